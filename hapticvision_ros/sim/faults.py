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
A simulated world whose devices can be told to go wrong, and that keeps the truth of it.

It speaks the protocol of the ordinary one; a campaign of faults asks for a distortion of a stream,
for its end, and for what the tool and the object went through meanwhile.
"""

from collections import deque
from collections.abc import Iterable, Sequence
import os
from random import Random
import socket
import time
from typing import Final

from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.protocol import (
    ARM,
    ARM_PACKET,
    decode,
    encode,
    FORCE,
    FORCE_PACKET,
    LOOPBACK,
    MAX_DATAGRAM,
    Message,
    SHAPE,
    SHAPE_PACKET,
)
from hapticvision_ros.sim.server import run_world, WorldServer
from hapticvision_ros.sim.world import Readings, World

HOUR_NS: Final = 3600 * 10**9
LATE: Final = 0.6
"""Delay of a late stream [s]."""
SLOW: Final = 25
"""Of a slow stream one sample in so many is sent."""
SATURATION: Final = 2.0
"""A saturated load cell reads no more than this [N]."""
LEAST_DESCENT: Final = 1e-7
"""A tool that sinks by less in a tick stands still [m]."""

_PACKETS: Final = {FORCE: FORCE_PACKET, ARM: ARM_PACKET, SHAPE: SHAPE_PACKET}
_MEASURED: Final = {FORCE: 3, ARM: 1, SHAPE: 2}
"""Which field of a packet is the one that matters."""
_NOISE: Final = {FORCE: 0.5, ARM: 2e-4, SHAPE: 2e-3}
_SPIKE: Final = {FORCE: -1e4, ARM: 0.0, SHAPE: 1.0}

type _Fields = list[float]


class Distortion:
    """
    What happens to the datagrams of one stream.

    Parameters
    ----------
    stream : str
        Which stream.
    how : str
        The kind.
    seed : int
        Of what is left to chance.

    """

    def __init__(self, stream: str, how: str, seed: int) -> None:
        self._how = how
        self._random = Random(seed)
        self._packet = _PACKETS[stream]
        self._at = _MEASURED[stream]
        self._noise = _NOISE[stream]
        self._spike = _SPIKE[stream]
        self._count = 0
        self._waiting: deque[tuple[float, bytes]] = deque()
        self._held: _Fields | None = None

    def pass_on(self, datagram: bytes, now: float) -> Iterable[bytes]:
        """Return what is sent at `now` [s] in place of a datagram."""
        self._count += 1
        match self._how:
            case 'silent':
                return ()
            case 'slow':
                return () if self._count % SLOW else (datagram,)
            case 'lossy':
                return () if self._random.random() < 0.5 else (datagram,)
            case 'twice':
                return (datagram, datagram)
            case 'late':
                self._waiting.append((now + LATE, datagram))
                due = []
                while self._waiting[0][0] <= now:
                    due.append(self._waiting.popleft()[1])
                    if not self._waiting:
                        break
                return due
            case 'swapped':
                self._waiting.append((now, datagram))
                if self._count % 2:
                    return ()
                pair = [item for _, item in self._waiting]
                self._waiting.clear()
                return reversed(pair)
            case 'garbage':
                return (b'\0' + os.urandom(self._packet.size - 1),)
            case 'spike' if self._count > 1:
                return (datagram,)
            case 'deaf':
                return (datagram,)
        return (self._changed(datagram),)

    def _changed(self, datagram: bytes) -> bytes:
        """Return a datagram with another content."""
        size = self._packet.size
        stamp, *fields = self._packet.unpack_from(datagram)
        k = self._at - 1
        if self._held is None:
            self._held = list(fields)
        match self._how:
            case 'noisy':
                fields[k] += self._random.gauss(0.0, self._noise)
            case 'nan':
                fields = [float('nan')] * len(fields)
            case 'saturated':
                fields[k] = max(fields[k], -SATURATION)
            case 'frozen':
                fields = self._held
            case 'spike':
                fields[k] = self._spike
            case 'an hour ahead':
                stamp += HOUR_NS
            case 'an hour back':
                stamp -= HOUR_NS
        # Where the nodes of a soft body follow, they stay.
        return self._packet.pack(stamp, *fields) + datagram[size:]


class FaultyServer(WorldServer):
    """
    A world server whose streams can be distorted.

    Parameters
    ----------
    world : World
        The cell to simulate.
    config : WorldConfig
        Its description.
    port : int
        UDP port on loopback; 0 for a free one.

    """

    def __init__(self, world: World, config: WorldConfig, port: int) -> None:
        super().__init__(world, config, port)
        self._truth = world
        self._materials = config.material
        self._top = config.block.height
        self._distortions: dict[str, Distortion] = {}
        self._deaf = False
        self._seed = 0
        self._watch()

    def _watch(self) -> None:
        self._peak_force = 0.0
        self._lowest = self._truth.tool_height
        self._last_height = self._truth.tool_height
        self._marked: float | None = None
        self._mark_at: float | None = None
        self._went_down = 0.0
        self._touched = 0.0

    def _stream(self, readings: Readings, start_ns: int) -> None:
        now, height = time.monotonic(), self._truth.tool_height
        force = self._truth.contact_force
        self._peak_force = max(self._peak_force, abs(force))
        self._lowest = min(self._lowest, height)
        if self._mark_at is not None and abs(force) > self._mark_at:
            self._marked, self._mark_at = now, None
        if height < self._last_height - LEAST_DESCENT:
            self._went_down = now
        self._last_height = height
        if self._touches():
            self._touched = now
        super()._stream(readings, start_ns)

    def _touches(self) -> bool:
        return self._truth.tool_height < self._top - self._truth.displacement + 1e-6

    def _publish(self, stream: str, datagram: bytes) -> None:
        distortion = self._distortions.get(stream)
        if distortion is None:
            super()._publish(stream, datagram)
            return
        for item in distortion.pass_on(datagram, time.monotonic()):
            super()._publish(stream, item)

    def _handle(self, message: Message, sender: tuple[str, int], now: float) -> Message | None:
        match message:
            case {'request': 'push'} if self._deaf:
                return None
            case {'request': 'distort', 'stream': str() as stream, 'how': str() as how}:
                self._seed += 1
                self._deaf = how == 'deaf'
                self._distortions[stream] = Distortion(stream, how, self._seed)
                return {'answer': 'distort'}
            case {'request': 'heal'}:
                self._distortions.clear()
                self._deaf = False
                return {'answer': 'heal'}
            case {'request': 'watch'}:
                self._watch()
                return {'answer': 'watch'}
            case {'request': 'mark'}:
                self._marked = time.monotonic()
                return {'answer': 'mark'}
            case {'request': 'mark_at', 'force': float() as force}:
                self._mark_at = force
                return {'answer': 'mark_at'}
            case {'request': 'material', 'name': str() as name}:
                # Of the next sample: who presses sees to it that the tool is out of the way.
                self.material = self._materials(name)
                return {'answer': 'material'}
            case {'request': 'report'}:
                return {'answer': 'report', **self._told()}
        return super()._handle(message, sender, now)

    def _told(self) -> dict[str, object]:
        """Return the truth since the watch began, and the times [s] since the mark."""
        marked = self._marked

        def since(last: float) -> float | None:
            return None if marked is None else max(0.0, last - marked)

        return {
            'peak_force': self._peak_force,
            'lowest': self._lowest,
            'height': self._truth.tool_height,
            'touching': self._touches(),
            'resting': time.monotonic() - self._went_down,
            'stopped': since(self._went_down),
            'clear': None if self._touches() else since(self._touched),
        }


class FaultLink:
    """
    The campaign's side: asks a faulty world for something.

    Parameters
    ----------
    port : int
        UDP port of the world on loopback.

    """

    def __init__(self, port: int) -> None:
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.settimeout(0.5)
        self._socket.connect((LOOPBACK, port))

    def ask(self, request: str, **values: object) -> Message:
        """
        Return the answer to a request.

        Raises
        ------
        DeviceError
            If there is none.

        """
        for _ in range(10):
            self._socket.send(encode({'request': request, **values}))
            try:
                answer = decode(self._socket.recv(MAX_DATAGRAM))
            except OSError:
                continue
            if answer is not None and answer.get('answer') == request:
                return answer
        raise DeviceError(f'the simulated world does not answer to "{request}": see its output')

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


def main(argv: Sequence[str] | None = None) -> int:
    """Run a world with faults, with the arguments of ``simulated_world``; return the exit code."""
    return run_world(FaultyServer, argv)
