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
The arms that the push controller can drive: simulated, or another arm over topics.

An arm over topics takes a speed along the push from us and tells its tool height, each on a topic
that its own drivers have: MoveIt Servo takes a ``TwistStamped``, a forward velocity controller of
ros2_control a ``Float64MultiArray``. What lies between them and the motors is the arm's own: its
limits, its watchdog and its emergency stop stay in force.
"""

from collections.abc import Sequence
from math import isfinite
import threading
import time
from typing import Any, Final

from geometry_msgs.msg import PoseStamped, TwistStamped
from hapticvision_ros.core.devices import Arm, ArmState
from hapticvision_ros.core.errors import DeviceError, InputError
from hapticvision_ros.nodes.conversions import ns_from_stamp
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import Parameters, ParameterSpec
from hapticvision_ros.sim.devices import connect_arm
from rclpy.duration import Duration
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

ARM_PARAMETERS: Final = (
    ParameterSpec(
        'backend',
        'string',
        '-',
        'Which arm to use: the simulated one, one behind MoveIt Servo (twist), or one behind a '
        'forward velocity controller of ros2_control (velocity).',
        choices=('simulated', 'twist', 'velocity'),
        read_only=True,
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
    ParameterSpec(
        'command_topic',
        'string',
        '-',
        'Where the arm takes its speed: a TwistStamped or a Float64MultiArray.',
        read_only=True,
    ),
    ParameterSpec(
        'command_frame',
        'string',
        '-',
        'Frame in which a twist is given, such as the tool frame.',
        read_only=True,
    ),
    ParameterSpec(
        'push_axis',
        'double_array',
        '-',
        'Unit vector along the push in the frame of the twist: three numbers.',
        -1.0,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'joint_velocities',
        'double_array',
        '-',
        'Velocity of each joint of the velocity controller for a push of 1 m/s, in its order.',
        -1000.0,
        1000.0,
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_type',
        'string',
        '-',
        "Where the arm tells its tool height: a Float64, a PoseStamped (its z), or one joint's "
        'position in a JointState.',
        choices=('float64', 'pose', 'joint_state'),
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_topic',
        'string',
        '-',
        "Topic of the arm's tool height; not the one that this node publishes.",
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_frame',
        'string',
        '-',
        'Frame in which poses have to be given; empty takes that of the first.',
        read_only=True,
    ),
    ParameterSpec(
        'largest_drift',
        'double',
        'm',
        'A tool that is farther than this beside where its motion began aborts the push; only '
        'poses tell.',
        1e-5,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_joint',
        'string',
        '-',
        'Joint whose position is the height, in a JointState.',
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_scale',
        'double',
        '-',
        'Factor of what the topic tells: -1 where it grows toward the support plane.',
        -1000.0,
        1000.0,
        read_only=True,
    ),
    ParameterSpec(
        'tool_height_offset',
        'double',
        'm',
        'Added to the scaled number, so that a tool tip on the support plane has height 0.',
        -10.0,
        10.0,
        read_only=True,
    ),
)
"""The parameters of the arm push controller that choose and describe its arm."""

CONNECT_TIMEOUT: Final = 5.0
"""How long the arm's own nodes are waited for [s]."""

LAST_WORDS: Final = 1.0
"""Longest wait until the arm has heard that it is to stop [s]."""

_HEIGHT_TYPES: Final = {'float64': Float64, 'pose': PoseStamped, 'joint_state': JointState}
_POLL: Final = 0.05
_LISTENER_CHECK: Final = 0.1
_DEPTH: Final = 500


class TopicArm:
    """
    An arm whose own nodes take a speed and tell a height.

    Parameters
    ----------
    node : rclpy.node.Node
        The node that drives it.
    parameters : Parameters
        Those of `ARM_PARAMETERS`.

    Raises
    ------
    InputError
        If the parameters do not fit together.
    DeviceError
        If nobody takes the speed, or nobody tells the height.

    """

    def __init__(self, node: Any, parameters: Parameters) -> None:
        self._node = node
        self._lock = threading.Lock()
        self._closed = False
        self._next_check = 0.0
        self._axis = _push_axis(parameters)
        self._joint_velocities = parameters.reals('joint_velocities')
        self._is_twist = parameters.text('backend') == 'twist'
        self._joint = parameters.text('tool_height_joint')
        self._scale = parameters.real('tool_height_scale')
        self._offset = parameters.real('tool_height_offset')
        self._frame = parameters.text('command_frame')
        self._pose_frame = parameters.text('tool_height_frame')
        self._trouble = ''
        self._height_topic = _topic(parameters, 'tool_height_topic')
        self._command_topic = _topic(parameters, 'command_topic')
        if parameters.text('tool_height_type') == 'joint_state' and not self._joint:
            raise InputError('tool_height_joint is empty: name the joint of the JointState.')
        kind = TwistStamped if self._is_twist else Float64MultiArray
        # A command that comes late is worse than none.
        self._publisher = node.create_publisher(kind, self._command_topic, QoSProfile(depth=1))
        profile = QoSProfile(
            history=QoSHistoryPolicy.KEEP_LAST,
            depth=_DEPTH,
            reliability=QoSReliabilityPolicy.BEST_EFFORT,
        )
        height_type = _HEIGHT_TYPES[parameters.text('tool_height_type')]
        self._heights = Intake(node, height_type, self._height_topic, profile, raw=False)
        try:
            self._wait_for_arm()
        except DeviceError:
            self.close()
            raise

    def read(self, timeout: float) -> Sequence[ArmState]:
        """Return the states since the last call, waiting up to `timeout` [s] for the first."""
        deadline = time.monotonic() + timeout
        while True:
            with self._lock:
                if self._closed:
                    raise DeviceError('the arm has been closed')
                if self._heights.wait(min(_POLL, timeout)):
                    states = self._take()
                    if states:
                        return states
            if time.monotonic() > deadline:
                raise DeviceError(
                    self._trouble
                    or f'the arm has told no tool height on {self._height_topic} for {timeout:g} '
                    's: see to its drivers'
                )

    def command(self, push_velocity: float) -> None:
        """Command a speed along the push [m/s], positive toward the object."""
        now = time.monotonic()
        if push_velocity and now >= self._next_check:
            self._next_check = now + _LISTENER_CHECK
            if not self._publisher.get_subscription_count():
                raise DeviceError(
                    f'nobody takes the speed of the arm on {self._command_topic}: see to its '
                    'controller'
                )
        if self._is_twist:
            message = TwistStamped()
            message.header.stamp = self._node.get_clock().now().to_msg()
            message.header.frame_id = self._frame
            linear = message.twist.linear
            linear.x, linear.y, linear.z = (item * push_velocity for item in self._axis)
        else:
            message = Float64MultiArray(
                data=[item * push_velocity for item in self._joint_velocities]
            )
        self._publisher.publish(message)

    def close(self) -> None:
        """Stop the arm and let go of it; may be called again."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
            self.command(0.0)
            # Also to those who are slow to hear that the publisher goes.
            self._publisher.wait_for_all_acked(Duration(seconds=LAST_WORDS))
            self._node.destroy_publisher(self._publisher)
            self._heights.close()

    def _take(self) -> list[ArmState]:
        """Return what the arm has told of its height, but for what is no number."""
        states = []
        for message, sent_ns, _ in self._heights.take():
            raw, stamp_ns = self._height(message, sent_ns)
            if raw is not None and isfinite(raw):
                place = None
                if isinstance(message, PoseStamped):
                    place = message.pose.position.x, message.pose.position.y
                    if not all(map(isfinite, place)):
                        continue
                states.append(ArmState(stamp_ns, self._scale * raw + self._offset, place))
        return states

    def _height(self, message: Any, sent_ns: int) -> tuple[float | None, int]:
        """Return what a message tells, and when it was measured [ns since the epoch]."""
        if isinstance(message, Float64):
            return float(message.data), sent_ns
        stamp_ns = ns_from_stamp(message.header.stamp) or sent_ns
        if isinstance(message, PoseStamped):
            trouble = self._in_another_frame(message.header.frame_id)
            if trouble and trouble != self._trouble:
                self._node.get_logger().warning(trouble)
            self._trouble = trouble
            return None if trouble else float(message.pose.position.z), stamp_ns
        positions = dict(zip(message.name, message.position, strict=False))
        return positions.get(self._joint), stamp_ns

    def _in_another_frame(self, frame: str) -> str:
        """Return why the z of a pose is not the height of the tool over the object, or ''."""
        self._pose_frame = self._pose_frame or frame
        if frame == self._pose_frame:
            return ''
        return (
            f"the pose on {self._height_topic} is in the frame '{frame}', not in "
            f"'{self._pose_frame}': it tells no height; set tool_height_frame"
        )

    def _wait_for_arm(self) -> None:
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while time.monotonic() < deadline:
            listened = self._publisher.get_subscription_count()
            if listened and self._heights.wait(_POLL) and self._take():
                return
            time.sleep(0.01)
        if self._trouble:
            raise DeviceError(self._trouble)
        taken = bool(self._publisher.get_subscription_count())
        raise DeviceError(
            f'the arm tells no tool height on {self._height_topic}: start its drivers, or set '
            'tool_height_topic and tool_height_type'
            if taken
            else f'nobody takes the speed of the arm on {self._command_topic}: start its '
            'controller, or set backend and command_topic'
        )


def _push_axis(parameters: Parameters) -> tuple[float, float, float]:
    axis = parameters.reals('push_axis')
    if len(axis) != 3 or abs(sum(item * item for item in axis) - 1.0) > 1e-3:
        raise InputError(
            f'push_axis is {list(axis)}: give the three numbers of a unit vector, such as '
            '[0.0, 0.0, 1.0].'
        )
    x, y, z = axis
    return (x, y, z)


def _topic(parameters: Parameters, name: str) -> str:
    topic = parameters.text(name)
    if not topic:
        raise InputError(f'{name} is empty: name the topic of the arm.')
    return topic


def connect(node: Any, parameters: Parameters) -> Arm:
    """
    Connect to the arm that the parameters choose.

    Parameters
    ----------
    node : rclpy.node.Node
        The node that drives it.
    parameters : Parameters
        Those of `ARM_PARAMETERS`.

    Returns
    -------
    Arm
        The arm, telling its state.

    Raises
    ------
    InputError
        If the parameters do not fit together.
    DeviceError
        If the arm does not answer.

    """
    if parameters.text('backend') == 'simulated':
        return connect_arm(parameters.integer('simulated_world_port'))
    return TopicArm(node, parameters)
