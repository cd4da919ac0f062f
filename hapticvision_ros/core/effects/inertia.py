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

"""Moving mass at the contact."""

from collections.abc import Sequence
from dataclasses import replace

from hapticvision_ros.core.effects.declaration import (
    dashpots,
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.chain import Slot
from hapticvision_ros.core.models.motion import acceleration
from hapticvision_ros.core.records import FloatArray


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.MASS, values[0])


def _of_the_tool(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    _add(acceleration(trial.t, trial.displacement), values, prediction, rows)


def _added(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    felt = acceleration(trial.t, trial.displacement)
    _add(felt * prediction.in_contact, values, prediction, rows)


def _add(
    felt: FloatArray, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    prediction.force += values[0] * felt
    if rows:
        prediction.d_force[rows[0]] += felt


_AT_THE_CONTACT = Effect(
    name='inertia',
    title='Inertia',
    kind='object',
    sketch="""
    tool ---- M ---- (K1 || C1) ---- C2 ----

    in contact F = F_chain + M d^2H/dt^2;  free M d^2H/dt^2 = -F_chain: a vibration that decays
    """,
    parameters=(
        EffectParameter(
            'M',
            'kg',
            'mass that moves with the contact point',
            0.0,
            1e3,
            lambda scale: 0.1,
        ),
    ),
    validity=(
        'A mass in one point; the tool is rigid, and a corner of its path is passed within one '
        'step.'
    ),
    signature=(
        'Spikes in the force where the tool changes its speed, and a vibration of the height '
        'after the release.'
    ),
    source='The paper, eq. (3), and the third property in its section 2.1.',
    shape=_shape,
    time_constant=lambda values: values['M'] / dashpots(values),
)

EFFECT = replace(
    _AT_THE_CONTACT,
    laws=(
        _AT_THE_CONTACT.following(
            'of_the_tool',
            sketch="""
    F_measured = F + M d^2x/dt^2,  x the tool's own way, in air as in contact
    """,
            validity='A rigid tool before the load cell, which is not compensated for its mass.',
            source=(
                'ISO 4965-1:2012, Dynamic force calibration for uniaxial fatigue testing (force '
                'of the mass between load cell and test piece).'
            ),
            observe=_of_the_tool,
            kind='cell',
        ),
        replace(
            _AT_THE_CONTACT.following(
                'added',
                sketch="""
    F = F_chain + M d^2x/dt^2 in contact,  x the tool's own way;  no blow at the touch
                """,
                validity=(
                    'What moves with the tool comes to do so little by little after the touch, as '
                    'the contact grows, and stays behind when the tool leaves.'
                ),
                source=(
                    'H. Lamb, Hydrodynamics, 6th ed. 1932, art. 92 (added mass); the paper, eq. '
                    "(3), with the tool's acceleration."
                ),
                observe=_added,
            ),
            time_constant=_AT_THE_CONTACT.time_constant,
        ),
    ),
)
