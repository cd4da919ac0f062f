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

"""The range sensor driver as a process: clouds, and H through a whole push of the cell."""

from hapticvision_ros.bag.contract import (
    CONTACT_POINT,
    DISPLACEMENT_HEIGHT,
    PHASE,
    PLAN,
    POINTS,
)
from hapticvision_ros.nodes.conversions import point_from_message, xyz_from_message
import numpy as np
import pytest
from std_srvs.srv import Trigger

BLOCK_HEIGHT = 0.040
DEPTH = 0.006


@pytest.fixture
def world(start_world):
    # Slower than the real thing, so that the logic is tested and not the speed of the machine.
    return start_world('--object', 'soft_dough', '--force-rate', '200', '--arm-rate', '200')


def test_clouds_show_the_block_on_the_support_plane(world, start_node, probe, until):
    start_node(
        'range_sensor_driver',
        {'simulated_world_port': world.port, 'width': 320, 'height': 240},
    )
    heard = probe.listen(POINTS)
    until(lambda: len(heard) >= 5, 'five clouds')
    cloud = xyz_from_message(heard[-1])
    assert cloud.shape == (240, 320, 3)
    assert heard[-1].header.frame_id == 'support_plane'
    z = cloud[..., 2][np.isfinite(cloud[..., 2])]
    # The plane and the block's top are the two levels that hold most of the points.
    assert np.count_nonzero(np.abs(z) < 0.002) > 0.2 * z.size
    assert np.count_nonzero(np.abs(z - BLOCK_HEIGHT) < 0.002) > 0.1 * z.size


def test_the_dent_is_seen_before_the_push_and_after_it(world, start_node, probe, until):
    port = {'simulated_world_port': world.port}
    start_node('load_cell_driver', port)
    start_node('range_sensor_driver', {**port, 'width': 320, 'height': 240})
    start_node('contact_point_planner')
    start_node(
        'arm_push_controller',
        {
            **port,
            'push_speed': 0.01,
            'depth': DEPTH,
            'hold_time': 2.0,
            'recover_time': 2.0,
            'release_speed': 0.03,
            'stale_time': 1.0,
            'heartbeat_time': 0.0,
        },
    )
    heights, phases = probe.listen(DISPLACEMENT_HEIGHT), probe.listen(PHASE)
    points = probe.listen(CONTACT_POINT)

    def planned():
        answer = probe.call(PLAN, Trigger.Request())
        # The first clouds and heights may still be on their way; anything else is final.
        late = 'No cloud came' in answer.message or 'No tool height came' in answer.message
        assert answer.success or late, answer.message
        return answer.success

    until(planned, 'a plan', 30.0)
    until(lambda: points, 'the contact point')
    # A single view at 40 degrees: the mass centre is off by up to some millimetres.
    assert point_from_message(points[0]) == pytest.approx((0.0, 0.0, BLOCK_HEIGHT), abs=4e-3)
    until(lambda: len(heights) >= 5, 'the height before the push')
    # Median of some tens of points with 0.5 mm noise.
    assert np.abs([message.data for message in heights[:5]]).max() < 5e-4
    probe.start_push()
    until(lambda: any(message.data == 'hold' for message in phases), 'the hold', 30.0)
    held = len(heights)
    until(lambda: any(message.data == 'release' for message in phases), 'the release', 30.0)
    # Nothing is seen while the tool is down; one frame may have been on its way.
    assert len(heights) - held <= 1
    until(lambda: phases[-1].data == 'done', 'the end', 30.0)
    after_hold = held + 1
    recovery = np.array([message.data for message in heights[after_hold:]])
    assert len(recovery) >= 10
    # The dough comes back from its dent, and keeps a part of it.
    assert recovery[:3].max() < DEPTH + 5e-4
    assert recovery[:3].mean() > recovery[-3:].mean() > 1e-3
