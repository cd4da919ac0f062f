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

"""Two changes of speed that run into each other, of an arm that is known from others."""

from typing import Final, NamedTuple

from hapticvision_ros.core.fit.bend import rounded, Servo
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.records import FloatArray
import numpy as np

_PROBE: Final = 1e-4
"""Steps by which derivatives are told, over an interval of the encoders and over the speed."""
_TELLING: Final = 1e-4
"""Part of what is left below which a drop of the squares tells nothing more."""
_LOOKS: Final = 40


class ShortMove(NamedTuple):
    """
    Straight, then at another speed for a short while, then straight again.

    Parameters
    ----------
    level, slope : float
        The line before it, at time zero [m, m/s].
    t, next_t : float
        When the line between the two changes of speed meets that before and that after [s].
    turn, next_turn : float
        By how much the speed changes [m/s].

    """

    level: float
    slope: float
    t: float
    turn: float
    next_t: float
    next_turn: float

    @property
    def lines(self) -> tuple[tuple[float, float], ...]:
        """Return level at time zero and slope of the three lines [m, m/s]."""
        level, slope = self.level - self.turn * self.t, self.slope + self.turn
        last = level - self.next_turn * self.next_t, slope + self.next_turn
        return (self.level, self.slope), (level, slope), last

    def at(self, t: FloatArray, servo: Servo) -> FloatArray:
        """Return where the tool is at times `t` [s], as an arm makes the changes of speed [m]."""
        way = self.level + self.slope * t
        for at, turn in ((self.t, self.turn), (self.next_t, self.next_turn)):
            away = t - at
            way += turn * (np.maximum(away, 0.0) + rounded(away, servo.shape(turn)))
        return np.asarray(way)


def short_move(
    t: FloatArray, value: FloatArray, noise: float, servo: Servo, start: ShortMove
) -> tuple[ShortMove, tuple[float, float]] | None:
    """
    Return the short move that follows samples best.

    Neither of its changes of speed shows by itself between lines; how an arm makes them, which
    longer ways have told, tells where they are.

    Parameters
    ----------
    t, value : ndarray, shape (n,)
        Samples of the encoders from before the first to after the second [s, m].
    noise : float
        Standard deviation of a sample [m].
    servo : Servo
        How the arm changes its speed.
    start : ShortMove
        One near the best.

    Returns
    -------
    tuple of (ShortMove, (float, float)), or None
        And the standard errors of when it begins and ends [s]. None where the samples do not tell
        it, or the changes of speed would not come in turn, or turn the same way.

    """
    step = float(np.median(np.diff(t)))
    speed = max(abs(start.turn), abs(start.next_turn))
    middle = 0.5 * (start.t + start.next_t)
    # Of the order of one; the line before is told in the middle, where its error is small.
    scale = np.array([speed * step, speed, step, speed, step, speed])
    begun = np.array([start.level + start.slope * middle, *start[1:]])

    def move(x: FloatArray) -> ShortMove:
        level, slope, *others = (begun + scale * x).tolist()
        return ShortMove(level - slope * middle, slope, *others)

    def left(x: FloatArray) -> FloatArray:
        return (value - move(x).at(t, servo)) / noise

    def evaluate(x: FloatArray) -> tuple[FloatArray, FloatArray]:
        here = left(x)
        jacobian = np.empty((here.size, x.size))
        for k in range(x.size):
            moved = x.copy()
            moved[k] += _PROBE
            jacobian[:, k] = (left(moved) - here) / _PROBE
        return here, jacobian

    found = minimise(evaluate, np.zeros(6), tolerance=_TELLING, max_evaluations=_LOOKS)
    best = move(found.theta)
    errors = scale * np.sqrt(np.diag(found.covariance()))
    # Of a very short one a longer way at less speed is as good, and a search goes on for long.
    if (
        not np.isfinite(errors).all()
        or not best.t < best.next_t
        or best.turn * best.next_turn >= 0.0
    ):
        return None
    return best, (float(errors[2]), float(errors[4]))
