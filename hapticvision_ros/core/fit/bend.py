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
How an arm changes its speed: the same way in all trials, as one controller does it.

An acceleration that comes and goes over a time of its own (a jerk limit, or a moving average of
the commands), which a servo follows with a lag of first order, or of second, which may swing.
Encoders that round tell little of a single stop of a slow push; all changes of speed of a campaign
together tell the shape.

References
----------
L. Biagiotti and C. Melchiorri, Trajectory Planning for Automatic Machines and Robots, 2008,
ch. 3.2 and 4.6 (trapezoidal and double-S profiles, and these as filters in a row).
K. Ogata, Modern Control Engineering, 5th ed. 2010, ch. 5.3 (response of second-order systems).

"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import product
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.fit.simplex import minimum
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

BRISK: Final = 0.1
"""Part of a wait that the stop before it and the start after it take where a search begins."""
FADED: Final = 7.0
"""Time constants after which a lag has gone: a thousandth of what it was."""
ROUNDED: Final = 1.001
"""Slack of what rounding accounts for, over half a step of the encoders."""
RESTS: Final = 17
"""Places within a step of the encoders at which a tool may rest."""
SHOWN: Final = 12.0
"""Drop of the squares over the noise from which on a change of speed takes time."""
_SOFT: Final = 1e-3
"""Part of an acceleration over which it comes and goes, below which it does so at once."""
_FEWEST: Final = 2
"""Changes of speed that tell how the arm makes them."""
_MOST: Final = 24
"""Those that are looked at."""
_CRITICAL: Final = 1e-4
"""Four times a swing less one, of either sign, below which the damping is the critical one."""
_STIFF: Final = 1e-4
"""Swing below which a servo has a lag of first order."""
_UNLIKELY: Final = 80.0
"""Squares over the noise by which a place to rest is so unlikely that no sum shows it."""
_BRIEFEST: Final = 1e-4
"""Acceleration that comes and goes at once, as how it does so cannot be told apart [s]."""
SWINGS: Final = (0.5, 1.2)
"""Those that are tried, of damping ratios of 0.7 and 0.46 [-]."""
_SEARCHED: Final = np.array([0.3, 0.3, 0.4, 0.3])
"""First steps of a search: of duration, lag, jerk, and swing."""
_MORE_SEARCHES: Final = 4
"""Searches that are begun again."""
_MORE_TURNS: Final = 200
"""Turns of a search that goes to the end."""
_APART: Final = 40.0
"""Deviance that a shape of its own takes out of a change of speed that is not made as others."""
_LARGE: Final = 0.5
"""Part of the largest change of speed from which on others tell as well how an arm swings."""
_LEAST: Final = 0.01
"""Part of its usual duration that an acceleration lasts at least where a search begins."""
WILDEST: Final = 12.0
"""Swing at most: a damping ratio of 0.14 [-]."""
_LIKE: Final = 0.02
"""Spread of the parts of its speed by which a tool changes it, below which they are alike."""
_EVENLY: Final = 0.1
"""By how much the halves of a turn may differ that are taken for equal."""
_PROBE: Final = 1e-6
"""Steps by which derivatives of shapes are told."""
_CLEAN: Final = 2e-4
"""Noise of clean encoders over the way that a change of speed makes about it."""
_CLEANER: Final = 4
"""Rounds in which those that are made otherwise are left out."""
_TELLING: Final = 1e-3
"""Part of what is left, or of one, below which a drop of the squares tells nothing more."""
_POLISHED: Final = 30
"""Looks at clean changes of speed at most."""
_DURATIONS: Final = 17
"""How long an acceleration lasts is looked for at so many places first."""
_FINEST: Final = 2e-5
_ROUGH: Final = 1e-3
"""Part of the longest to which that is told; the latter where what it leaves is wanted more."""
_LOOKS: Final = 100
"""At most so often more finely."""
_GOLDEN: Final = 0.5 * (3.0 - math.sqrt(5.0))
"""Part of a bracket at which one more look narrows it the same way again."""
_LAGS: Final = 7
_HALVINGS: Final = 4
"""A lag is looked for at so many places first, odd, and so often at half the distance."""
_BRIEF: Final = 0.05
"""Of a lag, below which how long an acceleration lasts makes no difference."""
_RESTING: Final = 0.1
"""Speed after a stop, over that before, below which it is one."""
_LONGEST: Final = 3.0
"""How long a change of speed may take, over the longest that was found for one."""
_BOUNDS: Final = np.array([_LONGEST, 10.0, 1.0, WILDEST])
"""Greatest numbers of a servo, as a search takes it."""


class Shape(NamedTuple):
    """
    How a change of speed goes.

    Parameters
    ----------
    duration : float
        How long the acceleration lasts, from when half of it has come until half has gone [s].
    jerk : float
        How long it takes to come, and to go; no longer than `duration` [s].
    lag : float
        By how much the arm's servo is late, 2 zeta / omega with its damping ratio zeta and its
        natural frequency omega; without a swing the time constant of a first-order lag [s].
    swing : float
        1 / (4 zeta^2): none for a first-order lag, above a quarter the speed goes beyond [-].
    part : float
        Part of the change that is a stop, where it is a stop and a start the other way, one right
        after the other, each of which takes as long as is said here; none where it is zero [-].
    wait : float
        How long it rests between the two [s].

    """

    duration: float
    jerk: float = 0.0
    lag: float = 0.0
    swing: float = 0.0
    part: float = 0.0
    wait: float = 0.0

    @property
    def soft(self) -> float:
        """Return the part of the duration over which the acceleration comes [-]."""
        return self.jerk / self.duration if self.duration > 0.0 else 0.0

    @property
    def slowest(self) -> float:
        """Return the longest time constant with which the servo comes to its end [s]."""
        return self.lag * max(1.0, 2.0 * self.swing)

    @property
    def spans(self) -> float:
        """Return how long the commanded speed changes [s]."""
        once = self.duration + self.jerk
        return once + self.apart if self.part > 0.0 else once

    @property
    def apart(self) -> float:
        """Return how long after a stop the start is that comes with it [s]."""
        return self.duration + self.jerk + self.wait

    @property
    def ahead(self) -> float:
        """Return by how much the change begins before the straight pieces would meet [s]."""
        half = 0.5 * (self.duration + self.jerk)
        return half + (1.0 - self.part) * self.apart if self.part > 0.0 else half

    @property
    def takes(self) -> float:
        """Return how long the speed changes, but for the last of the lag [s]."""
        return self.spans + 2.0 * self.slowest

    def as_wait(self, part: float) -> float:
        """
        Return how long a tool waits that stops and starts at once and is beyond as much in all.

        Parameters
        ----------
        part : float
            Part of the change of speed that is the stop [-].

        Returns
        -------
        float
            From the stop to the start [s].

        """
        # The mean square of when the speed changes, about the mean.
        square = (self.duration**2 + self.jerk**2) / 12.0 + self.lag**2 * (1.0 - 2.0 * self.swing)
        if self.part > 0.0:
            square += self.part * (1.0 - self.part) * self.apart**2
        return math.sqrt(max(square, 0.0) / (part * (1.0 - part)))


@dataclass(frozen=True, slots=True)
class Bend:
    """
    A corner of the tool's path that is passed with an acceleration.

    Parameters
    ----------
    t : float
        When the two straight pieces would meet [s].
    turn : float
        Speed after less speed before [m/s].
    shape : Shape
        How the speed changes.
    common : bool
        Whether that is how the arm makes all its changes of speed.
    error : float
        Standard error of `t` [s].

    """

    t: float
    turn: float
    shape: Shape
    common: bool = False
    error: float = 0.0

    @property
    def lasts(self) -> float:
        """Return how long the speed changes, but for the last of a lag [s]."""
        return self.shape.takes

    @property
    def start(self) -> float:
        """Return when the acceleration begins [s]."""
        return self.t - self.shape.lag - self.shape.ahead

    @property
    def stop(self) -> float:
        """Return when it ends [s]."""
        return self.start + self.shape.spans + FADED * self.shape.slowest

    @property
    def halves(self) -> tuple['Bend', ...]:
        """Return the stop and the start that it is; itself where it is not both."""
        part, apart = self.shape.part, self.shape.apart
        if part <= 0.0 or apart <= 0.0:
            return (self,)
        shape = self.shape._replace(part=0.0, wait=0.0)
        stop = replace(self, t=self.t - (1.0 - part) * apart, turn=part * self.turn, shape=shape)
        start = replace(self, t=self.t + part * apart, turn=(1.0 - part) * self.turn, shape=shape)
        return stop, start

    def beyond(self, t: FloatArray) -> FloatArray:
        """Return by how much the path is beyond the straight pieces at times within [m]."""
        beyond = rounded(t - self.t, self.shape)
        if self.shape.lag > 0.0:
            # What a lag leaves at its end would be a jump of the tool.
            left = rounded(np.array([self.stop - self.t]), self.shape)
            beyond -= left * (t - self.start) / (self.stop - self.start)
        return self.turn * beyond


@kernel(error_model='numpy')
def _fading(since, lag, swing, value, slope):  # type: ignore[no-untyped-def]
    """Return what a servo that is left to itself with a value and a slope has after a time."""
    decay = -0.5 / (swing * lag)
    spread = 4.0 * swing - 1.0
    if abs(spread) < _CRITICAL:
        # Of sine and cosine, or their hyperbolic fellows, no more is left.
        square = spread * (decay * since) ** 2
        turned = (slope - decay * value) * since * (1.0 - square / 6.0)
        return math.exp(decay * since) * (value * (1.0 - 0.5 * square) + turned)
    if spread > 0.0:
        rate = -decay * math.sqrt(spread)
        turned = (slope - decay * value) / rate * math.sin(rate * since)
        return math.exp(decay * since) * (value * math.cos(rate * since) + turned)
    root = math.sqrt(-spread)
    # The slower one as a quotient: the sum cancels where there is almost no swing.
    slow, quick = -2.0 / (lag * (1.0 + root)), decay * (1.0 + root)
    left = (slope - quick * value) * math.exp(slow * since)
    return (left - (slope - slow * value) * math.exp(quick * since)) / (slow - quick)


@kernel(error_model='numpy')
def _behind(since, lag, swing, order):  # type: ignore[no-untyped-def]
    """Return by how much a servo lags behind an even acceleration: its speed, way, or integral."""
    if order == 0:
        if swing > _STIFF:
            return lag - _fading(since, lag, swing, lag, -1.0)
        return -lag * np.expm1(-since / lag)
    if order == 1:
        if swing > _STIFF:
            ahead = lag * lag * (1.0 - swing)
            return lag * since - ahead + _fading(since, lag, swing, ahead, -lag)
        return lag * since + lag * lag * np.expm1(-since / lag)
    if swing > _STIFF:
        ahead = lag * lag * (1.0 - swing)
        level = -lag * lag * lag * (1.0 - 2.0 * swing)
        fading = _fading(since, lag, swing, level, ahead)
        return fading - level - since * (ahead - 0.5 * lag * since)
    return lag * (0.5 * since * since - lag * since - lag * lag * np.expm1(-since / lag))


# Inlined where it is short only: a kernel of nothing but inlined ones takes a minute to compile.
@kernel(error_model='numpy', inline='always')
def _travel(since, lag, swing, order):  # type: ignore[no-untyped-def]
    """Return the speed of a tool that is accelerated evenly for a time, its way, or integral."""
    if since <= 0.0:
        return 0.0
    way = since
    if order > 0:
        way = 0.5 * since * since if order == 1 else since * since * since / 6.0
    if lag > 0.0:
        way -= _behind(since, lag, swing, order)
    return way


@kernel(error_model='numpy')
def _left_at_end(duration, jerk, lag, swing):  # type: ignore[no-untyped-def]
    """Return what a servo has still to go when the command is at its end, and its speed."""
    if lag <= 0.0:
        return 0.0, 0.0
    if jerk <= _SOFT * duration or duration < _BRIEFEST:
        way = _travel(duration, lag, swing, 1) / duration
        return way - 0.5 * duration + lag, _travel(duration, lag, swing, 0) / duration - 1.0
    way = speed = 0.0
    for since, sign in ((duration + jerk, 1.0), (duration, -1.0), (jerk, -1.0)):
        way += sign * _travel(since, lag, swing, 2)
        speed += sign * _travel(since, lag, swing, 1)
    way /= duration * jerk
    return way - 0.5 * (duration + jerk) + lag, speed / (duration * jerk) - 1.0


@kernel(error_model='numpy')
def _gone(at, duration, jerk, lag, swing, left, speed):  # type: ignore[no-untyped-def]
    """Return the way of a tool whose speed changes by one, from when half of it has come on."""
    half = 0.5 * duration
    soft = 0.5 * jerk
    at_once = jerk <= _SOFT * duration or duration < _BRIEFEST
    end = half if at_once else half + soft
    if at <= -end:
        return 0.0
    if at >= end:
        # A servo that is left to itself takes one exponential, not one for each part of a command.
        if lag <= 0.0:
            return at
        if swing <= _STIFF:
            return at - lag + left * np.exp((end - at) / lag)
        return at - lag + _fading(at - end, lag, swing, left, speed)
    if at_once:
        return _travel(at + half, lag, swing, 1) / duration
    way = _travel(at + half + soft, lag, swing, 2) - _travel(at + half - soft, lag, swing, 2)
    way -= _travel(at - half + soft, lag, swing, 2)
    return way / (duration * jerk)


@kernel(error_model='numpy')
def _beyond(  # type: ignore[no-untyped-def]
    away, duration, jerk, lag, swing, part, wait, left, speed
):
    """Return by how much a corner is passed, over the change of speed."""
    at = away + lag
    if part > 0.0:
        apart = duration + jerk + wait
        stop, start = at + (1.0 - part) * apart, at - part * apart
        way = part * _gone(stop, duration, jerk, lag, swing, left, speed)
        way += (1.0 - part) * _gone(start, duration, jerk, lag, swing, left, speed)
    else:
        way = _gone(at, duration, jerk, lag, swing, left, speed)
    return way - max(away, 0.0)


@kernel(error_model='numpy')
def _rounded(away, how, beyond):  # type: ignore[no-untyped-def]
    duration, jerk, lag, swing, part, wait = how
    left, speed = _left_at_end(duration, jerk, lag, swing)
    for i in range(away.size):
        beyond[i] = _beyond(away[i], duration, jerk, lag, swing, part, wait, left, speed)


def rounded(away: FloatArray, shape: Shape) -> FloatArray:
    """
    Return by how much a corner is passed, over the change of speed.

    Parameters
    ----------
    away : ndarray, shape (n,)
        Times from when the straight pieces would meet [s].
    shape : Shape
        How the speed changes; one without a duration is a sharp corner.

    Returns
    -------
    ndarray, shape (n,)
        Above zero, but where a servo swings [s].

    """
    beyond = np.empty(away.size)
    _rounded(away, _numbers(shape), beyond)
    return beyond


class Corner(NamedTuple):
    """
    What the encoders tell of one change of speed.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        Their samples near it [s, m].
    level, slope, next_level, next_slope : float
        The straight lines before and after it, at time zero [m, m/s].
    rest : int
        Which of the two is a rest, 0 or 1; -1 for none.
    coarse : float
        By how much the encoders round [m]; zero if they do not.
    noise : float
        Standard deviation of a sample [m].

    """

    t: FloatArray
    value: FloatArray
    level: float
    slope: float
    next_level: float
    next_slope: float
    rest: int
    coarse: float
    noise: float

    @property
    def turn(self) -> float:
        """Return the change of speed [m/s]."""
        return self.next_slope - self.slope

    @property
    def share(self) -> float:
        """Return the change of speed over the higher speed: 1 for a stop, 2 for a turn [-]."""
        return abs(self.turn) / max(abs(self.slope), abs(self.next_slope))

    @property
    def part(self) -> float:
        """Return the part of a turn that is a stop; zero for what is none [-]."""
        if self.slope * self.next_slope >= 0.0 or self.is_stop or self.is_start:
            return 0.0
        return abs(self.slope) / (abs(self.slope) + abs(self.next_slope))

    @property
    def is_start(self) -> bool:
        """Return whether the tool was at rest."""
        return abs(self.slope) < _RESTING * abs(self.next_slope)

    @property
    def is_stop(self) -> bool:
        """Return whether the tool comes to rest."""
        return abs(self.next_slope) < _RESTING * abs(self.slope)

    @property
    def shifts(self) -> FloatArray:
        """Return where a tool at rest may be beside its reading; shape (k,) [m]."""
        if self.rest < 0:
            return np.zeros(1)
        return np.linspace(-self.coarse, self.coarse, RESTS)

    def best(
        self,
        shift: float,
        longest: float,
        soft: float,
        lag: float | None = None,
        *,
        roughly: bool = False,
    ) -> tuple[Shape, float]:
        """
        Return the acceleration that follows the samples best, without a swing.

        Parameters
        ----------
        shift : float
            Where the tool rests beside its reading [m].
        longest : float
            How long it may last [s].
        soft : float
            Part of how long it lasts over which it comes, and goes [-].
        lag : float, optional
            How late the servo is [s]; looked for where it is not given.
        roughly : bool
            Whether what it leaves is wanted more than how long it lasts.

        Returns
        -------
        shape : Shape
            The best.
        squares : float
            What it leaves of the samples [m^2].

        """
        known = self.t, self.value, self._lines, self.rest, self.coarse, shift, longest, soft
        worth = SHOWN * self.noise**2
        left, duration, late = _best(
            *known, -1.0 if lag is None else lag, longest * (_ROUGH if roughly else _FINEST), worth
        )
        return Shape(duration, soft * duration, late), left

    @property
    def noisiness(self) -> float:
        """Return the noise over the way that the change of speed makes here [-]."""
        way = abs(self.turn) * float(self.t[-1] - self.t[0])
        if self.rest >= 0 or self.coarse > 0.0 or way == 0.0:
            return math.inf
        return self.noise / way

    @property
    def is_clean(self) -> bool:
        """Return whether the encoders neither round nor have noise that matters here."""
        return self.noisiness < _CLEAN

    def beside(self, shape: Shape) -> FloatArray:
        """Return what a shape leaves of each sample over the noise; shape (n,) [-]."""
        meeting = self.meeting(0.0)[0]
        before = self.t < meeting
        line = np.where(
            before, self.level + self.slope * self.t, self.next_level + self.next_slope * self.t
        )
        left = self.value - line - self.turn * rounded(self.t - meeting, shape)
        return np.asarray(left / self.noise)

    def left(self, shape: Shape, shift: float) -> float:
        """Return what one shape leaves of the samples with a rest at a shift [m^2]."""
        others = self._lines, self.rest, self.coarse, shift
        return float(_left_by(self.t, self.value, *others, _numbers(shape)))

    def deviance(self, shape: Shape, most: float = math.inf) -> float:
        """Return minus twice the log likelihood of a shape wherever the tool rests, at most."""
        others = self._lines, self.rest, self.coarse, self.noise
        return min(float(_deviance(self.t, self.value, *others, _numbers(shape), most)), most)

    @property
    def _lines(self) -> tuple[float, float, float, float]:
        return self.level, self.slope, self.next_level, self.next_slope

    def rested(self, shape: Shape) -> float:
        """
        Return where the tool rests beside its reading [m].

        A tool at rest reads the same wherever it is within a step of its encoders; how it comes
        there tells more: the mean over the step, by how likely the readings beside the rest are.
        """
        return self.likely(np.array([self.left(shape, shift) for shift in self.shifts.tolist()]))

    def likely(self, squares: FloatArray) -> float:
        """Return the mean of `shifts`, by how likely they are with what they leave [m]."""
        likely = np.exp(-0.5 * (squares - squares.min()) / self.noise**2)
        return float(likely @ self.shifts / likely.sum())

    def meeting(self, shift: float) -> tuple[float, float]:
        """Return when and at which level the lines meet with a rest at a shift [s, m]."""
        level = self.level + (shift if self.rest == 0 else 0.0)
        next_level = self.next_level + (shift if self.rest == 1 else 0.0)
        t = (level - next_level) / self.turn
        return t, level + self.slope * t


@kernel(error_model='numpy')
def _missed(t, value, lines, rest, coarse, shift, how, most):  # type: ignore[no-untyped-def]
    """Return the squares that a shape leaves where the tool rests at a shift, up to the most."""
    level, slope, next_level, next_slope = lines
    duration, jerk, lag, swing, part, wait = how
    to_go, speed = _left_at_end(duration, jerk, lag, swing)
    turn = next_slope - slope
    if rest == 0:
        level += shift
    elif rest == 1:
        next_level += shift
    meeting = (level - next_level) / turn
    total = 0.0
    for i in range(t.size):
        before = t[i] < meeting
        line = level + slope * t[i] if before else next_level + next_slope * t[i]
        miss = value[i] - line
        away = t[i] - meeting
        left = miss
        left -= turn * _beyond(away, duration, jerk, lag, swing, part, wait, to_go, speed)
        if rest >= 0 and before == (rest == 0) and abs(miss) <= ROUNDED * coarse:
            left = max(abs(left) - coarse, 0.0)
        total += left * left
        if total > most:
            break
    return total


def _numbers(shape: Shape) -> tuple[float, float, float, float, float, float]:
    """Return the numbers of a shape as a kernel takes them."""
    lasts = max(shape.duration, 1e-9)
    return lasts, shape.soft * lasts, shape.lag, shape.swing, shape.part, shape.wait


@kernel(error_model='numpy')
def _left_by(t, value, lines, rest, coarse, shift, how):  # type: ignore[no-untyped-def]
    return _missed(t, value, lines, rest, coarse, shift, how, np.inf)


@kernel(error_model='numpy')
def _best_duration(  # type: ignore[no-untyped-def]
    t, value, lines, rest, coarse, shift, longest, soft, lag, finest
):
    """Return what an acceleration leaves that lasts as long as is best, and how long that is."""
    shortest = max(_BRIEF * lag, 1e-9)
    width = longest / (_DURATIONS - 1)
    least = np.inf
    best = 0.0
    for k in range(_DURATIONS):
        # The one in the middle is often the best, beside which the others are seen soon.
        lasts = ((k + _DURATIONS // 2) % _DURATIONS) * width
        how = max(lasts, shortest), soft * max(lasts, shortest), lag, 0.0, 0.0, 0.0
        left = _missed(t, value, lines, rest, coarse, shift, how, least)
        # The shortest of those that leave as much.
        if left < least or (left == least and lasts < best):
            least = left
            best = lasts
    # Brent's search in a bracket: by parabolas, or the golden section where these lead nowhere.
    low = max(best - width, 0.0)
    high = best + width
    second = third = best
    next_least = last_least = least
    step = before = 0.0
    for _ in range(_LOOKS):
        middle = 0.5 * (low + high)
        if least <= 0.0 or abs(best - middle) + 0.5 * (high - low) <= 2.0 * finest:
            break
        golden = True
        if abs(before) > finest:
            r = (best - second) * (least - last_least)
            q = (best - third) * (least - next_least)
            p = (best - third) * q - (best - second) * r
            q = 2.0 * (q - r)
            if q > 0.0:
                p = -p
            q = abs(q)
            if abs(p) < abs(0.5 * q * before) and q * (low - best) < p < q * (high - best):
                before = step
                step = p / q
                golden = False
                if min(best + step - low, high - best - step) < 2.0 * finest:
                    step = math.copysign(finest, middle - best)
        if golden:
            before = (low if best >= middle else high) - best
            step = _GOLDEN * before
        lasts = best + (step if abs(step) >= finest else math.copysign(finest, step))
        how = max(lasts, shortest), soft * max(lasts, shortest), lag, 0.0, 0.0, 0.0
        left = _missed(t, value, lines, rest, coarse, shift, how, np.inf)
        if left <= least:
            if lasts >= best:
                low = best
            else:
                high = best
            third, last_least = second, next_least
            second, next_least = best, least
            best, least = lasts, left
            continue
        if lasts < best:
            low = lasts
        else:
            high = lasts
        if left <= next_least or second == best:
            third, last_least = second, next_least
            second, next_least = lasts, left
        elif left <= last_least or third in (best, second):
            third, last_least = lasts, left
    return least, max(best, _BRIEF * lag)


@kernel(error_model='numpy')
def _best(  # type: ignore[no-untyped-def]
    t, value, lines, rest, coarse, shift, longest, soft, lag, finest, worth
):
    """Return what the best acceleration leaves, how long it lasts, and its lag if that is seen."""
    given = max(lag, 0.0)
    left, duration = _best_duration(
        t, value, lines, rest, coarse, shift, longest, soft, given, finest
    )
    if lag >= 0.0:
        return left, duration, lag
    least = left
    lasts = duration
    late = 0.0
    width = 0.25 * longest / _LAGS
    middle = 0.5 * (_LAGS + 1) * width
    reach = _LAGS // 2
    for _ in range(1 + _HALVINGS):
        for k in range(-reach, reach + 1):
            each = middle + k * width
            if each > 0.0 and each != late:
                other, its = _best_duration(
                    t, value, lines, rest, coarse, shift, longest, soft, each, finest
                )
                if other < least:
                    least, lasts, late = other, its, each
        # Beside the best, on both sides.
        middle, width, reach = late, 0.5 * width, 1
    if least < left - worth:
        return least, lasts, late
    return left, duration, 0.0


@kernel(error_model='numpy')
def _deviance(t, value, lines, rest, coarse, noise, how, most):  # type: ignore[no-untyped-def]
    """Return minus twice the log likelihood of a shape, wherever the tool rests."""
    count = RESTS if rest >= 0 else 1
    scaled = np.empty(count)
    variance = noise * noise
    least = np.inf
    for k in range(count):
        # From the middle on to both sides: what is much less likely than others is not summed up.
        j = count // 2 + ((k + 1) // 2 if k % 2 else -(k // 2))
        shift = coarse * (2.0 * j / (RESTS - 1) - 1.0) if count > 1 else 0.0
        enough = variance * (min(least, most) + _UNLIKELY)
        scaled[j] = _missed(t, value, lines, rest, coarse, shift, how, enough) / variance
        least = min(least, scaled[j])
    total = 0.0
    for j in range(count):
        total += math.exp(-0.5 * (scaled[j] - least))
    return least - 2.0 * math.log(total / count)


@dataclass(frozen=True, slots=True)
class Servo:
    """
    How an arm makes all its changes of speed.

    Parameters
    ----------
    duration : float
        How long the acceleration lasts [s], or where `even` how long for a change of 1 m/s.
    jerk : float
        How long the acceleration takes to come [s]; over how long it lasts where this is not
        `even`, or all of it is drawn out.
    lag : float
        How late the arm is [s].
    even : bool
        Whether the acceleration is the same for all changes, and not its duration.
    lasts : float
        How long the acceleration of a usual change of speed lasts [s].
    stops : bool
        Whether it makes only the stops so.
    others : Servo or None
        How it makes the others then, if these are alike.
    swing : float
        How it swings [-].
    scaled : bool
        Whether `duration` is that of a stop, and in proportion for parts of the speed and for its
        reversal, as of an arm whose acceleration is scaled with its speed; `jerk` is over that of
        a stop then.
    parted : bool
        Whether it makes a turn as a stop and a start, one right after the other.
    wait : float
        How long it rests between the two [s].
    drawn_out : bool
        Whether a larger change of an `even` acceleration is the same over a longer time, and not
        limited in its jerk.

    """

    duration: float
    jerk: float
    lag: float
    even: bool
    lasts: float
    stops: bool = False
    others: 'Servo | None' = None
    swing: float = 0.0
    scaled: bool = False
    parted: bool = False
    wait: float = 0.0
    drawn_out: bool = False

    def of(self, corner: Corner) -> 'Servo | None':
        """Return what makes a change of speed; None where it is not one of those made alike."""
        return self if corner.is_stop or not self.stops else self.others

    def changed(self, duration: float, lag: float, jerk: float, swing: float = 0.0) -> 'Servo':
        """
        Return an arm that does it somewhat otherwise.

        Parameters
        ----------
        duration : float
            Logarithm of the ratio of how long the acceleration lasts. Of an arm that waits it is
            that of what is brisk beside the wait, if that is more, and the wait gets shorter by
            what is added.
        lag, jerk : float
            What is added to lag and jerk, over how long a change of speed lasts; none of both
            gets below zero.
        swing : float
            Logarithm of the ratio of how it swings.

        """
        scale = self.lasts
        soft = min(max(self.jerk + jerk * self._softest, 0.0), self._softest)
        lasts, wait = self.duration * math.exp(duration), self.wait
        if self._may_wait:
            # An arm that stops at once may as well do so over a while.
            more = math.expm1(duration) * max(self.duration, BRISK * wait)
            more = min(max(more, -self.duration), wait)
            lasts, wait = self.duration + more, wait - more
        return replace(
            self,
            duration=lasts,
            wait=wait,
            jerk=soft,
            lag=max(self.lag + lag * scale, 0.0),
            swing=self.swing * math.exp(swing),
        )

    @property
    def _may_wait(self) -> bool:
        return self.wait > 0.0 and not self.even

    def inward(self, duration: float, lag: float, jerk: float) -> tuple[float, float, float]:
        """Return which way each goes from a limit that is nearer than a change: 1 or -1, or 0."""
        scale = self.lasts
        short = self._may_wait and self.duration < duration * BRISK * self.wait
        jerk *= self._softest
        soft = 1.0 if self.jerk < jerk else -1.0 if self.jerk > self._softest - jerk else 0.0
        return 1.0 if short else 0.0, 1.0 if self.lag < lag * scale else 0.0, soft

    @property
    def _softest(self) -> float:
        return self.lasts if self.even and not self.drawn_out else 1.0

    def at(self, corner: Corner) -> Shape:
        """Return how the change of speed of a corner goes."""
        if self.parted and corner.part > 0.0:
            half = self.shape(0.5 * corner.turn)
            return half._replace(part=corner.part, wait=self.wait)
        return self.shape(corner.turn, corner.share)

    def shape(self, turn: float, share: float = 1.0) -> Shape:
        """Return how a change of speed [m/s] goes, of a part `share` of the speed."""
        if self.scaled:
            duration = max(self.duration * share, 1e-9)
            jerk = self.jerk * self.duration
            return Shape(max(duration, jerk), min(duration, jerk), self.lag, self.swing)
        if not self.even:
            return Shape(self.duration, self.jerk * self.duration, self.lag, self.swing)
        duration = max(self.duration * abs(turn), 1e-9)
        if self.drawn_out:
            return Shape(duration, self.jerk * duration, self.lag, self.swing)
        return Shape(max(duration, self.jerk), min(duration, self.jerk), self.lag, self.swing)


def polished(
    corners: Sequence[Corner],
    shape: Callable[[FloatArray, Corner], Shape],
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """
    Return how changes of speed go that clean encoders tell, by least squares.

    What they tell is a valley too narrow for a search that compares sums of squares.

    Parameters
    ----------
    corners : sequence of Corner
        All of encoders that neither round nor read a rest alike.
    shape : callable
        How each goes by the numbers that are looked for.
    start : ndarray, shape (k,)
        Numbers near the best, of the order of one.
    bounds : (ndarray, ndarray)
        Least and greatest ones, shapes (k,).

    Returns
    -------
    ndarray, shape (k,)
        The best numbers near by.

    """

    def left(x: FloatArray) -> FloatArray:
        # What is left of clean samples is small beside the one that stands at the end.
        return np.concatenate([*(corner.beside(shape(x, corner)) for corner in corners), [1.0]])

    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        here = left(x)
        jacobian = np.empty((here.size, x.size))
        for k in range(x.size):
            # Away from a bound, beyond which nothing changes.
            step = _PROBE if x[k] + _PROBE <= bounds[1][k] else -_PROBE
            moved = x.copy()
            moved[k] += step
            jacobian[:, k] = (left(moved) - here) / step
        return here, jacobian

    return minimise(evaluate, start, bounds, tolerance=_TELLING, max_evaluations=_POLISHED).theta


def told(corners: Sequence[Corner], servo: Servo) -> float:
    """Return minus twice the log likelihood of how an arm changes its speed."""
    total = 0.0
    for corner in corners:
        mine = servo.of(corner)
        total += 0.0 if mine is None else corner.deviance(mine.at(corner))
    return total


def is_apart(corner: Corner, alone: float, servo: Servo) -> bool:
    """
    Return whether a change of speed is not made as an arm makes the others.

    Parameters
    ----------
    corner : Corner
        What the encoders tell of it.
    alone : float
        The deviance that its own shape leaves of it.
    servo : Servo
        How the arm makes the others.

    """
    mine = servo.of(corner)
    return mine is not None and corner.deviance(mine.at(corner)) > alone + _APART


class _Kind(NamedTuple):
    """What a search for a servo goes by: how long it lasts as usual, and the scale of its lag."""

    even: bool
    usual: float
    scale: float
    scaled: bool = False
    parted: bool = False
    waits: bool = False
    drawn_out: bool = False
    # The tool follows at once.
    prompt: bool = False


def _servo(x: FloatArray, kind: _Kind) -> Servo:
    """
    Return the servo of a search.

    It is given by how long over the usual (logarithm), lag, part that comes, and swing; one that
    is prompt by how long and the part that comes; one that waits by how long it does so, how long
    it takes to stop and to start, and lag, over the scale, and part that comes.
    """
    if kind.waits:
        wait, *others = np.maximum(x, 0.0).tolist()
        duration, lag, jerk = [*others, 0.0, 0.0, 0.0][:3]
        return Servo(
            kind.usual * duration,
            min(jerk, 1.0) * (kind.scale if kind.even else 1.0),
            lag * kind.scale,
            kind.even,
            kind.scale,
            parted=True,
            wait=wait * kind.scale,
        )
    if kind.prompt:
        x = np.insert(x, 1, 0.0)
    lag = max(float(x[1]), 0.0) if x.size > 1 else 0.0
    jerk = min(max(float(x[2]), 0.0), 1.0) if x.size > 2 else 0.0
    return Servo(
        kind.usual * math.exp(float(x[0])),
        jerk * kind.scale if kind.even and not kind.drawn_out else jerk,
        lag * kind.scale,
        kind.even,
        kind.scale,
        swing=min(max(float(x[3]), 0.0), WILDEST) if x.size > 3 else 0.0,
        scaled=kind.scaled,
        parted=kind.parted,
        drawn_out=kind.drawn_out,
    )


def _left(
    corners: Sequence[tuple[Corner, float]],
    kind: _Kind,
    longest: float,
    x: FloatArray,
) -> float:
    """Return minus twice the log likelihood of a servo, beside that of each corner by itself."""
    negative = x < 0.0
    # How long it takes is a logarithm, but not of one that waits.
    negative[0] = negative[0] and kind.waits
    if negative.any():
        return math.inf
    servo = _servo(x, kind)
    shapes = [servo.at(corner) for corner, _ in corners]
    if max(sum(shape[:3]) for shape in shapes) > longest:
        return math.inf
    # A tool that has not come to rest before it turns again, or a hand on it, is no other arm.
    return sum(
        corner.deviance(shape, alone + _APART)
        for (corner, alone), shape in zip(corners, shapes, strict=True)
    )


def servo_of(corners: Sequence[Corner], shapes: Sequence[Shape]) -> Servo | None:
    """
    Return how an arm makes all its changes of speed, if they are alike.

    Parameters
    ----------
    corners : sequence of Corner
        What the encoders tell of each.
    shapes : sequence of Shape
        What each tells by itself.

    Returns
    -------
    Servo or None
        None where the changes of speed differ by more than the encoders' noise, by Schwarz's
        criterion, or there are too few; some may be apart from the others (`is_apart`). Stops
        and the other changes may differ, and be alike among themselves, or the stops alone; where
        they differ only in how long they last, one controller makes both.

    """
    worth = math.log(max(sum(corner.t.size for corner in corners), 1))
    whole = _alike(corners, shapes, worth)
    kinds = []
    for stops in (True, False):
        of = [k for k, corner in enumerate(corners) if corner.is_stop == stops]
        kinds.append(([corners[k] for k in of], [shapes[k] for k in of]))
    (cost, stopped), (other_cost, others) = (_alike(*kind, worth) for kind in kinds)
    cost += other_cost
    if min(len(kind) for kind, _ in kinds) >= _FEWEST:
        left, first, second = _kindred(*(_largest(*kind) for kind in kinds))
        if left + 4 * worth < cost:
            cost, stopped, others = left + 4 * worth, first, second
    if stopped is None or (whole[1] is not None and whole[0] <= cost):
        return whole[1]
    if lasting(kinds[0][0], stopped) <= SHOWN:
        return whole[1]
    return replace(stopped, stops=True, others=others)


def lasting(corners: Sequence[Corner], servo: Servo) -> float:
    """
    Return by how much changes of speed show that they take time.

    Parameters
    ----------
    corners : sequence of Corner
        What the encoders tell of each.
    servo : Servo
        How the arm makes them.

    Returns
    -------
    float
        The drop of minus twice the log likelihood against changes at once.

    """
    at_once = [corner.deviance(Shape(0.0)) - told([corner], servo) for corner in corners]
    # One that is apart from the others tells nothing of these.
    return sum(max(each, -_APART) for each in at_once)


def _kindred(
    stops: tuple[list[Corner], list[Shape]], others: tuple[list[Corner], list[Shape]]
) -> tuple[float, Servo, Servo]:
    """Return how one controller makes stops, and others that last otherwise; what that leaves."""
    usual = [
        float(np.median([shape.duration for shape in shapes])) for _, shapes in (stops, others)
    ]
    scale = max(*usual, 1e-6)
    lags = [shape.lag for _, shapes in (stops, others) for shape in shapes]
    swings = [shape.swing for _, shapes in (stops, others) for shape in shapes]

    def servos(x: FloatArray) -> tuple[Servo, Servo]:
        first, second = (
            _servo(np.array([size, *x[2:]]), _Kind(False, max(each, 1e-6), scale))
            for size, each in zip(x[:2], usual, strict=True)
        )
        return first, second

    def cost(x: FloatArray) -> float:
        if np.any(x[2:] < 0.0) or np.any(np.abs(x[:2]) > _LONGEST):
            return math.inf
        made = servos(x)
        return sum(told(of, servo) for (of, _), servo in zip((stops, others), made, strict=True))

    swing = float(np.median(swings))
    size = 5 if swing > 0.0 else 4
    start = np.array([0.0, 0.0, float(np.median(lags)) / scale, 0.5, swing])[:size]
    sizes = np.array([0.3, 0.3, 0.3, 0.4, 0.3])[:size]
    left, best = minimum(cost, start, sizes, near=0.0, turns=_MORE_TURNS)
    return left, *servos(best)


def _largest(
    corners: Sequence[Corner], shapes: Sequence[Shape]
) -> tuple[list[Corner], list[Shape]]:
    """Return the changes of speed that tell most, some of each size."""
    order = np.argsort([-abs(corner.turn) / corner.noise for corner in corners])
    chosen = order[np.unique(np.linspace(0, order.size - 1, _MOST).round().astype(int))].tolist()
    return [corners[k] for k in chosen], [shapes[k] for k in chosen]


def _alike(
    corners: Sequence[Corner], shapes: Sequence[Shape], worth: float
) -> tuple[float, Servo | None]:
    """
    Return how an arm makes some changes of speed, if they are alike, and what that leaves.

    Each number that says so is worth something; what is left by a shape for each is told where
    they are not alike.
    """
    if len(corners) < _FEWEST:
        return sum(c.deviance(s) for c, s in zip(corners, shapes, strict=True)), None
    corners, shapes = _largest(corners, shapes)
    each = [(c, c.deviance(s)) for c, s in zip(corners, shapes, strict=True)]
    alone = sum(own + 2.0 * worth for _, own in each)
    lasts = np.array([shape.duration for shape in shapes])
    turns = np.abs([corner.turn for corner in corners])
    longest = _LONGEST * float((lasts + np.array([shape.lag for shape in shapes])).max())
    lag, soft = (float(np.median([each[of] for each in shapes])) for of in (2, 1))
    soft = min(soft / max(float(np.median(lasts)), 1e-9), 1.0)
    clean = float(np.median([corner.noisiness for corner in corners])) < _CLEAN
    found: list[tuple[float, float, FloatArray, _Kind]] = []
    shares = np.array([corner.share for corner in corners])
    kinds = [('even', turns, False), ('alike', np.ones(turns.size), False)]
    if np.ptp(turns) > _LIKE * float(turns.max()):
        kinds.append(('drawn out', turns, False))
    if np.ptp(shares) > _LIKE:
        kinds.append(('scaled', shares, False))
    turning = np.array([corner.part > 0.0 for corner in corners])
    if turning.any():
        # How long each half of a turn lasts.
        whole = turning & np.array([shape.part == 0.0 for shape in shapes])
        if all(abs(corner.part - 0.5) < _EVENLY for corner in corners if corner.part > 0.0):
            # Two of unequal speeds take unequal times where the acceleration is the same.
            kinds.append(('even', np.where(turning & ~whole, 0.5, 1.0) * turns, True))
        kinds.append(('alike', np.where(whole, 2.0, 1.0), True))
    for name, sizes, parted in kinds:
        usual = float(np.median(lasts / sizes))
        scale = usual * float(np.median(sizes))
        if usual <= 0.0:
            continue
        drawn = name == 'drawn out'
        kind = _Kind(name == 'even' or drawn, usual, scale, name == 'scaled', parted, False, drawn)
        cost = partial(_left, each, kind, longest)
        # With less than three numbers it is as where the jerk is limited.
        sizes_of_starts = (3,) if drawn else (1, 2, 3)
        starts = [np.array([0.0, lag / scale, 0.5])[:size] for size in sizes_of_starts]
        swinging = _swinging(shapes, turns, usual, sizes)
        if clean:
            for start in (np.array([0.0, lag / scale, soft]), *swinging):
                best = _clean(each, kind, start)
                left = cost(best)
                found.append((left + start.size * worth, left, best, kind))
            continue
        begun = [(kind, False, start) for start in swinging]
        # Beside a start that is far off all are apart, and no way leads to where they are alike.
        begun += [(kind, True, start) for start in [*starts, *swinging]]
        # A moving average of commands that have a ramp, which the tool follows at once.
        begun.append((kind._replace(prompt=True), True, np.array([0.0, 0.5])))
        for which, at_all, start in begun:
            sought = [(corner, math.inf) for corner in corners] if at_all else each
            cost = partial(_left, sought, which, longest)
            _, best = minimum(cost, start, _SEARCHED[: start.size], hopeful=_within_bounds)
            left = _left(each, which, longest, best)
            found.append((left + start.size * worth, left, best, which))
    first: dict[_Kind, tuple[float, float, FloatArray]] = {}
    for worst, left, x, kind in found:
        if kind not in first or worst < first[kind][0]:
            first[kind] = worst, left, x
    # The first search of a kind may end far from its best, and another kind then look better.
    closer = [(*_closest(each, kind, longest, *one), kind) for kind, one in first.items()]
    rivals = [*found, *closer]
    for waits in _waiting(each, shapes, clean=clean, longest=longest, worth=worth):
        # No arm stops at once: where encoders do not tell it from a turn that takes a while and
        # no more numbers, it is that.
        as_few = [left for _, left, x, _ in rivals if x.size <= waits[2].size]
        if waits[1] < min(as_few, default=math.inf) - SHOWN:
            closer.append((*_closest(each, waits[3], longest, *waits[:3]), waits[3]))
    if not closer:
        return alone, None
    worst, _, x, kind = min(closer, key=lambda one: one[0])
    return (alone, None) if worst > alone else (worst, _servo(x, kind))


def _within_bounds(_: int, least: float) -> bool:
    """Return whether a search goes on: among servos all out of bounds nothing leads anywhere."""
    return math.isfinite(least)


def _closest(
    each: Sequence[tuple[Corner, float]],
    kind: _Kind,
    longest: float,
    worst: float,
    left: float,
    x: FloatArray,
) -> tuple[float, float, FloatArray]:
    """Return a servo to which a search leads that is begun again and again, as it was given."""
    cost = partial(_left, each, kind, longest)
    for _ in range(_MORE_SEARCHES):
        # Clear changes of speed tell much more than the first search asks for: two points may be
        # near and one of them by far the better.
        closer, point = minimum(
            cost, x, _SEARCHED[: x.size], near=0.0, turns=_MORE_TURNS, hopeful=_within_bounds
        )
        if not math.isfinite(closer) or left - closer < 1.0:
            break
        worst, left, x = worst - left + closer, closer, point
    return worst, left, x


def _waiting(
    each: Sequence[tuple[Corner, float]],
    shapes: Sequence[Shape],
    *,
    clean: bool,
    longest: float,
    worth: float,
) -> list[tuple[float, float, FloatArray, _Kind]]:
    """
    Return arms that turn by a stop and a start with a wait between them.

    With what they are worth, what they leave, and their numbers. Encoders see a short wait much
    as they see a slow turn; what takes fewer numbers is the likelier one.
    """
    waits, others = list[float](), list[float]()
    for (corner, _), shape in zip(each, shapes, strict=True):
        if corner.part > 0.0:
            waits.append(shape.as_wait(corner.part))
        else:
            others.append(shape.duration)
    scale = float(np.median(waits)) if waits else 0.0
    if scale <= 0.0:
        return []
    brief = min(float(np.median(others)) / scale, 1.0) if others else BRISK
    found = []
    sizes = np.array([(0.5 if c.part > 0.0 else 1.0) * abs(c.turn) for c, _ in each])
    evenly = [False, True] if float(np.ptp(sizes)) > _LIKE * float(sizes.max()) else [False]
    for even, size in product(evenly, (1, 2, 3, 4)):
        if even and size == 1:
            continue
        usual = scale / float(np.median(sizes)) if even else scale
        kind = _Kind(even, usual, scale, parted=True, waits=True)
        start = np.array([1.0, brief, BRISK, 0.5])[:size]
        if clean:
            best = _clean(each, kind, start)
        else:
            at_all = partial(_left, [(corner, math.inf) for corner, _ in each], kind, longest)
            _, best = minimum(at_all, start, BRISK * np.array([1.0, 1.0, 1.0, 2.0])[:size])
        left = _left(each, kind, longest, best)
        found.append((left + size * worth, left, best, kind))
    return found


def _clean(each: Sequence[tuple[Corner, float]], kind: _Kind, start: FloatArray) -> FloatArray:
    """Return how an arm makes most changes of speed that clean encoders tell, as `_servo` does."""
    bounds = np.array([-_LONGEST, 0.0, 0.0, 0.0])[: start.size], _BOUNDS[: start.size]
    if kind.waits:
        bounds = np.zeros(start.size), np.array([_LONGEST, _LONGEST, _LONGEST, 1.0])[: start.size]

    def shape(x: FloatArray, corner: Corner) -> Shape:
        return _servo(x, kind).at(corner)

    best = np.clip(start, *bounds)
    each = [(corner, own) for corner, own in each if math.isfinite(corner.noisiness)]
    corners = [corner for corner, _ in each]
    for _ in range(_CLEANER):
        best = polished(corners, shape, best, bounds)
        # Some may be made otherwise, and draw all others with them.
        worse = [corner.deviance(shape(best, corner)) - own for corner, own in each]
        usual = float(np.median(worse))
        nearest = [c for (c, _), w in zip(each, worse, strict=True) if w <= max(usual, _APART)]
        if len(nearest) == len(corners):
            break
        corners = nearest
    return best


def _swinging(
    shapes: Sequence[Shape], turns: FloatArray, usual: float, sizes: FloatArray
) -> list[FloatArray]:
    """
    Return where to begin to look for a servo that swings, as `_servo` takes it.

    How long a change of speed lasts is in proportion to its size.
    """
    scale = usual * float(np.median(sizes))
    seen = [k for k, shape in enumerate(shapes) if shape.swing > 0.0]
    if seen:
        # The largest changes of speed tell most.
        most = _LARGE * max(turns[k] for k in seen)
        seen = [k for k in seen if turns[k] >= most]
        lasts = float(np.median([shapes[k].duration / sizes[k] for k in seen]))
        lag, swing = (float(np.median([shapes[k][of] for k in seen])) for of in (2, 3))
        return [np.array([math.log(max(lasts / usual, _LEAST)), lag / scale, 0.5, swing])]
    # Half of how long it takes otherwise is made by how it swings.
    lag = 0.25 * float(np.median([shape.takes for shape in shapes]))
    return [np.array([math.log(0.5), lag / scale, 0.5, swing]) for swing in SWINGS]
