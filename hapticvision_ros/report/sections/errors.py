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

"""How far the models miss, by channel, phase and trial, on seen and on unseen trials."""

from collections.abc import Mapping
from typing import Final

from hapticvision_ros.core.diagnosis.records import Channel, Misfit, Misfits
from hapticvision_ros.core.fit.held_out import are_repeats, labels
from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.cells import rows_of
from hapticvision_ros.report.misses import DIMENSIONS, ROUGH, short_name
from hapticvision_ros.report.quantities import format_number, UnitSystem

TITLES: Final[tuple[tuple[Channel, str], ...]] = (
    ('force', 'Force'),
    ('height', 'Displacement height'),
)
_NOTHING: Final = ('', '', '')

type _Cells = tuple[str, str, str]


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    models = [campaign.before] if campaign.after is None else [campaign.before, campaign.after]
    columns: list[tuple[str, str, Misfits]] = []
    for side, name in (('train', 'Fitted trials'), ('held_out', 'Unseen trials')):
        for model in models:
            misfits = model.train if side == 'train' else model.held_out
            if misfits is not None:
                columns.append((name, short_name(model), misfits))
    names = (*labels(campaign.trials), *labels(campaign.held_out))
    tables = []
    for channel, title in TITLES:
        if not any(channel in misfits.total for _, _, misfits in columns):
            continue
        rows = [
            (name, [_cells(one, channel, units) for one in found])
            for name, found in rows_of([(misfits, channel) for *_, misfits in columns], names)
        ]
        tables.append((title, units[DIMENSIONS[channel]].symbol, rows))
    sides = [name for name, _, _ in columns]
    return {
        'changes': _changes(campaign),
        'sides': [(name, 3 * sides.count(name)) for name in dict.fromkeys(sides)],
        'models': [model for _, model, _ in columns],
        'tables': tables,
        'titles': [title for _, title in TITLES],
        'held_out_by': campaign.held_out_by,
        'repeats': are_repeats(campaign.trials),
        'diagnosed': campaign.diagnosis is not None and campaign.after is not None,
    }


def _changes(campaign: CampaignAnalysis) -> list[tuple[str, list[str]]]:
    """Return the rows of the table of changes on unseen trials; a cell for each channel."""
    changes = campaign.changes
    if changes is None:
        return []
    against = campaign.trials if campaign.held_out_by == 'condition' else campaign.held_out
    columns = [(changes, channel) for channel, _ in TITLES]
    return [
        (name, ['' if one is None else format_number(one.chi2, one.std) for one in each])
        for name, each in rows_of(columns, labels(against))
    ]


def _cells(misfit: Misfit | None, channel: Channel, units: UnitSystem) -> _Cells:
    """Return the error, percent of the range, and chi squared."""
    if misfit is None:
        return _NOTHING
    percent, chi2 = misfit.percent_of_range, misfit.chi2
    return (
        format_number(units[DIMENSIONS[channel]].from_si(misfit.rmse), digits=ROUGH),
        '' if percent is None else format_number(percent, digits=ROUGH),
        'unknown' if chi2 is None else format_number(chi2, digits=3),
    )
