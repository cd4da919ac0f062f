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
Bench: exported MuJoCo models under a constant force and free again, against closed forms.

MuJoCo is no requirement of this package; it is only needed here: ``pip install mujoco``, then
``python3 bench/bench_mujoco_export.py``.
"""

import importlib.util

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.export import mujoco as to_mjcf
import numpy as np

FORCE, RELEASED, END = 10.0, 5.0, 10.0
K1, C1, C2, F_y, K_0 = 2000.0, 1600.0, 2400.0, 3.0, 8000.0


def simulate(text: str) -> tuple[np.ndarray, np.ndarray]:
    """Return time [s] and displacement height [m]."""
    import mujoco

    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    surface = model.body('surface').id
    samples = []
    while data.time < END:
        data.xfrc_applied[surface, 2] = -FORCE if data.time < RELEASED else 0.0
        mujoco.mj_step(model, data)
        samples.append((data.time, -data.xpos[surface, 2]))
    t, height = np.array(samples).T
    return t, height


def creep(t: np.ndarray, threshold: float, series: float) -> np.ndarray:
    """Return the displacement height of a chain without mass [m]."""
    held = np.minimum(t, RELEASED)
    bounced = FORCE / K1 * -np.expm1(-held * K1 / C1) * np.exp(-(t - held) * K1 / C1)
    return bounced + (FORCE - threshold) / C2 * held + np.where(t < RELEASED, FORCE / series, 0.0)


def main() -> None:
    """Print how far each model misses."""
    if importlib.util.find_spec('mujoco') is None:
        print('mujoco is not installed: nothing to compare with')
        return
    base = {'K1': K1, 'C1': C1, 'C2': C2}
    for effect, more, threshold, series in (
        (None, {}, 0.0, np.inf),
        ('yield_force', {'F_y': F_y}, F_y, np.inf),
        ('series_spring', {'K_0': K_0}, 0.0, K_0),
    ):
        model = Model(() if effect is None else (effect,))
        t, height = simulate(to_mjcf(model, base | more))
        exact = creep(t, threshold, series)
        # The small masses swing for a moment where the force jumps.
        quiet = (np.abs(t - RELEASED) > 0.5) & (t > 0.5)
        missed = np.abs(height - exact)[quiet].max()
        print(f'{model.name}: {1e6 * missed:.1f} um of {1e3 * exact.max():.1f} mm')


if __name__ == '__main__':
    main()
