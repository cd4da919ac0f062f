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

"""The verb `faults`: what it refuses, and some cells of its table on a live cell."""

import json
import os
from pathlib import Path
import shutil
import socket
import subprocess
import sys

from hapticvision_ros.cli.faults import LEFT_OUT
from hapticvision_ros.cli.main import main
import pytest

HAPTICVISION = str(Path(sys.executable).with_name('hapticvision'))
DEADLINE = 240.0
"""Eight processes start, and seven trials are made, on a machine that may be busy [s]."""
CLOCK = "machine's clock set an hour back in push"
CELLS = (
    'arm_push_controller killed in push',
    'load_cell_driver killed in push',
    'experiment_orchestrator killed in hold',
    'force silent in near the limit',
    CLOCK,
    'phase_segmenter gets garbage parameters in push',
    # What comes last shows that all of them came back.
    'disk: full in push',
)


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


def test_a_fault_that_is_not_in_the_table_is_told(capsys):
    assert main(['faults', '--only', 'flood']) == 2
    assert 'fits no fault' in capsys.readouterr().err


def test_the_table_is_shown_without_running_it(capsys):
    assert main(['faults', '--list', '--only', 'emergency', 'full']) == 0
    lines = capsys.readouterr().out.splitlines()
    assert 'emergency stop in hold' in lines and 'disk: full in push' in lines
    assert len(lines) == 7


def test_without_a_compiler_no_clock_is_set(tmp_path, capsys, monkeypatch):
    monkeypatch.setenv('PATH', str(tmp_path))
    out = tmp_path / 'out'
    assert main(['faults', '--out', str(out), '--only', 'clock set']) != 0
    assert 'there is no C compiler' in capsys.readouterr().err
    assert not out.exists()


def test_a_few_faults_on_a_live_cell(domain, tmp_path):
    done = subprocess.run(
        [
            HAPTICVISION,
            'faults',
            '--out',
            str(tmp_path),
            '--domain',
            str(domain),
            '--only',
            *CELLS,
        ],
        env=os.environ | {'OMP_NUM_THREADS': '1'},
        capture_output=True,
        text=True,
        timeout=DEADLINE,
        check=False,
    )
    (folder,) = tmp_path.iterdir()
    rows = json.loads((folder / 'faults.json').read_text())
    lines = [f'{row[0]} in {row[1]}' for row in rows]
    if LEFT_OUT in done.stdout:
        assert not any(map(shutil.which, ('cc', 'gcc', 'clang')))
        lines.append(CLOCK)
    assert sorted(lines) == sorted(CELLS)
    for fault, _, outcome, *_, clear, kept, lost, verdict in rows:
        # What depends on the speed of this machine, such as the time to safe, is not asked for.
        assert verdict in ('safe', 'went on'), fault
        goes_on = 'garbage parameters' in fault
        assert outcome in (('complete',) if goes_on else ('aborted', 'no word')), fault
        assert clear != '-', fault
        assert float(kept) > 0.0 and float(lost) < 1.0, fault
    assert done.returncode in (0, 1), done.stdout + done.stderr
    assert '| arm_push_controller killed | push |' in (folder / 'faults.md').read_text()
