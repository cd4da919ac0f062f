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


"""What the range sensor sees: a dented block, the tool and the support plane, by ray casting."""

from dataclasses import dataclass

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.sim.config import Block, RangeSensorModel
import numpy as np
from numpy.typing import NDArray

type BoolArray = NDArray[np.bool_]
type IndexArray = NDArray[np.intp]

MARCH_STEPS = 12
"""
Slices of the dent's depth in which the first crossing of a ray is looked for; thin at the top,
where a ray can cut through the rim and come out again.
"""
REFINE_STEPS = 4
"""Regula falsi steps inside the slice: leaves well under 10 um of a 10 mm dent."""


@dataclass(frozen=True, slots=True)
class Scene:
    """
    The geometry before the range sensor, in the frame `support_plane`.

    The block is centred at x = y = 0 on the plane z = 0, the tool's axis is the z axis.

    Parameters
    ----------
    block : Block
        The object's shape.
    tool_radius : float
        Radius of the cylindrical tool [m].
    sensor : RangeSensorModel
        Where the sensor stands.
    sphere : bool
        Whether the tool ends in a sphere of that radius; else it is flat.

    """

    block: Block
    tool_radius: float
    sensor: RangeSensorModel
    sphere: bool = False

    def __post_init__(self) -> None:
        reach = self.tool_radius + self.block.rim_width
        if 2.0 * reach > min(self.block.length, self.block.width):
            raise InputError(
                f'a dent of {2e3 * reach:g} mm across does not fit on the block of '
                f'{1e3 * self.block.length:g} x {1e3 * self.block.width:g} mm: choose a smaller '
                'tool_radius or rim_width'
            )

    def profile(self, radius: FloatArray) -> FloatArray:
        """
        Return the dent's depth at distances from the tool's axis, as a share of H.

        Parameters
        ----------
        radius : ndarray
            Distances from the axis [m].

        Returns
        -------
        ndarray
            1 under the tool, running out smoothly to 0 over the rim.

        """
        share = np.clip((radius - self.tool_radius) / self.block.rim_width, 0.0, 1.0)
        return 1.0 - share * share * (3.0 - 2.0 * share)


class RangeRenderer:
    """
    Renders the clouds of a range sensor with `width` x `height` pixels.

    What does not move is cast once; a frame casts again only the rays that enter the dent or
    meet the tool.

    Parameters
    ----------
    scene : Scene
        What stands before the sensor.
    width, height : int
        Size of the cloud in pixels.
    depth_noise : float
        Standard deviation of the depth along the optical axis [m].
    seed : int
        Seed of the noise.
    triangles : ndarray of int, shape (m, 3), optional
        Nodes of the triangles of a deforming body that stands in the place of the block.

    """

    def __init__(
        self,
        scene: Scene,
        *,
        width: int,
        height: int,
        depth_noise: float,
        seed: int,
        triangles: IndexArray | None = None,
    ) -> None:
        self._scene = scene
        self._noise = np.float32(depth_noise)
        self._random = np.random.default_rng(seed)
        self._size = (height, width)
        self._triangles = triangles
        origin, directions = _rays(scene, width, height)
        depth, on_top = _cast_static(scene, origin, directions, with_block=triangles is None)
        self._origin = origin.astype(np.float32)
        self._directions = directions.astype(np.float32)
        self._static_depth = depth.astype(np.float32)
        self._set_up_dent(origin, directions, depth, on_top)
        self._set_up_tool(origin, directions)

    def _set_up_dent(
        self, origin: FloatArray, directions: FloatArray, depth: FloatArray, on_top: BoolArray
    ) -> None:
        """Keep the rays that enter the block's top where there can be a dent."""
        reach = self._scene.tool_radius + self._scene.block.rim_width
        entry = origin[:2] + depth[:, None] * directions[:, :2]
        inside = on_top & (np.hypot(entry[:, 0], entry[:, 1]) < reach)
        self._dent_rays = np.flatnonzero(inside)
        down = -directions[inside, 2]
        slope = directions[inside, :2] / down[:, None]
        entry = entry[inside]
        # The squared distance from the axis at depth u below the top is a parabola in u.
        self._dent_parabola = tuple(
            coefficient.astype(np.float32)
            for coefficient in (
                np.sum(entry * entry, axis=1),
                2.0 * np.sum(entry * slope, axis=1),
                np.sum(slope * slope, axis=1),
            )
        )
        self._depth_per_descent = (1.0 / down).astype(np.float32)

    def _set_up_tool(self, origin: FloatArray, directions: FloatArray) -> None:
        """Keep the rays that meet the tool's cylinder, which only moves along its axis."""
        horizontal = directions[:, :2]
        a = np.sum(horizontal * horizontal, axis=1)
        b = horizontal @ origin[:2]
        c = float(origin[:2] @ origin[:2]) - self._scene.tool_radius**2
        discriminant = b * b - a * c
        meets = (discriminant > 0.0) & (a > 0.0)
        depth = (-b[meets] - np.sqrt(discriminant[meets])) / a[meets]
        self._tool_rays = np.flatnonzero(meets)
        self._tool_depth = depth.astype(np.float32)
        self._tool_z = (origin[2] + depth * directions[meets, 2]).astype(np.float32)
        self._aim = directions[meets]

    def _tool(self, tip: float) -> tuple[PointArray, BoolArray]:
        """Return the depth at which the tool's rays meet it, and which of them do."""
        if not self._scene.sphere:
            return self._tool_depth, self._tool_z >= tip
        # A ray that enters the cylinder below the ball's equator meets the ball or nothing.
        radius = self._scene.tool_radius
        start = self._origin - np.array([0.0, 0.0, tip + radius])
        a = np.sum(self._aim * self._aim, axis=1)
        b = self._aim @ start
        discriminant = b * b - a * (float(start @ start) - radius**2)
        ball = (-b - np.sqrt(np.maximum(discriminant, 0.0))) / a
        shaft = self._tool_z >= tip + radius
        return (
            np.where(shaft, self._tool_depth, ball).astype(np.float32),
            shaft | (discriminant > 0.0),
        )

    def render(
        self, tool_height: float, displacement: float, points: FloatArray | None = None
    ) -> PointArray:
        """
        Return one cloud.

        Parameters
        ----------
        tool_height : float
            Height of the tool tip [m].
        displacement : float
            Depth H of the dent [m].
        points : ndarray, shape (n, 3), optional
            Nodes of the deforming body, where there is one [m].

        Returns
        -------
        ndarray of float32, shape (height, width, 3)
            Points [m] in the frame `support_plane`; NaN is no return.

        """
        depth = self._static_depth.copy()
        if self._triangles is not None:
            assert points is not None, 'a deforming body is rendered where its nodes are'
            self._draw(points, depth)
        elif displacement > 1e-7:
            depth[self._dent_rays] += self._depth_per_descent * self._descent(displacement)
        tool_depth, met = self._tool(tool_height)
        seen = met & ~(tool_depth >= depth[self._tool_rays])
        depth[self._tool_rays[seen]] = tool_depth[seen]
        noise = self._random.standard_normal(depth.size, dtype=np.float32)
        noise *= self._noise
        depth += noise
        share = self._scene.sensor.dropout
        if share > 0.0:
            count = self._random.binomial(depth.size, share)
            depth[self._random.integers(depth.size, size=count)] = np.nan
        cloud = self._directions * depth[:, None]
        cloud += self._origin
        return cloud.reshape(*self._size, 3)

    def _draw(self, points: FloatArray, depth: PointArray) -> None:
        """Put the deforming body before what is behind it."""
        # It needs numba, which is slow to load and which a block does without.
        from hapticvision_ros.sim.raster import cast

        height, width = self._size
        axes, focal = _camera(self._scene, width)
        seen = (points - self._origin) @ axes.T
        place = focal * seen[:, :2] / seen[:, 2:] + 0.5 * np.array([width, height]) - 0.5
        cast(seen, place, self._triangles, focal, depth.reshape(height, width))

    def _descent(self, displacement: float) -> PointArray:
        """Return how far below the block's top each ray of the dent ends [m]."""
        constant, linear, quadratic = self._dent_parabola
        radius_tool = np.float32(self._scene.tool_radius)
        per_rim = np.float32(1.0 / self._scene.block.rim_width)
        dent = np.float32(displacement)

        def clearance(u: PointArray, ray: slice | IndexArray = slice(None)) -> PointArray:
            """Return how far a ray at depth `u` still is above the dent's surface [m]."""
            radius = np.sqrt(np.maximum(constant[ray] + u * (linear[ray] + u * quadratic[ray]), 0))
            share = np.clip((radius - radius_tool) * per_rim, 0, 1)
            above: PointArray = dent * (1 - share * share * (3 - 2 * share)) - u
            return above

        low = np.zeros_like(constant)
        high = np.full_like(constant, dent)
        above_low = clearance(low)
        above_high = np.zeros_like(constant)
        open_rays = np.arange(constant.size)
        for step in range(1, MARCH_STEPS + 1):
            u = np.full(open_rays.size, dent * np.float32((step / MARCH_STEPS) ** 2))
            above = clearance(u, open_rays)
            ends = above <= 0
            ended, going = open_rays[ends], open_rays[~ends]
            high[ended], above_high[ended] = u[ends], above[ends]
            low[going], above_low[going] = u[~ends], above[~ends]
            open_rays = going
        for _ in range(REFINE_STEPS):
            gap = above_low - above_high
            share = np.divide(above_low, gap, out=np.ones_like(gap), where=gap > 0)
            u = low + share * (high - low)
            above = clearance(u)
            ends = above <= 0
            high, above_high = np.where(ends, u, high), np.where(ends, above, above_high)
            low, above_low = np.where(ends, low, u), np.where(ends, above_low, above)
        gap = above_low - above_high
        share = np.divide(above_low, gap, out=np.ones_like(gap), where=gap > 0)
        descent: PointArray = low + share * (high - low)
        return descent


def _camera(scene: Scene, width: int) -> tuple[FloatArray, float]:
    """Return the sensor's axes (right, down, forward), and its focal length in pixels."""
    sensor = scene.sensor
    cos, sin = np.cos(sensor.elevation), np.sin(sensor.elevation)
    forward = np.array([0.0, cos, -sin])
    right = np.array([1.0, 0.0, 0.0])
    focal = 0.5 * width / np.tan(0.5 * sensor.field_of_view)
    return np.stack([right, np.cross(forward, right), forward]), float(focal)


def _rays(scene: Scene, width: int, height: int) -> tuple[FloatArray, FloatArray]:
    """Return the sensor's origin, and the rays' directions per metre of depth, row by row."""
    sensor = scene.sensor
    target = np.array([0.0, 0.0, scene.block.height])
    (right, down, forward), focal = _camera(scene, width)
    columns = (np.arange(width) + 0.5 - 0.5 * width) / focal
    rows = (np.arange(height) + 0.5 - 0.5 * height) / focal
    directions = (forward + columns[None, :, None] * right + rows[:, None, None] * down).reshape(
        -1, 3
    )
    return target - sensor.distance * forward, directions


def _cast_static(
    scene: Scene, origin: FloatArray, directions: FloatArray, *, with_block: bool
) -> tuple[FloatArray, BoolArray]:
    """Return each ray's depth in the undented scene (NaN: none), and whether it meets the top."""
    block = scene.block
    cos, sin = np.cos(block.yaw), np.sin(block.yaw)
    to_block = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
    start, along = to_block @ origin, directions @ to_block.T
    low = np.array([-0.5 * block.length, -0.5 * block.width, 0.0])
    high = np.array([0.5 * block.length, 0.5 * block.width, block.height])
    with np.errstate(divide='ignore'):
        inverse = 1.0 / along
    near = np.minimum((low - start) * inverse, (high - start) * inverse)
    far = np.maximum((low - start) * inverse, (high - start) * inverse)
    entry, leave = near.max(axis=1), far.min(axis=1)
    hits_block = (entry <= leave) & (entry > 0.0) & with_block
    on_top = hits_block & (near.argmax(axis=1) == 2)

    with np.errstate(divide='ignore'):
        to_plane = -origin[2] / directions[:, 2]
    on_plane = origin[:2] + to_plane[:, None] * directions[:, :2]
    hits_plane = (to_plane > 0.0) & np.all(
        np.abs(on_plane) <= 0.5 * scene.sensor.table_size, axis=1
    )
    depth = np.where(hits_block, entry, np.where(hits_plane, to_plane, np.nan))
    return depth, on_top
