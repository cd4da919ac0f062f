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


"""A trial in virtual time is a contract bag that tells what was measured, and nothing else."""

from dataclasses import fields, replace
from pathlib import Path
import struct

from hapticvision_ros.bag.contract import PHASES, POINTS, TOPICS
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.offline import CloudPlan, record_trial, TrialPlan
from mcap.reader import make_reader
import numpy as np
import pytest

# No round numbers: their bytes would be found in any file.
MATERIAL = Material(
    elastic_stiffness=2013.37,
    retardation_viscosity=1607.91,
    flow_viscosity=2411.53,
    yield_force=6.0173,
    series_stiffness=90127.7,
    parallel_stiffness=11.173,
)
PLAN = TrialPlan(push_speed=0.005, depth=0.006, hold_time=1.0, recover_time=1.0)


@pytest.fixture(scope='module')
def slow_devices(config: WorldConfig) -> WorldConfig:
    """Return the cell with few samples, for small bags."""
    return replace(
        config,
        load_cell=replace(config.load_cell, rate=250.0),
        arm=replace(config.arm, state_rate=250.0),
    )


def record(path: Path, config: WorldConfig, plan: TrialPlan = PLAN, seed: int = 1) -> Path:
    record_trial(
        path,
        config,
        MATERIAL,
        plan,
        seed=seed,
        clouds=CloudPlan(64, 48, 0.0),
        displacement_noise=0.0,
        compression='none',
    )
    return path


@pytest.fixture(scope='module')
def bag(slow_devices: WorldConfig, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a trial with clouds and displacement height."""
    return record(tmp_path_factory.mktemp('bag') / 'trial.mcap', slow_devices)


def test_the_bag_has_the_contracts_topics_and_every_sample(bag: Path) -> None:
    trial = read_trial(bag)
    duration = trial.force.t[-1] - trial.force.t[0]
    for signal, rate in ((trial.force, 250.0), (trial.tool_height, 250.0)):
        assert len(signal) == pytest.approx(duration * rate + 1, abs=2)
    assert trial.clouds is not None
    assert trial.displacement_height is not None
    assert len(trial.clouds) == len(trial.displacement_height)
    assert trial.displacement_source == 'topic'
    assert trial.provenance['licence'] == 'Apache-2.0'
    assert trial.provenance['seed'] == '1'
    assert not trial.warnings


def test_the_arm_does_what_was_planned(bag: Path) -> None:
    trial = read_trial(bag)
    assert [phase for _, phase in trial.phases] == list(PHASES[:-1])
    start = {phase: t for t, phase in trial.phases}
    assert start['release'] - start['hold'] == pytest.approx(PLAN.hold_time, abs=0.005)
    assert start['done'] - start['recover'] == pytest.approx(PLAN.recover_time, abs=0.005)
    pushing = trial.tool_height.between(start['push'] + 0.1, start['hold'] - 0.1)
    speed = -np.polyfit(pushing.t, pushing.value, 1)[0]
    assert speed == pytest.approx(PLAN.push_speed, rel=1e-3)
    held = trial.tool_height.between(start['hold'] + 0.1, start['release'] - 0.1)
    # Touch is noticed within three readings, 60 um at this speed.
    assert 0.040 - held.value.mean() == pytest.approx(PLAN.depth, abs=8e-5)


def test_clouds_and_displacement_height_agree_where_the_dent_is_seen(bag: Path) -> None:
    trial = read_trial(bag)
    assert trial.clouds is not None
    assert trial.displacement_height is not None
    compared = 0
    for frame, height in zip(trial.clouds, trial.displacement_height.value, strict=True):
        assert frame.frame_id == POINTS.frame_id
        points = frame.xyz.reshape(-1, 3)
        seen = points[np.hypot(points[:, 0], points[:, 1]) < 0.006, 2]
        if len(seen) > 8:
            assert 0.040 - np.median(seen) == pytest.approx(height, abs=1e-6)
            compared += height > 0.001
    assert compared > 5


def test_the_bag_tells_nothing_of_the_truth(bag: Path, config: WorldConfig) -> None:
    content = bag.read_bytes()
    for name in config.objects:
        assert name.encode() not in content
    for field in fields(MATERIAL):
        assert field.name.encode() not in content
        assert struct.pack('<d', getattr(MATERIAL, field.name)) not in content
    with bag.open('rb') as stream:
        summary = make_reader(stream).get_summary()
    assert summary is not None
    recorded = {channel.topic for channel in summary.channels.values()}
    assert recorded == {topic.name for topic in TOPICS}


def test_the_same_seed_gives_the_same_file(
    bag: Path, slow_devices: WorldConfig, tmp_path: Path
) -> None:
    again = record(tmp_path / 'trial.mcap', slow_devices)
    assert again.read_bytes() == bag.read_bytes()
    other = record(tmp_path / 'other' / 'trial.mcap', slow_devices, seed=2)
    assert other.read_bytes() != bag.read_bytes()


@pytest.mark.parametrize(
    ('change', 'sentence'),
    [
        ({'depth': 0.036}, 'depth is 36 mm'),
        ({'push_speed': 0.0}, 'push_speed is 0 mm/s'),
        ({'hold_time': 1e4}, 'the cell allows 3600 s'),
        ({'touch_force': 500.0, 'depth': 0.002}, 'aborted.*without touching anything'),
    ],
)
def test_a_plan_that_does_not_fit_leaves_no_bag(
    slow_devices: WorldConfig, tmp_path: Path, change: dict[str, float], sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        record(tmp_path / 'trial', slow_devices, replace(PLAN, **change))
    assert not list(tmp_path.iterdir())
