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
"""Records that are odd, cut or damaged, through the whole fit: a result or a reason."""

from collections.abc import Callable
from dataclasses import replace
import json
import warnings

from hapticvision_ros.cli.main import main
from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    Push,
    random_campaign,
    Run,
    run,
    Sensors,
    write_bags,
)
from hapticvision_ros.sim.specimen import Body
import numpy as np
import pytest

CAMPAIGN = Campaign(
    Body(1500.0, 1200.0, 3000.0),
    (Push(0.008, 0.006, 3.0, 2.0), Push(0.004, 0.004, 3.0, 2.0)),
    Sensors(ForceNoise(0.05), 3e-5, force_rate=100.0, tool_rate=100.0, height_rate=20.0),
)
"""Pushes that touch at some 2 s, stop at some 2.8 s and are released at 5.8 s."""

type Change = Callable[[Signal], Signal]


def each(
    force: Change | None = None, tool: Change | None = None, height: Change | None = None
) -> Callable[[Trial], Trial]:
    """Return what changes the signals of a trial."""

    def changed(trial: Trial) -> Trial:
        seen = trial.displacement_height
        assert seen is not None
        return replace(
            trial,
            force=trial.force if force is None else force(trial.force),
            tool_height=trial.tool_height if tool is None else tool(trial.tool_height),
            displacement_height=seen if height is None else height(seen),
        )

    return changed


def all_of(change: Change) -> Callable[[Trial], Trial]:
    return each(change, change, change)


def part(start: float, stop: float) -> Change:
    return lambda signal: signal.between(start, stop)


def gap(start: float, stop: float) -> Change:
    def cut(signal: Signal) -> Signal:
        keep = (signal.t < start) | (signal.t > stop)
        return Signal(signal.t[keep], signal.value[keep])

    return cut


def scaled(factor: float, offset: float = 0.0) -> Change:
    return lambda signal: Signal(signal.t, factor * signal.value + offset)


def slower(factor: float) -> Change:
    return lambda signal: Signal(factor * signal.t, signal.value)


def later(delay: float) -> Change:
    return lambda signal: Signal(signal.t + delay, signal.value)


def clipped(most: float) -> Change:
    return lambda signal: Signal(signal.t, np.minimum(signal.value, most))


def in_steps(step: float) -> Change:
    return lambda signal: Signal(signal.t, step * np.round(signal.value / step))


def drifting(rate: float) -> Change:
    return lambda signal: Signal(signal.t, signal.value + rate * signal.t)


def spiky(size: float) -> Change:
    def spoilt(signal: Signal) -> Signal:
        random = np.random.default_rng(1)
        value = signal.value.copy()
        at = random.integers(0, value.size - 1, value.size // 50)
        value[at] += size
        value[at[::3] + 1] += size
        return Signal(signal.t, value)

    return spoilt


def too_low(signal: Signal) -> Signal:
    value = signal.value.copy()
    value[100] -= 0.02
    return Signal(signal.t, value)


def wandering(signal: Signal) -> Signal:
    steps = np.random.default_rng(2).standard_normal(signal.t.size)
    return Signal(signal.t, 0.05 * np.cumsum(steps))


def twice(signal: Signal) -> Signal:
    t = np.concatenate((signal.t, signal.t + signal.t[-1] + 0.01))
    return Signal(t, np.concatenate((signal.value, signal.value)))


ODD = {
    'begins in the push': all_of(part(2.3, np.inf)),
    'begins at the stop': all_of(part(2.82, np.inf)),
    'begins in the hold': all_of(part(4.0, np.inf)),
    'begins after the release': all_of(part(6.2, np.inf)),
    'ends in the air': all_of(part(0.0, 1.5)),
    'ends at the touch': all_of(part(0.0, 2.1)),
    'ends in the push': all_of(part(0.0, 2.5)),
    'ends in the hold': all_of(part(0.0, 3.0)),
    'lacks the touch': all_of(gap(1.9, 2.3)),
    'lacks the stop': all_of(gap(2.5, 3.2)),
    'lacks the tool at the touch': each(tool=gap(1.9, 2.3)),
    'ten forces a second': each(lambda signal: Signal(signal.t[::10], signal.value[::10])),
    'ten heights a second': each(None, lambda signal: Signal(signal.t[::10], signal.value[::10])),
    'one sample in minutes': all_of(slower(1000.0)),
    'force upside down': each(scaled(-1.0)),
    'no force': each(scaled(0.0)),
    'force in kN': each(scaled(1e-3)),
    'force with a large zero': each(scaled(1.0, 1e6)),
    'tool upside down': each(None, scaled(-1.0)),
    'tool in mm': each(None, scaled(1e3)),
    'tool that stands still': each(None, scaled(0.0, 0.03)),
    'tool half a second late': each(None, later(0.5)),
    'H upside down': each(None, None, scaled(-1.0)),
    'H in mm': each(None, None, scaled(1e3)),
    'H that stands still': each(None, None, scaled(0.0, 0.002)),
    'H three seconds late': each(None, None, later(3.0)),
    'saturated': each(clipped(5.0)),
    'steps of a newton': each(in_steps(1.0)),
    'steps of a millimetre': each(None, in_steps(1e-3)),
    'drifts down': each(drifting(-2.0)),
    'spikes': each(spiky(1e3)),
    'spikes of the encoder': each(None, spiky(0.5)),
    'spikes of the encoder down': each(None, spiky(-0.04)),
    'one reading of the encoder too low': each(None, too_low),
    'walks at random': each(wandering),
    'two pushes': all_of(twice),
}
HARMLESS = (
    'force with a large zero',
    'ends in the hold',
    'spikes',
    'spikes of the encoder',
    'spikes of the encoder down',
    'one reading of the encoder too low',
)
"""What is left of these, or all of it, is an object that the base model explains."""


@pytest.fixture(scope='module')
def made() -> Run:
    return run(CAMPAIGN, seed=1)


@pytest.mark.parametrize('odd', ODD)
def test_odd_records_give_a_result_or_a_reason(made, tmp_path, capsys, odd):
    change = ODD[odd]
    trials = (change(made.trials[0]), made.trials[1])
    bags = write_bags(Run(trials, made.truth), tmp_path, compression='none')
    out = tmp_path / 'out'
    with warnings.catch_warnings():
        warnings.simplefilter('error')
        code = main(['fit', *map(str, bags), '--out', str(out)])
    said = capsys.readouterr()
    if code:
        # One sentence, which names the trial.
        (sentence,) = said.err.strip().splitlines()
        assert bags[0].name in sentence
        return
    result = json.loads((out / 'result.json').read_text())
    assert (out / 'report.html').stat().st_size > 0
    if odd in HARMLESS:
        assert result['diagnosis']['status'] == 'none'
        assert 'no model is fitted' not in json.dumps(result['warnings'])


def test_a_few_heights_are_not_explained_by_an_effect():
    """Two in each trial: what fits them to the last digit is not what made them."""
    whole = run(random_campaign(6, longest=12.0), seed=1).trials
    few = [each(None, None, lambda s: Signal(s.t[::80], s.value[::80]))(trial) for trial in whole]
    assert sum(len(trial.displacement_height) for trial in few) == 6
    found = diagnose([analyse(trial) for trial in few])
    assert found.status == 'none'
    assert any('too few to tell their noise' in warning for warning in found.before.warnings)


@pytest.mark.parametrize('thinner', [10, 15, 25, 40])
def test_forces_that_come_more_slowly_than_heights_are_no_effect(thinner):
    """Down to 2.5 a second, with 16 heights: several of these in the step of one force."""
    whole = run(random_campaign(6, longest=12.0), seed=1).trials
    slow = [each(lambda s: Signal(s.t[::thinner], s.value[::thinner]))(trial) for trial in whole]
    found = diagnose([analyse(trial) for trial in slow])
    assert found.status == 'none', found.effects


@pytest.mark.parametrize(
    ('force_rate', 'height_rate', 'hold', 'noise'),
    [(10.0, 60.0, 30.0, 5e-6), (5.0, 30.0, 60.0, 1e-5), (50.0, 500.0, 30.0, 3e-6)],
)
def test_a_slow_load_cell_beside_a_fast_range_sensor_is_no_effect(
    force_rate, height_rate, hold, noise
):
    pushes = tuple(Push(v, d, hold, 2.0) for v, d in ((0.008, 0.006), (0.004, 0.004)))
    sensors = Sensors(
        ForceNoise(0.05), noise, force_rate=force_rate, tool_rate=250.0, height_rate=height_rate
    )
    made = run(Campaign(CAMPAIGN.body, pushes, sensors), seed=1)
    found = diagnose([analyse(trial) for trial in made.trials])
    assert found.status == 'none', found.effects


@pytest.mark.parametrize('seed', [1, 2, 3])
def test_stamps_that_are_a_little_off_are_no_effect(seed):
    """By a fifth of their interval, as of heights that are stamped when they are sent."""
    random = np.random.default_rng(seed)

    def off(signal: Signal) -> Signal:
        interval = float(np.median(np.diff(signal.t)))
        error = np.clip(0.2 * random.standard_normal(signal.t.size), -0.45, 0.45)
        return Signal(signal.t + interval * error, signal.value)

    found = diagnose([analyse(all_of(off)(trial)) for trial in run(CAMPAIGN, seed=seed).trials])
    assert found.status == 'none', found.effects
