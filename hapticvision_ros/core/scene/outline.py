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
The outline of the object, held against pictures.

The cloud says where object and table are; colours learned there (GrabCut) tell the one from the
other near the outline. Seen from anywhere, a cell of the top view that falls outside the
silhouette is not the object's. Seen from above, the silhouette also gives back what the cloud
lost at a dark or shiny edge.
"""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.body import Body, BoolArray
from hapticvision_ros.core.scene.views import Picture, Pose
import numpy as np


@dataclass(frozen=True, slots=True)
class OutlineSettings:
    """
    How pictures are used.

    Parameters
    ----------
    band : float
        A picture moves the outline by no more than this [m].
    least_overlap : float
        A silhouette that has less in common with the cloud's (IoU) is not used: the picture is of
        something else, or its pose is wrong.
    steep : float
        A view steeper than this gives back cells that the cloud lost [rad].
    rounds : int
        Rounds of GrabCut.

    """

    band: float = 0.006
    least_overlap: float = 0.8
    steep: float = float(np.deg2rad(65.0))
    rounds: int = 3


DEFAULT_OUTLINE: Final = OutlineSettings()


@dataclass(frozen=True, slots=True, eq=False)
class OutlineCheck:
    """
    What a picture says of the outline.

    Parameters
    ----------
    overlap : float
        What the silhouettes of picture and cloud have in common, as a share of both (IoU).
    used : bool
        Whether the outline was moved by it.
    body : Body
        The object with its outline after that.

    """

    overlap: float
    used: bool
    body: Body


def refine_outline(
    body: Body,
    picture: Picture,
    to_base: Pose,
    settings: OutlineSettings = DEFAULT_OUTLINE,
) -> OutlineCheck:
    """
    Hold the outline against one picture.

    Parameters
    ----------
    body : Body
        The object, in the support plane's frame.
    picture : Picture
        A picture without distortion (`image_rect`), with its pose in the base frame.
    to_base : Pose
        The support plane's frame in the base frame.
    settings : OutlineSettings
        How far it is trusted.

    Returns
    -------
    OutlineCheck
        The overlap, and the object with the outline moved where the picture is to be trusted.

    """
    import cv2

    rows, columns = picture.pixels.shape[:2]
    known = _shadow(body, picture, to_base)
    if not known.any():
        return OutlineCheck(0.0, False, body)
    left, top, width, height = cv2.boundingRect(known.astype(np.uint8))
    margin = max(width, height) // 2
    window = (
        slice(max(top - margin, 0), min(top + height + margin, rows)),
        slice(max(left - margin, 0), min(left + width + margin, columns)),
    )
    # Nothing is held fast: a picture of something else must be free to say so.
    labels = np.where(known, cv2.GC_PR_FGD, cv2.GC_PR_BGD).astype(np.uint8)
    pixels = picture.pixels[window]
    if pixels.ndim == 2:
        pixels = np.repeat(pixels[:, :, None], 3, axis=2)
    # Noise of the pixels is not colour of the object.
    pixels = cv2.GaussianBlur(np.ascontiguousarray(pixels[:, :, :3]), (5, 5), 0)
    cv2.setRNGSeed(0)
    part = np.ascontiguousarray(labels[window])
    cv2.grabCut(
        pixels,
        part,
        None,
        np.zeros((1, 65)),
        np.zeros((1, 65)),
        settings.rounds,
        cv2.GC_INIT_WITH_MASK,
    )
    silhouette = np.zeros(known.shape, dtype=bool)
    silhouette[window] = part == cv2.GC_PR_FGD
    common = np.count_nonzero(silhouette & known)
    overlap = common / np.count_nonzero(silhouette | known)
    if overlap < settings.least_overlap:
        return OutlineCheck(float(overlap), False, body)
    wider = body.with_outline(_grown(body, settings.band).inside)
    points = _tops(wider)
    places, within = picture.project(to_base.apply(points))
    column, row = (
        np.clip(np.rint(places[:, i]), 0, limit - 1).astype(np.intp)
        for i, limit in ((0, columns), (1, rows))
    )
    of_object = np.where(within, silhouette[row, column], True)
    inside = wider.inside.copy()
    inside[wider.inside] = of_object
    ahead = to_base.rotation.T @ picture.pose.rotation[:, 2]
    if -ahead[2] < np.sin(settings.steep):
        inside &= body.inside
    inside |= _grown(body, -settings.band).inside
    moved = body.with_outline(inside)
    return OutlineCheck(float(overlap), True, moved)


def _grown(body: Body, distance: float) -> Body:
    """Return the body with its outline moved outward, on a map that has room for it."""
    import cv2

    cells = round(abs(distance) / body.cell)
    kernel = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * cells + 1, 2 * cells + 1))
    change = cv2.dilate if distance > 0.0 else cv2.erode
    return body.with_outline(change(body.inside.astype(np.uint8), kernel).astype(bool))


def _tops(body: Body) -> FloatArray:
    """Return the surface above the middles of the cells, shape (n, 3) [m]."""
    x, y = body.centres()
    return np.stack([item[body.inside] for item in (x, y, body.heights)], axis=1)


def _shadow(body: Body, picture: Picture, to_base: Pose) -> BoolArray:
    """Return which pixels show the body, standing solid on the support plane."""
    import cv2

    mask = np.zeros(picture.pixels.shape[:2], dtype=np.uint8)
    if not body.inside.any():
        return mask.astype(bool)
    x, y = body.centres()
    half = 0.5 * body.cell
    corners = []
    for dx, dy in ((-half, -half), (half, -half), (half, half), (-half, half)):
        for height in (np.zeros_like(body.heights), body.heights):
            points = np.stack((x + dx, y + dy, height), axis=-1)[body.inside]
            corners.append(picture.project(to_base.apply(points))[0])
    places = np.stack(corners, axis=1)
    # Sub-pixel corners by 4 bits of fraction, and far away ones within what OpenCV takes.
    places = np.rint(np.clip(places, -2000.0, 20000.0) * 16.0).astype(np.int32)
    for cell in places:
        cv2.fillConvexPoly(mask, cv2.convexHull(cell), 1, shift=4)
    return mask.astype(bool)
