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

"""The arm push controller as a process, with load cell driver, on the simulated cell."""

import contextlib
from dataclasses import replace
import math
import os
import re
import signal
import subprocess
import sys
import time

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    ENABLE,
    HEARTBEAT,
    PHASE,
    PUSH,
    PUSH_REPORT,
    PUSH_VELOCITY,
    RETRACT,
    STOP,
    TOOL_HEIGHT,
    WRENCH,
)
from hapticvision_ros.core.devices import ArmState
from hapticvision_ros.core.push_control import Reading, SHUT_DOWN
from hapticvision_ros.nodes.arm_push_controller import ArmPushController
from hapticvision_ros.nodes.conversions import (
    contact_force,
    point_to_message,
    stamp_from_ns,
    values_from_status,
)
from hapticvision_ros.nodes.qos import interface_class
from hapticvision_ros.share import share_folder
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState
import numpy as np
import pytest
from std_msgs.msg import Bool, Float64
from std_srvs.srv import SetBool, Trigger

QUICK_PUSH = {
    'push_speed': 0.01,
    'depth': 0.004,
    'hold_time': 0.5,
    'recover_time': 0.3,
    # A starved controller is stopped by the arm's watchdog, within 0.1 s: 1.5 mm.
    'release_speed': 0.015,
    'clearance': 0.01,
    # Other tests and builds may hold up these processes for some tenths of a second.
    'stale_time': 1.0,
    # These tests push without an orchestrator.
    'heartbeat_time': 0.0,
}
BLOCK_HEIGHT = 0.040
SURFACE = point_to_message((0.0, 0.0, BLOCK_HEIGHT), 0, CONTACT_POINT.frame_id)
SPRING1_STIFFNESS = 3628.4605


@pytest.fixture
def world(start_world, tmp_path):
    # A short way down to the object.
    config = (share_folder() / 'config' / 'sim_world.yaml').read_text()
    near = tmp_path / 'sim_world.yaml'
    near.write_text(re.sub('start_height: 0.080', 'start_height: 0.050', config))
    # Slower than the real thing, so that the logic is tested and not the speed of the machine.
    rates = ('--force-rate', '200', '--arm-rate', '200')
    return start_world('--object', 'spring1', '--config', str(near), *rates)


@pytest.fixture
def load_cell(start_node, world):
    return start_node('load_cell_driver', {'simulated_world_port': world.port})


@pytest.fixture
def controller(start_node, world, load_cell):
    return start_node('arm_push_controller', {'simulated_world_port': world.port, **QUICK_PUSH})


def texts(messages):
    return [message.data for message in messages]


def test_a_push_goes_through_its_phases_at_the_commanded_speed_and_depth(controller, probe, until):
    phases, tool = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    wrenches, velocities = probe.listen(WRENCH), probe.listen(PUSH_VELOCITY)
    reports = probe.listen(PUSH_REPORT)
    (result,) = probe.set_parameters('arm_push_controller', {'push_speed': 0.002})
    assert result.successful, result.reason
    probe.send(CONTACT_POINT, SURFACE)
    # In air: a listener that loses readings must not take those of the contact for the zero.
    until(lambda: len(wrenches) >= 100, 'the zero of the load cell', 30.0)
    zero = np.median([contact_force(message) for message in wrenches[:100]])
    probe.start_push()
    until(lambda: 'done' in texts(phases), 'the end of the push', 30.0)
    assert texts(phases) == ['approach', 'push', 'hold', 'release', 'recover', 'done']
    # Fast in air, at the push speed from the gap above the planned surface on.
    assert texts(velocities) == [0.0, 0.01, 0.002, 0.0, -0.015, 0.0]
    heights = np.array(texts(tool))
    depth = BLOCK_HEIGHT - heights.min()
    # The touch is noticed at 0.2 N (0.06 mm); 0.2 s of latency on a loaded machine is 0.4 mm.
    assert 0.004 <= depth < 0.0045
    # Within the lead of 8 ms and the latency at the release speed.
    assert heights[-1] == pytest.approx(BLOCK_HEIGHT + QUICK_PUSH['clearance'], abs=0.003)
    report = values_from_status(reports[-1])
    assert float(report['depth_m']) == pytest.approx(depth, abs=0.2e-3)
    # A spring holds its force; the largest of some thousand readings with 0.022 N of noise. The
    # controller's own: a listener on a loaded machine loses some.
    peak = float(report['peak_force_N']) - zero
    assert peak == pytest.approx(SPRING1_STIFFNESS * depth, abs=0.15)
    assert report['overshoot_N'] == '0'


def test_a_start_is_refused_until_motion_is_allowed(controller, probe):
    answer = probe.call(PUSH, Trigger.Request())
    assert not answer.success
    assert 'Motion is forbidden' in answer.message


def test_a_start_without_a_force_is_refused(start_node, world, probe):
    start_node('arm_push_controller', {'simulated_world_port': world.port, **QUICK_PUSH})
    assert probe.call(ENABLE, SetBool.Request(data=True)).success
    answer = probe.call(PUSH, Trigger.Request())
    assert not answer.success
    assert 'No force' in answer.message


def test_a_goal_beyond_the_limits_is_refused(controller, probe, until):
    wrenches = probe.listen(WRENCH)
    until(lambda: wrenches, 'a force')
    assert probe.call(ENABLE, SetBool.Request(data=True)).success
    (result,) = probe.set_parameters('arm_push_controller', {'depth': 0.4})
    assert result.successful, result.reason

    def refused():
        answer = probe.call(PUSH, Trigger.Request())
        assert not answer.success
        return 'The depth is 400 mm' in answer.message

    until(refused, 'the refusal')


@pytest.mark.parametrize('how', ['stop', 'disable'])
def test_a_stopped_push_retracts_and_ends_as_aborted(controller, probe, until, how):
    phases, tool = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    until(lambda: tool, 'the tool height')
    start = tool[-1].data
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    refused = probe.call(PUSH, Trigger.Request())
    assert not refused.success and 'already' in refused.message
    (result,) = probe.set_parameters('arm_push_controller', {'depth': 0.002})
    assert not result.successful and 'A push is running' in result.reason
    if how == 'stop':
        answer = probe.call(STOP, Trigger.Request())
    else:
        answer = probe.call(ENABLE, SetBool.Request(data=False))
    assert answer.success
    # A service never waits for the motion, which takes about a second here.
    assert start - tool[-1].data > 0.001
    until(lambda: texts(phases)[-1] == 'aborted', 'the abort')
    # Back where it came from, within the braking distance.
    until(lambda: abs(tool[-1].data - start) < 0.002, 'the retraction')
    # Who hears that it has ended may go on at once.
    (result,) = probe.set_parameters('arm_push_controller', {'depth': 0.002})
    assert result.successful, result.reason


def test_a_lost_load_cell_aborts_the_push_and_retracts_the_tool(
    controller, load_cell, probe, until
):
    phases, tool = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    until(lambda: tool, 'the tool height')
    start = tool[-1].data
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    load_cell.stop()
    until(lambda: texts(phases)[-1] == 'aborted', 'the abort')
    until(lambda: abs(tool[-1].data - start) < 0.002, 'the retraction')
    until(lambda: 'The contact force is missing' in controller.output, 'the reason')


def test_too_large_a_force_aborts_the_push(start_node, world, load_cell, probe, until):
    start_node(
        'arm_push_controller',
        {
            'simulated_world_port': world.port,
            **QUICK_PUSH,
            'push_speed': 0.002,
            'max_force': 5.0,
        },
    )
    phases, wrenches = probe.listen(PHASE), probe.listen(WRENCH)
    reports = probe.listen(PUSH_REPORT)
    probe.send(CONTACT_POINT, SURFACE)
    probe.start_push()
    until(lambda: texts(phases) and texts(phases)[-1] == 'aborted', 'the abort')
    # 7.3 N/s at this speed: the loop of 4 ms, and 0.4 s of latency on a loaded machine.
    largest = max(contact_force(message) for message in wrenches)
    assert largest < 8.0
    until(lambda: reports, 'the report')
    assert 'exceeds the limit of 5 N' in reports[-1].message
    overshoot = float(values_from_status(reports[-1])['overshoot_N'])
    assert overshoot == pytest.approx(max(0.0, largest - 5.0), abs=0.1)


class StandingArm:
    """An arm that stays where it is, and keeps what it was told."""

    def __init__(self):
        self.told = []

    def read(self, timeout):
        time.sleep(0.01)
        return [ArmState(time.time_ns(), 0.05)]

    def command(self, push_velocity):
        self.told.append(push_velocity)

    def close(self):
        pass


@pytest.mark.parametrize('force', [150.1, -150.1, math.nan])
def test_a_force_beyond_its_limit_acts_when_it_comes_and_not_with_the_next_cycle(
    ros, probe, until, monkeypatch, force
):
    arm = StandingArm()
    monkeypatch.setattr(ArmPushController, '_connect', lambda self: arm)
    node = ArmPushController()
    wrench = interface_class(WRENCH.msgtype)()

    def send(value):
        wrench.header.stamp = stamp_from_ns(time.time_ns())
        wrench.wrench.force.z = -value
        forces.publish(wrench)

    try:
        node._limits = replace(node._limits, stale_time=60.0, heartbeat_time=0.0)
        # The next cycle comes after the test.
        node._period = 600.0
        forces = probe.publisher(WRENCH)
        send(0.1)
        until(lambda: node._force is not None and node._tool is not None, 'the readings')
        node._enabled = True
        node._start(time.monotonic())
        until(lambda: arm.told, 'the first cycle')
        assert node._control.reason is None
        send(force)
        until(lambda: node._last_report is not None, 'the end of the push', 10.0)
        reason = 'exceeds the limit of 150 N' if math.isfinite(force) else 'not a number'
        assert reason in node._last_report.reason
        assert max(arm.told) <= 0.0
    finally:
        node.close()
        node.destroy_node()


@pytest.mark.parametrize(('heartbeat_time', 'aborts'), [(1.0, True), (0.0, False)])
def test_an_orchestrator_that_was_started_anew_does_not_watch_over_the_push_of_the_one_before(
    ros, probe, until, monkeypatch, heartbeat_time, aborts
):
    arm = StandingArm()
    monkeypatch.setattr(ArmPushController, '_connect', lambda self: arm)
    node = ArmPushController()
    try:
        node._limits = replace(node._limits, stale_time=60.0, heartbeat_time=heartbeat_time)
        node._force = Reading(time.monotonic(), 0.1)
        until(lambda: node._tool is not None, 'the height')
        # Also the one that starts the push may have been started anew, before it.
        for uptime in (500.0, 7.0, 7.1):
            node._on_heartbeat(Float64(data=uptime))
        node._enabled = True
        node._start(time.monotonic())
        node._on_heartbeat(Float64(data=7.2))
        assert node._stop_reason is None
        node._on_heartbeat(Float64(data=0.0))
        assert (node._stop_reason is not None) == aborts
        if aborts:
            until(lambda: node._last_report is not None, 'the end of the push', 10.0)
            assert 'is another than before' in node._last_report.reason
    finally:
        node.close()
        node.destroy_node()


class AsideArm(StandingArm):
    """An arm that goes aside when it is told to go up or down; its height trembles."""

    def __init__(self):
        super().__init__()
        self.aside = 0.0
        self._last = time.monotonic()

    def read(self, timeout):
        time.sleep(0.005)
        now = time.monotonic()
        self.aside -= (self.told[-1] if self.told else 0.0) * (now - self._last)
        self._last = now
        height = 0.05 + 1e-5 * (len(self.told) % 3)
        return [ArmState(time.time_ns(), height, (self.aside, 0.0))]


def test_an_arm_that_goes_aside_is_not_raised_again_and_again(ros, until, monkeypatch):
    arm = AsideArm()
    monkeypatch.setattr(ArmPushController, '_connect', lambda self: arm)
    node = ArmPushController()
    try:
        node._limits = replace(node._limits, stale_time=60.0, heartbeat_time=0.0)
        until(lambda: node._tool is not None, 'the height')
        node._on_enable(SetBool.Request(data=True), SetBool.Response())

        def asked():
            response = node._on_retract(Trigger.Request(), Trigger.Response())
            assert not response.success
            return response.message

        # As the orchestrator asks until the tool is up.
        said = until(lambda: 'by the arm' in (said := asked()) and said, 'the refusal', 20.0)
        assert 'beside where its motion began' in said
        assert 'not raised any further' in said
        way = arm.aside
        assert way == pytest.approx(node._limits.largest_drift, rel=0.5)
        assert asked() == said
        assert node._control is None
        node._on_enable(SetBool.Request(data=True), SetBool.Response())
        assert asked() == 'The tool is on its way up.'
        until(lambda: node._control is None, 'its end', 10.0)
        assert arm.aside > way
    finally:
        node.close()
        node.destroy_node()


class LateArm(StandingArm):
    """An arm of which each fifth state is handed over 50 ms late, from 1 m."""

    reads = 0

    def read(self, timeout):
        (state,) = super().read(timeout)
        self.reads += 1
        if self.reads % 5:
            return [state]
        time.sleep(0.05)
        return [replace(state, tool_height=1.0)]


def test_a_height_that_is_handed_over_late_is_not_published(ros, probe, until, monkeypatch):
    tool = probe.listen(TOOL_HEIGHT)
    arm = LateArm()
    monkeypatch.setattr(ArmPushController, '_connect', lambda self: arm)
    node = ArmPushController()
    try:
        until(lambda: len(tool) >= 100 and arm.reads >= 200, 'the heights', 20.0)
    finally:
        node.close()
        node.destroy_node()
    late = np.count_nonzero(np.array(texts(tool)) == 1.0)
    # The first has nothing before it, and others may be held up for longer.
    assert late <= 0.02 * len(tool) + 1


LISTENER = """
import rclpy
from hapticvision_ros.bag.contract import PHASE
from hapticvision_ros.nodes.qos import create_subscription
rclpy.init()
node = rclpy.create_node('listener')
create_subscription(node, PHASE, lambda message: print(message.data, flush=True))
rclpy.spin(node)
"""


def test_the_last_words_reach_a_listener_that_is_held_up(controller, probe, until, tmp_path):
    # Told first that the controller has gone, it would drop what the controller has said last.
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    heard = tmp_path / 'heard'
    with (
        heard.open('w') as output,
        subprocess.Popen([sys.executable, '-c', LISTENER], stdout=output) as listener,
    ):
        try:
            until(lambda: probe.node.count_subscribers(PHASE.name), 'the listener')
            probe.start_push()
            until(lambda: 'hold' in heard.read_text(), 'the hold')
            listener.send_signal(signal.SIGSTOP)
            controller.send_signal(signal.SIGINT)
            with pytest.raises(subprocess.TimeoutExpired):
                controller.wait(1.0)
            listener.send_signal(signal.SIGCONT)
            assert controller.wait() == 0
            until(lambda: 'aborted' in heard.read_text(), 'the last words')
        finally:
            listener.kill()


def test_a_stopped_controller_stops_the_arm_and_says_so(controller, probe, until):
    phases, tool = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    # It must not be over before it is stopped, however late that comes.
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    probe.start_push()
    until(lambda: 'push' in texts(phases), 'the push')
    assert controller.stop() == 0
    until(lambda: texts(phases)[-1] == 'aborted', 'the last words')
    assert tool[-1].data > BLOCK_HEIGHT - QUICK_PUSH['depth'] - 0.001
    assert 'Traceback' not in controller.output


def test_the_emergency_stop_ends_a_push_and_stays_until_it_is_released(controller, probe, until):
    phases, reports = probe.listen(PHASE), probe.listen(PUSH_REPORT)
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    # As `ros2 topic pub` does it, without the history that the contract's own publishers keep.
    button = probe.node.create_publisher(Bool, 'emergency_stop', 1)
    probe.send(CONTACT_POINT, SURFACE)
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    button.publish(Bool(data=True))
    until(lambda: texts(phases)[-1] == 'aborted', 'the abort')
    until(lambda: reports, 'the report')
    assert reports[-1].message == 'The emergency stop was pressed.'
    refused = probe.call(ENABLE, SetBool.Request(data=True))
    assert not refused.success and 'emergency stop is pressed' in refused.message
    for service in (PUSH, RETRACT):
        refused = probe.call(service, Trigger.Request())
        assert not refused.success and 'emergency stop is pressed' in refused.message
    button.publish(Bool(data=False))
    # Released, but nothing moves before it is allowed again.
    until(
        lambda: 'forbidden' in probe.call(PUSH, Trigger.Request()).message, 'the end of the stop'
    )
    assert probe.call(ENABLE, SetBool.Request(data=True)).success


def test_a_push_goes_on_only_while_someone_watches(start_node, world, load_cell, probe, until):
    start_node(
        'arm_push_controller',
        {
            'simulated_world_port': world.port,
            **QUICK_PUSH,
            'heartbeat_time': 1.0,
            'hold_time': 60.0,
        },
    )
    phases, reports, tool = (probe.listen(item) for item in (PHASE, PUSH_REPORT, TOOL_HEIGHT))
    assert probe.call(ENABLE, SetBool.Request(data=True)).success
    until(
        lambda: 'No heartbeat' in probe.call(PUSH, Trigger.Request()).message,
        'the refusal of a push that nobody watches',
    )
    heart = probe.publisher(HEARTBEAT)
    beat = probe.node.create_timer(0.1, lambda: heart.publish(Float64()))
    until(lambda: probe.call(PUSH, Trigger.Request()).success, 'the start')
    until(lambda: 'hold' in texts(phases), 'the hold')
    low = tool[-1].data
    probe.node.destroy_timer(beat)
    until(lambda: texts(phases)[-1] == 'aborted', 'the abort')
    until(lambda: reports, 'the report')
    assert 'has been silent for 1 s' in reports[-1].message
    assert tool[-1].data > low + 0.009


@pytest.fixture
def notes(tmp_path):
    return tmp_path / f'hapticvision_ros_{os.getuid()}'


def test_who_takes_the_place_of_a_controller_that_died_in_a_push_raises_the_tool_unasked(
    notes, controller, start_node, world, probe, until
):
    tool, phases = probe.listen(TOOL_HEIGHT), probe.listen(PHASE)
    reports = probe.listen(PUSH_REPORT)
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    (note,) = until(lambda: list(notes.glob('*.json')), 'the note of the push')
    left = note.read_bytes()
    # Not killed: the test process, which others share, would take its services for alive. One that
    # is stopped in order leaves the tool low as well, but nothing to do for the next.
    assert controller.stop() == 0
    assert tool[-1].data < BLOCK_HEIGHT
    assert not list(notes.iterdir())
    reports.clear()
    note.write_bytes(left)
    parameters = {'simulated_world_port': world.port, **QUICK_PUSH, 'retract_height': 0.048}
    successor = start_node('arm_push_controller', parameters)
    # Nobody has called a service.
    until(lambda: reports, 'the report')
    assert 'died in the push' in reports[-1].message
    assert tool[-1].data > 0.048 - 0.002
    until(lambda: not list(notes.iterdir()), 'the end of what was left to do')
    assert successor.stop() == 0


def test_a_push_that_was_left_to_itself_is_told_to_be_over_also_where_the_tool_is_up(
    notes, controller, start_node, world, probe, until
):
    """Its last phase would stand for ever, and keep the load cell from being tared."""
    phases = probe.listen(PHASE)
    (result,) = probe.set_parameters('arm_push_controller', {'hold_time': 60.0})
    assert result.successful, result.reason
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    (note,) = until(lambda: list(notes.glob('*.json')), 'the note of the push')
    left = note.read_bytes()
    assert probe.call(STOP, Trigger.Request()).success
    until(lambda: texts(phases)[-1] == 'aborted', 'the end of the push')
    assert controller.stop() == 0
    phases.clear()
    note.write_bytes(left)
    parameters = {'simulated_world_port': world.port, **QUICK_PUSH, 'retract_height': 0.03}
    start_node('arm_push_controller', parameters)
    until(lambda: phases, 'what the successor tells')
    assert texts(phases) == ['aborted']
    until(lambda: not list(notes.iterdir()), 'the end of what was left to do')


@pytest.fixture
def change(probe, until):
    """Ask the controller for a transition; return whether it was made."""

    def change(transition):
        request = ChangeState.Request()
        request.transition.id = transition
        for _ in range(4):
            states = probe.node.create_client(ChangeState, 'arm_push_controller/change_state')
            until(states.service_is_ready, 'the lifecycle services')
            future = states.call_async(request)
            # A client is ready once it has found the server, which may not have found it yet.
            with contextlib.suppress(pytest.fail.Exception):
                until(future.done, 'the transition', 15.0)
            probe.node.destroy_client(states)
            if future.done():
                return future.result().success
        pytest.fail('the controller does not change its state')

    return change


def test_the_managed_node_moves_nothing_unless_active(
    start_node, world, load_cell, probe, until, change
):
    controller = start_node(
        'arm_push_controller',
        {'simulated_world_port': world.port, **QUICK_PUSH, 'autostart': False, 'hold_time': 60.0},
    )
    phases, tool = probe.listen(PHASE), probe.listen(TOOL_HEIGHT)
    assert change(Transition.TRANSITION_CONFIGURE)
    refused = probe.call(ENABLE, SetBool.Request(data=True))
    assert not refused.success and 'not active' in refused.message
    assert change(Transition.TRANSITION_ACTIVATE)
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    low = tool[-1].data
    assert change(Transition.TRANSITION_DEACTIVATE)
    assert not change(Transition.TRANSITION_CLEANUP), 'the arm is let go in mid-motion'
    until(lambda: texts(phases)[-1] == 'aborted', 'the abort')
    assert tool[-1].data > low + 0.009
    until(lambda: change(Transition.TRANSITION_CLEANUP), 'the cleaning up')
    assert change(Transition.TRANSITION_CONFIGURE) and change(Transition.TRANSITION_ACTIVATE)
    assert controller.stop() == 0
    assert 'Traceback' not in controller.output


@pytest.mark.parametrize('moving', [False, True], ids=['at rest', 'on its way up'])
def test_a_shutdown_is_the_last_that_is_told(
    start_node, world, load_cell, probe, until, change, moving
):
    controller = start_node(
        'arm_push_controller',
        {'simulated_world_port': world.port, **QUICK_PUSH, 'hold_time': 60.0},
    )
    phases, reports = probe.listen(PHASE), probe.listen(PUSH_REPORT)
    probe.start_push()
    until(lambda: 'hold' in texts(phases), 'the hold')
    assert probe.call(STOP, Trigger.Request()).success
    if not moving:
        until(lambda: reports, 'the end of the push')
        assert reports[-1].message == 'A stop was requested.'
    change(Transition.TRANSITION_ACTIVE_SHUTDOWN)
    assert controller.wait() == 0
    until(lambda: reports and reports[-1].message == SHUT_DOWN, 'that it was shut down')
    assert 'Traceback' not in controller.output
