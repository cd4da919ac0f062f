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

"""Pictures of shapes, and the animation as other programs read it."""

import cv2
from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.surface.raster import ParallelView
from hapticvision_ros.report.shape_gif import gif
from hapticvision_ros.report.shape_picture import (
    captioned,
    colour_bar,
    coloured,
    draw,
    draw_with_tool,
    Grey,
    palette,
    png,
    ramp,
    Shape,
    tool_mesh,
)
import numpy as np
import pytest


def _block() -> Mesh:
    lattice = box((0.08, 0.06, 0.04), 0.01)
    nodes, triangles = lattice.surface
    return Mesh(lattice.points[nodes], triangles)


def _view(mesh: Mesh) -> ParallelView:
    return ParallelView.around(mesh.points, azimuth=0.4, elevation=0.6, width=120, height=90)


@pytest.mark.parametrize('kind', ['pictures', 'noise', 'one colour'])
def test_another_reader_finds_the_pictures_of_an_animation(kind: str, tmp_path) -> None:
    random = np.random.default_rng(3)
    if kind == 'noise':
        # More codes than fit: the table is begun anew.
        pictures = [random.integers(0, 256, (90, 120), dtype=np.uint8) for _ in range(2)]
    elif kind == 'one colour':
        pictures = [np.full((90, 120), 7, np.uint8) for _ in range(3)]
    else:
        mesh = _block()
        shape = Shape.of_mesh(mesh, mesh.points[:, 2])
        pictures = [
            draw_with_tool(shape, tool_mesh(0.01, tip, 0.03), _view(mesh), 0.0, 0.04)
            for tip in (0.05, 0.045, 0.045, 0.041)
        ]
    colours = palette('depth')
    path = tmp_path / 'animation.gif'
    path.write_bytes(gif(pictures, colours, 0.1))
    done, read = cv2.imreadanimation(str(path))
    assert done
    assert len(read.frames) == len(pictures)
    for picture, frame in zip(pictures, read.frames, strict=True):
        np.testing.assert_array_equal(frame[:, :, 2::-1], colours[picture])


def test_an_animation_has_a_picture() -> None:
    with pytest.raises(ValueError, match='at least one'):
        gif([], palette('depth'))


def test_colours_go_from_end_to_end() -> None:
    colours = ramp(np.array([-1.0, 0.0, 1.0, 7.0]), -1.0, 1.0, 'error').astype(int)
    assert colours[0, 2] > colours[0, 0] + 80
    assert np.ptp(colours[1]) <= 2
    assert colours[2, 0] > colours[2, 2] + 80
    assert colours[3].tolist() == colours[2].tolist()


def test_a_surface_is_drawn_where_it_is_with_its_values_between_the_corners() -> None:
    mesh = _block()
    view = _view(mesh)
    # One light for all, so that only the values differ.
    flat = Shape(
        mesh.points, np.tile(view.toward, (len(mesh.triangles), 1)), mesh.points[:, 2], mesh
    )
    picture = draw(flat, view, 0.0, 0.04)
    shown = picture != Grey.PAGE
    assert 0.2 < shown.mean() < 0.8
    middle = picture[:, 60]
    column = middle[middle != Grey.PAGE].astype(int)
    # From the top's one height down the side, ever lower: no steps of whole triangles.
    assert np.all(np.diff(column) <= 0)
    assert np.unique(column).size > 15


def test_the_tool_covers_what_is_behind_it_and_nothing_before_it() -> None:
    mesh = _block()
    view = _view(mesh)
    shape = Shape.of_mesh(mesh, mesh.points[:, 2])
    tool = range(Grey.TOOL, Grey.TOOL + 7)
    above = draw_with_tool(shape, tool_mesh(0.01, 0.041, 0.03), view, 0.0, 0.04)
    inside = draw_with_tool(shape, tool_mesh(0.01, 0.005, 0.03), view, 0.0, 0.04)
    assert np.isin(above, tool).any()
    assert not np.isin(inside, tool).any()


def test_a_png_holds_the_picture() -> None:
    mesh = _block()
    picture = coloured(
        draw(Shape.of_mesh(mesh, mesh.points[:, 2]), _view(mesh), 0.0, 0.04), 'height'
    )
    read = cv2.imdecode(np.frombuffer(png(picture), np.uint8), cv2.IMREAD_COLOR)
    np.testing.assert_array_equal(read[:, :, ::-1], picture)


def test_a_caption_stands_over_the_picture_and_can_be_read() -> None:
    plain = np.full((60, 240), 9, np.uint8)
    strips = [captioned(plain, text)[:-60] for text in ('', 'measured', 'simulated')]
    np.testing.assert_array_equal(captioned(plain, 'measured')[-60:], plain)
    assert (strips[0] == Grey.PAGE).all()
    assert not np.array_equal(strips[1], strips[2])
    dark = [palette('height')[strip].mean(axis=2) for strip in strips]
    # Letters as dark as print on a light page, and no block of ink.
    assert dark[1].max() - dark[1].min() > 120
    assert 0.01 < np.mean(dark[1] < dark[0] - 60) < 0.2


def test_a_long_caption_is_shrunk_and_not_cut() -> None:
    plain = np.full((60, 400), 9, np.uint8)
    told = 'measured - simulated: rms 10.12 mm, noise 10.15 mm, and 1.5 s after'
    for text in (told, told + ' the release'):
        columns = np.flatnonzero((captioned(plain, text)[:-60] != Grey.PAGE).any(axis=0))
        assert columns[0] >= 8
        # It fills the line, and ends before the picture does.
        assert 360 < columns[-1] <= 393
    # What is short enough is as large as ever.
    wide = np.full((60, 800), 9, np.uint8)
    np.testing.assert_array_equal(
        captioned(plain, 'measured')[:-60], captioned(wide, 'measured')[:-60, :400]
    )


def test_a_colour_bar_says_where_its_colours_end() -> None:
    closed, open_ended = (
        colour_bar(320, -1e-3, 1e-3, 'mm', factor=1e3, open_ended=end) for end in (False, True)
    )
    np.testing.assert_array_equal(closed[4:16], open_ended[4:16])
    assert not np.array_equal(closed, open_ended)
    other = colour_bar(320, -1e-3, 2e-3, 'mm', factor=1e3)
    assert not np.array_equal(closed[16:], other[16:])


def test_the_tip_of_a_ball_is_drawn() -> None:
    ball = tool_mesh(0.01, 0.03, 0.03, sphere=True)
    assert ball.points[:, 2].min() == pytest.approx(0.03)
    assert ball.points[:, 2].max() == pytest.approx(0.06)
    low = ball.points[ball.points[:, 2] < 0.0399]
    assert len(low) > 100
    np.testing.assert_allclose(np.linalg.norm(low - [0.0, 0.0, 0.04], axis=1), 0.01, rtol=1e-9)
    # Closed, and outward: the volume of half a ball with a cylinder on it.
    a, b, c = (ball.points[ball.triangles[:, k]] for k in range(3))
    volume = np.einsum('ij,ij->i', a, np.cross(b, c)).sum() / 6.0
    assert volume == pytest.approx(np.pi * 0.01**2 * (0.02 + 0.02 / 3.0), rel=0.01)
