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

"""What stands in for a trial before it is simulated: where the tip was, and where the block is."""

from dataclasses import replace
from typing import Any

from hapticvision_ros.core.body.lattice import Lattice
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.surface import study
from hapticvision_ros.core.surface.cloud import CloudSettings, Observation, observe
import numpy as np
import pytest

from .conftest import PHASES, Record, SIZE, TOOL, TOOL_RADIUS


@pytest.mark.parametrize(
    ('effect', 'values'),
    [('machine_compliance', {'K_m': 4000.0}), ('contact_offset', {'delta_0': 4e-4})],
)
def test_what_the_cell_adds_to_the_depth_is_not_pressed_into_the_body(
    effect: str, values: dict[str, float]
) -> None:
    # The tip goes 10 mm deep into 200 N/m.
    t = np.linspace(0.0, 10.0, 1001)
    tip = TOOL.at(t)
    force = 200.0 * np.maximum(SIZE[2] - tip, 0.0)
    phases = PHASES
    told = tip
    if effect == 'machine_compliance':
        told = tip - force / values['K_m']
    else:
        phases = replace(PHASES, contact_height=SIZE[2] - values['delta_0'])
    phases = replace(phases, force_zero=0.3)
    trial = Trial('push', 0, Signal(t, force + 0.3), Signal(t, told), None, 'none')
    parameters = {'K1': 1.0, 'C1': 1.0, 'C2': 1.0} | values
    trial, phases = study._at_the_tip(trial, phases, Model((effect,)), parameters)
    motion = study._motion(trial, phases, SIZE[2])
    np.testing.assert_allclose(motion.height, TOOL.at(motion.t), atol=1e-9)
    assert study._depth(trial, phases).value == pytest.approx(0.010, abs=1e-9)


def test_a_depth_that_was_not_recorded_is_unknown() -> None:
    often = np.array([t for t in np.arange(0.0, 10.0, 0.1) if not 3.5 < t < 5.5])
    tool = Signal(often, TOOL.at(often))
    trial = Trial('push', 0, tool, tool, None, 'none')
    depth = study._depth(trial, PHASES)
    assert (depth.value, depth.std) == (None, None)
    assert 'no height of the tool' in (depth.reason or '')


def _placed(observed: Observation) -> Lattice:
    settings = study.ShapeSettings(CloudSettings(TOOL_RADIUS), pitch=0.005, size=SIZE)
    return study._lattice(observed, settings)


def test_a_block_that_is_pressed_beside_its_middle_is_placed_where_it_is_seen(
    record: Record,
) -> None:
    beside: Any = (0.018, -0.011)
    seen = observe(record(), TOOL, PHASES, CloudSettings(TOOL_RADIUS), contact=beside)
    # A side that is not seen ends at some return: the spacing is a millimetre.
    assert np.allclose(_placed(seen).low[:2], -0.5 * np.array(SIZE[:2]) - beside, atol=3e-4)
    points = seen.before.points
    top = points[:, 2] > SIZE[2] - 0.004
    above = replace(seen.before, points=points[top], covariance=seen.before.covariance[top])
    low = _placed(replace(seen, before=above)).low[:2]
    assert np.allclose(low, -0.5 * np.array(SIZE[:2]) - beside, atol=3e-4)


@pytest.mark.parametrize(
    ('size', 'warned'),
    [
        (SIZE, False),
        ((1.05 * SIZE[0], SIZE[1], SIZE[2]), False),
        ((1.2 * SIZE[0], SIZE[1], SIZE[2]), True),
        ((SIZE[0], SIZE[1], 0.85 * SIZE[2]), True),
    ],
)
def test_a_block_that_is_seen_to_be_of_another_size_is_worth_a_warning(
    observed: Observation, size: tuple[float, float, float], warned: bool
) -> None:
    told = study._other_size(observed, size)
    assert len(told) == warned
    assert all('check --size' in one for one in told)
