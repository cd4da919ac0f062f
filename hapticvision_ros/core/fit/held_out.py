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
How far a model misses trials: those that it was fitted to, and those that it has not seen.

Of a trial that a fit has not seen, only its own values are found from it: the onset within the
precision of the detected contact, the zeros of the sensors, and what an effect declares for a
trial, such as a phase. The parameters of the model stay where the fit has put them.

Where no trial is named to be held out, each condition of the push (speed and depth) is left out in
turn, the parameters are fitted to the others, and the condition is predicted.

References
----------
M. Stone, J. R. Stat. Soc. B 36, 1974, 111-147, doi:10.1111/j.2517-6161.1974.tb00994.x
(cross-validation).

"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
import math
from types import MappingProxyType
from typing import Final, NamedTuple

from hapticvision_ros.core import parallel
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import Channel, HeldOutChange, Misfit, Misfits, Phase
from hapticvision_ros.core.fit.bend import Servo
from hapticvision_ros.core.fit.campaign import (
    calm,
    CampaignNoise,
    find_onsets,
    Fit,
    pairs_of,
    Problem,
    Segmented,
    TrialFit,
    turn_phases,
)
from hapticvision_ros.core.fit.data import (
    deepest_before,
    FitTrial,
    prepare,
    range_end_of,
    reads_at_moments,
)
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.fit.noise import (
    estimate_noise,
    in_motion,
    Noise,
    of_neighbours,
    pool_noise,
    rounding,
)
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np
from numpy.typing import NDArray

PHASES: Final[tuple[Phase, ...]] = ('approach', 'push', 'hold', 'release', 'recover')
CHANNELS: Final[tuple[Channel, ...]] = ('force', 'height')

_ALIKE: Final = 0.1
"""Pushes whose speeds and depths differ by no more than this share are one condition."""
_TOLERANCE: Final = 1e-7
_BASELINE: Final = 32
"""Samples before contact, in all trials together, from which on they tell the noise."""
_FEWEST: Final = 8
"""Samples before contact from which on a trial takes part in that."""
_CLOSE_TO_TOUCH: Final = 2
"""Samples before the detected touch that may come after the true one."""
_DOUBT: Final = 2.0
"""Standard errors by which the residual may exceed the noise before contact."""
_LOCAL_ERROR: Final = 0.05
"""Relative error of the noise that neighbouring samples show."""
_ROUNDING: Final = 1e-12
"""Scatter below this share of the signal is arithmetic."""


@dataclass(frozen=True, slots=True)
class Trained:
    """
    A model with the parameters that some trials have given it.

    Parameters
    ----------
    model : Model
        The model.
    theta : ndarray, shape (p,)
        Its parameters, as the fit sees them.
    noise : CampaignNoise
        Of the sensors.
    reference_depth : float
        Deepest push of the trials [m], to which some effects refer.
    pushes : tuple of (float, float)
        When the trials start, from the start of the campaign [s], and their depths [m].
    start_ns : int
        When the campaign began [ns since the epoch], from where an effect may count its time.
    scatter : ndarray, shape (3,) or (0,)
        Standard deviations of the logarithms of K1, C1 and C2 from trial to trial.
    servo : Servo, optional
        How the arm changes its speed; what the encoders of the unseen trials tell by default.
    momentary : bool, optional
        Whether the readings of the force are of a moment.
    range_end : float, optional
        Where the range of the load cell ends [N].

    """

    model: Model
    theta: FloatArray
    noise: CampaignNoise
    reference_depth: float
    pushes: tuple[tuple[float, float], ...]
    start_ns: int
    scatter: FloatArray
    servo: Servo | None = None
    momentary: bool | None = None
    range_end: float = math.inf

    @classmethod
    def of(cls, fit: Fit, campaign: Sequence[Segmented]) -> 'Trained':
        """Return what a fit to a campaign has found."""
        return cls(
            fit.model,
            fit.theta,
            fit.noise,
            fit.problem.trials[0].reference_depth,
            tuple((trial.campaign_time, trial.depth) for trial in fit.problem.trials),
            min(trial.start_ns for trial, _ in pairs_of(campaign)),
            fit.problem.scatter,
            fit.problem.trials[0].path.servo,
            reads_at_moments(pairs_of(campaign)),
            range_end_of(pairs_of(campaign)),
        )

    def problem(self, trials: Sequence[FitTrial]) -> Problem:
        """Return the problem of the trials' own values."""
        return Problem(self.model, trials, self.scatter)


@dataclass(frozen=True, slots=True)
class Unseen:
    """
    Trials that a fit has not seen, beside what it says of them.

    Parameters
    ----------
    trials : tuple of (TrialFit or None)
        One for each trial; None where it could not be used.
    squares : tuple of (float or None)
        Whitened squares of each, with the price of its onset.
    warnings : tuple of str
        Why a trial could not be used.

    """

    trials: tuple[TrialFit | None, ...]
    squares: tuple[float | None, ...]
    warnings: tuple[str, ...] = ()


class Residuals(NamedTuple):
    """Measured values of one channel of a trial, its residuals and their phases (an index)."""

    measured: FloatArray
    residual: FloatArray
    phase: NDArray[np.intp]


def labels(campaign: Sequence[Segmented]) -> tuple[str, ...]:
    """Return the names of trials, told apart by a number where they are alike."""
    names = [trial.name for trial, _ in pairs_of(campaign)]
    seen: dict[str, int] = {}
    made = []
    for name in names:
        seen[name] = seen.get(name, 0) + 1
        made.append(name if seen[name] == 1 else f'{name} ({seen[name]})')
    return tuple(made)


def phases_at(t: FloatArray, segmentation: Segmentation) -> NDArray[np.intp]:
    """Return the phase at some times, as an index into `PHASES`; shape as `t`."""
    phase = np.zeros(t.shape, dtype=np.intp)
    starts = (
        segmentation.t_contact,
        segmentation.t_hold,
        segmentation.t_release,
        segmentation.t_loss,
    )
    for index, start in enumerate(starts, start=1):
        if start is not None:
            phase[t >= start] = index
    return phase


def fitted_trials(fit: Fit, campaign: Sequence[Segmented]) -> tuple[TrialFit | None, ...]:
    """
    Return the trials of a fit beside the model, each sample of force and height by itself.

    Parameters
    ----------
    fit : Fit
        The fit.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        What it was fitted to.

    Returns
    -------
    tuple of (TrialFit or None)
        As `Fit.trials`, whose heights are the means that the fit works with.

    """
    result: list[TrialFit | None] = []
    indices = iter(range(len(fit.problem.trials)))
    for one, (trial, _) in zip(fit.trials, pairs_of(campaign), strict=True):
        if one is None:
            result.append(None)
            continue
        index = next(indices)
        if not np.any(fit.problem.trials[index].height_count > 1.0):
            result.append(one)
            continue
        full = _every_height(fit.problem.trials[index].full_rate, trial)
        predicted = fit.problem.predict(fit.state, index, full, directions=False)
        zero = fit.problem.own(fit.state, index)[2]
        result.append(
            replace(
                one,
                height=Signal(full.height_t, full.height - zero),
                height_fitted=predicted.height,
            )
        )
    return tuple(result)


def misfits(
    trials: Sequence[TrialFit | None], campaign: Sequence[Segmented], noise: Noise
) -> Misfits | None:
    """
    Return how far a model misses trials, per channel, phase and trial.

    Parameters
    ----------
    trials : sequence of (TrialFit or None)
        The trials beside the model, from `fitted_trials` or `predict_unseen`.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The same trials as measured, with their phases.
    noise : Noise
        Of one sample, to which chi squared refers.

    Returns
    -------
    Misfits or None
        The trials under their `labels`. The range is that of the measured values of the channel:
        over all trials for `total` and `by_phase`, and over the trial for `by_trial`. None
        without any trial to compare with.

    """
    scale = {'force': noise.force.value, 'height': noise.height.value}
    total: dict[Channel, Misfit] = {}
    by_phase: dict[tuple[Channel, Phase], Misfit] = {}
    by_trial: dict[tuple[str, Channel], Misfit] = {}
    parts: dict[Channel, list[Residuals]] = {channel: [] for channel in CHANNELS}
    for label, one, (_, phases) in zip(labels(campaign), trials, pairs_of(campaign), strict=True):
        if one is None:
            continue
        for channel in CHANNELS:
            part = residuals(one, phases, channel)
            if part.residual.size:
                parts[channel].append(part)
                by_trial[label, channel] = _misfit(
                    part.residual, scale[channel], float(np.ptp(part.measured))
                )
    for channel in CHANNELS:
        if not parts[channel]:
            continue
        residual = np.concatenate([part.residual for part in parts[channel]])
        phase = np.concatenate([part.phase for part in parts[channel]])
        span = float(np.ptp(np.concatenate([part.measured for part in parts[channel]])))
        total[channel] = _misfit(residual, scale[channel], span)
        for index, name in enumerate(PHASES):
            if np.any(phase == index):
                by_phase[channel, name] = _misfit(residual[phase == index], scale[channel], span)
    return Misfits(total, by_phase, by_trial) if total else None


def residuals(trial: TrialFit, segmentation: Segmentation, channel: Channel) -> Residuals:
    """Return measured minus predicted of one channel, with the phases of the samples."""
    measured, fitted = signals(trial, channel)
    return Residuals(measured.value, measured.value - fitted, phases_at(measured.t, segmentation))


def signals(trial: TrialFit, channel: Channel) -> tuple[Signal, FloatArray]:
    """Return what was measured of one channel, and what the model says of it."""
    if channel == 'force':
        return trial.force, trial.force_fitted
    return trial.height, trial.height_fitted


def _misfit(residual: FloatArray, noise: float | None, span: float) -> Misfit:
    """Return the size of a residual."""
    square = float(residual @ residual) / residual.size
    return Misfit(
        samples=residual.size,
        rmse=math.sqrt(square),
        chi2=square / noise**2 if noise else None,
        percent_of_range=100.0 * math.sqrt(square) / span if span > 0.0 else None,
    )


def sample_noise(
    fit: Fit, trials: Sequence[TrialFit | None], campaign: Sequence[Segmented]
) -> Noise:
    """
    Return the noise of one sample of force and height, to which chi squared refers.

    It is the root mean square residual of the fit, unless that exceeds the noise before contact,
    where the model cannot be wrong, by more than two standard errors: then it is the noise before
    contact. Where the records show nothing before contact, or one and the same reading, the
    scatter between neighbouring samples (`hapticvision_ros.core.fit.noise`) takes its place, which
    does not see slow noise.

    Parameters
    ----------
    fit : Fit
        The fit with the least residual of those to compare.
    trials : sequence of (TrialFit or None)
        Its trials, from `fitted_trials`.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The same trials.

    Returns
    -------
    Noise
        One standard deviation of a sample of either; unknown with a reason.

    """
    pairs = pairs_of(campaign)
    local = pool_noise([estimate_noise(*pair) for pair in pairs])
    parts: dict[Channel, list[Residuals]] = {
        channel: [
            residuals(one, phases, channel)
            for one, (_, phases) in zip(trials, pairs, strict=True)
            if one is not None
        ]
        for channel in CHANNELS
    }
    return Noise(
        _level(parts['force'], local.force, 'force'),
        _level(parts['height'], local.height, 'displacement height'),
    )


def _level(parts: Sequence[Residuals], local: Estimate, what: str) -> Estimate:
    """Return the noise of a sample of one channel."""
    parts = [part for part in parts if part.residual.size]
    if not parts:
        return local
    size = sum(part.residual.size for part in parts)
    rmse = math.sqrt(sum(float(part.residual @ part.residual) for part in parts) / size)
    air, doubt, count = 0.0, 0.0, 0
    coarse = max(rounding(part.measured) for part in parts)
    for part in parts:
        # As measured: what a model misses after the touch may move its onset ahead of it.
        early = part.measured[part.phase == 0]
        early = early[: early.size - _CLOSE_TO_TOUCH - early.size // 50]
        if early.size >= _FEWEST:
            noise = _about_a_line(early)
            count += early.size
            # A coarse sensor may read the same without contact, and rounds in it.
            rounded = in_motion(early, coarse) if coarse > 0.0 else 0.0
            if np.ptp(early) == 0.0:
                # As does a height that is taken from the tool once it touches.
                rounded = max(rounded, of_neighbours(part.residual[part.phase > 0]))
            air += max(float(noise @ noise) / (early.size - 2), rounded**2) * early.size
            doubt += early.size * _memory(noise)
    if count >= _BASELINE:
        quiet, error = math.sqrt(air / count), math.sqrt(0.5 * doubt) / count
    elif local.value is None and coarse == 0.0:
        return local
    else:
        quiet, error = local.value or 0.0, _LOCAL_ERROR
        if coarse > quiet:
            quiet = math.hypot(quiet, coarse)
    value = quiet if rmse > quiet * (1.0 + _DOUBT * error) else rmse
    largest = max(float(np.abs(part.measured).max()) for part in parts)
    if value <= _ROUNDING * largest:
        return Estimate.unknown(f'the {what} shows no noise at all')
    return Estimate(value)


def _about_a_line(value: FloatArray) -> FloatArray:
    """Return samples less the straight line through them."""
    along = np.linspace(-1.0, 1.0, value.size)
    slope = float(along @ value) / float(along @ along)
    return np.asarray(value - value.mean() - slope * along, dtype=np.float64)


def _memory(noise: FloatArray) -> float:
    """Return by how much the memory of a noise widens the error of its variance."""
    power = np.abs(np.fft.rfft(noise, 2 * noise.size)) ** 2
    correlation = np.fft.irfft(power)[: noise.size]
    if correlation[0] <= 0.0:
        return 1.0
    correlation /= correlation[0]
    # Beyond the first lag that is not told from none there is only chance.
    end = int(np.argmax(np.append(correlation, 0.0) < 2.0 / math.sqrt(noise.size)))
    return 1.0 + 2.0 * float(correlation[1:end] @ correlation[1:end])


def predict_unseen(
    trained: Trained, unseen: Sequence[Segmented], noise: CampaignNoise | None = None
) -> Unseen:
    """
    Predict trials that a fit has not seen.

    Parameters
    ----------
    trained : Trained
        The model with its parameters, which stay as they are.
    unseen : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials; each one's own values are found from it alone.
    noise : CampaignNoise, optional
        What the trials' own values and `Unseen.squares` are weighted by; that of the fit by
        default. Two models are compared on the same.

    Returns
    -------
    Unseen
        The trials beside the model.

    """
    pairs = pairs_of(unseen)
    # What has a phase is faster than the steps of a trial.
    fast = any(math.isnan(own.neutral) for own in trained.model.trial_parameters)
    prepared, warnings = prepare(
        pairs,
        windows=fast,
        servo=... if trained.servo is None else trained.servo,
        momentary=trained.momentary,
        range_end=trained.range_end,
    )
    first = min((trial.start_ns for trial, _ in pairs), default=0)
    later = (first - trained.start_ns) * 1e-9
    pushes = [
        *trained.pushes,
        *((one.campaign_time + later, one.depth) for one in prepared if one is not None),
    ]
    moved = [
        None
        if trial is None
        else replace(
            trial,
            reference_depth=trained.reference_depth,
            campaign_time=trial.campaign_time + later,
            depth_before=deepest_before(trial.campaign_time + later, pushes),
        )
        for trial in prepared
    ]
    return replace(_predict(trained, moved, pairs, noise), warnings=warnings)


def _predict(
    trained: Trained,
    prepared: Sequence[FitTrial | None],
    pairs: Sequence[tuple[Trial, Segmentation]],
    noise: CampaignNoise | None,
) -> Unseen:
    """Predict trials in the form of the fit."""
    weights = trained.noise if noise is None else noise
    results = [
        None if one is None else _predict_one(trained, one, trial, weights)
        for one, (trial, _) in zip(prepared, pairs, strict=True)
    ]
    return Unseen(
        tuple(None if result is None else result[0] for result in results),
        tuple(None if result is None else result[1] for result in results),
    )


def _predict_one(
    trained: Trained, one: FitTrial, trial: Trial, noise: CampaignNoise
) -> tuple[TrialFit, float]:
    """Return a trial beside the prediction, and its whitened squares."""
    problem = trained.problem([one])
    p = problem.p

    def evaluate(own: FloatArray) -> tuple[FloatArray, FloatArray]:
        residual, jacobian = problem.evaluate(np.concatenate((trained.theta, own)))
        return residual, jacobian[:, p:]

    state = np.concatenate((trained.theta, np.zeros(problem.size - p)))
    bounds = (problem.bounds[0][p:], problem.bounds[1][p:])
    find_onsets(problem, state)
    turn_phases(problem, state)
    for _ in range(3):
        # Where the force jumps depends on the onset.
        problem.set_noise(noise.force, noise.height, problem.unsure(state, noise.blur))
        solution = minimise(evaluate, state[p:], bounds, tolerance=_TOLERANCE)
        state[p:] = solution.theta
    full = _every_height(one.full_rate, trial)
    whole = trained.problem([full])
    predicted = whole.predict(state, 0, directions=False)
    _, force_zero, height_zero = problem.own(state, 0)
    good = calm(full, predicted.force, noise.force)
    std = np.sqrt(np.diag(solution.covariance()))
    return TrialFit(
        name=one.name,
        force=Signal(full.middle[good], full.force[good] - force_zero),
        force_fitted=predicted.force[good],
        height=Signal(full.height_t, full.height - height_zero),
        height_fitted=predicted.height,
        values=MappingProxyType(
            {
                name: Estimate(float(value), float(error))
                if math.isfinite(error)
                else Estimate.unknown('nothing in this trial depends on it')
                for name, value, error in zip(problem.own_names(one), state[p:], std, strict=True)
            }
        ),
        set_aside=one.set_aside,
    ), solution.cost


def _every_height(full: FitTrial, trial: Trial) -> FitTrial:
    """Return a trial with each of its samples of the displacement height by itself."""
    record = trial.displacement_height
    if record is None or not full.height_t.size:
        return full
    record = record.between(full.samples.edges[0], full.samples.edges[-1])
    good = ~np.isin(record.t, full.heights_aside)
    return replace(
        full,
        height_t=record.t[good],
        height=record.value[good],
        height_count=np.ones(int(np.count_nonzero(good))),
    )


def conditions(campaign: Sequence[Segmented]) -> tuple[tuple[int, ...], ...]:
    """
    Return which trials repeat the same push.

    Parameters
    ----------
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials.

    Returns
    -------
    tuple of (tuple of int)
        Indices of the trials whose speed and depth are within 10 % of the first one of theirs, and
        the times of their steps, if they have any; the depth of a push that never ends is that at
        its end, and a trial whose speed or depth is unknown stands alone. Each trial alone where
        all would be one condition.

    """
    groups = _pushes(campaign)
    if len(groups) == 1:
        return tuple((index,) for index in groups[0])
    return tuple(tuple(group) for group in groups)


def are_repeats(campaign: Sequence[Segmented]) -> bool:
    """Return whether all trials repeat one push, so that each alone is left out in turn."""
    return len(_pushes(campaign)) == 1


def _pushes(campaign: Sequence[Segmented]) -> list[list[int]]:
    groups: list[list[int]] = []
    firsts: list[tuple[float, ...] | None] = []
    for index, (_, phases) in enumerate(pairs_of(campaign)):
        push = (
            None
            if phases.push_speed is None or phases.reach is None
            else (phases.push_speed, phases.reach, *phases.in_steps)
        )
        for group, first in zip(groups, firsts, strict=True):
            if push is not None and first is not None and _alike(push, first):
                group.append(index)
                break
        else:
            groups.append([index])
            firsts.append(push)
    return groups


def _alike(push: tuple[float, ...], other: tuple[float, ...]) -> bool:
    """Return whether speeds, depths and times are within a tenth of each other."""
    return len(push) == len(other) and all(
        abs(a - b) <= _ALIKE * max(abs(a), abs(b)) for a, b in zip(push, other, strict=True)
    )


def refit_without(
    fit: Fit, campaign: Sequence[Segmented], left_out: Collection[int]
) -> Trained | None:
    """
    Fit the parameters of a model again, from where they are, without some trials.

    The noise stays as the whole campaign has told it: it only weights the samples.

    Parameters
    ----------
    fit : Fit
        The fit to all trials.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials.
    left_out : collection of int
        Indices of the trials to leave out.

    Returns
    -------
    Trained or None
        What the others tell; None where none is left.

    """
    used = [index for index, one in enumerate(fit.trials) if one is not None]
    kept = [place for place, index in enumerate(used) if index not in left_out]
    if not kept:
        return None
    whole = fit.problem
    problem = Problem(fit.model, [whole.trials[place] for place in kept], whole.scatter)
    state = np.concatenate([fit.theta, *(fit.state[whole.places[place]] for place in kept)])
    for _ in range(3):
        # Where the force jumps, and so what a sample weighs, is seen by the others alone.
        jumps = problem.unsure(state, fit.noise.blur)
        problem.set_noise(fit.noise.force, fit.noise.height, jumps)
        state = problem.search(state, tolerance=_TOLERANCE).theta
    return replace(Trained.of(fit, campaign), theta=state[: problem.p].copy())


type Refit = Callable[[Collection[int]], Sequence[Trained] | None]
"""From the indices of the trials that are left out to the models that the others tell."""


def leave_one_condition_out(
    campaign: Sequence[Segmented],
    refit: Refit,
    prepared: Sequence[FitTrial | None],
    noise: CampaignNoise,
    *,
    progress: Callable[[str], None] | None = None,
    workers: int = 1,
) -> tuple[Unseen, ...]:
    """
    Predict each condition of the push by models that have not seen it.

    Parameters
    ----------
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials.
    refit : callable
        Returns the models to compare, always as many, fitted without some trials. All that the
        models owe to the data has to happen in it, the choice of effects too, if the errors are
        to be those of trials that nothing has seen.
    prepared : sequence of (FitTrial or None)
        The trials in the form of the fit.
    noise : CampaignNoise
        What all models are weighted by.
    progress : callable, optional
        Told of each condition that is done.
    workers : int
        Processors.

    Returns
    -------
    tuple of Unseen
        For each model, all trials; None for those that no model could be fitted without.

    """
    pairs = pairs_of(campaign)
    groups = [
        group
        for group in conditions(campaign)
        if any(prepared[index] is not None for index in group)
    ]

    def predicted(group: Sequence[int]) -> list[dict[int, tuple[TrialFit, float]]]:
        """Return the trials of a condition beside each model."""
        usable = [(index, one) for index in group if (one := prepared[index]) is not None]
        return [
            {index: _predict_one(trained, one, pairs[index][0], noise) for index, one in usable}
            for trained in refit(group) or ()
        ]

    results: list[dict[int, tuple[TrialFit, float]]] = []
    what = 'repeats' if are_repeats(campaign) else 'conditions of the push'
    for count, found in enumerate(parallel.each(predicted, groups, workers), start=1):
        if progress is not None:
            progress(f'left out {count} of {len(groups)} {what}')
        for number, one in enumerate(found):
            if number == len(results):
                results.append({})
            results[number] |= one
    return tuple(
        Unseen(
            tuple(found[i][0] if i in found else None for i in range(len(pairs))),
            tuple(found[i][1] if i in found else None for i in range(len(pairs))),
        )
        for found in results
    )


def prepared_of(fit: Fit) -> tuple[FitTrial | None, ...]:
    """Return the trials of a fit in its form, as it has cleaned them."""
    used = iter(fit.problem.trials)
    return tuple(None if one is None else next(used) for one in fit.trials)


def held_out_change(before: Unseen, after: Unseen) -> HeldOutChange | None:
    """
    Return by how much the error on unseen trials changes from one model to the other.

    Parameters
    ----------
    before, after : Unseen
        The same trials, weighted by the same noise.

    Returns
    -------
    HeldOutChange or None
        None where no trial could be compared.

    """
    both = [
        (old, new)
        for old, new in zip(before.squares, after.squares, strict=True)
        if old is not None and new is not None
    ]
    if not both:
        return None
    old, new = np.array(both).T
    change = new - old
    std = float(np.std(change, ddof=1)) / math.sqrt(change.size) if change.size > 1 else 0.0
    return HeldOutChange(float(new.sum() / old.sum()), float(change.mean()), std)
