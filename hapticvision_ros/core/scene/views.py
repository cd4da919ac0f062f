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

"""What is seen from one place: a cloud, or a picture, with the pose of the sensor."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """
    Where a frame is: ``p @ rotation.T + translation`` brings its points into the base frame.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
    translation : ndarray, shape (3,)
        [m]

    """

    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def identity(cls) -> 'Pose':
        """Return the pose of the base frame itself."""
        return cls(np.eye(3), np.zeros(3))

    @classmethod
    def from_quaternion(
        cls, translation: tuple[float, ...], quaternion: tuple[float, ...]
    ) -> 'Pose':
        """
        Return the pose with a translation [m] and a quaternion (x, y, z, w), as ROS has them.

        Raises
        ------
        InputError
            If a number is not finite or the quaternion is not of unit length.

        """
        values = np.array((*translation, *quaternion), dtype=np.float64)
        length = float(np.linalg.norm(values[3:]))
        if values.shape != (7,) or not np.isfinite(values).all() or abs(length - 1.0) > 1e-2:
            raise InputError(
                f'A pose of {[float(f"{item:.4g}") for item in values]} is none: give x, y, z [m] '
                'and a quaternion x, y, z, w of unit length.'
            )
        x, y, z, w = values[3:] / length
        rotation = np.array(
            [
                [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
            ]
        )
        return cls(rotation, values[:3].copy())

    @property
    def quaternion(self) -> tuple[float, float, float, float]:
        """Return the rotation as a quaternion x, y, z, w."""
        # Of the four squares the largest is at least 1/4, so that nothing small is divided by.
        r = self.rotation
        squares = 1.0 + np.array([[1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1]]) @ np.diag(r)
        rows = np.array(
            [
                [squares[0], r[1, 0] + r[0, 1], r[2, 0] + r[0, 2], r[2, 1] - r[1, 2]],
                [r[1, 0] + r[0, 1], squares[1], r[2, 1] + r[1, 2], r[0, 2] - r[2, 0]],
                [r[2, 0] + r[0, 2], r[2, 1] + r[1, 2], squares[2], r[1, 0] - r[0, 1]],
                [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], squares[3]],
            ]
        )
        found = rows[int(np.argmax(squares))]
        x, y, z, w = (float(item) for item in found / np.linalg.norm(found))
        return x, y, z, w

    def after(self, inner: 'Pose') -> 'Pose':
        """Return the pose of a frame whose pose in this one is `inner`."""
        return Pose(
            self.rotation @ inner.rotation, self.rotation @ inner.translation + self.translation
        )

    def inverse(self) -> 'Pose':
        """Return the pose of the base frame in this one."""
        return Pose(self.rotation.T, -self.rotation.T @ self.translation)

    def apply(self, points: FloatArray) -> FloatArray:
        """Return points, shape (n, 3), in the base frame."""
        return points @ self.rotation.T + self.translation


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """
    One cloud and where it was taken from.

    Parameters
    ----------
    xyz : ndarray of float32, shape (height, width, 3) or (n, 3)
        Points in the sensor's frame [m]; NaN or Inf is no return (REP-117).
    pose : Pose
        Of the sensor in the base frame, as far as it is known.
    name : str
        What the view is called in a refusal.
    levelled : bool
        Whether the points are in the support plane's frame already: the pose is then not the
        sensor's, and from where it looked is not known.

    """

    xyz: PointArray
    pose: Pose
    name: str
    levelled: bool = False


_STILL: Final = 0.005
"""A pixel that goes further to and fro [m] looks past an edge: it is left out."""


def mean_cloud(clouds: Sequence[PointArray]) -> PointArray:
    """
    Return the mean of clouds that a sensor took from one place.

    Parameters
    ----------
    clouds : sequence of ndarray of float32, each (height, width, 3) or (n, 3)
        At least one; clouds of different sizes are put in a row.

    Returns
    -------
    ndarray of float32
        Where pixels belong together, their means over the clouds that have them.

    """
    first = clouds[0]
    if len(clouds) == 1:
        return first
    if first.ndim != 3 or any(cloud.shape != first.shape for cloud in clouds):
        return np.concatenate([cloud.reshape(-1, 3) for cloud in clouds])
    total, count = np.zeros(first.shape, np.float32), np.zeros(first.shape[:2], np.float32)
    low, high = np.full(count.shape, np.inf), np.full(count.shape, -np.inf)
    for cloud in clouds:
        returned = np.isfinite(cloud).all(axis=-1)
        points = np.where(returned[..., None], cloud, 0.0)
        total += points
        count += returned
        distance = np.linalg.norm(points, axis=-1)
        low = np.minimum(low, np.where(returned, distance, np.inf))
        high = np.maximum(high, np.where(returned, distance, -np.inf))
    good = (count > 0) & ~(high - low > _STILL)
    mean: PointArray = np.where(
        good[..., None], total / np.maximum(count, 1.0)[..., None], np.float32(np.nan)
    )
    return mean


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """
    One picture of a camera without distortion, and where it was taken from.

    Parameters
    ----------
    pixels : ndarray of uint8, shape (height, width) or (height, width, 3)
        Grey or colour.
    matrix : ndarray, shape (3, 3)
        The intrinsic matrix K [pixels].
    pose : Pose
        Of the camera's optical frame in the base frame: z ahead, x right, y down (REP-103).

    """

    pixels: NDArray[np.uint8]
    matrix: FloatArray
    pose: Pose

    def project(self, points: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
        """
        Return where points of the base frame lie in the picture.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            Points [m].

        Returns
        -------
        places : ndarray, shape (n, 2)
            Column and row [pixels].
        inside : ndarray of bool, shape (n,)
            Whether they lie before the camera and within the picture.

        """
        optical = self.pose.inverse().apply(points)
        ahead = optical[:, 2] > 1e-6
        depth = np.where(ahead, optical[:, 2], 1.0)
        places = (optical @ self.matrix.T)[:, :2] / depth[:, None]
        rows, columns = self.pixels.shape[:2]
        inside = (
            ahead
            & np.all(places > -0.5, axis=1)
            & (places[:, 0] < columns - 0.5)
            & (places[:, 1] < rows - 0.5)
        )
        return places, inside
