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


"""Each trial with its pictures and its own numbers."""

from collections.abc import Mapping
from typing import Final

from hapticvision_ros.core.fit.waveform import Prediction
from hapticvision_ros.core.pipeline import CampaignAnalysis, TrialAnalysis
from hapticvision_ros.report.cells import cell, optional
from hapticvision_ros.report.figure import Panel, svg
from hapticvision_ros.report.misses import force_miss, height_miss, paired, ROUGH
from hapticvision_ros.report.quantities import Dimension, format_quantity, UnitSystem
from hapticvision_ros.report.series import force_panel, height_panel

# Attribute of `PaperResult`, symbol and index, dimension, what it is, where it comes from.
QUANTITIES: Final[tuple[tuple[str, str, str, Dimension, str, str], ...]] = (
    ('K1', 'K', '1', 'stiffness', 'elastic coefficient', 'eq. (13) with H0'),
    ('C1', 'C', '1', 'viscosity', 'viscosity beside the spring', 'eq. (12)'),
    ('C2', 'C', '2', 'viscosity', 'viscosity in series', 'eq. (9)'),
    ('relaxation_time', 'τ', '', 'time', 'relaxation time', 'eq. (4)'),
    ('F0', 'F', '0', 'force', 'force that decays in the hold', 'eq. (4)'),
    ('F_inf', 'F', '∞', 'force', 'force that remains', 'eq. (4)'),
    ('retardation_time', 'γ', '', 'time', 'retardation time', 'eq. (10)'),
    ('H0', 'H', '0', 'length', 'bouncing deformation', 'eq. (10)'),
    ('H_inf', 'H', '∞', 'length', 'residual deformation', 'eq. (10)'),
)
# Attribute of `Segmentation`, symbol and index, what happens then.
INSTANTS: Final = (
    ('t_contact', 'T', 'c', 'first touch'),
    ('t_hold', 'T', 's', 'the tool stops'),
    ('t_release', 'T', 'e', 'the tool withdraws'),
    ('t_loss', 't', 'loss', 'contact is lost'),
)


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    return {
        'trials': [
            _trial(number, analysis, prediction, held_out, units)
            for number, (analysis, prediction, held_out) in enumerate(paired(campaign), start=1)
        ]
    }


def _trial(
    number: int,
    analysis: TrialAnalysis,
    prediction: Prediction | None,
    held_out: bool,
    units: UnitSystem,
) -> Mapping[str, object]:
    name = analysis.trial.name
    force = force_panel(analysis, prediction, units)
    height = height_panel(analysis, prediction, units)
    pictures = [_picture(force, name, f'{number}-force', _force_words(prediction, units))]
    if height is not None:
        pictures.append(
            _picture(height, name, f'{number}-height', _height_words(analysis, prediction, units))
        )
    phases, paper = analysis.segmentation, analysis.paper
    return {
        'number': number,
        'name': name,
        'held_out': held_out,
        'speed': optional(phases.push_speed, units['speed']).text,
        'depth': optional(phases.depth, units['length']).text,
        'instants': [
            (symbol, index, what, optional(getattr(phases, attribute), units['time']))
            for attribute, symbol, index, what in INSTANTS
        ],
        'quantities': [
            (symbol, index, what, where, cell(getattr(paper, attribute), units[dimension]))
            for attribute, symbol, index, dimension, what, where in QUANTITIES
        ],
        'pictures': pictures,
        'warnings': list(dict.fromkeys(analysis.warnings)),
    }


def _picture(panel: Panel, name: str, salt: str, caption: str) -> Mapping[str, str]:
    """Return a picture with its caption and what stands for it where it cannot be seen."""
    fits = ', '.join(series.label for series in panel.residuals) or 'no fit'
    phases = ', '.join(phase.name for phase in panel.phases)
    return {
        'svg': svg(panel, salt),
        'alt': f'{panel.quantity} of {name} against time, measured and fitted ({fits}), with the '
        f'phases {phases}, and the residuals below.',
        'caption': caption,
    }


def _force_words(prediction: Prediction | None, units: UnitSystem) -> str:
    words = 'Contact force against time; below, what the fits leave, and a grey band of two '
    words += 'standard deviations of the noise on either side.'
    if prediction is None:
        return words + ' The three-element model could not be compared with this trial.'
    return f'{words} The three-element model misses it by {force_miss(prediction).text(units)}.'


def _height_words(
    analysis: TrialAnalysis, prediction: Prediction | None, units: UnitSystem
) -> str:
    source = analysis.trial.displacement_source
    if source == 'none':
        return 'The displacement height was not recorded: only the tool is shown.'
    words = 'Displacement height against time, and what the fits of the free recovery leave.'
    if source == 'tool':
        words = (
            'Displacement against time: only the tool was recorded, which is the object where '
            'they touch.'
        )
    missed = None if prediction is None else height_miss(prediction)
    if missed is None:
        return words
    size = format_quantity(missed, units['length'], digits=ROUGH)
    return (
        f'{words} With the parameters of push and hold the three-element model misses the '
        f'recovery by {size}.'
    )
