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
Bench: one relaxation curve of 2,000 points, fitted by this package and by its peers in one run.

The curve is that of a three-element body pushed for a second and held, with 1 % noise. A fit is
judged by its distance from the noise-free force over the hold. Peers that know only a step of the
displacement get the hold alone, from the largest force on; those that take any history get the
whole. The peers do not go together into one environment: each has one of its own in the folder
``--venvs``, made there by ``--install``, and runs in a process of its own on the same data.

``OMP_NUM_THREADS=1 python bench/bench_peers.py --venvs DIR --install``
"""

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from statistics import median
import subprocess
import sys
import tempfile
import time

from closed_form import Body, Cell, record
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.start import identify
from hapticvision_ros.core.records import Signal
from hapticvision_ros.core.segmentation import segment
import numpy as np

BODY = Body(K1=2000.0, C1=1600.0, C2=18400.0)
SPEED, DEPTH, RATE, DURATION = 0.005, 0.005, 100.0, 20.0


class Curve:
    """The recorded trial, and the truth of its hold."""

    def __init__(self) -> None:
        cell = Cell(
            rate=RATE,
            tool_rate=RATE,
            hold=DURATION - 2.0,
            release=False,
            force_noise=0.0,
            encoder_noise=0.0,
            force_zero=0.0,
            height_noise=1e-5,
        )
        clean = record(BODY, cell, SPEED, DEPTH, (0, 0))
        peak = float(clean.force.value.max())
        noise = 0.01 * peak * np.random.default_rng(1).standard_normal(len(clean.force))
        self.t = clean.force.t
        self.truth = clean.force.value
        self.force = clean.force.value + noise
        self.peak = peak
        self.trial = replace(clean, force=Signal(self.t, self.force), displacement_height=None)
        self.phases = segment(self.trial.force, self.trial.tool_height, None)
        # Two samples after the tool has come to rest.
        self.hold = self.t > (self.phases.t_hold or 0.0) + 2.0 / RATE

    def error(self, fitted: np.ndarray) -> float:
        """Return the distance of a fitted hold from the truth, over the peak."""
        return float(np.sqrt(np.mean((fitted - self.truth[self.hold]) ** 2))) / self.peak


def whole_fit(curve: Curve) -> np.ndarray:
    """Fit force and noise, with covariance, from the signals to the parameters."""
    result = fit([(curve.trial, curve.phases)], Model())
    problem = result.problem
    full = problem.trials[0].full_rate
    predicted = problem.predict(result.state, 0, full, directions=False).force
    # The reading, with the zero that was found: what the others fit as well.
    zero = curve.phases.force_zero + problem.own(result.state, 0)[1]
    return predicted[curve.hold] + zero


def identity(curve: Curve) -> np.ndarray:
    """Fit the force by the linear identity alone, without errors."""
    prepared, _ = prepare([(curve.trial, curve.phases)])
    trial = prepared[0]
    assert trial is not None
    body = identify([trial])
    model = Model()
    theta = model.theta([body.K1, body.C1, body.C2])
    force = model.predict(trial.full_rate, theta, directions=False).force
    return force[curve.hold] + curve.phases.force_zero


def two_exponentials(curve: Curve) -> np.ndarray:
    """Fit a relaxation with a constant by scipy's curve_fit, to the hold."""
    from scipy.optimize import curve_fit

    t = curve.t[curve.hold] - curve.t[curve.hold][0]

    def model(t: np.ndarray, a: float, b: float, c: float) -> np.ndarray:
        return a + b * np.exp(-t / c)

    found, _ = curve_fit(model, t, curve.force[curve.hold], p0=(0.0, curve.peak, 5.0))
    return model(t, *found)


def any_history(curve: Curve) -> np.ndarray:
    """Fit the three elements under the recorded history by scipy: odeint inside least_squares."""
    from scipy.integrate import odeint
    from scipy.optimize import least_squares

    t = curve.t
    speed = np.gradient(curve.trial.tool_height.value, t) * -1.0
    touched = t >= (curve.phases.t_contact or 0.0)
    speed = np.where(touched, speed, 0.0)

    def model(theta: np.ndarray) -> np.ndarray:
        k1, c1, c2 = np.exp(theta)
        z = odeint(
            lambda z, at: (c2 * np.interp(at, t, speed) - k1 * z) / (c1 + c2), 0.0, t, hmax=0.02
        )[:, 0]
        return k1 * z + c1 * (c2 * speed - k1 * z) / (c1 + c2)

    start = np.log([1000.0, 1000.0, 10000.0])
    found = least_squares(lambda theta: model(theta) - curve.force, start, method='lm')
    return model(found.x)[curve.hold]


OURS: tuple[tuple[str, Callable[[Curve], np.ndarray]], ...] = (
    ('this: whole fit, noise, covariance', whole_fit),
    ('this: linear identity only', identity),
    ('scipy odeint, any history', any_history),
    ('scipy curve_fit, hold only', two_exponentials),
)
PEERS = (
    ('rheojax Zener', 'rheojax==0.7.1'),
    ('rheojax fractional Zener', 'rheojax==0.7.1'),
    ('pyvisco Prony, 2 terms', 'pyvisco==2.1.3'),
    ('hermes-rheo spectrum', 'hermes-rheo==2.0.0'),
)
"""Fit in ``bench/peer_fits.py``, and what to install for it."""
PASCAL = 1e4
"""The peers' bounds are made for moduli [Pa]: they get the force as that on 1 cm^2."""
PATIENCE = 600.0
"""Time that a peer has for all its fits [s]."""


def environment(venvs: Path, requirement: str, *, install: bool) -> Path | None:
    """Return the interpreter of a peer's environment, made if asked for; None without."""
    folder = venvs / requirement
    python = folder / 'bin' / 'python'
    done = folder / 'installed'
    if install and not done.exists():
        print(f'installing {requirement} into {folder}', file=sys.stderr)
        subprocess.run([sys.executable, '-m', 'venv', '--clear', str(folder)], check=True)
        subprocess.run([str(python), '-m', 'pip', 'install', '-q', requirement], check=True)
        done.touch()
    return python if done.exists() else None


def peer_fit(
    curve: Curve, python: Path, name: str, repeats: int
) -> tuple[np.ndarray, list[float]] | str:
    """Return a peer's fitted hold and its times, the first one's first; or why there are none."""
    with tempfile.TemporaryDirectory() as folder:
        data, out = Path(folder, 'data.npz'), Path(folder, 'out.npz')
        t = curve.t[curve.hold]
        np.savez(data, t=t - t[0] + 1.0 / RATE, force=PASCAL * curve.force[curve.hold])
        script = Path(__file__).with_name('peer_fits.py')
        command = [str(python), str(script), name, str(data), str(repeats), str(out)]
        try:
            done = subprocess.run(
                command, capture_output=True, text=True, timeout=PATIENCE, check=False
            )
        except subprocess.TimeoutExpired:
            return f'not done in {PATIENCE:.0f} s'
        if done.returncode:
            return f'fails: {done.stderr.strip().splitlines()[-1]}'
        with np.load(out) as held:
            return held['fitted'] / PASCAL, held['times'].tolist()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--repeats', type=int, default=5, help='fits of which the median counts')
    parser.add_argument('--venvs', type=Path, help="folder of the peers' environments")
    parser.add_argument('--install', action='store_true', help='make those that are not there')
    args = parser.parse_args()
    curve = Curve()
    print(f'{curve.t.size} points; CPU time of the first fit, and the median of {args.repeats}')
    print('| fit | first | then | over the first line | error |\n| --- | --- | --- | --- | --- |')
    reference = None

    def show(name: str, fitted: np.ndarray, times: list[float]) -> None:
        nonlocal reference
        spent = median(times[1:])
        reference = spent if reference is None else reference
        error = 100.0 * curve.error(fitted)
        print(
            f'| {name} | {times[0] * 1e3:.1f} ms | {spent * 1e3:.1f} ms '
            f'| {spent / reference:.2f} | {error:.3f} % |',
            flush=True,
        )

    for name, work in OURS:
        times = []
        for _ in range(args.repeats + 1):
            start = time.process_time()
            fitted = work(curve)
            times.append(time.process_time() - start)
        show(name, fitted, times)
    for name, requirement in PEERS:
        python = environment(args.venvs, requirement, install=args.install) if args.venvs else None
        if python is None:
            print(f'| {name} | not measured: no {requirement} (--venvs, --install) | | | |')
            continue
        found = peer_fit(curve, python, name, args.repeats)
        if isinstance(found, str):
            print(f'| {name} | {found} | | | |', flush=True)
            continue
        show(name, *found)


if __name__ == '__main__':
    main()
