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
import numpy as np


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    amplitude, frequency, phase = values
    half = 0.5 * np.diff(trial.t)
    # From the middle of the trial, so that a change of the frequency does not turn the phase.
    t = trial.t[:-1] + half - 0.5 * (trial.t[0] + trial.t[-1])
    angle = 2.0 * np.pi * frequency * t + phase
    # The load cell averages over its step.
    width = 2.0 * np.pi * frequency * half
    mean = np.sinc(width / np.pi)
    sine, cosine = np.sin(angle), np.cos(angle)
    prediction.force += amplitude * mean * sine
    if rows:
        prediction.d_force[rows[0]] += mean * sine
        d_mean = np.divide(np.cos(width) - mean, frequency, out=np.zeros_like(t), where=width > 0)
        prediction.d_force[rows[1]] += amplitude * (d_mean * sine + 2 * np.pi * t * mean * cosine)
        prediction.d_force[rows[2]] += amplitude * mean * cosine


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
)
