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
Looking at triangles and points along a direction: maps of heights, and what a picture shows.

The view is parallel: no perspective. What is nearest to the viewer covers what is behind it.
"""

from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.surface.mesh import Mesh
import numpy as np
from numpy.typing import NDArray

type PixelArray = NDArray[np.int32]

NOTHING: Final = -1
"""The owner of a pixel that shows nothing."""


@dataclass(frozen=True, slots=True)
class ParallelView:
    """
    From where a picture is taken, and what of it is shown.

    Parameters
    ----------
    azimuth, elevation : float
        Where the viewer is: angle about z, counted from -y, and above the horizon [rad].
    centre : tuple of float
        What is in the middle of the picture [m].
    scale : float
        Pixels a metre.
    width, height : int
        Of the picture [pixels].

    """

    azimuth: float
    elevation: float
    centre: tuple[float, float, float]
    scale: float
    width: int
    height: int

    @property
    def toward(self) -> FloatArray:
        """Return the unit vector from the scene to the viewer, shape (3,)."""
        level = math.cos(self.elevation)
        return np.array(
            [
                level * math.sin(self.azimuth),
                -level * math.cos(self.azimuth),
                math.sin(self.elevation),
            ]
        )

    def project(self, points: FloatArray) -> FloatArray:
        """Return column, row and nearness of points, shape (..., 3) [pixels, pixels, m]."""
        toward = self.toward
        right = np.array([math.cos(self.azimuth), math.sin(self.azimuth), 0.0])
        up = np.cross(toward, right)
        away = points - np.array(self.centre)
        column = 0.5 * self.width + self.scale * (away @ right)
        row = 0.5 * self.height - self.scale * (away @ up)
        return np.stack((column, row, away @ toward), axis=-1)

    @classmethod
    def around(
        cls,
        points: FloatArray,
        *,
        azimuth: float,
        elevation: float,
        width: int,
        height: int,
        margin: float = 0.06,
    ) -> 'ParallelView':
        """Return the view from a side in which all points fit, with a margin [-] around them."""
        low, high = points.min(axis=0), points.max(axis=0)
        middle = tuple(float(item) for item in 0.5 * (low + high))
        unit = cls(azimuth, elevation, (middle[0], middle[1], middle[2]), 1.0, 0, 0)
        corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
        reach = 2.0 * np.abs(unit.project(corners)[:, :2]).max(axis=0)
        scale = min(width / max(reach[0], 1e-9), height / max(reach[1], 1e-9))
        return cls(azimuth, elevation, unit.centre, (1.0 - 2.0 * margin) * scale, width, height)


def draw_mesh(mesh: Mesh, view: ParallelView) -> tuple[PixelArray, FloatArray]:
    """
    Return which triangle each pixel shows, and how near it is.

    Parameters
    ----------
    mesh : Mesh
        The surface.
    view : ParallelView
        From where it is seen.

    Returns
    -------
    owner : ndarray of int32, shape (height, width)
        Row of the triangle; `NOTHING` where there is none.
    nearness : ndarray, shape (height, width)
        Along the direction to the viewer [m]; minus infinity where there is nothing.

    """
    owner, nearness = _blank(view)
    _triangles(np.ascontiguousarray(view.project(mesh.points)[mesh.triangles]), owner, nearness)
    return owner, nearness


def draw_points(
    points: FloatArray, view: ParallelView, size: int
) -> tuple[PixelArray, FloatArray]:
    """
    Return which point each pixel shows, points as squares.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        [m]
    view : ParallelView
        From where they are seen.
    size : int
        Side of a square [pixels].

    Returns
    -------
    owner, nearness : ndarray, shape (height, width)
        As of `draw_mesh`.

    """
    owner, nearness = _blank(view)
    _squares(np.ascontiguousarray(view.project(points)), max(size, 1), owner, nearness)
    return owner, nearness


def height_map(
    mesh: Mesh, low: tuple[float, float], cell: float, shape: tuple[int, int]
) -> FloatArray:
    """
    Return the heights of a surface seen from above, in the middles of cells.

    Parameters
    ----------
    mesh : Mesh
        The surface.
    low : tuple of float
        x and y of the map's first corner [m].
    cell : float
        Side of its cells [m].
    shape : tuple of int
        Rows along y, columns along x.

    Returns
    -------
    ndarray, shape (rows, columns)
        [m]; NaN where there is no surface.

    """
    owner = np.full(shape, NOTHING, np.int32)
    heights = np.full(shape, -np.inf)
    corners = mesh.points[mesh.triangles].copy()
    corners[:, :, 0] = (corners[:, :, 0] - low[0]) / cell
    corners[:, :, 1] = (corners[:, :, 1] - low[1]) / cell
    _triangles(corners, owner, heights)
    return np.where(owner == NOTHING, np.nan, heights)


def _blank(view: ParallelView) -> tuple[PixelArray, FloatArray]:
    shape = view.height, view.width
    return np.full(shape, NOTHING, np.int32), np.full(shape, -np.inf)


@kernel(error_model='numpy')
def _triangles(corners, owner, nearness):  # type: ignore[no-untyped-def]
    """Draw triangles of columns, rows and nearness; a pixel is looked at in its middle."""
    rows, columns = owner.shape
    for n in range(corners.shape[0]):
        x0, y0, w0 = corners[n, 0]
        x1, y1, w1 = corners[n, 1]
        x2, y2, w2 = corners[n, 2]
        area = (x1 - x0) * (y2 - y0) - (x2 - x0) * (y1 - y0)
        if area == 0.0:
            continue
        first = max(int(np.floor(min(x0, x1, x2) - 0.5)), 0)
        last = min(int(np.ceil(max(x0, x1, x2) - 0.5)), columns - 1)
        top = max(int(np.floor(min(y0, y1, y2) - 0.5)), 0)
        bottom = min(int(np.ceil(max(y0, y1, y2) - 0.5)), rows - 1)
        for row in range(top, bottom + 1):
            y = row + 0.5
            for column in range(first, last + 1):
                x = column + 0.5
                a = ((x1 - x) * (y2 - y) - (x2 - x) * (y1 - y)) / area
                b = ((x2 - x) * (y0 - y) - (x0 - x) * (y2 - y)) / area
                c = 1.0 - a - b
                if a >= -1e-12 and b >= -1e-12 and c >= -1e-12:
                    w = a * w0 + b * w1 + c * w2
                    if w > nearness[row, column]:
                        nearness[row, column] = w
                        owner[row, column] = n


@kernel()
def _squares(places, size, owner, nearness):  # type: ignore[no-untyped-def]
    """Draw points as squares."""
    rows, columns = owner.shape
    for n in range(places.shape[0]):
        left = int(np.floor(places[n, 0] - 0.5 * size + 0.5))
        top = int(np.floor(places[n, 1] - 0.5 * size + 0.5))
        for row in range(max(top, 0), min(top + size, rows)):
            for column in range(max(left, 0), min(left + size, columns)):
                if places[n, 2] > nearness[row, column]:
                    nearness[row, column] = places[n, 2]
                    owner[row, column] = n
