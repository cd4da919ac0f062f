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
Bench: whether the push that a diagnosis suggests tells its two candidates apart.

Campaigns of the simulated world of `bench_attribution` are cut to a few trials with short holds,
so that their diagnosis leaves sets. Where two effects of a set are to be told apart, the suggested
push is made in the same world, and in its place each push of the campaign is made again, as often
as it takes to last as long. Both candidates are refitted to the campaign with either, and compared
by how far their deviances part. A case is a line of JSON in the file `--lines`, as there;
``OMP_NUM_THREADS=1 python3 bench/bench_next_push.py --lines FILE --seeds 5 --r 0.1 0.3`` runs
every effect, ``--summary`` makes the table.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
import json
import math
from pathlib import Path
import time
import traceback
from typing import Any

from bench_attribution import CANNOT, make
from cases import carry_out, kept
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import Diagnosis
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.fit.campaign import fit_prepared
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.records import Segmentation, Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import Campaign, Push, run
from hapticvision_ros.sim.specimen import LIBRARY, Undeclared
from hapticvision_ros.sim.strengths import LinearMisfit, strength_for, undeclared
import numpy as np

OTHER_NOISE = 50_000
"""Added to the seed of a campaign for the noise of the pushes that are made after it."""
MOST_REPEATS = 6

type Pair = tuple[Trial, Segmentation]


def phased(trials: Sequence[Trial]) -> list[Pair]:
    """Return trials with their phases."""
    return [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]


def longer(campaign: Campaign, pushes: Sequence[Push]) -> Campaign:
    """Return a campaign that goes on."""
    return replace(campaign, pushes=(*campaign.pushes, *pushes))


def duration(campaign: Campaign, push: Push) -> float:
    """Return how long a push takes, from approach to recovery [s]."""
    return longer(campaign, [push]).motion(len(campaign.pushes))[1]


def parted(pairs: Sequence[Pair], found: Diagnosis, names: Sequence[str]) -> float | None:
    """Return the deviance of the second candidate less that of the first."""
    prepared, _ = prepare(pairs, windows='periodic_disturbance' in names)
    before = fit_prepared(prepared, Model())
    scatter = found.after.problem.scatter
    bench = Workbench(before.problem.trials, scatter if scatter.size else None)
    base = bench.base(before)
    # What was accepted before the set stands beside both.
    place = next(i for i, each in enumerate(found.sets) if set(names) <= set(each))
    deviances = []
    for name in names:
        refit: Refit | None = base
        for effects in (found.effects[:place], (*found.effects[:place], name)):
            for _ in range(2):
                if refit is not None and effects:
                    refit = bench.refit(Model(effects), refit)
        if refit is None:
            return None
        deviances.append(refit.deviance)
    return deviances[1] - deviances[0]


def gone_on(
    campaign: Campaign, acting: Sequence[Undeclared], pushes: Sequence[Push], seed: int
) -> list[Pair]:
    """Return the trials of pushes that follow a campaign, in noise of their own."""
    trials = run(longer(campaign, pushes), acting, seed=seed + OTHER_NOISE).trials
    made = len(campaign.pushes)
    return phased(trials[made:])


def case(task: dict[str, Any]) -> dict[str, Any]:
    """Run one case; return what came of it."""
    seed, name = task['seed'], task['effect']
    whole = make('grid', seed, 0.0)
    pushes = [
        replace(push, hold=task['cut'] * push.hold, recover=task['cut'] * push.recover)
        for push in whole.pushes[: task['trials']]
    ]
    campaign = replace(whole, pushes=tuple(pushes))
    shape = float(np.random.default_rng((seed, 5)).uniform())
    result = dict(task)
    try:
        misfit = LinearMisfit(campaign, seed=seed)
        size = strength_for(
            task['r'], name, campaign, misfit, shape=shape, seed=seed, tolerance=0.1
        )
    except (InputError, ValueError):
        return {**result, 'skipped': 'no such misfit'}
    acting = [undeclared(name, size, campaign, shape=shape)]
    start = time.perf_counter()
    try:
        pairs = phased(run(campaign, acting, seed=seed).trials)
        found = diagnose(pairs)
        result |= {'status': found.status, 'sets': [list(each) for each in found.sets]}
        push = found.next_trial
        if push is None or len(push.separates) < 2 or not set(push.separates) <= set(BY_NAME):
            return {**result, 'skipped': 'nothing to tell apart'}
        like = max(campaign.pushes, key=lambda each: each.depth)
        suggested = replace(like, speed=push.push_speed, depth=push.depth, hold=push.hold_time)
        time_ = duration(campaign, suggested)
        result |= {
            'separates': list(push.separates),
            'gain': push.gain,
            'push': [push.push_speed, push.depth, push.hold_time],
            'lasts': round(time_, 2),
            'before': parted(pairs, found, push.separates),
        }
        made = gone_on(campaign, acting, [suggested], seed)
        result['suggested'] = parted([*pairs, *made], found, push.separates)
        repeats = []
        for each in campaign.pushes:
            count = min(math.ceil(time_ / duration(campaign, each) - 0.05), MOST_REPEATS)
            made = gone_on(campaign, acting, [each] * max(count, 1), seed)
            repeats.append([max(count, 1), parted([*pairs, *made], found, push.separates)])
        result['repeats'] = repeats
    except Exception:
        return {**result, 'error': traceback.format_exc()}
    return {**result, 'seconds': round(time.perf_counter() - start, 1)}


def tasks(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the cases that are asked for."""
    names = [name for name in args.effects or LIBRARY if name not in CANNOT]
    for seed in range(args.first, args.first + args.seeds):
        for name in names:
            for r in args.r:
                for trials in args.trials:
                    yield {
                        'seed': seed,
                        'effect': name,
                        'r': r,
                        'trials': trials,
                        'cut': args.cut,
                    }


def key(task: dict[str, Any]) -> str:
    """Return what tells a case from others."""
    return json.dumps([task[k] for k in ('seed', 'effect', 'r', 'trials', 'cut')])


def leads(result: dict[str, Any]) -> tuple[float, float, list[float]] | None:
    """Return by how much the truth leads before, with the push, with each repeat; None without."""
    values = [result['before'], result['suggested'], *(d for _, d in result['repeats'])]
    if any(value is None for value in values) or result['effect'] not in result['separates']:
        return None
    sign = 1.0 if result['separates'][0] == result['effect'] else -1.0
    before, suggested, *repeats = [sign * value for value in values]
    return before, suggested, repeats


def summary(results: list[dict[str, Any]]) -> str:
    """Return the table in Markdown."""
    failed = [r for r in results if 'error' in r]
    confused = [r for r in results if 'suggested' in r and 'error' not in r]
    among = sum(leads(r) is not None for r in confused)
    lines = [
        f'{len(results)} campaigns, {len(failed)} failures, {len(confused)} with two effects to '
        f'tell apart; the true one is among the two in {among}.',
        '',
        '| r | trials | confused pairs | lead of the truth before | with the push | with a repeat '
        '| push beats a repeat | push beats the best repeat | told (lead above 10): push, repeat '
        '| obtained over promised gain: median (quartiles) |',
        '| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |',
    ]
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for r in confused:
        if leads(r) is not None:
            groups.setdefault((f'{r["r"]:g}', r['trials']), []).append(r)
            groups.setdefault(('all', 'all'), []).append(r)
    for head, of in sorted(groups.items(), key=lambda item: tuple(map(str, item[0]))):
        parts = [leads(r) for r in of]
        before = np.array([p[0] for p in parts if p])
        push = np.array([p[1] for p in parts if p])
        best = np.array([max(p[2]) for p in parts if p])
        wins = [p[1] > each for p in parts if p for each in p[2]]
        every = np.array([each for p in parts if p for each in p[2]])
        gained = np.sqrt(np.maximum(push - before, 0.0))
        ratio = gained / np.array([r['gain'] for r in of])
        low, middle, high = np.quantile(ratio, (0.25, 0.5, 0.75))
        lines.append(
            f'| {head[0]} | {head[1]} | {len(of)} | {np.median(before):.1f} '
            f'| {np.median(push):.1f} | {np.median(every):.1f} '
            f'| {100 * np.mean(wins):.0f} % | {100 * np.mean(push > best):.0f} % '
            f'| {100 * np.mean(push > 10.0):.0f} %, {100 * np.mean(every > 10.0):.0f} % '
            f'| {middle:.2f} ({low:.2f} to {high:.2f}) |'
        )
    return '\n'.join(lines)


def line(result: dict[str, Any]) -> str:
    """Return a case in a line."""
    head = f'{result["effect"]} r={result["r"]} seed {result["seed"]} of {result["trials"]}'
    if 'skipped' in result:
        return f'{head}: {result["skipped"]} {result.get("sets", "")}'
    if 'error' in result:
        return f'{head}: {result["error"].splitlines()[-1]}'
    return (
        f'{head}: {result["separates"]} gain {result["gain"]:.2g}, {result["before"]} -> '
        f'{result["suggested"]}, repeats {result["repeats"]} {result["seconds"]} s'
    )


def main() -> None:
    """Run the cases that are not in the file yet, or make the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--lines', type=Path, required=True, help='file of the cases')
    parser.add_argument('--seeds', type=int, default=1, help='campaigns an effect')
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--r', type=float, nargs='+', default=[0.1, 0.3])
    parser.add_argument('--trials', type=int, nargs='+', default=[2])
    parser.add_argument('--cut', type=float, default=0.25, help='part of hold and recovery kept')
    parser.add_argument('--effects', nargs='+', default=[])
    parser.add_argument('--summary', action='store_true')
    args = parser.parse_args()
    if args.summary:
        print(summary(kept(args.lines)))
        return
    carry_out(args.lines, tasks(args), key, case, line)


if __name__ == '__main__':
    main()
