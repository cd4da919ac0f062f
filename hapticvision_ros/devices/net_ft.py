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
ATI Net F/T boxes and Ethernet Axia sensors, over Raw Data Transfer (RDT).

A request of 8 bytes starts the stream, each record of 36 bytes is a datagram; all numbers are
big-endian. The box has no clock and numbers its records. Scales and units come from its
configuration page over HTTP, or from the caller.

References
----------
ATI document 9620-05-NET FT, Network Force/Torque Sensor System, sections 9 (configuration page),
10 (RDT) and 18.2 (status code); 9610-05-Ethernet Axia, sections 4.8 (status code) and 12 (RDT).

"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import isfinite
import select
import socket
import struct
import time
from typing import Final, Literal
import urllib.error
import urllib.request
import xml.etree.ElementTree as ElementTree

from hapticvision_ros.core.devices import LoadCell, StreamCounts, WrenchSample
from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.core.units import FORCE_UNITS
from hapticvision_ros.devices.numbered import ArrivalClock, SequenceWatch

type Product = Literal['net_box', 'axia']

RDT_PORT: Final = 49152
HTTP_PORT: Final = 80
REQUEST: Final = struct.Struct('>HHI')
RECORD: Final = struct.Struct('>III6i')

CONNECT_TIMEOUT: Final = 3.0
"""How long a box is waited for [s]."""
RETRY: Final = 0.2
"""Time between two requests to start [s]."""
RECEIVE_BUFFER: Final = 1 << 20
"""Bytes asked of the system for records that wait to be read."""

_HEADER: Final = 0x1234
_STOP: Final = 0x0000
_START_REALTIME: Final = 0x0002
_MAX_DATAGRAM: Final = 2048
_MAX_PAGE: Final = 1 << 20
_TIMESPEC: Final = struct.Struct('@qq')
_SO_TIMESTAMPNS: Final = 35

_MONITOR_CONDITION: Final = 1 << 16
_SATURATION: Final[Mapping[Product, int]] = {
    'net_box': 1 << 17,
    'axia': 1 << 27 | 1 << 30,
}
_STATUS: Final[Mapping[Product, Mapping[int, str]]] = {
    'net_box': {
        30: 'CPU or RAM error',
        29: 'digital board error',
        28: 'analog board error',
        27: 'serial link communication error',
        26: 'program memory error',
        25: 'halted due to configuration errors',
        24: 'settings validation error',
        23: 'configuration incompatible with calibration',
        22: 'network communication failure',
        17: 'transducer saturation or A/D error',
        14: 'watchdog timeout',
        10: 'analog board watchdog timeout',
        9: 'excessive strain gage excitation current',
        8: 'insufficient strain gage excitation current',
        6: 'analog board power supply too high',
        5: 'analog board power supply too low',
        4: 'serial link data unavailable',
        3: 'reference voltage or power error',
        2: 'internal temperature error',
    },
    'axia': {
        30: 'force or torque out of range',
        29: 'calibration checksum error',
        28: 'simulated error',
        27: 'gage out of range',
        7: 'calibration not accessible',
        5: 'unspecified error',
        3: 'busy',
        2: 'broken gage',
        1: 'supply voltage out of range',
        0: 'temperature out of range',
    },
}

_POUND: Final = FORCE_UNITS['lbf']
_KILOGRAM: Final = FORCE_UNITS['kgf']
_FORCE_UNITS: Final[Mapping[str, float]] = {
    'n': 1.0,
    'kn': 1000.0,
    'lbf': _POUND,
    'lb': _POUND,
    'klbf': 1000.0 * _POUND,
    'kgf': _KILOGRAM,
    'kg': _KILOGRAM,
    'gf': 0.001 * _KILOGRAM,
}
_TORQUE_UNITS: Final[Mapping[str, float]] = {
    'nm': 1.0,
    'nmm': 0.001,
    'knm': 1000.0,
    'lbfin': 0.0254 * _POUND,
    'lbin': 0.0254 * _POUND,
    'inlb': 0.0254 * _POUND,
    'lbfft': 0.3048 * _POUND,
    'ftlb': 0.3048 * _POUND,
    'kgfcm': 0.01 * _KILOGRAM,
    'kgcm': 0.01 * _KILOGRAM,
}


@dataclass(frozen=True, slots=True)
class NetFtSettings:
    """
    What turns the box's counts into SI units.

    Parameters
    ----------
    counts_per_newton : float
        Counts of force for one newton.
    counts_per_newton_metre : float
        Counts of torque for one newton metre.
    rate : float
        Records each second [Hz].

    """

    counts_per_newton: float
    counts_per_newton_metre: float
    rate: float


def read_settings(address: str, port: int = HTTP_PORT) -> NetFtSettings:
    """
    Read scales, units and rate from the configuration page of a box.

    Parameters
    ----------
    address : str
        Name or address of the box.
    port : int
        Port of its web server.

    Returns
    -------
    NetFtSettings
        Those of the active configuration.

    Raises
    ------
    DeviceError
        If the box does not answer, answers something else, or has RDT switched off.

    """
    url = f'http://{address}:{port}/netftapi2.xml'
    # The box is on the cell's own network: never by way of a proxy.
    opener = urllib.request.build_opener(urllib.request.ProxyHandler({}))
    try:
        with opener.open(url, timeout=CONNECT_TIMEOUT) as answer:
            page = answer.read(_MAX_PAGE)
    except (OSError, ValueError, urllib.error.URLError) as error:
        reason = getattr(error, 'reason', error)
        raise DeviceError(
            f'the Net F/T box gives no configuration at {url} ({reason}): see to its power, '
            'cable and address'
        ) from error
    try:
        root = ElementTree.fromstring(page)
    except ElementTree.ParseError as error:
        raise DeviceError(f'{url} is no configuration of a Net F/T box ({error})') from error
    values = {element.tag: (element.text or '').strip() for element in root.iter()}
    if values.get('comrdte', 'Enabled').lower() not in ('enabled', '1'):
        raise DeviceError(
            f'RDT is switched off in the Net F/T box at {address}: enable it on its '
            'communication page'
        )
    return NetFtSettings(
        _number(values, 'cfgcpf', url) / _unit(values, 'scfgfu', _FORCE_UNITS, url),
        _number(values, 'cfgcpt', url) / _unit(values, 'scfgtu', _TORQUE_UNITS, url),
        _number(values, 'comrdtrate', url),
    )


def _number(values: Mapping[str, str], name: str, url: str) -> float:
    try:
        number = float(values[name])
    except (KeyError, ValueError):
        number = 0.0
    if not (isfinite(number) and number > 0.0):
        raise DeviceError(
            f'{url} gives no positive number {name}: set counts and rate by parameters instead'
        )
    return number


def _unit(values: Mapping[str, str], name: str, units: Mapping[str, float], url: str) -> float:
    said = values.get(name, '')
    plain = ''.join(c for c in said.lower() if c.isalnum())
    if plain not in units:
        raise DeviceError(
            f'{url} gives {name} as {said!r}, which is no known unit: choose N and N-m in the box'
        )
    return units[plain]


class NetFt:
    """
    A stream of RDT records.

    Parameters
    ----------
    address : str
        Name or address of the box.
    settings : NetFtSettings
        Its scales and rate.
    port : int
        Its UDP port.
    product : {'net_box', 'axia'}
        Whose status code it speaks.

    Raises
    ------
    DeviceError
        If no record comes.

    """

    def __init__(
        self,
        address: str,
        settings: NetFtSettings,
        port: int = RDT_PORT,
        product: Product = 'net_box',
    ) -> None:
        self.counts = StreamCounts()
        self._name = f'the Net F/T box at {address}, UDP port {port}'
        self._settings = settings
        self._product: Product = product
        self._numbers = SequenceWatch(self.counts)
        self._clock = ArrivalClock(settings.rate)
        self._restarts = 0
        self._pending: list[tuple[bytes, int]] = []
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, RECEIVE_BUFFER)
            # When the system got a record, not when this process came round to it.
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)
            self._socket.setblocking(False)
            self._socket.connect((address, port))
            self._start()
        except (OSError, OverflowError) as error:
            self._socket.close()
            raise DeviceError(f'{self._name} cannot be reached: {error}') from error
        except DeviceError:
            self.close()
            raise

    def read(self, timeout: float) -> Sequence[WrenchSample]:
        """Return the samples since the last call, waiting up to `timeout` [s] for the first."""
        deadline = time.monotonic() + timeout
        samples: list[WrenchSample] = []
        while not samples:
            datagrams, self._pending = self._pending, []
            if not datagrams:
                if not self._wait(deadline):
                    raise DeviceError(
                        f'{self._name} has sent no record for {timeout:g} s: see to its power '
                        'and cable, and that no other program reads it'
                    )
                datagrams = self._receive()
            for datagram, arrival_ns in datagrams:
                sample = self._decode(datagram, arrival_ns)
                if sample is not None:
                    samples.append(sample)
        self.counts.received += len(samples)
        return samples

    def close(self) -> None:
        """Stop the stream and close the socket; may be called again."""
        if self._socket.fileno() != -1:
            self._request(_STOP)
            self._socket.close()

    def _start(self) -> None:
        """Ask for the stream until its first record comes."""
        deadline = time.monotonic() + CONNECT_TIMEOUT
        while (now := time.monotonic()) < deadline:
            self._request(_START_REALTIME)
            attempt_ends = min(deadline, now + RETRY)
            while not self._pending and self._wait(attempt_ends):
                try:
                    self._pending = self._receive()
                except DeviceError:
                    # Nothing listens there yet: a box that just starts.
                    time.sleep(max(0.0, attempt_ends - time.monotonic()))
                    break
            if self._pending:
                return
        raise DeviceError(
            f'{self._name} does not answer: see to its power, cable and address, and that RDT is '
            'enabled on its communication page'
        )

    def _request(self, command: int) -> None:
        """Send a request; one that meets nobody is told by the silence that follows."""
        try:
            self._socket.send(REQUEST.pack(_HEADER, command, 0))
        except OSError:
            return

    def _wait(self, deadline: float) -> bool:
        if self._socket.fileno() == -1:
            raise DeviceError(f'{self._name} has been closed')
        remaining = max(0.0, deadline - time.monotonic())
        return bool(select.select([self._socket], [], [], remaining)[0])

    def _receive(self) -> list[tuple[bytes, int]]:
        """Return all datagrams that wait, with the times of their arrival [ns since the epoch]."""
        datagrams: list[tuple[bytes, int]] = []
        try:
            while True:
                data, ancillary, _, _ = self._socket.recvmsg(
                    _MAX_DATAGRAM, socket.CMSG_SPACE(_TIMESPEC.size)
                )
                datagrams.append((data, _arrival(ancillary)))
        except BlockingIOError:
            return datagrams
        except OSError as error:
            if datagrams:
                return datagrams
            raise DeviceError(f'{self._name} cannot be reached: {error.strerror}') from error

    def _decode(self, datagram: bytes, arrival_ns: int) -> WrenchSample | None:
        if len(datagram) != RECORD.size:
            self.counts.garbled += 1
            return None
        number, _, status, fx, fy, fz, tx, ty, tz = RECORD.unpack(datagram)
        index = self._numbers.take(number)
        if index is None:
            return None
        if self.counts.restarts != self._restarts:
            self._restarts = self.counts.restarts
            self._clock = ArrivalClock(self._settings.rate)
        per_newton = self._settings.counts_per_newton
        per_newton_metre = self._settings.counts_per_newton_metre
        wrong = status & ~_MONITOR_CONDITION
        return WrenchSample(
            self._clock.stamp(index, arrival_ns),
            (fx / per_newton, fy / per_newton, fz / per_newton),
            (tx / per_newton_metre, ty / per_newton_metre, tz / per_newton_metre),
            bool(wrong & _SATURATION[self._product]),
            _fault(wrong, self._product) if wrong else '',
        )


def _arrival(ancillary: Sequence[tuple[int, int, bytes]]) -> int:
    for level, kind, data in ancillary:
        if (level, kind) == (socket.SOL_SOCKET, _SO_TIMESTAMPNS) and len(data) == _TIMESPEC.size:
            seconds, nanoseconds = _TIMESPEC.unpack(data)
            return int(seconds) * 1_000_000_000 + int(nanoseconds)
    return time.time_ns()


def _fault(status: int, product: Product) -> str:
    said = [text for bit, text in _STATUS[product].items() if status >> bit & 1]
    return f'status 0x{status:08x}' + (f', {", ".join(said)}' if said else '')


def connect_net_ft(
    address: str,
    *,
    port: int = RDT_PORT,
    http_port: int = HTTP_PORT,
    product: Product = 'net_box',
    settings: NetFtSettings | None = None,
) -> LoadCell:
    """
    Open the stream of a Net F/T box or an Ethernet Axia sensor.

    Parameters
    ----------
    address : str
        Its name or address.
    port, http_port : int
        UDP port of RDT, and TCP port of its web server.
    product : {'net_box', 'axia'}
        Whose status code it speaks.
    settings : NetFtSettings, optional
        Its scales and rate; read from the box if not given.

    Returns
    -------
    LoadCell
        The load cell, streaming.

    Raises
    ------
    DeviceError
        If the box does not answer, or its configuration cannot be used.

    """
    if settings is None:
        settings = read_settings(address, http_port)
    return NetFt(address, settings, port, product)
