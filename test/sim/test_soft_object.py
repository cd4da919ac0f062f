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

"""The deforming object of the simulated cell, and what the range sensor sees of it."""

from dataclasses import replace
from pathlib import Path

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.sim.config import (
    default_config_path,
    load_config,
    SoftBodyModel,
    WorldConfig,
)
from hapticvision_ros.sim.objects import DeformableObject, Material
from hapticvision_ros.sim.scene import RangeRenderer, Scene
from hapticvision_ros.sim.soft_object import SoftObject
from hapticvision_ros.sim.world import World
import numpy as np
import pytest
import yaml

MATERIAL = Material(2000.0, 1600.0, 2400.0)
MODEL = SoftBodyModel(pitch=0.005, step=0.001, volume_ratio=0.0)
STEP = 0.001
RADIUS = 0.008


@pytest.fixture(scope='module')
def small(config: WorldConfig) -> WorldConfig:
    """Return the cell with a small block that deforms."""
    return replace(
        config,
        block=replace(config.block, length=0.03, width=0.03, height=0.02, rim_width=0.004),
        arm=replace(config.arm, tool_radius=RADIUS),
        soft_body=MODEL,
    )


def soft(config: WorldConfig, material: Material = MATERIAL, **changed: object) -> SoftObject:
    model = replace(MODEL, **changed)  # type: ignore[arg-type]
    return SoftObject(material, config.block, RADIUS, model, STEP)


def press(body: SoftObject, depth: float) -> None:
    """Press within half a second, and hold for a tenth."""
    for step in range(1, 601):
        body.advance(depth * min(step / 500, 1.0))


@pytest.mark.parametrize('ratio', [0.0, 1.0])
def test_a_slight_push_meets_the_material(small: WorldConfig, ratio: float) -> None:
    # 0.2 mm in 0.2 s, then held: as the chain, once what the added mass does is over.
    body, chain = soft(small, volume_ratio=ratio), DeformableObject(MATERIAL, STEP)
    pairs = []
    for step in range(1, 1001):
        depth = 2e-4 * min(step * STEP / 0.2, 1.0)
        pairs.append((body.advance(depth), chain.advance(depth)))
    force, told = np.array(pairs).T
    # Dashpots that keep the volume ask for more mass, and in the hold springs keep a volume that
    # nothing flows out of: then more is left of the force.
    times, off = ((0.1, 0.15, 0.19, 0.6, 0.99), 0.03) if ratio == 0.0 else ((0.15, 0.19), 0.08)
    for t in times:
        assert force[round(t / STEP)] == pytest.approx(told[round(t / STEP)], rel=off)


def test_a_body_that_is_not_touched_stays_as_it_is(small: WorldConfig) -> None:
    body = soft(small)
    for depth in (-0.01, -0.001, 0.0):
        assert body.advance(depth) == 0.0
    np.testing.assert_array_equal(body.points, body.rest)


def test_a_fresh_object_has_no_dent(small: WorldConfig) -> None:
    body = soft(small)
    press(body, 0.001)
    assert body.displacement > 0.0
    body.reset()
    assert (body.displacement, body.force) == (0.0, 0.0)
    np.testing.assert_array_equal(body.points, body.rest)


def test_a_body_that_slides_spreads_at_its_foot(small: WorldConfig) -> None:
    spread = []
    for friction in (np.inf, 0.4, 0.2, 0.0):
        body = soft(small, friction=friction)
        press(body, 0.002)
        foot = body.rest[:, 2] == 0.0
        spread.append(float(np.ptp(body.points[foot, 0])) - 0.03)
    assert spread[0] == 0.0
    assert np.all(np.diff(spread) > 3e-5)


def test_a_sphere_makes_a_round_dent(small: WorldConfig) -> None:
    body = soft(small, sphere=True)
    press(body, 0.003)
    pressed = body.points[(body.rest[:, 2] == 0.02)]
    away = np.hypot(pressed[:, 0], pressed[:, 1])
    least = 0.017 + RADIUS - np.sqrt(np.maximum(RADIUS**2 - away**2, 0.0))
    assert np.all(pressed[:, 2] <= least + 1e-9)
    beside = (away > 0.004) & (away < 0.006)
    assert pressed[beside, 2].min() > pressed[away < 1e-6, 2].max() + 5e-4


def rendered(config: WorldConfig, body: SoftObject, tool: float, **options: float) -> np.ndarray:
    scene = Scene(config.block, RADIUS, replace(config.range_sensor, dropout=0.0))
    renderer = RangeRenderer(
        scene, width=120, height=90, depth_noise=0.0, seed=1, triangles=body.triangles, **options
    )
    return renderer.render(tool, body.displacement, body.points)


@pytest.mark.parametrize('yaw', [0.0, 0.4])
def test_at_rest_the_body_is_seen_as_the_block(small: WorldConfig, yaw: float) -> None:
    turned = replace(small, block=replace(small.block, yaw=yaw))
    body = SoftObject(MATERIAL, turned.block, RADIUS, MODEL, STEP)
    scene = Scene(turned.block, RADIUS, replace(small.range_sensor, dropout=0.0))
    block = RangeRenderer(scene, width=120, height=90, depth_noise=0.0, seed=1)
    expected = block.render(0.1, 0.0)
    seen = rendered(turned, body, 0.1)
    same = np.abs(seen - expected).max(axis=2) < 1e-6
    # Pixels on an edge may fall to either side of it.
    assert same.mean() > 0.995


def test_the_dent_is_seen_where_its_nodes_are_and_the_tool_before_it(
    small: WorldConfig,
) -> None:
    body = soft(small)
    press(body, 0.003)
    away = rendered(small, body, 0.1).reshape(-1, 3)
    near = away[np.hypot(away[:, 0], away[:, 1]) < 0.003]
    assert len(near) > 8
    np.testing.assert_allclose(near[:, 2], 0.017, atol=1e-6)
    side = away[(away[:, 2] > 0.005) & (away[:, 2] < 0.012) & (away[:, 1] < -0.01)]
    assert side[:, 1].min() < -0.0151, 'the side bulges'
    down = rendered(small, body, 0.017).reshape(-1, 3)
    assert not (np.hypot(down[:, 0], down[:, 1]) < 0.003).any(), 'the tool hides its dent'


@pytest.mark.parametrize(
    ('material', 'changed', 'complaint'),
    [
        (Material(2000.0), {}, 'needs a dashpot'),
        (Material(2000.0, 1.0, series_stiffness=1e5), {}, 'no spring in series'),
        (Material(2000.0, 1.0, parallel_stiffness=1.0), {}, 'no spring in series or beside'),
        (MATERIAL, {'pitch': 0.007}, 'whole cells'),
        (MATERIAL, {'pitch': 0.010}, 'smaller than a cell'),
    ],
)
def test_what_the_body_cannot_be_is_refused(
    small: WorldConfig, material: Material, changed: dict[str, float], complaint: str
) -> None:
    config = replace(small, soft_body=replace(MODEL, **changed))
    with pytest.raises(InputError, match=complaint):
        World(config, material, seed=1)


def test_the_cell_says_that_its_object_deforms(tmp_path: Path) -> None:
    content = yaml.safe_load(default_config_path().read_text())
    path = tmp_path / 'cell.yaml'

    def read(**section: object) -> WorldConfig:
        path.write_text(yaml.safe_dump(content | {'soft_body': section}))
        return load_config(path)

    assert load_config().soft_body is None
    given = {'pitch': 0.005, 'step': 0.0005, 'volume_ratio': 1}
    assert read(**given).soft_body == SoftBodyModel(0.005, 0.0005, 1.0)
    slides = SoftBodyModel(0.005, 0.0005, 1.0, friction=0.0)
    assert read(**given, friction=0).soft_body == slides
    with pytest.raises(InputError, match='friction is -1, but must lie in 0 to inf'):
        read(**given, friction=-1)
    with pytest.raises(InputError, match='sphere must be true or false'):
        read(**given, sphere=1)
    with pytest.raises(InputError, match="soft_body: entry 'step' is missing"):
        read(pitch=0.005, volume_ratio=1.0)
