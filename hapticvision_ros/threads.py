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

"""How many threads the linear algebra of a process starts; imports nothing that starts any."""

import os
import sys
from typing import Final

_NUMBERS: Final = ('OPENBLAS_NUM_THREADS', 'OMP_NUM_THREADS', 'MKL_NUM_THREADS')
"""What says so, before numpy is loaded."""


def one_thread() -> None:
    """
    Have the linear algebra of this process and of those it starts run in the caller's thread.

    The matrices here are small. Threads that share one wait for each other without a pause, and
    where another process is at work, as on a cell, this takes tens of times as long as one thread.
    What the environment says stands, and so does what has been loaded already.
    """
    if 'numpy' not in sys.modules and not any(name in os.environ for name in _NUMBERS):
        for name in _NUMBERS:
            os.environ[name] = '1'
