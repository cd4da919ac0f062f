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
The SROS2 policy allows each node what it does, and no more.

What a node does is read from its source: the topics and services of the contract that it imports,
and which way they go where it names them when it makes a publisher or a server.
"""

import ast
from pathlib import Path

from hapticvision_ros.bag import contract
from hapticvision_ros.bag.contract import CELL_TOPICS, Service, SERVICES, Topic, TOPICS
from hapticvision_ros.cli.cell import NODES
from lxml import etree
import pytest
import yaml

ROOT = Path(__file__).resolve().parents[1]
TABLE = {item.name: item for item in (*TOPICS, *CELL_TOPICS, *SERVICES)}
WATCHDOG = 'velocity_watchdog'
OPERATOR = 'operator'
DIRECTIONS = {
    'create_publisher': 'publish',
    'create_subscription': 'subscribe',
    'of': 'subscribe',
    'refuse_changes_while_pushing': 'subscribe',
    'create_service': 'reply',
    'create_client': 'request',
}
COMMON = {
    'publish': {'/rosout', '/diagnostics', '/parameter_events'},
    'subscribe': {'/clock', '/parameter_events'},
}
FOREIGN_PARAMETERS = {
    ('range_sensor_driver', 'subscribe'): ('points_topic', 'depth_topic', 'camera_info_topic'),
    ('arm_push_controller', 'publish'): ('command_topic',),
    ('arm_push_controller', 'subscribe'): ('tool_height_topic',),
    (WATCHDOG, 'publish'): ('output_topic',),
    (WATCHDOG, 'subscribe'): ('input_topic',),
}
TF = {'/tf', '/tf_static'}


def _read() -> dict[str, dict[str, set[str]]]:
    """Return the full names that the policy allows, by enclave and direction."""
    tree = etree.parse(ROOT / 'config' / 'sros2' / 'policy.xml')
    tree.xinclude()
    assert tree.getroot().attrib['version'] == '0.2.0'
    found = {}
    for enclave in tree.iter('enclave'):
        (profile,) = enclave.iter('profile')
        rules = found[enclave.attrib['path'].removeprefix('/hapticvision/')] = {}
        assert profile.attrib['ns'] == '/'
        for block in profile.iter('topics', 'services'):
            for direction in ('publish', 'subscribe', 'reply', 'request'):
                if block.get(direction) == 'ALLOW':
                    names = {_full(item.text, profile.attrib['node']) for item in block}
                    rules[direction] = rules.get(direction, set()) | names
    return found


def _full(name: str, node: str) -> str:
    if name.startswith('~'):
        return f'/{node}{name[1:]}'
    return name if name.startswith('/') else f'/{name}'


POLICY = _read()


def _source(node: str) -> ast.Module:
    return ast.parse((ROOT / 'hapticvision_ros' / 'nodes' / f'{node}.py').read_text())


def _imported(node: str) -> set[str]:
    """Return the names of the contract's topics and services that a node's module imports."""
    names: set[str] = set()
    for statement in ast.walk(_source(node)):
        if isinstance(statement, ast.ImportFrom) and statement.module == contract.__name__:
            for alias in statement.names:
                item = getattr(contract, alias.name)
                items = item if isinstance(item, tuple) else (item,)
                names |= {i.name for i in items if isinstance(i, Topic | Service)}
    return names


def _declared(node: str) -> set[tuple[str, str]]:
    """Return direction and name wherever the source names a contract constant at the call."""
    found = set()
    for call in ast.walk(_source(node)):
        if not isinstance(call, ast.Call) or len(call.args) < 2:
            continue
        kind = ast.unparse(call.func).rpartition('.')[2]
        if kind in DIRECTIONS and isinstance(call.args[1], ast.Name):
            item = getattr(contract, call.args[1].id, None)
            if isinstance(item, Topic | Service):
                found.add((DIRECTIONS[kind], item.name))
    return found


def _allowed(enclave: str, *directions: str) -> set[str]:
    return {name for item in directions for name in POLICY[enclave].get(item, ())}


def test_there_is_an_enclave_for_each_node_and_one_for_the_operator() -> None:
    assert set(POLICY) == {*NODES, WATCHDOG, OPERATOR}


@pytest.mark.parametrize('node', NODES)
def test_what_a_node_declares_is_allowed(node: str) -> None:
    assert _declared(node)
    for direction, name in _declared(node):
        assert name in _allowed(node, direction), (direction, name)


@pytest.mark.parametrize('node', NODES)
def test_of_the_contract_a_node_may_what_it_imports_and_no_more(node: str) -> None:
    allowed = _allowed(node, 'publish', 'subscribe', 'reply', 'request') & set(TABLE)
    assert allowed == _imported(node)


def test_each_topic_has_one_node_that_publishes_it_and_each_service_one_server() -> None:
    from_outside = {'/range_sensor/pose', '/emergency_stop'}
    for name, item in TABLE.items():
        verb = 'publish' if isinstance(item, Topic) else 'reply'
        servers = [node for node in NODES if name in _allowed(node, verb)]
        assert len(servers) == (0 if name in from_outside else 1), (name, servers)


def test_only_orchestrator_and_operator_may_ask_for_motion() -> None:
    controller = '/arm_push_controller'
    moving = {f'{controller}/{name}' for name in ('enable', 'start', 'retract')}
    moving |= {'/experiment/enable', '/experiment/start'}
    assert moving <= set(TABLE)
    for enclave in POLICY:
        asked = _allowed(enclave, 'request') & moving
        assert not asked or enclave in ('experiment_orchestrator', OPERATOR), enclave


@pytest.mark.parametrize('enclave', sorted(POLICY))
def test_what_is_outside_the_contract_is_named_by_a_parameter_or_common(enclave: str) -> None:
    for direction in ('publish', 'subscribe'):
        outside = _allowed(enclave, direction) - set(TABLE) - COMMON[direction]
        outside -= {'/arm_push_controller/transition_event'}
        if enclave == OPERATOR:
            outside -= {'/diagnostics', '/rosout', *TF}
        if enclave == 'contact_point_planner' and direction == 'subscribe':
            outside -= TF
        names = FOREIGN_PARAMETERS.get((enclave, direction), ())
        if names:
            content = yaml.safe_load((ROOT / 'config' / f'{enclave}.yaml').read_text())
            values = content['/**']['ros__parameters']
            assert {values[name] for name in names} == outside
        else:
            assert outside == set()


def test_the_operator_sees_every_topic_and_may_call_every_service() -> None:
    assert {t.name for t in (*TOPICS, *CELL_TOPICS)} <= _allowed(OPERATOR, 'subscribe')
    assert {service.name for service in SERVICES} <= _allowed(OPERATOR, 'request')
    assert _allowed(OPERATOR, 'publish') & set(TABLE) == {'/emergency_stop'}
