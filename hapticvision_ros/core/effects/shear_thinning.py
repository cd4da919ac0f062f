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

"""Power-law dashpot in place of C2."""

from collections.abc import Sequence

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.slots[Slot.FLOW_INDEX] = values[0]


EFFECT = Effect(
    name='shear_thinning',
    title='Shear thinning',
    kind='object',
    sketch="""
    F = C2 v_ref (v / v_ref)^n,  v = dy/dt,  v_ref = 1 mm/s
    """,
    parameters=(
        EffectParameter(
            'n',
            '-',
            'flow index: 1 a dashpot, less for a thinning body; C2 holds at 1 mm/s',
            0.1,
            3.0,
            lambda scale: 0.8,
            neutral=1.0,
        ),
    ),
    validity='Rates within a few decades of 1 mm/s: no plateau at either end of the power law.',
    signature=(
        'A faster push meets less viscosity than the base model says, and the hold relaxes ever '
        'more slowly.'
    ),
    source=(
        'W. Ostwald, Kolloid-Z. 36, 1925, 99-117; R. B. Bird, R. C. Armstrong and O. Hassager, '
        'Dynamics of Polymeric Liquids, vol. 1, 2nd ed., 1987, ch. 4.'
    ),
    shape=_shape,
    excludes=('springpot',),
)
