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

"""Numbered readings: which are new, which are lost, and when they were measured."""

from typing import Final

from hapticvision_ros.core.devices import StreamCounts
from hapticvision_ros.core.push_control import MeasuredTime

CONFIRM: Final = 10
"""So many readings in a row, numbered one by one, are a device that counts anew."""
NEAR: Final = 1000
"""A number this far behind is a reading that came late, one farther off is no number at all."""
LARGEST_JUMP: Final = 100_000
"""More readings than this are not lost at once: such a number is no number."""
LARGEST_DELAY_NS: Final = 50_000_000
"""Readings that seem delayed by more, one and all, have another rate than was said [ns]."""
PATIENCE_NS: Final = 1_000_000_000
"""For how long they have to seem so [ns]: a network may stall for a moment."""
CLOCK_JUMP_NS: Final = 10_000_000_000
"""A reading that seems delayed by more tells that this machine's clock was set [ns]."""
LEAST_STEP_NS: Final = 1000
"""Between the stamps of two readings lies at least this, unless the clock was set [ns]."""
MOST_AHEAD_NS: Final = 1_000_000
"""A last stamp that is further after an arrival tells that the clock was set back [ns]."""
OTHER_RATE: Final = 0.05
"""A mean rate that is off by this share is another rate."""
FOLLOWED_DRIFT: Final = 0.01
"""How far a rate that is followed may be off at a time [s/s]."""


class SequenceWatch:
    """
    Sorts out readings by the numbers that the device gives them.

    Parameters
    ----------
    counts : StreamCounts
        Where losses, late readings and restarts are counted.
    modulus : int
        The number at which the device begins again with zero.

    """

    def __init__(self, counts: StreamCounts, modulus: int = 2**32) -> None:
        self._counts = counts
        self._modulus = modulus
        self._last: int | None = None
        self._index = 0
        self._refused: int | None = None
        self._run = 0

    def take(self, number: int) -> int | None:
        """
        Return how many readings the device has measured until this one, or None to leave it out.

        Parameters
        ----------
        number : int
            The device's number of the reading.

        Returns
        -------
        int or None
            The first reading's is 0; lost ones count. None if the reading came again, came after
            a newer one, or has a number that cannot be.

        """
        if self._last is None:
            return self._accept(number, 0)
        step = (number - self._last) % self._modulus
        if 0 < step <= min(LARGEST_JUMP, self._modulus // 2):
            self._counts.lost += step - 1
            return self._accept(number, step)
        follows = self._refused is not None and (number - self._refused) % self._modulus == 1
        self._refused, self._run = number, self._run + 1 if follows else 1
        if self._run >= CONFIRM:
            self._counts.restarts += 1
            return self._accept(number, 1)
        if self._modulus - step <= NEAR or step == 0:
            self._counts.late += 1
        else:
            self._counts.garbled += 1
        return None

    def _accept(self, number: int, step: int) -> int:
        self._last = number
        self._index += step
        self._refused, self._run = None, 0
        return self._index


class ArrivalClock:
    """
    When numbered readings were measured, from when they arrived.

    The device measures at equal intervals, and what varies is the delay of the network or of a
    buffer: the fastest reading so far is taken to have come without delay.

    Parameters
    ----------
    rate : float
        Readings each second [Hz].
    exact : bool
        Whether the rate is that of a crystal. If not (the HX711's oscillator is good to a few
        percent), it is followed.

    """

    def __init__(self, rate: float, *, exact: bool = True) -> None:
        self._period = 1.0 / rate
        self._exact = exact
        self._started = False
        self._start_ns = self._checked_ns = self._delayed_since = self._last_ns = 0
        self._first = self._index = 0
        self._model = 0.0
        self._time = MeasuredTime()

    def restart(self) -> None:
        """Take the next reading as the first: the device has paused."""
        self._started = False

    def stamp(self, index: int, arrival_ns: int) -> int:
        """
        Return when a reading was measured [ns since the epoch].

        Parameters
        ----------
        index : int
            How many readings were measured before, lost ones among them.
        arrival_ns : int
            When it arrived [ns since the epoch].

        """
        if not self._started:
            self._begin(index, arrival_ns, self._period)
            return arrival_ns
        # Counted from the start, the seconds keep their nanoseconds in a float.
        arrival = (arrival_ns - self._start_ns) * 1e-9
        self._model += (index - self._index) * self._period
        self._index = index
        measured = self._start_ns + round(self._time.of(self._model, arrival) * 1e9)
        # Not after the arrival by the rounding.
        delay_ns = max(0, arrival_ns - measured)
        if self._is_another(delay_ns, arrival_ns):
            known = self._exact or delay_ns > CLOCK_JUMP_NS
            period = self._period if known else self._mean(index, arrival_ns)
            self._begin(index, arrival_ns, period)
            return arrival_ns
        if not self._exact:
            self._follow(index, arrival_ns)
        # A reading that is quicker than all before it must not overtake them, nor be at the same
        # time as others of its burst; after its arrival it is by microseconds at most.
        measured_ns, next_ns = arrival_ns - delay_ns, self._last_ns + LEAST_STEP_NS
        set_back = next_ns - arrival_ns > MOST_AHEAD_NS
        self._last_ns = measured_ns if set_back else max(measured_ns, next_ns)
        return self._last_ns

    def _is_another(self, delay_ns: int, arrival_ns: int) -> bool:
        """Return whether the delay tells of another rate, or of a clock that was set."""
        if delay_ns <= LARGEST_DELAY_NS:
            self._delayed_since = arrival_ns
        return delay_ns > CLOCK_JUMP_NS or arrival_ns - self._delayed_since > PATIENCE_NS

    def _follow(self, index: int, arrival_ns: int) -> None:
        """Take the mean interval since the beginning as the period, once in a second."""
        if not arrival_ns - self._checked_ns > PATIENCE_NS:
            return
        self._checked_ns = arrival_ns
        period = self._mean(index, arrival_ns)
        change = abs(period / self._period - 1.0)
        if change > OTHER_RATE:
            self._begin(index, arrival_ns, period)
        self._period = period

    def _mean(self, index: int, arrival_ns: int) -> float:
        """Return the mean interval since the beginning [s]."""
        return (arrival_ns - self._start_ns) * 1e-9 / max(1, index - self._first)

    def _begin(self, index: int, arrival_ns: int, period: float) -> None:
        self._started = True
        self._start_ns = self._checked_ns = self._delayed_since = self._last_ns = arrival_ns
        self._first = self._index = index
        self._period = period
        self._model = 0.0
        self._time = MeasuredTime() if self._exact else MeasuredTime(FOLLOWED_DRIFT)
        self._time.of(0.0, 0.0)
