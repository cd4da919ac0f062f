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

"""
Pictures of a signal against its fits, as SVG that takes its colours from the page.

The SVG is written out here: a plotting library takes longer to import and to draw than the fit of
a trial.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape
import math
from typing import Final, Literal

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.report.decimation import line
import numpy as np

type Window = tuple[float, float]
type Role = Literal['measured', 'tool', 'paper', 'base', 'after']

_BINS: Final = 500
_MARKERS_UP_TO: Final = 150
_CLOSE_UP_BELOW: Final = 0.2
_NOISE_BAND_SIGMAS: Final = 2.0
_GLITCH_SHARE: Final = 0.002
_GLITCH_RATIO: Final = 2.0

# The layout, in points of a picture that the page scales to its width.
_WIDTH: Final = 691.0
_LEFT: Final = 69.0
_RIGHT: Final = 686.0
_TOP: Final = 53.0
_BOTTOM: Final = 36.0
_SIGNAL_HEIGHT: Final = 152.0
_RESIDUAL_HEIGHT: Final = 58.0
_ROOM_BETWEEN_ROWS: Final = 11.0
_ROOM_BETWEEN_COLUMNS: Final = 35.0
_COLUMNS: Final = (1.0, 2.3)
_TICK: Final = 3.5
_POINTS_A_TICK: Final = 40.0
_TICKS_OF_A_SIGNAL: Final = 6
_TICKS_OF_A_RESIDUAL: Final = 4
_TICK_STEPS: Final = (1.0, 2.0, 2.5, 5.0, 10.0)
_FONT: Final = 9.5
_LETTER: Final = 5.2
_LEGEND_LINE: Final = 23.0
_LEGEND_GAP: Final = 18.0
_ROOM_FOR_A_LETTER: Final = 6.0
_ROOM_BESIDE_A_NAME: Final = 22.0
_RAISED: Final = 11.5

_CURVES_HEIGHT: Final = 105.0
_ROOM_BETWEEN_CURVES: Final = 46.0
_HUES: Final = 300.0
"""Of the last of several trials; the first is red."""
_MOST_NAMED: Final = 24

_COLOURS: Final[dict[Role, str]] = {
    'measured': 'var(--measured)',
    'tool': 'var(--tool)',
    'paper': 'var(--paper-fit)',
    'base': 'var(--base-fit)',
    'after': 'var(--after-fit)',
}
_DASHES: Final[dict[Role, str]] = {'tool': '1.3,2.1', 'paper': '7,3'}
_WIDTHS: Final[dict[Role, float]] = {
    'measured': 1.1,
    'tool': 1.3,
    'paper': 1.9,
    'base': 1.5,
    'after': 1.5,
}
_RESIDUAL_WIDTH: Final = 0.8
_DOT: Final = 3.2


@dataclass(frozen=True, slots=True)
class Series:
    """
    One line of a picture.

    Parameters
    ----------
    role : {'measured', 'tool', 'paper', 'base', 'after'}
        What it is: decides colour and dashes.
    label : str
        What the legend calls it.
    t : ndarray, shape (n,)
        Times [s].
    value : ndarray, shape (n,)
        Values in the unit of the panel; NaN where there is none.

    """

    role: Role
    label: str
    t: FloatArray
    value: FloatArray


@dataclass(frozen=True, slots=True)
class Phase:
    """A span of time [s] with its name."""

    start: float
    stop: float
    name: str


@dataclass(frozen=True, slots=True)
class Mark:
    """An instant [s] with its symbol, such as ``T_c``: what follows the mark is an index."""

    t: float
    symbol: str


@dataclass(frozen=True, slots=True)
class Panel:
    """
    A measured quantity, its fits, and what they leave.

    Parameters
    ----------
    quantity : str
        What is drawn, for example ``Force``.
    unit : str
        Its unit.
    lines : tuple of Series
        The measured signal first, then the fits.
    residuals : tuple of (tuple of Series)
        Measured minus fitted: a row of the picture for each group, as their sizes differ.
    noise : float or None
        One standard deviation of a sample, in `unit`.
    phases : tuple of Phase
        The phases of the trial, in order.
    marks : tuple of Mark
        The instants between them.

    """

    quantity: str
    unit: str
    lines: tuple[Series, ...]
    residuals: tuple[tuple[Series, ...], ...]
    noise: float | None
    phases: tuple[Phase, ...]
    marks: tuple[Mark, ...]


@dataclass(frozen=True, slots=True)
class _Frame:
    """The axes of a picture: where they stand [points, y downwards] and what they span."""

    left: float
    right: float
    top: float
    bottom: float
    window: Window
    limits: Window

    def x(self, t: float) -> float:
        start, stop = self.window
        return self.left + (self.right - self.left) * (t - start) / (stop - start)

    def y(self, value: float) -> float:
        low, high = self.limits
        return self.bottom - (self.bottom - self.top) * (value - low) / (high - low)

    def points(self, t: FloatArray, value: FloatArray) -> FloatArray:
        """Return where samples stand, in hundredths of a point: no screen shows less."""
        start, stop = self.window
        low, high = self.limits
        x = self.left + (self.right - self.left) / (stop - start) * (t - start)
        y = self.bottom - (self.bottom - self.top) / (high - low) * (value - low)
        points: FloatArray = np.round(100.0 * np.stack((x, y), axis=1))
        return points


def _within(series: Series, window: Window) -> tuple[FloatArray, FloatArray]:
    """Return the samples in a window and one beyond each end, so that lines reach the frame."""
    first = max(0, int(np.searchsorted(series.t, window[0])) - 1)
    last = int(np.searchsorted(series.t, window[1], side='right')) + 1
    return series.t[first:last], series.value[first:last]


def _limits(lines: tuple[Series, ...], window: Window, robust: bool) -> Window:
    """
    Return the least and the greatest value in a window of time, with a margin.

    With `robust`, a few glitches that would squeeze all else into a line are left out.
    """
    parts = [_within(series, window)[1] for series in lines]
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return 0.0, 1.0
    lowest, highest = float(values.min()), float(values.max())
    if robust:
        low, high = np.quantile(values, (_GLITCH_SHARE, 1.0 - _GLITCH_SHARE))
        if highest - lowest > _GLITCH_RATIO * (high - low) > 0.0:
            centre, half = 0.5 * (low + high), 0.6 * (high - low)
            lowest, highest = max(lowest, centre - half), min(highest, centre + half)
    margin = 0.06 * (highest - lowest) or 0.06 * abs(highest) or 1.0
    return lowest - margin, highest + margin


def _number(value: float) -> str:
    """Return a length for a picture, to a hundredth of a point."""
    return f'{value:.2f}'.rstrip('0').rstrip('.')


def _polyline(points: FloatArray) -> str:
    """Return the path through points [hundredths], interrupted where one is not finite."""
    whole = np.isfinite(points[:, 1])
    cuts = np.flatnonzero(whole[1:] != whole[:-1]) + 1
    path = []
    for part in np.split(points, cuts):
        if not part.size or not np.isfinite(part[0, 1]):
            continue
        # From point to point: the steps have fewer digits than the places.
        steps = np.diff(part, axis=0)
        (x, y), moved = part[0], steps[np.any(steps != 0.0, axis=1)]
        path.append(f'M{x / 100:g},{y / 100:g}l')
        path.append(' '.join(f'{dx / 100:g},{dy / 100:g}' for dx, dy in moved.tolist()) or '0,0')
    return ''.join(path)


def _dots(points: FloatArray) -> str:
    """Return a path that sets a dot at each point [hundredths], for a pen with a round tip."""
    return ''.join(f'M{x / 100:g},{y / 100:g}h0' for x, y in points.tolist() if math.isfinite(y))


def _path(path: str, style: str) -> str:
    return f'<path d="{path}" style="{style}"/>'


def _pen(colour: str, width: float, dashes: str | None = None) -> str:
    """Return the style of a line."""
    style = f'fill:none;stroke:{colour};stroke-width:{width}'
    return style if dashes is None else f'{style};stroke-dasharray:{dashes}'


def _rectangle(left: float, right: float, top: float, bottom: float, colour: str) -> str:
    width, height = _number(right - left), _number(bottom - top)
    place = f'x="{_number(left)}" y="{_number(top)}" width="{width}" height="{height}"'
    return f'<rect {place} style="fill:{colour}"/>'


def _text(x: float, y: float, text: str, anchor: str = 'middle', style: str = '') -> str:
    """Return a text, whose markup is escaped already."""
    return (
        f'<text x="{_number(x)}" y="{_number(y)}" '
        f'style="text-anchor:{anchor};{style}">{text}</text>'
    )


def _ruler(window: Window, most: int) -> tuple[list[float], list[str]]:
    """Return round places for at most `most` spaces in a window, and their labels."""
    low, high = window
    raw = (high - low) / most
    decade = 10.0 ** math.floor(math.log10(raw))
    step = decade * next(one for one in _TICK_STEPS if one * decade >= 0.999 * raw)
    first, last = math.ceil(low / step - 1e-6), math.floor(high / step + 1e-6)
    places = [number * step for number in range(first, last + 1)]
    digits = max(0, -math.floor(math.log10(step) + 1e-9))
    if abs(step * 10.0**digits - round(step * 10.0**digits)) > 1e-6:
        digits += 1  # 0.25 and not 0.2
    greatest = max((abs(place) for place in places), default=0.0)
    if digits > 6 or greatest >= 1e6:
        significant = max(1, math.floor(math.log10(max(greatest, step) / step) + 1e-9) + 2)
        labels = [f'{place:.{significant}g}' for place in places]
    else:
        labels = [f'{place + 0.0:.{digits}f}' for place in places]
    return places, [label.replace('-', '\N{MINUS SIGN}') for label in labels]


def _drawn(frame: _Frame, series: Series, thin: bool) -> str:
    """Return the line of a series."""
    points = frame.points(*line(*_within(series, frame.window), _BINS))
    colour = _COLOURS[series.role]
    if series.role == 'measured' and series.t.size <= _MARKERS_UP_TO:
        return _path(_dots(points), f'{_pen(colour, _DOT)};stroke-linecap:round')
    if thin:
        return _path(_polyline(points), _pen(colour, _RESIDUAL_WIDTH))
    return _path(_polyline(points), _pen(colour, _WIDTHS[series.role], _DASHES.get(series.role)))


def _inside(frame: _Frame, parts: Sequence[str]) -> str:
    """Return parts of a picture, cut off at the frame."""
    size = frame.right - frame.left, frame.bottom - frame.top
    x, y, width, height = (_number(one) for one in (frame.left, frame.top, *size))
    place = f'x="{x}" y="{y}" width="{width}" height="{height}"'
    # An inner picture is cut off at its edge; its view box keeps the outer one's coordinates.
    return f'<svg {place} viewBox="{x} {y} {width} {height}">{"".join(parts)}</svg>'


def _background(frame: _Frame, panel: Panel) -> Iterator[str]:
    """Give the shades of the phases and the instants between them."""
    for number, phase in enumerate(panel.phases):
        start, stop = frame.x(phase.start), frame.x(phase.stop)
        yield _rectangle(start, stop, frame.top, frame.bottom, f'var(--shade-{"ab"[number % 2]})')
    for mark in panel.marks:
        x = _number(frame.x(mark.t))
        path = f'M{x},{_number(frame.bottom)}V{_number(frame.top)}'
        yield _path(path, _pen('var(--ink)', 0.7, '1.4,1.4'))


def _axes(frame: _Frame, most: int, lowest: bool, inside: Sequence[str]) -> Iterator[str]:
    """Give the axes of a frame with their ticks, and what is inside them."""
    left, right, bottom = _number(frame.left), _number(frame.right), _number(frame.bottom)
    places, labels = _ruler(frame.limits, most)
    heights = [frame.y(place) for place in places]
    grid = ''.join(f'M{left},{_number(y)}H{right}' for y in heights)
    # Shades, grid, lines: each upon the one before.
    yield _inside(frame, [inside[0], _path(grid, _pen('var(--grid)', 0.6)), *inside[1:]])
    ticks = [f'M{left},{_number(y)}h{-_TICK}' for y in heights]
    for y, label in zip(heights, labels, strict=True):
        yield _text(frame.left - 2.0 * _TICK, y + 0.36 * _FONT, label, 'end')
    most = max(2, int((frame.right - frame.left) / _POINTS_A_TICK))
    places, labels = _ruler(frame.window, most)
    for place, label in zip(places, labels, strict=True):
        x = frame.x(place)
        ticks.append(f'M{_number(x)},{bottom}v{_TICK}')
        if lowest:
            yield _text(x, frame.bottom + 2.0 * _TICK + 0.8 * _FONT, label)
    spines = f'M{left},{_number(frame.top)}V{bottom}H{right}'
    yield _path(spines + ''.join(ticks), _pen('var(--ink)', 0.7))


def _point_at_what_is_off(frame: _Frame, lines: tuple[Series, ...]) -> Iterator[str]:
    """Give a triangle at the frame where samples lie beyond it."""
    low, high = frame.limits
    for series in lines:
        t, value = line(*_within(series, frame.window), _BINS)
        seen = (t >= frame.window[0]) & (t <= frame.window[1])
        t, value = t[seen], value[seen]
        for beyond, edge, down in ((value > high, frame.top, 1), (value < low, frame.bottom, -1)):
            corners = ''.join(
                f'M{_number(frame.x(one))},{_number(edge)}l-2.5,{4.3 * down}h5z'
                for one in t[beyond].tolist()
            )
            if corners:
                yield _path(corners, f'fill:{_COLOURS[series.role]}')


def _close_up(panel: Panel, span: Window) -> Window | None:
    """Return the window around the push where it is too short to be seen in the whole."""
    push = next((phase for phase in panel.phases if phase.name == 'push'), None)
    if push is None or push.stop - push.start > _CLOSE_UP_BELOW * (span[1] - span[0]):
        return None
    fits = [one for row in panel.residuals for one in row]
    if not any(np.any((one.t > push.start) & (one.t < push.stop)) for one in fits):
        return None  # No fit to be judged there.
    length = push.stop - push.start
    return max(span[0], push.start - 0.5 * length), min(span[1], push.stop + 1.0 * length)


def _span(panel: Panel) -> Window:
    measured = panel.lines[0].t
    start, stop = float(measured[0]), float(measured[-1])
    # One sample spans no time, as where a sensor went silent at once.
    return (start, stop) if stop > start else (start - 0.5, start + 0.5)


def _phases_named(frame: _Frame, panel: Panel) -> Iterator[str]:
    """Give the names of the instants above the frame, and of the phases that have room."""
    right_of_last = -math.inf
    row = 0
    above = frame.top - 4.0
    for mark in panel.marks:
        if not frame.window[0] <= mark.t <= frame.window[1]:
            continue
        x = frame.x(mark.t)
        # Two instants too close to each other to be told apart stand one above the other.
        row = row + 1 if x - right_of_last < _ROOM_BESIDE_A_NAME else 0
        right_of_last = x
        letter, _, index = (escape(part) for part in mark.symbol.partition('_'))
        if index:
            index = f'<tspan dy="0.25em" font-size="75%">{index}</tspan>'
        yield _text(x, above - _RAISED * row, letter + index, style='font-style:italic')
    for phase in panel.phases:
        start, stop = max(phase.start, frame.window[0]), min(phase.stop, frame.window[1])
        room = _ROOM_BESIDE_A_NAME + _ROOM_FOR_A_LETTER * len(phase.name)
        if frame.x(stop) - frame.x(start) > room:
            x = frame.x(0.5 * (start + stop))
            yield _text(x, above, escape(phase.name), style='font-size:8.5px;fill:var(--soft)')


def _legend(lines: tuple[Series, ...]) -> Iterator[str]:
    """Give what the lines are called, in a row at the top."""
    widths = [_LEGEND_LINE + 6.0 + _LETTER * len(series.label) for series in lines]
    x = 0.5 * (_LEFT + _RIGHT - sum(widths) - _LEGEND_GAP * (len(widths) - 1))
    for series, width in zip(lines, widths, strict=True):
        colour = _COLOURS[series.role]
        if series.role == 'measured' and series.t.size <= _MARKERS_UP_TO:
            dot = f'M{_number(x + 0.5 * _LEGEND_LINE)},12h0'
            yield _path(dot, f'{_pen(colour, _DOT)};stroke-linecap:round')
        else:
            pen = _pen(colour, _WIDTHS[series.role], _DASHES.get(series.role))
            yield _path(f'M{_number(x)},12h{_LEGEND_LINE}', pen)
        yield _text(x + _LEGEND_LINE + 6.0, 12.0 + 0.36 * _FONT, escape(series.label), 'start')
        x += width + _LEGEND_GAP


def _frames(panel: Panel) -> list[list[_Frame]]:
    """Return the frames of a picture, row by row, the signal's first."""
    span = _span(panel)
    close_up = _close_up(panel, span)
    windows = [span] if close_up is None else [close_up, span]
    parts = (1.0,) if close_up is None else _COLUMNS
    room = _RIGHT - _LEFT - _ROOM_BETWEEN_COLUMNS * (len(windows) - 1)
    edges = []
    left = _LEFT
    for part in parts:
        width = room * part / sum(parts)
        edges.append((left, left + width))
        left += width + _ROOM_BETWEEN_COLUMNS
    rows = []
    top = _TOP
    for number, lines in enumerate((panel.lines, *panel.residuals)):
        height = _RESIDUAL_HEIGHT if number else _SIGNAL_HEIGHT
        rows.append(
            [
                _Frame(*edge, top, top + height, window, _limits(lines, window, number > 0))
                for edge, window in zip(edges, windows, strict=True)
            ]
        )
        top += height + _ROOM_BETWEEN_ROWS
    return rows


def _turned(y: float, text: str) -> str:
    """Return a text that reads upwards along the left edge."""
    place = f'{_number(0.19 * _LEFT)} {_number(y)}'
    return (
        f'<text transform="translate({place}) rotate(-90)" '
        f'style="text-anchor:middle">{escape(text)}</text>'
    )


def svg(panel: Panel) -> str:
    """
    Draw a panel: signal and fits above, residuals with the band of the noise below.

    A push too short to be seen in the whole trial gets a column of its own, on the left.

    Parameters
    ----------
    panel : Panel
        What to draw.

    Returns
    -------
    str
        An ``<svg>`` element without identifiers, for a page that defines the CSS variables
        ``--ink``, ``--soft``, ``--grid``, ``--band``, ``--shade-a``, ``--shade-b``,
        ``--measured``, ``--tool``, ``--paper-fit``, ``--base-fit`` and ``--after-fit``.

    """
    rows = _frames(panel)
    names = (panel.quantity, *_names_of_rows(len(panel.residuals)))
    parts = list(_legend(panel.lines))
    for number, (frames, lines) in enumerate(
        zip(rows, (panel.lines, *panel.residuals), strict=True)
    ):
        middle = 0.5 * (frames[0].top + frames[0].bottom)
        parts.append(_turned(middle, f'{names[number]} [{panel.unit}]'))
        for frame in frames:
            inside = [''.join(_background(frame, panel))]
            if number:
                inside.append(_zero(frame, panel.noise))
            else:
                parts += _phases_named(frame, panel)
            inside += [_drawn(frame, series, thin=number > 0) for series in lines]
            most = _TICKS_OF_A_RESIDUAL if number else _TICKS_OF_A_SIGNAL
            parts += _axes(frame, most, number == len(rows) - 1, inside)
            parts += _point_at_what_is_off(frame, lines)
    bottom = rows[-1][0].bottom
    parts += [
        _text(0.5 * (frame.left + frame.right), bottom + 31.0, 'Time [s]') for frame in rows[-1]
    ]
    box = f'0 0 {_number(_WIDTH)} {_number(bottom + _BOTTOM)}'
    style = f'font-size:{_FONT}px;fill:var(--ink)'
    return f'<svg viewBox="{box}" style="{style}">\n' + '\n'.join(parts) + '\n</svg>'


@dataclass(frozen=True, slots=True)
class SmoothLine:
    """
    A curve through a few corners over one phase of one trial.

    Parameters
    ----------
    trial : str
        What the legend calls it.
    phase : str
        The phase.
    t : ndarray, shape (n,)
        Times of the corners, from the start of the phase [s].
    value, std : ndarray, shape (n,)
        Values there with their standard errors, in the unit of the picture.

    """

    trial: str
    phase: str
    t: FloatArray
    value: FloatArray
    std: FloatArray


def curves_svg(
    rows: Sequence[tuple[str, Sequence[SmoothLine]]], order: Sequence[str], unit: str
) -> str:
    """
    Draw curves phase by phase, with a row for each model.

    Parameters
    ----------
    rows : sequence of (str, sequence of SmoothLine)
        The model and its curves.
    order : sequence of str
        The phases, as they follow one another.
    unit : str
        Unit of these.

    Returns
    -------
    str
        An ``<svg>`` element for the same page as that of `svg`; empty without any curve.

    """
    every = [each for _, lines in rows for each in lines]
    if not every:
        return ''
    phases = [phase for phase in order if any(each.phase == phase for each in every)]
    trials = list(dict.fromkeys(each.trial for each in every))
    colours = {
        trial: f'hsl({round(_HUES * k / max(len(trials) - 1, 1))} 65% 50%)'
        for k, trial in enumerate(trials)
    }
    parts = []
    legend = _names_of_trials(colours) if 1 < len(trials) <= _MOST_NAMED else ['']
    for number, entries in enumerate(legend):
        parts.append(f'<g transform="translate(0 {_LEGEND_LINE * number:g})">{entries}</g>')
    top = _LEGEND_LINE * len(legend) + 3.5 * _FONT
    room = _RIGHT - _LEFT - _ROOM_BETWEEN_CURVES * (len(phases) - 1)
    width = room / len(phases)
    for name, lines in rows:
        parts.append(_text(_LEFT, top - 2.0 * _FONT, escape(name), 'start'))
        bottom = top + _CURVES_HEIGHT
        parts.append(_turned(0.5 * (top + bottom), f'Residual [{unit}]'))
        for column, phase in enumerate(phases):
            curves = [each for each in lines if each.phase == phase]
            left = _LEFT + column * (width + _ROOM_BETWEEN_CURVES)
            long = max((float(each.t[-1]) for each in curves), default=1.0)
            frame = _Frame(left, left + width, top, bottom, (0.0, long), _around(curves))
            x = 0.5 * (left + left + width)
            parts.append(_text(x, top - 0.6 * _FONT, phase, style='fill:var(--soft)'))
            inside = ['', _zero(frame, None)]
            inside += [_with_errors(frame, each, colours[each.trial]) for each in curves]
            parts += _axes(frame, _TICKS_OF_A_RESIDUAL, True, inside)
        top = bottom + 6.0 * _FONT
    for column in range(len(phases)):
        x = _LEFT + column * (width + _ROOM_BETWEEN_CURVES) + 0.5 * width
        parts.append(_text(x, top - 1.8 * _FONT, 'Time [s]'))
    box = f'0 0 {_number(_WIDTH)} {_number(top - _FONT)}'
    style = f'font-size:{_FONT}px;fill:var(--ink)'
    return f'<svg viewBox="{box}" style="{style}">\n' + '\n'.join(parts) + '\n</svg>'


def _around(curves: Sequence[SmoothLine]) -> Window:
    """Return the limits of curves with their usual errors, and zero."""
    ends = [0.0]
    for each in curves:
        # The first corners have few samples, and errors beside which nothing else would show.
        std = np.minimum(each.std, np.median(each.std))
        ends += [float(np.min(each.value - std)), float(np.max(each.value + std))]
    low, high = min(ends), max(ends)
    margin = 0.06 * (high - low) or 1.0
    return low - margin, high + margin


def _with_errors(frame: _Frame, curve: SmoothLine, colour: str) -> str:
    """Return a curve with a bar for the error at each corner."""
    bars = ''.join(
        f'M{_number(frame.x(t))},{_number(frame.y(low))}V{_number(frame.y(high))}'
        for t, low, high in zip(
            curve.t.tolist(),
            (curve.value - curve.std).tolist(),
            (curve.value + curve.std).tolist(),
            strict=True,
        )
    )
    path = _polyline(frame.points(curve.t, curve.value))
    return _path(bars, f'{_pen(colour, 2.2)};opacity:0.35') + _path(path, _pen(colour, 1.2))


def _names_of_trials(colours: Mapping[str, str]) -> list[str]:
    """Return the names of the trials beside their colours, in rows."""
    rows, x = [''], _LEFT
    for name, colour in colours.items():
        width = _LEGEND_LINE + 6.0 + _LETTER * len(name)
        if x > _LEFT and x + width > _RIGHT:
            rows.append('')
            x = _LEFT
        rows[-1] += _path(f'M{_number(x)},12h{_LEGEND_LINE}', _pen(colour, 1.5))
        rows[-1] += _text(x + _LEGEND_LINE + 6.0, 12.0 + 0.36 * _FONT, escape(name), 'start')
        x += width + _LEGEND_GAP
    return rows


def _zero(frame: _Frame, noise: float | None) -> str:
    """Return the line of no residual, and the band of the noise about it."""
    y = _number(frame.y(0.0))
    zero = _path(f'M{_number(frame.left)},{y}H{_number(frame.right)}', _pen('var(--ink)', 0.6))
    if not noise:
        return zero
    band = _NOISE_BAND_SIGMAS * noise
    ends = frame.y(band), frame.y(-band)
    return _rectangle(frame.left, frame.right, *ends, 'var(--band)') + zero


def _names_of_rows(rows: int) -> tuple[str, ...]:
    """Return what the rows of residuals are called."""
    return ('Residual',) if rows == 1 else ('Before', 'After')[:rows]
