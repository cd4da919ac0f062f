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
The noise of a sample of force and of displacement height.

Two looks, of which the larger counts: the scatter about a straight line over the whole record
before contact (which sees slow noise, but not what contact adds), and the scatter about cubics
over 16 samples at a time during hold or recovery (which sees contact, but not slow noise). Cubics,
since at 10 Hz 16 samples may last longer than the decay that they lie on, and its curvature is no
noise. Both by the median over pieces, which glitches do not move.

"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np

_WINDOW: Final = 16
_MIN_BASELINE: Final = 32
_ROUNDING: Final = 1e-12
"""Scatter below this share of the signal is arithmetic."""
_DEGREE: Final = 3
_CHI2_MEDIAN: Final = 11.340
"""Median of chi squared with `_WINDOW` - `_DEGREE` - 1 = 12 degrees of freedom."""
_WHOLE: Final = 0.05
"""Of a step of a reading, by which what is called a multiple of it may be off."""
_MULTIPLES: Final = 4
"""Different multiples, fewer of which a tool with a few speeds shows without any rounding."""
_AGAINST: Final = -0.1
"""Covariance of two changes in a row over the variance, below which it is noise; white: -0.5."""
_FEWEST_STEPS: Final = 16
_FEWEST_TURNS: Final = 3
"""Times that a quick tool goes on by a step more or less; fewer are chance."""
_RESTS: Final = 41
"""Places between two readings that are tried."""
_DITHER: Final = (0.02, 1.5, 160)
"""Least and greatest noise that is tried, over the step of a reading, and how many."""
_GLITCH: Final = 1e-6
"""Part of the readings that may be any."""
_FEWEST_RESTS: Final = 8
_PARTS: Final = 8
"""Readings of a sensor at rest that tell a noise, and parts in which its zero hardly drifts."""
_SEVERAL: Final = 2.0
"""Steps by which a zero drifts through all places between two readings."""
_MOST_WINDOWS: Final = 4096
"""Windows that are looked at: their median is known to half a percent."""


@dataclass(frozen=True, slots=True)
class Noise:
    """One standard deviation of a sample of `force` [N] and of `height` [m]."""

    force: Estimate
    height: Estimate


def estimate_noise(trial: Trial, segmentation: Segmentation) -> Noise:
    """
    Estimate the noise of one trial.

    Parameters
    ----------
    trial : Trial
        What was measured.
    segmentation : Segmentation
        Its phases.

    Returns
    -------
    Noise
        Unknown with a reason where there are too few samples, or no noise is visible at all.

    """
    touch, hold = segmentation.t_contact, segmentation.t_hold
    released = segmentation.t_release
    end = segmentation.t_end
    baseline_end = trial.force.t[0] if touch is None else touch - 0.02 * (touch - trial.force.t[0])
    quiet = (
        trial.force.between(hold, end if released is None else released)
        if hold is not None
        else trial.force.between(0.0, end)
    )
    force = _larger(trial.force.between(-math.inf, baseline_end), quiet, 'force')
    height = trial.displacement_height
    if height is None:
        missing = 'the displacement height was not recorded'
        return Noise(force, Estimate.unknown(missing))
    free = segmentation.t_loss if segmentation.t_loss is not None else released
    rest = height if free is None else height.between(free, end)
    return Noise(
        force, _larger(height.between(-math.inf, baseline_end), rest, 'displacement height')
    )


def rounding(value: FloatArray) -> float:
    """
    Return the standard deviation of the error that a sensor makes by rounding what it reads.

    A tool may go on by the same number of steps of its encoders for long, and a load cell may read
    the same without contact, which looks as if nothing were rounded: all changes of the reading
    are multiples of one step.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Readings.

    Returns
    -------
    float
        A step over the root of twelve [unit of `value`]; zero where none shows.

    """
    changes = np.abs(np.diff(value))
    goes = changes > _ROUNDING * float(np.abs(value).max(initial=0.0))
    changes = changes[goes]
    if changes.size < _FEWEST_STEPS:
        return 0.0
    # A slow tool goes on by a single step at a time, and rests in between.
    rests = int(np.count_nonzero(np.diff(np.flatnonzero(goes)) > 1))
    step, multiples, turns = _step(changes, float(changes.min()))
    if multiples < _MULTIPLES and max(turns, rests) < _FEWEST_STEPS:
        step = 0.0
    if step == 0.0:
        # A quick tool never goes on by a single step, but by one more or less from time to time.
        apart = np.diff(np.sort(changes))
        apart = apart[apart > _ROUNDING * float(np.abs(value).max())]
        if apart.size:
            step, _, turns = _step(changes, float(apart.min()))
            step = step if turns >= _FEWEST_TURNS else 0.0
    return step / math.sqrt(12.0)


def of_neighbours(residual: FloatArray) -> float:
    """
    Return the noise that samples show beside the next ones.

    Cubics through a few samples of a record without noise leave little, but not nothing.

    Parameters
    ----------
    residual : ndarray, shape (n,)
        What a model leaves of a reading.

    Returns
    -------
    float
        Standard deviation [unit of `residual`]; zero where one change tells the next, as of what
        is missed smoothly.

    """
    changes = np.diff(residual)
    power = float(changes @ changes)
    if changes.size < _FEWEST_STEPS or float(changes[1:] @ changes[:-1]) > _AGAINST * power:
        return 0.0
    return math.sqrt(0.5 * power / changes.size)


def in_motion(still: FloatArray, error: float) -> float:
    """
    Return the noise that a sensor which rounds has where what it reads goes on.

    At rest near the middle of a reading it tells less than its noise, between two readings more;
    over all places the error of rounding adds to the noise.

    Parameters
    ----------
    still : ndarray, shape (n,)
        What it reads at rest, about any zero, which may drift evenly.
    error : float
        Standard deviation of its error of rounding, of `rounding` [unit of `still`].

    Returns
    -------
    float
        Standard deviation [unit of `still`].

    Notes
    -----
    Widrow and Kollar, Quantization Noise (Cambridge, 2008), chapters 4 and 7.

    """
    step = error * math.sqrt(12.0)
    if still.size < _FEWEST_RESTS:
        return error
    index = np.arange(still.size, dtype=np.float64)
    noise = _line_residual(index, still)
    spread = float(np.std(noise))
    line = still - noise
    moved = float(np.ptp(line))
    # Over several readings what is seen about the line has the rounding in it already.
    if step == 0.0 or spread >= step or moved >= _SEVERAL * step:
        return spread
    if float(np.ptp(still)) == 0.0:
        return error
    from scipy.special import ndtr

    reading = np.rint((still - still.min()) / step)
    part = np.minimum(index * _PARTS / still.size, _PARTS - 1).astype(np.intp)
    place = np.array([(line[part == k] - still.min()).mean() / step for k in range(_PARTS)])
    readings = np.unique(reading)
    seen = reading == readings[:, np.newaxis]
    counts = np.array([seen[:, part == k].sum(axis=1) for k in range(_PARTS)])
    # Nobody knows where between the readings the sensor rests.
    rests = np.linspace(-0.5, 0.5, _RESTS)[:, np.newaxis, np.newaxis, np.newaxis]
    noises = np.geomspace(*_DITHER)[:, np.newaxis, np.newaxis]
    above = readings + 0.5 - rests - place[:, np.newaxis]
    share = ndtr(above / noises) - ndtr((above - 1.0) / noises)
    # A glitch tells nothing of the noise.
    likely = np.sum(np.log(np.maximum(share, _GLITCH)) * counts, axis=(2, 3))
    likeliest = np.unravel_index(int(np.argmax(likely)), likely.shape)[1]
    return math.hypot(float(noises[likeliest, 0, 0]) * step, error)


def _step(changes: FloatArray, step: float) -> tuple[float, int, int]:
    """
    Return the step of a reading near one, or zero if its changes are no multiples of it.

    Also how many different multiples there are, and how often one follows its neighbour.
    """
    # The small ones tell it closely enough for the large ones to be counted, whose digits may end
    # before it does.
    for largest in (3.5 * step, 30.0 * step, math.inf):
        chosen = changes[changes <= largest]
        whole = np.rint(chosen / step)
        if chosen.size:
            if not whole.any():
                return 0.0, 0, 0
            step = float(chosen.sum() / whole.sum())
    away = np.abs(changes / step - whole)
    turns = int(np.count_nonzero(np.abs(np.diff(whole)) == 1.0))
    return (step if away.max() < _WHOLE else 0.0), np.unique(whole).size, turns


def pool_noise(noises: Sequence[Noise]) -> Noise:
    """Return the noise of several trials on one device: the median of those that are known."""
    return Noise(
        _median(tuple(noise.force for noise in noises)),
        _median(tuple(noise.height for noise in noises)),
    )


def _median(estimates: tuple[Estimate, ...]) -> Estimate:
    """Return the median of the known estimates, or the first reason."""
    known = [estimate.value for estimate in estimates if estimate.value is not None]
    if not known:
        return estimates[0] if estimates else Estimate.unknown('there is no trial')
    return Estimate(float(np.median(known)))


def _larger(baseline: Signal, quiet: Signal, what: str) -> Estimate:
    """Return the larger of the two looks at a signal's noise."""
    looks = []
    if len(baseline) >= _MIN_BASELINE:
        line = _line_residual(baseline.t, baseline.value)
        looks.append(NORMAL_FROM_MAD * float(np.median(np.abs(line))))
    if len(quiet) >= 2 * _WINDOW:
        looks.append(_local(quiet))
    if not looks:
        return Estimate.unknown(f'there are too few samples of the {what} to see its noise')
    values = np.concatenate((baseline.value, quiet.value))
    if max(looks) <= _ROUNDING * float(np.abs(values).max()):
        return Estimate.unknown(f'the {what} shows no noise at all')
    return Estimate(max(looks))


def _line_residual(t: FloatArray, value: FloatArray) -> FloatArray:
    """Return the residual of a straight line."""
    centred = t - t.mean()
    slope = float(centred @ value) / float(centred @ centred)
    return np.asarray(value - value.mean() - slope * centred, dtype=np.float64)


def _local(signal: Signal) -> float:
    """Return the scatter about cubics over short windows."""
    windows = len(signal) // _WINDOW
    count = windows * _WINDOW
    # Evenly spread over the record, and each of consecutive samples.
    chosen = np.linspace(0, windows - 1, min(windows, _MOST_WINDOWS)).astype(np.intp)
    t = signal.t[:count].reshape(-1, _WINDOW)[chosen]
    value = signal.value[:count].reshape(-1, _WINDOW)[chosen]
    first, last = t[:, :1], t[:, -1:]
    powers = np.polynomial.legendre.legvander((2.0 * t - first - last) / (last - first), _DEGREE)
    basis = np.linalg.qr(powers).Q
    # About the mean, since rounding would otherwise be that of the level.
    value = value - value.mean(axis=1, keepdims=True)
    along = np.einsum('wsp,ws->wp', basis, value)
    residual = value - np.einsum('wsp,wp->ws', basis, along)
    return math.sqrt(float(np.median(np.sum(residual**2, axis=1))) / _CHI2_MEDIAN)
