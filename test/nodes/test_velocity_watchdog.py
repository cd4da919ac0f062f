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

"""The velocity watchdog as a process."""

import signal
import threading
import time

from hapticvision_ros.nodes.parameters import default_values
from hapticvision_ros.nodes.velocity_watchdog import NAME, PARAMETERS
import pytest
from std_msgs.msg import Float64MultiArray

TOPICS = {'input_topic': '/raw', 'output_topic': '/joints'}
TIMEOUT = 0.1


def test_table_and_file_agree():
    assert list(default_values(NAME, PARAMETERS)) == [spec.name for spec in PARAMETERS]


class Arm:
    """Hears what the joints are told, and when."""

    def __init__(self, probe, until):
        self.heard = []
        self._until = until
        self.commands = probe.node.create_publisher(Float64MultiArray, '/raw', 1)
        probe.node.create_subscription(
            Float64MultiArray,
            '/joints',
            lambda message: self.heard.append((time.monotonic(), list(message.data))),
            100,
        )
        until(self.commands.get_subscription_count, 'the watchdog')
        until(lambda: probe.node.count_publishers('/joints'), 'its output')
        until(lambda: self.heard, 'the stop at its start')
        assert not any(self.heard.pop()[1])

    def send(self, *velocities):
        self.commands.publish(Float64MultiArray(data=list(velocities)))

    def send_until_heard(self, *velocities):
        """Send until the first gets through: who has just come may miss it."""

        def through():
            self.send(*velocities)
            return self.heard

        self._until(through, 'a command')


@pytest.fixture
def arm(start_node, probe, until):
    start_node(NAME, {**TOPICS, 'timeout': TIMEOUT, 'joints': 2})
    return Arm(probe, until)


def test_commands_pass_and_silence_stops_the_joints(arm, until):
    arm.send_until_heard(0.01, -0.02)
    assert arm.heard[0][1] == [0.01, -0.02]
    going = threading.Event()

    def keep_on():
        while not going.wait(0.02):
            arm.send(0.03, 0.0)

    sender = threading.Thread(target=keep_on)
    sender.start()
    until(lambda: len(arm.heard) > 20, 'commands that go on')
    going.set()
    sender.join()
    last_sent = time.monotonic()
    until(lambda: arm.heard[-1][1] == [0.0, 0.0], 'the stop', 5.0)
    # The timeout, a quarter of it for the wait, and what a loaded machine takes.
    assert arm.heard[-1][0] - last_sent < 1.25 * TIMEOUT + 0.5
    # One stop is enough: a velocity controller keeps it.
    count = len(arm.heard)
    arm.send(0.0, 0.0)
    until(lambda: len(arm.heard) > count, 'a command that stands still')
    assert [item for _, item in arm.heard[count:]] == [[0.0, 0.0]]


@pytest.mark.parametrize('bad', [(0.01, float('nan')), (0.01, float('inf')), (0.01, 5.0), (0.01,)])
def test_a_command_that_cannot_be_stops_the_joints(arm, until, bad):
    arm.send_until_heard(0.01, 0.0)
    arm.send(*bad)
    until(lambda: arm.heard[-1][1] == [0.0, 0.0], 'the stop')
    assert all(abs(item) <= 0.1 for _, data in arm.heard for item in data)


def test_the_watchdog_that_is_stopped_stops_the_joints(start_node, probe, until):
    watchdog = start_node(NAME, {**TOPICS, 'timeout': 1.0, 'joints': 1})
    arm = Arm(probe, until)
    arm.send_until_heard(0.01)
    assert watchdog.stop(signal.SIGTERM) == 0
    until(lambda: arm.heard[-1][1] == [0.0], 'the stop')


def test_a_watchdog_that_takes_the_place_of_one_that_died_stops_the_joints(
    start_node, probe, until
):
    options = {**TOPICS, 'timeout': 1.0, 'joints': 1}
    watchdog = start_node(NAME, options)
    arm = Arm(probe, until)
    arm.send_until_heard(0.01)
    watchdog.stop(signal.SIGKILL)
    assert arm.heard[-1][1] == [0.01], 'nobody has stopped them'
    start_node(NAME, options)
    until(lambda: arm.heard[-1][1] == [0.0], 'the stop')


def test_topics_that_are_the_same_are_refused(start_node):
    node = start_node(NAME, {'input_topic': '/a', 'output_topic': '/a'})
    assert node.wait() == 2
    assert 'two different topics' in node.output
