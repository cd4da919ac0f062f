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
What could tell effects apart that act within a sample, if nothing but the noise were in the way.

A spring in series, a machine that gives way and a lag of the load cell all draw jumps of the force
out. Each acts in a campaign without noise, whose encoders follow the arm; every one of them is
fitted to it, and the squares that are left over the noise's variance are what a diagnosis with
perfect knowledge of the noise could tell them by. ``OMP_NUM_THREADS=1 python3
bench/bench_within_a_sample.py``
"""

import argparse

from bench_attribution import BaseMisfit, fitted_strength, make
from hapticvision_ros.sim.campaigns import run
from hapticvision_ros.sim.strengths import undeclared
import numpy as np

ACTING = ('series_spring', 'machine_compliance', 'force_lag')
FITTED = (*ACTING, 'second_retardation')


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--world', choices=('grid', 'random'), default='grid')
    parser.add_argument('--seeds', type=int, nargs='+', default=[0, 1])
    parser.add_argument('--r', type=float, nargs='+', default=[0.3, 1.0])
    args = parser.parse_args()
    print(f'| seed | r | acting | its size | base | {" | ".join(FITTED)} |')
    print(f'| --- | --- | --- | --- | --- |{" --- |" * len(FITTED)}')
    for seed in args.seeds:
        campaign = make(args.world, seed, 0.0)
        misfit = BaseMisfit(campaign, seed)
        shape = float(np.random.default_rng((seed, 5)).uniform())
        for r in args.r:
            for name in ACTING:
                size = fitted_strength(r, name, campaign, misfit, shape, seed)
                effect = undeclared(name, size, campaign, shape=shape)
                trials = run(misfit.campaign, [effect], seed=seed, ideal=True).trials
                left = [
                    misfit.left(trials, effects)[0]
                    for effects in ((), *((each,) for each in FITTED))
                ]
                cells = ' | '.join(f'{value:.0f}' for value in left)
                print(f'| {seed} | {r:g} | {name} | {effect.values[0]:.3g} | {cells} |')


if __name__ == '__main__':
    main()
