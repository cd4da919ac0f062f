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


"""Fewer points for the same picture: extremes survive, so that a glitch stays visible."""

from typing import Final

from hapticvision_ros.core.records import FloatArray
import numpy as np

_GAP_IN_INTERVALS: Final = 10.0
_GAP_IN_SPAN: Final = 0.01


def envelope(t: FloatArray, value: FloatArray, bins: int) -> tuple[FloatArray, FloatArray]:
    """
    Return the least and the greatest sample of each of `bins` runs of samples.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s], increasing.
    value : ndarray, shape (n,)
        Samples, finite.
    bins : int
        Number of runs; a picture needs about one a column of pixels.

    Returns
    -------
    t, value : ndarray, shape (m,)
        A subset of the samples in order of time, ``m <= 2 bins + 2``, with the first and the last
        one and every extreme; all of them where there are no more than that.

    """
    if t.size <= 2 * bins + 2:
        return t, value
    edges = np.linspace(0, t.size, bins + 1).astype(np.intp)
    size = int(np.diff(edges).max())
    # Rows of equal length: the last sample of a shorter run stands twice, which moves no extreme.
    index = np.minimum(edges[:-1, None] + np.arange(size), edges[1:, None] - 1)
    rows = value[index]
    run = np.arange(bins)
    least = index[run, rows.argmin(axis=1)]
    greatest = index[run, rows.argmax(axis=1)]
    kept = np.unique(np.concatenate(([0, t.size - 1], least, greatest)))
    return t[kept], value[kept]


def line(t: FloatArray, value: FloatArray, bins: int) -> tuple[FloatArray, FloatArray]:
    """
    Return the points of a line that does not bridge the gaps of a record.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s], increasing.
    value : ndarray, shape (n,)
        Samples; a sample that is not finite is a gap.
    bins : int
        Resolution, as in `envelope`, over the whole record.

    Returns
    -------
    t, value : ndarray, shape (m,)
        The envelope of each stretch, with one NaN where the line is interrupted.

    """
    usable = np.isfinite(value)
    t, value = t[usable], value[usable]
    if t.size < 2:
        return t, value
    step = np.diff(t)
    # Against its neighbours, not the mean step: a record may be sampled ever more sparsely.
    beside = np.maximum(np.append(step[1:], 0.0), np.append(0.0, step[:-1]))
    gap = np.maximum(_GAP_IN_INTERVALS * beside, _GAP_IN_SPAN * (t[-1] - t[0]))
    cuts = np.flatnonzero((step > gap) & (beside > 0.0)) + 1
    times: list[FloatArray] = []
    values: list[FloatArray] = []
    for part_t, part_value in zip(np.split(t, cuts), np.split(value, cuts), strict=True):
        share = max(2, round(bins * part_t.size / t.size))
        kept_t, kept_value = envelope(part_t, part_value, share)
        times += [kept_t, kept_t[-1:]]
        values += [kept_value, np.array([np.nan])]
    return np.concatenate(times[:-1]), np.concatenate(values[:-1])
