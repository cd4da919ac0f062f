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

"""Two cells on one network: namespaces keep them apart, and names can be remapped."""

from dataclasses import replace

from diagnostic_msgs.msg import DiagnosticArray
from hapticvision_ros.bag.contract import ENABLE, PHASE, PUSH, TOOL_HEIGHT, WRENCH
import pytest
from std_srvs.srv import SetBool, Trigger

PUSH_PARAMETERS = {
    'push_speed': 0.02,
    'depth': 0.002,
    'hold_time': 0.1,
    'recover_time': 0.1,
    'stale_time': 1.0,
    'heartbeat_time': 0.0,
}
REMAPPED = ('-r', 'load_cell/wrench:=force_torque/wrench')


def of(cell, item):
    """Return a topic or a service of a cell."""
    return replace(item, name=f'/{cell}{item.name}')


@pytest.fixture
def cells(start_world, start_node):
    """Start load cell and arm of two cells; the load cell of the second has another topic."""
    for cell, extra in (('cell1', ()), ('cell2', REMAPPED)):
        world = start_world('--object', 'spring1', '--force-rate', '200', '--arm-rate', '200')
        port = {'simulated_world_port': world.port}
        names = ('-r', f'__ns:=/{cell}', *extra)
        start_node('load_cell_driver', port, *names)
        start_node('arm_push_controller', port | PUSH_PARAMETERS, *names)


def test_a_push_in_one_cell_leaves_the_other_alone(cells, probe, until):
    phases = {cell: probe.listen(of(cell, PHASE)) for cell in ('cell1', 'cell2')}
    heights = {cell: probe.listen(of(cell, TOOL_HEIGHT)) for cell in ('cell1', 'cell2')}
    remapped = probe.listen(replace(WRENCH, name='/cell2/force_torque/wrench'))
    told = []
    probe.node.create_subscription(DiagnosticArray, '/diagnostics', told.append, 10)
    assert probe.call(of('cell2', ENABLE), SetBool.Request(data=True)).success
    until(
        lambda: probe.call(of('cell2', PUSH), Trigger.Request()).success,
        'a start with fresh readings',
    )
    until(lambda: any(item.data == 'push' for item in phases['cell2']), 'the touch')
    until(lambda: remapped, 'the remapped wrench')
    until(lambda: any(item.data == 'done' for item in phases['cell2']), 'the end of the push')
    assert not phases['cell1']
    low, high = min(item.data for item in heights['cell1']), 0.08
    # Encoder noise only.
    assert low == pytest.approx(high, abs=1e-4)
    refused = probe.call(of('cell1', PUSH), Trigger.Request())
    assert 'Motion is forbidden' in refused.message, 'what allows one cell does not allow another'
    names = {'cell1/arm_push_controller: push', 'cell2/arm_push_controller: push'}
    until(
        lambda: names <= {status.name for item in told for status in item.status},
        'the diagnostics of both cells',
    )
