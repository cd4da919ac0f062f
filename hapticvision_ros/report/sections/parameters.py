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

_LETTER_AND_DIGIT: Final = 2


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
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
        'before': campaign.before.model.name,
        'after': None if campaign.after is None else campaign.after.model.name,
        'shared': _shared(campaign, units),
        'noise': [
            ('Force', size(campaign.noise.force, units['force'])),
            ('Displacement height', size(campaign.noise.height, units['length'])),
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


def _shared(
    campaign: CampaignAnalysis, units: UnitSystem
) -> list[tuple[str, str, Cell | None, Cell | None, str]]:
    """Return, for each parameter of the models, both values and how far the first is off."""
    before, after = campaign.before, campaign.after
    known = before.units if after is None else {**before.units, **after.units}
    rows = []
    for name, si_unit in known.items():
        unit = display_unit(si_unit, units)
        old = before.parameters.get(name)
        new = None if after is None else after.parameters.get(name)
        off = ''
        if old is not None and new is not None and old.value is not None and new.value:
            off = f'{format_number(100.0 * (old.value / new.value - 1.0), digits=3)}\u00a0%'
        rows.append(
            (
                *_symbol(name),
                None if old is None else cell(old, unit),
                None if new is None else cell(new, unit),
                off,
            )
        )
    return rows


def _symbol(name: str) -> tuple[str, str]:
    """Return a parameter's symbol and its index: K1, F_y, delta_0, or alpha without any."""
    owner, point, symbol = name.rpartition('.')
    if len(symbol) == _LETTER_AND_DIGIT and symbol[1].isdigit():
        return owner + point + symbol[0], symbol[1]
    letter, _, index = symbol.partition('_')
    return owner + point + letter, index
