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

"""Frames that hang together."""

from hapticvision_ros.core.scene.frames import FrameTree
from hapticvision_ros.core.scene.views import Pose
import numpy as np
import pytest

S = 1_000_000_000


def at(x, y=0.0, z=0.0):
    return Pose(np.eye(3), np.array([x, y, z]))


@pytest.fixture
def tree():
    tree = FrameTree()
    tree.put('world', 'base_link', at(1.0), None)
    tree.put('world', '/support_plane', at(1.5, 0.0, 0.7), None)
    for k in range(10):
        tree.put('base_link', 'tool0', at(0.0, 0.1 * k), k * S)
    quarter = Pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.zeros(3))
    tree.put('tool0', 'camera', quarter, None)
    return tree


def test_a_sensor_on_the_wrist_is_found_over_the_common_frame(tree):
    pose = tree.pose('camera', 'support_plane', 3 * S + 5, S // 10)
    assert pose.translation == pytest.approx((-0.5, 0.3, -0.7))
    assert pose.apply(np.array([1.0, 0.0, 0.0])) == pytest.approx((-0.5, 1.3, -0.7))


def test_a_pose_of_another_time_is_none(tree):
    assert tree.pose('camera', 'support_plane', 12 * S, S) is None
    assert tree.pose('base_link', 'support_plane', 12 * S, 0) is not None


def test_a_frame_that_hangs_nowhere_has_no_pose(tree):
    assert tree.pose('camera_2', 'support_plane', 0, S) is None


def test_a_frame_is_where_it_is_in_itself(tree):
    assert tree.pose('lens', '/lens', 0, 0).translation == pytest.approx(np.zeros(3))


def test_a_ring_of_frames_ends():
    tree = FrameTree()
    tree.put('a', 'b', at(1.0), None)
    tree.put('b', 'a', at(1.0), None)
    assert tree.pose('a', 'c', 0, 0) is None
