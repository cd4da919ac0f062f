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
Samples of a tool's place, as smooth as each part of them allows.

The jerk is white noise, whose size each part of the record tells by its likelihood. A tool at rest
is smoothed over long, and one that stops only as far as it may.

References
----------
H. E. Rauch, F. Tung, and C. T. Striebel, AIAA J. 3, 1965, 1445-1450, doi:10.2514/3.3166
(smoother).
G. Wahba, J. R. Stat. Soc. B 40, 1978, 364-372, doi:10.1111/j.2517-6161.1978.tb01050.x (splines as
smoothed random walks).

"""

from typing import Final, NamedTuple

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

_SPAN: Final = 0.3
"""A part of the record that is looked at by itself [s]."""
_FEWEST: Final = 32
"""Samples of such a part, at least."""
_STILL: Final = 0.5
"""Bandwidth of a part that shows no jerk, over one over its length [rad]."""
_STEP: Final = 1.5
"""Ratio of the bandwidths that are tried."""
_FURTHER: Final = 5
"""Those beyond one over the interval, that are tried where this is the best of the others."""
_LONGER: Final = 4
"""Ratio of the lengths of parts that are looked at in turn."""
_SHOWN: Final = 3.0
"""Rise of the log likelihood from which on a part shows a jerk."""
_VAGUE: Final = 10.0
"""What is known before the first sample, over what the record spans."""
_SIDE_BY_SIDE: Final = 8
"""Bandwidths that are tried at once, or a multiple of it."""
_FACTORS: Final = 8
"""Samples of whose likelihoods the product is far from what is taken for zero."""


class Smoothed(NamedTuple):
    """
    Samples, smoothed.

    Parameters
    ----------
    state, speed : ndarray, shape (n,)
        Place and speed at the samples [m, m/s].
    bandwidth : ndarray, shape (n,)
        Up to where the place is followed there [rad/s].
    misfit : float
        Minus twice the log likelihood of the samples, but for a constant.

    """

    state: FloatArray
    speed: FloatArray
    bandwidth: FloatArray
    misfit: float


def usual_interval(t: FloatArray) -> float:
    """Return the interval between two samples, of which some may come in bundles [s]."""
    return float(np.quantile(np.diff(t), 0.75))


def calm(interval: float) -> float:
    """Return the bandwidth of a short part that shows no jerk [rad/s]."""
    return _STILL / (_part(interval) * interval)


def _part(interval: float) -> int:
    return max(_FEWEST, round(_SPAN / interval))


def adapted(
    t: FloatArray, value: FloatArray, noise: float, alike: FloatArray | None = None
) -> Smoothed:
    """
    Smooth samples as far as each part of them allows.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        The samples [s, m].
    noise : float
        Standard deviation of each [m].
    alike : ndarray, shape (n,), optional
        Of how many samples each is one that err as one; one by default.

    Returns
    -------
    Smoothed
        They, smoothed.

    """
    interval = usual_interval(t)
    vague = vaguely(value, interval)
    unit = noise * noise * interval
    variance = _variance(t, noise, alike)
    many = _part(interval)
    bandwidth = np.full(t.size, calm(interval))
    while True:
        # What bends slowly is seen over long only, beside what short parts have shown by then.
        many = min(many, t.size)
        still = _STILL / (many * interval)
        least = bandwidth.copy()
        widths = np.geomspace(still, 1.0 / interval, _tries(still * interval))
        wider = widths[-1] * _STEP ** np.arange(_FURTHER + 1)
        for first in range(0, max(t.size - many // 2, 1), max(many // 2, 1)):
            part = slice(first, min(first + many, t.size))
            known = t[part], value[part], variance[part]
            best = _widest(*known, vague, unit, least[part], widths)
            if best == 0:
                continue
            wide = widths[best]
            if best == widths.size - 1:
                # Between samples that are nearly exact the jerk counts.
                wide = wider[_widest(*known, vague, unit, least[part], wider)]
            bandwidth[part] = np.maximum(bandwidth[part], wide)
        if many == t.size:
            break
        many *= _LONGER
    return smoothed(t, value, noise, bandwidth, alike)


def _variance(t: FloatArray, noise: float, alike: FloatArray | None) -> FloatArray:
    """Return the variance of each sample, so that those that err as one tell as much as one."""
    return noise**2 * (np.ones(t.size) if alike is None else alike)


def smoothed(
    t: FloatArray,
    value: FloatArray,
    noise: float,
    bandwidth: FloatArray,
    alike: FloatArray | None = None,
) -> Smoothed:
    """Smooth samples, as of `adapted`, up to a bandwidth at each [rad/s], shapes (n,)."""
    interval = usual_interval(t)
    intensity = noise**2 * interval * np.minimum(bandwidth[1:], bandwidth[:-1]) ** 6
    state, speed = np.empty(t.size), np.empty(t.size)
    vague = vaguely(value, interval)
    misfit = _through(t, value, _variance(t, noise, alike), vague, intensity, state, speed)
    return Smoothed(state, speed, bandwidth, misfit)


def vaguely(value: FloatArray, interval: float) -> FloatArray:
    """Return the variances of place, speed and acceleration before the first sample."""
    spans = _VAGUE * float(np.ptp(value))
    return np.array([spans, spans / (8.0 * interval), spans / (8.0 * interval) ** 2]) ** 2


def _tries(ratio: float) -> int:
    """Return how many bandwidths there are from the least, over the most, on."""
    return max(2, int(np.ceil(-np.log(ratio) / np.log(_STEP))))


def _widest(
    t: FloatArray,
    value: FloatArray,
    variance: FloatArray,
    vague: FloatArray,
    unit: float,
    least: FloatArray,
    widths: FloatArray,
) -> int:
    """Return the place of the most likely bandwidth, at `least`; the first where none is shown."""
    misfits = np.empty(widths.size)
    _try(t, value, variance, vague, unit, least, widths, misfits)
    best = int(np.argmin(misfits))
    return best if misfits[best] < misfits[0] - 2.0 * _SHOWN else 0


@kernel(error_model='numpy')
def forth(h, q, m, p):  # type: ignore[no-untyped-def]
    """Take mean and covariance (xx, xv, xa, vv, va, aa) over a step with a white jerk."""
    h2 = h * h
    h3 = h2 * h
    m[0] += h * m[1] + 0.5 * h2 * m[2]
    m[1] += h * m[2]
    xx, xv, xa, vv, va, aa = p[0], p[1], p[2], p[3], p[4], p[5]
    p[0] = xx + 2.0 * h * xv + h2 * (vv + xa) + h3 * va + 0.25 * h2 * h2 * aa
    p[0] += q * h2 * h3 / 20.0
    p[1] = xv + h * (vv + xa) + 1.5 * h2 * va + 0.5 * h3 * aa + q * h2 * h2 / 8.0
    p[2] = xa + h * va + 0.5 * h2 * aa + q * h3 / 6.0
    p[3] = vv + 2.0 * h * va + h2 * aa + q * h3 / 3.0
    p[4] = va + h * aa + q * h2 / 2.0
    p[5] = aa + q * h


@kernel(error_model='numpy')
def taken(value, variance, m, p):  # type: ignore[no-untyped-def]
    """Take a sample into mean and covariance; return minus twice its log likelihood."""
    s = p[0] + variance
    miss = value - m[0]
    certainty = 1.0 / s
    left = variance * certainty
    x, v, a = p[0] * certainty, p[1] * certainty, p[2] * certainty
    m[0] += x * miss
    m[1] += v * miss
    m[2] += a * miss
    p[5] -= a * p[2]
    p[4] -= a * p[1]
    p[3] -= v * p[1]
    p[2] *= left
    p[1] *= left
    p[0] *= left
    return miss * miss * certainty - np.log(left)


@kernel(error_model='numpy')
def _try(t, value, variance, vague, unit, least, widths, misfits):  # type: ignore[no-untyped-def]
    """Set the misfit of some samples for each bandwidth, or `least` where that is more."""
    # As `forth` and `taken` do, for all bandwidths side by side: each sample waits for the one
    # before it, and a processor does several at once of what does not wait. A whole number of
    # registers of it.
    n = _SIDE_BY_SIDE * ((widths.size - 1) // _SIDE_BY_SIDE + 1)
    strength = np.full(n, widths[-1] ** 6)
    strength[: widths.size] = widths**6
    x, v, a = np.full(n, value[0]), np.zeros(n), np.zeros(n)
    xx, xv, xa = np.full(n, vague[0]), np.zeros(n), np.zeros(n)
    vv, va, aa = np.full(n, vague[1]), np.zeros(n), np.full(n, vague[2])
    total, shares = np.zeros(n), np.ones(n)
    for i in range(t.size):
        h, weakest = 0.0, 0.0
        if i > 0:
            h = t[i] - t[i - 1]
            weakest = min(least[i], least[i - 1]) ** 6
        h2 = h * h
        h3 = h2 * h
        sample, error = value[i], variance[i]
        for j in range(n):
            q = unit * max(weakest, strength[j])
            x0 = x[j] + h * v[j] + 0.5 * h2 * a[j]
            v0 = v[j] + h * a[j]
            xx0 = xx[j] + 2.0 * h * xv[j] + h2 * (vv[j] + xa[j]) + h3 * va[j]
            xx0 += 0.25 * h2 * h2 * aa[j] + q * h2 * h3 / 20.0
            xv0 = xv[j] + h * (vv[j] + xa[j]) + 1.5 * h2 * va[j] + 0.5 * h3 * aa[j]
            xv0 += q * h2 * h2 / 8.0
            xa0 = xa[j] + h * va[j] + 0.5 * h2 * aa[j] + q * h3 / 6.0
            vv0 = vv[j] + 2.0 * h * va[j] + h2 * aa[j] + q * h3 / 3.0
            va0 = va[j] + h * aa[j] + q * h2 / 2.0
            aa0 = aa[j] + q * h
            certainty = 1.0 / (xx0 + error)
            left = error * certainty
            miss = sample - x0
            of_x, of_v, of_a = xx0 * certainty, xv0 * certainty, xa0 * certainty
            x[j], v[j], a[j] = x0 + of_x * miss, v0 + of_v * miss, a[j] + of_a * miss
            aa[j], va[j], vv[j] = aa0 - of_a * xa0, va0 - of_a * xv0, vv0 - of_v * xv0
            xa[j], xv[j], xx[j] = xa0 * left, xv0 * left, xx0 * left
            total[j] += miss * miss * certainty
            shares[j] *= left
        # A logarithm of the product of some takes no longer than that of one.
        if i % _FACTORS == 0 or i == t.size - 1:
            for j in range(n):
                total[j] -= np.log(shares[j])
                shares[j] = 1.0
    misfits[:] = total[: widths.size]


@kernel(error_model='numpy')
def _through(  # type: ignore[no-untyped-def]
    t, value, variance, vague, intensity, state, speed
):
    """Set the smoothed places and speeds; return minus twice the log likelihood."""
    n = t.size
    means = np.empty((n, 3))
    covariances = np.empty((n, 6))
    m = np.zeros(3)
    m[0] = value[0]
    p = np.zeros(6)
    p[0], p[3], p[5] = vague[0], vague[1], vague[2]
    total = taken(value[0], variance[0], m, p)
    means[0] = m
    covariances[0] = p
    for i in range(1, n):
        forth(t[i] - t[i - 1], intensity[i - 1], m, p)
        total += taken(value[i], variance[i], m, p)
        means[i] = m
        covariances[i] = p
    # Backwards, what later samples say of the mean at a sample: the modified Bryson-Frazier form
    # of the smoother, which inverts no covariance.
    x = v = a = 0.0
    state[n - 1] = means[n - 1, 0]
    speed[n - 1] = means[n - 1, 1]
    for i in range(n - 2, -1, -1):
        m[:] = means[i]
        p[:] = covariances[i]
        h = t[i + 1] - t[i]
        forth(h, intensity[i], m, p)
        s = p[0] + variance[i + 1]
        x -= (p[0] * x + p[1] * v + p[2] * a + value[i + 1] - m[0]) / s
        a += h * v + 0.5 * h * h * x
        v += h * x
        c = covariances[i]
        state[i] = means[i, 0] - (c[0] * x + c[1] * v + c[2] * a)
        speed[i] = means[i, 1] - (c[1] * x + c[3] * v + c[4] * a)
    return total
