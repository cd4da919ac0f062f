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
Live cloud path: loss and delay of 640x480 clouds at 30 Hz, with and without the shipped profile.

A publisher process sends clouds as the range sensor driver does; a subscriber process takes them
as raw bytes (as the planner does) or reads their points (``--read``). The same run is made with
Fast DDS's default transports and with ``config/fastdds_profile.xml``.

    python bench/bench_cloud_path.py [--seconds 10] [--rate 30] [--read]
"""

import argparse
import os
from pathlib import Path
import signal
import subprocess
import sys
import tempfile
import time

import numpy as np

PROFILE = Path(__file__).resolve().parents[1] / 'config' / 'fastdds_profile.xml'


def publish(rate: float, seconds: float) -> None:
    """Publish stamped clouds until the time is over."""
    from hapticvision_ros.bag.contract import POINTS
    from hapticvision_ros.core.devices import RangeFrame
    from hapticvision_ros.nodes.conversions import cloud_to_message
    from hapticvision_ros.nodes.qos import create_publisher
    import rclpy

    rclpy.init()
    node = rclpy.create_node('bench_publisher')
    publisher = create_publisher(node, POINTS)
    while publisher.get_subscription_count() < 1:
        time.sleep(0.05)
    time.sleep(1.0)
    cloud = np.random.default_rng(0).random((480, 640, 3), dtype=np.float32)
    due = time.monotonic()
    for _ in range(int(rate * seconds)):
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        publisher.publish(cloud_to_message(RangeFrame(time.time_ns(), cloud), POINTS.frame_id))
    time.sleep(1.0)
    rclpy.shutdown()


def subscribe(path: str, read: bool) -> int:
    """Receive clouds and write down when each was sent and received."""
    from hapticvision_ros.bag.contract import POINTS
    from hapticvision_ros.nodes import range_sensor_driver
    from hapticvision_ros.nodes.conversions import ns_from_stamp, xyz_from_message
    from hapticvision_ros.nodes.qos import create_subscription
    from hapticvision_ros.nodes.runtime import CellNode, run

    class Receiver(CellNode):
        def __init__(self) -> None:
            super().__init__(range_sensor_driver.NAME, range_sensor_driver.PARAMETERS)
            self._received: list[tuple[int, int]] = []
            create_subscription(self, POINTS, self._on_cloud, raw=not read)

        def _on_cloud(self, message: object) -> None:
            now = time.time_ns()
            if read:
                xyz_from_message(message)
                self._received.append((ns_from_stamp(message.header.stamp), now))
            else:
                # The stamp is the first field, behind the four bytes of the encapsulation.
                self._received.append((stamp_of(message), now))

        def close(self) -> None:
            super().close()
            np.save(path, np.array(self._received, dtype=np.int64).reshape(-1, 2))

    def stamp_of(serialised: bytes) -> int:
        seconds, nanoseconds = np.frombuffer(serialised, '<u4', 2, 4)
        return int(seconds) * 10**9 + int(nanoseconds)

    return run(Receiver)


def measure(name: str, environment: dict[str, str], arguments: argparse.Namespace) -> None:
    """Run one pair of processes and print its loss and delay."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__]
        path = f'{folder}/received.npy'
        subscriber = subprocess.Popen(
            [*command, '--role', 'subscriber', '--out', path, *(['--read'] * arguments.read)],
            env=environment,
        )
        try:
            subprocess.run(
                [
                    *command,
                    *('--role', 'publisher'),
                    *('--rate', str(arguments.rate)),
                    *('--seconds', str(arguments.seconds)),
                ],
                env=environment,
                check=True,
                timeout=arguments.seconds + 60.0,
            )
        finally:
            subscriber.send_signal(signal.SIGINT)
            subscriber.wait(20.0)
        sent = int(arguments.rate * arguments.seconds)
        stamps, received = np.load(path).T
        line = f'{name:>8}: {sent} sent, {sent - np.unique(stamps).size} lost'
        if stamps.size:
            p50, p99 = np.percentile((received - stamps) * 1e-6, (50, 99))
            line += f', p50 {p50:.1f} ms, p99 {p99:.1f} ms'
        print(line)


def main() -> int:
    """Run the bench, or one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--rate', type=float, default=30.0)
    parser.add_argument('--read', action='store_true', help='read the points of each cloud')
    parser.add_argument('--role', choices=('publisher', 'subscriber'))
    parser.add_argument('--out')
    arguments = parser.parse_args()
    match arguments.role:
        case 'publisher':
            publish(arguments.rate, arguments.seconds)
            return 0
        case 'subscriber':
            sys.argv = sys.argv[:1]
            return subscribe(arguments.out, arguments.read)
    print(
        f'load average of this machine before: {os.getloadavg()[0]:.2f} of {os.cpu_count()} cores'
    )
    base = {**os.environ, 'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST'}
    base.pop('FASTRTPS_DEFAULT_PROFILES_FILE', None)
    measure('default', base, arguments)
    measure('profile', {**base, 'FASTRTPS_DEFAULT_PROFILES_FILE': str(PROFILE)}, arguments)
    return 0


if __name__ == '__main__':
    sys.exit(main())
