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

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, sqrt
from pathlib import Path

import numpy as np

from hapticvision_ros.bag.contract import (
    DISPLACEMENT_HEIGHT,
    PHASE,
    POINTS,
    PUSH_VELOCITY,
    TOOL_HEIGHT,
)
from hapticvision_ros.bag.writer import BagWriter, Compression, PROVENANCE
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.scene import RangeRenderer, Scene
from hapticvision_ros.sim.world import Readings, World

START_NS = 1_700_000_000 * 10**9
"""Stamp of virtual time zero in a synthetic bag [ns since the epoch]."""
CONTROL_PERIOD = 0.002
"""Time between two commands to the arm [s]."""
LONGEST_PUSH = 3600.0
"""A push that would take longer than this is a mistake [s]."""
ARRIVED = 1e-6
"""The tool has reached a height when it is this near [m]."""


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """
    What the arm does in a trial.

    Parameters
    ----------
    push_speed : float
        Speed of the push [m/s].
    depth : float
        How far the tool goes below the block's top [m].
    hold_time, recover_time : float
        Duration of the hold, and of the recovery after the tool is back at its start [s].
    baseline_time : float
        Rest before the approach, in which the undented object is seen [s].
    approach_gap : float
        Height above the block's top at which the fast approach becomes the push [m].
    approach_speed, retract_speed : float
        Speed in the air before the push and after the hold [m/s].

    """

    push_speed: float
    depth: float
    hold_time: float
    recover_time: float
    baseline_time: float = 1.0
    approach_gap: float = 0.002
    approach_speed: float = 0.020
    retract_speed: float = 0.050


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
    Run one trial in virtual time and write it as a contract bag.

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
    top, arm = config.block.height, config.arm
    if not arm.lowest_height <= top - plan.depth < top:
        raise InputError(
            f'a depth of {plan.depth * 1e3:g} mm does not fit: it must be above 0 and at most '
            f'{(top - arm.lowest_height) * 1e3:g} mm, where the arm has its end stop'
        )
    if not 0.0 < plan.approach_gap < arm.start_height - top:
        raise InputError(
            f'an approach_gap of {plan.approach_gap * 1e3:g} mm does not fit: it must be above 0 '
            f'and below {(arm.start_height - top) * 1e3:g} mm, where the arm starts'
        )
    if not min(plan.push_speed, plan.approach_speed, plan.retract_speed) > 0.0:
        raise InputError('the speeds of a trial must be above zero')
    if plan.depth + plan.approach_gap > plan.push_speed * LONGEST_PUSH:
        raise InputError(
            f'a push of {plan.depth * 1e3:g} mm at {plan.push_speed * 1e3:g} mm/s takes over an '
            'hour: push faster'
        )
    renderer = None
    if clouds is not None:
        scene = Scene(config.block, arm.tool_radius, config.range_sensor)
        renderer = RangeRenderer(
            scene,
            width=clouds.width,
            height=clouds.height,
            depth_noise=clouds.depth_noise,
            seed=seed,
        )
    random = np.random.default_rng([seed, 1])
    world = World(config, material, seed=seed)
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
        phase, command = '', inf
        for new_phase, new_command in _motion(world, config, plan):
            now_ns = START_NS + round(world.time * 1e9)
            if new_phase != phase:
                phase = new_phase
                bag.write_string(PHASE, now_ns, phase)
            if new_command != command:
                command = new_command
                bag.write_float64(PUSH_VELOCITY, now_ns, command)
            world.set_push_velocity(command)
            readings = world.advance(world.time + CONTROL_PERIOD)
            _write(bag, readings, renderer, displacement_noise, random)
        bag.write_string(PHASE, START_NS + round(world.time * 1e9), 'done')


def _motion(world: World, config: WorldConfig, plan: TrialPlan) -> Iterator[tuple[str, float]]:
    """Yield the phase and the commanded push velocity [m/s] of each control period."""
    arm, top = config.arm, config.block.height
    start = world.tool_height

    def rest(phase: str, duration: float) -> Iterator[tuple[str, float]]:
        stop = world.time + duration
        while world.time < stop:
            yield phase, 0.0

    def descend(phase: str, speed: float, height: float) -> Iterator[tuple[str, float]]:
        """Move down to `height`, braking with half of the arm's acceleration."""
        while (left := world.tool_height - height) > ARRIVED:
            yield phase, min(speed, sqrt(arm.acceleration * left), left / CONTROL_PERIOD)

    yield from rest('approach', plan.baseline_time)
    yield from descend('approach', plan.approach_speed, top + plan.approach_gap)
    yield from descend('push', plan.push_speed, top - plan.depth)
    yield from rest('hold', plan.hold_time)
    while world.tool_height < start:
        yield 'release', -plan.retract_speed
    yield from rest('recover', plan.recover_time)


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
            xyz = renderer.render(shape.tool_height, shape.displacement)
            bag.write_cloud(stamp, POINTS.frame_id, xyz)
        if displacement_noise is not None:
            height = shape.displacement + displacement_noise * random.standard_normal()
            bag.write_float64(DISPLACEMENT_HEIGHT, stamp, float(height))
