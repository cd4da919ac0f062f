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
Reads measured CSV files, whoever wrote them, and makes contract bags of them.

A column is known by its name with the unit in it (``force_N``) or by a choice that the caller
makes for it. What a cell, a row or a file cannot give is left out and told, never guessed.
"""

from bisect import bisect_left
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
import csv
from dataclasses import dataclass
import hashlib
from importlib.metadata import version
import math
from pathlib import Path
import re
import shutil
from typing import Final

from hapticvision_ros.bag.contract import Qos, Topic
from hapticvision_ros.bag.writer import METADATA_FILE, write_signals
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.records import FloatArray, Signal
from hapticvision_ros.core.units import FORCE_UNITS, LENGTH_UNITS, TIME_UNITS
import numpy as np
from numpy.typing import NDArray

UNITS: Final[Mapping[str, Mapping[str, float]]] = {
    'time': TIME_UNITS,
    'force': FORCE_UNITS,
    'displacement': LENGTH_UNITS,
    'tool_displacement': LENGTH_UNITS,
    'force_sd': FORCE_UNITS,
}
"""What a column can hold, and the units that each may have."""
NEEDED: Final = ('time', 'force', 'displacement')
SIGNED: Final = ('force', 'displacement', 'tool_displacement')
MINUS: Final = '-'
"""Before a unit: the column counts the other way, as where a machine counts tension."""
DELIMITERS: Final = ',;\t|'
COMMENT_MARKS: Final = ('#', '%', '//')
MAX_PREAMBLE_LINES: Final = 200
"""The header is looked for in as many lines; instruments write up to a few dozen before it."""
MAX_BYTES: Final = 2 * 1024**3
"""A larger file would not fit into the memory of a small machine together with its numbers."""
MAX_LOST_SHARE: Final = 0.1
"""More rows than this against the order of time are no glitch but several recordings."""
MAX_EXAMPLES: Final = 3
"""As many faults of one kind are told with their line; the rest are counted."""
_MANY_ROWS: Final = 30
"""From as many rows on, decimals alike in all of them are no chance."""
_LOOKED_AT: Final = 1000
"""Last rows that are looked at for that."""

DEFAULT_HEIGHT: Final = 0.05
"""Original height [m] where nobody says one; heights are then relative to it."""
NOMINAL_START_NS: Final = 946_684_800 * 10**9
"""2000-01-01T00:00:00Z: the time zero of a file that does not say when it was recorded."""
MAX_STAMP_NS: Final = (2**31 - 1) * 10**9
"""The seconds of a ROS stamp are a signed 32-bit number."""

FORCE_SD: Final = Topic(
    name='/load_cell/force_sd',
    msgtype='std_msgs/msg/Float64',
    unit='N',
    frame_id='load_cell',
    rate_hz=None,
    required=False,
    stamped=False,
    qos=Qos(),
    meaning='Standard deviation of the force over repeated measurements, where the source has it; '
    'outside the contract.',
)

_THOUSANDS: Final = re.compile(r'[+-]?[1-9]\d{0,2}([.,]\d{3})+')
_NUMBER: Final = re.compile(r'[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?')
_BINARY_KINDS: Final = (
    (b'PK\x03\x04', 'an Excel workbook or zip archive: export it as CSV'),
    (b'\xd0\xcf\x11\xe0', 'an old Excel workbook: export it as CSV'),
    (b'\x89MCAP', 'an MCAP bag already: give it to `hapticvision fit`'),
)


@dataclass(frozen=True, slots=True)
class Column:
    """
    A column of a CSV file and what it holds.

    Parameters
    ----------
    quantity : str
        A key of `UNITS`.
    header : str
        The column's name in the file.
    unit : str
        A unit of the quantity; with a minus before it where the column counts the other way.

    """

    quantity: str
    header: str
    unit: str

    @property
    def scale(self) -> float:
        """Return the SI value of one unit, negative where the column counts the other way."""
        size = UNITS[self.quantity][self.unit.removeprefix(MINUS)]
        return -size if self.unit.startswith(MINUS) else size

    @classmethod
    def parse(cls, text: str) -> 'Column':
        """
        Read a choice made on the command line, ``QUANTITY=HEADER:UNIT``.

        A minus before the unit turns the sign of what has one.

        Raises
        ------
        UsageError
            If the text has another form, names an unknown quantity or unit, or turns the sign of
            what has none.

        """
        quantity, equals, rest = text.partition('=')
        header, colon, unit = rest.rpartition(':')
        if not (equals and colon and header):
            raise UsageError(
                f"'{text}' is no column: write QUANTITY=HEADER:UNIT, as in 'force=Kraft [N]:N'."
            )
        if quantity not in UNITS:
            raise UsageError(f"'{text}': there is no quantity '{quantity}'; use {_either(UNITS)}.")
        unit = _plain_unit(unit).replace('\u2212', MINUS)
        if unit.startswith(MINUS):
            unit = MINUS + unit.removeprefix(MINUS).lstrip()
        if unit.removeprefix(MINUS) not in UNITS[quantity]:
            raise UsageError(
                f"'{text}': '{unit}' is no unit of {quantity}; use {_either(UNITS[quantity])}."
            )
        if unit.startswith(MINUS) and quantity not in SIGNED:
            raise UsageError(f"'{text}': a {quantity} has no sign to turn; leave the minus out.")
        return cls(quantity, header, unit)


@dataclass(frozen=True, slots=True)
class Measurement:
    """
    What a CSV file holds, in SI units.

    Parameters
    ----------
    signals : mapping of str to Signal
        The samples of each quantity of `UNITS` but time, where its column exists.
    columns : tuple of Column
        Where they come from.
    row_count : int
        Rows of the file below its header.
    encoding, delimiter, decimal : str
        How the file was read.
    sha256 : str
        Digest of the file.
    warnings : tuple of str
        What was left out, one sentence each.

    """

    signals: Mapping[str, Signal]
    columns: tuple[Column, ...]
    row_count: int
    encoding: str
    delimiter: str
    decimal: str
    sha256: str
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class ImportedTrial:
    """
    What became of a CSV file.

    Parameters
    ----------
    bag : Path
        The rosbag2 directory that was made.
    row_count : int
        Rows of the file below its header.
    sample_counts : mapping of str to int
        Samples of each quantity in the bag.
    warnings : tuple of str
        What was left out, one sentence each.

    """

    bag: Path
    row_count: int
    sample_counts: Mapping[str, int]
    warnings: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class _Header:
    """The header: its index among the lines, the delimiter, the names, the chosen columns."""

    index: int
    delimiter: str
    names: tuple[str, ...]
    columns: tuple[Column, ...]


@dataclass(frozen=True, slots=True)
class _Cells:
    """
    The cells of the chosen columns: values, shape (rows, columns), and the rows' line numbers.

    `texts` holds, by line number and column, what stood where there is no number.
    """

    values: FloatArray
    numbers: NDArray[np.int64]
    decimal: str
    texts: Mapping[tuple[int, int], str]
    warnings: list[str]


def _either(names: Iterable[str]) -> str:
    *rest, last = names
    return f'{", ".join(rest)} or {last}' if rest else last


def _plain_unit(unit: str) -> str:
    return unit.strip().replace('\u00b5', 'u').replace('\u03bc', 'u')


def _decode(path: Path, data: bytes) -> tuple[str, str]:
    """Return the text of a file and its encoding."""
    for magic, kind in _BINARY_KINDS:
        if data.startswith(magic):
            raise InputError(f'{path} is {kind}.')
    if data.startswith((b'\xff\xfe', b'\xfe\xff')):
        encoding = 'utf-16'
    elif b'\0' in data:
        raise InputError(f'{path} is a binary file: export the measurement as CSV text.')
    else:
        encoding = 'utf-8-sig' if data.startswith(b'\xef\xbb\xbf') else 'utf-8'
    try:
        return data.decode(encoding), encoding
    except UnicodeDecodeError as error:
        if encoding == 'utf-16':
            raise InputError(f'{path} is cut off or no UTF-16 text: export it again.') from error
        # Every byte is a letter in Latin-1, and only headers hold letters beyond ASCII.
        return data.decode('latin-1'), 'latin-1'


def _cells(line: str, delimiter: str) -> list[str]:
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:
        return [cell.strip() for cell in line.split(delimiter)]


def _named_columns(names: Sequence[str]) -> list[Column]:
    """Return the columns whose names hold their quantity and unit."""
    found = []
    for name in names:
        quantity, _, unit = name.rpartition('_')
        quantity, unit = quantity.lower(), _plain_unit(unit)
        if unit in UNITS.get(quantity, ()):
            found.append(Column(quantity, name, unit))
    return found


def _find_header(path: Path, lines: Sequence[str], choices: Sequence[Column]) -> _Header:
    """Return the first line that names all columns that are needed."""
    best: _Header | None = None
    for index, line in enumerate(lines[:MAX_PREAMBLE_LINES]):
        for delimiter in DELIMITERS:
            names = tuple(_cells(line, delimiter))
            chosen = [choice for choice in choices if choice.header in names]
            taken = {choice.quantity for choice in chosen}
            headers = {choice.header for choice in chosen}
            columns = chosen + [
                column
                for column in _named_columns(names)
                if column.quantity not in taken and column.header not in headers
            ]
            header = _Header(index, delimiter, names, tuple(columns))
            if best is None or _promise(header) > _promise(best):
                best = header
    if best is None:
        raise InputError(f'{path} is empty: there is nothing to import.')
    _check_header(path, best, choices)
    return best


def _promise(header: _Header) -> tuple[int, int]:
    """Return how much a line looks like the header: known columns, then cells with letters."""
    words = [name for name in header.names if name and not _NUMBER.fullmatch(name)]
    return len({column.quantity for column in header.columns}), len(words) if header.names else 0


def _check_header(path: Path, header: _Header, choices: Sequence[Column]) -> None:
    where = f'{path}, line {header.index + 1}'
    for quantity, count in Counter(column.quantity for column in header.columns).items():
        if count > 1:
            rivals = [column.header for column in header.columns if column.quantity == quantity]
            if len(set(rivals)) == 1:
                raise InputError(
                    f"{where}: two columns are called '{rivals[0]}'; rename one of them."
                )
            raise InputError(
                f'{where}: {_either(rivals)} could be the {quantity}; choose one, as in '
                f"--column '{quantity}={rivals[0]}:{next(iter(UNITS[quantity]))}'."
            )
    for column in header.columns:
        if header.names.count(column.header) > 1:
            raise InputError(
                f"{where}: two columns are called '{column.header}'; rename one of them."
            )
    found = {column.quantity for column in header.columns}
    for choice in choices:
        if choice not in header.columns:
            raise InputError(
                f"{path} has no column '{choice.header}'; its columns are {_quoted(header.names)}."
            )
    for quantity in NEEDED:
        if quantity in found:
            continue
        units = UNITS[quantity]
        for name in header.names:
            if name.lower() == quantity:
                raise InputError(
                    f"{where}: the column '{name}' has no unit; rename it to "
                    f'{_either(f"{quantity}_{unit}" for unit in units)}, or say it with '
                    f"--column '{quantity}={name}:{next(iter(units))}'."
                )
            if name.lower().startswith(f'{quantity}_'):
                raise InputError(
                    f"{where}: the unit of the column '{name}' is not known; use "
                    f'{_either(f"{quantity}_{unit}" for unit in units)}.'
                )
        example = f"--column '{quantity}=NAME:{next(iter(units))}'"
        if not any(re.search(r'[^\W\d]', name) for name in header.names):
            raise InputError(
                f'{path} has no header line; add one, such as time_s,force_N,displacement_mm.'
            )
        raise InputError(
            f'{where}: no column holds the {quantity}; name one {quantity}_{next(iter(units))}, '
            f'or choose one with {example}; the columns are {_quoted(header.names)}.'
        )


def _quoted(names: Sequence[str]) -> str:
    shown = [f"'{name}'" for name in names[:10]]
    return ', '.join([*shown, '...'] if len(names) > len(shown) else shown)


def _body(lines: Sequence[str], header: _Header) -> tuple[list[str], NDArray[np.int64]]:
    """Return the rows below the header and their line numbers."""
    rows, numbers = [], []
    blank = header.delimiter + ' \t"'
    first = header.index + 1
    for number, line in enumerate(lines[first:], start=first + 1):
        if line.strip(blank) and not line.lstrip().startswith(COMMENT_MARKS):
            rows.append(line)
            numbers.append(number)
    return rows, np.array(numbers, dtype=np.int64)


def _is_cut(rows: Sequence[str], delimiter: str) -> bool:
    """Return whether the last row, which has no end, is cut: one of its numbers lacks digits."""
    *whole, last = ([cell.replace(',', '.') for cell in _cells(r, delimiter)] for r in rows)
    widths = {len(cells) for cells in whole}
    if len(widths) != 1 or not _NUMBER.fullmatch(last[0]):
        return False
    (width,) = widths
    if len(last) != width:
        return len(last) < width
    # As many decimals in each of many rows are the program's, unless they are of one number.
    ends = {cells[-1] for cells in whole}
    decimals = {len(end.partition('.')[2]) for end in ends}
    if len(whole) < _MANY_ROWS or len(ends) < 2 or len(decimals) != 1:
        return False
    return len(last[-1].partition('.')[2]) < decimals.pop()


def _fast_values(rows: Sequence[str], header: _Header, places: list[int]) -> FloatArray | None:
    """Return the cells of a file without any irregularity, shape (rows, columns), or None."""
    widths = {row.count(header.delimiter) for row in rows}
    if widths != {len(header.names) - 1} or any('"' in row for row in rows):
        return None
    try:
        values: FloatArray = np.loadtxt(
            rows, delimiter=header.delimiter, usecols=places, ndmin=2, comments=None
        )
    except ValueError:
        return None
    return values


def _decimal_mark(cells: Iterable[str]) -> str:
    """Return the mark of most numbers that one mark tells; a comma where no number has a point."""
    found = dict.fromkeys('.,', 0)
    clear = dict(found)
    for cell in cells:
        for mark in found:
            if mark in cell and _NUMBER.fullmatch(cell.replace(mark, '.', 1)):
                found[mark] += 1
                # Three digits after it may be thousands.
                clear[mark] += not _THOUSANDS.fullmatch(cell)
    if not found['.']:
        return ',' if found[','] else '.'
    return ',' if clear[','] > clear['.'] else '.'


def _careful_values(
    path: Path,
    rows: Sequence[str],
    numbers: NDArray[np.int64],
    header: _Header,
    places: list[int],
) -> _Cells:
    """Return the cells of any file, NaN where one is no number."""
    table: list[list[str]] = []
    wide, kept = [], []
    width = len(header.names)
    for row, number in zip(rows, numbers.tolist(), strict=True):
        cells = _cells(row, header.delimiter)
        if any(cells[width:]):
            wide.append(number)
            continue
        cells += [''] * (width - len(cells))
        table.append([cells[place] for place in places])
        kept.append(number)
    if len(wide) > MAX_LOST_SHARE * len(rows):
        raise InputError(
            f'{path}, line {wide[0]}: more cells than the {width} columns of the '
            'header; where the decimal mark is a comma, columns must be separated by semicolons, '
            'tabs or quotes.'
        )
    warnings = []
    if wide:
        warnings.append(_told(path, wide, 'more cells than the header has', 'row'))
    decimal = _decimal_mark(cell for cells in table for cell in cells)
    other = '.' if decimal == ',' else ','
    values = np.full((len(table), len(places)), math.nan)
    texts: dict[tuple[int, int], str] = {}
    for i, (number, cells) in enumerate(zip(kept, table, strict=True)):
        for j, cell in enumerate(cells):
            text = cell.replace(',', '.') if decimal == ',' else cell
            # A mark of thousands, say, must not pass for the decimal one.
            if other not in cell and _NUMBER.fullmatch(text):
                values[i, j] = float(text)
            elif cell:
                texts[number, j] = cell[:40]
    return _Cells(values, np.array(kept, dtype=np.int64), decimal, texts, warnings)


def _told(path: Path, lines: Sequence[int], what: str, lost: str) -> str:
    """Return one sentence on one kind of fault."""
    shown = ', '.join(map(str, lines[:MAX_EXAMPLES])) + (' ...' if lines[MAX_EXAMPLES:] else '')
    count = f'1 {lost} is' if len(lines) == 1 else f'{len(lines)} {lost}s are'
    return f'{path}, line {shown}: {what}; {count} left out.'


def _longest_rising(stamps: Sequence[int]) -> list[int]:
    """Return the indices of a longest strictly increasing subsequence."""
    tails: list[int] = []
    ends: list[int] = []
    previous = []
    for i, stamp in enumerate(stamps):
        place = bisect_left(tails, stamp)
        previous.append(ends[place - 1] if place else -1)
        if place == len(tails):
            tails.append(stamp)
            ends.append(i)
        elif tails[place] != stamp:
            tails[place] = stamp
            ends[place] = i
    kept = []
    i = ends[-1]
    while i >= 0:
        kept.append(i)
        i = previous[i]
    return kept[::-1]


def _rising(
    path: Path, t: FloatArray, numbers: NDArray[np.int64]
) -> tuple[NDArray[np.int64], list[str]]:
    """Return which rows to keep so that time increases, to the nanosecond; warnings."""
    stamps = np.rint(t * 1e9).astype(np.int64)
    steps = np.diff(stamps)
    if (steps > 0).all():
        return np.arange(t.size), []
    kept = np.array(_longest_rising(stamps.tolist()), dtype=np.int64)
    lost = np.setdiff1d(np.arange(t.size), kept)
    backward = np.flatnonzero(steps < 0)
    if backward.size and lost.size > max(1.0, MAX_LOST_SHARE * t.size):
        first = int(backward[0])
        raise InputError(
            f'{path}, line {numbers[first + 1]}: time falls from {t[first]:g} s to '
            f'{t[first + 1]:g} s; where the file holds several recordings, split it.'
        )
    what = 'time does not increase'
    return kept, [_told(path, numbers[lost].tolist(), what, 'row')]


def _strike_unusable(path: Path, cells: _Cells, columns: Sequence[Column]) -> list[str]:
    """Turn times that no stamp can hold into NaN; tell of all cells that are not finite."""
    values, texts, numbers = cells.values, cells.texts, cells.numbers
    time = [column.quantity for column in columns].index('time')
    values[~(np.abs(values[:, time]) <= MAX_STAMP_NS / 1e9), time] = math.nan
    usable = np.isfinite(values)
    wordy = ~usable.any(axis=1)
    if wordy.all():
        wordy[:] = False
    warnings = []
    if wordy.any():
        warnings.append(_told(path, numbers[wordy].tolist(), 'no usable number', 'row'))
    for j, column in enumerate(columns):
        lost = numbers[~(usable[:, j] | wordy)].tolist()
        if not lost:
            continue
        cell = f"'{texts[lost[0], j]}'" if (lost[0], j) in texts else 'a cell'
        what = f"{cell} under '{column.header}' is not a usable number"
        if column.quantity in NEEDED and not usable[:, j].any():
            raise InputError(
                f'{path}, line {lost[0]}: {what}, nor is any other cell of this column; write '
                'plain numbers with one decimal mark in all columns.'
            )
        kind = 'row' if column.quantity == 'time' else 'sample'
        warnings.append(_told(path, lost, what, kind))
    return warnings


def read_csv(path: Path, choices: Sequence[Column] = ()) -> Measurement:
    """
    Read a measured CSV file.

    Delimiter (comma, semicolon, tab, bar), decimal mark, encoding (UTF-8, UTF-16, Latin-1) and
    the lines before the header are found from the file itself.

    Parameters
    ----------
    path : Path
        The file.
    choices : sequence of Column
        Columns whose names do not hold quantity and unit; they go before those that do.

    Returns
    -------
    Measurement
        All samples that the file gives, in SI units. A cell that is no number costs one sample
        of its own quantity, not its row.

    Raises
    ------
    InputError
        If the file cannot be read, a needed column or its unit is missing, or fewer than two
        samples are left.

    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputError(
                f'{path} has {path.stat().st_size / 1024**3:.1f} GiB, more than '
                f'{MAX_BYTES / 1024**3:.0f}: split it or leave out rows.'
            )
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f'{path} cannot be read ({error.strerror}).') from error
    text, encoding = _decode(path, data)
    lines = text.splitlines()
    if not text.strip():
        raise InputError(f'{path} is empty: there is nothing to import.')
    header = _find_header(path, lines, choices)
    rows, numbers = _body(lines, header)
    if not rows:
        raise InputError(f'{path} has a header and no rows: there is nothing to import.')
    cut = []
    count = len(rows)
    at_the_end = numbers[-1] == len(lines) and not text.endswith(('\n', '\r'))
    if at_the_end and count > 1 and _is_cut(rows[-_LOOKED_AT:], header.delimiter):
        cut = [f'{path}, line {numbers[-1]}: the file is cut off within this row, left out.']
        rows, numbers = rows[:-1], numbers[:-1]
    places = [header.names.index(column.header) for column in header.columns]
    values = _fast_values(rows, header, places)
    if values is None:
        cells = _careful_values(path, rows, numbers, header, places)
    else:
        cells = _Cells(values, numbers, '.', {}, [])
    cells.values[:] *= [column.scale for column in header.columns]
    warnings = cells.warnings + _strike_unusable(path, cells, header.columns)
    series = {column.quantity: cells.values[:, j] for j, column in enumerate(header.columns)}
    signals, faults = _signals(path, series, cells.numbers)
    return Measurement(
        signals=signals,
        columns=header.columns,
        row_count=count,
        encoding=encoding,
        delimiter=header.delimiter,
        decimal=cells.decimal,
        sha256=hashlib.sha256(data).hexdigest(),
        warnings=(*cut, *warnings, *faults),
    )


def _signals(
    path: Path, series: Mapping[str, FloatArray], numbers: NDArray[np.int64]
) -> tuple[dict[str, Signal], list[str]]:
    """Return the samples that are numbers at increasing times, and what was left out."""
    timed = np.flatnonzero(np.isfinite(series['time']))
    kept, warnings = _rising(path, series['time'][timed], numbers[timed])
    rows = timed[kept]
    signals = {}
    for quantity, values in series.items():
        if quantity == 'time':
            continue
        good = rows[np.isfinite(values[rows])]
        if good.size < 2:
            if quantity not in NEEDED:
                continue
            if timed.size > 1 and np.ptp(series['time'][timed]) == 0.0:
                raise InputError(f'{path}: the time is the same in all rows.')
            raise InputError(
                f'{path} holds {good.size} usable sample{"s" * (good.size != 1)} of the '
                f'{quantity}; a trial needs at least two.'
            )
        signals[quantity] = Signal(series['time'][good], values[good])
    return signals, warnings


def import_csv(
    path: Path,
    folder: Path,
    *,
    choices: Sequence[Column] = (),
    original_height: float | None = None,
    start_ns: int | None = None,
    replace: bool = False,
) -> ImportedTrial:
    """
    Make a contract bag of a measured CSV file, named after it.

    Parameters
    ----------
    path : Path
        The CSV file.
    folder : Path
        Where the rosbag2 directory goes.
    choices : sequence of Column
        Columns whose names do not hold quantity and unit.
    original_height : float, optional
        Height of the object before the push [m]. The tool's height is this less the tool's
        displacement; the default, `DEFAULT_HEIGHT`, moves all heights alike and no displacement.
    start_ns : int, optional
        The file's time zero [ns since the epoch]. Where nobody says it and the file's times do
        not count from the epoch themselves, it is nominal: `NOMINAL_START_NS`.
    replace : bool
        Whether a bag that is there already gives way.

    Returns
    -------
    ImportedTrial
        The bag and what went into it.

    Raises
    ------
    InputError
        If the file cannot be used, or the bag is there already or cannot be written. Nothing is
        left half made.

    """
    bag = folder / path.stem
    if bag.exists() and not replace:
        raise InputError(
            f'{bag} exists already: choose another --out, or replace it with --force.'
        )
    if bag.exists() and not (bag / METADATA_FILE).is_file():
        raise InputError(f'{bag} is not a bag, so it is not replaced: choose another --out.')
    measurement = read_csv(path, choices)
    signals = measurement.signals
    displacement = signals['displacement']
    source = 'topic' if 'tool_displacement' in signals else 'tool'
    tool = signals.get('tool_displacement', displacement)
    height = DEFAULT_HEIGHT if original_height is None else original_height
    if tool.value.max() > height:
        raise InputError(
            f'{path}: the tool goes {tool.value.max() * 1e3:g} mm deep into an object that is '
            f'{height * 1e3:g} mm high; say its height with --height, or the right unit of the '
            'displacement in its header or with --column.'
        )
    start, origin, time_zero = _start(path, start_ns, list(signals.values()))
    provenance = {
        'source_file': path.name,
        'source_sha256': measurement.sha256,
        'importer': f'hapticvision_ros {version("hapticvision_ros")} import',
        'columns': '; '.join(f'{c.quantity} = {c.header} [{c.unit}]' for c in measurement.columns),
        'displacement_source': source,
        'original_height_m': f'{height:g}'
        + (' (nominal: the source does not say)' if original_height is None else ''),
        'time_zero': time_zero,
        'encoding': measurement.encoding,
        'delimiter': {'\t': 'tab'}.get(measurement.delimiter, measurement.delimiter),
        'decimal_mark': measurement.decimal,
        'rows': str(measurement.row_count),
        'warnings': ' '.join(measurement.warnings),
    }

    def shifted(signal: Signal) -> Signal:
        return Signal(signal.t - origin, signal.value)

    aside = bag.with_name(f'.{bag.name}.replaced')
    if bag.exists():
        shutil.rmtree(aside, ignore_errors=True)
        bag.rename(aside)
    try:
        write_signals(
            bag,
            start_ns=start,
            force=shifted(signals['force']),
            tool_height=shifted(Signal(tool.t, height - tool.value)),
            displacement=shifted(displacement),
            extra=[(FORCE_SD, shifted(signals['force_sd']))] if 'force_sd' in signals else (),
            provenance=provenance,
        )
    except BaseException:
        if aside.exists():
            aside.rename(bag)
        raise
    shutil.rmtree(aside, ignore_errors=True)
    return ImportedTrial(
        bag=bag,
        row_count=measurement.row_count,
        sample_counts={quantity: len(signal) for quantity, signal in signals.items()},
        warnings=measurement.warnings,
    )


def _start(path: Path, start_ns: int | None, signals: Sequence[Signal]) -> tuple[int, float, str]:
    """Return the epoch [ns] of the file's time [s] that follows it, and how it is known."""
    first = min(float(signal.t[0]) for signal in signals)
    last = max(float(signal.t[-1]) for signal in signals)
    if start_ns is not None:
        start, origin, source = start_ns, 0.0, 'given'
    elif first * 1e9 >= NOMINAL_START_NS:
        # From the whole second on, so that the nanoseconds survive in a float.
        origin = float(math.floor(first))
        start, source = int(origin) * 10**9, 'the times of the source count from the Unix epoch'
    else:
        start, origin, source = NOMINAL_START_NS, 0.0, 'nominal: the source does not say'
    if start + (first - origin) * 1e9 < 0 or start + (last - origin) * 1e9 > MAX_STAMP_NS:
        raise InputError(
            f'{path}: times from {first:g} s to {last:g} s do not fit a ROS stamp (1970 to 2038); '
            'check the unit of the time column and --start.'
        )
    return start, origin, source
