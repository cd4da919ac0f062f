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

"""Least-squares fits of the kinks that bound the phases, finer than a sample."""

from dataclasses import dataclass

from hapticvision_ros.core.records import FloatArray
import numpy as np

_LAGS = (1, 2, 4, 8, 16)
# What a shape with a second term must gain over one without [noise variances].
_COSTS = (0.0, 0.0, 8.0, 8.0, 8.0)
_JUMP = 4
"""Which of the shapes jumps."""
_GUARD = 3
"""Samples before an onset that may already hold some of the rise."""
_P50_OF_NORMAL = 0.6744897501960817
_P70_OF_NORMAL = 1.0364333894937898
_SHOW = 4
"""Samples that it takes to see that a tool slows down."""
_FEWEST_TOLD = 8
_BLURRED = 4.0
"""Variance of a moving tool's samples over that at rest, from which on stamps are uncertain."""
_MOST_BLURRED = 1e4


def despike(value: FloatArray) -> FloatArray:
    """Return the running median of three [unit of `value`]: single-sample spikes are gone."""
    if value.size < 3:
        return value
    low = np.minimum(value[:-1], value[1:])
    high = np.maximum(value[:-1], value[1:])
    middle = high[:-1]
    np.minimum(middle, value[2:], out=middle)
    np.maximum(middle, low[:-1], out=middle)
    return np.concatenate((value[:1], middle, value[-1:]))


def level(value: FloatArray) -> float:
    """Return the median of `value`, of a thousand samples spread over it where it is long."""
    return float(np.median(value[:: max(1, value.size // 1000)]))


def noise_std(value: FloatArray) -> float:
    """
    Estimate the standard deviation of the noise on a piecewise smooth signal.

    Third differences at several lags are blind to a parabola; the largest of their scales holds
    for correlated noise, whose neighbours differ little.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Evenly sampled signal.

    Returns
    -------
    float
        Standard deviation [unit of `value`]; 0 where there are too few samples to tell.

    """
    worst = 0.0
    for lag in _LAGS:
        if value.size < max(5, 100 * (lag - 1)):
            break
        thin = max(1, value.size // 2048)
        count = (value.size - 3 * lag + thin - 1) // thin
        at = thin * np.arange(count)
        bend = value[at + 3 * lag] - value[at] + 3.0 * (value[at + lag] - value[at + 2 * lag])
        bend = np.abs(bend)
        rank = int(0.7 * (bend.size - 1))
        scale = float(np.partition(bend, rank)[rank]) / (_P70_OF_NORMAL * np.sqrt(20.0))
        worst = max(worst, scale)
    return worst


@dataclass(frozen=True, slots=True)
class Onset:
    """
    Where a signal leaves its baseline.

    Parameters
    ----------
    t : float
        Time of the onset [s].
    baseline : float
        Baseline at the onset [unit of the signal].
    rest : float
        Sum of squares that the onset leaves unexplained [square of the unit].

    """

    t: float
    baseline: float
    rest: float


def _binned(
    t: FloatArray, columns: FloatArray, centre: float, half: float, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return means in bins, single samples near `centre`: times, `columns` (rows), bin sizes."""
    n = t.size
    if n <= count:
        return t, columns, np.ones(n)
    first, last = np.searchsorted(t, (centre - half, centre + half))
    inner_step = max(1, int(last - first) // (count // 2))
    outer_step = max(1, (n - int(last - first)) // (count // 2))
    starts = np.concatenate(
        (
            np.arange(0, first, outer_step),
            np.arange(first, last, inner_step),
            np.arange(last, n, outer_step),
        )
    )
    size = np.diff(np.append(starts, n)).astype(np.float64)
    return (
        np.add.reduceat(t, starts) / size,
        np.add.reduceat(columns, starts, axis=1) / size,
        size,
    )


def _explained(
    p: FloatArray, q: FloatArray, target: FloatArray, weight: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the sums of squares, shape (g,), that a constant and `p`, or `p` and `q`, fit."""
    total = float(np.sum(weight))
    p = p - (p @ weight)[:, None] / total
    q = q - (q @ weight)[:, None] / total
    wp = p * weight
    wy = target * weight
    pp, pq = np.einsum('gn,gn->g', wp, p), np.einsum('gn,gn->g', wp, q)
    qq = np.einsum('gn,gn->g', q * weight, q)
    py, qy = p @ wy, q @ wy
    one = py * py / np.maximum(pp, 1e-300)
    # The second column counts for what the first does not hold, if that is more than rounding.
    rest = qq - pq * pq / np.maximum(pp, 1e-300)
    second = qy - pq * py / np.maximum(pp, 1e-300)
    extra = np.where(rest > 1e-10 * qq, second * second / np.maximum(rest, 1e-300), 0.0)
    return one, one + extra


def _between(t: FloatArray, moment: float) -> float:
    """Return the middle of the two samples beside a moment."""
    after = min(max(int(np.searchsorted(t, moment, side='right')), 1), t.size - 1)
    return 0.5 * float(t[after - 1] + t[after])


def fit_onset(
    t: FloatArray,
    value: FloatArray,
    travel: FloatArray,
    low: float,
    high: float,
    *,
    count: int = 160,
    grid: int = 21,
) -> Onset:
    """
    Find where a signal leaves its level baseline as the tool travels on.

    Beyond the onset the signal goes as ``a u + b u^2`` (spring), ``a u^1.5 + b u^2.5`` (Hertz), as
    the first term of either, or as ``a + b u`` (a dashpot's jump) of the travel u since the onset.
    What fits best is taken; a second term has to earn its keep.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the window [s].
    value : ndarray, shape (n,)
        The signal, rising or falling.
    travel : ndarray, shape (n,)
        Travel [m] at `t`, or any other coordinate in which the signal is smooth.
    low, high : float
        Bounds of the onset [s].
    count : int
        About how many points the window is binned to; it stays finest about the onset.
    grid : int
        Onsets tried in each of the rounds.

    Returns
    -------
    Onset
        The onset; of a jump half way between the two samples beside it.

    """
    columns = np.stack((value, travel))
    flat = 0.0
    best_t, best_sse, baseline = low, np.inf, float(value[0])
    step = (high - low) / (grid - 1)
    for _round in range(4):
        centre, half = 0.5 * (low + high), 0.5 * (high - low)
        tb, (vb, xb), weight = _binned(t, columns, centre, half + step, count)
        reach = max(float(np.max(xb) - np.min(xb)), 1e-300)
        starts = np.linspace(low, high, grid)
        u = np.maximum(xb - np.interp(starts, tb, xb)[:, None], 0.0) / reach
        touching = (tb > starts[:, None]).astype(np.float64)
        u *= touching
        offset = vb - float(vb @ weight) / float(np.sum(weight))
        flat = float((offset * offset) @ weight)
        square, root = u * u, np.sqrt(u)
        linear, spring = _explained(u, square, offset, weight)
        toe, hertz = _explained(u * root, square * root, offset, weight)
        _, dashpot = _explained(touching, u, offset, weight)
        tables = [np.maximum(flat - e, 0.0) for e in (linear, toe, spring, hertz, dashpot)]
        least = min(float(np.min(table)) for table in tables)
        unit = least / max(float(np.sum(weight)) - 6.0, 1.0)
        costs = [float(np.min(table)) + p * unit for table, p in zip(tables, _COSTS, strict=True)]
        shape = int(np.argmin(costs))
        table = tables[shape]
        # Where the data cannot tell (a jump between two samples, a tool that does not move yet)
        # the sum of squares is level.
        equal = np.flatnonzero(table <= float(np.min(table)) * (1.0 + 1e-9) + 1e-300)
        run = equal[equal >= int(np.argmin(table))]
        best_t, best_sse = float(np.mean(starts[run])), least
        # The onset is known to about a sample, and a dashpot's jump is far above the noise: the
        # last samples before it stay out of the baseline where there are others.
        before = int(np.searchsorted(tb, best_t, side='right'))
        if before:
            quiet = slice(0, max(before - _GUARD, min(before, _GUARD)))
            baseline = float(np.average(vb[quiet], weights=weight[quiet]))
        step = (high - low) / (grid - 1)
        low, high = max(low, best_t - 2.0 * step), min(high, best_t + 2.0 * step)
        if high - low <= 0.0:
            break
    if shape == _JUMP:
        # Nothing tells where between two samples it is, and rounding shall not.
        best_t = _between(t, best_t)
    return Onset(best_t, baseline, best_sse)


def fit_from_start(value: FloatArray, travel: FloatArray) -> float:
    """
    Return what is left unexplained if the signal rises from its first sample on.

    The least sum of squared residuals of ``c + a u^p + b u^q`` of the travel u, over smooth rises
    that are convex (a toe) or concave: to be held against that of `fit_onset`.

    Parameters
    ----------
    value : ndarray, shape (n,)
        The signal.
    travel : ndarray, shape (n,)
        Travel since the first sample.

    Returns
    -------
    float
        Sum of squares [square of the unit of `value`].

    """
    u = np.maximum(travel, 0.0) / max(float(np.max(travel)), 1e-300)
    first = np.stack((u, u, u, u * u))
    second = np.stack((u * u, u**3, np.sqrt(u), u**4))
    offset = value - np.mean(value)
    weight = np.ones_like(u)
    explained = float(np.max(_explained(first, second, offset, weight)[1]))
    return max(float(offset @ offset) - explained, 0.0)


def fit_stop(
    t: FloatArray,
    travel: FloatArray,
    low: float,
    high: float,
    *,
    backwards: bool = False,
    count: int = 130,
) -> float:
    """
    Find when a tool that moved steadily has come to rest.

    The travel is a straight line, then a parabola while the tool slows down at a constant rate
    (for a time that may be zero), then constant: the stop is the end of the parabola. Reverse the
    time to find when a tool at rest starts. Samples that were stamped late scatter by their speed
    times the delay, so that the last bit of the way tells the stop best: it gets the weight.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of a window about the stop [s].
    travel : ndarray, shape (n,)
        Travel in the window [m].
    low, high : float
        Bounds of the stop [s].
    backwards : bool
        Whether time is reversed, so that a late sample shows what is yet to come.
    count : int
        About how many points the window is binned to; it stays finest about the stop.

    Returns
    -------
    float
        Time of the stop [s].

    """
    corner, slow = _search_stop(t, travel, low, high, count)
    scatter = _scatter(t, travel, corner, slow)
    if scatter is not None:
        corner, slow = _search_again(t, travel, corner, low, high, count, scatter, backwards)
    return corner + 0.5 * slow


def _pace(t: FloatArray, corner: FloatArray, slow: FloatArray) -> FloatArray:
    """Return the speed of a tool that stops, as a share of its full one."""
    return np.clip((corner + 0.5 * slow - t) / np.maximum(slow, 1e-12), 0.0, 1.0)


def _way(t: FloatArray, corner: FloatArray, slow: FloatArray) -> FloatArray:
    """Return the way that is left at unit speed: a straight line, a parabola, then none."""
    left = np.maximum(corner + 0.5 * slow - t, 0.0)
    curve = left * left / (2.0 * np.maximum(slow, 1e-300))
    return np.where(left < slow, curve, left - 0.5 * slow)


def _scatter(
    t: FloatArray, travel: FloatArray, corner: float, slow: float
) -> tuple[float, float] | None:
    """Return the variances at rest and at full speed [m^2], if the stamps make them differ."""
    at, length = np.array(corner), np.array(slow)
    pace = _pace(t, at, length)
    moves, rests = pace == 1.0, pace == 0.0
    if min(np.count_nonzero(moves), np.count_nonzero(rests)) < _FEWEST_TOLD:
        return None
    line = _way(t[moves], at, length)
    line -= np.mean(line)
    off = travel[moves] - np.mean(travel[moves])
    off -= (float(off @ line) / max(float(line @ line), 1e-300)) * line
    steps = np.abs(np.diff(travel))
    steps = steps[steps > 0.0]
    # What the encoders' step hides of the scatter at rest.
    hidden = float(np.min(steps)) ** 2 / 12.0 if steps.size else 0.0
    # Medians, since the first path may be wrong by what it takes for rest.
    still = np.abs(travel[rests] - np.median(travel[rests]))
    moving = float(np.median(np.abs(off))) ** 2 / _P50_OF_NORMAL**2
    resting = float(np.median(still)) ** 2 / _P50_OF_NORMAL**2 + hidden
    resting = max(resting, moving / _MOST_BLURRED)
    return (resting, moving) if moving > _BLURRED * resting else None


def _misfit(
    t: FloatArray,
    travel: FloatArray,
    weight: FloatArray,
    corner: FloatArray,
    slow: FloatArray,
    high: float,
) -> FloatArray:
    """Return the sum of squares that each path, shape (g, 1), leaves; infinite if it is none."""
    total = float(np.sum(weight))
    off = travel - float(travel @ weight) / total
    shape = _way(t, corner, slow)
    shape -= (shape @ weight)[:, None] / total
    power = np.maximum(np.einsum('gn,gn->g', shape * weight, shape), 1e-300)
    sse = np.maximum(float((off * off) @ weight) - (shape @ (off * weight)) ** 2 / power, 0.0)
    # A parabola that no sample shows, or that reaches beyond the bounds of the stop, is none.
    start, stop = (corner - 0.5 * slow)[:, 0], (corner + 0.5 * slow)[:, 0]
    shown = np.searchsorted(t, stop) - np.searchsorted(t, start)
    sse[(stop > high + 1e-12) | ((slow[:, 0] > 0.0) & (shown < _SHOW))] = np.inf
    return np.asarray(sse)


def _search_stop(
    t: FloatArray, travel: FloatArray, low: float, high: float, count: int
) -> tuple[float, float]:
    """Return the corner of line and rest, and how long the tool slows down about it [s]."""
    columns = travel[None, :]
    longest = max(high - float(t[0]), 0.0)
    # The corner of line and rest is told well, the slowing about it less so: search in these.
    corners, slowing = np.linspace(low, high, 65), np.zeros(1)
    dc, dd = 2.0 * (corners[1] - corners[0]), 0.5 * longest
    corner = slow = 0.0
    spacing = float(t[-1] - t[0]) / (t.size - 1)
    for _round in range(10):
        centre, half = 0.5 * (corners[0] + corners[-1]), 0.5 * (slowing[-1] + 4.0 * dc)
        tb, (xb,), weight = _binned(t, columns, centre, half, count)
        at, length = (axis.ravel()[:, None] for axis in np.meshgrid(corners, slowing))
        sse = _misfit(tb, xb, weight, at, length, high)
        best = int(np.argmin(sse))
        sharp = np.where(length[:, 0] == 0.0, sse, np.inf)
        sharpest = int(np.argmin(sharp))
        # What is sharp within the noise is sharp.
        if sharp[sharpest] <= sse[best] * (1.0 + 9.0 / max(t.size - 4.0, 1.0)) + 1e-300:
            best = sharpest
        corner, slow = float(at[best, 0]), float(length[best, 0])
        corners = np.clip(corner + np.linspace(-1.0, 1.0, 9) * dc, low, high)
        slowing = np.clip(slow + np.linspace(-1.0, 1.0, 8) * dd, 0.0, longest)
        slowing[0] = 0.0
        dc, dd = dc / 3.0, dd / 3.0
        if dc < 0.01 * spacing:
            break
    return corner, slow


def _unlikely(
    t: FloatArray,
    travel: FloatArray,
    blur: FloatArray,
    size: FloatArray,
    corner: FloatArray,
    slow: FloatArray,
    scatter: tuple[float, float],
    delay: FloatArray,
) -> FloatArray:
    """
    Return minus twice the log-likelihood of each path, shape (g, 1), but for a constant.

    A sample scatters by the speed that the tool had when it may have been taken, `delay` before
    its stamp [s], and by `blur`, how old it may be beside the others.
    """
    resting, moving = scatter
    pace = _pace(t - delay, corner, slow) * blur
    variance = resting + (moving - resting) * pace**2
    weight = size / variance
    total = np.sum(weight, axis=1)
    shape = _way(t, corner, slow)
    shape -= (np.einsum('gn,gn->g', shape, weight) / total)[:, None]
    off = travel - ((weight @ travel) / total)[:, None]
    power = np.maximum(np.einsum('gn,gn,gn->g', weight, shape, shape), 1e-300)
    along = np.einsum('gn,gn,gn->g', weight, shape, off)
    sse = np.einsum('gn,gn,gn->g', weight, off, off) - along**2 / power
    return np.asarray(sse + np.log(variance) @ size)


def _search_again(
    t: FloatArray,
    travel: FloatArray,
    corner: float,
    low: float,
    high: float,
    count: int,
    scatter: tuple[float, float],
    backwards: bool,
) -> tuple[float, float]:
    """
    Return corner and slowing [s] where stamps are uncertain, near a corner that is known.

    The samples at the lowest speeds tell the stop far better than all others tell the rest, so
    that the search goes by the stop. A sample may be as old as the gap before it is long.
    """
    gap = np.diff(t)
    spacing, usual = float(np.mean(gap)), float(np.median(gap))
    age = np.concatenate((gap, gap[-1:]) if backwards else (gap[:1], gap))
    delay = np.zeros_like(t) if backwards else age
    columns = np.stack((travel, np.maximum(age / usual, 1.0), delay))
    longest = max(high - float(t[0]), 2.0 * spacing)
    reach = 0.1 * longest
    corners = corner + np.linspace(-reach, reach, 25)
    lengths = np.concatenate(([0.0], np.geomspace(spacing, longest, 24)))
    at, length = (axis.ravel()[:, None] for axis in np.meshgrid(corners, lengths))
    step, factor, half = reach / 12.0, (longest / spacing) ** (1.0 / 23.0), longest
    while True:
        tb, (xb, blur, delay), size = _binned(t, columns, corner, half, count)
        at = np.clip(at, low, high)
        score = _unlikely(tb, xb, blur, size, at, length, scatter, delay)
        score[(at + 0.5 * length)[:, 0] > high + 1e-12] = np.inf
        best = int(np.argmin(score))
        corner, slow = float(at[best, 0]), float(length[best, 0])
        if step < 0.01 * spacing:
            return corner, slow
        stops = corner + 0.5 * slow + np.linspace(-step, step, 9)
        lengths = slow * factor ** np.linspace(-1.0, 1.0, 9)
        ends, length = (axis.ravel()[:, None] for axis in np.meshgrid(stops, lengths))
        at, half = ends - 0.5 * length, slow + 4.0 * step
        step, factor = 0.5 * step, factor**0.6
