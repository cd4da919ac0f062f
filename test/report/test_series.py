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


from dataclasses import replace

from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.core.records import Segmentation
from hapticvision_ros.core.units import STANDARD_GRAVITY
from hapticvision_ros.report.figure import Panel, Phase, Series
from hapticvision_ros.report.misses import Shown, shown
from hapticvision_ros.report.quantities import PAPER_UNITS, SI_UNITS
from hapticvision_ros.report.series import force_panel, height_panel, marks_of, phases_of
import numpy as np
import pytest

FORCE_NOISE, HEIGHT_NOISE = 0.02, 2e-5
"""Of the trials in conftest."""

PHASES = Segmentation(
    t_contact=2.0,
    t_hold=3.0,
    t_release=11.0,
    t_loss=11.5,
    t_end=20.0,
    contact_height=0.04,
    force_zero=0.3,
    push_speed=5e-3,
    depth=5e-3,
)


def of(series: tuple[Series, ...], role: str) -> Series:
    """Return the one line of a role."""
    (found,) = (one for one in series if one.role == role)
    return found


def left_by(panel: Panel, role: str) -> Series:
    """Return the residual of a role."""
    return of(tuple(one for row in panel.residuals for one in row), role)


@pytest.fixture
def force(diagnosed: CampaignAnalysis) -> Panel:
    """Return the force of the whole trial."""
    return force_panel(shown(diagnosed)[0], diagnosed.noise.force.value, SI_UNITS)


@pytest.fixture
def height(diagnosed: CampaignAnalysis) -> Panel:
    """Return the displacement height of the whole trial."""
    panel = height_panel(shown(diagnosed)[0], diagnosed.noise.height.value, SI_UNITS)
    assert panel is not None
    return panel


def test_phases_follow_each_other_to_the_end() -> None:
    assert phases_of(PHASES, 0.0) == (
        Phase(0.0, 2.0, 'approach'),
        Phase(2.0, 3.0, 'push'),
        Phase(3.0, 11.0, 'hold'),
        Phase(11.0, 11.5, 'release'),
        Phase(11.5, 20.0, 'recover'),
    )
    assert [mark.symbol for mark in marks_of(PHASES)] == ['T_c', 'T_s', 'T_e', 't_loss']


def test_a_trial_without_release_ends_in_its_hold() -> None:
    phases = replace(PHASES, t_release=None, t_loss=None)
    assert phases_of(phases, 2.0)[-1] == Phase(3.0, 20.0, 'hold')
    assert [mark.symbol for mark in marks_of(phases)] == ['T_c', 'T_s']


def test_of_a_push_in_steps_all_of_it_is_shown(diagnosed: CampaignAnalysis) -> None:
    one, noise = shown(diagnosed)[0], diagnosed.noise.force.value
    whole = one.analysis.segmentation
    first = replace(whole, t_release=None, t_loss=None, t_end=whole.t_release, whole=whole)
    stepping = replace(one, analysis=replace(one.analysis, segmentation=first))
    for panel in (force_panel, height_panel):
        again, known = (panel(each, noise, SI_UNITS) for each in (stepping, one))
        assert (again.phases, again.marks) == (known.phases, known.marks)


def test_the_measured_force_is_free_of_the_load_cells_zero(force: Panel) -> None:
    measured = of(force.lines, 'measured')
    # 2000 samples of 0.02 N before contact: their mean is known to 0.5 mN.
    assert abs(measured.value[measured.t < 1.9].mean()) < 5e-3
    assert force.unit == 'N' and force.quantity == 'Force'


@pytest.mark.parametrize('role', ['paper', 'base', 'after'])
def test_a_residual_is_measured_minus_fitted(force: Panel, height: Panel, role: str) -> None:
    for panel in (force, height):
        measured, fitted = of(panel.lines, 'measured'), of(panel.lines, role)
        at_fit = np.searchsorted(measured.t, fitted.t - 1e-6)
        # A step of the fit is around its sample.
        np.testing.assert_allclose(measured.t[at_fit], fitted.t, atol=1e-6)
        np.testing.assert_allclose(
            left_by(panel, role).value,
            measured.value[at_fit] - fitted.value,
            atol=1e-9,
        )


def test_the_papers_decays_leave_only_noise_where_they_were_fitted(
    diagnosed: CampaignAnalysis, force: Panel, height: Panel
) -> None:
    # The body decays as eqs. (4) and (10) do: a wrong sign, origin or series would leave newtons.
    hold, recovery = left_by(force, 'paper'), left_by(height, 'paper')
    assert hold.t[0] > 2.9 and hold.t[-1] < 11.1 and recovery.t[0] > 10.9
    assert hold.value.std() < 1.2 * FORCE_NOISE
    assert recovery.value.std() < 1.2e3 * HEIGHT_NOISE


def test_the_models_are_shown_over_the_whole_trial_each_in_a_row_of_its_own(
    force: Panel, height: Panel
) -> None:
    for panel in (force, height):
        assert [[one.role for one in row] for row in panel.residuals] == [
            ['base', 'paper'],
            ['after'],
        ]
        for role in ('base', 'after'):
            line = of(panel.lines, role)
            assert line.t[0] < 0.1 and line.t[-1] > 18.0


def test_the_tool_is_shown_while_it_touches(height: Panel) -> None:
    tool = of(height.lines, 'tool')
    assert tool.t[0] >= 1.9 and tool.t[-1] < 11.1
    # 5 mm deep, as commanded.
    assert tool.value.max() == pytest.approx(5.0, abs=0.01)


def test_the_noise_band_has_the_unit_of_its_panel(
    diagnosed: CampaignAnalysis, force: Panel, height: Panel
) -> None:
    assert force.noise == diagnosed.noise.force.value
    in_metres = diagnosed.noise.height.value
    assert in_metres is not None and height.noise == pytest.approx(1e3 * in_metres)


def test_forces_read_in_kgf_on_request(diagnosed: CampaignAnalysis, force: Panel) -> None:
    panel = force_panel(shown(diagnosed)[0], None, PAPER_UNITS)
    assert panel.unit == 'kgf'
    for si, kgf in zip(
        force.lines + sum(force.residuals, ()), panel.lines + sum(panel.residuals, ()), strict=True
    ):
        np.testing.assert_allclose(kgf.value * STANDARD_GRAVITY, si.value, atol=1e-12)


def test_without_a_displacement_height_the_tool_is_all_there_is(
    campaign: CampaignAnalysis,
) -> None:
    panel = height_panel(shown(campaign)[1], None, SI_UNITS)
    assert panel is not None
    assert panel.quantity == 'Tool displacement' and not panel.residuals
    assert [series.role for series in panel.lines] == ['tool']


def test_nothing_is_shown_where_nothing_is_known(campaign: CampaignAnalysis) -> None:
    blind = campaign.trials[1]
    lost = Shown(
        replace(blind, segmentation=replace(blind.segmentation, contact_height=None)),
        held_out=False,
        before=None,
        after=None,
    )
    assert height_panel(lost, None, SI_UNITS) is None
    rows = force_panel(lost, None, SI_UNITS).residuals
    assert [[series.role for series in row] for row in rows] == [['paper']]
