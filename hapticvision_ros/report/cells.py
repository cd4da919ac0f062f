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

from dataclasses import dataclass
from typing import Final

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
