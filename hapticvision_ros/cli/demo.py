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
``hapticvision demo``: the main job in one go, on a simulated cell and on real data.

It starts the cell, runs a small experiment, fits the bags that were just recorded, and fits
measured data, with the functions of the verbs ``cell``, ``import`` and ``fit``.
"""

import argparse
from collections.abc import Sequence
from datetime import datetime
import os
from pathlib import Path
import random
import shutil
import time
from typing import Any, Final, TYPE_CHECKING

from hapticvision_ros.cli import cell
from hapticvision_ros.cli.configuration import write_config
from hapticvision_ros.cli.fit import check_fitted, fit_bags, print_tables, write_results
from hapticvision_ros.core.errors import HapticVisionError, InputError
from hapticvision_ros.share import share_folder

if TYPE_CHECKING:
    from hapticvision_ros.core.composition import Model

SILICONE_VARIABLE: Final = 'HAPTICVISION_SILICONE'
SILICONE_FOLDER: Final = Path('data', 'silicone_indentation')
SHIPPED_FOLDER: Final = Path('bags', 'muscle_ramp_hold')
OBJECT: Final = 'soft_dough'
# Two speeds by two depths; the object relaxes with two seconds and recovers with less than one.
EXPERIMENT: Final = (
    *('--speeds', '0.004', '0.008'),
    *('--depths', '0.005', '0.008'),
    *('--repeats', '1'),
    *('--hold-time', '6'),
    *('--recover-time', '3'),
    *('--rest-time', '0.2'),
)
OWN_PARAMETERS: Final[dict[str, dict[str, Any]]] = {
    # A demo need not fill a gigabyte of disk.
    'range_sensor_driver.yaml': {'width': 160, 'height': 120},
    # Nothing is there to be hurt, and the machine may have other work to do.
    'arm_push_controller.yaml': {'stale_time': 1.0, 'approach_speed': 0.02},
}
"""Where the demo differs from the package's own configuration."""
INTERRUPTED: Final = 130
LARGEST_DOMAIN: Final = 101
"""The ports of larger ROS domains may collide with the system's own."""
ENOUGH_TO_HOLD_OUT: Final = 3
RUN: Final = '%Y%m%d-%H%M%S'
"""Name of a run's folder: when it began."""
RUNS_KEPT: Final = 3
"""Runs whose folders are kept, the newest among them: each has some 150 MB of clouds."""


class DemoError(HapticVisionError):
    """The experiment of the demo has failed."""

    exit_code = 1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        '--out',
        type=Path,
        default=Path('out', 'demo'),
        metavar='DIR',
        help=f'where each run makes a folder of its own (default: out/demo); the last {RUNS_KEPT} '
        'that came to an end are kept, others are deleted',
    )
    parser.add_argument(
        '--silicone',
        type=Path,
        metavar='DIR',
        help='folder with CSV files of the silicone indentation, which this package may not ship '
        f'(default: ${SILICONE_VARIABLE}, else {SILICONE_FOLDER} of the checkout, else the '
        f'shipped {SHIPPED_FOLDER})',
    )
    parser.add_argument(
        '--domain', type=int, metavar='ID', help='ROS domain of the cell (default: by chance)'
    )


def run(args: argparse.Namespace) -> int:
    """Run the demo and return the exit code."""
    began = time.monotonic()
    # As in the verb fit: threads inside each small product would only get into each other's way.
    for variable in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'):
        os.environ.setdefault(variable, '1')
    measured = _silicone_csv(args.silicone)
    _delete_old_runs(args.out)
    out = args.out / datetime.now().astimezone().strftime(RUN)
    code = _experiment(out, args.domain)
    if code == INTERRUPTED:
        return code
    if code:
        raise DemoError(
            'the experiment did not succeed, for the reason that the last lines above give; its '
            f'bags so far are in {out / "bags"}.'
        )
    recorded = sorted(
        path.parent
        for path in (out / 'bags').glob('trial_*/metadata.yaml')
        if not path.parent.name.endswith(('_aborted', '_incomplete'))
    )
    if not recorded:
        raise DemoError(
            f'no trial in {out / "bags"} is complete, so there is nothing to fit: see the '
            'messages of the nodes above, and try again on an idle machine.'
        )
    from hapticvision_ros.core.composition import Model

    written = _fit(f'The {len(recorded)} trials just recorded', recorded, out / 'recorded')
    title, bags = _measured_bags(measured, out / 'measured')
    if bags:
        written += _fit(title, bags, out / 'measured', Model())
    print(
        '\nThe three-element model is not the whole truth about these objects: the lines above '
        'say how far it misses\neach. What it lacks was looked for in the recorded trials; for '
        'the measured ones that takes longer:\n'
        f'  hapticvision fit {" ".join(map(str, bags))} --out {out / "closed"}\n'
    )
    print(f'Done in {time.monotonic() - began:.0f} s. Open the reports in a browser:')
    for path in written:
        print(f'  {path}')
    return 0


def _delete_old_runs(folder: Path) -> None:
    """Delete the folders of all runs but the last ones, to which another is about to come."""
    runs = sorted(path for path in folder.glob('*') if _is_run(path))
    # One that was interrupted takes no place of one that came to an end.
    ended = [path for path in runs if (path / 'recorded' / 'result.json').is_file()]
    beside_another = 1 - RUNS_KEPT
    kept = {*ended[beside_another:], *runs[-1:]}
    for path in sorted({*runs} - kept):
        shutil.rmtree(path, ignore_errors=True)
        print(f'Deleted the old run {path}: the last {RUNS_KEPT} are kept.', flush=True)


def _is_run(path: Path) -> bool:
    """Return whether a folder has been made by a run of the demo."""
    try:
        datetime.strptime(path.name, RUN)
    except ValueError:
        return False
    return not path.is_symlink() and all((path / 'config' / n).is_file() for n in OWN_PARAMETERS)


def _experiment(out: Path, domain: int | None) -> int:
    """Run the cell for one small experiment and return the client's exit code."""
    write_config(out / 'config', OWN_PARAMETERS)
    if domain is None:
        domain = random.randint(1, LARGEST_DOMAIN)
    os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
    print(
        f'Starting the simulated cell: seven nodes on this machine alone, in ROS domain {domain}, '
        'clear of other cells.\nThe experiment takes about a minute; Ctrl-C stops everything.\n',
        flush=True,
    )
    parser = argparse.ArgumentParser()
    cell.add_arguments(parser)
    options = ['--run', '--object', OBJECT, '--domain', str(domain)]
    folders = ['--config', str(out / 'config'), '--out', str(out / 'bags')]
    return cell.run(parser.parse_args([*options, *folders, *EXPERIMENT]))


def _silicone_csv(folder: Path | None) -> Path | None:
    """
    Return a silicone trial to import, or None if nobody has put that folder there.

    Raises
    ------
    InputError
        If a folder was named that holds no CSV file.

    """
    named = os.environ.get(SILICONE_VARIABLE)
    if folder is None and named:
        folder = Path(named)
    if folder is None:
        folder = share_folder() / SILICONE_FOLDER
        if not folder.is_dir():
            return None
    # A trial with a release first: it tells more.
    files = [*sorted(folder.glob('push_hold_release_*.csv')), *sorted(folder.glob('*.csv'))]
    if not files:
        raise InputError(
            f'{folder} holds no CSV file of the silicone indentation: name the folder that does '
            f'with --silicone or ${SILICONE_VARIABLE}, or none.'
        )
    return files[0]


def _measured_bags(csv: Path | None, out: Path) -> tuple[str, list[Path]]:
    """Return a title and the bags of real data: the imported silicone trial, else the shipped."""
    if csv is not None:
        from hapticvision_ros.bag.csv_import import import_csv

        imported = import_csv(csv, out / 'bags')
        print(f'\nImported {csv} ({imported.row_count} rows) as {imported.bag}.')
        for warning in imported.warnings:
            print(f'  {warning}')
        return 'A real silicone phantom', [imported.bag]
    folder = share_folder() / SHIPPED_FOLDER
    bags = sorted(path.parent for path in folder.glob('*/metadata.yaml'))
    if bags:
        print('\nThe silicone data are not here (bags/README.md says how to get them).')
    else:
        print(f'\nNo real data: this installation has neither {SILICONE_FOLDER} nor {folder}.')
    return 'Real muscle fibres, as shipped', bags


def _fit(title: str, bags: Sequence[Path], out: Path, model: 'Model | None' = None) -> list[Path]:
    """Fit bags as the verb fit does, the last of several held out; return what was written."""
    from hapticvision_ros.report.quantities import SI_UNITS

    kept = len(bags) - 1 if len(bags) >= ENOUGH_TO_HOLD_OUT else len(bags)
    fitted, held_out = bags[:kept], bags[kept:]
    heading = f'{title}, {held_out[0].name} held out of the fit' if held_out else title
    print(f'\n{heading}\n{"=" * len(heading)}\n')
    campaign = fit_bags(fitted, held_out, model)
    result, report = write_results(out, campaign, fitted, held_out, SI_UNITS)
    print_tables(campaign, SI_UNITS)
    check_fitted(campaign)
    return [report, result]
