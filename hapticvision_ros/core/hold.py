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
How long to hold: the relaxation time, estimated while the force decays.

Under a held displacement the force of the three-element model, with or without a Saint-Venant
slider, is ``F = F_inf + A exp(-t / T)``. Then ``F' = -(F - F_inf) / T``, and integrated

    ``F(t) = F(0) - S(t) / T + (F_inf / T) t``, with ``S(t)`` the integral of F,

which is linear in S and t: sums of three products, updated sample by sample, give T at any time.
The integral has next to no noise, so that the noise of F does not bias T.

References
----------
J. Jacquelin, Regressions et equations integrales, 2009 (exponential functions by integration).

"""

from typing import Final, NamedTuple

import numpy as np

BLOCK: Final = 0.02
"""Samples are averaged over this time [s]: neighbours in a block may have the same noise."""

LEAST_BLOCKS: Final = 12
"""Before that many blocks nothing is told."""

SMALLEST_DECAY: Final = 6.0
"""The force must have fallen by so many standard deviations of a block."""


class RelaxationTime(NamedTuple):
    """An estimate of the relaxation time and its standard deviation [s]."""

    value: float
    std: float


class HoldEstimator:
    """
    Estimates the relaxation time during a hold, in constant time a sample.

    Parameters
    ----------
    t : float
        When the hold began [s].

    """

    def __init__(self, t: float) -> None:
        self._start = t
        self._last: tuple[float, float] | None = None
        self._integral = 0.0
        self._first = 0.0
        self._sums = np.zeros((4, 4))
        self._blocks = 0
        self._in_block = np.zeros(3)
        self._block_ends = t + BLOCK
        self._samples = 0

    def add(self, t: float, force: float) -> None:
        """Take a force [N] that was measured at `t` [s], unless it is no newer than the last."""
        t -= self._start
        if self._last is None:
            self._first = force
        else:
            before, value = self._last
            if t <= before:
                return
            self._integral += 0.5 * (value + force - 2.0 * self._first) * (t - before)
        self._last = (t, force)
        if t + self._start >= self._block_ends and self._samples:
            mean = self._in_block / self._samples
            row = np.array((1.0, mean[1], mean[2], mean[0]))
            self._sums += np.outer(row, row)
            self._blocks += 1
            self._in_block[:] = 0.0
            self._samples = 0
            # Where samples are rarer than blocks, each is a block of its own.
            self._block_ends = max(self._block_ends + BLOCK, t + self._start)
        # Counted from the first force, so that the sums do not lose their last digits.
        self._in_block += (force - self._first, self._integral, t)
        self._samples += 1

    def estimate(self) -> RelaxationTime | None:
        """
        Return the relaxation time, or None while the force tells none.

        Returns
        -------
        RelaxationTime or None
            None for too few samples, and for a force that does not decay to a limit, such as a
            spring's.

        """
        if self._blocks < LEAST_BLOCKS:
            return None
        normal, right = self._sums[:3, :3], self._sums[:3, 3]
        scale = np.sqrt(np.diag(normal))
        if not np.all(scale > 0.0):
            return None
        try:
            inverse = np.linalg.inv(normal / np.outer(scale, scale)) / np.outer(scale, scale)
        except np.linalg.LinAlgError:
            return None
        solution = inverse @ right
        rest = max(0.0, float(self._sums[3, 3] - solution @ right))
        variance = rest / (self._blocks - 3)
        rate, rate_std = -float(solution[1]), float(np.sqrt(max(0.0, variance * inverse[1, 1])))
        mean = self._sums[0, 3] / self._blocks
        spread = float(np.sqrt(max(0.0, self._sums[3, 3] / self._blocks - mean * mean)))
        if not rate > 0.0 or spread < SMALLEST_DECAY * float(np.sqrt(variance)) / 3.5:
            return None
        return RelaxationTime(1.0 / rate, rate_std / rate**2)
