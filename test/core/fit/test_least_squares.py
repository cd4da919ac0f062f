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
The search reaches the certified values and standard errors of the NIST reference problems.

`nist_strd.json` holds the starts, the certified values and the data of the Statistical Reference
Datasets for non-linear regression of the National Institute of Standards and Technology (public
domain), https://www.itl.nist.gov/div898/strd/.
"""

from collections.abc import Callable
import json
import math
from pathlib import Path

from hapticvision_ros.core.fit.least_squares import (
    covariance,
    minimise,
    orthonormal,
    triangle,
)
import numpy as np
import pytest

PROBLEMS = json.loads((Path(__file__).parent / 'nist_strd.json').read_text(encoding='utf-8'))

exp, pi = np.exp, np.pi


def _gauss(b, x):
    first = b[2] * exp(-((x - b[3]) ** 2) / b[4] ** 2)
    return b[0] * exp(-b[1] * x) + first + b[5] * exp(-((x - b[6]) ** 2) / b[7] ** 2)


def _rational(b, x, degree):
    above = sum(b[k] * x**k for k in range(degree + 1))
    return above / (1 + sum(b[degree + k] * x**k for k in range(1, len(b) - degree)))


def _chwirut(b, x):
    return exp(-b[0] * x) / (b[1] + b[2] * x)


def _lanczos(b, x):
    return b[0] * exp(-b[1] * x) + b[2] * exp(-b[3] * x) + b[4] * exp(-b[5] * x)


def _enso(b, x):
    year = b[1] * np.cos(2 * pi * x / 12) + b[2] * np.sin(2 * pi * x / 12)
    first = b[4] * np.cos(2 * pi * x / b[3]) + b[5] * np.sin(2 * pi * x / b[3])
    return (
        b[0] + year + first + b[7] * np.cos(2 * pi * x / b[6]) + b[8] * np.sin(2 * pi * x / b[6])
    )


MODELS: dict[str, Callable] = {
    'Bennett5': lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    'BoxBOD': lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    'Chwirut1': _chwirut,
    'Chwirut2': _chwirut,
    'DanWood': lambda b, x: b[0] * x ** b[1],
    'ENSO': _enso,
    'Eckerle4': lambda b, x: b[0] / b[1] * exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    'Gauss1': _gauss,
    'Gauss2': _gauss,
    'Gauss3': _gauss,
    'Hahn1': lambda b, x: _rational(b, x, 3),
    'Kirby2': lambda b, x: _rational(b, x, 2),
    'Lanczos1': _lanczos,
    'Lanczos2': _lanczos,
    'Lanczos3': _lanczos,
    'MGH09': lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    'MGH10': lambda b, x: b[0] * exp(b[1] / (x + b[2])),
    'MGH17': lambda b, x: b[0] + b[1] * exp(-x * b[3]) + b[2] * exp(-x * b[4]),
    'Misra1a': lambda b, x: b[0] * (1 - exp(-b[1] * x)),
    'Misra1b': lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** (-2)),
    'Misra1c': lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** (-0.5)),
    'Misra1d': lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    'Nelson': lambda b, x: b[0] - b[1] * x[0] * exp(-b[2] * x[1]),
    'Rat42': lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)),
    'Rat43': lambda b, x: b[0] / (1 + exp(b[1] - b[2] * x)) ** (1 / b[3]),
    'Roszman1': lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / pi,
    'Thurber': lambda b, x: _rational(b, x, 3),
}


def _problem(name: str) -> Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]:
    """Return residual and Jacobian, the latter by the complex step."""
    data = np.array(PROBLEMS[name]['data'])
    y = np.log(data[:, 0]) if name == 'Nelson' else data[:, 0]
    x = data[:, 1:].T if name == 'Nelson' else data[:, 1]
    model = MODELS[name]

    def evaluate(b: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(all='ignore'):
            columns = []
            for k in range(b.size):
                step = 1e-30 * (abs(b[k]) or 1.0)
                shifted = b.astype(complex)
                shifted[k] += 1j * step
                columns.append(model(shifted, x.astype(complex)).imag / step)
            value = model(b.astype(complex), x.astype(complex)).real
            return value - y, np.stack(columns, axis=1)

    return evaluate


@pytest.mark.parametrize('start', [0, 1])
@pytest.mark.parametrize('name', sorted(PROBLEMS))
def test_certified_values_and_errors_of_nist(name: str, start: int) -> None:
    """Both starts lead to the certified values, to six digits."""
    problem = PROBLEMS[name]
    begin = np.array(problem['starts'][start])
    solution = minimise(_problem(name), begin, tolerance=1e-22, max_evaluations=3000)
    # The residual of Lanczos1 is rounding: 1e-13 of its data.
    rounding = name == 'Lanczos1'
    np.testing.assert_allclose(solution.theta, problem['certified'], rtol=1e-6)
    if rounding:
        return
    assert solution.cost == pytest.approx(problem['residual_sum_of_squares'], rel=1e-8)
    freedom = solution.residual.size - solution.theta.size
    std = np.sqrt(np.diag(solution.covariance()) * solution.cost / freedom)
    np.testing.assert_allclose(std, problem['standard_deviation'], rtol=1e-6)


def _line(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    x = np.array([0.0, 1.0, 2.0])
    return theta[0] + theta[1] * x - 3.0 * x, np.stack((np.ones(3), x), axis=1)


def test_a_bound_holds_what_would_cross_it() -> None:
    """With the slope held at 2 the best level is the mean of what is left: 1."""
    bounds = np.array([-np.inf, 0.0]), np.array([np.inf, 2.0])
    solution = minimise(_line, np.array([5.0, 1.0]), bounds)
    np.testing.assert_allclose(solution.theta, [1.0, 2.0], atol=1e-12)
    assert solution.at_bound.tolist() == [False, True]
    assert solution.covariance()[1, 1] == 0.0


def test_what_hardly_matters_at_the_start_does_not_hold_up_the_others() -> None:
    """The logarithm of a strength of nearly nothing, which the first steps would send anywhere."""
    x = np.linspace(0.1, 1.0, 10)

    def bent(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        with np.errstate(over='ignore'):
            bend = np.exp(theta[1]) * x**2
        value = 5.0 * x + 2.0 * x**2
        return theta[0] * x + bend - value, np.stack((x, bend), axis=1)

    start = np.array([6.0, math.log(1e-6)])
    found = minimise(bent, start, reach=np.array([np.inf, 3.0]), max_evaluations=16)
    assert found.theta == pytest.approx([5.0, math.log(2.0)], rel=1e-3)


def test_what_is_known_of_the_start_is_not_asked_again() -> None:
    asked = []

    def line(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        asked.append(theta.tolist())
        return _line(theta)

    start = np.array([5.0, 1.0])
    plain = minimise(line, start)
    assert asked[0] == start.tolist()
    first, asked = asked, []
    again = minimise(line, start, known=_line(start))
    assert asked == first[1:]
    assert again.theta.tolist() == plain.theta.tolist()
    assert again.evaluations == plain.evaluations


def test_a_search_from_zero_that_no_step_improves_comes_to_an_end() -> None:
    """At a kink, of which the slope on one side says that the other is lower."""

    def kink(theta: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return np.array([1.0 + abs(theta[0])]), np.array([[1.0]])

    solution = minimise(kink, np.zeros(1), max_evaluations=10_000)
    assert solution.theta.tolist() == [0.0]
    assert solution.evaluations < 100


def test_a_direction_in_which_nothing_changes_has_no_error() -> None:
    """Two parameters of which only the sum counts are both unknown; a third is known."""
    jacobian = np.array([[1.0, 1.0, 0.0], [2.0, 2.0, 1.0], [3.0, 3.0, -1.0]])
    spread = np.diag(covariance(jacobian))
    assert np.isinf(spread[:2]).all()
    assert np.isfinite(spread[2])


def test_a_start_without_a_value_is_refused() -> None:
    """A search cannot leave a point at which the model is not finite."""
    with pytest.raises(ValueError, match='not finite at the start'):
        minimise(lambda theta: (np.array([np.nan]), np.ones((1, 1))), np.array([1.0]))


@pytest.mark.parametrize('value', [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize('row', [0, 2, 4])
def test_a_triangular_factor_tells_what_is_not_finite(row: int, value: float) -> None:
    rows = np.random.default_rng(5).standard_normal((5, 40))
    rows[1] = rows[3] = 0.0
    assert np.isfinite(triangle(rows.copy())).all()
    rows[row, 7] = value
    assert not np.isfinite(triangle(rows)).all()


def test_a_triangular_factor_has_the_products_of_its_matrix() -> None:
    random = np.random.default_rng(4)
    rows = random.standard_normal((12, 3000)) * np.geomspace(1e-3, 1e3, 12)[:, np.newaxis]
    rows[5] = rows[3] + 1e-6 * rows[5]
    rows[7] = 0.0
    factor = triangle(rows.copy())
    assert np.array_equal(factor, np.triu(factor))
    length = np.linalg.norm(rows, axis=1)
    length[7] = 1.0
    off = (factor.T @ factor - rows @ rows.T) / np.outer(length, length)
    assert np.abs(off).max() < 1e-13
    # What is left of two that are nearly alike is as exact as by reflections.
    expected = abs(np.linalg.qr(rows[:6].T, mode='r')[5, 5])
    assert factor[5, 5] == pytest.approx(expected, rel=1e-8)


def test_directions_at_right_angles_leave_out_what_depends_on_others() -> None:
    random = np.random.default_rng(5)
    rows = random.standard_normal((5, 200))
    rows[3] = rows[0] - 2.0 * rows[1]
    rows[4] = 0.0
    found = orthonormal(rows.copy())
    assert found.shape == (3, 200)
    assert found @ found.T == pytest.approx(np.eye(3), abs=1e-12)
    assert rows - (rows @ found.T) @ found == pytest.approx(np.zeros((5, 200)), abs=1e-11)
