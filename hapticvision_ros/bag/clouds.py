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


"""The range sensor's clouds: read from the file one at a time, as views on the message's bytes."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import BinaryIO, Final

from hapticvision_ros.bag.cdr import Decoder, FLOAT32
from hapticvision_ros.bag.mcap_scan import Place, unpack
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import CloudFrame, PointArray
import numpy as np

FLOAT64: Final = 8
"""`PointField.datatype` of a float64."""

_FORMATS: Final = {FLOAT32: 'f4', FLOAT64: 'f8'}
_MOST_FIELDS: Final = 1024


@dataclass(frozen=True, slots=True)
class CloudLayout:
    """
    Where the points of a ``sensor_msgs/msg/PointCloud2`` lie in its message.

    Parameters
    ----------
    stamp_ns : int
        Header stamp [ns since the epoch].
    frame_id : str
        Frame of the points.
    height, width : int
        Rows and points in a row; the height is 1 if the cloud is not organised.
    row_step, point_step : int
        Bytes from row to row and from point to point.
    offsets : tuple of int
        Where x, y and z of the first point lie, counted from the start of the message [bytes].
    formats : tuple of str
        Their numpy formats, byte order included.

    """

    stamp_ns: int
    frame_id: str
    height: int
    width: int
    row_step: int
    point_step: int
    offsets: tuple[int, int, int]
    formats: tuple[str, str, str]

    @property
    def native(self) -> bool:
        """Whether the coordinates are float32 in this machine's byte order."""
        return all(np.dtype(code) == np.float32 for code in self.formats)


def _coordinates(fields: dict[str, tuple[int, int]], point_step: int) -> list[tuple[int, int]]:
    """Return offset and type of x, y and z."""
    missing = [name for name in 'xyz' if name not in fields]
    if missing:
        raise ValueError(f'it has no field {", ".join(missing)}')
    found = [fields[name] for name in 'xyz']
    for name, (offset, datatype) in zip('xyz', found, strict=True):
        if datatype not in _FORMATS:
            raise ValueError(f'its field {name} is not a floating-point number')
        if offset + np.dtype(_FORMATS[datatype]).itemsize > point_step:
            raise ValueError(f'its field {name} lies outside the point')
    return found


def read_layout(message: memoryview) -> CloudLayout:
    """
    Return the layout of a ``sensor_msgs/msg/PointCloud2``.

    Parameters
    ----------
    message : memoryview
        The serialized message with its encapsulation header.

    Raises
    ------
    ValueError
        If it is no cloud with floating-point x, y, z, or its sizes contradict each other; the
        text says what is wrong.

    """
    decoder = Decoder(message)
    stamp_ns = decoder.stamp()
    frame_id = decoder.string()
    height, width = decoder.number('I'), decoder.number('I')
    count = decoder.number('I')
    if count > _MOST_FIELDS:
        raise ValueError('it claims an impossible number of fields')
    fields: dict[str, tuple[int, int]] = {}
    for _ in range(count):
        name = decoder.string()
        fields[name] = (decoder.number('I'), decoder.number('B'))
        decoder.number('I')
    order = '>' if decoder.number('B') else '<'
    point_step, row_step = decoder.number('I'), decoder.number('I')
    size = decoder.number('I')
    start = decoder.skip(size)
    found = _coordinates(fields, point_step)
    packed = width * point_step
    if row_step < packed or height == 1:
        # Some drivers leave the row step at zero; without padding it follows from the rest.
        row_step = packed
    if height and width and (height - 1) * row_step + packed > size:
        raise ValueError('it holds fewer bytes than its height, width and steps ask for')
    x, y, z = (start + offset for offset, _ in found)
    fx, fy, fz = (order + _FORMATS[datatype] for _, datatype in found)
    return CloudLayout(
        stamp_ns, frame_id, height, width, row_step, point_step, (x, y, z), (fx, fy, fz)
    )


def view_points(message: memoryview, layout: CloudLayout) -> PointArray:
    """
    Return the points of a cloud, without a copy where they lie evenly as native float32.

    Parameters
    ----------
    message : memoryview
        The serialized message.
    layout : CloudLayout
        What `read_layout` returned for it.

    Returns
    -------
    xyz : ndarray of float32, shape (height, width, 3) if organised, else (n, 3)
        The points [m], read-only where they are a view.

    """
    shape: tuple[int, ...] = (layout.height, layout.width)
    strides: tuple[int, ...] = (layout.row_step, layout.point_step)
    if layout.height <= 1:
        shape, strides = (layout.height * layout.width,), (layout.point_step,)
    if 0 in shape:
        return np.empty((0, 3), np.float32)
    x, y, z = layout.offsets
    if layout.native and y - x == z - y:
        return np.ndarray(
            (*shape, 3), np.float32, buffer=message, offset=x, strides=(*strides, y - x)
        )
    axes = [
        np.ndarray(shape, code, buffer=message, offset=offset, strides=strides)
        for offset, code in zip(layout.offsets, layout.formats, strict=True)
    ]
    return np.stack(axes, axis=-1).astype(np.float32)


@dataclass(frozen=True, slots=True)
class CloudReference:
    """
    A cloud that stays in its file until it is asked for.

    Parameters
    ----------
    t : float
        Its time [s].
    layout : CloudLayout
        Where its points lie in the message.
    place : Place
        The run of records that holds the message.
    start, size : int
        Where the message begins in the run once decompressed, and its length [bytes].

    """

    t: float
    layout: CloudLayout
    place: Place
    start: int
    size: int


class BagClouds:
    """
    The clouds of a bag, in order of time; each pass reads the file again.

    One cloud (and, in a compressed bag, one chunk) is in memory at a time.

    Parameters
    ----------
    references : sequence of CloudReference
        The clouds, in order of time.

    """

    def __init__(self, references: Sequence[CloudReference]) -> None:
        self._references = tuple(references)

    def __len__(self) -> int:
        """Return the number of frames."""
        return len(self._references)

    def __iter__(self) -> Iterator[CloudFrame]:
        """
        Yield the frames in order of time; their points are views on the message where possible.

        Raises
        ------
        InputError
            If the bag has changed or gone since it was scanned.

        """
        file: BinaryIO | None = None
        path = run = None
        records = memoryview(b'')
        try:
            for reference in self._references:
                place = reference.place
                if path != place.path:
                    if file is not None:
                        file.close()
                    path = place.path
                    file = path.open('rb')
                assert file is not None
                if place.compression == '':
                    start = place.position + reference.start
                    message = memoryview(_read(file, start, reference.size))
                else:
                    if run != place:
                        stored = _read(file, place.position, place.size)
                        records, run = memoryview(unpack(place, stored)), place
                    start, stop = reference.start, reference.start + reference.size
                    message = records[start:stop]
                points = view_points(message, reference.layout)
                yield CloudFrame(reference.t, points, reference.layout.frame_id)
        except (OSError, ValueError) as error:
            raise InputError(
                f'{path} has changed since it was opened, its clouds are gone: read it again'
            ) from error
        finally:
            if file is not None:
                file.close()


def _read(file: BinaryIO, position: int, size: int) -> bytes:
    file.seek(position)
    data = file.read(size)
    if len(data) < size:
        raise ValueError('the file has become shorter')
    return data
