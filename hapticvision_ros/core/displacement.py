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
The paper's displacement height H, from clouds: original height minus height now, at P_c.

The tool hides the dent while it is down. The surface is seen again once the tool has risen above
it; the median height within a small radius of the contact axis is then compared with the same
before the push. Clouds in which there is no tool show the dent all the time.

Heights are over the support plane as each frame shows it: a sensor that drifts, sinks or is
knocked moves plane and surface alike. Which pixels see the plane is found once; a frame then costs
a fit to some thousand of them. Close-ups that show the top of the object alone have no plane to
follow: their heights are taken as they are.
"""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.planning import plan_contact
from hapticvision_ros.core.records import CloudFrame, FloatArray, PointArray, Signal
from hapticvision_ros.core.scene.plane import (
    finite_points,
    fit_support_plane,
    LARGEST_OFFSET,
    still_supports,
    SupportPlane,
    VERTICAL,
)
from hapticvision_ros.core.scene.settings import DEFAULT_PLANNING
import numpy as np
from numpy.typing import NDArray

type IndexArray = NDArray[np.intp]

_PLANE_ROUNDS: Final = 3
_LEAST_ON_PLANE: Final = 0.5
"""Less than this share of the plane's pixels on one plane is none."""
_PLANE_MARGIN: Final = 4
"""In pixels, from what is not of the plane."""
_STRIDE: Final = 6
_WIDER: Final = 4.0
"""The patch is looked for at this many times its radius: what the tool leaves of it is whole."""
_FLAT_SAMPLE: Final = 20000
"""Points of a cloud without rows that the plane is looked for in."""
_WHOLE: Final = 0.9
"""A patch that has this share of its returns is seen as if there were no tool."""

_FEW_BELOW: Final = 0.1
_FEW_ABOVE: Final = 0.3
"""Shares of a close-up that may lie far below and above the surface at the contact point."""
_NOISES: Final = 5.0
"""Standard deviations within which the heights of a surface are of its own."""
_LEAST_MARGIN: Final = 5e-5
"""How near to its tip may be the tool at least, whatever the noise [m]."""
_NOISIEST: Final = 0.5
"""Part of the usual margin by which heights spread that are more than noisy."""
_RISES: Final = 0.1
"""Part of the tool's way by which a close-up rises that is in another frame."""
_DOWN: Final = 0.5
_FEWEST_DOWN: Final = 5
_WITH_TOOL: Final = 0.6
"""Part of its deepest way below which a tool is down, frames that tell it, and the part of its
depth by which a surface that it presses goes down as well."""
_DENT_FRAMES: Final = 6
"""Frames before the push, with the tool down and after it that the dent is looked for in."""
_FLOOR_FRAMES: Final = 30
"""Frames before the push and after it that its floor is told by."""
_DENT_POINTS: Final = 1500
_FLOOR_POINTS: Final = 6000
"""Points that are kept of each of them, about."""
_AS_PLANNED: Final = 1e-3
"""A tool that is nearer to where it was planned pushed there [m]."""
_NARROWER: Final = 0.7
"""By how much a patch is made smaller whose rim is no part of the floor of the dent."""
_FLOOR: Final = 0.5
"""Part of its radius within which a patch is surely on the floor."""
_SHALLOWER: Final = 0.01
_SURELY: Final = 2.5
"""By which part of its depth, and how many standard errors, a rim is above the floor of a dent."""
_ROUND: Final = (2.0, 1.5)
"""Radii, over that of the patch, within which the form of the dent is looked for."""
_FEWEST_ROUND: Final = 5
"""Frames that tell it."""
_ROUNDEST: Final = 0.4
_STEEPEST: Final = 1.5
_CURVES: Final = 61
"""Logarithm of what is left of the depth at the rim of a patch at most, at that of what tells it,
and curves that are tried."""
_LEAST_APART: Final = 1e-6
"""Distance from its axis within which points tell no form of a dent [m]."""
_RAGGED: Final = 1.5
"""Spread about the form of a dent, over that about the surface before the push, of one surface."""
_RINGS: Final = 4
_FORM_OFF: Final = 3.5
"""Rings of as many points, and standard errors by which the form may miss one of them."""
_NEAR_LEVEL: Final = 4e-3
"""How far from the heights around the contact point a touch may be [m]."""
_DOWN_TO: Final = 0.05
"""Part of its way within which a tool is at its deepest."""
_ASTRAY: Final = 0.02
"""How far from where it was planned a tool may have pushed [m]."""
_LEAST_TOLD: Final = 8
"""Fewest heights that tell their own noise."""

ELSEWHERE: Final = (
    'The clouds give no displacement height: what they show at the contact point stays above the '
    'tool that presses it, so that the tool pushes elsewhere, or hides where.'
)
"""Said of clouds whose surface `is_elsewhere`."""

LARGEST_TILT: Final = np.deg2rad(2.0)
"""A support plane tilted by more than this [rad] is not that of the contract's frame."""


@dataclass(frozen=True, slots=True)
class DisplacementSettings:
    """
    What counts as the surface at the contact point.

    Parameters
    ----------
    patch_radius : float
        The height is the median within this distance of the contact axis [m]; of a record within
        less where the dent turns out narrower.
    region_radius : float
        The dent can be seen only by pixels that saw the original surface within this distance of
        the contact axis [m]: the patch's radius and the deepest dent over the tangent of the
        view's elevation.
    tool_margin : float
        Points nearer to the tool tip's height than this, or higher, are the tool [m]: a few times
        the sensor's noise.
    tool_clearance : float
        The surface counts as free once the tool tip is this far above it [m].
    least_points : int
        Fewest points in the patch.
    least_share : float
        Fewest points in the patch, as a share of those before the push, less what this frame has
        lost of the support plane too: a patch that is seen only at its rim is still behind the
        tool.
    least_frames, most_frames : int
        Frames before the push over which the original height is taken: H is unknown before the
        least, the most end it.
    plane_pixels : int
        Most pixels that the support plane is followed by.
    least_plane_pixels : int
        With fewer, and as few returns from them in a frame, it is not seen.
    plane_tolerance : float
        Half thickness of the plane [m]: a few times the sensor's noise.
    noise : float
        Standard deviation of a height [m], where it is known: a patch whose heights spread no
        more than this has no tool in it, however near that is. Zero if it is not.
    largest_shift, largest_tilt : float
        A plane that has moved further than this since the first frame [m], [rad] is refused: what
        the contact axis points at is then not known any more.

    """

    patch_radius: float = 0.005
    region_radius: float = 0.05
    tool_margin: float = 0.002
    tool_clearance: float = 0.004
    least_points: int = 12
    least_share: float = 0.4
    least_frames: int = 3
    most_frames: int = 30
    plane_pixels: int = 2000
    least_plane_pixels: int = 100
    plane_tolerance: float = 0.003
    noise: float = 0.0
    largest_shift: float = 0.01
    largest_tilt: float = float(np.deg2rad(2.0))


DEFAULT_DISPLACEMENT: Final = DisplacementSettings()

OF_RECORDS: Final = replace(DEFAULT_DISPLACEMENT, least_points=3)
"""No tool is sent to a surface that was recorded: points that are millimetres apart will do."""


class DisplacementTracker:
    """
    Follow H at one contact point, frame by frame.

    Parameters
    ----------
    contact_axis : tuple of float
        x and y of the contact point [m] in the frame `support_plane`.
    settings : DisplacementSettings
        What counts as the surface.
    rotation, shift : ndarray, shapes (3, 3) and (3,), optional
        Bring the clouds into the frame `support_plane`, if they are in another:
        ``p @ rotation.T + shift``.
    lowest_tool_height : float, optional
        How low the tool has been before the first frame [m]: what it has pushed is no original
        surface.
    original_height : float, optional
        Height of the surface before the push [m], where no frame shows it.
    curved : float, default 0
        Curvature of the dent relative to its depth [1/m^2]: at a distance r from its axis it is
        less deep by exp(-curved r^2).

    """

    def __init__(
        self,
        contact_axis: tuple[float, float],
        settings: DisplacementSettings = DEFAULT_DISPLACEMENT,
        *,
        rotation: FloatArray | None = None,
        shift: FloatArray | None = None,
        lowest_tool_height: float = np.inf,
        original_height: float | None = None,
        curved: float = 0.0,
    ) -> None:
        self._x, self._y = (np.float32(item) for item in contact_axis)
        self._settings = settings
        self._rotation = None if rotation is None else rotation.T.astype(np.float32)
        self._shift = None if shift is None else shift.astype(np.float32)
        self._region: tuple[slice, slice] | None = None
        self._shape: tuple[int, ...] | None = None
        self._plane_pixels: IndexArray | None = None
        self._plane: FloatArray | None = None
        self._first_level: float | None = None
        self._heights: list[float] = []
        self._counts: list[float] = []
        self._pushed = False
        self._lowest_tool_height = lowest_tool_height
        self._original_height = original_height
        self._curved = curved
        self._reason = 'no frame has come yet'

    @property
    def original_height(self) -> float | None:
        """Height of the surface before the push [m], or None before enough frames."""
        if self._original_height is not None:
            return self._original_height
        if len(self._heights) < self._settings.least_frames:
            return None
        return float(np.median(self._heights))

    def near(self, xyz: PointArray, radius: float) -> PointArray:
        """Return the returns of a frame within a radius of the axis [m], shape (n, 3)."""
        points = self._levelled(finite_points(xyz))
        with np.errstate(over='ignore', invalid='ignore'):
            points = points[self._distance(points) < radius**2]
        # Over the plane as this frame shows it.
        points[:, 2] -= self._level_at(points)
        return points

    @property
    def pushed(self) -> bool:
        """Whether the tool has come to the surface: the original height is then settled."""
        return self._pushed

    def update(self, xyz: PointArray, tool_height: float | None) -> float | None:
        """
        Take one frame.

        Parameters
        ----------
        xyz : ndarray of float32, shape (height, width, 3) or (n, 3)
            The cloud [m].
        tool_height : float or None
            Height of the tool tip above the support plane [m] at the frame's time; None or NaN if
            it is not known.

        Returns
        -------
        float or None
            H [m]; None while the dent is hidden, the original height is not known yet, or the
            frame holds too few points of it.

        """
        if tool_height is None or not np.isfinite(tool_height):
            self._reason = 'the height of the tool is not known'
            return None
        settings = self._settings
        if self._shape != xyz.shape:
            self._find_pixels(xyz)
            self._shape = xyz.shape
        seen = self._follow_plane(xyz)
        patch = np.empty(0) if seen is None else self._patch(xyz)
        surface = _middle(patch[patch < tool_height - settings.tool_margin])
        clearance = settings.tool_clearance
        bare = self._bare(patch, tool_height)
        if bare is not None:
            surface = bare, int(patch.size)
            clearance = _NOISES * settings.noise / np.sqrt(patch.size)
        height, count = surface if surface is not None else (None, 0)
        original = self.original_height
        level = height if height is not None else original
        self._lowest_tool_height = min(self._lowest_tool_height, tool_height)
        if level is not None:
            # Also a surface that was hidden when the tool came down has been pushed.
            # A bare surface may have followed a tool whose height is a little off.
            settled = level if original is None else max(level, original)
            if self._lowest_tool_height - settled < clearance:
                self._pushed = True
            if tool_height - level < clearance:
                under = None if seen is None else self._under_tool(patch, seen)
                self._reason = '' if under is not None else 'the tool is down'
                return under
        if seen is None:
            return None
        if height is None or count < settings.least_points:
            self._reason = f'{count} returns at the contact point are too few'
            return None
        # Returns that are lost all over the frame are no sign of the tool.
        whole = count / seen
        if not self._pushed and len(self._heights) < settings.most_frames:
            self._heights.append(height)
            self._counts.append(whole)
            original = self.original_height
        if original is None:
            self._reason = 'the surface was not seen often enough before the push'
            return None
        if self._counts and whole < settings.least_share * float(np.median(self._counts)):
            self._reason = 'the tool hides most of the contact point'
            return None
        self._reason = ''
        return original - height

    @property
    def reason(self) -> str:
        """Why the last frame gave no height, in a few words; empty if it gave one."""
        return self._reason

    def _follow_plane(self, xyz: PointArray) -> float | None:
        """Take the support plane from a frame; return which share of its pixels came back."""
        settings = self._settings
        if self._plane_pixels is not None:
            points = xyz.reshape(-1, 3)[self._plane_pixels]
        elif xyz.ndim == 3:
            return 1.0
        else:
            points = xyz[:: max(len(xyz) // _FLAT_SAMPLE, 1)]
        ground = self._levelled(finite_points(points)).astype(np.float64)
        share = 1.0
        if self._plane_pixels is None:
            ground = ground[np.abs(ground[:, 2] - self._level_at(ground)) < LARGEST_OFFSET]
        else:
            share = len(ground) / len(self._plane_pixels)
        if len(ground) < settings.least_plane_pixels:
            if self._plane is None:
                return 1.0
            self._reason = 'the support plane is not seen'
            return None
        plane = self._fit_plane(ground)
        if plane is None:
            self._reason = 'the support plane is not seen'
            return None
        level = float(plane[0])
        if self._first_level is None:
            self._first_level = level
        if abs(level - self._first_level) > settings.largest_shift or np.hypot(
            plane[1], plane[2]
        ) > np.tan(settings.largest_tilt):
            self._reason = 'the range sensor or the support plane has moved'
            return None
        self._plane = plane
        return share

    def _fit_plane(self, points: FloatArray) -> FloatArray | None:
        """Return height over the contact axis and the slopes; None if the points are no plane."""
        slopes = np.stack(
            (np.ones(len(points)), points[:, 0] - self._x, points[:, 1] - self._y), axis=1
        )
        start = np.zeros(3) if self._plane is None else self._plane
        residual = points[:, 2] - slopes @ start
        # A jump moves all alike; what stands before the plane is none of it.
        residual -= np.median(residual)
        inside = np.abs(residual) < LARGEST_OFFSET
        for _ in range(_PLANE_ROUNDS):
            if np.count_nonzero(inside) < max(_LEAST_ON_PLANE * len(points), 3):
                return None
            used = slopes[inside]
            plane: FloatArray = np.linalg.lstsq(
                used.T @ used, used.T @ points[inside, 2], rcond=None
            )[0]
            inside = np.abs(points[:, 2] - slopes @ plane) < self._settings.plane_tolerance
        return plane

    def _level_at(self, points: PointArray | FloatArray) -> FloatArray:
        """Return the height of the support plane under points [m]."""
        if self._plane is None:
            return np.zeros(points.shape[:-1])
        level, slope_x, slope_y = self._plane
        under: FloatArray = (
            level + slope_x * (points[..., 0] - self._x) + slope_y * (points[..., 1] - self._y)
        )
        return under

    def _patch(self, xyz: PointArray) -> FloatArray:
        """Return the heights of the points within the patch's radius of the contact axis [m]."""
        settings = self._settings
        points = xyz if self._region is None else self._window(xyz[self._region])
        points = self._levelled(points)
        with np.errstate(over='ignore', invalid='ignore'):
            patch = points[self._distance(points) < settings.patch_radius**2]
            # A comparison drops NaN, but not a return at minus infinity.
            patch = patch[np.isfinite(patch[:, 2])]
            heights: FloatArray = patch[:, 2] - self._level_at(patch)
        if self._curved and (original := self.original_height) is not None:
            # What each point says of the deepest one.
            there = np.exp(self._curved * self._distance(patch))
            heights = original - (original - heights) * there
        return heights

    def _bare(self, patch: FloatArray, tool_height: float) -> float | None:
        """Return the height of a patch that is one surface but for its noise; None if not."""
        settings = self._settings
        if not settings.noise or patch.size < settings.least_points:
            return None
        if np.ptp(patch) >= 2.0 * _NOISES * settings.noise:
            return None
        height = float(np.median(patch))
        # What is above the tip may be the upper end of the tool.
        return height if height < tool_height + settings.tool_margin else None

    def _under_tool(self, patch: FloatArray, seen: float) -> float | None:
        """Return H below a tool that these clouds do not show; None if they may show it."""
        original = self.original_height
        # Only of a record is it looked at how noisy heights are, and no tool is sent by it.
        if not self._settings.noise or original is None or not self._counts:
            return None
        if patch.size / seen < _WHOLE * float(np.median(self._counts)):
            return None
        # A tool is held from above: with it in the picture something is higher than the surface.
        if patch.max() > original + self._settings.tool_margin:
            return None
        return original - float(np.median(patch))

    def _window(self, region: PointArray) -> PointArray:
        """Return the part of the region in which a look at every sixth pixel finds the patch."""
        coarse = self._levelled(region[::_STRIDE, ::_STRIDE])
        with np.errstate(over='ignore', invalid='ignore'):
            near = self._distance(coarse) < (_WIDER * self._settings.patch_radius) ** 2
        rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        if not rows.size:
            return region
        row, column = max(rows[0] - 1, 0) * _STRIDE, max(columns[0] - 1, 0) * _STRIDE
        end_row, end_column = (rows[-1] + 2) * _STRIDE, (columns[-1] + 2) * _STRIDE
        return region[row:end_row, column:end_column]

    def _distance(self, points: PointArray) -> PointArray:
        """Return the squared distance of points from the contact axis [m^2]."""
        dx = points[..., 0] - self._x
        dy = points[..., 1] - self._y
        squared: PointArray = dx * dx + dy * dy
        return squared

    def _find_pixels(self, xyz: PointArray) -> None:
        """Find which pixels can see the dent, and which see the support plane."""
        settings = self._settings
        self._region, self._plane_pixels = None, None
        if xyz.ndim != 3:
            return
        points = self._levelled(xyz)
        with np.errstate(over='ignore', invalid='ignore'):
            near = self._distance(points) < settings.region_radius**2
            ground = np.abs(points[..., 2]) < LARGEST_OFFSET
        rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        if rows.size:
            self._region = slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)
        else:
            self._region = slice(0, 0), slice(0, 0)
        # Pixels next to anything else would change sides when the sensor is knocked.
        inner = ground.copy()
        for axis in (0, 1):
            for step in (-_PLANE_MARGIN, _PLANE_MARGIN):
                inner &= np.roll(ground, step, axis=axis)
        pixels = np.flatnonzero(inner)
        if pixels.size >= settings.least_plane_pixels:
            step = max(pixels.size // settings.plane_pixels, 1)
            self._plane_pixels = pixels[::step]

    def _levelled(self, points: PointArray) -> PointArray:
        if self._rotation is None or self._shift is None:
            return points
        with np.errstate(over='ignore', invalid='ignore'):
            return points @ self._rotation + self._shift


def _middle(heights: FloatArray) -> tuple[float, int] | None:
    """Return the median and the number of heights, None if there are none."""
    if not heights.size:
        return None
    return float(np.median(heights)), int(heights.size)


def displacement_from_clouds(
    frames: Iterable[CloudFrame],
    tool_height: Signal,
    *,
    contact_point: tuple[float, float, float] | None = None,
    touched: Callable[[], float | None] | None = None,
    settings: DisplacementSettings = OF_RECORDS,
) -> tuple[Signal | None, tuple[str, ...]]:
    """
    Compute H over a trial whose bag has clouds but no displacement height.

    The contract's clouds are in the frame `support_plane`, z up and z = 0 on the plane. The plane
    is estimated all the same: a cloud in some other frame (a sensor's own) is brought into the
    plane's frame, with a warning. Without a given contact point, it is in the middle of the dent
    that the tool has left, or if that is not clear where the vertical through the mass centre of
    the object's top view meets the surface. Close-ups, which show the top of the object alone,
    are taken to be in the contract's frame if that puts their surface where the tool was, and the
    contact point in the middle of what they show.

    Parameters
    ----------
    frames : iterable of CloudFrame
        The trial's clouds in order of time. What can be read only once shows no dent.
    tool_height : Signal
        Height of the tool tip above the support plane [m].
    contact_point : tuple of float, optional
        The contact point [m] in the frame `support_plane`, where it was recorded.
    touched : callable, optional
        Returns the height of the tool tip at which it touched the object [m], or None: that of
        the original surface where the tool hides it until then and the dent tells where it is.
    settings : DisplacementSettings
        What counts as the surface.

    Returns
    -------
    displacement_height : Signal or None
        H [m] at the frames in which the dent is seen; None if there are fewer than two.
    warnings : tuple of str
        What was assumed, and why frames are missing, one sentence each.

    """
    if not len(tool_height):
        return None, ('The clouds give no displacement height: there is no tool height.',)
    again = contact_point is None and iter(frames) is not frames
    dent = _Dent(tool_height) if again else None
    followed = _follow(frames, tool_height, contact_point, settings, dent=dent)
    told = _told(followed, tool_height)
    view = followed.view
    if dent is None or view is None:
        return told
    axis = dent.axis(view.axis)
    middle = view.axis if axis is None else axis
    radius = dent.floor(middle, view.settings)
    curved = dent.curved(middle, radius, view.settings)
    if axis is None and radius == view.settings.patch_radius and not curved:
        return told
    view = view._replace(curved=curved)
    if radius < view.settings.patch_radius:
        view = view._replace(settings=replace(view.settings, patch_radius=radius), floor=radius)
    if axis is not None:
        view = view._replace(axis=axis, place=_in_the_dent(axis))
    followed = _follow(frames, tool_height, None, settings, view=view)
    tracker = followed.tracker
    if touched is not None and tracker is not None and tracker.original_height is None:
        original, level = touched(), dent.level(view.axis)
        if original is not None and level is not None and abs(original - level) < _NEAR_LEVEL:
            followed = _follow(
                frames, tool_height, None, settings, view=view._replace(original=original)
            )
    by_dent = _told(followed, tool_height)
    # A dent that is not where the tool pressed is none.
    return told if ELSEWHERE in by_dent[1] else by_dent


class _View(NamedTuple):
    """How clouds are looked at, from which time on, and where."""

    axis: tuple[float, float]
    settings: DisplacementSettings
    rotation: FloatArray | None
    shift: FloatArray | None
    lowest: float
    begun: float
    close_up: bool
    warnings: tuple[str, ...]
    place: str
    original: float | None = None
    floor: float | None = None
    curved: float = 0.0

    def tracker(self) -> DisplacementTracker:
        """Return what follows the surface."""
        return DisplacementTracker(
            self.axis,
            self.settings,
            rotation=self.rotation,
            shift=self.shift,
            lowest_tool_height=self.lowest,
            original_height=self.original,
            curved=self.curved,
        )

    @property
    def told(self) -> list[str]:
        """Return what was assumed, one sentence each."""
        told = [*self.warnings]
        if self.place:
            told.append(f'The contact point was taken {self.place}.')
        if self.floor is not None:
            told.append(
                f'The dent is narrow: the surface was taken within {1e3 * self.floor:.2g} mm of '
                'the contact point.'
            )
        if self.curved:
            radius = self.settings.patch_radius
            less = 100.0 * -math.expm1(-self.curved * radius**2)
            told.append(
                f'The dent is round: {1e3 * radius:.2g} mm from the contact point it was taken to '
                f'be {less:.2g} % less deep.'
            )
        if self.original is not None:
            told.append(
                'The clouds do not show the surface before the push: its height was taken from '
                'where the force tells that the tool touched it.'
            )
        return told


class _Followed(NamedTuple):
    """What the clouds of a trial show at the contact point."""

    times: list[float]
    heights: list[float]
    tools: list[float]
    tracker: DisplacementTracker | None
    view: _View | None
    used: int
    refusal: str


class _Dent:
    """Keeps the few frames of a trial that tell where the dent is, and how wide its floor."""

    def __init__(self, tool_height: Signal) -> None:
        t, height = tool_height.t, tool_height.value
        lowest = float(np.nanmin(height))
        down = t[height <= lowest + _DOWN_TO * (float(np.nanmax(height)) - lowest)]
        after = np.linspace(down[-1], t[-1], _DENT_FRAMES + 2)[1:-1]
        held = np.linspace(down[0], down[-1], _DENT_FRAMES + 2)[1:-1]
        self._due = sorted([*held.tolist(), *after.tolist()])
        self._later = np.linspace(down[-1], t[-1], _FLOOR_FRAMES + 2)[1:-1].tolist()
        self._first = float(down[0])
        self._before: list[tuple[PointArray, float]] = []
        self._with_dent: list[tuple[PointArray, float]] = []
        self._bare: list[tuple[PointArray, float]] = []
        self._left: list[tuple[PointArray, float]] = []
        self._meanwhile = np.linspace(down[0], down[-1], _FLOOR_FRAMES + 2)[1:-1].tolist()
        self._pressed: list[tuple[PointArray, float]] = []

    def take(
        self, frame: CloudFrame, tool: float, tracker: DisplacementTracker, height: float | None
    ) -> None:
        """Keep a frame, with what it has told, if it is one of them."""
        if not np.isfinite(tool):
            return
        kept = []
        if not tracker.pushed and frame.t < self._first:
            if len(self._before) < _DENT_FRAMES:
                kept.append((self._before, _DENT_POINTS))
            if len(self._bare) < _FLOOR_FRAMES:
                kept.append((self._bare, _FLOOR_POINTS))
        else:
            if self._due and frame.t >= self._due[0]:
                kept.append((self._with_dent, _DENT_POINTS))
                self._due = [t for t in self._due if t > frame.t]
            if self._later and frame.t >= self._later[0]:
                kept.append((self._left, _FLOOR_POINTS))
                self._later = [t for t in self._later if t > frame.t]
            if height is not None and self._meanwhile and frame.t >= self._meanwhile[0]:
                # Clouds in which there is no tool.
                kept.append((self._pressed, _FLOOR_POINTS))
                self._meanwhile = [t for t in self._meanwhile if t > frame.t]
        if kept:
            points = tracker.near(frame.xyz, 2.0 * _ASTRAY)
            for frames, count in kept:
                # A view would keep all of them.
                frames.append((points[:: max(len(points) // count, 1)].copy(), tool))

    def axis(self, planned: tuple[float, float]) -> tuple[float, float] | None:
        """Return the axis of the dent [m]; None if it is not clear, or the one as planned."""
        # Loads much of scipy, which clouds of a recorded contact point do without.
        from hapticvision_ros.core.scene.dent import find_dent_axis

        found = find_dent_axis(self._before, self._with_dent, planned, _ASTRAY)
        if found is None or math.dist(found, planned) < _AS_PLANNED:
            return None
        return found

    def floor(self, axis: tuple[float, float], settings: DisplacementSettings) -> float:
        """
        Return the radius within which the dent around an axis is even [m].

        A patch that is wider than the tool reads less than the tool has pressed.
        """
        radius = settings.patch_radius
        seen = self._free(axis, settings)
        while True:
            inside, beside = (0.0, _FLOOR * radius), (_NARROWER * radius, radius)
            steps, depth = [], []
            for frames in seen:
                rings = [
                    [_ring(points, axis, *edges, settings) for edges in (inside, beside)]
                    for points in frames
                ]
                known = [(a, b) for a, b in rings if a is not None and b is not None]
                if len(known) < settings.least_frames:
                    return radius
                steps.append(np.array([b - a for a, b in known]))
                depth.append(float(np.mean([a for a, _ in known])))
            shallower = float(steps[1].mean() - steps[0].mean())
            error = math.sqrt(sum(float(np.var(each, ddof=1)) / each.size for each in steps))
            if shallower < max(_SURELY * error, _SHALLOWER * (depth[0] - depth[1])):
                return radius
            radius *= _NARROWER

    def curved(
        self, axis: tuple[float, float], radius: float, settings: DisplacementSettings
    ) -> float:
        """
        Return the curvature of a dent relative to its depth, for a patch of a radius [1/m^2].

        Zero where it is not seen to be round: the floor of a flat tool is even.
        """
        before, after = self._free(axis, settings)
        after = [*after, *(points for points, _ in self._pressed)]
        for wider in _ROUND:
            near, dent = (
                [_around(points, axis, wider * radius) for points in frames]
                for frames in (before, after)
            )
            if not near:
                break
            # What hides the middle leaves a rim that does not tell it.
            whole = _WHOLE * float(np.median([len(points) for points in near]))
            dent = [points for points in dent if len(points) >= whole]
            found = _roundness(near, dent, radius, settings.least_points)
            if found is None:
                continue
            curved, error = found
            if curved > _SURELY * error and curved * radius**2 < _ROUNDEST:
                return curved
        return 0.0

    def _free(
        self, axis: tuple[float, float], settings: DisplacementSettings
    ) -> tuple[list[PointArray], list[PointArray]]:
        """Return what is seen of the surface before the push, and after it without the tool."""
        # Higher up is the tool, which is out of the way before the push, and after it for long.
        before, after = (
            [(points[points[:, 2] < tool - settings.tool_margin], tool) for points, tool in seen]
            for seen in (self._bare, self._left)
        )
        return [points for points, _ in before], [
            points
            for points, tool in after
            if (middle := _ring(points, axis, 0.0, settings.patch_radius, settings)) is not None
            and tool > middle + settings.tool_clearance
        ]

    def level(self, axis: tuple[float, float]) -> float | None:
        """Return the median height around an axis before the push [m]; None if it is not seen."""
        heights = [
            points[
                (np.hypot(*(points[:, :2] - axis).T) < 0.5 * _ASTRAY) & (points[:, 2] < tool), 2
            ]
            for points, tool in self._before
        ]
        middle = _middle(np.concatenate(heights)) if heights else None
        return None if middle is None else middle[0]


def _ring(
    points: PointArray,
    axis: tuple[float, float],
    inner: float,
    outer: float,
    settings: DisplacementSettings,
) -> float | None:
    """Return the median height of what is between two radii [m]; None where it is too little."""
    away = np.hypot(*(points[:, :2] - axis).T)
    heights = points[(away >= inner) & (away < outer), 2]
    heights = heights[np.isfinite(heights)]
    return float(np.median(heights)) if heights.size >= settings.least_points else None


def _around(points: PointArray, axis: tuple[float, float], radius: float) -> FloatArray:
    """Return the points within a distance of an axis, from there; shape (n, 3) [m]."""
    near = points.astype(np.float64) - [*axis, 0.0]
    return np.asarray(near[(np.hypot(near[:, 0], near[:, 1]) < radius) & np.isfinite(near[:, 2])])


def _roundness(
    before: Sequence[FloatArray], after: Sequence[FloatArray], radius: float, least: int
) -> tuple[float, float] | None:
    """
    Return the curvature of a dent relative to its depth, and its standard error [1/m^2].

    A dent of a depth of its own in each frame, exp(-c r^2) of which is left at a distance r. None
    where it has another form, as one that is even within the radius of a patch, or is not seen.
    """
    before, after = ([p for p in frames if len(p) >= least] for frames in (before, after))
    if min(len(before), len(after)) < _FEWEST_ROUND:
        return None
    surface = np.vstack(before)
    terms = _quadratic(surface)
    original, *_ = np.linalg.lstsq(terms, surface[:, 2], rcond=None)
    noise = float(np.std(surface[:, 2] - terms @ original))
    apart = np.linalg.pinv(terms.T @ terms)
    frame = np.repeat(np.arange(len(after)), [len(points) for points in after])
    points = np.vstack(after)
    missing = _quadratic(points) @ original - points[:, 2]
    square = points[:, 0] ** 2 + points[:, 1] ** 2
    if square.max() < _LEAST_APART**2:
        return None

    def fitted(curved: float, of: slice | NDArray[np.bool_]) -> tuple[FloatArray, FloatArray]:
        """Return the depth in each frame, by some of its points, and what is left of these."""
        left, there = np.exp(-curved * square[of]), frame[of]
        sums = [np.bincount(there, weights=w) for w in (left * missing[of], left * left)]
        depth = sums[0] / np.maximum(sums[1], 1e-9)
        return depth, missing[of] - depth[there] * left

    def beside(curved: float, of: slice | NDArray[np.bool_]) -> float:
        return float(np.sum(fitted(curved, of)[1] ** 2))

    every, inside = slice(None), square < radius**2
    most = _STEEPEST / float(square.max())
    curves = np.linspace(0.0, most, _CURVES)
    squares = [beside(each, every) for each in curves.tolist()]
    best = min(max(int(np.argmin(squares)), 1), _CURVES - 2)
    step = most / (_CURVES - 1)
    low, middle, high = (squares[k] for k in (best - 1, best, best + 1))
    bent = (low + high - 2.0 * middle) / step**2
    if bent <= 0.0:
        return None
    curved = float(curves[best]) + 0.5 * (low - high) / (bent * step)
    if beside(curved, inside) > beside(0.0, inside):
        # The floor of a flat tool, whose rim is round.
        return None
    depth, rest = fitted(curved, every)
    usual = float(np.median(depth))
    spread = float(np.std(rest))
    # Where the rim hides a part of the dent, what is seen is no one surface.
    if usual < spread or spread > _RAGGED * noise:
        return None
    # The form of the surface before the push is told by its noise as well.
    level = noise**2 * (apart[3, 3] + apart[5, 5] + 2.0 * apart[3, 5]) / (2.0 * usual) ** 2
    # Another form shows in what is left of rings of as many points.
    edges = np.unique(np.quantile(square, np.arange(1, _RINGS) / _RINGS, method='lower'))
    ring = np.searchsorted(edges, square)
    count = np.bincount(ring)
    off = np.bincount(ring, weights=rest)[count > 0] / np.sqrt(count[count > 0])
    if float(np.abs(off).max()) > _FORM_OFF * spread:
        return None
    return curved, math.sqrt(2.0 * spread**2 / bent + level)


def _quadratic(points: FloatArray) -> FloatArray:
    """Return the terms of a surface that is bent; shape (n, 6)."""
    x, y = points[:, 0], points[:, 1]
    return np.column_stack((np.ones(x.size), x, y, x * x, x * y, y * y))


def _follow(
    frames: Iterable[CloudFrame],
    tool_height: Signal,
    contact_point: tuple[float, float, float] | None,
    settings: DisplacementSettings,
    *,
    view: _View | None = None,
    dent: _Dent | None = None,
) -> _Followed:
    """Follow the surface at the contact point, or as a view that is known tells."""
    first, last = float(tool_height.t[0]), float(tool_height.t[-1])
    times: list[float] = []
    heights: list[float] = []
    tools: list[float] = []
    tracker = None if view is None else view.tracker()
    refusal = 'there is no cloud within the record of the tool height'
    used = 0
    plane: SupportPlane | None = None
    for frame in frames:
        if not first <= frame.t <= last or (times and frame.t <= times[-1]):
            continue
        used += 1
        if view is not None and frame.t < view.begun:
            # What hid the object from being planned for hides it still.
            continue
        tool = float(tool_height.at(np.array([frame.t]))[0])
        if tracker is None:
            try:
                # The object may be hidden in the frames before.
                passed = tool_height.value[tool_height.t <= frame.t]
                lowest = float(np.nanmin(passed, initial=np.inf))
                view = _close_up(frame, tool_height, lowest, contact_point, settings)
                if view is None:
                    points = finite_points(frame.xyz)
                    if plane is None or not still_supports(plane, points):
                        plane = fit_support_plane(points)
                    view = _set_up(frame, tool, lowest, contact_point, plane, settings)
                tracker = view.tracker()
            except InputError as error:
                text = str(error).rstrip('.')
                refusal = text[:1].lower() + text[1:]
                continue
        height = tracker.update(frame.xyz, tool)
        if dent is not None:
            dent.take(frame, tool, tracker, height)
        if height is not None:
            times.append(frame.t)
            heights.append(height)
            tools.append(tool)
    return _Followed(times, heights, tools, tracker, view, used, refusal)


def _told(followed: _Followed, tool_height: Signal) -> tuple[Signal | None, tuple[str, ...]]:
    """Return H if what was followed tells it, and what was assumed or why it does not."""
    tracker, view = followed.tracker, followed.view
    if tracker is None or view is None:
        return None, (f'The clouds give no displacement height: {followed.refusal}.',)
    warnings = view.told
    if tracker.original_height is None:
        return None, (
            *warnings,
            'The clouds give no displacement height: the surface at the contact point was not '
            'seen before the push.',
        )
    if len(followed.times) < 2:
        return None, (
            *warnings,
            'The clouds give no displacement height: the surface at the contact point was seen '
            f'free of the tool in {len(followed.times)} of {followed.used} frames.',
        )
    found = Signal(np.array(followed.times), np.array(followed.heights))
    if is_elsewhere(found.value, tracker.original_height - np.array(followed.tools)):
        return None, (*warnings, ELSEWHERE)
    if view.close_up:
        pressed = found.value[found.t > tool_height.t[np.nanargmin(tool_height.value)]]
        # A sensor that drifts, or a tool whose height is a little off, is no other frame.
        deep = max(view.settings.tool_margin, _RISES * float(np.ptp(tool_height.value)))
        if pressed.size and np.median(pressed) < -deep:
            return None, (
                'The clouds give no displacement height: they show no support plane, and the '
                'surface that they show rises where it was pushed, so that they are not in the '
                'frame of the plane: record clouds in the frame support_plane.',
            )
    return found, tuple(warnings)


def is_elsewhere(heights: FloatArray, depths: FloatArray) -> bool:
    """
    Return whether a surface is not where the tool presses it.

    Parameters
    ----------
    heights, depths : ndarray, shape (n,)
        Displacement height, and depth of the tool below the original surface [m].

    Returns
    -------
    bool
        Whether it goes down by far less while the tool is down.

    """
    down = depths > _DOWN * float(depths.max(initial=0.0))
    if np.count_nonzero(down) < _FEWEST_DOWN:
        return False
    return bool(np.median(heights[down]) < _WITH_TOOL * np.median(depths[down]))


def _by_noise(
    points: FloatArray, below: float, settings: DisplacementSettings
) -> DisplacementSettings:
    """
    Return settings that go as near to the tool as the noise of the heights allows.

    A tool that stays within millimetres of the surface would leave none to be seen. The noise is
    that of points lower than `below` [m] in the patch around the axis, which are counted from, or
    in a wider one where these are few.
    """
    away = np.hypot(*points[:, :2].T)
    for radius in (settings.patch_radius, 2.0 * settings.patch_radius):
        patch = points[(away < radius) & (points[:, 2] < below)]
        if len(patch) >= _LEAST_TOLD:
            break
    else:
        return settings
    slopes = np.column_stack((np.ones(len(patch)), patch[:, :2]))
    residual = patch[:, 2] - slopes @ np.linalg.lstsq(slopes, patch[:, 2], rcond=None)[0]
    free = len(patch) / (len(patch) - slopes.shape[1])
    noise = NORMAL_FROM_MAD * float(np.median(np.abs(residual))) * np.sqrt(free)
    if noise > _NOISIEST * settings.tool_margin:
        # That much may be a tool in sight as well.
        return settings
    margin = min(max(_NOISES * noise, _LEAST_MARGIN), settings.tool_margin)
    clearance = min(2.0 * margin, settings.tool_clearance)
    return replace(settings, tool_margin=margin, tool_clearance=clearance, noise=noise)


def _close_up(
    frame: CloudFrame,
    tool_height: Signal,
    lowest_before: float,
    contact_point: tuple[float, float, float] | None,
    settings: DisplacementSettings,
) -> _View | None:
    """
    Take clouds that show the top of the object alone, without the plane that it lies on.

    Nothing in such a cloud tells its frame but the tool, which came from above the surface and
    went below it.

    Returns
    -------
    _View or None
        How they are looked at; None if the cloud is none of these.

    """
    points = finite_points(frame.xyz).astype(np.float64)
    if len(points) < settings.least_points:
        return None
    lowest, highest = float(np.nanmin(tool_height.value)), float(np.nanmax(tool_height.value))
    low = max(0.5 * lowest, LARGEST_OFFSET)
    if contact_point is not None:
        axis = np.array(contact_point[:2])
    else:
        # Returns that are lost, and single odd ones, move this less than they do the mean.
        seen = points[points[:, 2] > low, :2]
        if not len(seen):
            return None
        axis = np.quantile(seen, (0.02, 0.98), axis=0).mean(axis=0)
    offset = points[:, :2] - axis
    patch = np.hypot(*offset.T) < settings.patch_radius
    if np.count_nonzero(patch) < settings.least_points:
        return None
    z = points[:, 2]
    height = float(np.median(z[patch]))
    if (
        not max(lowest, LARGEST_OFFSET) < height < highest
        or np.mean(z < low) > _FEW_BELOW
        or np.mean(z > height + LARGEST_OFFSET) > _FEW_ABOVE
    ):
        return None
    # A tool that is in sight is no surface.
    near = _by_noise(np.column_stack((offset, z)), height + LARGEST_OFFSET, settings)
    warning = (
        'The clouds show no support plane: their z was taken as the height above it, since the '
        'tool came from above the surface that they show and went below it.'
    )
    place = ''
    if contact_point is None:
        place = (
            'in the middle of what the clouds show: '
            f'x = {axis[0] * 1e3:.1f} mm, y = {axis[1] * 1e3:.1f} mm'
        )
    where = float(axis[0]), float(axis[1])
    return _View(where, near, None, None, lowest_before, frame.t, True, (warning,), place)


def _set_up(
    frame: CloudFrame,
    tool_height: float,
    lowest: float,
    contact_point: tuple[float, float, float] | None,
    plane: SupportPlane,
    settings: DisplacementSettings,
) -> _View:
    """Return how the clouds are looked at that begin with a frame."""
    xyz = frame.xyz
    warnings: list[str] = []
    rotation = shift = None
    levelled = xyz
    if plane.tilt > LARGEST_TILT or abs(plane.offset) > LARGEST_OFFSET:
        rotation, shift = plane.to_plane_frame()
        with np.errstate(over='ignore', invalid='ignore'):
            levelled = (xyz @ rotation.T + shift).astype(np.float32)
        warnings.append(
            'The clouds are not in the frame support_plane (the largest plane is tilted by '
            f'{np.rad2deg(plane.tilt):.3g} deg, {plane.offset * 1e3:.3g} mm from the origin): '
            'they were brought into the frame of that plane.'
        )
        plane = replace(plane, normal=VERTICAL, offset=0.0)
    place = ''
    if contact_point is not None and rotation is None:
        axis = contact_point[:2]
    else:
        planning = replace(DEFAULT_PLANNING, least_patch_points=settings.least_points)
        try:
            plan = plan_contact(levelled, ceiling=tool_height, plane=plane, settings=planning)
        except InputError:
            # The tool may be near, and out of sight.
            near = tool_height + 2.0 * planning.plane_tolerance
            plan = plan_contact(levelled, ceiling=near, plane=plane, settings=planning)
        axis = plan.contact_point[:2]
        place = (
            'where the vertical through the mass centre of the top view meets the surface: '
            f'x = {axis[0] * 1e3:.1f} mm, y = {axis[1] * 1e3:.1f} mm '
            'in the frame of the support plane'
        )
    points = finite_points(levelled).astype(np.float64)
    points[:, :2] -= axis
    settings = _by_noise(points, tool_height, settings)
    where = float(axis[0]), float(axis[1])
    return _View(where, settings, rotation, shift, lowest, frame.t, False, tuple(warnings), place)


def _in_the_dent(axis: tuple[float, float]) -> str:
    """Say where the dent is."""
    return (
        'in the middle of the dent that the tool left: '
        f'x = {axis[0] * 1e3:.1f} mm, y = {axis[1] * 1e3:.1f} mm in the frame of the support plane'
    )
