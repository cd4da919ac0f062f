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
The kernels of the fit, compiled in a process of its own before a node fits.

A compiler holds Python's lock for a minute: a node that compiled them itself, as at its first
trial after an installation, would not take the messages of the next one in time.
"""

import os
import subprocess
import sys
import threading
import time
from typing import Final

NICENESS: Final = 10
"""What takes the messages goes first."""
_COMMAND: Final = (sys.executable, '-P', '-m', 'hapticvision_ros.nodes.fit_kernels')
_LONGEST: Final = 600.0
"""The first fit compiles what this long was not enough for [s]."""
_LOOK_AGAIN: Final = 0.1
"""Period at which it is looked whether the node stops [s]."""


def missing() -> bool:
    """Return whether kernels that each fit calls have changed since they were compiled."""
    # These take longer to import than a node may take to answer.
    from hapticvision_ros.core.fit import bend, campaign, data, noise_model, ripple, smooth, start
    from hapticvision_ros.core.kernels import kept
    from hapticvision_ros.core.models import chain

    modules = (bend, campaign, chain, data, noise_model, ripple, smooth, start)
    return not all(kept(module) for module in modules)


def compile_apart(stopping: threading.Event) -> None:
    """
    Compile what is `missing` in a process of its own, and wait for it.

    Where it cannot be started or fails nothing is lost: the first fit compiles what it needs.

    Parameters
    ----------
    stopping : threading.Event
        Ends the process, whatever it is doing.

    """
    environment = dict(os.environ) | {'OMP_NUM_THREADS': '1', 'OPENBLAS_NUM_THREADS': '1'}
    try:
        process = subprocess.Popen(
            _COMMAND,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=environment,
            # Ctrl-C in a terminal reaches the node, which ends this.
            start_new_session=True,
        )
    except OSError:
        return
    try:
        deadline = time.monotonic() + _LONGEST
        while process.poll() is None and time.monotonic() < deadline:
            if stopping.wait(_LOOK_AGAIN):
                break
    finally:
        process.kill()
        process.wait()


def main() -> int:
    """Fit a push that was calculated, as a node fits one that was measured."""
    os.nice(NICENESS)
    import warnings

    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.fit.campaign import fit
    from hapticvision_ros.core.fit.way import smooth
    from hapticvision_ros.core.pipeline import analyse
    from hapticvision_ros.core.records import Signal, Trial
    import numpy as np

    warnings.simplefilter('ignore')
    random = np.random.default_rng(0)
    t = np.arange(0.0, 4.0, 0.005)
    # A push by 5 mm in 0.5 s, a hold, and the way back, over a height of 50 mm.
    depth = 1e-2 * np.clip(np.minimum(t - 0.5, 3.0 - t), -0.1, 0.5)
    force = np.where(t < 2.5, 1000.0 * np.maximum(depth, 0.0), 0.0)
    force *= np.where(t < 1.0, 1.0, 0.5 + 0.5 * np.exp(1.0 - t))
    force += random.normal(0.0, 0.01, t.size)
    height = Signal(t, 0.05 - depth + random.normal(0.0, 1e-6, t.size))
    trial = Trial('calculated', 0, Signal(t, force), height, None, 'none')
    fit([analyse(trial)], Model())
    # The arm of this push goes along no curve, and does not ripple.
    smooth(t, height.value + 2e-5 * np.sin(150.0 * t), 1e-6)
    return 0


if __name__ == '__main__':
    sys.exit(main())
