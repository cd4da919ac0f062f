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
Bench: bouncing and residual deformation over speeds and depths, from clouds, as in Table 4.

The body is the deforming one of the simulated cell, of a dough that yields. Each push is a bag;
`hapticvision fit` finds what the three elements lack, and `hapticvision shape` simulates each push
before and after; beside them stands the model with the yield force that this world has, fitted to
the same bags with that name given away. True is what the world's body has at the end. The table
is that of doc/shape.md: ``OMP_NUM_THREADS=1 python bench/bench_shape_grid.py --out doc/shape.md``
(6 min).
"""

import argparse
import contextlib
from dataclasses import replace
import io
import itertools
import json
from pathlib import Path
import tempfile
from typing import Any

from bench_shape_loop import HEIGHT, Kept, MATERIAL, record, truth, USUAL
from hapticvision_ros.cli.main import main as hapticvision
from hapticvision_ros.core.units import MM
from hapticvision_ros.sim import offline
import numpy as np
from page import renew

BEGIN, END = '<!-- table of bench/bench_shape_grid.py -->', '<!-- end of the grid -->'
SPEEDS = (0.002, 0.005, 0.010)
DEPTHS = (0.002, 0.003, 0.004)
DOUGH = replace(MATERIAL, yield_force=2.0)
RADIUS = 0.008
TOLD = 'three-element+yield_force'


def shapes(result: Path, bags: list[str], which: str, out: Path) -> list[dict[str, Any]]:
    """Return what `hapticvision shape` writes of each bag."""
    command = ['shape', str(result), *bags, '--tool-radius', f'{RADIUS}', '--which', which]
    command += ['--size', '60x40x20mm', '--cell', '4mm', '--out', str(out)]
    # What is known of this object, and the force does not tell.
    command += ['--volume-ratio', '1']
    if hapticvision(command) != 0:
        raise SystemExit('a shape could not be simulated')
    return [json.loads((out / Path(bag).name / 'shape.json').read_text()) for bag in bags]


def main() -> None:
    """Record, fit, simulate and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, help='the page that has the table')
    parser.add_argument('--seed', type=int, default=1)
    args = parser.parse_args()
    offline.World = Kept
    pushes = list(itertools.product(SPEEDS, DEPTHS))
    # Repeats of the push in the middle tell scatter from effect; they are fitted, not shown.
    repeated = [*pushes, *[(SPEEDS[1], DEPTHS[1])] * 2]
    with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()):
        folder = Path(place)
        world = replace(USUAL, step=1e-4)
        bags = record(
            folder,
            world,
            RADIUS,
            args.seed,
            pushes=repeated,
            material=DOUGH,
            hold=6.0,
            recover=6.0,
        )
        true = [truth(world)[0] for world in Kept.made]
        fit, told = folder / 'fit', folder / 'told'
        hapticvision(['fit', *bags, '--out', str(fit)])
        hapticvision(['fit', *bags, '--model', TOLD, '--out', str(told)])
        result = json.loads((fit / 'result.json').read_text())
        models = {
            kind: result[kind]['model'] for kind in ('before', 'after') if result.get(kind)
        } | {'told': TOLD}
        kinds = list(models)
        shown = bags[: len(pushes)]
        found = {
            kind: shapes(fit / 'result.json', shown, kind, folder / kind)
            for kind in kinds
            if kind != 'told'
        }
        found['told'] = shapes(told / 'result.json', shown, 'after', folder / 'as_told')
    lines = [
        '| push | of the height | true | measured | '
        + ' | '.join(f'simulated, {kind}' for kind in kinds)
        + ' | rms of the surface, '
        + ', '.join(kinds)
        + ' (noise) |',
        '| --- ' * (5 + len(kinds)) + '|',
    ]
    off: dict[str, list[float]] = {kind: [] for kind in kinds}
    for k, (speed, depth) in enumerate(pushes):
        one = found['before'][k]
        cells = [f'{speed / MM:g} mm/s, {depth / MM:g} mm', f'{100 * depth / HEIGHT:.0f} %']
        # A bouncing is the depth at the release less what stays.
        seen, bounced = one['residual_m'], one['bouncing_m']
        at_release = seen['measured'] + bounced['measured']
        cells.append(f'{(at_release - true[k]) / MM:.3f}, {true[k] / MM:.3f}')
        cells.append(
            f'{bounced["measured"] / MM:.3f}, {seen["measured"] / MM:.3f} '
            f'± {seen["measured_std"] / MM:.3f}'
        )
        rms = []
        for kind in kinds:
            shape = found[kind][k]
            pair = [shape[name]['simulated'] / MM for name in ('bouncing_m', 'residual_m')]
            cells.append(f'{pair[0]:.3f}, {pair[1]:.3f}')
            off[kind].append(pair[1] - seen['measured'] / MM)
            rms.append(f'{shape["after"][-1]["rms_m"] / MM:.3f}')
        cells.append(f'{", ".join(rms)} ({one["after"][-1]["noise_m"] / MM:.3f})')
        lines.append(f'| {" | ".join(cells)} |')
    errors = '; '.join(
        f'{kind} `{models[kind]}`: {np.sqrt(np.mean(np.square(off[kind]))):.3f} mm'
        for kind in kinds
    )
    text = '\n'.join([*lines, '', f'Residual simulated less measured, rms: {errors}.', ''])
    print(text)
    if args.out is not None:
        renew(args.out, BEGIN, END, text)


if __name__ == '__main__':
    main()
