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
Arms over topics that are emulated, over a bad network: loss, delay, garbage, a peer that restarts.

The emulated arm moves the tool of a simulated world. It has a ROS context of its own, hence a
participant of its own on the network, and goes with it. As MoveIt Servo does, it stops when twists
cease; as a forward velocity controller of ros2_control does, it keeps its last velocity for ever.
"""

from collections import deque
from contextlib import suppress
from random import Random
import signal
import threading
import time

from geometry_msgs.msg import PoseStamped, TwistStamped
from hapticvision_ros.bag.contract import ENABLE, PHASE, PUSH_REPORT, RETRACT, TOOL_HEIGHT
from hapticvision_ros.core.devices import ArmState
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.nodes import arm_push_controller
from hapticvision_ros.nodes.arm_backends import connect
from hapticvision_ros.nodes.conversions import stamp_from_ns
from hapticvision_ros.share import share_folder
from hapticvision_ros.sim.devices import connect_arm
import pytest
import rclpy
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from sensor_msgs.msg import JointState
from std_msgs.msg import Float64MultiArray
from std_srvs.srv import SetBool, Trigger

OFFSET = 0.3
"""The robot stands so high above the plane [m]."""
SERVO_TIMEOUT = 0.1
DEPTH = 0.004
STALE_TIME = 1.0
TOP = 0.040
NAN = float('nan')


def pose(state):
    message = PoseStamped()
    message.header.stamp = stamp_from_ns(state.stamp_ns)
    message.pose.position.z = state.tool_height - OFFSET
    return message


def joints(state):
    message = JointState(name=['pan', 'lift'], position=[0.5, state.tool_height - OFFSET])
    message.header.stamp = stamp_from_ns(state.stamp_ns)
    return message


KINDS = {
    'twist': (TwistStamped, lambda message: message.twist.linear.z, PoseStamped, pose),
    # The lift goes down in a push.
    'velocity': (Float64MultiArray, lambda message: -message.data[1], JointState, joints),
}


class StandingArm:
    """An arm without motors."""

    def read(self, timeout):
        time.sleep(0.01)
        return [ArmState(time.time_ns(), 0.25)]

    def command(self, push_velocity):
        pass

    def close(self):
        pass


class Robot:
    """
    The arm's own nodes: they take a speed and tell a height, over a network with faults.

    Attributes
    ----------
    loss : float
        Share of the messages of both directions that is lost.
    delay_of_heights, delay_of_commands : float
        How long those of either direction are held up [s].
    make : callable
        Makes a message of a state of the arm, or None.
    velocity : float
        Present velocity of the tool towards the object [m/s].
    commands : list of float
        All velocities that it was told [m/s].
    lowest : float
        How low the tool has been [m].

    """

    def __init__(self, kind, arm, topic='/robot/command'):
        self._command_type, self._velocity_of, self._height_type, self.make = KINDS[kind]
        self._timeout = SERVO_TIMEOUT if kind == 'twist' else float('inf')
        self._topic = topic
        self._arm = arm
        self._random = Random(1)
        self.commands = []
        self.lowest = float('inf')
        self.loss = self.delay_of_heights = self.delay_of_commands = 0.0
        self.start()

    def start(self):
        self.velocity = 0.0
        self._heard = 0.0
        self._orders, self._words = deque(), deque()
        self._closing = threading.Event()
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._node = rclpy.create_node('robot', context=self._context)
        self._node.create_subscription(self._command_type, self._topic, self._hear, 10)
        self._publisher = self._node.create_publisher(self._height_type, '/robot/height', 100)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        self._threads = [threading.Thread(target=run) for run in (self._spin, self._run)]
        for thread in self._threads:
            thread.start()

    def stop(self):
        """Go, and let the motors stand; may be called again."""
        if self._context.ok():
            self._closing.set()
            for thread in self._threads:
                thread.join()
            with suppress(DeviceError):
                self._arm.command(0.0)
            self._executor.shutdown()
            self._node.destroy_node()
            self._context.shutdown()

    def heal(self):
        """Lose and hold up nothing any more, and forget the heights that are on their way."""
        self.loss = self.delay_of_heights = self.delay_of_commands = 0.0
        self._words.clear()

    def _gets_through(self):
        return self._random.random() >= self.loss

    def _spin(self):
        while not self._closing.is_set():
            self._executor.spin_once(timeout_sec=0.05)

    def _hear(self, message):
        if self._gets_through():
            self._orders.append(
                (time.monotonic() + self.delay_of_commands, self._velocity_of(message))
            )

    def _run(self):
        while not self._closing.is_set():
            try:
                state = self._arm.read(0.5)[-1]
            except DeviceError:
                # A world that is held up.
                continue
            self.lowest = min(self.lowest, state.tool_height)
            now = time.monotonic()
            while self._orders and self._orders[0][0] <= now:
                self.velocity, self._heard = self._orders.popleft()[1], now
                self.commands.append(self.velocity)
            if now - self._heard > self._timeout:
                self.velocity = 0.0
            with suppress(DeviceError):
                self._arm.command(self.velocity)
            message = self.make(state)
            if message is not None and self._gets_through():
                self._words.append((now + self.delay_of_heights, message))
            # The test may forget them meanwhile.
            with suppress(IndexError):
                while self._words[0][0] <= now:
                    self._publisher.publish(self._words.popleft()[1])


@pytest.fixture
def robot_of(ros):
    """Start robots that stop with the test."""
    robots = []

    def start(kind, arm, *topic):
        robots.append(Robot(kind, arm, *topic))
        return robots[-1]

    yield start
    for robot in robots:
        robot.stop()
        robot._arm.close()


# -- the back end by itself -----------------------------------------------------------------------

BACKEND = {
    'twist': {'backend': 'twist', 'tool_height_type': 'pose'},
    'velocity': {
        'backend': 'velocity',
        'joint_velocities': [0.0, -1.0],
        'tool_height_type': 'joint_state',
        'tool_height_joint': 'lift',
    },
}
TOPICS = {
    'command_topic': '/robot/command',
    'tool_height_topic': '/robot/height',
    'tool_height_offset': OFFSET,
}


@pytest.fixture
def arm_of(connected):
    """Connect back ends in the test process, which are closed with the test."""
    return lambda kind: connected(arm_push_controller, connect, TOPICS | BACKEND[kind])


def moves(robot, arm, until, velocity):
    """Command until the robot moves so, as the control loop does."""

    def moved():
        with suppress(DeviceError):
            arm.command(velocity)
        return robot.velocity == pytest.approx(velocity)

    until(moved, f'a velocity of {velocity:g} m/s')


@pytest.mark.parametrize('kind', BACKEND)
def test_an_arm_on_a_lossy_and_slow_network_is_read_and_moved(kind, robot_of, arm_of, until):
    robot = robot_of(kind, StandingArm())
    arm = arm_of(kind)
    robot.loss, robot.delay_of_heights, robot.delay_of_commands = 0.5, 0.3, 0.3
    # What was on its way.
    until(lambda: time.time_ns() - arm.read(10.0)[-1].stamp_ns > 0.25e9, 'heights that were late')
    states = [arm.read(10.0)[-1] for _ in range(10)]
    # The stamp tells when it was measured, not when it came.
    assert all(time.time_ns() - state.stamp_ns > 0.25e9 for state in states[-1:])
    assert [state.tool_height for state in states] == pytest.approx([0.25] * 10)
    stamps = [state.stamp_ns for state in states]
    assert stamps == sorted(set(stamps))
    moves(robot, arm, until, 0.01)


GARBAGE = {
    'twist': {
        'no number': lambda state: pose(ArmState(state.stamp_ns, NAN)),
        'infinite': lambda state: pose(ArmState(state.stamp_ns, float('inf'))),
        'no message': lambda state: b'\xde\xad\xbe\xef' * 20,
    },
    'velocity': {
        'no number': lambda state: joints(ArmState(state.stamp_ns, NAN)),
        'no joints': lambda state: JointState(),
        'other joints': lambda state: JointState(name=['pan'], position=[0.5]),
        'no positions': lambda state: JointState(name=['pan', 'lift']),
        'too few positions': lambda state: JointState(name=['pan', 'lift'], position=[0.5]),
        'no message': lambda state: b'\xde\xad\xbe\xef' * 20,
    },
}


@pytest.mark.parametrize(
    ('kind', 'what'), [(kind, what) for kind, makers in GARBAGE.items() for what in makers]
)
def test_garbage_of_the_arm_is_no_height(kind, what, robot_of, arm_of):
    robot = robot_of(kind, StandingArm())
    arm = arm_of(kind)
    good, bad = robot.make, GARBAGE[kind][what]
    turns = [0]

    def in_turn(state):
        turns[0] += 1
        return (good if turns[0] % 2 else bad)(state)

    robot.make = in_turn
    states = [state for _ in range(10) for state in arm.read(10.0)]
    assert [state.tool_height for state in states] == pytest.approx([0.25] * len(states))
    # Nothing else is as bad as silence.
    robot.make = bad
    with pytest.raises(DeviceError, match='has told no tool height on /robot/height'):
        for _ in range(100):
            arm.read(0.3)
    robot.make = good
    assert arm.read(10.0)[-1].tool_height == pytest.approx(0.25)


@pytest.mark.parametrize('kind', BACKEND)
def test_an_arm_that_starts_again_is_read_and_moved_again(kind, robot_of, arm_of, until):
    robot = robot_of(kind, StandingArm())
    arm = arm_of(kind)
    moves(robot, arm, until, 0.01)
    robot.stop()

    def refused():
        try:
            arm.command(0.01)
        except DeviceError as error:
            return 'nobody takes the speed of the arm on /robot/command' in str(error)
        return False

    until(refused, 'the loss of the controller')
    with pytest.raises(DeviceError, match='has told no tool height'):
        for _ in range(100):
            arm.read(0.3)
    # A stop is always sent, also into the void.
    arm.command(0.0)
    robot.start()
    assert arm.read(20.0)[-1].tool_height == pytest.approx(0.25)
    moves(robot, arm, until, 0.02)


# -- whole pushes ---------------------------------------------------------------------------------


@pytest.fixture
def world(start_world, tmp_path):
    """Return a world with a short way down to the object."""
    config = (share_folder() / 'config' / 'sim_world.yaml').read_text()
    near = tmp_path / 'sim_world.yaml'
    near.write_text(config.replace('start_height: 0.080', 'start_height: 0.046'))
    # Slower than the real thing, so that the logic is tested and not the speed of the machine.
    rates = ('--force-rate', '200', '--arm-rate', '200')
    return start_world('--object', 'spring1', '--config', str(near), *rates)


class Cell:
    """A push controller with its load cell, and a robot that moves a simulated world's tool."""

    def __init__(self, kind, others, world, start_node, robot_of, probe, until):
        self.kind = kind
        self._others = others
        self._start_node, self._until, self._probe = start_node, until, probe
        self.watchdog = None
        topic = '/robot/command'
        if kind == 'velocity':
            topic = '/robot/joints'
            self.watchdog = start_node(
                'velocity_watchdog',
                {
                    'input_topic': '/robot/command',
                    'output_topic': topic,
                    'timeout': 0.2,
                    'joints': 2,
                },
            )
        self.robot = robot_of(kind, connect_arm(world.port), topic)
        start_node('load_cell_driver', {'simulated_world_port': world.port, 'rate': 200.0})
        self.phases, self.heights = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
        self.reports = probe.listen(PUSH_REPORT)
        self.controller = self.start_controller()
        if self.watchdog is not None:
            # The controller has someone to command when the watchdog is there. What that passes on
            # before it knows of the robot is lost: the first it sends to it is a stop.
            until(lambda: self.robot.commands, 'a watchdog that has found the robot')

    def start_controller(self):
        return self._start_node(
            'arm_push_controller',
            {
                **TOPICS,
                **BACKEND[self.kind],
                'push_speed': 0.004,
                'depth': DEPTH,
                'hold_time': 0.5,
                'recover_time': 0.5,
                'release_speed': 0.015,
                'clearance': 0.01,
                'stale_time': STALE_TIME,
                'read_timeout': 5.0,
                'retract_height': 0.06,
                'heartbeat_time': 0.0,
                **self._others,
            },
        )

    def reaches(self, *phases):
        """Wait until the push is in one of some phases."""
        self._until(lambda: self.phases and self.phases[-1].data in phases, f'{phases}')

    def is_low(self):
        """Wait until the tool presses on the object."""
        self._until(
            lambda: self.heights and self.heights[-1].data < TOP - 0.001, 'a tool on the object'
        )


@pytest.fixture
def cell_of(world, start_node, robot_of, probe, until):
    return lambda kind, **others: Cell(kind, others, world, start_node, robot_of, probe, until)


@pytest.mark.parametrize('kind', BACKEND)
def test_a_whole_push_over_a_bad_network(kind, cell_of, probe, until):
    cell = cell_of(kind)
    cell.robot.loss = 0.3
    cell.robot.delay_of_heights = cell.robot.delay_of_commands = 0.02
    probe.start_push()
    cell.reaches('done', 'aborted')
    assert cell.phases[-1].data == 'done', cell.controller.output
    # 20 ms there, 20 ms back, and 0.5 s of a loaded machine are 2 mm, half of the depth.
    assert cell.robot.lowest == pytest.approx(TOP - DEPTH, abs=0.002)
    # The robot did move as it was told, and stands.
    assert max(cell.robot.commands) == pytest.approx(0.004, rel=0.3)
    assert cell.controller.stop() == 0
    if cell.watchdog is not None:
        cell.robot.heal()
        assert cell.watchdog.stop() == 0
        until(lambda: cell.robot.velocity == 0.0, 'a robot that stands')


@pytest.mark.parametrize('kind', BACKEND)
def test_heights_that_come_too_late_abort_the_push(kind, cell_of, probe, until):
    # Slowly: between two heights the controller goes by what it has commanded, down to the depth.
    cell = cell_of(kind, push_speed=0.001)
    probe.start_push()
    cell.is_low()
    cell.robot.delay_of_heights = 5.0
    # A robot whose commands are late stops as well, but is told to go on.
    until(lambda: max(cell.robot.commands[-20:]) <= 0.0, 'the stop')
    # On for as long as a height may be old; the rest is a second of a loaded machine.
    assert cell.robot.lowest > TOP - 0.001 - 0.001 * STALE_TIME - 0.001
    cell.robot.heal()
    cell.reaches('aborted', 'done')
    assert cell.phases[-1].data == 'aborted'
    assert 'height is missing, stale' in cell.reports[-1].message
    # Back where it came from, by itself.
    until(lambda: cell.heights[-1].data > TOP, 'a tool that is up')
    assert cell.controller.returncode is None


@pytest.mark.parametrize('kind', BACKEND)
def test_a_robot_that_restarts_in_a_push_is_left_and_found_again(kind, cell_of, probe, until):
    cell = cell_of(kind)
    probe.start_push()
    cell.is_low()
    cell.robot.stop()
    assert cell.controller.wait() == 2
    assert 'error: ' in cell.controller.output
    assert 'Traceback' not in cell.controller.output
    cell.robot.start()
    seen = len(cell.heights)
    cell.start_controller()
    if kind == 'velocity':
        # The watchdog still took the commands: the push was over before the controller gave up.
        assert probe.call(ENABLE, SetBool.Request(data=True)).success

        def retracts():
            answer = probe.call(RETRACT, Trigger.Request())
            return answer.success or 'on its way' in answer.message

        until(retracts, 'a retraction')
    # Else the controller that takes its place raises the tool by itself, as after its own death.
    until(lambda: any(m.data > 0.058 for m in cell.heights[seen:]), 'a tool that is up')


def test_the_watchdog_stops_the_joints_when_the_controller_is_killed_in_a_push(
    cell_of, probe, until
):
    cell = cell_of('velocity')
    probe.start_push()
    cell.is_low()
    cell.controller.send_signal(signal.SIGKILL)
    killed = len(cell.robot.commands)
    until(lambda: cell.robot.velocity == 0.0, 'the stop', 5.0)
    # A forward velocity controller has kept it: nothing came after.
    assert cell.robot.commands[-1] == 0.0
    assert len(cell.robot.commands) > killed or cell.robot.commands[killed - 1] == 0.0
    assert cell.watchdog.returncode is None
    probe.forget('arm_push_controller')
