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


"""Trials of a known body, analysed by the real pipeline, for the tests of the report."""

from dataclasses import replace
from types import MappingProxyType

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import (
    Bootstrap,
    Candidate,
    Diagnosis,
    NextTrial,
    Unexplained,
)
from hapticvision_ros.core.models.three_element import respond, ThreeElement
from hapticvision_ros.core.pipeline import analyse, analyse_campaign, CampaignAnalysis
from hapticvision_ros.core.records import Signal, Trial
import numpy as np
import pytest

BODY = ThreeElement(K1=2000.0, C1=1600.0, C2=2400.0)
FORCE_THAT_REMAINS = 6.0
FORCE_NOISE, HEIGHT_NOISE = 0.02, 2e-5
ORIGINAL_HEIGHT = 0.04
NASTY_NAME = 'dough <b>1</b> & "co"'


def make_trial(name: str, push_speed: float = 5e-3, **changes: object) -> Trial:
    """
    Return a trial of `BODY`, which keeps a force in the hold that the model does not have.

    The tool touches at 2 s, goes 5 mm deep, holds for 8 s and withdraws; the recovery lasts 8 s.
    """
    depth, touch = 5e-3, 2.0
    stop = touch + depth / push_speed
    release = stop + 8.0
    knots = np.array([touch, stop, release, release + 1.0, release + 9.0])
    path = np.array([0.0, depth, depth, depth - 0.05, depth - 0.05])
    t = np.arange(0.0, knots[-1], 1e-3)
    slow = np.arange(0.0, knots[-1], 0.02)
    rng = np.random.default_rng(7)
    response = respond(BODY, t, knots, path)
    touching = (t > touch) & (t < (response.t_loss or t[-1]))
    force = np.where(t < touch, 0.0, response.force)
    force += np.where(touching & (t > stop), FORCE_THAT_REMAINS, 0.0)
    # The force that remains leaves the spring stretched by as much, which comes back when free.
    bounced = FORCE_THAT_REMAINS / BODY.K1 * -np.expm1(-(slow - release) / BODY.retardation_time)
    height = np.where(slow < release, np.interp(slow, knots, path), depth - bounced)
    tool = np.where(slow < touch, -push_speed * (touch - slow), np.interp(slow, knots, path))
    fields: dict[str, object] = {
        'name': name,
        'start_ns': 1_700_000_000 * 10**9,
        'force': Signal(t, force + rng.normal(0.0, FORCE_NOISE, t.size) + 0.3),
        'tool_height': Signal(slow, ORIGINAL_HEIGHT - tool),
        'displacement_height': Signal(slow, height + rng.normal(0.0, HEIGHT_NOISE, slow.size)),
        'warnings': (f'a message of {name} came twice',),
        'provenance': MappingProxyType({'source': '<script>alert(1)</script>', 'licence': 'MIT'}),
    }
    return Trial(**(fields | changes))  # type: ignore[arg-type]


@pytest.fixture(scope='session')
def campaign() -> CampaignAnalysis:
    """Return a whole trial, one without any height, and one held out with a nasty name."""
    whole = make_trial('whole')
    blind = make_trial('blind', displacement_height=None, displacement_source='none')
    held_out = make_trial(NASTY_NAME, push_speed=2e-3)
    return analyse_campaign([analyse(whole), analyse(blind)], [analyse(held_out)], model=Model())


@pytest.fixture(scope='session')
def diagnosed(campaign: CampaignAnalysis) -> CampaignAnalysis:
    """Return the same trials with a model of what remains, and a diagnosis that says all."""
    both = analyse_campaign(campaign.trials, campaign.held_out, model=Model(('parallel_spring',)))
    assert both.before.fit is not None
    assert both.after is not None and both.after.fit is not None
    found = Diagnosis(
        status='partly_explained',
        effects=('parallel_spring',),
        sets=(('parallel_spring', 'springpot'),),
        not_testable=('ageing', 'clock_offset'),
        look_alikes=(('parallel_spring', 'springpot', 0.987),),
        ranking=(
            Candidate('parallel_spring', 4321.0, 4312.0, 0.12, 17.0),
            Candidate('damage', -0.3, -9.5, None, None),
        ),
        unexplained=Unexplained(0.23, ('the force at the start of the hold, by 0.3 N',)),
        next_trial=NextTrial(
            2e-4, 5e-3, 60.0, ('parallel_spring', 'springpot'), 121.0, 'they part in slow pushes'
        ),
        before=both.before.fit,
        after=both.after.fit,
        warnings=('repeats are missing, so scatter cannot be told from an effect',),
        bootstrap=Bootstrap(50, 2, 0.0196),
    )
    return replace(both, diagnosis=found)
