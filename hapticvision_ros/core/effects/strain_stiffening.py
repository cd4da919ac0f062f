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

"""K1 grows with its stretch."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.STIFFENING, values[0])


EFFECT = Effect(
    name='strain_stiffening',
    title='Strain stiffening',
    kind='object',
    sketch="""
    K1(z) = K1 (1 + beta z^2)
    """,
    parameters=(
        EffectParameter(
            'beta',
            '1/m^2',
            'growth of K1 with the square of its stretch',
            0.0,
            math.inf,
            lambda scale: 0.3 / scale.depth**2,
        ),
    ),
    validity='The first term of an even series in the stretch: moderate stretches.',
    signature='Deep pushes are stiffer and relax faster than shallow ones.',
    source=(
        'Y. C. Fung, Biomechanics: Mechanical Properties of Living Tissues, 2nd ed., 1993, ch. 7 '
        '(stiffening of soft tissue); the even series is that of the Duffing spring.'
    ),
    shape=_shape,
)
