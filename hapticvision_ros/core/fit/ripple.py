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
What repeats along the way of a tool: ripples of gears, and vibrations while an arm moves.

Between two samples of encoders nothing tells it from a way that bends so, but all its periods
together tell its rate and its size far better than noise lets each be seen. It may repeat in time,
then only while the tool moves, or in the place of the tool, as the teeth of its gears do.

References
----------
E. J. Hannan, J. Appl. Probab. 10, 1973, 510-519, doi:10.2307/3212772 (rate of a sine in noise).

"""

from collections.abc import Sequence
from itertools import pairwise
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.fit.smooth import (
    calm,
    forth,
    Smoothed,
    smoothed,
    taken,
    usual_interval,
    vaguely,
)
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

_STEADY: Final = 0.25
"""Bandwidth of the way without a ripple, over that which follows it."""
_TREND: Final = 0.1
"""Bandwidth of what is taken for no ripple, over that which follows it."""
_RATES: Final = (0.2, 1.5)
"""Least and greatest rate of a ripple, over the bandwidth which follows it."""
_FASTEST: Final = 0.8
"""Greatest rate, over the highest that samples tell."""
_MOVES: Final = 0.05
"""Speed from which on a tool moves, over its greatest, and over its usual one."""
_EVEN: Final = 0.8
"""Speed from which on it goes evenly, over that at which it moves."""
_SETTLES: Final = 2
"""Time that it then takes to be at that speed, over that which it has taken."""
_FEWEST: Final = 16
"""Samples of a move, at least."""
_FULL: Final = 0.3
"""Speed from which on it ripples in full, over that at which it moves."""
_PERIODS: Final = 5.0
"""Periods that the longest move has at least, and one whose own ripple is told."""
_PADDED: Final = 4
"""Length of a transform, over that of the longest move."""
_FINER: Final = 8
"""Rates to either side that are tried in turn, and how much closer they are in the next."""
_TURNS: Final = 3
_MOST_RATES: Final = 128
"""Rates to either side that are tried at most."""
_RATE: Final = 3
"""Numbers as which a rate counts that is searched for: it is told by the length to the 3/2."""


class Ripple(NamedTuple):
    """
    What repeats along a way.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Moments at which it is known, and between which it is interpolated [s].
    phase : ndarray, shape (n,)
        Its phase [rad].
    cosine, sine : ndarray, shape (n,)
        Its amplitudes there [m].
    price : float
        Fall of minus twice the log likelihood from which on it is there.
    promise : float
        That fall, less the price, where the tool goes evenly and nothing else bends its way.

    """

    t: FloatArray
    phase: FloatArray
    cosine: FloatArray
    sine: FloatArray
    price: float
    promise: float

    def at(self, t: FloatArray) -> FloatArray:
        """Return it at some moments [m], shape (k,)."""
        phase = np.interp(t, self.t, self.phase)
        return np.asarray(
            np.interp(t, self.t, self.cosine) * np.cos(phase)
            + np.interp(t, self.t, self.sine) * np.sin(phase)
        )

    @property
    def rate(self) -> FloatArray:
        """Return its rate between the moments, zero where there is none [rad/s]."""
        there = np.hypot(self.cosine, self.sine)
        rate = np.abs(np.diff(self.phase)) / np.diff(self.t)
        return np.where(there[1:] + there[:-1] > 0.0, rate, 0.0)


class _Move(NamedTuple):
    """Where the tool goes evenly one way, what is nearest to that, and how full its ripple is."""

    run: slice
    near: slice
    full: FloatArray


def candidates(
    t: FloatArray, value: FloatArray, noise: float, found: Smoothed
) -> tuple[Ripple, ...]:
    """
    Return the strongest ripples: in time, in each move or through all moves, and in place.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        The samples, without ripples that are known [s, m].
    noise : float
        Standard deviation of each [m].
    found : Smoothed
        They, smoothed as far as they allow.

    Returns
    -------
    tuple of Ripple
        Empty where the samples show no part that bends, or the tool does not move for long.

    """
    interval = usual_interval(t)
    bent = found.bandwidth > 1.01 * calm(interval)
    if not bent.any():
        return ()
    bandwidth = float(np.median(found.bandwidth[bent]))
    steady = smoothed(t, value, noise, np.full(t.size, _STEADY * bandwidth))
    highest = min(_RATES[1] * bandwidth, _FASTEST * math.pi / interval)
    lowest = _RATES[0] * bandwidth
    moves = _moves(steady.speed)
    if not moves or highest <= lowest:
        return ()
    rows = [_innovations(t[m.run], value[m.run], noise, _TREND * bandwidth) for m in moves]
    speed = float(np.median(np.abs(np.concatenate([steady.speed[m.run] for m in moves]))))
    ripples = []
    for along, unit, in_time, apart in (
        (t, 1.0, True, True),
        (t, 1.0, True, False),
        (steady.state, 1.0 / speed, False, False),
    ):
        search = _Search(along, moves, rows, in_time, apart)
        rate = search.rate(lowest * unit, highest * unit)
        # In one move alone the phase tells nothing of the next.
        if rate is None or (in_time and not apart and search.told(rate) < 2):
            continue
        pairs, gain = search.amplitudes(rate)
        if in_time:
            cosine, sine = np.zeros((2, t.size))
            for move, (a, b) in zip(moves, np.broadcast_to(pairs, (len(moves), 2)), strict=True):
                cosine[move.near], sine[move.near] = a * move.full, b * move.full
        else:
            cosine, sine = np.outer(pairs[0], np.ones(t.size))
        count = 2 * np.count_nonzero(pairs.any(axis=1)) + _RATE
        price = count * math.log(t.size)
        ripples.append(Ripple(t, rate * along, cosine, sine, price, gain - price))
    return tuple(ripples)


def _moves(speed: FloatArray) -> list[_Move]:
    """Return the moves of a tool."""
    size = np.abs(speed)
    way = np.where(size > _MOVES * float(size.max()), np.sign(speed), 0.0)
    edges = np.flatnonzero(np.diff(way)) + 1
    runs = [
        slice(int(first), int(last))
        for first, last in zip((0, *edges), (*edges, way.size), strict=True)
        if way[first] != 0.0
    ]
    # What a tool does in between belongs to the nearest.
    middles = [(a.stop + b.start) // 2 for a, b in pairwise(runs)]
    moves = []
    for run, first, last in zip(runs, (0, *middles), (*middles, way.size), strict=True):
        usual = float(np.median(size[run]))
        # Where it swings back after a stop nothing of the move goes on.
        going = np.maximum(speed[first:last] * way[run.start], 0.0) / usual
        full = np.clip((going - _MOVES) / (_FULL - _MOVES), 0.0, 1.0)
        even = np.flatnonzero(size[run] > _EVEN * usual)
        # It comes near its speed slowly, and leaves it at once.
        begin = run.start + (1 + _SETTLES) * int(even[0])
        end = 2 * (run.start + int(even[-1]) + 1) - run.stop
        if end - begin > _FEWEST:
            moves.append(_Move(slice(begin, end), slice(first, last), full))
    return moves


class _Innovations(NamedTuple):
    """A filter that takes a trend away, and what it leaves of samples, over the noise."""

    t: FloatArray
    gains: FloatArray
    left: FloatArray


def _innovations(t: FloatArray, value: FloatArray, noise: float, bandwidth: float) -> _Innovations:
    """Return it for the samples of a move."""
    interval = usual_interval(t)
    gains = np.empty((t.size, 4))
    intensity = noise**2 * interval * bandwidth**6
    _gains(t, noise**2, vaguely(value, interval), intensity, gains)
    left = np.empty(t.size)
    _filtered(t, gains, value - value[0], left)
    return _Innovations(t, gains, left)


class _Search(NamedTuple):
    """Along what a ripple repeats, (n,), if it rests with the tool, and if moves are apart."""

    along: FloatArray
    moves: Sequence[_Move]
    rows: Sequence[_Innovations]
    in_time: bool
    apart: bool

    def rate(self, lowest: float, highest: float) -> float | None:
        """Return the rate of the strongest, or None where no move is long enough."""
        places = [self.along[move.run] for move in self.moves]
        spans = np.array([np.ptp(place) for place in places])
        counts = np.array([place.size for place in places])
        step, longest = float(np.min(spans / (counts - 1))), float(spans.max())
        size = _PADDED * (int(longest / step) + 1)
        power = np.zeros(size // 2 + 1)
        for place, row in zip(places, self.rows, strict=True):
            order = np.argsort(place, kind='stable')
            even = np.arange(float(place.min()), float(place.max()), step)
            left = np.interp(even, place[order], row.left[order]) * np.hanning(even.size)
            power += np.abs(np.fft.rfft(left, size)) ** 2
        rates = 2.0 * math.pi * np.arange(power.size) / (size * step)
        power[(rates < max(lowest, 2.0 * math.pi * _PERIODS / longest)) | (rates > highest)] = 0.0
        if not power.any():
            return None
        rate, width = float(rates[np.argmax(power)]), 2.0 * math.pi / longest
        # A phase that goes on from move to move tells the rate as closely as all of them span.
        span = longest if self.apart else float(np.ptp(np.concatenate(places)))
        count = min(_FINER * math.ceil(span / longest), _MOST_RATES)
        for _ in range(_TURNS):
            tried = rate + width * np.linspace(-1.0, 1.0, 2 * count + 1)
            rate = float(max(tried, key=lambda each: self.amplitudes(each)[1]))
            width, count = width / count, _FINER
        return rate

    def told(self, rate: float) -> int:
        """Return how many moves tell it."""
        return sum(self._is_told(rate * self.along[move.run]) for move in self.moves)

    def _is_told(self, phase: FloatArray) -> bool:
        return float(np.ptp(phase)) >= 2.0 * math.pi * _PERIODS

    def amplitudes(self, rate: float) -> tuple[FloatArray, float]:
        """Return the amplitudes in each move, or in all, (k, 2) [m], and the fall of squares."""
        products = np.zeros((len(self.moves), 3, 3))
        for place, (move, row) in enumerate(zip(self.moves, self.rows, strict=True)):
            phase = rate * self.along[move.run]
            if not self._is_told(phase):
                continue
            run, near = move.run, move.near
            inside = slice(run.start - near.start, run.stop - near.start)
            full = move.full[inside] if self.in_time else 1.0
            rows = np.empty((3, phase.size))
            _filtered(row.t, row.gains, full * np.cos(phase), rows[0])
            _filtered(row.t, row.gains, full * np.sin(phase), rows[1])
            rows[2] = row.left
            products[place] = rows @ rows.T
        if not self.apart:
            products = products.sum(axis=0, keepdims=True)
        pairs = [np.linalg.lstsq(p[:2, :2], p[:2, 2], rcond=None)[0] for p in products]
        return np.array(pairs), float(np.sum(pairs * products[:, :2, 2]))


@kernel(error_model='numpy')
def _gains(t, variance, vague, intensity, gains):  # type: ignore[no-untyped-def]
    """Set, for each sample, how much of what is new goes into the state, and one over its size."""
    m = np.zeros(3)
    p = np.zeros(6)
    p[0], p[3], p[5] = vague[0], vague[1], vague[2]
    for i in range(t.size):
        if i > 0:
            forth(t[i] - t[i - 1], intensity, m, p)
        s = p[0] + variance
        gains[i, 0], gains[i, 1], gains[i, 2] = p[0] / s, p[1] / s, p[2] / s
        gains[i, 3] = 1.0 / np.sqrt(s)
        taken(0.0, variance, m, p)


@kernel(error_model='numpy')
def _filtered(t, gains, value, left):  # type: ignore[no-untyped-def]
    """Set what is new in each sample, over its standard deviation."""
    x = v = a = 0.0
    for i in range(t.size):
        if i > 0:
            h = t[i] - t[i - 1]
            x += h * v + 0.5 * h * h * a
            v += h * a
        new = value[i] - x
        left[i] = new * gains[i, 3]
        x += gains[i, 0] * new
        v += gains[i, 1] * new
        a += gains[i, 2] * new
