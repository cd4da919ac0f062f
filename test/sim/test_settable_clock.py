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
"""A clock that is set under processes that are running."""

import os
from pathlib import Path
import shutil
import subprocess
import sys
import time

from hapticvision_ros.core.errors import HapticVisionError
from hapticvision_ros.sim.settable_clock import clock_environment, set_clock, VARIABLE
import pytest

NEEDS_COMPILER = pytest.mark.skipif(
    not any(map(shutil.which, ('cc', 'gcc', 'clang'))), reason='there is no C compiler'
)
# A wait until a time of day by the C library itself, as the middleware has it.
TOLD = """
import ctypes, sys, time
libc = ctypes.CDLL(None)
mutex, condition = ctypes.create_string_buffer(64), ctypes.create_string_buffer(64)
end = (ctypes.c_long * 2)(int(time.time()) + 2, 0)
libc.pthread_mutex_lock(mutex)
def days():
    day = (ctypes.c_long * 2)()
    libc.gettimeofday(day, None)
    assert abs(day[0] - time.time()) < 1.5 and abs(libc.time(None) - time.time()) < 1.5
print(time.time(), time.monotonic(), flush=True)
days()
sys.stdin.readline()
days()
print(time.time(), time.monotonic(), flush=True)
woken = 0
while libc.pthread_cond_timedwait(condition, mutex, end) == 0:
    woken += 1
if libc.pthread_cond_timedwait(condition, mutex, end) == 0:
    sys.exit('the wait is not over')
semaphore = ctypes.create_string_buffer(64)
libc.sem_init(semaphore, 0, 0)
for wait in (libc.sem_timedwait, libc.pthread_mutex_timedlock):
    began = time.monotonic()
    soon = time.time() + 0.3
    until = (ctypes.c_long * 2)(int(soon), int(soon % 1.0 * 1e9))
    assert wait(semaphore if wait is libc.sem_timedwait else mutex, until) != 0
    assert 0.25 < time.monotonic() - began < 20.0
print(time.time(), time.monotonic(), flush=True)
"""


@NEEDS_COMPILER
@pytest.mark.parametrize(('by', 'least', 'most'), [(3600.0, 0.0, 0.9), (-1.5, 2.1, 30.0)])
def test_processes_see_the_clock_that_was_set(tmp_path, monkeypatch, by, least, most):
    environment = clock_environment(tmp_path / 'clock')
    monkeypatch.setenv(VARIABLE, environment[VARIABLE])
    process = subprocess.Popen(
        [sys.executable, '-c', TOLD],
        env=os.environ | environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        day, start = map(float, process.stdout.readline().split())
        assert day == pytest.approx(time.time(), abs=30.0)
        set_clock(by)
        out, _ = process.communicate('\n', timeout=60.0)
    finally:
        process.kill()
        process.wait()
    (set_day, set_at), (_, end) = (map(float, line.split()) for line in out.splitlines())
    assert set_day - day - (set_at - start) == pytest.approx(by, abs=0.01)
    # A wait of up to two seconds is over at once, or lasts longer by as much.
    assert least < end - start < most


def test_without_a_compiler_no_clock_is_set(tmp_path, monkeypatch):
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(HapticVisionError, match='there is no C compiler'):
        clock_environment(tmp_path / 'clock')
    assert not (tmp_path / 'clock').exists()


def compiler(folder: Path, name: str, script: str) -> None:
    """Put a program of this name into a folder."""
    program = folder / name
    program.write_text(f'#!/bin/sh\n{script}\n')
    program.chmod(0o755)


def test_a_compiler_that_fails_is_told(tmp_path, monkeypatch):
    compiler(tmp_path, 'cc', 'echo "no headers here" >&2; exit 1')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(HapticVisionError, match='no headers here'):
        clock_environment(tmp_path / 'clock')


def test_a_library_that_is_not_loaded_is_told(tmp_path, monkeypatch):
    compiler(tmp_path, 'cc', 'exit 0')
    monkeypatch.setenv('PATH', str(tmp_path))
    with pytest.raises(HapticVisionError, match='is not loaded'):
        clock_environment(tmp_path / 'clock')


@NEEDS_COMPILER
@pytest.mark.parametrize('name', ['a folder', 'a:folder'])
def test_a_folder_that_no_library_is_loaded_from_is_told(tmp_path, name):
    with pytest.raises(HapticVisionError, match='a space or a colon'):
        clock_environment(tmp_path / name)
