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

"""The covariance of a fit, against the textbook and against repetition."""

from hapticvision_ros.core.fit.uncertainty import least_squares_covariance
import numpy as np
import pytest
from scipy.signal import lfilter


def test_white_noise_gives_the_textbook_covariance_however_the_record_is_cut() -> None:
    rng = np.random.default_rng(6)
    t = np.arange(6000) / 6000.0
    jacobian = np.column_stack((np.ones_like(t), t))
    noise = 0.1 * rng.standard_normal(t.size)
    residual = noise - jacobian @ np.linalg.lstsq(jacobian, noise, rcond=None)[0]
    textbook = 0.01 * np.linalg.inv(jacobian.T @ jacobian)
    for cuts in ([], [2000], [1500, 3000, 4500]):
        covariance = least_squares_covariance(jacobian, np.split(residual, cuts))
        # 256 blocks or more tell a variance to 9 %, and correlation is never taken as negative.
        assert np.allclose(np.diag(covariance), np.diag(textbook), rtol=0.3), cuts
        correlation = covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])
        assert correlation == pytest.approx(-np.sqrt(0.75), abs=0.05)


@pytest.mark.parametrize('coefficient', [0.5, 0.95, 0.99])
def test_the_error_of_a_mean_of_correlated_noise_is_never_below_that_of_repetition(
    coefficient: float,
) -> None:
    rng = np.random.default_rng(7)
    means, errors = [], []
    for _ in range(300):
        noise = lfilter([1.0], [1.0, -coefficient], rng.standard_normal(6000))[2000:]
        means.append(noise.mean())
        covariance = least_squares_covariance(np.ones((noise.size, 1)), (noise - noise.mean(),))
        errors.append(np.sqrt(covariance[0, 0]))
    # 300 repetitions tell a spread to 4 %: three of those. Above, the correction is conservative,
    # by a third at the most. White noise would be told 1.7 to 14 times too small an error.
    assert 0.88 < np.mean(errors) / np.std(means) < 1.4


def test_a_perfect_fit_has_no_error_and_too_few_samples_an_infinite_one() -> None:
    jacobian = np.ones((50, 1))
    assert least_squares_covariance(jacobian, (np.zeros(50),)) == pytest.approx(0.0)
    assert np.isinf(least_squares_covariance(np.ones((4, 1)), (np.array([1.0, -1.0, 1.0, -1.0]),)))
