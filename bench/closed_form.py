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
Campaigns of the three-element model in closed form, under noise with memory.

Push, hold and release have a constant speed each, so that the stretch of K1 is one exponential in
each of them; nothing here shares code with what is tested.
"""

from dataclasses import dataclass

from hapticvision_ros.core.records import Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
import numpy as np
from scipy.optimize import brentq
from scipy.signal import lfilter

TOP = 0.040
PUSHES = (
    (0.002, 0.004),
    (0.005, 0.006),
    (0.005, 0.003),
    (0.002, 0.006),
    (0.010, 0.006),
    (0.010, 0.004),
)
"""Speed [m/s] and depth [m] of the trials."""


@dataclass(frozen=True)
class Body:
    """The three elements [N/m, N.s/m]."""

    K1: float = 2000.0
    C1: float = 1600.0
    C2: float = 2400.0

    @property
    def logarithms(self) -> np.ndarray:
        """Return what a fit works with."""
        return np.log([self.K1, self.C1, self.C2])

    def stretch(self, start: float, speed: float, after: np.ndarray | float) -> np.ndarray:
        """Return the stretch of K1 after some time at a constant speed of the tool."""
        final = self.C2 * speed / self.K1
        return final + (start - final) * np.exp(-after * self.K1 / (self.C1 + self.C2))

    def force(self, stretch: np.ndarray | float, speed: float) -> np.ndarray:
        """Return the force at a stretch and a speed of the tool."""
        rate = (self.C2 * speed - self.K1 * stretch) / (self.C1 + self.C2)
        return self.K1 * stretch + self.C1 * rate


@dataclass(frozen=True)
class Cell:
    """How a trial is run and recorded."""

    rate: float = 200.0
    tool_rate: float = 200.0
    height_rate: float = 30.0
    hold: float = 10.0
    recovery: float = 6.0
    withdrawal: float = 0.05
    force_noise: float = 0.05
    correlation: float = 0.6
    height_noise: float = 1e-4
    encoder_noise: float = 5e-6
    force_zero: float = 0.3
    release: bool = True


def record(body: Body, cell: Cell, speed: float, depth: float, seed: tuple[int, ...]) -> Trial:
    """Return a trial whose touch falls anywhere between two samples."""
    random = np.random.default_rng(seed)
    touch = 1.0 + random.uniform(0.0, 0.01)
    t_hold = touch + depth / speed
    t_release = t_hold + cell.hold
    end = t_release + cell.recovery if cell.release else t_release
    pushed = float(body.stretch(0.0, speed, t_hold - touch))
    held = float(body.stretch(pushed, 0.0, cell.hold))
    withdrawn = 0.0
    if body.force(held, -cell.withdrawal) > 0.0:
        withdrawn = brentq(
            lambda s: body.force(body.stretch(held, -cell.withdrawal, s), -cell.withdrawal),
            0.0,
            depth / cell.withdrawal,
        )
    left = float(body.stretch(held, -cell.withdrawal, withdrawn))
    t_loss = t_release + withdrawn
    far = 1e3
    corners = [touch - far, touch, t_hold, t_release, t_release + far]
    heights = [-far * speed, 0.0, depth, depth, depth - far * cell.withdrawal]

    t = np.arange(0.0, end, 1.0 / cell.rate)
    push = (t >= touch) & (t < t_hold)
    hold = (t >= t_hold) & (t < t_release)
    release = (t >= t_release) & (t < t_loss)
    force = np.zeros_like(t)
    force[push] = body.force(body.stretch(0.0, speed, t[push] - touch), speed)
    force[hold] = body.force(body.stretch(pushed, 0.0, t[hold] - t_hold), 0.0)
    back = body.stretch(held, -cell.withdrawal, t[release] - t_release)
    force[release] = body.force(back, -cell.withdrawal)
    step = cell.force_noise * np.sqrt(1.0 - cell.correlation**2)
    white = random.standard_normal(t.size + 500)
    noise = lfilter([step], [1.0, -cell.correlation], white)[500:]

    tool_t = np.arange(0.0, end, 1.0 / cell.tool_rate)
    tool = np.interp(tool_t, corners, heights)
    height_t = np.arange(0.0, end, 1.0 / cell.height_rate) + random.uniform(0.0, 0.01)
    height = np.where(height_t < touch, 0.0, np.interp(height_t, corners, heights))
    free = height_t >= t_loss
    recovered = left * np.exp(-(height_t[free] - t_loss) * body.K1 / body.C1)
    height[free] = depth - cell.withdrawal * withdrawn - left + recovered
    return Trial(
        name=f'speed_{speed * 1e3:g}_depth_{depth * 1e3:g}',
        start_ns=0,
        force=Signal(t, cell.force_zero + force + noise),
        tool_height=Signal(
            tool_t, TOP - tool + cell.encoder_noise * random.standard_normal(tool_t.size)
        ),
        displacement_height=Signal(
            height_t, height + cell.height_noise * random.standard_normal(height_t.size)
        ),
    )


def campaign(
    seed: int, trials: int = 3, body: Body | None = None, cell: Cell | None = None
) -> list[tuple[Trial, Segmentation]]:
    """Return trials with the phases that the signals tell."""
    body = Body() if body is None else body
    cell = Cell() if cell is None else cell
    made = []
    for index, (speed, depth) in enumerate(PUSHES[:trials]):
        trial = record(body, cell, speed, depth, (seed, index))
        made.append((trial, segment(trial.force, trial.tool_height, trial.displacement_height)))
    return made
