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
"""Samples that are no measurement: what no object and no arm can do."""

from typing import Final

from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

FEWEST: Final = 16
"""In fewer samples nothing is usual."""
RARE: Final = 5e-3
"""Share of the samples at either end that do not count for the span of a record."""
SPANS: Final = 3.0
"""What stands out by so many times the span of all others is no measurement."""
LONGEST: Final = 8
"""Samples in a burst of such."""


def runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return first and one past last of each run of chosen samples."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], chosen, [False]))))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]


def median_of_five(value: FloatArray) -> FloatArray:
    """Return the running median of five values, by comparisons of whole records: 4 fewer."""
    length = value.size - 4
    a, b, c, d, e = np.lib.stride_tricks.sliding_window_view(value, length)
    low = np.maximum(np.minimum(a, b), np.minimum(c, d))
    high = np.minimum(np.maximum(a, b), np.maximum(c, d))
    return np.asarray(np.maximum(np.minimum(low, high), np.minimum(np.maximum(low, high), e)))


def absurd(value: FloatArray) -> NDArray[np.bool_]:
    """
    Find samples that stand out by far more than the whole record spans.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Samples in order of time.

    Returns
    -------
    ndarray of bool, shape (n,)
        Which samples. A jump, a peak or a pulse is none, wherever it is: the record would have to
        span less than a third of it elsewhere. A burst is, while all such are rare.

    """
    if value.size < FEWEST:
        return np.zeros(value.size, dtype=np.bool_)
    usual = np.pad(median_of_five(value), 2, mode='edge')
    low, high = np.quantile(usual, [RARE, 1.0 - RARE])
    most = SPANS * (high - low)
    found = np.asarray((value > high + most) | (value < low - most))
    for first, last in runs(found):
        # A push that is short in a long record stands out as well, but not for a few samples.
        found[first:last] = last - first <= LONGEST
    return np.asarray(found | (np.abs(value - usual) > most))


def possible(value: FloatArray) -> FloatArray:
    """Return a record whose absurd samples are on a line between those around them."""
    found = absurd(value)
    if not found.any() or found.all():
        return value
    good, bad = np.flatnonzero(~found), np.flatnonzero(found)
    clean = value.copy()
    clean[bad] = np.interp(bad, good, value[good])
    return clean
