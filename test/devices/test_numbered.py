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

"""Numbered readings: losses, restarts, and when they were measured."""

from hapticvision_ros.core.devices import StreamCounts
from hapticvision_ros.devices.numbered import ArrivalClock, CONFIRM, SequenceWatch
import numpy as np
import pytest

START_NS = 1_790_000_000_000_000_000


def _taken(numbers, modulus=2**32):
    counts = StreamCounts()
    watch = SequenceWatch(counts, modulus)
    return [watch.take(number) for number in numbers], counts


def test_lost_readings_are_counted_also_where_the_numbers_wrap():
    indices, counts = _taken([253, 254, 1, 2], modulus=256)
    assert indices == [0, 1, 4, 5]
    assert counts == StreamCounts(lost=2)
    indices, counts = _taken([2**32 - 1, 0, 1])
    assert (indices, counts.lost) == ([0, 1, 2], 0)


def test_a_reading_that_comes_again_or_late_is_left_out():
    indices, counts = _taken([10, 11, 11, 13, 12, 14])
    assert indices == [0, 1, None, 3, None, 4]
    assert (counts.lost, counts.late) == (1, 2)


def test_a_number_that_cannot_be_is_left_out_and_does_not_count_as_a_loss():
    indices, counts = _taken([10, 11, 3_000_000_000, 12, 13])
    assert indices == [0, 1, None, 2, 3]
    assert (counts.lost, counts.garbled) == (0, 1)


@pytest.mark.parametrize('last', [50, 500, 5_000_000])
def test_a_device_that_counts_anew_is_believed_after_some_readings(last):
    indices, counts = _taken([last, *range(1, CONFIRM + 5)])
    assert [index for index in indices if index is not None] == list(range(6))
    assert counts.restarts == 1
    assert counts.lost == 0


def _stamps(rate, arrivals, **options):
    """Return the error of each stamp [s] for arrivals [s] of readings 0, 1, 2..."""
    clock = ArrivalClock(rate, **options)
    return np.array(
        [
            (clock.stamp(index, START_NS + round(arrival * 1e9)) - START_NS) * 1e-9
            for index, arrival in enumerate(arrivals)
        ]
    )


def test_the_jitter_of_a_network_does_not_reach_the_stamps():
    random = np.random.default_rng(1)
    measured = np.arange(5000) / 1000.0
    # Most come at once, some wait for up to 20 ms, in their order.
    delays = random.exponential(0.001, 5000) * (random.random(5000) < 0.7)
    arrivals = np.maximum.accumulate(measured + delays)
    error = _stamps(1000.0, arrivals) - measured
    # The quickest of any few readings comes within 0.1 ms; the leak is 0.2 ms in a second.
    assert np.abs(error[100:]).max() < 2e-4
    assert (arrivals - measured)[100:].max() > 5e-3


def test_a_crystal_that_is_off_by_100_ppm_is_followed():
    measured = np.arange(60_000) / 1000.0 * (1.0 + 1e-4)
    error = _stamps(1000.0, measured) - measured
    assert np.abs(error).max() < 1e-6


def test_a_stall_of_the_network_leaves_the_stamps_where_they_were():
    measured = np.arange(2000) / 500.0
    arrivals = measured.copy()
    held = (measured >= 2.0) & (measured < 2.3)
    arrivals[held] = 2.3
    error = _stamps(500.0, arrivals) - measured
    # For 0.3 s the clocks may have run apart by 2e-4 of it.
    assert np.abs(error).max() < 1e-4


@pytest.mark.parametrize('jump', [-3600.0, 3600.0])
def test_when_this_machines_clock_is_set_the_stamps_go_with_it(jump):
    measured = np.arange(2000) / 500.0
    arrivals = measured + np.where(measured > 2.0, jump, 0.0)
    error = _stamps(500.0, arrivals) - arrivals
    assert np.abs(error).max() < 1e-6


@pytest.mark.parametrize('true_rate', [250.0, 490.0, 1000.0])
def test_a_rate_that_is_not_as_said_leaves_the_stamps_near_the_arrivals(true_rate):
    measured = np.arange(20 * int(true_rate)) / true_rate
    error = _stamps(500.0, measured) - measured
    assert error.max() <= 1e-9
    # While it waits a second to be sure, it falls behind by the difference of the rates.
    assert error.min() > -1.1


@pytest.mark.parametrize('true_rate', [72.0, 80.0, 88.0, 10.0])
def test_the_rate_of_an_oscillator_is_followed(true_rate):
    measured = np.arange(60 * int(true_rate)) / true_rate
    # An adapter's buffer hands its bytes over each 16 ms.
    arrivals = np.ceil(measured / 0.016) * 0.016
    error = _stamps(80.0, arrivals, exact=False) - measured
    settled = measured > 5.0
    assert np.abs(error[settled]).max() < 0.017
    assert np.all(np.diff(error + measured) > 0.0)


def test_readings_that_come_in_one_piece_get_stamps_one_after_the_other():
    measured = np.arange(4000) / 80.0
    arrivals = np.ceil(measured / 0.1) * 0.1
    stamps = _stamps(80.0, arrivals, exact=False)
    settled = measured > 10.0
    assert np.abs(np.diff(stamps[settled]) - 1.0 / 80.0).max() < 0.005
