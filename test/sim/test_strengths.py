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

"""Effects of a wanted strength."""

from dataclasses import replace

from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body, EFFECTS
from hapticvision_ros.sim.strengths import LinearMisfit, scale, strength_for, undeclared
import pytest

CAMPAIGN = Campaign(
    Body(2000.0, 1600.0, 2400.0),
    (Push(0.008, 0.006, 3.0, 2.0), Push(0.004, 0.004, 3.0, 2.0)),
    Sensors(ForceNoise(0.05), 5e-5),
    rest=30.0,
)


@pytest.fixture(scope='module')
def misfit() -> LinearMisfit:
    """Return this world's own measure."""
    return LinearMisfit(CAMPAIGN)


@pytest.mark.parametrize(
    'name', ['yield_force', 'height_bias', 'periodic_disturbance', 'fracture']
)
def test_a_strength_makes_the_base_model_miss_by_what_was_asked(
    name: str, misfit: LinearMisfit
) -> None:
    small, large = (strength_for(r, name, CAMPAIGN, misfit) for r in (0.1, 0.3))
    assert small < large
    effect = undeclared(name, large, CAMPAIGN)
    reached = misfit(run(CAMPAIGN, [effect], seed=0, ideal=True).trials)
    assert reached == pytest.approx(0.3, rel=0.02)


def test_what_the_base_model_can_imitate_is_no_misfit(misfit: LinearMisfit) -> None:
    body = replace(CAMPAIGN.body, K1=1.01 * CAMPAIGN.body.K1, C2=0.99 * CAMPAIGN.body.C2)
    moved = replace(CAMPAIGN, body=body, surface_offset=1e-6)
    trials = run(moved, seed=0, ideal=True).trials
    other = run(CAMPAIGN, [undeclared('yield_force', 0.01, CAMPAIGN)], seed=0, ideal=True).trials
    # One percent changes the force by two times the noise; what is left is of second order.
    assert misfit(trials) < 0.03
    assert misfit(other) > 0.1


def test_a_misfit_that_no_strength_reaches_is_refused() -> None:
    with pytest.raises(InputError, match='no strength of yield_force'):
        strength_for(1.0, 'yield_force', CAMPAIGN, lambda trials: 0.0)


def test_every_effect_has_a_strength() -> None:
    for name, quantities in EFFECTS.items():
        assert len(undeclared(name, 0.1, CAMPAIGN).values) == len(quantities)
    with pytest.raises(UsageError, match='no effect'):
        undeclared('magic', 0.1, CAMPAIGN)


def test_the_scale_is_that_of_the_campaign() -> None:
    large = scale(CAMPAIGN)
    # C2 v is what the force of the fastest push tends to, from C1 C2 / (C1 + C2) v.
    assert 960.0 * 0.008 < large.force < 2400.0 * 0.008
    assert large.depth == 0.006
    assert large.push_time == pytest.approx(0.75)
