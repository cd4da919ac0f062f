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
Bench: what the force cannot see, from clouds of the deforming body of the simulated cell.

For each world, some pushes are recorded as bags, fitted, and held against the body of
`hapticvision shape`, which has a volume ratio of 14, sticks to the support and has a flat tool.
What differs in the world is declared nowhere. The tables are those of doc/shape.md:
``OMP_NUM_THREADS=1 python bench/bench_shape_loop.py`` (a minute for each world), and with
``--seeds 5`` how often the answer is right.
"""

import argparse
from collections.abc import Sequence
import contextlib
from dataclasses import replace
import io
import json
from pathlib import Path
import tempfile
import time
from typing import Any, ClassVar

from hapticvision_ros.cli.main import main as hapticvision
from hapticvision_ros.core.units import MM
from hapticvision_ros.sim import offline
from hapticvision_ros.sim.config import load_config, SoftBodyModel
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.offline import CloudPlan, record_trial, TrialPlan
import numpy as np

MATERIAL = Material(2000.0, 1600.0, 2400.0)
USUAL = SoftBodyModel(pitch=0.005, step=5e-4, volume_ratio=1.0)
BALL = SoftBodyModel(pitch=0.0025, step=2.5e-4, volume_ratio=1.0, sphere=True)
"""In cells of 5 mm the contact of a ball of 8 mm does not grow, but jumps from node to node."""
WORLDS = {
    'keeps its volume (ratio 1)': USUAL,
    'keeps its volume (ratio 4)': replace(USUAL, volume_ratio=4.0, step=2.5e-4),
    'does not keep its volume (ratio 0)': replace(USUAL, volume_ratio=0.0),
    'slides on the support': replace(USUAL, friction=0.0),
    'spherical tool': BALL,
    'ratio 0 and slides': replace(USUAL, volume_ratio=0.0, friction=0.0),
    'spherical tool of 12 mm': BALL,
    'friction of 0.3 on the support': replace(USUAL, friction=0.3),
    'friction of 0.15 on the support': replace(USUAL, friction=0.15),
}
RADII = {'spherical tool of 12 mm': 0.012}
"""Where it is not 8 mm [m]."""
SLIDES, RUBS, BALL_TIP = 'slides on the support', 'friction 0.3 on the support', 'spherical tool'
ASKED_FOR: dict[str, tuple[set[str], ...]] = {
    'does not keep its volume (ratio 0)': ({'volume ratio 0'},),
    'slides on the support': ({SLIDES},),
    'spherical tool': ({BALL_TIP},),
    'ratio 0 and slides': ({'volume ratio 0', SLIDES},),
    'spherical tool of 12 mm': ({BALL_TIP},),
    'friction of 0.3 on the support': ({RUBS},),
    'friction of 0.15 on the support': ({SLIDES}, {RUBS}),
}
"""What the shape should ask for, one of these; a ratio of 1 where it is true does no harm."""
LENGTH, WIDTH, HEIGHT = 0.060, 0.040, 0.020
PUSHES = ((0.005, 0.003), (0.004, 0.004), (0.008, 0.0035))
"""Speeds [m/s] and depths [m]."""


class Kept(offline.World):
    """A world that is kept after its trial: it alone knows the truth."""

    made: ClassVar[list[offline.World]] = []

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **options)
        Kept.made.append(self)


def truth(world: offline.World) -> tuple[float, float]:
    """Return the depth of the dent and the bulge of the side that faces the sensor [m]."""
    assert world.soft is not None
    rest, points = world.soft.rest, world.soft.points
    facing = (rest[:, 1] == -0.5 * WIDTH) & (np.abs(rest[:, 2] / HEIGHT - 0.5) < 0.3)
    return world.displacement, float((rest - points)[facing, 1].mean())


def record(
    folder: Path,
    model: SoftBodyModel,
    radius: float,
    seed: int,
    *,
    pushes: Sequence[tuple[float, float]] = PUSHES,
    material: Material = MATERIAL,
    hold: float = 3.0,
    recover: float = 2.0,
) -> list[str]:
    """Make the bags of a world."""
    cell = load_config()
    cell = replace(
        cell,
        block=replace(cell.block, length=LENGTH, width=WIDTH, height=HEIGHT, rim_width=0.004),
        load_cell=replace(cell.load_cell, rate=250.0),
        arm=replace(cell.arm, state_rate=100.0, tool_radius=radius, start_height=0.042),
        range_sensor=replace(cell.range_sensor, rate=5.0, field_of_view=0.21, table_size=0.1),
        soft_body=model,
    )
    bags = []
    for k, (speed, depth) in enumerate(pushes):
        bag = folder / f'push_{k + 1}'
        plan = TrialPlan(push_speed=speed, depth=depth, hold_time=hold, recover_time=recover)
        clouds = CloudPlan(width=96, height=72, depth_noise=0.0003)
        record_trial(bag, cell, material, plan, seed=seed + k, clouds=clouds)
        bags.append(str(bag))
    return bags


def main() -> None:
    """Run the worlds and print what was found in each."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--worlds', type=int, nargs='*', help='which, from 0')
    parser.add_argument('--cell', default='4mm')
    parser.add_argument('--rounds', default='8')
    parser.add_argument('--small', action='store_true', help='small displacements')
    parser.add_argument('--seed', type=int, default=1, help='the first')
    parser.add_argument('--seeds', type=int, default=1, help='campaigns of each world')
    args = parser.parse_args()
    offline.World = Kept
    rows = [
        '| world | campaigns | right | accepted otherwise | left out [mm] |',
        '| --- ' * 5 + '|',
    ]
    for k, (name, model) in enumerate(WORLDS.items()):
        if args.worlds is not None and k not in args.worlds:
            continue
        answers, left = [], []
        for seed in range(args.seed, args.seed + args.seeds):
            loops = _campaign(name, model, seed, args)
            answers.append({loop['chosen'] for loop in loops if loop['accepted']})
            accepted = [loop for loop in loops if loop['accepted']]
            first, last = loops[0], (accepted or loops)[-1]
            after = 'held_out_after_m' if accepted else 'held_out_before_m'
            left.append((first['held_out_before_m'] / MM, last[after] / MM))
        asked = ASKED_FOR.get(name, (set(),))
        harmless = {'volume ratio 1'} if model.volume_ratio == 1.0 else set()
        wrong = sorted(
            ', '.join(sorted(one)) or 'nothing'
            for one in answers
            if not any(wanted <= one <= wanted | harmless for wanted in asked)
        )
        before, after = np.median(left, axis=0)
        rows.append(
            f'| {name} | {len(answers)} | {len(answers) - len(wrong)} | {"; ".join(wrong) or "-"} '
            f'| {before:.3f} → {after:.3f} |'
        )
    print('\n'.join(rows))


def _campaign(
    name: str, model: SoftBodyModel, seed: int, asked: argparse.Namespace
) -> list[dict[str, Any]]:
    """Make a campaign of a world, close the loop, print what came of it and return its turns."""
    began = time.process_time()
    Kept.made.clear()
    with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(place)
        radius = RADII.get(name, 0.008)
        bags = record(folder, model, radius, seed)
        fit, out = folder / 'fit', folder / 'shape'
        hapticvision(['fit', *bags, '--model', 'three-element', '--out', str(fit)])
        command = ['shape', str(fit / 'result.json'), *bags, '--tool-radius', f'{radius}']
        command += ['--size', '60x40x20mm', '--cell', asked.cell]
        command += ['--rounds', asked.rounds, *(['--small'] if asked.small else [])]
        hapticvision([*command, '--close-loop', '--out', str(out)])
        told = json.loads((fit / 'result.json').read_text())['before']['parameters']
        table = json.loads((out / 'shapes.json').read_text())
        shapes = [json.loads((out / Path(bag).name / 'shape.json').read_text()) for bag in bags]
    print(f'## {name}, seed {seed} ({time.process_time() - began:.0f} s)')
    print({one: round(told[one]['value']) for one in told})
    for loop in table['loop']:
        for rival, misfits in loop['misfit_m'].items():
            print(f'{rival:<24}', *(f'{one / MM:.3f}' for one in misfits))
        print(
            f'held out {loop["held_out_before_m"] / MM:.3f} -> '
            f'{loop["held_out_after_m"] / MM:.3f} mm, lowered {loop["lowered_m2"] / MM**2:.5f}'
            f' ± {loop["lowered_std_m2"] / MM**2:.5f}, '
            f'cells {loop["by_cells_m2"] / MM**2:.5f} mm2'
        )
        print(f'{"accepted" if loop["accepted"] else "not accepted"}: {loop["verdict"]}')
    true = [truth(world) for world in Kept.made]
    for k, what in enumerate(('residual', 'bulge')):
        print(
            f'{what} [mm], true, measured, simulated:',
            *(
                f'{one[k] / MM:.3f} {shape[f"{what}_m"]["measured"] / MM:.3f} '
                f'{shape[f"{what}_m"]["simulated"] / MM:.3f};'
                for one, shape in zip(true, shapes, strict=True)
            ),
            flush=True,
        )
    turns: list[dict[str, Any]] = table['loop']
    return turns


if __name__ == '__main__':
    main()
