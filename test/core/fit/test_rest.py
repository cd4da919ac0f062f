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

"""Where a tool is held, which encoders that round leave open, and the force tells."""

from dataclasses import replace

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.campaign import Fit, fit_prepared
from hapticvision_ros.core.fit.data import FitTrial, prepare, Rest, ToolPath
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body
import numpy as np
import pytest

DEPTHS = (0.004, 0.00403, 0.004061, 0.00409)
SPEEDS = (0.0011, 0.0016, 0.0025, 0.0045)
SHIFT = 2.5e-6
NEAR = 1e-7


def _prepared(step: float) -> list[FitTrial]:
    """Return four pushes, slowly withdrawn, through encoders that round."""
    pushes = tuple(Push(*each, 8.0, 3.0, 0.002) for each in zip(SPEEDS, DEPTHS, strict=True))
    sensors = Sensors(ForceNoise(0.005), 1e-5, encoder_noise=0.0, encoder_resolution=step)
    trials = run(Campaign(Body(1000.0, 900.0, 1600.0), pushes, sensors), seed=3).trials
    pairs = [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
    made = [trial for trial in prepare(pairs)[0] if trial is not None]
    assert len(made) == len(pushes)
    return made


@pytest.fixture(scope='module')
def coarse() -> list[FitTrial]:
    """Return them through steps of 10 um."""
    return _prepared(1e-5)


def _rests(fit: Fit) -> list[float]:
    values = [trial.values['rest'].value for trial in fit.trials if trial is not None]
    assert all(value is not None for value in values)
    return [float(value or 0.0) for value in values]


def _misread(trial: FitTrial, shift: float) -> FitTrial:
    """Return a trial whose tool is taken to rest deeper."""
    path = trial.path
    assert path.rest is not None
    stop = int(np.argmin(np.abs(path.t - path.rest.t)))
    slopes = np.diff(path.displacement) / np.diff(path.t)
    t, displacement, bends = path.t.copy(), path.displacement.copy(), path.bends
    displacement[[stop, stop + 1]] += shift
    for knot, slope in ((stop, slopes[stop - 1]), (stop + 1, slopes[stop + 1])):
        t[knot] += shift / slope
        bends = tuple(replace(b, t=t[knot]) if b.t == path.t[knot] else b for b in bends)
    rest = path.rest._replace(t=t[stop])
    path = replace(path, t=t, displacement=displacement, bends=bends, rest=rest)
    return replace(trial, path=path, displacement=path.at(trial.t))


def test_a_tool_that_is_held_elsewhere_goes_on_as_the_encoders_tell(
    coarse: list[FitTrial],
) -> None:
    for trial in coarse:
        assert trial.rest_std == pytest.approx(1e-5 / np.sqrt(12.0), rel=0.01)
        assert trial.held(0.0) is trial
        kept = trial.touch_head
        for shift in (SHIFT, -2.0 * trial.rest_std):
            moved = trial.held(shift)
            beside = (moved.displacement - trial.displacement) / shift
            held = (trial.t > trial.t_stop + 0.5) & (trial.t < trial.t_release - 0.1)
            assert held.any()
            assert beside[held] == pytest.approx(1.0, abs=1e-3)
            moves = (trial.t < trial.t_stop - 0.5) | (trial.t > trial.t_release + 0.7)
            assert beside[moves] == pytest.approx(0.0, abs=1e-6)
            assert moved.turns is not None and trial.turns is not None
            change = moved.turns.displacement - trial.turns.displacement
            assert np.ptp(change) == pytest.approx(abs(shift), rel=1e-3)
            # It stops sooner or later, and does not come back from where it went too far.
            pressed = (trial.t > trial.t_contact) & (trial.t < trial.t_release - 0.1)
            assert np.diff(moved.displacement[pressed]).min() > -1e-8
            # What is kept of the one is not taken for the other's.
            head = moved.touch_head
            assert head is not kept
            steps = slice(moved.near_touch.stop + 1)
            assert np.array_equal(head.displacement[:-1], moved.displacement[steps])


def test_a_tool_that_creeps_while_it_is_held_is_held_until_it_goes_on() -> None:
    for creeps in (0.0, 1e-8, -1e-8):
        path = ToolPath(
            np.array([0.0, 1.0, 5.0, 9.0, 13.0, 16.0]),
            np.array([-0.001, 0.0, 0.004, 0.004, 0.004 + 4.0 * creeps, -0.002]),
            3e-6,
            rest=Rest(5.0, 3e-6),
        )
        t = np.linspace(0.0, 16.0, 1601)
        beside = (path.held(t, SHIFT) - path.at(t)) / SHIFT
        assert beside[(t > 5.01) & (t < 12.99)] == pytest.approx(1.0, abs=0.02)
        assert beside[(t < 4.99) | (t > 13.01)] == pytest.approx(0.0, abs=1e-6)
    kept = replace(path, t=path.t[:-1], displacement=path.displacement[:-1])
    beside = (kept.held(t, SHIFT) - kept.at(t)) / SHIFT
    assert beside[t > 5.01] == pytest.approx(1.0, abs=0.02)


def test_the_force_tells_where_the_tool_is_held(coarse: list[FitTrial]) -> None:
    """As far as the encoders leave it open: a fit to other readings of the rest finds the same."""
    known = fit_prepared(coarse, Model())
    other = [_misread(trial, -SHIFT) for trial in coarse[:2]] + coarse[2:]
    found = fit_prepared(other, Model())
    away = np.subtract(_rests(found), _rests(known))
    # Within two of their standard errors, and one.
    assert away[:2] == pytest.approx(SHIFT, abs=1.1e-6)
    assert away[2:] == pytest.approx(0.0, abs=0.8e-6)
    for name in ('K1', 'C1', 'C2'):
        value, before = found.parameters[name].value, known.parameters[name].value
        std = found.parameters[name].std
        assert std is not None
        assert std < 5e-4 * before
        assert value == pytest.approx(before, abs=std)


def test_the_slope_of_what_a_rest_does_is_that_of_the_prediction(coarse: list[FitTrial]) -> None:
    fit = fit_prepared(coarse, Model())
    problem = fit.problem
    place = problem.places[1].start + problem.own_names(problem.trials[1]).index('rest')
    force, height = problem.records(fit.state, 1)
    row = problem.p + place - problem.places[1].start
    ends = []
    for change in (NEAR, -NEAR):
        state = fit.state.copy()
        state[place] += change
        ends.append(problem.records(state, 1))
    # Where it leaves the object, which comes the sooner or the later, it is no straight line.
    early = problem.trials[1].middle < problem.trials[1].t_release - 0.02
    for k, (slope, told) in enumerate(((force[row], early), (height[row], ...))):
        wide = (ends[0][k][-1] - ends[1][k][-1]) / (2.0 * NEAR)
        assert np.abs(slope[told]).max() > 0.5
        assert slope[told] == pytest.approx(wide[told], abs=0.03 * np.abs(wide[told]).max())


def test_encoders_that_tell_it_well_enough_leave_nothing_open() -> None:
    made = _prepared(1e-6)
    assert all(trial.rest_std == 0.0 for trial in made)
    fit = fit_prepared(made, Model())
    assert not any('rest' in trial.values for trial in fit.trials if trial is not None)
