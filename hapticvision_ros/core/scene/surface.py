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

"""
A surface from points: thinned to one point a voxel, smoothed, with normals.

Averages over voxels alone leave a halo of stray voxels before each face; a plane through the
neighbours, weighted by how many returns stand behind them, takes these back onto the face.
"""

from dataclasses import dataclass

from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Surface:
    """
    Points of a surface.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        [m]
    normals : ndarray, shape (n, 3)
        Unit normals, on the side from which the surface was seen.
    returns : ndarray, shape (n,)
        How many returns of the sensor stand behind each point.

    """

    points: FloatArray
    normals: FloatArray
    returns: FloatArray

    def __len__(self) -> int:
        return len(self.points)

    def where(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> 'Surface':
        """Return the chosen points."""
        return Surface(self.points[chosen], self.normals[chosen], self.returns[chosen])


def thin(points: FloatArray, size: float) -> tuple[FloatArray, FloatArray]:
    """
    Return the mean of the points in each voxel, and how many they are.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        [m]
    size : float
        Side of a voxel [m].

    Returns
    -------
    means : ndarray, shape (m, 3)
    counts : ndarray, shape (m,)

    """
    if not len(points):
        return np.empty((0, 3)), np.empty(0)
    low = points.min(axis=0)
    keys = ((points - low) / size).astype(np.int64)
    spans = keys.max(axis=0) + 1
    flat = (keys[:, 0] * spans[1] + keys[:, 1]) * spans[2] + keys[:, 2]
    _, place, counts = np.unique(flat, return_inverse=True, return_counts=True)
    means = np.stack(
        [np.bincount(place, points[:, axis], minlength=counts.size) for axis in range(3)], axis=1
    )
    return means / counts[:, None], counts.astype(np.float64)


def make_surface(
    points: FloatArray,
    *,
    voxel: float,
    viewpoint: FloatArray | None = None,
    neighbours: int = 24,
) -> Surface:
    """
    Return the surface on which points lie.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Finite points [m].
    voxel : float
        Side of a voxel [m].
    viewpoint : ndarray, shape (3,), optional
        From where they were seen: the normals' side; else they point upward.
    neighbours : int
        Points that a plane is laid through.

    Returns
    -------
    Surface
        One point a voxel; those that stand alone, within three voxels, are left out.

    """
    from scipy.spatial import cKDTree

    means, counts = thin(points, voxel)
    if len(means) < 4:
        return Surface(means, np.tile([0.0, 0.0, 1.0], (len(means), 1)), counts)
    count = min(neighbours, len(means))
    tree = cKDTree(means)
    distance, index = tree.query(means, k=count, distance_upper_bound=3.0 * voxel)
    near = np.isfinite(distance)
    index = np.where(near, index, 0)
    # Close ones count most, so that an edge is rounded by less than a voxel.
    weight = np.where(
        near, counts[index] * np.exp(-0.5 * (np.where(near, distance, 0.0) / voxel) ** 2), 0.0
    )
    total = weight.sum(axis=1)
    neighbour = means[index]
    centre = np.einsum('ij,ijk->ik', weight, neighbour) / total[:, None]
    offset = neighbour - centre[:, None]
    spread = np.einsum('ij,ijk,ijl->ikl', weight, offset, offset) / total[:, None, None]
    normals = np.linalg.eigh(spread)[1][:, :, 0]
    side = np.array([0.0, 0.0, 1.0]) if viewpoint is None else viewpoint - means
    away = np.sum(normals * side, axis=1) < 0.0
    normals = np.where(away[:, None], -normals, normals)
    height = np.sum((means - centre) * normals, axis=1)
    alone = near.sum(axis=1) < 4
    return Surface(means - height[:, None] * normals, normals, counts).where(~alone)
