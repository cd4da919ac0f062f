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

"""First-order lag of the load cell."""

from collections.abc import Sequence

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.sampling import lag


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    lag(trial.t, values[0], prediction.force, prediction.d_force, rows[0] if rows else -1)


EFFECT = Effect(
    name='force_lag',
    title='Force lag',
    kind='sensor',
    sketch="""
    T_f dF_measured/dt = F - F_measured
    """,
    parameters=(
        EffectParameter(
            'T_f',
            's',
            'time constant of the load cell and its filter',
            0.0,
            100.0,
            lambda scale: 3.0 * scale.sampling_interval,
        ),
    ),
    validity='A filter of first order; a delay of the stamps is a clock offset instead.',
    signature='The force is late where it changes fast: at the touch, the stop and the release.',
    source=(
        'E. O. Doebelin, Measurement Systems: Application and Design, 4th ed., 1990, ch. 3 '
        '(first-order instrument).'
    ),
    observe=_observe,
    time_constant=lambda values: values['T_f'],
)
