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

"""The serial back end against an emulated microcontroller at a pseudo-terminal."""

import time

from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.devices.serial_cell import connect_serial_cell, LineFormat, numbers_of
from hapticvision_ros.sim.emulators.serial_cell import Firmware, SerialCellEmulator
from hapticvision_ros.sim.emulators.sources import constant
import numpy as np
import pytest

LOAD = (0.0, 0.0, -12.5, 0.0, 0.0, 0.0)
RATE = 400.0
"""Faster than an HX711, to save time [Hz]."""
PLAIN = LineFormat(newton_per_unit=-1 / 20000.0, zero=100000.0)
CHECKED = LineFormat(
    newton_per_unit=-1 / 20000.0,
    zero=100000.0,
    counter_field=0,
    force_field=1,
    checksum=True,
)


@pytest.fixture
def start(tmp_path):
    started = []

    def start(load=LOAD, **firmware):
        emulator = SerialCellEmulator(
            tmp_path / 'tty', constant(load), Firmware(rate=RATE, **firmware), seed=3
        )
        started.append(emulator)
        return emulator

    yield start
    for emulator in started:
        emulator.close()


@pytest.fixture
def connect():
    opened = []

    def connect(emulator, line_format=PLAIN, rate=RATE):
        cell = connect_serial_cell(str(emulator.link), line_format=line_format, rate=rate)
        opened.append(cell)
        return cell

    yield connect
    for cell in opened:
        cell.close()


@pytest.mark.parametrize(
    ('line', 'numbers'),
    [
        (b'-8388608', [-8388608.0]),
        (b'3.5e2', [350.0]),
        (b'reading,12.5kg,-7050.00', [12.5, -7050.0]),
        (b'Reading: 0.25 kg calibration_factor: -7050.00', [0.25, -7050.0]),
        (b'3.53,kg,', [3.53]),
        (b'41;81234', [41.0, 81234.0]),
        (b'12.5*18', [12.5]),
        (b'12.5*19', None),
        (b'12-5', []),
        (b'1.2.3', []),
        (b'nan', []),
        (b'\xff12', None),
        (b'', []),
    ],
)
def test_numbers_on_a_line(line, numbers):
    # 0x31 ^ 0x32 ^ 0x2e ^ 0x35 is 0x18.
    assert numbers_of(line, checksum=False) == numbers


def test_counts_become_newtons(start, connect, read_until):
    samples = read_until(connect(start()), lambda samples: len(samples) >= 100)
    for sample in samples:
        assert sample.force == pytest.approx(LOAD[:3], abs=1e-4)
        assert not sample.saturated
    stamps = np.array([sample.stamp_ns for sample in samples]) * 1e-9
    assert np.all(np.diff(stamps) > 0.0)
    assert abs(time.time() - stamps[-1]) < 0.5


def test_a_converter_at_its_end_is_saturated(start, connect, read_until):
    emulator = start((0.0, 0.0, -1000.0, 0.0, 0.0, 0.0))
    assert read_until(connect(emulator), bool)[0].saturated


def test_lines_that_are_no_readings_are_left_out(start, connect, read_until):
    emulator = start()
    cell = connect(emulator)
    read_until(cell, bool)
    for garbage in (b'HX711 ready\r\n', b'\xff\xfe\x00\r\n', b'x' * 1000, b'\r\n\r\n'):
        emulator.write(garbage)
        before = len(read_until(cell, lambda samples: len(samples) >= 20))
        assert before
    samples = read_until(cell, lambda samples: len(samples) >= 100)
    assert {sample.force[2] for sample in samples} == {LOAD[2]}
    assert cell.counts.garbled >= 3


def test_the_end_of_a_line_that_began_before_is_no_reading(start, connect, read_until):
    emulator = start()
    emulator.faults.silent = True
    cell = connect(emulator)
    emulator.write(b'45\r\n350000\r\n')
    assert read_until(cell, bool)[0].force[2] == pytest.approx(LOAD[2])


def test_with_counter_and_checksum_no_damaged_line_gets_through(start, connect, read_until):
    emulator = start(template='{counter},{raw}', checksum=True)
    cell = connect(emulator, CHECKED)
    read_until(cell, bool)
    faults = emulator.faults
    faults.noise = faults.cutting = faults.loss = faults.doubling = 0.1
    samples = read_until(cell, lambda samples: len(samples) >= 300)
    assert {sample.force[2] for sample in samples} == {LOAD[2]}
    counts = cell.counts
    assert counts.garbled > 10 and counts.late > 5
    assert counts.lost > 20
    # What is lost, damaged and read adds up to what was measured, but for the first lines.
    assert counts.received + counts.lost == pytest.approx(emulator.sent, abs=60)


def test_lines_that_a_buffer_holds_back_keep_their_times(start, connect, read_until):
    emulator = start()
    emulator.faults.burst = 16
    cell = connect(emulator, rate=RATE)
    read_until(cell, lambda samples: len(samples) >= 600)
    samples = read_until(cell, lambda samples: len(samples) >= 400)
    steps = np.diff([sample.stamp_ns for sample in samples]) * 1e-9
    assert np.all(steps > 0.0)
    # Without that, fifteen steps of sixteen would be nothing, and one 40 ms.
    assert np.percentile(np.abs(steps - 1.0 / RATE), 90) < 0.5 / RATE


def test_a_device_that_is_unplugged_and_plugged_in_is_found_again(start, connect, read_until):
    emulator = start()
    cell = connect(emulator)
    read_until(cell, bool)
    emulator.unplug()
    with pytest.raises(DeviceError, match=r'has gone|has sent no reading') as error:
        for _ in range(1000):
            cell.read(0.5)
    assert '\n' not in str(error.value)
    cell.close()
    with pytest.raises(DeviceError, match='cannot be opened'):
        connect(emulator)
    emulator.plug_in()
    assert read_until(connect(emulator), lambda samples: len(samples) >= 10)


def test_a_silent_device_is_an_error_of_one_sentence(start, connect, read_until):
    emulator = start()
    cell = connect(emulator)
    read_until(cell, bool)
    emulator.faults.silent = True
    with pytest.raises(DeviceError, match=r'has sent no reading for 0\.2 s'):
        for _ in range(1000):
            cell.read(0.2)
    emulator.faults.silent = False
    assert read_until(cell, bool)


def test_what_is_only_garbage_is_no_reading(start, connect):
    emulator = start(template='no number')
    with pytest.raises(DeviceError, match='has sent no reading'):
        connect(emulator).read(0.3)


def test_a_port_that_is_not_there_is_told(tmp_path):
    with pytest.raises(DeviceError, match='cannot be opened'):
        connect_serial_cell(str(tmp_path / 'ttyNone'))
    with pytest.raises(DeviceError, match='cannot be opened'):
        connect_serial_cell('nonsense://x')
