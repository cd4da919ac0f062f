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
"""Samples that are no measurement."""

from hapticvision_ros.core.outliers import absurd, FEWEST, median_of_five, possible
from hapticvision_ros.core.records import Signal
import numpy as np
import pytest


def press(noise: float = 0.05) -> np.ndarray:
    """Return a touch that jumps, a rise, a decay, and a release with a pull: span about 12 N."""
    t = np.linspace(0.0, 1.0, 2000)
    value = np.where((t > 0.2) & (t < 0.8), 7.0 + 4.0 * np.minimum(t - 0.2, 0.1) / 0.1, 0.0)
    value[t > 0.3] *= np.exp(-(t[t > 0.3] - 0.3) / 0.2)
    value[(t >= 0.8) & (t < 0.803)] = -1.0
    return value + noise * np.random.default_rng(1).standard_normal(t.size)


def timed(value: np.ndarray, interval: float = 1e-3) -> Signal:
    return Signal(interval * np.arange(value.size), value)


def test_the_median_of_five_is_that_of_numpy():
    value = np.random.default_rng(2).standard_normal(400)
    windows = np.lib.stride_tricks.sliding_window_view(value, 5)
    np.testing.assert_array_equal(median_of_five(value), np.median(windows, axis=1))


@pytest.mark.parametrize('noise', [0.0, 0.05, 1.0])
def test_what_an_object_does_is_no_glitch(noise):
    value = press(noise)
    assert not absurd(value, 1e-3).any()
    assert possible(timed(value)) is value
    pulse = press(noise)
    # A blow: one sample, twice the span.
    pulse[401] += 22.0
    assert not absurd(pulse, 1e-3).any()


@pytest.mark.parametrize(
    'at', [(0,), (10, 11), (399, 400), (401, 402), (1604, 1605), (1999,), (500, 501, 502, 503)]
)
@pytest.mark.parametrize('size', [60.0, -60.0, 1e9])
def test_what_no_object_does_is_found_wherever_it_is(at, size):
    value = press()
    clean = value.copy()
    value[list(at)] += size
    assert np.flatnonzero(absurd(value, 1e-3)).tolist() == list(at)
    assert np.abs(possible(timed(value)) - clean).max() < 8.0


def test_in_a_few_samples_nothing_is_usual():
    value = np.zeros(FEWEST - 1)
    value[3] = 1e9
    assert not absurd(value, 1e-3).any()


def test_a_short_push_in_a_long_record_is_a_push():
    value = 0.05 * np.random.default_rng(3).standard_normal(20000)
    value[5000:5060] += 8.0
    assert not absurd(value, 1e-3).any()


def test_a_push_of_a_few_samples_of_a_slow_sensor_is_a_push():
    value = 0.05 * np.random.default_rng(4).standard_normal(2000)
    value[700:706] += (8.0, 6.0, 5.0, 4.5, 4.0, 3.5)
    assert not absurd(value, 0.1).any()


def test_a_sensor_that_tells_only_steps_has_no_span_at_rest():
    value = np.zeros(20000)
    value[5000:5010] = 1.0
    value[7000] = 1.0
    assert not absurd(value, 1e-3).any()
