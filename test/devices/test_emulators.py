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

"""The emulators as commands, measuring in a simulated world."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
import subprocess
import sys

from hapticvision_ros.devices.net_ft import connect_net_ft
from hapticvision_ros.devices.serial_cell import connect_serial_cell, LineFormat
from hapticvision_ros.sim.emulators import net_ft, serial_cell
import pytest

BIN = Path(sys.executable).parent


@contextmanager
def _running(*command: str) -> Iterator[list[str]]:
    """Run a command, yield what it says when it is ready, and stop it."""
    with subprocess.Popen(
        [str(BIN / command[0]), *command[1:]], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        yield process.stdout.readline().split()
        process.terminate()
        assert process.wait(10.0) == 0


def test_both_load_cells_read_what_stands_in_the_world(tmp_path, read_until):
    link = tmp_path / 'tty'
    with (
        _running('simulated_world', '--object', 'spring1') as (_, port),
        _running('emulate_net_ft', '--world', port) as (_, udp, http),
        _running('emulate_serial_cell', '--world', port, '--link', str(link)) as _,
    ):
        box = connect_net_ft('127.0.0.1', port=int(udp), http_port=int(http))
        line = LineFormat(newton_per_unit=-1 / 20000.0, zero=100000.0)
        cell = connect_serial_cell(str(link), line_format=line)
        for device in (box, cell):
            samples = read_until(device, lambda samples: len(samples) >= 50)
            mean = -sum(sample.force[2] for sample in samples) / len(samples)
            # The simulated zero is 0.35 N; 50 readings with 0.022 N of correlated noise.
            assert mean == pytest.approx(0.35, abs=0.03)
            device.close()


@pytest.mark.parametrize(
    ('main', 'arguments', 'sentence'),
    [
        (net_ft.main, ['--port', '99999'], 'choose others with --port'),
        (net_ft.main, ['--rate', '0'], '--rate must lie in 1 to 7000'),
        (net_ft.main, ['--world', '1'], 'no simulated world answers'),
        (serial_cell.main, ['--link', '/nowhere/tty'], 'choose another with --link'),
        (serial_cell.main, ['--rate', '0'], '--rate must lie in 1 to 1000'),
        (serial_cell.main, ['--template', '{weight}'], 'holds no {raw}'),
    ],
)
def test_what_cannot_be_done_is_told_in_one_sentence(main, arguments, sentence, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count('\n') == 1
