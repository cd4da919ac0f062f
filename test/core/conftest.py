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

"""Trials that a tool drives, for the tests of the forward model."""

from collections.abc import Callable
from dataclasses import dataclass

from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.records import FloatArray, Signal
import numpy as np
import pytest


@dataclass(frozen=True)
class Driven:
    """What a prediction has to know about a trial."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    campaign_time: float = 1800.0
    reference_depth: float = 0.010
    depth_before: float = 0.006
    zero_time: float = 0.5


@dataclass(frozen=True)
class Live:
    """
    A trial as a busy machine records it: heights at uneven intervals and stamped late.

    An arm that takes its time to start and to stop pushes a soft dough with a yield force. Only
    the force is stamped as it is measured.
    """

    push_speed: float = 0.008
    depth: float = 0.005
    seed: int = 0
    acceleration: float = 0.5
    withdrawal: float = 0.020
    air: float = 0.004
    K1: float = 2000.0
    C1: float = 1600.0
    C2: float = 2400.0
    yield_force: float = 6.0

    @property
    def t_hold(self) -> float:
        """Return when the tool has come to rest [s]."""
        way = self.air + self.depth
        return 1.0 + way / self.push_speed + self.push_speed / self.acceleration

    @property
    def t_release(self) -> float:
        """Return when it starts back [s]."""
        return self.t_hold + 6.0

    def speed(self, t: FloatArray) -> FloatArray:
        """Return the speed of the tool [m/s], positive toward the object."""
        up = self.t_release + (self.air + self.depth) / self.withdrawal

        def ramp(start: float, stop: float, full: float) -> FloatArray:
            a = self.acceleration
            return np.clip(np.minimum(a * (t - start), a * (stop - t)), 0.0, full)

        pushed = ramp(1.0, self.t_hold, self.push_speed)
        back = up + self.withdrawal / self.acceleration
        return np.asarray(pushed - ramp(self.t_release, back, self.withdrawal))

    def make(self) -> tuple[Signal, Signal]:
        """Return the force [N] and the tool's height [m]."""
        step = 2.5e-4
        grid = np.arange(0.0, self.t_release + 3.0, step)
        speed = self.speed(grid)
        travel = np.concatenate(([0.0], np.cumsum(0.5 * step * (speed[1:] + speed[:-1]))))
        force = np.zeros_like(grid)
        z = 0.0
        first = int(np.searchsorted(travel, self.air))
        for i, v in enumerate(speed[first:].tolist(), first):
            flows = (self.C2 * v - self.K1 * z + self.yield_force) / (self.C1 + self.C2)
            rate = flows if self.C1 * flows + self.K1 * z > self.yield_force else v
            force[i] = self.K1 * z + self.C1 * rate
            if force[i] < 0.0:
                force[i] = 0.0
                break
            z += rate * step
        rng = np.random.default_rng(self.seed)
        t = np.arange(2e-4, grid[-1], 1e-3)
        measured = np.interp(t, grid, force) + 0.02 * rng.standard_normal(t.size)
        stamps, taken, now = [], [], 0.0
        while now < grid[-1] - 0.2:
            stall = rng.exponential(0.008) if rng.random() < 0.1 else 0.0
            # A stalled process leaves a gap, or gives a height that was taken before it stalled.
            before = rng.random() < 0.5
            taken.append(now if before else now + stall)
            stamps.append(now + stall + rng.uniform(0.0, 0.001))
            now = stamps[-1] + rng.uniform(0.001, 0.003)
        height = 0.1 - np.interp(taken, grid, travel) + 1e-6 * rng.standard_normal(len(taken))
        return Signal(t, measured), Signal(np.array(stamps), np.round(height, 6))


@pytest.fixture(scope='session')
def live() -> type[Live]:
    """Return the maker of trials that a busy machine has recorded."""
    return Live


@pytest.fixture
def scale() -> Scale:
    """Return what a campaign on a soft dough looks like."""
    return Scale(
        K1=5000.0,
        C1=84000.0,
        C2=107000.0,
        force=100.0,
        depth=0.010,
        push_speed=1.3e-3,
        contact_time=25.0,
        sampling_interval=1e-2,
        campaign_time=3600.0,
        disturbance_amplitude=0.7,
        disturbance_frequency=7.0,
    )


@pytest.fixture
def driven() -> Callable[..., Driven]:
    """Return a maker of trials: approach, push, hold, a pull in steps, and another push."""

    def make(
        interval: float = 1e-2, shift: float = 0.0, jitter: float = 0.0, touch: float = 1.003
    ) -> Driven:
        t = np.arange(0.0, 50.0 + 0.5 * interval, interval)
        t[1:-1] += jitter * interval * np.random.default_rng(1).uniform(-1.0, 1.0, t.size - 2)
        knots = [0.0, touch, 9.0, 20.0, 21.0, 24.0, 24.5, 35.0, 38.0, 42.0, 50.0]
        depth = [-1.3, 0.0, 10.0, 10.0, 9.7, 9.7, -5.0, -5.0, 10.3, 10.3, 9.34]
        displacement = np.interp(t, knots, 1e-3 * np.array(depth))
        return Driven(t + shift, displacement, np.arange(0.013, 49.9, 1.0 / 30.0) + shift)

    return make
