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
Touch and see: errors on solids whose truth is known, and the time of a plan.

Solids are ray-cast into clouds of 320x240 with 0.5 mm of depth noise and 2 % dropouts; the
sensors' poses are known with the given errors. Each figure is a root mean square over the seeds;
what all views have in common, the mean of their poses' errors, is taken out.

    OMP_NUM_THREADS=1 python bench/bench_touch_and_see.py [--seeds 5] [--only above]
"""

import argparse
import os
import sys
import time

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.planning import touch_and_see, TouchPlan, TouchSettings
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.scene.stability import PushSettings
from hapticvision_ros.core.scene.views import Pose, View
from hapticvision_ros.sim.shapes import (
    block,
    Camera,
    hemisphere,
    lump,
    Solid,
    take,
    Truth,
    truth_of,
    wedge,
)
import numpy as np

SOLIDS = {
    'block 90 x 60 x 45 mm': block(0.09, 0.06, 0.045).at(0.01, -0.005, 0.4),
    'wedge 90 x 60 x 30-45 mm': wedge(0.09, 0.06, 0.03, 0.045).at(-0.005, 0.01, 1.0),
    'hemisphere 80 mm': hemisphere(0.04).at(0.004, 0.01),
    'lump 1': lump(1).at(0.01, 0.0, 1.0),
    'lump 2': lump(2),
    'lump 3': lump(3),
}
AROUND = tuple(Camera(np.deg2rad(angle), np.deg2rad(40.0)) for angle in (45, 135, 225, 315))
ABOVE = Camera(0.3, np.deg2rad(88.0))
VIEWPOINTS = {
    'above and four sides, poses known to 3 mm and 0.6 deg': ((*AROUND, ABOVE), 0.003, 0.01),
    'above': ((ABOVE,), 0.0, 0.0),
    'one side': (AROUND[:1], 0.0, 0.0),
}
PLACES = np.array([[0.03, 0, 0.02], [-0.03, 0, 0.02], [0, 0.03, 0.04], [0, -0.03, 0.0]])


def error_of(random: np.random.Generator, camera: Camera, shift: float, angle: float) -> Pose:
    """Return by how much a pose is known wrongly: turned about the target, and shifted."""
    half = 0.5 * random.normal(0.0, angle / np.sqrt(3.0), 3)
    quaternion = np.array([*half, np.sqrt(1.0 - half @ half)])
    turn = Pose.from_quaternion((0.0, 0.0, 0.0), tuple(float(item) for item in quaternion))
    target = np.array(camera.target)
    moved = random.normal(0.0, shift / np.sqrt(3.0), 3)
    return Pose(turn.rotation, moved + target - turn.rotation @ target)


def disagreement(poses: list[Pose], truths: list[Pose]) -> tuple[float, FloatArray]:
    """Return how far apart the views put the same places, and where they put them on average."""
    errors = np.array(
        [
            pose.apply(true.inverse().apply(PLACES)) - PLACES
            for pose, true in zip(poses, truths, strict=True)
        ]
    )
    common = errors.mean(axis=0)
    return float(np.sqrt(np.mean(np.sum((errors - common) ** 2, axis=-1)))), common.mean(axis=0)


def figures(plan: TouchPlan, true: Truth, common: FloatArray) -> list[float]:
    """Return the errors of one plan."""
    contact = np.array(plan.contact.contact_point) - common
    gravity = np.array(plan.centre_of_gravity) - common
    return [
        float(np.hypot(*(contact[:2] - true.top_view_centre))) * 1e3,
        float(contact[2] - true.contact_height) * 1e3,
        (plan.contact.object_area / true.top_view_area - 1.0) * 100.0,
        (plan.volume / true.volume - 1.0) * 100.0,
        float(np.linalg.norm(gravity - true.centre_of_gravity)) * 1e3,
        plan.outline_seen,
    ]


def row(name: str, solid: Solid, true: Truth, setting: str, seeds: int) -> str:
    """Return one line of the table."""
    cameras, shift, angle = VIEWPOINTS[setting]
    # A slope is no reason to refuse here.
    settings = TouchSettings(push=PushSettings(tool_friction=3.0, support_friction=3.0))
    truths = [Pose(camera.rotation, camera.translation) for camera in cameras]
    rows, spreads, times = [], [], []
    for seed in range(seeds):
        random = np.random.default_rng(seed)
        known = [
            error_of(random, camera, shift, angle).after(pose)
            for camera, pose in zip(cameras, truths, strict=True)
        ]
        views = [
            View(take(camera, [solid], seed=100 * seed + number).xyz, pose, f'{number}')
            for number, (camera, pose) in enumerate(zip(cameras, known, strict=True))
        ]
        start = time.process_time()
        try:
            plan = touch_and_see(views, settings=settings)
        except InputError as error:
            return f'| {name} | {error} | | | | | | | |'
        times.append(time.process_time() - start)
        after, common = disagreement(list(plan.merge.poses), truths)
        spreads.append((disagreement(known, truths)[0], after))
        rows.append(figures(plan, true, common))
    rms = np.sqrt(np.mean(np.square(rows), axis=0))
    before, after = np.sqrt(np.mean(np.square(spreads), axis=0)) * 1e3
    views_apart = f'{before:.2f} -> {after:.2f}' if len(cameras) > 1 else '-'
    return (
        f'| {name} | {views_apart} | {rms[0]:.2f} | {rms[1]:.2f} | {rms[2]:.1f} | {rms[3]:.1f} | '
        f'{rms[4]:.2f} | {rms[5]:.2f} | {np.median(times):.2f} |'
    )


def main() -> int:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--only', choices=VIEWPOINTS, help='only these viewpoints')
    arguments = parser.parse_args()
    print(
        f'load average of this machine before: {os.getloadavg()[0]:.2f} of {os.cpu_count()} cores'
    )
    truths = {name: truth_of(solid) for name, solid in SOLIDS.items()}
    for setting in VIEWPOINTS if arguments.only is None else (arguments.only,):
        print(f'\n{setting}\n')
        print(
            '| solid | views apart mm | G_top mm | P_c height mm | area % | volume % | '
            'centre of gravity mm | outline seen | CPU s |'
        )
        print('| --- | --- | --- | --- | --- | --- | --- | --- | --- |')
        for name, solid in SOLIDS.items():
            print(row(name, solid, truths[name], setting, arguments.seeds), flush=True)
    return 0


if __name__ == '__main__':
    sys.exit(main())
