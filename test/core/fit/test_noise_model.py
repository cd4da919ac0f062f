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

"""Whitening of means over blocks is exact, and the restricted likelihood finds the noise."""

import math

from hapticvision_ros.core.fit.noise_model import (
    Blocks,
    deviance,
    estimate,
    Record,
    SensorNoise,
    wandering,
    whitener,
)
import numpy as np
import pytest
from scipy.linalg import block_diag, cholesky, solve_triangular

INTERVAL = 1e-3


def _covariance(noise: SensorNoise, samples: int) -> np.ndarray:
    lag = np.abs(np.subtract.outer(np.arange(samples), np.arange(samples)))
    slow = noise.slow**2 * np.exp(-lag * INTERVAL / noise.correlation_time)
    wander = noise.wander**2 * np.exp(-lag * INTERVAL / noise.wander_time)
    return slow + wander + noise.white**2 * np.eye(samples)


def _blocks(counts: list[int]) -> tuple[Blocks, np.ndarray]:
    """Return blocks and the matrix that averages samples over them."""
    count = np.array(counts, dtype=float)
    mean = block_diag(*[np.full((1, n), 1.0 / n) for n in counts])
    return Blocks(count * INTERVAL, count, np.zeros(count.size)), mean


@pytest.mark.parametrize('wander_time', [9.0, 1e15, math.inf])
@pytest.mark.parametrize('samples', [1, 2, 16, 40])
def test_means_are_as_noisy_as_the_full_covariance_says(samples: int, wander_time: float) -> None:
    noise = SensorNoise(0.3, 0.7, 5e-3, 0.2, wander_time)
    expected = math.sqrt(_covariance(noise, samples).mean())
    assert noise.std_of_mean(np.array([1.0, samples]), INTERVAL) == pytest.approx(
        [noise.std, expected], rel=1e-9
    )
    white = SensorNoise(0.3, 0.0, 0.0)
    assert white.std_of_mean(np.array([samples]), INTERVAL) == pytest.approx(
        0.3 / math.sqrt(samples)
    )


@pytest.mark.parametrize('wander', [0.0, 0.9])
@pytest.mark.parametrize('correlation_time', [1e-4, 5e-3, 3.0])
def test_whitening_means_is_that_of_the_full_covariance(
    correlation_time: float, wander: float
) -> None:
    """The filter's squares and determinant are those of the dense matrix."""
    noise = SensorNoise(0.7, 1.3, correlation_time, wander, 0.1)
    blocks, mean = _blocks([1, 1, 2, 3, 7, 16, 17, 40, 40, 5, 1])
    covariance = mean @ _covariance(noise, mean.shape[1]) @ mean.T
    lower = cholesky(covariance, lower=True)
    rows = np.random.default_rng(0).standard_normal((3, len(covariance)))
    filter_ = whitener(blocks, noise)
    # The closed form of a long block cancels digits where the noise is much slower than it.
    np.testing.assert_allclose(
        filter_(rows), solve_triangular(lower, rows.T, lower=True).T, rtol=1e-6, atol=1e-7
    )
    assert filter_.log_determinant == pytest.approx(2.0 * np.log(np.diag(lower)).sum(), rel=1e-7)
    white = filter_(rows)
    np.testing.assert_allclose(filter_.products(rows), white @ white.T, atol=1e-9)


@pytest.mark.parametrize('wander', [0.0, 0.9])
def test_a_filter_that_has_settled_sees_what_changes(wander: float) -> None:
    """A gap, samples that are less well known and longer blocks, after many that are alike."""
    noise = SensorNoise(0.7, 1.3, 5e-3, wander, 0.05)
    counts = [*[1] * 300, 20, *[1] * 300, *[1] * 3, *[1] * 300, *[4] * 100]
    blocks, mean = _blocks(counts)
    count, extra = blocks.count.copy(), np.zeros(len(counts))
    # What is in the long block was set aside.
    count[300], extra[601:604] = 0.0, 9.0
    seen = count > 0.0
    filter_ = whitener(Blocks(blocks.duration, count, extra), noise)
    covariance = mean[seen] @ _covariance(noise, mean.shape[1]) @ mean[seen].T
    lower = cholesky(covariance + np.diag(extra[seen]), lower=True)
    rows = np.random.default_rng(0).standard_normal((3, len(counts)))
    told = solve_triangular(lower, rows[:, seen].T, lower=True).T
    np.testing.assert_allclose(filter_(rows)[:, seen], told, rtol=1e-6, atol=1e-7)
    assert filter_.log_determinant == pytest.approx(2.0 * np.log(np.diag(lower)).sum(), rel=1e-7)
    # A row without derivatives, which is whitened as the filter is made, is worth as much.
    none = np.empty((0, len(counts)))
    bare = Record(Blocks(blocks.duration, count, extra), rows[0], none, none)
    samples = int(seen.sum())
    likely = samples * np.log(told[0] @ told[0] / samples) + filter_.log_determinant
    assert deviance([bare], noise) == pytest.approx(likely, abs=1e-6)


def test_a_block_without_samples_tells_nothing() -> None:
    """Its residual does not count, whatever it is."""
    noise = SensorNoise(0.5, 1.0, 5e-3)
    duration, count = np.full(5, INTERVAL), np.array([1.0, 1.0, 0.0, 1.0, 1.0])
    filter_ = whitener(Blocks(duration, count, np.zeros(5)), noise)
    rows = np.ones((2, 5))
    rows[1, 2] = 1e6
    white = filter_(rows)
    np.testing.assert_array_equal(white[0], white[1])
    assert white[0, 2] == 0.0


def _noise(true: SensorNoise, samples: int, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    memory = np.exp(-INTERVAL / true.correlation_time)
    value = np.empty(samples)
    value[0] = true.slow * random.standard_normal()
    kicks = true.slow * np.sqrt(1.0 - memory**2) * random.standard_normal(samples)
    for k in range(1, samples):
        value[k] = memory * value[k - 1] + kicks[k]
    return value + true.white * random.standard_normal(samples)


@pytest.mark.parametrize(
    'true', [SensorNoise(1.0, 1.0, 0.02), SensorNoise(0.1, 1.0, 0.05), SensorNoise(1.0, 0.01, 0.1)]
)
def test_level_and_memory_come_back_from_a_residual(true: SensorNoise) -> None:
    """Also where the fit has taken a level and a slope out of each record."""
    samples = 8000
    t = np.linspace(-1.0, 1.0, samples)
    shared = np.stack((np.ones(samples), t))
    records = []
    for seed in range(3):
        noise = _noise(true, samples, seed)
        line = np.polynomial.Polynomial.fit(t, noise, 1)
        blocks = Blocks(np.full(samples, INTERVAL), np.ones(samples), np.zeros(samples))
        records.append(Record(blocks, noise - line(t), np.zeros((0, samples)), shared))
    found = estimate(records, SensorNoise(0.5, 0.5, 0.01), INTERVAL)
    assert found.std == pytest.approx(true.std, rel=0.1)
    assert found.correlation(INTERVAL) == pytest.approx(true.correlation(INTERVAL), abs=0.05)
    if true.slow > 0.5:
        # The memory of 24,000 samples is known to about a tenth.
        assert found.correlation_time == pytest.approx(true.correlation_time, rel=0.3)


@pytest.mark.parametrize('everywhere', [True, False])
def test_jumps_that_turn_out_known_better_do_not_make_the_noise_quieter(everywhere: bool) -> None:
    """A third of the steps may be off by ten times the noise, and are not."""
    true = SensorNoise(1.0, 0.0, 0.02)
    random = np.random.default_rng(4)
    count = np.ones(900)
    extra = np.where(np.arange(900) % 3 == 0, 100.0, 0.0)
    residual = random.standard_normal(900)
    none = np.zeros((0, 900))
    records = [Record(Blocks(count * INTERVAL, count, extra), residual, none, none)]
    start = SensorNoise(0.9, 0.1, 0.02)
    found = estimate(records, start, INTERVAL, everywhere=everywhere, longest=0.05)
    assert found.std == pytest.approx(true.std, rel=0.08)


def test_three_samples_tell_nothing_of_their_noise() -> None:
    """As many parameters as samples leave no residual, and no noise that explains it."""
    blocks = Blocks(np.full(3, INTERVAL), np.ones(3), np.zeros(3))
    record = Record(blocks, np.array([1e-3, -2e-3, 1e-3]), np.eye(3), np.ones((1, 3)))
    start = SensorNoise(0.1, 0.1, 0.01)
    assert estimate([record], start, INTERVAL) == start


def _silence(wander: float, drift: float) -> list[Record]:
    """Return the force without contact of some trials, before and after a push."""
    samples, records = 3000, []
    for seed in range(12):
        value = _noise(SensorNoise(1.0, 1.0, 3.0 * INTERVAL), samples, seed)
        if wander:
            value += _noise(SensorNoise(0.0, wander, 2000.0 * INTERVAL), samples, 100 + seed)
        since = np.arange(samples) * INTERVAL
        value += drift * since
        blocks = Blocks(np.full(samples, INTERVAL), np.ones(samples), np.zeros(samples))
        rest = value - value.mean()
        records.append(Record(blocks, rest, since[np.newaxis], np.ones((1, samples))))
    return records


def test_a_zero_that_wanders_is_told_from_noise_that_forgets() -> None:
    records, longest = _silence(0.5, 0.0), 50.0 * INTERVAL
    brief = estimate(records, SensorNoise(1.0, 1.0, 10.0 * INTERVAL), INTERVAL, longest=longest)
    found = wandering(records, brief, INTERVAL, longest, at_least=6.0)
    assert found is not None
    assert deviance(records, brief) - deviance(records, found) > 100.0
    # Records of 1.5 correlation times tell how fast it wanders, hardly how far.
    assert found.wander**2 / found.wander_time == pytest.approx(0.5**2 / 2.0, rel=0.3)
    assert math.hypot(found.white, found.slow) == pytest.approx(math.sqrt(2.0), rel=0.1)


def test_neither_silence_nor_a_drift_that_all_trials_share_wanders() -> None:
    longest = 50.0 * INTERVAL
    for drift in (0.0, 1.0 / INTERVAL / 3000.0):
        records = _silence(0.0, drift)
        start = SensorNoise(1.0, 1.0, 10.0 * INTERVAL)
        brief = estimate(records, start, INTERVAL, longest=longest)
        assert wandering(records, brief, INTERVAL, longest, at_least=6.0) is None


def test_the_likelihood_allows_for_what_a_fit_takes_out() -> None:
    """Of twenty samples and ten fitted parameters, plain squares would lose half the variance."""
    random = np.random.default_rng(0)
    records = []
    for _ in range(100):
        columns = random.standard_normal((10, 20))
        noise = random.standard_normal(20)
        fitted = np.linalg.lstsq(columns.T, noise, rcond=None)[0]
        blocks = Blocks(np.full(20, INTERVAL), np.ones(20), np.zeros(20))
        records.append(Record(blocks, noise - fitted @ columns, np.zeros((0, 20)), columns))
    found = estimate(records, SensorNoise(1.0, 0.1, 1e-3), INTERVAL)
    assert found.std == pytest.approx(1.0, rel=0.1)
