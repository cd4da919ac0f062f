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

"""The load cell driver as a process, on the simulated cell."""

import math
import signal

from hapticvision_ros.bag.contract import TARE, WRENCH
from hapticvision_ros.nodes.conversions import contact_force, ns_from_stamp
import numpy as np
import pytest
from std_srvs.srv import Trigger


@pytest.fixture
def driver(start_world, start_node):
    world = start_world('--object', 'spring1')
    return start_node('load_cell_driver', {'simulated_world_port': world.port})


def test_every_reading_is_published_with_the_cells_own_stamp(
    start_world, start_node, probe, until
):
    # Slower than the real thing, so that the driver is tested and not the speed of the listener.
    world = start_world('--object', 'spring1', '--force-rate', '250')
    start_node('load_cell_driver', {'simulated_world_port': world.port})
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 800, 'eight hundred readings')
    stamps = np.array([ns_from_stamp(message.header.stamp) for message in heard[100:800]])
    # The simulated cell samples exactly each 4 ms; a lost reading would be a step of two.
    assert np.all(np.abs(np.diff(stamps) - 4_000_000) <= 1000)
    assert {message.header.frame_id for message in heard} == {'load_cell'}
    assert all(math.isfinite(contact_force(message)) for message in heard)


def test_tare_takes_the_present_load_as_zero(driver, probe, until):
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 500, 'readings before the tare')
    before = np.mean([contact_force(message) for message in heard[-400:]])
    answer = probe.call(TARE, Trigger.Request())
    assert answer.success, answer.message
    seen = len(heard)
    until(lambda: len(heard) >= seen + 1000, 'readings after the tare')
    after = np.mean([contact_force(message) for message in heard[-400:]])
    # The simulated zero is 0.35 N; the mean of 200 readings with 0.02 N white noise and 0.01 N of
    # correlated noise (40 readings long) is good to about 0.005 N.
    assert before == pytest.approx(0.35, abs=0.03)
    assert after == pytest.approx(0.0, abs=0.03)


def test_a_reading_beyond_the_capacity_is_reported(start_world, start_node, until):
    world = start_world('--object', 'spring1')
    node = start_node('load_cell_driver', {'simulated_world_port': world.port, 'capacity': 0.1})
    until(lambda: 'is saturated' in node.output, 'the warning of saturation')


def test_without_a_load_cell_the_driver_ends_with_one_sentence(start_node):
    node = start_node('load_cell_driver', {'simulated_world_port': 1})
    assert node.wait() == 2
    assert 'no simulated world answers' in node.output
    assert 'Traceback' not in node.output


def test_a_load_cell_that_falls_silent_ends_the_driver(start_world, start_node, probe, until):
    world = start_world('--object', 'spring1')
    node = start_node('load_cell_driver', {'simulated_world_port': world.port})
    heard = probe.listen(WRENCH)
    until(lambda: heard, 'a reading')
    world.stop()
    assert node.wait() == 2
    assert 'Traceback' not in node.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_driver_stops_cleanly(driver, probe, until, number):
    heard = probe.listen(WRENCH)
    until(lambda: heard, 'a reading')
    assert driver.stop(number) == 0
    assert 'Traceback' not in driver.output


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'capacity': 0.0}, 'must lie between'),
        ({'capacity': 200}, 'not of type double'),
        ({'backend': 'imaginary'}, 'choose from simulated'),
        ({'capacitty': 200.0}, "unknown parameter 'capacitty'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_one_sentence(start_node, parameters, sentence):
    node = start_node('load_cell_driver', parameters)
    assert node.wait() == 2
    assert sentence in node.output
    assert len(node.output.splitlines()) == 1


def test_the_topic_follows_the_namespace(start_world, start_node, probe, until):
    world = start_world('--object', 'spring1')
    start_node('load_cell_driver', {'simulated_world_port': world.port}, '-r', '__ns:=/cell_2')
    until(
        lambda: '/cell_2/load_cell/wrench' in dict(probe.node.get_topic_names_and_types()),
        'the topic in the namespace',
    )
