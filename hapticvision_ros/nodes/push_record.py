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
A note on the disk that a push is under way, for the controller that takes the place of a dead one.

It says when it was last renewed, on a clock of the machine that cannot be set, in which start of
the machine, and for which arm. A controller that ends in order removes it.
"""

import contextlib
import json
import os
from pathlib import Path
import tempfile
import time
from typing import Final

from hapticvision_ros.report.writing import write_whole

RENEWAL: Final = 0.5
"""Time between two renewals [s]."""
_BOOT: Final = Path('/proc/sys/kernel/random/boot_id')


class PushRecord:
    """
    The note of one controller.

    Parameters
    ----------
    controller : str
        Which controller, among all of this user on this machine.
    arm : str
        Which arm it moves.
    folder : Path, optional
        Where the note lies; by default one of the user's own that does not outlive the machine's
        start for long.

    """

    def __init__(self, controller: str, arm: str, folder: Path | None = None) -> None:
        own = f'hapticvision_ros_{os.getuid()}'
        self._folder = Path(tempfile.gettempdir(), own) if folder is None else folder
        self._name = controller.strip('/').replace('/', '.') + '.push.json'
        self._arm = arm

    def renew(self) -> None:
        """
        Note that a push is under way now.

        Raises
        ------
        OSError
            If it cannot be written.

        """
        self._folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        note = {'boot': _boot(), 'time': time.monotonic(), 'arm': self._arm}
        write_whole(self._folder, [(self._name, json.dumps(note).encode())])

    def age(self) -> float | None:
        """Return how long ago a push of this arm was under way [s]; None if none is noted."""
        try:
            # What another user has put there moves no arm.
            if self._folder.stat().st_uid != os.getuid():
                return None
            note = json.loads((self._folder / self._name).read_bytes())
            if (note['boot'], note['arm']) != (_boot(), self._arm):
                return None
            age = time.monotonic() - float(note['time'])
        except (OSError, ValueError, KeyError, TypeError):
            return None
        return age if age >= 0.0 else None

    def remove(self) -> None:
        """Note that no push is under way; a note that cannot be removed grows old by itself."""
        # Called where a controller ends: nothing may keep it from stopping its arm.
        with contextlib.suppress(OSError):
            (self._folder / self._name).unlink()


def _boot() -> str:
    """Return what differs from one start of the machine to the next."""
    return _BOOT.read_text(encoding='ascii').strip()
