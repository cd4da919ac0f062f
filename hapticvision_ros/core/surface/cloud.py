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
The object in the range sensor's clouds of one trial: before the push, and free of the tool again.

A few frames around each wanted time are averaged pixel by pixel; their scatter is the noise of
the mean, with its direction, so that the part of it along a surface's normal can be told. The
support plane is found anew for each time and taken out, the tool is masked as a cylinder about
its axis, and what stands elsewhere on the plane is left out. All is then in the object's own
frame: z up from the support plane, x along the longer side of the object, the tool's axis at
x = y = 0.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Final, Literal

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import plan_contact
from hapticvision_ros.core.records import (
    CloudFrame,
    Estimate,
    FloatArray,
    PointArray,
    Segmentation,
    Signal,
)
from hapticvision_ros.core.scene.body import Body, make_body
from hapticvision_ros.core.scene.plane import finite_points, fit_support_plane
from hapticvision_ros.core.scene.settings import DEFAULT_PLANNING, PlanningSettings
from hapticvision_ros.core.scene.surface import make_surface, Surface
import numpy as np
from numpy.typing import NDArray

type BoolArray = NDArray[np.bool_]
type IndexArray = NDArray[np.intp]
type ContactSource = Literal['given', 'tool', 'top view']

_SHARES: Final = (0.0, 0.05, 0.15, 0.4, 1.0)
"""When the free object is looked at, as shares of the recovery: early, where it moves most."""
_JUMP: Final = 0.005
"""A pixel that goes further to and fro [m] looks past an edge: it is left out."""
_LEAST_POINTS: Final = 50
_TOOL_BAND: Final = (0.003, 0.020)
"""Above the object and the tip: what is there is the tool, and not yet what holds it [m]."""
_ROUNDS: Final = 20
_MOST_OF_TOOL: Final = 0.7
"""Less than this share of the returns in the band on one circle is no tool."""
_OF_RADIUS: Final = 0.25
"""A return that is farther from the circle than this share of its radius is not on it."""
_LEAST_ARC: Final = 1.5
"""A circle of which less is seen has no radius that could be told [rad]."""
WIDEST_TOOL: Final = 1.0
"""A circle of this radius is no tool's, but a wall that is nearly straight, or a slip [m]."""
_ROOM: Final = 0.01
"""How far beyond its outline and above its top the object may have been pressed [m]."""
_FINEST: Final = 1e-3
_LEAST_NOISE: Final = 1e-4
"""With a smaller scale than the tool's own noise the fit of its circle ends beside it [m]."""
_UPRIGHT: Final = 0.7
"""A surface whose normal rises by less than this is a wall."""
_WALL_CELLS: Final = 2.5
"""A wall without a top this near, in cells, is none of it."""
_PLANE_SAMPLE: Final = 4000.0
"""How many points the support plane is fitted to."""


@dataclass(frozen=True, slots=True)
class CloudSettings:
    """
    How the object is taken out of the clouds.

    Parameters
    ----------
    tool_radius : float
        Of the tool [m].
    tool_margin : float
        What is this near to the tool is taken for it [m].
    tool_clearance : float
        The surface counts as free once the tip is this far above its original height [m].
    average : int
        Frames that are averaged at each time.
    planning : PlanningSettings
        What counts as plane and object.

    """

    tool_radius: float
    tool_margin: float = 0.002
    tool_clearance: float = 0.004
    average: int = 5
    planning: PlanningSettings = DEFAULT_PLANNING


@dataclass(frozen=True, slots=True, eq=False)
class Seen:
    """
    What was seen of the object at one time.

    Parameters
    ----------
    t : float
        Mean time of the frames [s].
    points : ndarray, shape (n, 3)
        Returns in the object's frame, means over the frames [m].
    covariance : ndarray, shape (n, 3, 3)
        Of the noise of each [m^2].
    frames : int
        How many were averaged.
    plane_std : float
        Standard error of the height of the support plane [m].

    """

    t: float
    points: FloatArray
    covariance: FloatArray
    frames: int
    plane_std: float

    def noise(self, normals: FloatArray) -> FloatArray:
        """Return the standard deviation of each point along a normal, both (n, ...) [m]."""
        variance = np.einsum('ni,nij,nj->n', normals, self.covariance, normals)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float64)

    @property
    def spacing(self) -> float:
        """Return the usual distance between neighbouring returns [m]."""
        return usual_spacing(self.points)


@dataclass(frozen=True, slots=True, eq=False)
class Observation:
    """
    The object over one trial.

    Parameters
    ----------
    before : Seen
        Before the push.
    after : tuple of Seen
        Free of the tool again, in order of time.
    body : Body
        Map of heights before the push: what is hidden has the height of its nearest neighbour.
    rotation, shift : ndarray, shapes (3, 3) and (3,)
        Bring the clouds before the push into the object's frame, ``p @ rotation.T + shift``.
    contact_source : {'given', 'tool', 'top view'}
        Where the tool's axis comes from.
    tool_radius : Estimate
        Of the circle that is seen above the object in the hold, whatever radius was given [m];
        unknown where no circle is seen.

    """

    before: Seen
    after: tuple[Seen, ...]
    body: Body
    rotation: FloatArray
    shift: FloatArray
    contact_source: ContactSource
    tool_radius: Estimate


def usual_spacing(points: FloatArray) -> float:
    """Return the median distance to the nearest neighbour, from about a thousand points [m]."""
    from scipy.spatial import cKDTree

    if len(points) < 2:
        return math.nan
    some = points[:: max(len(points) // 1000, 1)]
    return float(np.median(cKDTree(points).query(some, k=2)[0][:, 1]))


def observe(
    frames: Iterable[CloudFrame],
    tool_height: Signal,
    phases: Segmentation,
    settings: CloudSettings,
    *,
    contact: tuple[float, float] | None = None,
) -> Observation:
    """
    Take the object out of the clouds of a trial.

    Parameters
    ----------
    frames : iterable of CloudFrame
        The clouds in order of time, read once.
    tool_height : Signal
        Height of the tool's tip above the support plane [m].
    phases : Segmentation
        When the tool touched and let go.
    settings : CloudSettings
        Tool, averages, plane.
    contact : tuple of float, optional
        x and y of the tool's axis in the frame of the clouds, as far as that is the support
        plane's [m]; by default where the tool is seen in the hold, else the mass centre of the
        object's top view.

    Returns
    -------
    Observation
        The object before and after.

    Raises
    ------
    InputError
        If the trial has no contact or no release, no cloud from before the push or from after
        it, or no object in them.

    """
    if phases.t_contact is None or phases.t_release is None:
        missing = 'contact' if phases.t_contact is None else 'release'
        raise InputError(f'the trial has no {missing}: a shape that stays has to be let go first')
    top = phases.contact_height
    clear = _when_clear(tool_height, phases, settings.tool_clearance)
    if clear is None or top is None:
        raise InputError(
            'the tool does not rise above the object after the release: what it hides cannot be '
            'compared'
        )
    low = float(tool_height.t[0])
    approach = tool_height.between(low, phases.t_contact)
    # The higher the tool, the less of the object it hides.
    highest = float(approach.t[np.argmax(approach.value)]) if len(approach) else low
    groups = [_Nearest(highest, settings.average, low, phases.t_contact)]
    span = phases.t_end - clear
    groups += [
        _Nearest(clear + share * span, settings.average, clear, phases.t_end) for share in _SHARES
    ]
    pressed = phases.t_hold if phases.t_hold is not None else phases.t_contact
    middle = 0.5 * (pressed + phases.t_release)
    hold = _Nearest(middle, settings.average, pressed, phases.t_release)
    for frame in frames:
        tool = float(tool_height.at(np.array([frame.t]))[0])
        if frame.t <= phases.t_contact and tool < top + settings.tool_clearance:
            continue
        for group in (*groups, hold):
            group.offer(frame, tool)
    if not groups[0].frames:
        raise InputError('there is no cloud from before the push: nothing to measure a dent from')
    if not any(group.frames for group in groups[1:]):
        raise InputError('there is no cloud from after the release: record the recovery as well')
    return _taken_out(groups, hold, top, contact, settings)


def _when_clear(tool_height: Signal, phases: Segmentation, clearance: float) -> float | None:
    """Return from when on the tool is above the original surface for good."""
    released, top = phases.t_release, phases.contact_height
    if released is None or top is None:
        return None
    record = tool_height.between(released, math.inf)
    down = np.flatnonzero(record.value < top + clearance)
    if not len(record) or (down.size and down[-1] + 1 >= len(record)):
        return None
    free = float(record.t[down[-1] + 1]) if down.size else released
    free = max(free, phases.t_loss or free)
    return free if free < phases.t_end else None


class _Nearest:
    """The frames nearest to a time, within bounds."""

    def __init__(self, t: float, count: int, first: float, last: float) -> None:
        self._t, self._count, self._first, self._last = t, count, first, last
        self.frames: list[tuple[float, PointArray, float]] = []

    def offer(self, frame: CloudFrame, tool: float) -> None:
        """Keep a copy of a frame if it is among the nearest."""
        if not self._first <= frame.t <= self._last:
            return
        if len(self.frames) >= self._count:
            furthest = max(range(len(self.frames)), key=lambda k: abs(self.frames[k][0] - self._t))
            if abs(self.frames[furthest][0] - self._t) <= abs(frame.t - self._t):
                return
            del self.frames[furthest]
        self.frames.append((frame.t, np.array(frame.xyz, dtype=np.float32), tool))


def _taken_out(
    groups: Sequence[_Nearest],
    hold: _Nearest,
    top: float,
    contact: tuple[float, float] | None,
    settings: CloudSettings,
) -> Observation:
    """Return the object of each group of frames, in one frame."""
    before = _levelled(groups[0], settings.planning)
    rotation, shift = before.rotation, before.shift
    source: ContactSource = 'given'
    radius = Estimate.unknown('no cloud from the hold')
    level: _Level | None = None
    if hold.frames:
        try:
            level = _levelled(hold, settings.planning)
        except InputError:
            # Where the axis was given, the hold is needed for nothing else.
            if contact is None:
                raise
    if level is not None:
        radius = _seen_radius(level, top)
    if contact is not None:
        contact = _moved(contact, rotation, shift)
    else:
        found = None if level is None else _tool_axis(level, top, settings.tool_radius)
        if found is not None:
            contact, source = found, 'tool'
        else:
            cloud = groups[0].frames[0][1]
            with np.errstate(over='ignore', invalid='ignore'):
                levelled = (cloud @ rotation.T + shift).astype(np.float32)
            plan = plan_contact(levelled, ceiling=before.tool, settings=settings.planning)
            contact, source = plan.contact_point[:2], 'top view'
    away = -contact[0], -contact[1]
    centred = _shifted(before, away)
    mask = _object_mask(centred, settings)
    yaw = _yaw(mask.points)
    turn = np.array(
        [[math.cos(yaw), math.sin(yaw), 0.0], [-math.sin(yaw), math.cos(yaw), 0.0], [0, 0, 1.0]]
    )
    seen = [_object_of(_turned(centred, turn), mask.turned(turn), settings)]
    starts: set[float] = set()
    for group in groups[1:]:
        if not group.frames or group.frames[0][0] in starts:
            continue
        starts.add(group.frames[0][0])
        level = _turned(_shifted(_levelled(group, settings.planning), away), turn)
        seen.append(_object_of(level, mask.turned(turn), settings))
    if len(seen) < 2 or any(len(one.seen.points) < _LEAST_POINTS for one in seen):
        raise InputError(
            'the object has too few returns in the clouds to compare a shape with: move the '
            'range sensor nearer'
        )
    first = seen[0].seen
    cell = max(1.5 * first.spacing, _FINEST)
    surface = make_surface(first.points, voxel=cell)
    body = make_body(
        surface, seen[0].ground, cell=cell, closing_cells=settings.planning.closing_cells
    )
    body = _topped(body, surface)
    to_frame = turn @ rotation
    moved = turn @ (shift - np.array([*contact, 0.0]))
    after = tuple(one.seen for one in seen[1:])
    return Observation(first, after, body, to_frame, moved, source, radius)


def _topped(body: Body, surface: Surface) -> Body:
    """Return a map in which cells that hold nothing but a wall are as high as what is on top."""
    from scipy.ndimage import distance_transform_edt

    place = np.floor((surface.points[:, :2] - np.array(body.low)) / body.cell).astype(np.intp)
    upper = np.zeros(body.inside.shape, dtype=bool)
    wall = np.zeros(body.inside.shape, dtype=bool)
    up = surface.normals[:, 2] > _UPRIGHT
    for flags, chosen in ((upper, up), (wall, ~up)):
        flags[place[chosen, 1], place[chosen, 0]] = True
    away, nearest = distance_transform_edt(~upper, return_indices=True)
    taken = body.inside & wall & ~upper & (away < _WALL_CELLS)
    heights = np.where(taken, body.heights[tuple(nearest)], body.heights)
    return replace(body, heights=heights)


def _moved(
    contact: tuple[float, float], rotation: FloatArray, shift: FloatArray
) -> tuple[float, float]:
    point = rotation @ np.array([*contact, 0.0]) + shift
    return float(point[0]), float(point[1])


@dataclass(frozen=True, slots=True, eq=False)
class _Level:
    """All returns of a group of frames, averaged, over the support plane."""

    t: float
    clouds: tuple[PointArray, ...]
    pixels: IndexArray | None
    points: FloatArray
    tool: float
    rotation: FloatArray
    shift: FloatArray
    plane_noise: float
    plane_std: float

    def covariance(self, chosen: IndexArray) -> FloatArray:
        """Return the covariance of some of the points, shape (m, 3, 3) [m^2]."""
        if self.pixels is None:
            # Nothing but the plane tells the noise, and not its direction.
            return np.broadcast_to(np.eye(3) * self.plane_noise**2, (chosen.size, 3, 3))
        stack, returned, count = _stacked(self.clouds, self.pixels[chosen])
        stack = np.where(returned[:, :, None], stack, 0.0)
        mean = stack.sum(axis=0) / count[:, None]
        away = np.where(returned[:, :, None], stack - mean, 0.0) @ self.rotation.T
        scatter = np.einsum('kni,knj->nij', away, away)
        return np.asarray(scatter / (count * (count - 1.0))[:, None, None], dtype=np.float64)


def _levelled(group: _Nearest, planning: PlanningSettings) -> _Level:
    """Return the mean of a group's frames, with the support plane at z = 0."""
    clouds = tuple(xyz for _, xyz, _ in group.frames)
    points, pixels = _averaged(clouds)
    plane = fit_support_plane(points.astype(np.float32), planning)
    rotation, shift = plane.to_plane_frame()
    on_plane = max(plane.share * len(points), 1.0)
    return _Level(
        t=float(np.mean([t for t, _, _ in group.frames])),
        clouds=clouds,
        pixels=pixels,
        points=points @ rotation.T + shift,
        tool=min(tool for _, _, tool in group.frames),
        rotation=rotation,
        shift=shift,
        plane_noise=plane.noise,
        plane_std=plane.noise / math.sqrt(min(on_plane, _PLANE_SAMPLE)),
    )


def _averaged(clouds: Sequence[PointArray]) -> tuple[FloatArray, IndexArray | None]:
    """Return the mean over some clouds of each pixel that is still, and which pixels those are."""
    first = clouds[0]
    if len(clouds) < 2 or first.ndim != 3 or any(one.shape != first.shape for one in clouds):
        points = np.concatenate([finite_points(one) for one in clouds])
        return points.astype(np.float64), None
    total = np.zeros((first.size // 3, 3))
    count = np.zeros(len(total))
    low, high = np.full(len(total), np.inf), np.full(len(total), -np.inf)
    for cloud in clouds:
        flat = cloud.reshape(-1, 3)
        returned = np.isfinite(flat).all(axis=1)
        total[returned] += flat[returned]
        count += returned
        far = np.sqrt(np.einsum('ij,ij->i', flat[returned], flat[returned]))
        low[returned] = np.minimum(low[returned], far)
        high[returned] = np.maximum(high[returned], far)
    kept = np.flatnonzero((count > max(len(clouds) // 2, 1)) & ~(high - low > _JUMP))
    return total[kept] / count[kept, None], kept


def _stacked(
    clouds: Sequence[PointArray], pixels: IndexArray
) -> tuple[FloatArray, BoolArray, FloatArray]:
    """Return some pixels of each cloud, which of them came back, and how often."""
    stack = np.stack([one.reshape(-1, 3)[pixels] for one in clouds]).astype(np.float64)
    returned = np.isfinite(stack).all(axis=2)
    return stack, returned, returned.sum(axis=0).astype(np.float64)


def _shifted(level: _Level, by: tuple[float, float]) -> _Level:
    return replace(level, points=level.points + np.array([*by, 0.0]))


def _turned(level: _Level, turn: FloatArray) -> _Level:
    return replace(level, points=level.points @ turn.T, rotation=turn @ level.rotation)


@dataclass(frozen=True, slots=True, eq=False)
class _Mask:
    """Where the object stands: its points before the push, and its greatest height."""

    points: FloatArray
    top: float

    def turned(self, turn: FloatArray) -> '_Mask':
        return _Mask(self.points @ turn.T, self.top)


def _above(level: _Level, settings: CloudSettings) -> BoolArray:
    """Return which points stand out of the support plane and are not the tool."""
    points = level.points
    near = np.hypot(points[:, 0], points[:, 1]) < settings.tool_radius + settings.tool_margin
    tool = near & (points[:, 2] > level.tool - settings.tool_margin)
    return np.asarray((points[:, 2] > settings.planning.object_clearance) & ~tool)


def _object_mask(level: _Level, settings: CloudSettings) -> _Mask:
    """Return the object under the tool."""
    from hapticvision_ros.core.scene.top_view import find_objects

    above = _above(level, settings) & (level.points[:, 2] < level.tool - settings.tool_margin)
    points = level.points[above]
    view = find_objects(points, settings.planning)
    reach = [
        float(np.min(np.hypot(*points[view.object_of_point == k, :2].T)))
        for k in range(len(view.areas))
    ]
    mine = points[view.object_of_point == int(np.argmin(reach))]
    return _Mask(mine, float(mine[:, 2].max()))


def _yaw(points: FloatArray) -> float:
    """Return the direction of the longer side of the smallest rectangle around the object."""
    import cv2

    (_, _), (width, height), degrees = cv2.minAreaRect(points[:, :2].astype(np.float32))
    angle = math.radians(degrees) + (0.0 if width >= height else 0.5 * math.pi)
    # Either way along the side will do: the smaller turn.
    return (angle + 0.5 * math.pi) % math.pi - 0.5 * math.pi


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    seen: Seen
    ground: FloatArray


def _object_of(level: _Level, mask: _Mask, settings: CloudSettings) -> _Part:
    """Return the object's points of a group, and those of the support plane."""
    from scipy.spatial import cKDTree

    above = _above(level, settings) & (level.points[:, 2] < mask.top + _ROOM)
    candidates = np.flatnonzero(above)
    # Thinned: a point within a millimetre stands for its neighbours.
    outline = np.unique(np.rint(mask.points[:, :2] / _FINEST), axis=0) * _FINEST
    near = cKDTree(outline).query(level.points[candidates, :2], distance_upper_bound=_ROOM)[0]
    chosen = candidates[np.isfinite(near)]
    ground = level.points[np.abs(level.points[:, 2]) < settings.planning.plane_tolerance]
    seen = Seen(
        level.t,
        level.points[chosen],
        level.covariance(chosen),
        len(level.clouds),
        level.plane_std,
    )
    return _Part(seen, ground)


def _tool_band(hold: _Level, top: float) -> FloatArray:
    """Return the returns above the object in which the tool is."""
    z = hold.points[:, 2] - max(top, hold.tool)
    return np.asarray(hold.points[(z > _TOOL_BAND[0]) & (z < _TOOL_BAND[1])])


def _seen_radius(hold: _Level, top: float) -> Estimate:
    """Return the radius of the circle that the tool's returns are on, whatever was given [m]."""
    from scipy.optimize import least_squares

    points = _tool_band(hold, top)[:, :2]
    none = Estimate.unknown('no circle is seen above the object in the hold')
    if len(points) < _LEAST_POINTS:
        return none
    middle = np.median(points, axis=0)
    usual = float(np.median(np.hypot(*(points - middle).T)))

    def off(circle: FloatArray) -> FloatArray:
        return np.asarray(np.hypot(*(points - circle[:2]).T) - circle[2])

    # What is not of the tool pulls little.
    noise = max(hold.plane_noise, _LEAST_NOISE)
    found = least_squares(off, [*middle, usual], loss='cauchy', f_scale=noise)
    centre, radius = found.x[:2], float(found.x[2])
    if not 0.0 < radius < WIDEST_TOOL:
        return none
    bound = min(max(3.0 * hold.plane_noise, _FINEST), _OF_RADIUS * radius)
    inside = np.abs(off(found.x)) < bound
    away = points[inside] - centre
    if np.count_nonzero(inside) < max(_LEAST_POINTS, _MOST_OF_TOOL * len(points)):
        return none
    # A short piece of a noisy circle is one of any radius.
    angle = np.sort(np.arctan2(*away.T))
    if 2.0 * np.pi - float(np.diff(np.append(angle, angle[0] + 2.0 * np.pi)).max()) < _LEAST_ARC:
        return none
    design = np.column_stack((away / np.hypot(*away.T)[:, None], np.ones(len(away))))
    spread = float(np.mean(off(found.x)[inside] ** 2))
    return Estimate(radius, math.sqrt(spread * float(np.linalg.inv(design.T @ design)[2, 2])))


def _tool_axis(hold: _Level, top: float, radius: float) -> tuple[float, float] | None:
    """
    Return x and y of the tool's axis from its own returns above the object; None without enough.

    A single view hides the far side of the object, whose mass centre is then another; of the tool
    it sees a known piece of a circle. Above an object that a ball has been pressed into by less
    than its radius, the circle is as large as the ball is there, where that fits better.
    """
    band = _tool_band(hold, top)
    points = band[:, :2]
    if len(points) < _LEAST_POINTS:
        return None
    below = np.maximum(hold.tool + radius - band[:, 2], 0.0)
    of_ball = np.sqrt(np.maximum(radius**2 - below**2, 0.0))
    best: tuple[float, float] | None = None
    least = np.inf
    for radii in (np.full(len(points), radius), of_ball):
        centre = _circle(points, radii, radius, hold.plane_noise)
        if centre is None:
            continue
        off = np.abs(np.hypot(*(points - centre).T) - radii)
        if np.mean(off < max(3.0 * hold.plane_noise, _FINEST)) < _MOST_OF_TOOL:
            continue
        if float(np.median(off)) < least:
            least = float(np.median(off))
            best = float(centre[0]), float(centre[1])
    return best


def _circle(
    points: FloatArray, radii: FloatArray, radius: float, noise: float
) -> FloatArray | None:
    """Return the centre about which points are at their radii; None where it is not told."""
    centre = np.median(points, axis=0)
    for number in range(_ROUNDS):
        away = points - centre
        distance = np.maximum(np.hypot(*away.T), 1e-9)
        residual = distance - radii
        # All of them lead to the circle; only then it is seen what is not of it.
        bound = 2.0 * radius if number < _ROUNDS // 2 else max(3.0 * noise, _FINEST)
        inside = np.abs(residual) < bound
        if np.count_nonzero(inside) < _LEAST_POINTS:
            return None
        outward = away[inside] / distance[inside, None]
        step, _, rank, _ = np.linalg.lstsq(outward, residual[inside], rcond=None)
        if rank < 2:
            return None
        centre = centre + step
    return np.asarray(centre)
