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

from collections.abc import Sequence
from importlib import resources
import os
from pathlib import Path
import shutil
import struct
import subprocess
import sys
import time
from typing import Final

from hapticvision_ros.core.errors import HapticVisionError

VARIABLE: Final = 'HAPTICVISION_SET_CLOCK'
"""Names the file that tells by how much the clock is set."""
_SOURCE: Final = 'set_clock.c'
_COMPILERS: Final = ('cc', 'gcc', 'clang')
_SET_BY: Final = struct.Struct('q')
_TRIED: Final = 3600.0
"""By how much the clock is set to see whether it can be [s]."""


def clock_environment(folder: Path) -> dict[str, str]:
    """
    Return what must stand in the environment of processes whose clock can be set.

    Parameters
    ----------
    folder : Path
        Where the library and the file go.

    Returns
    -------
    dict of str to str
        Variables and their values.

    Raises
    ------
    HapticVisionError
        If the clock cannot be set here: there is no C compiler, or what it makes is not loaded.

    """
    compilers = [found for name in _COMPILERS if (found := shutil.which(name)) is not None]
    if not compilers:
        raise HapticVisionError(f'there is no C compiler ({", ".join(_COMPILERS)}): install one.')
    folder = folder.resolve()
    if any(sign in str(folder) for sign in ' :'):
        raise HapticVisionError(
            f"no library is loaded from a folder with a space or a colon in its name, '{folder}': "
            'choose another with --out.'
        )
    folder.mkdir(parents=True, exist_ok=True)
    library, file = folder / 'set_clock.so', folder / 'set_by'
    _compile(compilers, library)
    others = os.environ.get('LD_PRELOAD')
    preload = f'{library}:{others}' if others else str(library)
    environment = {'LD_PRELOAD': preload, VARIABLE: str(file)}
    file.write_bytes(_SET_BY.pack(round(_TRIED * 1e9)))
    code = 'import time; print(time.time())'
    seen = subprocess.run(
        [sys.executable, '-c', code],
        env=os.environ | environment,
        capture_output=True,
        text=True,
        check=False,
    ).stdout.strip()
    if not seen or abs(float(seen) - time.time() - _TRIED) > 0.5 * _TRIED:
        raise HapticVisionError(
            f'{library} is not loaded before the libraries of the system: choose a folder from '
            'which programs may be run with --out.'
        )
    file.write_bytes(_SET_BY.pack(0))
    return environment


def _compile(compilers: Sequence[str], library: Path) -> None:
    source = resources.files(__package__).joinpath(_SOURCE).read_bytes()
    said = ''
    for compiler in compilers:
        command = [compiler, '-O2', '-shared', '-fPIC', '-x', 'c', '-', '-o', str(library), '-ldl']
        made = subprocess.run(command, input=source, capture_output=True, check=False)
        if not made.returncode:
            return
        first = made.stderr.decode(errors='replace').strip().partition('\n')[0]
        said = said or f'{compiler} cannot make {library}: {first}'
    raise HapticVisionError(said)


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
