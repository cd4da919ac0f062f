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

"""Where the tool first touches the object, once it is known about when."""

from dataclasses import dataclass
import math
from typing import Literal

from hapticvision_ros.core.fit.uncertainty import least_squares_covariance
from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.segmentation.fits import (
    fit_from_start,
    fit_onset,
    fit_stop,
    level,
    Onset,
)
import numpy as np

_BLOCKS = 20
_FEWEST = 8
_GLITCH = 9.0
"""Median deviations beyond which a sample without contact is a glitch: 6 sigma."""
_LEAST_RISE = 6
"""Samples of the shortest rise that a curve is fitted to."""
_EARLY, _MISSED = 0.1, 2.0
"""An onset is early by this share of the rise; a curve is off by so many times the noise."""
_RISEN = 4.0
"""Standard errors by which the force has risen since the tool has started."""
_PART = 32
"""Parts of a rest, in the last of which a slow rise of the force may begin."""
_AT_THE_RISE = 2
"""Samples before a rise that may have a part of it."""
_AIR_BLOCKS, _MOST_BLOCKS = 16, 100
"""Parts of the air, no longer than those of the lead, whose spread tells what noise makes."""
_LEADS = 4
"""Parts of a slow lead, each of which presses."""
_PRESSED = 6.0
"""By how many times the spread of blocks in air: of so many it is chance once in 1e5."""
_LOW = 0.75
"""Share of the samples of a lead up to the last of which no sample is of the push's own rise."""
_FAR = 12.0
"""Standard deviations from the usual level that are none of the noise in air."""
_STARTED = 0.01
"""Share of its way by which a tool has moved in air."""


@dataclass(frozen=True, slots=True)
class Touch:
    """
    The first touch.

    Parameters
    ----------
    t : float
        Its time [s].
    zero : float or None
        Force just before [N]; None if the record has none.
    drift : float
        Drift of the force before [N/s].
    found : {'approach', 'rest', 'start'}
        After an approach in air; as a tool that rested on the object starts; or the record
        starts in contact.
    zero_std : float
        Standard error of `zero` [N]; 0 where there is none.
    travel_std : float
        Standard error of the tool's travel at `t` [m]; 0 where the touch is not in the record.
    t_push : float
        When the push begins [s], where a slow approach was waiting for the touch.
    rest : float or None
        Where a tool that rests on the object stays [m of travel]: one that starts softly has gone
        some way until it is seen to.

    """

    t: float
    zero: float | None
    drift: float
    found: Literal['approach', 'rest', 'start']
    zero_std: float = 0.0
    travel_std: float = 0.0
    t_push: float = -math.inf
    rest: float | None = None

    def travel(self, t: FloatArray, x: FloatArray) -> float:
        """
        Return where the object is touched.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times [s].
        x : ndarray, shape (n,)
            Travel of the tool [m].

        Returns
        -------
        float
            Its travel there [m].

        """
        return float(np.interp(self.t, t, x)) if self.rest is None else self.rest


def slope(t: FloatArray, value: FloatArray) -> tuple[float, float]:
    """
    Fit a straight line to the means of blocks, so that correlated noise is not underrated.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s]; n of at least 20.
    value : ndarray, shape (n,)
        The signal.

    Returns
    -------
    slope, error : float
        Slope of the line [unit of `value`/s] and its standard error.

    """
    starts = np.linspace(0, t.size, _BLOCKS + 1).astype(np.intp)[:-1]
    size = np.diff(np.append(starts, t.size))
    tb, vb = np.add.reduceat(t, starts) / size, np.add.reduceat(value, starts) / size
    tb -= np.mean(tb)
    power = float(tb @ tb)
    steepness = float(tb @ vb) / power
    residual = vb - np.mean(vb) - steepness * tb
    return steepness, float(np.sqrt(residual @ residual / (_BLOCKS - 2.0) / power))


def smooth(x: FloatArray, noise: float) -> FloatArray:
    """
    Average the noise of a travel out, over as many samples as the tool is fast beside it.

    Parameters
    ----------
    x : ndarray, shape (n,)
        Travel [m].
    noise : float
        Standard deviation of a sample [m].

    Returns
    -------
    ndarray, shape (n,)
        The moving average; `x` itself where there is no noise to speak of.

    """
    step = np.abs(np.diff(x))
    fast = float(np.partition(step, int(0.9 * (step.size - 1)))[int(0.9 * (step.size - 1))])
    width = 1 + 2 * int(min(50.0, 2.0 * noise / max(fast, 1e-300)))
    if width == 1 or x.size < 2 * width:
        return x
    padded = np.concatenate((np.full(width // 2, x[0]), x, np.full(width // 2, x[-1])))
    total = np.concatenate(([0.0], np.cumsum(padded)))
    return np.asarray((total[width:] - total[:-width]) / width)


def fit_start(t: FloatArray, x: FloatArray, first: int, moved: int) -> float:
    """
    Find when a tool at rest starts.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s].
    x : ndarray, shape (n,)
        Travel [m].
    first, moved : int
        The tool rests from sample `first` and is clearly away at sample `moved`.

    Returns
    -------
    float
        Time of the start [s].

    """
    rest = level(x[first:moved])
    off = np.abs(x[moved:] - rest)
    leg = int(np.argmax(off >= 0.2 * float(np.max(off))))
    last = min(x.size, moved + max(leg, 4) + 1)
    near = np.flatnonzero(np.abs(x[first:last] - rest) <= 0.1 * abs(float(x[last - 1]) - rest))
    settled = first + int(near[-1]) if near.size else moved
    begin = max(first, settled - max(2 * (last - settled), 8))
    back = -t[begin:last][::-1]
    gone = x[begin:last][::-1]
    return -fit_stop(back, gone, float(back[0]), float(back[-1]), backwards=True)


def locate_touch(
    t: FloatArray,
    force: FloatArray,
    tx: FloatArray,
    x: FloatArray,
    travel_noise: float,
    low: int,
    high: int,
) -> Touch:
    """
    Find the first touch finer than a sample.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the force [s].
    force : ndarray, shape (n,)
        Force [N] with its offset.
    tx : ndarray, shape (m,)
        Times of the travel [s].
    x : ndarray, shape (m,)
        Travel of the tool toward the object [m].
    travel_noise : float
        Standard deviation of a sample of `x` [m].
    low, high : int
        Samples of the force: not yet touching at `low`, surely touching at `high`.

    Returns
    -------
    Touch
        The touch.

    Notes
    -----
    A guarded approach goes slowly until it has touched, and the push from there on: the force
    rises at the touch, and by far more as the push begins. The touch is the first of them.

    """
    rise = max(high - low, _LEAST_RISE)
    smoothed = smooth(x, travel_noise)
    while True:
        stop = min(low + 2 * rise + 1, t.size)
        first = low - max(4 * rise, 40)
        first = 0 if first < 40 else first
        tw, fw = t[first:stop], force[first:stop]
        travel = np.interp(tw, tx, smoothed)
        earliest, latest = float(tw[0]), float(t[min(stop - 1, low + rise)])
        onset = fit_onset(tw, fw, travel, earliest, latest)
        if rise == _LEAST_RISE or not _misses(onset, tw, fw, low - first, latest):
            break
        # A slow push, or one that stops on its way, is no curve of the travel for so long.
        rise = max(rise // 2, _LEAST_RISE)
    t_push = -math.inf
    led = _led(t, force, tx, x, travel_noise, onset.t)
    if led is not None:
        t_push, (first, touch, stop) = onset.t, led
        tw, fw = t[first:stop], force[first:stop]
        travel = np.interp(tw, tx, smoothed)
        near = (stop - touch) // 2
        earliest, latest = float(t[max(touch - near, first)]), float(t[touch + near // 2])
        onset = fit_onset(tw, fw, travel, earliest, latest)
    rises = False
    if first == 0 and np.count_nonzero(tw < onset.t) < _BLOCKS:
        # So short a baseline could be the foot of a toe.
        doubt = fit_from_start(fw, travel - travel[0]) / max(onset.rest, 1e-300)
        rises = doubt < 2.0 or (doubt - 1.0) * (tw.size - 5.0) < 30.0
    reach = float(tw[-1]) - onset.t
    before = int(np.searchsorted(t, onset.t - 0.1 * reach))
    drift, zero = 0.0, onset.baseline
    scatter = math.sqrt(onset.rest / max(tw.size - 5.0, 1.0))
    zero_std = scatter / math.sqrt(max(before, 1))
    if before >= _BLOCKS:
        drift, error = slope(t[:before], force[:before])
        if abs(drift) > 4.0 * error:
            rises = drift * reach > 0.125 * (float(fw[-1]) - onset.baseline)
            onset = fit_onset(tw, fw - drift * (tw - onset.t), travel, earliest, latest)
        else:
            drift = 0.0
        quiet = force[:before] - drift * (t[:before] - onset.t)
        zero, zero_std = quiet_level(quiet, (t[:before] - onset.t) if drift else None)
    far = float(np.max(x) - x[0])
    away = np.abs(x - x[0]) > 5.0 * travel_noise + 1e-3 * far
    moved = int(np.argmax(away))
    if moved >= 4:
        stays = level(x[: moved - 1])
        if float(np.interp(onset.t, tx, x)) - stays <= 5.0 * travel_noise + 0.01 * far:
            started = fit_start(tx, x, 0, moved)
            begun, end = np.searchsorted(t, (started, onset.t)).tolist()
            still, later = force[:begun], force[begun:end]
            if not still.size:
                return Touch(started, None, 0.0, 'rest', travel_std=travel_noise, rest=stays)
            if not _stays(*quiet_level(still), later):
                calm = _before_rise(still)
                if calm < still.size:
                    started = float(t[calm])
                    stays = level(x[: max(int(np.searchsorted(tx, started)), 1)])
                zero, error = quiet_level(still[:calm])
                return Touch(started, zero, 0.0, 'rest', error, travel_noise, rest=stays)
    elif away[moved] and (rises or np.count_nonzero(t < onset.t) <= 3):
        return Touch(max(float(t[0]), float(tx[0])), None, 0.0, 'start')
    error = _travel_std(tw, fw, travel, onset.t, onset.baseline, scatter)
    travel_std = math.hypot(error, travel_noise)
    return Touch(onset.t, zero, drift, 'approach', zero_std, travel_std, t_push)


def _misses(onset: Onset, t: FloatArray, force: FloatArray, low: int, latest: float) -> bool:
    """Return whether an onset is well before what is still quiet, and its curve is no match."""
    if low < _FEWEST or float(t[low]) - onset.t <= _EARLY * (latest - float(t[low])):
        return False
    # The last of them may have a part of the rise. Of a coarse load cell all may be equal.
    steps = np.abs(np.diff(force))
    rounded = float(np.min(steps[steps > 0.0], initial=np.inf)) / math.sqrt(12.0)
    noise = max(float(np.std(np.array_split(force[:low], 2)[0])), rounded)
    return math.sqrt(onset.rest / t.size) > _MISSED * noise


def _stays(quiet: float, error: float, later: FloatArray) -> bool:
    """Return whether the force of a tool that has started has not risen from its level at rest."""
    if later.size < _BLOCKS:
        return False
    moving, moving_error = quiet_level(later)
    return moving - quiet <= _RISEN * math.hypot(error, moving_error)


def _before_rise(force: FloatArray) -> int:
    """Return how many samples of a tool at rest there are before a start is felt, not yet seen."""
    count, size = force.size, _FEWEST
    while size <= max(count // _PART, _FEWEST) and count - size >= _BLOCKS:
        # A few samples show a quick rise, and many a slow one.
        before, last = np.split(force[:count], [count - size])
        usual, error = quiet_level(before)
        noise = error * math.sqrt(before.size)
        if quiet_level(last)[0] - usual > _RISEN * noise / math.sqrt(size):
            count -= size
        else:
            size *= 2
    return count


def _led(
    t: FloatArray,
    force: FloatArray,
    tx: FloatArray,
    x: FloatArray,
    travel_noise: float,
    rise: float,
) -> tuple[int, int, int] | None:
    """
    Return the touch by a slow tool that a push followed, between two samples; None without one.

    What the tool does in air moves the force as well, from where it starts; a touch is further on,
    and the force stays above all that it was in air until the push begins.
    """
    stop = int(np.searchsorted(t, rise)) - _AT_THE_RISE
    if stop < _FEWEST * _AIR_BLOCKS:
        return None
    # Where the levels before and after differ most, beside how many samples tell it. The first
    # samples of the push are none of either.
    middle = float(np.median(force[:stop]))
    usual = NORMAL_FROM_MAD * float(np.median(np.abs(force[:stop] - middle)))
    # More than half of the samples of a coarse load cell may be equal.
    reach = _FAR * (usual or float(force[: stop // 2].std()))
    past = np.clip(force[:stop], middle - reach, middle + reach)
    past = np.cumsum(past - past.mean())[:-1]
    before = np.arange(1, stop)
    first = 1 + int(np.argmax(past**2 / (before * (stop - before))))
    far = float(np.max(x) - x[0])
    if float(np.interp(t[first], tx, x)) - x[0] <= 5.0 * travel_noise + _STARTED * far:
        return None
    low = np.flatnonzero(force[first:stop] <= np.quantile(force[first:stop], _LOW))
    stop = first + int(low[-1])
    size = max(min((stop - first) // _LEADS, first // _AIR_BLOCKS), 1)
    count = min(first // size, _MOST_BLOCKS)
    if count < _AIR_BLOCKS or stop - first < _AT_THE_RISE:
        return None
    begin = first - count * size
    air = force[begin:first].reshape(count, size).mean(axis=1)
    least = float(air.mean()) + _PRESSED * float(air.std(ddof=1))
    parts = np.array_split(force[first:stop], min(stop - first, _LEADS))
    if min(float(part.mean()) for part in parts) <= least:
        return None
    return max(first - max(4 * (stop - first), 40), 0), first, stop


def _travel_std(
    t: FloatArray,
    force: FloatArray,
    travel: FloatArray,
    touch: float,
    baseline: float,
    scatter: float,
) -> float:
    """Return the error of the travel [m] that the error of the time of touch makes."""
    after = min(max(int(np.searchsorted(t, touch)), 1), t.size - 1)
    interval = max(float(np.median(np.diff(t))), float(t[after] - t[after - 1]))
    duration = max(float(t[-1]) - touch, interval)
    speed = abs(float(travel[-1] - np.interp(touch, t, travel))) / duration
    between = interval / math.sqrt(12.0)
    if abs(float(force[after]) - baseline) > 5.0 * scatter:
        return speed * between
    # No jump: a parabola extrapolated to its start has three times the error of a mean.
    rate = abs(float(force[-1]) - baseline) / duration
    toe = 3.0 * scatter / max(rate * math.sqrt(t.size - after), 1e-300)
    return speed * math.hypot(between, min(toe, duration))


def quiet_level(value: FloatArray, u: FloatArray | None = None) -> tuple[float, float]:
    """
    Return the mean of all that is no glitch: correlated noise needs a long average.

    Parameters
    ----------
    value : ndarray, shape (n,)
        A level with noise.
    u : ndarray, shape (n,), optional
        Where a straight line has been taken out of `value`: the coordinate of that, zero where
        it was taken to be zero.

    Returns
    -------
    level, error : float
        The mean and its standard error, corrected for autocorrelation.

    """
    centre = float(np.median(value))
    off = np.abs(value - centre)
    # More than half of the samples of a coarse load cell may be equal.
    kept = off <= (_GLITCH * float(np.median(off)) or float(np.max(off)))
    quiet = value[kept]
    mean = float(np.mean(quiet))
    if quiet.size < _FEWEST:
        return mean, float(np.std(quiet)) / math.sqrt(max(quiet.size - 1, 1))
    ones = np.ones(quiet.size)
    columns = (ones,) if u is None else (ones, u[kept])
    covariance = least_squares_covariance(np.stack(columns).T, (quiet - mean,))
    return mean, math.sqrt(float(covariance[0, 0]))
