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
The range sensor driver on another driver that is an emulated one, over a bad network.

The other driver has a ROS context of its own, hence a participant of its own on the network, and
goes with it: messages are lost, held up, sent twice, overtaken, garbled, and it starts anew.
"""

from contextlib import suppress
from heapq import heappop, heappush
from itertools import count, cycle, pairwise
from random import Random
import threading
import time

from hapticvision_ros.bag.contract import POINTS
from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.nodes import range_sensor_driver
from hapticvision_ros.nodes.conversions import (
    cloud_to_message,
    ns_from_stamp,
    NS_PER_S,
    stamp_from_ns,
    values_from_status,
    xyz_from_message,
)
from hapticvision_ros.nodes.range_backends import connect
import numpy as np
import pytest
import rclpy
from rclpy.context import Context
from sensor_msgs.msg import CameraInfo, Image, PointCloud2, PointField, RegionOfInterest

WIDTH, HEIGHT = 64, 48
FOCAL = 60.0
STEP = 0.04
FRAME = 'scanner_optical_frame'
HUGE = 4_000_000_000
ENOUGH = 3


class OtherDriver:
    """
    Publishes again and again what `make` returns: one message, or None, for each of its topics.

    Attributes
    ----------
    make : callable
        Returns the messages; bytes are sent as they are.
    loss : list of float
        Share of each topic's messages that is lost.
    delay, jitter : float
        How long messages are held up, and how much longer by chance [s].
    again : float
        How much later each message is sent once more [s]; 0 for never.
    stamps : set of int
        Of the first topic's messages that were made [ns].

    """

    def __init__(self, *topics):
        self._topics = topics
        self._random = Random(1)
        self._number = count()
        self._lock = threading.Lock()
        self.stamps = set()
        self.heal()
        self._start()

    def heal(self):
        """Let nothing go wrong any more, and forget what is on its way."""
        with self._lock:
            self.make = lambda: ()
            self.loss = [0.0] * len(self._topics)
            self.delay = self.jitter = self.again = 0.0
            self._waiting = []

    def restart(self, gap=0.0):
        """Go with all that is known of it, and come again after a time [s]."""
        self.close()
        time.sleep(gap)
        self._start()

    def close(self):
        """Go; may be called again."""
        if self._context.ok():
            self._closing.set()
            self._thread.join()
            self._node.destroy_node()
            self._context.shutdown()

    def _start(self):
        self._closing = threading.Event()
        self._context = Context()
        rclpy.init(args=[], context=self._context)
        self._node = rclpy.create_node('another_driver', context=self._context)
        self._publishers = [self._node.create_publisher(*topic, 5) for topic in self._topics]
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    def _run(self):
        while not self._closing.wait(STEP / 4):
            with self._lock:
                self._step(time.monotonic())

    def _step(self, now):
        if next(self._number) % 4 == 0:
            for index, message in enumerate(self.make()):
                if message is None or self._random.random() < self.loss[index]:
                    continue
                if index == 0 and not isinstance(message, bytes):
                    self.stamps.add(ns_from_stamp(message.header.stamp))
                due = now + self.delay + self._random.uniform(0.0, self.jitter)
                for time_due in (due, due + self.again) if self.again else (due,):
                    heappush(self._waiting, (time_due, next(self._number) * 4, index, message))
        while self._waiting and self._waiting[0][0] <= now:
            _, _, index, message = heappop(self._waiting)
            self._publishers[index].publish(message)


@pytest.fixture
def other_driver(ros):
    """Start another driver that ends with the test: kinds and names of its topics."""
    started = []

    def start(*topics):
        started.append(OtherDriver(*topics))
        return started[-1]

    yield start
    for driver in started:
        driver.close()


def with_fields(message, others):
    """Return a message in which some fields are others."""
    for name, value in others.items():
        setattr(message, name, value)
    return message


def in_turn(*makers):
    """Return what makes one of several after the other, again and again."""
    turns = cycle(makers)

    def make():
        return next(turns)()

    return make


class Driver:
    """The driver under test: what it publishes, and what it says of itself."""

    def __init__(self, probe, until, diagnosis):
        self.heard = probe.listen(POINTS)
        self._until = until
        self.status = diagnosis('range_sensor_driver')

    @property
    def stamps(self):
        return [ns_from_stamp(message.header.stamp) for message in self.heard]

    def goes_on(self, what):
        """Wait until more clouds have come."""
        seen = len(self.heard)
        self._until(lambda: len(self.heard) >= seen + ENOUGH, f'clouds: {what}')

    def count_of(self, name):
        """Return a count that the driver tells of its device."""
        status = self.status.wait('device', lambda s, v: True, 'the counts')
        return int(values_from_status(status)[name])

    def counts(self, name, least, what):
        """Wait until a count has come so far."""
        self.status.wait('device', lambda s, v: int(v[name]) >= least, what)

    def fails(self, sentence):
        return self.status.wait(
            'device', lambda s, v: s.level == s.ERROR and sentence in s.message, sentence
        )

    def is_well(self, what):
        self.status.wait('device', lambda s, v: s.level == s.OK, what)


@pytest.fixture
def backend(connected):
    """Make back ends in the test process, whose counts are told without delay."""
    return lambda **values: connected(range_sensor_driver, connect, values)


@pytest.fixture
def driver(probe, until, diagnosis):
    return Driver(probe, until, diagnosis)


# -- clouds ---------------------------------------------------------------------------------------


def cloud(stamp_ns=None):
    """Return a cloud of which each point is a return."""
    xyz = np.random.default_rng(0).uniform(0.2, 0.6, (HEIGHT, WIDTH, 3)).astype(np.float32)
    return cloud_to_message(RangeFrame(stamp_ns or time.time_ns(), xyz), FRAME)


def changed(**fields):
    """Return a maker of clouds in which some fields are others."""
    return lambda: (with_fields(cloud(), fields),)


def fields(*rows):
    return [PointField(name=n, offset=o, datatype=t, count=1) for n, o, t in rows]


F32, F64 = PointField.FLOAT32, PointField.FLOAT64
GARBLED_CLOUDS = {
    'cut off': changed(data=bytes(100)),
    'nothing': changed(data=b''),
    'no points': changed(height=0, width=0, row_step=0, data=b''),
    'no fields': changed(fields=[]),
    'no z': changed(fields=fields(('x', 0, F32), ('y', 4, F32))),
    'doubles': changed(fields=fields(('x', 0, F64), ('y', 4, F64), ('z', 8, F64))),
    'outside of the point': changed(fields=fields(('x', 0, F32), ('y', 4, F32), ('z', HUGE, F32))),
    'points of no size': changed(point_step=0, row_step=0),
    'no size, many of them': changed(point_step=0, row_step=0, height=1, width=HUGE),
    'far too many': changed(height=HUGE, width=HUGE),
    'rows too long': changed(row_step=HUGE),
    'another frame': lambda: (
        cloud_to_message(RangeFrame(time.time_ns(), np.ones((2, 2, 3))), ''),
    ),
}
LATE_CLOUDS = {
    'an hour ahead': lambda: (cloud(time.time_ns() + 3600 * NS_PER_S),),
    'an hour old': lambda: (cloud(time.time_ns() - 3600 * NS_PER_S),),
    'before the epoch': changed(header=cloud(-NS_PER_S).header),
}
NOISE = (b'\0\1\0\0' + b'\xff' * 400, b'\xde\xad\xbe\xef' * 100, b'\0\1\0\0')


def points_parameters(**others):
    return {
        'backend': 'points',
        'points_topic': '/scanner/points',
        'input_frame': FRAME,
        'reopen_interval': 0.1,
        **others,
    }


def test_clouds_over_a_bad_network(start_node, other_driver, driver):
    scanner = other_driver((PointCloud2, '/scanner/points'))
    # Room for a machine that is held up: what is late here is late on purpose.
    start_node('range_sensor_driver', points_parameters(frame_timeout=3.0, largest_age=2.0))

    def go_on(what):
        scanner.heal()
        scanner.make = lambda: (cloud(),)
        driver.goes_on(what)

    go_on('a good network')
    scanner.loss = [0.5]
    for _ in range(4):
        driver.goes_on('half of them lost')
    driver.is_well('half of them lost')

    go_on('nothing lost')
    scanner.delay = 0.6
    slow = driver.status.wait('frames', lambda s, v: float(v['age_s']) > 0.6, 'the delay told')
    assert float(values_from_status(slow)['age_s']) < 2.0
    driver.goes_on('held up')

    go_on('not held up')
    late = driver.count_of('late')
    scanner.jitter = 0.4
    driver.counts('late', late + ENOUGH, 'clouds that were overtaken')
    driver.goes_on('overtaken')

    go_on('in order')
    late = driver.count_of('late')
    scanner.again = STEP / 2
    driver.counts('late', late + ENOUGH, 'clouds that were sent twice')
    driver.goes_on('sent twice')

    go_on('sent once')
    scanner.delay = 5.0
    driver.fails('old, more than largest_age')
    go_on('held up no longer')
    driver.is_well('held up no longer')

    stamps = driver.stamps
    # Each cloud once, in the order of its making, with the stamp that the other driver gave it.
    assert all(later > earlier for earlier, later in pairwise(stamps))
    assert set(stamps) <= scanner.stamps


def take_among(sensor, other_driver, make, bad, count_name):
    """Take frames, of which each second one is bad, until enough of both have come."""
    good = set()

    def made():
        messages = make()
        good.add(ns_from_stamp(messages[0].header.stamp))
        return messages

    other_driver.make = in_turn(made, bad)
    end = time.monotonic() + 60.0
    while getattr(sensor.counts, count_name) < ENOUGH or sensor.counts.received < ENOUGH:
        assert time.monotonic() < end, sensor.counts
        assert sensor.grab(20.0).stamp_ns in good


@pytest.mark.parametrize('what', [*GARBLED_CLOUDS, *LATE_CLOUDS])
def test_a_garbled_cloud_is_left_out_and_counted(what, backend, other_driver):
    scanner = other_driver((PointCloud2, '/scanner/points'))
    sensor = backend(**points_parameters())
    bad = (GARBLED_CLOUDS | LATE_CLOUDS)[what]
    name = 'garbled' if what in GARBLED_CLOUDS else 'late'
    take_among(sensor, scanner, lambda: (cloud(),), bad, name)


def test_the_driver_outlives_garbled_clouds_and_noise(start_node, other_driver, driver):
    scanner = other_driver((PointCloud2, '/scanner/points'))
    node = start_node('range_sensor_driver', points_parameters(frame_timeout=1.0))
    garbage = in_turn(*GARBLED_CLOUDS.values(), *LATE_CLOUDS.values())
    # Noise is no message at all, and does not get as far as the driver.
    noise = cycle(NOISE)
    scanner.make = lambda: (cloud(),)
    driver.goes_on('good ones')
    scanner.make = in_turn(lambda: (cloud(),), in_turn(lambda: (next(noise),), garbage))
    driver.counts('garbled', 2 * len(GARBLED_CLOUDS), 'all of the garbage')
    driver.goes_on('good ones among garbage')
    assert node.returncode is None

    # Only garbage is as bad as silence, and is told as what it is.
    scanner.make = GARBLED_CLOUDS['no z']
    driver.fails('no float32 fields x, y and z')
    scanner.make = lambda: (cloud(),)
    driver.is_well('clouds again')


def test_a_scanner_that_starts_again_is_heard_again(start_node, other_driver, driver):
    scanner = other_driver((PointCloud2, '/scanner/points'))
    start_node('range_sensor_driver', points_parameters(frame_timeout=1.0))
    scanner.make = lambda: (cloud(),)
    driver.goes_on('before')
    scanner.restart()
    driver.goes_on('after a restart')
    scanner.close()
    driver.fails('has given no usable frame for 1 s: see to the driver of the sensor')
    opened = driver.count_of('opened_again')
    scanner._start()
    driver.goes_on('after a longer one')
    driver.is_well('after a longer one')
    assert driver.count_of('opened_again') >= opened
    stamps = driver.stamps
    assert all(later > earlier for earlier, later in pairwise(stamps))


# -- depth images ---------------------------------------------------------------------------------


def image(*size, **others):
    """Return a depth image of a block 40 mm high on the plane, in mm."""
    height, width = size or (HEIGHT, WIDTH)
    depth = np.full((height, width), 500, np.uint16)
    depth[16:32, 20:44] = 460
    message = Image(height=height, width=width, encoding='16UC1', step=2 * width)
    message.header.stamp = stamp_from_ns(time.time_ns())
    message.header.frame_id = FRAME
    message.data = depth.tobytes()
    return with_fields(message, others)


def info(*size, **others):
    height, width = size or (HEIGHT, WIDTH)
    message = CameraInfo(height=height, width=width, distortion_model='plumb_bob')
    message.d = [0.0] * 5
    message.k = [FOCAL, 0.0, 31.5, 0.0, FOCAL, 23.5, 0.0, 0.0, 1.0]
    return with_fields(message, others)


NAN = float('nan')
GARBLED_IMAGES = {
    'coloured': {'encoding': 'rgb8'},
    'compressed': {'encoding': '16UC1; compressedDepth'},
    'no encoding': {'encoding': ''},
    'cut off': {'data': bytes(1000)},
    'nothing': {'data': b''},
    'rows too short': {'step': 3},
    'rows too long': {'step': HUGE},
    'no size': {'height': 0, 'width': 0},
    'far too large': {'height': HUGE, 'width': HUGE},
    'another size': {'height': HEIGHT // 2},
}
GARBLED_INFOS = {
    'not calibrated': {'k': [0.0] * 9},
    'no numbers': {'k': [NAN] * 9},
    'no centre': {'k': [FOCAL, 0.0, NAN, 0.0, FOCAL, 23.5, 0.0, 0.0, 1.0]},
    'far too large': {'height': HUGE, 'width': HUGE},
    'another size': {'height': 10, 'width': 10},
    'binned': {'binning_x': 2},
    'a part': {'roi': RegionOfInterest(x_offset=8, y_offset=8, height=10, width=10)},
    'three coefficients': {'d': [0.1, 0.2, 0.3]},
    'no coefficients': {'d': [NAN] * 5},
    'unknown lens': {'distortion_model': 'equidistant', 'd': [0.1] * 4},
}


@pytest.fixture
def camera(other_driver):
    return other_driver((Image, '/camera/depth'), (CameraInfo, '/camera/info'))


DEPTH_PARAMETERS = {
    'backend': 'depth',
    'depth_topic': '/camera/depth',
    'camera_info_topic': '/camera/info',
    'depth_is_rectified': False,
    'input_frame': FRAME,
    # Half a metre above the support plane, looking straight down.
    'sensor_pose': [0.0, 0.0, 0.5, np.pi, 0.0, 0.0],
    'frame_timeout': 1.0,
    'reopen_interval': 0.1,
}


def shows_the_block(xyz):
    """Return whether a cloud shows the block where it is."""
    z = xyz[..., 2]
    return bool(np.allclose(z[16:32, 20:44], 0.04) and np.allclose(z[40:], 0.0, atol=1e-6))


def test_depth_images_and_camera_infos_over_a_bad_network(start_node, camera, driver):
    start_node('range_sensor_driver', DEPTH_PARAMETERS | {'largest_age': 2.0})
    camera.make = lambda: (image(), None)
    driver.fails('there is no camera info on /camera/info')
    assert not driver.heard
    camera.make = lambda: (image(), info())
    driver.goes_on('with a CameraInfo')
    driver.is_well('with a CameraInfo')
    # The camera is known by now.
    camera.loss = [0.0, 1.0]
    driver.goes_on('without further CameraInfos')
    camera.loss = [0.5, 0.5]
    for _ in range(3):
        driver.goes_on('half of both lost')
    camera.heal()
    camera.make = lambda: (image(), info())
    camera.delay = 0.6
    driver.status.wait('frames', lambda s, v: float(v['age_s']) > 0.6, 'the delay told')
    late = driver.count_of('late')
    camera.jitter = 0.4
    driver.counts('late', late + ENOUGH, 'images that were overtaken')
    driver.goes_on('overtaken')
    camera.heal()
    camera.make = lambda: (None, info())
    driver.fails('see to the driver of the sensor')
    camera.make = lambda: (image(), info())
    driver.goes_on('images again')
    driver.is_well('images again')
    stamps = driver.stamps
    assert all(later > earlier for earlier, later in pairwise(stamps))
    assert set(stamps) <= camera.stamps
    assert all(shows_the_block(xyz_from_message(message)) for message in driver.heard)


def good_pair():
    return (image(), info())


def garbled_images(what):
    """Return a maker of images with one thing wrong."""
    fields = GARBLED_IMAGES[what]
    return lambda: (image(**fields), info())


def garbled_infos(what):
    """Return a maker of CameraInfos with one thing wrong."""
    fields = GARBLED_INFOS[what]
    return lambda: (image(), info(**fields))


@pytest.mark.parametrize('what', GARBLED_IMAGES)
def test_a_garbled_image_is_left_out_and_counted(what, backend, camera):
    sensor = backend(**DEPTH_PARAMETERS)
    take_among(sensor, camera, good_pair, garbled_images(what), 'garbled')


@pytest.mark.parametrize('what', GARBLED_INFOS)
def test_a_frame_with_a_garbled_camera_info_is_left_out(what, backend, camera):
    sensor = backend(**DEPTH_PARAMETERS)
    camera.make = good_pair
    sensor.grab(20.0)
    camera.make = garbled_infos(what)
    end = time.monotonic() + 60.0
    while sensor.counts.garbled < ENOUGH:
        assert time.monotonic() < end
        with suppress(DeviceError):
            sensor.grab(0.1)
    camera.make = good_pair
    received = sensor.counts.received
    while sensor.counts.received < received + ENOUGH:
        frame = sensor.grab(20.0)
    assert shows_the_block(frame.xyz)


def test_the_driver_outlives_garbled_images_and_noise(start_node, camera, driver):
    node = start_node('range_sensor_driver', DEPTH_PARAMETERS)
    garbage = in_turn(*map(garbled_images, GARBLED_IMAGES), *map(garbled_infos, GARBLED_INFOS))
    noise = cycle(NOISE)
    camera.make = good_pair
    driver.goes_on('good ones')
    camera.make = in_turn(good_pair, in_turn(lambda: (next(noise),) * 2, garbage))
    driver.counts('garbled', len(GARBLED_IMAGES) + len(GARBLED_INFOS), 'all of the garbage')
    driver.goes_on('good ones among garbage')
    assert node.returncode is None
    assert all(shows_the_block(xyz_from_message(message)) for message in driver.heard)


def test_a_camera_that_starts_again_with_another_size_is_used(start_node, camera, driver, until):
    start_node('range_sensor_driver', DEPTH_PARAMETERS)
    camera.make = lambda: (image(), info())
    driver.goes_on('before')
    camera.close()
    driver.fails('see to the driver of the sensor')
    camera.make = lambda: (image(96, 128), info(96, 128))
    camera._start()
    until(lambda: driver.heard[-1].width == 128, 'clouds of the other size')
    driver.goes_on('after the restart')
    driver.is_well('after the restart')
    assert driver.heard[-1].height == 96
    stamps = driver.stamps
    assert all(later > earlier for earlier, later in pairwise(stamps))
