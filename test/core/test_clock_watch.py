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
"""The watch over the machine's clock."""

from hapticvision_ros.core.clock_watch import ClockWatch
import pytest

MS = 10**6


class Clocks:
    """A time of day and a time since the start of the machine, in steps of a microsecond."""

    def __init__(self) -> None:
        self.since_start, self.set_by, self.look = 5 * 10**12, 0, 1000

    def monotonic(self) -> int:
        self.since_start += self.look
        return self.since_start

    def day(self) -> int:
        return self.since_start + 17 * 10**17 + self.set_by

    def watch(self) -> ClockWatch:
        return ClockWatch(self.day, self.monotonic)


@pytest.fixture
def clocks() -> Clocks:
    return Clocks()


@pytest.mark.parametrize('set_by', [3600 * 10**9, -(10**9), 11 * MS, -11 * MS])
def test_a_clock_that_was_set_is_told_once(clocks, set_by):
    watch = clocks.watch()
    steps = [watch.step(), watch.step()]
    clocks.set_by = set_by
    steps += [watch.step(), watch.step()]
    assert steps == [0.0, 0.0, pytest.approx(set_by / 1e9, abs=1e-5), 0.0]


def test_a_clock_that_follows_its_source_slowly_was_not_set(clocks):
    watch = clocks.watch()
    for _ in range(100):
        clocks.set_by += 5 * MS
        assert watch.step() == 0.0


def test_who_is_held_up_between_the_two_clocks_looks_again(clocks):
    watch = clocks.watch()
    watch.step()
    clocks.set_by, clocks.look = 10**9, 50 * MS
    assert watch.step() == 0.0
    clocks.look = 1000
    assert watch.step() == pytest.approx(1.0, abs=1e-5)


def test_what_was_before_is_forgotten(clocks):
    watch = clocks.watch()
    watch.step()
    clocks.set_by = 10**9
    watch.forget()
    assert watch.step() == 0.0
