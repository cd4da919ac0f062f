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

"""Support plane and contact point from one cloud."""

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import plan_contact
from hapticvision_ros.core.scene.plane import finite_points, fit_support_plane
from hapticvision_ros.core.scene.settings import PlanningSettings
import numpy as np
import pytest

TOP = 0.045


def rotation(angle, axis):
    """Return the matrix of a rotation by `angle` about `axis` (Rodrigues)."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    k = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * k + (1.0 - np.cos(angle)) * k @ k


def scene(*blocks, noise=3e-4, seed=0, step=0.001):
    """Return a top view of the plane z = 0 with blocks (x, y, length, width, yaw, height)."""
    x, y = np.meshgrid(np.arange(-0.15, 0.15, step), np.arange(-0.12, 0.12, step))
    z = np.zeros_like(x)
    for cx, cy, length, width, yaw, height in blocks:
        u = (x - cx) * np.cos(yaw) + (y - cy) * np.sin(yaw)
        v = -(x - cx) * np.sin(yaw) + (y - cy) * np.cos(yaw)
        z[(np.abs(u) < length / 2) & (np.abs(v) < width / 2)] = height
    z += np.random.default_rng(seed).normal(0.0, noise, z.shape)
    return np.stack((x, y, z), axis=-1).astype(np.float32)


@pytest.mark.parametrize('yaw', [0.0, 0.4, 1.2])
@pytest.mark.parametrize('centre', [(0.0, 0.0), (0.0313, -0.0177)])
def test_the_contact_point_is_above_the_top_views_mass_centre(centre, yaw):
    plan = plan_contact(scene((*centre, 0.09, 0.06, yaw, TOP)))
    # Half a cell of 2 mm at most; edges on both sides average it out.
    assert plan.contact_point[:2] == pytest.approx(centre, abs=1e-3)
    # A median of some 78 points with 0.3 mm noise: 0.04 mm.
    assert plan.contact_point[2] == pytest.approx(TOP, abs=2e-4)
    assert plan.push_direction == pytest.approx((0.0, 0.0, -1.0), abs=1e-3)
    # The area has up to half a cell on each of its edges.
    assert plan.object_area == pytest.approx(0.09 * 0.06, rel=0.1)


def test_an_uneven_top_is_pushed_at_its_own_height_there():
    cloud = scene((0.0, 0.0, 0.1, 0.06, 0.0, TOP))
    cloud[..., 2] += np.where(cloud[..., 2] > 0.02, 0.2 * cloud[..., 0], 0.0).astype(np.float32)
    x, _, z = plan_contact(cloud).contact_point
    assert z == pytest.approx(TOP + 0.2 * x, abs=2e-4)


def test_missing_returns_and_stray_points_do_not_move_the_contact_point():
    cloud = scene((0.01, 0.0, 0.09, 0.06, 0.3, TOP))
    random = np.random.default_rng(1)
    cloud[random.random(cloud.shape[:2]) < 0.3] = np.nan
    cloud[random.random(cloud.shape[:2]) < 0.001] = np.inf
    stray = random.random(cloud.shape[:2]) < 0.001
    cloud[stray, 2] = random.uniform(0.0, 0.3, np.count_nonzero(stray))
    plan = plan_contact(cloud)
    assert plan.contact_point == pytest.approx((0.01, 0.0, TOP), abs=1.5e-3)


def test_what_is_as_high_as_the_tool_tip_is_no_object():
    cloud = scene((0.0, 0.0, 0.09, 0.06, 0.0, TOP))
    x, y, _ = np.moveaxis(cloud, -1, 0)
    cloud[np.hypot(x - 0.075, y) < 0.0126, 2] = 0.08
    with pytest.raises(InputError, match='There are 2 objects'):
        plan_contact(cloud)
    plan = plan_contact(cloud, ceiling=0.08)
    assert plan.contact_point == pytest.approx((0.0, 0.0, TOP), abs=1e-3)


def test_an_unorganised_cloud_gives_the_same_plan():
    cloud = scene((0.01, 0.0, 0.09, 0.06, 0.3, TOP))
    shuffled = finite_points(cloud)
    np.random.default_rng(2).shuffle(shuffled)
    expected = plan_contact(cloud).contact_point
    # Other points for the plane: its tilt of some 1e-4 moves points over the cells' borders.
    assert plan_contact(shuffled).contact_point == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize('angle', [0.3, 1.0, 2.5])
def test_the_plane_is_found_in_a_sensors_own_frame(angle):
    cloud = finite_points(scene((0.0, 0.0, 0.09, 0.06, 0.0, TOP)))
    turn = rotation(angle, (1.0, 0.3, 0.0))
    # The sensor, the origin of its frame, stands 0.5 m above the plane.
    in_sensor = ((cloud - np.array([0.0, 0.0, 0.5])) @ turn.T).astype(np.float32)
    plane = fit_support_plane(in_sensor)
    assert plane.normal == pytest.approx(turn @ (0.0, 0.0, 1.0), abs=1e-3)
    turned, shift = plane.to_plane_frame()
    height = (in_sensor @ turned.T + shift)[:, 2]
    assert np.percentile(height, 99) == pytest.approx(TOP, abs=1e-3)
    assert plan_contact(in_sensor).object_height == pytest.approx(TOP, abs=5e-4)


def test_the_objects_top_is_not_the_support_even_if_it_holds_most_points():
    cloud = scene((0.0, 0.0, 0.26, 0.2, 0.0, TOP))
    assert np.mean(cloud[..., 2] > 0.02) > 0.7
    plane = fit_support_plane(finite_points(cloud))
    assert plane.offset == pytest.approx(0.0, abs=1e-4)


def test_three_points_of_one_row_of_a_grid_propose_no_plane_of_their_own():
    # Most of this view is the object, so that such triples of the ground are tried first.
    cloud = scene((0.0, 0.0, 0.26, 0.2, 0.0, TOP), noise=1e-4, step=0.004)
    for seed in range(10):
        plane = fit_support_plane(finite_points(cloud), PlanningSettings(seed=seed))
        assert plane.normal == pytest.approx((0.0, 0.0, 1.0), abs=2e-3)


def test_an_upside_down_frame_is_turned_back():
    cloud = finite_points(scene((0.0, 0.0, 0.09, 0.06, 0.0, TOP)))
    flipped = (cloud * (1.0, -1.0, -1.0) + (0.0, 0.0, 0.5)).astype(np.float32)
    plane = fit_support_plane(flipped)
    assert plane.normal == pytest.approx((0.0, 0.0, -1.0), abs=1e-3)
    turned, shift = plane.to_plane_frame()
    assert np.linalg.det(turned) == pytest.approx(1.0)
    assert np.percentile((flipped @ turned.T + shift)[:, 2], 99) == pytest.approx(TOP, abs=1e-3)


@pytest.mark.parametrize(
    ('cloud', 'sentence'),
    [
        (scene(), 'Nothing larger than'),
        (scene((0.0, 0.0, 0.01, 0.01, 0.0, TOP)), 'Nothing larger than 4 cm'),
        (
            scene((-0.05, 0.0, 0.04, 0.04, 0.0, TOP), (0.05, 0.0, 0.04, 0.04, 0.0, TOP)),
            'There are 2 objects on the support plane',
        ),
        (scene((0.14, 0.0, 0.08, 0.05, 0.0, TOP)), "border of the range sensor's image"),
        (np.full((50, 50, 3), np.nan, dtype=np.float32), 'only 0 returns'),
        (
            np.random.default_rng(0).uniform(-0.5, 0.5, (5000, 3)).astype(np.float32),
            'No support plane',
        ),
        (np.repeat(np.linspace(0.1, 1, 500, dtype=np.float32), 3).reshape(-1, 3), 'No support'),
    ],
    ids=['nothing', 'too small', 'two', 'cut off', 'no returns', 'fog', 'a line'],
)
def test_what_cannot_be_pushed_is_refused_with_the_reason(cloud, sentence):
    with pytest.raises(InputError, match=sentence):
        plan_contact(cloud)


def test_a_hidden_surface_is_refused():
    cloud = scene((0.0, 0.0, 0.09, 0.06, 0.0, TOP))
    x, y, _ = np.moveaxis(cloud, -1, 0)
    cloud[np.hypot(x, y) < 0.007] = np.nan
    with pytest.raises(InputError, match='is not seen: 0 returns within 5 mm'):
        plan_contact(cloud, settings=PlanningSettings(closing_cells=9))
