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

"""The smooth way of a tool through the noise of its encoders."""

from collections.abc import Callable
from dataclasses import replace
import math

from hapticvision_ros.core.fit.campaign import _jumps, _unsure, SHARPEST
from hapticvision_ros.core.fit.data import (
    _encoder_noise,
    _smooth_way,
    FitTrial,
    prepare,
    tool_path,
)
from hapticvision_ros.core.fit.ripple import candidates
from hapticvision_ros.core.fit.smooth import _through, _try, adapted, vaguely
from hapticvision_ros.core.fit.way import smooth
from hapticvision_ros.core.records import Segmentation, Signal, Trial
import numpy as np
import pytest
from scipy.signal import butter, lfilter

PHASES = Segmentation(1.0, 3.0, 13.0, 13.1, 20.0, 0.04, 0.0, 0.003, 0.006)


def _rippling(t: np.ndarray, ripple: float) -> np.ndarray:
    """Return a push at 3 mm/s, a hold and a withdrawal, with a ripple of 9 Hz while it moves."""
    way = np.interp(t, [0.0, 3.0, 13.0, 14.0, 20.0], [-0.003, 0.006, 0.006, -0.02, -0.02])
    moves = np.interp(t, [2.95, 3.0, 13.0, 13.05, 13.95, 14.0], [1.0, 0.0, 0.0, 1.0, 1.0, 0.0])
    return way + ripple * moves * np.sin(2.0 * np.pi * 9.0 * t)


def _toothed(t: np.ndarray, ripple: float) -> np.ndarray:
    """Return the same with a ripple of 0.33 mm along the way."""
    way = _rippling(t, 0.0)
    return np.asarray(way + ripple * np.sin(2.0 * np.pi * way / 3.3e-4))


def _noisy(t: np.ndarray, way: np.ndarray, noise: float, rounded: float, seed: int) -> np.ndarray:
    random = np.random.default_rng(seed)
    return np.round((way + noise * random.standard_normal(t.size)) / rounded) * rounded


def test_it_is_the_estimate_of_least_squares_of_all_samples() -> None:
    """Held against the Gaussian whose covariance is written out, with uneven samples and noise."""
    random = np.random.default_rng(0)
    t = np.cumsum(random.uniform(0.5, 1.5, 40) * 0.01)
    value = 1e-3 * np.sin(20.0 * t) + 1e-5 * random.standard_normal(t.size)
    intensity = 10.0 ** random.uniform(0.0, 2.0, t.size - 1)
    variance, vague = 1e-10 * random.uniform(1.0, 30.0, t.size), vaguely(value, 0.01)
    state, speed = np.empty(t.size), np.empty(t.size)
    misfit = _through(t, value, variance, vague, intensity, state, speed)

    # Rows of each state as a sum of what is new in each step, which is independent.
    rows = np.zeros((t.size, 3, 3 * t.size))
    rows[0, :, :3] = np.diag(np.sqrt(vague))
    for i, h in enumerate(np.diff(t)):
        step = np.array([[1.0, h, 0.5 * h * h], [0.0, 1.0, h], [0.0, 0.0, 1.0]])
        spread = intensity[i] * np.array(
            [
                [h**5 / 20.0, h**4 / 8.0, h**3 / 6.0],
                [h**4 / 8.0, h**3 / 3.0, h**2 / 2.0],
                [h**3 / 6.0, h**2 / 2.0, h],
            ]
        )
        rows[i + 1] = step @ rows[i]
        rows[i + 1, :, 3 * (i + 1) + np.arange(3)] += np.linalg.cholesky(spread).T
    places, speeds = rows[:, 0], rows[:, 1]
    covariance = places @ places.T + np.diag(variance)
    weighted = np.linalg.solve(covariance, value - value[0])
    np.testing.assert_allclose(state, value[0] + places @ places.T @ weighted, atol=1e-9)
    np.testing.assert_allclose(speed, speeds @ places.T @ weighted, rtol=1e-4, atol=1e-6)
    _, log_determinant = np.linalg.slogdet(covariance)
    expected = (value - value[0]) @ weighted + log_determinant - np.sum(np.log(variance))
    assert misfit == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize('count', [1, 7, 8, 9, 20])
def test_bandwidths_that_are_tried_side_by_side_miss_as_each_by_itself(count: int) -> None:
    random = np.random.default_rng(count)
    t = np.cumsum(random.uniform(0.5, 1.5, 300) * 0.01)
    value = 1e-3 * np.sin(20.0 * t) + 1e-5 * random.standard_normal(t.size)
    variance, vague = 1e-10 * random.uniform(1.0, 30.0, t.size), vaguely(value, 0.01)
    widths, least = np.geomspace(1.0, 80.0, count), 10.0 ** random.uniform(0.0, 1.5, t.size)
    tried = np.empty(count)
    _try(t, value, variance, vague, 1e-12, least, widths, tried)
    lower = np.minimum(least[1:], least[:-1])
    for width, misfit in zip(widths, tried, strict=True):
        intensity = 1e-12 * np.maximum(lower, width) ** 6
        alone = _through(t, value, variance, vague, intensity, np.empty(300), np.empty(300))
        assert misfit == pytest.approx(alone, rel=1e-9)


@pytest.mark.parametrize(
    ('true', 'rate', 'ripple', 'noise', 'rounded'),
    [
        (_rippling, 1000.0, 14e-6, 8e-6, 5e-6),
        (_rippling, 125.0, 24e-6, 4e-6, 1e-5),
        (_toothed, 1000.0, 14e-6, 8e-6, 5e-6),
    ],
)
def test_a_tool_that_ripples_is_followed_far_better_than_its_encoders_tell(
    true: Callable[[np.ndarray, float], np.ndarray],
    rate: float,
    ripple: float,
    noise: float,
    rounded: float,
) -> None:
    """Without a ripple that repeats it is missed by 1.4 and 2.2 um, 0.09 and 0.16 mm/s."""
    off, speed = 0.8e-6, 7e-5
    t = np.arange(0.0, 20.0, 1.0 / rate)
    value = _noisy(t, true(t, ripple), noise, rounded, 1)
    path = tool_path(Signal(t, value), PHASES)
    fine = np.arange(0.7, 2.8, 1e-4)
    missed = path.at(fine) - true(fine, ripple)
    assert np.std(missed) < off
    # The dashpots make force of the speed, which samples tell far worse.
    assert np.std(np.gradient(missed, fine)) < speed
    samples = np.interp(fine, t, value) - true(fine, ripple)
    assert np.std(np.gradient(samples, fine)) > 10.0 * speed
    held = np.arange(4.0, 12.0, 1e-3)
    assert np.std(path.at(held) - true(held, ripple)) < off


def test_an_even_acceleration_has_no_jerk_and_is_not_straight() -> None:
    """A tool whose acceleration and slowing take all of a way of 3.6 mm."""
    t = np.arange(0.0, 3.0, 0.005)
    fine = np.arange(0.0, 3.0, 1e-3)

    def true(moments: np.ndarray) -> np.ndarray:
        grid = np.arange(0.0, 3.0, 1e-4)
        speed = 0.02 * np.clip(0.6 - np.abs(grid - 1.6), 0.0, None)
        return np.interp(moments, grid, np.cumsum(speed) * 1e-4)

    value = true(t) + 1e-6 * np.random.default_rng(3).standard_normal(t.size)
    way = smooth(t, value, 1e-6)
    missed = np.interp(fine, way.t, way.value) - true(fine)
    assert np.abs(missed).max() < 2e-6
    assert np.std(np.gradient(missed, fine)[(fine > 1.1) & (fine < 2.1)]) < 1e-4
    # Where it is at rest few knots are enough.
    assert np.count_nonzero(way.t < 0.7) < 10


@pytest.mark.parametrize(('speed', 'rate'), [(2.6e-4, 100.0), (2.6e-4, 125.0), (3.4e-4, 100.0)])
def test_what_rounding_makes_of_an_even_speed_is_no_ripple(speed: float, rate: float) -> None:
    """Of one to two and a half steps a sample: few in a row go on by the same."""
    t = np.arange(0.0, 10.0, 1.0 / rate)
    step = 1.5e-6
    true = speed * np.abs(5.0 - t)
    way = _smooth_way(t, step * np.round(true / step), None, step / math.sqrt(12.0))
    assert way is not None
    # As if it rippled it would be 1.5e-5 m/s and more.
    even = (way.t > 1.0) & (way.t < 4.0)
    assert np.std(np.gradient(way.value, way.t)[even]) < 1e-6


@pytest.mark.parametrize('off', [0.0, 0.21, 0.43, 0.6, 0.83])
def test_encoders_whose_steps_a_tool_passes_evenly_do_not_turn_it(off: float) -> None:
    """At its fastest, at least jerk, it goes by about two steps from one reading to the next."""
    t = np.arange(0.0, 18.0, 0.01)
    step = 9.8e-6
    fine = np.arange(1.0, 14.9, 1e-3)

    def true(moments: np.ndarray) -> np.ndarray:
        part = np.clip((moments - 1.0) / 13.9, 0.0, 1.0)
        return np.asarray(15e-3 * part**3 * (10.0 - 15.0 * part + 6.0 * part**2) + off * step)

    way = _smooth_way(t, step * np.round(true(t) / step), None, step / math.sqrt(12.0))
    assert way is not None
    missed = (np.interp(fine, way.t, way.value) - true(fine))[::20]
    speed = np.diff(missed) / 0.02
    # With each reading taken by itself it is 8.7e-5 to 9.6e-5 m/s there.
    assert np.abs(speed[200:500]).max() < 1e-5


def test_a_ripple_in_time_rests_with_the_tool_and_one_in_place_does_not() -> None:
    t = np.arange(0.0, 20.0, 0.002)
    for true, rests in ((_rippling, True), (_toothed, False)):
        value = _noisy(t, true(t, 14e-6), 5e-6, 1e-6, 1)
        tried = candidates(t, value, 5e-6, adapted(t, value, 5e-6))
        best = max(tried, key=lambda ripple: ripple.promise)
        # The other promises far less, for its phase in one move says nothing of that in the next.
        assert best.promise - min(ripple.promise for ripple in tried) > 100.0
        assert np.hypot(best.cosine, best.sine).max() == pytest.approx(14e-6, rel=0.1)
        going, held = best.rate[500:1400], best.rate[2000:6000]
        # A tooth of 0.33 mm passes nine times a second as well.
        assert going == pytest.approx(2.0 * np.pi * 9.0, rel=0.05)
        assert (held.max() == 0.0) == rests


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_a_ripple_ends_with_the_move(seed: int) -> None:
    t = np.arange(0.0, 20.0, 0.001)
    true = _rippling(t, 14e-6)
    found = smooth(t, _noisy(t, true, 2e-6, 1e-7, seed), 2e-6)
    stopped = np.arange(3.02, 3.3, 1e-4)
    missed = np.interp(stopped, found.t, found.value) - _rippling(stopped, 14e-6)
    # Without a ripple that repeats it is 0.3 mm/s at most; of the ripple itself it is 0.8.
    assert np.abs(np.gradient(missed, stopped)).max() < 5e-4


@pytest.mark.parametrize('hold', [10.0, 30.0])
def test_a_phase_that_goes_on_through_all_moves_is_found(hold: float) -> None:
    """It tells the rate far more closely than the longest move does."""
    t = np.arange(0.0, 6.0 + hold, 0.004)
    stops = [0.0, 3.0, 3.0 + hold, 6.0 + hold]
    way = np.interp(t, stops, [-0.003, 0.006, 0.006, -0.003])
    moves = (t < stops[1]) | (t > stops[2])
    value = _noisy(t, way + 14e-6 * moves * np.sin(10.0 * np.pi * t), 8e-6, 1e-6, 1)
    apart, through, _ = candidates(t, value, 8e-6, adapted(t, value, 8e-6))
    assert through.promise > apart.promise
    assert through.rate.max() == pytest.approx(10.0 * np.pi, abs=0.5 / (6.0 + hold))


@pytest.mark.parametrize('rate', [100.0, 1000.0])
def test_no_ripple_is_seen_in_a_curve_without_one(rate: float) -> None:
    t = np.arange(0.0, 20.0, 1.0 / rate)
    way = np.interp(t, [0.0, 3.0, 13.0, 14.0, 20.0], [-0.003, 0.006, 0.006, -0.02, -0.02])
    way += 2e-4 * np.sin(1.5 * t) + 1e-4 * np.sin(4.0 * t)
    for seed in range(5):
        value = _noisy(t, way, 8e-6, 1e-6, seed)
        plain = adapted(t, value, 8e-6)
        assert smooth(t, value, 8e-6).misfit == plain.misfit


def test_a_way_that_bends_slowly_is_smoothed_over_long() -> None:
    t = np.arange(0.0, 20.0, 0.002)
    way = 0.004 * np.sin(0.5 * t)
    found = smooth(t, _noisy(t, way, 1e-5, 1e-6, 2), 1e-5)
    off = np.interp(t, found.t, found.value) - way
    assert np.std(off) < 2e-6
    # Few knots are enough.
    assert found.t.size < t.size // 10


@pytest.mark.parametrize(('noise', 'rounded'), [(5e-6, 1e-6), (1e-6, 1e-5), (2e-6, 1e-5)])
@pytest.mark.parametrize('rate', [250.0, 1000.0])
@pytest.mark.parametrize('share', [0.0, 0.15, 0.3])
def test_straight_pieces_remain_where_they_follow_the_samples(
    share: float, noise: float, rounded: float, rate: float
) -> None:
    """Wherever within a step of the encoders the tool rests."""
    t = np.arange(0.0, 20.0, 1.0 / rate)
    way = _rippling(t, 0.0) + share * rounded
    path = tool_path(Signal(t, _noisy(t, way, noise, rounded, 3)), PHASES)
    assert path.t.size <= 12
    assert path.still == math.inf


@pytest.mark.parametrize('share', [0.0, 0.15, 0.3, 0.45])
@pytest.mark.parametrize('passed', [1.0, 0.997, 2.0, 1.998, 3.003])
def test_straight_pieces_remain_where_a_tool_passes_about_whole_steps(
    passed: float, share: float
) -> None:
    """All readings of a push, or hundreds of them, err as one."""
    t = np.arange(0.0, 20.0, 0.004)
    rounded = 0.012e-3 / passed
    value = rounded * np.round(_rippling(t, 0.0) / rounded + share)
    path = tool_path(Signal(t, value), PHASES)
    assert path.t.size <= 14
    assert path.still == math.inf
    fine = np.arange(1.05, 2.9, 0.01)
    assert np.abs(np.diff(path.at(fine)) / 0.01 - 3e-3).max() < 1e-5


def test_a_way_that_is_far_off_the_samples_is_none() -> None:
    """As where the noise is taken for a thousandth of what it is."""
    t = np.arange(0.0, 20.0, 0.002)
    value = _noisy(t, _rippling(t, 14e-6), 8e-6, 1e-6, 6)
    assert _smooth_way(t, value, None, 8e-6) is not None
    assert _smooth_way(t, value, None, 8e-9) is None


def _jerked(t: np.ndarray, far: float, pushes: float, withdraws: float) -> np.ndarray:
    """Return a way there from 0.5 s on and back from 8 s or later on, each at one least jerk."""
    way = np.full(t.size, -0.004)
    for start, length, lasts in ((0.5, far, pushes), (max(8.0, pushes + 3.5), -far, withdraws)):
        share = np.clip((t - start) / lasts, 0.0, 1.0)
        way += length * share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
    return way


def test_a_curve_before_encoders_that_round_is_followed_better_than_by_shapes_of_arms() -> None:
    """By 20 um, of a tool that makes up to four steps from sample to sample."""
    t = np.arange(0.0, 13.0, 0.008)
    phases = Segmentation(1.6, 3.5, 8.0, 10.4, 13.0, 0.04, 0.0, 0.006, 0.011)
    fine = np.arange(1.2, 3.3, 1e-3)
    way = _jerked(t, 0.015, 3.0, 3.0)
    for seed in range(3):
        path = tool_path(Signal(t, _noisy(t, way, 3e-6, 2e-5, seed)), phases)
        missed = path.at(fine) - _jerked(fine, 0.015, 3.0, 3.0)
        # By pieces and shapes it is 14 to 21 um.
        assert np.std(missed) < 4e-6
        assert path.unsteady is not None
        off = np.interp(fine, path.t, path.unsteady)
        # What the speed is off by over a tenth of a second is foreseen, within a factor of two.
        means = np.diff(missed[::100]) / 0.1
        told = float(np.sqrt(np.mean(off**2) / 0.1))
        assert 0.5 * told < np.std(means) < 2.0 * told
        # Held still, it is off by less than a step.
        assert abs(path.at(np.array([5.5]))[0] - 0.011) < 2e-5


@pytest.mark.parametrize('seed', [0, 1, 2])
def test_the_speed_between_knots_is_hardly_off(seed: int) -> None:
    """A push at one least jerk: straight pieces whose places are right make force of dashpots."""
    t = np.arange(0.0, 13.0, 0.002)
    value = _noisy(t, _jerked(t, 0.015, 3.0, 3.0), 3e-7, 5e-7, seed)
    path = tool_path(
        Signal(t, value), Segmentation(1.6, 3.5, 8.0, 10.4, 13.0, 0.04, 0.0, 6e-3, 0.011)
    )
    fine = np.arange(1.6, 3.5, 5e-4)
    off = np.gradient(path.at(fine) - _jerked(fine, 0.015, 3.0, 3.0), fine)
    # With knots where the places alone ask for them it is 15 um/s.
    assert np.std(off) < 7e-6


@pytest.mark.parametrize(
    ('pushes', 'noise', 'off'), [(1.0, 0.0, 1e-8), (1.0, 1e-7, 1.2e-7), (2.0, 1e-7, 1e-7)]
)
def test_a_quick_curve_is_followed_by_few_samples_that_are_nearly_exact(
    pushes: float, noise: float, off: float
) -> None:
    """How the tool is accelerated, up to 10 um beside a line, is no noise of its encoders."""
    t = np.arange(0.0, 13.0, 0.02)
    way = _jerked(t, 0.009, pushes, 1.0)
    first, last = np.flatnonzero(way > 0.0)[[0, -1]]
    stop = 0.5 + pushes
    phases = Segmentation(t[first], stop, 8.0, t[last], 13.0, 0.04, 0.0, 0.002, 0.005)
    fine = np.arange(t[first], stop, 1e-3)
    for seed in range(3):
        path = tool_path(Signal(t, _noisy(t, way, noise, 1e-9, seed)), phases)
        assert path.noise < max(1.6 * noise, 5e-8)
        assert np.std(path.at(fine) - _jerked(fine, 0.009, pushes, 1.0)) < off
        # Samples tell nothing faster than themselves.
        assert path.unsteady is not None
        most = path.noise * np.sqrt(0.02 / 3.0) * np.pi / 0.02
        assert 0.5 * most < path.unsteady.max() <= 1.001 * most


def test_of_a_tool_that_hardly_rests_how_it_is_accelerated_is_no_noise_either() -> None:
    t = np.arange(0.5, 12.0, 0.02)
    # What rests may sink.
    way = _jerked(t, 0.009, 4.0, 4.0) + 1e-6 * t
    value = _noisy(t, way, 1e-8, 1e-9, 0)
    path = tool_path(
        Signal(t, value), Segmentation(2.4, 4.5, 8.0, 10.1, 12.0, 0.04, 0.0, 2e-3, 5e-3)
    )
    assert path.noise < 3e-8
    fine = np.arange(2.4, 4.5, 1e-3)
    assert np.std(path.at(fine) - _jerked(fine, 0.009, 4.0, 4.0) - 1e-6 * fine) < 2e-8


def test_noise_that_has_been_filtered_is_no_acceleration() -> None:
    """It is as alike for neighbours, and shows where the tool rests."""
    t = np.arange(0.0, 13.0, 0.002)
    noise = lfilter(*butter(4, 0.1), np.random.default_rng(0).standard_normal(t.size))
    value = _jerked(t, 0.009, 2.0, 1.0) + 1e-6 * noise / noise.std()
    # Fourth differences tell 1.6 nm.
    assert _encoder_noise(t, value) > 2e-8
    # A tool that never rests shows nothing of that.
    t = np.arange(0.0, 20.0, 0.02)
    assert _encoder_noise(t, _noisy(t, 0.004 * np.sin(0.5 * t), 1e-8, 1e-10, 0)) < 4e-7


def test_four_samples_of_the_encoders_are_a_path() -> None:
    t = np.array([1.0, 2.0, 3.0, 4.0])
    path = tool_path(Signal(t, np.array([-0.002, 0.0, 0.002, 0.003])), PHASES)
    assert path.at(t).tolist() == pytest.approx([-0.002, 0.0, 0.002, 0.003])


@pytest.mark.parametrize('seed', range(4))
def test_a_curve_along_which_a_tool_creeps_is_smoothed_as_well(seed: int) -> None:
    """It goes on by less than 0.3 of a step of its encoders a sample, and is off quickly."""
    t = np.arange(0.0, 18.0, 0.004)
    phases = Segmentation(4.8, 8.2, 11.5, 11.7, 18.0, 0.04, 0.0, 0.002, 0.011)
    path = tool_path(Signal(t, _noisy(t, _jerked(t, 0.006, 8.0, 0.6), 1e-6, 2e-5, seed)), phases)
    fine = np.arange(4.8, 8.5, 1e-3)
    # By shapes of arms it is 2.4 to 2.6 um.
    assert np.std(path.at(fine) - _jerked(fine, 0.006, 8.0, 0.6)) < 1.6e-6


def test_samples_that_come_in_bundles_tell_a_way() -> None:
    """Two at nearly the same moment, over and over."""
    t = np.sort(np.concatenate((np.arange(0.0, 20.0, 0.02), np.arange(0.0, 20.0, 0.02) + 1e-6)))
    way = 0.004 * np.sin(0.5 * t)
    found = smooth(t, _noisy(t, way, 1e-5, 1e-6, 7), 1e-5)
    assert np.std(np.interp(t, found.t, found.value) - way) < 1e-5


@pytest.mark.parametrize(('speed', 'rate'), [(1.0, 1000.0), (0.2, 500.0)])
def test_steps_are_sparse_where_a_rippling_tool_rests_and_dense_where_it_goes(
    speed: float, rate: float
) -> None:
    """A slow push takes longer, before a withdrawal that is as quick."""
    t = np.arange(0.0, 12.0 + 3.0 / speed, 0.001)
    true = _rippling(np.where(t < 3.0 / speed, speed * t, t - 3.0 / speed + 3.0), 0.0)
    moves = np.clip((3.0 / speed - t) / 0.05, 0.0, 1.0)
    true = true + 14e-6 * moves * np.sin(2.0 * np.pi * 9.0 * t)
    every = round(1000.0 / rate)
    tool = Signal(t[::every], 0.04 - _noisy(t[::every], true[::every], 8e-6, 5e-6, 4))
    times = (1.0 / speed, 3.0 / speed, 10.0 + 3.0 / speed)
    phases = Segmentation(*times, times[2] + 0.1, float(t[-1]), 0.04, 0.0, speed * 0.003, 0.006)
    pressed = (t > phases.t_contact) & (t < phases.t_loss)
    force = np.where(pressed, 1000.0 * np.maximum(true, 0.0), 0.0)
    force += 0.01 * np.random.default_rng(5).standard_normal(t.size)
    (made,), _ = prepare([(Trial('rippling', 0, Signal(t, force), tool, None, 'none'), phases)])
    assert made is not None
    assert made.path.still < math.inf
    held = np.count_nonzero((made.t > times[1] + 2.0) & (made.t < times[2] - 2.0))
    assert held < 3000
    fine = np.arange(times[0] + 0.1, times[1] - 0.1, 1e-3)
    straight = np.interp(fine, made.t, made.displacement)
    assert np.std(straight - made.path.at(fine)) < 0.5e-6


@pytest.fixture(scope='module')
def smooth_trial() -> FitTrial:
    """Return a trial along a smooth way, of a spring of 1 N/mm and a dashpot of 0.3 N.s/mm."""
    t = np.arange(0.0, 20.0, 0.002)
    way = _rippling(t, 14e-6)
    tool = Signal(t, 0.04 - _noisy(t, way, 8e-6, 5e-6, 4))
    force = 1000.0 * np.maximum(way, 0.0) + 300.0 * np.gradient(way, t) * (way > 0.0)
    force += 0.01 * np.random.default_rng(5).standard_normal(t.size)
    (made,), _ = prepare([(Trial('rippling', 0, Signal(t, force), tool, None, 'none'), PHASES)])
    assert made is not None
    return replace(made, path=replace(made.path, unsteady=np.full(made.path.t.size, 1e-5)))


def _makes(trial: FitTrial) -> float:
    """Return how much force a speed makes, by the noise that a speed which is off makes."""
    unsteady = trial.unsteady
    assert unsteady is not None
    return math.sqrt(float(np.median((unsteady * trial.duration)[trial.pushed[0]]))) / 1e-5


def test_what_the_speed_is_off_by_is_noise_of_the_force(smooth_trial: FitTrial) -> None:
    unsteady = smooth_trial.unsteady
    assert unsteady is not None
    blurred = _jumps(smooth_trial.force, smooth_trial, SHARPEST)
    assert np.all(_unsure(smooth_trial.force, smooth_trial, SHARPEST) >= blurred + unsteady)
    assert not unsteady[smooth_trial.displacement[1:] <= 0.0].any()
    assert _makes(smooth_trial) == pytest.approx(300.0, rel=0.1)
    # Of a part of the trial as well.
    part = smooth_trial.head(int(np.searchsorted(smooth_trial.t, 3.0)))
    assert part.path.unsteady is not None
    assert part.path.unsteady.size == part.path.t.size


def test_readings_that_are_none_tell_nothing_of_what_a_speed_makes(smooth_trial: FitTrial) -> None:
    gone = (smooth_trial.middle > 1.8) & (smooth_trial.middle < 2.2)
    gappy = replace(
        smooth_trial,
        force=np.where(gone, 0.0, smooth_trial.force),
        force_count=np.where(gone, 0.0, smooth_trial.force_count),
    )
    assert _makes(gappy) == pytest.approx(300.0, rel=0.1)


@pytest.mark.parametrize('settling', [0.3, 0.8])
def test_an_arm_that_settles_slowly_tells_what_a_speed_makes(
    smooth_trial: FitTrial, settling: float
) -> None:
    """Its speed falls in a straight line with its way."""
    since = smooth_trial.t - 1.0
    way = np.where(since > 0.0, 0.006 * -np.expm1(-np.maximum(since, 0.0) / settling), 0.0)
    speed = np.diff(way) / smooth_trial.duration
    force = 1000.0 * 0.5 * (way[1:] + way[:-1]) + 300.0 * speed
    force += 0.5 * np.random.default_rng(5).standard_normal(force.size)
    slow = replace(smooth_trial, displacement=way, force=force)
    assert _makes(slow) == pytest.approx(300.0, rel=0.1)


def test_like_readings_tell_as_much_as_one() -> None:
    """A slow curve of which each reading comes eight times, off by what it is off by."""
    t = np.arange(0.0, 8.0, 0.001)
    way = 0.0004 * np.sin(0.8 * t)
    value = np.repeat(way[3::8] + 6e-6 * np.random.default_rng(0).standard_normal(1000), 8)
    as_one, apart = smooth(t, value, 6e-6, np.full(t.size, 8.0)), smooth(t, value, 6e-6)
    missed, taken = (np.interp(t, each.t, each.value) - way for each in (as_one, apart))
    assert np.std(missed) < 1e-6
    assert np.std(taken) > 3e-6
    # The bandwidth tells what the speed is off by.
    off = np.diff(missed[::100]) / 0.1
    told = float(np.sqrt(np.mean(as_one.unsteady**2) / 0.1))
    assert 0.3 * told < np.std(off) < 3.0 * told


def _pressed_by_a_force(t: np.ndarray, swings_by: float, withdraws: float) -> np.ndarray:
    """Return a way at one speed from 1 s on, which a force leads from 2 to 8 s, and back."""
    since = np.maximum(t - 2.0, 0.0)
    fades, turns = 1.0 / 0.35, 2.0 * math.pi / 1.2
    swings = turns * np.sin(turns * since) - fades * np.cos(turns * since)
    swings = (fades + np.exp(-fades * since) * swings) / (fades**2 + turns**2)
    creeps = 0.62e-3 * since + 0.28e-3 * (1.0 - np.exp(-since / 2.0)) - swings_by * swings
    creeps = np.where(t < 8.0, creeps, np.interp(8.0, t, creeps))
    back = np.minimum(withdraws * np.maximum(t - 8.0, 0.0), 8e-3)
    return 1.9e-3 * np.clip(t - 1.0, 0.0, 1.0) + creeps - back - 5e-4


@pytest.mark.parametrize('seed', range(3))
@pytest.mark.parametrize(
    ('swings_by', 'withdraws'),
    [(0.0, 1.5e-3), (2.5e-4, 1.5e-3), (4e-4, 1.5e-3), (2.5e-4, 9e-3)],
)
def test_the_way_of_a_tool_that_presses_with_a_force_is_a_curve(
    swings_by: float, withdraws: float, seed: int
) -> None:
    """Corners at which it goes on nearly as before follow the samples as well, but no arm does."""
    t = np.arange(0.0, 12.0, 0.004)
    way = _pressed_by_a_force(t, swings_by, withdraws)
    phases = Segmentation(1.263, 8.0, 8.0, 11.0, 12.0, 0.04, 0.0, 0.0019, float(way.max()))
    value = way + 3e-6 * np.random.default_rng(seed).standard_normal(t.size)
    path = tool_path(Signal(t, value), phases)
    assert path.unsteady is not None
    fine = np.arange(2.1, 7.8, 1e-3)
    off = path.at(fine) - _pressed_by_a_force(fine, swings_by, withdraws)
    speeds = np.diff(off[::100]) / 0.1
    told = float(np.sqrt(np.mean(np.interp(fine, path.t, path.unsteady) ** 2) / 0.1))
    # By pieces it is 4.7 to 17 um/s.
    assert np.std(speeds) < min(told, 5e-6)
