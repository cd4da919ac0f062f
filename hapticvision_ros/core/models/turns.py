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

    def means(self, value: FloatArray) -> FloatArray:
        """Return the means over the steps of means over the split ones; (p, N) to (p, n)."""
        result = np.empty((value.shape[0], self.ends.size - 1))
        _means(self.t, self.ends, value, result)
        return result

    def at_ends(self, value: FloatArray) -> FloatArray:
        """Return what is known at the ends of the split steps at those of the steps."""
        return np.take(value, self.ends, axis=-1)


@kernel(error_model='numpy')
def _means(t, ends, value, result):  # type: ignore[no-untyped-def]
    """Fill `result`."""
    for j in range(value.shape[0]):
        for i in range(ends.size - 1):
            first = ends[i]
            last = ends[i + 1]
            if last == first + 1:
                result[j, i] = value[j, first]
                continue
            total = 0.0
            for k in range(first, last):
                total += value[j, k] * (t[k + 1] - t[k])
            result[j, i] = total / (t[last] - t[first])
