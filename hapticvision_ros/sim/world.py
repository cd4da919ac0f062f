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


"""The simulated cell in virtual time: an object, an arm that pushes it, and what is measured."""

from dataclasses import dataclass, field
from math import exp, inf, sqrt
from random import Random
from typing import NamedTuple, TYPE_CHECKING

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.objects import DeformableObject, Material

if TYPE_CHECKING:
    from hapticvision_ros.sim.soft_object import SoftObject

LATERAL_FORCE_SHARE = 0.5
"""Noise of the lateral forces, as a share of the white noise along the push."""
TORQUE_ARM = 0.01
"""Lever arm [m] that turns the force noise into the noise of the torques."""


class ForceReading(NamedTuple):
    """Time [s], force [N] and torque [N.m] of one reading of the load cell."""

    t: float
    fx: float
    fy: float
    fz: float
    tx: float
    ty: float
    tz: float


class ArmReading(NamedTuple):
    """Time [s] and tool height [m] of one reading of the arm's encoders."""

    t: float
    tool_height: float


class Shape(NamedTuple):
    """
    What a range sensor has before it: time [s], tool height [m] and the dent's depth H [m].

    Of a soft body also where its nodes are, shape (n, 3) [m].
    """

    t: float
    tool_height: float
    displacement: float
    points: FloatArray | None = None


@dataclass(slots=True)
class Readings:
    """What the devices have measured while the world advanced, in order of time."""

    force: list[ForceReading] = field(default_factory=list)
    arm: list[ArmReading] = field(default_factory=list)
    shape: list[Shape] = field(default_factory=list)


class World:
    """
    An object, an arm and the load cell's noise, stepped in virtual time.

    The same configuration, seed and commands give the same readings.

    Parameters
    ----------
    config : WorldConfig
        The cell.
    material : Material
        What the object is made of.
    seed : int
        Seed of the noise of load cell and encoders.

    """

    def __init__(self, config: WorldConfig, material: Material, *, seed: int) -> None:
        arm, cell = config.arm, config.load_cell
        if not arm.lowest_height < config.block.height < arm.start_height <= arm.highest_height:
            raise InputError(
                'the simulated arm must start above the block and below its upper end stop: '
                f'lowest {arm.lowest_height:g} m, block {config.block.height:g} m, '
                f'start {arm.start_height:g} m, highest {arm.highest_height:g} m'
            )
        self._config = config
        self._soft = _soft_object(config, material)
        self._object = self._soft or DeformableObject(material, config.time_step)
        self._random = Random(seed)
        self._steps = 0
        self._tool_height = arm.start_height
        self._push_velocity = 0.0
        self._target_velocity = 0.0
        self._command_expires = -inf
        self._ar_memory = exp(-1.0 / (cell.rate * cell.slow_noise_time))
        self._ar_noise = cell.slow_noise * self._random.gauss(0.0, 1.0)
        self._next_samples = [1, 1, 1]

    @property
    def time(self) -> float:
        """Return the virtual time [s]."""
        return self._steps * self._config.time_step

    @property
    def tool_height(self) -> float:
        """Return the height of the tool tip above the support plane [m], as it is."""
        return self._tool_height

    @property
    def displacement(self) -> float:
        """Return the depth H of the dent under the tool [m], as it is."""
        return self._object.displacement

    @property
    def contact_force(self) -> float:
        """Return the force of the object on the tool [N], as it is."""
        return self._object.force

    @property
    def soft(self) -> 'SoftObject | None':
        """Return the object where it is a soft body."""
        return self._soft

    def set_push_velocity(self, push_velocity: float, at: float | None = None) -> None:
        """
        Command a speed along the push.

        Parameters
        ----------
        push_velocity : float
            Speed [m/s], positive toward the object.
        at : float, optional
            When the command came, if that is ahead of the world, which was late [s]: the
            watchdog counts from then.

        """
        self._target_velocity = push_velocity
        came = self.time if at is None else max(at, self.time)
        self._command_expires = came + self._config.arm.watchdog

    def place_new_sample(self, material: Material | None = None) -> None:
        """
        Put a fresh object under the tool.

        Parameters
        ----------
        material : Material, optional
            What it is made of; by default as the one before.

        Raises
        ------
        InputError
            If the tool is in the way.

        """
        if self._tool_height <= self._config.block.height:
            raise InputError(
                'the tool is in the way of a new sample: raise it above '
                f'{self._config.block.height * 1e3:g} mm first'
            )
        if material is None:
            self._object.reset()
            return
        self._soft = _soft_object(self._config, material)
        self._object = self._soft or DeformableObject(material, self._config.time_step)

    def advance(self, to_time: float) -> Readings:
        """
        Advance to a virtual time and return what was measured on the way.

        Parameters
        ----------
        to_time : float
            Virtual time to reach [s]; nothing happens if it is past already.

        Returns
        -------
        Readings
            The samples that fell due.

        """
        config = self._config
        arm = config.arm
        dt = config.time_step
        largest_change = arm.acceleration * dt
        top = config.block.height
        obj = self._object
        rates = (config.load_cell.rate, arm.state_rate, config.range_sensor.rate)
        due = [sample / rate for sample, rate in zip(self._next_samples, rates, strict=True)]
        next_due = min(due)
        readings = Readings()
        height, velocity = self._tool_height, self._push_velocity
        for step in range(self._steps + 1, int(to_time / dt + 1e-6) + 1):
            now = step * dt
            target = self._target_velocity if now <= self._command_expires else 0.0
            change = target - velocity
            if change > largest_change:
                change = largest_change
            elif change < -largest_change:
                change = -largest_change
            height -= (velocity + 0.5 * change) * dt
            velocity += change
            if height < arm.lowest_height:
                height, velocity = arm.lowest_height, 0.0
            elif height > arm.highest_height:
                height, velocity = arm.highest_height, 0.0
            obj.advance(top - height)
            self._steps = step
            if now + 1e-9 >= next_due:
                self._tool_height = height
                for stream, rate in enumerate(rates):
                    if now + 1e-9 >= due[stream]:
                        self._measure(stream, now, readings)
                        self._next_samples[stream] += 1
                        due[stream] = self._next_samples[stream] / rate
                next_due = min(due)
        self._tool_height, self._push_velocity = height, velocity
        return readings

    def _measure(self, stream: int, now: float, readings: Readings) -> None:
        """Append one reading of the load cell (0), the arm (1) or the range sensor (2)."""
        if stream == 0:
            readings.force.append(self._read_force(now))
        elif stream == 1:
            readings.arm.append(self._read_arm(now))
        else:
            points = None if self._soft is None else self._soft.points
            readings.shape.append(Shape(now, self._tool_height, self._object.displacement, points))

    def _read_force(self, now: float) -> ForceReading:
        cell = self._config.load_cell
        gauss = self._random.gauss
        memory = self._ar_memory
        self._ar_noise = memory * self._ar_noise + cell.slow_noise * sqrt(
            1.0 - memory * memory
        ) * gauss(0.0, 1.0)
        white = cell.white_noise
        noise = white * gauss(0.0, 1.0) + self._ar_noise + cell.zero + cell.drift * now
        lateral = white * LATERAL_FORCE_SHARE
        torque = lateral * TORQUE_ARM
        return ForceReading(
            now,
            lateral * gauss(0.0, 1.0),
            lateral * gauss(0.0, 1.0),
            # The frame's +z points along the push, the object pushes back.
            -(self._object.force + noise),
            torque * gauss(0.0, 1.0),
            torque * gauss(0.0, 1.0),
            torque * gauss(0.0, 1.0),
        )

    def _read_arm(self, now: float) -> ArmReading:
        arm = self._config.arm
        height = self._tool_height + arm.encoder_noise * self._random.gauss(0.0, 1.0)
        if arm.encoder_resolution > 0.0:
            height = round(height / arm.encoder_resolution) * arm.encoder_resolution
        return ArmReading(now, height)


def _soft_object(config: WorldConfig, material: Material) -> 'SoftObject | None':
    """Return the object as a soft body, where the cell has one."""
    if config.soft_body is None:
        return None
    # It needs numba, which is slow to load and which a chain does without.
    from hapticvision_ros.sim.soft_object import SoftObject

    return SoftObject(
        material, config.block, config.arm.tool_radius, config.soft_body, config.time_step
    )
