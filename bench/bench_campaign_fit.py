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
Bench: the fit of a campaign of 6 trials x 130 s x 1 kHz, step by step and effect by effect.

Run it with one thread: ``OMP_NUM_THREADS=1 python3 bench/bench_campaign_fit.py``. The trials are
those of ``bench/closed_form.py``; all times are CPU times of a warm second run, the least
of several, so that other work on the machine counts little.
"""

import argparse
import resource
import time

from closed_form import campaign, Cell
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.intervals import profile_intervals


def least_cpu_time(work, repeats: int) -> float:
    """Return the least CPU time of a call [s], after a first one that does not count."""
    work()
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--repeats', type=int, default=3, help='calls of which the least counts')
    parser.add_argument('--effects', nargs='*', default=list(BY_NAME), help='which effects to fit')
    args = parser.parse_args()
    cell = Cell(rate=1000.0, tool_rate=500.0, hold=60.0, recovery=66.0, correlation=0.9)
    trials = campaign(0, 6, cell=cell)
    samples = sum(len(trial.force) for trial, _ in trials)
    print(f'{len(trials)} trials, {samples} force samples')
    base = least_cpu_time(lambda: fit(trials), args.repeats)
    prepared = least_cpu_time(lambda: prepare(trials), args.repeats)
    result = fit(trials)
    intervals = least_cpu_time(lambda: profile_intervals(result), args.repeats)
    print(f'{"what":<28}{"CPU time":>10}{"over base":>11}{"ns a sample":>13}')

    def show(what: str, seconds: float) -> None:
        print(
            f'{what:<28}{seconds:>8.3f} s{seconds / base:>11.2f}{seconds / samples * 1e9:>13.0f}'
        )

    show('base, with covariance', base)
    show('  of it: steps and paths', prepared)
    show('profile intervals of it', intervals)
    for name in args.effects:
        show(f'base + {name}', least_cpu_time(lambda n=name: fit(trials, Model((n,))), 1))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    print(f'peak memory {peak:.0f} MB')


if __name__ == '__main__':
    main()
