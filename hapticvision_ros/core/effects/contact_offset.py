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

"""The touch happens before or after the detected contact."""

from collections.abc import Sequence
from dataclasses import replace
import math

from hapticvision_ros.core.effects.declaration import (
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.chain import Slot
import numpy as np


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.OFFSET, values[0])


def _loose_top(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    delta_0 = values[0]
    deepest = np.maximum.accumulate(trial.displacement)
    for t, height, derivatives in (
        (trial.height_t, prediction.height, prediction.d_height),
        (trial.t, prediction.surface, prediction.d_surface),
    ):
        reached = np.interp(t, trial.t, deepest)
        if delta_0 >= 0.0:
            closed = np.clip(reached + delta_0, 0.0, delta_0)
            moves = reached + delta_0 > 0.0
        else:
            # A top that is not seen to move stays where it was.
            moves = (reached > 0.0) & (height + delta_0 > 0.0)
            closed = np.where(moves, delta_0, -height) * (reached > 0.0)
        height += closed
        if rows:
            derivatives[rows[0], moves] += 1.0


_OF_THE_TOUCH = Effect(
    name='contact_offset',
    title='Contact offset',
    kind='cell',
    sketch="""
    d -> d + delta_0
    """,
    parameters=(
        EffectParameter(
            'delta_0',
            'm',
            'how much deeper the tool is than the detected contact says; positive: earlier',
            -math.inf,
            math.inf,
            lambda scale: 0.03 * scale.depth,
            scan=(1.0, -1.0),
        ),
    ),
    validity=(
        'The same offset in every trial, as a threshold on the force makes it. The fit finds the '
        'touch of each trial for itself, and with it what all have in common.'
    ),
    signature='The force and the height start too early or too late at the touch, in every trial.',
    source=(
        'D. C. Lin, E. K. Dimitriadis and F. Horkay, J. Biomech. Eng. 129, 2007, 430-440, '
        'doi:10.1115/1.2720924 (contact point as a parameter of the fit).'
    ),
    shape=_shape,
    nuisance=True,
)

EFFECT = replace(
    _OF_THE_TOUCH,
    laws=(
        replace(
            _OF_THE_TOUCH.following(
                'loose_top',
                sketch="""
    H_measured = H + delta_0 from the touch on, also after the release;  F as without
    """,
                validity=(
                    'A top that the tool pushes down before the object resists, and that stays '
                    'down; negative: the object resists before its top is seen to move.'
                ),
                source=_OF_THE_TOUCH.source,
                observe=_loose_top,
            ),
            nuisance=False,
        ),
    ),
)
