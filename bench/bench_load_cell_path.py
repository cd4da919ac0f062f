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
Live load-cell path: loss and delay from publish to where the push controller takes a sample.

A publisher process sends 1,000 wrenches a second, paced by absolute time, each stamped as it is
published. A subscriber process is built as the push controller is: a `CellNode` under `run`, with
an `Intake` that a thread of its own waits for. Beside it, the same without the package (plain
rclpy, a reliable subscription with a callback and ``rclpy.spin``) gives the ratio. Both hear the
same messages in the same run.

    python bench/bench_load_cell_path.py [--seconds 10] [--rate 1000]
"""

import argparse
from contextlib import suppress
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
    """Publish stamped wrenches until the time is over."""
    from hapticvision_ros.bag.contract import WRENCH
    from hapticvision_ros.core.devices import WrenchSample
    from hapticvision_ros.nodes.conversions import wrench_to_message
    from hapticvision_ros.nodes.qos import create_publisher
    import rclpy

    rclpy.init()
    node = rclpy.create_node('bench_publisher')
    publisher = create_publisher(node, WRENCH)
    while publisher.get_subscription_count() < 2:
        time.sleep(0.05)
    # Newly matched subscribers miss what is sent before they know it.
    time.sleep(1.0)
    due = time.monotonic()
    late = []
    for k in range(int(rate * seconds)):
        due += 1.0 / rate
        time.sleep(max(0.0, due - time.monotonic()))
        late.append(time.monotonic() - due)
        sample = WrenchSample(time.time_ns(), (float(k), 0.0, 0.0), (0.0, 0.0, 0.0))
        publisher.publish(wrench_to_message(sample, WRENCH.frame_id))
    time.sleep(1.0)
    rclpy.shutdown()
    p50, p99 = np.percentile(np.array(late) * 1e3, (50, 99))
    print(f'   machine: a process wakes p50 {p50:.3f} ms, p99 {p99:.3f} ms after its time')


def report(received: list[tuple[int, float, int]], path: str) -> None:
    """Write (number, delay) of each message."""
    np.save(path, np.array([(k, now - stamp) for now, k, stamp in received]))


def subscribe_as_controller(path: str) -> int:
    """Receive as the push controller does."""
    from hapticvision_ros.bag.contract import WRENCH
    from hapticvision_ros.nodes import load_cell_driver
    from hapticvision_ros.nodes.conversions import ns_from_stamp
    from hapticvision_ros.nodes.intake import Intake
    from hapticvision_ros.nodes.runtime import CellNode, run

    class Receiver(CellNode):
        def __init__(self) -> None:
            super().__init__(load_cell_driver.NAME, load_cell_driver.PARAMETERS)
            self._received: list[tuple[int, float, int]] = []
            self._wrenches = Intake.of(self, WRENCH)
            self.spawn(self._listen, 'load cell reader')

        def _listen(self) -> None:
            while not self.stopping.is_set():
                if not self._wrenches.wait(0.1):
                    continue
                for message, _, _ in self._wrenches.take():
                    stamp = ns_from_stamp(message.header.stamp)
                    self._received.append((time.time_ns(), message.wrench.force.x, stamp))

        def close(self) -> None:
            super().close()
            report(self._received, path)

    return run(Receiver)


def subscribe_plainly(path: str) -> int:
    """Receive with nothing but rclpy."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node('bench_plain')
    received: list[tuple[int, float, int]] = []

    def on_wrench(message: object) -> None:
        stamp = message.header.stamp
        received.append(
            (time.time_ns(), message.wrench.force.x, stamp.sec * 10**9 + stamp.nanosec)
        )

    node.create_subscription(WrenchStamped, 'load_cell/wrench', on_wrench, 1000)
    with suppress(KeyboardInterrupt, ExternalShutdownException):
        rclpy.spin(node)
    report(received, path)
    return 0


def main() -> int:
    """Run the bench, or one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=float, default=10.0)
    parser.add_argument('--rate', type=float, default=1000.0)
    parser.add_argument('--role', choices=('publisher', 'controller', 'plain'))
    parser.add_argument('--out')
    arguments = parser.parse_args()
    match arguments.role:
        case 'publisher':
            publish(arguments.rate, arguments.seconds)
            return 0
        case 'controller':
            sys.argv = sys.argv[:1]
            return subscribe_as_controller(arguments.out)
        case 'plain':
            return subscribe_plainly(arguments.out)

    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(PROFILE),
    }
    print(
        f'load average of this machine before: {os.getloadavg()[0]:.2f} of {os.cpu_count()} cores'
    )
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__]
        subscribers = {
            role: subprocess.Popen(
                [*command, '--role', role, '--out', f'{folder}/{role}.npy'], env=environment
            )
            for role in ('controller', 'plain')
        }
        cpu: dict[str, float] = {}
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
            for role, process in subscribers.items():
                process.send_signal(signal.SIGINT)
                usage = os.wait4(process.pid, 0)[2]
                cpu[role] = usage.ru_utime + usage.ru_stime
        sent = int(arguments.rate * arguments.seconds)
        medians = {}
        for role in subscribers:
            numbers, delays = np.load(f'{folder}/{role}.npy').T
            p50, p99 = np.percentile(delays * 1e-6, (50, 99))
            medians[role] = p50
            print(
                f'{role:>10}: {sent} sent, {sent - np.unique(numbers).size} lost, '
                f'p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {delays.max() * 1e-6:.3f} ms, '
                f'{cpu[role]:.2f} s of CPU time from start to end'
            )
        print(
            f'controller / plain: p50 {medians["controller"] / medians["plain"]:.2f}, '
            f'CPU {cpu["controller"] / cpu["plain"]:.2f}'
        )
    return 0


if __name__ == '__main__':
    sys.exit(main())
