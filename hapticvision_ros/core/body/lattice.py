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
A body as a lattice: nodes on a cubic grid, cells between them, links along and across the cells.

Each cell joins its eight nodes by twelve edges, twelve face diagonals and four body diagonals with
the weights 1/4, 1/4 and 3/16, so that an edge, a face diagonal and a body diagonal inside the body
weigh 1, 1/2 and 3/16: an isotropic solid with Poisson's ratio 1/4 and Young's modulus 1.875 k/a.

References
----------
D. C. Wallace, Thermodynamics of Crystals, 1972, ch. 2 (elasticity of a crystal of central forces).

"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

type IndexArray = NDArray[np.intp]
type BoolArray = NDArray[np.bool_]

DIRECTIONS: Final = np.array(
    [
        [1, 0, 0],
        [0, 1, 0],
        [0, 0, 1],
        [1, 1, 0],
        [-1, 1, 0],
        [1, 0, 1],
        [-1, 0, 1],
        [0, 1, 1],
        [0, -1, 1],
        [1, 1, 1],
        [-1, 1, 1],
        [1, -1, 1],
        [-1, -1, 1],
    ],
    dtype=np.intp,
)
"""From a node to the 13 neighbours that follow it in the order of the grid, x fastest."""

CORNERS: Final = np.array(
    [[i & 1, i >> 1 & 1, i >> 2 & 1] for i in range(8)],
    dtype=np.intp,
)
"""The corners of a cell, in the order in which `Lattice.cells` names them."""

_CELL_WEIGHTS: Final = {1: 1.0 / 4.0, 2: 1.0 / 4.0, 3: 3.0 / 16.0}
"""What a cell adds to the weight of an edge, a face diagonal, a body diagonal."""
_FACES: Final = (
    # Corners of the six faces, counterclockwise as seen from outside.
    ((-1, 0, 0), (0, 4, 6, 2)),
    ((1, 0, 0), (1, 3, 7, 5)),
    ((0, -1, 0), (0, 1, 5, 4)),
    ((0, 1, 0), (2, 6, 7, 3)),
    ((0, 0, -1), (0, 2, 3, 1)),
    ((0, 0, 1), (4, 5, 7, 6)),
)
_UP: Final = 0.5
_DOWN: Final = 0.75
"""How far the nodes on top are moved to the measured height, over the pitch."""
_MOST_NODES: Final = 2_000_000
_REFINED: Final = 3
"""Voxels in a cell, along each axis, in which a cloud is set out."""


@dataclass(frozen=True, eq=False)
class Lattice:
    """
    A body at rest.

    Parameters
    ----------
    pitch : float
        Side of a cell [m].
    low : ndarray, shape (3,)
        Where the grid's first node is [m].
    full : ndarray of bool, shape (cx, cy, cz)
        Which cells belong to the body.
    lift : ndarray, shape (cx + 1, cy + 1), optional
        How far the uppermost node of each column is above its place in the grid [m]: the measured
        height of the surface.

    Raises
    ------
    InputError
        If no cell is full.

    """

    pitch: float
    low: FloatArray
    full: BoolArray
    lift: FloatArray | None = None

    def __post_init__(self) -> None:
        if not self.full.any():
            raise InputError(
                f'the body is thinner than a cell of {1e3 * self.pitch:g} mm: choose smaller ones'
            )

    @property
    def shape(self) -> tuple[int, int, int]:
        """Return the nodes of the grid along x, y and z."""
        x, y, z = self.full.shape
        return x + 1, y + 1, z + 1

    @cached_property
    def grid(self) -> IndexArray:
        """Return the places in the grid, x fastest, of the n nodes of the body."""
        used = np.zeros(self.shape, dtype=bool)
        for corner in CORNERS:
            used[_shifted(corner, self.full.shape)] |= self.full
        return np.asarray(np.flatnonzero(used.ravel(order='F')), dtype=np.intp)

    @cached_property
    def node(self) -> IndexArray:
        """Return the node at each place of the grid, -1 where there is none."""
        node = np.full(int(np.prod(self.shape)), -1, dtype=np.intp)
        node[self.grid] = np.arange(self.grid.size)
        return node

    @cached_property
    def places(self) -> IndexArray:
        """Return the indices along x, y and z of the nodes, shape (n, 3)."""
        return np.stack(np.unravel_index(self.grid, self.shape, order='F'), axis=1)

    @cached_property
    def points(self) -> FloatArray:
        """Return the positions of the nodes at rest, shape (n, 3) [m]."""
        points = self.low + self.pitch * self.places
        if self.lift is not None:
            top = self.node.reshape(self.shape, order='F').copy()
            level = np.where(top >= 0, np.arange(self.shape[2]), -1).max(axis=2)
            x, y = np.nonzero(level >= 0)
            points[top[x, y, level[x, y]], 2] += self.lift[x, y]
        return points

    @cached_property
    def cells(self) -> IndexArray:
        """Return the nodes of the c cells, shape (c, 8), in the order of `CORNERS`."""
        first = np.argwhere(self.full)
        place = (first[:, None] + CORNERS).reshape(-1, 3).T
        flat = np.ravel_multi_index(tuple(place), self.shape, order='F')
        return np.asarray(self.node[flat].reshape(-1, 8))

    @cached_property
    def weights_of_links(self) -> FloatArray:
        """Return the weight of each link, shape (13, places): zero where there is none."""
        weights = np.zeros((len(DIRECTIONS), *self.shape))
        for k, direction in enumerate(DIRECTIONS):
            part = _CELL_WEIGHTS[int(np.abs(direction).sum())]
            for corner in CORNERS:
                other = corner + direction
                if ((other >= 0) & (other <= 1)).all():
                    weights[k][_shifted(corner, self.full.shape)] += part * self.full
        return np.stack([w.ravel(order='F') for w in weights])

    @cached_property
    def _triangles(self) -> IndexArray:
        """Return the surface in terms of the body's nodes, shape (m, 3)."""
        padded = np.pad(self.full, 1)
        first = np.argwhere(self.full)
        triangles = []
        for outward, corners in _FACES:
            beside = first + outward + 1
            bare = ~padded[tuple(beside.T)]
            a, b, c, d = self.cells[bare][:, corners].T
            triangles += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
        return np.concatenate(triangles)

    @cached_property
    def surface(self) -> tuple[IndexArray, IndexArray]:
        """
        Return the surface.

        Returns
        -------
        nodes : ndarray of int, shape (s,)
            Nodes of the body on it.
        triangles : ndarray of int, shape (m, 3)
            Indices into `nodes`, counterclockwise as seen from outside.

        """
        nodes, triangles = np.unique(self._triangles, return_inverse=True)
        return nodes, triangles.reshape(-1, 3).astype(np.intp)

    def volume(self, points: FloatArray) -> float:
        """Return the volume within the surface for positions of the n nodes [m^3]."""
        a, b, c = (points[self._triangles[:, i]] for i in range(3))
        return float(np.einsum('ij,ij->', a, np.cross(b, c)) / 6.0)

    def weights(self, points: FloatArray) -> tuple[IndexArray, FloatArray]:
        """
        Return how points move with the nodes of their cell, or of the nearest.

        Parameters
        ----------
        points : ndarray, shape (m, 3)
            Points of the body at rest [m]; those just outside go with the cell beside them.

        Returns
        -------
        nodes : ndarray of int, shape (m, 8)
        weights : ndarray, shape (m, 8)
            They sum to one and reproduce a linear motion.

        """
        from scipy.ndimage import distance_transform_edt

        scaled = (points - self.low) / self.pitch
        cell = np.clip(np.floor(scaled).astype(np.intp), 0, np.array(self.full.shape) - 1)
        if not self.full.all():
            nearest = distance_transform_edt(
                ~self.full, return_distances=False, return_indices=True
            )
            cell = nearest[:, cell[:, 0], cell[:, 1], cell[:, 2]].T.astype(np.intp)
        within = scaled - cell
        place = (cell[:, None] + CORNERS).reshape(-1, 3).T
        flat = np.ravel_multi_index(tuple(place), self.shape, order='F')
        factor = np.where(CORNERS[None] == 1, within[:, None], 1.0 - within[:, None])
        return self.node[flat].reshape(-1, 8), factor.prod(axis=2)


def _shifted(
    corner: IndexArray | Sequence[int], cells: tuple[int, ...]
) -> tuple[slice, slice, slice]:
    """Return the part of a grid of nodes that is a certain corner of the cells."""
    x, y, z = (slice(int(c), int(c) + n) for c, n in zip(corner, cells, strict=True))
    return x, y, z


def _check(pitch: float, size: FloatArray) -> None:
    if not 0.0 < pitch < np.inf:
        raise InputError(f'the side of a cell is above zero, not {pitch:g} m')
    nodes = float(np.prod(np.maximum(size, 0.0) / pitch + 2.0))
    if not nodes <= _MOST_NODES:
        raise InputError(
            f'cells of {1e3 * pitch:g} mm make {nodes:.3g} nodes, more than {_MOST_NODES}: '
            f'choose larger ones'
        )


def box(size: Sequence[float], pitch: float) -> Lattice:
    """
    Return a box on the support plane, its middle over the origin.

    Parameters
    ----------
    size : sequence of float, length 3
        Along x, y and z [m]; rounded to whole cells.
    pitch : float
        Side of a cell [m].

    Raises
    ------
    InputError
        If it is thinner than a cell, or there are more nodes than a machine can hold.

    """
    _check(pitch, np.array(size))
    cells = np.rint(np.array(size) / pitch).astype(int)
    low = np.array([-0.5 * pitch * cells[0], -0.5 * pitch * cells[1], 0.0])
    return Lattice(pitch, low, np.ones(np.maximum(cells, 0), dtype=bool))


def from_heights(low: Sequence[float], cell: float, heights: FloatArray, pitch: float) -> Lattice:
    """
    Return the body under a map of heights, such as `core.scene.body.Body` holds.

    Parameters
    ----------
    low : sequence of float, length 2
        x and y of the map's first corner [m].
    cell : float
        Side of the map's cells [m].
    heights : ndarray, shape (rows, columns)
        Height of the surface over the support plane [m], rows along y; zero outside.
    pitch : float
        Side of a cell of the lattice [m].

    Returns
    -------
    Lattice
        A column of cells is full as far up as its mean height, rounded; the nodes on top are then
        set to the map's own height where that is less than three quarters of a cell lower, or half
        a cell higher.

    Raises
    ------
    InputError
        If the map is empty, or as for `box`.

    """
    from scipy.ndimage import map_coordinates

    rows, columns = heights.shape
    _check(pitch, np.array([columns * cell, rows * cell, heights.max(initial=0.0)]))
    inside = heights > 0.0
    if not inside.any():
        raise InputError('a map of heights without an object: nothing is above the support plane')
    row, column = np.nonzero(inside)
    first = np.array([column.min(), row.min()])
    extent = np.array([column.max(), row.max()]) + 1 - first
    count = np.ceil(extent * cell / pitch - 1e-9).astype(int)
    # The grid is centred on the object, so that both sides are cut alike.
    origin = np.asarray(low) + cell * (first + 0.5 * extent) - 0.5 * pitch * count
    fine = max(2, int(np.ceil(pitch / cell)))
    x = origin[0] + (np.arange(count[0] * fine) + 0.5) * pitch / fine
    y = origin[1] + (np.arange(count[1] * fine) + 0.5) * pitch / fine
    column = np.floor((x - low[0]) / cell).astype(np.intp)
    row = np.floor((y - low[1]) / cell).astype(np.intp)
    within = ((row >= 0) & (row < rows))[:, None] & ((column >= 0) & (column < columns))
    taken = np.where(
        within, heights[np.clip(row, 0, rows - 1)[:, None], np.clip(column, 0, columns - 1)], 0.0
    )
    blocks = taken.T.reshape(count[0], fine, count[1], fine)
    covered = (blocks > 0.0).mean(axis=(1, 3))
    mean = blocks.sum(axis=(1, 3)) / np.maximum((blocks > 0.0).sum(axis=(1, 3)), 1)
    # A node's own height: the surface beside the outline is that of the nearest cell inside.
    levels = np.where(covered >= 0.5, np.rint(mean / pitch), 0.0).astype(int)
    full = np.arange(max(1, levels.max()))[None, None, :] < levels[:, :, None]
    node_x = origin[0] + np.arange(count[0] + 1) * pitch
    node_y = origin[1] + np.arange(count[1] + 1) * pitch
    where = np.meshgrid((node_y - low[1]) / cell - 0.5, (node_x - low[0]) / cell - 0.5)
    smooth = map_coordinates(_spread(heights, inside), where, order=1, mode='nearest')
    top = np.zeros((count[0] + 1, count[1] + 1))
    for dx in (0, 1):
        for dy in (0, 1):
            beside = slice(dx, dx + int(count[0])), slice(dy, dy + int(count[1]))
            np.maximum(top[beside], levels * pitch, out=top[beside])
    lift = np.where(top > 0.0, smooth - top, 0.0)
    lift = np.clip(lift, -_DOWN * pitch, _UP * pitch)
    return Lattice(pitch, np.array([*origin, 0.0]), full, lift)


def from_cloud(points: FloatArray, pitch: float) -> Lattice:
    """
    Return the body within a closed cloud of its surface, seen from all sides but its foot.

    Parameters
    ----------
    points : ndarray, shape (m, 3)
        Points of the surface [m], not further apart than a third of a cell; z = 0 is the support.
    pitch : float
        Side of a cell of the lattice [m].

    Returns
    -------
    Lattice
        A cell is full where the surface encloses more than half of it.

    Raises
    ------
    InputError
        If the cloud is empty, or as for `box`.

    """
    from scipy.ndimage import binary_fill_holes

    points = points[np.isfinite(points).all(axis=1)]
    if len(points) < 4:
        raise InputError(f'a body needs a closed cloud of its surface, not {len(points)} points')
    low = np.array([*points[:, :2].min(axis=0), 0.0])
    high = points.max(axis=0)
    _check(pitch, high - low)
    count = np.ceil((high - low) / pitch - 1e-9).astype(int)
    low[:2] -= 0.5 * (count[:2] * pitch - (high - low)[:2])
    size = pitch / _REFINED
    place = np.floor((points - low) / size).astype(np.intp)
    limit = count * _REFINED
    place = np.clip(place, 0, limit - 1)
    wall = np.zeros(limit, dtype=bool)
    wall[tuple(place.T)] = True
    # The foot is closed by the support, layer by layer where an overhang hides nothing.
    closed = np.pad(wall, ((1, 1), (1, 1), (1, 1)))
    closed[:, :, 0] = np.pad(binary_fill_holes(wall.any(axis=2)), 1)
    filled = binary_fill_holes(closed)[1:-1, 1:-1, 1:-1]
    share = np.where(wall, 0.5, filled.astype(float))
    blocks = share.reshape(count[0], _REFINED, count[1], _REFINED, count[2], _REFINED)
    return Lattice(pitch, low, blocks.mean(axis=(1, 3, 5)) > 0.5)


def _spread(heights: FloatArray, inside: BoolArray) -> FloatArray:
    """Return the heights with those outside taken from the nearest inside."""
    from scipy.ndimage import distance_transform_edt

    nearest = distance_transform_edt(~inside, return_distances=False, return_indices=True)
    return np.asarray(heights[tuple(nearest)], dtype=np.float64)
