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
Load cells that send one reading a line as text, as a microcontroller with an HX711 does.

A line is ASCII, ends with a line feed, and holds numbers between commas, semicolons, colons, tabs
or spaces: ``-8388.0``, ``reading,12.5kg,-7050.00`` or ``41,8123456*5A``. One of them is the force
in the device's own unit, one may be a counter that grows by one, and a checksum may follow a star:
the exclusive or of all bytes before it, in two hexadecimal digits.

References
----------
HX711 data sheet, Avia Semiconductor: 24 bits, saturated at 0x7FFFFF and 0x800000; 10 or 80
readings each second.

"""

from collections.abc import Sequence
from dataclasses import dataclass
import re
import time
from typing import Any, Final

from hapticvision_ros.core.devices import LoadCell, StreamCounts, WrenchSample
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.devices.numbered import ArrivalClock, SequenceWatch
import serial

LONGEST_LINE: Final = 256
"""Bytes without a line feed that are given up as no line."""
PAUSE_NS: Final = 500_000_000
"""A silence of this length is a pause [ns]; the slowest HX711 sends each 100 ms."""
POLL: Final = 0.05
"""Longest wait for the next byte before the time is looked at [s]."""

_CHECKSUM: Final = re.compile(rb'^(?P<body>[^*]*)\*(?P<sum>[0-9A-Fa-f]{2})$')
_SEPARATORS: Final = re.compile(r'[,;:\s]+')
# A number, with a unit at most behind it: half a line of something else is none.
_NUMBER: Final = re.compile(
    r'^(?P<number>[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d{1,3})?)[A-Za-z]{0,3}$'
)


@dataclass(frozen=True, slots=True)
class LineFormat:
    """
    What stands on a line, and what it means.

    Parameters
    ----------
    force_field : int
        Which of the line's numbers is the force; the first is 0.
    newton_per_unit : float
        Force along +z of the frame `load_cell` [N] for one unit; negative where compression
        reads positive, since the contact force is -force.z.
    zero : float
        The number without load.
    saturation : float
        A number of this magnitude or more is beyond what the device can measure.
    counter_field : int
        Which number counts the readings; -1 where none does.
    counter_modulus : int
        The number at which the counter begins again with zero.
    checksum : bool
        Whether each line must end with a checksum.

    """

    force_field: int = 0
    newton_per_unit: float = 1.0
    zero: float = 0.0
    saturation: float = 8388607.0
    counter_field: int = -1
    counter_modulus: int = 65536
    checksum: bool = False


def numbers_of(line: bytes, *, checksum: bool) -> list[float] | None:
    """
    Return the numbers on a line, or None if it is no line of the format.

    Parameters
    ----------
    line : bytes
        The line without its end.
    checksum : bool
        Whether it must end with a checksum; one that is there must be right in any case.

    """
    found = _CHECKSUM.match(line)
    if found is not None:
        total = 0
        for byte in found['body']:
            total ^= byte
        if total != int(found['sum'], 16):
            return None
        line = found['body']
    elif checksum:
        return None
    try:
        words = _SEPARATORS.split(line.decode('ascii').strip())
    except UnicodeDecodeError:
        return None
    matches = [_NUMBER.match(word) for word in words]
    return [float(match['number']) for match in matches if match is not None]


class SerialCell:
    """
    A load cell at a serial port.

    Parameters
    ----------
    port : str
        The port, such as ``/dev/ttyACM0``, or a URL such as ``socket://host:port``.
    baud_rate : int
        Bits each second.
    line_format : LineFormat
        What stands on a line.
    rate : float
        Readings each second, roughly [Hz]: lines that come in one piece were measured one after
        the other.

    Raises
    ------
    DeviceError
        If the port cannot be opened.

    """

    def __init__(self, port: str, baud_rate: int, line_format: LineFormat, rate: float) -> None:
        self.counts = StreamCounts()
        self._name = f'the load cell at {port}'
        self._format = line_format
        self._numbers = SequenceWatch(self.counts, line_format.counter_modulus)
        self._clock = ArrivalClock(rate, exact=False)
        self._index = -1
        self._heard_ns = 0
        self._buffer = bytearray()
        # What comes first may be the end of a line that began before.
        self._skipping = True
        try:
            self._serial: Any = serial.serial_for_url(
                port, baudrate=baud_rate, timeout=POLL, do_not_open=True
            )
            if port.startswith('/'):
                self._serial.exclusive = True
            self._serial.open()
            self._serial.reset_input_buffer()
        except (OSError, ValueError) as error:
            raise DeviceError(
                f'{self._name} cannot be opened ({_reason(error)}): see to its cable, the name of '
                'the port and the right to use it'
            ) from error

    def read(self, timeout: float) -> Sequence[WrenchSample]:
        """Return the samples since the last call, waiting up to `timeout` [s] for the first."""
        deadline = time.monotonic() + timeout
        samples: list[WrenchSample] = []
        while not samples:
            if time.monotonic() > deadline:
                raise DeviceError(
                    f'{self._name} has sent no reading for {timeout:g} s: see to its power, '
                    'cable, baud rate and line format'
                )
            data = self._receive()
            now_ns = time.time_ns()
            lines = self._lines(data)
            # One line after a silence is a device that has paused; several were held up.
            if len(lines) == 1 and now_ns - self._heard_ns > PAUSE_NS:
                self._clock.restart()
            self._heard_ns = now_ns if lines else self._heard_ns
            for line in lines:
                sample = self._decode(line, now_ns)
                if sample is not None:
                    samples.append(sample)
        self.counts.received += len(samples)
        return samples

    def close(self) -> None:
        """Let go of the port; may be called again."""
        self._serial.close()

    def _receive(self) -> bytes:
        """Return what waits, at least one byte, or nothing after `POLL`."""
        if not self._serial.is_open:
            raise DeviceError(f'{self._name} has been closed')
        try:
            first: bytes = self._serial.read(1)
            return first + self._serial.read(self._serial.in_waiting) if first else b''
        except (OSError, TypeError) as error:
            # What is unplugged while it is read shows as either.
            raise DeviceError(
                f'{self._name} has gone ({_reason(error)}): plug it in again'
            ) from error

    def _lines(self, data: bytes) -> list[bytes]:
        """Return the whole lines that `data` completes."""
        *lines, rest = (self._buffer + data).split(b'\n')
        if lines and self._skipping:
            self._skipping = False
            lines = lines[1:]
        if len(rest) > LONGEST_LINE:
            self.counts.garbled += 1
            self._skipping, rest = True, bytearray()
        self._buffer = bytearray(rest)
        return [bytes(line).strip() for line in lines]

    def _decode(self, line: bytes, now_ns: int) -> WrenchSample | None:
        if not line:
            return None
        form = self._format
        # A line that cannot be read was a reading all the same.
        self._index += 1
        numbers = numbers_of(line, checksum=form.checksum)
        if numbers is None or len(numbers) <= max(form.force_field, form.counter_field):
            self.counts.garbled += 1
            return None
        if form.counter_field >= 0:
            number = numbers[form.counter_field]
            if not number.is_integer() or not 0 <= number < form.counter_modulus:
                self.counts.garbled += 1
                return None
            index = self._numbers.take(int(number))
            if index is None:
                return None
            self._index = index
        raw = numbers[form.force_field]
        force = (raw - form.zero) * form.newton_per_unit
        return WrenchSample(
            self._clock.stamp(self._index, now_ns),
            (0.0, 0.0, force),
            (0.0, 0.0, 0.0),
            saturated=abs(raw) >= form.saturation,
        )


def _reason(error: BaseException) -> str:
    return str(getattr(error, 'strerror', None) or error or type(error).__name__)


def connect_serial_cell(
    port: str,
    *,
    baud_rate: int = 115200,
    line_format: LineFormat | None = None,
    rate: float = 80.0,
) -> LoadCell:
    """
    Open a load cell that sends lines of text.

    Parameters
    ----------
    port : str
        The port, such as ``/dev/ttyACM0``, or a URL such as ``socket://host:port``.
    baud_rate : int
        Bits each second.
    line_format : LineFormat, optional
        What stands on a line; one number, the force in newton, if not given.
    rate : float
        Readings each second, roughly [Hz].

    Returns
    -------
    LoadCell
        The load cell.

    Raises
    ------
    DeviceError
        If the port cannot be opened.

    """
    return SerialCell(port, baud_rate, line_format or LineFormat(), rate)
