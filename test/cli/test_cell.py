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

"""The verb `cell`: what it refuses, and that it starts and stops the whole cell."""

import json
import math
import os
from pathlib import Path
import signal
import socket
import subprocess
import sys
import threading
import time

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.cli.cell import NODES
from hapticvision_ros.cli.configuration import write_config
from hapticvision_ros.cli.main import main
from hapticvision_ros.core.records import Signal
import numpy as np
import pytest
import yaml

CONFIG = Path(__file__).resolve().parents[2] / 'config'
HAPTICVISION = str(Path(sys.executable).with_name('hapticvision'))
DEADLINE = 90.0
"""Eight processes start and stop on a machine that may have two processors [s]."""
STEADY = 0.1
"""Longest time without a height of a tool on its way below the top, of 0.01 s [s]."""
LATE = 0.05
"""Longest time for which the arm goes on beyond a height, where none is held up [s]."""
IN_TIME = 0.02
"""Longest time by which some heights of a push come later than others [s]."""
SPEED = 0.005
"""Of that push [m/s]."""
ATTEMPTS = 8
"""How often a trial is recorded until nothing stood still while the tool was on its way there."""
TOP = 0.02
"""Height of the block [m]."""


@pytest.fixture
def domain():
    """Give a ROS domain that no other test run uses."""
    for number in range(1, 100):
        with socket.socket() as lock:
            try:
                lock.bind(('127.0.0.1', 61000 + number))
            except OSError:
                continue
            yield number
            return
    pytest.fail('all ROS domains are taken by other test runs')


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['--speeds', '0.004'], 'add --run'),
        (['--run'], '--run needs --out'),
        (['--domain', '233'], 'a ROS domain lies in 0 to 232'),
        (['--config', '/nowhere'], 'is no folder'),
        (['--object', 'granite'], 'granite'),
        (['--run', '--out', 'x', '--speeds', '0.004', '5'], 'The push_speed is 5000 mm/s'),
        (['--run', '--out', 'x', '--speeds', 'nan'], 'speeds'),
        (['--run', '--out', 'x', '--depths', '0.1'], 'The depth is 100 mm'),
        (['--run', '--out', 'x', '--depths', '-0.005'], 'depths'),
        (['--run', '--out', 'x', '--repeats', '0'], 'repeats is 0'),
        (['--run', '--out', 'x', '--hold-time', '-1'], 'hold_time'),
        (['--run', '--out', 'x', '--hold-time', '1e5'], 'the cell allows 3600 s'),
        (['--run', '--out', 'x', '--autonomous', '--budget-trials', '0'], 'budget_trials is 0'),
        (['--run', '--out', 'x', '--autonomous', '--precision', 'nan'], 'precision is nan'),
        (['--run', '--out', 'x', '--precision', '0.1'], 'add --autonomous'),
    ],
)
def test_what_cannot_work_is_refused_before_anything_starts(arguments, says, capsys):
    assert main(['cell', *arguments]) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1, 'one sentence'


def test_a_folder_that_cannot_be_one_is_told_before_anything_starts(tmp_path, capsys):
    (tmp_path / 'bags').write_text('')
    goal = ['--speeds', '0.004', '--depths', '0.005']
    assert main(['cell', '--run', '--out', str(tmp_path / 'bags'), *goal]) == 2
    told = capsys.readouterr()
    assert told.err.startswith('hapticvision: --out ')
    assert told.err.count('\n') == 1
    assert not told.out


def test_a_limit_of_the_users_own_is_kept(tmp_path, capsys):
    own = '/**: {ros__parameters: {max_speed: 0.005}}'
    (tmp_path / 'arm_push_controller.yaml').write_text(own)
    run = ['cell', '--run', '--out', 'x', '--config', str(tmp_path), '--speeds', '0.008']
    assert main(run) == 2
    assert 'up to 5 mm/s' in capsys.readouterr().err


def test_a_parameter_file_that_is_none_is_told(tmp_path, capsys):
    (tmp_path / 'arm_push_controller.yaml').write_text('- 1')
    assert main(['cell', '--run', '--out', 'x', '--config', str(tmp_path)]) == 2
    assert 'is no ROS parameter file' in capsys.readouterr().err


def test_a_parameter_file_whose_name_is_misspelt_is_told(tmp_path, capsys):
    own = '/**: {ros__parameters: {max_speed: 0.005}}'
    (tmp_path / 'load_cell_driver.yaml').write_text('/**: {ros__parameters: {}}')
    (tmp_path / 'arm_push_controler.yaml').write_text(own)
    run = ['cell', '--run', '--out', 'x', '--config', str(tmp_path), '--speeds', '0.008']
    assert main(run) == 2
    assert 'arm_push_controler.yaml is read by no node' in capsys.readouterr().err
    # Beside the one that is meant it may be an older one.
    (tmp_path / 'arm_push_controller.yaml').write_text(own)
    assert main(run) == 2
    assert 'up to 5 mm/s' in capsys.readouterr().err


def test_a_parameter_whose_name_is_misspelt_is_told(tmp_path, capsys):
    (tmp_path / 'range_sensor_driver.yaml').write_text('/**: {ros__parameters: {widht: 100}}')
    assert main(['cell', '--config', str(tmp_path)]) == 2
    said = "range_sensor_driver.yaml: no parameter is called 'widht': write width."
    assert said in capsys.readouterr().err
    # Also in a namespace, and not of another node.
    own = '/**: {range_sensor_driver: {ros__parameters: {widht: 1}}, other: {ros__parameters: {}}}'
    (tmp_path / 'range_sensor_driver.yaml').write_text(own)
    assert main(['cell', '--config', str(tmp_path)]) == 2
    assert said in capsys.readouterr().err
    own = own.replace('range_sensor_driver', 'another')
    (tmp_path / 'range_sensor_driver.yaml').write_text(own)
    assert main(['cell', '--config', str(tmp_path), '--object', 'none']) == 2
    assert 'widht' not in capsys.readouterr().err


def running(parent: int) -> list[int]:
    """Return the processes that the kernel ends with `parent`, from their command lines."""
    found = []
    for entry in Path('/proc').iterdir():
        try:
            command = (entry / 'cmdline').read_bytes()
        except (OSError, NotADirectoryError):
            continue
        if entry.name.isdigit() and f'end_with({parent})'.encode() in command:
            found.append(int(entry.name))
    return found


def test_a_cell_that_is_killed_leaves_no_process(domain):
    # What Ctrl-C does the demo's tests see.
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain), 'OMP_NUM_THREADS': '1'}
    with subprocess.Popen(
        [HAPTICVISION, 'cell'],
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    ) as process:
        assert process.stdout is not None
        end = time.monotonic() + DEADLINE
        impatience = threading.Timer(DEADLINE, process.kill)
        impatience.start()
        said = []
        for line in process.stdout:
            said.append(line)
            if line.endswith('ready for an experiment\n'):
                break
        impatience.cancel()
        assert said and said[-1].startswith('[experiment_orchestrator] '), said
        assert len(running(process.pid)) == 1 + len(NODES)
        process.kill()
        code = process.wait(DEADLINE)
        while running(process.pid):
            assert time.monotonic() < end + DEADLINE, 'processes are left over'
            time.sleep(0.1)
    assert code == -signal.SIGKILL


def longest_gap(heights: Signal) -> float:
    """Return the longest time without a height while the tool was on its way below the top [s]."""
    value = heights.value
    below = np.minimum(value[1:], value[:-1]) < TOP
    return float(np.diff(heights.t)[below & (np.abs(np.diff(value)) > 1e-5)].max())


def latest(heights: Signal) -> float:
    """Return by how much some heights of the push into the block come later than others [s]."""
    value = heights.value
    way = np.flatnonzero(value[: int(np.argmin(value))] < TOP)
    way = way[value[way] > value.min() + 5e-5]
    return float(np.ptp(heights.t[way] + value[way] / SPEED)) if way.size else math.inf


def steadily_recorded(run: list[str], environment: dict, folder: Path) -> tuple[Path, Signal]:
    """
    Record one trial in which the arm was heard wherever it pressed; return its bag and its way.

    On a machine with other work the world stands still now and then, so that the arm is stopped
    late and nobody knows how, or is late with its heights, which have the time at which they came:
    what is fitted to such a bag is warned of, and is off. A tool that rests, or is away from the
    block, tells no less for that.
    """
    seen = []
    for attempt in range(ATTEMPTS):
        bags = folder / f'bags_{attempt}'
        done = subprocess.run(
            [*run, '--out', str(bags)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=DEADLINE,
            check=False,
        )
        if done.returncode:
            assert 'stale' in done.stdout, done.stdout + done.stderr
            seen.append('an aborted push')
            continue
        (bag,) = bags.iterdir()
        heights = read_trial(bag).tool_height
        gap, late = longest_gap(heights), latest(heights)
        seen.append(f'{gap:.3f} s without a height, some {late:.3f} s late')
        if gap < STEADY and late < IN_TIME:
            return bag, heights
    pytest.fail(f'the machine is too busy for a cell: {", ".join(seen)}')


def test_a_running_cell_tells_its_body_and_its_shape_by_messages_alone(domain, tmp_path):
    # The world's body is explicit and in a process of its own; what is fitted and simulated has
    # the bag that the cell recorded, and the size of the block.
    config = tmp_path / 'config'
    config.mkdir()
    world = yaml.safe_load((CONFIG / 'sim_world.yaml').read_text())
    world['block'] |= {'length': 0.06, 'width': 0.04, 'height': TOP, 'rim_width': 0.004}
    world['arm'] |= {'tool_radius': 0.008, 'start_height': 0.042, 'state_rate': 100.0}
    world['load_cell']['rate'] = 250.0
    world['range_sensor'] |= {'rate': 5.0, 'field_of_view': 0.21, 'table_size': 0.1}
    world['objects']['rubber'] = {
        'elastic_stiffness': 2000.0,
        'retardation_viscosity': 1600.0,
        'flow_viscosity': 2400.0,
    }
    world['soft_body'] = {'pitch': 0.005, 'step': 5e-4, 'volume_ratio': 1.0}
    (config / 'sim_world.yaml').write_text(yaml.safe_dump(world))
    for node, parameters in {
        'range_sensor_driver': {'width': 96, 'height': 72},
        'load_cell_driver': {'rate': 250.0},
        # Wide: a machine with other work is late now and then, and nobody is at risk here.
        'arm_push_controller': {
            'approach_speed': 0.02,
            'stale_time': 1.0,
            'tool_height_rate': 100.0,
        },
    }.items():
        text = yaml.safe_dump({'/**': {'ros__parameters': parameters}})
        (config / f'{node}.yaml').write_text(text)
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain), 'OMP_NUM_THREADS': '1'}
    run = [HAPTICVISION, 'cell', '--run', '--config', str(config), '--object', 'rubber']
    run += ['--speeds', str(SPEED), '--depths', '0.003', '--hold-time', '4', '--recover-time', '3']
    bag, heights = steadily_recorded(run, environment, tmp_path)
    fit = ['fit', str(bag), '--model', 'three-element', '--out', str(tmp_path / 'fit')]
    assert main(fit) == 0
    result = tmp_path / 'fit' / 'result.json'
    told = json.loads(result.read_text())['before']['parameters']
    # What the same body gives offline, by the mean of three seeds; a hold of 2 s leaves K1 open
    # by a quarter there. A slight push meets its 2000, 1600 and 2400; 15 % of the height is none,
    # and springs keep the volume.
    for name, value in (('K1', 1501.0), ('C1', 1315.0), ('C2', 3051.0)):
        # A record of a busy machine leaves more open, and says so.
        unsure = 0.1 * value + 2.0 * told[name]['std']
        assert told[name]['value'] == pytest.approx(value, abs=unsure)
    shape = ['shape', str(result), str(bag), '--tool-radius', '8mm', '--size', '60x40x20mm']
    shape += ['--cell', '4mm', '--volume-ratio', '1', '--out', str(tmp_path / 'shape')]
    assert main(shape) == 0
    told = json.loads((tmp_path / 'shape' / 'shape.json').read_text())
    assert told['contact']['source'] == 'tool'
    residual, bouncing, bulge = (told[f'{name}_m'] for name in ('residual', 'bouncing', 'bulge'))
    assert 0.0015 < residual['measured'] < 0.0027
    # The controller stops the arm ahead of the depth, by as much as it goes on as a rule. Where a
    # height is late it goes further, and where it stops sooner than the rule less far.
    deepest = TOP - heights.value.min()
    late = max(longest_gap(heights), LATE)
    usual = yaml.safe_load((CONFIG / 'arm_push_controller.yaml').read_text())
    lead = usual['/**']['ros__parameters']['stop_lead']
    assert 0.003 - SPEED * lead < deepest < 0.003 + SPEED * late
    assert residual['measured'] + bouncing['measured'] == pytest.approx(deepest, abs=5e-5)
    assert residual['simulated'] == pytest.approx(residual['measured'], abs=1.5e-4)
    assert bouncing['simulated'] == pytest.approx(bouncing['measured'], abs=1.5e-4)
    assert bulge['measured'] > 1e-4, 'of ten standard errors'
    assert bulge['simulated'] == pytest.approx(bulge['measured'], abs=8e-5)


def test_a_running_cell_decides_for_a_yield_force_that_nobody_told(domain, tmp_path):
    # One push; what the grid alone makes of it differs from run to run (doc/autonomous.md).
    config = tmp_path / 'config'
    material = {
        'elastic_stiffness': 1000.0,
        'retardation_viscosity': 900.0,
        'flow_viscosity': 1600.0,
        'yield_force': 0.12,
    }
    world = {
        'arm': {'state_rate': 100.0},
        'load_cell': {'rate': 100.0},
        'range_sensor': {'rate': 5.0},
        'objects': {'gel': material},
    }
    arm = {'approach_speed': 0.02, 'stale_time': 1.0, 'tool_height_rate': 100.0}
    nodes = {
        'range_sensor_driver': {'width': 160, 'height': 120},
        'load_cell_driver': {'rate': 100.0},
        'arm_push_controller': arm,
    }
    files = {f'{name}.yaml': values for name, values in nodes.items()}
    write_config(config, files | {'sim_world.yaml': world})
    environment = os.environ | {'ROS_DOMAIN_ID': str(domain), 'OMP_NUM_THREADS': '1'}
    bags = tmp_path / 'bags'
    run = [HAPTICVISION, 'cell', '--run', '--config', str(config), '--object', 'gel']
    run += ['--speeds', '0.004', '--depths', '0.006', '--hold-time', '2', '--recover-time', '2']
    run += ['--rest-time', '0.1', '--autonomous', '--budget-trials', '6', '--out', str(bags)]
    # On a busy machine a push and a look at it take half a minute, and six may be made.
    done = subprocess.run(
        run, env=environment, capture_output=True, text=True, timeout=4 * DEADLINE, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    looks = json.loads((bags / 'autonomous.json').read_text())
    assert len(looks) > 1, 'one push decides nothing'
    assert looks[-1]['ending'] == 'decided'
    assert looks[-1]['found']['sets'] == [['yield_force']]
    told = looks[-1]['found']['parameters']['F_y']
    # The worst of nine runs was 4 % off, of 2.5 % by its own error.
    assert told['value'] == pytest.approx(0.12, rel=0.15)
