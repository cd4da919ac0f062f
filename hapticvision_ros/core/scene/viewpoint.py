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
The viewpoint V_O, from which the dent is to be seen: perpendicular to S, above the horizon.

The paper looks horizontally. From there the rim hides a dent in the middle of a top: the view is
therefore raised, to the least elevation from which the middle of the dent is seen over its rim and
over what else of the object stands in the way.
"""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.body import Body
from hapticvision_ros.core.scene.symmetry import Symmetry
from hapticvision_ros.core.scene.views import Pose
import numpy as np


@dataclass(frozen=True, slots=True)
class ViewSettings:
    """
    What is to be seen, and from how far.

    Parameters
    ----------
    distance : float
        Distance of V_O from the contact point [m].
    least_elevation, largest_elevation : float
        Between which the elevation is chosen [rad].
    dent_depth : float
        Deepest dent to be seen [m].
    tool_radius : float
        Radius of the dent [m].
    patch_radius : float
        Its bottom is to be seen within this distance of the axis [m].

    """

    distance: float = 0.4
    least_elevation: float = float(np.deg2rad(30.0))
    largest_elevation: float = float(np.deg2rad(45.0))
    dent_depth: float = 0.006
    tool_radius: float = 0.0126
    patch_radius: float = 0.005


DEFAULT_VIEW: Final = ViewSettings()


@dataclass(frozen=True, slots=True, eq=False)
class Viewpoint:
    """
    Where to look at the dent from.

    Parameters
    ----------
    pose : Pose
        Of the sensor's optical frame: z towards the contact point, y down (REP-103).
    elevation : float
        Of the view above the support plane [rad].
    needed : float
        From which elevation on all of the dent's middle is seen [rad].
    seen_share : float
        Share of the diameter of the dent's middle that is seen from there.

    """

    pose: Pose
    elevation: float
    needed: float
    seen_share: float


def choose_viewpoint(
    body: Body,
    symmetry: Symmetry,
    contact: FloatArray,
    settings: ViewSettings = DEFAULT_VIEW,
    *,
    near: FloatArray | None = None,
) -> Viewpoint:
    """
    Choose V_O.

    Parameters
    ----------
    body : Body
        The object, in the support plane's frame.
    symmetry : Symmetry
        Its line L.
    contact : ndarray, shape (3,)
        The contact point [m].
    settings : ViewSettings
        What is to be seen.
    near : ndarray, shape (3,), optional
        Of two sides as good, the one of this point is taken [m].

    Returns
    -------
    Viewpoint
        The pose, in the support plane's frame, and its elevation.

    """
    middle = 2.0 * settings.patch_radius
    sides = []
    for turn in (0.5 * np.pi, -0.5 * np.pi):
        azimuth = symmetry.angle + turn
        blocked = _horizon(body, contact, azimuth, settings.tool_radius)
        # The near end of the middle lies `run` behind the rim, the dent's depth below it.
        run = settings.tool_radius - settings.patch_radius
        rim = float(np.arctan2(settings.dent_depth, max(run, 1e-4)))
        needed = max(rim, blocked)
        across = np.array([np.cos(azimuth), np.sin(azimuth)])
        away = 0.0 if near is None else float(across @ (near[:2] - contact[:2]))
        elevation = float(np.clip(needed, settings.least_elevation, settings.largest_elevation))
        # From a degree to a degree the sides are alike, and the nearer one is better.
        sides.append((round(np.rad2deg(elevation)), -away, azimuth, elevation, needed, blocked))
    _, _, azimuth, elevation, needed, blocked = min(sides)
    hidden = settings.dent_depth / np.tan(elevation) - (
        settings.tool_radius - settings.patch_radius
    )
    share = float(np.clip(1.0 - hidden / middle, 0.0, 1.0)) if blocked <= elevation else 0.0
    ahead = -np.array(
        [
            np.cos(azimuth) * np.cos(elevation),
            np.sin(azimuth) * np.cos(elevation),
            np.sin(elevation),
        ]
    )
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    rotation = np.stack((right, np.cross(ahead, right), ahead), axis=1)
    return Viewpoint(Pose(rotation, contact - settings.distance * ahead), elevation, needed, share)


def _horizon(body: Body, contact: FloatArray, azimuth: float, radius: float) -> float:
    """Return the elevation up to which the object hides its own contact point [rad]."""
    x, y = body.centres()
    dx, dy = x - contact[0], y - contact[1]
    ahead = dx * np.cos(azimuth) + dy * np.sin(azimuth)
    aside = -dx * np.sin(azimuth) + dy * np.cos(azimuth)
    # What is under the tool is pressed down.
    in_way = body.inside & (ahead > radius) & (np.abs(aside) < radius)
    if not in_way.any():
        return 0.0
    rise = np.arctan2(body.heights[in_way] - contact[2], ahead[in_way])
    return float(max(np.max(rise), 0.0))
