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


"""Pictures of a signal against its fits, as SVG that takes its colours from the page."""

from dataclasses import dataclass
import io
import math
import re
from typing import Final, Literal, TYPE_CHECKING

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.report.decimation import line
import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes

type Window = tuple[float, float]
type Role = Literal['measured', 'tool', 'paper', 'base', 'after']

_BINS: Final = 500
_MARKERS_UP_TO: Final = 150
_ROOM_FOR_A_LETTER: Final = 0.009
_ROOM_BESIDE_A_NAME: Final = 0.035
_COLUMNS: Final = (1.0, 2.3)
# A layout that is computed from the extent of every label takes longer than all the drawing.
_MARGINS: Final[dict[str, float]] = {
    'left': 0.1,
    'right': 0.992,
    'bottom': 0.115,
    'top': 0.83,
    'hspace': 0.1,
    'wspace': 0.12,
}
_CLOSE_UP_BELOW: Final = 0.2
_LABEL_PLACE: Final = -0.085
_WIDTH_IN: Final = 9.6
_HEIGHT_IN: Final = 4.3
_ROW_IN: Final = 1.0
_NOISE_BAND_SIGMAS: Final = 2.0
_RESIDUAL_WIDTH: Final = 0.8
_GLITCH_SHARE: Final = 0.002
_GLITCH_RATIO: Final = 2.0

# Each stands for a CSS variable of the page, so that a dark screen and white paper both read
# well. The values never reach the page.
_INK: Final = '#010203'
_GRID: Final = '#010204'
_SOFT: Final = '#01020b'
_BAND: Final = '#010205'
_SHADES: Final = ('#010206', '#010207')
_INDEX: Final = '<tspan dy="0.25em" font-size="75%">'
_COLOURS: Final[dict[Role, str]] = {
    'measured': '#010208',
    'tool': '#01020c',
    'paper': '#010209',
    'base': '#01020a',
    'after': '#01020d',
}
_VARIABLES: Final = {
    _INK: 'var(--ink)',
    _GRID: 'var(--grid)',
    _SOFT: 'var(--soft)',
    _BAND: 'var(--band)',
    _SHADES[0]: 'var(--shade-a)',
    _SHADES[1]: 'var(--shade-b)',
    _COLOURS['measured']: 'var(--measured)',
    _COLOURS['tool']: 'var(--tool)',
    _COLOURS['paper']: 'var(--paper-fit)',
    _COLOURS['base']: 'var(--base-fit)',
    _COLOURS['after']: 'var(--after-fit)',
}
_DASHES: Final[dict[Role, str]] = {
    'measured': '-',
    'tool': ':',
    'paper': '--',
    'base': '-',
    'after': '-',
}
_WIDTHS: Final[dict[Role, float]] = {
    'measured': 1.1,
    'tool': 1.3,
    'paper': 1.9,
    'base': 1.5,
    'after': 1.5,
}


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


def _within(series: Series, window: Window) -> tuple[FloatArray, FloatArray]:
    """Return the samples in a window and one beyond each end, so that lines reach the frame."""
    first = max(0, int(np.searchsorted(series.t, window[0])) - 1)
    last = int(np.searchsorted(series.t, window[1], side='right')) + 1
    return series.t[first:last], series.value[first:last]


def _draw(axes: 'Axes', series: Series, window: Window, thin: bool) -> None:
    t, value = line(*_within(series, window), _BINS)
    few = series.role == 'measured' and series.t.size <= _MARKERS_UP_TO
    axes.plot(
        t,
        value,
        color=_COLOURS[series.role],
        linestyle='none' if few else ('-' if thin else _DASHES[series.role]),
        marker='o' if few else None,
        markersize=3.2,
        linewidth=_RESIDUAL_WIDTH if thin else _WIDTHS[series.role],
        label=series.label,
        solid_joinstyle='round',
    )


def _shade(axes: 'Axes', panel: Panel) -> None:
    for number, phase in enumerate(panel.phases):
        axes.axvspan(phase.start, phase.stop, color=_SHADES[number % 2], linewidth=0, zorder=-2)
    for mark in panel.marks:
        axes.axvline(mark.t, color=_INK, linewidth=0.7, linestyle=(0, (2, 2)), zorder=-1)


def _limits(lines: tuple[Series, ...], window: Window, robust: bool) -> Window | None:
    """
    Return the least and the greatest value in a window of time, with a margin.

    With `robust`, a few glitches that would squeeze all else into a line are left out.
    """
    parts = [_within(series, window)[1] for series in lines]
    values = np.concatenate([part[np.isfinite(part)] for part in parts])
    if not values.size:
        return None
    lowest, highest = float(values.min()), float(values.max())
    if robust:
        low, high = np.quantile(values, (_GLITCH_SHARE, 1.0 - _GLITCH_SHARE))
        if highest - lowest > _GLITCH_RATIO * (high - low) > 0.0:
            centre, half = 0.5 * (low + high), 0.6 * (high - low)
            lowest, highest = max(lowest, centre - half), min(highest, centre + half)
    margin = 0.06 * (highest - lowest) or 0.06 * abs(highest) or 1.0
    return lowest - margin, highest + margin


def _point_at_what_is_off(axes: 'Axes', lines: tuple[Series, ...], window: Window) -> None:
    """Set a triangle at the frame where samples lie beyond it."""
    low, high = axes.get_ylim()
    for series in lines:
        t, value = line(*_within(series, window), _BINS)
        seen = (t >= window[0]) & (t <= window[1])
        t, value = t[seen], value[seen]
        for beyond, edge, marker in ((value > high, high, '^'), (value < low, low, 'v')):
            (triangles,) = axes.plot(
                t[beyond],
                np.full(int(beyond.sum()), edge),
                linestyle='none',
                marker=marker,
                markersize=5.0,
                color=_COLOURS[series.role],
                clip_on=False,
            )
            # An empty line has no extent: it would upset the layout.
            triangles.set_in_layout(False)


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
    return float(measured[0]), float(measured[-1])


def _label_phases(axes: 'Axes', panel: Panel, window: Window, share: float) -> None:
    """
    Write the instants above the frame, and the phases where there is room for them.

    The panel takes `share` of the picture's width.
    """
    transform = axes.get_xaxis_transform()
    width = window[1] - window[0]
    right_of_last = -math.inf
    row = 0
    for mark in panel.marks:
        if not window[0] <= mark.t <= window[1]:
            continue
        # Two instants too close to each other to be told apart stand one above the other.
        close = share * (mark.t - right_of_last) < _ROOM_BESIDE_A_NAME * width
        row = row + 1 if close else 0
        right_of_last = mark.t
        axes.text(
            mark.t,
            1.015 + 0.075 * row,
            mark.symbol,
            transform=transform,
            ha='center',
            va='bottom',
            color=_INK,
            fontsize=9,
            style='italic',
        )
    for phase in panel.phases:
        start, stop = max(phase.start, window[0]), min(phase.stop, window[1])
        room = _ROOM_BESIDE_A_NAME + _ROOM_FOR_A_LETTER * len(phase.name)
        if share * (stop - start) > room * width:
            axes.text(
                0.5 * (start + stop),
                1.015,
                phase.name,
                transform=transform,
                ha='center',
                va='bottom',
                color=_SOFT,
                fontsize=8.5,
            )


def svg(panel: Panel, salt: str) -> str:
    """
    Draw a panel: signal and fits above, residuals with the band of the noise below.

    A push too short to be seen in the whole trial gets a column of its own, on the left.

    Parameters
    ----------
    panel : Panel
        What to draw.
    salt : str
        Sets the picture's identifiers apart from those of the page's other pictures.

    Returns
    -------
    str
        An ``<svg>`` element for a page that defines the CSS variables ``--ink``, ``--soft``,
        ``--grid``, ``--band``, ``--shade-a``, ``--shade-b``, ``--measured``,
        ``--tool``, ``--paper-fit``, ``--base-fit`` and ``--after-fit``.

    """
    import matplotlib as mpl
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    span = _span(panel)
    close_up = _close_up(panel, span)
    windows = [span] if close_up is None else [close_up, span]
    shares = [1.0] if close_up is None else [one / sum(_COLUMNS) for one in _COLUMNS]
    with mpl.rc_context(
        {
            'svg.fonttype': 'none',
            'svg.hashsalt': salt,
            'font.family': 'sans-serif',
            'font.size': 9.5,
            'text.color': _INK,
            'axes.edgecolor': _INK,
            'axes.labelcolor': _INK,
            'xtick.color': _INK,
            'ytick.color': _INK,
            'axes.linewidth': 0.7,
            'axes.spines.top': False,
            'axes.spines.right': False,
            'grid.color': _GRID,
            'grid.linewidth': 0.6,
            'axes.unicode_minus': True,
            'path.simplify': True,
        }
    ):
        rows = len(panel.residuals)
        figure = Figure(figsize=(_WIDTH_IN, _HEIGHT_IN + _ROW_IN * max(0, rows - 1)))
        figure.subplots_adjust(**_margins(figure.get_figheight()))
        FigureCanvasSVG(figure)
        figure.patch.set_alpha(0.0)
        grid = figure.subplots(
            1 + rows,
            len(windows),
            squeeze=False,
            sharex='col',
            height_ratios=[2.6, *[1.0] * rows],
            width_ratios=shares,
        )
        for column, window in enumerate(windows):
            top = grid[0][column]
            for series in panel.lines:
                _draw(top, series, window, thin=False)
            _label_phases(top, panel, window, shares[column])
            content = [(top, panel.lines)]
            for below, residuals in zip(grid[1:, column], panel.residuals, strict=True):
                if panel.noise:
                    band = _NOISE_BAND_SIGMAS * panel.noise
                    below.axhspan(-band, band, color=_BAND, linewidth=0, zorder=0)
                below.axhline(0.0, color=_INK, linewidth=0.6)
                for series in residuals:
                    _draw(below, series, window, thin=True)
                content.append((below, residuals))
            for axes, lines in content:
                _shade(axes, panel)
                axes.set_xlim(*window)
                limits = _limits(lines, window, robust=axes is not top)
                if limits is not None:
                    axes.set_ylim(*limits)
                    _point_at_what_is_off(axes, lines, window)
                axes.grid(axis='y')
                axes.set_axisbelow(True)
                axes.patch.set_alpha(0.0)
                axes.locator_params(axis='y', nbins=6 if axes is top else 4)
            content[-1][0].set_xlabel('Time [s]')
        grid[0][0].set_ylabel(f'{panel.quantity} [{panel.unit}]')
        for below, name in zip(grid[1:, 0], _names_of_rows(rows), strict=True):
            below.set_ylabel(f'{name} [{panel.unit}]')
        for axes in grid[:, 0]:
            axes.yaxis.set_label_coords(_LABEL_PLACE / shares[0], 0.5)
        handles, labels = grid[0][-1].get_legend_handles_labels()
        figure.legend(
            handles,
            labels,
            loc='upper center',
            ncols=len(labels),
            frameon=False,
            handlelength=2.4,
        )
        stream = io.StringIO()
        figure.savefig(stream, format='svg', metadata={'Date': None})
    return _for_a_page(stream.getvalue())


def _names_of_rows(rows: int) -> tuple[str, ...]:
    """Return what the rows of residuals are called."""
    return ('Residual',) if rows == 1 else ('Before', 'After')[:rows]


def _margins(height: float) -> dict[str, float]:
    """Return the margins of a picture of some height [in]: what is beside the axes stays so."""
    share = _HEIGHT_IN / height
    return {
        **_MARGINS,
        'bottom': _MARGINS['bottom'] * share,
        'top': 1.0 - (1.0 - _MARGINS['top']) * share,
    }


def _for_a_page(document: str) -> str:
    """Return the ``<svg>`` element of a document, small and in the page's colours."""
    element = document.removeprefix(document.partition('<svg')[0])
    element = re.sub(r'<metadata>.*?</metadata>\s*', '', element, flags=re.DOTALL)
    element = re.sub(r'<style type="text/css">.*?</style>\s*', '', element, flags=re.DOTALL)
    # Identifiers of groups repeat from picture to picture; nothing refers to them.
    element = re.sub(r'<g id="[^"]*"', '<g', element)
    element = re.sub(r' d="[^"]*"', _short_path, element)
    element = re.sub(r'>(\w)_(\w+)</text>', rf'>\1{_INDEX}\2</tspan></text>', element)
    for placeholder, variable in _VARIABLES.items():
        element = element.replace(placeholder, variable)
    return re.sub(r'<svg [^>]*?viewBox="([^"]*)"[^>]*>', r'<svg viewBox="\1">', element, count=1)


def _short_path(path: re.Match[str]) -> str:
    """Return a path's coordinates with two decimals: a hundredth of a point is no pixel."""
    return re.sub(r'(\.\d\d)\d+', r'\1', path[0]).replace(' \n', ' ')
