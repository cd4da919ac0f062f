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
Noise with memory: white noise plus one or two first-order autoregressions, over blocks of samples.

An autoregression is one of continuous time (an Ornstein-Uhlenbeck process), so that rates may
differ and samples may be missing; together with the white noise, its samples are ARMA(1,1). A
second one with a long memory stands for a zero that wanders, as that of a load cell does. Means
over blocks of samples are whitened exactly, by the innovations of a Kalman filter, so that a
record may be averaged where nothing happens in it, without losing what is known of its noise.

References
----------
A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989, ch. 3
(innovations), 6 (temporal aggregation); H. D. Patterson and R. Thompson, Biometrika 58, 1971,
545-554, doi:10.1093/biomet/58.3.545 (restricted likelihood).

"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
import math
from typing import Final

from hapticvision_ros.core.fit.simplex import minimum
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

_NEAR: Final = 128
"""Blocks whose whitened rows stay near the processor while their products are added up."""
_WANDERS: Final = 3.0
"""Longest correlation time of a zero that wanders, over a record."""
_SIZES: Final = (-3.0, -1.5, 0.0)
"""Logarithms of what the wandering may be, over the rest of the noise, at a first look."""
_LOG_SIZES: Final = 5.0
_TURNS: Final = 2
_FEWEST: Final = 8
"""Samples beyond the parameters without which nothing is known of the noise."""
_SUMMED: Final = 16
"""Blocks of up to this many samples are summed; the closed form loses digits in short ones."""


@dataclass(frozen=True, slots=True)
class SensorNoise:
    """
    The noise of a sample of one sensor.

    Parameters
    ----------
    white : float
        Standard deviation of what is new in each sample.
    slow : float
        Standard deviation of the autoregression, in the same unit.
    correlation_time : float
        Of the autoregression [s].
    wander : float
        Standard deviation of the zero, which wanders, in the same unit.
    wander_time : float
        Correlation time of the zero [s].

    """

    white: float
    slow: float
    correlation_time: float
    wander: float = 0.0
    wander_time: float = math.inf

    @property
    def std(self) -> float:
        """Return the standard deviation of a sample."""
        return math.hypot(self.white, self.slow, self.wander)

    def over_long(self, interval: float) -> float:
        """Return the variance of a mean over long, times its length, but for how it wanders."""
        return self.white**2 * interval + 2.0 * self.slow**2 * self.correlation_time

    def std_of_mean(self, count: FloatArray, interval: float) -> FloatArray:
        """Return the standard deviation of means of so many samples, `interval` [s] apart."""
        variance = self.white**2 / count
        lengths, each = np.unique(count, return_inverse=True)
        for std, time in ((self.slow, self.correlation_time), (self.wander, self.wander_time)):
            if std == 0.0:
                continue
            alike = np.ones(lengths.size)
            if time < math.inf:
                for k, length in enumerate(lengths.tolist()):
                    of = np.zeros(5)
                    _of_length(length * interval, length, time, of)
                    alike[k] = of[3] + of[2] ** 2
            variance = variance + std**2 * alike[each]
        return np.sqrt(variance)

    def correlation(self, interval: float) -> float:
        """Return the correlation of two samples that are `interval` [s] apart."""
        if self.std == 0.0:
            return 0.0
        slow = self.slow**2 * math.exp(-interval / self.correlation_time)
        return (slow + self.wander**2 * math.exp(-interval / self.wander_time)) / self.std**2


@dataclass(frozen=True, slots=True)
class Blocks:
    """
    How the samples of a record are averaged.

    Parameters
    ----------
    duration : ndarray, shape (n,)
        Of each block [s], gaps included.
    count : ndarray, shape (n,)
        Samples in it; none where all were set aside.
    extra : ndarray, shape (n,)
        Variance of the block's mean that is none of the sensor's.

    """

    duration: FloatArray
    count: FloatArray
    extra: FloatArray


@kernel()
def _of_length(h, n, tau, of):  # type: ignore[no-untyped-def]
    """
    Fill what the length of a block makes of an autoregression of unit variance.

    How much of it is left at the block's end, how much of its start the mean sees, what the mean
    has beyond that, and what of this goes on to the end.
    """
    of[1] = np.exp(-h / tau)
    if n <= 0.0:
        return
    x = h / (n * tau)
    phi = np.exp(-x)
    gone = -np.expm1(-x)
    all_gone = -np.expm1(-h / tau)
    of[2] = phi * all_gone / (n * gone)
    if n <= _SUMMED:
        pairs = n
        power = 1.0
        for k in range(1, int(n)):
            power *= phi
            pairs += 2.0 * (n - k) * power
    else:
        pairs = n * (1.0 + phi) / gone - 2.0 * phi * all_gone / (gone * gone)
    of[3] = max(pairs / (n * n) - of[2] * of[2], 0.0)
    of[4] = all_gone / (n * gone) - of[2] * of[1]


@kernel()
def _largest(count):  # type: ignore[no-untyped-def]
    """Return the largest number of samples of a block."""
    # In a loop: what numba makes of count.max() loads scipy.linalg with every process.
    largest = 0.0
    for i in range(count.size):
        largest = max(largest, count[i])
    return int(largest)


@kernel()
def _filter(  # type: ignore[no-untyped-def]
    duration, count, extra, white, slow, tau, seen, passed, gain, weight, row
):
    """
    Return the determinant's logarithm, and fill the filter of each block or whiten a row at once.

    Given a row, the filter is not kept, and the squares of the whitened row come second.
    """
    at_once = row.size > 0
    state = 0.0
    squares = 0.0
    variance = slow * slow
    noise = white * white
    p = variance
    log_determinant = 0.0
    determinant = 1.0
    # What a block's length makes of it, worked out once for each number of samples.
    known = np.full((_largest(count) + 1, 5), -1.0)
    last_h = -1.0
    last_n = -1.0
    known_extra = -1.0
    a = 0.0
    b = 0.0
    s = 1.0
    g = 0.0
    w = 0.0
    own = 0.0
    joint = 0.0
    steady = False
    for i in range(duration.size):
        h = duration[i]
        n = count[i]
        # Stamps are rounded: almost the same duration has the same filter.
        if n != last_n or abs(h - last_h) > 1e-6 * h:
            last_h = h
            last_n = n
            steady = False
            of = known[int(n)]
            if abs(h - of[0]) > 1e-6 * h:
                of[0] = h
                _of_length(h, n, tau, of)
            b = of[1]
            a = of[2]
            own = variance * of[3] + (noise / n if n > 0.0 else 0.0)
            joint = variance * of[4]
        if n > 0.0:
            # Among like blocks the filter soon changes no more: it is not worked out again.
            if not steady or extra[i] != known_extra:
                known_extra = extra[i]
                s = a * a * p + own + known_extra
                c = b * a * p + joint
                w = 1.0 / np.sqrt(s)
                g = c * w * w
                after = b * b * p + variance * (1.0 - b * b) - g * c
                if after < 0.0:
                    after = 0.0
                steady = abs(after - p) <= 1e-13 * variance
                p = after
            if at_once:
                new = row[i] - a * state
                state = b * state + g * new
                squares += new * new * w * w
            else:
                seen[i] = a
                passed[i] = b
                gain[i] = g
                weight[i] = w
            determinant *= s
            # One logarithm for as many blocks as a number can hold.
            if not 1e-150 < determinant < 1e150:
                log_determinant += np.log(determinant)
                determinant = 1.0
        else:
            if at_once:
                state *= b
            else:
                seen[i] = 0.0
                passed[i] = b
                gain[i] = 0.0
                weight[i] = 0.0
            p = b * b * p + variance * (1.0 - b * b)
    return log_determinant + np.log(determinant), squares


@kernel()
def _filter_two(  # type: ignore[no-untyped-def]
    duration, count, extra, white, sizes, times, seen, passed, gain, weight
):
    """Fill the filter of each block for two autoregressions, as `_filter` does for one."""
    noise = white * white
    v0 = sizes[0] * sizes[0]
    v1 = sizes[1] * sizes[1]
    p00 = v0
    p01 = 0.0
    p11 = v1
    log_determinant = 0.0
    determinant = 1.0
    known = np.full((2, _largest(count) + 1, 5), -1.0)
    last_h = -1.0
    last_n = -1.0
    known_extra = -1.0
    a0 = 0.0
    a1 = 0.0
    b0 = 0.0
    b1 = 0.0
    own = 0.0
    joint0 = 0.0
    joint1 = 0.0
    s = 1.0
    g0 = 0.0
    g1 = 0.0
    w = 0.0
    steady = False
    for i in range(duration.size):
        h = duration[i]
        n = count[i]
        if n != last_n or abs(h - last_h) > 1e-6 * h:
            last_h = h
            last_n = n
            steady = False
            for k in range(2):
                of = known[k, int(n)]
                if abs(h - of[0]) > 1e-6 * h:
                    of[0] = h
                    _of_length(h, n, times[k], of)
            first = known[0, int(n)]
            second = known[1, int(n)]
            b0 = first[1]
            b1 = second[1]
            a0 = first[2]
            a1 = second[2]
            own = v0 * first[3] + v1 * second[3] + (noise / n if n > 0.0 else 0.0)
            joint0 = v0 * first[4]
            joint1 = v1 * second[4]
        passed[0, i] = b0
        passed[1, i] = b1
        if n > 0.0:
            if not steady or extra[i] != known_extra:
                known_extra = extra[i]
                r0 = p00 * a0 + p01 * a1
                r1 = p01 * a0 + p11 * a1
                s = a0 * r0 + a1 * r1 + own + known_extra
                c0 = b0 * r0 + joint0
                c1 = b1 * r1 + joint1
                w = 1.0 / np.sqrt(s)
                g0 = c0 * w * w
                g1 = c1 * w * w
                q00 = max(b0 * b0 * p00 + v0 * (1.0 - b0 * b0) - g0 * c0, 0.0)
                q01 = b0 * b1 * p01 - g0 * c1
                q11 = max(b1 * b1 * p11 + v1 * (1.0 - b1 * b1) - g1 * c1, 0.0)
                change = max(abs(q00 - p00), abs(q01 - p01), abs(q11 - p11))
                steady = change <= 1e-13 * (v0 + v1)
                p00 = q00
                p01 = q01
                p11 = q11
            seen[0, i] = a0
            seen[1, i] = a1
            gain[0, i] = g0
            gain[1, i] = g1
            weight[i] = w
            determinant *= s
            if not 1e-150 < determinant < 1e150:
                log_determinant += np.log(determinant)
                determinant = 1.0
        else:
            seen[:, i] = 0.0
            gain[:, i] = 0.0
            weight[i] = 0.0
            p00 = b0 * b0 * p00 + v0 * (1.0 - b0 * b0)
            p01 = b0 * b1 * p01
            p11 = b1 * b1 * p11 + v1 * (1.0 - b1 * b1)
    return log_determinant + np.log(determinant)


@kernel()
def _whiten_two(seen, passed, gain, weight, rows, out):  # type: ignore[no-untyped-def]
    """Fill the innovations of each row over their standard deviations, two states deep."""
    # Row by row each would wait for its own last state.
    count = rows.shape[0]
    a = np.zeros(count)
    b = np.zeros(count)
    for i in range(weight.size):
        for j in range(count):
            new = rows[j, i] - seen[0, i] * a[j] - seen[1, i] * b[j]
            out[j, i] = new * weight[i]
            a[j] = passed[0, i] * a[j] + gain[0, i] * new
            b[j] = passed[1, i] * b[j] + gain[1, i] * new


@kernel()
def _whiten(seen, passed, gain, weight, rows, out):  # type: ignore[no-untyped-def]
    """Fill the innovations of each row over their standard deviations."""
    # Four rows at a time: each waits for its own last state, and none for another's.
    count = rows.shape[0]
    j = 0
    while j + 4 <= count:
        a = 0.0
        b = 0.0
        c = 0.0
        d = 0.0
        for i in range(weight.size):
            carry = passed[i] - gain[i] * seen[i]
            r0 = rows[j, i]
            r1 = rows[j + 1, i]
            r2 = rows[j + 2, i]
            r3 = rows[j + 3, i]
            out[j, i] = (r0 - seen[i] * a) * weight[i]
            out[j + 1, i] = (r1 - seen[i] * b) * weight[i]
            out[j + 2, i] = (r2 - seen[i] * c) * weight[i]
            out[j + 3, i] = (r3 - seen[i] * d) * weight[i]
            a = carry * a + gain[i] * r0
            b = carry * b + gain[i] * r1
            c = carry * c + gain[i] * r2
            d = carry * d + gain[i] * r3
        j += 4
    while j < count:
        a = 0.0
        for i in range(weight.size):
            r0 = rows[j, i]
            out[j, i] = (r0 - seen[i] * a) * weight[i]
            a = (passed[i] - gain[i] * seen[i]) * a + gain[i] * r0
        j += 1


@kernel(fastmath={'reassoc', 'contract'})
def _products(seen, passed, gain, weight, rows, out):  # type: ignore[no-untyped-def]
    """Add up the products of the whitened rows, two by two."""
    count = rows.shape[0]
    state = np.zeros(count)
    # As many blocks at a time as stay near: then the products go side by side.
    white = np.empty((count, _NEAR))
    for first in range(0, weight.size, _NEAR):
        size = min(_NEAR, weight.size - first)
        for i in range(size):
            a = seen[first + i]
            g = gain[first + i]
            w = weight[first + i]
            carry = passed[first + i] - g * a
            for j in range(count):
                r = rows[j, first + i]
                white[j, i] = (r - a * state[j]) * w
                state[j] = carry * state[j] + g * r
        for j in range(count):
            for k in range(j, count):
                total = 0.0
                for i in range(size):
                    total += white[j, i] * white[k, i]
                out[j, k] += total
    for j in range(count):
        for k in range(j):
            out[j, k] = out[k, j]


@dataclass(frozen=True, slots=True)
class Whitener:
    """The filter that makes a record's noise, of one memory or two, white and of unit size."""

    seen: FloatArray
    passed: FloatArray
    gain: FloatArray
    weight: FloatArray
    log_determinant: float

    def __call__(self, rows: FloatArray) -> FloatArray:
        """Return the whitened rows, shape (k, n): residuals and derivatives of block means."""
        out = np.empty(rows.shape)
        whiten = _whiten if self.seen.ndim == 1 else _whiten_two
        whiten(self.seen, self.passed, self.gain, self.weight, rows, out)
        return out

    def products(self, rows: FloatArray) -> FloatArray:
        """Return the products of the whitened rows, shape (k, k)."""
        products = np.zeros((rows.shape[0],) * 2)
        if self.seen.ndim == 1:
            _products(self.seen, self.passed, self.gain, self.weight, rows, products)
            return products
        white = self(rows)
        return np.asarray(white @ white.T)


def whitener(blocks: Blocks, noise: SensorNoise) -> Whitener:
    """
    Return the filter for one record.

    Parameters
    ----------
    blocks : Blocks
        How the record is averaged.
    noise : SensorNoise
        The sensor's noise; not zero.

    Returns
    -------
    Whitener
        The filter, with the logarithm of the determinant of the noise's covariance.

    """
    n = blocks.count.size
    weight = np.empty(n)
    if noise.wander > 0.0:
        seen, passed, gain = np.empty((3, 2, n))
        log_determinant = _filter_two(
            blocks.duration,
            blocks.count,
            blocks.extra,
            noise.white,
            np.array([noise.slow, noise.wander]),
            np.array([noise.correlation_time, noise.wander_time]),
            seen,
            passed,
            gain,
            weight,
        )
        return Whitener(seen, passed, gain, weight, log_determinant)
    seen, passed, gain = np.empty((3, n))
    log_determinant, _ = _filtered(blocks, noise, seen, passed, gain, weight, _NOTHING)
    return Whitener(seen, passed, gain, weight, log_determinant)


def _filtered(blocks: Blocks, noise: SensorNoise, *arrays: FloatArray) -> tuple[float, float]:
    """Return what `_filter` does for a noise of one memory: see there for the arrays."""
    log_determinant, squares = _filter(
        blocks.duration,
        blocks.count,
        blocks.extra,
        noise.white,
        noise.slow,
        noise.correlation_time,
        *arrays,
    )
    return log_determinant, squares


_NOTHING: Final = np.empty(0)
_NO_FILTER: Final = (_NOTHING, _NOTHING, _NOTHING, _NOTHING)


@dataclass(frozen=True, slots=True)
class Record:
    """
    What is left of a record after a fit.

    Parameters
    ----------
    blocks : Blocks
        How it is averaged.
    residual : ndarray, shape (n,)
        Measured minus model, block by block.
    shared, own : ndarray, shapes (p, n), (q, n)
        Derivatives of the model in the parameters that all records share, and in its own.

    """

    blocks: Blocks
    residual: FloatArray
    shared: FloatArray
    own: FloatArray


class _Pile:
    """Records laid out for the likelihood of many noises, once."""

    def __init__(self, records: Sequence[Record], *, bare: bool = False) -> None:
        shared = 0 if bare else records[0].shared.shape[0]
        self.records = []
        self.samples = 0
        first = shared
        for record in records:
            last = first + (0 if bare else record.own.shape[0])
            rows = () if bare else (record.shared, record.own)
            stacked = np.vstack((*rows, record.residual[np.newaxis]))
            place = np.concatenate((np.arange(shared), np.arange(first, last)))
            self.records.append((record.blocks, stacked, place))
            self.samples += int(np.count_nonzero(record.blocks.count))
            first = last
        self.parameters = first
        self.jumps = any(bool(record.blocks.extra.any()) for record in records)


def estimate(
    records: Sequence[Record],
    start: SensorNoise,
    interval: float,
    *,
    everywhere: bool = True,
    longest: float = math.inf,
) -> SensorNoise:
    """
    Estimate the noise from the residuals of a fit, by the restricted likelihood.

    The restricted likelihood allows for what the fitted parameters have taken out of the
    residual, which without it looks quieter and less correlated than the noise is.

    Parameters
    ----------
    records : sequence of Record
        The residuals, all of one sensor.
    start : SensorNoise
        A first guess; how its zero wanders is taken for known.
    interval : float
        Usual interval between two samples [s].
    everywhere : bool
        Whether to look for all kinds of noise; otherwise the search stays near `start`.
    longest : float
        Longest correlation time that the sensor may have [s]: what a model lacks goes slowly, and
        would pass for slow noise.

    Returns
    -------
    SensorNoise
        The most likely noise; `start` where hardly more samples than parameters are there.

    """
    pile = _Pile(records)
    if pile.samples - pile.parameters < _FEWEST:
        return start
    longest = min(longest, max(float(record.blocks.duration.sum()) for record in records))
    limits = (math.log(0.3 * interval), math.log(max(longest, 10.0 * interval)))

    def cost(point: FloatArray, given: _Pile = pile) -> float:
        share, log_time = point
        if not limits[0] <= log_time <= limits[1]:
            return math.inf
        return _restricted(given, _split(share, math.exp(log_time), start))[0]

    quick = math.hypot(start.white, start.slow)
    slow, white = max(start.slow, 1e-9 * quick), max(start.white, 1e-9 * quick)
    point = np.array([2.0 * math.log(slow / white), math.log(start.correlation_time)])
    point[1] = np.clip(point[1], *limits)
    size = 0.4
    if everywhere:
        bare = _Pile(records, bare=True)
        times = np.linspace(*limits, 6)
        grid = [np.array([share, time]) for share in (-3.0, 0.0, 4.0) for time in times]
        point = min((*grid, point), key=lambda at: cost(at, bare))
        size = 1.0
    _, point = minimum(cost, point, np.full(2, size))
    relative = _split(point[0], math.exp(point[1]), start)
    level = _restricted(pile, relative)[1]
    if not pile.jumps:
        return louder(relative, level)

    # What is not known of a jump is of a size of its own, and has no level.
    def whole(point: FloatArray) -> float:
        if abs(point[0]) > _LOG_SIZES:
            return math.inf
        return _likelihood(pile, louder(relative, math.exp(point[0])))

    _, best = minimum(whole, np.array([math.log(level)]), np.array([0.1]))
    return louder(relative, math.exp(best[0]))


def louder(noise: SensorNoise, times: float) -> SensorNoise:
    """Return noise of so many times the size, but for how its zero wanders."""
    return replace(noise, white=times * noise.white, slow=times * noise.slow)


def wandering(
    records: Sequence[Record],
    noise: SensorNoise,
    interval: float,
    longest: float,
    *,
    at_least: float,
) -> SensorNoise | None:
    """
    Estimate how the zero wanders beside a noise that forgets soon.

    Parameters
    ----------
    records : sequence of Record
        Force without contact: what a model lacks would pass for a zero that wanders.
    noise : SensorNoise
        The noise of the best fit whose zero does not.
    interval : float
        Usual interval between two samples [s].
    longest : float
        Longest correlation time of the rest [s].
    at_least : float
        Fall of the deviance at a first look below which the zero is taken not to wander.

    Returns
    -------
    SensorNoise or None
        Noise with a zero that wanders.

    """
    pile = _Pile(records)
    span = max(float(record.blocks.duration.sum()) for record in records)
    limits = (math.log(longest), math.log(_WANDERS * span))

    def cost(point: FloatArray) -> float:
        if not limits[0] <= point[1] <= limits[1] or abs(point[0]) > _LOG_SIZES:
            return math.inf
        size = noise.std * math.exp(point[0])
        wanders = replace(noise, wander=size, wander_time=math.exp(point[1]))
        return _restricted(pile, wanders)[0]

    grid = [np.array([size, time]) for size in _SIZES for time in np.linspace(*limits, 3)]
    if limits[1] <= limits[0] or _restricted(pile, noise)[0] - min(map(cost, grid)) < at_least:
        return None
    for _ in range(_TURNS):
        _, point = minimum(cost, min(grid, key=cost), np.full(2, 0.7))
        size, time = noise.std * math.exp(point[0]), math.exp(point[1])
        _, level = _restricted(pile, replace(noise, wander=size, wander_time=time))
        noise = replace(noise, wander=level * size, wander_time=time)
        noise = estimate(records, noise, interval, longest=longest)
    return noise


def deviance(records: Sequence[Record], noise: SensorNoise) -> float:
    """Return minus twice the restricted log likelihood of a noise of the best level."""
    return _restricted(_Pile(records), noise)[0]


def _split(log_ratio: float, correlation_time: float, like: SensorNoise) -> SensorNoise:
    """Return noise of the size of another for the logarithm of slow over white variance."""
    share = 1.0 / (1.0 + math.exp(-min(max(log_ratio, -30.0), 30.0)))
    quick = math.hypot(like.white, like.slow)
    return replace(
        like,
        white=quick * math.sqrt(max(1.0 - share, 1e-12)),
        slow=quick * math.sqrt(share),
        correlation_time=correlation_time,
    )


def _restricted(pile: _Pile, noise: SensorNoise) -> tuple[float, float]:
    """Return minus twice the restricted log likelihood at the best level, and that level."""
    left, log_determinant, free = _squares(pile, noise)
    variance = max(left, 1e-300) / max(free, 1)
    return free * math.log(variance) + log_determinant, math.sqrt(variance)


def _likelihood(pile: _Pile, noise: SensorNoise) -> float:
    """Return minus twice the restricted log likelihood at the level that the noise has."""
    left, log_determinant, _ = _squares(pile, noise)
    return left + log_determinant


def _squares(pile: _Pile, noise: SensorNoise) -> tuple[float, float, int]:
    """Return the least whitened squares, the determinants' logarithm, and the free samples."""
    if pile.parameters == 0 and noise.wander == 0.0:
        # No filter is kept, which takes longer than it takes to whiten one row.
        total, whole = 0.0, 0.0
        for blocks, rows, _ in pile.records:
            determinant, left = _filtered(blocks, noise, *_NO_FILTER, rows[0])
            total += left
            whole += determinant
        return total, whole, pile.samples
    normal = np.zeros((pile.parameters, pile.parameters))
    gradient = np.zeros(pile.parameters)
    squares, log_determinant = 0.0, 0.0
    for blocks, rows, place in pile.records:
        filter_ = whitener(blocks, noise)
        products = filter_.products(rows)
        normal[place[:, np.newaxis], place] += products[:-1, :-1]
        gradient[place] += products[:-1, -1]
        squares += float(products[-1, -1])
        log_determinant += filter_.log_determinant
    scale = np.sqrt(np.diag(normal))
    seen = scale > 0.0
    scale = scale[seen]
    if scale.size == 0:
        return squares, log_determinant, pile.samples
    values, vectors = np.linalg.eigh(normal[np.ix_(seen, seen)] / np.outer(scale, scale))
    steep = values > 1e-9
    projected = vectors[:, steep].T @ (gradient[seen] / scale)
    # The columns' own scale belongs to the determinant as well.
    information = float(np.sum(np.log(values[steep]))) + 2.0 * float(np.sum(np.log(scale)))
    left = squares - float(projected**2 @ (1.0 / values[steep]))
    return left, log_determinant + information, pile.samples - int(np.count_nonzero(steep))
