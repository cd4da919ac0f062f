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

"""Coulomb friction in the push axis."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Final

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.records import FloatArray
import numpy as np

SLIDING_SPEED: Final = 1e-5
"""Speed [m/s] above which the tool is taken to slide: a tenth and less of any push."""
PRESLIDING: Final = 5e-6
"""Way [m] up to which a tool that turns does not slide yet."""


def _direction(trial: DrivenTrial) -> FloatArray:
    """Return the direction in which the tool slides in each step, 0 at rest; shape (n,)."""
    speed = np.diff(trial.displacement) / np.diff(trial.t)
    # Friction at rest is anything up to the threshold; as the load cell's zero is taken at rest,
    # or at a steady approach, a tool at rest is given none; nor is one that only creeps by the
    # noise of its encoders.
    return np.tanh((speed / SLIDING_SPEED) ** 3)


def _last_direction(trial: DrivenTrial) -> FloatArray:
    """Return the direction in which the tool has slid last, 0 before it has; shape (n,)."""
    direction = _direction(trial)
    direction = np.where(np.abs(direction) > 0.5, np.sign(direction), 0.0)
    # A path that swings past its stop by parts of a micrometre, as one from encoders does, must
    # not turn what is held in the whole hold.
    starts = np.append(0, np.flatnonzero(np.diff(direction)) + 1)
    far = np.abs(np.add.reduceat(np.diff(trial.displacement), starts)) > PRESLIDING
    steps = np.diff(np.append(starts, direction.size))
    slides = (direction != 0.0) & np.repeat(far, steps)
    last = np.maximum.accumulate(np.where(slides, np.arange(slides.size), -1))
    return np.where(last < 0, 0.0, direction[last])


def _add(
    direction: FloatArray, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    prediction.force += values[0] * direction
    if rows:
        prediction.d_force[rows[0]] += direction


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    _add(_direction(trial), values, prediction, rows)


def _held(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    _add(_last_direction(trial), values, prediction, rows)


def _in_contact(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    _add(_direction(trial) * prediction.in_contact, values, prediction, rows)


def _held_in_contact(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    _add(_last_direction(trial) * prediction.in_contact, values, prediction, rows)


_COULOMB = Effect(
    name='friction',
    title='Friction',
    kind='cell',
    sketch="""
    F_measured = F + F_c sign(v),  v the speed of the tool; nothing at rest
    """,
    parameters=(
        EffectParameter(
            'F_c',
            'N',
            'Coulomb friction of the push axis',
            0.0,
            math.inf,
            lambda scale: 0.01 * scale.force,
        ),
    ),
    validity=(
        'Dry friction between load cell and object, in air as in contact; at rest it has decayed '
        '(no stiction).'
    ),
    signature='The force steps where the tool starts, stops or turns, whatever the depth.',
    source=(
        'B. Armstrong-Helouvry, P. Dupont and C. Canudas de Wit, Automatica 30, 1994, 1083-1138, '
        'doi:10.1016/0005-1098(94)90209-7 (Coulomb friction and its regularisation at rest).'
    ),
    observe=_observe,
)

_DAHL = (
    'P. R. Dahl, AIAA J. 14, 1976, 1675-1682, doi:10.2514/3.61511 (friction at rest keeps what it '
    'had when the motion ended).'
)

EFFECT = replace(
    _COULOMB,
    laws=(
        _COULOMB.following(
            'held',
            sketch="""
    F_measured = F + F_c sign(v),  at rest v as it was before
    """,
            validity=(
                'Dry friction that a tool keeps at rest and while it goes back by less than 5 um, '
                'in air as in contact.'
            ),
            source=_DAHL,
            observe=_held,
        ),
        _COULOMB.following(
            'in_contact',
            sketch="""
    F_measured = F + F_c sign(v) in contact;  nothing at rest
    """,
            validity='Dry friction between tool and object; at rest it has decayed.',
            source=_COULOMB.source,
            observe=_in_contact,
        ),
        _COULOMB.following(
            'held_in_contact',
            sketch="""
    F_measured = F + F_c sign(v) in contact,  at rest v as it was before
    """,
            validity='Dry friction between tool and object, which a tool at rest keeps.',
            source=_DAHL,
            observe=_held_in_contact,
        ),
    ),
)
