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
Least squares of an exponential decay towards a constant: eqs. (4) and (10) of the paper.

The two amplitudes enter linearly, so the search runs over the time constant alone (variable
projection): first on a grid over block means, then by Gauss-Newton steps on every sample.

References
----------
.. [1] G. H. Golub, V. Pereyra, "The differentiation of pseudo-inverses and nonlinear least squares
   problems whose variables separate", SIAM J. Numer. Anal. 10 (1973), doi:10.1137/0710036.

"""

from dataclasses import dataclass, replace
import math
from typing import Final

from hapticvision_ros.core.fit.glitches import find_glitches
from hapticvision_ros.core.fit.uncertainty import least_squares_covariance
from hapticvision_ros.core.records import FloatArray, Signal
import numpy as np

MIN_SAMPLES: Final = 12
"""Fewer samples than this leave no freedom to judge an error from the residual."""

_BLOCKS: Final = 512
_GRID: Final = 96
_LONGEST: Final = 100.0
"""The slowest decay that is tried, in durations of the record: a straight line."""


@dataclass(frozen=True, slots=True)
class ExponentialFit:
    """
    A fitted decay ``amplitude exp(-(t - origin) / time_constant) + offset``.

    Parameters
    ----------
    origin : float
        Time that `amplitude` refers to [s].
    amplitude, offset : float
        In the unit of the signal.
    time_constant : float
        [s], positive.
    covariance : ndarray, shape (3, 3)
        Of (amplitude, time_constant, offset), corrected for autocorrelated residuals.
    noise : float
        Root mean square of the residual, in the unit of the signal.
    start, stop : float
        The first and the last time that was fitted [s].
    interval : float
        Median time between samples [s].
    mean : float
        Mean of the fitted samples, in the unit of the signal.
    mean_std : float
        Standard error of `mean`, in the unit of the signal.
    slide, slide_std : float
        How far a straight line through the record falls over it, and the standard error of that,
        in the unit of the signal.
    set_aside : ndarray
        Times of the samples left out as glitches [s].

    """

    origin: float
    amplitude: float
    time_constant: float
    offset: float
    covariance: FloatArray
    noise: float
    start: float
    stop: float
    interval: float
    mean: float
    mean_std: float
    slide: float
    slide_std: float
    set_aside: FloatArray

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the fitted curve at times `t` [s]."""
        decay = np.exp(-(t - self.origin) / self.time_constant)
        return np.asarray(self.amplitude * decay + self.offset, dtype=np.float64)

    @property
    def span(self) -> float:
        """Return how long the fitted record lasts [s]."""
        return self.stop - self.start

    @property
    def std(self) -> tuple[float, float, float]:
        """Return the standard errors of (amplitude, time_constant, offset)."""
        amplitude, time_constant, offset = np.sqrt(np.diag(self.covariance)).tolist()
        return amplitude, time_constant, offset

    @property
    def drop(self) -> tuple[float, float]:
        """Return how far the curve falls over the record, and the standard error of that."""
        at_start = self.referred_to(self.start)
        left = math.exp(-self.span / self.time_constant)
        gradient = np.array(
            [1.0 - left, -at_start.amplitude * left * self.span / self.time_constant**2, 0.0]
        )
        variance = float(gradient @ at_start.covariance @ gradient)
        return at_start.amplitude * (1.0 - left), math.sqrt(max(variance, 0.0))

    def flat(self) -> 'ExponentialFit':
        """Return the constant in place of the curve, for a record that shows no decay."""
        covariance = np.zeros((3, 3))
        covariance[2, 2] = self.mean_std**2
        return replace(self, amplitude=0.0, offset=self.mean, covariance=covariance)

    def referred_to(self, origin: float) -> 'ExponentialFit':
        """Return the same curve with its amplitude taken at the time `origin` [s]."""
        shift = self.origin - origin
        scale = math.exp(min(shift / self.time_constant, 700.0))
        jacobian = np.eye(3)
        jacobian[0, 0] = scale
        jacobian[0, 1] = -self.amplitude * scale * shift / self.time_constant**2
        return replace(
            self,
            origin=origin,
            amplitude=self.amplitude * scale,
            covariance=jacobian @ self.covariance @ jacobian.T,
        )


def fit_exponential(signal: Signal) -> ExponentialFit:
    """
    Fit a decay to a constant to a signal; the amplitude refers to its first sample.

    Samples that stand out of their own neighbourhood are set aside as glitches
    (`find_glitches`); a smooth misfit of the curve never is.

    Parameters
    ----------
    signal : Signal
        At least `MIN_SAMPLES` samples.

    Returns
    -------
    ExponentialFit
        The curve, with standard errors from the residual. Whether its time constant means
        anything (no decay at all, a record far shorter than the decay) is for the caller to judge.

    Raises
    ------
    ValueError
        If there are too few samples.

    """
    if len(signal) < MIN_SAMPLES:
        raise ValueError(f'{len(signal)} samples cannot tell a decay')
    glitch = find_glitches(signal.value)
    clean = not glitch.any()
    t = (signal.t if clean else signal.t[~glitch]) - signal.t[0]
    y = signal.value if clean else signal.value[~glitch]
    edges = np.linspace(0, t.size, min(t.size, _BLOCKS) + 1).astype(np.intp)
    weight = np.diff(edges).astype(np.float64)
    block_t, block_y = (
        np.add.reduceat(t, edges[:-1]) / weight,
        np.add.reduceat(y, edges[:-1]) / weight,
    )
    rate, amplitude, offset = _polish(t, y, _search(block_t, block_y, weight))
    decay = np.exp(-rate * t)
    residual = y - amplitude * decay - offset
    jacobian = np.stack((decay, (amplitude * rate**2) * t * decay, np.ones_like(t)))
    # The straight line loses nothing by the blocks.
    line = np.stack((np.ones_like(block_t), (block_t.mean() - block_t) / t[-1]))
    mean = float(y.mean())
    slide = float(line[1] @ block_y) / float(line[1] @ line[1])
    spread = least_squares_covariance(line.T, (block_y - block_y.mean() - slide * line[1],))
    return ExponentialFit(
        origin=float(signal.t[0]),
        amplitude=amplitude,
        time_constant=1.0 / rate,
        offset=offset,
        covariance=least_squares_covariance(jacobian.T, (residual,)),
        noise=math.sqrt(float(residual @ residual) / (t.size - 3)),
        start=float(signal.t[0]),
        stop=float(signal.t[-1]),
        interval=float(np.median(np.diff(signal.t))),
        mean=mean,
        mean_std=math.sqrt(float(spread[0, 0])),
        slide=slide,
        slide_std=math.sqrt(float(spread[1, 1])),
        set_aside=signal.t[glitch],
    )


def _search(t: FloatArray, y: FloatArray, weight: FloatArray) -> float:
    """Return the best rate [1/s] of a grid, from the interval of the blocks to a straight line."""
    shortest = 0.2 * t[-1] / t.size
    rates = np.geomspace(1.0 / shortest, 1.0 / (_LONGEST * t[-1]), _GRID)
    decay = np.exp(-np.outer(rates, t))
    share = weight / weight.sum()
    decay -= (decay @ share)[:, np.newaxis]
    with np.errstate(invalid='ignore', divide='ignore'):
        gain = (decay @ (share * (y - share @ y))) ** 2 / (decay**2 @ share)
    return float(rates[int(np.argmax(np.nan_to_num(gain)))])


def _polish(t: FloatArray, y: FloatArray, rate: float) -> tuple[float, float, float]:
    """Return rate [1/s], amplitude and offset of least squares, starting at a rate nearby."""
    count = t.size
    mean = float(y.sum()) / count
    centred = y - mean
    slowest = 1.0 / (_LONGEST * t[-1])
    fastest = 10.0 * count / t[-1]

    def project(rate: float) -> tuple[float, float, float, float]:
        """Return cost, amplitude, mean of the decay and the Gauss-Newton step in log rate."""
        decay = np.exp(-rate * t)
        level = float(decay.sum()) / count
        decay -= level
        power = float(decay @ decay)
        if power <= 0.0:
            return math.inf, 0.0, level, 0.0
        amplitude = float(decay @ centred) / power
        residual = centred - amplitude * decay
        slope = (-rate * amplitude) * t * (decay + level)
        slope -= float(slope.sum()) / count
        slope -= (float(slope @ decay) / power) * decay
        curvature = float(slope @ slope)
        step = float(slope @ residual) / curvature if curvature > 0.0 else 0.0
        return float(residual @ residual), amplitude, level, step

    cost, amplitude, level, step = project(rate)
    for _ in range(50):
        step = float(np.clip(step, -1.0, 1.0))
        tried = float(np.clip(rate * math.exp(step), slowest, fastest))
        if abs(math.log(tried / rate)) < 1e-9:
            break
        outcome = project(tried)
        if outcome[0] < cost:
            rate, (cost, amplitude, level, step) = tried, outcome
        else:
            step *= 0.25
    return rate, amplitude, mean - amplitude * level
