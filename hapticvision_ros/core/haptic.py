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
A fitted model one step at a time, for a haptic renderer: displacement in, force out.

The forward model (`hapticvision_ros.core.models.chain`) takes a whole tool path, since a fit has
one, and its state lives within one call. Here the same rule of integration takes one step, with
the state in an array: the laws of the units, the weights of the memory and that of a step's end
are the forward model's own functions. What is not here is most of the forward model: the
sensitivities, and the short cuts for long stretches between two events. A test holds both to the
same force on the same path, 1e-9 of the largest.

The arm's own compliance and its sensors are none of the object's: the renderer has its own.
"""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.composition import BASE_PARAMETERS, Model
from hapticvision_ros.core.effects.declaration import Draft
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.models.chain import (
    _anchor,
    _end_weight,
    _flow_unit,
    _held,
    _lead,
    _memory_weight,
    _paces,
    _power,
    _retarded_unit,
    Slot,
)
from hapticvision_ros.core.records import FloatArray
import numpy as np

RATE: Final = 1000.0
"""Steps per second of a usual haptic loop [Hz]."""

_COUNTED_FROM_DEPTH: Final = ('damage', 'contact_growth')

_Z, _Y, _X, _Z_MAX, _SPEED, _CHAIN_FORCE, _MEAN, _TOOL, _RATE, _RATE_BEFORE = range(10)
_CONTACT, _VIRGIN, _STEADY, _HELD_BACK, _GAP, _OPENS, _PULL = range(10, 17)
_FLOW_SERIES = 17
_GROWTH_SERIES = _FLOW_SERIES + 8
_STATES = _GROWTH_SERIES + 8
"""Powers of the flow unit and of the contact; then the further units' stretches."""

_K1 = int(Slot.K1)
_C1 = int(Slot.C1)
_C2 = int(Slot.C2)
_FY = int(Slot.YIELD_FORCE)
_N = int(Slot.FLOW_INDEX)
_BETA = int(Slot.STIFFENING)
_D = int(Slot.DAMAGE)
_C0 = int(Slot.SERIES_COMPLIANCE)
_KP = int(Slot.PARALLEL_STIFFNESS)
_M = int(Slot.CONTACT_EXPONENT)
_DREF = int(Slot.REFERENCE_DEPTH)
_FAD = int(Slot.ADHESION)
_MASS = int(Slot.MASS)
_OPEN = int(Slot.OPENING)
_DECAY = int(Slot.DECAY)
_SATURATION = int(Slot.SATURATION)
_GROWTH = len(Slot)
"""Behind the slots of the chain: a of exponential stiffening [1/m]."""

_LOOK, _FIRST, _SURE, _LAST, _REST, _CAUGHT = range(6)
_INSTANT = 1e-2
_SHORTEST = 1e-6
_TOLERANCE = 1e-6
_SMALLEST = 1e-16
_MOST_ITERATIONS = 60


@kernel(error_model='numpy')
def _start(state, q, displacement):  # type: ignore[no-untyped-def]
    """Set the body at rest, the tool at a displacement."""
    state[:] = 0.0
    state[_TOOL] = displacement
    state[_VIRGIN] = 1.0
    _anchor(1.0, 1.0 / q[_N], state[_FLOW_SERIES:_GROWTH_SERIES])
    _anchor(1.0, q[_M], state[_GROWTH_SERIES:_STATES])


@kernel(error_model='numpy')
def _step(d_end, h, q, ku, cu, state):  # type: ignore[no-untyped-def]
    """Take the tool to a displacement within h seconds; return the mean force over them."""
    d_start = state[_TOOL]
    state[_TOOL] = d_end
    if state[_VIRGIN] > 0.0 and d_end <= 0.0:
        return 0.0
    k1, c1, c2, f_y = q[_K1], q[_C1], q[_C2], q[_FY]
    beta, damage, saturation, d_ref = q[_BETA], q[_D], q[_SATURATION], q[_DREF]
    c0, kp, m, f_ad, mass = q[_C0], q[_KP], q[_M], q[_FAD], q[_MASS]
    p = 1.0 / q[_N]
    units = ku.size
    zu = state[_STATES:]
    flow_series = state[_FLOW_SERIES:_GROWTH_SERIES]
    growth_series = state[_GROWTH_SERIES:_STATES]
    stiff = 0.0 if c1 > 0.0 else 1.0
    fluidity = 1.0 / c2
    if c1 > 0.0:
        fluidity += 1.0 / c1
    for k in range(units):
        fluidity += 1.0 / cu[k]
    pace, give = _paces(k1, c1, ku, cu)
    leads, leads_h = np.zeros(units + 2), np.zeros(units + 2)
    nothing, nowhere = np.empty((0, units + 1)), np.empty((0, units + 2))
    z, y, x, z_max = state[_Z], state[_Y], state[_X], state[_Z_MAX]
    speed, chain_force = state[_SPEED], state[_CHAIN_FORCE]
    rate, rate_before = state[_RATE], state[_RATE_BEFORE]
    contact = state[_CONTACT] > 0.0
    # How far a cohesive zone is open, and how fast it opens.
    cohesive = q[_OPEN] > 0.0 or q[_DECAY] > 0.0
    held_back, gap, opens = state[_HELD_BACK] > 0.0, state[_GAP], state[_OPENS]
    x_start = x

    share = 1.0
    touching = contact
    split = False
    last = 0.0
    if contact:
        last = state[_MEAN]
    if state[_VIRGIN] > 0.0:
        state[_VIRGIN] = 0.0
        touching = True
        if d_start < 0.0:
            share = max(d_end / (d_end - d_start), _SHORTEST)
            split = share > _SHORTEST
    stage = _LOOK
    if held_back:
        opens += state[_PULL] - (d_end - d_start) / h
    if held_back and 0.0 < gap < -opens * h * (1.0 - _SHORTEST):
        stage = _CAUGHT
        share = max(gap / (-opens * h), _SHORTEST)
    force = 0.0
    mean = 0.0
    # The passes of a step, as in the forward model: as it was, and in contact where the tool
    # catches up with the surface; where the contact may end, a look at the whole step and at its
    # first instant, then the part in contact and the rest.
    while True:
        hs = h * share
        target = d_end
        if stage in (_FIRST, _LAST):
            target = d_start + share * (d_end - d_start)
        bound = touching or mass > 0.0
        against = c1 + c2 if bound else c1
        e = _memory_weight(k1, c1, hs, against)[0]
        end = 1.0
        if c0 > 0.0 and bound:
            end = _end_weight(c0 / (hs * fluidity))[0]
        swing = 0.0
        if mass > 0.0:
            swing = _end_weight(mass * (c0 + stiff / k1 + hs * fluidity) / (hs * hs))[0]
        inert = swing * mass / (hs * hs)
        ahead = x + hs * speed
        pull = (d_end - d_start) / h
        tear = 0.0
        lasting = False
        if held_back and not touching:
            torn, _gap, _more, _length, lasting = _held(gap, opens * hs, q[_OPEN], q[_DECAY])
            tear = f_ad * torn
        lead = 0.0
        if touching and c0 > 0.0:
            _lead(
                hs,
                pace,
                give,
                nothing,
                nothing,
                1.0 / fluidity,
                leads_h[:0],
                leads,
                leads_h,
                nowhere,
            )
            climb = leads[0] * pull + leads[1] * z
            for k in range(units):
                climb += leads[2 + k] * zu[k]
            lead = (1.0 - 0.5 * end) * hs * climb
        rest = z + y + c0 * ((1.0 - end) * chain_force + lead)
        ce = end * c0
        for k in range(units):
            left = -np.expm1(-ku[k] / cu[k] * hs)
            rest += zu[k] * (1.0 - left)
            ce += left / ku[k]
        u = (2.0 * rate - rate_before) * hs
        for _ in range(_MOST_ITERATIONS):
            if beta == 0.0 and damage == 0.0:
                fc = k1 * z + e * u
                slope = e
            else:
                fc, slope, _k, _dk, _ek, _ex, _mid = _retarded_unit(
                    u, z, z_max, hs, k1, c1, against, beta, damage, saturation, d_ref
                )
            flow, fluid, _excess = _flow_unit(fc, c2, f_y, p, flow_series)
            x_end = rest + u + hs * flow + ce * fc
            x_slope = 1.0 + (hs * fluid + ce) * slope
            x_mid = 0.5 * (x + x_end)
            growth = 1.0
            d_growth = 0.0
            if m != 0.0:
                growth = 0.0
                if x_mid > 0.0:
                    growth = _power(x_mid / d_ref, m, growth_series)
                    d_growth = m * growth / x_mid
            total = growth * fc + kp * x_mid
            total_slope = growth * slope + 0.5 * x_slope * (d_growth * fc + kp)
            if touching:
                g = x_end - target
                g_slope = x_slope
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
        fc += slope * change
        flow += fluid * slope * change
        x_end += x_slope * change
        total += total_slope * change
        thrust = mass * (pull - speed) / (h if stage == _FIRST else hs)
        probing = stage == _FIRST
        if touching and stage == _LOOK:
            mean = total + thrust
            if 1.5 * mean - 0.5 * last < -f_ad:
                if split:
                    if mean < -f_ad:
                        touching = False
                        held_back, gap, opens = cohesive, 0.0, 0.0
                        share = 1.0
                        split = False
                        rate = 0.0
                        rate_before = 0.0
                        contact = True
                        continue
                else:
                    probing = True
        if stage == _LOOK and not touching and not contact and x_end < d_end:
            touching = True
            held_back = False
            contact = True
            rate = 0.0
            rate_before = 0.0
            if d_end > x > d_start:
                share = max((d_end - x) / (d_end - d_start), _SHORTEST)
                split = share > _SHORTEST
            continue
        if probing:
            if stage == _LOOK:
                stage = _FIRST
                share = _INSTANT
                continue
            first = total + thrust
            share = 1.0
            if first <= -f_ad:
                touching = False
                held_back, gap, opens = cohesive, 0.0, 0.0
                rate = 0.0
                rate_before = 0.0
                stage = _SURE
            elif 2.0 * mean - first >= -f_ad:
                stage = _SURE
            else:
                stage = _LAST
                share = 0.5 * (first + f_ad) / (first - mean)
                share = min(max(share, _SHORTEST), 1.0 - _SHORTEST)
            continue
        for k in range(units):
            zu[k] -= np.expm1(-ku[k] / cu[k] * hs) * (fc / ku[k] - zu[k])
        z += u
        z_max = max(z_max, z)
        y += hs * flow
        rate_before = rate if state[_STEADY] > 0.0 else u / hs
        rate = u / hs
        state[_STEADY] = 1.0 if stage == _LOOK and contact == touching else 0.0
        if bound:
            chain_force += end * (fc - chain_force) + lead
        else:
            chain_force = fc
        if touching:
            force += (total + thrust) * share
            speed = pull
        else:
            speed += swing / hs * (x_end - ahead)
            if held_back:
                force -= tear * share
                opens = (x_end - d_end - gap) / hs
                gap = x_end - d_end
                held_back = lasting
        x = x_end
        contact = touching
        if stage not in (_LAST, _CAUGHT):
            break
        touching = stage == _CAUGHT
        held_back, gap, opens = cohesive and not touching, 0.0, 0.0
        stage = _REST
        share = 1.0 - share
        contact = True
        rate = 0.0
        rate_before = 0.0
    state[_Z], state[_Y], state[_X], state[_Z_MAX] = z, y, x, z_max
    state[_SPEED], state[_CHAIN_FORCE] = speed, chain_force
    state[_RATE], state[_RATE_BEFORE] = rate, rate_before
    state[_CONTACT] = 1.0 if contact else 0.0
    state[_HELD_BACK] = 1.0 if held_back else 0.0
    state[_GAP], state[_OPENS], state[_PULL] = gap, opens, (d_end - d_start) / h
    state[_MEAN] = force
    # Within the step in which the touch ends the rule may pull by some thousandths of the peak.
    force = max(force, -f_ad)
    if q[_GROWTH] != 0.0:
        force *= np.exp(q[_GROWTH] * 0.5 * (x_start + x))
    return force


@dataclass(frozen=True, slots=True)
class _Condition:
    """What the effects of the object ask of a trial."""

    reference_depth: float
    campaign_time: float
    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    depth_before: float = 0.0
    zero_time: float = 0.0


class HapticStepper:
    """
    A body that answers a displacement with a force, step by step.

    Parameters
    ----------
    model : Model
        The model; its effects of the arm and of the sensors are left out, see `left_out`.
    parameters : mapping of str to float
        Its parameters in SI units, by name.
    reference_depth : float, optional
        Depth of the deepest push of the campaign that was fitted [m]: damage and contact growth
        are counted from it.
    campaign_time : float
        When the body is touched, from the start of that campaign [s], for ageing.

    Raises
    ------
    UsageError
        If a parameter is missing or no number, an effect of the object has no step of its own, or
        one needs the reference depth.

    Notes
    -----
    A step takes a time that does not depend on what came before, and asks for no memory. An
    instance holds one contact; it is not to be called from two threads at once.

    """

    __slots__ = ('_numbers', '_state', '_stiffness', '_viscosity', 'left_out')

    def __init__(
        self,
        model: Model,
        parameters: Mapping[str, float],
        *,
        reference_depth: float | None = None,
        campaign_time: float = 0.0,
    ) -> None:
        self.left_out: tuple[str, ...] = tuple(
            effect.name for effect in model.declared if effect.kind != 'object'
        )
        draft, growth = _draft(model, parameters, reference_depth, campaign_time)
        self._numbers = np.append(draft.real_slots, growth)
        units = [(k.real, c.real) for k, c in draft.units if math.isfinite(k.real)]
        self._stiffness = np.array([k for k, _ in units])
        self._viscosity = np.array([c for _, c in units])
        self._state = np.zeros(_STATES + len(units))
        self.reset()
        # Compiled, or read from where compiled kernels are kept, before the loop runs.
        self.step(0.0, 1.0 / RATE)
        self.reset()

    def reset(self, displacement: float = 0.0) -> None:
        """Put the body back as it was before it was ever touched, the tool at a displacement."""
        _start(self._state, self._numbers, float(displacement))

    def step(self, displacement: float, dt: float = 1.0 / RATE) -> float:
        """
        Move the tool and return the force.

        Parameters
        ----------
        displacement : float
            How far the tool is beyond the undeformed surface at the end of the step [m]; negative
            in air. Its way there is taken as straight.
        dt : float
            Length of the step [s], above zero.

        Returns
        -------
        float
            Mean contact force over the step [N]: zero without contact, and below zero only down
            to the pull-off force of a body that sticks.

        Raises
        ------
        UsageError
            If the displacement is not finite or the step is not above zero.

        """
        if not (math.isfinite(displacement) and 0.0 < dt < math.inf):
            raise UsageError(
                f'no step: a displacement of {displacement} m in {dt} s; give finite numbers and '
                'a time above zero'
            )
        force: float = _step(
            displacement, dt, self._numbers, self._stiffness, self._viscosity, self._state
        )
        return force

    @property
    def surface(self) -> float:
        """Return how deep the surface is at the end of the last step, the paper's H [m]."""
        return float(self._state[_X])

    @property
    def touching(self) -> bool:
        """Return whether the tool was in contact at the end of the last step."""
        return bool(self._state[_CONTACT] > 0.0)


def _draft(
    model: Model,
    parameters: Mapping[str, float],
    reference_depth: float | None,
    campaign_time: float,
) -> tuple[Draft, float]:
    """Return the chain of the object, and a of exponential stiffening."""
    for name in model.names:
        # A spring in series may be infinitely stiff.
        if math.isnan(parameters.get(name, math.nan)):
            raise UsageError(f'{name} is not known: a step needs all parameters of {model.name}')
    values = [float(parameters[name]) for name in model.names]
    first = len(BASE_PARAMETERS)
    draft = Draft.of(*values[:first])
    if reference_depth is not None:
        draft.slots[Slot.REFERENCE_DEPTH] = reference_depth
    nothing = np.zeros(0)
    condition = _Condition(
        math.nan if reference_depth is None else reference_depth,
        campaign_time,
        nothing,
        nothing,
        nothing,
    )
    growth = 0.0
    for effect in model.declared:
        last = first + len(effect.parameters)
        own = values[first:last]
        first = last
        if effect.kind != 'object':
            continue
        if effect.named in _COUNTED_FROM_DEPTH and not (reference_depth or 0.0) > 0.0:
            raise UsageError(
                f'{effect.name} is counted from the deepest push of the fitted campaign: give '
                'its depth as reference_depth'
            )
        if effect.shape is not None:
            effect.shape(draft, [complex(value) for value in own], condition)
        elif effect.name == 'exponential_stiffening':
            growth = own[0]
        else:
            raise UsageError(f'{effect.name} has no step of its own: fit a model without it')
    return draft, growth
