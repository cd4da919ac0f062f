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

from hapticvision_ros.core.diagnosis.structure import GATE, look
from hapticvision_ros.core.records import Signal
from hapticvision_ros.sim.campaigns import peak_force
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest


@pytest.mark.parametrize('creeps', [False, True])
def test_a_load_cell_that_is_slow_to_come_back_is_seen_once_the_tool_is_away(
    world: Any, creeps: bool
) -> None:
    """What a zero does by itself is another in each trial; this follows the force before."""
    effects = [Undeclared('cell_creep', (0.1, 1.0))] if creeps else []
    pushes = (*world.repeated, *world.four)
    measured = world.measure(world.campaign(pushes, recover=6.0), *effects, seed=4)
    bench, base = measured.bench()
    found = [each for each in look(bench, base, measured.phases) if each.gain > GATE]
    curves = [(each.curve.channel, each.curve.phase, each.curve.size) for each in found]
    assert (('force', 'recover', 'alike') in curves) == creeps
    assert ('force', 'recover', 'own') not in curves


def test_a_zero_that_wanders_in_each_trial_by_itself_is_nothing_that_is_left(world: Any) -> None:
    size = 0.01 * peak_force(world.campaign())
    random = np.random.default_rng(6)
    zeros = iter(random.normal(0.0, size, (4, 2)))

    def drifting(trial: Any) -> Any:
        first, last = next(zeros)
        t = trial.force.t
        value = trial.force.value + first + (last - first) * np.sin(t / t[-1])
        return replace(trial, force=Signal(t, value))

    measured = world.measure(world.campaign(), seed=5, change=drifting)
    bench, base = measured.bench()
    found = look(bench, base, measured.phases)
    assert not [each for each in found if each.gain > GATE and each.curve.phase == 'recover']
