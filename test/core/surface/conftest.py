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

"""A block with a dent as the simulated cell's range sensor sees it, and as triangles."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.records import CloudFrame, Segmentation, Signal
from hapticvision_ros.core.surface.cloud import CloudSettings, Observation, observe
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np
import pytest

SIZE = 0.080, 0.060, 0.040
TOOL_RADIUS = 0.0125
RIM = 0.010
NOISE = 5e-4
PHASES = Segmentation(
    t_contact=2.0,
    t_hold=3.0,
    t_release=5.0,
    t_loss=5.2,
    t_end=10.0,
    contact_height=SIZE[2],
    force_zero=0.0,
    push_speed=0.01,
    depth=0.010,
)
TOOL = Signal(
    np.array([0.0, 2.0, 3.0, 5.0, 7.0, 10.0]),
    np.array([0.09, SIZE[2], SIZE[2] - 0.01, SIZE[2] - 0.01, 0.09, 0.09]),
)


def dented(depth: float, pitch: float = 2.5e-3) -> Mesh:
    """Return the block whose top has the dent of the simulated cell."""
    lattice = box(SIZE, pitch)
    nodes, triangles = lattice.surface
    points = lattice.points[nodes].copy()
    share = np.clip((np.hypot(points[:, 0], points[:, 1]) - TOOL_RADIUS) / RIM, 0.0, 1.0)
    dent = depth * (1.0 - share * share * (3.0 - 2.0 * share))
    top = points[:, 2] > SIZE[2] - 1e-9
    points[top, 2] -= dent[top]
    return Mesh(points, triangles)


def true_depth(t: float) -> float:
    """Return the dent that is left free at a time [m]."""
    return 0.0 if t < 3.0 else 0.0066 + 0.0009 * np.exp(-(t - 5.2) / 2.0)


type Record = Callable[..., list[CloudFrame]]


@pytest.fixture(scope='session')
def record() -> Record:
    """Return what records the clouds of the trial above, usually at 4 Hz."""

    @cache
    def make(
        *,
        yaw: float = 0.0,
        flat: bool = False,
        columns: int = 160,
        step: float = 0.25,
        sphere: bool = False,
        raised: float = 0.0,
    ) -> list[CloudFrame]:
        config = load_config()
        length, width, height = SIZE
        block = replace(
            config.block, length=length, width=width, height=height, yaw=yaw, rim_width=RIM
        )
        scene = Scene(block, TOOL_RADIUS, config.range_sensor, sphere)
        renderer = RangeRenderer(
            scene, width=columns, height=3 * columns // 4, depth_noise=NOISE, seed=0
        )
        frames = []
        for t in np.arange(0.0, 10.0, step).tolist():
            tool = float(TOOL.at(np.array([t]))[0]) + raised
            depth = max(true_depth(t), SIZE[2] - tool)
            cloud = renderer.render(tool, depth)
            frames.append(CloudFrame(t, cloud.reshape(-1, 3) if flat else cloud, 'support_plane'))
        return frames

    return make


@pytest.fixture(scope='session')
def observed(record: Record) -> Observation:
    """Return the object taken out of those clouds."""
    return observe(record(), TOOL, PHASES, CloudSettings(TOOL_RADIUS), contact=(0.0, 0.0))
