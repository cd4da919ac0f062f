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

"""The experiment's plan and the life of its goal, without ROS."""

import math

from hapticvision_ros.core.autonomy import Budget, Ending, Findings, Push
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.experiment import (
    Deadlines,
    Experiment,
    ExperimentGoal,
    GoalStatus,
    Outcome,
    Step,
)
import pytest

DEADLINES = Deadlines(service=5.0, approach=20.0, margin=10.0)


def goal(**changes: object) -> ExperimentGoal:
    """Return a goal of 2 speeds, 2 depths and one repeat, with changes."""
    values: dict[str, object] = {
        'push_speeds': (0.0013, 0.0077),
        'depths': (0.005, 0.010),
        'repeats': 1,
        'hold_time': 3.0,
        'recover_time': 4.0,
        'rest_time': 1.0,
    }
    return ExperimentGoal(**(values | changes))  # type: ignore[arg-type]


def begun(**changes: object) -> Experiment:
    """Return an experiment that executes, at time 0."""
    experiment = Experiment(goal(**changes), DEADLINES, max_failures=2, now=0.0)
    experiment.begin(0.0)
    return experiment


def advance(experiment: Experiment, step: Step, now: float = 0.0) -> None:
    """Carry the steps out until `step` is due."""
    for _ in range(20):
        if experiment.step is step:
            return
        if experiment.step is Step.START:
            experiment.started(now)
        else:
            experiment.done(now)
    raise AssertionError(f'{step} was never due')


def push(experiment: Experiment, phase: str = 'done', now: float = 0.0) -> None:
    """Make the trial at hand, and record it."""
    advance(experiment, Step.PUSH, now)
    experiment.phase(phase, now)
    assert experiment.step is Step.FINISH
    experiment.recorded(f'/bags/{experiment.trial.name}', (), now)


def test_the_grid_is_gone_through_before_it_is_repeated():
    trials = goal(repeats=2).trials()
    assert [trial.name for trial in trials] == [
        'trial_001_1.3mm_s_5mm_r1',
        'trial_002_1.3mm_s_10mm_r1',
        'trial_003_7.7mm_s_5mm_r1',
        'trial_004_7.7mm_s_10mm_r1',
        'trial_005_1.3mm_s_5mm_r2',
        'trial_006_1.3mm_s_10mm_r2',
        'trial_007_7.7mm_s_5mm_r2',
        'trial_008_7.7mm_s_10mm_r2',
    ]


def test_a_whole_number_of_millimetres_per_second_keeps_its_decimal():
    (trial,) = goal(push_speeds=(0.005,), depths=(0.0105,)).trials()
    assert trial.name == 'trial_001_5.0mm_s_10.5mm_r1'


def test_different_pushes_never_share_a_name():
    speeds = (0.001, 0.0010001, 0.0100001, 1e-9)
    names = {trial.name for trial in goal(push_speeds=speeds).trials()}
    assert len(names) == 8


@pytest.mark.parametrize(
    ('changes', 'says'),
    [
        ({'push_speeds': ()}, 'no speeds'),
        ({'push_speeds': (0.001, -0.001)}, 'speeds has -0.001'),
        ({'depths': (math.nan,)}, 'depths has nan'),
        ({'depths': (0.01, 0.01)}, 'depths names a value twice'),
        ({'repeats': 0}, 'repeats is 0'),
        ({'hold_time': 0.0}, 'hold_time has 0'),
        ({'recover_time': math.inf}, 'recover_time has inf'),
        ({'rest_time': -1.0}, 'rest_time is -1'),
        ({'hold_mode': 'long'}, "hold_mode is 'long'"),
    ],
)
def test_a_goal_that_cannot_be_pushed_is_refused_in_one_sentence(changes, says):
    with pytest.raises(UsageError, match=says):
        goal(**changes)


def test_an_experiment_without_trouble_succeeds_with_all_its_trials():
    experiment = begun()
    for number in range(1, 5):
        assert experiment.trial.number == number
        push(experiment, now=float(number))
        if number < 4:
            assert experiment.step is Step.REST
            experiment.tick(number + 0.5)
            assert experiment.step is Step.REST, 'the rest is not over'
            experiment.tick(number + 1.0)
            assert experiment.step is Step.BRING_UP
    assert experiment.step is Step.DISABLE
    experiment.done(9.0)
    assert experiment.status is GoalStatus.SUCCEEDED
    assert [item.outcome for item in experiment.outcomes] == [Outcome.COMPLETE] * 4
    assert experiment.time_left(9.0) == 0.0


def test_the_latched_end_of_the_push_before_does_not_end_the_next_one():
    experiment = begun()
    experiment.phase('done', 0.0)
    advance(experiment, Step.PUSH)
    assert experiment.step is Step.PUSH


def test_a_push_that_ends_before_the_service_answers_is_not_missed():
    experiment = begun()
    advance(experiment, Step.START)
    experiment.phase('approach', 0.0)
    experiment.phase('done', 0.0)
    assert experiment.step is Step.START
    experiment.started(0.0)
    assert experiment.step is Step.FINISH


def test_a_push_aborted_by_the_arm_is_kept_and_the_next_trial_goes_on():
    experiment = begun()
    push(experiment, 'aborted')
    assert experiment.outcomes[0].outcome is Outcome.ABORTED
    assert experiment.outcomes[0].bag is not None
    assert experiment.step is Step.REST
    experiment.tick(1.0)
    push(experiment)
    assert experiment.outcomes[1].outcome is Outcome.COMPLETE


def test_two_failed_trials_in_a_row_abort_the_experiment():
    experiment = begun()
    push(experiment, 'aborted')
    experiment.tick(1.0)
    advance(experiment, Step.PUSH)
    experiment.phase('done', 1.0)
    experiment.recorded('/bags/b', ['/load_cell/wrench'], 1.0)
    assert experiment.outcomes[1].outcome is Outcome.INCOMPLETE
    assert experiment.step is Step.DISABLE
    experiment.done(1.0)
    assert experiment.status is GoalStatus.ABORTED
    assert 'nothing was received on /load_cell/wrench' in experiment.reason


@pytest.mark.parametrize('step', [Step.BRING_UP, Step.PLAN, Step.TARE, Step.CONFIGURE])
def test_a_service_that_does_not_answer_aborts_the_experiment(step):
    experiment = begun()
    advance(experiment, step)
    experiment.tick(5.0)
    assert experiment.step is step
    experiment.tick(5.1)
    assert experiment.step is Step.DISABLE
    assert step.name.lower() in experiment.reason
    experiment.done(5.2)
    assert experiment.status is GoalStatus.ABORTED


def test_an_arm_that_dies_in_mid_push_costs_its_trial_and_the_bag_is_kept():
    experiment = begun()
    advance(experiment, Step.PUSH)
    experiment.phase('push', 0.0)
    # approach + depth / speed + hold + recover + margin
    limit = 20.0 + 0.005 / 0.0013 + 3.0 + 4.0 + 10.0
    experiment.tick(limit - 0.1)
    assert experiment.step is Step.PUSH
    experiment.tick(limit + 0.1)
    assert experiment.step is Step.STOP
    experiment.tick(limit + 6.0)
    assert experiment.step is Step.FINISH, 'a dead arm does not answer the stop either'
    experiment.recorded('/bags/a', (), limit + 6.0)
    assert experiment.outcomes[0].outcome is Outcome.ABORTED
    assert experiment.outcomes[0].bag == '/bags/a'
    assert 'push' in experiment.outcomes[0].reason
    experiment.tick(limit + 7.0)
    # Whoever supervises the processes may start it again; its tool was left low.
    assert experiment.step is Step.BRING_UP
    assert experiment.shaken
    experiment.tick(limit + 13.0)
    assert experiment.step is Step.DISABLE
    experiment.done(limit + 14.0)
    assert experiment.status is GoalStatus.ABORTED
    assert 'bring_up' in experiment.reason


def test_a_tool_left_low_by_the_last_trial_is_retracted():
    experiment = begun(push_speeds=(0.001,), depths=(0.005,))
    advance(experiment, Step.PUSH)
    experiment.phase('hold', 0.5)
    experiment.lost('/arm/tool_height has been silent', 1.0)
    experiment.done(2.0)
    experiment.recorded('/bags/a', (), 2.0)
    advance(experiment, Step.RETRACT, 3.0)
    assert experiment.time_left(3.0) == 0.0
    experiment.done(4.0)
    assert experiment.step is Step.DISABLE
    experiment.done(4.0)
    assert experiment.status is GoalStatus.ABORTED
    assert experiment.reason == 'no trial is complete: /arm/tool_height has been silent'


def test_an_arm_that_does_not_come_back_is_not_waited_for_twice():
    experiment = begun(push_speeds=(0.001,), depths=(0.005,))
    advance(experiment, Step.PUSH)
    experiment.phase('hold', 0.5)
    experiment.lost('/arm/tool_height has been silent', 1.0)
    experiment.tick(7.0)
    experiment.recorded('/bags/a', (), 7.0)
    experiment.tick(13.0)
    assert experiment.step is Step.END
    low = 'the tool may have been left low: see to it'
    assert experiment.reason == f'/arm/tool_height has been silent; {low}'


def test_a_stream_that_falls_silent_costs_one_trial_only():
    experiment = begun()
    advance(experiment, Step.PUSH)
    experiment.lost('/load_cell/wrench has been silent', 1.0)
    assert experiment.step is Step.STOP
    experiment.phase('aborted', 1.1)
    experiment.explain('something the arm says')
    experiment.recorded('/bags/a', (), 1.2)
    assert experiment.outcomes[0].reason == '/load_cell/wrench has been silent'
    experiment.tick(3.0)
    push(experiment, now=4.0)
    assert experiment.outcomes[1].outcome is Outcome.COMPLETE
    assert not experiment.shaken


def test_the_arms_own_reason_is_told():
    experiment = begun()
    advance(experiment, Step.PUSH)
    experiment.phase('aborted', 0.0)
    experiment.explain('The contact force exceeds the limit.')
    experiment.recorded('/bags/a', (), 0.0)
    said = 'the arm aborted the push: The contact force exceeds the limit.'
    assert experiment.outcomes[0].reason == said


def test_a_cancel_in_mid_push_stops_the_arm_and_keeps_the_bag():
    experiment = begun()
    advance(experiment, Step.PUSH)
    assert experiment.cancel(0.0)
    assert experiment.status is GoalStatus.CANCELING
    assert experiment.step is Step.STOP
    assert not experiment.cancel(0.0), 'it is being cancelled already'
    experiment.phase('aborted', 0.1)
    assert experiment.step is Step.FINISH
    experiment.recorded('/bags/a', (), 0.2)
    assert Step.RETRACT in steps_until(experiment, Step.DISABLE, 0.3)
    experiment.done(0.3)
    assert experiment.status is GoalStatus.CANCELED
    assert [item.outcome for item in experiment.outcomes] == [Outcome.ABORTED]


def test_a_cancel_between_trials_makes_no_further_push():
    experiment = begun()
    push(experiment)
    assert experiment.cancel(0.5)
    assert experiment.step is Step.DISABLE
    experiment.done(0.6)
    assert experiment.status is GoalStatus.CANCELED
    assert not experiment.cancel(0.7), 'it is over'


def test_the_time_left_falls_as_the_push_goes_on():
    experiment = begun(push_speeds=(0.001,), depths=(0.005,), repeats=2)
    one = 5.0 + 3.0 + 4.0
    assert experiment.time_left(0.0) == pytest.approx(2 * one + 1.0)
    advance(experiment, Step.PUSH)
    assert experiment.time_left(2.0) == pytest.approx(2 * one + 1.0 - 2.0)
    experiment.phase('done', 12.0)
    experiment.recorded('/bags/a', (), 12.0)
    assert experiment.time_left(12.25) == pytest.approx(one + 0.75)


def test_a_disk_error_aborts_and_its_sentence_is_the_reason():
    experiment = begun()
    advance(experiment, Step.RECORD)
    experiment.failed('cannot write /bags/a: no space left on device', 0.0)
    assert experiment.step is Step.STOP
    experiment.done(0.0)
    experiment.recorded(None, (), 0.0)
    experiment.done(0.0)
    assert experiment.status is GoalStatus.ABORTED
    assert 'no space left' in experiment.reason


SEPARATE = Push('separate', 0.002, 0.004, 6.0, ('a', 'b'), 8.0, 'a and b answer it differently')
OPEN = Findings('explained', ('a',), (('a', 'b'),), {}, push=SEPARATE)
CLOSED = Findings('explained', ('a',), (('a',),), {}, trials=2, kinds=2)


def autonomous(**budget: float) -> Experiment:
    """Return an experiment of one push that is going to choose more, after this push."""
    experiment = begun(
        push_speeds=(0.001,),
        depths=(0.005,),
        hold_mode='auto',
        budget=Budget(**({'trials': 2} | budget)),  # type: ignore[arg-type]
    )
    push(experiment)
    return experiment


def test_after_its_grid_an_autonomous_experiment_goes_on_until_the_effect_is_decided():
    experiment = autonomous()
    assert experiment.step is Step.ANALYSE
    assert experiment.time_left(0.0) == 0.0
    experiment.found(OPEN, 5.0)
    assert experiment.step is Step.REST
    experiment.tick(6.0)
    chosen = experiment.trial
    assert (chosen.number, chosen.push_speed, chosen.depth) == (2, 0.002, 0.004)
    assert (chosen.hold_time, chosen.hold_mode) == (6.0, 'fixed')
    assert chosen.reason == 'a and b answer it differently'
    assert chosen.name == 'trial_002_2.0mm_s_4mm_r1'
    # Two seconds down, six at the depth, four to recover.
    assert experiment.time_left(6.0) == pytest.approx(12.0)
    push(experiment, now=20.0)
    assert experiment.step is Step.ANALYSE
    experiment.found(CLOSED, 25.0)
    assert experiment.step is Step.DISABLE
    experiment.done(26.0)
    assert experiment.status is GoalStatus.SUCCEEDED
    assert experiment.decision is not None
    assert experiment.decision.ending is Ending.DECIDED
    assert len(experiment.complete) == 2


def test_the_budget_counts_from_the_end_of_the_grid_and_failed_pushes_too():
    experiment = autonomous()
    for trial in (2, 3):
        experiment.found(OPEN, 1.0)
        experiment.tick(2.0)
        assert experiment.trial.number == trial
        push(experiment, 'aborted' if trial == 2 else 'done', now=3.0)
        advance(experiment, Step.ANALYSE, 3.0)
    experiment.found(OPEN, 4.0)
    assert experiment.decision is not None
    assert experiment.decision.ending is Ending.BUDGET
    assert [item.trial.number for item in experiment.complete] == [1, 3]

    # Twelve seconds of a push and one of rest.
    short = autonomous(trials=9, time=20.0)
    short.found(OPEN, 8.0)
    assert short.decision is not None
    assert short.decision.ending is Ending.BUDGET


def test_a_repeat_is_of_the_trial_as_it_was_commanded():
    experiment = autonomous()
    repeat = Push('repeat', 0.00099, 0.0051, 2.7, (), 0.0, 'only a repeat tells', like=0)
    left = Findings('unexplained', (), (), {}, trials=2, kinds=2, repeat=repeat)
    experiment.found(left, 1.0)
    experiment.tick(2.0)
    chosen = experiment.trial
    assert chosen.name == 'trial_002_1.0mm_s_5mm_r2'
    assert (chosen.hold_time, chosen.hold_mode) == (3.0, 'auto')


def test_an_analysis_that_fails_or_takes_too_long_aborts_and_the_trials_stay():
    experiment = autonomous()
    experiment.analysis_failed('the process that analyses the bags ended by signal 9', 1.0)
    experiment.done(2.0)
    assert experiment.status is GoalStatus.ABORTED
    assert experiment.reason.startswith('the analysis failed: the process that')
    assert [item.outcome for item in experiment.outcomes] == [Outcome.COMPLETE]

    slow = Experiment(
        goal(push_speeds=(0.001,), depths=(0.005,), budget=Budget(2)),
        Deadlines(service=5.0, approach=20.0, margin=10.0, analysis=30.0),
        max_failures=2,
        now=0.0,
    )
    slow.begin(0.0)
    push(slow)
    slow.waiting_for = 'the analysis of the bags so far'
    slow.tick(29.0)
    assert slow.step is Step.ANALYSE
    slow.tick(31.0)
    assert slow.step is Step.DISABLE
    assert slow.reason == ('the analysis failed: waited 30 s for the analysis of the bags so far')


def test_what_holds_an_analysis_up_does_not_count():
    slow = Experiment(
        goal(push_speeds=(0.001,), depths=(0.005,), budget=Budget(2)),
        Deadlines(service=5.0, approach=20.0, margin=10.0, analysis=30.0),
        max_failures=2,
        now=0.0,
    )
    slow.begin(0.0)
    push(slow)
    slow.held_up = 100.0
    slow.tick(129.0)
    assert slow.step is Step.ANALYSE
    slow.tick(131.0)
    assert slow.step is Step.DISABLE
    assert slow.held_up == 0.0, 'that was another step'


def test_a_cancel_while_it_analyses_makes_no_further_push():
    experiment = autonomous()
    assert experiment.cancel(1.0)
    assert experiment.step is Step.DISABLE
    experiment.done(1.0)
    assert experiment.status is GoalStatus.CANCELED


def failed_after_a_complete_one() -> Experiment:
    """Return an experiment whose last push before the analysis has left its tool low."""
    experiment = begun(push_speeds=(0.001,), depths=(0.005, 0.006), budget=Budget(2))
    push(experiment)
    experiment.tick(1.0)
    push(experiment, 'aborted', now=2.0)
    return experiment


def steps_until(experiment: Experiment, step: Step, now: float) -> list[Step]:
    """Carry the steps out until `step` is due, and return them."""
    gone = []
    while experiment.step is not step:
        gone.append(experiment.step)
        experiment.done(now)
    return gone


def test_a_tool_left_low_is_retracted_before_the_trials_are_analysed():
    experiment = failed_after_a_complete_one()
    assert experiment.time_left(2.0) == 0.0
    gone = steps_until(experiment, Step.ANALYSE, 3.0)
    assert gone == [Step.BRING_UP, Step.ENABLE, Step.RETRACT]
    # So ends the retraction of a controller that was started again.
    experiment.phase('aborted', 3.0)
    experiment.found(CLOSED, 4.0)
    # It is up: nothing is to be seen to any more.
    assert experiment.step is Step.DISABLE
    experiment.done(5.0)
    assert experiment.status is GoalStatus.SUCCEEDED
    assert experiment.reason == ''


def test_a_cancel_while_the_tool_is_seen_to_ends_without_the_analysis():
    experiment = failed_after_a_complete_one()
    assert experiment.cancel(2.5)
    gone = steps_until(experiment, Step.DISABLE, 3.0)
    assert gone == [Step.BRING_UP, Step.ENABLE, Step.RETRACT]
    experiment.done(4.0)
    assert experiment.status is GoalStatus.CANCELED


def test_an_arm_that_does_not_come_back_ends_the_experiment_before_its_analysis():
    experiment = failed_after_a_complete_one()
    experiment.tick(8.0)
    assert experiment.step is Step.END
    assert experiment.status is GoalStatus.ABORTED
    assert experiment.reason.startswith('the arm aborted the push; the tool may have been left')


def test_motion_is_forbidden_after_a_retraction_that_was_refused():
    experiment = failed_after_a_complete_one()
    advance(experiment, Step.RETRACT, 3.0)
    experiment.tick(9.0)
    assert experiment.step is Step.DISABLE
    experiment.done(9.0)
    assert experiment.status is GoalStatus.ABORTED


def test_a_chosen_push_that_failed_leaves_no_tool_low_either():
    experiment = autonomous()
    experiment.found(OPEN, 1.0)
    experiment.tick(2.0)
    push(experiment, 'aborted', now=3.0)
    assert Step.RETRACT in steps_until(experiment, Step.ANALYSE, 4.0)
    assert experiment.cancel(5.0)
    assert experiment.step is Step.DISABLE, 'the tool is up'


@pytest.mark.parametrize('step', [Step.REST, Step.BRING_UP, Step.ENABLE, Step.RETRACT])
def test_a_cancel_after_a_failed_trial_leaves_no_tool_low(step):
    experiment = begun()
    push(experiment, 'aborted')
    assert experiment.step is Step.REST
    if step is not Step.REST:
        experiment.tick(1.0)
        advance(experiment, step, 1.0)
    assert experiment.cancel(1.5)
    assert Step.RETRACT in steps_until(experiment, Step.DISABLE, 2.0)
    experiment.done(3.0)
    assert experiment.status is GoalStatus.CANCELED


def test_a_cancel_before_the_first_push_moves_nothing():
    experiment = begun()
    # Of an experiment before this one.
    experiment.phase('aborted', 0.0)
    assert experiment.cancel(0.5)
    assert experiment.step is Step.DISABLE


def test_without_a_complete_trial_there_is_nothing_to_analyse():
    experiment = begun(push_speeds=(0.001,), depths=(0.005,), budget=Budget(2))
    push(experiment, 'aborted')
    assert experiment.step is not Step.ANALYSE
    assert Step.ANALYSE not in steps_until(experiment, Step.DISABLE, 0.0)


@pytest.mark.parametrize('step', [Step.BRING_UP, Step.TARE, Step.RECORD, Step.PUSH, Step.STOP])
def test_nothing_moves_any_more_once_somebody_has_forbidden_it(step):
    """The emergency stop in the second trial, whatever the experiment is doing."""
    experiment = begun()
    push(experiment)
    experiment.tick(1.0)
    advance(experiment, Step.PUSH if step is Step.STOP else step, 1.0)
    if step is Step.STOP:
        experiment.lost('silent', 1.1)
    experiment.forbidden('The emergency stop was pressed.', 1.2)
    experiment.forbidden('The controller was disabled.', 1.2)
    if step in (Step.PUSH, Step.STOP):
        experiment.phase('aborted', 1.3)
    if step in (Step.RECORD, Step.PUSH, Step.STOP):
        advance(experiment, Step.FINISH, 1.3)
        experiment.recorded('/bags/b', (), 1.4)
    assert experiment.step is Step.DISABLE
    experiment.done(1.5)
    assert experiment.status is GoalStatus.ABORTED
    assert experiment.reason.startswith('The emergency stop was pressed')
    assert ('left low' in experiment.reason) == (step in (Step.PUSH, Step.STOP))


@pytest.mark.parametrize(
    'step', [Step.BRING_UP, Step.TARE, Step.RECORD, Step.START, Step.PUSH, Step.STOP, Step.DISABLE]
)
def test_a_controller_that_was_shut_down_is_not_waited_for(step):
    experiment = begun()
    push(experiment)
    experiment.tick(1.0)
    if step is Step.DISABLE:
        experiment.failed('no disk', 1.1)
    else:
        advance(experiment, Step.PUSH if step is Step.STOP else step, 1.0)
    if step is Step.STOP:
        experiment.lost('silent', 1.1)
    assert experiment.step is step
    experiment.forbidden('The controller was shut down.', 1.2, gone=True)
    if step in (Step.RECORD, Step.START, Step.PUSH, Step.STOP):
        assert experiment.step is Step.FINISH
        experiment.recorded('/bags/b', (), 1.3)
    assert experiment.step is Step.END
    assert experiment.status is GoalStatus.ABORTED


def test_a_stop_while_a_bag_is_being_closed_keeps_the_trial():
    experiment = begun()
    advance(experiment, Step.PUSH)
    experiment.phase('aborted', 1.0)
    experiment.forbidden('The controller was disabled.', 1.1)
    assert experiment.step is Step.FINISH
    experiment.recorded('/bags/a', (), 1.2)
    assert [item.outcome for item in experiment.outcomes] == [Outcome.ABORTED]
    assert experiment.step is Step.DISABLE
    experiment.done(1.3)
    assert experiment.status is GoalStatus.ABORTED
    assert experiment.reason.startswith('The controller was disabled')


def test_a_stop_before_the_first_step_is_not_forgotten():
    experiment = Experiment(goal(), DEADLINES, max_failures=2, now=0.0)
    experiment.forbidden('The emergency stop was pressed.', 0.0)
    experiment.begin(0.1)
    assert experiment.step is Step.DISABLE
    experiment.done(0.2)
    assert experiment.status is GoalStatus.ABORTED


def test_a_stop_after_a_failed_trial_leaves_the_tool_where_it_is():
    experiment = begun()
    push(experiment, 'aborted')
    experiment.tick(1.0)
    advance(experiment, Step.RETRACT, 1.0)
    experiment.forbidden('The emergency stop was pressed.', 1.2)
    assert experiment.step is Step.DISABLE
    experiment.done(1.5)
    assert 'left low' in experiment.reason
    experiment.forbidden('The controller was disabled.', 1.6)
    assert experiment.status is GoalStatus.ABORTED
