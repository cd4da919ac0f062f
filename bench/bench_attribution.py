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
`--lines`, so that a long bench can be stopped and taken up again.
``OMP_NUM_THREADS=1 python bench/bench_attribution.py --lines FILE --plan --out PAGE``
runs `PLAN`, whatever of it is not in the file yet, and renews the tables of a page. Other runs:
``--seeds 20 --r 0.1 0.3 1`` the effects; ``--none 400`` campaigns without any; ``--outside``
effects that no library has; ``--summary`` prints the tables of a file.
"""

import argparse
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
import json
import math
from multiprocessing import get_context
from pathlib import Path
import tempfile
import time
import traceback
from typing import Any

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import Misfits
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.fit.campaign import fit_prepared
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.pipeline import analyse, analyse_campaign
from hapticvision_ros.core.records import Trial
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    peak_force,
    Push,
    random_campaign,
    Run,
    run,
    Sensors,
    write_bags,
)
from hapticvision_ros.sim.config import load_config
from hapticvision_ros.sim.offline import CloudPlan
from hapticvision_ros.sim.specimen import (
    Body,
    LAW_OF,
    LIBRARY,
    OTHER_LAWS,
    OUTSIDE,
    Undeclared,
)
from hapticvision_ros.sim.strengths import LinearMisfit, strength_for, undeclared
import numpy as np
from page import renew
from scipy.optimize import minimize_scalar

BEGIN, END = '<!-- tables of bench/bench_attribution.py -->', '<!-- end of the tables -->'
CLOUD = CloudPlan(80, 60, 3e-4)
"""Pixels, and the noise of their depth [m], of campaigns with clouds; at this rate [Hz]:"""
CLOUD_RATE = 5.0
SLOW = (0.01, 0.3)
"""Accelerations of slow arms [m/s^2]."""
STEPS = (1e-9, 1e-6, 5e-6, 2e-5)
"""Steps of the encoders of arms that move at least jerk, in turn [m]."""
EXACT = 1e-8
"""Step below which encoders have no other noise [m]."""
GOES_BACK, MOST_SWINGS = (0.2, 1.0), 4
"""Parts of the depth by which a tool goes back that goes to and fro, and how often at most."""
KINDS = {'slow': 'slow arms', 'curved': 'at least jerk', 'to_and_fro': 'to and fro'}
"""Ways of the arm that may be asked for, as the tables have them."""
NEAR = 0.1
"""Relative error of the misfit that a strength may have."""
FOLLOWED = 500.0
"""Rate at which encoders follow an arm [Hz]."""
OFFSET = 'contact_offset'
"""Makes no misfit, since the fit finds each touch: its r is a part of the greatest depth."""
LAW = 'another law'
"""What a campaign of `OTHER_LAWS` is."""
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


def make(
    world: str,
    seed: int,
    scatter: float,
    *,
    clouds: bool = False,
    slow: bool = False,
    curved: bool = False,
    to_and_fro: bool = False,
) -> Campaign:
    """Return a campaign of one of the worlds."""
    if world == 'grid':
        campaign = grid_campaign(seed, scatter)
        if clouds:
            sensors = replace(campaign.sensors, height_rate=CLOUD_RATE)
            campaign = replace(campaign, sensors=sensors)
    else:
        campaign = random_campaign(seed, scatter=scatter, longest=30.0)
    if slow:
        part = np.random.default_rng((seed, 77)).uniform()
        acceleration = SLOW[0] * (SLOW[1] / SLOW[0]) ** part
        campaign = replace(campaign, acceleration=acceleration)
    if curved:
        step = STEPS[seed % len(STEPS)]
        sensors = replace(campaign.sensors, encoder_resolution=step)
        if step < EXACT:
            sensors = replace(sensors, encoder_noise=0.0)
        campaign = replace(campaign, sensors=sensors, curved=True)
    if to_and_fro:
        random = np.random.default_rng((seed, 4))
        share, swings = random.uniform(*GOES_BACK), int(random.integers(1, MOST_SWINGS + 1))
        pushes = (replace(p, swings=swings, swing=share * p.depth) for p in campaign.pushes)
        campaign = replace(campaign, pushes=tuple(pushes))
    return campaign


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
        best = problem.search(found.state, tolerance=1e-9, max_evaluations=60)
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
    kinds = {'clouds': task['clouds'], **{kind: task.get(kind, False) for kind in KINDS}}
    campaign = make(task['world'], seed, task['scatter'], **kinds)
    shape = float(np.random.default_rng((seed, 5)).uniform())
    result = dict(task)
    acting = list[Undeclared]()
    try:
        misfit = BaseMisfit(campaign, seed) if names else None
        for name in names:
            assert misfit is not None
            size = task['r']
            if name != OFFSET:
                size = fitted_strength(task['r'], name, campaign, misfit, shape, seed)
            acting.append(undeclared(name, size, campaign, shape=shape))
        if misfit is not None and set(names) <= set(BY_NAME):
            result['known'] = misfit.known(acting, names)
    except (InputError, UsageError, ValueError):
        return {**result, 'skipped': True}
    try:
        done = run(campaign, acting, seed=seed)
        trials = read_back(done, campaign, seed) if task['clouds'] else done.trials
        start, cpu = time.perf_counter(), time.process_time()
        whole = analyse_campaign([analyse(trial) for trial in trials])
        found = whole.diagnosis
        assert found is not None
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
            [c.effect, round(c.score, 1), round(c.delta_bic, 1), round(c.strength or 0.0, 3)]
            for c in found.ranking[:6]
        ],
        'where': list(found.unexplained.where) if found.unexplained else [],
        'before': (found.before.theta[:3] - truth).tolist(),
        'after': (found.after.theta[:3] - truth).tolist(),
        'held_out': {
            when: chi2(None if model is None else model.held_out)
            for when, model in (('before', whole.before), ('after', whole.after))
        },
        'ratio': None if whole.change is None else round(whole.change.ratio, 4),
        'warnings': list(found.warnings),
        'trials': len(trials),
        'samples': found.before.samples,
        'seconds': round(time.perf_counter() - start, 2),
        'cpu': round(time.process_time() - cpu, 2),
    }
    return result


def read_back(done: Run, campaign: Campaign, seed: int) -> tuple[Trial, ...]:
    """Return trials as they are read from bags with clouds in the place of heights."""
    cell = load_config()
    cell = replace(cell, block=replace(cell.block, height=campaign.surface_height))
    with tempfile.TemporaryDirectory() as folder:
        paths = write_bags(done, Path(folder), clouds=(cell, CLOUD), seed=seed)
        return tuple(read_trial(path) for path in paths)


def chi2(misfits: Misfits | None) -> dict[str, float | None]:
    """Return the mean squared residual over the squared noise, by channel."""
    total = {} if misfits is None else misfits.total
    return {
        channel: None if one.chi2 is None else round(one.chi2, 4) for channel, one in total.items()
    }


PLAN = (
    '--world random --none 400 --first 66600',
    '--world random --scatter 0.02 --none 400 --first 48100',
    '--world grid --seeds 2 --first 464 --r 0.3 1 0.1 0.07 0.05',
    '--world grid --scatter 0.02 --seeds 2 --first 776 --r 0.3 1',
    '--world grid --pairs 20 --seeds 2 --first 674 --r 0.3',
    '--world grid --outside --seeds 2 --first 263 --r 1',
    '--world grid --clouds --seeds 1 --first 906 --r 1',
    '--world grid --laws --seeds 1 --first 981 --r 0.3 1 3',
    '--world random --slow --none 60 --first 65200',
    '--world random --curved --none 60 --first 90300',
)
"""What the page is made of."""


def tasks(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """Yield the cases that are asked for."""
    common = {'world': args.world, 'scatter': args.scatter, 'clouds': args.clouds}
    common |= {kind: True for kind in KINDS if getattr(args, kind)}
    for seed in range(args.first, args.first + args.none):
        yield {**common, 'seed': seed, 'effects': [], 'r': 0.0}
    every = OTHER_LAWS if args.laws else OUTSIDE if args.outside else LIBRARY
    chosen = [name for name in args.effects or every if name not in CANNOT]
    for seed in range(args.first, args.first + args.seeds):
        for r in args.r:
            if args.pairs:
                random = np.random.default_rng((seed, 99))
                for _ in range(args.pairs):
                    pair = random.choice(chosen, 2, replace=False)
                    yield {**common, 'seed': seed, 'effects': sorted(map(str, pair)), 'r': r}
                continue
            for name in chosen:
                yield {**common, 'seed': seed, 'effects': [name], 'r': r}


def key(task: dict[str, Any]) -> str:
    """Return what tells a case from others."""
    given = [task[k] for k in ('world', 'scatter', 'clouds', 'seed', 'effects', 'r')]
    return json.dumps([*given, *(task.get(kind, False) for kind in KINDS)])


def parser() -> argparse.ArgumentParser:
    """Return what a run, or a part of the plan, is asked for with."""
    made = argparse.ArgumentParser(description=__doc__)
    made.add_argument('--lines', type=Path, help='file of the cases')
    made.add_argument('--world', choices=('grid', 'random'), default='grid')
    made.add_argument('--scatter', type=float, default=0.0, help='of K1, C1, C2, such as 0.02')
    made.add_argument('--clouds', action='store_true', help='through bags with clouds (grid)')
    made.add_argument('--slow', action='store_true', help='arms of 0.01 to 0.3 m/s^2')
    made.add_argument(
        '--curved', action='store_true', help='arms at least jerk, encoders of 1 nm to 20 um'
    )
    made.add_argument(
        '--to-and-fro', action='store_true', help='tools that go back, and down again'
    )
    made.add_argument('--none', type=int, default=0, help='campaigns without an effect')
    made.add_argument('--seeds', type=int, default=0, help='campaigns an effect')
    made.add_argument('--first', type=int, default=0, help='first seed')
    made.add_argument('--r', type=float, nargs='+', default=[0.3])
    made.add_argument('--effects', nargs='+', default=[])
    made.add_argument('--outside', action='store_true', help='effects outside the library')
    made.add_argument('--laws', action='store_true', help='effects by other laws')
    made.add_argument('--pairs', type=int, default=0, help='random pairs a seed')
    made.add_argument('--workers', type=int, default=1)
    made.add_argument('--plan', action='store_true', help='all that the page is made of')
    made.add_argument('--part', type=int, nargs='+', help='of the plan, from 0')
    made.add_argument('--summary', action='store_true', help='tables of the file')
    made.add_argument('--out', type=Path, help='page whose tables are renewed')
    return made


def main() -> None:
    """Run the cases that are not in the file yet, and make the tables."""
    args = parser().parse_args()
    if args.lines is None:
        raise SystemExit('--lines FILE: where are the cases to be kept?')
    wanted = list(tasks(args))
    if args.plan:
        parts = [PLAN[k] for k in args.part] if args.part else PLAN
        wanted = [task for part in parts for task in tasks(parser().parse_args(part.split()))]
    results = []
    if args.lines.exists():
        results = [json.loads(line) for line in args.lines.read_text().splitlines()]
    done = {key(result) for result in results}
    todo = [task for task in wanted if key(task) not in done]
    if not args.summary and todo:
        with get_context('spawn').Pool(args.workers) as pool, args.lines.open('a') as file:
            for count, result in enumerate(pool.imap_unordered(case, todo), start=1):
                file.write(json.dumps(result) + '\n')
                file.flush()
                results.append(result)
                print(f'{count}/{len(todo)} {line(result)}', flush=True)
    if args.summary or args.out:
        text = summary(results)
        print(text)
        if args.out:
            renew(args.out, BEGIN, END, text)


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
    """
    Whether a case came out right: each effect in a set of at most `most`, or none found.

    An effect that the answer lists as not testable is told where nothing else is named for it.
    """
    if not result['effects']:
        return bool(result['status'] == 'none')
    if set(result['effects']) <= set(OUTSIDE):
        return result['status'] in ('unexplained', 'partly_explained')
    shown = [name for name in names(result) if name not in result['not_testable']]
    if len(shown) < len(names(result)) and any(
        not set(each) & set(shown) for each in result['sets']
    ):
        return False
    return all(
        any(name in each and len(each) <= most for each in result['sets']) for name in shown
    )


def names(result: dict[str, Any]) -> list[str]:
    """Return what the acting effects are called, by whatever law they act."""
    return [LAW_OF.get(name, name) for name in result['effects']]


def kind(result: dict[str, Any]) -> str:
    """Return what sort of campaign it is."""
    if not result['effects']:
        return 'none'
    if set(result['effects']) <= set(OUTSIDE):
        return 'outside'
    if set(result['effects']) <= set(OTHER_LAWS):
        return LAW
    return 'pair' if len(result['effects']) > 1 else 'one'


def percent(flags: Iterable[bool]) -> str:
    """Return how many are true."""
    listed = list(flags)
    return f'{100.0 * sum(listed) / len(listed):.0f} % ({sum(listed)} of {len(listed)})'


def median(values: Iterable[float | None], form: str) -> str:
    """Return the median of what is known."""
    known = [value for value in values if value is not None]
    return format(float(np.median(known)), form) if known else '-'


def rates(results: list[dict[str, Any]]) -> list[str]:
    """Return a row for each kind of campaign."""
    rows = [
        '| world | campaigns | r | right, alone or in a set of two | in a set | something found '
        '| single names right | K1, C1, C2 off, before and after | held-out chi2 of the force, '
        'before and after | of the height | CPU time |',
        '| --- ' * 11 + '|',
    ]
    groups: dict[tuple[Any, ...], list[dict[str, Any]]] = {}
    for r in results:
        world = ', '.join([r['world'], *(told for way, told in KINDS.items() if r.get(way))])
        groups.setdefault((world, r['clouds'], r['scatter'], kind(r), r['r']), []).append(r)
    for (world, clouds, scatter, what, size), of in sorted(groups.items()):
        singles = [each[0] in names(r) for r in of for each in r['sets'] if len(each) == 1]
        traced = what in ('one', 'pair', LAW)
        named = bool(singles) and traced
        good = [r for r in of if traced and right(r)]
        cells = [
            f'{world}{", clouds" if clouds else ""}{f", scatter {scatter:g}" if scatter else ""}',
            what,
            f'{size:g}' if what != 'none' else '-',
            percent(right(r) for r in of),
            percent(right(r, 20) for r in of) if traced else '-',
            percent(r['status'] != 'none' for r in of),
            percent(singles) if named else '-',
            ' to '.join(
                median((100 * max(map(abs, r[when])) for r in good), '.1f')
                for when in ('before', 'after')
            )
            + ' %',
            *(
                ' to '.join(
                    median((r['held_out'][when].get(channel) for r in good), '.2f')
                    for when in ('before', 'after')
                )
                for channel in ('force', 'height')
            ),
            median((r['cpu'] for r in of), '.1f') + ' s',
        ]
        rows.append(f'| {" | ".join(cells if good else [*cells[:7], "-", "-", "-", cells[10]])} |')
    return rows


def confusion(results: list[dict[str, Any]], r: float) -> list[str]:
    """Return a row for each acting effect: how often it is named, and what is named instead."""
    rows = [
        f'| acting (r = {r:g}) | campaigns | alone | in a set of two | in a larger set | nothing '
        'named, as not testable | nothing named otherwise | other names given alone |',
        '| --- ' * 8 + '|',
    ]
    for name in (*LIBRARY, *OTHER_LAWS):
        of = [each for each in results if each['effects'] == [name] and each['r'] == r]
        effect = LAW_OF.get(name, name)
        sizes = [min((len(s) for s in each['sets'] if effect in s), default=0) for each in of]
        singles = [s[0] for each in of for s in each['sets'] if len(s) == 1]
        others = Counter(single for single in singles if single != effect)
        told = ', '.join(f'{other} {count}' for other, count in others.most_common()) or '-'
        cells = [
            sizes.count(1),
            sizes.count(2),
            sum(size > 2 for size in sizes),
            sum(not each['sets'] and name in each['not_testable'] for each in of),
            sum(not each['sets'] and name not in each['not_testable'] for each in of),
        ]
        if of:
            rows.append(f'| {name} | {len(of)} | {" | ".join(map(str, cells))} | {told} |')
    return rows


def threshold(found: Sequence[tuple[float, bool]]) -> str:
    """Return the r at which half are found, by a logistic curve in its logarithm."""
    r, hit = (np.array(one, dtype=float) for one in zip(*found, strict=True))
    if hit.all():
        return f'below {r.min():.3g}'
    if not hit.any():
        return f'above {r.max():.3g}'

    def cost(middle: float) -> float:
        rise = (np.log(r) - middle) / STEEP
        return float(np.sum(np.logaddexp(0.0, np.where(hit > 0.5, -rise, rise))))

    bounds = (math.log(0.5 * r.min()), math.log(2.0 * r.max()))
    return f'{math.exp(minimize_scalar(cost, bounds=bounds, method="bounded").x):.3f}'


STEEP = 0.25
"""Scale of that curve: from an eighth to seven eighths are found in a factor of 2.6 of r."""


def thresholds(results: list[dict[str, Any]]) -> list[str]:
    """Return a row for each effect: from which misfit on it is found, and named."""
    rows = [
        '| acting | campaigns | half are found at r = | half are named, alone or in a set of two, '
        'at r = |',
        '| --- | --- | --- | --- |',
    ]
    meant: tuple[Callable[[dict[str, Any]], bool], ...] = (
        lambda each: bool(each['status'] != 'none'),
        right,
    )
    for name in LIBRARY:
        of = [each for each in results if each['effects'] == [name]]
        if of:
            cells = [threshold([(each['r'], one(each)) for each in of]) for one in meant]
            rows.append(f'| {name} | {len(of)} | {" | ".join(cells)} |')
    return rows


def outside(results: list[dict[str, Any]]) -> list[str]:
    """Return a row for each effect that no library has."""
    rows = ['| acting | answers | named | look-alikes |', '| --- | --- | --- | --- |']
    for name in OUTSIDE:
        of = [each for each in results if each['effects'] == [name]]
        if of:
            answers = Counter(each['status'] for each in of)
            named = Counter(s[0] for each in of for s in each['sets'])
            alike = Counter(f'{b} for {a}' for each in of for a, b, _ in each['look_alikes'])
            told = (', '.join(f'{k} {n}' for k, n in one.items()) for one in (answers, named))
            rows.append(f'| {name} | {" | ".join(told)} | {", ".join(alike) or "-"} |')
    return rows


def summary(results: list[dict[str, Any]]) -> str:
    """Return the tables in Markdown."""
    failed = sum('error' in r for r in results)
    results = [r for r in results if 'skipped' not in r and 'error' not in r]
    others = ('scatter', 'clouds', *KINDS)
    plain = [
        r for r in results if r['world'] == 'grid' and not any(r.get(each) for each in others)
    ]
    parts = [[f'{len(results)} campaigns, {failed} failures.'], rates(results)]
    parts += [
        confusion(plain, r) for r in (0.1, 0.3, 1.0) if any(each['r'] == r for each in plain)
    ]
    if any(kind(r) == 'one' for r in plain):
        parts.append(thresholds(plain))
    if any(kind(r) == 'outside' for r in plain):
        parts.append(outside(plain))
    return '\n\n'.join('\n'.join(part) for part in parts) + '\n'


if __name__ == '__main__':
    main()
