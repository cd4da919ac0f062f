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
effects with kernels of their own call all of them as ``hapticvision fit`` does, a small body
calls those of the shape and of its pictures, and a short push those of the simulated world. Two
processes share the work. Run it from the root of the repository, with the interpreter of .venv;
``tools/setup.sh`` does.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from math import inf
from multiprocessing import get_context
from pathlib import Path
import sys
import warnings

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Tool, ToolMotion
from hapticvision_ros.core.body.simulation import simulate
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.bootstrap import sensor_noise
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.interpolated import readings
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.fit.way import smooth
from hapticvision_ros.core.haptic import HapticStepper
from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.surface.raster import draw_mesh, draw_points, ParallelView
from hapticvision_ros.report.shape_gif import gif
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, Push, run, Sensors
from hapticvision_ros.sim.soft_body import SoftBody, SoftMaterial
from hapticvision_ros.sim.specimen import Body, Undeclared
import numpy as np

BAGS = ('bags/muscle_ramp_hold/ramp_10s', 'bags/synthetic_soft_block/speed_5mm_s_depth_8mm')
EFFECTS = ('force_lag', 'periodic_disturbance')


def fits() -> None:
    """Call the kernels of the fit."""
    warnings.simplefilter('ignore')
    for bag in BAGS:
        fit([analyse(read_trial(Path(bag)))], Model(EFFECTS))
    HapticStepper(Model(), {'K1': 1.0, 'C1': 1.0, 'C2': 1.0})
    # No arm of these bags goes along a curve, none ripples, and no driver draws lines.
    t = np.arange(0.0, 4.0, 0.005)
    smooth(t, 1e-2 * t + 2e-5 * np.sin(50.0 * t), 1e-6)
    read = np.arange(0.0, 4.0, 0.008)
    readings(t, np.interp(t, read, np.random.default_rng(0).standard_normal(read.size)))


def worlds() -> None:
    """Call the kernels of shapes and of the simulated world."""
    warnings.simplefilter('ignore')
    sensors = Sensors(ForceNoise(0.0, 0.1, 0.01), 1e-5)
    campaign = Campaign(Body(2000.0, 1600.0, 2400.0), (Push(0.01, 0.002, 0.1, 0.1),), sensors)
    run(campaign, [Undeclared('force_lag', (0.01,))], seed=0)
    sensor_noise(np.arange(9.0), SensorNoise(1.0, 1.0, 1.0), np.random.default_rng(0))
    soft = SoftBody((0.02, 0.02, 0.01), 0.005, SoftMaterial(1.0, 1.0, inf, 0.0, 1.0), 0.004, 1e-3)
    soft.advance(1e-3, 0.01, 0.0099)
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


def main() -> int:
    """Call every kernel."""
    with ProcessPoolExecutor(2, mp_context=get_context('spawn')) as pool:
        for done in [pool.submit(fits), pool.submit(worlds)]:
            done.result()
    return 0


if __name__ == '__main__':
    sys.exit(main())
