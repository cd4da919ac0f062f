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


"""Which effects are accepted."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis import selection
from hapticvision_ros.core.diagnosis.refit import Look, Refit, Workbench
from hapticvision_ros.core.diagnosis.selection import (
    _best,
    _by_place,
    _good,
    _near,
    _rivals,
    _sharper,
    _shown,
    _with_rivals,
    _withdrawal_shown,
    drawn_out,
    fleeting,
    price,
    Round,
    seldom,
    select,
    strength,
    Strongest,
    told_by_one_step,
    Trialled,
    try_all,
    WEAKEST,
)
from hapticvision_ros.core.effects import EVERY_LAW
from hapticvision_ros.core.fit.bend import Bend, Shape
from hapticvision_ros.core.fit.campaign import Blur, SHARPEST
from hapticvision_ros.sim.campaigns import ForceNoise
from hapticvision_ros.sim.specimen import Body, Undeclared
import numpy as np
import pytest


def test_what_only_a_longer_search_gains_is_no_effect(world: Any) -> None:
    """A base model that has not come to its best loses to any model that starts from it."""
    bench, base = world.measure(world.campaign(world.four[:2]), seed=1).bench()
    state = base.state.copy()
    state[0] += 0.01
    worse = 60.0
    poor = replace(base, state=state, cost=base.cost + worse, deviance=base.deviance + worse)
    chosen, rounds = select(bench, poor, ['friction', 'contact_growth'])
    assert chosen.model.effects == ()
    assert chosen.deviance < base.deviance + 1.0
    assert [each.alike for each in rounds] == [()]
    assert all(each.gain < 0.5 * worse for each in rounds[0].candidates)


@pytest.fixture
def best(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return what comes of paths, each told by its effects and its total."""
    monkeypatch.setattr(selection, 'worth', lambda _, refit: refit.total)
    monkeypatch.setattr(selection, '_samples', lambda _, refit, __: refit)
    # Two of these draw jumps out over less than a sample.
    names = ('a', 'b', 'c', 'd', 'friction', 'friction:held')
    samples = {**dict.fromkeys(names, np.inf), 'lag': 0.5, 'spring': 0.5}
    tried: Any = tuple(Trialled(name, 50.0, 40.0, 1.0, samples[name]) for name in samples)

    def made(*paths: tuple[float, str], alike: str = '') -> tuple[float, list[tuple[str, ...]]]:
        listed: Any = []
        for total, effects in paths:
            names = effects.split()
            rounds: Any = [Round(None, tried, (name,)) for name in names]
            rounds[0] = replace(rounds[0], alike=(names[0], *alike.split()))
            refit = SimpleNamespace(total=total, model=SimpleNamespace(effects=names))
            listed.append((refit, (*rounds, Round(refit, tried, ()))))
        chosen, rounds = _best(None, listed)
        return chosen.total, [each.alike for each in rounds]

    return made


def test_what_comes_first_by_itself_gives_way_to_a_better_pair(best: Any) -> None:
    assert best((100.0, 'a b'), (50.0, 'c d')) == (50.0, [('c',), ('d',), ()])
    # Also where nothing stood beside the first, or it was alike.
    assert best((100.0, 'a'), (50.0, 'c d'), alike='a') == (50.0, [('c',), ('d',), ()])
    assert best((50.0, 'a b'), (100.0, 'c d'), alike='c') == (50.0, [('a',), ('b',), ()])
    # What draws jumps out is not told from its like by what stands beside it.
    total, sets = best((50.0, 'lag b'), (100.0, 'spring d'), alike='spring')
    assert (total, sets) == (50.0, [('lag', 'spring'), ('b',), ()])


def test_pairs_that_are_not_told_apart_are_both_said(best: Any) -> None:
    assert best((55.0, 'a b'), (50.0, 'c d')) == (50.0, [('c', 'a'), ('d', 'b'), ()])
    assert best((55.0, 'a b'), (50.0, 'c b')) == (50.0, [('c', 'a'), ('b',), ()])
    # The same two in another order are the same: what gains more by it is no other pair.
    assert best((50.0, 'a b'), (49.0, 'b a'), (80.0, 'c d')) == (49.0, [('b',), ('a',), ()])
    # What both have is no rival of what only one has, whatever came first in it.
    assert best((50.0, 'a b'), (55.0, 'c a'), alike='c') == (50.0, [('a',), ('b', 'c'), ()])
    # Fewer effects come before more that are no better.
    assert best((55.0, 'a'), (50.0, 'c d')) == (55.0, [('a',), ()])
    assert best((55.0, 'a b'), (50.0, 'c')) == (50.0, [('c',), ()])


def test_laws_of_an_effect_are_no_rivals_of_one_another(best: Any) -> None:
    assert best((55.0, 'friction b'), (50.0, 'friction:held b')) == (
        50.0,
        [('friction:held',), ('b',), ()],
    )
    # Nor does a law stand for an effect that went worse by another.
    assert best((50.0, 'a b'), (100.0, 'friction d'), alike='friction:held') == (
        50.0,
        [('a',), ('b',), ()],
    )


def test_a_rival_that_promised_nothing_beside_the_best_is_refitted_there(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2]), seed=1).bench()
    promised = Trialled('friction', 5.0, -5.0, 0.0, None)
    leader = Trialled('damage', 60.0, 50.0, 1.0, bench.refit(Model(('damage',)), base))
    found = _with_rivals(bench, Round(base, (leader, promised), ('damage',)), ['friction'])
    assert found.alike == ('damage', 'friction')
    assert [each.effect for each in found.candidates] == ['damage', 'friction']
    refit = found.candidates[1].refit
    assert refit is not None
    assert refit.model.effects == ('friction',)
    # What a model cannot have beside it is no rival there.
    beside = Round(refit, (leader,), ('damage',))
    assert _with_rivals(bench, beside, ['friction:held']) == beside


def test_each_effect_comes_first_once_whatever_its_laws(best: Any) -> None:
    names = ('a', 'a:one', 'b', 'b:one', 'b:two', 'c', 'd', 'e')
    tried: Any = tuple(
        Trialled(name, 60.0 - k, 50.0 - k, 1.0, np.inf) for k, name in enumerate(names)
    )
    assert _rivals(None, Round(None, tried, ()), ['a', 'b']) == ['b', 'c', 'd']


def test_a_sine_that_turns_once_or_twice_is_no_disturbance(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2]), seed=1).bench()
    refit = bench.refit(Model(('periodic_disturbance',)), base)
    frequency = refit.model.names.index('frequency')
    longest = max(float(trial.t[-1] - trial.t[0]) for trial in bench.trials)
    found = []
    for turns in (2.0, 50.0):
        values = refit.model.values(refit.theta)
        values[frequency] = turns / longest
        state = refit.state.copy()
        state[: values.size] = refit.model.theta(values)
        found.append(seldom(bench, replace(refit, state=state), 'periodic_disturbance'))
    assert found == [True, False]


def test_where_the_best_quick_effect_is_too_weak_no_other_quick_one_is_taken(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    assert any(map(_shown, bench.trials))

    def quick(name: str, gain: float, strength: float, **values: float) -> Trialled:
        refit = bench.refit(Model((name,)), base)
        known = dict(zip(refit.model.names, refit.model.values(refit.theta), strict=True))
        state = refit.state.copy()
        state[: len(known)] = refit.model.theta(list((known | values).values()))
        return Trialled(name, gain + 10.0, gain, strength, replace(refit, state=state))

    weak = quick('series_spring', 220.0, 0.06, K_0=1e6)
    general = quick('second_retardation', 24.0, 0.11, K_2=1e6, C_3=1e3)
    assert fleeting(bench, general.refit, general.effect)
    assert _good(bench, base, [weak, general], Strongest()) == []
    assert _good(bench, base, [general], Strongest()) == [general]
    strong = replace(weak, strength=0.2)
    assert _good(bench, base, [strong, general], Strongest()) == [strong, general]
    # Nor is what gains a small part of the strongest: how the arm moved is not known so exactly.
    assert _good(bench, base, [strong], Strongest(0.5, gain=4300.0)) == [strong]
    assert _good(bench, base, [strong], Strongest(0.5, gain=4500.0)) == []
    # What the heights tell of it is another matter.
    seen = replace(weak, in_height=0.4, height_score=45.0)
    assert _good(bench, base, [seen], Strongest()) == [seen]
    # Nor is what only has the moments of jumps known better.
    assert _good(bench, base, [replace(strong, sure=15.0)], Strongest()) == []
    # Nor is what the start of the release alone tells, in which a sample is too long.
    assert _good(bench, base, [replace(strong, release=210.0)], Strongest()) == []
    assert drawn_out(bench, [replace(strong, release=210.0)]) == ()
    # What stops tell that the encoders do not show is said and not taken.
    unseen = replace(strong, stop=210.0)
    assert _good(bench, base, [unseen], Strongest()) == []
    assert drawn_out(bench, [unseen]) == (unseen,)
    assert drawn_out(bench, [strong]) == ()


def test_what_takes_some_of_drawn_out_jumps_is_no_effect(world: Any) -> None:
    """A spring in series tells all of it, and is refused for stops that are not seen."""
    bench, base = world.measure(
        world.campaign(world.four[:2]), Undeclared('series_spring', (3e5,)), seed=1
    ).bench()
    spring = bench.refit(Model(('series_spring',)), base)
    other = bench.refit(Model(('contact_growth',)), base)
    refused = Trialled('series_spring', 310.0, 300.0, 1.0, spring, stop=290.0)
    taken = Trialled('contact_growth', 110.0, 100.0, 1.0, other)
    assert fleeting(bench, spring, 'series_spring')
    assert _good(bench, base, [refused, taken], Strongest()) == []
    # Nor is what gains a little more than that: only what clearly does is not asked.
    little, more = replace(taken, gain=309.0), replace(taken, gain=311.0)
    assert _good(bench, base, [little, refused], Strongest()) == []
    assert _good(bench, base, [more, refused], Strongest()) == [more]
    # What is over at once is refused as well, wherever it is told.
    place = spring.model.names.index('K_0')
    values = spring.model.values(spring.theta)
    values[place] *= 1000.0
    state = spring.state.copy()
    state[: values.size] = spring.model.theta(values)
    at_once = replace(refused, refit=replace(spring, state=state), stop=0.0)
    assert drawn_out(bench, [at_once]) == (at_once,)
    assert _good(bench, base, [at_once, taken], Strongest()) == []


def test_a_clear_gain_is_an_effect_though_it_acts_in_few_samples(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2]), seed=1).bench()
    refit = bench.refit(Model(('height_bias',)), base)
    clear, less = (Trialled('height_bias', gain, gain, 0.04, refit) for gain in (45.0, 35.0))
    assert _good(bench, base, [clear, less], Strongest()) == [clear]
    # Beside a stronger effect the share of that one counts.
    assert _good(bench, base, [clear], Strongest(1.0, 1.0, 1.0)) == []
    # In the heights that of an effect which they show as well: they are few beside the forces.
    shown = replace(clear, in_height=0.3, height_score=45.0)
    assert _good(bench, base, [shown], Strongest(1.0, 0.1, 1.0)) == [shown]
    assert _good(bench, base, [shown], Strongest(1.0, 4.0, 1.0)) == []
    assert _good(bench, base, [replace(shown, height_score=35.0)], Strongest(1.0, 0.1, 1.0)) == []


def _offset_by(refit: Refit, size: float) -> Refit:
    """Return a refit with a contact offset in which that is of another size [m]."""
    values = refit.model.values(refit.theta)
    values[refit.model.names.index('delta_0')] = size
    state = refit.state.copy()
    state[: values.size] = refit.model.theta(values)
    return replace(refit, state=state)


def test_what_only_misplaced_jumps_show_beside_an_effect_must_be_certain(world: Any) -> None:
    """The form of what was accepted is not exact: a touch a little off makes up for it."""
    bench, base = world.measure(world.campaign(), seed=39).bench()
    refit = bench.refit(Model(('contact_offset:loose_top',)), base)
    refit = _offset_by(refit, 1e-4)
    moved = Trialled('contact_offset:loose_top', 35.0, 25.0, 0.3, refit, calm=0.01)
    assert _good(bench, base, [moved], Strongest()) == [moved]
    assert _good(bench, base, [moved], Strongest(0.4, calm=0.4)) == []
    for told in (replace(moved, calm=0.1), replace(moved, gain=45.0)):
        assert _good(bench, base, [told], Strongest(0.4, calm=0.4)) == [told]
    # Beside a strong one it is more of what that one gains.
    large = replace(moved, gain=45.0)
    assert _good(bench, base, [large], Strongest(0.4, calm=0.4, gain=850.0)) == [large]
    assert _good(bench, base, [large], Strongest(0.4, calm=0.4, gain=950.0)) == []
    seen = replace(moved, calm=0.1)
    assert _good(bench, base, [seen], Strongest(0.4, calm=0.4, gain=950.0)) == [seen]
    # What is weak beside it may be its form.
    seen = replace(moved, calm=0.3)
    assert _good(bench, base, [seen], Strongest(1.9, calm=1.9)) == [seen]
    assert _good(bench, base, [seen], Strongest(2.1, calm=2.1)) == []
    # Not so beside what is strong at jumps only, as a lag of the load cell.
    assert _good(bench, base, [seen], Strongest(2.1, calm=0.2)) == [seen]


def test_an_offset_that_the_tool_goes_by_within_half_a_sample_is_none(world: Any) -> None:
    campaign = world.campaign(((0.004, 0.004), (0.012, 0.004), (0.004, 0.006)), rate=250.0)
    bench, base = world.measure(campaign, seed=39).bench()
    refit = bench.refit(Model(('contact_offset:loose_top',)), base)
    # At 4 mm/s and 250 Hz it is 8 um, whatever the one quicker push.
    for size, told in ((9e-6, True), (7e-6, False), (-9e-6, True), (-7e-6, False)):
        moved = _offset_by(refit, size)
        each = Trialled('contact_offset:loose_top', 50.0, 40.0, 0.3, moved, calm=0.3)
        assert bool(_good(bench, base, [each], Strongest())) == told


def test_adhesion_that_unsure_moments_hide_is_looked_for_near_by(world: Any) -> None:
    """A start at two thirds of the pull-off force, as if moments were known to two samples."""
    bench, base = world.measure(
        world.campaign(world.four[:2]), Undeclared('adhesion', (1.5,)), seed=1
    ).bench()
    (found,) = try_all(bench, base, ['adhesion'])
    right = found.refit
    place = right.model.names.index('F_ad')
    values = right.model.values(right.theta)
    best = float(values[place])
    # At 200 Hz the pull changes by a fifth from one sample to the next.
    assert best == pytest.approx(1.5, rel=0.2)
    values[place] = best / 1.5
    state = right.state.copy()
    state[: values.size] = right.model.theta(values)
    known = replace(right, state=state, blur=Blur(0.1, 2.0))
    sharp, near = _sharper(bench, known, 'adhesion')
    assert sharp.blur == near.blur == SHARPEST
    assert np.array_equal(sharp.state, state)
    # One of the sizes that are looked at is as good as the best.
    states = [state, near.state, right.state]
    away, beside, least = bench.leaves(right.problem, states, sharp)
    assert away > least + 10.0
    assert beside == pytest.approx(least, abs=0.5)


def test_necks_whose_pull_is_hardly_louder_than_the_noise_are_seen(world: Any) -> None:
    """Twice the noise for 0.4 s: no reading by itself tells where the pull ends."""
    pushes = [replace(push, release_speed=1e-3) for push in world.campaign().pushes]
    campaign = replace(world.campaign(), pushes=tuple(pushes))
    bench, base = world.measure(campaign, Undeclared('necking', (0.1, 4e-4)), seed=19).bench()
    scale = bench.scale(base)
    assert scale.opening == pytest.approx(4e-4, rel=0.1)
    assert scale.held_back == pytest.approx(0.1, rel=0.1)
    (found,) = try_all(bench, base, ['adhesion:cohesive_zone'])
    assert found.refit is not None
    values = found.refit.model.values(found.refit.theta)
    assert values[3:] == pytest.approx([0.1, 4e-4], rel=0.05)


def test_what_the_arm_does_unseen_is_a_part_of_the_deviance(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=250.0), seed=1).bench()
    # Each by itself: all of a campaign together show more.
    alone = [
        replace(
            t, path=replace(t.path, bends=tuple(replace(b, common=False) for b in t.path.bends))
        )
        for t in bench.trials
    ]
    shown = [_shown(trial) for trial in alone]
    # Nor is it seen how it gathers speed for the withdrawal.
    hidden = [
        replace(
            t,
            path=replace(t.path, bends=tuple(b for b in t.path.bends if b.t < t.t_release)),
        )
        for t in bench.trials
    ]
    hiding = Workbench(hidden, None, bench.memory)
    release, stop, seen = _by_place(hiding, base, shown, base)
    # The encoders show the stop of the quick push, and not that of the slow one.
    assert sum(shown) == 1
    assert release != 0.0 and stop != 0.0
    ends = [replace(trial.path.bends[-1], shape=Shape(1e6)) for trial in bench.trials]
    late = [
        replace(trial, t_release=trial.t[0], path=replace(trial.path, bends=(end,), interval=1e7))
        for trial, end in zip(bench.trials, ends, strict=True)
    ]
    # A release that lasts for the whole trial tells all of what the force tells.
    release, *_ = _by_place(Workbench(late, None, bench.memory), base, shown, base)
    told = 0.0
    filters = bench.whiteners(base.force_noise, base.height_noise, base.jumps)
    for index, (white, _) in enumerate(filters):
        residual, _ = bench.residual(base.problem, base.state, index)
        told += float(np.sum(white(residual[np.newaxis])[0] ** 2)) + white.log_determinant
    assert release == pytest.approx(told, rel=1e-9)
    # Nothing is lost between the parts.
    whole = _by_place(bench, base, [True, True], base)
    assert sum(_by_place(hiding, base, shown, base)) == pytest.approx(sum(whole))
    assert seen != 0.0


@pytest.mark.parametrize(('samples', 'seen'), [(6.0, False), (8.0, True)])
def test_a_push_of_few_samples_of_the_encoders_is_not_seen_from_its_touch_on(
    world: Any, samples: float, seen: bool
) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=250.0), seed=1).bench()
    state = base.state.copy()
    for place in base.problem.places:
        state[place.start] += 2e-4
    off = replace(base, state=state)
    slow = []
    for t in bench.trials:
        interval = (t.t_stop - t.t_contact) / samples
        slow.append(replace(t, path=replace(t.path, bends=(), interval=interval)))
    parts = [
        _by_place(Workbench(slow, None, bench.memory), each, [False, False], base)
        for each in (off, base)
    ]
    of_stops = parts[0][1] - parts[1][1]
    of_all_else = parts[0][2] - parts[1][2]
    assert (of_all_else > 10.0 * abs(of_stops)) == seen
    assert (of_stops > 10.0 * abs(of_all_else)) != seen


def test_how_the_arm_slows_down_in_the_air_does_not_show_how_it_stops(world: Any) -> None:
    bench, _ = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    moved = []
    for trial in bench.trials:
        bends = tuple(replace(bend, t=0.5 * trial.t_contact) for bend in trial.path.bends)
        moved.append(replace(trial, path=replace(trial.path, bends=bends)))
    assert any(map(_shown, bench.trials))
    assert not any(map(_shown, moved))


def test_what_is_over_within_few_samples_is_not_told_apart_by_little_of_the_gain(
    world: Any,
) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    refit = bench.refit(Model(('force_lag',)), base)
    place = refit.model.names.index('T_f')

    def near(samples: float, *others: tuple[float, float], blur: float = 1.0) -> int:
        """Return how many of some gains, with what is not seen of each, are near one of 1000."""
        values = refit.model.values(refit.theta)
        values[place] = samples * 0.002
        state = refit.state.copy()
        state[: values.size] = refit.model.theta(values)
        there = replace(refit, state=state, blur=Blur(blur, blur))
        leader = Trialled('force_lag', 1010.0, 1000.0, 1.0, there, 0.0, 50.0)
        rest = [
            Trialled(name, 0.0, gain, 1.0, refit, stop=stop)
            for name, (gain, stop) in zip(('friction', 'damage'), others, strict=False)
        ]
        return len(_near(bench, [leader, *rest])) - 1

    def lasting(gain: float, other: tuple[str, float, float]) -> int:
        """Return the same where it lasts for ten samples, with what the heights tell of one."""
        values = refit.model.values(refit.theta)
        values[place] = 0.02
        state = refit.state.copy()
        state[: values.size] = refit.model.theta(values)
        leader = Trialled('force_lag', gain, gain, 1.0, replace(refit, state=state))
        name, less, heights = other
        each = Trialled(name, less, less, 1.0, refit, height_score=heights)
        return len(_near(bench, [leader, each])) - 1

    # By 2 % of the gain, or by the usual lead.
    assert near(0.5, (981.0, 50.0), (979.0, 50.0)) == 1
    assert near(10.0, (991.0, 50.0), (989.0, 50.0)) == 1
    # Where the moments of jumps are known, how the tool goes within a sample is known as well.
    assert near(0.5, (991.0, 50.0), (989.0, 50.0), blur=0.1) == 1
    # How it goes while it changes its speed is not known to half a percent of what that explains.
    assert lasting(30000.0, ('series_spring', 29880.0, 0.0)) == 1
    assert lasting(30000.0, ('series_spring', 29840.0, 0.0)) == 0
    assert lasting(30000.0, ('friction', 29880.0, 0.0)) == 0
    # The heights show it as well, and jumps are nothing to them.
    assert lasting(30000.0, ('series_spring', 29880.0, -50.0)) == 0
    # Once two are not told apart, half of that sets a third aside.
    assert near(10.0, (996.0, 50.0), (991.0, 50.0)) == 1
    assert near(10.0, (991.0, 50.0), (990.5, 50.0)) == 1
    assert near(10.0, (999.0, 50.0), (996.0, 50.0)) == 2
    assert near(0.5, (985.0, 50.0), (984.0, 50.0)) == 1
    assert near(0.5, (995.0, 50.0), (992.0, 50.0)) == 2
    # What leads only by how the arm moved unseen does not lead.
    assert near(0.5, (960.0, 19.0), (960.0, 21.0)) == 1
    assert near(10.0, (960.0, 10.0)) == 0


def test_beside_another_effect_a_small_part_of_the_gain_tells_nothing_apart(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    alone = bench.refit(Model(('parallel_spring',)), base)
    beside = bench.refit(Model(('contact_growth', 'parallel_spring')), base)

    def near(refit: Refit, first: float, second: float) -> int:
        named = (('parallel_spring', first), ('second_retardation', second))
        return len(_near(bench, [Trialled(name, g, g, 1.0, refit) for name, g in named]))

    assert near(alone, 5000.0, 4960.0) == 1
    assert near(beside, 5000.0, 4960.0) == 2
    assert near(beside, 5000.0, 4940.0) == 1


def test_what_a_parameter_costs_sets_a_rival_aside_by_half(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    refit = bench.refit(Model(('springpot',)), base)

    def near(leader: str, rival: str, behind: float) -> bool:
        tried = [
            Trialled(name, score, score - price(bench, name), 1.0, refit)
            for name, score in ((leader, 500.0), (rival, 500.0 - behind))
        ]
        return len(_near(bench, tried)) == 2

    more = price(bench, 'second_retardation') - price(bench, 'springpot')
    assert 7.0 < more < 10.0
    assert near('springpot', 'second_retardation', 10.0 - more + 3.0)
    assert not near('springpot', 'second_retardation', 10.0 - more / 2.0 + 0.1)
    # Of two that cost the same the deviance is all there is.
    assert near('springpot', 'parallel_spring', 9.9)
    assert not near('springpot', 'parallel_spring', 10.1)
    # What costs less than the leader has no more of it counted.
    less = price(bench, 'periodic_disturbance') - price(bench, 'springpot')
    assert near('periodic_disturbance', 'springpot', 10.0 + less - 0.1)
    assert not near('periodic_disturbance', 'springpot', 10.0 + less + 0.1)
    # A unit more never leaves more than the spring that it becomes: all of its cost tells.
    assert near('parallel_spring', 'second_retardation', 10.0 - more - 0.1)
    assert not near('parallel_spring', 'second_retardation', 10.0 - more + 0.1)
    # What draws jumps out, for however long, has all who do so as rivals already.
    lag = bench.refit(Model(('force_lag',)), base)
    known = dict(zip(lag.model.names, lag.model.values(lag.theta), strict=True))
    state = lag.state.copy()
    theta = lag.model.theta(list((known | {'T_f': 20.0 * bench.trials[0].interval}).values()))
    state[: theta.size] = theta
    refit = replace(lag, state=state)
    assert not near('force_lag', 'second_retardation', 10.0 - more + 3.0)


def test_laws_of_one_effect_are_one_place_of_a_set(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    refit = bench.refit(Model(('yield_force',)), base)

    def near(*named: tuple[str, float], missed: tuple[str, ...] = ()) -> list[str]:
        tried = [Trialled(name, gain, gain, 1.0, refit) for name, gain in named]
        return [each.effect for each in _near(bench, tried, missed)]

    told = near(('friction', 100.0), ('friction:held', 98.0), ('yield_force', 93.0))
    assert told == ['friction', 'friction:held', 'yield_force']
    # The third name needs half the lead only.
    told = near(('friction', 100.0), ('damage', 98.0), ('yield_force', 93.0))
    assert told == ['friction', 'damage']
    # What has missed a limit itself takes no place from others, but a single name needs the lead.
    assert near(('friction', 100.0), ('damage', 93.0), missed=('damage',)) == [
        'friction',
        'damage',
    ]
    told = near(('friction', 100.0), ('damage', 98.0), ('yield_force', 93.0), missed=('damage',))
    assert told == ['friction', 'damage', 'yield_force']


def test_a_general_form_of_the_leader_takes_no_place_of_a_set(world: Any) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()

    def quick(name: str, gain: float, **values: float) -> Trialled:
        refit = bench.refit(Model((name,)), base)
        known = dict(zip(refit.model.names, refit.model.values(refit.theta), strict=True))
        state = refit.state.copy()
        state[: len(known)] = refit.model.theta(list((known | values).values()))
        return Trialled(name, gain, gain, 1.0, replace(refit, state=state))

    tried = [
        quick('series_spring', 100.0, K_0=1e6),
        quick('second_retardation', 98.0, K_2=1e6, C_3=1e3),
        quick('machine_compliance', 93.0, K_m=1e6),
    ]
    names = [each.effect for each in _near(bench, tried)]
    assert names == ['series_spring', 'machine_compliance']


def test_a_misplaced_touch_is_no_size_of_what_a_model_lacks(world: Any) -> None:
    """The force of a quick push jumps by many times the noise from one sample to the next."""
    bench, base = world.measure(world.campaign(((0.02, 0.005),) * 2, hold=1.0), seed=1).bench()
    problem, state = base.problem, base.state.copy()
    for place in problem.places:
        state[place.start] += 0.02 * problem.trials[0].interval
    blunt = replace(base, state=state, jumps=problem.unsure(state, Blur(2.0, 1.0)))
    whole = strength(bench, base, blunt)
    assert whole > 0.3
    assert strength(bench, base, blunt, calm=True) < 0.2 * whole
    # What goes on for long counts as before.
    longer = bench.refit(Model(('shear_thinning',)), base)
    other = longer.state.copy()
    other[longer.model.names.index('K1')] += 0.02
    away = replace(longer, state=other)
    assert strength(bench, away, longer, calm=True) > 0.9 * strength(bench, away, longer)


def test_what_scatter_takes_up_beside_an_effect_is_no_less_of_an_effect(world: Any) -> None:
    """An object that ages: trials that scatter follow that as well, each by itself."""
    campaign = world.campaign(world.repeated, hold=3.0, recover=2.0, rate=100.0)
    names = ['yield_force', 'ageing', 'damage']
    acting = Undeclared('yield_force', (0.37,)), Undeclared('ageing', (-1.5,))
    bench, base = world.measure(campaign, *acting, seed=3).bench(scatter=0.02)
    _, rounds = select(bench, base, names)
    assert [each.alike for each in rounds] == [('yield_force',), ('ageing',), ()]
    aged = rounds[1].candidates[0]
    assert aged.strength < WEAKEST < 1.0 < aged.unscattered
    # It is weighed against what was accepted before, by what that does to trials without scatter.
    yields = rounds[0].candidates[0].unscattered
    assert yields > WEAKEST
    before = Strongest(strength=1.0, calm=1.0, unscattered=yields)
    assert _good(bench, rounds[1].without, (aged,), before) == [aged]
    louder = replace(before, unscattered=10.0 * aged.unscattered)
    assert _good(bench, rounds[1].without, (aged,), louder) == []


def test_a_pull_that_comes_slowly_is_found_at_whatever_noise_makes_it_look_like(
    world: Any,
) -> None:
    """Noise that remembers makes the pull look larger than that at which the object lets go."""
    campaign = world.campaign(rate=500.0)
    campaign = replace(
        campaign,
        pushes=tuple(replace(push, release_speed=0.001) for push in campaign.pushes),
        sensors=replace(campaign.sensors, force_noise=ForceNoise(0.0, 0.09, 0.03)),
    )
    # A little more or less of it lets go a sample later or sooner, and all else moves with that.
    for seed in range(23, 26):
        bench, base = world.measure(campaign, Undeclared('adhesion', (0.4,)), seed=seed).bench()
        assert bench.scale(base).pull > 0.45
        (found,) = try_all(bench, base, ['adhesion'])
        assert found.refit is not None
        assert found.gain > 300.0
        pull = found.refit.model.values(found.refit.theta)[3]
        assert pull == pytest.approx(0.4, rel=0.1)


def test_a_pull_that_lets_go_several_times_is_found(world: Any) -> None:
    """The object springs back faster than the tool withdraws: a few percent off is all off."""
    campaign = world.campaign(rate=500.0)
    campaign = replace(
        campaign,
        body=Body(1000.0, 600.0, 16_000.0),
        pushes=tuple(replace(push, release_speed=0.001) for push in campaign.pushes),
        sensors=replace(campaign.sensors, force_noise=ForceNoise(0.006)),
    )
    bench, base = world.measure(campaign, Undeclared('adhesion', (0.2,)), seed=1).bench()
    (found,) = try_all(bench, base, ['adhesion'])
    assert found.refit is not None
    assert found.gain > 5000.0
    assert found.refit.model.values(found.refit.theta)[3] == pytest.approx(0.2, rel=0.01)


def test_what_draws_jumps_out_as_the_leader_does_is_tried_though_it_promises_nothing(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    measured = world.measure(world.campaign(), Undeclared('series_spring', (20_000.0,)), seed=24)
    bench, base = measured.bench()
    look = bench.look

    def little(model: Model, near: Any) -> Look:
        found = look(model, near)
        return replace(found, promise=0.0) if 'machine_compliance' in model.effects else found

    monkeypatch.setattr(bench, 'look', little)
    tried = try_all(bench, base, ['series_spring', 'machine_compliance', 'springpot'])
    gains = {each.effect: each.gain for each in tried if each.refit is not None}
    assert gains['series_spring'] > 100.0
    assert gains['machine_compliance'] > 0.5 * gains['series_spring']


def test_beside_a_striking_candidate_all_that_change_the_chain_are_fitted(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What moves the body far promises nothing in one step."""
    measured = world.measure(world.campaign(), Undeclared('parallel_spring', (300.0,)), seed=24)
    bench, base = measured.bench()
    look = bench.look

    def little(model: Model, near: Any) -> Look:
        found = look(model, near)
        promised = 'springpot' in model.effects
        return found if promised else replace(found, promise=0.0)

    monkeypatch.setattr(bench, 'look', little)
    monkeypatch.setattr(selection, '_STRIKING', 50.0)
    names = ['springpot', 'parallel_spring', 'force_drift']
    gains = {each.effect: each.gain for each in try_all(bench, base, names) if each.refit}
    assert gains['springpot'] > 50.0
    assert gains['parallel_spring'] > gains['springpot']
    # What leaves the chain as it is promises in one step what it can do.
    assert 'force_drift' not in gains
    monkeypatch.setattr(selection, '_STRIKING', 1e9)
    (fitted,) = (each for each in try_all(bench, base, names) if each.refit)
    assert fitted.effect == 'springpot'


def test_a_withdrawal_that_the_encoders_follow_tells_what_acts_in_it(world: Any) -> None:
    bench, base = world.measure(world.campaign(), seed=25).bench()
    trial = bench.trials[0]
    slow = Bend(trial.t_release + 0.05, -0.02, Shape(0.1))
    quick = Bend(trial.t_release + 0.005, -0.02, Shape(0.01))
    other = Bend(trial.t_contact, 0.02, Shape(0.1))
    for bends, shown in (((), False), ((quick, other), False), ((slow, other), True)):
        told = replace(trial, path=replace(trial.path, bends=bends))
        assert _withdrawal_shown(told) == shown
    # Nothing of a release that is shown is left out of what counts.
    bench = Workbench([replace(trial, path=replace(trial.path, bends=(slow,)))], None)
    assert _by_place(bench, base, [True], base)[0] == 0.0


def test_where_jumps_are_blunt_what_draws_them_out_is_refitted_whatever_it_promises(
    noise_only: Any,
) -> None:
    bench, base = noise_only.bench()
    for later in (0.1, 2.0):
        without = replace(base, blur=Blur(base.blur.touch, later))
        tried = {each.effect: each for each in try_all(bench, without, ['inertia', 'yield_force'])}
        assert (tried['inertia'].refit is not None) == (later > 1.0)


def test_what_blunt_jumps_hide_is_searched_for_as_long_as_what_they_show(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, base = world.measure(world.campaign(world.four[:2], rate=500.0), seed=1).bench()
    longer = set[str]()

    def closer(bench: Any, without: Any, found: Trialled) -> Trialled:
        longer.add(found.effect)
        return found

    monkeypatch.setattr(selection, '_closer', closer)
    for later, expected in ((0.5, set[str]()), (2.0, {'force_lag', 'series_spring'})):
        longer.clear()
        there = replace(base, blur=Blur(0.5, later))
        tried = try_all(bench, there, ['force_lag', 'series_spring', 'force_drift'])
        # All gain nothing here.
        assert max(each.gain for each in tried) < 0.0
        assert longer == expected


@pytest.mark.parametrize(
    ('reached', 'expected'),
    [(0.0, {'yield_force', 'springpot'}), (200.0, {'yield_force'}), (500.0, set())],
)
def test_what_is_far_behind_the_leader_is_not_searched_for_longer(
    reached: float, expected: set[str], noise_only: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, base = noise_only.bench()
    gains = {'yield_force': 100.0, 'springpot': 30.0, 'shear_thinning': 20.0}
    look = bench.look
    longer = set[str]()

    def closer(bench: Any, without: Any, found: Trialled) -> Trialled:
        longer.add(found.effect)
        return found

    def gaining(bench: Any, without: Any, name: str, refit: Refit) -> Trialled:
        return Trialled(name, gains[name], gains[name], 1.0, refit)

    monkeypatch.setattr(bench, 'look', lambda *of: replace(look(*of), promise=100.0))
    monkeypatch.setattr(selection, '_trialled', gaining)
    monkeypatch.setattr(selection, '_closer', closer)
    try_all(bench, base, list(gains), reached=reached)
    assert longer == expected


def test_what_one_step_alone_tells_is_no_effect(world: Any) -> None:
    """The tool's way is not known there, and many effects lower what is off a little."""
    bench, base = world.measure(world.campaign(world.four[:2]), seed=1).bench()
    refit = bench.refit(Model(('friction',)), base)
    values = refit.model.values(refit.theta)
    values[-1] = 0.02
    state = refit.state.copy()
    state[: values.size] = refit.model.theta(values)
    acting = replace(refit, state=state)
    usual = told_by_one_step(bench, base, acting)
    # A force that follows the friction at one step, and is far from what it is without it.
    trial = bench.trials[0]
    before, after = (bench.residual(each.problem, each.state, 0)[0] for each in (base, acting))
    step = int(np.argmax(np.abs(after - before)))
    force = trial.force.copy()
    force[step] += 100.0 * (before[step] - after[step])
    struck = Workbench((replace(trial, force=force), *bench.trials[1:]), None, bench.memory)
    told = told_by_one_step(struck, base, acting)
    assert told > 10.0 * usual
    found = Trialled('friction', told + 8.0, told - 1.0, 0.5, acting)
    assert _good(struck, base, [found], Strongest()) == []
    assert _good(struck, base, [replace(found, gain=told + 1.0)], Strongest()) != []
    assert _good(bench, base, [found], Strongest()) == [found]


def test_the_laws_of_an_effect_take_the_place_of_one(
    noise_only: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The laws of damage hold the usual one, and promise as much each."""
    bench, base = noise_only.bench()
    look = bench.look
    laws = [name for name in (law.name for law in EVERY_LAW) if name.startswith('damage')]
    others = ['yield_force', 'shear_thinning', 'springpot']

    def promising(model: Model, near: Any) -> Look:
        (name,) = model.effects
        promise = 100.0 if name in laws else 90.0 - others.index(name)
        return replace(look(model, near), promise=promise)

    def gaining(bench: Any, without: Any, name: str, refit: Refit) -> Trialled:
        gain = 100.0 if name in laws else 90.0 - others.index(name)
        return Trialled(name, gain, gain, 1.0, refit)

    closely = []

    def longer(bench: Any, without: Any, found: Trialled) -> Trialled:
        closely.append(found.effect)
        return found

    monkeypatch.setattr(bench, 'look', promising)
    monkeypatch.setattr(selection, '_trialled', gaining)
    monkeypatch.setattr(selection, '_closer', longer)
    tried = try_all(bench, base, [*laws, *others], most=3)
    refitted = {each.effect for each in tried if each.refit is not None}
    assert refitted == {*laws, 'yield_force', 'shear_thinning'}
    # So among what is searched for longer.
    assert {'yield_force', 'shear_thinning'} < set(closely)


def test_a_weak_effect_by_a_law_of_more_parameters_is_found_as_by_one_of_less(world: Any) -> None:
    """How early damage is done is no smaller where it is weak."""
    measured = world.measure(world.campaign(), Undeclared('lasting_damage', (0.1,)), seed=24)
    bench, base = measured.bench()
    found = []
    for law in ('lasting', 'lasting_saturating'):
        refit = bench.refit(Model((f'damage:{law}',)), base)
        assert refit is not None
        found.append(base.deviance - refit.deviance)
    assert found[0] > 20.0
    assert found[1] > found[0] - 1.0
