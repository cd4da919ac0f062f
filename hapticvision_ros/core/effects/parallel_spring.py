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

"""Equilibrium spring beside the whole chain."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.PARALLEL_STIFFNESS, values[0])


EFFECT = Effect(
    name='parallel_spring',
    title='Parallel spring',
    kind='object',
    sketch="""
        +------------- K_p -------------+
    ----|                               |----      F = F_chain + K_p H
        +---- (K1 || C1) ---- C2 -------+
    """,
    parameters=(
        EffectParameter(
            'K_p',
            'N/m',
            'stiffness of the equilibrium spring',
            0.0,
            math.inf,
            lambda scale: 0.1 * scale.force / scale.depth,
        ),
    ),
    validity='Displacements small enough for a linear spring; in the long run no residual.',
    signature=(
        'The force of the hold levels off at a plateau in proportion to the depth, and the '
        'residual creeps back after the release.'
    ),
    source=(
        'J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed., 1980, ch. 1; N. W. Tschoegl, '
        'The Phenomenological Theory of Linear Viscoelastic Behavior, 1989, ch. 3.'
    ),
    shape=_shape,
)
