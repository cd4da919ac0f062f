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
An ATI Net F/T box: RDT over UDP, and its configuration page over HTTP.

``emulate_net_ft --port 49152 --http-port 8080 --world 47111`` serves what the load cell of a
simulated world reads.

References
----------
ATI document 9620-05-NET FT, sections 9.1 (netftapi2.xml) and 10.1 to 10.4 (RDT): requests of a
header 0x1234, a command and a sample count (0 for no end), answers of rdt_sequence (from 1 for
each request), ft_sequence (from power-up), status and six counts; big-endian. One client at a
time: the newest request counts.

"""

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
import random
import select
import signal
import socket
import sys
import threading
import time
from typing import Self

from hapticvision_ros.core.errors import DeviceError, HapticVisionError
from hapticvision_ros.sim.emulators.sources import no_load, Source, WorldSource

LOOPBACK = '127.0.0.1'
INTERNAL_RATE = 7000
"""Measurements each second inside the box [Hz], which ft_sequence counts."""


@dataclass
class NetFaults:
    """
    What goes wrong between the box and its client; may be changed while it runs.

    Parameters
    ----------
    loss, doubling, swapping, garbage : float
        Share of the records that are lost, come twice, come after the next one, or are followed
        by a datagram that is none.
    delay : float
        Longest time by which the network holds up a record; all that follow wait behind it [s].
    silent : bool
        Whether nothing is sent, as with the cable pulled.
    status : int
        The status code in all records.

    """

    loss: float = 0.0
    doubling: float = 0.0
    swapping: float = 0.0
    garbage: float = 0.0
    delay: float = 0.0
    silent: bool = False
    status: int = 0


@dataclass(frozen=True)
class NetFtBox:
    """
    How the box is set up.

    Parameters
    ----------
    rate : int
        Records each second [Hz].
    counts_per_force, counts_per_torque : int
        Counts for one of the units below.
    force_unit, torque_unit : str
        As the box spells them.
    newton, newton_metre : float
        One N and one N.m in these units.
    rdt : bool
        Whether RDT is enabled.

    """

    rate: int = 500
    counts_per_force: int = 1_000_000
    counts_per_torque: int = 1_000_000
    force_unit: str = 'N'
    torque_unit: str = 'N-m'
    newton: float = 1.0
    newton_metre: float = 1.0
    rdt: bool = True

    def page(self) -> bytes:
        """Return the configuration page."""
        values = {
            'prodname': 'Emulated Net F/T',
            'cfgcpf': self.counts_per_force,
            'cfgcpt': self.counts_per_torque,
            'scfgfu': self.force_unit,
            'scfgtu': self.torque_unit,
            'comrdte': 'Enabled' if self.rdt else 'Disabled',
            'comrdtrate': self.rate,
            'comrdtbsiz': 40,
        }
        body = ''.join(f'<{name}>{value}</{name}>' for name, value in values.items())
        return f'<?xml version="1.0" encoding="UTF-8"?><netft>{body}</netft>'.encode()


class NetFtEmulator:
    """
    A box that serves from threads of its own until it is closed.

    Parameters
    ----------
    source : callable
        What it measures.
    box : NetFtBox
        How it is set up.
    port, http_port : int
        UDP and TCP port on loopback; 0 for a free one.
    seed : int
        Of what goes wrong by chance.

    Attributes
    ----------
    faults : NetFaults
        What goes wrong.
    sent : int
        Records measured for the client, lost ones among them.

    Raises
    ------
    DeviceError
        If a port is taken.

    """

    def __init__(
        self,
        source: Source = no_load,
        box: NetFtBox | None = None,
        port: int = 0,
        http_port: int = 0,
        seed: int = 0,
    ) -> None:
        self.faults = NetFaults()
        self.sent = 0
        self._source = source
        self._box = box or NetFtBox()
        self._random = random.Random(seed)
        self._closing = threading.Event()
        self._restarting = threading.Event()
        self._power_up()
        page = self._box.page()

        class Page(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                found = self.path.partition('?')[0] == '/netftapi2.xml'
                self.send_response(200 if found else 404)
                self.send_header('Content-Type', 'text/xml')
                self.end_headers()
                self.wfile.write(page if found else b'')

            def log_message(self, *_: object) -> None:
                return

        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        try:
            self._socket.bind((LOOPBACK, port))
            self._web = ThreadingHTTPServer((LOOPBACK, http_port), Page)
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DeviceError(
                f'UDP port {port} or TCP port {http_port} on {LOOPBACK} cannot be had ({error}): '
                'choose others with --port and --http-port'
            ) from error
        self.port: int = self._socket.getsockname()[1]
        self.http_port: int = self._web.server_address[1]
        self._threads = [
            threading.Thread(target=self._serve, name='RDT', daemon=True),
            threading.Thread(target=self._web.serve_forever, args=(0.05,), name='HTTP'),
        ]
        for thread in self._threads:
            thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Switch the box off."""
        self._closing.set()
        self._web.shutdown()
        for thread in self._threads:
            thread.join()
        self._web.server_close()
        self._socket.close()

    def restart(self) -> None:
        """Switch the box off and on: it forgets its client, and counts from the beginning."""
        self._restarting.set()
        while self._restarting.is_set():
            time.sleep(0.001)

    def _power_up(self) -> None:
        self._client: tuple[str, int] | None = None
        self._left: int | None = None
        self._rdt_sequence = 0
        self._born = time.monotonic()
        self._next = self._born
        self._held: bytes | None = None
        self._road: list[tuple[float, bytes]] = []

    def _serve(self) -> None:
        while not self._closing.is_set():
            if self._restarting.is_set():
                self._power_up()
                self._restarting.clear()
            now = time.monotonic()
            wake = min([now + 0.02, self._next, *(due for due, _ in self._road[:1])])
            if select.select([self._socket], [], [], max(0.0, wake - now))[0]:
                self._listen()
            now = time.monotonic()
            if self._client is not None and now >= self._next:
                self._next += 1.0 / self._box.rate
                self._measure(now)
            elif self._client is None:
                self._next = now + 0.02
            while self._road and self._road[0][0] <= now:
                self._send(self._road.pop(0)[1])

    def _listen(self) -> None:
        try:
            datagram, client = self._socket.recvfrom(64)
        except OSError:
            return
        if len(datagram) != 8 or datagram[:2] != b'\x12\x34' or not self._box.rdt:
            return
        command = int.from_bytes(datagram[2:4])
        count = int.from_bytes(datagram[4:])
        if command == 0:
            self._client = None
        elif command in (1, 2, 3):
            self._client = client
            self._left = count or None
            self._rdt_sequence = 0
            self._next = time.monotonic()
            self._road.clear()

    def _measure(self, now: float) -> None:
        self._rdt_sequence = (self._rdt_sequence + 1) % 2**32
        self.sent += 1
        if self._left is not None:
            self._left -= 1
            if not self._left:
                self._client = None
        if self.faults.silent or self._random.random() < self.faults.loss:
            return
        record = self._record(now)
        due = now + self._random.random() * self.faults.delay
        if self._road:
            due = max(due, self._road[-1][0])
        batch = [record]
        if self._held is not None:
            batch.append(self._held)
            self._held = None
        elif self._random.random() < self.faults.swapping:
            self._held = record
            return
        if self._random.random() < self.faults.doubling:
            batch.append(record)
        if self._random.random() < self.faults.garbage:
            batch.append(self._random.randbytes(self._random.choice((0, 1, 35, 37, 400))))
        self._road += [(due, item) for item in batch]

    def _record(self, now: float) -> bytes:
        box = self._box
        scales = [box.newton * box.counts_per_force] * 3
        scales += [box.newton_metre * box.counts_per_torque] * 3
        counts = [
            max(-(2**31), min(2**31 - 1, round(value * scale)))
            for value, scale in zip(self._source(), scales, strict=True)
        ]
        ft_sequence = int((now - self._born) * INTERNAL_RATE) % 2**32
        head = b''.join(
            number.to_bytes(4) for number in (self._rdt_sequence, ft_sequence, self.faults.status)
        )
        return head + b''.join(number.to_bytes(4, signed=True) for number in counts)

    def _send(self, datagram: bytes) -> None:
        client = self._client
        if client is None:
            return
        try:
            self._socket.sendto(datagram, client)
        except OSError:
            return


def main(argv: Sequence[str] | None = None) -> int:
    """Run the ``emulate_net_ft`` command and return its exit code."""
    parser = argparse.ArgumentParser(
        prog='emulate_net_ft',
        description='Emulate an ATI Net F/T box on loopback. Prints "ready UDP_PORT HTTP_PORT".',
    )
    parser.add_argument('--port', type=int, default=0, help='UDP port; 0 (default) for a free one')
    parser.add_argument('--http-port', type=int, default=0, help='TCP port; 0 for a free one')
    parser.add_argument('--rate', type=int, default=500, help='records each second')
    parser.add_argument('--world', type=int, metavar='PORT', help='simulated world to measure in')
    parser.add_argument('--loss', type=float, default=0.0, help='share of the records to lose')
    parser.add_argument('--delay', type=float, default=0.0, help='longest delay of a record [s]')
    arguments = parser.parse_args(argv)
    world: WorldSource | None = None
    try:
        if not 1 <= arguments.rate <= INTERNAL_RATE:
            raise DeviceError(f'--rate must lie in 1 to {INTERNAL_RATE}')
        if arguments.world is not None:
            world = WorldSource(arguments.world)
        emulator = NetFtEmulator(
            world or no_load,
            NetFtBox(rate=arguments.rate),
            arguments.port,
            arguments.http_port,
        )
    except HapticVisionError as error:
        print(f'emulate_net_ft: {error}', file=sys.stderr)
        return error.exit_code
    emulator.faults.loss, emulator.faults.delay = arguments.loss, arguments.delay
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    print(f'ready {emulator.port} {emulator.http_port}', flush=True)
    stopped.wait()
    emulator.close()
    if world is not None:
        world.close()
    return 0
