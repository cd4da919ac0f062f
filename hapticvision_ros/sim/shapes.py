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
What cameras see of known solids on a table, by ray casting: the truth for "touch and see".

Solids are unions of convex parts, each an intersection of half spaces and at most one ellipsoid,
so that a ray meets each part in one interval. Nothing here is shared with what is tested on it.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from hapticvision_ros.core.records import FloatArray, PointArray
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Part:
    """
    A convex body: ``normals @ p <= offsets``, inside an ellipsoid if it has one.

    Parameters
    ----------
    normals : ndarray, shape (m, 3)
    offsets : ndarray, shape (m,)
        Half spaces [m].
    centre, radii : tuple of float, optional
        Ellipsoid, its axes along x, y and z [m].

    """

    normals: FloatArray
    offsets: FloatArray
    centre: tuple[float, float, float] | None = None
    radii: tuple[float, float, float] | None = None

    def interval(self, origin: FloatArray, along: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return where rays enter and leave the part; it is missed where enter >= leave."""
        enter = np.full(len(along), -np.inf)
        leave = np.full(len(along), np.inf)
        for normal, offset in zip(self.normals, self.offsets, strict=True):
            slope, room = along @ normal, offset - origin @ normal
            with np.errstate(divide='ignore', invalid='ignore'):
                at = room / slope
            enter = np.where(slope < 0.0, np.maximum(enter, at), enter)
            leave = np.where(slope > 0.0, np.minimum(leave, at), leave)
            leave = np.where((slope == 0.0) & (room < 0.0), -np.inf, leave)
        if self.centre is not None and self.radii is not None:
            start = (origin - np.array(self.centre)) / np.array(self.radii)
            scaled = along / np.array(self.radii)
            a = np.sum(scaled * scaled, axis=1)
            b = np.sum(scaled * start, axis=1)
            c = np.sum(start * start, axis=-1) - 1.0
            discriminant = b * b - a * c
            root = np.sqrt(np.maximum(discriminant, 0.0))
            enter = np.where(discriminant > 0.0, np.maximum(enter, (-b - root) / a), np.inf)
            leave = np.where(discriminant > 0.0, np.minimum(leave, (-b + root) / a), -np.inf)
        return enter, leave


@dataclass(frozen=True, slots=True)
class Solid:
    """
    A body on the table: convex parts, turned by `yaw` about z and shifted to (x, y).

    Parameters
    ----------
    parts : tuple of Part
        In the body's own frame, its underside at z = 0.
    reach : float
        No part is farther from the body's own z axis than this [m].
    top : float
        Nor higher [m].
    x, y, yaw : float
        Where it stands [m] and how it is turned [rad].

    """

    parts: tuple[Part, ...]
    reach: float
    top: float
    x: float = 0.0
    y: float = 0.0
    yaw: float = 0.0

    def at(self, x: float, y: float, yaw: float = 0.0) -> 'Solid':
        """Return the body at another place."""
        return Solid(self.parts, self.reach, self.top, x, y, yaw)

    def to_world(self, points: FloatArray) -> FloatArray:
        """Return points of the body's own frame in the table's."""
        world: FloatArray = points @ _turn(self.yaw).T + np.array([self.x, self.y, 0.0])
        return world

    def depth(self, origin: FloatArray, along: FloatArray) -> FloatArray:
        """Return where rays first meet the body, infinite where they miss it."""
        turn = _turn(self.yaw)
        start = (origin - np.array([self.x, self.y, 0.0])) @ turn
        turned = along @ turn
        nearest = np.full(len(along), np.inf)
        for part in self.parts:
            enter, leave = part.interval(start, turned)
            hits = (enter < leave) & (enter > 0.0)
            nearest = np.where(hits, np.minimum(nearest, enter), nearest)
        return nearest


@dataclass(frozen=True, slots=True)
class Truth:
    """
    What a body is, by quadrature over vertical lines through it.

    Parameters
    ----------
    volume : float
        [m^3].
    centre_of_gravity : ndarray, shape (3,)
        At constant density [m].
    top_view_centre : ndarray, shape (2,)
        Mass centre of its top view [m].
    top_view_area : float
        [m^2].
    contact_height : float
        Height of its surface above that centre [m].

    """

    volume: float
    centre_of_gravity: FloatArray
    top_view_centre: FloatArray
    top_view_area: float
    contact_height: float


def truth_of(solid: Solid, step: float = 2e-4) -> Truth:
    """Return the truth of a body, sampled every `step` [m]."""
    half = int(np.ceil(solid.reach / step))
    middles = (np.arange(-half, half) + 0.5) * step
    x, y = (item.ravel() for item in np.meshgrid(middles, middles))
    length, moment, _ = _columns(solid, x, y)
    inside = length > 0.0
    cell = step * step
    volume = float(length.sum() * cell)
    gravity = np.array([x @ length, y @ length, moment.sum()]) * cell / volume
    centre = np.array([x[inside].mean(), y[inside].mean()])
    height = float(_columns(solid, centre[:1], centre[1:])[2][0])
    return Truth(
        volume,
        solid.to_world(gravity),
        solid.to_world(np.array([*centre, 0.0]))[:2],
        float(np.count_nonzero(inside) * cell),
        height,
    )


def _columns(solid: Solid, x: FloatArray, y: FloatArray) -> tuple[FloatArray, ...]:
    """Return length, first moment and top of the body along vertical lines."""
    origins = np.stack((x, y, np.zeros_like(x)), axis=1)
    up = np.tile([0.0, 0.0, 1.0], (x.size, 1))
    intervals = np.stack([np.stack(part.interval(origins, up)) for part in solid.parts])
    met = intervals[:, 1] > np.maximum(intervals[:, 0], 0.0)
    enter = np.where(met, np.maximum(intervals[:, 0], 0.0), 0.0)
    leave = np.where(met, intervals[:, 1], 0.0)
    order = np.argsort(enter, axis=0)
    enter, leave = np.take_along_axis(enter, order, 0), np.take_along_axis(leave, order, 0)
    length, moment, top = np.zeros_like(x), np.zeros_like(x), np.zeros_like(x)
    for low, high in zip(enter, leave, strict=True):
        bottom = np.maximum(low, top)
        extra = np.maximum(high - bottom, 0.0)
        length += extra
        moment += extra * (bottom + 0.5 * extra)
        top = np.where(high > low, np.maximum(top, high), top)
    return length, moment, top


def _turn(yaw: float) -> FloatArray:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


_BOX = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, -1]], dtype=np.float64)


def block(length: float, width: float, height: float) -> Solid:
    """Return a block with sides along x, y and z [m]."""
    return wedge(length, width, height, height)


def wedge(length: float, width: float, low: float, high: float) -> Solid:
    """Return a block whose top rises along x, from `low` to `high` [m]."""
    slope = (high - low) / length
    normal = np.array([-slope, 0.0, 1.0])
    normals = np.vstack((_BOX, normal))
    half = (length / 2, length / 2, width / 2, width / 2, 0.0, 0.5 * (low + high))
    return Solid((Part(normals, np.array(half)),), np.hypot(length, width) / 2, max(low, high))


def hemisphere(radius: float) -> Solid:
    """Return a half ball that lies on its flat side [m]."""
    return mound(((0.0, 0.0, 0.0, radius, radius, radius),))


def mound(ellipsoids: Sequence[tuple[float, float, float, float, float, float]]) -> Solid:
    """Return the union of ellipsoids (x, y, z, rx, ry, rz) [m], as far as it is above z = 0."""
    ground = np.array([[0.0, 0.0, -1.0]])
    parts = tuple(
        Part(ground, np.zeros(1), (x, y, z), (rx, ry, rz)) for x, y, z, rx, ry, rz in ellipsoids
    )
    reach = max(np.hypot(x, y) + max(rx, ry) for x, y, _, rx, ry, _ in ellipsoids)
    top = max(z + rz for _, _, z, _, _, rz in ellipsoids)
    return Solid(parts, float(reach), float(top))


def lump(seed: int) -> Solid:
    """Return an irregular lump without overhang, some 8 cm across."""
    random = np.random.default_rng(seed)
    bumps = [(0.0, 0.0, 0.0, 0.032, 0.024, 0.028)]
    for angle in random.uniform(0.0, 2.0 * np.pi, 4):
        distance, width, depth, height = random.uniform(
            (0.012, 0.014, 0.014, 0.015), (0.024, 0.022, 0.022, 0.04)
        )
        bumps.append(
            (distance * np.cos(angle), distance * np.sin(angle), 0.0, width, depth, height)
        )
    return mound(bumps)


@dataclass(frozen=True, slots=True)
class Camera:
    """
    A range sensor with a camera in the same place, in its optical frame: z ahead, y down.

    Parameters
    ----------
    azimuth, elevation : float
        Where it stands, seen from the target [rad].
    distance : float
        Distance from the target [m].
    target : tuple of float
        What it looks at [m].
    width, height : int
        Pixels.
    field_of_view : float
        Full horizontal angle [rad].

    """

    azimuth: float
    elevation: float
    distance: float = 0.45
    target: tuple[float, float, float] = (0.0, 0.0, 0.02)
    width: int = 320
    height: int = 240
    field_of_view: float = 0.6

    @property
    def rotation(self) -> FloatArray:
        """Bring the optical frame into the table's: ``p @ rotation.T + translation``."""
        cos, sin = np.cos(self.azimuth), np.sin(self.azimuth)
        ahead = -np.array(
            [cos * np.cos(self.elevation), sin * np.cos(self.elevation), np.sin(self.elevation)]
        )
        right = np.array([-sin, cos, 0.0])
        return np.stack((right, np.cross(ahead, right), ahead), axis=1)

    @property
    def translation(self) -> FloatArray:
        """Return the place of the camera [m]."""
        place: FloatArray = np.array(self.target) - self.distance * self.rotation[:, 2]
        return place

    @property
    def matrix(self) -> FloatArray:
        """Return the intrinsic matrix K of a camera without distortion, shape (3, 3)."""
        focal = 0.5 * self.width / np.tan(0.5 * self.field_of_view)
        return np.array(
            [
                [focal, 0.0, 0.5 * (self.width - 1)],
                [0.0, focal, 0.5 * (self.height - 1)],
                [0.0, 0.0, 1.0],
            ]
        )


@dataclass(frozen=True, slots=True)
class Shot:
    """
    What a camera measured.

    Parameters
    ----------
    xyz : ndarray of float32, shape (height, width, 3)
        Points in the optical frame [m]; NaN is no return.
    image : ndarray of uint8, shape (height, width, 3)
        A picture with texture and noise.
    of_solid : ndarray of bool, shape (height, width)
        The true silhouette.

    """

    xyz: PointArray
    image: NDArray[np.uint8]
    of_solid: NDArray[np.bool_]


def take(
    camera: Camera,
    solids: Sequence[Solid],
    *,
    noise: float = 5e-4,
    dropout: float = 0.02,
    table: float = 0.3,
    seed: int = 0,
) -> Shot:
    """
    Return what a camera measures of bodies on a square table.

    Parameters
    ----------
    camera : Camera
        The camera.
    solids : sequence of Solid
        The bodies; the first that a ray meets hides the others.
    noise : float
        Standard deviation of the depth along the optical axis [m].
    dropout : float
        Share of the pixels without a return.
    table : float
        Side of the table [m].
    seed : int
        Seed of noise and dropouts.

    Returns
    -------
    Shot
        The measurement.

    """
    random = np.random.default_rng(seed)
    inverse = np.linalg.inv(camera.matrix)
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    pixels = np.stack(
        (columns.ravel(), rows.ravel(), np.ones(columns.size)), axis=1, dtype=np.float64
    )
    rays = pixels @ inverse.T
    origin, along = camera.translation, rays @ camera.rotation.T
    depth = np.full(len(rays), np.inf)
    for solid in solids:
        depth = np.minimum(depth, solid.depth(origin, along))
    of_solid = np.isfinite(depth)
    with np.errstate(divide='ignore'):
        to_table = -origin[2] / along[:, 2]
    on_table = origin + to_table[:, None] * along
    hits = (to_table > 0.0) & np.all(np.abs(on_table[:, :2]) < 0.5 * table, axis=1) & ~of_solid
    depth = np.where(of_solid, depth, np.where(hits, to_table, np.nan))
    depth = depth + noise * random.standard_normal(depth.size)
    depth[random.random(depth.size) < dropout] = np.nan
    shape = (camera.height, camera.width)
    base = np.where(of_solid[:, None], (190.0, 170.0, 130.0), (70.0, 90.0, 80.0))
    grain = 18.0 * random.standard_normal((len(rays), 1)) + 6.0 * random.standard_normal(
        (len(rays), 3)
    )
    image = np.clip(base + grain, 0, 255).astype(np.uint8)
    return Shot(
        (rays * depth[:, None]).astype(np.float32).reshape(*shape, 3),
        image.reshape(*shape, 3),
        of_solid.reshape(shape),
    )
