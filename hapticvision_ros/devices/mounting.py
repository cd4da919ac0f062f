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

"""Where a sensor sits: its pose in another frame."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, sin

from hapticvision_ros.core.records import FloatArray
import numpy as np


def rotation_from_rpy(roll: float, pitch: float, yaw: float) -> FloatArray:
    """
    Return the rotation matrix of fixed-axis roll, pitch and yaw (REP-103).

    Parameters
    ----------
    roll, pitch, yaw : float
        Angles about x, then y, then z of the outer frame [rad].

    Returns
    -------
    ndarray, shape (3, 3)
        Turns coordinates of the inner frame into those of the outer.

    """
    cr, sr, cp, sp = cos(roll), sin(roll), cos(pitch), sin(pitch)
    cy, sy = cos(yaw), sin(yaw)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


@dataclass(frozen=True, slots=True)
class Pose:
    """
    The pose of an inner frame in an outer one.

    Parameters
    ----------
    rotation : ndarray, shape (3, 3)
        Turns coordinates of the inner frame into those of the outer.
    translation : ndarray, shape (3,)
        Origin of the inner frame in the outer [m].

    """

    rotation: FloatArray
    translation: FloatArray

    @classmethod
    def of(cls, numbers: Sequence[float]) -> 'Pose':
        """
        Return the pose of six numbers, as a parameter gives it.

        Parameters
        ----------
        numbers : sequence of float
            x, y, z [m], roll, pitch, yaw [rad].

        Raises
        ------
        ValueError
            If there are not six.

        """
        x, y, z, roll, pitch, yaw = numbers
        return cls(rotation_from_rpy(roll, pitch, yaw), np.array([x, y, z]))
