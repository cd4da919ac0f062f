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
What a shape tells in a few numbers: what stays, what comes back, the sides' bulge, the volume.

The paper's Table 4 splits the depth of the push in two: the residual deformation is what is left
at the end of the recovery, the bouncing deformation the rest, all that came back since the
release; in all its rows, measured and simulated, the two add up to the depth. A part of the
bouncing comes back while the tool leaves, before anything is seen of it; it is told apart.

Measured and simulated are taken from the surface in the same way: the median height within a
small radius of the tool's axis, before the push less after it. A number that cannot be seen is
unknown, with the reason.

References
----------
Paper, section 4.2 with Table 4.

"""

from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.records import Estimate, FloatArray
from hapticvision_ros.core.surface.cloud import Observation, Seen
from hapticvision_ros.core.surface.compare import seen_triangles
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.surface.raster import height_map
import numpy as np
from numpy.typing import NDArray

type BoolArray = NDArray[np.bool_]

PATCH_RADIUS: Final = 0.005
"""The height at the tool's axis is the median within this distance of it [m]."""
_LEAST_POINTS: Final = 12
_MEDIAN: Final = 1.2533
"""Standard error of a median over that of a mean, of a normal distribution."""
_PATCH_CELLS: Final = 21
_UPRIGHT: Final = 0.5
"""A triangle whose normal rises by less than this is of a side."""
_BAND: Final = (0.2, 0.8)
"""Shares of the object's height between which a side bulges."""
_LEAST_SIDE: Final = 30
_LEAST_CELLS: Final = 20


@dataclass(frozen=True, slots=True)
class Height:
    """The depth of the dent at one time [s]: measured and simulated [m]."""

    t: float
    measured: Estimate
    simulated: Estimate


@dataclass(frozen=True, slots=True)
class Pair:
    """A measured quantity beside the simulated one, in one SI unit."""

    measured: Estimate
    simulated: Estimate


@dataclass(frozen=True, slots=True)
class Deformation:
    """
    The shape's numbers for one trial.

    Parameters
    ----------
    heights : tuple of Height
        Depth of the dent at the times at which the free object was looked at.
    residual : Pair
        What is left at the last of them [m].
    bouncing : Pair
        Depth of the push less the residual [m].
    at_once : Pair
        The part of it that had come back when the dent was first seen [m].
    bulge : Pair
        How far the sides stand out on average at the last time, more than before the push [m].
    volume_change : Pair
        Of the part of the object that was seen from above both before and last [m^3].
    seen_area : float
        How much of the top view that is [m^2].

    """

    heights: tuple[Height, ...]
    residual: Pair
    bouncing: Pair
    at_once: Pair
    bulge: Pair
    volume_change: Pair
    seen_area: float


def measure(
    observed: Observation,
    rest: Mesh,
    surfaces: tuple[Mesh, ...],
    *,
    depth: Estimate,
    simulated_depth: float,
) -> Deformation:
    """
    Return the numbers of a trial, measured and simulated.

    Parameters
    ----------
    observed : Observation
        The object's clouds.
    rest : Mesh
        The simulated surface before the push.
    surfaces : tuple of Mesh
        The simulated surface at the times of ``observed.after``, with the same triangles.
    depth : Estimate
        Measured depth of the push at the release [m].
    simulated_depth : float
        The same of the simulation [m].

    Returns
    -------
    Deformation
        All of them; unknown with the reason where they were not seen.

    """
    before = patch_height(observed.before)
    start = mesh_height(rest)
    heights = tuple(
        Height(
            seen.t,
            _less(before, patch_height(seen)),
            _less(start, mesh_height(surface)),
        )
        for seen, surface in zip(observed.after, surfaces, strict=True)
    )
    residual = Pair(heights[-1].measured, heights[-1].simulated)
    first = Pair(heights[0].measured, heights[0].simulated)
    pressed = Estimate(simulated_depth, 0.0)
    change, area = _volume_change(observed, rest, surfaces[-1])
    return Deformation(
        heights=heights,
        residual=residual,
        bouncing=Pair(_less(depth, residual.measured), _less(pressed, residual.simulated)),
        at_once=Pair(_less(depth, first.measured), _less(pressed, first.simulated)),
        bulge=_bulge(observed, rest, surfaces[-1]),
        volume_change=change,
        seen_area=area,
    )


def patch_height(seen: Seen) -> Estimate:
    """Return the height of the surface at the tool's axis, from returns [m]."""
    near = np.hypot(seen.points[:, 0], seen.points[:, 1]) < PATCH_RADIUS
    count = int(np.count_nonzero(near))
    if count < _LEAST_POINTS:
        return Estimate.unknown(
            f'the surface at the contact point is not seen: {count} returns within '
            f'{1e3 * PATCH_RADIUS:g} mm, {_LEAST_POINTS} are needed'
        )
    height = seen.points[near, 2]
    # The scatter within the patch holds noise and shape: an upper bound of the error.
    spread = _MEDIAN * float(height.std()) / math.sqrt(count)
    return Estimate(float(np.median(height)), math.hypot(spread, seen.plane_std))


def mesh_height(surface: Mesh) -> Estimate:
    """Return the height of a surface at the tool's axis, in the same way [m]."""
    cell = 2.0 * PATCH_RADIUS / _PATCH_CELLS
    low = -PATCH_RADIUS, -PATCH_RADIUS
    heights = height_map(surface, low, cell, (_PATCH_CELLS, _PATCH_CELLS))
    middle = (np.arange(_PATCH_CELLS) + 0.5) * cell - PATCH_RADIUS
    inside = np.hypot(*np.meshgrid(middle, middle)) < PATCH_RADIUS
    found = heights[inside & np.isfinite(heights)]
    if not found.size:
        return Estimate.unknown('the simulated object does not reach under the tool')
    return Estimate(float(np.median(found)), 0.0)


def _less(minuend: Estimate, subtrahend: Estimate) -> Estimate:
    """Return a difference with its standard error; unknown where either is."""
    for one in (minuend, subtrahend):
        if one.value is None:
            return Estimate.unknown(one.reason or 'it was not seen')
    assert minuend.value is not None
    assert subtrahend.value is not None
    if minuend.std is None or subtrahend.std is None:
        return Estimate(minuend.value - subtrahend.value)
    return Estimate(minuend.value - subtrahend.value, math.hypot(minuend.std, subtrahend.std))


def of_sides(rest: Mesh, band: tuple[float, float] = _BAND) -> BoolArray:
    """Return which triangles are of the sides, between these shares of the height."""
    top = float(rest.points[:, 2].max())
    z = rest.centres[:, 2]
    return np.asarray(
        (np.abs(rest.normals[:, 2]) < _UPRIGHT) & (z > band[0] * top) & (z < band[1] * top)
    )


def _bulge(observed: Observation, rest: Mesh, last: Mesh) -> Pair:
    """Return how far the sides stand out more than before the push."""
    side = of_sides(rest)
    means, errors = [], []
    for seen in (observed.before, observed.after[-1]):
        found = nearest(seen.points, rest)
        chosen = side[found.triangle]
        count = int(np.count_nonzero(chosen))
        if count < _LEAST_SIDE:
            unseen = Estimate.unknown(
                f'no side of the object is seen: {count} returns, {_LEAST_SIDE} are needed'
            )
            return Pair(unseen, unseen)
        noise = seen.noise(rest.normals[found.triangle])[chosen]
        means.append(float(found.distance[chosen].mean()))
        errors.append(math.sqrt(float(np.mean(noise**2)) / count))
    measured = Estimate(means[1] - means[0], math.hypot(*errors))
    where = np.flatnonzero(side & seen_triangles(observed.before, rest))
    if not where.size:
        unseen = Estimate.unknown('the sides of the simulated object are not those that are seen')
        return Pair(measured, unseen)
    moved = nearest(last.centres[where], rest).distance
    return Pair(measured, Estimate(float(np.average(moved, weights=rest.areas[where])), 0.0))


@dataclass(frozen=True, slots=True, eq=False)
class Levels:
    """
    By how much the top has risen, in the cells of a map.

    Parameters
    ----------
    low : ndarray, shape (2,)
        The map's first corner [m].
    cell : float
        Side of its cells [m].
    seen : ndarray of bool, shape (rows, columns)
        Which were seen both before the push and at the last look, and are of the simulated body.
    measured, variance, simulated : ndarray, shape (rows, columns)
        [m], [m^2], [m]

    """

    low: FloatArray
    cell: float
    seen: BoolArray
    measured: FloatArray
    variance: FloatArray
    simulated: FloatArray

    @property
    def middles(self) -> tuple[FloatArray, FloatArray]:
        """Return x and y of the cells' middles, shape (rows, columns) each [m]."""
        rows, columns = self.seen.shape
        x, y = np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5)
        return self.low[0] + self.cell * x, self.low[1] + self.cell * y


def levels(observed: Observation, rest: Mesh, last: Mesh) -> Levels:
    """Return by how much the top has risen from before the push to the last look."""
    cell = max(1.5 * observed.before.spacing, 1e-3)
    both = np.concatenate((observed.before.points, observed.after[-1].points))
    low = both[:, :2].min(axis=0) - 0.5 * cell
    count = (np.ceil((both[:, :2].max(axis=0) - low) / cell) + 1).astype(np.intp)
    shape = int(count[1]), int(count[0])
    before, before_variance = _upper_heights(observed.before, low, cell, shape)
    after, after_variance = _upper_heights(observed.after[-1], low, cell, shape)
    corner = float(low[0]), float(low[1])
    old, new = (height_map(one, corner, cell, shape) for one in (rest, last))
    seen = np.isfinite(before) & np.isfinite(after) & np.isfinite(old) & np.isfinite(new)
    return Levels(low, cell, seen, after - before, before_variance + after_variance, new - old)


def _volume_change(observed: Observation, rest: Mesh, last: Mesh) -> tuple[Pair, float]:
    """Return by how much the seen part of the object has lost or gained, and its area."""
    maps = levels(observed, rest, last)
    cell, seen = maps.cell, int(np.count_nonzero(maps.seen))
    area = seen * cell**2
    if seen < _LEAST_CELLS:
        unseen = Estimate.unknown(f'too little of the top is seen: {1e4 * area:.3g} cm^2')
        return Pair(unseen, unseen), area
    change = float(np.sum(maps.measured[maps.seen])) * cell**2
    scatter = math.sqrt(float(np.sum(maps.variance[maps.seen]))) * cell**2
    level = area * math.hypot(observed.before.plane_std, observed.after[-1].plane_std)
    return Pair(
        Estimate(change, math.hypot(scatter, level)),
        Estimate(float(np.sum(maps.simulated[maps.seen])) * cell**2, 0.0),
    ), area


def _upper_heights(
    seen: Seen, low: FloatArray, cell: float, shape: tuple[int, int]
) -> tuple[FloatArray, FloatArray]:
    """Return the height of the uppermost surface in the cells of a map, and its variance."""
    place = np.floor((seen.points[:, :2] - low) / cell).astype(np.intp)
    flat = place[:, 1] * shape[1] + place[:, 0]
    size = shape[0] * shape[1]
    top = np.full(size, -np.inf)
    np.maximum.at(top, flat, seen.points[:, 2])
    # A cell at a wall holds returns of the whole wall; its surface is what is on top.
    upper = seen.points[:, 2] > top[flat] - cell
    count = np.bincount(flat[upper], minlength=size)
    up = np.zeros_like(seen.points)
    up[:, 2] = 1.0
    with np.errstate(invalid='ignore', divide='ignore'):
        mean = np.bincount(flat[upper], seen.points[upper, 2], minlength=size) / count
        variance = np.bincount(flat[upper], seen.noise(up)[upper] ** 2, minlength=size)
        variance = variance / count.astype(np.float64) ** 2
    return mean.reshape(shape), variance.reshape(shape)
