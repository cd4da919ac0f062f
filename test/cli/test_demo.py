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


"""The demo as a user runs it: real nodes, real bags, real data."""

from collections.abc import Iterator
import json
import os
from pathlib import Path
import signal
import subprocess
import sys
import threading
import time

from hapticvision_ros.cli import demo
from hapticvision_ros.cli.configuration import write_config
from hapticvision_ros.cli.main import main
import pytest

DOMAIN = '108'
DEADLINE = 90.0
"""Until nodes are up or down, also on a busy machine [s]."""
ONE_TRIAL = (
    *('--speeds', '0.004', '--depths', '0.008', '--repeats', '1'),
    *('--hold-time', '6', '--recover-time', '3', '--rest-time', '0'),
)


def processes_of(marker: str) -> list[int]:
    """Return the running processes that have `marker` in their environment."""
    found = []
    for folder in Path('/proc').iterdir():
        if not folder.name.isdigit():
            continue
        try:
            running = (folder / 'stat').read_text().rpartition(')')[2].split()[0] != 'Z'
            if running and marker.encode() in (folder / 'environ').read_bytes():
                found.append(int(folder.name))
        except OSError:
            continue
    return found


class Demo:
    """A demo in a process of its own, in a session of its own, with its lines as they come."""

    def __init__(self, out: Path) -> None:
        self.marker = f'HAPTICVISION_TEST_DEMO={out}'
        code = 'import sys; from hapticvision_ros.cli.main import main; sys.exit(main())'
        name, _, value = self.marker.partition('=')
        self.process = subprocess.Popen(
            [sys.executable, '-c', code, 'demo', '--out', str(out), '--domain', DOMAIN],
            env=os.environ | {name: value},
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self.lines: list[str] = []
        self.errors = ''
        self._readers = [
            threading.Thread(target=self._read, daemon=True),
            threading.Thread(target=self._read_errors, daemon=True),
        ]
        for reader in self._readers:
            reader.start()

    def _read(self) -> None:
        assert self.process.stdout is not None
        with self.process.stdout as stream:
            for line in stream:
                self.lines.append(line)

    def _read_errors(self) -> None:
        assert self.process.stderr is not None
        with self.process.stderr as stream:
            self.errors = stream.read()

    def wait_for(self, text: str) -> None:
        """Wait until a line holds `text`."""
        end = time.monotonic() + DEADLINE
        while not any(text in line for line in self.lines):
            assert self.process.poll() is None, ''.join(self.lines) + self.errors
            assert time.monotonic() < end, ''.join(self.lines)
            time.sleep(0.05)

    def code(self) -> int:
        """Return the exit code, and what it has said on standard error as `errors`."""
        code = self.process.wait(DEADLINE)
        for reader in self._readers:
            reader.join(DEADLINE)
        return code


@pytest.fixture
def running(tmp_path: Path) -> Iterator[Demo]:
    """Return a demo that records its first trial."""
    started = Demo(tmp_path)
    try:
        started.wait_for(': push,')
        yield started
    finally:
        started.process.kill()
        started.process.wait(DEADLINE)
        for pid in processes_of(started.marker):
            os.kill(pid, signal.SIGKILL)


def node_of(marker: str, name: str) -> int:
    """Return the process of a node."""
    (pid,) = (
        pid
        for pid in processes_of(marker)
        if name in Path(f'/proc/{pid}/cmdline').read_bytes().decode()
    )
    return pid


def test_ctrl_c_stops_everything(running: Demo) -> None:
    # Two processes at least are the demo and a node: the look for leftovers can find something.
    assert len(processes_of(running.marker)) > 7
    running.process.send_signal(signal.SIGINT)
    assert running.code() == 130
    assert processes_of(running.marker) == []
    assert 'Traceback' not in ''.join(running.lines) + running.errors


def test_the_demo_goes_on_with_a_node_that_died_and_says_so(running: Demo) -> None:
    os.kill(node_of(running.marker, 'phase_segmenter'), signal.SIGKILL)
    running.wait_for('ended with signal SIGKILL; it is started again.')
    running.wait_for(': release,')
    running.process.send_signal(signal.SIGINT)
    assert running.code() == 130
    assert processes_of(running.marker) == []
    assert 'Traceback' not in ''.join(running.lines) + running.errors


def test_the_demo_fits_what_it_has_just_recorded_and_real_data(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(demo, 'EXPERIMENT', ONE_TRIAL)
    monkeypatch.delenv(demo.SILICONE_VARIABLE, raising=False)
    monkeypatch.setattr(demo, 'SILICONE_FOLDER', Path('no', 'such', 'folder'))
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    assert main(['demo', '--out', str(tmp_path), '--domain', DOMAIN]) == 0
    said = capfd.readouterr().out
    (out,) = tmp_path.iterdir()
    for name in ('recorded', 'measured'):
        assert f'{out / name / "report.html"}\n' in said
        assert f'{out / name / "result.json"}\n' in said
        assert (out / name / 'report.html').stat().st_size > 10_000
    result = json.loads((out / 'recorded' / 'result.json').read_text())
    assert len(result['trials']) == 1
    paper = result['trials'][0]['paper']
    # The simulated dough relaxes with 2.0 s and keeps 6 N; the hold lasts three relaxation times.
    assert paper['tau_s'] == pytest.approx(2.0, rel=0.1)
    assert paper['Finf_N'] == pytest.approx(6.0, rel=0.05)
    measured = json.loads((out / 'measured' / 'result.json').read_text())
    # The one held out is listed with the others.
    assert len(measured['trials']) == 4
    assert 'ramp_1s (held out): the three-element model misses the force by' in said
    assert said.count('\nDiagnosis:\n') == 1


def test_the_silicone_trial_with_a_release_comes_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ('push_hold_P1.csv', 'push_hold_release_P3.csv', 'push_hold_release_P1.csv'):
        (tmp_path / name).touch()
    assert demo._silicone_csv(tmp_path) == tmp_path / 'push_hold_release_P1.csv'
    monkeypatch.setenv(demo.SILICONE_VARIABLE, str(tmp_path))
    assert demo._silicone_csv(None) == tmp_path / 'push_hold_release_P1.csv'


def test_a_measured_csv_goes_through_the_importer_and_the_fit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = ['time_s,force_N,displacement_mm']
    rows += [f'{0.1 * i:.1f},{min(i, 50) * 0.1:.3f},{min(i, 50) * 0.05:.3f}' for i in range(150)]
    csv = tmp_path / 'spring.csv'
    csv.write_text('\n'.join(rows) + '\n')
    title, bags = demo._measured_bags(csv, tmp_path / 'out')
    assert [bag.name for bag in bags] == ['spring']
    report, result = demo._fit(title, bags, tmp_path / 'out')
    assert report.is_file() and json.loads(result.read_text())['trials'][0]['bag']
    assert 'Imported' in capsys.readouterr().out


def test_only_the_last_runs_are_kept_and_nothing_else_is_touched(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [tmp_path / f'2026010{day}-120000' for day in range(1, 6)]
    for run in runs:
        write_config(run / 'config', demo.OWN_PARAMETERS)
        (run / 'bags').mkdir()
    for run in runs[:3]:
        (run / 'recorded').mkdir()
        (run / 'recorded' / 'result.json').touch()
    others = [tmp_path / '20250101-120000', tmp_path / 'mine']
    for folder in others:
        folder.mkdir()
        (folder / 'notes.txt').touch()
    demo._delete_old_runs(tmp_path)
    # With the one that is about to begin, three that come to an end, and the last that did not.
    assert sorted(tmp_path.iterdir()) == sorted([*runs[1:3], runs[4], *others])
    assert capsys.readouterr().out.count('Deleted the old run') == 2
    demo._delete_old_runs(tmp_path)
    assert len(list(tmp_path.iterdir())) == 5
    demo._delete_old_runs(tmp_path / 'nowhere')


def test_a_named_folder_without_data_is_told_before_anything_starts(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'out'
    assert main(['demo', '--out', str(out), '--silicone', str(tmp_path)]) == 2
    said = capsys.readouterr()
    assert 'holds no CSV file' in said.err and not said.out and not out.exists()


def test_a_folder_that_cannot_be_written_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'file').touch()
    assert main(['demo', '--out', str(tmp_path / 'file')]) == 2
    assert 'choose another --out' in capsys.readouterr().err
