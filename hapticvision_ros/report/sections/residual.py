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

"""Whether what the models leave is noise, and what is smooth in it."""

from collections.abc import Mapping
from typing import NamedTuple

from hapticvision_ros.core.diagnosis.records import Channel, Goes, Leftover, Leftovers
from hapticvision_ros.core.fit.held_out import labels, PHASES
from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.cells import rows_of
from hapticvision_ros.report.figure import curves_svg, SmoothLine
from hapticvision_ros.report.leftover import (
    goes,
    is_coloured,
    is_smooth,
    residual_sentences,
)
from hapticvision_ros.report.misses import DIMENSIONS, ROUGH, short_name
from hapticvision_ros.report.quantities import format_number, format_quantity, UnitSystem
from hapticvision_ros.report.sections.errors import TITLES


class _Cell(NamedTuple):
    """A number, and whether it is beyond chance."""

    text: str
    told: bool


_NOTHING = (_Cell('', False),) * 6


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    models = [campaign.before] if campaign.after is None else [campaign.before, campaign.after]
    columns = [(short_name(model), model.left) for model in models if model.left is not None]
    tables = []
    for channel, title in TITLES:
        if not any(channel in left.total for _, left in columns):
            continue
        mine = [(left, channel) for _, left in columns]
        rows = [
            (name, [_cells(one, units) for one in each])
            for name, each in rows_of(mine, labels(campaign.trials))
        ]
        unit = units[DIMENSIONS[channel]]
        tables.append(
            {
                'title': title,
                'rows': rows,
                'noise': _noise_text(columns[-1][1], channel, units),
                'picture': curves_svg(
                    [(name, _lines(left, channel, unit.in_si)) for name, left in columns],
                    PHASES,
                    unit.symbol,
                ),
            }
        )
    return {
        'sentences': residual_sentences(campaign, units),
        'models': [name for name, _ in columns],
        'tables': tables,
    }


def _cells(left: Leftover | None, units: UnitSystem) -> tuple[_Cell, ...]:
    """Return the size, correlation of neighbours, smooth part, and what it goes with."""
    if left is None:
        return _NOTHING
    return (
        _Cell(format_number(left.size, digits=ROUGH), False),
        _Cell(_optional(left.neighbours), is_coloured(left)),
        _Cell(_optional(None if left.share is None else 100.0 * left.share), is_smooth(left)),
        _with(left.depth, units),
        _with(left.speed, units),
        _with(left.order, units),
    )


def _optional(value: float | None) -> str:
    return '' if value is None else format_number(value, digits=ROUGH)


def _with(with_it: Goes | None, units: UnitSystem) -> _Cell:
    """Return a correlation with something, and its lag where it is beyond chance."""
    if with_it is None:
        return _Cell('', False)
    text = format_number(with_it.correlation, digits=ROUGH)
    told = goes(with_it)
    if told and with_it.lag:
        text += f' ({format_quantity(with_it.lag, units["time"], digits=ROUGH)})'
    return _Cell(text, told)


def _noise_text(left: Leftovers, channel: Channel, units: UnitSystem) -> str:
    """Return the noise that a residual was whitened by."""
    noise, unit = left.noise[channel], units[DIMENSIONS[channel]]
    text = f'{format_quantity(noise.white, unit, digits=ROUGH)} white'
    if noise.slow > 0.0:
        slow = format_quantity(noise.slow, unit, digits=ROUGH)
        memory = format_quantity(noise.correlation_time, units['time'], digits=ROUGH)
        text += f', {slow} with a correlation time of {memory}'
    if noise.wander > 0.0:
        text += f', and a zero that wanders by {format_quantity(noise.wander, unit, digits=ROUGH)}'
    return text


def _lines(left: Leftovers, channel: Channel, scale: float) -> list[SmoothLine]:
    """Return the smooth curves of a channel in the unit of display."""
    return [
        SmoothLine(one.trial, one.phase, one.t, one.value / scale, one.std / scale)
        for one in left.curves
        if one.channel == channel
    ]
