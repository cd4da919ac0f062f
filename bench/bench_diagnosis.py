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
How long the diagnosis of six trials of 130 s at 1 kHz takes, with one process and with two.

Each is made in a process of its own that has compiled everything and seen none of the trials: what
one diagnosis has kept of their tool's way another would not have to find again.

``OMP_NUM_THREADS=1 python bench/bench_diagnosis.py``; with ``--bootstrap 50`` also the bootstrap
of the first of them, with two processes; with ``--curved 1e-5`` by an arm at least jerk.
"""

import argparse
from dataclasses import replace
from multiprocessing import get_context
from multiprocessing.queues import SimpleQueue
import resource
import time

from hapticvision_ros.core.diagnosis.bootstrap import bootstrap
from hapticvision_ros.core.diagnosis.search import diagnose
from hapticvision_ros.core.fit.campaign import Segmented
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, peak_force, Push, run, Sensors
from hapticvision_ros.sim.specimen import Body
from hapticvision_ros.sim.strengths import undeclared

BODY = Body(2000.0, 1600.0, 2400.0)
PUSHES = tuple(
    Push(speed, depth, 60.0, 60.0)
    for depth, speed in ((0.004, 0.002), (0.008, 0.008), (0.006, 0.002))
    for speed in (speed, 0.01 - speed)
)
ACTING = ((), ('yield_force', 0.004), ('springpot', 0.01))
"""Effects by name and strength."""


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--bootstrap', type=int, default=0, metavar='N', help='campaigns')
    parser.add_argument(
        '--curved', type=float, metavar='STEP', help='an arm at least jerk, its encoders in steps'
    )
    args = parser.parse_args()
    peak = peak_force(Campaign(BODY, PUSHES, Sensors(ForceNoise(0.0), 0.0)))
    sensors = Sensors(
        ForceNoise(0.0, 0.005 * peak, 0.002),
        4e-5,
        force_rate=1000.0,
        tool_rate=500.0,
        force_zero=0.02 * peak,
    )
    campaign = Campaign(BODY, PUSHES, sensors)
    if args.curved is not None:
        campaign = replace(
            campaign, sensors=replace(sensors, encoder_resolution=args.curved), curved=True
        )
    # So small a campaign compiles, or loads, all that is compiled.
    first = run(replace(campaign, pushes=PUSHES[:2]), seed=2).trials
    diagnose([(t, segment(t.force, t.tool_height, t.displacement_height)) for t in first])
    context = get_context('fork')
    answers: SimpleQueue[tuple[str, float, float]] = context.SimpleQueue()
    print('| acting | answer | processes | time [s] | CPU time [s] |')
    print('| --- | --- | --- | --- | --- |')
    for acting in ACTING:
        effects = [undeclared(*acting, campaign)] if acting else []
        trials = run(campaign, effects, seed=1).trials
        given = [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
        for processes in (1, 2):
            fresh = context.Process(target=_measure, args=(given, processes, answers))
            fresh.start()
            answer, wall, cpu = answers.get()
            fresh.join()
            name = acting[0] if acting else 'nothing'
            print(f'| {name} | {answer} | {processes} | {wall:.1f} | {cpu:.1f} |', flush=True)
        if args.bootstrap and not acting:
            found = diagnose(given)
            wall, cpu = time.perf_counter(), _cpu()
            phases = [segmentation for _, segmentation in given]
            chance = bootstrap(found, phases, args.bootstrap, workers=2)
            wall, cpu = time.perf_counter() - wall, _cpu() - cpu
            what = f'bootstrap, {chance.campaigns} campaigns'
            told = f'{chance.false_alarms} false alarms'
            print(f'| {what} | {told} | 2 | {wall:.1f} | {cpu:.1f} |', flush=True)


def _measure(
    given: list[Segmented], processes: int, answers: 'SimpleQueue[tuple[str, float, float]]'
) -> None:
    """Tell what a diagnosis answers, and its wall and processor time [s]."""
    wall, cpu = time.perf_counter(), _cpu()
    found = diagnose(given, workers=processes)
    wall, cpu = time.perf_counter() - wall, _cpu() - cpu
    answers.put((', '.join(found.effects) or found.status, wall, cpu))


def _cpu() -> float:
    """Return the processor time of this process and of those that it has started [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


if __name__ == '__main__':
    main()
