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
``hapticvision shape``: the object simulated with a fitted model, beside the clouds of bags.

Everything of a bag is made before anything of it is written; ``shape.json`` comes last, so that a
folder that has one has the rest. Several bags have a folder each, and a table over them.
"""

import argparse
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
import contextlib
from dataclasses import replace
from functools import cache
import math
import os
from pathlib import Path
import re
from typing import Any, Final, TYPE_CHECKING

from hapticvision_ros.cli.command import check_out
from hapticvision_ros.cli.export import depths, fitted_model, quantity, read_result
from hapticvision_ros.cli.fit import Progress, write_json
from hapticvision_ros.cli.tips import ByTip, Identified
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.units import LENGTH_UNITS

if TYPE_CHECKING:
    from hapticvision_ros.core.records import Segmentation, Trial
    from hapticvision_ros.core.surface.cloud import Observation
    from hapticvision_ros.core.surface.study import ShapeSettings, ShapeStudy

_TABLE_SCHEMA: Final = 'hapticvision/shapes/1'
_MOST_FRAMES: Final = 100
_OF_A_LOOK: Final = re.compile(r'(surface|cloud)_\d+\.(ply|vtk)')
_MM: Final = 1e-3
_LEAST_HELD_OUT: Final = 2
_STIFFEST: Final = 1e3
"""A volume that is stiffer than this, over Young's modulus, is one that the solver loses."""
_MOST_TURNS: Final = 3


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        'result', type=Path, metavar='RESULT_JSON', help='what hapticvision fit wrote'
    )
    parser.add_argument(
        'bags',
        nargs='+',
        type=Path,
        metavar='BAG',
        help='a trial with clouds and a release',
    )
    parser.add_argument(
        '--out', type=Path, required=True, metavar='DIR', help='where shape.json and the rest go'
    )
    parser.add_argument(
        '--tool-radius',
        required=True,
        metavar='LENGTH',
        help='of the flat, round tool, in metres or as 12.6mm',
    )
    parser.add_argument(
        '--sphere', action='store_true', help='the tool ends in a sphere of that radius'
    )
    parser.add_argument(
        '--size',
        metavar='LxWxH',
        help='of an object that is a block, such as 85x60x40mm (default: what the cloud shows)',
    )
    parser.add_argument(
        '--cell',
        metavar='LENGTH',
        help="side of a cell of the lattice (default: about half the tool's radius, up to 5mm)",
    )
    parser.add_argument(
        '--contact',
        nargs=2,
        type=float,
        metavar=('X', 'Y'),
        help="the tool's axis in the frame of the clouds, in metres (default: where it is seen)",
    )
    parser.add_argument(
        '--which',
        choices=('before', 'after'),
        help='the base model, or the one with what it lacked (default: after where there is one)',
    )
    parser.add_argument(
        '--volume-ratio',
        type=float,
        metavar='R',
        help="stiffness against a change of volume over Young's modulus (default: 14)",
    )
    parser.add_argument(
        '--support-friction',
        type=float,
        metavar='MU',
        help="Coulomb's coefficient under the object; 0 lets it slide (default: it sticks)",
    )
    parser.add_argument(
        '--tool-friction',
        type=float,
        metavar='MU',
        help='the same at the tool (default: what it touches sticks to it)',
    )
    parser.add_argument(
        '--density',
        type=float,
        default=0.0,
        metavar='KG_M3',
        help='of the object, whose weight then pulls it down from the shape that was seen on '
        '(default: 0, without weight)',
    )
    parser.add_argument(
        '--small',
        action='store_true',
        help='links keep their directions, as if the push were small',
    )
    parser.add_argument(
        '--links',
        choices=('alike', 'even'),
        help='alike: as of one material; even: those that are stretched less come to a threshold '
        'or a power with less force, all at once (default: the first that follows the model '
        'within 1 %%, else the better)',
    )
    parser.add_argument(
        '--rounds',
        type=int,
        default=12,
        metavar='N',
        help='runs of the calibration of either kind of links at most (default: 12)',
    )
    parser.add_argument(
        '--average',
        type=int,
        default=5,
        metavar='N',
        help='frames that are averaged at each time (default: 5)',
    )
    parser.add_argument(
        '--close-loop',
        action='store_true',
        help='find volume stiffness, friction under the object and tip of the tool from the shape '
        'of several bags, each held out in turn (about ten times as long)',
    )


def run(args: argparse.Namespace) -> int:
    """Simulate, compare, and write."""
    _check(args)
    for variable in ('OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS'):
        os.environ.setdefault(variable, '1')
    settings = _settings(args)
    result = read_result(args.result)
    of_tip = ByTip(args.bags, _identified(args.result, args.which, result), sphere=args.sphere)
    which = args.which or ('after' if result.get('after') is not None else 'before')
    rows: list[dict[str, Any]] = []
    loop: list[dict[str, Any]] = []
    folders = _folders(args.bags, args.out)
    # The loop looks at each bag many times; clouds stay in the file.
    opened = cache(_opened)
    if args.close_loop:
        loop, settings = _closed(args.bags, opened, of_tip, settings)
    for bag, out in zip(args.bags, folders, strict=True):
        if len(args.bags) > 1:
            print(f'{bag}\n')
        identified = of_tip(settings.sphere)
        study = _study(bag, opened, identified, settings)
        rows.append(_done(study, args.result, which, bag, out, identified))
        print()
    if len(rows) > 1:
        path = args.out / 'shapes.json'
        with _told(args.out):
            write_json(path, {'schema': _TABLE_SCHEMA, 'trials': rows, 'loop': loop})
        print('\n'.join(_table(rows)))
        print(f'\nWrote {path}.')
    return 0


def _identified(path: Path, which: str | None, result: Mapping[str, Any]) -> Identified:
    """Return what a result says of the object."""
    from hapticvision_ros.core.export import known_values

    model, estimates = fitted_model(path, which)[:2]
    deepest = max((depth for depth in depths(result) if depth is not None), default=None)
    return Identified(model, known_values(model, estimates), deepest)


def _folders(bags: Sequence[Path], out: Path) -> list[Path]:
    """Return where each bag's files go."""
    if len(bags) == 1:
        return [out]
    names = [bag.resolve().name.removesuffix('.mcap') for bag in bags]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise UsageError(f"two bags are called '{twice}': give each its own call and --out.")
    return [out / name for name in names]


def _done(
    study: 'ShapeStudy',
    result: Path,
    which: str,
    bag: Path,
    out: Path,
    identified: Identified,
) -> dict[str, Any]:
    """Write what was found of a bag, print it, and return its row of the table."""
    from hapticvision_ros.core.surface.document import PAIRS, shape_document
    from hapticvision_ros.report.shape import files, render_shape
    from hapticvision_ros.report.writing import as_bytes, write_whole

    document = shape_document(
        study,
        result=str(result),
        which=which,
        bag=str(bag),
        fitted_anew=identified.parameters if identified.anew else None,
    )
    with Progress() as tell:
        tell('drawing')
        made = dict(files(study))
        page = render_shape(
            study,
            result=str(result),
            bag=str(bag),
            warnings=document['warnings'],
            made=made,
        )
    made['shape.html'] = as_bytes(page)
    with _told(out):
        write_whole(out, made.items())
        # An earlier run may have had more looks.
        for path in out.iterdir():
            if _OF_A_LOOK.fullmatch(path.name) and path.name not in made:
                path.unlink()
        write_json(out / 'shape.json', document)
    _print(study, document['warnings'])
    print(f'\nWrote {out / "shape.json"}, {out / "shape.html"} and {len(made) - 1} files beside.')
    last = document['after'][-1]
    return {
        'bag': str(bag),
        'push_speed_m_s': study.phases.push_speed,
        'depth_m': study.phases.depth,
        'links': document['simulation']['links'],
        **{f'{name}_{unit}': document[f'{name}_{unit}'] for name, unit, _ in PAIRS},
        **{
            name: last[name]
            for name in ('rms_m', 'noise_m', 'percentile_95_m', 'largest_m', 'hausdorff_m')
        },
        'warnings': document['warnings'],
    }


@contextlib.contextmanager
def _told(out: Path) -> Iterator[None]:
    """Say in one sentence why nothing can be written."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f'{error.filename or out} cannot be written ({error.strerror}): choose another --out.'
        ) from error


def _table(rows: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the lines of the paper's Table 4 for some bags [mm, mm/s]."""
    lines = ['  push speed  depth   bouncing: measured  simulated   residual: measured  simulated']
    for row in rows:
        cells = [
            f'{row["push_speed_m_s"] / _MM:12.2f}'
            if row['push_speed_m_s'] is not None
            else f'{"-":>12}',
            f'{row["depth_m"] / _MM:7.2f}' if row['depth_m'] is not None else f'{"-":>7}',
        ]
        for name in ('bouncing_m', 'residual_m'):
            for side, width in (('measured', 21), ('simulated', 11)):
                value = row[name][side]
                cells.append(f'{"-":>{width}}' if value is None else f'{value / _MM:{width}.3f}')
        lines.append(''.join(cells))
    return lines


def _check(args: argparse.Namespace) -> None:
    """Refuse what does not fit together, before anything is read."""
    check_out(args.out)
    if args.close_loop and len(args.bags) < _LEAST_HELD_OUT:
        raise UsageError(
            f'--close-loop: a bag is held out, so give {_LEAST_HELD_OUT} or more, not '
            f'{len(args.bags)}.'
        )
    if args.volume_ratio is not None and _STIFFEST < args.volume_ratio < math.inf:
        raise UsageError(
            f'--volume-ratio {args.volume_ratio:g}: up to {_STIFFEST:g}; a body that keeps its '
            'volume has about 14.'
        )
    if args.rounds < 1:
        raise UsageError(f'--rounds {args.rounds}: one run or more.')
    if not 1 <= args.average <= _MOST_FRAMES:
        raise UsageError(f'--average {args.average}: from 1 to {_MOST_FRAMES} frames.')
    if args.contact is not None and not all(map(math.isfinite, args.contact)):
        raise UsageError(f'--contact {args.contact[0]:g} {args.contact[1]:g}: two finite numbers.')
    for name in ('volume_ratio', 'support_friction', 'tool_friction', 'density'):
        value = getattr(args, name)
        if value is not None and not 0.0 <= value < math.inf:
            raise UsageError(f'--{name.replace("_", "-")} {value:g}: zero or above, and finite.')


def _settings(args: argparse.Namespace) -> 'ShapeSettings':
    """Return what the arguments ask for."""
    radius = quantity('--tool-radius', args.tool_radius, LENGTH_UNITS, 'm', '0.0126 or 12.6mm')
    pitch = None
    if args.cell is not None:
        pitch = quantity('--cell', args.cell, LENGTH_UNITS, 'm', '0.005 or 5mm')
    size = None if args.size is None else _size(args.size)
    from hapticvision_ros.core.body.push import Surroundings
    from hapticvision_ros.core.surface.cloud import CloudSettings, WIDEST_TOOL
    from hapticvision_ros.core.surface.study import ShapeSettings

    if radius > WIDEST_TOOL:
        raise UsageError(
            f"--tool-radius '{args.tool_radius}' is {radius:g} m: write millimetres as 12.6mm."
        )

    surroundings = Surroundings(small=args.small, density=args.density)
    if args.volume_ratio is not None:
        surroundings = replace(surroundings, volume_ratio=args.volume_ratio)
    for touch in ('tool', 'support'):
        friction = getattr(args, f'{touch}_friction')
        if friction is not None:
            changed = replace(getattr(surroundings, touch), friction=friction)
            surroundings = replace(surroundings, **{touch: changed})
    return ShapeSettings(
        cloud=CloudSettings(tool_radius=radius, average=args.average),
        pitch=pitch,
        size=size,
        contact=None if args.contact is None else (args.contact[0], args.contact[1]),
        sphere=args.sphere,
        surroundings=surroundings,
        rounds=args.rounds,
        alike=None if args.links is None else args.links == 'alike',
    )


def _size(text: str) -> tuple[float, float, float]:
    """Return length, width and height of a block [m]."""
    match = re.fullmatch(r'([\d.]+)\s*x\s*([\d.]+)\s*x\s*([\d.]+)\s*(m|mm)?', text.strip())
    values: list[float] = []
    if match is not None:
        with contextlib.suppress(ValueError):
            values = [float(one) * LENGTH_UNITS[match[4] or 'm'] for one in match.groups()[:3]]
    if len(values) != 3 or not all(value > 0.0 for value in values):
        raise UsageError(f"--size '{text}' is no size of a block: write it as 85x60x40mm.")
    length, width, height = values
    return max(length, width), min(length, width), height


def _closed(
    bags: Sequence[Path],
    opened: '_Opened',
    of_tip: ByTip,
    settings: 'ShapeSettings',
) -> 'tuple[list[dict[str, Any]], ShapeSettings]':
    """Return what the shapes ask for, one thing after the other, and with what to simulate."""
    from hapticvision_ros.core.surface.loop import close_loop

    _differ(bags)
    documents = []
    for turn in range(_MOST_TURNS):
        loop, asked = close_loop(
            len(bags),
            settings,
            lambda trial, changed, seen: _study(
                bags[trial], opened, of_tip(changed.sphere), changed, seen
            ),
        )
        print('Misfit of the profile of the shape, trial by trial [mm rms]:\n')
        for name, misfits in loop.misfits.items():
            print(f'  {name:<24}' + ''.join(f'{one / _MM:8.3f}' for one in misfits))
        if loop.before is not None and loop.after is not None:
            print(
                f'\n  each trial left out in turn: {loop.before / _MM:.3f} as '
                f'{"accepted so far" if turn else "declared"}, {loop.after / _MM:.3f} with what '
                'the others choose'
            )
        print(f'\n{"Accepted" if loop.accepted else "Not accepted"}: {loop.verdict}.\n')
        documents.append(
            {
                'misfit_m': {name: list(misfits) for name, misfits in loop.misfits.items()},
                'chosen': loop.chosen,
                'accepted': loop.accepted,
                'held_out_before_m': loop.before,
                'held_out_after_m': loop.after,
                'lowered_m2': loop.lowered,
                'lowered_std_m2': loop.lowered_std,
                'by_cells_m2': loop.by_cells if math.isfinite(loop.by_cells) else None,
                'alike': list(loop.alike),
                'verdict': loop.verdict,
                'fitted_anew': _fitted_anew(of_tip),
            }
        )
        if not loop.accepted:
            break
        if asked.sphere != settings.sphere and of_tip(asked.sphere).anew:
            identified = of_tip(asked.sphere)
            print('\n'.join(f'{one}.' for one in (_anew(identified), *identified.warnings)) + '\n')
        settings = asked
    return documents, settings


def _differ(bags: Sequence[Path]) -> None:
    """Refuse trials of which one is a copy of another: it would be held out of itself."""
    from hapticvision_ros.bag.reader import read_trial

    seen: dict[bytes, Path] = {}
    for bag in bags:
        force = read_trial(bag, displacement_from_points=False).force
        mark = force.t.tobytes() + force.value.tobytes()
        if mark in seen:
            raise InputError(
                f'{bag} is the same trial as {seen[mark]}: nothing of it is held out of the '
                'other; give different trials.'
            )
        seen[mark] = bag


def _fitted_anew(of_tip: ByTip) -> dict[str, Any] | None:
    """Return the numbers and the warnings of what was fitted for another tip, if it was."""
    identified = of_tip.anew
    if identified is None:
        return None
    return {
        'model': identified.model.name,
        'parameters': dict(identified.parameters),
        'warnings': list(identified.warnings),
    }


def _anew(identified: Identified) -> str:
    """Return what was fitted for another tip than the declared one."""
    model = identified.model
    told = ', '.join(
        f'{name} {identified.parameters[name]:.5g} {parameter.unit}'.removesuffix(' -')
        for name, parameter in zip(model.names, model.parameters, strict=True)
    )
    return f'for this tip of the tool the bags were fitted anew, with {model.name}: {told}'


type _Opened = Callable[[Path], 'tuple[Trial, Segmentation]']


def _opened(bag: Path) -> 'tuple[Trial, Segmentation]':
    """Return the trial of a bag that has clouds, with its phases."""
    from hapticvision_ros.bag.reader import read_trial

    trial = read_trial(bag)
    if trial.clouds is None:
        raise InputError(
            f'{bag} has no clouds: record /range_sensor/points, or choose another bag.'
        )
    from hapticvision_ros.core.segmentation import segment

    with _naming(bag):
        return trial, segment(trial.force, trial.tool_height, trial.displacement_height)


@contextlib.contextmanager
def _naming(bag: Path) -> Iterator[None]:
    """Name the bag of which the numerics, that know no files, say that they cannot use it."""
    try:
        yield
    except InputError as error:
        raise InputError(f'{bag}: {str(error).rstrip(".")}.') from error


def _study(
    bag: Path,
    opened: _Opened,
    identified: Identified,
    settings: 'ShapeSettings',
    observed: 'Observation | None' = None,
) -> 'ShapeStudy':
    """Return what was found in a bag; of its object, where it was taken out of the clouds."""
    with Progress() as tell:
        tell('reading')
        trial, phases = opened(bag)
        from hapticvision_ros.core.surface.study import study_shape

        with _naming(bag):
            study = study_shape(
                trial,
                phases,
                identified.model,
                identified.parameters,
                settings,
                reference_depth=identified.reference_depth,
                observed=observed,
                progress=tell,
            )
    if identified.anew:
        told = (_anew(identified), *identified.warnings)
        study = replace(study, warnings=(*study.warnings, *told))
    return study


def _print(study: 'ShapeStudy', warnings: Iterable[str]) -> None:
    """Print the numbers of the shape."""
    from hapticvision_ros.core.surface.document import PAIRS

    print('Measured beside simulated (± one standard error):\n')
    for name, unit, what in PAIRS:
        pair = getattr(study.deformation, name)
        scale, symbol = (_MM, 'mm') if unit == 'm' else (1e-6, 'cm3')
        seen, told = pair.measured, pair.simulated
        measured = (
            '-' if seen.value is None else f'{seen.value / scale:.3f} ± {seen.std / scale:.3f}'
        )
        simulated = '-' if told.value is None else f'{told.value / scale:.3f}'
        print(f'  {what} [{symbol}]: {measured} beside {simulated}')
    print('\nDistance of the cloud from the simulated surface [mm]:\n')
    looks = [('before the push', study.at_rest)]
    released = study.phases.t_release or 0.0
    looks += [(f'{one.t - released:.2f} s after release', one) for one in study.comparisons]
    for name, one in looks:
        print(
            f'  {name}: rms {one.rms / _MM:.3f} (noise {one.noise / _MM:.3f}, '
            f'{one.noise_share:.0%} of its square), 95 % below {one.percentile_95 / _MM:.3f}, '
            f'largest {one.largest / _MM:.3f}'
        )
    for warning in warnings:
        print(f'  {warning}')
