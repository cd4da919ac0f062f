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
Bench: the body in 3D beside a deformable body of a public engine, MuJoCo.

A block of 85 x 60 x 40 mm with 18 x 13 x 9 nodes, which stands fast on the support, is pressed by
a flat tool of 12.6 mm radius, held and let go. Both have the same Young's modulus and a Poisson's
ratio of 1/4: links here, tetrahedra there, with friction between tool and block. MuJoCo has no
dashpot in series; what it has is damping beside the spring and a yield strain. Its mass is scaled
with the square of its step, since its contact is as stiff as the mass allows. Forces are means
over the last tenth of push and hold, dent and residual those of the node at the axis.

MuJoCo is no requirement of this package: ``pip install mujoco`` (4.0 or later), then
``OMP_NUM_THREADS=1 python bench/bench_public_engine.py`` (2 min).
"""

import argparse
import contextlib
from dataclasses import dataclass
import importlib.util
import math
import tempfile
import time
from typing import Any

from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.body.simulation import simulate
import numpy as np

SIZE, PITCH, RADIUS = (0.085, 0.060, 0.040), 0.005, 0.0126
STIFFNESS = 320.0
"""Of a link along an edge [N/m]."""
YOUNG = 1.875 * STIFFNESS / PITCH
SPEED, HOLD, RECOVERY, CLEARANCE = 7.7e-3, 0.3, 0.3, 1e-3
WHOLE = 130.0
"""The trial that is asked for [s]."""
SKIN = 5e-4
"""By how much MuJoCo's tetrahedra are thickened for contact [m]."""


@dataclass(frozen=True)
class Shown:
    """What came of it: CPU times [s], steps, forces [N], dent and residual [m]."""

    cpu: float
    whole: float
    steps: int
    pushed: float
    held: float
    dent: float
    residual: float

    def line(self, name: str) -> str:
        """Return a row of the table."""
        return (
            f'| {name} | {self.steps} | {self.cpu:.1f} | {self.whole:.0f} | {self.pushed:.2f} | '
            f'{self.held:.2f} | {1e3 * self.dent:.2f} | {1e3 * self.residual:.2f} |'
        )


def path(depth: float, hold: float = HOLD, recovery: float = RECOVERY) -> ToolMotion:
    """Return push, hold, release and recovery."""
    return ToolMotion.trial(
        SIZE[2],
        depth=depth,
        push_speed=SPEED,
        hold=hold,
        recovery=recovery,
        clearance=CLEARANCE,
    )


def of_links(motion: ToolMotion, law: LinkLaw) -> Shown:
    """Run the body of this package."""
    body, tool = box(SIZE, PITCH), Tool(RADIUS, 0.0, 0.0)
    around = Surroundings(volume_ratio=0.0)
    pushed, held = motion.corners
    began = time.process_time()
    run = simulate(body, law, tool, motion, around, at=(held, float(motion.t[-1])))
    cpu = time.process_time() - began
    axis = _at_the_axis(body.points)
    fall = body.points[axis, 2] - run.frames[:, axis, 2]
    over = [
        float(np.average(run.force[of], weights=np.diff(run.t)[of]))
        for of in (_last(run.t[1:], 0.0, pushed), _last(run.t[1:], pushed, held))
    ]
    depth = SIZE[2] - float(motion.height.min())
    rest = 0.5 * (WHOLE - depth / SPEED)
    began = time.process_time()
    simulate(body, law, tool, path(depth, rest, rest), around)
    whole = time.process_time() - began
    return Shown(cpu, whole, run.force.size, *over, float(fall[0]), float(fall[1]))


def _last(t: np.ndarray, start: float, stop: float) -> np.ndarray:
    """Return which steps end in the last tenth of a phase, its last step at least."""
    chosen = (t > stop - 0.1 * (stop - start)) & (t <= stop + 1e-9)
    return chosen if chosen.any() else t == t[t <= stop + 1e-9].max()


def _at_the_axis(points: np.ndarray) -> int:
    """Return the node on top that is nearest to the tool's axis."""
    top = np.flatnonzero(points[:, 2] > points[:, 2].max() - 1e-9)
    return int(top[np.argmin(np.hypot(points[top, 0], points[top, 1]))])


def described(step: float, density: float, damping: float, strain: float) -> str:
    """Return the same block and tool for MuJoCo."""
    counts = [round(one / PITCH) + 1 for one in SIZE]
    touch = (
        f'condim="3" friction="10 0.005 0.0001" solref="{2.0 * step} 1" solimp="0.99 0.999 0.0001"'
    )
    return f"""<mujoco>
  <option timestep="{step}" gravity="0 0 0" integrator="discrete" solver="CG"/>
  <size memory="500M"/>
  <worldbody>
    <body name="tool" mocap="true" pos="0 0 1">
      <geom type="cylinder" size="{RADIUS} 0.01" {touch}/>
    </body>
    <flexcomp name="block" type="grid" dim="3" count="{counts[0]} {counts[1]} {counts[2]}"
        spacing="{PITCH} {PITCH} {PITCH}" pos="0 0 {0.5 * SIZE[2]}" radius="{SKIN}"
        mass="{density * math.prod(SIZE)}">
      <contact selfcollide="none" {touch}/>
      <elasticity young="{YOUNG}" poisson="0.25" damping="{damping}" yield="{strain}"/>
      <pin gridrange="0 0 0 {counts[0] - 1} {counts[1] - 1} 0"/>
    </flexcomp>
  </worldbody>
</mujoco>"""


def of_mujoco(
    motion: ToolMotion, step: float, density: float, damping: float, strain: float
) -> Shown:
    """Run MuJoCo's."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(described(step, density, damping, strain))
    data: Any = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    axis = _at_the_axis(np.array(data.flexvert_xpos))
    pushed, held = motion.corners
    times, forces, heights = [], [], []
    six = np.zeros(6)
    cpu = 0.0
    while data.time < motion.t[-1]:
        data.mocap_pos[0, 2] = motion.at(np.array([data.time + step]))[0] + SKIN + 0.01
        began = time.process_time()
        mujoco.mj_step(model, data)
        cpu += time.process_time() - began
        force = 0.0
        for k in range(data.ncon):
            mujoco.mj_contactForce(model, data, k, six)
            force -= float((data.contact[k].frame.reshape(3, 3).T @ six[:3])[2])
        times.append(data.time)
        forces.append(force)
        heights.append(float(data.flexvert_xpos[axis, 2]))
    t, f, z = np.array(times), np.array(forces), np.array(heights)
    over = [float(f[of].mean()) for of in (_last(t, 0.0, pushed), _last(t, pushed, held))]
    dent = SIZE[2] - float(np.interp(held, t, z))
    whole = cpu * WHOLE / float(motion.t[-1])
    return Shown(cpu, whole, t.size, *over, dent, SIZE[2] - float(z[-1]))


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--depth-mm', type=float, default=2.0)
    parser.add_argument('--cases', type=int, nargs='*', help='which of them, from 0')
    args = parser.parse_args()
    if importlib.util.find_spec('mujoco') is None:
        print('mujoco is not installed: nothing to compare with')
        return
    motion = path(1e-3 * args.depth_mm)
    spring = LinkLaw(STIFFNESS, 0.0, 1e15)
    voigt = LinkLaw(STIFFNESS, 0.1 * STIFFNESS, 1e15)
    chain = LinkLaw(STIFFNESS, 0.1 * STIFFNESS, 0.3 * STIFFNESS)
    cases = (
        ('springs', lambda: of_links(motion, spring)),
        ('springs, MuJoCo, 3 ms', lambda: of_mujoco(motion, 3e-3, 1e6, 0.0, 0.0)),
        ('springs, MuJoCo, 1 ms', lambda: of_mujoco(motion, 1e-3, 1e5, 0.0, 0.0)),
        ('a dashpot beside, 0.1 s', lambda: of_links(motion, voigt)),
        ('a dashpot beside, 0.1 s, MuJoCo, 3 ms', lambda: of_mujoco(motion, 3e-3, 1e6, 0.1, 0.0)),
        ('three elements, 0.1 s and 0.3 s', lambda: of_links(motion, chain)),
        ('a yield strain of 0.02, MuJoCo, 3 ms', lambda: of_mujoco(motion, 3e-3, 1e6, 0.0, 0.02)),
    )
    of_links(motion, spring)
    print(
        f'{motion.t[-1]:.2f} s simulated; for {WHOLE:g} s measured here, MuJoCo extrapolated\n'
        f'| body | steps | CPU s | for {WHOLE:g} s | force at the end of push N | of hold N '
        '| dent mm | residual mm |',
        flush=True,
    )
    # MuJoCo writes its warnings into a file where it is run.
    with tempfile.TemporaryDirectory() as place, contextlib.chdir(place):
        for k, (name, made) in enumerate(cases):
            if args.cases is None or k in args.cases:
                print(made().line(name), flush=True)


if __name__ == '__main__':
    main()
