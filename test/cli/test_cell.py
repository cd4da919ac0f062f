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

"""The verb `cell`: what it refuses, and that it starts and stops the whole cell."""

import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import time

from hapticvision_ros.cli.cell import NODES
from hapticvision_ros.cli.main import main
import pytest

HAPTICVISION = str(Path(sys.executable).with_name('hapticvision'))
DEADLINE = 90.0
"""Eight processes start and stop on a machine that may have two processors [s]."""


@pytest.fixture
def domain():
    """Give a ROS domain that no other test run uses."""
    for number in range(1, 100):
        with socket.socket() as lock:
            try:
                lock.bind(('127.0.0.1', 61000 + number))
            except OSError:
                continue
            yield number
            return
    pytest.fail('all ROS domains are taken by other test runs')


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['--speeds', '0.004'], 'add --run'),
        (['--run'], '--run needs --out'),
        (['--domain', '233'], 'a ROS domain lies in 0 to 232'),
        (['--config', '/nowhere'], 'is no folder'),
        (['--object', 'granite'], 'granite'),
        (['--run', '--out', 'x', '--speeds', '0.004', '5'], 'The push_speed is 5000 mm/s'),
        (['--run', '--out', 'x', '--speeds', 'nan'], 'speeds'),
        (['--run', '--out', 'x', '--depths', '0.1'], 'The depth is 100 mm'),
        (['--run', '--out', 'x', '--depths', '-0.005'], 'depths'),
        (['--run', '--out', 'x', '--repeats', '0'], 'repeats is 0'),
        (['--run', '--out', 'x', '--hold-time', '-1'], 'hold_time'),
        (['--run', '--out', 'x', '--hold-time', '1e5'], 'the cell allows 3600 s'),
        (['--run', '--out', 'x', '--autonomous', '--budget-trials', '0'], 'budget_trials is 0'),
        (['--run', '--out', 'x', '--autonomous', '--precision', 'nan'], 'precision is nan'),
        (['--run', '--out', 'x', '--precision', '0.1'], 'add --autonomous'),
    ],
)
def test_what_cannot_work_is_refused_before_anything_starts(arguments, says, capsys):
    assert main(['cell', *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1, 'one sentence'


def test_a_limit_of_the_users_own_is_kept(tmp_path, capsys):
    own = '/**: {ros__parameters: {max_speed: 0.005}}'
    (tmp_path / 'arm_push_controller.yaml').write_text(own)
    run = ['cell', '--run', '--out', 'x', '--config', str(tmp_path), '--speeds', '0.008']
    assert main(run) == 2
    assert 'up to 5 mm/s' in capsys.readouterr().err


def test_a_parameter_file_that_is_none_is_told(tmp_path, capsys):
    (tmp_path / 'arm_push_controller.yaml').write_text('- 1')
    assert main(['cell', '--run', '--out', 'x', '--config', str(tmp_path)]) == 2
    assert 'is no ROS parameter file' in capsys.readouterr().err


def running(parent: int) -> list[int]:
    """Return the processes that the kernel ends with `parent`, from their command lines."""
    found = []
    for entry in Path('/proc').iterdir():
        try:
            command = (entry / 'cmdline').read_bytes()
        except (OSError, NotADirectoryError):
            continue
        if entry.name.isdigit() and f'end_with({parent})'.encode() in command:
            found.append(int(entry.name))
    return found


def test_a_cell_that_is_killed_leaves_no_process(domain):
    # What Ctrl-C does the demo's tests see.
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain), 'OMP_NUM_THREADS': '1'}
    with subprocess.Popen(
        [HAPTICVISION, 'cell'],
        env=environment,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    ) as process:
        end = time.monotonic() + DEADLINE
        while len(running(process.pid)) < 1 + len(NODES):
            assert process.poll() is None
            assert time.monotonic() < end, 'the nodes did not start'
            time.sleep(0.1)
        process.kill()
        code = process.wait(DEADLINE)
        while running(process.pid):
            assert time.monotonic() < end + DEADLINE, 'processes are left over'
            time.sleep(0.1)
    assert code == -signal.SIGKILL
