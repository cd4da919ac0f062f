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

"""The load cell driver as a process, on the simulated cell."""

import math
import signal
import subprocess
import sys
import time

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from hapticvision_ros.bag.contract import PHASE, TARE, WRENCH
from hapticvision_ros.nodes.conversions import contact_force, ns_from_stamp, values_from_status
from hapticvision_ros.nodes.diagnostics import DIAGNOSTICS
from hapticvision_ros.sim.emulators.net_ft import NetFtEmulator
from hapticvision_ros.sim.emulators.serial_cell import Firmware, SerialCellEmulator
from hapticvision_ros.sim.emulators.sources import constant
from hapticvision_ros.sim.faults import FaultLink
import numpy as np
import pytest
from std_msgs.msg import String
from std_srvs.srv import Trigger

LOAD = (1.25, -0.5, -12.75, 0.01, 0.02, -0.03)


@pytest.fixture
def driver(start_world, start_node):
    world = start_world('--object', 'spring1')
    return start_node('load_cell_driver', {'simulated_world_port': world.port})


def test_every_reading_is_published_with_the_cells_own_stamp(
    start_world, start_node, probe, until
):
    # Slower than the real thing, so that the driver is tested and not the speed of the listener.
    world = start_world('--object', 'spring1', '--force-rate', '250')
    start_node('load_cell_driver', {'simulated_world_port': world.port})
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 800, 'eight hundred readings')
    stamps = np.array([ns_from_stamp(message.header.stamp) for message in heard[100:800]])
    # The simulated cell samples exactly each 4 ms; a lost reading would be a step of two.
    assert np.all(np.abs(np.diff(stamps) - 4_000_000) <= 1000)
    assert {message.header.frame_id for message in heard} == {'load_cell'}
    assert all(math.isfinite(contact_force(message)) for message in heard)


def test_tare_takes_the_present_load_as_zero(driver, probe, until):
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 500, 'readings before the tare')
    before = np.mean([contact_force(message) for message in heard[-400:]])
    answer = probe.call(TARE, Trigger.Request())
    assert answer.success, answer.message
    seen = len(heard)
    until(lambda: len(heard) >= seen + 1000, 'readings after the tare')
    after = np.mean([contact_force(message) for message in heard[-400:]])
    # The simulated zero is 0.35 N; the mean of 200 readings with 0.02 N white noise and 0.01 N of
    # correlated noise (40 readings long) is good to about 0.005 N.
    assert before == pytest.approx(0.35, abs=0.03)
    assert after == pytest.approx(0.0, abs=0.03)


def test_a_reading_beyond_the_capacity_is_reported(start_world, start_node, until):
    world = start_world('--object', 'spring1')
    node = start_node('load_cell_driver', {'simulated_world_port': world.port, 'capacity': 0.1})
    until(lambda: 'is saturated' in node.output, 'the warning of saturation')


def test_without_a_load_cell_the_driver_ends_with_one_sentence(start_node):
    node = start_node('load_cell_driver', {'simulated_world_port': 1})
    assert node.wait() == 2
    assert 'no simulated world answers' in node.output
    assert 'Traceback' not in node.output


def test_a_load_cell_that_falls_silent_ends_the_driver(start_world, start_node, probe, until):
    world = start_world('--object', 'spring1')
    parameters = {'simulated_world_port': world.port, 'reopen_time': 0.0}
    node = start_node('load_cell_driver', parameters)
    heard = probe.listen(WRENCH)
    until(lambda: heard, 'a reading')
    world.stop()
    assert node.wait() == 2
    assert node.output.startswith('error: the simulated world on UDP port')
    assert len(node.output.splitlines()) == 1


def test_a_load_cell_that_does_not_come_back_ends_the_driver(start_node, probe, until, tmp_path):
    with SerialCellEmulator(tmp_path / 'tty', constant(LOAD)) as device:
        parameters = {
            'backend': 'serial',
            'serial_port': tmp_path / 'tty',
            'rate': 80.0,
            'reopen_time': 0.3,
            'reopen_interval': 0.1,
        }
        node = start_node('load_cell_driver', parameters)
        heard = probe.listen(WRENCH)
        until(lambda: heard, 'a reading')
        device.unplug()
        assert node.wait() == 2
    assert 'it is tried again for 0.3 s' in node.output
    assert 'Traceback' not in node.output


@pytest.mark.parametrize('number', [signal.SIGINT, signal.SIGTERM])
def test_the_driver_stops_cleanly(driver, probe, until, number):
    heard = probe.listen(WRENCH)
    until(lambda: heard, 'a reading')
    assert driver.stop(number) == 0
    assert 'Traceback' not in driver.output


@pytest.mark.parametrize(
    ('parameters', 'sentence'),
    [
        ({'capacity': 0.0}, 'must lie between'),
        ({'capacity': 200}, 'not of type double'),
        ({'backend': 'imaginary'}, 'choose from simulated'),
        ({'backend': 'net_ft'}, 'net_ft_address is empty'),
        ({'backend': 'serial'}, 'serial_port is empty'),
        ({'mounting_rpy': '[0.0]'}, 'give three angles'),
        ({'capacitty': 200.0}, "unknown parameter 'capacitty'"),
    ],
)
def test_a_wrong_parameter_is_refused_with_one_sentence(start_node, parameters, sentence):
    node = start_node('load_cell_driver', parameters)
    assert node.wait() == 2
    assert sentence in node.output
    assert len(node.output.splitlines()) == 1


def test_the_topic_follows_the_namespace(start_world, start_node, probe, until):
    world = start_world('--object', 'spring1')
    start_node('load_cell_driver', {'simulated_world_port': world.port}, '-r', '__ns:=/cell_2')
    until(
        lambda: '/cell_2/load_cell/wrench' in dict(probe.node.get_topic_names_and_types()),
        'the topic in the namespace',
    )


class Status:
    """What a driver has told of itself."""

    def __init__(self, probe, until):
        self._heard = []
        self._until = until
        probe.node.create_subscription(DiagnosticArray, DIAGNOSTICS, self._heard.append, 10)

    def wait(self, name, condition, what):
        """Return the first new status of that name for which a condition holds."""
        seen = len(self._heard)

        def found():
            for array in self._heard[seen:]:
                for status in array.status:
                    if status.name == f'load_cell_driver: {name}' and condition(status):
                        return status
            return None

        return self._until(found, what)


@pytest.fixture
def status(probe, until):
    return Status(probe, until)


def test_a_net_ft_box_from_the_first_record_to_its_restart(start_node, probe, until, status):
    with NetFtEmulator(constant(LOAD)) as box:
        start_node(
            'load_cell_driver',
            {
                'backend': 'net_ft',
                'net_ft_address': '127.0.0.1',
                'net_ft_port': box.port,
                'net_ft_http_port': box.http_port,
                'rate': 500.0,
                'read_timeout': 0.3,
                'reopen_interval': 0.1,
                # Turned by half a turn about x: y and z change their signs.
                'mounting_rpy': '[3.141592653589793, 0.0, 0.0]',
            },
        )
        heard = probe.listen(WRENCH)
        until(lambda: len(heard) >= 50, 'readings')
        force = heard[-1].wrench.force
        assert (force.x, force.y, force.z) == pytest.approx((1.25, 0.5, 12.75), abs=1e-6)

        answer = probe.call(TARE, Trigger.Request())
        assert answer.success, answer.message
        until(lambda: abs(contact_force(heard[-1])) < 1e-6, 'readings less the zero')
        tare = values_from_status(
            status.wait('tare', lambda s: 'was taken' in s.message, 'the tare told')
        )
        assert float(tare['force_z_N']) == pytest.approx(12.75, abs=1e-4)
        good = status.wait('readings', lambda s: s.level == DiagnosticStatus.OK, 'a good state')
        # The emulator shares a processor with the rest of the test.
        assert float(values_from_status(good)['rate_hz']) == pytest.approx(500.0, rel=0.1)

        box.faults.loss = 0.1
        status.wait(
            'device', lambda s: int(values_from_status(s)['lost']) > 10, 'lost records counted'
        )
        box.faults.loss = 0.0

        box.faults.status = 0x80020000
        until(lambda: math.isnan(contact_force(heard[-1])), 'readings that are not numbers')
        bad = status.wait('readings', lambda s: s.level == DiagnosticStatus.ERROR, 'saturation')
        assert 'saturated' in bad.message
        # There is no zero to be taken of this.
        assert not probe.call(TARE, Trigger.Request()).success
        box.faults.status = 0
        until(lambda: math.isfinite(contact_force(heard[-1])), 'numbers again')

        box.restart()
        gone = status.wait('device', lambda s: s.level == DiagnosticStatus.ERROR, 'the loss')
        assert 'has sent no record' in gone.message
        back = status.wait('device', lambda s: s.level == DiagnosticStatus.OK, 'the return')
        assert values_from_status(back)['opened_again'] == '1'
        seen = len(heard)
        until(lambda: len(heard) > seen, 'readings after the restart')
        # The zero is kept.
        assert abs(contact_force(heard[-1])) < 1e-6


def test_a_serial_load_cell_that_is_unplugged_and_plugged_in(
    start_node, probe, until, status, tmp_path
):
    firmware = Firmware(rate=200.0, template='{counter},{raw}', checksum=True)
    with SerialCellEmulator(tmp_path / 'tty', constant(LOAD), firmware) as device:
        start_node(
            'load_cell_driver',
            {
                'backend': 'serial',
                'serial_port': tmp_path / 'tty',
                'serial_newton_per_unit': -1 / 20000.0,
                'serial_zero': 100000.0,
                'serial_counter_field': 0,
                'serial_force_field': 1,
                'serial_checksum': True,
                'rate': 200.0,
                'read_timeout': 0.3,
                'reopen_interval': 0.1,
                'latency': 0.05,
                'filter_delay': 0.02,
            },
        )
        heard = probe.listen(WRENCH)
        until(lambda: len(heard) >= 50, 'readings')
        assert contact_force(heard[-1]) == pytest.approx(12.75, abs=1e-4)
        told = status.wait('readings', lambda s: True, 'a state')
        assert float(values_from_status(told)['filter_delay_s']) == pytest.approx(0.02)

        device.unplug()
        status.wait('device', lambda s: s.level == DiagnosticStatus.ERROR, 'the loss')
        device.plug_in()
        status.wait('device', lambda s: s.level == DiagnosticStatus.OK, 'the return')
        seen = len(heard)
        until(lambda: len(heard) > seen, 'readings after the return')


def test_a_load_that_moves_is_no_zero(driver, probe, until):
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 100, 'readings')
    # The simulated noise is 0.02 N.
    assert all(
        r.successful for r in probe.set_parameters('load_cell_driver', {'tare_spread': 1e-3})
    )
    answer = probe.call(TARE, Trigger.Request())
    assert not answer.success
    assert 'wait until nothing moves' in answer.message


def test_in_a_push_there_is_no_tare(driver, probe, until):
    """It would raise the force limit by the force of the push."""
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 100, 'readings')
    probe.send(PHASE, String(data='hold'))
    until(lambda: 'hold' in probe.call(TARE, Trigger.Request()).message, 'the refusal')
    probe.send(PHASE, String(data='aborted'))
    until(lambda: probe.call(TARE, Trigger.Request()).success, 'the tare')


@pytest.fixture
def faulty_world():
    """Run a simulated world at 250 readings a second that can be told to go wrong."""
    code = 'import sys; from hapticvision_ros.sim.faults import main; sys.exit(main())'
    command = [sys.executable, '-c', code, '--object', 'spring1', '--force-rate', '250']
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        port = int(process.stdout.readline().split()[1])
        link = FaultLink(port)
        yield port, link
        link.close()
        process.terminate()


def test_a_reading_with_a_stamp_far_from_now_is_left_out_and_counted(
    faulty_world, start_node, probe, until, status
):
    port, link = faulty_world
    start_node('load_cell_driver', {'simulated_world_port': port, 'rate': 250.0})
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 50, 'readings')
    link.ask('distort', stream='force', how='garbage')
    told = status.wait('readings', lambda s: 'far off' in s.message, 'the readings left out')
    # Garbage may read as a force beyond the range as well.
    assert told.level in (DiagnosticStatus.WARN, DiagnosticStatus.ERROR)
    assert int(values_from_status(told)['far_off']) > 0
    seen = len(heard)
    link.ask('heal')
    until(lambda: len(heard) >= seen + 50, 'readings again')
    now_ns = time.time_ns()
    # The shipped bound is a day: whatever was published lies within the test.
    assert all(abs(ns_from_stamp(m.header.stamp) - now_ns) < 120e9 for m in heard)


def test_a_rate_that_is_not_the_expected_one_is_told(start_world, start_node, status):
    world = start_world('--object', 'spring1', '--force-rate', '250')
    # Four times as many as come, so that only a machine that is held up for long could hide it;
    # and gaps are allowed, which are told as well.
    start_node(
        'load_cell_driver',
        {'simulated_world_port': world.port, 'rate': 1000.0, 'largest_gap': 1.0},
    )
    told = status.wait('readings', lambda s: 'The rate is' in s.message, 'the rate told')
    assert told.level == DiagnosticStatus.WARN
    assert 'Hz, where 1000 Hz are expected' in told.message
    values = values_from_status(told)
    # The first second is also that in which the stream begins.
    assert 0.0 < float(values['rate_hz']) < 400.0
    assert values['expected_rate_hz'] == '1000'


def test_a_rate_within_its_tolerance_is_no_warning(start_world, start_node, probe, status):
    world = start_world('--object', 'spring1', '--force-rate', '250')
    # Three eighths less than expected.
    start_node(
        'load_cell_driver',
        {
            'simulated_world_port': world.port,
            'rate': 400.0,
            'rate_tolerance': 0.9,
            'largest_gap': 1.0,
        },
    )
    good = status.wait(
        'readings',
        lambda s: s.level == DiagnosticStatus.OK and values_from_status(s)['rate_hz'] != '-',
        'a good state with a rate',
    )
    assert good.message == 'Readings come as expected.'
    # The tolerance may be changed while the driver runs.
    probe.set_parameters('load_cell_driver', {'rate_tolerance': 0.1})
    status.wait('readings', lambda s: 'where 400 Hz are expected' in s.message, 'the warning')


def test_a_tare_after_the_clock_was_set_back_averages_nothing_from_before(
    faulty_world, start_node, probe, until
):
    port, link = faulty_world
    start_node('load_cell_driver', {'simulated_world_port': port, 'tare_time': 0.2})
    heard = probe.listen(WRENCH)
    until(lambda: len(heard) >= 100, 'readings before')
    link.ask('distort', stream='force', how='an hour back')

    def back():
        later = [m for m in heard if ns_from_stamp(m.header.stamp) < time.time_ns() - 3000 * 10**9]
        return len(later) >= 100

    until(back, 'readings after')
    answer = probe.call(TARE, Trigger.Request())
    assert answer.success, answer.message
    # In 0.2 s there are 50 readings; those from before would never have left.
    assert 40 <= int(answer.message.split()[-2]) <= 51, answer.message
