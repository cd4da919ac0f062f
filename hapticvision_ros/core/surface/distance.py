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
The signed distance of points from a surface of triangles.

The triangles are sorted into a grid of cells. From a point the cells are searched in shells that
grow until nothing nearer can come; the distance is then exact. The sign is that of the normal at
the nearest place, where an edge or a corner has the normal of what meets there.
"""

from dataclasses import dataclass
from typing import Final, NamedTuple

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.surface.mesh import Mesh
import numpy as np
from numpy.typing import NDArray

type IndexArray = NDArray[np.int64]

_MOST_CELLS: Final = 4_000_000


class Nearest(NamedTuple):
    """
    Where points are nearest to a surface.

    Parameters
    ----------
    distance : ndarray, shape (n,)
        Signed distance, positive outside [m].
    place : ndarray, shape (n, 3)
        The nearest place on the surface [m].
    triangle : ndarray of int, shape (n,)
        The triangle that holds it.

    """

    distance: FloatArray
    place: FloatArray
    triangle: IndexArray


@dataclass(frozen=True, slots=True)
class _Grid:
    """Triangles by cell: those of cell i are ``order[first[i]:first[i + 1]]``."""

    low: FloatArray
    cell: float
    shape: IndexArray
    first: IndexArray
    order: IndexArray


def nearest(points: FloatArray, mesh: Mesh) -> Nearest:
    """
    Return where points are nearest to a surface.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Finite points [m].
    mesh : Mesh
        The surface.

    Returns
    -------
    Nearest
        Distance, place and triangle of each point.

    """
    grid = _make_grid(mesh)
    corners = mesh.points[mesh.triangles]
    found = Nearest(
        np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), np.int64)
    )
    _search(
        np.ascontiguousarray(points, dtype=np.float64),
        np.ascontiguousarray(corners),
        mesh.normals,
        mesh.corner_normals[mesh.triangles],
        mesh.edge_normals,
        grid.low,
        grid.cell,
        grid.shape,
        grid.first,
        grid.order,
        found.distance,
        found.place,
        found.triangle,
    )
    return found


def _make_grid(mesh: Mesh) -> _Grid:
    """Return the triangles sorted into cells about as wide as they are."""
    corners = mesh.points[mesh.triangles]
    low, high = corners.min(axis=1), corners.max(axis=1)
    start = low.min(axis=0)
    span = high.max(axis=0) - start
    cell = max(mesh.spacing, float(np.cbrt(span.prod() / _MOST_CELLS)), float(span.max()) / 1000)
    cell = max(cell, 1e-12)
    shape = np.maximum(np.ceil(span / cell), 1).astype(np.int64)
    first_cell = np.minimum(((low - start) / cell).astype(np.int64), shape - 1)
    last_cell = np.minimum(((high - start) / cell).astype(np.int64), shape - 1)
    counts = np.zeros(int(shape.prod()) + 1, np.int64)
    _count(first_cell, last_cell, shape, counts)
    first = np.cumsum(counts)
    order = np.empty(int(first[-1]), np.int64)
    _fill(first_cell, last_cell, shape, first[:-1].copy(), order)
    return _Grid(start, cell, shape, first, order)


@kernel()
def _count(first_cell, last_cell, shape, counts):  # type: ignore[no-untyped-def]
    """Count the triangles of each cell, one place further on."""
    for k in range(first_cell.shape[0]):
        for i in range(first_cell[k, 0], last_cell[k, 0] + 1):
            for j in range(first_cell[k, 1], last_cell[k, 1] + 1):
                for m in range(first_cell[k, 2], last_cell[k, 2] + 1):
                    counts[(i * shape[1] + j) * shape[2] + m + 1] += 1


@kernel()
def _fill(first_cell, last_cell, shape, place, order):  # type: ignore[no-untyped-def]
    """Put the triangles into their cells."""
    for k in range(first_cell.shape[0]):
        for i in range(first_cell[k, 0], last_cell[k, 0] + 1):
            for j in range(first_cell[k, 1], last_cell[k, 1] + 1):
                for m in range(first_cell[k, 2], last_cell[k, 2] + 1):
                    cell = (i * shape[1] + j) * shape[2] + m
                    order[place[cell]] = k
                    place[cell] += 1


@kernel(inline='always', error_model='numpy')
def _dot(a, b):  # type: ignore[no-untyped-def]
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@kernel(error_model='numpy')
def _on_triangle(p, corners):  # type: ignore[no-untyped-def]
    """
    Return the weights of b and c at the place of a triangle nearest to p, and where that is.

    The region is 0 inside, 1 to 3 at the corners a, b, c, 4 to 6 on the edges ab, bc, ca.

    References
    ----------
    C. Ericson, Real-Time Collision Detection, 2005, section 5.1.5.

    """
    a = (corners[0, 0], corners[0, 1], corners[0, 2])
    ab = (corners[1, 0] - a[0], corners[1, 1] - a[1], corners[1, 2] - a[2])
    ac = (corners[2, 0] - a[0], corners[2, 1] - a[1], corners[2, 2] - a[2])
    ap = (p[0] - a[0], p[1] - a[1], p[2] - a[2])
    d1 = _dot(ab, ap)
    d2 = _dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0, 1
    d3 = d1 - _dot(ab, ab)
    d4 = d2 - _dot(ab, ac)
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0, 2
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0, 4
    d5 = d1 - _dot(ab, ac)
    d6 = d2 - _dot(ac, ac)
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0, 3
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6), 6
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w, 5
    total = va + vb + vc
    if total <= 0.0:
        # A triangle without area: its corner will do, its neighbours hold the rest.
        return 0.0, 0.0, 1
    return vb / total, vc / total, 0


@kernel(error_model='numpy')
def _search(  # type: ignore[no-untyped-def]
    points,
    corners,
    face_normals,
    corner_normals,
    edge_normals,
    low,
    cell,
    shape,
    first,
    order,
    distance,
    place,
    triangle,
):
    """Find for each point the nearest place of the triangles."""
    most = max(shape[0], shape[1], shape[2])
    home = np.empty(3, np.int64)
    at = np.empty(3)
    for n in range(points.shape[0]):
        p = points[n]
        for axis in range(3):
            home[axis] = min(max(int((p[axis] - low[axis]) / cell), 0), shape[axis] - 1)
        best = np.inf
        for ring in range(most + 1):
            # What is not in the cells searched so far is at least this far off.
            if best <= max(ring - 1, 0) * cell and ring > 0:
                break
            for i in range(max(home[0] - ring, 0), min(home[0] + ring, shape[0] - 1) + 1):
                face_i = abs(i - home[0]) == ring
                for j in range(max(home[1] - ring, 0), min(home[1] + ring, shape[1] - 1) + 1):
                    face_j = face_i or abs(j - home[1]) == ring
                    step = 1 if face_j or ring == 0 else 2 * ring
                    for m in range(home[2] - ring, home[2] + ring + 1, step):
                        if m < 0 or m >= shape[2]:
                            continue
                        c = (i * shape[1] + j) * shape[2] + m
                        for k in range(first[c], first[c + 1]):
                            t = order[k]
                            v, w, region = _on_triangle(p, corners[t])
                            squared = 0.0
                            for axis in range(3):
                                a = corners[t, 0, axis]
                                at[axis] = a + v * (corners[t, 1, axis] - a)
                                at[axis] += w * (corners[t, 2, axis] - a)
                                squared += (p[axis] - at[axis]) ** 2
                            away = np.sqrt(squared)
                            if away < best:
                                best = away
                                triangle[n] = t
                                side = 0.0
                                for axis in range(3):
                                    place[n, axis] = at[axis]
                                    if region == 0:
                                        normal = face_normals[t, axis]
                                    elif region <= 3:
                                        normal = corner_normals[t, region - 1, axis]
                                    else:
                                        normal = edge_normals[t, region - 4, axis]
                                    side += (p[axis] - at[axis]) * normal
                                distance[n] = away if side >= 0.0 else -away
