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

"""Coulomb friction in the push axis."""

from collections.abc import Sequence
import math
from typing import Final

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
import numpy as np

SLIDING_SPEED: Final = 1e-5
"""Speed [m/s] above which the tool is taken to slide: a tenth and less of any push."""


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    speed = np.diff(trial.displacement) / np.diff(trial.t)
    # Friction at rest is anything up to the threshold; as the load cell's zero is taken at rest,
    # or at a steady approach, a tool at rest is given none; nor is one that only creeps by the
    # noise of its encoders.
    direction = np.tanh((speed / SLIDING_SPEED) ** 3)
    prediction.force += values[0] * direction
    if rows:
        prediction.d_force[rows[0]] += direction


EFFECT = Effect(
    name='friction',
    title='Friction',
    kind='cell',
    sketch="""
    F_measured = F + F_c sign(v),  v the speed of the tool; nothing at rest
    """,
    parameters=(
        EffectParameter(
            'F_c',
            'N',
            'Coulomb friction of the push axis',
            0.0,
            math.inf,
            lambda scale: 0.01 * scale.force,
        ),
    ),
    validity=(
        'Dry friction between load cell and object, in air as in contact; at rest it has decayed '
        '(no stiction).'
    ),
    signature='The force steps where the tool starts, stops or turns, whatever the depth.',
    source=(
        'B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit, Automatica 30, 1994, 1083-1138, '
        'doi:10.1016/0005-1098(94)90209-7 (Coulomb friction and its regularisation at rest).'
    ),
    observe=_observe,
)
