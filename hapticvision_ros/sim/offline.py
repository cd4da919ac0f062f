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


"""Whole trials in virtual time: from a simulated cell to a contract bag, faster than real time."""

from dataclasses import dataclass
from math import nan
from pathlib import Path

from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PROVENANCE,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
)
from hapticvision_ros.bag.writer import BagWriter, Compression
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.push_control import PushControl, PushGoal, PushLimits, Reading
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.scene import RangeRenderer, Scene
from hapticvision_ros.sim.world import Readings, World
import numpy as np

START_NS = 1_700_000_000 * 10**9
"""Stamp of virtual time zero in a synthetic bag [ns since the epoch]."""
CONTROL_PERIOD = 0.002
"""Time between two commands to the arm [s]."""
LONGEST_TRIAL = 3600.0
"""A trial that would take longer than this is a mistake [s]."""
MAX_FORCE = 1000.0
"""The simulated load cell takes any load that the objects can bear [N]."""


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """
    What the arm does in a trial.

    Parameters
    ----------
    push_speed : float
        Speed of the push [m/s].
    depth : float
        How far the tool goes on from the touch [m].
    hold_time, recover_time : float
        Duration of the hold, and of the recovery after the tool is back at its start [s].
    zero_time : float
        Rest before the approach, in which the load cell's zero is taken and the undented object
        is seen [s].
    approach_gap : float
        Height above the surface at which the approach slows down to the push [m].
    approach_speed, release_speed : float
        Speed in the air before the push and after the hold [m/s].
    touch_force : float
        Rise of the force that counts as touch [N].

    """

    push_speed: float
    depth: float
    hold_time: float
    recover_time: float
    zero_time: float = 1.0
    approach_gap: float = 0.002
    approach_speed: float = 0.030
    release_speed: float = 0.050
    touch_force: float = 0.2


@dataclass(frozen=True, slots=True)
class CloudPlan:
    """Size of the clouds in pixels, and their depth noise [m]."""

    width: int = 160
    height: int = 120
    depth_noise: float = 0.0005


def record_trial(
    path: Path,
    config: WorldConfig,
    material: Material,
    plan: TrialPlan,
    *,
    seed: int,
    clouds: CloudPlan | None = None,
    displacement_noise: float | None = None,
    compression: Compression = 'zstd',
) -> None:
    """
    Run one trial in virtual time, under the real control law, and write it as a contract bag.

    Parameters
    ----------
    path : Path
        The bag to make: a bare file if it ends in ``.mcap``, else a rosbag2 directory.
    config : WorldConfig
        The cell, with the rates of its devices.
    material : Material
        What the object is made of; the bag tells nothing of it.
    plan : TrialPlan
        What the arm does.
    seed : int
        Seed of all noise: the same call gives the same bag.
    clouds : CloudPlan or None
        The range sensor's clouds; None for no such topic.
    displacement_noise : float or None
        Standard deviation of the displacement height [m], which is sent at the range sensor's
        rate; None for no such topic.
    compression : {'none', 'lz4', 'zstd'}
        Compression of the bag.

    Raises
    ------
    InputError
        If the plan does not fit the cell, or the bag cannot be written.

    """
    arm = config.arm
    world = World(config, material, seed=seed)
    renderer = None
    if clouds is not None:
        sphere = config.soft_body is not None and config.soft_body.sphere
        scene = Scene(config.block, arm.tool_radius, config.range_sensor, sphere)
        renderer = RangeRenderer(
            scene,
            width=clouds.width,
            height=clouds.height,
            depth_noise=clouds.depth_noise,
            seed=seed,
            triangles=None if world.soft is None else world.soft.triangles,
        )
    random = np.random.default_rng([seed, 1])
    with BagWriter(path, compression=compression, atomic=True) as bag:
        bag.write_metadata(
            PROVENANCE,
            {
                'source': 'synthetic: a simulated cell, no measurement',
                'generator': 'hapticvision_ros, simulated world in virtual time',
                'seed': str(seed),
                'licence': 'Apache-2.0',
            },
        )
        phase, velocity = '', nan
        tool, force = Reading(0.0, arm.start_height), Reading(0.0, config.load_cell.zero)
        control = PushControl(
            _goal(config, plan), _limits(config, plan), world.time, arm.start_height
        )
        while not control.finished:
            now_ns = START_NS + round(world.time * 1e9)
            command = control.step(world.time, tool, force)
            if command.phase != phase:
                phase = command.phase
                bag.write_string(PHASE, now_ns, phase)
            if command.push_velocity != velocity:
                velocity = command.push_velocity
                bag.write_float64(PUSH_VELOCITY, now_ns, velocity)
            world.set_push_velocity(command.push_velocity)
            readings = world.advance(world.time + CONTROL_PERIOD)
            if readings.arm:
                tool = Reading(readings.arm[-1].t, readings.arm[-1].tool_height)
            if readings.force:
                force = Reading(readings.force[-1].t, -readings.force[-1].fz)
            _write(bag, readings, renderer, displacement_noise, random)
        if control.reason is not None:
            raise InputError(f'the simulated trial was aborted: {control.reason}')


def _goal(config: WorldConfig, plan: TrialPlan) -> PushGoal:
    """Return what the arm's controller is asked for."""
    return PushGoal(
        push_speed=plan.push_speed,
        depth=plan.depth,
        hold_time=plan.hold_time,
        recover_time=plan.recover_time,
        release_speed=plan.release_speed,
        approach_speed=plan.approach_speed,
        approach_gap=plan.approach_gap,
        clearance=config.arm.start_height - config.block.height,
        touch_force=plan.touch_force,
        zero_time=plan.zero_time,
        surface_height=config.block.height,
    )


def _limits(config: WorldConfig, plan: TrialPlan) -> PushLimits:
    """Return limits that only the cell itself sets."""
    arm = config.arm
    return PushLimits(
        max_force=MAX_FORCE,
        max_speed=max(plan.push_speed, plan.approach_speed, plan.release_speed),
        max_depth=config.block.height - arm.lowest_height,
        lowest_height=arm.lowest_height,
        highest_height=arm.highest_height,
        max_duration=LONGEST_TRIAL,
        stale_time=arm.watchdog,
        frozen_time=0.0,
        heartbeat_time=0.0,
        touch_margin=config.block.height,
        stop_lead=CONTROL_PERIOD + 0.5 * plan.push_speed / arm.acceleration,
    )


def _write(
    bag: BagWriter,
    readings: Readings,
    renderer: RangeRenderer | None,
    displacement_noise: float | None,
    random: np.random.Generator,
) -> None:
    """Write what was measured in one control period."""
    for force in readings.force:
        stamp = START_NS + round(force.t * 1e9)
        bag.write_wrench(stamp, (force.fx, force.fy, force.fz), (force.tx, force.ty, force.tz))
    for arm in readings.arm:
        bag.write_float64(TOOL_HEIGHT, START_NS + round(arm.t * 1e9), arm.tool_height)
    for shape in readings.shape:
        stamp = START_NS + round(shape.t * 1e9)
        if renderer is not None:
            xyz = renderer.render(shape.tool_height, shape.displacement, shape.points)
            bag.write_cloud(stamp, POINTS.frame_id, xyz)
        if displacement_noise is not None:
            height = shape.displacement + displacement_noise * random.standard_normal()
            bag.write_float64(DISPLACEMENT_HEIGHT, stamp, float(height))
