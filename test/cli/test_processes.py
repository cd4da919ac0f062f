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

"""Processes that live and end together, tried with real ones."""

import os
from pathlib import Path
import signal
import subprocess
import sys
import time

from hapticvision_ros.cli import processes
from hapticvision_ros.cli.processes import ProcessError, Supervisor
import pytest

DEADLINE = 20.0


def python(code: str) -> list[str]:
    """Return the command that runs some code."""
    return [sys.executable, '-c', code]


SLEEPER = python('import time; print("ready", flush=True); time.sleep(600)')
STUBBORN = python(
    'import signal, time\n'
    'for number in (signal.SIGINT, signal.SIGTERM):\n'
    '    signal.signal(number, signal.SIG_IGN)\n'
    'print("ready", flush=True)\n'
    'time.sleep(600)'
)


def alive(pid: int) -> bool:
    """Return whether a process runs; a zombie does not."""
    try:
        state = Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0]
    except OSError:
        return False
    return state != 'Z'


def wait_until(condition, what: str) -> None:
    """Wait for a condition, with a deadline."""
    end = time.monotonic() + DEADLINE
    while not condition():
        assert time.monotonic() < end, f'{what} did not happen in {DEADLINE:g} s'
        time.sleep(0.02)


def test_each_line_is_shown_with_the_name_of_its_process():
    shown: list[str] = []
    with Supervisor(os.environ, shown.append) as supervisor:
        supervisor.start({'client': python('print("one"); print("two")')})
        assert supervisor.wait('client') == 0
    assert shown == ['[client] one', '[client] two']


def test_the_exit_code_of_the_client_is_told():
    with Supervisor(os.environ, [].append) as supervisor:
        supervisor.start({'peer': SLEEPER})
        supervisor.start({'client': python('raise SystemExit(7)')}, labelled=False)
        assert supervisor.wait('client') == 7


def test_a_peer_that_dies_is_named_and_the_others_are_stopped():
    shown: list[str] = []
    with (
        pytest.raises(ProcessError, match='peer ended with exit code 3') as caught,
        Supervisor(os.environ, shown.append) as supervisor,
    ):
        code = 'import os, time; print(os.getpid(), flush=True); time.sleep(600)'
        supervisor.start({'other': python(code)})
        pid = int(supervisor.wait_for_line('other', '', DEADLINE))
        supervisor.start({'peer': python('raise SystemExit(3)')})
        supervisor.wait()
    assert caught.value.exit_code != 0
    assert not alive(pid)


def test_a_peer_that_dies_is_started_again_as_often_as_asked(monkeypatch):
    monkeypatch.setattr(processes, 'STEADY', 0.0)
    shown: list[str] = []
    with (
        pytest.raises(ProcessError, match='peer ended with signal SIGKILL'),
        Supervisor(os.environ, shown.append) as supervisor,
    ):
        code = 'import os, signal; print("up", flush=True); os.kill(os.getpid(), signal.SIGKILL)'
        supervisor.start({'peer': python(code)}, restarts=2)
        supervisor.wait()
    assert shown.count('[peer] up') == 3
    assert shown.count('[peer] ended with signal SIGKILL; it is started again.') == 2


def test_a_peer_whose_middleware_is_deaf_is_started_again(tmp_path):
    shown: list[str] = []
    first = tmp_path / 'first'
    code = (
        f'import pathlib, time\nfirst = pathlib.Path({str(first)!r})\n'
        'print("[RTPS_TRANSPORT_SHM Error] Failed init_port fastrtps_port7002: no", flush=True)\n'
        'if not first.exists():\n'
        '    first.touch()\n'
        '    print("[RTPS_TRANSPORT_SHM Error] Failed init_port fastrtps_port7413", flush=True)\n'
        '    time.sleep(600)\n'
        'print("heard", flush=True)\n'
    )
    with (
        pytest.raises(ProcessError, match='peer ended with exit code 0'),
        Supervisor(os.environ, shown.append) as supervisor,
    ):
        supervisor.start({'peer': python(code)}, restarts=1)
        supervisor.wait()
    assert shown[-1] == '[peer] heard'


def test_ports_that_a_killed_process_has_not_finished_are_removed(tmp_path):
    names = ('fastrtps_port7002', 'sem.fastrtps_port7002_mutex', 'fastrtps_port7003')
    others = ('fastrtps_port7002_el', 'fastrtps_0153d4784640d019', 'fastrtps_port7004')
    for name in (*names, *others):
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (1e9, 1e9))
    # One that is whole, and one that is being made.
    (tmp_path / 'fastrtps_port7003').write_text('whole')
    os.utime(tmp_path / 'fastrtps_port7004')
    processes.remove_half_made_ports(tmp_path)
    left = {path.name for path in tmp_path.iterdir()}
    assert left == {*others, 'fastrtps_port7003'}


def test_a_peer_that_cannot_even_start_is_not_started_again():
    shown: list[str] = []
    with (
        pytest.raises(ProcessError, match='peer ended with exit code 2'),
        Supervisor(os.environ, shown.append) as supervisor,
    ):
        supervisor.start({'peer': python('print("up"); raise SystemExit(2)')}, restarts=2)
        supervisor.wait()
    assert shown == ['[peer] up']


def test_a_process_that_ends_before_it_is_ready_is_told_at_once():
    start = time.monotonic()
    with (
        pytest.raises(ProcessError, match='world ended with exit code 2 before it was ready'),
        Supervisor(os.environ, [].append) as supervisor,
    ):
        supervisor.start({'world': python('raise SystemExit(2)')})
        supervisor.wait_for_line('world', 'ready', 600.0)
    assert time.monotonic() - start < DEADLINE


def test_a_process_that_says_nothing_is_not_waited_for_longer_than_asked():
    with (
        pytest.raises(ProcessError, match=r'was not ready in 0\.2 s'),
        Supervisor(os.environ, [].append) as supervisor,
    ):
        supervisor.start({'world': python('import time; time.sleep(600)')})
        supervisor.wait_for_line('world', 'ready', 0.2)


def test_a_process_that_has_no_handlers_yet_is_stopped_without_a_word():
    shown: list[str] = []
    with Supervisor(os.environ, shown.append) as supervisor:
        supervisor.start({'sleeper': SLEEPER})
        supervisor.wait_for_line('sleeper', 'ready', DEADLINE)
    assert shown == ['[sleeper] ready']


def test_a_process_that_ignores_every_signal_is_killed():
    with Supervisor(os.environ, [].append) as supervisor:
        supervisor.start({'stubborn': STUBBORN}, grace=0.2)
        supervisor.wait_for_line('stubborn', 'ready', DEADLINE)
        pid = supervisor.pid('stubborn')
    assert not alive(pid)


@pytest.mark.parametrize(
    ('number', 'code'), [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGKILL, -9)]
)
def test_no_process_is_left_over_whatever_ends_the_supervisor(tmp_path, number, code):
    child = tmp_path / 'child_that_outlives.py'
    child.write_text(
        'import os, time\ndef main():\n    print(os.getpid(), flush=True)\n    time.sleep(600)\n',
    )
    parent = (
        'import os, sys\n'
        'from hapticvision_ros.cli.processes import program, Supervisor\n'
        'try:\n'
        '    with Supervisor(os.environ) as supervisor:\n'
        '        supervisor.start({"a": program("child_that_outlives")}, labelled=False)\n'
        '        supervisor.wait()\n'
        'except KeyboardInterrupt:\n'
        '    sys.exit(130)\n'
    )
    environment = os.environ | {'PYTHONPATH': str(tmp_path)}
    with subprocess.Popen(
        python(parent), env=environment, stdout=subprocess.PIPE, encoding='utf-8'
    ) as popen:
        assert popen.stdout is not None
        pid = int(popen.stdout.readline())
        assert alive(pid)
        popen.send_signal(number)
        assert popen.wait(DEADLINE) == code
        wait_until(lambda: not alive(pid), 'the end of the child')


def test_what_the_user_has_set_of_the_environment_stands(monkeypatch):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'SUBNET')
    monkeypatch.setenv('FASTRTPS_DEFAULT_PROFILES_FILE', 'mine.xml')
    environment = processes.ros_environment(domain=17)
    assert environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'SUBNET'
    assert environment['FASTRTPS_DEFAULT_PROFILES_FILE'] == 'mine.xml'
    assert environment['ROS_DOMAIN_ID'] == '17'


def test_discovery_stays_on_this_machine_unless_told_otherwise(monkeypatch):
    monkeypatch.delenv('ROS_AUTOMATIC_DISCOVERY_RANGE', raising=False)
    monkeypatch.delenv('FASTRTPS_DEFAULT_PROFILES_FILE', raising=False)
    environment = processes.ros_environment()
    assert environment['ROS_AUTOMATIC_DISCOVERY_RANGE'] == 'LOCALHOST'
    assert environment['FASTRTPS_DEFAULT_PROFILES_FILE'].endswith('fastdds_profile.xml')
