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
Compile the kernels and keep them, so that the first fit does not wait for it.

numba keeps a kernel for the types of its arguments; two shipped bags, one with a release, and the
effects with kernels of their own call all of them as ``hapticvision fit`` does, and a small body
calls those of the shape and of its pictures. Run it from the root of the repository, with the
interpreter of .venv; ``tools/setup.sh`` does.
"""

from dataclasses import replace
from pathlib import Path
import sys
import warnings

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Tool, ToolMotion
from hapticvision_ros.core.body.simulation import simulate
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.haptic import HapticStepper
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.surface.raster import draw_mesh, draw_points, ParallelView
from hapticvision_ros.report.shape_gif import gif
import numpy as np

BAGS = ('bags/muscle_ramp_hold/ramp_10s', 'bags/synthetic_soft_block/speed_5mm_s_depth_8mm')
EFFECTS = ('force_lag', 'periodic_disturbance')


def main() -> int:
    """Fit the bags with every kernel."""
    warnings.simplefilter('ignore')
    for bag in BAGS:
        fit([analyse(read_trial(Path(bag)))], Model(EFFECTS))
    body = box((0.04, 0.04, 0.04), 0.01)
    motion = ToolMotion(np.array([0.0, 0.1]), np.array([0.04, 0.0399]))
    # One whose surface was measured has cells of several shapes.
    for lattice in (body, replace(body, lift=np.zeros((5, 5)))):
        simulate(lattice, LinkLaw(1.0, 1.0, 1.0), Tool(0.01, 0.0, 0.0), motion)
    nodes, triangles = body.surface
    surface = Mesh(body.points[nodes], triangles)
    nearest(surface.points, surface)
    view = ParallelView.around(surface.points, azimuth=0.0, elevation=0.5, width=8, height=8)
    draw_mesh(surface, view)
    draw_points(surface.points, view, 1)
    gif([np.zeros((8, 8), np.uint8)], np.zeros((256, 3), np.uint8))
    HapticStepper(Model(), {'K1': 1.0, 'C1': 1.0, 'C2': 1.0})
    return 0


if __name__ == '__main__':
    sys.exit(main())
