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

"""What an experiment does after its grid: the rules, and the whole loop on a simulated body."""

from dataclasses import replace
import json
import math
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Literal

from hapticvision_ros.core.autonomy import (
    _other,
    _repeat,
    Budget,
    Cell,
    decide,
    Decision,
    Ending,
    Findings,
    look,
    Parameter,
    PATIENCE,
    Push,
    Spent,
)
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.push_control import expected_duration, PushGoal, PushLimits
from hapticvision_ros.core.records import Segmentation, Signal, Trial
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, run, Sensors
from hapticvision_ros.sim.campaigns import Push as MadePush
from hapticvision_ros.sim.specimen import Body, Undeclared
import numpy as np
import pytest
import yaml

ARM = yaml.safe_load(
    (Path(__file__).parents[2] / 'config' / 'arm_push_controller.yaml').read_text()
)['/**']['ros__parameters']
BUDGET = Budget(trials=4, time=100.0, precision=0.05)
TIGHT = {'K1': Parameter(1000.0, 2.0, 'N/m'), 'F_y': Parameter(0.5, 0.01, 'N')}
LOOSE = TIGHT | {'F_y': Parameter(0.5, 0.1, 'N')}
SEPARATE = Push('separate', 0.001, 0.002, 6.0, ('a', 'b'), 8.0, 'a and b answer it differently')
SHARPEN = Push('sharpen', 0.001, 0.002, 6.0, ('F_y',), 3.0, 'F_y is told least')
REPEAT = Push('repeat', 0.004, 0.006, 2.0, (), 0.0, 'only a repeat tells', like=1)


def cell(**changes: Any) -> Cell:
    """Return what the shipped arm allows, with changes of its limits."""
    limits = {name: ARM[name] for name in PushLimits.__dataclass_fields__} | changes
    usual = {name: ARM[name] for name in PushGoal.__dataclass_fields__ if name in ARM}
    return Cell(PushLimits(**limits), PushGoal(**usual), 0.004, 0.004, 0.006, 2.0)


def found(**changes: Any) -> Findings:
    """Return that an effect explains trials of which one push was repeated, with changes."""
    values: dict[str, Any] = {
        'status': 'explained',
        'effects': ('a',),
        'sets': (('a',),),
        'parameters': TIGHT,
        'trials': 4,
        'kinds': 3,
        'push': SHARPEN,
        'repeat': REPEAT,
    }
    return Findings(**(values | changes))


def decision(
    findings: Findings,
    budget: Budget = BUDGET,
    pushes: tuple[Push, ...] = (),
    time: float = 0.0,
    before: Findings | Literal['same'] | None = 'same',
) -> Decision:
    """Return what is decided where each push takes 10 s; the answer has outlived one."""
    then = replace(findings, trials=findings.trials - 1) if before == 'same' else before
    return decide(findings, budget, Spent(pushes, time, then), lambda push: 10.0)


def test_one_effect_and_known_parameters_are_enough() -> None:
    end = decision(found())
    assert (end.ending, end.push) == (Ending.DECIDED, None)
    assert end.reason == 'a explains the trials, and every parameter is known to 2 % or better'


def test_no_effect_and_known_parameters_are_enough_too() -> None:
    nothing = found(status='none', effects=(), sets=())
    end = decision(nothing, before=replace(nothing, trials=3))
    assert end.ending is Ending.TIGHT
    assert end.reason.startswith('nothing is left that noise does not explain')


NOTHING = {'status': 'none', 'effects': (), 'sets': ()}


@pytest.mark.parametrize(
    ('changes', 'before'),
    [
        ({}, None),
        (NOTHING, None),
        ({}, NOTHING),
        (NOTHING, {}),
        ({}, {'effects': ('b',), 'sets': (('b', 'a'),)}),
        ({}, {'status': 'partly_explained'}),
        ({}, {'trials': 4}),
    ],
    ids=['grid', 'no_effect', 'new', 'gone', 'another', 'beside_a_rest', 'push_failed'],
)
def test_an_answer_that_has_not_outlived_a_push_is_tested_by_one(
    changes: dict[str, Any], before: dict[str, Any] | None
) -> None:
    then = None if before is None else replace(found(), **({'trials': 3} | before))
    answer = found(**changes)
    other = decision(answer, before=then).push
    assert other is not None
    assert (other.purpose, other.push_speed) == ('test', SHARPEN.push_speed)
    assert 'an answer that no push has tested yet' in other.reason
    # Where no push tells more it has to do.
    assert decision(replace(answer, push=None), before=then).push is None


def test_an_answer_is_tested_by_the_push_that_is_least_like_those_made() -> None:
    other = Push('test', 0.008, 0.006, 2.0, (), 0.0, 'it is least like those that were made')
    for changes, purpose in (({}, 'test'), ({'status': 'unexplained'}, 'explore')):
        wanted = decision(found(other=other, **changes), before=None).push
        assert wanted is not None
        assert (wanted.purpose, wanted.push_speed, wanted.hold_time) == (purpose, 0.008, 2.0)
        # Only where something is expected of a push at all.
        assert wanted.gain == SHARPEN.gain
    # What sharpens a parameter is left to the diagnosis.
    assert decision(found(other=other, parameters=LOOSE)).push == SHARPEN


def test_the_push_least_like_those_made_repeats_none_until_all_are_made() -> None:
    made, others = [(0.004, 0.006, 2.0)], list[tuple[float, float]]()
    allowed = cell().reach()
    for _ in range(9):
        trials: Any = [SimpleNamespace(segmentation=_phases(*each)) for each in made]
        other = _other(trials, allowed)
        if other is None:
            break
        assert other.depth == 0.006
        others.append((other.push_speed, other.hold_time))
        made.append((other.push_speed, other.depth, other.hold_time))
    assert others == [(0.00133, 6.0), (0.004, 6.0), (0.00133, 2.0), (0.0023, 6.0), (0.0023, 2.0)]


def test_a_push_without_a_hold_is_like_no_other() -> None:
    trials: Any = [SimpleNamespace(segmentation=_phases(0.004, 0.006, -0.01))]
    assert _other(trials, cell().reach()) is None


def test_a_push_in_steps_is_one_to_its_depth_and_repeated_by_none() -> None:
    whole = replace(_phases(0.004, 0.006, 6.0), t_first=0.5)
    first = replace(whole, t_hold=0.5, t_release=None, depth=0.002, whole=whole)
    force = Signal(np.arange(2.0), np.array([0.0, 9.0]))
    steps = SimpleNamespace(segmentation=first, trial=SimpleNamespace(force=force))
    weaker = Signal(np.arange(2.0), np.array([0.0, 2.0]))
    straight = SimpleNamespace(
        segmentation=_phases(0.004, 0.005, 2.0), trial=SimpleNamespace(force=weaker)
    )
    trials: Any = [steps, straight]
    again = _repeat(trials)
    assert again is not None
    assert (again.like, again.depth, again.hold_time) == (1, 0.005, 2.0)
    assert _repeat(trials[:1]) is None
    only: Any = [SimpleNamespace(segmentation=_phases(0.004, 0.006, 6.0))]
    assert _other(trials[:1], cell().reach()) == _other(only, cell().reach())


def _phases(speed: float, depth: float, hold: float) -> Segmentation:
    """Return the phases of a push."""
    return Segmentation(0.0, 1.0, 1.0 + hold, None, 20.0, 0.04, 0.0, speed, depth)


def test_a_push_that_separates_tests_the_effect_that_led_before_it() -> None:
    led = found(sets=(('a', 'b'),), trials=3)
    assert decision(found(), before=led).ending is Ending.DECIDED
    # One push may have gone wrong: the effect that it has brought to the front needs another.
    followed = found(effects=('b',), sets=(('b', 'a'),), trials=3)
    assert decision(found(), before=followed).push is not None


def test_pushes_that_fail_to_test_an_answer_come_to_an_end() -> None:
    other = decision(found(), before=None).push
    assert other is not None
    generous = Budget(trials=100)
    assert decision(found(), generous, (other,) * (PATIENCE - 1), before=None).push == other
    end = decision(found(), generous, (other,) * PATIENCE, before=None)
    assert end.ending is Ending.NOTHING_HELPS
    assert end.reason == 'the answer could not be tested: 3 pushes for it have failed'
    # Pushes for another answer are none for this one.
    earlier = (replace(other, about=('b',)), other, other)
    assert decision(found(), generous, earlier, before=None).push == other


def test_effects_that_are_confounded_are_told_apart_first() -> None:
    confounded = found(sets=(('a', 'b'),), parameters=LOOSE, push=SEPARATE)
    assert decision(confounded) == Decision(SEPARATE, None, SEPARATE.reason)


def test_a_parameter_that_is_known_too_little_is_sharpened() -> None:
    assert decision(found(parameters=LOOSE)).push == SHARPEN
    # Twenty percent are enough for who asks for no more.
    assert decision(found(parameters=LOOSE), replace(BUDGET, precision=0.2)).push is None
    assert decision(found(parameters=LOOSE), replace(BUDGET, precision=0.0)).push is None


def test_a_parameter_that_is_not_told_is_never_tight() -> None:
    untold = TIGHT | {'C2': Parameter(None, None, 'N.s/m')}
    assert decision(found(parameters=untold)).push == SHARPEN
    end = decision(found(parameters=untold, push=None))
    assert end.ending is Ending.NOTHING_HELPS
    assert end.reason.startswith('the trials do not tell C2')


@pytest.mark.parametrize('status', ['partly_explained', 'unexplained'])
def test_what_several_trials_leave_asks_for_a_repeat_before_anything_else(status: str) -> None:
    left = found(status=status, sets=(('a', 'b'),), kinds=4, push=SEPARATE)
    assert decision(left).push == REPEAT
    assert decision(replace(left, kinds=3)).push == SEPARATE
    # One trial does not scatter.
    assert decision(replace(left, trials=1, kinds=1)).push == SEPARATE


def test_without_room_for_a_repeat_scatter_cannot_be_told() -> None:
    left = found(status='partly_explained', kinds=4)
    end = decision(left, pushes=(SHARPEN,) * 4)
    assert end.ending is Ending.SCATTER
    assert 'no push was repeated, and the budget of 4 trials after the grid is spent' in end.reason


def test_what_no_effect_explains_is_given_some_pushes_that_differ() -> None:
    left = found(status='partly_explained', rest=('force in hold, 0.2 N',))
    other = decision(left).push
    assert other is not None
    assert (other.purpose, other.push_speed) == ('explore', SHARPEN.push_speed)
    generous = Budget(trials=100)
    assert decision(left, generous, (other,) * (PATIENCE - 1)).push == other
    end = decision(left, generous, (other,) * PATIENCE)
    assert end.ending is Ending.NOTHING_HELPS
    assert end.reason == (
        'a explains a part, and something is left that no known effect explains (force in hold, '
        '0.2 N), and 3 pushes that differ have not shown what it is'
    )


@pytest.mark.parametrize(
    ('push', 'parameters', 'sets'),
    [
        (replace(SEPARATE, gain=0.9), TIGHT, (('a', 'b'),)),
        (replace(SHARPEN, gain=1.04), LOOSE, (('a',),)),
        (None, LOOSE, (('a',),)),
    ],
    ids=['separation', 'sharpening', 'none'],
)
def test_a_push_that_promises_next_to_nothing_is_not_made(
    push: Push | None, parameters: dict[str, Parameter], sets: tuple[tuple[str, ...], ...]
) -> None:
    end = decision(found(push=push, parameters=parameters, sets=sets))
    assert end.ending is Ending.NOTHING_HELPS
    assert 'no push within the limits of the cell tells more' in end.reason


def test_the_budget_of_trials_and_that_of_time_end_it() -> None:
    open_ = found(sets=(('a', 'b'),), push=SEPARATE)
    other = replace(SEPARATE, about=('b', 'c'))
    end = decision(open_, pushes=(other,) * 4)
    assert end.ending is Ending.BUDGET
    assert end.reason == (
        'a and b are not told apart, and the budget of 4 trials after the grid is spent'
    )
    assert decision(open_, time=90.0).push == SEPARATE
    end = decision(open_, time=90.5)
    assert end.ending is Ending.BUDGET
    assert 'would take 10 s, of which the budget of 100 s leaves 10 s' in end.reason
    assert decision(open_, replace(BUDGET, time=0.0), time=1e6).push == SEPARATE


def test_the_same_question_is_not_asked_for_ever() -> None:
    open_ = found(sets=(('a', 'b'),), push=SEPARATE)
    generous = Budget(trials=100)
    assert decision(open_, generous, (SEPARATE,) * (PATIENCE - 1)).push == SEPARATE
    end = decision(open_, generous, (SEPARATE,) * PATIENCE)
    assert end.ending is Ending.NOTHING_HELPS
    assert end.reason == '3 pushes that were to tell a and b apart have not'
    # An answer in between is progress.
    assert decision(open_, generous, (SEPARATE, SHARPEN, SEPARATE)).push == SEPARATE


@pytest.mark.parametrize(
    ('changes', 'says'),
    [
        ({'trials': 0}, 'budget_trials is 0'),
        ({'time': -1.0}, 'budget_time is -1'),
        ({'precision': math.nan}, 'precision is nan'),
    ],
)
def test_a_budget_that_makes_no_sense_is_refused(changes: dict[str, Any], says: str) -> None:
    with pytest.raises(UsageError, match=says):
        Budget(**({'trials': 1} | changes))


def test_findings_and_cell_come_back_from_json_as_they_were() -> None:
    one = found(push=SEPARATE, other=SHARPEN, rest=('x',), warnings=('y',))
    assert Findings.from_document(json.loads(json.dumps(one.document()))) == one
    assert Cell.from_document(json.loads(json.dumps(cell().document()))) == cell()


def test_no_push_is_chosen_that_is_deeper_or_faster_than_the_grid() -> None:
    allowed = cell().reach()
    assert (allowed.deepest, allowed.fastest) == (0.006, 0.004)
    assert allowed.slowest == pytest.approx(0.004 / 3.0)
    assert allowed.longest_hold == pytest.approx(6.0)


def test_no_push_is_chosen_beyond_what_the_arm_may_do() -> None:
    assert cell(max_speed=0.003).reach().fastest == 0.003
    assert cell(max_depth=0.004).reach().deepest == 0.004
    # A push takes some eighty seconds beside its hold, so that less than six are left for that.
    assert 2.0 < cell(max_duration=86.0).reach().longest_hold < 6.0


@pytest.mark.parametrize('max_duration', [50.0, 79.0, 80.0, 81.0, 84.0, 1000.0])
def test_each_push_that_may_be_chosen_is_one_that_the_arm_accepts(max_duration: float) -> None:
    slow = replace(cell(max_duration=max_duration, max_depth=0.02), slowest=0.001, deepest=0.012)
    slow = replace(slow, usual=replace(slow.usual, recover_time=20.0))
    air = slow.limits.highest_height

    def lasts(speed: float, hold: float) -> float:
        push = replace(slow.usual, push_speed=speed, depth=slow.deepest, hold_time=hold)
        return expected_duration(push, air)

    allowed = slow.reach()
    assert 0.001 / 3.0 * (1.0 - 1e-9) <= allowed.slowest <= 0.001
    assert 2.0 <= allowed.longest_hold <= 6.0
    # Also once it is written in three digits; the grid's own pushes are the arm's to accept.
    longest = lasts(allowed.slowest / 1.01, allowed.longest_hold)
    assert longest <= max(max_duration, 1.01 * lasts(0.001, 2.0))


# -- on a simulated body ------------------------------------------------------------------------

GRID = ((0.004, 0.006, 2.0),)
"""Speed, depth and hold of a grid of one push."""
YIELD = Undeclared('yield_force', (0.12,))


def measured(pushes: tuple[tuple[float, float, float], ...]) -> tuple[Trial, ...]:
    """Return trials on a body that flows above 0.12 N only, with noise of 0.5 %."""
    sensors = Sensors(ForceNoise(0.015), 3e-5, force_rate=100.0, tool_rate=100.0, force_zero=0.06)
    made = tuple(MadePush(speed, depth, hold, 2.0) for speed, depth, hold in pushes)
    body = Body(1000.0, 900.0, 1600.0)
    return run(Campaign(body, made, sensors, surface_scatter=1e-5), [YIELD], seed=3).trials


def test_an_effect_that_the_grid_leaves_confounded_is_decided_by_the_pushes_that_it_chooses() -> (
    None
):
    pushes, spent, ends = GRID, list[Push](), list[Decision]()
    first: Findings | None = None
    before: Findings | None = None
    while not ends:
        findings = look(measured(pushes), cell())
        first = first or findings
        next_ = decide(findings, BUDGET, Spent(tuple(spent), 0.0, before), lambda push: 10.0)
        before = findings
        if next_.push is None:
            ends.append(next_)
        else:
            spent.append(next_.push)
            pushes = (*pushes, (next_.push.push_speed, next_.push.depth, next_.push.hold_time))
    assert first is not None
    assert set(first.confounded) == {'yield_force', 'shear_thinning'}
    assert spent[0].purpose == 'separate'
    assert set(spent[0].about) == set(first.confounded)
    assert 1 <= len(spent) <= 2
    assert ends[0].ending is Ending.DECIDED
    assert findings.sets == (('yield_force',),)
    told = findings.parameters['F_y']
    assert told.value is not None
    assert told.std is not None
    # An estimate is off by more than four standard errors once in ten thousand.
    assert abs(told.value - 0.12) < 4.0 * told.std < 0.04


def test_a_push_whose_speed_the_encoders_do_not_tell_is_none_that_was_made() -> None:
    noise = ForceNoise(0.015)
    slow = Sensors(noise, 3e-5, force_rate=100.0, tool_rate=50.0, encoder_noise=5e-5)
    pushes = (MadePush(0.004, 0.006, 2.0, 2.0), MadePush(0.03, 0.005, 2.0, 2.0))
    campaign = Campaign(Body(1000.0, 900.0, 1600.0), pushes, slow, surface_scatter=1e-5)
    trials = run(campaign, seed=3).trials
    findings = look(trials, cell())
    assert findings.trials == findings.kinds == 1
    assert findings.repeat is not None
    assert findings.repeat.push_speed == pytest.approx(0.004, rel=0.01)
    (told,) = [w for w in findings.warnings if 'no model is fitted' in w]
    assert told.startswith(f'{trials[1].name}: ')
    # It tells no more than how the arm changes its speed.
    alone = look(trials[:1], cell()).parameters
    for name, found in findings.parameters.items():
        assert abs(found.value - alone[name].value) < alone[name].std
