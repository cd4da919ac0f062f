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

"""The analysis of a campaign in a process of its own, and what is made of its end."""

from collections.abc import Iterator
from pathlib import Path
import sys
from typing import Any

from hapticvision_ros.core.autonomy import Cell
from hapticvision_ros.core.push_control import PushGoal, PushLimits
from hapticvision_ros.nodes.arm_push_controller import PARAMETERS
from hapticvision_ros.nodes.campaign_analysis import CampaignAnalysis
from hapticvision_ros.nodes.parameters import default_values
import pytest

BAG = Path(__file__).parents[2] / 'bags' / 'synthetic_soft_block' / 'speed_2mm_s_depth_6mm'

NO_PARAMETERS = (
    '{"status": "none", "effects": [], "sets": [], "parameters": [], "rest": [], "trials": 1}'
)


@pytest.fixture
def cell() -> Cell:
    """Return what the shipped arm allows."""
    values = default_values('arm_push_controller', PARAMETERS)
    limits = {name: values[name] for name in PushLimits.__dataclass_fields__}
    usual = {name: values[name] for name in PushGoal.__dataclass_fields__ if name in values}
    return Cell(PushLimits(**limits), PushGoal(**usual), 0.002, 0.002, 0.006, 8.0)


@pytest.fixture
def analysis(cell: Cell) -> Iterator[Any]:
    """Start analyses that end with the test; of what a line of Python says in place of one."""
    started: list[CampaignAnalysis] = []

    def start(code: str = '', bags: tuple[Path, ...] = (BAG,)) -> CampaignAnalysis:
        command = ((sys.executable, '-c', code),) if code else ()
        started.append(CampaignAnalysis(bags, cell, *command))
        return started[-1]

    yield start
    for each in started:
        each.drop()


def test_bags_are_analysed_in_another_process_without_those_that_cannot_be_read(
    analysis: Any, until: Any, tmp_path: Path
) -> None:
    (tmp_path / 'one.mcap').write_bytes(b'no bag')
    one = analysis(bags=(tmp_path / 'one.mcap', BAG))
    until(lambda: one.doing, 'something told')
    until(lambda: one.over, 'the end')
    assert one.error == ''
    assert one.findings is not None
    assert 'yield_force' in one.findings.effects
    assert one.findings.push is not None
    assert one.findings.repeat is not None
    assert one.findings.repeat.like == 1, 'the place among all bags'
    assert one.findings.warnings[0].startswith('one.mcap is left out: ')


def test_without_a_bag_that_can_be_read_there_is_no_answer(
    analysis: Any, until: Any, tmp_path: Path
) -> None:
    (tmp_path / 'one.mcap').write_bytes(b'no bag')
    one = analysis(bags=(tmp_path / 'one.mcap',))
    until(lambda: one.over, 'the end')
    assert one.findings is None
    assert 'one.mcap' in one.error
    assert 'Traceback' not in one.error


@pytest.mark.parametrize(
    ('code', 'says'),
    [
        ('import os; os.kill(os.getpid(), 9)', 'ended by signal 9 and gave no answer'),
        ('import os; os.abort()', 'ended by signal 6 and gave no answer'),
        ('import sys; sys.exit(3)', 'ended with exit code 3 and gave no answer'),
        ('print("found {}")', 'an answer that cannot be read'),
        ('print("found [")', 'an answer that cannot be read'),
        (f"print('found {NO_PARAMETERS}')", 'an answer that cannot be read'),
    ],
)
def test_a_process_that_dies_or_talks_nonsense_costs_the_answer_only(
    analysis: Any, until: Any, code: str, says: str
) -> None:
    one = analysis(code)
    until(lambda: one.over, 'the end')
    assert one.findings is None
    assert says in one.error


def test_it_is_dropped_at_once_whatever_it_is_doing(analysis: Any, until: Any) -> None:
    one = analysis('print("doing much", flush=True)\nwhile True: pass')
    until(lambda: one.doing == 'much', 'the work')
    assert not one.over
    one.drop()
    assert one.over
    assert one.findings is None


def test_the_compiling_of_kernels_is_told_apart_from_the_analysis(
    analysis: Any, until: Any
) -> None:
    module = 'hapticvision_ros.nodes.campaign_analysis'
    # As after an installation: what is compiled is not in the cache.
    code = (
        f'import sys, {module} as m\n'
        'from numba import njit\n'
        'def look(*args, **kwargs):\n'
        '    m._say("doing", "much")\n'
        '    inner = njit(lambda x: x + 1)\n'
        '    njit(lambda x: inner(x))(1)\n'
        '    sys.stdin.read()\n'
        'm._end_with_input = lambda: None\n'
        'm.look = look\n'
        'm.main()'
    )
    one = analysis(code)
    until(lambda: one.doing.startswith('compiling'), 'the compiling')
    until(lambda: one.doing == 'much', 'its end')
    took = one.compiled
    assert took > 0.0
    assert one.compiled == took, 'it goes on without'


def test_a_node_that_dies_leaves_no_analysis(analysis: Any, until: Any) -> None:
    # What the node holds open is the process's standard input.
    module = 'hapticvision_ros.nodes.campaign_analysis'
    code = (
        f'import json, {module} as m\n'
        'def look(*args, **kwargs):\n'
        '    m._say("doing", "much")\n'
        '    while True: pass\n'
        'm.look = look\n'
        'm.main()'
    )
    one = analysis(code)
    until(lambda: one.doing == 'much', 'the work')
    one._popen.stdin.close()
    until(lambda: one.over, 'the end')
    assert 'with exit code 1' in one.error
