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


"""How an arm changes its speed, as all trials of a campaign tell it together."""

from dataclasses import replace
from itertools import pairwise
from typing import Any

from hapticvision_ros.core.fit import data
from hapticvision_ros.core.fit.bend import (
    Bend,
    Corner,
    is_apart,
    rounded,
    Servo,
    servo_of,
    Shape,
    told,
)
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.data import (
    _misread,
    _path,
    arm_of,
    prepare,
    suspects,
    tool_path,
    ToolPath,
)
from hapticvision_ros.core.records import Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body
import numpy as np
import pytest
from scipy.signal import cont2discrete, lfilter
from scipy.special import logsumexp

TOP = 0.03
STEP = 1e-5
SPEEDS = (0.0011, 0.0016, 0.0025, 0.0045)
SHAPE = Shape(0.07, 0.05, 0.02)


def _way(t: np.ndarray, speed: float, stop: float, shape: Shape, release: float) -> np.ndarray:
    """Return the way of an arm that stops and withdraws, by filters in a row and a servo."""
    fine = np.arange(-1.0, t[-1] + STEP, STEP)
    followed = np.where(fine < stop, speed, np.where(fine < release, 0.0, -0.02))
    for length in (shape.duration, shape.jerk):
        count = max(round(length / STEP), 1)
        total = np.cumsum(np.concatenate((np.full(count, speed), followed)))
        followed = (total[count:] - total[:-count]) / count
    if shape.lag:
        followed = speed + _servo(followed - speed, shape)
    way = np.cumsum(followed) * STEP
    return np.interp(t, fine, way - np.interp(0.0, fine, way)) - 0.001


def _servo(speed: np.ndarray, shape: Shape) -> np.ndarray:
    """Return what a servo makes of a speed that begins at zero."""
    if not shape.swing:
        keep = np.exp(-STEP / shape.lag)
        return lfilter([1.0 - keep], [1.0, -keep], speed)
    servo = ([1.0], [shape.swing * shape.lag**2, shape.lag, 1.0])
    ahead, back, _ = cont2discrete(servo, STEP, 'foh')
    return lfilter(ahead.ravel(), back, speed)


@pytest.mark.parametrize(
    'shape',
    [
        SHAPE,
        Shape(0.05),
        Shape(0.05, 0.05),
        Shape(0.02, 0.0, 0.03),
        *(Shape(0.02, 0.01, 0.03, swing) for swing in (0.01, 0.1, 0.25, 0.7, 2.0)),
        Shape(0.02, 0.0, 0.03, 1.0),
    ],
)
def test_a_corner_is_passed_as_filters_in_a_row_pass_it(shape: Shape) -> None:
    away = np.linspace(-0.2, 0.4, 601)
    speed = np.where(np.arange(-1.0, 1.0, STEP) < 0.0, 0.0, 1.0)
    for length in (shape.duration, shape.jerk):
        count = max(round(length / STEP), 1)
        total = np.cumsum(np.concatenate((np.zeros(count), speed)))
        # Half of a filter's length later, which is where the straight pieces are.
        speed = np.roll((total[count:] - total[:-count]) / count, -(count // 2))
    t = np.arange(-1.0, 1.0, STEP)
    if shape.lag:
        speed = _servo(speed, shape)
        t = t - shape.lag
    way = np.interp(away, t, np.cumsum(speed) * STEP) - np.maximum(away, 0.0)
    assert rounded(away, shape) == pytest.approx(way, abs=3e-5)


@pytest.mark.parametrize('jerk', [0.0, 0.01])
def test_a_critically_damped_servo_is_between_those_that_are_hardly_otherwise(jerk: float) -> None:
    away = np.linspace(-0.2, 0.6, 801)
    less, critical, more = (
        rounded(away, Shape(0.03, jerk, 0.1, 0.25 + step)) for step in (-1e-4, 0.0, 1e-4)
    )
    assert critical == pytest.approx(0.5 * (less + more), abs=1e-9)


def _campaign(
    shapes: list[Shape],
    step: float,
    released: list[Shape] | None = None,
    interval: float = 0.008,
) -> list[tuple[Trial, Segmentation]]:
    """Return pushes whose tool goes as given, through encoders that round; the force is not."""
    pushes = tuple(Push(speed, 0.004, 4.0, 2.0) for speed in SPEEDS)
    sensors = Sensors(ForceNoise(0.01), 1e-5)
    made = []
    trials = run(Campaign(Body(1000.0, 900.0, 1600.0), pushes, sensors), seed=3).trials
    for trial, speed, shape, other in zip(trials, SPEEDS, shapes, released or shapes, strict=True):
        phases = segment(trial.force, trial.tool_height, trial.displacement_height)
        t = np.arange(0.0, trial.tool_height.t[-1], interval)
        since = t - phases.t_contact + 0.001 / speed
        way, later = (
            _way(since, speed, 0.004 / speed, each, 0.004 / speed + 4.0) for each in (shape, other)
        )
        held = int(np.searchsorted(since, 0.004 / speed + 3.0))
        way[held:] = later[held:] + way[held] - later[held]
        read = phases.contact_height - np.round(way / step) * step
        made.append((replace(trial, tool_height=Signal(t, read)), phases))
    return made


def _off(path: ToolPath, phases: Segmentation, speed: float, shape: Shape = SHAPE) -> float:
    """Return by how much the speed of a path is off where the tool stops, relative."""
    begun = phases.t_contact - 0.001 / speed
    near = begun + 0.004 / speed + np.arange(-0.1, 0.25, 0.002)
    true = _way(near - begun, speed, 0.004 / speed, shape, 0.004 / speed + 4.0)
    off = np.diff(path.at(near) - true) / 0.002 / speed
    return float(np.sqrt(np.mean(off**2)))


def _displacement(trial: Trial, phases: Segmentation) -> Signal:
    return Signal(trial.tool_height.t, phases.contact_height - trial.tool_height.value)


def test_all_trials_tell_how_the_arm_stops_better_than_each_by_itself() -> None:
    """Encoders of 125 Hz that round to 5 um: a stop from 1 mm/s is a few readings."""
    trials = _campaign([SHAPE] * 4, 5e-6)
    made, _ = prepare(trials)
    together, alone = [], []
    for trial, (read, phases), speed in zip(made, trials, SPEEDS, strict=True):
        assert trial is not None
        together.append(_off(trial.path, phases, speed))
        alone.append(_off(tool_path(_displacement(read, phases), phases), phases, speed))
    # A speed that is off by two percent is a force that is off by as much, for a moment.
    assert max(together) < 0.02
    assert max(alone) > 2.0 * max(together)


def test_changes_of_speed_that_differ_are_not_made_alike() -> None:
    shapes = [Shape(0.03, 0.01), Shape(0.03, 0.0, 0.04), Shape(0.2, 0.1), Shape(0.1, 0.0, 0.02)]
    told = []
    for chosen in (shapes, [SHAPE] * 4):
        turns = [
            turn
            for trial, phases in _campaign(chosen, 1e-6)
            for turn in _path(_displacement(trial, phases), phases, None)[1]
        ]
        assert len(turns) >= 4
        told.append(servo_of([turn.corner for turn in turns], [turn.shape for turn in turns]))
    assert told[0] is None
    assert told[1] is not None
    assert not told[1].even
    # Two lags one after the other, of which one is short, may pass for one; the way is as it is.
    away = np.linspace(-0.2, 0.4, 601)
    for turn in turns:
        way = rounded(away, told[1].at(turn.corner))
        off = turn.corner.turn * (way - rounded(away, SHAPE))
        assert np.abs(off).max() < 0.5e-6, 'half a step of the encoders'


def _drawn_out(t: np.ndarray, changes: list[tuple[float, float]]) -> np.ndarray:
    """Return the way of an arm whose speed changes by cubics of the time, 25 mm/s^2 on average."""
    way = np.zeros(t.size)
    for at, change in changes:
        lasts = 40.0 * abs(change)
        part = np.clip((t - at) / lasts + 0.5, 0.0, 1.0)
        way += change * (lasts * (part**3 - 0.5 * part**4) + np.maximum(t - at - 0.5 * lasts, 0.0))
    return way


def test_a_change_of_speed_may_be_drawn_out_as_it_is_larger() -> None:
    """A planner with one smooth ramp for all; where the jerk is limited they are not alike."""
    trials, truth = [], []
    random = np.random.default_rng(1)
    for (trial, phases), speed in zip(_campaign([SHAPE] * 4, 1e-6), SPEEDS, strict=True):
        t, stop = trial.tool_height.t, phases.t_contact + 0.003 / speed
        begun = phases.t_contact - 0.001 / speed
        changes = [(begun, speed), (stop, -speed), (stop + 4.0, -0.006), (stop + 4.9, 0.006)]
        read = 3e-7 * random.standard_normal(t.size) - 0.001 + _drawn_out(t, changes)
        read = phases.contact_height - np.round(read / 1e-6) * 1e-6
        trials.append((replace(trial, tool_height=Signal(t, read)), phases))
        truth.append((stop, changes))
    servo, _ = arm_of(trials)
    assert servo is not None
    assert servo.even
    assert servo.drawn_out
    made, _ = prepare(trials)
    for trial, speed, (stop, changes) in zip(made, SPEEDS, truth, strict=True):
        assert trial is not None
        near = stop + np.arange(-0.2, 0.3, 0.002)
        off = np.diff(trial.path.at(near) - _drawn_out(near, changes)) / 0.002 / speed
        assert np.sqrt(np.mean(off**2)) < 0.006


def _led(t: np.ndarray, touch: float, speed: float) -> np.ndarray:
    """Return the way of a guarded push by an arm whose commands are averaged over two times."""
    fine = np.arange(0.0, t[-1] + 2.0, 1e-4)
    slow, fast = touch - 0.3, touch + 0.1
    stop = fast + 0.003 / speed
    followed = np.select(
        [fine < slow, fine < fast, fine < stop, fine < stop + 3.0],
        [speed, 0.06 * speed, speed, 0.0],
        -speed,
    )
    for length in (1200, 600):
        total = np.cumsum(np.concatenate((np.full(length, speed), followed)))
        followed = (total[length:] - total[:-length]) / length
    way = np.cumsum(followed) * 1e-4
    return np.interp(t, fine, way - np.interp(touch, fine, way))


@pytest.mark.parametrize('seed', [4, 5])
def test_a_ramp_that_is_followed_at_once_has_no_lag(seed: int) -> None:
    """The slow way before the push ends where it hardly has become straight."""
    random = np.random.default_rng(seed)
    trials, truth = [], []
    for (trial, phases), speed in zip(
        _campaign([SHAPE] * 4, 1e-6, interval=0.01), SPEEDS, strict=True
    ):
        t, touch = trial.tool_height.t, phases.t_contact
        read = _led(t, touch, speed) + 1e-6 * random.standard_normal(t.size)
        read = phases.contact_height - np.round(read / 2e-6) * 2e-6
        trials.append((replace(trial, tool_height=Signal(t, read)), phases))
        truth.append((touch, speed))
    servo, _ = arm_of(trials)
    assert servo is not None
    assert servo.lag == 0.0
    made, _ = prepare(trials)
    for trial, (touch, speed) in zip(made, truth, strict=True):
        assert trial is not None
        near = touch + np.arange(-0.1, 0.4, 0.002)
        off = np.diff(trial.path.at(near) - _led(near, touch, speed)) / 0.002
        # With lines that begin where the arm still changes its speed it is up to 29 um/s.
        assert np.sqrt(np.mean(off**2)) < 1.8e-5


def test_a_start_that_goes_on_after_the_touch_is_followed_as_the_stops() -> None:
    """The tool begins to move a tenth of a millimetre above the object."""
    trials, truth = [], []
    random = np.random.default_rng(1)
    for (trial, phases), speed in zip(_campaign([SHAPE] * 4, 1e-6), SPEEDS, strict=True):
        t = trial.tool_height.t
        # By so much it has moved on average when it touches.
        touch = np.interp(1e-4, _drawn_out(t - 1.0, [(0.0, speed)]), t - 1.0)
        begun = phases.t_contact - touch
        stop = begun + 0.003 / speed
        changes = [(begun, speed), (stop, -speed), (stop + 4.0, -0.006), (stop + 4.7, 0.006)]
        read = 4e-6 * random.standard_normal(t.size) - 1e-4 + _drawn_out(t, changes)
        trials.append(
            (replace(trial, tool_height=Signal(t, phases.contact_height - read)), phases)
        )
        truth.append(changes)
    # The quickest, whose own shape ends on the object, tells how the arm does it as well.
    _, corners = arm_of(trials)
    assert any(corner.is_start and corner.turn > 0.0 for corner in corners)
    made, _ = prepare(trials)
    held = 0
    for trial, (_, phases), speed, changes in zip(made, trials, SPEEDS, truth, strict=True):
        assert trial is not None
        near = phases.t_contact + np.arange(0.0, 0.3, 0.002)
        off = np.diff(trial.path.at(near) - _drawn_out(near, changes)) / 0.002 / speed
        if changes[0][0] + 20.0 * speed > phases.t_contact:
            assert trial.path.bends[0].t < phases.t_contact
            assert trial.path.bends[0].common
            held += 1
        # By a shape of its own it is off by up to one percent.
        assert np.sqrt(np.mean(off**2)) < 0.005
    assert held == 2


def test_stops_may_be_alike_where_withdrawals_are_not() -> None:
    released = [Shape(duration) for duration in (0.03, 0.2, 0.09, 0.4)]
    trials = _campaign([SHAPE] * 4, 5e-6, released)
    servo, corners = arm_of(trials)
    assert servo is not None and servo.stops
    assert servo.others is None
    assert [servo.of(corner) for corner in corners].count(servo) == len(trials)
    made, _ = prepare(trials)
    off = [
        _off(trial.path, phases, speed)
        for trial, (_, phases), speed in zip(made, trials, SPEEDS, strict=True)
        if trial is not None
    ]
    assert len(off) == len(trials)
    assert max(off) < 0.02


def test_stops_and_withdrawals_may_each_be_alike() -> None:
    trials = _campaign([SHAPE] * 4, 5e-6, [Shape(0.3, 0.02)] * 4)
    servo, corners = arm_of(trials)
    assert servo is not None and servo.others is not None
    assert servo.others.shape(0.02).duration == pytest.approx(0.3, rel=0.05)
    stop = servo.shape(-SPEEDS[0])
    assert stop.duration + 2.0 * stop.lag == pytest.approx(0.11, rel=0.3)
    assert {servo.of(corner) for corner in corners} == {servo, servo.others}


def test_one_controller_makes_stops_and_withdrawals_that_last_otherwise() -> None:
    """Quick withdrawals show the lag and how the acceleration comes, which slow stops do not."""
    soft = Shape(0.08, 0.05, 0.007)
    brief = Shape(0.06, 0.0375, 0.007)
    off = []
    for released in ([brief] * 4, [Shape(0.06, 0.0, 0.02)] * 4):
        servo, corners = arm_of(_campaign([soft] * 4, 2e-6, released))
        assert servo is not None and servo.others is not None
        assert len(corners) >= 8
        alike = servo.lag == servo.others.lag and servo.jerk == servo.others.jerk
        assert alike == (released[0] == brief)
        off.append(abs(servo.shape(-SPEEDS[0]).duration / soft.duration - 1.0))
    assert off[0] < 0.05


def test_an_arm_that_goes_beyond_where_it_stops_is_followed() -> None:
    """A servo of 3 Hz with a damping ratio of a half, through encoders that tell it or not."""
    shape = Shape(0.03, 0.01, 0.053, 1.0)
    servo = _follows(_campaign([shape] * 4, 2e-6), shape, 0.01)
    assert servo.swing == pytest.approx(1.0, rel=0.05)
    assert servo.lag == pytest.approx(shape.lag, rel=0.02)
    _follows(_campaign([shape] * 4, 2e-5), shape, 0.1)


def test_clear_swings_are_followed_and_what_is_not_made_so_does_not_hide_them() -> None:
    """Quick pushes through fine encoders: a servo of 6.5 Hz with a damping ratio of a third."""
    shape, held = Shape(0.045, 0.0, 0.017, 2.0), Shape(0.3, 0.1)
    trials = _campaign([shape, shape, shape, held], 1e-6, [shape] * 4)
    servo, _ = arm_of(trials)
    assert servo is not None
    assert servo.swing == pytest.approx(shape.swing, rel=0.02)
    assert servo.lag == pytest.approx(shape.lag, rel=0.01)
    # Of how the acceleration comes hardly more than its second moment is told.
    made_so = servo.shape(0.02)
    lasts = np.hypot(made_so.duration, made_so.jerk)
    assert lasts == pytest.approx(np.hypot(shape.duration, shape.jerk), rel=0.05)
    # The last stop is not made so, and its path is none of that servo.
    made, _ = prepare(trials)
    off = [
        _off(trial.path, phases, speed, each)
        for trial, (_, phases), speed, each in zip(
            made, trials, SPEEDS, [shape, shape, shape, held], strict=True
        )
        if trial is not None
    ]
    assert len(off) == len(trials)
    assert max(off) < 0.02


def test_a_stop_is_followed_after_a_push_that_is_shorter_than_the_swing() -> None:
    """The line before it is short, and the tool goes on to swing for longer."""
    shape = Shape(0.045, 0.0, 0.017, 2.0)
    (trial, phases), *_ = _campaign([shape] * 4, 1e-6)[-1:]
    whole = _displacement(trial, phases)
    stop = phases.t_contact + 0.003 / SPEEDS[-1]
    late = whole.between(stop - 0.25, phases.t_release - 0.5)
    stops = [turn for turn in _path(late, phases, None)[1] if turn.corner.is_stop]
    assert len(stops) == 1
    delay = 0.5 * shape.duration + shape.lag
    assert stops[0].bend.t == pytest.approx(stop + delay, abs=2e-3)
    assert stops[0].shape.swing == pytest.approx(shape.swing, rel=0.1)


TEETH = 6
TOOTH = 0.14


def _to_and_fro(t: np.ndarray, speed: float, *, scaled: bool) -> np.ndarray:
    """Return the way of an arm that goes to and fro at the end of a push, and is withdrawn."""
    turn = 0.004 / speed
    moments = [turn + TOOTH * k for k in range(TEETH + 1)]
    moments[-1] -= 0.3 * TOOTH
    moments.append(turn + 4.0)
    speeds = [speed * (-1.0) ** k for k in range(TEETH + 1)] + [0.0, -0.02]
    way = speed * t - 0.001
    jerk = 0.0098
    for at, (before, after) in zip(moments, pairwise(speeds), strict=True):
        whole = max(abs(before), abs(after))
        lasts = 0.0233 * (abs(after - before) / whole if scaled else 1.0)
        # An even acceleration over one time, averaged over the other, integrated twice.
        cubes = [
            sign * np.maximum(t - at + 0.5 * (a * lasts + b * jerk), 0.0) ** 3
            for sign, a, b in ((1, 1, 1), (-1, 1, -1), (-1, -1, 1), (1, -1, -1))
        ]
        way += (after - before) * sum(cubes) / (6.0 * lasts * jerk)
    return way


@pytest.mark.parametrize('scaled', [True, False])
@pytest.mark.parametrize('interval', [0.02, 0.004])
def test_clean_encoders_tell_how_a_tool_goes_to_and_fro(scaled: bool, interval: float) -> None:
    """Of a tooth they have seven samples, of which three or four are on a straight line."""
    speeds = (0.0045, 0.0084, 0.0063, 0.0084)
    pushes = tuple(Push(speed, 0.004, 4.0, 2.0) for speed in speeds)
    sensors = Sensors(ForceNoise(0.01), 1e-5)
    trials, truth = [], []
    for trial, speed in zip(
        run(Campaign(Body(1000.0, 900.0, 1600.0), pushes, sensors), seed=3).trials,
        speeds,
        strict=True,
    ):
        phases = segment(trial.force, trial.tool_height, trial.displacement_height)
        t = np.arange(0.0, trial.tool_height.t[-1], interval)
        begun = phases.t_contact - 0.001 / speed
        way = _to_and_fro(t - begun, speed, scaled=scaled)
        trials.append((replace(trial, tool_height=Signal(t, TOP - way)), phases))
        trials[-1] = trials[-1][0], replace(phases, contact_height=TOP)
        truth.append((begun, speed))
    servo, corners = arm_of(trials)
    assert servo is not None
    assert len(corners) >= 4 * TEETH
    assert servo.scaled == scaled
    stop, turned = (servo.shape(part * speeds[1], part) for part in (1.0, 2.0))
    assert stop.duration == pytest.approx(0.0233, rel=0.02)
    assert turned.duration == pytest.approx(0.0233 * (2.0 if scaled else 1.0), rel=0.02)
    made, _ = prepare(trials)
    for trial, (begun, speed) in zip(made, truth, strict=True):
        assert trial is not None
        near = np.arange(0.003 / speed, 0.005 / speed + TEETH * TOOTH, 0.002)
        true = _to_and_fro(near, speed, scaled=scaled)
        off = np.diff(trial.path.at(near + begun) - true) / 0.002 / speed
        # Straight lines from sample to sample are off by some twenty percent.
        assert np.abs(off).max() < 0.02


def test_a_way_there_and_back_is_no_glitch() -> None:
    """The last tooth before a long hold stands out of it; a burst of odd readings does as well."""
    t = np.arange(0.0, 5.0, 0.02)
    way = _to_and_fro(t, 0.0084, scaled=True)
    assert suspects(way).any()
    assert not _misread(way).any()
    odd = way.copy()
    odd[120:130] += 1e-3 * np.random.default_rng(0).choice([-1.0, 1.0], 10)
    assert _misread(odd)[120:130].all()
    # Between two of a push, those that are right are set aside with them.
    push = 1e-5 * np.arange(400.0)
    push[[200, 207]] += 0.04
    assert _misread(push)[[200, 207]].all()


def test_few_clean_samples_tell_a_servo_of_second_order() -> None:
    """Of 50 Hz: seven samples of each change of speed, and one that is made of two."""
    shape = Shape(0.0962, 0.0, 0.0198, 0.285)
    trials = _campaign([shape] * 4, 1e-12, interval=0.02)
    trial, phases = trials[0]
    t, way = trial.tool_height.t, phases.contact_height - trial.tool_height.value
    # It is let go faster while it still begins to be withdrawn.
    begun = phases.t_contact - 0.001 / SPEEDS[0] + 0.004 / SPEEDS[0] + 4.0
    way -= 0.4 * np.clip(t - begun - 0.07, 0.0, None) ** 2 * (t < begun + 0.13)
    later = t >= begun + 0.13
    way[later] -= 0.4 * 0.06**2 + 0.8 * 0.06 * (t[later] - begun - 0.13)
    read = Signal(t, phases.contact_height - way)
    trials[0] = replace(trial, tool_height=read), phases
    servo, corners = arm_of(trials)
    assert servo is not None
    assert len(corners) >= 7
    assert servo.duration == pytest.approx(shape.duration, rel=0.01)
    assert servo.lag == pytest.approx(shape.lag, rel=0.02)
    assert servo.swing == pytest.approx(shape.swing, rel=0.02)
    made, _ = prepare(trials)
    assert made[0] is not None
    # A lag of first order, and an acceleration that comes slowly, are off by five times that.
    assert _off(made[0].path, phases, SPEEDS[0], shape) < 2e-6


def _follows(trials: list[tuple[Trial, Segmentation]], shape: Shape, most: float) -> Servo:
    """Return the servo of a campaign whose paths go as a shape says, but for `most`."""
    made, _ = prepare(trials)
    for trial, (_, phases), speed in zip(made, trials, SPEEDS, strict=True):
        assert trial is not None and trial.path.t.size <= 8
        assert _off(trial.path, phases, speed, shape) < most
    servo, _ = arm_of(trials)
    assert servo is not None
    return servo


def test_limits_of_an_arm_are_told() -> None:
    arm = Servo(0.1, 0.5, 0.02, even=False, lasts=0.1)
    assert arm.inward(0.1, 0.1, 0.1) == (0.0, 0.0, 0.0)
    assert replace(arm, lag=0.0, jerk=0.0).inward(0.1, 0.1, 0.1) == (0.0, 1.0, 1.0)
    assert replace(arm, jerk=1.0).inward(0.1, 0.1, 0.1) == (0.0, 0.0, -1.0)
    waiting = replace(arm, duration=0.0, parted=True, wait=0.1)
    assert waiting.inward(0.1, 0.1, 0.1)[0] == 1.0
    slower = waiting.changed(1.0, 0.0, 0.0)
    assert 0.0 < slower.duration < slower.wait
    assert slower.duration + slower.wait == pytest.approx(0.1)
    assert replace(waiting, duration=0.05, wait=0.0).changed(-0.1, 0.0, 0.0).wait == 0.0


def test_a_corner_of_one_sample_tells_nothing() -> None:
    """Lines that share a sample, beside gaps of the record."""
    alone = Corner(np.array([2.5]), np.array([0.0]), 0.0, 0.001, 0.0, -0.001, -1, 0.0, 1e-8)
    assert alone.noisiness == np.inf
    assert servo_of([alone] * 3, [Shape(0.0)] * 3) is None


@pytest.mark.parametrize('shape', [SHAPE, Shape(0.02), Shape(0.05, 0.0, 0.02, 1.0)])
@pytest.mark.parametrize('rest', [1, -1])
def test_what_is_less_likely_than_others_makes_no_difference(shape: Shape, rest: int) -> None:
    t = np.arange(-0.2, 0.2, 0.004)
    speed, coarse, noise = 0.002, 0.5 * STEP, 2e-6
    # A stop that is some steps of the encoders long, and a rest beside the middle of a step.
    way = speed * np.minimum(t, 0.0) - speed * rounded(t, SHAPE) + 0.3 * STEP
    read = STEP * np.round(way / STEP)
    corner = Corner(t, read, 0.3 * STEP, speed, read[-1], 0.0, rest, coarse, noise)
    left = np.array([corner.left(shape, shift) for shift in corner.shifts.tolist()]) / noise**2
    whole = -2.0 * float(logsumexp(-0.5 * left) - np.log(left.size))
    assert corner.deviance(shape) == pytest.approx(whole, rel=1e-9)
    assert corner.deviance(shape, whole + 1.0) == pytest.approx(whole, rel=1e-9)
    assert corner.deviance(shape, whole - 1.0) == whole - 1.0


RAMP = 0.074
"""How long the tool takes from rest to its speed, and back."""


def _eased(t: np.ndarray, changes: list[tuple[float, float]]) -> np.ndarray:
    """Return the way of a tool whose speed changes, each time as half a wave of a cosine does."""
    way = np.zeros(t.size)
    for at, change in changes:
        since = t - at
        part = np.clip(since / RAMP + 0.5, 0.0, 1.0)
        eased = 0.5 * RAMP * (part - np.sin(np.pi * part) / np.pi)
        way += change * (eased + np.maximum(since - 0.5 * RAMP, 0.0))
    return way


def _there_and_back(
    speeds: tuple[float, ...], quick: float, way: float, noise: float, interval: float
) -> tuple[list[tuple[Trial, Segmentation]], list[list[tuple[float, float]]]]:
    """Return slow ways to and fro after a quick approach, turned by a stop and a start."""
    pushes = tuple(Push(speed, 0.004, 4.0, 2.0) for speed in speeds)
    sensors = Sensors(ForceNoise(0.01), 1e-5)
    random = np.random.default_rng(5)
    trials, truth = [], []
    campaign = Campaign(Body(1000.0, 900.0, 1600.0), pushes, sensors)
    for trial, speed in zip(run(campaign, seed=3).trials, speeds, strict=True):
        phases = segment(trial.force, trial.tool_height, trial.displacement_height)
        # A third of the slow way is above the object.
        begun, slow = 1.0, 1.0 + 0.02 / quick
        turn = slow + way / speed
        away = turn + RAMP + way / speed
        gone = away + 0.02 / quick
        changes = [(begun, quick), (slow, speed - quick), (turn, -speed)]
        changes += [(turn + RAMP, -speed), (away, speed - quick), (gone, quick)]
        t = np.arange(0.0, gone + 2.0, interval)
        gone_by = _eased(t, changes) - 0.02 - way / 3.0
        gone_by += noise * random.standard_normal(t.size)
        phases = replace(
            phases,
            t_contact=slow + way / 3.0 / speed,
            t_hold=None,
            t_release=turn,
            t_loss=turn + RAMP + 0.5 * way / speed,
            t_end=float(t[-1]),
            contact_height=TOP,
        )
        force = Signal(t, np.interp(t, trial.force.t, trial.force.value))
        moved = replace(trial, force=force, tool_height=Signal(t, TOP - gone_by))
        trials.append((moved, phases))
        truth.append(changes)
    return trials, truth


def test_a_stop_and_a_start_are_two_changes_of_speed() -> None:
    bend = Bend(1.0, -0.03, Shape(0.03, 0.01, 0.02, 0.0, 0.3, 0.1))
    t = np.linspace(0.5, 2.0, 3001)
    slopes = 0.3 * 0.03, -0.7 * 0.03
    whole = np.where(t < 1.0, slopes[0], slopes[1]) * (t - 1.0)
    within = slice(*np.searchsorted(t, (bend.start, bend.stop)))
    whole[within] += bend.beyond(t[within])
    stop, start = bend.halves
    assert start.t - stop.t == pytest.approx(0.03 + 0.01 + 0.1)
    rest = slopes[0] * (stop.t - 1.0)
    assert slopes[1] * (start.t - 1.0) == pytest.approx(rest)
    apart = rest + np.where(
        t < stop.t, slopes[0] * (t - stop.t), slopes[1] * np.maximum(t - start.t, 0.0)
    )
    for half in (stop, start):
        within = slice(*np.searchsorted(t, (half.start, half.stop)))
        apart[within] += half.beyond(t[within])
    assert apart == pytest.approx(whole, abs=2e-6)


def test_a_turn_may_be_a_stop_and_a_start() -> None:
    """Encoders of 50 Hz have some seven samples of it."""
    trials, truth = _there_and_back((0.002, 0.01, 0.002, 0.01), 0.03, 0.006, 1e-6, 0.02)
    servo, corners = arm_of(trials)
    assert servo is not None
    assert servo.parted
    turned = max(corners, key=lambda corner: corner.part)
    assert turned.part == pytest.approx(0.5, abs=0.01)
    # How much a half wave and the next are spread in time.
    spread = RAMP * np.sqrt(0.25 - 2.0 / np.pi**2 + 0.25)
    assert servo.at(turned).as_wait(0.5) == pytest.approx(2.0 * spread, rel=0.02)
    for trial, phases in trials:
        path = tool_path(Signal(trial.tool_height.t, TOP - trial.tool_height.value), phases, servo)
        changes = truth.pop(0)
        near = changes[2][0] + np.arange(-0.1, 0.2, 0.001)
        off = path.at(near) - (_eased(near, changes) - 0.022)
        # A change of speed that does not pass through rest is off by 13 and 60 um.
        assert np.abs(off).max() < 3e-6


def test_a_turn_may_be_a_stop_a_wait_and_a_start() -> None:
    """Encoders with 1 um of noise see a wait of 0.1 s much as a slow turn."""
    pushes = tuple(Push(2.5e-4, depth, 0.1, 2.0, 2.5e-4) for depth in (7.5e-4, 1.5e-3) * 2)
    sensors = Sensors(ForceNoise(0.3), 7e-6, force_rate=500.0, tool_rate=200.0, height_rate=20.0)
    trials = [
        (trial, segment(trial.force, trial.tool_height, trial.displacement_height))
        for trial in run(Campaign(Body(1.5e5, 3.7e5, 5.1e5), pushes, sensors), seed=2).trials
    ]
    servo, corners = arm_of(trials)
    assert servo is not None
    assert len(corners) == len(pushes)
    assert servo.wait == pytest.approx(0.1, rel=0.02)
    made, _ = prepare(trials)
    for trial, corner in zip(made, corners, strict=True):
        assert trial is not None
        middle = corner.meeting(0.0)[0] + np.linspace(-0.04, 0.04, 9)
        assert np.abs(np.diff(trial.path.at(middle)) / 0.01).max() < 1e-3 * pushes[0].speed
    # A body as viscous makes a force of 100 N of how it comes to rest.
    assert fit(trials).noise.blur.later == 1.0


def test_quick_ways_in_the_air_tell_what_slow_ones_on_the_object_do_not() -> None:
    """A turn at 0.05 mm/s is passed by 1 um, of which encoders with 2 um of noise show little."""
    trials, _ = _there_and_back((5e-5,) * 3, 0.008, 6e-4, 2e-6, 0.01)
    servo, corners = arm_of(trials)
    assert servo is not None
    assert len(corners) == 3
    shape = servo.at(corners[0])
    assert shape.part == pytest.approx(0.5, abs=0.01)
    # How much an acceleration is spread in time: half a wave, and those that arms are told by.
    spread = np.sqrt((shape.duration**2 + shape.jerk**2) / 12.0 + shape.lag**2)
    assert spread == pytest.approx(RAMP * np.sqrt(0.25 - 2.0 / np.pi**2), rel=0.05)


QUICK = Servo(1.25, 0.0, 0.0102, True, 0.02, swing=0.65)
"""A linear motor of 0.8 m/s^2, whose servo of 19 Hz has a damping ratio of 0.62."""


def _quick(speed: float, depth: float, seed: int) -> tuple[Signal, Segmentation, Signal]:
    """Return what encoders tell of a tool that goes to and fro by short ways, and how it went."""
    rest = 2.0e-3
    ways = [(depth + rest, speed), (-0.1 * depth, 0.5 * speed), (0.3 * depth, speed)]
    ways += [(-0.1 * depth, 0.5 * speed), (0.25 * depth, speed), (-1.35 * depth - rest, 0.015)]
    command, starts, stops = [np.zeros(40_000)], [], []
    for way, quickest in ways:
        ramp = round(min(quickest, np.sqrt(0.8 * abs(way))) / 0.8 / STEP)
        level = round(abs(way) / quickest / STEP)
        made = np.convolve(np.full(level, way / level), np.full(ramp, 1.0 / ramp))
        starts.append(sum(map(len, command)))
        command += [made, np.zeros(60_000)]
        stops.append(starts[-1] + len(made))
    t = STEP * np.arange(sum(map(len, command)))
    shape = QUICK.shape(speed)
    way = np.cumsum(_servo(np.concatenate(command), shape)) - rest
    random = np.random.default_rng(seed)
    at = np.arange(0.01, t[-1] - 0.01, 1.0 / 900.0)
    read = np.interp(at, t, way) + random.normal(0.0, 3e-7, at.size)
    touch = float(np.interp(0.0, way[: stops[0]], t[: stops[0]]))
    times = touch, STEP * stops[4], STEP * starts[5], STEP * stops[5]
    phases = Segmentation(*times, at[-1], TOP, 0.0, speed, 1.35 * depth, ())
    return Signal(at, 5e-7 * np.round(read / 5e-7)), phases, Signal(t, way)


def test_a_search_for_a_swing_goes_to_the_end_of_its_valley() -> None:
    """Fine encoders tell points from each other by far that are near each other."""
    turns = []
    for seed, (speed, depth) in enumerate([(0.008, 0.02), (0.015, 0.03), (0.02, 0.04)]):
        read, phases, _ = _quick(speed, depth, seed)
        turns += [turn for turn in _path(read, phases, None)[1] if abs(turn.bend.turn) > 2e-3]
    corners = [turn.corner for turn in turns]
    assert len(corners) > 12
    servo = servo_of(corners, [turn.shape for turn in turns])
    assert servo is not None
    assert servo.even
    near = [c for c in corners if not is_apart(c, c.deviance(QUICK.at(c)), servo)]
    assert len(near) > 0.8 * len(corners)
    assert told(near, servo) < told(near, QUICK) + 12.0


def test_short_moves_are_told_by_how_the_arm_makes_long_ones() -> None:
    """The tool has not come to its speed when it stops again: 0.3 mm at 20 mm/s."""
    for seed, depth in enumerate((2e-3, 3e-3, 4e-3)):
        read, phases, way = _quick(0.02, depth, seed)
        path = tool_path(read, phases, QUICK)
        on_it = (way.t > phases.t_contact) & (way.t < phases.t_release)
        off = np.abs(path.at(way.t[on_it]) - way.value[on_it])
        assert off.max() < 5e-7, depth
        assert len(path.bends) == 12


def test_a_path_that_short_moves_would_spoil_is_made_without_them(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    read, phases, _ = _quick(0.02, 3e-3, 1)
    short_move = data._short_move

    def wrong(*args: Any) -> Any:
        made = short_move(*args)
        return made and [turn._replace(level=turn.level + 1e-4) for turn in made]

    paths = []
    for other in (lambda *_: None, wrong, short_move):
        monkeypatch.setattr(data, '_short_move', other)
        paths.append(tool_path(read, phases, QUICK))
    without, spoilt, with_them = paths
    assert 0 < len(without.bends) < len(with_them.bends)
    assert [bend.t for bend in spoilt.bends] == [bend.t for bend in without.bends]
