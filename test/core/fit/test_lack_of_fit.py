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

"""Whether what a model leaves is noise, and what is told of it if it is not."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit import lack_of_fit as module
from hapticvision_ros.core.fit.campaign import Fit, fit, Problem
from hapticvision_ros.core.fit.held_out import fitted_trials, sample_noise
from hapticvision_ros.core.fit.lack_of_fit import lack_of_fit, sensor_noise
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import Estimate, Segmentation, Signal, Trial
import numpy as np
import pytest
from scipy.signal import lfilter
from scipy.stats import chi2

type Pair = tuple[Trial, Segmentation]

FORCE_NOISE, HEIGHT_NOISE, MEMORY = 0.02, 5e-5, 0.02
YIELD = Model(('yield_force',))
PUSHES = ((0.002, 0.005), (0.005, 0.005), (0.005, 0.008), (0.003, 0.008))


def _noisy(pair: Pair, seed: int) -> Pair:
    """Return a trial whose force has a zero, and noise that is alike over some samples."""
    trial, phases = pair
    rng = np.random.default_rng(seed)
    height = trial.displacement_height
    assert height is not None
    keep = np.exp(-float(np.median(np.diff(trial.force.t))) / MEMORY)
    white = rng.standard_normal(len(trial.force) + 500)
    slow = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], white)[500:]
    return replace(
        trial,
        name=f'trial_{seed}',
        start_ns=seed * 600 * 10**9,
        force=Signal(trial.force.t, trial.force.value + 0.05 + FORCE_NOISE * slow),
        displacement_height=Signal(
            height.t, height.value + HEIGHT_NOISE * rng.standard_normal(len(height))
        ),
    ), phases


@pytest.fixture(scope='module')
def campaign(bingham: Callable[[], Any]) -> list[Pair]:
    """Return four pushes of a body with a yield force, from an integrator of its own."""
    body = bingham()
    return [
        _noisy(body.make(speed, depth, hold=8.0, recovery=6.0), seed)
        for seed, (speed, depth) in enumerate(PUSHES)
    ]


@pytest.fixture(scope='module')
def right(campaign: list[Pair]) -> Fit:
    """Return the model that lacks nothing."""
    return fit(campaign, YIELD)


def _noise(found: Fit, campaign: list[Pair]) -> dict[Any, SensorNoise]:
    beside = fitted_trials(found, campaign)
    return sensor_noise(found, campaign, sample_noise(found, beside, campaign))


def test_of_a_model_that_lacks_nothing_noise_is_left(right: Fit, campaign: list[Pair]) -> None:
    noise = _noise(right, campaign)
    # Beside nothing smooth it is that of the fit, which knows what its parameters take out.
    assert noise == {'force': right.noise.force, 'height': right.noise.height}
    assert noise['force'].std == pytest.approx(FORCE_NOISE, rel=0.05)
    assert noise['force'].correlation_time == pytest.approx(MEMORY, rel=0.25)
    assert noise['height'].std == pytest.approx(HEIGHT_NOISE, rel=0.05)
    left = lack_of_fit(right, campaign, noise)
    assert set(left.total) == {'force', 'height'}
    groups = [*left.total.values(), *left.by_phase.values(), *left.by_trial.values()]
    for each in groups:
        if each.white is None:
            continue
        assert each.size == pytest.approx(1.0, abs=0.12)
        assert each.white > 1e-3
        assert each.smooth is None or each.smooth > 1e-3
        for goes in (each.depth, each.speed, each.order):
            assert goes is None or goes.chance > 1e-3
    assert left.total['force'].size == pytest.approx(1.0, abs=0.03)
    beyond = [
        abs(one) > 4.0 * std for c in left.curves for one, std in zip(c.value, c.std, strict=True)
    ]
    assert len(beyond) > 100
    assert not any(beyond)


def test_of_the_base_model_is_left_what_the_right_one_has(
    right: Fit, campaign: list[Pair]
) -> None:
    """Beside the same noise: not white, mostly smooth, and the curves are those of the means."""
    base = fit(campaign)
    left = lack_of_fit(base, campaign, _noise(right, campaign))
    force = left.total['force']
    assert force.size > 3.0
    assert force.neighbours is not None and force.neighbours > 0.8
    assert force.white is not None and force.white < 1e-12
    assert force.smooth is not None and force.smooth < 1e-12
    assert force.share is not None and force.share > 0.7
    for curve in left.curves:
        if (curve.channel, curve.phase) != ('force', 'hold'):
            continue
        index = [pair[0].name for pair in campaign].index(curve.trial)
        beside, phases = base.trials[index], campaign[index][1]
        assert beside is not None and phases.t_hold is not None
        off = beside.force.value - beside.force_fitted
        since = beside.force.t - phases.t_hold
        for k in range(5, curve.t.size - 1):
            near = np.abs(since - curve.t[k]) < 0.3
            assert curve.value[k] == pytest.approx(float(off[near].mean()), abs=0.03)


@pytest.fixture
def leaves(
    right: Fit, campaign: list[Pair], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Any]:
    """Return what is left where the residual of the force is white noise and something else."""
    rng = np.random.default_rng(5)
    white = SensorNoise(FORCE_NOISE, 0.0, 1.0)
    plain = [rng.standard_normal(trial.force.size) for trial in right.problem.trials]

    def make(beside: Callable[[Any, int], Any], noise: SensorNoise = white) -> Any:
        def residual(_: Problem, state: Any, index: int) -> Any:
            trial = right.problem.trials[index]
            size = FORCE_NOISE / np.sqrt(np.maximum(trial.force_count, 1.0))
            return size * plain[index] + beside(trial, index), np.zeros(trial.height_t.size)

        monkeypatch.setattr(Problem, 'residual', residual)
        monkeypatch.setattr(
            Problem, 'unsure', lambda self, *_: [np.zeros(t.force.size) for t in self.trials]
        )
        return lack_of_fit(right, campaign, {'force': noise})

    return make


def test_white_noise_is_white(leaves: Callable[..., Any], right: Fit) -> None:
    left = leaves(lambda *_: 0.0)
    assert 1e-3 < left.total['force'].white < 1.0
    sums = left.by_trial['trial_1', 'force']
    assert sums.blocks == np.count_nonzero(right.problem.trials[1].force_count)
    assert sums.size == pytest.approx(1.0, abs=0.1)
    alternating = leaves(lambda trial, _: FORCE_NOISE * (-1.0) ** np.arange(trial.force.size))
    assert alternating.total['force'].neighbours < -0.2
    assert alternating.total['force'].white < 1e-12


@pytest.mark.parametrize('count', [3, 10, 45, 280])
@pytest.mark.parametrize('chance', [0.9, 0.3, 1e-2, 1e-3])
def test_the_chance_is_that_of_chi_squared(count: int, chance: float) -> None:
    squares = float(chi2.isf(chance, count))
    assert module._chance(squares, count) == pytest.approx(chance, rel=0.15)


def test_what_one_trial_leaves_in_one_phase_is_told_there(
    leaves: Callable[..., Any], campaign: list[Pair]
) -> None:
    hold = campaign[2][1].t_hold
    assert hold is not None

    def bump(t: Any) -> Any:
        return 0.02 * np.exp(-(((t - hold - 4.0) / 1.5) ** 2))

    left = leaves(lambda trial, index: bump(trial.middle) if index == 2 else 0.0)
    told = {key for key, one in left.by_trial.items() if one.smooth < 1e-3}
    assert told == {('trial_2', 'force')}
    assert {key for key, one in left.by_phase.items() if (one.smooth or 1.0) < 1e-3} == {
        ('force', 'hold')
    }
    (curve,) = (c for c in left.curves if (c.trial, c.phase) == ('trial_2', 'hold'))
    off = curve.value - bump(hold + curve.t)
    # Straight between its corners, it is below the top by up to 0.001.
    assert np.all(np.abs(off) < 4.0 * curve.std + 1e-3)
    assert np.max(curve.value) > 5.0 * np.min(curve.std)


@pytest.mark.parametrize('late', [-64, 0, 16])
def test_what_goes_with_the_speed_later_is_told_so(
    leaves: Callable[..., Any], right: Fit, campaign: list[Pair], late: int
) -> None:
    """By so many intervals; each trial by itself has one speed, which starts and stops."""
    interval = right.problem.trials[0].interval

    def delayed(trial: Any, index: int) -> Any:
        loss = campaign[index][1].t_loss
        touches = (trial.middle > trial.t_contact) & (trial.middle < loss)
        speed = np.where(touches, np.diff(trial.displacement) / trial.duration, 0.0)
        return 5.0 * np.interp(trial.middle - late * interval, trial.middle, speed)

    speed = leaves(delayed).total['force'].speed
    assert speed.correlation > 0.1
    # Where nothing is slower than its own lag, the nearest of those tried.
    assert speed.lag == pytest.approx(late * interval, abs=1.01 * interval)


def test_trials_need_not_be_of_one_rate(campaign: list[Pair]) -> None:
    """Every second sample of one: lags are those of the slower, and the numbers are told."""
    trial, phases = campaign[0]
    slower = replace(trial, force=Signal(trial.force.t[::2], trial.force.value[::2]))
    mixed = [*campaign[1:], (slower, phases)]
    found = fit(mixed, YIELD)
    left = lack_of_fit(found, mixed, _noise(found, mixed))
    force = left.total['force']
    assert force.size == pytest.approx(1.0, abs=0.05)
    assert force.white is not None and force.white > 1e-3
    assert force.speed is not None
    steps = abs(force.speed.lag) / (2.0 * found.problem.trials[0].interval)
    assert steps == pytest.approx(round(steps))


def _of_trials(levels: list[float], noise: float = 1e-3) -> Any:
    """Return the sums of one phase of as many trials, whose means are given."""
    sums = []
    for index, level in enumerate(levels):
        trial: Any = SimpleNamespace(campaign_time=600.0 * index)
        record: Any = SimpleNamespace(trial=trial, interval=0.01, channel='force')
        nothing, count = np.zeros(10), 100
        inputs = np.zeros((3, 2, module._lags(0.01).size))
        squares = count * (level**2 + noise**2)
        of = count, count * level, squares, nothing, inputs
        sums.append(module._Sums(record, 'hold', *of, None, squares, squares))
    return sums


def test_a_correlation_is_worth_less_where_means_are_alike() -> None:
    """0.3 of 1000 means of white noise are none by chance; 1 in 66 of a slow noise may be."""
    (sums,) = _of_trials([0.0], noise=1.0)
    middle = sums.inputs.shape[2] // 2
    inputs = np.zeros(sums.inputs.shape)
    inputs[1, 1] = 100.0
    inputs[2, 1, middle] = 30.0
    # About a mean of 3, which is no evidence.
    level = replace(sums, inputs=inputs, total=300.0, squares=1000.0)
    parts = [level for _ in range(10)]
    for alike, least, most in (
        (np.zeros(10), 0.0, 1e-18),
        (0.97 ** np.arange(1.0, 11.0), 1e-3, 1.0),
        (-0.5 * np.ones(10), 0.0, 1e-18),
    ):
        depth, speed = module._goes_with(parts, alike)
        assert depth is None and speed is not None
        assert (speed.correlation, speed.lag) == (pytest.approx(0.3), 0.0)
        assert least <= speed.chance <= most
    assert module._bunched(0.97 ** np.arange(1.0, 11.0)) == pytest.approx(1.97 / 0.03)


def test_what_grows_from_trial_to_trial_goes_with_their_order() -> None:
    growing = module._goes_with_order(_of_trials([0.0, 0.1, 0.19, 0.31, 0.4, 0.5, 0.61, 0.7]))
    assert growing is not None
    assert growing.correlation > 0.99 and growing.chance < 1e-6
    falling = module._goes_with_order(_of_trials([0.5, 0.4, 0.31, 0.19, 0.1, 0.0]))
    assert falling is not None and falling.correlation < -0.99
    # All phases count.
    levels = [0.0, 0.1, 0.19, 0.31, 0.4, 0.5]
    after: Any = [replace(each, phase='recover') for each in _of_trials([0.0] * 6)]
    both = module._goes_with_order([*_of_trials(levels), *after])
    assert both is not None and both.correlation > 0.99
    # A few trials go with anything.
    assert module._goes_with_order(_of_trials([0.0, 0.1, 0.2, 0.3])) is None


def test_levels_without_an_order_go_with_none_however_well_they_are_known() -> None:
    random = np.random.default_rng(3)
    told = 0
    for _ in range(400):
        found = module._goes_with_order(_of_trials(random.standard_normal(6).tolist()))
        assert found is not None
        told += found.chance < 0.05
    assert 8 <= told <= 36


def test_levels_of_trials_and_slow_noise_do_not_go_with_the_tool(
    leaves: Callable[..., Any], right: Fit
) -> None:
    """A level of each trial, and noise that goes on for longer than is allowed for."""
    random = np.random.default_rng(11)
    told = 0
    for _ in range(40):
        levels = 0.02 * random.standard_normal(len(right.problem.trials))
        slow = [
            0.02 * lfilter([np.sqrt(1.0 - 0.97**2)], [1.0, -0.97], random.standard_normal(9000))
            for _ in levels
        ]

        def beside(trial: Any, index: int, slow: Any = slow, levels: Any = levels) -> Any:
            contact = trial.middle > trial.t_contact
            return slow[index][: trial.middle.size] + levels[index] * contact

        total = leaves(beside).total['force']
        told += (total.depth.chance < 1e-3) + (total.speed.chance < 1e-3)
    assert told <= 4


def test_whether_it_is_white_is_the_test_of_ljung_and_box() -> None:
    """Of one record by the book, and of two as of one of twice the length."""
    white = np.random.default_rng(2).standard_normal(40)
    noise = white + 0.2 * np.roll(white, 3)
    lagged = np.array([noise[k:] @ noise[:-k] for k in range(1, 11)])
    (sums,) = _of_trials([0.0])
    one = replace(sums, count=40, total=float(noise.sum()), squares=float(noise @ noise))
    one = replace(one, lagged=lagged)
    for parts, n in (([one], 40), ([one, one], 80)):
        alike = lagged / (noise @ noise)
        statistic = n * (n + 2.0) * np.sum(alike**2 / (n - np.arange(1, 11)))
        left = module._leftover(parts)
        assert left.white == pytest.approx(chi2.sf(statistic, 10), rel=0.03, abs=1e-3)
        assert left.neighbours == pytest.approx(alike[0])
    assert left.white is not None and 1e-6 < left.white < 0.9


def test_what_is_smooth_does_not_pass_for_slow_noise(
    right: Fit, campaign: list[Pair], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An arch over each hold, five times as high as the noise, and no other level to compare."""
    known = Problem.residual

    def residual(self: Problem, state: Any, index: int) -> Any:
        force, height = known(self, state, index)
        t, hold = self.trials[index].middle, campaign[index][1].t_hold
        arch = np.sin(np.pi * np.clip((t - hold) / 8.0, 0.0, 1.0))
        return force + 5.0 * FORCE_NOISE * arch, height

    monkeypatch.setattr(Problem, 'residual', residual)
    noise = sensor_noise(right, campaign, Noise(Estimate(1.0), Estimate(1.0)))
    assert noise['force'].std == pytest.approx(FORCE_NOISE, rel=0.05)
    assert noise['force'].correlation_time == pytest.approx(MEMORY, rel=0.3)


def test_corners_take_noise_out_that_is_given_back(
    right: Fit, campaign: list[Pair], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Ninety corners in each phase of some 350 means: what is beside them is 10 % too quiet."""
    random = np.random.default_rng(4)

    def residual(self: Problem, state: Any, index: int) -> Any:
        trial = self.trials[index]
        size = FORCE_NOISE / np.sqrt(np.maximum(trial.force_count, 1.0))
        since = np.maximum(trial.middle - trial.t_contact, 0.0)
        arch = 0.2 * np.sin(np.pi * since / 8.0)
        noise = size * random.standard_normal(trial.force.size)
        return noise + arch, np.zeros(trial.height_t.size)

    monkeypatch.setattr(Problem, 'residual', residual)
    monkeypatch.setattr(module, '_CORNERS', np.linspace(0.0, 1.0, 90))
    white = SensorNoise(FORCE_NOISE, 0.01 * FORCE_NOISE, MEMORY)
    known = replace(right, noise=replace(right.noise, force=white))
    noise = sensor_noise(known, campaign, Noise(Estimate(1.0), Estimate(1.0)))
    assert noise['force'].std == pytest.approx(FORCE_NOISE, rel=0.04)


def test_what_is_neither_smooth_nor_noise_does_not_pass_for_noise(
    right: Fit, campaign: list[Pair], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A square wave of the force, five times as large as its noise, from the touch on."""
    known = Problem.residual

    def residual(self: Problem, state: Any, index: int) -> Any:
        force, height = known(self, state, index)
        t = self.trials[index].middle
        wave = np.sign(np.sin(2.0 * np.pi * 1.3 * t)) * (t > self.trials[index].t_contact)
        return force + 5.0 * FORCE_NOISE * wave, height

    beside = fitted_trials(right, campaign)
    level = sample_noise(right, beside, campaign)
    monkeypatch.setattr(Problem, 'residual', residual)
    noise = sensor_noise(right, campaign, level)
    assert noise['force'].std == pytest.approx(FORCE_NOISE, rel=0.1)
    assert noise['force'].correlation_time == pytest.approx(MEMORY, rel=0.5)
    assert lack_of_fit(right, campaign, noise).total['force'].white < 1e-12
    # Where hardly anything is seen before the touch, or one and the same reading, as large as chi
    # squared refers to.
    with monkeypatch.context() as few:
        few.setattr(module, '_FEWEST', 10_000)
        found = sensor_noise(right, campaign, level)
        assert found['force'].std == pytest.approx(level.force.value)
    known_air = module._before_contact

    def still(record: Any) -> Any:
        made = known_air(record)
        return made and replace(made, residual=np.full(made.residual.size, 0.05))

    monkeypatch.setattr(module, '_before_contact', still)
    assert sensor_noise(right, campaign, level)['force'].std == pytest.approx(level.force.value)
