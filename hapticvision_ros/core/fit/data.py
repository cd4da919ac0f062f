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
Trials as the fit of the whole waveform sees them: steps, and means of samples over them.

The steps of a trial end midway between two force samples. Where nothing happens in a trial, as
late in the hold, steps span many samples, ever more the longer ago the last event is: the mean
force over such a step and the memory of its noise (`hapticvision_ros.core.fit.noise_model`) lose
nothing by it. The tool's displacement at the ends of the steps comes from straight pieces through
the encoders' samples, as many as it takes to follow them within their noise.

"""

from collections.abc import Iterable, Sequence
from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from itertools import pairwise
import math
from types import EllipsisType
from typing import Final, NamedTuple

from hapticvision_ros.core import parallel
from hapticvision_ros.core.fit.bend import (
    Bend,
    BRISK,
    Corner,
    is_apart,
    lasting,
    polished,
    ROUNDED,
    Servo,
    servo_of,
    Shape,
    SHOWN,
    SWINGS,
    WILDEST,
)
from hapticvision_ros.core.fit.glitches import find_glitches, resolution
from hapticvision_ros.core.fit.interpolated import readings
from hapticvision_ros.core.fit.noise import rounding
from hapticvision_ros.core.fit.saturation import at_the_end, end_of_range
from hapticvision_ros.core.fit.short_move import short_move, ShortMove
from hapticvision_ros.core.fit.simplex import minimum
from hapticvision_ros.core.fit.way import keep, kept, Key, smooth, Way
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.models.turns import Turns
from hapticvision_ros.core.outliers import absurd, median_of_five, NORMAL_FROM_MAD, runs
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal, Trial
import numpy as np
from numpy.typing import NDArray

_FEWEST: Final = 16
"""A trial with fewer force samples is not fitted."""
_FIRST: Final = 3
"""Heights at the beginning of a record whose median tells whether the object is pressed in."""
_PRESSED: Final = 0.2
"""Share of the largest displacement height from which on it is."""
_TOUCH_REACH: Final = 8.0
"""The touch is at most so many errors of the detection from the detected one."""
_FEWEST_STAMPS: Final = 8
_BY_THE_CLOCK: Final = 1e-3
_BY_NO_CLOCK: Final = 0.2
_LONG_GAP: Final = 5
"""
Stamps that tell a clock, by which part of a tick exact stamps and those of none are off, and ticks
that are too many to be counted.
"""
_COARSE_STEP: Final = 0.5
"""Over the interval of the heights: a step of one force that is too coarse for these."""
_EVENTFUL_STEPS: Final = 12.0
"""Intervals of the force beside an event in which they are looked at more finely."""
_LOOKS: Final = 0.25
"""Parts of such steps, over the shorter interval."""
_MOST_LOOKS: Final = 400
"""Looks at an event."""
_ASTRAY: Final = 12.0
"""What a height is beyond both its neighbours by, over the noise, from which on it is a glitch."""
_LONE: Final = 2.5
"""Samples beside an event in which one that is alone may be what the object does."""
_ON_LINE: Final = 0.1
"""What those beside it are off a straight line by, over what it is beyond them."""
_NEXT: Final = np.array([-2.0, -1.0, 1.0, 2.0])
"""Where these are, in samples."""
_LONE_STEPS: Final = 12.0
"""Standard deviations of rounding beyond its neighbours from which on a force may be alone."""
_LONGEST_GLITCH: Final = 16
"""Samples in a glitch that is set aside before any fit."""
_SHORTEST_WAY: Final = 5
_AS_USUAL: Final = 3.0
"""Samples over which a tool goes there and back, which a glitch does at once; and steps from one
to the next, over the usual ones there, that are none of a glitch."""
_IN_AIR: Final = 5.0
_IN_CONTACT: Final = 10.0
_CLEAR_TOUCH: Final = 40.0
"""Force over its noise below and above which it is none and one, and which tells a touch well."""
_TWICE: Final = 0.4
"""Part of the readings in the air that are as those before them, from which on each is told
twice, or so coarse that it might be."""
_BEFORE_TOUCH: Final = 4
"""Readings in the air before a touch."""
_RAMP: Final = 0.2
"""Part of a jump by which the force rises in a reading after it at most."""
_PARTLY: Final = 0.1
"""Part of the force of a touch that a reading in which the tool touches lacks."""
_WHOLE: Final = (0.9 / 0.2, 0.1 / 0.8)
"""How much more likely readings of a moment are whole than means are, and are not."""
_CERTAIN: Final = 4.5
"""Logarithm of how much more likely all of them are, from which on they are of a moment."""
_GROWTH: Final = 0.02
"""Length of a step over the time since the last event, or until the next."""
_DIGITS: Final = 2
"""Binary digits of a length of a step in samples, after the first."""
_MOVED: Final = 0.1
"""Noise of a step by which its force may differ where an end of it is moved to a tick."""
_ASIDE: Final = 0.25
"""Samples by which such an end may be moved."""
_ABOUT: Final = 4
"""Samples before and after it that tell how fast the force goes there."""
_JUMPS: Final = 4.0
"""Noise beyond which the force jumps from one sample to the next."""
_PHASE: Final = 64
"""Samples by which the phase of such a clock is told."""
_SET_BY: Final = 0.05
"""Part of what a stamp is off by which a clock of nearly the right interval is set."""
_OTHER_PHASE: Final = 5.0
"""Median deviations, of the mean of so many, by which it is another phase."""
_STRAY: Final = 8.0
"""Median deviations by which an edge is off that is none of the clock's."""
_REGULAR: Final = 1e-9
"""Part of an interval within which stamps are regular by themselves."""
_FRACTION: Final = 6.0
_TO_THE_TICK: Final = 1e-6
"""Deviations of a step from whole ticks, and part of a tick, above which the clock has stood still
or was set."""
_WINDOW: Final = 512
_WINDOW_EVERY: Final = 8192
"""Samples in a window at the full rate, and from one to the next."""
_WELL_SHOWN: Final = 300.0
"""What the changes of speed on the object show of how an arm makes them, that is enough."""
_GONE_ON: Final = 6.0
"""Standard deviations of the encoders by which a tool may have gone on where a corner is told."""
_PATH_BLOCKS: Final = 256
_PATH_SIGMAS: Final = 5.0
_LEFT_SIGMAS: Final = 6.0
_FAR_APART: Final = 4.0
"""Intervals of the encoders from which on two corners of a curve have a straight piece between."""
_MORE_CORNERS: Final = 24
"""Corners that a path gets where it leaves the samples, before it goes through all of them."""
_SHORTEST: Final = 4
"""Fewer samples between two that the path goes through have no line of their own."""
_CLEAR: Final = 4.0
_CROWDED: Final = 32
"""Changes of speed that may as well be a curve which shapes of arms follow in pieces."""
_LOOSE: Final = 3
"""Corners that no shape follows, from which on a tool may go along a curve."""
_FAINT: Final = 6.0
"""Further price of a corner at which it goes on nearly as before, over the logarithm of the number
of samples: twice that of the corner itself, as a curve is likelier."""
_DITHERED: Final = 1.4
"""Noise of the encoders over that of their rounding, from which on like readings err apart."""
_BADLY: Final = 1.35
"""Squares over the noise, for each sample, from which on the shapes of arms are none of its."""
_RESTS: Final = 40
"""Readings within a step of the encoders, one after another, in more of which a tool rests."""
_EVENLY: Final = 6
"""Readings that go on by the same from one to the next, of which at least so many err as one."""
_FOLLOWED: Final = 4.0
"""Squares over the noise, for each sample, that a curve leaves at most."""
_MOST_PIECES: Final = 96
"""Pieces of a path at most, for each time that the tool goes there and back."""
_UNBENT: Final = 2
"""How many more there may be before shapes take the place of those of slow changes of speed."""
_SAME_START: Final = 1e-3
"""Trials that start within this time of each other are one [s]."""
_FEWEST_OF_A_RAMP: Final = 3
"""Corners of one change of speed that are followed by corners at first."""
_TO_AND_FRO: Final = 0.4
"""Part of the corners of a way that ripples at which its speed changes the other way at least."""
_MOST_WAYS: Final = 16
"""Times there and back that count for these."""
_WAY: Final = 0.05
"""Part of a tool's whole way from which on it goes there and back."""
_FEW_LOOKS: Final = 2048
"""Samples of a way that tell how often it does so."""
_CORNER_SAMPLES: Final = 64
"""Corners that are so many samples of the encoders apart may be one change of speed."""
_APART: Final = 16
"""Those that are further apart are tried as several if they are not one."""
_ALONE: Final = 3.0
"""Gap between corners over all others from which on it parts two changes of speed."""
_DENSE: Final = 0.05
"""Quantile of the intervals of the encoders that is theirs where samples are dense."""
_BURST: Final = 10
"""Samples that may be stamped late together."""
_STRAIGHT: Final = 8
"""Samples on either side of these that are on one line."""
_SILENT: Final = 3.5
"""Usual intervals of the encoders without a sample that are a gap."""
_MOST_MISSING: Final = 10_000
"""Steps of a gap at most."""
_BESIDE: Final = 4
"""Samples beside a gap that tell the tool's way into it."""
_UNSEEN: Final = 0.02
"""Share of the depth that the way in a gap may be off, if the tool went on as before or after."""
QUIETEST: Final = 1e-4
"""Noise that a sensor has at least, over the largest reading: that of a class of 0.01 %."""
_UNSURE: Final = 0.005
_SWAMPED: Final = 1.0
"""Relative error of a push's speed, and what it makes in the force over the noise, from which on
the way is not known: few samples of the encoders, whose corners are off as well."""
_SHORTEST_PART: Final = 1e-3
"""Intervals of the force that a part of a step is long at least."""
_PARTS: Final = 4
_QUICK: Final = 24.0
"""Straight parts of an interval of the force over which the tool changes its speed steadily; and
intervals that this takes at most where it matters."""
_EXACT: Final = (1e-6, 1e-5, 1e-4)
"""Parts of the depth to which encoders whose own noise is less are to be followed, in turn."""
_FEWEST_ON_LINE: Final = 3
"""Samples that tell a straight piece."""
_ON_LINES: Final = 0.1
"""Part of the samples of a tool that moves which are exactly on a line, from which on none of
what the others are beside one is noise."""
_MOST_STEPS: Final = 24
_OFF_GRID: Final = 1e-4
"""Steps of a grid within the smallest that is seen, and parts of one that a reading may be off."""
_CURVED: Final = 0.5
"""Part of what straight lines leave of samples between others that a curve may leave of them."""
_BETWEEN: Final = 8
"""Most straight pieces that stand for the curve from one exact sample to the next."""
_MOST_SHAPES: Final = 1 << 14
"""Shapes of changes of speed that are known, some hundred samples each."""
_EDGE_SAMPLES: Final = (6, 3)
"""Samples of the encoders beside a change of speed; the first number that will do counts."""
_LINED_AGAIN: Final = 3
"""Times that straight pieces between changes of speed are told anew by what these leave."""
_LEFT_OVER: Final = 0.3
"""Part of a piece that is left at least where a change of speed beside it goes on into it."""
_MOSTLY_ROUNDED: Final = 3.0
"""Noise of the encoders over that of their rounding, below which the latter tells its size."""
_CALMER: Final = 1.5
_NORMAL_FROM_QUARTER: Final = 3.1387
"""Standard deviation of a normal error over the first quartile of its size, and how many times it
that is taken for the noise of a tool that moves at most."""
_STRETCH: Final = 32
"""Samples, one after another, that may go the straightest way."""
_STEADIER: Final = 0.3
"""Noise by what is left of how the tool is accelerated, over that with it, from which on that is
no noise."""
_NO_FILTER: Final = 3e-3
"""The same, from which on it is none either where no rest shows it: noise that has been filtered
at a fiftieth of the rate of the samples is four times as much."""
_MOVING: Final = 6.0
"""Way between two samples of the encoders over their noise from which on the tool moves."""
_BRIEF_SWING: Final = 0.02
"""Part of the longest change of speed that one that swings lasts at least, at first."""
_TOUCHING: Final = 16
"""Samples of the encoders before the touch beyond which a tool goes that pushes."""
_CRITICAL: Final = 0.25
"""Swing of a servo that is critically damped."""
_SWING_SEARCHES: Final = 4
"""Times that the search for a change of speed that swings is begun anew at most."""
_LOOKED_AT: Final = 64
"""Samples, or up to half as many more, of a change of speed that are looked at first."""
_HOPELESS: Final = 10.0
"""What they leave then, over what is enough, from which on no shape follows it."""
_FEW_SEEN: Final = 8.0
"""Samples of the encoders in a change of speed from which on they show how it goes."""
_FEW_CLEAN: Final = 4.0
"""Those that tell a swing as well, where they are clean."""
_FORM: Final = 1e-4
"""What its form may be off by otherwise, over the way in it."""
_FOLLOWS: Final = 2.0
"""Noise that samples may be away from a change of speed, root mean square."""
_CLOSELY: Final = 1.2
"""The same where little is straight after it."""
_SOFT: Final = (0.0, 0.5, 1.0)
"""Parts of how long an acceleration lasts, over which it comes and goes, that are tried."""
_COARSE_REST: Final = 5e-4
"""Half a step of the encoders over the depth, from which on it matters where a tool rests."""
_HELD: Final = 0.1
"""Speed of a tool that is held, over that of the push, at most."""
_STILL: Final = 0.9
"""Part of the readings of a tool at rest that are one and the same."""
_NO_WORSE: Final = 1.2
_AIR: Final = 0.2
"""The tool's path is followed closely up to this share of the depth above the first touch."""
_COARSE: Final = 0.002
"""Above that, within this part of it."""
_MOST_IN_AIR: Final = 24
_DETECTION: Final = 0.01
"""Scatter of the detected touch in any noise, over the depth."""
_SHALLOW: Final = (0.01, 0.03, 0.1)
"""Shares of the depth over which the first rise of the force is looked at."""
_SEEN_WAY: Final = 0.2
"""Share of the depth that heights in contact are to have seen, to be held against the tool."""
_LEAST_FOLLOWED: Final = 0.1
_MOST_FOLLOWED: Final = 10.0
"""Parts of the tool's way that the height of an object under it goes at least and at most."""
_BASELINE: Final = 32
"""Samples before the contact from which on the zero of the load cell is fitted."""


@dataclass(frozen=True, slots=True)
class Samples:
    """
    The force samples of a trial, each with the step around it.

    Parameters
    ----------
    edges : ndarray, shape (n + 1,)
        Ends of the steps [s].
    force : ndarray, shape (n,)
        Measured force without the load cell's zero [N].
    good : ndarray of bool, shape (n,)
        False where a sample is set aside as a glitch, or missing.
    missing : ndarray of bool, shape (n,), optional
        True where a gap of the record has a step without a sample, or with one that tells nothing.
    ended : ndarray of bool, shape (n,), optional
        True for those of them at which the range of the load cell has ended.

    """

    edges: FloatArray
    force: FloatArray
    good: NDArray[np.bool_]
    missing: NDArray[np.bool_] | None = None
    ended: NDArray[np.bool_] | None = None


class Rest(NamedTuple):
    """
    How well encoders that round tell where a tool is held.

    Parameters
    ----------
    t : float
        When it stops [s].
    std : float
        Standard deviation of where it is beside what is taken [m].

    """

    t: float
    std: float


@dataclass(frozen=True, slots=True)
class ToolPath:
    """
    The tool's displacement beyond the first touch: straight pieces, round ones along a smooth way.

    Parameters
    ----------
    t, displacement : ndarray, shape (k,)
        The corners, or the knots of a smooth way [s, m].
    noise : float
        Standard deviation of a sample of the encoders about the path [m].
    bends : tuple of Bend
        Corners at which the tool changes its speed over a finite time.
    interval : float
        Interval between two samples of the encoders where they are dense [s].
    servo : Servo or None
        How the arm changes its speed, where the campaign tells it.
    rest : Rest or None
        How well encoders that round tell where the tool is held.
    still : float
        Interval between corners from which on the tool hardly changes its speed there, as at the
        knots of a smooth way [s].
    unsteady : ndarray, shape (k,), optional
        By how much the speed of a smooth way is off at the corners, as of `Way`.
    curved : bool
        Whether the corners follow a curve, so that of most of them the tool knows nothing.

    """

    t: FloatArray
    displacement: FloatArray
    noise: float
    bends: tuple[Bend, ...] = ()
    interval: float = 0.0
    servo: Servo | None = None
    rest: Rest | None = None
    still: float = math.inf
    unsteady: FloatArray | None = None
    curved: bool = False

    def at(self, t: FloatArray) -> FloatArray:
        """Return the displacement at times `t` [m]."""
        result = np.interp(t, self.t, self.displacement)
        if self.unsteady is not None:
            self._round(t, result)
        for bend in self.bends:
            first, last = np.searchsorted(t, (bend.start, bend.stop))
            if first < last:
                result[first:last] += bend.beyond(t[first:last])
        return result

    def _round(self, t: FloatArray, result: FloatArray) -> None:
        """
        Round the corners of a smooth way.

        Straight pieces whose places are right have speeds that jump, of which dashpots make force;
        a model that blurs the way would gain by that.
        """
        assert self.unsteady is not None
        if self.t.size < 3:
            return
        smooth = (self.unsteady[1:] > 0.0) & (self.unsteady[:-1] > 0.0)
        piece = np.clip(np.searchsorted(self.t, t, side='right') - 1, 0, self.t.size - 2)
        inside = np.flatnonzero(smooth[piece])
        piece = piece[inside]
        gaps, ways = np.diff(self.t), np.diff(self.displacement)
        speed = np.gradient(self.displacement, self.t)
        share = (t[inside] - self.t[piece]) / gaps[piece]
        rest = 1.0 - share
        before = gaps[piece] * speed[piece] - ways[piece]
        after = gaps[piece] * speed[piece + 1] - ways[piece]
        result[inside] += share * rest * (rest * before - share * after)

    def held(self, t: FloatArray, shift: float, at: FloatArray | None = None) -> FloatArray:
        """
        Return the displacement of a tool that is held deeper than it is taken to be.

        It stops the later by that, goes on the sooner, and is where the encoders tell it while it
        moves.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times [s], increasing.
        shift : float
            By how much deeper [m].
        at : ndarray, shape (n,), optional
            What `at` has returned for these times, where it is known.

        Returns
        -------
        ndarray, shape (n,)
            Displacements [m].

        """
        result = self.at(t) if at is None else at.copy()
        if self.rest is None:
            return result
        stop = int(np.argmin(np.abs(self.t - self.rest.t)))
        if not 0 < stop < self.t.size - 1:
            return result
        slopes = np.diff(self.displacement) / np.diff(self.t)
        comes = float(slopes[stop - 1])
        # What creeps is held; a tool that goes on does so at some speed.
        moves = np.flatnonzero(np.abs(slopes[stop:]) > _HELD * abs(comes))
        leave = stop + int(moves[0]) if moves.size else self.t.size
        middle = 0.5 * float(self.t[stop] + self.t[min(leave, self.t.size - 1)])
        edges = {bend.t: (bend.start, bend.stop) for bend in self.bends}

        def within(knot: int) -> tuple[float, float]:
            return edges.get(float(self.t[knot]), (float(self.t[knot]), float(self.t[knot])))

        # Between two corners it is on a line, on which it may as well be earlier or later.
        first = 0.5 * (within(stop - 1)[1] + within(stop)[0])
        low, high = np.searchsorted(t, (first, middle))
        result[low:high] = self.at(t[low:high] - shift / comes) + shift
        if leave >= slopes.size + 1:
            result[high:] += shift
            return result
        last = 0.5 * (within(leave)[1] + within(leave + 1)[0])
        end = int(np.searchsorted(t, last))
        result[high:end] = self.at(t[high:end] - shift / float(slopes[leave])) + shift
        return result

    @property
    def events(self) -> list[float]:
        """Return when the tool's speed changes [s]."""
        if self.still < math.inf:
            gaps = np.diff(self.t)
            turns = np.minimum(gaps[1:], gaps[:-1]) < self.still
            return list(self.t[1:-1][turns | self._sharp])
        edges = [edge for bend in self.bends for edge in (bend.start, bend.stop)]
        return [*self.t.tolist(), *edges]

    @property
    def jerks(self) -> list[float]:
        """
        Return the events, but for corners that follow a curve [s].

        Those remain at which the speed jumps, and, on the object, those beside a piece that is
        straight for long: nothing else shows that a tool that goes evenly begins to do otherwise.
        """
        if not self.curved:
            return self.events
        far = np.diff(self.t) >= min(self.still, _FAR_APART * self.interval)
        # In a smooth way there are knots where it is straight as well.
        beside = far[1:] != far[:-1] if self.still < math.inf else far[1:] | far[:-1]
        told = self._sharp | (beside & (self.displacement[1:-1] > 0.0))
        edges = [edge for bend in self.bends for edge in (bend.start, bend.stop)]
        return [*self.t[1:-1][told].tolist(), *edges]

    @property
    def _sharp(self) -> NDArray[np.bool_]:
        """Return at which corners between two pieces the speed jumps."""
        slope = np.diff(self.displacement) / np.diff(self.t)
        return np.asarray(np.abs(np.diff(slope)) > _HELD * float(np.abs(slope).max()))

    def straight(self, t: FloatArray) -> FloatArray:
        """
        Return for how long a curve is taken for straight, around some times.

        Parameters
        ----------
        t : ndarray, shape (n,)
            Times [s].

        Returns
        -------
        ndarray, shape (n,)
            How long it takes from corner to corner there [s]; not finite where a smooth way
            hardly bends.

        """
        gaps = np.diff(self.t)
        piece = np.clip(np.searchsorted(self.t, t, side='right') - 1, 0, gaps.size - 1)
        return np.where(gaps < self.still, gaps, math.inf)[piece]


@dataclass(frozen=True)
class FitTrial:
    """
    A trial in n steps, with m samples (or means of samples) of the displacement height.

    Parameters
    ----------
    name : str
        The trial's name.
    t : ndarray, shape (n + 1,)
        Ends of the steps [s].
    displacement : ndarray, shape (n + 1,)
        Tool displacement beyond the detected touch at `t` [m].
    force : ndarray, shape (n,)
        Mean of the good force samples in each step, without the zero of the segmentation [N].
    force_count : ndarray, shape (n,)
        How many those are.
    height_t, height, height_count : ndarray, shape (m,)
        Times [s], displacement height [m] and number of samples of each mean.
    campaign_time : float
        When the trial starts, from the start of the campaign [s].
    reference_depth : float
        Depth of the deepest push of the campaign [m].
    depth_before : float
        Depth of the deepest push before this one [m].
    zero_time : float
        Mean time of the samples that gave the force zero [s].
    interval, height_interval : float
        Usual interval between two samples of force and of height [s].
    height_jitter : float
        By how much the stamps of the heights are off a regular clock, as a standard deviation [s].
    onset_std : float
        How well the detected contact is known [m].
    has_force_zero, has_height_zero : bool
        Whether the record shows the sensor without contact, so that its zero can be fitted.
    t_contact, t_release : float
        The detected touch and start of the release [s].
    t_first : float or None
        When a tool that pushes in steps has first come to rest [s].
    heights_aside : tuple of float
        Times of the displacement heights that are not used [s].
    eventful : ndarray of bool, shape (samples,)
        Which force samples are near an event, where a sudden residual is no glitch.
    samples : Samples
        The force at its full rate.
    path : ToolPath
        The tool's path.
    set_aside : tuple of float
        Times of the force samples that are not used [s].

    """

    name: str
    t: FloatArray
    displacement: FloatArray
    force: FloatArray
    force_count: FloatArray
    height_t: FloatArray
    height: FloatArray
    height_count: FloatArray
    campaign_time: float
    reference_depth: float
    depth_before: float
    zero_time: float
    interval: float
    height_interval: float
    height_jitter: float
    onset_std: float
    has_force_zero: bool
    has_height_zero: bool
    t_contact: float
    t_release: float | None
    t_first: float | None
    heights_aside: tuple[float, ...]
    eventful: NDArray[np.bool_]
    samples: Samples
    path: ToolPath

    @cached_property
    def duration(self) -> FloatArray:
        """Return the lengths of the steps [s], shape (n,)."""
        return np.diff(self.t)

    @cached_property
    def middle(self) -> FloatArray:
        """Return the times in the middle of the steps [s], shape (n,)."""
        return 0.5 * (self.t[1:] + self.t[:-1])

    @cached_property
    def spacing(self) -> FloatArray:
        """Return the intervals between the samples within the steps [s], shape (n,)."""
        return np.asarray(self.duration / np.maximum(self.force_count, 1.0))

    @cached_property
    def unsteady(self) -> FloatArray | None:
        """
        Return the variance of each step's force for what its speed is off by [N^2], shape (n,).

        None but along a smooth way.
        """
        push = self.pushed[0]
        count = np.sqrt(self.force_count[push])
        if self.path.unsteady is None or np.count_nonzero(count) < _FEWEST:
            return None
        off = np.interp(self.middle, self.path.t, self.path.unsteady)
        # How much force a speed makes is told by the push, and by no model that is held against
        # another: of two models one would pay for the greater variance. There is no level beside
        # them: an arm that settles slowly has a speed that falls in a line with its way.
        speed = np.diff(self.displacement)[push] / self.duration[push]
        felt = np.column_stack((speed, self.displacement[1:][push])) * count[:, np.newaxis]
        flow = max(float(np.linalg.lstsq(felt, self.force[push] * count)[0][0]), 0.0)
        touching = self.displacement[1:] > 0.0
        return np.asarray(np.where(touching, (flow * off) ** 2, 0.0) / self.duration)

    @cached_property
    def pushed(self) -> tuple[slice, float]:
        """
        Return the steps of the push, and how well its speed is known relative to itself.

        It is that of a line through the encoders' samples. What the line is off by is the same
        for the whole push: the error stands for as much as all its steps tell together. Of a tool
        that rests on its way it is the push up to that.
        """
        deepest = int(np.argmax(self.displacement >= 0.98 * self._pushed_to))
        first = int(np.searchsorted(self.t, self.t_contact, side='right')) - 1
        steps = slice(max(first, 0), max(deepest, first, 0))
        way = float(self.displacement[steps.stop] - self.displacement[steps.start])
        return steps, self._slope_error(way, float(self.t[steps.stop] - self.t[steps.start]))

    @property
    def best_pushed(self) -> float:
        """Return how well the speed of the longest way between two stops is known, relatively."""
        ends = np.array([self.t_contact, *self.stops])
        ways = np.abs(np.diff(np.interp(ends, self.t, self.displacement)))
        longest = int(np.argmax(ways))
        return self._slope_error(float(ways[longest]), float(np.diff(ends)[longest]))

    def _slope_error(self, way: float, lasted: float) -> float:
        """Return the relative error of the slope of a line through the encoders' samples."""
        seen = lasted / max(self.path.interval, 1e-300)
        if way <= 0.0 or seen < 1.0:
            return 0.0
        return math.sqrt(12.0 / seen) * self.path.noise / way

    @property
    def _pushed_to(self) -> float:
        """Return how deep the tool goes before it first rests [m]."""
        if self.t_first is None:
            return float(self.displacement.max())
        return float(np.interp(self.t_first, self.t, self.displacement))

    @cached_property
    def stops(self) -> tuple[float, ...]:
        """Return when the tool changes its speed between touch and release [s]; first `t_stop`."""
        if self.t_first is None:
            return (self.t_stop,)
        end = math.inf if self.t_release is None else self.t_release
        later = (0.5 * (bend.start + bend.stop) for bend in self.path.bends)
        return (self.t_stop, *(t for t in later if self.t_first < t < end))

    @cached_property
    def t_stop(self) -> float:
        """Return when the tool would stop if it went on to its depth as in the push [s]."""
        push, _ = self.pushed
        ends = [push.start, push.stop]
        (start, stop), (first, last) = self.t[ends].tolist(), self.displacement[ends].tolist()
        if last <= first:
            return float(stop)
        return float(stop + (self._pushed_to - last) * (stop - start) / (last - first))

    @cached_property
    def half_way(self) -> int:
        """Return the number of steps up to the middle of the push: the touch is among them."""
        push = self.pushed[0]
        return max(int(push.start + push.stop + 1) // 2, int(push.start) + 1)

    @cached_property
    def turns(self) -> Turns | None:
        """Return the steps, split where the tool changes its speed below the surface."""
        if self.path.curved:
            # Corners at the encoders' samples are their noise as well, and a smooth way has none.
            return None
        fine = self.interval / _PARTS
        bent = [
            np.arange(bend.start, bend.start + bend.lasts, fine)
            for bend in self.path.bends
            if bend.lasts < _QUICK * self.interval
        ]
        t = np.unique(np.concatenate((self.path.events, *bent)))
        displacement = self.path.at(t)
        inner = (t > self.t[0]) & (t < self.t[-1]) & (displacement > 0.0)
        t = t[inner]
        after = np.searchsorted(self.t, t)
        away = np.minimum(self.t[after] - t, t - self.t[np.maximum(after - 1, 0)])
        apart = np.diff(t, prepend=-np.inf)
        kept = np.minimum(away, apart) > _SHORTEST_PART * self.interval
        t = np.unique(np.concatenate((t[kept], self._looked_at())))
        if not t.size:
            return None
        return Turns.of(self.t, self.displacement, t, self.path.at(t))

    def _looked_at(self) -> FloatArray:
        """
        Return times within the steps near the events, where heights come about as fast as forces.

        The surface is a straight line within a step, but stays where it is until the touch, and
        goes on in a curve after the stop and the release.
        """
        step = min(self.interval, self.height_interval)
        if not self.height_t.size or self.interval <= _COARSE_STEP * self.height_interval:
            return np.empty(0)
        reach = _EVENTFUL_STEPS * self.interval
        count = min(math.ceil(2.0 * reach / (_LOOKS * step)), _MOST_LOOKS)
        events = [self.t_contact, *self.stops]
        if self.t_release is not None:
            events.append(self.t_release)
        looks = np.unique(np.add.outer(events, np.linspace(-reach, reach, count + 1)))
        looks = looks[(looks > self.t[0]) & (looks < self.t[-1])]
        after = np.searchsorted(self.t, looks)
        away = np.minimum(self.t[after] - looks, looks - self.t[after - 1])
        apart = np.diff(looks, prepend=-np.inf)
        kept = np.minimum(away, apart) > _SHORTEST_PART * _LOOKS * step
        return np.asarray(looks[kept], dtype=np.float64)

    @property
    def rest_std(self) -> float:
        """Return how well the encoders tell where the tool is held [m]; zero if well enough."""
        return 0.0 if self.path.rest is None else self.path.rest.std

    def held(self, shift: float) -> 'FitTrial':
        """Return what to predict for a tool that is held deeper than it is taken to be [m]."""
        if shift == 0.0:
            return self
        split = self.turns
        moved = copy(self)
        # Where the tool is is known anew; when it does what stays.
        for known in ('full_rate', 'near_touch', 'touch_head'):
            moved.__dict__.pop(known, None)
        displacement = self.path.held(self._finest, shift, self._unmoved)
        if split is not None:
            moved.__dict__['turns'] = replace(split, displacement=displacement)
            displacement = displacement[split.ends]
        moved.__dict__['displacement'] = displacement
        return moved

    @property
    def _finest(self) -> FloatArray:
        """Return the ends of the steps, split or not [s]."""
        return self.t if self.turns is None else self.turns.t

    @cached_property
    def _unmoved(self) -> FloatArray:
        """Return where the tool is then if it is held where it is taken to be [m]."""
        return self.path.at(self._finest)

    @property
    def touch_reach(self) -> float:
        """Return how far from the detected touch it may be [m]."""
        return _TOUCH_REACH * self.onset_std

    @cached_property
    def peak_force(self) -> float:
        """Return the largest mean force of a step [N]; in a planned trial, of one like it."""
        return max(float(np.abs(self.force).max()), 1e-300)

    @property
    def set_aside(self) -> FloatArray:
        """Return the times of the force samples that are not used [s]."""
        samples = self.samples
        bad = np.flatnonzero(
            ~samples.good if samples.missing is None else ~samples.good & ~samples.missing
        )
        return 0.5 * (self.samples.edges[bad] + self.samples.edges[bad + 1])

    @cached_property
    def full_rate(self) -> 'FitTrial':
        """Return the same trial with one step for each force sample."""
        samples = self.samples
        return replace(
            self,
            t=samples.edges,
            displacement=self.path.at(samples.edges),
            force=samples.force,
            force_count=samples.good.astype(np.float64),
        )

    @property
    def depth(self) -> float:
        """Return how far the tool goes beyond the detected contact [m]."""
        return float(self.path.displacement.max())

    @cached_property
    def near_touch(self) -> slice:
        """Return the steps of the push in which the touch may be: none where `stop` is zero."""
        near = np.flatnonzero(np.abs(self.displacement) <= self.touch_reach)
        last = min(int(near[-1]), int(np.argmax(self.displacement))) if near.size else 0
        # A record that begins in contact, or after it, has none.
        return slice(int(near[0]), last) if near.size and near[0] < last else slice(0, 0)

    @cached_property
    def touch_head(self) -> 'FitTrial':
        """Return the head up to the end of `near_touch`: made once, it is looked at very often."""
        return self.head(self.near_touch.stop)

    def head(self, steps: int) -> 'FitTrial':
        """Return the first steps of the trial, and one for the rest; with the force alone."""
        # What counts from the middle of the trial, as the phase of a hum, stays what it is.
        last = self.t.size - 1
        steps = min(steps, last - 1)
        ends = np.append(np.arange(steps + 1), last)
        # Nobody asks how the tool goes on within the rest.
        until = float(self.t[steps])
        # The one after the next knot tells how fast the tool passes that.
        knots = slice(int(np.searchsorted(self.path.t, until)) + 2)
        path = replace(
            self.path,
            t=self.path.t[knots],
            displacement=self.path.displacement[knots],
            unsteady=None if self.path.unsteady is None else self.path.unsteady[knots],
            bends=tuple(bend for bend in self.path.bends if bend.start < until),
        )
        return replace(
            self,
            path=path,
            t=self.t[ends],
            displacement=self.displacement[ends],
            force=np.append(self.force[:steps], 0.0),
            force_count=np.append(self.force_count[:steps], 0.0),
            height_t=np.empty(0),
            height=np.empty(0),
            height_count=np.empty(0),
        )

    def without(self, bad: NDArray[np.bool_]) -> 'FitTrial':
        """Return the same trial with further force samples set aside; `bad` has shape (n,)."""
        samples = replace(self.samples, good=self.samples.good & ~bad)
        steps = np.searchsorted(samples.edges, self.t)
        return _with_steps(replace(self, samples=samples), steps)


def prepare(
    trials: Sequence[tuple[Trial, Segmentation]],
    *,
    windows: bool = False,
    servo: Servo | EllipsisType | None = ...,
    momentary: bool | None = None,
    range_end: float = math.inf,
) -> tuple[tuple[FitTrial | None, ...], tuple[str, ...]]:
    """
    Return trials in the form that the fit works with.

    Parameters
    ----------
    trials : sequence of (Trial, Segmentation)
        A campaign.
    windows : bool
        Whether each force sample has a step of its own not only near events but also in windows
        all over the trial, for what is faster than the steps elsewhere.
    servo : Servo or None, optional
        How the arm changes its speed, None where that is not known; what the encoders tell of it
        by default.
    momentary : bool, optional
        Whether the readings of the force are of a moment, so that those beside a touch do not tell
        when within a sample it was; what the touches tell by default.
    range_end : float, optional
        Where other trials show that the range of the load cell ends [N].

    Returns
    -------
    fit_trials : tuple of (FitTrial or None)
        One for each trial; None where there is nothing to fit.
    warnings : tuple of str
        Why.

    """
    prepared: list[FitTrial | None] = []
    warnings: list[str] = []
    unknown: list[str | None] = []
    pushes: list[tuple[float, float]] = []
    first = min((trial.start_ns for trial, _ in trials), default=0)
    if isinstance(servo, EllipsisType):
        servo = arm_of(trials)[0]
    touches = [_touches(trial.force, phases) for trial, phases in trials]
    if momentary is None:
        momentary = _at_moments(touches)
    forces = [_without_spikes(trial) for trial, _ in trials]
    range_end = min(range_end, end_of_range(forces))
    for (trial, phases), force, (touched, _) in zip(trials, forces, touches, strict=True):
        beside = touched if momentary else np.empty(0)
        later = (trial.start_ns - first) * 1e-9
        ends = range_end
        if math.isinf(ends) or force.max() > ends:
            # One trial may have been read through another range.
            ends = end_of_range([force])
        made = _prepare(trial, phases, later, windows, servo, touched, beside, ends)
        astray = None if isinstance(made, str) else astray_height(trial, phases)
        if astray is not None:
            warnings.append(f'{trial.name}: {astray}, and is not used')
            blind = replace(trial, displacement_height=None, displacement_source='none')
            made = _prepare(blind, phases, later, windows, servo, touched, beside, ends)
        # What no model is fitted to has been pushed as well.
        depth = phases.depth if isinstance(made, str) else made.depth
        pushes.append((later, depth or 0.0))
        if isinstance(made, str):
            warnings.append(f'{trial.name}: {made}, so no model is fitted to it')
            prepared.append(None)
            unknown.append(None)
            continue
        prepared.append(made)
        unknown.append(_unknown_way(trial, made))
        if made.samples.ended is not None:
            warnings.append(
                f'{trial.name}: the load cell reads no more than {ends:.4g} N, as at the end of '
                f'its range: {np.count_nonzero(made.samples.ended)} readings of '
                f'{made.samples.ended.size} are not used'
            )
    clear = [made for made, why in zip(prepared, unknown, strict=True) if made and not why]
    for index, why in enumerate(unknown):
        if why is None:
            continue
        then = 'no model is fitted to it' if clear else 'what is fitted to it may be off'
        warnings.append(f'{trials[index][0].name}: {why}: {then}')
        if clear:
            prepared[index] = None
    deepest = max((one.depth for one in prepared if one is not None), default=1.0)
    return (
        tuple(
            t
            if t is None
            else replace(
                t, reference_depth=deepest, depth_before=deepest_before(t.campaign_time, pushes)
            )
            for t in prepared
        ),
        tuple(warnings),
    )


def deepest_before(campaign_time: float, pushes: Iterable[tuple[float, float]]) -> float:
    """
    Return the depth of the deepest of earlier pushes.

    Parameters
    ----------
    campaign_time : float
        When a trial starts, from the start of the campaign [s].
    pushes : iterable of (float, float)
        When trials start [s], and their depths [m].

    Returns
    -------
    float
        The depth [m]; zero where none is earlier.

    """
    before = (depth for start, depth in pushes if start < campaign_time - _SAME_START)
    return max(before, default=0.0)


def planned(
    like: FitTrial,
    *,
    push_speed: float,
    depth: float,
    hold_time: float,
    release: bool,
    campaign_time: float,
) -> FitTrial:
    """
    Return a trial that was not made, for predictions of it.

    Parameters
    ----------
    like : FitTrial
        A trial with the same sensors; the release and the recovery are as long and fast as there.
    push_speed, depth, hold_time : float
        The push [m/s, m, s].
    release : bool
        Whether the tool is withdrawn.
    campaign_time : float
        When it would start, from the start of the campaign [s].

    Returns
    -------
    FitTrial
        With zeros where a measured one holds what was measured.

    """
    touch = _BASELINE * like.interval
    stop = touch + depth / push_speed
    end = stop + hold_time
    corners = [0.0, touch, stop, end]
    levels = [-push_speed * touch, 0.0, depth, depth]
    if release and like.t_release is not None:
        deepest = like.depth
        later = like.path.t > like.t_release
        risen = deepest - like.path.displacement[later]
        times = like.path.t[later] - like.t_release
        far = int(np.argmax(risen >= 0.9 * deepest)) if np.any(risen >= 0.9 * deepest) else -1
        speed = float(risen[far] / times[far]) if risen.size else push_speed
        speed = speed if speed > 0.0 else push_speed
        gone = (1.0 + _AIR) * depth / speed
        recovery = max(float(like.t[-1] - like.t_release) - gone, 0.0)
        corners += [end + gone, end + gone + recovery + like.interval]
        levels += [-_AIR * depth, -_AIR * depth]
    edges = np.arange(0.0, corners[-1], like.interval)
    path = ToolPath(
        np.array(corners), np.array(levels), like.path.noise, interval=like.path.interval
    )
    heights = np.empty(0)
    if like.height_t.size:
        heights = np.arange(0.5 * like.height_interval, edges[-1], like.height_interval)
    count = edges.size - 1
    trial = replace(
        like,
        name='planned',
        t=edges,
        displacement=path.at(edges),
        force=np.zeros(count),
        force_count=np.ones(count),
        height_t=heights,
        height=np.zeros(heights.size),
        height_count=np.ones(heights.size),
        campaign_time=campaign_time,
        depth_before=like.reference_depth,
        t_contact=touch,
        t_release=end if release else None,
        t_first=None,
        heights_aside=(),
        eventful=np.zeros(count, dtype=np.bool_),
        samples=Samples(edges, np.zeros(count), np.ones(count, dtype=np.bool_)),
        path=path,
    )
    events = np.array([t for t in corners[1:] if t < edges[-1]])
    made = _with_steps(trial, _steps(edges, events, like.interval, windows=False))
    # How far its zero may be off goes with the forces, which it has not measured.
    made.__dict__['peak_force'] = like.peak_force
    return made


def _prepare(
    trial: Trial,
    phases: Segmentation,
    campaign_time: float,
    windows: bool,
    servo: Servo | None,
    touches: FloatArray,
    beside: FloatArray,
    range_end: float,
) -> FitTrial | str:
    """
    Return one trial, or why it cannot be used.

    A tool that comes again is followed as closely at later `touches` at which the force jumps as
    at the first. The trial is without the readings at the times `beside`, and without those at
    the end of the range.
    """
    touch, original = phases.t_contact, phases.contact_height
    if touch is None or original is None:
        # Of a record with a turned sign they say so.
        why = f' ({"; ".join(phases.warnings)})' if phases.warnings else ''
        return f'no contact was found{why}'
    force = trial.force.between(-math.inf, np.nextafter(phases.t_end, math.inf))
    tool = trial.tool_height.between(-math.inf, np.nextafter(phases.t_end, math.inf))
    if np.count_nonzero(force.t > touch) < _FEWEST or np.count_nonzero(tool.t > touch) < 4:
        return 'there are too few samples in contact'
    height = trial.displacement_height if trial.displacement_source != 'tool' else None
    # The phases are looked for where both records are.
    begun = min(int(np.searchsorted(force.t, tool.t[0])) + 1, len(force) - 1)
    if phases.push_is_cut or (touch <= force.t[begun] and _is_pressed(height)):
        return 'the record begins in contact, after a part of the push or all of it'
    displacement = Signal(tool.t, original - tool.value)
    if not _goes_on(displacement, touch, phases.contact_height_std):
        return 'the tool does not go on after the touch'
    path = tool_path(displacement, phases, servo)
    deepest = int(np.argmax(path.displacement))
    if path.displacement[deepest] <= 0.0 or path.t[deepest] <= touch:
        return 'the tool does not go on after the touch'
    interval = float(np.median(np.diff(force.t)))
    middle = 0.5 * (force.t[1:] + force.t[:-1])
    edges = np.concatenate(([force.t[0] - 0.5 * interval], middle, [force.t[-1] + 0.5 * interval]))
    later = touches[touches > touch + 2.0 * interval].tolist()
    turns = [] if phases.t_first is None else [bend.t for bend in path.bends if bend.t > touch]
    eventful = near_events(force.t, phases, interval, (*later, *turns))
    lone = _lone(force, phases, path, interval)
    eventful &= ~lone
    bad = ((suspects(force.value) | lone) & ~eventful) | absurd(force.value, interval)
    samples = Samples(edges, force.value - phases.force_zero, ~bad)
    samples, eventful = _with_gaps(samples, force.t, interval, eventful)
    ended = force.t[at_the_end(force.value, range_end)]
    samples = _without(_without(samples, beside), ended, at_the_end=True)
    edges = samples.edges
    baseline = int(np.searchsorted(force.t, touch))
    height_interval, height_jitter = 1.0, 0.0
    height_t = heights = np.empty(0)
    aside: tuple[float, ...] = ()
    if height is not None:
        record = height.between(edges[0], edges[-1])
        if len(record) >= 2:
            good = ~(suspects(record.value) | _astray(record, phases, (*later, *turns)))
            height_t, heights = record.t[good], record.value[good]
            aside = tuple(record.t[~good].tolist())
            height_interval = float(np.median(np.diff(record.t)))
            height_jitter = jitter_of(record.t)
    raw = FitTrial(
        name=trial.name,
        t=edges,
        displacement=edges,
        force=samples.force,
        force_count=np.ones(samples.force.size),
        height_t=height_t,
        height=heights,
        height_count=np.ones(heights.size),
        campaign_time=campaign_time,
        reference_depth=float(path.displacement.max()),
        depth_before=0.0,
        zero_time=float(force.t[:baseline].mean()) if baseline else float(force.t[0]),
        interval=interval,
        height_interval=height_interval,
        height_jitter=height_jitter,
        # The record of the force may have a gap where the tool touched.
        onset_std=max(_onset_std(force, path, touch, interval), phases.contact_height_std),
        has_force_zero=baseline >= _BASELINE or phases.t_loss is not None,
        # Where the tool hides the surface until it touches it, that is where its height is from.
        has_height_zero=(trial.displacement_source == 'points' and height_t.size > 0)
        or int(np.count_nonzero(height_t < touch)) >= 3,
        t_contact=touch,
        t_release=phases.t_release,
        t_first=phases.t_first,
        heights_aside=aside,
        eventful=eventful,
        samples=samples,
        path=path,
    )
    events = [t for t in (touch, phases.t_hold, phases.t_release, phases.t_loss) if t is not None]
    events += [t for t in path.jerks if touch < t < edges[-1]]
    events += later
    straight = path.straight(0.5 * (edges[1:] + edges[:-1])) if path.curved else None
    steps = _steps(edges, np.array(sorted(events)), interval, windows, straight)
    # What was set aside is no force that goes on or jumps.
    told = np.flatnonzero(samples.good)
    read = np.interp(np.arange(samples.force.size), told, samples.force[told])
    samples = replace(samples, edges=_on_ticks(edges, steps, _tick(force.t), read))
    return _with_steps(replace(raw, samples=samples, t=samples.edges), steps)


def range_end_of(trials: Sequence[tuple[Trial, Segmentation]]) -> float:
    """Return where the trials of a campaign show that the range of the load cell ends [N]."""
    return end_of_range([_without_spikes(trial) for trial, _ in trials])


def _without_spikes(trial: Trial) -> FloatArray:
    """Return the readings of the force without glitches, which may be above the range's end."""
    value = trial.force.value
    return value[~suspects(value)]


def reads_at_moments(trials: Sequence[tuple[Trial, Segmentation]]) -> bool:
    """
    Return whether the readings of the force are of a moment, and not means over a sample.

    A mean over the sample in which a tool touches is a part of the force that follows; if hardly
    any of a campaign's is, they are of a moment.

    Parameters
    ----------
    trials : sequence of (Trial, Segmentation)
        A campaign.

    Returns
    -------
    bool
        Whether the clear touches of the trials tell that.

    """
    return _at_moments([_touches(trial.force, phases) for trial, phases in trials])


def _at_moments(touches: Sequence[tuple[FloatArray, list[bool]]]) -> bool:
    """Return the same of the touches of the trials."""
    told = [whole for _, each in touches for whole in each]
    evidence = float(np.log(_WHOLE) @ (sum(told), len(told) - sum(told)))
    return evidence > _CERTAIN


def _touches(force: Signal, phases: Segmentation) -> tuple[FloatArray, list[bool]]:
    """
    Return the times of the readings before and after each touch of a trial that makes a jump.

    Also whether the force of each that is told well is whole at once.
    """
    force = force.between(-math.inf, np.nextafter(phases.t_end, math.inf))
    value = force.value - phases.force_zero
    before = math.inf if phases.t_contact is None else phases.t_contact
    air = value[force.t < before]
    if air.size < _BASELINE or not (noise := float(np.std(air))) > 0.0:
        return np.empty(0), []
    free = np.abs(value) < _IN_AIR * noise
    pressed = value > _IN_CONTACT * noise
    # Of readings that are rounded some are alike by chance.
    twice = rounding(force.value) == 0.0 or float(np.mean(np.diff(air) == 0.0)) > _TWICE
    # A tool was in the air for some readings, and presses for some: one that is lost is neither.
    since = np.arange(_BEFORE_TOUCH - 1, value.size - 3)
    starts = pressed[since + 1] & pressed[since + 2] & pressed[since + 3]
    for back in range(_BEFORE_TOUCH):
        starts &= free[since - back]
    times: list[float] = []
    whole: list[bool] = []
    for k in since[starts].tolist():
        first, second, later = (float(value[k + after]) for after in (1, 2, 3))
        lacks = (second - first) - (later - second)
        jump = first + max(lacks, 0.0)
        if later - second > _RAMP * jump or (twice and first == second):
            # A force that rises from nothing, or a reading that is told twice.
            continue
        times += [float(force.t[k]), float(force.t[k + 1])]
        if jump > _CLEAR_TOUCH * noise:
            whole.append(lacks < _PARTLY * jump)
    return np.array(times), whole


def _without(samples: Samples, times: FloatArray, *, at_the_end: bool = False) -> Samples:
    """Return samples without the readings at some times, as if these were missing."""
    if not times.size:
        return samples
    away = np.zeros(samples.good.size, dtype=np.bool_)
    inside = times[(times > samples.edges[0]) & (times < samples.edges[-1])]
    away[np.searchsorted(samples.edges, inside) - 1] = True
    missing = away if samples.missing is None else samples.missing | away
    ended = away if at_the_end else samples.ended
    return replace(samples, good=samples.good & ~away, missing=missing, ended=ended)


def arm_of(
    trials: Sequence[tuple[Trial, Segmentation]], *, workers: int = 1
) -> tuple[Servo | None, tuple[Corner, ...]]:
    """
    Return how the arm changes its speed.

    Parameters
    ----------
    trials : sequence of (Trial, Segmentation)
        A campaign.
    workers : int
        Processors.

    Returns
    -------
    servo : Servo or None
        How it makes all changes of speed, if the trials tell that it does so alike.
    corners : tuple of Corner
        What the encoders tell of each that is made so, of all if there is none.

    """
    turns: list[_Turned] = []
    others: list[_Turned] = []
    for near, away, ways in parallel.each(_turns_of, trials, workers):
        turns += near
        others += away
        keep(ways)
    corners = [turn.corner for turn in turns]
    servo = servo_of(corners, [turn.shape for turn in turns])
    if others and (servo is None or lasting(corners, servo) < _WELL_SHOWN):
        # On its way there and back the tool may be commanded otherwise than on the object. Where
        # it is not, its quicker ways tell more.
        every = turns + others
        whole = servo_of([turn.corner for turn in every], [turn.shape for turn in every])
        if whole is not None and _is_as_good(whole, servo, turns):
            servo = whole
    if servo is not None:
        turns = [
            turn
            for turn in turns
            if not is_apart(turn.corner, turn.corner.deviance(turn.shape), servo)
        ]
    return servo, tuple(turn.corner for turn in turns)


def _turns_of(
    each: tuple[Trial, Segmentation],
) -> 'tuple[list[_Turned], list[_Turned], dict[Key, Way]]':
    """Return how the tool turns on the object, and elsewhere, and what ways have been smoothed."""
    trial, phases = each
    known, near, away = kept(), list[_Turned](), list[_Turned]()
    displacement = _displacement(trial, phases)
    if displacement is None or phases.push_is_cut:
        return near, away, {}
    reached = displacement.t > float(phases.t_contact or 0.0)
    if np.count_nonzero(reached) >= _FEWEST and displacement.value[reached].max() > 0.0:
        path, found = _path(displacement, phases, None)
        for turn in found:
            on_it = _on_the_object(turn, phases, path.interval)
            (near if on_it else away).append(turn)
    return near, away, {key: way for key, way in kept().items() if key not in known}


def _is_as_good(whole: Servo, servo: Servo | None, turns: 'Sequence[_Turned]') -> bool:
    """Return whether what all ways tell of an arm follows those on the object as theirs does."""
    worth = math.log(max(sum(turn.corner.t.size for turn in turns), 2))
    swings = [
        any(arm.swing > 0.0 for arm in (each, each and each.others) if arm is not None)
        for each in (whole, servo)
    ]
    if swings == [True, False]:
        # How an arm swings shows on the object, or is none of what is told from elsewhere.
        return False
    near = [not is_apart(turn.corner, turn.corner.deviance(turn.shape), whole) for turn in turns]
    if 2 * sum(near) <= len(near):
        return False

    def left(turn: _Turned, by: Servo | None) -> float:
        alone = turn.corner.deviance(turn.shape) + 2.0 * worth
        mine = None if by is None else by.of(turn.corner)
        return alone if mine is None else turn.corner.deviance(mine.at(turn.corner), alone)

    return sum(left(turn, whole) - left(turn, servo) for turn in turns) < worth


def along(
    trials: Sequence[tuple[Trial, Segmentation]], made: Sequence[FitTrial | None], servo: Servo
) -> tuple[FitTrial, ...]:
    """
    Return trials with the same steps, whose tool goes as an arm would make it.

    Parameters
    ----------
    trials : sequence of (Trial, Segmentation)
        A campaign.
    made : sequence of (FitTrial or None)
        What `prepare` returned for it.
    servo : Servo
        How the arm changes its speed.

    Returns
    -------
    tuple of FitTrial
        Those that are not None.

    """
    moved = []
    for (trial, phases), each in zip(trials, made, strict=True):
        displacement = _displacement(trial, phases)
        if each is None:
            continue
        if displacement is None or each.path.still < math.inf:
            # A smooth way is none of an arm's.
            moved.append(each)
            continue
        path = tool_path(displacement, phases, servo)
        moved.append(replace(each, path=path, displacement=path.at(each.t)))
    return tuple(moved)


def _displacement(trial: Trial, phases: Segmentation) -> Signal | None:
    """Return the tool's displacement beyond the detected touch; None without one."""
    tool = trial.tool_height.between(-math.inf, np.nextafter(phases.t_end, math.inf))
    if phases.t_contact is None or phases.contact_height is None or len(tool) < _FEWEST:
        return None
    return Signal(tool.t, phases.contact_height - tool.value)


def astray_height(trial: Trial, phases: Segmentation) -> str | None:
    """
    Return why a displacement height cannot be that of the object under the tool.

    Parameters
    ----------
    trial, phases : Trial, Segmentation
        What was measured, and its phases.

    Returns
    -------
    str or None
        None where the height goes with the tool while this is on the object, or is not seen then.

    """
    whole = phases.entire
    height, displacement = trial.displacement_height, _displacement(trial, whole)
    if height is None or displacement is None or trial.displacement_source == 'tool':
        return None
    end = math.inf if whole.t_release is None else whole.t_release
    touch = float(whole.t_contact or 0.0)
    pressed = (height.t > touch) & (height.t < min(end, float(displacement.t[-1])))
    way = np.interp(height.t[pressed], displacement.t, displacement.value)
    value = height.value[pressed]
    least = max(_SEEN_WAY * float(displacement.value.max()), 0.0)
    if value.size < _FEWEST or float(np.ptp(way)) <= least:
        return None
    way = way - way.mean()
    power = float(way @ way)
    slope = float(way @ value) / power
    error = float(np.std(value - value.mean() - slope * way)) * math.sqrt(1.0 / power)
    if slope + 3.0 * error >= _LEAST_FOLLOWED and slope - 3.0 * error <= _MOST_FOLLOWED:
        return None
    return (
        f'the displacement height goes {slope:.4g} times as far as the tool that presses '
        f'(check the sensor, its sign and its unit)'
    )


def _is_pressed(height: Signal | None) -> bool:
    """Return whether an object is pressed in when its record begins."""
    if height is None or len(height) < 2 * _FIRST:
        return False
    most = float(height.value[~suspects(height.value)].max())
    return float(np.median(height.value[:_FIRST])) > _PRESSED * most


def _with_gaps(
    samples: Samples, t: FloatArray, interval: float, eventful: NDArray[np.bool_]
) -> tuple[Samples, NDArray[np.bool_]]:
    """Return the samples with steps of their own in each gap, and what is eventful of all."""
    steps = np.diff(t)
    beside = np.full(steps.size, interval)
    beside[1:] = np.maximum(beside[1:], steps[:-1])
    beside[:-1] = np.maximum(beside[:-1], steps[1:])
    # Where a record is sparse for long, each sample stands for its surroundings.
    gaps = np.flatnonzero(steps > _SILENT * beside)
    if gaps.size == 0:
        return samples, eventful
    edges, places, forces = [np.delete(samples.edges, gaps + 1)], list[int](), list[float]()
    for gap in gaps.tolist():
        count = min(round(float(steps[gap]) / interval) - 1, _MOST_MISSING)
        inside = (t[gap] + 0.5 * interval, t[gap + 1] - 0.5 * interval)
        edges.append(np.linspace(*inside, count + 1))
        places += [gap + 1] * count
        ends = samples.force[gap], samples.force[gap + 1]
        forces += np.linspace(*ends, count + 2)[1:-1].tolist()
    return (
        Samples(
            np.sort(np.concatenate(edges)),
            np.insert(samples.force, places, forces),
            np.insert(samples.good, places, False),
            np.insert(np.zeros(t.size, dtype=np.bool_), places, True),
        ),
        np.insert(eventful, places, False),
    )


def _steps(
    edges: FloatArray,
    events: FloatArray,
    interval: float,
    windows: bool,
    straight: FloatArray | None = None,
) -> NDArray[np.intp]:
    """
    Return which edges remain: sparse far from the events, and all of them near these.

    A step of a regular record lasts no longer than the tool's way is `straight` around it [s].
    """
    kept = np.zeros(edges.size, dtype=np.bool_)
    kept[[0, 1, -1]] = True
    most = np.full(edges.size - 1, float(edges.size))
    if straight is not None:
        # In twos: all is worked out anew for each other length, and knots come at any.
        most = 2.0 ** np.floor(np.log2(np.clip(straight / interval, 1.0, edges.size)))
    _keep(edges, events, interval, _WINDOW if windows else 0, most, kept)
    return np.flatnonzero(kept)


@kernel()
def _keep(edges, events, interval, window, most, kept):  # type: ignore[no-untyped-def]
    """
    Mark the edges that remain.

    Many steps in a row are of one length: what a chain of elements does in a step is worked out
    anew for each other length.
    """
    since = 0
    after = 0
    for i in range(edges.size - 1):
        middle = 0.5 * (edges[i + 1] + edges[i])
        while after < events.size and events[after] <= middle:
            after += 1
        distance = np.inf
        if after > 0:
            distance = middle - events[after - 1]
        if after < events.size:
            distance = min(distance, events[after] - middle)
        samples = 1.0
        if i % _WINDOW_EVERY >= window:
            # Without events one step is as good as many.
            samples = min(max(_GROWTH * distance / interval, 1.0), most[i])
            # The nearest whole number of so few digits, in twos.
            unit = 2.0 ** max(np.floor(np.log2(samples)) - _DIGITS, 0.0)
            samples = unit * np.round(samples / unit)
        since += 1
        if since >= samples and i > 0:
            kept[i + 1] = True
            since = 0


def _on_ticks(
    edges: FloatArray, steps: NDArray[np.intp], tick: float, force: FloatArray
) -> FloatArray:
    """
    Return edges, those between steps moved to where a regular clock would have them.

    Stamps that are off by a little make every step another length, and all is worked out anew
    for each. An edge may be moved as long as the force that the model has in a step is the same
    to a part of its noise, and all of them together by no more than their phase is known.
    """
    moved = edges.copy()
    noise = _scatter_of(force)
    if noise > 0.0 and tick > 0.0 and force.size > 2 * _ABOUT:
        # By how much the force goes on from sample to sample, noise apart; or jumps.
        change = np.abs(np.diff(force)) - _JUMPS * noise
        sums = np.cumsum(np.concatenate(([0.0], force)))
        means = (sums[_ABOUT:] - sums[:-_ABOUT]) / _ABOUT
        slope = (means[_ABOUT:] - means[:-_ABOUT]) / _ABOUT
        middle = slice(_ABOUT - 1, force.size - _ABOUT)
        change[middle] = np.maximum(change[middle], np.abs(slope))
        _move(edges, moved, steps, tick, change, _MOVED * noise)
    return moved


@kernel()
def _move(edges, moved, steps, tick, change, allowed):  # type: ignore[no-untyped-def]
    """Move edges to the ticks of a clock, whose phase is told anew where it is another."""
    since, stop = edges[0], 0
    for k in range(1, steps.size - 1):
        j = steps[k]
        if j >= stop:
            begin, stop = j, min(j + _PHASE, edges.size)
            off = edges[begin:stop] - since - tick * np.arange(begin, stop)
            middle = np.median(off)
            spread = np.median(np.abs(off - middle))
            unsure = spread / np.sqrt(stop - begin)
            if begin == steps[1] or np.abs(middle) > _OTHER_PHASE * unsure:
                since += middle
        if np.abs(edges[j + 1] - 2.0 * edges[j] + edges[j - 1]) < _REGULAR * tick:
            continue
        place = since + tick * j
        aside = np.abs(place - edges[j])
        if aside > min(_ASIDE * tick, _STRAY * spread) or not moved[j - 1] < place < edges[j + 1]:
            continue
        shorter = min(j - steps[k - 1], steps[k + 1] - j)
        if change[j - 1] * aside <= allowed * tick * np.sqrt(shorter):
            moved[j] = place


def _with_steps(trial: FitTrial, steps: NDArray[np.intp]) -> FitTrial:
    """Return a trial in the steps between some edges of its samples."""
    samples = trial.samples
    t = samples.edges[steps]
    start = steps[:-1]
    good = samples.good.astype(np.float64)
    count = np.add.reduceat(good, start)
    total = np.add.reduceat(samples.force * good, start)
    force = np.divide(total, count, out=np.zeros(count.size), where=count > 0.0)
    height_t, height, height_count = trial.height_t, trial.height, trial.height_count
    if height_t.size and height_t.size > steps.size // 4:
        where = np.searchsorted(t, height_t, side='right')
        # Within a step of one force the surface may do anything: heights that come faster stay.
        alone = (np.diff(steps) == 1)[np.clip(where - 1, 0, count.size - 1)]
        first = np.flatnonzero((np.diff(where, prepend=-1) != 0) | alone)
        weight = np.add.reduceat(height_count, first)
        height_t = np.add.reduceat(height_t * height_count, first) / weight
        height = np.add.reduceat(height * height_count, first) / weight
        height_count = weight
    return replace(
        trial,
        t=t,
        displacement=trial.path.at(t),
        force=force,
        force_count=count,
        height_t=height_t,
        height=height,
        height_count=height_count,
    )


def suspects(value: FloatArray) -> NDArray[np.bool_]:
    """
    Return which samples are glitches; quick where there are none.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Samples in order of time.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where a sample, or a few, stand out of their neighbourhood. A longer run can be what
        an object does, and is left to the residual of a fit.

    """
    none = np.zeros(value.size, dtype=np.bool_)
    if value.size < 8:
        return none
    curvature = np.abs(value[2:] - 2.0 * value[1:-1] + value[:-2])
    typical = float(np.median(curvature[:: max(1, curvature.size // 10_000)]))
    # A glitch shows at its ends, whatever its length.
    ends = np.flatnonzero(curvature > 8.0 * NORMAL_FROM_MAD * typical)
    if ends.size == 0:
        return none
    found = np.zeros(value.size, dtype=np.bool_)
    # Where a quantised record rests, that part alone does not show its steps.
    floor = resolution(value)
    for block in dict.fromkeys((ends // 2048).tolist()):
        low, high = max(0, block * 2048 - 512), min(value.size, (block + 1) * 2048 + 512)
        part = value[low:high]
        found[low:high] |= find_glitches(part, max(floor, resolution(part)))
    for first, last in runs(found):
        none[first:last] = last - first <= _LONGEST_GLITCH
    return none


def _misread(value: FloatArray) -> NDArray[np.bool_]:
    """Return which samples of a tool's way are glitches, and not a way there and back."""
    found = suspects(value)
    for first, last in runs(found):
        if last - first < _SHORTEST_WAY or first == 0 or last == value.size:
            continue
        with_ends = slice(first - 1, last + 1)
        steps = np.diff(value[with_ends])
        inside = np.abs(steps[1:-1])
        usual = float(np.median(inside))
        jump = max(abs(float(steps[0])), abs(float(steps[-1])), float(inside.max()))
        smooth = float(np.median(np.abs(np.diff(steps[1:-1])))) < 0.5 * usual
        if smooth and jump < _AS_USUAL * usual:
            found[first:last] = False
    return found


def _astray(height: Signal, phases: Segmentation, turns: Sequence[float]) -> NDArray[np.bool_]:
    """
    Return which heights are beyond both of their neighbours, far from where the tool turns.

    A surface that is pushed down goes on steadily: beside its way such a one is no part of it.
    """
    t, value = height.t, height.value
    astray = np.zeros(value.size, dtype=np.bool_)
    if value.size < 8:
        return astray
    noise = _scatter_of(value)
    astray = (noise > 0.0) & (_outside(value) > _ASTRAY * noise)
    reach = 2.0 * float(np.median(np.diff(t)))
    for event in (phases.t_hold, phases.t_release, phases.t_loss, *turns):
        if event is not None:
            astray &= np.abs(t - event) > reach
    return astray


def jitter_of(t: FloatArray) -> float:
    """
    Return by how much stamps are off a regular clock.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Stamps in order of time [s]; some of the clock's ticks may be missing.

    Returns
    -------
    float
        A standard deviation [s]; zero for a clock that is exact, for stamps of no clock, and for
        few of them.

    """
    if t.size < _FEWEST_STAMPS:
        return 0.0
    tick, steps = _tick(t), np.diff(t)
    if tick <= 0.0:
        return 0.0
    # Some ticks may be missing within a step, whose both ends are off.
    ticks = np.rint(steps / tick)
    within = (ticks > 0.0) & (ticks < _LONG_GAP)
    off = (steps - tick * ticks)[within]
    jitter = NORMAL_FROM_MAD * float(np.median(np.abs(off))) / math.sqrt(2.0)
    return jitter if _BY_THE_CLOCK * tick < jitter < _BY_NO_CLOCK * tick else 0.0


def _tick(t: FloatArray) -> float:
    """Return the interval of the clock that stamps are of, some of them missing [s]."""
    steps = np.diff(t)
    tick = float(np.median(steps))
    if tick <= 0.0:
        return 0.0
    ticks = np.rint(steps / tick)
    within = (ticks > 0.0) & (ticks < _LONG_GAP)
    tick = float(steps[within].sum() / ticks[within].sum())
    # What one step has too little, if both ends are off, the next has too much.
    off = np.abs(steps - tick * ticks)[within]
    limit = max(_FRACTION * NORMAL_FROM_MAD * float(np.median(off)), _TO_THE_TICK * tick)
    count, time = _ticks(t, tick, limit)
    return float(time) / count if count > 0 else tick


@kernel()
def _ticks(t, usual, limit):  # type: ignore[no-untyped-def]
    """Return how many ticks of a clock its stamps take, and how long, by one that follows."""
    total, time = 0, 0.0
    clock = t[0]
    for i in range(1, t.size):
        ticks = np.rint((t[i] - clock) / usual)
        step = t[i] - t[i - 1]
        whole = np.rint(step / usual)
        if whole >= _LONG_GAP or np.abs(step - usual * whole) > limit:
            # The part of a tick in a pause is no error of the clock.
            clock = t[i]
            continue
        total += int(ticks)
        time += step
        clock += ticks * usual
        clock += _SET_BY * (t[i] - clock)
    return total, time


def _scatter_of(value: FloatArray) -> float:
    """Return by how much values that go on evenly scatter, as a standard deviation."""
    return NORMAL_FROM_MAD * float(np.median(np.abs(np.diff(value, 2)))) / math.sqrt(6.0)


def _outside(value: FloatArray) -> FloatArray:
    """Return how far each sample is beyond both of its neighbours; at least zero."""
    beyond = np.zeros(value.size)
    before, here, after = value[:-2], value[1:-1], value[2:]
    beyond[1:-1] = np.maximum(here - np.maximum(before, after), np.minimum(before, after) - here)
    return np.maximum(beyond, 0.0)


def _lone(
    force: Signal, phases: Segmentation, path: ToolPath, interval: float
) -> NDArray[np.bool_]:
    """
    Return which forces near a touch or a stop are glitches nevertheless.

    What an object does there begins with the event or goes on for some samples: one that is alone,
    between two that are as they should be, is a sensor's.
    """
    lone = np.zeros(force.t.size, dtype=np.bool_)
    if lone.size < 8:
        return lone
    beyond = _outside(force.value)
    noise = _scatter_of(force.value)
    lone = beyond > _ASTRAY * noise
    if not lone.any():
        return lone
    lone &= beyond > _LONE_STEPS * rounding(force.value)
    # The two before and the two after are on one line.
    value = force.value
    beside = np.stack((value[:-4], value[1:-3], value[3:-1], value[4:]))
    slope = (_NEXT @ beside) / float(_NEXT @ _NEXT)
    miss = np.abs(beside - beside.mean(axis=0) - slope * _NEXT[:, np.newaxis]).max(axis=0)
    lone[:2] = lone[-2:] = False
    lone[2:-2] &= miss < np.maximum(_ON_LINE * beyond[2:-2], 3.0 * noise)
    # A sticky object lets go at once.
    if phases.t_release is not None:
        lone &= force.t < phases.t_release
    reach = _LONE * interval + 2.0 * path.interval
    spans = [(t, t) for t in (phases.t_contact, phases.t_hold) if t is not None]
    spans += [(bend.start, bend.stop) for bend in path.bends]
    for first, last in spans:
        lone[(force.t > first - reach) & (force.t < last + reach)] = False
    return lone


def near_events(
    t: FloatArray, phases: Segmentation, interval: float, others: Sequence[float] = ()
) -> NDArray[np.bool_]:
    """
    Return which samples are so near to an event that what stands out may be the object's doing.

    A blow at the touch or the pull of a sticky object lasts for a few samples, as a glitch does.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the samples [s].
    phases : Segmentation
        The events.
    interval : float
        Usual interval between two samples [s].
    others : sequence of float
        Further events [s].

    Returns
    -------
    ndarray of bool, shape (n,)
        True within some samples of a touch, a stop, the start of the release or the loss.

    """
    near = np.zeros(t.size, dtype=np.bool_)
    for event in (phases.t_contact, phases.t_hold, phases.t_release, phases.t_loss, *others):
        if event is not None:
            reach = _LONGEST_GLITCH * interval
            first = np.searchsorted(t, event - reach)
            last = np.searchsorted(t, event + reach, side='right')
            near[first:last] = True
    return near


def _onset_std(force: Signal, path: ToolPath, touch: float, interval: float) -> float:
    """Return how well the detected touch is known, as a displacement [m]."""
    early = np.interp(touch + np.array([0.0, 4.0 * interval]), path.t, path.displacement)
    travelled = abs(float(early[1] - early[0])) / 4.0
    depth = float(path.displacement.max())
    air = force.between(-math.inf, touch - 2.0 * interval).value
    if air.size >= _BASELINE:
        noise = float(np.std(air))
    else:
        curvature = np.abs(np.diff(force.value, 2))
        noise = NORMAL_FROM_MAD * float(np.median(curvature)) / math.sqrt(6.0)
    inside = force.between(touch, math.inf)
    travel = path.at(inside.t)
    error = math.inf
    for share in _SHALLOW:
        rise = inside.value[: max(int(np.argmax(travel > share * depth)), 4)]
        # How far the tool goes on until the force stands out of the noise.
        gained = float(rise[-1] - rise[0]) if rise.size < 8 else float(np.ptp(rise))
        # Force without noise shows the touch itself.
        error = min(error, 2.0 * share * depth * noise / max(gained, noise, 1e-300))
    return math.hypot(travelled, path.noise, error, _DETECTION * depth)


class _Turned(NamedTuple):
    """
    A change of speed in a path.

    Parameters
    ----------
    bend : Bend
        How the path goes there.
    level : float
        Where the straight pieces would meet [m].
    corner : Corner
        What the encoders tell of it.
    shape : Shape
        What it goes like by these, whether or not it is told from a sharp corner.

    """

    bend: Bend
    level: float
    corner: Corner
    shape: Shape

    @property
    def knots(self) -> list[tuple[float, float]]:
        """Return the corners of the path, times and levels: two of a stop and a start [s, m]."""
        slopes = self.corner.slope, self.corner.next_slope
        halves = self.bend.halves
        if len(halves) == 1:
            return [(self.bend.t, self.level)]
        return [
            (half.t, self.level + slope * (half.t - self.bend.t))
            for half, slope in zip(halves, slopes, strict=True)
        ]


type _Part = _Turned | list[tuple[float, float]]
"""Of a path: a change of speed, or corners, each a time and a level."""


def _goes_on(displacement: Signal, touch: float, unsure: float) -> bool:
    """Return whether the tool goes on after the touch by more than is unsure of it there."""
    # A reading of the encoders that is far off is no way.
    good = ~_misread(displacement.value)
    t, value = displacement.t[good], displacement.value[good]
    after = t > touch
    beyond = float(value[after].max(initial=0.0))
    before = float(value[~after][-_TOUCHING:].max(initial=0.0))
    return beyond > before + min(unsure, 0.5 * beyond)


def tool_path(displacement: Signal, phases: Segmentation, servo: Servo | None = None) -> ToolPath:
    """
    Return the tool's path as straight pieces that follow the encoders within their noise.

    The dashpots make force of speed, so that differences of noisy samples will not do. Pieces are
    split in two where their samples, or means of 4 to 64 of them, leave a straight line by more
    than the noise allows, so that a curved path is followed by many of them. Corners between two
    clear slopes go to where the lines meet, and the levels at all corners are those of least
    squares. A tool that goes neither straight nor by the shapes of arms, as with gears that
    ripple or where a force leads it, is followed along the smoothest way that the noise allows.
    Encoders that are nearly exact are followed as far as the shapes of arms go.

    Parameters
    ----------
    displacement : Signal
        Tool displacement beyond the first touch [m], as the encoders tell it.
    phases : Segmentation
        Where corners are to be expected.
    servo : Servo, optional
        How the arm changes its speed, where the campaign tells it.

    Returns
    -------
    ToolPath
        The path; where that takes too many corners or is a smooth way, from a fifth of the depth
        above the object on only roughly.

    """
    return _path(displacement, phases, servo)[0]


def _path(
    displacement: Signal, phases: Segmentation, servo: Servo | None
) -> tuple[ToolPath, list[_Turned]]:
    """Return the path of the tool, and what it tells of how the arm changes its speed."""
    t, value = displacement.t, displacement.value
    bad = _misread(value)
    if bad.any():
        t, value = t[~bad], value[~bad]
    t, value = readings(t, value)
    noise = _encoder_noise(t, value)
    late = _late(t, value, noise)
    if late.any():
        t, value = t[~late], value[~late]
    top = -_AIR * float(value.max())
    below = np.flatnonzero(value > top)
    near = max(int(below[0]) - 1, 0), min(int(below[-1]) + 2, t.size)
    times = (phases.t_contact, phases.t_hold, phases.t_release, phases.t_loss)
    events = [time for time in times if time is not None]
    # A tool that has a mass is felt in the air as well where it changes its speed.
    first, last = 0, t.size
    touch = -math.inf if phases.t_contact is None else phases.t_contact
    depth = float(value.max())
    read = noise
    exact = noise < _EXACT[-1] * depth
    if exact:
        # A campaign's paths are made several times, for arms that change their speed otherwise.
        noise = _as_exact(t.tobytes(), value.tobytes(), noise, depth, tuple(events), touch)
    found = _closely(t, value, events, noise, servo, touch)
    if found is None:
        first, last = near
        found = _closely(t[first:last], value[first:last], events, noise, servo, touch)
    elif _above(t[near[0]], t[near[1] - 1], found[0]) > _MOST_IN_AIR:
        first, last, found = _without_air(t, found, near)
    # The arm is told by its changes of speed, also where another way follows the samples better.
    told = [] if found is None else found[2]
    still = math.inf
    way = None
    # What is nearly exact is noise between samples all the same, where no shapes follow them.
    if not exact or (
        read > _EXACT[0] * depth
        and (
            found is None
            or found[0].size > _CROWDED
            or _loose(found) >= min(_LOOSE, _timed(found) + 1)
        )
    ):
        way = _smooth_way(t[slice(*near)], value[slice(*near)], found, read)
    if way is not None:
        first, last = near
        found, still = (way.t, way.value, []), way.still
    if found is None:
        found = t[first:last], value[first:last], []
    knots, levels, turns = found
    tolerance = max(_COARSE * -top, _LEFT_SIGMAS * noise)
    before = _coarse(t[:first], value[:first], tolerance)
    after = _coarse(t[last:], value[last:], tolerance)
    unsteady = None
    if way is not None:
        unsteady = np.pad(way.unsteady, (before[0].size, after[0].size))
    interval = float(np.quantile(np.diff(t), _DENSE))
    path = ToolPath(
        np.concatenate((before[0], knots, after[0])),
        np.concatenate((before[1], levels, after[1])),
        noise,
        tuple(bend for bend in _bends(turns) if bend.stop > bend.start),
        interval,
        servo,
        _rest(turns, phases, float(value.max()), interval),
        still,
        unsteady,
        before[0].size + knots.size + after[0].size > 4 * _MOST_PIECES or still < math.inf,
    )
    return path, told


def _smooth_way(
    t: FloatArray,
    value: FloatArray,
    found: tuple[FloatArray, FloatArray, list[_Turned]] | None,
    noise: float,
) -> Way | None:
    """Return the smooth way of a tool that goes neither straight nor by the shapes of arms."""
    if t.size < _FEWEST:
        return None
    error = rounding(value)
    # Readings that round and have hardly other noise err as one where they go on evenly.
    step = math.sqrt(12.0) * error
    rounds = noise < _DITHERED * error
    alike = _repeated(value, step) if rounds else np.ones(t.size)
    samples = float(np.sum(1.0 / alike))
    least = _FOLLOWED * samples
    if found is not None:
        corners = found[0].size - 2 - len(_bends(found[2]))
        faint = _faint(found)
        least = _misfit(t, value, found, noise, alike)
        few = corners < _LOOSE and found[0].size <= _CROWDED
        if few and not faint and least < _BADLY * samples:
            return None
        least += _FAINT * faint * math.log(t.size)
    # Also where no two are the same: what rounding makes of an even speed may ripple.
    way = smooth(t, value, noise, alike if rounds else None)
    return way if way.misfit < least else None


def _faint(found: tuple[FloatArray, FloatArray, list[_Turned]]) -> int:
    """
    Return at how many corners a tool presses on nearly as before.

    An arm that is told a speed seldom does that; one that is to press with a force does, as the
    object gives way, along a curve.
    """
    slopes = np.diff(found[1]) / np.diff(found[0])
    touching = found[1][1:] > 0.0
    little = _HELD * float(slopes[touching].max(initial=0.0))
    presses = touching & (slopes > little)
    nearly = np.abs(np.diff(slopes)) < little
    return int(np.count_nonzero(nearly & presses[1:] & presses[:-1]))


def _repeated(value: FloatArray, step: float) -> FloatArray:
    """
    Return of how many readings one after the other each is one that err as one.

    They are the same, or a tool that rests near the edge between two readings gives these in turn,
    or they go on by the same number of steps from each to the next for long: so the errors of
    rounding change by little from one to the next.
    """
    alike = _lengths(np.diff(value) != 0.0)
    _resting(value, 1.5 * step, alike)
    evenly = _lengths(np.abs(np.diff(value, 2)) > 0.5 * step) + 1.0
    evenly[evenly < _EVENLY] = 1.0
    alike[:-1] = np.maximum(alike[:-1], evenly)
    alike[1:] = np.maximum(alike[1:], evenly)
    return alike


def _lengths(changes: NDArray[np.bool_]) -> FloatArray:
    """Return the lengths of runs without a change from each to the next, for each in them."""
    starts = np.flatnonzero(np.concatenate(([True], changes)))
    counts = np.diff(starts, append=changes.size + 1)
    return np.repeat(counts, counts).astype(np.float64)


@kernel()
def _resting(value, reach, alike):  # type: ignore[no-untyped-def]
    """Count readings that stay within a reach for long as one."""
    first = 0
    while first < value.size:
        least = most = value[first]
        stop = first + 1
        while stop < value.size:
            least = min(least, value[stop])
            most = max(most, value[stop])
            if most - least >= reach:
                break
            stop += 1
        if stop - first > _RESTS:
            alike[first:stop] = stop - first
        first = stop


def _misfit(
    t: FloatArray,
    value: FloatArray,
    found: tuple[FloatArray, FloatArray, list[_Turned]],
    noise: float,
    alike: FloatArray,
) -> float:
    """
    Return what a path leaves of samples, over the noise, with a price for its corners.

    It is that of places which are searched for, N. R. Zhang and D. O. Siegmund, Biometrics 63,
    2007, 22-32, doi:10.1111/j.1541-0420.2006.00662.x.
    """
    knots, levels, turns = found
    miss = value - ToolPath(knots, levels, noise, tuple(_bends(turns))).at(t)
    corners = np.count_nonzero((knots >= t[0]) & (knots <= t[-1]))
    return float(miss @ (miss / alike)) / noise**2 + 3.0 * corners * math.log(t.size)


def _bends(turns: Sequence[_Turned]) -> list[Bend]:
    """Return the changes of speed of a path, a stop and a start apart from each other."""
    return [bend for turn in turns for bend in turn.bend.halves]


def _on_the_object(turn: _Turned, phases: Segmentation, interval: float) -> bool:
    """Return whether a change of speed ends on the object, or is one that leads away from it."""
    end = phases.t_end if phases.t_loss is None else phases.t_loss
    # A quick withdrawal is off the object at once.
    end += _EDGE_SAMPLES[0] * interval + turn.bend.lasts
    return turn.bend.stop > float(phases.t_contact or 0.0) and turn.bend.start < end


@lru_cache(maxsize=64)
def _as_exact(
    t: bytes,
    value: bytes,
    noise: float,
    depth: float,
    events: tuple[float, ...],
    touch: float,
) -> float:
    """
    Return to what encoders that are nearly exact are to be followed [m].

    No arm goes quite as any of the shapes. Where they follow the samples to a part of the depth
    that matters to no force, they tell what is between these; a path through the samples does not.
    """
    samples, heights = np.frombuffer(t).copy(), np.frombuffer(value).copy()
    exact = noise < _EXACT[0] * depth
    if exact and _on_a_grid(heights, depth):
        return 0.0
    # The samples themselves, or a curve through them, are the path where no shape follows them.
    best, most = 0.0 if exact else noise, 0
    for part in _EXACT:
        least = max(noise, part * depth)
        if part == _EXACT[-1] and exact and _is_smooth(samples, heights, depth):
            corners = len(_on_lines(samples, heights, least)) - 1
            # A curve through dense samples is better than shapes that follow them nearly.
            dense = _is_smooth(samples, heights, depth, _EXACT[0])
            return 0.0 if dense or 2 * most <= corners else best
        found = _closely(samples, heights, events, least, None, touch)
        if found is None:
            continue
        # A corner that is followed only roughly is none.
        count = len(_bends(found[2])) if part == _EXACT[0] else _timed(found)
        if count == found[0].size - 2:
            return least
        if count > most:
            best, most = least, count
    return best


def _rest(
    turns: Sequence[_Turned], phases: Segmentation, depth: float, interval: float
) -> Rest | None:
    """Return how well it is known where the tool is held; None if that is no matter."""
    held = [turn for turn in turns if turn.corner.is_stop and turn.corner.rest == 1]
    if not held or phases.t_hold is None:
        return None
    t_hold = phases.t_hold
    stop = min(held, key=lambda turn: abs(turn.bend.t - t_hold))
    coarse = stop.corner.coarse
    far = abs(stop.bend.t - t_hold) > stop.bend.lasts + _CORNER_SAMPLES * interval
    if coarse < _COARSE_REST * depth or far:
        return None
    return Rest(stop.bend.t, coarse / math.sqrt(3.0))


def _without_air(
    t: FloatArray,
    found: tuple[FloatArray, FloatArray, list[_Turned]],
    near: tuple[int, int],
) -> tuple[int, int, tuple[FloatArray, FloatArray, list[_Turned]]]:
    """Return the part of a path near the object, with all of the changes of speed in it."""
    knots, levels, turns = found
    first, last = near
    kept = [turn for turn in turns if turn.bend.stop > t[first] and turn.bend.start < t[last - 1]]
    if kept:
        first = min(first, int(np.searchsorted(t, min(turn.bend.start for turn in kept))) - 1)
        last = max(last, int(np.searchsorted(t, max(turn.bend.stop for turn in kept))) + 1)
    first, last = max(first, 0), min(last, t.size)
    inside = (knots > t[first]) & (knots < t[last - 1])
    ends = t[[first, last - 1]]
    made = np.concatenate((ends[:1], knots[inside], ends[1:]))
    return first, last, (made, np.interp(made, knots, levels), kept)


def _above(start: float, stop: float, knots: FloatArray) -> int:
    """Return how many corners a path has before a time and after another."""
    return int(np.count_nonzero((knots < start) | (knots > stop)))


def _closely(
    t: FloatArray,
    value: FloatArray,
    events: Sequence[float],
    noise: float,
    servo: Servo | None,
    touch: float,
) -> tuple[FloatArray, FloatArray, list[_Turned]] | None:
    """Return a path that follows the samples; None where it takes too many corners."""
    if noise <= 0.0 or t.size < 16:
        return *_thinned(*_curved(t, value)), []
    breaks = tuple(sorted({b for b in events if t[1] < b < t[-2]}))
    most = _MOST_PIECES * _ways(value)
    knots, levels = _by_pieces(t.tobytes(), value.tobytes(), breaks, noise, most)
    coarse = ROUNDED * math.sqrt(3.0) * rounding(value)
    found = None
    if knots.size <= most or (knots.size <= _UNBENT * most and _goes_by_ramps(knots, levels)):
        found = _bent(t, value, knots, levels, noise, coarse, servo, touch)
        if found[0].size > most:
            found = None
    loose = math.inf if found is None else _loose(found)
    if loose > 0 and coarse == 0.0 and noise <= _EXACT[-1] * float(value.max()):
        other = _between_lines(t, value, noise, servo, touch)
        if other is not None and (found is None or _timed(other) >= _timed(found)):
            return other
    return found


@lru_cache(maxsize=64)
def _by_pieces(
    t: bytes, value: bytes, breaks: tuple[float, ...], noise: float, most: int
) -> tuple[FloatArray, FloatArray]:
    """Return the corners of straight pieces that follow samples, and the levels there."""
    # A campaign's paths are made many times, for arms that change their speed otherwise.
    times, heights = np.frombuffer(t).copy(), np.frombuffer(value).copy()
    pieces = _pieces(times, heights, breaks, noise, _UNBENT * most)
    knots, levels = _levels(times, heights, _meet(times, heights, pieces, noise))
    knots, levels = _followed(times, heights, knots, levels, noise, most)
    for each in (knots, levels):
        each.flags.writeable = False
    return knots, levels


def _goes_by_ramps(knots: FloatArray, levels: FloatArray) -> bool:
    """Return whether the speed changes the same way at most corners as at those before them."""
    faster = np.diff(np.diff(levels) / np.diff(knots)) > 0.0
    return bool(np.count_nonzero(faster[1:] != faster[:-1]) < _TO_AND_FRO * faster.size)


def _ways(value: FloatArray) -> int:
    """Return how many times a tool goes there and back, by a part of its way that is not small."""
    few = value[:: max(1, value.size // _FEW_LOOKS)]
    least = _WAY * float(np.ptp(few))
    turns, low, high, up = 0, few[0], few[0], True
    for each in few.tolist():
        low, high = min(low, each), max(high, each)
        if up and each < high - least:
            turns, low, up = turns + 1, each, False
        elif not up and each > low + least:
            turns, high, up = turns + 1, each, True
    return min(max((turns + 1) // 2, 1), _MOST_WAYS)


def _timed(found: tuple[FloatArray, FloatArray, list[_Turned]]) -> int:
    """Return how many changes of speed of a path are followed by a shape that takes time."""
    return len(_bends([turn for turn in found[2] if turn.bend.stop > turn.bend.start]))


def _loose(found: tuple[FloatArray, FloatArray, list[_Turned]]) -> int:
    """Return at how many corners of a path no shape follows the samples."""
    return found[0].size - 2 - _timed(found)


def _on_lines(t: FloatArray, value: FloatArray, noise: float) -> list[tuple[int, int]]:
    """Return the first and the last sample of each piece that is straight within the noise."""
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    beside = value[1:-1] - (1.0 - share) * value[:-2] - share * value[2:]
    pieces = []
    for first, last in runs(np.abs(beside) <= noise):
        # Sample k + 1 is the one between k and k + 2; where the speed begins to change, each is
        # on a line with its neighbours for a while.
        end = last + 2
        away = (end - first) // 4
        inner = slice(first + away, end - away)
        level, slope = _line(t[inner], value[inner], np.ones(end - first - 2 * away))
        on = np.abs(value[first:end] - level - slope * t[first:end]) <= noise
        start, stop = max(runs(on), key=lambda run: run[1] - run[0], default=(0, 0))
        if stop - start >= _FEWEST_ON_LINE:
            pieces.append((first + start, first + stop - 1))
    return pieces


def _between_lines(
    t: FloatArray,
    value: FloatArray,
    noise: float,
    servo: Servo | None,
    touch: float,
) -> tuple[FloatArray, FloatArray, list[_Turned]] | None:
    """
    Return a path of straight pieces and the changes of speed between them.

    Three samples that are nearly exact tell a line, so that a tool which goes to and fro with few
    samples between its turns is followed as well.
    """
    pieces = _on_lines(t, value, noise)
    if len(pieces) < 2:
        return None
    step = float(np.median(np.diff(t)))
    curve: tuple[FloatArray, FloatArray] | None = None
    new_t, new_levels = t[: pieces[0][0] + 1].tolist(), value[: pieces[0][0] + 1].tolist()
    turns: list[_Turned] = []
    for (first, last), (after, end) in pairwise(pieces):
        around = t[[first, last, after, end]].tolist()
        slopes = [
            (value[stop] - value[start]) / (t[stop] - t[start])
            for start, stop in ((first, last), (after, end))
        ]
        mine = servo if _may_last_until(servo, slopes, t[after], touch) else None
        tried = (
            _bend(t, value, around, step, noise, 0.0, 0, known)
            for known in ((mine, None) if mine is not None else (None,))
        )
        found = next(filter(None, tried), None)
        if found is None:
            # Two changes of speed in one, say: the samples, or a curve through them.
            if curve is None:
                curve = _curved(t, value)
            inside = (curve[0] >= t[last]) & (curve[0] <= t[after])
            new_t += curve[0][inside].tolist()
            new_levels += curve[1][inside].tolist()
            continue
        new_t += [at for at, _ in found.knots]
        new_levels += [level for _, level in found.knots]
        turns.append(found)
    rest = slice(pieces[-1][1], None)
    new_t += t[rest].tolist()
    new_levels += value[rest].tolist()
    made, heights = np.array(new_t), np.array(new_levels)
    if np.any(np.diff(made) <= 0.0):
        return None
    return made, heights, turns


def _coarse(t: FloatArray, value: FloatArray, tolerance: float) -> tuple[FloatArray, FloatArray]:
    """Return corners of a path in the air, where friction alone depends on it."""
    if t.size < 2:
        return t, value
    corners = [0, t.size - 1]
    while len(corners) < _MOST_IN_AIR:
        away = np.abs(value - np.interp(t, t[corners], value[corners]))
        far = int(np.argmax(away))
        if away[far] <= tolerance:
            break
        corners = sorted([*corners, far])
    return t[corners], value[corners]


def _bent(
    t: FloatArray,
    value: FloatArray,
    knots: FloatArray,
    levels: FloatArray,
    noise: float,
    coarse: float,
    servo: Servo | None,
    touch: float,
    *,
    short: bool = True,
) -> tuple[FloatArray, FloatArray, list[_Turned]]:
    """
    Return the path with corners in place of the short pieces over which the tool changes speed.

    An arm takes some time to change its speed. Two straight pieces and an acceleration between
    them take the place of the corners there if they follow the samples as well, but for `coarse`,
    by which the encoders round. The arm is known to do it as `servo` where that may go on after
    the touch. `short` moves may be of two changes of speed that no line parts.
    """
    step = float(np.median(np.diff(t)))
    groups: list[list[int]] = []
    for k in range(1, knots.size - 1):
        if groups and knots[k] - knots[groups[-1][-1]] <= _CORNER_SAMPLES * step:
            groups[-1].append(k)
        else:
            groups.append([k])
    parts: list[_Part] = [[(float(knots[0]), float(levels[0]))]]
    are_short = False
    pending = groups[::-1]
    while pending:
        group = pending.pop()
        around = knots[[group[0] - 1, group[0], group[-1], group[-1] + 1]].tolist()
        slopes = [
            (levels[k + 1] - levels[k]) / (knots[k + 1] - knots[k])
            for k in (group[0] - 1, group[-1])
        ]
        mine = servo if _may_last_until(servo, slopes, around[2], touch) else None
        beside = slice(group[0] - 1, group[-1] + 2)
        ramp = len(group) >= _FEWEST_OF_A_RAMP and _goes_by_ramps(knots[beside], levels[beside])
        others = (
            _gap(knots, group[0] - 1, -1, _CORNER_SAMPLES * step),
            _gap(knots, group[-1] + 1, 1, _CORNER_SAMPLES * step),
        )
        # A quick push has few samples of the encoders before it stops.
        tried = (
            _bend(t, value, around, step, noise, coarse, edge, known, ramp=ramp, others=others)
            for known in ((mine, None) if mine is not None else (None,))
            for edge in _EDGE_SAMPLES
        )
        found = next(filter(None, tried), None)
        if found is None and mine is not None and short and coarse <= noise:
            both = _short_move(t, value, knots, levels, group, step, noise, mine, others)
            if both is not None:
                are_short = True
                parts += both
                continue
        gaps = np.diff(knots[group])
        waits = found is not None and found.shape.wait > 0.0 and not found.bend.common
        if (found is None or waits) and _are_apart(gaps, step):
            # A stop and the start of the release after a short hold are two changes of speed.
            cut = int(np.argmax(gaps)) + 1
            pending += [group[cut:], group[:cut]]
            continue
        if found is None:
            parts.append(list(zip(knots[group].tolist(), levels[group].tolist(), strict=True)))
            continue
        parts.append(found)
    parts.append([(float(knots[-1]), float(levels[-1]))])
    _rest_alike(parts)
    made, heights, turns, after = _joined(t, value, parts, noise, coarse)
    for _ in range(_LINED_AGAIN):
        anew = _lined_again(t, value, parts, step, noise, coarse, servo)
        if anew is None:
            break
        _rest_alike(anew)
        joined = _joined(t, value, anew, noise, coarse)
        if joined[-1] > after - SHOWN * noise**2 or np.any(np.diff(joined[0]) <= 0.0):
            break
        parts, (made, heights, turns, after) = anew, joined
    before = float(np.sum((value - np.interp(t, knots, levels)) ** 2))
    # The pieces between are those of least squares by themselves: all must still follow.
    if np.any(np.diff(made) <= 0.0) or after > _NO_WORSE * before + t.size * noise**2:
        if are_short:
            return _bent(t, value, knots, levels, noise, coarse, servo, touch, short=False)
        return knots, levels, []
    return made, heights, turns


def _joined(
    t: FloatArray,
    value: FloatArray,
    parts: Sequence[_Part],
    noise: float,
    coarse: float,
) -> tuple[FloatArray, FloatArray, list[_Turned], float]:
    """Return the corners of a path of parts, its changes of speed, and the squares it leaves."""
    turns = [part for part in parts if isinstance(part, _Turned)]
    ends = [each for part in parts for each in (part.knots if isinstance(part, _Turned) else part)]
    made, heights = np.array(ends).T
    path = ToolPath(made, heights, noise, tuple(_bends(turns)))
    return made, heights, turns, float(np.sum(_beyond(value - path.at(t), coarse) ** 2))


def _lined_again(
    t: FloatArray,
    value: FloatArray,
    parts: Sequence[_Part],
    step: float,
    noise: float,
    coarse: float,
    servo: Servo | None,
) -> list[_Part] | None:
    """
    Return the parts with those lines anew that samples of a change of speed have bent, if any.

    Where one begins and ends is known once a shape follows it. Of a quick push, with little
    between two long changes of speed, the corners told it too roughly.
    """
    bent = set[int]()
    for k, (one, other) in enumerate(pairwise(parts)):
        if not isinstance(one, _Turned) or not isinstance(other, _Turned):
            continue
        inside = _within(t, one.bend.stop, other.bend.start)
        count = inside.stop - inside.start
        if count < _EDGE_SAMPLES[1]:
            continue
        (at, level), (end, next_level) = one.knots[-1], other.knots[0]
        near, there = t[inside], value[inside]
        off = there - level - (next_level - level) / (end - at) * (near - at)
        line = _line(near, there, np.ones(count))
        left = there - line[0] - line[1] * near
        squares = float(np.sum(_beyond(off, coarse) ** 2))
        if squares - float(left @ left) > SHOWN * noise**2:
            bent |= {k, k + 1}
    made = list(parts)
    for k in sorted(bent):
        before, turn, after = parts[k - 1], parts[k], parts[k + 1]
        assert isinstance(turn, _Turned)
        start, stop = turn.bend.start, turn.bend.stop
        first = before.bend.stop if isinstance(before, _Turned) else before[-1][0]
        last = after.bend.start if isinstance(after, _Turned) else after[0][0]
        sides = _within(t, first, start), _within(t, stop, last)
        if min(side.stop - side.start for side in sides) < _EDGE_SAMPLES[1]:
            continue
        known = servo if turn.bend.common else None
        found = _bend(t, value, (first, start, stop, last), step, noise, coarse, 0, known)
        if found is not None:
            made[k] = found
    return made if any(a is not b for a, b in zip(made, parts, strict=True)) else None


def _rest_alike(parts: list[_Part]) -> None:
    """
    Let a tool that reads the same after a stop and before the next start rest at one place.

    Each of the two tells for itself where within a step of the encoders that is, by how the tool
    comes there and leaves it, and two places would be a tool that creeps. It is their mean, as how
    well each is told hangs on shapes that are hardly known.
    """
    for k in range(len(parts) - 1):
        one, other = parts[k], parts[k + 1]
        if not isinstance(one, _Turned) or not isinstance(other, _Turned):
            continue
        stop, start = one.corner, other.corner
        if stop.rest != 1 or start.rest != 0 or stop.next_level != start.level:
            continue
        shift = 0.5 * (one.level + other.level) - start.level
        for place, turn in ((k, one), (k + 1, other)):
            meeting, level = turn.corner.meeting(shift)
            parts[place] = turn._replace(bend=replace(turn.bend, t=meeting), level=level)


def _short_move(
    t: FloatArray,
    value: FloatArray,
    knots: FloatArray,
    levels: FloatArray,
    group: Sequence[int],
    step: float,
    noise: float,
    servo: Servo,
    others: tuple[float, float],
) -> list[_Turned] | None:
    """Return two changes of speed with too little between them for a line, if corners are both."""
    first, last = group[0] - 1, group[-1] + 1
    if servo.stops or servo.scaled or len(group) < _FEWEST_OF_A_RAMP:
        return None
    inside = slice(first, last + 1)
    slopes = np.diff(levels[inside]) / np.diff(knots[inside])
    beyond = slopes - 0.5 * (slopes[0] + slopes[-1])
    quickest = int(np.argmax(np.abs(beyond)))
    if not 0 < quickest < slopes.size - 1:
        return None
    lines = [
        (levels[k] - slopes[j] * knots[k], slopes[j])
        for j, k in ((0, first), (quickest, first + quickest), (slopes.size - 1, last))
    ]
    turns = [float(b[1] - a[1]) for a, b in pairwise(lines)]
    if not all(turns):
        return None
    meetings = [(a[0] - b[0]) / turn for (a, b), turn in zip(pairwise(lines), turns, strict=True)]
    if not knots[first] < meetings[0] < meetings[1] < knots[last]:
        return None
    start = ShortMove(*lines[0], meetings[0], turns[0], meetings[1], turns[1])
    takes = max(servo.shape(turn).takes for turn in turns)
    if float(np.diff(knots[group]).max()) > takes:
        # A line between them shows each by itself.
        return None
    reach = takes + _CORNER_SAMPLES * step
    chosen = _within(
        t,
        max(knots[first] + others[0], knots[group[0]] - reach),
        min(knots[last] - others[1], knots[group[-1]] + reach),
    )
    t, value = t[chosen], value[chosen]
    if not _EDGE_SAMPLES[1] <= np.searchsorted(t, meetings[0]) <= t.size - _FEWEST:
        return None
    found = short_move(t, value, noise, servo, start)
    if found is None or not knots[first] < found[0].t < found[0].next_t < knots[last]:
        return None
    move, errors = found
    left = value - move.at(t, servo)
    # What is straight before and after it must not hide what is left of it.
    near = left[_within(t, move.t - takes, move.next_t + takes)]
    corners = value - np.interp(t, knots, levels)
    if float(near @ near) > _FOLLOWS**2 * near.size * noise**2 or float(left @ left) > (
        _NO_WORSE * float(corners @ corners) + t.size * noise**2
    ):
        return None
    bends = [
        Bend(at, turn, servo.shape(turn), True, error)
        for at, turn, error in zip(
            (move.t, move.next_t), (move.turn, move.next_turn), errors, strict=True
        )
    ]
    return [
        _Turned(
            bend,
            before[0] + before[1] * bend.t,
            Corner(t, value, *before, *after, -1, 0.0, noise),
            bend.shape,
        )
        for bend, (before, after) in zip(bends, pairwise(move.lines), strict=True)
    ]


def _gap(knots: FloatArray, k: int, way: int, most: float) -> float:
    """Return how far a corner is from the one beyond it, if these make one change of speed [s]."""
    if not 0 < k + way < knots.size - 1:
        return 0.0
    beyond = abs(float(knots[k + way] - knots[k]))
    return beyond if beyond <= most else 0.0


def _may_last_until(
    servo: Servo | None, slopes: Sequence[float], last: float, touch: float
) -> bool:
    """Return whether an arm that changes its speed so may go on with it after the touch."""
    if servo is None:
        return False
    turn, fastest = slopes[1] - slopes[0], max(abs(slope) for slope in slopes)
    share = abs(turn) / fastest if fastest > 0.0 else 0.0
    return last + servo.shape(turn, share).takes > touch


def _are_apart(gaps: FloatArray, step: float) -> bool:
    """Return whether corners with gaps between them are of two changes of speed."""
    if not gaps.size:
        return False
    most = float(gaps.max())
    # A quick push is a few samples of the encoders between two bundles of corners.
    others = np.delete(gaps, int(np.argmax(gaps)))
    alone = most > _ALONE * float(others.max(initial=step))
    return most > _APART * step or (alone and most > _EDGE_SAMPLES[0] * step)


def _bend(
    t: FloatArray,
    value: FloatArray,
    around: Sequence[float],
    step: float,
    noise: float,
    coarse: float,
    edge: int,
    servo: Servo | None,
    *,
    ramp: bool = False,
    others: tuple[float, float] = (0.0, 0.0),
) -> _Turned | None:
    """
    Return the acceleration between two straight pieces, and the level where these meet.

    Beside it are `edge` samples at least; none of the pieces' own are of it where that is zero.
    After a `ramp`, whose corners all turn the same way, little may be straight. The changes of
    speed before and after go on beyond their corners by about as long as these are from `others`.
    """
    left, start, stop, right = around
    margin = max(stop - start, edge * step) if edge else 0.0
    lines = []
    variance = 0.0
    rest = -1
    before, after = start - margin, stop + margin
    sides = _within(t, left, before), _within(t, after, right)
    is_short = [
        may_be and side.stop - side.start < edge
        for may_be, side in zip((True, ramp), sides, strict=True)
    ]
    # An arm is straight until it begins to change its speed: of a quick push that is little, and
    # of a way on which it takes long to come to its speed.
    if is_short[0]:
        before = start - edge * step
    if is_short[1]:
        after = stop + edge * step
    # Nearer to its own corners where little is left between two changes of speed.
    near = 0.5 * margin
    straights = [
        (_within(t, left + others[0], before), _within(t, left + others[0], start - near)),
        (_within(t, after, right - others[1]), _within(t, stop + near, right - others[1])),
    ]
    for k, inside in enumerate((_within(t, left, before), _within(t, after, right))):
        count = inside.stop - inside.start
        if count < edge:
            return None
        for straight in straights[k] if others[k] > 0.0 else ():
            left_over = straight.stop - straight.start
            if edge and left_over >= max(1.5 * edge, _LEFT_OVER * count):
                inside, count = straight, left_over
                break
        lines.append(_line(t[inside], value[inside], np.ones(count)))
        if coarse > 0.0:
            # One of the readings, also where as many are at the next.
            reading = float(np.quantile(value[inside], 0.5, method='lower'))
            if np.mean(np.abs(value[inside] - reading) < coarse) > _STILL:
                rest = k
                lines[k] = reading, 0.0
        # Of a line at its end, or of a rest at any place within a step of the encoders.
        variance += coarse**2 / 12.0 if rest == k else 4.0 * noise**2 / count
        if is_short[k] and rest != k:
            # The lines meet beyond where the short one ends.
            away = t[inside] - float(t[inside].mean())
            ahead = 0.5 * (start + stop) - float(t[inside].mean())
            variance += noise**2 * ahead**2 / float(away @ away)
    if lines[0][1] == lines[1][1]:
        return None
    if edge == 0:
        margin = max(0.5 * (stop - start), step)
    chosen = slice(
        int(np.searchsorted(t, max(start - 2.0 * margin, left), 'right')),
        int(np.searchsorted(t, min(stop + 2.0 * margin, right))),
    )
    if chosen.stop - chosen.start < (1 if edge else _FEWEST_ON_LINE):
        return None
    corner = Corner(t[chosen], value[chosen], *lines[0], *lines[1], rest, coarse, noise)
    # Where little is straight after it, a shape takes the place of corners of other ways easily.
    enough = (_CLOSELY if is_short[1] else _FOLLOWS) ** 2 * corner.t.size * noise**2
    if servo is None:
        shape, shift = _shape_of(corner, 4.0 * margin, enough)
    else:
        known = servo.of(corner)
        if known is None:
            return None
        own, _ = _shape_of(corner, 4.0 * margin, enough)
        if is_apart(corner, corner.deviance(own), servo):
            return None
        servo = known
        shape = servo.at(corner)
        shift = corner.rested(shape)
    meeting, level = corner.meeting(shift)
    squares = corner.left(shape, shift)
    if not start - margin < meeting < stop + margin:
        return None
    if shape.duration + shape.lag < _FEW_SEEN * step:
        # No arm goes quite as any of the shapes; the samples beside tell less of what is between.
        enough += corner.t.size * (_FORM * abs(corner.turn) * shape.duration) ** 2
    if squares > enough:
        return None
    scale = max(noise**2, squares / corner.t.size)
    sharp = corner.left(Shape(0.0), shift)
    shown = servo is not None or sharp - squares > SHOWN * scale
    bend = Bend(
        meeting,
        corner.turn,
        shape if shown else Shape(0.0),
        servo is not None,
        math.sqrt(variance) / abs(corner.turn),
    )
    return _Turned(bend, level, corner, shape)


def _within(t: FloatArray, first: float, last: float) -> slice:
    """Return which samples are between two times, these among them."""
    start = int(np.searchsorted(t, first))
    return slice(start, max(int(np.searchsorted(t, last, 'right')), start))


def _shape_of(corner: Corner, longest: float, enough: float) -> tuple[Shape, float]:
    """
    Return how one change of speed goes by itself, and where the tool rests beside it [m].

    An acceleration comes and goes at once unless this leaves more than `enough` [m^2].
    """
    # A campaign's paths are made several times, for arms that change their speed otherwise.
    return _known_shape(corner.t.tobytes(), corner.value.tobytes(), corner[2:], longest, enough)


@lru_cache(maxsize=_MOST_SHAPES)
def _known_shape(
    t: bytes,
    value: bytes,
    others: tuple[float, float, float, float, int, float, float],
    longest: float,
    enough: float,
) -> tuple[Shape, float]:
    """Return what `_shape_of` does of a corner's bytes and its further fields."""
    corner = Corner(np.frombuffer(t).copy(), np.frombuffer(value).copy(), *others)
    step = float(np.median(np.diff(corner.t))) if corner.t.size > 1 else math.inf
    if corner.t.size > 2 * _LOOKED_AT:
        # A few samples tell that no shape comes near them, which takes the longest to find out.
        every = corner.t.size // _LOOKED_AT
        few = corner._replace(t=corner.t[::every], value=corner.value[::every])
        part = few.t.size / corner.t.size
        shape, shift = _own_shape(few, longest, part * enough, step)
        slow = shape.duration + shape.lag >= _FEW_SEEN * step
        if slow and few.left(shape, shift) > _HOPELESS * part * enough:
            return shape, shift
    return _own_shape(corner, longest, enough, step)


def _own_shape(corner: Corner, longest: float, enough: float, step: float) -> tuple[Shape, float]:
    """Return what `_shape_of` does of a corner of encoders with a step between readings [s]."""
    found: list[tuple[float, Shape, float]] = []
    for soft in _SOFT:
        shape, left = corner._replace(rest=-1).best(0.0, longest, soft)
        shift = 0.0
        # Far from a shape it does not matter where within a step the tool rests.
        reach = math.sqrt(enough / corner.t.size) + 2.0 * corner.coarse
        if corner.rest >= 0 and left < reach**2 * corner.t.size:
            # How the tool comes to where it rests tells where that is, within a step.
            squares = [
                corner.best(each, longest, soft, shape.lag, roughly=True)[1]
                for each in corner.shifts.tolist()
            ]
            shift = corner.likely(np.array(squares))
            shape, left = corner.best(shift, longest, soft)
        found.append((left, shape, shift))
        if left <= enough:
            return shape, shift
        if corner.is_clean:
            break
    _, shape, shift = min(found)
    left, shape = _between(corner, shape, shift, longest)
    if left > enough and corner.part > 0.0:
        # A turn may be a stop and a start, each half as long and as soft as an S-curve.
        near = Shape(0.35 * shape.duration, 0.2 * shape.duration, shape.lag, 0.0, corner.part)
        left, shape = min((left, shape), _between(corner, near, shift, longest))
    if left > enough and corner.part > 0.0:
        # With a rest between the two.
        wait = shape.as_wait(corner.part)
        near = Shape(BRISK * wait, 0.0, 0.0, 0.0, corner.part, wait)
        left, shape = min((left, shape), _between(corner, near, shift, longest))
    if left > enough:
        swinging = []
        for swing in SWINGS:
            # Half of how long it takes otherwise is made by how it swings.
            lag = 0.25 * max(shape.takes, _BRIEF_SWING * longest)
            near = Shape(0.5 * shape.duration, shape.jerk, lag, swing)
            swinging.append(_between(corner, near, shift, longest))
        if corner.is_clean:
            # What comes slowly may as well be followed so, without a swing to be seen.
            near = Shape(shape.duration, 0.0, shape.lag + 0.5 * shape.jerk, _CRITICAL)
            swinging.append(_between(corner, near, shift, longest))
        closest, other = min(swinging)
        for _ in range(_SWING_SEARCHES):
            # Duration and swing make up for each other: a search may stop on its way.
            if closest <= enough:
                break
            again, found_again = _between(corner, other, shift, longest)
            if again >= closest:
                break
            closest, other = again, found_again
        seen = other.takes / step
        if seen > _FEW_SEEN or (corner.is_clean and seen > _FEW_CLEAN and closest < 0.25 * left):
            shape = other
    return shape, shift


def _between(corner: Corner, near: Shape, shift: float, longest: float) -> tuple[float, Shape]:
    """
    Return the best shape near one of those that are tried, whatever its parts.

    What it leaves of the samples comes first [m^2].
    """
    scale = max(near.duration, near.lag, 1e-6)
    size = 4 if near.swing > 0.0 or near.wait > 0.0 else 3

    def shape(x: FloatArray) -> Shape:
        duration = min(max(float(x[0]) * scale, 1e-9), longest)
        soft = min(max(float(x[2]), 0.0), 1.0)
        fourth = max(float(x[3]), 0.0) if size == 4 else 0.0
        lag = min(max(float(x[1]), 0.0) * scale, longest)
        if near.wait > 0.0:
            return Shape(duration, soft * duration, lag, 0.0, near.part, fourth * near.wait)
        return Shape(duration, soft * duration, lag, fourth, near.part)

    def cost(x: FloatArray) -> float:
        return corner.left(shape(x), shift) / corner.noise**2

    fourth = 1.0 if near.wait > 0.0 else near.swing
    start = np.array([near.duration / scale, near.lag / scale, near.soft, fourth])[:size]
    if corner.is_clean:
        highest = np.array([longest / scale, longest / scale, 1.0, WILDEST])[:size]
        lowest = np.array([1e-9 / scale, 0.0, 0.0, 0.0])[:size]
        if size == 3:
            # Of an acceleration that comes at once nothing tells whether it may take longer.
            start[2] = max(start[2], 0.3)
        best = polished([corner], lambda x, _: shape(x), start, (lowest, highest))
        left = cost(best)
    else:
        left, best = minimum(cost, start, np.array([0.1, 0.1, 0.3, 0.3])[:size], turns=200)
    return left * corner.noise**2, shape(best)


def _beyond(miss: FloatArray, coarse: float) -> FloatArray:
    """Return what rounding by up to `coarse` does not account for."""
    return np.asarray(np.maximum(np.abs(miss) - coarse, 0.0)) if coarse > 0.0 else miss


def _followed(
    t: FloatArray,
    value: FloatArray,
    knots: FloatArray,
    levels: FloatArray,
    noise: float,
    most: int,
) -> tuple[FloatArray, FloatArray]:
    """
    Return the path with more corners, or through the samples themselves, where it leaves them.

    A tool that changes its speed within a few samples is followed by no line; the pieces on both
    sides are then those of least squares by themselves.
    """
    for _ in range(_MORE_CORNERS * most // _MOST_PIECES):
        away = np.abs(value - np.interp(t, knots, levels))
        far = int(np.argmax(away))
        if away[far] <= _LEFT_SIGMAS * noise:
            return knots, levels
        if t[far] in knots:
            break
        more = np.sort(np.append(knots, t[far]))
        again, new_levels = _levels(t, value, more)
        if again.size == knots.size:
            break
        knots, levels = again, new_levels
    corners = knots
    own = np.zeros(t.size, dtype=np.bool_)
    for _ in range(most):
        away = np.abs(value - np.interp(t, knots, levels))
        far = int(np.argmax(away))
        if away[far] <= _LEFT_SIGMAS * noise:
            break
        beside = slice(max(far - 1, 0), far + 2)
        own[beside] = True
        knots, levels = _through(t, value, corners, own)
    return knots, levels


def _through(
    t: FloatArray, value: FloatArray, corners: FloatArray, own: NDArray[np.bool_]
) -> tuple[FloatArray, FloatArray]:
    """Return the path through some samples, and by least squares between these."""
    all_t, all_levels = [t[own]], [value[own]]
    for first, last in runs(~own):
        if last - first < _SHORTEST:
            all_t.append(t[first:last])
            all_levels.append(value[first:last])
            continue
        piece = t[first:last]
        inside = corners[(corners > piece[0]) & (corners < piece[-1])]
        found = _levels(piece, value[first:last], np.concatenate((piece[:1], inside, piece[-1:])))
        all_t.append(found[0])
        all_levels.append(found[1])
    knots, levels = np.concatenate(all_t), np.concatenate(all_levels)
    order = np.argsort(knots)
    return knots[order], levels[order]


def _late(t: FloatArray, value: FloatArray, noise: float) -> NDArray[np.bool_]:
    """
    Return which samples leave a straight way for a moment and come back to it.

    Heights that are stamped late, as on a busy machine, do so; a tool does not.
    """
    late = np.zeros(t.size, dtype=np.bool_)
    reach = _BURST + 5
    if noise <= 0.0 or t.size < 4 * reach:
        return late
    middle_t, middle = t[2:-2], median_of_five(value)
    inner = np.arange(reach, t.size - reach)
    before, after = inner - reach, inner + reach - 4
    share = (t[inner] - middle_t[before]) / (middle_t[after] - middle_t[before])
    straight = middle[before] + share * (middle[after] - middle[before])
    off = np.zeros(t.size, dtype=np.bool_)
    off[inner] = np.abs(value[inner] - straight) > _LEFT_SIGMAS * noise
    # At a corner samples are off for longer, and after a pause the way is another.
    for first, last in runs(off):
        if last - first <= _BURST:
            begin, end = first - _STRAIGHT, last + _STRAIGHT
            beside = np.r_[begin:first, last:end]
            level, slope = _line(t[beside], value[beside], np.ones(beside.size))
            miss = value[beside] - level - slope * t[beside]
            late[first:last] = float(miss @ miss) <= _FOLLOWS**2 * miss.size * noise**2
    return late


def _unknown_way(trial: Trial, made: FitTrial) -> str | None:
    """Return why the tool's way in contact is not known well enough, if it is not."""
    gap = _unseen(trial.tool_height, made)
    if gap is not None:
        return (
            f'the tool height is missing from {gap[0]:.3f} s to {gap[1]:.3f} s, where the tool '
            f'changed its speed in contact, so its way there is not known'
        )
    push, error = made.pushed
    before = int(np.searchsorted(made.samples.edges, made.t_contact)) - 2
    if error < _UNSURE or before < _BASELINE:
        return None
    # A load cell that tells only steps has no noise at rest.
    noise = max(float(made.samples.force[:before].std()), QUIETEST * made.peak_force)
    share = error * made.peak_force / noise
    if share < _SWAMPED or (made.t_first is not None and made.best_pushed < _UNSURE):
        return None
    return (
        f'the push took {1e3 * (made.t[push.stop] - made.t[push.start]):.0f} ms, with a tool '
        f'height every {1e3 * made.path.interval:.3g} ms that is off by '
        f'{1e6 * made.path.noise:.2g} um: its speed is known to {100.0 * error:.2g} % only, which '
        f'makes {share:.3g} times the noise of its force (push slower, or sample heights faster)'
    )


def _unseen(height: Signal, trial: FitTrial) -> tuple[float, float] | None:
    """
    Return the gap of the encoders in which the way in contact is not known; None if there is none.

    It is known where the tool went straight on into the gap, or came straight out of it.
    """
    t, value = height.t, height.value
    steps = np.diff(t)
    deepest = trial.depth
    end = math.inf if trial.t_release is None else trial.t_release
    # Nothing is measured of the contact before the touch, and little after the release.
    silent = steps > _SILENT * float(np.median(steps))
    silent &= (t[1:] > trial.t_contact) & (t[:-1] < end)
    for last in np.flatnonzero(silent).tolist():
        off = []
        gap = slice(last, last + 2)
        for beside in (
            slice(max(last - _BESIDE + 1, 0), last + 1),
            slice(last + 1, last + 1 + _BESIDE),
        ):
            if t[beside].size < 2:
                continue
            level, slope = _line(t[beside], value[beside], np.ones(t[beside].size))
            away = float(np.abs(level + slope * t[gap] - value[gap]).max())
            # A line through few samples leads astray over a gap that is longer.
            span = float(t[beside][-1] - t[beside][0])
            off.append(away - _LEFT_SIGMAS * trial.path.noise * (1.0 + 2.0 * steps[last] / span))
        if min(off, default=0.0) > _UNSEEN * deepest:
            return float(t[last]), float(t[last + 1])
    return None


def _encoder_noise(t: FloatArray, value: FloatArray) -> float:
    """Return the standard deviation of an encoder's sample, steps of its reading included."""
    # Held against their stamps: samples may come unevenly, and so may what their stamps say.
    share = (t[1:-1] - t[:-2]) / (t[2:] - t[:-2])
    beside = value[1:-1] - (1.0 - share) * value[:-2] - share * value[2:]
    # What a tool that is accelerated is beside that line is much, and nearly alike for neighbours.
    again = beside[1:-1] - (1.0 - share[1:-1]) * beside[:-2] - share[1:-1] * beside[2:]
    rounded = rounding(value)
    rests = _at_its_calmest(value)
    noise = _least_spread(beside, again, rounded, rests)
    steps = np.abs(np.diff(value))
    nothing = _EXACT[0] * float(np.ptp(value))
    # Stamps that are a little off make noise of the tool's speed, which a tool at rest hides.
    moves = steps > _MOVING * noise
    fast = moves[2:-1] & moves[1:-2] & moves[:-3]
    if rounded > 0.0:
        # Readings that flicker at rest go there and back.
        way = np.sign(np.diff(value))
        fast &= (way[2:-1] == way[1:-2]) & (way[1:-2] == way[:-3])
    off = beside[1:-1][fast]
    many: np.bool_ | bool = off.size >= _FEWEST
    if many and noise == 0.0 == rounded:
        # Much of what a tool goes to and fro is no noise.
        many = np.mean(np.abs(off) < nothing) <= _ON_LINES
    if many:
        # Much of that may be how a tool goes that swings for long after each change of speed.
        calm = _CALMER * _NORMAL_FROM_QUARTER * float(np.quantile(np.abs(off), 0.25))
        on_its_way = _least_spread(off, again[fast], rounded, rests)
        noise = max(noise, min(on_its_way, calm / math.sqrt(1.5)))
    moving = steps[steps > 1e-12 * float(np.abs(value).max())]
    noise = max(noise, rounded)
    if moving.size and moving.size < 0.7 * steps.size and noise < float(moving.min()):
        resting = np.count_nonzero(steps == 0.0) > 0.1 * steps.size
        changes = int(np.count_nonzero(np.diff(np.flatnonzero(steps)) > 1))
        # Steps between rests of a reading are its resolution; a tool that rests once has none.
        if resting and changes > 0.1 * moving.size:
            noise = max(noise, 0.3 * float(moving.min()))
    return noise


def _least_spread(beside: FloatArray, again: FloatArray, rounded: float, rests: float) -> float:
    """
    Return what `_spread` does of samples beside lines, or of these beside lines in turn.

    What has been filtered is alike for neighbours as well: it is seen where the tool rests.
    """
    noise = _spread(beside, 1.5, rounded)
    if again.size < _FEWEST:
        return noise
    other = _spread(again, 4.375, rounded)
    if other < _NO_FILTER * noise:
        return other
    return min(noise, max(other, rests)) if other < _STEADIER * noise else noise


def _at_its_calmest(value: FloatArray) -> float:
    """Return the standard deviation about a line of the samples that go the straightest way."""
    parts = value[: value.size // _STRETCH * _STRETCH].reshape(-1, _STRETCH)
    if not parts.size:
        return math.inf
    along = np.arange(_STRETCH) - 0.5 * (_STRETCH - 1)
    level = parts - parts.mean(axis=1, keepdims=True)
    slope = level @ along / (along @ along)
    left = level - slope[:, np.newaxis] * along
    return math.sqrt(float(np.sum(left**2, axis=1).min()) / (_STRETCH - 2))


def _spread(off: FloatArray, alike: float, rounded: float) -> float:
    """
    Return the standard deviation of samples, of sums of them with squared weights of `alike`.

    Of readings that round, these sums are multiples of half a step, and so is their median.
    """
    noise = NORMAL_FROM_MAD * float(np.median(np.abs(off))) / math.sqrt(alike)
    if not 0.0 < noise < _MOSTLY_ROUNDED * rounded:
        return noise
    usual = off[np.abs(off) < _LEFT_SIGMAS * noise]
    return float(np.sqrt(np.mean(usual**2))) / math.sqrt(alike)


def _on_a_grid(value: FloatArray, depth: float) -> bool:
    """
    Return whether all steps from one reading to the next are multiples of one length.

    A tool that goes by a whole number of steps of its encoders from one reading to the next is
    rounded alike at each, and looks as if it were not rounded.
    """
    steps = np.abs(np.diff(value))
    steps = steps[steps > _EXACT[0] * depth]
    if not steps.size:
        return False
    parts = steps / steps.min() * np.arange(1.0, _MOST_STEPS + 1.0)[:, np.newaxis]
    off = np.abs(parts - np.round(parts)).max(axis=1)
    return bool(off.min() < _OFF_GRID)


def _is_smooth(t: FloatArray, value: FloatArray, depth: float, part: float = _EXACT[-1]) -> bool:
    """
    Return whether a curve through every second sample tells the others to a part of the depth.

    Through all of them it is off by a sixteenth of that.
    """
    # Loads much of scipy, which encoders with noise do without.
    from scipy.interpolate import CubicSpline

    inner = slice(1, t.size - 1, 2)
    known_t, known = t[::2], value[::2]
    away = CubicSpline(known_t, known)(t[inner]) - value[inner]
    straight = np.interp(t[inner], known_t, known) - value[inner]
    better = float(away @ away) <= _CURVED**2 * float(straight @ straight)
    return better and float(np.abs(away).max(initial=0.0)) < 16.0 * part * depth


def _curved(t: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """
    Return the way between samples that are exact, as a cubic spline through all of them tells it.

    A tool that changes its speed too quickly for that is left with its samples.
    """
    depth = float(value.max())
    if t.size < _FEWEST or not _is_smooth(t, value, depth):
        return t, value
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(t, value)
    middle = 0.5 * (t[1:] + t[:-1])
    away = np.abs(spline(middle) - 0.5 * (value[1:] + value[:-1]))
    # Of parts of a piece each leaves the curve by the square of their number less.
    parts = np.clip(np.ceil(np.sqrt(away / (_EXACT[0] * depth))), 1, _BETWEEN).astype(np.intp)
    number = np.arange(int(parts.sum())) - np.repeat(np.cumsum(parts) - parts, parts)
    knots = np.repeat(t[:-1], parts) + np.repeat(np.diff(t) / parts, parts) * number
    knots = np.append(knots, t[-1])
    return knots, spline(knots)


def _thinned(t: FloatArray, value: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the samples without those on a straight line between their neighbours."""
    slope = np.diff(value) / np.diff(t)
    bend = np.abs(np.diff(slope)) * np.minimum(np.diff(t)[1:], np.diff(t)[:-1])
    kept = np.concatenate(([True], bend > 1e-9 * float(np.ptp(value)), [True]))
    return t[kept], value[kept]


def _pieces(
    t: FloatArray, value: FloatArray, breaks: Sequence[float], noise: float, most: int
) -> list[float]:
    """Return the corners of straight pieces that follow the samples within the noise."""
    corners = [float(t[0]), *breaks, float(t[-1])]
    bounds = [0, *np.searchsorted(t, corners[1:-1]).tolist(), t.size]
    pending = [(a, b) for a, b in pairwise(bounds) if b > a]
    while pending and len(corners) <= 2 * most:
        first, last = pending.pop()
        if last - first < 8:
            continue
        blocks = min(last - first, _PATH_BLOCKS)
        edges = first + np.arange(blocks + 1) * (last - first) // blocks
        count = np.diff(edges).astype(np.float64)
        mean_t = np.add.reduceat(t[first:last], edges[:-1] - first) / count
        mean = np.add.reduceat(value[first:last], edges[:-1] - first) / count
        line = _line(mean_t, mean, count)
        miss = mean - line[0] - line[1] * mean_t
        if not _leaves(miss, count, noise):
            continue
        split = _best_split(mean_t, mean, count)
        at = int(edges[split])
        corners.append(float(0.5 * (t[at - 1] + t[at])))
        pending += [(first, at), (at, last)]
    return sorted(corners)


def _line(t: FloatArray, value: FloatArray, weight: FloatArray) -> tuple[float, float]:
    """Return level at t = 0 and slope of the weighted line of least squares."""
    level, slope, _ = _straight(t, value, weight)
    return level, slope


@kernel(fastmath={'reassoc', 'contract'})
def _straight(t, value, weight):  # type: ignore[no-untyped-def]
    """Return level at t = 0 and slope of the weighted line of least squares, and its spread."""
    total = centre = mean = 0.0
    for i in range(t.size):
        total += weight[i]
        centre += weight[i] * t[i]
        mean += weight[i] * value[i]
    centre /= total
    mean /= total
    spread = joint = 0.0
    for i in range(t.size):
        away = t[i] - centre
        spread += weight[i] * away * away
        joint += weight[i] * away * (value[i] - mean)
    slope = joint / spread if spread > 0.0 else 0.0
    return mean - slope * centre, slope, spread


def _leaves(miss: FloatArray, count: FloatArray, noise: float) -> bool:
    """Whether means over some number of blocks leave zero by more than the noise allows."""
    while miss.size >= 4:
        if np.any(np.abs(miss) * np.sqrt(count) > _PATH_SIGMAS * noise):
            return True
        pairs = miss.size // 4 * 4
        weight = count[:pairs].reshape(-1, 4)
        miss = np.sum(miss[:pairs].reshape(-1, 4) * weight, axis=1) / weight.sum(axis=1)
        count = weight.sum(axis=1)
    return False


def _best_split(t: FloatArray, value: FloatArray, weight: FloatArray) -> int:
    """Return where two lines follow the points best; at least two points are on either side."""
    t = t - t.mean()
    value = value - value.mean()
    sums = np.cumsum(
        np.stack((weight, weight * t, weight * value, weight * t * t, weight * t * value)), axis=1
    )
    left = sums[:, 1:-2]
    gained = np.zeros(left.shape[1])
    for w, wt, wv, wtt, wtv in (left, sums[:, -1:] - left):
        spread = wtt - wt * wt / w
        joint = wtv - wt * wv / w
        gained += wv * wv / w + np.where(spread > 0.0, joint**2 / np.maximum(spread, 1e-300), 0.0)
    return int(np.argmax(gained)) + 2


@dataclass(frozen=True, slots=True)
class _Piece:
    """A line of least squares through the samples between two corners, and its slope's error."""

    level: float
    slope: float
    error: float


def _piece(t: FloatArray, value: FloatArray, first: int, last: int, noise: float) -> _Piece:
    """Return the line through some samples, without those at the corners if there are many."""
    inner = slice(first + 2, last - 2) if last - first >= 8 else slice(first, last)
    x = t[inner]
    if x.size < 2:
        return _Piece(0.0, 0.0, math.inf)
    level, slope, spread = _straight(x, value[inner], np.ones(x.size))
    return _Piece(level, slope, noise / math.sqrt(spread))


def _meet(t: FloatArray, value: FloatArray, corners: Sequence[float], noise: float) -> FloatArray:
    """Return the corners, moved to where their pieces meet; without those that are none."""
    knots = list(corners)
    bounds = [0, *np.searchsorted(t, knots[1:-1]).tolist(), t.size]
    pieces = [_piece(t, value, a, b, noise) for a, b in pairwise(bounds)]
    while len(knots) > 2:
        # One at a time, the least clear first: what is left of two neighbours is clearer.
        corner_of = zip(knots, knots[1:], knots[2:], pieces, pieces[1:], strict=False)
        clear = [_clearness(*each) for each in corner_of]
        least = int(np.argmin(clear))
        if clear[least] > _CLEAR:
            break
        del knots[least + 1], bounds[least + 1]
        pieces[least] = _piece(t, value, bounds[least], bounds[least + 1], noise)
        del pieces[least + 1]
    knots = _moved(t, knots, pieces, noise)
    # Samples on the wrong side of a corner have bent its pieces.
    bounds = [0, *np.searchsorted(t, knots[1:-1]).tolist(), t.size]
    pieces = [_piece(t, value, a, b, noise) for a, b in pairwise(bounds)]
    return np.array(_moved(t, knots, pieces, noise))


def _moved(
    t: FloatArray, knots: Sequence[float], pieces: Sequence[_Piece], noise: float
) -> list[float]:
    """Return the corners, each where its two pieces meet if that is close by."""
    step = float(np.median(np.diff(t)))
    moved = [knots[0]]
    for k in range(1, len(knots) - 1):
        before, after = pieces[k - 1], pieces[k]
        meeting = knots[k]
        shorter = min(knots[k] - knots[k - 1], knots[k + 1] - knots[k])
        reach = max(8.0 * step, 4.0 * shorter / _PATH_BLOCKS)
        turn = before.slope - after.slope
        if abs(turn) > _CLEAR * math.hypot(before.error, after.error):
            meeting = (after.level - before.level) / turn
            # Of a slow tool whose encoders are noisy a corner is not told better.
            reach = max(reach, min(_GONE_ON * noise / abs(turn), 0.5 * shorter))
        inside = abs(meeting - knots[k]) <= reach and moved[-1] < meeting < knots[k + 1]
        moved.append(meeting if inside else knots[k])
    return [*moved, knots[-1]]


def _clearness(left: float, corner: float, right: float, before: _Piece, after: _Piece) -> float:
    """Return by how many standard errors two pieces differ, in slope or where they meet."""
    error = math.hypot(before.error, after.error)
    if not math.isfinite(error):
        return 0.0
    slopes = abs(before.slope - after.slope) / max(error, 1e-300)
    gap = (before.level - after.level) + (before.slope - after.slope) * corner
    reach = min(corner - left, right - corner)
    return max(slopes, abs(gap) / max(error * reach, 1e-300))


def _levels(t: FloatArray, value: FloatArray, knots: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the corners and their levels of least squares."""
    piece = np.clip(np.searchsorted(knots, t, side='right') - 1, 0, knots.size - 2)
    share = (t - knots[piece]) / (knots[piece + 1] - knots[piece])
    # A corner that no sample holds is none.
    held = np.bincount(piece, minlength=knots.size - 1) >= 2
    if not held.all():
        kept = np.concatenate((held, [True]))
        if not kept[0]:
            # The path begins where it did; the corner after it goes.
            kept[:2] = True, knots.size == 2
        return _levels(t, value, knots[kept])
    diagonal = np.bincount(piece, (1.0 - share) ** 2, knots.size)
    diagonal += np.bincount(piece + 1, share**2, knots.size)
    beside = np.bincount(piece, share * (1.0 - share), knots.size - 1)
    right = np.bincount(piece, (1.0 - share) * value, knots.size)
    right += np.bincount(piece + 1, share * value, knots.size)
    matrix = np.diag(diagonal) + np.diag(beside, 1) + np.diag(beside, -1)
    return knots, np.asarray(np.linalg.solve(matrix, right), dtype=np.float64)
