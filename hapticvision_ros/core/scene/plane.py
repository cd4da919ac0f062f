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

"""The support plane: found in one cloud, without trust in any frame."""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.core.scene.settings import DEFAULT_PLANNING, PlanningSettings
import numpy as np

VERTICAL: Final = (0.0, 0.0, 1.0)

LARGEST_OFFSET: Final = 0.005
"""Points this near to a plane [m] may be of it, also while its tilt is not known yet."""

_LARGEST_SHARE_BELOW: Final = 0.02
_PLANE_SAMPLE: Final = 4000
_PLANE_HYPOTHESES: Final = 256
_REFINEMENTS: Final = 3
_AS_NEAR: Final = 1.2
_FINEST: Final = 2e-5
"""Distance of a plane's points from it over what it was, and one that is no matter [m]."""


@dataclass(frozen=True, slots=True)
class SupportPlane:
    """
    The plane that the object lies on: ``normal . p = offset``, the object on the normal's side.

    Parameters
    ----------
    normal : tuple of float
        Unit normal.
    offset : float
        Distance of the plane from the origin along the normal [m].
    share : float
        Share of the points that lie in the plane.
    noise : float
        Root mean square distance of those points from it [m].

    """

    normal: tuple[float, float, float]
    offset: float
    share: float
    noise: float

    @property
    def tilt(self) -> float:
        """Angle between the normal and +z [rad]."""
        x, y, z = self.normal
        return float(np.arctan2(np.hypot(x, y), z))

    def to_plane_frame(self) -> tuple[FloatArray, FloatArray]:
        """
        Return rotation and shift that bring points into the plane's own frame.

        Returns
        -------
        rotation : ndarray, shape (3, 3)
        shift : ndarray, shape (3,)
            ``p @ rotation.T + shift`` has z along the normal and z = 0 in the plane; the
            rotation is the smallest one that does it.

        """
        normal = np.array(self.normal)
        axis = np.cross(normal, VERTICAL)
        cosine = float(normal[2])
        if cosine < -1.0 + 1e-9:
            rotation = np.diag((1.0, -1.0, -1.0))
        else:
            skew = np.array(
                [
                    [0.0, -axis[2], axis[1]],
                    [axis[2], 0.0, -axis[0]],
                    [-axis[1], axis[0], 0.0],
                ]
            )
            rotation = np.eye(3) + skew + skew @ skew / (1.0 + cosine)
        return rotation, np.array([0.0, 0.0, -self.offset])


def finite_points(xyz: PointArray) -> PointArray:
    """Return the returns of a cloud, shape (n, 3): the points without NaN and Inf (REP-117)."""
    flat = xyz.reshape(-1, 3)
    return flat[np.isfinite(flat).all(axis=1)]


def fit_support_plane(
    points: PointArray | FloatArray,
    settings: PlanningSettings = DEFAULT_PLANNING,
    *,
    seen_from: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> SupportPlane:
    """
    Find the plane that holds most points, and the side on which the object lies.

    Random triples of a subsample propose planes, the one with most points near it is refined by
    least squares. Nothing is seen through the support: a plane with points below it is none. Up
    is +z if the plane z = 0 is such a plane (the contract's frame `support_plane`), else it is
    where the range sensor stands.

    Parameters
    ----------
    points : ndarray of float32, shape (n, 3)
        Finite points [m].
    settings : PlanningSettings
        Tolerance, least share and seed.
    seen_from : tuple of float
        Where the range sensor stands [m]: at the origin of its own frame.

    Returns
    -------
    SupportPlane
        The plane.

    Raises
    ------
    InputError
        If there are too few points, or no plane holds the least share of them.

    References
    ----------
    Fischler & Bolles (1981), doi:10.1145/358669.358692.

    """
    if len(points) < 100:
        raise InputError(
            f'The cloud has only {len(points)} returns: check that the range sensor sees the '
            'support plane.'
        )
    random = np.random.default_rng(settings.seed)
    sample = points[random.integers(len(points), size=_PLANE_SAMPLE)].astype(np.float64)
    levelled = _is_levelled(sample, settings)
    proposers = sample[np.abs(sample[:, 2]) < LARGEST_OFFSET] if levelled else sample
    a, b, c = proposers[random.integers(len(proposers), size=(3, _PLANE_HYPOTHESES))]
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    # Three points that are (nearly) in line propose no plane.
    proper = lengths > 1e-3 * np.linalg.norm(b - a, axis=1) * np.linalg.norm(c - a, axis=1)
    normals = normals[proper] / lengths[proper, None]
    offsets = np.einsum('ij,ij->i', normals, a[proper])
    # Not the sign: three points of one row of a regular grid propose an upright plane, of zero.
    above = normals[:, 2] if levelled else normals @ np.array(seen_from) - offsets
    up = np.where(above < 0.0, -1.0, 1.0)
    normals, offsets = normals * up[:, None], offsets * up
    heights = sample @ normals.T - offsets
    inside = np.abs(heights) < settings.plane_tolerance
    below = np.mean(heights < -LARGEST_OFFSET, axis=0)
    votes = np.where(below < _LARGEST_SHARE_BELOW, np.mean(inside, axis=0), 0.0)
    share = float(votes.max(initial=0.0))
    if share >= settings.least_plane_share:
        best = int(np.argmax(votes))
        normal, offset = normals[best], float(offsets[best])
        for _ in range(_REFINEMENTS):
            inlier = np.abs(sample @ normal - offset) < settings.plane_tolerance
            centre = sample[inlier].mean(axis=0)
            refined = np.linalg.svd(sample[inlier] - centre, full_matrices=False)[2][2]
            normal = refined * np.sign(refined @ normal)
            offset = float(normal @ centre)
        height = sample @ normal - offset
        inlier = np.abs(height) < settings.plane_tolerance
        share = float(inlier.mean())
    if share < settings.least_plane_share:
        raise InputError(
            f'No support plane in the cloud: the best plane holds {share:.0%} of the points, '
            f'{settings.least_plane_share:.0%} are needed.'
        )
    noise = float(np.sqrt(np.mean(height[inlier] ** 2)))
    x, y, z = (float(item) for item in normal)
    return SupportPlane((x, y, z), offset, share, noise)


def still_supports(
    plane: SupportPlane,
    points: PointArray | FloatArray,
    settings: PlanningSettings = DEFAULT_PLANNING,
) -> bool:
    """
    Return whether a plane of an earlier cloud supports this scene as well.

    Parameters
    ----------
    plane : SupportPlane
        The earlier cloud's.
    points : ndarray, shape (n, 3)
        Finite points of this one [m].
    settings : PlanningSettings
        Tolerance and least share.

    Returns
    -------
    bool
        Whether as many points lie in it as a plane needs, as near to it as before, and none below
        it.

    """
    if not len(points):
        return False
    height = points @ np.array(plane.normal) - plane.offset
    inlier = np.abs(height) < settings.plane_tolerance
    if np.mean(inlier) < max(settings.least_plane_share, 0.5 * plane.share):
        return False
    # A sensor that was knocked sees the plane beside where it was, or askew.
    off = abs(float(np.median(height[inlier])))
    spread = float(np.sqrt(np.mean(height[inlier] ** 2)))
    below = float(np.mean(height < -LARGEST_OFFSET))
    return (
        off < 0.1 * settings.plane_tolerance
        and spread < max(_AS_NEAR * plane.noise, _FINEST)
        and below < _LARGEST_SHARE_BELOW
    )


def _is_levelled(points: FloatArray, settings: PlanningSettings) -> bool:
    """Return whether the plane z = 0 supports the scene, as in the contract's frame."""
    z = points[:, 2]
    on_plane = float(np.mean(np.abs(z) < LARGEST_OFFSET))
    below = float(np.mean(z < -LARGEST_OFFSET))
    return on_plane >= settings.least_plane_share and below < _LARGEST_SHARE_BELOW
