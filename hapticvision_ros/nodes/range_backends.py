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
The range sensors that the driver can use: simulated, or another driver's clouds or depth images.

What comes is brought into the frame `support_plane` by a pose that is configured. Frames that are
old, repeated, of another frame or cannot be read are left out and counted.
"""

from abc import ABC, abstractmethod
import threading
import time
from typing import Any, Final

from hapticvision_ros.core.devices import RangeFrame, RangeSensor, StreamCounts
from hapticvision_ros.core.errors import DeviceError, InputError
from hapticvision_ros.core.records import PointArray
from hapticvision_ros.devices.mounting import Pose
from hapticvision_ros.devices.range_frames import Camera, CloudMover, Deprojector, depth_view
from hapticvision_ros.nodes.conversions import ns_from_stamp, NS_PER_S, xyz_from_message
from hapticvision_ros.nodes.intake import Intake
from hapticvision_ros.nodes.parameters import Parameters, ParameterSpec
from hapticvision_ros.sim.devices import connect_range_sensor
from rclpy.qos import QoSHistoryPolicy, QoSProfile, QoSReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

RANGE_PARAMETERS: Final = (
    ParameterSpec(
        'backend',
        'string',
        '-',
        'Which range sensor to use: the simulated one, the PointCloud2 of another driver '
        '(points), or its depth image and CameraInfo (depth).',
        choices=('simulated', 'points', 'depth'),
        read_only=True,
    ),
    ParameterSpec(
        'simulated_world_port',
        'integer',
        '-',
        'UDP port of the simulated world on loopback.',
        1,
        65535,
        read_only=True,
    ),
    ParameterSpec(
        'width', 'integer', '-', 'Columns of a simulated cloud.', 16, 4096, read_only=True
    ),
    ParameterSpec(
        'height', 'integer', '-', 'Rows of a simulated cloud.', 16, 4096, read_only=True
    ),
    ParameterSpec(
        'simulated_depth_noise',
        'double',
        'm',
        'Standard deviation of the depth that the simulated sensor measures.',
        0.0,
        0.01,
        read_only=True,
    ),
    ParameterSpec(
        'simulated_seed',
        'integer',
        '-',
        "Seed of the simulated sensor's noise.",
        0,
        2**31 - 1,
        read_only=True,
    ),
    ParameterSpec('points_topic', 'string', '-', "Another driver's PointCloud2.", read_only=True),
    ParameterSpec(
        'depth_topic',
        'string',
        '-',
        "Another driver's depth image: 16UC1 in mm or 32FC1 in m.",
        read_only=True,
    ),
    ParameterSpec(
        'camera_info_topic', 'string', '-', "The depth image's CameraInfo.", read_only=True
    ),
    ParameterSpec(
        'depth_is_rectified',
        'bool',
        '-',
        'Whether the depth image is rectified (its CameraInfo is then read by P) or has the '
        "lens's distortion (K and D).",
        read_only=True,
    ),
    ParameterSpec(
        'sensor_pose',
        'double_array',
        '-',
        "The sensor's frame (of a depth image the optical frame) in support_plane: x, y, z [m], "
        'roll, pitch, yaw [rad].',
        -10.0,
        10.0,
        read_only=True,
    ),
    ParameterSpec(
        'input_frame',
        'string',
        '-',
        'Frame that the messages must name; empty for any.',
        read_only=True,
    ),
    ParameterSpec(
        'nearest',
        'double',
        'm',
        'What is nearer to the sensor is no return; with a sensor_pose of zeros, as of clouds '
        'that are in support_plane already, nothing is.',
        0.0,
        100.0,
        read_only=True,
    ),
    ParameterSpec(
        'farthest',
        'double',
        'm',
        'What is farther from the sensor is no return.',
        0.01,
        100.0,
        read_only=True,
    ),
    ParameterSpec(
        'largest_age',
        'double',
        's',
        'A frame that was measured longer ago when it arrives is left out, and one that is '
        'stamped farther ahead.',
        0.001,
        60.0,
        read_only=True,
    ),
)
"""The parameters of the range sensor driver that choose and describe its sensor."""

_POLL: Final = 0.05
_CLOCK_JUMP_NS: Final = NS_PER_S
_SENSOR_DATA: Final = QoSProfile(
    history=QoSHistoryPolicy.KEEP_LAST, depth=5, reliability=QoSReliabilityPolicy.BEST_EFFORT
)


class _TopicSensor(ABC):
    """What clouds and depth images have in common."""

    def __init__(self, node: Any, parameters: Parameters, kind: Any, topic: str) -> None:
        self.counts = StreamCounts()
        self._topic = topic
        self._node = node
        self._frame_id = parameters.text('input_frame')
        self._largest_age_ns = round(parameters.real('largest_age') * NS_PER_S)
        self._last_ns: int | None = None
        self._lock = threading.Lock()
        self._closed = False
        self._frames = Intake(node, kind, topic, _SENSOR_DATA, raw=False)

    def grab(self, timeout: float) -> RangeFrame:
        """Return the next frame, waiting up to `timeout` [s]; late frames are skipped."""
        deadline = time.monotonic() + timeout
        reason = 'see to the driver of the sensor'
        while True:
            with self._lock:
                if self._closed:
                    raise DeviceError('the range sensor has been closed')
                waiting = list(self._frames.take()) if self._frames.wait(_POLL) else []
            if waiting:
                self.counts.lost += len(waiting) - 1
                message, sent_ns, _ = waiting[-1]
                try:
                    frame = self._frame(message, sent_ns)
                except InputError as error:
                    self.counts.garbled += 1
                    text = str(error).rstrip('.')
                    reason = text[:1].lower() + text[1:]
                except _Late as late:
                    self.counts.late += 1
                    reason = str(late)
                else:
                    self.counts.received += 1
                    return frame
            if time.monotonic() > deadline:
                raise DeviceError(
                    f'{self._topic} has given no usable frame for {timeout:g} s: {reason}'
                )

    def close(self) -> None:
        """Listen no longer; may be called again."""
        with self._lock:
            if not self._closed:
                self._closed = True
                self._close()

    def _close(self) -> None:
        self._frames.close()

    def _frame(self, message: Any, sent_ns: int) -> RangeFrame:
        """Return a message as a frame, or raise why not."""
        frame_id = message.header.frame_id
        if self._frame_id and frame_id != self._frame_id:
            raise InputError(
                f"The frames are in '{frame_id}' instead of '{self._frame_id}': set input_frame "
                'and sensor_pose for this sensor.'
            )
        stamp_ns = ns_from_stamp(message.header.stamp) or sent_ns
        self._check_time(stamp_ns)
        xyz = self._points(message)
        self._last_ns = stamp_ns
        return RangeFrame(stamp_ns, xyz)

    def _check_time(self, stamp_ns: int) -> None:
        age_ns = self._node.get_clock().now().nanoseconds - stamp_ns
        if age_ns > self._largest_age_ns:
            raise _Late(
                f'its frames are {age_ns / NS_PER_S:.3g} s old, more than largest_age: set the '
                "clocks of the machines by each other, or lower the sensor's rate"
            )
        if -age_ns > self._largest_age_ns:
            # What is in time behind it would be taken for old, and no tool height would fit it.
            raise _Late(
                f"its frames are stamped {-age_ns / NS_PER_S:.3g} s ahead of this machine's time, "
                'more than largest_age: set the clocks of the machines by each other'
            )
        last_ns = self._last_ns
        if last_ns is not None and stamp_ns <= last_ns:
            if last_ns - stamp_ns <= _CLOCK_JUMP_NS:
                raise _Late('its frames come again and again')
            self.counts.restarts += 1

    @abstractmethod
    def _points(self, message: Any) -> PointArray:
        """Return the points of a message in `support_plane`."""


class _Late(Exception):
    """A frame that is of another time than it should be."""


class CloudTopic(_TopicSensor):
    """Clouds of another driver."""

    def __init__(self, node: Any, parameters: Parameters) -> None:
        self._mover = CloudMover(_pose(parameters), *_range(parameters))
        super().__init__(node, parameters, PointCloud2, _topic(parameters, 'points_topic'))

    def _points(self, message: Any) -> PointArray:
        xyz = xyz_from_message(message)
        if not xyz.size:
            raise InputError('The clouds are empty.')
        return self._mover.points(xyz)


class DepthTopics(_TopicSensor):
    """Depth images of another driver, with the camera's intrinsics."""

    def __init__(self, node: Any, parameters: Parameters) -> None:
        self._pose = _pose(parameters)
        self._range = _range(parameters)
        self._rectified = parameters.flag('depth_is_rectified')
        self._info_topic = _topic(parameters, 'camera_info_topic')
        self._camera: Camera | None = None
        self._rays: tuple[Camera, Deprojector] | None = None
        self._infos = Intake(node, CameraInfo, self._info_topic, _SENSOR_DATA, raw=False)
        super().__init__(node, parameters, Image, _topic(parameters, 'depth_topic'))

    def _close(self) -> None:
        super()._close()
        self._infos.close()

    def _points(self, message: Any) -> PointArray:
        for info, _, _ in self._infos.take():
            self._camera = camera_from_message(info, rectified=self._rectified)
        if self._camera is None:
            raise InputError(f'There is no camera info on {self._info_topic}.')
        depth = depth_view(
            message.data,
            encoding=message.encoding,
            width=int(message.width),
            height=int(message.height),
            step=int(message.step),
            is_bigendian=bool(message.is_bigendian),
        )
        return self._deprojector_of(self._camera, depth.shape).points(depth)

    def _deprojector_of(self, camera: Camera, shape: tuple[int, ...]) -> Deprojector:
        """Return the rays of a camera, made anew only where it is another one."""
        if shape != (camera.height, camera.width):
            # Before any ray is made: of a garbled size there would be too many.
            raise InputError(
                f'A depth image has {shape[1]} x {shape[0]} pixels, its CameraInfo '
                f'{camera.width} x {camera.height}: they belong to different streams.'
            )
        if self._rays is None or self._rays[0] != camera:
            self._rays = camera, Deprojector(camera, self._pose, *self._range)
        return self._rays[1]


def camera_from_message(message: Any, *, rectified: bool) -> Camera:
    """
    Return the intrinsics of a CameraInfo.

    Parameters
    ----------
    message : sensor_msgs.msg.CameraInfo
        The message.
    rectified : bool
        Whether the image that it belongs to is rectified.

    Raises
    ------
    InputError
        If the camera is not calibrated, or the image is a part of the sensor.

    """
    roi = message.roi
    if max(message.binning_x, message.binning_y) > 1 or roi.x_offset or roi.y_offset:
        raise InputError(
            'The depth image is binned or a region of interest: set the camera to send the whole '
            'image.'
        )
    k, p = [float(item) for item in message.k], [float(item) for item in message.p]
    matrix = (k[0], k[4], k[2], k[5])
    if rectified:
        # P of a camera that was never rectified is left at zero.
        matrix = (p[0], p[5], p[2], p[6]) if p[0] else matrix
        return Camera(int(message.width), int(message.height), matrix)
    return Camera(
        int(message.width),
        int(message.height),
        matrix,
        str(message.distortion_model),
        tuple(float(item) for item in message.d),
    )


def _pose(parameters: Parameters) -> Pose:
    numbers = parameters.reals('sensor_pose')
    if len(numbers) != 6:
        raise InputError(
            f'sensor_pose is {list(numbers)}: give six numbers, x, y, z [m] and roll, pitch, yaw '
            '[rad].'
        )
    return Pose.of(numbers)


def _range(parameters: Parameters) -> tuple[float, float]:
    nearest, farthest = parameters.real('nearest'), parameters.real('farthest')
    if not nearest < farthest:
        raise InputError(f'nearest is {nearest:g} m and farthest {farthest:g} m: nothing is left.')
    return nearest, farthest


def _topic(parameters: Parameters, name: str) -> str:
    topic = parameters.text(name)
    if not topic:
        raise InputError(f'{name} is empty: name the topic of the sensor.')
    return topic


def connect(node: Any, parameters: Parameters) -> RangeSensor:
    """
    Connect to the range sensor that the parameters choose.

    Parameters
    ----------
    node : rclpy.node.Node
        The node that uses it.
    parameters : Parameters
        Those of `RANGE_PARAMETERS`.

    Returns
    -------
    RangeSensor
        The sensor; one over topics may be silent still.

    Raises
    ------
    InputError
        If the parameters do not fit together.
    DeviceError
        If the sensor does not answer.

    """
    match parameters.text('backend'):
        case 'points':
            return CloudTopic(node, parameters)
        case 'depth':
            return DepthTopics(node, parameters)
    return connect_range_sensor(
        parameters.integer('simulated_world_port'),
        width=parameters.integer('width'),
        height=parameters.integer('height'),
        depth_noise=parameters.real('simulated_depth_noise'),
        seed=parameters.integer('simulated_seed'),
    )
