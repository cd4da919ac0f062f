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

"""From where the dent is to be seen."""

from hapticvision_ros.core.scene.body import Body
from hapticvision_ros.core.scene.symmetry import Symmetry
from hapticvision_ros.core.scene.viewpoint import choose_viewpoint, ViewSettings
import numpy as np
import pytest

CONTACT = np.array([0.0, 0.0, 0.04])


def body(height=0.04, ridge=0.0):
    """Return a block with a ridge along its side y = 30 mm."""
    inside = np.ones((40, 50), dtype=bool)
    heights = np.full(inside.shape, height)
    heights[-5:] += ridge
    return Body((-0.05, -0.04), 0.002, inside, heights, inside)


def along(angle):
    return Symmetry((0.0, 0.0), angle, 1.0, 1.0, 0.5)


def seen_over_the_rim(place, settings):
    """Return which share of the dent's middle line a straight line from `place` reaches."""
    away = (place - CONTACT) / np.linalg.norm(place - CONTACT)
    across = away[:2] / np.linalg.norm(away[:2])
    starts = np.linspace(-settings.patch_radius, settings.patch_radius, 2001)
    # Straight up to the rim's height, how far has the line gone out?
    out = starts + settings.dent_depth * np.linalg.norm(away[:2]) / away[2]
    assert across @ across == pytest.approx(1.0)
    return float(np.mean(out < settings.tool_radius))


@pytest.mark.parametrize('angle', [0.0, 0.7, 2.0])
@pytest.mark.parametrize('depth', [0.002, 0.006, 0.009])
def test_it_looks_across_the_plane_of_symmetry_at_the_contact_point(angle, depth):
    settings = ViewSettings(dent_depth=depth)
    found = choose_viewpoint(body(), along(angle), CONTACT, settings)
    ahead = found.pose.rotation[:, 2]
    assert ahead @ (np.cos(angle), np.sin(angle), 0.0) == pytest.approx(0.0, abs=1e-12)
    assert np.arcsin(-ahead[2]) == pytest.approx(found.elevation)
    assert found.pose.translation + settings.distance * ahead == pytest.approx(CONTACT)
    assert np.linalg.det(found.pose.rotation) == pytest.approx(1.0)
    # y of the optical frame points down.
    assert found.pose.rotation[2, 1] < 0.0
    assert np.deg2rad(30.0) <= found.elevation <= np.deg2rad(45.0)
    assert found.seen_share == pytest.approx(
        seen_over_the_rim(found.pose.translation, settings), abs=2e-3
    )


def test_a_shallow_dent_is_looked_at_from_low_and_a_deep_one_from_high():
    shares = []
    for depth in (0.002, 0.006, 0.012):
        found = choose_viewpoint(body(), along(0.0), CONTACT, ViewSettings(dent_depth=depth))
        shares.append((np.rad2deg(found.elevation), found.seen_share))
    assert shares[0] == pytest.approx((30.0, 1.0))
    assert shares[1] == pytest.approx((np.rad2deg(np.arctan2(6.0, 7.6)), 1.0), rel=1e-6)
    assert shares[2][0] == pytest.approx(45.0)
    assert shares[2][1] < 0.7


def test_a_horizontal_view_sees_nothing_of_a_dent():
    flat = ViewSettings(least_elevation=0.0, largest_elevation=0.02)
    assert choose_viewpoint(body(), along(0.0), CONTACT, flat).seen_share == 0.0


def test_it_stands_on_the_side_where_nothing_is_in_the_way():
    found = choose_viewpoint(body(ridge=0.02), along(0.0), CONTACT)
    assert found.pose.translation[1] < 0.0
    assert found.seen_share == 1.0


@pytest.mark.parametrize('side', [-1.0, 1.0])
def test_of_equal_sides_it_takes_the_one_of_the_sensor(side):
    near = np.array([0.1, side * 0.3, 0.3])
    found = choose_viewpoint(body(), along(0.0), CONTACT, near=near)
    assert found.pose.translation[1] * side > 0.0
