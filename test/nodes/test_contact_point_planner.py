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

"""The contact-point planner as a process, on clouds that the test sends."""

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    PLAN,
    POINTS,
    PUSH_DIRECTION,
    TOOL_HEIGHT,
)
from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    point_from_message,
    scalar_to_message,
    vector_from_message,
)
import numpy as np
import pytest
from std_srvs.srv import Trigger

TOP = 0.04
DEADLINE = 60.0
"""For three clouds, of which many may be lost on a loaded machine [s]."""


def top_view(*blocks, seed=0):
    """Return a cloud seen from above: the plane z = 0 and blocks (x, y, length, width)."""
    x, y = np.meshgrid(np.linspace(-0.15, 0.15, 300), np.linspace(-0.1, 0.1, 200))
    z = np.zeros_like(x)
    for cx, cy, length, width in blocks:
        z[(np.abs(x - cx) < length / 2) & (np.abs(y - cy) < width / 2)] = TOP
    z += np.random.default_rng(seed).normal(0.0, 3e-4, z.shape)
    cloud = np.stack((x, y, z), axis=-1).astype(np.float32)
    cloud[::17, ::13] = np.nan
    return cloud


@pytest.fixture
def planner(start_node):
    # Clouds of this size lose their way on a loaded machine; three of them must get through.
    return start_node('contact_point_planner', {'cloud_timeout': 20.0})


@pytest.fixture
def show(probe):
    """Send one cloud again and again, as a range sensor would, and the height of the tool."""
    timers = []

    def show(cloud, frame_id=POINTS.frame_id, tool_height=2.0 * TOP):
        publisher, arm = probe.publisher(POINTS), probe.publisher(TOOL_HEIGHT)

        def send():
            stamp = probe.node.get_clock().now().nanoseconds
            if tool_height is not None:
                arm.publish(scalar_to_message(tool_height))
            publisher.publish(cloud_to_message(RangeFrame(stamp, cloud), frame_id))

        timers.append(probe.node.create_timer(0.05, send))

    yield show
    for timer in timers:
        probe.node.destroy_timer(timer)


def test_the_contact_point_lies_on_top_of_the_mass_centre(planner, probe, show, until):
    show(top_view((0.004, -0.003, 0.08, 0.05)))
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert answer.success, answer.message
    # Asked for after the plan was made: the topics are latched.
    points, directions = probe.listen(CONTACT_POINT), probe.listen(PUSH_DIRECTION)
    until(lambda: points and directions, 'the latched plan')
    x, y, z = point_from_message(points[0])
    # Half a cell of the top-view grid is 1 mm; the height is a median of some 70 points.
    assert (x, y) == pytest.approx((0.004, -0.003), abs=1e-3)
    assert z == pytest.approx(TOP, abs=2e-4)
    assert points[0].header.frame_id == 'support_plane'
    assert vector_from_message(directions[0]) == pytest.approx((0.0, 0.0, -1.0), abs=0.002)


@pytest.mark.parametrize(
    ('blocks', 'sentence'),
    [
        ((), 'Nothing larger than'),
        (((-0.05, 0.0, 0.04, 0.04), (0.05, 0.0, 0.04, 0.04)), 'There are 2 objects'),
        (((0.05, 0.0, 0.04, 0.04),), "from the tool's axis"),
        (((-0.14, 0.0, 0.08, 0.04),), "border of the range sensor's image"),
    ],
    ids=['nothing', 'two objects', 'off the axis', 'cut off'],
)
def test_what_cannot_be_pushed_is_refused_with_the_reason(planner, probe, show, blocks, sentence):
    show(top_view(*blocks))
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert sentence in answer.message


def test_without_clouds_the_plan_is_refused_in_time(start_node, probe):
    start_node('contact_point_planner', {'cloud_timeout': 1.0})
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert 'No cloud came within 1 s' in answer.message
    # And the service still answers.
    assert 'No cloud came' in probe.call(PLAN, Trigger.Request()).message


def test_without_the_tools_height_the_tool_is_not_taken_for_the_object(start_node, probe, show):
    start_node('contact_point_planner', {'cloud_timeout': 1.0})
    show(top_view((0.0, 0.0, 0.08, 0.05)), tool_height=None)
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    # On a loaded machine the clouds may not come either.
    assert 'No tool height came within 1 s' in answer.message or 'No cloud' in answer.message


def test_clouds_in_a_foreign_frame_are_refused(planner, probe, show):
    show(top_view((0.0, 0.0, 0.08, 0.05)), frame_id='camera')
    answer = probe.call(PLAN, Trigger.Request(), DEADLINE)
    assert not answer.success
    assert "frame 'camera'" in answer.message
