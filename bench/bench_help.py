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

"""How long ``hapticvision --help`` takes, beside an empty start of the same interpreter."""

from pathlib import Path
from statistics import median
import subprocess
import sys
import time

ROUNDS = 15


def seconds(command: list[str]) -> float:
    """Return the wall time of one run [s]."""
    start = time.perf_counter()
    subprocess.run(command, stdout=subprocess.DEVNULL, check=True)
    return time.perf_counter() - start


def main() -> None:
    """Print both medians and their difference."""
    program = Path(sys.executable).with_name('hapticvision')
    commands = {
        'python -c pass': [sys.executable, '-c', 'pass'],
        'hapticvision --help': [str(program), '--help'],
    }
    # In turns, so that a busy machine slows both alike.
    rounds = [{name: seconds(c) for name, c in commands.items()} for _ in range(ROUNDS)]
    empty, helped = (median(r[name] for r in rounds) for name in commands)
    for name, duration in zip(commands, (empty, helped), strict=True):
        print(f'{name:20} {1e3 * duration:7.0f} ms')
    print(f'{"ratio":20} {helped / empty:7.2f}')


if __name__ == '__main__':
    main()
