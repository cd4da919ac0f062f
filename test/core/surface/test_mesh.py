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

"""Triangles: volume, normals, what stands in the files, distances, views from a side."""

import math
import struct

from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh, ply, vtk
from hapticvision_ros.core.surface.raster import (
    draw_mesh,
    draw_points,
    height_map,
    NOTHING,
    ParallelView,
)
import numpy as np
import pytest

SIZE = np.array([0.08, 0.06, 0.04])


def _box(pitch: float = 0.01) -> Mesh:
    lattice = box(SIZE, pitch)
    nodes, triangles = lattice.surface
    return Mesh(lattice.points[nodes], triangles)


def _notched() -> Mesh:
    """Return a box of 6 x 1 x 2 cells without the two upper cells in its middle."""
    lattice = box((0.06, 0.01, 0.02), 0.01)
    lattice.full[2:4, :, 1] = False
    nodes, triangles = lattice.surface
    return Mesh(lattice.points[nodes], triangles)


def _from_box(points: np.ndarray) -> np.ndarray:
    """Return the signed distance from the box, in closed form."""
    low, high = np.array([-0.04, -0.03, 0.0]), np.array([0.04, 0.03, 0.04])
    beyond = np.maximum(low - points, points - high)
    outside = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
    return np.asarray(outside + np.minimum(beyond.max(axis=1), 0.0))


def test_a_closed_mesh_has_the_volume_and_area_of_its_body() -> None:
    mesh = _box()
    assert mesh.volume == pytest.approx(SIZE.prod(), rel=1e-12)
    faces = 2.0 * (SIZE[0] * SIZE[1] + SIZE[1] * SIZE[2] + SIZE[0] * SIZE[2])
    assert mesh.areas.sum() == pytest.approx(faces, rel=1e-12)
    # Outward: away from the middle.
    assert np.all(np.sum(mesh.normals * (mesh.centres - [0.0, 0.0, 0.02]), axis=1) > 0.0)


@pytest.mark.parametrize('reach', [0.002, 0.03, 0.4])
def test_the_distance_from_a_box_is_exact(reach: float) -> None:
    random = np.random.default_rng(1)
    mesh = _box()
    spread = mesh.centres[random.integers(len(mesh.triangles), size=800)]
    points = spread + random.uniform(-reach, reach, (800, 3))
    found = nearest(points, mesh)
    np.testing.assert_allclose(found.distance, _from_box(points), rtol=0.0, atol=1e-15)
    np.testing.assert_allclose(
        np.linalg.norm(points - found.place, axis=1), np.abs(found.distance), atol=1e-15
    )


def test_the_sign_is_right_at_inner_and_outer_corners() -> None:
    mesh = _notched()
    # In the notch: beside its floor's edge, straight above its wall's edge, in its middle; then
    # inside, just below the inner edge, and outside above the outer one.
    points = np.array(
        [
            [-0.0095, 0.0, 0.0105],
            [-0.0098, 0.0, 0.0199],
            [0.0, 0.0, 0.012],
            [-0.0105, 0.0, 0.0095],
            [-0.0105, 0.0, 0.0205],
            [-0.031, -0.006, 0.021],
        ]
    )
    signs = np.sign(nearest(points, mesh).distance)
    assert signs.tolist() == [1.0, 1.0, 1.0, -1.0, 1.0, 1.0]


def test_a_mesh_that_is_none_is_refused() -> None:
    points = np.zeros((3, 3))
    for bad_points, triangles in (
        (points, np.array([[0, 1, 3]])),
        (points, np.empty((0, 3), int)),
        (np.full((3, 3), np.nan), np.array([[0, 1, 2]])),
    ):
        with pytest.raises(InputError):
            Mesh(bad_points, triangles)


def test_a_ply_file_holds_points_colours_numbers_and_triangles() -> None:
    mesh = _box(0.02)
    colours = np.arange(3 * len(mesh.points), dtype=np.uint8).reshape(-1, 3)
    error = np.linspace(-1e-3, 1e-3, len(mesh.points))
    data = ply(
        mesh.points,
        mesh.triangles,
        colours=colours,
        quantities={'distance': error},
        comment='one\nline',
    )
    header, _, body = data.partition(b'end_header\n')
    lines = header.decode('ascii').splitlines()
    assert lines[:3] == ['ply', 'format binary_little_endian 1.0', 'comment one line']
    assert f'element vertex {len(mesh.points)}' in lines
    assert f'element face {len(mesh.triangles)}' in lines
    row = struct.Struct('<3f3Bf')
    face = struct.Struct('<B3i')
    assert len(body) == row.size * len(mesh.points) + face.size * len(mesh.triangles)
    x, y, z, red, green, blue, distance = row.unpack_from(body, 5 * row.size)
    np.testing.assert_allclose((x, y, z), mesh.points[5], atol=1e-8)
    assert (red, green, blue) == tuple(colours[5])
    assert distance == pytest.approx(error[5], rel=1e-6)
    last = face.unpack_from(body, len(body) - face.size)
    assert last == (3, *mesh.triangles[-1])


def test_a_vtk_file_holds_points_triangles_and_numbers() -> None:
    mesh = _box(0.02)
    depth = np.linspace(0.0, 1.0, len(mesh.points))
    data = vtk(mesh.points, mesh.triangles, {'depth': depth, 'moved': mesh.points})
    assert data.startswith(b'# vtk DataFile Version 3.0\n')
    at = data.index(b'POINTS')
    start = data.index(b'\n', at) + 1
    stop = start + 12 * len(mesh.points)
    points = np.frombuffer(data[start:stop], '>f4').reshape(-1, 3)
    np.testing.assert_allclose(points, mesh.points, atol=1e-8)
    at = data.index(b'\nCELLS') + 1
    start = data.index(b'\n', at) + 1
    stop = start + 16 * len(mesh.triangles)
    cells = np.frombuffer(data[start:stop], '>i4').reshape(-1, 4)
    np.testing.assert_array_equal(cells[:, 1:], mesh.triangles)
    assert b'SCALARS depth float 1\nLOOKUP_TABLE default\n' in data
    assert b'VECTORS moved float\n' in data


def test_a_map_of_heights_is_the_surface_seen_from_above() -> None:
    heights = height_map(_notched(), (-0.035, -0.01), 0.001, (20, 70))
    assert np.isnan(heights[:5]).all()
    assert np.isnan(heights[:, :5]).all()
    inside = heights[5:15, 5:65]
    np.testing.assert_allclose(inside[:, 20:40], 0.01, atol=1e-12)
    np.testing.assert_allclose(inside[:, :20], 0.02, atol=1e-12)


def test_what_is_nearer_covers_what_is_behind() -> None:
    mesh = _box(0.02)
    view = ParallelView.around(mesh.points, azimuth=0.0, elevation=0.0, width=100, height=80)
    owner, _ = draw_mesh(mesh, view)
    shown = np.unique(owner[owner != NOTHING])
    # Seen from -y: nothing but that side.
    np.testing.assert_allclose(mesh.normals[shown], [[0.0, -1.0, 0.0]] * shown.size, atol=1e-12)
    assert np.count_nonzero(owner != NOTHING) == pytest.approx(
        SIZE[0] * SIZE[2] * view.scale**2, rel=0.05
    )
    # The wider way has the margin that is asked for.
    columns = np.flatnonzero((owner != NOTHING).any(axis=0))
    np.testing.assert_allclose([columns[0], 99 - columns[-1]], 6.0, atol=1.0)
    above = ParallelView.around(
        mesh.points, azimuth=0.3, elevation=0.5 * math.pi, width=100, height=80
    )
    points = np.array([[0.0, 0.0, 0.01], [0.0, 0.0, 0.03]])
    assert set(np.unique(draw_points(points, above, 3)[0])) == {NOTHING, 1}
