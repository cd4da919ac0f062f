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


"""Smooth curves that are left of a residual."""

from dataclasses import replace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.refit import Smooth, Workbench
from hapticvision_ros.core.diagnosis.structure import _alike, _calm, look, SURPRISE
from hapticvision_ros.core.fit.campaign import fit_prepared, Problem
from hapticvision_ros.core.fit.data import arm_of, FitTrial, prepare
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import peak_force
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest


def away(measured: Any) -> list[str]:
    """Return the sizes of the curves that stand out of the force once the tool is away."""
    bench, base = measured.bench()
    found = look(bench, base, measured.phases)
    return [each.curve.size for each in found if each.beyond_chance and each.away]


@pytest.mark.parametrize('creeps', [False, True])
def test_a_load_cell_that_is_slow_to_come_back_is_seen_once_the_tool_is_away(
    world: Any, creeps: bool
) -> None:
    """What a zero does by itself is another in each trial; this follows the force before."""
    effects = [Undeclared('cell_creep', (0.1, 1.0))] if creeps else []
    pushes = (*world.repeated, *world.four)
    measured = world.measure(world.campaign(pushes, recover=6.0), *effects, seed=4)
    assert ('alike' in away(measured)) == creeps


@pytest.mark.parametrize(
    ('trials', 'lasts', 'seen'), [(4, 0.5, True), (3, 0.5, False), (4, np.inf, False)]
)
def test_little_is_said_of_a_force_once_the_tool_is_away(
    world: Any, trials: int, lasts: float, seen: bool
) -> None:
    """Three trials do not tell what is alike in them, nor is another level of any of them."""
    size = 0.02 * peak_force(world.campaign())

    def humped(trial: Trial) -> Trial:
        t, value = trial.force.t, trial.force.value
        loss = segment(trial.force, trial.tool_height, trial.displacement_height).t_loss
        assert loss is not None
        hump = np.where(t > loss, size * np.exp(-np.maximum(t - loss, 0.0) / lasts), 0.0)
        return replace(trial, force=Signal(t, value + hump))

    campaign = world.campaign(world.four[:trials], recover=4.0)
    assert bool(away(world.measure(campaign, seed=5, change=humped))) == seen


def test_nothing_is_looked_for_while_a_tool_gathers_speed_to_withdraw(world: Any) -> None:
    """How it does so its encoders leave open, and a flow feels it."""
    campaign = replace(world.campaign(world.four[:2]), acceleration=0.1)
    pairs = world.measure(campaign, seed=3).pairs
    prepared, _ = prepare(pairs, servo=arm_of(pairs)[0])
    found = fit_prepared(prepared, Model())
    base = Workbench(found.problem.trials, None).base(found)
    for trial, (_, phases), calm in zip(base.problem.trials, pairs, _calm(base), strict=True):
        t_hold, t_release = phases.t_hold, phases.t_release
        assert t_hold is not None
        assert t_release is not None
        gathers = next(b.stop for b in trial.path.bends if b.stop > t_release + 0.1)
        assert gathers == pytest.approx(t_release + 0.2, abs=0.01)
        assert not calm[(trial.middle > t_release) & (trial.middle < gathers)].any()
        assert calm[(trial.middle > t_hold + 0.2) & (trial.middle < t_release - 0.05)].all()
        assert calm[trial.middle > gathers + 0.05].any()


def curved(trial: FitTrial, unsteady: float, noise: float) -> FitTrial:
    """Return a trial whose tool is taken to go along a curve."""
    path = trial.path
    off = np.full(path.t.size, unsteady)
    path = replace(path, still=0.1, unsteady=off, noise=noise, curved=True)
    return replace(trial, path=path)


@pytest.mark.parametrize(('times', 'looked'), [(0.9, True), (1.1, False)])
def test_nothing_is_looked_for_where_the_speed_is_less_known_than_the_force(
    world: Any, times: float, looked: bool
) -> None:
    """How a curve is off its encoders leave open, alike in trials that go alike."""
    measured = world.measure(world.campaign(world.four[:2]), seed=3)
    _, base = measured.bench()
    noise = base.force_noise
    trials = []
    for trial in base.problem.trials:
        unit = curved(trial, 1.0, trial.path.noise)
        assert unit.unsteady is not None
        most = float((unit.unsteady * unit.duration).max())
        over = noise.white**2 * trial.interval + 2.0 * noise.slow**2 * noise.correlation_time
        trials.append(curved(trial, times * np.sqrt(4.0 * over / most), trial.path.noise))
    found = replace(base, problem=Problem(base.model, tuple(trials)))
    for trial, calm in zip(trials, _calm(found), strict=True):
        touching = (trial.middle > trial.t_contact + 0.2) & (trial.displacement[1:] > 0.0)
        assert calm[touching].any() == looked
        assert calm[trial.middle < trial.t_contact - 0.2].all()


@pytest.mark.parametrize(('noise', 'seen'), [(0.2, True), (0.4, False)])
def test_a_surface_that_is_off_by_less_than_the_tool_is_not_looked_at(
    world: Any, noise: float, seen: bool
) -> None:
    """A step of encoders that round is 3.5 times their noise."""
    campaign = world.campaign(world.four, recover=4.0)
    size = campaign.sensors.height_noise

    def higher(trial: Trial) -> Trial:
        height = trial.displacement_height
        phases = segment(trial.force, trial.tool_height, height)
        t_hold, t_release, loss = phases.t_hold, phases.t_release, phases.t_loss
        assert height is not None
        assert t_hold is not None
        assert t_release is not None
        assert loss is not None
        hold = np.clip((trial.force.t - t_hold) / (t_release - t_hold), 0.0, 1.0)
        force = trial.force.value + 0.5 * campaign.sensors.force_noise.std * np.sin(7.0 * hold)
        later = np.maximum(height.t - loss, 0.0)
        value = height.value + 4.0 * size * np.where(later > 0.0, np.exp(-later), 0.0)
        return replace(
            trial,
            force=Signal(trial.force.t, force),
            displacement_height=Signal(height.t, value),
        )

    measured = world.measure(campaign, seed=6, change=higher)
    prepared, _ = prepare(measured.pairs)
    found = fit_prepared(
        tuple(None if t is None else curved(t, 1e-12, noise * size) for t in prepared), Model()
    )
    bench = Workbench(found.problem.trials, None)
    left = look(bench, bench.base(found), measured.phases)
    assert any(each.curve.channel == 'height' for each in left) == seen
    # What is not looked at takes no place from what is.
    assert any(each.curve.channel == 'force' and each.beyond_chance for each in left) != seen


@pytest.mark.parametrize('taken_for', [0.01, 1.0, 10.0])
@pytest.mark.parametrize('common', [0.0, 30.0])
def test_curves_of_one_form_are_told_from_slow_noise_of_unknown_size(
    common: float, taken_for: float
) -> None:
    """A random walk in white noise, whose variance is taken for another, in six trials."""
    random = np.random.default_rng(9)
    trials, corners, curves = 6, 5, 20
    t = np.linspace(0.01, 1.0, 100)
    hats = np.maximum(1.0 - np.abs(4.0 * t[:, np.newaxis] - np.arange(corners)), 0.0)
    walk = 100.0 * np.minimum.outer(t, t)
    colour = np.linalg.cholesky(np.eye(t.size) + walk)
    white = np.linalg.inv(np.linalg.cholesky(np.eye(t.size) + taken_for * walk))
    along = np.linalg.qr(white @ hats)[0].T @ white
    seen = []
    for _ in range(300):
        force = random.standard_normal((trials, t.size)) @ colour.T + common * np.sin(9.0 * t)
        sizes = force @ along.T
        alike = float(trials * np.sum(sizes.mean(axis=0) ** 2))
        own = float(np.sum(sizes**2))
        gain = _alike(
            Smooth(alike, corners, (), ()), Smooth(own, trials * corners, (), ()), curves
        )
        seen.append(gain > SURPRISE)
    assert np.mean(seen) > 0.95 if common else np.mean(seen) < 0.01
