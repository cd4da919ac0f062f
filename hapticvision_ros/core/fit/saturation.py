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
Where the range of a load cell ends.

A cell that is saturated goes on to read the same: what it reads then is no measurement.
"""

from collections.abc import Sequence
import math
from typing import Final

from hapticvision_ros.core.outliers import NORMAL_FROM_MAD, runs
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

_CHANCE: Final = 1e-6
"""Chance at most that readings of noise stay at their greatest for as long."""
_SHORTEST: Final = 10
"""Readings in a row at least."""
_STRETCH: Final = 20
"""Readings in which it is looked whether they differ from one to the next."""
_CALMEST: Final = 0.05
"""Part of the stretches that may be calmer."""
_ALIKE: Final = 0.5
"""Part of a stretch's readings that are as the one before, from which on it tells nothing."""
_TURNING: Final = 0.2
"""Part of the readings at least that are above both of their neighbours, or below both: of white
noise two in three."""
_NEAR: Final = 10
"""Readings beside one at the end of the range whose noise has to do with it, where they are"""
_BELOW: Final = 3.0
"""standard deviations below it at most."""


def end_of_range(forces: Sequence[FloatArray]) -> float:
    """
    Return the force at which the readings of a load cell end.

    Parameters
    ----------
    forces : sequence of ndarray, shapes (n,)
        All readings of some trials [N].

    Returns
    -------
    float
        Their greatest one, if it is read again and again where all others differ from one to the
        next by their noise [N]; infinity otherwise, also where the readings are rounded so that
        they do not differ.

    """
    most = max((float(force.max()) for force in forces if force.size), default=math.inf)
    for force in forces:
        longest = max((stop - start for start, stop in runs(force == most)), default=0)
        if longest < _SHORTEST:
            continue
        alike = _alike(force, most)
        if alike >= _ALIKE or not _is_noisy(force[force < most]):
            continue
        enough = math.log(_CHANCE / force.size) / math.log(max(alike, _CALMEST))
        if longest >= enough:
            return most
    return math.inf


def at_the_end(force: FloatArray, end: float) -> NDArray[np.bool_]:
    """
    Return which readings the end of the range has to do with.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Readings [N].
    end : float
        From `end_of_range` [N].

    Returns
    -------
    ndarray of bool, shape (n,)
        Those at the end, and those nearby that are below it only by their noise.

    """
    found = force >= end
    if not found.any():
        return found
    below = np.diff(force[~found], 2)
    noise = 0.0
    if below.size:
        noise = NORMAL_FROM_MAD * float(np.median(np.abs(below))) / math.sqrt(6.0)
    near = np.convolve(found, np.ones(2 * _NEAR + 1))[slice(_NEAR, _NEAR + found.size)] > 0.5
    return found | (near & (force >= end - _BELOW * noise))


def _is_noisy(force: FloatArray) -> bool:
    """Return whether readings go up and down, as they do by noise."""
    ways = np.sign(np.diff(force))
    return bool(np.mean(ways[1:] * ways[:-1] < 0.0) > _TURNING) if ways.size > 1 else False


def _alike(force: FloatArray, most: float) -> float:
    """Return the part of readings below the greatest that are as the one before, at most [-]."""
    same = np.diff(force[force < most]) == 0.0
    count = same.size // _STRETCH
    if not count:
        return 1.0
    parts = same[: count * _STRETCH].reshape(count, _STRETCH).mean(axis=1)
    return float(np.quantile(parts, 1.0 - _CALMEST))
