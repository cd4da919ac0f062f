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

"""Clouds and depth images in the frame of the support plane."""

import cv2
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.devices.mounting import Pose, rotation_from_rpy
from hapticvision_ros.devices.range_frames import (
    Camera,
    CloudMover,
    Deprojector,
    depth_view,
    rays_of,
    share_of_returns,
)
import numpy as np
import pytest

CAMERA = Camera(64, 48, (60.0, 61.0, 31.2, 24.1))
# Half a metre above the plane, looking straight down: z forward becomes -z.
DOWN = Pose.of([0.1, -0.2, 0.5, np.pi, 0.0, 0.0])


def test_fixed_axis_angles_turn_as_rep_103_says():
    assert rotation_from_rpy(np.pi / 2, 0.0, 0.0) @ [0, 1, 0] == pytest.approx([0, 0, 1])
    assert rotation_from_rpy(0.0, np.pi / 2, 0.0) @ [0, 0, 1] == pytest.approx([1, 0, 0])
    assert rotation_from_rpy(0.0, 0.0, np.pi / 2) @ [1, 0, 0] == pytest.approx([0, 1, 0])
    rotation = rotation_from_rpy(0.3, -0.4, 1.2)
    assert rotation @ rotation.T == pytest.approx(np.eye(3))
    # Roll first, yaw last, all about fixed axes.
    steps = [rotation_from_rpy(*angles) for angles in ((0.3, 0, 0), (0, -0.4, 0), (0, 0, 1.2))]
    assert rotation == pytest.approx(steps[2] @ steps[1] @ steps[0])


@pytest.mark.parametrize(('dtype', 'unit'), [(np.uint16, 0.001), (np.float32, 1.0)])
def test_a_plane_seen_from_above_lies_at_its_height(dtype, unit):
    depth = np.full((48, 64), 0.42 / unit).astype(dtype)
    points = Deprojector(CAMERA, DOWN, 0.1, 2.0).points(depth)
    assert points.dtype == np.float32
    assert points[..., 2] == pytest.approx(0.08, abs=1e-6)
    v, u = 7, 50
    x = 0.1 + 0.42 * (u - 31.2) / 60.0
    y = -0.2 - 0.42 * (v - 24.1) / 61.0
    assert points[v, u, :2] == pytest.approx([x, y], abs=1e-6)


def test_no_return_is_nan():
    depth = np.full((48, 64), 0.42, np.float32)
    depth[0, :5] = [0.0, np.nan, np.inf, 0.01, 5.0]
    points = Deprojector(CAMERA, DOWN, 0.1, 2.0).points(depth)
    assert np.isnan(points[0, :5]).all()
    assert np.isfinite(points[0, 5:]).all()
    assert share_of_returns(points) == pytest.approx(1.0 - 5 / depth.size)
    zeros = Deprojector(CAMERA, DOWN, 0.0, 2.0).points(np.zeros((48, 64), np.uint16))
    # Zero is no return in REP-118, also where nothing is too near.
    assert np.isnan(zeros).all()


def test_a_distorted_lens_is_straightened():
    bent = Camera(64, 48, (60.0, 61.0, 31.2, 24.1), 'plumb_bob', (-0.2, 0.05, 1e-3, -1e-3, 0.0))
    rays = rays_of(bent).reshape(-1, 3).astype(np.float64)
    matrix = np.array([[60.0, 0.0, 31.2], [0.0, 61.0, 24.1], [0.0, 0.0, 1.0]])
    pixels, _ = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), matrix, np.array(bent.distortion)
    )
    u, v = np.meshgrid(np.arange(64.0), np.arange(48.0))
    # OpenCV inverts the distortion step by step; what is left is a part of a pixel.
    assert pixels.reshape(48, 64, 2) == pytest.approx(np.stack([u, v], axis=-1), abs=0.05)


@pytest.mark.parametrize('is_bigendian', [False, True])
@pytest.mark.parametrize('encoding', ['16UC1', '32FC1'])
def test_the_bytes_of_an_image_are_its_depths(encoding, is_bigendian):
    code = {'16UC1': 'u2', '32FC1': 'f4'}[encoding]
    depth = np.arange(12).reshape(3, 4).astype(('>' if is_bigendian else '<') + code)
    row = depth.itemsize * 4
    padded = b''.join(line.tobytes() + b'\xff\xff\xff' for line in depth)
    seen = depth_view(
        padded, encoding=encoding, width=4, height=3, step=row + 3, is_bigendian=is_bigendian
    )
    assert seen.tolist() == depth.tolist()
    assert seen.dtype.isnative


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'encoding': 'rgb8'}, "encoded as 'rgb8'"),
        ({'step': 3}, 'was cut off'),
        ({'height': 4}, 'was cut off'),
        ({'width': 0}, 'was cut off'),
    ],
)
def test_an_image_that_cannot_be_read_is_told(change, sentence):
    good = {'encoding': '16UC1', 'width': 4, 'height': 3, 'step': 8, 'is_bigendian': False}
    with pytest.raises(InputError, match=sentence):
        depth_view(bytes(24), **(good | change))


def test_what_does_not_belong_together_is_told():
    with pytest.raises(InputError, match='belong to different streams'):
        Deprojector(CAMERA, DOWN, 0.1, 2.0).points(np.zeros((10, 10), np.uint16))
    with pytest.raises(InputError, match='is not calibrated'):
        Camera(64, 48, (0.0, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match='distortion model'):
        Camera(64, 48, (60.0, 60.0, 32.0, 24.0), 'equidistant', (0.1, 0.0, 0.0, 0.0))
    with pytest.raises(InputError, match='has 3 coefficients'):
        Camera(64, 48, (60.0, 60.0, 32.0, 24.0), 'plumb_bob', (0.1, 0.0, 0.0))
    with pytest.raises(InputError, match='no number'):
        Camera(64, 48, (60.0, 60.0, float('nan'), 24.0))
    with pytest.raises(InputError, match='no number'):
        Camera(64, 48, (60.0, 60.0, 32.0, 24.0), 'plumb_bob', (float('nan'),) * 5)


def test_a_cloud_is_moved_and_what_is_no_return_becomes_nan():
    random = np.random.default_rng(0)
    xyz = random.uniform(-0.3, 0.3, (20, 30, 3)).astype(np.float32) + np.float32([0, 0, 0.6])
    pose = Pose.of([0.1, 0.2, 0.9, 2.2, 0.1, -0.5])
    xyz[0, 0] = np.nan
    xyz[0, 1, 1] = np.inf
    xyz[0, 2] = [0.0, 0.0, -np.inf]
    xyz[0, 3] = 0.0
    xyz[0, 4] = 1e30
    moved = CloudMover(pose, 0.05, 2.0).points(xyz)
    assert np.isnan(moved[0, :5]).all()
    true = xyz.astype(np.float64) @ pose.rotation.T + pose.translation
    assert moved[1:] == pytest.approx(true[1:], abs=1e-6)


def test_a_cloud_that_is_in_the_planes_frame_keeps_what_is_about_its_origin():
    xyz = np.random.default_rng(0).uniform(-0.04, 0.04, (20, 30, 3)).astype(np.float32)
    xyz[0, 0] = 0.0
    xyz[0, 1] = [0.0, 3.0, 0.0]
    xyz[0, 2] = np.inf
    kept = CloudMover(Pose.of([0.0] * 6), 0.05, 2.0).points(xyz)
    assert np.isnan(kept[0, :3]).all()
    np.testing.assert_array_equal(kept[0, 3:], xyz[0, 3:])
    np.testing.assert_array_equal(kept[1:], xyz[1:])
