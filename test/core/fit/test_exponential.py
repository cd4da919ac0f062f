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

"""The exponential fit: exact on closed forms, honest elsewhere."""

from hapticvision_ros.core.fit.exponential import fit_exponential, MIN_SAMPLES
from hapticvision_ros.core.records import Signal
import numpy as np
import pytest
from scipy.optimize import curve_fit


@pytest.mark.parametrize('time_constant', [0.03, 0.5, 10.0, 100.0])
def test_a_noise_free_decay_is_found_exactly_over_four_decades(time_constant: float) -> None:
    t = 100.0 + np.arange(3000) * 0.01
    fit = fit_exponential(Signal(t, 3.0 * np.exp(-(t - t[0]) / time_constant) - 2.0))
    # Rounding alone, amplified where the decay is hardly longer than a line.
    assert fit.time_constant == pytest.approx(time_constant, rel=1e-7)
    assert fit.amplitude == pytest.approx(3.0, rel=1e-7)
    assert fit.offset == pytest.approx(-2.0, rel=1e-7)


def test_uneven_samples_are_fitted_at_their_own_times() -> None:
    t = np.sort(np.random.default_rng(2).uniform(0.0, 20.0, 300)) ** 1.5
    fit = fit_exponential(Signal(t, 2.0 * np.exp(-(t - t[0]) / 7.0) + 1.0))
    assert fit.time_constant == pytest.approx(7.0, rel=1e-9)


def test_estimates_and_errors_in_white_noise_are_those_of_scipy() -> None:
    t = np.arange(4000) * 0.005
    noise = 0.02 * np.random.default_rng(3).standard_normal(t.size)
    value = 3.0 * np.exp(-t / 4.0) + 1.0 + noise
    fit = fit_exponential(Signal(t, value))
    estimate, covariance = curve_fit(
        lambda t, a, tau, c: a * np.exp(-t / tau) + c, t, value, p0=(1.0, 1.0, 0.0)
    )
    found = (fit.amplitude, fit.time_constant, fit.offset)
    # The same least squares: only the stopping of the two searches differs.
    assert np.allclose(found, estimate, rtol=1e-5)
    # Ours comes from 256 blocks, which tell a standard deviation to 4 %, and never takes
    # correlation for negative: three of those, on either side.
    assert np.allclose(fit.std, np.sqrt(np.diag(covariance)), rtol=0.15)


def test_the_amplitude_can_be_referred_to_another_time_with_its_error() -> None:
    t = 5.0 + np.arange(800) * 0.01
    noise = 0.01 * np.random.default_rng(4).standard_normal(t.size)
    value = np.exp(-(t - 5.0) / 2.0) + noise
    fit = fit_exponential(Signal(t, value))
    earlier = fit.referred_to(3.0)
    assert np.allclose(earlier(t), fit(t), rtol=1e-12)
    back = earlier.referred_to(5.0)
    assert np.allclose(back.covariance, fit.covariance, rtol=1e-9)
    assert earlier.std[0] > fit.std[0]


def test_the_drop_and_the_slide_agree_on_a_straight_line() -> None:
    t = np.arange(1000) * 0.01
    value = 1.0 - 0.02 * t + 1e-3 * np.random.default_rng(5).standard_normal(t.size)
    fit = fit_exponential(Signal(t, value))
    assert fit.slide == pytest.approx(0.02 * t[-1], abs=4.0 * fit.slide_std)
    assert fit.drop[0] == pytest.approx(fit.slide, rel=0.02)


def test_too_few_samples_are_refused() -> None:
    t = np.arange(MIN_SAMPLES - 1, dtype=np.float64)
    with pytest.raises(ValueError, match='cannot tell'):
        fit_exponential(Signal(t, np.exp(-t)))
