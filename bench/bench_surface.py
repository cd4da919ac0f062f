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
Bench: clouds of 640x480 beside a surface: the object taken out, distances, the dent; CPU times.

Beside the exact distance stands what is often taken for it, the distance to the nearest corner.
The noise is 0.5 mm along the depth, the dent known. ``python bench/bench_surface.py``.
"""

from collections.abc import Callable
from dataclasses import replace
from time import process_time

from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.records import CloudFrame, Estimate, Segmentation, Signal
from hapticvision_ros.core.surface.cloud import CloudSettings, observe
from hapticvision_ros.core.surface.compare import compare, seen_triangles
from hapticvision_ros.core.surface.deformation import measure
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np
from scipy.spatial import cKDTree

SIZE = 0.085, 0.060, 0.040
RADIUS, RIM = 0.0126, 0.010
DENT, NOISE = 0.00657, 5e-4
ROUNDS = 5
T = (0.0, 2.0, 3.0, 5.0, 7.0, 10.0)
HEIGHT = (0.09, SIZE[2], SIZE[2] - 0.01, SIZE[2] - 0.01, 0.09, 0.09)
PHASES = Segmentation(2.0, 3.0, 5.0, 5.2, 10.0, SIZE[2], 0.0, 0.01, 0.010)


def dented(depth: float, pitch: float) -> Mesh:
    """Return the block with the dent of the simulated cell."""
    lattice = box(SIZE, pitch)
    nodes, triangles = lattice.surface
    points = lattice.points[nodes].copy()
    share = np.clip((np.hypot(points[:, 0], points[:, 1]) - RADIUS) / RIM, 0.0, 1.0)
    top = points[:, 2] > SIZE[2] - 1e-9
    points[top, 2] -= (depth * (1.0 - share * share * (3.0 - 2.0 * share)))[top]
    return Mesh(points, triangles)


def timed[T](function: Callable[[], T]) -> tuple[float, T]:
    """Return the least CPU time of some runs [ms], and what came out."""
    least = np.inf
    for _ in range(ROUNDS):
        start = process_time()
        result = function()
        least = min(least, process_time() - start)
    return 1e3 * least, result


def clouds(tool: Signal) -> list[CloudFrame]:
    """Return the frames of a trial, 2.5 a second."""
    config = load_config()
    length, width, height = SIZE
    block = replace(config.block, length=length, width=width, height=height, rim_width=RIM)
    renderer = RangeRenderer(
        Scene(block, RADIUS, config.range_sensor),
        width=640,
        height=480,
        depth_noise=NOISE,
        seed=5,
    )
    frames = []
    for t in np.arange(0.0, 10.0, 0.4).tolist():
        tip = float(tool.at(np.array([t]))[0])
        depth = max(0.0 if t < 3.0 else DENT, SIZE[2] - tip)
        frames.append(CloudFrame(t, renderer.render(tip, depth), 'support_plane'))
    return frames


def main() -> None:
    """Print times, the measured dent and the distances."""
    tool = Signal(np.array(T), np.array(HEIGHT))
    frames = clouds(tool)
    settings = CloudSettings(RADIUS)
    took, seen = timed(lambda: observe(frames, tool, PHASES, settings))
    looks = 1 + len(seen.after)
    print(f'object taken out of {len(frames)} clouds of 640x480, {looks} looks: {took:.0f} ms')
    print(f'tool axis off by {1e3 * np.hypot(*seen.shift[:2]):.3f} mm')
    last = seen.after[-1]
    for pitch in (5e-3, 2.5e-3, 1e-3):
        rest, after = dented(0.0, pitch), dented(DENT, pitch)
        took, found = timed(lambda after=after: nearest(last.points, after))
        print(
            f'\n{len(last.points)} returns, {len(after.triangles)} triangles: exact {took:.0f} ms'
        )
        took, corner = timed(lambda after=after: cKDTree(after.points).query(last.points)[0])
        rms = 1e3 * np.sqrt(np.mean(corner**2))
        print(f'nearest corner {took:.0f} ms, rms {rms:.3f} mm')
        visible = seen_triangles(seen.before, rest)
        took, one = timed(lambda after=after, visible=visible: compare(last, after, visible))
        print(
            f'comparison {took:.0f} ms: rms {1e3 * one.rms:.3f} mm, noise {1e3 * one.noise:.3f} '
            f'mm ({one.noise_share:.0%} of its square), beyond it {1e3 * one.beyond_noise:.3f} mm;'
            f' 95 % {1e3 * one.percentile_95:.3f} mm; largest {1e3 * one.largest:.2f} mm, of '
            f'noise about {1e3 * one.noise_largest:.2f} mm'
        )
        wrong = compare(last, dented(DENT + 5e-4, pitch))
        print(f'a dent 0.5 mm too deep: beyond noise {1e3 * wrong.beyond_noise:.3f} mm')
        del found
    took, numbers = timed(
        lambda: measure(
            seen,
            dented(0.0, 2.5e-3),
            (dented(DENT, 2.5e-3),) * len(seen.after),
            depth=Estimate(0.010, 1e-5),
            simulated_depth=0.010,
        )
    )
    print(f'\nnumbers of the shape: {took:.0f} ms')
    for height in numbers.heights:
        value, std = height.measured.value, height.measured.std
        print(
            f'dent at {height.t:.1f} s: {1e3 * (value or np.nan):.3f} +- '
            f'{1e3 * (std or np.nan):.3f} mm (true {1e3 * DENT:.3f})'
        )


if __name__ == '__main__':
    main()
