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

"""The touch happens before or after the detected contact."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.OFFSET, values[0])


EFFECT = Effect(
    name='contact_offset',
    title='Contact offset',
    kind='cell',
    sketch="""
    d -> d + delta_0
    """,
    parameters=(
        EffectParameter(
            'delta_0',
            'm',
            'how much deeper the tool is than the detected contact says; positive: earlier',
            -math.inf,
            math.inf,
            lambda scale: 0.03 * scale.depth,
            scan=(1.0, -1.0),
        ),
    ),
    validity=(
        'The same offset in every trial, as a threshold on the force makes it. The fit finds the '
        'touch of each trial for itself, and with it what all have in common.'
    ),
    signature='The force and the height start too early or too late at the touch, in every trial.',
    source=(
        'D. C. Lin, E. K. Dimitriadis and F. Horkay, J. Biomech. Eng. 129, 2007, 430-440, '
        'doi:10.1115/1.2720924 (contact point as a parameter of the fit).'
    ),
    shape=_shape,
    nuisance=True,
)
