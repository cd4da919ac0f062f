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


@kernel(error_model='numpy')
def _moments(pace, held, d_held):  # type: ignore[no-untyped-def]
    """
    Fill `held` with pace times the integral of exp(-pace (1 - x)) x^k over [0, 1], k = 0, 1, 2.

    That is what a lag keeps of a power of time at the end of a step, which is `pace` of the lag's
    time constants long; `d_held` is filled with the derivatives in `pace`.
    """
    if pace < 0.5:
        # The recursion below would divide rounding by a short step's square.
        for k in range(3):
            term = 1.0 / (k + 1)
            total = term
            d_total = term
            for j in range(1, 14):
                term *= -pace / (k + j + 1)
                total += term
                d_total += (j + 1) * term
            held[k] = pace * total
            d_held[k] = d_total
        return
    kept = math.exp(-pace)
    held[0] = 1.0 - kept
    d_held[0] = kept
    for k in range(1, 3):
        held[k] = 1.0 - k * held[k - 1] / pace
        d_held[k] = k * (held[k - 1] / pace - d_held[k - 1]) / pace


@kernel(error_model='numpy', fastmath={'contract'})
def lag(t, time_constant, value, d_value, row):  # type: ignore[no-untyped-def]
    """
    Put step means through a first-order lag that starts at rest with the first of them.

    A lag that is short beside the steps asks for what the signal is within them. The end of a step
    is on the line through two means before it or through two after it, whichever is less steep, so
    that a jump within a step is not drawn into the next. Between its ends a step is the parabola
    with its mean; one that goes further than the two lines at its ends jumps when its mean says,
    or is constant where the mean is not between its ends.

    Parameters
    ----------
    t : ndarray, shape (n + 1,)
        Ends of the steps [s].
    time_constant : float
        Of the lag [s]; zero for none.
    value : ndarray, shape (n,)
        Mean of the signal over each step; replaced by that of the lag.
    d_value : ndarray, shape (p, n)
        Its tangents; replaced too.
    row : int
        The row to which the derivative in the time constant is added; -1 for none.

    """
    rows = d_value.shape[0]
    last = value.size - 1
    state = value[0]
    start = value[0]
    # The mean before, as it was, and the line at the start of the step: half of what it rises by.
    old = value[0]
    rise = 0.0
    d_state = d_value[:, 0].copy()
    d_start = d_value[:, 0].copy()
    d_old = d_value[:, 0].copy()
    held = np.zeros(3)
    d_held = np.zeros(3)
    known = -1.0
    latest = -1.0
    even = 0
    before = 0.0
    kept = 0.0
    d_kept = 0.0
    pace = np.inf
    share = 0.0
    # Of the end of a parabola in the lag at its end: the weights of its start, its mean, its end.
    of_start = 0.0
    of_mean = 0.0
    of_end = 1.0
    d_of_start = 0.0
    d_of_mean = 0.0
    d_of_end = 0.0
    for i in range(last + 1):
        h = t[i + 1] - t[i]
        if abs(h - known) > _SAME * h:
            known = h
            share = time_constant / h
            if time_constant > 0.0:
                pace = 1.0 / share
                kept = math.exp(-pace)
                d_pace = -pace / time_constant
                d_kept = kept * pace / time_constant
                _moments(pace, held, d_held)
                bulge = held[1] - held[2]
                of_start = held[0] - held[1] - 3.0 * bulge
                of_mean = 6.0 * bulge
                of_end = held[1] - 3.0 * bulge
                d_bulge = d_held[1] - d_held[2]
                d_of_start = d_pace * (d_held[0] - d_held[1] - 3.0 * d_bulge)
                d_of_mean = d_pace * 6.0 * d_bulge
                d_of_end = d_pace * (d_held[1] - 3.0 * d_bulge)
        # How many steps in a row are as long as the one before them, up to the next but one.
        further = i + 2 <= last
        if further:
            length = t[i + 3] - t[i + 2]
            even = even + 1 if abs(length - latest) <= _SAME * length else 0
            latest = length
        mean = value[i]
        # The line through two means, by its half rise over a step: of the means before the end ...
        weight = 0.5
        ahead = 0.5
        if even < 3:
            weight = h / (h + before) if i > 0 else 0.0
            ahead = (t[i + 2] - t[i + 1]) / (t[i + 3] - t[i + 1]) if further else 0.0
        half = weight * (mean - old)
        end = mean + half
        # ... or of those after it.
        forward = False
        if further:
            half_ahead = ahead * (value[i + 2] - value[i + 1])
            if even < 3:
                steeper = abs(half) * (t[i + 2] - t[i + 1]) > abs(half_ahead) * h
            else:
                steeper = abs(half) > abs(half_ahead)
            if i == 0 or steeper:
                forward = True
                half = half_ahead
                end = value[i + 1] - half
        before = h
        jump = end - start
        smooth = abs(jump) <= 2.0 * (abs(rise) + abs(half))
        # What is left at the end of where the signal was, and of the jump in between.
        jumps = False
        fading = 0.0
        part = 0.0
        if smooth:
            after = kept * state + (of_start * start + of_mean * mean + of_end * end)
        else:
            jumps = jump * (end - mean) > 0.0 and jump * (mean - start) > 0.0
            if jumps:
                part = (end - mean) / jump
                if time_constant > 0.0:
                    fading = math.exp(-(1.0 - part) * pace)
                after = end - jump * fading + kept * (state - start)
            else:
                after = mean + kept * (state - mean)
        for j in range(rows):
            d_mean = d_value[j, i]
            d_end = d_mean + weight * (d_mean - d_old[j])
            if forward:
                d_next = d_value[j, i + 1]
                d_end = d_next - ahead * (d_value[j, i + 2] - d_next)
            if smooth:
                d_after = kept * d_state[j]
                d_after += of_start * d_start[j] + of_mean * d_mean + of_end * d_end
                if j == row:
                    d_after += d_kept * state
                    d_after += d_of_start * start + d_of_mean * mean + d_of_end * end
            elif jumps:
                d_jump = d_end - d_start[j]
                d_after = d_end - fading * d_jump + kept * (d_state[j] - d_start[j])
                if fading > 0.0:
                    d_after -= fading * pace * (d_end - d_mean - part * d_jump)
                if j == row and fading > 0.0:
                    d_after -= jump * fading * (1.0 - part) * pace / time_constant
                if j == row:
                    d_after += d_kept * (state - start)
            else:
                d_after = d_mean + kept * (d_state[j] - d_mean)
                if j == row:
                    d_after += d_kept * (state - mean)
            d_value[j, i] = d_mean - share * (d_after - d_state[j])
            if j == row:
                d_value[j, i] -= (after - state) / h
            d_old[j] = d_mean
            d_start[j] = d_end
            d_state[j] = d_after
        value[i] = mean - share * (after - state)
        old = mean
        rise = half
        start = end
        state = after


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
