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


"""How trials differ among themselves, from repeats of the same push."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

from hapticvision_ros.core.diagnosis.refit import Workbench
from hapticvision_ros.core.diagnosis.scatter import (
    _at_once,
    _block,
    _common,
    apart,
    Block,
    conditions,
    LEAST,
    measure,
    pushed_apart,
    Scatter,
)
from hapticvision_ros.core.fit import held_out
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.records import Segmentation
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import peak_force, random_campaign, run
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest

PUSHES = ((0.004, 0.006), (0.012, 0.004)) * 4
"""Two pushes, four times each."""


def pooled(values: Any) -> float:
    """Return the standard deviation of three elements between repeats of the two pushes."""
    away = np.concatenate([values[k::2] - values[k::2].mean(axis=0) for k in range(2)])
    return float(np.sqrt(np.sum(away**2) / (3 * (len(values) - 2))))


def logarithms(measured: Any) -> Any:
    """Return the logarithms of K1, C1 and C2 of each trial, shape (trials, 3)."""
    return np.log([[body.K1, body.C1, body.C2] for body in measured.truth.bodies])


@pytest.fixture(scope='module')
def repeated(world: Any) -> Callable[..., Any]:
    """Return a maker of eight trials, and of the scatter that is measured in them."""

    @cache
    def make(
        *effects: Undeclared, scatter: float = 0.0, seed: int = 1, noise: float = 1.0
    ) -> tuple[Any, Scatter]:
        campaign = world.campaign(PUSHES, hold=3.0, recover=2.0, rate=100.0, scatter=scatter)
        quiet = campaign.sensors
        force = replace(
            quiet.force_noise,
            white=noise * quiet.force_noise.white,
            coloured=noise * quiet.force_noise.coloured,
        )
        sensors = replace(quiet, force_noise=force, height_noise=noise * quiet.height_noise)
        measured = world.measure(replace(campaign, sensors=sensors), *effects, seed=seed)
        found = measure(measured.bench()[1], conditions(measured.phases))
        assert found is not None
        return measured, found

    return make


def phases(speed: float | None, depth: float | None, hold: float | None) -> Segmentation:
    """Return what a push looks like."""
    return Segmentation(
        t_contact=1.0,
        t_hold=3.0,
        t_release=None if hold is None else 3.0 + hold,
        t_loss=None,
        t_end=30.0,
        contact_height=0.04,
        force_zero=0.0,
        push_speed=speed,
        depth=depth,
    )


def test_repeats_that_withdraw_otherwise_are_compared_until_then(world: Any) -> None:
    """An object that sticks to the tool makes another force of each withdrawal."""
    campaign = world.campaign(PUSHES, hold=3.0, recover=2.0, rate=100.0)
    speeds = np.random.default_rng(8).uniform(0.0005, 0.004, len(campaign.pushes))
    pushes = tuple(
        replace(push, release_speed=float(speed))
        for push, speed in zip(campaign.pushes, speeds, strict=True)
    )
    force = peak_force(campaign)
    sticky = Undeclared('adhesion', (0.15 * force,))
    for scatter in (0.0, 0.02):
        made = replace(campaign, pushes=pushes, scatter=scatter)
        clean, stuck = (
            measure(measured.bench()[1], conditions(measured.phases))
            for measured in (world.measure(made, seed=1), world.measure(made, sticky, seed=1))
        )
        assert clean is not None
        assert stuck is not None
        # Much less than what so few repeats leave open; to the end they would differ by a tenth.
        assert np.all(np.abs(stuck.std - clean.std) < 0.05 * clean.cautious)
    assert float(np.sqrt(np.mean(stuck.std**2))) == pytest.approx(
        pooled(logarithms(world.measure(made, sticky, seed=1))), rel=0.15
    )


def test_repeats_are_pushes_of_the_same_speed_depth_and_hold() -> None:
    trials = [
        phases(0.004, 0.006, 10.0),
        phases(0.008, 0.006, 10.0),
        phases(0.00404, 0.00598, 10.1),
        phases(0.004, 0.003, 10.0),
        phases(0.004, 0.006, 20.0),
        phases(0.008, 0.006, 10.0),
    ]
    assert conditions(trials) == [[0, 2], [1, 5], [3], [4]]


def test_a_push_without_a_release_repeats_only_one_without() -> None:
    trials = [phases(0.004, 0.006, 10.0), phases(0.004, 0.006, None), phases(0.004, 0.006, None)]
    assert conditions(trials) == [[0], [1, 2]]
    assert conditions([phases(None, None, None), phases(None, None, None)]) == [[0, 1]]
    assert conditions([]) == []


def test_a_push_that_never_ends_repeats_only_one_as_deep() -> None:
    ramp = replace(phases(0.004, None, None), t_hold=None, t_release=None, t_contact=1.0)
    trials = [replace(ramp, t_end=end) for end in (3.0, 5.0, 3.02)]
    assert [trial.reach for trial in trials[:2]] == [0.008, 0.016]
    assert phases(0.004, None, 10.0).reach is None
    assert conditions(trials) == [[0, 2], [1]]
    assert held_out.conditions([(None, trial) for trial in trials]) == ((0, 2), (1,))


def test_pushes_that_differ_in_how_deep_they_come_differ_in_depth() -> None:
    trials = [phases(0.004, depth, 10.0) for depth in (0.006, 0.006, 0.012, 0.012)]
    assert pushed_apart(trials, [0.0, 60.0, 120.0, 180.0], Block(0, 1, 0.1, 0.0)) == ('depth',)


def test_a_push_in_steps_repeats_no_other_than_one_of_the_same_steps() -> None:
    straight = phases(0.004, 0.006, 10.0)
    # First rests after 0.5 s and 1 s, of pushes that have their depth after two; and after four.
    first, again = replace(straight, t_first=1.5), replace(straight, t_first=1.51)
    other, later = replace(straight, t_first=2.0), replace(first, t_hold=5.0, t_release=15.0)
    assert conditions([straight, first, again, other, later]) == [[0], [1, 2], [3], [4]]


def test_without_repeats_no_scatter_is_measured(noise_only: Any) -> None:
    _, base = noise_only.bench()
    assert measure(base, conditions(noise_only.phases)) is None


@pytest.mark.parametrize('seed', [1, 2])
def test_scatter_is_measured_as_large_as_it_happened(repeated: Any, seed: int) -> None:
    measured, scatter = repeated(scatter=0.03, seed=seed)
    assert scatter.degrees == 6
    size = float(np.sqrt(np.mean(scatter.std**2)))
    # What a trial alone tells of each element is some tenths of a percent: in squares little
    # beside the three percent that happened, which is taken from the bodies themselves.
    assert size == pytest.approx(pooled(logarithms(measured)), rel=0.15)
    assert np.all(scatter.cautious > scatter.std)


def test_scatter_in_one_element_is_told_from_that_in_others(repeated: Any) -> None:
    measured, scatter = repeated(scatter=0.03, seed=1)
    happened = logarithms(measured)
    each = np.array([pooled(np.tile(happened[:, [k]], 3)) for k in range(3)])
    assert np.argmax(scatter.std) == np.argmax(each)
    assert np.argmin(scatter.std) == np.argmin(each)


def test_what_the_noise_makes_of_repeats_is_no_scatter(repeated: Any) -> None:
    shares = []
    for seed in (3, 4):
        measured, scatter = repeated(seed=seed, noise=8.0)
        alone = [np.diag(fit([pair]).covariance)[:3] for pair in measured.pairs[:2]]
        shares.append(np.mean(scatter.std**2) / np.mean(alone))
    # Taken for scatter it would be the whole of it, to a quarter.
    assert np.mean(shares) < 0.5


def test_repeats_that_are_alike_show_next_to_none(repeated: Any) -> None:
    _, scatter = repeated(seed=3)
    assert scatter.std.max() < 0.005
    assert scatter.std.max() == 0.0 or scatter.std.max() >= LEAST


def test_a_missing_effect_is_no_scatter_as_it_misses_repeats_alike(repeated: Any) -> None:
    _, scatter = repeated(Undeclared('yield_force', (0.5,)), seed=4)
    # Two pushes are bent by five to twenty percent each.
    assert scatter.std.max() < 0.01


def test_a_change_over_the_campaign_is_no_scatter(repeated: Any) -> None:
    measured, scatter = repeated(Undeclared('ageing', (1.0,)), seed=5)
    starts = np.array([trial.start_ns * 1e-9 for trial, _ in measured.pairs]) / 3600.0
    drift = pooled(np.tile(starts[:, None], 3))
    assert drift > 0.04
    assert scatter.std.max() < 0.1 * drift


def test_the_scatter_of_trials_that_tell_no_element_by_itself_is_measured() -> None:
    """Trials much shorter than the relaxation: each element to 20 %, the force to a percent."""
    campaign = random_campaign(8639, scatter=0.02, longest=30.0)
    trials = run(campaign, seed=8639).trials
    pairs = [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
    fitted = fit(pairs)
    base = Workbench(fitted.problem.trials, None, fitted.noise.memory).base(fitted)
    scatter = measure(base, conditions([p for _, p in pairs]))
    assert scatter is not None
    # The depths of one pair differ by six percent, which is where repeats end.
    assert scatter.degrees in {6, 7}
    np.testing.assert_allclose(scatter.std, 0.02, rtol=0.35)


@pytest.mark.parametrize('slope', [0.0, 0.03])
def test_the_limit_of_the_scatter_is_above_it_as_often_as_it_says(slope: float) -> None:
    """Also where the trials tell only the size of the force, and where a trend is taken out."""
    random, scatter, groups = np.random.default_rng(4), 0.02, [[0, 1, 2], [3, 4]]
    size = np.full(3, 1.0 / np.sqrt(3.0))
    noise = 1e-8 * np.outer(size, size) + 0.04 * (np.eye(3) - np.outer(size, size))
    factor = np.linalg.cholesky(noise)
    late = slope * np.arange(-2.0, 3.0)
    above = []
    for _ in range(100):
        shifts = scatter * random.standard_normal((5, 3))
        shifts += random.standard_normal((5, 3)) @ factor.T + late[:, np.newaxis]
        _, limit = _common(shifts, np.array([noise] * 5), late, groups)
        above.append(limit >= scatter)
    assert 0.65 < np.mean(above) < 0.85


QUIET = 1e-8
"""Variance of what noise makes of a trial's factor."""


def block(factors: Any, groups: Any, noise: Any = QUIET) -> Any:
    """Return the trials that differ, of pushes a minute apart."""
    count = factors.size
    return _block(factors, np.full(count, 1.0) * noise, np.arange(count) * 60.0, groups)


@pytest.mark.parametrize('groups', [[[0, 1, 2, 3, 4]], [[0, 2, 4, 6], [1, 3, 5, 7]]])
def test_trials_one_after_another_that_differ_from_all_others_are_no_scatter(
    groups: list[list[int]],
) -> None:
    random = np.random.default_rng(7)
    count = sum(map(len, groups))
    changed = 2e-4 * random.standard_normal(count)
    changed[2:4] -= 0.08
    found = block(changed, groups)
    assert found is not None
    assert found.change == pytest.approx(np.expm1(-0.08), abs=2e-3)
    assert (found.first, found.last) == (2, 3)
    assert found.rest < 1e-3
    # Scatter puts them so by chance once in a thousand campaigns.
    chance = [block(0.02 * random.standard_normal(count), groups) for _ in range(300)]
    assert sum(each is not None for each in chance) <= 3


def test_trials_that_tell_little_are_no_block_because_they_are_off() -> None:
    """Shallow pushes after deep ones, each with its noise: by scatter of one size 5 %."""
    random = np.random.default_rng(8)
    std = np.array([1e-4] * 6 + [1e-3] * 4)
    groups = [list(range(6)), list(range(6, 10))]
    chance = [block(std * random.standard_normal(10), groups, std**2) for _ in range(400)]
    assert sum(each is not None for each in chance) <= 3


def test_what_changed_once_is_said_of_the_fewer_trials() -> None:
    factors = np.array([0.05, 0.0501, 0.0, 0.0001, -0.0001, 0.0])
    found = block(factors, [list(range(6))])
    assert found is not None
    assert (found.first, found.last) == (0, 1)
    assert found.change == pytest.approx(0.0513, abs=1e-3)
    # The order of the bags does not matter.
    times = np.arange(6)[::-1] * 60.0
    found = _block(factors[::-1].copy(), np.full(6, QUIET), times, [list(range(6))])
    assert found is not None
    assert (found.first, found.last) == (5, 4)


def test_a_single_trial_that_differs_is_scatter_and_none_that_does_is_nothing() -> None:
    factors = np.array([0.0, 0.0001, 0.05, -0.0001, 0.0002, 0.0])
    assert block(factors, [list(range(6))]) is None
    assert block(0.0 * factors, [list(range(6))]) is None


def test_a_change_between_two_trials_is_told_from_a_steady_one(
    repeated: Callable[..., Any],
) -> None:
    """Both go with time: the four trials of the second half, by the gain of the load cell."""
    _, found = repeated(Undeclared('gain_step', (0.08,)))
    assert found.block is not None
    # Of as many, those before are as good.
    assert (found.block.first, found.block.last) in {(0, 3), (4, 7)}
    assert abs(found.block.change) == pytest.approx(0.08, abs=0.01)
    _, found = repeated(Undeclared('ageing', (-1.0,)))
    assert found.block is None


ROUNDS = [[0, 4], [1, 5], [2, 6], [3, 7]]
"""Four pushes, and all of them once more."""


@pytest.mark.parametrize('misses', [0.0, 0.01])
def test_a_steady_change_over_two_rounds_is_told_by_the_pushes_within_each(misses: float) -> None:
    """Repeats differ all by as much, as where something changed between the rounds."""
    times = np.array([0.0, 1069.0, 2611.0, 4033.0, 5347.0, 6849.0, 8433.0, 9766.0])
    # What the model misses of each push by itself.
    push = misses * np.array([1.0, -1.0, 0.5, -0.5] * 2)
    ages = np.log1p(0.15 / 3600.0 * times) + push
    found = _block(ages, np.full(8, QUIET), times, ROUNDS)
    assert found is not None
    assert not _at_once(found, ages, times, ROUNDS)
    changed = np.repeat([0.0, 0.18], 4) + 0.002 * np.sin(times) + push
    found = _block(changed, np.full(8, QUIET), times, ROUNDS)
    assert found is not None
    assert _at_once(found, changed, times, ROUNDS)


@pytest.mark.parametrize('once', [1, 3])
def test_what_was_pushed_once_before_two_rounds_is_as_the_first(once: int) -> None:
    times = 1200.0 * np.arange(8.0 + once)
    rounds = [[index + once for index in group] for group in ROUNDS]
    changed = np.where(times < 1200.0 * (4 + once), 0.0, 0.18) + 0.002 * np.sin(times)
    found = _block(changed, np.full(times.size, QUIET), times, rounds)
    assert found is not None
    assert _at_once(found, changed, times, rounds)
    ages = 4e-5 * times + 0.002 * np.sin(times)
    assert not _at_once(found, ages, times, rounds)


def test_where_the_model_misses_the_pushes_repeats_tell_a_steady_change() -> None:
    times, groups = 600.0 * np.arange(10.0), [[0, 2, 4, 6, 8], [1, 3, 5, 7, 9]]
    push = 0.1 * np.array([1.0, -1.0] * 5) + 1e-3 * np.sin(times)
    changed = np.where(times < 2700.0, 0.0, 0.1) + push
    found = _block(changed, np.full(10, QUIET), times, groups)
    assert found is not None
    assert _at_once(found, changed, times, groups)
    assert not _at_once(replace(found, rest=0.02), 2e-5 * times + push, times, groups)


def test_ageing_over_two_rounds_is_no_change_between_them(world: Any) -> None:
    campaign = world.campaign(MIXED[:4] * 2, hold=3.0, recover=2.0, rate=100.0)
    for effect, seen in (
        (Undeclared('ageing', (-3.0,)), False),
        (Undeclared('gain_step', (0.08,)), True),
    ):
        measured = world.measure(campaign, effect, seed=3)
        found = measure(measured.bench()[1], conditions(measured.phases))
        assert found is not None
        assert (found.block is not None) == seen


MIXED = ((0.004, 0.006), (0.012, 0.004), (0.004, 0.004), (0.012, 0.006), (0.008, 0.005))
"""Five pushes, none of them twice."""


@pytest.mark.parametrize(
    ('effect', 'scatter', 'seen'),
    [
        (Undeclared('gain_step', (0.08,)), 0.0, True),
        (Undeclared('ageing', (-3.0,)), 0.0, False),
        (Undeclared('gain_step', (0.0,)), 0.03, False),
    ],
)
def test_without_repeats_what_changed_between_trials_is_told_from_scatter(
    world: Any, effect: Undeclared, scatter: float, seen: bool
) -> None:
    campaign = world.campaign(MIXED, hold=3.0, recover=2.0, rate=100.0, scatter=scatter)
    found = apart(world.measure(campaign, effect, seed=3).bench()[1])
    assert (found is not None) == seen
    if found is not None:
        # The second half has begun with the fourth.
        assert (found.first, found.last) == (3, 4)
        assert found.change == pytest.approx(0.08, abs=0.01)
        assert found.rest < 0.01


def test_trials_of_one_time_are_not_one_after_another(world: Any) -> None:
    campaign = world.campaign(MIXED, hold=3.0, recover=2.0, rate=100.0)
    _, base = world.measure(campaign, Undeclared('gain_step', (0.08,)), seed=3).bench()
    trials = [replace(trial, campaign_time=0.0) for trial in base.problem.trials]
    assert apart(Workbench(trials, None).taken_over(base)) is None


def test_in_what_pushes_differ_from_all_others_is_said() -> None:
    four = [phases(0.004, depth, 10.0) for depth in (0.006, 0.004)]
    twelve = [phases(0.012, depth, 9.5) for depth in (0.006, 0.004)]
    times, block = [0.0, 60.0, 120.0, 180.0], Block(0, 1, 0.05, 0.001)
    assert pushed_apart([*four, *twelve], times, block) == ('push speed',)
    mixed = [four[0], twelve[1], four[1], twelve[0]]
    assert pushed_apart(mixed, times, block) == ()
    # The order of the bags does not matter.
    turned = pushed_apart(
        [*twelve, *four], [120.0, 180.0, 0.0, 60.0], replace(block, first=2, last=3)
    )
    assert turned == ('push speed',)
    unknown = [phases(None, 0.006, None), *four[1:], *twelve]
    assert pushed_apart(unknown, times, block) == ('push speed',)
    assert pushed_apart([phases(None, None, None)] * 4, times, block) == ()
