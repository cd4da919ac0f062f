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
The push control law: approach, push, hold, release, recover, within limits.

A pure state machine: `PushControl.step` gets the time and the latest readings and returns the
speed to command. Whatever is wrong ends in `aborted`: the tool stops, or retracts while its
height is known. From then on no input brings it down again.
"""

from collections import deque
from dataclasses import dataclass, fields
from math import dist, inf, isfinite
from statistics import median
from typing import Final, Literal, NamedTuple

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.hold import HoldEstimator, RelaxationTime

type PushPhase = Literal['approach', 'push', 'hold', 'release', 'recover', 'done', 'aborted']

NO_PUSH: Final = 'No push is running.'
"""What is answered to a stop when there is nothing to stop."""
NOT_ALLOWED: Final = 'Motion is forbidden: call the enable service first.'
"""What is answered where nobody has allowed motion since the controller was started."""
EMERGENCY: Final = 'The emergency stop is pressed: release it first.'
FORBIDDEN: Final = 'Motion was forbidden: '
"""How an answer begins where somebody has taken the permission back."""
STOPPED_BY_HAND: Final = 'The emergency stop was pressed.'
DISABLED: Final = 'The controller was disabled.'
DEACTIVATED: Final = 'The controller was deactivated.'
SHUT_DOWN: Final = 'The controller was shut down.'
TAKEN_BACK: Final = (STOPPED_BY_HAND, DISABLED, DEACTIVATED, SHUT_DOWN)
"""Why a push was aborted where somebody has forbidden motion: who did has to allow it again."""

TOUCH_READINGS: Final = 2
"""Readings in a row above the touch force that count as touch: one may be a glitch."""

PLACES: Final = 3
"""The tool is aside once so many places in turn say so, and began where the first ones are."""
COASTING: Final = 0.3
"""An aborted push may go on aside for so long: braking, and what was told late [s]."""
RETRACT_PATIENCE: Final = 2.0
"""How long an aborted push waits for the arm's height to come back, to retract [s]."""

FROZEN_READINGS: Final = 10
"""Fewer readings of the very same force do not count as frozen, however long they take."""

RISE_TIME: Final = 0.05
"""Over about this time the rise of the force is averaged [s]."""

FROZEN_TRAVEL: Final = 0.0005
"""A height that stays the very same while the tool is told to go so far is no height [m]."""

FROZEN_HEIGHTS: Final = 3
"""In fewer readings a height may stay the same by its rate alone."""

REACTION_TIME: Final = 0.1
"""So long an arm may stand after it was told to go, or to go the other way: commands take their
way, singly get lost, and are followed late [s]."""

BACKWARD_STAMPS: Final = 5
"""So many stamps in a row before the newest tell that a clock was set back."""

FAR_BACK: Final = 1.0
"""Stamps that are further back may be another's, as of a bag that is played into the cell [s]."""

FAR_BACKWARD_STAMPS: Final = 20
"""So many in a row of these tell that it was the clock."""

WORKSPACE_MARGIN: Final = 0.001
"""How far outside of its workspace or its depth the tool aborts a push [m]."""

PROGRESS: Final = 0.0002
"""A retracting tool that has not come up by so much for `RETRACT_PATIENCE` is stuck [m]."""

SURE: Final = 0.2
"""Largest relative standard deviation with which a relaxation time ends a hold."""

LEAST_HOLD: Final = 0.5
"""Shortest hold that a relaxation time may ask for [s]."""

_PROMPT: Final = 5e-4
"""What is handed over within this time is of the moment at which it is sent [s]."""

_UNUSUAL: Final = 2.0
_DELAYS: Final = 101
"""A delay is unusual at so many times the median of so many."""

_IN_A_ROW: Final = 3
"""So many late ones are followed by one that is taken."""

type Place = tuple[float, float]
type HoldMode = Literal['fixed', 'auto']
HOLD_MODES: Final[tuple[HoldMode, ...]] = ('fixed', 'auto')


def hold_mode(name: str) -> HoldMode:
    """
    Return a mode of holding by its name.

    Raises
    ------
    InputError
        If there is none of this name.

    """
    for mode in HOLD_MODES:
        if name == mode:
            return mode
    raise InputError(f"The hold_mode is '{name}'; choose from {', '.join(HOLD_MODES)}.")


class Reading(NamedTuple):
    """A value and when it was measured [s], by the clock that `PushControl.step` is given."""

    t: float
    value: float


class MeasuredTime:
    """
    When a sample was measured, by the receiver's clock, from a stamp by another clock.

    What is received late (a full queue, a starved driver) must not look fresh. The clocks differ
    by an unknown offset: the fastest sample so far is taken to have come without delay, and the
    delay of the others is counted from it.

    Parameters
    ----------
    largest_drift : float
        How much the two clocks may run apart [s/s].

    """

    def __init__(self, largest_drift: float = 2e-4) -> None:
        self._largest_drift = largest_drift
        self._offset = inf
        self._received = -inf
        self._newest = -inf
        self._backward = 0

    def of(self, stamp: float, received: float) -> float:
        """Return when the sample with this stamp [s], received at `received` [s], was measured."""
        if isfinite(self._received):
            self._offset += self._largest_drift * (received - self._received)
        self._received = received
        # Late, repeated and reordered samples come singly; a clock that was set back stays there.
        # One that was set back by less than these few samples makes them look late by no more.
        self._backward = self._backward + 1 if stamp < self._newest else 0
        far = self._newest - stamp > FAR_BACK
        if self._backward >= (FAR_BACKWARD_STAMPS if far else BACKWARD_STAMPS):
            self._offset, self._newest, self._backward = inf, stamp, 0
        self._newest = max(self._newest, stamp)
        self._offset = min(self._offset, received - stamp)
        return stamp + self._offset


class Punctuality:
    """
    Whether what was received came about as quickly as others do.

    A number without a stamp is taken to be of the moment at which it is sent. What a busy machine
    hands over late was measured earlier, and is better left out; what a slow network always delays
    is not. Of delays that differ much the longest are late; so that none are left out for long,
    few in a row are told to be late.
    """

    def __init__(self) -> None:
        self._delays: deque[float] = deque(maxlen=_DELAYS)
        self._in_a_row = 0

    def is_late(self, delay: float) -> bool:
        """Return whether a delay [s] is longer than half a millisecond and than usual ones."""
        self._delays.append(delay)
        late = delay > max(_PROMPT, _UNUSUAL * median(self._delays))
        self._in_a_row = self._in_a_row + 1 if late and self._in_a_row < _IN_A_ROW else 0
        return self._in_a_row > 0


class Command(NamedTuple):
    """A speed along the push [m/s], positive toward the object, and the phase it belongs to."""

    push_velocity: float
    phase: PushPhase


@dataclass(frozen=True, slots=True)
class PushGoal:
    """
    One push.

    Parameters
    ----------
    push_speed : float
        Speed while the tool touches and pushes [m/s].
    depth : float
        How far the tool pushes on from the touch [m].
    hold_time, recover_time : float
        How long the tool holds its depth (in an auto hold: at most), and waits above the object
        after the release [s].
    release_speed : float
        Speed of the withdrawal [m/s].
    approach_speed : float
        Speed in air, down to `approach_gap` above the surface where its height is known [m/s];
        else the approach is made at `push_speed`.
    approach_gap : float
        Distance from the surface at which the approach slows down to `push_speed` [m].
    clearance : float
        How far above the touch the release ends [m], so that the range sensor sees the dent.
    touch_force : float
        Rise of the force above its zero that counts as touch [N].
    zero_time : float
        How long the force's zero is averaged before the tool moves [s].
    surface_height : float or None
        Height of the surface above the support plane at the contact point [m], if planned.
    hold_mode : {'fixed', 'auto'}
        Whether the hold ends after `hold_time`, or as soon as it has lasted `hold_factor`
        relaxation times, which are estimated from the force meanwhile.
    hold_factor : float
        For an auto hold. The longer the hold, the less is left to measure after the release.

    """

    push_speed: float
    depth: float
    hold_time: float
    recover_time: float
    release_speed: float
    approach_speed: float
    approach_gap: float
    clearance: float
    touch_force: float
    zero_time: float
    surface_height: float | None = None
    hold_mode: HoldMode = 'fixed'
    hold_factor: float = 1.0


@dataclass(frozen=True, slots=True)
class PushLimits:
    """
    What no push may exceed.

    Parameters
    ----------
    max_force : float
        Largest magnitude of the contact force [N], as it is read, and while the tool goes down
        as it is going to be when the tool has come to rest: the rise since the last reading and
        until then counts.
    max_speed : float
        Largest speed of the tool [m/s].
    max_depth : float
        Largest depth from the touch [m].
    lowest_height, highest_height : float
        Range of the tool tip above the support plane [m].
    max_duration : float
        Longest time from the start to the end of a push [s].
    stale_time : float
        A reading older than this is no reading [s].
    frozen_time : float
        A force that keeps the very same value for longer is that of a saturated or dead sensor
        [s]; 0 if the load cell is so coarse that it may.
    heartbeat_time : float
        A push goes on only while who watches over it has been heard within this time [s]; 0 if
        nobody does.
    touch_margin : float
        How far below the planned surface the tool goes on without a touch [m].
    stop_lead : float
        Time that the tool goes on after a stop command, in effect: the latency of the loop and
        half the braking time [s].
    largest_drift : float
        How far the tool may be beside where its motion began [m].

    """

    max_force: float
    max_speed: float
    max_depth: float
    lowest_height: float
    highest_height: float
    max_duration: float
    stale_time: float
    frozen_time: float
    heartbeat_time: float
    touch_margin: float
    stop_lead: float
    largest_drift: float = inf


@dataclass(frozen=True, slots=True)
class PushReport:
    """
    What a push came to.

    Parameters
    ----------
    reason : str or None
        Why it was aborted.
    peak_force : float
        Largest magnitude of the force that was read [N].
    overshoot : float
        By how much the force went beyond its limit, also after the stop [N].
    touch_height : float or None
        Height of the tool tip at the touch [m].
    depth : float
        How deep the tool came after the touch [m].
    hold_time : float
        How long it held its depth [s].
    relaxation_time : RelaxationTime or None
        What the hold told of it.

    """

    reason: str | None
    peak_force: float
    overshoot: float
    touch_height: float | None
    depth: float
    hold_time: float
    relaxation_time: RelaxationTime | None


def check_goal(goal: PushGoal, limits: PushLimits, tool_height: float) -> None:
    """
    Refuse a push that cannot be made within the limits.

    Parameters
    ----------
    goal : PushGoal
        What is asked for.
    limits : PushLimits
        What is allowed.
    tool_height : float
        Height of the tool tip at the start [m].

    Raises
    ------
    InputError
        With the number that does not fit.

    """
    for field in fields(goal):
        value = getattr(goal, field.name)
        if field.name == 'surface_height' and value is None:
            continue
        if field.name == 'hold_mode':
            hold_mode(value)
            continue
        if not isfinite(value) or value < 0.0:
            raise InputError(f'A push needs a {field.name} of zero or more, not {value}.')
    for name in ('push_speed', 'release_speed', 'approach_speed'):
        speed = getattr(goal, name)
        if not 0.0 < speed <= limits.max_speed:
            raise InputError(
                f'The {name} is {speed * 1e3:.4g} mm/s; the cell allows more than 0 and up to '
                f'{limits.max_speed * 1e3:.4g} mm/s.'
            )
    if not 0.0 < goal.depth <= limits.max_depth:
        raise InputError(
            f'The depth is {goal.depth * 1e3:.4g} mm; the cell allows more than 0 and up to '
            f'{limits.max_depth * 1e3:.4g} mm.'
        )
    if not 0.0 < goal.touch_force < limits.max_force:
        raise InputError(
            f'The touch_force is {goal.touch_force:.4g} N; it must lie between 0 and the '
            f'max_force of {limits.max_force:.4g} N.'
        )
    if not limits.lowest_height <= tool_height <= limits.highest_height:
        raise InputError(
            f'The tool is at {tool_height * 1e3:.4g} mm, outside of the workspace of '
            f'{limits.lowest_height * 1e3:.4g} to {limits.highest_height * 1e3:.4g} mm: bring it '
            'back first.'
        )
    air = None
    if goal.surface_height is not None:
        air = tool_height - goal.surface_height
        if air <= 0.0:
            raise InputError(
                f'The tool is at {tool_height * 1e3:.4g} mm, below the surface at '
                f'{goal.surface_height * 1e3:.4g} mm: raise it before the push.'
            )
        deepest = goal.surface_height - goal.depth
        if deepest < limits.lowest_height:
            raise InputError(
                f'A depth of {goal.depth * 1e3:.4g} mm ends at a height of {deepest * 1e3:.4g} '
                f'mm, below the lowest allowed {limits.lowest_height * 1e3:.4g} mm.'
            )
        if goal.surface_height + goal.clearance > limits.highest_height:
            raise InputError(
                f'A clearance of {goal.clearance * 1e3:.4g} mm ends above the highest allowed '
                f'{limits.highest_height * 1e3:.4g} mm.'
            )
    duration = expected_duration(goal, air)
    if duration > limits.max_duration:
        raise InputError(
            f'The push takes about {duration:.4g} s; the cell allows {limits.max_duration:.4g} s.'
        )


def expected_duration(goal: PushGoal, air: float | None) -> float:
    """
    Return about how long a push takes.

    Parameters
    ----------
    goal : PushGoal
        The push.
    air : float or None
        Distance between tool and surface at the start [m], if known.

    Returns
    -------
    float
        Duration from start to done [s]; a lower bound where the distance is not known.

    """
    approach = 0.0
    if air is not None:
        slow = min(air, goal.approach_gap)
        approach = slow / goal.push_speed + (air - slow) / goal.approach_speed
    return (
        goal.zero_time
        + approach
        + goal.depth / goal.push_speed
        + goal.hold_time
        + (goal.depth + goal.clearance) / goal.release_speed
        + goal.recover_time
    )


class PushControl:
    """
    The state of one push.

    Parameters
    ----------
    goal : PushGoal
        What to do.
    limits : PushLimits
        What not to exceed.
    t : float
        Time of the start [s].
    tool_height : float
        Height of the tool tip at the start [m]; an aborted push retracts to it, or to the
        clearance above the touch if that is higher.

    Raises
    ------
    InputError
        If the goal does not fit the limits.

    Attributes
    ----------
    phase : str
        One of the contract's phases.
    reason : str or None
        Why the push was aborted, one sentence.
    stays : str
        Why its retraction goes no further, or empty.

    """

    def __init__(self, goal: PushGoal, limits: PushLimits, t: float, tool_height: float) -> None:
        check_goal(goal, limits, tool_height)
        self._begin(goal, limits, t, tool_height, 'approach')

    @classmethod
    def retraction(
        cls,
        limits: PushLimits,
        t: float,
        *,
        speed: float,
        to_height: float,
        reason: str | None = None,
    ) -> 'PushControl':
        """
        Return a push that has only its retraction left.

        For a tool that was left where it is, as by a controller that died.

        Parameters
        ----------
        limits : PushLimits
            What not to exceed.
        t : float
            Time of the start [s].
        speed : float
            Speed of the retraction [m/s].
        to_height : float
            Where it ends [m].
        reason : str, optional
            Why, one sentence.

        Returns
        -------
        PushControl
            In the phase `aborted`.

        """
        goal = PushGoal(
            push_speed=limits.max_speed,
            depth=limits.max_depth,
            hold_time=0.0,
            recover_time=0.0,
            release_speed=min(speed, limits.max_speed),
            approach_speed=limits.max_speed,
            approach_gap=0.0,
            clearance=0.0,
            touch_force=limits.max_force,
            zero_time=0.0,
        )
        control = cls.__new__(cls)
        control._begin(goal, limits, t, to_height, 'aborted')
        control.reason = reason
        return control

    def _begin(
        self, goal: PushGoal, limits: PushLimits, t: float, retract_height: float, phase: PushPhase
    ) -> None:
        self.phase: PushPhase = phase
        self.reason: str | None = None
        self._goal = goal
        self._limits = limits
        self._started = t
        self._phase_started = t
        self._retract_height = retract_height
        self._touch_height: float | None = None
        self._candidate_height = retract_height
        self._touch_readings = 0
        self._in_gap = False
        self._last_force = Reading(-inf, 0.0)
        self._rise = 0.0
        self._changed = t
        self._same_readings = 0
        self._new_force = False
        self._last_tool = Reading(-inf, retract_height)
        self._same_heights = 0
        self._travel = 0.0
        self._goes_by = t
        self._stepped = t
        self._last_step: float | None = None
        self._told = 0.0
        self._zero_sum = 0.0
        self._zero_count = 0
        self._at_rest = False
        self._highest = -inf
        self._progress = t
        self.stays = ''
        self._start_places = list[Place]()
        self._start_place: Place = (0.0, 0.0)
        self._drifts = deque[float](maxlen=PLACES)
        self._place_told = -inf
        self._drift = self._abort_drift = 0.0
        self._coasts_until = -inf
        self._hold: HoldEstimator | None = None
        self._hold_time = 0.0
        self._lowest = inf
        self._peak_force = 0.0

    @property
    def finished(self) -> bool:
        """Whether the push has ended and the tool stands still."""
        return self._at_rest

    @property
    def touch_height(self) -> float | None:
        """Height of the tool tip at the touch [m], or None before it."""
        return self._touch_height

    def report(self) -> PushReport:
        """Return what the push has come to so far."""
        touch = self._touch_height
        return PushReport(
            reason=self.reason,
            peak_force=self._peak_force,
            overshoot=max(0.0, self._peak_force - self._limits.max_force),
            touch_height=touch,
            depth=0.0 if touch is None else max(0.0, touch - self._lowest),
            hold_time=self._hold_time,
            relaxation_time=None if self._hold is None else self._hold.estimate(),
        )

    def abort(self, reason: str, t: float) -> None:
        """End the push because of `reason`: the next steps stop and retract the tool."""
        if self.phase in ('done', 'aborted'):
            return
        self.reason = reason
        self._coasts_until = t + COASTING
        self._enter('aborted', t)

    def step(
        self,
        t: float,
        tool: Reading | None,
        force: Reading | None,
        heartbeat: float | None = None,
        place: Place | None = None,
    ) -> Command:
        """
        Advance to time `t` and return what to command.

        Parameters
        ----------
        t : float
            Time [s], not before the last step's.
        tool : Reading or None
            Latest height of the tool tip [m].
        force : Reading or None
            Latest contact force [N], positive in compression, with the load cell's zero.
        heartbeat : float or None
            When who watches over the push was last heard [s].
        place : tuple of float or None
            Where the tool was told to be with `tool`, x and y across the vertical [m]; None if
            the arm tells heights only.

        Returns
        -------
        Command
            Speed and phase; a positive speed only in `approach` and `push`.

        """
        height = self._fresh(tool, t)
        contact_force = self._fresh(force, t)
        self._note(t, height, contact_force, force)
        if height is not None and tool is not None:
            self._follow(t, tool)
            self._go_aside(t, tool, place)
        if self.phase not in ('done', 'aborted'):
            self._check(t, height, contact_force, heartbeat)
        self._last_step = t
        if height is None:
            # Without its height the tool may neither push nor retract.
            if self.phase == 'aborted':
                self._wait(t)
            self._told = 0.0
            return Command(0.0, self.phase)
        if tool is not None:
            # It has gone on since, as far as it was told to: down, where it matters.
            height -= max(0.0, self._told) * max(0.0, t - tool.t)
        most = self._limits.max_speed
        told = min(max(self._advance(t, height, contact_force), -most), most)
        if told != 0.0 and told * self._told <= 0.0:
            self._goes_by = t + REACTION_TIME
        self._told = told
        return Command(told, self.phase)

    def _fresh(self, reading: Reading | None, t: float) -> float | None:
        if reading is None or not isfinite(reading.value):
            return None
        return reading.value if t - reading.t <= self._limits.stale_time else None

    def _note(
        self, t: float, height: float | None, force: float | None, reading: Reading | None
    ) -> None:
        """Take note of the readings for what looks at more than the latest."""
        if height is not None:
            self._lowest = min(self._lowest, height)
        self._new_force = False
        if force is None or reading is None:
            return
        self._peak_force = max(self._peak_force, abs(force))
        if reading.t > self._last_force.t:
            self._new_force = True
            elapsed = reading.t - self._last_force.t
            if isfinite(elapsed):
                change = (force - self._last_force.value) - self._rise * elapsed
                self._rise += change / (elapsed + RISE_TIME)
            if force != self._last_force.value:
                self._changed, self._same_readings = t, 0
            else:
                self._same_readings += 1
            self._last_force = reading

    def _follow(self, t: float, tool: Reading) -> None:
        """Take note of how far the tool was told to go while its height stays the same."""
        if t > self._goes_by:
            self._travel += abs(self._told) * (t - self._stepped)
        self._stepped = t
        if tool.t > self._last_tool.t:
            if tool.value != self._last_tool.value:
                self._travel, self._same_heights = 0.0, 0
            else:
                self._same_heights += 1
            self._last_tool = tool

    def _go_aside(self, t: float, tool: Reading, place: Place | None) -> None:
        """Take note of how far the tool is beside where its motion began."""
        if place is None or tool.t <= self._place_told:
            return
        self._place_told = tool.t
        # A single place may be garbage.
        if len(self._start_places) < PLACES:
            self._start_places.append(place)
            x, y = zip(*self._start_places, strict=True)
            self._start_place = median(x), median(y)
        self._drifts.append(dist(place, self._start_place))
        self._drift = min(self._drifts)
        if t < self._coasts_until:
            self._abort_drift = max(self._abort_drift, self._drift)

    def _check(
        self, t: float, height: float | None, force: float | None, heartbeat: float | None
    ) -> None:
        limits = self._limits
        touch = self._touch_height
        if height is None:
            self.abort("The arm's height is missing, stale or not a number.", t)
        elif force is None:
            self.abort('The contact force is missing, stale or not a number.', t)
        elif self._last_step is not None and t - self._last_step > limits.stale_time:
            # Its threads may have got fresh readings before it: who hung must not go on as if
            # nothing had been.
            self.abort(f'The control loop was held up for {t - self._last_step:.2g} s.', t)
        elif abs(force) > limits.max_force:
            self.abort(
                f'The contact force of {force:.4g} N exceeds the limit of '
                f'{limits.max_force:.4g} N.',
                t,
            )
        elif self._told > 0.0 and abs(self._expected(t, force)) > limits.max_force:
            self.abort(
                f'The contact force was {force:.4g} N {(t - self._last_force.t) * 1e3:.3g} ms ago '
                f'and changes by {self._rise:.3g} N/s: before the tool stands still it exceeds '
                f'the limit of {limits.max_force:.4g} N.',
                t,
            )
        elif t - self._started > limits.max_duration:
            self.abort(f'The push takes longer than {limits.max_duration:.4g} s.', t)
        elif limits.heartbeat_time > 0.0 and (
            heartbeat is None or t - heartbeat > limits.heartbeat_time
        ):
            self.abort(
                'The experiment orchestrator, which watches over the push, has been silent for '
                f'{limits.heartbeat_time:.4g} s.',
                t,
            )
        elif (
            0.0 < limits.frozen_time < t - self._changed and self._same_readings >= FROZEN_READINGS
        ):
            self.abort(
                f'The contact force has been {force:.6g} N exactly for {limits.frozen_time:.4g} '
                's: the load cell is saturated or dead.',
                t,
            )
        elif (
            # What it was told since the reading is not in there yet.
            self._travel - abs(self._told) * (t - self._last_tool.t) > FROZEN_TRAVEL
            and self._same_heights >= FROZEN_HEIGHTS
        ):
            self.abort(
                f'The tool height stays at {height * 1e3:.6g} mm while the tool is told to move: '
                'the arm does not follow, or its reading is dead.',
                t,
            )
        elif self._drift > limits.largest_drift:
            self.abort(f'{self._aside()} See to push_axis and command_frame.', t)
        elif not (
            limits.lowest_height - WORKSPACE_MARGIN
            <= height
            <= limits.highest_height + WORKSPACE_MARGIN
        ):
            self.abort(f'The tool has left its workspace: it is at {height * 1e3:.4g} mm.', t)
        elif touch is not None and touch - height > limits.max_depth + WORKSPACE_MARGIN:
            self.abort(
                f'The tool is {(touch - height) * 1e3:.4g} mm deep; the cell allows '
                f'{limits.max_depth * 1e3:.4g} mm.',
                t,
            )

    def _expected(self, t: float, force: float) -> float:
        """Return the force with which a tool that is stopped now comes to rest [N]."""
        return force + self._rise * (t - self._last_force.t + self._limits.stop_lead)

    def _advance(self, t: float, height: float, force: float | None) -> float:
        goal = self._goal
        match self.phase:
            case 'approach' if force is not None:
                return self._approach(t, height, force)
            case 'push':
                return self._push(t, height)
            case 'hold' if force is not None:
                if self._keeps_holding(t, force):
                    return 0.0
                self._enter('release', t)
                return -goal.release_speed
            case 'release':
                if height < self._release_height():
                    return -goal.release_speed
                self._enter('recover', t)
                return 0.0
            case 'recover':
                if t - self._phase_started >= goal.recover_time:
                    self._enter('done', t)
                    self._at_rest = True
                return 0.0
            case 'aborted' if not self._at_rest:
                return self._retract(t, height, force)
            case _:
                return 0.0

    def _approach(self, t: float, height: float, force: float) -> float:
        goal = self._goal
        if t - self._started < goal.zero_time or not self._zero_count:
            if self._new_force:
                self._zero_sum += force
                self._zero_count += 1
            return 0.0
        if self._new_force:
            zero = self._zero_sum / self._zero_count
            if force - zero > goal.touch_force:
                if not self._touch_readings:
                    self._candidate_height = height
                self._touch_readings += 1
            else:
                self._touch_readings = 0
        if self._touch_readings >= TOUCH_READINGS:
            self._touch_height = self._candidate_height
            self._enter('push', t)
            return self._push(t, height)
        speed = goal.push_speed
        if goal.surface_height is not None:
            if height < goal.surface_height - self._limits.touch_margin:
                self.abort(
                    f'The tool is {(goal.surface_height - height) * 1e3:.4g} mm below the planned '
                    'surface without having touched anything: see to the load cell and the plan.',
                    t,
                )
                return 0.0
            # Once slow it stays slow: the noise of the height must not set it off again.
            self._in_gap = self._in_gap or (
                height - goal.approach_speed * self._limits.stop_lead
                <= goal.surface_height + goal.approach_gap
            )
            if not self._in_gap:
                speed = goal.approach_speed
        return self._downward(t, height, speed, 'without touching anything')

    def _push(self, t: float, height: float) -> float:
        goal = self._goal
        assert self._touch_height is not None
        if height - goal.push_speed * self._limits.stop_lead <= self._touch_height - goal.depth:
            self._enter('hold', t)
            self._hold = HoldEstimator(t)
            return 0.0
        return self._downward(t, height, goal.push_speed, 'before the depth was reached')

    def _downward(self, t: float, height: float, speed: float, how: str) -> float:
        """Return `speed`, unless the tool could then not stop above its lowest height."""
        if height - speed * self._limits.stop_lead > self._limits.lowest_height:
            return speed
        self.abort(
            f'The tool came to its lowest height of {self._limits.lowest_height * 1e3:.4g} mm '
            f'{how}.',
            t,
        )
        return 0.0

    def _keeps_holding(self, t: float, force: float) -> bool:
        """Return whether the hold goes on, and take note of how long it has lasted."""
        goal = self._goal
        self._hold_time = t - self._phase_started
        assert self._hold is not None
        if self._new_force:
            self._hold.add(self._last_force.t, force)
        if self._hold_time >= goal.hold_time:
            return False
        if goal.hold_mode == 'fixed' or self._hold_time < LEAST_HOLD:
            return True
        estimate = self._hold.estimate()
        return (
            estimate is None
            or estimate.std > SURE * estimate.value
            or self._hold_time < goal.hold_factor * estimate.value
        )

    def _retract(self, t: float, height: float, force: float | None) -> float:
        """Return the speed of an aborted push, which goes up or nowhere."""
        if height >= self._release_height():
            self._at_rest = True
            return 0.0
        if force is not None and force < -self._limits.max_force:
            # What sticks to the tool must not be torn off.
            self._wait(t)
            return 0.0
        if self._drift > self._abort_drift + self._limits.largest_drift:
            # The way of the push takes it back, another takes it anywhere.
            self.stays = f'{self._aside()} It was not raised any further.'
            self._wait(t)
            return 0.0
        self.stays = ''
        if height > self._highest:
            # A slow retraction gets on as well.
            self._highest = height + min(PROGRESS, 0.5 * self._goal.release_speed)
            self._progress = t
        self._wait(t)
        return 0.0 if self._at_rest else -self._goal.release_speed

    def _aside(self) -> str:
        return (
            f'The tool is {self._drift * 1e3:.3g} mm beside where its motion began; '
            f'{self._limits.largest_drift * 1e3:.3g} mm are allowed.'
        )

    def _wait(self, t: float) -> None:
        """End an aborted push that has not got on for too long."""
        if t - max(self._progress, self._phase_started) > RETRACT_PATIENCE:
            self._at_rest = True

    def _release_height(self) -> float:
        height = -inf if self.phase == 'release' else self._retract_height
        if self._touch_height is not None:
            height = max(height, self._touch_height + self._goal.clearance)
        lead = self._goal.release_speed * self._limits.stop_lead
        return min(height, self._limits.highest_height) - lead

    def _enter(self, phase: PushPhase, t: float) -> None:
        self.phase = phase
        self._phase_started = t
