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
Pictures of shapes: surfaces and clouds with a colour for each value, shaded, in one palette.

A picture holds numbers of colours of one palette of 256: each of 31 steps of a ramp in seven
shades, then a few greys. So the same picture goes into a PNG and into an animation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Final, Literal

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.surface.mesh import ColourArray, Mesh
from hapticvision_ros.core.surface.raster import (
    draw_mesh,
    draw_points,
    NOTHING,
    ParallelView,
    PixelArray,
)
import numpy as np
from numpy.typing import NDArray

type Picture = NDArray[np.uint8]
type RampName = Literal['height', 'depth', 'error']

_STEPS: Final = 31
_SHADES: Final = 7
_STEPS_OF_TEXT: Final = 8
_FINER: Final = 4
"""Letters are drawn so much larger, and made smaller again: without it no point is seen."""
_CAPTION: Final = 24
"""Height of a line of text over a picture [pixels]."""
_SIZE: Final = 0.45
"""Size of the letters, as OpenCV scales its font."""
_ASIDE: Final = 8
"""Pixels between a caption and either side of the picture."""
_DARKEST: Final = 0.45
_LIGHT: Final = np.array([-0.35, -0.45, 0.82])
"""Where the light comes from, as seen by the viewer: left, above, in front."""
_RAMPS: Final[dict[RampName, tuple[tuple[int, int, int], ...]]] = {
    # From low to high, alike in lightness for all eyes (the viridis of matplotlib, CC0).
    'height': ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)),
    'depth': ((240, 236, 220), (158, 202, 190), (66, 144, 164), (38, 84, 134), (30, 28, 78)),
    # Inside blue, outside red, none white.
    'error': ((33, 60, 160), (120, 160, 225), (245, 245, 245), (232, 145, 110), (165, 25, 40)),
}


class Grey(IntEnum):
    """Colours beside the ramp."""

    PAGE = _STEPS * _SHADES
    INK = PAGE + 1
    SOFT = PAGE + 2
    TOOL = PAGE + 3
    """The first of seven shades."""
    TEXT = TOOL + _SHADES
    """The first of eight steps from page to ink, for the edges of letters."""


_GREYS: Final = {Grey.PAGE: (255, 255, 255), Grey.INK: (29, 33, 38), Grey.SOFT: (200, 205, 210)}
_TOOL: Final = np.array([150.0, 156.0, 164.0])


def ramp(values: FloatArray, low: float, high: float, name: RampName) -> ColourArray:
    """Return the colours, shape (n, 3), of values between two ends."""
    return _ramp_colours(name)[_steps(values, low, high)]


def palette(name: RampName) -> ColourArray:
    """Return the palette of a ramp: red, green and blue of 256 colours."""
    colours = np.zeros((256, 3))
    shades = np.linspace(_DARKEST, 1.0, _SHADES)
    lit = _ramp_colours(name)[:, None, :] * shades[None, :, None]
    colours[: _STEPS * _SHADES] = lit.reshape(-1, 3)
    for grey, colour in _GREYS.items():
        colours[grey] = colour
    tool = slice(Grey.TOOL, Grey.TOOL + _SHADES)
    colours[tool] = shades[:, None] * _TOOL
    share = np.linspace(0.0, 1.0, _STEPS_OF_TEXT)[:, None]
    text = slice(Grey.TEXT, Grey.TEXT + _STEPS_OF_TEXT)
    colours[text] = (1.0 - share) * _GREYS[Grey.PAGE] + share * _GREYS[Grey.INK]
    return np.rint(colours).astype(np.uint8)


def _ramp_colours(name: RampName) -> ColourArray:
    anchors = np.array(_RAMPS[name], dtype=np.float64)
    where = np.linspace(0.0, len(anchors) - 1.0, _STEPS)
    channels = [np.interp(where, np.arange(len(anchors)), anchors[:, k]) for k in range(3)]
    return np.rint(np.stack(channels, axis=1)).astype(np.uint8)


def _steps(values: FloatArray, low: float, high: float) -> NDArray[np.intp]:
    share = (values - low) / max(high - low, 1e-12)
    return np.rint(np.clip(share, 0.0, 1.0) * (_STEPS - 1)).astype(np.intp)


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """
    Something to draw.

    Parameters
    ----------
    points, normals : ndarray, shape (n, 3)
        Points [m] and unit normals, for a cloud.
    values : ndarray, shape (n,)
        What the colours show, of each point; of a surface linear in between.
    mesh : Mesh, optional
        A surface instead of a cloud; the normals are then those of its triangles.

    """

    points: FloatArray
    normals: FloatArray
    values: FloatArray
    mesh: Mesh | None = None

    @classmethod
    def of_mesh(cls, mesh: Mesh, values: FloatArray) -> 'Shape':
        """Return a surface with a value for each of its points."""
        return cls(mesh.points, mesh.normals, values, mesh)


def draw(shape: Shape, view: ParallelView, low: float, high: float, *, dot: int = 3) -> Picture:
    """
    Return a picture of a surface or a cloud.

    Parameters
    ----------
    shape : Shape
        What is drawn.
    view : ParallelView
        From where it is seen.
    low, high : float
        Values at the ends of the ramp.
    dot : int
        Side of a point of a cloud [pixels].

    Returns
    -------
    ndarray of uint8, shape (height, width)
        Rows of the palette.

    """
    if shape.mesh is not None:
        owner, _ = draw_mesh(shape.mesh, view)
    else:
        owner, _ = draw_points(shape.points, view, dot)
    shown = owner != NOTHING
    values = shape.values[owner[shown]] if shape.mesh is None else _between(shape, view, owner)
    colours = _steps(values, low, high) * _SHADES
    picture = np.full(owner.shape, Grey.PAGE, np.uint8)
    picture[shown] = colours + _shades(shape.normals, view)[owner[shown]]
    return picture


def _between(shape: Shape, view: ParallelView, owner: PixelArray) -> FloatArray:
    """Return the values in the middles of the pixels that show a surface, row by row."""
    assert shape.mesh is not None
    row, column = np.nonzero(owner != NOTHING)
    corners = shape.mesh.triangles[owner[row, column]]
    a, b, c = np.moveaxis(view.project(shape.points)[corners][:, :, :2], 1, 0)
    pixel = np.stack((column + 0.5, row + 0.5), axis=1)

    def area(one: FloatArray, two: FloatArray) -> FloatArray:
        return np.asarray(one[:, 0] * two[:, 1] - one[:, 1] * two[:, 0])

    whole = area(b - a, c - a)
    at_b, at_c = area(pixel - a, c - a) / whole, area(b - a, pixel - a) / whole
    weights = np.stack((1.0 - at_b - at_c, at_b, at_c), axis=1)
    return np.asarray((weights * shape.values[corners]).sum(axis=1))


def _shades(normals: FloatArray, view: ParallelView) -> NDArray[np.intp]:
    toward = view.toward
    right = np.array([np.cos(view.azimuth), np.sin(view.azimuth), 0.0])
    up = np.cross(toward, right)
    light = _LIGHT[0] * right - _LIGHT[1] * up + _LIGHT[2] * toward
    bright = np.clip(normals @ light / np.linalg.norm(light), 0.0, 1.0)
    return np.asarray(np.rint(bright * (_SHADES - 1)), dtype=np.intp)


def draw_with_tool(
    shape: Shape, tool: Mesh, view: ParallelView, low: float, high: float
) -> Picture:
    """Return a picture of a surface and of the tool that presses it, in grey."""
    assert shape.mesh is not None
    picture = draw(shape, view, low, high)
    _, depth = draw_mesh(shape.mesh, view)
    owner, tool_depth = draw_mesh(tool, view)
    front = (owner != NOTHING) & (tool_depth > depth)
    picture[front] = (Grey.TOOL + _shades(tool.normals, view))[owner[front]]
    return picture


def tool_mesh(
    radius: float, tip: float, length: float, *, sphere: bool = False, sides: int = 48
) -> Mesh:
    """
    Return a tool about the z axis.

    Parameters
    ----------
    radius, tip, length : float
        Of the cylinder or the ball, height of its lowest point, and how far it reaches above that
        [m].
    sphere : bool
        Whether it ends in a ball; else it is flat.
    sides : int
        Of the polygon that is drawn for a circle.

    """
    if sphere:
        return _turned(radius, tip, max(length, 1.001 * radius), sides)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    ring = np.stack((radius * np.cos(angle), radius * np.sin(angle)), axis=1)
    low = np.column_stack((ring, np.full(sides, tip)))
    high = np.column_stack((ring, np.full(sides, tip + length)))
    points = np.concatenate((low, high, [[0.0, 0.0, tip], [0.0, 0.0, tip + length]]))
    a = np.arange(sides)
    b = (a + 1) % sides
    triangles = np.concatenate(
        (
            np.stack((a, b, b + sides), axis=1),
            np.stack((a, b + sides, a + sides), axis=1),
            np.stack((b, a, np.full(sides, 2 * sides)), axis=1),
            np.stack((a + sides, b + sides, np.full(sides, 2 * sides + 1)), axis=1),
        )
    )
    return Mesh(points, triangles)


def _turned(radius: float, tip: float, length: float, sides: int) -> Mesh:
    """Return a tool that ends in a ball: a profile turned about the z axis."""
    up = np.linspace(0.0, 0.5 * np.pi, sides // 4 + 1)[1:]
    around = np.append(radius * np.sin(up), radius)
    height = tip + np.append(radius * (1.0 - np.cos(up)), length)
    angle = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    circle = np.stack((np.cos(angle), np.sin(angle)), axis=1)
    rings = [
        np.column_stack((r * circle, np.full(sides, z)))
        for r, z in zip(around, height, strict=True)
    ]
    points = np.concatenate((*rings, [[0.0, 0.0, tip], [0.0, 0.0, tip + length]]))
    a = np.arange(sides)
    b = (a + 1) % sides
    last = sides * (len(rings) - 1)
    triangles = [
        np.stack((b, a, np.full(sides, sides * len(rings))), axis=1),
        np.stack((a + last, b + last, np.full(sides, sides * len(rings) + 1)), axis=1),
    ]
    for low in range(0, last, sides):
        triangles.append(np.stack((a, b, b + sides), axis=1) + low)
        triangles.append(np.stack((a, b + sides, a + sides), axis=1) + low)
    return Mesh(points, np.concatenate(triangles))


def captioned(picture: Picture, text: str) -> Picture:
    """Return a picture with a line of plain text over it, smaller where that is long."""
    import cv2

    width = picture.shape[1]
    strip = np.full((_CAPTION, width), Grey.PAGE, np.uint8)
    (long, _), _ = cv2.getTextSize(text, cv2.FONT_HERSHEY_SIMPLEX, _FINER * _SIZE, _FINER + 1)
    shrunk = min(1.0, _FINER * (width - 2 * _ASIDE) / max(long, 1))
    _write(strip, text, _ASIDE, _CAPTION - 7, size=shrunk * _SIZE)
    return np.concatenate((strip, picture))


def _write(picture: Picture, text: str, column: int, row: int, *, size: float = _SIZE) -> None:
    """Write a line of plain text onto a page, its left end at a place [pixels]."""
    import cv2

    plain = text.encode('ascii', 'replace').decode()
    large = np.zeros([_FINER * side for side in picture.shape], np.uint8)
    place = _FINER * column, _FINER * row
    cv2.putText(
        large, plain, place, cv2.FONT_HERSHEY_SIMPLEX, _FINER * size, 255, _FINER + 1, cv2.LINE_AA
    )
    rows, columns = picture.shape
    ink = cv2.resize(large, (columns, rows), interpolation=cv2.INTER_AREA)
    step = np.rint(ink.astype(np.float64) / 255.0 * (_STEPS_OF_TEXT - 1)).astype(np.uint8)
    picture[step > 0] = Grey.TEXT + step[step > 0]


def colour_bar(
    width: int, low: float, high: float, unit: str, *, factor: float, open_ended: bool = False
) -> Picture:
    """Return a bar of the ramp with its ends and its middle in numbers, and what is beyond."""
    bar = np.full((38, width), Grey.PAGE, np.uint8)
    left, right = 14, width - 14
    steps = np.linspace(0, _STEPS - 1, right - left).round().astype(np.intp)
    bar[4:16, left:right] = steps * _SHADES + _SHADES - 1
    for share, text in (
        (0.0, f'{"<= " if open_ended else ""}{factor * low:.3g}'),
        (0.5, f'{factor * 0.5 * (low + high):.3g}'),
        (1.0, f'{">= " if open_ended else ""}{factor * high:.3g} {unit}'),
    ):
        place = (
            left + share * (right - left) - 4 * len(text) * (1.0 + (share == 1.0)) * (share > 0)
        )
        _write(bar, text, int(max(place, 2)), 32, size=0.4)
    return bar


def coloured(picture: Picture, name: RampName) -> ColourArray:
    """Return a picture's red, green and blue, shape (height, width, 3)."""
    return palette(name)[picture]


def beside(pictures: Sequence[ColourArray]) -> ColourArray:
    """Return pictures of one height in a row."""
    return np.concatenate(list(pictures), axis=1)


def below(pictures: Sequence[ColourArray]) -> ColourArray:
    """Return pictures of one width in a column."""
    return np.concatenate(list(pictures), axis=0)


def png(picture: ColourArray) -> bytes:
    """Return a picture as a PNG file."""
    import cv2

    return bytes(cv2.imencode('.png', picture[:, :, ::-1])[1])
