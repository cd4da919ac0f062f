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

from hapticvision_ros.core.records import FloatArray, Signal
import numpy as np
from numpy.typing import NDArray

NORMAL_FROM_MAD: Final = 1.4826
"""Standard deviation of a normal variable over its median absolute deviation."""
FEWEST: Final = 16
"""In fewer samples nothing is usual."""
RARE: Final = 5e-3
FEW: Final = 40.0
"""Share of the samples, and at most so many, that do not count for the span at either end."""
SPANS: Final = 3.0
"""What stands out by so many times the span of all others is no measurement."""
LONGEST: Final = 8
LASTING: Final = 0.05
"""Samples in a burst of such, and how long it may last [s]."""
SHORTEST: Final = 2
"""Samples in one, however long they last."""


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


def absurd(value: FloatArray, interval: float) -> NDArray[np.bool_]:
    """
    Find samples that stand out by far more than the whole record spans, and come back at once.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Samples in order of time.
    interval : float
        Time between two samples [s].

    Returns
    -------
    ndarray of bool, shape (n,)
        Which samples: alone, or in short bursts. A jump, a peak or a pulse is none, wherever it
        is: the record would have to span less than a third of it elsewhere.

    """
    found = np.zeros(value.size, dtype=np.bool_)
    if value.size < FEWEST:
        return found
    usual = np.pad(median_of_five(value), 2, mode='edge')
    rare = min(RARE, FEW / value.size)
    low, high = np.quantile(usual, [rare, 1.0 - rare])
    most = SPANS * float(high - low)
    if most == 0.0:
        # A sensor that tells only steps, at rest.
        return found
    far = (value > high + most) | (value < low - most) | (np.abs(value - usual) > most)
    longest = max(SHORTEST, min(LONGEST, int(LASTING / max(interval, 1e-9))))
    for first, last in runs(np.asarray(far)):
        before, after = value[max(first - 1, 0)], value[min(last, value.size - 1)]
        at_end = first == 0 or last == value.size
        # Not so what jumps up and then goes on from there.
        found[first:last] = last - first <= longest and (at_end or abs(after - before) <= most)
    return found


def possible(signal: Signal) -> FloatArray:
    """Return a signal's values, absurd ones on a line between those around them."""
    value = signal.value
    if value.size < FEWEST:
        return value
    found = absurd(value, float(np.median(np.diff(signal.t))))
    if not found.any():
        return value
    good, bad = np.flatnonzero(~found), np.flatnonzero(found)
    clean = value.copy()
    clean[bad] = np.interp(bad, good, value[good])
    return clean
