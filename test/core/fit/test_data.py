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

"""The steps of a trial and the tool's path through its encoders' noise."""

from dataclasses import replace
import math

from hapticvision_ros.core.fit.bend import Bend, Shape
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.data import (
    _bend,
    _goes_by_ramps,
    _on_ticks,
    _tick,
    deepest_before,
    jitter_of,
    planned,
    prepare,
    reads_at_moments,
    suspects,
    tool_path,
    ToolPath,
)
from hapticvision_ros.core.fit.held_out import predict_unseen, Trained
from hapticvision_ros.core.models.motion import acceleration
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal, Trial
import numpy as np
import pytest
from scipy.signal import lfilter

PHASES = Segmentation(1.0, 3.0, 13.0, 13.1, 20.0, 0.04, 0.0, 0.003, 0.006)


def _tool(t: np.ndarray, corners: list[float], depths: list[float]) -> np.ndarray:
    return np.interp(t, corners, depths)


CORNERS, DEPTHS = [0.0, 3.0003, 13.0004, 20.0], [-0.003, 0.006, 0.006, -0.344]


def test_the_speed_of_a_straight_path_is_known_far_better_than_from_differences() -> None:
    """Encoders of 5 um at 500 Hz: the push's speed to 0.01 %, its corner to 0.5 ms."""
    t = np.arange(0.0, 20.0, 0.002)
    noise = 5e-6 * np.random.default_rng(0).standard_normal(t.size)
    path = tool_path(Signal(t, _tool(t, CORNERS, DEPTHS) + noise), PHASES)
    speed = np.diff(path.at(np.array([1.0, 2.9])))[0] / 1.9
    assert speed == pytest.approx(0.009 / 3.0003, rel=1e-4)
    assert np.min(np.abs(path.t - 3.0003)) < 5e-4
    assert path.noise == pytest.approx(5e-6, rel=0.1)
    # Nothing but the corners: a straight line is one piece.
    assert path.t.size <= 8


def test_a_curved_path_is_followed_within_the_noise() -> None:
    """A withdrawal under force control bends; no straight piece would do."""
    t = np.arange(0.0, 20.0, 0.002)
    bent = _tool(t, CORNERS, DEPTHS)
    late = (t > 13.0) & (t < 16.0)
    bent[late] = 0.006 - 0.003 * (1.0 - np.cos(t[late] - 13.0))
    bent[t >= 16.0] = bent[late][-1] - 0.05 * (t[t >= 16.0] - 16.0)
    noise = 5e-6 * np.random.default_rng(0).standard_normal(t.size)
    path = tool_path(Signal(t, bent + noise), PHASES)
    inside = (t > 0.5) & (t < 16.0) & (np.abs(t - 3.0) > 0.004)
    off = path.at(t[inside]) - bent[inside]
    assert np.sqrt(np.mean(off**2)) < 5e-6


def test_the_speed_between_two_long_changes_of_it_is_that_of_the_line_alone() -> None:
    """At 40 mm/s with 0.3 m/s^2 a push of 12 mm has 42 readings of 1 um at an even speed."""
    t = np.arange(0.0, 8.0, 0.004) + 0.0012
    phases = Segmentation(1.1, 1.433, 5.43, 5.6, 8.0, 0.05, 0.0, 0.04, 0.01)
    fine = np.arange(0.0, 8.0, 1e-4)
    turns = [1.0, 1.0 + 2.0 / 15.0, 1.3, 1.3 + 2.0 / 15.0, 5.433, 5.433 + 2.0 / 15.0, 5.808, 5.941]
    speed = np.interp(fine, turns, [0.0, 0.04, 0.04, 0.0, 0.0, -0.04, -0.04, 0.0])
    off = []
    for seed in range(16):
        random = np.random.default_rng(seed)
        way = np.interp(t - random.uniform(0.0, 4e-3), fine, np.cumsum(speed) * 1e-4) - 0.002
        path = tool_path(Signal(t, way + 1e-6 * random.standard_normal(t.size)), phases)
        off.append(np.diff(path.at(np.array([1.15, 1.29])))[0] / 0.14 - 0.04)
    # The readings tell it to 3.2 um/s; what bends the line by less than it shows remains.
    assert np.sqrt(np.mean(np.square(off))) < 8e-6


def _served(t: np.ndarray, speed: float, duration: float, lag: float) -> np.ndarray:
    """
    Return the way of an arm that stops at 3 s and withdraws at 13 s, by its equation of motion.

    Its servo follows what is commanded, which is accelerated evenly, with a first-order lag.
    """
    step = 1e-5
    fine = np.arange(-1.0, t[-1] + step, step)
    ramps = [3.0 - duration, 3.0, 13.0, 13.0 + duration]
    commanded = np.interp(fine, ramps, [speed, 0.0, 0.0, -0.02])
    followed = commanded
    if lag:
        keep = np.exp(-step / lag)
        followed = lfilter([1.0 - keep], [1.0, -keep], commanded, zi=[keep * speed])[0]
    way = np.cumsum(followed) * step
    return np.interp(t, fine, way - np.interp(0.0, fine, way)) - 0.001


@pytest.mark.parametrize('lag', [0.0, 0.012, 0.03])
@pytest.mark.parametrize('duration', [0.004, 0.05])
def test_how_a_servo_follows_is_seen_through_encoders_that_round(duration, lag) -> None:
    """Steps of 2 um: a stop over 50 ms is followed to a third of them, whatever the servo."""
    t = np.arange(0.0, 14.5, 0.004)
    way = _served(t, 0.0035, duration, lag)
    path = tool_path(Signal(t, np.round(way / 2e-6) * 2e-6), PHASES)
    near = np.arange(2.8, 3.3, 5e-4)
    off = path.at(near) - _served(near, 0.0035, duration, lag)
    # But for where the whole way is.
    off -= np.mean(off)
    assert np.sqrt(np.mean(off**2)) < (7e-7 if duration > 0.01 or lag else 1e-6)


def test_a_servos_lag_ends_without_a_jump_of_the_tool() -> None:
    bend = Bend(1.0, -0.05, Shape(0.01, 0.0, 0.02))
    path = ToolPath(np.array([0.0, 1.0, 3.0]), np.array([0.0, 0.05, 0.05]), 1e-6, (bend,), 1e-3)
    t = np.arange(bend.stop - 0.01, bend.stop + 0.01, 1e-5)
    assert np.abs(np.diff(path.at(t))).max() < 1e-5 * 2e-4


@pytest.mark.parametrize('speed', [0.001, 0.0035])
def test_how_a_tool_comes_to_rest_tells_where_it_rests_within_a_step(speed) -> None:
    """All readings of a rest are alike, and their mean no better than one: here steps of 10 um."""
    t = np.arange(0.0, 14.5, 0.004)
    way = _served(t, speed, 0.1, 0.0)
    still, just = (t > 4.0) & (t < 12.0), (t > 3.06) & (t < 3.2)
    read_off, path_off = [], []
    for shift in np.linspace(0.0, 1e-5, 16, endpoint=False):
        moved = way + shift
        read = np.round(moved / 1e-5) * 1e-5
        read_off.append((read - moved)[still][0])
        path_off.append((tool_path(Signal(t, read), PHASES).at(t[just]) - moved[just])[0])
    assert np.std(read_off) == pytest.approx(1e-5 / np.sqrt(12.0), rel=0.05)
    assert np.std(path_off) < 0.7 * np.std(read_off)


@pytest.mark.parametrize('speed', [0.001, 0.0035, 0.012])
def test_a_tool_that_reads_the_same_from_its_stop_to_its_start_does_not_creep(speed) -> None:
    """How it comes there and how it leaves tell where within a step of 10 um: at one place."""
    t = np.arange(0.0, 14.5, 0.004)
    way = _served(t, speed, 0.05, 0.03)
    rests = (t > 3.6) & (t < 12.5)
    first_off = []
    for shift in np.linspace(0.0, 1e-5, 16, endpoint=False):
        read = np.round((way + shift) / 1e-5) * 1e-5
        off = tool_path(Signal(t, read), PHASES).at(t[rests]) - (way + shift)[rests]
        assert abs(off[-1] - off[0]) < 1e-8
        first_off.append(off[0])
    # Those of one reading are off by 2.9 um.
    assert np.std(first_off) < 1.5e-6


def test_readings_that_flicker_at_rest_are_no_noise_of_a_tool_on_its_way() -> None:
    """One in eight is the next one, 10 um away, as noise of a seventh of that makes it there."""
    t = np.arange(0.0, 20.0, 0.002)
    way = _tool(t, [0.0, 3.0, 15.0, 18.0, 20.0], [-0.0006, 0.0006, 0.0006, -0.006, -0.006])
    noise = 1.4e-6 * np.random.default_rng(1).standard_normal(t.size)
    read = np.round((way - 0.0006 + 3.4e-6 + noise) / 1e-5) * 1e-5 + 0.0006
    path = tool_path(Signal(t, read), PHASES)
    # That of rounding, with what is added to it.
    assert 2.8e-6 < path.noise < 3.5e-6


def test_what_encoders_add_to_a_curve_makes_no_force() -> None:
    """Steps of 1e-5 of the depth, of samples that no shape of an arm follows."""
    random = np.random.default_rng(8)
    fine = np.arange(0.0, 20.0, 1e-4)
    turns = [0.0, 0.9, 1.0, 3.0, 3.1, 13.0, 13.1, 15.0, 15.1]
    speed = np.interp(fine, turns, [0.0, 0.0, 2.6e-3, 2.6e-3, 0.0, 0.0, -3e-3, -3e-3, 0.0])
    fine_way = np.cumsum(speed) * 1e-4 - 1e-4
    fine_way += 1e-5 * np.sin(2.0 * math.pi * 8.0 * np.clip(fine - 3.1, 0.0, 9.0))
    t = np.arange(0.0, 19.9, 0.004)
    noisy = np.interp(t, fine, fine_way) + 6e-8 * random.standard_normal(t.size)
    path = tool_path(Signal(t, 1e-7 * np.round(noisy / 1e-7)), PHASES)
    near = np.arange(4.0, 11.0, 0.002)
    off = np.diff(path.at(near) - np.interp(near, fine, fine_way)) / 0.002
    # Between samples the speed would be off by 6e-8 m times the root of two in 4 ms: 21 um/s.
    assert np.std(off) < 8e-6


def test_clean_encoders_are_followed_exactly() -> None:
    """Without noise the samples are the path, a sine as well as a line."""
    t = np.arange(0.0, 20.0, 0.002)
    wavy = _tool(t, CORNERS, DEPTHS) + 1e-3 * np.sin(3.0 * t)
    path = tool_path(Signal(t, wavy), PHASES)
    inside = wavy > 0.0
    np.testing.assert_allclose(path.at(t[inside]), wavy[inside], atol=1e-9)


@pytest.mark.parametrize('interval', [0.0005, 0.001, 0.01])
@pytest.mark.parametrize(
    ('duration', 'lag'), [(0.004, 0.0), (0.05, 0.0), (0.05, 0.012), (0.2, 0.03)]
)
def test_clean_encoders_tell_how_an_arm_stops_between_their_samples(
    duration, lag, interval
) -> None:
    """A straight line from one sample to the next of a stop over 50 ms is off by 0.9 um."""
    t = np.arange(0.0, 14.5, interval)
    path = tool_path(Signal(t, _served(t, 0.0035, duration, lag)), PHASES)
    near = np.arange(2.7, 3.4, 1e-4)
    way = _served(near, 0.0035, duration, lag)
    off = path.at(near) - way
    # Of a stop between two samples they tell where, and not how.
    hidden = duration < interval
    close = 3e-7 if lag else 1e-8
    assert np.abs(off).max() < (2e-6 if hidden else close)
    assert np.abs(off[np.abs(near - 3.0) > 0.02]).max() < close
    if not hidden:
        # No shape that follows the samples makes more of the speed than these do.
        straight = np.diff(np.interp(near, t, _served(t, 0.0035, duration, lag)) - way)
        assert np.abs(np.diff(off)).max() < max(1.01 * np.abs(straight).max(), 1e-9)


def _slowing(t: np.ndarray) -> np.ndarray:
    """Return the way of a tool that slows down over half a second, with a wobble."""
    fine = np.arange(0.0, 15.0, 1e-4)
    rest = np.clip((3.0 - fine) / 0.5, 0.0, 1.0)
    speed = 0.0035 * rest**3 * (10.0 - 15.0 * rest + 6.0 * rest**2)
    speed = speed * (1.0 + 0.2 * np.sin(30.0 * fine) * (1.0 - rest))
    way = np.cumsum(speed) * 1e-4
    return np.interp(t, fine, way - np.interp(1.0, fine, way))


@pytest.mark.parametrize(('interval', 'most'), [(0.0005, 4e-6), (0.001, 8e-6), (0.01, 13e-6)])
def test_clean_encoders_tell_a_way_that_no_shape_follows(interval, most) -> None:
    t = np.arange(0.0, 14.5, interval)
    path = tool_path(Signal(t, _slowing(t)), PHASES)
    near = np.arange(2.52, 2.98, 1e-4)
    speed, way = np.diff(path.at(near)) / 1e-4, np.diff(_slowing(near)) / 1e-4
    # Straight lines between samples 10 ms apart are off by up to 77 um/s.
    assert np.abs(speed - way).max() < most


def test_encoders_that_round_all_readings_alike_are_not_clean() -> None:
    """At 12 mm/s and 50 Hz a tool goes by 12 steps of 20 um from one reading to the next."""
    t = np.arange(0.0, 8.0, 0.02)
    way = np.interp(
        t, [1.0, 1.511, 4.0, 4.6, 8.0], [0.0, 0.006132, 0.006132, -0.005868, -0.005868]
    )
    read = np.round(way / 2e-5) * 2e-5
    path = tool_path(Signal(t, read), PHASES)
    # Nothing tells when between two readings it stopped.
    near = np.arange(1.4, 1.6, 1e-3)
    assert np.abs(path.at(near) - np.interp(near, t, read)).max() < 1e-12


def test_a_corner_between_clean_encoders_is_no_curve() -> None:
    t = np.arange(0.0, 14.5, 0.01)
    bent = np.minimum(0.001 * (t - 1.00037), 0.00200291)
    path = tool_path(Signal(t, bent), PHASES)
    near = np.arange(2.9, 3.1, 5e-4)
    assert np.abs(path.at(near) - np.minimum(0.001 * (near - 1.00037), 0.00200291)).max() < 1e-9


def test_a_quick_withdrawal_between_slow_samples_does_not_bend_the_hold() -> None:
    """The arm is at 20 mm/s after two samples of 50 Hz: no line, and no acceleration, is seen."""
    t = np.arange(0.0, 20.0, 0.02)
    bent = _tool(t, CORNERS[:2], DEPTHS[:2])
    since = np.maximum(t - 13.0, 0.0)
    bent -= np.where(since < 0.04, 0.25 * since**2, 0.02 * (since - 0.02))
    noise = 1e-6 * np.random.default_rng(0).standard_normal(t.size)
    path = tool_path(Signal(t, bent + noise), PHASES)
    still = np.linspace(3.1, 12.9, 500)
    # Each step of the encoders' noise would be a speed of 50 um/s.
    assert np.abs(np.diff(path.at(still)) / np.diff(still)).max() < 1e-6
    inside = bent > 0.0
    assert np.abs(path.at(t[inside]) - bent[inside]).max() < 6e-6
    assert path.interval == pytest.approx(0.02)


def test_a_tool_at_rest_high_above_the_object_does_not_creep() -> None:
    """Friction acts in air as well, once the tool moves."""
    t = np.arange(0.0, 20.0, 0.004)
    way = _tool(t, [0.0, 1.0, 3.0003, 13.0004, 20.0], [-0.009, -0.009, 0.006, 0.006, -0.344])
    path = tool_path(
        Signal(t, way + 1e-6 * np.random.default_rng(0).standard_normal(t.size)), PHASES
    )
    early, later = path.at(np.array([0.1, 0.9])), path.at(np.array([1.1, 1.3]))
    assert abs(np.diff(early)[0]) / 0.8 < 5e-6
    assert np.diff(later)[0] / 0.2 == pytest.approx(0.0075, rel=1e-3)


def _trial() -> Trial:
    t = np.arange(0.0, 20.0, 0.001)
    force = np.where((t > 1.0) & (t < 13.0), 5.0, 0.0)
    force += 0.01 * np.random.default_rng(1).standard_normal(t.size)
    height = np.maximum(_tool(t[::100], CORNERS, DEPTHS), 0.0)
    height += 1e-5 * np.random.default_rng(2).standard_normal(height.size)
    return Trial(
        name='trial',
        start_ns=10**9,
        force=Signal(t, force),
        tool_height=Signal(t, 0.04 - _tool(t, CORNERS, DEPTHS)),
        displacement_height=Signal(t[::100], height),
    )


def test_steps_hold_every_sample_once_and_are_short_near_events() -> None:
    """Sums over steps are sums over samples; at touch and stop each sample has its own step."""
    trial = _trial()
    (made,), warnings = prepare([(trial, PHASES)])
    assert warnings == ()
    assert made.force_count.sum() == len(trial.force)
    assert made.force_count @ made.force == pytest.approx(trial.force.value.sum())
    assert made.force.size < 0.1 * len(trial.force)
    near = np.abs(made.t[:-1] - 3.0) < 0.02
    assert np.all(made.force_count[near] == 1.0)
    # Most steps are as long as the one before them, and some are many times longer than others.
    alike = np.diff(made.force_count[1:]) == 0.0
    assert np.count_nonzero(~alike) < 0.2 * alike.size
    assert made.force_count.max() > 50.0
    full = made.full_rate
    assert full.force.size == len(trial.force)
    head = made.head(50)
    assert head.t[-1] == made.t[-1] and head.t.size == head.displacement.size == 52
    assert np.array_equal(head.force[:50], made.force[:50])
    assert head.force_count[50] == 0.0 and head.height.size == head.height_t.size == 0
    assert np.array_equal(made.head(made.force.size).t, made.t)


def _curved(error: float, jump: float = 0.0) -> Trial:
    """Return a trial whose tool goes along a curve, which its encoders tell to `error`."""
    t = np.arange(0.0, 20.0, 0.001)

    def way(t: FloatArray) -> FloatArray:
        down, up = np.clip((t - 1.0) / 4.0, 0.0, 1.0), np.clip((t - 13.0) / 4.0, 0.0, 1.0)
        gone = [part**3 * (10.0 - 15.0 * part + 6.0 * part**2) for part in (down, up)]
        return 0.016 * (gone[0] - gone[1]) - 0.008 - jump * np.maximum(t - 14.0, 0.0)

    force = 600.0 * np.maximum(way(t), 0.0)
    force += 0.01 * np.random.default_rng(1).standard_normal(t.size)
    told = way(t[::4]) + error * np.random.default_rng(2).standard_normal(t[::4].size)
    return Trial('trial', 0, Signal(t, force), Signal(t[::4], 0.04 - told), None)


CURVED = replace(PHASES, t_contact=3.0, t_hold=5.0, t_release=13.0, t_loss=15.0, depth=0.008)


@pytest.mark.parametrize('error', [0.0, 3e-6])
def test_along_a_curve_steps_are_as_long_as_it_is_straight(error: float) -> None:
    """Corners of a curve are none of the tool: there is nothing to follow sample by sample."""
    trial = _curved(error)
    (made,), warnings = prepare([(trial, CURVED)])
    assert warnings == ()
    assert made.path.curved
    assert made.force_count.sum() == len(trial.force)
    assert made.force.size < 0.25 * len(trial.force)
    near = np.abs(made.t[:-1] - 3.0) < 0.02
    assert np.all(made.force_count[near] == 1.0)
    moving = (made.t[:-1] > 1.5) & (made.t[:-1] < 4.5)
    assert made.force_count[moving].max() > 1.0
    straight = made.path.straight(made.middle)
    assert np.all(made.duration[moving] < 1.001 * straight[moving])
    held = (made.t[:-1] > 8.0) & (made.t[:-1] < 10.0)
    assert made.force_count[held].min() > 30.0
    # Within its steps the tool is where it would be at each sample.
    full = made.full_rate
    off = np.interp(full.t, made.t, made.displacement) - full.displacement
    assert np.abs(off[(full.t > 3.0) & (full.t < 15.0)]).max() < 1e-6


def test_where_the_tool_jumps_on_a_curve_steps_are_short() -> None:
    """It stops at once on its way up, or goes on sooner: the force may jump there."""
    (made,), _ = prepare([(_curved(0.0, jump=0.004), CURVED)])
    assert made.path.jerks == pytest.approx([5.0, 13.0, 14.0], abs=0.005)
    beside = np.abs(made.t[:-1] - made.path.jerks[-1]) < 0.02
    assert np.all(made.force_count[beside] == 1.0)
    before = np.abs(made.t[:-1] - 13.8) < 0.02
    assert np.all(made.force_count[before] > 1.0)


def test_a_curve_keeps_the_ends_of_its_bends() -> None:
    """A path of many ways has shapes of arms at more corners than a curve has to have."""
    bend = Bend(1.0, -0.05, Shape(0.01, 0.0, 0.02))
    t = np.linspace(0.0, 2.0, 401)
    path = ToolPath(t, 0.01 * np.sin(t), 1e-7, (bend,), 0.005, curved=True)
    assert path.jerks == [bend.start, bend.stop]


@pytest.mark.parametrize('every', [1, 4])
def test_where_an_even_push_goes_on_slower_on_a_curved_record_steps_are_short(every: int) -> None:
    """The withdrawal, at least jerk and 25 times as fast, makes little of that jump of speed."""
    t = np.arange(0.0, 20.0, 0.001)
    part = np.clip((t - 13.0) / 0.5625, 0.0, 1.0)
    way = -0.012 + 0.004 * np.clip(t - 1.0, 0.0, 4.0) + 0.0005 * np.clip(t - 5.0, 0.0, 4.0)
    way -= 0.03 * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    force = Signal(t, 600.0 * np.maximum(way, 0.0))
    trial = Trial('trial', 0, force, Signal(t[::every], 0.04 - way[::every]), None)
    phases = replace(PHASES, t_contact=4.0, t_hold=9.0, t_release=13.0, t_loss=13.2, depth=0.006)
    (made,), _ = prepare([(trial, phases)])
    assert made.path.curved
    assert np.all(made.force_count[np.abs(made.t[:-1] - 5.0) < 0.02] == 1.0)
    full = made.full_rate
    off = np.interp(full.t, made.t, made.displacement) - full.displacement
    assert np.abs(off[(full.t > 4.0) & (full.t < 13.0)]).max() < 1e-6
    assert made.force.size < 0.3 * len(trial.force)


def test_the_head_of_a_curved_trial_is_as_curved() -> None:
    """It is used to find where the whole trial touches."""
    (made,), _ = prepare([(_curved(0.0), CURVED)])
    head = made.head(int(np.searchsorted(made.t, 3.4)))
    assert head.path.t.size < 300
    assert head.path.curved
    assert made.turns is None
    assert head.turns is None


def test_a_glitch_is_left_out_of_its_step() -> None:
    """The mean of a step is that of its good samples."""
    trial = _trial()
    value = trial.force.value.copy()
    value[8000] = 50.0
    (made,), _ = prepare([(replace(trial, force=Signal(trial.force.t, value)), PHASES)])
    assert made.set_aside.tolist() == pytest.approx([8.0])
    assert made.force_count.sum() == len(trial.force) - 1
    assert made.force.max() < 6.0


def test_a_step_of_the_force_is_no_glitch() -> None:
    """A jump that stays is what an object does."""
    value = np.repeat([0.0, 5.0], 500) + 0.01 * np.random.default_rng(2).standard_normal(1000)
    assert not suspects(value).any()


def test_where_a_quantised_record_rests_its_other_steps_are_no_glitches() -> None:
    """That part alone does not show how the record is quantised."""
    random = np.random.default_rng(5)
    fall = 3.6 * np.exp(-np.arange(4000) / 400.0)
    value = np.round((fall + 0.018 * random.standard_normal(4000)) / 0.09) * 0.09
    value = np.append(value, np.zeros(8000))
    value[[7000, 9000, 9001, 11000]] = 0.09
    assert not suspects(value).any()
    value[10000] = 0.9
    assert np.flatnonzero(suspects(value)).tolist() == [10000]
    # One value out of this world hides no glitch elsewhere.
    value[5000] = 1e30
    assert np.flatnonzero(suspects(value)).tolist() == [5000, 10000]


def test_what_cannot_be_fitted_is_named_with_the_reason() -> None:
    """No contact, and a tool that does not push."""
    trial = _trial()
    none = replace(PHASES, t_contact=None, contact_height=None)
    high = replace(PHASES, contact_height=0.01)
    made, warnings = prepare([(trial, none), (trial, high)])
    assert made == (None, None)
    assert 'no contact' in warnings[0]
    assert 'does not go on' in warnings[1]


@pytest.mark.parametrize('share', [0.0, 0.1, 0.3, 1.0])
def test_a_record_that_begins_in_the_push_is_not_fitted(share: float) -> None:
    """The displacement height tells; without one it may as well begin at the touch."""
    trial = _trial()
    start = float(trial.force.t[0])
    height = Signal(trial.tool_height.t, np.full(len(trial.tool_height), 0.006))
    height.value[:10] *= share
    begun = replace(PHASES, t_contact=start)
    seen = replace(trial, displacement_height=height, displacement_source='topic')
    told = replace(seen, displacement_source='tool')
    made, warnings = prepare([(seen, begun), (told, begun), (seen, PHASES)])
    assert (made[0] is None) == (share > 0.2)
    assert None not in made[1:]
    # That it does not follow the tool is another matter.
    cut = [warning for warning in warnings if 'is not used' not in warning]
    assert len(cut) == (share > 0.2)
    assert all('begins in contact' in warning for warning in cut)


def test_a_record_that_begins_in_the_hold_is_not_fitted() -> None:
    made, warnings = prepare([(_trial(), replace(PHASES, push_is_cut=True))])
    assert made == (None,)
    assert 'begins in contact' in warnings[0]


def test_campaign_time_and_depth_are_those_of_the_campaign() -> None:
    """The first that is given starts later; both know the deepest push."""
    trial = _trial()
    later = replace(trial, start_ns=trial.start_ns + 60 * 10**9)
    made, _ = prepare([(later, PHASES), (trial, PHASES)])
    assert [t.campaign_time for t in made] == pytest.approx([60.0, 0.0])
    assert made[0].reference_depth == pytest.approx(0.006, rel=1e-3)
    assert [t.depth_before for t in made] == pytest.approx([0.006, 0.0], rel=1e-3)


def test_the_deepest_push_before_may_be_any_that_was_made() -> None:
    pushes = [(0.0, 0.003), (50.0, 0.006), (70.0, 0.002), (100.0, 0.009)]
    told = [deepest_before(start, pushes) for start, _ in pushes]
    assert told == [0.0, 0.003, 0.006, 0.006]
    trial = _trial()
    later = replace(trial, start_ns=trial.start_ns + 60 * 10**9)
    # No model is fitted to the first, which begins in contact.
    made, _ = prepare([(trial, replace(PHASES, push_is_cut=True)), (later, PHASES)])
    assert made[0] is None and made[1] is not None
    assert made[1].depth_before == PHASES.depth


def test_a_corner_within_a_gap_of_the_record_does_no_harm() -> None:
    t = np.arange(0.0, 20.0, 0.002)
    kept = np.abs(t[:, np.newaxis] - np.array(CORNERS)).min(axis=1) > 0.4
    noise = np.random.default_rng(4).normal(0.0, 1e-6, t.size)
    path = tool_path(Signal(t[kept], (_tool(t, CORNERS, DEPTHS) + noise)[kept]), PHASES)
    assert np.abs(path.at(t[kept]) - _tool(t, CORNERS, DEPTHS)[kept]).max() < 1e-5


def _stopping(t: np.ndarray, speed: float, depth: float) -> np.ndarray:
    """Return the way of a tool from 1 mm above, which stops at 0.5 m/s^2."""
    stop = 0.9 + (depth + 0.001) / speed
    half = 0.5 * speed / 0.5
    since = np.clip(t - stop + half, 0.0, 2.0 * half)
    moved = speed * np.clip(t - 0.9, 0.0, stop - half - 0.9) + since * (speed - 0.25 * since)
    return np.asarray(moved - 0.001)


def test_a_stop_after_few_samples_of_the_encoders_is_found() -> None:
    """A push of 0.2 s at 50 Hz: the arm stops within two samples, over 35 ms."""
    t = np.arange(0.007, 20.0, 0.02)
    noise = 1e-6 * np.random.default_rng(0).standard_normal(t.size)
    path = tool_path(Signal(t, _stopping(t, 0.0177, 0.003) + noise), PHASES)
    (bend,) = path.bends
    assert bend.shape.duration == pytest.approx(0.0354, rel=0.1)
    fine = np.linspace(1.0, 3.0, 4001)
    assert np.abs(path.at(fine) - _stopping(fine, 0.0177, 0.003)).max() < 4e-6


def _without(trial: Trial, start: float, stop: float) -> Trial:
    """Return a trial whose encoders are silent for some time."""
    seen = (trial.tool_height.t < start) | (trial.tool_height.t > stop)
    height = Signal(trial.tool_height.t[seen], trial.tool_height.value[seen])
    return replace(trial, name='silent', tool_height=height)


def test_a_trial_whose_encoders_miss_the_stop_is_left_out() -> None:
    whole = _trial()
    silent = _without(whole, 2.7, 3.4)
    (kept, left), told = prepare([(whole, PHASES), (silent, PHASES)])
    assert kept is not None
    assert left is None
    (warning,) = told
    assert warning.startswith('silent: the tool height is missing from 2.699 s to 3.401 s')
    # Where there is no other trial, it is better than none.
    (alone,), told = prepare([(silent, PHASES)])
    assert alone is not None
    assert 'may be off' in told[0]


@pytest.mark.parametrize('silence', [(1.5, 2.5), (5.0, 9.0)], ids=['push', 'hold'])
def test_a_gap_in_which_the_tool_went_straight_on_does_no_harm(
    silence: tuple[float, float],
) -> None:
    made, told = prepare([(_trial(), PHASES), (_without(_trial(), *silence), PHASES)])
    assert None not in made
    assert told == ()


def test_the_speed_of_a_quick_push_is_known_as_well_as_its_stamps() -> None:
    """At 25 mm/s stamps that are off by 1 ms are heights that are off by 25 um."""
    t = np.arange(0.007, 20.0, 0.02)
    random = np.random.default_rng(0)
    late, noise = 1e-3 * random.standard_normal(t.size), 1e-6 * random.standard_normal(t.size)
    phases = replace(PHASES, t_contact=0.95)
    errors = []
    for moments in (t, t + late):
        way = _stopping(moments, 0.0257, 0.0044) - 0.02 * np.maximum(moments - 13.0, 0.0)
        heights = Signal(t, 0.04 - way - noise)
        ((made,), _) = prepare([(replace(_trial(), tool_height=heights), phases)])
        assert made is not None
        push, error = made.pushed
        assert made.t[push.start] <= 0.95 < made.t[push.start + 1]
        assert made.displacement[push.stop] == pytest.approx(0.0044, rel=0.05)
        errors.append(error)
    # 25 um of 4.4 mm in 9 samples.
    assert errors[0] < 1e-3
    assert 3e-3 < errors[1] < 2e-2


def _jittering(fine: np.ndarray, way: np.ndarray, late: tuple[float, float]) -> Signal:
    """Return heights of a way whose stamps are off by 1 ms, some of them by much more."""
    t = np.arange(0.007, fine[-1], 0.02)
    moments = t + 1e-3 * np.random.default_rng(4).standard_normal(t.size)
    stale = 0.03 * ((t > late[0]) & (t < late[1]))
    return Signal(t, np.interp(moments - stale, fine, way))


def test_heights_that_are_stamped_late_are_left_out() -> None:
    fine = np.array([0.0, 2.35, 13.0, 15.0])
    way = np.array([-0.01035, 0.0155, 0.0155, -0.02])
    heights = _jittering(fine, way, (1.5, 1.6))
    path = tool_path(heights, replace(PHASES, t_contact=0.94, t_hold=2.35))
    pushed = heights.t[(heights.t > 0.9) & (heights.t < 2.3)]
    assert np.abs(path.at(pushed) - np.interp(pushed, fine, way)).max() < 2e-5


def test_a_push_after_a_pause_is_not_taken_for_late_stamps() -> None:
    """The tool stands still for a moment, 1 mm above the object, before it pushes."""
    fine = np.arange(0.0, 7.0, 1e-4)
    times = [1.0, 1.022, 1.823, 1.845, 1.867, 2.2835, 2.3055, 4.3054, 4.3454, 4.995, 5.035]
    speeds = [0.0, 0.011, 0.011, 0.0, 0.011, 0.011, 0.0, 0.0, -0.02, -0.02, 0.0]
    speed = np.interp(fine, times, speeds)
    way = np.concatenate(([0.0], np.cumsum(0.5e-4 * (speed[1:] + speed[:-1]))))
    way -= np.interp(1.94, fine, way)
    heights = _jittering(fine, way, (0.0, 0.0))
    path = tool_path(heights, Segmentation(1.94, 2.29, 4.31, 4.31, 7.0, 0.04, 0.0, 0.01, 0.004))
    pushed = heights.t[(heights.t > 1.87) & (heights.t < 2.28)]
    assert np.abs(path.at(pushed) - np.interp(pushed, fine, way)).max() < 2e-5


def _quick(name: str, noise: float, first: float, rounded: float = 0.0) -> Trial:
    """Return a push of 9 samples of the encoders, under a load cell of some noise."""
    random = np.random.default_rng(5)
    t = np.arange(first, 20.0, 0.02)
    moments = t + 1e-3 * random.standard_normal(t.size)
    way = _stopping(moments, 0.0257, 0.0044) - 0.02 * np.maximum(moments - 13.0, 0.0)
    height = 0.04 - way - 1e-6 * random.standard_normal(t.size)
    whole = _trial()
    force = np.where(whole.force.t < 0.95, 0.0, 5.0 + np.arange(len(whole.force)) * 1e-6)
    force += noise * random.standard_normal(force.size)
    if rounded:
        force = rounded * np.round(force / rounded)
    return replace(
        whole, name=name, force=Signal(whole.force.t, force), tool_height=Signal(t, height)
    )


@pytest.mark.parametrize('share', [1.0, 0.15, 0.02, -1.0, 1000.0])
def test_a_height_that_does_not_go_with_the_tool_is_not_used(share: float) -> None:
    """One that is dead, turned or in millimetres; a soft arm leaves most of the way to others."""
    whole = _trial()
    t = np.arange(0.0, 20.0, 0.05)
    noise = 2e-5 * np.random.default_rng(1).standard_normal(t.size)
    way = np.maximum(PHASES.contact_height - whole.tool_height.at(t), 0.0)
    seen = replace(
        whole,
        displacement_height=Signal(t, share * way + noise * max(abs(share), 1.0)),
        displacement_source='topic',
    )
    (made,), told = prepare([(seen, PHASES)])
    assert made is not None
    if share in (1.0, 0.15):
        assert made.height_t.size > 100 and told == ()
        return
    assert made.height_t.size == 0
    (warning,) = told
    assert float(warning.split(' goes ')[1].split()[0]) == pytest.approx(share, rel=0.2)
    assert warning.endswith('and is not used')


def test_a_push_whose_speed_swamps_the_noise_of_its_force_is_left_out() -> None:
    """By the noise before the contact, of which the sample of the touch is no part."""
    phases = replace(PHASES, t_contact=0.95)
    loud = _quick('loud', 0.5, 0.007)
    for first in (0.001, 0.007, 0.013):
        for noise, rounded in ((0.005, 0.0), (1e-5, 0.01)):
            quiet = _quick('quiet', noise, first, rounded)
            (kept, left), told = prepare([(loud, phases), (quiet, phases)])
            assert kept is not None and left is None
            assert 'its speed is known to' in told[0]
            share = float(told[0].split(' times the noise')[0].split()[-1])
            assert 1.0 < share < 200.0


@pytest.mark.parametrize(('second', 'deeper'), [(0.0257, 0.003), (0.002, 0.006)])
def test_a_push_in_steps_is_as_well_known_as_its_longest_way(second: float, deeper: float) -> None:
    """A first step of some samples of the encoders, and a second one as quick, or slow."""
    random = np.random.default_rng(6)
    t = np.arange(0.007, 20.0, 0.02)
    moments = t + 2e-3 * random.standard_normal(t.size)
    way = _stopping(moments, 0.0257, 0.0044)
    way += second * np.clip(moments - 5.0, 0.0, deeper / second)
    way -= 0.02 * np.maximum(moments - 13.0, 0.0)
    heights = Signal(t, 0.04 - way - 1e-6 * random.standard_normal(t.size))
    steps = replace(_quick('steps', 0.005, 0.007), tool_height=heights)
    first = 0.95 + 0.0044 / 0.0257
    phases = replace(PHASES, t_contact=0.95, t_first=first, t_hold=5.0 + deeper / second)
    loud = _quick('loud', 0.5, 0.007)
    (_, made), told = prepare([(loud, replace(PHASES, t_contact=0.95)), (steps, phases)])
    if second == 0.0257:
        assert made is None and 'its speed is known to' in told[0]
    else:
        assert made is not None and told == ()
        assert made.pushed[1] > 0.005 > 3.0 * made.best_pushed


def test_a_planned_push_is_seen_by_the_same_encoders() -> None:
    (made,), _ = prepare([(_trial(), PHASES)])
    assert made is not None
    made = replace(made, path=replace(made.path, noise=1e-5))
    push = planned(
        made, push_speed=0.03, depth=0.006, hold_time=2.0, release=True, campaign_time=0.0
    )
    assert push.path.interval == made.path.interval
    assert push.pushed[1] > made.pushed[1]
    assert push.depth_before == made.reference_depth


def test_a_short_hold_leaves_both_changes_of_speed() -> None:
    """A stop and a start of the release within 64 samples of the encoders are two corners."""
    t = np.arange(0.0, 4.0, 0.004)
    random = np.random.default_rng(0)
    speed = np.interp(t, [0.0, 1.99, 2.01, 2.2, 2.24], [0.01, 0.01, 0.0, 0.0, -0.02], right=-0.02)
    way = -0.01 + np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.004)))
    phases = replace(PHASES, t_contact=1.0, t_hold=2.0, t_release=2.2, t_loss=2.5, t_end=4.0)
    path = tool_path(Signal(t, way + 2e-6 * random.standard_normal(t.size)), phases)
    bends = [bend for bend in path.bends if 1.9 < bend.t < 2.4]
    assert [bend.t for bend in bends] == pytest.approx([2.0, 2.22], abs=0.003)
    assert [bend.shape.duration for bend in bends] == pytest.approx([0.02, 0.04], rel=0.2)


def test_a_record_that_is_sparse_in_the_hold_has_no_gap() -> None:
    """As relaxation is often kept: dense at first, then every two seconds; encoders of 5 um."""
    whole = _trial()
    t, value = whole.tool_height.t, whole.tool_height.value
    kept = (t < 4.0) | (t > 12.9) | (np.arange(t.size) % 2000 == 0)
    noise = 5e-6 * np.random.default_rng(0).standard_normal(t.size)
    sparse = replace(whole, tool_height=Signal(t[kept], (value + noise)[kept]))
    # The push that ends at a sample after a gap went straight on until then.
    ends = (t < 2.0) | (t >= 3.0)
    straight = replace(whole, tool_height=Signal(t[ends], value[ends]))
    made, told = prepare([(whole, PHASES), (sparse, PHASES), (straight, PHASES)])
    assert None not in made
    assert told == ()


def test_a_gap_of_the_force_has_steps_without_samples() -> None:
    """No sample stands for what it has not seen, and none is told to be set aside."""
    whole = _trial()
    t, value = whole.force.t, whole.force.value
    kept = (t < 0.90) | (t > 1.15)
    (made,), told = prepare([(replace(whole, force=Signal(t[kept], value[kept])), PHASES)])
    assert told == ()
    assert made.set_aside.size == 0
    assert made.force_count.sum() == np.count_nonzero(kept)
    assert made.full_rate.force_count.sum() == np.count_nonzero(kept)
    assert np.all(np.diff(made.full_rate.t) > 0.0)
    seen = made.full_rate.force_count > 0.0
    lengths = np.diff(made.full_rate.t)
    assert lengths[seen].max() < 1.6e-3
    inside = (made.full_rate.middle > 0.901) & (made.full_rate.middle < 1.149)
    assert not np.any(seen & inside)
    assert lengths.max() < 2e-3
    # The touch is somewhere in the gap.
    unsure = replace(PHASES, contact_height_std=3e-4)
    (made,), _ = prepare([(replace(whole, force=Signal(t[kept], value[kept])), unsure)])
    assert made.onset_std >= 3e-4


def test_turns_of_the_tool_within_steps_are_known() -> None:
    """A corner between two samples of the force, and encoders twice as dense as it."""
    whole = _trial()
    t, value = whole.force.t, whole.force.value
    slow = replace(whole, force=Signal(t[::4], value[::4]))
    (made,), _ = prepare([(slow, PHASES)])
    assert made.turns is not None
    added = np.delete(made.turns.t, made.turns.ends)
    assert np.array_equal(made.turns.t[made.turns.ends], made.t)
    np.testing.assert_allclose(made.turns.displacement, made.path.at(made.turns.t), atol=1e-12)
    # Those of the push and of the hold; what the tool does in the air is nobody's matter.
    assert np.min(np.abs(added - CORNERS[1])) < 1e-3
    assert np.min(np.abs(added - CORNERS[2])) < 1e-3
    assert np.all(made.path.at(added) > 0.0)


def test_a_change_of_speed_within_few_steps_is_made_of_short_straight_parts() -> None:
    t = np.arange(0.0, 20.0, 0.004)
    speed = np.interp(t, [0.0, 2.990, 3.006], [0.003, 0.003, 0.0])
    way = -0.003 + np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * 0.004)))
    noise = 3e-7 * np.random.default_rng(0).standard_normal(t.size)
    trial = replace(_trial(), tool_height=Signal(t, 0.04 - way - noise))
    trial = replace(trial, force=Signal(t, np.interp(t, trial.force.t, trial.force.value)))
    (made,), _ = prepare([(trial, PHASES)])
    (bend,) = [bend for bend in made.path.bends if 2.9 < bend.t < 3.1]
    assert bend.shape.duration > 0.008
    assert made.turns is not None
    inside = (made.turns.t > bend.start) & (made.turns.t < bend.stop)
    assert np.diff(made.turns.t[inside]).max() < 1.1e-3


def test_a_path_through_the_samples_of_the_encoders_splits_no_step() -> None:
    """Each of its corners is noise as well: what yields would yield to it."""
    whole = _trial()
    t, value = whole.tool_height.t, whole.tool_height.value
    wavy = replace(whole, tool_height=Signal(t, value + 1e-4 * np.sin(30.0 * t)))
    wavy = replace(wavy, force=Signal(whole.force.t[::4], whole.force.value[::4]))
    (made,), _ = prepare([(wavy, PHASES)])
    assert made.path.t.size > 1000
    assert made.turns is None


def test_samples_that_come_unevenly_and_say_so_are_no_noise_of_the_encoders() -> None:
    """A twentieth of an interval to and fro, a micrometre at 10 mm/s and more, on one line."""
    random = np.random.default_rng(6)
    t = np.arange(0.0, 20.0, 0.02) + 1e-3 * random.standard_normal(1000)
    fine = np.array([0.0, 0.9, 1.0, 3.0, 13.0, 15.0, 20.0])
    way = np.array([-0.01, -0.001, 0.0, 0.02, 0.02, -0.02, -0.12])
    read = np.interp(t, fine, way) + 5e-7 * random.standard_normal(t.size)
    assert tool_path(Signal(t, read), PHASES).noise == pytest.approx(5e-7, rel=0.2)


def test_a_change_of_speed_in_the_air_is_followed() -> None:
    """The force of the tool's own mass is there as well; at rest and in motion there is none."""
    fine = np.arange(0.0, 20.0, 1e-4)
    times = [0.3, 0.42, 2.94, 3.06, 12.94, 13.06, 13.5, 13.62]
    speeds = [0.0, 0.003, 0.003, 0.0, 0.0, -0.02, -0.02, 0.0]
    speed = np.interp(fine, times, speeds)
    way = np.concatenate(([0.0], np.cumsum(0.5e-4 * (speed[1:] + speed[:-1]))))
    way -= np.interp(1.0, fine, way)
    t = np.arange(0.001, 19.9, 0.01)
    noise = 1e-6 * np.random.default_rng(7).standard_normal(t.size)
    path = tool_path(Signal(t, np.interp(t, fine, way) + noise), PHASES)
    steps = np.arange(0.0, 19.0, 0.005)
    found = acceleration(steps, path.at(steps))
    expected = acceleration(steps, np.interp(steps, fine, way))
    assert np.abs(expected).max() > 0.02
    # A step that a change of speed begins or ends in is off by a part of it.
    assert np.sqrt(np.mean((found - expected) ** 2)) < 0.05 * np.sqrt(np.mean(expected**2))


@pytest.mark.parametrize('at', [1.4, 2.0, 8.0])
def test_a_height_beyond_both_of_its_neighbours_is_left_out(at: float) -> None:
    """On the way down too, where heights are far from each other."""
    whole = _trial()
    height = whole.displacement_height
    index = int(np.searchsorted(height.t, at))
    value = height.value.copy()
    value[index] -= 0.003
    astray = replace(whole, displacement_height=Signal(height.t, value))
    (made,), _ = prepare([(astray, PHASES)])
    (clean,), _ = prepare([(whole, PHASES)])
    assert made is not None and clean is not None
    assert clean.height_count.sum() == len(height)
    # On the way down the one before it is beyond both as well.
    assert 1 <= len(height) - made.height_count.sum() <= 2
    assert height.t[index] not in made.height_t
    assert np.abs(made.height - np.interp(made.height_t, height.t, height.value)).max() < 1e-4


@pytest.mark.parametrize(
    ('away', 'samples', 'aside'),
    [(5, 1, True), (1, 1, False), (5, 3, False), (-6, 1, True)],
)
def test_one_force_alone_near_a_touch_is_a_glitch(away: int, samples: int, aside: bool) -> None:
    """Right at the touch, or for some samples, it may be what the object does."""
    trial = _trial()
    value = trial.force.value.copy()
    touch = int(np.argmax(value > 2.5))
    value[touch + away + np.arange(samples)] += 0.5
    (made,), _ = prepare([(replace(trial, force=Signal(trial.force.t, value)), PHASES)])
    assert made is not None
    expected = trial.force.t[[touch + away]].tolist() if aside else []
    assert made.set_aside.tolist() == pytest.approx(expected)


def test_the_lowest_force_of_a_slip_is_no_glitch() -> None:
    """It comes back at once, and does not go there so."""
    trial = _trial()
    value = trial.force.value.copy()
    touch = int(np.argmax(value > 2.5))
    value[touch + np.array([5, 6])] -= (0.5, 1.6)
    (made,), _ = prepare([(replace(trial, force=Signal(trial.force.t, value)), PHASES)])
    assert made is not None
    assert made.set_aside.size == 0


def test_what_lets_go_at_once_is_no_glitch() -> None:
    """Near the loss of contact a sticky object pulls for a sample."""
    trial = _trial()
    value = trial.force.value.copy()
    loss = len(value) - int(np.argmax(value[::-1] > 2.5))
    value[loss + 4] -= 0.5
    (made,), _ = prepare([(replace(trial, force=Signal(trial.force.t, value)), PHASES)])
    assert made is not None
    assert made.set_aside.size == 0


@pytest.mark.parametrize('interval', [0.02, 0.002])
def test_a_change_of_speed_in_few_samples_is_taken_for_what_it_nearly_is(interval: float) -> None:
    """Half a cosine, of which encoders show by 0.2 um that it is another shape."""
    fine = np.arange(0.0, 2.0, 1e-4)
    speed = -0.02 * (1.0 - np.cos(np.pi * np.clip((fine - 0.96) / 0.08, 0.0, 1.0)))
    way = np.concatenate(([0.0], np.cumsum(0.5e-4 * (speed[1:] + speed[:-1]))))
    t = np.arange(0.001, 1.99, interval)
    read = np.round(np.interp(t, fine, way) / 1e-7) * 1e-7
    turned = _bend(t, read, (0.0, 0.95, 1.05, 1.98), interval, 5e-8, 1e-7, 3, None)
    if interval < 0.01:
        # Many samples show the way itself.
        assert turned is None
        return
    assert turned is not None
    near = (fine > 0.9) & (fine < 1.1)
    there = turned.level + turned.bend.turn * np.maximum(fine[near] - turned.bend.t, 0.0)
    assert np.abs(there + turned.bend.beyond(fine[near]) - way[near]).max() < 2e-6


def _slowly(t: np.ndarray, changes: list[tuple[float, float, float]], end: float) -> np.ndarray:
    """Return a way of even accelerations: when each is half over [s], its turn, how long."""
    fine = np.arange(0.0, end, 1e-4)
    speed = np.zeros(fine.size)
    for at, turn, lasts in changes:
        speed += turn * np.clip((fine - at) / lasts + 0.5, 0.0, 1.0)
    return np.interp(t, fine, np.cumsum(speed) * 1e-4)


def test_a_way_that_is_mostly_accelerations_is_followed_by_them() -> None:
    """It goes evenly for 0.25 s only, between two accelerations of 0.38 s."""
    changes = [(1.0, 0.003, 0.06), (3.0, -0.003, 0.06), (6.0, -0.02, 0.38), (6.63, 0.02, 0.38)]
    t = np.arange(0.003, 9.0, 0.009)
    way = _slowly(t, changes, 9.0) - 0.0006
    read = way + 1e-6 * np.random.default_rng(2).standard_normal(t.size)
    phases = replace(PHASES, t_contact=1.2, t_hold=3.0, t_release=5.81, t_loss=5.9, t_end=9.0)
    path = tool_path(Signal(t, np.round(read / 1e-6) * 1e-6), phases)
    ramps = [bend.shape.duration for bend in path.bends if bend.t > 5.0]
    assert ramps == pytest.approx([0.38, 0.38], rel=0.02)
    near = (t > 0.9) & (t < 6.4)
    assert np.abs(path.at(t) - way)[near].max() < 2e-6


def test_a_shape_with_little_straight_after_it_follows_the_samples_closely() -> None:
    t = np.arange(0.0, 1.5, 0.005)
    way = _slowly(t, [(1.0, 0.02, 0.38)], 1.5)
    read = way + 1.5e-6 * np.random.default_rng(4).standard_normal(t.size)
    for noise, followed in ((1.5e-6, True), (1e-6, False)):
        turned = _bend(t, read, (0.0, 0.85, 1.17, 1.42), 0.005, noise, 0.0, 6, None, ramp=True)
        assert (turned is not None) == followed
    # Of a way that ripples it is none.
    assert _bend(t, read, (0.0, 0.85, 1.17, 1.42), 0.005, 1.5e-6, 0.0, 6, None) is None


def test_a_way_that_ripples_goes_by_no_ramps() -> None:
    knots = np.arange(0.0, 12.0, 0.1)
    ramps = np.where(np.arange(knots.size) % 40 < 20, 1.0, -1.0)
    ripples = np.where(np.arange(knots.size) % 4 < 2, 1.0, -1.0)
    for turns, expected in ((ramps, True), (ripples, False)):
        assert _goes_by_ramps(knots, np.cumsum(np.cumsum(turns))) == expected


def test_slow_changes_of_speed_in_the_air_do_not_hide_those_on_the_object() -> None:
    """An approach by 67 mm with a stop on the way, all of it in accelerations of 0.9 s."""
    there = [(1.5, 0.02, 0.95), (3.2, -0.02, 0.95), (4.15, 0.0188, 0.89), (6.3, -0.0188, 0.89)]
    back = [(19.2, -0.02, 0.95), (22.9, 0.02, 0.95)]
    t = np.arange(0.007, 27.0, 0.01)
    way = _slowly(t, there + back, 27.0)
    way += 0.0074 - way[t > 10.0][0]
    read = way + 1e-6 * np.random.default_rng(5).standard_normal(t.size)
    touch = float(t[np.argmax(way > 0.0)])
    phases = replace(
        PHASES, t_contact=touch, t_hold=6.75, t_release=18.75, t_loss=18.76, t_end=27.0
    )
    path = tool_path(Signal(t, np.round(read / 1e-6) * 1e-6), phases)
    assert [bend.shape.duration for bend in path.bends] == pytest.approx([0.89, 0.95], rel=0.02)
    near = (t > touch - 0.05) & (t < 19.5)
    assert np.abs(path.at(t) - way)[near].max() < 2.5e-6


def _touching(
    sampled: str, seeds: int = 6, slope: float = 0.9, noise: float = 0.003
) -> list[tuple[Trial, Segmentation]]:
    """Return trials whose force jumps by 0.6 N where the tool touches, between two readings."""
    pairs = []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        t = np.arange(0.0, 20.0, 0.01) + 0.01 * random.uniform()
        fine = t[:, np.newaxis] + (0.01 * (np.arange(20) - 9.5) / 20 if sampled == 'mean' else 0.0)
        force = np.where(fine > 1.0, np.minimum(0.6 + slope * (fine - 1.0), 2.4), 0.0)
        force[(fine > 3.0) & (fine < 13.0)] = 1.8
        force[fine > 13.0] = 0.0
        read = force.mean(axis=1) + noise * random.standard_normal(t.size)
        tool_t = np.arange(0.0, 20.0, 0.004)
        tool = Signal(tool_t, 0.04 - _tool(tool_t, CORNERS, DEPTHS))
        height_t = np.arange(0.0, 20.0, 0.02)
        height = Signal(height_t, np.clip(_tool(height_t, CORNERS, DEPTHS), 0.0, None))
        trial = Trial(f'{sampled} {seed}', 0, Signal(t, read), tool, height)
        pairs.append((trial, PHASES))
    return pairs


def test_readings_of_a_moment_do_not_tell_when_a_tool_touches() -> None:
    pairs = _touching('moment')
    made, _ = prepare(pairs)
    for trial, (measured, _) in zip(made, pairs, strict=True):
        assert trial is not None
        beside = np.abs(measured.force.t - 1.0) < 0.01
        middle = 0.5 * (trial.samples.edges[1:] + trial.samples.edges[:-1])
        assert middle[~trial.samples.good] == pytest.approx(measured.force.t[beside], abs=1e-9)
        # None of them stands out.
        assert trial.set_aside.size == 0


def _read(sampled: str, step: float, times: int) -> list[tuple[Trial, Segmentation]]:
    """Return touches of a load cell that rounds and whose readings are told several times."""
    pairs = []
    for trial, phases in _touching(sampled, seeds=4, slope=0.05):
        value = trial.force.value.copy()
        if step:
            value = step * np.round(value / step)
        value = np.repeat(value[::times], times)[: value.size]
        pairs.append((replace(trial, force=Signal(trial.force.t, value)), phases))
    return pairs


@pytest.mark.parametrize('step', [0.0, 0.002, 0.004])
def test_rounded_readings_that_are_alike_by_chance_are_told_once(step: float) -> None:
    assert reads_at_moments(_read('moment', step, 1))
    assert not reads_at_moments(_read('mean', step, 1))
    # What is told twice is whole at once, however it was read.
    assert not reads_at_moments(_read('mean', step, 2))


def test_means_over_a_sample_tell_when_a_tool_touches() -> None:
    made, _ = prepare(_touching('mean'))
    assert all(trial is not None and trial.samples.good.all() for trial in made)


def test_touches_tell_that_are_fifty_times_as_loud_as_the_noise() -> None:
    assert reads_at_moments(_touching('moment', noise=0.012))
    assert not reads_at_moments(_touching('mean', noise=0.012))


def test_two_touches_do_not_tell_how_the_force_is_read() -> None:
    made, _ = prepare(_touching('moment', seeds=2))
    assert all(trial is not None and trial.samples.good.all() for trial in made)


def test_many_ways_there_and_back_are_followed_through_encoders_that_round() -> None:
    """Each has four accelerations over 0.2 s, of twenty pieces each."""
    fine = np.arange(0.0, 20.0, 5e-4)
    speed = np.zeros(fine.size)
    for k in range(5):
        for at, change in ((0.2, 0.004), (1.7, -0.004), (2.2, -0.004), (3.7, 0.004)):
            rise = np.clip((fine - 3.9 * k - at) / 0.2 + 0.5, 0.0, 1.0)
            speed += change * rise**2 * (3.0 - 2.0 * rise)
    way = np.concatenate(([0.0], np.cumsum(0.25e-3 * (speed[1:] + speed[:-1])))) - 0.001
    t = np.arange(0.001, 19.6, 0.005)
    read = np.round(np.interp(t, fine, way) / 1e-6) * 1e-6
    path = tool_path(Signal(t, read), replace(PHASES, t_hold=1.8, t_release=2.2, t_loss=3.6))
    assert path.t.size < 200
    near = np.arange(0.5, 19.0, 0.005)
    off = np.diff(path.at(near) - np.interp(near, fine, way)) / 0.005
    # Readings themselves are off by 0.1 mm/s.
    assert np.sqrt(np.mean(off**2)) < 5e-5


def test_readings_that_are_lost_or_odd_are_no_touches() -> None:
    """A reading of zero in the hold, and one of a newton in the air, say nothing of the others."""
    pairs = []
    for trial, phases in _touching('mean'):
        value = trial.force.value.copy()
        value[np.searchsorted(trial.force.t, 6.0)] = 0.0
        value[np.searchsorted(trial.force.t, 16.0)] = 1.0
        # No touch is told well.
        value[trial.force.t < 1.2] = np.random.default_rng(1).normal(0.0, 0.03, value.size)[
            trial.force.t < 1.2
        ]
        pairs.append((replace(trial, force=Signal(trial.force.t, value)), phases))
    assert not reads_at_moments(pairs)


def test_touches_after_the_end_of_a_trial_do_not_count() -> None:
    """The record of the force outlasts that of the tool, which pushes once more."""
    pairs = [(trial, replace(phases, t_end=12.0)) for trial, phases in _touching('moment')]
    for place, (trial, phases) in enumerate(pairs):
        value = trial.force.value.copy()
        value[trial.force.t > 15.0] = 1.5
        pairs[place] = replace(trial, force=Signal(trial.force.t, value)), phases
    made, _ = prepare(pairs)
    assert all(trial is not None and np.sum(~trial.samples.good) == 2 for trial in made)


def test_what_trials_tell_of_the_readings_is_kept_for_others() -> None:
    seen = _touching('moment')
    found = fit(seen)
    (unseen,) = predict_unseen(Trained.of(found, seen), seen[:1]).trials
    assert unseen is not None and found.trials[0] is not None
    # One trial alone does not tell.
    (alone,) = fit(seen[:1]).trials
    assert alone is not None
    assert len(unseen.force) == len(found.trials[0].force) == len(alone.force) - 2


def test_a_tool_that_never_goes_on_has_encoders_without_noise() -> None:
    t = np.arange(0.0, 5.0, 0.01)
    path = tool_path(Signal(t, np.where(t < 2.5, -0.004, 0.004)), replace(PHASES, t_end=5.0))
    assert np.isfinite(path.displacement).all()


def test_a_tool_that_swings_after_its_turns_hides_the_noise_of_few_samples_only() -> None:
    """Half of the samples of a tool that moves are beside the lines of their neighbours by um."""
    fine = np.arange(0.0, 5.0, 1e-4)

    def swung(turn: float) -> np.ndarray:
        since = np.maximum(fine - turn, 0.0)
        return 1.0 - np.exp(-20.0 * since) * (np.cos(71.0 * since) + 0.28 * np.sin(71.0 * since))

    speed = 0.0195 * swung(0.5) - 0.0195 * swung(1.3) - 0.043 * swung(3.0) + 0.043 * swung(3.36)
    way = np.concatenate(([0.0], np.cumsum(0.5e-4 * (speed[1:] + speed[:-1])))) - 0.008
    t = np.arange(0.01, 4.9, 0.02)
    noise = 1e-7 * np.random.default_rng(0).standard_normal(t.size)
    phases = replace(PHASES, t_contact=0.92, t_hold=1.35, t_release=3.0, t_loss=3.2, t_end=4.8)
    path = tool_path(Signal(t, np.interp(t, fine, way) + noise), phases)
    assert path.noise < 1e-6


@pytest.mark.parametrize('source', ['topic', 'points'])
def test_heights_that_the_touch_gives_their_zero_have_one_that_is_fitted(source: str) -> None:
    """Where the tool hides the surface until it touches, a cloud shows it after that only."""
    trial = _trial()
    t = np.arange(14.0, 19.0, 0.1)
    heights = Signal(t, np.full(t.size, 0.004))
    seen = replace(trial, displacement_height=heights, displacement_source=source)
    (made,), _ = prepare([(seen, PHASES)])
    assert made is not None
    assert made.has_height_zero == (source == 'points')


@pytest.mark.parametrize('early', [0.086, 0.04, -0.086])
def test_a_corner_that_noise_hides_is_where_the_pieces_meet(early: float) -> None:
    """A release at 0.17 mm/s is told to some 0.1 s by encoders with 5 um of noise."""
    t = np.arange(0.0, 32.0, 0.008)
    corners = [0.0, 1.6, 13.8, 16.57, 28.74, 32.0]
    way = np.interp(t, corners, [-5e-4, -5e-4, 1.54e-3, 1.54e-3, -5e-4, -5e-4])
    read = way + 5e-6 * np.random.default_rng(1).standard_normal(t.size)
    phases = Segmentation(4.6, 13.8, 16.57 - early, 17.1, 32.0, 0.04, 0.0, 1.7e-4, 1.54e-3)
    off = tool_path(Signal(t, read), phases).at(t) - way
    # The hold is taken to go on by 14 um where its end is taken to be early.
    assert np.abs(off).max() < 3e-6


def _other_lengths(edges: np.ndarray, steps: np.ndarray) -> float:
    """Return the share of steps whose lengths, of as many samples, are not as before them."""
    samples, lengths = np.diff(steps), np.diff(edges[steps])
    same = samples[1:] == samples[:-1]
    return float(np.mean(np.abs(np.diff(lengths))[same] > 1e-9 * lengths[1:][same]))


@pytest.mark.parametrize(('jitter', 'most'), [(1e-4, 0.02), (0.05, 0.1)])
def test_stamps_that_are_off_by_a_little_leave_most_steps_of_one_length(
    jitter: float, most: float
) -> None:
    random = np.random.default_rng(8)
    stamps = 0.001 * (np.arange(4000) + jitter * random.standard_normal(4000))
    # A hundred readings are missing, and later the clock is set by a part of a tick.
    stamps[2500:] += 0.1
    stamps[3500:] += 0.00037
    force = 5.0 * np.exp(-stamps) + 0.01 * random.standard_normal(4000)
    # A jump of 300 times the noise, and a fast rise.
    force[1500:] += 3.0
    force[3000:] += np.minimum(0.5 * np.arange(1000), 20.0)
    middle = 0.5 * (stamps[1:] + stamps[:-1])
    edges = np.concatenate(([stamps[0] - 0.0005], middle, [stamps[-1] + 0.0005]))
    steps = np.sort(np.concatenate((np.arange(2000), np.arange(2000, 4001, 5))))
    assert _other_lengths(edges, steps) > 0.95
    tick = 0.001
    moved = _on_ticks(edges, steps, tick, force)
    assert _other_lengths(moved, steps) < most
    # Samples stay in their steps, but for such whose stamps are far off themselves.
    assert np.all(np.diff(moved) > 0.0)
    aside = np.abs(moved - edges)
    assert aside.max() <= 0.25 * tick
    assert not aside[np.setdiff1d(np.arange(4001), steps)].any()
    # What a step has of the force changes by a tenth of its noise, which is less in steps of five
    # samples: where the force jumps nothing moves.
    change = np.abs(np.diff(force)) * aside[1:-1] / (0.1 * 0.01 * tick)
    assert change[1499] < 1.1
    assert np.all(change[2999:3039] < 1.1 * math.sqrt(5.0))
    # Without noise an edge is where its samples have it.
    clean = 5.0 * np.exp(-0.001 * np.arange(4000))
    assert np.abs(_on_ticks(edges, steps, tick, clean) - edges).max() < 0.001 * tick


@pytest.mark.parametrize('jitter', [0.0, 0.05])
def test_a_clock_that_has_stood_still_moves_no_edges_all_to_one_side(jitter: float) -> None:
    """A pause of 100.2 ticks in the air puts all that follows a fifth of a tick aside."""
    random = np.random.default_rng(11)
    stamps = 0.001 * (np.arange(20000) + jitter * random.standard_normal(20000))
    stamps[500:] += 0.0002
    edges = np.concatenate(
        ([stamps[0] - 0.0005], 0.5 * (stamps[1:] + stamps[:-1]), [stamps[-1] + 0.0005])
    )
    force = 5.0 * np.exp(-stamps) + 0.01 * random.standard_normal(stamps.size)
    for steps in (np.arange(20001), np.arange(0, 20001, 16)):
        moved = (_on_ticks(edges, steps, _tick(stamps), force) - edges)[steps]
        if jitter == 0.0:
            assert np.abs(moved).max() < 1e-9
        else:
            # A phase is known to an eighth of what 64 edges are off.
            assert abs(moved[np.flatnonzero(steps > 600)].mean()) < 0.125 * jitter * 0.001
            assert np.abs(moved).max() > 0.5 * jitter * 0.001


def test_two_rates_in_a_record_of_exact_stamps_stay_as_they_are() -> None:
    stamps = np.cumsum(np.concatenate((np.full(3000, 1e-3), np.full(3000, 0.99e-3))))
    edges = np.concatenate(
        ([stamps[0] - 0.0005], 0.5 * (stamps[1:] + stamps[:-1]), [stamps[-1] + 0.0005])
    )
    force = 0.01 * np.random.default_rng(12).standard_normal(stamps.size)
    steps = np.arange(edges.size)
    moved = _on_ticks(edges, steps, _tick(stamps), force)
    assert _other_lengths(edges, steps) < 0.001
    # Where one rate ends, and the record, an edge is like none.
    assert np.count_nonzero(moved != edges) <= 4


def test_a_trial_whose_stamps_are_off_by_a_little_has_steps_of_one_length() -> None:
    """So are stamps that were written as a time since 1970 in floating point."""
    trial = _trial()
    off = 1e-4 * np.random.default_rng(9).standard_normal(len(trial.force))
    t = trial.force.t + np.median(np.diff(trial.force.t)) * off
    noise = 0.01 * np.random.default_rng(10).standard_normal(t.size)
    (made,), _ = prepare([(replace(trial, force=Signal(t, trial.force.value + noise)), PHASES)])
    steps = np.searchsorted(made.samples.edges, made.t)
    assert np.array_equal(made.samples.edges[steps], made.t)
    assert _other_lengths(made.samples.edges, steps) < 0.1


def test_an_absurd_reading_moves_no_edges() -> None:
    trial = _trial()
    random = np.random.default_rng(9)
    t = trial.force.t + np.median(np.diff(trial.force.t)) * 0.1 * random.standard_normal(
        len(trial.force)
    )
    value = trial.force.value + 0.01 * random.standard_normal(t.size)
    wrong = value.copy()
    wrong[50] = 3.4e38
    (made,), _ = prepare([(replace(trial, force=Signal(t, value)), PHASES)])
    (other,), _ = prepare([(replace(trial, force=Signal(t, wrong)), PHASES)])
    assert not other.samples.good[50]
    same = np.isclose(made.samples.edges, other.samples.edges, rtol=0.0, atol=1e-9)
    assert np.count_nonzero(~same) <= 4


def test_the_interval_of_a_clock_does_not_drift_from_stamps_that_are_far_off() -> None:
    random = np.random.default_rng(6)
    ticks = 0.001 * np.flatnonzero(random.uniform(size=50000) > 0.01)
    late = 0.00015 * random.standard_normal(ticks.size)
    # Within all of the record a clock with it is off by less than a tick.
    assert _tick(np.sort(ticks + late)) == pytest.approx(0.001, rel=1e-5)
    # Nor from the parts of a tick of pauses.
    for off in (0.0, 0.05):
        stamps = ticks + off * 0.001 * random.standard_normal(ticks.size)
        for at in range(100, ticks.size, 2500):
            stamps[at:] += 0.1004
        assert _tick(np.sort(stamps)) == pytest.approx(0.001, rel=1e-6 if off == 0.0 else 2e-5)


def test_a_clock_is_told_from_its_stamps_and_what_is_missing_of_them() -> None:
    random = np.random.default_rng(5)
    ticks = 1.7e3 + np.arange(400) / 30.0
    late = 0.003 * random.standard_normal(ticks.size)
    some = random.uniform(size=ticks.size) > 0.4
    for kept in (np.ones(ticks.size, dtype=np.bool_), some):
        assert jitter_of(ticks[kept]) == 0.0
        assert jitter_of((ticks + late)[kept]) == pytest.approx(0.003, rel=0.15)
    # A pause of a part of a tick is no jitter.
    assert jitter_of(np.concatenate((ticks[:30], ticks[30:60] + 0.31))) == 0.0
    # Events have no clock, and a few stamps tell none.
    assert jitter_of(np.cumsum(random.exponential(0.03, 400))) == 0.0
    assert jitter_of((ticks + late)[:7]) == 0.0
