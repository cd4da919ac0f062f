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

"""The base model against whole trials: what it recovers, and how far it misses others."""

from collections.abc import Callable
from dataclasses import replace

from hapticvision_ros.core.fit.noise import estimate_noise, Noise
from hapticvision_ros.core.fit.waveform import fit_waveform, ModelFit
from hapticvision_ros.core.records import Estimate, Segmentation, Signal, Trial
import numpy as np
import pytest

type Segmented = tuple[Trial, Segmentation]

NOISE = Noise(Estimate(0.02), Estimate(2e-5))


def _noisy(trial: Trial, seed: int) -> Trial:
    rng = np.random.default_rng(seed)
    height = trial.displacement_height
    assert height is not None
    return replace(
        trial,
        force=Signal(
            trial.force.t, trial.force.value + 0.02 * rng.standard_normal(len(trial.force))
        ),
        tool_height=Signal(
            trial.tool_height.t,
            trial.tool_height.value + 2e-6 * rng.standard_normal(len(trial.tool_height)),
        ),
        displacement_height=Signal(
            height.t, height.value + 2e-5 * rng.standard_normal(len(height))
        ),
    )


def _value(fit: ModelFit, name: str) -> float:
    value = fit.parameters[name].value
    assert value is not None, fit.parameters[name].reason
    return value


@pytest.fixture
def plain(bingham: type) -> Callable[..., Segmented]:
    """Return a maker of noisy trials on the three-element body itself."""

    def make(push_speed: float, depth: float, seed: int) -> Segmented:
        body = bingham(yield_force=0.0)
        trial, phases = body.make(push_speed=push_speed, depth=depth, hold=8.0, recovery=5.0)
        return _noisy(trial, seed), phases

    return make


def test_two_speeds_give_the_parameters_and_an_error_of_the_noise(
    plain: Callable[..., Segmented],
) -> None:
    fit = fit_waveform([plain(0.005, 0.010, 1), plain(0.02, 0.012, 2)], [], NOISE)
    for name, truth in (('K1', 2000.0), ('C1', 1600.0), ('C2', 2400.0)):
        std = fit.parameters[name].std
        assert std is not None and std < 0.01 * truth
        # The corners of the path are known to a sample of 5 ms, which is not in the errors.
        assert _value(fit, name) == pytest.approx(truth, rel=0.01)
    assert fit.train is not None and fit.train.force_chi2 is not None
    assert fit.train.height_rmse is not None
    # 2,000 samples and more; what the corners and the errors above leave is below the noise.
    assert fit.train.force_chi2 == pytest.approx(1.0, abs=0.3)
    assert fit.train.height_rmse == pytest.approx(2e-5, rel=1.0)


def test_a_trial_held_out_is_predicted_and_changes_nothing(
    plain: Callable[..., Segmented],
) -> None:
    alone = fit_waveform([plain(0.005, 0.010, 1)], [], NOISE)
    fit = fit_waveform([plain(0.005, 0.010, 1)], [plain(0.02, 0.012, 2)], NOISE)
    assert fit.parameters == alone.parameters
    assert alone.held_out is None
    assert fit.held_out is not None and fit.held_out.force_rmse is not None
    assert len(fit.held_out_predictions) == 1


@pytest.mark.parametrize('seed', range(6))
def test_heights_that_were_sent_late_do_not_shake_the_force(
    plain: Callable[..., Segmented], seed: int
) -> None:
    trial, phases = plain(0.005, 0.010, seed)
    rng = np.random.default_rng(seed)
    t = trial.tool_height.t
    sent = np.minimum(t + rng.exponential(1.5e-3, t.size), np.append(t[1:], np.inf) - 1e-4)
    late = replace(trial, tool_height=Signal(sent, trial.tool_height.value))
    fit = fit_waveform([(late, phases)], [], NOISE)
    assert fit.train is not None and fit.train.force_rmse is not None
    peak = float(np.max(trial.force.value))
    # 1.5 ms at 5 mm/s are 0.1 % of the depth; what they do to the corners is half a percent.
    assert fit.train.force_rmse < 0.01 * peak
    # Known to the lateness of its corners.
    assert _value(fit, 'K1') == pytest.approx(2000.0, rel=0.02)


def test_the_miss_of_a_body_with_a_slider_is_told_phase_by_phase(bingham: type) -> None:
    trial, phases = bingham().make(hold=20.0)
    fit = fit_waveform([(trial, phases)], [], NOISE)
    assert fit.train is not None
    assert fit.train.force_rmse is not None and fit.train.force_chi2 is not None
    prediction = fit.predictions[0]
    assert prediction is not None
    assert [miss.phase for miss in prediction.misses] == ['push', 'hold']
    residual = prediction.force.value - prediction.force_fitted
    assert fit.train.force_rmse == pytest.approx(float(np.sqrt(np.mean(residual**2))))
    assert fit.train.force_chi2 == pytest.approx((fit.train.force_rmse / 0.02) ** 2)
    # The body holds 6 N for good; the model lets it go.
    assert max(miss.share_of_peak for miss in prediction.misses) > 0.02


def test_a_spring_has_a_stiffness_and_no_flow(two_decays: Callable[..., Segmented]) -> None:
    trial, phases = two_decays(F0=0.0, F_inf=36.0, H0=0.0, H_inf=0.0, at_once=0.010, hold=20.0)
    fit = fit_waveform([(_noisy(trial, 3), phases)], [], NOISE)
    assert _value(fit, 'K1') == pytest.approx(3600.0, rel=1e-3)
    assert fit.parameters['C2'].value is None
    assert 'from below' in str(fit.parameters['C2'].reason)
    assert any(warning.startswith('C2 is unknown') for warning in fit.warnings)


def test_a_bare_dashpot_has_a_viscosity_and_no_stiffness(
    two_decays: Callable[..., Segmented],
) -> None:
    trial, phases = two_decays()
    assert phases.t_contact is not None and phases.t_hold is not None
    t = trial.force.t
    pushed = (t >= phases.t_contact) & (t < phases.t_hold)
    speed = (phases.depth or 0.0) / (phases.t_hold - phases.t_contact)
    force = phases.force_zero + np.where(pushed, 5000.0 * speed, 0.0)
    fit = fit_waveform([(replace(trial, force=Signal(t, force)), phases)], [], NOISE)
    assert _value(fit, 'C2') == pytest.approx(5000.0, rel=0.01)
    assert fit.parameters['K1'].value is None


def test_a_trial_without_contact_is_named_and_not_fitted(
    two_decays: Callable[..., Segmented],
) -> None:
    trial, phases = two_decays()
    lost = replace(phases, t_contact=None, contact_height=None)
    fit = fit_waveform([(trial, lost)], [], NOISE)
    assert fit.predictions == (None,)
    assert fit.train is None
    assert not any(estimate.known for estimate in fit.parameters.values())
    assert any(trial.name in warning for warning in fit.warnings)


def test_the_noise_of_force_and_height_is_found(two_decays: Callable[..., Segmented]) -> None:
    for correlation in (0.0, 0.5):
        trial, phases = two_decays(
            force_noise=0.05, height_noise=3e-5, correlation=correlation, force_rate=1000.0
        )
        noise = estimate_noise(trial, phases)
        assert noise.force.value is not None and noise.height.value is not None
        # From about 1,000 samples of baseline, fewer if correlated: 4 % one standard error.
        assert noise.force.value == pytest.approx(0.05, rel=0.15)
        # 100 samples of baseline, and 37 windows of the recovery: 10 %.
        assert noise.height.value == pytest.approx(3e-5, rel=0.35)


def test_a_record_without_noise_says_so(two_decays: Callable[..., Segmented]) -> None:
    trial, phases = two_decays(F0=0.0, F_inf=0.0)
    assert 'no noise' in str(estimate_noise(trial, phases).force.reason)
    missing = estimate_noise(replace(trial, displacement_height=None), phases)
    assert 'not recorded' in str(missing.height.reason)


@pytest.mark.parametrize('seed', range(3))
def test_the_curvature_of_a_slow_record_is_no_noise(
    two_decays: Callable[..., Segmented], seed: int
) -> None:
    # 16 samples at 10 Hz last twice the retardation time.
    trial, phases = two_decays(
        H0=0.002,
        H_inf=0.004,
        retardation_time=0.8,
        recovery=4.0,
        height_rate=10.0,
        height_noise=4e-5,
        seed=seed,
    )
    trial = _with_longer_baseline(trial, 4e-5, seed)
    height = estimate_noise(trial, phases).height.value
    assert height is not None
    # The larger of 50 samples of baseline and 2 windows of recovery: 0.76 to 1.45 in 200 seeds.
    assert height == pytest.approx(4e-5, rel=0.5)


def _with_longer_baseline(trial: Trial, noise: float, seed: int) -> Trial:
    """Return the trial with 4 s of displacement height at 10 Hz more before it begins."""
    height = trial.displacement_height
    assert height is not None
    t = np.arange(-4.0, -0.05, 0.1)
    before = noise * np.random.default_rng((seed, 7)).standard_normal(t.size)
    together = np.concatenate((t, height.t)), np.concatenate((before, height.value))
    return replace(trial, displacement_height=Signal(*together))


def _with_spikes(signal: Signal, at: tuple[float, ...], size: float) -> Signal:
    """Return the signal with spikes at some times."""
    value = signal.value.copy()
    value[np.searchsorted(signal.t, at)] += size
    return Signal(signal.t, value)


@pytest.mark.parametrize(
    ('at', 'told'), [((5.0,), '1 glitch of {} was'), ((5.0, 6.0), '2 glitches of {} were')]
)
def test_a_glitch_of_the_force_is_neither_fitted_nor_counted_as_a_miss(
    plain: Callable[..., Segmented], at: tuple[float, ...], told: str
) -> None:
    trial, phases = plain(0.005, 0.010, 1)
    clean = fit_waveform([(trial, phases)], [(trial, phases)], NOISE)
    spiked = replace(trial, force=_with_spikes(trial.force, at, 1e6))
    fit = fit_waveform([(spiked, phases)], [(spiked, phases)], NOISE)
    assert clean.train is not None and clean.train.force_rmse is not None
    for error in (fit.train, fit.held_out):
        # One sample less of 2,000.
        assert error is not None
        assert error.force_rmse == pytest.approx(clean.train.force_rmse, rel=0.01)
    for prediction in (*fit.predictions, *fit.held_out_predictions):
        assert prediction is not None
        assert max(miss.rmse for miss in prediction.misses) < 0.03
    expected = f'{trial.name}: {told.format("the force in contact")} set aside'
    assert fit.warnings.count(expected) == 2
    assert not any('glitch' in warning for warning in clean.warnings)


def test_a_glitch_of_the_height_is_not_counted_as_a_miss(plain: Callable[..., Segmented]) -> None:
    trial, phases = plain(0.005, 0.010, 1)
    assert trial.displacement_height is not None
    clean = fit_waveform([(trial, phases)], [], NOISE)
    spiked = replace(
        trial,
        displacement_height=_with_spikes(
            trial.displacement_height, (float(trial.displacement_height.t[-300]),), 0.1
        ),
    )
    fit = fit_waveform([(spiked, phases)], [], NOISE)
    assert clean.train is not None and clean.train.height_rmse is not None
    assert fit.train is not None
    assert fit.train.height_rmse == pytest.approx(clean.train.height_rmse, rel=0.01)
    assert f'{trial.name}: 1 glitch of the height in the recovery was set aside' in fit.warnings


def test_the_peak_between_push_and_hold_is_no_glitch(bingham: type) -> None:
    trial, phases = bingham().make(push_speed=0.01, depth=0.010, hold=8.0, recovery=1.0)
    fit = fit_waveform([(_noisy(trial, 1), phases)], [], NOISE)
    assert not any('glitch' in warning for warning in fit.warnings)
