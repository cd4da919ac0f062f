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
The devices of a cell, as the nodes see them.

A back end (simulated, or a real device) implements one of these protocols; a driver node owns one
back end and turns its samples into messages. Calls block for at most the stated time and raise
`DeviceError` when the device does not answer.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from hapticvision_ros.core.records import PointArray


@dataclass(frozen=True, slots=True)
class WrenchSample:
    """
    One reading of the load cell.

    Parameters
    ----------
    stamp_ns : int
        When it was measured [ns since the epoch].
    force : tuple of float
        Force of the object on the tool [N] in the frame `load_cell`, +z along the push.
    torque : tuple of float
        Torque [N.m] in the same frame.
    saturated : bool
        Whether the device says that the load is beyond what it can measure.
    fault : str
        What else the device says is wrong with the reading; empty where nothing is.

    """

    stamp_ns: int
    force: tuple[float, float, float]
    torque: tuple[float, float, float]
    saturated: bool = False
    fault: str = ''


@dataclass(slots=True)
class StreamCounts:
    """
    What a back end has seen on its stream since it was made.

    Parameters
    ----------
    received : int
        Readings handed over.
    lost : int
        Readings that never came, by the device's own numbers; 0 where it has none.
    late : int
        Readings that came again, or after a newer one; they are left out.
    garbled : int
        What came and is no reading.
    restarts : int
        How often the device began to count anew.

    """

    received: int = 0
    lost: int = 0
    late: int = 0
    garbled: int = 0
    restarts: int = 0

    def __add__(self, other: 'StreamCounts') -> 'StreamCounts':
        """Return the counts of both: of a device before and after it was opened again."""
        return StreamCounts(
            self.received + other.received,
            self.lost + other.lost,
            self.late + other.late,
            self.garbled + other.garbled,
            self.restarts + other.restarts,
        )


@dataclass(frozen=True, slots=True)
class ArmState:
    """
    The arm's own reading.

    Parameters
    ----------
    stamp_ns : int
        When it was measured [ns since the epoch].
    tool_height : float
        Height of the tool tip above the support plane [m].
    place : tuple of float or None
        x and y of the tool in the arm's own frame [m]; None if it tells heights only.

    """

    stamp_ns: int
    tool_height: float
    place: tuple[float, float] | None = None


@dataclass(frozen=True, slots=True)
class RangeFrame:
    """
    One frame of the range sensor.

    Parameters
    ----------
    stamp_ns : int
        When it was measured [ns since the epoch].
    xyz : ndarray of float32, shape (height, width, 3)
        Points [m] in the frame `support_plane` (z up, z = 0 on the plane); NaN is no return.

    """

    stamp_ns: int
    xyz: PointArray


class LoadCell(Protocol):
    """A force sensor that streams samples."""

    @property
    def counts(self) -> StreamCounts:
        """Return what has been seen on the stream so far."""
        ...

    def read(self, timeout: float) -> Sequence[WrenchSample]:
        """Return the samples since the last call, waiting up to `timeout` [s] for the first."""
        ...

    def close(self) -> None:
        """Let go of the device."""
        ...


class RangeSensor(Protocol):
    """A sensor that measures the shape of what is before it."""

    @property
    def counts(self) -> StreamCounts:
        """Return what has been seen on the stream so far."""
        ...

    def grab(self, timeout: float) -> RangeFrame:
        """Return the next frame, waiting up to `timeout` [s]."""
        ...

    def close(self) -> None:
        """Let go of the device."""
        ...


class Arm(Protocol):
    """An arm that moves the tool along the push axis and reads its own encoders."""

    def read(self, timeout: float) -> Sequence[ArmState]:
        """Return the states since the last call, waiting up to `timeout` [s] for the first."""
        ...

    def command(self, push_velocity: float) -> None:
        """
        Command a speed along the push [m/s], positive toward the object.

        The arm stops by itself when no command has come for its watchdog time.
        """
        ...

    def close(self) -> None:
        """Stop the arm and let go of it."""
        ...
