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

"""The times of messages without a stamp, in a replay."""

from hapticvision_ros.nodes.clock import between_ticks, last_ticks
import numpy as np
import pytest

START = 946_684_800_000_000_000
NOW = 1_795_000_000_000_000_000


def test_a_tick_before_each_message_gives_its_time_whatever_the_pace():
    rng = np.random.default_rng(1)
    bag = START + np.cumsum(rng.integers(1_000_000, 9_000_000, 500))
    # A player that stops and hurries: the tick goes out at any time, the message after it.
    ticked = NOW + np.cumsum(rng.integers(10_000, 900_000, 500))
    sent = ticked + rng.integers(1, 9_000, 500)
    assert np.array_equal(last_ticks(sent, ticked, bag), bag)


@pytest.mark.parametrize('rate', [0.5, 1.0, 20.0])
def test_messages_between_periodic_ticks_are_placed_by_the_rate(rate):
    elapsed = np.arange(0, 2_000_000_000, 10_000_000)
    ticked = NOW + elapsed
    tick = START + np.rint(elapsed * rate).astype(np.int64)
    at = np.array([-5_000_000, 3_300_000, 1_234_567_890, 2_050_000_000])
    found = between_ticks(NOW + at, ticked, tick)
    # To the microsecond of bag time: an interpolation in doubles.
    assert found - START == pytest.approx(at * rate, abs=1000.0)


def test_a_message_before_the_first_tick_gets_the_first_tick():
    first = np.array([NOW - 5], dtype=np.int64)
    ticks = np.array([NOW], dtype=np.int64)
    bag = np.array([START], dtype=np.int64)
    assert last_ticks(first, ticks, bag)[0] == START
    assert between_ticks(first, ticks, bag)[0] == START - 5
