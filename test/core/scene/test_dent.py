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

"""Where a tool has pushed, from clouds of a dome with a dent that the tests make."""

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.dent import find_dent_axis
import numpy as np
import pytest

AXIS = (0.012, -0.007)
START = (0.008, -0.010)
TOOL = 0.004
NOISE = 3e-5


def cloud(
    depth: float, seed: int, *, tool: float | None = None, hidden: bool = False
) -> FloatArray:
    """Return points of a dome, 2 mm apart, with a dent that has a skirt, and those of a tool."""
    random = np.random.default_rng(seed)
    x, y = (
        each.ravel() + 3e-4 * random.standard_normal(each.size)
        for each in np.meshgrid(*(np.arange(-0.06, 0.06, 0.002),) * 2)
    )
    away = np.hypot(x - AXIS[0], y - AXIS[1])
    z = 0.03 - 2.0 * (x**2 + y**2) + NOISE * random.standard_normal(x.size)
    z -= depth * np.exp(-np.maximum(away - TOOL, 0.0) / 0.009)
    on_tool = away < TOOL
    if tool is not None:
        z[on_tool] = tool + 0.02 * random.random(np.count_nonzero(on_tool))
    shadow = hidden & on_tool | hidden & (y < AXIS[1]) & (away < 0.012)
    return np.column_stack((x, y, z))[~shadow]


@pytest.mark.parametrize('hidden', [False, True])
@pytest.mark.parametrize('tool', [None, 0.0315])
def test_a_dent_tells_its_axis_though_half_of_it_is_hidden(
    hidden: bool, tool: float | None
) -> None:
    before = [(cloud(0.0, seed, tool=tool, hidden=hidden), 0.0315) for seed in range(3)]
    after = [
        (cloud(depth, seed, tool=tool, hidden=hidden), 0.0315)
        for seed, depth in enumerate((0.002, 0.0015, 0.001), start=10)
    ]
    found = find_dent_axis(before, after, START, 0.02)
    assert found == pytest.approx(AXIS, abs=2e-4)
    # A dent that is where it was thought to be leaves all as it was.
    assert find_dent_axis(before, after, found, 0.02) is None


def test_a_tool_that_stands_in_the_dent_tells_nothing() -> None:
    before = [(cloud(0.0, seed), 0.0315) for seed in range(3)]
    down = [(cloud(0.002, seed, tool=0.0275), 0.0275) for seed in range(10, 13)]
    assert find_dent_axis(before, down, START, 0.02) is None


@pytest.mark.parametrize('depth', [0.0, 2e-5])
def test_where_no_dent_is_left_there_is_no_axis(depth: float) -> None:
    before = [(cloud(0.0, seed), 0.0315) for seed in range(3)]
    after = [(cloud(depth, seed), 0.0315) for seed in range(10, 13)]
    assert find_dent_axis(before, after, START, 0.02) is None
    assert find_dent_axis([], after, START, 0.02) is None
    assert find_dent_axis(before, [], START, 0.02) is None
