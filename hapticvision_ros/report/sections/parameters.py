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


"""The parameters of all trials side by side."""

from collections.abc import Mapping
from typing import Final

from hapticvision_ros.core.fit.waveform import ModelError
from hapticvision_ros.core.pipeline import CampaignAnalysis, TrialAnalysis
from hapticvision_ros.core.records import Estimate
from hapticvision_ros.report.cells import bare, Cell, cell, optional, size
from hapticvision_ros.report.quantities import (
    Dimension,
    display_unit,
    format_number,
    Unit,
    UnitSystem,
)

# Attribute of `PaperResult`, symbol and index, dimension.
COLUMNS: Final[tuple[tuple[str, str, str, Dimension], ...]] = (
    ('K1', 'K', '1', 'stiffness'),
    ('C1', 'C', '1', 'viscosity'),
    ('C2', 'C', '2', 'viscosity'),
    ('relaxation_time', 'τ', '', 'time'),
    ('retardation_time', 'γ', '', 'time'),
)


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    fit = campaign.before
    return {
        'speed_unit': units['speed'].symbol,
        'length_unit': units['length'].symbol,
        'columns': [
            (symbol, index, units[dimension].symbol) for _, symbol, index, dimension in COLUMNS
        ],
        'rows': [
            _row(number, analysis, units)
            for number, analysis in enumerate((*campaign.trials, *campaign.held_out), start=1)
        ],
        'model': fit.model,
        'shared': [
            (name[0], name[1:], cell(estimate, display_unit(fit.units[name], units)))
            for name, estimate in fit.parameters.items()
        ],
        'noise': [
            ('Force', size(campaign.noise.force, units['force'])),
            ('Displacement height', size(campaign.noise.height, units['length'])),
        ],
        'errors': [
            (name, *_errors(error, units))
            for name, error in (('Fitted trials', fit.train), ('Held-out trials', fit.held_out))
            if error is not None
        ],
    }


def _row(number: int, analysis: TrialAnalysis, units: UnitSystem) -> Mapping[str, object]:
    phases = analysis.segmentation
    estimates: list[tuple[Estimate, Dimension]] = [
        (getattr(analysis.paper, attribute), dimension) for attribute, _, _, dimension in COLUMNS
    ]
    return {
        'number': number,
        'name': analysis.trial.name,
        'speed': optional(phases.push_speed, Unit('', units['speed'].in_si)),
        'depth': optional(phases.depth, Unit('', units['length'].in_si)),
        'cells': [bare(estimate, units[dimension]) for estimate, dimension in estimates],
    }


def _errors(error: ModelError, units: UnitSystem) -> tuple[Cell, Cell, str, str]:
    """Return the errors of force and height, and how many times the noise's square they are."""
    force_chi2, height_chi2 = (
        'unknown' if chi2 is None else format_number(chi2, digits=2)
        for chi2 in (error.force_chi2, error.height_chi2)
    )
    return (
        optional(error.force_rmse, units['force']),
        optional(error.height_rmse, units['length']),
        force_chi2,
        height_chi2,
    )
