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
From trials to parameters: what the fitter node and the command line both call.

Both give the same numbers because both run this and nothing else. `analyse` takes one trial by
itself, by the paper's method; `analyse_campaign` fits one model to all trials together, looks for
what it lacks, and measures how far either model misses the trials. What only the latter needs is
imported in its functions, since the fitter node starts with this module.
"""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from types import MappingProxyType
from typing import Final, Literal, TYPE_CHECKING

from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.fit.noise import estimate_noise, Noise, pool_noise
from hapticvision_ros.core.fit.paper import fit_paper, PaperResult
from hapticvision_ros.core.records import Estimate, Segmentation, Trial
from hapticvision_ros.core.segmentation import segment
import numpy as np

if TYPE_CHECKING:
    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.diagnosis.records import (
        Channel,
        Diagnosis,
        ErrorChanges,
        HeldOutChange,
        Leftovers,
        Misfits,
    )
    from hapticvision_ros.core.fit.campaign import Fit, TrialFit
    from hapticvision_ros.core.fit.held_out import Unseen

type Progress = Callable[[str], None]
"""Told what is being done, in a few words."""

type HeldOutBy = Literal['name', 'condition']
"""Whether trials were named to be held out, or each condition of the push was left out in turn."""

MODEL_FIXED: Final = 'the model was fixed, so nothing was looked for that it may lack'
TOLD_BY_THE_TOOL: Final = (
    "The displacement height is what the tool reads while it is down: it is taken for the tool's "
    'own, which tells nothing of the surface where the tool is not on it.'
)
_SAME: Final = 1e-6
"""Part of the tool's way by which what is copied may differ."""
_MOST_OTHERS: Final = 0.01
"""Part of the heights of a tool that is down that may be no copies."""
_FEWEST_ON_THE_WAY: Final = 16
"""Copies of a tool that moves, at least."""
_RECOVERS: Final = 4
"""Heights after the last copy, from which on the surface is seen to come back."""
CHANNEL_NAMES: Final[Mapping['Channel', str]] = MappingProxyType(
    {'force': 'force', 'height': 'displacement height'}
)
_BY_CHANCE: Final = 2.0
_NO_RISE: Final = 1.01
"""Standard errors, and of a single trial the ratio, up to which held-out squares may rise."""
_MISSED: Final = 1.5
_UNSEEN: Final = 2.0
"""Misfit over the noise, and mean squares of unseen samples over fitted ones, that are told."""
_OUTLYING: Final = 10.0
_FEWEST_ALIKE: Final = 3
"""Mean squares of one trial over the median of the others that are told, and trials for that."""
_UNLIKELY: Final = 1e-3
"""Chance of a trial that differs by more than trials scatter, that is told."""
NOTHING_ADDED: Final = 'no effect was added to the base model, so there is no model after'


@dataclass(frozen=True, slots=True)
class TrialAnalysis:
    """
    What one trial tells by itself.

    Parameters
    ----------
    trial : Trial
        What was measured.
    segmentation : Segmentation
        Its phases.
    paper : PaperResult
        The parameters by the paper's method.
    noise : Noise
        Of one sample of force and of displacement height.

    """

    trial: Trial
    segmentation: Segmentation
    paper: PaperResult
    noise: Noise

    @property
    def warnings(self) -> tuple[str, ...]:
        """Return all that a reader of the numbers must know, from the file to the fit."""
        return self.trial.warnings + self.segmentation.warnings + self.paper.warnings


@dataclass(frozen=True, slots=True)
class FittedModel:
    """
    A model fitted to a campaign, and how far it misses the trials.

    Parameters
    ----------
    model : Model
        The model.
    parameters : mapping of str to Estimate
        Its shared parameters in SI units, by name.
    fit : Fit or None
        The fit; None where no trial could be fitted.
    trials : tuple of (TrialFit or None)
        Each trial of the campaign beside the model; None where it could not be used.
    unseen : tuple of (TrialFit or None)
        Each trial that was named to be held out, beside the prediction.
    train : Misfits or None
        How far the model misses the trials that it was fitted to.
    held_out : Misfits or None
        How far it misses trials that its parameters have not seen.
    left : Leftovers or None
        What it leaves of the trials that it was fitted to, beside the noise of the sensors.

    """

    model: 'Model'
    parameters: Mapping[str, Estimate]
    fit: 'Fit | None'
    trials: 'tuple[TrialFit | None, ...]'
    unseen: 'tuple[TrialFit | None, ...]'
    train: 'Misfits | None'
    held_out: 'Misfits | None'
    left: 'Leftovers | None' = None

    @property
    def units(self) -> Mapping[str, str]:
        """Return the SI unit of each parameter."""
        return dict(zip(self.model.names, self.model.units, strict=True))


@dataclass(frozen=True, slots=True)
class CampaignAnalysis:
    """
    What several trials on one object tell together.

    Parameters
    ----------
    trials : tuple of TrialAnalysis
        The trials that the models were fitted to.
    held_out : tuple of TrialAnalysis
        The trials that were named to be held out.
    noise : Noise
        Of one sample, to which chi squared refers.
    before : FittedModel
        The base three-element model.
    after : FittedModel or None
        The model with effects; None without any.
    diagnosis : Diagnosis or None
        What the base model lacks; None where the model was fixed or nothing could be fitted.
    held_out_by : HeldOutBy or None
        How the held-out errors came about; None without any.
    change : HeldOutChange or None
        By how much `after` changes the error on the held-out trials.
    changes : ErrorChanges or None
        The same by channel, phase and trial.
    warnings : tuple of str
        What holds for all trials together.

    """

    trials: tuple[TrialAnalysis, ...]
    held_out: tuple[TrialAnalysis, ...]
    noise: Noise
    before: FittedModel
    after: FittedModel | None
    diagnosis: 'Diagnosis | None'
    held_out_by: HeldOutBy | None
    change: 'HeldOutChange | None'
    changes: 'ErrorChanges | None'
    warnings: tuple[str, ...]


def analyse(trial: Trial) -> TrialAnalysis:
    """
    Segment one trial and estimate its parameters by the paper's method.

    Displacement heights of clouds whose surface is not where the force tells that the tool
    presses are left out, with a warning. Heights that are the tool's own count as such.
    """
    trial = _told_by_the_tool(trial)
    segmentation = segment(trial.force, trial.tool_height, trial.displacement_height)
    pressed = _without_another_surface(trial, segmentation)
    if pressed is not trial:
        trial, segmentation = pressed, segment(pressed.force, pressed.tool_height)
    return TrialAnalysis(
        trial=trial,
        segmentation=segmentation,
        paper=fit_paper(trial, segmentation),
        noise=estimate_noise(trial, segmentation),
    )


def _told_by_the_tool(trial: Trial) -> Trial:
    """
    Return a trial whose heights are known to be the tool's, if they are.

    A height that copies the encoders below the original surface, noise and all, is no second
    sensor: beside the tool it would have no error but that of the path that is laid through them.
    """
    heights = trial.displacement_height
    if trial.displacement_source != 'topic' or heights is None:
        return trial
    if min(len(heights), len(trial.tool_height)) < _FEWEST_ON_THE_WAY:
        return trial
    tool = trial.tool_height.at(heights.t)
    # One reading far off is no way.
    same = _SAME * float(np.ptp(np.quantile(tool, [0.01, 0.99])))
    down = np.abs(heights.value - heights.value[0]) > same
    level = heights.value + tool
    copied = down & (np.abs(level - np.median(level[down])) <= same) if down.any() else down
    moves = np.append(np.abs(np.diff(tool)) > same, False)
    if np.count_nonzero(copied & moves) < _FEWEST_ON_THE_WAY:
        return trial
    others = np.flatnonzero(down & ~copied)
    after = np.count_nonzero(others > np.flatnonzero(copied)[-1])
    if others.size > _MOST_OTHERS * np.count_nonzero(down) or after >= _RECOVERS:
        return trial
    return replace(
        trial,
        displacement_source='tool',
        warnings=(*trial.warnings, TOLD_BY_THE_TOOL),
    )


def _without_another_surface(trial: Trial, segmentation: Segmentation) -> Trial:
    """
    Return a trial without the heights of clouds that show another surface than the tool touches.

    Where the tool hides the contact point in each cloud, none tells its original height; the
    force does.
    """
    heights, touched = trial.displacement_height, segmentation.contact_height
    if trial.displacement_source != 'points' or heights is None or touched is None:
        return trial
    from hapticvision_ros.core.displacement import ELSEWHERE, is_elsewhere

    if not is_elsewhere(heights.value, touched - trial.tool_height.at(heights.t)):
        return trial
    return replace(
        trial,
        displacement_height=None,
        displacement_source='none',
        warnings=(*trial.warnings, ELSEWHERE),
    )


def analyse_campaign(
    trials: Sequence[TrialAnalysis],
    held_out: Sequence[TrialAnalysis] = (),
    *,
    model: 'Model | None' = None,
    progress: Progress | None = None,
    workers: int = 1,
    bootstrap: int = 0,
    limits: Mapping[str, float] = MappingProxyType({}),
) -> CampaignAnalysis:
    """
    Fit the base model to several analysed trials, and the model that has what it lacks.

    Parameters
    ----------
    trials : sequence of TrialAnalysis
        At least one trial to fit.
    held_out : sequence of TrialAnalysis
        Trials that are only predicted. Without any, and with two trials or more, each condition of
        the push is left out in turn.
    model : Model, optional
        The model to fit beside the base model; without it the base model is diagnosed.
    progress : callable, optional
        Told what is being done.
    workers : int
        Processors.
    bootstrap : int, default 0
        Campaigns without an effect that are simulated to tell what chance does in the diagnosis.
    limits : mapping of str to float
        Those limits of the cell for the next push that are known, by the names of
        `hapticvision_ros.core.diagnosis.design.PushLimits`; near what was done by default.

    Returns
    -------
    CampaignAnalysis
        Both models, and how far they miss seen and unseen trials.

    """
    from hapticvision_ros.core.composition import Model

    tell = _say_nothing if progress is None else progress
    trials = _named_apart(trials)
    try:
        before, after, diagnosis, warnings = _fits(trials, model, tell, workers, bootstrap, limits)
    except UsageError as error:
        return _nothing_fitted(trials, held_out, Model(), str(error))
    if diagnosis is not None and diagnosis.late:
        trials, held_out = (_earlier(each, diagnosis.late) for each in (trials, held_out))
    return _compared(trials, held_out, before, after, diagnosis, warnings, tell, workers)


def _named_apart(trials: Sequence[TrialAnalysis]) -> list[TrialAnalysis]:
    """Return trials of which no two have one name, by which those left out are known."""
    seen = Counter[str]()
    made = []
    for one in trials:
        seen[one.trial.name] += 1
        if seen[one.trial.name] > 1:
            name = f'{one.trial.name} ({seen[one.trial.name]})'
            one = replace(one, trial=replace(one.trial, name=name))
        made.append(one)
    return made


def _earlier(trials: Sequence[TrialAnalysis], late: float) -> list[TrialAnalysis]:
    """Return trials whose tool heights have earlier stamps."""
    from hapticvision_ros.core.diagnosis.search import earlier

    pairs = [(each.trial, each.segmentation) for each in trials]
    return [analyse(trial) for trial, _ in earlier(pairs, late)]


def _fits(
    trials: Sequence[TrialAnalysis],
    model: 'Model | None',
    tell: Progress,
    workers: int,
    campaigns: int,
    limits: Mapping[str, float],
) -> 'tuple[Fit, Fit | None, Diagnosis | None, list[str]]':
    """Return the base fit, that with effects, what was found, and what to know of it."""
    from hapticvision_ros.core.composition import Model
    from hapticvision_ros.core.fit.campaign import fit

    if model is None:
        from hapticvision_ros.core.diagnosis.design import PushLimits
        from hapticvision_ros.core.diagnosis.search import diagnose

        reach = None
        if limits:
            reach = PushLimits.like([each.segmentation for each in trials], limits)
        found = diagnose(trials, progress=tell, workers=workers, limits=reach)
        if campaigns:
            from hapticvision_ros.core.diagnosis.bootstrap import bootstrap
            from hapticvision_ros.core.fit.campaign import pairs_of

            looked_at = _earlier(trials, found.late) if found.late else trials
            used = [
                phases
                for (_, phases), fitted in zip(
                    pairs_of(looked_at), found.before.trials, strict=True
                )
                if fitted is not None
            ]
            chance = bootstrap(found, used, campaigns, progress=tell, workers=workers)
            found = replace(found, bootstrap=chance)
        told = list(found.warnings)
        if found.effects:
            return found.before, found.after, found, told
        return found.before, None, found, [*told, NOTHING_ADDED]
    tell(f'fitting the {Model().name} model')
    before = fit(trials, Model())
    if not model.effects:
        return before, None, None, [MODEL_FIXED]
    tell(f'fitting the {model.name} model')
    try:
        return before, fit(trials, model), None, [MODEL_FIXED]
    except UsageError as error:
        return before, None, None, [MODEL_FIXED, str(error).rstrip('.')]


def _compared(
    trials: Sequence[TrialAnalysis],
    held_out: Sequence[TrialAnalysis],
    before: 'Fit',
    after: 'Fit | None',
    diagnosis: 'Diagnosis | None',
    warnings: Sequence[str],
    tell: Progress,
    workers: int,
) -> CampaignAnalysis:
    """Return the analysis with how far the models miss the trials."""
    from hapticvision_ros.core.fit.change import error_changes
    from hapticvision_ros.core.fit.held_out import (
        are_repeats,
        fitted_trials,
        held_out_change,
        misfits,
        sample_noise,
    )
    from hapticvision_ros.core.fit.lack_of_fit import lack_of_fit, sensor_noise

    fits = [before] if after is None else [before, after]
    seen = [fitted_trials(one, trials) for one in fits]
    noise = sample_noise(fits[-1], seen[-1], trials)
    quiet = sensor_noise(fits[-1], trials, noise)
    told = list(warnings)
    if held_out:
        tell('predicting the trials held out')
        by: HeldOutBy | None = 'name'
        unseen, against = _predicted(trials, held_out, fits), held_out
    else:
        by, against, unseen = 'condition', trials, list['Unseen']()
        if len(trials) > 1:
            what = 'repeat' if are_repeats(trials) else 'condition of the push'
            tell(f'leaving out each {what} in turn')
            unseen = _left_out(trials, fits, diagnosis, tell, workers)
    errors = [misfits(one.trials, against, noise) for one in unseen]
    if not any(errors):
        by, errors, unseen = None, [None] * len(fits), []
        told.append(_why_nothing_is_held_out(trials, held_out))
    for one in unseen[:1]:
        told += one.warnings
    change = changes = None
    if len(unseen) > 1:
        change = held_out_change(*unseen)
        changes = error_changes(unseen[0].trials, unseen[1].trials, against, noise, quiet)
    if diagnosis is not None and after is not None and change is not None:
        names = ', '.join(diagnosis.effects)
        # Of a single trial nothing tells by how much the squares differ by chance.
        rises = change.change > _BY_CHANCE * change.std
        if rises and (change.std > 0.0 or change.ratio > _NO_RISE):
            told.append(
                f'a contradiction: {names} explains the fitted trials, yet on unseen ones the '
                f'squares grow by a factor of {change.ratio:.3g}'
            )
    if change is not None and not change.std:
        told.append(
            'how far the change of the squares on unseen trials may be by chance is unknown: '
            'it takes two trials or more'
        )
    for symbol, estimate in (('force', noise.force), ('height', noise.height)):
        if estimate.reason is not None:
            told.append(f'the noise of the {symbol} is unknown: {estimate.reason}')
    models = [
        FittedModel(
            model=one.model,
            parameters=one.parameters,
            fit=one,
            trials=beside,
            unseen=unseen[index].trials if by == 'name' else (),
            train=misfits(beside, trials, noise),
            held_out=errors[index],
            left=lack_of_fit(one, trials, quiet),
        )
        for index, (one, beside) in enumerate(zip(fits, seen, strict=True))
    ]
    if diagnosis is not None:
        told += _passed_for_noise(models[-1], diagnosis)
    told += _stands_out(models[-1])
    told += _worse_unseen(models[-1], held_out)
    return CampaignAnalysis(
        trials=tuple(trials),
        held_out=tuple(held_out),
        noise=noise,
        before=models[0],
        after=None if after is None else models[1],
        diagnosis=diagnosis,
        held_out_by=by,
        change=change,
        changes=changes,
        warnings=tuple(dict.fromkeys((*told, *_of_models(fits)))),
    )


def _passed_for_noise(model: 'FittedModel', diagnosis: 'Diagnosis') -> list[str]:
    """Return which channels are missed by more than their noise though nothing is said to lack."""
    if model.train is None or model.fit is None or diagnosis.unexplained is not None:
        return []
    told = []
    for channel, name in CHANNEL_NAMES.items():
        seen = model.train.total.get(channel)
        if seen is None or seen.chi2 is None or seen.chi2 < _MISSED**2:
            continue
        # Where the record shows the noise before contact the fit has said so.
        if not any(f'misses the {name.split()[-1]} by' in each for each in model.fit.warnings):
            told.append(
                f'the {model.model.name} model misses the {name} by {math.sqrt(seen.chi2):.3g} '
                'times its noise, which has passed for slow noise: it may lack more than was '
                'found (a long record of the sensors without contact would tell)'
            )
    return told


def _worse_unseen(model: 'FittedModel', held_out: Sequence[TrialAnalysis]) -> list[str]:
    """Return which channels the model misses by far more where it has not seen the trials."""
    if model.train is None or model.held_out is None:
        return []
    told = _another_object(model)
    for channel, name in CHANNEL_NAMES.items():
        seen, left_out = model.train.total.get(channel), model.held_out.total.get(channel)
        if seen is None or left_out is None or seen.chi2 is None or left_out.chi2 is None:
            continue
        fitted, unseen = seen.chi2, left_out.chi2
        if unseen < _UNSEEN * max(fitted, 1.0):
            continue
        where = (
            f'the trials held out ({", ".join(one.trial.name for one in held_out)})'
            if held_out
            else 'conditions that it has not seen'
        )
        told.append(
            f'a contradiction: on {where} the {model.model.name} model misses the {name} by '
            f'{math.sqrt(unseen):.3g} times its noise, and by {math.sqrt(fitted):.3g} times where '
            'it was fitted: they are of another object or way to push, or what acts there does '
            'not show in the fitted ones'
        )
    return told


def _another_object(model: 'FittedModel') -> list[str]:
    """
    Return which trials held out differ from the fitted ones by more than these scatter.

    What is missed does not tell it: a trial has K1, C1 and C2 of its own where trials scatter.
    """
    assert model.fit is not None
    scatter = model.fit.problem.scatter
    degrees = scatter.size * (len(model.fit.problem.trials) - 1)
    if not degrees:
        return []
    from scipy.special import fdtri

    # As well as scatter is known from so many trials.
    most = scatter.size * float(fdtri(scatter.size, degrees, 1.0 - _UNLIKELY))
    names = model.model.names[: scatter.size]
    told = []
    for one in model.unseen:
        if one is None:
            continue
        own = [one.values[f'scatter of {name}'].value or 0.0 for name in names]
        if float(np.sum((np.array(own) / scatter) ** 2)) < most:
            continue
        sizes = ', '.join(
            f'{100.0 * math.expm1(size):+.2g} % in {name}'
            for size, name in zip(own, names, strict=True)
        )
        told.append(
            f'a contradiction: {one.name}, held out, differs from the fitted trials by {sizes}, '
            'which is more than these scatter: it is of another object or way to push'
        )
    return told


def _stands_out(model: 'FittedModel') -> list[str]:
    """Return which trial the model misses by far more than the others, by channel."""
    if model.train is None:
        return []
    told = []
    for channel, name in CHANNEL_NAMES.items():
        missed = {
            trial: one.chi2
            for (trial, of), one in model.train.by_trial.items()
            if of == channel and one.chi2 is not None
        }
        if len(missed) < _FEWEST_ALIKE:
            continue
        worst = max(missed, key=missed.__getitem__)
        usual = float(np.median([chi2 for trial, chi2 in missed.items() if trial != worst]))
        if missed[worst] < _OUTLYING * max(usual, 1.0):
            continue
        told.append(
            f'{worst} stands out: the {model.model.name} model misses its {name} by '
            f'{math.sqrt(missed[worst]):.3g} times the noise, and that of the other trials by '
            f'{math.sqrt(usual):.3g} times (median): if it is no push like them, leave it out'
        )
    return told


def _of_models(fits: 'Sequence[Fit]') -> list[str]:
    """Return what the fits warn of; what not all say, with which one says it."""
    said = []
    for one in fits:
        doubtful = [
            f'{name} with caution: {estimate.reason}'
            for name, estimate in one.parameters.items()
            if estimate.known and estimate.reason is not None
        ]
        said.append([*one.warnings, *doubtful])
    shared = [warning for warning in said[0] if all(warning in each for each in said)]
    return shared + [
        f'{which}: {warning}'
        for which, each in zip(('before', 'after'), said, strict=False)
        for warning in each
        if warning not in shared
    ]


def _predicted(
    trials: Sequence[TrialAnalysis], held_out: Sequence[TrialAnalysis], fits: 'Sequence[Fit]'
) -> 'list[Unseen]':
    """Return the trials held out beside what each fit says of them."""
    from hapticvision_ros.core.fit.held_out import predict_unseen, Trained

    return [
        predict_unseen(Trained.of(one, trials), held_out, noise=fits[-1].noise) for one in fits
    ]


def _left_out(
    trials: Sequence[TrialAnalysis],
    fits: 'Sequence[Fit]',
    diagnosis: 'Diagnosis | None',
    tell: Progress,
    workers: int,
) -> 'list[Unseen]':
    """Return each trial beside what models say of it that have not seen it."""
    from collections.abc import Collection

    from hapticvision_ros.core.fit.held_out import (
        leave_one_condition_out,
        prepared_of,
        refit_without,
        Trained,
    )

    def refit(left_out: Collection[int]) -> list[Trained]:
        trained = [refit_without(one, trials, left_out) for one in fits]
        if diagnosis is not None and len(fits) > 1:
            from hapticvision_ros.core.diagnosis.search import choose_again

            names = {trials[index].trial.name for index in left_out}
            chosen = choose_again(diagnosis, names)
            if chosen is not None and trained[-1] is not None:
                trained[-1] = replace(trained[-1], model=chosen.model, theta=chosen.theta)
        return [one for one in trained if one is not None]

    prepared = prepared_of(fits[-1])
    noise = fits[-1].noise
    return list(
        leave_one_condition_out(trials, refit, prepared, noise, progress=tell, workers=workers)
    )


def _why_nothing_is_held_out(
    trials: Sequence[TrialAnalysis], held_out: Sequence[TrialAnalysis]
) -> str:
    """Return why there is no error on unseen trials."""
    if held_out:
        return 'the error on unseen trials is unknown: none of those held out could be used'
    if len(trials) == 1:
        return 'nothing is held out: the error on unseen trials needs more trials than one'
    return 'nothing is held out: the error on unseen trials needs more than one usable trial'


def _nothing_fitted(
    trials: Sequence[TrialAnalysis],
    held_out: Sequence[TrialAnalysis],
    model: 'Model',
    why: str,
) -> CampaignAnalysis:
    """Return an analysis in which everything that a fit tells is unknown."""
    reason = 'no trial could be fitted'
    noise = pool_noise([trial.noise for trial in trials])
    warnings = [why.rstrip('.'), _why_nothing_is_held_out(trials, held_out)]
    for symbol, estimate in (('force', noise.force), ('height', noise.height)):
        if estimate.reason is not None:
            warnings.append(f'the noise of the {symbol} is unknown: {estimate.reason}')
    unknown = MappingProxyType(dict.fromkeys(model.names, Estimate.unknown(reason)))
    nothing = FittedModel(
        model, unknown, None, (None,) * len(trials), (None,) * len(held_out), None, None
    )
    warnings += [f'{name} is unknown: {reason}' for name in model.names]
    return CampaignAnalysis(
        tuple(trials),
        tuple(held_out),
        noise,
        nothing,
        after=None,
        diagnosis=None,
        held_out_by=None,
        change=None,
        changes=None,
        warnings=tuple(warnings),
    )


def _say_nothing(what: str) -> None:
    """Tell nobody."""
