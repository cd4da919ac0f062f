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

"""``hapticvision faults``: what happens to a cell when something goes wrong, as a table."""

import argparse
from datetime import datetime
from pathlib import Path
import random
from typing import Any, Final

from hapticvision_ros.cli.cell import (
    ARM,
    CLIENT_GRACE,
    node_command,
    NODES,
    ORCHESTRATOR,
    start_world,
    WORLD_CONFIG,
)
from hapticvision_ros.cli.configuration import write_config
from hapticvision_ros.cli.processes import program, ros_environment, Supervisor
from hapticvision_ros.cli.replay import check_domain
from hapticvision_ros.core.errors import HapticVisionError, UsageError

CLIENT: Final = 'fault_campaign'
LARGEST_DOMAIN: Final = 101
RESTARTS: Final = 100
LEFT_OUT: Final = "The faults of the machine's clock are left out"
FORCE_LIMIT: Final = 20.0
"""A push into the soft dough takes half of it [N]."""
START_HEIGHT: Final = 0.052
WATCHDOG: Final = 0.05
"""A controller that is gone or held up is without command for so long [s]."""
QUICK: Final[dict[str, dict[str, Any]]] = {
    'range_sensor_driver.yaml': {'width': 160, 'height': 120},
    f'{ARM}.yaml': {
        'push_speed': 0.003,
        'approach_speed': 0.03,
        'release_speed': 0.02,
        'clearance': 0.008,
        'retract_height': 0.050,
        'zero_time': 0.1,
        'max_force': FORCE_LIMIT,
        'stale_time': 0.3,
        'frozen_time': 0.3,
        'heartbeat_time': 0.7,
    },
    f'{ORCHESTRATOR}.yaml': {
        'speeds': [0.003],
        'depths': [0.006],
        'hold_time': 0.6,
        'recover_time': 0.4,
        'rest_time': 0.0,
        'service_deadline': 20.0,
        'approach_deadline': 8.0,
        'push_margin': 5.0,
        'stream_deadline': 0.8,
        'cloud_deadline': 1.0,
        'retry_period': 0.1,
        'feedback_period': 0.5,
        'least_room': 0,
    },
    WORLD_CONFIG: {
        'arm': {'start_height': START_HEIGHT, 'watchdog': WATCHDOG},
        # 2.5 times the soft dough: a push that nobody stops is a quarter over the limit.
        'objects': {
            'hard_dough': {
                'elastic_stiffness': 5000.0,
                'retardation_viscosity': 4000.0,
                'flow_viscosity': 6000.0,
                'yield_force': 15.0,
            }
        },
    },
}
"""Pushes of about four seconds, and deadlines to match."""
RATES: Final = ('--force-rate', '500', '--arm-rate', '250', '--range-rate', '10')


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('out', 'faults'),
        metavar='DIR',
        help='where each run makes a folder of its own for its bags (default: out/faults)',
    )
    parser.add_argument(
        '--page', type=Path, metavar='FILE', help='where the table goes (default: into the folder)'
    )
    parser.add_argument(
        '--only',
        nargs='+',
        metavar='TEXT',
        default=[],
        help='only the faults whose line in --list contains one of these texts',
    )
    parser.add_argument('--list', action='store_true', help='show the table without running it')
    parser.add_argument(
        '--domain', type=int, metavar='ID', help='ROS domain of the cell (default: by chance)'
    )


def run(args: argparse.Namespace) -> int:
    """Run the campaign and return the exit code: 0 if all faults are safe."""
    from hapticvision_ros.core.faults import table
    from hapticvision_ros.sim.settable_clock import clock_environment

    chosen = [
        fault
        for fault in table()
        if not args.only or any(text in fault.line for text in args.only)
    ]
    if not chosen:
        raise UsageError(f'--only {" ".join(args.only)} fits no fault: see --list.')
    if args.list:
        print('\n'.join(fault.line for fault in chosen))
        return 0
    check_domain(args.domain)
    domain = random.randint(1, LARGEST_DOMAIN) if args.domain is None else args.domain
    out = args.out / datetime.now().astimezone().strftime('%Y%m%d-%H%M%S')
    environment = ros_environment(domain)
    environment['OMP_NUM_THREADS'] = '1'
    if any(fault.action == 'clock' for fault in chosen):
        try:
            environment |= clock_environment(out / 'clock')
        except HapticVisionError as error:
            if all(fault.action == 'clock' for fault in chosen):
                raise
            print(f'{LEFT_OUT}: {error}', flush=True)
    config = out / 'config'
    write_config(config, QUICK)
    page = args.page or out / 'faults.md'
    with Supervisor(environment) as supervisor:
        options = ('--object', 'soft_dough', '--config', str(config / WORLD_CONFIG), *RATES)
        port = start_world(supervisor, 'hapticvision_ros.sim.faults', *options)
        nodes = {name: node_command(name, port, config) for name in NODES}
        supervisor.start(nodes, restarts=RESTARTS)
        command = program(
            f'hapticvision_ros.nodes.{CLIENT}',
            *('--port', str(port), '--out', str(out), '--page', str(page)),
            *('--force-limit', str(FORCE_LIMIT), '--only', *args.only),
        )
        supervisor.start({CLIENT: command}, labelled=False, grace=CLIENT_GRACE)
        return supervisor.wait(CLIENT)
