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

"""What sensors make of a signal and its tangents: other times, a lag, a hum; compiled."""

import math
from typing import Final

from hapticvision_ros.core.kernels import kernel
import numpy as np

_SAME: Final = 1e-9
"""Relative difference between two steps that makes none."""
_TURNS: Final = 64
"""Steps for which sine and cosine are turned on before they are computed anew."""
_ASTRAY: Final = 1e-6
"""Angle [rad] by which stamps may leave even steps before they are."""


@kernel()
def sample(t, value, d_value, at, out, d_out, slope):  # type: ignore[no-untyped-def]
    """
    Read a piecewise linear signal and its tangents; held at its ends.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing times [s].
    value : ndarray, shape (n,)
        The signal.
    d_value : ndarray, shape (p, n)
        Its tangents.
    at : ndarray, shape (m,)
        Increasing times [s].
    out, d_out, slope : ndarray, shapes (m,), (p, m), (m,)
        Filled: the signal, its tangents and its slope at `at`.

    """
    last = t.size - 1
    i = 0
    for k in range(at.size):
        while i < last - 1 and t[i + 1] < at[k]:
            i += 1
        width = t[i + 1] - t[i]
        weight = (at[k] - t[i]) / width
        slope[k] = (value[i + 1] - value[i]) / width
        if weight < 0.0:
            weight = 0.0
            slope[k] = 0.0
        elif weight > 1.0:
            weight = 1.0
            slope[k] = 0.0
        out[k] = value[i] + weight * (value[i + 1] - value[i])
        for j in range(d_value.shape[0]):
            d_out[j, k] = d_value[j, i] + weight * (d_value[j, i + 1] - d_value[j, i])


@kernel()
def lag(t, time_constant, value, d_value, row):  # type: ignore[no-untyped-def]
    """
    Put step means through a first-order lag that starts at rest with the first of them.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the steps [s].
    time_constant : float
        Of the lag [s]; zero for none.
    value : ndarray, shape (n,)
        Mean of the signal over each step, taken as constant in it; replaced by that of the lag.
    d_value : ndarray, shape (p, n)
        Its tangents; replaced too.
    row : int
        The row to which the derivative in the time constant is added; -1 for none.

    """
    rows = d_value.shape[0]
    state = value[0]
    d_state = d_value[:, 0].copy()
    known = -1.0
    kept = 0.0
    lost = 1.0
    mean = 0.0
    d_kept = 0.0
    d_mean = 0.0
    for i in range(value.size):
        h = t[i + 1] - t[i]
        if abs(h - known) > _SAME * h:
            known = h
            if time_constant > 0.0:
                s = h / time_constant
                kept = np.exp(-s)
                lost = -np.expm1(-s)
                mean = lost / s
                d_kept = kept * s / time_constant
                d_mean = (lost - s * kept) / h
            else:
                kept = 0.0
                lost = 1.0
                mean = 0.0
                d_kept = 0.0
                d_mean = 1.0 / h
        # Over the step the state falls back from `away` to `kept` of it, and to `mean` on average.
        away = state - value[i]
        for j in range(rows):
            d_away = d_state[j] - d_value[j, i]
            d_state[j] = d_value[j, i] + kept * d_away
            d_value[j, i] += mean * d_away
        if row >= 0:
            d_state[row] += d_kept * away
            d_value[row, i] += d_mean * away
        # Written so that one product and one sum wait for each other from step to step.
        state = kept * state + lost * value[i]
        value[i] += mean * away


@kernel(error_model='numpy')
def hum(  # type: ignore[no-untyped-def]
    t, amplitude, frequency, phase, value, d_value, row, row_frequency, row_phase
):
    """
    Add the step means of a sine, and their derivatives.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the steps [s]; the phase is that in the middle between first and last.
    amplitude, frequency, phase : float
        Of the sine; in the unit of the signal, Hz and rad.
    value : ndarray, shape (n,)
        The signal's means over the steps.
    d_value : ndarray, shape (p, n)
        Its tangents.
    row, row_frequency, row_phase : int
        The rows of amplitude, frequency and phase; -1 for none.

    """
    centre = 0.5 * (t[0] + t[-1])
    omega = 2.0 * math.pi * frequency
    known = -1.0
    mean = d_mean = turn = sine = cosine = sine_turn = cosine_turn = anchor = 0.0
    turned = 0
    for i in range(value.size):
        h = t[i + 1] - t[i]
        angle = omega * (t[i] + 0.5 * h - centre) + phase
        if abs(h - known) > _SAME * h:
            known = h
            half = 0.5 * omega * h
            mean = math.sin(half) / half if half > 1e-4 else 1.0 - half * half / 6.0
            d_mean = (math.cos(half) - mean) / frequency
            turn = omega * h
            sine_turn = math.sin(turn)
            cosine_turn = math.cos(turn)
            turned = _TURNS
        turned += 1
        astray = angle - (anchor + turned * turn)
        if turned > _TURNS or abs(astray) > _ASTRAY:
            turned = 0
            anchor = angle
            astray = 0.0
            sine = math.sin(angle)
            cosine = math.cos(angle)
        else:
            ahead = sine * cosine_turn + cosine * sine_turn
            cosine = cosine * cosine_turn - sine * sine_turn
            sine = ahead
        # The stamps' own rounding, to first order.
        now = sine + astray * cosine
        value[i] += amplitude * mean * now
        if row >= 0:
            slope = amplitude * mean * (cosine - astray * sine)
            d_value[row, i] += mean * now
            d_value[row_frequency, i] += amplitude * d_mean * now
            d_value[row_frequency, i] += slope * (angle - phase) / frequency
            d_value[row_phase, i] += slope
