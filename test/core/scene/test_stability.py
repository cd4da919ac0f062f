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

"""Whether a push tips, slides or slips: against forces worked out by hand."""

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.scene.body import Body
from hapticvision_ros.core.scene.stability import (
    check_push,
    find_base,
    GRAVITY,
    PushSettings,
    refuse_unstable,
)
from hapticvision_ros.core.scene.surface import Surface
from hypothesis import given, strategies
import numpy as np
import pytest

HALF = 0.03
BASE = HALF * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
UP = np.array([0.0, 0.0, 1.0])


def cube(height=0.04):
    inside = np.ones((30, 30), dtype=bool)
    return Body((-HALF, -HALF), 0.002, inside, np.where(inside, height, 0.0), inside)


def tilted(angle):
    return np.array([np.sin(angle), 0.0, np.cos(angle)])


def test_a_push_in_the_middle_is_as_far_from_tipping_as_its_base_is_wide():
    found = check_push(cube(), BASE, True, np.array([0.0, 0.0, 0.04]), UP)
    assert found.base_distance == pytest.approx(HALF)
    assert found.slope == pytest.approx(0.0)
    refuse_unstable(found)


def test_an_eccentric_push_is_held_by_the_weight():
    # Moments about the edge x = 30 mm: 20 N at 5 mm outside, the weight at 30 mm inside.
    contact = np.array([HALF + 0.005, 0.0, 0.04])
    light = check_push(cube(), BASE, True, contact, UP, PushSettings(force=20.0))
    assert light.base_distance == pytest.approx(-0.005)
    mass = 20.0 * 0.005 / 0.03 / GRAVITY
    balanced = check_push(cube(), BASE, True, contact, UP, PushSettings(force=20.0, mass=mass))
    assert balanced.base_distance == pytest.approx(0.0, abs=1e-9)
    with pytest.raises(InputError, match=r'would tip the object: at 20 N .* 5.0 mm outside'):
        refuse_unstable(light)


def test_a_push_near_the_edge_is_refused_too():
    near = check_push(cube(), BASE, True, np.array([HALF - 0.001, 0.0, 0.04]), UP)
    with pytest.raises(InputError, match=r'only 1\.0 mm inside its base'):
        refuse_unstable(near)


def test_an_inclined_surface_turns_the_force_to_its_normal():
    angle = 0.2
    settings = PushSettings(force=10.0, tool_friction=0.5)
    found = check_push(cube(), BASE, True, np.array([0.0, 0.0, 0.04]), tilted(angle), settings)
    assert found.slope == pytest.approx(np.tan(angle))
    # The force along the normal meets the plane 40 mm * tan(angle) to the side.
    assert found.base_distance == pytest.approx(HALF - 0.04 * np.tan(angle))
    refuse_unstable(found, settings)
    slippery = PushSettings(force=10.0, tool_friction=0.5, support_friction=0.15)
    bare = check_push(cube(), BASE, True, np.array([0.0, 0.0, 0.04]), tilted(angle), slippery)
    with pytest.raises(InputError, match=r'would slide the object: its load is inclined by 0\.20'):
        refuse_unstable(bare, slippery)
    # 10 N of load at 0.2 rad, and a weight: 1.99 N to the side, 9.80 N and the weight down.
    heavy = PushSettings(force=10.0, tool_friction=0.5, support_friction=0.15, mass=0.5)
    held = check_push(cube(), BASE, True, np.array([0.0, 0.0, 0.04]), tilted(angle), heavy)
    down = 10.0 * np.cos(angle) + 0.5 * GRAVITY
    assert held.slope == pytest.approx(10.0 * np.sin(angle) / down)
    refuse_unstable(held, heavy)


def test_a_steep_surface_lets_the_tool_slip():
    found = check_push(cube(), BASE, True, np.array([0.0, 0.0, 0.04]), tilted(0.4))
    with pytest.raises(InputError, match=r'inclined by 23 deg to the push, its friction of 0\.3'):
        refuse_unstable(found)


@given(angle=strategies.floats(0.0, 6.28), dx=strategies.floats(-0.1, 0.1))
def test_turning_and_moving_everything_changes_nothing(angle, dx):
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[cos, -sin], [sin, cos]])
    settings = PushSettings()
    contact, normal = np.array([0.01, 0.004, 0.04]), tilted(0.1)
    expected = check_push(cube(), BASE, True, contact, normal, settings)
    moved = check_push(
        cube(),
        BASE @ turn.T + dx,
        True,
        np.array([*(turn @ contact[:2] + dx), contact[2]]),
        np.array([*(turn @ normal[:2]), normal[2]]),
        settings,
    )
    # Without a mass nothing depends on where the body is.
    assert moved.base_distance == pytest.approx(expected.base_distance, abs=1e-9)
    assert moved.slope == pytest.approx(expected.slope, abs=1e-9)


def feet(angles):
    points = np.stack((0.02 * np.cos(angles), 0.02 * np.sin(angles), np.full(len(angles), 0.006)))
    return Surface(points.T, np.tile(UP, (len(angles), 1)), np.ones(len(angles)))


def test_the_base_is_where_the_object_is_low():
    base, seen = find_base(feet(np.linspace(0.0, 2.0 * np.pi, 60)), cube())
    assert seen
    assert np.hypot(*base.T) == pytest.approx(0.02)


def test_a_base_that_is_seen_from_one_side_is_the_outline():
    base, seen = find_base(feet(np.linspace(0.0, np.pi, 60)), cube())
    assert not seen
    assert np.abs(base).max() == pytest.approx(HALF - 0.001)
