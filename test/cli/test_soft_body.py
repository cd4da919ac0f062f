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
From a body that deforms over its clouds to parameters, and back to its shape.

The simulated cell and what looks at it share nothing but the messages of a bag: the body of the
cell is explicit, with mass, in cells of 5 mm; the one that is fitted implicit, in cells of 4 mm.
"""

from dataclasses import replace
import json
from pathlib import Path

from hapticvision_ros.cli.main import main
from hapticvision_ros.sim import offline
from hapticvision_ros.sim.config import load_config, SoftBodyModel, WorldConfig
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.offline import CloudPlan, record_trial, TrialPlan
from hapticvision_ros.sim.world import World
import numpy as np
import pytest

TRUTH = Material(2000.0, 1600.0, 2400.0)
LENGTH, WIDTH, HEIGHT = 0.060, 0.040, 0.020
DEPTH = 0.003


@pytest.fixture
def worlds(monkeypatch: pytest.MonkeyPatch) -> list[World]:
    """Return where the worlds go that the recording makes: their bodies are the truth."""
    made = []

    class Kept(World):
        def __init__(self, *args: object, **options: object) -> None:
            super().__init__(*args, **options)  # type: ignore[arg-type]
            made.append(self)

    monkeypatch.setattr(offline, 'World', Kept)
    return made


def _cell(model: SoftBodyModel) -> WorldConfig:
    """Return a cell whose object deforms as told."""
    cell = load_config()
    return replace(
        cell,
        block=replace(cell.block, length=LENGTH, width=WIDTH, height=HEIGHT, rim_width=0.004),
        load_cell=replace(cell.load_cell, rate=250.0),
        arm=replace(cell.arm, state_rate=100.0, tool_radius=0.008, start_height=0.042),
        range_sensor=replace(cell.range_sensor, rate=5.0, field_of_view=0.21, table_size=0.1),
        soft_body=model,
    )


def test_clouds_that_bulge_tell_parameters_and_shape(tmp_path: Path, worlds: list[World]) -> None:
    cell = _cell(SoftBodyModel(pitch=0.005, step=5e-4, volume_ratio=1.0))
    bag = tmp_path / 'push'
    plan = TrialPlan(push_speed=0.005, depth=DEPTH, hold_time=2.0, recover_time=1.5)
    clouds = CloudPlan(width=96, height=72, depth_noise=0.0003)
    record_trial(bag, cell, TRUTH, plan, seed=1, clouds=clouds)
    assert main(['fit', str(bag), '--model', 'three-element', '--out', str(tmp_path / 'fit')]) == 0
    told = json.loads((tmp_path / 'fit' / 'result.json').read_text())['before']['parameters']
    # The material is what a slight push meets; 15 % of the height is none, and the volume flows
    # in the fitted chain where springs keep it.
    for name, value in (('K1', 2000.0), ('C1', 1600.0), ('C2', 2400.0)):
        assert told[name]['value'] == pytest.approx(value, rel=0.3)
    result = str(tmp_path / 'fit' / 'result.json')
    command = ['shape', result, str(bag), '--tool-radius', '8mm', '--size', '60x40x20mm']
    command += ['--cell', '4mm', '--rounds', '1', '--out', str(tmp_path / 'shape')]
    assert main(command) == 0
    shape = json.loads((tmp_path / 'shape' / 'shape.json').read_text())
    (world,) = worlds
    assert world.soft is not None
    rest, points = world.soft.rest, world.soft.points
    residual = world.displacement
    # From the mean of the last frames to the end the dent still rises by some hundredths.
    for side, bound in (('measured', 1e-4), ('simulated', 2e-4)):
        assert shape['residual_m'][side] == pytest.approx(residual, abs=bound)
        assert shape['bouncing_m'][side] == pytest.approx(DEPTH - residual, abs=bound)
    facing = (rest[:, 1] == -0.5 * WIDTH) & (np.abs(rest[:, 2] / HEIGHT - 0.5) < 0.3)
    bulge = float((rest - points)[facing, 1].mean())
    assert bulge > 1e-4, 'of 20 standard errors'
    assert shape['bulge_m']['measured'] == pytest.approx(bulge, abs=3e-5)
    assert shape['bulge_m']['measured_std'] < 1e-5
    assert shape['bulge_m']['simulated'] == pytest.approx(bulge, abs=5e-5)


def test_the_loop_over_real_clouds_finds_a_body_that_does_not_keep_its_volume(
    tmp_path: Path,
) -> None:
    cell = _cell(SoftBodyModel(pitch=0.005, step=1e-3, volume_ratio=0.0))
    clouds = CloudPlan(width=96, height=72, depth_noise=0.0003)
    bags = []
    for number, (speed, depth) in enumerate(((0.005, 0.003), (0.008, 0.004))):
        plan = TrialPlan(push_speed=speed, depth=depth, hold_time=1.5, recover_time=1.0)
        bags.append(str(tmp_path / f'push_{number}'))
        record_trial(Path(bags[-1]), cell, TRUTH, plan, seed=number, clouds=clouds)
    assert main(['fit', *bags, '--model', 'three-element', '--out', str(tmp_path / 'fit')]) == 0
    command = ['shape', str(tmp_path / 'fit' / 'result.json'), *bags, '--tool-radius', '8mm']
    command += ['--size', '60x40x20mm', '--cell', '5mm', '--rounds', '1', '--average', '3']
    assert main([*command, '--close-loop', '--out', str(tmp_path / 'shape')]) == 0
    table = json.loads((tmp_path / 'shape' / 'shapes.json').read_text())
    first, *more = table['loop']
    assert first['accepted'], first['verdict']
    assert first['chosen'] == 'volume ratio 0'
    assert first['held_out_after_m'] < 0.5 * first['held_out_before_m']
    assert [turn['accepted'] for turn in more] == [False]
    # The other tip has been tried, with a model of its own.
    assert first['fitted_anew']['model'] == 'three-element+contact_growth'
    assert set(first['fitted_anew']['parameters']) == {'K1', 'C1', 'C2', 'm'}
    for bag in bags:
        path = tmp_path / 'shape' / Path(bag).name / 'shape.json'
        told = json.loads(path.read_text())
        assert told['simulation']['volume_ratio'] == 0.0
        assert told['fitted_anew'] is None
