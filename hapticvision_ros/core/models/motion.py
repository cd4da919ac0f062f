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

"""How a path of the tool goes on within the steps of a fit."""

from hapticvision_ros.core.records import FloatArray
import numpy as np


def acceleration(t: FloatArray, displacement: FloatArray) -> FloatArray:
    """
    Return the mean acceleration in each step of a path.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the steps [s].
    displacement : ndarray, shape (n + 1,)
        Where the tool is then [m].

    Returns
    -------
    ndarray, shape (n,)
        [m/s^2].

    """
    length = np.diff(t)
    speed = np.diff(displacement) / length
    # The speed at the end of a step is that of the parabola through it and its neighbours.
    at_ends = np.concatenate(
        (
            speed[:1],
            (length[:-1] * speed[1:] + length[1:] * speed[:-1]) / (length[:-1] + length[1:]),
            speed[-1:],
        )
    )
    return np.asarray(np.diff(at_ends) / length)
