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
Whether the machine's clock was set: its time of day against the time since its start.

The latter is never set. A clock that follows its source slowly gains or loses less from one look
to the next than is told here.
"""

from collections.abc import Callable
from typing import Final

NS_PER_S: Final = 1_000_000_000
STEP_NS: Final = 10_000_000
"""A clock that has gained or lost more from one look to the next was set [ns]."""
LOOK_NS: Final = 1_000_000
"""A look at both clocks that takes longer tells nothing [ns]."""


class ClockWatch:
    """
    Looks at both clocks again and again, and remembers the last look.

    Parameters
    ----------
    time_of_day, since_start : callable
        Return the time of day, and the time since the machine started [ns].

    """

    def __init__(self, time_of_day: Callable[[], int], since_start: Callable[[], int]) -> None:
        self._time_of_day, self._since_start = time_of_day, since_start
        self._offset_ns: int | None = None

    def forget(self) -> None:
        """Begin anew: what happened before the next look is not told."""
        self._offset_ns = None

    def step(self) -> float:
        """Return by how much the clock was set since the last look [s]; 0 if it was not."""
        before = self._since_start()
        offset_ns = self._time_of_day() - before
        if self._since_start() - before > LOOK_NS:
            # Held up between the two clocks.
            return 0.0
        last_ns, self._offset_ns = self._offset_ns, offset_ns
        if last_ns is None or abs(offset_ns - last_ns) <= STEP_NS:
            return 0.0
        return (offset_ns - last_ns) / NS_PER_S
