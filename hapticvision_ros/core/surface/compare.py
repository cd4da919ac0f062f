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
How far a simulated surface is from the measured cloud, and how much of that is the sensor's noise.

The noise of the returns, along the normal where each is compared, adds to the distance of a true
surface as an independent part: ``rms^2 = shape^2 + noise^2``. So a share ``noise^2 / rms^2`` of
the mean square is noise, and only the rest is the shape's. A percentile or the largest distance
has no such sum; what noise alone would give is stated beside them.
"""

from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.surface.cloud import Seen
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
import numpy as np
from numpy.typing import NDArray

type BoolArray = NDArray[np.bool_]

_PERCENTILE: Final = 95.0
_OF_NORMAL: Final = 1.959964
"""Half the width of the interval that holds 95 % of a normal distribution."""
_NEAR: Final = 1.5
"""A place of the surface was seen if a return is this near beside it, in spacings of returns."""


@dataclass(frozen=True, slots=True, eq=False)
class Comparison:
    """
    A measured cloud beside a simulated surface.

    Parameters
    ----------
    t : float
        When it was seen [s].
    distance : ndarray, shape (n,)
        Of each return from the surface, along its normal, positive outside [m].
    noise : float
        Root mean square of what the sensor's noise adds to it [m].
    shift : float
        Mean distance: a surface that is too small as a whole has a positive one [m].
    rms : float
        Root mean square of the distances [m].
    percentile_95 : float
        What 95 % of their sizes are below [m].
    largest : float
        The largest of them: the directed Hausdorff distance of the cloud from the surface [m].
    surface_largest, surface_percentile_95 : float or None
        The same of the seen places of the surface from the nearest return [m]; never less than
        about half the returns' spacing. None where no place of the surface was seen before.
    spacing : float
        Usual distance of neighbouring returns [m].

    """

    t: float
    distance: FloatArray
    noise: float
    shift: float
    rms: float
    percentile_95: float
    largest: float
    surface_largest: float | None
    surface_percentile_95: float | None
    spacing: float

    @property
    def noise_share(self) -> float:
        """Return which share of the mean square the sensor's noise makes [-], at most 1."""
        return 1.0 if self.rms <= self.noise else (self.noise / self.rms) ** 2

    @property
    def beyond_noise(self) -> float:
        """Return what is left of the rms without the noise [m]."""
        return math.sqrt(max(self.rms**2 - self.noise**2, 0.0))

    @property
    def hausdorff(self) -> float | None:
        """Return the Hausdorff distance between the cloud and what was seen of the surface [m]."""
        return None if self.surface_largest is None else max(self.largest, self.surface_largest)

    @property
    def noise_percentile_95(self) -> float:
        """Return what noise alone would give for `percentile_95` [m]."""
        return _OF_NORMAL * self.noise

    @property
    def noise_largest(self) -> float:
        """Return what noise alone would about give for `largest` [m]."""
        # The median of the largest of n sizes of a normal distribution.
        from scipy.special import ndtri

        share = 0.5 ** (1.0 / max(self.distance.size, 1))
        return self.noise * float(ndtri(0.5 + 0.5 * share))


def compare(seen: Seen, surface: Mesh, of_surface: BoolArray | None = None) -> Comparison:
    """
    Hold a cloud against a surface.

    Parameters
    ----------
    seen : Seen
        The cloud, in the frame of the surface.
    surface : Mesh
        The simulated surface at that time.
    of_surface : ndarray of bool, shape (m,), optional
        Which of its triangles the sensor can see, see `seen_triangles`; without it the cloud is
        compared with the surface, and not the surface with the cloud.

    Returns
    -------
    Comparison
        Distances, and what noise makes of them.

    """
    found = nearest(seen.points, surface)
    sizes = np.abs(found.distance)
    noise = seen.noise(surface.normals[found.triangle])
    back = None
    if of_surface is not None and of_surface.any():
        from scipy.spatial import cKDTree

        back = np.asarray(cKDTree(seen.points).query(surface.centres[of_surface])[0])
    return Comparison(
        t=seen.t,
        distance=found.distance,
        noise=math.sqrt(float(np.mean(noise**2)) + seen.plane_std**2),
        shift=float(found.distance.mean()),
        rms=math.sqrt(float(np.mean(found.distance**2))),
        percentile_95=float(np.percentile(sizes, _PERCENTILE)),
        largest=float(sizes.max()),
        surface_largest=None if back is None else float(back.max()),
        surface_percentile_95=None if back is None else float(np.percentile(back, _PERCENTILE)),
        spacing=seen.spacing,
    )


def seen_triangles(before: Seen, rest: Mesh) -> BoolArray:
    """
    Return which triangles of a surface have returns beside them before the push.

    Material that was seen then is expected to be seen again: a simulation moves it, but does not
    say from where the sensor looks.

    Parameters
    ----------
    before : Seen
        The object before the push.
    rest : Mesh
        The surface at rest.

    Returns
    -------
    ndarray of bool, shape (m,)

    """
    from scipy.spatial import cKDTree

    reach = _NEAR * before.spacing
    beyond = max(rest.spacing, reach)
    away, index = cKDTree(before.points).query(
        rest.centres, distance_upper_bound=math.hypot(reach, beyond)
    )
    found = np.isfinite(away)
    offset = before.points[np.where(found, index, 0)] - rest.centres
    along = np.abs(np.sum(offset * rest.normals, axis=1))
    # A return may be off the surface, as far as the simulated object is coarse, but not beside it.
    beside = np.sqrt(np.maximum(np.sum(offset**2, axis=1) - along**2, 0.0))
    return np.asarray(found & (along < beyond) & (beside < reach))
