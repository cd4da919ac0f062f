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

"""What counts as plane, object and surface when a scene is taken apart."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class PlanningSettings:
    """
    What counts as plane, object and contact point.

    Parameters
    ----------
    plane_tolerance : float
        Half thickness of the plane [m]: a few times the sensor's noise.
    least_plane_share : float
        Smallest share of the points that must lie in the plane.
    object_clearance : float
        Points higher than this above the plane belong to an object [m].
    cell_size : float
        Side of a cell of the top-view grid [m].
    closing_cells : int
        Gaps of up to this many cells in the top view are closed (dropouts, a tool's shadow).
    least_area : float
        Smallest top-view area of an object [m^2]; smaller patches are taken for noise.
    patch_radius : float
        The surface's height is the median within this distance of the vertical [m].
    least_patch_points : int
        Fewest points in that patch.
    seed : int
        Seed of the random choice of points for the plane.

    """

    plane_tolerance: float = 0.002
    least_plane_share: float = 0.1
    object_clearance: float = 0.004
    cell_size: float = 0.002
    closing_cells: int = 3
    least_area: float = 4e-4
    patch_radius: float = 0.005
    least_patch_points: int = 12
    seed: int = 0


DEFAULT_PLANNING: Final = PlanningSettings()
