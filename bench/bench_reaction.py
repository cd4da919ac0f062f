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
Reaction of the push controller to a force above its limit, from the load cell to the arm.

This process plays the devices of a cell over the simulated world's protocol: a load cell at 1 kHz
and an arm at 500 Hz. The load cell driver and the push controller run as a user starts them. In
each round the tool goes down in the air; at a time of chance the force jumps above the limit. The
reaction is the time from the datagram with the first such force to the first command that does not
go down: driver, middleware, control law and back, all of it. The kernel tells when the command
came, so that it does not matter how late this process looks at it.

A process of its own wakes every millisecond meanwhile and takes note of how late it was: no loop
of this machine can be better than that.

    python bench/bench_reaction.py [--rounds 300] [--control-rate 250] [--realtime]

``--realtime`` runs all processes under SCHED_FIFO, for which it needs the right.
"""

import argparse
from contextlib import suppress
import os
from pathlib import Path
import random
import select
import signal
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time

from hapticvision_ros.bag.contract import ENABLE, PUSH
from hapticvision_ros.nodes.qos import create_client
from hapticvision_ros.sim.protocol import ARM_PACKET, decode, encode, FORCE_PACKET, MAX_DATAGRAM
import numpy as np
import rclpy
from std_srvs.srv import SetBool, Trigger

PROFILE = Path(__file__).resolve().parents[1] / 'config' / 'fastdds_profile.xml'
RATE = 1000.0
ARM_EVERY = 2
LIMIT = 20.0
SPEED = 0.002
START = 0.10
PRIORITY = 10
DEADLINE = 30.0
TARGET_MS = 5.0
SO_TIMESTAMPNS = 35
"""Of Linux, as the type of what then comes with a datagram; Python has no name for it."""
TIMESPEC = struct.Struct('qq')

JITTER = """
import sys, time
late, due = [], time.monotonic()
while not late or time.monotonic() < float(sys.argv[1]):
    due += 0.001
    time.sleep(max(0.0, due - time.monotonic()))
    late.append(time.monotonic() - due)
late.sort()
print(*(1e3 * late[int(q * (len(late) - 1))] for q in (0.5, 0.99, 0.999, 1.0)))
"""


class Devices:
    """A load cell and an arm, on loopback."""

    def __init__(self) -> None:
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(('127.0.0.1', 0))
        self.socket.setblocking(False)
        self.socket.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
        self.port = self.socket.getsockname()[1]
        self.random = random.Random(1)
        self.listeners: dict[str, tuple[str, int]] = {}
        self.height = START
        self.velocity = 0.0
        self.jump_after: float | None = None
        self.jumped_ns: int | None = None
        self.reactions: list[float] = []
        self.late: list[float] = []
        self.stopping = threading.Event()

    def run(self) -> None:
        """Send and receive until told to stop."""
        due = time.monotonic()
        tick = 0
        while not self.stopping.is_set():
            due += 1.0 / RATE
            self.receive_until(due)
            now = time.monotonic()
            self.late.append(now - due)
            tick += 1
            self.height -= self.velocity / RATE
            if self.jump_after is not None and now >= self.jump_after:
                self.jump_after, self.jumped_ns = None, time.time_ns()
            self.send_readings(tick)

    def send_readings(self, tick: int) -> None:
        """Send what the devices measure in this tick."""
        force = self.random.gauss(0.0, 0.02)
        if self.jumped_ns is not None:
            force += 2.0 * LIMIT
        stamp = time.time_ns()
        if 'force' in self.listeners:
            packet = FORCE_PACKET.pack(stamp, 0.0, 0.0, -force, 0.0, 0.0, 0.0)
            if self.jumped_ns is not None and self.reactions[-1:] != [None]:
                self.reactions.append(None)
                self.jumped_ns = time.time_ns()
            self.send(packet, self.listeners['force'])
        if 'arm' in self.listeners and tick % ARM_EVERY == 0:
            height = self.height + self.random.gauss(0.0, 1e-6)
            self.send(ARM_PACKET.pack(stamp, height), self.listeners['arm'])

    def send(self, data: bytes, address: tuple[str, int]) -> None:
        """Send a datagram, whether or not somebody still listens."""
        with suppress(OSError):
            self.socket.sendto(data, address)

    def receive_until(self, due: float) -> None:
        """Answer what comes until `due`."""
        while (left := due - time.monotonic()) > 0.0:
            if not select.select([self.socket], [], [], left)[0]:
                return
            try:
                data, told, _, sender = self.socket.recvmsg(MAX_DATAGRAM, 64)
            except OSError:
                continue
            message = decode(data) or {}
            match message:
                case {'request': 'push', 'velocity': float() as velocity}:
                    came_ns = arrival_ns(told)
                    # What came before the force is no answer to it.
                    jumped_ns = self.jumped_ns
                    if velocity <= 0.0 and jumped_ns is not None and came_ns > jumped_ns:
                        self.reactions[-1] = 1e-9 * (came_ns - jumped_ns)
                        self.jumped_ns = None
                    self.velocity = velocity
                case {'request': 'open', 'stream': str() as stream}:
                    self.listeners[stream] = sender
                    self.send(encode({'answer': 'open', 'scene': {}}), sender)


def arrival_ns(told: list[tuple[int, int, bytes]]) -> int:
    """Return when a datagram came, by what the kernel has told with it [ns]."""
    seconds, nanoseconds = TIMESPEC.unpack(told[0][2])
    return int(seconds * 10**9 + nanoseconds)


def realtime(pid: int) -> None:
    """Let a process run before all others, with the threads that it has."""
    for thread in Path(f'/proc/{pid}/task').iterdir():
        os.sched_setscheduler(int(thread.name), os.SCHED_FIFO, os.sched_param(PRIORITY))


def call(node: object, client: object, request: object) -> object:
    """Return the answer of a service."""
    end = time.monotonic() + DEADLINE
    while not client.wait_for_service(timeout_sec=0.5):
        assert time.monotonic() < end, 'the service is not there'
    future = client.call_async(request)
    rclpy.spin_until_future_complete(node, future, timeout_sec=DEADLINE)
    return future.result()


def measure(devices: Devices, rounds: int) -> None:
    """Start pushes and let the force jump in each."""
    node = rclpy.create_node('bench_reaction')
    enable, push = create_client(node, ENABLE), create_client(node, PUSH)
    assert call(node, enable, SetBool.Request(data=True)).success
    end = time.monotonic() + DEADLINE
    failed = 0
    while len(devices.reactions) < rounds:
        answer = call(node, push, Trigger.Request())
        if not answer.success:
            assert time.monotonic() < end, answer.message
            time.sleep(0.01)
            continue
        end = time.monotonic() + DEADLINE
        count = len(devices.reactions)
        begins = time.monotonic() + 1.0
        while devices.velocity <= 0.0 and time.monotonic() < begins:
            time.sleep(0.001)
        if devices.velocity <= 0.0:
            # A machine that is held up ends a push before it begins: its readings are too old.
            failed += 1
            assert failed < rounds, 'the tool does not go down'
            continue
        devices.jump_after = time.monotonic() + random.uniform(0.01, 0.03)
        while len(devices.reactions) == count or devices.reactions[-1] is None:
            assert time.monotonic() < end, 'no reaction'
            time.sleep(0.001)
    node.destroy_node()


def main() -> None:
    """Run the bench."""
    parser = argparse.ArgumentParser()
    parser.add_argument('--rounds', type=int, default=300)
    parser.add_argument('--control-rate', type=float, default=250.0)
    parser.add_argument('--realtime', action='store_true')
    args = parser.parse_args()
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'] = str(PROFILE)
    os.environ.setdefault('ROS_DOMAIN_ID', '87')
    rclpy.init()
    devices = Devices()
    thread = threading.Thread(target=devices.run)
    thread.start()
    parameters = {
        'load_cell_driver': {},
        'arm_push_controller': {
            'control_rate': args.control_rate,
            'max_force': LIMIT,
            'push_speed': SPEED,
            'zero_time': 0.02,
            'clearance': 0.0,
            'heartbeat_time': 0.0,
            'hold_time': 1.0,
            'recover_time': 1.0,
        },
    }
    processes = []
    with tempfile.TemporaryFile() as log:
        for name, values in parameters.items():
            command = [str(Path(sys.executable).with_name(name)), '--ros-args']
            for key, value in {'simulated_world_port': devices.port, **values}.items():
                command += ['-p', f'{key}:={value}']
            processes.append(subprocess.Popen(command, stdout=log, stderr=log))
        time.sleep(5.0)
        began = time.monotonic()
        until = began + 0.08 * args.rounds
        jitter = subprocess.Popen(
            [sys.executable, '-c', JITTER, str(until)], stdout=subprocess.PIPE, text=True
        )
        if args.realtime:
            for process in (*processes, jitter):
                realtime(process.pid)
            realtime(os.getpid())
        try:
            devices.late.clear()
            measure(devices, args.rounds)
        finally:
            devices.stopping.set()
            thread.join()
            for process in processes:
                process.send_signal(signal.SIGINT)
                process.wait()
            rclpy.shutdown()
    reactions = 1e3 * np.array(devices.reactions[: args.rounds], dtype=float)
    print(f'load average {os.getloadavg()[0]:.1f}, {time.monotonic() - began:.0f} s')
    names = ('p50', 'p99', 'p99.9', 'max')
    p50, p99, p999 = np.percentile(reactions, (50, 99, 99.9))
    told = ' '.join(
        f'{name} {value:.2f}'
        for name, value in zip(names, (p50, p99, p999, reactions.max()), strict=True)
    )
    print(f'reaction of {len(reactions)} rounds at {args.control_rate:g} Hz [ms]: {told}')
    late = 1e3 * np.array(devices.late)
    print(f'sender late [ms]: p50 {np.median(late):.2f} p99 {np.percentile(late, 99):.2f}')
    values = jitter.communicate()[0].split()
    told = ' '.join(f'{name} {float(v):.2f}' for name, v in zip(names, values, strict=True))
    print(f'a loop that only sleeps is late by [ms]: {told}')
    print(f'p99 {"within" if p99 <= TARGET_MS else "beyond"} {TARGET_MS:g} ms')


if __name__ == '__main__':
    main()
