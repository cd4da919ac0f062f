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


"""
The whole simulated chain: cell, clouds, load cell, bag, reader, segmentation and the paper's fit.

The simulated objects share no code with the fitter, and the bags hold no displacement height: it
comes from the clouds, with noise and occlusion.
"""

from dataclasses import replace
from math import hypot, sqrt
from pathlib import Path

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.fit.paper import PaperResult
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.offline import CloudPlan, record_trial, TrialPlan
import pytest


@pytest.mark.parametrize('name', ['spring1', 'spring2', 'spring3'])
def test_springs_of_the_papers_table_1_are_measured_within_one_percent(
    name: str, config: WorldConfig, tmp_path: Path
) -> None:
    spring = config.material(name)
    plan = TrialPlan(push_speed=0.005, depth=0.010, hold_time=2.0, recover_time=4.0)
    record_trial(tmp_path / 'trial', config, spring, plan, seed=1, clouds=CloudPlan())
    trial = read_trial(tmp_path / 'trial')
    assert trial.displacement_source == 'points'
    result = analyse(trial).paper
    assert result.K1.value is not None
    # The paper has 4.26, 4.12 and 3.97 %. Over eight seeds the error was 0.16 % (one standard
    # deviation), most of it from the height of the surface in the clouds after the release.
    assert result.K1.value == pytest.approx(spring.elastic_stiffness, rel=0.01)
    assert not result.C1.known, 'a spring has no viscosity to tell'
    assert not result.C2.known


def zero_error(config: WorldConfig, rest: float) -> float:
    """Return the standard error [N] of the load cell's zero, averaged over `rest` [s]."""
    cell = config.load_cell
    return hypot(
        cell.white_noise / sqrt(cell.rate * rest),
        cell.slow_noise * sqrt(2.0 * cell.slow_noise_time / rest),
    )


def check_against_truth(
    result: PaperResult, truth: Material, largest_error: float, force_error: float
) -> None:
    """
    Each estimate lies within three of its standard errors, which are small themselves.

    The standard error of F_inf is that of the fit to the hold; the load cell's zero, which is
    subtracted before, adds `force_error` [N].
    """
    expected = {
        'relaxation_time': truth.relaxation_time,
        'F_inf': truth.yield_force,
        'retardation_time': truth.retardation_time,
        'H0': truth.yield_force / truth.elastic_stiffness,
        'K1': truth.elastic_stiffness,
        'C1': truth.retardation_viscosity,
        'C2': truth.flow_viscosity,
    }
    for name, value in expected.items():
        estimate = getattr(result, name)
        assert estimate.known, f'{name}: {estimate.reason}'
        assert estimate.std < largest_error * value, name
        error = hypot(estimate.std, force_error) if name == 'F_inf' else estimate.std
        assert abs(estimate.value - value) < 3.0 * error, name


def test_soft_dough_is_measured_through_the_clouds(config: WorldConfig, tmp_path: Path) -> None:
    dough = config.material('soft_dough')
    # Eight relaxation times: in a shorter hold K1 and C1 have not come to rest against the
    # slider, and eq. (13) is biased by the rest.
    plan = TrialPlan(push_speed=0.005, depth=0.008, hold_time=16.0, recover_time=5.0)
    record_trial(tmp_path / 'trial', config, dough, plan, seed=5, clouds=CloudPlan())
    trial = read_trial(tmp_path / 'trial')
    assert trial.displacement_source == 'points'
    check_against_truth(analyse(trial).paper, dough, 0.03, zero_error(config, 1.0))


def test_dough_with_the_papers_time_constants_is_measured(
    config: WorldConfig, tmp_path: Path
) -> None:
    dough = config.material('dough')
    slow = replace(
        config,
        time_step=1e-3,
        load_cell=replace(config.load_cell, rate=100.0),
        arm=replace(config.arm, state_rate=100.0),
    )
    plan = TrialPlan(push_speed=0.0002, depth=0.008, hold_time=304.0, recover_time=68.0)
    record_trial(tmp_path / 'trial', slow, dough, plan, seed=7, displacement_noise=5e-5)
    result = analyse(read_trial(tmp_path / 'trial')).paper
    check_against_truth(result, dough, 0.03, zero_error(slow, 1.0))
