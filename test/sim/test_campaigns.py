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

"""Campaigns with an undeclared effect: what is measured, and what is not told."""

from dataclasses import replace
from pathlib import Path

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    peak_force,
    Push,
    random_campaign,
    run,
    Sensors,
    write_bags,
)
from hapticvision_ros.sim.config import load_config, WorldConfig
from hapticvision_ros.sim.offline import CloudPlan
from hapticvision_ros.sim.specimen import Body, EFFECTS, Undeclared
from hapticvision_ros.sim.strengths import undeclared
import numpy as np
import pytest

BODY = Body(2000.0, 1600.0, 2400.0)
CAMPAIGN = Campaign(
    BODY,
    (Push(0.008, 0.006, 3.0, 2.0), Push(0.004, 0.004, 3.0, 2.0)),
    Sensors(ForceNoise(0.05, 0.03, 0.05), 5e-5, force_zero=0.3),
    rest=30.0,
)


def height(trial: Trial) -> Signal:
    """Return the displacement height."""
    assert trial.displacement_height is not None
    return trial.displacement_height


def ideal(*effects: Undeclared, campaign: Campaign = CAMPAIGN) -> tuple[Trial, ...]:
    """Return the trials of a run without noise."""
    return run(campaign, effects, seed=1, ideal=True).trials


def same(one: Trial, other: Trial) -> bool:
    """Return whether two trials hold the same samples."""
    pairs = (
        (one.force, other.force),
        (one.tool_height, other.tool_height),
        (height(one), height(other)),
    )
    return all(np.array_equal(a.t, b.t) and np.array_equal(a.value, b.value) for a, b in pairs)


def test_the_same_seed_makes_the_same_campaign_and_another_does_not() -> None:
    first, again, other = (run(CAMPAIGN, seed=seed).trials for seed in (5, 5, 6))
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a, b in zip(first, other, strict=True))


@pytest.mark.parametrize('name', EFFECTS)
def test_each_effect_is_visible_and_absent_at_no_strength(name: str) -> None:
    bare = ideal()
    absent = ideal(undeclared(name, 0.0, CAMPAIGN))
    assert all(same(a, b) for a, b in zip(bare, absent, strict=True))
    present = ideal(undeclared(name, 0.2, CAMPAIGN))
    changes = [0.0, 0.0]
    for a, b in zip(present, bare, strict=True):
        changes[0] = max(changes[0], float(np.abs(a.force.value - b.force.value).max()))
        changes[1] = max(changes[1], float(np.abs(height(a).value - height(b).value).max()))
    # A tenth of the noise of a sample at least.
    assert changes[0] > 0.005 or changes[1] > 5e-6


def test_any_number_of_effects_acts_together() -> None:
    every = [undeclared(name, 0.01, CAMPAIGN) for name in EFFECTS]
    trials = ideal(*every)
    assert all(np.isfinite(trial.force.value).all() for trial in trials)
    with pytest.raises(UsageError, match='once'):
        run(CAMPAIGN, [every[0], every[0]], seed=0)


def test_bags_tell_what_was_measured_and_nothing_of_the_truth(tmp_path: Path) -> None:
    effect = undeclared('yield_force', 0.1, CAMPAIGN)
    done = run(CAMPAIGN, [effect], seed=2)
    paths = write_bags(done, tmp_path, duplicates=4, compression='none')
    assert [path.name for path in paths] == ['trial_01', 'trial_02']
    for path, trial in zip(paths, done.trials, strict=True):
        read = read_trial(path)
        assert same(read, trial)
        assert read.start_ns == trial.start_ns
        assert dict(read.provenance) == {'source': 'synthetic'} == dict(trial.provenance)
        content = b''.join(file.read_bytes() for file in path.iterdir()).lower()
        for word in ('yield', 'undeclared', 'seed', 'strength', 'truth', *EFFECTS):
            assert word.encode() not in content


def before_clouds(config: WorldConfig, rate: float) -> Campaign:
    """Return one push that the range sensor sees at `rate` [Hz]."""
    return replace(
        CAMPAIGN,
        pushes=(Push(0.006, 0.006, 1.0, 2.0),),
        sensors=replace(CAMPAIGN.sensors, height_rate=rate, height_noise=0.0),
        surface_height=config.block.height,
    )


def test_a_bag_with_clouds_gives_the_displacement_height_back(tmp_path: Path) -> None:
    config = load_config()
    one = before_clouds(config, 5.0)
    done = run(one, seed=3)
    (path,) = write_bags(done, tmp_path, clouds=(config, CloudPlan(80, 60, 2e-4)))
    read = read_trial(path)
    assert read.displacement_source == 'points'
    after = done.truth.losses[0] + 0.7
    true = height(done.trials[0])
    seen = height(read)
    late = seen.t > after
    # The median of a few dozen points with 0.2 mm of noise each, on a coarse cloud.
    np.testing.assert_allclose(seen.value[late], true.at(seen.t[late]), atol=3e-4)


def test_clouds_by_a_late_clock_show_the_tool_late(tmp_path: Path) -> None:
    config = load_config()
    one = before_clouds(config, 20.0)
    rises = []
    for late in (0.0, 0.5):
        done = run(one, [Undeclared('clock_offset', (late,))], seed=3)
        (path,) = write_bags(done, tmp_path / str(late), clouds=(config, CloudPlan(80, 60, 0.0)))
        clouds = read_trial(path).clouds
        assert clouds is not None
        # The lower the tool, the more points are on its shaft.
        above = config.block.height + 0.002
        times = np.array([frame.t for frame in clouds])
        shaft = np.array([np.sum(frame.xyz[..., 2] > above) for frame in clouds])
        rises.append(float(times[shaft > 0.5 * (shaft.min() + shaft.max())].max()))
    assert rises[1] - rises[0] == pytest.approx(0.5, abs=0.06)


def test_touch_and_loss_fall_between_samples_and_are_found_by_the_segmentation() -> None:
    done = run(replace(CAMPAIGN, surface_scatter=5e-5), seed=4)
    for trial, touch in zip(done.trials, done.truth.touches, strict=True):
        phases = segment(trial.force, trial.tool_height, height(trial))
        assert phases.t_contact is not None
        # Two samples of the load cell.
        assert phases.t_contact == pytest.approx(touch, abs=0.008)
        assert np.abs(trial.force.t - touch).min() > 1e-6


def test_noise_has_the_declared_size_and_correlation() -> None:
    long = replace(CAMPAIGN, pushes=(Push(0.008, 0.006, 200.0, 2.0),))
    noisy, clean = run(long, seed=7).trials[0], run(long, seed=7, ideal=True).trials[0]
    noise = noisy.force.value - clean.force.value
    # 50,000 samples, of which 2,500 are independent of each other: 3 %.
    assert noise.std() == pytest.approx(CAMPAIGN.sensors.force_noise.std, rel=0.05)
    lag = round(0.05 * CAMPAIGN.sensors.force_rate)
    shared = float(np.mean(noise[lag:] * noise[:-lag]))
    assert shared == pytest.approx(0.03**2 * np.exp(-lag * 0.004 / 0.05), rel=0.25)
    spread = height(noisy).value - height(clean).value
    assert spread.std() == pytest.approx(5e-5, rel=0.05)


def test_scatter_is_independent_from_coefficient_to_coefficient() -> None:
    many = replace(
        CAMPAIGN,
        pushes=(Push(0.02, 0.002, 0.1, 0.1),) * 200,
        scatter=0.02,
        surface_scatter=5e-5,
    )
    truth = run(many, seed=8).truth
    logs = np.log([[b.K1 / BODY.K1, b.C1 / BODY.C1, b.C2 / BODY.C2] for b in truth.bodies])
    # 200 draws: 5 % for a standard deviation, 0.07 for a correlation.
    np.testing.assert_allclose(logs.std(axis=0), 0.02, rtol=0.2)
    correlation = np.corrcoef(logs.T) - np.eye(3)
    assert np.abs(correlation).max() < 0.28
    assert np.std(truth.surface_offsets) == pytest.approx(5e-5, rel=0.2)


def test_the_load_cell_lags_by_its_time_constant() -> None:
    lag = 0.05
    (late, _), (prompt, _) = ideal(Undeclared('force_lag', (lag,))), ideal()
    # The force of the hold changes slowly: the lagged one is that of a moment before.
    hold = (prompt.force.t > 3.5) & (prompt.force.t < 5.0)
    expected = prompt.force.at(prompt.force.t[hold] - lag)
    np.testing.assert_allclose(late.force.value[hold], expected, atol=1e-3 * expected.max())


def test_an_arm_ripples_while_it_moves() -> None:
    straight, duration, _ = CAMPAIGN.motion(0)
    rippling, _, _ = replace(CAMPAIGN, ripple=2e-5, ripple_rate=8.0).motion(0)
    t = np.arange(0.0, duration, 1e-3)
    depth = rippling.at(t)[0]
    off = depth - straight.at(t)[0]
    at_rest = straight.at(t)[1] == 0.0
    # Where it starts and stops the pieces cut a corner.
    assert np.abs(off).max() == pytest.approx(2e-5, rel=0.1)
    assert np.abs(off[at_rest]).max() < 4e-6
    push = (t > 1.6) & (np.abs(straight.at(t)[1] - 0.008) < 1e-9)
    power = np.abs(np.fft.rfft(off[push] - off[push].mean()))
    assert np.fft.rfftfreq(push.sum(), 1e-3)[np.argmax(power)] == pytest.approx(8.0, abs=1.0)
    # The pieces go on where the one before ends.
    steps = np.diff(rippling.t)
    ends = rippling.depth[:-1] + steps * (rippling.speed[:-1] + rippling.speed[1:]) / 2.0
    np.testing.assert_allclose(ends, rippling.depth[1:], atol=1e-12)


def test_an_arm_that_moves_at_least_jerk_changes_its_speed_all_the_way() -> None:
    """It is at its greatest speed half way, and its acceleration does not jump."""
    campaign = replace(CAMPAIGN, curved=True)
    motion, duration, phases = campaign.motion(0)
    starts = {name: t for t, name in phases}
    t = np.linspace(starts['push'], starts['hold'], 2001)
    depth, speed, acceleration = motion.at(t)
    assert depth[-1] == pytest.approx(0.006, abs=1e-12)
    assert speed.max() == pytest.approx(0.008, rel=1e-3)
    assert t[int(np.argmax(speed))] == pytest.approx(0.5 * (t[0] + t[-1]), rel=1e-3)
    assert speed[[0, -1]] == pytest.approx(0.0, abs=1e-6)
    lasts = t[-1] - t[0]
    assert lasts == pytest.approx(1.875 * (depth[-1] - depth[0]) / 0.008)
    # Of the fifth order of the time: the acceleration is at most 5.77 ways over its square.
    most = 5.7735 * (depth[-1] - depth[0]) / lasts**2
    assert np.abs(acceleration).max() == pytest.approx(most, rel=0.01)
    assert np.abs(np.diff(acceleration)).max() < 0.05 * most
    assert motion.at(np.array([duration]))[0] == pytest.approx([-0.010])


def test_drift_goes_on_over_the_campaign_and_hum_keeps_its_phase() -> None:
    bare = ideal()
    for effect, change in (
        (Undeclared('force_drift', (1e-3,)), lambda t: 1e-3 * t),
        (
            Undeclared('periodic_disturbance', (0.1, 7.0)),
            lambda t: 0.1 * np.sinc(7.0 * 0.004) * np.sin(2.0 * np.pi * 7.0 * t),
        ),
    ):
        for trial, before in zip(ideal(effect), bare, strict=True):
            t = trial.force.t + (trial.start_ns - 1_750_000_000 * 10**9) / 1e9
            np.testing.assert_allclose(
                trial.force.value - before.force.value, change(t), atol=2e-5
            )


def test_a_range_sensor_with_a_late_clock_shows_an_earlier_height() -> None:
    late, prompt = ideal(Undeclared('clock_offset', (0.1,)))[0], ideal()[0]
    slow = height(late).t < 5.0
    expected = height(prompt).at(height(prompt).t[slow] - 0.1)
    # Between two samples of the height the tool's speed changes: 8 mm/s over 50 ms at most.
    np.testing.assert_allclose(height(late).value[slow], expected, atol=1e-4)


def test_the_object_is_hidden_while_it_is_touched_where_the_sensor_cannot_see() -> None:
    blind = replace(CAMPAIGN, sensors=replace(CAMPAIGN.sensors, sees_in_contact=False))
    done = run(blind, seed=1)
    for trial, touch, loss in zip(done.trials, done.truth.touches, done.truth.losses, strict=True):
        t = height(trial).t
        assert not np.any((t > touch) & (t < loss))
        assert np.any(t < touch)
        assert np.any(t > loss)


@pytest.mark.parametrize('seed', range(12))
def test_drawn_campaigns_stay_in_their_ranges_and_can_be_carried_out(seed: int) -> None:
    campaign = random_campaign(seed)
    assert campaign == random_campaign(seed)
    assert 0.5 <= campaign.body.relaxation_time <= 100.0
    assert peak_force(campaign) >= 0.1 * (1.0 - 1e-9)
    assert peak_force(campaign) <= 500.0 * (1.0 + 1e-9)
    assert 2 <= len(campaign.pushes) <= 24
    assert max(campaign.motion(i)[1] for i in range(len(campaign.pushes))) < 80.0
    one = replace(campaign, pushes=campaign.pushes[:1])
    trial = run(one, seed=seed).trials[0]
    phases = segment(trial.force, trial.tool_height, height(trial))
    assert None not in (phases.t_contact, phases.t_hold, phases.t_release)


def test_a_drawn_campaign_with_scatter_repeats_its_pushes() -> None:
    campaign = random_campaign(3, trials=6, scatter=0.02)
    assert len(campaign.pushes) == 6
    assert all(campaign.pushes.count(push) >= 2 for push in campaign.pushes)


@pytest.mark.parametrize('seen', [True, False])
def test_a_record_that_begins_at_any_moment_is_fitted_or_refused_with_the_reason(seen):
    made = run(CAMPAIGN, seed=1)
    whole, touch, loss = made.trials[0], made.truth.touches[0], made.truth.losses[0]
    refused = 0
    for begin in np.linspace(touch - 0.2, loss + 0.2, 21):
        late = replace(
            whole,
            force=whole.force.between(begin, np.inf),
            tool_height=whole.tool_height.between(begin, np.inf),
            displacement_height=(
                whole.displacement_height.between(begin, np.inf) if seen else None
            ),
        )
        try:
            fit([analyse(late)], Model())
        except UsageError as error:
            assert late.name in str(error) and 'no model is fitted' in str(error)
            refused += 1
    assert 10 <= refused <= 20
