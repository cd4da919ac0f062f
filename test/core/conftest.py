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
from hapticvision_ros.core.records import FloatArray
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
    zero_time: float = 0.5


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
