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
from collections.abc import Sequence
from dataclasses import replace

from bench_attribution import fitted_strength, FOLLOWED, make, white
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.fit.campaign import fit_prepared
from hapticvision_ros.core.fit.data import prepare
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.segmentation import segment
from hapticvision_ros.sim.campaigns import Campaign, run
from hapticvision_ros.sim.specimen import Undeclared
from hapticvision_ros.sim.strengths import LinearMisfit, strength_for, undeclared
import numpy as np

ACTING = ('series_spring', 'machine_compliance', 'force_lag')
FITTED = (*ACTING, 'second_retardation')


def squares(
    campaign: Campaign, acting: Sequence[Undeclared], seed: int, effects: tuple[str, ...]
) -> float:
    """Return what a model leaves, at its best, of trials without noise, over the variance."""
    rate = max(campaign.sensors.force_rate, FOLLOWED)
    exact = replace(campaign, sensors=replace(campaign.sensors, tool_rate=rate))
    trials = run(exact, acting, seed=seed, ideal=True).trials
    prepared, _ = prepare(
        [(t, segment(t.force, t.tool_height, t.displacement_height)) for t in trials]
    )
    found = fit_prepared(prepared, Model(effects))
    sensors = campaign.sensors
    found.problem.set_noise(white(sensors.force_noise.std), white(sensors.height_noise))
    best = minimise(
        found.problem.evaluate,
        found.state,
        found.problem.bounds,
        tolerance=1e-9,
        max_evaluations=60,
    )
    return best.cost


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
        misfit = LinearMisfit(campaign, seed=seed)
        shape = float(np.random.default_rng((seed, 5)).uniform())
        for r in args.r:
            for name in ACTING:
                start = strength_for(
                    r, name, campaign, misfit, shape=shape, seed=seed, tolerance=0.1
                )
                size = fitted_strength(r, name, campaign, start, shape, seed)
                effect = undeclared(name, size, campaign, shape=shape)
                left = [
                    squares(campaign, [effect], seed, effects)
                    for effects in ((), *((each,) for each in FITTED))
                ]
                cells = ' | '.join(f'{value:.0f}' for value in left)
                print(f'| {seed} | {r:g} | {name} | {effect.values[0]:.3g} | {cells} |')


if __name__ == '__main__':
    main()
