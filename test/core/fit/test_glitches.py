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

"""What counts as a glitch, and what of the physics never does."""

from hapticvision_ros.core.fit.glitches import find_glitches, resolution
import numpy as np
import pytest

T = np.arange(4000) * 1e-3


def _decay(noise: float = 0.01, seed: int = 0) -> np.ndarray:
    white = np.random.default_rng(seed).standard_normal(T.size)
    return 5.0 * np.exp(-T / 0.7) + 2.0 + noise * white


def test_noise_on_a_decay_has_no_glitch() -> None:
    assert not any(find_glitches(_decay(seed=seed)).any() for seed in range(20))


@pytest.mark.parametrize('length', [1, 3, 12, 50, 200])
def test_a_burst_of_any_length_up_to_its_limit_is_found(length: int) -> None:
    value = _decay()
    burst = slice(1501, 1501 + length)
    value[burst] = 9.0
    glitch = find_glitches(value)
    assert glitch[burst].all()
    # Whole blocks go, with a neighbour on either side, each no longer than the burst.
    assert glitch.sum() <= length + 3 * max(length, 1)


@pytest.mark.parametrize('noise', [0.0, 1e-7, 0.01])
def test_steps_peaks_and_steep_decays_are_no_glitches(noise: float) -> None:
    white = np.random.default_rng(1).standard_normal(T.size)
    shapes = (
        np.where(T < 2.0, 0.0, 3.0),
        np.where(T < 2.0, 4.0 * T, 8.0 * np.exp(-(T - 2.0) / 0.3)),
        np.exp(-T / 0.004),
        np.sin(2.0 * np.pi * T),
    )
    for shape in shapes:
        assert not find_glitches(shape + noise * white).any()


def test_the_steps_of_a_quantised_record_are_no_glitches() -> None:
    value = np.round(_decay(noise=0.003) / 0.02) * 0.02
    assert not find_glitches(value).any()


def test_the_resolution_is_that_of_the_whole_record_whatever_a_few_samples_do() -> None:
    value = np.round(_decay(noise=0.003) / 0.02) * 0.02
    assert resolution(value) == pytest.approx(0.04)
    odd = value.copy()
    odd[300] += 0.003
    odd[700:] += 1e-16 * np.random.default_rng(4).standard_normal(odd.size - 700)
    odd[900] = 1e30
    assert resolution(odd) == pytest.approx(0.04)
    # A record without steps has none but of its rounding.
    smooth = 5.0 * np.exp(-T / 0.7)
    assert 0.0 < resolution(smooth) < 1e-2
    assert resolution(np.full(100, 2.0)) == pytest.approx(2e-12)


def test_a_part_that_rests_on_one_step_has_no_glitches_by_the_steps_of_the_whole() -> None:
    """Its noise is less than half a step: now and then it shows the next one."""
    random = np.random.default_rng(4)
    value = np.round(0.2 * random.standard_normal(4000)) * 0.09
    assert 20 < np.count_nonzero(value) < 200
    assert not find_glitches(value, 0.18).any()
    value[2000] = 0.27
    assert np.flatnonzero(find_glitches(value, 0.18)).tolist() == [2000]


@pytest.mark.parametrize('count', [5, 9, 20])
def test_equal_drop_outs_of_a_record_at_rest_are_glitches(count: int) -> None:
    value = np.full(6000, 2.0)
    at = np.linspace(100, 5900, count).astype(int)
    value[at] = 0.0
    assert np.flatnonzero(find_glitches(value)).tolist() == at.tolist()


def test_short_records_are_left_alone() -> None:
    assert not find_glitches(np.array([1.0, 100.0, 1.0])).any()
