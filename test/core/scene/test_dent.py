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

from hapticvision_ros.core.displacement import displacement_from_clouds
from hapticvision_ros.core.records import CloudFrame, FloatArray, Signal
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


def tilted(points: FloatArray, slope: float) -> FloatArray:
    """Return points that stand askew."""
    return points + np.column_stack((np.zeros((len(points), 2)), slope * points[:, 0]))


@pytest.mark.parametrize('slope', [0.005, 0.03])
def test_what_tilts_between_the_clouds_is_no_dent(slope: float) -> None:
    before = [(cloud(0.0, seed), 0.0315) for seed in range(3)]
    askew = [(tilted(cloud(0.0, seed), slope), 0.0315) for seed in range(10, 13)]
    assert find_dent_axis(before, askew, START, 0.02) is None
    dent = [(tilted(cloud(0.002, seed), slope), 0.0315) for seed in range(10, 13)]
    assert find_dent_axis(before, dent, START, 0.02) == pytest.approx(AXIS, abs=5e-4)


@pytest.mark.parametrize('slope', [0.005, 0.02])
def test_what_tilts_does_not_move_a_shallow_dent(slope: float) -> None:
    """The tilt draws the axis aside by 3 and 11 mm, and noise hides that it is a plane."""
    random = np.random.default_rng(0)

    def noisy(points: FloatArray) -> FloatArray:
        noise = 1e-4 * random.standard_normal(len(points))
        return points + np.column_stack((np.zeros((len(points), 2)), noise))

    before = [(noisy(cloud(0.0, seed)), 0.0315) for seed in range(6)]
    after = [(noisy(tilted(cloud(5e-4, seed), slope)), 0.0315) for seed in range(10, 16)]
    assert find_dent_axis(before, after, AXIS, 0.02) is None


def test_what_the_object_lies_on_is_no_floor_of_a_dent() -> None:
    """Beside an edge a point may be of either, from one cloud to the next."""
    before = [(cloud(0.0, seed), 0.0315) for seed in range(3)]
    after = []
    for seed in range(10, 13):
        points = cloud(0.001, seed)
        flips = np.abs(points[:, 0] + 0.008) < 0.002
        points[flips & (np.random.default_rng(seed).random(len(points)) < 0.5), 2] = 0.0
        after.append((points, 0.027))
    assert find_dent_axis(before, after, START, 0.02) == pytest.approx(AXIS, abs=3e-4)


def test_a_cloud_with_nothing_where_the_tool_was_sent_tells_nothing() -> None:
    away = cloud(0.0, 0)
    away = away[np.hypot(*(away[:, :2] - START).T) > 0.012]
    assert find_dent_axis([(away, 0.0315)], [(cloud(0.002, 1), 0.0315)], START, 0.02) is None


def test_a_touch_tells_the_original_height_of_a_close_up_whose_middle_is_hidden() -> None:
    """The tool hides where it pushes until it is up again, and pushes beside the middle."""
    t = np.arange(0.0, 8.0, 0.1)
    top = 0.03 - 2.0 * (AXIS[0] ** 2 + AXIS[1] ** 2)
    height = top + np.interp(t, [0.0, 2.0, 3.0, 4.0, 6.0], [0.03, 0.0, -0.006, -0.006, 0.03])
    truth = np.interp(t, [2.0, 3.0, 4.0, 5.0], [0.0, 0.006, 0.006, 0.004])
    frames = []
    for seed, (now, dent) in enumerate(zip(t, truth, strict=True)):
        points = cloud(dent, seed)
        points = points[np.hypot(*points[:, :2].T) < 0.03]
        if now < 4.5:
            points = points[np.hypot(*(points[:, :2] - AXIS).T) > 0.0065]
        frames.append(CloudFrame(float(now), points.astype(np.float32), 'support_plane'))
    tool = Signal(t, height)
    signal, warnings = displacement_from_clouds(frames, tool, touched=lambda: top)
    assert signal is not None
    assert signal.t[0] > 4.4
    assert np.abs(signal.value - np.interp(signal.t, t, truth)).max() < 3e-4
    assert 'where the force tells' in warnings[-1]
    assert 'of the dent that the tool left: x = 12' in warnings[-2]
    # A touch that is far from what is seen beside it is none of this surface.
    for nowhere in (None, 0.02):
        signal, warnings = displacement_from_clouds(frames, tool, touched=lambda at=nowhere: at)
        assert signal is None
        assert 'was not seen before the push' in warnings[-1]
