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

"""What a load cell makes of a hum, and of what it follows late, against fine integration."""

from hapticvision_ros.core.models.sampling import hum, lag
import numpy as np
import pytest
from scipy.signal import lfilter

AMPLITUDE, FREQUENCY, PHASE = 0.5, 50.3, 0.4


def _mean(t: np.ndarray, amplitude: float, frequency: float, phase: float) -> np.ndarray:
    """Return the mean over each step by the cosine at its ends."""
    angle = 2.0 * np.pi * frequency * (t - 0.5 * (t[0] + t[-1])) + phase
    return -amplitude * np.diff(np.cos(angle)) / (2.0 * np.pi * frequency * np.diff(t))


@pytest.mark.parametrize('jitter', [0.0, 2e-11, 1e-9, 3e-4])
def test_a_hum_is_averaged_over_even_and_uneven_steps(jitter: float) -> None:
    # Even steps near the ends, long ones in between, as a fit has them.
    widths = np.concatenate([np.full(5000, 1e-3), np.repeat(np.arange(1, 60) * 1e-3, 7)])
    t = np.concatenate([[0.0], np.cumsum(np.concatenate([widths, widths[::-1]]))])
    t += jitter * np.random.default_rng(3).uniform(-1.0, 1.0, t.size)
    numbers = np.array([AMPLITUDE, FREQUENCY, PHASE])
    value, tangents = np.zeros(t.size - 1), np.zeros((3, t.size - 1))
    hum(t, *numbers, value, tangents, 0, 1, 2)
    # Steps whose lengths differ by less than 1e-9 of them share weights.
    assert np.abs(value - _mean(t, *numbers)).max() < 1e-9
    for row, size in enumerate((0.1, 1e-5, 1e-5)):
        sides = [numbers.copy(), numbers.copy()]
        sides[0][row] -= size
        sides[1][row] += size
        slope = (_mean(t, *sides[1]) - _mean(t, *sides[0])) / (2.0 * size)
        # A central difference: the square of its step, and rounding over it.
        assert np.abs(tangents[row] - slope).max() < 1e-6 * np.abs(slope).max() + 1e-10 / size


def test_a_hum_without_derivatives_is_the_same() -> None:
    t = np.arange(0.0, 2.0, 1e-3)
    values = np.zeros((2, t.size - 1))
    hum(t, AMPLITUDE, FREQUENCY, PHASE, values[0], np.zeros((3, t.size - 1)), 0, 1, 2)
    hum(t, AMPLITUDE, FREQUENCY, PHASE, values[1], np.zeros((0, t.size - 1)), -1, -1, -1)
    assert np.array_equal(*values)


@pytest.mark.parametrize('at', [0.1, 0.5, 0.9])
@pytest.mark.parametrize('time_constant', [0.05, 0.3, 2.0, 20.0])
def test_a_lag_is_that_of_the_signal_and_not_of_its_means(at: float, time_constant: float) -> None:
    """A jump to a decay anywhere within a step of 1 s, and back; the lag is integrated finely."""
    fine, steps = 4000, 60
    t = (np.arange(steps * fine) + 0.5) / fine
    signal = np.where(t > 10.0 + at, 2.0 + np.exp(-(t - 10.0 - at) / 20.0), 0.0)
    signal = np.where(t > 40.0 + at, 0.1 * (t - 50.0), signal)
    kept = np.exp(-1.0 / (fine * time_constant))
    lagged = lfilter([1.0 - kept], [1.0, -kept], signal)
    exact = lagged.reshape(steps, fine).mean(axis=1)
    value = signal.reshape(steps, fine).mean(axis=1)
    lag(np.arange(steps + 1.0), time_constant, value, np.zeros((0, steps)), -1)
    # A lag of the means themselves would be off by up to 0.31.
    assert np.abs(value - exact).max() < 0.02
