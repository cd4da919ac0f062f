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
Bench: how often the closed loop names the effect that made the data.

Campaigns come from the simulated world (`hapticvision_ros.sim.campaigns`), whose integrator is its
own, and are diagnosed without a word of what acts in them. A case is a line of JSON in the file
`--lines`, so that a long bench can be stopped and taken up again; ``--summary`` makes the tables.
``OMP_NUM_THREADS=1 python3 bench/bench_attribution.py --lines FILE --seeds 20 --r 0.1 0.3 1`` runs
the effects; ``--none 400`` campaigns without any; ``--outside`` effects that no library has.
"""

import argparse
from collections.abc import Iterator, Sequence
from dataclasses import replace
import json
import math
from multiprocessing import get_context
from pathlib import Path
import time
import traceback
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.fit.campaign import fit_prepared
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    peak_force,
    Push,
    random_campaign,
    run,
    Sensors,
)
from hapticvision_ros.sim.specimen import Body, LIBRARY, OUTSIDE, Undeclared
from hapticvision_ros.sim.strengths import LinearMisfit, strength_for, undeclared
import numpy as np

NEAR = 0.1
"""Relative error of the misfit that a strength may have."""
FOLLOWED = 500.0
"""Rate at which encoders follow an arm [Hz]."""
CANNOT = {'force_saturation', 'force_quantisation'}
"""Outside effects that are not smooth enough to be scaled to a misfit."""


def grid_campaign(seed: int, scatter: float) -> Campaign:
    """Return six trials: two speeds by three depths, or with scatter three pushes twice."""
    random = np.random.default_rng((seed, 17))
    relaxation = math.exp(random.uniform(math.log(1.0), math.log(20.0)))
    share = random.uniform(0.2, 0.6)
    depth = random.uniform(0.003, 0.008)
    hold = min(max(1.5 * relaxation, 6.0), 20.0)
    recover = min(max(2.0 * share * relaxation, 4.0), 12.0)
    grid = [(0.002, 0.4), (0.008, 1.0), (0.002, 0.7), (0.008, 0.7), (0.002, 1.0), (0.008, 0.4)]
    if scatter:
        grid = [(0.002, 1.0), (0.008, 0.6), (0.008, 1.0)] * 2
    pushes = tuple(Push(v, depth * d, hold, recover) for v, d in grid)
    K1 = math.exp(random.uniform(math.log(300.0), math.log(5000.0)))
    body = Body(K1, share * K1 * relaxation, (1.0 - share) * K1 * relaxation)
    quiet = Sensors(ForceNoise(0.0), 0.0)
    force = peak_force(Campaign(body, pushes, quiet))
    correlation = (0.0, 0.6, 0.9)[seed % 3]
    rate = (250.0, 500.0)[seed % 2]
    noise = ForceNoise(0.005 * force)
    if correlation:
        noise = ForceNoise(0.0, 0.005 * force, -1.0 / rate / math.log(correlation))
    sensors = Sensors(
        noise, 0.005 * depth, force_rate=rate, tool_rate=250.0, force_zero=0.02 * force
    )
    return Campaign(
        body, pushes, sensors, scatter=scatter, surface_scatter=5e-5 if scatter else 1e-5
    )


def make(world: str, seed: int, scatter: float) -> Campaign:
    """Return a campaign of one of the worlds."""
    if world == 'grid':
        return grid_campaign(seed, scatter)
    return random_campaign(seed, scatter=scatter, longest=30.0)


class BaseMisfit:
    """
    The misfit of the base model, at its best, to what trials are without noise.

    To first order it is a `LinearMisfit`; a fit may go further. How the encoders follow the arm is
    no matter of the model: the trials are those of `campaign`, in which they do.
    """

    def __init__(self, campaign: Campaign, seed: int) -> None:
        sensors = campaign.sensors
        rate = max(sensors.force_rate, FOLLOWED)
        self.campaign = replace(campaign, sensors=replace(sensors, tool_rate=rate))
        self._seed = seed
        self._none = 0.0
        self._none = self(run(self.campaign, seed=seed, ideal=True).trials)

    def __call__(self, trials: tuple[Trial, ...]) -> float:
        """Return the misfit of the noise-free run over the noise, less that without an effect."""
        squares, samples = self.left(trials, ())
        return math.sqrt(max(squares / samples - self._none**2, 0.0))

    def left(
        self, trials: tuple[Trial, ...], effects: tuple[str, ...], *, memory: bool = False
    ) -> tuple[float, float]:
        """
        Return the squares that a model leaves at its best, over the variance; the samples.

        With the memory of the noise, the squares are those of what is whitened by it.
        """
        prepared, _ = prepare(
            [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
        )
        found = fit_prepared(prepared, Model(effects))
        problem, sensors = found.problem, self.campaign.sensors
        force = remembering(sensors.force_noise) if memory else white(sensors.force_noise.std)
        problem.set_noise(force, white(sensors.height_noise))
        best = minimise(
            problem.evaluate, found.state, problem.bounds, tolerance=1e-9, max_evaluations=60
        )
        samples = sum(float(t.force_count.sum() + t.height_count.sum()) for t in problem.trials)
        return best.cost, samples

    def known(self, acting: Sequence[Undeclared], names: Sequence[str]) -> dict[str, float]:
        """Return, for each effect, the squares that it takes out beside the others at its best."""
        trials = run(self.campaign, acting, seed=self._seed, ideal=True).trials
        whole = self.left(trials, tuple(names), memory=True)[0]
        gains = {}
        for name in names:
            others = tuple(other for other in names if other != name)
            gains[name] = round(self.left(trials, others, memory=True)[0] - whole, 1)
        return gains


def remembering(noise: ForceNoise) -> SensorNoise:
    """Return the noise of a load cell as it is."""
    return SensorNoise(
        max(noise.white, 1e-3 * noise.std),
        noise.coloured,
        noise.correlation_time,
        noise.slow,
        noise.slow_time,
    )


def white(std: float) -> SensorNoise:
    """Return noise without a memory."""
    return SensorNoise(std, 0.0, 1.0)


def fitted_strength(
    r: float, name: str, campaign: Campaign, fitted: BaseMisfit, shape: float, seed: int
) -> float:
    """Return the strength at which the base model, at its best, misses by r times the noise."""
    linear = LinearMisfit(campaign, seed=seed)
    options: dict[str, Any] = {'shape': shape, 'seed': seed, 'tolerance': NEAR}
    start = strength_for(r, name, campaign, linear, **options)
    return strength_for(r, name, fitted.campaign, fitted, start=start, **options)


def case(task: dict[str, Any]) -> dict[str, Any]:
    """Run one case; return what came of it."""
    seed, names = task['seed'], task['effects']
    campaign = make(task['world'], seed, task['scatter'])
    shape = float(np.random.default_rng((seed, 5)).uniform())
    result = dict(task)
    acting = list[Undeclared]()
    try:
        misfit = BaseMisfit(campaign, seed) if names else None
        for name in names:
            assert misfit is not None
            size = fitted_strength(task['r'], name, campaign, misfit, shape, seed)
            acting.append(undeclared(name, size, campaign, shape=shape))
        if misfit is not None and set(names) <= set(BY_NAME):
            result['known'] = misfit.known(acting, names)
    except (InputError, UsageError, ValueError):
        return {**result, 'skipped': True}
    try:
        trials = run(campaign, acting, seed=seed).trials
        start, cpu = time.perf_counter(), time.process_time()
        segmented = [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
        found = diagnose(segmented)
    except Exception:
        return {**result, 'error': traceback.format_exc()}
    body = campaign.body
    truth = np.log([body.K1, body.C1, body.C2])
    result |= {
        'status': found.status,
        'sets': [list(each) for each in found.sets],
        'not_testable': list(found.not_testable),
        'look_alikes': [[a, b, round(c, 3)] for a, b, c in found.look_alikes],
        'ranking': [
            [c.effect, round(c.score, 1), round(c.delta_bic, 1), round(c.strength, 3)]
            for c in found.ranking[:6]
        ],
        'where': list(found.unexplained.where) if found.unexplained else [],
        'before': (found.before.theta[:3] - truth).tolist(),
        'after': (found.after.theta[:3] - truth).tolist(),
        'warnings': list(found.warnings),
        'trials': len(trials),
        'samples': found.before.samples,
        'seconds': round(time.perf_counter() - start, 2),
        'cpu': round(time.process_time() - cpu, 2),
    }
    return result


def tasks(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the cases that are asked for."""
    common = {'world': args.world, 'scatter': args.scatter}
    for seed in range(args.first, args.first + args.none):
        yield {**common, 'seed': seed, 'effects': [], 'r': 0.0}
    names = args.effects or [*(OUTSIDE if args.outside else LIBRARY)]
    names = [name for name in names if name not in CANNOT]
    for seed in range(args.first, args.first + args.seeds):
        for r in args.r:
            if args.pairs:
                random = np.random.default_rng((seed, 99))
                for _ in range(args.pairs):
                    pair = random.choice(names, 2, replace=False)
                    yield {**common, 'seed': seed, 'effects': sorted(map(str, pair)), 'r': r}
                continue
            for name in names:
                yield {**common, 'seed': seed, 'effects': [name], 'r': r}


def key(task: dict[str, Any]) -> str:
    """Return what tells a case from others."""
    return json.dumps([task[k] for k in ('world', 'scatter', 'seed', 'effects', 'r')])


def main() -> None:
    """Run the cases that are not in the file yet, or make the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--lines', type=Path, required=True, help='file of the cases')
    parser.add_argument('--world', choices=('grid', 'random'), default='grid')
    parser.add_argument('--scatter', type=float, default=0.0, help='of K1, C1, C2, such as 0.02')
    parser.add_argument('--none', type=int, default=0, help='campaigns without an effect')
    parser.add_argument('--seeds', type=int, default=0, help='campaigns an effect')
    parser.add_argument('--first', type=int, default=0, help='first seed')
    parser.add_argument('--r', type=float, nargs='+', default=[0.3])
    parser.add_argument('--effects', nargs='+', default=[])
    parser.add_argument('--outside', action='store_true', help='effects outside the library')
    parser.add_argument('--pairs', type=int, default=0, help='random pairs a seed')
    parser.add_argument('--workers', type=int, default=1)
    parser.add_argument('--summary', action='store_true')
    args = parser.parse_args()
    if args.summary:
        print(summary([json.loads(line) for line in args.lines.read_text().splitlines()]))
        return
    done = set()
    if args.lines.exists():
        done = {key(json.loads(line)) for line in args.lines.read_text().splitlines()}
    todo = [task for task in tasks(args) if key(task) not in done]
    with get_context('spawn').Pool(args.workers) as pool, args.lines.open('a') as file:
        for count, result in enumerate(pool.imap_unordered(case, todo), start=1):
            file.write(json.dumps(result) + '\n')
            file.flush()
            print(f'{count}/{len(todo)} {line(result)}', flush=True)


def line(result: dict[str, Any]) -> str:
    """Return a case in a line."""
    name = '+'.join(result['effects']) or 'none'
    head = f'{name} r={result["r"]} seed {result["seed"]}'
    if 'skipped' in result:
        return f'{head}: no such misfit'
    if 'error' in result:
        return f'{head}: {result["error"].splitlines()[-1]}'
    mark = 'ok' if right(result) else 'BAD'
    return (
        f'{head}: {mark} {result["status"]} {result["sets"]} {result["ranking"][:2]} '
        f'{result["where"][:1]} {result["cpu"]} s'
    )


def right(result: dict[str, Any], most: int = 2) -> bool:
    """Whether a case came out right: each effect in a set of at most `most`, or none found."""
    if not result['effects']:
        return bool(result['status'] == 'none')
    if set(result['effects']) <= set(OUTSIDE):
        return result['status'] in ('unexplained', 'partly_explained')
    return all(
        any(name in each and len(each) <= most for each in result['sets'])
        for name in result['effects']
    )


def summary(results: list[dict[str, Any]]) -> str:
    """Return the tables in Markdown."""
    results = [r for r in results if 'skipped' not in r]
    failed = [r for r in results if 'error' in r]
    results = [r for r in results if 'error' not in r]
    lines = [f'{len(results)} campaigns, {len(failed)} failures.', '']
    lines += [
        '| world | scatter | effects | r | n | right (set of at most 2) | detected | single names '
        'right / given | median size of set | bias of K1, C1, C2 before -> after | median time |',
        '| --- | --- | --- | --- | --- | --- | --- | --- | --- | --- | --- |',
    ]
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for r in results:
        kind = (
            'none'
            if not r['effects']
            else (
                'outside'
                if set(r['effects']) <= set(OUTSIDE)
                else ('pair' if len(r['effects']) > 1 else 'one')
            )
        )
        groups.setdefault((r['world'], r['scatter'], kind, r['r']), []).append(r)
        if kind in ('one', 'outside'):
            groups.setdefault(
                (r['world'], r['scatter'], f'{kind}: {r["effects"][0]}', r['r']), []
            ).append(r)
    for head, of in sorted(groups.items(), key=lambda item: tuple(map(str, item[0]))):
        singles = [(r, each[0]) for r in of for each in r['sets'] if len(each) == 1]
        good = sum(name in r['effects'] for r, name in singles)
        before = 100 * float(np.median([np.abs(r['before']).max() for r in of]))
        after = 100 * float(np.median([np.abs(r['after']).max() for r in of]))
        sizes = [len(each) for r in of for each in r['sets']]
        lines.append(
            f'| {head[0]} | {head[1]:g} | {head[2]} | {head[3]:g} | {len(of)} '
            f'| {100 * np.mean([right(r) for r in of]):.0f} % '
            f'| {100 * np.mean([r["status"] != "none" for r in of]):.0f} % '
            f'| {good} / {len(singles)} '
            f'| {np.median(sizes) if sizes else 0:g} | {before:.1f} -> {after:.1f} % '
            f'| {np.median([r["seconds"] for r in of]):.1f} s |'
        )
    return '\n'.join(lines)


if __name__ == '__main__':
    main()
