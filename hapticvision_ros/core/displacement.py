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
before the push.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import plan_contact
from hapticvision_ros.core.records import CloudFrame, FloatArray, PointArray, Signal
from hapticvision_ros.core.scene.plane import finite_points, fit_support_plane, LARGEST_OFFSET
import numpy as np

LARGEST_TILT: Final = np.deg2rad(2.0)
"""A support plane tilted by more than this [rad] is not that of the contract's frame."""


@dataclass(frozen=True, slots=True)
class DisplacementSettings:
    """
    What counts as the surface at the contact point.

    Parameters
    ----------
    patch_radius : float
        The height is the median within this distance of the contact axis [m].
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
        Fewest points in the patch, as a share of those before the push: a patch that is seen
        only at its rim is still behind the tool.
    least_frames, most_frames : int
        Frames before the push over which the original height is taken: H is unknown before the
        least, the most end it.

    """

    patch_radius: float = 0.005
    region_radius: float = 0.05
    tool_margin: float = 0.002
    tool_clearance: float = 0.004
    least_points: int = 12
    least_share: float = 0.4
    least_frames: int = 3
    most_frames: int = 30


DEFAULT_DISPLACEMENT: Final = DisplacementSettings()


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

    """

    def __init__(
        self,
        contact_axis: tuple[float, float],
        settings: DisplacementSettings = DEFAULT_DISPLACEMENT,
        *,
        rotation: FloatArray | None = None,
        shift: FloatArray | None = None,
    ) -> None:
        self._x, self._y = (np.float32(item) for item in contact_axis)
        self._settings = settings
        self._rotation = None if rotation is None else rotation.T.astype(np.float32)
        self._shift = None if shift is None else shift.astype(np.float32)
        self._region: tuple[slice, slice] | None = None
        self._region_shape: tuple[int, ...] | None = None
        self._heights: list[float] = []
        self._counts: list[int] = []
        self._pushed = False
        self._lowest_tool_height = np.inf

    @property
    def original_height(self) -> float | None:
        """Height of the surface before the push [m], or None before enough frames."""
        if len(self._heights) < self._settings.least_frames:
            return None
        return float(np.median(self._heights))

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
            return None
        settings = self._settings
        surface = self._surface(xyz, tool_height)
        if surface is None:
            height, count = None, 0
        else:
            height, count = surface
        original = self.original_height
        level = height if height is not None else original
        self._lowest_tool_height = min(self._lowest_tool_height, tool_height)
        if level is not None:
            # Also a surface that was hidden when the tool came down has been pushed.
            if self._lowest_tool_height - level < settings.tool_clearance:
                self._pushed = True
            if tool_height - level < settings.tool_clearance:
                return None
        if height is None or count < settings.least_points:
            return None
        if not self._pushed and len(self._heights) < settings.most_frames:
            self._heights.append(height)
            self._counts.append(count)
            original = self.original_height
        if original is None or count < settings.least_share * float(np.median(self._counts)):
            return None
        return original - height

    def _surface(self, xyz: PointArray, tool_height: float) -> tuple[float, int] | None:
        """Return the median height of the patch below the tool and its number of points."""
        settings = self._settings
        points = self._in_region(xyz)
        with np.errstate(over='ignore', invalid='ignore'):
            dx = points[..., 0] - self._x
            dy = points[..., 1] - self._y
            z = points[..., 2]
            patch = (dx * dx + dy * dy < settings.patch_radius**2) & (
                z < tool_height - settings.tool_margin
            )
        # A comparison drops NaN, but not a return at minus infinity.
        heights = z[patch & np.isfinite(z)]
        if not heights.size:
            return None
        return float(np.median(heights)), int(heights.size)

    def _in_region(self, xyz: PointArray) -> PointArray:
        """Return the points that can see the dent, in the frame `support_plane`."""
        if xyz.ndim != 3:
            return self._levelled(xyz)
        if self._region is None or self._region_shape != xyz.shape:
            self._region = self._find_region(xyz)
            self._region_shape = xyz.shape
        return self._levelled(xyz[self._region])

    def _find_region(self, xyz: PointArray) -> tuple[slice, slice]:
        points = self._levelled(xyz)
        with np.errstate(over='ignore', invalid='ignore'):
            near = (points[..., 0] - self._x) ** 2 + (
                points[..., 1] - self._y
            ) ** 2 < self._settings.region_radius**2
        rows, columns = np.flatnonzero(near.any(axis=1)), np.flatnonzero(near.any(axis=0))
        if not rows.size:
            return slice(0, 0), slice(0, 0)
        return slice(rows[0], rows[-1] + 1), slice(columns[0], columns[-1] + 1)

    def _levelled(self, points: PointArray) -> PointArray:
        if self._rotation is None or self._shift is None:
            return points
        with np.errstate(over='ignore', invalid='ignore'):
            return points @ self._rotation + self._shift


def displacement_from_clouds(
    frames: Iterable[CloudFrame],
    tool_height: Signal,
    *,
    contact_point: tuple[float, float, float] | None = None,
    settings: DisplacementSettings = DEFAULT_DISPLACEMENT,
) -> tuple[Signal | None, tuple[str, ...]]:
    """
    Compute H over a trial whose bag has clouds but no displacement height.

    The contract's clouds are in the frame `support_plane`, z up and z = 0 on the plane. The plane
    is estimated all the same: a cloud in some other frame (a sensor's own) is brought into the
    plane's frame, with a warning. Without a given contact point, it is where the vertical through
    the mass centre of the object's top view meets the surface.

    Parameters
    ----------
    frames : iterable of CloudFrame
        The trial's clouds in order of time, read once.
    tool_height : Signal
        Height of the tool tip above the support plane [m].
    contact_point : tuple of float, optional
        The contact point [m] in the frame `support_plane`, where it was recorded.
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
    first, last = float(tool_height.t[0]), float(tool_height.t[-1])
    times: list[float] = []
    heights: list[float] = []
    warnings: list[str] = []
    tracker: DisplacementTracker | None = None
    refusal = 'there is no cloud within the record of the tool height'
    used = 0
    for frame in frames:
        if not first <= frame.t <= last or (times and frame.t <= times[-1]):
            continue
        used += 1
        tool = float(tool_height.at(np.array([frame.t]))[0])
        if tracker is None:
            try:
                tracker, warnings = _set_up(frame.xyz, tool, contact_point, settings)
            except InputError as error:
                text = str(error).rstrip('.')
                refusal = text[:1].lower() + text[1:]
                continue
        height = tracker.update(frame.xyz, tool)
        if height is not None:
            times.append(frame.t)
            heights.append(height)
    if tracker is None:
        return None, (f'The clouds give no displacement height: {refusal}.',)
    if tracker.original_height is None:
        return None, (
            *warnings,
            'The clouds give no displacement height: the surface at the contact point was not '
            'seen before the push.',
        )
    if len(times) < 2:
        return None, (
            *warnings,
            'The clouds give no displacement height: the surface at the contact point was seen '
            f'free of the tool in {len(times)} of {used} frames.',
        )
    return Signal(np.array(times), np.array(heights)), tuple(warnings)


def _set_up(
    xyz: PointArray,
    tool_height: float,
    contact_point: tuple[float, float, float] | None,
    settings: DisplacementSettings,
) -> tuple[DisplacementTracker, list[str]]:
    """Return a tracker for the clouds that begin with `xyz`, and what had to be assumed."""
    warnings: list[str] = []
    plane = fit_support_plane(finite_points(xyz))
    rotation = shift = None
    if plane.tilt > LARGEST_TILT or abs(plane.offset) > LARGEST_OFFSET:
        rotation, shift = plane.to_plane_frame()
        warnings.append(
            'The clouds are not in the frame support_plane (the largest plane is tilted by '
            f'{np.rad2deg(plane.tilt):.3g} deg, {plane.offset * 1e3:.3g} mm from the origin): '
            'they were brought into the frame of that plane.'
        )
    if contact_point is not None and rotation is None:
        axis = contact_point[:2]
    else:
        levelled = xyz
        if rotation is not None and shift is not None:
            with np.errstate(over='ignore', invalid='ignore'):
                levelled = (xyz @ rotation.T + shift).astype(np.float32)
        point = plan_contact(levelled, ceiling=tool_height).contact_point
        axis = point[:2]
        warnings.append(
            'The contact point was taken where the vertical through the mass centre of the '
            f'top view meets the surface: x = {axis[0] * 1e3:.1f} mm, y = {axis[1] * 1e3:.1f} mm '
            'in the frame of the support plane.'
        )
    return DisplacementTracker(axis, settings, rotation=rotation, shift=shift), warnings
