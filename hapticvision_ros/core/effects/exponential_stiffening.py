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
The force grows exponentially with the depth, all elements alike.

Fung found the slope of the force of tissue to grow in proportion to the force, which makes an
elastic force proportional to exp(a H) - 1. Here the exponential is a factor on the force of the
whole chain, so that an elastic force is proportional to H exp(a H), and the relaxation is that of
the chain at any depth.
"""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
import numpy as np


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    rate = values[0]
    depth = 0.5 * (prediction.surface[1:] + prediction.surface[:-1])
    growth = np.exp(rate * depth)
    prediction.force *= growth
    if not rows:
        return
    prediction.d_force *= growth
    d_depth = 0.5 * (prediction.d_surface[:, 1:] + prediction.d_surface[:, :-1])
    prediction.d_force += rate * prediction.force * d_depth
    prediction.d_force[rows[0]] += depth * prediction.force


EFFECT = Effect(
    name='exponential_stiffening',
    title='Exponential stiffening',
    kind='object',
    sketch="""
    F = exp(a H) F_chain
    """,
    parameters=(
        EffectParameter(
            'a',
            '1/m',
            'growth of the force with the depth; the elements are those of a small depth',
            0.0,
            math.inf,
            lambda scale: 0.3 / scale.depth,
        ),
    ),
    validity=(
        'Soft tissue, or a layer on a harder one, whose relaxation does not depend on the depth; '
        'a stiff arm and a light object: machine_compliance, inertia and adhesion take the force '
        'of the chain.'
    ),
    signature=(
        'The force starts as that of a flat punch and rises ever more steeply, and what it loses '
        'in the hold is the same share of it at any depth.'
    ),
    source=(
        'Y. C. Fung, Am. J. Physiol. 213, 1967, 1532-1544, doi:10.1152/ajplegacy.1967.213.6.1532 '
        '(force of tissue by an exponential); Biomechanics: Mechanical Properties of Living '
        'Tissues, 2nd ed., 1993, ch. 7 (a law of the stretch times a law of time).'
    ),
    observe=_observe,
    extra=True,
)
