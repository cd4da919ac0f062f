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
Search for the minimum of a function that has no derivatives.

References
----------
J. A. Nelder and R. Mead, Comput. J. 7, 1965, 308-313, doi:10.1093/comjnl/7.4.308.

"""

from collections.abc import Callable

from hapticvision_ros.core.records import FloatArray
import numpy as np


def minimum(
    cost: Callable[[FloatArray], float],
    start: FloatArray,
    sizes: FloatArray,
    *,
    enough: float = 0.1,
    near: float = 0.02,
    turns: int = 60,
    hopeful: Callable[[int, float], bool] | None = None,
) -> tuple[float, FloatArray]:
    """
    Return the minimum of a function near a point, by the method of Nelder and Mead.

    Parameters
    ----------
    cost : callable of ndarray to float
        The function.
    start : ndarray, shape (n,)
        Where to begin.
    sizes : ndarray, shape (n,)
        First steps.
    enough, near : float
        Differences in cost, and in every variable, below which two points are one.
    turns : int
        Most turns of the search.
    hopeful : callable, optional
        Whether to go on, by the turns so far and the least cost.

    Returns
    -------
    cost : float
        The least that was found.
    point : ndarray, shape (n,)
        Where.

    """

    def scored_at(point: FloatArray) -> tuple[float, tuple[float, ...]]:
        return cost(point), tuple(point.tolist())

    scored = [scored_at(start), *(scored_at(start + step) for step in np.diag(sizes))]
    for turn in range(turns):
        scored.sort()
        if hopeful is not None and not hopeful(turn, scored[0][0]):
            break
        corner = np.array([point for _, point in scored])
        spread = max(float(np.abs(corner[-1] - corner[0]).max()), 0.0)
        if scored[-1][0] - scored[0][0] < enough or spread < near:
            break
        middle = corner[:-1].sum(axis=0) / start.size
        away = middle - corner[-1]

        reflected = scored_at(middle + away)
        if reflected[0] < scored[0][0]:
            scored[-1] = min(reflected, scored_at(middle + 2.0 * away))
        elif reflected[0] < scored[-2][0]:
            scored[-1] = reflected
        else:
            reach = 0.5 if reflected[0] < scored[-1][0] else -0.5
            inner = scored_at(middle + reach * away)
            if inner[0] < min(reflected[0], scored[-1][0]):
                scored[-1] = inner
            else:
                scored[1:] = [scored_at(0.5 * (corner[0] + far)) for far in corner[1:]]
    least, point = min(scored)
    return least, np.array(point)
