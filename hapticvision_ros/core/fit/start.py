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
Where the search starts: the three-element model by linear least squares.

In contact the force is ``eta v + k s(T)``, linear in eta and k at a given relaxation time T (see
`hapticvision_ros.core.models.three_element`), so that a look at all T finds the best one wherever
it is: a search that starts there has no wrong valley to fall into.
"""

from collections.abc import Sequence
from typing import Final

from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.models.three_element import ThreeElement
from hapticvision_ros.core.records import FloatArray
import numpy as np

_GRID: Final = 48
_SAME: Final = 1e-9
"""Relative difference between two steps that makes none."""
_LONGEST: Final = 100.0
"""The slowest relaxation that is tried, in durations of a contact."""


@kernel()
def _products(duration, travel, force, count, times, out):  # type: ignore[no-untyped-def]
    """Add the products of speed, mean Maxwell stretch and force to `out`, shape (6, times)."""
    for k in range(times.size):
        T = times[k]
        s = 0.0
        known = -1.0
        left = 0.0
        mean = 0.0
        for i in range(duration.size):
            h = duration[i]
            if abs(h - known) > _SAME * h:
                known = h
                left = np.exp(-h / T)
                mean = -T / h * np.expm1(-h / T)
            v = travel[i] / h
            away = s - v * T
            stretch = v * T + mean * away
            s = v * T + left * away
            w = count[i]
            out[0, k] += w * v * v
            out[1, k] += w * v * stretch
            out[2, k] += w * stretch * stretch
            out[3, k] += w * v * force[i]
            out[4, k] += w * stretch * force[i]
            out[5, k] += w * force[i] * force[i]


def identify(trials: Sequence[FitTrial]) -> ThreeElement:
    """
    Return the three-element model that follows the force of push and hold best.

    Parameters
    ----------
    trials : sequence of FitTrial
        At least one.

    Returns
    -------
    ThreeElement
        With all three elements above zero, to start a search from.

    """
    pieces = []
    longest, shortest = 0.0, np.inf
    for trial in trials:
        stop = trial.t[-1] if trial.t_release is None else trial.t_release
        inside = (trial.t[:-1] >= trial.t_contact) & (trial.t[1:] <= stop)
        duration = np.diff(trial.t)[inside]
        if duration.size < 4:
            continue
        travel = np.diff(trial.displacement)[inside]
        pieces.append((duration, travel, trial.force[inside], trial.force_count[inside]))
        longest = max(longest, float(duration.sum()))
        shortest = min(shortest, trial.interval)
    if not pieces:
        return ThreeElement.from_maxwell(1.0, 1.0, 1.0)
    low, high = shortest, _LONGEST * longest
    for _ in range(3):
        times = np.geomspace(low, high, _GRID)
        sums = np.zeros((6, _GRID))
        for piece in pieces:
            _products(*piece, times, sums)
        cost, eta, k = _best(sums)
        at = int(np.argmin(cost))
        low, high = float(times[max(at - 1, 0)]), float(times[min(at + 1, _GRID - 1)])
    T, best_k, best_eta = float(times[at]), float(k[at]), float(eta[at])
    # A vanishing element is none to start from: the search works with logarithms.
    best_k = max(best_k, 1e-3 * best_eta / T, 1e-6)
    best_eta = max(best_eta, 1e-3 * best_k * T)
    return ThreeElement.from_maxwell(best_eta, best_k, T)


def _best(sums: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return least cost, eta and k, neither negative, for each relaxation time."""
    vv, vs, ss, vf, sf, ff = sums
    determinant = vv * ss - vs**2
    with np.errstate(divide='ignore', invalid='ignore'):
        eta = (ss * vf - vs * sf) / determinant
        k = (vv * sf - vs * vf) / determinant
        inside = (eta >= 0.0) & (k >= 0.0) & (determinant > 1e-12 * vv * ss)
        only_k = np.where(ss > 0.0, np.maximum(sf / ss, 0.0), 0.0)
        only_eta = np.where(vv > 0.0, np.maximum(vf / vv, 0.0), 0.0)
    branch = only_k * sf >= only_eta * vf
    eta = np.where(inside, eta, np.where(branch, 0.0, only_eta))
    k = np.where(inside, k, np.where(branch, only_k, 0.0))
    return ff - eta * vf - k * sf, eta, k
