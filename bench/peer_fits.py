# Copyright 2026 The hapticvision_ros developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.

"""
One peer's fit of a relaxation, in the environment where that peer is installed.

Run by ``bench/bench_peers.py``: ``python peer_fits.py PEER DATA.npz REPEATS OUT.npz``. The data
hold `t` and `force` of a hold, `t` from its first step on; written are the fitted force, the CPU
time of the first fit and those of the further ones. Imports only the peer and numpy.
"""

import contextlib
import io
import sys
import time
import warnings

import numpy as np


def rheojax_zener():
    """Return a fit of a Maxwell element beside a spring."""
    from rheojax.models import Zener

    def fit(t, force):
        model = Zener()
        model.fit(t, force, test_mode='relaxation')
        return np.asarray(model.predict(t, test_mode='relaxation'))

    return fit


def rheojax_fractional_zener():
    """Return a fit of a fractional Maxwell element beside a spring."""
    from rheojax.models import FractionalZenerSolidSolid

    def fit(t, force):
        model = FractionalZenerSolidSolid()
        model.fit(t, force, test_mode='relaxation')
        return np.asarray(model.predict(t, test_mode='relaxation'))

    return fit


def pyvisco_prony():
    """Return a fit of a Prony series whose terms and times are looked for."""
    import pandas as pd
    from pyvisco import master, prony

    def fit(t, force):
        frame = pd.DataFrame({'t': t, 'E_relax': force})
        frame['f'] = 1.0 / frame['t']
        frame['omega'] = 2.0 * np.pi * frame['f']
        frame.RefT, frame.domain, frame.modul = 20.0, 'time', 'E'
        frame = master.smooth(frame, win=1)
        found, _ = prony.fit(prony.discretize(frame, window='min', nprony=2), frame, opt=True)
        terms = found['df_terms']
        share, times = terms['alpha_i'].to_numpy(), terms['tau_i'].to_numpy()
        decay = np.exp(-t[:, np.newaxis] / times) @ share
        return found['E_0'] * (1.0 - share.sum() + decay)

    return fit


def hermes_spectrum():
    """Return a fit of a relaxation spectrum with its plateau, then of discrete modes."""
    from hermes_rheo.transforms.relaxation_spectrum import RelaxationSpectrum
    from piblin.data.data_collections.measurement import Measurement
    from piblin.data.datasets.abc.split_datasets.one_dimensional_composite_dataset import (
        OneDimensionalCompositeDataset,
    )

    def fit(t, force):
        dataset = OneDimensionalCompositeDataset(
            data_arrays=[t, force],
            data_array_names=['time', 'relaxation modulus'],
            data_array_units=['s', 'Pa'],
            default_independent_name='time',
            default_dependent_name='relaxation modulus',
            source='bench',
        )
        transform = RelaxationSpectrum('time', plateau=True, relaxation_name='relaxation modulus')
        transform(Measurement(datasets=[dataset], conditions={}, details={}))
        found = transform.result
        return found.G0_disc + np.exp(-t[:, np.newaxis] / found.tau) @ found.g

    return fit


FITS = {
    'rheojax Zener': rheojax_zener,
    'rheojax fractional Zener': rheojax_fractional_zener,
    'pyvisco Prony, 2 terms': pyvisco_prony,
    'hermes-rheo spectrum': hermes_spectrum,
}


def main() -> None:
    """Fit and write."""
    name, data, repeats, out = sys.argv[1:]
    with np.load(data) as held:
        t, force = held['t'], held['force']
    warnings.simplefilter('ignore')
    times = []
    with contextlib.redirect_stdout(io.StringIO()):
        fit = FITS[name]()
        for _ in range(int(repeats) + 1):
            start = time.process_time()
            fitted = fit(t, force)
            times.append(time.process_time() - start)
    np.savez(out, fitted=fitted, times=times)


if __name__ == '__main__':
    main()
