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
Where a tool has pushed, from the dent that it left in what the range sensor shows.

A round tool makes a dent whose depth falls with the distance from its axis, whatever its profile.
The axis is that around which a falling profile of any form follows the depths best: parts of the
dent that are hidden, as behind a rim, do not pull it aside as they would pull its mass centre.
"""

from collections.abc import Sequence
from typing import Final

from hapticvision_ros.core.records import FloatArray, PointArray
import numpy as np
from scipy.interpolate import LinearNDInterpolator
from scipy.optimize import isotonic_regression, minimize
from scipy.spatial import QhullError

_FEWEST: Final = 20
"""Fewest depths that tell an axis."""
_DEEP: Final = 0.98
"""Quantile of its depths that is taken for how deep a dent is."""
_FINELY: Final = 1e-5
"""How finely the axis is looked for [m]."""
_LOOKS: Final = 9
"""Axes that are tried along each side of the region, before the best is refined."""
_BEGUN: Final = 250
"""Depths of a frame by which they are compared."""
_CLEAR: Final = 3.0
"""Depth of a dent that tells its axis, in standard deviations of the depths around its profile."""
_TOLD: Final = 20.0
"""Gain in the deviance of one frame that tells an axis from the one that was planned."""
_PLANES: Final = 2
"""How often plane and profile are taken out in turn."""
_ASKEW: Final = 0.5
"""Part of the squares that a plane leaves where something tilts."""
_AS_WELL: Final = 4.0
"""Gain in the deviance of one frame that an axis has where a plane is taken out as well."""
_EDGE: Final = 4e-3
"""What was lower by more than this beside the axis is no top of the object [m]."""
_ABOVE: Final = 1e-3
"""What is higher than the original surface by more is the tool [m]."""
_MOST_ABOVE: Final = 0.01
"""Share of the points that may be so high by chance, as at edges."""


def find_dent_axis(
    before: Sequence[tuple[PointArray | FloatArray, float]],
    after: Sequence[tuple[PointArray | FloatArray, float]],
    start: tuple[float, float],
    reach: float,
) -> tuple[float, float] | None:
    """
    Find the vertical axis of a dent.

    Parameters
    ----------
    before, after : sequence of (ndarray, float)
        Points of the surface before the push and with the dent, shape (n, 3), z up, and the
        height of the tool's tip then [m].
    start : tuple of float
        Where the axis was thought to be [m].
    reach : float
        How far from there it may be, and the radius within which the dent is looked at [m].

    Returns
    -------
    tuple of float or None
        x and y of the axis [m]; None where there is no clear dent, or where the one at `start`
        is as good.

    """
    # Higher up may be the tool.
    original = _within(
        [points[points[:, 2] < tool] for points, tool in before], start, 2.0 * reach
    )
    near_start = _within([original], start, 0.5 * reach)
    if len(near_start) < _FEWEST or not after:
        return None
    level = float(np.median(near_start[:, 2]))
    # Lower down is what the object lies on.
    lowest = min(tool for _, tool in after) - _EDGE
    try:
        surface = LinearNDInterpolator(original[:, :2] - start, original[:, 2])
    except QhullError:
        return None
    dents = []
    for points, tool in after:
        near = _within([points], start, reach)
        place = near[:, :2] - start
        was = surface(place)
        depth = was - near[:, 2]
        known = np.isfinite(depth) & (was > level - _EDGE) & (near[:, 2] > lowest)
        above = known & (depth < -_ABOVE)
        if tool < level + _ABOVE and np.count_nonzero(above) > _MOST_ABOVE * depth.size:
            # What of it is below the original surface is none of the dent.
            continue
        known &= ~above
        if np.count_nonzero(known) >= _FEWEST:
            dents.append((place[known], depth[known]))
    if not dents:
        return None

    # To begin with, some of the depths do.
    few = [
        (place[:: 1 + depth.size // _BEGUN], depth[:: 1 + depth.size // _BEGUN])
        for place, depth in dents
    ]

    def squares(
        axis: FloatArray, planes: int, of: Sequence[tuple[FloatArray, FloatArray]] = dents
    ) -> float:
        total = 0.0
        for place, depth in of:
            order = np.argsort(np.hypot(*(place - axis).T))
            x, y = place[order].T
            left = depth[order]
            for _ in range(planes):
                left = left - _plane(x, y, left - _profile(left))
            total += float(np.sum((left - _profile(left)) ** 2))
        return total

    ticks = np.linspace(-reach, reach, _LOOKS)
    looks = [np.array([x, y]) for x in ticks for y in ticks if np.hypot(x, y) <= reach]
    triangle = 0.25 * (ticks[1] - ticks[0]) * np.array([[-1.0, -1.0], [1.0, -1.0], [0.0, 1.0]])

    def best(planes: int) -> tuple[FloatArray, float, float]:
        """Return the best axis, the squares around it and those around the start."""
        begin = min(looks, key=lambda axis: squares(axis, planes, few))
        found = minimize(
            squares,
            begin,
            args=(planes,),
            method='Nelder-Mead',
            options={'initial_simplex': begin + triangle, 'xatol': _FINELY, 'fatol': np.inf},
        )
        return found.x, float(found.fun), squares(np.zeros(2), planes)

    axis, left, planned = best(0)
    askew = best(_PLANES)
    count = sum(depth.size for _, depth in dents) / len(dents)
    if askew[1] < _ASKEW * left:
        # A sensor or an object that tilts makes a plane of depths.
        axis, left, planned = askew
    elif count * np.log(askew[2] / squares(axis, _PLANES)) < _AS_WELL:
        # What only a plane would move is no dent.
        return None
    noise = np.sqrt(left / (count * len(dents)))
    if noise <= 0.0:
        return None
    deepest = max(float(np.quantile(depth, _DEEP)) for _, depth in dents)
    if (
        deepest < _CLEAR * noise
        or np.hypot(*axis) > reach
        or count * np.log(planned / left) < _TOLD
    ):
        return None
    return float(start[0] + axis[0]), float(start[1] + axis[1])


def _profile(depth: FloatArray) -> FloatArray:
    """Return the profile that falls and follows depths best, nearest to the axis first [m]."""
    return np.asarray(isotonic_regression(depth, increasing=False).x)


def _plane(x: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    """Return the heights of the plane through the origin that fits best [m]."""
    # Sums, since threads of a library for matrices wait for each other longer than this takes.
    xx, xy, yy = np.sum(x * x), np.sum(x * y), np.sum(y * y)
    xz, yz = np.sum(x * z), np.sum(y * z)
    determinant = xx * yy - xy * xy
    if not determinant > 0.0:
        return np.zeros(z.size)
    return np.asarray(((yy * xz - xy * yz) * x + (xx * yz - xy * xz) * y) / determinant)


def _within(
    clouds: Sequence[PointArray | FloatArray], axis: tuple[float, float], radius: float
) -> FloatArray:
    """Return the points of clouds within a radius of an axis [m]."""
    if not clouds:
        return np.empty((0, 3))
    points = np.concatenate([np.asarray(cloud, dtype=np.float64) for cloud in clouds])
    near: FloatArray = points[np.hypot(*(points[:, :2] - axis).T) < radius]
    return near
