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
CDR, the byte format of ROS 2 messages, for the few types that a trial holds.

Encoding packs one message at a time with a layout that is compiled once. Decoding takes all
messages of a topic that lie in one buffer at once, so that a bag with 200,000 samples costs a few
array operations and not 200,000 calls.

References
----------
.. [1] OMG, "Common Object Request Broker Architecture", part 2, section 9.3 (CDR), and
       "DDS Interoperability Wire Protocol" 2.5, section 10 (the encapsulation header).

"""

from collections.abc import Iterator
from functools import lru_cache
import struct
from typing import Final, Literal

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
import numpy as np
from numpy.typing import NDArray

type ByteArray = NDArray[np.uint8]
type IntArray = NDArray[np.int64]
type BoolArray = NDArray[np.bool_]

ENCAPSULATION: Final = b'\x00\x01\x00\x00'
"""Plain CDR, little endian; alignment counts from behind these four bytes."""

NS_PER_S: Final = 1_000_000_000
FLOAT32: Final = 7
"""`PointField.datatype` of a float32."""

_FLOAT64 = struct.Struct('<4sd')
_XYZ_STEP: Final = 12


def _padding(size: int, alignment: int) -> int:
    """Return how many bytes bring `size` to a multiple of `alignment`."""
    return -size % alignment


def _split_stamp(stamp_ns: int) -> tuple[int, int]:
    """Return the two fields of ``builtin_interfaces/msg/Time``."""
    sec, nanosec = divmod(stamp_ns, NS_PER_S)
    if not -(2**31) <= sec < 2**31:
        raise InputError(
            f'the stamp {stamp_ns} ns does not fit a ROS time: give nanoseconds since the epoch'
        )
    return sec, nanosec


def encode_float64(value: float) -> bytes:
    """Return a ``std_msgs/msg/Float64``."""
    return _FLOAT64.pack(ENCAPSULATION, value)


def encode_string(text: str) -> bytes:
    """Return a ``std_msgs/msg/String``."""
    data = text.encode() + b'\x00'
    return ENCAPSULATION + struct.pack('<I', len(data)) + data


@lru_cache(maxsize=64)
def _wrench_layout(frame_id: str) -> tuple[struct.Struct, bytes]:
    name = frame_id.encode() + b'\x00'
    pad = _padding(12 + len(name), 8)
    return struct.Struct(f'<4siII{len(name)}s{pad}x6d'), name


def encode_wrench(
    stamp_ns: int,
    frame_id: str,
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
) -> bytes:
    """
    Return a ``geometry_msgs/msg/WrenchStamped``.

    Parameters
    ----------
    stamp_ns : int
        Header stamp [ns since the epoch].
    frame_id : str
        Frame of the header.
    force, torque : tuple of float
        Force [N] and torque [N.m].

    Raises
    ------
    InputError
        If the stamp does not fit a ROS time.

    """
    sec, nanosec = _split_stamp(stamp_ns)
    layout, name = _wrench_layout(frame_id)
    return layout.pack(ENCAPSULATION, sec, nanosec, len(name), name, *force, *torque)


class _Encoder:
    """Appends CDR values to a growing buffer, each at its own alignment."""

    def __init__(self) -> None:
        self.data = bytearray()

    def add(self, code: str, *values: int) -> None:
        for value in values:
            size = struct.calcsize(code)
            self.data += bytes(_padding(len(self.data), size)) + struct.pack('<' + code, value)

    def add_string(self, text: str) -> None:
        data = text.encode() + b'\x00'
        self.add('I', len(data))
        self.data += data


@lru_cache(maxsize=64)
def _cloud_middle(prefix_size: int, height: int, width: int) -> bytes:
    """Return what lies between the header and the points of a packed float32 x, y, z cloud."""
    encoder = _Encoder()
    encoder.data += bytes(prefix_size)
    encoder.add('I', height, width, 3)
    for axis, name in enumerate('xyz'):
        encoder.add_string(name)
        encoder.add('I', 4 * axis)
        encoder.add('B', FLOAT32)
        encoder.add('I', 1)
    encoder.add('B', 0)
    row_step = width * _XYZ_STEP
    encoder.add('I', _XYZ_STEP, row_step, row_step * height)
    return bytes(encoder.data[prefix_size:])


def encode_cloud(stamp_ns: int, frame_id: str, xyz: PointArray) -> bytes:
    """
    Return a ``sensor_msgs/msg/PointCloud2`` with float32 x, y, z and nothing else.

    Parameters
    ----------
    stamp_ns : int
        Header stamp [ns since the epoch].
    frame_id : str
        Frame of the points.
    xyz : ndarray of float32, shape (height, width, 3) or (n, 3)
        Points [m]; NaN is no return (REP-117).

    Raises
    ------
    InputError
        If the shape is another one, or the stamp does not fit a ROS time.

    """
    if xyz.ndim not in (2, 3) or xyz.shape[-1] != 3:
        raise InputError(f'a cloud has the shape (height, width, 3) or (n, 3), not {xyz.shape}')
    height, width = (1, xyz.shape[0]) if xyz.ndim == 2 else xyz.shape[:2]
    points = np.ascontiguousarray(xyz, dtype='<f4')
    encoder = _Encoder()
    sec, nanosec = _split_stamp(stamp_ns)
    encoder.add('i', sec)
    encoder.add('I', nanosec)
    encoder.add_string(frame_id)
    middle = _cloud_middle(len(encoder.data), height, width)
    is_dense = bytes([bool(np.isfinite(points).all())])
    return b''.join((ENCAPSULATION, encoder.data, middle, points.tobytes(), is_dense))


def _rows(data: ByteArray, starts: IntArray, size: int) -> ByteArray:
    """Return `size` bytes from each start, shape (n, size)."""
    rows: ByteArray = data[starts[:, np.newaxis] + np.arange(size)]
    return rows


def _plain(data: ByteArray, starts: IntArray, sizes: IntArray, minimum: int) -> BoolArray:
    """Tell which messages are plain CDR of at least `minimum` bytes."""
    plain = sizes >= minimum
    heads = _rows(data, starts[plain], 2)
    plain[plain] = (heads[:, 0] == 0) & (heads[:, 1] <= 1)
    return plain


def _by_byte_order(
    data: ByteArray, starts: IntArray, readable: BoolArray
) -> Iterator[tuple[str, IntArray]]:
    """Yield numpy's sign of each byte order and the indices of the readable messages in it."""
    index = np.flatnonzero(readable)
    little = data[starts[index] + 1] == 1
    yield '<', index[little]
    if not little.all():
        yield '>', index[~little]


def decode_float64(
    data: ByteArray, starts: IntArray, sizes: IntArray
) -> tuple[FloatArray, BoolArray]:
    """
    Return the values of the ``std_msgs/msg/Float64`` that lie in a buffer.

    Parameters
    ----------
    data : ndarray of uint8
        The buffer.
    starts, sizes : ndarray of int, shape (n,)
        Where each message begins, encapsulation header included, and its length [bytes].

    Returns
    -------
    value : ndarray, shape (n,)
        The numbers; NaN where a message cannot be read.
    readable : ndarray of bool, shape (n,)
        Which messages could be read.

    """
    value = np.full(starts.size, np.nan)
    readable = _plain(data, starts, sizes, _FLOAT64.size)
    for order, index in _by_byte_order(data, starts, readable):
        value[index] = _rows(data, starts[index] + 4, 8).view(order + 'f8')[:, 0]
    return value, readable


def decode_wrench(
    data: ByteArray, starts: IntArray, sizes: IntArray
) -> tuple[IntArray, FloatArray, BoolArray]:
    """
    Return stamps and forces of the ``geometry_msgs/msg/WrenchStamped`` that lie in a buffer.

    Parameters
    ----------
    data : ndarray of uint8
        The buffer.
    starts, sizes : ndarray of int, shape (n,)
        Where each message begins, encapsulation header included, and its length [bytes].

    Returns
    -------
    stamp : ndarray of int64, shape (n,)
        Header stamps [ns since the epoch]; 0 where a message cannot be read.
    force : ndarray, shape (n, 3)
        Forces [N]; NaN where a message cannot be read.
    readable : ndarray of bool, shape (n,)
        Which messages could be read.

    """
    stamp = np.zeros(starts.size, np.int64)
    force = np.full((starts.size, 3), np.nan)
    readable = _plain(data, starts, sizes, 16)
    for order, index in _by_byte_order(data, starts, readable):
        begin = starts[index] + 4
        head = _rows(data, begin, 12)
        sec = head[:, :4].view(order + 'i4')[:, 0]
        nanosec = head[:, 4:8].view(order + 'u4')[:, 0]
        name_size = head[:, 8:].view(order + 'u4')[:, 0].astype(np.int64)
        body = (12 + name_size + 7) // 8 * 8
        whole = body + 48 <= sizes[index] - 4
        readable[index[~whole]] = False
        index, begin, body = index[whole], begin[whole], body[whole]
        stamp[index] = sec[whole].astype(np.int64) * NS_PER_S + nanosec[whole]
        force[index] = _rows(data, begin + body, 24).view(order + 'f8')
    return stamp, force, readable


class Decoder:
    """
    Reads CDR values one after the other from one message.

    Parameters
    ----------
    message : bytes-like
        The message with its encapsulation header.

    Raises
    ------
    ValueError
        If the message is not plain CDR; and by every method, if it ends too early.

    """

    def __init__(self, message: memoryview) -> None:
        if len(message) < 4 or message[0] != 0 or message[1] > 1:
            raise ValueError('not plain CDR')
        self._data = message
        self.order: Literal['<', '>'] = '<' if message[1] else '>'
        self.position = 4

    def number(self, code: Literal['B', 'i', 'I']) -> int:
        """Return the integer at the next aligned place."""
        size = struct.calcsize(code)
        start = self.position + _padding(self.position - 4, size)
        self.position = start + size
        if self.position > len(self._data):
            raise ValueError('the message ends too early')
        value: int = struct.unpack_from(self.order + code, self._data, start)[0]
        return value

    def string(self) -> str:
        """Return the text at the next aligned place."""
        start = self.skip(self.number('I'))
        stop = self.position
        return bytes(self._data[start:stop]).rstrip(b'\x00').decode(errors='replace')

    def skip(self, size: int) -> int:
        """Step over `size` bytes; return where they begin."""
        start = self.position
        self.position += size
        if self.position > len(self._data):
            raise ValueError('the message ends too early')
        return start

    def stamp(self) -> int:
        """Return a ``builtin_interfaces/msg/Time`` [ns since the epoch]."""
        sec = self.number('i')
        return sec * NS_PER_S + self.number('I')


def decode_string(message: memoryview) -> str:
    """Return the text of a ``std_msgs/msg/String``; raise ValueError if it cannot be read."""
    return Decoder(message).string()
