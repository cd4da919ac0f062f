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


"""The simulated object behaves as the bodies of rheology that it is composed of."""

from collections.abc import Callable
from dataclasses import replace
from math import exp, inf, sin

from hapticvision_ros.sim.objects import DeformableObject, Material
from hypothesis import given, settings
from hypothesis import strategies as st
import pytest

STEP = 2.5e-4
DOUGH = Material(
    elastic_stiffness=2000.0,
    retardation_viscosity=1600.0,
    flow_viscosity=2400.0,
    yield_force=6.0,
)
SPEED, DEPTH = 0.005, 0.010
PUSH_TIME = DEPTH / SPEED


def press(
    material: Material, path: Callable[[float], float], stop: float, step: float = STEP
) -> tuple[list[float], list[float], list[float]]:
    """Return times, forces and displacements under a tool that follows `path`."""
    body = DeformableObject(material, step)
    times, forces, displacements = [], [], []
    for number in range(1, round(stop / step) + 1):
        times.append(number * step)
        forces.append(body.advance(path(number * step)))
        displacements.append(body.displacement)
    return times, forces, displacements


def push_and_hold(t: float) -> float:
    return min(SPEED * t, DEPTH)


def at(times: list[float], values: list[float], t: float) -> float:
    return values[round(t / (times[1] - times[0])) - 1]


def test_push_force_of_the_three_element_model_is_the_closed_form() -> None:
    material = replace(DOUGH, yield_force=0.0)
    k1, c1, c2 = 2000.0, 1600.0, 2400.0
    times, forces, _ = press(material, push_and_hold, PUSH_TIME)
    relaxation_time = (c1 + c2) / k1
    # F = v (eta + k T (1 - exp(-t/T))) under a ramp, from eqs. (1)-(3) of the paper.
    eta, k = c1 * c2 / (c1 + c2), k1 * c2**2 / (c1 + c2) ** 2
    for t in (0.1, 0.5, 1.0, 2.0):
        grown = k * relaxation_time * (1.0 - exp(-t / relaxation_time))
        # First-order method: the error is of the order of step / T = 1.25e-4.
        assert at(times, forces, t) == pytest.approx(SPEED * (eta + grown), rel=3e-4)


def test_hold_force_decays_to_the_yield_force() -> None:
    times, forces, _ = press(DOUGH, push_and_hold, PUSH_TIME + 24.0)
    assert forces[-1] == pytest.approx(6.0, rel=1e-4)
    above = [at(times, forces, PUSH_TIME + t) - 6.0 for t in (0.5, 2.5, 4.5)]
    assert above[1] / above[0] == pytest.approx(exp(-2.0 / DOUGH.relaxation_time), rel=1e-3)
    assert above[2] / above[1] == pytest.approx(exp(-2.0 / DOUGH.relaxation_time), rel=1e-3)


def test_free_recovery_is_the_yield_force_over_k1_with_the_retardation_time() -> None:
    release = PUSH_TIME + 30.0

    def path(t: float) -> float:
        return push_and_hold(t) if t <= release else -0.02

    times, forces, displacements = press(DOUGH, path, release + 10.0)
    first_free = round(release / STEP) + 1
    assert max(forces[first_free:]) == 0.0
    final = displacements[-1]
    recovered = at(times, displacements, release + STEP) - final
    assert recovered == pytest.approx(6.0 / 2000.0, rel=1e-3)
    left = at(times, displacements, release + 0.8) - final
    assert left / recovered == pytest.approx(exp(-0.8 / DOUGH.retardation_time), rel=1e-3)


def test_below_the_yield_force_nothing_is_permanent() -> None:
    depth = 0.5 * DOUGH.yield_force / DOUGH.elastic_stiffness

    def path(t: float) -> float:
        return min(1e-4 * t, depth) if t < 20.0 else -1.0

    _, forces, displacements = press(DOUGH, path, 40.0, step=1e-3)
    assert max(forces) < DOUGH.yield_force
    assert displacements[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_spring_obeys_hooke_and_returns_with_the_tool() -> None:
    def path(t: float) -> float:
        return 0.01 * sin(t)

    times, forces, displacements = press(Material(3628.0), path, 6.0)
    for t, force, displacement in zip(times, forces, displacements, strict=True):
        assert force == pytest.approx(3628.0 * max(path(t), 0.0), abs=1e-9)
        assert displacement == pytest.approx(max(path(t), 0.0), abs=1e-12)


def test_springs_in_series_and_in_parallel_add_up() -> None:
    series = Material(3000.0, series_stiffness=6000.0)
    parallel = Material(3000.0, parallel_stiffness=500.0)
    assert press(series, lambda _: 1e-3, STEP)[1][-1] == pytest.approx(2.0)
    assert press(parallel, lambda _: 1e-3, STEP)[1][-1] == pytest.approx(3.5)


def test_a_series_spring_comes_back_at_once() -> None:
    material = replace(DOUGH, series_stiffness=8000.0)

    def path(t: float) -> float:
        return push_and_hold(t) if t <= 20.0 else -0.02

    times, forces, displacements = press(material, path, 21.0)
    drop = at(times, displacements, 20.0) - at(times, displacements, 20.0 + STEP)
    assert drop == pytest.approx(at(times, forces, 20.0) / 8000.0, rel=2e-3)


def test_a_parallel_spring_pulls_the_object_back_until_the_slider_holds_it() -> None:
    material = replace(DOUGH, parallel_stiffness=2000.0)

    def path(t: float) -> float:
        return push_and_hold(t) if t <= 10.0 else -0.02

    residual = press(material, path, 60.0)[2][-1]
    # The slider holds what pull is left, and without the spring more stays.
    assert 0.0 < 2000.0 * residual <= DOUGH.yield_force
    assert residual < 0.5 * press(DOUGH, path, 60.0)[2][-1]


def test_a_tool_that_comes_back_meets_the_recovered_surface() -> None:
    def path(t: float) -> float:
        if t <= 4.0:
            return push_and_hold(t)
        if t <= 9.0:
            return -0.02
        return 0.001 * (t - 9.0)

    times, forces, displacements = press(DOUGH, path, 20.0)
    surface = at(times, displacements, 9.0)
    first = next(i for i, t in enumerate(times) if t > 9.0 and forces[i] > 0.0)
    # The surface has all but stopped: it moves less than a tool's step until the touch.
    assert path(times[first]) == pytest.approx(surface, rel=2e-3)


def test_halving_the_step_halves_the_error() -> None:
    material = replace(DOUGH, series_stiffness=20000.0, parallel_stiffness=100.0)

    def path(t: float) -> float:
        return min(0.005 * t, 0.008) if t < 4.0 else 0.008 - 0.01 * (t - 4.0)

    results = []
    for step in (4e-3, 2e-3, 1e-3):
        times, forces, displacements = press(material, path, 6.0, step)
        probes = (1.0, 2.0, 3.6)
        results.append(
            [at(times, forces, t) for t in probes]
            + [1e3 * at(times, displacements, t) for t in (5.2, 6.0)]
        )
    for coarse, middle, fine in zip(*results, strict=True):
        # An implicit Euler method is of first order; the next order is under a tenth of it here.
        assert (coarse - middle) / (middle - fine) == pytest.approx(2.0, rel=0.1)


@settings(max_examples=25, deadline=None)
@given(
    stiffness=st.floats(1e2, 1e5),
    retardation=st.floats(0.0, 1e5),
    flow=st.one_of(st.just(inf), st.floats(1e2, 1e6)),
    threshold=st.floats(0.0, 20.0),
    series=st.one_of(st.just(inf), st.floats(1e3, 1e9)),
    parallel=st.floats(0.0, 1e4),
    rate=st.floats(0.2, 20.0),
)
def test_no_object_gives_back_more_than_was_put_in(
    stiffness: float,
    retardation: float,
    flow: float,
    threshold: float,
    series: float,
    parallel: float,
    rate: float,
) -> None:
    material = Material(stiffness, retardation, flow, threshold, series, parallel)
    body = DeformableObject(material, 1e-3)
    work = 0.0
    for number in range(1, 1500):
        t = 1e-3 * number
        before = body.displacement
        force = body.advance(0.004 * sin(rate * t) + 0.003 * sin(2.7 * rate * t))
        assert force >= 0.0
        # The force at the end of a step is that of the whole step in an implicit Euler method.
        work += force * (body.displacement - before)
        chain = force - parallel * body.displacement
        stored = 0.5 * (
            stiffness * body.retarded_displacement**2
            + chain**2 / series
            + parallel * body.displacement**2
        )
        assert stored <= work + 1e-9


@pytest.mark.parametrize(
    'values',
    [
        {'elastic_stiffness': 0.0},
        {'elastic_stiffness': inf},
        {'elastic_stiffness': 1.0, 'retardation_viscosity': -1.0},
        {'elastic_stiffness': 1.0, 'flow_viscosity': 0.0},
        {'elastic_stiffness': 1.0, 'yield_force': -1.0},
        {'elastic_stiffness': 1.0, 'series_stiffness': 0.0},
        {'elastic_stiffness': 1.0, 'parallel_stiffness': inf},
    ],
)
def test_an_impossible_material_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match='must be'):
        Material(**values)
