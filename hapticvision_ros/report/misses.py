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

"""How far the models miss each trial, in numbers and in plain words."""

from collections.abc import Mapping
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.composition import BASE
from hapticvision_ros.core.diagnosis.records import Channel, Misfit
from hapticvision_ros.core.fit.campaign import TrialFit
from hapticvision_ros.core.fit.held_out import are_repeats, labels, PHASES, residuals
from hapticvision_ros.core.pipeline import (
    CampaignAnalysis,
    CHANNEL_NAMES,
    FittedModel,
    TrialAnalysis,
)
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.report.quantities import (
    Dimension,
    format_number,
    format_quantity,
    SI_UNITS,
    UnitSystem,
)

ROUGH: Final = 2
"""Digits of a misfit: it is a size, not a measurement."""
DIMENSIONS: Final[Mapping[Channel, Dimension]] = {'force': 'force', 'height': 'length'}
IN_CONTACT: Final = ('push', 'hold')


@dataclass(frozen=True, slots=True)
class Beside:
    """
    One trial beside a model.

    Parameters
    ----------
    model : FittedModel
        The model.
    trial : TrialFit
        What it says of the trial.
    misfit : mapping of Channel to Misfit
        How far it misses each channel.

    """

    model: FittedModel
    trial: TrialFit
    misfit: Mapping[Channel, Misfit]


@dataclass(frozen=True, slots=True)
class Shown:
    """
    One trial as the report shows it.

    Parameters
    ----------
    analysis : TrialAnalysis
        The trial.
    held_out : bool
        Whether it was named to be held out of the fit.
    before, after : Beside or None
        The trial beside the base model and the one with effects; None where either is not there
        or could not be compared.

    """

    analysis: TrialAnalysis
    held_out: bool
    before: Beside | None
    after: Beside | None


def shown(campaign: CampaignAnalysis) -> list[Shown]:
    """Return all trials of a campaign beside its models, those held out last."""
    models = (campaign.before, campaign.after)
    found = []
    for held_out in (False, True):
        analyses = campaign.held_out if held_out else campaign.trials
        for index, label in enumerate(labels(analyses)):
            before, after = (
                None if model is None else _beside(model, label, index, held_out)
                for model in models
            )
            found.append(Shown(analyses[index], held_out, before, after))
    return found


def _beside(model: FittedModel, label: str, index: int, held_out: bool) -> Beside | None:
    """Return a trial beside a model, if the model says anything of it."""
    trials = model.unseen if held_out else model.trials
    errors = model.held_out if held_out else model.train
    trial = trials[index] if index < len(trials) else None
    if trial is None or errors is None:
        return None
    channels: tuple[Channel, ...] = ('force', 'height')
    return Beside(
        model,
        trial,
        {c: errors.by_trial[label, c] for c in channels if (label, c) in errors.by_trial},
    )


def short_name(fitted: FittedModel) -> str:
    """Return a model's name as it fits a sentence: with one effect at most by its name."""
    effects = fitted.model.effects
    return fitted.model.name if len(effects) < 2 else f'{BASE} with {len(effects)} effects'


def size_text(misfit: Misfit, channel: Channel, units: UnitSystem) -> str:
    """Return the size of a misfit in its unit, and in percent of the measured range."""
    size = format_quantity(misfit.rmse, units[DIMENSIONS[channel]], digits=ROUGH)
    if misfit.percent_of_range is None:
        return size
    share = format_number(misfit.percent_of_range, digits=ROUGH)
    return f'{size} ({share}\u00a0% of its range)'


def verdicts(campaign: CampaignAnalysis, units: UnitSystem = SI_UNITS) -> list[str]:
    """
    Return one plain sentence a trial on how far the models miss it.

    Parameters
    ----------
    campaign : CampaignAnalysis
        The trials and the fits.
    units : mapping of str to Unit
        Units of display.

    Returns
    -------
    list of str
        In the order of the trials, those held out last.

    """
    return [_verdict(one, campaign, units) for one in shown(campaign)]


def _verdict(one: Shown, campaign: CampaignAnalysis, units: UnitSystem) -> str:
    name = one.analysis.trial.name + (' (held out)' if one.held_out else '')
    if one.before is None or 'force' not in one.before.misfit:
        return f'{name}: the three-element model could not be compared with this trial.'
    miss = one.before.misfit['force']
    text = f'the three-element model misses the force by {size_text(miss, "force", units)}'
    part = residuals(one.before.trial, one.analysis.segmentation.entire, 'force')
    sizes = [
        (phase, part.residual[part.phase == index])
        for index, phase in enumerate(PHASES)
        if phase in IN_CONTACT
    ]
    phases = [
        f'{format_quantity(_rms(each), units["force"], digits=ROUGH)} in the {phase}'
        for phase, each in sizes
        if each.size
    ]
    if len(phases) > 1:
        text += f': {" and ".join(phases)}'
    noise = campaign.noise.force.value
    if noise:
        text += f', {format_number(miss.rmse / noise, digits=ROUGH)} times the noise of a sample'
    if one.after is not None and 'force' in one.after.misfit:
        text += f'; {short_name(one.after.model)} by '
        text += size_text(one.after.misfit['force'], 'force', units)
    return f'{name}: {text}.'


def _rms(residual: FloatArray) -> float:
    return math.sqrt(float(residual @ residual) / residual.size)


def held_out_sentences(campaign: CampaignAnalysis, units: UnitSystem = SI_UNITS) -> list[str]:
    """Return how far the models miss trials that their parameters have not seen."""
    before = campaign.before.held_out
    if before is None:
        return []
    if campaign.held_out_by == 'name':
        how = 'On the trials held out'
    elif are_repeats(campaign.trials):
        how = 'On each trial in turn, predicted from the others of the same speed and depth,'
    else:
        how = 'On each speed and depth in turn, predicted from the others,'
    after = None if campaign.after is None else campaign.after.held_out
    sentences = []
    for channel, what in CHANNEL_NAMES.items():
        if channel not in before.total:
            continue
        text = f'{how} the three-element model misses the {what} by '
        text += size_text(before.total[channel], channel, units)
        if after is not None and campaign.after is not None and channel in after.total:
            text += f', {short_name(campaign.after)} by '
            text += size_text(after.total[channel], channel, units)
        sentences.append(f'{text}.')
    change = campaign.change
    if change is not None:
        ratio = format_number(change.ratio, digits=3)
        text = f'Weighted by the noise, the squares there become {ratio} times as large'
        if change.std > 0.0:
            size = format_number(change.change, change.std)
            text += f' (a change of {size} a trial, with its standard error over the trials)'
        sentences.append(f'{text}.')
    return sentences
