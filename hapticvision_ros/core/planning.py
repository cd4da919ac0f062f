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
Where and how to push, and from where to watch it: the paper's "touch and see".

The paper takes the vertical through the mass centre of the object's top view, G_top; where it
meets the surface is the contact point P_c, and the tool pushes against the support plane's
normal. One cloud is enough for that (`plan_contact`). Clouds and pictures of several viewpoints
also tell what the object is, whether the push leaves it where it stands, and from where its dent
will be seen (`touch_and_see`).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.core.scene.body import Body, BoolArray, border_seen, make_body
from hapticvision_ros.core.scene.outline import DEFAULT_OUTLINE, OutlineSettings, refine_outline
from hapticvision_ros.core.scene.plane import fit_support_plane, SupportPlane
from hapticvision_ros.core.scene.registration import (
    DEFAULT_MERGE,
    Merge,
    merge_views,
    MergeSettings,
)
from hapticvision_ros.core.scene.settings import DEFAULT_PLANNING, PlanningSettings
from hapticvision_ros.core.scene.stability import (
    check_push,
    DEFAULT_PUSH,
    find_base,
    PushSettings,
    refuse_unstable,
    Stability,
)
from hapticvision_ros.core.scene.surface import make_surface, Surface
from hapticvision_ros.core.scene.symmetry import find_symmetry, Symmetry
from hapticvision_ros.core.scene.top_view import find_objects, refuse_several, TopView
from hapticvision_ros.core.scene.viewpoint import (
    choose_viewpoint,
    DEFAULT_VIEW,
    Viewpoint,
    ViewSettings,
)
from hapticvision_ros.core.scene.views import Picture, Pose, View
import numpy as np

_ABOVE: Final = 1.0
"""Height from which a levelled cloud is taken to be seen [m]: any above the objects."""
_CUT_OFF: Final = (
    "The object reaches the border of the range sensor's image: move it to the middle."
)


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


def plan_contact(
    xyz: PointArray,
    *,
    ceiling: float | None = None,
    plane: SupportPlane | None = None,
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
    plane : SupportPlane, optional
        Where it is known already.
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
    returns = np.isfinite(xyz).all(axis=-1)
    points = xyz[returns]
    if plane is None:
        plane = fit_support_plane(points, settings)
    rotation, shift = plane.to_plane_frame()
    levelled = points @ rotation.T.astype(np.float32) + shift.astype(np.float32)
    on_object = levelled[:, 2] > settings.object_clearance
    if ceiling is not None:
        on_object &= levelled[:, 2] < ceiling - settings.plane_tolerance
    objects = levelled[on_object]
    view = find_objects(objects, settings)
    refuse_several(view)
    of_object = view.object_of_point == 0
    if xyz.ndim == 3 and _at_border(returns, on_object, of_object):
        raise InputError(_CUT_OFF)
    centre = np.array(view.centres[0])
    surface = objects[of_object]
    near = np.hypot(*(surface[:, :2] - centre).T) < settings.patch_radius
    if np.count_nonzero(near) < settings.least_patch_points:
        raise InputError(_unseen(int(np.count_nonzero(near)), settings))
    height = float(np.median(surface[near, 2]))
    contact = (np.array([centre[0], centre[1], height]) - shift) @ rotation
    x, y, z = plane.normal
    return ContactPlan(
        contact_point=(float(contact[0]), float(contact[1]), float(contact[2])),
        push_direction=(-x, -y, -z),
        object_area=view.areas[0],
        object_height=height,
        plane=plane,
    )


def _at_border(returns: BoolArray, on_object: BoolArray, of_object: BoolArray) -> bool:
    """Return whether the object's pixels touch the border of the image."""
    flags = np.zeros(returns.shape, dtype=bool)
    image = np.zeros(np.count_nonzero(returns), dtype=bool)
    image[np.flatnonzero(on_object)[of_object]] = True
    flags[returns] = image
    return _touches_border(flags)


def _touches_border(flags: BoolArray) -> bool:
    rim = np.concatenate((flags[0], flags[-1], flags[:, 0], flags[:, -1]))
    return bool(rim.any())


@dataclass(frozen=True, slots=True)
class TouchSettings:
    """
    All that touch-and-see goes by.

    Parameters
    ----------
    planning : PlanningSettings
        Plane, objects and contact point.
    merge : MergeSettings
        How far the views' poses are known.
    push : PushSettings
        Force, mass and frictions.
    view : ViewSettings
        What is to be seen of the dent.
    outline : OutlineSettings
        How pictures are used.
    voxel : float
        Side of the voxels of the object's surface [m].
    border_reach : float
        The support plane is seen beside the outline if it is seen this near to it [m].
    least_seen : float
        Less than this share of top view, outline or dent seen is worth a warning.

    """

    planning: PlanningSettings = DEFAULT_PLANNING
    merge: MergeSettings = DEFAULT_MERGE
    push: PushSettings = DEFAULT_PUSH
    view: ViewSettings = DEFAULT_VIEW
    outline: OutlineSettings = DEFAULT_OUTLINE
    voxel: float = 0.0015
    border_reach: float = 0.005
    least_seen: float = 0.8


DEFAULT_TOUCH: Final = TouchSettings()


@dataclass(frozen=True, slots=True, eq=False)
class TouchPlan:
    """
    What stands there, where to push it, and from where to see it.

    Poses, points and directions are in the base frame, that of the views' poses; `body`,
    `symmetry` and `surface` in the support plane's.

    Parameters
    ----------
    contact : ContactPlan
        P_c and the push direction.
    centre_of_gravity : tuple of float
        At constant density [m].
    volume : float
        [m^3]
    object_pose : Pose
        At the centre of gravity: x along L, z along the plane's normal.
    size : tuple of float
        Length along L, width across it, and height [m].
    viewpoint : Viewpoint
        V_O.
    stability : Stability
        How far the push is from failing.
    symmetry : Symmetry
        L, and how far S is one.
    body : Body
        The object's map of heights.
    surface : Surface
        The object's surface.
    outline_seen : float
        Share of the outline beside which the support plane was seen.
    merge : Merge
        How the views fitted together.
    warnings : tuple of str
        What to know before trusting it, one sentence each.

    """

    contact: ContactPlan
    centre_of_gravity: tuple[float, float, float]
    volume: float
    object_pose: Pose
    size: tuple[float, float, float]
    viewpoint: Viewpoint
    stability: Stability
    symmetry: Symmetry
    body: Body
    surface: Surface
    outline_seen: float
    merge: Merge
    warnings: tuple[str, ...]


def touch_and_see(
    views: Sequence[View],
    pictures: Sequence[Picture] = (),
    *,
    ceiling: float | None = None,
    nearest_to: tuple[float, float, float] | None = None,
    settings: TouchSettings = DEFAULT_TOUCH,
) -> TouchPlan:
    """
    Merge views, find the object, and choose contact point, push direction and viewpoint.

    Parameters
    ----------
    views : sequence of View
        At least one.
    pictures : sequence of Picture
        Pictures without distortion that the outline is held against.
    ceiling : float, optional
        Height of the tool tip above the support plane [m]: nothing as high is the object's.
    nearest_to : tuple of float, optional
        Of several objects the one nearest to this point of the base frame is taken; without it
        several are refused.
    settings : TouchSettings
        Numbers.

    Returns
    -------
    TouchPlan
        The plan.

    Raises
    ------
    InputError
        If views do not fit together, there is no plane, no object or more than one, an object
        that is cut off, a contact point that is not seen, or a push that tips or slides it.

    References
    ----------
    Paper, section on touch and see: G_top, L, S, P_c and V_O.

    """
    merge = merge_views(views, settings.merge)
    points = np.concatenate(merge.clouds)
    places = [
        pose.apply(np.array([0.0, 0.0, _ABOVE if view.levelled else 0.0]))
        for view, pose in zip(views, merge.poses, strict=True)
    ]
    plane = fit_support_plane(
        points, settings.planning, seen_from=_triple(np.mean(places, axis=0))
    )
    to_plane = Pose(*plane.to_plane_frame())
    to_base = to_plane.inverse()
    levelled = to_plane.apply(points)
    above = levelled[:, 2] > settings.planning.object_clearance
    if ceiling is not None:
        above &= levelled[:, 2] < ceiling - settings.planning.plane_tolerance
    objects = levelled[above]
    top = find_objects(objects, settings.planning)
    chosen = _choose(top, nearest_to, to_plane)
    mine = top.object_of_point == chosen
    member = np.zeros(len(points), dtype=bool)
    member[np.flatnonzero(above)[mine]] = True
    _refuse_cut_off(views, member)
    surface = make_surface(objects[mine], voxel=settings.voxel)
    on_plane = levelled[np.abs(levelled[:, 2]) < settings.planning.plane_tolerance]
    body = make_body(
        surface,
        on_plane,
        cell=settings.planning.cell_size,
        closing_cells=settings.planning.closing_cells,
    )
    warnings: list[str] = []
    for number, picture in enumerate(pictures, 1):
        check = refine_outline(body, picture, to_base, settings.outline)
        body = check.body
        if not check.used:
            warnings.append(
                f'Picture {number} was not used: its silhouette of the object has only '
                f'{check.overlap:.0%} in common with that of the clouds, '
                f'{settings.outline.least_overlap:.0%} are needed; check its pose.'
            )
    outline_seen = border_seen(body, on_plane, settings.border_reach)
    symmetry = find_symmetry(body)
    contact, normal = _contact(surface, body, settings.planning)
    base, base_seen = find_base(surface, body, settings.push)
    stability = check_push(body, base, base_seen, contact, normal, settings.push)
    refuse_unstable(stability, settings.push)
    viewpoint = choose_viewpoint(
        body, symmetry, contact, settings.view, near=to_plane.apply(places[0])
    )
    warnings += _object_warnings(body, outline_seen, stability, viewpoint, settings)
    gravity = body.centre_of_gravity
    cos, sin = np.cos(symmetry.angle), np.sin(symmetry.angle)
    along = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    pose = to_base.after(Pose(along, gravity))
    x, y, z = plane.normal
    return TouchPlan(
        contact=ContactPlan(
            contact_point=_triple(to_base.apply(contact)),
            push_direction=(-x, -y, -z),
            object_area=body.area,
            object_height=float(contact[2]),
            plane=plane,
        ),
        centre_of_gravity=_triple(pose.translation),
        volume=body.volume,
        object_pose=pose,
        size=_size(body, symmetry),
        viewpoint=Viewpoint(
            to_base.after(viewpoint.pose),
            viewpoint.elevation,
            viewpoint.needed,
            viewpoint.seen_share,
        ),
        stability=stability,
        symmetry=symmetry,
        body=body,
        surface=surface,
        outline_seen=outline_seen,
        merge=merge,
        warnings=tuple(warnings),
    )


def _triple(point: FloatArray) -> tuple[float, float, float]:
    return float(point[0]), float(point[1]), float(point[2])


def _choose(top: TopView, nearest_to: tuple[float, float, float] | None, to_plane: Pose) -> int:
    """Return the number of the object to push."""
    if nearest_to is None:
        refuse_several(top)
        return 0
    goal = to_plane.apply(np.array(nearest_to))[:2]
    return int(np.argmin([np.hypot(*(np.array(centre) - goal)) for centre in top.centres]))


def _refuse_cut_off(views: Sequence[View], member: BoolArray) -> None:
    """Refuse an object that no view shows whole."""
    start = 0
    cut = []
    for view in views:
        returns = np.isfinite(view.xyz).all(axis=-1)
        count = int(np.count_nonzero(returns))
        if returns.ndim == 2:
            shown = np.flatnonzero(returns)
            flags = np.zeros(returns.size, dtype=bool)
            flags[shown[member[start:][:count]]] = True
            cut.append(_touches_border(flags.reshape(returns.shape)))
        else:
            cut.append(False)
        start += count
    if all(cut):
        raise InputError(_CUT_OFF)


def _contact(
    surface: Surface, body: Body, settings: PlanningSettings
) -> tuple[FloatArray, FloatArray]:
    """Return P_c and the surface's normal there, in the support plane's frame."""
    centre = body.top_view_centre
    offset = surface.points - np.array([*centre, 0.0])
    near = np.hypot(offset[:, 0], offset[:, 1]) < settings.patch_radius
    # The underside of nothing is seen: what faces down is a stray.
    near &= surface.normals[:, 2] > 0.0
    returns = int(surface.returns[near].sum())
    if returns < settings.least_patch_points or np.count_nonzero(near) < 3:
        raise InputError(_unseen(returns, settings))
    weight = np.sqrt(surface.returns[near])
    slope = np.stack((*offset[near, :2].T, np.ones(np.count_nonzero(near))), axis=1)
    a, b, _ = np.linalg.lstsq(slope * weight[:, None], offset[near, 2] * weight, rcond=None)[0]
    normal = np.array([-a, -b, 1.0]) / np.sqrt(a * a + b * b + 1.0)
    level = float(np.median(offset[near, 2] - slope[:, :2] @ (a, b)))
    return np.array([*centre, level]), normal


def _unseen(returns: int, settings: PlanningSettings) -> str:
    return (
        f"The surface at the object's mass centre is not seen: {returns} "
        f'returns within {settings.patch_radius * 1e3:.3g} mm, '
        f'{settings.least_patch_points} are needed; raise the tool out of the view.'
    )


def _size(body: Body, symmetry: Symmetry) -> tuple[float, float, float]:
    """Return length along L, width across it, and height [m]."""
    x, y = (item[body.inside] for item in body.centres())
    cos, sin = np.cos(symmetry.angle), np.sin(symmetry.angle)
    # The middles of the cells at the border lie on the border.
    along, across = x * cos + y * sin, y * cos - x * sin
    return float(np.ptp(along)), float(np.ptp(across)), float(body.heights.max())


def _object_warnings(
    body: Body,
    outline_seen: float,
    stability: Stability,
    viewpoint: Viewpoint,
    settings: TouchSettings,
) -> list[str]:
    warnings = []
    if outline_seen < settings.least_seen:
        warnings.append(
            f'Beside {1.0 - outline_seen:.0%} of the outline the support plane was not seen, the '
            'object may go on there: add a view from above or from the other side.'
        )
    if body.seen_share < settings.least_seen:
        warnings.append(
            f'Only {body.seen_share:.0%} of the top view was measured: add a view from above.'
        )
    if not stability.base_seen:
        warnings.append(
            'The base of the object was not seen all around, its outline stands in for it: add '
            'views from other sides.'
        )
    if viewpoint.seen_share < settings.least_seen:
        warnings.append(
            f'From the viewpoint, {np.rad2deg(viewpoint.elevation):.0f} deg above the plane, '
            f'{viewpoint.seen_share:.0%} of the middle of the dent are seen; all of it from '
            f'{np.rad2deg(viewpoint.needed):.0f} deg on.'
        )
    return warnings
