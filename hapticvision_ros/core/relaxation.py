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
The relaxation function of the chain: its poles and residues, and the Prony series made of it.

The elements in a row have the compliance

    ``D(s) = 1/K_0 + sum_i 1 / (K_i + C_i s) + 1 / (C2 s)``,

whose poles lie at minus the retardation rates ``lambda_i = K_i / C_i`` (0 for C2), each with the
weight ``1 / C_i``. Between two neighbouring poles D grows from minus to plus infinity, so that it
has one zero there, at minus a relaxation rate ``r_k``, and one more beyond the fastest pole where
there is a K_0. So bracketed, each zero is found to the last digits, however far apart the rates
are. The force under a displacement is that of a dashpot and a spring beside Maxwell branches:

    ``Q(s) = K_p + 1 / D(s) = K_inf + eta s + sum_k K_k s / (s + r_k)``,

    ``K_k = -1 / (r_k dD/ds(-r_k))``, ``K_inf = Q(0)``, ``1 / eta = sum 1 / C``,

with eta only without K_0. In time this is ``K(t) = K_inf + eta delta(t) + sum K_k exp(-r_k t)``,
for the three-element chain the identity of `hapticvision_ros.core.models.three_element`.

References
----------
N. W. Tschoegl, The Phenomenological Theory of Linear Viscoelastic Behavior, 1989, ch. 3 and 8
(poles and zeros interlace); R. M. Christensen, Theory of Viscoelasticity, 2nd ed., 1982, ch. 1.

"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Final, Literal

from hapticvision_ros.core.composition import BASE_PARAMETERS, Model
from hapticvision_ros.core.effects.declaration import Draft
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.models.chain import Slot
from hapticvision_ros.core.records import FloatArray
import numpy as np

type Point = Literal['rest', 'reference']
"""
Where a nonlinear body is taken to be linear: at `rest`, that is for small loads on the undeformed
body, or at the `reference` of its parameters (see `relaxation_function`).
"""

POINTS: Final[tuple[Point, ...]] = ('rest', 'reference')

NONLINEAR: Final = frozenset(
    {
        'yield_force',
        'shear_thinning',
        'strain_stiffening',
        'damage',
        'contact_growth',
        'exponential_stiffening',
    }
)
LINEAR: Final = frozenset({'series_spring', 'parallel_spring', 'second_retardation', 'springpot'})
_BESIDE: Final = frozenset({'ageing', 'adhesion', 'inertia'})
"""Effects of the object that leave the chain at the start of the campaign as it is."""
_NOT_AT_REST: Final = {
    'contact_growth': 'a contact patch of no size carries no force',
    'shear_thinning': 'a power law has no viscosity at rest',
}
_SAME: Final = 1e-12
"""Relative difference below which two retardation rates are one."""
_DIGITS: Final = 4.0 * np.finfo(np.float64).eps
_STEP: Final = 1e-4
"""Share of a parameter by which it is moved for a slope: errors of 1e-8 in standard errors."""
_MOST_ITERATIONS: Final = 2000
"""Enough to halve the way between two rates that are 600 powers of ten apart."""


@dataclass(frozen=True, slots=True)
class RelaxationFunction:
    """
    Force over a step of the displacement: K(t) = K_inf + eta delta(t) + sum K_k exp(-t / T_k).

    Parameters
    ----------
    long_term : float
        K_inf [N/m]; zero for a body that flows.
    impulse : float
        eta [N.s/m]: a dashpot beside all the rest; zero where a spring is in series.
    stiffness : ndarray, shape (n,)
        K_k [N/m].
    relaxation_time : ndarray, shape (n,)
        T_k [s], from the longest to the shortest.

    """

    long_term: float
    impulse: float
    stiffness: FloatArray
    relaxation_time: FloatArray

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return K at times `t` above zero [N/m]; the impulse is over then."""
        decay = np.exp(-t[:, np.newaxis] / self.relaxation_time)
        return np.asarray(self.long_term + decay @ self.stiffness, dtype=np.float64)

    @property
    def instantaneous(self) -> float:
        """Return the stiffness against a sudden displacement [N/m]; infinite with an impulse."""
        return math.inf if self.impulse > 0.0 else self.long_term + float(self.stiffness.sum())

    def without_impulse(self, shortest_time: float) -> 'RelaxationFunction':
        """
        Return the function with the impulse as one more, fast branch.

        Parameters
        ----------
        shortest_time : float
            The relaxation time of that branch [s], positive; its stiffness is eta over it.

        Returns
        -------
        RelaxationFunction
            The same where there is no impulse. Else the force after a change of the speed is that
            of the body after a few times `shortest_time`, and smaller before.

        """
        if self.impulse == 0.0:
            return self
        return RelaxationFunction(
            self.long_term,
            0.0,
            np.append(self.stiffness, self.impulse / shortest_time),
            np.append(self.relaxation_time, shortest_time),
        )


@dataclass(frozen=True, slots=True)
class PronySeries:
    """
    A relaxation function as finite-element codes take it.

    Parameters
    ----------
    instantaneous : float
        The modulus or stiffness at t = 0.
    ratio : ndarray, shape (n,)
        g_k: what relaxes with each time, as a share of `instantaneous`.
    relaxation_time : ndarray, shape (n,)
        [s].

    """

    instantaneous: float
    ratio: FloatArray
    relaxation_time: FloatArray

    @property
    def long_term_ratio(self) -> float:
        """Return what never relaxes, as a share of `instantaneous`."""
        return max(1.0 - float(self.ratio.sum()), 0.0)

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the modulus at times `t` [s], in the unit of `instantaneous`."""
        gone = -np.expm1(-t[:, np.newaxis] / self.relaxation_time) @ self.ratio
        return np.asarray(self.instantaneous * (1.0 - gone), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class _AtTheStart:
    """A trial at the start of the campaign, as an effect's term in the chain asks for one."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    campaign_time: float = 0.0
    reference_depth: float = 1.0
    depth_before: float = 0.0
    zero_time: float = 0.0


def relaxation_function(
    model: Model, parameters: Mapping[str, float], point: Point | None = None
) -> RelaxationFunction:
    """
    Return the relaxation function of the object that a model describes.

    Effects of the cell and of the sensors, adhesion and inertia are not of the chain and are left
    out; ageing is taken at the start of the campaign; a springpot is the sum of exponentials that
    the forward model has for it.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to float
        All its parameters in SI units, by name.
    point : {'rest', 'reference'}, optional
        Where a nonlinear effect is linearised. At `rest` the slider holds, so that C2 does not
        flow, and K1 is as it is without stretch. At the `reference` C2 flows (its force counts
        from F_y on, and is proportional to the rate with the viscosity at 1 mm/s), the patch is
        that of the depth d_ref, and K1 is neither stiffened nor harmed. A force that grows
        exponentially with the depth is that of a small depth at both.

    Returns
    -------
    RelaxationFunction
        Exact to rounding.

    Raises
    ------
    UsageError
        If the model is nonlinear and no point is given, or has no linear limit there.

    """
    for effect in model.declared:
        if effect.kind == 'object' and effect.named not in LINEAR | NONLINEAR | _BESIDE:
            raise UsageError(f'{effect.name} has no relaxation function in this version')
    nonlinear = [effect.named for effect in model.declared if effect.named in NONLINEAR]
    if nonlinear and point is None:
        raise UsageError(
            f'a relaxation function is linear and the body with {", ".join(nonlinear)} is not: '
            f'choose the point at which to linearise it, {" or ".join(POINTS)}'
        )
    if point == 'rest':
        for name in nonlinear:
            if name in _NOT_AT_REST:
                raise UsageError(
                    f'the body with {name} has no linear limit at rest, as {_NOT_AT_REST[name]}: '
                    'linearise at the reference'
                )
    draft = linear_chain(model, parameters)
    blocked = point == 'rest' and 'yield_force' in nonlinear
    return _partial_fractions(draft, blocked)


def prony_series(
    relaxation: RelaxationFunction, shortest_time: float | None = None, scale: float = 1.0
) -> PronySeries:
    """
    Return a relaxation function as a Prony series.

    A Prony series has a finite modulus at t = 0, so that it cannot hold the impulse eta delta(t)
    of a chain without a series spring. In its place stands a branch that relaxes within a shortest
    time, which the user names: forces that change more slowly are those of the chain.

    Parameters
    ----------
    relaxation : RelaxationFunction
        The function.
    shortest_time : float, optional
        Needed, and above zero, where there is an impulse [s].
    scale : float
        Factor on the stiffness: h/A for a modulus.

    Returns
    -------
    PronySeries
        The terms, from the longest to the shortest time.

    Raises
    ------
    UsageError
        If there is an impulse and no shortest time, or one that is longer than a relaxation time.

    """
    if relaxation.impulse > 0.0:
        if shortest_time is None:
            raise UsageError(
                'the body resists a sudden displacement like a dashpot of '
                f'{relaxation.impulse:.4g} N.s/m, which no Prony series holds: name the shortest '
                'time that the simulation is to resolve'
            )
        fastest = float(relaxation.relaxation_time.min(initial=math.inf))
        if not 0.0 < shortest_time < fastest:
            raise UsageError(
                f'the shortest time is {shortest_time:g} s: it must be above zero and below the '
                f'shortest relaxation time of {fastest:.4g} s'
            )
        relaxation = relaxation.without_impulse(shortest_time)
    instantaneous = relaxation.instantaneous
    return PronySeries(
        scale * instantaneous, relaxation.stiffness / instantaneous, relaxation.relaxation_time
    )


def standard_errors(
    numbers: Callable[[Mapping[str, float]], FloatArray],
    parameters: Mapping[str, float],
    covariance: FloatArray,
) -> FloatArray:
    """
    Return the standard errors of what is computed from parameters, to first order.

    Parameters
    ----------
    numbers : callable
        Takes the parameters, and returns an array of shape (m,).
    parameters : mapping of str to float
        The q parameters, in SI units.
    covariance : ndarray, shape (q, q)
        Of them; not a number where it is unknown.

    Returns
    -------
    ndarray, shape (m,)
        Not a number where an error matters that is unknown, and everywhere if there are more or
        fewer numbers when a parameter is a little different.

    """
    size = numbers(parameters).size
    std = np.sqrt(np.diag(covariance))
    known = np.isfinite(std)
    slopes = np.zeros((len(parameters), size))
    for row, (name, value) in enumerate(parameters.items()):
        step = _STEP * (abs(value) or (float(std[row]) if known[row] else 0.0) or 1.0)
        ahead, behind = (numbers({**parameters, name: value + one}) for one in (step, -step))
        if ahead.size != size or behind.size != size:
            return np.full(size, math.nan)
        slopes[row] = (ahead - behind) / (2.0 * step)
    spread = covariance[np.ix_(known, known)]
    variance = np.einsum('im,ij,jm->m', slopes[known], spread, slopes[known])
    lost = np.any(slopes[~known] != 0.0, axis=0)
    return np.where(lost, math.nan, np.sqrt(np.maximum(variance, 0.0)))


def linear_chain(model: Model, parameters: Mapping[str, float]) -> Draft:
    """Return the chain with those effects that are linear elements of it."""
    values = [parameters[name] for name in model.names]
    draft = Draft.of(*values[: len(BASE_PARAMETERS)])
    trial = _AtTheStart(np.zeros(1), np.zeros(1), np.zeros(0))
    first = len(BASE_PARAMETERS)
    for effect in model.declared:
        last = first + len(effect.parameters)
        if effect.name in LINEAR and effect.shape is not None:
            effect.shape(draft, [complex(value) for value in values[first:last]], trial)
        first = last
    return draft


def _partial_fractions(draft: Draft, blocked: bool) -> RelaxationFunction:
    """Return K_p + 1 / D(s) as a spring, a dashpot and Maxwell branches."""
    slots = draft.real_slots
    compliance = float(slots[Slot.SERIES_COMPLIANCE])
    units = [(float(slots[Slot.K1]), float(slots[Slot.C1]))]
    units += [(stiffness.real, viscosity.real) for stiffness, viscosity in draft.units]
    units = [(K, C) for K, C in units if math.isfinite(K) and math.isfinite(C)]
    compliance += sum(1.0 / K for K, C in units if C == 0.0)
    poles = [(K / C, 1.0 / C) for K, C in units if C > 0.0]
    if not blocked:
        poles.append((0.0, 1.0 / float(slots[Slot.C2])))
    rates, weights = _merged(poles)
    flows = bool(rates.size) and rates[0] == 0.0
    long_term = float(slots[Slot.PARALLEL_STIFFNESS])
    if not flows:
        long_term += 1.0 / (compliance + float(np.sum(weights / rates)))
    zeros = [_zero(rates, weights, compliance, left) for left in range(rates.size - 1)]
    if compliance > 0.0 and rates.size:
        zeros.append(_last_zero(rates, weights, compliance))
    r = np.array(zeros)
    slope = np.sum(weights / (rates - r[:, np.newaxis]) ** 2, axis=1)
    return RelaxationFunction(
        long_term=long_term,
        impulse=1.0 / float(weights.sum()) if compliance == 0.0 else 0.0,
        stiffness=1.0 / (r * slope),
        relaxation_time=1.0 / r,
    )


def _merged(poles: Sequence[tuple[float, float]]) -> tuple[FloatArray, FloatArray]:
    """Return increasing rates and their weights, equal rates as one."""
    rates: list[float] = []
    weights: list[float] = []
    for rate, weight in sorted(poles):
        if rates and rate - rates[-1] <= _SAME * rate:
            weights[-1] += weight
        else:
            rates.append(rate)
            weights.append(weight)
    return np.array(rates), np.array(weights)


def _zero(rates: FloatArray, weights: FloatArray, compliance: float, left: int) -> float:
    """Return the relaxation rate between two neighbouring retardation rates."""
    a, b = float(rates[left]), float(rates[left + 1])
    others = np.delete(np.arange(rates.size), [left, left + 1])

    def without_poles(r: float) -> float:
        # D (a - r) (b - r): finite at both ends, and of opposite sign.
        rest = compliance + float(np.sum(weights[others] / (rates[others] - r)))
        both = float(weights[left]) * (b - r) + float(weights[left + 1]) * (a - r)
        return both + rest * (a - r) * (b - r)

    return _root(without_poles, a, b)


def _last_zero(rates: FloatArray, weights: FloatArray, compliance: float) -> float:
    """Return the relaxation rate beyond the fastest retardation rate."""
    a = float(rates[-1])

    def without_pole(r: float) -> float:
        rest = compliance + float(np.sum(weights[:-1] / (rates[:-1] - r)))
        return float(weights[-1]) + rest * (a - r)

    # At this rate all weights would be at the fastest pole.
    return _root(without_pole, a, a + 1.01 * float(weights.sum()) / compliance)


def _root(function: Callable[[float], float], a: float, b: float) -> float:
    """Return where a function changes its sign, to the last digits."""
    from scipy.optimize import brentq

    return float(brentq(function, a, b, xtol=1e-300, rtol=_DIGITS, maxiter=_MOST_ITERATIONS))
