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


"""What the pictures of a trial show, in the units of display: no drawing here."""

import math
from typing import Final

from hapticvision_ros.core.diagnosis.records import Channel
from hapticvision_ros.core.fit.exponential import ExponentialFit
from hapticvision_ros.core.pipeline import TrialAnalysis
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal
from hapticvision_ros.report.figure import Mark, Panel, Phase, Role, Series
from hapticvision_ros.report.misses import Beside, short_name, Shown
from hapticvision_ros.report.quantities import UnitSystem

PAPER_FORCE_LABEL: Final = 'eq. (4), hold alone'
PAPER_HEIGHT_LABEL: Final = 'eq. (10), recovery alone'
MEASURED_LABEL: Final = 'measured'
TOOL_LABEL: Final = 'tool'
_INSTANTS: Final = (
    ('t_contact', 'push', 'T_c'),
    ('t_hold', 'hold', 'T_s'),
    ('t_release', 'release', 'T_e'),
    ('t_loss', 'recover', 't_loss'),
)


def phases_of(segmentation: Segmentation, start: float) -> tuple[Phase, ...]:
    """
    Return the phases that were found, from the start of the record to its end.

    Parameters
    ----------
    segmentation : Segmentation
        The instants between the phases; those that are None start no phase.
    start : float
        First time of the record [s].

    Returns
    -------
    tuple of Phase
        In order of time; each ends where the next one begins.

    """
    begins = [(start, 'approach')]
    for attribute, name, _ in _INSTANTS:
        instant = getattr(segmentation, attribute)
        if instant is not None:
            begins.append((instant, name))
    ends = [begin for begin, _ in begins[1:]] + [segmentation.t_end]
    return tuple(
        Phase(begin, end, name)
        for (begin, name), end in zip(begins, ends, strict=True)
        if end > begin
    )


def marks_of(segmentation: Segmentation) -> tuple[Mark, ...]:
    """Return the instants that were found, with their symbols."""
    found = ((getattr(segmentation, name), symbol) for name, _, symbol in _INSTANTS)
    return tuple(Mark(instant, symbol) for instant, symbol in found if instant is not None)


def _fit(
    role: Role, label: str, measured: Signal, fitted: FloatArray, scale: float, zero: float = 0.0
) -> tuple[Series, Series]:
    """Return a fit, raised by the zero that `measured` is without, and measured minus fitted."""
    return (
        Series(role, label, measured.t, (fitted + zero) / scale),
        Series(role, label, measured.t, (measured.value - fitted) / scale),
    )


def _decay(
    label: str, measured: Signal, fit: ExponentialFit, scale: float
) -> tuple[Series, Series]:
    """Return one of the paper's exponentials where it was fitted, and what it leaves."""
    record = measured.between(fit.start, math.nextafter(fit.stop, math.inf))
    return _fit('paper', label, record, fit(record.t), scale)


def _modelled(
    role: Role, beside: Beside | None, channel: Channel, scale: float
) -> list[tuple[Series, Series]]:
    """Return what a model says of a channel, and what it leaves; nothing without samples."""
    if beside is None:
        return []
    trial = beside.trial
    measured, fitted = (
        (trial.force, trial.force_fitted)
        if channel == 'force'
        else (trial.height, trial.height_fitted)
    )
    if not len(measured):
        return []
    zero = trial.values.get(f'{channel}_zero')
    raised = 0.0 if zero is None or zero.value is None else zero.value
    return [_fit(role, short_name(beside.model), measured, fitted, scale, raised)]


def _panel(
    quantity: str,
    unit: str,
    measured: tuple[Series, ...],
    fits: tuple[list[tuple[Series, Series]], ...],
    noise: float | None,
    analysis: TrialAnalysis,
) -> Panel:
    """Return a panel with a row of residuals for each group of fits."""
    record = measured[0].t
    return Panel(
        quantity=quantity,
        unit=unit,
        lines=(*measured, *(fit for group in fits for fit, _ in group)),
        residuals=tuple(tuple(residual for _, residual in group) for group in fits if group),
        noise=noise,
        phases=phases_of(analysis.segmentation.entire, float(record[0])),
        marks=marks_of(analysis.segmentation.entire),
    )


def force_panel(one: Shown, noise: float | None, units: UnitSystem) -> Panel:
    """
    Return the contact force of a trial against its fits.

    Parameters
    ----------
    one : Shown
        The trial with the decay of eq. (4), beside the models.
    noise : float or None
        One standard deviation of a sample [N].
    units : mapping of str to Unit
        Units of display.

    Returns
    -------
    Panel
        Force without the load cell's zero; residuals are measured minus fitted.

    """
    unit = units['force']
    analysis = one.analysis
    raw = analysis.trial.force
    force = Signal(raw.t, raw.value - analysis.segmentation.force_zero)
    before = _modelled('base', one.before, 'force', unit.in_si)
    if analysis.paper.hold_fit is not None:
        before.append(_decay(PAPER_FORCE_LABEL, force, analysis.paper.hold_fit, unit.in_si))
    return _panel(
        'Force',
        unit.symbol,
        (Series('measured', MEASURED_LABEL, force.t, force.value / unit.in_si),),
        (before, _modelled('after', one.after, 'force', unit.in_si)),
        None if noise is None else noise / unit.in_si,
        analysis,
    )


def height_panel(one: Shown, noise: float | None, units: UnitSystem) -> Panel | None:
    """
    Return the displacement height of a trial against its fits, as `force_panel` does the force.

    Returns
    -------
    Panel or None
        With the tool's displacement while it touches, where the contact was found; None without
        any height at all.

    """
    unit = units['length']
    analysis = one.analysis
    tool = _tool_displacement(analysis)
    tool_line = (
        () if tool is None else (Series('tool', TOOL_LABEL, tool.t, tool.value / unit.in_si),)
    )
    height = analysis.trial.displacement_height
    if height is None or not len(height):
        if not tool_line:
            return None
        return _panel('Tool displacement', unit.symbol, tool_line, (), None, analysis)
    before = _modelled('base', one.before, 'height', unit.in_si)
    if analysis.paper.recovery_fit is not None:
        before.append(_decay(PAPER_HEIGHT_LABEL, height, analysis.paper.recovery_fit, unit.in_si))
    measured = Series('measured', MEASURED_LABEL, height.t, height.value / unit.in_si)
    return _panel(
        'Displacement height',
        unit.symbol,
        (measured,) if analysis.trial.displacement_source == 'tool' else (measured, *tool_line),
        (before, _modelled('after', one.after, 'height', unit.in_si)),
        None if noise is None else noise / unit.in_si,
        analysis,
    )


def _tool_displacement(analysis: TrialAnalysis) -> Signal | None:
    """Return how far the tool is in while it touches [m]; beyond that it leaves the picture."""
    phases = analysis.segmentation.entire
    if phases.t_contact is None or phases.contact_height is None:
        return None
    stops = (phases.t_loss, phases.t_release, phases.t_end)
    stop = next(instant for instant in stops if instant is not None)
    tool = analysis.trial.tool_height.between(phases.t_contact, stop)
    return Signal(tool.t, phases.contact_height - tool.value) if len(tool) else None
