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


"""
Campaigns with an undeclared effect, from a world that shares no code with what is tested.

Each is measured, written as bags and read back, as a cell's would be. Diagnoses take seconds, so
that they are made once for all tests.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import Diagnosis
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.fit.campaign import fit_prepared, pairs_of
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    peak_force,
    Push,
    run,
    Sensors,
    Truth,
    write_bags,
)
from hapticvision_ros.sim.specimen import (
    Body,
    integrate,
    Motion,
    parameter_vector,
    Undeclared,
)
import numpy as np
import pytest

type Pair = tuple[Trial, Segmentation]

BODY = Body(1000.0, 900.0, 1600.0)
FOUR = ((0.004, 0.006), (0.012, 0.006), (0.004, 0.003), (0.012, 0.0045))
UNSEEN = (0.007, 0.005)
REPEATED = ((0.004, 0.006), (0.012, 0.004)) * 3
DEPTH = 0.006
CORRELATION_TIME = 0.01
_STEP = 1e-3
SURFACE = 0.05
"""Height of the object [m]."""


@dataclass(frozen=True)
class Measured:
    """The trials of a campaign with their phases, and the truth behind them."""

    pairs: tuple[Pair, ...]
    truth: Truth

    @property
    def phases(self) -> list[Segmentation]:
        """Return the phases of the trials."""
        return [phases for _, phases in self.pairs]

    def bench(self, scatter: float | None = None) -> tuple[Workbench, Refit]:
        """Return the trials on a bench, and the base model fitted to them."""
        prepared, _ = prepare(pairs_of(self.pairs))
        found = fit_prepared(prepared, Model())
        plain = Workbench(found.problem.trials, None)
        if scatter is None:
            return plain, plain.base(found)
        bench = Workbench(found.problem.trials, np.full(3, scatter))
        return bench, bench.base(found)


@dataclass(frozen=True)
class Case:
    """A diagnosis, what it was made from, and a trial that it has not seen."""

    measured: Measured
    unseen: tuple[Pair, ...]
    found: Diagnosis

    def errors(self, which: str) -> FloatArray:
        """Return by how much K1, C1 and C2 are off `before` or `after` the loop, relatively."""
        body = self.measured.truth.body
        theta = getattr(self.found, which).theta[:3]
        return np.asarray(np.abs(np.exp(theta) / [body.K1, body.C1, body.C2] - 1.0))


class World:
    """The simulated cell."""

    body = BODY
    four, repeated = FOUR, REPEATED

    def campaign(
        self,
        pushes: Sequence[tuple[float, float]] = FOUR,
        *,
        hold: float = 4.0,
        recover: float = 3.0,
        rate: float = 200.0,
        scatter: float = 0.0,
    ) -> Campaign:
        """Return pushes (speed, depth) on the body, with noise of 0.5 % of the full scale."""
        made = tuple(Push(speed, depth, hold, recover) for speed, depth in pushes)
        force = peak_force(Campaign(BODY, made, Sensors(ForceNoise(0.0), 0.0)))
        sensors = Sensors(
            ForceNoise(0.003 * force, 0.004 * force, CORRELATION_TIME),
            0.005 * DEPTH,
            force_rate=rate,
            tool_rate=rate,
            force_zero=0.02 * force,
        )
        return Campaign(BODY, made, sensors, scatter=scatter, surface_scatter=1e-5)

    def measure(
        self,
        campaign: Campaign,
        *effects: Undeclared,
        seed: int,
        change: Callable[[Trial], Trial] = lambda trial: trial,
    ) -> Measured:
        """Return what a campaign gives, straight from the sensors."""
        result = run(campaign, effects, seed=seed)
        return Measured(phased([change(trial) for trial in result.trials]), result.truth)


def phased(trials: Sequence[Trial]) -> tuple[Pair, ...]:
    """Return trials with their phases."""
    return tuple((t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials)


@pytest.fixture(scope='session')
def world() -> World:
    """Return the simulated cell."""
    return World()


@pytest.fixture(scope='session')
def noise_only(world: World) -> Measured:
    """Return a campaign without any effect."""
    return world.measure(world.campaign(), seed=1)


@pytest.fixture(scope='session')
def yielding(world: World) -> Measured:
    """Return a campaign on a body with a clear yield force."""
    return world.measure(world.campaign(), Undeclared('yield_force', (0.37,)), seed=2)


@pytest.fixture(scope='session')
def case(world: World, tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Case]:
    """Return what makes a case: it goes through bags, and is diagnosed once."""

    @cache
    def make(
        effect: Undeclared | None,
        seed: int,
        pushes: tuple[tuple[float, float], ...] = FOUR,
        scatter: float = 0.0,
    ) -> Case:
        campaign = world.campaign((*pushes, UNSEEN), scatter=scatter)
        result = run(campaign, [] if effect is None else [effect], seed=seed)
        folder: Path = tmp_path_factory.mktemp('bags')
        pairs = phased([read_trial(path) for path in write_bags(result, folder)])
        seen = Measured(pairs[:-1], result.truth)
        return Case(seen, pairs[-1:], diagnose(seen.pairs))

    return make


@pytest.fixture
def without_height() -> Callable[[Trial], Trial]:
    """Return what takes a trial's own range sensor away: the tool's height stands in for it."""
    return lambda trial: replace(trial, displacement_source='tool')


def _speeds(t: FloatArray, speed: float, stop: float, smooth: float, lag: float) -> FloatArray:
    """Return the speed of an arm that stops, by two moving averages and a lag."""
    commanded = np.where(t < stop, speed, 0.0)
    count = round(smooth / _STEP)
    for _ in range(2):
        total = np.cumsum(np.concatenate((np.full(count, commanded[0]), commanded)))
        commanded = (total[count:] - total[:-count]) / count
    followed = np.empty(t.size)
    last, keep = commanded[0], np.exp(-_STEP / lag)
    for k, each in enumerate(commanded):
        last = keep * last + (1.0 - keep) * each
        followed[k] = last
    return followed


def smoothed_pushes(
    body: Body,
    depths: Sequence[float],
    *,
    speed: float,
    smooth: float,
    lag: float,
    resolution: float,
    noise: float,
    hold: float = 6.0,
    seed: int = 0,
) -> list[Pair]:
    """
    Return pushes that hold.

    The commands of the arm are smoothed twice, and it follows them with a lag; the force comes at
    500 Hz, the encoders at 125 Hz.
    """
    random = np.random.default_rng(seed)
    made = []
    for index, depth in enumerate(depths):
        gap = 1.5 * speed
        stop = (gap + depth) / speed
        t = np.arange(0.0, stop + hold, _STEP)
        v = _speeds(t, speed, stop, smooth, lag)
        way = np.concatenate(([0.0], np.cumsum(0.5 * (v[1:] + v[:-1]) * _STEP))) - gap
        motion = Motion(t, way, v, np.append(np.diff(v) / _STEP, 0.0))
        history = integrate(t, motion, parameter_vector(body))
        impulse = np.concatenate(([0.0], np.cumsum(history.force * np.diff(history.t))))
        at = np.arange(0.01, t[-1] - 0.01, 0.002)
        mean = np.interp(at + 0.001, history.t, impulse) - np.interp(
            at - 0.001, history.t, impulse
        )
        force = Signal(at, mean / 0.002 + noise * random.standard_normal(at.size))
        tool_t = np.arange(0.003, t[-1], 0.008)
        read = SURFACE - np.interp(tool_t, t, way)
        if resolution:
            read = np.round(read / resolution) * resolution
        height_t = np.arange(0.01, t[-1], 1.0 / 30.0)
        height = np.interp(height_t, history.t, history.surface)
        height += 3e-5 * random.standard_normal(height_t.size)
        trial = Trial(
            name=f'trial_{index + 1:02d}',
            start_ns=1_700_000_000_000_000_000 + index * 60_000_000_000,
            force=force,
            tool_height=Signal(tool_t, read),
            displacement_height=Signal(height_t, height),
            displacement_source='topic',
            push_velocity=None,
            phases=(),
        )
        made.append((trial, segment(trial.force, trial.tool_height, trial.displacement_height)))
    return made


@pytest.fixture
def smoothed() -> Callable[..., list[Pair]]:
    """Return `smoothed_pushes`."""
    return smoothed_pushes
