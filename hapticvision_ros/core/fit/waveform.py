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
Least squares of the three-element model to the whole force while the tool touches.

In push and hold the force is linear in ``eta`` and ``k`` at a given relaxation time (see
`hapticvision_ros.core.models.three_element`), so that the search runs over that one number, with
non-negative least squares inside; K1, C1 and C2 then follow in closed form. All trials share one
set of parameters. The free recovery is not fitted: how far the same parameters miss it is the
error of the displacement height.

"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
import math
from typing import Final, Literal

from hapticvision_ros.core.fit.exponential import MIN_SAMPLES
from hapticvision_ros.core.fit.glitches import find_glitches
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.fit.release import (
    sampling_interval,
    start_of_recovery,
    withdrawal_speed,
)
from hapticvision_ros.core.fit.uncertainty import least_squares_covariance
from hapticvision_ros.core.models.three_element import maxwell_stretch, respond, ThreeElement
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np

MODEL: Final = 'three-element'
UNITS: Final = {'K1': 'N/m', 'C1': 'N.s/m', 'C2': 'N.s/m'}

_BLOCKS: Final = 256
_MAX_KNOTS: Final = 48
_GRID: Final = 64
_LONGEST: Final = 1e4
"""The slowest relaxation that is tried, in durations of a trial: a spring."""


@dataclass(frozen=True, slots=True)
class PhaseMiss:
    """
    How far the model misses the force in one phase.

    Parameters
    ----------
    phase : {'push', 'hold'}
        Which phase.
    rmse : float
        Root mean square of measured minus fitted force [N].
    share_of_peak : float
        The same over the largest measured force of the trial [-].

    """

    phase: Literal['push', 'hold']
    rmse: float
    share_of_peak: float


@dataclass(frozen=True, slots=True)
class Prediction:
    """
    One trial beside what the model says of it.

    Parameters
    ----------
    force : Signal
        Measured contact force in push and hold, without the load cell's zero [N]; glitches and two
        samples on either side of the path's corners are left out.
    force_fitted : ndarray
        The model's force at the same times [N].
    height : Signal or None
        Measured displacement height in the free recovery, without glitches [m].
    height_fitted : ndarray or None
        The model's at the same times [m].
    misses : tuple of PhaseMiss
        Phase by phase.

    """

    force: Signal
    force_fitted: FloatArray
    height: Signal | None
    height_fitted: FloatArray | None
    misses: tuple[PhaseMiss, ...]


@dataclass(frozen=True, slots=True)
class ModelError:
    """
    How far a model misses a set of trials; None where there is nothing to compare with.

    Parameters
    ----------
    force_rmse, height_rmse : float or None
        Root mean square of measured minus model, of force [N] and of displacement height [m].
    force_chi2, height_chi2 : float or None
        Mean squared residual over the squared noise of a sample [-].

    """

    force_rmse: float | None
    height_rmse: float | None
    force_chi2: float | None
    height_chi2: float | None


@dataclass(frozen=True, slots=True)
class ModelFit:
    """
    A model fitted to trials, and how far it misses them.

    Parameters
    ----------
    model : str
        What was fitted.
    parameters : mapping of str to Estimate
        K1 [N/m], C1 and C2 [N.s/m]. The standard errors are approximate: they take what the model
        misses for autocorrelated noise.
    units : mapping of str to str
        Unit of each parameter.
    predictions : tuple of (Prediction or None)
        One for each trial of the fit; None where the trial could not be used.
    held_out_predictions : tuple of (Prediction or None)
        One for each trial kept out of the fit.
    train, held_out : ModelError or None
        Errors on either; None without any such trial.
    warnings : tuple of str
        What could not be used or told.

    """

    model: str
    parameters: Mapping[str, Estimate]
    units: Mapping[str, str]
    predictions: tuple[Prediction | None, ...]
    held_out_predictions: tuple[Prediction | None, ...]
    train: ModelError | None
    held_out: ModelError | None
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class _Contact:
    """What a trial has of the time in contact: the tool's path as knots, the force and phases."""

    knot_t: FloatArray
    knot_height: FloatArray
    force: Signal
    t_hold: float | None
    block_t: FloatArray
    block_force: FloatArray
    block_weight: FloatArray


type SegmentedTrial = tuple[Trial, Segmentation]


def fit_waveform(
    trials: Sequence[SegmentedTrial], held_out: Sequence[SegmentedTrial], noise: Noise
) -> ModelFit:
    """
    Fit the three-element model to push and hold of several trials at once.

    Parameters
    ----------
    trials, held_out : sequence of (Trial, Segmentation)
        Trials to fit, and trials only to compare with.
    noise : Noise
        Of one sample, for chi squared.

    Returns
    -------
    ModelFit
        With unknown parameters and a reason where the trials cannot tell them.

    """
    warnings: list[str] = []
    contacts = [_contact(trial, phases, warnings) for trial, phases in trials]
    usable = [contact for contact in contacts if contact is not None]
    if not usable:
        nothing = Estimate.unknown('no trial has a push to fit')
        return ModelFit(
            MODEL,
            dict.fromkeys(UNITS, nothing),
            UNITS,
            (None,) * len(contacts),
            (None,) * len(held_out),
            None,
            None,
            tuple(warnings),
        )
    eta, k, T, limits = _search(usable)
    parameters = _parameters(usable, eta, k, T, limits)
    warnings += [
        f'{name} is unknown: {e.reason}'
        for name, e in parameters.items()
        if not e.known and e.reason
    ]
    # A vanishing branch, so that the same equations predict a bare dashpot.
    body = ThreeElement.from_maxwell(eta, max(k, 1e-9 * eta / T, 1e-12), T)
    predictions = tuple(
        None if contact is None else _predict(contact, body, trial, phases, warnings)
        for contact, (trial, phases) in zip(contacts, trials, strict=True)
    )
    kept_out = tuple(
        None if contact is None else _predict(contact, body, trial, phases, warnings)
        for trial, phases in held_out
        for contact in (_contact(trial, phases, warnings),)
    )
    return ModelFit(
        MODEL,
        parameters,
        UNITS,
        predictions,
        kept_out,
        _error(predictions, noise),
        _error(kept_out, noise),
        tuple(warnings),
    )


def _contact(trial: Trial, phases: Segmentation, warnings: list[str]) -> _Contact | None:
    """Return a trial's time in contact, or None with a warning."""
    start, original = phases.t_contact, phases.contact_height
    stop = phases.t_end if phases.t_release is None else phases.t_release
    if start is None or original is None or stop <= start:
        warnings.append(f'{trial.name}: no contact was found, so no model was fitted to it')
        return None
    inside = trial.force.between(start, stop)
    tool = trial.tool_height.between(start, stop)
    if len(inside) < MIN_SAMPLES or len(tool) < 4:
        warnings.append(f'{trial.name}: too few samples in contact to fit a model')
        return None
    force = Signal(inside.t, inside.value - phases.force_zero)
    breaks = [start, stop]
    if phases.t_hold is not None and start < phases.t_hold < stop:
        breaks.insert(1, phases.t_hold)
    knot_t, knot_height = _tool_path(Signal(tool.t, original - tool.value), breaks)
    apart = np.min(np.abs(np.subtract.outer(force.t, breaks)), axis=1) > _corner(trial, breaks)
    force = Signal(force.t[apart], force.value[apart])
    force = _without_glitches(force, breaks[1:-1], trial.name, 'force in contact', warnings)
    if len(force) < MIN_SAMPLES:
        warnings.append(f'{trial.name}: too few samples in contact to fit a model')
        return None
    block_t, block_force, block_weight = _average(force.t, force.value, breaks)
    return _Contact(knot_t, knot_height, force, phases.t_hold, block_t, block_force, block_weight)


def _without_glitches(
    signal: Signal, breaks: Sequence[float], trial: str, what: str, warnings: list[str]
) -> Signal:
    """Return a signal without its glitches, and warn of them."""
    # Piece by piece, since the peak between push and hold is as short as a burst.
    pieces = np.split(signal.value, np.searchsorted(signal.t, breaks))
    glitch = np.concatenate([find_glitches(piece) for piece in pieces])
    count = int(np.count_nonzero(glitch))
    if not count:
        return signal
    glitches = '1 glitch' if count == 1 else f'{count} glitches'
    verb = 'was' if count == 1 else 'were'
    warnings.append(f'{trial}: {glitches} of the {what} {verb} set aside')
    return Signal(signal.t[~glitch], signal.value[~glitch])


def _corner(trial: Trial, breaks: Sequence[float]) -> float:
    """
    Return how near a corner of the tool's path a sample is neither fitted nor counted [s].

    The force jumps there, and the corner is known to about two samples.
    """
    known = 2.0 * max(sampling_interval(trial.tool_height), sampling_interval(trial.force))
    return min(known, 0.05 * float(np.diff(breaks).min()))


def _average(
    t: FloatArray, value: FloatArray, breaks: Sequence[float]
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean times, mean values and counts of blocks that no break runs through."""
    bounds = np.searchsorted(t, breaks[1:-1]).tolist()
    edges = [0]
    for first, last in zip([0, *bounds], [*bounds, t.size], strict=True):
        edges += np.linspace(first, last, min(last - first, _BLOCKS) + 1).astype(int)[1:].tolist()
    starts = np.array(edges[:-1], dtype=np.intp)
    count = np.diff(edges).astype(np.float64)
    return np.add.reduceat(t, starts) / count, np.add.reduceat(value, starts) / count, count


def _tool_path(height: Signal, breaks: Sequence[float]) -> tuple[FloatArray, FloatArray]:
    """
    Return the fewest straight pieces that follow the tool within the encoders' noise.

    The dashpot makes force of speed, so that differences of noisy samples will not do.
    """
    inner = [b for b in breaks[1:-1] if height.t[0] < b < height.t[-1]]
    t, value, count = _average(height.t, height.value, [breaks[0], *inner, breaks[-1]])
    knots = np.array([breaks[0], *inner, breaks[-1]])
    weight = np.sqrt(count)
    # The 95th percentile: a moving tool whose samples carry the time of their sending scatters
    # with its speed, and is at rest for most of the time.
    scatter = np.abs(np.diff(value, 2)) if value.size > 4 else np.zeros(1)
    noise = float(np.quantile(scatter, 0.95)) / (1.96 * math.sqrt(6.0))
    tolerance = max(4.0 * noise, 1e-4 * float(np.ptp(value)))
    shortest = 3.0 * sampling_interval(height)
    while True:
        hats = _hats(t, knots)
        level = np.linalg.lstsq(hats * weight[:, np.newaxis], value * weight, rcond=None)[0]
        miss = np.abs(value - hats @ level)
        miss[np.min(np.abs(t[:, np.newaxis] - knots), axis=1) < shortest] = 0.0
        # A piece without a sample inside would have any slope.
        piece = np.searchsorted(knots, t, side='right')
        miss[
            np.append(True, piece[1:] != piece[:-1]) | np.append(piece[1:] != piece[:-1], True)
        ] = 0.0
        worst = int(np.argmax(miss))
        if miss[worst] <= tolerance or knots.size >= _MAX_KNOTS:
            return knots, np.asarray(level, dtype=np.float64)
        knots = np.sort(np.append(knots, t[worst]))


def _hats(t: FloatArray, knots: FloatArray) -> FloatArray:
    """Return the linear interpolation at `t` between `knots` as a matrix."""
    piece = np.clip(np.searchsorted(knots, t, side='right') - 1, 0, knots.size - 2)
    share = (t - knots[piece]) / (knots[piece + 1] - knots[piece])
    hats = np.zeros((t.size, knots.size))
    rows = np.arange(t.size)
    hats[rows, piece] = 1.0 - share
    hats[rows, piece + 1] = share
    return hats


def _search(contacts: Sequence[_Contact]) -> tuple[float, float, float, tuple[float, float]]:
    """Return eta [N.s/m], k [N/m], T [s] of least squares, and the limits of T [s]."""
    duration = max(float(np.ptp(contact.knot_t)) for contact in contacts)
    interval = min(sampling_interval(contact.force) for contact in contacts)
    limits = (interval, _LONGEST * duration)
    low, high = limits
    while True:
        grid = np.geomspace(low, high, _GRID)
        cost, eta, k = _costs(contacts, grid)
        best = int(np.argmin(cost))
        low, high = float(grid[max(best - 1, 0)]), float(grid[min(best + 1, _GRID - 1)])
        if high < low * (1.0 + 1e-8):
            return float(eta[best]), float(k[best]), float(grid[best]), limits


def _costs(
    contacts: Sequence[_Contact], T: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the least cost at each T, and the eta and k, neither negative, that reach it."""
    vv = vf = ff = 0.0
    vs, ss, sf = np.zeros(T.size), np.zeros(T.size), np.zeros(T.size)
    for contact in contacts:
        speed, stretch = maxwell_stretch(contact.block_t, contact.knot_t, contact.knot_height, T)
        weighted = contact.block_weight * contact.block_force
        vv += float(contact.block_weight @ speed**2)
        vf += float(weighted @ speed)
        ff += float(weighted @ contact.block_force)
        vs += stretch @ (contact.block_weight * speed)
        ss += stretch**2 @ contact.block_weight
        sf += stretch @ weighted
    determinant = vv * ss - vs**2
    with np.errstate(divide='ignore', invalid='ignore'):
        eta = (ss * vf - vs * sf) / determinant
        k = (vv * sf - vs * vf) / determinant
        inside = (eta >= 0.0) & (k >= 0.0) & (determinant > 1e-12 * vv * ss)
        only_k = np.maximum(sf / ss, 0.0)
    only_eta = max(vf / vv, 0.0) if vv > 0.0 else 0.0
    branch_wins = only_k * sf >= only_eta * vf
    eta = np.where(inside, eta, np.where(branch_wins, 0.0, only_eta))
    k = np.where(inside, k, np.where(branch_wins, only_k, 0.0))
    return ff - eta * vf - k * sf, eta, k


def _parameters(
    contacts: Sequence[_Contact], eta: float, k: float, T: float, limits: tuple[float, float]
) -> dict[str, Estimate]:
    """Return K1, C1 and C2 with standard errors, unknown where the fit lies on a bound."""
    columns, residuals = [], []
    for contact in contacts:
        nearby = T * np.exp(np.array([-1e-4, 0.0, 1e-4]))
        speed, stretch = maxwell_stretch(
            contact.block_t, contact.knot_t, contact.knot_height, nearby
        )
        weight = np.sqrt(contact.block_weight)
        slope = k * (stretch[2] - stretch[0]) / 2e-4
        columns.append(weight * np.stack((speed, stretch[1], slope)))
        residuals.append(weight * (contact.block_force - eta * speed - k * stretch[1]))
    jacobian = np.concatenate(columns, axis=1).T
    active = [1, 2] if eta == 0.0 else [0, 1, 2]
    covariance = np.zeros((3, 3))
    covariance[np.ix_(active, active)] = least_squares_covariance(jacobian[:, active], residuals)
    if k <= 2.0 * math.sqrt(covariance[1, 1]) or T / limits[0] < 1.01:
        reason = 'the force follows the speed of the tool alone, like that of a bare dashpot'
        spread = least_squares_covariance(jacobian[:, :1], residuals)[0, 0]
        return {
            'K1': Estimate.unknown(reason),
            'C1': Estimate.unknown(reason),
            'C2': _bounded(
                'C2', eta + (k * T if T / limits[0] < 1.01 else 0.0), math.sqrt(spread)
            ),
        }
    # In the order (eta, k, log T); q = eta / (k T) is C1 over C2.
    q = eta / (k * T)
    gradients = {
        'K1': (
            2.0 * (1.0 + q) / T,
            (1.0 + q) ** 2 - 2.0 * q * (1.0 + q),
            -2.0 * eta * (1.0 + q) / T,
        ),
        'C1': (1.0 + 2.0 * q, -eta * q / k, -eta * q),
        'C2': (1.0, T, k * T),
    }
    body = ThreeElement.from_maxwell(eta, k, T)
    values = {'K1': body.K1, 'C1': body.C1, 'C2': body.C2}
    estimates = {}
    for name, gradient in gradients.items():
        std = math.sqrt(max(float(np.array(gradient) @ covariance @ np.array(gradient)), 0.0))
        estimates[name] = _bounded(name, values[name], std)
    if eta == 0.0:
        estimates['C1'] = Estimate.unknown('the best fit lies on the bound C1 = 0')
    if T / limits[1] > 0.99 or math.sqrt(covariance[2, 2]) > 0.5:
        estimates['C2'] = Estimate.unknown(
            'the best fit is a body that does not flow: it only bounds C2 from below'
        )
    return estimates


def _bounded(name: str, value: float, std: float) -> Estimate:
    """Return an estimate, unknown if its error is as large as itself."""
    if not std < value:
        return Estimate.unknown(f'{name} = {value:.2g} is nothing within its error of {std:.2g}')
    return Estimate(value, std)


def _predict(
    contact: _Contact,
    body: ThreeElement,
    trial: Trial,
    phases: Segmentation,
    warnings: list[str],
) -> Prediction:
    """Return what the body does in a trial, beside what was measured."""
    t = contact.force.t
    speed, stretch = maxwell_stretch(
        t, contact.knot_t, contact.knot_height, np.array([body.relaxation_time])
    )
    fitted = body.eta * speed + body.k * stretch[0]
    residual = contact.force.value - fitted
    peak = float(np.quantile(contact.force.value, 0.999))
    misses = []
    in_push = t < (math.inf if contact.t_hold is None else contact.t_hold)
    for phase, chosen in (('push', in_push), ('hold', ~in_push)):
        if chosen.any() and peak > 0.0:
            rmse = math.sqrt(float(np.mean(residual[chosen] ** 2)))
            misses.append(PhaseMiss('push' if phase == 'push' else 'hold', rmse, rmse / peak))
    height = _free_height(trial, phases, warnings)
    height_fitted = None
    if height is not None and phases.t_release is not None:
        height_fitted = _recovered(contact, body, trial, phases.t_release, height)
    if height_fitted is None:
        height = None
    return Prediction(contact.force, fitted, height, height_fitted, tuple(misses))


def _free_height(trial: Trial, phases: Segmentation, warnings: list[str]) -> Signal | None:
    """Return the displacement height from the loss of contact on, if it was measured."""
    if phases.t_release is None or trial.displacement_height is None:
        return None
    start, _ = start_of_recovery(trial, phases, phases.t_release)
    if start is None:
        return None
    record = trial.displacement_height.between(start, phases.t_end)
    if not len(record):
        return None
    return _without_glitches(record, (), trial.name, 'height in the recovery', warnings)


def _recovered(
    contact: _Contact, body: ThreeElement, trial: Trial, released: float, height: Signal
) -> FloatArray | None:
    """Return the model's displacement height at the times of `height` [m]."""
    speed = withdrawal_speed(trial, released, float(height.t[0]))
    depth = float(contact.knot_height[-1])
    if speed <= 0.0 or depth <= 0.0:
        return None
    # Far enough out that the tool has left by then, whatever the body.
    knot_t = np.append(contact.knot_t, contact.knot_t[-1] + 2.0 * depth / speed)
    knot_height = np.append(contact.knot_height, -depth)
    return respond(body, height.t, knot_t, knot_height).height


def _error(predictions: Sequence[Prediction | None], noise: Noise) -> ModelError | None:
    """Return the error over several trials, every sample counting alike."""
    forces, heights = [], []
    for prediction in predictions:
        if prediction is None:
            continue
        forces.append(prediction.force.value - prediction.force_fitted)
        if prediction.height is not None and prediction.height_fitted is not None:
            heights.append(prediction.height.value - prediction.height_fitted)
    if not forces:
        return None
    force, height = _rmse(forces), _rmse(heights)
    return ModelError(
        force, height, _chi2(force, noise.force.value), _chi2(height, noise.height.value)
    )


def _rmse(residuals: Sequence[FloatArray]) -> float | None:
    """Return the root mean square of all residuals together."""
    if not residuals:
        return None
    return math.sqrt(float(np.mean(np.concatenate(residuals) ** 2)))


def _chi2(rmse: float | None, noise: float | None) -> float | None:
    """Return the mean squared residual over the squared noise."""
    return None if rmse is None or not noise else (rmse / noise) ** 2
