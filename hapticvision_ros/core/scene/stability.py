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
Whether a push tips or slides the object, or slips off it.

The tool touches one point; its force lies between the push direction and the surface's own
normal, whatever the friction of the tool is: both ends are looked at. The object stands if the
resultant of that force and its weight meets the support plane inside its base, and stays in place
if the resultant's slope is within the friction of the support.
"""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.body import Body
from hapticvision_ros.core.scene.surface import Surface
import numpy as np


@dataclass(frozen=True, slots=True)
class PushSettings:
    """
    What pushes and what holds.

    Parameters
    ----------
    force : float
        Largest force of the push [N].
    mass : float
        Mass of the object [kg]; zero if it is not known: nothing is then counted on.
    support_friction, tool_friction : float
        Coefficients of Coulomb friction under the object and under the tool.
    base_margin : float
        The resultant must meet the plane this far inside the base [m].
    base_height : float
        Points of the object lower than this tell where it touches the plane [m].
    largest_gap : float
        Where the base was not seen over a larger angle than this, the outline stands in for it
        [rad].

    """

    force: float = 20.0
    mass: float = 0.0
    support_friction: float = 0.3
    tool_friction: float = 0.3
    base_margin: float = 0.002
    base_height: float = 0.01
    largest_gap: float = 2.1


DEFAULT_PUSH: Final = PushSettings()
_LEAST_FEET: Final = 8
GRAVITY: Final = 9.80665
"""Standard acceleration of free fall [m/s^2]."""


@dataclass(frozen=True, slots=True)
class Stability:
    """
    How far the push is from tipping, sliding and slipping.

    Parameters
    ----------
    base_distance : float
        How far inside its base the object is pushed down [m], at worst.
    slope, friction : float
        Largest ratio of horizontal to vertical load, and what the support's friction carries.
    surface_angle, tool_angle : float
        Angle of the surface against the push, and up to which the tool's friction holds [rad].
    base_seen : bool
        Whether the base was seen around the object; else its outline stands in.

    """

    base_distance: float
    slope: float
    friction: float
    surface_angle: float
    tool_angle: float
    base_seen: bool


def find_base(
    surface: Surface, body: Body, settings: PushSettings = DEFAULT_PUSH
) -> tuple[FloatArray, bool]:
    """
    Return where the object touches the support plane.

    Parameters
    ----------
    surface : Surface
        The object in the support plane's frame.
    body : Body
        Its map of heights.
    settings : PushSettings
        How low a point must be.

    Returns
    -------
    base : ndarray, shape (n, 2)
        Corners of a convex polygon, anticlockwise [m].
    seen : bool
        Whether it comes from low points; else it is the hull of the outline.

    """
    from scipy.spatial import ConvexHull

    feet = surface.points[surface.points[:, 2] < settings.base_height, :2]
    seen = False
    if len(feet) >= _LEAST_FEET and np.ptp(feet, axis=0).min() > 0.0:
        # Around their own middle: what leans stands on a foot that is not below its own.
        corners = feet[ConvexHull(feet).vertices]
        angles = np.sort(np.arctan2(*(feet - _centroid(corners)).T[::-1]))
        gaps = np.diff(np.append(angles, angles[:1] + 2.0 * np.pi))
        seen = float(gaps.max()) < settings.largest_gap
    if not seen:
        x, y = body.centres()
        # The middles of the cells at the border lie on the border.
        feet = np.stack((x[body.inside], y[body.inside]), axis=1)
    return feet[ConvexHull(feet).vertices], seen


def check_push(
    body: Body,
    base: FloatArray,
    base_seen: bool,
    contact: FloatArray,
    normal: FloatArray,
    settings: PushSettings = DEFAULT_PUSH,
) -> Stability:
    """
    Check a push against the support plane's normal.

    Parameters
    ----------
    body : Body
        The object, in the support plane's frame.
    base : ndarray, shape (n, 2)
        Where it touches the plane, anticlockwise [m].
    base_seen : bool
        Whether that was seen.
    contact : ndarray, shape (3,)
        The contact point [m].
    normal : ndarray, shape (3,)
        Outward unit normal of the surface there.
    settings : PushSettings
        Forces and frictions.

    Returns
    -------
    Stability
        How far the push is from failing.

    """
    angle = float(np.arccos(np.clip(normal[2], -1.0, 1.0)))
    tool_angle = float(np.arctan(settings.tool_friction))
    weight = settings.mass * GRAVITY
    gravity = body.centre_of_gravity[:2]
    distances, slopes = [], []
    for force in (np.array([0.0, 0.0, -1.0]), -normal):
        load = settings.force * force
        down = weight - load[2]
        if down <= 0.0:
            distances.append(-np.inf)
            slopes.append(np.inf)
            continue
        foot = contact[:2] * -load[2] + contact[2] * load[:2] + weight * gravity
        distances.append(_inside(base, foot / down))
        slopes.append(float(np.hypot(load[0], load[1]) / down))
    return Stability(
        min(distances), max(slopes), settings.support_friction, angle, tool_angle, base_seen
    )


def refuse_unstable(stability: Stability, settings: PushSettings = DEFAULT_PUSH) -> None:
    """
    Refuse a push that would fail.

    Raises
    ------
    InputError
        With the reason in one sentence.

    """
    if stability.surface_angle > stability.tool_angle:
        raise InputError(
            'The tool would slip: the surface at the contact point is inclined by '
            f'{np.rad2deg(stability.surface_angle):.0f} deg to the push, its friction of '
            f'{settings.tool_friction:g} holds up to {np.rad2deg(stability.tool_angle):.0f} deg; '
            'turn the object, or use a rougher tool (tool_friction).'
        )
    if stability.base_distance < settings.base_margin:
        where = (
            f'{-stability.base_distance * 1e3:.1f} mm outside'
            if stability.base_distance < 0.0
            else f'only {stability.base_distance * 1e3:.1f} mm inside'
        )
        raise InputError(
            f'The push would tip the object: at {settings.force:g} N the load meets the support '
            f'plane {where} its base, {settings.base_margin * 1e3:.1f} mm inside are needed; '
            'lay the object on a broader side, or fix it.'
        )
    if stability.slope > stability.friction:
        raise InputError(
            f'The push would slide the object: its load is inclined by {stability.slope:.2f}, '
            f'friction under the object holds {stability.friction:g}; turn the object, or put it '
            'on a rougher plate (support_friction).'
        )


def _centroid(corners: FloatArray) -> FloatArray:
    """Return the mass centre of a convex polygon."""
    following = np.roll(corners, -1, axis=0)
    cross = corners[:, 0] * following[:, 1] - following[:, 0] * corners[:, 1]
    centre: FloatArray = (corners + following).T @ cross / (3.0 * cross.sum())
    return centre


def _inside(corners: FloatArray, point: FloatArray) -> float:
    """Return how far inside a convex polygon a point is [m]; negative outside."""
    edge = np.roll(corners, -1, axis=0) - corners
    inward = np.stack((-edge[:, 1], edge[:, 0]), axis=1)
    length = np.hypot(edge[:, 0], edge[:, 1])
    distance = np.sum((point - corners) * inward, axis=1) / length
    return float(distance.min())
