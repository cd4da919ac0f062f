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
Bags that other tools might have made: the messages by rosbags, the file by the mcap library.

Nothing here uses this package's own writer, so that reader and writer are not tested against each
other alone.
"""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
    Topic,
    WRENCH,
)
from mcap.writer import CompressionType, Writer
import numpy as np
import pytest
from rosbags.typesys import get_typestore, Stores
from rosbags.typesys.store import Typestore

START_NS = 1_700_000_000_123_456_789
MS = 1_000_000


@dataclass(frozen=True)
class Sample:
    """A message to be written: any topic, any type, any bytes."""

    topic: str
    msgtype: str
    data: bytes
    publish_ns: int
    log_ns: int
    encoding: str = 'cdr'
    schema_encoding: str = 'ros2msg'


class BagMaker:
    """Makes samples with rosbags' serializer and writes them with the mcap library."""

    def __init__(self, store: Typestore) -> None:
        self.store = store

    def header(self, stamp_ns: int, frame_id: str) -> object:
        """Return a std_msgs/msg/Header."""
        sec, nanosec = divmod(stamp_ns, 10**9)
        stamp = self.store.types['builtin_interfaces/msg/Time'](sec=sec, nanosec=nanosec)
        return self.store.types['std_msgs/msg/Header'](stamp=stamp, frame_id=frame_id)

    def pack(self, message: object, msgtype: str, *, little: bool = True) -> bytes:
        """Return a message in CDR."""
        return bytes(self.store.serialize_cdr(message, msgtype, little_endian=little))

    def wrench(
        self,
        ms: float,
        force_z: float,
        *,
        stamp_ns: int | None = None,
        publish_ns: int | None = None,
        frame_id: str = 'load_cell',
        little: bool = True,
    ) -> Sample:
        """Return a wrench `ms` after the start."""
        types = self.store.types
        time = START_NS + round(ms * MS)
        zero = types['geometry_msgs/msg/Vector3'](x=0.0, y=0.0, z=0.0)
        force = types['geometry_msgs/msg/Vector3'](x=0.1, y=-0.2, z=force_z)
        message = types[WRENCH.msgtype](
            header=self.header(time if stamp_ns is None else stamp_ns, frame_id),
            wrench=types['geometry_msgs/msg/Wrench'](force=force, torque=zero),
        )
        publish = time if publish_ns is None else publish_ns
        data = self.pack(message, WRENCH.msgtype, little=little)
        return Sample(WRENCH.name, WRENCH.msgtype, data, publish, publish)

    def number(
        self, topic: Topic, ms: float, value: float, *, log_ns: int | None = None
    ) -> Sample:
        """Return a number `ms` after the start."""
        time = START_NS + round(ms * MS)
        message = self.store.types['std_msgs/msg/Float64'](data=value)
        data = self.pack(message, topic.msgtype)
        return Sample(topic.name, topic.msgtype, data, time, time if log_ns is None else log_ns)

    def text(self, topic: Topic, ms: float, text: str) -> Sample:
        """Return a text `ms` after the start."""
        time = START_NS + round(ms * MS)
        message = self.store.types['std_msgs/msg/String'](data=text)
        return Sample(topic.name, topic.msgtype, self.pack(message, topic.msgtype), time, time)

    def cloud(
        self,
        ms: float,
        *,
        fields: list[tuple[str, int, int]],
        height: int,
        width: int,
        point_step: int,
        row_step: int,
        data: bytes,
        big_endian: bool = False,
        frame_id: str = 'support_plane',
    ) -> Sample:
        """Return a cloud `ms` after the start; fields are (name, offset, datatype)."""
        types = self.store.types
        time = START_NS + round(ms * MS)
        field = types['sensor_msgs/msg/PointField']
        message = types[POINTS.msgtype](
            header=self.header(time, frame_id),
            height=height,
            width=width,
            fields=[field(name=n, offset=o, datatype=d, count=1) for n, o, d in fields],
            is_bigendian=big_endian,
            point_step=point_step,
            row_step=row_step,
            data=np.frombuffer(data, np.uint8),
            is_dense=False,
        )
        return Sample(POINTS.name, POINTS.msgtype, self.pack(message, POINTS.msgtype), time, time)

    def flat_cloud(self, ms: float, xyz: np.ndarray) -> Sample:
        """Return a packed cloud of float32 x, y, z, shape (n, 3)."""
        return self.cloud(
            ms,
            fields=[('x', 0, 7), ('y', 4, 7), ('z', 8, 7)],
            height=1,
            width=len(xyz),
            point_step=12,
            row_step=12 * len(xyz),
            data=np.ascontiguousarray(xyz, np.float32).tobytes(),
        )

    def trial(self, count: int = 100) -> list[Sample]:
        """Return the samples of a small whole trial: force 0..count-1 N at 1 kHz and the rest."""
        samples = [self.wrench(k, -float(k)) for k in range(count)]
        samples += [self.number(TOOL_HEIGHT, k, 0.05 - 1e-4 * k) for k in range(0, count, 2)]
        samples += [self.number(DISPLACEMENT_HEIGHT, k, 1e-4 * k) for k in range(0, count, 10)]
        samples += [self.number(PUSH_VELOCITY, 0, 0.001)]
        samples += [self.text(PHASE, 0, 'approach'), self.text(PHASE, 50, 'push')]
        cloud = np.arange(30, dtype=np.float32).reshape(10, 3)
        samples += [self.flat_cloud(k, cloud + k) for k in (20, 60)]
        return sorted(samples, key=lambda sample: sample.publish_ns)

    def write(
        self,
        path: Path,
        samples: list[Sample],
        *,
        compression: CompressionType = CompressionType.NONE,
        chunked: bool = True,
        chunk_size: int = 4096,
        metadata: dict[str, dict[str, str]] | None = None,
    ) -> Path:
        """Write the samples in the given order."""
        path.parent.mkdir(parents=True, exist_ok=True)
        channels: dict[tuple[str, str, str, str], int] = {}
        with path.open('wb') as file:
            writer = Writer(
                file, chunk_size=chunk_size, compression=compression, use_chunking=chunked
            )
            writer.start('ros2', 'test')
            for name, mapping in (metadata or {}).items():
                writer.add_metadata(name, mapping)
            for sample in samples:
                key = (sample.topic, sample.msgtype, sample.encoding, sample.schema_encoding)
                if key not in channels:
                    text, _ = self.store.generate_msgdef(sample.msgtype, ros_version=2)
                    schema = writer.register_schema(
                        sample.msgtype, sample.schema_encoding, text.encode()
                    )
                    channels[key] = writer.register_channel(sample.topic, sample.encoding, schema)
                writer.add_message(channels[key], sample.log_ns, sample.data, sample.publish_ns)
            writer.finish()
        return path


@pytest.fixture(scope='session')
def store() -> Typestore:
    """Return rosbags' types of ROS 2 Jazzy."""
    return get_typestore(Stores.ROS2_JAZZY)


@pytest.fixture(scope='session')
def maker(store: Typestore) -> BagMaker:
    """Return the maker of foreign bags."""
    return BagMaker(store)


@pytest.fixture
def foreign(maker: BagMaker, tmp_path: Path) -> Callable[..., Path]:
    """Return a function that writes samples to a bare file."""

    def write(samples: list[Sample], name: str = 'trial.mcap', **options: object) -> Path:
        return maker.write(tmp_path / name, samples, **options)

    return write
