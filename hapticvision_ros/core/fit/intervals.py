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
Intervals by the profile likelihood: how far a parameter may go before the fit gets worse.

References
----------
D. J. Venzon and S. H. Moolgavkar, Appl. Statist. 37, 1988, 87-94, doi:10.2307/2347496; W. Q.
Meeker and L. A. Escobar, Am. Statist. 49, 1995, 48-53, doi:10.2307/2684811.

"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from statistics import NormalDist
from typing import Final

from hapticvision_ros.core.fit.campaign import Fit
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.records import FloatArray
import numpy as np

_CLOSE: Final = 0.01
"""The rise of the cost at an end is right to this share."""
_MOST_STEPS: Final = 12
_FARTHEST: Final = 7.0
"""Search of a logarithm ends this far from the best value: at a factor of a thousand."""


@dataclass(frozen=True, slots=True)
class Interval:
    """
    An interval of confidence.

    Parameters
    ----------
    lower, upper : float or None
        Its ends in SI units; None on a side to which it is open.
    level : float
        Its confidence, between 0 and 1.
    reason : str or None
        Why it is open.

    """

    lower: float | None
    upper: float | None
    level: float
    reason: str | None = None


def profile_intervals(
    fit: Fit, names: Sequence[str] | None = None, level: float = 0.95
) -> dict[str, Interval]:
    """
    Return the intervals of shared parameters by their profile likelihood.

    An interval holds the values at which the least cost, over all other parameters, is above the
    least of all by no more than the quantile of chi squared with one degree of freedom. The noise
    stays as the fit has found it.

    Parameters
    ----------
    fit : Fit
        The fit.
    names : sequence of str, optional
        Which parameters; all by default.
    level : float
        Confidence.

    Returns
    -------
    dict of str to Interval
        Open, with the reason, to a side on which the cost never rises enough.

    Raises
    ------
    ValueError
        If the level is no probability, or the model has no such parameter.

    """
    if not 0.0 < level < 1.0:
        raise ValueError(f'a level of confidence is between 0 and 1, not {level:g}')
    intervals = {}
    rise = NormalDist().inv_cdf(0.5 + 0.5 * level) ** 2
    for name in fit.model.names if names is None else names:
        if name not in fit.model.names:
            raise ValueError(f'the model has no parameter {name!r}')
        place = fit.model.names.index(name)
        ends = [_end(fit, place, sign, rise) for sign in (-1.0, 1.0)]
        values: list[float | None] = []
        for end in ends:
            theta = fit.theta.copy()
            if end is not None:
                theta[place] = end
            values.append(None if end is None else float(fit.model.values(theta)[place]))
        open_to = [side for side, end in zip(('below', 'above'), ends, strict=True) if end is None]
        reason = (
            f'these trials do not bound {name} from {" and ".join(open_to)}' if open_to else None
        )
        intervals[name] = Interval(values[0], values[1], level, reason)
    return intervals


def _end(fit: Fit, place: int, sign: float, rise: float) -> float | None:
    """Return where the profile has risen enough on one side; None if it never does."""
    best = float(fit.theta[place])
    bounds = fit.problem.bounds
    limit = float(bounds[0][place] if sign < 0.0 else bounds[1][place])
    log = fit.model.log[place]
    std = math.sqrt(fit.covariance[place, place])
    if not math.isfinite(std) or std == 0.0:
        std = 0.1 if log else 0.1 * max(abs(best), 1e-9)
    reach = sign * math.sqrt(rise) * std
    if log:
        reach = math.copysign(min(abs(reach), 0.5 * _FARTHEST), sign)
    state = fit.state
    # The root of the rise is almost linear in the parameter; inside and outside bracket the end.
    inside, inside_root, outside = 0.0, 0.0, math.inf
    outside_root = math.inf
    for _ in range(_MOST_STEPS):
        moved = best + reach
        beyond = moved <= limit if sign < 0.0 else moved >= limit
        if beyond:
            moved = limit
            reach = limit - best
        if reach == 0.0:
            return None
        cost, state = _least(fit, place, moved, state)
        root = math.sqrt(max(cost - fit.cost, 0.0) / rise)
        if abs(root - 1.0) <= _CLOSE:
            return moved
        if root < 1.0:
            if beyond or (log and abs(reach) >= _FARTHEST):
                return None
            inside, inside_root = abs(reach), root
        else:
            outside, outside_root = abs(reach), root
        if math.isinf(outside):
            step = inside * min(max(1.05 / max(inside_root, 0.2), 1.2), 3.0)
            if log:
                step = min(step, _FARTHEST)
        else:
            share = (1.0 - inside_root) / (outside_root - inside_root)
            step = inside + min(max(share, 0.05), 0.95) * (outside - inside)
        reach = sign * step
    return best + reach if math.isfinite(outside) else None


def _least(fit: Fit, place: int, value: float, state: FloatArray) -> tuple[float, FloatArray]:
    """Return the least cost with one parameter held, and the state there."""
    lower, upper = fit.problem.bounds
    others = np.arange(state.size) != place

    def held(free: FloatArray) -> tuple[FloatArray, FloatArray]:
        whole = np.insert(free, place, value)
        residual, jacobian = fit.problem.evaluate(whole)
        return residual, jacobian[:, others]

    solution = minimise(
        held,
        state[others],
        (lower[others], upper[others]),
        reach=fit.problem.reach[others],
        tolerance=1e-6,
        max_evaluations=30,
    )
    return solution.cost, np.insert(solution.theta, place, value)
