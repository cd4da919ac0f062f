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

"""What an emulated load cell measures."""

from collections.abc import Callable
from contextlib import suppress
import threading

from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.sim.devices import connect_load_cell

type Wrench = tuple[float, float, float, float, float, float]
"""Force [N] and torque [N.m] in the frame `load_cell`."""
type Source = Callable[[], Wrench]

_TIMEOUT = 1.0


def no_load() -> Wrench:
    """Measure nothing."""
    return (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


def constant(wrench: Wrench) -> Source:
    """Return a source that always measures the same."""
    return lambda: wrench


class WorldSource:
    """
    What the load cell of a simulated world reads at present.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.

    Raises
    ------
    DeviceError
        If no world answers.

    """

    def __init__(self, port: int) -> None:
        self._cell = connect_load_cell(port)
        self._newest = no_load()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._follow, daemon=True)
        self._thread.start()

    def __call__(self) -> Wrench:
        """Return the newest reading."""
        return self._newest

    def close(self) -> None:
        """Let go of the world."""
        self._closing.set()
        self._thread.join()
        self._cell.close()

    def _follow(self) -> None:
        while not self._closing.is_set():
            # A world that has gone leaves its last reading.
            with suppress(DeviceError):
                newest = self._cell.read(_TIMEOUT)[-1]
                self._newest = (*newest.force, *newest.torque)
