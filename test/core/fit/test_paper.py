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

"""The paper's method: its own numbers, closed forms, honest errors, and what it cannot tell."""

from collections.abc import Callable
from dataclasses import replace
import math
from typing import Any

from hapticvision_ros.core.fit.paper import fit_paper, PaperResult, parameters_from_decays
from hapticvision_ros.core.records import Estimate, Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.core.units import KGF_PER_MM, STANDARD_GRAVITY
import numpy as np
import pytest

type Maker = Callable[..., tuple[Trial, Segmentation]]

GF = 1e-3 * STANDARD_GRAVITY
# Tables 2 and 3 of the paper: tau [s], F_inf [1e2 gf], gamma [s], H0 [mm], then C1, C2
# [kgf.s/mm] and K1 [kgf/mm] as printed.
DOUGH = (
    (38.3, 5.01, 16.8, 0.98, '8.59', '11.0', '0.511'),
    (62.7, 11.4, 17.2, 2.01, '9.73', '26.0', '0.565'),
    (37.4, 6.42, 17.6, 1.27, '8.95', '10.0', '0.507'),
    (36.9, 8.26, 21.4, 0.63, '27.9', '20.3', '1.30'),
)


def _number(estimate: Estimate) -> float:
    assert estimate.value is not None, estimate.reason
    return estimate.value


def _std(estimate: Estimate) -> float:
    assert estimate.std is not None
    return estimate.std


def _relative_rounding(printed: float, digits: int = 3) -> float:
    """Return half a unit of the last of three printed digits, relative."""
    return 0.5 * 10.0 ** (math.floor(math.log10(printed)) - digits + 1) / printed


@pytest.mark.parametrize('row', DOUGH, ids=('SP0-10', 'SP0-15', 'SP2-10', 'SP2-15'))
def test_table_3_follows_from_table_2(
    row: tuple[float, float, float, float, str, str, str],
) -> None:
    tau, F_inf, gamma, H0, *printed = row
    K1, C1, C2 = parameters_from_decays(tau, 100.0 * F_inf * GF, gamma, H0 * 1e-3)
    # Table 2 itself is rounded to three digits (H0 of 0.98 and 0.63 to two): its rounding moves
    # K1 by so much, and each C by that and the time constants'.
    inputs = _relative_rounding(F_inf) + 0.005 / H0
    difference = (_relative_rounding(tau) * tau + _relative_rounding(gamma) * gamma) / (
        tau - gamma
    )
    allowed = (inputs + _relative_rounding(gamma), inputs + difference, inputs)
    for value, text, tolerance in zip((C1, C2, K1), printed, allowed, strict=True):
        published = float(text)
        assert value / KGF_PER_MM == pytest.approx(
            published, rel=tolerance + _relative_rounding(published)
        )


def test_the_printed_eq_13_with_H_inf_does_not_give_table_3() -> None:
    K1, _, _ = parameters_from_decays(38.3, 501.0 * GF, 16.8, 7.44e-3)
    assert K1 / KGF_PER_MM < 0.2


def test_the_papers_trial_of_figures_10_and_11_gives_its_row_of_table_3(two_decays: Maker) -> None:
    # 10 mm deep: 0.98 mm recover by eq. (10), 7.44 mm stay, 1.58 mm came back at once.
    result = fit_paper(
        *two_decays(
            F0=926.0 * GF,
            F_inf=501.0 * GF,
            relaxation_time=38.3,
            H0=0.98e-3,
            H_inf=7.44e-3,
            retardation_time=16.8,
            at_once=1.58e-3,
            hold=150.0,
            recovery=70.0,
        )
    )
    # Noise-free closed forms: what is left is rounding of the arithmetic.
    assert _number(result.relaxation_time) == pytest.approx(38.3, rel=1e-6)
    assert _number(result.F0) == pytest.approx(926.0 * GF, rel=1e-6)
    assert _number(result.F_inf) == pytest.approx(501.0 * GF, rel=1e-6)
    assert _number(result.retardation_time) == pytest.approx(16.8, rel=1e-6)
    assert _number(result.H0) == pytest.approx(0.98e-3, rel=1e-6)
    assert _number(result.H_inf) == pytest.approx(7.44e-3, rel=1e-6)
    assert _number(result.K1) / KGF_PER_MM == pytest.approx(0.511, abs=0.0005)
    assert _number(result.C1) / KGF_PER_MM == pytest.approx(8.59, abs=0.005)
    assert _number(result.C2) / KGF_PER_MM == pytest.approx(11.0, abs=0.05)
    assert any('1.58 mm came back at once' in warning for warning in result.warnings)


def test_a_body_with_a_slider_gives_its_own_parameters_when_the_hold_has_converged(
    bingham: type,
) -> None:
    body = bingham()
    result = fit_paper(*body.make(hold=40.0))
    # The hold lasts 20 relaxation times, so that only the integrator's error is left.
    assert _number(result.K1) == pytest.approx(body.K1, rel=1e-5)
    assert _number(result.C1) == pytest.approx(body.C1, rel=1e-5)
    assert _number(result.C2) == pytest.approx(body.C2, rel=1e-5)
    assert _number(result.F_inf) == pytest.approx(body.yield_force, rel=1e-5)
    assert not result.warnings


def test_a_hold_that_has_not_converged_is_told_with_the_size_of_its_bias(bingham: type) -> None:
    body = bingham()
    result = fit_paper(*body.make(hold=4.0))
    bias = 1.0 - _number(result.K1) / body.K1
    (warning,) = result.warnings
    told = float(warning.split('about ')[1].split(' %')[0])
    # The warning prints two digits.
    assert 100.0 * bias == pytest.approx(told, abs=0.6)
    assert told > 10.0


def test_the_object_that_keeps_pace_with_the_tool_has_H0_from_the_release_on(
    bingham: type,
) -> None:
    body = bingham()
    # z relaxes at z / 0.8 s = 3.75 mm/s at first: the tool at 1 mm/s stays on it for 2.2 mm.
    trial, phases = body.make(hold=40.0, withdrawal=0.001)
    assert phases.t_loss is not None and phases.t_release is not None
    assert phases.t_loss - phases.t_release > 1.0
    result = fit_paper(trial, phases)
    # H(T_e) - H_inf is exact however long the contact lasted: no flow below F_y.
    assert _number(result.H0) == pytest.approx(body.yield_force / body.K1, rel=1e-4)
    assert _number(result.K1) == pytest.approx(body.K1, rel=1e-4)
    assert _number(result.retardation_time) == pytest.approx(body.C1 / body.K1, rel=1e-4)


def _zscores(results: list[PaperResult], truth: dict[str, float]) -> dict[str, np.ndarray]:
    return {
        name: np.array(
            [(_number(getattr(r, name)) - value) / _std(getattr(r, name)) for r in results]
        )
        for name, value in truth.items()
    }


@pytest.mark.parametrize('correlation', [0.0, 0.9])
def test_standard_errors_cover_the_truth_in_white_and_in_correlated_noise(
    two_decays: Maker, correlation: float
) -> None:
    # With noise correlated over ten samples an error that took it for white would be four
    # times too small.
    count = 120
    results = [
        fit_paper(
            *two_decays(
                force_noise=0.05,
                height_noise=2e-5,
                correlation=correlation,
                seed=seed,
                force_rate=50.0,
                height_rate=50.0,
            )
        )
        for seed in range(count)
    ]
    K1, C1, C2 = parameters_from_decays(2.0, 5.0, 0.9, 0.001)
    truth = {
        'relaxation_time': 2.0,
        'F0': 8.0,
        'F_inf': 5.0,
        'retardation_time': 0.9,
        'H0': 0.001,
        'H_inf': 0.007,
        'K1': K1,
        'C1': C1,
        'C2': C2,
    }
    for name, z in _zscores(results, truth).items():
        # The spread of 120 scores is known to 6.5 %: four of those above 1. Below, the correction
        # is conservative: 0.85 to 0.98 in runs of 1,500.
        assert 0.65 < np.std(z) < 1.26, name
        # 95 % +- 2 %, four of those.
        assert np.mean(np.abs(z) < 2.0) > 0.87, name
        assert abs(np.mean(z)) < 4.0 / np.sqrt(z.size), name


def test_a_spring_has_no_relaxation_and_its_stiffness_from_the_held_force(
    two_decays: Maker,
) -> None:
    trial, phases = two_decays(
        F0=0.0,
        F_inf=36.0,
        H0=0.0,
        H_inf=0.0,
        at_once=0.010,
        force_noise=0.02,
        height_noise=1e-4,
    )
    result = fit_paper(trial, phases)
    assert _number(result.K1) == pytest.approx(3600.0, abs=4.0 * _std(result.K1))
    assert _std(result.K1) < 0.01 * 3600.0
    for unknown in (result.relaxation_time, result.retardation_time, result.C1, result.C2):
        assert unknown.value is None
        assert unknown.reason
    assert 'no relaxation' in str(result.relaxation_time.reason)


def test_a_slow_drift_of_a_spring_is_not_called_a_relaxation_nor_denied(
    two_decays: Maker,
) -> None:
    trial, phases = two_decays(F0=0.0, F_inf=36.0, force_noise=2.0, correlation=0.99)
    reason = str(fit_paper(trial, phases).relaxation_time.reason)
    assert 'no relaxation is told' in reason
    change, error = (float(word) for word in reason.split('by ')[1].split(' N')[0].split(' ± '))
    assert abs(change) < 5.0 * error
    assert 'fall' not in reason and 'does not relax' not in reason


@pytest.mark.parametrize('push_speed', [0.004, 0.008])
@pytest.mark.parametrize('seed', range(4))
def test_the_relaxation_time_holds_nothing_of_the_tools_own_motion(
    live: Callable[..., Any], push_speed: float, seed: int
) -> None:
    force, height = live(push_speed=push_speed, seed=seed).make()
    trial = Trial('live', 0, force, height, None)
    result = fit_paper(trial, segment(force, height))
    # The force falls by 4 and 8 N while the tool stops, and by 6 N as it starts back. In the
    # slower trials 0.8 N of 7 N relax, in noise of 0.02 N: tau is told to about 1.5 %.
    assert _number(result.relaxation_time) == pytest.approx(2.0, rel=0.05)
    assert not any('does not describe' in warning for warning in result.warnings)


@pytest.mark.parametrize('second', [0.0, 0.5], ids=['one exponential', 'two'])
def test_a_hold_of_two_exponentials_is_told_with_the_size_of_the_misfit(
    two_decays: Maker, second: float
) -> None:
    trial, phases = two_decays(force_noise=0.01, height_noise=1e-5)
    assert phases.t_hold is not None and phases.t_release is not None
    t = trial.force.t
    held = (t >= phases.t_hold) & (t < phases.t_release)
    extra = np.where(held, second * np.exp(-(t - phases.t_hold) / 0.3), 0.0)
    result = fit_paper(
        replace(trial, force=Signal(t, trial.force.value + extra)),
        phases,
    )
    said = [text for text in result.warnings if 'one exponential does not describe' in text]
    assert len(said) == (1 if second else 0)
    if second:
        assert result.hold_fit is not None
        assert 'the hold' in said[0]
        missed = float(said[0].split('misses by ')[1].split(' N')[0])
        # Two digits are printed.
        assert missed == pytest.approx(result.hold_fit.noise, rel=0.05)
        assert missed > 0.02


def test_a_recovery_of_two_exponentials_is_told(two_decays: Maker) -> None:
    trial, phases = two_decays(height_noise=5e-6)
    height, lost = trial.displacement_height, phases.t_loss
    assert height is not None and lost is not None
    extra = np.where(height.t >= lost, 5e-4 * np.exp(-(height.t - lost) / 0.2), 0.0)
    result = fit_paper(
        replace(trial, displacement_height=Signal(height.t, height.value + extra)), phases
    )
    assert any('describe the recovery' in text for text in result.warnings)


def test_a_coarse_load_cell_is_no_misfit(two_decays: Maker) -> None:
    # A step of 0.05 N far above the noise: the residual is that of rounding.
    trial, phases = two_decays(force_noise=1e-3)
    rounded = np.round(trial.force.value / 0.05) * 0.05
    result = fit_paper(replace(trial, force=Signal(trial.force.t, rounded)), phases)
    assert not result.warnings


def test_a_hold_far_shorter_than_its_decay_tells_no_limit(two_decays: Maker) -> None:
    result = fit_paper(*two_decays(relaxation_time=60.0, hold=6.0, force_noise=0.05))
    for unknown in (result.relaxation_time, result.F0, result.F_inf, result.K1, result.C2):
        assert unknown.value is None
    assert 'too short' in str(result.relaxation_time.reason)
    assert result.retardation_time.known


def test_a_hold_shorter_than_its_relaxation_time_is_given_with_caution(two_decays: Maker) -> None:
    result = fit_paper(*two_decays(relaxation_time=16.0, hold=12.0, force_noise=0.001))
    assert _number(result.relaxation_time) == pytest.approx(
        16.0, abs=4.0 * _std(result.relaxation_time)
    )
    assert 'extrapolated' in str(result.relaxation_time.reason)


def test_without_a_release_only_the_hold_is_told(two_decays: Maker) -> None:
    trial, phases = two_decays(force_noise=0.01)
    assert phases.t_release is not None
    held = replace(
        trial, force=trial.force.between(0.0, phases.t_release), displacement_height=None
    )
    result = fit_paper(held, replace(phases, t_release=None, t_loss=None, t_end=phases.t_release))
    assert _number(result.relaxation_time) == pytest.approx(2.0, rel=0.02)
    assert result.F0.known and result.F_inf.known
    for unknown in (result.retardation_time, result.H0, result.H_inf, result.K1, result.C1):
        assert 'no release' in str(unknown.reason)


def test_without_a_displacement_height_only_the_hold_is_told(two_decays: Maker) -> None:
    trial, phases = two_decays(force_noise=0.01)
    result = fit_paper(replace(trial, displacement_height=None), phases)
    assert result.F_inf.known
    assert 'was not recorded' in str(result.K1.reason)


def test_without_contact_nothing_is_told(two_decays: Maker) -> None:
    trial, phases = two_decays()
    nothing = replace(
        phases, t_contact=None, t_hold=None, t_release=None, t_loss=None, contact_height=None
    )
    result = fit_paper(trial, nothing)
    assert not any(getattr(result, name).known for name in ('relaxation_time', 'F_inf', 'K1'))


def test_a_force_that_relaxes_to_nothing_gives_no_stiffness(bingham: type) -> None:
    # The bare three-element model, eq. (8): K1 by eq. (13) would be noise over H0.
    trial, phases = bingham(yield_force=0.0).make(hold=12.0)
    noise = np.random.default_rng(1).standard_normal(len(trial.force))
    noisy = replace(trial, force=Signal(trial.force.t, trial.force.value + 0.01 * noise))
    result = fit_paper(noisy, phases)
    assert _number(result.relaxation_time) == pytest.approx(2.0, rel=0.01)
    assert result.K1.value is None
    assert 'nothing within its error' in str(result.K1.reason)


def test_what_is_unknown_is_not_said_to_be_too_low(bingham: type) -> None:
    """A hold that ends early, above a limit that is nothing within its error."""
    trial, phases = bingham(yield_force=0.0).make(hold=6.0)
    for seed in range(8):
        noise = np.random.default_rng(seed).standard_normal(len(trial.force))
        noisy = replace(trial, force=Signal(trial.force.t, trial.force.value + 0.05 * noise))
        result = fit_paper(noisy, phases)
        assert result.K1.value is None
        assert not any('too low' in warning for warning in result.warnings)


def test_a_retardation_longer_than_the_relaxation_gives_no_C2(two_decays: Maker) -> None:
    result = fit_paper(
        *two_decays(retardation_time=3.0, recovery=15.0, force_noise=0.01, height_noise=1e-6)
    )
    assert result.K1.known and result.C1.known
    assert 'rule out' in str(result.C2.reason)


def test_a_force_that_rises_in_the_hold_is_no_relaxation(two_decays: Maker) -> None:
    result = fit_paper(*two_decays(F0=-2.0, force_noise=0.01))
    assert 'rises' in str(result.relaxation_time.reason)


def test_glitches_are_set_aside_and_counted(two_decays: Maker) -> None:
    trial, phases = two_decays(force_noise=0.01, height_noise=1e-5)
    clean = fit_paper(trial, phases)
    assert phases.t_hold is not None
    force = trial.force.value.copy()
    first = int(np.searchsorted(trial.force.t, phases.t_hold)) + 200
    force[first] = 80.0
    burst = slice(first + 900, first + 930)
    force[burst] = 0.0
    spoiled = fit_paper(replace(trial, force=Signal(trial.force.t, force)), phases)
    (warning,) = spoiled.warnings
    # The burst is 30 samples; the blocks that it lies in are up to 16 longer on either side.
    assert 31 <= int(warning.split()[0]) <= 31 + 3 * 16
    assert f'{trial.force.t[first]:.3f} s' in warning
    for name in ('relaxation_time', 'F0', 'F_inf', 'K1', 'C2'):
        kept, fresh = getattr(clean, name), getattr(spoiled, name)
        assert _number(fresh) == pytest.approx(_number(kept), abs=_std(kept)), name


def test_only_a_tool_that_left_the_object_tells_no_recovery(two_decays: Maker) -> None:
    trial, phases = two_decays(force_noise=0.01)
    tool = Signal(trial.tool_height.t, 0.04 - trial.tool_height.value)
    result = fit_paper(
        replace(trial, displacement_height=tool, displacement_source='tool'), phases
    )
    assert 'it left the object' in str(result.retardation_time.reason)
    assert result.relaxation_time.known


def test_a_tool_kept_on_the_recovering_object_tells_its_recovery_with_a_caution(
    two_decays: Maker,
) -> None:
    trial, phases = two_decays(force_noise=0.005, height_noise=1e-6)
    assert phases.t_release is not None
    force = trial.force.value.copy()
    force[trial.force.t >= phases.t_release] += 0.4
    dense = two_decays(height_noise=1e-6, height_rate=200.0)[0].displacement_height
    assert dense is not None
    result = fit_paper(
        replace(
            trial,
            force=Signal(trial.force.t, force),
            displacement_height=dense,
            displacement_source='tool',
        ),
        replace(phases, t_loss=None),
    )
    assert _number(result.retardation_time) == pytest.approx(0.9, rel=0.02)
    assert any('0.4 N' in warning for warning in result.warnings)
