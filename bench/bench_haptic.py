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
Bench: one step of the haptic stepper, called from Python, for several models.

Each step is timed by itself, its call included; the body is pushed, held, left and pushed again,
so that touch and loss of contact are among the steps. ``python bench/bench_haptic.py``.
"""

import gc
from time import perf_counter_ns

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.haptic import HapticStepper, RATE
import numpy as np

VALUES = {
    'K1': 5000.0,
    'C1': 20000.0,
    'C2': 60000.0,
    'F_y': 3.0,
    'K_0': 2e4,
    'K_p': 300.0,
    'K_2': 15000.0,
    'C_3': 9000.0,
    'alpha': 0.6,
    'beta': 3e4,
    'n': 0.6,
    'm': 0.5,
    'D': 0.4,
    'M': 0.2,
}
MODELS = (
    'three-element',
    'three-element+yield_force+series_spring',
    'three-element+springpot',
    'three-element+series_spring+inertia',
    'three-element+shear_thinning+strain_stiffening+damage+contact_growth',
)
SECONDS = 60
LIMIT = 20.0
"""[us]"""


def main() -> None:
    """Print percentiles of the time of a step."""
    t = np.arange(SECONDS * int(RATE)) / RATE
    # Three pushes, a tremble on them, and the air in between.
    path = (0.006 * np.sin(2.0 * np.pi * t / 20.0) + 1e-4 * np.sin(2.0 * np.pi * 8.0 * t)).tolist()
    print(f'{len(path)} steps of {1e3 / RATE:g} ms, time of a step [us]')
    print(f'{"p50":>8}{"p99":>8}{"p99.9":>8}{"max":>8}  share below {LIMIT:g} us')
    for name in MODELS:
        model = Model.parse(name)
        body = HapticStepper(
            model, {key: VALUES[key] for key in model.names}, reference_depth=0.01
        )
        took = np.empty(len(path))
        gc.disable()
        for i, displacement in enumerate(path):
            start = perf_counter_ns()
            body.step(displacement)
            took[i] = perf_counter_ns() - start
        gc.enable()
        took *= 1e-3
        numbers = ''.join(f'{one:8.2f}' for one in np.percentile(took, (50.0, 99.0, 99.9, 100.0)))
        print(f'{numbers}  {np.mean(took < LIMIT):.5%}  {name}')


if __name__ == '__main__':
    main()
