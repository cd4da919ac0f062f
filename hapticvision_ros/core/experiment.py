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
The experiment's plan and its goal's life: a grid of pushes, and those that its analysis asks for.

Nothing here touches ROS, a clock or a file: the node asks which step is due, carries it out, and
tells how it ended. The rules on failure stand in `Experiment`.

References
----------
.. [1] ROS 2 design, "Actions", https://design.ros2.org/articles/actions.html (goal states).

"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import auto, Enum, IntEnum
import itertools
import math
from typing import Final

from hapticvision_ros.core.autonomy import Budget, decide, Decision, Ending, Findings, Push, Spent
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.units import MM


class GoalStatus(IntEnum):
    """States of a goal, with the codes of ``action_msgs/msg/GoalStatus``."""

    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def terminal(self) -> bool:
        """Whether the goal has ended."""
        return self in (GoalStatus.SUCCEEDED, GoalStatus.CANCELED, GoalStatus.ABORTED)


class Step(Enum):
    """
    What the experiment is doing; the order of a trial is the order of the names.

    `CHECK` asks whether the cell allows the goal, before its first trial. `RETRACT` sees to it
    that no tool was left low: before the first trial, and after one that failed before the next,
    before an analysis and at the end. `STOP` is gone through only after a cancel or a failure in
    mid-push, `ANALYSE` only where the experiment chooses trials by itself once its grid is done;
    `END` is the last.
    """

    BRING_UP = auto()
    CHECK = auto()
    ENABLE = auto()
    RETRACT = auto()
    SAMPLE = auto()
    PLAN = auto()
    TARE = auto()
    CONFIGURE = auto()
    RECORD = auto()
    START = auto()
    PUSH = auto()
    STOP = auto()
    FINISH = auto()
    ANALYSE = auto()
    REST = auto()
    DISABLE = auto()
    END = auto()


class Outcome(Enum):
    """How a trial ended."""

    COMPLETE = 'complete'
    INCOMPLETE = 'incomplete'
    ABORTED = 'aborted'


def bag_prefix(number: int) -> str:
    """Return what the name of a trial's bag begins with, before an underscore."""
    return f'trial_{number:03d}'


@dataclass(frozen=True, slots=True)
class PlannedTrial:
    """
    One push of the grid, or one that the analysis has asked for.

    Parameters
    ----------
    number : int
        Place in the experiment, from 1.
    push_speed : float
        Commanded speed along the push [m/s].
    depth : float
        How far the tool goes in after it has touched [m].
    repeat : int
        Which repeat of this push, from 1.
    hold_time : float
        How long the tool holds its depth; in an auto hold, at most [s].
    hold_mode : {'fixed', 'auto'}
        Whether the hold may end by itself.
    reason : str
        Why the analysis has asked for it; empty for the grid's.

    """

    number: int
    push_speed: float
    depth: float
    repeat: int
    hold_time: float
    hold_mode: str
    reason: str = ''

    @property
    def name(self) -> str:
        """Return the name of the trial's bag, such as ``trial_003_5.0mm_s_10mm_r1``."""
        speed = f'{self.push_speed / MM:.6g}'
        if '.' not in speed and 'e' not in speed:
            speed += '.0'
        return f'{bag_prefix(self.number)}_{speed}mm_s_{self.depth / MM:.6g}mm_r{self.repeat}'


@dataclass(frozen=True, slots=True)
class TrialOutcome:
    """
    How one trial ended.

    Parameters
    ----------
    trial : PlannedTrial
        Which one.
    outcome : Outcome
        How it ended.
    bag : str or None
        Where it was recorded; None if the recording never began.
    reason : str
        Why it is not complete; empty if it is.

    """

    trial: PlannedTrial
    outcome: Outcome
    bag: str | None
    reason: str = ''


def _positive(name: str, values: Iterable[float]) -> tuple[float, ...]:
    """Return the values if there are some and all are finite and above zero."""
    checked = tuple(float(value) for value in values)
    if not checked:
        raise UsageError(f'the experiment has no {name}: give at least one.')
    for value in checked:
        if not (math.isfinite(value) and value > 0.0):
            raise UsageError(f'{name} has {value:g}: give finite numbers above zero, in SI units.')
    if len(set(checked)) != len(checked):
        raise UsageError(f'{name} names a value twice: use repeats to push again.')
    return checked


@dataclass(frozen=True, slots=True)
class ExperimentGoal:
    """
    What a client asks for: every speed at every depth, so many times.

    Parameters
    ----------
    push_speeds : tuple of float
        Speeds along the push [m/s].
    depths : tuple of float
        Depths after touch [m].
    repeats : int
        How often each pair is pushed.
    hold_time, recover_time : float
        How long the tool holds its depth (in an auto hold: at most), and how long the object is
        watched afterwards [s].
    rest_time : float
        Pause between two trials [s], in which a new sample is put in place.
    hold_mode : {'fixed', 'auto'}
        Whether a hold ends by itself once it has lasted the relaxation time.
    budget : Budget or None
        How long to go on with the pushes that the analysis asks for; None to end with the grid.

    Raises
    ------
    UsageError
        If a list is empty, or a number is not finite, not above zero or named twice.

    """

    push_speeds: tuple[float, ...]
    depths: tuple[float, ...]
    repeats: int
    hold_time: float
    recover_time: float
    rest_time: float
    hold_mode: str = 'fixed'
    budget: Budget | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, 'push_speeds', _positive('speeds', self.push_speeds))
        object.__setattr__(self, 'depths', _positive('depths', self.depths))
        if self.repeats < 1:
            raise UsageError(f'repeats is {self.repeats}: give 1 or more.')
        _positive('hold_time', [self.hold_time])
        _positive('recover_time', [self.recover_time])
        if not (math.isfinite(self.rest_time) and self.rest_time >= 0.0):
            raise UsageError(f'rest_time is {self.rest_time:g}: give a finite number, 0 or more.')
        if self.hold_mode not in ('fixed', 'auto'):
            raise UsageError(f"hold_mode is '{self.hold_mode}': choose fixed or auto.")

    def trials(self) -> tuple[PlannedTrial, ...]:
        """
        Return the pushes in the order in which they are made.

        The whole grid is gone through before it is repeated, so that a slow drift of the material
        or of the cell shows as a difference between repeats, not between speeds or depths.

        Returns
        -------
        tuple of PlannedTrial
            ``len(push_speeds) * len(depths) * repeats`` pushes.

        """
        grid = itertools.product(range(1, self.repeats + 1), self.push_speeds, self.depths)
        return tuple(
            PlannedTrial(number, speed, depth, repeat, self.hold_time, self.hold_mode)
            for number, (repeat, speed, depth) in enumerate(grid, start=1)
        )


@dataclass(frozen=True, slots=True)
class Deadlines:
    """
    How long the experiment waits before it takes a peer for dead.

    Parameters
    ----------
    service : float
        For the answer of a service [s].
    approach : float
        For the touch of the object after the push has been started [s].
    margin : float
        Added to the time that a push must take [s].
    analysis : float
        For an analysis of the trials so far, without the compiling of its kernels [s].

    """

    service: float
    approach: float
    margin: float
    analysis: float = math.inf

    def of(self, step: Step, goal: ExperimentGoal, trial: PlannedTrial) -> float:
        """Return how long `step` may take [s]."""
        if step is Step.REST:
            return math.inf
        if step is Step.ANALYSE:
            return self.analysis
        if step is Step.PUSH:
            return self.approach + pushing_time(goal, trial) + self.margin
        return self.service


def pushing_time(goal: ExperimentGoal, trial: PlannedTrial | Push) -> float:
    """Return how long a push takes at least, without approach and retraction [s]."""
    return trial.depth / trial.push_speed + trial.hold_time + goal.recover_time


_NEXT: Final = {
    Step.BRING_UP: Step.CHECK,
    Step.CHECK: Step.ENABLE,
    Step.ENABLE: Step.RETRACT,
    Step.RETRACT: Step.SAMPLE,
    Step.SAMPLE: Step.PLAN,
    Step.PLAN: Step.TARE,
    Step.TARE: Step.CONFIGURE,
    Step.CONFIGURE: Step.RECORD,
    Step.RECORD: Step.START,
    Step.START: Step.PUSH,
    Step.PUSH: Step.FINISH,
    Step.STOP: Step.FINISH,
}
RUNNING: Final = 'is running: cancel it first.'
"""How a goal is refused beside another one ends."""
ARM_ABORTED: Final = 'the arm aborted the push'
LEFT_LOW: Final = 'the tool may have been left low: see to it'
_RECORDING: Final = (Step.RECORD, Step.START, Step.PUSH)
_PUSHED: Final = (Step.STOP, Step.FINISH, Step.ANALYSE, Step.DISABLE, Step.END)
"""Steps in which the trial at hand has been pushed."""


class Experiment:
    """
    The life of one goal, as a state machine.

    The owner carries out `step`, then calls `done` or `failed`; it tells the arm's phases by
    `phase` and lets time pass by `tick`. Each of them may change `step`, and `entered` tells
    since when it stands.

    A push that the arm itself has aborted (a force limit, no contact) is kept, marked, and the
    next trial goes on, since the cell still works; so is a bag that lacks a stream, and one of a
    push in which a peer fell silent: whoever supervises the processes may start it again, and the
    next trial begins with waiting for it. When `max_failures` trials in a row went that way the
    experiment is aborted. A peer that does not answer in time before a push, and a disk that
    cannot be written, abort the experiment at once. Whatever was recorded until then is kept.

    Where somebody has taken back the permission to move (the emergency stop, a controller that
    was disabled, deactivated or shut down) the experiment is aborted, and nothing moves any more
    for its sake: who releases the stop does not expect the arm to go on.

    A goal with a budget goes on after its grid: each `ANALYSE` is answered by `found`, which adds
    a trial or ends the experiment, or by `analysis_failed`, which aborts it.

    Parameters
    ----------
    goal : ExperimentGoal
        What to do.
    deadlines : Deadlines
        How long to wait.
    max_failures : int
        How many trials in a row may fail before the experiment is aborted.
    now : float
        Time of acceptance [s], of a monotonic clock.

    Attributes
    ----------
    status : GoalStatus
        State of the goal.
    outcomes : list of TrialOutcome
        How the trials ended that are over.
    reason : str
        Why the experiment ends before its time; empty while it goes well.
    arm_phase : str or None
        What the arm is doing; None before it has said so.
    waiting_for : str
        What the owner waits for in this step, for the sentence on a deadline that is over.
    held_up : float
        How long the present step was held up by what its deadline does not count [s].
    findings : Findings or None
        What the last analysis has found.
    decision : Decision or None
        What it has led to.

    """

    def __init__(
        self, goal: ExperimentGoal, deadlines: Deadlines, max_failures: int, now: float
    ) -> None:
        self.goal = goal
        self.trials = goal.trials()
        self.status = GoalStatus.ACCEPTED
        self.outcomes: list[TrialOutcome] = []
        self.reason = ''
        self.arm_phase: str | None = None
        self.waiting_for = ''
        self.held_up = 0.0
        self.findings: Findings | None = None
        self.decision: Decision | None = None
        self._pushes: list[Push] = []
        self._grid_over: float | None = None
        self._deadlines = deadlines
        self._max_failures = max_failures
        self._index = 0
        self._trial_reason = ''
        self._trial_failed = False
        # Whether the tool may be low: also where the arm has said "aborted", since it may have
        # lost its height, or its controller was ended.
        self._low = False
        self._forbidden = False
        self._gone = False
        self._then: Step | None = None
        self._step = Step.BRING_UP
        self.entered = now

    @property
    def step(self) -> Step:
        """Return what is to be done now."""
        return self._step

    @property
    def trial(self) -> PlannedTrial:
        """Return the trial at hand; the last one when all are over."""
        return self.trials[self._index]

    @property
    def failing(self) -> bool:
        """Whether the trial at hand is already known to be of no use."""
        return self._trial_failed

    @property
    def shaken(self) -> bool:
        """Whether the tool may have been left low: at the begin, and after a failed trial."""
        return not self.outcomes or self.outcomes[-1].outcome is Outcome.ABORTED

    def begin(self, now: float) -> None:
        """Start to execute the accepted goal."""
        if self.status is GoalStatus.ACCEPTED:
            self.status = GoalStatus.EXECUTING
            if not self._forbidden:
                self._enter(Step.BRING_UP, now)

    def time_left(self, now: float) -> float:
        """
        Return the least time that the experiment still needs [s].

        Approach and retraction are not known beforehand and are left out.
        """
        goal = self.goal
        if self.status.terminal:
            return 0.0
        following = self._index + 1
        left = sum(goal.rest_time + pushing_time(goal, trial) for trial in self.trials[following:])
        if self._then is not None or self._step in _PUSHED:
            return left
        if self._step is Step.REST:
            return max(0.0, left - (now - self.entered))
        spent = now - self.entered if self._step is Step.PUSH else 0.0
        return left + max(0.0, pushing_time(goal, self.trial) - spent)

    def done(self, now: float) -> None:
        """Take note that the present step (but `PUSH` and `FINISH`) has been carried out."""
        if self._step is Step.DISABLE:
            self._end(now)
        elif self._step is Step.BRING_UP and self._then is not None:
            # No push follows whose goal the cell might not allow.
            self._enter(Step.ENABLE, now)
        elif self._step is Step.RETRACT:
            self._low = False
            step, self._then = self._then or _NEXT[self._step], None
            self._enter(step, now)
        elif self._step is Step.REST:
            self._index += 1
            self._enter(Step.BRING_UP, now)
        else:
            self._enter(_NEXT[self._step], now)

    def failed(self, reason: str, now: float) -> None:
        """
        Take note that the present step cannot be carried out: the experiment is aborted.

        Parameters
        ----------
        reason : str
            One sentence.
        now : float
            Time [s].

        """
        returning = self._then is not None
        if (self._step is Step.DISABLE or returning) and self.shaken and self.outcomes:
            # What does not answer now is what failed before.
            reason = self.outcomes[-1].reason
        self.reason = self.reason or reason
        if self._step in (*_RECORDING, Step.FINISH):
            self._fail_trial(reason)
        if self._step in _RECORDING:
            self._enter(Step.STOP, now)
        elif self._step is Step.STOP:
            self._enter(Step.FINISH, now)
        elif self._step is Step.DISABLE or (returning and self._step is not Step.RETRACT):
            self._end(now)
        else:
            self._enter(Step.DISABLE, now)

    def forbidden(self, reason: str, now: float, *, gone: bool = False) -> None:
        """
        Take note that somebody has forbidden motion: the experiment is aborted where it stands.

        Parameters
        ----------
        reason : str
            One sentence.
        now : float
            Time [s].
        gone : bool
            Whether the controller has ended, so that it need not be told.

        """
        if self._forbidden or self.status.terminal:
            return
        self._forbidden = True
        self._gone = gone
        self.reason = self.reason or reason
        # A trial that is being stopped or closed is brought to its end first.
        if self._step not in (Step.STOP, Step.FINISH, Step.DISABLE):
            self.failed(reason, now)
        elif gone:
            self._enter(self._step, now)

    def lost(self, reason: str, now: float) -> None:
        """
        Take note that the running push cannot come to anything: its trial is aborted.

        Parameters
        ----------
        reason : str
            One sentence.
        now : float
            Time [s].

        """
        self._fail_trial(reason)
        self._enter(Step.STOP, now)

    def explain(self, reason: str) -> None:
        """Take note of why the arm has aborted the push."""
        if self._trial_reason == ARM_ABORTED:
            self._trial_reason = f'{ARM_ABORTED}: {reason}'

    def phase(self, name: str, now: float) -> None:
        """Take note of the arm's phase; only of use once the push has been started."""
        self.arm_phase = name
        if self._step not in (Step.START, Step.PUSH, Step.STOP):
            return
        self._low = name != 'done'
        if name == 'aborted':
            self._fail_trial(ARM_ABORTED)
        if name in ('done', 'aborted') and self._step in (Step.PUSH, Step.STOP):
            self._enter(Step.FINISH, now)

    def started(self, now: float) -> None:
        """Take note that the arm has accepted the push."""
        self._enter(Step.PUSH, now)
        if self.arm_phase in ('done', 'aborted'):
            self.phase(self.arm_phase, now)

    def tick(self, now: float) -> None:
        """Let time pass: fail the step whose deadline is over, end a rest."""
        if self.status is GoalStatus.ACCEPTED or self._step is Step.END:
            return
        waited = now - self.entered
        if self._step is Step.REST:
            if waited >= self.goal.rest_time:
                self.done(now)
            return
        limit = self._deadlines.of(self._step, self.goal, self.trial)
        if waited > limit + self.held_up:
            doing = self.waiting_for or f'the end of "{self._step.name.lower()}"'
            reason = f'{self.trial.name}: waited {limit:.3g} s for {doing}'
            if self._step is Step.PUSH:
                self.lost(reason, now)
            elif self._step is Step.ANALYSE:
                self.analysis_failed(f'waited {limit:.3g} s for {doing}', now)
            elif self._step is Step.STOP and self._trial_failed:
                # Who does not answer cannot be stopped; the next trial begins with seeing to it.
                self._enter(Step.FINISH, now)
            else:
                self.failed(reason, now)

    def cancel(self, now: float) -> bool:
        """Return whether the goal can still be cancelled, and begin to do so."""
        if self.status.terminal or self.status is GoalStatus.CANCELING:
            return False
        self.status = GoalStatus.CANCELING
        if self._step in _RECORDING:
            self._fail_trial('the experiment was cancelled')
            self._enter(Step.STOP, now)
        elif self._then is not None:
            # The tool is being seen to, and nothing else is done after that.
            self._then = Step.DISABLE
        elif self._step not in (Step.STOP, Step.FINISH, Step.DISABLE):
            if self.outcomes:
                self._leave(now)
            else:
                # Nothing was pushed: after a cancel nothing moves.
                self._enter(Step.DISABLE, now)
        return True

    def recorded(self, bag: str | None, missing: Iterable[str], now: float) -> None:
        """
        Take note that the bag is closed, and go on to the next trial or to the end.

        Parameters
        ----------
        bag : str or None
            Where the trial was recorded; None if it was not.
        missing : iterable of str
            Topics that a trial needs and of which nothing came.
        now : float
            Time [s].

        """
        lacking = ', '.join(missing)
        outcome = Outcome.COMPLETE
        if self._trial_failed:
            outcome = Outcome.ABORTED
        elif lacking:
            outcome = Outcome.INCOMPLETE
            self._trial_reason = f'nothing was received on {lacking}'
        self.outcomes.append(TrialOutcome(self.trial, outcome, bag, self._trial_reason))
        if self.status is GoalStatus.EXECUTING and not self.reason:
            most = self._max_failures
            last = self.outcomes[-most:]
            if len(last) == self._max_failures and all(
                item.outcome is not Outcome.COMPLETE for item in last
            ):
                self.reason = (
                    f'{self._max_failures} trials in a row failed, the last one because '
                    f'{self._trial_reason}'
                )
        over = self._index + 1 == len(self.trials)
        if self.reason or self.status is GoalStatus.CANCELING:
            self._leave(now)
        elif not over:
            self._enter(Step.REST, now)
        elif self.goal.budget is not None and self.complete:
            if self._grid_over is None:
                self._grid_over = now
            # A tool that may have been left low does not wait for an analysis.
            self._return(Step.ANALYSE, now)
        else:
            self._leave(now)

    @property
    def complete(self) -> list[TrialOutcome]:
        """Return the trials that are of use."""
        return [item for item in self.outcomes if item.outcome is Outcome.COMPLETE]

    def found(self, findings: Findings, now: float) -> None:
        """
        Take note of what the complete trials tell, and go on to the next push or to the end.

        Parameters
        ----------
        findings : Findings
            From the trials of `complete`, in their order.
        now : float
            Time [s].

        """
        goal = self.goal
        assert goal.budget is not None
        assert self._grid_over is not None
        spent = Spent(tuple(self._pushes), now - self._grid_over, self.findings)
        self.findings = findings
        self.decision = decide(
            findings,
            goal.budget,
            spent,
            lambda push: goal.rest_time + pushing_time(goal, push),
        )
        push = self.decision.push
        if push is None:
            self._leave(now)
            return
        self._pushes.append(push)
        self.trials = (*self.trials, self._planned(push))
        self._enter(Step.REST, now)

    def _planned(self, push: Push) -> PlannedTrial:
        """Return a push that the analysis has asked for as the next trial."""
        number = len(self.trials) + 1
        if push.like is not None:
            like = self.complete[push.like].trial
            same = [
                each.repeat
                for each in self.trials
                if (each.push_speed, each.depth, each.hold_time)
                == (like.push_speed, like.depth, like.hold_time)
            ]
            return replace(like, number=number, repeat=max(same) + 1, reason=push.reason)
        return PlannedTrial(
            number, push.push_speed, push.depth, 1, push.hold_time, 'fixed', push.reason
        )

    def analysis_failed(self, reason: str, now: float) -> None:
        """
        Take note that the trials could not be analysed: the experiment ends, they are kept.

        Parameters
        ----------
        reason : str
            One sentence.
        now : float
            Time [s].

        """
        self.decision = Decision(None, Ending.FAILED, reason)
        self.reason = self.reason or f'{Ending.FAILED.value}: {reason}'
        self._leave(now)

    def _leave(self, now: float) -> None:
        """End the trials, and see to a tool that may have been left low."""
        self._return(Step.DISABLE, now)

    def _return(self, then: Step, now: float) -> None:
        """Go to a step, by a retraction if the tool may have been left low and may be moved."""
        retract = self._low and not self._forbidden
        self._then = then if retract else None
        self._enter(Step.BRING_UP if retract else then, now)

    def _fail_trial(self, reason: str) -> None:
        """Mark the trial at hand; its first reason stands."""
        if not self._trial_failed:
            self._trial_failed = True
            self._trial_reason = reason

    def _enter(self, step: Step, now: float) -> None:
        """Go to a step; a new trial forgets the last one's troubles."""
        if self._gone and step is Step.DISABLE:
            self._end(now)
            return
        if self._gone and step is Step.STOP:
            step = Step.FINISH
        if step is Step.BRING_UP:
            self._trial_failed = False
            self._trial_reason = ''
        if step is Step.START:
            # The latched phase of the push before must not end this one.
            self.arm_phase = None
            self._low = True
        self._step = step
        self.waiting_for = ''
        self.held_up = 0.0
        self.entered = now

    def _end(self, now: float) -> None:
        """Settle the goal's final status."""
        self._enter(Step.END, now)
        if self.reason:
            self.status = GoalStatus.ABORTED
        elif self.status is GoalStatus.CANCELING:
            self.status = GoalStatus.CANCELED
            self.reason = 'cancelled on request'
        elif any(item.outcome is Outcome.COMPLETE for item in self.outcomes):
            self.status = GoalStatus.SUCCEEDED
        else:
            self.status = GoalStatus.ABORTED
            self.reason = f'no trial is complete: {self.outcomes[-1].reason}'
        if self._low:
            self.reason = f'{self.reason.rstrip(".")}; {LEFT_LOW}'
