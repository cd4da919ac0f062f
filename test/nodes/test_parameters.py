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

"""The nodes' parameter tables and their files agree."""

from importlib import import_module
from types import SimpleNamespace

from hapticvision_ros.bag.contract import PHASE
from hapticvision_ros.core.errors import HapticVisionError
from hapticvision_ros.nodes import parameters, qos
from hapticvision_ros.nodes.conversions import text_to_message
from hapticvision_ros.nodes.parameters import (
    config_file,
    default_values,
    ParameterSpec,
    RunningPush,
)
import pytest
import rclpy
from rclpy.context import Context
import yaml

NODES = (
    'range_sensor_driver',
    'load_cell_driver',
    'arm_push_controller',
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
    'experiment_orchestrator',
)


@pytest.mark.parametrize('name', NODES)
def test_table_and_file_agree(name):
    node = import_module(f'hapticvision_ros.nodes.{name}')
    values = default_values(name, node.PARAMETERS)
    assert list(values) == [spec.name for spec in node.PARAMETERS]
    assert name == node.NAME


@pytest.mark.parametrize('name', NODES)
def test_each_parameter_says_what_it_is(name):
    node = import_module(f'hapticvision_ros.nodes.{name}')
    for spec in node.PARAMETERS:
        assert spec.description.endswith('.'), spec.name
        if spec.kind in ('double', 'double_array', 'integer'):
            assert spec.minimum is not None and spec.maximum is not None, spec.name


TABLE = (
    ParameterSpec('speed', 'double', 'm/s', 'Speed.', 0.0, 1.0),
    ParameterSpec('grid', 'double_array', 'm', 'Grid.', 0.0, 1.0),
    ParameterSpec('count', 'integer', '-', 'Count.', 1, 5),
    ParameterSpec('loud', 'bool', '-', 'Loud.'),
    ParameterSpec('kind', 'string', '-', 'Kind.', choices=('a', 'b')),
)
GOOD = {'speed': 0.5, 'grid': [0.1, 0.2], 'count': 3, 'loud': True, 'kind': 'a'}


@pytest.fixture
def write(tmp_path, monkeypatch):
    (tmp_path / 'config').mkdir()
    monkeypatch.setattr(parameters, 'share_folder', lambda: tmp_path)

    def write(content):
        config_file('node').write_text(content)

    return write


def test_a_good_file_is_read(write):
    write(yaml.safe_dump({'/**': {'ros__parameters': GOOD}}))
    assert default_values('node', TABLE) == GOOD


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'speed': 1}, 'not of type double'),
        ({'speed': 1.5}, 'between 0 and 1 m/s'),
        ({'speed': float('nan')}, 'between 0 and 1 m/s'),
        ({'grid': []}, 'not of type double_array'),
        ({'grid': [0.1, 7.0]}, 'between 0 and 1 m'),
        ({'count': True}, 'not of type integer'),
        ({'count': 9}, 'between 1 and 5.'),
        ({'loud': 'yes'}, 'not of type bool'),
        ({'kind': 'c'}, 'choose from a, b'),
        ({'sped': 0.5}, "unknown parameter 'sped'"),
    ],
)
def test_a_bad_value_is_told_in_one_sentence(write, change, sentence):
    write(yaml.safe_dump({'/**': {'ros__parameters': GOOD | change}}))
    with pytest.raises(HapticVisionError, match=sentence):
        default_values('node', TABLE)


@pytest.mark.parametrize(
    ('content', 'sentence'),
    [
        ('a: [', 'not valid YAML'),
        ('node: {}', 'no ROS parameter file'),
        ('- 1', 'no ROS parameter file'),
        ('/**: {ros__parameters: 3}', 'sets no parameters'),
        ('/**: {ros__parameters: {speed: 0.5}}', "no value for the parameter 'grid'"),
    ],
)
def test_a_bad_file_is_told_in_one_sentence(write, content, sentence):
    write(content)
    with pytest.raises(HapticVisionError, match=sentence):
        default_values('node', TABLE)


def test_a_missing_file_is_told_in_one_sentence(write):
    with pytest.raises(HapticVisionError, match='Cannot read the parameters of node'):
        default_values('node', TABLE)


@pytest.fixture
def push(ros):
    """Return what a node that is not spun has heard of a push."""
    node = rclpy.create_node('listener')
    yield RunningPush(node, PHASE)
    node.destroy_node()


def test_changes_are_refused_from_the_approach_to_the_end_of_the_push(push):
    changes = {'seed': 3, 'clouds': 2}
    told = []
    for phase in (
        '',
        'done',
        'approach',
        'push',
        'hold',
        'release',
        'recover',
        'nonsense',
        'done',
    ):
        push._on_phase(text_to_message(phase))
        told.append(push.refusal(changes))
    assert [sentence is None for sentence in told] == [True, True, *[False] * 6, True]
    assert told[2] == (
        "A push is running (in the phase 'approach'): stop it or wait for its end before changing "
        'clouds, seed.'
    )
    # A node that starts in the middle hears the latched phase only; an abort ends a push as well.
    push._on_phase(text_to_message('hold'))
    assert push.refusal(changes) is not None
    push._on_phase(text_to_message('aborted'))
    assert push.refusal(changes) is None


def test_a_controller_that_died_in_a_push_locks_nothing(push):
    push._on_phase(text_to_message('hold'))
    push._on_matched(SimpleNamespace(current_count=2))
    # One that has died is missed only later: the push may be that of its successor.
    push._on_matched(SimpleNamespace(current_count=1))
    assert push.phase == 'hold'
    push._on_matched(SimpleNamespace(current_count=0))
    assert push.phase is None


@pytest.fixture
def controller(ros):
    """Return a publisher of the phase in a participant of its own, and what lets it go."""
    context = Context()
    rclpy.init(args=[], context=context)
    node = rclpy.create_node('controller', context=context)

    def go():
        if context.ok():
            node.destroy_node()
            context.shutdown()

    yield qos.create_publisher(node, PHASE), go
    go()


@pytest.mark.parametrize(
    ('name', 'change'),
    [
        ('contact_point_planner', {'cloud_timeout': 2.0}),
        ('range_sensor_driver', {'frame_timeout': 2.0}),
    ],
)
def test_a_node_refuses_changes_while_pushing(
    name, change, start_world, start_node, probe, controller, until
):
    port = {'simulated_world_port': start_world('--object', 'spring1').port}
    start_node(name, port if name == 'range_sensor_driver' else {})
    publisher, go = controller
    # Latched before the node is there, or not: both are heard.
    publisher.publish(text_to_message('push'))

    def answer():
        (result,) = probe.set_parameters(name, change)
        return result

    until(lambda: not answer().successful, 'a refusal')
    assert "in the phase 'push'" in answer().reason
    publisher.publish(text_to_message('done'))
    until(lambda: answer().successful, 'a change after the push')
    publisher.publish(text_to_message('approach'))
    until(lambda: not answer().successful, 'a refusal in the next push')
    # The controller goes without another word.
    go()
    until(lambda: answer().successful, 'a change after the controller has gone')
