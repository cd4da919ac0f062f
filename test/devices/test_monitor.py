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

"""What is watched on a stream."""

from hapticvision_ros.core.push_control import BACKWARD_STAMPS
from hapticvision_ros.devices.monitor import StreamHealth, StreamMonitor
import pytest

MS = 1_000_000


def _health(stamps_ms):
    monitor = StreamMonitor(jump=1.0)
    taken = [monitor.take(stamp * MS, 0.02) for stamp in stamps_ms]
    return taken, monitor.health


def test_gaps_are_counted_and_old_readings_left_out():
    taken, health = _health([0, 1, 2, 2, 1, 40, 41, 100])
    assert taken == [True, True, True, False, False, True, True, True]
    assert health == StreamHealth(taken=6, gaps=2, largest_gap=0.059, not_newer=2)


def test_a_clock_that_is_set_back_does_not_silence_the_stream():
    taken, health = _health([3_600_000, 3_600_001, 5, 6])
    assert all(taken)
    assert health.clock_jumps == 1
    assert health.gaps == 0


@pytest.mark.parametrize('back', [50, 400, 999])
def test_a_clock_that_is_set_back_a_little_is_found_out_in_a_few_readings(back):
    stamps = [*range(2000), *range(2000 - back, 4000 - back)]
    taken, health = _health(stamps)
    few = BACKWARD_STAMPS - 1
    assert taken == [True] * 2000 + [False] * few + [True] * (2000 - few)
    assert (health.clock_jumps, health.not_newer, health.gaps) == (1, few, 0)


def test_readings_that_change_places_or_come_twice_are_no_clock():
    stamps = [stamp for k in range(0, 200, 2) for stamp in (k + 1, k, k + 1, k + 1)]
    _, health = _health(stamps)
    assert (health.clock_jumps, health.taken) == (0, 100)


def test_after_a_loss_there_is_no_gap():
    monitor = StreamMonitor(jump=1.0)
    monitor.take(0, 0.02)
    monitor.restart()
    monitor.take(5000 * MS, 0.02)
    assert monitor.health.gaps == 0


def test_the_rate_is_that_since_the_last_look():
    monitor = StreamMonitor(jump=1.0)
    assert monitor.rate(10.0) is None
    for stamp in range(100):
        monitor.take(stamp * MS, 0.02)
    assert monitor.rate(10.5) == pytest.approx(200.0)
    assert monitor.rate(10.6) == pytest.approx(200.0)
    assert monitor.rate(11.0) == 0.0
