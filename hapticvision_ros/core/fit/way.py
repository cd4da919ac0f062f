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
The way of a tool that goes neither straight nor by a known shape, from encoders with noise.

Gears ripple, and a tool may be led along a curve. A path through the samples then makes force of
their noise, and so does one of straight pieces of their corners. Between them is the smoothest way
that the samples allow, beside ripples that repeat: these are told by all their periods together.

"""

from collections.abc import Mapping, Sequence
import math
from threading import Lock
from typing import Final, NamedTuple

from hapticvision_ros.core.fit.ripple import candidates, Ripple
from hapticvision_ros.core.fit.smooth import adapted, calm, Smoothed, usual_interval
from hapticvision_ros.core.records import FloatArray
import numpy as np

_BETWEEN: Final = 0.25
"""Interval between two knots, over one over the bandwidth [rad]."""
_CHORD: Final = 0.1
"""How far the way may be off between two knots, over the noise of a sample."""
_CALM: Final = 0.75
"""Part of the interval of a part that shows no jerk, from which on the way is as in one."""
_MOST_PARTS: Final = 8
"""Knots between two samples, at most, and one."""
_FINE: Final = 2.0
"""Bandwidth for which knots are as dense as those along a ripple, over its rate."""
_CLOSE: Final = 0.5
"""Promise of a ripple that may be the better one, over the greatest."""
_MOST_RIPPLES: Final = 3
"""Ripples of one record, at most."""
_MOST_KEPT: Final = 64

type Key = tuple[bytes, bytes, float, bytes]

_kept: Final[dict[Key, 'Way']] = {}
"""A campaign's paths are made several times, for arms that change their speed otherwise."""
_lock: Final = Lock()


class Way(NamedTuple):
    """
    A smooth way.

    Parameters
    ----------
    t, value : ndarray, shape (k,)
        Knots [s, m].
    misfit : float
        Minus twice the log likelihood of the samples, but for a constant; not finite where the
        samples tell no way.
    still : float
        Interval between knots from which on the speed hardly changes between these [s].
    unsteady : ndarray, shape (k,)
        By how much its speed is off at the knots: that of a mean over a time is off by this over
        the root of the time [m/s^0.5].

    """

    t: FloatArray
    value: FloatArray
    misfit: float
    still: float
    unsteady: FloatArray


def smooth(t: FloatArray, value: FloatArray, noise: float, alike: FloatArray | None = None) -> Way:
    """
    Return the smoothest way that samples with noise allow.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        The samples [s, m].
    noise : float
        Standard deviation of each [m].
    alike : ndarray, shape (n,), optional
        Of how many samples each is one that err as one, where they round; their errors may
        repeat, so that no ripple is looked for. One by default.

    Returns
    -------
    Way
        It, from the first sample to the last.

    """
    key = t.tobytes(), value.tobytes(), noise, b'' if alike is None else alike.tobytes()
    way = _kept.get(key)
    if way is None:
        way = _smooth(t, value, noise, alike)
        keep({key: way})
    return way


def kept() -> dict[Key, Way]:
    """Return the ways that are known, by their samples: for a process that does not know them."""
    with _lock:
        return dict(_kept)


def keep(ways: Mapping[Key, Way]) -> None:
    """Know some ways, in place of the oldest ones where they are many."""
    with _lock:
        _kept.update(ways)
        for oldest in [*_kept][: max(len(_kept) - _MOST_KEPT, 0)]:
            del _kept[oldest]


def _smooth(t: FloatArray, value: FloatArray, noise: float, alike: FloatArray | None) -> Way:
    found = adapted(t, value, noise, alike)
    ripples: list[Ripple] = []
    left = value
    # The errors of rounding repeat as well where the tool goes on evenly.
    while alike is None and len(ripples) < _MOST_RIPPLES:
        tried = candidates(t, left, noise, found)
        most = max((ripple.promise for ripple in tried), default=0.0)
        # To smooth all samples anew takes longest.
        ways = [
            (adapted(t, left - ripple.at(t), noise), ripple)
            for ripple in tried
            if ripple.promise > max(0.0, _CLOSE * most)
        ]
        cleaned, ripple = min(ways, key=_cost, default=(found, None))
        if ripple is None or _cost((cleaned, ripple)) >= found.misfit:
            break
        found, left = cleaned, left - ripple.at(t)
        ripples.append(ripple)
    knots, levels = _knots(t, found, ripples, noise)
    for ripple in ripples:
        levels += ripple.at(knots)
    interval = usual_interval(t)
    # Up to the bandwidth the way goes with the noise of the samples, whose speed has the power of
    # the square of the frequency: a third of what it has at the end, which is that of the samples
    # at most. At rest it is none.
    most = math.pi / interval
    wide = np.where(found.bandwidth > calm(interval), np.minimum(found.bandwidth, most), 0.0)
    if alike is not None:
        # As of longer intervals, up to the shortest time that is followed.
        longest = 1.0 / (np.maximum(wide, calm(interval)) * interval)
        wide = wide * np.cbrt(np.minimum(alike, np.maximum(longest, 1.0)))
    unsteady = noise * math.sqrt(interval / 3.0) * np.interp(knots, t, wide)
    return Way(knots, levels, found.misfit, _CALM * _BETWEEN / calm(interval), unsteady)


def _cost(way: tuple[Smoothed, Ripple]) -> float:
    return way[0].misfit + way[1].price


def _knots(
    t: FloatArray, found: Smoothed, ripples: Sequence[Ripple], noise: float
) -> tuple[FloatArray, FloatArray]:
    """
    Return knots as dense as bandwidths and accelerations ask for, on a cubic between the samples.

    An even acceleration shows no jerk, and is not straight.
    """
    state, speed, bandwidth, _ = found
    steps = np.diff(t)
    wide = np.maximum(bandwidth[1:], bandwidth[:-1])
    # A chord is off its parabola by an eighth of the acceleration and the square of its time.
    bent = np.abs(np.diff(speed)) / steps
    wide = np.maximum(wide, _BETWEEN * np.sqrt(bent / (8.0 * _CHORD * noise)))
    for ripple in ripples:
        wide = np.maximum(wide, _FINE * ripple.rate)
    parts = np.clip(np.ceil(steps * wide / _BETWEEN), 1, _MOST_PARTS).astype(np.intp)
    number = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    share = number / np.repeat(parts, parts)
    place = np.repeat(np.arange(steps.size), parts)
    step = steps[place]
    rest = 1.0 - share
    level = rest * rest * (1.0 + 2.0 * share) * state[place]
    level += share * share * (3.0 - 2.0 * share) * state[place + 1]
    level += share * rest * step * (rest * speed[place] - share * speed[place + 1])
    knots = t[place] + share * step
    # Fewer where the way bends little: one wherever that many turns of the bandwidth have passed.
    turns = np.concatenate(([0.0], np.cumsum(steps * wide)))
    passed = np.floor(np.interp(knots, t, turns) / _BETWEEN)
    kept = np.concatenate(([True], np.diff(passed) > 0.0))
    return np.append(knots[kept], t[-1]), np.append(level[kept], state[-1])
