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
Which samples of a record are glitches: spikes, drop-outs and short bursts.

References
----------
.. [1] F. R. Hampel, "The influence curve and its role in robust estimation", J. Am. Stat. Assoc.
   69 (1974), doi:10.1080/01621459.1974.10482962: the departure from a running median, over its
   own median absolute value.

"""

import math
from typing import Final

from hapticvision_ros.core.outliers import NORMAL_FROM_MAD
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

_HALF_WIDTH: Final = 5
_SIGMAS: Final = 8.0
_LAST: Final = slice(-_HALF_WIDTH - 1, -1)
_LOCAL_SPREADS: Final = 5.0
_SCALES: Final = (1, 4, 16, 64)
_TYPICAL_SAMPLES: Final = 4096
"""Windows that tell the noise of a long record."""
_ODD: Final = 0.05
"""Part of the steps of a quantised record that may be smaller than its own."""


def find_glitches(value: FloatArray, floor: float | None = None) -> NDArray[np.bool_]:
    """
    Return which samples stand out of their own neighbourhood.

    A sample is compared with the running median of the 11 samples around it, and so are the
    medians of blocks of 4, 16 and 64 samples, so that bursts up to 320 samples long are seen. The
    limit is eight times the robust noise of the same comparison or of second differences, and
    five times the median departure in the same window. A monotone stretch has no departure at all,
    however steep, and a smooth turn little: a decay, a step and a peak are never glitches.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Samples in order of time.
    floor : float, optional
        Departure below which nothing is a glitch; `resolution` of the samples by default.

    Returns
    -------
    ndarray of bool, shape (n,)
        True where a sample is a glitch.

    """
    glitch = np.zeros(value.size, dtype=np.bool_)
    if floor is None:
        floor = resolution(value)
    for scale in _SCALES:
        blocks = value.size // scale
        if blocks <= 4 * _HALF_WIDTH:
            break
        body = value[: blocks * scale].reshape(blocks, scale)
        middle = np.partition(body, scale // 2, axis=1)[:, scale // 2] if scale > 1 else value
        outlying = _outlying(middle, floor)
        if scale > 1 and outlying.any():
            # A burst seldom ends where a block does.
            outlying[1:] |= outlying[:-1].copy()
            outlying[:-1] |= outlying[1:].copy()
        glitch[: blocks * scale] |= np.repeat(outlying, scale)
    return glitch


def _outlying(value: FloatArray, floor: float) -> NDArray[np.bool_]:
    """Return which values depart from the running median by more than the limit."""
    # Continued point-symmetrically beyond either end, so that a slope stays monotone there.
    head = 2.0 * value[0] - value[_HALF_WIDTH:0:-1]
    tail = 2.0 * value[-1] - np.flip(value[_LAST])
    padded = np.concatenate((head, value, tail))
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * _HALF_WIDTH + 1)
    thin = max(1, value.size // _TYPICAL_SAMPLES)
    departure = np.abs(value[::thin] - _middle(windows[::thin]))
    # On a slope steeper than the noise most departures are nil; second differences still see it.
    curvature = np.abs(value[2::thin] - 2.0 * value[1:-1:thin] + value[:-2:thin])
    typical = max(float(np.median(departure)), float(np.median(curvature)) / math.sqrt(6.0))
    limit = max(_SIGMAS * NORMAL_FROM_MAD * typical, floor)
    # No sample departs from a median by more than from the extremes of its window.
    highest, lowest = _running(np.maximum, padded), _running(np.minimum, padded)
    suspects = np.flatnonzero(np.maximum(highest - value, value - lowest) > limit)
    running = _middle(windows[suspects])
    departure = np.abs(value[suspects] - running)
    # A smooth turn of the signal departs as well, but no further than its neighbours do.
    local = _middle(np.abs(windows[suspects] - running[:, np.newaxis]))
    outlying = np.zeros(value.size, dtype=np.bool_)
    outlying[suspects] = (departure > limit) & (departure > _LOCAL_SPREADS * local)
    return outlying


def _middle(windows: FloatArray) -> FloatArray:
    """Return the median of each window."""
    return np.asarray(np.partition(windows, _HALF_WIDTH, axis=1)[:, _HALF_WIDTH])


def _running(larger: np.ufunc, padded: FloatArray) -> FloatArray:
    """Return the extremes over windows of 11 samples, by doubling: 2, 4, 8, 11."""
    two = larger(padded[:-1], padded[1:])
    four = larger(two[:-2], two[2:])
    eight = larger(four[:-4], four[4:])
    return np.asarray(larger(eight[:-3], eight[3:]))


def resolution(value: FloatArray) -> float:
    """
    Return the departure that the steps of a quantised record make by themselves.

    Parameters
    ----------
    value : ndarray, shape (n,)
        Samples in order of time.

    Returns
    -------
    float
        Twice its steps, or what rounding makes of a record that has none.

    """
    if value.size < 2:
        return 0.0
    low, high = map(float, np.quantile(value, (0.05, 0.95)))
    span = high - low
    # One wild value makes no rounding.
    rounding = 1e-6 * span + 1e-12 * max(abs(low), abs(high))
    steps = np.abs(np.diff(value))
    steps = steps[steps > rounding]
    if steps.size == 0:
        return rounding
    # A few odd samples have smaller steps than a quantised record.
    quantum = float(np.quantile(steps, _ODD, method='lower'))
    return max(2.0 * quantum if quantum < span else 0.0, rounding)
