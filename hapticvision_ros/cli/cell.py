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

"""``hapticvision cell``: the seven nodes and the simulated cell, where there is no ros2 launch."""

import argparse
from dataclasses import fields
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Final, TYPE_CHECKING

from hapticvision_ros.cli.command import check_out
from hapticvision_ros.cli.processes import node, program, ros_environment, Supervisor
from hapticvision_ros.cli.replay import check_domain
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.share import share_folder

if TYPE_CHECKING:
    from hapticvision_ros.sim.config import WorldConfig

ARM: Final = 'arm_push_controller'
ORCHESTRATOR: Final = 'experiment_orchestrator'
NODES: Final = (
    'range_sensor_driver',
    'load_cell_driver',
    ARM,
    'contact_point_planner',
    'phase_segmenter',
    'rheology_fitter',
    ORCHESTRATOR,
)
WORLD: Final = 'simulated_world'
WORLD_MODULE: Final = 'hapticvision_ros.sim.server'
CLIENT: Final = 'experiment_client'
WORLD_CONFIG: Final = 'sim_world.yaml'
NEEDS_WORLD: Final = ('range_sensor_driver', 'load_cell_driver', ARM, ORCHESTRATOR)
WORLD_DEADLINE: Final = 30.0
CLIENT_GRACE: Final = 45.0
"""How long the client may take to cancel: the tool has to retract [s]."""
BUDGET_OPTIONS: Final = ('budget_trials', 'budget_time', 'precision')
GOAL_OPTIONS: Final = (
    'speeds',
    'depths',
    'repeats',
    'hold_time',
    'hold_mode',
    'recover_time',
    'rest_time',
    'autonomous',
    *BUDGET_OPTIONS,
)
MISSPELT: Final = 0.8
"""Likeness from which on the name of a file or parameter is taken for a known one."""
RESTARTS: Final = 5
"""How often a node of the cell is started again when it has died."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        '--object', default='soft_dough', help='the simulated object (default: soft_dough)'
    )
    parser.add_argument(
        '--config',
        type=Path,
        metavar='DIR',
        help=f'folder with parameter files NODE.yaml and {WORLD_CONFIG} that replace the '
        "package's own; what it lacks stays as it is",
    )
    parser.add_argument('--domain', type=int, metavar='ID', help='ROS domain')
    parser.add_argument(
        '--run',
        action='store_true',
        help='run one experiment, show its progress, and stop; else the nodes run until Ctrl-C',
    )
    goal = parser.add_argument_group(
        'the experiment of --run', 'What is not given stays as config/ has it. SI units.'
    )
    goal.add_argument('--speeds', nargs='+', type=float, metavar='M_S', help='push speeds [m/s]')
    goal.add_argument('--depths', nargs='+', type=float, metavar='M', help='push depths [m]')
    goal.add_argument('--repeats', type=int, help='how often the grid is gone through')
    goal.add_argument('--hold-time', type=float, metavar='S', help='time at the depth [s]')
    goal.add_argument(
        '--hold-mode',
        choices=('fixed', 'auto'),
        help='auto: hold about one relaxation time, estimated meanwhile, at most --hold-time',
    )
    goal.add_argument('--recover-time', type=float, metavar='S', help='time after release [s]')
    goal.add_argument('--rest-time', type=float, metavar='S', help='pause between trials [s]')
    goal.add_argument(
        '--autonomous',
        action=argparse.BooleanOptionalAction,
        help='go on after the grid with the pushes that the analysis of the bags asks for, until '
        'the effect is decided, the parameters are tight enough, or the budget is spent',
    )
    goal.add_argument('--budget-trials', type=int, metavar='N', help='such pushes at most')
    goal.add_argument(
        '--budget-time', type=float, metavar='S', help='time after the grid at most [s]; 0: any'
    )
    goal.add_argument(
        '--precision',
        type=float,
        help='relative standard error that every parameter is to reach; 0: as soon as the effect '
        'is decided',
    )
    goal.add_argument('--out', type=Path, metavar='DIR', help='folder for the bags')


def run(args: argparse.Namespace) -> int:
    """Start the cell and return the exit code."""
    _check(args)
    with Supervisor(ros_environment(args.domain)) as supervisor:
        port = start_world(supervisor, WORLD_MODULE, *_world_options(args))
        nodes = {name: node_command(name, port, args.config) for name in NODES}
        supervisor.start(nodes, restarts=RESTARTS)
        if not args.run:
            return supervisor.wait()
        goal = _goal(args)
        command = program(f'hapticvision_ros.nodes.{CLIENT}', *goal)
        supervisor.start({CLIENT: command}, labelled=False, grace=CLIENT_GRACE)
        return supervisor.wait(CLIENT)


def _check(args: argparse.Namespace) -> None:
    """Refuse what cannot work, before anything is started."""
    check_domain(args.domain)
    given = [name for name in (*GOAL_OPTIONS, 'out') if getattr(args, name) is not None]
    if given and not args.run:
        options = ', '.join('--' + name.replace('_', '-') for name in given)
        raise UsageError(f'{options} belongs to an experiment: add --run.')
    if args.run and args.out is None:
        raise UsageError('--run needs --out DIR, the folder for the bags.')
    if args.run:
        check_out(args.out)
    if args.config is not None:
        known = {f'{name}.yaml' for name in NODES} | {WORLD_CONFIG}
        if not args.config.is_dir():
            raise InputError(f'--config {args.config} is no folder.')
        if not any((args.config / name).is_file() for name in known):
            raise InputError(f'--config {args.config} holds none of {", ".join(sorted(known))}.')
        for path in sorted(args.config.glob('*.y*ml')):
            meant = get_close_matches(path.name, known, n=1, cutoff=MISSPELT)
            if meant and not (args.config / meant[0]).exists():
                raise InputError(
                    f'{path} is read by no node: rename it to {meant[0]}, or move it.'
                )
        for name in NODES:
            _parameters(args.config, name)
    from hapticvision_ros.sim.config import load_config

    world = load_config(_file(args.config, WORLD_CONFIG))
    world.material(args.object)
    if args.run:
        _check_goal(args, world)


def _check_goal(args: argparse.Namespace, world: 'WorldConfig') -> None:
    """Refuse an experiment that the arm would refuse, while nothing runs."""
    from hapticvision_ros.core.autonomy import Budget
    from hapticvision_ros.core.experiment import ExperimentGoal
    from hapticvision_ros.core.push_control import check_goal, PushGoal, PushLimits

    asked = _parameters(args.config, ORCHESTRATOR)
    given = {name: value for name in GOAL_OPTIONS if (value := getattr(args, name)) is not None}
    asked = {name: asked[name] for name in GOAL_OPTIONS} | given
    given_budget = [name for name in BUDGET_OPTIONS if name in given]
    if given_budget and not asked['autonomous']:
        options = ', '.join('--' + name.replace('_', '-') for name in given_budget)
        raise UsageError(f'{options} belongs to an autonomous experiment: add --autonomous.')
    trials, time, precision = (asked.pop(name) for name in BUDGET_OPTIONS)
    budget = Budget(trials, time, precision)
    goal = ExperimentGoal(
        push_speeds=tuple(asked.pop('speeds')),
        depths=tuple(asked.pop('depths')),
        budget=budget if asked.pop('autonomous') else None,
        **asked,
    )
    arm = _parameters(args.config, ARM)
    limits = PushLimits(**{field.name: arm[field.name] for field in fields(PushLimits)})
    usual = {field.name: arm[field.name] for field in fields(PushGoal) if field.name in arm}
    for trial in goal.trials():
        push = PushGoal(
            **usual
            | {
                'push_speed': trial.push_speed,
                'depth': trial.depth,
                'hold_time': trial.hold_time,
                'hold_mode': trial.hold_mode,
                'recover_time': goal.recover_time,
            },
            surface_height=world.block.height,
        )
        check_goal(push, limits, world.arm.start_height)


def _parameters(folder: Path | None, name: str) -> dict[str, Any]:
    """Return the parameters that a node will have; what is of a wrong type is left to the node."""
    import yaml

    values: dict[str, Any] = {}
    usual = share_folder() / 'config' / f'{name}.yaml'
    for path in (usual, _file(folder, f'{name}.yaml')):
        if path is None:
            continue
        try:
            content = dict(yaml.safe_load(path.read_text(encoding='utf-8')))
            own = {k: v for section in _sections(content, name) for k, v in section.items()}
        except (OSError, ValueError, yaml.YAMLError, KeyError, TypeError, AttributeError) as error:
            raise InputError(f'{path} is no ROS parameter file that can be read.') from error
        for key in own if path is not usual else ():
            meant = get_close_matches(str(key), values, n=1, cutoff=MISSPELT)
            if meant and key not in values:
                raise InputError(f"{path}: no parameter is called '{key}': write {meant[0]}.")
        values |= {k: v for k, v in own.items() if isinstance(v, type(values.get(k, v)))}
    return values


def _sections(content: dict[str, Any], name: str) -> list[dict[str, Any]]:
    """Return what a parameter file has for a node, in whatever namespace."""
    found = []
    for key, value in content.items():
        if 'ros__parameters' not in value:
            found += _sections(value, name)
        elif str(key).rpartition('/')[2] in ('**', name):
            found.append(value['ros__parameters'])
    return found


def _file(folder: Path | None, name: str) -> Path | None:
    """Return a file of the user's folder, or None where the package's own is to be used."""
    return folder / name if folder is not None and (folder / name).is_file() else None


def _world_options(args: argparse.Namespace) -> list[str]:
    options = ['--object', args.object]
    config = _file(args.config, WORLD_CONFIG)
    return options if config is None else [*options, '--config', str(config)]


def start_world(supervisor: Supervisor, module: str, *options: str) -> int:
    """Start a simulated world and return its port."""
    supervisor.start({WORLD: program(module, *options)})
    line = supervisor.wait_for_line(WORLD, 'ready ', WORLD_DEADLINE)
    return int(line.split()[1])


def node_command(name: str, port: int, folder: Path | None) -> list[str]:
    """Return the command of a node with its parameters, those of a file in `folder` as well."""
    options = ['--ros-args']
    config = _file(folder, f'{name}.yaml')
    if config is not None:
        options += ['--params-file', str(config)]
    if name in NEEDS_WORLD:
        options += ['-p', f'simulated_world_port:={port}']
    return node(name, *options)


def _goal(args: argparse.Namespace) -> list[str]:
    """Return the arguments of the client."""
    options = ['--output-folder', str(args.out.absolute())]
    for name in GOAL_OPTIONS:
        value = getattr(args, name)
        option = name.replace('_', '-')
        if isinstance(value, bool):
            options.append(f'--{option}' if value else f'--no-{option}')
        elif value is not None:
            values = value if isinstance(value, list) else [value]
            options += [f'--{option}', *map(str, values)]
    return options
