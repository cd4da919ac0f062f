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
The response of the whole chain of elements to a measured tool motion, with its sensitivities.

::

                    +--------------------- K_p ----------------------+
    tool --- K_m ---|                                                |--- support
                    +-- K_0 --+-- K1 --+--+-- K_i --+-- flow unit --+
                              +-- C1 --+  +-- C_i --+   (i = 1..n)

The elements in a row carry one force, the chain force F_c. The flow unit is the dashpot C2, which
a Saint-Venant slider of threshold F_y (Bingham) or a power law of index n changes; K1 grows with
its stretch (beta) and is lost with the largest stretch so far (D); the force scales with the
penetration (m). With every effect at its zero strength this is the three-element model of the
paper, eqs. (1)-(3).

The unknown of a step is the stretch u that K1 gains in it, from which follow the mean chain force
over the step and, by it, everything else; one scalar, monotone equation says that the stretches
add up to the tool's displacement. The mean force over a step is what a load cell reports that
averages between its samples. It is preferred to the force at the step's ends because the force of
a chain without K_0 jumps with the tool's speed, and an end-point rule of second order answers a
jump with an undamped ringing. The first unit and the flow unit are advanced by their exact
solution under a tool of constant speed, or free of force, which makes the three-element model
exact for steps of any length; further Kelvin-Voigt units by theirs under a constant force; the
compliances K_0 and K_m, and the speed of a freed mass, by the exponentially fitted rule, which is
the trapezoidal rule for a short step and the implicit Euler rule for a long one. What the force of
the compliances falls to goes on itself, by what the Kelvin-Voigt units yield: the rule is that of
a force that falls to a straight line.

Touch and loss of contact fall inside steps: a step is split there, so that force and surface are
continuous and differentiable functions of the contact offset, the pull-off force and all others.
The loss is where a straight line through the force meets the pull-off force, and earlier where
the chain relaxes so fast within the step that the part up to there would pull on average. A tool
that does not withdraw is left by no force that only relaxes. A cohesive zone goes on to pull at
the surface, with the pull-off force, until it has opened, or less as it opens; by how much it does
so within a step follows from how fast the surface went in the step before.
The mass M takes the tool's speed at the touch and, once free, swings on the chain until the tool
meets it again; a corner of the tool's path is passed within one step, over which the load cell
averages the blow.

References
----------
J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed., 1980, ch. 1 (units in series); M.
Reiner, Deformation, Strain and Flow, 1960 (Bingham); E. Hairer and G. Wanner, Solving Ordinary
Differential Equations II, 2nd ed., 1996, IV.8 (implicit mid-point), and W. Liniger and R. A.
Willoughby, SIAM J. Numer. Anal. 7, 1970, 47-66, doi:10.1137/0707002 (exponential fitting).

"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

REFERENCE_RATE: Final = 1e-3
"""Rate [m/s] at which a power-law dashpot has the viscosity C2: 1 mm/s, a usual push."""


class Slot(IntEnum):
    """Where a quantity stands in the vector that the integrator reads."""

    K1 = 0
    """Stiffness of the first Kelvin-Voigt unit [N/m]."""
    C1 = 1
    """Viscosity of the first Kelvin-Voigt unit [N.s/m]; zero for a spring."""
    C2 = 2
    """Viscosity of the flow unit [N.s/m]."""
    YIELD_FORCE = 3
    """Threshold of the slider beside C2 [N]."""
    FLOW_INDEX = 4
    """Exponent n of the flow unit, F = C2 v_ref (v / v_ref)^n [-]; 1 is a dashpot."""
    STIFFENING = 5
    """beta of K1 (1 + beta z^2) [1/m^2]."""
    DAMAGE = 6
    """Share of K1 that is lost where its stretch reaches d_ref, at the first rate of loss [-]."""
    SERIES_COMPLIANCE = 7
    """1 / K_0 [m/N]."""
    MACHINE_COMPLIANCE = 8
    """1 / K_m [m/N]."""
    PARALLEL_STIFFNESS = 9
    """K_p [N/m]."""
    CONTACT_EXPONENT = 10
    """m of the factor (H / d_ref)^m on the force of the chain [-]."""
    REFERENCE_DEPTH = 11
    """d_ref [m], a constant of the campaign."""
    ADHESION = 12
    """Pull-off force F_ad [N]."""
    OFFSET = 13
    """How much deeper the tool is than its measured displacement [m]."""
    MASS = 14
    """M, which moves with the surface [kg]."""
    OPENING = 15
    """How far tool and surface are apart where F_ad lets go [m]; zero where it does so at once."""
    DECAY = 16
    """Opening over which F_ad falls to 1/e instead [m]; zero where it does not."""
    STRETCHED = 17
    """Largest stretch of K1 before the trial [m]."""
    SATURATION = 18
    """How often the rate of loss falls to 1/e until d_ref [-]; zero where it does not fall."""


def neutral() -> FloatArray:
    """
    Return the vector of slots in which every effect is absent.

    Returns
    -------
    ndarray, shape (19,)
        Zeros, a Newtonian dashpot, and ones for K1, C2 and the reference depth.

    """
    slots = np.zeros(len(Slot))
    slots[[Slot.K1, Slot.C2, Slot.FLOW_INDEX, Slot.REFERENCE_DEPTH]] = 1.0
    return slots


@dataclass(frozen=True, slots=True)
class Chain:
    """
    The numbers of a chain; or p directions in their space, one in each row.

    Parameters
    ----------
    slots : ndarray, shape (19,) or (p, 19)
        One number for each `Slot`.
    unit_stiffness, unit_viscosity : ndarray, shape (n,) or (p, n)
        K_i [N/m] and C_i [N.s/m] of the further Kelvin-Voigt units.

    """

    slots: FloatArray
    unit_stiffness: FloatArray
    unit_viscosity: FloatArray


@dataclass(frozen=True, slots=True)
class Response:
    """
    What the chain answers to a tool motion of n steps, and to p directions.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Mean contact force over each step [N].
    surface : ndarray, shape (n + 1,)
        Displacement height H of the surface at the ends of the steps [m].
    force_tangent : ndarray, shape (p, n)
        Derivative of `force` along each direction.
    surface_tangent : ndarray, shape (p, n + 1)
        Derivative of `surface` along each direction.

    """

    force: FloatArray
    surface: FloatArray
    force_tangent: FloatArray
    surface_tangent: FloatArray


def respond(
    t: FloatArray, displacement: FloatArray, chain: Chain, directions: Chain | None = None
) -> Response:
    """
    Return the response of a chain that starts at rest.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the steps [s], increasing.
    displacement : ndarray, shape (n + 1,)
        Tool displacement beyond the first touch at `t` [m], linear in between; negative in air.
    chain : Chain
        The numbers.
    directions : Chain, optional
        Directions in the space of the numbers, for the sensitivities.

    Returns
    -------
    Response
        Force and surface, and their derivatives along the directions.

    """
    if directions is None:
        none = np.empty((0, chain.unit_stiffness.size))
        directions = Chain(_NOWHERE, none, none)
    n, p = t.size - 1, directions.slots.shape[0]
    response = Response(np.empty(n), np.empty(n + 1), np.empty((p, n)), np.empty((p, n + 1)))
    _respond(
        t,
        displacement,
        chain.slots,
        chain.unit_stiffness,
        chain.unit_viscosity,
        directions.slots,
        directions.unit_stiffness,
        directions.unit_viscosity,
        response.force,
        response.surface,
        response.force_tangent,
        response.surface_tangent,
    )
    return response


_NOWHERE: Final = np.empty((0, len(Slot)))
# The enum is not known to the compiler; these are its values as constants.
_K1 = int(Slot.K1)
_C1 = int(Slot.C1)
_C2 = int(Slot.C2)
_FY = int(Slot.YIELD_FORCE)
_N = int(Slot.FLOW_INDEX)
_BETA = int(Slot.STIFFENING)
_D = int(Slot.DAMAGE)
_C0 = int(Slot.SERIES_COMPLIANCE)
_CM = int(Slot.MACHINE_COMPLIANCE)
_KP = int(Slot.PARALLEL_STIFFNESS)
_M = int(Slot.CONTACT_EXPONENT)
_DREF = int(Slot.REFERENCE_DEPTH)
_FAD = int(Slot.ADHESION)
_OFF = int(Slot.OFFSET)
_MASS = int(Slot.MASS)
_OPEN = int(Slot.OPENING)
_DECAY = int(Slot.DECAY)
_STRETCHED = int(Slot.STRETCHED)
_SATURATION = int(Slot.SATURATION)

_TOLERANCE = 1e-6
"""Relative change of u at which Newton's iteration may take its last, quadratic step."""
_SMALLEST = 1e-16
"""Absolute change of u [m] at which it may."""
_MOST_ITERATIONS = 60
_SHORTENED = 8
"""How often the part of a step before the loss is shortened where it pulls."""
_LOOK, _FIRST, _SURE, _LAST, _REST, _CAUGHT = range(6)
"""
A step, as it is looked at; its first instant; decided; in contact up to the loss; what is after a
part; held back until the tool is there again.
"""
_INSTANT = 1e-2
"""Share of a step that is its first instant."""
_NEAR = 5e-3
"""Relative distance within which six terms of the binomial series are exact to 1e-13."""
_SHORTEST = 1e-6
"""Share of a step that a part of it has at least."""
_FADED = 20.0
"""Opening over that of its decay at which a pull has gone: two billionths are left."""
_SAME = 1e-9
"""Relative difference between two steps that makes none."""
_B_E, _B_FLOW, _B_END, _B_K1, _B_C0, _B_CM, _B_KP, _B_OFF, _B_MASS = range(9)
_B_Z_Z, _B_Z_D, _B_F_Z, _B_F_D, _BENT = range(9, 14)
"""
Derivatives along a direction: of e, h / C2 and kappa, and of numbers; of what z and the force take
from z and from the tool's way; their count.
"""


@kernel(inline='always', error_model='numpy')
def _memory_weight(k, c1, h, against):  # type: ignore[no-untyped-def]
    """
    Return e in F_mean = k z + e u, its slope in k, and k x b'(x) for its others.

    It is e = k b(x) + C1 / h, b(x) = 1 / (1 - exp(-x)) - 1 / x, x = h k / against: exact while z
    falls back by k against that viscosity, which is C1 + C2 where the tool holds the chain and C1
    where it is free; b is 1/2, the mid-point rule, for a short step.
    """
    if against == 0.0:
        return k, 1.0, 0.0
    x = h * k / against
    if x < 0.3:
        # The closed form loses digits here; the next term of the series is below 1e-12.
        x2 = x * x
        value = 0.5 + x * (1.0 / 12.0 - x2 * (1.0 / 720.0 - x2 * (1.0 / 30240.0 - x2 / 1209600.0)))
        slope = 1.0 / 12.0 - x2 * (1.0 / 240.0 - x2 * (1.0 / 6048.0 - x2 / 172800.0))
    else:
        kept = np.exp(-x)
        gone = 1.0 - kept
        value = 1.0 / gone - 1.0 / x
        slope = 1.0 / (x * x) - kept / (gone * gone)
    return k * value + c1 / h, value + x * slope, k * x * slope


@kernel(inline='always', error_model='numpy')
def _gone(x):  # type: ignore[no-untyped-def]
    """Return 1 - exp(-x) for x >= 0: most units are much slower than a step, or much faster."""
    if x < 0.1:
        # The next term of the series is below 3e-14.
        x2 = x * x
        even = 1.0 + x2 * (1.0 / 6.0 + x2 * (1.0 / 120.0 + x2 * (1.0 / 5040.0)))
        odd = 0.5 + x2 * (1.0 / 24.0 + x2 * (1.0 / 720.0 + x2 * (1.0 / 40320.0)))
        return x * (even - x * odd)
    if x > 40.0:
        return 1.0
    return -np.expm1(-x)


@kernel(error_model='numpy')
def _end_weight(r):  # type: ignore[no-untyped-def]
    """
    Return kappa in F_end = F_start + kappa (F_mean - F_start), and its derivative.

    It is that of an F which decays with r times the step's length as its time constant: 2 for a
    slow one (trapezoidal rule), 1 for a fast one (implicit Euler rule).
    """
    if r > 100.0:
        return 2.0 - 1.0 / (3.0 * r), 1.0 / (3.0 * r * r)
    if r < 1e-3:
        return 1.0 / (1.0 - r), 1.0 / (1.0 - r) ** 2
    kept = np.exp(-1.0 / r)
    gone = -np.expm1(-1.0 / r)
    left = 1.0 - gone * r
    d_gone = -kept / (r * r)
    return gone / left, (d_gone * left + gone * (d_gone * r + gone)) / (left * left)


@kernel(error_model='numpy')
def _held(gap, more, opening, decay):  # type: ignore[no-untyped-def]
    """
    Return by which part of it the pull-off force holds, in the mean over a step.

    Also its derivatives in the opening where the step begins, in what opens in the step, and in
    the length of the law; and whether the zone is still there where the step ends.
    """
    if decay <= 0.0:
        if more <= 0.0:
            return 1.0, 0.0, 0.0, 0.0, True
        part = (opening - gap) / more
        if part >= 1.0 or part <= 0.0:
            return min(max(part, 0.0), 1.0), 0.0, 0.0, 0.0, part >= 1.0
        return part, -1.0 / more, -part / more, 1.0 / more, False
    start = gap / decay
    if start > _FADED:
        return 0.0, 0.0, 0.0, 0.0, False
    turns = more / decay
    kept = np.exp(-start)
    if abs(turns) < _NEAR:
        mean = kept * (1.0 - turns * (0.5 - turns * (1.0 / 6.0 - turns / 24.0)))
        slope = -kept * (0.5 - turns * (1.0 / 3.0 - turns / 8.0))
    else:
        left = np.exp(-turns)
        mean = kept * (1.0 - left) / turns
        slope = kept * (left * (1.0 + turns) - 1.0) / (turns * turns)
    d_length = (start * mean - turns * slope) / decay
    return mean, -mean / decay, slope / decay, d_length, gap + more < _FADED * decay


@kernel(error_model='numpy')
def _paces(k1, c1, ku, cu):  # type: ignore[no-untyped-def]
    """Return k / c and k / c^2 of the first unit and the others, zeros for springs."""
    pace = np.zeros(ku.size + 1)
    give = np.zeros(ku.size + 1)
    for k in range(ku.size + 1):
        viscosity = c1 if k == 0 else cu[k - 1]
        if viscosity > 0.0:
            pace[k] = (k1 if k == 0 else ku[k - 1]) / viscosity
            give[k] = pace[k] / viscosity
    return pace, give


@kernel(error_model='numpy')
def _lead(  # type: ignore[no-untyped-def]
    h, pace, give, d_pace, d_give, solidity, d_fluid, lead, lead_h, d_lead
):
    """
    Set how fast that rises to which the force of the compliances falls within a step.

    It is (v + sum k z / c) / fluidity for a tool of speed v, and rises as the units yield to it,
    each by no more than it has to: by `lead` times v and the z of the units, all in a row.
    `lead_h` is its slope in the length of the step, `d_lead` along the directions. Of the units
    it takes what `_paces` returns, with its derivatives; and 1 / fluidity, whose relative change
    along a direction is `-d_fluid`.
    """
    directions = d_lead.shape[0]
    d_lead[:, 0] = 0.0
    yields = 0.0
    yields_h = 0.0
    for k in range(pace.size):
        if pace[k] == 0.0:
            continue
        x = pace[k] * h
        gone = _gone(x)
        part = gone / x
        part_x = (1.0 - gone - part) / x
        if x < 1e-3:
            part_x = x / 3.0 - 0.5
        squared = pace[k] * pace[k] * solidity
        yields += part * give[k]
        yields_h += part_x * pace[k] * give[k]
        lead[1 + k] = -part * squared
        lead_h[1 + k] = -part_x * pace[k] * squared
        for j in range(directions):
            d_part = part_x * h * d_pace[j, k]
            d_lead[j, 0] += d_part * give[k] + part * d_give[j, k]
            d_both = d_part * pace[k] + 2.0 * part * d_pace[j, k]
            d_lead[j, 1 + k] = part * squared * d_fluid[j] - d_both * pace[k] * solidity
    share = yields * solidity
    for j in range(directions):
        d_lead[j, 0] = d_lead[j, 0] * solidity - share * d_fluid[j]
    for k in range(pace.size):
        if pace[k] == 0.0:
            continue
        lead[1 + k] += pace[k] * share * solidity
        lead_h[1 + k] += pace[k] * yields_h * solidity * solidity
        for j in range(directions):
            change = d_pace[j, k] * share + pace[k] * (d_lead[j, 0] - share * d_fluid[j])
            d_lead[j, 1 + k] += change * solidity
    lead[0] = share * solidity
    lead_h[0] = yields_h * solidity * solidity
    for j in range(directions):
        d_lead[j, 0] = d_lead[j, 0] * solidity - lead[0] * d_fluid[j]


@kernel(inline='always', error_model='numpy')
def _worn(stretch, saturation, d_ref):  # type: ignore[no-untyped-def]
    """Return the loss of K1 by its largest stretch, over D, and the slopes in both."""
    part = stretch / d_ref
    if saturation == 0.0:
        return part, 1.0 / d_ref, -0.5 * part * part
    rate = np.exp(-saturation * part)
    loss = -np.expm1(-saturation * part) / saturation
    return loss, rate / d_ref, (part * rate - loss) / saturation


@kernel(inline='always', error_model='numpy')
def _retarded_unit(  # type: ignore[no-untyped-def]
    u, z, z_max, h, k1, c1, against, beta, damage, saturation, d_ref
):
    """Return mean force, its slope in u, stiffness, its slope in z, the weight's two, middle."""
    middle = z + 0.5 * u
    stiffening = 1.0 + beta * middle * middle
    worn, wears, _bends = _worn(max(middle, z_max), saturation, d_ref)
    left = 1.0 - damage * worn
    d_left = -damage * wears if middle > z_max else 0.0
    k = k1 * stiffening * left
    dk = k1 * (2.0 * beta * middle * left + stiffening * d_left)
    e, e_k, e_x = _memory_weight(k, c1, h, against)
    return k * z + e * u, e + 0.5 * dk * (z + e_k * u), k, dk, e_k, e_x, middle


@kernel(error_model='numpy')
def _anchor(x, p, series):  # type: ignore[no-untyped-def]
    """Set out 1 / x, x^p and the binomial coefficients of p, for powers near x."""
    series[0] = 1.0 / x
    series[1] = x**p
    term = 1.0
    for k in range(1, 7):
        term *= (p - k + 1.0) / k
        series[1 + k] = term


@kernel(inline='always', error_model='numpy')
def _power(x, p, series):  # type: ignore[no-untyped-def]
    """Return x^p, by the binomial series where x is near the last anchor."""
    r = x * series[0] - 1.0
    if abs(r) > _NEAR:
        _anchor(x, p, series)
        return series[1]
    tail = series[4] + r * (series[5] + r * (series[6] + r * series[7]))
    return series[1] * (1.0 + r * (series[2] + r * (series[3] + r * tail)))


@kernel(inline='always', error_model='numpy')
def _flow_unit(force, c2, f_y, p, series):  # type: ignore[no-untyped-def]
    """Return the rate of the flow unit, its slope, and the force beyond the threshold."""
    if f_y == 0.0 and p == 1.0:
        return force / c2, 1.0 / c2, abs(force)
    excess = abs(force) - f_y
    if excess <= 0.0:
        return 0.0, 0.0, excess
    if p == 1.0:
        rate = excess / c2
        slope = 1.0 / c2
    else:
        rate = REFERENCE_RATE * _power(excess / (c2 * REFERENCE_RATE), p, series)
        slope = p * rate / excess
    if force < 0.0:
        rate = -rate
    return rate, slope, excess


@kernel(error_model='numpy', inline='always')
def _fallen(kept, stretch):  # type: ignore[no-untyped-def]
    """Return what is left of the further units' stretches after a step free of force."""
    total = 0.0
    for k in range(kept.size):
        total += kept[k] * stretch[k]
    return total


@kernel(error_model='numpy', inline='always')
def _fallen_tangent(j, give, d_force, kept, d_stretch):  # type: ignore[no-untyped-def]
    """Take tangent j of the further units from one step, with its force, into the next."""
    total = 0.0
    for k in range(kept.size):
        d_stretch[j, k] = kept[k] * (d_stretch[j, k] + give[k] * d_force)
        total += d_stretch[j, k]
    return total


@kernel(error_model='numpy', inline='always')
def _bent_tangent(j, d_kept, stretch, d_give, force, d_stretch):  # type: ignore[no-untyped-def]
    """Add what direction j changes of the further units themselves; return the sum of it."""
    total = 0.0
    for k in range(stretch.size):
        change = d_kept[j, k] * stretch[k] + d_give[j, k] * force
        d_stretch[j, k] += change
        total += change
    return total


@kernel(error_model='numpy', fastmath={'contract', 'reassoc'})
def _respond(  # type: ignore[no-untyped-def]
    t, d, q, ku, cu, dq, dku, dcu, force, surface, d_force, d_surface
):
    steps = t.size - 1
    units = ku.size
    directions = dq.shape[0]
    k1, c1, c2, f_y = q[_K1], q[_C1], q[_C2], q[_FY]
    beta, damage, saturation, d_ref = q[_BETA], q[_D], q[_SATURATION], q[_DREF]
    c0, cm, kp, m = q[_C0], q[_CM], q[_KP], q[_M]
    f_ad, offset, opening, decay = q[_FAD], q[_OFF], q[_OPEN], q[_DECAY]
    p = 1.0 / q[_N]
    plain = beta == 0.0 and damage == 0.0
    linear = plain and p == 1.0 and f_y == 0.0 and m == 0.0
    c2_inverse = 1.0 / c2
    k1_inverse = 1.0 / k1
    d_ref_inverse = 1.0 / d_ref
    mass = q[_MASS]
    massive = mass > 0.0
    for j in range(directions):
        massive = massive or dq[j, _MASS] != 0.0

    # The compliances relax against the viscosities beside them, at the rate fluidity / compliance;
    # so does the speed of the mass, which without C1 and K_0 the spring K1 holds.
    compliance = c0 + cm
    stiff = 0.0 if c1 > 0.0 else 1.0
    fluidity = c2_inverse
    if c1 > 0.0:
        fluidity += 1.0 / c1
    for k in range(units):
        fluidity += 1.0 / cu[k]
    d_fluidity = np.zeros(directions)
    d_compliance = np.zeros(directions)
    compliant = compliance > 0.0
    for j in range(directions):
        d_fluidity[j] = -dq[j, _C2] / (c2 * c2)
        if c1 > 0.0:
            d_fluidity[j] -= dq[j, _C1] / (c1 * c1)
        for k in range(units):
            d_fluidity[j] -= dcu[j, k] / (cu[k] * cu[k])
        d_compliance[j] = dq[j, _C0] + dq[j, _CM]
        compliant = compliant or d_compliance[j] != 0.0

    solidity = 1.0 / fluidity
    d_fluid = d_fluidity * solidity

    # The units of the chain in one row, with the first.
    row_pace, row_give = _paces(k1, c1, ku, cu)
    d_row_pace = np.zeros((directions, units + 1))
    d_row_give = np.zeros((directions, units + 1))
    for k in range(units + 1):
        viscosity = c1 if k == 0 else cu[k - 1]
        if viscosity == 0.0:
            continue
        for j in range(directions):
            d_viscosity = dq[j, _C1] if k == 0 else dcu[j, k - 1]
            change = dq[j, _K1] if k == 0 else dku[j, k - 1]
            d_row_pace[j, k] = (change - row_pace[k] * d_viscosity) / viscosity
            d_row_give[j, k] = (d_row_pace[j, k] - row_give[k] * d_viscosity) / viscosity
    leads = np.zeros(units + 2)
    leads_h = np.zeros(units + 2)
    d_leads = np.zeros((directions, units + 2))
    lead_weight = 0.0
    climb = 0.0
    lead = 0.0
    machine_lead = 0.0

    # State: stretches z (K1), y (flow), zu (units); forces at the step's start of chain and
    # machine; the surface x; the largest stretch so far. Below, a leading d is the tangent.
    z = 0.0
    y = 0.0
    chain_force = 0.0
    machine_force = 0.0
    x = 0.0
    z_max = q[_STRETCHED]
    speed = 0.0
    zu = np.zeros(units)
    left_u = np.zeros(units)
    softness = 1.0 / ku
    pace = ku / cu
    d_pace = (dku - pace * dcu) / cu
    d_softness = -dku * softness * softness
    d_kept = np.zeros((directions, units))
    flow_series = np.zeros(8)
    growth_series = np.zeros(8)
    if p != 1.0:
        _anchor(1.0, p, flow_series)
    if m != 0.0:
        _anchor(1.0, m, growth_series)
    dz = np.zeros(directions)
    dy = np.zeros(directions)
    d_chain_force = np.zeros(directions)
    d_machine_force = np.zeros(directions)
    dx = np.zeros(directions)
    dz_max = dq[:, _STRETCHED].copy()
    d_speed = np.zeros(directions)
    d_mean = np.zeros(directions)
    d_first = np.zeros(directions)
    d_part = np.zeros(directions)
    dzu_kept = np.zeros((directions, units))
    dzu = np.zeros((directions, units))

    # How far a cohesive zone is open, and how fast it opens; its mean force over a pass.
    cohesive = opening > 0.0 or decay > 0.0
    held_back = False
    gap_open = 0.0
    opens = 0.0
    tear = 0.0
    # What it pulls with, from step to step.
    drawn = 0.0
    d_gap_open = np.zeros(directions)
    d_opens = np.zeros(directions)
    d_tear = np.zeros(directions)
    contact = False
    virgin = True
    rate = 0.0
    rate_before = 0.0
    steady = False
    h_known = -1.0
    e = k1
    e_k = 1.0
    e_x = 0.0
    against = c1
    bound_to_tool = False
    kappa = 1.0
    d_kappa = 0.0
    swing = 1.0
    d_swing = 0.0
    held = 0.0
    mean = 0.0
    unit_compliance = 0.0
    # A linear chain between two events is most of a trial, most of the time.
    brisk = linear
    for j in range(directions):
        brisk = brisk and dq[j, _N] == 0.0 and dq[j, _FY] == 0.0 and dq[j, _M] == 0.0
        brisk = brisk and dq[j, _BETA] == 0.0 and dq[j, _D] == 0.0
    # And often it has nothing but the three elements.
    bare = brisk and units == 0 and kp == 0.0 and not compliant and not massive
    for j in range(directions):
        bare = bare and dq[j, _KP] == 0.0
    brisk = brisk and not bare
    quick = directions == 0
    bare_h = -1.0
    bare_inverse = 0.0
    kept_z = 1.0
    f_z = 0.0
    f_d = 0.0
    brisk_h = -1.0
    brisk_contact = False
    per_h = 0.0
    flow_give = 0.0
    give = 0.0
    z_give = 0.0
    x_give = 0.0
    total_give = 0.0
    inverse = 0.0
    waits = 0.0
    held_kappa = 0.0
    ahead_give = 0.0
    on = 0.0
    half_kp = 0.5 * kp
    bent = np.zeros((directions, _BENT))
    kept_u = np.zeros(units)
    kept_twice = np.zeros(units)
    unit_give = np.zeros(units)
    d_unit_give = np.zeros((directions, units))
    d_fc = np.zeros(directions)
    own_units = np.zeros(directions, dtype=np.bool_)
    for j in range(directions):
        for k in range(units):
            own_units[j] = own_units[j] or dku[j, k] != 0.0 or dcu[j, k] != 0.0
        bent[j, _B_K1] = dq[j, _K1]
        bent[j, _B_C0] = dq[j, _C0]
        bent[j, _B_CM] = dq[j, _CM]
        bent[j, _B_KP] = dq[j, _KP]
        bent[j, _B_OFF] = dq[j, _OFF]
        bent[j, _B_MASS] = dq[j, _MASS]
    surface[0] = 0.0
    for j in range(directions):
        d_surface[j, 0] = 0.0

    i = -1
    while i < steps - 1:
        i += 1
        h = t[i + 1] - t[i]
        d_end = d[i + 1] + offset
        if bare and not virgin and not held_back:
            if abs(h - bare_h) > _SAME * h:
                bare_h = h
                h_known = -1.0
                against = c1 + c2 if contact else c1
                e, e_k, e_x = _memory_weight(k1, c1, h, against)
                flow_give = h * c2_inverse
                bare_inverse = 1.0 / (1.0 + flow_give * e)
                # In contact the flow unit has what z has not of the tool's way, so that z alone
                # goes from step to step; free, y rests.
                kept_z = 1.0 - bare_inverse * flow_give * k1 if contact else 1.0 - k1 / e
                f_z = bare_inverse * k1
                f_d = bare_inverse * e
                for j in range(directions):
                    de = e_k * dq[j, _K1] + dq[j, _C1] / h
                    if contact:
                        de -= e_x / against * (dq[j, _C1] + dq[j, _C2])
                        d_flow = -flow_give * c2_inverse * dq[j, _C2]
                        d_inverse = -(d_flow * e + flow_give * de) * bare_inverse * bare_inverse
                        change = d_flow * k1 + flow_give * dq[j, _K1]
                        bent[j, _B_Z_Z] = -d_inverse * flow_give * k1 - bare_inverse * change
                        bent[j, _B_Z_D] = d_inverse
                        bent[j, _B_F_Z] = d_inverse * k1 + bare_inverse * dq[j, _K1]
                        bent[j, _B_F_D] = d_inverse * e + bare_inverse * de
                    else:
                        if c1 > 0.0:
                            de -= e_x / against * dq[j, _C1]
                        bent[j, _B_Z_Z] = (k1 * de / e - dq[j, _K1]) / e
            first = i
            if contact:
                start = d[i] + offset
                last = force[i - 1]
                while True:
                    pushed = d_end - start
                    total = f_z * z + f_d * pushed
                    ends = 1.5 * total - 0.5 * last < -f_ad
                    # A tool that does not withdraw is left by no force that only relaxes.
                    if ends and (pushed < 0.0 or total < -f_ad):
                        break
                    for j in range(directions):
                        dfc = bent[j, _B_F_Z] * z + bent[j, _B_F_D] * pushed
                        d_force[j, i] = dfc + f_z * dz[j]
                        dz[j] = kept_z * dz[j] + bent[j, _B_Z_Z] * z + bent[j, _B_Z_D] * pushed
                        d_surface[j, i + 1] = bent[j, _B_OFF]
                    z = kept_z * z + bare_inverse * pushed
                    force[i] = total
                    surface[i + 1] = d_end
                    last = total
                    start = d_end
                    i += 1
                    if i == steps:
                        break
                    h = t[i + 1] - t[i]
                    d_end = d[i + 1] + offset
                    if abs(h - bare_h) > _SAME * h:
                        break
                if i > first:
                    x = start
                    y = x - z
                    for j in range(directions):
                        dx[j] = bent[j, _B_OFF]
                        dy[j] = dx[j] - dz[j]
            else:
                while y + kept_z * z >= d_end:
                    for j in range(directions):
                        dz[j] = kept_z * dz[j] + bent[j, _B_Z_Z] * z
                        dx[j] = dz[j] + dy[j]
                        d_force[j, i] = 0.0
                        d_surface[j, i + 1] = dx[j]
                    z *= kept_z
                    x = y + z
                    force[i] = 0.0
                    surface[i + 1] = x
                    i += 1
                    if i == steps:
                        break
                    h = t[i + 1] - t[i]
                    d_end = d[i + 1] + offset
                    if abs(h - bare_h) > _SAME * h:
                        break
            if i > first:
                i -= 1
                continue
        if virgin and d_end <= 0.0:
            force[i] = 0.0
            surface[i + 1] = 0.0
            for j in range(directions):
                d_force[j, i] = 0.0
                d_surface[j, i + 1] = 0.0
            continue
        if brisk and not virgin and not held_back and (contact or quick or not massive):
            if contact != brisk_contact or abs(h - brisk_h) > _SAME * h:
                brisk_h = h
                brisk_contact = contact
                h_known = -1.0
                bound = contact or mass > 0.0
                against = c1 + c2 if bound else c1
                e, e_k, e_x = _memory_weight(k1, c1, h, against)
                kappa = 1.0
                d_kappa = 0.0
                if bound and compliant:
                    kappa, d_kappa = _end_weight(compliance / (h * fluidity))
                # Free, nothing but a mass holds the force of the chain, and the machine has none.
                on = 1.0 if contact else 0.0
                held_kappa = on * kappa
                lead_weight = 0.0
                if contact and compliant:
                    lead_weight = (1.0 - 0.5 * kappa) * h
                    _lead(
                        h,
                        row_pace,
                        row_give,
                        d_row_pace,
                        d_row_give,
                        solidity,
                        d_fluid,
                        leads,
                        leads_h,
                        d_leads,
                    )
                flow_give = h * c2_inverse
                waits = (1.0 - kappa) * c0
                give = flow_give + kappa * c0
                ahead_give = flow_give + waits * kappa
                for k in range(units):
                    left_u[k] = _gone(pace[k] * h)
                    kept_u[k] = 1.0 - left_u[k]
                    kept_twice[k] = kept_u[k] * kept_u[k]
                    unit_give[k] = left_u[k] * softness[k]
                    give += unit_give[k]
                    ahead_give += kept_u[k] * unit_give[k]
                z_give = 1.0 + give * k1
                x_give = 1.0 + give * e
                total_give = e + half_kp * x_give
                per_h = 1.0 / h
                swing = 0.0
                if massive and not contact:
                    swing, _ = _end_weight(mass * (c0 + stiff / k1 + h * fluidity) * per_h * per_h)
                inert = swing * mass * per_h * per_h
                if contact:
                    inverse = 1.0 / (x_give + cm * kappa * total_give)
                else:
                    inverse = 1.0 / (total_give + inert * x_give)
                per_against = e_x / against if against > 0.0 else 0.0
                r = compliance / (h * fluidity)
                for j in range(directions):
                    de = e_k * dq[j, _K1] + dq[j, _C1] * (per_h - per_against)
                    if contact:
                        de -= per_against * dq[j, _C2]
                    bent[j, _B_E] = de
                    bent[j, _B_FLOW] = -flow_give * c2_inverse * dq[j, _C2]
                    bent[j, _B_END] = 0.0
                    if d_kappa != 0.0:
                        d_r = d_compliance[j] * per_h - r * d_fluidity[j]
                        bent[j, _B_END] = d_kappa * d_r / fluidity
                    if own_units[j]:
                        for k in range(units):
                            change = h * kept_u[k] * d_pace[j, k]
                            d_kept[j, k] = -change
                            d_unit_give[j, k] = change * softness[k] + left_u[k] * d_softness[j, k]
            for j in range(directions):
                d_fc[j] = 0.0
            first = i
            if quick:
                # Where the step would end without u is known from the state one step before and
                # that step's u, so that only a product and a sum wait for each other.
                x_free = y + z_give * z + waits * chain_force + _fallen(kept_u, zu)
                fallen = _fallen(kept_twice, zu)
                ahead_z = z_give + ahead_give * k1
                ahead_u = z_give + ahead_give * e
                held_waits = waits * (1.0 - kappa)
                lead = 0.0
                machine_lead = 0.0
                d_start = d[i] + offset
                pull = 0.0
                ahead = 0.0
                while True:
                    fc = k1 * z
                    x_next = y + ahead_z * z + held_waits * chain_force + fallen
                    if lead_weight > 0.0:
                        pull = (d[i + 1] - d[i]) * per_h
                        climb = leads[0] * pull + leads[1] * z
                        for k in range(units):
                            climb += leads[2 + k] * zu[k]
                        lead = lead_weight * climb
                        machine_lead = lead_weight * (climb + kp * pull)
                        x_free += c0 * lead
                        x_next += waits * lead
                    total = fc + half_kp * (x + x_free)
                    if contact:
                        g = x_free - d_end
                        if cm > 0.0:
                            g += cm * (machine_force + kappa * (total - machine_force))
                            g += cm * machine_lead
                    else:
                        g = total
                        if massive:
                            ahead = x + h * speed
                            g += inert * (x_free - ahead)
                    u = -g * inverse
                    x_end = x_free + x_give * u
                    total += total_give * u
                    seen = total
                    if contact:
                        if massive:
                            pull = (d_end - d_start) * per_h
                            seen += mass * (pull - speed) * per_h
                        ends = 1.5 * seen - 0.5 * force[i - 1] < -f_ad
                        if ends and (d[i + 1] < d[i] or massive or seen < -f_ad):
                            break
                    elif x_end < d_end:
                        break
                    x_free = x_next + ahead_u * u
                    fc += e * u
                    fallen = 0.0
                    for k in range(units):
                        stretch = kept_u[k] * zu[k] + unit_give[k] * fc
                        zu[k] = stretch
                        fallen += kept_twice[k] * stretch
                    z += u
                    y += flow_give * fc
                    chain_force += kappa * (fc - chain_force) + lead
                    machine_force += kappa * (total - machine_force) + machine_lead
                    machine_force *= on
                    x = x_end
                    if massive:
                        speed = pull if contact else speed + swing * per_h * (x_end - ahead)
                        d_start = d_end
                    force[i] = on * seen
                    surface[i + 1] = x_end
                    i += 1
                    if i == steps:
                        break
                    h = t[i + 1] - t[i]
                    d_end = d[i + 1] + offset
                    if abs(h - brisk_h) > _SAME * h:
                        break
            while not quick:
                x_end = y + z_give * z + waits * chain_force
                if units > 0:
                    x_end += _fallen(kept_u, zu)
                lead = 0.0
                machine_lead = 0.0
                if lead_weight > 0.0:
                    pull = (d[i + 1] - d[i]) * per_h
                    climb = leads[0] * pull + leads[1] * z
                    for k in range(units):
                        climb += leads[2 + k] * zu[k]
                    lead = lead_weight * climb
                    machine_lead = lead_weight * (climb + kp * pull)
                    x_end += c0 * lead
                fc = k1 * z
                total = fc + half_kp * (x + x_end)
                if contact:
                    g = x_end - d_end
                    if cm > 0.0:
                        g += cm * (machine_force + kappa * (total - machine_force))
                        g += cm * machine_lead
                else:
                    g = total
                u = -g * inverse
                x_end += x_give * u
                total += total_give * u
                seen = total
                spurt = 0.0
                if contact:
                    if massive:
                        spurt = ((d[i + 1] - d[i]) * per_h - speed) * per_h
                        seen += mass * spurt
                    ends = 1.5 * seen - 0.5 * force[i - 1] < -f_ad
                    if ends and (d[i + 1] < d[i] or massive or seen < -f_ad):
                        break
                elif x_end < d_end:
                    break
                fc += e * u
                jump = fc - chain_force
                chain_end = chain_force + kappa * jump + lead
                machine_jump = total - machine_force
                machine_end = machine_force + kappa * machine_jump + machine_lead
                x_mid = 0.5 * (x + x_end)
                for j in range(directions):
                    dfc = bent[j, _B_K1] * z + bent[j, _B_E] * u + k1 * dz[j]
                    d_flow = bent[j, _B_FLOW] * fc
                    d_sum = dz[j] + dy[j] + d_flow + give * dfc
                    d_sum += waits * d_chain_force[j]
                    dl = 0.0
                    d_machine_lead = 0.0
                    if lead_weight > 0.0:
                        d_climb = d_leads[j, 0] * pull + d_leads[j, 1] * z + leads[1] * dz[j]
                        for k in range(units):
                            started = dzu[j, k] + unit_give[k] * d_fc[j]
                            d_climb += d_leads[j, 2 + k] * zu[k] + leads[2 + k] * started
                        bend = -0.5 * h * bent[j, _B_END]
                        dl = lead_weight * d_climb + bend * climb
                        d_machine_lead = dl + lead_weight * bent[j, _B_KP] * pull
                        d_machine_lead += bend * kp * pull
                    d_sum += c0 * dl
                    d_sum += bent[j, _B_C0] * chain_end + c0 * bent[j, _B_END] * jump
                    if units > 0:
                        d_sum += _fallen_tangent(j, unit_give, d_fc[j], kept_u, dzu)
                        if own_units[j]:
                            d_sum += _bent_tangent(j, d_kept, zu, d_unit_give, fc, dzu)
                    d_total = dfc + half_kp * (dx[j] + d_sum) + bent[j, _B_KP] * x_mid
                    d_machine = (1.0 - kappa) * d_machine_force[j] + bent[j, _B_END] * machine_jump
                    d_machine += d_machine_lead
                    dg = d_total
                    if contact:
                        dg = d_sum - bent[j, _B_OFF] + bent[j, _B_CM] * machine_end
                        dg += cm * (d_machine + kappa * d_total)
                    du = -dg * inverse
                    dfc += e * du
                    d_total += total_give * du
                    d_sum += x_give * du
                    dz[j] += du
                    dy[j] += d_flow + flow_give * dfc
                    dx[j] = d_sum
                    d_fc[j] = dfc
                    d_chain_force[j] += kappa * (dfc - d_chain_force[j]) + bent[j, _B_END] * jump
                    d_chain_force[j] += dl
                    d_machine_force[j] = on * d_machine + held_kappa * d_total
                    d_force[j, i] = on * d_total
                    if massive:
                        d_force[j, i] += bent[j, _B_MASS] * spurt - mass * d_speed[j] * per_h
                        d_speed[j] = 0.0
                    d_surface[j, i + 1] = d_sum
                for k in range(units):
                    zu[k] = kept_u[k] * zu[k] + unit_give[k] * fc
                z += u
                y += flow_give * fc
                chain_force = chain_end
                machine_force = on * machine_end
                x = x_end
                force[i] = on * seen
                if massive:
                    speed = (d[i + 1] - d[i]) * per_h
                surface[i + 1] = x_end
                i += 1
                if i == steps:
                    break
                h = t[i + 1] - t[i]
                d_end = d[i + 1] + offset
                if abs(h - brisk_h) > _SAME * h:
                    break
            if units > 0:
                for j in range(directions):
                    for k in range(units):
                        dzu[j, k] += unit_give[k] * d_fc[j]
            if i > first:
                i -= 1
                continue
        share = 1.0
        touching = contact
        split = False
        if virgin:
            virgin = False
            touching = True
            gap = -(d[i] + offset)
            if gap > 0.0:
                share = max(d_end / (d_end + gap), _SHORTEST)
                split = share > _SHORTEST
        last = 0.0
        if contact:
            last = force[i - 1]
        stage = _LOOK
        if held_back:
            # The surface goes on as it did, and the tool as is known.
            opens += (d[i] - d[i - 1]) / (t[i] - t[i - 1]) - (d[i + 1] - d[i]) / h
        if held_back and 0.0 < gap_open < -opens * h * (1.0 - _SHORTEST):
            # The tool and what it is held by meet within the step.
            stage = _CAUGHT
            share = max(gap_open / (-opens * h), _SHORTEST)
            for j in range(directions):
                d_part[j] = -(d_gap_open[j] + share * h * d_opens[j]) / opens
        at_once = 0.0
        shortened = 0
        force[i] = 0.0
        for j in range(directions):
            d_force[j, i] = 0.0

        # The passes of a step: as it was, and in contact where the tool catches up with the free
        # surface. Where the contact may end, the force is looked at without consequences, on the
        # whole step and at its first instant; the contact then ends where the straight line
        # through both reaches the pull-off force, and the rest of the step is free.
        while True:
            hs = h * share
            target = d_end
            if stage in (_FIRST, _LAST):
                target = d[i] + offset + share * (d[i + 1] - d[i])
            if abs(hs - h_known) > _SAME * hs or bound_to_tool != (touching or mass > 0.0):
                bound_to_tool = touching or mass > 0.0
                against = c1 + c2 if bound_to_tool else c1
                if plain:
                    e, e_k, e_x = _memory_weight(k1, c1, hs, against)
                unit_compliance = 0.0
                for k in range(units):
                    left_u[k] = _gone(pace[k] * hs)
                    unit_compliance += left_u[k] * softness[k]
                    for j in range(directions):
                        d_kept[j, k] = hs * (left_u[k] - 1.0) * d_pace[j, k]
                if compliant:
                    kappa, d_kappa = _end_weight(compliance / (hs * fluidity))
                    _lead(
                        hs,
                        row_pace,
                        row_give,
                        d_row_pace,
                        d_row_give,
                        solidity,
                        d_fluid,
                        leads,
                        leads_h,
                        d_leads,
                    )
                if massive:
                    held = c0 + stiff / k1 + hs * fluidity
                    swing, d_swing = _end_weight(mass * held / (hs * hs))
                h_known = hs
            end = kappa if touching or mass > 0.0 else 1.0
            inert = swing * mass / (hs * hs)
            ahead = x + hs * speed
            pull = (d[i + 1] - d[i]) / h
            tear = 0.0
            torn = 1.0
            torn_gap = 0.0
            torn_more = 0.0
            torn_length = 0.0
            lasting = False
            if held_back and not touching:
                torn, torn_gap, torn_more, torn_length, lasting = _held(
                    gap_open, opens * hs, opening, decay
                )
                tear = f_ad * torn
            lead = 0.0
            machine_lead = 0.0
            climb = 0.0
            grown = 1.0
            if touching and compliant:
                climb = leads[0] * pull + leads[1] * z
                for k in range(units):
                    climb += leads[2 + k] * zu[k]
                if m != 0.0:
                    grown = (x * d_ref_inverse) ** m if x > 0.0 else 0.0
                lead = (1.0 - 0.5 * kappa) * hs * climb
                machine_lead = (1.0 - 0.5 * kappa) * hs * (grown * climb + kp * pull)
            rest = z + y + c0 * ((1.0 - end) * chain_force + lead)
            for k in range(units):
                rest += zu[k] * (1.0 - left_u[k])
            ce = unit_compliance + end * c0
            growth = 1.0
            d_growth = 0.0
            stiffness = k1
            d_stiffness = 0.0
            if linear:
                fc = k1 * z
                slope = e
                flow = fc * c2_inverse
                fluid = c2_inverse
                x_slope = 1.0 + (hs * fluid + ce) * slope
                x_end = rest + hs * flow + ce * fc
                x_mid = 0.5 * (x + x_end)
                total = fc + kp * x_mid
                total_slope = slope + 0.5 * x_slope * kp
                if touching:
                    g = x_end - target + cm * (machine_force + end * (total - machine_force))
                    g += cm * machine_lead
                    g_slope = x_slope + cm * end * total_slope
                else:
                    g = total + tear + inert * (x_end - ahead)
                    g_slope = total_slope + inert * x_slope
                u = -g / g_slope
                fc += slope * u
                flow = fc * c2_inverse
                excess = abs(fc)
                x_end += x_slope * u
                x_mid = 0.5 * (x + x_end)
                total += total_slope * u
                middle = z + 0.5 * u
            else:
                u = (2.0 * rate - rate_before) * hs
                for _ in range(_MOST_ITERATIONS):
                    if plain:
                        middle = z + 0.5 * u
                        fc = k1 * z + e * u
                        slope = e
                    else:
                        fc, slope, stiffness, d_stiffness, e_k, e_x, middle = _retarded_unit(
                            u, z, z_max, hs, k1, c1, against, beta, damage, saturation, d_ref
                        )
                    flow, fluid, excess = _flow_unit(fc, c2, f_y, p, flow_series)
                    x_end = rest + u + hs * flow + ce * fc
                    x_slope = 1.0 + (hs * fluid + ce) * slope
                    x_mid = 0.5 * (x + x_end)
                    if m != 0.0:
                        growth = 0.0
                        d_growth = 0.0
                        if x_mid > 0.0:
                            growth = _power(x_mid * d_ref_inverse, m, growth_series)
                            d_growth = m * growth / x_mid
                    total = growth * fc + kp * x_mid
                    total_slope = growth * slope + 0.5 * x_slope * (d_growth * fc + kp)
                    if touching:
                        g = x_end - target + cm * (machine_force + end * (total - machine_force))
                        g += cm * machine_lead
                        g_slope = x_slope + cm * end * total_slope
                    elif kp == 0.0 and mass == 0.0 and not held_back:
                        g = fc
                        g_slope = slope
                    else:
                        g = total + tear + inert * (x_end - ahead)
                        g_slope = total_slope + inert * x_slope
                    change = -g / g_slope
                    u += change
                    if abs(change) <= _TOLERANCE * abs(u) + _SMALLEST:
                        break
                # The last change is of first order in everything that depends on u.
                fc += slope * change
                flow += fluid * slope * change
                x_end += x_slope * change
                x_mid = 0.5 * (x + x_end)
                total += total_slope * change
                middle += 0.5 * change
            thrust = mass * (pull - speed) / (h if stage == _FIRST else hs)
            probing = stage == _FIRST or (stage == _LAST and shortened < _SHORTENED)
            if touching and stage == _LOOK:
                mean = total + thrust
                ends = 1.5 * mean - 0.5 * last < -f_ad
                if ends and (pull < 0.0 or massive or mean < -f_ad):
                    if split:
                        if mean < -f_ad:
                            touching = False
                            held_back = cohesive
                            gap_open = 0.0
                            opens = 0.0
                            d_gap_open[:] = 0.0
                            d_opens[:] = 0.0
                            share = 1.0
                            split = False
                            rate = 0.0
                            rate_before = 0.0
                            contact = True
                            continue
                    else:
                        probing = True
            tip = d_end + cm * drawn if held_back else d_end
            if stage == _LOOK and not touching and not contact and x_end < tip:
                touching = True
                contact = True
                held_back = False
                rate = 0.0
                rate_before = 0.0
                if d_end > x > d[i] + offset:
                    # The surface is taken to wait for the tool.
                    share = max((d_end - x) / (d[i + 1] - d[i]), _SHORTEST)
                    split = share > _SHORTEST
                continue

            if directions > 0:
                if probing:
                    dzu_kept[:] = dzu
                stiffening = 1.0 + beta * middle * middle
                growing = middle > z_max
                worn, wears, bends = _worn(middle if growing else z_max, saturation, d_ref)
                left = 1.0 - damage * worn
                inverse = 1.0 / g_slope
                per_hs = 1.0 / hs
                per_against = e_x / against if against > 0.0 else 0.0
                per_relaxation = per_hs / fluidity
                for j in range(directions):
                    dhs = 0.0
                    if split:
                        dhs = h * (dq[j, _OFF] - dx[j]) / (d[i + 1] - d[i])
                    elif stage in (_LAST, _CAUGHT):
                        dhs = d_part[j]
                    elif stage == _REST:
                        dhs = -d_part[j]
                    if plain:
                        dk = dq[j, _K1]
                    else:
                        dk = dq[j, _K1] * (stiffness * k1_inverse) + d_stiffness * dz[j]
                    if not plain or dq[j, _BETA] != 0.0 or dq[j, _D] != 0.0:
                        dk += k1 * middle * middle * dq[j, _BETA] * left
                        d_lost = dq[j, _D] * worn + damage * bends * dq[j, _SATURATION]
                        if not growing:
                            d_lost += damage * wears * dz_max[j]
                        dk -= k1 * stiffening * d_lost
                    de = e_k * dk + dq[j, _C1] * (per_hs - per_against)
                    de += (e_x - c1 * per_hs) * per_hs * dhs
                    if bound_to_tool:
                        de -= per_against * dq[j, _C2]
                    dfc = dk * z + stiffness * dz[j] + de * u
                    d_flow = -flow * c2_inverse * dq[j, _C2] * p
                    if dq[j, _FY] != 0.0:
                        d_flow -= (fluid if fc > 0.0 else -fluid) * dq[j, _FY]
                    if dq[j, _N] != 0.0 and excess > 0.0:
                        d_flow -= flow * np.log(excess / (c2 * REFERENCE_RATE)) * p * p * dq[j, _N]
                    d_end_weight = 0.0
                    if compliant and (touching or mass > 0.0):
                        d_r = d_compliance[j] - compliance * dhs * per_hs
                        d_r -= compliance * d_fluidity[j] / fluidity
                        d_end_weight = d_kappa * d_r * per_relaxation
                    d_inert = 0.0
                    d_swing_weight = 0.0
                    if massive and not touching:
                        d_held = dq[j, _C0] - stiff * dq[j, _K1] * (k1_inverse * k1_inverse)
                        d_held += hs * d_fluidity[j] + (fluidity - 2.0 * held * per_hs) * dhs
                        d_swing_weight = mass * d_held + dq[j, _MASS] * held
                        d_swing_weight *= d_swing * per_hs * per_hs
                        d_inert = d_swing_weight * mass + swing * dq[j, _MASS]
                        d_inert *= per_hs * per_hs
                        d_inert -= 2.0 * inert * per_hs * dhs
                    d_tear[j] = 0.0
                    if held_back and not touching:
                        d_torn = torn_gap * d_gap_open[j]
                        d_torn += torn_more * (d_opens[j] * hs + opens * dhs)
                        d_torn += torn_length * (dq[j, _OPEN] + dq[j, _DECAY])
                        d_tear[j] = dq[j, _FAD] * torn + f_ad * d_torn
                    d_sum = dz[j] + dy[j] + dhs * flow + hs * d_flow
                    dl = 0.0
                    d_machine_lead = 0.0
                    if touching and compliant:
                        d_climb = (d_leads[j, 0] + leads_h[0] * dhs) * pull
                        d_climb += (d_leads[j, 1] + leads_h[1] * dhs) * z + leads[1] * dz[j]
                        for k in range(units):
                            d_climb += (d_leads[j, 2 + k] + leads_h[2 + k] * dhs) * zu[k]
                            d_climb += leads[2 + k] * dzu[j, k]
                        weight = 1.0 - 0.5 * kappa
                        bend = weight * dhs - 0.5 * hs * d_end_weight
                        dl = weight * hs * d_climb + bend * climb
                        d_grown = 0.0
                        if x > 0.0 and (m != 0.0 or dq[j, _M] != 0.0):
                            d_grown = grown * (np.log(x / d_ref) * dq[j, _M] + m * dx[j] / x)
                        d_machine_lead = weight * hs * (grown * d_climb + d_grown * climb)
                        d_machine_lead += weight * hs * dq[j, _KP] * pull
                        d_machine_lead += bend * (grown * climb + kp * pull)
                    for k in range(units):
                        kept = 1.0 - left_u[k]
                        dzu[j, k] = (
                            kept * dzu[j, k]
                            + (d_kept[j, k] - kept * pace[k] * dhs) * (zu[k] - fc * softness[k])
                            + left_u[k] * d_softness[j, k] * fc
                        )
                        d_sum += dzu[j, k]
                    if c0 > 0.0 or dq[j, _C0] != 0.0:
                        jump = fc - chain_force
                        d_sum += dq[j, _C0] * (chain_force + end * jump + lead)
                        d_sum += c0 * ((1.0 - end) * d_chain_force[j] + d_end_weight * jump + dl)
                    d_sum += (hs * fluid + ce) * dfc
                    d_mid = 0.5 * (dx[j] + d_sum)
                    d_scale = d_growth * d_mid
                    if dq[j, _M] != 0.0 and x_mid > 0.0:
                        d_scale += growth * np.log(x_mid / d_ref) * dq[j, _M]
                    d_total = growth * dfc + d_scale * fc + kp * d_mid + dq[j, _KP] * x_mid
                    if touching:
                        dg = d_sum - dq[j, _OFF]
                        if stage == _LAST:
                            dg -= pull * dhs
                        if cm > 0.0 or dq[j, _CM] != 0.0:
                            jump = total - machine_force
                            dg += dq[j, _CM] * (machine_force + end * jump + machine_lead)
                            dg += cm * (
                                d_machine_force[j]
                                + end * (d_total - d_machine_force[j])
                                + d_end_weight * jump
                                + d_machine_lead
                            )
                    elif kp == 0.0 and dq[j, _KP] == 0.0 and not massive and not held_back:
                        dg = dfc
                    else:
                        dg = d_total + d_tear[j] + d_inert * (x_end - ahead)
                        dg += inert * (d_sum - dx[j] - hs * d_speed[j] - dhs * speed)
                    du = -dg * inverse
                    dfc += slope * du
                    d_total += total_slope * du
                    if probing:
                        span = hs if stage == _LAST else h
                        d_probe = d_total - thrust * dhs / span
                        d_probe += (dq[j, _MASS] * (pull - speed) - mass * d_speed[j]) / span
                        if stage == _FIRST:
                            d_first[j] = d_probe
                        else:
                            d_mean[j] = d_probe
                        continue
                    for k in range(units):
                        dzu[j, k] += left_u[k] * softness[k] * dfc
                    dz[j] += du
                    if z + u > z_max:
                        dz_max[j] = dz[j]
                    dy[j] += dhs * flow + hs * (d_flow + fluid * dfc)
                    d_ahead = dx[j] + hs * d_speed[j] + dhs * speed
                    dx[j] = d_sum + x_slope * du
                    if massive and not touching:
                        d_swing_weight -= swing * dhs * per_hs
                        d_speed[j] += swing * per_hs * (dx[j] - d_ahead)
                        d_speed[j] += d_swing_weight * per_hs * (x_end - ahead)
                    if touching or mass > 0.0:
                        d_chain_force[j] += end * (dfc - d_chain_force[j])
                        d_chain_force[j] += d_end_weight * (fc - chain_force) + dl
                    else:
                        d_chain_force[j] = dfc
                    if touching:
                        d_machine_force[j] += end * (d_total - d_machine_force[j])
                        d_machine_force[j] += d_end_weight * (total - machine_force)
                        d_machine_force[j] += d_machine_lead
                        d_force[j, i] += d_total * share + total * dhs / h
                        d_force[j, i] += (dq[j, _MASS] * (pull - speed) - mass * d_speed[j]) / h
                        d_speed[j] = 0.0
                    else:
                        d_machine_force[j] = 0.0
                        if held_back:
                            d_machine_force[j] = -d_tear[j]
                            d_force[j, i] -= d_tear[j] * (hs / h) + tear * dhs / h
                            d_gap = dx[j] - dq[j, _OFF] - cm * d_tear[j] - dq[j, _CM] * tear
                            wider = (x_end - d_end - cm * tear - gap_open) * per_hs
                            d_opens[j] = (d_gap - d_gap_open[j] - wider * dhs) * per_hs
                            d_gap_open[j] = d_gap
                    d_surface[j, i + 1] = dx[j]

            if probing:
                if directions > 0:
                    dzu[:] = dzu_kept
                if stage == _LOOK:
                    stage = _FIRST
                    share = _INSTANT
                    continue
                if stage == _LAST:
                    # What relaxes within the step falls faster than the straight line: the part
                    # is as long as it does not pull on average.
                    mean = total + thrust
                    shortened += 1
                    if mean >= -f_ad or at_once <= mean:
                        shortened = _SHORTENED
                        continue
                    ratio = (at_once + f_ad) / (at_once - mean)
                    for j in range(directions):
                        change = d_first[j] * (1.0 - ratio) + dq[j, _FAD] + ratio * d_mean[j]
                        d_part[j] = ratio * d_part[j] + share * h * change / (at_once - mean)
                    share = max(share * ratio, _SHORTEST)
                    continue
                at_once = total + thrust
                share = 1.0
                if at_once <= -f_ad:
                    touching = False
                    held_back = cohesive
                    gap_open = 0.0
                    opens = 0.0
                    d_gap_open[:] = 0.0
                    d_opens[:] = 0.0
                    rate = 0.0
                    rate_before = 0.0
                    stage = _SURE
                elif 2.0 * mean - at_once >= -f_ad:
                    stage = _SURE
                else:
                    stage = _LAST
                    share = 0.5 * (at_once + f_ad) / (at_once - mean)
                    share = min(max(share, _SHORTEST), 1.0 - _SHORTEST)
                    for j in range(directions):
                        change = d_first[j] * (0.5 - share) + 0.5 * dq[j, _FAD] + share * d_mean[j]
                        d_part[j] = h * change / (at_once - mean)
                continue
            for k in range(units):
                zu[k] += left_u[k] * (fc * softness[k] - zu[k])
            z += u
            if z > z_max:
                z_max = z
            y += hs * flow
            rate_before = rate if steady else u / hs
            rate = u / hs
            steady = stage == _LOOK and contact == touching
            if touching or mass > 0.0:
                chain_force += end * (fc - chain_force) + lead
            else:
                chain_force = fc
            if touching:
                machine_force += end * (total - machine_force) + machine_lead
                force[i] += (total + thrust) * share
                speed = pull
            else:
                machine_force = 0.0
                speed += swing / hs * (x_end - ahead)
                if held_back:
                    force[i] -= tear * (hs / h)
                    # A tool that is held back is off by what its arm gives.
                    gap = x_end - d_end - cm * tear
                    opens = (gap - gap_open) / hs
                    gap_open = gap
                    held_back = lasting
                    drawn = tear
                    machine_force = -tear if held_back else 0.0
            x = x_end
            surface[i + 1] = x_end
            contact = touching
            bare_h = -1.0
            brisk_h = -1.0
            if stage not in (_LAST, _CAUGHT):
                break
            touching = stage == _CAUGHT
            held_back = cohesive and not touching
            stage = _REST
            share = 1.0 - share
            gap_open = 0.0
            opens = 0.0
            d_gap_open[:] = 0.0
            d_opens[:] = 0.0
            contact = True
            rate = 0.0
            rate_before = 0.0
