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
Velocity watchdog: stands before a velocity controller that has no watchdog of its own.

A forward velocity controller of ros2_control goes on with the last command for ever. This node, a
process of its own, passes commands on, and sends zero when none has come for a short time: also
when the arm push controller was killed, or hangs. It knows nothing of the cell, so that little can
go wrong with it; against a machine that stands still as a whole only the arm's own stop helps. One
that takes the place of a watchdog that died stops the joints first: they may still move by the
last command that was passed on.
"""

from math import isfinite
import time
from typing import Any, Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Level
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import ParameterSpec
from hapticvision_ros.nodes.runtime import CellNode, run
from rclpy.qos import QoSProfile
from std_msgs.msg import Float64MultiArray

NAME: Final = 'velocity_watchdog'

PARAMETERS: Final = (
    ParameterSpec(
        'input_topic',
        'string',
        '-',
        'Where the commands come from: command_topic of the arm push controller.',
        read_only=True,
    ),
    ParameterSpec(
        'output_topic',
        'string',
        '-',
        'Where they go: the commands of the forward velocity controller.',
        read_only=True,
    ),
    ParameterSpec(
        'joints',
        'integer',
        '-',
        'Velocities in a command of the controller; a command of another length is refused.',
        1,
        64,
        read_only=True,
    ),
    ParameterSpec(
        'timeout',
        'double',
        's',
        'Without a command for this time the joints are stopped.',
        0.01,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'largest_velocity',
        'double',
        '-',
        'Largest velocity of a joint [m/s or rad/s]; a command beyond it, or one that is no '
        'number, stops all joints.',
        1e-6,
        100.0,
        read_only=True,
    ),
)

_DEPTH: Final = QoSProfile(depth=1)


class VelocityWatchdog(CellNode):
    """Pass commands on while they come; stop the joints when they do not."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        topics = values.text('input_topic'), values.text('output_topic')
        if '' in topics or topics[0] == topics[1]:
            raise InputError('input_topic and output_topic have to be two different topics.')
        self._timeout = values.real('timeout')
        self._largest = values.real('largest_velocity')
        self._joints = values.integer('joints')
        self._stopped = self._refused = 0
        self._moving = False
        self._publisher = self.create_publisher(Float64MultiArray, topics[1], _DEPTH)
        self._commands = Intake(self, Float64MultiArray, topics[0], _DEPTH, raw=False)
        Diagnostics(self).add('commands', self._find)
        self.spawn(self._watch, 'watchdog')

    def close(self) -> None:
        """Stop the joints, and watch no longer."""
        super().close()
        self._stop()

    def _watch(self) -> None:
        heard = time.monotonic()
        told = False
        while not self.stopping.is_set():
            if not told and self._publisher.get_subscription_count():
                # Whoever was told to move by a watchdog that died would go on for ever.
                self._stop()
                told = True
            if self._commands.wait(self._timeout / 4.0):
                for message, _, _ in self._commands.take():
                    heard = time.monotonic()
                    self._pass(message)
            elif self._moving and time.monotonic() - heard > self._timeout:
                self._stopped += 1
                self._stop()
                self.get_logger().warning('No command came: the joints are stopped.')

    def _pass(self, message: Any) -> None:
        velocities = list(message.data)
        bad = any(not isfinite(item) or abs(item) > self._largest for item in velocities)
        if bad or len(velocities) != self._joints:
            self._refused += 1
            self._stop()
            self.get_logger().warning(
                'A command was no number, beyond largest_velocity, or not of as many velocities '
                f'as joints says ({self._joints}): the joints are stopped.',
                throttle_duration_sec=1.0,
            )
            return
        self._moving = any(velocities)
        self._publisher.publish(message)

    def _stop(self) -> None:
        self._moving = False
        self._publisher.publish(Float64MultiArray(data=[0.0] * self._joints))

    def _find(self) -> Finding:
        """Return what the watchdog had to do."""
        values = {'moving': self._moving, 'stopped': self._stopped, 'refused': self._refused}
        if not self._publisher.get_subscription_count():
            return Finding(Level.ERROR, 'Nobody takes the commands.', values)
        if self._stopped or self._refused:
            return Finding(Level.WARN, 'The joints had to be stopped.', values)
        return Finding(Level.OK, 'Commands are passed on.', values)


def main() -> int:
    """Run the velocity watchdog."""
    return run(VelocityWatchdog)
