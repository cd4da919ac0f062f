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


"""Estimates as cells of a table: a number with its error and unit, or why there is none."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from hapticvision_ros.core.diagnosis.records import Channel, Phase
from hapticvision_ros.core.fit.held_out import PHASES
from hapticvision_ros.core.records import Estimate
from hapticvision_ros.report.quantities import format_quantity, Unit

NOT_IDENTIFIABLE: Final = 'not identifiable'


@dataclass(frozen=True, slots=True)
class Cell:
    """
    A cell of a table.

    Parameters
    ----------
    text : str
        What stands in it.
    known : bool
        Whether it holds a number.
    note : str
        Why there is no number, or why it is no better than it is; may be empty.

    """

    text: str
    known: bool
    note: str = ''


class Parts[T](Protocol):
    """What is known of all samples, of each phase, and of each trial, by channel."""

    @property
    def total(self) -> Mapping[Channel, T]: ...

    @property
    def by_phase(self) -> Mapping[tuple[Channel, Phase], T]: ...

    @property
    def by_trial(self) -> Mapping[tuple[str, Channel], T]: ...


def rows_of[T](
    columns: Sequence[tuple[Parts[T], Channel]], trials: Iterable[str]
) -> list[tuple[str, list[T | None]]]:
    """Return the rows of a table with a cell for each column: all, the phases, the trials."""
    rows: list[tuple[str, list[T | None]]] = [
        ('All', [of.total.get(channel) for of, channel in columns])
    ]
    rows += [
        (phase, [of.by_phase.get((channel, phase)) for of, channel in columns]) for phase in PHASES
    ]
    rows += [
        (name, [of.by_trial.get((name, channel)) for of, channel in columns])
        for name in dict.fromkeys(trials)
    ]
    return [row for row in rows if any(one is not None for one in row[1])]


def cell(estimate: Estimate, unit: Unit) -> Cell:
    """Return an estimate as it stands in a table."""
    if estimate.value is None:
        return Cell(NOT_IDENTIFIABLE, False, estimate.reason or 'the data cannot tell it')
    note = estimate.reason or ''
    if estimate.std is None:
        note = '; '.join(filter(None, (note, 'without an error')))
    return Cell(format_quantity(estimate.value, unit, estimate.std), True, note)


def bare(estimate: Estimate, unit: Unit) -> Cell:
    """Return an estimate for a column whose head tells the unit."""
    return cell(estimate, Unit('', unit.in_si))


def size(estimate: Estimate, unit: Unit) -> Cell:
    """Return an estimate of which only the size matters, such as a noise: two digits, no error."""
    if estimate.value is None:
        return cell(estimate, unit)
    return Cell(format_quantity(estimate.value, unit, digits=2), True, estimate.reason or '')


def optional(value: float | None, unit: Unit) -> Cell:
    """Return a plain number as a cell, or that it was not found."""
    if value is None:
        return Cell('not found', False)
    return Cell(format_quantity(value, unit), True)
