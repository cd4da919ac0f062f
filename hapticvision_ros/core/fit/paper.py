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
The paper's method: K1, C1 and C2 from two decays.

Step 1 fits ``F = F0 exp(-t / relaxation_time) + F_inf`` (eq. 4) to the hold, t from T_s; step 2
fits ``H = H0 exp(-t / retardation_time) + H_inf`` (eq. 10) to the free recovery, t from T_e.
Then ``K1 = F_inf / H0`` (eq. 13, with the bouncing deformation H0: the printed H_inf is a
misprint, as the paper's Tables 2 and 3 show), ``C1 = retardation_time K1`` (eq. 12) and
``C2 = relaxation_time K1 - C1`` (eq. 9).

Which H0
--------
H is fitted once the object is free, from the loss of contact on. Between T_e and then the tool
withdraws at some speed v. A three-element body follows the tool for as long as it recovers
faster than that by itself, so that its free recovery begins at the rate v: with the amplitude
``retardation_time v``. Hence three cases:

- The free recovery begins at about v: the body has kept pace with the tool, and H0 is what the
  paper defines it to be, H(T_e) - H_inf.
- It begins slower: the tool left the body at once, or the body gave way by something that the
  model does not have (a series spring). H0 is the amplitude of eq. (10) at T_e, as in the paper's
  Fig. 11, where 0.98 mm were fitted and 1.6 mm more had come back at once.
- Nothing is left of the recovery when the body is free (a spring): H0 = H(T_e) - H_inf, and the
  retardation time is too short to be told.

H(T_e) comes from the tool while it touches, because it hides the dent from the range sensor.

"""

from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.fit.exponential import (
    ExponentialFit,
    fit_exponential,
    MIN_SAMPLES,
)
from hapticvision_ros.core.fit.noise import estimate_noise
from hapticvision_ros.core.fit.release import (
    pressed_in,
    sampling_interval,
    start_of_recovery,
    withdrawal_speed,
)
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np

SIGNIFICANT: Final = 5.0
"""A decay smaller than this many standard errors has not been seen."""

NEGLIGIBLE: Final = 0.01
"""A decay smaller than this share of what decays is none for eqs. (4) and (13)."""

LONGEST_EXTRAPOLATION: Final = 3.0
"""A time constant longer than this many records is not told by them."""

UNCONVERGED: Final = 0.02
"""A bouncing part that is longer at T_e than eq. (13) takes it to be, by more than this share."""

MISSED: Final = 2.0
"""A fit with a residual of more than this many times the noise does not describe the record."""

IRRELEVANT: Final = 1e-3
"""A misfit smaller than this share of the decay is none, however quiet the sensor."""

ROUNDING: Final = 1e-12
"""Steps below this share of the signal are arithmetic."""

WORST_RELATIVE_ERROR: Final = 0.5
"""A time constant with a larger relative standard error is not told by the record."""


@dataclass(frozen=True, slots=True)
class PaperResult:
    """
    What the paper's method gets from one trial.

    Parameters
    ----------
    relaxation_time : Estimate
        tau of eqs. (4) and (9) [s].
    F0, F_inf : Estimate
        Decaying part of the hold force at T_s and its limit, eq. (4) [N].
    retardation_time : Estimate
        gamma of eqs. (10) and (12) [s].
    H0, H_inf : Estimate
        Bouncing and residual deformation, eq. (10) [m].
    K1 : Estimate
        [N/m].
    C1, C2 : Estimate
        [N.s/m].
    hold_fit : ExponentialFit or None
        The curve of eq. (4), force without the load cell's zero [N].
    recovery_fit : ExponentialFit or None
        The curve of eq. (10) [m].
    warnings : tuple of str
        What was set aside or looks unlike the model, one sentence each.

    """

    relaxation_time: Estimate
    F0: Estimate
    F_inf: Estimate
    retardation_time: Estimate
    H0: Estimate
    H_inf: Estimate
    K1: Estimate
    C1: Estimate
    C2: Estimate
    hold_fit: ExponentialFit | None = None
    recovery_fit: ExponentialFit | None = None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Decay:
    """One fitted decay; `covariance` is that of (time constant, amplitude, limit)."""

    time_constant: Estimate
    amplitude: Estimate
    limit: Estimate
    covariance: FloatArray
    fit: ExponentialFit | None
    warnings: tuple[str, ...] = ()


def parameters_from_decays(
    relaxation_time: float, F_inf: float, retardation_time: float, H0: float
) -> tuple[float, float, float]:
    """
    Return K1, C1 and C2 from what the two decays give: the paper's steps 3 and 4.

    Parameters
    ----------
    relaxation_time, retardation_time : float
        [s].
    F_inf : float
        [N].
    H0 : float
        [m].

    Returns
    -------
    tuple of float
        K1 [N/m] (eq. 13 with H0), C1 [N.s/m] (eq. 12) and C2 [N.s/m] (eq. 9).

    """
    K1 = F_inf / H0
    C1 = retardation_time * K1
    return K1, C1, relaxation_time * K1 - C1


def fit_paper(trial: Trial, segmentation: Segmentation) -> PaperResult:
    """
    Estimate K1, C1 and C2 of one trial by the paper's method.

    Parameters
    ----------
    trial : Trial
        What was measured.
    segmentation : Segmentation
        Its phases.

    Returns
    -------
    PaperResult
        Estimates with standard errors from the residuals of the two fits, corrected for their
        autocorrelation, and from the errors of the load cell's zero and of the contact height,
        propagated to first order. They hold no error of T_s, T_e and the loss of contact and
        none of the model: where the fit misses by far more than the noise, a warning says so.
        What the trial cannot tell is unknown, with the reason.

    """
    noise = estimate_noise(trial, segmentation)
    hold = _fit_hold(trial, segmentation, noise.force)
    recovery = _fit_recovery(trial, segmentation, noise.height)
    K1, C1, C2 = _parameters(hold, recovery)
    # What is unknown is not too low either.
    early = _unconverged(hold, recovery, segmentation) if K1.known else ()
    return PaperResult(
        relaxation_time=hold.time_constant,
        F0=hold.amplitude,
        F_inf=hold.limit,
        retardation_time=recovery.time_constant,
        H0=recovery.amplitude,
        H_inf=recovery.limit,
        K1=K1,
        C1=C1,
        C2=C2,
        hold_fit=hold.fit,
        recovery_fit=recovery.fit,
        warnings=hold.warnings + recovery.warnings + early,
    )


def _unknown_decay(reason: str, fit: ExponentialFit | None = None) -> _Decay:
    """Return a decay of which nothing is known."""
    nothing = Estimate.unknown(reason)
    return _Decay(nothing, nothing, nothing, np.zeros((3, 3)), fit)


def _unresolved(fit: ExponentialFit, record: str) -> str | None:
    """Return why a significant decay does not tell its time constant; None if it does."""
    relative = fit.std[1] / fit.time_constant
    if fit.time_constant > LONGEST_EXTRAPOLATION * fit.span or relative > WORST_RELATIVE_ERROR:
        return (
            f'the {record} of {fit.span:.3g} s is too short to tell its decay from a straight '
            'line: record longer'
        )
    if fit.time_constant < fit.interval:
        return f'the {record} decays within one sample of {fit.interval:.3g} s'
    return None


def _extrapolated(fit: ExponentialFit, record: str) -> str | None:
    """Return a caution where the limit lies beyond what was recorded."""
    if fit.span >= fit.time_constant:
        return None
    return (
        f'extrapolated: the {record} of {fit.span:.3g} s is shorter than its time constant of '
        f'{fit.time_constant:.3g} s'
    )


def _set_aside(fit: ExponentialFit, what: str) -> tuple[str, ...]:
    """Return the sentence on the samples that the fit left out."""
    if not fit.set_aside.size:
        return ()
    return (
        f'{fit.set_aside.size} glitches of the {what} were set aside, the first at '
        f't = {fit.set_aside[0]:.3f} s',
    )


def _missed(
    fit: ExponentialFit, record: Signal, noise: Estimate, name: str, scale: float, unit: str
) -> tuple[str, ...]:
    """Return the sentence on a decay that one exponential misses by far more than the noise."""
    if noise.value is None:
        return ()
    step = np.abs(np.diff(record.value))
    step = step[step > ROUNDING * float(np.abs(record.value).max())]
    resolution = float(step.min()) / math.sqrt(12.0) if step.size else 0.0
    blur = math.hypot(noise.value, resolution)
    seen = fit.referred_to(fit.start).amplitude
    if fit.noise <= max(MISSED * blur, IRRELEVANT * abs(seen)):
        return ()
    return (
        f'one exponential does not describe the {name}: it misses by {scale * fit.noise:.2g} '
        f'{unit} rms where the noise of a sample is {scale * blur:.2g} {unit}, which the standard '
        'errors do not hold',
    )


def _unconverged(hold: _Decay, recovery: _Decay, phases: Segmentation) -> tuple[str, ...]:
    """
    Return the sentence on a hold that ends before its force has converged.

    The stretch z of the bouncing part converges with the force, and its excess at T_e over
    F_inf / K1 is that of the force over ``F_inf (1 - gamma / tau)`` (eqs. 1, 2, 9 and 12).
    """
    tau, F0, F_inf = hold.time_constant.value, hold.amplitude.value, hold.limit.value
    gamma = recovery.time_constant.value
    if tau is None or F0 is None or F_inf is None or F_inf <= 0.0 or gamma is None or gamma >= tau:
        return ()
    held = (phases.t_release or phases.t_end) - (phases.t_hold or phases.t_end)
    left = F0 * math.exp(-held / tau)
    excess = left / F_inf / (1.0 - gamma / tau)
    if excess <= UNCONVERGED:
        return ()
    return (
        f'the hold ends {left:.2g} N above F_inf: eq. (13) takes the force to have converged by '
        f'T_e, and gives K1, C1 and C2 about {100.0 * excess / (1.0 + excess):.3g} % too low',
    )


def _fit_hold(trial: Trial, segmentation: Segmentation, noise: Estimate) -> _Decay:
    """Fit eq. (4) to the hold."""
    if segmentation.t_hold is None:
        return _unknown_decay('the trial has no hold')
    stop = segmentation.t_end if segmentation.t_release is None else segmentation.t_release
    record = trial.force.between(
        _corner(trial, segmentation.t_hold, stop),
        stop if segmentation.t_release is None else _corner(trial, stop, segmentation.t_hold),
    )
    if len(record) < MIN_SAMPLES:
        return _unknown_decay(f'the hold has only {len(record)} samples of the force')
    fit = fit_exponential(Signal(record.t, record.value - segmentation.force_zero))
    fit = fit.referred_to(segmentation.t_hold)
    warnings = _set_aside(fit, 'hold force')
    drop, drop_std = fit.drop
    if abs(drop) <= max(SIGNIFICANT * drop_std, NEGLIGIBLE * abs(fit.mean)):
        reason = (
            f'no relaxation is told in the hold of {fit.span:.3g} s: a straight line through the '
            f'force of {fit.mean:.4g} N changes by {-fit.slide:+.2g} ± {fit.slide_std:.2g} N'
        )
        slide = max(abs(fit.slide), fit.slide_std)
        limit_std = math.hypot(fit.mean_std, slide, segmentation.force_zero_std)
        return _Decay(
            Estimate.unknown(reason),
            Estimate(0.0, slide, reason),
            Estimate(fit.mean, limit_std, reason),
            np.diag([0.0, 0.0, limit_std**2]),
            fit.flat(),
            warnings,
        )
    if drop < 0.0:
        return _unknown_decay(f'the force rises by {-drop:.2g} N in the hold', fit)
    reason = _unresolved(fit, 'hold') or ''
    if reason:
        return _unknown_decay(reason, fit)
    caution = _extrapolated(fit, 'hold')
    covariance = fit.covariance[np.ix_((1, 0, 2), (1, 0, 2))]
    covariance[2, 2] += segmentation.force_zero_std**2
    time_std, amplitude_std, limit_std = np.sqrt(np.diag(covariance)).tolist()
    return _Decay(
        Estimate(fit.time_constant, time_std, caution),
        Estimate(fit.amplitude, amplitude_std, caution),
        Estimate(fit.offset, limit_std, caution),
        covariance,
        fit,
        warnings + _missed(fit, record, noise, 'hold', 1.0, 'N'),
    )


def _corner(trial: Trial, corner: float, other: float) -> float:
    """
    Return a time [s] in the hold at which the tool rests for certain, near one of its ends.

    The corners of the tool's path are known to about two of its samples, however far apart.
    """
    apart = 2.0 * max(sampling_interval(trial.tool_height), sampling_interval(trial.force))
    t = trial.tool_height.t
    second = int(np.searchsorted(t, corner)) + (1 if other > corner else -2)
    if 0 <= second < t.size:
        apart = max(apart, abs(float(t[second]) - corner))
    apart = min(apart, 0.05 * abs(other - corner))
    return corner + math.copysign(apart, other - corner)


def _fit_recovery(trial: Trial, segmentation: Segmentation, noise: Estimate) -> _Decay:
    """Fit eq. (10) to the free recovery."""
    height = trial.displacement_height
    released = segmentation.t_release
    if released is None:
        return _unknown_decay(segmentation.unreleased)
    if height is None:
        return _unknown_decay('the displacement height was not recorded')
    start, caution = start_of_recovery(trial, segmentation, released)
    if start is None:
        return _unknown_decay(caution)
    record = height.between(start, segmentation.t_end)
    if len(record) < MIN_SAMPLES:
        return _unknown_decay(
            f'the recovery has only {len(record)} samples of the displacement height'
        )
    fit = fit_exponential(record).referred_to(start)
    warnings = _set_aside(fit, 'displacement height')
    warnings += (caution,) if caution else ()
    pressed, pressed_std = pressed_in(trial, segmentation, released)
    if not math.isfinite(pressed):
        return _unknown_decay('no height of the tool was recorded right before the release', fit)
    drop, drop_std = fit.drop
    bounce = pressed - fit.mean
    if abs(drop) <= max(SIGNIFICANT * drop_std, NEGLIGIBLE * abs(bounce)):
        # Nothing has recovered since the loss of contact: a spring, or a purely viscous body.
        reason = (
            'the object recovered as fast as the tool withdrew: in the recovery of '
            f'{fit.span:.3g} s only {1e3 * fit.slide:.2g} ± {1e3 * fit.slide_std:.2g} mm were left'
        )
        limit_std = math.hypot(fit.mean_std, max(abs(fit.slide), fit.slide_std))
        bounce_std = math.hypot(pressed_std, limit_std)
        covariance = np.diag([0.0, bounce_std**2, limit_std**2])
        return _Decay(
            Estimate.unknown(reason),
            Estimate(bounce, bounce_std),
            Estimate(fit.mean, limit_std),
            covariance,
            fit.flat(),
            warnings,
        )
    if drop < 0.0:
        return _unknown_decay(f'the dent deepens by {-1e3 * drop:.2g} mm after the release', fit)
    reason = _unresolved(fit, 'recovery') or ''
    if reason:
        return _unknown_decay(reason, fit)
    at_release = fit.referred_to(released)
    bounce = pressed - fit.offset
    withdrawal = withdrawal_speed(trial, released, start)
    kept_pace = fit.amplitude >= 0.5 * fit.time_constant * withdrawal
    if kept_pace:
        # Rows: (time constant, amplitude, limit) by (amplitude, time constant, offset).
        select = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
        covariance = select @ fit.covariance @ select.T
        covariance[1, 1] += pressed_std**2
        amplitude = bounce
    else:
        order = np.ix_((1, 0, 2), (1, 0, 2))
        covariance = at_release.covariance[order]
        amplitude = at_release.amplitude
        at_once = bounce - amplitude
        if at_once > max(SIGNIFICANT * math.hypot(pressed_std, fit.std[2]), 0.05 * amplitude):
            warnings += (
                f'{1e3 * at_once:.3g} mm came back at once on release, beside the '
                f'{1e3 * amplitude:.3g} mm of eq. (10): the three-element model has no such part',
            )
    warnings += _missed(fit, record, noise, 'recovery', 1e3, 'mm')
    extrapolated = _extrapolated(fit, 'recovery')
    time_std, amplitude_std, limit_std = np.sqrt(np.diag(covariance)).tolist()
    return _Decay(
        Estimate(fit.time_constant, time_std, extrapolated),
        Estimate(amplitude, amplitude_std, extrapolated),
        Estimate(fit.offset, limit_std, extrapolated),
        covariance,
        at_release,
        warnings,
    )


def _parameters(hold: _Decay, recovery: _Decay) -> tuple[Estimate, Estimate, Estimate]:
    """Return K1, C1 and C2 with first-order standard errors, or why they are unknown."""
    F_inf, H0 = hold.limit, recovery.amplitude
    if F_inf.value is None or F_inf.std is None:
        nothing = Estimate.unknown(f'F_inf is unknown: {F_inf.reason}')
        return nothing, nothing, nothing
    if H0.value is None or H0.std is None:
        nothing = Estimate.unknown(f'H0 is unknown: {H0.reason}')
        return nothing, nothing, nothing
    for symbol, value, std, unit in (
        ('F_inf', F_inf.value, F_inf.std, 'N'),
        ('H0', H0.value, H0.std, 'm'),
    ):
        if value <= 3.0 * std:
            nothing = Estimate.unknown(
                f'{symbol} = {value:.2g} ± {std:.2g} {unit} is nothing within its error, so that '
                'eq. (13) gives no stiffness'
            )
            return nothing, nothing, nothing
    K1 = F_inf.value / H0.value
    relative = math.hypot(F_inf.std / F_inf.value, H0.std / H0.value)
    caution = F_inf.reason or H0.reason
    stiffness = Estimate(K1, K1 * relative, caution)
    gamma, tau = recovery.time_constant, hold.time_constant
    if gamma.value is None:
        nothing = Estimate.unknown(f'the retardation time is unknown: {gamma.reason}')
        return stiffness, nothing, nothing
    # In the order (relaxation time, F_inf, retardation time, H0).
    covariance = np.zeros((4, 4))
    covariance[:2, :2] = hold.covariance[np.ix_((0, 2), (0, 2))]
    covariance[2:, 2:] = recovery.covariance[:2, :2]
    C1 = gamma.value * K1
    gradient = np.array([0.0, C1 / F_inf.value, K1, -C1 / H0.value])
    viscosity = Estimate(C1, math.sqrt(float(gradient @ covariance @ gradient)), caution)
    if tau.value is None:
        nothing = Estimate.unknown(f'the relaxation time is unknown: {tau.reason}')
        return stiffness, viscosity, nothing
    C2 = parameters_from_decays(tau.value, F_inf.value, gamma.value, H0.value)[2]
    if C2 <= 0.0:
        nothing = Estimate.unknown(
            f'the retardation time of {gamma.value:.3g} s is no shorter than the relaxation time '
            f'of {tau.value:.3g} s, which eqs. (9) and (12) rule out'
        )
        return stiffness, viscosity, nothing
    gradient = np.array([K1, C2 / F_inf.value, -K1, -C2 / H0.value])
    return (
        stiffness,
        viscosity,
        Estimate(C2, math.sqrt(float(gradient @ covariance @ gradient)), caution),
    )
