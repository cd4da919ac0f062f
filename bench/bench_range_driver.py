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
The whole range sensor driver, live: displacement height from 640x480 frames at 30 Hz.

A camera process publishes frames as a device's own driver does, clouds in one run and depth images
in the other, and the tool's height at 250 Hz; the driver runs as an integrator starts it. Heights
are counted and timed here, from the stamp of the frame; clouds are taken as raw bytes, as the
planner does. The CPU time is that of the driver's process, all of its threads.

    OMP_NUM_THREADS=1 python bench/bench_range_driver.py [--seconds 20] [--rate 30]
"""

import argparse
from collections.abc import Callable, Iterator
import os
from pathlib import Path
import subprocess
import sys
import tempfile
import time
from typing import Any

from hapticvision_ros.bag.contract import CONTACT_POINT, DISPLACEMENT_HEIGHT, POINTS, TOOL_HEIGHT
from hapticvision_ros.cli.processes import node, ros_environment
from hapticvision_ros.core.devices import RangeFrame
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np

WIDTH, HEIGHT = 640, 480
FOCAL, ABOVE = 600.0, 0.5
"""Of the depth camera, which looks straight down: focal length [px], height [m]."""
BLOCK = 0.04
NOISE = 5e-4
CLOUDS, DEPTH, INFO = '/bench/points', '/bench/depth', '/bench/info'
FRAME = 'bench_camera'
UP = 0.080
TOOL_RATE = 250.0
LEVELS = 4e-4 * np.arange(8)
"""Dents of the frames that are sent in turn [m]: they tell which frame a height is of."""
BEFORE = 60
"""Frames of the object as it was, which are not counted."""
START_DEADLINE = 60.0


def clouds() -> Iterator[Callable[[int], Any]]:
    """Yield makers of stamped clouds: first of the object as it was, then of each dent."""
    from hapticvision_ros.nodes.conversions import cloud_to_message

    config = load_config()
    scene = Scene(config.block, config.arm.tool_radius, config.range_sensor)
    renderer = RangeRenderer(scene, width=WIDTH, height=HEIGHT, depth_noise=NOISE, seed=1)
    for dent in (0.0, *LEVELS.tolist()):
        xyz = renderer.render(UP, dent)
        yield lambda stamp, xyz=xyz: cloud_to_message(RangeFrame(stamp, xyz), POINTS.frame_id)


def images() -> Iterator[Callable[[int], Any]]:
    """Yield makers of stamped depth images, as `clouds` does."""
    from hapticvision_ros.nodes.conversions import stamp_from_ns
    from sensor_msgs.msg import Image

    random = np.random.default_rng(1)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    aside = np.abs(columns - WIDTH / 2) * (ABOVE - BLOCK) / FOCAL
    along = np.abs(rows - HEIGHT / 2) * (ABOVE - BLOCK) / FOCAL
    for dent in (0.0, *LEVELS.tolist()):
        surface = np.where((aside < 0.05) & (along < 0.05), BLOCK, 0.0)
        surface[np.hypot(aside, along) < 0.012] -= dent
        depth = ABOVE - surface + random.normal(0.0, NOISE, surface.shape)
        data = depth.astype(np.float32).tobytes()

        def make(stamp: int, data: bytes = data) -> Any:
            message = Image(height=HEIGHT, width=WIDTH, encoding='32FC1', step=4 * WIDTH)
            message.header.stamp = stamp_from_ns(stamp)
            message.header.frame_id = FRAME
            message.data = data
            return message

        yield make


def camera(backend: str, rate: float, seconds: float, path: str) -> None:
    """Publish frames and tool heights until the time is over; write down the frames' stamps."""
    from hapticvision_ros.nodes.conversions import point_to_message, scalar_to_message
    from hapticvision_ros.nodes.qos import create_publisher
    import rclpy
    from sensor_msgs.msg import CameraInfo, Image, PointCloud2

    rclpy.init()
    me = rclpy.create_node('bench_camera')
    makers = list(clouds() if backend == 'points' else images())
    if backend == 'points':
        publisher = me.create_publisher(PointCloud2, CLOUDS, 5)
    else:
        publisher = me.create_publisher(Image, DEPTH, 5)
    info = me.create_publisher(CameraInfo, INFO, 5)
    tool = create_publisher(me, TOOL_HEIGHT)
    contact = create_publisher(me, CONTACT_POINT)
    calibration = CameraInfo(height=HEIGHT, width=WIDTH, distortion_model='plumb_bob')
    middle = [(WIDTH - 1) / 2, (HEIGHT - 1) / 2]
    calibration.d = [0.0] * 5
    calibration.k = [FOCAL, 0.0, middle[0], 0.0, FOCAL, middle[1], 0.0, 0.0, 1.0]
    calibration.p = [FOCAL, 0.0, middle[0], 0.0, 0.0, FOCAL, middle[1], 0.0, 0.0, 0.0, 1.0, 0.0]
    while not (publisher.get_subscription_count() and tool.get_subscription_count()):
        time.sleep(0.05)
    contact.publish(point_to_message((0.0, 0.0, BLOCK), time.time_ns(), CONTACT_POINT.frame_id))
    stamps = list[int]()
    start, sent = time.monotonic(), 0
    while len(stamps) < BEFORE + int(rate * seconds):
        now = time.monotonic() - start
        if sent <= now * TOOL_RATE:
            sent += 1
            tool.publish(scalar_to_message(UP))
        if len(stamps) <= now * rate:
            turn = len(stamps) - BEFORE
            stamp = time.time_ns()
            if backend == 'depth':
                calibration.header.stamp.sec, calibration.header.stamp.nanosec = divmod(
                    stamp, 10**9
                )
                calibration.header.frame_id = FRAME
                info.publish(calibration)
            publisher.publish(makers[0 if turn < 0 else 1 + turn % LEVELS.size](stamp))
            stamps.append(stamp)
        wake = min(sent / TOOL_RATE, len(stamps) / rate)
        time.sleep(max(0.0, start + wake - time.monotonic()))
    time.sleep(1.0)
    np.save(path, np.array(stamps))
    rclpy.shutdown()


def cpu_time(process: int) -> float:
    """Return what a process has used so far [s]."""
    fields = Path(f'/proc/{process}/stat').read_text().rsplit(')', 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf('SC_CLK_TCK')


def delays(stamps: FloatArray, heights: FloatArray, times: FloatArray) -> FloatArray:
    """Return the time from each counted frame's stamp to its height [ns]; NaN where none came."""
    late = np.full(stamps.size - BEFORE, np.nan)
    for height, time_ns in zip(heights, times, strict=True):
        known = np.searchsorted(stamps, time_ns) - 1 - BEFORE
        recent = np.arange(max(known - LEVELS.size + 1, 0), known + 1)
        if recent.size:
            one = recent[np.argmin(np.abs(LEVELS[recent % LEVELS.size] - height))]
            late[one] = time_ns - stamps[one + BEFORE]
    return late


def measure(backend: str, rate: float, seconds: float) -> str:
    """Return one line of the table."""
    from hapticvision_ros.nodes.qos import create_subscription
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    settings = {
        'backend': backend,
        'points_topic': CLOUDS,
        'depth_topic': DEPTH,
        'camera_info_topic': INFO,
        'input_frame': POINTS.frame_id if backend == 'points' else FRAME,
    }
    if backend == 'depth':
        settings['sensor_pose'] = f'[0.0, 0.0, {ABOVE}, 3.141592653589793, 0.0, 0.0]'
    options = [part for k, v in settings.items() for part in ('-p', f'{k}:={v}')]
    command = [*node('range_sensor_driver'), '--ros-args', *options]
    heard, seen = list[tuple[float, int]](), [0]

    def count(_: bytes) -> None:
        seen[0] += 1

    me = rclpy.create_node('bench_listener')
    executor = SingleThreadedExecutor()
    executor.add_node(me)
    create_subscription(
        me, DISPLACEMENT_HEIGHT, lambda message: heard.append((message.data, time.time_ns()))
    )
    create_subscription(me, POINTS, count, raw=True)
    with tempfile.TemporaryDirectory() as folder:
        path = f'{folder}/stamps.npy'
        role = ['--role', backend, '--rate', str(rate), '--seconds', str(seconds), '--out', path]
        driver = subprocess.Popen(command)
        publisher = subprocess.Popen([sys.executable, __file__, *role])
        try:
            end = time.monotonic() + START_DEADLINE
            while not heard:
                executor.spin_once(timeout_sec=0.05)
                if time.monotonic() > end:
                    raise SystemExit(f'{backend}: no height within {START_DEADLINE:g} s')
            used, begun = cpu_time(driver.pid), time.monotonic()
            while publisher.poll() is None:
                executor.spin_once(timeout_sec=0.05)
            used, took = cpu_time(driver.pid) - used, time.monotonic() - begun
        finally:
            for process in (publisher, driver):
                process.terminate()
                process.wait(20.0)
        stamps = np.load(path)
    executor.shutdown()
    me.destroy_node()
    heights, times = np.array(heard).T
    late = delays(stamps, heights, times) * 1e-6
    lost = int(np.isnan(late).sum())
    p50, p99 = np.nanpercentile(late, (50, 99))
    sent = late.size
    interval = float(np.diff(stamps[BEFORE:]).mean()) * 1e-9
    return (
        f'| {backend} | {1.0 / interval:.1f} | {sent} | {lost} | {p50:.1f} | {p99:.1f} | '
        f'{np.nanmax(late):.1f} | {1e3 * used / (took / interval):.1f} | {seen[0]} |'
    )


def main() -> int:
    """Run the bench, or its camera."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=float, default=20.0)
    parser.add_argument('--rate', type=float, default=30.0)
    parser.add_argument('--role', choices=('points', 'depth'), help=argparse.SUPPRESS)
    parser.add_argument('--out', help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.role:
        camera(arguments.role, arguments.rate, arguments.seconds, arguments.out)
        return 0
    os.environ.update(ros_environment())
    import rclpy

    rclpy.init()
    print(
        f'load average of this machine before: {os.getloadavg()[0]:.2f} of {os.cpu_count()} cores'
    )
    print(
        '| frames | Hz | sent | heights lost | delay p50 ms | p99 ms | max ms | '
        'CPU of the driver, ms a frame | clouds passed on |'
    )
    print('| --- | --- | --- | --- | --- | --- | --- | --- | --- |')
    for backend in ('points', 'depth'):
        print(measure(backend, arguments.rate, arguments.seconds), flush=True)
    rclpy.shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
