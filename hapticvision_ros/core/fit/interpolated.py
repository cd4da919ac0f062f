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
Encoders that are read seldom, between whose readings a driver draws straight lines.

What it tells in between is no reading of its own: followed as it stands, the tool would change its
speed at every reading by what the noise of two of them makes over the time between.
"""

import math
from typing import Final

from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.records import FloatArray
import numpy as np

_STRAIGHT: Final = 1e-9
"""Part of the way by which a sample may leave the line through its neighbours: arithmetic."""
_FEWEST: Final = 32
"""Readings that show that they come regularly."""
_SPARSE: Final = 2.95
_DENSE: Final = 20.0
"""Samples from one reading to the next: with fewer not every line has three; more are how a tool
goes."""
_REGULAR: Final = 0.02
"""Part of their interval by which the times between the lines' ends may be no multiples of it."""
_USUAL: Final = 0.9
"""Part of them that are."""
_ALIKE: Final = 0.8
"""Part of all turns that may be as large as the usual one: more are a tool to and fro."""
_MISSED: Final = 1e-6
_MOSTLY: Final = 0.99
"""Part of the way by which what is found may miss a sample, and part of them that it tells."""
_SIGMAS: Final = 6.0
"""Noise of the readings by which it may miss the others: those at a line that is too short."""


def readings(t: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """
    Return the readings of a source between which samples were interpolated.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        Samples [s, m].

    Returns
    -------
    t, value : ndarray, shape (k,)
        Where the lines meet that the samples lie on, which is at regular times; what lies on a
        line at such a time without a turn; and the first and the last sample. The samples
        themselves where that does not tell all of them.

    """
    step = np.diff(t)
    if t.size < _FEWEST or not np.all(step > 0.0):
        return t, value
    slope = np.diff(value) / step
    off = np.abs(np.diff(slope)) * np.minimum(step[1:], step[:-1])
    straight = off <= _STRAIGHT * float(np.ptp(value))
    # Of each line the first interval between two samples, and the last.
    on_line = np.zeros(slope.size, dtype=np.bool_)
    on_line[:-1] |= straight
    on_line[1:] |= straight
    first = np.flatnonzero(on_line & np.concatenate(([True], ~straight)))
    last = np.flatnonzero(on_line & np.concatenate((~straight, [True])))
    apart = first[1:] - last[:-1]
    before, after = last[:-1], first[1:]
    turn = slope[after] - slope[before]
    # They meet at a sample, or within the interval between the two.
    met = t[after].copy()
    between = (apart == 2) & (turn != 0.0)
    rise = value[before] + slope[before] * (t[after] - t[before]) - value[after]
    met[between] = (t[after] + rise / np.where(turn == 0.0, 1.0, turn))[between]
    known = (apart == 1) | (between & (met >= t[before + 1]) & (met <= t[after]))
    at = met[known]
    if at.size < _FEWEST:
        return t, value
    gaps = np.diff(at)
    interval = float(np.median(gaps))
    usual = float(np.median(step))
    if not _SPARSE * usual < interval < _DENSE * usual:
        return t, value
    # Nothing is read more often than it is told.
    if t[-1] - t[0] > interval * t.size:
        return t, value
    times = np.maximum(np.rint(gaps / interval), 1.0)
    if np.mean(np.abs(gaps - times * interval) < _REGULAR * interval) < _USUAL:
        return t, value
    level = (value[before] + slope[before] * (met - t[before]))[known]
    # Readings that lie on one line with their neighbours are readings as well.
    parts = times.astype(np.intp)
    number = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    inner = np.repeat(at[:-1], parts) + np.repeat(gaps / times, parts) * number
    # Up to the first and the last sample, but not next to them.
    early = np.arange(at[0] - interval, t[0] + 0.5 * interval, -interval)[::-1]
    late = np.arange(at[-1] + interval, t[-1] - 0.5 * interval, interval)
    beside = np.concatenate((t[:1], early)), np.concatenate((late, t[-1:]))
    whole = np.concatenate((beside[0], inner, at[-1:], beside[1]))
    knots = np.concatenate((beside[0], at, beside[1]))
    levels = np.concatenate(
        (np.interp(beside[0], t, value), level, np.interp(beside[1], t, value))
    )
    turns = np.abs(np.diff(level, 2))
    noise = NORMAL_FROM_MAD * float(np.median(turns)) / math.sqrt(6.0)
    usual_turn = np.abs(turns - np.median(turns)) < _REGULAR * np.median(turns)
    missed = np.abs(np.interp(t, knots, levels) - value)
    told = float(np.mean(missed <= _MISSED * float(np.ptp(value))))
    if np.mean(usual_turn) > _ALIKE or told < _MOSTLY or float(missed.max()) > _SIGMAS * noise:
        return t, value
    return whole, np.interp(whole, knots, levels)
