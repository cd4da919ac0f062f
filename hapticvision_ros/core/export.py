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
Fitted parameters in the terms of others: moduli, Prony series, links of a simulator.

Moduli and viscosities hold for a specimen of one height and one cross-section that is pressed over
all of it: ``stress = F / A``, ``strain = H / h``. A tool that is smaller than the object gives
numbers of the right size at best.

References
----------
J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed., 1980, ch. 1 (stiffness and modulus);
Abaqus Keywords Reference (VISCOELASTIC, TIME=PRONY); Ansys Mechanical APDL Command Reference (TB,
PRONY); MuJoCo XML Reference, joint (stiffness, damping, frictionloss).

"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import batched
import json
import math
from typing import Any, Final, Literal, NamedTuple

from hapticvision_ros.core.composition import BASE, BASE_PARAMETERS, Model
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.effects.declaration import without_law
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.models.chain import Slot
from hapticvision_ros.core.records import Estimate, FloatArray
from hapticvision_ros.core.relaxation import (
    linear_chain,
    Point,
    prony_series,
    PronySeries,
    relaxation_function,
    RelaxationFunction,
    standard_errors,
)
import numpy as np

type Format = Literal['json', 'csv', 'abaqus', 'ansys', 'mujoco', 'haptic']

SCHEMA: Final = 'hapticvision/export/1'

_STEP: Final = 1e-4
"""Time step that the MuJoCo model asks for [s]: its dry friction creeps by much more at 1 ms."""
_STEPS_A_SWING: Final = 20.0
"""Steps in 1/omega of the mass on the stiffest spring."""
_HARD_FRICTION: Final = f' solreffriction="{2.0 * _STEP:g} 1" solimpfriction="0.9999 0.9999"'
"""MuJoCo's dry friction is soft: as hard as it can be."""
_LAWS: Final = (
    'strain_stiffening',
    'damage',
    'shear_thinning',
    'contact_growth',
    'exponential_stiffening',
    'ageing',
    'adhesion:cohesive_zone',
    'adhesion:fading_zone',
)
"""Effects that a link with constant numbers cannot hold."""
_DIGITS: Final = 10
_NO_CORRELATION: Final = (
    'how the errors of the parameters go together is not known: write the result anew with '
    'hapticvision fit'
)


@dataclass(frozen=True, slots=True)
class Specimen:
    """
    What was pressed.

    Parameters
    ----------
    area : float
        Cross-section A [m^2].
    height : float
        Original height h [m].

    Raises
    ------
    UsageError
        If one of them is not a number above zero.

    """

    area: float
    height: float

    def __post_init__(self) -> None:
        for name, value, unit in (('area', self.area, 'm^2'), ('height', self.height, 'm')):
            if not 0.0 < value < math.inf:
                raise UsageError(f'the {name} of a specimen is above zero, not {value:g} {unit}')

    @property
    def modulus(self) -> float:
        """Return what turns a stiffness into a modulus, h/A [1/m]."""
        return self.height / self.area


@dataclass(frozen=True, slots=True)
class MaterialQuantity:
    """
    A parameter as stress over strain.

    Parameters
    ----------
    symbol : str or None
        Its name as one of the material; None where it has no such form.
    unit : str or None
        Its unit.
    estimate : Estimate
        Value and standard error, both by the same factor; unknown with the reason.

    """

    symbol: str | None
    unit: str | None
    estimate: Estimate


def material_quantities(
    model: Model, parameters: Mapping[str, Estimate], specimen: Specimen
) -> dict[str, MaterialQuantity]:
    """
    Return the parameters of a model as quantities of stress and strain.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to Estimate
        Its parameters in SI units, by name.
    specimen : Specimen
        What was pressed; its area and height are taken as exact.

    Returns
    -------
    dict of str to MaterialQuantity
        ``E = K h / A`` [Pa], ``eta = C h / A`` [Pa.s], ``sigma = F / A`` [Pa], ``beta h^2`` [-],
        ``a h`` [-], and numbers without a unit as they are; null with the reason for what is not
        a property of the material.

    """
    return {
        name: _material(effect, name, parameters[name], specimen)
        for effect, name in zip(_owners(model), model.names, strict=True)
    }


def _owners(model: Model) -> tuple[str, ...]:
    """Return the effect that each parameter belongs to."""
    owners = [BASE] * len(BASE_PARAMETERS)
    for effect in model.declared:
        owners += [effect.name] * len(effect.parameters)
    return tuple(owners)


def _material(effect: str, name: str, estimate: Estimate, specimen: Specimen) -> MaterialQuantity:
    """Return one parameter as a quantity of the material."""
    symbol = name.rpartition('.')[2]
    if effect != BASE and BY_NAME[effect].kind != 'object':
        where = BY_NAME[effect].kind
        return _no_form(f'{without_law(effect)} is of the {where}, not of the object')
    forms = {
        'K': ('E' + symbol[1:], 'Pa', specimen.modulus),
        'C': ('eta' + symbol[1:], 'Pa.s', specimen.modulus),
    }
    special = {
        'F_y': ('sigma_y', 'Pa', 1.0 / specimen.area),
        'beta': ('beta', '-', specimen.height**2),
        'a': ('a', '-', specimen.height),
        'n': ('n', '-', 1.0),
        'm': ('m', '-', 1.0),
        'D': ('D', '-', 1.0),
        's': ('s', '-', 1.0),
        'alpha': ('alpha', '-', 1.0),
        'rate': ('rate', '1/h', 1.0),
    }
    form = special.get(symbol) or forms.get(symbol[:1])
    if form is None:
        return _no_form(_WITHOUT_FORM.get(symbol, f'{symbol} has no form as stress over strain'))
    of_material, unit, factor = form
    if estimate.value is None:
        return MaterialQuantity(of_material, unit, estimate)
    std = None if estimate.std is None else estimate.std * factor
    return MaterialQuantity(
        of_material, unit, Estimate(estimate.value * factor, std, estimate.reason)
    )


_WITHOUT_FORM: Final = {
    'M': 'the mass that moves with the contact point is none of a volume of the material',
    'F_ad': 'a pull-off force goes with the edge of the contact, not with its area',
    'kappa': 'what earlier pushes have stretched goes with the place, not with the material',
    'delta_c': 'the opening at which a pull ends is that of the surface, not of the material',
    'delta_e': 'the opening over which a pull fades is that of the surface, not of the material',
}


def _no_form(reason: str) -> MaterialQuantity:
    return MaterialQuantity(None, None, Estimate.unknown(reason))


def known_values(model: Model, parameters: Mapping[str, Estimate]) -> dict[str, float]:
    """
    Return the numbers of parameters that all have to be known.

    Raises
    ------
    UsageError
        If the trials have not told one of them.

    """
    values = {}
    for name in model.names:
        estimate = parameters[name]
        if estimate.value is None:
            why = f' ({estimate.reason})' if estimate.reason else ''
            raise UsageError(
                f'the trials do not tell {name}{why}: fit a model of which they tell everything'
            )
        values[name] = estimate.value
    return values


def links(model: Model, parameters: Mapping[str, float]) -> dict[str, Any]:
    """
    Return the chain as links of a simulator.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to float
        Its parameters in SI units, by name.

    Returns
    -------
    dict
        `in_series`: from the tool to the support, each a spring, a dashpot and a slider side by
        side; `parallel_stiffness_N_m` over all of them; mass and pull-off force of the contact
        point; `laws`: for each effect that constant numbers cannot hold, its law and parameters.

    """
    draft = linear_chain(model, parameters)
    slots = draft.real_slots
    compliance = float(slots[Slot.SERIES_COMPLIANCE])
    chain = []
    if compliance > 0.0:
        chain.append(_link('instantaneous', 1.0 / compliance, 0.0))
    chain.append(_link('retarded', float(slots[Slot.K1]), float(slots[Slot.C1])))
    for number, (stiffness, viscosity) in enumerate(draft.units, 2):
        chain.append(_link(f'retarded_{number}', stiffness.real, viscosity.real))
    chain.append(_link('flow', 0.0, float(slots[Slot.C2]), parameters.get('F_y', 0.0)))
    return {
        'in_series': chain,
        'parallel_stiffness_N_m': float(slots[Slot.PARALLEL_STIFFNESS]),
        'mass_kg': parameters.get('M', 0.0) if 'inertia' in model.effects else 0.0,
        'pull_off_force_N': parameters.get('F_ad', 0.0),
        'laws': {
            effect.name: {
                'law': ' '.join(effect.sketch.split()),
                'parameters': {
                    name: parameters[name]
                    for owner, name in zip(_owners(model), model.names, strict=True)
                    if owner == effect.name
                },
            }
            for effect in model.declared
            if effect.named in _LAWS or effect.name in _LAWS
        },
    }


def _link(
    name: str, stiffness: float, damping: float, dry_friction: float = 0.0
) -> dict[str, Any]:
    return {
        'name': name,
        'stiffness_N_m': stiffness,
        'damping_Ns_m': damping,
        'dry_friction_N': dry_friction,
    }


def document(
    model: Model,
    parameters: Mapping[str, Estimate],
    specimen: Specimen | None = None,
    point: Point | None = None,
    correlation: FloatArray | None = None,
) -> dict[str, Any]:
    """
    Return all forms of a fitted model, as JSON holds them.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to Estimate
        Its parameters in SI units, by name.
    specimen : Specimen, optional
        What was pressed; without it there are no quantities of the material.
    point : {'rest', 'reference'}, optional
        Where a nonlinear model is linearised for its relaxation function.
    correlation : ndarray, shape (p, p), optional
        Of the parameters, in the order of the model; the relaxation function has no standard
        errors without it.

    Returns
    -------
    dict
        Finite numbers, strings, lists, dicts and None; next to each None stands its reason.

    """
    result: dict[str, Any] = {
        'schema': SCHEMA,
        'model': model.name,
        'parameters': {
            name: _entry(parameters[name], unit)
            for name, unit in zip(model.names, model.units, strict=True)
        },
        'specimen': None,
        'material': None,
        'relaxation': None,
        'links': None,
        'reasons': {},
    }
    if specimen is None:
        result['reasons']['material'] = 'area and height of the specimen are not given'
    else:
        result['specimen'] = {'area_m2': specimen.area, 'height_m': specimen.height}
        result['material'] = {
            name: {'symbol': quantity.symbol} | _entry(quantity.estimate, quantity.unit)
            for name, quantity in material_quantities(model, parameters, specimen).items()
        }
    try:
        values = known_values(model, parameters)
    except UsageError as error:
        result['reasons'] |= dict.fromkeys(('relaxation', 'links'), str(error))
        return result
    result['links'] = links(model, values)
    try:
        relaxation = relaxation_function(model, values, point)
    except UsageError as error:
        result['reasons']['relaxation'] = str(error)
        return result
    covariance = covariance_of(model, parameters, correlation)
    spread = _spread(model, values, covariance, point)
    result['relaxation'] = {
        'linearised_at': point,
        'long_term_N_m': relaxation.long_term,
        'long_term_std_N_m': _known(spread.long_term),
        'impulse_Ns_m': relaxation.impulse,
        'impulse_std_Ns_m': _known(spread.impulse),
        'terms': [
            {
                'stiffness_N_m': stiffness,
                'stiffness_std_N_m': _known(of_stiffness),
                'relaxation_time_s': time,
                'relaxation_time_std_s': _known(of_time),
            }
            for (stiffness, time), of_stiffness, of_time in zip(
                _terms(relaxation),
                spread.stiffness.tolist(),
                spread.relaxation_time.tolist(),
                strict=True,
            )
        ],
    }
    if not spread.complete:
        result['reasons']['relaxation_std'] = _why_unknown(model, parameters, correlation)
    return result


def _entry(estimate: Estimate, unit: str | None) -> dict[str, Any]:
    return {
        'value': estimate.value,
        'std': estimate.std,
        'unit': unit,
        'reason': estimate.reason,
    }


def _terms(relaxation: RelaxationFunction) -> list[tuple[float, float]]:
    return list(
        zip(relaxation.stiffness.tolist(), relaxation.relaxation_time.tolist(), strict=True)
    )


class Spread(NamedTuple):
    """
    Standard errors of a relaxation function; not a number where they are unknown.

    Parameters
    ----------
    long_term, impulse : float
        Of the spring [N/m] and of the dashpot [N.s/m].
    stiffness, relaxation_time, viscosity : ndarray, shape (n,)
        Of the branches [N/m, s, N.s/m].

    """

    long_term: float
    impulse: float
    stiffness: FloatArray
    relaxation_time: FloatArray
    viscosity: FloatArray

    @property
    def complete(self) -> bool:
        """Return whether all of them are known."""
        return bool(np.all(np.isfinite(np.concatenate([np.atleast_1d(one) for one in self]))))


def covariance_of(
    model: Model, parameters: Mapping[str, Estimate], correlation: FloatArray | None
) -> FloatArray:
    """
    Return the covariance of the parameters of a model.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to Estimate
        Its p parameters in SI units, by name.
    correlation : ndarray, shape (p, p), or None
        Of them, in the order of the model; None where it is not known.

    Returns
    -------
    ndarray, shape (p, p)
        Not a number where it is unknown.

    """
    std = [parameters[name].std for name in model.names]
    known = np.array([math.nan if one is None else one for one in std])
    if correlation is None:
        return np.full((known.size, known.size), math.nan)
    return np.asarray(correlation * np.outer(known, known), dtype=np.float64)


def _why_unknown(
    model: Model, parameters: Mapping[str, Estimate], correlation: FloatArray | None
) -> str:
    """Return why some standard errors are not known."""
    if correlation is None:
        return _NO_CORRELATION
    without = [name for name in model.names if parameters[name].std is None]
    if without:
        return f'the standard error of {", ".join(without)} is not known'
    return 'the number of terms changes with the parameters'


def _spread(
    model: Model, values: Mapping[str, float], covariance: FloatArray, point: Point | None
) -> Spread:
    """Return the standard errors of a relaxation function."""

    def numbers(parameters: Mapping[str, float]) -> FloatArray:
        one = relaxation_function(model, parameters, point)
        viscosity = one.stiffness * one.relaxation_time
        return np.concatenate(
            ([one.long_term, one.impulse], one.stiffness, one.relaxation_time, viscosity)
        )

    std = standard_errors(numbers, values, covariance)
    return Spread(float(std[0]), float(std[1]), *np.split(std[2:], 3))


def _known(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def csv(relaxation: RelaxationFunction, spread: Spread | None = None) -> str:
    """
    Return a relaxation function as a table.

    A row is a spring (no time), a dashpot (no stiffness) or a Maxwell branch; all stand side by
    side.

    Parameters
    ----------
    relaxation : RelaxationFunction
        The function.
    spread : Spread, optional
        Its standard errors; their columns are empty where they are unknown.

    Returns
    -------
    str
        Comma-separated values with a header.

    """

    def row(*numbers: float | None) -> str:
        return ','.join('' if one is None else repr(one) for one in numbers)

    count = relaxation.stiffness.size
    unknown = np.full(count, math.nan)
    std = spread or Spread(math.nan, math.nan, unknown, unknown, unknown)
    rows = [
        'stiffness_N_m,viscosity_Ns_m,relaxation_time_s,'
        'stiffness_std_N_m,viscosity_std_Ns_m,relaxation_time_std_s'
    ]
    if relaxation.long_term > 0.0:
        rows.append(row(relaxation.long_term, None, None, _known(std.long_term), None, None))
    if relaxation.impulse > 0.0:
        rows.append(row(None, relaxation.impulse, None, None, _known(std.impulse), None))
    for number, (stiffness, time) in enumerate(_terms(relaxation)):
        errors = (std.stiffness[number], std.viscosity[number], std.relaxation_time[number])
        rows.append(row(stiffness, stiffness * time, time, *map(_known, errors)))
    return '\n'.join(rows) + '\n'


def abaqus(series: PronySeries, poisson: float, remarks: Sequence[str] = ()) -> str:
    """
    Return a Prony series as Abaqus reads it.

    Parameters
    ----------
    series : PronySeries
        With a modulus in Pa.
    poisson : float
        Poisson's ratio, taken as constant in time: shear and bulk relax alike.
    remarks : sequence of str
        Lines of comment.

    Returns
    -------
    str
        A material: instantaneous modulus, then a line of g, k and relaxation time for each term.

    """
    _check_poisson(poisson)
    lines = [f'** {remark}' for remark in (*remarks, *_remarks(series))]
    lines += [
        '*MATERIAL, NAME=HAPTICVISION',
        '*ELASTIC, MODULI=INSTANTANEOUS',
        f'{series.instantaneous:.{_DIGITS}g}, {poisson:g}',
        '*VISCOELASTIC, TIME=PRONY',
        *(f'{g}, {g}, {T:.{_DIGITS}g}' for g, T in _printed(series)),
    ]
    return '\n'.join(lines) + '\n'


def ansys(series: PronySeries, poisson: float, remarks: Sequence[str] = ()) -> str:
    """
    Return a Prony series as commands of Ansys Mechanical APDL, for material 1.

    Parameters
    ----------
    series : PronySeries
        With a modulus in Pa.
    poisson : float
        Poisson's ratio, taken as constant in time: shear and bulk relax alike.
    remarks : sequence of str
        Lines of comment.

    Returns
    -------
    str
        Instantaneous modulus, then the pairs of ratio and relaxation time for shear and bulk.

    """
    _check_poisson(poisson)
    lines = [f'! {remark}' for remark in (*remarks, *_remarks(series))]
    lines += [f'MP,EX,1,{series.instantaneous:.{_DIGITS}g}', f'MP,PRXY,1,{poisson:g}']
    pairs = [f'{g},{T:.{_DIGITS}g}' for g, T in _printed(series)]
    for part in ('SHEAR', 'BULK'):
        lines.append(f'TB,PRONY,1,1,{len(pairs)},{part}')
        # A command takes six numbers.
        lines += [
            f'TBDATA,{1 + 6 * number},{",".join(three)}'
            for number, three in enumerate(batched(pairs, 3))
        ]
    return '\n'.join(lines) + '\n'


def _check_poisson(poisson: float) -> None:
    if not -1.0 < poisson < 0.5:
        raise UsageError(
            f"Poisson's ratio is {poisson:g}: it must be above -1 and below 0.5, as 0.49"
        )


def _remarks(series: PronySeries) -> Iterator[str]:
    yield 'SI units: Pa, s'
    if series.long_term_ratio < 10.0**-_DIGITS:
        yield 'the body flows: the ratios add up to 1, and no modulus is left in the long run'


def _errors_told(series: PronySeries, std: FloatArray) -> Iterator[str]:
    """Give the standard errors of a series: of its modulus, its ratios and its times."""
    if math.isfinite(std[0]):
        yield f'instantaneous modulus {series.instantaneous:.6g} +- {std[0]:.2g} Pa'
    of_ratio, of_time = np.split(std[1:], 2)
    terms = zip(series.ratio, of_ratio, series.relaxation_time, of_time, strict=True)
    for number, (ratio, ratio_std, time, time_std) in enumerate(terms, 1):
        if math.isfinite(ratio_std) and math.isfinite(time_std):
            yield (
                f'term {number}: ratio {ratio:.6g} +- {ratio_std:.2g}, '
                f'time {time:.6g} +- {time_std:.2g} s'
            )


def _printed(series: PronySeries) -> list[tuple[str, float]]:
    """Return ratios, rounded so that they never add up to more than 1, and relaxation times."""
    scale = 10.0**_DIGITS
    ratios = np.floor(series.ratio * scale) / scale
    return [
        (f'{ratio:.{_DIGITS}f}', time)
        for ratio, time in zip(ratios.tolist(), series.relaxation_time.tolist(), strict=True)
    ]


def mujoco(model: Model, parameters: Mapping[str, float]) -> str:
    """
    Return the chain as a MuJoCo model: one slide joint in another for each link.

    Each joint has the spring, the dashpot and the dry friction of its link. The bodies between
    them need a mass that the chain does not have: it is as small as the time step can bear, and a
    spring without a dashpot gets one that stops its swing on that mass within milliseconds. The
    contact point has the mass of the effect `inertia` on top.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to float
        Its parameters in SI units, by name.

    Returns
    -------
    str
        MJCF. The height of the body named `surface` falls by the displacement height H.

    Raises
    ------
    UsageError
        If the model has a law that constant numbers cannot hold.

    """
    chain = links(model, parameters)
    if chain['laws']:
        raise UsageError(
            f'a MuJoCo joint has constant numbers and cannot hold {", ".join(chain["laws"])}: '
            'export json, which has their laws'
        )
    joints = chain['in_series'][::-1]
    mass = max(joint['stiffness_N_m'] for joint in joints) * (_STEPS_A_SWING * _STEP) ** 2
    lines = [
        '<mujoco model="hapticvision">',
        f'  <option timestep="{_STEP:g}" integrator="implicitfast" gravity="0 0 0"/>',
        '  <worldbody>',
    ]
    for depth, joint in enumerate(joints):
        pad = '  ' * (depth + 2)
        last = depth == len(joints) - 1
        here = mass + (chain['mass_kg'] if last else 0.0)
        damping = joint['damping_Ns_m'] or 2.0 * math.sqrt(joint['stiffness_N_m'] * mass)
        lines += [
            f'{pad}<body name="{"surface" if last else joint["name"]}">',
            f'{pad}  <joint name="{joint["name"]}" type="slide" axis="0 0 -1" '
            f'stiffness="{joint["stiffness_N_m"]:.{_DIGITS}g}" '
            f'damping="{damping:.{_DIGITS}g}" '
            f'frictionloss="{joint["dry_friction_N"]:.{_DIGITS}g}"{_HARD_FRICTION}/>',
            f'{pad}  <inertial pos="0 0 0" mass="{here:.{_DIGITS}g}" diaginertia="1 1 1"/>',
        ]
    lines += [f'{"  " * (depth + 2)}</body>' for depth in reversed(range(len(joints)))]
    lines.append('  </worldbody>')
    if chain['parallel_stiffness_N_m'] > 0.0:
        lines += [
            '  <tendon>',
            '    <fixed name="parallel" springlength="0" '
            f'stiffness="{chain["parallel_stiffness_N_m"]:.{_DIGITS}g}">',
            *(f'      <joint joint="{joint["name"]}" coef="1"/>' for joint in joints),
            '    </fixed>',
            '  </tendon>',
        ]
    lines.append('</mujoco>')
    return '\n'.join(lines) + '\n'


_STEP_FUNCTION: Final = '''\
#!/usr/bin/env python3
"""
{model}: displacement in, force out, a millisecond a step.

Import `stepper` into a renderer, or run the file: it reads the displacement of the tool beyond the
undeformed surface from its input, a number a line [m], and prints the force over the millisecond
in which the tool goes there, a number a line [N].
"""

import math
import sys

from hapticvision_ros import HapticStepper, Model

SOURCE = {source!r}
MODEL = {model!r}
PARAMETERS = {{
{parameters}
}}
"""In SI units."""
REFERENCE_DEPTH = {reference_depth!r}
"""Of the deepest push that was fitted [m]."""


def stepper() -> HapticStepper:
    """Return the body, untouched; its step(displacement, dt=0.001) returns the force."""
    return HapticStepper(Model.parse(MODEL), PARAMETERS, reference_depth=REFERENCE_DEPTH)


def main() -> int:
    """Answer displacements with forces until the input ends."""
    body = stepper()
    for number, line in enumerate(sys.stdin, 1):
        try:
            displacement = float(line)
        except ValueError:
            displacement = math.nan
        if not math.isfinite(displacement):
            print(f'line {{number}} is no finite number: {{line.strip()}}', file=sys.stderr)
            return 2
        print(body.step(displacement), flush=True)
    return 0


if __name__ == '__main__':
    try:
        sys.exit(main())
    except (BrokenPipeError, KeyboardInterrupt):
        sys.stderr.close()
        sys.exit(1)
'''


def step_function(
    model: Model,
    parameters: Mapping[str, float],
    reference_depth: float | None,
    source: str,
) -> str:
    """
    Return a Python file with the model as a step function (`hapticvision_ros.core.haptic`).

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to float
        Its parameters in SI units, by name.
    reference_depth : float or None
        Depth of the deepest push of the campaign [m].
    source : str
        What was fitted.

    Returns
    -------
    str
        A module that needs this package and can be run.

    Raises
    ------
    UsageError
        If the model cannot be taken step by step.

    """
    from hapticvision_ros.core.haptic import HapticStepper

    for name in model.names:
        value = parameters[name]
        if not value >= 0.0 or (name in ('K1', 'C2') and not 0.0 < value < math.inf):
            raise UsageError(f'{name} of the model is {value:g}, which no body can have')
    if reference_depth is not None and not math.isfinite(reference_depth):
        raise UsageError(f'the deepest push of the result is {reference_depth:g} m: fit it again')
    # Refuses what it cannot hold.
    HapticStepper(model, parameters, reference_depth=reference_depth)
    lines = [f'    {name!r}: {float(parameters[name])!r},' for name in model.names]
    return _STEP_FUNCTION.format(
        model=model.name,
        source=source,
        parameters='\n'.join(lines),
        reference_depth=reference_depth,
    )


def export(
    form: Format,
    model: Model,
    parameters: Mapping[str, Estimate],
    *,
    specimen: Specimen | None = None,
    poisson: float | None = None,
    shortest_time: float | None = None,
    point: Point | None = None,
    correlation: FloatArray | None = None,
    reference_depth: float | None = None,
    source: str = 'hapticvision_ros',
) -> str:
    """
    Return a fitted model in one of the formats.

    Parameters
    ----------
    form : {'json', 'csv', 'abaqus', 'ansys', 'mujoco', 'haptic'}
        All forms as JSON, the relaxation function as a table, a Prony series for one of two
        finite-element codes, a MuJoCo model, or a step function in Python for a haptic renderer.
    model : Model
        The model.
    parameters : mapping of str to Estimate
        Its parameters in SI units, by name.
    specimen : Specimen, optional
        What was pressed; finite-element codes need it.
    poisson : float, optional
        Poisson's ratio; finite-element codes need it.
    shortest_time : float, optional
        See `hapticvision_ros.core.relaxation.prony_series` [s].
    point : {'rest', 'reference'}, optional
        Where a nonlinear model is linearised.
    correlation : ndarray, shape (p, p), optional
        Of the parameters, in the order of the model, for the standard errors of the terms.
    reference_depth : float, optional
        Depth of the deepest push of the campaign [m]; a step function of damage or of a contact
        that grows counts from it.
    source : str
        What to name as the source of a Prony series or a step function.

    Returns
    -------
    str
        The content of a file.

    Raises
    ------
    UsageError
        If the format cannot hold the model, or something that it needs is missing.

    """
    if form == 'json':
        whole = document(model, parameters, specimen, point, correlation)
        return json.dumps(whole, indent=2, allow_nan=False, ensure_ascii=False) + '\n'
    values = known_values(model, parameters)
    if form == 'mujoco':
        return mujoco(model, values)
    if form == 'haptic':
        if (specimen, poisson, shortest_time, point) != (None, None, None, None):
            raise UsageError(
                'a step function is of the object as it was pressed: leave out area, height, '
                "Poisson's ratio, shortest time and linearisation"
            )
        return step_function(model, values, reference_depth, source)
    relaxation = relaxation_function(model, values, point)
    covariance = covariance_of(model, parameters, correlation)
    if form == 'csv':
        return csv(relaxation, _spread(model, values, covariance, point))
    if specimen is None or poisson is None:
        raise UsageError(
            f"{form} needs area and height of the specimen and Poisson's ratio: it works with "
            'moduli, not with stiffnesses'
        )
    series = prony_series(relaxation, shortest_time, specimen.modulus)
    remarks = [f'{model.name}, from {source}']
    if point is not None:
        remarks.append(f'linearised at: {point}')
    if relaxation.impulse > 0.0:
        remarks.append(f'nothing faster than {shortest_time:g} s is resolved')

    def numbers(changed: Mapping[str, float]) -> FloatArray:
        one = prony_series(
            relaxation_function(model, changed, point), shortest_time, specimen.modulus
        )
        return np.concatenate(([one.instantaneous], one.ratio, one.relaxation_time))

    std = standard_errors(numbers, values, covariance)
    remarks += _errors_told(series, std)
    if not np.all(np.isfinite(std)):
        remarks.append(f'standard errors: {_why_unknown(model, parameters, correlation)}')
    return (abaqus if form == 'abaqus' else ansys)(series, poisson, remarks)
