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

"""The range sensor driver on the topics of another driver."""

import time

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hapticvision_ros.bag.contract import POINTS
from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    ns_from_stamp,
    NS_PER_S,
    values_from_status,
    xyz_from_message,
)
from hapticvision_ros.nodes.diagnostics import DIAGNOSTICS
from hapticvision_ros.nodes.range_backends import camera_from_message
import numpy as np
import pytest
from sensor_msgs.msg import CameraInfo, Image, PointCloud2

WIDTH, HEIGHT = 64, 48
FOCAL = 60.0
# Half a metre above the support plane, looking straight down.
POSE = '[0.0, 0.0, 0.5, 3.141592653589793, 0.0, 0.0]'
STEP = 0.04


def _stamp(age=0.0):
    sec, nanosec = divmod(time.time_ns() - round(age * NS_PER_S), NS_PER_S)
    return Time(sec=sec, nanosec=nanosec)


def _depth():
    """Return a depth image of a block 40 mm high on the plane."""
    depth = np.full((HEIGHT, WIDTH), 500, np.uint16)
    depth[16:32, 20:44] = 460
    depth[0, 0] = 0
    return depth


def _image(depth, age=0.0, frame='camera_depth_optical_frame'):
    message = Image(height=HEIGHT, width=WIDTH, encoding='16UC1', step=2 * WIDTH)
    message.header.stamp = _stamp(age)
    message.header.frame_id = frame
    message.data = depth.tobytes()
    return message


def _info():
    message = CameraInfo(height=HEIGHT, width=WIDTH, distortion_model='plumb_bob')
    message.d = [0.0] * 5
    message.k = [FOCAL, 0.0, 31.5, 0.0, FOCAL, 23.5, 0.0, 0.0, 1.0]
    message.p = [FOCAL, 0.0, 31.5, 0.0, 0.0, FOCAL, 23.5, 0.0, 0.0, 0.0, 1.0, 0.0]
    return message


class Camera:
    """Publishes a message again and again, as another driver does."""

    def __init__(self, node, topics):
        self._publishers = [node.create_publisher(kind, topic, 5) for kind, topic in topics]
        self.make = None
        self._timer = node.create_timer(STEP, self._send)

    def _send(self):
        if self.make is not None:
            for publisher, message in zip(self._publishers, self.make(), strict=True):
                publisher.publish(message)


@pytest.fixture
def statuses(probe):
    heard = []
    probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, heard.append, 10)
    return heard


def _new_status(heard, since, name, level):
    for array in heard[since:]:
        for status in array.status:
            if status.name.endswith(f': {name}') and status.level == level:
                return status
    return None


def test_a_depth_image_becomes_a_cloud_on_the_support_plane(start_node, probe, until, statuses):
    start_node(
        'range_sensor_driver',
        {
            'backend': 'depth',
            'depth_topic': '/camera/depth',
            'camera_info_topic': '/camera/info',
            'sensor_pose': POSE,
            'input_frame': 'camera_depth_optical_frame',
            'frame_timeout': 0.5,
        },
    )
    camera = Camera(probe.node, [(Image, '/camera/depth'), (CameraInfo, '/camera/info')])
    camera.make = lambda: (_image(_depth()), _info())
    heard = probe.listen(POINTS)
    until(lambda: len(heard) >= 3, 'clouds')
    xyz = xyz_from_message(heard[-1])
    assert xyz.shape == (HEIGHT, WIDTH, 3)
    assert heard[-1].header.frame_id == 'support_plane'
    assert abs(time.time_ns() - ns_from_stamp(heard[-1].header.stamp)) < 10 * NS_PER_S
    assert xyz[16:32, 20:44, 2] == pytest.approx(0.04, abs=1e-6)
    assert xyz[40:, :, 2] == pytest.approx(0.0, abs=1e-6)
    assert np.isnan(xyz[0, 0]).all()
    # The columns go along x, the rows against y: the camera looks down.
    assert xyz[24, 40, 0] == pytest.approx(0.46 * (40 - 31.5) / FOCAL, abs=1e-6)
    assert xyz[20, 30, 1] == pytest.approx(-0.46 * (20 - 23.5) / FOCAL, abs=1e-6)

    # Each in turn: what is wrong is told, nothing is passed on, and then it goes on.
    troubles = {
        'instead of': lambda: (_image(_depth(), frame='other'), _info()),
        'old, more than largest_age': lambda: (_image(_depth(), age=3.0), _info()),
        'belong to different streams': lambda: (
            _image(_depth()),
            CameraInfo(height=10, width=10, k=_info().k),
        ),
        'see to the driver of the sensor': None,
    }
    for sentence, make in troubles.items():
        seen = len(statuses)
        camera.make = make
        bad = until(
            lambda seen=seen: _new_status(statuses, seen, 'device', DiagnosticStatus.ERROR),
            f'an error: {sentence}',
        )
        assert sentence in bad.message
        camera.make = lambda: (_image(_depth()), _info())
        count, seen = len(heard), len(statuses)
        until(lambda count=count: len(heard) > count, f'clouds after: {sentence}')
        until(
            lambda seen=seen: _new_status(statuses, seen, 'device', DiagnosticStatus.OK),
            f'a good state after: {sentence}',
        )

    # A lens that is covered.
    seen = len(statuses)
    camera.make = lambda: (_image(np.zeros_like(_depth())), _info())
    covered = until(
        lambda: _new_status(statuses, seen, 'frames', DiagnosticStatus.WARN), 'a warning'
    )
    assert values_from_status(covered)['share_of_returns'] == '0'


def test_a_cloud_is_passed_on_in_the_frame_of_the_support_plane(start_node, probe, until):
    start_node(
        'range_sensor_driver',
        {'backend': 'points', 'points_topic': '/scanner/points', 'sensor_pose': POSE},
    )
    scanner = Camera(probe.node, [(PointCloud2, '/scanner/points')])
    xyz = np.random.default_rng(0).uniform(0.2, 0.6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    xyz[3, 4] = np.nan
    scanner.make = lambda: (
        cloud_to_message(RangeFrame(time.time_ns(), xyz), 'scanner_optical_frame'),
    )
    heard = probe.listen(POINTS)
    until(lambda: len(heard) >= 3, 'clouds')
    moved = xyz_from_message(heard[-1])
    assert heard[-1].header.frame_id == 'support_plane'
    assert moved == pytest.approx(
        xyz * np.float32([1, -1, -1]) + np.float32([0, 0, 0.5]), abs=1e-6, nan_ok=True
    )
    # No stamp is published twice, and the sensor's own is kept.
    stamps = [ns_from_stamp(message.header.stamp) for message in heard]
    assert len(set(stamps)) == len(stamps)


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'backend': 'points', 'points_topic': "''"}, 'points_topic is empty'),
        ({'backend': 'points', 'sensor_pose': '[0.0]'}, 'give six numbers'),
        ({'backend': 'depth', 'nearest': 3.0}, 'nothing is left'),
    ],
)
def test_a_wrong_setting_is_refused_with_one_sentence(start_node, parameters, sentence):
    node = start_node('range_sensor_driver', parameters)
    assert node.wait() == 2
    assert sentence in node.output
    assert len(node.output.splitlines()) == 1


def test_intrinsics_are_those_of_the_kind_of_image():
    info = _info()
    info.d = [0.1, 0.0, 0.0, 0.0, 0.0]
    info.p[0] = 70.0
    assert camera_from_message(info, rectified=True).matrix == (70.0, FOCAL, 31.5, 23.5)
    assert camera_from_message(info, rectified=True).distortion == ()
    raw = camera_from_message(info, rectified=False)
    assert raw.matrix == (FOCAL, FOCAL, 31.5, 23.5)
    assert raw.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)
    info.binning_x = 2
    with pytest.raises(InputError, match='send the whole image'):
        camera_from_message(info, rectified=True)
