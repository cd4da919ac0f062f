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

"""What is watched on a stream of stamped readings: gaps, readings out of order, the rate."""

from dataclasses import dataclass

from hapticvision_ros.core.push_control import BACKWARD_STAMPS

_NS_PER_S = 1_000_000_000
_LEAST_WINDOW = 0.5
"""A rate is measured over this time at least [s]."""


@dataclass(slots=True)
class StreamHealth:
    """
    What a stream has shown so far.

    Parameters
    ----------
    taken : int
        Readings in order.
    gaps : int
        Times between two stamps that were too long.
    largest_gap : float
        The longest of them [s].
    not_newer : int
        Readings that were not newer than the one before, and left out.
    clock_jumps : int
        How often the stamps went back as those of a clock that was set.
    far_off : int
        Readings whose stamp was so far from now that they were left out, by whoever takes them.

    """

    taken: int = 0
    gaps: int = 0
    largest_gap: float = 0.0
    not_newer: int = 0
    clock_jumps: int = 0
    far_off: int = 0


class StreamMonitor:
    """
    Watches the stamps of a stream.

    Parameters
    ----------
    jump : float
        A stamp that lies back by more [s] is that of a clock that was set; what lies back less is
        old, unless `BACKWARD_STAMPS` in a row are: such a clock was set too.

    Attributes
    ----------
    health : StreamHealth
        What has been seen.
    gap : float
        Time between the last two stamps [s]; 0 where there is no such.

    """

    def __init__(self, jump: float) -> None:
        self.health = StreamHealth()
        self.gap = 0.0
        self._jump_ns = round(jump * _NS_PER_S)
        self._last_ns: int | None = None
        self._older = 0
        self._asked: tuple[float, int] | None = None
        self._rate: float | None = None

    def take(self, stamp_ns: int, largest_gap: float) -> bool:
        """
        Return whether a reading is newer than the one before.

        Parameters
        ----------
        stamp_ns : int
            Its stamp [ns since the epoch].
        largest_gap : float
            Time between two stamps above which readings are missing [s].

        """
        health, last_ns = self.health, self._last_ns
        self.gap = 0.0
        if last_ns is not None and stamp_ns <= last_ns:
            self._older += stamp_ns < last_ns
            if last_ns - stamp_ns <= self._jump_ns and self._older < BACKWARD_STAMPS:
                health.not_newer += 1
                return False
            health.clock_jumps += 1
        elif last_ns is not None:
            self.gap = (stamp_ns - last_ns) / _NS_PER_S
            if self.gap > largest_gap:
                health.gaps += 1
                health.largest_gap = max(health.largest_gap, self.gap)
        self._last_ns, self._older = stamp_ns, 0
        health.taken += 1
        return True

    def restart(self) -> None:
        """Expect no continuation: the device has gone."""
        self._last_ns = None

    def rate(self, now: float) -> float | None:
        """
        Return the readings each second since the last call [Hz], or None the first time.

        Where it is asked too soon, the answer is the last one.

        Parameters
        ----------
        now : float
            Monotonic time [s].

        """
        if self._asked is None:
            self._asked = (now, self.health.taken)
        elif now - self._asked[0] >= _LEAST_WINDOW:
            self._rate = (self.health.taken - self._asked[1]) / (now - self._asked[0])
            self._asked = (now, self.health.taken)
        return self._rate
