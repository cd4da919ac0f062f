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
"""Where the range of a load cell ends."""

from dataclasses import replace
import math

from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.held_out import predict_unseen, Trained
from hapticvision_ros.core.fit.saturation import at_the_end, end_of_range
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body
import numpy as np
import pytest

T = np.linspace(0.0, 20.0, 4001)
FORCE = 8.0 * np.interp(T, [0.0, 4.0, 6.0, 15.0, 15.5, 20.0], [0.0, 0.0, 1.0, 0.6, 0.0, 0.0])
"""A push, a hold that relaxes, and a release."""
NOISE = np.random.default_rng(1).standard_normal(T.size)


def test_readings_that_stay_at_their_greatest_are_its_end() -> None:
    assert end_of_range([FORCE + 0.01 * NOISE]) == math.inf
    assert end_of_range([np.minimum(FORCE + 0.01 * NOISE, 6.5)]) == 6.5
    assert end_of_range([FORCE[:800], np.minimum(FORCE + 0.01 * NOISE, 6.5)]) == 6.5


def test_a_few_that_chance_to_be_alike_are_none() -> None:
    once = FORCE + 0.01 * NOISE
    at = int(np.argmax(once))
    once[slice(at, at + 9)] = once[at]
    assert end_of_range([once]) == math.inf


@pytest.mark.parametrize('noise', [0.0, 0.01, 0.05, 0.2])
def test_a_cell_that_rounds_stays_at_its_greatest_by_itself(noise: float) -> None:
    held = np.minimum(FORCE, 7.5)
    assert end_of_range([0.1 * np.round((held + noise * NOISE) / 0.1)]) == math.inf


def test_the_end_is_seen_through_readings_that_round() -> None:
    rounded = 0.02 * np.round((FORCE + 0.05 * NOISE) / 0.02)
    assert end_of_range([np.minimum(rounded, 6.5)]) == 6.5


def test_readings_that_only_their_noise_keeps_below_the_end_are_no_measurement() -> None:
    noisy = np.full(400, 6.5) + 0.05 * NOISE[:400]
    rising = np.linspace(0.0, 6.5, 400) + 0.05 * NOISE[400:800]
    ended = at_the_end(np.minimum(np.concatenate((rising, noisy)), 6.5), 6.5)
    assert ended[400:].mean() > 0.99
    assert not ended[:370].any()
    assert not at_the_end(rising, math.inf).any()


BODY = Body(1500.0, 1200.0, 3000.0)
CAMPAIGN = Campaign(
    BODY,
    (Push(0.008, 0.006, 3.0, 2.0), Push(0.004, 0.004, 3.0, 2.0), Push(0.006, 0.006, 3.0, 2.0)),
    Sensors(ForceNoise(0.05), 3e-5, force_rate=100.0, tool_rate=100.0, height_rate=20.0),
)


def _saturated(trial: Trial) -> Trial:
    force = trial.force
    return replace(trial, force=Signal(force.t, np.minimum(force.value, 5.0)))


def test_what_a_saturated_cell_reads_is_told_and_bends_nothing() -> None:
    trials = [analyse(_saturated(trial)) for trial in run(CAMPAIGN, seed=1).trials]
    found = diagnose(trials)
    # Nothing acts, and no effect stands in for the end of the range.
    assert (found.status, found.effects) == ('unexplained', ())
    assert found.unexplained is not None
    assert "end of the load cell's range" in found.unexplained.where[0]
    assert sum('reads no more than 5 N' in each for each in found.before.warnings) == 3
    for name, true in zip(('K1', 'C1', 'C2'), (BODY.K1, BODY.C1, BODY.C2), strict=True):
        assert found.before.parameters[name].value == pytest.approx(true, rel=0.02)


def test_the_end_is_known_in_trials_that_the_fit_has_not_seen() -> None:
    *trained, unseen = [analyse(_saturated(trial)) for trial in run(CAMPAIGN, seed=2).trials]
    # Of this one too little is recorded there to tell it.
    force = unseen.trial.force
    kept = (force.value < 5.0) | (np.cumsum(force.value >= 5.0) < 5)
    left = replace(unseen.trial, force=Signal(force.t[kept], force.value[kept]))
    assert end_of_range([left.force.value]) == math.inf
    known = Trained.of(fit(trained), trained)
    assert known.range_end == 5.0
    (warning,) = predict_unseen(known, [analyse(left)]).warnings
    assert 'end of its range' in warning


def test_a_glitch_above_the_end_hides_nothing() -> None:
    trials = []
    for trial in run(CAMPAIGN, seed=1).trials:
        value = np.minimum(trial.force.value, 5.0)
        value[50] = 60.0
        trials.append(analyse(replace(trial, force=Signal(trial.force.t, value))))
    found = fit(trials)
    assert sum('reads no more than 5 N' in each for each in found.warnings) == 3
    assert found.parameters['K1'].value == pytest.approx(BODY.K1, rel=0.02)


def test_one_trial_may_have_another_range() -> None:
    whole = run(CAMPAIGN, seed=1).trials
    trials = [analyse(_saturated(whole[0])), *map(analyse, whole[1:])]
    found = fit(trials)
    (warning,) = found.warnings
    assert warning.startswith(f'{whole[0].name}: the load cell reads no more than 5 N')
    known = Trained.of(fit(trials[:1]), trials[:1])
    assert known.range_end == 5.0
    assert predict_unseen(known, trials[1:]).warnings == ()


def test_a_force_without_noise_that_is_held_is_no_end() -> None:
    """As of a spring in a simulation, with hardly anything of it in the air."""
    ways = np.zeros(40), np.linspace(0.0, 5.0, 400), np.full(600, 5.0), np.linspace(5.0, 0.0, 400)
    assert end_of_range([1e-3 * np.round(np.concatenate(ways) / 1e-3)]) == math.inf


def test_few_readings_are_judged_as_well() -> None:
    few = np.array([0.0, 0.1, 0.0, 1.0, 1.0, 1.0, 1.0])
    assert at_the_end(few, 1.0).tolist() == [False] * 3 + [True] * 4
