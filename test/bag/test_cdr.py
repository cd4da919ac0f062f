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


"""The hand-packed CDR agrees with the serializers of ROS 2 and of rosbags."""

from hapticvision_ros.bag import cdr
from hapticvision_ros.bag.clouds import read_layout, view_points
from hapticvision_ros.core.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
import numpy as np
import pytest
from rosbags.typesys.store import Typestore

numbers = st.floats(width=64)
stamps = st.integers(-(2**31) * 10**9, 2**31 * 10**9 - 1)
frames = st.text(st.characters(codec='utf-8', exclude_characters='\x00'), max_size=20)
vectors = st.tuples(numbers, numbers, numbers)


def whole(message: bytes) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return a message as a buffer with one start and one size."""
    data = np.frombuffer(message, np.uint8)
    return data, np.array([0]), np.array([data.size])


@given(value=numbers)
def test_float64_is_what_rosbags_writes(store: Typestore, value: float) -> None:
    msgtype = 'std_msgs/msg/Float64'
    expected = store.serialize_cdr(store.types[msgtype](data=value), msgtype)
    assert cdr.encode_float64(value) == bytes(expected)


@given(text=frames)
def test_string_is_what_rosbags_writes(store: Typestore, text: str) -> None:
    msgtype = 'std_msgs/msg/String'
    expected = bytes(store.serialize_cdr(store.types[msgtype](data=text), msgtype))
    assert cdr.encode_string(text) == expected
    assert cdr.decode_string(memoryview(expected)) == text


@settings(deadline=None)
@given(stamp_ns=stamps, frame_id=frames, force=vectors, torque=vectors)
def test_wrench_is_read_back_by_rosbags(
    store: Typestore,
    stamp_ns: int,
    frame_id: str,
    force: tuple[float, float, float],
    torque: tuple[float, float, float],
) -> None:
    msgtype = 'geometry_msgs/msg/WrenchStamped'
    data = cdr.encode_wrench(stamp_ns, frame_id, force, torque)
    message = store.deserialize_cdr(data, msgtype)
    stamp = message.header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == stamp_ns
    assert message.header.frame_id == frame_id
    for vector, given_vector in ((message.wrench.force, force), (message.wrench.torque, torque)):
        np.testing.assert_array_equal((vector.x, vector.y, vector.z), given_vector)
    assert bytes(store.serialize_cdr(message, msgtype)) == data


@given(
    little=st.lists(st.booleans(), min_size=1, max_size=8),
    stamp_ns=stamps,
    frame_id=frames,
    force=vectors,
)
@settings(deadline=None)
def test_wrenches_of_both_byte_orders_are_decoded_together(
    store: Typestore,
    little: list[bool],
    stamp_ns: int,
    frame_id: str,
    force: tuple[float, float, float],
) -> None:
    msgtype = 'geometry_msgs/msg/WrenchStamped'
    message = store.deserialize_cdr(
        cdr.encode_wrench(stamp_ns, frame_id, force, (0.0, 0.0, 0.0)), msgtype
    )
    parts = [bytes(store.serialize_cdr(message, msgtype, little_endian=one)) for one in little]
    starts = np.cumsum([0] + [len(part) + 3 for part in parts])[:-1]
    data = np.frombuffer(b'???'.join(parts), np.uint8)
    found, forces, readable = cdr.decode_wrench(data, starts, np.array([len(p) for p in parts]))
    assert readable.all()
    assert (found == stamp_ns).all()
    np.testing.assert_array_equal(forces, np.tile(force, (len(parts), 1)))


def test_messages_are_what_rclpy_writes() -> None:
    serialization = pytest.importorskip('rclpy.serialization')
    from geometry_msgs.msg import WrenchStamped
    from sensor_msgs.msg import PointCloud2
    from std_msgs.msg import Float64, String

    wrench = WrenchStamped()
    wrench.header.stamp.sec, wrench.header.stamp.nanosec = 12, 34
    wrench.header.frame_id = 'load_cell'
    wrench.wrench.force.z, wrench.wrench.torque.x = -1.5, 0.25
    stamp_ns = 12 * 10**9 + 34
    # Padding is compared nowhere: the middleware leaves there whatever its buffer held.
    theirs = serialization.serialize_message(wrench)
    ours = cdr.encode_wrench(stamp_ns, 'load_cell', (0.0, 0.0, -1.5), (0.25, 0.0, 0.0))
    assert len(theirs) == len(ours)
    assert serialization.deserialize_message(ours, WrenchStamped) == wrench
    stamps, forces, _ = cdr.decode_wrench(*whole(theirs))
    assert stamps == [stamp_ns]
    assert forces.tolist() == [[0.0, 0.0, -1.5]]
    assert serialization.serialize_message(Float64(data=0.1)) == cdr.encode_float64(0.1)
    theirs = serialization.serialize_message(String(data='push'))
    assert cdr.decode_string(memoryview(theirs)) == 'push'
    assert serialization.deserialize_message(cdr.encode_string('push'), String).data == 'push'

    xyz = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    cloud = serialization.deserialize_message(
        cdr.encode_cloud(stamp_ns, 'support_plane', xyz), PointCloud2
    )
    assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (2, 4, 12, 48)
    assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
        ('x', 0, 7, 1),
        ('y', 4, 7, 1),
        ('z', 8, 7, 1),
    ]
    assert cloud.is_dense and not cloud.is_bigendian
    assert cloud.header.frame_id == 'support_plane'
    assert bytes(cloud.data) == xyz.tobytes()
    theirs = memoryview(serialization.serialize_message(cloud))
    layout = read_layout(theirs)
    assert (layout.stamp_ns, layout.frame_id) == (stamp_ns, 'support_plane')
    np.testing.assert_array_equal(view_points(theirs, layout), xyz)


@given(data=st.binary(max_size=120), size=st.integers(0, 120))
def test_no_bytes_upset_the_decoders(data: bytes, size: int) -> None:
    buffer, start, _ = whole(data + bytes(120))
    for decode in (cdr.decode_float64, cdr.decode_wrench):
        result = decode(buffer, start, np.array([size]))
        assert result[-1].shape == (1,)


@pytest.mark.parametrize('encapsulation', [b'\x00\x02', b'\x00\x07', b'\x01\x01'])
def test_other_encapsulations_are_refused(encapsulation: bytes) -> None:
    message = encapsulation + cdr.encode_float64(1.0)[2:]
    value, readable = cdr.decode_float64(*whole(message))
    assert not readable.any() and np.isnan(value).all()


def test_a_cut_message_is_refused() -> None:
    message = cdr.encode_wrench(1, 'load_cell', (1.0, 2.0, 3.0), (4.0, 5.0, 6.0))
    for size in range(len(message)):
        assert not cdr.decode_wrench(*whole(message[:size]))[-1].any()
    assert cdr.decode_wrench(*whole(message))[-1].all()


def test_a_stamp_that_ros_cannot_hold_is_refused() -> None:
    with pytest.raises(InputError, match='does not fit a ROS time'):
        cdr.encode_wrench(2**31 * 10**9, 'load_cell', (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))


def test_a_cloud_of_another_shape_is_refused() -> None:
    with pytest.raises(InputError, match='shape'):
        cdr.encode_cloud(0, 'support_plane', np.zeros((4, 2), np.float32))
