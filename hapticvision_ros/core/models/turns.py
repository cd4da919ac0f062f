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
Steps that are split where the tool changes its speed.

A force is the mean over its step, and the tool's way within the step is a straight line. Where it
turns between two samples, what relaxes within a step (a spring in series, a mass, the load cell)
tells when that was: there the step is made of several, and their forces are put together again.
"""

from dataclasses import dataclass

from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Turns:
    """
    The n steps of a trial, split into N.

    Parameters
    ----------
    t, displacement : ndarray, shape (N + 1,)
        Ends of the split steps [s] and the tool's displacement there [m].
    ends : ndarray of int, shape (n + 1,)
        Which of them are ends of the steps themselves.

    """

    t: FloatArray
    displacement: FloatArray
    ends: NDArray[np.intp]

    @classmethod
    def of(
        cls, t: FloatArray, displacement: FloatArray, at: FloatArray, there: FloatArray
    ) -> 'Turns':
        """
        Split steps.

        Parameters
        ----------
        t, displacement : ndarray, shape (n + 1,)
            Ends of the steps [s] and the tool's displacement there [m].
        at, there : ndarray, shape (k,)
            Increasing times within the steps at which the tool changes its speed [s], and its
            displacement there [m].

        Returns
        -------
        Turns
            The split steps.

        """
        places = np.searchsorted(t, at)
        ends = np.arange(t.size) + np.searchsorted(places, np.arange(t.size), side='right')
        return cls(np.insert(t, places, at), np.insert(displacement, places, there), ends)

    def joined(
        self, means: tuple[FloatArray, FloatArray], at_ends: tuple[FloatArray, FloatArray]
    ) -> tuple[FloatArray, ...]:
        """
        Put together what is known of the split steps.

        Parameters
        ----------
        means : (ndarray, ndarray), shapes (N,) and (p, N)
            Means over the split steps, of a value and of its derivatives.
        at_ends : (ndarray, ndarray), shapes (N + 1,) and (p, N + 1)
            What is known at their ends.

        Returns
        -------
        tuple of ndarray, shapes (n,), (p, n), (n + 1,) and (p, n + 1)
            The means over the steps, and what is known at their ends.

        """
        p, n = means[1].shape[0], self.ends.size - 1
        result = np.empty(n), np.empty((p, n)), np.empty(n + 1), np.empty((p, n + 1))
        _join(self.t, self.ends, *means, *at_ends, *result)
        return result


@kernel(error_model='numpy')
def _join(  # type: ignore[no-untyped-def]
    t, ends, mean, d_mean, end, d_end, out, d_out, end_out, d_end_out
):
    """Fill the last four."""
    _join_row(t, ends, mean, end, out, end_out)
    for j in range(d_mean.shape[0]):
        _join_row(t, ends, d_mean[j], d_end[j], d_out[j], d_end_out[j])


@kernel(error_model='numpy')
def _join_row(t, ends, mean, end, out, end_out):  # type: ignore[no-untyped-def]
    """Fill the last two."""
    end_out[0] = end[ends[0]]
    for i in range(ends.size - 1):
        first = ends[i]
        last = ends[i + 1]
        end_out[i + 1] = end[last]
        if last == first + 1:
            out[i] = mean[first]
            continue
        total = 0.0
        for k in range(first, last):
            total += mean[k] * (t[k + 1] - t[k])
        out[i] = total / (t[last] - t[first])
