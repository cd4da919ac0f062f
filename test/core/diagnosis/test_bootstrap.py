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


"""What chance does in campaigns that a fitted model makes."""

from dataclasses import replace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis import bootstrap as simulation
from hapticvision_ros.core.diagnosis import search
from hapticvision_ros.core.diagnosis.bootstrap import (
    bootstrap,
    sensor_noise,
    simulated,
    trial_noise,
)
from hapticvision_ros.core.diagnosis.records import Candidate, Diagnosis
from hapticvision_ros.core.diagnosis.refit import Workbench
from hapticvision_ros.core.diagnosis.search import choose_again
from hapticvision_ros.core.diagnosis.selection import select
from hapticvision_ros.core.fit.campaign import fit_prepared, height_blocks
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest

EFFECTS = ('yield_force', 'parallel_spring', 'friction')
SHORT = ((0.004, 0.006), (0.012, 0.004))
NONE = np.empty(0)


def diagnosed(measured: Any) -> Diagnosis:
    """Return a diagnosis among a few effects."""
    prepared, _ = prepare(measured.pairs)
    fit = fit_prepared(prepared, Model())
    bench = Workbench(fit.problem.trials, None)
    _, rounds = select(bench, bench.base(fit), EFFECTS)
    first = rounds[0]
    return Diagnosis(
        status='explained' if first.alike else 'none',
        effects=first.alike[:1],
        sets=(first.alike,) if first.alike else (),
        not_testable=(),
        look_alikes=(),
        ranking=tuple(
            Candidate(c.effect, c.score, c.gain, None, c.strength) for c in first.candidates
        ),
        unexplained=None,
        next_trial=None,
        before=fit,
        after=fit,
        warnings=(),
    )


def small(world: Any, *effects: Undeclared, seed: int) -> Any:
    """Return a small campaign."""
    campaign = world.campaign(SHORT, hold=1.0, recover=1.0, rate=100.0)
    return world.measure(campaign, *effects, seed=seed)


def test_noise_has_its_level_and_its_memory_at_uneven_times() -> None:
    random = np.random.default_rng(0)
    noise = SensorNoise(0.3, 0.4, 0.05)
    t = np.cumsum(np.tile([0.01, 0.01, 0.03], 40_000))
    value = sensor_noise(t, noise, random)
    # Some 30 000 independent pieces tell a variance to within one percent.
    assert np.std(value) == pytest.approx(0.5, rel=0.03)
    for first, gap in ((0, 0.01), (1, 0.03)):
        pairs = value[first::3] * np.roll(value, -1)[first::3]
        assert np.mean(pairs[:-1]) == pytest.approx(0.16 * np.exp(-gap / 0.05), rel=0.05)


def test_simulated_campaigns_are_white_beside_the_noise_that_they_were_made_with(
    noise_only: Any,
) -> None:
    bench, base = noise_only.bench()
    assert max(trial.force_count.max() for trial in bench.trials) > 3.0
    random = np.random.default_rng(0)
    squares, lagged, count = 0.0, 0.0, 0
    for _ in range(20):
        made = Workbench(simulated(base, NONE, random), None, bench.memory)
        whiteners = made.whiteners(base.force_noise, base.height_noise, base.jumps)
        for index, (force_filter, height_filter) in enumerate(whiteners):
            assert height_filter is not None
            force, height = made.residual(base.problem, base.state, index)
            for white in (
                force_filter(force[np.newaxis])[0],
                height_filter(height[np.newaxis])[0],
            ):
                squares += float(white @ white)
                lagged += float(white[1:] @ white[:-1])
                count += white.size
    # Means of samples included: a chi squared, and products of neighbours, within four errors.
    assert squares / count == pytest.approx(1.0, abs=4.0 * np.sqrt(2.0 / count))
    assert lagged / count == pytest.approx(0.0, abs=4.0 * np.sqrt(1.0 / count))


def test_scattering_trials_differ_by_their_scatter(noise_only: Any) -> None:
    _, base = noise_only.bench()
    spans = []
    for seed in range(5):
        made = simulated(base, np.array([0.1, 0.0, 0.0]), np.random.default_rng(seed))
        alike = simulated(base, NONE, np.random.default_rng(seed))
        peaks = [one.peak_force / other.peak_force for one, other in zip(made, alike, strict=True)]
        spans.append(np.ptp(peaks))
    # A tenth of K1 is a few percent of the largest force.
    assert np.mean(spans) > 0.02


def test_chance_does_what_a_campaign_without_effect_shows(world: Any) -> None:
    measured = small(world, seed=1)
    told = list[str]()
    found = bootstrap(diagnosed(measured), measured.phases, 7, progress=told.append)
    assert found.campaigns == 7
    assert found.p_value > 0.2
    assert told == [f'bootstrap {number} of 7' for number in range(1, 8)]


def test_chance_does_not_do_what_a_clear_effect_does(world: Any) -> None:
    measured = small(world, Undeclared('yield_force', (0.5,)), seed=2)
    diagnosis = diagnosed(measured)
    assert diagnosis.effects
    found = bootstrap(diagnosis, measured.phases, 7)
    assert found.p_value == pytest.approx(1.0 / 8.0)
    assert found.false_alarms <= 1


def test_what_was_said_of_the_stamps_and_of_laws_holds_for_the_choice_made_anew(
    world: Any,
) -> None:
    measured = small(world, Undeclared('friction', (0.5,)), seed=3)
    diagnosis = diagnosed(measured)
    first = diagnosis.ranking[0]
    late = replace(first, effect='arm_clock_offset')
    named = replace(
        diagnosis,
        ranking=(late, *diagnosis.ranking),
        laws=('friction:held',),
        contenders=(('friction:held', 'yield_force'),),
    )
    tried = set[str]()

    def listening(bench: Any, base: Any, names: Any, **options: Any) -> Any:
        tried.update(names)
        return select(bench, base, names, **options)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulation, 'select', listening)
        bootstrap(named, measured.phases, 1)
        assert 'friction:held' in tried
        assert 'arm_clock_offset' not in tried
        tried.clear()
        patch.setattr(search, 'select', listening)
        again = choose_again(named, {named.before.problem.trials[0].name})
        assert again is not None
        assert tried == {'friction:held', 'yield_force'}


def test_simulated_heights_have_what_stamps_that_are_off_make_of_them(noise_only: Any) -> None:
    bench, base = noise_only.bench()
    trial = replace(bench.trials[0], height_jitter=0.02)
    extra = height_blocks(trial).extra
    fast = extra > 4.0 * base.height_noise.std**2
    assert np.count_nonzero(fast) > 5
    random = np.random.default_rng(3)
    drawn = [trial_noise(trial, base, base.jumps[0], random).height for _ in range(200)]
    squares = np.mean(np.square(drawn), axis=0)
    assert np.mean((squares / (extra + base.height_noise.std**2))[fast]) == pytest.approx(
        1.0, abs=0.1
    )
    # Nothing moves the surface before the touch, and no tool does so after the release.
    assert trial.t_release is not None
    assert not extra[trial.height_t < trial.t_contact - trial.height_interval].any()
    assert not extra[trial.height_t > trial.t_release].any()
