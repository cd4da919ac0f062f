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

"""The explicit body of the simulated cell, and the implicit one that is fitted, side by side."""

from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion, Touch
from hapticvision_ros.core.body.simulation import simulate
from hapticvision_ros.sim.soft_body import SoftBody, SoftMaterial
import numpy as np
import pytest

SIZE = (0.04, 0.04, 0.04)
RADIUS = 0.0126


@pytest.mark.parametrize('friction', [0.0, 0.1, 0.3])
def test_two_codes_that_share_nothing_slide_alike(friction: float) -> None:
    size, height = (0.05, 0.05, 0.02), 0.02
    motion = ToolMotion.trial(height, depth=0.003, push_speed=2e-3, hold=4.0, recovery=12.0)
    around = Surroundings(Touch(0.0), Touch(friction, lets_go=False), volume_ratio=0.0)
    law = LinkLaw(300.0, 5000.0, 6000.0)
    run = simulate(box(size, 0.005), law, Tool(RADIUS, 0.0, 0.0), motion, around, at=(17.0,))
    body = SoftBody(
        size, 0.005, SoftMaterial(300.0, 5000.0, 6000.0), RADIUS, 1e-3, friction=friction
    )
    for start, end, before, after in zip(
        run.t[:-1], run.t[1:], run.tool[:-1], run.tool[1:], strict=True
    ):
        body.advance(end - start, before, after)
    feet = (run.lattice.points[:, 2] == 0.0, body.rest[:, 2] == 0.0)
    spread = [np.ptp(run.frames[-1][feet[0], 0]), np.ptp(body.points[feet[1], 0])]
    assert spread[1] - 0.05 > 2e-4
    assert spread[1] == pytest.approx(spread[0], abs=0.05 * (spread[0] - 0.05))
    assert body.sunk == pytest.approx(run.height[-1], abs=3e-5)


@pytest.mark.parametrize('threshold', [0.2, 2.0])
def test_two_codes_that_share_nothing_give_one_body(threshold: float) -> None:
    material = SoftMaterial(300.0, 5000.0, 6000.0, threshold=threshold)
    law = LinkLaw(300.0, 5000.0, 6000.0, yield_force=threshold)
    motion = ToolMotion.trial(0.04, depth=0.004, push_speed=2e-3, hold=4.0, recovery=12.0)
    around = Surroundings(volume_ratio=0.0)
    run = simulate(box(SIZE, 0.01), law, Tool(RADIUS, 0.0, 0.0), motion, around)
    body = SoftBody(SIZE, 0.01, material, RADIUS, 5e-4)
    force, sunk = [], []
    for start, end, before, after in zip(
        run.t[:-1], run.t[1:], run.tool[:-1], run.tool[1:], strict=True
    ):
        force.append(body.advance(end - start, before, after))
        sunk.append(body.sunk)
    # Mass shows for half a second after each corner of the tool's path; then both are at rest.
    since = run.t[1:] - np.array([0.0, 2.0, 6.0])[np.searchsorted([2.01, 6.01], run.t[1:])]
    late = since > 0.7
    assert np.count_nonzero(late) > 6
    np.testing.assert_allclose(np.array(force)[late], run.force[late], atol=5e-3 * run.force.max())
    np.testing.assert_allclose(np.array(sunk)[late], run.height[1:][late], atol=1.2e-5)


def test_springs_of_the_volume_keep_it() -> None:
    changes = []
    for bulk in (0.0, 14.0 * 1.875 * 300.0 / 0.01):
        body = SoftBody(SIZE, 0.01, SoftMaterial(300.0, 0.1, 1e9, bulk=bulk), RADIUS, 2e-4)
        body.advance(0.5, 0.04, 0.038)
        body.advance(0.5, 0.038, 0.038)
        lattice = box(SIZE, 0.01)
        order = np.lexsort((body.rest[:, 0], body.rest[:, 1], body.rest[:, 2]))
        changes.append(1.0 - lattice.volume(body.points[order]) / 0.04**3)
    assert changes[0] > 5e-3
    assert changes[1] < 0.3 * changes[0]


def test_a_tool_smaller_than_a_cell_is_refused() -> None:
    with pytest.raises(ValueError, match='smaller than a cell'):
        SoftBody((0.02, 0.02, 0.02), 0.01, SoftMaterial(1.0, 1.0, 1.0), -1.0, 1e-3)
