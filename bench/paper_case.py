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
Bench: the paper's own tables as a case for the models of this package.

What does the three-element model say with the paper's K1, C1 and C2, which effects account for
what it misses, and what do they say of Table 4? All curves are those of the forward model, looked
at as the paper does: eq. (4) is fitted to the hold, eq. (10) to the recovery. The paper does not
say how long it held, how fast the tool left and how long the dough recovered: see `CONVERGED`,
`WITHDRAWAL` and `RECOVERY`. ``OMP_NUM_THREADS=1 python bench/paper_case.py --out
doc/paper_case.md`` renews the tables of that page.
"""

import argparse
from collections.abc import Callable, Mapping, Sequence
import csv
from dataclasses import dataclass
import math
from pathlib import Path

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.exponential import fit_exponential
from hapticvision_ros.core.records import Signal
from hapticvision_ros.core.units import KGF_PER_MM, MM, STANDARD_GRAVITY
import numpy as np
from page import renew
from scipy.optimize import least_squares, OptimizeResult

TABLES = Path(__file__).with_name('data') / 'wheat_dough.csv'
BEGIN, END = '<!-- tables of bench/paper_case.py -->', '<!-- end of the tables -->'
HUNDRED_GF = 0.1 * STANDARD_GRAVITY

FIGURE_10_F0 = 9.26 * HUNDRED_GF
"""F_0 of row 1, which is in the text and in Fig. 10, but in no table [N]."""
FIGURE_11_H_INF = 7.44 * MM
"""H_inf of row 1, which is in the text and in Fig. 11, but in no table [m]."""
NEAR = 0.1
"""Share by which a trial may be off Table 2 and still count as having it."""
WITHDRAWAL = 10.0 * MM
"""Assumed speed of the tool on release [m/s]."""
RECOVERY = 10.0
"""Assumed duration of the recovery, in retardation times of Table 2; the paper: converged."""
CONVERGED = 5.0
"""Duration of a hold at the end of which eq. (4) has converged, in relaxation times of Table 2."""
PUSH_STEP, STEP = 0.02, 0.4
"""Of the push, and of all that follows [s]."""


@dataclass(frozen=True)
class Row:
    """One trial of the paper, in SI units."""

    speed: float
    depth: float
    relaxation_time: float
    F_inf: float
    retardation_time: float
    H0: float
    K1: float
    C1: float
    C2: float
    bouncing: float
    simulated: float

    @property
    def name(self) -> str:
        """Return what to call it."""
        return f'{self.speed / MM:g} mm/s, {self.depth / MM:g} mm'

    @property
    def table_2(self) -> np.ndarray:
        """Return what Table 2 says of it."""
        return np.array([self.relaxation_time, self.F_inf, self.retardation_time, self.H0])

    @property
    def table_3(self) -> dict[str, float]:
        """Return the paper's parameters."""
        return {'K1': self.K1, 'C1': self.C1, 'C2': self.C2}

    @property
    def converged_hold(self) -> float:
        """Return a hold in which the force has converged [s]."""
        return CONVERGED * self.relaxation_time

    @property
    def implied_hold(self) -> float:
        """Return the hold after which the model's z is Table 4's simulated bouncing [s]."""
        tau = (self.C1 + self.C2) / self.K1
        z = self.C2 * self.speed / self.K1 * -math.expm1(-self.depth / self.speed / tau)
        return tau * math.log(z / self.simulated)


def read_rows() -> list[Row]:
    """Return the rows of the tables."""
    lines = [line for line in TABLES.read_text().splitlines() if not line.startswith('#')]
    return [
        Row(
            speed=float(row['push_speed_mm_s']) * MM,
            depth=float(row['depth_mm']) * MM,
            relaxation_time=float(row['tau_s']),
            F_inf=float(row['F_inf_100gf']) * HUNDRED_GF,
            retardation_time=float(row['gamma_s']),
            H0=float(row['H0_mm']) * MM,
            K1=float(row['K1']) * KGF_PER_MM,
            C1=float(row['C1']) * KGF_PER_MM,
            C2=float(row['C2']) * KGF_PER_MM,
            bouncing=float(row['bouncing_real_mm']) * MM,
            simulated=float(row['bouncing_simulated_mm']) * MM,
        )
        for row in csv.DictReader(lines)
    ]


@dataclass(frozen=True)
class Driven:
    """A trial as the forward model asks for it."""

    t: np.ndarray
    displacement: np.ndarray
    height_t: np.ndarray
    campaign_time: float = 0.0
    reference_depth: float = 15.0 * MM
    depth_before: float = 0.0
    zero_time: float = 0.0


@dataclass(frozen=True)
class Seen:
    """
    What the paper would have written down of a trial [s, N, m].

    `push_force` is the force as the push ends, `hold_force` that of eq. (4) as the hold starts;
    `at_once` is what came back beside eq. (10), `bouncing` all that came back.
    """

    relaxation_time: float
    F_inf: float
    retardation_time: float
    H0: float
    push_force: float
    hold_force: float
    at_once: float
    bouncing: float

    @property
    def table_2(self) -> np.ndarray:
        """Return what Table 2 would say."""
        return np.array([self.relaxation_time, self.F_inf, self.retardation_time, self.H0])


def see(model: Model, values: Mapping[str, float], row: Row, hold: float) -> Seen:
    """Run a trial through the forward model and look at it as the paper does."""
    t_hold = row.depth / row.speed
    t_release = t_hold + hold
    t_end = t_release + RECOVERY * row.retardation_time
    t = np.concatenate(
        (
            np.arange(0.0, t_hold, PUSH_STEP),
            np.arange(t_hold, t_release - 0.5 * STEP, STEP),
            np.arange(t_release, t_end, STEP),
        )
    )
    tool = np.interp(t, [0.0, t_hold, t_release], [0.0, row.depth, row.depth])
    tool -= WITHDRAWAL * np.maximum(t - t_release, 0.0)
    theta = model.theta([values[name] for name in model.names])
    prediction = model.predict(Driven(t, tool, t[1:]), theta, directions=False)
    middle = 0.5 * (t[1:] + t[:-1])
    held = (middle > t_hold) & (middle < t_release)
    decay = fit_exponential(Signal(middle[held], prediction.force[held])).referred_to(t_hold)
    free = prediction.surface > tool + 1e-9
    after = (t > t_release) & free
    back = fit_exponential(Signal(t[after], prediction.surface[after])).referred_to(t_release)
    return Seen(
        relaxation_time=decay.time_constant,
        F_inf=decay.offset,
        retardation_time=back.time_constant,
        H0=back.amplitude,
        push_force=float(prediction.force[middle < t_hold][-1]),
        hold_force=decay.amplitude + decay.offset,
        at_once=row.depth - back.amplitude - back.offset,
        bouncing=row.depth - float(prediction.surface[-1]),
    )


def matched(
    model: Model,
    row: Row,
    hold: float,
    starts: Sequence[Mapping[str, float]],
    fixed: Mapping[str, float] | None = None,
) -> tuple[dict[str, float], float]:
    """Return parameters whose trial is closest to the row's Table 2, and the largest distance."""
    free = [name for name in model.names if name not in (fixed or {})]

    def values(logs: np.ndarray) -> dict[str, float]:
        return dict(zip(free, np.exp(logs).tolist(), strict=True)) | dict(fixed or {})

    def misfit(logs: np.ndarray) -> np.ndarray:
        seen = see(model, values(logs), row, hold).table_2
        return np.log(np.maximum(seen, 1e-2 * row.table_2) / row.table_2)

    found = [search(misfit, model, free, start) for start in starts]
    best = min(found, key=lambda solution: solution.cost)
    return values(best.x), float(np.expm1(np.abs(best.fun).max()))


def search(
    misfit: Callable[[np.ndarray], np.ndarray],
    model: Model,
    free: Sequence[str],
    start: Mapping[str, float],
) -> OptimizeResult:
    """Return the least squares of a misfit over the logarithms of parameters, in their range."""
    declared = dict(zip(model.names, model.parameters, strict=True))
    lower = np.log([max(declared[name].lower, 1e-6) for name in free])
    upper = np.log([min(declared[name].upper, 1e12) for name in free])
    first = np.clip(np.log([start[name] for name in free]), lower + 1e-3, upper - 1e-3)
    return least_squares(
        misfit, first, bounds=(lower, upper), diff_step=1e-4, max_nfev=MOST_STEPS, x_scale=0.3
    )


MOST_STEPS = 30
FACTORS = ({}, {'C2': 4.0}, {'C2': 0.25}, {'K1': 4.0, 'C1': 4.0})
"""Where to start from, as factors on Table 3."""

HOLDS: tuple[tuple[str, Callable[[Row], float]], ...] = (
    ("Held for as long as Table 4's simulated bouncing implies", lambda row: row.implied_hold),
    ('Held until eq. (4) has converged', lambda row: row.converged_hold),
)
"""The paper does not say how long it held."""

ALONE = {
    'yield_force': lambda row: {'F_y': row.F_inf},
    'parallel_spring': lambda row: {'K_p': row.F_inf / row.depth},
    'shear_thinning': lambda row: {'n': 0.5},
    'springpot': lambda row: {'alpha': 0.6},
}
"""Effects of one parameter, and where to start it: with K1, C1, C2 as many as a row of Table 2."""


def rms(errors: Sequence[float]) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def plain(value: float) -> str:
    """Return a number with two decimals; what rounds to zero has no sign."""
    return f'{round(value, 2) + 0.0:.2f}'


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    """Return a table in Markdown."""
    lines = ['| ' + ' | '.join(head) + ' |', '| ' + ' | '.join('---' for _ in head) + ' |']
    return [*lines, *('| ' + ' | '.join(row) + ' |' for row in rows), '']


def base_case(rows: Sequence[Row]) -> list[str]:
    """Return what the three-element model says with the paper's parameters."""
    lines = ["### The three-element model with the paper's K1, C1 and C2", '']
    for title, hold_of in HOLDS:
        cells, errors = [], []
        for row in rows:
            hold = hold_of(row)
            seen = see(Model(), row.table_3, row, hold)
            errors.append((seen.bouncing - row.bouncing) / MM)
            measured = 'not told'
            if row is rows[0]:
                measured = f'{FIGURE_10_F0 + row.F_inf:.1f}'
            cells.append(
                [
                    row.name,
                    f'{hold:.1f}',
                    f'{seen.push_force:.0f}',
                    f'{seen.hold_force:.0f} / {measured}',
                    f'{plain(seen.F_inf)} / {row.F_inf:.2f}',
                    f'{plain(seen.at_once / MM)} / {(row.bouncing - row.H0) / MM:.2f}',
                    f'{plain(seen.bouncing / MM)} / {row.bouncing / MM:.2f}',
                    f'{(row.depth - seen.bouncing) / MM:.2f} / '
                    f'{(row.depth - row.bouncing) / MM:.2f}',
                ]
            )
        lines += [f'{title} (model / measured):', '']
        lines += table(
            [
                'row',
                'hold [s]',
                'force as the push ends [N]',
                'force as the hold starts [N]',
                'F_inf [N]',
                'back at once [mm]',
                'bouncing [mm]',
                'residual [mm]',
            ],
            cells,
        )
        lines += [f'Bouncing is off by {rms(errors):.2f} mm rms.', '']
    return lines


def one_effect(rows: Sequence[Row]) -> list[str]:
    """Return what models that have Table 2 say of Table 4, which they have not seen."""
    lines = ['### One effect, row by row: Table 2 given, Table 4 predicted', '']
    for title, hold_of in HOLDS:
        cells = []
        for effect, start in ALONE.items():
            model = Model((effect,))
            errors, misses, texts, forces = [], [], [], []
            for row in rows:
                first = row.table_3 | start(row)
                starts = [{k: v * of.get(k, 1.0) for k, v in first.items()} for of in FACTORS]
                values, miss = matched(model, row, hold_of(row), starts)
                seen = see(model, values, row, hold_of(row))
                errors.append((seen.bouncing - row.bouncing) / MM)
                misses.append(miss)
                forces.append(seen.hold_force)
                texts.append(f'{seen.bouncing / MM:.2f}' if miss < NEAR else '-')
            having = [e for e, miss in zip(errors, misses, strict=True) if miss < NEAR]
            cells.append(
                [
                    f'`{effect}`',
                    str(len(having)),
                    *texts,
                    f'{rms(having):.2f}' if having else '-',
                    f'{forces[0]:.1f}' if misses[0] < NEAR else '-',
                ]
            )
        printed = [(row.simulated - row.bouncing) / MM for row in rows]
        cells += [
            [
                'three-element, Table 4',
                '',
                *(f'{row.simulated / MM:.2f}' for row in rows),
                f'{rms(printed):.2f}',
                '',
            ],
            [
                'measured, Table 4',
                '',
                *(f'{row.bouncing / MM:.2f}' for row in rows),
                '',
                f'{FIGURE_10_F0 + rows[0].F_inf:.1f}',
            ],
        ]
        lines += [f'{title}:', '']
        lines += table(
            [
                'effect added',
                'rows whose Table 2 it can have',
                *(f'bouncing [mm], {row.name}' for row in rows),
                'rms error [mm]',
                'force as the hold starts, row 1 [N]',
            ],
            cells,
        )
    return lines


def with_series_spring(rows: Sequence[Row]) -> list[str]:
    """Return what a series spring adds, its stiffness from other rows than the one predicted."""
    lines = ['### Yield force and series spring', '']
    model = Model(('yield_force', 'series_spring'))
    grid = KGF_PER_MM * np.geomspace(0.15, 4.0, 16)
    bouncing = np.full((len(rows), grid.size), np.nan)
    hold_force, at_once = bouncing.copy(), bouncing.copy()
    for i, row in enumerate(rows):
        start = row.table_3 | {'F_y': 0.75 * row.F_inf}
        for k, K_0 in enumerate(grid):
            values, miss = matched(model, row, row.converged_hold, [start], {'K_0': K_0})
            if miss > NEAR:
                continue
            start = values
            seen = see(model, values, row, row.converged_hold)
            bouncing[i, k], hold_force[i, k] = seen.bouncing / MM, seen.hold_force
            at_once[i, k] = seen.at_once / MM
    measured = np.array([row.bouncing / MM for row in rows])
    errors = bouncing - measured[:, np.newaxis]

    def best(chosen: Sequence[int]) -> int:
        """Return the place of the K_0 that these rows' bouncing asks for."""
        return int(np.nanargmin(np.sum(errors[list(chosen)] ** 2, axis=0)))

    cells, held_out = [], []
    everything = range(len(rows))
    for i, row in enumerate(rows):
        told = np.isfinite(errors[i])
        stiffest = grid[told][-1] / KGF_PER_MM
        own = f'more than {stiffest:.2f}'
        if errors[i][told].min() < 0.0:
            own = f'{np.interp(0.0, -errors[i][told], grid[told]) / KGF_PER_MM:.2f}'
        others = best([k for k in everything if k != i])
        held_out.append(errors[i, others])
        predicted = 'none: it cannot have its Table 2'
        if told[others]:
            predicted = f'{bouncing[i, others]:.2f} / {measured[i]:.2f}'
        cells.append(
            [
                row.name,
                own,
                f'{stiffest:.2f}',
                f'{grid[others] / KGF_PER_MM:.2f}',
                predicted,
            ]
        )
    lines += table(
        [
            'row',
            'K_0 that its own bouncing asks for [kgf/mm]',
            'stiffest K_0 with which it can have its Table 2',
            'K_0 of the other three rows',
            'bouncing predicted with that / measured [mm]',
        ],
        cells,
    )
    shared = best(everything)
    having = [error for error in held_out if math.isfinite(error)]
    left_out = f'{rms(having):.2f} mm over the {len(having)} rows that can have their Table 2'
    mean = [(measured.sum() - own) / (len(rows) - 1) - own for own in measured]
    force = FIGURE_10_F0 + rows[0].F_inf
    told = np.isfinite(hold_force[0])
    by_force = float(np.interp(force, hold_force[0][told], grid[told]))
    lines += [
        f'The best K_0 for all rows together is {grid[shared] / KGF_PER_MM:.2f} kgf/mm, and '
        f'bouncing is off by {rms(errors[:, shared]):.2f} mm rms; with each row left '
        f'out in turn by {left_out}. The mean of the other three rows, with no model at all, is '
        f'off by {rms(mean):.2f} mm.',
        '',
        f'Row 1 also tells the force as the hold starts, {force:.1f} N. That alone asks for K_0 = '
        f'{by_force / KGF_PER_MM:.2f} kgf/mm, with which '
        f'{np.interp(by_force, grid[told], at_once[0][told]):.2f} mm come back at once. Measured '
        f'were {(rows[0].depth - rows[0].H0 - FIGURE_11_H_INF) / MM:.2f} mm by Fig. 11 and '
        f'{(rows[0].bouncing - rows[0].H0) / MM:.2f} mm by Table 4.',
        '',
    ]
    return lines


def one_material(rows: Sequence[Row]) -> list[str]:
    """Return how models with one set of parameters for all rows predict the row left out."""
    lines = ['### One material for all rows', '']
    cells = []
    for effects in (
        (),
        ('yield_force',),
        ('yield_force', 'series_spring'),
        ('yield_force', 'shear_thinning'),
        ('yield_force', 'strain_stiffening'),
        ('yield_force', 'second_retardation'),
    ):
        model = Model(effects)
        start = {
            'K1': rows[0].K1,
            'C1': rows[0].C1,
            'C2': rows[0].C2,
            'F_y': rows[0].F_inf,
            'K_0': 1.0 * KGF_PER_MM,
            'n': 0.7,
            'beta': 1e4,
            'K_2': 5.0 * rows[0].K1,
            'C_3': 0.5 * rows[0].C1,
        }

        def values(logs: np.ndarray, model: Model = model) -> dict[str, float]:
            return dict(zip(model.names, np.exp(logs).tolist(), strict=True))

        def misfit(logs: np.ndarray, chosen: Sequence[Row], model: Model = model) -> np.ndarray:
            of = values(logs)
            parts = []
            for row in chosen:
                seen = see(model, of, row, row.converged_hold)
                parts.append(np.log(np.maximum(seen.table_2, 1e-2 * row.table_2) / row.table_2))
            return np.concatenate(parts)

        def fitted(
            chosen: Sequence[Row], model: Model = model, start: Mapping[str, float] = start
        ) -> np.ndarray:
            return search(lambda x: misfit(x, chosen), model, model.names, start).x

        table_2 = rms(misfit(fitted(rows), rows))
        left_out, bouncing = [], []
        for row in rows:
            found = fitted([other for other in rows if other is not row])
            left_out.append(rms(misfit(found, [row])))
            seen = see(model, values(found), row, row.converged_hold)
            bouncing.append((seen.bouncing - row.bouncing) / MM)
        cells.append(
            [
                '`' + '+'.join(effects) + '`' if effects else 'none',
                str(len(model.names)),
                f'{100.0 * math.expm1(table_2):.0f} %',
                f'{100.0 * math.expm1(rms(left_out)):.0f} %',
                f'{rms(bouncing):.2f}',
            ]
        )
    return lines + table(
        [
            'effects',
            'parameters',
            'off Table 2, all rows fitted',
            'off Table 2, the row left out',
            'bouncing of the row left out, rms error [mm]',
        ],
        cells,
    )


def main() -> None:
    """Print the tables, and write them if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--out', type=Path, help='page whose tables are renewed')
    args = parser.parse_args()
    rows = read_rows()
    lines = []
    for part in (base_case, one_effect, with_series_spring, one_material):
        lines += part(rows)
    text = '\n'.join(lines)
    print(text)
    if args.out:
        renew(args.out, BEGIN, END, text)


if __name__ == '__main__':
    main()
