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

"""Thinned, smoothed surfaces."""

from hapticvision_ros.core.scene.surface import make_surface, thin
import numpy as np
import pytest


def noisy_plane(noise=5e-4, seed=0, count=20000):
    random = np.random.default_rng(seed)
    points = random.uniform(-0.05, 0.05, (count, 3))
    points[:, 2] = noise * random.standard_normal(count)
    return points


def test_thinning_keeps_every_return():
    points = noisy_plane()
    means, counts = thin(points, 0.004)
    assert counts.sum() == len(points)
    assert counts @ means / len(points) == pytest.approx(points.mean(axis=0))
    assert thin(np.empty((0, 3)), 0.004)[0].shape == (0, 3)


def test_a_noisy_plane_becomes_a_smooth_one():
    surface = make_surface(noisy_plane(), voxel=0.002, viewpoint=np.array([0.0, 0.0, -1.0]))
    inner = np.abs(surface.points[:, :2]).max(axis=1) < 0.045
    # Some 8 returns a voxel, and a dozen voxels a plane: 0.5 mm / sqrt(100), and twice that.
    assert np.sqrt(np.mean(surface.points[inner, 2] ** 2)) < 1e-4
    assert np.all(surface.normals[inner, 2] < -0.98)


def test_stray_returns_are_left_out():
    points = np.concatenate((noisy_plane(), [[0.0, 0.0, 0.05], [0.02, 0.0, 0.08]]))
    surface = make_surface(points, voxel=0.002)
    assert surface.points[:, 2].max() < 0.005
    assert surface.normals[:, 2].min() > 0.0


def test_few_points_are_no_error():
    assert len(make_surface(np.zeros((3, 3)), voxel=0.002)) == 1
    assert len(make_surface(np.empty((0, 3)), voxel=0.002)) == 0
