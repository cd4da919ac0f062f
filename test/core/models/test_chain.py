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
The chain against an integration of its own equations, closed forms, and thermodynamics.

The reference shares no code with the chain: scipy's Radau on the differential equations, with the
work of the force as a state, so that its mean over a step is exact.
"""

from dataclasses import dataclass, field, replace
import math

from hapticvision_ros.core.effects.declaration import Draft
from hapticvision_ros.core.effects.springpot import EFFECT as SPRINGPOT
from hapticvision_ros.core.effects.springpot import REFERENCE_TIME
from hapticvision_ros.core.models.chain import _gone, Chain, neutral, respond, Slot
from hapticvision_ros.core.models.three_element import respond as respond_exactly
from hapticvision_ros.core.models.three_element import ThreeElement
from hapticvision_ros.sim import specimen
from hapticvision_ros.sim.specimen import integrate, Motion, parameter_vector, Undeclared
from hypothesis import given, settings, strategies
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import gamma

K1, C1, C2 = 5000.0, 20000.0, 60000.0
DEPTH = 0.010
KNOT_T = np.array([0.0, 5.0, 15.0, 40.0])
KNOT_D = np.array([0.0, DEPTH, DEPTH, 0.004])
"""A push, a hold and a slow withdrawal, in which contact is lost."""


@dataclass(frozen=True)
class Body:
    """The numbers of a chain, in the reader's words."""

    K1: float = K1
    C1: float = C1
    C2: float = C2
    F_y: float = 0.0
    n: float = 1.0
    beta: float = 0.0
    D: float = 0.0
    s: float = 0.0
    K_0: float = math.inf
    K_m: float = math.inf
    K_p: float = 0.0
    m: float = 0.0
    F_ad: float = 0.0
    delta_c: float = 0.0
    delta_e: float = 0.0
    M: float = 0.0
    units: tuple[tuple[float, float], ...] = field(default=())

    def chain(self) -> Chain:
        """Return it as the integrator reads it."""
        slots = neutral()
        slots[Slot.K1], slots[Slot.C1], slots[Slot.C2] = self.K1, self.C1, self.C2
        slots[Slot.YIELD_FORCE], slots[Slot.FLOW_INDEX] = self.F_y, self.n
        slots[Slot.STIFFENING], slots[Slot.DAMAGE] = self.beta, self.D
        slots[Slot.SERIES_COMPLIANCE] = 1.0 / self.K_0
        slots[Slot.MACHINE_COMPLIANCE] = 1.0 / self.K_m
        slots[Slot.PARALLEL_STIFFNESS], slots[Slot.CONTACT_EXPONENT] = self.K_p, self.m
        slots[Slot.REFERENCE_DEPTH], slots[Slot.ADHESION] = DEPTH, self.F_ad
        slots[Slot.MASS], slots[Slot.OPENING] = self.M, self.delta_c
        slots[Slot.DECAY], slots[Slot.SATURATION] = self.delta_e, self.s
        units = np.array(self.units).reshape(-1, 2)
        return Chain(slots, units[:, 0].copy(), units[:, 1].copy())

    def flow(self, force: float) -> float:
        """Return the rate of the flow unit."""
        excess = max(abs(force) - self.F_y, 0.0)
        return math.copysign(1e-3 * (excess / (self.C2 * 1e-3)) ** (1.0 / self.n), force)

    def rates(self, force: float, state: np.ndarray) -> np.ndarray:
        """Return the rates of z, z_max, y and the further units under a chain force."""
        z, z_max = state[0], state[1]
        worn = z_max / DEPTH
        if self.s:
            worn = -math.expm1(-self.s * worn) / self.s
        stiffness = self.K1 * (1.0 + self.beta * z * z) * (1.0 - self.D * worn)
        dz = (force - stiffness * z) / self.C1
        growing = z >= z_max - 1e-12 and dz > 0.0
        further = [(force - k * zu) / c for (k, c), zu in zip(self.units, state[3:], strict=True)]
        return np.array([dz, dz if growing else 0.0, self.flow(force), *further])

    def speed(self, force: float, state: np.ndarray) -> float:
        """Return how fast the parts of the chain, K_0 apart, give way together."""
        rates = self.rates(force, state)
        return float(rates[0] + rates[2:].sum())

    def force_at_speed(self, speed: float, state: np.ndarray) -> float:
        """Return the chain force that makes them give way at a speed."""
        reach = 1e3
        while self.speed(reach, state) < speed or self.speed(-reach, state) > speed:
            reach *= 4.0
        return float(brentq(lambda f: self.speed(f, state) - speed, -reach, reach, xtol=1e-12))

    def growth(self, height: float) -> float:
        """Return the factor of the contact patch."""
        return max(height, 0.0) ** self.m / DEPTH**self.m if self.m else 1.0


def _reference(body: Body, t: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean forces over the steps, the surface at their ends, and when it lets go."""
    parts = 3 + len(body.units)
    elastic = math.isfinite(body.K_0) or math.isfinite(body.K_m)

    def height(state: np.ndarray, force: float) -> float:
        return float(state[0] + state[2:parts].sum() + force / body.K_0)

    def held(_: float, s: np.ndarray, speed: float) -> np.ndarray:
        # The states: z, z_max, y, further units, chain force (where it is one), impulse.
        if elastic:
            force = s[parts]
            rates = body.rates(force, s[:parts])
            given = rates[0] + rates[2:].sum()
            # v = H' + (F + K_p H)' / K_m and H' = given + F' / K_0.
            d_force = (speed - given * (1.0 + body.K_p / body.K_m)) / (
                1.0 / body.K_m + (1.0 + body.K_p / body.K_m) / body.K_0
            )
        else:
            force = body.force_at_speed(speed, s[:parts])
            rates = body.rates(force, s[:parts])
            d_force = 0.0
        return np.array([*rates, d_force, contact(force, s)])

    def contact(force: float, s: np.ndarray) -> float:
        h = height(s[:parts], force)
        return body.growth(h) * force + body.K_p * h

    def lost(_: float, s: np.ndarray, speed: float) -> float:
        force = s[parts] if elastic else body.force_at_speed(speed, s[:parts])
        return contact(force, s) + body.F_ad

    def under(pull: float, states: np.ndarray) -> np.ndarray:
        # The parallel spring presses the chain flat; what holds the surface pulls at both.
        h0 = states[0] + states[2:parts].sum(axis=0)
        return np.asarray(-(pull + body.K_p * h0) / (1.0 + body.K_p / body.K_0))

    def drawn(now: float, s: np.ndarray, pull: float) -> float:
        """Return what is left of a pull at the opening that it makes itself."""
        left = pull
        for _ in range(20 if body.delta_e else 0):
            tip = np.interp(now, KNOT_T, KNOT_D) + left / body.K_m
            gap = height(s[:parts], float(under(left, s))) - tip
            left = pull * math.exp(-gap / body.delta_e)
        return left

    def free(now: float, s: np.ndarray, pull: float) -> np.ndarray:
        left = drawn(now, s, pull)
        return np.array([*body.rates(float(under(left, s)), s[:parts]), 0.0, -left])

    def torn(now: float, s: np.ndarray, pull: float) -> float:
        h = height(s[:parts], float(under(pull, s)))
        tip = np.interp(now, KNOT_T, KNOT_D) + pull / body.K_m
        return float(h - tip - body.delta_c)

    lost.terminal = True  # type: ignore[attr-defined]
    lost.direction = -1.0  # type: ignore[attr-defined]
    torn.terminal = True  # type: ignore[attr-defined]
    state = np.zeros(parts + 2)
    impulse, surface = np.zeros(t.size), np.zeros(t.size)
    options = {'method': 'Radau', 'rtol': 1e-8, 'atol': 1e-13, 'dense_output': True}
    if body.D:
        options['max_step'] = 0.05
    if body.m:
        # At the touch its slope has no bound; it is held against a coarse one.
        options['rtol'] = 1e-6
    t_loss = math.inf
    for start, stop, low, high in zip(
        KNOT_T[:-1], KNOT_T[1:], KNOT_D[:-1], KNOT_D[1:], strict=True
    ):
        speed = (high - low) / (stop - start)
        with np.errstate(over='ignore'):
            # A slider at rest has no slope: Radau widens its difference in vain.
            run = solve_ivp(held, (start, stop), state, args=(speed,), events=lost, **options)
        inside = (t > start) & (t <= run.t[-1])
        if not inside.any():
            break
        states = run.sol(t[inside])
        impulse[inside] = states[-1]
        surface[inside] = states[0] + states[2:parts].sum(axis=0) + states[parts] / body.K_0
        state = run.y[:, -1]
        if run.status == 1 and start > 0.0:
            t_loss = run.t[-1]
            break
    if math.isfinite(t_loss):
        for pull in (body.F_ad, 0.0) if body.delta_c else (body.F_ad if body.delta_e else 0.0,):
            events = torn if body.delta_c and pull else None
            run = solve_ivp(free, (t_loss, t[-1]), state, args=(pull,), events=events, **options)
            after = t > t_loss
            states = run.sol(t[after])
            impulse[after] = states[-1]
            left = np.array([drawn(*each, pull) for each in zip(t[after], states.T, strict=True)])
            surface[after] = (
                states[0] + states[2:parts].sum(axis=0) + under(left, states) / body.K_0
            )
            t_loss, state = (run.t[-1], run.y[:, -1]) if events else (t_loss, state)
    return np.diff(impulse) / np.diff(t), surface, t_loss


BODIES = {
    'base': Body(),
    'slider': Body(F_y=6.0),
    'series spring': Body(K_0=2e4),
    'parallel spring': Body(K_p=300.0),
    'second unit': Body(units=((15000.0, 9000.0),)),
    'stiffening': Body(beta=3e4),
    'thinning': Body(n=0.6),
    'growth': Body(m=0.5),
    'damage': Body(D=0.4),
    'machine': Body(K_m=3e4),
    'adhesion': Body(F_ad=1.0),
    'adhesion on a spring': Body(F_ad=1.0, K_0=2e4),
    'cohesive zone': Body(F_ad=1.0, delta_c=1e-3),
    'cohesive zone on springs in a machine': Body(
        F_ad=1.0, delta_c=1e-3, K_0=3e4, K_p=200.0, K_m=5e4
    ),
    'cohesive zone that draws a stiffening body out': Body(F_ad=3.0, delta_c=2e-3, beta=3e4),
    'fading zone': Body(F_ad=1.0, delta_e=5e-4),
    'fading zone on springs in a machine': Body(
        F_ad=1.0, delta_e=5e-4, K_0=3e4, K_p=200.0, K_m=5e4
    ),
    'fading zone that draws a stiffening body out': Body(F_ad=3.0, delta_e=1e-3, beta=3e4),
    'slider on a stiffening spring in a soft machine': Body(F_y=4.0, beta=3e4, K_m=3e4),
    'two springs': Body(K_0=3e4, K_m=5e4, K_p=200.0),
    'thinning with a second unit': Body(n=0.7, units=((15000.0, 9000.0),)),
}
COARSE = {'growth': 3e-3, 'damage': 3e-4}
"""Of the largest force: the factor (H / d_ref)^m has no derivative at the touch, and the damage is
that of the largest stretch at the end of the step before."""


@pytest.mark.parametrize('name', BODIES)
def test_force_and_surface_are_those_of_the_equations(name: str) -> None:
    body = BODIES[name]
    t = np.linspace(0.0, 40.0, 4001)
    force, surface, t_loss = _reference(body, t)
    found = respond(t, np.interp(t, KNOT_T, KNOT_D), body.chain())
    error = np.abs(found.force - force)
    # The error of a scheme of second order with steps of 10 ms; at the loss the last instants of
    # contact are one trapezium.
    bound = COARSE.get(name, 3e-5)
    near = np.abs(t[1:] - t_loss) < 0.03
    assert error[~near].max() < bound * force.max()
    assert error.max() < max(bound, 2e-3) * force.max() + body.F_ad * 0.1
    away = np.abs(t - t_loss) > 0.03
    assert np.abs(found.surface - surface)[away].max() < bound * DEPTH
    if math.isfinite(t_loss) and not body.delta_e:
        assert not found.force[t[:-1] > t_loss + 0.02].any()


def _along(*slots: Slot, units: int = 0) -> Chain:
    """Return the directions of some numbers of a chain, each alone."""
    return Chain(np.eye(len(Slot))[list(slots)], *np.zeros((2, len(slots), units)))


def _slope(chain: Chain, slot: Slot, t: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """Return how the force changes with a number of the chain, by differences."""
    step = 1e-6 * chain.slots[slot]
    sides = []
    for sign in (-1.0, 1.0):
        moved = replace(chain, slots=chain.slots.copy())
        moved.slots[slot] += sign * step
        sides.append(respond(t, displacement, moved).force)
    return np.asarray((sides[1] - sides[0]) / (2.0 * step))


@pytest.mark.parametrize(
    'body',
    [
        Body(F_ad=1.0, delta_c=3e-3),
        Body(F_ad=3.0, delta_c=3e-3, K_m=2e4),
        Body(F_ad=3.0, delta_c=3e-3, K_m=2e4, K_0=3e4),
        Body(F_ad=1.0, delta_e=3e-3),
        Body(F_ad=3.0, delta_e=3e-3, K_m=2e4),
        Body(F_ad=3.0, delta_e=3e-3, K_m=2e4, K_0=3e4),
    ],
)
def test_a_tool_that_comes_back_while_it_is_held_meets_what_holds_it(body: Body) -> None:
    """Against the simulated world, whose events are found by bisection."""
    knot_t = np.array([0.0, 5.0, 6.0, 9.0, 9.5, 12.0, 16.0])
    knot_d = np.array([0.0, 8.0, 8.0, 3.5, 3.5, 8.0, 8.0]) * 1e-3
    motion = Motion(knot_t[:-1], knot_d[:-1], np.diff(knot_d) / np.diff(knot_t), np.zeros(6))
    effects = [Undeclared('necking', (body.F_ad, body.delta_c))]
    if body.delta_e:
        effects = [Undeclared('stringing', (body.F_ad, body.delta_e))]
    if math.isfinite(body.K_m):
        effects.append(Undeclared('machine_compliance', (body.K_m,)))
    if math.isfinite(body.K_0):
        effects.append(Undeclared('series_spring', (body.K_0,)))
    t = np.linspace(0.0, 16.0, 16001)
    vector = parameter_vector(specimen.Body(K1, C1, C2), effects)
    world = integrate(t, motion, vector, reference_depth=DEPTH)
    impulse = np.concatenate(([0.0], np.cumsum(world.force * np.diff(world.t))))
    force = np.diff(np.interp(t, world.t, impulse)) / np.diff(t)
    assert np.count_nonzero(force < -(0.3 if body.delta_e else 0.999) * body.F_ad) > 1000
    displacement = np.interp(t, knot_t, knot_d)
    slots = [Slot.K1, Slot.C2, Slot.ADHESION, *([Slot.DECAY] if body.delta_e else [])]
    found = respond(t, displacement, body.chain(), _along(*slots))
    assert np.abs(found.force - force).max() < (3e-4 if body.delta_e else 2e-4)
    for slot, tangent in zip(slots, found.force_tangent, strict=True):
        slope = _slope(body.chain(), slot, t, displacement)
        assert tangent == pytest.approx(slope, abs=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize('body', [Body(F_ad=1.0, delta_c=3e-3), Body(F_ad=1.0, delta_e=1.5e-3)])
@pytest.mark.parametrize('h', [0.01, 0.02])
def test_a_tool_that_turns_back_before_it_meets_what_holds_it_goes_free(
    body: Body, h: float
) -> None:
    t = np.arange(0.0, 5.4, h)
    for top in np.linspace(3e-3, 7e-3, 41):
        knot_d = [-1e-3, 8e-3, 8e-3, 3e-3, float(top), -5e-3]
        found = respond(t, np.interp(t, [0.0, 2.0, 3.0, 3.8, 4.4, 5.4], knot_d), body.chain())
        assert found.force.min() > -1.05 * body.F_ad


def test_a_zone_that_opens_for_a_second_time_opens_from_nothing() -> None:
    knot_t = [0.0, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0]
    t = np.arange(0.0, 8.0, 0.01)
    d = np.interp(t, knot_t, np.array([-1.0, 8.0, 8.0, 3.0, 8.0, 8.0, -4.0]) * 1e-3)
    body = Body(F_ad=3.0, delta_e=3e-4)
    for slot in (Slot.K1, Slot.ADHESION, Slot.DECAY):
        found = respond(t, d, body.chain(), _along(slot)).force_tangent[0]
        slope = _slope(body.chain(), slot, t, d)
        assert found == pytest.approx(slope, abs=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize(
    ('effect', 'damage', 'saturation'),
    [
        (Undeclared('lasting_damage', (0.3,)), 0.3, 0.0),
        # A length of a quarter of d_ref; at its end the slopes are 1e-2 of those at the start.
        (Undeclared('early_lasting_damage', (0.3, 0.25 * DEPTH)), 1.2 / (1 - math.exp(-4)), 4.0),
    ],
    ids=['linear', 'saturating'],
)
def test_damage_of_earlier_pushes_stays(
    effect: Undeclared, damage: float, saturation: float
) -> None:
    """Against the simulated world, beyond and below what has been stretched before."""
    body = Body(D=damage, s=saturation)
    t = np.linspace(0.0, 40.0, 4001)
    d = np.interp(t, KNOT_T, KNOT_D)
    motion = Motion(KNOT_T[:-1], KNOT_D[:-1], np.diff(KNOT_D) / np.diff(KNOT_T), np.zeros(3))
    vector = parameter_vector(specimen.Body(K1, C1, C2), [effect])
    fresh = respond(t, d, body.chain()).force
    slots = (Slot.STRETCHED, Slot.DAMAGE, *((Slot.SATURATION,) if saturation else ()))
    for before in (0.002, 0.012):
        world = integrate(t, motion, vector, reference_depth=DEPTH, stretched=before)
        impulse = np.concatenate(([0.0], np.cumsum(world.force * np.diff(world.t))))
        force = np.diff(np.interp(t, world.t, impulse)) / np.diff(t)
        chain = body.chain()
        chain.slots[Slot.STRETCHED] = before
        found = respond(t, d, chain, _along(*slots))
        near = np.abs(t[1:] - world.t_loss) < 0.03
        assert np.abs(found.force - force)[~near].max() < 3e-4 * force.max()
        assert np.abs(found.force - fresh).max() > 2e-3 * force.max()
        for slot, tangent in zip(slots, found.force_tangent, strict=True):
            slope = _slope(chain, slot, t, d)
            assert tangent == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


def test_a_thinning_that_is_none_yet_has_its_derivative() -> None:
    t = np.linspace(0.0, 14.0, 1401)
    d = np.interp(t, KNOT_T, KNOT_D)
    found = respond(t, d, Body().chain(), _along(Slot.FLOW_INDEX)).force_tangent[0]
    sides = [respond(t, d, Body(n=1.0 + step).chain()).force for step in (-1e-5, 1e-5)]
    slope = (sides[1] - sides[0]) / 2e-5
    assert found == pytest.approx(slope, abs=1e-4 * np.abs(slope).max())


def test_what_a_unit_has_gone_is_exact_in_steps_of_any_length() -> None:
    """Beside the series for short ones, and where nothing is left."""
    x = np.concatenate(([0.0, np.nextafter(0.1, 0.0), 0.1, 40.0, 1e9], np.geomspace(1e-12, 60.0)))
    np.testing.assert_allclose([_gone(each) for each in x], -np.expm1(-x), rtol=1e-13)


@pytest.mark.parametrize('name', ['series spring', 'second unit', 'thinning', 'machine'])
def test_half_the_step_is_a_quarter_of_the_error(name: str) -> None:
    body = BODIES[name]
    errors = []
    for n in (25, 50, 100):
        t = np.linspace(0.0, 15.0, 3 * n + 1)
        force, _, _ = _reference(body, t)
        found = respond(t, np.interp(t, KNOT_T, KNOT_D), body.chain()).force
        # Corners apart, at whose first instants a fast force is not resolved.
        smooth = (np.abs(t[1:] - 5.0) > 0.5) & (t[1:] > 0.5)
        errors.append(np.abs(found - force)[smooth].max())
    assert errors[1] < errors[0] / 2.8
    assert errors[2] < errors[1] / 3.3


STIFF = {
    'series spring': Body(K_0=1e5, C1=2000.0),
    'machine': Body(K_m=1e5, C1=2000.0),
    'machine with a parallel spring': Body(K_m=1e5, C1=2000.0, K_p=800.0),
    'with a second unit': Body(K_0=1e5, C1=2000.0, units=((15000.0, 9000.0),)),
}


@pytest.mark.parametrize('name', STIFF)
def test_a_stiff_spring_is_followed_over_long_and_uneven_steps(name: str) -> None:
    """A spring that gives within 20 ms, through steps of 20 to 90 ms, as of stamps that jitter."""
    body = STIFF[name]
    steps = np.random.default_rng(3).uniform(0.02, 0.09, 400)
    t = np.unique(np.concatenate((np.cumsum(steps)[np.cumsum(steps) < 15.0], KNOT_T[:3])))
    force, _, _ = _reference(body, t)
    found = respond(t, np.interp(t, KNOT_T, KNOT_D), body.chain()).force
    smooth = (np.abs(t[1:] - 5.0) > 0.5) & (t[1:] > 0.5)
    assert np.abs(found - force)[smooth].max() < 2e-4 * force.max()


def test_a_unit_that_yields_at_once_on_a_soft_spring_is_followed_as_well() -> None:
    """Within a hundredth of a step; what it yields in one is no more than it has to."""
    t = np.linspace(0.0, 15.0, 1501)
    body = Body(K_0=1e4, units=((1e5, 10.0),))
    force, _, _ = _reference(body, t)
    found = respond(t, np.interp(t, KNOT_T, KNOT_D), body.chain()).force
    smooth = (np.abs(t[1:] - 5.0) > 0.5) & (t[1:] > 0.5)
    assert np.abs(found - force)[smooth].max() < 2e-3 * force.max()


def test_the_base_is_the_exact_model_of_the_paper_through_push_hold_and_recovery() -> None:
    # Eqs. (8), (10) and (12), in the closed form of the three-element model.
    t = np.linspace(0.0, 100.0, 20001)
    knot_t, knot_d = np.array([0.0, 5.0, 35.0, 35.5, 100.0]), DEPTH * np.array([0, 1, 1, -1, -1.0])
    found = respond(t, np.interp(t, knot_t, knot_d), Body().chain())
    exact = respond_exactly(ThreeElement(K1, C1, C2), t, knot_t, knot_d)
    between = respond_exactly(ThreeElement(K1, C1, C2), t[:-1] + 2.5e-3, knot_t, knot_d)
    assert exact.t_loss == 35.0
    # The force in the middle of a step is its mean but for (h / T)^2 / 24.
    assert np.abs(found.force - between.force).max() < 1e-6 * between.force.max()
    assert np.abs(found.surface - exact.height).max() < 1e-6 * DEPTH


def test_the_three_elements_are_exact_for_steps_of_any_length() -> None:
    knots = np.array([0.0, 1.0, 5.0, 12.0, 15.0, 35.0, 35.1, 60.0, 100.0])
    d = np.interp(knots, [0.0, 5.0, 35.0, 35.1, 100.0], DEPTH * np.array([0, 1, 1, -1, -1.0]))
    fine = np.unique(np.concatenate([knots, np.linspace(0.0, 100.0, 50001)]))
    for body in (Body(), Body(C1=1e-3), Body(C1=0.0)):
        coarse = respond(knots, d, body.chain())
        resolved = respond(fine, np.interp(fine, knots, d), body.chain())
        impulse = np.concatenate([[0.0], np.cumsum(resolved.force * np.diff(fine))])
        means = np.diff(impulse[np.searchsorted(fine, knots)]) / np.diff(knots)
        # Where C1 is nothing, what is left is the instant of the loss.
        assert np.allclose(coarse.force[:5], means[:5], rtol=1e-9)
        at = np.searchsorted(fine, knots)
        assert np.allclose(coarse.surface, resolved.surface[at], rtol=0.0, atol=1e-3 * DEPTH)


def test_a_step_is_answered_by_the_maxwell_branch() -> None:
    # A tool that is down within 1 us: F decays from k d with the relaxation time of eq. (9).
    t = np.concatenate([[0.0, 1e-6], 1e-6 + np.linspace(0.01, 60.0, 6000)])
    d = np.full(t.size, DEPTH)
    d[0] = 0.0
    found = respond(t, d, Body().chain()).force[1:]
    body = ThreeElement(K1, C1, C2)
    middle = 0.5 * (t[1:-1] + t[2:])
    assert np.allclose(found, body.k * DEPTH * np.exp(-middle / body.relaxation_time), rtol=1e-6)


def test_the_reduction_of_each_slot_is_continuous() -> None:
    # Towards zero strength the answer goes to the base, in proportion to the strength.
    t = np.linspace(0.0, 30.0, 3001)
    d = np.interp(t, KNOT_T, KNOT_D)
    base = respond(t, d, Body().chain())
    for weak, weaker in (
        (Body(F_y=1e-3), Body(F_y=1e-4)),
        (Body(n=1.0 - 1e-4), Body(n=1.0 - 1e-5)),
        (Body(beta=10.0), Body(beta=1.0)),
        (Body(D=1e-4), Body(D=1e-5)),
        (Body(K_p=0.1), Body(K_p=0.01)),
        (Body(m=1e-4), Body(m=1e-5)),
        (Body(K_0=1e9), Body(K_0=1e10)),
        (Body(K_m=1e9), Body(K_m=1e10)),
        (Body(units=((1e9, 1e9),)), Body(units=((1e10, 1e10),))),
    ):
        far, near = (
            np.abs(respond(t, d, body.chain()).force - base.force).sum() for body in (weak, weaker)
        )
        assert far == pytest.approx(10.0 * near, rel=0.05)
        assert near < 1e-4 * base.force.sum()


def _mittag_leffler(x: np.ndarray, alpha: float, beta: float) -> np.ndarray:
    """Return E_{alpha,beta}(-x) by its power series, for x of order one."""
    terms = np.arange(120)
    powers = (-x[:, np.newaxis]) ** terms
    return np.sum(powers / gamma(alpha * terms + beta), axis=1)


@pytest.mark.parametrize('alpha', [0.4, 0.7, 0.95])
def test_a_spring_and_a_springpot_relax_as_mittag_leffler(alpha: float) -> None:
    # G(t) = K E_alpha(-(t / T)^alpha), T^alpha = c / K, under a ramp and a hold.
    draft = Draft.of(K1, 0.0, C2)
    assert SPRINGPOT.shape is not None
    SPRINGPOT.shape(draft, [complex(alpha)], None)  # type: ignore[arg-type]
    units = np.array(draft.units).real
    chain = Chain(draft.real_slots, units[:, 0].copy(), units[:, 1].copy())
    t = np.linspace(0.0, 12.0, 4801)
    found = respond(t, np.interp(t, [0.0, 4.0, 12.0], [0.0, DEPTH, DEPTH]), chain).force
    spread = C2 * REFERENCE_TIME ** (alpha - 1.0) / K1

    def ramp(since: np.ndarray) -> np.ndarray:
        since = np.maximum(since, 0.0)
        x = since**alpha / spread
        return K1 * DEPTH / 4.0 * since * _mittag_leffler(x, alpha, 2.0)

    middle = 0.5 * (t[1:] + t[:-1])
    expected = ramp(middle) - ramp(middle - 4.0)
    smooth = (np.abs(middle - 4.0) > 0.02) & (middle > 0.02)
    # The sum of exponentials is good to 1e-3 (its docstring), the steps to less.
    assert np.abs(found - expected)[smooth].max() < 1e-3 * expected.max()


@pytest.mark.parametrize('alpha', [0.05, 0.3, 0.6, 0.9, 0.99])
def test_the_creep_of_the_exponentials_is_the_power_law(alpha: float) -> None:
    draft = Draft()
    assert SPRINGPOT.shape is not None
    SPRINGPOT.shape(draft, [complex(alpha)], None)  # type: ignore[arg-type]
    t = np.geomspace(1e-3, 1e3, 200)
    creep = draft.slots[Slot.SERIES_COMPLIANCE].real + t / draft.slots[Slot.C2].real
    for stiffness, viscosity in draft.units:
        creep += -np.expm1(-t * (stiffness / viscosity).real) / stiffness.real
    exact = t**alpha * REFERENCE_TIME ** (1.0 - alpha) / gamma(1.0 + alpha)
    assert np.abs(creep / exact - 1.0).max() < 1e-3


@pytest.mark.parametrize('viscosity', [0.0, 2.0, 40.0])
def test_a_freed_mass_vibrates_as_its_equation_says(viscosity: float) -> None:
    # M H'' = -F, F = K1 z + C1 z' = C2 y', after a tool that leaves at once.
    body = Body(C1=viscosity, C2=2000.0, M=0.2)
    t = np.arange(0.0, 1.0, 2e-4)
    d = np.interp(t, [0.0, 0.3, 0.5, 0.5002, 1.0], DEPTH * np.array([0.0, 1.0, 1.0, -5.0, -5.0]))
    found = respond(t, d, body.chain())
    held = respond(t, np.minimum(np.interp(t, [0.0, 0.3], [0.0, DEPTH]), DEPTH), body.chain())
    start = round(0.5 / 2e-4)
    force = held.force[start - 1]
    if viscosity:
        r = body.C2 / (body.C1 + body.C2)
        z0 = force / (r * K1)
    else:
        z0 = force / K1

    def motion(t: float, s: np.ndarray) -> list[float]:
        z, _, speed = s
        if viscosity:
            f = (speed + K1 * z / body.C1) / (1.0 / body.C1 + 1.0 / body.C2)
            return [(f - K1 * z) / body.C1, f / body.C2, -f / body.M]
        f = K1 * z
        return [speed - f / body.C2, f / body.C2, -f / body.M]

    run = solve_ivp(
        motion,
        (0.5, 1.0),
        [z0, DEPTH - z0, 0.0],
        method='DOP853',
        rtol=1e-10,
        atol=1e-14,
        t_eval=t[start:],
    )
    expected = run.y[0] + run.y[1]
    swing = np.ptp(expected)
    crossings = np.count_nonzero(np.diff(np.sign(np.diff(expected))))
    assert crossings >= 5, 'it vibrates'
    # Half a step of lateness at the release and 2e-3 (h w)^2 of the phase in 10 periods.
    assert np.abs(found.surface[start:] - expected).max() < 2e-2 * swing


def test_without_a_mass_the_free_surface_does_not_vibrate() -> None:
    t = np.arange(0.0, 1.0, 2e-4)
    d = np.interp(t, [0.0, 0.3, 0.5, 0.5002, 1.0], DEPTH * np.array([0.0, 1.0, 1.0, -5.0, -5.0]))
    surface = respond(t, d, Body(C1=40.0).chain()).surface
    assert np.all(np.diff(surface[t > 0.501]) <= 0.0)


strength = strategies.floats(0.0, 1.0)


@given(
    sizes=strategies.tuples(*(strategies.floats(-1.0, 1.0) for _ in range(3))),
    strengths=strategies.tuples(*(strength for _ in range(9))),
    path=strategies.lists(strategies.floats(-0.5, 1.0), min_size=3, max_size=7),
)
@settings(max_examples=150, deadline=None)
def test_no_body_gives_back_more_work_than_was_done_on_it(
    sizes: tuple[float, ...], strengths: tuple[float, ...], path: list[float]
) -> None:
    a = strengths
    body = Body(
        K1=K1 * 10.0 ** sizes[0],
        C1=C1 * 10.0 ** sizes[1],
        C2=C2 * 10.0 ** sizes[2],
        F_y=10.0 * a[0],
        n=1.0 - 0.6 * a[1],
        beta=3e4 * a[2],
        D=0.5 * a[3],
        K_0=2e4 / (a[4] + 1e-3),
        K_m=2e4 / (a[5] + 1e-3),
        K_p=500.0 * a[6],
        F_ad=3.0 * a[7],
        units=((15000.0, 9000.0),) if a[8] > 0.5 else (),
    )
    knots = np.linspace(0.0, 20.0, len(path) + 2)
    t = np.linspace(0.0, 20.0, 2001)
    d = np.interp(t, knots, DEPTH * np.array([0.0, *path, -1.0]))
    found = respond(t, d, body.chain())
    assert np.isfinite(found.force).all()
    assert np.isfinite(found.surface).all()
    # What the tool has done up to any time is stored or lost, never negative. In the step of the
    # touch and of the loss the tool moves further than it pushes: that much is the steps'.
    work = np.concatenate([[0.0], np.cumsum(found.force * np.diff(d))])
    touches = np.count_nonzero(np.diff((found.force != 0.0).astype(int)))
    slack = np.abs(found.force).max(initial=0.0) * np.abs(np.diff(d)).max() * (touches + 1)
    assert work.min() >= -slack


@settings(max_examples=100, deadline=None)
@given(
    C1=strategies.floats(1e2, 1e6),
    C2=strategies.floats(1e3, 1e7),
    K_0=strategies.sampled_from((math.inf, 2e3, 1e6)),
    K_m=strategies.sampled_from((math.inf, 3e4)),
    K_p=strategies.sampled_from((0.0, 200.0)),
    F_ad=strategies.sampled_from((0.0, 0.5)),
    units=strategies.lists(
        strategies.tuples(strategies.floats(1e2, 1e5), strategies.floats(1e2, 1e6)), max_size=4
    ),
    seed=strategies.integers(0, 10_000),
)
def test_the_response_is_the_same_with_and_without_its_sensitivities(
    C1: float,
    C2: float,
    K_0: float,
    K_m: float,
    K_p: float,
    F_ad: float,
    units: list[tuple[float, float]],
    seed: int,
) -> None:
    # The two ways of a linear chain through a run of equal steps are not the same code.
    body = Body(C1=C1, C2=C2, K_0=K_0, K_m=K_m, K_p=K_p, F_ad=F_ad, units=tuple(units))
    rng = np.random.default_rng(seed)
    # Runs of steps of one length each, and a second push.
    t = np.concatenate(([0.0], np.cumsum(np.repeat(rng.uniform(0.01, 0.3, 12), 25))))
    d = np.interp(
        t, np.linspace(0.0, t[-1], 7), [-0.001, DEPTH, DEPTH, -0.003, -0.003, DEPTH, 0.0]
    )
    alone = respond(t, d, body.chain())
    beside = respond(t, d, body.chain(), _along(Slot.K1, units=len(units)))
    # Sums in another order, over 300 steps.
    assert alone.force == pytest.approx(beside.force, abs=1e-10 * np.abs(beside.force).max())
    assert alone.surface == pytest.approx(beside.surface, abs=1e-10 * DEPTH)


def test_a_tool_in_air_meets_nothing() -> None:
    t = np.linspace(0.0, 5.0, 501)
    found = respond(t, np.full(t.size, -1e-3), Body().chain(), _along(*Slot))
    for array in (found.force, found.surface, found.force_tangent, found.surface_tangent):
        assert not array.any()


@pytest.mark.parametrize('alpha', [0.5, 0.7, 0.8, 0.9])
@pytest.mark.parametrize('hold', [2.0, 5.0])
def test_without_adhesion_nothing_pulls_at_the_tool(alpha: float, hold: float) -> None:
    # What relaxes within the step of the loss falls faster than a straight line.
    draft = Draft.of(1000.0, 800.0, 1600.0)
    SPRINGPOT.shape(draft, [alpha], None)
    units = np.array([[k.real, c.real] for k, c in draft.units])
    chain = Chain(draft.real_slots, units[:, 0].copy(), units[:, 1].copy())
    t = np.arange(0.0, hold + 5.0, 1e-3)
    stop = 1.0 + 0.8
    d = np.interp(
        t, [0.0, 1.0, stop, stop + hold, stop + hold + 0.9], [-1e-3, 0.0, 0.008, 0.008, -0.01]
    )
    force = respond(t, d, chain).force
    assert force.min() > -5e-4 * force.max()


def test_a_tool_at_rest_loses_no_contact_to_what_only_relaxes() -> None:
    # Four relaxation times within a step: the line through two means crosses zero at once.
    body = Body(K1=1000.0, C1=5.0, C2=20.0)
    t = np.arange(0.0, 30.0, 0.1)
    d = np.interp(t, [0.0, 1.0, 3.0, 30.0], [-1e-3, 0.0, 0.006, 0.006])
    force = respond(t, d, body.chain()).force
    held = (t[:-1] > 3.0) & (t[:-1] < 10.0)
    assert np.all(force[held] > 0.0)


def test_the_touch_may_fall_anywhere_within_a_step() -> None:
    # The mean force over the step of the touch grows with the square of what is left of the step
    # for a spring, and is continuous as the touch crosses the step's end.
    t = np.linspace(0.0, 1.0, 101)
    impulses = []
    for touch in np.linspace(0.495, 0.515, 81):
        d = 1e-3 * (t - touch)
        impulses.append(respond(t, d, Body().chain()).force.sum())
    steps = np.diff(impulses)
    assert np.all(steps < 0.0)
    assert steps.min() > 1.5 * steps.max()
    assert steps.max() / steps.min() > 0.5


def test_the_tool_catches_up_with_the_surface_that_it_left() -> None:
    t = np.linspace(0.0, 60.0, 6001)
    d = np.interp(
        t, [0.0, 5.0, 15.0, 15.5, 30.0, 33.0, 60.0], DEPTH * np.array([0, 1, 1, 0, 0, 1.1, 1.1])
    )
    found = respond(t, d, Body().chain())
    free = (t > 16.0) & (t < 30.0)
    assert not found.force[free[1:]].any()
    residual = found.surface[np.searchsorted(t, 30.0)]
    assert 0.0 < residual < DEPTH
    again = t[1:][(t[1:] > 30.0) & (found.force > 0.0)][0]
    assert again == pytest.approx(np.interp(residual, [0.0, 1.1 * DEPTH], [30.0, 33.0]), abs=0.05)
    assert np.allclose(found.surface[t > 33.0], 1.1 * DEPTH)
