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

"""The verb `replay`: what it refuses, and a bag from the command line to the numbers."""

import os
from pathlib import Path
import subprocess
import sys

from hapticvision_ros.cli.main import main
import pytest

HAPTICVISION = str(Path(sys.executable).with_name('hapticvision'))
BAG = Path(__file__).parents[2] / 'bags' / 'muscle_ramp_hold' / 'ramp_10s'
DOMAIN = '101'
"""No domain that the node tests take: they use 1 to 99."""


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        ([str(BAG), '--rate', '0'], '--rate is 0'),
        ([str(BAG), '--rate', 'nan'], '--rate is nan'),
        (['/nowhere/bag'], '/nowhere/bag'),
        ([str(BAG), '--domain', '-1'], 'a ROS domain lies in 0 to 232'),
    ],
)
def test_what_cannot_be_played_is_refused_before_anything_starts(arguments, says, capsys):
    assert main(['replay', *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1, 'one sentence'
    assert error.endswith('.\n') and not error.endswith('..\n')


def test_a_bag_goes_through_the_nodes_to_printed_numbers():
    done = subprocess.run(
        [HAPTICVISION, 'replay', str(BAG), '--rate', '50', '--domain', DOMAIN],
        env=os.environ | {'OMP_NUM_THREADS': '1'},
        capture_output=True,
        encoding='utf-8',
        timeout=120.0,
        check=False,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    lines = done.stdout.splitlines()
    assert any(line.startswith('relaxation_time') and line.endswith(' s') for line in lines)
    assert any(line.startswith('K1') and 'unknown: ' in line for line in lines)
