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

"""The verb ``fit``: what it writes, what it refuses, and what it leaves behind when it fails."""

import argparse
import errno
import io
import json
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys

from hapticvision_ros.bag.contract import DISPLACEMENT_HEIGHT, TOOL_HEIGHT
from hapticvision_ros.bag.writer import BagWriter
from hapticvision_ros.cli.fit import _check, add_arguments, Progress, write_json
from hapticvision_ros.cli.main import main
from hapticvision_ros.core.errors import UsageError
import pytest

BAGS = Path(__file__).parents[2] / 'bags'
SLOW = BAGS / 'muscle_ramp_hold' / 'ramp_10s'
FAST = BAGS / 'muscle_ramp_hold' / 'ramp_1s'
BASE = ('--model', 'three-element')
SOFT = sorted((BAGS / 'synthetic_soft_block').glob('speed_*'))


def _fit(*arguments: str | Path) -> int:
    return main(['fit', *(str(argument) for argument in arguments)])


def test_a_measured_trial_gives_a_table_a_result_and_a_report(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / 'new' / 'folder'
    assert _fit(SLOW, '--out', out, *BASE) == 0
    shown = capsys.readouterr()
    assert 'fitting the three-element model' in shown.err.splitlines()
    assert 'ramp_10s' in shown.out
    assert 'K1 [N/m]' in shown.out
    assert 'misses the force by' in shown.out
    assert 'in the hold' in shown.out
    assert 'the trial has no release' in shown.out
    result = json.loads((out / 'result.json').read_text())
    assert result['trials'][0]['bag'] == str(SLOW)
    assert result['trials'][0]['paper']['tau_s'] > 0.0
    assert result['trials'][0]['paper']['K1_N_m'] is None
    assert '<html' in (out / 'report.html').read_text()
    # Nothing else, no temporary file either.
    assert sorted(path.name for path in out.iterdir()) == ['report.html', 'result.json']


def test_a_fit_of_a_fixed_model_imports_only_what_it_needs(tmp_path: Path) -> None:
    # Each of these takes a tenth of a second to a whole one.
    heavy = (
        'cv2 matplotlib pandas rclpy scipy.integrate scipy.linalg scipy.optimize scipy.signal '
        'scipy.stats hapticvision_ros.core.diagnosis.search'
    )
    code = (
        'import sys\n'
        'from hapticvision_ros.cli.main import main\n'
        'code = main(sys.argv[2:])\n'
        'print("imported:", *set(sys.argv[1].split()) & set(sys.modules))\n'
        'sys.exit(code)\n'
    )
    # A kernel that was never compiled on this machine brings all of its compiler.
    assert _fit(SOFT[0], '--out', tmp_path, *BASE) == 0
    command = [sys.executable, '-c', code, heavy, 'fit', str(SOFT[0]), '--out', str(tmp_path)]
    done = subprocess.run([*command, *BASE], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == 'imported:'


def test_the_printed_units_change_and_the_file_does_not(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fit(SLOW, '--out', tmp_path / 'si', *BASE) == 0
    capsys.readouterr()
    assert _fit(SLOW, '--out', tmp_path / 'paper', '--units', 'paper', *BASE) == 0
    assert 'K1 [kgf/mm]' in capsys.readouterr().out
    files = [(tmp_path / name / 'result.json').read_bytes() for name in ('si', 'paper')]
    assert files[0] == files[1]


def test_a_bag_held_out_is_predicted_from_the_others(tmp_path: Path) -> None:
    assert _fit(SLOW, '--out', tmp_path, '--hold-out', FAST, *BASE) == 0
    result = json.loads((tmp_path / 'result.json').read_text())
    assert [trial['bag'] for trial in result['trials']] == [str(SLOW), str(FAST)]
    assert result['before']['error']['held_out']['force_rmse_N'] > 0.0
    assert result['held_out_by'] == 'name'


def test_a_named_model_is_fitted_beside_the_base_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fit(*SOFT, '--out', tmp_path, '--model', 'three-element+yield_force') == 0
    result = json.loads((tmp_path / 'result.json').read_text())
    assert result['diagnosis'] is None
    # The simulated block: K1 2000 N/m, C1 1600, C2 2400 N.s/m, a yield force of 6 N. The bags hold
    # 0.02 N of noise, which tells each to within 0.2 %.
    values = {name: p['value'] for name, p in result['after']['parameters'].items()}
    assert values == pytest.approx(
        {'K1': 2000.0, 'C1': 1600.0, 'C2': 2400.0, 'F_y': 6.0}, rel=5e-3
    )
    before, after = (result[name]['error']['held_out'] for name in ('before', 'after'))
    assert before['force_chi2'] > 100.0
    # The fit to one trial predicts the other to within the noise; 5800 samples tell it to 2 %.
    assert after['force_chi2'] == pytest.approx(1.0, abs=0.1)
    assert result['held_out_by'] == 'condition'
    assert result['held_out_change']['ratio'] < 0.01
    shown = capsys.readouterr().out
    assert re.search(r'three-element\+yield_force +(1 99|2 00)\d', shown.replace('\u202f', ' '))
    assert 'F_y [N]' in shown


def test_without_a_model_the_loop_is_closed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cell = ('--slowest', '0.003', '--fastest', '0.004', '--deepest', '0.005')
    cell += ('--longest-hold', '5')
    assert _fit(*SOFT, '--out', tmp_path, '--bootstrap', '1', *cell) == 0
    shown = capsys.readouterr()
    assert 'What the base model lacks is explained by yield_force.' in shown.out
    assert {'trying yield_force', 'bootstrap 1 of 1'} <= set(shown.err.splitlines())
    assert 'Of 1 campaigns that the base model simulates' in shown.out
    result = json.loads((tmp_path / 'result.json').read_text())
    # A block of three elements and a yield force of 6 N, with 0.02 N of noise.
    assert result['diagnosis']['status'] == 'explained'
    assert result['diagnosis']['effects'] == ['yield_force']
    assert result['diagnosis']['bootstrap']['p_value'] == 0.5
    push = result['diagnosis']['next_trial']
    assert 0.003 <= push['push_speed_m_s'] <= 0.004 + 1e-12
    assert 0.0 < push['depth_m'] <= 0.005 and 0.0 < push['hold_s'] <= 5.0
    assert push['repeats'] == 1
    assert result['after']['model'] == 'three-element+yield_force'
    assert result['after']['error']['held_out']['force_chi2'] == pytest.approx(1.0, abs=0.1)
    assert '<section id="diagnosis">' in (tmp_path / 'report.html').read_text()


def test_bags_of_one_name_in_two_folders_are_two_trials(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fit(SLOW, FAST, '--out', tmp_path / 'out', *BASE) == 0
    shutil.copytree(FAST, tmp_path / 'copies' / SLOW.name)
    assert (
        _fit(
            *(SLOW, tmp_path / 'copies' / SLOW.name),
            *('--out', tmp_path / 'twins', *BASE),
        )
        == 0
    )
    plain, twins = (
        json.loads((tmp_path / name / 'result.json').read_text()) for name in ('out', 'twins')
    )
    assert plain['before']['parameters'] == twins['before']['parameters']


def test_names_of_bags_need_not_be_utf_8(tmp_path: Path) -> None:
    odd = tmp_path / 'm\udce9' / 'p\udce9'
    shutil.copytree(SLOW, odd)
    assert _fit(odd, '--out', tmp_path / 'out', *BASE) == 0
    result = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert result['trials'][0]['bag'] == str(odd)
    assert r'p\udce9' in (tmp_path / 'out' / 'report.html').read_text()


class _Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_progress_leaves_no_trace_on_a_terminal_and_lines_elsewhere() -> None:
    for stream, said in (
        (_Terminal(), '\r\x1b[Kone ...\r\x1b[Ktwo ...\r\x1b[K'),
        (io.StringIO(), 'one\ntwo\n'),
    ):
        with Progress(stream) as progress:
            progress('one')
            progress('two')
        assert stream.getvalue() == said


def test_an_out_where_nothing_can_be_made_is_told_at_once(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Whatever its rights say, as below /proc; before bags are read that are not there."""
    assert main(['fit', str(tmp_path / 'none'), '--out', '/proc/hapticvision']) == 2
    assert 'cannot be written to' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('number', 'code', 'said'),
    [(signal.SIGINT, 130, 'interrupted'), (signal.SIGTERM, 143, 'ended by SIGTERM')],
)
def test_a_fit_that_is_ended_says_so_and_leaves_no_result(
    number: signal.Signals, code: int, said: str, tmp_path: Path
) -> None:
    command = [sys.executable, '-c', 'from hapticvision_ros.cli.main import main; exit(main())']
    process = subprocess.Popen(
        [*command, 'fit', *map(str, SOFT), '--out', str(tmp_path / 'out')],
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stderr is not None
    try:
        assert 'fitting' in process.stderr.readline()
        process.send_signal(number)
        errors = process.communicate(timeout=60.0)[1]
    finally:
        process.kill()
    assert process.returncode == code
    assert errors.splitlines()[-1] == f'hapticvision: {said}.'
    assert not (tmp_path / 'out').exists()


def test_every_bag_that_cannot_be_read_is_named_and_nothing_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    broken = tmp_path / 'broken.mcap'
    broken.write_bytes(b'not a bag at all')
    missing = tmp_path / 'missing.mcap'
    assert _fit(SLOW, broken, missing, '--out', tmp_path / 'out') == 2
    shown = capsys.readouterr()
    assert len(shown.err.splitlines()) == 1
    assert 'broken.mcap' in shown.err and 'missing.mcap' in shown.err
    assert shown.out == ''
    assert not (tmp_path / 'out').exists()


def test_every_bag_that_cannot_be_analysed_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [tmp_path / name / 'take_1' for name in ('monday', 'tuesday')]
    for number, bag in enumerate(short):
        with BagWriter(bag) as writer:
            for index in range(5):
                stamp = 10**9 + 10**7 * index
                writer.write_wrench(stamp, (0.0, 0.0, -1.0 - number))
                for topic in (TOOL_HEIGHT, DISPLACEMENT_HEIGHT):
                    writer.write_float64(topic, stamp, 0.01)
    assert _fit(short[0], SLOW, '--hold-out', short[1], '--out', tmp_path / 'out') == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert all(f'{bag}: the force has too few samples (5)' in error for bag in short)
    assert not (tmp_path / 'out').exists()


def test_bags_of_which_nothing_is_fitted_are_told_beside_what_they_tell(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A tool that comes down on nothing."""
    bag = tmp_path / 'nothing'
    with BagWriter(bag) as writer:
        for index in range(800):
            stamp = 10**9 + 5 * 10**6 * index
            writer.write_wrench(stamp, (0.0, 0.0, 0.01 * (-1.0) ** index))
            writer.write_float64(TOOL_HEIGHT, stamp, max(0.05 - 2e-5 * index, 0.04))
            writer.write_float64(DISPLACEMENT_HEIGHT, stamp, 0.03)
    assert _fit(bag, '--out', tmp_path / 'out') == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert 'there is no trial to fit: nothing: no contact was found' in error
    result = json.loads((tmp_path / 'out' / 'result.json').read_text())
    assert result['before']['parameters']['K1']['value'] is None


def test_a_turned_sign_is_the_reason_that_no_trial_is_fitted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = tmp_path / 'turned'
    with BagWriter(bag) as writer:
        for index in range(2400):
            stamp = 10**9 + 5 * 10**6 * index
            down = min(max(index - 400, 0), 800) if index < 2000 else -400.0
            writer.write_float64(TOOL_HEIGHT, stamp, 0.05 - 1e-5 * down)
            pressed = -5.0 * max(down, 0.0) / 800.0 + 0.01 * (-1.0) ** index
            # The load cell tells how the object pushes the tool: so it pulls.
            writer.write_wrench(stamp, (0.0, 0.0, -pressed))
    assert _fit(bag, '--out', tmp_path / 'out') == 2
    error = capsys.readouterr().err.splitlines()[-1]
    assert 'turned: no contact was found (the force falls by ' in error
    assert 'turn its sign)' in error


def test_bags_of_one_name_are_told_apart_by_their_paths(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bags = [tmp_path / day / 'take_1' for day in ('monday', 'tuesday')]
    for bag, original in zip(bags, (SLOW, FAST), strict=True):
        shutil.copytree(original, bag)
    assert _fit(*bags, '--model', 'three-element', '--out', tmp_path / 'out') == 0
    lines = capsys.readouterr().out.splitlines()
    for bag in bags:
        assert any(line.startswith(f'{bag}: the three-element model misses') for line in lines)


def test_a_bag_named_twice_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    link = tmp_path / 'link'
    link.symlink_to(SLOW)
    assert _fit(SLOW, link, '--out', tmp_path) == 2
    assert 'named twice' in capsys.readouterr().err


def test_a_bag_that_is_held_out_may_be_named_with_all_others(tmp_path: Path) -> None:
    parser = argparse.ArgumentParser()
    add_arguments(parser)
    out = ['--out', str(tmp_path / 'out')]
    args = parser.parse_args(['a', './b', 'c', '--hold-out', 'b', *out])
    _check(args)
    assert args.bags == [Path('a'), Path('c')]
    args = parser.parse_args(['a', 'b', '--hold-out', 'b', 'a', *out])
    with pytest.raises(UsageError, match='names every bag'):
        _check(args)


def test_nothing_is_written_into_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bag = tmp_path / 'bag'
    shutil.copytree(SLOW, bag)
    held = sorted(bag.iterdir())
    for out in (bag, bag / 'results', tmp_path / 'other' / '..' / 'bag'):
        assert _fit(SLOW, '--out', out) == 2
        assert f'is in the bag {bag}: choose another folder' in capsys.readouterr().err
    assert sorted(bag.iterdir()) == held


def test_a_copy_of_a_recording_is_no_second_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / 'again'
    shutil.copytree(SLOW, copy)
    assert _fit(SLOW, copy, '--out', tmp_path / 'out') == 2
    assert f'{copy} holds the same recording as {SLOW}' in capsys.readouterr().err


@pytest.mark.parametrize(
    ('model', 'complaint'),
    [
        ('four-element', 'no model'),
        ('three-element+yield_farce', 'no effect'),
        ('three-element+damage+damage', 'named twice'),
        ('three-element+', 'no effect'),
        ('three-element+yield_force+springpot', 'choose one'),
    ],
)
def test_a_model_that_cannot_be_is_refused_before_a_bag_is_read(
    model: str, complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fit(tmp_path / 'missing', '--out', tmp_path, '--model', model) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert complaint in error and error.endswith('.')


@pytest.mark.parametrize(
    ('more', 'complaint'), [(('0',), 'one campaign or more'), (('5', *BASE), 'leave one out')]
)
def test_a_bootstrap_of_nothing_is_refused(
    more: tuple[str, ...],
    complaint: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert _fit(tmp_path / 'missing', '--out', tmp_path, '--bootstrap', *more) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert complaint in error


@pytest.mark.parametrize(
    ('limits', 'complaint'),
    [
        (('--fastest', '0'), '--fastest 0: give a number above 0.'),
        (('--longest-hold', 'inf'), '--longest-hold inf: give a number above 0.'),
        (('--slowest', '0.2', '--fastest', '0.1'), '--slowest is above --fastest'),
        (('--deepest', '0.01', *BASE), 'leave one out'),
    ],
)
def test_limits_of_no_cell_are_refused(
    limits: tuple[str, ...], complaint: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _fit(tmp_path / 'missing', '--out', tmp_path, *limits) == 2
    (error,) = capsys.readouterr().err.splitlines()
    assert complaint in error


def test_an_out_that_cannot_be_a_folder_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'file').write_text('here')
    assert _fit(SLOW, '--out', tmp_path / 'file') == 2
    assert _fit(SLOW, '--out', tmp_path / 'file' / 'below') == 2
    errors = capsys.readouterr().err.splitlines()
    assert len(errors) == 2
    assert all('--out' in error for error in errors)
    assert (tmp_path / 'file').read_text() == 'here'


def test_a_disk_that_is_too_full_for_the_page_has_the_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, 'No space left on device')

    (tmp_path / 'report.html').write_text('of another result')
    monkeypatch.setattr('hapticvision_ros.report.page.write_whole', full)
    assert _fit(SLOW, '--out', tmp_path, *BASE) == 2
    said = capsys.readouterr().err
    assert 'No space left' in said and said.endswith(f'{tmp_path / "result.json"} is written.\n')
    assert json.loads((tmp_path / 'result.json').read_text())['trials']
    assert not (tmp_path / 'report.html').exists()


def test_a_result_is_replaced_as_a_whole_or_not_at_all(tmp_path: Path) -> None:
    path = tmp_path / 'result.json'
    write_json(path, {'a': 1})
    with pytest.raises(ValueError, match='JSON'):
        write_json(path, {'a': float('nan')})
    assert json.loads(path.read_text()) == {'a': 1}
    assert [file.name for file in tmp_path.iterdir()] == ['result.json']
