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

import cmath
from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Final

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.DAMAGE, values[0])


def _saturating(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    lost, saturation = values[:2]
    if saturation != 0.0:
        lost *= saturation / (1.0 - cmath.exp(-saturation))
    draft.add(Slot.DAMAGE, lost)
    draft.add(Slot.SATURATION, saturation)


def _stretched(draft: Draft, kappa: complex, trial: DrivenTrial) -> None:
    # Beyond d_ref, as before a push that is predicted, nothing would be left of K1.
    draft.add(Slot.STRETCHED, kappa * min(trial.depth_before, trial.reference_depth))


def _lasting(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    _shape(draft, values, trial)
    _stretched(draft, values[1], trial)


def _lasting_saturating(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    _saturating(draft, values, trial)
    _stretched(draft, values[2], trial)


_D: Final = EffectParameter(
    'D',
    '-',
    'share of K1 that is lost when its stretch has reached d_ref',
    0.0,
    0.95,
    lambda scale: 0.1,
)
_S: Final = EffectParameter(
    's',
    '-',
    'how often the rate of the loss falls to 1/e until the stretch has reached d_ref',
    0.1,
    50.0,
    lambda scale: 3.0,
    neutral=math.nan,
    log=True,
    scan=(0.4, 1.0, 3.0),
)
_KAPPA: Final = EffectParameter(
    'kappa',
    '-',
    'stretch of K1 over the depth, of the deepest push before a trial',
    0.0,
    1.0,
    lambda scale: 0.7,
    neutral=math.nan,
)

_OF_A_TRIAL: Final = Effect(
    name='damage',
    title='Damage',
    kind='object',
    sketch="""
    K1(z_max) = K1 (1 - D z_max / d_ref),  z_max the largest stretch of K1 so far in the trial
    """,
    parameters=(_D,),
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
_SATURATES: Final = _OF_A_TRIAL.following(
    'saturating',
    sketch="""
    K1(z_max) = K1 (1 - D (1 - exp(-s z_max / d_ref)) / (1 - exp(-s))),
    z_max the largest stretch of K1 so far in the trial
    """,
    validity=(
        'Each trial starts on an unharmed place. What can be lost is lost early: the larger s, '
        'the less are deep pushes softer than shallow ones.'
    ),
    source=(
        'C. Miehe, Eur. J. Mech. A/Solids 14, 1995, 697-720 (damage that saturates '
        'exponentially with the largest strain so far).'
    ),
    shape=_saturating,
    parameters=(_D, _S),
)
_LASTS: Final = _OF_A_TRIAL.following(
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
    parameters=(_D, _KAPPA),
)
_LASTS_AND_SATURATES: Final = _OF_A_TRIAL.following(
    'lasting_saturating',
    sketch="""
    K1(z_max) = K1 (1 - D (1 - exp(-s z_max / d_ref)) / (1 - exp(-s))),
    z_max the largest stretch of K1 so far in the campaign, before a trial kappa times the depth
    of the deepest push before it
    """,
    validity=f'{_LASTS.validity} What can be lost is lost early.',
    source=f'{_LASTS.source} {_SATURATES.source}',
    shape=_lasting_saturating,
    parameters=(_D, _S, _KAPPA),
)

EFFECT = replace(_OF_A_TRIAL, laws=(_SATURATES, _LASTS, _LASTS_AND_SATURATES))
