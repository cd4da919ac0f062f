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
The records that the layers exchange: signals, clouds, trials and estimates.

All times are seconds since the trial's `start_ns`, all quantities SI (REP-103).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

type FloatArray = NDArray[np.float64]
type PointArray = NDArray[np.float32]

type DisplacementSource = Literal['topic', 'points', 'tool', 'none']


@dataclass(frozen=True, slots=True)
class Signal:
    """
    A scalar quantity sampled over time.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Sample times [s], strictly increasing and finite.
    value : ndarray, shape (n,)
        Samples, finite, in the SI unit of the quantity.

    Raises
    ------
    ValueError
        If the shapes differ, a number is not finite, or the times do not increase.

    """

    t: FloatArray
    value: FloatArray

    def __post_init__(self) -> None:
        if self.t.ndim != 1 or self.t.shape != self.value.shape:
            raise ValueError(f'times {self.t.shape} and values {self.value.shape} do not match')
        if not (np.isfinite(self.t).all() and np.isfinite(self.value).all()):
            raise ValueError('a signal holds finite numbers only')
        if np.any(np.diff(self.t) <= 0.0):
            raise ValueError('the times of a signal increase strictly')

    def __len__(self) -> int:
        return self.t.size

    def between(self, start: float, stop: float) -> 'Signal':
        """Return the samples with ``start <= t < stop`` [s], as views."""
        first, last = np.searchsorted(self.t, (start, stop))
        # Made without the checks, which the whole has passed.
        part = object.__new__(Signal)
        object.__setattr__(part, 't', self.t[first:last])
        object.__setattr__(part, 'value', self.value[first:last])
        return part

    def at(self, t: FloatArray) -> FloatArray:
        """Return the values at times `t` [s], linear in between and held at the ends."""
        return np.interp(t, self.t, self.value)


@dataclass(frozen=True, slots=True)
class CloudFrame:
    """
    One frame of the range sensor.

    Parameters
    ----------
    t : float
        Time of the frame [s].
    xyz : ndarray of float32, shape (height, width, 3) if organised, else (n, 3)
        Points [m] in `frame_id`; may be a strided view on the message. A point that holds NaN or
        Inf is no return (REP-117).
    frame_id : str
        The coordinate frame of the points.

    """

    t: float
    xyz: PointArray
    frame_id: str


class CloudSequence(Protocol):
    """The clouds of a trial in order of time, read from the file as they are asked for."""

    def __len__(self) -> int:
        """Return the number of frames."""
        ...

    def __iter__(self) -> Iterator[CloudFrame]:
        """Yield the frames in order of time; a frame's points may be a view on the file."""
        ...


@dataclass(frozen=True, slots=True)
class Trial:
    """
    One trial: approach, push, hold, release and recover, as it was measured.

    Parameters
    ----------
    name : str
        What a person calls the trial: the bag's name.
    start_ns : int
        The first stamp of the trial [ns since the epoch]; all times below count from it.
    force : Signal
        Contact force F [N], positive in compression.
    tool_height : Signal
        Height of the tool tip above the support plane [m].
    displacement_height : Signal or None
        The paper's H [m]: original height minus height now at the contact point, positive when
        pressed in. None if it was neither recorded nor to be had from the clouds.
    displacement_source : {'topic', 'points', 'tool', 'none'}
        Where H comes from: its own topic, the clouds, or only the tool ('tool': the importer's
        case of one displacement for both, or heights that copy the tool's; true while they touch).
    push_velocity : Signal or None
        Commanded speed along the push [m/s], positive toward the object.
    phases : tuple of (float, str)
        The commanded phases and their times; for display, never trusted over the signals.
    clouds : CloudSequence or None
        The range sensor's frames.
    warnings : tuple of str
        What the reader had to leave out or repair, one sentence each.
    provenance : mapping of str to str
        Where the data come from: file, importer, source, licence.

    """

    name: str
    start_ns: int
    force: Signal
    tool_height: Signal
    displacement_height: Signal | None
    displacement_source: DisplacementSource = 'topic'
    push_velocity: Signal | None = None
    phases: tuple[tuple[float, str], ...] = ()
    clouds: CloudSequence | None = None
    warnings: tuple[str, ...] = ()
    provenance: Mapping[str, str] = field(default_factory=lambda: MappingProxyType({}))


@dataclass(frozen=True, slots=True)
class Estimate:
    """
    An estimated quantity, or the reason why the data cannot tell it.

    Parameters
    ----------
    value : float or None
        The estimate in SI units; None if the data cannot tell it.
    std : float or None
        One standard error, in the same unit.
    reason : str or None
        Why `value` is None, or why it is no better than it is.

    """

    value: float | None
    std: float | None = None
    reason: str | None = None

    @classmethod
    def unknown(cls, reason: str) -> 'Estimate':
        """Return an estimate that the data cannot tell, with the reason."""
        return cls(None, None, reason)

    @property
    def known(self) -> bool:
        """Whether there is a number."""
        return self.value is not None


@dataclass(frozen=True, slots=True)
class Segmentation:
    """
    The phases of a trial (the paper's Fig. 6), found from the signals alone.

    Parameters
    ----------
    t_contact : float or None
        T_c: first touch [s]; the start of the record where the tool already touches.
    t_hold : float or None
        T_s: the tool has reached its depth and stops [s].
    t_release : float or None
        T_e: the hold ends, the tool starts to withdraw [s].
    t_loss : float or None
        The object loses contact with the withdrawing tool [s]; free recovery starts.
    t_end : float
        The last time at which the trial can be used [s].
    contact_height : float or None
        Height of the tool tip at T_c [m]: the original height of the object there.
    force_zero : float
        The load cell's reading without contact [N], to be subtracted.
    push_speed : float or None
        Mean speed of the tool between T_c and T_s [m/s].
    depth : float or None
        Tool displacement from T_c to the hold [m].
    warnings : tuple of str
        What could not be found, and why.
    force_zero_std : float
        Standard error of `force_zero` [N], corrected for autocorrelation; 0 where it is unknown.
    contact_height_std : float
        Standard error of `contact_height` [m]; 0 where it is unknown.
    push_is_cut : bool
        Whether the force is largest at the start of the record: what was pressed before, and for
        how long, is not in it.
    whole : Segmentation or None
        Where the tool pushes in steps: the phases of all of the record, whose push are all steps
        up to the deepest, with the speed of the first.
    t_first : float or None
        In the phases of such a `whole`: when the tool first came to rest [s].

    """

    t_contact: float | None
    t_hold: float | None
    t_release: float | None
    t_loss: float | None
    t_end: float
    contact_height: float | None
    force_zero: float
    push_speed: float | None
    depth: float | None
    warnings: tuple[str, ...] = ()
    force_zero_std: float = 0.0
    contact_height_std: float = 0.0
    push_is_cut: bool = False
    whole: 'Segmentation | None' = None
    t_first: float | None = None

    @property
    def unreleased(self) -> str:
        """Return what to say of phases without a release."""
        if self.whole is None:
            return 'the trial has no release'
        return 'the first step of a push in steps has no release'

    @property
    def in_steps(self) -> tuple[float, ...]:
        """Return after which times from the touch a tool first rests and has its depth [s]."""
        if self.t_first is None or self.t_contact is None:
            return ()
        deep = next(t for t in (self.t_hold, self.t_release, self.t_end) if t is not None)
        return self.t_first - self.t_contact, deep - self.t_contact

    @property
    def entire(self) -> 'Segmentation':
        """Return the phases of all of the record: of the `whole`, where that has others."""
        return self.whole or self

    @property
    def reach(self) -> float | None:
        """Return how deep a tool pushes [m]: up to the end of a push that never ends."""
        endless = self.t_hold is None and self.t_release is None
        if self.depth is None and endless and self.push_speed and self.t_contact is not None:
            return self.push_speed * (self.t_end - self.t_contact)
        return self.depth

    @property
    def hold_time(self) -> float | None:
        """Return how long the trial holds [s]; None where start or end of the hold is unknown."""
        if self.t_hold is None or self.t_release is None:
            return None
        return self.t_release - self.t_hold
