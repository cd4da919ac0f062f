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
``hapticvision fit``: bags in, parameters, a diagnosis, result.json and a report out.

Every bag is read before anything is written. A bag that cannot be read stops the command: a
result that lacks a trial somebody asked for is worse than none, and all such bags are named at
once so that one correction does.
"""

import argparse
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
import gc
import json
import math
import os
from pathlib import Path
import sys
from types import MappingProxyType, TracebackType
from typing import Any, Final, Self, TextIO, TYPE_CHECKING

from hapticvision_ros.cli.command import check_out
from hapticvision_ros.core.errors import InputError, UsageError

if TYPE_CHECKING:
    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.pipeline import CampaignAnalysis, TrialAnalysis
    from hapticvision_ros.core.records import Estimate, Trial
    from hapticvision_ros.report.quantities import Unit, UnitSystem

LIMITS: Final = {
    'slowest': ('slowest push', 'm/s'),
    'fastest': ('fastest push', 'm/s'),
    'deepest': ('deepest push', 'm'),
    'longest_hold': ('longest hold', 's'),
}
"""Limits of the cell that can be given, by their names in `design.PushLimits`, and their units."""
_MOST_NAMED: Final = 5
_CLEAR_LINE: Final = '\r\x1b[K'
_NEW_OBJECTS: Final = 100_000


class Progress:
    """
    Says on a stream what is being done: on a terminal in one line that goes, else line by line.

    Parameters
    ----------
    stream : file
        Where; standard error by default.

    """

    def __init__(self, stream: TextIO | None = None) -> None:
        self._stream = sys.stderr if stream is None else stream
        self._terminal = self._stream.isatty()

    def __call__(self, what: str) -> None:
        """Say what is being done."""
        if self._terminal:
            self._stream.write(f'{_CLEAR_LINE}{what} ...')
        else:
            self._stream.write(f'{what}\n')
        self._stream.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._terminal:
            self._stream.write(_CLEAR_LINE)
            self._stream.flush()


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        'bags', nargs='+', type=Path, metavar='BAG', help='a bare .mcap or a rosbag2 directory'
    )
    parser.add_argument(
        '--out',
        type=Path,
        required=True,
        metavar='DIR',
        help='where result.json and report.html go',
    )
    parser.add_argument(
        '--hold-out',
        nargs='+',
        type=Path,
        default=[],
        metavar='BAG',
        help='bags that nothing is fitted to and that are only predicted, also if they are among '
        'the others',
    )
    parser.add_argument(
        '--model',
        metavar='MODEL',
        help='the model to fit, such as three-element+yield_force, instead of a search for what '
        'the three-element model lacks',
    )
    parser.add_argument(
        '--bootstrap',
        type=int,
        metavar='N',
        help='simulate N campaigns without an effect, such as 50, and tell in how many of them '
        'chance alone has one accepted',
    )
    for name, (what, unit) in LIMITS.items():
        parser.add_argument(
            f'--{name.replace("_", "-")}',
            type=float,
            metavar=unit.upper().replace('/', '_'),
            help=f'{what} of the cell, for the push to make next [{unit}]; near what was done by '
            'default',
        )
    parser.add_argument(
        '--units',
        choices=('si', 'paper'),
        default='si',
        help="units of table and report: N/m, or the paper's kgf/mm; result.json is always SI",
    )


def run(args: argparse.Namespace) -> int:
    """Fit the bags, print a table and write the results."""
    _check(args)
    # The matrices are small: threads inside each product would only get into each other's way.
    for variable in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'):
        os.environ.setdefault(variable, '1')
    # Half the start is imports, and what they make stays: no use in searching it for garbage.
    gc.set_threshold(_NEW_OBJECTS)
    model = None
    if args.model is not None:
        from hapticvision_ros.core.composition import Model

        model = Model.parse(args.model)
    from hapticvision_ros.report.quantities import PAPER_UNITS, SI_UNITS

    units = PAPER_UNITS if args.units == 'paper' else SI_UNITS
    campaign = fit_bags(args.bags, args.hold_out, model, args.bootstrap or 0, _limits(args))
    result, report = write_results(args.out, campaign, args.bags, args.hold_out, units)
    print_tables(campaign, units)
    print(f'\nWrote {result} and {report}.')
    check_fitted(campaign)
    return 0


def check_fitted(campaign: 'CampaignAnalysis') -> None:
    """Raise an InputError that says why, where no trial could be fitted."""
    if campaign.before.fit is None:
        raise InputError(f'{campaign.warnings[0]}.')


def fit_bags(
    bags: Sequence[Path],
    hold_out: Sequence[Path],
    model: 'Model | None' = None,
    bootstrap: int = 0,
    limits: Mapping[str, float] = MappingProxyType({}),
) -> 'CampaignAnalysis':
    """
    Read bags and fit them together; what takes long is told on standard error.

    Parameters
    ----------
    bags, hold_out : sequence of Path
        Bags to fit, and bags only to predict.
    model : Model, optional
        The model to fit instead of looking for what the base model lacks.
    bootstrap : int, default 0
        Campaigns without an effect to simulate.
    limits : mapping of str to float
        Known limits of the cell for the next push, as for `analyse_campaign`.

    Returns
    -------
    CampaignAnalysis
        What they tell.

    Raises
    ------
    InputError
        If bags cannot be read or analysed: it names them all.

    """
    # The numerics take longer to import than a wrong argument takes to be told.
    from hapticvision_ros.core.pipeline import analyse_campaign

    count = len(bags)
    analyses = _analyse([*bags, *hold_out])
    with Progress() as progress:
        return analyse_campaign(
            analyses[:count],
            analyses[count:],
            model=model,
            progress=progress,
            workers=len(os.sched_getaffinity(0)),
            bootstrap=bootstrap,
            limits=limits,
        )


def write_results(
    out: Path,
    campaign: 'CampaignAnalysis',
    bags: Sequence[Path],
    hold_out: Sequence[Path],
    units: 'UnitSystem',
) -> tuple[Path, Path]:
    """
    Write ``result.json`` and ``report.html``.

    Parameters
    ----------
    out : Path
        The folder; it is made if it is not there.
    campaign : CampaignAnalysis
        What was found.
    bags, hold_out : sequence of Path
        The bags, as they are named in the result.
    units : mapping of str to Unit
        Units of the report; the result is always SI.

    Returns
    -------
    tuple of Path
        The result and the report.

    Raises
    ------
    InputError
        If they cannot be written.

    """
    from hapticvision_ros.core.result import result_document
    from hapticvision_ros.report.page import write_report

    document = result_document(campaign, [str(bag) for bag in bags], [str(b) for b in hold_out])
    result, report = out / 'result.json', out / 'report.html'
    try:
        out.mkdir(parents=True, exist_ok=True)
        # The result first: a disk may be too full for the page.
        write_json(result, document)
        # An older page would be of another result.
        report.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(
            f'{error.filename or out} cannot be written ({error.strerror}): choose another --out.'
        ) from error
    try:
        write_report(report, campaign, units)
    except InputError as error:
        raise InputError(f'{error} {result} is written.') from error
    return result, report


def write_json(path: Path, document: dict[str, Any]) -> None:
    """Write a JSON document so that `path` holds all of it or what it held before."""
    from hapticvision_ros.report.writing import as_bytes, write_whole

    text = json.dumps(document, indent=2, allow_nan=False, ensure_ascii=False)
    write_whole(path.parent, [(path.name, as_bytes(text + '\n'))])


def print_tables(campaign: 'CampaignAnalysis', units: 'UnitSystem') -> None:
    """Print the parameters, what is doubtful, how far the models miss, and what was found."""
    from hapticvision_ros.report.findings import findings
    from hapticvision_ros.report.leftover import residual_sentences
    from hapticvision_ros.report.misses import held_out_sentences, verdicts

    analyses = campaign.trials + campaign.held_out
    print("The paper's method, trial by trial (value ± one standard error):\n")
    print('\n'.join(_paper_table(analyses, units)))
    for analysis in analyses:
        for line in _doubts(analysis):
            print(f'  {analysis.trial.name}: {line}')
    print('\nOne model for all of push, hold, release and recovery, of all trials together:\n')
    print('\n'.join(_model_table(campaign, units)))
    print()
    lines = [*verdicts(campaign, units), *held_out_sentences(campaign, units)]
    print('\n'.join([*lines, *residual_sentences(campaign, units)]))
    for warning in campaign.warnings:
        print(f'  {warning}')
    if campaign.diagnosis is not None:
        print('\nDiagnosis:\n')
        for sentence in findings(campaign.diagnosis, units):
            print(f'  {sentence}')


def _check(args: argparse.Namespace) -> None:
    """Refuse what does not fit together, before anything is read."""
    if args.bootstrap is not None:
        if args.bootstrap < 1:
            raise UsageError(f'--bootstrap {args.bootstrap}: simulate one campaign or more.')
        if args.model is not None:
            raise UsageError(
                '--bootstrap tests the search for effects, which --model replaces: leave one out.'
            )
    known = _limits(args)
    for name, value in known.items():
        option = f'--{name.replace("_", "-")}'
        if not (math.isfinite(value) and value > 0.0):
            raise UsageError(f'{option} {value:g}: give a number above 0.')
        if args.model is not None:
            raise UsageError(
                f'{option} is of the push to make next, which --model does not look for: leave '
                'one out.'
            )
    if known.get('slowest', 0.0) > known.get('fastest', math.inf):
        raise UsageError('--slowest is above --fastest: exchange them.')
    check_out(args.out)
    # A pattern names those that are held out as well.
    unseen = {bag.resolve() for bag in args.hold_out}
    args.bags = [bag for bag in args.bags if bag.resolve() not in unseen]
    if not args.bags:
        raise UsageError('--hold-out names every bag: leave one or more to fit.')
    seen: set[Path] = set()
    for bag in [*args.bags, *args.hold_out]:
        resolved = bag.resolve()
        if resolved in seen:
            raise UsageError(f'{bag} is named twice: name each bag once.')
        seen.add(resolved)
    out = args.out.resolve()
    for folder in (out, *out.parents):
        if (folder / 'metadata.yaml').is_file() and any(folder.glob('*.mcap')):
            raise UsageError(f'--out {args.out} is in the bag {folder}: choose another folder.')


def _limits(args: argparse.Namespace) -> dict[str, float]:
    """Return the limits of the cell that were given."""
    return {name: value for name in LIMITS if (value := getattr(args, name)) is not None}


def _analyse(bags: Sequence[Path]) -> 'list[TrialAnalysis]':
    """Read and analyse all bags, or name all with which that fails."""
    from hapticvision_ros.bag.reader import read_trial
    from hapticvision_ros.core.pipeline import analyse

    trials: list[tuple[Path, Trial]] = []
    complaints = []
    seen: dict[tuple[int, bytes, bytes], Path] = {}
    for bag in bags:
        try:
            trial = read_trial(bag)
        except InputError as error:
            complaints.append(str(error).rstrip('.'))
            continue
        recording = (trial.start_ns, trial.force.t.tobytes(), trial.force.value.tobytes())
        if recording in seen:
            complaints.append(
                f'{bag} holds the same recording as {seen[recording]}: name each recording once'
            )
            continue
        seen[recording] = bag
        trials.append((bag, trial))
    names = Counter(trial.name for _, trial in trials)
    analyses = []
    for bag, trial in trials:
        try:
            # Monday's first take and Tuesday's: results and warnings go by the name.
            analyses.append(
                analyse(replace(trial, name=str(bag)) if names[trial.name] > 1 else trial)
            )
        except InputError as error:
            # The numerics know no files.
            complaints.append(f'{bag}: {str(error).rstrip(".")}')
    if complaints:
        more = len(complaints) - _MOST_NAMED
        named = '; '.join(complaints[:_MOST_NAMED]) + (f'; and {more} more' if more > 0 else '')
        raise InputError(f'{named}.')
    return analyses


def _paper_table(analyses: 'Sequence[TrialAnalysis]', system: 'UnitSystem') -> list[str]:
    """Return the lines of the table of the paper's method."""
    columns = (
        ('relaxation time', 'relaxation_time', system['time']),
        ('F_inf', 'F_inf', system['force']),
        ('retardation time', 'retardation_time', system['time']),
        ('H0', 'H0', system['length']),
        ('K1', 'K1', system['stiffness']),
        ('C1', 'C1', system['viscosity']),
        ('C2', 'C2', system['viscosity']),
    )
    rows = [['trial', *(f'{title} [{unit.symbol}]' for title, _, unit in columns)]]
    rows += [
        [
            analysis.trial.name,
            *(_cell(getattr(analysis.paper, name), unit) for _, name, unit in columns),
        ]
        for analysis in analyses
    ]
    return _aligned(rows)


def _model_table(campaign: 'CampaignAnalysis', system: 'UnitSystem') -> list[str]:
    """Return the lines of the table of the models' parameters."""
    from hapticvision_ros.report.misses import short_name
    from hapticvision_ros.report.quantities import display_unit

    models = [campaign.before] if campaign.after is None else [campaign.before, campaign.after]
    units = {
        name: display_unit(unit, system) for model in models for name, unit in model.units.items()
    }
    heads = [f'{name} [{unit.symbol}]' if unit.symbol else name for name, unit in units.items()]
    rows = [['model', *heads]]
    for model in models:
        cells = [
            _cell(model.parameters[name], unit) if name in model.parameters else ''
            for name, unit in units.items()
        ]
        rows.append([short_name(model), *cells])
    return _aligned(rows)


def _doubts(analysis: 'TrialAnalysis') -> list[str]:
    """Return what a reader must know of the numbers of one trial."""
    from hapticvision_ros.core.result import estimate_warnings, PAPER_KEYS

    estimates = {name: getattr(analysis.paper, name) for _, name in PAPER_KEYS}
    return [*analysis.warnings, *estimate_warnings(estimates)]


def _cell(estimate: 'Estimate', unit: 'Unit') -> str:
    """Return one number of a table; a dash where the data cannot tell it."""
    from hapticvision_ros.report.quantities import format_number

    if estimate.value is None:
        return '-'
    std = None if estimate.std is None else unit.from_si(estimate.std)
    return format_number(unit.from_si(estimate.value), std)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows as lines with aligned columns, the first to the left."""
    widths = [max(len(cell) for cell in column) for column in zip(*rows, strict=True)]
    return [
        '  '
        + '  '.join(
            cell.ljust(width) if index == 0 else cell.rjust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
