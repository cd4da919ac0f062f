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
Arm push controller: owns the arm, runs one push at a time within limits, and can always stop.

A managed node: it is connected to the arm while configured, and moves it only while active and
enabled. It heeds whatever may be wrong by itself, without the help of any other node.

One thread reads the arm, one takes the load cell's samples as they come, one runs the control law
at its own fixed rate. A back end's `read` and `command` are therefore called from two threads.
"""

from collections import deque
from contextlib import suppress
from dataclasses import replace
from math import isfinite, nan
import threading
import time
from typing import Any, Final

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    EMERGENCY_STOP,
    ENABLE,
    HEARTBEAT,
    PHASE,
    PUSH,
    PUSH_REPORT,
    PUSH_VELOCITY,
    Qos,
    RETRACT,
    STOP,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.core.devices import Arm
from hapticvision_ros.core.errors import DeviceError, HapticVisionError, InputError
from hapticvision_ros.core.push_control import (
    Command,
    DEACTIVATED,
    DISABLED,
    EMERGENCY,
    FORBIDDEN,
    hold_mode,
    HOLD_MODES,
    MeasuredTime,
    NO_PUSH,
    NOT_ALLOWED,
    Punctuality,
    PushControl,
    PushGoal,
    PushLimits,
    PushReport,
    Reading,
    SHUT_DOWN,
    STOPPED_BY_HAND,
)
from hapticvision_ros.nodes.arm_backends import ARM_PARAMETERS, connect
from hapticvision_ros.nodes.conversions import (
    contact_force,
    ns_from_stamp,
    NS_PER_S,
    point_from_message,
    scalar_to_message,
    status_to_message,
    text_to_message,
)
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Level
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.push_record import PushRecord, RENEWAL
from hapticvision_ros.nodes.qos import (
    create_publisher,
    create_service,
    create_subscription,
    interface_class,
)
from hapticvision_ros.nodes.runtime import ManagedCellNode, run, THREAD_JOIN_TIMEOUT
from rclpy.clock import Clock, ClockType
from rclpy.lifecycle import TransitionCallbackReturn
from rclpy.serialization import deserialize_message

NAME: Final = 'arm_push_controller'

PARAMETERS: Final = (
    *ARM_PARAMETERS,
    ParameterSpec('push_speed', 'double', 'm/s', 'Speed of the push.', 1e-6, 1.0),
    ParameterSpec('depth', 'double', 'm', 'How far to push on from the touch.', 1e-6, 0.5),
    ParameterSpec(
        'hold_time',
        'double',
        's',
        'How long to hold the depth; in an auto hold the longest.',
        0.0,
        86400.0,
    ),
    ParameterSpec(
        'hold_mode',
        'string',
        '-',
        'Whether to hold for hold_time, or as long as the relaxation time asks for.',
        choices=HOLD_MODES,
    ),
    ParameterSpec(
        'hold_factor',
        'double',
        '-',
        'How many relaxation times an auto hold lasts, as estimated meanwhile.',
        0.1,
        10.0,
    ),
    ParameterSpec(
        'recover_time',
        'double',
        's',
        'How long to watch the object after the release.',
        0.0,
        86400.0,
    ),
    ParameterSpec('release_speed', 'double', 'm/s', 'Speed of the withdrawal.', 1e-6, 1.0),
    ParameterSpec(
        'approach_speed',
        'double',
        'm/s',
        'Speed in air, down to the approach gap; used only where the contact point is planned.',
        1e-6,
        1.0,
    ),
    ParameterSpec(
        'approach_gap',
        'double',
        'm',
        'Distance above the planned contact point at which the approach slows to the push speed.',
        0.0,
        0.1,
    ),
    ParameterSpec(
        'clearance',
        'double',
        'm',
        'How far above the touch the release ends, so that the range sensor sees the dent.',
        0.0,
        0.5,
    ),
    ParameterSpec(
        'touch_force', 'double', 'N', 'Rise of the force that counts as touch.', 0.001, 100.0
    ),
    ParameterSpec(
        'zero_time',
        'double',
        's',
        "How long the force's zero is averaged before the tool moves.",
        0.0,
        10.0,
    ),
    ParameterSpec(
        'max_force',
        'double',
        'N',
        'A contact force above this aborts the push.',
        0.1,
        100000.0,
        read_only=True,
    ),
    ParameterSpec(
        'max_speed', 'double', 'm/s', 'Largest speed of the tool.', 1e-6, 1.0, read_only=True
    ),
    ParameterSpec(
        'max_depth', 'double', 'm', 'Largest depth of a push.', 1e-6, 0.5, read_only=True
    ),
    ParameterSpec(
        'lowest_height',
        'double',
        'm',
        'The tool tip stays above this height.',
        0.0,
        2.0,
        read_only=True,
    ),
    ParameterSpec(
        'highest_height',
        'double',
        'm',
        'The tool tip stays below this height.',
        0.0,
        2.0,
        read_only=True,
    ),
    ParameterSpec(
        'max_duration',
        'double',
        's',
        'A push that takes longer is aborted.',
        1.0,
        172800.0,
        read_only=True,
    ),
    ParameterSpec(
        'stale_time',
        'double',
        's',
        'A force or a tool height older than this aborts the push.',
        0.005,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'frozen_time',
        'double',
        's',
        'A force that keeps the very same value for longer aborts the push, as of a saturated or '
        'dead load cell; 0 for one so coarse that it may.',
        0.0,
        60.0,
        read_only=True,
    ),
    ParameterSpec(
        'heartbeat_time',
        'double',
        's',
        'Without a heartbeat of the experiment orchestrator for this time a push is aborted; 0 if '
        'nobody watches over the pushes.',
        0.0,
        60.0,
        read_only=True,
    ),
    ParameterSpec(
        'touch_margin',
        'double',
        'm',
        'How far below the planned surface the tool goes on without a touch.',
        0.0,
        0.1,
        read_only=True,
    ),
    ParameterSpec(
        'stop_lead',
        'double',
        's',
        'Time for which the tool goes on after a stop, in effect: half its braking time and the '
        "loop's latency.",
        0.0,
        0.5,
        read_only=True,
    ),
    ParameterSpec(
        'retract_height',
        'double',
        'm',
        'To where the retract service raises the tool: clear of any object.',
        0.0,
        2.0,
        read_only=True,
    ),
    ParameterSpec(
        'takeover_time',
        'double',
        's',
        'A controller that starts so soon after one of the same arm died in a push raises the '
        'tool by itself; 0: it never does.',
        0.0,
        600.0,
        read_only=True,
    ),
    ParameterSpec(
        'autostart',
        'bool',
        '-',
        'Whether the node configures and activates itself when it starts.',
        read_only=True,
    ),
    ParameterSpec(
        'control_rate', 'double', 'Hz', 'Rate of the control loop.', 250.0, 1000.0, read_only=True
    ),
    ParameterSpec(
        'tool_height_rate',
        'double',
        'Hz',
        'Highest rate at which the tool height is published.',
        50.0,
        1000.0,
        read_only=True,
    ),
    ParameterSpec(
        'read_timeout',
        'double',
        's',
        'Without a reading for this time the arm counts as lost and the node ends.',
        0.01,
        10.0,
        read_only=True,
    ),
)

_GOAL_PARAMETERS: Final = (
    'hold_factor',
    'push_speed',
    'depth',
    'hold_time',
    'recover_time',
    'release_speed',
    'approach_speed',
    'approach_gap',
    'clearance',
    'touch_force',
    'zero_time',
)
_LIMIT_PARAMETERS: Final = (
    'max_force',
    'max_speed',
    'max_depth',
    'lowest_height',
    'highest_height',
    'max_duration',
    'stale_time',
    'frozen_time',
    'heartbeat_time',
    'touch_margin',
    'stop_lead',
    'largest_drift',
)
_FARTHEST: Final = 3.0
"""No arm tells a height of more: the limits of the workspace are within 2 m [m]."""
_IDLE_WAIT: Final = 0.1
_NEAR: Final = 0.002
"""A tool that is so close to the retract height is up [m]."""
_TAKEOVER_PERIOD: Final = 0.05
"""Time between two looks whether the tool of a controller that died can be raised [s]."""
_TAKEN_OVER: Final = 'The controller before this one died in the push: the tool is raised.'


class ArmPushController(ManagedCellNode):
    """Run pushes on request, and publish what the arm does."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._limits = PushLimits(**{name: values.real(name) for name in _LIMIT_PARAMETERS})
        self._period = 1.0 / values.real('control_rate')
        self._active = False
        self._enabled = False
        self._forbidden = ''
        self._emergency = False
        self._force_time, self._tool_time = MeasuredTime(), MeasuredTime()
        self._force: Reading | None = None
        self._tool: Reading | None = None
        self._place: tuple[float, float] | None = None
        self._stays = ''
        self._heartbeat: float | None = None
        self._watched = 0.0
        self._surface_height: float | None = None
        self._control: PushControl | None = None
        self._stop_reason: str | None = None
        self._trouble = ''
        self._late_cycles = 0
        self._last_report: PushReport | None = None
        self._work = threading.Event()
        self._urgent = threading.Event()
        self._tool_height = create_publisher(self, TOOL_HEIGHT)
        self._push_velocity = create_publisher(self, PUSH_VELOCITY)
        self._phase = create_publisher(self, PHASE)
        self._report = create_publisher(self, PUSH_REPORT)
        self._told_velocity: float | None = None
        self._told_phase: str | None = None
        port = values.integer('simulated_world_port')
        self._record = PushRecord(
            f'{self.context.get_domain_id()}{self.get_fully_qualified_name()}',
            f'{values.text("backend")} {values.text("command_topic")} {port}',
        )
        self._recorded = threading.Event()
        self._takeover: Any = None
        self._takeover_end = 0.0
        self._arm: Arm | None = None
        self._reader: threading.Thread | None = None
        self._disconnecting = threading.Event()
        values.add_check(self._check_change)
        self._wrenches = Intake.of(self, WRENCH, raw=True)
        create_subscription(self, CONTACT_POINT, self._on_contact_point)
        create_subscription(self, HEARTBEAT, self._on_heartbeat)
        # Once for what was said before this node was there, once for publishers of any kind.
        for topic in (EMERGENCY_STOP, replace(EMERGENCY_STOP, qos=Qos())):
            create_subscription(self, topic, self._on_emergency_stop)
        create_service(self, ENABLE, self._on_enable)
        create_service(self, PUSH, self._on_start)
        create_service(self, STOP, self._on_stop)
        create_service(self, RETRACT, self._on_retract)
        diagnostics = Diagnostics(self)
        diagnostics.add('push', self._find_push)
        diagnostics.add('readings', self._find_readings)
        self.spawn(self._listen, 'load cell reader')
        self._begin_takeover()
        self.spawn(self._run, 'push control')
        self.spawn(self._keep_record, 'push record')
        if values.flag('autostart') or self._takeover is not None:
            self._start_up()

    def close(self) -> None:
        """Stop the push, then the arm."""
        self.stopping.set()
        for waited_for in (self._work, self._urgent, self._recorded):
            waited_for.set()
        super().close()
        control = self._control
        taking_over = self._takeover is not None or (
            control is not None and control.reason == _TAKEN_OVER
        )
        # Whoever ends this node sees to its tool; one that takes the place of a failed one does so
        # by itself.
        if self.failure is None and not taking_over:
            self._record.remove()
        if control is not None:
            control.abort(self._stop_reason or 'The controller ends.', time.monotonic())
            self._tell(control.report())
            self._publish(Command(0.0, control.phase), ended=True)
        self._disconnect()

    # -- the managed node's transitions ---------------------------------------------------------

    def _start_up(self) -> None:
        """Configure and activate, or raise why that is not possible."""
        for transition in (self.trigger_configure, self.trigger_activate):
            if transition() is not TransitionCallbackReturn.SUCCESS:
                raise DeviceError(self._trouble)

    def on_configure(self, state: Any) -> Any:
        """Connect to the arm."""
        try:
            self._arm = self._connect()
        except HapticVisionError as error:
            self._trouble = str(error)
            self.get_logger().error(self._trouble)
            return TransitionCallbackReturn.FAILURE
        self._trouble = ''
        self._disconnecting = threading.Event()
        self._reader = self.spawn(self._read, 'arm reader')
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: Any) -> Any:
        """Answer to requests to move; motion itself still has to be allowed."""
        self._active = True
        return TransitionCallbackReturn.SUCCESS

    def on_deactivate(self, state: Any) -> Any:
        """Stop and retract; the control thread sees to it."""
        self._forbid(DEACTIVATED)
        self._active = False
        return TransitionCallbackReturn.SUCCESS

    def on_cleanup(self, state: Any) -> Any:
        """Let go of the arm, unless it is still retracting."""
        if self._control is not None:
            self.get_logger().error('The tool still retracts: let go of the arm when it is up.')
            return TransitionCallbackReturn.FAILURE
        self._disconnect()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: Any) -> Any:
        """End the node."""
        running = self._control is not None
        self._forbid(SHUT_DOWN)
        self._active = False
        if not running:
            # Else the report on the push tells it. Nobody is to allow motion to the controller
            # that may be started in the place of this one.
            self._report.publish(status_to_message('push', SHUT_DOWN, {}))
        self.stopping.set()
        return TransitionCallbackReturn.SUCCESS

    def _connect(self) -> Arm:
        return connect(self, self.parameters)

    def _disconnect(self) -> None:
        self._disconnecting.set()
        if self._arm is not None:
            self._arm.close()
        if self._reader is not None:
            self._reader.join(THREAD_JOIN_TIMEOUT)
        self._arm, self._reader, self._tool = None, None, None

    # -- a push that was left to itself ---------------------------------------------------------

    def _keep_record(self) -> None:
        """Keep a note on the disk while a push is under way."""
        noted = False
        while not self.stopping.is_set():
            self._recorded.clear()
            try:
                if self._control is not None:
                    self._record.renew()
                    noted = True
                elif noted:
                    self._record.remove()
                    noted = False
            except OSError as error:
                self.get_logger().warning(
                    f'That a push is under way cannot be noted: {error}. A controller that takes '
                    'the place of this one would not raise the tool by itself.',
                    once=True,
                )
            self._recorded.wait(RENEWAL)

    def _begin_takeover(self) -> None:
        """See whether a controller of this arm has just died in a push."""
        limit, age = self.parameters.real('takeover_time'), self._record.age()
        if age is None:
            return
        if age > limit:
            self.get_logger().warning(
                f'A push was left to itself {age:.0f} s ago: the tool may be low.'
            )
            self._end_left_push()
            return
        self._takeover_end = time.monotonic() + limit
        self._takeover = self.create_timer(
            _TAKEOVER_PERIOD, self._take_over, clock=Clock(clock_type=ClockType.STEADY_TIME)
        )

    def _take_over(self) -> None:
        """
        Raise a tool that was left low, as the controller that died would have done.

        Motion was allowed to that one, and nobody can be waited for: the experiment may be over,
        and the orchestrator may not reach this controller.
        """
        now, tool = time.monotonic(), self._tool
        if self._control is not None or self._emergency or now > self._takeover_end:
            # Somebody else sees to the tool, or has to.
            if self._control is None:
                self._end_left_push()
            self._end_takeover()
        elif tool is not None and now - tool.t <= self._limits.stale_time:
            if not self._begin_retraction(now, tool, _TAKEN_OVER):
                self._end_left_push()
            self._end_takeover()

    def _end_left_push(self) -> None:
        """Tell that the push of a controller that died is over: its last phase still stands."""
        self._record.remove()
        self._publish(Command(0.0, 'aborted'), ended=True)

    def _end_takeover(self) -> None:
        self.destroy_timer(self._takeover)
        self._takeover = None

    # -- what comes in --------------------------------------------------------------------------

    def _listen(self) -> None:
        kind = interface_class(WRENCH.msgtype)
        largest = self._limits.max_force
        while not self.stopping.is_set():
            if not self._wrenches.wait(_IDLE_WAIT):
                continue
            # Only the newest counts; reading all that wait would make a late node later still.
            newest = deque(self._wrenches.take(), maxlen=1)
            if not newest:
                continue
            message = deserialize_message(newest[0][0], kind)
            stamp = ns_from_stamp(message.header.stamp) / NS_PER_S
            measured = self._force_time.of(stamp, time.monotonic())
            force = contact_force(message)
            if self._force is not None and measured < self._force.t:
                # Sent twice, or overtaken.
                continue
            self._force = Reading(measured, force)
            if not isfinite(force) or abs(force) > largest:
                # The control loop need not wait for its next cycle.
                self._urgent.set()

    def _on_contact_point(self, message: Any) -> None:
        self._surface_height = point_from_message(message)[2]

    def _on_heartbeat(self, message: Any) -> None:
        self._heartbeat = time.monotonic()
        another = message.data < self._watched
        self._watched = message.data
        if another and self._control is not None and self._limits.heartbeat_time > 0.0:
            # One that was started at once is heard in time, but does not know of this push.
            self._stop_reason = (
                'The experiment orchestrator, which watches over the push, is another than '
                'before, or there are two of them.'
            )
            self._urgent.set()

    def _on_emergency_stop(self, message: Any) -> None:
        if message.data and not self._emergency:
            self.get_logger().error('Emergency stop.')
        self._emergency = bool(message.data)
        if self._emergency:
            self._forbid(STOPPED_BY_HAND)

    def _check_change(self, changes: Any) -> str | None:
        if self._control is not None:
            return 'A push is running: stop it before changing parameters.'
        return None

    def _forbid(self, reason: str) -> None:
        """Stop what moves, and let nothing move until it is allowed again."""
        self._enabled = False
        self._forbidden = reason
        self._stop_reason = reason
        self._urgent.set()

    def _on_enable(self, request: Any, response: Any) -> Any:
        if request.data:
            refusal = self._inability()
            self._enabled = not refusal
            self._stays = ''
            response.success = not refusal
            response.message = refusal or 'Motion is allowed.'
            return response
        self._forbid(DISABLED)
        response.success = True
        response.message = 'Motion is forbidden.'
        return response

    def _inability(self) -> str:
        """Return why motion cannot be allowed, or an empty text."""
        if not self._active:
            return 'The controller is not active: configure and activate it first.'
        if self._emergency:
            return EMERGENCY
        return ''

    def _on_stop(self, request: Any, response: Any) -> Any:
        running = self._control is not None
        self._stop_reason = 'A stop was requested.'
        self._urgent.set()
        response.success = True
        response.message = 'The tool stops and retracts.' if running else NO_PUSH
        return response

    def _on_start(self, request: Any, response: Any) -> Any:
        try:
            self._start(time.monotonic())
        except InputError as error:
            response.success = False
            response.message = str(error)
            return response
        response.success = True
        response.message = 'The push begins.'
        return response

    def _on_retract(self, request: Any, response: Any) -> Any:
        try:
            up = self._retract(time.monotonic())
        except InputError as error:
            response.success = False
            response.message = str(error)
            return response
        response.success = up
        response.message = 'The tool is up.' if up else 'The tool is on its way up.'
        return response

    def _movable(self, now: float) -> Reading:
        """Return the tool's height, or raise why the tool may not be moved now."""
        refusal = self._inability()
        if refusal:
            raise InputError(refusal)
        if not self._enabled:
            raise InputError(f'{FORBIDDEN}{self._forbidden}' if self._forbidden else NOT_ALLOWED)
        if self._stays:
            raise InputError(
                f"{self._stays} Bring it up by the arm's own means, see to push_axis and "
                'command_frame, and enable the controller anew.'
            )
        tool = self._tool
        stale = self._limits.stale_time
        if tool is None or now - tool.t > stale:
            raise InputError(f'No tool height within the last {stale:g} s: see to the arm.')
        return tool

    def _start(self, now: float) -> None:
        if self._control is not None and self._enabled:
            raise InputError('A push is running already: stop it or wait for its end.')
        tool = self._movable(now)
        force, stale = self._force, self._limits.stale_time
        if force is None or now - force.t > stale:
            raise InputError(
                f'No force within the last {stale:g} s: see whether the load cell driver runs.'
            )
        silence = self._limits.heartbeat_time
        if silence and (self._heartbeat is None or now - self._heartbeat > silence):
            raise InputError(
                f'No heartbeat of the experiment orchestrator within the last {silence:g} s: '
                'nobody watches over the push.'
            )
        goal = PushGoal(
            **{name: self.parameters.real(name) for name in _GOAL_PARAMETERS},
            hold_mode=hold_mode(self.parameters.text('hold_mode')),
            surface_height=self._surface_height,
        )
        self._go(PushControl(goal, self._limits, now, tool.value))

    def _retract(self, now: float) -> bool:
        """Begin to raise the tool unless it is up or on its way, and return whether it is up."""
        tool = self._movable(now)
        return self._control is None and not self._begin_retraction(now, tool)

    def _begin_retraction(self, now: float, tool: Reading, reason: str | None = None) -> bool:
        """Begin to raise the tool, and return whether it was not up."""
        height = min(self.parameters.real('retract_height'), self._limits.highest_height)
        if tool.value >= height - _NEAR:
            return False
        speed = self.parameters.real('release_speed')
        self._go(
            PushControl.retraction(self._limits, now, speed=speed, to_height=height, reason=reason)
        )
        return True

    def _go(self, control: PushControl) -> None:
        self._stop_reason = None
        self._control = control
        self._recorded.set()
        self._work.set()

    def _read(self) -> None:
        arm, disconnecting = self._arm, self._disconnecting
        assert arm is not None
        timeout = self.parameters.real('read_timeout')
        # A tenth less, so that an arm of just this rate is not halved by its jitter.
        interval = 0.9 / self.parameters.real('tool_height_rate')
        next_publish = 0.0
        punctuality = Punctuality()
        while not (self.stopping.is_set() or disconnecting.is_set()):
            try:
                state = arm.read(timeout)[-1]
            except (DeviceError, OSError):
                # Let go of while it was waited for.
                if disconnecting.is_set():
                    return
                raise
            now = time.monotonic()
            measured = self._tool_time.of(state.stamp_ns / NS_PER_S, now)
            if self._tool is not None and measured < self._tool.t:
                continue
            # Garbage that is taken for a height would end a retraction as if the tool were up.
            height = state.tool_height if abs(state.tool_height) <= _FARTHEST else nan
            self._tool = Reading(measured, height)
            self._place = state.place
            # The topic has no stamps, so that a late one would tell where the tool has been.
            if not punctuality.is_late(now - measured) and now >= next_publish:
                self._tool_height.publish(scalar_to_message(state.tool_height))
                next_publish = now + interval

    # -- the control loop -----------------------------------------------------------------------

    def _run(self) -> None:
        while not self.stopping.is_set():
            control = self._control
            if control is None:
                self._work.wait(_IDLE_WAIT)
                self._work.clear()
                continue
            self._execute(control)

    def _execute(self, control: PushControl) -> None:
        """Run one push to its end, at the control rate by absolute time."""
        arm = self._arm
        assert arm is not None
        try:
            self._control_arm(control, arm)
        finally:
            # The arm would go on with what it was told last.
            if not control.finished:
                with suppress(DeviceError, OSError):
                    arm.command(0.0)
        if control.reason is not None:
            self.get_logger().warning(f'The push was aborted: {control.reason}')
        if control.stays:
            self.get_logger().error(control.stays)

    def _control_arm(self, control: PushControl, arm: Arm) -> None:
        self._late_cycles = 0
        due = time.monotonic()
        while not (control.finished or self.stopping.is_set()):
            self._urgent.clear()
            now = time.monotonic()
            reason = self._stop_reason
            if reason is not None:
                control.abort(reason, now)
            command = control.step(now, self._tool, self._force, self._heartbeat, self._place)
            arm.command(command.push_velocity)
            if control.finished:
                self._stays = control.stays
                # Before the last phase is told: who hears it may start the next push at once.
                self._control = None
                self._recorded.set()
                self._tell(control.report())
            self._publish(command, ended=control.finished)
            if now - due > self._period:
                self._late_cycles += 1
            if now >= due:
                # After a long interruption the missed cycles are not made up for. What was urgent
                # does not put off the next one.
                due = max(due + self._period, now)
            self._urgent.wait(max(0.0, due - time.monotonic()))

    def _tell(self, report: PushReport) -> None:
        self._last_report = report
        reason = report.reason or 'The push came to its end.'
        if self._forbidden == SHUT_DOWN:
            # Also where the tool was on its way up for another reason: it is told last.
            reason = SHUT_DOWN
        self._report.publish(status_to_message('push', reason, report_values(report)))

    # -- what is told ---------------------------------------------------------------------------

    def _find_push(self) -> Finding:
        """Return the state of the controller and what the last push came to."""
        report = self._last_report
        values: dict[str, object] = {
            'active': self._active,
            'enabled': self._enabled,
            'emergency stop': self._emergency,
            'pushing': self._control is not None,
            'late cycles': self._late_cycles,
            **({} if report is None else report_values(report)),
        }
        if self._emergency:
            return Finding(Level.ERROR, EMERGENCY, values)
        if not self._active:
            return Finding(Level.WARN, self._trouble or 'The controller is not active.', values)
        if report is not None and report.reason is not None:
            said = f'The last push was aborted: {report.reason}'
            return Finding(Level.WARN, said, values)
        return Finding(Level.OK, 'Ready, or at work.', values)

    def _find_readings(self) -> Finding:
        """Return how old the readings are on which a push relies."""
        now = time.monotonic()
        ages = {
            'age of the force [s]': None if self._force is None else now - self._force.t,
            'age of the tool height [s]': None if self._tool is None else now - self._tool.t,
            'age of the heartbeat [s]': None if self._heartbeat is None else now - self._heartbeat,
        }
        silence = self._limits.heartbeat_time
        limits = (self._limits.stale_time, self._limits.stale_time, silence or None)
        old = [
            name.removeprefix('age of ').removesuffix(' [s]')
            for (name, age), limit in zip(ages.items(), limits, strict=True)
            if limit is not None and (age is None or age > limit)
        ]
        if old:
            said = f'Missing or too old: {", ".join(old)}.'
            return Finding(Level.ERROR if self._control is not None else Level.WARN, said, ages)
        return Finding(Level.OK, 'All readings are fresh.', ages)

    def _publish(self, command: Command, *, ended: bool) -> None:
        """Tell what has changed; that a push was aborted only once the tool has come back."""
        velocity, phase = command
        if velocity != self._told_velocity:
            self._told_velocity = velocity
            self._push_velocity.publish(scalar_to_message(velocity))
        if phase != self._told_phase and (ended or phase != 'aborted'):
            self._told_phase = phase
            self._phase.publish(text_to_message(phase))


def report_values(report: PushReport) -> dict[str, str]:
    """Return a push's report as texts by names with units; what does not apply is empty."""
    relaxation = report.relaxation_time
    values = {
        'peak_force_N': report.peak_force,
        'overshoot_N': report.overshoot,
        'touch_height_m': report.touch_height,
        'depth_m': report.depth,
        'hold_time_s': report.hold_time,
        'relaxation_time_s': None if relaxation is None else relaxation.value,
        'relaxation_time_std_s': None if relaxation is None else relaxation.std,
    }
    return {name: '' if value is None else f'{value:.6g}' for name, value in values.items()}


def main() -> int:
    """Run the arm push controller."""
    return run(ArmPushController)
