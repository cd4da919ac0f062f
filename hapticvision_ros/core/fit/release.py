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

"""The release of a trial: how fast the tool left, and from when on the object was free."""

import math

from hapticvision_ros.core.fit.exponential import MIN_SAMPLES
from hapticvision_ros.core.records import Segmentation, Signal, Trial
import numpy as np

_LAST = 1.0
"""The height at the end of a hold is that of its last second [s], or of its last samples."""
_LAST_SAMPLES = 4
_FEW = 3


def start_of_recovery(
    trial: Trial, segmentation: Segmentation, released: float
) -> tuple[float | None, str]:
    """Return when the recovery starts and a caution, or None and why there is no recovery."""
    lost = segmentation.t_loss
    only_tool = trial.displacement_source == 'tool'
    if lost is not None and not only_tool:
        return lost, ''
    record = trial.force.between(released, segmentation.t_end)
    if len(record) < MIN_SAMPLES:
        return None, 'the record ends with the hold'
    force = record.value - segmentation.force_zero
    late = np.array_split(force, 2)[1]
    kept = float(np.median(late))
    spread = float(np.quantile(late, 0.84) - np.quantile(late, 0.16)) / 2.0
    before = trial.force.between(segmentation.t_hold or released, released)
    held = float(np.median(before.value)) - segmentation.force_zero if len(before) else kept
    if kept <= max(3.0 * spread, 0.005 * held):
        return None, (
            "there is no height but the tool's, and it left the object"
            if only_tool
            else 'the loss of contact was not found'
        )
    if kept > 0.5 * held:
        return None, 'the tool did not withdraw'
    unsteady = np.flatnonzero(np.abs(force - kept) > max(0.5 * kept, 3.0 * spread))
    start = float(record.t[min(unsteady[-1] + 1, force.size - 1)]) if unsteady.size else released
    if segmentation.t_end - start < 0.2 * (segmentation.t_end - released):
        return None, 'the tool was not kept on the object steadily while it recovered'
    return start, (
        f'the tool was kept on the recovering object with {kept:.2g} N: eq. (10) assumes none'
    )


def pressed_in(trial: Trial, segmentation: Segmentation, released: float) -> tuple[float, float]:
    """
    Return H(T_e) and its standard error [m].

    From the tool it has the error of the contact height, which no number of samples of the hold
    makes smaller.
    """
    begun = -math.inf if segmentation.t_hold is None else segmentation.t_hold
    if segmentation.contact_height is not None:
        height, error = _before(trial.tool_height, begun, released)
        if math.isfinite(height):
            error = math.hypot(error, segmentation.contact_height_std)
            return segmentation.contact_height - height, error
    if trial.displacement_height is not None:
        return _before(trial.displacement_height, begun, released)
    return math.nan, math.inf


def _before(signal: Signal, begun: float, released: float) -> tuple[float, float]:
    """Return a height at the end of a hold and its standard error [m]."""
    span = max(_LAST, _LAST_SAMPLES * sampling_interval(signal))
    record = signal.between(max(released - span, begun), released)
    if not len(record):
        return math.nan, math.inf
    error = float(record.value.std()) / math.sqrt(len(record))
    if len(record) < _FEW:
        # These tell no noise: the height may be anywhere between theirs and their neighbours'.
        first, last = np.searchsorted(signal.t, (record.t[0], record.t[-1]))
        error = float(np.ptp(signal.value[slice(max(int(first) - 1, 0), int(last) + 2)]))
    return float(np.median(record.value)), error


def withdrawal_speed(trial: Trial, released: float, lost: float) -> float:
    """Return the mean speed of the tool between T_e and the loss of contact [m/s]."""
    duration = max(lost - released, 2.0 * sampling_interval(trial.tool_height))
    rise = trial.tool_height.at(np.array([released, released + duration]))
    return max(float(rise[1] - rise[0]) / duration, 0.0)


def sampling_interval(signal: Signal) -> float:
    """Return the median time between samples [s], from about a thousand pairs."""
    if len(signal) < 2:
        return 0.0
    pairs = np.linspace(0, len(signal) - 2, min(len(signal) - 1, 1000)).astype(np.intp)
    return float(np.median(signal.t[pairs + 1] - signal.t[pairs]))
