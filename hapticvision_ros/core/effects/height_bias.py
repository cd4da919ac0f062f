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

"""The range sensor's reading shifts while the tool occludes the object."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Final

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
import numpy as np

_SHARPEST: Final = 1e-6
"""Way of the tool within which it comes to hide the object at least [m]."""


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    hidden = np.interp(trial.height_t, trial.t, trial.displacement) > 0.0
    prediction.height[hidden] += values[0]
    if rows:
        prediction.d_height[rows[0], hidden] += 1.0


def _near(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    bias, clearance = values
    depth = np.interp(trial.height_t, trial.t, trial.displacement)
    # A frame in which the tool passes the limit is hidden in part.
    width = np.full(depth.size, _SHARPEST)
    if depth.size > 1:
        width = np.maximum(np.abs(np.gradient(depth)), _SHARPEST)
    part = (depth + clearance) / width + 0.5
    hidden = np.clip(part, 0.0, 1.0)
    prediction.height += bias * hidden
    if rows:
        prediction.d_height[rows[0]] += hidden
        passing = (part > 0.0) & (part < 1.0)
        prediction.d_height[rows[1], passing] += bias / width[passing]


def _touching(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    assert prediction.touched is not None
    step = np.searchsorted(trial.t, trial.height_t, side='right') - 1
    hidden = prediction.touched[np.clip(step, 0, prediction.touched.size - 1)]
    prediction.height[hidden] += values[0]
    if rows:
        prediction.d_height[rows[0], hidden] += 1.0


_BELOW = Effect(
    name='height_bias',
    title='Height bias',
    kind='sensor',
    sketch="""
    H_measured = H + b while the tip is below the original surface
    """,
    parameters=(
        EffectParameter(
            'b',
            'm',
            'shift of the height while the tool is in front of the contact point',
            -math.inf,
            math.inf,
            lambda scale: 0.0,
        ),
    ),
    validity='A shift that depends neither on the depth nor on the side of the view.',
    signature='The height steps at the touch and steps back when the tool is out of the dent.',
    source=(
        'H. Sarbolandi, D. Lefloch and A. Kolb, Comput. Vis. Image Underst. 139, 2015, 1-20, '
        'doi:10.1016/j.cviu.2015.05.006 (occlusion and mixed pixels of range sensors).'
    ),
    observe=_observe,
)

EFFECT = replace(
    _BELOW,
    laws=(
        _BELOW.following(
            'near',
            sketch="""
    H_measured = H + b while the tip is less than c above the original surface, or below it
    """,
            validity='A shift that depends neither on the depth nor on the side of the view.',
            source=_BELOW.source,
            observe=_near,
            parameters=(
                *_BELOW.parameters,
                EffectParameter(
                    'c',
                    'm',
                    'how far above the surface the tool begins to hide it',
                    0.0,
                    math.inf,
                    lambda scale: scale.depth,
                    scan=(0.3, 0.45, 0.7, 1.0, 1.5, 2.2),
                ),
            ),
        ),
        _BELOW.following(
            'touching',
            sketch="""
    H_measured = H + b while the tool touches the object
    """,
            validity='A shift that ends when the object comes off the tool, however deep that is.',
            source=_BELOW.source,
            observe=_touching,
        ),
    ),
)
