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
Time of the forward model, for the base and for each effect: ns of CPU time a force sample.

One trial of 130 s at 1 kHz with its height at 30 Hz: approach, push, hold, release and recovery.
The models take turns, so that a busy machine slows all alike; the best of the rounds counts. The
second column is the cost with all derivatives.
"""

import argparse
from dataclasses import dataclass
import time

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.records import FloatArray
import numpy as np

SCALE = Scale(
    K1=5000.0,
    C1=84000.0,
    C2=107000.0,
    force=100.0,
    depth=0.010,
    push_speed=1.3e-3,
    contact_time=70.0,
    sampling_interval=1e-3,
    campaign_time=3600.0,
    disturbance_amplitude=0.5,
    disturbance_frequency=50.0,
)


@dataclass(frozen=True)
class Driven:
    """A trial that no one measured."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    campaign_time: float = 1800.0
    reference_depth: float = 0.010
    depth_before: float = 0.0
    zero_time: float = 0.5


def _trial(seconds: float) -> Driven:
    t = np.arange(0.0, seconds, 1e-3)
    knots = np.array([0.0, 1.00033, 8.693, 0.53 * seconds, 0.53 * seconds + 2.3, seconds])
    depth = np.array([-0.0013, 0.0, 0.010, 0.010, -0.020, -0.020])
    return Driven(t, np.interp(t, knots, depth), np.arange(0.01, seconds, 1.0 / 30.0))


def main() -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--seconds', type=float, default=130.0, help='length of the trial')
    parser.add_argument('--rounds', type=int, default=7, help='how often each model has its turn')
    arguments = parser.parse_args()
    trial = _trial(arguments.seconds)
    models = [Model(), *(Model((effect.name,)) for effect in EFFECTS)]
    best: dict[tuple[str, bool], float] = {}
    for _ in range(arguments.rounds + 1):
        for model in models:
            theta = model.first_guess(SCALE)
            for directions in (False, True):
                start = time.process_time()
                model.predict(trial, theta, directions=directions)
                spent = (time.process_time() - start) / (trial.t.size - 1) * 1e9
                key = (model.name, directions)
                best[key] = min(best.get(key, np.inf), spent)
    base = best[models[0].name, False]
    print(f'{"model":36} {"ns/sample":>10} {"to base":>8} {"with derivatives":>17}')
    for model in models:
        forward, full = best[model.name, False], best[model.name, True]
        print(f'{model.name:36} {forward:10.1f} {forward / base:8.2f} {full:17.1f}')
    return 0


if __name__ == '__main__':
    raise SystemExit(main())
