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

"""The displacement height H from clouds that the tests make."""

from dataclasses import replace
import re

from hapticvision_ros.core import displacement
from hapticvision_ros.core.displacement import (
    _by_noise,
    displacement_from_clouds,
    DisplacementSettings,
    DisplacementTracker,
)
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.records import CloudFrame, Signal
from hapticvision_ros.core.scene.plane import fit_support_plane
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body
import numpy as np
import pytest

TOP = 0.045
RADIUS = 0.0126
AXIS = (0.01, -0.005)
PUSHED = (AXIS[0] + 0.007, AXIS[1] - 0.004)
"""Where a tool pushes that misses the middle of the object."""
NOISE = 5e-4
ELEVATION = np.deg2rad(40.0)
# Median of some 60 points with a depth noise of 0.5 mm, of which sin(40 deg) is height.
HEIGHT_STD = 1.25 * NOISE * np.sin(ELEVATION) / np.sqrt(60.0)


def view(dent, tool_height, seed, shape=(240, 320), axis=AXIS):
    """Return an oblique parallel view of a block with a flat dent below a cylinder."""
    forward = np.array([0.0, np.cos(ELEVATION), -np.sin(ELEVATION)])
    up = np.array([0.0, np.sin(ELEVATION), np.cos(ELEVATION)])
    rows, columns = shape
    u = (np.arange(columns) + 0.5 - columns / 2) * 0.0008
    v = (rows / 2 - np.arange(rows) - 0.5) * 0.0008
    origin = (
        np.array([0.0, 0.0, 0.03])
        - 0.5 * forward
        + u[None, :, None] * np.array([1.0, 0.0, 0.0])
        + v[:, None, None] * up
    )

    def at_height(z):
        depth = (z - origin[..., 2]) / forward[2]
        return depth, origin + depth[..., None] * forward

    def from_axis(points):
        return np.hypot(points[..., 0] - axis[0], points[..., 1] - axis[1])

    depth, _ = at_height(0.0)
    wall_depth = (AXIS[1] - 0.03 - origin[..., 1]) / forward[1]
    wall = origin + wall_depth[..., None] * forward
    on_wall = (np.abs(wall[..., 0] - AXIS[0]) < 0.045) & (wall[..., 2] > 0) & (wall[..., 2] < TOP)
    depth = np.where(on_wall, wall_depth, depth)
    top_depth, top = at_height(TOP)
    on_top = (np.abs(top[..., 0] - AXIS[0]) < 0.045) & (np.abs(top[..., 1] - AXIS[1]) < 0.03)
    depth = np.where(on_top, top_depth, depth)
    dent_depth, floor = at_height(TOP - dent)
    # The rim hides the near part of the floor.
    in_dent = (from_axis(floor) < RADIUS) & (from_axis(top) < RADIUS)
    depth = np.where(in_dent, dent_depth, depth)
    a = forward[1] ** 2
    b = 2.0 * (origin[..., 1] - axis[1]) * forward[1]
    c = (origin[..., 0] - axis[0]) ** 2 + (origin[..., 1] - axis[1]) ** 2 - RADIUS**2
    discriminant = b * b - 4.0 * a * c
    tool_depth = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / (2.0 * a)
    tool_z = origin[..., 2] + tool_depth * forward[2]
    on_tool = (discriminant > 0.0) & (tool_z > tool_height) & (tool_depth < depth)
    depth = np.where(on_tool, tool_depth, depth)
    random = np.random.default_rng(seed)
    depth = depth + NOISE * random.standard_normal(depth.shape)
    cloud = (origin + depth[..., None] * forward).astype(np.float32)
    cloud[random.random(depth.shape) < 0.02] = np.nan
    cloud[random.random(depth.shape) < 0.001] = -np.inf
    return cloud


def trial():
    """Return (t, tool height, dent) of a push of 8 mm that leaves 5 mm, at 10 frames a second."""
    frames = [(0.1 * k, 0.075, 0.0) for k in range(10)]
    frames += [(1.0 + 0.1 * k, 0.075 - 0.02 * 0.1 * k, 0.0) for k in range(15)]
    frames += [(2.5 + 0.1 * k, TOP - 0.001 * k, 0.001 * k) for k in range(9)]
    frames += [(3.4 + 0.1 * k, TOP - 0.008, 0.008) for k in range(10)]
    for k in range(60):
        t = 0.1 * k
        dent = 0.005 + 0.003 * np.exp(-t / 2.0)
        frames.append((4.4 + t, min(TOP - 0.008 + 0.02 * t, 0.075), dent))
    return frames


def follow(tracker, frames):
    return [
        tracker.update(view(dent, tool, seed), tool) for seed, (_, tool, dent) in enumerate(frames)
    ]


@pytest.fixture(scope='module')
def clouds():
    return [
        CloudFrame(t, view(dent, tool, seed), 'support_plane')
        for seed, (t, tool, dent) in enumerate(trial())
    ]


@pytest.fixture(scope='module')
def tool_height():
    frames = trial()
    return Signal(
        np.array([t for t, _, _ in frames]), np.array([height for _, height, _ in frames])
    )


def test_the_height_is_the_dent_before_the_push_and_after_it(clouds):
    tracker = DisplacementTracker(AXIS)
    errors = []
    for cloud, (t, tool, dent) in zip(clouds, trial(), strict=True):
        height = tracker.update(cloud.xyz, tool)
        if t >= 2.5 and tool < TOP - dent + 0.004:
            assert height is None, f'seen at {t} s although the tool is down'
        if t > 5.6:
            assert height is not None, f'not seen at {t} s'
        if height is not None:
            errors.append(height - dent)
    assert len(errors) > 50
    # The original height is an average over frames, so that the error is one frame's.
    assert np.abs(np.mean(errors)) < 3.0 * HEIGHT_STD / np.sqrt(10.0)
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD


def test_the_original_height_is_settled_once_the_tool_has_come_down(clouds):
    tracker = DisplacementTracker(AXIS, DisplacementSettings(most_frames=1000))
    for cloud, (_, tool, _) in zip(clouds, trial(), strict=True):
        tracker.update(cloud.xyz, tool)
    assert tracker.pushed
    assert tracker.original_height == pytest.approx(TOP, abs=2.0 * HEIGHT_STD)


def test_nothing_is_told_before_the_original_height_is_known():
    tracker = DisplacementTracker(AXIS)
    heights = follow(tracker, [(0.0, 0.075, 0.0)] * 4)
    assert heights[:2] == [None, None]
    assert heights[2] is not None


@pytest.mark.parametrize('tool', [None, np.nan])
def test_nothing_is_told_while_the_tools_height_is_unknown(tool):
    tracker = DisplacementTracker(AXIS)
    follow(tracker, [(0.0, 0.075, 0.0)] * 4)
    assert tracker.update(view(0.0, 0.075, 9), tool) is None


def test_a_push_that_began_unseen_gives_no_height():
    tracker = DisplacementTracker(AXIS)
    heights = follow(tracker, [(0.0, 0.043, 0.002)] * 3 + [(0.0, 0.075, 0.002)] * 5)
    assert heights == [None] * 8


def test_an_empty_patch_gives_no_height():
    tracker = DisplacementTracker(AXIS)
    follow(tracker, [(0.0, 0.075, 0.0)] * 4)
    cloud = view(0.0, 0.075, 9)
    cloud[np.hypot(cloud[..., 0] - AXIS[0], cloud[..., 1] - AXIS[1]) < 0.004] = np.nan
    assert tracker.update(cloud, 0.075) is None
    assert DisplacementTracker((1.0, 1.0)).update(cloud, 0.075) is None


def test_unorganised_clouds_give_the_same_height(clouds):
    organised, flat = DisplacementTracker(AXIS), DisplacementTracker(AXIS)
    for cloud, (_, tool, _) in zip(clouds, trial(), strict=True):
        expected = organised.update(cloud.xyz, tool)
        found = flat.update(cloud.xyz.reshape(-1, 3), tool)
        assert (found is None) == (expected is None)
        if found is not None:
            # The support plane comes from other points: 0.5 mm over the root of some thousand.
            assert found == pytest.approx(expected, abs=5e-5)


def moved(cloud, shift=(0.0, 0.0, 0.0), tilt=0.0):
    """Return a cloud as a sensor gives it that was shifted and tilted [m], [rad]."""
    cos, sin = np.cos(tilt), np.sin(tilt)
    turn = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    with np.errstate(invalid='ignore'):
        return (cloud @ turn.T + np.array(shift)).astype(np.float32)


def errors_of(change, clouds, start=2.5):
    """Return H less the dent after the push, where each frame from `start` on is changed."""
    tracker = DisplacementTracker(AXIS)
    errors = []
    for number, (cloud, (t, tool, dent)) in enumerate(zip(clouds, trial(), strict=True)):
        xyz = cloud.xyz if t < start else change(cloud.xyz.copy(), number)
        height = tracker.update(xyz, tool)
        if height is not None and t > 5.6:
            errors.append(height - dent)
    return np.array(errors), tracker.reason


@pytest.mark.parametrize(
    'change',
    [
        {'shift': (0.0, 0.0, 0.0015)},
        {'shift': (0.0, 0.0, -0.006)},
        # The plane is seen over some 20 cm: 1.7 mm at its ends.
        {'tilt': np.deg2rad(1.0)},
        {'shift': (0.0, 0.0, 0.003), 'tilt': np.deg2rad(-0.5)},
    ],
    ids=['up', 'down', 'tilted', 'both'],
)
def test_a_sensor_that_is_knocked_moves_no_height(clouds, change):
    errors, _ = errors_of(lambda xyz, _: moved(xyz, **change), clouds)
    assert len(errors) > 40
    assert np.abs(errors.mean()) < 3.0 * HEIGHT_STD / np.sqrt(10.0)
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD


def test_a_sensor_that_drifts_moves_no_height(clouds):
    # 30 um a frame, 3 mm in all.
    errors, _ = errors_of(lambda xyz, n: moved(xyz, (0.0, 0.0, 3e-5 * n)), clouds, start=0.0)
    assert len(errors) > 40
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD


def test_a_sideward_shift_is_felt_as_far_as_the_dent_is_uneven(clouds):
    # The dent is flat over 12.6 mm about the axis, the patch looks at 5 mm of it.
    errors, _ = errors_of(lambda xyz, _: moved(xyz, (0.003, -0.002, 0.0)), clouds)
    assert len(errors) > 40
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD


@pytest.mark.parametrize(
    'change', [{'shift': (0.0, 0.0, 0.02)}, {'tilt': np.deg2rad(3.0)}], ids=['far', 'steep']
)
def test_a_sensor_that_has_moved_too_far_is_refused(clouds, change):
    errors, reason = errors_of(lambda xyz, _: moved(xyz, **change), clouds)
    assert not len(errors)
    assert reason in (
        'the range sensor or the support plane has moved',
        'the support plane is not seen',
    )


@pytest.mark.parametrize('share', [0.5, 0.75])
def test_dropouts_all_over_the_frame_cost_no_frame(clouds, share):
    random = np.random.default_rng(3)

    def drop(xyz, _):
        xyz[random.random(xyz.shape[:2]) < share] = np.nan
        return xyz

    errors, _ = errors_of(drop, clouds)
    assert len(errors) > 40
    # Of some 60 returns in the patch a quarter is left: twice the noise.
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD / np.sqrt(1.0 - share)


def test_dropouts_in_rows_and_in_the_plane_cost_no_frame(clouds):
    def drop(xyz, number):
        first = number % 3
        xyz[first::3] = np.nan
        xyz[:, :100] = np.nan
        return xyz

    errors, _ = errors_of(drop, clouds)
    assert len(errors) > 40
    assert np.abs(errors).max() < 8.0 * HEIGHT_STD


def test_a_hand_on_the_table_is_no_plane(clouds):
    def cover(xyz, _):
        xyz[-60:, :, 2] += 0.05
        return xyz

    errors, _ = errors_of(cover, clouds)
    assert len(errors) > 40
    assert np.abs(errors).max() < 5.0 * HEIGHT_STD


def test_a_frame_without_the_support_plane_is_passed_over(clouds):
    def blind(xyz, _):
        xyz[np.abs(xyz[..., 2]) < 0.01] = np.nan
        return xyz

    errors, reason = errors_of(blind, clouds)
    assert not len(errors)
    assert reason == 'the support plane is not seen'


def test_a_trial_is_followed_from_its_clouds(clouds, tool_height):
    signal, warnings = displacement_from_clouds(clouds, tool_height, contact_point=(*AXIS, TOP))
    assert warnings == ()
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD


def test_without_a_contact_point_it_is_planned_and_told(clouds, tool_height):
    signal, warnings = displacement_from_clouds(iter(clouds), tool_height)
    assert len(warnings) == 1
    assert 'The contact point was taken where' in warnings[0]
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD


def test_clouds_in_a_sensors_own_frame_are_brought_into_the_planes(clouds, tool_height):
    angle = 2.2
    turn = np.array(
        [
            [1.0, 0.0, 0.0],
            [0.0, np.cos(angle), -np.sin(angle)],
            [0.0, np.sin(angle), np.cos(angle)],
        ]
    )
    sensor = np.array([0.0, -0.4, 0.35])
    with np.errstate(invalid='ignore'):
        moved = [
            CloudFrame(frame.t, ((frame.xyz - sensor) @ turn.T).astype(np.float32), 'camera')
            for frame in clouds
        ]
    signal, warnings = displacement_from_clouds(moved, tool_height)
    assert len(warnings) == 2
    assert 'not in the frame support_plane' in warnings[0]
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD


def test_leading_frames_without_returns_are_passed_over(clouds, tool_height):
    empty = np.full_like(clouds[0].xyz, np.nan)
    lost = [CloudFrame(frame.t, empty, frame.frame_id) for frame in clouds[:3]]
    signal, _ = displacement_from_clouds([*lost, *clouds[3:]], tool_height)
    assert signal.t[0] > clouds[2].t


def test_what_gives_no_height_says_why(clouds, tool_height):
    nothing = Signal(np.empty(0), np.empty(0))
    signal, warnings = displacement_from_clouds(clouds, nothing)
    assert signal is None
    assert 'there is no tool height' in warnings[-1]
    signal, warnings = displacement_from_clouds([], tool_height)
    assert signal is None
    assert 'no cloud within the record' in warnings[-1]
    empty = [CloudFrame(0.5, np.full((10, 10, 3), np.nan, dtype=np.float32), 'support_plane')]
    signal, warnings = displacement_from_clouds(empty, tool_height)
    assert signal is None
    assert 'only 0 returns' in warnings[-1]
    # While the tool is down, and once it is up again.
    for first in (30, 70):
        signal, warnings = displacement_from_clouds(
            clouds[first:], tool_height, contact_point=(*AXIS, TOP)
        )
        assert signal is None
        assert 'not seen before the push' in warnings[-1]
    signal, warnings = displacement_from_clouds(
        clouds[:3], tool_height, contact_point=(*AXIS, TOP)
    )
    assert signal is None
    assert 'free of the tool in 1 of 3 frames' in warnings[-1]


FLOOR = 0.006
"""Radius of the flat floor of the dent in a close-up [m]."""
FINE = 2e-5
"""Noise of the heights in a close-up [m]."""


def close_up(
    dent, seed, *, curvature=0.0, tool=None, thick=FLOOR, noise=FINE, flat=False, floor=FLOOR
):
    """Return 15 by 15 points of the top around the contact point alone, seen from above."""
    x, y = np.meshgrid(np.arange(-7, 8) * 0.002, np.arange(-7, 8) * 0.002)
    radius = np.hypot(x, y)
    slope = np.clip((floor + 0.004 - radius) / 0.004, 0.0, 1.0)
    z = TOP - curvature * radius**2 - dent * slope
    random = np.random.default_rng((seed, 5))
    z = z + noise * random.standard_normal(z.shape)
    if tool is not None:
        # What is seen of a tool from above is its upper end.
        z = np.where(radius < thick, tool + 0.05, z)
    cloud = np.stack((x + AXIS[0], y + AXIS[1], z), axis=-1).astype(np.float32)
    cloud[random.random(z.shape) < 0.02] = np.nan
    return cloud.reshape(-1, 3) if flat else cloud


def close_ups(*, opaque=False, **made):
    return [
        CloudFrame(t, close_up(dent, seed, tool=tool if opaque else None, **made), 'support')
        for seed, (t, tool, dent) in enumerate(trial())
    ]


@pytest.mark.parametrize('made', [{}, {'curvature': 8.0}, {'flat': True}])
def test_close_ups_of_the_top_are_taken_by_where_the_tool_was(made, tool_height):
    signal, warnings = displacement_from_clouds(close_ups(**made), tool_height)
    assert len(warnings) == 2
    assert 'show no support plane' in warnings[0]
    assert 'x = 10.0 mm, y = -5.0 mm' in warnings[1]
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert len(signal) >= 0.9 * len(tool_height)
    assert np.abs(signal.value - truth).max() < 2.0 * FINE


@pytest.mark.parametrize('noise', [FINE, 3e-4])
def test_a_dent_narrower_than_the_patch_is_read_on_its_floor(noise, tool_height):
    """In the median of the patch as it was, 0.4 to 0.8 mm would be missed."""
    signal, warnings = displacement_from_clouds(close_ups(floor=0.0035, noise=noise), tool_height)
    assert 'The dent is narrow' in warnings[-1]
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    after = truth > 0.004
    assert np.count_nonzero(after) > 20
    # Of nine points the median is good to less than half the noise of one.
    assert abs(np.mean((signal.value - truth)[after])) < 0.3 * noise
    assert np.abs((signal.value - truth)[after]).max() < 2.0 * noise


def hollow(dent, seed, width, *, grid=False, flat=False, noise=3e-4):
    """
    Return a slightly domed top with a dent, a point each 4 mm^2 or so.

    Of the form of a bell, or flat up to the width with a rim of 3 mm.
    """
    random = np.random.default_rng((seed, 11))
    if grid:
        x, y = (each.ravel() for each in np.meshgrid(*2 * [np.arange(-11, 12) * 0.002]))
    else:
        x, y = random.uniform(-0.022, 0.022, (2, 500))
    square = x**2 + y**2
    form = np.exp(-0.5 * square / width**2)
    if flat:
        form = np.clip((width + 0.003 - np.sqrt(square)) / 0.003, 0.0, 1.0)
    z = TOP - 2.0 * square - dent * form
    z += noise * random.standard_normal(z.size)
    return np.stack((x + AXIS[0], y + AXIS[1], z), axis=-1).astype(np.float32)


@pytest.mark.parametrize('width', [0.008, 0.013])
@pytest.mark.parametrize('grid', [False, True])
def test_a_round_dent_is_read_where_it_is_deepest(width, grid, tool_height):
    """The median of what is seen around it is less deep, by 3 % and more of the narrower one."""
    clouds = [
        CloudFrame(t, hollow(dent, seed, width, grid=grid), 'support_plane')
        for seed, (t, _, dent) in enumerate(trial())
    ]
    signal, warnings = displacement_from_clouds(clouds, tool_height)
    assert 'The dent is round' in warnings[-1]
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    pressed = truth > 0.004
    assert np.count_nonzero(pressed) > 20
    assert np.mean(signal.value[pressed] / truth[pressed]) == pytest.approx(1.0, abs=0.01)


@pytest.mark.parametrize('width', [0.004, 0.005, 0.007])
@pytest.mark.parametrize('noise', [1e-4, 8e-4])
def test_the_floor_of_a_flat_tool_is_not_taken_for_round(width, noise, tool_height):
    """However round its rim is."""
    clouds = [
        CloudFrame(t, hollow(dent, seed, width, flat=True, noise=noise), 'support_plane')
        for seed, (t, _, dent) in enumerate(trial())
    ]
    signal, warnings = displacement_from_clouds(clouds, tool_height)
    assert not any('The dent is round' in each for each in warnings)
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    pressed = truth > 0.004
    assert np.mean(signal.value[pressed] / truth[pressed]) == pytest.approx(1.0, abs=0.02)


def test_what_is_seen_at_one_place_alone_tells_no_form(tool_height):
    random = np.random.default_rng(2)
    clouds = [
        CloudFrame(
            t,
            np.column_stack(
                (np.tile(AXIS, (20, 1)), TOP - dent + FINE * random.standard_normal(20))
            ).astype(np.float32),
            'c',
        )
        for t, _, dent in trial()
    ]
    signal, _ = displacement_from_clouds(clouds, tool_height)
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 2.0 * FINE


def near_by(**made):
    """Return clouds and tool heights of a push whose tool stays a millimetre above the surface."""
    frames = [(0.1 * k, TOP + 0.001, 0.0) for k in range(10)]
    frames += [(1.0 + 0.1 * k, TOP - 0.0005 * k, 0.0005 * k) for k in range(9)]
    frames += [(2.0 + 0.1 * k, TOP + 0.001, 0.002) for k in range(20)]
    thin = made.pop('thin', False)
    clouds = [
        CloudFrame(t, close_up(dent, seed, tool=tool if thin else None, thick=0.003, **made), 'c')
        for seed, (t, tool, dent) in enumerate(frames)
    ]
    heights = Signal(np.array([t for t, _, _ in frames]), np.array([z for _, z, _ in frames]))
    return clouds, heights


def test_close_ups_tell_by_their_own_noise_what_may_be_the_tool():
    """A margin of 2 mm would leave nothing of the surface around a tool."""
    signal, _ = displacement_from_clouds(*near_by(thin=True))
    after = signal.t > 1.95
    assert np.count_nonzero(after) == 20
    assert np.abs(signal.value[after] - 0.002).max() < 2.0 * FINE
    assert not np.any((signal.t > 1.05) & (signal.t < 1.95))


def test_a_patch_that_spreads_as_the_noise_has_no_tool_in_it():
    """Noise of 0.3 mm does not hide a tool of which nothing is seen."""
    signal, _ = displacement_from_clouds(*near_by(noise=3e-4))
    after = signal.t > 1.95
    assert np.count_nonzero(after) >= 15
    assert np.abs(signal.value[after] - 0.002).max() < 1.2 * 3e-4


@pytest.mark.parametrize('before', [4, 20])
@pytest.mark.parametrize('off', [2e-4, -2e-4])
def test_a_tool_height_that_is_a_little_off_takes_no_dent_for_the_original_surface(before, off):
    frames = [(0.1 * k, TOP + 0.01, 0.0) for k in range(before)]
    frames += [(0.1 * (before + k), TOP - 0.0005 * k, 0.0005 * k) for k in range(13)]
    frames += [(0.1 * (before + 13 + k), TOP + 0.01, 0.004) for k in range(20)]
    clouds = [CloudFrame(t, close_up(dent, seed), 'c') for seed, (t, _, dent) in enumerate(frames)]
    times, dents = np.array([t for t, _, _ in frames]), [dent for _, _, dent in frames]
    tool = Signal(times, np.array([height + off for _, height, _ in frames]))
    signal, _ = displacement_from_clouds(clouds, tool)
    assert len(signal) > 0.9 * len(frames)
    assert np.abs(signal.value - np.interp(signal.t, times, dents)).max() < 2.0 * FINE


def test_an_arm_before_the_object_is_not_taken_for_it(clouds, tool_height):
    """The object is hidden in the first frame, in which something stands above the tool."""
    first = clouds[0].xyz.copy()
    first[first[..., 2] > 0.004] = np.nan
    arm = (np.abs(first[..., 0] - 0.02) < 0.03) & (np.abs(first[..., 1] + 0.04) < 0.02)
    first[arm, 2] = 0.12
    hidden = [CloudFrame(clouds[0].t, first, 'support_plane'), *clouds[1:]]
    signal, warnings = displacement_from_clouds(iter(hidden), tool_height)
    expected, told = displacement_from_clouds(iter(clouds[1:]), tool_height)
    assert warnings == told
    # Its support plane is used, which differs by less than a micrometre; an arm is 75 mm high.
    assert np.abs(signal.value - expected.value).max() < 2e-6
    # Nor where the clouds are looked at again, since the tool has pushed elsewhere.
    beside = [
        CloudFrame(t, view(dent, tool, seed, axis=PUSHED), 'support_plane')
        for seed, (t, tool, dent) in enumerate(trial())
    ]
    by_dent, warnings = displacement_from_clouds([hidden[0], *beside[1:]], tool_height)
    assert 'of the dent' in warnings[-1]
    truth = np.interp(by_dent.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(by_dent.value - truth).max() < 5.0 * HEIGHT_STD


def test_the_plane_is_looked_for_once_while_the_surface_is_hidden(
    clouds, tool_height, monkeypatch
):
    found = []
    monkeypatch.setattr(
        displacement,
        'fit_support_plane',
        lambda points: found.append(len(points)) or fit_support_plane(points),
    )
    hidden = []
    for frame in clouds:
        xyz = frame.xyz.copy()
        xyz[np.hypot(xyz[..., 0] - AXIS[0], xyz[..., 1] - AXIS[1]) < 0.02] = np.nan
        hidden.append(CloudFrame(frame.t, xyz, frame.frame_id))
    signal, warnings = displacement_from_clouds(hidden, tool_height)
    assert signal is None
    assert 'is not seen' in warnings[-1]
    assert len(found) == 1
    # A sensor that is knocked in the meantime sees another one.
    for place, knock in enumerate(({'shift': (0.0, 0.0, 0.0025)}, {'tilt': np.deg2rad(0.8)})):
        knocked = [
            CloudFrame(frame.t, moved(frame.xyz, **knock), frame.frame_id) for frame in hidden[20:]
        ]
        displacement_from_clouds([*hidden[:20], *knocked], tool_height)
        assert len(found) == 3 + 2 * place


def test_a_tool_in_a_close_up_hides_the_dent(tool_height):
    signal, _ = displacement_from_clouds(close_ups(opaque=True), tool_height)
    assert signal is None
    mixed = close_ups(opaque=True)
    open_view = close_ups()
    # Before the push and once it is high up it is out of the picture.
    free = [frame.t < 1.0 or frame.t > 6.0 for frame in mixed]
    clouds = [b if out else a for a, b, out in zip(mixed, open_view, free, strict=True)]
    signal, _ = displacement_from_clouds(clouds, tool_height)
    assert np.all((signal.t < 1.0) | (signal.t > 6.0))
    assert np.any(signal.t > 6.0)


def test_a_surface_that_rises_under_the_tool_is_in_no_frame_of_the_plane(tool_height):
    clouds = [
        CloudFrame(frame.t, frame.xyz * np.float32([1, 1, -1]) + np.float32([0, 0, 2 * TOP]), 'c')
        for frame in close_ups()
    ]
    signal, warnings = displacement_from_clouds(clouds, tool_height)
    assert signal is None
    assert len(warnings) == 1
    assert 'rises where it was pushed' in warnings[0]


def test_clouds_without_the_tool_show_the_dent_all_the_time(tool_height):
    clouds = [
        CloudFrame(t, view(dent, 1.0, seed), 'support_plane')
        for seed, (t, _, dent) in enumerate(trial())
    ]
    signal, _ = displacement_from_clouds(clouds, tool_height, contact_point=(*AXIS, TOP))
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    # Deeper down, the rim hides part of the floor.
    assert np.any((signal.t > 2.5) & (signal.t < 3.4))
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD


def test_a_surface_that_stays_above_the_tool_is_not_the_one_that_it_presses(tool_height):
    """The contact point is taken beside the dent, in clouds that do not show the tool."""
    clouds = [
        CloudFrame(t, view(dent, 1.0, seed), 'support_plane')
        for seed, (t, _, dent) in enumerate(trial())
    ]
    beside = (AXIS[0] + 0.03, AXIS[1], TOP)
    signal, warnings = displacement_from_clouds(clouds, tool_height, contact_point=beside)
    assert signal is None
    assert 'stays above the tool' in warnings[-1]


def test_a_record_tells_by_its_dent_where_the_tool_has_pushed(tool_height):
    clouds = [
        CloudFrame(t, view(dent, tool, seed, axis=PUSHED), 'support_plane')
        for seed, (t, tool, dent) in enumerate(trial())
    ]
    signal, warnings = displacement_from_clouds(clouds, tool_height)
    found = re.search(r'of the dent that the tool left: x = (\S+) mm, y = (\S+) mm', warnings[-1])
    assert found is not None
    assert 1e-3 * np.array([float(item) for item in found.groups()]) == pytest.approx(
        PUSHED, abs=5e-4
    )
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD
    # What can be read only once is not looked at twice.
    _, warnings = displacement_from_clouds(iter(clouds), tool_height)
    assert 'mass centre of the top view' in warnings[-1]


def test_a_dent_that_is_not_where_the_tool_pressed_is_none(tool_height, monkeypatch):
    """The heights at the planned contact point are those that are told."""
    clouds = [
        CloudFrame(t, view(dent, 1.0, seed), 'support_plane')
        for seed, (t, _, dent) in enumerate(trial())
    ]
    planned, told = displacement_from_clouds(iter(clouds), tool_height)
    elsewhere = (AXIS[0] + 0.03, AXIS[1])
    monkeypatch.setattr(displacement._Dent, 'axis', lambda *_: elsewhere)
    signal, warnings = displacement_from_clouds(clouds, tool_height)
    assert warnings == told
    assert signal.value == pytest.approx(planned.value)


def test_where_the_tool_hides_the_surface_its_touch_tells_the_original_height(tool_height):
    """The surface at the contact point is in no frame before the push."""
    clouds = []
    for seed, (t, tool, dent) in enumerate(trial()):
        xyz = view(dent, tool, seed, axis=PUSHED)
        if t < 4.4:
            with np.errstate(invalid='ignore'):
                xyz[np.hypot(xyz[..., 0] - PUSHED[0], xyz[..., 1] - PUSHED[1]) < 0.006] = np.nan
        clouds.append(CloudFrame(t, xyz, 'support_plane'))
    unseen, warnings = displacement_from_clouds(clouds, tool_height)
    assert unseen is None
    assert 'was not seen before the push' in warnings[-1]
    signal, _ = displacement_from_clouds(clouds, tool_height, touched=lambda: TOP)
    assert np.all(signal.t > 4.4)
    truth = np.interp(signal.t, tool_height.t, [dent for _, _, dent in trial()])
    assert np.abs(signal.value - truth).max() < 5.0 * HEIGHT_STD
    assert displacement_from_clouds(clouds, tool_height, touched=lambda: None)[0] is None


def test_a_driver_takes_no_dent_below_the_tool():
    """Only of a record is the noise looked at: what a robot goes by stays as it was."""
    tracker = DisplacementTracker(AXIS)
    for seed in range(5):
        assert tracker.update(view(0.0, 1.0, seed), 0.075) is not None or seed < 2
    assert tracker.update(view(0.003, 1.0, 5), TOP - 0.003) is None
    assert tracker.reason == 'the tool is down'


def test_a_part_of_the_patch_that_is_missing_may_be_the_tool():
    """A tool that gives no returns leaves the rim of the patch, which is no dent."""
    clouds, heights = near_by()
    pressed = heights.value < TOP
    for frame in (frame for frame, down in zip(clouds, pressed, strict=True) if down):
        radius = np.hypot(frame.xyz[..., 0] - AXIS[0], frame.xyz[..., 1] - AXIS[1])
        frame.xyz[radius < 0.003] = np.nan
    signal, _ = displacement_from_clouds(clouds, heights)
    assert not np.any((signal.t > 1.05) & (signal.t < 1.75))
    assert np.count_nonzero(signal.t > 1.95) == 20


def test_the_upper_end_of_a_flat_tool_is_no_surface_that_was_pushed():
    clouds, heights = near_by()
    for frame in clouds[1:3]:
        frame.xyz[..., 2] = TOP + 0.02
    signal, _ = displacement_from_clouds(clouds, heights)
    assert np.abs(signal.value[signal.t > 1.95] - 0.002).max() < 2.0 * FINE


def test_a_wider_patch_tells_the_noise_of_few_points():
    """Of points 4 mm apart there are four in the patch."""
    clouds, heights = near_by(noise=1e-4)
    sparse = [CloudFrame(frame.t, frame.xyz[::2, ::2], 'c') for frame in clouds]
    signal, _ = displacement_from_clouds(sparse, heights)
    after = signal.t > 1.95
    assert np.count_nonzero(after) >= 10
    assert np.abs(signal.value[after] - 0.002).max() < 3.0 * 1e-4


def test_a_sensor_that_drifts_is_in_no_other_frame():
    """The object is as it was after the push, and the sensor has risen by half a millimetre."""
    frames = [(0.1 * k, TOP + 0.02, 0.0) for k in range(10)]
    frames += [(1.0 + 0.1 * k, TOP - 0.0005 * k, 0.0005 * k) for k in range(9)]
    frames += [(2.0 + 0.1 * k, TOP + 0.02, 0.0) for k in range(20)]
    drift = np.float32([0.0, 0.0, 1.25e-4])
    clouds = [
        CloudFrame(t, close_up(dent, seed) + drift * np.float32(t), 'c')
        for seed, (t, _, dent) in enumerate(frames)
    ]
    tool = Signal(np.array([t for t, _, _ in frames]), np.array([z for _, z, _ in frames]))
    signal, _ = displacement_from_clouds(clouds, tool)
    assert signal.value[-1] == pytest.approx(-4.3e-4, abs=5e-5)


def test_the_edge_of_an_object_is_no_noise():
    """A patch of which half is on the plate says nothing of how noisy heights are."""
    x, y = (axis.ravel() for axis in np.meshgrid(*[np.arange(-4, 5) * 0.001] * 2))
    heights = np.where(x > 0.0, TOP, 0.0) + FINE * np.random.default_rng(1).standard_normal(81)
    points, settings = np.column_stack((x, y, heights)), DisplacementSettings()
    assert _by_noise(points, 0.1, settings) is settings
    told = _by_noise(points[x > 0.0], 0.1, settings)
    assert told.noise == pytest.approx(FINE, rel=0.3)


def test_clouds_that_never_show_the_contact_point_give_no_heights() -> None:
    """Where the surface was tells the force, not what is seen beside the tool."""
    pushes = tuple(Push(speed, 0.004, 4.0, 3.0) for speed in (0.002, 0.004))
    sensors = Sensors(ForceNoise(0.01), 3e-5)
    ran = run(Campaign(Body(800.0, 900.0, 2000.0), pushes, sensors), [], seed=3)
    trial = ran.trials[0]
    heights = trial.displacement_height
    beside = Signal(heights.t, 0.2 * heights.value)
    seen = analyse(replace(trial, displacement_source='points'))
    hidden = analyse(replace(trial, displacement_height=beside, displacement_source='points'))
    recorded = analyse(replace(trial, displacement_height=beside))
    assert seen.trial.displacement_source == 'points'
    assert seen.trial.displacement_height is heights
    assert hidden.trial.displacement_height is None
    assert hidden.trial.displacement_source == 'none'
    assert 'stays above the tool' in hidden.warnings[-1]
    assert not hidden.noise.height.known
    assert recorded.trial.displacement_height is beside
