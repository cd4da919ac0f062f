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

"""Stiffness and viscosity drift over the campaign."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

from hapticvision_ros.core.effects.declaration import (
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.chain import Slot
import numpy as np

_HOUR: Final = 3600.0
"""[s]"""


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    factor = np.exp(values[0] * (trial.campaign_time / _HOUR))
    for slot in (Slot.K1, Slot.C1, Slot.C2, Slot.PARALLEL_STIFFNESS):
        draft.multiply(slot, factor)
    draft.multiply(Slot.SERIES_COMPLIANCE, 1.0 / factor)
    draft.units = [
        (stiffness * factor, viscosity * factor) for stiffness, viscosity in draft.units
    ]


def _within(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    # Where all elements change by one factor the object moves as it did, and only its force has
    # the factor: so it is within a trial.
    since = (0.5 * (trial.t[1:] + trial.t[:-1]) - trial.t[0]) / _HOUR
    factor = np.exp(values[0] * since)
    prediction.force *= factor
    if rows:
        prediction.d_force *= factor
        prediction.d_force[rows[0]] += since * prediction.force


_BY_TRIAL = Effect(
    name='ageing',
    title='Ageing',
    kind='object',
    sketch="""
    K, C -> K exp(rate t), C exp(rate t),  t from the start of the campaign to that of the trial
    """,
    parameters=(
        EffectParameter(
            'rate',
            '1/h',
            'relative growth of every stiffness and viscosity of the object',
            -20.0,
            20.0,
            lambda scale: 0.0,
        ),
    ),
    validity='Drying or warming that is slow against a trial and acts on all elements alike.',
    signature='The residual has the shape of the force and grows from trial to trial.',
    source=(
        'L. C. E. Struik, Physical Aging in Amorphous Polymers and Other Materials, 1978; J. D. '
        'Ferry, Viscoelastic Properties of Polymers, 3rd ed., 1980, ch. 11 (temperature).'
    ),
    shape=_shape,
)

EFFECT = replace(
    _BY_TRIAL,
    laws=(
        _BY_TRIAL.following(
            'within_trials',
            sketch="""
    K, C -> K exp(rate t), C exp(rate t),  t from the start of the campaign
    """,
            validity=(
                'Drying or warming that acts on all elements alike; a stiff arm and a light '
                'object: machine_compliance, inertia and adhesion age with them within a trial.'
            ),
            source=_BY_TRIAL.source,
            shape=_shape,
            observe=_within,
        ),
    ),
)
