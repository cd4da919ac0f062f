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


"""``hapticvision import``: measured CSV files become contract bags."""

import argparse
from collections import Counter
from datetime import datetime, UTC
from pathlib import Path
import re
import sys

from hapticvision_ros.bag.csv_import import Column, DEFAULT_HEIGHT, import_csv, UNITS
from hapticvision_ros.core.errors import HapticVisionError, UsageError
from hapticvision_ros.core.units import LARGEST, LENGTH_UNITS, MM

EPILOG = f"""\
A column is known by its name with the unit in it:
  {', '.join(f'{quantity}_<{"|".join(units)}>' for quantity, units in UNITS.items())}
time, force and displacement are needed. Other names are mapped, as in
  hapticvision import zwick.csv --out bags --column time=Zeit:s --column 'force=Kraft [N]:N' \\
    --column 'displacement=Weg:mm'
Force and displacement are positive in compression; a minus before the unit turns the sign of a
column that counts the other way, as in --column 'force=Kraft [N]:-N'. The displacement is the
object's displacement height; without a tool_displacement it is the tool's as well, true while
they touch.
A force_sd goes to the topic /load_cell/force_sd, outside the bag contract.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.epilog = EPILOG
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.add_argument('files', nargs='+', type=Path, metavar='FILE', help='CSV files')
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='where the bags go, one a file'
    )
    parser.add_argument(
        '--column',
        action='append',
        default=[],
        metavar='QUANTITY=NAME:UNIT',
        help='what a column holds, where its name does not tell; can be repeated',
    )
    parser.add_argument(
        '--height',
        metavar='LENGTH',
        help='original height of the object, in metres or with a unit, as in 40mm '
        f'(default: {DEFAULT_HEIGHT / MM:g}mm; it moves all heights alike)',
    )
    parser.add_argument(
        '--start',
        metavar='TIME',
        help="when the file's time zero was, ISO 8601, UTC unless it says otherwise "
        '(default: 2000-01-01, or the times themselves where they count from 1970)',
    )
    parser.add_argument('--force', action='store_true', help='replace a bag that is there already')


def _length(text: str) -> float:
    """Return a length [m] above zero, given in metres or with its unit."""
    match = re.fullmatch(r'(\d+\.?\d*|\.\d+)\s*(\w*)', text.strip())
    unit = match[2] or 'm' if match else ''
    if match is None or unit not in LENGTH_UNITS or float(match[1]) == 0.0:
        raise UsageError(f"--height '{text}' is no height: write it as 0.04 or 40mm.")
    length = float(match[1]) * LENGTH_UNITS[unit]
    if length > LARGEST:
        raise UsageError(f'--height is {length:g} m, which is none: write its unit beside it.')
    return length


def _stamp_ns(text: str) -> int:
    """Return a point of time [ns since the epoch]."""
    try:
        when = datetime.fromisoformat(text)
    except ValueError as error:
        raise UsageError(
            f"--start '{text}' is no time: write it as 2026-05-01T12:00:00."
        ) from error
    if when.tzinfo is None:
        when = when.replace(tzinfo=UTC)
    # Whole microseconds, so that no digit is lost on the way through a float.
    return round(when.timestamp() * 1e6) * 1000


def run(args: argparse.Namespace) -> int:
    """
    Import each file; a bad one is told and does not keep the others from their bags.

    Returns
    -------
    int
        0, or 2 if a file could not be imported.

    Raises
    ------
    UsageError
        If the arguments do not fit together; nothing has been written then.

    """
    choices = [Column.parse(text) for text in args.column]
    for quantity, count in Counter(choice.quantity for choice in choices).items():
        if count > 1:
            raise UsageError(f'--column names {quantity} {count} times; name it once.')
    for stem, count in Counter(path.stem for path in args.files).items():
        if count > 1:
            raise UsageError(
                f"{count} files would become the bag '{stem}': import them into different --out."
            )
    height = None if args.height is None else _length(args.height)
    start_ns = None if args.start is None else _stamp_ns(args.start)
    failed = 0
    for path in args.files:
        try:
            trial = import_csv(
                path,
                args.out,
                choices=choices,
                original_height=height,
                start_ns=start_ns,
                replace=args.force,
            )
        except HapticVisionError as error:
            print(f'hapticvision import: {error}', file=sys.stderr)
            failed += 1
            continue
        for warning in trial.warnings:
            print(f'hapticvision import: warning: {warning}', file=sys.stderr)
        samples = ', '.join(f'{count} of {name}' for name, count in trial.sample_counts.items())
        print(f'{path}: {trial.row_count} rows -> {trial.bag}: {samples}')
    return HapticVisionError.exit_code if failed else 0
