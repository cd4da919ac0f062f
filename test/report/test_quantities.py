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


import math
import re

from hapticvision_ros.report.quantities import (
    format_number,
    format_quantity,
    PAPER_UNITS,
    SI_UNITS,
)
from hypothesis import given, strategies
import pytest

FINITE = strategies.floats(-1e12, 1e12, allow_nan=False)
ERRORS = strategies.floats(1e-9, 1e9)


def read_back(text: str) -> float:
    """Return the number that a person reads in `text`."""
    superscripts = str.maketrans('⁻⁰¹²³⁴⁵⁶⁷⁸⁹', '-0123456789')
    head, _, power = text.replace('\u202f', '').replace('(', '').replace(')', '').partition('×10')
    exponent = int(power.translate(superscripts)) if power else 0
    return float(head.split(' ±')[0].replace('\u2212', '-')) * 10.0**exponent


@pytest.mark.parametrize(
    ('value', 'std', 'text'),
    [
        (5011.3, 12.4, '5\u202f011 ± 12'),
        (84240.0, 3210.0, '84\u202f200 ± 3\u202f200'),
        (0.0098, 0.00012, '0.00980 ± 0.00012'),
        (1.234e7, 1.2e5, '(1.234 ± 0.012)\u202f×\u202f10⁷'),
        (-12345.678, 0.996, '\u221212\u202f345.7 ± 1.0'),
        (3.2, 55.0, '3 ± 55'),
        (38.27123, None, '38.27'),
        (0.0, None, '0.000'),
        (-1e-9, 0.1, '0.00 ± 0.10'),
        # Data without noise: the error is that of the arithmetic.
        (4.02709755516070622, 9.7e-16, '4.02710 ± 0.00001'),
        (5011.3, 0.07, '5\u202f011.30 ± 0.07'),
        (5011.3, 0.0444, '5\u202f011.30 ± 0.05'),
        (1.2345678e7, 3.0, '(1.23457 ± 0.00001)\u202f×\u202f10⁷'),
        (-2.0, 0.0001, '\u22122.00000 ± 0.00010'),
        (0.0, 1e-9, '(0.0 ± 1.0)\u202f×\u202f10⁻⁹'),
    ],
)
def test_the_error_decides_the_digits(value: float, std: float | None, text: str) -> None:
    assert format_number(value, std) == text


@given(FINITE, ERRORS)
def test_rounding_moves_a_number_by_less_than_a_tenth_of_its_error(
    value: float, std: float
) -> None:
    # Two digits of the error: half a unit of the second digit is at most 1/20 of the error.
    shown = read_back(format_number(value, std))
    # Half a unit of the sixth digit of the number is at most 5e-6 of it.
    assert abs(shown - value) <= max(0.051 * std, 5.1e-6 * abs(value)) + 1e-12 * abs(value)


@given(FINITE, ERRORS)
def test_an_error_is_never_shown_as_none_and_a_number_never_with_more_than_six_digits(
    value: float, std: float
) -> None:
    number, _, error = format_number(value, std).partition(' ± ')
    assert re.search('[1-9]', error.partition('\u202f×')[0])
    digits = re.sub('[^0-9]', '', number).lstrip('0')
    # Rounded up to the next power of ten, a number has one more; a large error has its own place.
    assert len(digits) <= 7 or std > abs(value)


@given(FINITE)
def test_without_an_error_four_digits_are_kept(value: float) -> None:
    # Half a unit of the fourth digit is 5e-4 at most.
    assert math.isclose(read_back(format_number(value)), value, rel_tol=5.1e-4, abs_tol=1e-12)


@pytest.mark.parametrize(
    ('value', 'std'), [(math.nan, None), (math.inf, 1.0), (1.0, math.nan), (1.0, -1.0)]
)
def test_what_is_no_number_is_refused(value: float, std: float | None) -> None:
    with pytest.raises(ValueError, match='cannot be printed'):
        format_number(value, std)


def test_the_same_stiffness_reads_in_both_unit_systems() -> None:
    assert format_quantity(5011.3, SI_UNITS['stiffness'], 12.4) == '(5\u202f011 ± 12)\u00a0N/m'
    # Table 3, first row: 0.511 kgf/mm.
    text = format_quantity(0.511 * 9806.65, PAPER_UNITS['stiffness'], 9.80665)
    assert text == '(0.5110 ± 0.0010)\u00a0kgf/mm'
    assert format_quantity(0.01, SI_UNITS['length']) == '10.00\u00a0mm'
