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
Bench: the paper's Table 4 with the body of this package in three dimensions.

The block of 85 x 60 x 40 mm is pressed as in each of the four rows, with the model that the row's
Table 3 gives, and with models that have one or two effects more and the row's Table 2. Bouncing
and residual deformation are those of the surface, taken as `hapticvision shape` takes them. Holds,
withdrawal and recovery are assumptions, see ``bench/paper_case.py``; so are the tool's radius of
12.6 mm and a body that sticks to tool and support. Nothing is fitted to Table 4 but the stiffness
of the series spring. ``OMP_NUM_THREADS=1 python bench/bench_table_4.py --out doc/shape.md`` renews
the tables of that page: with small displacements, and with large ones (6 min).
"""

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
import time

from hapticvision_ros.core.body.calibration import calibrate
from hapticvision_ros.core.body.lattice import box
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.surface.deformation import mesh_height
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.units import KGF_PER_MM, MM
from page import renew
from paper_case import (
    ALONE,
    FACTORS,
    matched,
    NEAR,
    plain,
    read_rows,
    RECOVERY,
    rms,
    Row,
    see,
    table,
    WITHDRAWAL,
)

BEGIN, END = '<!-- table of bench/bench_table_4.py -->', '<!-- end of the table -->'
SIZE = (0.085, 0.060, 0.040)
RADIUS = 0.0126
K_0 = 0.45 * KGF_PER_MM
"""The one stiffness for all rows of doc/paper_case.md, which was fitted to their bouncing."""


@dataclass(frozen=True)
class Case:
    """What a row is simulated with."""

    name: str
    effects: tuple[str, ...]
    converged: bool

    def hold(self, row: Row) -> float:
        """Return how long the tool stays [s]."""
        return row.converged_hold if self.converged else row.implied_hold

    def values(self, row: Row) -> tuple[dict[str, float], float]:
        """Return the parameters, and how far a trial with them is off the row's Table 2."""
        if not self.effects:
            return row.table_3, 0.0
        model, fixed = Model(self.effects), {}
        first: Mapping[str, float]
        if 'series_spring' in self.effects:
            first, fixed = row.table_3 | {'F_y': 0.75 * row.F_inf}, {'K_0': K_0}
            return matched(model, row, self.hold(row), [first], fixed)
        first = row.table_3 | ALONE[self.effects[0]](row)
        starts = [{name: v * of.get(name, 1.0) for name, v in first.items()} for of in FACTORS]
        return matched(model, row, self.hold(row), starts)


CASES = (
    Case('before: three elements, Table 3', (), False),
    Case('before, hold converged', (), True),
    Case('after: `shear_thinning`', ('shear_thinning',), False),
    Case('after: `yield_force`, hold converged', ('yield_force',), True),
    Case(
        'after: `yield_force+series_spring`, hold converged',
        ('yield_force', 'series_spring'),
        True,
    ),
)


@dataclass(frozen=True)
class Shown:
    """Bouncing of the model and of the body [m], and how well the body follows the model."""

    model: float
    body: float
    force_misfit: float
    height_misfit: float


def simulated(case: Case, row: Row, pitch: float, rounds: int, *, small: bool) -> Shown | None:
    """Return what a row comes to; nothing where no model has its Table 2, or no body bears it."""
    values, miss = case.values(row)
    if miss > NEAR:
        return None
    model, hold = Model(case.effects), case.hold(row)
    body = box(SIZE, pitch)
    motion = ToolMotion.trial(
        SIZE[2],
        depth=row.depth,
        push_speed=row.speed,
        hold=hold,
        recovery=RECOVERY * row.retardation_time,
        release_speed=WITHDRAWAL,
    )
    end = float(motion.t[-1])
    around = Surroundings(small=small)
    tool = Tool(RADIUS, 0.0, 0.0)
    try:
        found = calibrate(body, model, values, tool, motion, around, at=(0.0, end), rounds=rounds)
    except InputError as error:
        print(f'{case.name}, {row.name}: {error}', flush=True)
        return None
    first, last = (
        mesh_height(Mesh(*found.run.surface(frame))).value
        for frame in (0, len(found.run.frame_t) - 1)
    )
    bouncing = row.depth - (first - last)
    told = see(model, values, row, hold).bouncing
    return Shown(told, bouncing, found.force_misfit, found.height_misfit)


def block(rows: Sequence[Row], pitch: float, rounds: int, *, small: bool) -> list[str]:
    """Return the table for one of the kinematics."""
    began = time.process_time()
    cells = []
    for case in CASES:
        of_body, of_model, worst = [], [], (0.0, 0.0)
        line = [case.name]
        for row in rows:
            shown = simulated(case, row, pitch, rounds, small=small)
            if shown is None:
                line.append(f'{case.hold(row):.0f}: -')
                continue
            of_body.append((shown.body - row.bouncing) / MM)
            of_model.append((shown.model - row.bouncing) / MM)
            worst = max(worst[0], shown.force_misfit), max(worst[1], shown.height_misfit)
            line.append(
                f'{case.hold(row):.0f}: {plain(shown.body / MM)}, '
                f'{plain((row.depth - shown.body) / MM)} ({plain(shown.model / MM)})'
            )
            print(case.name, row.name, shown, f'{time.process_time() - began:.0f} s', flush=True)
        line += [f'{rms(of_body):.2f} ({rms(of_model):.2f})' if of_body else '-']
        line += [f'{100 * worst[0]:.1f}, {100 * worst[1]:.1f} %' if of_body else '-']
        cells.append(line)
    printed = [(row.simulated - row.bouncing) / MM for row in rows]
    cells += [
        [
            "Table 4, the paper's simulation",
            *(f'{row.simulated / MM:.2f}, {(row.depth - row.simulated) / MM:.2f}' for row in rows),
            f'{rms(printed):.2f}',
            '',
        ],
        [
            'Table 4, the dough',
            *(f'{row.bouncing / MM:.2f}, {(row.depth - row.bouncing) / MM:.2f}' for row in rows),
            '',
            '',
        ],
    ]
    head = [
        'hold [s]: bouncing, residual [mm] (bouncing of the model alone)',
        *(row.name for row in rows),
        'bouncing off, rms [mm] (the model alone)',
        'body off its model: force, depth',
    ]
    kinematics = 'Small displacements' if small else 'Large displacements'
    return [f'{kinematics}, cells of {pitch / MM:g} mm:', '', *table(head, cells)]


def main() -> None:
    """Print the tables, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, help='page whose tables are renewed')
    parser.add_argument('--cell-mm', type=float, default=5.0)
    parser.add_argument('--rounds', type=int, default=12)
    args = parser.parse_args()
    rows = read_rows()
    lines = []
    for small in (True, False):
        lines += block(rows, args.cell_mm * MM, args.rounds, small=small)
    text = '\n'.join(lines)
    print(text)
    if args.out:
        renew(args.out, BEGIN, END, text)


if __name__ == '__main__':
    main()
