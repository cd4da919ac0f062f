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

from hapticvision_ros.core.fit.glitches import find_glitches
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


def test_a_quantised_record_that_rests_on_one_step_has_no_glitches() -> None:
    """Its noise is less than half a step: now and then it shows the next one."""
    random = np.random.default_rng(4)
    value = np.round(0.2 * random.standard_normal(4000)) * 0.09
    flips = np.count_nonzero(value)
    assert 20 < flips < 200
    assert not find_glitches(value).any()
    value[2000] = 0.9
    assert np.flatnonzero(find_glitches(value)).tolist() == [2000]


def test_short_records_are_left_alone() -> None:
    assert not find_glitches(np.array([1.0, 100.0, 1.0])).any()
