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

"""What a sensor rounds is told from its readings."""

from hapticvision_ros.core.fit.noise import in_motion, of_neighbours, rounding
import numpy as np
import pytest

T = np.arange(0.0, 10.0, 0.008)
STEP = 5e-6


def way(*speeds: float) -> np.ndarray:
    """Return the way of a tool with some speeds in turn, each for as long, and a rest at last."""
    corners = np.linspace(0.0, 8.0, len(speeds) + 1)
    done = np.concatenate(([0.0], np.cumsum(np.multiply(speeds, np.diff(corners)))))
    return np.interp(T, corners, done)


@pytest.mark.parametrize('speeds', [(0.0011, 0.0047), (0.0007213,), (0.0045, 0.00073)])
@pytest.mark.parametrize('digits', [np.float64, np.float32])
def test_steps_of_the_encoders_are_seen(speeds, digits) -> None:
    """Also those of a slow tool, which go on by one or two of them."""
    read = 0.04 - np.round(way(*speeds) / STEP) * STEP
    assert rounding(read.astype(digits).astype(np.float64)) == pytest.approx(
        STEP / np.sqrt(12.0), rel=1e-3
    )


@pytest.mark.parametrize('speed', [0.01296, 0.0213, 0.0071])
def test_steps_of_the_encoders_are_seen_beside_a_quick_tool(speed: float) -> None:
    """It never goes on by a single step from one reading to the next."""
    t = np.arange(0.003, 3.0, 0.01)
    read = 0.04 - np.round(speed * np.clip(t - 0.5, 0.0, 1.0) / 1.851e-6) * 1.851e-6
    assert rounding(read) == pytest.approx(1.851e-6 / np.sqrt(12.0), rel=1e-3)


def test_steps_of_the_encoders_are_seen_below_a_slow_tool() -> None:
    """Less than a step from sample to sample: it reads one more from time to time."""
    read = np.round(np.minimum(3.716e-6 * np.arange(900), 0.003) / 1e-5) * 1e-5
    assert rounding(read) == pytest.approx(1e-5 / np.sqrt(12.0), rel=1e-3)


def test_no_steps_are_seen_of_a_tool_that_is_accelerated_evenly() -> None:
    for start, lasts in ((0.503, 0.2), (0.5, 0.317)):
        t = np.arange(0.0, 3.0, 0.01)
        begun = np.clip(t - start, 0.0, lasts)
        way = 0.05 * begun**2 / 2.0 + 0.05 * lasts * np.clip(t - start - lasts, 0.0, 1.0)
        assert rounding(way) == 0.0


def test_no_steps_are_seen_where_there_are_none() -> None:
    noise = np.random.default_rng(0).standard_normal(T.size)
    assert rounding(way(0.0011, 0.0047) + 1e-6 * noise) == 0.0
    # A tool that is not measured goes on evenly, which is no rounding.
    assert rounding(way(0.001, 0.002)) == 0.0
    assert rounding(np.zeros(100)) == 0.0
    assert rounding(np.array([0.0, 1.0])) == 0.0
    # Nor where the least change is far below what lies between the others.
    assert rounding(np.cumsum(np.tile([0.137, 10.0, 11.03, 14.41], 50))) == 0.0


@pytest.mark.parametrize('rest', [0.0, 0.2, 0.5])
@pytest.mark.parametrize('noise', [0.2, 0.3, 0.6])
def test_what_is_read_at_rest_tells_the_noise_in_motion(rest: float, noise: float) -> None:
    """Over steps of one; at rest between two readings it is up to twice that in the middle."""
    dither = noise * np.random.default_rng(3).standard_normal((2, 20000))
    still = np.round(rest + dither[0])
    moved = np.linspace(0.0, 50.0, 20000)
    expected = np.std(np.round(moved + dither[1]) - moved)
    assert in_motion(still - still.mean(), 1.0 / np.sqrt(12.0)) == pytest.approx(
        expected, rel=0.03
    )


def test_a_sensor_that_reads_the_same_at_rest_rounds_in_motion() -> None:
    assert in_motion(np.zeros(100), 0.3) == 0.3
    assert in_motion(np.array([-1.0, 1.0] * 50), 0.0) == pytest.approx(1.0, rel=1e-3)


@pytest.mark.parametrize('drift', [0.3, 1.0, 1.7, 3.0])
@pytest.mark.parametrize('glitch', [0.0, 10.0, -10.0])
def test_a_drift_and_a_glitch_at_rest_are_no_noise(drift: float, glitch: float) -> None:
    dither = 0.25 * np.random.default_rng(4).standard_normal(2000)
    still = np.round(drift * np.linspace(0.0, 1.0, 2000) + dither)
    still[700] += glitch
    # A glitch of ten steps is in the scatter about a line.
    seen = 0.2 if glitch and drift > 2.0 else 0.05
    assert in_motion(still, 1.0 / np.sqrt(12.0)) == pytest.approx(
        np.hypot(0.25, 1.0 / np.sqrt(12.0)), rel=seen
    )


def test_neighbours_tell_noise_and_nothing_of_what_is_missed_smoothly() -> None:
    noise = 3e-5 * np.random.default_rng(4).standard_normal(4000)
    missed = 1e-3 * np.sin(np.linspace(0.0, 9.0, 4000))
    assert of_neighbours(noise) == pytest.approx(3e-5, rel=0.05)
    assert of_neighbours(missed + noise) == pytest.approx(3e-5, rel=0.05)
    assert of_neighbours(missed) == 0.0
    assert of_neighbours(noise[:9]) == 0.0
    assert of_neighbours(np.zeros(100)) == 0.0
