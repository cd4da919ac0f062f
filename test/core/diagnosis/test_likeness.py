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


"""How alike effects are in some trials, which of them show, and what they are worth unseen."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.likeness import left_out, pairs, Tangent, visible
from hapticvision_ros.core.diagnosis.scatter import conditions
from hapticvision_ros.core.diagnosis.selection import Trialled
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.specimen import Undeclared
import pytest


def hidden(measured: Any) -> set[str]:
    """Return the effects that some trials cannot show."""
    bench, base = measured.bench()
    tangent = Tangent(bench, base)
    names = [effect.name for effect in EFFECTS]
    return {name for name in names if not visible(bench, base, tangent, name)}


def short(trial: Trial, end: float) -> Trial:
    """Return what was recorded until a time."""

    def cut(signal: Signal | None) -> Signal | None:
        return None if signal is None else signal.between(0.0, end)

    return replace(
        trial,
        force=cut(trial.force),
        tool_height=cut(trial.tool_height),
        displacement_height=cut(trial.displacement_height),
    )


@pytest.fixture(scope='module')
def two(world: Any) -> Any:
    """Return a small campaign."""
    return world.campaign(world.four[:2], hold=3.0, recover=2.0)


def test_a_whole_campaign_shows_all_effects_of_sensors_and_time(world: Any, two: Any) -> None:
    unseen = hidden(world.measure(two, seed=1))
    assert not unseen & {'clock_offset', 'height_bias', 'ageing', 'force_drift', 'series_spring'}


def test_without_a_height_of_its_own_the_range_sensor_cannot_be_tested(
    world: Any, two: Any, without_height: Callable[[Trial], Trial]
) -> None:
    unseen = hidden(world.measure(two, seed=1, change=without_height))
    assert {'clock_offset', 'height_bias'} <= unseen
    assert 'series_spring' not in unseen


def test_one_trial_does_not_age(world: Any) -> None:
    assert 'ageing' in hidden(world.measure(world.campaign(world.four[:1]), seed=1))


def test_without_a_release_nothing_sticks(world: Any, two: Any) -> None:
    whole = world.measure(two, seed=1)
    end = min(phases.t_release for phases in whole.phases) - 0.1
    unseen = hidden(world.measure(two, seed=1, change=lambda trial: short(trial, end)))
    assert 'adhesion' in unseen
    assert 'series_spring' not in unseen


def alike(measured: Any, one: str, other: str) -> tuple[float, float]:
    """Return the cosine of two effects, zero where not listed, and by how much one fits better."""
    bench, base = measured.bench()
    tried = []
    for name in (one, other):
        refit = bench.refit(Model((name,)), base)
        assert refit is not None
        tried.append(Trialled(name, base.deviance - refit.deviance, 0.0, 0.0, refit))
    listed = {(a, b): cosine for a, b, cosine in pairs(bench, base, tried, (one,))}
    assert set(listed) <= {(one, other)}
    return listed.get((one, other), 0.0), tried[0].score - tried[1].score


def test_object_and_machine_give_way_alike_unless_the_object_is_seen(
    world: Any, two: Any, without_height: Callable[[Trial], Trial]
) -> None:
    spring = Undeclared('series_spring', (15_000.0,))
    blind = world.measure(two, spring, seed=1, change=without_height)
    cosine, lead = alike(blind, 'series_spring', 'machine_compliance')
    # In the force alone the two are the same spring; searches end within a tenth.
    assert cosine > 0.999
    assert abs(lead) < 0.5
    seen = world.measure(two, spring, seed=1)
    cosine, lead = alike(seen, 'series_spring', 'machine_compliance')
    assert cosine < 0.99
    assert lead > 50.0


def test_a_drift_looks_like_no_spring(world: Any, two: Any) -> None:
    measured = world.measure(two, Undeclared('force_drift', (0.01,)), seed=1)
    assert alike(measured, 'force_drift', 'series_spring')[0] < 0.1


def test_without_an_accepted_effect_nothing_looks_like_it(noise_only: Any) -> None:
    bench, base = noise_only.bench()
    assert pairs(bench, base, [], ()) == ()


def test_the_true_effect_predicts_pushes_that_it_has_not_seen(yielding: Any) -> None:
    bench, base = yielding.bench()
    groups = conditions(yielding.phases)
    assert len(groups) == 4
    right = bench.refit(Model(('yield_force',)), base)
    useless = bench.refit(Model(('force_drift',)), base)
    assert right is not None
    assert useless is not None
    # The misfit is as large as the noise: half of the squares, or nearly.
    assert left_out(bench, base, right, groups) < 0.8
    # Its one parameter moves squares of some thousands by a few.
    assert left_out(bench, base, useless, groups) == pytest.approx(1.0, abs=0.03)


def test_a_single_push_leaves_none_to_predict(yielding: Any) -> None:
    bench, base = yielding.bench()
    assert left_out(bench, base, base, [[0, 1, 2, 3]]) is None
