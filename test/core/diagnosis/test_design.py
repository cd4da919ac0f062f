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


"""The push to make next."""

from dataclasses import replace
import math
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.design import push_again, PushLimits, suggest
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.fit.campaign import Problem
from hapticvision_ros.core.records import Segmentation
from hapticvision_ros.sim.specimen import Undeclared
import numpy as np
import pytest

FIRST, SECOND = 'yield_force', 'shear_thinning'
YIELD = Undeclared(FIRST, (0.12,))
SHORT = ((0.004, 0.006), (0.006, 0.005))
LIMITS = PushLimits(slowest=0.002, fastest=0.010, deepest=0.007, longest_hold=8.0)


def rivals(measured: Any) -> tuple[Workbench, Refit, Refit]:
    """Return a campaign with the two models that are to be told apart."""
    bench, base = measured.bench()
    first, second = (bench.refit(Model((name,)), base) for name in (FIRST, SECOND))
    assert first is not None
    assert second is not None
    return bench, first, second


@pytest.fixture(scope='module')
def short(world: Any) -> Any:
    """Return a short campaign that hardly tells yield from thinning."""
    return world.measure(world.campaign(SHORT, hold=2.0, recover=2.0), YIELD, seed=3)


def test_limits_know_how_deep_a_push_comes_that_never_ends() -> None:
    ramp = Segmentation(1.0, None, None, None, 3.0, 0.04, 0.0, 0.004, None)
    assert PushLimits.like([ramp]).deepest == 0.008


def test_limits_are_near_what_has_been_done(short: Any) -> None:
    limits = PushLimits.like(short.phases)
    assert limits.slowest == pytest.approx(0.004 / 3.0, rel=0.02)
    assert limits.fastest == pytest.approx(3.0 * 0.006, rel=0.02)
    assert limits.deepest == pytest.approx(0.006, rel=0.02)
    assert limits.longest_hold == pytest.approx(6.0, rel=0.05)


@pytest.mark.parametrize(
    ('known', 'slowest', 'fastest', 'deepest', 'longest_hold'),
    [
        ({'fastest': 0.009}, 0.004 / 3.0, 0.009, 0.006, 6.0),
        ({'deepest': 0.010, 'longest_hold': 60.0}, 0.004 / 3.0, 0.018, 0.010, 60.0),
        # Beyond what has been done, on either side.
        ({'slowest': 0.050}, 0.050, 0.050, 0.006, 6.0),
        ({'fastest': 0.001}, 0.001, 0.001, 0.006, 6.0),
    ],
)
def test_limits_that_are_known_count(
    short: Any,
    known: dict[str, float],
    slowest: float,
    fastest: float,
    deepest: float,
    longest_hold: float,
) -> None:
    limits = PushLimits.like(short.phases, known)
    found = limits.slowest, limits.fastest, limits.deepest, limits.longest_hold
    assert found == pytest.approx((slowest, fastest, deepest, longest_hold), rel=0.05)


def test_the_push_that_shows_scatter_most_is_made_again(short: Any) -> None:
    """As often as asked for; two differ by as much more as the scatter is larger."""
    bench, first, _ = rivals(short)
    push = push_again(bench, first, short.phases, 0.01, SECOND, 3)
    assert push is not None
    assert push.separates == ('scatter', SECOND)
    assert push.repeats == 3
    made = [(each.push_speed, each.depth, each.hold_time) for each in short.phases]
    assert (push.push_speed, push.depth, push.hold_time) in made
    larger = push_again(bench, first, short.phases, 0.03, SECOND, 3)
    assert larger is not None
    assert larger.gain == pytest.approx(3.0 * push.gain)
    # As the fit tells a common factor of K1, C1 and C2 from this trial, were it alone.
    index = made.index((push.push_speed, push.depth, push.hold_time))
    alone = Problem(first.model, (bench.trials[index],))
    state = np.concatenate((first.theta, first.state[first.problem.places[index]]))
    alone.set_noise(first.force_noise, first.height_noise, alone.unsure(state, first.blur))

    def left(parameter: int, factor: float) -> float:
        """Return what a change of one of the three leaves beside the trial's own parameters."""
        moved = state.copy()
        moved[parameter] += factor
        residual, jacobian = alone.evaluate_trial(moved, 0)
        own = np.linalg.lstsq(jacobian, -residual, rcond=None)[0]
        return float(np.sum((residual + jacobian @ own) ** 2))

    # Half the second derivative is what one standard deviation of each adds to the squares.
    told = sum((left(k, -1e-3) + left(k, 1e-3) - 2.0 * left(k, 0.0)) / 2e-6 for k in range(3))
    # Both of two trials scatter, and both have noise: the root of two goes out.
    assert push.gain == pytest.approx(0.01 * math.sqrt(told), rel=0.05)
    slow = replace(LIMITS, fastest=0.005)
    within = push_again(bench, first, short.phases, 0.01, SECOND, 3, slow)
    assert within is not None and within.push_speed < 0.0051
    assert (
        push_again(bench, first, short.phases, 0.01, SECOND, 3, replace(slow, deepest=1e-3))
        is None
    )
    without = [replace(each, t_release=None) for each in short.phases]
    assert push_again(bench, first, without, 0.01, SECOND, 3) is None


@pytest.mark.parametrize('rival', [True, False], ids=['separates', 'sharpens'])
def test_the_push_stays_within_what_the_cell_can_do(short: Any, rival: bool) -> None:
    bench, first, second = rivals(short)
    push = suggest(bench, first, second if rival else None, short.phases, LIMITS)
    assert push is not None
    slack = 1.0 + 1e-9
    assert LIMITS.slowest / slack <= push.push_speed <= LIMITS.fastest * slack
    assert 0.0 < push.depth <= LIMITS.deepest * slack
    assert 0.0 < push.hold_time <= LIMITS.longest_hold * slack
    if rival:
        assert push.separates == (FIRST, SECOND)
        assert push.gain > 0.0
        # Until they are three standard deviations apart, ten times at most, if ten tell at all.
        many = min(max(math.ceil(9.0 / push.gain**2), 1), 10)
        assert push.repeats == (many if push.gain * math.sqrt(10.0) >= 2.0 else 1)
    else:
        assert push.separates[0] in first.model.names
        assert push.gain > 1.0
        assert push.repeats == 1


@pytest.mark.parametrize(('other', 'told'), [('machine_compliance', True), ('yield_force', False)])
def test_what_no_push_of_this_object_tells_something_rigid_does(
    world: Any, other: str, told: bool
) -> None:
    # The height is that of the arm's encoders: a spring in series is where the object gives, or
    # where the machine does.
    made = world.measure(
        world.campaign(SHORT, hold=2.0, recover=2.0),
        Undeclared('machine_compliance', (1e6,)),
        seed=3,
    )
    bench, base = made.bench()
    first, second = (bench.refit(Model((name,)), base) for name in ('series_spring', other))
    assert first is not None
    assert second is not None
    push = suggest(bench, first, second, made.phases, LIMITS)
    assert push is not None
    rigid = f'Something rigid in the place of the object, pushed as hard, would show {other}'
    assert (rigid in push.reason) == told


def test_a_push_that_should_be_fast_and_deep_ends_where_the_cell_does(noise_only: Any) -> None:
    bench, base = noise_only.bench()
    push = suggest(bench, base, None, noise_only.phases, LIMITS)
    assert push is not None
    # Against white noise the largest force tells most.
    assert push.push_speed == pytest.approx(LIMITS.fastest)
    assert push.depth == pytest.approx(LIMITS.deepest)


def test_one_more_of_trials_that_scatter_tells_as_much_as_one_of_them(short: Any) -> None:
    plain, base = short.bench()
    bench = plain.scattering(np.full(3, 0.02))
    push = suggest(bench, bench.taken_over(base), None, short.phases, LIMITS)
    # However well it is measured: what is another each time is seen three times, not two.
    assert push is not None
    assert push.gain == pytest.approx(math.sqrt(3.0 / 2.0), rel=0.1)


def lead(world: Any, hold: float, extra: tuple[float, float]) -> float:
    """Return by how much the truth leads its rival with one more push."""
    made = world.campaign(SHORT, hold=2.0, recover=2.0)
    longer = world.campaign((extra,), hold=hold, recover=2.0).pushes
    whole = type(made)(made.body, (*made.pushes, *longer), made.sensors, surface_scatter=1e-5)
    _, first, second = rivals(world.measure(whole, YIELD, seed=3))
    return second.deviance - first.deviance


def test_the_push_tells_two_candidates_apart_better_than_a_repeat(world: Any, short: Any) -> None:
    bench, first, second = rivals(short)
    push = suggest(bench, first, second, short.phases, LIMITS)
    assert push is not None
    suggested = lead(world, push.hold_time, (push.push_speed, push.depth))
    repeat = max(lead(world, 2.0, one) for one in SHORT)
    # A deviance has chance of its own: twice its root is about one in a hundred.
    assert suggested > repeat + 10.0
    # In standard deviations, what came of it is what was expected: along straight slopes, and with
    # the noise of the leader for the rival as well, it would be half of that.
    gained = suggested - (second.deviance - first.deviance)
    assert math.sqrt(gained) / push.gain == pytest.approx(1.0, abs=0.25)
