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


"""What is left in no smooth form is seen by its loudness."""

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from hapticvision_ros.core.diagnosis.excess import (
    _about_its_mean,
    _Averaged,
    _held,
    _parted,
    bursts,
    Excess,
    louder,
    Stretch,
)
from hapticvision_ros.core.fit.campaign import Problem
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import peak_force
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest


@pytest.fixture(scope='module')
def heard(world: Any) -> Callable[..., tuple[Excess, ...]]:
    """Return what is louder in contact beside the base model."""

    def hear(*effects: Undeclared, change: Callable[[Trial], Trial] = lambda t: t) -> Any:
        measured = world.measure(world.campaign(), *effects, seed=1, change=change)
        _, base = measured.bench()
        return louder(base, measured.phases)

    return hear


def test_noise_is_as_loud_in_contact_as_without(heard: Any) -> None:
    assert heard() == ()


def test_a_knock_in_one_hold_is_heard_there(world: Any, heard: Any) -> None:
    amplitude = 0.1 * peak_force(world.campaign())
    (found,) = heard(Undeclared('knock', (amplitude, 4.8, 0.5)))
    assert found.channel == 'force'
    # It comes in the middle of the campaign.
    assert found.trial == 'trial_03'
    assert found.trial_ratio > 1.5 * found.ratio > 1.5
    assert 'force, in contact' in str(found)


def test_a_range_sensor_with_another_scale_is_seen(heard: Any) -> None:
    (found,) = heard(Undeclared('height_gain', (-0.07,)))
    assert found.channel == 'displacement height'
    assert found.ratio > 1.3


def test_heights_that_come_often_are_as_loud_in_contact_as_without(world: Any) -> None:
    """In the air, where steps are long, the fit works with means of several."""
    usual = world.campaign([(0.2 * speed, depth) for speed, depth in world.four])
    sensors = replace(usual.sensors, height_rate=usual.sensors.force_rate)
    often = replace(usual, sensors=sensors, clearance=0.02)
    measured = world.measure(often, seed=1)
    _, base = measured.bench()
    assert max(trial.height_count.max() for trial in base.problem.trials) > 4.0
    assert louder(base, measured.phases) == ()
    scaled = world.measure(often, Undeclared('height_gain', (-0.07,)), seed=1)
    _, base = scaled.bench()
    (found,) = louder(base, scaled.phases)
    assert found.channel == 'displacement height'
    assert found.ratio > 1.3


def test_means_are_as_loud_as_each_of_their_samples() -> None:
    """And what acts in contact is no louder for them."""
    t = 0.01 * np.arange(8000)
    left = np.where(np.arange(t.size) % 2, 0.4, 1.0)
    read = left * np.random.default_rng(1).standard_normal(t.size) + np.where(t > 40.0, 0.5, 3.0)
    trial: Any = SimpleNamespace(t_contact=40.0)
    phase: Any = SimpleNamespace(t_end=80.0, t_loss=None)
    (quiet,), loud = _parted(t, read, trial, phase, _Averaged(1.0, left), after=False)
    assert np.sqrt(np.mean(quiet**2)) == pytest.approx(1.0, rel=0.05)
    assert np.sqrt(np.mean(loud**2)) == pytest.approx(np.hypot(1.0, 0.5), rel=0.05)


@pytest.mark.parametrize('height', [1.7e-7, 2.1e-7, 3.3e-7])
def test_a_height_that_is_always_the_same_is_no_noise_at_all(height: float) -> None:
    """What is left of it by rounding would be one, once means of several are weighed."""
    assert not _about_its_mean(np.full(117, height)).any()
    seen = np.array([1.0, 2.0, 6.0])
    assert _about_its_mean(seen).tolist() == [-2.0, -1.0, 3.0]


def test_without_a_height_the_force_alone_is_held_against_its_noise(
    heard: Any, without_height: Callable[[Trial], Trial]
) -> None:
    assert heard(Undeclared('height_gain', (-0.07,)), change=without_height) == ()


def test_a_coarse_load_cell_that_reads_the_same_in_air_is_not_louder_in_contact(
    world: Any, heard: Any
) -> None:
    """Steps of seven times the noise: without contact hardly any reading differs from zero."""
    force = peak_force(world.campaign())
    step, zero = 0.035 * force, 0.02 * force

    def rounded(trial: Trial) -> Trial:
        value = np.round((trial.force.value - zero) / step) * step
        return replace(trial, force=Signal(trial.force.t, value))

    assert heard(change=rounded) == ()


def test_a_load_cell_that_rests_at_a_reading_is_not_louder_where_it_goes_through_them() -> None:
    """Steps of one: at rest it mostly reads the same, in contact it rounds."""
    dither = 0.3 * np.random.default_rng(5).standard_normal((2, 4000))
    still, moved = np.round(dither[0]), np.linspace(0.0, 20.0, 4000)
    parts = [('a', [still - still.mean()], np.round(moved + dither[1]) - moved)]
    assert _held('force', parts, 1.0, 1e-6, 1.0 / np.sqrt(12.0), memory=0.0) is None
    louder_one = [(name, quiet, 1.5 * loud) for name, quiet, loud in parts]
    assert _held('force', louder_one, 1.0, 1e-6, 1.0 / np.sqrt(12.0), memory=0.0) is not None


def test_a_coarse_range_sensor_that_reads_the_same_in_air_is_not_louder_in_contact(
    heard: Any,
) -> None:
    """Steps of 0.4 mm, many times the noise of the heights."""

    def rounded(trial: Trial) -> Trial:
        height = trial.displacement_height
        assert height is not None
        value = np.round((height.value - 1e-4) / 4e-4) * 4e-4
        return replace(trial, displacement_height=Signal(height.t, value))

    assert heard(change=rounded) == ()


def test_heights_that_are_taken_from_the_tool_once_it_touches_are_not_louder_for_it(
    heard: Any,
) -> None:
    """Encoders of 0.02 mm that round to 0.02 mm, and one and the same height before the touch."""

    def taken(trial: Trial) -> Trial:
        height, tool = trial.displacement_height, trial.tool_height
        assert height is not None
        way = np.interp(height.t, tool.t, tool.value)
        deepest = way < way.min() + 1e-4
        depth = way.min() + float(np.median(height.value[deepest])) - way
        seen = height.t < height.t[deepest][-1]
        read = depth + 2e-5 * np.random.default_rng(3).standard_normal(depth.size)
        value = np.where(depth > 0.0, np.round(read / 2e-5) * 2e-5, 0.0)
        return replace(trial, displacement_height=Signal(height.t[seen], value[seen]))

    assert heard(change=taken) == ()


def _slow(t: Any, time: float, seed: int) -> Any:
    """Return an autoregression of unit size."""
    random = np.random.default_rng(seed)
    value = random.standard_normal(t.size)
    for i, gone in enumerate(np.exp(-np.diff(t) / time), start=1):
        value[i] = gone * value[i - 1] + np.sqrt(1.0 - gone**2) * value[i]
    return value


def test_a_range_sensor_that_averages_over_long_is_seen(heard: Any) -> None:
    """A fit takes the rounded corners for slow noise, of which the sensor shows none before."""

    def averaged(trial: Trial) -> Trial:
        seen = trial.displacement_height
        grid = np.arange(seen.t[0], seen.t[-1], 0.01)
        long = np.pad(np.interp(grid, seen.t, seen.value), 25, mode='edge')
        value = np.interp(seen.t, grid, np.convolve(long, np.full(51, 1.0 / 51.0), mode='valid'))
        noise = np.random.default_rng(3).normal(0.0, 5e-5, seen.t.size)
        return replace(trial, displacement_height=Signal(seen.t, value + noise))

    (found,) = heard(change=averaged)
    assert found.channel == 'displacement height'
    assert found.memory > 0.1
    assert 'which the noise without contact does not' in str(found)


def test_a_range_sensor_whose_noise_is_slow_everywhere_is_heard_as_such(heard: Any) -> None:
    def slow(trial: Trial) -> Trial:
        seen = trial.displacement_height
        # Of each trial its own.
        noise = 1e-4 * _slow(seen.t, 0.4, int(1e6 * abs(seen.value[-1])))
        return replace(trial, displacement_height=Signal(seen.t, seen.value + noise))

    assert heard(change=slow) == ()


def _struck(world: Any, start: float, stop: float) -> Any:
    """Return the bursts of a campaign whose force is struck in a part of each record."""

    def strike(trial: Trial) -> Trial:
        t, value = trial.force.t, trial.force.value.copy()
        random = np.random.default_rng(len(trial.name))
        for at in np.linspace(start, stop, 10) + 0.01 * random.uniform(size=10):
            value[np.searchsorted(t, at)] += 2.0
        return replace(trial, force=Signal(t, value))

    measured = world.measure(world.campaign(((0.001, 0.003),) * 4), seed=1, change=strike)
    _, base = measured.bench()
    assert sum(trial.set_aside.size for trial in base.problem.trials) > 30
    return bursts(base, measured.phases), measured.phases


def test_what_strikes_in_the_push_alone_is_no_glitch_of_the_load_cell(world: Any) -> None:
    """An object that slips again and again stands out of the noise as glitches do."""
    touch = world.measure(world.campaign(((0.001, 0.003),) * 4), seed=1).phases[0].t_contact
    found, _ = _struck(world, touch + 0.5, touch + 2.5)
    assert found is not None
    assert found.phase == 'push'
    assert found.count == found.total
    assert found.rms == pytest.approx(2.0, rel=0.05)
    assert 'which glitches of a load cell would not' in str(found)


def test_what_strikes_at_any_time_is_glitches(world: Any) -> None:
    found, phases = _struck(world, 0.2, 9.0)
    assert phases[0].t_end > 9.0
    assert found is None


@pytest.mark.parametrize('kind', ['off', 'dead', 'wild'])
def test_a_stretch_that_stands_off_at_once_is_no_glitch(world: Any, kind: str) -> None:
    """Unless the load cell hangs, or tells more than any force of the push."""
    campaign = world.campaign(((0.001, 0.003),) * 3)
    largest = peak_force(campaign)

    def moved(trial: Trial) -> Trial:
        t, value = trial.force.t, trial.force.value.copy()
        stretch = (t > 7.0) & (t < 7.3)
        if kind == 'dead':
            value[stretch] = value[stretch][0] - 0.2 * largest
        else:
            value[stretch] -= (0.2 if kind == 'off' else 5.0) * largest
        return replace(trial, force=Signal(t, value))

    measured = world.measure(campaign, seed=1, change=moved)
    phases = measured.phases[0]
    assert phases.t_hold is not None and phases.t_release is not None
    assert phases.t_hold < 7.0 and phases.t_release > 7.3
    _, base = measured.bench()
    assert all(trial.set_aside.size > 50 for trial in base.problem.trials)
    found = bursts(base, measured.phases)
    if kind != 'off':
        assert found is None
        return
    assert isinstance(found, Stretch)
    # What the way of the tool leaves open by as much is none.
    open_ways = tuple(np.full(jumps.shape, (0.1 * largest) ** 2) for jumps in base.jumps)
    assert bursts(replace(base, jumps=open_ways), measured.phases) is None
    assert (found.phase, found.trials) == ('hold', ('trial_01', 'trial_02', 'trial_03'))
    assert found.longest == pytest.approx(0.3, abs=0.02)
    assert found.rms == pytest.approx(0.2 * largest, rel=0.1)
    assert 'in trial_01 and 2 more' in str(found)


@pytest.mark.parametrize('channel', ['force', 'height'])
def test_a_trial_that_is_noisier_in_the_air_as_well_is_not_louder(
    heard: Any, channel: str
) -> None:
    random = np.random.default_rng(11)

    def noisier(trial: Trial, since: float = 0.0, until: float = np.inf) -> Trial:
        if trial.name != 'trial_02':
            return trial
        seen = trial.force if channel == 'force' else trial.displacement_height
        assert seen is not None
        level = 4.0 * np.std(seen.value[: seen.value.size // 20])
        noise = level * random.standard_normal(seen.t.size) * ((seen.t > since) & (seen.t < until))
        made = Signal(seen.t, seen.value + noise)
        if channel == 'force':
            return replace(trial, force=made)
        return replace(trial, displacement_height=made)

    assert heard(change=noisier) == ()
    # Noise that comes with the contact is.
    (found,) = heard(change=lambda trial: noisier(trial, 1.5, 6.0))
    assert found.trial == 'trial_02'


def test_a_few_heights_in_each_trial_are_held_against_their_noise_together(
    world: Any,
) -> None:
    """Those of one trial tell little by themselves."""

    def thinned(trial: Trial) -> Trial:
        seen = trial.displacement_height
        return replace(trial, displacement_height=Signal(seen.t[::2], seen.value[::2]))

    campaign = world.campaign(hold=0.5)
    found = []
    for effects in ((), (Undeclared('height_gain', (-0.3,)),)):
        measured = world.measure(campaign, *effects, seed=1, change=thinned)
        _, base = measured.bench()
        for trial, phases in zip(base.problem.trials, measured.phases, strict=True):
            inside = (trial.height_t > phases.t_contact) & (trial.height_t < phases.t_loss)
            assert np.count_nonzero(inside) < 32
        found.append(louder(base, measured.phases))
    assert found[0] == ()
    assert [each.channel for each in found[1]] == ['displacement height']


def test_one_sample_that_is_astray_is_no_trial_that_is_louder() -> None:
    random = np.random.default_rng(9)
    quiet, loud = random.standard_normal((2, 400))
    parts: list[Any] = [('a', [quiet], loud), ('b', [], np.array([6.0]))]
    assert _held('force', parts, 1.0, 1e-6, memory=0.0) is None
    louder_one = [*parts, ('c', [], 2.5 * random.standard_normal(60))]
    found = _held('force', louder_one, 1.0, 1e-6, memory=0.0)
    assert found is not None
    assert found.trial == 'c'


def test_heights_of_a_fast_push_whose_stamps_are_off_are_not_louder(world: Any) -> None:
    random = np.random.default_rng(7)

    def stamped(trial: Trial) -> Trial:
        height = trial.displacement_height
        assert height is not None
        off = 0.005 * np.clip(random.standard_normal(height.t.size), -2.5, 2.5)
        return replace(trial, displacement_height=Signal(height.t + off, height.value))

    pushes = (0.03, 0.006), (0.03, 0.003), (0.02, 0.006), (0.03, 0.0045)
    measured = world.measure(world.campaign(pushes, hold=1.0), seed=32, change=stamped)
    _, base = measured.bench()
    assert louder(base, measured.phases) == ()
    # With a clock that is exact they would be.
    exact = tuple(replace(trial, height_jitter=0.0) for trial in base.problem.trials)
    problem = Problem(base.model, exact)
    problem.set_noise(base.force_noise, base.height_noise, base.jumps)
    assert 'displacement height' in [
        each.channel for each in louder(replace(base, problem=problem), measured.phases)
    ]
