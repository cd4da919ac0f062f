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


"""What the installation page tells to type and to set is there."""

import ast
from functools import cache
from importlib import import_module
from pathlib import Path
import re
from typing import Any

from hapticvision_ros.bag.contract import CELL_TOPICS, SERVICES, TOPICS
from hapticvision_ros.cli.cell import NODES
from hapticvision_ros.core.push_control import check_goal, PushGoal, PushLimits
from hapticvision_ros.nodes.parameters import ParameterSpec
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'doc' / 'installation.md').read_text()
BLOCKS = re.findall(r'^```(\w*)\n(.*?)^```', PAGE, re.MULTILINE | re.DOTALL)
EXAMPLES = [text for language, text in BLOCKS if language == 'yaml']
COMMANDS = [
    line.strip()
    for language, text in BLOCKS
    if language == ''
    for line in text.replace('\\\n', ' ').splitlines()
]
TOPIC_TYPES = {topic.name: topic.msgtype for topic in (*TOPICS, *CELL_TOPICS)}
SERVICE_TYPES = {service.name: service.srvtype for service in SERVICES}
OTHER_NAMES = {
    # Words of the page in code marks that are no parameter of a node's own: frames and programs.
    'support_plane',
    'foxglove_bridge',
    'use_sim_time',
    'experiment_client',
}


@cache
def _table(node: str) -> dict[str, ParameterSpec]:
    module = import_module(f'hapticvision_ros.nodes.{node}')
    return {spec.name: spec for spec in module.PARAMETERS}


def _arguments(file: str) -> set[str]:
    tree = ast.parse((ROOT / 'launch' / file).read_text())
    texts = {item.value for item in ast.walk(tree) if isinstance(item, ast.Constant)}
    return {text for text in texts if isinstance(text, str)}


def _values(text: str) -> dict[str, dict[str, Any]]:
    """Return the parameters of an example, by node."""
    sections = yaml.safe_load(text)
    assert all(key.startswith('/**/') for key in sections), 'a namespace would hide them'
    return {key.removeprefix('/**/'): v['ros__parameters'] for key, v in sections.items()}


@pytest.mark.parametrize('text', EXAMPLES, ids=lambda text: text.split()[1])
def test_each_parameter_of_an_example_is_taken_with_its_value(text: str) -> None:
    for node, values in _values(text).items():
        for name, value in values.items():
            assert name in _table(node), f'{node} has no {name}'
            assert _table(node)[name].refusal(value) is None


@pytest.mark.parametrize('count', range(1, len(EXAMPLES) + 1))
def test_the_pushes_of_the_examples_are_within_their_limits(count: int) -> None:
    arm = 'arm_push_controller'
    content = yaml.safe_load((ROOT / 'config' / f'{arm}.yaml').read_text())
    values = content['/**']['ros__parameters']
    for text in EXAMPLES[:count]:
        values |= _values(text).get(arm, {})
    # The grid's own pushes come from the orchestrator: a tenth of the usual depth is in any.
    goal = PushGoal(
        **{name: values[name] for name in PushGoal.__dataclass_fields__ if name in values}
        | {'depth': 0.001}
    )
    limits = PushLimits(**{name: values[name] for name in PushLimits.__dataclass_fields__})
    check_goal(goal, limits, values['retract_height'])


def test_each_name_in_code_marks_is_there() -> None:
    known = {name for node in (*NODES, 'velocity_watchdog') for name in _table(node)}
    known |= {*NODES, 'velocity_watchdog'} | OTHER_NAMES | _arguments('real_cell.launch.py')
    prose = re.sub(r'^```.*?^```', '', PAGE, flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r'`([a-z]+(?:_[a-z]+)+)`', prose))
    assert named
    assert named <= known
    for name in re.findall(r'`(/[a-z_/]+)`', prose):
        assert name.removeprefix('/cell1') in {*TOPIC_TYPES, *SERVICE_TYPES, '/diagnostics'}


def test_each_launch_file_takes_the_arguments_of_the_page() -> None:
    found = [re.search(r'ros2 launch hapticvision_ros (\S+)(.*)', line) for line in COMMANDS]
    launches = [match for match in found if match]
    assert launches
    for match in launches:
        for name, value in re.findall(r'(\w+):=(\S+)', match[2]):
            assert name in _arguments(match[1])
            if name in ('load_cell', 'range_sensor', 'arm'):
                assert value in _arguments(match[1])
    for name in re.findall(r'`(\w+)(?::=[^`]*)`', PAGE):
        assert name in _arguments('real_cell.launch.py')
    for name in re.findall(r'`(\w+\.launch\.py)`', PAGE):
        assert (ROOT / 'launch' / name).is_file()


def test_each_service_and_topic_that_is_called_has_its_type() -> None:
    for line in COMMANDS:
        if match := re.match(r'ros2 service call (\S+) (\S+)', line):
            assert SERVICE_TYPES[match[1]] == match[2]
        if match := re.match(r'ros2 topic pub --once (\S+) (\S+)', line):
            assert TOPIC_TYPES[match[1]] == match[2]
        if match := re.match(r'ros2 topic echo (\S+)', line):
            assert match[1] in TOPIC_TYPES


def test_each_program_that_is_run_is_installed() -> None:
    set_up = (ROOT / 'setup.py').read_text()
    programs = re.findall(r'ros2 run hapticvision_ros (\w+)', PAGE)
    assert programs
    for program in programs:
        assert re.search(rf"'{program}\b", set_up)


def test_the_enclaves_are_those_of_the_policy() -> None:
    (line,) = (line for line in COMMANDS if line.startswith('for name in'))
    names = line.removeprefix('for name in').partition(';')[0].split()
    policy = (ROOT / 'config' / 'sros2' / 'policy.xml').read_text()
    assert names == re.findall(r'<enclave path="/hapticvision/(\w+)"', policy)


def test_what_refuses_says_what_the_page_says() -> None:
    source = '\n'.join(p.read_text() for p in (ROOT / 'hapticvision_ros').rglob('*.py'))
    table = PAGE.partition('## When something refuses')[2].partition('\n## ')[0]
    said = re.findall(r'^\| `([^`]+)` \|', table, re.MULTILINE)
    assert said
    for sentence in said:
        assert sentence in source


def test_links_of_the_page_lead_somewhere() -> None:
    for target in re.findall(r'\]\((\w+\.md)\)', PAGE):
        assert (ROOT / 'doc' / target).is_file()


def test_no_program_of_the_package_is_started_by_its_bare_name() -> None:
    # colcon puts them where `ros2 run` finds them, and not on the PATH.
    setup = (ROOT / 'setup.py').read_text()
    programs = {'hapticvision', 'simulated_world', *NODES}
    programs |= set(re.findall(r"'(\w+) = hapticvision_ros", setup))
    first = {command.split()[0] for command in COMMANDS if command}
    assert {'ros2', 'colcon'} <= first
    assert not first & programs
