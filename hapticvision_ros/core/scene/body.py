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
The object as a map of heights over the support plane: its top view, volume and centre of gravity.

A map of heights knows no overhang: what lies under one counts as full.
"""

from dataclasses import dataclass, replace
from typing import Final

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.surface import Surface
import numpy as np
from numpy.typing import NDArray

_LOW_EDGE: Final = 5.0
"""In cells: the object's edge is low if its surface is no higher there."""
_SPARSE: Final = 10.0
"""Percentile of the cells that stands for the side which the fewest views show."""

type BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """
    The object in the support plane's frame.

    Parameters
    ----------
    low : tuple of float
        x and y of the map's first corner [m].
    cell : float
        Side of its cells [m].
    inside : ndarray of bool, shape (rows, columns)
        The top view; rows along y, columns along x.
    heights : ndarray, shape (rows, columns)
        Height of the surface [m], zero outside.
    seen : ndarray of bool, shape (rows, columns)
        Cells whose height was measured; the others have their nearest neighbour's.

    """

    low: tuple[float, float]
    cell: float
    inside: BoolArray
    heights: FloatArray
    seen: BoolArray

    @property
    def coverage(self) -> FloatArray:
        """Return the share of each cell that the object covers: half of those at its border."""
        padded = np.pad(self.inside, 1)
        enclosed = padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:]
        return np.where(self.inside, np.where(enclosed, 1.0, 0.5), 0.0)

    @property
    def area(self) -> float:
        """Return the area of the top view [m^2]."""
        return float(self.coverage.sum() * self.cell**2)

    @property
    def volume(self) -> float:
        """Return the volume [m^3]."""
        return float((self.coverage * self.heights).sum() * self.cell**2)

    @property
    def seen_share(self) -> float:
        """Return which share of the top view was measured."""
        return float(np.count_nonzero(self.seen) / np.count_nonzero(self.inside))

    @property
    def top_view_centre(self) -> FloatArray:
        """Return the paper's G_top, shape (2,) [m]."""
        weight = self.coverage
        return self._mean(weight)

    @property
    def centre_of_gravity(self) -> FloatArray:
        """Return the centre of gravity at constant density, shape (3,) [m]."""
        weight = self.coverage * self.heights
        height = 0.5 * float((weight * self.heights).sum() / weight.sum())
        return np.array([*self._mean(weight), height])

    def centres(self) -> tuple[FloatArray, FloatArray]:
        """Return x and y of the cells' middles [m], each of the map's shape."""
        rows, columns = self.inside.shape
        x = self.low[0] + (np.arange(columns) + 0.5) * self.cell
        y = self.low[1] + (np.arange(rows) + 0.5) * self.cell
        grid_x, grid_y = np.meshgrid(x, y)
        return grid_x, grid_y

    def with_outline(self, inside: BoolArray) -> 'Body':
        """Return the body with another outline; new cells take the nearest height."""
        seen = self.seen & inside
        return replace(self, inside=inside, seen=seen, heights=_filled(self.heights, seen, inside))

    def _mean(self, weight: FloatArray) -> FloatArray:
        x, y = self.centres()
        return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


def border_seen(body: Body, plane_points: FloatArray, reach: float) -> float:
    """
    Return the share of the outline beside which the support plane was seen.

    Where it was not, the object hides its own far side, and may go on there.

    Parameters
    ----------
    body : Body
        The object.
    plane_points : ndarray, shape (n, 3)
        Points of the support plane, in its frame [m].
    reach : float
        How near to the outline they must lie [m].

    """
    import cv2

    rows, columns = body.inside.shape
    ground = _ground_cells(plane_points, np.array(body.low), body.cell, (rows, columns))
    size = 2 * int(np.ceil(reach / body.cell)) + 1
    beside = cv2.dilate(ground.astype(np.uint8), np.ones((size, size), dtype=np.uint8)) > 0
    border = body.inside & (body.coverage < 1.0)
    return float(np.count_nonzero(border & beside) / np.count_nonzero(border))


def make_body(surface: Surface, ground: FloatArray, *, cell: float, closing_cells: int) -> Body:
    """
    Return the map of heights of an object.

    Parameters
    ----------
    surface : Surface
        The object's surface in the support plane's frame.
    ground : ndarray, shape (n, 3)
        Points of the support plane [m]. Between them and the object's lies its outline: half way,
        where sparse returns leave a gap.
    cell : float
        Side of the map's cells [m], not smaller than the distance of the points.
    closing_cells : int
        Gaps of up to this many cells are closed.

    Returns
    -------
    Body
        The map.

    """
    import cv2
    from scipy.ndimage import distance_transform_edt

    points = surface.points
    low = points[:, :2].min(axis=0) - cell * (closing_cells + 1.5)
    place = ((points[:, :2] - low) / cell).astype(np.intp)
    columns, rows = place.max(axis=0) + 2 + closing_cells
    flat = place[:, 1] * columns + place[:, 0]
    top = np.full(rows * columns, -np.inf)
    np.maximum.at(top, flat, points[:, 2])
    # A cell at a wall holds points of the whole wall; its surface is what is on top.
    upper = points[:, 2] > top[flat] - cell
    sums = np.bincount(flat[upper], points[upper, 2], minlength=top.size)
    counts = np.bincount(flat[upper], minlength=top.size)
    seen = (counts > 0).reshape(rows, columns)
    heights = (sums / np.maximum(counts, 1)).reshape(rows, columns)
    kernel = np.ones((closing_cells, closing_cells), dtype=np.uint8)
    closed = cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_CLOSE, kernel)
    beside = _ground_cells(ground, low, cell, (int(rows), int(columns)))
    if beside.any():
        to_object, nearest = distance_transform_edt(closed == 0, return_indices=True)
        to_ground = distance_transform_edt(~beside)
        returns = np.bincount(flat, surface.returns, minlength=top.size).reshape(rows, columns)
        # Where few returns lie in a cell, a gap is no wider than they are apart; a wider one, or
        # one beside a high edge, is hidden rather than sparse: nothing says that the object goes
        # on there.
        widest = 1.0 / np.sqrt(max(np.percentile(returns[closed > 0], _SPARSE), 0.25))
        nearer = (to_object <= to_ground) & (np.maximum(to_object, to_ground) <= widest)
        nearer &= heights[tuple(nearest)] < _LOW_EDGE * cell
        closed |= nearer.astype(np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(closed)
    inside = labels == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA]))
    seen &= inside
    return Body((float(low[0]), float(low[1])), cell, inside, _filled(heights, seen, inside), seen)


def _ground_cells(
    points: FloatArray, low: FloatArray, cell: float, shape: tuple[int, int]
) -> BoolArray:
    """Return the cells of a map in which the support plane was seen."""
    place = np.floor((points[:, :2] - low) / cell).astype(np.intp)
    place = place[np.all((place >= 0) & (place < shape[::-1]), axis=1)]
    cells = np.zeros(shape, dtype=bool)
    cells[place[:, 1], place[:, 0]] = True
    return cells


def _filled(heights: FloatArray, seen: BoolArray, inside: BoolArray) -> FloatArray:
    """Return the heights with those not seen taken from the nearest that are; zero outside."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~seen, return_distances=False, return_indices=True)
    return np.where(inside, heights[tuple(nearest)], 0.0)
