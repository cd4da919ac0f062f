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

from hapticvision_ros.core.diagnosis.records import Channel
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.cells import cell, optional
from hapticvision_ros.report.figure import Panel, svg
from hapticvision_ros.report.misses import short_name, Shown, shown, size_text
from hapticvision_ros.report.quantities import Dimension, UnitSystem
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
            _trial(number, one, campaign.noise, units)
            for number, one in enumerate(shown(campaign), start=1)
        ]
    }


def _trial(number: int, one: Shown, noise: Noise, units: UnitSystem) -> Mapping[str, object]:
    analysis = one.analysis
    name = analysis.trial.name
    force = force_panel(one, noise.force.value, units)
    height = height_panel(one, noise.height.value, units)
    pictures = [_picture(force, name, _force_words(one, units))]
    if height is not None:
        pictures.append(_picture(height, name, _height_words(one, units)))
    phases, paper = analysis.segmentation, analysis.paper
    return {
        'number': number,
        'name': name,
        'held_out': one.held_out,
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


def _picture(panel: Panel, name: str, caption: str) -> Mapping[str, str]:
    """Return a picture with its caption and what stands for it where it cannot be seen."""
    fits = ', '.join(one.label for row in panel.residuals for one in row) or 'no fit'
    phases = ', '.join(phase.name for phase in panel.phases)
    return {
        'svg': svg(panel),
        'alt': f'{panel.quantity} of {name} against time, measured and fitted ({fits}), with the '
        f'phases {phases}, and the residuals below.',
        'caption': caption,
    }


def _force_words(one: Shown, units: UnitSystem) -> str:
    words = 'Contact force against time; below, what the fits leave, and a grey band of two '
    words += 'standard deviations of the noise on either side.'
    if one.before is None:
        return words + ' The three-element model could not be compared with this trial.'
    return words + _missed(one, 'force', units)


def _height_words(one: Shown, units: UnitSystem) -> str:
    source = one.analysis.trial.displacement_source
    if source == 'none':
        return 'The displacement height was not recorded: only the tool is shown.'
    if source == 'tool':
        return (
            "Displacement against time: there is no height but the tool's, which is the object's "
            'where they touch.'
        )
    words = 'Displacement height against time, and what the fits leave.'
    return words + _missed(one, 'height', units)


def _missed(one: Shown, channel: Channel, units: UnitSystem) -> str:
    """Return by how much each model misses a channel."""
    sizes = [
        f'{short_name(beside.model)} by {size_text(beside.misfit[channel], channel, units)}'
        for beside in (one.before, one.after)
        if beside is not None and channel in beside.misfit
    ]
    return f' Missed: {", ".join(sizes)}.' if sizes else ''
