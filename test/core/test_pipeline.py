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


"""What is taken for what before a trial is analysed."""

from dataclasses import replace

from hapticvision_ros.core.pipeline import analyse, TOLD_BY_THE_TOOL
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import Body, Campaign, ForceNoise, Push, run, Sensors
import numpy as np
import pytest

NOISE = 2e-6
"""Of the encoders and of a height of its own [m]."""


@pytest.fixture(scope='module')
def pushed() -> Trial:
    """Return a push whose encoders are noisy."""
    campaign = Campaign(
        Body(800.0, 900.0, 2000.0),
        (Push(0.002, 0.004, 4.0, 3.0),),
        Sensors(ForceNoise(0.01), 3e-5),
    )
    trial: Trial = run(campaign, [], seed=3).trials[0]
    tool = trial.tool_height
    noise = NOISE * np.random.default_rng(8).standard_normal(len(tool))
    return replace(trial, tool_height=Signal(tool.t, tool.value + noise))


def _copied(trial: Trial, *, until_loss: bool = False, own_noise: float = 0.0) -> Trial:
    """Return it with heights that are what the tool reads below the surface."""
    tool, phases = trial.tool_height, analyse(trial).segmentation
    assert phases.contact_height is not None and phases.t_loss is not None
    depth = phases.contact_height - tool.value
    depth += own_noise * np.random.default_rng(9).standard_normal(depth.size)
    seen = tool.t < (phases.t_loss if until_loss else np.inf)
    return replace(trial, displacement_height=Signal(tool.t[seen], np.maximum(depth, 0.0)[seen]))


@pytest.mark.parametrize('until_loss', [False, True])
def test_a_height_that_copies_the_tool_is_the_tools(pushed: Trial, until_loss: bool) -> None:
    made = analyse(_copied(pushed, until_loss=until_loss))
    assert made.trial.displacement_source == 'tool'
    assert TOLD_BY_THE_TOOL in made.warnings
    assert not made.paper.H0.known
    assert made.paper.H0.reason == "there is no height but the tool's, and it left the object"


def test_a_height_of_a_sensor_of_its_own_stays_one(pushed: Trial) -> None:
    made = analyse(_copied(pushed, own_noise=NOISE))
    assert made.trial.displacement_source == 'topic'
    assert TOLD_BY_THE_TOOL not in made.warnings


def test_a_height_that_shows_the_recovery_is_no_copy(pushed: Trial) -> None:
    """As of a simulation that notes where the surface is, pressed or not."""
    copied, shown = _copied(pushed).displacement_height, pushed.displacement_height
    assert copied is not None and shown is not None
    recovers = np.interp(copied.t, shown.t, shown.value)
    up = (copied.value == 0.0) & (copied.t > copied.t[np.argmax(copied.value)])
    both = Signal(copied.t, np.where(up, recovers, copied.value))
    assert analyse(replace(pushed, displacement_height=both)).trial.displacement_source == 'topic'


def test_a_reading_far_off_makes_no_copies(pushed: Trial) -> None:
    """A range finder that sees nothing now and then."""
    own = _copied(pushed, own_noise=0.15 * NOISE, until_loss=True)
    height = own.displacement_height
    assert height is not None
    value = height.value.copy()
    value[len(value) // 2] = 3.0
    far = analyse(replace(own, displacement_height=Signal(height.t, value)))
    assert far.trial.displacement_source == 'topic'


def test_a_height_that_goes_its_own_way_for_a_while_is_no_copy(pushed: Trial) -> None:
    height = _copied(pushed).displacement_height
    assert height is not None
    down = np.flatnonzero(height.value > 0.0)
    first, last = down[[down.size // 2, down.size * 11 // 20]]
    value = height.value.copy()
    value[first:last] -= 1e-4
    made = analyse(replace(pushed, displacement_height=Signal(height.t, value)))
    assert made.trial.displacement_source == 'topic'


def test_a_recovery_that_is_hardly_seen_is_one(pushed: Trial) -> None:
    shown = _copied(pushed, until_loss=True).displacement_height
    assert shown is not None
    t = shown.t[-1] + 0.004 * np.arange(1, 6)
    late = Signal(np.append(shown.t, t), np.append(shown.value, np.full(5, 0.001)))
    assert len(late) > 600
    made = analyse(replace(pushed, displacement_height=late))
    assert made.trial.displacement_source == 'topic'


def test_heights_that_rest_with_the_tool_are_no_copies(pushed: Trial) -> None:
    """Both read the same for as long as the tool is held."""
    shown, phases = _copied(pushed).displacement_height, analyse(pushed).segmentation
    assert shown is not None and phases.t_hold is not None
    held = shown.between(phases.t_hold + 0.5, phases.t_hold + 3.0)
    tool = pushed.tool_height
    steady = np.where((tool.t > held.t[0]) & (tool.t < held.t[-1]), tool.value.min(), tool.value)
    still = Signal(held.t, np.full(len(held), float(held.value.mean())))
    start = Signal(np.append(0.0, still.t), np.append(0.0, still.value))
    trial = replace(pushed, tool_height=Signal(tool.t, steady), displacement_height=start)
    assert analyse(trial).trial.displacement_source == 'topic'


def test_a_height_without_samples_is_none_to_compare(pushed: Trial) -> None:
    nothing = Signal(np.empty(0), np.empty(0))
    made = analyse(replace(pushed, displacement_height=nothing))
    assert made.trial.displacement_source == 'topic'
