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

"""The fit of a whole campaign, on trials in closed form: what it finds, and how sure it is."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
import importlib.util
import math
from pathlib import Path
import sys
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.fit import campaign as fitting
from hapticvision_ros.core.fit.campaign import (
    _jump_variance,
    _jumps,
    Blur,
    Fit,
    fit,
    fit_prepared,
    Memory,
    Problem,
    replace_onsets,
)
from hapticvision_ros.core.fit.data import FitTrial, prepare
from hapticvision_ros.core.fit.intervals import profile_intervals
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.models.three_element import ThreeElement
from hapticvision_ros.core.records import Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim import campaigns, specimen, strengths
import numpy as np
import pytest
from scipy.signal import lfilter

_SPEC = importlib.util.spec_from_file_location(
    'closed_form', Path(__file__).parents[3] / 'bench' / 'closed_form.py'
)
closed_form = importlib.util.module_from_spec(_SPEC)
sys.modules['closed_form'] = closed_form
_SPEC.loader.exec_module(closed_form)
Body, campaign, Cell = closed_form.Body, closed_form.campaign, closed_form.Cell


def _scores(result: Fit, body: Body) -> np.ndarray:
    """Return how many of its standard errors the fit is off."""
    return (result.theta[:3] - body.logarithms) / np.sqrt(np.diag(result.covariance)[:3])


def test_intervals_cover_the_truth() -> None:
    """
    Of 60 campaigns with correlated noise the 95 % intervals hold the truth about so often.

    With 180 intervals, binomial, four standard deviations below 95 % are 88.5 %; taking the noise
    for white covers 85 %, with scores of 1.34.
    """
    body = Body()
    scores = np.array([_scores(fit(campaign(seed, 2)), body) for seed in range(60)])
    covered = np.abs(scores) < 1.96
    assert covered.mean() > 0.885
    # Errors that are far too large cover everything.
    assert 0.75 < scores.std() < 1.25
    # Without bias: the mean of 60 scores of unit variance has a standard deviation of 0.13.
    assert np.all(np.abs(scores.mean(axis=0)) < 0.55)


def test_error_bars_hold_at_1_khz_with_long_noise() -> None:
    """Five times the samples with noise five times as long tell hardly more."""
    long = Cell(rate=1000.0, tool_rate=500.0, correlation=0.9)
    result = fit(campaign(3, 3, cell=long))
    assert np.all(np.abs(_scores(result, Body())) < 4.0)
    assert result.noise.force.std == pytest.approx(0.05, rel=0.1)
    # An autoregression of coefficient 0.9 at 1 kHz forgets in 9.5 ms.
    assert result.noise.force.correlation_time == pytest.approx(9.5e-3, rel=0.15)
    assert result.noise.force.white < 0.01
    assert result.noise.force_before_contact == pytest.approx(0.05, rel=0.25)


@pytest.mark.parametrize('factors', [(30.0, 30.0, 30.0), (1 / 30, 30.0, 1 / 30), (30, 1 / 30, 1)])
def test_the_start_does_not_matter(factors: tuple[float, ...]) -> None:
    """Starts off by a factor of thirty end where the usual one does."""
    trials = campaign(1, 2)
    usual = fit(trials)
    body = Body()
    truth = dict(zip(('K1', 'C1', 'C2'), (body.K1, body.C1, body.C2), strict=True))
    start = {name: truth[name] * f for name, f in zip(truth, factors, strict=True)}
    # A tenth of a standard error is far below what the noise leaves open.
    off = fit(trials, start=start).theta - usual.theta
    assert np.all(np.abs(off) < 0.1 * np.sqrt(np.diag(usual.covariance)))


def test_where_the_model_is_not_finite_a_search_turns_back() -> None:
    result = fit(campaign(1, 2))
    state = result.state.copy()
    state[0] = 800.0
    residual, jacobian = result.problem.reduced(state, 1)
    assert residual.tolist() == [math.inf]
    assert np.isfinite(jacobian).all()
    residual, jacobian = result.problem.evaluate(state)
    assert residual.tolist() == [math.inf]
    assert jacobian.shape == (1, state.size)


def test_what_is_known_of_onsets_and_zeros_beforehand_is_weighed() -> None:
    result = fit(campaign(1, 2))
    problem, state = result.problem, result.state + 1e-3
    rows, aim = problem.priors(state)
    assert aim.size == 4
    assert aim == pytest.approx(rows @ state)
    assert np.count_nonzero(aim) == 4
    residual, jacobian = problem.evaluate(state)
    per_trial = residual.size // 2
    known = np.add.outer(per_trial * np.arange(1, 3), np.arange(-2, 0)).ravel()
    assert np.array_equal(jacobian[known], rows)
    assert np.array_equal(residual[known], aim)


@pytest.mark.parametrize('length', [1, 3, 100])
def test_glitches_are_set_aside_and_told(length: int) -> None:
    """A spike, or half a second of nonsense, moves no parameter and is reported."""
    trials = campaign(2, 2)
    clean = fit(trials)
    trial, phases = trials[0]
    value = trial.force.value.copy()
    first = int(np.searchsorted(trial.force.t, 6.0))
    value[first:][:length] += 8.0
    spoilt = replace(trial, force=Signal(trial.force.t, value))
    result = fit([(spoilt, phases), trials[1]])
    off = np.abs(result.theta - clean.theta) / np.sqrt(np.diag(clean.covariance))
    # The samples under the glitch are lost, which moves the result a little.
    assert np.all(off < 0.5)
    # A glitch may take its neighbours with it: they are not told apart within 4 samples.
    assert length <= result.trials[0].set_aside.size <= length + 9
    assert any('set aside (at' in warning for warning in result.warnings)
    assert not any('set aside (at' in warning for warning in clean.warnings)


def test_a_trial_without_release_still_tells_the_elements() -> None:
    """Push and hold alone hold the three elements; the recovery is not needed."""
    result = fit(campaign(4, 2, cell=Cell(release=False)))
    assert all(estimate.known for estimate in result.parameters.values())
    assert np.all(np.abs(_scores(result, Body())) < 4.0)


def test_a_spring_has_no_dashpots() -> None:
    """What does not flow or creep within the trials is unknown with a reason, not a number."""
    spring = Body(K1=2000.0, C1=1e-3, C2=1e9)
    result = fit(campaign(5, 2, body=spring))
    assert result.parameters['K1'].value == pytest.approx(2000.0, rel=0.01)
    for name in ('C1', 'C2'):
        assert not result.parameters[name].known
        assert result.parameters[name].reason
    interval = profile_intervals(result, ['C2'])['C2']
    assert interval.upper is None
    assert interval.reason is not None


def test_profile_intervals_agree_with_the_standard_errors_where_the_fit_is_linear() -> None:
    """With much data the likelihood is a parabola."""
    result = fit(campaign(6, 3))
    for name, interval in profile_intervals(result).items():
        estimate = result.parameters[name]
        half = 0.5 * (interval.upper - interval.lower)
        assert half == pytest.approx(1.96 * estimate.std, rel=0.05)
        assert interval.lower < estimate.value < interval.upper


def test_noise_of_the_encoders_is_not_taken_for_speed() -> None:
    """Encoders of 20 um at 200 Hz would make 9 N of force by their differences alone."""
    result = fit(campaign(7, 3, cell=Cell(encoder_noise=2e-5)))
    assert np.all(np.abs(_scores(result, Body())) < 4.0)
    assert result.force_rmse == pytest.approx(0.05, rel=0.1)


def test_an_absent_effect_is_found_absent() -> None:
    """The base model's data leave a yield force of nothing within its error."""
    result = fit(campaign(8, 3), Model(('yield_force',)))
    estimate = result.parameters['F_y']
    assert estimate.value is not None
    assert estimate.value < 0.02


def test_a_hum_is_found_with_its_frequency() -> None:
    """50.3 Hz at 1 kHz, on top of the noise: amplitude and frequency come back."""
    cell = Cell(rate=1000.0, tool_rate=500.0)
    trials = []
    for k, (trial, phases) in enumerate(campaign(10, 2, cell=cell)):
        hum = 0.04 * np.sin(2.0 * np.pi * 50.3 * trial.force.t + k)
        force = Signal(trial.force.t, trial.force.value + hum)
        trials.append((replace(trial, force=force), phases))
    result = fit(trials, Model(('periodic_disturbance',)))
    # The load cell of this record samples; the model's averages over its steps, 0.4 % at 50 Hz.
    assert result.parameters['amplitude'].value == pytest.approx(0.04, rel=0.1)
    assert result.parameters['frequency'].value == pytest.approx(50.3, abs=0.002)
    assert np.all(np.abs(_scores(result, Body())) < 4.0)


def test_yield_force_is_found(bingham) -> None:
    """A Bingham body, integrated by scipy, gives back its four parameters."""
    body = bingham()
    random = np.random.default_rng(0)
    trials = []
    for speed, depth in ((0.002, 0.006), (0.005, 0.010)):
        trial, phases = body.make(push_speed=speed, depth=depth, hold=15.0)
        force = trial.force.value + 0.02 * random.standard_normal(len(trial.force))
        seen = trial.displacement_height
        height = seen.value + 1e-4 * random.standard_normal(len(seen))
        noisy = replace(
            trial,
            force=Signal(trial.force.t, force),
            displacement_height=Signal(seen.t, height),
        )
        trials.append((noisy, phases))
    result = fit(trials, Model(('yield_force',)))
    truth = {'K1': body.K1, 'C1': body.C1, 'C2': body.C2, 'F_y': body.yield_force}
    for name, value in truth.items():
        estimate = result.parameters[name]
        assert abs(estimate.value - value) < 4.0 * estimate.std, name
        assert estimate.std < 5e-3 * value, name
    # A tenth of the largest force is usual.
    end = result.problem.search(result.state, tolerance=1e-6, max_evaluations=3)
    covariance = end.covariance()[:4, :4]
    usual = 0.1 * max(float(trial.force.max()) for trial in result.problem.trials)
    told = {}
    for times in (30.0, 300.0):
        covariance[3, 3] = (times * max(usual, body.yield_force)) ** 2
        told[times] = fitting._estimates(result.problem, end, covariance)['F_y']
    assert told[30.0].value == pytest.approx(body.yield_force, rel=0.02)
    assert told[300.0].value is None
    assert told[300.0].reason is not None
    assert told[300.0].reason.startswith('these trials tell it only to within ')


def test_what_is_about_zero_is_told_well() -> None:
    """Beside its value its error is large."""
    found = fit(campaign(0, 2), Model(('force_drift',)))
    end = found.problem.search(found.state, tolerance=1e-6, max_evaluations=3)
    covariance = end.covariance()[:4, :4]
    name = found.model.names[3]
    covariance[3, 3] = (1e3 * found.theta[3]) ** 2
    told = fitting._estimates(found.problem, end, covariance)[name]
    assert told.std == pytest.approx(1e3 * abs(found.theta[3]))


def test_zeros_and_onsets_are_each_trials_own() -> None:
    """A wrong zero of the load cell and a wrong touch are put right, trial by trial."""
    trials = campaign(9, 2)
    trial, phases = trials[0]
    wrong = replace(
        phases,
        force_zero=phases.force_zero + 0.5,
        contact_height=phases.contact_height + 5e-5,
    )
    result = fit([(trial, wrong), trials[1]])
    right = fit(trials)
    assert result.trials[0].values['force_zero'].value == pytest.approx(
        right.trials[0].values['force_zero'].value - 0.5, abs=0.01
    )
    moved = result.trials[0].values['onset'].value - right.trials[0].values['onset'].value
    # The tool is less deep by what the touch is too high; 5 um is an error of the onset.
    assert moved == pytest.approx(-5e-5, abs=5e-6)
    np.testing.assert_allclose(result.theta, right.theta, atol=2e-3)


def test_a_touch_detected_too_early_is_put_right() -> None:
    """Thirty samples early, in air: no slope of the cost leads from there to the jump."""
    trials = campaign(3, 2, cell=Cell(rate=1000.0, tool_rate=500.0))
    early = [
        (
            trial,
            replace(
                phases,
                t_contact=phases.t_contact - 0.03,
                contact_height=phases.contact_height + 0.03 * phases.push_speed,
            ),
        )
        for trial, phases in trials
    ]
    result = fit(early)
    assert np.all(np.abs(_scores(result, Body())) < 4.0)
    assert not any('set aside (at' in warning for warning in result.warnings)
    assert result.noise.force.std == pytest.approx(0.05, rel=0.1)


def test_a_campaign_without_contact_is_refused() -> None:
    """There is nothing to fit, and the sentence says why."""
    trial, _ = campaign(0, 1)[0]
    nothing = Segmentation(None, None, None, None, 10.0, None, 0.0, None, None)
    with pytest.raises(UsageError, match='no contact'):
        fit([(trial, nothing)])


def test_an_unknown_start_is_refused() -> None:
    """A start for what the model does not have is a mistake."""
    with pytest.raises(UsageError, match="no parameter 'K9'"):
        fit(campaign(0, 1), start={'K9': 1.0})


def test_of_two_valleys_the_one_that_the_height_shows_is_found() -> None:
    """In the force of a quick push both dashpots are one; the height alone tells them apart."""
    made = campaigns.Campaign(
        specimen.Body(1.0, 41.0, 57.0),
        tuple(campaigns.Push(speed, 0.003, 6.0, 4.0) for speed in (0.01, 0.025)),
        campaigns.Sensors(
            campaigns.ForceNoise(0.001, 0.003, 0.01), 2e-5, force_rate=500.0, tool_rate=50.0
        ),
    )
    trials = campaigns.run(made, seed=2).trials
    found = fit([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials])
    # A thousand means scatter by a few hundredths about one.
    assert found.height_chi2 == pytest.approx(1.0, abs=0.3)
    assert not any('misses the height' in warning for warning in found.warnings)


@pytest.mark.parametrize('effects', [{}, {'force_drift': 0.02}, {'inertia': 0.02}], ids=str)
def test_a_simulation_without_noise_is_fitted(effects: dict[str, float]) -> None:
    body = specimen.Body(2000.0, 1600.0, 2400.0)
    pushes = [campaigns.Push(speed, 0.006, 6.0, 4.0) for speed in (0.002, 0.008)]
    quiet = campaigns.Sensors(campaigns.ForceNoise(0.0), 0.0)
    acting = [specimen.Undeclared(name, (value,)) for name, value in effects.items()]
    campaign = campaigns.Campaign(body, tuple(pushes), quiet)
    trials = campaigns.run(campaign, acting, seed=0, ideal=True).trials
    found = fit([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials])
    assert found.noise.force.std > 0.0
    assert found.parameters['K1'].value == pytest.approx(2000.0, rel=0.02)
    if not effects:
        assert found.parameters['C2'].value == pytest.approx(2400.0, rel=1e-3)
        assert found.parameters['C2'].std == pytest.approx(0.0, abs=5.0)


def _memory(seed: int, *effects: specimen.Undeclared) -> Memory:
    """Return what the force without contact tells of the noise in a random campaign."""
    made = campaigns.random_campaign(seed, scatter=0.0, longest=30.0)
    trials = campaigns.run(made, effects, seed=seed).trials
    return fit(
        [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
    ).noise.memory


def test_zeros_of_few_trials_that_wander_alike_do_not_drift() -> None:
    """Two trials whose zeros happen to go the same way: 0.04 N within 16 s."""
    memory = _memory(6008)
    assert 0.02 < memory.wander < 0.08


@pytest.mark.parametrize('drag', ['of the cable', 'of the guide'])
def test_a_zero_that_goes_with_the_tool_in_all_trials_does_not_wander(drag: str) -> None:
    """It would pass for slow noise, behind which whatever goes slowly is hidden."""
    body = specimen.Body(1700.0, 1000.0, 2000.0)
    pushes = tuple(campaigns.Push(speed, 0.004, 4.0, 3.0) for speed in (0.003, 0.008))
    sensors = campaigns.Sensors(campaigns.ForceNoise(0.05), 3e-5, force_rate=100.0)
    made = []
    for trial in campaigns.run(campaigns.Campaign(body, pushes, sensors), seed=3).trials:
        height = np.interp(trial.force.t, trial.tool_height.t, trial.tool_height.value)
        speed = np.gradient(height, trial.force.t)
        extra = 8.0 * height + 2.0 * speed
        if drag == 'of the guide':
            extra = -0.1 * np.tanh(speed / 2e-5)
        force = Signal(trial.force.t, trial.force.value + extra)
        made.append((replace(trial, force=force), segment(force, trial.tool_height, None)))
    memory = fit(made).noise.memory
    assert memory.wander == 0.0
    assert memory.force < 1.0


def test_a_jump_is_uncertain_where_the_force_bends() -> None:
    """By half a sample's step of the slope, over the samples of the mean, and beside it."""
    t = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 7.0, 8.0])
    force = np.array([0.0, 0.0, 4.0, 4.0, 4.0, 4.0])
    count = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 0.0])
    variance = np.full(6, np.nan)
    middle = 0.5 * (t[1:] + t[:-1])
    _jump_variance(force, middle, np.diff(t) / np.maximum(count, 1.0), count, 0.5, variance)
    # Both corners turn the slope by 4.
    assert variance == pytest.approx([1.0, 1.0, 1.0, 0.25, 0.0, 0.0])
    for size in (1, 2):
        _jump_variance(force[:size], middle[:size], count, count[:size], 1.0, variance[:size])
        assert variance[:size].tolist() == [0.0] * size


@pytest.mark.parametrize('blur', [0.09, 0.35, 0.7])
def test_how_well_the_moments_of_jumps_are_known_is_seen(blur: float) -> None:
    """Between the places that are tried, too: what is left over would reward a smoother model."""
    cell = Cell(rate=500.0, force_noise=0.002, hold=2.0, recovery=2.0)
    result = fit(campaign(3, 24, cell=cell))
    old, found = result.problem, list[Blur]()
    for seed in range(6, 27):
        random = np.random.default_rng(seed)
        trials = []
        for index, trial in enumerate(old.trials):
            force = (
                old.predict(result.state, index, directions=False).force
                + old.own(result.state, index)[1]
            )
            variance = _jumps(force, trial, Blur(0.4, blur)) + 0.002**2 / np.maximum(
                trial.force_count, 1.0
            )
            noisy = force + np.sqrt(variance) * random.standard_normal(force.size)
            trials.append(replace(trial, force=noisy))
        noise = SensorNoise(0.002, 1e-9, 0.01)
        problem = Problem(old.model, trials)
        found.append(problem.sharpest(result.state, noise, Blur(1.0, 1.0)))
    # Some ten jumps tell it to a fifth or two; of 21 campaigns the middle one is nearer.
    assert np.median([each.later for each in found]) == pytest.approx(blur, rel=0.2)
    assert np.median([each.touch for each in found]) == pytest.approx(0.4, rel=0.2)


def test_a_touch_is_known_no_better_than_whether_a_reading_is_of_a_moment() -> None:
    """Each trial has a touch of its own to suit the one reading that it falls on."""
    result = fit(campaign(2, 24, cell=Cell(rate=500.0, force_noise=0.002)))
    noise = SensorNoise(0.002, 1e-9, 0.01)
    trials = [
        replace(
            trial,
            force=result.problem.predict(result.state, index, directions=False).force
            + result.problem.own(result.state, index)[1],
        )
        for index, trial in enumerate(result.problem.trials)
    ]
    found = Problem(result.problem.model, trials).sharpest(result.state, noise, Blur(1.0, 1.0))
    assert found.touch == pytest.approx(math.sqrt(1.0 / 12.0))
    assert found.later < 0.1


def _two(seed: int, cell: Cell, speeds: tuple[float, float]) -> list:
    """Return a slow and a quick push."""
    made = [closed_form.record(Body(), cell, speed, 0.006, (seed, 9)) for speed in speeds]
    return [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in made]


def test_error_bars_hold_where_slow_encoders_leave_the_speed_unsure() -> None:
    cell = Cell(
        rate=500.0,
        tool_rate=100.0,
        hold=5.0,
        recovery=3.0,
        force_noise=0.005,
        correlation=0.0,
    )
    scores = [_scores(fit(_two(seed, cell, (0.002, 0.02))), Body()) for seed in range(12)]
    # Of C1, which the quick push tells; 9.8 if the speed is taken for known.
    assert math.sqrt(np.mean(np.square(scores), axis=0)[1]) < 2.0


def test_a_glitch_in_a_push_of_unsure_speed_is_set_aside() -> None:
    cell = Cell(rate=1000.0, tool_rate=250.0, hold=5.0, recovery=3.0, encoder_noise=5e-5)
    pairs = _two(0, replace(cell, force_noise=0.1), (0.01, 0.01))
    trial, phases = pairs[0]
    value = trial.force.value.copy()
    first = int(np.searchsorted(trial.force.t, phases.t_contact + 0.3))
    value[first:][:40] += 1.5
    pairs[0] = replace(trial, force=Signal(trial.force.t, value)), phases
    result = fit(pairs)
    assert 38 <= result.trials[0].set_aside.size <= 44
    # The push is told sample by sample.
    inside = result.trials[1].force.between(phases.t_contact, phases.t_hold)
    assert len(inside) > 500


def test_a_touch_that_is_misplaced_is_found_to_a_part_of_a_samples_way() -> None:
    """The tool goes 4 and 10 um from sample to sample; the detection is known to 200 um."""
    cell = Cell(rate=500.0, force_noise=0.0005, hold=2.0, recovery=2.0)
    result = fit(campaign(3, 2, cell=cell))
    model = result.problem.model
    problem = Problem(model, [replace(trial, onset_std=2e-4) for trial in result.problem.trials])
    places = [place.start for place in problem.places]
    state = result.state.copy()
    state[places] += 4e-5
    assert replace_onsets(problem, state, SensorNoise(0.0005, 1e-9, 0.01), Blur(0.0625, 0.0625))
    np.testing.assert_allclose(state[places], result.state[places], atol=1e-6)


def test_a_slow_body_is_found_though_slow_encoders_make_its_force_jump() -> None:
    """It relaxes in 61 s; what jumps where the path is not well known relaxes in 30 ms."""
    body = specimen.Body(8.0, 210.0, 280.0)
    pushes = tuple(campaigns.Push(0.0014, depth, 12.0, 7.5) for depth in (0.0022, 0.0009, 0.0022))
    sensors = campaigns.Sensors(
        campaigns.ForceNoise(0.001), 1.5e-5, force_rate=1000.0, tool_rate=50.0
    )
    made = campaigns.Campaign(body, pushes, sensors, scatter=0.02)
    trials = campaigns.run(made, seed=1).trials
    result = fit([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials])
    for name in ('K1', 'C1', 'C2'):
        assert result.parameters[name].value == pytest.approx(getattr(body, name), rel=0.05)


@pytest.mark.parametrize(
    ('body', 'swing'),
    [
        (specimen.Body(2100.0, 12_200.0, 84_000.0), 0.0008),
        (specimen.Body(608.0, 156.0, 326.0), 0.0075),
    ],
    ids=['slow', 'quick'],
)
def test_a_tool_that_leaves_the_object_and_comes_again_tells_it(
    body: specimen.Body, swing: float
) -> None:
    """Taken for a contact that lasts, the force of the air would have been that of the object."""
    pushes = tuple(
        campaigns.Push(speed, depth, 5.0, 4.0, swings=4, swing=swing)
        for speed, depth in ((0.001, 0.0015), (0.002, 0.006), (0.004, 0.003))
    )
    sensors = campaigns.Sensors(campaigns.ForceNoise(0.005), 3e-5)
    cell = campaigns.Campaign(body, pushes, sensors)
    ran = campaigns.run(cell, [], seed=4)
    pairs = [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in ran.trials]
    result = fit(pairs)
    found = np.exp(result.theta[:3])
    assert found == pytest.approx([body.K1, body.C1, body.C2], rel=0.01)
    assert result.noise.force.std == pytest.approx(0.005, rel=0.1)


def _led(
    body: specimen.Body, t: np.ndarray, depth: np.ndarray, noise: float, seed: int
) -> tuple[Signal, ...]:
    """Return force, tool height and displacement height of a tool led along a path."""
    random = np.random.default_rng(seed)
    speed = np.gradient(depth, t)
    way = np.concatenate(([0.0], np.cumsum(0.5e-3 * (speed[1:] + speed[:-1])))) + depth[0]
    motion = specimen.Motion(t, way, speed, np.append(np.diff(speed) / 1e-3, 0.0))
    step = 4e-3
    count = int(t[-1] / step) - 25
    first = random.uniform(0.5, 1.5) * step
    history = specimen.integrate(
        first + step * (np.arange(10 * count + 1) / 10.0 - 0.5),
        motion,
        specimen.parameter_vector(body, ()),
        surface_offset=0.0,
        reference_depth=0.006,
        campaign_time=0.0,
        stretched=0.0,
    )
    passed = np.concatenate(([0.0], np.cumsum(history.force * np.diff(history.t))))
    at = first + step * np.arange(count)
    ends = (np.interp(at + side * step, history.t, passed) for side in (0.5, -0.5))
    force = (next(ends) - next(ends)) / step + noise * random.standard_normal(count)
    tool_t = random.uniform(0.0, 0.016) + 0.016 * np.arange(count // 4)
    tool = 0.04 - motion.at(tool_t)[0] + 1e-6 * random.standard_normal(tool_t.size)
    height_t = random.uniform(0.0, 0.05) + 0.05 * np.arange(int(0.08 * count) - 1)
    height = np.interp(height_t, history.t, history.surface)
    return (
        Signal(at, force),
        Signal(tool_t, 1e-6 * np.round(tool / 1e-6)),
        Signal(height_t, height + 1e-5 * random.standard_normal(height_t.size)),
    )


def _swung(body: specimen.Body, frequency: float, reach: float, seed: int) -> tuple[Signal, ...]:
    """Return the signals of a tool led along a sine."""
    t = np.arange(0.0, 14.0, 1e-3)
    swinging = (t >= 1.0) & (t <= 11.0)
    sine = 1.0 - np.cos(2.0 * math.pi * frequency * (t - 1.0))
    return _led(body, t, np.where(swinging, reach * sine, 0.0) - 2e-3, 0.02, seed)


@pytest.mark.parametrize(
    ('body', 'ways'),
    [
        (specimen.Body(1000.0, 1500.0, 3000.0), ((0.5, 3e-3), (1.0, 2e-3), (0.5, 2e-3))),
        (specimen.Body(1385.0, 7717.0, 7716.0), ((0.2, 2e-3),)),
    ],
    ids=['quick', 'slow'],
)
def test_a_tool_that_comes_and_goes_along_a_sine_tells_the_object(
    body: specimen.Body, ways: Sequence[tuple[float, float]]
) -> None:
    """When it meets the object again hangs on all that went before."""
    pairs = []
    for number, (frequency, reach) in enumerate(ways):
        signals = _swung(body, frequency, reach, 3 + number)
        trial = Trial(f's{number}', number * 10**11, *signals)
        pairs.append((trial, segment(*signals)))
    # Sines tell nothing of how an arm stops, and take long to be asked for it.
    prepared, _ = prepare(pairs, servo=None)
    result = fit_prepared(prepared, Model())
    assert np.exp(result.theta[:3]) == pytest.approx([body.K1, body.C1, body.C2], rel=0.01)
    assert result.noise.force.std == pytest.approx(0.02, rel=0.1)


def _prepared(
    campaign: campaigns.Campaign, seed: int, acting: Sequence[specimen.Undeclared] = ()
) -> list[FitTrial]:
    """Return what is fitted of a campaign."""
    ran = campaigns.run(campaign, list(acting), seed=seed)
    made, _ = prepare(
        [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in ran.trials]
    )
    return [trial for trial in made if trial is not None]


def _to_and_fro(body: specimen.Body, share: float, swings: int) -> list[FitTrial]:
    """Return trials of a tool that goes back by a share of its way, and down again, and again."""
    pushes = tuple(
        campaigns.Push(speed, depth, 6.0, 4.0, swings=swings, swing=share * depth)
        for speed, depth in ((0.002, 0.0018), (0.008, 0.0045), (0.002, 0.0032))
    )
    noise = 0.002 * campaigns.peak_force(
        campaigns.Campaign(body, pushes, campaigns.Sensors(campaigns.ForceNoise(0.0), 0.0))
    )
    sensors = campaigns.Sensors(campaigns.ForceNoise(noise), 2e-5)
    return _prepared(campaigns.Campaign(body, pushes, sensors), 4)


@pytest.mark.parametrize(
    ('body', 'share', 'swings'),
    [
        (specimen.Body(1690.0, 14_500.0, 10_300.0), 0.65, 3),
        (specimen.Body(1690.0, 14_500.0, 10_300.0), 0.95, 1),
        (specimen.Body(378.0, 1192.0, 1822.0), 1.0, 4),
    ],
)
def test_a_tool_that_goes_to_and_fro_on_the_object_tells_it(
    body: specimen.Body, share: float, swings: int
) -> None:
    result = fit_prepared(_to_and_fro(body, share, swings), Model())
    off = result.theta[:3] - np.log([body.K1, body.C1, body.C2])
    errors = np.sqrt(np.diag(result.covariance)[:3])
    assert np.all(np.abs(off) < 4.0 * errors)
    assert errors.max() < 0.02


@pytest.mark.parametrize('share', [0.34, 0.4])
def test_the_first_search_is_not_led_astray_by_noise_with_a_memory(share: float) -> None:
    """The tool leaves the object three times in each of two trials, deep and shallow."""
    drawn = campaigns.random_campaign(41110, longest=30.0)
    pushes = tuple(replace(push, swings=3, swing=share * push.depth) for push in drawn.pushes)
    result = fit_prepared(_prepared(replace(drawn, pushes=pushes), 41110), Model())
    off = result.theta[:3] - np.log([drawn.body.K1, drawn.body.C1, drawn.body.C2])
    errors = np.sqrt(np.diag(result.covariance)[:3])
    assert np.all(np.abs(off) < 4.0 * errors)
    assert errors.max() < 0.01


def test_a_base_fit_goes_on_where_it_lacks_what_acts(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the object is touched again is off by what is lacking, and valleys are many."""
    body = specimen.Body(3000.0, 1500.0, 4900.0)
    pushes = tuple(
        campaigns.Push(speed, depth, 6.0, 4.0, swings=3, swing=0.95 * depth)
        for speed, depth in ((0.002, 0.0018), (0.008, 0.0046), (0.002, 0.0032), (0.008, 0.0032))
    )
    sensors = campaigns.Sensors(campaigns.ForceNoise(0.0, 0.08, 0.008), 2e-5)
    campaign = campaigns.Campaign(body, pushes, sensors)
    deeper = []
    for threshold, seed in ((0.13, 1), (0.13, 2), (0.2, 1)):
        made = _prepared(campaign, seed, [specimen.Undeclared('yield_force', (threshold,))])
        found = fit_prepared(made, Model())
        with monkeypatch.context() as patch:
            patch.setattr(Problem, 'search_on', lambda _, found: found)
            stuck = fit_prepared(made, Model())
        deeper.append(stuck.deviance - found.deviance)
    # It is 122, 203 and 510 deeper.
    assert min(deeper) > -10.0
    assert sum(deeper) > 300.0


@pytest.mark.parametrize('beside', [(0.3, 0.1, -0.1), (-0.2, 0.2, 0.2)])
def test_a_search_that_ends_before_a_jump_has_passed_all_samples_goes_on(
    beside: tuple[float, float, float],
) -> None:
    """Beside noise with a memory each sample that the jump passes makes a valley."""
    body = specimen.Body(378.0, 1192.0, 1822.0)
    result = fit_prepared(_to_and_fro(body, 1.0, 4), Model())
    problem, begin = result.problem, result.state.copy()
    part = math.sqrt(0.5) * result.noise.force.std
    problem.set_noise(SensorNoise(part, part, 0.04), result.noise.height)
    least = problem.search(begin, tolerance=1e-7).cost
    begin[:3] += beside
    stuck = problem.search(begin, tolerance=1e-7)
    assert stuck.cost > least + 100.0
    weighed = problem.log_determinant
    again = problem.search_on(stuck)
    assert again.cost == pytest.approx(least, abs=1.0)
    # It is all the way down, beside the noise that it was asked for.
    assert problem.search(again.theta, tolerance=1e-7).cost == pytest.approx(again.cost, rel=1e-6)
    residual, _ = problem.evaluate(again.theta)
    assert float(residual @ residual) == pytest.approx(again.cost, rel=1e-9)
    assert problem.log_determinant == weighed


def test_an_object_that_comes_after_a_tool_at_rest_is_told_beside_slow_noise() -> None:
    """A tool that goes back slowly loses the object, which meets it again where it rests."""
    body = specimen.Body(157.0, 940.0, 940.0)
    pairs = []
    for number, speed in enumerate((1e-3, 2e-3, 4e-3)):
        down = 1.0 + 8e-3 / speed
        knots = np.cumsum([down, 4.0, 10.0, 3.0, 1.2, 4.0])
        ways = [-2e-3, -2e-3, 6e-3, 6e-3, 5.2e-3, 5.2e-3, -2e-3, -2e-3]
        t = np.arange(0.0, knots[-1], 1e-3)
        depth = np.interp(t, [0.0, 1.0, *knots], ways)
        force, *others = _led(body, t, depth, 0.0, 10 + number)
        random = np.random.default_rng(10 + number)
        noise = np.zeros(force.t.size)
        for memory in np.geomspace(0.006, 8.0, 8):
            kept = math.exp(-0.004 / memory)
            new = random.standard_normal(force.t.size + 4000) * math.sqrt(1.0 - kept**2)
            noise += 0.0056 * lfilter([1.0], [1.0, -kept], new)[4000:]
        signals = (Signal(force.t, force.value + noise), *others)
        pairs.append((Trial(f's{number}', number * 10**11, *signals), segment(*signals)))
    prepared, _ = prepare(pairs)
    result = fit_prepared(prepared, Model())
    off = result.theta[:3] - np.log([body.K1, body.C1, body.C2])
    assert np.all(np.abs(off) < 4.0 * np.sqrt(np.diag(result.covariance)[:3]))
    assert np.abs(off).max() < 0.02


def test_what_touches_once_is_not_searched_on(monkeypatch: pytest.MonkeyPatch) -> None:
    result = fit(campaign(1, 2))
    monkeypatch.delattr(Problem, 'set_noise')
    found = result.problem.search(result.state, tolerance=1e-7)
    assert result.problem.search_on(found) is found


@pytest.mark.parametrize('lost', [True, False])
def test_the_body_that_most_trials_tell_is_a_start_where_all_together_mislead(
    lost: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    trials, _ = prepare(campaign(1, 3))
    begun: list[list[float]] = []
    ended, identify = fitting._ended, fitting.identify

    def mislead(some: Sequence[FitTrial], noise: float) -> ThreeElement:
        body = identify(some, noise)
        return body if len(some) == 1 or not lost else replace(body, K1=30.0 * body.K1)

    def stuck(problem: Problem, values: Mapping[str, float], *noises: SensorNoise) -> Any:
        begun.append(list(values.values()))
        end = ended(problem, values, *noises)
        return end._replace(squares=1e3 * end.squares) if lost else end

    monkeypatch.setattr(fitting, '_ended', stuck)
    monkeypatch.setattr(fitting, 'identify', mislead)
    fit_prepared(trials, Model())
    each = [identify([trial], 0.01) for trial in trials if trial is not None]
    own = np.median([(body.K1, body.C1, body.C2) for body in each], axis=0)
    tried = [values for values in begun if values == pytest.approx(own, rel=0.2)]
    assert len(tried) == 1
    # All together tell it as well where they are not misled.
    assert (begun[0] in tried) is not lost


def test_what_a_model_lacks_does_not_move_a_touch_that_jumps() -> None:
    """The force of a viscous body jumps by a hundred times its noise where the tool touches."""
    body = specimen.Body(1.5e5, 3.7e5, 5.1e5)
    pushes = tuple(campaigns.Push(1e-4, d, 2.0, 2.0) for d in (7.5e-4, 1.5e-3, 7.5e-4, 1.5e-3))
    sensors = campaigns.Sensors(
        campaigns.ForceNoise(0.1), 7e-6, force_rate=1000.0, tool_rate=200.0, height_rate=20.0
    )
    made = campaigns.Campaign(body, pushes, sensors)
    acting = strengths.undeclared('parallel_spring', 0.5, made)
    trials = campaigns.run(made, [acting], seed=1).trials
    result = fit([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials])
    for trial, place in zip(result.problem.trials, result.problem.places, strict=True):
        full = trial.full_rate
        first = int(np.argmax(full.displacement[1:] > -result.state[place.start]))
        jump = int(np.argmax(full.force > 20.0))
        # Four samples off, and its moment taken for unsure by as much, the spring made up for it.
        assert abs(first - jump) <= 1
    assert result.noise.blur.touch == 1.0
