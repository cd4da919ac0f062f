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


"""The simulated arm and load cell: limits of motion, and noise as it is configured."""

from dataclasses import replace

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.world import Readings, World
import numpy as np
import pytest


def world_of(config: WorldConfig, name: str = 'soft_dough', seed: int = 1) -> World:
    return World(config, config.material(name), seed=seed)


def drive(world: World, velocity: float, duration: float) -> Readings:
    """Command a velocity for a time, often enough for the watchdog."""
    collected = Readings()
    stop = world.time + duration
    while world.time < stop - 1e-9:
        world.set_push_velocity(velocity)
        readings = world.advance(min(world.time + 0.01, stop))
        collected.force += readings.force
        collected.arm += readings.arm
        collected.shape += readings.shape
    return collected


def test_devices_sample_at_their_rates(config: WorldConfig) -> None:
    rates = replace(
        config,
        load_cell=replace(config.load_cell, rate=300.0),
        arm=replace(config.arm, state_rate=125.0),
        range_sensor=replace(config.range_sensor, rate=30.0),
    )
    readings = world_of(rates).advance(2.0)
    assert [len(x) for x in (readings.force, readings.arm, readings.shape)] == [600, 250, 60]
    times = np.array([reading.t for reading in readings.force])
    # A sample falls on the next step of the simulation.
    late = times - np.arange(1, 601) / 300.0
    assert late.min() > -1e-9
    assert late.max() < config.time_step


def test_advancing_in_pieces_changes_nothing(config: WorldConfig) -> None:
    whole, pieces = world_of(config), world_of(config)
    whole.set_push_velocity(0.01)
    pieces.set_push_velocity(0.01)
    expected = whole.advance(0.5).force
    got = [reading for k in range(1, 101) for reading in pieces.advance(0.005 * k).force]
    assert got == expected


def test_the_same_seed_gives_the_same_readings(config: WorldConfig) -> None:
    first, second, other = (world_of(config, seed=seed) for seed in (5, 5, 6))
    readings = first.advance(0.1)
    assert readings == second.advance(0.1)
    assert readings != other.advance(0.1)


def test_the_arm_never_exceeds_its_acceleration(config: WorldConfig) -> None:
    world = world_of(config)
    heights = []
    for velocity in (0.02, -0.03, 0.0):
        for _ in range(400):
            world.set_push_velocity(velocity)
            world.advance(world.time + 0.001)
            heights.append(world.tool_height)
    velocity = -np.diff(heights) / 0.001
    acceleration = np.diff(velocity) / 0.001
    assert np.abs(acceleration).max() <= config.arm.acceleration * (1 + 1e-6)
    assert velocity.max() == pytest.approx(0.02)
    assert velocity.min() == pytest.approx(-0.03)
    assert velocity[-1] == pytest.approx(0.0, abs=1e-12)


def test_the_arm_stops_by_itself_when_no_command_comes(config: WorldConfig) -> None:
    world = world_of(config)
    world.set_push_velocity(0.01)
    world.advance(5.0)
    travel = config.arm.start_height - world.tool_height
    assert travel == pytest.approx(0.01 * config.arm.watchdog, rel=0.1)


def test_a_late_world_does_not_blame_the_commander(config: WorldConfig) -> None:
    world = world_of(config)
    world.set_push_velocity(0.01, at=0.5)
    world.advance(0.5)
    travel = config.arm.start_height - world.tool_height
    assert travel == pytest.approx(0.01 * 0.49, rel=1e-6), '20 ms at half speed to accelerate'


@pytest.mark.parametrize(('velocity', 'end'), [(-0.1, 'highest_height'), (0.1, 'lowest_height')])
def test_the_arm_rests_at_its_end_stops(config: WorldConfig, velocity: float, end: str) -> None:
    world = world_of(config, 'spring1')
    drive(world, velocity, 2.0)
    assert world.tool_height == getattr(config.arm, end)


def test_encoders_read_the_height_to_their_resolution(config: WorldConfig) -> None:
    arm = replace(config.arm, encoder_noise=0.0, encoder_resolution=1e-4)
    world = world_of(replace(config, arm=arm))
    readings = drive(world, 0.003, 1.0)
    heights = np.array([reading.tool_height for reading in readings.arm])
    np.testing.assert_allclose(heights / 1e-4, np.round(heights / 1e-4), atol=1e-6)
    assert heights[-1] == pytest.approx(world.tool_height, abs=0.51e-4)


def test_load_cell_noise_has_its_size_memory_and_zero(config: WorldConfig) -> None:
    cell = replace(
        config.load_cell,
        white_noise=0.02,
        slow_noise=0.03,
        slow_noise_time=0.005,
        zero=0.35,
        drift=0.01,
    )
    readings = world_of(replace(config, load_cell=cell)).advance(20.0).force
    t = np.array([reading.t for reading in readings])
    force = -np.array([reading.fz for reading in readings])
    slope, zero = np.polyfit(t, force, 1)
    noise = force - (zero + slope * t)
    # 20,000 samples, about 2,000 of them independent: the mean is good to 0.002 N.
    assert zero == pytest.approx(0.35, abs=0.008)
    assert slope == pytest.approx(0.01, abs=6e-4)
    assert noise.std() == pytest.approx(np.hypot(0.02, 0.03), rel=0.05)
    neighbours = np.mean(noise[1:] * noise[:-1]) / np.mean(noise**2)
    assert neighbours == pytest.approx(np.exp(-0.2) * 9.0 / 13.0, abs=0.04)


def test_contact_force_is_minus_z_in_the_load_cells_frame(config: WorldConfig) -> None:
    world = world_of(config, 'spring1')
    drive(world, 0.02, 2.2)
    readings = drive(world, 0.0, 0.5)
    depth = config.block.height - world.tool_height
    assert depth > 0.002
    stiffness = config.material('spring1').elastic_stiffness
    measured = -np.mean([reading.fz for reading in readings.force[-200:]])
    # The mean of 200 samples of correlated noise of 0.022 N is good to 0.01 N.
    assert measured == pytest.approx(stiffness * depth + config.load_cell.zero, abs=0.03)


def test_a_new_sample_is_fresh_and_needs_the_tool_out_of_the_way(config: WorldConfig) -> None:
    world = world_of(config)
    drive(world, 0.02, 2.4)
    assert world.contact_force > 0.0
    with pytest.raises(InputError, match='tool is in the way'):
        world.place_new_sample()
    drive(world, -0.05, 1.0)
    assert world.displacement > 0.001
    world.place_new_sample()
    assert world.displacement == 0.0


def test_an_arm_that_starts_inside_the_block_is_refused(config: WorldConfig) -> None:
    with pytest.raises(InputError, match='must start above the block'):
        world_of(replace(config, arm=replace(config.arm, start_height=0.03)))
