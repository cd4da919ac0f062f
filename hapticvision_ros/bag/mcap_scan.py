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
Reads MCAP files from front to back, whatever state they are in.

The index and the footer are not needed: a recording that was cut off is read up to the cut. What
cannot be read is counted and told, never raised, once the file has proved to be MCAP at all.

References
----------
.. [1] MCAP format specification, https://mcap.dev/spec

"""

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
import struct
from typing import BinaryIO, Final
import zlib

from hapticvision_ros.bag.cdr import ByteArray, IntArray
from hapticvision_ros.core.errors import InputError
import numpy as np

MAGIC: Final = b'\x89MCAP0\r\n'

_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _METADATA, _DATA_END = 0x03, 0x04, 0x05, 0x06, 0x0C, 0x0F
_IN_CHUNKS: Final = (_SCHEMA, _CHANNEL, _MESSAGE)
_HEAD: Final = struct.Struct('<BQ')
_MESSAGE_HEAD: Final = struct.Struct('<BQH')
_CHUNK_HEAD: Final = struct.Struct('<QQQI')
_RECORD_START: Final = _HEAD.size + 22
"""Bytes of a message record before its data: opcode, length, channel, sequence and two times."""
_WINDOW: Final = 4 * 1024 * 1024
"""How much of a file without chunks is read at once [bytes]."""
_LARGEST_CHUNK: Final = 4 * 1024**3

_FOREIGN: Final = {
    b'SQLite format 3\x00': 'a SQLite bag: convert it with "ros2 bag convert" to MCAP storage',
    b'#ROSBAG V2.0': 'a ROS 1 bag: convert it to an MCAP bag of profile ros2 first',
    b'\x28\xb5\x2f\xfd': 'compressed as a whole: decompress it with "zstd -d" first',
}


@dataclass(frozen=True, slots=True)
class Channel:
    """A topic as an MCAP file announces it."""

    topic: str
    msgtype: str
    message_encoding: str
    schema_encoding: str


@dataclass(frozen=True, slots=True)
class Place:
    """
    Where a run of records lies in a file.

    Parameters
    ----------
    path : Path
        The file.
    position, size : int
        Where the stored bytes begin in the file, and how many they are.
    compression : {'', 'lz4', 'zstd'}
        How they are compressed.
    unpacked_size : int
        Their number once decompressed.
    cut : bool
        Whether the file ends before they do.

    """

    path: Path
    position: int
    size: int
    compression: str
    unpacked_size: int
    cut: bool = False


@dataclass(frozen=True, slots=True)
class Batch:
    """
    The messages of one channel that lie in one run of records.

    Parameters
    ----------
    channel : Channel
        What they are.
    place : Place
        Where the run lies in the file.
    data : ndarray of uint8
        The run's bytes, decompressed.
    starts, sizes : ndarray of int64, shape (n,)
        Where each message's data begin in `data`, and their lengths [bytes].
    log_ns, publish_ns : ndarray of int64, shape (n,)
        When the messages were received and sent [ns since the epoch]; 0 if that is no date.

    """

    channel: Channel
    place: Place
    data: ByteArray
    starts: IntArray
    sizes: IntArray
    log_ns: IntArray
    publish_ns: IntArray


def unpack(place: Place, stored: bytes) -> bytes:
    """
    Return the records of a run: all of them, or what a cut file still holds.

    Parameters
    ----------
    place : Place
        The run.
    stored : bytes
        Its bytes as they lie in the file.

    Raises
    ------
    ValueError
        If they cannot be decompressed, or give another number of bytes than promised.

    """
    if place.cut:
        return _unpack_cut(place.compression, stored)
    size = place.unpacked_size
    if place.compression == '':
        records = stored
    elif size > _LARGEST_CHUNK:
        raise ValueError('it claims to be impossibly large')
    elif place.compression == 'zstd':
        import zstandard

        try:
            if zstandard.frame_content_size(stored) not in (-1, size):
                raise ValueError('it has another size than it claims')
            records = zstandard.ZstdDecompressor().decompress(stored, max_output_size=size)
        except (zstandard.ZstdError, MemoryError) as error:
            raise ValueError('it does not decompress') from error
    elif place.compression == 'lz4':
        try:
            records = _unpack_lz4(stored, size)
        except (RuntimeError, MemoryError) as error:
            raise ValueError('it does not decompress') from error
    else:
        raise ValueError(f'its compression {place.compression!r} is unknown')
    if len(records) != size:
        raise ValueError('it has another size than it claims')
    return records


def _unpack_lz4(data: bytes, limit: int) -> bytes:
    import lz4.frame  # type: ignore[import-untyped]

    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=limit))


def _unpack_cut(compression: str, data: bytes) -> bytes:
    """Return what the first part of a chunk still holds."""
    if compression == 'zstd':
        import zstandard

        try:
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        except zstandard.ZstdError:
            return b''
    if compression == 'lz4':
        try:
            return _unpack_lz4(data, _LARGEST_CHUNK)
        except RuntimeError:
            return b''
    return data if compression == '' else b''


class _Fields:
    """Reads the fields of an MCAP record; raises ValueError where it ends too early."""

    def __init__(self, data: bytes) -> None:
        self.data = data
        self.position = 0

    def take(self, size: int) -> bytes:
        start, stop = self.position, self.position + size
        if stop > len(self.data):
            raise ValueError('the record ends too early')
        self.position = stop
        return self.data[start:stop]

    def integer(self, size: int) -> int:
        return int.from_bytes(self.take(size), 'little')

    def string(self) -> str:
        return self.take(self.integer(4)).decode(errors='replace')

    def mapping(self) -> dict[str, str]:
        stop = self.integer(4) + self.position
        result = {}
        while self.position < stop:
            key = self.string()
            result[key] = self.string()
        return result


class McapScanner:
    """
    One MCAP file and what is found in it.

    Parameters
    ----------
    path : Path
        The file.
    topics : collection of str
        The topics whose messages are wanted; the others are only counted.

    Attributes
    ----------
    channels : dict of int to Channel
        What the file announces, complete once `batches` is exhausted.
    counts : dict of str to int
        How many messages each topic has.
    metadata : dict of str to dict
        The named metadata records.
    faults : list of str
        What could not be read, one sentence each, complete once `batches` is exhausted.

    """

    def __init__(self, path: Path, topics: Collection[str]) -> None:
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.counts: dict[str, int] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.faults: list[str] = []
        self._topics = topics
        self._schemas: dict[int, tuple[str, str]] = {0: ('', '')}
        self._damaged_chunks: list[str] = []
        self._damaged_records = 0
        self._stray = 0

    def batches(self) -> Iterator[Batch]:
        """
        Yield the wanted messages in the order of the file, run by run.

        Raises
        ------
        InputError
            If the file cannot be opened or is not an MCAP file.

        """
        try:
            with self.path.open('rb') as file:
                size = self._check_start(file)
                yield from self._walk_file(file, size)
        except OSError as error:
            raise InputError(
                f'{self.path} cannot be read ({error.strerror}): check the path and permissions'
            ) from error
        self._tell_damage()

    def _check_start(self, file: BinaryIO) -> int:
        size = file.seek(0, 2)
        file.seek(0)
        start = file.read(16)
        if not start:
            raise InputError(f'{self.path} is empty: record or copy it again')
        if not start.startswith(MAGIC):
            for magic, what in _FOREIGN.items():
                if start.startswith(magic):
                    raise InputError(f'{self.path} is {what}')
            raise InputError(
                f'{self.path} is not an MCAP file: give a .mcap file or a rosbag2 bag'
            )
        return size

    def _walk_file(self, file: BinaryIO, size: int) -> Iterator[Batch]:
        position = len(MAGIC)
        while position + _HEAD.size <= size:
            file.seek(position)
            opcode, length = _HEAD.unpack(file.read(_HEAD.size))
            body = position + _HEAD.size
            following = body + length
            if opcode in _IN_CHUNKS and following <= size:
                data = file.read(max(length, min(_WINDOW, size - body)))
                records = _HEAD.pack(opcode, length) + data
                place = Place(self.path, position, len(records), '', len(records))
                found, used = self._walk_records(records, inside_chunk=False)
                if used == 0:
                    break
                yield from self._batches(found, records, place)
                position += used
                continue
            if opcode == _CHUNK and length <= _LARGEST_CHUNK:
                yield from self._chunk(file.read(min(length, size - body)), body, length)
            elif opcode == _METADATA and following <= size:
                self._define(opcode, file.read(length))
            elif opcode == _DATA_END and following <= size:
                self._check_end(file, size)
                return
            elif opcode == 0:
                break
            if following > size:
                break
            position = following
        self.faults.append(
            f'{self.path.name} breaks off at byte {position} of {size}, without index and footer: '
            f'the {sum(self.counts.values())} messages before that were read'
        )

    def _check_end(self, file: BinaryIO, size: int) -> None:
        file.seek(max(0, size - len(MAGIC)))
        if file.read() != MAGIC:
            self.faults.append(
                f'{self.path.name} is cut within its index: no message is lost, but other tools '
                'may refuse it'
            )

    def _chunk(self, body: bytes, position: int, length: int) -> Iterator[Batch]:
        """Yield the messages of a chunk of `length` bytes, of which `body` is there."""
        fields = _Fields(body)
        try:
            _, _, size, checksum = _CHUNK_HEAD.unpack(fields.take(_CHUNK_HEAD.size))
            compression = fields.string()
            stored_size = fields.integer(8)
        except ValueError:
            self._damaged_records += len(body) == length
            return
        start, stop = fields.position, fields.position + stored_size
        stored = body[start:stop]
        cut = len(body) < length
        place = Place(self.path, position + start, len(stored), compression, size, cut)
        try:
            records = unpack(place, stored)
            if not cut and checksum not in (0, zlib.crc32(records)):
                raise ValueError('its checksum is wrong')
        except ValueError as error:
            self._damaged_chunks.append(str(error))
            return
        found, used = self._walk_records(records, inside_chunk=True)
        self._damaged_records += used < len(records) and not cut
        yield from self._batches(found, records, place)

    def _walk_records(
        self, records: bytes, *, inside_chunk: bool
    ) -> tuple[dict[int, list[int]], int]:
        """Return where each channel's message records begin, and how far the records reach."""
        found: dict[int, list[int]] = {}
        position, end = 0, len(records)
        head = _MESSAGE_HEAD.unpack_from
        while position + _MESSAGE_HEAD.size <= end:
            opcode, length, channel = head(records, position)
            following = position + _HEAD.size + length
            if following > end or opcode == 0:
                break
            if opcode == _MESSAGE:
                if channel in found:
                    found[channel].append(position)
                else:
                    found[channel] = [position]
            elif opcode in _IN_CHUNKS:
                start = position + _HEAD.size
                self._define(opcode, records[start:following])
            elif not inside_chunk:
                break
            position = following
        return found, position

    def _define(self, opcode: int, body: bytes) -> None:
        """Take in a schema, channel or metadata record."""
        fields = _Fields(body)
        try:
            if opcode == _METADATA:
                name = fields.string()
                self.metadata[name] = fields.mapping()
                return
            number = fields.integer(2)
            if opcode == _SCHEMA:
                name = fields.string()
                self._schemas[number] = (name, fields.string())
                return
            msgtype, schema_encoding = self._schemas.get(fields.integer(2), ('', ''))
            topic = fields.string()
            self.channels[number] = Channel(topic, msgtype, fields.string(), schema_encoding)
            self.counts.setdefault(topic, 0)
        except ValueError:
            self._damaged_records += 1

    def _batches(
        self, found: dict[int, list[int]], records: bytes, place: Place
    ) -> Iterator[Batch]:
        data = np.frombuffer(records, np.uint8)
        for number, positions in found.items():
            channel = self.channels.get(number)
            if channel is None:
                self._stray += len(positions)
                continue
            self.counts[channel.topic] += len(positions)
            if channel.topic not in self._topics:
                continue
            at = np.array(positions, np.int64)
            sizes = self._column(data, at + 1) - 22
            whole = sizes >= 0
            if not whole.all():
                self._damaged_records += int(np.count_nonzero(~whole))
                at, sizes = at[whole], sizes[whole]
            yield Batch(
                channel=channel,
                place=place,
                data=data,
                starts=at + _RECORD_START,
                sizes=sizes,
                log_ns=self._column(data, at + 15),
                publish_ns=self._column(data, at + 23),
            )

    @staticmethod
    def _column(data: ByteArray, at: IntArray) -> IntArray:
        """Return the 64-bit numbers at the given places; 0 for what is no date and no length."""
        numbers: IntArray = data[at[:, np.newaxis] + np.arange(8)].view('<i8')[:, 0]
        # Below 2^62 ns (the year 2116) differences of times cannot overflow.
        return np.where((numbers >= 0) & (numbers < 2**62), numbers, 0)

    def _tell_damage(self) -> None:
        if self._damaged_chunks:
            self.faults.append(
                f'{len(self._damaged_chunks)} of the chunks of {self.path.name} cannot be read '
                f'(the first: {self._damaged_chunks[0]}): their messages are missing'
            )
        if self._damaged_records:
            self.faults.append(
                f'{self.path.name} has {self._damaged_records} damaged records: left out'
            )
        if self._stray:
            self.faults.append(
                f'{self.path.name} has {self._stray} messages of unknown channels: left out'
            )
