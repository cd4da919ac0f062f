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

"""The table of faults and its verdicts."""

from dataclasses import replace

from hapticvision_ros.core.faults import (
    ARM,
    COLUMNS,
    Fault,
    markdown,
    Measured,
    NEAR,
    NODES,
    ORCHESTRATOR,
    PHASES,
    row,
    table,
    verdict,
)
from hapticvision_ros.nodes.fault_campaign import DEPTH, GARBAGE, SPEED
import pytest

MUST_STOP = Fault('distort', 'force', 'push', 'silent')
MAY_GO_ON = Fault('kill', 'phase_segmenter', 'push', must_stop=False)
GOOD = Measured(
    outcome='aborted',
    peak_force=12.0,
    force_limit=20.0,
    stopped=0.3,
    clear=0.4,
    bag_expected=True,
    readable=True,
    kept=2.0,
    lost=0.1,
)


def test_each_node_dies_in_each_phase():
    killed = {(fault.target, fault.phase) for fault in table() if fault.action == 'kill'}
    assert {pair for pair in killed if pair[1] != NEAR} == {
        (node, phase) for node in NODES for phase in PHASES
    }


def test_each_node_gets_garbage():
    assert {fault.target for fault in table() if fault.action == 'parameters'} == set(NODES)
    assert set(GARBAGE) == set(NODES)


def test_whatever_happens_near_the_limit_the_push_has_to_stop():
    near = [fault for fault in table() if fault.phase == NEAR]
    assert all(fault.must_stop for fault in near)
    assert {fault.action for fault in near} == {'kill', 'hang', 'distort', 'clock'}
    # What a push into the hard dough comes to that nobody stops.
    whole = replace(GOOD, peak_force=25.7)
    assert {verdict(fault, whole) for fault in near} == {'too much force'}


def test_the_table_has_at_least_sixty_cells_and_none_twice():
    lines = [f'{fault.name} in {fault.phase}' for fault in table()]
    assert len(lines) == len(set(lines)) >= 60


def test_what_is_as_it_has_to_be_is_safe():
    assert verdict(MUST_STOP, GOOD) == 'safe'


@pytest.mark.parametrize(
    ('change', 'said'),
    [
        ({'peak_force': 22.1}, 'too much force'),
        ({'stopped': 0.9}, 'went on'),
        ({'outcome': 'complete'}, 'was not noticed'),
        ({'clear': None}, 'left in contact'),
        ({'readable': False}, 'bag does not read back'),
        ({'lost': 1.1}, 'data lost'),
        ({'trouble': 'the moon fell down'}, 'the moon fell down'),
    ],
)
def test_what_is_not_is_named(change, said):
    assert verdict(MUST_STOP, replace(GOOD, **change)) == said


def test_a_fault_that_need_not_stop_the_push_may_let_it_go_on():
    assert verdict(MAY_GO_ON, replace(GOOD, stopped=5.0)) == 'safe'


def test_a_push_that_nobody_stopped_is_told():
    """The whole way of the campaign's pushes, to the end."""
    whole = replace(GOOD, outcome='complete', stopped=DEPTH / SPEED, clear=2.9)
    for fault in table():
        assert (verdict(fault, whole) == 'safe') != fault.must_stop, fault


def test_only_a_heartbeat_that_is_missed_takes_longer():
    killed = Fault('kill', ORCHESTRATOR, 'push')
    assert verdict(killed, replace(GOOD, outcome='no word', stopped=1.1)) == 'safe'
    assert verdict(killed, replace(GOOD, outcome='no word', stopped=1.3)) == 'went on'


def test_without_a_recording_no_bag_is_asked_for():
    assert verdict(MUST_STOP, replace(GOOD, bag_expected=False, readable=False)) == 'safe'


def test_the_force_over_the_limit_is_told():
    texts = row(Fault('kill', ARM, 'push'), replace(GOOD, peak_force=20.5))
    told = dict(zip(COLUMNS, texts, strict=True))
    assert (told['fault'], told['over limit [N]']) == ('arm_push_controller killed', '0.50')
    assert told['verdict'] == 'safe'
    page = markdown([texts]).splitlines()
    assert page[1] == '|' + ' --- |' * len(COLUMNS)
    assert page[2].startswith('| arm_push_controller killed | push | aborted | 20.50 | 0.50 |')
