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

"""Views of known solids, by a ray caster that shares nothing with what is tested."""

from collections.abc import Callable, Sequence

from hapticvision_ros.core.scene.views import Pose, View
from hapticvision_ros.sim.shapes import Camera, Solid, take
import numpy as np
import pytest

SMALL = {'width': 240, 'height': 180}
ABOVE = Camera(0.3, np.deg2rad(88.0), **SMALL)
"""Not from the zenith: there an azimuth is none."""
AROUND = tuple(Camera(np.deg2rad(a), np.deg2rad(40.0), **SMALL) for a in (45, 135, 225, 315))


def turn(vector: Sequence[float]) -> Pose:
    """Return the rotation by a rotation vector [rad], as a pose at the origin."""
    angle = float(np.linalg.norm(vector))
    half = np.sin(0.5 * angle) / max(angle, 1e-12) * np.asarray(vector)
    return Pose.from_quaternion((0.0, 0.0, 0.0), (*half, np.cos(0.5 * angle)))


def pose_of(camera: Camera) -> Pose:
    """Return where a camera truly is."""
    return Pose(camera.rotation, camera.translation)


def look(
    solids: Sequence[Solid],
    cameras: Sequence[Camera],
    *,
    shift: float = 0.0,
    angle: float = 0.0,
    seed: int = 0,
    **noise: float,
) -> list[View]:
    """Return views whose poses are known with errors `shift` [m] and `angle` [rad]."""
    random = np.random.default_rng(seed)
    views = []
    for number, camera in enumerate(cameras):
        shot = take(camera, solids, seed=100 * seed + number, **noise)
        turned = turn(random.normal(0.0, angle / np.sqrt(3.0), 3))
        target = np.array(camera.target)
        moved = target - turned.rotation @ target + random.normal(0.0, shift / np.sqrt(3.0), 3)
        pose = Pose(turned.rotation, moved).after(pose_of(camera))
        views.append(View(shot.xyz, pose, f'from {np.rad2deg(camera.azimuth):.0f} deg'))
    return views


@pytest.fixture(name='look')
def _look() -> Callable[..., list[View]]:
    return look


@pytest.fixture(name='pose_of')
def _pose_of() -> Callable[[Camera], Pose]:
    return pose_of


@pytest.fixture(name='turn')
def _turn() -> Callable[..., Pose]:
    return turn


@pytest.fixture
def above() -> Camera:
    """Return a camera over the object."""
    return ABOVE


@pytest.fixture
def around() -> tuple[Camera, ...]:
    """Return four cameras around the object."""
    return AROUND
