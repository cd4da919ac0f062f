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
A microcontroller with an HX711 at a serial port, here a pseudo-terminal.

``emulate_serial_cell --link /tmp/ttyHX711 --world 47111`` sends what the load cell of a simulated
world reads. Like an adapter under ``/dev/serial/by-id``, the link keeps its name when the device
is unplugged and plugged in again.

References
----------
HX711 data sheet, Avia Semiconductor: 24 bits, held at 0x7FFFFF and 0x800000 beyond the range; 10
or 80 readings each second.

"""

import argparse
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
import os
from pathlib import Path
import random
import signal
import sys
import tempfile
import threading
import time
import tty
from typing import Self

from hapticvision_ros.core.errors import DeviceError, HapticVisionError
from hapticvision_ros.sim.emulators.sources import no_load, Source, WorldSource

HIGHEST, LOWEST = 0x7FFFFF, -0x800000
"""What the converter gives where the load is beyond its range."""


@dataclass
class LineFaults:
    """
    What goes wrong on the line; may be changed while it runs.

    Parameters
    ----------
    loss, doubling, noise, cutting : float
        Share of the lines that are lost, come twice, have a byte changed, or lack some.
    burst : int
        Lines that a buffer holds back and sends in one piece.
    silent : bool
        Whether nothing is sent.

    """

    loss: float = 0.0
    doubling: float = 0.0
    noise: float = 0.0
    cutting: float = 0.0
    burst: int = 1
    silent: bool = False


@dataclass(frozen=True)
class Firmware:
    """
    What the microcontroller sends.

    Parameters
    ----------
    rate : float
        Lines each second [Hz].
    counts_per_newton : float
        Counts for one newton along the push; compression reads positive.
    offset : int
        Counts without load.
    template : str
        The line, with ``{raw}`` and, if wanted, ``{counter}``.
    checksum : bool
        Whether a star and the exclusive or of the bytes before it end the line.

    """

    rate: float = 80.0
    counts_per_newton: float = 20000.0
    offset: int = 100000
    template: str = '{raw}'
    checksum: bool = False


class SerialCellEmulator:
    """
    A device that sends from a thread of its own until it is closed.

    Parameters
    ----------
    link : Path
        Where the port is to be found.
    source : callable
        What it measures.
    firmware : Firmware
        What it sends.
    seed : int
        Of what goes wrong by chance.

    Attributes
    ----------
    faults : LineFaults
        What goes wrong.
    sent : int
        Readings taken, lost ones among them.

    Raises
    ------
    DeviceError
        If there is something else where the link is to be.

    """

    def __init__(
        self,
        link: Path,
        source: Source = no_load,
        firmware: Firmware | None = None,
        seed: int = 0,
    ) -> None:
        self.link = link
        self.faults = LineFaults()
        self.sent = 0
        self._source = source
        self._firmware = firmware or Firmware()
        self._random = random.Random(seed)
        self._lock = threading.Lock()
        self._master: int | None = None
        self._slave: int | None = None
        self._closing = threading.Event()
        self.plug_in()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Take the device away."""
        self._closing.set()
        self._thread.join()
        self.unplug()

    def plug_in(self) -> None:
        """Connect the device; its counter begins anew."""
        with self._lock:
            self._master, self._slave = os.openpty()
            tty.setraw(self._slave)
            os.set_blocking(self._master, False)
            self._counter = 0
            self._buffer = b''
            try:
                if self.link.is_symlink():
                    self.link.unlink()
                self.link.symlink_to(os.ttyname(self._slave))
            except OSError as error:
                raise DeviceError(
                    f'{self.link} cannot be made ({error.strerror}): choose another with --link'
                ) from error

    def unplug(self) -> None:
        """Pull the plug."""
        with self._lock:
            with suppress(OSError):
                self.link.unlink()
            for end in (self._master, self._slave):
                if end is not None:
                    os.close(end)
            self._master = self._slave = None

    def write(self, data: bytes) -> None:
        """Send bytes as they are, such as a boot message."""
        with self._lock:
            if self._master is not None:
                # A line that nobody reads is full, and what is sent then is lost.
                with suppress(OSError):
                    os.write(self._master, data)

    def _run(self) -> None:
        due = time.monotonic()
        while not self._closing.is_set():
            due += 1.0 / self._firmware.rate
            time.sleep(max(0.0, due - time.monotonic()))
            self._measure()

    def _measure(self) -> None:
        firmware, faults, chance = self._firmware, self.faults, self._random.random
        force = -self._source()[2]
        raw = round(force * firmware.counts_per_newton) + firmware.offset
        raw = max(LOWEST, min(HIGHEST, raw))
        self.sent += 1
        self._counter = (self._counter + 1) % 65536
        line = firmware.template.format(raw=raw, counter=self._counter).encode('ascii')
        if firmware.checksum:
            parity = 0
            for byte in line:
                parity ^= byte
            line += b'*%02X' % parity
        if faults.silent or chance() < faults.loss:
            return
        if chance() < faults.noise:
            damaged = bytearray(line)
            damaged[self._random.randrange(len(line))] ^= 1 << self._random.randrange(8)
            line = bytes(damaged)
        if chance() < faults.cutting:
            line = line[: self._random.randrange(len(line))]
        self._buffer += (line + b'\r\n') * (2 if chance() < faults.doubling else 1)
        if self._buffer.count(b'\n') >= faults.burst:
            self.write(self._buffer)
            self._buffer = b''


def _check(template: str) -> None:
    """Refuse a line that tells no reading."""
    try:
        said = template.format(raw=4711, counter=1)
        said.encode('ascii')
    except (LookupError, ValueError):
        said = ''
    if '4711' not in said:
        raise DeviceError(f'--template {template!r} holds no {{raw}}, or cannot be sent as ASCII')


def main(argv: Sequence[str] | None = None) -> int:
    """Run the ``emulate_serial_cell`` command and return its exit code."""
    parser = argparse.ArgumentParser(
        prog='emulate_serial_cell',
        description='Emulate a load cell with an HX711 at a serial port. Prints "ready PORT".',
    )
    default = Path(tempfile.gettempdir()) / 'ttyHX711'
    parser.add_argument('--link', type=Path, default=default, help=f'the port ({default})')
    parser.add_argument('--rate', type=float, default=80.0, help='lines each second')
    parser.add_argument('--template', default='{raw}', help="the line; default '{raw}'")
    parser.add_argument('--checksum', action='store_true', help='end each line with a checksum')
    parser.add_argument('--world', type=int, metavar='PORT', help='simulated world to measure in')
    arguments = parser.parse_args(argv)
    world: WorldSource | None = None
    try:
        if not 1.0 <= arguments.rate <= 1000.0:
            raise DeviceError('--rate must lie in 1 to 1000')
        _check(arguments.template)
        if arguments.world is not None:
            world = WorldSource(arguments.world)
        firmware = Firmware(
            rate=arguments.rate, template=arguments.template, checksum=arguments.checksum
        )
        emulator = SerialCellEmulator(arguments.link, world or no_load, firmware)
    except HapticVisionError as error:
        print(f'emulate_serial_cell: {error}', file=sys.stderr)
        return error.exit_code
    stopped = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stopped.set())
    print(f'ready {emulator.link}', flush=True)
    stopped.wait()
    emulator.close()
    if world is not None:
        world.close()
    return 0
