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

"""Instantaneous spring in series with the chain: the Burgers body."""

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
    draft.add(Slot.SERIES_COMPLIANCE, 1.0 / values[0])


EFFECT = Effect(
    name='series_spring',
    title='Series spring',
    kind='object',
    sketch="""
    ---- K_0 ---- (K1 || C1) ---- C2 ----      H = F / K_0 + z + y
    """,
    parameters=(
        EffectParameter(
            'K_0',
            'N/m',
            'stiffness of the instantaneous spring',
            1e-3,
            1e12,
            lambda scale: 10.0 * scale.force / scale.depth,
            neutral=math.inf,
            log=True,
        ),
    ),
    validity='Displacements small enough for a linear spring.',
    signature=(
        'The force rises and falls over a finite time where the tool starts or stops, and the '
        'object springs back at once when it is released.'
    ),
    source=(
        'J. M. Burgers, First Report on Viscosity and Plasticity, 1935, ch. 1; W. N. Findley, '
        'J. S. Lai and K. Onaran, Creep and Relaxation of Nonlinear Viscoelastic Materials, 1976, '
        'ch. 5.'
    ),
    shape=_shape,
    time_constant=lambda values: dashpots(values) / values['K_0'],
)
