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
from hapticvision_ros.sim import settable_clock
from hapticvision_ros.sim.settable_clock import clock_environment, set_clock, VARIABLE
import pytest

NEEDS_COMPILER = pytest.mark.skipif(
    not any(map(shutil.which, ('cc', 'gcc', 'clang'))), reason=settable_clock.NO_COMPILER
)
# A wait until a time of day by the C library itself, as the middleware has it.
TOLD = """
import ctypes, sys, time
libc = ctypes.CDLL(None)
mutex, condition = ctypes.create_string_buffer(64), ctypes.create_string_buffer(64)
end = (ctypes.c_long * 2)(int(time.time()) + 2, 0)
libc.pthread_mutex_lock(mutex)
print(time.time(), time.monotonic(), flush=True)
sys.stdin.readline()
print(time.time(), time.monotonic(), flush=True)
woken = 0
while libc.pthread_cond_timedwait(condition, mutex, end) == 0:
    woken += 1
print(time.time(), time.monotonic(), flush=True)
"""


@NEEDS_COMPILER
@pytest.mark.parametrize(('by', 'least', 'most'), [(3600.0, 0.0, 0.9), (-1.5, 1.6, 30.0)])
def test_processes_see_the_clock_that_was_set(tmp_path, monkeypatch, by, least, most):
    environment = clock_environment(tmp_path / 'clock')
    assert environment is not None
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
    monkeypatch.setattr(settable_clock.shutil, 'which', lambda name: None)
    assert clock_environment(tmp_path) is None


def test_a_compiler_that_fails_is_told(tmp_path, monkeypatch):
    compiler = tmp_path / 'cc'
    compiler.write_text('#!/bin/sh\necho "no headers here" >&2\nexit 1\n')
    compiler.chmod(0o755)
    monkeypatch.setenv('PATH', str(tmp_path), prepend=os.pathsep)
    with pytest.raises(HapticVisionError, match='no headers here'):
        clock_environment(Path(tmp_path, 'clock'))
