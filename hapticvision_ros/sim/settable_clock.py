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
A machine's clock that a campaign of faults can set, for the processes that it starts.

Setting the clock of the machine itself would take an administrator, and hit all else that runs on
it. What is set here is the clock that the processes see, by a library that is loaded before the
system's own, ``set_clock.c``.
"""

from importlib import resources
import os
from pathlib import Path
import shutil
import struct
import subprocess
from typing import Final

from hapticvision_ros.core.errors import HapticVisionError

VARIABLE: Final = 'HAPTICVISION_SET_CLOCK'
"""Names the file that tells by how much the clock is set."""
NO_COMPILER: Final = 'this machine has no C compiler (cc, gcc or clang).'
_SOURCE: Final = 'set_clock.c'
_COMPILERS: Final = ('cc', 'gcc', 'clang')
_SET_BY: Final = struct.Struct('q')


def clock_environment(folder: Path) -> dict[str, str] | None:
    """
    Return what must stand in the environment of processes whose clock can be set.

    Parameters
    ----------
    folder : Path
        Where the library and the file go.

    Returns
    -------
    dict of str to str, or None
        None if this machine has no C compiler.

    Raises
    ------
    HapticVisionError
        If the library cannot be made.

    """
    compiler = next(filter(None, map(shutil.which, _COMPILERS)), None)
    if compiler is None:
        return None
    folder.mkdir(parents=True, exist_ok=True)
    library, file = (folder / 'set_clock.so').resolve(), (folder / 'set_by').resolve()
    source = resources.files(__package__).joinpath(_SOURCE).read_bytes()
    command = [compiler, '-O2', '-shared', '-fPIC', '-x', 'c', '-', '-o', str(library), '-ldl']
    made = subprocess.run(command, input=source, capture_output=True, check=False)
    if made.returncode:
        said = made.stderr.decode(errors='replace').strip().partition('\n')[0]
        raise HapticVisionError(f'{compiler} cannot make {library}: {said}')
    file.write_bytes(_SET_BY.pack(0))
    others = os.environ.get('LD_PRELOAD')
    preload = f'{library}:{others}' if others else str(library)
    return {'LD_PRELOAD': preload, VARIABLE: str(file)}


def can_be_set() -> bool:
    """Return whether the clock that this process sees can be set."""
    return VARIABLE in os.environ


def set_clock(by: float) -> None:
    """
    Set the clock that this process and the others of its campaign see.

    Parameters
    ----------
    by : float
        How far it goes ahead of the machine's own [s].

    """
    # In place, since the processes have mapped it.
    with Path(os.environ[VARIABLE]).open('r+b') as file:
        file.write(_SET_BY.pack(round(by * 1e9)))
