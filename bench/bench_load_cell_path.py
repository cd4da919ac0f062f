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

A process sends 1,000 messages a second, paced by absolute time, each stamped right before it is
sent. Three others wait for them, and each in turn gets all messages of a second, so that they do
not take the processors from each other while all of them see the same machine:

- controller: built as the push controller is, a `CellNode` under `run` with an `Intake` that a
  thread of its own waits for;
- plain: the same without the package, an rclpy subscription with a callback and ``rclpy.spin``;
- datagram: no ROS, a bare UDP socket on loopback. What it measures is the machine: the time from
  the sender's call to a process that waits for nothing else.

    python bench/bench_load_cell_path.py [--seconds 10] [--rate 1000] [--realtime]

``--realtime`` runs all four processes under SCHED_FIFO, for which it needs the right: other work
on the machine then takes no processor from them, as on an idle machine.
"""

import argparse
from collections.abc import Callable
from contextlib import suppress
import os
from pathlib import Path
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import time

import numpy as np

PROFILE = Path(__file__).resolve().parents[1] / 'config' / 'fastdds_profile.xml'
ROLES = ('controller', 'plain', 'datagram')
PACKET = struct.Struct('<qd')
PRIORITY = 10
LIMIT_MS = 1.0


def publish(rate: float, seconds: int, port: int, path: str) -> None:
    """Send stamped messages to each listener in turn until each has had its time."""
    from hapticvision_ros.bag.contract import WRENCH
    from hapticvision_ros.core.devices import WrenchSample
    from hapticvision_ros.nodes.conversions import wrench_to_message
    from hapticvision_ros.nodes.qos import create_publisher
    import rclpy

    rclpy.init()
    publishers = [
        create_publisher(rclpy.create_node('bench_publisher', namespace=role), WRENCH)
        for role in ROLES[:2]
    ]
    while not all(publisher.get_subscription_count() for publisher in publishers):
        time.sleep(0.05)
    # Newly matched subscribers miss what is sent before they know it.
    time.sleep(1.0)
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.connect(('127.0.0.1', port))

    def send_wrench(publisher: object) -> Callable[[int], None]:
        def send(number: int) -> None:
            sample = WrenchSample(time.time_ns(), (float(number), 0.0, 0.0), (0.0, 0.0, 0.0))
            publisher.publish(wrench_to_message(sample, WRENCH.frame_id))

        return send

    def send_datagram(number: int) -> None:
        link.send(PACKET.pack(time.time_ns(), number))

    ways = [*map(send_wrench, publishers), send_datagram]
    late = []
    due = time.monotonic()
    for second in range(seconds):
        for send in ways:
            for number in range(round(rate * second), round(rate * (second + 1))):
                due += 1.0 / rate
                time.sleep(max(0.0, due - time.monotonic()))
                late.append(time.monotonic() - due)
                send(number)
    np.save(path, late)
    time.sleep(1.0)
    rclpy.shutdown()


def report(received: list[tuple[int, float, int]], path: str) -> None:
    """Write (number, delay) of each message."""
    np.save(path, np.array([(k, now - stamp) for now, k, stamp in received]))


def receive_as_controller(path: str) -> int:
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

    return run(Receiver, ['--ros-args', '-r', f'__ns:=/{ROLES[0]}'])


def receive_plainly(path: str) -> int:
    """Receive with nothing but rclpy."""
    from geometry_msgs.msg import WrenchStamped
    import rclpy
    from rclpy.executors import ExternalShutdownException

    rclpy.init()
    node = rclpy.create_node('bench_plain', namespace=ROLES[1])
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


def receive_datagrams(path: str) -> int:
    """Receive without ROS; tell the port on standard output."""
    received: list[tuple[int, float, int]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link, suppress(KeyboardInterrupt):
        link.bind(('127.0.0.1', 0))
        print(link.getsockname()[1], flush=True)
        while True:
            stamp, number = PACKET.unpack(link.recv(PACKET.size))
            received.append((time.time_ns(), number, stamp))
    report(received, path)
    return 0


def percentiles(values: np.ndarray) -> str:
    """Return median, 99th percentile and maximum of times [ms]."""
    p50, p99 = np.percentile(values, (50, 99))
    return f'p50 {p50:.3f} ms, p99 {p99:.3f} ms, max {values.max():.2f} ms'


def measure(rate: float, seconds: int, realtime: bool) -> None:
    """Run the processes and print what they have measured."""
    environment = {
        **os.environ,
        'ROS_AUTOMATIC_DISCOVERY_RANGE': 'LOCALHOST',
        'FASTRTPS_DEFAULT_PROFILES_FILE': str(PROFILE),
    }
    print(f'load average before: {os.getloadavg()[0]:.2f} on {os.cpu_count()} processors')
    if realtime:
        # Inherited by all that is started from here.
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, __file__, '--rate', str(rate), '--seconds', str(seconds)]
        receivers = {
            role: subprocess.Popen(
                [*command, '--role', role, '--out', f'{folder}/{role}.npy'],
                env=environment,
                stdout=subprocess.PIPE if role == 'datagram' else None,
                text=True,
            )
            for role in ROLES
        }
        cpu: dict[str, float] = {}
        try:
            stdout = receivers['datagram'].stdout
            assert stdout is not None
            port = stdout.readline().strip()
            subprocess.run(
                [*command, '--role', 'publisher', '--out', f'{folder}/late.npy', '--port', port],
                env=environment,
                check=True,
                timeout=len(ROLES) * seconds + 60.0,
            )
        finally:
            for role, process in receivers.items():
                process.send_signal(signal.SIGINT)
                usage = os.wait4(process.pid, 0)[2]
                cpu[role] = usage.ru_utime + usage.ru_stime
        print(f'   wake-up: {percentiles(np.load(f"{folder}/late.npy") * 1e3)} after its time')
        sent = round(rate * seconds)
        p50, p99 = {}, {}
        for role in ROLES:
            numbers, delays = np.load(f'{folder}/{role}.npy').T
            delays = delays * 1e-6
            p50[role], p99[role] = np.percentile(delays, (50, 99))
            print(
                f'{role:>10}: {sent} sent, {sent - np.unique(numbers).size} lost, '
                f'{percentiles(delays)}, {100.0 * np.mean(delays < LIMIT_MS):.2f} % within '
                f'{LIMIT_MS:g} ms, {cpu[role]:.2f} s of CPU time'
            )
        print(
            f'controller / plain: p50 {p50["controller"] / p50["plain"]:.2f}, '
            f'p99 {p99["controller"] / p99["plain"]:.2f}, '
            f'CPU {cpu["controller"] / cpu["plain"]:.2f}; '
            f'controller - datagram: p50 {p50["controller"] - p50["datagram"]:.3f} ms, '
            f'p99 {p99["controller"] - p99["datagram"]:.3f} ms'
        )


def main() -> int:
    """Run the bench, or one of its processes."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seconds', type=int, default=10, help='for each of the three listeners')
    parser.add_argument('--rate', type=float, default=1000.0)
    parser.add_argument('--realtime', action='store_true', help='run under SCHED_FIFO')
    parser.add_argument('--role', choices=('publisher', *ROLES), help=argparse.SUPPRESS)
    parser.add_argument('--out', help=argparse.SUPPRESS)
    parser.add_argument('--port', type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    match arguments.role:
        case 'publisher':
            publish(arguments.rate, arguments.seconds, arguments.port, arguments.out)
        case 'controller':
            return receive_as_controller(arguments.out)
        case 'plain':
            return receive_plainly(arguments.out)
        case 'datagram':
            return receive_datagrams(arguments.out)
        case _:
            measure(arguments.rate, arguments.seconds, arguments.realtime)
    return 0


if __name__ == '__main__':
    sys.exit(main())
