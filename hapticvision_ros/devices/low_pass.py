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

"""A low-pass with one delay for all frequencies."""

from collections import deque
from typing import Final

from hapticvision_ros.core.devices import WrenchSample
import numpy as np

LARGEST_HALF_WIDTH: Final = 500
"""Readings on each side of the one in the middle, at most."""


class LowPass:
    """
    A Hann-weighted mean over as many readings before as after the one it stands for.

    Being symmetric, it delays all frequencies alike, and the result carries the stamp of the
    reading in the middle: it is known later, but not shifted in time. With the interval between
    two readings, its -3 dB lie at 0.36 / (delay + interval). After a break the first results come
    from fewer readings.

    Parameters
    ----------
    delay : float
        Time after which a reading's result is known [s].
    rate : float
        Readings each second [Hz].

    """

    def __init__(self, delay: float, rate: float) -> None:
        self._half = min(round(delay * rate), LARGEST_HALF_WIDTH)
        self.delay = self._half / rate
        self._recent: deque[WrenchSample] = deque(maxlen=2 * self._half + 1)
        self._taken = 0

    def restart(self) -> None:
        """Forget what came before a gap."""
        self._recent.clear()
        self._taken = 0

    def take(self, sample: WrenchSample) -> WrenchSample | None:
        """Return the result that `sample` completes, or None where there is none yet."""
        if not self._half:
            return sample
        self._recent.append(sample)
        self._taken += 1
        if self._taken % 2 == 0 and self._taken < 2 * self._half + 1:
            return None
        middle = self._recent[len(self._recent) // 2]
        weights = _hann(len(self._recent))
        rows = np.array([(*item.force, *item.torque) for item in self._recent])
        fx, fy, fz, tx, ty, tz = (weights @ rows).tolist()
        return WrenchSample(
            middle.stamp_ns, (fx, fy, fz), (tx, ty, tz), middle.saturated, middle.fault
        )


def _hann(count: int) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    weights = np.hanning(count + 2)[1:-1]
    return weights / weights.sum()
