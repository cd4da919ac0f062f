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


"""Small matrices are no work for several threads."""

import os
import subprocess
import sys

import pytest

_NAMES = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
_ASK = f'import os; print([os.environ.get(name) for name in {_NAMES}])'


@pytest.mark.parametrize(
    ('first', 'given', 'expected'),
    [
        ('', {}, ['1', '1', '1']),
        ('', {'OMP_NUM_THREADS': '2'}, [None, '2', None]),
        ('import numpy; ', {}, [None, None, None]),
    ],
)
def test_linear_algebra_runs_in_one_thread_unless_told_otherwise(
    first: str, given: dict[str, str], expected: list[str | None]
) -> None:
    environment = {name: value for name, value in os.environ.items() if name not in _NAMES}
    script = f'{first}from hapticvision_ros.threads import one_thread; one_thread(); {_ASK}'
    done = subprocess.run(
        [sys.executable, '-c', script],
        env=environment | given,
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.strip() == str(expected)
