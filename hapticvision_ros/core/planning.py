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
Where to push: the support plane, the object on it, and the contact point, from one cloud.

The paper takes the vertical through the mass centre of the object's top view, G_top; where it
meets the surface is the contact point P_c, and the tool pushes against the support plane's
normal.
"""

from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
import numpy as np
from numpy.typing import NDArray

type BoolArray = NDArray[np.bool_]

VERTICAL: Final = (0.0, 0.0, 1.0)

LARGEST_OFFSET: Final = 0.005
"""Points this near to a plane [m] may be of it, also while its tilt is not known yet."""

_LARGEST_SHARE_BELOW: Final = 0.02
_PLANE_SAMPLE: Final = 4000
_PLANE_HYPOTHESES: Final = 256
_REFINEMENTS: Final = 3


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


@dataclass(frozen=True, slots=True)
class ContactPlan:
    """
    Where and along what to push.

    Parameters
    ----------
    contact_point : tuple of float
        The paper's P_c [m], in the frame of the points.
    push_direction : tuple of float
        Unit vector of the push: against the support plane's normal.
    object_area : float
        Area of the object's top view, as far as it is seen [m^2].
    object_height : float
        Height of the surface above the support plane at the contact point [m].
    plane : SupportPlane
        The support plane that was found.

    """

    contact_point: tuple[float, float, float]
    push_direction: tuple[float, float, float]
    object_area: float
    object_height: float
    plane: SupportPlane


def finite_points(xyz: PointArray) -> PointArray:
    """Return the returns of a cloud, shape (n, 3): the points without NaN and Inf (REP-117)."""
    flat = xyz.reshape(-1, 3)
    return flat[np.isfinite(flat).all(axis=1)]


def fit_support_plane(
    points: PointArray, settings: PlanningSettings = DEFAULT_PLANNING
) -> SupportPlane:
    """
    Find the plane that holds most points, and the side on which the object lies.

    Random triples of a subsample propose planes, the one with most points near it is refined by
    least squares. Nothing is seen through the support: a plane with points below it is none. Up
    is +z if the plane z = 0 is such a plane (the contract's frame `support_plane`), else it is
    where the origin lies, the range sensor's place in its own frame.

    Parameters
    ----------
    points : ndarray of float32, shape (n, 3)
        Finite points [m].
    settings : PlanningSettings
        Tolerance, least share and seed.

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
    up = np.sign(normals[:, 2] if levelled else -offsets)
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


def _is_levelled(points: FloatArray, settings: PlanningSettings) -> bool:
    """Return whether the plane z = 0 supports the scene, as in the contract's frame."""
    z = points[:, 2]
    on_plane = float(np.mean(np.abs(z) < LARGEST_OFFSET))
    below = float(np.mean(z < -LARGEST_OFFSET))
    return on_plane >= settings.least_plane_share and below < _LARGEST_SHARE_BELOW


def plan_contact(
    xyz: PointArray,
    *,
    ceiling: float | None = None,
    settings: PlanningSettings = DEFAULT_PLANNING,
) -> ContactPlan:
    """
    Choose contact point and push direction from one cloud.

    A single view sees no far side: seen from the side, the mass centre of the top view is off by
    some millimetres, from above by less than one.

    Parameters
    ----------
    xyz : ndarray of float32, shape (height, width, 3) or (n, 3)
        The cloud [m], in any frame.
    ceiling : float, optional
        Height of the tool tip above the support plane [m]: before the push, nothing that is as
        high belongs to the object.
    settings : PlanningSettings
        What counts as plane, object and contact point.

    Returns
    -------
    ContactPlan
        The plan, in the frame of the points.

    Raises
    ------
    InputError
        If there is no support plane, nothing on it, more than one object, an object that the
        image cuts off, or no return at the contact point.

    References
    ----------
    Paper, section on the contact point: G_top and P_c.

    """
    import cv2

    returns = np.isfinite(xyz).all(axis=-1)
    points = xyz[returns]
    plane = fit_support_plane(points, settings)
    rotation, shift = plane.to_plane_frame()
    levelled = points @ rotation.T.astype(np.float32) + shift.astype(np.float32)
    on_object = levelled[:, 2] > settings.object_clearance
    if ceiling is not None:
        on_object &= levelled[:, 2] < ceiling - settings.plane_tolerance
    objects = levelled[on_object]
    nothing = (
        f'Nothing larger than {settings.least_area * 1e4:.3g} cm^2 stands out of the support '
        'plane: put an object under the tool.'
    )
    if not len(objects):
        raise InputError(nothing)

    # Half a cell more, so that the rounding is alike at both ends and the centre unbiased.
    low = objects[:, :2].min(axis=0) - settings.cell_size * (settings.closing_cells + 0.5)
    cells = ((objects[:, :2] - low) / settings.cell_size).astype(np.intp)
    columns, rows = cells.max(axis=0) + 1 + settings.closing_cells
    if columns * rows > 25_000_000:
        raise InputError(
            'The points above the support plane spread over '
            f'{columns * settings.cell_size:.3g} m x {rows * settings.cell_size:.3g} m: '
            'limit the range sensor to the cell.'
        )
    grid = np.zeros((rows, columns), dtype=np.uint8)
    grid[cells[:, 1], cells[:, 0]] = 1
    kernel = np.ones((settings.closing_cells, settings.closing_cells), dtype=np.uint8)
    closed = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, kernel)
    _, labels, statistics, centroids = cv2.connectedComponentsWithStats(closed)
    areas = statistics[1:, cv2.CC_STAT_AREA] * settings.cell_size**2
    large = np.flatnonzero(areas >= settings.least_area)
    if not large.size:
        raise InputError(nothing)
    if large.size > 1:
        raise InputError(
            f'There are {large.size} objects on the support plane, of '
            f'{", ".join(f"{area * 1e4:.3g}" for area in areas[large])} cm^2: leave one.'
        )
    label = int(large[0]) + 1
    of_object = labels[cells[:, 1], cells[:, 0]] == label
    if xyz.ndim == 3 and _at_border(returns, on_object, of_object):
        raise InputError(
            "The object reaches the border of the range sensor's image: move it to the middle."
        )
    centre = low + (centroids[label] + 0.5) * settings.cell_size
    surface = objects[of_object]
    near = np.hypot(*(surface[:, :2] - centre).T) < settings.patch_radius
    if np.count_nonzero(near) < settings.least_patch_points:
        raise InputError(
            f"The surface at the object's mass centre is not seen: {np.count_nonzero(near)} "
            f'returns within {settings.patch_radius * 1e3:.3g} mm, '
            f'{settings.least_patch_points} are needed; raise the tool out of the view.'
        )
    height = float(np.median(surface[near, 2]))
    contact = (np.array([centre[0], centre[1], height]) - shift) @ rotation
    x, y, z = plane.normal
    return ContactPlan(
        contact_point=(float(contact[0]), float(contact[1]), float(contact[2])),
        push_direction=(-x, -y, -z),
        object_area=float(areas[large[0]]),
        object_height=height,
        plane=plane,
    )


def _at_border(returns: BoolArray, on_object: BoolArray, of_object: BoolArray) -> bool:
    """Return whether the object's pixels touch the border of the image."""
    flags = np.zeros(returns.shape, dtype=bool)
    image = np.zeros(np.count_nonzero(returns), dtype=bool)
    image[np.flatnonzero(on_object)[of_object]] = True
    flags[returns] = image
    rim = np.concatenate((flags[0], flags[-1], flags[:, 0], flags[:, -1]))
    return bool(rim.any())
