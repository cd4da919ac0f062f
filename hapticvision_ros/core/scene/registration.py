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
Views with roughly known poses, brought together: all poses at once, by point-to-plane ICP.

Surfaces that two views share tell how far they are apart. Opposite sides of a block share none
but its top, which slides on itself: there the edge that one view sees, with nothing behind it,
must lie on the wall that the other sees. The known poses stay in the sum as what they are,
measurements with an error: what nothing tells stays as it was known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.plane import finite_points, LARGEST_OFFSET
from hapticvision_ros.core.scene.surface import make_surface, Surface
from hapticvision_ros.core.scene.views import Pose, View
import numpy as np


@dataclass(frozen=True, slots=True)
class MergeSettings:
    """
    How views are brought together.

    Parameters
    ----------
    translation_error, rotation_error : float
        Standard deviations of the known poses [m], [rad].
    voxel : float
        Side of the voxels of the surfaces that are compared [m].
    reach : float
        Points of two views farther apart than this are not of one place [m].
    distance_error : float
        Standard deviation of a distance between two smoothed surfaces [m].
    edge_error : float
        Standard deviation of the place of an edge [m].
    points : int
        Most points of a view that are compared.
    rounds : int
        Most rounds of finding pairs and moving the views.
    least_overlap : float
        A view of which no other sees this share shows another place, or its pose is wrong.
    seed : int
        Seed of the choice of points.

    """

    translation_error: float = 0.003
    rotation_error: float = 0.01
    voxel: float = 0.002
    reach: float = 0.012
    distance_error: float = 0.0005
    edge_error: float = 0.001
    points: int = 1500
    rounds: int = 20
    least_overlap: float = 0.1
    seed: int = 0


DEFAULT_MERGE: Final = MergeSettings()

_LARGEST_CORRECTION: Final = 4.0
"""In standard deviations of the known pose: beyond, the pose is wrong rather than inexact."""

_SAME_SIDE: Final = 0.7
"""Least cosine between the normals of a pair."""

_ACROSS: Final = 0.4
"""Largest cosine between the normals of the two faces that meet in an edge."""

_LEAST_STEEPNESS: Final = 0.35
"""Least cosine between the line of sight and the normal of a face that ends."""

_UPWARD: Final = 0.1
"""Upward [m] against outward from the middle [m]: the plane itself faces up."""

_EDGE_NEIGHBOURS: Final = 24


@dataclass(frozen=True, slots=True, eq=False)
class Merge:
    """
    Views brought together.

    Parameters
    ----------
    clouds : tuple of ndarray, shape (n, 3)
        The returns of each view in the base frame [m].
    poses : tuple of Pose
        The refined poses.
    shifts, turns : tuple of float
        By how much each view was moved and turned against the others [m], [rad].
    overlaps : tuple of float
        Share of each view's points that some other view sees too.
    distance_before, distance_after : float
        Root mean square distance between the surfaces of paired views [m].

    """

    clouds: tuple[FloatArray, ...]
    poses: tuple[Pose, ...]
    shifts: tuple[float, ...]
    turns: tuple[float, ...]
    overlaps: tuple[float, ...]
    distance_before: float
    distance_after: float


def merge_views(views: Sequence[View], settings: MergeSettings = DEFAULT_MERGE) -> Merge:
    """
    Bring views together.

    Parameters
    ----------
    views : sequence of View
        At least one.
    settings : MergeSettings
        How far the poses are known.

    Returns
    -------
    Merge
        The clouds in the base frame.

    Raises
    ------
    InputError
        If a view has no returns, has too little in common with the others, or fits them only
        far from its pose.

    References
    ----------
    Chen & Medioni (1992), doi:10.1016/0262-8856(92)90066-C, for the distance to the plane.

    """
    clouds = []
    for view in views:
        returns = finite_points(view.xyz).astype(np.float64)
        if len(returns) < 100:
            raise InputError(
                f'The view {view.name} has only {len(returns)} returns: check that the range '
                'sensor sees the support plane from there.'
            )
        clouds.append(returns)
    poses = [view.pose for view in views]
    if len(views) == 1:
        return Merge((poses[0].apply(clouds[0]),), tuple(poses), (0.0,), (0.0,), (1.0,), 0.0, 0.0)
    random = np.random.default_rng(settings.seed)
    surfaces, edges = [], []
    for view, cloud, pose in zip(views, clouds, poses, strict=True):
        place = None if view.levelled else pose.translation
        seen = make_surface(
            pose.apply(cloud), voxel=settings.voxel, viewpoint=place, neighbours=16
        )
        if place is None:
            seen = _turned_outward(seen, pose)
            # From an unknown place an edge looks like where a round body turns out of sight.
            edges.append(_Edges(*np.empty((3, 0, 3))))
        else:
            edges.append(_find_edges(seen, place, settings.voxel))
        surfaces.append(_sample(seen, settings.points, random))
    corrections, overlaps, before, after = _refine(surfaces, edges, settings)
    shifts, turns = _relative(surfaces, corrections)
    for view, shift, turn, overlap in zip(views, shifts, turns, overlaps, strict=True):
        if overlap < settings.least_overlap:
            raise InputError(
                f'The view {view.name} has only {overlap:.0%} in common with the others: check '
                'the pose of its sensor, or add a view from in between.'
            )
        if (
            shift > _LARGEST_CORRECTION * settings.translation_error
            or turn > _LARGEST_CORRECTION * settings.rotation_error
        ):
            raise InputError(
                f'The view {view.name} fits the others only if it is moved by '
                f'{shift * 1e3:.1f} mm and turned by {np.rad2deg(turn):.1f} deg: check the pose '
                'of its sensor, and that nothing moved between the views.'
            )
    refined = tuple(
        correction.after(pose) for correction, pose in zip(corrections, poses, strict=True)
    )
    return Merge(
        tuple(pose.apply(cloud) for pose, cloud in zip(refined, clouds, strict=True)),
        refined,
        shifts,
        turns,
        tuple(overlaps),
        before,
        after,
    )


def _relative(
    surfaces: Sequence[Surface], corrections: Sequence[Pose]
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Return by how much each view was moved and turned against the others [m], [rad]."""
    middles = [surface.points.mean(axis=0) for surface in surfaces]
    moves = np.array(
        [
            np.concatenate((item.apply(middle[None])[0] - middle, _rotation_vector(item)))
            for item, middle in zip(corrections, middles, strict=True)
        ]
    )
    others = (moves.sum(axis=0) - moves) / (len(moves) - 1)
    against = moves - others
    shifts, turns = (np.linalg.norm(against[:, part], axis=1) for part in np.s_[:3, 3:])
    return tuple(map(float, shifts)), tuple(map(float, turns))


def _turned_outward(surface: Surface, pose: Pose) -> Surface:
    """Return the surface with its normals away from the middle of what stands on the plane."""
    levelled = pose.inverse().apply(surface.points)
    standing = levelled[levelled[:, 2] > LARGEST_OFFSET]
    middle = standing.mean(axis=0) if len(standing) else levelled.mean(axis=0)
    away = np.stack((*(levelled - middle).T[:2], np.full(len(levelled), _UPWARD)), axis=1)
    flip = np.sum((away @ pose.rotation.T) * surface.normals, axis=1) < 0.0
    normals = np.where(flip[:, None], -surface.normals, surface.normals)
    return Surface(surface.points, normals, surface.returns)


def _sample(surface: Surface, most: int, random: np.random.Generator) -> Surface:
    """Return at most so many points, alike many of each direction of the normal."""
    if len(surface) <= most:
        return surface
    # A table is most of what is seen, and tells nothing about a shift along it.
    bins = np.floor((surface.normals + 1.0) * 1.999).astype(np.intp) @ np.array([16, 4, 1])
    weight = 1.0 / np.bincount(bins)[bins]
    chosen = random.choice(len(surface), most, replace=False, p=weight / weight.sum())
    return surface.where(np.sort(chosen))


@dataclass(frozen=True, slots=True, eq=False)
class _Edges:
    """Points where a face ends with nothing seen behind it, and the way out, along the face."""

    points: FloatArray
    normals: FloatArray
    outward: FloatArray


def _find_edges(surface: Surface, viewpoint: FloatArray, voxel: float) -> _Edges:
    """Return the edges of a surface; not where it only turns out of sight, as a ball's does."""
    from scipy.spatial import cKDTree

    radius = 3.0 * voxel
    points, normals = surface.points, surface.normals
    count = min(_EDGE_NEIGHBOURS, len(points))
    distance, index = cKDTree(points).query(points, k=count, distance_upper_bound=radius)
    near = np.isfinite(distance)
    offset = points[np.where(near, index, 0)] - points[:, None]
    mean = np.sum(np.where(near[..., None], offset, 0.0), axis=1) / near.sum(axis=1)[:, None]
    mean -= np.sum(mean * normals, axis=1)[:, None] * normals
    length = np.linalg.norm(mean, axis=1)
    outward = -mean / np.maximum(length, 1e-9)[:, None]
    beyond = np.einsum('ikj,ij->ik', offset, outward)
    outermost = np.max(np.where(near, beyond, 0.0), axis=1) < 0.6 * voxel
    sight = viewpoint - points
    steep = np.sum(sight * normals, axis=1) / np.linalg.norm(sight, axis=1)
    # Half a disc of neighbours has its middle at 0.42 of the radius.
    edge = (length > 0.25 * radius) & outermost & (steep > _LEAST_STEEPNESS)
    return _Edges(points[edge], normals[edge], outward[edge])


def _refine(
    surfaces: Sequence[Surface], edges: Sequence[_Edges], settings: MergeSettings
) -> tuple[list[Pose], list[float], float, float]:
    """Return each view's motion, its overlap, and the distance before and after."""
    from scipy.spatial import cKDTree

    count = len(surfaces)
    trees = [cKDTree(surface.points) for surface in surfaces]
    middle = np.mean([surface.points.mean(axis=0) for surface in surfaces], axis=0)
    arms = [surface.points - middle for surface in surfaces]
    radius = np.sqrt(np.mean([np.mean(np.sum(arm * arm, axis=1)) for arm in arms]))
    motions = [Pose.identity() for _ in surfaces]
    prior = np.repeat([settings.rotation_error**-2, settings.translation_error**-2], 3) * np.ones(
        6
    )
    reach = settings.reach
    before = after = 0.0
    overlaps = [0.0] * count
    for step in range(settings.rounds):
        matrix, vector = np.zeros((6 * count, 6 * count)), np.zeros(6 * count)
        squares = pairs = 0.0
        seen = [np.zeros(len(surface), dtype=bool) for surface in surfaces]
        for first in range(count):
            moved = motions[first].apply(arms[first])
            turned = surfaces[first].normals @ motions[first].rotation.T
            for second in range(count):
                if second == first:
                    continue
                back = motions[second].inverse()
                distance, index = trees[second].query(
                    back.apply(moved) + middle, distance_upper_bound=reach
                )
                met = np.flatnonzero(np.isfinite(distance))
                index = index[met]
                normal = surfaces[second].normals[index] @ motions[second].rotation.T
                same = np.sum(normal * turned[met], axis=1) > _SAME_SIDE
                met, index, normal = met[same], index[same], normal[same]
                if not met.size:
                    continue
                seen[first][met] = True
                point = moved[met]
                target = motions[second].apply(arms[second][index])
                residual = np.sum(normal * (point - target), axis=1)
                squares += float(residual @ residual)
                pairs += residual.size
                error = np.full(residual.size, settings.distance_error)
                met_edges = _meet_edges(
                    edges[first],
                    motions[first],
                    surfaces[second],
                    trees[second],
                    motions[second],
                    middle,
                    reach,
                )
                point = np.concatenate((point, met_edges[0]))
                normal = np.concatenate((normal, met_edges[1]))
                residual = np.concatenate((residual, met_edges[2]))
                error = np.concatenate((error, np.full(len(met_edges[2]), settings.edge_error)))
                # Where the pair is none, as at the border of what is seen, it counts little.
                scaled = residual / (3.0 * error)
                weight = 1.0 / (1.0 + scaled * scaled) ** 2 / error**2
                slope = np.concatenate((np.cross(point, normal), normal), axis=1)
                block = slope.T @ (weight[:, None] * slope)
                pull = slope.T @ (weight * residual)
                i, j = (slice(6 * item, 6 * item + 6) for item in (first, second))
                matrix[i, i] += block
                matrix[j, j] += block
                matrix[i, j] -= block
                matrix[j, i] -= block
                vector[i] -= pull
                vector[j] += pull
        overlaps = [float(item.mean()) for item in seen]
        after = float(np.sqrt(squares / max(pairs, 1.0)))
        if step == 0:
            before = after
        for item, motion in enumerate(motions):
            part = slice(6 * item, 6 * item + 6)
            matrix[part, part] += np.diag(prior)
            vector[part] -= prior * np.concatenate((_rotation_vector(motion), motion.translation))
        moves = np.linalg.solve(matrix, vector).reshape(count, 6)
        for item, move in enumerate(moves):
            motions[item] = Pose(_rotate(move[:3]), move[3:]).after(motions[item])
        reach = max(0.8 * reach, 1.5 * settings.voxel)
        largest = float(np.max(np.abs(moves) * np.repeat([radius, 1.0], 3)))
        if largest < 0.02 * settings.distance_error and reach <= 1.5 * settings.voxel:
            break
    # The motions turn about the middle of all; as poses they turn about the origin.
    about_origin = [
        Pose(motion.rotation, motion.translation + middle - motion.rotation @ middle)
        for motion in motions
    ]
    return about_origin, overlaps, before, after


def _meet_edges(
    edges: _Edges,
    motion: Pose,
    surface: Surface,
    tree: Any,
    other: Pose,
    middle: FloatArray,
    reach: float,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return edge points, the normals of the walls that they belong to, and their distances."""
    moved = motion.apply(edges.points - middle)
    empty = np.empty((0, 3)), np.empty((0, 3)), np.empty(0)
    if not len(moved):
        return empty
    count = min(_EDGE_NEIGHBOURS, len(surface))
    distance, index = tree.query(
        other.inverse().apply(moved) + middle, k=count, distance_upper_bound=reach
    )
    met = np.isfinite(distance)
    index = np.where(met, index, 0)
    normal = surface.normals[index] @ other.rotation.T
    across = np.einsum('ikj,ij->ik', normal, edges.normals @ motion.rotation.T)
    out = np.einsum('ikj,ij->ik', normal, edges.outward @ motion.rotation.T)
    wall = met & (np.abs(across) < _ACROSS) & (out > _SAME_SIDE)
    found = np.flatnonzero(wall.any(axis=1))
    nearest = np.argmax(wall[found], axis=1)
    normal = normal[found, nearest]
    target = other.apply(surface.points[index[found, nearest]] - middle)
    return moved[found], normal, np.sum(normal * (moved[found] - target), axis=1)


def _rotate(vector: FloatArray) -> FloatArray:
    """Return the rotation by a rotation vector [rad] (Rodrigues)."""
    angle = float(np.linalg.norm(vector))
    x, y, z = vector
    skew = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle < 1e-9:
        first: FloatArray = np.eye(3) + skew
        return first
    turn: FloatArray = (
        np.eye(3) + np.sin(angle) / angle * skew + (1.0 - np.cos(angle)) / angle**2 * (skew @ skew)
    )
    return turn


def _rotation_vector(motion: Pose) -> FloatArray:
    """Return the rotation vector [rad] of a small rotation."""
    r = motion.rotation
    vector: FloatArray = 0.5 * np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return vector
