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
How long the paper's method takes on one trial of 130 s at 1 kHz.

Beside it, in turns on the same samples, scipy's `curve_fit` on the same two exponentials alone,
from starting values close to the truth and without glitches, phases or corrected errors.
Run it with OMP_NUM_THREADS=1.
"""

from statistics import median
import time

from hapticvision_ros.core.fit.paper import fit_paper
from hapticvision_ros.core.records import Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import curve_fit

ROUNDS = 15
TOP, DEPTH, SPEED, HOLD, RECOVERY = 0.040, 0.010, 0.005, 67.0, 60.0
T_CONTACT = 1.0
T_HOLD = T_CONTACT + DEPTH / SPEED
T_RELEASE = T_HOLD + HOLD
TAU, F0, F_INF, GAMMA, H0, H_INF = 15.0, 9.0, 5.0, 8.0, 0.001, 0.009


def make_trial() -> Trial:
    """Return 130 s of force at 1 kHz, tool at 500 Hz and displacement height at 30 Hz."""
    rng = np.random.default_rng(1)
    end = T_RELEASE + RECOVERY
    t = np.arange(0.0, end, 1e-3)
    ramp = (F0 + F_INF) * np.clip(t - T_CONTACT, 0.0, None) / (T_HOLD - T_CONTACT)
    force = np.where(t < T_HOLD, ramp, F0 * np.exp(-(t - T_HOLD) / TAU) + F_INF)
    force[t >= T_RELEASE] = 0.0
    tool_t = np.arange(0.0, end, 2e-3)
    tool = np.interp(
        tool_t,
        [0.0, T_CONTACT, T_HOLD, T_RELEASE, T_RELEASE + 1.0],
        [TOP + SPEED * T_CONTACT, TOP, TOP - DEPTH, TOP - DEPTH, TOP + DEPTH],
    )
    height_t = np.arange(0.0, end, 1.0 / 30.0)
    height_t = height_t[(height_t < T_CONTACT) | (height_t >= T_RELEASE)]
    recovery = H0 * np.exp(-(height_t - T_RELEASE) / GAMMA) + H_INF
    height = np.where(height_t < T_CONTACT, 0.0, recovery)
    return Trial(
        name='bench',
        start_ns=0,
        force=Signal(t, force + 0.02 * rng.standard_normal(t.size)),
        tool_height=Signal(tool_t, tool + 1e-6 * rng.standard_normal(tool_t.size)),
        displacement_height=Signal(height_t, height + 1e-4 * rng.standard_normal(height_t.size)),
    )


def decay(
    t: NDArray[np.float64], amplitude: float, time_constant: float, offset: float
) -> NDArray[np.float64]:
    """Return eq. (4) or (10)."""
    return np.asarray(amplitude * np.exp(-t / time_constant) + offset, dtype=np.float64)


def fit_with_scipy(trial: Trial, phases: Segmentation) -> None:
    """Fit both exponentials with curve_fit."""
    height = trial.displacement_height
    if phases.t_hold is None or phases.t_release is None or height is None:
        raise SystemExit('the trial was not segmented')
    hold = trial.force.between(phases.t_hold + 0.01, phases.t_release - 0.01)
    curve_fit(decay, hold.t - phases.t_hold, hold.value, p0=(8.0, 12.0, 4.0))
    free = height.between(phases.t_release, phases.t_end)
    curve_fit(decay, free.t - phases.t_release, free.value, p0=(0.0008, 10.0, 0.008))


def milliseconds(call: object, *arguments: object) -> float:
    """Return the wall time of one call [ms]."""
    start = time.perf_counter()
    call(*arguments)  # type: ignore[operator]
    return 1e3 * (time.perf_counter() - start)


def main() -> None:
    """Print the medians and their ratios."""
    trial = make_trial()
    arguments = (trial.force, trial.tool_height, trial.displacement_height)
    phases = segment(*arguments)
    calls = {
        'segmentation': (segment, *arguments),
        "the paper's method": (fit_paper, trial, phases),
        'scipy curve_fit, both decays': (fit_with_scipy, trial, phases),
    }
    rounds = [{name: milliseconds(*call) for name, call in calls.items()} for _ in range(ROUNDS)]
    segmented, ours, scipy = (median(r[name] for r in rounds) for name in calls)
    print(f'one trial of {phases.t_end:.0f} s, {len(trial.force)} samples of force')
    for name, duration in zip(calls, (segmented, ours, scipy), strict=True):
        best = min(r[name] for r in rounds)
        print(f'{name:30} median {duration:7.1f} ms   best {best:7.1f} ms')
    print(f'ratio curve_fit / paper method {scipy / ours:7.2f}')


if __name__ == '__main__':
    main()
