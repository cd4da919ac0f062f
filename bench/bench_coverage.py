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
Bench: how often 95 % intervals hold the truth, over simulated campaigns.

Each campaign is made in closed form (``bench/closed_form.py``), its phases are found by the
segmentation, and it is fitted like any other. Intervals are those of the standard errors (of the
logarithm) and, for the first campaigns, those of the profile likelihood. ``--out`` writes the
table in Markdown: ``OMP_NUM_THREADS=1 python3 bench/bench_coverage.py --out doc/coverage.md``.
"""

import argparse
from pathlib import Path
import time

from closed_form import Body, campaign, Cell
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.intervals import profile_intervals
import numpy as np

CASES = {
    'dough, 200 Hz, noise of correlation 0.6': (Body(), Cell()),
    'dough, 1 kHz, noise of correlation 0.9': (
        Body(),
        Cell(rate=1000.0, tool_rate=500.0, correlation=0.9),
    ),
    'springy (C1 = 40 N.s/m), 200 Hz': (Body(C1=40.0), Cell()),
    'dough, 200 Hz, no release': (Body(), Cell(release=False)),
}


def run(
    body: Body, cell: Cell, campaigns: int, profiles: int, first: int
) -> tuple[np.ndarray, ...]:
    """Return scores, shape (n, 3), and whether the profile intervals hold, shape (m, 3)."""
    scores, held = [], []
    truth = (body.K1, body.C1, body.C2)
    for seed in range(first, first + campaigns):
        result = fit(campaign(seed, 2, body, cell))
        scores.append((result.theta - body.logarithms) / np.sqrt(np.diag(result.covariance)))
        if seed < first + profiles:
            intervals = profile_intervals(result).values()
            held.append(
                [
                    (i.lower is None or i.lower <= value) and (i.upper is None or value <= i.upper)
                    for i, value in zip(intervals, truth, strict=True)
                ]
            )
    return np.array(scores), np.array(held)


def main() -> None:
    """Print the table, and write it if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--campaigns', type=int, default=400, help='campaigns a case')
    parser.add_argument('--profiles', type=int, default=400, help='of them with profiles')
    parser.add_argument('--first-seed', type=int, default=0, help='seed of the first campaign')
    parser.add_argument('--cases', nargs='+', default=list(CASES), help='which cases')
    parser.add_argument('--out', type=Path, help='file for the table')
    args = parser.parse_args()
    lines = [
        f'Share of {args.campaigns} simulated campaigns (two trials each) whose 95 % interval '
        f'holds the truth; the binomial standard error is '
        f'{100 * np.sqrt(0.05 * 0.95 / args.campaigns):.1f} %. The last column is the root mean '
        f'square of (estimate - truth) / standard error, which is 1 where the errors are right; '
        f'before it, their mean for each parameter, which is 0 where the estimates are.',
        '',
        '| case | interval | K1 | C1 | C2 | mean score of K1, C1, C2 | score |',
        '| --- | --- | --- | --- | --- | --- | --- |',
    ]
    start = time.process_time()
    for name in args.cases:
        body, cell = CASES[name]
        scores, held = run(body, cell, args.campaigns, args.profiles, args.first_seed)
        for kind, inside in (('standard error', np.abs(scores) < 1.96), ('profile', held)):
            if not inside.size:
                continue
            share = ' | '.join(f'{100 * each:.1f} %' for each in inside.mean(axis=0))
            mean = score = ''
            if kind == 'standard error':
                mean = ', '.join(f'{each:.2f}' for each in scores.mean(axis=0))
                score = f'{np.sqrt(np.mean(scores**2)):.2f}'
            lines.append(f'| {name} | {kind} | {share} | {mean} | {score} |')
            print(lines[-1], flush=True)
    spent = time.process_time() - start
    print(f'{spent:.0f} s of CPU time')
    if args.out is not None:
        args.out.write_text('# Coverage of the intervals\n\n' + '\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
