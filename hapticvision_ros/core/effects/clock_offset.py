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

"""The range sensor's clock against the load cell's."""

from collections.abc import Sequence

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    speed = prediction.look(trial.t, trial.height_t - values[0])
    if rows:
        prediction.d_height[rows[0]] -= speed


EFFECT = Effect(
    name='clock_offset',
    title='Clock offset',
    kind='sensor',
    sketch="""
    H_measured(t) = H(t - dt)
    """,
    parameters=(
        EffectParameter(
            'dt',
            's',
            "how much later the range sensor's stamps are than the load cell's",
            -100.0,
            100.0,
            lambda scale: 0.0,
        ),
    ),
    validity='The same offset in every trial, and no drift between the clocks in one.',
    signature='The height is late or early by the same time wherever it changes.',
    source=(
        'P. Furgale, J. Rehder and R. Siegwart, IEEE/RSJ IROS 2013, 1280-1286, '
        'doi:10.1109/IROS.2013.6696514 (offset of clocks as a parameter of the fit).'
    ),
    observe=_observe,
)
