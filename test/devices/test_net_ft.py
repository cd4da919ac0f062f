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

"""The Net F/T back end against an emulated box."""

import socket
import time

from hapticvision_ros.core.errors import DeviceError
from hapticvision_ros.devices import net_ft
from hapticvision_ros.devices.net_ft import connect_net_ft, NetFtSettings, read_settings
from hapticvision_ros.sim.emulators.net_ft import NetFtBox, NetFtEmulator
from hapticvision_ros.sim.emulators.sources import constant
import numpy as np
import pytest

ADDRESS = '127.0.0.1'
LOAD = (1.25, -0.5, -12.75, 0.01, 0.02, -0.03)


@pytest.fixture
def box():
    with NetFtEmulator(constant(LOAD)) as emulator:
        yield emulator


@pytest.fixture
def cell(box):
    opened = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port)
    yield opened
    opened.close()


def test_counts_become_newtons_with_the_scales_of_the_box(cell, box, read_until):
    samples = read_until(cell, lambda samples: len(samples) >= 100)
    for sample in samples:
        # A count is a millionth of a newton.
        assert (*sample.force, *sample.torque) == pytest.approx(LOAD, abs=1e-6)
        assert not sample.saturated and not sample.fault
    assert cell.counts.received == len(samples)
    assert (cell.counts.lost, cell.counts.late, cell.counts.garbled) == (0, 0, 0)


def test_readings_are_stamped_at_the_rate_of_the_box_and_now(cell, read_until):
    samples = read_until(cell, lambda samples: len(samples) >= 300)
    stamps = np.array([sample.stamp_ns for sample in samples]) * 1e-9
    assert abs(time.time() - stamps[-1]) < 0.5
    assert np.all(np.diff(stamps) > 0.0)
    # 500 Hz; the emulator's own thread may be late by some ms, but not on the average.
    assert np.diff(stamps).mean() == pytest.approx(0.002, rel=0.05)


@pytest.mark.parametrize(
    ('unit', 'newton', 'torque_unit', 'newton_metre'),
    [
        ('lbf', 1 / 4.4482216152605, 'lbf-in', 1 / 0.1129848290276167),
        ('kN', 1e-3, 'N-mm', 1e3),
        ('kgf', 1 / 9.80665, 'kgf-cm', 1 / 0.0980665),
    ],
)
def test_the_units_of_the_box_are_converted(unit, newton, torque_unit, newton_metre, read_until):
    setup = NetFtBox(
        force_unit=unit, torque_unit=torque_unit, newton=newton, newton_metre=newton_metre
    )
    with NetFtEmulator(constant(LOAD), setup) as emulator:
        cell = connect_net_ft(ADDRESS, port=emulator.port, http_port=emulator.http_port)
        sample = read_until(cell, bool)[0]
        cell.close()
    # Half a count of the coarsest of these units, a kilonewton, is 0.5 mN.
    assert sample.force == pytest.approx(LOAD[:3], abs=1e-3)
    assert sample.torque == pytest.approx(LOAD[3:], abs=1e-5)


def test_scales_may_be_given_where_the_box_has_no_web_page(box, read_until):
    settings = NetFtSettings(2e6, 1e6, 500.0)
    cell = connect_net_ft(ADDRESS, port=box.port, http_port=1, settings=settings)
    sample = read_until(cell, bool)[0]
    cell.close()
    assert sample.force == pytest.approx(np.array(LOAD[:3]) / 2.0, abs=1e-6)


def test_lost_records_are_counted(cell, box, read_until):
    read_until(cell, bool)
    box.faults.loss = 0.2
    sent = box.sent
    read_until(cell, lambda _: box.sent - sent >= 400)
    box.faults.loss = 0.0
    before = cell.counts.received + cell.counts.lost
    read_until(cell, lambda _: cell.counts.received + cell.counts.lost > before)
    # 400 draws at 20 %: 80 with a standard deviation of 8.
    assert 40 <= cell.counts.lost <= 160
    assert cell.counts.late == cell.counts.restarts == 0


def test_doubled_swapped_and_foreign_datagrams_are_left_out(cell, box, read_until):
    read_until(cell, bool)
    box.faults.doubling = box.faults.swapping = box.faults.garbage = 0.1
    samples = read_until(cell, lambda samples: len(samples) >= 300)
    stamps = np.array([sample.stamp_ns for sample in samples])
    assert np.all(np.diff(stamps) > 0)
    for sample in samples:
        assert sample.force == pytest.approx(LOAD[:3], abs=1e-6)
    counts = cell.counts
    assert counts.late > 0 and counts.garbled > 0 and counts.restarts == 0
    # A record that was overtaken counts as lost, and then as late.
    assert counts.lost > 0


def test_a_network_that_holds_records_up_does_not_bend_the_stamps(cell, box, read_until):
    read_until(cell, lambda samples: len(samples) >= 100)
    box.faults.delay = 0.03
    samples = read_until(cell, lambda samples: len(samples) >= 500)
    steps = np.diff([sample.stamp_ns for sample in samples]) * 1e-6
    # The rate is known; a step that is off shows a delay in the stamps.
    assert np.percentile(np.abs(steps - 2.0), 90) < 0.5
    assert cell.counts.lost == 0


@pytest.mark.parametrize(
    ('product', 'status', 'saturated', 'said'),
    [
        ('net_box', 0x80020000, True, 'transducer saturation'),
        ('net_box', 0x88000000, False, 'serial link communication error'),
        ('net_box', 0x00010000, False, ''),
        ('axia', 0xC0000000, True, 'force or torque out of range'),
        ('axia', 0x88000000, True, 'gage out of range'),
        ('axia', 0x80000004, False, 'broken gage'),
        ('axia', 0x00000000, False, ''),
    ],
)
def test_the_status_code_is_told(box, product, status, saturated, said, read_until):
    box.faults.status = status
    cell = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port, product=product)
    sample = read_until(cell, bool)[0]
    cell.close()
    assert sample.saturated is saturated
    assert said in sample.fault
    assert bool(sample.fault) is bool(said)


def test_a_silent_box_is_an_error_of_one_sentence(cell, box, read_until):
    read_until(cell, bool)
    box.faults.silent = True

    with pytest.raises(DeviceError, match=r'has sent no record for 0\.2 s') as error:
        # What is still in the queue comes first.
        for _ in range(100):
            cell.read(0.2)
    assert '\n' not in str(error.value)


def test_a_box_that_was_switched_off_and_on_sends_again_when_asked(box, read_until):
    cell = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port)
    read_until(cell, bool)
    box.restart()
    with pytest.raises(DeviceError, match='has sent no record'):
        for _ in range(100):
            cell.read(0.2)
    cell.close()
    again = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port)
    assert read_until(again, lambda samples: len(samples) >= 10)
    assert again.counts.lost == 0
    again.close()


def test_a_second_program_that_takes_the_stream_leaves_the_first_silent(cell, box, read_until):
    read_until(cell, bool)
    thief = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port)
    with pytest.raises(DeviceError, match='no other program reads it'):
        for _ in range(100):
            cell.read(0.2)
    thief.close()


def test_closing_stops_the_stream(box, read_until):
    cell = connect_net_ft(ADDRESS, port=box.port, http_port=box.http_port)
    read_until(cell, bool)
    cell.close()
    cell.close()
    deadline = time.monotonic() + 5.0
    while box._client is not None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    with pytest.raises(DeviceError, match='has been closed'):
        cell.read(0.1)


def test_where_no_box_is_it_says_so(monkeypatch):
    monkeypatch.setattr(net_ft, 'CONNECT_TIMEOUT', 0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as deaf:
        deaf.bind((ADDRESS, 0))
        settings = NetFtSettings(1e6, 1e6, 500.0)
        with pytest.raises(DeviceError, match='does not answer: see to its power'):
            connect_net_ft(ADDRESS, port=deaf.getsockname()[1], settings=settings)
    with pytest.raises(DeviceError, match='gives no configuration'):
        connect_net_ft(ADDRESS, http_port=1)
    with pytest.raises(DeviceError, match='cannot be reached'):
        connect_net_ft('no.such.host.invalid', settings=settings)


def test_rdt_that_is_switched_off_is_told():
    with (
        NetFtEmulator(box=NetFtBox(rdt=False)) as emulator,
        pytest.raises(DeviceError, match='RDT is switched off'),
    ):
        read_settings(ADDRESS, emulator.http_port)


@pytest.mark.parametrize(
    ('page', 'sentence'),
    [
        (b'<html><body>router</body>', 'is no configuration of a Net F/T box'),
        (b'<netft/>', 'no positive number cfgcpf'),
        (b'<netft><cfgcpf>0</cfgcpf></netft>', 'no positive number cfgcpf'),
        (b'<netft><cfgcpf>x</cfgcpf></netft>', 'no positive number cfgcpf'),
        (b'<netft><cfgcpf>1</cfgcpf></netft>', 'gives scfgfu as'),
        (
            b'<netft><cfgcpf>1</cfgcpf><scfgfu>stone</scfgfu></netft>',
            "'stone', which is no known unit",
        ),
    ],
)
def test_a_page_that_is_no_configuration_is_told(monkeypatch, page, sentence):
    monkeypatch.setattr(NetFtBox, 'page', lambda self: page)
    with (
        NetFtEmulator() as emulator,
        pytest.raises(DeviceError, match=sentence) as error,
    ):
        read_settings(ADDRESS, emulator.http_port)
    assert '\n' not in str(error.value)
