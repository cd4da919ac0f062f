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

"""A measured cloud beside a known surface: the object, its numbers, distances, noise."""

from collections.abc import Callable
from dataclasses import replace
import math
from types import SimpleNamespace
from typing import Any, cast

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import CloudFrame, Estimate, Signal
from hapticvision_ros.core.surface.cloud import (
    _seen_radius,
    CloudSettings,
    Observation,
    observe,
    Seen,
)
from hapticvision_ros.core.surface.compare import compare, seen_triangles
from hapticvision_ros.core.surface.deformation import measure, patch_height
import numpy as np
import pytest

from .conftest import dented, NOISE, PHASES, Record, SIZE, TOOL, TOOL_RADIUS, true_depth

SETTINGS = CloudSettings(TOOL_RADIUS)
DEPTH = Estimate(0.010, 1e-5)


def test_the_object_is_told_from_plane_and_tool(observed: Observation) -> None:
    for seen in (observed.before, *observed.after):
        low, high = seen.points.min(axis=0), seen.points.max(axis=0)
        assert np.all(np.abs(low[:2] + np.array(SIZE[:2]) / 2) < 0.002)
        assert np.all(np.abs(high[:2] - np.array(SIZE[:2]) / 2) < 0.002)
        assert high[2] < SIZE[2] + 0.002
        assert seen.frames == 5
    # The map of heights is of one view, which hides a strip along the far side.
    assert observed.body.volume == pytest.approx(math.prod(SIZE), rel=0.07)


def test_the_noise_of_the_mean_has_its_direction(observed: Observation) -> None:
    seen = observed.before
    top = seen.points[:, 2] > SIZE[2] - 0.003
    part = replace(seen, points=seen.points[top], covariance=seen.covariance[top])
    count = len(part.points)

    def along(x: float, y: float, z: float) -> float:
        return math.sqrt(np.mean(part.noise(np.tile([x, y, z], (count, 1))) ** 2))

    # Along the depth of five frames; seen at 45 degrees, and not across it.
    expected = NOISE / math.sqrt(5)
    assert along(0.0, -math.sqrt(0.5), math.sqrt(0.5)) == pytest.approx(expected, rel=0.05)
    assert along(0.0, 0.0, 1.0) == pytest.approx(expected * math.sqrt(0.5), rel=0.1)
    assert along(0.0, math.sqrt(0.5), math.sqrt(0.5)) < 0.2 * expected


def test_the_axis_is_that_of_the_tool_and_x_the_longer_side(record: Record) -> None:
    yaw = 0.35
    found = observe(record(yaw=yaw), TOOL, PHASES, SETTINGS)
    assert found.contact_source == 'tool'
    np.testing.assert_allclose(found.shift[:2], 0.0, atol=2e-4)
    turned = math.atan2(found.rotation[0, 1], found.rotation[0, 0])
    assert turned == pytest.approx(yaw, abs=0.02)


def test_the_axis_of_a_ball_that_is_not_pressed_in_to_its_equator_is_found(
    record: Record,
) -> None:
    raised = 0.0055
    tool = Signal(TOOL.t, TOOL.value + raised)
    flat, ball = (
        observe(record(sphere=sphere, raised=raised), tool, PHASES, SETTINGS)
        for sphere in (False, True)
    )
    assert ball.contact_source == 'tool'
    # As if all of it were as wide as its shaft it was 0.08 mm aside.
    np.testing.assert_allclose(ball.shift[:2], flat.shift[:2], atol=2e-5)


def test_the_axis_of_a_tool_of_many_returns_is_found(record: Record) -> None:
    # So many that a circle that is not there has enough of them beside it.
    few = replace(SETTINGS, average=1)
    found = observe(record(columns=640, step=4.0), TOOL, PHASES, few)
    assert found.contact_source == 'tool'
    np.testing.assert_allclose(found.shift[:2], 0.0, atol=2e-4)


def test_the_radius_of_the_tool_is_seen_whatever_was_told(record: Record) -> None:
    wrong = replace(SETTINGS, tool_radius=0.8 * TOOL_RADIUS)
    for settings in (SETTINGS, wrong):
        radius = observe(record(), TOOL, PHASES, settings, contact=(0.0, 0.0)).tool_radius
        assert radius.value is not None
        assert radius.std is not None
        assert radius.std < 1e-4
        assert abs(radius.value - TOOL_RADIUS) < 4.0 * radius.std


def test_a_short_noisy_arc_tells_no_radius(record: Record) -> None:
    # A post before the tool leaves a piece of it to be seen.
    def behind(frames: list[CloudFrame], width: float) -> list[CloudFrame]:
        made = []
        for frame in frames:
            xyz = frame.xyz.copy()
            tool = (xyz[..., 2] > SIZE[2] + 0.002) & (np.abs(xyz[..., 0]) > width)
            xyz[tool] = np.nan
            made.append(replace(frame, xyz=xyz))
        return made

    known = [
        observe(behind(record(), width), TOOL, PHASES, SETTINGS, contact=(0.0, 0.0)).tool_radius
        for width in (0.9 * TOOL_RADIUS, 0.3 * TOOL_RADIUS)
    ]
    assert known[0].value == pytest.approx(TOOL_RADIUS, rel=0.03)
    assert known[1].value is None
    assert 'no circle is seen' in (known[1].reason or '')


def test_residual_and_bounce_are_those_of_the_dent(observed: Observation) -> None:
    surfaces = tuple(dented(true_depth(seen.t)) for seen in observed.after)
    found = measure(observed, dented(0.0), surfaces, depth=DEPTH, simulated_depth=0.010)
    for height in found.heights:
        assert height.measured.value is not None
        assert height.measured.std is not None
        assert height.measured.std < 5e-5
        assert abs(height.measured.value - true_depth(height.t)) < 3.0 * height.measured.std
        assert height.simulated.value == pytest.approx(true_depth(height.t), abs=2e-5)
    last = true_depth(found.heights[-1].t)
    for pair in (found.residual, found.bouncing):
        assert pair.measured.value is not None
        assert pair.simulated.value is not None
        assert pair.measured.std is not None
        assert abs(pair.measured.value - pair.simulated.value) < 3.0 * pair.measured.std
    assert found.residual.simulated.value == pytest.approx(last, abs=2e-5)
    assert found.bouncing.simulated.value == pytest.approx(0.010 - last, abs=2e-5)
    # The block has no bulge; the dent takes the same volume from both, 1 % of cells at its rim.
    assert abs(found.bulge.measured.value or 1.0) < 3.0 * (found.bulge.measured.std or 0.0)
    assert found.bulge.simulated.value == pytest.approx(0.0, abs=1e-9)
    assert found.volume_change.measured.value == pytest.approx(
        found.volume_change.simulated.value or 0.0, rel=0.03
    )


def test_a_bulge_of_the_sides_is_seen(observed: Observation) -> None:
    rest = dented(0.0)
    bulged = rest.points.copy()
    # A whole side moves out by 1 mm, in the surface and in the cloud.
    side = np.abs(bulged[:, 1] + SIZE[1] / 2) < 1e-9
    bulged[side, 1] -= 1e-3
    last = observed.after[-1]
    points = last.points.copy()
    points[points[:, 1] < -SIZE[1] / 2 + 1.5e-3, 1] -= 1e-3
    moved = replace(observed, after=(replace(last, points=points),))
    found = measure(
        moved, rest, (type(rest)(bulged, rest.triangles),), depth=DEPTH, simulated_depth=0.010
    )
    assert found.bulge.measured.value == pytest.approx(1e-3, rel=0.05)
    assert found.bulge.simulated.value == pytest.approx(1e-3, rel=0.05)


def test_of_a_true_surface_noise_is_the_rms_and_of_a_false_one_it_is_not(
    observed: Observation,
) -> None:
    seen = observed.after[-1]
    rest, true = dented(0.0), dented(true_depth(seen.t))
    visible = seen_triangles(observed.before, rest)
    right = compare(seen, true, visible)
    expected = NOISE / math.sqrt(5) * math.sqrt(0.5)
    assert right.noise == pytest.approx(expected, rel=0.05)
    # The lattice cuts the dent's curved rim into facets of 2.5 mm: the rest of the rms.
    assert right.noise_share > 0.85
    assert right.beyond_noise < 7e-5
    assert right.percentile_95 == pytest.approx(right.noise_percentile_95, rel=0.08)
    assert right.largest < 2.0 * right.noise_largest
    assert abs(right.shift) < 3e-5
    assert right.surface_percentile_95 is not None
    assert 0.3 * right.spacing < right.surface_percentile_95 < 2.0 * right.spacing
    assert right.hausdorff is not None
    assert right.hausdorff >= right.largest
    wrong = compare(seen, dented(true_depth(seen.t) + 0.002), visible)
    assert wrong.noise == pytest.approx(right.noise, rel=0.02)
    assert wrong.noise_share < 0.3
    assert wrong.percentile_95 > 1.4e-3
    assert wrong.shift > 10.0 * abs(right.shift)


def test_seen_are_the_top_and_the_side_before_the_sensor(observed: Observation) -> None:
    rest = dented(0.0)
    visible = seen_triangles(observed.before, rest)
    inner = np.abs(rest.centres[:, 0]) < 0.03
    up = (rest.normals[:, 2] > 0.9) & inner & (rest.centres[:, 1] > -0.02)
    front = (rest.normals[:, 1] < -0.9) & inner & (rest.centres[:, 2] > 0.008)
    back = (rest.normals[:, 1] > 0.9) & (rest.centres[:, 2] < 0.03)
    under = rest.normals[:, 2] < -0.9
    assert visible[front].mean() > 0.95
    assert visible[up].mean() > 0.8
    assert not visible[back | under].any()


def test_clouds_without_rows_have_the_noise_of_the_plane(record: Record) -> None:
    few = replace(SETTINGS, average=2)
    found = observe(record(flat=True), TOOL, PHASES, few, contact=(0.0, 0.0))
    # Not the mean but all returns; along the depth the plane is seen at 45 degrees as well.
    assert len(found.before.points) > 10_000
    up = np.tile([0.0, 0.0, 1.0], (len(found.before.points), 1))
    assert found.before.noise(up)[0] == pytest.approx(NOISE * math.sqrt(0.5), rel=0.05)


def _without(condition: Callable[[CloudFrame], bool]) -> Callable[[list[CloudFrame]], list]:
    return lambda frames: [frame for frame in frames if not condition(frame)]


@pytest.mark.parametrize(
    ('left', 'phases', 'complaint'),
    [
        (_without(lambda frame: frame.t < 2.0), PHASES, 'from before the push'),
        (_without(lambda frame: frame.t > 5.0), PHASES, 'from after the release'),
        (list, replace(PHASES, t_release=None), 'no release'),
        (list, replace(PHASES, t_contact=None), 'no contact'),
        (list, replace(PHASES, contact_height=0.2), 'does not rise'),
    ],
)
def test_what_is_missing_is_said(
    record: Record,
    left: Callable[[list[CloudFrame]], list[CloudFrame]],
    phases: object,
    complaint: str,
) -> None:
    with pytest.raises(InputError, match=complaint):
        observe(left(record()), TOOL, phases, SETTINGS)  # type: ignore[arg-type]


def test_a_contact_point_that_is_not_seen_has_no_height() -> None:
    nowhere = Seen(0.0, np.full((20, 3), 0.1), np.zeros((20, 3, 3)), 5, 0.0)
    height = patch_height(nowhere)
    assert height.value is None
    assert '0 returns' in (height.reason or '')


@pytest.mark.parametrize('seed', range(5))
def test_a_sharp_plane_does_not_make_the_tool_sharp(seed: int) -> None:
    random = np.random.default_rng(seed)
    angle = random.uniform(-1.4, 1.4, 600)
    radius = TOOL_RADIUS + random.normal(0.0, 5e-5, 600)
    tool = np.column_stack((radius * np.cos(angle), radius * np.sin(angle), np.full(600, 0.05)))
    stray = random.random(600) < 0.1
    tool[stray, :2] = random.uniform(-0.012, 0.012, (int(stray.sum()), 2))
    hold = SimpleNamespace(points=tool, tool=0.04, plane_noise=1e-9)
    seen = _seen_radius(cast('Any', hold), 0.04)
    assert seen.value is not None
    assert seen.std is not None
    assert abs(seen.value - TOOL_RADIUS) < 4.0 * seen.std < 1e-4
