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

"""The integrator of the specimens against closed forms and against scipy."""

from collections.abc import Callable
import math
from typing import Any

from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.sim.specimen import (
    Body,
    History,
    integrate,
    Motion,
    parameter_vector,
    Undeclared,
)
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.special import gamma

BODY = Body(2000.0, 1600.0, 2400.0)
SPEED, DEPTH, HOLD = 0.008, 0.006, 4.0
PUSHED = DEPTH / SPEED
STEP = 4e-4
"""A tenth of the interval of a load cell at 250 Hz [s]."""


def motion(hold: float = HOLD, release: float = 0.05) -> Motion:
    """Return a push at a steady speed that starts in touch, a hold, and a withdrawal."""
    return Motion(
        np.array([0.0, PUSHED, PUSHED + hold]),
        np.array([0.0, DEPTH, DEPTH]),
        np.array([SPEED, 0.0, -release]),
        np.zeros(3),
    )


def push(
    *effects: Undeclared, until: float = PUSHED + HOLD, step: float = STEP, body: Body = BODY
) -> History:
    """Return what a specimen does under that motion."""
    grid = np.arange(0.0, until + 0.5 * step, step)
    return integrate(grid, motion(), parameter_vector(body, effects), reference_depth=DEPTH)


def means(t: np.ndarray, force: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Return the means of a smooth force between the moments `t` (Simpson's rule)."""
    a, b = t[:-1], t[1:]
    inside = 1e-9 * (b - a)
    return (force(a + inside) + 4.0 * force(0.5 * (a + b)) + force(b - inside)) / 6.0


def test_three_elements_follow_their_closed_form_in_push_and_hold() -> None:
    got = push()
    T = BODY.relaxation_time

    def force(t: np.ndarray) -> np.ndarray:
        pushing = BODY.C2 * SPEED * (1.0 - BODY.C2 / (BODY.C1 + BODY.C2) * np.exp(-t / T))
        z = BODY.C2 * SPEED / BODY.K1 * -np.expm1(-PUSHED / T)
        holding = BODY.K1 * z * BODY.C2 / (BODY.C1 + BODY.C2) * np.exp(-(t - PUSHED) / T)
        return np.where(t < PUSHED, pushing, holding)

    # The rule is of second order: its error is (STEP / T)^2 = 4e-8 of the force.
    np.testing.assert_allclose(got.force[1:], means(got.t, force)[1:], rtol=1e-6)
    assert got.t_touch == pytest.approx(0.0, abs=1e-9)


def test_a_freed_surface_recovers_with_the_retardation_time() -> None:
    got = push(until=PUSHED + HOLD + 3.0)
    T = BODY.relaxation_time
    z = BODY.C2 * SPEED / BODY.K1 * -np.expm1(-PUSHED / T) * math.exp(-HOLD / T)
    free = got.t > got.t_loss + STEP
    expected = DEPTH - z * -np.expm1(-(got.t - PUSHED - HOLD) / BODY.retardation_time)
    # The tool leaves at once, faster than the surface can follow.
    assert got.t_loss == pytest.approx(PUSHED + HOLD, abs=STEP)
    np.testing.assert_allclose(got.surface[free], expected[free], atol=1e-7 * DEPTH)
    assert np.all(got.force[got.t[:-1] > got.t_loss] == 0.0)


def test_touch_between_two_steps_is_found_where_it_is() -> None:
    late = 0.12345e-3
    below = Motion(np.zeros(1), np.array([-late]), np.array([SPEED]), np.zeros(1))
    got = integrate(np.arange(0.0, 0.1, STEP), below, parameter_vector(BODY))
    assert got.t_touch == pytest.approx(late / SPEED, abs=1e-10)
    at_touch = BODY.C1 * BODY.C2 / (BODY.C1 + BODY.C2) * SPEED
    first = int(np.searchsorted(got.t, got.t_touch, side='right'))
    assert got.force[first - 2] == 0.0
    assert got.force[first] == pytest.approx(at_touch, rel=1e-3)


class Network:
    """The same network as ordinary differential equations, for scipy's Radau."""

    beta, n, F_y, K_0, K_p, K_2, C_3, K_m, M = 2e4, 0.8, 0.6, 3e4, 150.0, 6e3, 900.0, 8e4, 3.0
    z_max = 0.0
    damage = 0.0
    length = math.inf

    def flow(self, f: float) -> float:
        """Return dy/dt of the flow unit."""
        over = max(abs(f) - self.F_y, 0.0)
        return math.copysign(1e-3 * (over / (BODY.C2 * 1e-3)) ** (1.0 / self.n), f)

    def spring(self, z: float) -> float:
        """Return the force of K1."""
        worn = max(z, self.z_max) / DEPTH
        if math.isfinite(self.length):
            worn = math.expm1(-worn * DEPTH / self.length) / math.expm1(-DEPTH / self.length)
        left = 1.0 - self.damage * worn
        return BODY.K1 * (1.0 + self.beta * z * z) * left * z

    def chain(self, state: np.ndarray, x: float) -> float:
        """Return the force of the chain."""
        return self.K_0 * (x - state[0] - state[1] - state[2])

    def contact(self, t: float, state: np.ndarray) -> float:
        """Return the force on the tool."""
        depth = min(SPEED * t, DEPTH)
        return self.K_m * (depth - state[3])

    def __call__(self, t: float, state: np.ndarray) -> list[float]:
        """Return the rates of z, y, the second unit's stretch, H and dH/dt."""
        z, _, zu, x, v = state
        f = self.chain(state, x)
        return [
            (f - self.spring(z)) / BODY.C1,
            self.flow(f),
            (f - self.K_2 * zu) / self.C_3,
            v,
            (self.contact(t, state) - f - self.K_p * x) / self.M,
        ]


def radau(network: Network, start: float, stop: float, state: np.ndarray) -> Any:
    """Return scipy's solution from one corner of the motion to the next."""
    return solve_ivp(
        network, (start, stop), state, method='Radau', rtol=1e-6, atol=1e-10, dense_output=True
    )


@pytest.mark.parametrize(
    ('damage', 'length'), [(0.0, math.inf), (0.3, math.inf), (0.3, 0.4 * DEPTH)]
)
def test_a_nonlinear_network_with_a_swinging_mass_agrees_with_radau(
    damage: float, length: float
) -> None:
    network = Network()
    network.damage, network.length = damage, length
    harm = Undeclared('damage', (damage,))
    if math.isfinite(length):
        harm = Undeclared('early_damage', (damage, length))
    pushed = radau(network, 0.0, PUSHED, np.zeros(5))
    # The stretch is largest soon after the push: the instant is found by scipy's own event.
    first = radau(network, PUSHED, PUSHED + 0.2, pushed.y[:, -1])
    times = np.linspace(PUSHED, PUSHED + 0.2, 20001)
    stretch = first.sol(times)[0]
    top = times[np.argmax(stretch)]
    network.z_max = float(stretch.max())
    held = radau(network, top, PUSHED + HOLD, first.sol(top))

    def force(t: np.ndarray) -> np.ndarray:
        states = np.where(t < PUSHED, pushed.sol(t), np.where(t < top, first.sol(t), held.sol(t)))
        return network.K_m * (np.minimum(SPEED * t, DEPTH) - states[3])

    got = push(
        Undeclared('strain_stiffening', (network.beta,)),
        Undeclared('shear_thinning', (network.n,)),
        Undeclared('yield_force', (network.F_y,)),
        Undeclared('series_spring', (network.K_0,)),
        Undeclared('parallel_spring', (network.K_p,)),
        Undeclared('second_retardation', (network.K_2, network.C_3)),
        Undeclared('machine_compliance', (network.K_m,)),
        Undeclared('inertia', (network.M,)),
        harm,
        step=STEP / 4.0,
    )
    expected = means(got.t, force)
    # The mass swings at 26 Hz: (2 pi 26 STEP / 4)^2 = 3e-4 of the swing in the worst sample.
    np.testing.assert_allclose(got.force, expected, atol=5e-4 * expected.max())
    assert np.sqrt(np.mean((got.force - expected) ** 2)) < 2e-5 * expected.max()


@pytest.mark.parametrize('alpha', [0.3, 0.7, 0.95])
def test_a_springpot_alone_answers_a_ramp_with_a_power_law(alpha: float) -> None:
    rigid = Body(1e9, 0.0, BODY.C2)
    ramp = Motion(np.zeros(1), np.zeros(1), np.array([1e-4]), np.zeros(1))
    grid = np.arange(0.0, 30.0, 2e-3)
    vector = parameter_vector(rigid, [Undeclared('springpot', (alpha,))])
    got = integrate(grid, ramp, vector)
    scale = BODY.C2 * 10.0 ** (alpha - 1.0) * 1e-4 / gamma(3.0 - alpha)
    impulse = scale * grid ** (2.0 - alpha)
    passed = np.concatenate(([0.0], np.cumsum(got.force * np.diff(got.t))))
    later = grid > 0.1
    np.testing.assert_allclose(np.interp(grid[later], got.t, passed), impulse[later], rtol=1e-3)


def test_contact_growth_scales_the_force_with_the_penetration() -> None:
    grown = push(Undeclared('contact_growth', (0.5,)))
    bare = push()
    t = 0.5 * (bare.t[1:] + bare.t[:-1])
    share = np.minimum(SPEED * t, DEPTH) / DEPTH
    later = t > 0.05
    factor = grown.force[later] / bare.force[later]
    np.testing.assert_allclose(factor, share[later] ** 0.5, rtol=1e-4)


def test_adhesion_holds_the_tool_back_down_to_the_pull_off_force() -> None:
    pull_off = 1.5
    slow = motion(release=0.0012)
    grid = np.arange(0.0, PUSHED + HOLD + 6.0, STEP)
    stuck = integrate(grid, slow, parameter_vector(BODY, [Undeclared('adhesion', (pull_off,))]))
    free = integrate(grid, slow, parameter_vector(BODY))
    assert stuck.t_loss > free.t_loss
    assert -pull_off < stuck.force.min() < -0.95 * pull_off


def test_necks_hold_the_tool_back_until_they_are_drawn_out() -> None:
    pull_off, length, speed = 1.5, 4e-4, 0.0012
    necks = Undeclared('necking', (pull_off, length))
    grid = np.arange(0.0, PUSHED + HOLD + 6.0, STEP)
    got = integrate(grid, motion(release=speed), parameter_vector(BODY, [necks]))
    until = got.t_loss
    t = 0.5 * (got.t[1:] + got.t[:-1])
    drawn = (got.force < -0.999 * pull_off) & (t > until)
    assert got.force.min() == pytest.approx(-pull_off)
    assert not got.force[t > t[drawn].max() + STEP].any()
    # Where they are drawn out the surface is as far behind the tool.
    end = int(np.flatnonzero(drawn)[-1]) + 1
    away = got.surface[end] - motion(release=speed).at(got.t[[end]])[0][0]
    assert away == pytest.approx(length, abs=speed * STEP)


def test_threads_hold_the_tool_back_by_how_far_they_are_drawn_out() -> None:
    pull_off, length = 1.5, 4e-4
    threads = Undeclared('stringing', (pull_off, length))
    grid = np.arange(0.0, PUSHED + HOLD + 6.0, STEP)
    slow = motion(release=0.0012)
    got = integrate(grid, slow, parameter_vector(BODY, [threads]))
    tip = np.array([slow.at(np.array([each]))[0][0] for each in got.t.tolist()])
    apart = got.surface - tip
    after = (got.t[1:] > got.t_loss + STEP) & (apart[1:] < 6.0 * length)
    assert np.count_nonzero(after) > 50
    middle = 0.5 * (apart[1:] + apart[:-1])[after]
    assert got.force[after] == pytest.approx(-pull_off * np.exp(-middle / length), rel=1e-3)
    assert got.force.min() == pytest.approx(-pull_off, rel=0.02)


def test_the_blow_of_a_mass_is_its_momentum() -> None:
    mass = 0.4
    with_mass = push(Undeclared('inertia', (mass,)), until=0.1)
    without = push(until=0.1)
    blow = [np.sum(each.force * np.diff(each.t)) for each in (with_mass, without)]
    assert blow[0] - blow[1] == pytest.approx(mass * SPEED, rel=1e-6)


def test_ageing_scales_the_force_as_the_campaign_goes_on() -> None:
    grid = np.arange(0.0, PUSHED, STEP)
    vector = parameter_vector(BODY, [Undeclared('ageing', (0.5,))])
    early = integrate(grid, motion(), vector)
    late = integrate(grid, motion(), vector, campaign_time=7200.0)
    np.testing.assert_allclose(late.force, math.e * early.force, rtol=1e-9)


def test_a_fracture_drops_the_force_by_its_share_at_its_depth() -> None:
    broken, whole = push(Undeclared('fracture', (0.2, 0.003))), push()
    ratio = broken.force[1:] / whole.force[1:]
    before = whole.surface[2:] < 0.003
    np.testing.assert_allclose(ratio[before], 1.0, rtol=1e-12)
    np.testing.assert_allclose(ratio[whole.surface[1:-1] > 0.003 + SPEED * STEP], 0.8)


def test_pore_fluid_relaxes_with_the_root_of_time_and_is_gone_in_the_end() -> None:
    seconds = 2.0
    soft = Body(1e-3, 1e-3, 1e-3)
    jump = Motion(np.array([0.0, 1e-3]), np.array([0.0, 1e-3]), np.array([1.0, 0.0]), np.zeros(2))
    fluid = Undeclared('poroelasticity', (1000.0, seconds))
    got = integrate(np.arange(0.0, 8.0, 1e-3), jump, parameter_vector(soft, [fluid]))
    t = 0.5 * (got.t[1:] + got.t[:-1]) - 0.5e-3
    early = (t > 0.05) & (t < 0.3)
    slope = np.polyfit(np.log(t[early]), np.log(1.0 - got.force[early] / 0.9872), 1)[0]
    assert slope == pytest.approx(0.5, abs=0.05)
    assert got.force[-1] < 0.03


def test_backlash_keeps_the_tip_where_it_is_until_the_gap_is_passed() -> None:
    gap = 1e-4
    moved = motion().with_backlash(gap)
    t = np.linspace(0.0, PUSHED + HOLD + 0.1, 5000)
    depth, late = motion().at(t)[0], moved.at(t)[0]
    down = t <= PUSHED + HOLD
    np.testing.assert_allclose(late[down], depth[down])
    np.testing.assert_allclose(late[~down], np.minimum(DEPTH, depth[~down] + gap), atol=1e-9)


CLEAR = {
    'yield_force': (0.5,),
    'series_spring': (2e4,),
    'parallel_spring': (200.0,),
    'second_retardation': (8e3, 900.0),
    'springpot': (0.7,),
    'strain_stiffening': (2e4,),
    'shear_thinning': (0.7,),
    'contact_growth': (0.3,),
    'damage': (0.3,),
    'ageing': (2.0,),
    'adhesion': (0.5,),
    'necking': (0.5, 3e-4),
    'stringing': (0.5, 3e-4),
    'lasting_damage': (0.3,),
    'early_damage': (0.3, 1e-3),
    'early_lasting_damage': (0.3, 1e-3),
    'inertia': (0.5,),
    'machine_compliance': (2e4,),
    'poroelasticity': (300.0, 3.0),
    'fracture': (0.2, 0.003),
    'thixotropy': (0.3, 0.002, 3.0),
    'support_slip': (1e-4, 5.0, 0.5),
    'unloading_stiffness': (0.3, 3e-4),
    'shoulder_contact': (300.0, 0.003),
    'backlash': (1e-4,),
}
"""All effects that act on the specimen, not on the sensors, and clearly visible."""


@pytest.mark.parametrize('name', CLEAR)
def test_halving_the_step_changes_little(name: str) -> None:
    effect = Undeclared(name, CLEAR[name])
    edges = np.arange(0.0, PUSHED + HOLD + 2.0, 10 * STEP)
    passed = []
    for step in (STEP, STEP / 2.0, STEP / 8.0):
        got = push(effect, until=edges[-1] + 1e-9, step=step)
        impulse = np.concatenate(([0.0], np.cumsum(got.force * np.diff(got.t))))
        passed.append(np.diff(np.interp(edges, got.t, impulse)) / (10 * STEP))
    peak = passed[-1].max()
    errors = [np.sqrt(np.mean((each - passed[-1]) ** 2)) / peak for each in passed[:-1]]
    if name in ('fracture', 'support_slip'):
        # These jump at a step's end: one sample is off by the share of a step in it.
        assert errors[0] < 3e-3
    else:
        # Far below the noise of any load cell.
        assert errors[0] < 5e-5
        assert errors[1] < max(0.7 * errors[0], 1e-6)


def test_no_element_gives_energy_back_that_was_not_put_in() -> None:
    for name, values in CLEAR.items():
        got = push(Undeclared(name, values), until=PUSHED + HOLD + 2.0)
        depth = motion().at(got.t)[0]
        work = np.cumsum(got.force * np.diff(depth))
        assert work.min() > -1e-12, name


def test_effects_must_exist_and_be_complete() -> None:
    with pytest.raises(UsageError, match='no effect'):
        Undeclared('magic', (1.0,))
    with pytest.raises(UsageError, match='2 parameters'):
        Undeclared('second_retardation', (1.0,))
