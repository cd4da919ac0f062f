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

from functools import lru_cache
import math
from typing import Final

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

_STRAIGHT: Final = 1e-9
"""Part of the way by which a sample may leave the line through its neighbours: arithmetic."""
_FEWEST: Final = 32
"""Readings that show that they come regularly."""
_SPARSE: Final = 2.95
_DENSE: Final = 20.0
"""Samples from one reading to the next: with fewer not every line has three; more are how a tool
goes."""
_DENSEST: Final = 1.2
"""Samples from one reading to the next where not every line has three: with fewer yet hardly more
is told than read, and nothing shows how."""
_OUTSIDE: Final = 3.0
"""Medians beyond which what samples turn by is no noise."""
_UNLIKE: Final = -0.5
"""How alike two turns in a row are at least where some samples lie on lines between others: -0.40
with 1.2 a reading."""
_UNUSUAL: Final = 0.3
"""By how much they may be more, or less, alike than those of readings with new noise in each."""
_WINDOW: Final = 128
"""Samples at which their interval and phase are looked for first."""
_PHASES: Final = 12
_PARTS: Final = 7
_CHANCES: Final = 8
_ZOOM: Final = 0.5
_SURE: Final = 1e-8
"""Phases that are looked at, parts of what is looked at more closely, how many intervals have that
chance, how much more closely, and until when."""
_AGAIN: Final = 1e-3
"""Part of an interval by which those of the window may be off at the ends of all samples."""
_MOST_TIMES: Final = 4
"""How many times as many readings as there are may be found at first."""
_END: Final = 1.5
"""Intervals from the first and the last sample by which there is a reading, if one is known."""
_NOTHING: Final = 1e-13
"""Squares of a sample's share that are always known of a reading: nothing is divided by zero."""
_MOST_UNSURE: Final = 1e3
"""Variance of a reading over that of a sample, beyond which samples are lost that tell of it."""
_UNTOLD: Final = 1e-3
"""Part of what samples turn by that may be missed, by the root of the mean square."""
_REGULAR: Final = 0.02
"""Part of their interval by which the times between the lines' ends may be no multiples of it, and
within which a sample tells the same as a reading; of the usual turn, by which others are as large,
and by which each sample may be missed."""
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
        line at such a time without a turn; the first and the last sample; and samples beside
        lost ones. The samples themselves where that does not tell all of them, up to an interval
        and a half from the first and the last.

    """
    if t.size < _FEWEST or not np.all(np.diff(t) > 0.0):
        return t, value
    found = _where_lines_meet(t, value)
    if found is None:
        found = _that_fit(t.tobytes(), value.tobytes())
    return (t, value) if found is None else (found[0].copy(), found[1].copy())


def _where_lines_meet(t: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Return readings between which lines have three samples or more."""
    step = np.diff(t)
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
        return None
    gaps = np.diff(at)
    interval = float(np.median(gaps))
    usual = float(np.median(step))
    if not _SPARSE * usual < interval < _DENSE * usual:
        return None
    # Nothing is read more often than it is told.
    if t[-1] - t[0] > interval * t.size:
        return None
    times = np.maximum(np.rint(gaps / interval), 1.0)
    if np.mean(np.abs(gaps - times * interval) < _REGULAR * interval) < _USUAL:
        return None
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
        return None
    return whole, np.interp(whole, knots, levels)


@lru_cache(maxsize=64)
def _that_fit(stamps: bytes, samples: bytes) -> tuple[FloatArray, FloatArray] | None:
    """
    Return readings at regular times, fewer than the samples, that tell all of these.

    Where lines have two samples or one, their ends are not seen. But at the right interval and
    phase the readings, of which there are fewer than samples, miss none of these.
    """
    # A campaign's paths are made several times, for arms that change their speed otherwise.
    t, value = np.frombuffer(stamps).copy(), np.frombuffer(samples).copy()
    usual = float(np.median(np.diff(t)))
    # After a stamp of another day there is no room for all readings until then.
    if t.size < _WINDOW or t[-1] - t[0] > _SPARSE * usual * t.size:
        return None
    bent = np.diff(value, 2)
    # Of noise that is new in each sample two in a row are unlike, by two thirds: most records end
    # here.
    if _in_a_row(bent) < _UNLIKE:
        return None
    # Where the tool changes its speed, that is most of what readings at wrong times miss.
    apart = _WINDOW // 2
    bends = sliding_window_view(bent, _WINDOW - 2)[::apart]
    turns = np.abs(bends)
    usual_turn = np.median(turns, axis=1)
    told = usual_turn > _STRAIGHT * float(np.ptp(value))
    times = sliding_window_view(t, _WINDOW)[::apart]
    if not told.any():
        return None
    beyond = turns.max(axis=1) / usual_turn.clip(float(usual_turn[told].min()))
    calmest = int(np.argmin(np.where(told, beyond, math.inf)))
    enough = _UNTOLD * float(usual_turn[calmest])
    near = sliding_window_view(value, _WINDOW)[::apart][calmest]
    found = _interval(times[calmest], near - near.mean(), usual, enough)
    if found is None:
        return None
    middle, interval = found
    # Readings follow a smooth way, and a vibration, as well where six samples tell of five.
    if abs(_in_a_row(bends[calmest]) - _expected(interval / usual)) > _UNUSUAL:
        return None
    middle += round((0.5 * float(t[0] + t[-1]) - middle) / interval) * interval
    mean = float(value.mean())
    off = _AGAIN * interval / float(t[-1] - t[0])
    middle, interval, _ = _closer(t, value - mean, middle, interval, (_AGAIN, off))
    whole, levels = _with_lone(t, value, middle, interval)
    if not _FEWEST <= whole.size < t.size:
        return None
    within = (t > t[0] + _END * interval) & (t < t[-1] - _END * interval)
    missed = np.abs(np.interp(t[within], whole, levels) - value[within])
    return (whole, levels) if missed.max() <= _REGULAR * usual_turn[calmest] else None


def _interval(
    t: FloatArray, value: FloatArray, usual: float, enough: float
) -> tuple[float, float] | None:
    """Return a moment and an interval of readings that miss little of some samples."""
    step = 0.5 / _WINDOW
    ratios = np.exp(np.arange(math.log(_DENSEST), math.log(_SPARSE) + step, step))
    phases = np.arange(_PHASES) / _PHASES
    centre = 0.5 * float(t[0] + t[-1])
    left = _missed(t, value, centre, usual, phases, ratios - 1.0)
    # Of many readings fewer samples are left to be missed.
    left /= 1.0 - 1.0 / ratios[:, np.newaxis]
    for which in np.argsort(left.min(axis=1))[:_CHANCES]:
        interval = usual * float(ratios[which])
        middle = centre + float(phases[np.argmin(left[which])]) * interval
        middle, interval, miss = _closer(t, value, middle, interval, (1.0 / _PHASES, step))
        if miss <= enough:
            break
    else:
        return None
    # Twice as many readings miss nothing either, where the tool is read half as often.
    for times in range(_MOST_TIMES, 1, -1):
        apart = interval * times
        phases = np.arange(times) / times
        fewer = _missed(t, value, middle, apart, phases, np.zeros(1))[0]
        if math.sqrt(float(fewer.min()) / t.size) <= enough:
            return middle + float(phases[np.argmin(fewer)]) * apart, apart
    return middle, interval


def _with_lone(
    t: FloatArray, value: FloatArray, middle: float, interval: float
) -> tuple[FloatArray, FloatArray]:
    """Return readings that samples tell of, and the samples beside others."""
    start = middle - math.ceil((middle - t[0]) / interval) * interval
    level, known, beside = np.empty((3, int((t[-1] - start) / interval) + 2))
    mean = float(value.mean())
    _fit(t, value - mean, start, interval, level, known, beside)
    read = start + interval * np.arange(level.size)
    own = (read > t[0] + 0.5 * interval) & (read < t[-1] - 0.5 * interval)
    own &= _unsure(t, start, interval, level.size) < _MOST_UNSURE
    place = (t - start) / interval
    near, close = np.minimum(place.astype(np.intp), level.size - 2), np.rint(place).astype(np.intp)
    lone = ~(own[near] & own[near + 1])
    lone &= ~own[close] | (np.abs(place - close) > _REGULAR)
    lone &= (t > t[0] + _END * interval) & (t < t[-1] - _END * interval)
    lone[[0, -1]] = True
    whole = np.concatenate((read[own], t[lone]))
    levels = np.concatenate((level[own] + mean, value[lone]))
    order = np.argsort(whole)
    return whole[order], levels[order]


def _in_a_row(bent: FloatArray) -> float:
    """Return how alike two turns in a row are, without those that are no noise."""
    most = _OUTSIDE * float(np.median(np.abs(bent)))
    usual = np.clip(bent, -most, most)
    square = float(usual @ usual)
    return float(usual[1:] @ usual[:-1]) / square if square else 0.0


def _expected(ratio: float) -> float:
    """Return how alike two turns in a row are with so many samples a reading, at any phase."""
    # What samples see of a reading, by when they are: each turn is of three in a row.
    at = np.linspace(-4.0, 4.0, 801)
    before, one, two, after = (
        np.clip(1.0 - np.abs(at + later / ratio), 0.0, None) for later in range(4)
    )
    turn, following = before - 2.0 * one + two, one - 2.0 * two + after
    return float(turn @ following / (turn @ turn))


def _unsure(t: FloatArray, start: float, interval: float, count: int) -> FloatArray:
    """Return the variances of readings over those of the samples that tell of them."""
    place = (t - start) / interval
    near = np.minimum(place.astype(np.intp), count - 2)
    part = place - near
    own = np.bincount(near, (1.0 - part) ** 2, count) + np.bincount(near + 1, part**2, count)
    own += _NOTHING
    beside = np.bincount(near, part * (1.0 - part), count)
    # What is known of each together with those before it, and with those after it.
    before, after = own.tolist(), own.tolist()
    shared = (beside**2).tolist()
    for k in range(1, count):
        before[k] = max(before[k] - shared[k - 1] / before[k - 1], _NOTHING)
        after[-1 - k] = max(after[-1 - k] - shared[-1 - k] / after[-k], _NOTHING)
    return np.asarray(1.0 / np.maximum(np.add(before, after) - own, _NOTHING))


def _closer(
    t: FloatArray,
    value: FloatArray,
    middle: float,
    interval: float,
    off: tuple[float, float],
) -> tuple[float, float, float]:
    """
    Return a moment and an interval of readings near those that are known, and what they miss.

    The moment, and the interval, are off by these parts of the interval.
    """
    phase, stretch = off
    parts = np.linspace(-1.0, 1.0, _PARTS)
    while True:
        left = _missed(t, value, middle, interval, phase * parts, stretch * parts)
        best, at = np.unravel_index(int(np.argmin(left)), left.shape)
        interval *= 1.0 + stretch * float(parts[best])
        middle += phase * float(parts[at]) * interval
        if phase < _SURE:
            return middle, interval, math.sqrt(float(left[best, at]) / t.size)
        phase *= _ZOOM
        stretch *= _ZOOM


def _missed(
    t: FloatArray,
    value: FloatArray,
    middle: float,
    interval: float,
    phases: FloatArray,
    stretches: FloatArray,
) -> FloatArray:
    """Return the squares that readings miss, by how their interval is stretched, and by phase."""
    least = interval * (1.0 + float(stretches.min()))
    room = np.empty((3, int((t[-1] - t[0]) / least) + 4))
    left = np.empty((stretches.size, phases.size))
    _try(t, value, middle, interval, phases, stretches, left, room)
    return left


@kernel()
def _try(t, value, middle, interval, phases, spans, left, room):  # type: ignore[no-untyped-def]
    """Fill in the squares that are missed at each interval and phase."""
    for which in range(spans.size):
        apart = interval * (1.0 + spans[which])
        for at in range(phases.size):
            one = middle + phases[at] * apart
            first = one - math.ceil((one - t[0]) / apart) * apart
            count = int((t[-1] - first) / apart) + 2
            left[which, at] = _fit(
                t, value, first, apart, room[0, :count], room[1, :count], room[2, :count]
            )


@kernel()
def _fit(t, value, first, interval, level, known, beside):  # type: ignore[no-untyped-def]
    """Fit readings to samples on lines between them, and return the squares that are missed."""
    level[:] = 0.0
    known[:] = _NOTHING
    beside[:] = 0.0
    for k in range(t.size):
        place = (t[k] - first) / interval
        near = min(max(int(place), 0), level.size - 2)
        part = place - near
        known[near] += (1.0 - part) ** 2
        known[near + 1] += part**2
        beside[near] += part * (1.0 - part)
        level[near] += (1.0 - part) * value[k]
        level[near + 1] += part * value[k]
    for near in range(level.size - 1):
        share = beside[near] / known[near]
        known[near + 1] = max(known[near + 1] - share * beside[near], _NOTHING)
        level[near + 1] -= share * level[near]
    level[-1] /= known[-1]
    for near in range(level.size - 2, -1, -1):
        level[near] = (level[near] - beside[near] * level[near + 1]) / known[near]
    left = 0.0
    for k in range(t.size):
        place = (t[k] - first) / interval
        near = min(max(int(place), 0), level.size - 2)
        part = place - near
        left += (value[k] - (1.0 - part) * level[near] - part * level[near + 1]) ** 2
    return left
