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

"""Stiffness lost with the largest stretch so far."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.DAMAGE, values[0])


def _lasting(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    _shape(draft, values, trial)
    # Beyond d_ref, as before a push that is predicted, nothing would be left of K1.
    draft.add(Slot.STRETCHED, values[1] * min(trial.depth_before, trial.reference_depth))


_OF_A_TRIAL: Final = Effect(
    name='damage',
    title='Damage',
    kind='object',
    sketch="""
    K1(z_max) = K1 (1 - D z_max / d_ref),  z_max the largest stretch of K1 so far in the trial
    """,
    parameters=(
        EffectParameter(
            'D',
            '-',
            'share of K1 that is lost when its stretch has reached d_ref',
            0.0,
            0.95,
            lambda scale: 0.1,
        ),
    ),
    validity='Each trial starts on an unharmed place; the loss grows linearly with the stretch.',
    signature=(
        'Deep pushes are softer than shallow ones, and what comes after the largest stretch is '
        'softer than what came before.'
    ),
    source=(
        'L. Mullins, Rubber Chem. Technol. 42, 1969, 339-362, doi:10.5254/1.3539210; J. C. Simo, '
        'Comput. Methods Appl. Mech. Eng. 60, 1987, 153-173, doi:10.1016/0045-7825(87)90107-1 '
        '(damage by the largest strain so far).'
    ),
    shape=_shape,
)

EFFECT = replace(
    _OF_A_TRIAL,
    laws=(
        _OF_A_TRIAL.following(
            'lasting',
            sketch="""
    K1(z_max) = K1 (1 - D z_max / d_ref),  z_max the largest stretch of K1 so far in the campaign,
    before a trial kappa times the depth of the deepest push before it
    """,
            validity=(
                'All trials at one place, which does not heal between them; the deepest pushes '
                'stretch K1 by the same part of their depth. Of earlier pushes those count that '
                'are fitted together.'
            ),
            source=(
                'J. Diani, B. Fayolle and P. Gilormini, Eur. Polym. J. 45, 2009, 601-612, '
                'doi:10.1016/j.eurpolymj.2008.11.017 (softening by the largest strain ever, which '
                'stays).'
            ),
            shape=_lasting,
            parameters=(
                *_OF_A_TRIAL.parameters,
                EffectParameter(
                    'kappa',
                    '-',
                    'stretch of K1 over the depth, of the deepest push before a trial',
                    0.0,
                    1.0,
                    lambda scale: 0.7,
                ),
            ),
        ),
    ),
)
