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

"""Saint-Venant slider beside the dashpot C2."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.YIELD_FORCE, values[0])


EFFECT = Effect(
    name='yield_force',
    title='Yield force',
    kind='object',
    sketch="""
        +---- C2 ----+
    ----|            |----      C2 dy/dt = sign(F) max(|F| - F_y, 0)
        +--- F_y ----+
    """,
    parameters=(
        EffectParameter(
            'F_y',
            'N',
            'threshold below which C2 does not flow',
            0.0,
            math.inf,
            lambda scale: 0.1 * scale.force,
        ),
    ),
    validity='One threshold, which neither rest nor flow changes (no thixotropy).',
    signature=(
        'The force of the hold levels off at a plateau instead of falling to zero, and small or '
        'short pushes leave no residual.'
    ),
    source=(
        'E. C. Bingham, Fluidity and Plasticity, 1922; M. Reiner, Deformation, Strain and Flow, '
        '1960 (Saint-Venant element beside a dashpot).'
    ),
    shape=_shape,
)
