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
The simulated world as a process of its own, which serves its devices on loopback only.

The world's clock is the machine's: it is paced by the monotonic clock, and a stamp is the wall
time of the instant that was simulated, also when the process was late to simulate it.
"""

import argparse
from collections.abc import Callable, Sequence
import ctypes
from dataclasses import asdict, replace
from math import isfinite
from pathlib import Path
import signal
import socket
import sys
import time
from types import FrameType

from hapticvision_ros.core.clock_watch import ClockWatch
from hapticvision_ros.core.errors import DeviceError, HapticVisionError, InputError, UsageError
from hapticvision_ros.sim.config import load_config, WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.protocol import (
    ARM,
    ARM_PACKET,
    decode,
    encode,
    FORCE,
    FORCE_PACKET,
    LEASE,
    LOOPBACK,
    MAX_DATAGRAM,
    Message,
    POINT,
    SHAPE,
    SHAPE_PACKET,
    STREAMS,
)
from hapticvision_ros.sim.world import Readings, World
import numpy as np

TICK = 0.001
"""The world advances, listens and sends once in this time [s]."""
_STOPPING = (signal.SIGINT, signal.SIGTERM)

type Address = tuple[str, int]


class WorldServer:
    """
    Serves one world to its devices.

    Parameters
    ----------
    world : World
        The cell to simulate.
    config : WorldConfig
        Its description, from which a range sensor learns the geometry.
    port : int
        UDP port on loopback; 0 for a free one.

    Attributes
    ----------
    material : Material or None
        What the next sample is made of; None for what the one before was.

    Raises
    ------
    DeviceError
        If the port is taken.
    InputError
        If the object has more nodes than a datagram carries.

    """

    def __init__(self, world: World, config: WorldConfig, port: int) -> None:
        self._world = world
        self.material: Material | None = None
        self._scene = {
            'block': asdict(config.block),
            'tool_radius': config.arm.tool_radius,
            'sensor': asdict(config.range_sensor),
            'soft_body': None if config.soft_body is None else asdict(config.soft_body),
        }
        if world.soft is not None:
            most = (MAX_DATAGRAM - SHAPE_PACKET.size) // (3 * np.dtype(POINT).itemsize)
            if len(world.soft.rest) > most:
                raise InputError(
                    f'the soft body has {len(world.soft.rest)} nodes, more than the {most} that a '
                    'running cell can show: choose a larger pitch'
                )
        self._subscribers: dict[str, dict[Address, float]] = {name: {} for name in STREAMS}
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((LOOPBACK, port))
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DeviceError(
                f'UDP port {port} on {LOOPBACK} cannot be had ({error}): stop the process that '
                'uses it, or choose another with --port'
            ) from error

    @property
    def port(self) -> int:
        """Return the UDP port that is served."""
        port: int = self._socket.getsockname()[1]
        return port

    def serve(self, stopped: Callable[[], bool]) -> None:
        """Run the world in real time until `stopped` says so."""
        start = time.monotonic() - self._world.time
        start_ns = time.time_ns() - round(self._world.time * 1e9)
        clock = ClockWatch(time.time_ns, time.monotonic_ns)
        next_tick = time.monotonic()
        while not stopped():
            next_tick += TICK
            pause = next_tick - time.monotonic()
            if pause > 0.0:
                time.sleep(pause)
            now = time.monotonic() - start
            self._listen(now)
            # Devices stamp by the machine's clock, also when it was set.
            start_ns += round(clock.step() * 1e9)
            self._stream(self._world.advance(now), start_ns)

    def close(self) -> None:
        """Stop serving."""
        self._socket.close()

    def _listen(self, now: float) -> None:
        """Handle the datagrams that have come until `now`, in virtual time [s]."""
        while True:
            try:
                datagram, sender = self._socket.recvfrom(MAX_DATAGRAM)
            except BlockingIOError:
                return
            except ConnectionError:
                # An earlier datagram met a device that has gone: its lease will run out.
                continue
            message = decode(datagram)
            if message is not None:
                answer = self._handle(message, sender, now)
                if answer is not None:
                    self._send(encode(answer), sender)

    def _handle(self, message: Message, sender: Address, now: float) -> Message | None:
        """Do what a device asks, and return the answer if it expects one."""
        match message:
            case {'request': 'push', 'velocity': float() | int() as velocity}:
                if isfinite(velocity):
                    self._world.set_push_velocity(float(velocity), now)
                return None
            case {'request': 'renew', 'stream': str() as stream} if stream in STREAMS:
                self._subscribers[stream][sender] = time.monotonic() + LEASE
                return None
            case {'request': 'open', 'stream': str() as stream} if stream in STREAMS:
                self._subscribers[stream][sender] = time.monotonic() + LEASE
                return {'answer': 'open', 'scene': self._scene}
            case {'request': 'close'}:
                for subscribers in self._subscribers.values():
                    subscribers.pop(sender, None)
                return None
            case {'request': 'place_new_sample'}:
                try:
                    self._world.place_new_sample(self.material)
                except HapticVisionError as error:
                    return {'answer': 'place_new_sample', 'error': str(error)}
                return {'answer': 'place_new_sample'}
        return {'answer': 'error', 'error': 'the simulated world does not know this request'}

    def _stream(self, readings: Readings, start_ns: int) -> None:
        """Send what was measured to the devices that listen."""
        for force in readings.force:
            stamp = start_ns + round(force.t * 1e9)
            self._publish(FORCE, FORCE_PACKET.pack(stamp, *force[1:]))
        for arm in readings.arm:
            stamp = start_ns + round(arm.t * 1e9)
            self._publish(ARM, ARM_PACKET.pack(stamp, arm.tool_height))
        for shape in readings.shape:
            stamp = start_ns + round(shape.t * 1e9)
            packet = SHAPE_PACKET.pack(stamp, shape.tool_height, shape.displacement)
            if shape.points is not None:
                packet += shape.points.astype(POINT).tobytes()
            self._publish(SHAPE, packet)

    def _publish(self, stream: str, datagram: bytes) -> None:
        """Send a datagram to each device of a stream whose lease runs."""
        subscribers = self._subscribers[stream]
        if not subscribers:
            return
        now = time.monotonic()
        for address, expires in list(subscribers.items()):
            if expires < now:
                del subscribers[address]
            else:
                self._send(datagram, address)

    def _send(self, datagram: bytes, address: Address) -> None:
        """Send one datagram; a device that has gone or is slow loses it, as on a real bus."""
        try:
            self._socket.sendto(datagram, address)
        except (BlockingIOError, ConnectionError):
            return


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='simulated_world',
        description='Simulate a cell (object, arm, load cell, range sensor) in real time and '
        'serve its devices on loopback. Prints "ready PORT" when it serves.',
    )
    parser.add_argument('--object', default='soft_dough', help='name of the object in the config')
    parser.add_argument('--port', type=int, default=0, help='UDP port; 0 (default) for a free one')
    parser.add_argument('--seed', type=int, default=0, help='seed of the noise')
    parser.add_argument('--config', type=Path, help='YAML description of the cell')
    parser.add_argument('--force-rate', type=float, metavar='HZ', help='rate of the load cell')
    parser.add_argument('--arm-rate', type=float, metavar='HZ', help="rate of the arm's readings")
    parser.add_argument('--range-rate', type=float, metavar='HZ', help='rate of the range sensor')
    return parser


def _with_rates(config: WorldConfig, arguments: argparse.Namespace) -> WorldConfig:
    """Return the configuration with the rates of the command line."""
    for name in ('force_rate', 'arm_rate', 'range_rate'):
        rate = getattr(arguments, name)
        if rate is not None and not 1.0 <= rate <= 1000.0:
            option = name.replace('_', '-')
            raise UsageError(f'--{option} is {rate:g} Hz, but must lie in 1 to 1000')
    if arguments.force_rate is not None:
        config = replace(config, load_cell=replace(config.load_cell, rate=arguments.force_rate))
    if arguments.arm_rate is not None:
        config = replace(config, arm=replace(config.arm, state_rate=arguments.arm_rate))
    if arguments.range_rate is not None:
        config = replace(
            config, range_sensor=replace(config.range_sensor, rate=arguments.range_rate)
        )
    return config


def main(argv: Sequence[str] | None = None) -> int:
    """Run the ``simulated_world`` command and return its exit code."""
    return run_world(WorldServer, argv)


def run_world(kind: type[WorldServer], argv: Sequence[str] | None = None) -> int:
    """
    Serve a world until a signal comes.

    Parameters
    ----------
    kind : type of WorldServer
        What serves it.
    argv : sequence of str, optional
        The arguments of ``simulated_world``; those of the process if not given.

    Returns
    -------
    int
        The exit code.

    """
    arguments = _parser().parse_args(argv)
    stop = False

    def request_stop(_number: int, _frame: FrameType | None) -> None:
        nonlocal stop
        stop = True

    for number in _STOPPING:
        signal.signal(number, request_stop)
    try:
        config = _with_rates(load_config(arguments.config), arguments)
        world = World(config, config.material(arguments.object), seed=arguments.seed)
        server = kind(world, config, arguments.port)
    except HapticVisionError as error:
        print(f'simulated_world: {error}', file=sys.stderr)
        return error.exit_code
    print(f'ready {server.port}', flush=True)
    try:
        server.serve(lambda: stop)
    finally:
        server.close()
        _stop_listening()
    return 0


def _stop_listening() -> None:
    """
    Ignore the signals that end the process, as it ends.

    Ctrl-C under `ros2 launch` comes twice: the second is not to kill it in its last moments, when
    Python has given up its handlers. Python's own call alone says that it ignored one which comes
    in the midst of that call; after the one of the C library none comes.
    """
    ignore = ctypes.CDLL(None).signal
    ignore.argtypes, ignore.restype = (ctypes.c_int, ctypes.c_void_p), ctypes.c_void_p
    for number in _STOPPING:
        ignore(number, signal.SIG_IGN)
        signal.signal(number, signal.SIG_IGN)
