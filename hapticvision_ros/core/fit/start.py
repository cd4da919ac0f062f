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
from hapticvision_ros.core.outliers import runs
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

_GRID: Final = 48
_SAME: Final = 1e-9
"""Relative difference between two steps that makes none."""
_LONGEST: Final = 100.0
"""The slowest relaxation that is tried, in durations of a contact."""
_IN_AIR: Final = 3.0
_PRESSED: Final = 10.0
"""Forces of a tool in the air and of one that presses, in standard deviations of the noise."""
_BACK: Final = 0.01
"""Part of the deepest way by which a tool is back that has left."""
_STEPS_IN_AIR: Final = 3
"""Fewest steps in a row in which a tool has left."""


@kernel()
def _products(duration, travel, force, count, fresh, times, out):  # type: ignore[no-untyped-def]
    """
    Add the products of speed, mean Maxwell stretch and force to `out`, shape (6, times).

    From a fresh step on the stretch is what it would be from none, and an unknown one that was
    there decays beside it, which takes its part of all products.
    """
    part = np.zeros(4)
    for k in range(times.size):
        T = times[k]
        s = 0.0
        before = 0.0
        known = -1.0
        left = 0.0
        mean = 0.0
        part[:] = 0.0
        for i in range(duration.size + 1):
            if i == duration.size or fresh[i]:
                if part[0] > 0.0:
                    vb, sb, fb = part[1], part[2], part[3]
                    out[0, k] -= vb * vb / part[0]
                    out[1, k] -= vb * sb / part[0]
                    out[2, k] -= sb * sb / part[0]
                    out[3, k] -= vb * fb / part[0]
                    out[4, k] -= sb * fb / part[0]
                    out[5, k] -= fb * fb / part[0]
                if i == duration.size:
                    break
                part[:] = 0.0
                s = 0.0
                before = 1.0
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
            if before > 0.0:
                decayed = mean * before
                before *= left
                part[0] += w * decayed * decayed
                part[1] += w * v * decayed
                part[2] += w * stretch * decayed
                part[3] += w * force[i] * decayed


def _contacts(
    travel: FloatArray, force: FloatArray, count: FloatArray, noise: float
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """
    Tell when a tool that goes to and fro leaves the object and touches it again.

    Parameters
    ----------
    travel, force, count : ndarray, shape (n,)
        How far the tool goes on in each step of a push [m], the force [N], and how many samples
        it is the mean of.
    noise : float
        Standard deviation of a sample [N].

    Returns
    -------
    count : ndarray, shape (n,)
        As it was, but zero for steps in the air and for those beside them.
    fresh : ndarray of bool, shape (n,)
        The first step of each contact but the first one.

    """
    reached = np.cumsum(travel)
    deepest = np.maximum.accumulate(reached)
    # A force that is gone where the tool is at its deepest has relaxed.
    away = (np.abs(force) < _IN_AIR * noise) & (deepest - reached > _BACK * deepest[-1])
    away[: int(np.argmax(force > _PRESSED * noise))] = False
    kept = count.copy()
    fresh = np.zeros(force.size, dtype=np.bool_)
    for first, last in runs(away):
        if last - first < _STEPS_IN_AIR:
            continue
        beside = slice(max(first - 1, 0), last + 1)
        kept[beside] = 0.0
        if last + 1 < force.size:
            # The step after it may hold the touch.
            fresh[last + 1] = True
    return kept, fresh


def identify(trials: Sequence[FitTrial], noise: float = 0.0) -> ThreeElement:
    """
    Return the three-element model that follows the force of push and hold best.

    Parameters
    ----------
    trials : sequence of FitTrial
        At least one.
    noise : float, default 0
        Standard deviation of a sample of the force [N], which tells where a tool that goes to and
        fro is in the air.

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
        force = trial.force[inside]
        pieces.append(
            (duration, travel, force, *_contacts(travel, force, trial.force_count[inside], noise))
        )
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
