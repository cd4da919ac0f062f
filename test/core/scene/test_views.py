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

"""Poses and pictures."""

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.scene.views import mean_cloud, Picture, Pose
from hypothesis import given, strategies
import numpy as np
import pytest

coordinates = strategies.floats(-1.0, 1.0)
quaternions = strategies.tuples(coordinates, coordinates, coordinates, coordinates).filter(
    lambda q: np.linalg.norm(q) > 0.1
)


def unit(quaternion):
    return tuple(float(item) for item in np.array(quaternion) / np.linalg.norm(quaternion))


@given(quaternions)
def test_a_quaternion_comes_back_from_its_rotation(quaternion):
    given_one = unit(quaternion)
    pose = Pose.from_quaternion((0.0, 0.0, 0.0), given_one)
    assert pose.rotation @ pose.rotation.T == pytest.approx(np.eye(3), abs=1e-12)
    assert np.linalg.det(pose.rotation) == pytest.approx(1.0)
    found = np.array(pose.quaternion)
    # q and -q are one rotation.
    found *= np.sign(found @ given_one)
    assert found == pytest.approx(np.array(given_one), abs=1e-9)


@given(quaternions, quaternions)
def test_poses_chain_and_invert(first, second):
    a = Pose.from_quaternion((0.1, -0.2, 0.3), unit(first))
    b = Pose.from_quaternion((-1.0, 0.5, 0.2), unit(second))
    point = np.array([[0.3, 0.1, -0.7]])
    assert a.after(b).apply(point) == pytest.approx(a.apply(b.apply(point)), abs=1e-12)
    assert a.inverse().apply(a.apply(point)) == pytest.approx(point, abs=1e-12)


@pytest.mark.parametrize(
    'quaternion', [(0.0, 0.0, 0.0, 0.0), (1.0, 1.0, 0.0, 0.0), (0.0, 0.0, np.nan, 1.0)]
)
def test_what_is_no_rotation_is_refused(quaternion):
    with pytest.raises(InputError, match='quaternion x, y, z, w of unit length'):
        Pose.from_quaternion((0.0, 0.0, 0.0), quaternion)


def test_a_picture_shows_what_is_before_it():
    picture = Picture(
        np.zeros((40, 60), dtype=np.uint8),
        np.array([[100.0, 0.0, 29.5], [0.0, 100.0, 19.5], [0.0, 0.0, 1.0]]),
        Pose(np.diag((1.0, -1.0, -1.0)), np.array([0.0, 0.0, 1.0])),
    )
    points = np.array([[0, 0, 0], [0.1, 0.05, 0], [0.5, 0, 0], [0, 0, 2.0]])
    places, inside = picture.project(points)
    assert inside.tolist() == [True, True, False, False]
    assert places[:2] == pytest.approx(np.array([[29.5, 19.5], [39.5, 14.5]]))


def test_the_mean_of_clouds_takes_what_each_has():
    first = np.zeros((2, 2, 3), dtype=np.float32)
    first[..., 2] = 0.5
    second = first + np.float32(0.001)
    second[0, 0] = np.nan
    second[1, 1, 2] = 0.6
    mean = mean_cloud([first, second])
    assert mean[0, 0] == pytest.approx((0.0, 0.0, 0.5))
    assert mean[0, 1] == pytest.approx((0.0005, 0.0005, 0.5005))
    # It looks past an edge, now at what is before it and now at what is behind.
    assert np.isnan(mean[1, 1]).all()
    assert mean_cloud([first]) is first


def test_clouds_without_rows_are_put_in_a_row():
    assert mean_cloud([np.zeros((4, 3), np.float32), np.zeros((5, 3), np.float32)]).shape == (9, 3)
