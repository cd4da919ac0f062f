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

"""Second Kelvin-Voigt unit in series."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.units.append((values[0], values[1]))


EFFECT = Effect(
    name='second_retardation',
    title='Second retardation',
    kind='object',
    sketch="""
    ---- (K1 || C1) ---- (K_2 || C_3) ---- C2 ----
    """,
    parameters=(
        EffectParameter(
            'K_2',
            'N/m',
            'stiffness of the second Kelvin-Voigt unit',
            1e-3,
            1e12,
            lambda scale: 3.0 * scale.K1,
            neutral=math.inf,
            log=True,
            twin='K1',
        ),
        EffectParameter(
            'C_3',
            'N.s/m',
            'viscosity of the second Kelvin-Voigt unit',
            1e-6,
            1e15,
            # A tenth of the first unit's retardation time, or ten times it: the two are told apart
            # best when their times differ and neither is longer than the contact.
            lambda scale: 0.3 * scale.C1,
            neutral=math.nan,
            log=True,
            scan=(1.0, 0.1, 10.0, 100.0),
            twin='C1',
        ),
    ),
    validity=(
        'A second retardation time apart from C1 / K1; where the two are equal the units are one, '
        'and exchanging them changes nothing: the first is the one that the base model shows.'
    ),
    signature='The decay in the hold and the recovery have two time constants instead of one.',
    source=(
        'J. D. Ferry, Viscoelastic Properties of Polymers, 3rd ed., 1980, ch. 1 (units in '
        'series); N. W. Tschoegl, The Phenomenological Theory of Linear Viscoelastic Behavior, '
        '1989, ch. 5.'
    ),
    shape=_shape,
    time_constant=lambda values: values['C_3'] / values['K_2'],
    generalises=('series_spring',),
    # Without flow, two units in series are one in parallel with a spring.
    limits=('parallel_spring',),
)
