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
A specimen under the tool as the physics has it: any of the contract's effects, and others.

::

                     +-------------- K_p, pore fluid, shoulder ---------------+
    tool ---[ K_m ]--+                                                        +--- support
       | (M moves    +--[ K_0 ]--( K1 || C1 )--( K_2 || C_3 )--( C2 or spring-+
       |  with H)                                     pot, slider F_y, slip )

What this module integrates is what data with a known cause are made of, so it shares no code with
the models that are fitted to them. The unknown of a stage is the stretch z of K1: the force of
the chain, and by it every other stretch, follows from z without another equation, and their sum
rises with z at least as fast as z itself. The states are advanced by the L-stable two-stage SDIRK
rule of second order, whose stages are implicit Euler steps; touch and loss of contact are found
by bisection of the step, and a step ends there.

References
----------
Paper, eqs. (1)-(3), and the table of effects of the bag contract; R. Alexander, SIAM J. Numer.
Anal. 14, 1977, 1006-1021, doi:10.1137/0714068 (the rule); D. Matignon, ESAIM: Proc. 5, 1998,
145-158, doi:10.1051/proc:1998004 (fractional integral as a continuum of relaxations); K.
Terzaghi, Theoretical Soil Mechanics, 1943, ch. 13 (consolidation series).

"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np

FLOW_RATE: Final = 1e-3
"""Rate at which a power-law dashpot has the viscosity C2 [m/s]."""
FRACTIONAL_TIME: Final = 10.0
"""Time at which a springpot has the viscosity C2 [s]."""
HOUR: Final = 3600.0
"""[s]"""


class Quantity(NamedTuple):
    """A parameter of an effect: its symbol, its unit, and its value where there is no effect."""

    symbol: str
    unit: str
    absent: float


LIBRARY: Final[Mapping[str, tuple[Quantity, ...]]] = {
    'yield_force': (Quantity('F_y', 'N', 0.0),),
    'series_spring': (Quantity('K_0', 'N/m', math.inf),),
    'parallel_spring': (Quantity('K_p', 'N/m', 0.0),),
    'second_retardation': (Quantity('K_2', 'N/m', math.inf), Quantity('C_3', 'N.s/m', 1.0)),
    'springpot': (Quantity('alpha', '-', 1.0),),
    'strain_stiffening': (Quantity('beta', '1/m^2', 0.0),),
    'shear_thinning': (Quantity('n', '-', 1.0),),
    'contact_growth': (Quantity('m', '-', 0.0),),
    'damage': (Quantity('D', '-', 0.0),),
    'ageing': (Quantity('rate', '1/h', 0.0),),
    'adhesion': (Quantity('F_ad', 'N', 0.0),),
    'inertia': (Quantity('M', 'kg', 0.0),),
    'machine_compliance': (Quantity('K_m', 'N/m', math.inf),),
    'contact_offset': (Quantity('delta_0', 'm', 0.0),),
    'friction': (Quantity('F_c', 'N', 0.0),),
    'force_drift': (Quantity('rate', 'N/s', 0.0),),
    'force_lag': (Quantity('T_f', 's', 0.0),),
    'clock_offset': (Quantity('dt', 's', 0.0),),
    'height_bias': (Quantity('b', 'm', 0.0),),
    'periodic_disturbance': (
        Quantity('amplitude', 'N', 0.0),
        Quantity('frequency', 'Hz', 1.0),
    ),
}
"""The effects of the contract."""

OTHER_LAWS: Final[Mapping[str, tuple[Quantity, ...]]] = {
    'stiction': (Quantity('F_c', 'N', 0.0), Quantity('travel', 'm', 1e-4)),
    'contact_friction': (Quantity('F_c', 'N', 0.0),),
    'tool_mass': (Quantity('M', 'kg', 0.0),),
    'gathered_mass': (Quantity('M', 'kg', 0.0),),
    'early_shadow': (Quantity('b', 'm', 0.0), Quantity('clearance', 'm', 0.0)),
    'touch_shadow': (Quantity('b', 'm', 0.0),),
    'loose_top': (Quantity('delta_0', 'm', 0.0),),
    'ageing_by_trial': (Quantity('rate', '1/h', 0.0),),
    'necking': (Quantity('F_ad', 'N', 0.0), Quantity('length', 'm', 0.0)),
    'stringing': (Quantity('F_ad', 'N', 0.0), Quantity('length', 'm', 0.0)),
    'lasting_damage': (Quantity('D', '-', 0.0),),
    'early_damage': (Quantity('D', '-', 0.0), Quantity('length', 'm', 1.0)),
    'early_lasting_damage': (Quantity('D', '-', 0.0), Quantity('length', 'm', 1.0)),
}
"""
Effects of the contract by laws that differ from those of `LIBRARY`.

``stiction``: friction that builds up over `travel` and stays at rest (Dahl);
``contact_friction``: friction between tool and object only;
``tool_mass``: inertia of the tool itself, in air as in contact;
``gathered_mass``: inertia of what goes with the tool while it touches, without a blow;
``early_shadow``: the height is biased from when the tool is `clearance` above the object;
``touch_shadow``: the height is biased while the tool touches the object;
``loose_top``: the top is pushed down by `delta_0` before the object resists, and stays down;
``ageing_by_trial``: each trial has an object of its own age, which stays as it is in it;
``necking``: adhesion that pulls on with its force until necks of `length` have been drawn out;
``stringing``: adhesion whose threads break one after the other, as many on each `length`;
``lasting_damage``: damage at one place, which stays from trial to trial;
``early_damage``: `D` is lost at d_ref, and of what is not lost yet 1 - 1/e on each `length`;
``early_lasting_damage``: both.
"""

LAW_OF: Final[Mapping[str, str]] = {
    'stiction': 'friction',
    'contact_friction': 'friction',
    'tool_mass': 'inertia',
    'gathered_mass': 'inertia',
    'early_shadow': 'height_bias',
    'touch_shadow': 'height_bias',
    'loose_top': 'contact_offset',
    'ageing_by_trial': 'ageing',
    'necking': 'adhesion',
    'stringing': 'adhesion',
    'lasting_damage': 'damage',
    'early_damage': 'damage',
    'early_lasting_damage': 'damage',
}
"""Whose laws these are."""

LASTING: Final = ('lasting_damage', 'early_lasting_damage')
"""Which of them one trial hands on to the next."""

OUTSIDE: Final[Mapping[str, tuple[Quantity, ...]]] = {
    'poroelasticity': (Quantity('K_pore', 'N/m', 0.0), Quantity('time', 's', 1.0)),
    'fracture': (Quantity('share', '-', 0.0), Quantity('depth', 'm', math.inf)),
    'thixotropy': (
        Quantity('share', '-', 0.0),
        Quantity('flow', 'm', 1.0),
        Quantity('rest', 's', 1.0),
    ),
    'support_slip': (
        Quantity('distance', 'm', 0.0),
        Quantity('force', 'N', math.inf),
        Quantity('pause', 's', 1.0),
    ),
    'unloading_stiffness': (Quantity('share', '-', 0.0), Quantity('speed', 'm/s', 1e-5)),
    'shoulder_contact': (Quantity('K_s', 'N/m', 0.0), Quantity('depth', 'm', math.inf)),
    'backlash': (Quantity('gap', 'm', 0.0),),
    'cell_creep': (Quantity('share', '-', 0.0), Quantity('time', 's', 1.0)),
    'cell_hysteresis': (Quantity('share', '-', 0.0), Quantity('width', 'N', 1.0)),
    'gain_step': (Quantity('share', '-', 0.0),),
    'force_saturation': (Quantity('limit', 'N', math.inf),),
    'force_quantisation': (Quantity('step', 'N', 0.0),),
    'knock': (
        Quantity('amplitude', 'N', 0.0),
        Quantity('frequency', 'Hz', 1.0),
        Quantity('decay', 's', 1.0),
    ),
    'height_gain': (Quantity('share', '-', 0.0),),
}
"""
Effects that no library has.

``poroelasticity``: fluid is squeezed out, G(t) is Terzaghi's series, at first as 1 - t^(1/2);
``fracture``: a share of the section breaks once the surface is `depth` down;
``thixotropy``: C2 falls by `share` as it flows over `flow`, and recovers with rest;
``support_slip``: once in a `pause` the object slips on its support when the force passes `force`,
by `distance` or until half of the force is left;
``unloading_stiffness``: K1 is less by `share` while it shortens its stretch;
``shoulder_contact``: from `depth` on a spring of the tool's shoulder joins in;
``backlash``: the tip follows the encoders only after `gap` when they turn;
``cell_creep``, ``cell_hysteresis``: of the load cell, as a share of its reading;
``gain_step``: the load cell's gain is another in the second half of the campaign;
``force_saturation``, ``force_quantisation``: of the load cell's converter;
``knock``: someone bumps into the cell in the hold of one trial in the middle;
``height_gain``: the range sensor's scale is off.
"""

EFFECTS: Final[Mapping[str, tuple[Quantity, ...]]] = {**LIBRARY, **OTHER_LAWS, **OUTSIDE}
"""All effects of this world, with their parameters."""

_BASE: Final = ('K1', 'C1', 'C2')
_SLOTS: Final[Mapping[tuple[str, str], int]] = {
    key: len(_BASE) + i
    for i, key in enumerate((name, q.symbol) for name in EFFECTS for q in EFFECTS[name])
}


@dataclass(frozen=True, slots=True)
class Body:
    """
    The three elements of the paper.

    Parameters
    ----------
    K1 : float
        Elastic coefficient [N/m].
    C1, C2 : float
        Viscosities of the bouncing and of the residual part [N.s/m].

    """

    K1: float
    C1: float
    C2: float

    @property
    def relaxation_time(self) -> float:
        """Return the time constant of the force at held displacement [s]."""
        return (self.C1 + self.C2) / self.K1

    @property
    def retardation_time(self) -> float:
        """Return the time constant of the free recovery [s]."""
        return self.C1 / self.K1


@dataclass(frozen=True, slots=True)
class Undeclared:
    """
    An effect that acts in a campaign without being declared anywhere in its data.

    Parameters
    ----------
    name : str
        One of `EFFECTS`.
    values : tuple of float
        Its parameters, in the order of `EFFECTS`, in SI units (rates of ageing in 1/h).

    Raises
    ------
    UsageError
        If there is no such effect or the number of values is another.

    """

    name: str
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.name not in EFFECTS:
            known = ', '.join(EFFECTS)
            raise UsageError(
                f'there is no effect {self.name!r} in this world: choose among {known}'
            )
        if len(self.values) != len(EFFECTS[self.name]):
            raise UsageError(
                f'the effect {self.name!r} has {len(EFFECTS[self.name])} parameters, but '
                f'{len(self.values)} values are given'
            )


@dataclass(frozen=True, slots=True)
class Motion:
    """
    A motion of the tool in pieces of constant acceleration.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Where the pieces start [s]; the last one never ends.
    depth, speed, acceleration : ndarray, shape (n,)
        At the start of each piece: how far the tip is below the nominal surface [m], its speed
        toward the object [m/s] and its acceleration [m/s^2].

    """

    t: FloatArray
    depth: FloatArray
    speed: FloatArray
    acceleration: FloatArray

    def at(self, t: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return depth [m], speed [m/s] and acceleration [m/s^2] at times `t` [s]."""
        piece = np.maximum(np.searchsorted(self.t, t, side='right') - 1, 0)
        since = t - self.t[piece]
        a = self.acceleration[piece]
        speed = self.speed[piece]
        return (
            self.depth[piece] + since * (speed + 0.5 * a * since),
            speed + a * since,
            a,
        )

    def with_backlash(self, gap: float) -> 'Motion':
        """
        Return the motion of a tip that follows only `gap` [m] after the motion has turned back.

        The motion may turn once, from a resting tool.
        """
        if gap <= 0.0:
            return self
        up = (self.speed < 0.0) | ((self.speed == 0.0) & (self.acceleration < 0.0))
        turn = int(np.argmax(up))
        deepest = float(self.depth[turn])
        lasts = np.append(np.diff(self.t), math.inf)
        for piece in range(turn, self.t.size):
            ahead = (0.5 * self.acceleration[piece], self.speed[piece])
            roots = np.roots((*ahead, self.depth[piece] - deepest + gap))
            after = [
                float(z.real) for z in roots if z.imag == 0.0 and 0.0 <= z.real < lasts[piece]
            ]
            if after:
                taken_up = float(self.t[piece]) + min(after)
                break
        else:
            raise UsageError(f'a backlash of {gap:g} m is more than the tool withdraws')
        _, speed, acceleration = self.at(np.array([taken_up]))
        later = self.t > taken_up
        return Motion(
            np.concatenate((self.t[: turn + 1], [taken_up], self.t[later])),
            np.concatenate((self.depth[: turn + 1], [deepest], self.depth[later] + gap)),
            np.concatenate((self.speed[:turn], [0.0], speed, self.speed[later])),
            np.concatenate(
                (self.acceleration[:turn], [0.0], acceleration, self.acceleration[later])
            ),
        )


@dataclass(frozen=True, slots=True)
class History:
    """
    What went on in a trial, at n + 1 moments.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        The moments [s]; touch and loss of contact are among them.
    force : ndarray, shape (n,)
        Mean force of the object on the tool between them [N].
    surface : ndarray, shape (n + 1,)
        Displacement height H of the surface under the tool [m].
    t_touch, t_loss : float
        First touch and last loss of contact [s]; NaN where there was none.
    stretched : float
        The largest stretch of the spring K1 so far [m].

    """

    t: FloatArray
    force: FloatArray
    surface: FloatArray
    t_touch: float
    t_loss: float
    stretched: float


def parameter_vector(body: Body, effects: Sequence[Undeclared] = ()) -> FloatArray:
    """
    Return the numbers that the integrator reads.

    Parameters
    ----------
    body : Body
        The three elements.
    effects : sequence of Undeclared
        What else acts.

    Returns
    -------
    ndarray
        K1, C1, C2, then the parameters of all `EFFECTS` in their order.

    """
    vector = np.array(
        [body.K1, body.C1, body.C2, *(q.absent for name in EFFECTS for q in EFFECTS[name])]
    )
    for effect in effects:
        for quantity, value in zip(EFFECTS[effect.name], effect.values, strict=True):
            vector[_SLOTS[effect.name, quantity.symbol]] = value
    return vector


def parameter(vector: FloatArray, effect: str, symbol: str) -> float:
    """Return one parameter of an effect from the numbers of `parameter_vector`."""
    return float(vector[_SLOTS[effect, symbol]])


def integrate(
    grid: FloatArray,
    motion: Motion,
    vector: FloatArray,
    *,
    surface_offset: float = 0.0,
    reference_depth: float = 1.0,
    campaign_time: float = 0.0,
    stretched: float = 0.0,
) -> History:
    """
    Push a specimen at rest along a motion of the tool.

    Parameters
    ----------
    grid : ndarray, shape (n,)
        Moments that the steps end at [s], increasing; those where the motion changes its
        acceleration are added.
    motion : Motion
        Motion of the tool, as the encoders have it.
    vector : ndarray
        From `parameter_vector`.
    surface_offset : float
        How much higher the surface is than the nominal one [m].
    reference_depth : float
        d_ref of damage and contact growth, the deepest push of the campaign [m].
    campaign_time : float
        When the trial starts, from the start of the campaign [s].
    stretched : float
        How far its spring K1 has been stretched before [m].

    Returns
    -------
    History
        Force and surface.

    """
    tip = motion.with_backlash(parameter(vector, 'backlash', 'gap'))
    corners = tip.t[(tip.t > grid[0]) & (tip.t < grid[-1])]
    near = np.minimum(np.searchsorted(grid, corners), grid.size - 1)
    away = np.abs(grid[near] - corners) > _SAME_MOMENT
    away &= np.abs(grid[near - 1] - corners) > _SAME_MOMENT
    moments: FloatArray = np.sort(np.concatenate((grid, corners[away])))
    # A piece of the motion is looked up within the step, not at its end.
    middle: FloatArray = 0.5 * (moments[1:] + moments[:-1])
    depth, speed, acceleration = tip.at(middle)
    half = middle - moments[:-1]
    speed = speed - acceleration * half
    depth = depth - half * (speed + 0.5 * acceleration * half) + surface_offset

    order = parameter(vector, 'springpot', 'alpha')
    rates, weights, give, flow = _fractional(order, float(vector[2]))
    odd = 2.0 * np.arange(_PORE_MODES) + 1.0
    pore_stiffness: FloatArray = np.zeros(0)
    if parameter(vector, 'poroelasticity', 'K_pore') > 0.0:
        pore_stiffness = np.asarray(parameter(vector, 'poroelasticity', 'K_pore') * 8.0)
        pore_stiffness = pore_stiffness / (np.pi * odd) ** 2
    pore_rates = odd[: pore_stiffness.size] ** 2 / parameter(vector, 'poroelasticity', 'time')
    room = moments.size + _MOST_EVENTS
    t, impulse, surface = np.empty(room), np.empty(room), np.empty(room)
    count, touch, loss, stretched = _push(
        moments,
        depth,
        speed,
        acceleration,
        vector,
        reference_depth,
        campaign_time,
        stretched,
        rates,
        weights,
        give,
        flow,
        pore_stiffness,
        pore_rates,
        t,
        impulse,
        surface,
    )
    t, surface = t[:count], surface[:count]
    return History(t, np.diff(impulse[:count]) / np.diff(t), surface, touch, loss, stretched)


def _fractional(order: float, C2: float) -> tuple[FloatArray, FloatArray, float, float]:
    """
    Return rates [1/s], weights [m/(N.s)], spring [m/N] and fluidity [m/(N.s)] of a springpot.

    The kernel of the fractional integral is a continuum of relaxations,
    ``t^(a-1) / Gamma(a) = sin(pi a) / pi * integral of s^-a exp(-s t) ds``; what is faster than
    the range of the rates is a spring, what is slower a dashpot.
    """
    if order >= 1.0:
        return np.zeros(0), np.zeros(0), 0.0, 1.0 / C2
    scale = math.sin(math.pi * order) / math.pi * FRACTIONAL_TIME ** (1.0 - order) / C2
    # The trapezoidal rule in ln s; what the ends of the sum leave out are geometric series.
    rates = np.exp(_MODE_STEP * np.arange(_FIRST_RATE, _LAST_RATE + 1))
    weights = scale * _MODE_STEP * rates ** (1.0 - order)
    give = weights[-1] / rates[-1] / math.expm1(_MODE_STEP * order)
    flow = weights[0] / math.expm1(_MODE_STEP * (1.0 - order))
    return rates, weights, give, flow


_SAME_MOMENT = 1e-9
"""Moments that are as near as this are one [s]."""
_SHORTEST = 1e-8
"""What is left of a step after a touch or loss is left out if it is no longer than this [s]."""
_AT_ONCE = 1e-11
"""How exactly touch and loss are found [s]."""
_MOST_EVENTS = 4000
_THREADED = 4
"""Passes of a step in which threads and what they pull at are told together."""
_MOST_IN_STEP = 8
"""Touches and losses in a step, after which it is finished as it is."""
_MODE_STEP = 0.5
_FIRST_RATE, _LAST_RATE = -28, 24
"""Range of ln s of the rates s of a springpot [1/s], in steps; the rule is exact to 1e-8."""
_PORE_MODES = 24
_SLIP_TIME = 0.02
"""How long a slip over the whole distance takes if the force stays as it is [s]."""
_STUCK = 1.05
"""A slip has ended when this times the force that holds is left."""
_TURN_TIME = 0.02
"""How long the spring takes to have its other stiffness when its stretch turns [s]."""
_SMALLEST_PATCH = 1e-6
"""Penetration over d_ref below which the contact patch grows no smaller."""
_MOST_ITERATIONS = 200
_CONVERGED = 1e-13
_SMALL = 1e-3
"""Change of the stretch, relative but not below that of this stretch [m], that ends the search."""
_GAMMA = 1.0 - math.sqrt(0.5)
_AHEAD = (1.0 - _GAMMA) / _GAMMA

_FY = _SLOTS['yield_force', 'F_y']
_K0 = _SLOTS['series_spring', 'K_0']
_KP = _SLOTS['parallel_spring', 'K_p']
_K2 = _SLOTS['second_retardation', 'K_2']
_C3 = _SLOTS['second_retardation', 'C_3']
_BETA = _SLOTS['strain_stiffening', 'beta']
_N = _SLOTS['shear_thinning', 'n']
_M_GROWTH = _SLOTS['contact_growth', 'm']
_D = _SLOTS['damage', 'D']
_D_LASTS = _SLOTS['lasting_damage', 'D']
_D_EARLY = _SLOTS['early_damage', 'D']
_EARLY = _SLOTS['early_damage', 'length']
_D_EARLY_LASTS = _SLOTS['early_lasting_damage', 'D']
_EARLY_LASTS = _SLOTS['early_lasting_damage', 'length']
_AGE = _SLOTS['ageing', 'rate']
_AGE_BY_TRIAL = _SLOTS['ageing_by_trial', 'rate']
_FAD = _SLOTS['adhesion', 'F_ad']
_NECKED = _SLOTS['necking', 'F_ad']
_NECK = _SLOTS['necking', 'length']
_STRUNG = _SLOTS['stringing', 'F_ad']
_THREAD = _SLOTS['stringing', 'length']
_MASS = _SLOTS['inertia', 'M']
_KM = _SLOTS['machine_compliance', 'K_m']
_CRACK = _SLOTS['fracture', 'share']
_CRACK_DEPTH = _SLOTS['fracture', 'depth']
_THIXO = _SLOTS['thixotropy', 'share']
_THIXO_FLOW = _SLOTS['thixotropy', 'flow']
_THIXO_REST = _SLOTS['thixotropy', 'rest']
_SLIP = _SLOTS['support_slip', 'distance']
_SLIP_FORCE = _SLOTS['support_slip', 'force']
_SLIP_PAUSE = _SLOTS['support_slip', 'pause']
_UNLOAD = _SLOTS['unloading_stiffness', 'share']
_UNLOAD_SPEED = _SLOTS['unloading_stiffness', 'speed']
_KS = _SLOTS['shoulder_contact', 'K_s']
_KS_DEPTH = _SLOTS['shoulder_contact', 'depth']

# Where the states stand: the stretches of K1, C2 and K_2, the slip on the support, the surface
# and its speed; then what changes between steps only: largest stretch, structure of the
# thixotropy, factor of the unloading, mobility of the slip, unbroken share; then the modes of
# springpot and pores.
_Z, _Y, _ZU, _SHIFT, _H, _V, _Z_MAX, _BUILD, _TURN, _SLIDE, _WHOLE, _FIRST_MODE = range(12)


@kernel(error_model='numpy')
def _stage(  # type: ignore[no-untyped-def]
    q, d_ref, factor, w, kept, give, flow, kp, kept_p, base, e, d, v, a, contact, necks, out
):
    """
    Set out in `out` an implicit stage of length e from `base`; return the contact force.

    The tool is at d with the speed v and the acceleration a; `kept` and `kept_p` are what a stage
    leaves of the modes of springpot and pores; `necks` is the force of necks between the two.
    """
    c1, c2 = q[1], q[2] * (1.0 - q[_THIXO] * (1.0 - base[_BUILD]))
    threshold = q[_FY] / factor
    k1 = q[0] * base[_TURN]
    beta, damage = q[_BETA], q[_D] + q[_D_LASTS]
    early = q[_D_EARLY] / (1.0 - np.exp(-d_ref / q[_EARLY]))
    lasting = q[_D_EARLY_LASTS] / (1.0 - np.exp(-d_ref / q[_EARLY_LASTS]))
    exponent, growth_exponent = 1.0 / q[_N], q[_M_GROWTH]
    soft0, softm = 1.0 / q[_K0], 1.0 / q[_KM]
    x_before, v_before = base[_H], base[_V]
    sliding, held = e * base[_SLIDE], 0.5 * q[_SLIP_FORCE]
    unit, left_unit = 0.0, base[_ZU]
    if not np.isinf(q[_K2]):
        unit = e / (q[_C3] + e * q[_K2])
        left_unit = base[_ZU] * q[_C3] / (q[_C3] + e * q[_K2])
    rest = base[_Y] + base[_SHIFT] + left_unit
    # The flow unit: C2 times the rate of its dashpot is what a springpot integrates.
    dashpot = e * flow * (q[2] / c2)
    yields = dashpot + give
    modes, pores = w.size, kp.size
    for j in range(modes):
        rest += w[j] * kept[j] * base[_FIRST_MODE + j]
        yields += w[j] * kept[j] * e
    pore, pore_gain = 0.0, 0.0
    for j in range(pores):
        pore += kept_p[j] * base[_FIRST_MODE + modes + j]
        pore_gain += kept_p[j] * kp[j]
    scale = factor * base[_WHOLE]
    bound = contact and softm == 0.0
    z, z_max = base[_Z], base[_Z_MAX]
    low, high = -np.inf, np.inf
    x = 0.0
    f = 0.0
    drive = 0.0
    slid = 0.0
    total = 0.0
    for _ in range(_MOST_ITERATIONS):
        square = beta * z * z
        stiffness, slope = k1 * (1.0 + square), k1 * (1.0 + 3.0 * square)
        if damage != 0.0 or early != 0.0 or lasting != 0.0:
            farthest = max(z, z_max)
            fresh = early * np.exp(-farthest / q[_EARLY])
            other = lasting * np.exp(-farthest / q[_EARLY_LASTS])
            left = 1.0 - damage * farthest / d_ref - (early - fresh) - (lasting - other)
            slope *= left
            if z > z_max:
                lost = damage / d_ref + fresh / q[_EARLY] + other / q[_EARLY_LASTS]
                slope -= stiffness * z * lost
            stiffness *= left
        f = c1 * (z - base[_Z]) / e + stiffness * z
        df = c1 / e + slope
        over = abs(f) - threshold
        drive, d_drive = 0.0, 0.0
        if over > 0.0:
            drive, d_drive = over, 1.0
            if exponent != 1.0:
                most = q[2] * FLOW_RATE
                drive = most * (over / most) ** exponent
                d_drive = exponent * drive / over
            if f < 0.0:
                drive = -drive
        x = z + f * (soft0 + unit) + rest + yields * drive
        dx = 1.0 + df * (soft0 + unit + yields * d_drive)
        slid = 0.0
        if sliding > 0.0 and f > held:
            slid = sliding * (f - held)
            x += slid
            dx += sliding * df
        own = f + q[_KP] * x + pore + pore_gain * (x - x_before)
        d_own = df + (q[_KP] + pore_gain) * dx
        if x > q[_KS_DEPTH]:
            own += q[_KS] * (x - q[_KS_DEPTH])
            d_own += q[_KS] * dx
        if growth_exponent != 0.0:
            part = max(x / d_ref, _SMALLEST_PATCH)
            growth = part**growth_exponent
            d_own *= growth
            if part > _SMALLEST_PATCH:
                d_own += own * growth_exponent * growth / (part * d_ref) * dx
            own *= growth
        total = scale * own
        d_total = scale * d_own
        if bound:
            total += q[_MASS] * a
        else:
            total += q[_MASS] * ((x - x_before) / e - v_before) / e
            d_total += q[_MASS] * dx / (e * e)
        if not contact:
            miss, d_miss = total + necks, d_total
        elif bound:
            miss, d_miss = x - d, dx
        else:
            miss, d_miss = x - d + softm * total, dx + softm * d_total
        if miss > 0.0:
            high = z
        else:
            low = z
        following = z - miss / d_miss
        # Where the stiffness falls the slope may mislead; the bracket then helps.
        if not low <= following <= high:
            if high - low < np.inf:
                following = 0.5 * (low + high)
            else:
                following = z - np.sign(miss) * (1e-6 * d_ref + abs(z))
        change = abs(following - z)
        z = following
        if change <= _CONVERGED * (abs(z) + _SMALL):
            break
    if bound:
        x = d
    out[_Z] = z
    out[_Y] = base[_Y] + dashpot * drive
    out[_ZU] = left_unit + unit * f
    out[_SHIFT] = base[_SHIFT] + slid
    out[_H] = x
    out[_V] = v if bound else (x - x_before) / e
    for j in range(_Z_MAX, _FIRST_MODE):
        out[j] = base[j]
    out[_Z_MAX] = max(z_max, z)
    for j in range(modes):
        out[_FIRST_MODE + j] = kept[j] * (base[_FIRST_MODE + j] + e * drive)
    for j in range(pores):
        at = _FIRST_MODE + modes + j
        out[at] = kept_p[j] * (base[at] + kp[j] * (x - x_before))
    return total if contact else -necks


@kernel(error_model='numpy')
def _step(  # type: ignore[no-untyped-def]
    q,
    d_ref,
    factor,
    r,
    w,
    kept,
    give,
    flow,
    kp,
    rp,
    kept_p,
    kept_e,
    state,
    h,
    path,
    contact,
    necks,
    middle,
    after,
):
    """Advance `state` by h into `after`; return the impulse on the tool and the force at the end.

    `path` holds depth, speed and acceleration of the tool at the start.
    """
    e = _GAMMA * h
    if kept_e[0] != e:
        kept_e[0] = e
        for j in range(r.size):
            kept[j] = 1.0 / (1.0 + e * r[j])
        for j in range(rp.size):
            kept_p[j] = 1.0 / (1.0 + e * rp[j])
    impulse, force = 0.0, 0.0
    for stage in range(2):
        if stage == 0:
            middle[:] = state
        else:
            for j in range(state.size):
                if j < _Z_MAX or j >= _FIRST_MODE:
                    middle[j] = state[j] + _AHEAD * (after[j] - state[j])
        at = h if stage else e
        d = path[0] + at * (path[1] + 0.5 * path[2] * at)
        v = path[1] + path[2] * at
        force = _stage(
            q,
            d_ref,
            factor,
            w,
            kept,
            give,
            flow,
            kp,
            kept_p,
            middle,
            e,
            d,
            v,
            path[2],
            contact,
            necks,
            after,
        )
        impulse += (e if stage else h - e) * force
    return impulse, force


@kernel(error_model='numpy')
def _between_steps(q, before, after, h, force, timers):  # type: ignore[no-untyped-def]
    """Change what a step's end changes in `after`; `timers`: a slip's pause [s], start [m]."""
    if q[_THIXO] != 0.0:
        breaking = abs(after[_Y] - before[_Y]) / (h * q[_THIXO_FLOW])
        pace = breaking + 1.0 / q[_THIXO_REST]
        level = 1.0 / (q[_THIXO_REST] * pace)
        after[_BUILD] = level + (after[_BUILD] - level) * np.exp(-pace * h)
    if q[_UNLOAD] != 0.0:
        rate = (after[_Z] - before[_Z]) / h
        target = 1.0 - 0.5 * q[_UNLOAD] * (1.0 - np.tanh(rate / q[_UNLOAD_SPEED]))
        after[_TURN] += (target - after[_TURN]) * -np.expm1(-h / _TURN_TIME)
    if after[_H] > q[_CRACK_DEPTH]:
        after[_WHOLE] = 1.0 - q[_CRACK]
    if q[_SLIP] != 0.0:
        timers[0] -= h
        if after[_SLIDE] != 0.0:
            enough = after[_SHIFT] - timers[1] >= q[_SLIP]
            if enough or force <= 0.5 * q[_SLIP_FORCE] * _STUCK:
                after[_SLIDE] = 0.0
        elif timers[0] <= 0.0 and force > q[_SLIP_FORCE]:
            after[_SLIDE] = 2.0 * q[_SLIP] / (_SLIP_TIME * q[_SLIP_FORCE])
            timers[0] = q[_SLIP_PAUSE]
            timers[1] = after[_SHIFT]


@kernel(error_model='numpy')
def _push(  # type: ignore[no-untyped-def]
    grid,
    depth,
    speed,
    acceleration,
    q,
    d_ref,
    campaign_time,
    stretched,
    r,
    w,
    give,
    flow,
    kp,
    rp,
    t,
    impulse,
    surface,
):
    """Fill moments, impulse up to them and surface; return how many, touch, loss, stretch."""
    state = np.zeros(_FIRST_MODE + r.size + rp.size)
    state[_BUILD] = 1.0
    state[_TURN] = 1.0
    state[_WHOLE] = 1.0
    state[_Z_MAX] = stretched
    middle = state.copy()
    after = state.copy()
    kept = np.zeros(r.size)
    kept_p = np.zeros(rp.size)
    kept_e = np.zeros(1)
    path = np.zeros(3)
    timers = np.zeros(2)
    pull_off = q[_FAD] + q[_NECKED] + q[_STRUNG]
    necks = 0.0
    strung = q[_STRUNG] > 0.0
    opened = 0.0
    rigid = np.isinf(q[_KM])
    contact = False
    virgin = True
    touch, loss = np.nan, np.nan
    given = 0.0
    blow = 0.0
    count = 1
    events = 0
    t[0] = grid[0]
    impulse[0] = 0.0
    surface[0] = 0.0
    for i in range(grid.size - 1):
        whole = grid[i + 1] - grid[i]
        done = 0.0
        in_step = 0
        aged = q[_AGE] * (campaign_time + grid[i] + 0.5 * whole)
        factor = np.exp((aged + q[_AGE_BY_TRIAL] * campaign_time) / HOUR)
        while whole - done > _SHORTEST:
            path[2] = acceleration[i]
            path[1] = speed[i] + acceleration[i] * done
            path[0] = depth[i] + done * (speed[i] + 0.5 * acceleration[i] * done)
            in_step += 1
            watched = in_step <= _MOST_IN_STEP and events < _MOST_EVENTS
            changes = False
            h = whole - done
            low, high = 0.0, h
            push, force = 0.0, 0.0
            while True:
                tip = path[0] + h * (path[1] + 0.5 * path[2] * h)
                gap = tip
                if not virgin:
                    # Threads pull by how far they are drawn out in the middle of the step.
                    for _ in range(_THREADED if strung and necks > 0.0 else 1):
                        push, force = _step(
                            q,
                            d_ref,
                            factor,
                            r,
                            w,
                            kept,
                            give,
                            flow,
                            kp,
                            rp,
                            kept_p,
                            kept_e,
                            state,
                            h,
                            path,
                            contact,
                            necks,
                            middle,
                            after,
                        )
                        gap = tip - after[_H]
                        if strung and necks > 0.0:
                            out = max(opened - gap - necks / q[_KM], 0.0)
                            necks = q[_STRUNG] * np.exp(-0.5 * out / q[_THREAD])
                beyond = force < -pull_off if contact else gap > 0.0
                if necks > 0.0:
                    # What holds the tool back pulls it out of a soft arm.
                    gap += necks / q[_KM]
                    beyond = gap > 0.0 or (gap < -q[_NECK] and not strung)
                if not changes and not (watched and beyond):
                    break
                # Bisection: until the end of the step is where contact changes, and just beyond.
                changes = True
                if beyond:
                    high = h
                else:
                    low = h
                if high - low > _AT_ONCE:
                    h = 0.5 * (low + high)
                elif h == high:
                    break
                else:
                    h = high
            if changes:
                events += 1
            if not virgin:
                _between_steps(q, state, after, h, force, timers)
                state[:] = after
            done += h
            if not changes:
                done = whole
            given += push + blow
            blow = 0.0
            if strung and necks > 0.0:
                opened = max(-gap, 0.0)
            if changes and necks > 0.0 and gap < -0.5 * q[_NECK] and not strung:
                necks = 0.0
            elif changes:
                contact = not contact
                virgin = False
                necks = 0.0
                if not contact and q[_NECK] > 0.0:
                    necks = q[_NECKED]
                if not contact and strung:
                    necks = q[_STRUNG]
                    opened = 0.0
                if contact:
                    if np.isnan(touch):
                        touch = grid[i] + done
                    if rigid:
                        # The mass takes the tool's speed at once.
                        pace = path[1] + path[2] * h
                        blow = q[_MASS] * (pace - state[_V])
                        state[_V] = pace
                else:
                    loss = grid[i] + done
            t[count] = grid[i] + done if changes else grid[i + 1]
            impulse[count] = given
            surface[count] = state[_H]
            count += 1
    return count, touch, loss, state[_Z_MAX]
