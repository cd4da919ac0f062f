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
Load cell driver: owns the load cell and publishes each reading with the time of its measurement.

A reading that the device calls wrong is published as not a number: who controls by it must stop
at once, and a reading that is left out would be missed only when the next ones are late.
"""

from collections import deque
from math import isfinite, nan, sqrt
import time
from typing import Any, Final

from hapticvision_ros.bag.contract import PHASE, TARE, WRENCH
from hapticvision_ros.core.devices import LoadCell, WrenchSample
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.devices.low_pass import LowPass
from hapticvision_ros.devices.monitor import StreamMonitor
from hapticvision_ros.devices.mounting import rotation_from_rpy
from hapticvision_ros.devices.net_ft import connect_net_ft, NetFtSettings
from hapticvision_ros.devices.serial_cell import connect_serial_cell, LineFormat
from hapticvision_ros.nodes.conversions import NS_PER_S, wrench_to_message
from hapticvision_ros.nodes.device_keeper import DeviceKeeper, REOPEN_PARAMETERS
from hapticvision_ros.nodes.diagnostics import Diagnostics, Finding, Level, worst
from hapticvision_ros.nodes.parameters import ParameterSpec, RunningPush
from hapticvision_ros.nodes.qos import create_publisher, create_service
from hapticvision_ros.nodes.runtime import CellNode, run
from hapticvision_ros.sim.devices import connect_load_cell
import numpy as np

NAME: Final = 'load_cell_driver'

PARAMETERS: Final = (
    ParameterSpec(
        'backend',
        'string',
        '-',
        'Which load cell to use: the simulated one, an ATI Net F/T box or Ethernet Axia (net_ft), '
        'or one that sends lines of text over a serial port (serial).',
        choices=('simulated', 'net_ft', 'serial'),
        read_only=True,
    ),
    ParameterSpec(
        'simulated_world_port',
        'integer',
        '-',
        'UDP port of the simulated world on loopback.',
        1,
        65535,
        read_only=True,
    ),
    ParameterSpec(
        'net_ft_address', 'string', '-', 'Name or address of the Net F/T box.', read_only=True
    ),
    ParameterSpec(
        'net_ft_port',
        'integer',
        '-',
        'UDP port of its raw data transfer.',
        1,
        65535,
        read_only=True,
    ),
    ParameterSpec(
        'net_ft_http_port', 'integer', '-', 'TCP port of its web server.', 1, 65535, read_only=True
    ),
    ParameterSpec(
        'net_ft_product',
        'string',
        '-',
        'Whose status code it speaks: that of a Net F/T box or of an Ethernet Axia.',
        choices=('net_box', 'axia'),
        read_only=True,
    ),
    ParameterSpec(
        'net_ft_counts_per_newton',
        'double',
        '1/N',
        'Counts of force for one newton; 0 to read scales and rate from the box.',
        0.0,
        1e12,
        read_only=True,
    ),
    ParameterSpec(
        'net_ft_counts_per_newton_metre',
        'double',
        '1/(N.m)',
        'Counts of torque for one newton metre, where those of force are given.',
        0.0,
        1e12,
        read_only=True,
    ),
    ParameterSpec(
        'serial_port',
        'string',
        '-',
        'Serial port, best by its name below /dev/serial/by-id, or a URL such as '
        'socket://host:port.',
        read_only=True,
    ),
    ParameterSpec(
        'serial_baud_rate', 'integer', '1/s', 'Bits each second.', 300, 4000000, read_only=True
    ),
    ParameterSpec(
        'serial_force_field',
        'integer',
        '-',
        'Which number of a line is the force; the first is 0.',
        0,
        63,
        read_only=True,
    ),
    ParameterSpec(
        'serial_newton_per_unit',
        'double',
        'N',
        'Force along +z of the frame load_cell for one unit of that number: negative where '
        'compression reads positive.',
        -1e6,
        1e6,
        read_only=True,
    ),
    ParameterSpec(
        'serial_zero', 'double', '-', 'That number without load.', -1e9, 1e9, read_only=True
    ),
    ParameterSpec(
        'serial_saturation',
        'double',
        '-',
        'A number of this magnitude or more is beyond what the device can measure.',
        1e-9,
        1e18,
        read_only=True,
    ),
    ParameterSpec(
        'serial_counter_field',
        'integer',
        '-',
        'Which number of a line counts the readings; -1 where none does.',
        -1,
        63,
        read_only=True,
    ),
    ParameterSpec(
        'serial_counter_modulus',
        'integer',
        '-',
        'Number at which the counter begins again with 0.',
        2,
        2**32,
        read_only=True,
    ),
    ParameterSpec(
        'serial_checksum',
        'bool',
        '-',
        'Whether each line must end with a star and the exclusive or of the bytes before it.',
        read_only=True,
    ),
    ParameterSpec(
        'rate',
        'double',
        'Hz',
        'Readings each second that are expected; the filter and a serial load cell go by it.',
        1.0,
        10000.0,
        read_only=True,
    ),
    ParameterSpec(
        'rate_tolerance',
        'double',
        '-',
        'Share by which the rate may be off before it is reported.',
        0.001,
        1.0,
    ),
    ParameterSpec(
        'mounting_rpy',
        'double_array',
        'rad',
        "Roll, pitch and yaw of the sensor's frame in the frame load_cell, whose +z points along "
        'the push.',
        -3.1416,
        3.1416,
        read_only=True,
    ),
    ParameterSpec(
        'latency',
        'double',
        's',
        'Known time from the measurement until it arrives, such as the settling of a converter; '
        'the stamps are put back by it.',
        0.0,
        1.0,
        read_only=True,
    ),
    ParameterSpec(
        'filter_delay',
        'double',
        's',
        'Delay of the low-pass, whose -3 dB lie at 0.36 over the delay and one interval; 0 for '
        'none. The stamps are those of the measurement, but readings are known later.',
        0.0,
        0.5,
        read_only=True,
    ),
    ParameterSpec(
        'read_timeout',
        'double',
        's',
        'Without a reading for this time the load cell counts as lost.',
        0.01,
        10.0,
    ),
    *REOPEN_PARAMETERS,
    ParameterSpec(
        'capacity',
        'double',
        'N',
        'Largest magnitude along the push that the load cell can measure; readings at or above it '
        'are reported as saturated.',
        0.1,
        100000.0,
    ),
    ParameterSpec(
        'largest_gap',
        'double',
        's',
        'Time between two stamps above which samples are reported as lost.',
        0.001,
        1.0,
    ),
    ParameterSpec(
        'largest_clock_error',
        'double',
        's',
        "A reading whose stamp is further from this machine's time is garbage and left out; the "
        'simulated world stamps by its own clock, others by the arrival.',
        1.0,
        1e9,
        read_only=True,
    ),
    ParameterSpec(
        'tare_time',
        'double',
        's',
        'The tare service takes the mean over this time as zero.',
        0.01,
        2.0,
        read_only=True,
    ),
    ParameterSpec(
        'tare_spread',
        'double',
        'N',
        'Largest standard deviation of the force meanwhile; a load that moves is no zero.',
        1e-6,
        1000.0,
    ),
    ParameterSpec(
        'warning_interval',
        'double',
        's',
        'Shortest time between two warnings of the same kind.',
        0.1,
        600.0,
        read_only=True,
    ),
)

type Vector = tuple[float, float, float]

_NOTHING: Final[Vector] = (0.0, 0.0, 0.0)
_INVALID: Final[Vector] = (nan, nan, nan)


class LoadCellDriver(CellNode):
    """Publish the load cell's readings less the tare; report what is wrong with them."""

    def __init__(self) -> None:
        super().__init__(NAME, PARAMETERS)
        values = self.parameters
        self._warning_interval = values.real('warning_interval')
        self._tare_ns = round(values.real('tare_time') * NS_PER_S)
        self._latency_ns = round(values.real('latency') * NS_PER_S)
        self._largest_error_ns = round(values.real('largest_clock_error') * NS_PER_S)
        self._rotation = _rotation(values.reals('mounting_rpy'))
        self._low_pass = LowPass(values.real('filter_delay'), values.real('rate'))
        self._monitor = StreamMonitor(values.real('read_timeout'))
        self._recent: deque[WrenchSample] = deque()
        self._heard = 0.0
        self._push = RunningPush(self, PHASE)
        values.add_check(self._push.refusal)
        self._zero: tuple[Vector, Vector] = (_NOTHING, _NOTHING)
        self._tared: float | None = None
        self._saturated = self._faulty = 0
        self._told: dict[str, int] = {}
        self._warned: dict[str, float] = {}
        self._publisher = create_publisher(self, WRENCH)
        self._keeper = DeviceKeeper(
            self._connect,
            self.stopping,
            self.get_logger(),
            interval=values.real('reopen_interval'),
            patience=values.real('reopen_time'),
        )
        create_service(self, TARE, self._tare)
        diagnostics = self._diagnostics = Diagnostics(self, values.text('backend'))
        diagnostics.add('device', self._keeper.finding)
        diagnostics.add('readings', self._find_readings)
        diagnostics.add('tare', self._find_tare)
        self.spawn(self._read, 'load cell reader')

    def close(self) -> None:
        """Stop the reader, then let go of the load cell."""
        super().close()
        self._keeper.close()

    def _connect(self) -> LoadCell:
        values = self.parameters
        match values.text('backend'):
            case 'net_ft':
                return self._connect_net_ft()
            case 'serial':
                return connect_serial_cell(
                    _needed(values.text('serial_port'), 'serial_port'),
                    baud_rate=values.integer('serial_baud_rate'),
                    line_format=LineFormat(
                        force_field=values.integer('serial_force_field'),
                        newton_per_unit=values.real('serial_newton_per_unit'),
                        zero=values.real('serial_zero'),
                        saturation=values.real('serial_saturation'),
                        counter_field=values.integer('serial_counter_field'),
                        counter_modulus=values.integer('serial_counter_modulus'),
                        checksum=values.flag('serial_checksum'),
                    ),
                    rate=values.real('rate'),
                )
            case _:
                return connect_load_cell(values.integer('simulated_world_port'))

    def _connect_net_ft(self) -> LoadCell:
        values = self.parameters
        per_newton = values.real('net_ft_counts_per_newton')
        per_newton_metre = values.real('net_ft_counts_per_newton_metre')
        settings = None
        if per_newton:
            if not per_newton_metre:
                raise InputError(
                    'net_ft_counts_per_newton_metre is 0: give the counts of torque as well.'
                )
            settings = NetFtSettings(per_newton, per_newton_metre, values.real('rate'))
        return connect_net_ft(
            _needed(values.text('net_ft_address'), 'net_ft_address'),
            port=values.integer('net_ft_port'),
            http_port=values.integer('net_ft_http_port'),
            product='axia' if values.text('net_ft_product') == 'axia' else 'net_box',
            settings=settings,
        )

    def _read(self) -> None:
        self._keeper.run(self._read_once, self._forget, self._diagnostics.hasten)

    def _read_once(self, cell: LoadCell) -> None:
        for sample in cell.read(self.parameters.real('read_timeout')):
            self._take(sample)

    def _forget(self) -> None:
        """Begin anew: what comes after a loss does not continue what came before."""
        self._monitor.restart()
        self._low_pass.restart()
        self._recent.clear()

    def _take(self, sample: WrenchSample) -> None:
        largest_gap = self.parameters.real('largest_gap')
        off_ns = abs(sample.stamp_ns - time.time_ns())
        if off_ns > self._largest_error_ns:
            # A bag that holds such a stamp would last for decades.
            self._monitor.health.far_off += 1
            self._warn(
                'far off',
                f'The load cell gave a reading with a stamp {off_ns / NS_PER_S:.3g} s off this '
                "machine's time; it was left out.",
            )
            return
        stamp_ns = sample.stamp_ns - self._latency_ns
        if not self._monitor.take(stamp_ns, largest_gap):
            self._warn(
                'order',
                'The load cell gave a reading that is not newer than the one before; it was '
                'left out.',
            )
            return
        self._heard = time.monotonic()
        if self._monitor.gap > largest_gap:
            self._low_pass.restart()
            self._warn('gap', f'The load cell gave no reading for {self._monitor.gap:.3g} s.')
        trouble = self._trouble(sample)
        if trouble:
            self._warn('invalid', f'{trouble}: it is published as not a number.')
            self._low_pass.restart()
            self._recent.clear()
            self._publish(WrenchSample(stamp_ns, _INVALID, _INVALID))
            return
        turned = WrenchSample(stamp_ns, self._turned(sample.force), self._turned(sample.torque))
        if self._recent and stamp_ns < self._recent[-1].stamp_ns:
            # The device's clock was set back: what bears later stamps would never leave.
            self._low_pass.restart()
            self._recent.clear()
        self._recent.append(turned)
        while stamp_ns - self._recent[0].stamp_ns > self._tare_ns:
            self._recent.popleft()
        if abs(turned.force[2]) >= self.parameters.real('capacity'):
            self._saturated += 1
            self._warn(
                'saturated', f'The load cell is saturated: it reads {turned.force[2]:.4g} N.'
            )
        smooth = self._low_pass.take(turned)
        if smooth is not None:
            self._publish(smooth)

    def _trouble(self, sample: WrenchSample) -> str:
        """Return what makes a reading worthless, or an empty text."""
        if sample.saturated:
            self._saturated += 1
            return 'The load cell is saturated' + (f' ({sample.fault})' if sample.fault else '')
        if sample.fault:
            self._faulty += 1
            return f'The load cell reports a fault ({sample.fault})'
        if not all(map(isfinite, (*sample.force, *sample.torque))):
            self._faulty += 1
            return 'The load cell gave a reading that is not a number'
        return ''

    def _publish(self, sample: WrenchSample) -> None:
        zero_force, zero_torque = self._zero
        tared = WrenchSample(
            sample.stamp_ns,
            _difference(sample.force, zero_force),
            _difference(sample.torque, zero_torque),
        )
        self._publisher.publish(wrench_to_message(tared, WRENCH.frame_id))

    def _turned(self, vector: Vector) -> Vector:
        if self._rotation is None:
            return vector
        x, y, z = (self._rotation @ vector).tolist()
        return (x, y, z)

    def _warn(self, kind: str, text: str) -> None:
        """Log a warning, unless there was one of its kind just now."""
        now = time.monotonic()
        if now >= self._warned.get(kind, now):
            self._warned[kind] = now + self._warning_interval
            self.get_logger().warning(text)

    def _news(self, name: str, total: int) -> int:
        """Return by how much a count has grown since the last time."""
        before, self._told[name] = self._told.get(name, 0), total
        return total - before

    def _tare(self, request: Any, response: Any) -> Any:
        # The reader thread goes on appending, so that only a snapshot can be averaged.
        recent = self._recent.copy()
        response.success = False
        if self._push.phase is not None:
            # What the arm's controller compares with its limit would lack the force of the push.
            response.message = (
                f'A push is under way ({self._push.phase}), and its force limit counts from the '
                'zero: tare when it is over.'
            )
            return response
        if not recent:
            response.message = 'The load cell has given no reading yet.'
            return response
        silent = time.monotonic() - self._heard
        if silent > self.parameters.real('read_timeout'):
            response.message = f'The load cell has given no reading for {silent:.3g} s.'
            return response
        zero = _mean([sample.force for sample in recent])
        spread = sqrt(
            sum((sample.force[2] - zero[2]) ** 2 for sample in recent) / max(1, len(recent) - 1)
        )
        largest = self.parameters.real('tare_spread')
        if spread > largest:
            response.message = (
                f'The force varies by {spread:.3g} N (one standard deviation), more than '
                f'tare_spread allows ({largest:g} N): wait until nothing moves.'
            )
            return response
        self._zero = (zero, _mean([sample.torque for sample in recent]))
        self._tared = time.monotonic()
        response.success = True
        response.message = (
            f'The zero is {zero[2]:.6g} N along the push, from {len(recent)} readings.'
        )
        return response

    def _find_readings(self) -> Finding:
        """Return what is wrong with the readings at present."""
        values = self.parameters
        health = self._monitor.health
        rate = self._monitor.rate(time.monotonic())
        expected = values.real('rate')
        told: dict[str, object] = {
            'rate_hz': rate,
            'expected_rate_hz': expected,
            'gaps': health.gaps,
            'largest_gap_s': health.largest_gap,
            'not_newer': health.not_newer,
            'clock_jumps': health.clock_jumps,
            'far_off': health.far_off,
            'saturated': self._saturated,
            'invalid': self._faulty,
            'filter_delay_s': self._low_pass.delay,
            'latency_s': values.real('latency'),
        }
        findings = [Finding(Level.OK, '', told)]
        if self._news('saturated', self._saturated):
            findings.append(Finding(Level.ERROR, 'The load cell is saturated.'))
        if self._news('faulty', self._faulty):
            findings.append(Finding(Level.ERROR, 'The load cell reports faulty readings.'))
        far_off = self._news('far_off', health.far_off)
        if far_off:
            said = f"{far_off} readings had stamps far off this machine's time and were left out."
            findings.append(Finding(Level.WARN, said))
        new_gaps = self._news('gaps', health.gaps)
        if new_gaps:
            findings.append(Finding(Level.WARN, f'Readings are missing: {new_gaps} new gaps.'))
        if rate is not None and abs(rate / expected - 1.0) > values.real('rate_tolerance'):
            said = f'The rate is {rate:.4g} Hz, where {expected:g} Hz are expected.'
            findings.append(Finding(Level.WARN, said))
        return worst(findings, 'Readings come as expected.')

    def _find_tare(self) -> Finding:
        """Return which zero is taken off."""
        tared = self._tared
        force, torque = self._zero
        values: dict[str, object] = {'tared': tared is not None}
        for name, vector in (('force', force), ('torque', torque)):
            unit = 'N' if name == 'force' else 'Nm'
            values |= {f'{name}_{axis}_{unit}': x for axis, x in zip('xyz', vector, strict=True)}
        if tared is None:
            return Finding(Level.OK, 'No zero has been taken.', values)
        age = time.monotonic() - tared
        return Finding(Level.OK, f'The zero was taken {age:.0f} s ago.', values | {'age_s': age})


def _needed(text: str, name: str) -> str:
    if not text:
        raise InputError(f'{name} is empty: set it for this backend.')
    return text


def _rotation(rpy: tuple[float, ...]) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None:
    if len(rpy) != 3:
        raise InputError(f'mounting_rpy is {list(rpy)}: give three angles.')
    return rotation_from_rpy(*rpy) if any(rpy) else None


def _difference(a: Vector, b: Vector) -> Vector:
    return (a[0] - b[0], a[1] - b[1], a[2] - b[2])


def _mean(vectors: list[Vector]) -> Vector:
    x, y, z = (sum(column) / len(vectors) for column in zip(*vectors, strict=True))
    return (x, y, z)


def main() -> int:
    """Run the load cell driver."""
    return run(LoadCellDriver)
