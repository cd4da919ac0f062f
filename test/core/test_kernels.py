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

"""Kernels work wherever the package is installed."""

import contextlib
import fcntl
from pathlib import Path
import subprocess
import sys
import time
from types import ModuleType

from hapticvision_ros.core import kernels
from hapticvision_ros.core.kernels import kept, kernel
from numba.core import caching
from numba.core.errors import TypingError
import pytest


def _double(x: float) -> float:
    return 2.0 * x


def test_a_kernel_works_where_no_cache_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CompileResultCacheImpl, '_locator_classes', [])
    assert kernel()(_double)(1.5) == 3.0


def test_a_kernel_keeps_what_is_compiled_and_frees_the_interpreter() -> None:
    compiled = kernel(error_model='numpy')(_double)
    assert compiled.targetoptions['nogil']
    assert compiled._cache.cache_path


def test_a_kernel_that_is_kept_comes_without_the_compiler(tmp_path: Path) -> None:
    source = tmp_path / 'summed.py'
    source.write_text(
        'import sys\n'
        'from hapticvision_ros.core.kernels import kernel\n'
        'import numpy as np\n'
        '@kernel()\n'
        'def summed(x):\n'
        '    twice = np.zeros(2)\n'
        '    twice[:] = x\n'
        '    return twice.sum()\n'
        'assert summed(1.5) == 3.0\n'
        'print(*(f"numba.{name}" in sys.modules for name in ("np.arrayobj", "cpython.unicode")))\n'
        'assert summed(3) == 6.0\n'
        'try:\n'
        '    summed("x")\n'
        'except Exception as error:\n'
        '    print(type(error).__name__)\n'
    )
    command = [sys.executable, '-c', 'import summed']
    said = [
        subprocess.run(
            command, cwd=tmp_path, capture_output=True, text=True, check=True
        ).stdout.split()
        for _ in range(2)
    ]
    # What is compiled after a kernel was read finds all that the compiler needs.
    assert said == [['True', 'True', 'TypingError'], ['False', 'False', 'TypingError']]


def test_of_processes_that_need_a_kernel_one_compiles_it(tmp_path: Path) -> None:
    (tmp_path / 'summed.py').write_text(
        'import sys\n'
        'from hapticvision_ros.core.kernels import kernel\n'
        'import numpy as np\n'
        '@kernel()\n'
        'def summed(x):\n'
        '    twice = np.zeros(2)\n'
        '    twice[:] = x\n'
        '    return twice.sum()\n'
        'print("ready", flush=True)\n'
        'sys.stdin.readline()\n'
        'assert summed(1.5) == 3.0\n'
        'print(sum(summed.stats.cache_misses.values()))\n'
    )
    command = [sys.executable, '-c', 'import summed']
    with contextlib.ExitStack() as stack:
        processes = [
            stack.enter_context(
                subprocess.Popen(
                    command,
                    cwd=tmp_path,
                    stdin=subprocess.PIPE,
                    stdout=subprocess.PIPE,
                    text=True,
                )
            )
            for _ in range(3)
        ]
        for process in processes:
            assert process.stdout is not None
            assert process.stdout.readline() == 'ready\n'
        for process in processes:
            assert process.stdin is not None
            process.stdin.write('go\n')
            process.stdin.flush()
        said = [process.communicate(timeout=300.0)[0].strip() for process in processes]
    assert sorted(said) == ['0', '0', '1']


def test_a_kernel_that_cannot_be_compiled_does_not_hold_up_others() -> None:
    compiled = kernel()(_double)
    compiled._cache.flush()
    with pytest.raises(TypingError):
        compiled('text')
    # Another one of the same function has a lock of its own.
    began = time.monotonic()
    assert kernel()(_double)(3) == 6.0
    assert time.monotonic() - began < kernels._LONGEST_WAIT / 2.0
    assert compiled(1.5) == 3.0


def test_what_cannot_be_kept_is_not_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    module = ModuleType(_double.__module__)
    module.double = kernel()(_double)  # type: ignore[attr-defined]
    module.double._cache.flush()
    assert not kept(module)
    module.double(1.5)
    assert kept(module)
    monkeypatch.setattr(caching.CompileResultCacheImpl, '_locator_classes', [])
    module.double = kernel()(_double)  # type: ignore[attr-defined]
    assert kept(module)


def test_a_kernel_works_where_no_lock_can_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*args: object) -> None:
        raise OSError('no locks available')

    monkeypatch.setattr(fcntl, 'flock', refuse)
    compiled = kernel()(_double)
    compiled._cache.flush()
    assert compiled(1.5) == 3.0


def test_what_another_package_keeps_does_not_ask_for_this_one(tmp_path: Path) -> None:
    (tmp_path / 'other.py').write_text(
        'import numba\n'
        '@numba.njit(cache=True)\n'
        'def double(x):\n'
        '    return 2.0 * x\n'
        'assert double(1.5) == 3.0\n'
        'assert sum(double.stats.cache_hits.values()) == hits\n'
    )
    for start in (
        'import hapticvision_ros.core.kernels; hits = 0',
        'import sys; sys.modules["hapticvision_ros"] = None; hits = 1',
    ):
        command = f'import builtins; {start}; builtins.hits = hits; import other'
        subprocess.run([sys.executable, '-c', command], cwd=tmp_path, check=True)
