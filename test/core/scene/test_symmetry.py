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

"""The line of symmetry, on maps of heights that the tests draw."""

from hapticvision_ros.core.scene.body import Body
from hapticvision_ros.core.scene.symmetry import find_symmetry
from hypothesis import given, settings, strategies
import numpy as np
import pytest

CELL = 0.002


def drawn(inside, height, half=0.07, centre=(0.0, 0.0), yaw=0.0):
    """Return a body from its outline and height as functions of its own x and y."""
    axis = np.arange(-half, half, CELL)
    x, y = np.meshgrid(axis + 0.5 * CELL, axis + 0.5 * CELL)
    dx, dy = x - centre[0], y - centre[1]
    u, v = dx * np.cos(yaw) + dy * np.sin(yaw), dy * np.cos(yaw) - dx * np.sin(yaw)
    mask = inside(u, v)
    return Body((-half, -half), CELL, mask, np.where(mask, height(u, v), 0.0), mask)


def rectangle(u, v):
    return (np.abs(u) < 0.0453) & (np.abs(v) < 0.0304)


def square(u, v):
    return (np.abs(u) < 0.0304) & (np.abs(v) < 0.0304)


def kite(u, v):
    """Return an outline that is symmetric about u only."""
    return np.abs(v) < np.where(u < 0.0, 0.03 * (1 + u / 0.02), 0.03 * (1 - u / 0.05))


def flat(u, v):
    return np.full_like(u, 0.04)


def slope(u, v):
    return 0.03 + 0.3 * u


def difference(angle, expected, period):
    """Return how far an angle is from another of some period [rad]."""
    return abs((angle - expected + 0.5 * period) % period - 0.5 * period)


@given(yaw=strategies.floats(0.0, np.pi), dx=strategies.floats(-0.01, 0.01))
@settings(max_examples=15, deadline=None)
def test_the_line_turns_and_moves_with_the_object(yaw, dx):
    found = find_symmetry(drawn(rectangle, flat, centre=(dx, -dx), yaw=yaw))
    # Along the map's own axes all cells of a side come and go together: half a cell.
    assert found.centre == pytest.approx((dx, -dx), abs=0.5 * CELL)
    # Each end of a long side is known to a cell.
    assert difference(found.angle, yaw, np.pi) < 2.0 * CELL / 0.0906
    # 150 of its 1,380 cells are at the border, where image and mirror image differ by half a cell.
    assert found.body_overlap > (1380 - 75) / (1380 + 75)


@pytest.mark.parametrize('yaw', [0.0, 0.5, 1.3])
def test_a_wedge_is_cut_along_its_slope(yaw):
    # Its outline is alike on both sides of both axes; the slope goes along the shorter one here.
    body = drawn(lambda u, v: rectangle(v, u), slope, yaw=yaw)
    found = find_symmetry(body)
    assert difference(found.angle, yaw, np.pi) < np.deg2rad(1.5)
    assert found.body_overlap > 0.93 > 0.85 > found.other_overlap


@pytest.mark.parametrize('yaw', [0.0, 0.3, 0.7])
def test_a_square_has_axes_though_its_moments_have_none(yaw):
    found = find_symmetry(drawn(square, flat, yaw=yaw))
    # Along the sides or along the diagonals.
    assert difference(found.angle, yaw, np.pi / 4) < np.deg2rad(2.0)
    assert found.outline_overlap > 0.92


@pytest.mark.parametrize('yaw', [0.2, 1.1])
def test_a_kite_has_one_axis_only(yaw):
    found = find_symmetry(drawn(kite, flat, yaw=yaw))
    assert difference(found.angle, yaw, np.pi) < np.deg2rad(2.0)
    assert found.outline_overlap > found.other_overlap + 0.1
