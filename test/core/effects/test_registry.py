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

"""Every effect of the registry: as the contract says, absent at zero strength, differentiable."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
import math
from pathlib import Path
import re
from types import ModuleType

from hapticvision_ros.core import effects
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.selection import candidates_for
from hapticvision_ros.core.effects import BY_NAME, EFFECTS, EVERY_LAW
from hapticvision_ros.core.effects.declaration import Effect, Scale
from hapticvision_ros.core.errors import UsageError
import numpy as np
import pytest

CONTRACT = {
    'yield_force': (('F_y', 'N'),),
    'series_spring': (('K_0', 'N/m'),),
    'parallel_spring': (('K_p', 'N/m'),),
    'second_retardation': (('K_2', 'N/m'), ('C_3', 'N.s/m')),
    'springpot': (('alpha', '-'),),
    'strain_stiffening': (('beta', '1/m^2'),),
    'shear_thinning': (('n', '-'),),
    'contact_growth': (('m', '-'),),
    'damage': (('D', '-'),),
    'ageing': (('rate', '1/h'),),
    'adhesion': (('F_ad', 'N'),),
    'inertia': (('M', 'kg'),),
    'machine_compliance': (('K_m', 'N/m'),),
    'contact_offset': (('delta_0', 'm'),),
    'friction': (('F_c', 'N'),),
    'force_drift': (('rate', 'N/s'),),
    'force_lag': (('T_f', 's'),),
    'clock_offset': (('dt', 's'),),
    'height_bias': (('b', 'm'),),
    'periodic_disturbance': (('amplitude', 'N'), ('frequency', 'Hz')),
}
"""The table of the contract."""

BEYOND = {
    'exponential_stiffening': (('a', '1/m'),),
    'arm_clock_offset': (('dt', 's'),),
}
"""What measured data ask for beside it (doc/real_data.md), and what is a nuisance of cells."""

STRONG = {
    'rate': 0.3,
    'ageing.rate': 0.3,
    'force_drift.rate': 0.02,
    'delta_0': 1.3e-4,
    'dt': 0.041,
    'clock_offset.dt': 0.041,
    'arm_clock_offset.dt': 0.013,
    'b': 4e-4,
    'F_ad': 0.5,
    'delta_c': 2e-4,
    'delta_e': 2e-4,
    'T_f': 0.05,
    's': 5.0,
    'kappa': 0.2,
}
"""Strengths where the first guess is the absence, or leaves little to be seen."""

every = pytest.mark.parametrize('effect', EVERY_LAW, ids=lambda effect: effect.name)


def _strong(model: Model, scale: Scale, factor: float = 1.0) -> np.ndarray:
    """Return a theta at which every effect of the model is clearly there."""
    values = model.values(model.first_guess(scale))
    for i, name in enumerate(model.names):
        values[i] = STRONG.get(name, values[i])
        if i > 2:
            values[i] *= factor
    return np.clip(model.theta(values), *model.bounds)


def test_the_registry_is_the_table_of_the_contract_and_what_measured_data_ask_for() -> None:
    declared = {e.name: tuple((p.symbol, p.unit) for p in e.parameters) for e in EFFECTS}
    assert declared == CONTRACT | BEYOND
    assert tuple(name for name in declared if name not in BEYOND) == tuple(CONTRACT)


@every
def test_an_effect_is_one_file_and_says_all_about_itself(effect: Effect) -> None:
    module = getattr(effects, effect.named)
    assert isinstance(module, ModuleType)
    assert module.__file__ is not None
    assert Path(module.__file__).stem == effect.named
    assert effect in (module.EFFECT, *module.EFFECT.laws)
    assert effect.shape is not None or effect.observe is not None
    for text in (effect.title, effect.sketch, effect.validity, effect.signature, effect.source):
        assert text.strip()
    assert re.search(r'[12]\d{3}|paper', effect.source), 'the source has a year'
    for other in effect.excludes:
        assert effect.name in BY_NAME[other].excludes or BY_NAME[other].shape is not None


def test_an_effect_follows_one_law() -> None:
    with pytest.raises(UsageError, match="'friction' is named twice"):
        Model(('friction', 'friction:held'))
    assert candidates_for(Model(('friction:held',)), list(BY_NAME)) == [
        name for name in BY_NAME if not name.startswith('friction')
    ]


def test_friction_in_contact_stays_there_beside_the_mass_of_the_tool(
    scale: Scale, driven: Callable
) -> None:
    trial = driven()
    both = Model(('inertia:of_the_tool', 'friction:in_contact'))
    values = both.values(both.first_guess(scale))
    values[3:] = 1e-9, 0.3
    force = both.predict(trial, both.theta(values), directions=False).force
    air = trial.t[1:] < 1.0
    assert np.abs(force[air]).max() < 1e-6


@every
def test_a_first_guess_is_within_its_bounds(effect: Effect, scale: Scale) -> None:
    for parameter in effect.parameters:
        assert parameter.lower <= parameter.guess(scale) <= parameter.upper
        assert not parameter.log or parameter.lower > 0.0


@pytest.mark.parametrize(
    ('law', 'symbol'), [('adhesion:cohesive_zone', 'delta_c'), ('adhesion:fading_zone', 'delta_e')]
)
def test_a_pull_that_does_not_fade_does_not_lead_a_search_astray(law: str, symbol: str) -> None:
    """Beside friction a search has gone to an opening of 1e158 m, whose squares overflow."""
    (opening,) = (each for each in BY_NAME[law].parameters if each.symbol == symbol)
    assert opening.upper == 1.0


@every
def test_at_zero_strength_the_model_is_the_base_model(
    effect: Effect, scale: Scale, driven: Callable
) -> None:
    trial = driven()
    base = Model().predict(trial, Model().first_guess(scale))
    model = Model((effect.name,))
    values = model.values(model.first_guess(scale))
    for i, parameter in enumerate(effect.parameters):
        if not math.isnan(parameter.neutral):
            values[3 + i] = parameter.neutral
    absent = model.predict(trial, model.theta(values))
    # The springpot is a sum of exponentials, which at alpha = 1 are 1e-12 of a dashpot. Steps
    # whose lengths differ by less than 1e-9 share weights, not the same ones in all branches.
    bound = 1e-8 if effect.name == 'springpot' else 1e-9
    top, deep = base.force.max(), base.height.max()
    assert np.abs(absent.force - base.force).max() <= bound * top
    assert np.abs(absent.height - base.height).max() <= bound * deep
    assert np.isfinite(absent.d_force).all()
    assert np.isfinite(absent.d_height).all()


@every
def test_a_strong_effect_is_seen(effect: Effect, scale: Scale, driven: Callable) -> None:
    trial = driven()
    base = Model().predict(trial, Model().first_guess(scale), directions=False)
    model = Model((effect.name,))
    there = model.predict(trial, _strong(model, scale), directions=False)
    seen = np.abs(there.force - base.force).max() / base.force.max()
    seen += np.abs(there.height - base.height).max() / base.height.max()
    assert seen > 1e-4


@every
def test_the_response_without_derivatives_is_that_with_them(
    effect: Effect, scale: Scale, driven: Callable
) -> None:
    # Without derivatives the steps take another way through the chain, also a mass that swings.
    trial = driven()
    model = Model((effect.name,))
    for factor in (1.0, 0.1):
        theta = _strong(model, scale, factor)
        whole, quick = (model.predict(trial, theta, directions=each) for each in (True, False))
        assert np.abs(quick.force - whole.force).max() <= 1e-9 * whole.force.max()
        assert np.abs(quick.height - whole.height).max() <= 1e-9 * whole.height.max()


def _check_derivatives(
    model: Model, trial: object, theta: np.ndarray, own: np.ndarray, tolerance: float
) -> None:
    p = theta.size
    exact = model.predict(trial, theta, own)
    point = np.concatenate([theta, own])
    sizes = [1.0 if log else max(abs(v), 1e-3) for v, log in zip(theta, model.log, strict=True)]
    sizes += [1e-4, *(1.0 for _ in own[1:])]
    for j, size in enumerate(sizes):
        step = 3e-6 * size
        sides = []
        for sign in (1.0, -1.0):
            moved = point.copy()
            moved[j] += sign * step
            sides.append(model.predict(trial, moved[:p], moved[p:], directions=False))
        for name, found in (('force', exact.d_force[j]), ('height', exact.d_height[j])):
            plus, minus = getattr(sides[0], name), getattr(sides[1], name)
            slope = (plus - minus) / (2.0 * step)
            # Rounding leaves 1e-13 of the signal in the difference, iterations some more.
            noise = 1e-12 * np.abs(plus).max() / step
            error = np.abs(slope - found).max()
            assert error <= tolerance * np.abs(slope).max() + noise, (model.names, j, name)


@every
def test_the_derivatives_are_those_of_the_prediction(
    effect: Effect, scale: Scale, driven: Callable
) -> None:
    model = Model((effect.name,))
    own = np.array([2.3e-5, *(0.4 for _ in model.trial_names[1:])])
    # A central difference is good to the square of its step, times a third derivative.
    _check_derivatives(model, driven(jitter=0.2), _strong(model, scale), own, 2e-5)


@pytest.mark.parametrize('seed', range(12))
def test_the_derivatives_of_pairs_are_those_of_the_prediction(
    seed: int, scale: Scale, driven: Callable
) -> None:
    random = np.random.default_rng(seed)
    names = [effect.name for effect in EFFECTS]
    while True:
        first, second = random.choice(names, 2, replace=False)
        if second not in BY_NAME[first].excludes and first not in BY_NAME[second].excludes:
            break
    model = Model((first, second))
    theta = _strong(model, scale, factor=random.uniform(0.7, 1.0))
    theta[:3] += random.uniform(-0.3, 0.3, 3)
    own = np.array([random.normal(0.0, 5e-5), *(0.4 for _ in model.trial_names[1:])])
    _check_derivatives(model, driven(), theta, own, 2e-5)


@every
@pytest.mark.parametrize('heights', [0, 1])
def test_a_trial_may_have_no_height_or_a_single_one(
    effect: Effect, heights: int, scale: Scale, driven: Callable
) -> None:
    trial = driven()
    few = replace(trial, height_t=trial.height_t[:heights])
    model = Model((effect.name,))
    found = model.predict(few, _strong(model, scale))
    assert found.height.shape == (heights,)
    assert found.d_height.shape[1] == heights
    assert np.isfinite(found.d_force).all()


@every
def test_a_trial_may_start_at_any_time(effect: Effect, scale: Scale, driven: Callable) -> None:
    model = Model((effect.name,))
    theta = _strong(model, scale)
    now, later = driven(), driven(shift=64.0)
    object.__setattr__(later, 'zero_time', later.zero_time + 64.0)
    first = model.predict(now, theta, directions=False)
    second = model.predict(later, theta, directions=False)
    # Stamps of 64 s and more have 1e-14 s of rounding, which the steps' lengths inherit.
    assert np.allclose(first.force, second.force, rtol=0.0, atol=1e-8 * first.force.max())
    assert np.allclose(first.height, second.height, rtol=0.0, atol=1e-8 * first.height.max())


@every
def test_what_comes_later_changes_nothing_before(
    effect: Effect, scale: Scale, driven: Callable
) -> None:
    # The fit looks for the touch with the first steps of a trial alone.
    model = Model((effect.name,))
    theta, trial = _strong(model, scale), driven()
    whole = model.predict(trial, theta, directions=False).force
    for steps in (120, 905, 2200):
        ends = np.append(np.arange(steps + 1), trial.t.size - 1)
        head = replace(
            trial,
            t=trial.t[ends],
            displacement=trial.displacement[ends],
            height_t=np.empty(0),
        )
        force = model.predict(head, theta, directions=False).force
        # Where the force is at the end of a step, a lag asks the next two as well.
        # An arm whose stamps are late has moved already.
        told = slice(0, steps - (6 if effect.misdates else 2))
        assert np.abs(force[told] - whole[told]).max() <= 1e-12 * whole.max()


@every
def test_finer_steps_change_the_prediction_ever_less(
    effect: Effect, scale: Scale, driven: Callable
) -> None:
    model = Model((effect.name,))
    theta = _strong(model, scale)
    if effect.misdates:
        # A jump is known to its step, and is to be moved by whole ones here.
        theta[3] = 0.04
    heights, forces = [], []
    for interval in (0.04, 0.02, 0.01, 0.005):
        # Every corner of the path is an end of a step, the same in all four.
        trial = driven(interval, touch=1.0)
        prediction = model.predict(trial, theta, directions=False)
        heights.append(prediction.height[trial.height_t < 20.0])
        forces.append(prediction.force[: round(20.0 / interval)].reshape(500, -1).mean(axis=1))
    for series in (heights, forces):
        change = [np.sqrt(np.mean((b - a) ** 2)) for a, b in pairwise(series)]
        # First order at the least: twice halved, a quarter of the change.
        assert change[2] <= 0.3 * change[0] + 1e-9 * np.abs(series[-1]).max()
