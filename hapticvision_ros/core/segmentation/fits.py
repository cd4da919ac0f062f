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

import numpy as np

from hapticvision_ros.core.records import FloatArray

_LAGS = (1, 2, 4, 8, 16)
_P70_OF_NORMAL = 1.0364333894937898


def despike(value: FloatArray) -> FloatArray:
    """Return the running median of three [unit of `value`]: single-sample spikes are gone."""
    if value.size < 3:
        return value
    low = np.minimum(value[:-1], value[1:])
    high = np.maximum(value[:-1], value[1:])
    out = value.copy()
    out[1:-1] = np.maximum(low[:-1], np.minimum(high[:-1], value[2:]))
    return out


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
        slope = value[lag:] - value[:-lag]
        bend = slope[2 * lag :] - 2.0 * slope[lag:-lag] + slope[: -2 * lag]
        bend = np.abs(bend[:: max(1, bend.size // 4096)])
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
    gain : float
        Sum of squares that the onset explains beyond a constant, over the rest's mean
        square: large where there is an onset at all.

    """

    t: float
    baseline: float
    gain: float


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


def _sse(design: FloatArray, target: FloatArray, weight: FloatArray) -> FloatArray:
    """Return the weighted sums of squared residuals, shape (g,), of designs of shape (g, k, n)."""
    weighted = design * weight
    normal = weighted @ np.swapaxes(design, 1, 2)
    scale = np.sqrt(np.maximum(np.einsum('gkk->gk', normal), 1e-300))
    normal /= scale[:, :, None] * scale[:, None, :]
    normal += 1e-12 * np.eye(normal.shape[1])
    moment = (weighted @ target) / scale
    solution = np.linalg.solve(normal, moment[:, :, None])[:, :, 0] / scale
    residual = target - np.einsum('gk,gkn->gn', solution, design)
    return np.asarray((residual * residual) @ weight, dtype=np.float64)


def _onset_shapes(u: FloatArray, touching: FloatArray) -> tuple[FloatArray, ...]:
    """Return the pairs of columns, each (g, 2, n), of a kink, a smooth onset and a jump."""
    root = np.sqrt(u)
    kink = np.stack((u, u * u), axis=1)
    return (
        kink,
        np.stack((u * root, u * u * root), axis=1),
        np.stack((touching, u), axis=1),
    )


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

    Beyond the onset the signal goes as ``a u + b u^2`` (spring), ``a u^1.5 + b u^2.5`` (Hertz) or
    ``a + b u`` (a dashpot's jump) of the travel u since the onset; what fits best is taken, the
    first of these where they fit alike.

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
        The onset.

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
        line = np.ones((grid, 1, tb.size))
        offset = vb - np.mean(vb)
        flat = float(_sse(line[:1], offset, weight)[0])
        tables = [
            _sse(np.concatenate((line, shape), axis=1), offset, weight)
            for shape in _onset_shapes(u, touching)
        ]
        least = min(float(np.min(table)) for table in tables)
        unit = least / max(float(np.sum(weight)) - 6.0, 1.0)
        for table in tables:
            if float(np.min(table)) <= least + 3.0 * unit:
                break
        # Where the data cannot tell (a jump between two samples, a tool that does not move yet)
        # the sum of squares is level: take the middle of a jump, else the last of equals.
        equal = np.flatnonzero(table <= float(np.min(table)) * (1.0 + 1e-9) + 1e-300)
        run = equal[np.searchsorted(equal, int(np.argmin(table))) :]
        best_t, best_sse = float(np.mean(starts[run])), least
        before = tb <= best_t
        if np.any(before):
            baseline = float(np.average(vb[before], weights=weight[before]))
        step = (high - low) / (grid - 1)
        low, high = max(low, best_t - 2.0 * step), min(high, best_t + 2.0 * step)
        if high - low <= 0.0:
            break
    gain = (flat - best_sse) / max(best_sse / max(t.size - 6.0, 1.0), 1e-300)
    return Onset(best_t, baseline, gain)


def fit_stop(
    t: FloatArray,
    travel: FloatArray,
    low: float,
    high: float,
    *,
    count: int = 160,
) -> float:
    """
    Find when a tool that moved steadily has come to rest.

    The travel is a straight line, then a parabola while the tool slows down at a constant rate
    (for a time that may be zero), then constant: the stop is the end of the parabola. Reverse the
    time to find when a tool at rest starts.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of a window about the stop [s].
    travel : ndarray, shape (n,)
        Travel in the window [m].
    low, high : float
        Bounds of the stop [s].
    count : int
        About how many points the window is binned to; it stays finest about the stop.

    Returns
    -------
    float
        Time of the stop [s].

    """
    columns = travel[None, :]
    longest = max(high - float(t[0]), 0.0) * 0.7
    stops, slowing = np.linspace(low, high, 17), np.linspace(0.0, longest, 9)
    best_stop, best_slow = 0.5 * (low + high), 0.0
    ds, dd = stops[1] - stops[0], slowing[1] - slowing[0]
    for _round in range(5):
        centre = best_stop - 0.5 * best_slow
        half = 0.5 * best_slow + float(stops[-1] - stops[0])
        tb, (xb,), weight = _binned(t, columns, centre, half, count)
        stop, slow = (axis.ravel() for axis in np.meshgrid(stops, slowing, indexing='ij'))
        left = np.maximum(stop[:, None] - tb, 0.0)
        length = np.maximum(slow, 1e-12)[:, None]
        shape = np.where(left < length, left * left / (2.0 * length), left - 0.5 * length)
        total = float(np.sum(weight))
        xc = xb - float(xb @ weight) / total
        shape -= (shape @ weight)[:, None] / total
        power = np.maximum((shape * shape) @ weight, 1e-300)
        sse = float((xc * xc) @ weight) - ((shape * xc) @ weight) ** 2 / power
        best = int(np.argmin(sse))
        sharp = np.where(slow == 0.0, sse, np.inf)
        sharpest = int(np.argmin(sharp))
        # A stop within noise of a sharp one is a sharp one.
        if sharp[sharpest] <= sse[best] * (1.0 + 9.0 / max(total - 4.0, 1.0)) + 1e-300:
            best = sharpest
        best_stop, best_slow = float(stop[best]), float(slow[best])
        stops = np.clip(best_stop + np.linspace(-1.0, 1.0, 13) * ds, low, high)
        slowing = np.clip(best_slow + np.linspace(-1.0, 1.0, 9) * dd, 0.0, longest)
        slowing[0] = 0.0
        ds, dd = ds / 5.0, dd / 3.5
    return best_stop
