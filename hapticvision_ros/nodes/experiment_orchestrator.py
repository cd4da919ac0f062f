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
Run an experiment: a grid of pushes, then those that its analysis asks for, each to its own bag.

An action server on standard types: a goal is sent with ``/experiment/start`` (its content is the
node's parameters) once ``/experiment/enable`` has allowed its motion, ``/experiment/cancel`` ends
it, ``/experiment/status`` tells its state, ``/experiment/feedback`` its progress and
``/experiment/result`` how it ended. What happens when something fails is told in
`hapticvision_ros.core.experiment.Experiment`.
"""

from collections import defaultdict
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields, replace
from functools import partial
import json
from pathlib import Path
import threading
import time
from typing import Any, Final
import uuid

from action_msgs import msg as action
from action_msgs.srv import CancelGoal
from diagnostic_msgs.msg import DiagnosticStatus
from hapticvision_ros.bag.contract import (
    CANCEL_EXPERIMENT,
    DISPLACEMENT_HEIGHT,
    EMERGENCY_STOP,
    ENABLE,
    ENABLE_EXPERIMENT,
    EXPERIMENT_FEEDBACK,
    EXPERIMENT_RESULT,
    EXPERIMENT_STATUS,
    HEARTBEAT,
    PHASE,
    PLAN,
    POINTS,
    PUSH,
    PUSH_REPORT,
    Qos,
    RESET,
    RETRACT,
    Service,
    START_EXPERIMENT,
    STOP,
    TARE,
    TOOL_HEIGHT,
    TOPICS,
    WRENCH,
)
from hapticvision_ros.bag.writer import preload
from hapticvision_ros.core.autonomy import Budget, Cell, Decision, describe, Ending, Findings
from hapticvision_ros.core.clock_watch import ClockWatch
from hapticvision_ros.core.errors import DeviceError, HapticVisionError
from hapticvision_ros.core.experiment import (
    bag_prefix,
    Deadlines,
    Experiment,
    ExperimentGoal,
    GoalStatus,
    Outcome,
    RUNNING,
    Step,
)
from hapticvision_ros.core.push_control import (
    check_goal,
    DEACTIVATED,
    EMERGENCY,
    FORBIDDEN,
    hold_mode,
    HOLD_MODES,
    NO_PUSH,
    NOT_ALLOWED,
    PushGoal,
    PushLimits,
    SHUT_DOWN,
    STOPPED_BY_HAND,
    TAKEN_BACK,
)
from hapticvision_ros.nodes.campaign_analysis import CampaignAnalysis
from hapticvision_ros.nodes.conversions import (
    scalar_to_message,
    stamp_from_ns,
    status_to_message,
    values_from_status,
)
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Level, RollCall, SILENCE
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec, refuse_changes_while_pushing
from hapticvision_ros.nodes.qos import (
    create_client,
    create_publisher,
    create_service,
    create_subscription,
    relative_name,
)
from hapticvision_ros.nodes.recorder import (
    check_room,
    missing_topics,
    Recording,
    writable_folder,
)
from hapticvision_ros.nodes.runtime import CellNode, run
from hapticvision_ros.report.writing import write_whole
from hapticvision_ros.sim.devices import place_new_sample
from lifecycle_msgs.msg import State, Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.clock import Clock, ClockType
from rclpy.serialization import deserialize_message
from std_msgs.msg import String
from std_srvs.srv import SetBool, Trigger
from unique_identifier_msgs.msg import UUID

NAME: Final = 'experiment_orchestrator'
ARM_NODE: Final = 'arm_push_controller'

PARAMETERS: Final = (
    ParameterSpec('speeds', 'double_array', 'm/s', 'Push speeds of the grid.', 1e-5, 0.1),
    ParameterSpec('depths', 'double_array', 'm', 'Push depths of the grid.', 1e-5, 0.1),
    ParameterSpec('repeats', 'integer', '-', 'How often the grid is gone through.', 1, 1000),
    ParameterSpec('hold_time', 'double', 's', 'How long the tool holds its depth.', 0.1, 36000.0),
    ParameterSpec(
        'hold_mode',
        'string',
        '-',
        'Whether to hold for hold_time, or as long as the relaxation time asks for, up to that.',
        choices=HOLD_MODES,
    ),
    ParameterSpec(
        'recover_time', 'double', 's', 'How long the object is watched afterwards.', 0.1, 36000.0
    ),
    ParameterSpec(
        'rest_time', 'double', 's', 'Pause between trials, for a new sample.', 0.0, 36000.0
    ),
    ParameterSpec(
        'autonomous',
        'bool',
        '-',
        'Whether to go on after the grid with the pushes that the analysis of the bags asks for.',
    ),
    ParameterSpec(
        'budget_trials', 'integer', '-', 'How many such pushes may be made at most.', 1, 1000
    ),
    ParameterSpec(
        'budget_time',
        'double',
        's',
        'How long they may go on after the grid; 0 for no limit.',
        0.0,
        1e6,
    ),
    ParameterSpec(
        'precision',
        'double',
        '-',
        'Relative standard error that every parameter is to reach; 0 to stop as soon as the '
        'effect is decided.',
        0.0,
        1.0,
    ),
    ParameterSpec(
        'analysis_deadline',
        'double',
        's',
        'How long an analysis of the bags may take, without the compiling of its kernels.',
        1.0,
        36000.0,
    ),
    ParameterSpec('output_folder', 'string', '-', 'Folder for the bags; made if missing.'),
    ParameterSpec(
        'simulated_world_port',
        'integer',
        '-',
        'UDP port of the simulated world that gives each trial a new sample; 0 for a real cell.',
        0,
        65535,
        read_only=True,
    ),
    ParameterSpec(
        'service_deadline',
        'double',
        's',
        'How long the other nodes may take to answer.',
        0.5,
        600.0,
    ),
    ParameterSpec(
        'approach_deadline', 'double', 's', 'How long the tool may take to touch.', 0.5, 3600.0
    ),
    ParameterSpec(
        'push_margin',
        'double',
        's',
        'Added to the time that a push must take, before the arm is taken for dead.',
        0.5,
        3600.0,
    ),
    ParameterSpec(
        'stream_deadline',
        'double',
        's',
        'How long the load cell or the arm may be silent in a push.',
        0.1,
        60.0,
    ),
    ParameterSpec(
        'cloud_deadline',
        'double',
        's',
        'How long the range sensor may be silent in a push before its trial counts as incomplete.',
        0.1,
        3600.0,
    ),
    ParameterSpec(
        'max_failures',
        'integer',
        '-',
        'How many trials in a row may fail before the experiment is aborted.',
        1,
        1000,
    ),
    ParameterSpec(
        'feedback_period', 'double', 's', 'Longest time between two reports.', 0.05, 60.0
    ),
    ParameterSpec(
        'retry_period',
        'double',
        's',
        'Pause before a service that refuses to prepare a push is asked again.',
        0.05,
        60.0,
    ),
    ParameterSpec(
        'tick_period',
        'double',
        's',
        'Period of the work: taking messages and going on to the next step.',
        0.005,
        0.2,
        read_only=True,
    ),
    ParameterSpec(
        'write_buffer',
        'integer',
        'byte',
        'How much may wait for the disk.',
        1 << 20,
        1 << 32,
    ),
    ParameterSpec(
        'least_room',
        'integer',
        'byte',
        'With less room on the disk no goal is accepted and the running one is aborted.',
        0,
        1 << 44,
    ),
)

OTHERS: Final = (
    ARM_NODE,
    'load_cell_driver',
    'range_sensor_driver',
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
)
"""The other nodes of a cell: which of them died in a trial is told with its outcome."""
HEARTBEAT_PERIOD: Final = 0.1
"""Time between two heartbeats, on which the arm's controller relies [s]."""
PATIENCE: Final = 2.0
"""Time after which a request that is not answered is sent again [s]."""
PLAN_PATIENCE: Final = 8.0
"""The same for the planner, which waits for clouds [s]."""
ROOM_PERIOD: Final = 1.0
"""Time between two looks at the room on the disk [s]."""
REPORT_PATIENCE: Final = 0.5
"""How long the arm's report on an aborted push is waited for [s]."""
ACTIVE: Final = State.PRIMARY_STATE_ACTIVE
_BRING_UP: Final = {
    State.PRIMARY_STATE_UNCONFIGURED: Transition.TRANSITION_CONFIGURE,
    State.PRIMARY_STATE_INACTIVE: Transition.TRANSITION_ACTIVATE,
}
_LIMITS: Final = tuple(item.name for item in fields(PushLimits))
_GOAL: Final = tuple(
    item.name for item in fields(PushGoal) if item.name not in ('surface_height', 'hold_mode')
)
"""The numbers of the arm's controller that are asked for to check a goal."""
DECISIONS: Final = 'autonomous.json'
"""File beside the bags in which each analysis and what it led to is kept."""
_CLOSE_TIMEOUT: Final = 3.0
_STOPPED: Final = 'the orchestrator was stopped'
_LEVELS: Final = {
    GoalStatus.SUCCEEDED: DiagnosticStatus.OK,
    GoalStatus.CANCELED: DiagnosticStatus.WARN,
    GoalStatus.ABORTED: DiagnosticStatus.ERROR,
}


class _Server:
    """
    A service of another node, and the client to it.

    Parameters
    ----------
    node : Node
        Whose client it is.
    connect : callable
        Makes a client.

    """

    def __init__(self, node: Any, connect: Callable[[], Any]) -> None:
        self._node = node
        self._connect = connect
        self.client = connect()

    def connect_anew(self, trouble: str) -> None:
        """Take a new client: one may be stuck with a server that was killed."""
        self._node.get_logger().warning(
            f'{self.client.service_name}: {trouble}: asked anew, by a new client'
        )
        self._node.destroy_client(self.client)
        self.client = self._connect()


class _Call:
    """
    One request to a service: waits for the server, sends, and holds the answer.

    A server that was killed still seems to be there for a while, and that of the node that takes
    its place may not be found: after `patience` [s] without a server or an answer a new client
    begins anew.
    """

    def __init__(self, server: _Server, request: Any, patience: float = PATIENCE) -> None:
        self._server = server
        self._request = request
        self._patience = patience
        self._since = time.monotonic()
        self._future: Any = None

    def answer(self) -> Any:
        """Return the answer, or None while there is none."""
        if self._future is None and self._server.client.service_is_ready():
            self._future = self._server.client.call_async(self._request)
            self._since = time.monotonic()
        if self._future is not None and self._future.done():
            return self._future.result()
        if time.monotonic() - self._since > self._patience:
            self.drop()
            self._server.connect_anew('not found' if self._future is None else 'no answer')
            self._future = None
            self._since = time.monotonic()
        return None

    def drop(self) -> None:
        """Forget a request whose answer is no longer waited for."""
        if self._future is not None and not self._future.done():
            self._server.client.remove_pending_request(self._future)


class _NewSample:
    """Puts a new sample into the simulated cell, in a thread, since that may take its time."""

    def __init__(self, port: int, timeout: float, stopping: threading.Event) -> None:
        self.error: str | None = None
        self._args = (port, time.monotonic() + timeout, stopping)
        self._thread = threading.Thread(target=self._place, name='new sample', daemon=True)
        self._thread.start()

    @property
    def over(self) -> bool:
        """Whether it is done, or has failed for good."""
        return not self._thread.is_alive()

    def _place(self) -> None:
        port, deadline, stopping = self._args
        while True:
            try:
                place_new_sample(port)
            except DeviceError as error:
                # The tool may still be on its way up from an aborted push.
                if time.monotonic() < deadline and not stopping.wait(0.2):
                    continue
                self.error = str(error)
            return


class ExperimentOrchestrator(CellNode):
    """
    The node.

    Its thread never waits: a timer takes the messages, asks the answers of the running request,
    and carries out the step that the experiment's state machine names.
    """

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        self._experiment: Experiment | None = None
        self._goal_info: Any = None
        self._folder = Path()
        self._recording: Recording | None = None
        self._call: _Call | None = None
        self._asked: tuple[Service, Any] = (STOP, None)
        self._owed: tuple[Service, Any] | None = None
        self._emergency = False
        self._allowed = False
        self._ask_again_at = 0.0
        self._sample: _NewSample | None = None
        self._cell: Cell | None = None
        self._analysis: CampaignAnalysis | None = None
        self._decisions: list[dict[str, Any]] = []
        self._kept: Decision | None = None
        self._carried_out: tuple[Step, float] | None = None
        self._last_heard: dict[str, float] = {}
        self._clock_watch = ClockWatch(time.time_ns, time.monotonic_ns)
        self._unseen = 0.0
        self._silent: defaultdict[int, set[str]] = defaultdict(set)
        self._reported = 0.0
        self._status: GoalStatus | None = None

        self._intakes = {topic: Intake.of(self, topic, raw=True) for topic in TOPICS}
        self._servers = {
            service.name: _Server(self, partial(create_client, self, service))
            for service in (PLAN, TARE, ENABLE, PUSH, STOP, RETRACT, RESET)
        }
        self._configure, self._limits, self._arm_state, self._change_arm = (
            _Server(self, partial(self.create_client, kind, f'{ARM_NODE}/{name}'))
            for kind, name in (
                (SetParameters, 'set_parameters'),
                (GetParameters, 'get_parameters'),
                (GetState, 'get_state'),
                (ChangeState, 'change_state'),
            )
        )
        self._changing = self._brought_up = False
        self._room_seen = 0.0
        self._push_report: Any = None
        create_subscription(self, PUSH_REPORT, self._on_push_report)
        # As the arm's controller hears it: what was said before, and publishers of any kind.
        for topic in (EMERGENCY_STOP, replace(EMERGENCY_STOP, qos=Qos())):
            create_subscription(self, topic, self._on_emergency_stop)
        self._began = time.monotonic()
        self._beaten = 0.0
        self._heartbeat = create_publisher(self, HEARTBEAT)
        self._status_publisher = create_publisher(self, EXPERIMENT_STATUS)
        self._feedback_publisher = create_publisher(self, EXPERIMENT_FEEDBACK)
        self._result_publisher = create_publisher(self, EXPERIMENT_RESULT)
        refuse_changes_while_pushing(self, PHASE)
        create_service(self, ENABLE_EXPERIMENT, self._on_enable)
        create_service(self, START_EXPERIMENT, self._on_start)
        create_service(self, CANCEL_EXPERIMENT, self._on_cancel)
        self._roll_call = RollCall(self, OTHERS)
        self._complete = False
        diagnostics = Diagnostics(self)
        diagnostics.add('experiment', self._find_experiment)
        diagnostics.add('recording', self._find_recording)
        self._status_publisher.publish(action.GoalStatusArray())
        self.spawn(preload, 'preload')
        # Deadlines count real seconds, also where the other nodes follow a simulated clock.
        self.create_timer(
            self.parameters.real('tick_period'),
            self._on_tick,
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def close(self) -> None:
        """Stop a running push, finish its bag, and tell how the experiment ended."""
        experiment = self._experiment
        if experiment is not None and not experiment.status.terminal:
            experiment.failed(_STOPPED, time.monotonic())
            end = time.monotonic() + _CLOSE_TIMEOUT
            while not experiment.status.terminal and time.monotonic() < end:
                self.executor.spin_once(timeout_sec=0.1)
            self._give_up(experiment)
            if experiment.status is not self._status:
                self._report(experiment, time.monotonic())
        self._drop_analysis()
        super().close()

    def _give_up(self, experiment: Experiment) -> None:
        """End an experiment whose other nodes have gone too."""
        recording = self._recording
        if recording is not None:
            recording.close({'outcome': Outcome.ABORTED.value}, f'_{Outcome.ABORTED.value}')
            recording.join(_CLOSE_TIMEOUT)
        while not experiment.status.terminal:
            now = time.monotonic()
            if experiment.step is Step.FINISH:
                self._finish(experiment, now)
            experiment.failed(_STOPPED, now)
            self._report(experiment, now)

    # -- the action's services ------------------------------------------------------------------

    def _on_enable(self, request: Any, response: Any) -> Any:
        """Allow one goal, or forbid the next and end a running one."""
        experiment = self._experiment
        running = experiment is not None and not experiment.status.terminal
        self._allowed = False
        response.success = not request.data
        if not request.data:
            response.message = 'The next goal may not move the arm.'
            if experiment is not None and experiment.cancel(time.monotonic()):
                self.get_logger().info(f'goal {self._goal_id()}: motion is forbidden')
                self._publish_status()
            if running:
                response.message += ' The running one ends: a tool that may be low retracts first.'
        elif running:
            response.message = f'goal {self._goal_id()} {RUNNING}'
        elif self._emergency:
            response.message = EMERGENCY
        else:
            self._allowed = response.success = True
            response.message = 'The next goal may move the arm.'
        return response

    def _on_start(self, request: Any, response: Any) -> Any:
        """Accept or refuse a goal."""
        response.success = False
        if self._experiment is not None and not self._experiment.status.terminal:
            response.message = f'goal {self._goal_id()} {RUNNING}'
            return response
        if self._emergency:
            # Else the arm would move on its own as soon as the stop is released.
            response.message = EMERGENCY
            return response
        if not self._allowed:
            enable = self.resolve_service_name(relative_name(ENABLE_EXPERIMENT.name))
            response.message = (
                f'Nobody has allowed the arm to move: call {enable} with true first; it holds '
                'for one start.'
            )
            return response
        # Also where the goal is refused below: who repairs it allows the motion anew.
        self._allowed = False
        values = self.parameters
        try:
            goal = ExperimentGoal(
                push_speeds=values.reals('speeds'),
                depths=values.reals('depths'),
                repeats=values.integer('repeats'),
                hold_time=values.real('hold_time'),
                recover_time=values.real('recover_time'),
                rest_time=values.real('rest_time'),
                hold_mode=values.text('hold_mode'),
                budget=self._budget(),
            )
            names = [trial.name for trial in goal.trials()]
            if goal.budget is not None:
                chosen = range(len(names) + 1, len(names) + 1 + goal.budget.trials)
                names += [*(bag_prefix(number) for number in chosen), DECISIONS]
            self._folder = writable_folder(values.text('output_folder'), names)
            check_room(self._folder, values.integer('least_room'))
        except HapticVisionError as error:
            response.message = str(error)
            return response
        deadlines = Deadlines(
            service=values.real('service_deadline'),
            approach=values.real('approach_deadline'),
            margin=values.real('push_margin'),
            analysis=values.real('analysis_deadline'),
        )
        self._experiment = Experiment(
            goal, deadlines, values.integer('max_failures'), time.monotonic()
        )
        self._goal_info = action.GoalInfo(
            goal_id=UUID(uuid=list(uuid.uuid4().bytes)), stamp=stamp_from_ns(time.time_ns())
        )
        self._carried_out = None
        self._decisions, self._kept = [], None
        self._silent.clear()
        self._roll_call.begin()
        self._publish_status()
        self.get_logger().info(
            f'goal {self._goal_id()}: {len(goal.trials())} trials to {self._folder}'
        )
        response.success = True
        response.message = self._goal_id()
        return response

    def _budget(self) -> Budget | None:
        """Return how long a goal may go on after its grid, as the parameters have it."""
        values = self.parameters
        if not values.flag('autonomous'):
            return None
        return Budget(
            trials=values.integer('budget_trials'),
            time=values.real('budget_time'),
            precision=values.real('precision'),
        )

    def _on_cancel(self, request: Any, response: Any) -> Any:
        """Cancel the goal that the request names, by the rules of an action server."""
        wanted = bytes(request.goal_info.goal_id.uuid)
        stamp = request.goal_info.stamp
        experiment = self._experiment
        named = any(wanted)
        mine = bytes(self._goal_info.goal_id.uuid) if experiment is not None else b''
        if named and wanted != mine:
            response.return_code = CancelGoal.Response.ERROR_UNKNOWN_GOAL_ID
            return response
        if experiment is None or experiment.status.terminal:
            response.return_code = (
                CancelGoal.Response.ERROR_GOAL_TERMINATED
                if named
                else CancelGoal.Response.ERROR_REJECTED
            )
            return response
        accepted = self._goal_info.stamp
        timed = (stamp.sec, stamp.nanosec) != (0, 0)
        later = (accepted.sec, accepted.nanosec) > (stamp.sec, stamp.nanosec)
        if (timed and later and not named) or not experiment.cancel(time.monotonic()):
            response.return_code = CancelGoal.Response.ERROR_REJECTED
            return response
        self.get_logger().info(f'goal {self._goal_id()}: cancel requested')
        response.return_code = CancelGoal.Response.ERROR_NONE
        response.goals_canceling = [self._goal_info]
        self._publish_status()
        return response

    # -- the work -------------------------------------------------------------------------------

    def _on_tick(self) -> None:
        """Take what has come, and go on."""
        now = time.monotonic()
        # From here and not from a thread: it tells that the work goes on.
        if now - self._beaten >= HEARTBEAT_PERIOD:
            self._beaten = now
            self._heartbeat.publish(scalar_to_message(now - self._began))
        self._take(now)
        if not self._complete and self._roll_call.complete:
            self._complete = True
            self.get_logger().info('all nodes of the cell are there: ready for an experiment')
        experiment = self._experiment
        if experiment is None:
            return
        if experiment.step is Step.END and experiment.status is self._status:
            # Told as well; it may have come to its end outside of a tick.
            return
        experiment.begin(now)
        # One tick may go through several steps: none of them waits.
        for _ in Step:
            entered = (experiment.step, experiment.entered)
            if entered != self._carried_out:
                self._carried_out = entered
                self._drop_call()
                self._drop_analysis()
                self._enter(experiment, now)
            self._poll(experiment, now)
            if (experiment.step, experiment.entered) == entered:
                break
        experiment.tick(now)
        self._keep(experiment)
        self._report(experiment, now)

    def _take(self, now: float) -> None:
        """Empty the queues into the bag, and tell the experiment the arm's phase."""
        for topic, intake in self._intakes.items():
            for data, sent_ns, received_ns in intake.take():
                self._last_heard[topic.name] = now
                if topic is PHASE and self._experiment is not None:
                    self._experiment.phase(deserialize_message(data, String).data, now)
                if self._recording is not None:
                    self._recording.write(topic, data, received_ns, sent_ns)

    def _enter(self, experiment: Experiment, now: float) -> None:
        """Begin a step."""
        trial, goal = experiment.trial, experiment.goal
        match experiment.step:
            case Step.BRING_UP:
                self._brought_up = False
                self._look_at_arm(experiment)
            case Step.CHECK:
                if not experiment.outcomes or trial.reason:
                    experiment.waiting_for = f'the parameters of {ARM_NODE}'
                    request = GetParameters.Request(names=[*_LIMITS, *_GOAL])
                    self._call = _Call(self._limits, request)
            case Step.RETRACT:
                if experiment.shaken:
                    self._ask(RETRACT, Trigger.Request())
            case Step.SAMPLE:
                self.get_logger().info(
                    f'{trial.name}: trial {trial.number} of {len(experiment.trials)}'
                )
                port = self.parameters.integer('simulated_world_port')
                self._sample = None
                if port:
                    timeout = self.parameters.real('service_deadline')
                    self._sample = _NewSample(port, timeout, self.stopping)
            case Step.PLAN:
                self._ask(PLAN, Trigger.Request(), PLAN_PATIENCE)
            case Step.TARE:
                self._ask(TARE, Trigger.Request())
            case Step.CONFIGURE:
                values: dict[str, float | str] = {
                    'hold_mode': trial.hold_mode,
                    'push_speed': trial.push_speed,
                    'depth': trial.depth,
                    'hold_time': trial.hold_time,
                    'recover_time': goal.recover_time,
                }
                experiment.waiting_for = f'the parameters of {ARM_NODE}'
                self._call = _Call(self._configure, _set_request(values))
            case Step.ENABLE:
                # Whoever starts a goal allows its motion. Later it is not allowed again: somebody
                # may have forbidden it meanwhile.
                if not experiment.outcomes:
                    self._ask(ENABLE, SetBool.Request(data=True))
            case Step.RECORD:
                experiment.waiting_for = 'the bag to be opened'
                self._unseen = 0.0
                # What was set since the last push is of no matter, what is set from here on is.
                self._clock_watch.forget()
                self._clock_watch.step()
                self._recording = Recording(
                    self._folder / trial.name,
                    {
                        'source': NAME,
                        'goal_id': self._goal_id(),
                        'trial': str(trial.number),
                        'repeat': str(trial.repeat),
                        'commanded_push_speed_m_s': repr(trial.push_speed),
                        'commanded_depth_m': repr(trial.depth),
                        'commanded_hold_time_s': repr(trial.hold_time),
                        'commanded_hold_mode': trial.hold_mode,
                        'commanded_recover_time_s': repr(goal.recover_time),
                        **({'chosen_because': trial.reason} if trial.reason else {}),
                    },
                    self.parameters.integer('write_buffer'),
                )
                # The fitter works on what is recorded, no more; without one there is only a bag.
                fitter = self._servers[RESET.name].client
                if fitter.service_is_ready():
                    fitter.call_async(Trigger.Request())
            case Step.START:
                self._push_report = None
                watched = (WRENCH, TOOL_HEIGHT, POINTS, DISPLACEMENT_HEIGHT)
                self._last_heard = dict.fromkeys((topic.name for topic in watched), now)
                self._ask(PUSH, Trigger.Request())
            case Step.STOP:
                self._ask(STOP, Trigger.Request())
            case Step.ANALYSE:
                self._analyse(experiment)
            case Step.DISABLE:
                self._ask(ENABLE, SetBool.Request(data=False))

    def _poll(self, experiment: Experiment, now: float) -> None:
        """See whether a step has come to its end."""
        match experiment.step:
            case Step.SAMPLE:
                if self._sample is None or self._sample.over:
                    if self._sample is not None and self._sample.error:
                        experiment.failed(self._sample.error, now)
                    else:
                        experiment.done(now)
            case Step.BRING_UP:
                self._bring_up(experiment, now)
            case Step.CHECK:
                self._check_limits(experiment, now)
            case Step.ENABLE if experiment.outcomes:
                experiment.done(now)
            case Step.RETRACT if not experiment.shaken:
                experiment.done(now)
            case Step.PLAN | Step.TARE | Step.ENABLE | Step.RETRACT:
                self._prepare(experiment, now, experiment.done)
            case Step.CONFIGURE:
                self._on_configured(experiment, now)
            case Step.RECORD:
                self._on_recording(experiment, now)
            case Step.START:
                self._prepare(experiment, now, experiment.started)
                self._watch_disk(experiment, now)
            case Step.PUSH:
                self._watch_disk(experiment, now)
                self._watch_others(experiment)
                if experiment.step is Step.PUSH:
                    self._watch_streams(experiment, now)
                if experiment.step is Step.PUSH:
                    self._watch_clock(experiment, now)
            case Step.STOP:
                # An arm that was moving tells by its phase when it has come back.
                if experiment.arm_phase in (None, 'done', 'aborted'):
                    self._on_answer(experiment, now, experiment.done)
                elif (
                    self._call is not None
                    and (answer := self._call.answer()) is not None
                    and answer.message == NO_PUSH
                ):
                    # It has been started anew since, and knows of no push.
                    experiment.done(now)
            case Step.FINISH:
                self._finish(experiment, now)
            case Step.ANALYSE:
                self._on_analysis(experiment, now)
            case Step.DISABLE:
                self._on_answer(experiment, now, experiment.done)

    def _ask(self, service: Service, request: Any, patience: float = PATIENCE) -> None:
        """Begin a request; `_on_answer` sees to its end."""
        assert self._experiment is not None
        self._experiment.waiting_for = f'an answer of {service.name}: see whether its node runs'
        self._call = _Call(self._servers[service.name], request, patience)
        self._asked, self._owed = (service, request), None

    def _look_at_arm(self, experiment: Experiment) -> None:
        experiment.waiting_for = f'{ARM_NODE}: see whether it runs'
        self._changing = False
        self._call = _Call(self._arm_state, GetState.Request())

    def _bring_up(self, experiment: Experiment, now: float) -> None:
        """Configure and activate the arm's controller unless it is active."""
        if self._call is None:
            if now >= self._ask_again_at:
                self._look_at_arm(experiment)
            return
        answer = self._call.answer()
        if answer is None:
            return
        self._drop_call()
        if self._changing:
            if not answer.success:
                self._ask_again_at = now + self.parameters.real('retry_period')
                return
            self._look_at_arm(experiment)
        elif answer.current_state.id == ACTIVE:
            experiment.done(now)
        elif (
            answer.current_state.id == State.PRIMARY_STATE_INACTIVE
            and experiment.outcomes
            and not self._brought_up
        ):
            # It was active, and one that was started anew begins with being configured.
            experiment.forbidden(f'{FORBIDDEN}{DEACTIVATED}', now)
        elif answer.current_state.id in _BRING_UP:
            self._brought_up = True
            request = ChangeState.Request()
            request.transition.id = _BRING_UP[answer.current_state.id]
            experiment.waiting_for = f'{ARM_NODE} to become active: see its messages'
            self._changing = True
            self._call = _Call(self._change_arm, request)

    def _check_limits(self, experiment: Experiment, now: float) -> None:
        """Refuse a goal that the cell does not allow, before anything moves."""
        if self._call is None:
            experiment.done(now)
            return
        answer = self._call.answer()
        if answer is None:
            return
        names = (*_LIMITS, *_GOAL)
        numbers = {
            name: value.double_value for name, value in zip(names, answer.values, strict=True)
        }
        limits = PushLimits(**{name: numbers[name] for name in _LIMITS})
        goal = experiment.goal
        try:
            for trial in experiment.trials:
                if trial.number < experiment.trial.number:
                    continue
                asked = {
                    'push_speed': trial.push_speed,
                    'depth': trial.depth,
                    'hold_time': trial.hold_time,
                    'recover_time': goal.recover_time,
                }
                push = PushGoal(
                    **{name: numbers[name] for name in _GOAL} | asked,
                    hold_mode=hold_mode(trial.hold_mode),
                )
                self._cell = Cell(
                    limits,
                    push,
                    slowest=min(goal.push_speeds),
                    fastest=max(goal.push_speeds),
                    deepest=max(goal.depths),
                    longest_hold=goal.hold_time,
                )
                check_goal(push, limits, limits.highest_height)
        except HapticVisionError as error:
            experiment.failed(f'{trial.name}: {error}', now)
            return
        experiment.done(now)

    def _analyse(self, experiment: Experiment) -> None:
        """Begin to analyse the bags so far."""
        assert self._cell is not None
        # One that somebody has taken away is left out there, and the others keep their places.
        bags = [Path(item.bag or self._folder / item.trial.name) for item in experiment.complete]
        experiment.waiting_for = 'the analysis of the bags so far'
        self._analysis = CampaignAnalysis(bags, self._cell)
        self.get_logger().info(f'analysing {len(bags)} trials')

    def _on_analysis(self, experiment: Experiment, now: float) -> None:
        """Go on with what the analysis has found, once it has."""
        analysis = self._analysis
        if analysis is None:
            return
        experiment.held_up = analysis.compiled
        if not analysis.over:
            return
        if analysis.findings is None:
            experiment.analysis_failed(analysis.error, now)
        else:
            experiment.found(analysis.findings, now)
            self.get_logger().info(f'found: {analysis.findings.sentence}')

    def _keep(self, experiment: Experiment) -> None:
        """Tell a new decision, and write beside the bags what was found and what it led to."""
        decision = experiment.decision
        if decision is None or decision is self._kept:
            return
        self._kept = decision
        if decision.push is not None:
            said = f'next: {describe(decision.push)}: {decision.reason}'
        else:
            assert decision.ending is not None
            said = f'{decision.ending.value}: {decision.reason}'
        self.get_logger().info(said)
        findings = None if decision.ending is Ending.FAILED else experiment.findings
        self._decisions.append(
            {
                'trials': len(experiment.complete),
                'found': None if findings is None else findings.document(),
                'ending': None if decision.ending is None else decision.ending.value,
                'push': None if decision.push is None else asdict(decision.push),
                'reason': decision.reason,
            }
        )
        text = json.dumps(self._decisions, indent=2) + '\n'
        try:
            write_whole(self._folder, [(DECISIONS, text.encode())])
        except OSError as error:
            path = self._folder / DECISIONS
            self.get_logger().warning(f'{path} cannot be written: {error.strerror}')

    def _drop_analysis(self) -> None:
        if self._analysis is not None:
            self._analysis.drop()
            self._analysis = None

    def _on_push_report(self, message: Any) -> None:
        self._push_report = message
        if message.message == SHUT_DOWN and self._experiment is not None:
            self._experiment.forbidden(SHUT_DOWN, time.monotonic(), gone=True)

    def _on_emergency_stop(self, message: Any) -> None:
        self._emergency = bool(message.data)
        self._allowed = self._allowed and not self._emergency
        if self._emergency and self._experiment is not None:
            self._experiment.forbidden(STOPPED_BY_HAND, time.monotonic())

    def _drop_call(self) -> None:
        if self._call is not None:
            self._call.drop()
            self._call = None

    def _on_answer(
        self, experiment: Experiment, now: float, then: Callable[[float], None]
    ) -> None:
        """Go on when the running request has been answered."""
        answer = self._call.answer() if self._call is not None else None
        if answer is None:
            return
        if answer.success:
            then(now)
        else:
            step = experiment.step.name.lower()
            experiment.failed(f'{experiment.trial.name}: {step} refused: {answer.message}', now)

    def _prepare(self, experiment: Experiment, now: float, then: Callable[[float], None]) -> None:
        """Go on when a service agrees; ask one that refuses again, since it may just start."""
        service, request = self._asked
        if self._call is None:
            if now >= self._ask_again_at:
                self._call = _Call(self._servers[service.name], request)
            return
        answer = self._call.answer()
        if answer is None:
            return
        if answer.success and self._owed is not None:
            self._ask(*self._owed)
            return
        if answer.success:
            then(now)
            return
        if answer.message == EMERGENCY or answer.message.startswith(FORBIDDEN):
            # Whoever has forbidden it, or releases the stop, sees to the tool.
            experiment.forbidden(answer.message, now)
            return
        if answer.message == NOT_ALLOWED and service in (RETRACT, PUSH):
            # The controller has been started anew: what was allowed to the one before it goes on.
            owed = self._asked
            self._ask(ENABLE, SetBool.Request(data=True))
            self._owed = owed
            return
        self._drop_call()
        self._ask_again_at = now + self.parameters.real('retry_period')
        experiment.waiting_for = f'{service.name}, which refuses: {answer.message}'

    def _on_configured(self, experiment: Experiment, now: float) -> None:
        answer = self._call.answer() if self._call is not None else None
        if answer is None:
            return
        refusals = [result.reason for result in answer.results if not result.successful]
        if refusals:
            experiment.failed(f'{experiment.trial.name}: {" ".join(dict.fromkeys(refusals))}', now)
        else:
            experiment.done(now)

    def _on_recording(self, experiment: Experiment, now: float) -> None:
        """Go on when the bag is open and all that a trial needs comes in."""
        assert self._recording is not None
        self._watch_disk(experiment, now)
        if experiment.step is Step.RECORD and self._recording.opened:
            silent = missing_topics(self._recording.counts)
            if silent:
                experiment.waiting_for = f'{" and ".join(silent)}: see whether the drivers run'
            else:
                experiment.done(now)

    def _watch_disk(self, experiment: Experiment, now: float) -> None:
        if self._recording is not None and self._recording.error is not None:
            experiment.failed(self._recording.error, now)
        elif now - self._room_seen >= ROOM_PERIOD:
            self._room_seen = now
            try:
                check_room(self._folder, self.parameters.integer('least_room'))
            except HapticVisionError as error:
                experiment.failed(str(error), now)

    def _watch_streams(self, experiment: Experiment, now: float) -> None:
        """Take a driver that has fallen silent for dead; the arm does not rely on what is seen."""
        seen = max(self._last_heard[topic.name] for topic in (POINTS, DISPLACEMENT_HEIGHT))
        self._unseen = max(self._unseen, now - seen)
        limit = self.parameters.real('stream_deadline')
        for name, heard in self._last_heard.items():
            if name in (WRENCH.name, TOOL_HEIGHT.name) and now - heard > limit:
                experiment.lost(
                    f'{experiment.trial.name}: {name} has been silent for {limit:g} s: see '
                    'whether its node runs',
                    now,
                )
                return

    def _watch_others(self, experiment: Experiment) -> None:
        """Take note of nodes that have died, also those that have no part in a push."""
        number = experiment.trial.number
        for name in set(self._roll_call.silent) - self._silent[number]:
            self._silent[number].add(name)
            self.get_logger().warning(
                f'{experiment.trial.name}: {name} has told nothing of itself for {SILENCE:g} s: '
                'see whether it runs.'
            )

    def _watch_clock(self, experiment: Experiment, now: float) -> None:
        """Take a trial for lost in which the machine's clock was set: its stamps do not agree."""
        step = self._clock_watch.step()
        if step:
            experiment.lost(
                f'{experiment.trial.name}: the clock of this machine was set by '
                f'{step:+.3g} s in the trial: let it follow its source slowly, as chrony '
                'does, or set it between experiments',
                now,
            )

    def _finish(self, experiment: Experiment, now: float) -> None:
        """Close the bag once all that belongs to the trial is in it, and judge it."""
        recording = self._recording
        if recording is None:
            experiment.recorded(None, (), now)
            return
        report = self._push_report
        if (
            experiment.arm_phase == 'aborted'
            and report is None
            and not recording.closed
            and now - experiment.entered < REPORT_PATIENCE
        ):
            return
        if report is not None:
            experiment.explain(report.message)
            if report.message in TAKEN_BACK:
                experiment.forbidden(report.message, now)
        missing = missing_topics(recording.counts)
        if self._unseen > self.parameters.real('cloud_deadline'):
            seen = f'{POINTS.name} or {DISPLACEMENT_HEIGHT.name}'
            missing.append(f'{seen} for {self._unseen:.1f} s of the push')
        usable = not (missing or experiment.failing or recording.error)
        outcome = Outcome.COMPLETE if usable else Outcome.INCOMPLETE
        if experiment.failing or recording.error:
            outcome = Outcome.ABORTED
        suffix = '' if usable else f'_{outcome.value}'
        told = {} if report is None else values_from_status(report)
        if report is not None and experiment.failing:
            told['reason'] = report.message
        silent = ', '.join(sorted(self._silent[experiment.trial.number]))
        values = {'outcome': outcome.value, 'missing': ', '.join(missing), 'silent': silent}
        recording.close(values | told, suffix)
        if not recording.closed:
            experiment.waiting_for = f'{recording.path} to be closed'
            return
        self._recording = None
        if recording.error:
            experiment.failed(recording.error, now)
        bag = str(recording.path) if recording.path.exists() else None
        experiment.recorded(bag, missing, now)
        self.get_logger().info(
            f'{bag}: {outcome.value}, {sum(recording.counts.values())} messages'
        )

    # -- what is told ---------------------------------------------------------------------------

    def _find_experiment(self) -> Finding:
        """Return how the experiment goes."""
        experiment = self._experiment
        if experiment is None:
            return Finding(Level.OK, 'No goal yet.')
        failed = sum(item.outcome is not Outcome.COMPLETE for item in experiment.outcomes)
        values: dict[str, object] = {
            'status': experiment.status.name,
            'step': experiment.step.name.lower(),
            'trial': experiment.trial.number,
            'trials': len(experiment.trials),
            'trials that failed': failed,
            'waiting for': experiment.waiting_for,
        }
        if experiment.status is GoalStatus.ABORTED:
            return Finding(Level.ERROR, f'The goal was aborted: {experiment.reason}', values)
        if failed:
            return Finding(Level.WARN, f'{failed} trials are of no use.', values)
        return Finding(Level.OK, 'The goal goes on, or has come to its end.', values)

    def _find_recording(self) -> Finding:
        """Return how the recording goes."""
        recording = self._recording
        if recording is None:
            return Finding(Level.OK, 'Nothing is being recorded.')
        values: dict[str, object] = {'bag': recording.path, **recording.counts}
        if recording.error is not None:
            return Finding(Level.ERROR, recording.error, values)
        return Finding(Level.OK, 'A trial is being recorded.', values)

    def _report(self, experiment: Experiment, now: float) -> None:
        """Publish status and result on change, feedback with each step and once a period."""
        changed = experiment.status is not self._status
        if changed:
            self._publish_status()
        if experiment.status.terminal:
            self._publish_feedback(experiment, now)
            self._publish_result(experiment)
        elif (
            changed
            or experiment.entered > self._reported
            or now - self._reported >= self.parameters.real('feedback_period')
        ):
            self._publish_feedback(experiment, now)

    def _goal_id(self) -> str:
        return uuid.UUID(bytes=bytes(self._goal_info.goal_id.uuid)).hex

    def _publish_status(self) -> None:
        assert self._experiment is not None
        self._status = self._experiment.status
        status = action.GoalStatus(goal_info=self._goal_info, status=int(self._status))
        self._status_publisher.publish(action.GoalStatusArray(status_list=[status]))

    def _publish_feedback(self, experiment: Experiment, now: float) -> None:
        self._reported = now
        trial = experiment.trial
        step = experiment.step.name.lower()
        pushing = experiment.step is Step.PUSH and experiment.arm_phase is not None
        values = {
            'goal_id': self._goal_id(),
            'trial': str(trial.number),
            'trials': str(len(experiment.trials)),
            'name': trial.name,
            'step': step,
            'phase': str(experiment.arm_phase) if pushing else '',
            'time_left_s': f'{experiment.time_left(now):.1f}',
        }
        if experiment.goal.budget is not None:
            findings, analysis = experiment.findings, self._analysis
            values |= {
                'doing': '' if analysis is None else analysis.doing,
                'found': '' if findings is None else findings.sentence,
                'chosen because': trial.reason,
            }
        text = str(experiment.arm_phase) if pushing else step
        self._feedback_publisher.publish(status_to_message('experiment', text, values))

    def _publish_result(self, experiment: Experiment) -> None:
        values = {
            'goal_id': self._goal_id(),
            'status': experiment.status.name,
            'trials': str(len(experiment.trials)),
            'complete': str(len(experiment.complete)),
        }
        for item in experiment.outcomes:
            values[f'bag {item.trial.number}'] = item.bag or ''
            values[f'outcome {item.trial.number}'] = item.outcome.value + (
                f': {item.reason}' if item.reason else ''
            )
        for number, silent in self._silent.items():
            if silent:
                values[f'silent {number}'] = ', '.join(sorted(silent))
        said = f'all bags are in {self._folder}'
        decision = experiment.decision
        if decision is not None and decision.ending is not None:
            values |= {'ending': decision.ending.value, 'ended because': decision.reason}
            said = f'{decision.ending.value}: {decision.reason}; {said}'
        if experiment.findings is not None:
            values |= _found(experiment.findings)
        message = status_to_message('experiment', experiment.reason or said, values)
        message.level = _LEVELS[experiment.status]
        self._result_publisher.publish(message)
        self.get_logger().info(
            f'goal {self._goal_id()}: {experiment.status.name}; {message.message}'
        )


def _found(findings: Findings) -> dict[str, str]:
    """Return the last diagnosis as names and texts."""
    values = {
        'found': findings.sentence,
        'diagnosis': findings.status,
        'effects': ', '.join(findings.effects),
        'sets': '; '.join(' or '.join(alike) for alike in findings.sets),
        'unexplained': '; '.join(findings.rest),
        'warnings': '; '.join(findings.warnings),
    }
    for name, each in findings.parameters.items():
        known = each.value is not None and each.std is not None
        values[name] = f'{each.value:.6g} +- {each.std:.2g} {each.unit}' if known else 'not told'
    return values


def _set_request(values: Mapping[str, float | str]) -> Any:
    """Return the request that sets doubles and texts of a node."""
    return SetParameters.Request(
        parameters=[
            Parameter(
                name=name,
                value=(
                    ParameterValue(type=ParameterType.PARAMETER_STRING, string_value=value)
                    if isinstance(value, str)
                    else ParameterValue(
                        type=ParameterType.PARAMETER_DOUBLE, double_value=float(value)
                    )
                ),
            )
            for name, value in values.items()
        ]
    )


def main() -> int:
    """Run the node."""
    return run(ExperimentOrchestrator)
