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

"""The force scales with the penetration as the contact patch grows."""

from collections.abc import Sequence

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.CONTACT_EXPONENT, values[0])


EFFECT = Effect(
    name='contact_growth',
    title='Contact growth',
    kind='object',
    sketch="""
    F = (H / d_ref)^m F_chain,  d_ref the deepest push of the campaign
    """,
    parameters=(
        EffectParameter(
            'm',
            '-',
            'exponent of the penetration; 0 for a flat punch, 1/2 for a sphere on an elastic body',
            0.0,
            4.0,
            lambda scale: 0.3,
        ),
    ),
    validity=(
        'A tool whose contact patch grows with the depth; the chain is then that of the '
        'patch at d_ref.'
    ),
    signature='The force starts too slowly at the touch and rises too steeply towards the depth.',
    source=(
        'K. L. Johnson, Contact Mechanics, 1985, ch. 4 (Hertz: F proportional to d^(3/2)); '
        'I. N. Sneddon, Int. J. Eng. Sci. 3, 1965, 47-57, doi:10.1016/0020-7225(65)90019-4.'
    ),
    shape=_shape,
)
