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

"""Vibration or mains hum in the force."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.effects.declaration import (
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.sampling import hum


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    amplitude, frequency, phase = values
    own = tuple(rows) or (-1, -1, -1)
    # From the middle of the trial, so that a change of the frequency does not turn the phase; the
    # load cell averages over its step.
    hum(trial.t, amplitude, frequency, phase, prediction.force, prediction.d_force, *own)


EFFECT = Effect(
    name='periodic_disturbance',
    title='Periodic disturbance',
    kind='sensor',
    sketch="""
    F_measured = F + amplitude sin(2 pi frequency t + phase),  averaged over a step
    """,
    parameters=(
        EffectParameter(
            'amplitude',
            'N',
            'amplitude of the disturbance',
            0.0,
            math.inf,
            lambda scale: scale.disturbance_amplitude,
        ),
        EffectParameter(
            'frequency',
            'Hz',
            'frequency of the disturbance',
            1e-3,
            1e4,
            lambda scale: scale.disturbance_frequency,
            neutral=math.nan,
            log=True,
        ),
    ),
    trial_parameters=(
        EffectParameter(
            'phase',
            '-',
            'phase at the middle of the trial [rad]',
            -math.inf,
            math.inf,
            lambda scale: 0.0,
            neutral=math.nan,
        ),
    ),
    validity='One line of constant amplitude and frequency; each trial has its own phase.',
    signature='A line in the spectrum of the residual of the force, in air as in contact.',
    source='P. Horowitz and W. Hill, The Art of Electronics, 3rd ed., 2015, ch. 8 (interference).',
    observe=_observe,
    period=lambda values: 1.0 / values['frequency'],
)
