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
The line of symmetry L of the top view, and with it the plane S through it.

The moments of the top view give two candidate axes. Each is scored by what the object has in
common with its mirror image: of the outline, and of the body, since a wedge's outline is alike on
both sides of the axis on which the wedge is not.
"""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.body import Body
import numpy as np


@dataclass(frozen=True, slots=True)
class Symmetry:
    """
    The line L in the support plane's frame; S holds it and the plane's normal.

    Parameters
    ----------
    centre : tuple of float
        G_top, through which L goes [m].
    angle : float
        Direction of L from the x axis [rad], from 0 to pi.
    outline_overlap, body_overlap : float
        What outline and body have in common with their mirror images, as a share of both (IoU).
    other_overlap : float
        The body's overlap about the candidate that was not taken.

    """

    centre: tuple[float, float]
    angle: float
    outline_overlap: float
    body_overlap: float
    other_overlap: float


_ROUND: Final = 0.7
"""A ratio of the principal moments above this leaves their axes to chance (a square's are)."""
_ALIKE: Final = 0.03
"""Overlaps that differ by less differ by how the cells of the border fall."""
_SCAN: Final = np.deg2rad(5.0)
_POLISH: Final = np.deg2rad(0.5)


def find_symmetry(body: Body) -> Symmetry:
    """
    Choose the line of symmetry.

    Parameters
    ----------
    body : Body
        The object.

    Returns
    -------
    Symmetry
        The better of the two candidates.

    """
    centre = body.top_view_centre
    weight = body.coverage
    x, y = body.centres()
    dx, dy = x - centre[0], y - centre[1]
    xx, yy, xy = ((weight * item).sum() for item in (dx * dx, dy * dy, dx * dy))
    major = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    mean, radius = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    candidates = [major, major + 0.5 * np.pi]
    if (mean - radius) / (mean + radius) > _ROUND:
        candidates += list(np.arange(0.0, np.pi, _SCAN))
    scores = [_overlap(body, centre, angle)[1] for angle in candidates]
    # Of equally good ones the first: the long axis.
    best = int(np.argmax(np.array(scores) > max(scores) - _ALIKE))
    angle = float(candidates[best])
    if best >= 2:
        # The moments are within half a degree; what was only scanned is within half a step.
        turned = angle + _POLISH * np.arange(-5, 6)
        angle = float(turned[np.argmax([_overlap(body, centre, item)[1] for item in turned])])
    outline, solid = _overlap(body, centre, angle)
    other = _overlap(body, centre, angle + 0.5 * np.pi)[1]
    return Symmetry(
        (float(centre[0]), float(centre[1])), float(angle % np.pi), outline, solid, other
    )


def _overlap(body: Body, centre: FloatArray, angle: float) -> tuple[float, float]:
    """Return the overlaps of outline and body with their mirror images about an axis."""
    import cv2

    x, y = body.centres()
    cos, sin = np.cos(2.0 * angle), np.sin(2.0 * angle)
    dx, dy = x - centre[0], y - centre[1]
    column = (centre[0] + cos * dx + sin * dy - body.low[0]) / body.cell - 0.5
    row = (centre[1] + sin * dx - cos * dy - body.low[1]) / body.cell - 0.5
    places = column.astype(np.float32), row.astype(np.float32)
    shares = []
    for values in (body.coverage, body.coverage * body.heights):
        image = values.astype(np.float32)
        mirrored = cv2.remap(image, *places, cv2.INTER_LINEAR)
        # What is mirrored out of the map is in no sum of its own.
        common = float(np.minimum(image, mirrored).sum())
        total = 2.0 * float(image.sum()) - common
        shares.append(common / total)
    return shares[0], shares[1]
