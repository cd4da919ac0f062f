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
``hapticvision export``: a fitted model in the terms of finite-element codes and simulators.

It reads what `hapticvision fit` wrote, so that nothing is fitted again.
"""

import argparse
from collections.abc import Mapping
import json
import math
from pathlib import Path
import re
from typing import Any, TYPE_CHECKING

from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.units import AREA_UNITS, LARGEST, LENGTH_UNITS

if TYPE_CHECKING:
    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.export import Specimen
    from hapticvision_ros.core.records import Estimate, FloatArray

FORMATS = ('json', 'csv', 'abaqus', 'ansys', 'mujoco', 'haptic')
POINTS = ('rest', 'reference')
RESULT_SCHEMA = 'hapticvision/result/1'


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the arguments of the verb."""
    parser.add_argument(
        'result', type=Path, metavar='RESULT_JSON', help='what hapticvision fit wrote'
    )
    parser.add_argument(
        '--format',
        choices=FORMATS,
        required=True,
        help='json: all forms; csv: relaxation function; abaqus, ansys: Prony series; mujoco; '
        'haptic: a step function in Python for a haptic renderer, 1 ms a step',
    )
    parser.add_argument(
        '--which',
        choices=('before', 'after'),
        help='the base model, or the one with what it lacked (default: after where there is one)',
    )
    parser.add_argument(
        '--area', metavar='AREA', help='cross-section of the specimen, in m2 or as 51cm2, 5100mm2'
    )
    parser.add_argument(
        '--height', metavar='LENGTH', help='its original height, in metres or as 40mm'
    )
    parser.add_argument(
        '--poisson', type=float, metavar='NU', help="Poisson's ratio (for abaqus, ansys)"
    )
    parser.add_argument(
        '--shortest-time',
        type=float,
        metavar='S',
        help='the shortest time that the simulation resolves [s] (for abaqus, ansys)',
    )
    parser.add_argument(
        '--linearise',
        choices=POINTS,
        metavar='POINT',
        help='where a nonlinear model is taken as linear: rest or reference',
    )
    parser.add_argument(
        '--out', type=Path, metavar='FILE', help='where it goes (default: standard output)'
    )


def run(args: argparse.Namespace) -> int:
    """Read the result and write the export."""
    specimen = _specimen(args)
    model, parameters, correlation = fitted_model(args.result, args.which)
    from hapticvision_ros.core.export import export

    text = export(
        args.format,
        model,
        parameters,
        specimen=specimen,
        poisson=args.poisson,
        shortest_time=args.shortest_time,
        point=args.linearise,
        correlation=correlation,
        reference_depth=deepest(args.result) if args.format == 'haptic' else None,
        source=args.result.name,
    )
    if args.out is None:
        print(text, end='')
        return 0
    try:
        args.out.write_text(text, encoding='utf-8')
    except OSError as error:
        raise InputError(
            f'{args.out} cannot be written ({error.strerror}): choose another --out.'
        ) from error
    print(f'Wrote {args.out}.')
    return 0


def _specimen(args: argparse.Namespace) -> 'Specimen | None':
    """Return what was pressed, as far as the arguments tell."""
    from hapticvision_ros.core.export import Specimen

    if args.area is None and args.height is None:
        return None
    if args.area is None or args.height is None:
        raise UsageError('--area and --height belong together: give both.')
    area = quantity('--area', args.area, AREA_UNITS, 'm2', '0.0051 or 51cm2')
    height = quantity('--height', args.height, LENGTH_UNITS, 'm', '0.04 or 40mm')
    for option, size, unit in (('--area', area, 'm2'), ('--height', height, 'm')):
        if size > LARGEST:
            raise UsageError(
                f'{option} is {size:g} {unit}, which no specimen has: write its unit beside it.'
            )
    return Specimen(area, height)


def quantity(
    option: str, text: str, units: Mapping[str, float], default: str, example: str
) -> float:
    """Return a number above zero in SI units, given with or without its unit."""
    match = re.fullmatch(r'(\d+\.?\d*|\.\d+)(e[+-]?\d+)?\s*([a-z]+\d?)?', text.strip())
    unit = (match[3] or default) if match else ''
    value = 0.0
    if match is not None and unit in units:
        value = float(match[1] + (match[2] or '')) * units[unit]
    if not 0.0 < value < math.inf:
        raise UsageError(
            f"{option} '{text}' is no size above zero and finite: write it as {example}."
        )
    return value


def fitted_model(
    path: Path, which: str | None
) -> 'tuple[Model, dict[str, Estimate], FloatArray | None]':
    """Return the model of a result, its parameters, and how their errors go together."""
    from hapticvision_ros.core.composition import Model

    result = read_result(path)
    chosen = which or ('after' if result.get('after') is not None else 'before')
    fitted = result.get(chosen)
    if fitted is None:
        raise UsageError(f"{path} has no model '{chosen}': leave --which away.")
    try:
        model = Model.parse(fitted['model'])
        parameters = {
            name: _estimate(name, fitted['parameters'][name], chosen, result['warnings'])
            for name in model.names
        }
        return model, parameters, _correlation(fitted.get('correlation'), len(parameters))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InputError(
            f"{path} does not hold the parameters of its model '{chosen}' ({error}): write it "
            'anew with hapticvision fit.'
        ) from error


def _estimate(name: str, entry: Mapping[str, Any], which: str, warnings: list[str]) -> 'Estimate':
    """Return one parameter; where it is null, with the warning that says why."""
    from hapticvision_ros.core.records import Estimate

    if entry['value'] is not None:
        value, std = float(entry['value']), entry['std']
        if not math.isfinite(value):
            raise ValueError(f'{name} is not finite')
        return Estimate(value, None if std is None else float(std))
    # Both models say it without a prefix; names are letters of units and of sentences as well.
    said = re.compile(rf'(?:{which}: )?{re.escape(name)} is unknown: (.+)', re.DOTALL)
    reasons = [match[1] for match in map(said.fullmatch, warnings) if match is not None]
    return Estimate.unknown(reasons[0] if reasons else 'the trials do not tell it')


def _correlation(rows: list[list[float | None]] | None, size: int) -> 'FloatArray | None':
    """Return the correlation of the parameters; None from a result that does not hold it."""
    if rows is None:
        return None
    import numpy as np

    matrix = np.array([[math.nan if one is None else float(one) for one in row] for row in rows])
    if matrix.shape != (size, size) or not np.all(
        np.isnan(matrix) | (np.abs(matrix) <= 1.0 + 1e-9)
    ):
        raise ValueError('correlation')
    return matrix


def deepest(path: Path) -> float | None:
    """Return the depth of the deepest push of a result [m]; None where no trial told one."""
    return max((depth for depth in depths(read_result(path)) if depth is not None), default=None)


def depths(result: Mapping[str, Any]) -> list[float | None]:
    """Return the depths of the trials of a result [m]."""
    try:
        found = [one.get('depth_m') for one in result.get('trials', [])]
        return [None if depth is None else float(depth) for depth in found]
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(
            f'the result does not hold its trials ({error}): write it anew with hapticvision fit.'
        ) from error


def read_result(path: Path) -> dict[str, Any]:
    """Return the document of a result."""
    try:
        result = json.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise InputError(
            f'{path} cannot be read ({error.strerror}): name a result.json.'
        ) from error
    except ValueError as error:
        raise InputError(f'{path} is no JSON ({error}): name a result.json.') from error
    if isinstance(result, dict) and result.get('schema') == RESULT_SCHEMA:
        return result
    schema = str(result.get('schema')) if isinstance(result, dict) else ''
    if schema.rpartition('/')[0] == RESULT_SCHEMA.rpartition('/')[0]:
        raise InputError(
            f'{path} is of the schema {schema}, and this version reads {RESULT_SCHEMA}: fit the '
            'bags with this version.'
        )
    raise InputError(f'{path} is no result of hapticvision fit: name a result.json.')
