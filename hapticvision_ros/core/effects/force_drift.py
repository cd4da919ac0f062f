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

"""The load cell's zero drifts."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.kernels import kernel
import numpy as np


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    row = prediction.d_force[rows[0]] if rows else np.empty(0)
    _drift(trial.t, trial.zero_time, values[0], prediction.force, row)


@kernel()
def _drift(t, zero_time, rate, force, row):  # type: ignore[no-untyped-def]
    """Add what has drifted since the zero was taken, and its derivative where one is asked for."""
    for i in range(force.size):
        since = 0.5 * (t[i + 1] + t[i]) - zero_time
        force[i] += rate * since
        if row.size > 0:
            row[i] += since


EFFECT = Effect(
    name='force_drift',
    title='Force drift',
    kind='sensor',
    sketch="""
    F_measured = F + rate (t - t_zero),  t_zero where the zero was taken
    """,
    parameters=(
        EffectParameter(
            'rate',
            'N/s',
            'drift of the zero of the load cell',
            -math.inf,
            math.inf,
            lambda scale: 0.0,
        ),
    ),
    validity='A drift that is steady over a trial and alike in all of them (warming up).',
    signature='The force in the air after the release is off its zero, more so the later.',
    source='E. O. Doebelin, Measurement Systems: Application and Design, 4th ed., 1990, ch. 3.',
    observe=_observe,
)
