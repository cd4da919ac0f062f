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

"""The arm and the load path give way."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import (
    dashpots,
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
)
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.MACHINE_COMPLIANCE, 1.0 / values[0])


EFFECT = Effect(
    name='machine_compliance',
    title='Machine compliance',
    kind='cell',
    sketch="""
    encoders ---- K_m ---- tip      H = d - F / K_m in contact
    """,
    parameters=(
        EffectParameter(
            'K_m',
            'N/m',
            'stiffness of arm, load cell and tool',
            1e-3,
            1e12,
            lambda scale: 20.0 * scale.force / scale.depth,
            neutral=math.inf,
            log=True,
        ),
    ),
    validity='A linear load path; told from a series spring only by a height of its own sensor.',
    signature=(
        'The height stays behind the tool in proportion to the force, and the force rises and '
        'falls over a finite time where the tool starts or stops.'
    ),
    source=(
        'W. C. Oliver and G. M. Pharr, J. Mater. Res. 7, 1992, 1564-1583, '
        'doi:10.1557/JMR.1992.1564 (load-frame compliance).'
    ),
    shape=_shape,
    time_constant=lambda values: dashpots(values) / values['K_m'],
)
