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
Merging views: the package's joint ICP against a chain of Open3D's point-to-plane ICP.

Open3D is no dependency: install it where this runs. Both get the same clouds with poses known to
3 mm and 0.6 deg; the chain begins with the view from above and adds one side after the other.

    OMP_NUM_THREADS=1 python bench/bench_merge_open3d.py [--seeds 2]
"""

import argparse
from collections.abc import Sequence
import sys
import time

from bench_touch_and_see import ABOVE, AROUND, disagreement, error_of, SOLIDS
from hapticvision_ros.core.scene.registration import merge_views
from hapticvision_ros.core.scene.views import Pose, View
from hapticvision_ros.sim.shapes import take
import numpy as np

CAMERAS = (*AROUND, ABOVE)
VOXEL = 0.002
REACHES = (0.012, 0.003)


def chain(views: Sequence[View]) -> list[Pose]:
    """Return the poses after Open3D's ICP of each view to those before it."""
    import open3d

    registration = open3d.pipelines.registration
    base = open3d.geometry.PointCloud()
    poses: dict[int, Pose] = {}
    for number in (len(views) - 1, *range(len(views) - 1)):
        view = views[number]
        points = view.xyz[np.isfinite(view.xyz).all(axis=-1)].astype(np.float64)
        cloud = open3d.geometry.PointCloud(open3d.utility.Vector3dVector(points))
        cloud = cloud.voxel_down_sample(VOXEL)
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = view.pose.rotation, view.pose.translation
        for reach in REACHES if poses else ():
            matrix = registration.registration_icp(
                cloud,
                base,
                reach,
                matrix,
                registration.TransformationEstimationPointToPlane(),
                registration.ICPConvergenceCriteria(max_iteration=30),
            ).transformation
        poses[number] = Pose(matrix[:3, :3].copy(), matrix[:3, 3].copy())
        base += cloud.transform(matrix)
        base = base.voxel_down_sample(VOXEL)
        base.estimate_normals(
            open3d.geometry.KDTreeSearchParamHybrid(radius=3.0 * VOXEL, max_nn=24)
        )
    return [poses[number] for number in range(len(views))]


def main() -> int:
    """Run the bench."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[1])
    parser.add_argument('--seeds', type=int, default=2)
    seeds = parser.parse_args().seeds
    truths = [Pose(camera.rotation, camera.translation) for camera in CAMERAS]
    print('| solid | seed | before mm | package mm | CPU s | Open3D mm | CPU s |')
    print('| --- | --- | --- | --- | --- | --- | --- |')
    for name, solid in SOLIDS.items():
        for seed in range(seeds):
            random = np.random.default_rng(seed)
            views = []
            for number, (camera, pose) in enumerate(zip(CAMERAS, truths, strict=True)):
                known = error_of(random, camera, 0.003, 0.01).after(pose)
                xyz = take(camera, [solid], seed=100 * seed + number).xyz
                views.append(View(xyz, known, f'{number}'))
            before = disagreement([view.pose for view in views], truths)[0]
            start = time.process_time()
            joint = disagreement(list(merge_views(views).poses), truths)[0]
            middle = time.process_time()
            chained = disagreement(chain(views), truths)[0]
            end = time.process_time()
            print(
                f'| {name} | {seed} | {before * 1e3:.2f} | {joint * 1e3:.2f} | '
                f'{middle - start:.2f} | {chained * 1e3:.2f} | {end - middle:.2f} |',
                flush=True,
            )
    return 0


if __name__ == '__main__':
    sys.exit(main())
