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

One thread reads the arm, one takes the load cell's samples as they come, one runs the control law
at its own fixed rate. A back end's `read` and `command` are therefore called from two threads.
"""

from collections import deque
import threading
import time
from typing import Any, Final

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    ENABLE,
    PHASE,
    PUSH,
    PUSH_VELOCITY,
    STOP,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.core.devices import Arm
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.push_control import (
    Command,
    MeasuredTime,
    PushControl,
    PushGoal,
    PushLimits,
    Reading,
)
from hapticvision_ros.nodes.conversions import (
    contact_force,
    ns_from_stamp,
    NS_PER_S,
    point_from_message,
    scalar_to_message,
    text_to_message,
)
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.qos import (
    create_publisher,
    create_service,
    create_subscription,
    interface_class,
)
from hapticvision_ros.nodes.runtime import CellNode, run
from hapticvision_ros.sim.devices import connect_arm
from rclpy.serialization import deserialize_message

NAME: Final = 'arm_push_controller'

PARAMETERS: Final = (
    ParameterSpec(
        'backend', 'string', '-', 'Which device to use.', choices=('simulated',), read_only=True
    ),
    ParameterSpec(
        'simulated_world_port',
        'integer',
        '-',
        'UDP port of the simulated world on loopback.',
        1,
        65535,
        read_only=True,
    ),
    ParameterSpec('push_speed', 'double', 'm/s', 'Speed of the push.', 1e-6, 1.0),
    ParameterSpec('depth', 'double', 'm', 'How far to push on from the touch.', 1e-6, 0.5),
    ParameterSpec('hold_time', 'double', 's', 'How long to hold the depth.', 0.0, 86400.0),
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
    'stop_lead',
)
_IDLE_WAIT: Final = 0.1


class ArmPushController(CellNode):
    """Run pushes on request, and publish what the arm does."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._limits = PushLimits(**{name: values.real(name) for name in _LIMIT_PARAMETERS})
        self._period = 1.0 / values.real('control_rate')
        self._enabled = False
        self._force_time, self._tool_time = MeasuredTime(), MeasuredTime()
        self._force: Reading | None = None
        self._tool: Reading | None = None
        self._surface_height: float | None = None
        self._control: PushControl | None = None
        self._stop_reason: str | None = None
        self._work = threading.Event()
        self._tool_height = create_publisher(self, TOOL_HEIGHT)
        self._push_velocity = create_publisher(self, PUSH_VELOCITY)
        self._phase = create_publisher(self, PHASE)
        self._told_velocity: float | None = None
        self._told_phase: str | None = None
        self._arm: Arm = connect_arm(values.integer('simulated_world_port'))
        values.add_check(self._check_change)
        self._wrenches = Intake.of(self, WRENCH, raw=True)
        create_subscription(self, CONTACT_POINT, self._on_contact_point)
        create_service(self, ENABLE, self._on_enable)
        create_service(self, PUSH, self._on_start)
        create_service(self, STOP, self._on_stop)
        self.spawn(self._read, 'arm reader')
        self.spawn(self._listen, 'load cell reader')
        self.spawn(self._run, 'push control')

    def close(self) -> None:
        """Stop the push, then the arm."""
        self._work.set()
        super().close()
        control = self._control
        if control is not None:
            control.abort('The controller ends.', time.monotonic())
            self._publish(Command(0.0, control.phase), ended=True)
        self._arm.close()

    def _listen(self) -> None:
        kind = interface_class(WRENCH.msgtype)
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
            self._force = Reading(measured, contact_force(message))

    def _on_contact_point(self, message: Any) -> None:
        self._surface_height = point_from_message(message)[2]

    def _check_change(self, changes: Any) -> str | None:
        if self._control is not None:
            return 'A push is running: stop it before changing parameters.'
        return None

    def _on_enable(self, request: Any, response: Any) -> Any:
        self._enabled = bool(request.data)
        if not self._enabled:
            self._stop_reason = 'The controller was disabled.'
        response.success = True
        response.message = 'Motion is allowed.' if self._enabled else 'Motion is forbidden.'
        return response

    def _on_stop(self, request: Any, response: Any) -> Any:
        running = self._control is not None
        self._stop_reason = 'A stop was requested.'
        response.success = True
        response.message = 'The tool stops and retracts.' if running else 'No push is running.'
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

    def _start(self, now: float) -> None:
        if not self._enabled:
            raise InputError('Motion is forbidden: call the enable service first.')
        if self._control is not None:
            raise InputError('A push is running already: stop it or wait for its end.')
        force, tool = self._force, self._tool
        stale = self._limits.stale_time
        if force is None or now - force.t > stale:
            raise InputError(
                f'No force within the last {stale:g} s: see whether the load cell driver runs.'
            )
        if tool is None or now - tool.t > stale:
            raise InputError(f'No tool height within the last {stale:g} s: see to the arm.')
        goal = PushGoal(
            **{name: self.parameters.real(name) for name in _GOAL_PARAMETERS},
            surface_height=self._surface_height,
        )
        control = PushControl(goal, self._limits, now, tool.value)
        self._stop_reason = None
        self._control = control
        self._work.set()

    def _read(self) -> None:
        timeout = self.parameters.real('read_timeout')
        # A tenth less, so that an arm of just this rate is not halved by its jitter.
        interval = 0.9 / self.parameters.real('tool_height_rate')
        next_publish = 0.0
        while not self.stopping.is_set():
            state = self._arm.read(timeout)[-1]
            now = time.monotonic()
            measured = self._tool_time.of(state.stamp_ns / NS_PER_S, now)
            self._tool = Reading(measured, state.tool_height)
            if now >= next_publish:
                self._tool_height.publish(scalar_to_message(state.tool_height))
                next_publish = now + interval

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
        due = time.monotonic()
        while not (control.finished or self.stopping.is_set()):
            now = time.monotonic()
            reason = self._stop_reason
            if reason is not None:
                control.abort(reason, now)
            command = control.step(now, self._tool, self._force)
            self._arm.command(command.push_velocity)
            if control.finished:
                # Before the last phase is told: who hears it may start the next push at once.
                self._control = None
            self._publish(command, ended=control.finished)
            # After a long interruption the missed cycles are not made up for.
            due = max(due + self._period, now)
            time.sleep(max(0.0, due - time.monotonic()))
        if control.reason is not None:
            self.get_logger().warning(f'The push was aborted: {control.reason}')

    def _publish(self, command: Command, *, ended: bool) -> None:
        """Tell what has changed; that a push was aborted only once the tool has come back."""
        velocity, phase = command
        if velocity != self._told_velocity:
            self._told_velocity = velocity
            self._push_velocity.publish(scalar_to_message(velocity))
        if phase != self._told_phase and (ended or phase != 'aborted'):
            self._told_phase = phase
            self._phase.publish(text_to_message(phase))


def main() -> int:
    """Run the arm push controller."""
    return run(ArmPushController)
