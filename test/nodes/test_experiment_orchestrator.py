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

"""The experiment orchestrator with the real nodes and the simulated cell, each a process."""

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
import json
from pathlib import Path
import signal
import subprocess
import sys
import time
from types import SimpleNamespace
from typing import Any

from action_msgs import msg as action
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticStatus
from hapticvision_ros.bag.contract import (
    CANCEL_EXPERIMENT,
    DISPLACEMENT_HEIGHT,
    ENABLE,
    ENABLE_EXPERIMENT,
    EXPERIMENT_FEEDBACK,
    EXPERIMENT_RESULT,
    EXPERIMENT_STATUS,
    PHASE,
    POINTS,
    PUSH,
    RHEOLOGY_RESULT,
    START_EXPERIMENT,
    STOP,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.autonomy import Budget, Findings, Push
from hapticvision_ros.core.clock_watch import ClockWatch
from hapticvision_ros.core.experiment import (
    Deadlines,
    Experiment,
    ExperimentGoal,
    GoalStatus,
    Outcome,
    Step,
    TrialOutcome,
)
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.push_control import SHUT_DOWN
from hapticvision_ros.nodes.conversions import values_from_status
from hapticvision_ros.nodes.experiment_orchestrator import (
    ACTIVE,
    ExperimentOrchestrator,
    PATIENCE,
)
from lifecycle_msgs.msg import State
import numpy as np
import pytest
from rclpy.parameter import Parameter
from std_msgs.msg import Bool
from std_srvs.srv import SetBool, Trigger

START = 120.0
"""Seven processes start on a machine that may have two processors [s]."""
SLOW = 180.0
"""A push of some seconds, on such a machine [s]."""


@pytest.fixture
def world() -> Iterator[int]:
    """Run a simulated world of modest rates, and give its port."""
    command = [str(Path(sys.executable).with_name('simulated_world'))]
    command += ['--object', 'soft_dough', '--force-rate', '200', '--arm-rate', '100']
    with subprocess.Popen(
        [*command, '--range-rate', '5'], stdout=subprocess.PIPE, encoding='utf-8'
    ) as process:
        assert process.stdout is not None
        yield int(process.stdout.readline().split()[1])
        process.send_signal(signal.SIGINT)


@pytest.fixture
def orchestrator() -> str:
    """Return the orchestrator's executable, for a test to take another."""
    return 'experiment_orchestrator'


@pytest.fixture
def cell(world: int, start_node: Any, tmp_path: Path, orchestrator: str) -> dict[str, Any]:
    """Start the nodes that an experiment needs."""
    port = {'simulated_world_port': world}
    goal = {
        'speeds': '[0.01]',
        'depths': '[0.005]',
        'repeats': 1,
        'hold_time': 2.0,
        'recover_time': 2.0,
        'rest_time': 0.1,
        'output_folder': str(tmp_path / 'bags'),
        'service_deadline': 40.0,
        'stream_deadline': 3.0,
        'feedback_period': 0.2,
    }
    arm = {
        'approach_speed': 0.03,
        'release_speed': 0.02,
        'zero_time': 0.2,
        'tool_height_rate': 100.0,
        'stale_time': 1.0,
    }
    return {
        'load_cell_driver': start_node('load_cell_driver', port),
        'range_sensor_driver': start_node(
            'range_sensor_driver', port | {'width': 160, 'height': 120}
        ),
        'arm_push_controller': start_node('arm_push_controller', port | arm),
        'contact_point_planner': start_node('contact_point_planner'),
        'experiment_orchestrator': start_node(orchestrator, port | goal),
    }


def begin(probe):
    """Allow motion, send the goal and return the answer."""
    probe.call(ENABLE_EXPERIMENT, SetBool.Request(data=True), START)
    return probe.call(START_EXPERIMENT, Trigger.Request(), START)


def states(heard: list[Any], goal_id: str) -> list[int]:
    """Return the states that a goal has gone through."""
    return [
        int(status.status)
        for message in heard
        for status in message.status_list
        if bytes(status.goal_info.goal_id.uuid).hex() == goal_id
    ]


def test_after_an_aborted_push_the_next_is_recorded_whole_and_live_and_offline_fits_agree(
    cell, start_node, probe, until
):
    start_node('rheology_fitter')
    results, told = probe.listen(EXPERIMENT_RESULT), probe.listen(EXPERIMENT_STATUS)
    feedback, fits = probe.listen(EXPERIMENT_FEEDBACK), probe.listen(RHEOLOGY_RESULT)
    phases = probe.listen(PHASE)
    (result,) = probe.set_parameters('experiment_orchestrator', {'repeats': 2})
    assert result.successful, result.reason
    answer = begin(probe)
    assert answer.success, answer.message
    again = begin(probe)
    assert not again.success
    assert 'cancel it first' in again.message
    until(
        lambda: any(item.data == 'hold' for item in phases) or results, 'the hold or an end', SLOW
    )
    assert not results, values_from_status(results[-1])
    assert probe.call(STOP, Trigger.Request()).success

    until(lambda: results, 'the result', SLOW)
    values = values_from_status(results[-1])
    assert values['outcome 1'] == 'aborted: the arm aborted the push: A stop was requested.'
    assert values['bag 1'].endswith('_aborted')
    assert values['outcome 2'] == 'complete'
    assert (values['status'], values['complete']) == ('SUCCEEDED', '1'), values
    bag = Path(values['bag 2'])
    assert bag.name == 'trial_002_10.0mm_s_5mm_r2'
    assert states(told, answer.message) == [
        action.GoalStatus.STATUS_ACCEPTED,
        action.GoalStatus.STATUS_EXECUTING,
        action.GoalStatus.STATUS_SUCCEEDED,
    ]
    seen = {values_from_status(message)['phase'] for message in feedback}
    assert {'hold', 'recover'} <= seen

    trial = read_trial(bag)
    assert [phase for _, phase in trial.phases][-1] == 'done'
    assert trial.provenance['commanded_depth_m'] == '0.005'
    offline = analyse(trial)
    until(lambda: fits, 'the live fit', START)
    live = values_from_status(fits[-1])
    # The live fit has some tenths of a second of recovery more than the bag: no news of the push.
    for name in ('push_speed', 'depth'):
        found = pytest.approx(getattr(offline.segmentation, name), rel=1e-3)
        unit = 'm_s' if name == 'push_speed' else 'm'
        assert float(live[f'{name}_{unit}']) == found, (live, offline.warnings)

    refused = begin(probe)
    assert not refused.success, 'nothing is overwritten'
    assert 'exists already' in refused.message


def test_a_cancelled_push_keeps_its_bag_and_says_so(cell, probe, until):
    results, phases = probe.listen(EXPERIMENT_RESULT), probe.listen(PHASE)
    goal_id = begin(probe).message
    until(
        lambda: any(item.data == 'hold' for item in phases) or results, 'the hold or an end', SLOW
    )
    assert not results, results[-1].message
    answer = probe.call(CANCEL_EXPERIMENT, CancelGoal.Request())
    assert answer.return_code == CancelGoal.Response.ERROR_NONE
    assert bytes(answer.goals_canceling[0].goal_id.uuid).hex() == goal_id
    until(lambda: results, 'the result', SLOW)
    values = values_from_status(results[-1])
    assert values['status'] == 'CANCELED'
    bag = Path(values['bag 1'])
    assert bag.name.endswith('_aborted')
    assert len(read_trial(bag).force) > 10
    late = probe.call(CANCEL_EXPERIMENT, CancelGoal.Request())
    assert late.return_code == CancelGoal.Response.ERROR_REJECTED


def test_after_an_emergency_stop_nothing_moves_until_somebody_starts_anew(cell, probe, until):
    results, phases = probe.listen(EXPERIMENT_RESULT), probe.listen(PHASE)
    button = probe.node.create_publisher(Bool, 'emergency_stop', 1)
    goal = {'repeats': 3, 'hold_time': 60.0, 'rest_time': 0.1}
    answers = probe.set_parameters('experiment_orchestrator', goal)
    assert all(answer.successful for answer in answers), answers
    assert begin(probe).success
    until(
        lambda: any(item.data == 'hold' for item in phases) or results, 'the hold or an end', SLOW
    )
    assert not results, values_from_status(results[-1])
    button.publish(Bool(data=True))
    until(lambda: phases[-1].data == 'aborted', 'the end of the push')
    refused = begin(probe)
    assert not refused.success
    # Released at once: the experiment has not forgotten it.
    button.publish(Bool(data=False))
    until(lambda: results, 'the result', SLOW)
    values = values_from_status(results[-1])
    assert (values['status'], values['trials']) == ('ABORTED', '3')
    assert results[-1].message.startswith('The emergency stop was pressed')
    assert 'outcome 2' not in values
    assert 'forbidden' in probe.call(PUSH, Trigger.Request()).message


def test_an_experiment_does_not_allow_what_somebody_has_forbidden(cell, probe, until):
    """The controller is disabled by hand between two trials."""
    results, feedback = probe.listen(EXPERIMENT_RESULT), probe.listen(EXPERIMENT_FEEDBACK)
    phases = probe.listen(PHASE)
    goal = {'repeats': 2, 'hold_time': 0.5, 'recover_time': 0.5, 'rest_time': 3.0}
    answers = probe.set_parameters('experiment_orchestrator', goal)
    assert all(answer.successful for answer in answers), answers
    assert begin(probe).success
    until(
        lambda: any(values_from_status(item)['step'] == 'rest' for item in feedback) or results,
        'the rest or an end',
        SLOW,
    )
    assert not results, values_from_status(results[-1])
    assert probe.call(ENABLE, SetBool.Request(data=False)).success
    phases.clear()
    until(lambda: results, 'the result', SLOW)
    values = values_from_status(results[-1])
    assert values['status'] == 'ABORTED'
    assert values['outcome 1'] == 'complete'
    assert 'The controller was disabled' in results[-1].message
    assert not phases, 'no second push was begun'


def test_an_orchestrator_that_is_stopped_stops_the_arm_and_tells_how_the_experiment_ended(
    cell, probe, until
):
    results, phases = probe.listen(EXPERIMENT_RESULT), probe.listen(PHASE)
    probe.set_parameters('experiment_orchestrator', {'hold_time': 60.0})
    answer = begin(probe)
    assert answer.success, answer.message
    until(
        lambda: any(item.data == 'hold' for item in phases) or results, 'the hold or an end', SLOW
    )
    assert not results, values_from_status(results[-1])
    assert cell['experiment_orchestrator'].stop() == 0
    until(lambda: results, 'the last words')
    values = values_from_status(results[-1])
    assert values['status'] == 'ABORTED'
    assert results[-1].message.startswith('the orchestrator was stopped')
    until(lambda: phases[-1].data == 'aborted', 'the end of the push')
    bag = Path(values['bag 1'])
    assert bag.name.endswith('_aborted')
    assert len(read_trial(bag).force) > 10


CHOSEN = Push('separate', 0.008, 0.003, 0.4, ('a', 'b'), 8.0, 'a and b answer it differently')
OPEN = Findings('explained', ('a',), (('a', 'b'),), {}, push=CHOSEN)
ANALYSIS = f"""
import sys
sys.stdin.readline()
print('doing much', flush=True)
print('found', {json.dumps(json.dumps(OPEN.document()))})
"""
"""An analysis that asks for the same push each time."""
ORCHESTRATOR = f"""#!{sys.executable}
from functools import partial
import sys
from hapticvision_ros.nodes import experiment_orchestrator as node
command = (sys.executable, '-c', {ANALYSIS!r})
node.CampaignAnalysis = partial(node.CampaignAnalysis, command=command)
sys.exit(node.main())
"""


class TestAnAutonomousExperiment:
    """Its analysis is played: what it costs and finds is tested elsewhere."""

    @pytest.fixture
    def orchestrator(self, tmp_path: Path) -> str:
        """Return an orchestrator whose analysis is played."""
        path = tmp_path / 'orchestrator'
        path.write_text(ORCHESTRATOR, encoding='utf-8')
        path.chmod(0o755)
        return str(path)

    def test_it_makes_the_push_that_its_analysis_asks_for_and_keeps_why(
        self, cell, probe, until, tmp_path
    ):
        results, feedback = probe.listen(EXPERIMENT_RESULT), probe.listen(EXPERIMENT_FEEDBACK)
        goal = {'depths': [0.003], 'hold_time': 0.4, 'recover_time': 0.4, 'autonomous': True}
        # Steps shorter than the period are told as well.
        goal |= {'budget_trials': 1, 'feedback_period': 60.0}
        answers = probe.set_parameters('experiment_orchestrator', goal)
        assert all(answer.successful for answer in answers), answers
        answer = begin(probe)
        assert answer.success, answer.message
        until(lambda: results, 'the result', SLOW)
        values = values_from_status(results[-1])
        assert values['status'] == 'SUCCEEDED', results[-1].message
        assert (values['complete'], values['ending']) == ('2', 'budget spent')
        assert values['sets'] == 'a or b'
        told = [values_from_status(message) for message in feedback]
        assert 'analyse' in {each['step'] for each in told}
        assert CHOSEN.reason in {each['chosen because'] for each in told}

        bag = Path(values['bag 2'])
        assert bag.name == 'trial_002_8.0mm_s_3mm_r1'
        trial = read_trial(bag)
        assert trial.provenance['chosen_because'] == CHOSEN.reason
        assert [phase for _, phase in trial.phases][-1] == 'done'
        kept = json.loads((bag.parent / 'autonomous.json').read_text())
        assert [(each['trials'], each['ending']) for each in kept] == [
            (1, None),
            (2, 'budget spent'),
        ]
        assert kept[0]['push']['push_speed'] == CHOSEN.push_speed
        names = {path.name for path in bag.parent.iterdir()}
        assert names == {Path(values['bag 1']).name, bag.name, 'autonomous.json'}


def came_to(step: Step) -> Experiment:
    """Return an autonomous experiment of one push whose step this is."""
    goal = ExperimentGoal((0.01,), (0.003,), 1, 0.4, 0.4, 0.1, budget=Budget(1))
    deadlines = Deadlines(service=1.0, approach=1.0, margin=1.0, analysis=30.0)
    experiment = Experiment(goal, deadlines, max_failures=1, now=0.0)
    experiment.begin(0.0)
    while experiment.step is not step:
        experiment.done(0.0)
    return experiment


@pytest.fixture
def node(ros: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """Return an orchestrator in the test process, with a folder for its bags."""
    made = ExperimentOrchestrator()
    monkeypatch.setattr(made, '_folder', tmp_path)
    yield made
    monkeypatch.undo()
    made.close()
    made.destroy_node()


def test_an_analysis_that_takes_too_long_is_kept_too(node, tmp_path, monkeypatch):
    experiment = came_to(Step.PUSH)
    experiment.phase('done', 0.0)
    experiment.recorded(str(tmp_path), (), time.monotonic() - 31.0)
    assert experiment.step is Step.ANALYSE
    for name in ('_enter', '_report'):
        monkeypatch.setattr(node, name, lambda *_: None)
    monkeypatch.setattr(node, '_experiment', experiment)
    node._on_tick()
    (kept,) = json.loads((tmp_path / 'autonomous.json').read_text())
    assert (kept['trials'], kept['found']) == (1, None)
    assert kept['ending'] == 'the analysis failed'
    assert kept['reason'].startswith('waited 30 s for ')


def test_no_push_is_made_before_all_that_a_trial_needs_comes_in(node, monkeypatch):
    experiment = came_to(Step.RECORD)
    counts = Counter({WRENCH.name: 5, TOOL_HEIGHT.name: 5})
    recording = SimpleNamespace(opened=True, error=None, counts=counts)
    monkeypatch.setattr(node, '_recording', recording)
    node._on_recording(experiment, 0.0)
    assert experiment.step is Step.RECORD
    assert experiment.waiting_for.startswith('/range_sensor/points or ')
    counts[POINTS.name] += 1
    node._on_recording(experiment, 0.0)
    assert experiment.step is Step.START


@pytest.mark.parametrize(('step', 'lost'), [(0.0, False), (3600.0, True), (-1.0, True)])
def test_a_push_in_which_the_machines_clock_was_set_is_lost(node, monkeypatch, step, lost):
    experiment = came_to(Step.PUSH)
    steps = iter((0.0, step, 0.0))
    monkeypatch.setattr(node._clock_watch, 'step', lambda: next(steps))
    for _ in range(3):
        node._watch_clock(experiment, 0.0)
    assert (experiment.step is not Step.PUSH) == lost
    if lost:
        experiment.phase('aborted', 0.0)
        experiment.recorded('a', (), 0.0)
        (outcome,) = experiment.outcomes
        assert outcome.outcome is Outcome.ABORTED
        assert f'was set by {step:+.3g} s' in outcome.reason


def test_nodes_that_die_in_a_trial_are_told_with_its_outcome(node, monkeypatch, tmp_path):
    experiment = came_to(Step.PUSH)
    silent = []
    monkeypatch.setattr(node, '_roll_call', SimpleNamespace(silent=silent))
    monkeypatch.setattr(node, '_last_heard', {POINTS.name: 0.0, DISPLACEMENT_HEIGHT.name: 0.0})
    node._poll(experiment, 0.0)
    silent.append('rheology_fitter')
    node._poll(experiment, 0.0)
    silent.clear()
    node._poll(experiment, 0.0)
    assert experiment.step is Step.PUSH
    closed = {}
    recording = SimpleNamespace(
        closed=True,
        error=None,
        counts=Counter({topic.name: 5 for topic in (WRENCH, TOOL_HEIGHT, POINTS)}),
        path=tmp_path,
        close=lambda values, suffix: closed.update(values),
    )
    monkeypatch.setattr(node, '_recording', recording)
    experiment.phase('done', 0.0)
    node._finish(experiment, 0.0)
    assert closed['silent'] == 'rheology_fitter' and closed['outcome'] == 'complete'
    results = []
    monkeypatch.setattr(node, '_goal_id', lambda: 'a goal')
    monkeypatch.setattr(node, '_result_publisher', SimpleNamespace(publish=results.append))
    while not experiment.status.terminal:
        experiment.failed('that was all', 0.0)
    node._publish_result(experiment)
    assert values_from_status(results[0])['silent 1'] == 'rheology_fitter'


def test_a_clock_that_was_set_before_the_recording_is_no_matter(node, monkeypatch):
    """What is set from the first message in the bag on is, until the push begins too."""
    monkeypatch.setattr(node, '_goal_id', lambda: 'a goal')
    monkeypatch.setattr(
        'hapticvision_ros.nodes.experiment_orchestrator.Recording', lambda *args: None
    )
    set_by = 0
    watch = ClockWatch(lambda: time.monotonic_ns() + set_by, time.monotonic_ns)
    monkeypatch.setattr(node, '_clock_watch', watch)
    watch.step()
    set_by = 10**10
    node._enter(came_to(Step.RECORD), 0.0)
    monkeypatch.setattr(node, '_recording', None)
    experiment = came_to(Step.PUSH)
    node._watch_clock(experiment, 0.0)
    assert experiment.step is Step.PUSH
    set_by += 10**10
    node._watch_clock(experiment, 0.0)
    assert experiment.step is not Step.PUSH
    node._enter(came_to(Step.RECORD), 0.0)
    set_by += 10**10
    experiment = came_to(Step.PUSH)
    node._watch_clock(experiment, 0.0)
    assert experiment.step is not Step.PUSH


def test_a_push_in_which_the_range_sensor_fell_silent_is_incomplete(node, monkeypatch, tmp_path):
    experiment = came_to(Step.PUSH)
    limit = node.parameters.real('cloud_deadline')
    topics = (WRENCH, TOOL_HEIGHT, POINTS, DISPLACEMENT_HEIGHT)
    heard = {topic.name: 0.0 for topic in topics}
    monkeypatch.setattr(node, '_last_heard', heard)
    monkeypatch.setattr(node, '_unseen', 0.0)
    for now in np.arange(0.0, 1.2 * limit, 0.1):
        heard |= {WRENCH.name: now, TOOL_HEIGHT.name: now}
        node._watch_streams(experiment, float(now))
    heard[POINTS.name] = now
    node._watch_streams(experiment, float(now))
    experiment.phase('done', float(now))
    counts = Counter({topic.name: 5 for topic in topics})
    closed = []
    recording = SimpleNamespace(
        closed=True,
        error=None,
        counts=counts,
        path=tmp_path,
        close=lambda outcome, suffix: closed.append(suffix),
    )
    monkeypatch.setattr(node, '_recording', recording)
    node._finish(experiment, float(now))
    assert closed == ['_incomplete']
    (outcome,) = experiment.outcomes
    assert outcome.outcome is Outcome.INCOMPLETE
    assert 'nothing was received on /range_sensor/points' in outcome.reason
    assert 's of the push' in outcome.reason


def test_an_end_that_came_outside_of_a_tick_is_told(node, monkeypatch):
    experiment = came_to(Step.BRING_UP)
    experiment.forbidden('The emergency stop was pressed.', 0.0)
    experiment.done(0.0)
    assert experiment.status is GoalStatus.ABORTED
    told = []

    def report(each, now):
        told.append(each.status)
        monkeypatch.setattr(node, '_status', each.status)

    monkeypatch.setattr(node, '_experiment', experiment)
    monkeypatch.setattr(node, '_status', GoalStatus.EXECUTING)
    monkeypatch.setattr(node, '_report', report)
    node._on_tick()
    node._on_tick()
    assert told == [GoalStatus.ABORTED]


def answered(node, *, allow):
    """Return the answer of an orchestrator in the test process that is told to allow motion."""
    return node._on_enable(SetBool.Request(data=allow), SetBool.Response())


def start(node):
    """Return the answer to a goal of an orchestrator in the test process."""
    return node._on_start(Trigger.Request(), Trigger.Response())


@pytest.fixture
def ready(node, tmp_path):
    """Return an orchestrator in the test process whose goal is sound."""
    (output,) = node.set_parameters([Parameter('output_folder', value=str(tmp_path))])
    assert output.successful, output.reason
    return node


def test_motion_is_allowed_for_one_goal(ready):
    assert answered(ready, allow=True).success
    assert start(ready).success
    ready._experiment = None
    assert 'Nobody has allowed' in start(ready).message


def test_a_goal_that_is_refused_leaves_nothing_allowed(ready, tmp_path):
    assert answered(ready, allow=True).success
    ready.set_parameters([Parameter('output_folder', value='/proc/nowhere')])
    assert 'cannot be used for the bags' in start(ready).message
    ready.set_parameters([Parameter('output_folder', value=str(tmp_path))])
    assert 'Nobody has allowed' in start(ready).message


def test_motion_that_is_forbidden_cancels_the_goal(ready):
    assert answered(ready, allow=True).success
    assert start(ready).success
    running = answered(ready, allow=True)
    assert not running.success
    assert 'cancel it first' in running.message
    forbidden = answered(ready, allow=False)
    assert forbidden.success
    assert 'The running one ends' in forbidden.message
    assert ready._experiment.status is GoalStatus.CANCELING
    ready._experiment = None


def test_what_was_allowed_before_an_emergency_stop_is_not_allowed_after_it(ready):
    assert answered(ready, allow=True).success
    ready._on_emergency_stop(Bool(data=True))
    refused = answered(ready, allow=True)
    assert not refused.success
    assert 'emergency stop' in refused.message
    ready._on_emergency_stop(Bool(data=False))
    assert 'Nobody has allowed' in start(ready).message


@pytest.mark.parametrize('begun', [True, False])
def test_a_controller_that_was_deactivated_between_two_pushes_stays_so(node, monkeypatch, begun):
    inactive = SimpleNamespace(current_state=SimpleNamespace(id=State.PRIMARY_STATE_INACTIVE))
    asked = []
    call = SimpleNamespace(answer=lambda: inactive, drop=lambda: None)
    monkeypatch.setattr(node, '_change_arm', asked)
    monkeypatch.setattr(
        'hapticvision_ros.nodes.experiment_orchestrator._Call',
        lambda server, request: asked.append(server) or call,
    )
    experiment = came_to(Step.BRING_UP)
    if begun:
        bag = TrialOutcome(experiment.trial, Outcome.COMPLETE, 'a')
        experiment.outcomes.append(bag)
    node._enter(experiment, 0.0)
    node._bring_up(experiment, 0.0)
    assert (experiment.step is Step.DISABLE) == begun
    assert (asked[-1] is asked) != begun, 'whether its state was changed'
    monkeypatch.setattr(node, '_call', None)


@pytest.mark.parametrize(
    ('told', 'ends'), [(SHUT_DOWN, True), ('The push came to its end.', False)]
)
def test_a_controller_that_was_shut_down_between_two_pushes_is_not_allowed_again(
    node, monkeypatch, told, ends
):
    experiment = came_to(Step.BRING_UP)
    monkeypatch.setattr(node, '_experiment', experiment)
    node._on_push_report(DiagnosticStatus(message=told))
    assert (experiment.step is Step.END) == ends
    assert experiment.status.terminal is ends
    monkeypatch.setattr(node, '_experiment', None)


def test_an_arm_whose_services_are_not_found_any_more_is_asked_by_new_clients(node, monkeypatch):
    # As a client that keeps to a controller that was killed.
    stuck = SimpleNamespace(service_is_ready=lambda: False, service_name='get_state')
    made = [stuck]
    answer = SimpleNamespace(current_state=SimpleNamespace(id=ACTIVE))

    def connect():
        asked = SimpleNamespace(done=lambda: True, result=lambda: answer)
        made.append(
            SimpleNamespace(service_is_ready=lambda: True, call_async=lambda request: asked)
        )
        return made[-1]

    monkeypatch.setattr(node._arm_state, 'client', stuck)
    monkeypatch.setattr(node._arm_state, '_connect', connect)
    experiment = came_to(Step.BRING_UP)
    monkeypatch.setattr(node, '_experiment', experiment)
    node._enter(experiment, 0.0)
    now = time.monotonic()
    for later in (0.5 * PATIENCE, 1.1 * PATIENCE, 1.2 * PATIENCE):
        assert experiment.step is Step.BRING_UP
        monkeypatch.setattr(time, 'monotonic', partial(float, now + later))
        node._poll(experiment, later)
    assert experiment.step is Step.CHECK
    assert len(made) == 2


def client(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run the experiment client to its end."""
    command = [str(Path(sys.executable).with_name('experiment_client')), *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=START, check=False)


def test_a_folder_that_cannot_be_written_is_refused_at_once_to_the_client_of_a_cell(
    start_node, probe
):
    start_node('experiment_orchestrator', {'output_folder': '/proc/nowhere'}, '-r', '__ns:=/cell1')
    start, enable = (
        replace(service, name=f'/cell1{service.name}')
        for service in (START_EXPERIMENT, ENABLE_EXPERIMENT)
    )
    answer = probe.call(start, Trigger.Request(), START)
    assert not answer.success
    assert 'call /cell1/experiment/enable with true first' in answer.message
    assert probe.call(enable, SetBool.Request(data=True), START).success
    answer = probe.call(start, Trigger.Request(), START)
    assert not answer.success
    assert 'cannot be used for the bags' in answer.message
    done = client('--autonomous', '--budget-trials', '2', '--ros-args', '-r', '__ns:=/cell1')
    assert (done.returncode, done.stdout) == (2, '')
    assert 'cannot be used for the bags' in done.stderr
    assert done.stderr.count('\n') == 1


def test_the_client_refuses_arguments_that_ros_does_not_take():
    done = client('--ros-args', '-r', 'nonsense')
    assert done.returncode == 2
    assert 'error: ROS does not accept the arguments' in done.stderr
    assert 'Traceback' not in done.stderr


def test_an_arm_that_dies_in_mid_push_aborts_the_experiment_and_the_bag_is_kept(
    cell, probe, until
):
    # The last of these: the middleware takes the services of a controller that was killed for
    # alive for some time, and a request to them is lost.
    results, phases = probe.listen(EXPERIMENT_RESULT), probe.listen(PHASE)
    probe.set_parameters('experiment_orchestrator', {'service_deadline': 5.0, 'hold_time': 20.0})
    until(
        lambda: begin(probe).success or pytest.fail('refused'),
        'the goal',
        START,
    )
    until(
        lambda: any(item.data == 'hold' for item in phases) or results, 'the hold or an end', SLOW
    )
    assert not results, values_from_status(results[-1])
    cell['arm_push_controller'].stop(signal.SIGKILL)
    until(lambda: results, 'the result', SLOW)
    values = values_from_status(results[-1])
    assert values['status'] == 'ABORTED'
    assert '/arm/tool_height has been silent' in results[-1].message
    assert len(read_trial(Path(values['bag 1'])).force) > 10
