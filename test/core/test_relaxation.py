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

"""The relaxation function: held against the forward model, closed forms and its own transform."""

from collections.abc import Mapping

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.models.three_element import ThreeElement
from hapticvision_ros.core.relaxation import (
    LINEAR,
    NONLINEAR,
    prony_series,
    relaxation_function,
    RelaxationFunction,
)
from hypothesis import given, settings, strategies
import numpy as np
import pytest

BASE = {'K1': 2000.0, 'C1': 1600.0, 'C2': 2400.0}
ADDED = {
    'series_spring': {'K_0': 8000.0},
    'parallel_spring': {'K_p': 50.0},
    'second_retardation': {'K_2': 5000.0, 'C_3': 300.0},
    'springpot': {'alpha': 0.5},
}
SPEED, RAMP = 0.005, 2.0


def _impedance(model: Model, values: Mapping[str, float], s: complex) -> complex:
    """Return Q(s) = K_p + 1 / D(s), from the elements as a textbook adds them up."""
    compliance = 1.0 / (values['K1'] + values['C1'] * s) + 1.0 / (values['C2'] * s)
    if 'K_0' in values:
        compliance += 1.0 / values['K_0']
    if 'K_2' in values:
        compliance += 1.0 / (values['K_2'] + values['C_3'] * s)
    return values.get('K_p', 0.0) + 1.0 / compliance


def _transform(relaxation: RelaxationFunction, s: complex) -> complex:
    """Return s times the Laplace transform of K(t)."""
    branches = relaxation.stiffness * s / (s + 1.0 / relaxation.relaxation_time)
    return complex(relaxation.long_term + relaxation.impulse * s + branches.sum())


def _ramp_force(relaxation: RelaxationFunction, t: np.ndarray) -> np.ndarray:
    """Return the force of a ramp that stops, from the function alone."""
    moving = np.minimum(t, RAMP)
    rest = t - moving
    T = relaxation.relaxation_time[:, np.newaxis]
    stretch = -T * np.expm1(-moving / T) * np.exp(-rest / T)
    force = relaxation.long_term * moving + relaxation.stiffness @ stretch
    return SPEED * (force + relaxation.impulse * (t < RAMP))


def test_the_base_model_is_a_dashpot_beside_one_maxwell_branch() -> None:
    relaxation = relaxation_function(Model(), BASE)
    body = ThreeElement(**BASE)
    assert relaxation.long_term == 0.0
    assert relaxation.impulse == pytest.approx(body.eta, rel=1e-14)
    assert relaxation.stiffness == pytest.approx([body.k], rel=1e-14)
    assert relaxation.relaxation_time == pytest.approx([body.relaxation_time], rel=1e-14)


positive = strategies.floats(-3.0, 6.0).map(lambda x: 10.0**x)


@settings(max_examples=200, deadline=None)
@given(values=strategies.tuples(*[positive] * 7), s=strategies.floats(-6.0, 6.0))
def test_poles_and_residues_add_up_to_the_network(values: tuple[float, ...], s: float) -> None:
    # Retardation times up to nine powers of ten apart, looked at from slow to fast.
    model = Model(('series_spring', 'parallel_spring', 'second_retardation'))
    numbers = dict(zip(model.names, values, strict=True))
    relaxation = relaxation_function(model, numbers)
    assert np.all(relaxation.stiffness > 0.0)
    assert np.all(np.diff(relaxation.relaxation_time) < 0.0)
    for point in (10.0**s, 1j * 10.0**s):
        # Rounding of sums of a few terms of one sign.
        expected = _impedance(model, numbers, point)
        assert _transform(relaxation, point) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize(
    'effects',
    [(), *((name,) for name in ADDED), ('series_spring', 'parallel_spring', 'second_retardation')],
    ids='+'.join,
)
def test_the_force_of_a_push_is_that_of_the_forward_model(effects, driven) -> None:
    model = Model(effects)
    values = BASE | {k: v for name in effects for k, v in ADDED[name].items()}
    trial = driven(1e-3)
    touch = 1.0
    t = trial.t
    displacement = SPEED * np.clip(t - touch, -1.0, RAMP)
    trial = type(trial)(t, displacement, trial.height_t)
    theta = model.theta([values[name] for name in model.names])
    force = model.predict(trial, theta, directions=False).force
    middle = 0.5 * (t[1:] + t[:-1]) - touch
    pushed = middle > 0.0
    expected = _ramp_force(relaxation_function(model, values), middle[pushed])
    # Means over a step of 1 ms against values in its middle; second order in step over time, which
    # the fastest branches of the springpot are not long against. The corner is a step of its own.
    away = (np.abs(middle[pushed] - RAMP) > 0.02) & (middle[pushed] > 0.02)
    scale = expected.max()
    assert force[pushed][away] == pytest.approx(expected[away], abs=2e-4 * scale)


def test_equal_retardation_times_are_one_unit() -> None:
    model = Model(('second_retardation',))
    both = relaxation_function(model, BASE | {'K_2': 1000.0, 'C_3': 800.0})
    one = relaxation_function(
        Model(),
        {'K1': 1.0 / (1 / 2000 + 1 / 1000), 'C1': 1.0 / (1 / 1600 + 1 / 800), 'C2': 2400.0},
    )
    assert both.impulse == pytest.approx(one.impulse, rel=1e-12)
    assert both.stiffness == pytest.approx(one.stiffness, rel=1e-12)
    assert both.relaxation_time == pytest.approx(one.relaxation_time, rel=1e-12)


def test_a_spring_alone_in_the_bouncing_part_is_one_maxwell_branch() -> None:
    relaxation = relaxation_function(Model(), BASE | {'C1': 0.0})
    assert relaxation.impulse == 0.0
    assert relaxation.stiffness == pytest.approx([2000.0], rel=1e-12)
    assert relaxation.relaxation_time == pytest.approx([1.2], rel=1e-12)


def test_a_prony_series_is_the_function_it_was_made_of() -> None:
    model = Model(('series_spring', 'parallel_spring'))
    relaxation = relaxation_function(model, BASE | {'K_0': 8000.0, 'K_p': 50.0})
    series = prony_series(relaxation, scale=20.0)
    t = np.geomspace(1e-4, 1e2, 50)
    assert series(t) == pytest.approx(20.0 * relaxation(t), rel=1e-12)
    # At once only K_0 and K_p resist, in the end K_p.
    assert series.instantaneous == pytest.approx(20.0 * 8050.0, rel=1e-12)
    assert series.long_term_ratio == pytest.approx(50.0 / 8050.0, rel=1e-9)


def test_an_impulse_needs_a_shortest_time_and_is_right_beyond_it() -> None:
    relaxation = relaxation_function(Model(), BASE)
    with pytest.raises(UsageError, match='no Prony series holds'):
        prony_series(relaxation)
    for wrong in (0.0, -1.0, 5.0, np.nan):
        with pytest.raises(UsageError, match='must be above zero and below'):
            prony_series(relaxation, wrong)
    t = np.linspace(0.1, 10.0, 300)
    steady = t[(t < RAMP) | (t > RAMP + 0.1)]
    exact = _ramp_force(relaxation, steady)
    replaced = _ramp_force(relaxation.without_impulse(0.01), steady)
    # exp(-10), ten shortest times after each change of the speed.
    assert replaced == pytest.approx(exact, abs=5e-5 * exact.max())


def test_a_nonlinear_body_is_refused_unless_the_point_is_named() -> None:
    values = {'F_y': 3.0, 'n': 0.5, 'beta': 1e3, 'D': 0.3, 's': 4.0, 'm': 0.5, 'a': 90.0}
    values |= {'kappa': 0.7}
    for name in (*NONLINEAR, 'damage:lasting', 'damage:saturating', 'damage:lasting_saturating'):
        model = Model((name,))
        with pytest.raises(UsageError, match='choose the point') as told:
            relaxation_function(model, BASE | values)
        assert name.partition(':')[0] in str(told.value)
        reference = relaxation_function(model, BASE | values, 'reference')
        assert reference.impulse == relaxation_function(Model(), BASE).impulse


def test_at_rest_a_slider_holds() -> None:
    # K1 and C1 side by side are left.
    relaxation = relaxation_function(Model(('yield_force',)), BASE | {'F_y': 3.0}, 'rest')
    assert relaxation.long_term == pytest.approx(2000.0)
    assert relaxation.impulse == pytest.approx(1600.0)
    assert relaxation.stiffness.size == 0
    for name, value in (('contact_growth', {'m': 0.5}), ('shear_thinning', {'n': 0.5})):
        with pytest.raises(UsageError, match='no linear limit at rest'):
            relaxation_function(Model((name,)), BASE | value, 'rest')


def test_each_effect_of_the_object_is_placed() -> None:
    # An effect that is added must be given a place here, or it is refused in one sentence.
    beside = {'ageing', 'adhesion', 'inertia'}
    objects = {effect.name for effect in EFFECTS if effect.kind == 'object'}
    assert LINEAR | NONLINEAR | beside == objects
    values = {'rate': 0.1, 'F_ad': 1.0, 'M': 0.2}
    for name in beside:
        relaxation = relaxation_function(Model((name,)), BASE | values)
        assert relaxation.impulse == relaxation_function(Model(), BASE).impulse
