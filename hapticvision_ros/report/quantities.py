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


"""Numbers as a person reads them: the error decides the digits, and the unit stands beside."""

from dataclasses import dataclass
import math
import sys
from types import MappingProxyType
from typing import Final, Literal

from hapticvision_ros.core.units import FORCE_UNITS, KGF_PER_MM, MM

THIN_SPACE: Final = '\u202f'
MINUS: Final = '\u2212'
PLUS_MINUS: Final = '\u00b1'

_DIGITS_OF_ERROR: Final = 2
_MOST_DIGITS: Final = 6
_UNGROUPED_DIGITS: Final = 3
_LARGEST_PLAIN_EXPONENT: Final = 6
_SMALLEST_PLAIN_EXPONENT: Final = -4

type Dimension = Literal['force', 'length', 'time', 'stiffness', 'viscosity', 'speed', 'one']


@dataclass(frozen=True, slots=True)
class Unit:
    """
    A unit of display.

    Parameters
    ----------
    symbol : str
        As it is printed.
    in_si : float
        One of this unit in the SI unit of the dimension.

    """

    symbol: str
    in_si: float

    def from_si(self, value: float) -> float:
        """Return an SI `value` in this unit."""
        return value / self.in_si


type UnitSystem = MappingProxyType[Dimension, Unit]

_COMMON: Final[dict[Dimension, Unit]] = {
    'length': Unit('mm', MM),
    'speed': Unit('mm/s', MM),
    'time': Unit('s', 1.0),
    'one': Unit('', 1.0),
}
SI_UNITS: Final[UnitSystem] = MappingProxyType(
    {
        **_COMMON,
        'force': Unit('N', 1.0),
        'stiffness': Unit('N/m', 1.0),
        'viscosity': Unit('N\u00b7s/m', 1.0),
    }
)
PAPER_UNITS: Final[UnitSystem] = MappingProxyType(
    {
        **_COMMON,
        'force': Unit('kgf', FORCE_UNITS['kgf']),
        'stiffness': Unit('kgf/mm', KGF_PER_MM),
        'viscosity': Unit('kgf\u00b7s/mm', KGF_PER_MM),
    }
)
"""The units of the paper's Table 3."""


_DIMENSIONS: Final[dict[str, Dimension]] = {
    'N': 'force',
    'm': 'length',
    's': 'time',
    'N/m': 'stiffness',
    'N.s/m': 'viscosity',
    'm/s': 'speed',
    '-': 'one',
}


def display_unit(si_unit: str, units: UnitSystem) -> Unit:
    """Return the unit in which a quantity with a given SI unit is printed."""
    dimension = _DIMENSIONS.get(si_unit)
    return Unit(si_unit, 1.0) if dimension is None else units[dimension]


def _grouped(text: str) -> str:
    """Return digits in groups of three (ISO 80000-1), with a true minus sign."""
    whole, point, decimals = text.partition('.')
    sign = MINUS if whole.startswith('-') else ''
    digits = whole.lstrip('-')
    if len(digits) > _UNGROUPED_DIGITS:
        digits = f'{int(digits):,}'.replace(',', THIN_SPACE)
    return f'{sign}{digits}{point}{decimals}'


def _exponent(value: float) -> int:
    """Return the decimal exponent of `value` as it would be printed with two digits."""
    return int(f'{abs(value):.{_DIGITS_OF_ERROR - 1}e}'.partition('e')[2]) if value else 0


def _fixed(value: float, last_place: int) -> str:
    """Return `value` rounded to ``10**last_place``."""
    rounded = round(value, -last_place)
    return _grouped(f'{rounded + 0.0:.{max(0, -last_place)}f}')


def _power(exponent: int) -> str:
    superscript = str(exponent).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))
    return f'{THIN_SPACE}×{THIN_SPACE}10{superscript}'


def format_number(value: float, std: float | None = None, digits: int = 4) -> str:
    """
    Return a number as text, with no more digits than its error allows.

    Parameters
    ----------
    value : float
        The number, finite.
    std : float or None
        Its standard error, in the same unit. The error is printed with two digits and the number
        to the same place, but with no more than six digits: no instrument here has more, and an
        error below the last of them is printed rounded up.
    digits : int
        Digits of a number without an error.

    Returns
    -------
    str
        For example ``5 011 ± 12``, ``(1.234 ± 0.012) × 10⁷`` or ``38.27``.

    Raises
    ------
    ValueError
        If a number is not finite, or the error is negative.

    """
    if not math.isfinite(value) or (std is not None and not (math.isfinite(std) and std >= 0.0)):
        raise ValueError(f'{value} ± {std} cannot be printed as a measured number')
    if abs(value) < sys.float_info.min:
        value = 0.0  # A power of ten cannot scale what is smaller.
    largest = max(abs(value), std or 0.0)
    power = _exponent(largest)
    if _SMALLEST_PLAIN_EXPONENT <= power < _LARGEST_PLAIN_EXPONENT:
        power = 0
    scaled = value / 10.0**power
    if std is None or std < sys.float_info.min:
        last = _exponent(scaled) - digits + 1
        return _fixed(scaled, last) + (_power(power) if power else '')
    error = std / 10.0**power
    last = _exponent(error) - _DIGITS_OF_ERROR + 1
    if value and last < (finest := _exponent(scaled) - _MOST_DIGITS + 1):
        last = finest
        # Rounded to nearest, it could read as none; 1e-9 is more than the scaling's own rounding.
        error = max(1, math.ceil(error * 10.0**-last - 1e-9)) * 10.0**last
    both = f'{_fixed(scaled, last)} {PLUS_MINUS} {_fixed(error, last)}'
    return f'({both}){_power(power)}' if power else both


def format_quantity(value: float, unit: Unit, std: float | None = None, digits: int = 4) -> str:
    """
    Return an SI `value` in `unit`, with its unit's symbol.

    Parameters
    ----------
    value : float
        The quantity in SI units.
    unit : Unit
        The unit to print.
    std : float or None
        Its standard error in SI units.
    digits : int
        Digits of a number without an error.

    Returns
    -------
    str
        For example ``(5 011 ± 12) N/m``.

    """
    scaled_std = None if std is None else unit.from_si(std)
    text = format_number(unit.from_si(value), scaled_std, digits)
    if not unit.symbol:
        return text
    if PLUS_MINUS in text and not text.startswith('('):
        text = f'({text})'
    return f'{text}\u00a0{unit.symbol}'
