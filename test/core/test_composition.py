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

"""What a model is: names, bounds, the vector of the fit."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hapticvision_ros.core import composition
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import EVERY_LAW
from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.models.chain import Chain, Response
from hapticvision_ros.core.models.three_element import respond, ThreeElement
from hapticvision_ros.core.models.turns import Turns
from hapticvision_ros.core.records import FloatArray
import numpy as np
import pytest


def test_the_order_of_the_effects_is_that_of_the_registry() -> None:
    model = Model(('friction', 'yield_force'))
    assert model.effects == ('yield_force', 'friction')
    assert model == Model(('yield_force', 'friction'))
    assert model.name == 'three-element+yield_force+friction'
    assert model.names == ('K1', 'C1', 'C2', 'F_y', 'F_c')
    assert model.units == ('N/m', 'N.s/m', 'N.s/m', 'N', 'N')
    assert Model.parse(model.name) == model
    assert Model.parse('three-element') == Model()


def test_two_parameters_of_one_symbol_are_told_apart() -> None:
    model = Model(('ageing', 'force_drift'))
    assert model.names[3:] == ('ageing.rate', 'force_drift.rate')


@pytest.mark.parametrize(
    ('name', 'message'),
    [
        ('three-element+gravity', 'there is no effect'),
        ('two-element', 'there is no model'),
        ('three-element+damage+damage', 'named twice'),
        ('three-element+springpot+yield_force', 'choose one'),
        ('three-element+shear_thinning+springpot', 'choose one'),
    ],
)
def test_what_is_no_model_is_said_in_one_sentence(name: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        Model.parse(name)


def test_theta_holds_the_logarithm_of_what_has_a_scale() -> None:
    model = Model(('series_spring', 'yield_force'))
    values = np.array([5000.0, 84000.0, 107000.0, 3.0, np.inf])
    theta = model.theta(values)
    assert theta[:3] == pytest.approx(np.log(values[:3]))
    assert theta[3] == 3.0
    assert model.values(theta) == pytest.approx(values)
    assert not model.log[3]
    assert model.log[4]


def test_the_first_guess_is_within_the_bounds(scale: Scale) -> None:
    for effects in ((), ('springpot', 'inertia'), ('second_retardation', 'force_lag')):
        model = Model(effects)
        lower, upper = model.bounds
        guess = model.first_guess(scale)
        assert np.all((lower <= guess) & (guess <= upper))
        assert lower.shape == guess.shape == (len(model.names),)


def test_the_base_model_is_the_exact_three_element_model(driven: Callable, scale: Scale) -> None:
    trial = driven(2e-3)
    prediction = Model().predict(trial, Model().first_guess(scale), directions=False)
    exact = respond(
        ThreeElement(scale.K1, scale.C1, scale.C2),
        trial.t[:-1] + 1e-3,
        np.array([0.0, 1.003, 9.0, 20.0, 30.0]),
        1e-3 * np.array([0.0, 0.0, 10.0, 10.0, 10.0]),
    )
    held = (trial.t[:-1] > 1.01) & (trial.t[1:] < 20.0)
    error = np.abs(prediction.force - exact.force)[held]
    # The mid-point rule at 2 ms, against a relaxation time of 38 s.
    assert error.max() < 1e-7 * exact.force.max()


def test_no_derivatives_are_made_where_none_are_asked_for(driven: Callable, scale: Scale) -> None:
    model = Model(('force_lag', 'clock_offset', 'yield_force'))
    theta = model.first_guess(scale)
    bare = model.predict(driven(), theta, directions=False)
    full = model.predict(driven(), theta)
    assert bare.d_force.shape[0] == bare.d_height.shape[0] == 0
    assert full.d_force.shape == (7, full.force.size)
    assert full.d_height.shape == (7, full.height.size)
    assert np.array_equal(bare.force, full.force)
    assert np.array_equal(bare.height, full.height)


@pytest.mark.parametrize('directions', [False, True])
@pytest.mark.parametrize('name', [effect.name for effect in EVERY_LAW if effect.observe])
def test_a_response_that_is_not_finite_warns_of_nothing(
    name: str, directions: bool, driven: Callable, scale: Scale, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A search turns back from there."""

    def breaks(t: FloatArray, displacement: FloatArray, chain: Chain, ways: Any) -> Response:
        rows = 0 if ways is None else ways.slots.shape[0]
        force = np.where(t[1:] > 2.0, np.inf, 0.0)
        sunk = np.where(t > 2.0, -np.inf, 0.0)
        return Response(force, sunk, np.tile(force, (rows, 1)), np.tile(sunk, (rows, 1)))

    model = Model((name,))
    monkeypatch.setattr(composition, 'respond', breaks)
    for sign in (1.0, -1.0):
        values = model.values(model.first_guess(scale))
        values[3:] *= np.where(model.log[3:], 1.0, sign)
        told = model.predict(driven(), model.theta(values), directions=directions)
        assert not np.isfinite(told.force).all() or not np.isfinite(told.height).all()


def test_heights_before_and_after_the_trial_are_held(driven: Callable, scale: Scale) -> None:
    trial = driven()
    object.__setattr__(trial, 'height_t', np.array([-5.0, 10.0, 49.0, 80.0]))
    height = Model().predict(trial, Model().first_guess(scale)).height
    assert height[0] == 0.0
    assert height[3] == pytest.approx(height[2], rel=0.05)


@pytest.mark.parametrize(
    ('effect', 'value', 'share'),
    [
        ('series_spring', 4e7, 0.02),
        ('machine_compliance', 4e7, 0.02),
        # Means tell it when the force jumps.
        ('force_lag', 2e-3, 0.3),
        ('second_retardation', None, 1.0),
    ],
)
def test_a_turn_of_the_tool_within_a_step_is_answered_when_it_comes(
    driven: Callable, scale: Scale, effect: str, value: float | None, share: float
) -> None:
    """Steps of 4 ms in which the tool starts and stops, beside a hundred times finer ones."""
    knots = np.array([0.0, 0.4501, 1.4511, 2.2503])
    depth = np.array([0.0, 0.0, 0.01, 0.01])
    coarse, fine = np.linspace(0.0, 2.2, 551), np.linspace(0.0, 2.2, 55001)
    heights = np.array([0.5, 1.449, 1.46])
    # What the touch within a step makes is told without a turn, as far as it is.
    late = coarse[1:] > 0.7
    trial, resolved = (
        replace(driven(), t=t, displacement=np.interp(t, knots, depth) - 1e-4, height_t=heights)
        for t in (coarse, fine)
    )
    at, there = knots[1:3], depth[1:3] - 1e-4
    turns = Turns.of(coarse, trial.displacement, at, there)
    model = Model((effect,))
    values = model.values(model.first_guess(scale))
    if value is not None:
        values[3] = value
    theta = model.theta(values)
    seen = model.predict(trial, theta, turns=turns)
    blind = model.predict(trial, theta, directions=False)
    exact = model.predict(resolved, theta)
    force = exact.force.reshape(-1, 100).mean(axis=1)
    off = np.abs(seen.force - force)[late].max()
    assert off < 2e-4 * force.max()
    assert off <= share * np.abs(blind.force - force)[late].max() + 1e-9
    slopes = exact.d_force.reshape(len(model.names) + 1, -1, 100).mean(axis=2)
    largest = np.abs(slopes).max(axis=1, keepdims=True) + 1e-300
    assert np.abs((seen.d_force - slopes) / largest).max() < 5e-3
    np.testing.assert_allclose(seen.height, exact.height, atol=1e-7)
    np.testing.assert_allclose(seen.surface, exact.surface[::100], atol=1e-7)


def test_several_turns_in_one_step_are_parts_of_it() -> None:
    turns = Turns.of(np.arange(4.0), np.zeros(4), np.array([1.25, 1.5, 2.5]), np.ones(3))
    assert turns.t.tolist() == [0.0, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0]
    assert turns.displacement.tolist() == [0.0, 0.0, 1.0, 1.0, 0.0, 1.0, 0.0]
    assert turns.ends.tolist() == [0, 1, 4, 6]
    parts = np.array([[7.0, 4.0, 8.0, 10.0, 1.0, 3.0]])
    times = turns.t[np.newaxis]
    mean, d_mean, end, d_end = turns.joined((parts[0], -parts), (turns.t, -times))
    assert mean.tolist() == [7.0, 8.0, 2.0]
    assert d_mean.tolist() == [[-7.0, -8.0, -2.0]]
    assert end.tolist() == [0.0, 1.0, 2.0, 3.0]
    assert d_end.tolist() == [[-0.0, -1.0, -2.0, -3.0]]


def test_damage_before_a_trial_is_that_of_the_deepest_push_at_most(driven: Callable) -> None:
    """A push that is predicted may come after one that is deeper than all that were fitted."""
    model = Model(('damage:lasting',))
    theta = model.theta([3000.0, 2000.0, 6000.0, 0.9, 1.0])
    fresh, same, deeper = (
        model.predict(replace(driven(2e-3), depth_before=depth), theta, directions=False).force
        for depth in (0.0, 0.010, 0.030)
    )
    assert np.array_equal(deeper, same)
    assert not np.array_equal(same, fresh)
    assert same.max() == pytest.approx(fresh.max(), rel=0.1)


@pytest.mark.parametrize('name', ['', *(effect.name for effect in EVERY_LAW)])
def test_a_trial_is_predicted_alike_whatever_was_predicted_before(
    driven: Callable, scale: Scale, name: str
) -> None:
    """A model keeps the chain that trials share, which trials of some effects do not."""
    effects = (name,) if name else ()
    kept = Model(effects)
    first = driven(0.02)
    other = replace(
        first,
        displacement=0.8 * first.displacement,
        campaign_time=first.campaign_time + 7200.0,
        depth_before=0.5 * first.reference_depth,
    )
    deeper = replace(first, reference_depth=2.0 * first.reference_depth)
    theta = kept.first_guess(scale)
    # Each parameter by itself, then all as they were.
    for parameters in (*(theta + 0.01 * np.eye(theta.size)), theta):
        for trial in (first, other, deeper, first):
            for onset, directions in ((0.0, False), (1e-5, True), (2e-5, True), (1e-5, False)):
                own = np.zeros(len(kept.trial_names))
                own[0] = onset
                asked = trial, parameters, own
                known = kept.predict(*asked, directions=directions)
                anew = Model(effects).predict(*asked, directions=directions)
                for part in ('force', 'height', 'surface', 'd_force', 'd_height'):
                    assert np.array_equal(
                        getattr(known, part), getattr(anew, part), equal_nan=True
                    )
