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

"""Arms over topics: the commands that they get, the heights that they tell, a whole push."""

from contextlib import suppress
import threading

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseStamped, TwistStamped
from hapticvision_ros.bag.contract import PHASE, PUSH_REPORT, TOOL_HEIGHT
from hapticvision_ros.core.errors import DeviceError, InputError
from hapticvision_ros.nodes import arm_backends
from hapticvision_ros.nodes.arm_backends import connect
from hapticvision_ros.nodes.arm_push_controller import NAME, PARAMETERS
from hapticvision_ros.nodes.parameters import Parameters
from hapticvision_ros.share import share_folder
from hapticvision_ros.sim.devices import connect_arm
from hapticvision_ros.sim.emulators.net_ft import NetFtBox, NetFtEmulator
from hapticvision_ros.sim.emulators.sources import WorldSource
import pytest
import rclpy
from rclpy.parameter import Parameter
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64, Float64MultiArray

STAMP_NS = 1_790_000_000_123_456_789


def _stamp():
    return Time(sec=STAMP_NS // 10**9, nanosec=STAMP_NS % 10**9)


def _pose(height):
    message = PoseStamped()
    message.header.stamp = _stamp()
    message.pose.position.z = height
    return message


def _joints(height):
    message = JointState(name=['pan', 'lift'], position=[9.9, height])
    message.header.stamp = _stamp()
    return message


HEIGHTS = {
    'float64': (Float64, lambda height: Float64(data=height)),
    'pose': (PoseStamped, _pose),
    'joint_state': (JointState, _joints),
}


class Robot:
    """What an arm's own nodes do: take a speed, tell a height, again and again."""

    def __init__(self, node, command_type, height_type, make):
        self.commands = []
        self.height = 0.25
        self.silent = False
        self._make = make
        self._subscription = node.create_subscription(
            command_type, '/robot/command', self.commands.append, 100
        )
        self._publisher = node.create_publisher(height_type, '/robot/height', 100)
        self._timer = node.create_timer(0.01, self._tell)
        self._node = node

    def _tell(self):
        if not self.silent:
            self._publisher.publish(self._make(self.height))

    def close(self):
        self._node.destroy_subscription(self._subscription)


@pytest.fixture
def parameters_of(ros):
    nodes = []

    def make(**values):
        values = {
            'command_topic': '/robot/command',
            'tool_height_topic': '/robot/height',
            **values,
        }
        node = rclpy.create_node(
            NAME,
            automatically_declare_parameters_from_overrides=True,
            parameter_overrides=[Parameter(name, value=value) for name, value in values.items()],
        )
        nodes.append(node)
        return node, Parameters(node, NAME, PARAMETERS)

    yield make
    for node in nodes:
        node.destroy_node()


@pytest.mark.parametrize('kind', HEIGHTS)
def test_the_height_is_read_from_what_the_arm_tells(kind, parameters_of, probe, until):
    robot = Robot(probe.node, TwistStamped, *HEIGHTS[kind])
    arm = connect(
        *parameters_of(
            backend='twist',
            tool_height_type=kind,
            tool_height_joint='lift',
            tool_height_scale=-2.0,
            tool_height_offset=1.0,
        )
    )
    state = arm.read(5.0)[-1]
    assert state.tool_height == pytest.approx(1.0 - 2.0 * 0.25)
    if kind != 'float64':
        assert state.stamp_ns == STAMP_NS
    robot.height = float('nan')
    with pytest.raises(DeviceError, match=r'has told no tool height on /robot/height for 0\.2 s'):
        for _ in range(100):
            arm.read(0.2)
    arm.close()
    with pytest.raises(DeviceError, match='has been closed'):
        arm.read(0.2)


def test_a_pose_tells_the_place_too_and_in_another_frame_nothing(parameters_of, probe, until):
    frame = ['base']

    def pose(height):
        message = _pose(height)
        message.header.frame_id = frame[0]
        message.pose.position.x, message.pose.position.y = 0.3, -0.2
        return message

    robot = Robot(probe.node, TwistStamped, PoseStamped, pose)
    node, parameters = parameters_of(
        backend='twist', tool_height_type='pose', tool_height_scale=1.0, tool_height_frame='base'
    )
    arm = connect(node, parameters)
    state = arm.read(5.0)[-1]
    assert state.tool_height == pytest.approx(robot.height)
    assert state.place == (0.3, -0.2)
    frame[0] = 'tool0'

    def refusal():
        try:
            arm.read(0.1)
        except DeviceError as error:
            return str(error)
        return ''

    told = until(refusal, 'the refusal of another frame')
    assert "is in the frame 'tool0', not in 'base'" in told
    frame[0] = 'base'
    until(lambda: not refusal(), 'a height again')
    arm.close()
    # From the start.
    frame[0] = 'tool0'
    until(lambda: not probe.node.count_publishers('/robot/command'), 'the end of the first arm')
    with pytest.raises(DeviceError, match="is in the frame 'tool0', not in 'base'"):
        connect(node, parameters)


def test_moveit_servo_gets_a_stamped_twist_along_the_push_axis(parameters_of, probe, until):
    robot = Robot(probe.node, TwistStamped, *HEIGHTS['pose'])
    node, parameters = parameters_of(
        backend='twist', push_axis=[0.0, -0.6, 0.8], command_frame='tcp'
    )
    arm = connect(node, parameters)
    arm.command(0.01)
    until(lambda: robot.commands, 'a command')
    twist = robot.commands[0]
    assert twist.header.frame_id == 'tcp'
    now_ns = node.get_clock().now().nanoseconds
    # MoveIt Servo halts on a stamp that is old.
    assert 0 <= now_ns - (twist.header.stamp.sec * 10**9 + twist.header.stamp.nanosec) < 10**9
    linear, angular = twist.twist.linear, twist.twist.angular
    assert (linear.x, linear.y, linear.z) == pytest.approx((0.0, -0.006, 0.008))
    assert (angular.x, angular.y, angular.z) == (0.0, 0.0, 0.0)
    # Letting go is a stop.
    arm.close()
    until(lambda: robot.commands[-1].twist.linear.z == 0.0, 'the stop')


def test_a_velocity_controller_gets_each_joints_velocity(parameters_of, probe, until):
    robot = Robot(probe.node, Float64MultiArray, *HEIGHTS['joint_state'])
    arm = connect(
        *parameters_of(
            backend='velocity',
            joint_velocities=[0.0, -2.5],
            tool_height_type='joint_state',
            tool_height_joint='lift',
        )
    )
    arm.command(0.01)
    until(lambda: robot.commands, 'a command')
    assert list(robot.commands[0].data) == pytest.approx([0.0, -0.025])
    arm.close()
    arm.close()
    until(lambda: list(robot.commands[-1].data) == [0.0, 0.0], 'the stop')


def test_a_controller_that_has_gone_is_an_error_of_one_sentence(parameters_of, probe, until):
    robot = Robot(probe.node, TwistStamped, *HEIGHTS['pose'])
    arm = connect(*parameters_of(backend='twist'))
    arm.command(0.01)
    robot.close()

    def refused():
        try:
            arm.command(0.01)
        except DeviceError as error:
            return str(error)
        return None

    assert until(refused, 'an error') == (
        'nobody takes the speed of the arm on /robot/command: see to its controller'
    )
    # A stop is always sent.
    arm.command(0.0)
    arm.close()


@pytest.mark.parametrize(
    ('values', 'sentence'),
    [
        ({'backend': 'twist', 'push_axis': [0.0, 0.0, 0.5]}, 'three numbers of a unit vector'),
        ({'backend': 'twist', 'push_axis': [1.0]}, 'three numbers of a unit vector'),
        ({'backend': 'twist', 'command_topic': ''}, 'command_topic is empty'),
        ({'backend': 'velocity', 'tool_height_type': 'joint_state'}, 'name the joint'),
    ],
)
def test_a_wrong_setting_is_refused(parameters_of, values, sentence):
    with pytest.raises(InputError, match=sentence):
        connect(*parameters_of(**values))


def test_an_arm_that_is_not_there_is_told(parameters_of, probe, monkeypatch):
    monkeypatch.setattr(arm_backends, 'CONNECT_TIMEOUT', 0.3)
    with pytest.raises(DeviceError, match='nobody takes the speed'):
        connect(*parameters_of(backend='twist'))
    robot = Robot(probe.node, TwistStamped, *HEIGHTS['pose'])
    robot.silent = True
    monkeypatch.setattr(arm_backends, 'CONNECT_TIMEOUT', 2.0)
    with pytest.raises(DeviceError, match='tells no tool height'):
        connect(*parameters_of(backend='twist'))


class WorldRobot:
    """An arm behind MoveIt Servo, whose motors are the simulated world's."""

    def __init__(self, node, port):
        self.slope = 0.0
        self._arm = connect_arm(port)
        self._publisher = node.create_publisher(PoseStamped, '/robot/pose', 100)
        self._subscription = node.create_subscription(TwistStamped, '/robot/twist', self._move, 1)
        self._node = node
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._tell)
        self._thread.start()

    def _move(self, message):
        with suppress(DeviceError):
            self._arm.command(message.twist.linear.z)

    def _tell(self):
        while not self._closing.is_set():
            try:
                state = self._arm.read(0.5)[-1]
            except DeviceError:
                # A world that is held up.
                continue
            message = PoseStamped()
            sec, nanosec = divmod(state.stamp_ns, 10**9)
            message.header.stamp = Time(sec=sec, nanosec=nanosec)
            # In the frame of a robot that stands 0.3 m above the plane.
            message.pose.position.z = state.tool_height - 0.3
            message.pose.position.x = self.slope * state.tool_height
            self._publisher.publish(message)

    def close(self):
        self._closing.set()
        self._thread.join()
        self._node.destroy_subscription(self._subscription)
        self._arm.close()


@pytest.fixture
def box(start_world, probe, tmp_path):
    """Return a Net F/T box that measures in a world whose arm is moved over topics."""
    # A short way down to the object.
    config = (share_folder() / 'config' / 'sim_world.yaml').read_text()
    near = tmp_path / 'sim_world.yaml'
    near.write_text(config.replace('start_height: 0.080', 'start_height: 0.046'))
    rates = ('--force-rate', '200', '--arm-rate', '200')
    world = start_world('--object', 'spring1', '--config', str(near), *rates)
    robot = WorldRobot(probe.node, world.port)
    source = WorldSource(world.port)
    with NetFtEmulator(source, NetFtBox(rate=200)) as emulator:
        emulator.robot = robot
        yield emulator
    source.close()
    robot.close()


@pytest.mark.parametrize('slope', [0.0, 2.0], ids=['along the axis', 'aside'])
def test_a_whole_push_with_the_formats_of_real_devices(box, slope, start_node, probe, until):
    box.robot.slope = slope
    start_node(
        'load_cell_driver',
        {
            'backend': 'net_ft',
            'net_ft_address': '127.0.0.1',
            'net_ft_port': box.port,
            'net_ft_http_port': box.http_port,
            'rate': 200.0,
        },
    )
    controller = start_node(
        'arm_push_controller',
        {
            'backend': 'twist',
            'command_topic': '/robot/twist',
            'tool_height_topic': '/robot/pose',
            'tool_height_offset': 0.3,
            'push_speed': 0.004,
            'depth': 0.004,
            'hold_time': 0.5,
            'recover_time': 0.5,
            'release_speed': 0.015,
            'clearance': 0.01,
            'stale_time': 1.0,
            'read_timeout': 5.0,
            'heartbeat_time': 0.0,
        },
    )
    phases, heights = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    reports = probe.listen(PUSH_REPORT)
    probe.start_push()
    until(lambda: phases and phases[-1].data in ('done', 'aborted'), 'the end')
    if slope:
        # It has gone back, and is there for the next one.
        assert 'beside where its motion began' in until(lambda: reports, 'a report')[-1].message
        until(lambda: heights[-1].data > 0.045, 'the tool above the object')
        assert phases[-1].data == 'aborted'
        assert controller.stop() == 0
        return
    assert phases[-1].data == 'done', controller.output
    lowest = min(message.data for message in heights)
    # The block is 40 mm high; 0.25 s on the way there and back, on a loaded machine, are 1 mm.
    assert lowest == pytest.approx(0.036, abs=0.001)
    assert controller.stop() == 0
