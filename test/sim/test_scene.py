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


"""The clouds show what a range sensor at its place could see, and nothing else."""

from dataclasses import replace
from math import atan2, cos, radians, sin

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import PointArray
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np
import pytest

UP, DEPTH = 0.080, 0.008


def scene_of(config: WorldConfig, elevation: float | None = None, dropout: float = 0.0) -> Scene:
    sensor = replace(
        config.range_sensor,
        dropout=dropout,
        elevation=config.range_sensor.elevation if elevation is None else elevation,
    )
    return Scene(config.block, config.arm.tool_radius, sensor)


def exact(scene: Scene, seed: int = 0) -> RangeRenderer:
    return RangeRenderer(scene, width=160, height=120, depth_noise=0.0, seed=seed)


def near_axis(cloud: PointArray, radius: float) -> PointArray:
    points = cloud.reshape(-1, 3)
    return points[np.hypot(points[:, 0], points[:, 1]) < radius]


def below_surface(scene: Scene, displacement: float, points: PointArray) -> PointArray:
    """Return how far the points are below the dented top, NaN outside the block's outline."""
    block = scene.block
    inside = (np.abs(points[:, 0]) < 0.5 * block.length) & (
        np.abs(points[:, 1]) < 0.5 * block.width
    )
    radius = np.hypot(points[:, 0], points[:, 1]).astype(np.float64)
    surface = block.height - displacement * scene.profile(radius)
    return np.where(inside, surface - points[:, 2], np.nan)


def test_undented_block_lies_on_the_plane_and_has_its_size(config: WorldConfig) -> None:
    scene = scene_of(config)
    points = exact(scene).render(UP, 0.0).reshape(-1, 3)
    assert points.dtype == np.float32
    points = points[np.isfinite(points).all(axis=1)]
    points = points[np.hypot(points[:, 0], points[:, 1]) > 0.0127]
    # A pixel is 0.9 mm wide where it meets the block.
    top = points[np.abs(points[:, 2] - 0.040) < 1e-6]
    assert np.ptp(top[:, 0]) == pytest.approx(0.085, abs=2e-3)
    assert np.ptp(top[:, 1]) == pytest.approx(0.060, abs=3e-3)
    assert points[:, 2].min() == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize('displacement', [0.0005, 0.003, 0.008, 0.012])
def test_no_point_floats_above_or_sinks_below_the_dented_surface(
    config: WorldConfig, displacement: float
) -> None:
    scene = scene_of(config)
    points = exact(scene).render(UP, displacement).reshape(-1, 3)
    points = points[points[:, 2] < UP - 1e-3]
    reach = config.arm.tool_radius + config.block.rim_width
    in_dent = points[np.hypot(points[:, 0], points[:, 1]) < reach]
    assert len(in_dent) > 200
    # A 25th of the sensor's noise.
    assert np.abs(below_surface(scene, displacement, in_dent)).max() < 2e-5


def test_each_ray_ends_where_it_first_meets_the_surface(config: WorldConfig) -> None:
    scene = scene_of(config)
    sensor = scene.sensor
    origin = np.array(
        [
            0.0,
            -sensor.distance * cos(sensor.elevation),
            config.block.height + sensor.distance * sin(sensor.elevation),
        ]
    )
    points = exact(scene).render(UP, DEPTH).reshape(-1, 3)
    reach = config.arm.tool_radius + config.block.rim_width
    ends = points[(np.hypot(points[:, 0], points[:, 1]) < reach) & (points[:, 2] < UP - 1e-3)]
    # All of the way but the last 0.3 mm must be in the air.
    length = np.linalg.norm(ends - origin, axis=1)
    for part in np.linspace(0.9, 1.0, 400):
        before = part < 1.0 - 0.0003 / length
        way = origin + part * (ends[before] - origin)
        depth = below_surface(scene, DEPTH, way)
        assert not np.any(depth > 2e-6)


def test_the_tool_hides_the_dent_while_it_is_down(config: WorldConfig) -> None:
    renderer = exact(scene_of(config))
    down = renderer.render(config.block.height - DEPTH, DEPTH)
    assert len(near_axis(down, 0.005)) == 0
    up = near_axis(renderer.render(UP, DEPTH), 0.005)
    assert len(up) > 30
    np.testing.assert_allclose(up[:, 2], config.block.height - DEPTH, atol=1e-6)


def test_the_tool_is_seen_as_a_cylinder_above_its_tip(config: WorldConfig) -> None:
    tip = 0.050
    points = exact(scene_of(config)).render(tip, 0.0).reshape(-1, 3)
    tool = points[points[:, 2] > config.block.height + 1e-3]
    assert len(tool) > 200
    np.testing.assert_allclose(np.hypot(tool[:, 0], tool[:, 1]), config.arm.tool_radius, atol=2e-6)
    assert tool[:, 2].min() == pytest.approx(tip, abs=1e-3)
    assert (tool[:, 1] < 0.0).all(), 'only the side toward the sensor is seen'


def test_the_raised_tool_hides_none_of_the_top(config: WorldConfig) -> None:
    renderer = exact(scene_of(config))
    away = renderer.render(0.14, 0.0)
    raised = renderer.render(config.arm.start_height, 0.0)
    on_top = np.abs(away[..., 2] - config.block.height) < 1e-6
    np.testing.assert_array_equal(raised[on_top], away[on_top])


def test_a_view_from_the_side_cannot_see_the_bottom_of_a_dent(config: WorldConfig) -> None:
    low = exact(scene_of(config, elevation=radians(10.0))).render(0.14, DEPTH)
    assert len(near_axis(low, 0.005)) == 0
    good = exact(scene_of(config, elevation=radians(40.0))).render(0.14, DEPTH)
    assert np.median(near_axis(good, 0.005)[:, 2]) == pytest.approx(0.032, abs=1e-6)


def test_a_turned_block_is_seen_turned(config: WorldConfig) -> None:
    turned = replace(config, block=replace(config.block, yaw=radians(30.0)))
    points = exact(scene_of(turned)).render(UP, 0.0).reshape(-1, 3)
    top = points[np.abs(points[:, 2] - 0.040) < 1e-6][:, :2].astype(np.float64)
    (xx, xy), (_, yy) = np.cov(top.T)
    assert 0.5 * atan2(2.0 * xy, xx - yy) == pytest.approx(radians(30.0), abs=radians(1.0))


def test_noise_is_along_the_depth_and_has_its_size(config: WorldConfig) -> None:
    scene = scene_of(config)
    clean = exact(scene).render(UP, 0.0)
    noisy = RangeRenderer(scene, width=160, height=120, depth_noise=0.0005, seed=1)
    error = (noisy.render(UP, 0.0) - clean).reshape(-1, 3)
    optical_axis = np.array([0.0, cos(scene.sensor.elevation), -sin(scene.sensor.elevation)])
    depth_error = (error @ optical_axis)[np.isfinite(error[:, 0])]
    # 19,000 samples: one standard error of the standard deviation is 0.5 %.
    assert depth_error.std() == pytest.approx(0.0005, rel=0.02)
    assert abs(depth_error.mean()) < 2e-5


def test_dropouts_are_nan_and_have_their_share(config: WorldConfig) -> None:
    scene = scene_of(config, dropout=0.05)
    cloud = exact(scene).render(UP, 0.0)
    full = exact(scene_of(config)).render(UP, 0.0)
    lost = np.isnan(cloud[..., 0]) & ~np.isnan(full[..., 0])
    # Some pixels are drawn twice: 1 - exp(-0.05) = 4.9 %.
    assert lost.mean() == pytest.approx(0.049, abs=0.006)
    assert (np.isnan(cloud).any(axis=2) == np.isnan(cloud).all(axis=2)).all()


def test_the_same_seed_gives_the_same_clouds(config: WorldConfig) -> None:
    clouds = []
    for seed in (3, 3, 4):
        renderer = RangeRenderer(
            scene_of(config, dropout=0.01), width=32, height=24, depth_noise=0.0005, seed=seed
        )
        clouds.append(renderer.render(UP, DEPTH))
    np.testing.assert_array_equal(clouds[0], clouds[1])
    assert not np.array_equal(clouds[0], clouds[2], equal_nan=True)


def test_a_dent_wider_than_the_block_is_refused(config: WorldConfig) -> None:
    with pytest.raises(InputError, match='does not fit on the block'):
        Scene(config.block, 0.030, config.range_sensor)


def test_a_tool_that_ends_in_a_ball_is_seen_as_one(config: WorldConfig) -> None:
    radius, tip = config.arm.tool_radius, config.block.height + 0.02
    sensor = replace(config.range_sensor, dropout=0.0)
    flat, ball = (
        RangeRenderer(
            Scene(config.block, radius, sensor, sphere),
            width=160,
            height=120,
            depth_noise=0.0,
            seed=1,
        )
        .render(tip, 0.0)
        .reshape(-1, 3)
        for sphere in (False, True)
    )
    changed = (flat != ball).any(axis=1) & np.isfinite(flat).all(axis=1)
    assert np.count_nonzero(changed) > 50
    # What the ball leaves free of the cylinder shows what is behind.
    behind = changed & (ball[:, 2] <= config.block.height + 1e-6)
    assert np.count_nonzero(behind) > 10
    on_ball = ball[changed & ~behind]
    assert len(on_ball) > 30
    centre = np.array([0.0, 0.0, tip + radius])
    np.testing.assert_allclose(np.linalg.norm(on_ball - centre, axis=1), radius, atol=1e-6)
    assert on_ball[:, 2].max() <= tip + radius + 1e-6
    assert on_ball[:, 2].min() < tip + 0.5 * radius
    shaft = ball[ball[:, 2] > tip + 1.01 * radius]
    np.testing.assert_allclose(np.hypot(shaft[:, 0], shaft[:, 1]), radius, atol=1e-6)
