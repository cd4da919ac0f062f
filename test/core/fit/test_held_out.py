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


"""Errors on trials that a fit has seen and on those that it has not."""

from collections.abc import Callable, Collection
from dataclasses import replace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit import data
from hapticvision_ros.core.fit.campaign import Fit, fit
from hapticvision_ros.core.fit.data import arm_of
from hapticvision_ros.core.fit.held_out import (
    are_repeats,
    conditions,
    fitted_trials,
    held_out_change,
    labels,
    leave_one_condition_out,
    misfits,
    phases_at,
    predict_unseen,
    prepared_of,
    refit_without,
    sample_noise,
    Trained,
    Unseen,
)
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.records import Estimate, Segmentation, Signal, Trial
import numpy as np
import pytest

type Pair = tuple[Trial, Segmentation]

FORCE_NOISE, HEIGHT_NOISE = 0.02, 5e-5
NOISE = Noise(Estimate(FORCE_NOISE), Estimate(HEIGHT_NOISE))
YIELD = Model(('yield_force',))
PUSHES = ((0.002, 0.005), (0.005, 0.005), (0.005, 0.008))


def _noisy(pair: Pair, seed: int) -> Pair:
    """Return a trial with white noise and a zero of the load cell that nobody has taken off."""
    trial, phases = pair
    rng = np.random.default_rng(seed)
    height = trial.displacement_height
    assert height is not None
    return replace(
        trial,
        name=f'trial_{seed}',
        start_ns=seed * 600 * 10**9,
        force=Signal(
            trial.force.t,
            trial.force.value + 0.03 + FORCE_NOISE * rng.standard_normal(len(trial.force)),
        ),
        displacement_height=Signal(
            height.t, height.value + HEIGHT_NOISE * rng.standard_normal(len(height))
        ),
    ), phases


@pytest.fixture(scope='module')
def campaign(bingham: Callable[[], Any]) -> list[Pair]:
    """Return three pushes of a body with a yield force, from an integrator of its own."""
    body = bingham()
    return [
        _noisy(body.make(speed, depth, hold=8.0, recovery=6.0), seed)
        for seed, (speed, depth) in enumerate(PUSHES)
    ]


@pytest.fixture(scope='module')
def base(campaign: list[Pair]) -> Fit:
    """Return the three-element model fitted to them."""
    return fit(campaign)


@pytest.fixture(scope='module')
def right(campaign: list[Pair]) -> Fit:
    """Return the right model fitted to them."""
    return fit(campaign, YIELD)


def test_the_phase_of_a_sample_is_that_of_the_last_instant_before_it() -> None:
    phases = Segmentation(1.0, 2.0, 5.0, 6.0, 9.0, 0.04, 0.0, 0.005, 0.005)
    t = np.array([0.5, 1.0, 1.9, 2.0, 5.5, 6.0, 8.0])
    assert phases_at(t, phases).tolist() == [0, 1, 1, 2, 3, 4, 4]
    # Contact is lost at once: there is no release; and a trial without one ends in its hold.
    assert phases_at(t, replace(phases, t_loss=5.0)).tolist() == [0, 1, 1, 2, 4, 4, 4]
    assert phases_at(t, replace(phases, t_release=None, t_loss=None)).max() == 2


def test_the_right_model_leaves_the_noise_in_each_phase_and_trial(
    campaign: list[Pair], right: Fit
) -> None:
    found = misfits(fitted_trials(right, campaign), campaign, NOISE)
    assert found is not None
    assert found.total['force'].samples > 9000
    for misfit in (*found.by_phase.values(), *found.by_trial.values()):
        assert misfit.chi2 is not None
        # The mean of n squares scatters by sqrt(2/n).
        assert misfit.chi2 == pytest.approx(1.0, abs=5.0 * np.sqrt(2.0 / misfit.samples))
    assert {phase for _, phase in found.by_phase} >= {'approach', 'push', 'hold', 'recover'}
    peak = max(pair[0].force.value.max() for pair in campaign)
    percent = found.total['force'].percent_of_range
    assert percent == pytest.approx(100.0 * FORCE_NOISE / peak, rel=0.05)


def test_every_height_counts_by_itself(campaign: list[Pair], right: Fit) -> None:
    # The fit works with means of heights, which scatter less than a sample.
    means = sum(len(one.height) for one in right.trials if one is not None)
    seen = fitted_trials(right, campaign)
    samples = sum(len(one.height) for one in seen if one is not None)
    recorded = sum(len(pair[0].displacement_height or ()) for pair in campaign)
    assert means < 0.9 * samples and samples >= recorded - len(campaign)


def test_a_height_that_is_set_aside_counts_nowhere_and_is_told(campaign: list[Pair]) -> None:
    trial, phases = campaign[0]
    height = trial.displacement_height
    assert height is not None
    value = height.value.copy()
    at = height.t.size - 60
    value[at] += 1e-3
    spoilt = [(replace(trial, displacement_height=Signal(height.t, value)), phases), *campaign[1:]]
    found = fit(spoilt, YIELD)
    told = [warning for warning in found.warnings if 'displacement height stands out' in warning]
    assert len(told) == 1 and f'(at {height.t[at]:.4g} s)' in told[0]
    seen = fitted_trials(found, spoilt)[0]
    assert seen is not None
    assert height.t[at] not in seen.height.t
    assert height.t[at - 1] in seen.height.t


def test_a_load_cell_that_rounds_by_more_than_its_noise_has_that_of_rounding(
    campaign: list[Pair],
) -> None:
    step = 20.0 * FORCE_NOISE
    coarse = []
    for trial, phases in campaign:
        # Without contact it reads the same all the time.
        value = step * np.round((trial.force.value - 0.03) / step)
        coarse.append((replace(trial, force=Signal(trial.force.t, value)), phases))
        assert phases.t_contact is not None
        assert np.ptp(value[trial.force.t < phases.t_contact - 0.1]) == 0.0
    found = fit(coarse, YIELD)
    noise = sample_noise(found, fitted_trials(found, coarse), coarse)
    assert noise.force.value is not None
    assert 0.5 < noise.force.value / (step / np.sqrt(12.0)) < 1.1


def test_a_height_that_is_the_same_until_the_touch_has_the_noise_that_it_has_from_then_on(
    campaign: list[Pair],
) -> None:
    taken = []
    for trial, phases in campaign:
        height = trial.displacement_height
        assert height is not None and phases.t_contact is not None
        touched = height.t > phases.t_contact
        value = np.where(touched, np.round(height.value / 1e-5) * 1e-5, height.value[0])
        taken.append((replace(trial, displacement_height=Signal(height.t, value)), phases))
    found = fit(taken, YIELD)
    noise = sample_noise(found, fitted_trials(found, taken), taken)
    assert noise.height.value == pytest.approx(HEIGHT_NOISE, rel=0.1)


@pytest.mark.parametrize('which', ['base', 'right'])
def test_the_noise_is_that_of_the_sensors_whether_the_model_is_right_or_not(
    campaign: list[Pair], which: str, request: pytest.FixtureRequest
) -> None:
    found = request.getfixturevalue(which)
    noise = sample_noise(found, fitted_trials(found, campaign), campaign)
    # Before contact are 600 samples of either: 3 % each, five standard errors.
    assert noise.force.value == pytest.approx(FORCE_NOISE, rel=0.15)
    assert noise.height.value == pytest.approx(HEIGHT_NOISE, rel=0.15)


def test_an_unseen_trial_is_predicted_to_within_the_noise(campaign: list[Pair]) -> None:
    seen, unseen = campaign[:2], campaign[2:]
    found = predict_unseen(Trained.of(fit(seen, YIELD), seen), unseen)
    errors = misfits(found.trials, unseen, NOISE)
    assert errors is not None
    for misfit in errors.total.values():
        assert misfit.chi2 is not None
        # 3000 samples and parameters that the two others tell to a part of the noise.
        assert misfit.chi2 == pytest.approx(1.0, abs=0.15)
    (trial,) = found.trials
    assert trial is not None
    # The zero that is the trial's own is found: segmentation was told none.
    assert trial.values['force_zero'].value == pytest.approx(0.03, abs=0.005)


def test_the_parameters_do_not_move_for_an_unseen_trial(campaign: list[Pair], right: Fit) -> None:
    trial, phases = campaign[0]
    doubled = replace(trial, force=Signal(trial.force.t, 2.0 * trial.force.value))
    found = predict_unseen(Trained.of(right, campaign), [(doubled, phases)])
    errors = misfits(found.trials, [(doubled, phases)], NOISE)
    assert errors is not None
    # Twice the force is missed by about itself: nothing but zero and onset can give way.
    size = float(np.sqrt(np.mean(trial.force.value**2)))
    assert errors.total['force'].rmse > 0.5 * size


def test_an_arm_that_is_not_known_is_told_by_the_unseen_trials(
    campaign: list[Pair], right: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not taken for one that nothing tells."""
    asked = []

    def asking(trials: Any) -> Any:
        asked.append(trials)
        return arm_of(trials)

    monkeypatch.setattr(data, 'arm_of', asking)
    trained = replace(Trained.of(right, campaign), servo=None)
    predict_unseen(trained, campaign[:1])
    assert asked == [campaign[:1]]


def test_a_push_after_others_finds_their_damage(campaign: list[Pair], base: Fit) -> None:
    trained = Trained.of(base, campaign[:2])
    trial, phases = campaign[2]

    def squares(effect: str, numbers: tuple[float, ...], start_ns: int) -> float | None:
        told = replace(trained, model=Model((effect,)), theta=np.append(base.theta, numbers))
        return predict_unseen(told, [(replace(trial, start_ns=start_ns), phases)]).squares[0]

    before = campaign[0][0].start_ns - 10**12
    fresh = squares('damage', (0.5,), before)
    assert squares('damage:lasting', (0.5, 0.7), before) == pytest.approx(fresh, rel=1e-6)
    assert squares('damage:lasting', (0.5, 0.7), trial.start_ns) != pytest.approx(fresh, rel=1e-3)


def test_what_is_left_out_is_not_seen(campaign: list[Pair], right: Fit) -> None:
    spoilt_trial, phases = campaign[2]
    spoilt_trial = replace(
        spoilt_trial, force=Signal(spoilt_trial.force.t, 3.0 * spoilt_trial.force.value)
    )
    spoilt = [*campaign[:2], (spoilt_trial, phases)]
    honest = refit_without(right, campaign, (2,))
    fooled = fit(spoilt, YIELD)
    still = refit_without(replace(fooled, noise=right.noise, theta=right.theta), spoilt, (2,))
    assert honest is not None and still is not None
    std = np.sqrt(np.diag(right.covariance))
    assert np.all(np.abs(still.theta - honest.theta) < 0.5 * std)
    # Though the whole campaign would have moved.
    assert np.any(np.abs(fooled.theta - honest.theta) > 20.0 * std)
    assert refit_without(right, campaign, (0, 1, 2)) is None


def test_the_right_effect_takes_the_error_on_left_out_conditions_to_the_noise(
    campaign: list[Pair], base: Fit, right: Fit
) -> None:
    def refit(left_out: Collection[int]) -> list[Trained]:
        trained = (refit_without(one, campaign, left_out) for one in (base, right))
        return [one for one in trained if one is not None]

    before, after = leave_one_condition_out(campaign, refit, prepared_of(right), right.noise)
    chi2 = []
    for unseen in (before, after):
        errors = misfits(unseen.trials, campaign, NOISE)
        assert errors is not None
        chi2.append(errors.total['force'].chi2)
    assert chi2[0] > 100.0 and chi2[1] == pytest.approx(1.0, abs=0.15)
    change = held_out_change(before, after)
    assert change is not None
    assert change.ratio < 0.02 and change.change < 0.0
    each = [b - a for a, b in zip(before.squares, after.squares, strict=True)]
    assert change.change == pytest.approx(np.mean(each))
    assert change.std == pytest.approx(np.std(each, ddof=1) / np.sqrt(3.0))


def _push(speed: float | None, depth: float | None) -> Pair:
    trial = Trial(
        'a', 0, Signal(np.arange(2.0), np.zeros(2)), Signal(np.arange(2.0), np.zeros(2)), None
    )
    return trial, Segmentation(0.0, 1.0, None, None, 2.0, 0.04, 0.0, speed, depth)


def test_pushes_within_a_tenth_in_speed_and_depth_are_one_condition() -> None:
    pushes = [(5.0, 5.0), (5.2, 4.9), (5.0, 8.0), (2.0, 5.0), (4.8, 5.1), (None, 5.0), (None, 5.0)]
    assert conditions([_push(*push) for push in pushes]) == ((0, 1, 4), (2,), (3,), (5,), (6,))


def test_repeats_of_one_push_are_left_out_one_by_one() -> None:
    assert conditions([_push(5.0, 5.0)] * 3) == ((0,), (1,), (2,))
    assert are_repeats([_push(5.0, 5.0)] * 3)
    assert not are_repeats([_push(5.0, 5.0), _push(5.0, 8.0)])
    # Nor is a push in steps one that goes on at once.
    trial, straight = _push(5.0, 5.0)
    step = replace(straight, t_contact=1.0, t_first=1.5, t_hold=3.0)
    assert conditions([(trial, straight), (trial, step), (trial, step)]) == ((0,), (1, 2))
    assert labels([_push(5.0, 5.0)] * 3) == ('a', 'a (2)', 'a (3)')


def test_a_change_without_trials_is_none() -> None:
    assert held_out_change(Unseen((None,), (None,)), Unseen((None,), (1.0,))) is None
