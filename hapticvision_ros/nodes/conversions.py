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
All translation between messages and records, in one place.

A message's setters take numpy scalars and store other numbers without a word, so that every
number passes through `float` or `int` here.
"""

from array import array
from collections.abc import Mapping
import sys
from typing import Any, Final

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import PointStamped, PoseStamped, Vector3Stamped, WrenchStamped
from hapticvision_ros.core.devices import RangeFrame, WrenchSample
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import PointArray
from hapticvision_ros.core.scene.views import Picture, Pose
import numpy as np
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Float64, String

NS_PER_S: Final = 1_000_000_000

_XYZ: Final = ('x', 'y', 'z')
_FLOAT32_SIZE: Final = 4
_CHANNELS: Final = {'mono8': 1, 'rgb8': 3, 'bgr8': 3, 'rgba8': 4, 'bgra8': 4}


def ns_from_stamp(stamp: Any) -> int:
    """Return a stamp as nanoseconds since the epoch."""
    return int(stamp.sec) * NS_PER_S + int(stamp.nanosec)


def stamp_from_ns(stamp_ns: int) -> Any:
    """Return nanoseconds since the epoch as a stamp."""
    sec, nanosec = divmod(int(stamp_ns), NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def wrench_to_message(sample: WrenchSample, frame_id: str) -> Any:
    """Return a reading of the load cell as a WrenchStamped."""
    message = WrenchStamped()
    message.header.stamp = stamp_from_ns(sample.stamp_ns)
    message.header.frame_id = frame_id
    force, torque = message.wrench.force, message.wrench.torque
    force.x, force.y, force.z = (float(item) for item in sample.force)
    torque.x, torque.y, torque.z = (float(item) for item in sample.torque)
    return message


def wrench_from_message(message: Any) -> WrenchSample:
    """Return a WrenchStamped as a reading of the load cell."""
    force, torque = message.wrench.force, message.wrench.torque
    return WrenchSample(
        ns_from_stamp(message.header.stamp),
        (force.x, force.y, force.z),
        (torque.x, torque.y, torque.z),
    )


def contact_force(message: Any) -> float:
    """Return the contact force F [N] of a WrenchStamped: positive in compression."""
    return -float(message.wrench.force.z)


def scalar_to_message(value: float) -> Any:
    """Return a number as a Float64."""
    return Float64(data=float(value))


def text_to_message(text: str) -> Any:
    """Return a text as a String."""
    return String(data=str(text))


def point_to_message(point: tuple[float, float, float], stamp_ns: int, frame_id: str) -> Any:
    """Return a point [m] as a PointStamped."""
    message = PointStamped()
    message.header.stamp = stamp_from_ns(stamp_ns)
    message.header.frame_id = frame_id
    message.point.x, message.point.y, message.point.z = (float(item) for item in point)
    return message


def point_from_message(message: Any) -> tuple[float, float, float]:
    """Return a PointStamped as a point [m]."""
    return (float(message.point.x), float(message.point.y), float(message.point.z))


def vector_to_message(vector: tuple[float, float, float], stamp_ns: int, frame_id: str) -> Any:
    """Return a vector as a Vector3Stamped."""
    message = Vector3Stamped()
    message.header.stamp = stamp_from_ns(stamp_ns)
    message.header.frame_id = frame_id
    message.vector.x, message.vector.y, message.vector.z = (float(item) for item in vector)
    return message


def vector_from_message(message: Any) -> tuple[float, float, float]:
    """Return a Vector3Stamped as a vector."""
    return (float(message.vector.x), float(message.vector.y), float(message.vector.z))


def pose_to_message(pose: Pose, stamp_ns: int, frame_id: str) -> Any:
    """Return a pose as a PoseStamped."""
    message = PoseStamped()
    message.header.stamp = stamp_from_ns(stamp_ns)
    message.header.frame_id = frame_id
    place, turn = message.pose.position, message.pose.orientation
    place.x, place.y, place.z = (float(item) for item in pose.translation)
    turn.x, turn.y, turn.z, turn.w = pose.quaternion
    return message


def pose_from_parts(place: Any, turn: Any) -> Pose:
    """
    Return a Point or Vector3 and a Quaternion as a pose.

    Raises
    ------
    InputError
        If they are none.

    """
    return Pose.from_quaternion((place.x, place.y, place.z), (turn.x, turn.y, turn.z, turn.w))


def picture_from_messages(image: Any, info: Any, pose: Pose) -> Picture:
    """
    Return a rectified Image with its CameraInfo as a picture.

    Parameters
    ----------
    image : sensor_msgs.msg.Image
        In mono8, or three or four channels of 8 bits; their order does not matter.
    info : sensor_msgs.msg.CameraInfo
        Of the same camera; its P holds for rectified pictures, its K where it has no P.
    pose : Pose
        Of the camera's optical frame in the support plane's.

    Raises
    ------
    InputError
        If the encoding is another, the data are cut off, or the camera is not calibrated.

    """
    channels = _CHANNELS.get(image.encoding)
    if channels is None:
        raise InputError(
            f"The camera's image is encoded as '{image.encoding}': set it to publish one of "
            f'{", ".join(_CHANNELS)}.'
        )
    height, width, step = int(image.height), int(image.width), int(image.step)
    if step < width * channels or len(image.data) < height * step:
        raise InputError("The camera's image holds fewer bytes than its size asks for.")
    rows = np.frombuffer(image.data, np.uint8, height * step).reshape(height, step)
    pixels = rows[:, : width * channels].reshape(height, width, channels)
    projection = np.array(info.p, dtype=np.float64).reshape(3, 4)[:, :3]
    matrix = projection if projection[0, 0] > 0.0 else np.array(info.k).reshape(3, 3)
    if not matrix[0, 0] > 0.0 or (info.height, info.width) != (height, width):
        raise InputError(
            "The camera's CameraInfo does not fit its image, or is not calibrated: calibrate the "
            'camera.'
        )
    return Picture(pixels[:, :, 0] if channels == 1 else pixels[:, :, :3], matrix, pose)


def cloud_to_message(frame: RangeFrame, frame_id: str) -> Any:
    """Return an organised frame of the range sensor as a PointCloud2 of float32 x, y, z."""
    xyz = np.ascontiguousarray(frame.xyz, dtype='<f4')
    height, width, _ = xyz.shape
    message = PointCloud2()
    message.header.stamp = stamp_from_ns(frame.stamp_ns)
    message.header.frame_id = frame_id
    message.height, message.width = int(height), int(width)
    message.fields = [
        PointField(name=name, offset=4 * index, datatype=PointField.FLOAT32, count=1)
        for index, name in enumerate(_XYZ)
    ]
    message.is_bigendian = False
    message.point_step = 12
    message.row_step = 12 * int(width)
    message.is_dense = False
    # Of all types that the setter takes, only an array of bytes is not checked item by item.
    data = array('B')
    data.frombytes(memoryview(xyz).cast('B'))
    message.data = data
    return message


def xyz_from_message(message: Any) -> PointArray:
    """
    Return the points of a PointCloud2, without copying where x, y, z lie side by side.

    Parameters
    ----------
    message : sensor_msgs.msg.PointCloud2
        Any layout that holds float32 x, y, z.

    Returns
    -------
    ndarray of float32, shape (height, width, 3)
        Points [m]; a view on the message where its layout allows it.

    Raises
    ------
    InputError
        If x, y or z is missing, no float32 or outside of the point, or the data are shorter than
        the message says.

    """
    offsets = {
        field.name: int(field.offset)
        for field in message.fields
        if field.name in _XYZ and field.datatype == PointField.FLOAT32
    }
    if len(offsets) != len(_XYZ):
        raise InputError(
            'A cloud has no float32 fields x, y and z: set the range sensor to publish them.'
        )
    height, width = int(message.height), int(message.width)
    point_step, row_step = int(message.point_step), int(message.row_step)
    if height == 0 or width == 0:
        return np.empty((height, width, 3), dtype=np.float32)
    if max(offsets.values()) + _FLOAT32_SIZE > point_step:
        # Steps of zero would make a cloud of any size out of a few bytes.
        raise InputError(
            f"A cloud's x, y or z lies outside of its point of {point_step} bytes: the message "
            'contradicts itself.'
        )
    packed = width * point_step
    if row_step < packed or height == 1:
        # Some drivers leave it at zero; without padding it follows from the rest.
        row_step = packed
    needed = (height - 1) * row_step + packed
    if len(message.data) < needed:
        raise InputError(
            f'A cloud of {height} x {width} points needs {needed} bytes but holds '
            f'{len(message.data)}: the message was cut off.'
        )
    dtype = np.dtype('>f4' if message.is_bigendian else '<f4')
    strides = (row_step, point_step)
    x, y, z = (offsets[name] for name in _XYZ)
    if (y, z) == (x + 4, x + 8) and message.is_bigendian == (sys.byteorder == 'big'):
        return np.ndarray((height, width, 3), dtype, message.data, x, (*strides, 4))
    columns = [np.ndarray((height, width), dtype, message.data, o, strides) for o in (x, y, z)]
    return np.stack(columns, axis=-1).astype(np.float32)


def status_to_message(
    name: str, message: str, values: Mapping[str, str], *, warning: bool = False
) -> Any:
    """Return a named state with its key-value pairs as a DiagnosticStatus."""
    return DiagnosticStatus(
        level=DiagnosticStatus.WARN if warning else DiagnosticStatus.OK,
        name=name,
        message=message,
        values=[KeyValue(key=str(key), value=str(value)) for key, value in values.items()],
    )


def values_from_status(message: Any) -> dict[str, str]:
    """Return the key-value pairs of a DiagnosticStatus."""
    return {item.key: item.value for item in message.values}
