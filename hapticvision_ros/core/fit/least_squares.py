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
Non-linear least squares by a trust region, with a given Jacobian.

References
----------
J. J. More, "The Levenberg-Marquardt algorithm: implementation and theory", Lecture Notes in
Mathematics 630, 1978, 105-116, doi:10.1007/BFb0067700 (trust region, scaling of the parameters).

"""

from collections.abc import Callable
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

type Evaluated = tuple[FloatArray, FloatArray]
"""A residual, shape (m,), and its derivatives, shape (m, p)."""
type ResidualAndJacobian = Callable[[FloatArray], Evaluated]
"""theta, shape (p,), to them."""

_FIRST_RADIUS: Final = 1.0
"""First step in units of the scaled parameters' length (or of one)."""
_STUCK: Final = 1e-9
"""Step, over the parameters, below which a search that gains nothing has ended."""
_DEPENDENT: Final = 1e-9
"""Part of a vector's length beside others below which it depends on them."""
_ROUNDING: Final = 4.0 * float(np.finfo(np.float64).eps)


class NotFiniteError(ValueError):
    """A model has no finite value where the search for its parameters begins."""


@dataclass(frozen=True, slots=True)
class Solution:
    """
    Where a search ended.

    Parameters
    ----------
    theta : ndarray, shape (p,)
        The parameters.
    residual : ndarray, shape (m,)
        The residual there.
    jacobian : ndarray, shape (m, p)
        Its derivatives there.
    at_bound : ndarray of bool, shape (p,)
        Which parameters lie on a bound that they would cross.
    converged : bool
        Whether no step promised more than the tolerance.
    evaluations : int
        How often the model was evaluated, at the start too.

    """

    theta: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    at_bound: NDArray[np.bool_]
    converged: bool
    evaluations: int

    @property
    def cost(self) -> float:
        """Return the sum of squares."""
        return float(self.residual @ self.residual)

    def covariance(self) -> FloatArray:
        """
        Return the covariance of the parameters for a residual of unit variance; shape (p, p).

        Infinite on the diagonal where the residual does not depend on a parameter; a parameter on
        a bound is taken as known, with zeros.
        """
        return covariance(self.jacobian, ~self.at_bound)


def covariance(jacobian: FloatArray, free: NDArray[np.bool_] | None = None) -> FloatArray:
    """
    Return the inverse of ``J^T J`` by the singular values of the scaled Jacobian.

    Parameters
    ----------
    jacobian : ndarray, shape (m, p)
        Derivatives of a residual of unit variance.
    free : ndarray of bool, shape (p,), optional
        The parameters that are not held; all by default.

    Returns
    -------
    ndarray, shape (p, p)
        The covariance; infinite on the diagonal for a parameter that takes part in a direction in
        which nothing changes, zeros for a held one.

    """
    p = jacobian.shape[1]
    chosen = np.flatnonzero(np.ones(p, dtype=np.bool_) if free is None else free)
    result = np.zeros((p, p))
    columns = jacobian[:, chosen]
    scale = np.sqrt(np.sum(columns**2, axis=0))
    seen = scale > 0.0
    result[chosen[~seen], chosen[~seen]] = np.inf
    chosen, columns, scale = chosen[seen], columns[:, seen], scale[seen]
    if chosen.size == 0:
        return result
    _, singular, right = np.linalg.svd(columns / scale, full_matrices=False)
    flat = singular <= _ROUNDING * max(columns.shape) * singular[0]
    steep = right[~flat] / singular[~flat, np.newaxis]
    block = (steep.T @ steep) / np.outer(scale, scale)
    if right.shape[0] < chosen.size or flat.any():
        hidden = 1.0 - np.sum(right[~flat] ** 2, axis=0) > 1e-6
        block[hidden, hidden] = np.inf
    result[np.ix_(chosen, chosen)] = block
    return result


def triangle(rows: FloatArray) -> FloatArray:
    """
    Return the triangular factor of a matrix with many more rows than columns.

    By modified Gram-Schmidt (Å. Björck, BIT 7, 1967, 1-21, doi:10.1007/BF01934122), whose factor
    is as exact as Householder's, with the columns side by side in memory and in the caller's
    thread: a library's threads that wait for each other take tens of times as long where another
    process is at work.

    Parameters
    ----------
    rows : ndarray, shape (p, m)
        The p columns of the matrix, one after another; they are overwritten.

    Returns
    -------
    ndarray, shape (p, p)
        The factor, whose products are those of the matrix; not finite where they are not.

    """
    factor = np.zeros((rows.shape[0],) * 2)
    _triangle(rows, factor)
    return factor


def orthonormal(rows: FloatArray) -> FloatArray:
    """
    Return directions at right angles that span some vectors, as `triangle` finds them.

    Parameters
    ----------
    rows : ndarray, shape (p, m)
        The vectors; they are overwritten.

    Returns
    -------
    ndarray, shape (k, m)
        Of unit length; fewer where vectors depend on each other.

    """
    length = np.linalg.norm(rows, axis=1)
    rows /= np.where(length > 0.0, length, 1.0)[:, np.newaxis]
    left = np.diag(triangle(rows))
    chosen = left > _DEPENDENT
    return np.asarray(rows[chosen] / left[chosen, np.newaxis])


@kernel(fastmath={'reassoc', 'contract'})
def _triangle(rows, factor):  # type: ignore[no-untyped-def]
    """Fill the factor, and leave what each column has beside those before it."""
    count, size = rows.shape
    for j in range(count):
        squares = 0.0
        for i in range(size):
            squares += rows[j, i] * rows[j, i]
        if squares == 0.0:
            continue
        length = math.sqrt(squares)
        factor[j, j] = length
        for k in range(j + 1, count):
            along = 0.0
            for i in range(size):
                along += rows[j, i] * rows[k, i]
            factor[j, k] = along / length
            share = along / squares
            for i in range(size):
                rows[k, i] -= share * rows[j, i]


def minimise(
    model: ResidualAndJacobian,
    start: FloatArray,
    bounds: tuple[FloatArray, FloatArray] | None = None,
    *,
    known: Evaluated | None = None,
    reach: FloatArray | None = None,
    tolerance: float = 1e-10,
    step_tolerance: float = 0.0,
    max_evaluations: int = 200,
) -> Solution:
    """
    Find the parameters with the least sum of squares near a start.

    The parameters are scaled by the largest columns of the Jacobian seen so far. A point at which
    the model is not finite counts as infinitely bad. A parameter on a bound stays there while the
    residual wants it beyond.

    Parameters
    ----------
    model : callable
        Residual and Jacobian at theta.
    start : ndarray, shape (p,)
        Where to start; moved into the bounds.
    bounds : (ndarray, ndarray), optional
        Least and greatest theta, shapes (p,).
    known : Evaluated, optional
        What the model has returned for the start, which must be within the bounds.
    reach : ndarray, shape (p,), optional
        The largest change of each parameter in one step. One that hardly matters where the search
        starts has next to no say in the trust region, which shrinks to nothing before such a
        parameter is kept from going astray.
    tolerance : float
        The search ends where the linear model promises a smaller relative drop of the cost.
    step_tolerance : float
        It also ends where the trust region is smaller than this share of the parameters.
    max_evaluations : int
        Or after this many evaluations of the model.

    Returns
    -------
    Solution
        The best point found.

    Raises
    ------
    NotFiniteError
        If the model is not finite at the start.

    """
    lower, upper = bounds if bounds is not None else (np.full(start.size, -np.inf), np.inf)
    theta = np.clip(np.asarray(start, dtype=np.float64), lower, upper)
    residual, jacobian = model(theta) if known is None else known
    cost = float(residual @ residual)
    if not math.isfinite(cost):
        raise NotFiniteError('the model is not finite at the start')
    scale = np.sqrt(np.sum(jacobian**2, axis=0))
    scale[scale == 0.0] = 1.0
    length = float(np.linalg.norm(scale * theta))
    radius = _FIRST_RADIUS * (length if length > 0.0 else 1.0)
    evaluations, converged = 1, False
    held = _held(theta, lower, upper, jacobian.T @ residual)
    while True:
        free = np.flatnonzero(~held)
        left, singular, right = np.linalg.svd(jacobian[:, free] / scale[free], full_matrices=False)
        projected = left.T @ residual
        # What the linear model promises without the trust region: a small promise within a small
        # region is no sign of a minimum.
        reachable = _step(singular, right, projected, math.inf)[1]
        accepted = False
        while not accepted:
            step, promised = _step(singular, right, projected, radius)
            move = np.zeros(theta.size)
            move[free] = step / scale[free]
            if reach is not None:
                np.clip(move, -reach, reach, out=move)
            trial = np.clip(theta + move, lower, upper)
            taken = float(np.linalg.norm(scale * (trial - theta)))
            # Where all parameters are zero, steps are small beside the residual.
            size = max(float(np.linalg.norm(scale * theta)), math.sqrt(cost), 1e-300)
            stuck = promised <= tolerance * cost and taken <= _STUCK * size
            if (
                reachable <= tolerance * cost
                or stuck
                or taken <= max(step_tolerance, _ROUNDING) * size
            ):
                converged = True
                break
            if evaluations >= max_evaluations:
                break
            new_residual, new_jacobian = model(trial)
            evaluations += 1
            with np.errstate(over='ignore', invalid='ignore'):
                new_cost = float(new_residual @ new_residual)
            linear = residual + jacobian @ (trial - theta)
            expected = cost - float(linear @ linear)
            gain = (cost - new_cost) / expected if expected > 0.0 else -1.0
            if not math.isfinite(new_cost) or not np.isfinite(new_jacobian).all():
                gain = -1.0
            if gain < 0.25:
                radius = 0.25 * min(radius, taken)
            elif gain > 0.75:
                radius = max(radius, 2.0 * taken)
            accepted = gain > 1e-4
        if not accepted:
            return Solution(theta, residual, jacobian, held, converged, evaluations)
        theta, residual, jacobian, cost = trial, new_residual, new_jacobian, new_cost
        scale = np.maximum(scale, np.sqrt(np.sum(jacobian**2, axis=0)))
        held = _held(theta, lower, upper, jacobian.T @ residual)


def left_over(residual: FloatArray, jacobian: FloatArray) -> float:
    """
    Return the least squares that the linear model promises.

    Parameters
    ----------
    residual, jacobian : ndarray, shapes (m,), (m, p)
        The residual and its derivatives.

    Returns
    -------
    float
        What one step to its best leaves.

    """
    left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
    explained = left[:, singular > 1e-10 * singular[0]].T @ residual
    return float(residual @ residual - explained @ explained)


def _held(
    theta: FloatArray, lower: FloatArray | float, upper: FloatArray | float, gradient: FloatArray
) -> NDArray[np.bool_]:
    """Return which parameters lie on a bound and would go on beyond it."""
    return np.asarray(
        ((theta <= lower) & (gradient > 0.0)) | ((theta >= upper) & (gradient < 0.0)),
        dtype=np.bool_,
    )


def _step(
    singular: FloatArray, right: FloatArray, projected: FloatArray, radius: float
) -> tuple[FloatArray, float]:
    """Return the best step of the linear model within a radius, and by how much it would drop."""
    usable = singular > _ROUNDING * (singular[0] if singular.size else 0.0)
    s, g = singular[usable], projected[usable]
    damping = 0.0
    weights = -g / s
    if float(weights @ weights) > radius**2:
        damping = 1e-3 * float(np.linalg.norm(s * g)) / radius
        for _ in range(50):
            weights = -s * g / (s**2 + damping)
            norm = float(np.linalg.norm(weights))
            slope = -float(np.sum(weights**2 / (s**2 + damping))) / norm
            # Newton's method on the reciprocal of the norm, which is almost linear.
            change = (norm - radius) / radius * norm / -slope
            damping = max(damping + change, 0.1 * damping)
            if abs(norm - radius) <= 0.05 * radius:
                break
    linear = g + s * weights
    promised = float(g @ g) - float(linear @ linear)
    return right[usable].T @ weights, promised
