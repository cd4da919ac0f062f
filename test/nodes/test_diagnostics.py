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

"""What nodes say of themselves on ``/diagnostics``."""

import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hapticvision_ros.nodes import diagnostics
from hapticvision_ros.nodes.diagnostics import (
    DIAGNOSTICS,
    Diagnostics,
    Finding,
    Heard,
    Level,
    RollCall,
    worst,
)
import pytest
import rclpy


@pytest.fixture
def node(ros):
    made = rclpy.create_node('cell_part', namespace='/cell_2')
    yield made
    made.destroy_node()


def test_findings_are_sent_with_the_nodes_full_name(node, probe, until):
    heard = []
    probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, heard.append, 10)
    diagnostics = Diagnostics(node, 'serial 42')
    values = {'rate_hz': 998.51234, 'lost': 3, 'tared': True, 'reason': None}
    diagnostics.add('stream', lambda: Finding(Level.WARN, 'Three are lost.', values))
    diagnostics.add('device', lambda: Finding(Level.STALE, 'It is silent.'))

    def sent():
        diagnostics.publish()
        return heard

    until(sent, 'a message')
    stream, device = heard[0].status
    assert stream.name == 'cell_2/cell_part: stream'
    assert device.name == 'cell_2/cell_part: device'
    assert (stream.level, device.level) == (stream.WARN, stream.STALE)
    assert stream.message == 'Three are lost.'
    assert stream.hardware_id == 'serial 42'
    assert {item.key: item.value for item in stream.values} == {
        'rate_hz': '998.512',
        'lost': '3',
        'tared': 'yes',
        'reason': '-',
    }
    assert heard[0].header.stamp.sec > 0


def test_the_timer_sends_also_while_the_ros_time_stands_still(ros, probe, until):
    standing = rclpy.create_node(
        'standing', parameter_overrides=[rclpy.parameter.Parameter('use_sim_time', value=True)]
    )
    heard = []
    probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, heard.append, 10)
    try:
        Diagnostics(standing, period=0.05).add('part', lambda: Finding(Level.OK, 'Fine.'))

        def sent():
            rclpy.spin_once(standing, timeout_sec=0.05)
            return heard

        until(sent, 'a message')
        assert heard[0].status[0].message == 'Fine.'
    finally:
        standing.destroy_node()


def test_the_worst_finding_counts_and_all_that_is_wrong_is_said():
    good = Finding(Level.OK, 'Rate is right.', {'rate_hz': 1000.0})
    warning = Finding(Level.WARN, 'Readings are lost.', {'lost': 4})
    error = Finding(Level.ERROR, 'It is saturated.', {'saturated': 2})
    together = worst([good, error, warning], 'All is well.')
    assert together.level is Level.ERROR
    assert together.message == 'It is saturated. Readings are lost.'
    assert together.values == {'rate_hz': 1000.0, 'saturated': 2, 'lost': 4}
    assert worst([good], 'All is well.').message == 'All is well.'
    assert worst([], 'All is well.').level is Level.OK


def array_of(*names):
    return DiagnosticArray(status=[DiagnosticStatus(name=name) for name in names])


@pytest.mark.parametrize('namespace', ['', '/cell1'])
def test_nodes_that_were_heard_and_are_silent_now_are_named(ros, monkeypatch, namespace):
    monkeypatch.setattr(diagnostics, 'SILENCE', 0.05)
    node = rclpy.create_node('caller', namespace=namespace)
    try:
        call = RollCall(node, ('fitter', 'planner', 'driver'))
        own = f'{namespace}/'.removeprefix('/')
        call._on_array(
            array_of(f'{own}fitter: fit', f'{own}planner: plan', 'cell2/driver: device')
        )
        call._on_array(array_of(f'{own}stranger: it'))
        assert call.silent == ()
        # The driver that was heard is of another cell, where there are several.
        assert not call.complete
        end = time.monotonic() + 0.1
        while time.monotonic() < end:
            call._on_array(array_of(f'{own}planner: plan'))
        assert call.silent == ('fitter',)
        call.begin()
        assert call.silent == ()
        call._on_array(array_of(f'{own}fitter: fit'))
        assert call.silent == ()
        call._on_array(array_of(f'{own}planner: plan'))
        assert not call.complete
        call._on_array(array_of(f'{own}driver: device', f'{own}driver: clock'))
        assert call.complete
    finally:
        node.destroy_node()


@pytest.mark.parametrize(('ago', 'age'), [(5.0, 5.0), (0.0, 0.0), (-3600.0, 0.0)])
def test_what_came_by_a_clock_that_was_set_back_came_now(ago, age):
    heard = Heard('The force', 'force')
    heard.note(ago=ago)
    assert heard.age == pytest.approx(age, abs=1.0)


def test_a_change_is_sent_at_once(node, probe, until):
    heard = []
    probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, heard.append, 10)
    diagnostics = Diagnostics(node, period=3600.0)
    diagnostics.add('part', lambda: Finding(Level.ERROR, 'It has gone.'))

    def sent():
        diagnostics.hasten()
        rclpy.spin_once(node, timeout_sec=0.05)
        return heard

    until(sent, 'a message')
    assert heard[0].status[0].message == 'It has gone.'
