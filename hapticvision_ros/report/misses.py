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


"""How far the whole-waveform fit misses a trial, in numbers and in plain words."""

from collections.abc import Iterator
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.fit.waveform import Prediction
from hapticvision_ros.core.pipeline import CampaignAnalysis, TrialAnalysis
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.report.quantities import (
    format_number,
    format_quantity,
    SI_UNITS,
    UnitSystem,
)
import numpy as np

ROUGH: Final = 2
"""Digits of a misfit: it is a size, not a measurement."""


@dataclass(frozen=True, slots=True)
class Miss:
    """
    How far the model misses the force of a trial.

    Parameters
    ----------
    rmse : float
        Root mean square of measured minus fitted [N].
    share_of_peak : float or None
        The same over the largest force of the trial [-]; None where no force was measured.

    """

    rmse: float
    share_of_peak: float | None

    def text(self, units: UnitSystem) -> str:
        """Return the size in the unit of force, and in percent of the peak."""
        size = format_quantity(self.rmse, units['force'], digits=ROUGH)
        if self.share_of_peak is None:
            return size
        share = format_number(100.0 * self.share_of_peak, digits=ROUGH)
        return f'{size} ({share}\u00a0% of peak)'


def force_miss(prediction: Prediction) -> Miss:
    """Return how far the model misses the force of a trial over push and hold together."""
    rmse = _rms(prediction.force.value - prediction.force_fitted)
    # A phase that the model follows exactly does not tell the peak.
    peaks = [miss.rmse / miss.share_of_peak for miss in prediction.misses if miss.share_of_peak]
    return Miss(rmse, rmse / peaks[0] if peaks else None)


def height_miss(prediction: Prediction) -> float | None:
    """Return the root mean square by which the model misses the free recovery [m], if seen."""
    if prediction.height is None or prediction.height_fitted is None:
        return None
    return _rms(prediction.height.value - prediction.height_fitted)


def _rms(residual: FloatArray) -> float:
    return math.sqrt(float(np.mean(residual**2)))


def paired(
    campaign: CampaignAnalysis,
) -> Iterator[tuple[TrialAnalysis, Prediction | None, bool]]:
    """Yield each trial with its prediction and whether it was held out of the fit."""
    fit = campaign.before
    for analysis, prediction in zip(campaign.trials, fit.predictions, strict=True):
        yield analysis, prediction, False
    for analysis, prediction in zip(campaign.held_out, fit.held_out_predictions, strict=True):
        yield analysis, prediction, True


def verdicts(campaign: CampaignAnalysis, units: UnitSystem = SI_UNITS) -> list[str]:
    """
    Return one plain sentence a trial on how far the three-element model misses it.

    Parameters
    ----------
    campaign : CampaignAnalysis
        The trials and the fit.
    units : mapping of str to Unit
        Units of display.

    Returns
    -------
    list of str
        In the order of the trials, those held out last.

    """
    return [_verdict(*triple, units) for triple in paired(campaign)]


def _verdict(
    analysis: TrialAnalysis, prediction: Prediction | None, held_out: bool, units: UnitSystem
) -> str:
    name = analysis.trial.name + (' (held out)' if held_out else '')
    if prediction is None:
        return f'{name}: the three-element model could not be compared with this trial.'
    parts = [f'the three-element model misses the force by {force_miss(prediction).text(units)}']
    phases = [
        f'{format_quantity(miss.rmse, units["force"], digits=ROUGH)} in the {miss.phase}'
        for miss in prediction.misses
    ]
    if len(phases) > 1:
        parts.append(f': {" and ".join(phases)}')
    noise = analysis.noise.force.value
    if noise:
        times = format_number(force_miss(prediction).rmse / noise, digits=ROUGH)
        parts.append(f', {times} times the noise of a sample')
    return f'{name}: {"".join(parts)}.'
