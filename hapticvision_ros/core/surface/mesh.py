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

"""A surface of triangles, and the files that other programs open: PLY and VTK."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

type TriangleArray = NDArray[np.integer]
type ColourArray = NDArray[np.uint8]

_VTK_TRIANGLE: Final = 5
_PLY_TYPES: Final = {'f': 'float', 'u': 'uchar'}


@dataclass(frozen=True)
class Mesh:
    """
    Triangles, counterclockwise when seen from outside.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Corners [m].
    triangles : ndarray of int, shape (m, 3)
        Rows of `points`.

    Raises
    ------
    InputError
        If there is no triangle, a corner is not finite or a triangle names none.

    """

    points: FloatArray
    triangles: TriangleArray

    def __post_init__(self) -> None:
        points, triangles = self.points, self.triangles
        if points.ndim != 2 or points.shape[1] != 3 or not np.isfinite(points).all():
            raise InputError('the points of a mesh are rows of three finite numbers')
        if triangles.ndim != 2 or triangles.shape[1] != 3 or not len(triangles):
            raise InputError('a mesh has at least one triangle, a row of three corners')
        if triangles.min() < 0 or triangles.max() >= len(points):
            raise InputError('a triangle of the mesh has a corner that is not there')

    @cached_property
    def _area_vectors(self) -> FloatArray:
        """Return the normals of the triangles times their areas, shape (m, 3) [m^2]."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return np.asarray(0.5 * np.cross(b - a, c - a), dtype=np.float64)

    @cached_property
    def areas(self) -> FloatArray:
        """Return the areas of the triangles, shape (m,) [m^2]."""
        return np.asarray(np.linalg.norm(self._area_vectors, axis=1), dtype=np.float64)

    @cached_property
    def normals(self) -> FloatArray:
        """Return the unit normals of the triangles, shape (m, 3); zero for one without area."""
        return self._area_vectors / np.maximum(self.areas, 1e-300)[:, None]

    @cached_property
    def centres(self) -> FloatArray:
        """Return the middles of the triangles, shape (m, 3) [m]."""
        return np.asarray(self.points[self.triangles].mean(axis=1), dtype=np.float64)

    @cached_property
    def volume(self) -> float:
        """Return the volume that a closed mesh encloses [m^3]."""
        # From the middle of the mesh, so that little is left over from a small gap.
        away = self.centres - self.points.mean(axis=0)
        return float(np.sum(away * self._area_vectors) / 3.0)

    @cached_property
    def spacing(self) -> float:
        """Return the median length of an edge [m]."""
        a, b, c = (self.points[self.triangles[:, k]] for k in range(3))
        return float(np.median(np.linalg.norm(np.concatenate((b - a, c - b, a - c)), axis=1)))

    @cached_property
    def corner_normals(self) -> FloatArray:
        """
        Return the normals at the corners, weighted by the angles there, shape (n, 3).

        References
        ----------
        J. A. Baerentzen and H. Aanaes, IEEE Trans. Vis. Comput. Graph. 11, 2005, 243-253,
        doi:10.1109/TVCG.2005.49: with these the sign of a distance is right at corners too.

        """
        total = np.zeros_like(self.points)
        for k in range(3):
            here, ahead, behind = (
                self.points[self.triangles[:, (k + shift) % 3]] for shift in range(3)
            )
            one, two = ahead - here, behind - here
            lengths = np.linalg.norm(one, axis=1) * np.linalg.norm(two, axis=1)
            cosine = np.sum(one * two, axis=1) / np.maximum(lengths, 1e-300)
            angle = np.arccos(np.clip(cosine, -1.0, 1.0))
            for axis in range(3):
                total[:, axis] += np.bincount(
                    self.triangles[:, k], angle * self.normals[:, axis], minlength=len(total)
                )
        length = np.linalg.norm(total, axis=1)
        return np.asarray(total / np.maximum(length, 1e-300)[:, None], dtype=np.float64)

    @cached_property
    def edge_normals(self) -> FloatArray:
        """Return the normals at the edges ab, bc, ca of each triangle, shape (m, 3, 3)."""
        corners = np.stack((self.triangles, np.roll(self.triangles, -1, axis=1)), axis=2)
        corners = np.sort(corners.reshape(-1, 2), axis=1).astype(np.int64)
        key = corners[:, 0] * len(self.points) + corners[:, 1]
        _, edge = np.unique(key, return_inverse=True)
        normals = np.repeat(self.normals, 3, axis=0)
        total = np.stack([np.bincount(edge, normals[:, axis]) for axis in range(3)], axis=1)
        return np.asarray(total[edge].reshape(-1, 3, 3), dtype=np.float64)


def ply(
    points: FloatArray,
    triangles: TriangleArray | None = None,
    *,
    colours: ColourArray | None = None,
    quantities: Mapping[str, FloatArray] | None = None,
    comment: str = '',
) -> bytes:
    """
    Return a PLY file (binary, little-endian), in metres.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Corners of a mesh, or points of a cloud [m].
    triangles : ndarray of int, shape (m, 3), optional
        Without them it is a cloud.
    colours : ndarray of uint8, shape (n, 3), optional
        Red, green and blue of each point.
    quantities : mapping of str to ndarray of shape (n,), optional
        Further numbers of each point, by a name without spaces.
    comment : str
        One line.

    Returns
    -------
    bytes
        The file's content.

    References
    ----------
    G. Turk, The PLY Polygon File Format, Stanford University, 1994.

    """
    columns: list[tuple[str, str, NDArray[np.float64] | ColourArray]] = [
        (name, '<f4', points[:, axis]) for axis, name in enumerate('xyz')
    ]
    if colours is not None:
        columns += [
            (name, 'u1', colours[:, axis]) for axis, name in enumerate(('red', 'green', 'blue'))
        ]
    columns += [(name, '<f4', values) for name, values in (quantities or {}).items()]
    rows = np.empty(len(points), [(name, code) for name, code, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    header = ['ply', 'format binary_little_endian 1.0']
    if comment:
        header.append(f'comment {" ".join(comment.split())}')
    header.append(f'element vertex {len(points)}')
    header += [f'property {_PLY_TYPES[code.lstrip("<")[0]]} {name}' for name, code, _ in columns]
    faces = b''
    if triangles is not None:
        header += [f'element face {len(triangles)}', 'property list uchar int vertex_indices']
        records = np.empty(len(triangles), [('count', 'u1'), ('corners', '<i4', 3)])
        records['count'], records['corners'] = 3, triangles
        faces = records.tobytes()
    text = '\n'.join([*header, 'end_header', ''])
    return text.encode('ascii', 'replace') + rows.tobytes() + faces


def vtk(
    points: FloatArray,
    triangles: TriangleArray,
    quantities: Mapping[str, FloatArray] | None = None,
    *,
    title: str = 'hapticvision',
) -> bytes:
    """
    Return a legacy VTK file (binary), in metres.

    The triangles stand in an unstructured grid: of the legacy kinds that is what most read.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Corners [m].
    triangles : ndarray of int, shape (m, 3)
        Rows of `points`.
    quantities : mapping of str to ndarray of shape (n,) or (n, 3), optional
        Numbers or vectors of each corner, by a name without spaces.
    title : str
        One line of up to 255 characters.

    Returns
    -------
    bytes
        The file's content.

    References
    ----------
    W. Schroeder, K. Martin and B. Lorensen, The Visualization Toolkit, 4th ed., 2006, ch. 19 (VTK
    File Formats: simple legacy formats).

    """
    line = ' '.join(title.split())[:255]
    count, faces = len(points), len(triangles)
    cells = np.empty((faces, 4), '>i4')
    cells[:, 0], cells[:, 1:] = 3, triangles
    parts: list[str | bytes] = [
        f'# vtk DataFile Version 3.0\n{line}\nBINARY\nDATASET UNSTRUCTURED_GRID\n'
        f'POINTS {count} float\n',
        points.astype('>f4').tobytes(),
        f'\nCELLS {faces} {4 * faces}\n',
        cells.tobytes(),
        f'\nCELL_TYPES {faces}\n',
        np.full(faces, _VTK_TRIANGLE, '>i4').tobytes(),
        '\n',
    ]
    if quantities:
        parts.append(f'POINT_DATA {count}\n')
    for name, values in (quantities or {}).items():
        if values.ndim == 2:
            parts.append(f'VECTORS {name} float\n')
        else:
            parts.append(f'SCALARS {name} float 1\nLOOKUP_TABLE default\n')
        parts += [values.astype('>f4').tobytes(), '\n']
    return b''.join(
        part.encode('ascii', 'replace') if isinstance(part, str) else part for part in parts
    )
