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
Writes contract bags: rosbag2 directories as Jazzy writes them, or bare ``.mcap`` files.

A live recording is written in place and its chunk is closed twice a second, so that a
crash costs the last second and never the bag. A bag that is made offline appears under its name
only when it is whole.
"""

from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from functools import lru_cache
import heapq
import os
from pathlib import Path
import shutil
import time
from types import TracebackType
from typing import Any, cast, Final, Literal, Self

from hapticvision_ros.bag import cdr
from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PROVENANCE,
    PUSH_VELOCITY,
    Qos,
    TOOL_HEIGHT,
    Topic,
    TOPICS,
    WRENCH,
)
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import CloudFrame, FloatArray, PointArray, Signal
from mcap.writer import CompressionType, Writer
import numpy as np
import yaml

type Compression = Literal['none', 'lz4', 'zstd']

CHUNK_SIZE: Final = 1024 * 1024
"""Bytes in a chunk before it is closed: clouds are then written one a chunk, without copies."""
FLUSH_PERIOD_S: Final = 0.5
"""
A recording that dies loses at most what came in this time, and what was still on its way here: no
more than the last second.
"""
METADATA_FILE: Final = 'metadata.yaml'
METADATA_VERSION: Final = 9
ROS_DISTRO: Final = 'jazzy'

_COMPRESSIONS: Final = {
    'none': CompressionType.NONE,
    'lz4': CompressionType.LZ4,
    'zstd': CompressionType.ZSTD,
}
_INFINITE: Final = {'sec': 9223372036, 'nsec': 854775807}


@lru_cache(maxsize=64)
def _definition(msgtype: str) -> tuple[bytes, str]:
    """Return a type's full ros2msg text and its RIHS01 hash."""
    from rosbags.typesys import get_typestore, Stores

    store = get_typestore(Stores.ROS2_JAZZY)
    text, _ = store.generate_msgdef(msgtype, ros_version=2)
    return text.encode(), store.hash_rihs01(msgtype)


def preload() -> None:
    """Look up the definitions of the contract's types: the first time takes seconds."""
    for topic in TOPICS:
        _definition(topic.msgtype)


def _offered_qos(qos: Qos) -> list[dict[str, Any]]:
    """Return the publisher's quality of service as rosbag2 spells it in version 9."""
    return [
        {
            'history': 'keep_last',
            'depth': qos.publish_depth,
            'reliability': qos.reliability,
            'durability': qos.durability,
            'deadline': dict(_INFINITE),
            'lifespan': dict(_INFINITE),
            'liveliness': 'automatic',
            'liveliness_lease_duration': dict(_INFINITE),
            'avoid_ros_namespace_conventions': False,
        }
    ]


def _dump_yaml(value: object) -> str:
    return yaml.safe_dump(value, sort_keys=False, default_flow_style=False, width=1000)


class BagWriter:
    """
    Write one bag; use it as a context manager or call `close`.

    Not for several threads at once.

    Parameters
    ----------
    path : Path
        The bag to make: a bare file if it ends in ``.mcap``, else a rosbag2 directory. Missing
        parents are made.
    compression : {'none', 'lz4', 'zstd'}
        Compression of the chunks: none for live recordings, zstd for small bags.
    atomic : bool
        Write to a hidden sibling that takes the bag's name at `close` and is removed if the
        ``with`` block fails. Otherwise the bag is written in place and what was written stays,
        also after an error.

    Raises
    ------
    InputError
        If the bag exists already or cannot be written.

    """

    def __init__(
        self, path: Path, *, compression: Compression = 'none', atomic: bool = False
    ) -> None:
        self.path = path
        self._bare = path.suffix == '.mcap'
        self._live = not atomic
        self._target = path.with_name(f'.{path.name}.partial-{os.getpid()}') if atomic else path
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._topics: dict[str, Topic] = {}
        self._counts: dict[str, int] = {}
        self._first_ns: int | None = None
        self._last_ns = 0
        self._closed = False
        for topic in TOPICS:
            # The definitions take a while once; better now than at the first message.
            _definition(topic.msgtype)
        if path.exists():
            raise InputError(f'{path} exists already: remove it or choose another name')
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            if not self._bare:
                self._target.mkdir()
            self._file = self._storage_file().open('xb')
        except OSError as error:
            raise self._failure(error) from error
        self._writer = Writer(
            self._file, chunk_size=CHUNK_SIZE, compression=_COMPRESSIONS[compression]
        )
        self._writer.start(profile='ros2', library='hapticvision_ros')
        self._last_flush = time.monotonic()

    def __enter__(self) -> Self:
        """Return the writer."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the bag; discard an atomic one after an error."""
        if kind is not None and not self._live:
            self._discard()
        else:
            self.close()

    @property
    def message_count(self) -> int:
        """How many messages were written."""
        return sum(self._counts.values())

    def write_raw(
        self, topic: Topic, data: bytes | memoryview, log_time_ns: int, publish_time_ns: int
    ) -> None:
        """
        Write a message that is CDR already, as a raw subscription gives it.

        Parameters
        ----------
        topic : Topic
            Where it came from; its type and quality of service go into the bag.
        data : bytes or memoryview
            The serialized message with its encapsulation header.
        log_time_ns, publish_time_ns : int
            When it was received and when it was sent [ns since the epoch].

        Raises
        ------
        InputError
            If the bag cannot be written.

        """
        channel = self._channels.get(topic.name)
        try:
            if channel is None:
                channel = self._register(topic)
            # The library's annotation is narrower than what its buffer takes.
            self._writer.add_message(channel, log_time_ns, cast('bytes', data), publish_time_ns)
            # An offline bag is discarded when it fails; without the clock it is reproducible.
            if self._live and time.monotonic() - self._last_flush >= FLUSH_PERIOD_S:
                self.flush()
        except OSError as error:
            raise self._failure(error) from error
        self._counts[topic.name] += 1
        if self._first_ns is None or log_time_ns < self._first_ns:
            self._first_ns = log_time_ns
        self._last_ns = max(self._last_ns, log_time_ns)

    def write_wrench(
        self,
        stamp_ns: int,
        force: tuple[float, float, float],
        torque: tuple[float, float, float] = (0.0, 0.0, 0.0),
    ) -> None:
        """Write a sample of the load cell: force [N] of the object on the tool, torque [N.m]."""
        data = cdr.encode_wrench(stamp_ns, WRENCH.frame_id, force, torque)
        self.write_raw(WRENCH, data, stamp_ns, stamp_ns)

    def write_float64(self, topic: Topic, publish_ns: int, value: float) -> None:
        """Write a number in the unit of `topic`."""
        self.write_raw(topic, cdr.encode_float64(value), publish_ns, publish_ns)

    def write_string(self, topic: Topic, publish_ns: int, text: str) -> None:
        """Write a text."""
        self.write_raw(topic, cdr.encode_string(text), publish_ns, publish_ns)

    def write_cloud(self, stamp_ns: int, frame_id: str, xyz: PointArray) -> None:
        """Write a frame of the range sensor: points [m], shape (height, width, 3) or (n, 3)."""
        self.write_raw(POINTS, cdr.encode_cloud(stamp_ns, frame_id, xyz), stamp_ns, stamp_ns)

    def write_metadata(self, name: str, mapping: Mapping[str, str]) -> None:
        """Write a named record of texts, such as the provenance of the data."""
        # The name of a file may be no text; what it cannot be read as is a question mark.
        texts = {key: os.fsencode(text).decode(errors='replace') for key, text in mapping.items()}
        try:
            self._writer.add_metadata(name, texts)
        except OSError as error:
            raise self._failure(error) from error

    def flush(self) -> None:
        """
        Close the chunk and hand all that was written to the operating system.

        `write_raw` does this twice a second by itself; call it when the messages stop.
        """
        self._writer.flush()  # type: ignore[no-untyped-call]
        self._last_flush = time.monotonic()

    def close(self) -> None:
        """Finish the bag: index, footer, ``metadata.yaml``. A second call does nothing."""
        if self._closed:
            return
        self._closed = True
        try:
            with self._file:
                information = self._information()
                self._writer.add_metadata(
                    'rosbag2', {'serialized_metadata': _dump_yaml(information)}
                )
                self._writer.finish()  # type: ignore[no-untyped-call]
                self._file.flush()
                os.fsync(self._file.fileno())
            if not self._bare:
                text = _dump_yaml({'rosbag2_bagfile_information': information})
                partial = self._target / f'.{METADATA_FILE}.partial'
                partial.write_text(text)
                partial.replace(self._target / METADATA_FILE)
            if not self._live:
                self._target.rename(self.path)
        except OSError as error:
            if not self._live:
                self._discard()
            raise self._failure(error) from error

    def _discard(self) -> None:
        self._closed = True
        # What is still in the buffer is not wanted; it may be what did not fit on the disk.
        with suppress(OSError):
            self._file.close()
        if self._bare:
            self._target.unlink(missing_ok=True)
        else:
            shutil.rmtree(self._target, ignore_errors=True)

    def _failure(self, error: OSError) -> InputError:
        return InputError(
            f'{self.path} cannot be written ({error.strerror}): choose a place with room and '
            'write permission'
        )

    def _storage_file(self) -> Path:
        return self._target if self._bare else self._target / f'{self.path.name}_0.mcap'

    def _register(self, topic: Topic) -> int:
        """Announce a topic in the file; return its channel."""
        text, digest = _definition(topic.msgtype)
        schema = self._schemas.get(topic.msgtype)
        if schema is None:
            schema = self._writer.register_schema(topic.msgtype, 'ros2msg', text)
            self._schemas[topic.msgtype] = schema
        channel = self._writer.register_channel(
            topic.name,
            'cdr',
            schema,
            {
                'offered_qos_profiles': _dump_yaml(_offered_qos(topic.qos)),
                'topic_type_hash': digest,
            },
        )
        self._channels[topic.name] = channel
        self._topics[topic.name] = topic
        self._counts[topic.name] = 0
        return channel

    def _information(self) -> dict[str, Any]:
        """Return what ``metadata.yaml`` says, in the order in which rosbag2 says it."""
        first_ns = 0 if self._first_ns is None else self._first_ns
        duration = {'nanoseconds': max(0, self._last_ns - first_ns)}
        start = {'nanoseconds_since_epoch': first_ns}
        file = f'{self.path.name}_0.mcap' if not self._bare else self.path.name
        return {
            'version': METADATA_VERSION,
            'storage_identifier': 'mcap',
            'duration': duration,
            'starting_time': start,
            'message_count': self.message_count,
            'topics_with_message_count': [
                {
                    'topic_metadata': {
                        'name': name,
                        'type': topic.msgtype,
                        'serialization_format': 'cdr',
                        'offered_qos_profiles': _offered_qos(topic.qos),
                        'type_description_hash': _definition(topic.msgtype)[1],
                    },
                    'message_count': self._counts[name],
                }
                for name, topic in self._topics.items()
            ],
            'compression_format': '',
            'compression_mode': '',
            'relative_file_paths': [file],
            'files': [
                {
                    'path': file,
                    'starting_time': dict(start),
                    'duration': dict(duration),
                    'message_count': self.message_count,
                }
            ],
            'custom_data': {},
            'ros_distro': ROS_DISTRO,
        }


type _Item = tuple[int, int, Topic, bytes]


def _stamps(start_ns: int, t: FloatArray) -> list[int]:
    stamps: list[int] = (start_ns + np.rint(t * cdr.NS_PER_S).astype(np.int64)).tolist()
    return stamps


def _stamp(start_ns: int, t: float) -> int:
    return start_ns + round(t * cdr.NS_PER_S)


def _numbers(order: int, topic: Topic, start_ns: int, signal: Signal) -> Iterator[_Item]:
    stamps = _stamps(start_ns, signal.t)
    for stamp, value in zip(stamps, signal.value.tolist(), strict=True):
        yield stamp, order, topic, cdr.encode_float64(value)


def _forces(order: int, start_ns: int, force: Signal) -> Iterator[_Item]:
    stamps = _stamps(start_ns, force.t)
    for stamp, value in zip(stamps, force.value.tolist(), strict=True):
        data = cdr.encode_wrench(stamp, WRENCH.frame_id, (0.0, 0.0, -value), (0.0, 0.0, 0.0))
        yield stamp, order, WRENCH, data


def _clouds(order: int, start_ns: int, frames: Iterable[CloudFrame]) -> Iterator[_Item]:
    for frame in frames:
        stamp = _stamp(start_ns, frame.t)
        yield stamp, order, POINTS, cdr.encode_cloud(stamp, frame.frame_id, frame.xyz)


def _texts(
    order: int, topic: Topic, start_ns: int, texts: Iterable[tuple[float, str]]
) -> Iterator[_Item]:
    for t, text in texts:
        yield _stamp(start_ns, t), order, topic, cdr.encode_string(text)


def write_signals(
    path: Path,
    *,
    start_ns: int,
    force: Signal,
    tool_height: Signal,
    displacement: Signal | None = None,
    push_velocity: Signal | None = None,
    phases: Iterable[tuple[float, str]] = (),
    clouds: Iterable[CloudFrame] = (),
    extra: Iterable[tuple[Topic, Signal]] = (),
    provenance: Mapping[str, str] | None = None,
    compression: Compression = 'zstd',
) -> None:
    """
    Write a trial that is in memory as a contract bag, which appears only when it is whole.

    Parameters
    ----------
    path : Path
        The bag to make: a bare file if it ends in ``.mcap``, else a rosbag2 directory.
    start_ns : int
        Epoch of the times below [ns].
    force : Signal
        Contact force F [N], positive in compression.
    tool_height : Signal
        Height of the tool tip above the support plane [m].
    displacement : Signal, optional
        The paper's displacement height H [m].
    push_velocity : Signal, optional
        Commanded speed along the push [m/s].
    phases : iterable of (float, str)
        Commanded phases and their times, in order of time.
    clouds : iterable of CloudFrame
        Frames of the range sensor, in order of time; taken one at a time.
    extra : iterable of (Topic, Signal)
        Numbers outside the contract, each on a topic of type ``std_msgs/msg/Float64``.
    provenance : mapping of str to str, optional
        Where the data come from. ``displacement_source: tool`` says that one recorded
        displacement serves as both the tool's and the object's.
    compression : {'none', 'lz4', 'zstd'}
        Compression of the chunks.

    Raises
    ------
    InputError
        If the bag exists already or cannot be written.

    """
    streams = [
        _forces(0, start_ns, force),
        _numbers(1, TOOL_HEIGHT, start_ns, tool_height),
        _clouds(4, start_ns, clouds),
        _texts(5, PHASE, start_ns, phases),
    ]
    if displacement is not None:
        streams.append(_numbers(2, DISPLACEMENT_HEIGHT, start_ns, displacement))
    if push_velocity is not None:
        streams.append(_numbers(3, PUSH_VELOCITY, start_ns, push_velocity))
    for order, (topic, signal) in enumerate(extra, start=6):
        streams.append(_numbers(order, topic, start_ns, signal))
    with BagWriter(path, compression=compression, atomic=True) as writer:
        if provenance is not None:
            writer.write_metadata(PROVENANCE, provenance)
        for stamp, _, topic, data in heapq.merge(*streams, key=lambda item: item[:2]):
            writer.write_raw(topic, data, stamp, stamp)
