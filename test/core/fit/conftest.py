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
Trials with known answers.

`two_decays` writes down the paper's two curves; `BinghamBody` integrates the network of springs
and dashpots with scipy, so that nothing here shares code with what is tested.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

from hapticvision_ros.core.records import Segmentation, Signal, Trial
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.signal import lfilter

TOP = 0.040


@dataclass(frozen=True)
class TwoDecays:
    """A trial whose force and displacement height are eqs. (4) and (10) and nothing else."""

    relaxation_time: float = 2.0
    F0: float = 8.0
    F_inf: float = 5.0
    retardation_time: float = 0.9
    H0: float = 0.001
    H_inf: float = 0.007
    at_once: float = 0.0
    hold: float = 12.0
    recovery: float = 6.0
    push_speed: float = 0.005
    withdrawal: float = 0.02
    depth: float = 0.010
    force_noise: float = 0.0
    height_noise: float = 0.0
    correlation: float = 0.0
    force_rate: float = 200.0
    height_rate: float = 100.0
    force_zero: float = 0.3
    seed: int = 0

    def noise(self, count: int, std: float, seed: int) -> np.ndarray:
        """Return stationary noise of a first-order autoregression."""
        warm_up = 200
        white = np.random.default_rng((self.seed, seed)).standard_normal(warm_up + count)
        step = np.sqrt(1.0 - self.correlation**2)
        return std * lfilter([step], [1.0, -self.correlation], white)[warm_up:]

    def make(self) -> tuple[Trial, Segmentation]:
        """Return the trial and its true phases."""
        t_contact = 1.0
        t_hold = t_contact + self.depth / self.push_speed
        t_release = t_hold + self.hold
        pressed = self.H0 + self.H_inf + self.at_once
        t_loss = t_release + self.at_once / self.withdrawal
        t_end = t_release + self.recovery
        t = np.arange(0.0, t_end, 1.0 / self.force_rate)
        decay = self.F0 * np.exp(-(t - t_hold) / self.relaxation_time) + self.F_inf
        ramp = (self.F0 + self.F_inf) * (t - t_contact) / (t_hold - t_contact)
        force = np.where(t < t_contact, 0.0, np.where(t < t_hold, ramp, decay))
        force[t >= t_loss] = 0.0
        tool_t = np.arange(0.0, t_end, 0.005)
        tool = np.interp(
            tool_t,
            [0.0, t_contact, t_hold, t_release, t_end],
            [
                TOP + self.push_speed * t_contact,
                TOP,
                TOP - pressed,
                TOP - pressed,
                TOP - pressed + self.withdrawal * self.recovery,
            ],
        )
        height_t = np.arange(0.0, t_end, 1.0 / self.height_rate)
        # The tool hides the dent.
        height_t = height_t[(height_t < t_contact) | (height_t >= t_loss)]
        recovered = self.H0 * np.exp(-(height_t - t_release) / self.retardation_time) + self.H_inf
        height = np.where(height_t < t_contact, 0.0, recovered)
        trial = Trial(
            name='two decays',
            start_ns=0,
            force=Signal(t, self.force_zero + force + self.noise(t.size, self.force_noise, 1)),
            tool_height=Signal(tool_t, tool),
            displacement_height=Signal(
                height_t, height + self.noise(height_t.size, self.height_noise, 2)
            ),
        )
        return trial, Segmentation(
            t_contact=t_contact,
            t_hold=t_hold,
            t_release=t_release,
            t_loss=t_loss,
            t_end=float(t[-1]),
            contact_height=TOP,
            force_zero=self.force_zero,
            push_speed=self.push_speed,
            depth=pressed,
        )


@dataclass(frozen=True)
class BinghamBody:
    """
    The three-element model with a Saint-Venant slider beside C2 (none if yield_force is zero).

    Integrated from eqs. (1) and (2): ``F = K1 z + C1 dz/dt``, and ``F = F_y + C2 dy/dt`` wherever
    that exceeds F_y, else y rests.
    """

    K1: float = 2000.0
    C1: float = 1600.0
    C2: float = 2400.0
    yield_force: float = 6.0

    def flow(self, z: float, speed: float) -> float:
        """Return dz/dt while the tool moves at `speed`."""
        z_dot = (self.C2 * speed - self.K1 * z + self.yield_force) / (self.C1 + self.C2)
        yields = self.C1 * z_dot + self.K1 * z > self.yield_force
        return z_dot if yields else speed

    def make(
        self,
        push_speed: float = 0.005,
        depth: float = 0.010,
        hold: float = 30.0,
        recovery: float = 8.0,
        withdrawal: float = 0.05,
        rate: float = 200.0,
    ) -> tuple[Trial, Segmentation]:
        """Return a noise-free trial and its true phases."""
        t_contact, t_hold = 1.0, 1.0 + depth / push_speed
        t_release = t_hold + hold

        def speed(t: float) -> float:
            return push_speed if t < t_hold else 0.0 if t < t_release else -withdrawal

        def force(t: float, z: float) -> float:
            return self.C1 * self.flow(z, speed(t)) + self.K1 * z

        pieces, z = [], 0.0
        for start, stop in (
            (t_contact, t_hold),
            (t_hold, t_release),
            (t_release, t_release + 60.0),
        ):

            def lost(t: float, state: np.ndarray) -> float:
                return force(t, state[0])

            lost.terminal, lost.direction = True, -1.0  # type: ignore[attr-defined]
            inside = np.nextafter(start, stop), np.nextafter(stop, start)
            at_once = start == t_release and lost(inside[0], np.array([z])) <= 0.0
            if at_once:
                t_loss = t_release
                break
            solution = solve_ivp(
                lambda t, state: [self.flow(state[0], speed(t))],
                inside,
                [z],
                events=lost if start == t_release else None,
                dense_output=True,
                rtol=1e-10,
                atol=1e-13,
                max_step=0.02,
            )
            pieces.append(solution)
            z = float(solution.y[0, -1])
            t_loss = float(solution.t[-1])
        free = solve_ivp(
            lambda t, state: -self.K1 * state / self.C1,
            (t_loss, t_loss + recovery),
            [z],
            dense_output=True,
            rtol=1e-10,
            atol=1e-13,
        )
        t = np.arange(0.0, t_loss + recovery, 1.0 / rate)
        corners = [0.0, t_contact, t_hold, t_release, t[-1]]
        depths = [-push_speed, 0.0, depth, depth, depth - withdrawal * (t[-1] - t_release)]
        tool = np.interp(t, corners, depths)
        tool[t < t_contact] = -push_speed * (t_contact - t[t < t_contact])
        forces = np.zeros_like(t)
        for piece in pieces:
            inside_piece = (t >= piece.t[0]) & (t < piece.t[-1])
            states = piece.sol(t[inside_piece])[0]
            forces[inside_piece] = [
                force(when, z) for when, z in zip(t[inside_piece], states, strict=True)
            ]
        depth_at_loss = float(np.interp(t_loss, corners, depths))
        seen = (t < t_contact) | (t > t_loss)
        height = np.where(
            t < t_contact, 0.0, depth_at_loss - z + free.sol(np.maximum(t, t_loss))[0]
        )
        trial = Trial(
            name='bingham',
            start_ns=0,
            force=Signal(t, forces),
            tool_height=Signal(t, TOP - tool),
            displacement_height=Signal(t[seen], height[seen]),
        )
        return trial, Segmentation(
            t_contact, t_hold, t_release, t_loss, float(t[-1]), TOP, 0.0, push_speed, depth
        )


@pytest.fixture
def two_decays() -> Callable[..., tuple[Trial, Segmentation]]:
    """Return a maker of trials with the paper's two curves."""
    return lambda **changes: replace(TwoDecays(), **changes).make()


@pytest.fixture(scope='session')
def bingham() -> type[BinghamBody]:
    """Return the independently integrated body."""
    return BinghamBody
