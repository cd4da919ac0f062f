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
Bench: how often an autonomous experiment decides for the effect that acts.

The loop of `doc/autonomous.md` without ROS: the simulated world, whose integrator is its own,
makes a grid of one or two short pushes of one depth; the trials, and nothing else, are diagnosed;
`decide` chooses the next push; the world makes it, until the end. A case is a line of JSON in the
file `--lines`, so that a long bench can be stopped and taken up again;
``--summary`` makes the table.
``OMP_NUM_THREADS=1 python bench/bench_autonomy.py --lines FILE --seeds 2 --none 4`` runs all.
"""

import argparse
from collections.abc import Iterator
from dataclasses import fields, replace
import json
import math
from pathlib import Path
import time
import traceback
from typing import Any

from bench_attribution import BaseMisfit, fitted_strength
from cases import carry_out, kept
from hapticvision_ros.core.autonomy import (
    Budget,
    Cell,
    decide,
    Decision,
    Ending,
    Findings,
    look,
    Push,
    Spent,
)
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.push_control import PushGoal, PushLimits
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, peak_force, run, Sensors
from hapticvision_ros.sim.campaigns import Push as MadePush
from hapticvision_ros.sim.specimen import Body, Undeclared
from hapticvision_ros.sim.strengths import undeclared
import numpy as np
import yaml

ARM = Path(__file__).resolve().parents[1] / 'config' / 'arm_push_controller.yaml'
EFFECTS = (
    'yield_force',
    'parallel_spring',
    'second_retardation',
    'springpot',
    'shear_thinning',
    'strain_stiffening',
    'contact_growth',
    'adhesion',
)
SPEEDS = (0.004, 0.008)
HOLD = RECOVER = 2.0
REFERENCE = [(0.002, 0.4), (0.008, 1.0), (0.002, 0.7), (0.008, 0.7), (0.002, 1.0), (0.008, 0.4)]
"""Speeds [m/s] and shares of the depth of the campaign by which the strength is measured."""
REFERENCE_HOLD = 6.0
DONE = (Ending.DECIDED.value, Ending.TIGHT.value)


def campaign_of(seed: int, speeds: int, scatter: float) -> Campaign:
    """Return the grid on a body of chance: some speeds at one depth, short holds."""
    random = np.random.default_rng((seed, 29))
    relaxation = math.exp(random.uniform(math.log(1.0), math.log(5.0)))
    share = random.uniform(0.2, 0.6)
    depth = random.uniform(0.003, 0.008)
    K1 = math.exp(random.uniform(math.log(300.0), math.log(5000.0)))
    body = Body(K1, share * K1 * relaxation, (1.0 - share) * K1 * relaxation)
    pushes = tuple(MadePush(speed, depth, HOLD, RECOVER) for speed in SPEEDS[:speeds])
    force = peak_force(Campaign(body, pushes, Sensors(ForceNoise(0.0), 0.0)))
    sensors = Sensors(
        ForceNoise(0.005 * force),
        0.005 * depth,
        force_rate=250.0,
        tool_rate=250.0,
        force_zero=0.02 * force,
    )
    return Campaign(
        body, pushes, sensors, scatter=scatter, surface_scatter=5e-5 if scatter else 1e-5
    )


def reference(campaign: Campaign) -> Campaign:
    """Return a campaign on the same body that tells effects apart."""
    depth = campaign.pushes[0].depth
    pushes = (MadePush(v, depth * share, REFERENCE_HOLD, RECOVER) for v, share in REFERENCE)
    return replace(campaign, pushes=tuple(pushes), scatter=0.0)


def cell_of(campaign: Campaign) -> Cell:
    """Return what the shipped arm and the grid allow."""
    arm = yaml.safe_load(ARM.read_text())['/**']['ros__parameters']
    goal = {each.name: arm[each.name] for each in fields(PushGoal) if each.name in arm}
    depth = campaign.pushes[0].depth
    return Cell(
        limits=PushLimits(**{each.name: arm[each.name] for each in fields(PushLimits)}),
        usual=PushGoal(**goal | {'depth': depth, 'hold_time': HOLD, 'recover_time': RECOVER}),
        slowest=min(each.speed for each in campaign.pushes),
        fastest=max(each.speed for each in campaign.pushes),
        deepest=depth,
        longest_hold=HOLD,
    )


def made(push: Push, so_far: tuple[MadePush, ...]) -> MadePush:
    """Return what the arm makes of a push that was chosen."""
    if push.like is not None:
        return so_far[push.like]
    return MadePush(push.push_speed, push.depth, push.hold_time, RECOVER)


def loop(
    campaign: Campaign, acting: list[Undeclared], seed: int, budget: Budget
) -> tuple[list[Findings], list[Push], Decision]:
    """Carry out an autonomous experiment; return all findings, all pushes and the end."""
    cell = cell_of(campaign)
    found, pushes = list[Findings](), list[Push]()
    while True:
        # A trial's noise goes by its place: those made before come out as they were.
        trials = run(campaign, acting, seed=seed).trials
        before = found[-1] if found else None
        found.append(look(trials, cell))
        decision = decide(found[-1], budget, Spent(tuple(pushes), 0.0, before), lambda push: 0.0)
        if decision.push is None:
            return found, pushes, decision
        pushes.append(decision.push)
        campaign = replace(
            campaign, pushes=(*campaign.pushes, made(decision.push, campaign.pushes))
        )


def case(task: dict[str, Any]) -> dict[str, Any]:
    """Run one case; return what came of it."""
    seed, name = task['seed'], task['effect']
    campaign = campaign_of(seed, task['grid'], task['scatter'])
    result = dict(task)
    acting = list[Undeclared]()
    if name:
        shape = float(np.random.default_rng((seed, 5)).uniform())
        try:
            whole = reference(campaign)
            size = fitted_strength(task['r'], name, whole, BaseMisfit(whole, seed), shape, seed)
            acting.append(undeclared(name, size, whole, shape=shape))
        except (InputError, UsageError, ValueError):
            return {**result, 'skipped': True}
    start, cpu = time.perf_counter(), time.process_time()
    budget = Budget(trials=task['budget'], precision=task['precision'])
    try:
        found, pushes, end = loop(campaign, acting, seed, budget)
    except Exception:
        return {**result, 'error': traceback.format_exc()}
    assert end.ending is not None
    return result | {
        'ending': end.ending.value,
        'reason': end.reason,
        'found': [[each.status, [list(alike) for alike in each.sets]] for each in found],
        'pushes': [
            [each.purpose, each.push_speed, each.depth, each.hold_time, round(each.gain, 2)]
            for each in pushes
        ],
        'rest': list(found[-1].rest[:2]),
        'warnings': list(found[-1].warnings),
        'seconds': round(time.perf_counter() - start, 1),
        'cpu': round(time.process_time() - cpu, 1),
    }


def tasks(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the cases that are asked for."""
    names = ('grid', 'scatter', 'budget', 'precision')
    common = {name: getattr(args, name) for name in names}
    for seed in range(args.first, args.first + args.none):
        yield {**common, 'seed': seed, 'effect': '', 'r': 0.0}
    for seed in range(args.first, args.first + args.seeds):
        for name in args.effects:
            yield {**common, 'seed': seed, 'effect': name, 'r': args.r}


def key(task: dict[str, Any]) -> str:
    """Return what tells a case from others."""
    return json.dumps(
        [task[k] for k in ('seed', 'effect', 'r', 'grid', 'scatter', 'budget', 'precision')]
    )


def verdict(result: dict[str, Any]) -> str:
    """Return what an experiment came to: `right`, `missed`, `wrong` only where it was decided."""
    if result['ending'] not in DONE:
        return str(result['ending'])
    sets = result['found'][-1][1]
    wanted = [[result['effect']]] if result['effect'] else []
    if sets == wanted:
        return 'right'
    return 'wrong' if sets else 'missed'


def named(result: dict[str, Any], place: int) -> str:
    """Return what was found after some pushes, in words."""
    status, sets = result['found'][place]
    text = ' and '.join('{' + ', '.join(alike) + '}' if alike[1:] else alike[0] for alike in sets)
    return text + (
        ', and a rest' if status.endswith('explained') and status != 'explained' else ''
    )


def line(result: dict[str, Any]) -> str:
    """Return a case in a line."""
    head = f'{result["effect"] or "none"} seed {result["seed"]}'
    if 'skipped' in result:
        return f'{head}: no such misfit'
    if 'error' in result:
        return f'{head}: {result["error"].splitlines()[-1]}'
    return (
        f'{head}: {verdict(result)}; {len(result["pushes"])} pushes; grid: '
        f'{named(result, 0) or "none"}; end: {named(result, -1) or "none"}; {result["cpu"]} s'
    )


def summary(results: list[dict[str, Any]]) -> str:
    """Return the tables in Markdown."""
    skipped = sum('skipped' in each for each in results)
    failed = sum('error' in each for each in results)
    results = [each for each in results if 'ending' in each]
    lines = [
        f'{len(results)} experiments, {failed} failures, {skipped} without such a strength.',
        '',
        '| acting | n | decided, right | decided that nothing acts | decided, wrong '
        '| budget spent | other end | right after the grid | chosen pushes, median (most) |',
        '| --- | --- | --- | --- | --- | --- | --- | --- | --- |',
    ]
    names = list(dict.fromkeys(each['effect'] for each in results))
    for name in [*names, None]:
        of = [each for each in results if name is None or each['effect'] == name]
        said = [verdict(each) for each in of]
        spent = said.count(Ending.BUDGET.value)
        right, missed, wrong = (said.count(each) for each in ('right', 'missed', 'wrong'))
        first = sum(
            each['found'][0][1] == ([[each['effect']]] if each['effect'] else []) for each in of
        )
        counts = [len(each['pushes']) for each in of]
        lines.append(
            f'| {"all" if name is None else name or "nothing"} | {len(of)} | {right} | {missed} '
            f'| {wrong} | {spent} | {len(of) - right - missed - wrong - spent} | {first} '
            f'| {np.median(counts):g} ({max(counts)}) |'
        )
    lines += ['', *(f'- {line(each)}' for each in results if verdict(each) != 'right')]
    return '\n'.join(lines)


def main() -> None:
    """Run the cases that are not in the file yet, or make the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--lines', type=Path, required=True, help='file of the cases')
    parser.add_argument('--none', type=int, default=0, help='experiments without an effect')
    parser.add_argument('--seeds', type=int, default=0, help='experiments an effect')
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument(
        '--r', type=float, default=1.0, help='misfit of the base model over the noise'
    )
    parser.add_argument('--effects', nargs='+', default=EFFECTS)
    parser.add_argument('--grid', type=int, choices=(1, 2), default=2, help='pushes of the grid')
    parser.add_argument('--scatter', type=float, default=0.0, help='of K1, C1, C2, such as 0.02')
    parser.add_argument('--budget', type=int, default=6, help='pushes after the grid')
    parser.add_argument('--precision', type=float, default=0.0)
    parser.add_argument('--summary', action='store_true')
    args = parser.parse_args()
    if args.summary:
        print(summary(kept(args.lines)))
        return
    carry_out(args.lines, tasks(args), key, case, line)


if __name__ == '__main__':
    main()
