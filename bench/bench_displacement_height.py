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
Displacement height, live: CPU time of a 640x480 frame, against the whole pipeline in each frame.

Both follow one simulated trial (push, hold, release) with 0.5 mm of depth noise. The whole one
finds the support plane and the object anew in each cloud, and takes the height at the contact
point from there; the tracker keeps which pixels see the plane and which the dent. Errors are
against the simulated dent, over the frames after the release.

    OMP_NUM_THREADS=1 python bench/bench_displacement_height.py [--frames 150]
"""

import argparse
import os
import sys
import time

from hapticvision_ros.core.displacement import DisplacementTracker
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import plan_contact
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.scene import RangeRenderer, Scene
import numpy as np

BUDGET_MS = 5.0
UP = 0.080


def trial(frames: int, top: float) -> list[tuple[float, float]]:
    """Return (tool height, dent) of frames before a push of 8 mm, in its hold, and after it."""
    before, hold = max(frames // 10, 5), frames // 5
    steps = [(UP, 0.0)] * before + [(top - 0.008, 0.008)] * hold
    for k in range(frames - len(steps)):
        dent = 0.005 + 0.003 * np.exp(-k / 60.0)
        steps.append((min(top - 0.008 + 0.01 * k, UP), float(dent)))
    return steps


def whole_pipeline(xyz: PointArray, tool: float) -> float | None:
    """Return the surface's height at the contact point, everything found anew."""
    try:
        return plan_contact(xyz, ceiling=tool).object_height
    except InputError:
        return None


def summary(name: str, times: list[float], errors: FloatArray, base: float) -> str:
    """Return one line of the table."""
    milliseconds = np.array(times) * 1e3
    p50, p99 = np.percentile(milliseconds, (50, 99))
    return (
        f'| {name} | {p50:.2f} | {p99:.2f} | {milliseconds.max():.2f} | '
        f'{p50 / base:.1f} | {len(errors)} | {np.mean(errors) * 1e3:+.3f} | '
        f'{np.std(errors) * 1e3:.3f} |'
    )


def main() -> int:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--frames', type=int, default=150)
    frames = parser.parse_args().frames
    config = load_config()
    scene = Scene(config.block, config.arm.tool_radius, config.range_sensor)
    renderer = RangeRenderer(scene, width=640, height=480, depth_noise=5e-4, seed=1)
    tracker = DisplacementTracker((0.0, 0.0))
    top = config.block.height
    live: list[float] = []
    whole: list[float] = []
    live_errors, whole_errors = [], []
    released = frames // 10 + frames // 5 + 10
    original: list[float] = []
    for number, (tool, dent) in enumerate(trial(frames, top)):
        xyz = renderer.render(tool, dent)
        start = time.process_time()
        height = tracker.update(xyz, tool)
        live.append(time.process_time() - start)
        if height is not None and number > released:
            live_errors.append(height - dent)
        start = time.process_time()
        level = whole_pipeline(xyz, tool)
        whole.append(time.process_time() - start)
        if level is None:
            continue
        if dent == 0.0:
            original.append(level)
        elif number > released:
            whole_errors.append(float(np.median(original)) - level - dent)
    print(
        f'load average of this machine before: {os.getloadavg()[0]:.2f} of {os.cpu_count()} cores'
    )
    print(f'first frame, which finds the pixels: {live[0] * 1e3:.1f} ms')
    print('| | p50 ms | p99 ms | max ms | times the tracker | frames | mean error mm | sd mm |')
    print('| --- | --- | --- | --- | --- | --- | --- | --- |')
    base = float(np.median(live[1:]) * 1e3)
    print(summary('tracker', live[1:], np.array(live_errors), base))
    print(summary('whole pipeline', whole, np.array(whole_errors), base))
    late = sum(1e3 * item > BUDGET_MS for item in live[1:])
    print(f'{late} of {frames - 1} frames of the tracker took more than {BUDGET_MS:g} ms')
    return 0


if __name__ == '__main__':
    sys.exit(main())
