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

Both give the same numbers because both run this and nothing else.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from hapticvision_ros.core.fit.noise import estimate_noise, Noise, pool_noise
from hapticvision_ros.core.fit.paper import fit_paper, PaperResult
from hapticvision_ros.core.fit.waveform import fit_waveform, ModelFit
from hapticvision_ros.core.records import Segmentation, Trial
from hapticvision_ros.core.segmentation import segment


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
class CampaignAnalysis:
    """
    What several trials on one object tell together.

    Parameters
    ----------
    trials : tuple of TrialAnalysis
        The trials that the model was fitted to.
    held_out : tuple of TrialAnalysis
        The trials that the fit has not seen.
    noise : Noise
        The median over `trials`.
    before : ModelFit
        The base three-element model, fitted to the force of push and hold of all `trials`.
    warnings : tuple of str
        What holds for all trials together.

    """

    trials: tuple[TrialAnalysis, ...]
    held_out: tuple[TrialAnalysis, ...]
    noise: Noise
    before: ModelFit
    warnings: tuple[str, ...]


def analyse(trial: Trial) -> TrialAnalysis:
    """Segment one trial and estimate its parameters by the paper's method."""
    segmentation = segment(trial.force, trial.tool_height, trial.displacement_height)
    return TrialAnalysis(
        trial=trial,
        segmentation=segmentation,
        paper=fit_paper(trial, segmentation),
        noise=estimate_noise(trial, segmentation),
    )


def analyse_campaign(
    trials: Sequence[TrialAnalysis], held_out: Sequence[TrialAnalysis] = ()
) -> CampaignAnalysis:
    """
    Fit the base model to several analysed trials and measure how far it misses them.

    Parameters
    ----------
    trials : sequence of TrialAnalysis
        At least one trial to fit.
    held_out : sequence of TrialAnalysis
        Trials that are only compared with.

    Returns
    -------
    CampaignAnalysis
        Without a diagnosis: this version does not look for what the model lacks.

    """
    noise = pool_noise([trial.noise for trial in trials])
    before = fit_waveform(
        [(trial.trial, trial.segmentation) for trial in trials],
        [(trial.trial, trial.segmentation) for trial in held_out],
        noise,
    )
    warnings = [
        'this version measures how far the three-element model misses the trials and does not '
        'diagnose why'
    ]
    if not held_out:
        warnings.append(
            'nothing is held out: the error on unseen trials needs more trials than one'
            if len(trials) == 1
            else 'nothing is held out: the error on unseen trials is unknown'
        )
    for symbol, estimate in (('force', noise.force), ('height', noise.height)):
        if estimate.reason is not None:
            warnings.append(f'the noise of the {symbol} is unknown: {estimate.reason}')
    return CampaignAnalysis(
        trials=tuple(trials),
        held_out=tuple(held_out),
        noise=noise,
        before=before,
        warnings=(*warnings, *before.warnings),
    )
