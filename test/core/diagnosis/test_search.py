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


"""The closed loop on data whose effect nobody has declared."""

from dataclasses import replace
import math
import re
from types import SimpleNamespace
from typing import Any

from hapticvision_ros.core import pipeline
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis import search
from hapticvision_ros.core.diagnosis.records import Diagnosis, NextTrial, Unexplained
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.diagnosis.search import (
    _contenders,
    _parted,
    _widened,
    choose_again,
    diagnose,
)
from hapticvision_ros.core.diagnosis.selection import Round, Trialled
from hapticvision_ros.core.fit import data, way
from hapticvision_ros.core.fit.bend import Servo, told
from hapticvision_ros.core.fit.campaign import fit_prepared
from hapticvision_ros.core.fit.data import arm_of, prepare
from hapticvision_ros.core.fit.held_out import predict_unseen, Trained
from hapticvision_ros.core.pipeline import analyse, analyse_campaign
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    Push,
    random_campaign,
    run,
    Sensors,
)
from hapticvision_ros.sim.specimen import Body, Undeclared
import numpy as np
import pytest

YIELD = Undeclared('yield_force', (0.37,))
STIFFENING = Undeclared('strain_stiffening', (15_000.0,))
LATE = Undeclared('clock_offset', (0.026,))
PORES = Undeclared('poroelasticity', (332.0, 0.79))
ACTING = pytest.mark.parametrize(
    ('effect', 'seed'),
    [(YIELD, 2), (STIFFENING, 3), (LATE, 5)],
    ids=lambda x: getattr(x, 'name', ''),
)
NOISES = 5.0
"""An estimate is off by more standard errors once in a million."""


@ACTING
def test_an_undeclared_effect_is_named(case: Any, effect: Undeclared, seed: int) -> None:
    found = case(effect, seed).found
    assert found.status == 'explained'
    assert found.effects == (effect.name,)
    assert [effect.name in alike for alike in found.sets] == [True]
    assert found.unexplained is None


@ACTING
def test_its_strength_is_found_within_its_error(case: Any, effect: Undeclared, seed: int) -> None:
    found = case(effect, seed).found
    (symbol,) = found.after.model.names[3:]
    estimate = found.after.parameters[symbol]
    assert abs(estimate.value - effect.values[0]) < NOISES * estimate.std
    # Told from none at all, and to better than a tenth.
    assert estimate.std < 0.1 * abs(effect.values[0])


@pytest.mark.parametrize(('effect', 'seed'), [(YIELD, 2), (STIFFENING, 3)], ids=['yield', 'stiff'])
def test_the_effect_had_bent_the_base_parameters(case: Any, effect: Undeclared, seed: int) -> None:
    made = case(effect, seed)
    before, after = made.errors('before').max(), made.errors('after').max()
    assert before > 0.05
    # Their own errors are some tenths of a percent.
    assert after < 0.01


@ACTING
def test_squares_on_an_unseen_trial_fall_to_the_noise(
    case: Any, effect: Undeclared, seed: int
) -> None:
    made = case(effect, seed)
    noise = made.found.after.noise
    squares = []
    for fit in (made.found.before, made.found.after):
        unseen = predict_unseen(Trained.of(fit, made.measured.pairs), made.unseen, noise)
        squares.append(unseen.squares[0])
    (trial,), _ = prepare(made.unseen)
    assert trial is not None
    expected = float(np.count_nonzero(trial.force_count) + trial.height_t.size)
    # Chi squared: its standard deviation, and one in a hundred for the level of the noise.
    deviation = math.sqrt(2.0 * expected) + 0.02 * expected
    assert abs(squares[1] - expected) < 4.0 * deviation
    # Both have the same noise: that of the difference is twice its root, a fifth of it here.
    assert squares[0] - squares[1] > 100.0


@ACTING
def test_what_came_near_is_chosen_from_without_some_trials(
    case: Any, effect: Undeclared, seed: int
) -> None:
    found = case(effect, seed).found
    left_out = {found.before.problem.trials[0].name}
    again = choose_again(found, left_out)
    assert again is not None
    assert again.model.effects == (effect.name,)
    # Nothing else is looked for anew.
    none = choose_again(replace(found, contenders=()), left_out)
    assert none is not None
    assert none.model.effects == ()


def test_what_was_accepted_last_may_be_the_first_without_some_trials(
    noise_only: Any,
) -> None:
    """It stood far behind the other at first, which it has made superfluous."""
    _, refit = noise_only.bench()

    def trialled(**gains: float) -> tuple[Trialled, ...]:
        return tuple(Trialled(name, gain, gain, 1.0, refit) for name, gain in gains.items())

    rounds = (
        Round(refit, trialled(springpot=100.0, yield_force=20.0, damage=8.0), ('springpot',)),
        Round(refit, trialled(yield_force=50.0), ('yield_force',)),
        Round(refit, trialled(damage=8.0, ageing=2.0), ()),
    )
    assert _contenders(rounds, ('yield_force',)) == (
        ('yield_force', 'springpot'),
        ('yield_force',),
        ('damage',),
    )
    # What leads comes first where it is needed.
    assert _contenders(rounds, ('springpot', 'yield_force'))[0] == ('springpot', 'yield_force')


def test_a_rest_widens_a_set_and_takes_nothing_out_of_it(noise_only: Any) -> None:
    _, refit = noise_only.bench()
    gains = {'springpot': 100.0, 'damage': 80.0, 'friction': 60.0, 'yield_force': 20.0}
    tried = tuple(Trialled(name, gain, gain, 1.0, refit) for name, gain in gains.items())
    # As good as the leader, though not by itself.
    found = Round(refit, tried, ('springpot', 'yield_force'))
    assert _widened(found) == ('springpot', 'yield_force', 'damage')


@ACTING
def test_each_left_out_push_is_predicted_better(case: Any, effect: Undeclared, seed: int) -> None:
    ranking = case(effect, seed).found.ranking
    assert ranking[0].effect == effect.name
    assert ranking[0].held_out_ratio < 0.95
    others = [each.held_out_ratio for each in ranking[1:] if each.held_out_ratio is not None]
    assert all(ratio > ranking[0].held_out_ratio for ratio in others)
    # What was not refitted changes nobody knows what.
    unknown = [each.strength is None for each in ranking]
    assert unknown == [each.held_out_ratio is None for each in ranking]
    assert any(unknown)


def test_other_laws_are_looked_for_where_the_usual_ones_find_nothing(noise_only: Any) -> None:
    told = list[str]()
    found = diagnose(noise_only.pairs, progress=told.append)
    assert found.status == 'none'
    assert 'trying friction:in_contact' in told


@pytest.mark.parametrize(
    ('known', 'better', 'taken'),
    [
        ('yield_force', 15.0, True),
        ('arm_clock_offset', 15.0, False),
        ('arm_clock_offset', 25.0, True),
    ],
)
def test_another_law_must_show_an_effect_where_late_stamps_leave_none(
    known: str, better: float, taken: bool, noise_only: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, refit = noise_only.bench()
    chosen = replace(refit, model=Model((known,)))
    other = replace(refit, model=Model(('inertia:added',)), deviance=refit.deviance - better)
    rounds = (Round(refit, (), (known,)),)
    again = (other, rounds, other.model.effects)
    monkeypatch.setattr(search._Search, '_select', lambda *_: again)
    looking = object.__new__(search._Search)
    found = looking._further(bench, chosen, rounds, (known,), ['inertia:added'])
    assert found == (again if taken else (chosen, rounds, (known,)))


@pytest.mark.parametrize(
    ('other', 'seed', 'law'),
    [
        (Undeclared('stiction', (0.1, 1e-5)), 16, 'friction:held'),
        (Undeclared('contact_friction', (0.3,)), 12, 'friction:in_contact'),
        (Undeclared('tool_mass', (0.3,)), 13, 'inertia:of_the_tool'),
        (Undeclared('gathered_mass', (1.5,)), 20, 'inertia:added'),
        (Undeclared('early_shadow', (2e-4, 1.5e-3)), 14, 'height_bias:near'),
        (Undeclared('touch_shadow', (-2e-4,)), 17, 'height_bias:touching'),
        (Undeclared('loose_top', (3e-4,)), 18, 'contact_offset:loose_top'),
        (Undeclared('ageing', (8.0,)), 15, 'ageing:within_trials'),
        (Undeclared('necking', (0.3, 4e-4)), 19, 'adhesion:cohesive_zone'),
        (Undeclared('stringing', (0.3, 4e-4)), 19, 'adhesion:fading_zone'),
        (Undeclared('lasting_damage', (0.4,)), 22, 'damage:lasting'),
        (Undeclared('early_damage', (0.5, 2e-3)), 24, 'damage:saturating'),
        (Undeclared('early_lasting_damage', (0.5, 2e-3)), 25, 'damage:lasting_saturating'),
    ],
    ids=lambda value: getattr(value, 'name', ''),
)
def test_an_effect_is_named_by_whatever_law_it_acts(
    world: Any, other: Undeclared, seed: int, law: str
) -> None:
    found = diagnose(world.measure(world.campaign(), other, seed=seed).pairs)
    effect = law.partition(':')[0]
    assert (found.status, found.effects, found.sets) == ('explained', (effect,), ((effect,),))
    assert found.laws == (law,)
    assert found.after.model.effects == (law,)
    # The strength is the first parameter of either.
    symbol = found.after.model.names[3]
    estimate = found.after.parameters[symbol]
    assert abs(estimate.value - other.values[0]) < NOISES * estimate.std
    assert estimate.std < 0.1 * abs(other.values[0])
    assert [each.effect for each in found.ranking].count(effect) == 1


def _late(world: Any, late: float, *effects: Undeclared) -> Any:
    """Return a campaign whose arm tells its place later than the load cell its force."""

    def stamped(trial: Trial) -> Trial:
        tool = trial.tool_height
        return replace(trial, tool_height=Signal(tool.t + late, tool.value))

    return world.measure(world.campaign(rate=500.0), *effects, seed=21, change=stamped)


def test_stamps_of_the_arm_that_are_late_are_moved_and_no_effect(world: Any) -> None:
    measured = _late(world, 0.008)
    found = diagnose(measured.pairs)
    assert (found.status, found.effects) == ('none', ())
    assert found.late == pytest.approx(0.008, abs=2e-4)
    told = re.search(r'are ([0-9.]+) ms late', ''.join(found.warnings))
    assert told is not None
    assert float(told.group(1)) == pytest.approx(8.0, abs=0.2)
    assert 'arm_clock_offset' not in found.not_testable
    assert 'inertia' not in found.not_testable
    body = measured.truth.body
    off = np.exp(found.before.theta[:3]) / [body.K1, body.C1, body.C2] - 1.0
    assert np.abs(off).max() < 0.01


def test_what_stamps_that_are_a_little_late_may_stand_for_is_told(world: Any) -> None:
    """A mass makes the force of a speed that is off for a moment, as they do."""
    found = diagnose(_late(world, 0.001).pairs)
    assert found.late == pytest.approx(0.001, abs=2e-4)
    assert (found.status, found.not_testable[0]) == ('none', 'inertia')
    assert 'inertia would show much the same' in found.warnings[0]


@pytest.mark.parametrize(
    ('alike', 'gains', 'others'),
    [
        (('arm_clock_offset',), (1000.0, 970.0, 990.0, 900.0), ('inertia',)),
        (('arm_clock_offset', 'inertia'), (30.0, 22.0, 29.0, 0.0), ('inertia',)),
        (('arm_clock_offset',), (1000.0, 900.0, 990.0, 900.0), ()),
    ],
)
def test_what_explains_nearly_as_much_is_what_late_stamps_may_stand_for(
    alike: tuple[str, ...], gains: tuple[float, ...], others: tuple[str, ...]
) -> None:
    model = Model(('arm_clock_offset',))
    theta = model.theta(np.array([1000.0, 900.0, 1600.0, 1e-3]))
    refit = SimpleNamespace(model=model, theta=theta)
    tried: list[Any] = [
        # One that was not fitted has a promise for its gain.
        SimpleNamespace(effect=name, gain=gain, refit=None if name == 'friction' else refit)
        for name, gain in zip(
            ('arm_clock_offset', 'inertia', 'friction', 'springpot'), gains, strict=True
        )
    ]
    made: Any = SimpleNamespace(alike=alike, candidates=tried)
    late, found = search._late([made], ['arm_clock_offset'])
    assert late == pytest.approx(1e-3)
    assert found == others


@pytest.mark.parametrize('effects', [(), ('clock_offset',)], ids=['none', 'late'])
def test_heights_whose_stamps_are_off_by_chance_are_no_clock_that_is(
    effects: tuple[str, ...], world: Any
) -> None:
    """Few heights are of a fast push: chance makes them early or late together."""
    random = np.random.default_rng(32)

    def stamped(trial: Trial) -> Trial:
        height = trial.displacement_height
        assert height is not None
        off = 0.003 * np.clip(random.standard_normal(height.t.size), -4.0, 4.0)
        return replace(trial, displacement_height=Signal(height.t + off, height.value))

    pushes = (0.03, 0.006), (0.03, 0.003), (0.012, 0.006), (0.03, 0.0045)
    acting = [Undeclared(name, (0.01,)) for name in effects]
    found = diagnose(world.measure(world.campaign(pushes), *acting, seed=32, change=stamped).pairs)
    assert found.effects == effects
    assert found.status == ('explained' if effects else 'none')


@pytest.mark.parametrize('seed', [21, 23])
def test_nothing_stands_in_for_a_part_of_what_is_late(world: Any, seed: int) -> None:
    """At 100 Hz a machine that gives way beside late stamps looks like stamps less late."""

    def stamped(trial: Trial) -> Trial:
        tool = trial.tool_height
        return replace(trial, tool_height=Signal(tool.t + 0.008, tool.value))

    found = diagnose(world.measure(world.campaign(rate=100.0), seed=seed, change=stamped).pairs)
    assert (found.status, found.effects) == ('none', ())
    assert found.late == pytest.approx(0.008, abs=5e-4)


def test_an_effect_beside_late_stamps_is_named_alone(world: Any) -> None:
    found = diagnose(_late(world, 0.008, YIELD).pairs)
    assert (found.status, found.effects) == ('explained', ('yield_force',))
    assert found.late == pytest.approx(0.008, abs=3e-4)
    assert abs(found.after.parameters['F_y'].value - YIELD.values[0]) < 0.02


def test_the_whole_analysis_has_the_moved_stamps(world: Any) -> None:
    trials = [analyse(trial) for trial, _ in _late(world, 0.008).pairs]
    whole = analyse_campaign(trials[:3], trials[3:])
    assert whole.diagnosis is not None
    assert whole.diagnosis.status == 'none'
    assert whole.before is not None
    assert whole.before.held_out is not None
    # The trial that is held out has been moved as well.
    force = whole.before.held_out.total['force']
    assert force.chi2 == pytest.approx(1.0, abs=0.15)


def test_a_trial_of_another_object_is_no_trial_that_was_foreseen(world: Any) -> None:
    campaign = world.campaign(hold=3.0, recover=2.0)
    trials = [analyse(trial) for trial, _ in world.measure(campaign, seed=5).pairs]
    other = replace(campaign, body=Body(3000.0, 2700.0, 4800.0))
    (*_, unseen) = [analyse(trial) for trial, _ in world.measure(other, seed=6).pairs]
    unseen = replace(unseen, trial=replace(unseen.trial, name='other'))
    whole = analyse_campaign(trials, [unseen])
    assert whole.diagnosis is not None
    assert whole.diagnosis.status == 'none'
    told = [each for each in whole.warnings if each.startswith('a contradiction')]
    assert any('the trials held out (other)' in each and 'the force' in each for each in told)
    # Without it there is none.
    assert not any('contradiction' in each for each in analyse_campaign(trials).warnings)
    # A model that was asked for is no better.
    asked = analyse_campaign(trials, [unseen], model=Model()).warnings
    assert any('the trials held out (other)' in each and 'the force' in each for each in asked)
    assert any(
        'by chance is unknown' in each
        for each in analyse_campaign(trials, [unseen], model=Model(('yield_force',))).warnings
    )


def test_trials_that_scatter_tell_an_object_no_better_than_they_scatter(world: Any) -> None:
    pushes = ((0.004, 0.006), (0.004, 0.006), (0.006, 0.005), (0.006, 0.005))
    campaign = world.campaign(pushes, hold=3.0, recover=2.0)
    trials = [
        analyse(
            world.measure(replace(campaign, body=_scaled(campaign.body, f)), seed=k).pairs[k][0]
        )
        for k, f in enumerate((0.97, 1.03, 0.98, 1.02))
    ]
    whole = analyse_campaign(trials)
    assert whole.diagnosis is not None
    assert whole.diagnosis.status == 'none'
    K1, truth = whole.before.parameters['K1'], campaign.body.K1
    assert K1.std is not None
    # Of four that scatter by 3 to 4 %, not of one.
    assert 0.005 * truth < K1.std < 0.04 * truth
    assert abs(K1.value - truth) < 3.0 * K1.std
    # Each has K1, C1 and C2 of its own, also where it is held out.
    for factor, differs in ((1.03, False), (1.5, True)):
        body = _scaled(campaign.body, factor)
        (*_, unseen) = world.measure(replace(campaign, body=body), seed=9).pairs
        held_out = [analyse(replace(unseen[0], name='other'))]
        told = analyse_campaign(trials, held_out).warnings
        told = [each for each in told if each.startswith('a contradiction')]
        assert bool(told) == differs
        assert all(each.startswith('a contradiction: other, held out, ') for each in told)


def test_a_trial_whose_force_is_lost_is_named(world: Any) -> None:
    pairs = world.measure(world.campaign(hold=3.0, recover=2.0), seed=8).pairs
    trials = [analyse(trial) for trial, _ in pairs]
    assert not any('stands out' in each for each in analyse_campaign(trials).warnings)
    lost, phases = pairs[1]
    assert phases.t_hold is not None
    force = lost.force
    dead = replace(force, value=np.where(force.t > phases.t_hold + 1.0, 0.0, force.value))
    trials[1] = analyse(replace(lost, force=dead))
    whole = analyse_campaign(trials)
    (told,) = [each for each in whole.warnings if 'stands out' in each and 'its force' in each]
    assert told.startswith(f'{lost.name} stands out: ')


def _scaled(body: Body, factor: float) -> Body:
    """Return a body of so much of each parameter."""
    return Body(*(factor * each for each in (body.K1, body.C1, body.C2)))


def test_trials_of_one_name_are_left_out_one_by_one(world: Any) -> None:
    trials = [
        analyse(replace(trial, name='push'))
        for trial, _ in world.measure(world.campaign(), seed=2).pairs
    ]
    whole = analyse_campaign(trials, model=Model())
    assert [one.trial.name for one in whole.trials] == ['push', 'push (2)', 'push (3)', 'push (4)']
    assert whole.before is not None and whole.before.held_out is not None
    assert len(whole.before.held_out.by_trial) == 2 * len(trials)


def test_what_has_passed_for_slow_noise_is_told(case: Any, world: Any) -> None:
    """Where the record shows no noise without contact the fit does not say so."""
    measured = world.measure(world.campaign(), Undeclared('yield_force', (0.8,)), seed=2)
    trials = [analyse(trial) for trial, _ in measured.pairs]
    model = analyse_campaign(trials, model=Model()).before
    assert model is not None and model.fit is not None and model.train is not None
    chi2 = model.train.total['force'].chi2
    assert chi2 is not None and chi2 > 2.5
    found = case(None, 1).found
    assert found.unexplained is None
    assert pipeline._passed_for_noise(model, found) == []
    silent = replace(model, fit=replace(model.fit, warnings=()))
    told = pipeline._passed_for_noise(silent, found)
    assert f'misses the force by {math.sqrt(chi2):.3g} times its noise' in told[0]
    # What is said to be left is told already.
    left = replace(found, unexplained=Unexplained(1.0, ('force',)))
    assert pipeline._passed_for_noise(silent, left) == []


def test_two_objects_are_no_scatter_of_one(world: Any) -> None:
    """Each push on both, now on one first and now on the other: repeats differ by half."""
    campaign = world.campaign(hold=3.0, recover=2.0)
    other = replace(campaign, body=Body(1500.0, 1350.0, 2400.0))
    pairs = []
    for late, one in enumerate((campaign, other)):
        for k, (trial, phases) in enumerate(world.measure(one, seed=7 + late).pairs):
            start = (2 * k + (late + k) % 2) * 10**11
            pairs.append((replace(trial, name=f'push_{k}_{late}', start_ns=start), phases))
    found = diagnose(pairs)
    assert found.status in ('unexplained', 'partly_explained')
    assert found.unexplained is not None
    (told,) = (each for each in found.warnings if each.startswith('repeats of the same push'))
    assert told.endswith('more than one object does')


def test_how_an_arm_may_stop_is_no_effect_and_no_rest(
    smoothed: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Commands that are smoothed over 128 ms, a lag of 28 ms, encoders that round."""
    made = smoothed(
        Body(1000.0, 900.0, 1600.0),
        (0.0028, 0.0013, 0.002),
        speed=0.0027,
        smooth=0.064,
        lag=0.028,
        resolution=2e-5,
        noise=0.01,
    )
    otherwise = search._otherwise
    first: list[bool] = []

    def looked_at(*known: Any) -> Any:
        first.append(bool(known[3].effects or known[3].rest))
        return otherwise(*known)

    monkeypatch.setattr(search, '_otherwise', looked_at)
    found = diagnose(made)
    assert (found.status, found.effects) == ('none', ())
    # By what the encoders alone tell of the stops, there would be something.
    assert first == [True]


def _beside(made: Any, servo: Servo) -> tuple[Any, Workbench, Refit]:
    """Return the trials of an arm, a bench of them, and the base model."""
    prepared, _ = prepare(made, servo=servo)
    before = fit_prepared(prepared, Model())
    bench = Workbench(before.problem.trials, None, before.noise.memory)
    return prepared, bench, bench.base(before)


def test_the_forces_tell_how_the_arm_goes_beside_a_model(smoothed: Any) -> None:
    """Where it does so otherwise than the encoders have told, by less than these can tell."""
    made = smoothed(
        Body(1000.0, 4000.0, 6000.0),
        (0.0028, 0.0013, 0.002),
        speed=0.0027,
        smooth=0.064,
        lag=0.001,
        resolution=2e-6,
        noise=0.01,
    )
    arm, corners = arm_of(made)
    assert arm is not None
    slower = replace(arm, duration=1.04 * arm.duration)
    (prepared, bench, base), (_, _, known) = (_beside(made, servo) for servo in (slower, arm))
    measured = made, prepared, corners
    way = search._best_way(bench, base, slower, measured, search._SHARPER, search._SHARPER)
    assert way is not None
    found, left = way
    assert left < base.deviance - 10.0 * search._SHARPER
    # What the encoders tell of both arms counts as well.
    assert left < known.deviance + told(corners, arm) - told(corners, slower) + 1.0
    assert told(corners, found) < told(corners, slower)
    # Nothing is looked for where so much is not to be gained.
    much = base.deviance - left
    assert search._best_way(bench, base, slower, measured, 2.0 * much, much) is None


def test_the_arm_is_looked_for_beside_what_was_chosen_and_its_rivals(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = world.measure(world.campaign(), YIELD, seed=2)
    bench, base = measured.bench()
    refits = {
        name: bench.refit(Model((name,)), base)
        for name in ('yield_force', 'force_lag', 'friction', 'inertia')
    }

    def tried(name: str, gain: float, law: str = '') -> Any:
        return SimpleNamespace(effect=name + law, gain=gain, refit=refits[name])

    candidates = (
        # The first may have been refused; another law of what was chosen is no rival of it.
        tried('force_lag', 120.0),
        tried('yield_force', 100.0),
        tried('yield_force', 95.0, ':held'),
        tried('friction', 80.0),
        tried('inertia', 30.0),
    )
    rounds = (SimpleNamespace(candidates=candidates),)
    outcome: Any = SimpleNamespace(
        chosen=refits['yield_force'], effects=('yield_force',), rounds=rounds, scatter=None
    )
    looked: list[Any] = []
    left = {'yield_force': -25.0, 'force_lag': -30.0, 'friction': 50.0}
    none = search.worth(bench, refits['yield_force'])

    def way(_: Any, model: Refit, arm: Any, *__: Any) -> Any:
        looked.append(model.model.effects)
        return model.model.effects, none + left[model.model.effects[0]]

    monkeypatch.setattr(search, '_best_way', way)
    before, arm = fit_prepared(base.problem.trials, Model()), Servo(0.1, 0.5, 0.02, False, 0.1)
    found = search._sharpened([], [], before, outcome, 1, arm, ())
    assert looked == [('yield_force',), ('force_lag',), ('friction',)]
    assert found == ('force_lag',)
    left['force_lag'] = -15.0
    left['yield_force'] = -15.0
    assert search._sharpened([], [], before, outcome, 1, arm, ()) is None


def test_all_is_diagnosed_anew_with_the_arm_that_the_forces_tell(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = world.measure(world.campaign(hold=3.0, recover=2.0), YIELD, seed=2)
    arm, _ = arm_of(measured.pairs)
    assert arm is not None
    other = replace(arm, duration=1.001 * arm.duration)
    asked: list[Any] = []

    def sharpened(*known: Any) -> Servo:
        asked.append(known[5])
        return other

    monkeypatch.setattr(search, '_sharpened', sharpened)
    said: list[str] = []
    found = diagnose(measured.pairs, progress=said.append)
    assert found.effects == ('yield_force',)
    # Once, and with that arm no more.
    assert asked == [arm]
    assert sum(each.startswith('looking again') for each in said) == 1
    assert {trial.path.servo for trial in found.before.problem.trials} == {other}


@pytest.mark.parametrize(
    ('again', 'before', 'good'),
    [
        ((('a',), None), (('b',), None), True),
        (((), None), (('b',), 0.1), True),
        ((('a', 'c'), None), (('b',), None), False),
        ((('a',), 0.1), (('b',), 0.3), True),
        ((('a',), 0.3), (('b',), 0.1), False),
        ((('a',), 0.1), (('b',), None), False),
        (((), 0.05), (('b',), 0.1), False),
    ],
)
def test_another_arm_is_taken_where_no_more_effects_leave_no_more(
    again: Any, before: Any, good: bool
) -> None:
    first, second = (
        SimpleNamespace(
            effects=effects, unexplained=None if left is None else Unexplained(left, ('force',))
        )
        for effects, left in (again, before)
    )
    assert search._is_as_good(first, second) is good  # type: ignore[arg-type]


def test_an_arm_that_ripples_is_no_effect() -> None:
    """By 15 um at 9 Hz, before encoders that tell a moment to 4 um; the body feels the speed."""
    campaign = Campaign(
        Body(3000.0, 500.0, 3000.0),
        tuple(Push(speed, depth, 4.0, 4.0) for speed, depth in ((2e-3, 6e-3), (6e-3, 4e-3))),
        Sensors(
            ForceNoise(0.1),
            1e-5,
            force_rate=500.0,
            tool_rate=500.0,
            encoder_noise=4e-6,
            encoder_resolution=5e-6,
        ),
        acceleration=0.1,
        ripple=15e-6,
        ripple_rate=9.0,
    )
    trials, _ = run(campaign, seed=3)
    found = diagnose([(a.trial, a.segmentation) for a in map(analyse, trials)])
    assert (found.status, found.effects) == ('none', ())
    assert np.exp(found.before.theta[:3]) == pytest.approx([3000.0, 500.0, 3000.0], rel=0.01)


@pytest.mark.parametrize('seed', range(2))
def test_a_long_stop_of_a_slow_push_before_coarse_encoders_is_no_effect(
    smoothed: Any, seed: int
) -> None:
    """Steps of 10 um, of which the tool makes one in three samples."""
    made = smoothed(
        Body(17000.0, 66000.0, 254000.0),
        (0.003, 0.003, 0.003),
        speed=0.00093,
        smooth=0.11,
        lag=0.006,
        resolution=1e-5,
        noise=0.35,
        hold=12.0,
        seed=seed,
    )
    found = diagnose(made)
    assert (found.status, found.effects) == ('none', ())


def test_a_campaign_that_the_base_explains_says_none(case: Any) -> None:
    found = case(None, 1).found
    assert (found.status, found.effects, found.sets) == ('none', (), ())
    assert found.unexplained is None
    assert found.after is found.before
    assert found.look_alikes == ()
    assert not any('scatter' in warning for warning in found.warnings)


def test_what_no_trial_can_show_is_listed(case: Any) -> None:
    for effect, seed in ((YIELD, 2), (LATE, 5), (None, 1)):
        assert 'load_cell_gain' in case(effect, seed).found.not_testable


def test_scatter_between_repeats_is_a_nuisance_and_no_effect(case: Any, world: Any) -> None:
    made = case(None, 1, world.repeated, 0.03)
    found = made.found
    assert found.status == 'none'
    # Nothing of it is open.
    assert found.repeat is None and found.advice == found.next_trial
    (warning,) = [each for each in found.warnings if 'repeats of the same push scatter' in each]
    assert '4 differences between repeats' in warning
    sizes = [0.01 * float(part.split()[-2]) for part in warning.split(' in ')[:3]]
    logs = np.log([[b.K1, b.C1, b.C2] for b in made.measured.truth.bodies[:-1]])
    away = np.concatenate([logs[k::2] - logs[k::2].mean(axis=0) for k in range(2)])
    happened = np.sqrt(np.sum(away**2) / (3 * 4))
    # What has happened is known but for the noise of single trials, half a percent each.
    assert np.sqrt(np.mean(np.square(sizes))) == pytest.approx(happened, rel=0.25)


def test_scatter_without_repeats_is_not_told_from_an_effect(case: Any) -> None:
    pushes = ((0.004, 0.006), (0.012, 0.006), (0.007, 0.003))
    found = case(None, 2, pushes, 0.03).found
    assert any('cannot be told from an effect' in warning for warning in found.warnings)
    # Four repeats of a push that was made tell it; each shows 3 % of scatter clearly.
    push = found.advice
    assert push is not None and push is found.repeat
    assert push.repeats == 4
    assert push.separates[0] == 'scatter'
    assert push.separates[1] in {each.effect for each in found.ranking}
    assert (push.push_speed, push.depth) in [pytest.approx(each, rel=0.05) for each in pushes]
    assert push.gain > 5.0


@pytest.mark.parametrize('seed', [8618, 30050], ids=['no repeats', 'one repeat'])
def test_two_effects_do_not_stand_for_the_scatter_of_three_trials(seed: int) -> None:
    """Ageing and a yield force, or damage, lower the deviance by as much as scatter does."""
    campaign = random_campaign(seed, scatter=0.02, longest=30.0)
    trials = run(campaign, seed=seed).trials
    assert len(trials) == 3
    found = diagnose([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials])
    assert found.effects == ()
    assert any('cannot be told from an effect' in warning for warning in found.warnings)
    # Of four differences between repeats there is one, or none.
    assert found.repeat is not None
    assert found.repeat.repeats == (4 if seed == 8618 else 3)


def test_what_comes_first_by_itself_is_not_taken_for_part_of_a_pair(world: Any) -> None:
    """By itself a second retardation gains more than either, and one or both beside it nothing."""
    effects = [
        Undeclared('parallel_spring', (120.0,)),
        Undeclared('strain_stiffening', (8e3,)),
    ]
    found = diagnose(world.measure(world.campaign(), *effects, seed=1).pairs)
    assert found.ranking[0].effect == 'second_retardation'
    assert found.sets == (('parallel_spring',), ('strain_stiffening',))
    # So it is without some of the trials.
    again = choose_again(found, {'trial_01'})
    assert again is not None
    assert set(again.model.effects) == {'parallel_spring', 'strain_stiffening'}


def stepping(world: Any, *effects: Undeclared, back: float = 0.0, late: float = 0.0) -> Any:
    """Return pushes in three steps, by an arm whose stamps may be late."""

    def stamped(trial: Trial) -> Trial:
        tool = trial.tool_height
        return replace(trial, tool_height=Signal(tool.t + late, tool.value))

    campaign = world.campaign(((0.004, 0.008), (0.012, 0.008)), recover=6.0, rate=500.0)
    pushes = tuple(replace(push, steps=3, back=back) for push in campaign.pushes)
    return world.measure(replace(campaign, pushes=pushes), *effects, seed=3, change=stamped)


def test_all_steps_of_a_push_tell_what_acts(world: Any) -> None:
    """The first, a third as deep and four seconds long, shows nothing of a weak spring."""
    measured = stepping(world, Undeclared('parallel_spring', (6.0,)))
    assert all('steps' in phases.warnings[-1] for phases in measured.phases)
    found = diagnose(measured.pairs)
    assert found.effects == ('parallel_spring',)
    assert len(found.sets[0]) <= 2
    spring = found.after.parameters['K_p']
    assert spring.value == pytest.approx(6.0, rel=0.1)
    first_only = [(t, replace(phases, whole=None)) for t, phases in measured.pairs]
    assert diagnose(first_only).effects == ()


def test_each_stop_of_a_push_in_steps_is_one(world: Any) -> None:
    bench, _ = stepping(world, back=0.003).bench()
    for trial in bench.trials:
        # Down, back, down, back, and down to the depth: a start and a stop, but the first start.
        assert len(trial.stops) == 9
        assert trial.stops[0] == pytest.approx(trial.t_first, abs=0.05)
        assert np.all(np.diff(trial.stops) > 0.0)
        assert trial.stops[-1] < trial.t_release - 3.9
        # The speed of the push is that of the first step.
        push, _ = trial.pushed
        assert trial.t[push.stop] <= trial.t_first
        assert trial.displacement[push.stop] == pytest.approx(0.008 / 3.0, rel=0.03)
        for t in trial.stops:
            assert trial.eventful[np.searchsorted(trial.samples.edges, t)]


def test_late_stamps_are_told_from_a_mass_where_the_tool_comes_again(world: Any) -> None:
    """Beside what flows both make a force where the tool changes its speed."""
    found = diagnose(stepping(world, back=0.003, late=1e-3).pairs)
    assert found.late == pytest.approx(1e-3, rel=0.1)
    assert found.effects == ()
    assert 'inertia' not in found.not_testable
    found = diagnose(stepping(world, Undeclared('inertia', (0.5,)), back=0.003).pairs)
    assert found.late == 0.0
    assert found.sets == (('inertia',),)


@pytest.mark.parametrize('seed', [3, 4])
def test_what_follows_each_push_alike_is_no_slow_noise(world: Any, seed: int) -> None:
    """A load cell that creeps by 6 % passes for a zero that wanders, trial by trial."""
    pushes = (*world.four, (0.008, 0.005))
    creep = Undeclared('cell_creep', (0.06, 3.0))
    measured = world.measure(world.campaign(pushes, hold=6.0), creep, seed=seed)
    found = diagnose(measured.pairs)
    assert found.before.noise.force.wander > 0.0
    assert found.status == 'unexplained'
    assert found.unexplained is not None
    assert found.unexplained.where[0].startswith('force, hold')


@pytest.mark.parametrize('effect', [('gain_step', -0.03), ('ageing', -1.0)])
def test_what_changed_between_two_trials_is_no_ageing(
    world: Any, effect: tuple[str, float]
) -> None:
    """Both go with time; by three tenths of it all that a gain has changed passes for ageing."""
    pushes = (*world.four, (0.008, 0.005))
    name, size = effect
    campaign = world.campaign(pushes, hold=3.0, recover=2.0)
    found = diagnose(world.measure(campaign, Undeclared(name, (size,)), seed=3).pairs)
    if name == 'ageing':
        assert found.sets == (('ageing',),)
        return
    assert (found.status, found.effects) == ('unexplained', ())
    assert found.unexplained is not None
    assert 'trial_04 to trial_05 differ from all others by -3' in found.unexplained.where[0]


def test_a_change_between_trials_without_repeats_is_said_and_no_scatter(world: Any) -> None:
    slow_first = ((0.004, 0.006), (0.004, 0.003), (0.004, 0.0045))
    campaign = world.campaign(
        (*slow_first, *((0.012, depth) for _, depth in slow_first)), hold=3.0, recover=2.0
    )
    found = diagnose(world.measure(campaign, Undeclared('gain_step', (0.08,)), seed=3).pairs)
    assert found.status == 'unexplained'
    assert found.unexplained is not None
    (where,) = found.unexplained.where
    assert 'trial_01 to trial_03 differ from all others by -7' in where
    assert where.endswith('no scatter, or goes with the push speed')


def test_a_change_between_two_rounds_is_no_ageing(world: Any) -> None:
    """Repeats are all as far apart in time, so that both make the same of them."""
    campaign = world.campaign(world.four * 2, hold=3.0, recover=2.0)
    for name, size in (('gain_step', 0.1), ('ageing', -1.0)):
        found = diagnose(world.measure(campaign, Undeclared(name, (size,)), seed=3).pairs)
        if name == 'ageing':
            assert (found.status, found.sets) == ('explained', (('ageing',),))
            continue
        assert found.status in ('unexplained', 'partly_explained')
        assert found.unexplained is not None
        assert any('trial_0' in each and 'no scatter' in each for each in found.unexplained.where)


def test_a_change_between_trials_is_no_less_than_the_scatter_of_a_few_repeats(world: Any) -> None:
    campaign = world.campaign((*world.four, (0.008, 0.005)), hold=3.0, recover=2.0)
    measured = world.measure(campaign, Undeclared('gain_step', (-0.03,)), seed=3)
    prepared, _ = prepare(measured.pairs)
    before = fit_prepared(prepared, Model())
    plain = Workbench(before.problem.trials, None)
    base = plain.base(before)
    steps = search._Search(
        before, measured.phases, 1, lambda _: None, None, line=False, dated=False
    )
    aged = plain.refit(Model(('ageing',)), base)
    sizes = []
    for known in (None, 0.006, 0.1):
        bench = plain if known is None else plain.scattering(np.full(3, known))
        sizes.append(steps._at_once(plain, bench, aged))
    assert sizes[0] == sizes[1] > 0.006
    assert sizes[2] == 0.1


def test_an_effect_of_no_library_is_not_taken_for_a_certain_one(case: Any) -> None:
    found = case(PORES, 6).found
    assert found.status != 'none'
    assert found.status != 'explained' or found.look_alikes


def same(one: Diagnosis, other: Diagnosis) -> None:
    """Assert that two diagnoses say the same."""
    assert (one.status, one.effects, one.sets) == (other.status, other.effects, other.sets)
    assert set(one.not_testable) == set(other.not_testable)
    std = np.sqrt(np.diag(one.after.covariance))
    # Searches end where the squares change by less than a tenth: well within the errors.
    np.testing.assert_array_less(np.abs(one.after.theta - other.after.theta), 0.2 * std)
    assert one.ranking[0].effect == other.ranking[0].effect
    assert one.ranking[0].score == pytest.approx(other.ranking[0].score, abs=1.0)


@pytest.fixture(scope='module')
def few(world: Any) -> Any:
    """Return three trials on a body that yields, and their diagnosis."""
    campaign = world.campaign(world.four[:3], hold=3.0, recover=2.0, rate=100.0)
    measured = world.measure(campaign, YIELD, seed=8)
    found = diagnose(measured.pairs)
    assert found.effects == ('yield_force',)
    return measured.pairs, found


def test_the_order_in_which_trials_are_given_does_not_matter(few: Any) -> None:
    pairs, found = few
    same(found, diagnose([pairs[k] for k in (2, 0, 1)]))


def test_neither_does_the_epoch_at_which_the_campaign_begins(few: Any) -> None:
    pairs, found = few
    shift = -1_000_000_000 * 10**9
    same(
        found,
        diagnose([(replace(t, start_ns=t.start_ns + shift), phases) for t, phases in pairs]),
    )


@pytest.mark.parametrize('names', ['zyx', 'aaa'], ids=['others', 'all_alike'])
def test_neither_do_the_names_of_the_trials(few: Any, names: str) -> None:
    pairs, found = few
    same(
        found,
        diagnose([(replace(t, name=name), p) for name, (t, p) in zip(names, pairs, strict=True)]),
    )


def _slow(world: Any, stiffness: float, resolution: float = 0.0, steps: int = 1) -> Any:
    """Return what is found where a spring acts in series and encoders do not show the stops."""
    campaign = world.campaign()
    pushes = tuple(replace(push, steps=steps) for push in campaign.pushes)
    campaign = replace(campaign, pushes=pushes)
    slow = replace(
        campaign.sensors, force_rate=500.0, tool_rate=50.0, encoder_resolution=resolution
    )
    spring = Undeclared('series_spring', (stiffness,))
    return diagnose(world.measure(replace(campaign, sensors=slow), spring, seed=3).pairs)


def test_the_touches_tell_what_slow_encoders_do_not_show(world: Any) -> None:
    found = _slow(world, 1.0e5)
    (names,) = found.sets
    assert 'series_spring' in names
    assert len(names) == 2


@pytest.mark.parametrize('steps', [1, 3])
def test_what_neither_touches_nor_slow_encoders_show_is_told_and_not_named(
    world: Any, steps: int
) -> None:
    # Encoders that round: else all stops together show how the arm makes them.
    found = _slow(world, 8e5, 2e-5, steps)
    assert found.effects == ()
    (told,) = (each for each in found.warnings if 'drawn out' in each)
    assert 'series_spring' in told
    assert 'every 20 ms' in told


def test_one_repeat_does_not_hide_that_the_object_ages(world: Any) -> None:
    """Five pushes over a campaign, of which the last repeats the first."""
    campaign = world.campaign((*world.four, world.four[0]), hold=3.0, recover=2.0, rate=100.0)
    found = diagnose(world.measure(campaign, Undeclared('ageing', (2.0,)), seed=4).pairs)
    assert found.sets == (('ageing',),)
    assert not any('scatter' in each for each in found.warnings)


def test_two_repeats_alone_do_not_tell_ageing_from_scatter(world: Any) -> None:
    campaign = world.campaign((world.four[0],) * 2, hold=3.0, recover=2.0, rate=100.0)
    found = diagnose(world.measure(campaign, Undeclared('ageing', (2.0,)), seed=4).pairs)
    assert found.effects == ()
    assert any('scatter' in each for each in found.warnings)


def test_ways_that_the_encoders_leave_open_lead_away_from_the_limits(smoothed: Any) -> None:
    """A servo without a lag has none that is less."""
    made = smoothed(
        Body(1000.0, 900.0, 1600.0),
        (0.0028, 0.0013),
        speed=0.0027,
        smooth=0.064,
        lag=0.001,
        resolution=1e-5,
        noise=0.01,
    )
    known, corners = arm_of(made)
    assert known is not None
    for arm in (known, replace(known, lag=0.0, jerk=0.0), replace(known, swing=0.6, lag=0.05)):
        ways = search._open_ways(corners, arm)
        assert ways.shape == ((4, 4) if arm.swing else (3, 3))
        start = told(corners, arm)
        for step in ways.tolist():
            other = arm.changed(*(0.5 * np.array(step)).tolist())
            assert other != arm
            # A step is one that the encoders allow, if all of it can be gone.
            assert told(corners, other) - start < 30.0


def test_what_was_accepted_is_no_rival_of_another() -> None:
    sets = [('series_spring', 'force_lag', 'yield_force'), ('yield_force',)]
    parted = _parted(sets, ('series_spring', 'yield_force'))
    assert parted == [('series_spring', 'force_lag'), ('yield_force',)]


@pytest.mark.parametrize(
    ('sets', 'told_apart'),
    [
        ([('inertia', 'friction:held', 'friction', 'yield_force')], ('inertia', 'yield_force')),
        # Both are accepted, or are two laws of one.
        ([('inertia', 'friction', 'friction:held'), ('friction', 'friction:held')], None),
        # The first of the set was refused.
        ([('yield_force', 'ageing'), ('friction', 'ageing')], ('friction', 'ageing')),
    ],
)
def test_the_next_push_splits_what_was_accepted_from_its_rivals(
    sets: Any, told_apart: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def suggested(_: Any, first: Any, second: Any, *__: Any, **___: Any) -> NextTrial:
        names = (first, second) if second else ('K1',)
        return NextTrial(1e-3, 1e-3, 10.0, names, 2.0, 'because')

    monkeypatch.setattr(search, 'suggest', suggested)
    names = {name for each in sets for name in each}
    candidates = [SimpleNamespace(effect=name, refit=name) for name in names]
    rounds = [SimpleNamespace(alike=each, candidates=candidates) for each in sets]
    within: Any = SimpleNamespace(phases=(), limits=None, workers=1)
    found = search._Search._next(within, within, within, rounds, ('inertia', 'friction'))
    assert found is not None
    assert found.separates == (told_apart or ('K1',))


def test_what_a_diagnosis_knows_of_the_arm_is_found_once(
    noise_only: Any, yielding: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By other processes as by this one; what they have smoothed is not smoothed again."""
    smoothed = []
    smooth = way._smooth

    def counted(t: Any, *known: Any) -> way.Way:
        smoothed.append(t.size)
        return smooth(t, *known)

    monkeypatch.setattr(way, '_smooth', counted)
    monkeypatch.setattr(way, '_kept', {})
    alone = arm_of(noise_only.pairs)
    count = len(smoothed)
    assert count == len(noise_only.pairs)
    monkeypatch.setattr(way, '_kept', {})

    def elsewhere(function: Any, items: Any, *_: Any) -> Any:
        for item in items:
            known = way.kept()
            result = function(item)
            way._kept.clear()
            way.keep(known)
            yield result

    with monkeypatch.context() as others:
        others.setattr(data.parallel, 'each', elsewhere)
        together = arm_of(noise_only.pairs, workers=2)
    assert together[0] == alone[0]
    assert [corner.t.tolist() for corner in together[1]] == [c.t.tolist() for c in alone[1]]
    count = len(smoothed)
    asked = []

    def asking(*of: Any, **how: Any) -> Any:
        asked.append(how)
        return arm_of(*of, **how)

    for place in (data, search):
        monkeypatch.setattr(place, 'arm_of', asking)
    assert diagnose(noise_only.pairs).status == 'none'
    assert len(smoothed) == count
    asked.clear()
    assert diagnose(yielding.pairs).effects == ('yield_force',)
    assert len(asked) == 1


def test_ways_that_are_kept_make_room_for_later_ones(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(way, '_kept', {})
    found = way.Way(np.zeros(2), np.zeros(2), 0.0, 1.0, np.zeros(2))
    for number in range(70):
        way.keep({(b'', b'', float(number), b''): found})
    assert [key[2] for key in way.kept()] == list(range(6, 70))
