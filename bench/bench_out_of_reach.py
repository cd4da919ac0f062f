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
Which of the effects that a diagnosis missed it could have named, if nothing were in the way.

Each single effect that `bench_attribution.py` has in the lines of a file as not right acts anew,
without noise and with encoders that follow the arm; every effect of the library is fitted to it.
What each leaves in the squares, over the variance of the noise with its memory, is what one
who knows noise and arm could tell them by. An effect that takes out less than is asked for is not
to be found; one beside which two others leave no more than that in addition is not to be named in
a set of at most two. ``OMP_NUM_THREADS=1 python3 bench/bench_out_of_reach.py FILE``
"""

import argparse
import json
from pathlib import Path
from typing import Any, Final

from bench_attribution import BaseMisfit, fitted_strength, kind, make, right
from hapticvision_ros.sim.campaigns import run
from hapticvision_ros.sim.specimen import LIBRARY
from hapticvision_ros.sim.strengths import undeclared
import numpy as np

ASKED: Final = 10.0
"""What an effect has to lead by in the squares."""


def reach(result: dict[str, Any]) -> tuple[float, dict[str, float], float]:
    """Return what the acting effect takes out, by how much others leave more, and its own rest."""
    seed, name = result['seed'], result['effects'][0]
    campaign = make(result['world'], seed, result['scatter'])
    misfit = BaseMisfit(campaign, seed)
    shape = float(np.random.default_rng((seed, 5)).uniform())
    size = fitted_strength(result['r'], name, campaign, misfit, shape, seed)
    effect = undeclared(name, size, campaign, shape=shape)
    trials = run(misfit.campaign, [effect], seed=seed, ideal=True).trials
    base, own = (misfit.left(trials, of, memory=True)[0] for of in ((), (name,)))
    others = {
        other: misfit.left(trials, (other,), memory=True)[0] - own
        for other in LIBRARY
        if other != name
    }
    return base - own, others, own


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('lines', type=Path, help='file of the cases')
    args = parser.parse_args()
    results = [json.loads(line) for line in args.lines.read_text().splitlines()]
    single = [
        each
        for each in results
        if kind(each) == 'one' and not each['scatter'] and 'status' in each
    ]
    bad = [each for each in single if not right(each)]
    print('| r | acting | seed | answer | takes out | leaves | others within 10 | out of reach |')
    print('| --- ' * 8 + '|')
    beyond: dict[float, int] = {}
    for each in bad:
        gain, others, own = reach(each)
        near = [f'{k} {v:.0f}' for k, v in sorted(others.items(), key=lambda x: x[1]) if v < ASKED]
        out = 'not to be found' if gain < ASKED else 'no set of two' if len(near) > 1 else 'no'
        beyond[each['r']] = beyond.get(each['r'], 0) + (out != 'no')
        answer = ', '.join(' or '.join(names) for names in each['sets']) or each['status']
        print(
            f'| {each["r"]:g} | {each["effects"][0]} | {each["seed"]} | {answer} | {gain:.0f} | '
            f'{own:.0f} | {", ".join(near) or "-"} | {out} |',
            flush=True,
        )
    print()
    for r in sorted({each['r'] for each in single}):
        of = [each for each in single if each['r'] == r]
        good = sum(right(each) for each in of)
        left = len(of) - beyond.get(r, 0)
        print(
            f'r = {r:g}: {good} of {len(of)} right; {beyond.get(r, 0)} out of reach, '
            f'{good} of the other {left}' + (f' ({100.0 * good / left:.0f} %)' if left else '')
        )


if __name__ == '__main__':
    main()
