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

"""
CPU time of ``hapticvision fit --model three-element`` on one bag, from start to report.

Beside it stand the imports that it cannot do without, in a process of their own: what they take is
the machine's measure. ``--against`` names another checkout, whose command runs in turns with this
one's.
"""

import argparse
import os
from pathlib import Path
from statistics import median
import subprocess
import sys
import tempfile
from typing import Final

ROOT: Final = Path(__file__).resolve().parents[1]
BAG: Final = ROOT / 'bags' / 'synthetic_soft_block' / 'speed_5mm_s_depth_8mm'
START: Final = 'import sys; from hapticvision_ros.cli.main import main; sys.exit(main())'


def cpu_seconds(command: list[str], root: Path) -> float:
    """Return the user and system time of one run [s]."""
    environment = {**os.environ, 'PYTHONPATH': str(root), 'OMP_NUM_THREADS': '1'}
    # Python keeps what it has made of the sources, as it does for a user.
    environment.pop('PYTHONDONTWRITEBYTECODE', None)
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, env=environment, cwd=root
    ) as process:
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise SystemExit(f'{" ".join(command)} failed: run it by hand to see why.')
    return usage.ru_utime + usage.ru_stime


def main() -> None:
    """Print the median and the least CPU time of each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=7)
    parser.add_argument('--bag', type=Path, default=BAG)
    parser.add_argument('--against', type=Path, help='another checkout of this repository')
    args = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        fit = [sys.executable, '-c', START, 'fit', '--model', 'three-element']
        fit += [str(args.bag.resolve()), '--out', folder]
        runs = {
            'python -c pass': ([sys.executable, '-c', 'pass'], ROOT),
            'import numpy, numba': ([sys.executable, '-c', 'import numpy, numba'], ROOT),
            'fit': (fit, ROOT),
        }
        if args.against is not None:
            runs['fit, the other'] = (fit, args.against.resolve())
        for command, root in runs.values():
            cpu_seconds(command, root)  # Kernels are compiled once for a machine.
        # In turns, so that a busy machine slows all alike.
        rounds = [
            {name: cpu_seconds(*run) for name, run in runs.items()} for _ in range(args.rounds)
        ]
    print(f'{"CPU time [s]":22} {"median":>7} {"least":>7}')
    for name in runs:
        times = [one[name] for one in rounds]
        print(f'{name:22} {median(times):7.2f} {min(times):7.2f}')


if __name__ == '__main__':
    main()
