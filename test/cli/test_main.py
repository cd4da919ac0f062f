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

"""The command line as a whole: verbs, exit codes, and how little it imports for help."""

import importlib
from importlib.metadata import version
import os
from pathlib import Path
import subprocess
import sys

from hapticvision_ros.cli.command import VERBS
from hapticvision_ros.cli.main import INTERRUPTED, main
from hapticvision_ros.core.errors import InputError
import pytest


def _fail_with(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    """Let the verb fit end with an error."""
    fit = importlib.import_module('hapticvision_ros.cli.fit')

    def fail(_: object) -> int:
        raise error

    monkeypatch.setattr(fit, 'run', fail)


def test_the_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['--version'])
    assert not ended.value.code
    assert capsys.readouterr().out == f'hapticvision_ros {version("hapticvision_ros")}\n'


def test_help_names_every_verb_and_ends_with_zero(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(['--help'])
    assert ended.value.code == 0
    shown = capsys.readouterr().out
    assert all(verb in shown for verb in VERBS)


@pytest.mark.parametrize(
    'arguments', [[], ['frobnicate'], ['fit'], ['fit', '--units', 'stone', 'a', '--out', 'b']]
)
def test_wrong_usage_is_one_sentence_and_exit_code_2(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    shown = capsys.readouterr()
    assert shown.out == ''
    assert len(shown.err.splitlines()) == 1
    assert shown.err.startswith('hapticvision: ')
    assert '--help' in shown.err


@pytest.mark.parametrize(
    'arguments',
    [['fit', 'a', '--out', ''], ['fit', '', '--out', 'b'], ['fit', 'a', '--out=']],
)
def test_an_empty_argument_is_no_folder(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    assert 'an argument is empty' in capsys.readouterr().err


@pytest.mark.parametrize('message', ['no such bag', 'no such bag.'])
def test_bad_input_is_one_sentence_and_exit_code_2(
    message: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail_with(monkeypatch, InputError(message))
    assert main(['fit', 'a', '--out', 'b']) == 2
    assert capsys.readouterr().err == 'hapticvision: no such bag.\n'


def test_an_interrupt_ends_with_130(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail_with(monkeypatch, KeyboardInterrupt())
    assert main(['fit', 'a', '--out', 'b']) == INTERRUPTED == 130
    assert 'Traceback' not in capsys.readouterr().err


@pytest.mark.parametrize('closed', ['>&-', '2>&-', '>&- 2>&-'])
def test_closed_streams_are_no_traceback(closed: str) -> None:
    code = "import sys; from hapticvision_ros.cli.main import main; sys.exit(main(['fit']))"
    shell = f'"$1" -c "$2" {closed}'
    run = ['sh', '-c', shell, 'sh', sys.executable, code]
    done = subprocess.run(run, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 2
    assert 'Traceback' not in done.stderr


def test_a_file_that_cannot_be_opened_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    _fail_with(monkeypatch, PermissionError(13, 'Permission denied', 'a/b'))
    assert main(['fit', 'a', '--out', 'b']) == 2
    assert capsys.readouterr().err == 'hapticvision: a/b: Permission denied.\n'


def test_an_interrupt_of_the_very_first_import_ends_with_130() -> None:
    # A Ctrl-C at the first import after that of the entry point itself.
    code = (
        'import signal, sys\n'
        'class Interrupt:\n'
        '    started = False\n'
        '    def find_spec(self, name, path=None, target=None):\n'
        '        if self.started:\n'
        '            sys.meta_path.remove(self)\n'
        '            print(name)\n'
        '            signal.raise_signal(signal.SIGINT)\n'
        "        self.started = name == 'hapticvision_ros.cli.main'\n"
        'sys.meta_path.insert(0, Interrupt())\n'
        'from hapticvision_ros.cli.main import main\n'
        "sys.exit(main(['--help']))\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == 'hapticvision: interrupted.\n'
    assert done.stdout == 'hapticvision_ros.threads\n'
    assert done.returncode == INTERRUPTED


def test_a_defect_of_the_package_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    _fail_with(monkeypatch, ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        main(['fit', 'a', '--out', 'b'])


def test_a_reader_that_leaves_early_is_no_error() -> None:
    # The shell's `| head -0`: the pipe is closed before anything is written.
    code = (
        'import os, sys\n'
        'from hapticvision_ros.cli import fit, main\n'
        "fit.run = lambda _: [print('x' * 100) for _ in range(10000)] and 0\n"
        "sys.exit(main.main(['fit', 'a', '--out', 'b']))\n"
    )
    process = subprocess.Popen(
        [sys.executable, '-c', code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    )
    assert process.stdout is not None and process.stderr is not None
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == b''
    assert process.wait(timeout=60) == 0


def test_what_a_terminal_cannot_show_is_replaced() -> None:
    code = (
        'import sys\n'
        'from hapticvision_ros.cli import fit, main\n'
        "fit.run = lambda _: print('1 \\u00b1 2') or 0\n"
        "sys.exit(main.main(['fit', 'a', '--out', 'b']))\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code],
        capture_output=True,
        text=True,
        env=os.environ | {'PYTHONIOENCODING': 'ascii'},
        check=False,
    )
    assert (done.returncode, done.stdout, done.stderr) == (0, '1 ? 2\n', '')


@pytest.mark.skipif(not Path('/dev/full').exists(), reason='needs a device that is always full')
def test_a_full_disk_behind_the_output_is_one_sentence() -> None:
    code = (
        'import sys\n'
        'from hapticvision_ros.cli import fit, main\n'
        "fit.run = lambda _: print('x') or 0\n"
        "sys.exit(main.main(['fit', 'a', '--out', 'b']))\n"
    )
    with Path('/dev/full').open('w', encoding='ascii') as full:
        done = subprocess.run(
            [sys.executable, '-c', code],
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 2
    assert done.stderr.startswith('hapticvision: the output cannot be written (')
    assert done.stderr.count('\n') == 1


def test_help_imports_no_numerics() -> None:
    code = (
        'import sys\n'
        'from hapticvision_ros.cli.main import main\n'
        'try:\n'
        "    main(['--help'])\n"
        'except SystemExit:\n'
        '    pass\n'
        "heavy = {'numpy', 'scipy', 'rclpy', 'rosbags', 'cv2', 'jinja2', 'yaml', 'mcap'}\n"
        'sys.exit(len(heavy & set(sys.modules)))\n'
    )
    done = subprocess.run(
        [sys.executable, '-c', code], stdout=subprocess.DEVNULL, timeout=60, check=False
    )
    assert done.returncode == 0
