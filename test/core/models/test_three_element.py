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

"""The three-element model against an integration of its own equations, and its limits."""

from hapticvision_ros.core.models.three_element import recovery, respond, ThreeElement
from hypothesis import given, settings, strategies
import numpy as np
import pytest
from scipy.integrate import solve_ivp

BODY = ThreeElement(K1=5000.0, C1=84000.0, C2=107000.0)


def _integrated(
    body: ThreeElement, t: np.ndarray, knot_t: np.ndarray, knot_h: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return the force at `t` and the last z: ``C1 dz/dt + K1 z = C2 (dH/dt - dz/dt)``."""
    force, z = np.empty_like(t), 0.0
    for start, stop, low, high in zip(
        knot_t[:-1], knot_t[1:], knot_h[:-1], knot_h[1:], strict=True
    ):
        speed = (high - low) / (stop - start)

        def flow(_: float, z: np.ndarray, speed: float = speed) -> np.ndarray:
            return (body.C2 * speed - body.K1 * z) / (body.C1 + body.C2)

        solution = solve_ivp(flow, (start, stop), [z], dense_output=True, rtol=1e-11, atol=1e-15)
        inside = (t > start) & (t <= stop)
        if inside.any():
            states = solution.sol(t[inside])[0]
            force[inside] = body.K1 * states + body.C1 * flow(0.0, states)
        z = float(solution.y[0, -1])
    return force, z


def test_the_force_under_any_path_is_that_of_the_network() -> None:
    knot_t = np.array([0.0, 2.0, 3.0, 10.0, 11.0, 40.0])
    knot_h = np.array([0.0, 0.003, 0.003, 0.010, 0.0105, 0.0105])
    t = np.linspace(0.01, 40.0, 997)
    force, _ = _integrated(BODY, t, knot_t, knot_h)
    # Exact for a piecewise linear path: what is left is the integrator's.
    assert np.allclose(respond(BODY, t, knot_t, knot_h).force, force, rtol=1e-8, atol=1e-9)


def test_the_hold_force_decays_to_nothing_with_the_relaxation_time() -> None:
    # Eq. (8) with eq. (9), no stray factor in the exponent.
    t = np.linspace(8.0, 200.0, 50)
    force = respond(BODY, t, np.array([0.0, 8.0, 200.0]), np.array([0.0, 0.01, 0.01])).force
    held = force[1:] / force[1]
    assert BODY.relaxation_time == pytest.approx((84000.0 + 107000.0) / 5000.0)
    assert np.allclose(held, np.exp(-(t[1:] - t[1]) / BODY.relaxation_time), rtol=1e-9)


def test_a_fast_tool_leaves_at_once_and_H_follows_eq_10() -> None:
    knot_t = np.array([0.0, 8.0, 68.0, 70.0])
    knot_h = np.array([0.0, 0.010, 0.010, -0.010])
    t = np.linspace(68.5, 160.0, 100)
    response = respond(BODY, t, knot_t, knot_h)
    assert response.t_loss == 68.0
    _, z = _integrated(BODY, np.array([68.0]), knot_t[:3], knot_h[:3])
    expected = 0.010 - z + z * np.exp(-(t - 68.0) * BODY.K1 / BODY.C1)
    assert np.allclose(response.height, expected, rtol=1e-8)
    assert not response.force.any()


def test_a_slow_tool_is_left_when_the_body_no_longer_keeps_pace() -> None:
    speed = 5e-5
    knot_t = np.array([0.0, 8.0, 68.0, 468.0])
    knot_h = np.array([0.0, 0.010, 0.010, 0.010 - 400.0 * speed])
    response = respond(BODY, np.array([400.0]), knot_t, knot_h)
    assert response.t_loss is not None and response.t_loss > 69.0
    withdrawn = np.array([*knot_t[:3], response.t_loss])
    heights = np.interp(withdrawn, knot_t, knot_h)
    _, z = _integrated(BODY, np.array([response.t_loss]), withdrawn, heights)
    # At the loss the free recovery goes exactly as fast as the tool.
    assert z / BODY.retardation_time == pytest.approx(speed, rel=1e-8)


def test_an_unloaded_body_without_C1_springs_back_at_once() -> None:
    assert np.array_equal(
        recovery(ThreeElement(1.0, 0.0, 1.0), 0.5, np.array([0.0, 1.0])), [0.5, 0.0]
    )


def test_a_stiff_dashpot_leaves_a_kelvin_voigt_body() -> None:
    body = ThreeElement(K1=3000.0, C1=500.0, C2=1e12)
    t = np.array([1.0, 2.0, 5.0])
    force = respond(body, t, np.array([0.0, 2.0, 5.0]), np.array([0.0, 0.004, 0.004])).force
    # K1 H + C1 dH/dt, up to 1 / C2.
    assert np.allclose(force, [3000.0 * 0.002 + 1.0, 3000.0 * 0.004 + 1.0, 12.0], rtol=1e-6)


@settings(max_examples=60, deadline=None)
@given(
    K1=strategies.floats(1.0, 1e6),
    C1=strategies.floats(0.0, 1e6),
    C2=strategies.floats(1.0, 1e6),
)
def test_dashpot_and_maxwell_branch_map_back_to_the_same_body(
    K1: float, C1: float, C2: float
) -> None:
    body = ThreeElement(K1, C1, C2)
    again = ThreeElement.from_maxwell(body.eta, body.k, body.relaxation_time)
    found = (again.K1, again.C1, again.C2)
    # C1 = eta (1 + eta / (k T)) loses digits where C1 / C2 is large.
    assert found == pytest.approx((K1, C1, C2), rel=1e-9 * (1.0 + C1 / C2), abs=1e-12)


@settings(max_examples=40, deadline=None)
@given(strategies.lists(strategies.floats(-0.002, 0.002), min_size=2, max_size=8))
def test_a_cycle_never_gives_energy_back(steps: list[float]) -> None:
    path = np.concatenate(([0.0], np.cumsum(np.abs(steps))))
    knot_t = np.arange(path.size, dtype=np.float64)
    t = np.linspace(0.0, knot_t[-1], 2001)
    force = respond(BODY, t, knot_t, path).force
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(np.interp(t, knot_t, path)))
    assert work >= -1e-12


@pytest.mark.parametrize('wrong', [(0.0, 1.0, 1.0), (1.0, -1.0, 1.0), (1.0, 1.0, 0.0)])
def test_a_body_that_cannot_be_is_refused(wrong: tuple[float, float, float]) -> None:
    with pytest.raises(ValueError, match='no such body'):
        ThreeElement(*wrong)
