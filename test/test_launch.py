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
What the launch files start is there.

`launch` is no wheel: a stand-in that only keeps what it is called with takes its place. It says
nothing about whether `launch` itself would accept the calls.
"""

import ast
from importlib import import_module
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
import re
import sys
from types import ModuleType, SimpleNamespace

from hapticvision_ros.cli.cell import NEEDS_WORLD, NODES
from hapticvision_ros.nodes.parameters import ParameterSpec
import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / 'launch').glob('*.launch.py'))
MODULES = (
    'launch',
    'launch.actions',
    'launch.conditions',
    'launch.substitutions',
    'launch_ros',
    'launch_ros.actions',
    'launch_ros.substitutions',
)
DEVICES = {'load_cell': 'net_ft', 'range_sensor': 'depth', 'arm': 'twist'}


class Call:
    """What a name of `launch` was called with."""

    def __init__(self, kind, *values, **options):
        self.kind, self.values, self.options = kind, values, options

    def perform(self, context):
        """Return the value of a LaunchConfiguration."""
        return context.configurations[self.values[0]]


class StandIn(ModuleType):
    """A module in which every name makes a `Call`."""

    def __getattr__(self, name):
        if name.startswith('__'):
            raise AttributeError(name)
        return lambda *values, **options: Call(name, *values, **options)


@pytest.fixture
def load(monkeypatch):
    for name in MODULES:
        monkeypatch.setitem(sys.modules, name, StandIn(name))

    def load(name: str) -> ModuleType:
        spec = spec_from_file_location('a_launch_file', ROOT / 'launch' / f'{name}.launch.py')
        module = module_from_spec(spec)
        spec.loader.exec_module(module)
        return module

    return load


def _calls(item, kind: str) -> list[Call]:
    """Return the calls of a name within what was returned."""
    if isinstance(item, Call):
        inside = [*item.values, *item.options.values()]
        return [*([item] if item.kind == kind else []), *_calls(inside, kind)]
    if isinstance(item, list | tuple):
        return [found for part in item for found in _calls(part, kind)]
    return []


def _table(node: str) -> dict[str, ParameterSpec]:
    module = import_module(f'hapticvision_ros.nodes.{node}')
    return {spec.name: spec for spec in module.PARAMETERS}


def _context(module: ModuleType, **chosen: str) -> SimpleNamespace:
    defaults = {name: default for name, default, _ in module.ARGUMENTS}
    return SimpleNamespace(configurations=defaults | chosen)


def _parameters(node: Call) -> dict[str, object]:
    dictionaries = [item for item in node.options['parameters'] if isinstance(item, dict)]
    return {name: value for item in dictionaries for name, value in item.items()}


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_each_argument_that_is_used_is_declared(path: Path, load) -> None:
    module = load(path.name.removesuffix('.launch.py'))
    declared = _calls(module.generate_launch_description(), 'DeclareLaunchArgument')
    names = [call.values[0] for call in declared]
    assert len(names) == len(set(names))
    assert all(call.options['description'].endswith('.') for call in declared)
    used = set(re.findall(r"LaunchConfiguration\('(\w+)'\)", path.read_text()))
    used |= {item[0] for item in getattr(module, 'BACKENDS', ())}
    assert used == set(names)


@pytest.mark.parametrize('path', FILES, ids=lambda path: path.name)
def test_each_executable_is_installed(path: Path, load) -> None:
    module = load(path.name.removesuffix('.launch.py'))
    started = [module.generate_launch_description()]
    if hasattr(module, 'nodes'):
        started.append(module.nodes(_context(module, **DEVICES | {'arm': 'velocity'})))
    names = {call.options['executable'] for call in _calls(started, 'Node')}
    names |= {call.values[0] for call in _calls(started, 'ExecutableInPackage')}
    set_up = ast.parse((ROOT / 'setup.py').read_text())
    texts = {item.value for item in ast.walk(set_up) if isinstance(item, ast.Constant)}
    texts = {item.partition(' = ')[0] for item in texts if isinstance(item, str)}
    assert names and names <= texts


@pytest.mark.parametrize('name', ['cell', 'real_cell'])
def test_discovery_reaches_other_machines_only_where_it_is_asked_to(name: str, load) -> None:
    description = load(name).generate_launch_description()
    (local,) = _calls(description, 'GroupAction')
    assert local.options['condition'].kind == 'IfCondition'
    assert _set(local)['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    (beyond,) = (
        call
        for call in _calls(description, 'SetEnvironmentVariable')
        if getattr(call.options.get('condition'), 'kind', '') == 'UnlessCondition'
    )
    # What the user has set stands; without a word the nodes would stay on this machine.
    chosen = _set(beyond)['ROS_AUTOMATIC_DISCOVERY_RANGE']
    assert chosen.kind == 'EnvironmentVariable'
    assert chosen.options['default_value'] == 'SUBNET'


def _set(item: Call) -> dict[str, object]:
    return dict(call.values[:2] for call in _calls(item, 'SetEnvironmentVariable'))


def test_the_cells_are_made_of_the_seven_nodes(load) -> None:
    simulated, real = load('cell'), load('real_cell')
    assert simulated.NODES == real.NODES == NODES
    assert simulated.NEEDS_WORLD == NEEDS_WORLD
    for module in (simulated, real):
        started = module.nodes(_context(module, **DEVICES))
        assert [node.options['executable'] for node in started] == list(NODES)


def test_joints_that_take_velocities_get_their_watchdog(load) -> None:
    module = load('real_cell')
    started = module.nodes(_context(module, **DEVICES | {'arm': 'velocity'}))
    assert [node.options['executable'] for node in started] == [*NODES, 'velocity_watchdog']


def test_the_arguments_choose_among_the_back_ends_that_there_are(load) -> None:
    for argument, node, choices, _ in load('real_cell').BACKENDS:
        assert set(choices) == set(_table(node)['backend'].choices), argument


@pytest.mark.parametrize('name', ['cell', 'real_cell'])
def test_each_parameter_that_is_set_is_taken(name: str, load) -> None:
    module = load(name)
    for node in module.nodes(_context(module, **DEVICES | {'load_cell': 'simulated'})):
        table = _table(node.options['executable'])
        for parameter, value in _parameters(node).items():
            assert table[parameter].refusal(value) is None


def test_a_replay_sets_parameters_that_there_are(load) -> None:
    for node in _calls(load('replay').generate_launch_description(), 'Node'):
        table = _table(node.options['executable'])
        assert set(_parameters(node)) <= {*table, 'use_sim_time'}


def test_a_real_cell_asks_no_simulated_world_for_samples(load) -> None:
    module = load('real_cell')
    started = {n.options['executable']: n for n in module.nodes(_context(module, **DEVICES))}
    assert _parameters(started['experiment_orchestrator']) == {'simulated_world_port': 0}
    for name in ('load_cell_driver', 'range_sensor_driver', 'arm_push_controller'):
        assert 'simulated_world_port' not in _parameters(started[name])


def test_arguments_go_before_the_files_and_every_file_is_given(load) -> None:
    # ROS prefers a section with the node's name to `/**` in whatever file it stands, so the
    # arguments must be written into such a section: launch_ros does so for a node with a name.
    module = load('real_cell')
    for node in module.nodes(_context(module, **DEVICES, params='a.yaml, b.yaml')):
        assert node.options['name'] == node.options['executable']
        assert node.options['parameters'][:2] == ['a.yaml', 'b.yaml']


def test_each_node_of_a_real_cell_comes_back_a_few_times(load) -> None:
    module = load('real_cell')
    for node in module.nodes(_context(module, **DEVICES, restarts='2')):
        assert node.options['respawn'] and node.options['respawn_max_retries'] == 2
        assert 'on_exit' not in node.options


def test_each_node_has_its_enclave_only_where_one_is_asked_for(load) -> None:
    module = load('real_cell')
    for node in module.nodes(_context(module, **DEVICES)):
        assert node.options['ros_arguments'] == []
    for node in module.nodes(_context(module, **DEVICES, enclave='/hapticvision/')):
        assert node.options['ros_arguments'] == [
            '--enclave',
            f'/hapticvision/{node.options["executable"]}',
        ]
