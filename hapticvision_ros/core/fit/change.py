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

"""
By how much chi squared changes on unseen trials, by channel, phase and trial, each with its error.

Over several trials the error is that over these. In one trial nothing is repeated, and it is what
the noise of the sensor makes: of the squares of two residuals of the same samples the
difference is linear in the noise, whose level and correlation in time are known.
"""

from collections.abc import Mapping, Sequence
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.diagnosis.records import Channel, ErrorChange, ErrorChanges, Phase
from hapticvision_ros.core.fit.campaign import pairs_of, Segmented, TrialFit
from hapticvision_ros.core.fit.held_out import CHANNELS, labels, PHASES, phases_at, signals
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray

_FINEST: Final = 4
"""Places of a grid for each sample, at most."""


class _Sums(NamedTuple):
    """Samples of a trial, the change of their squares over the noise, and its variance."""

    samples: int
    change: float
    variance: float


class _Compared(NamedTuple):
    """
    Samples of one channel of a trial that two models are held against.

    `step` and `both` are the residual of the one after less, and with, that of the one before,
    over the noise of a sample, which is `size`.
    """

    t: FloatArray
    phase: NDArray[np.intp]
    step: FloatArray
    both: FloatArray
    interval: float
    size: float

    @classmethod
    def of(
        cls, old: TrialFit, new: TrialFit, channel: Channel, phases: Segmentation, size: float
    ) -> '_Compared':
        """Return the samples that both models are held against."""
        (measured, fitted), (again, other) = (signals(one, channel) for one in (old, new))
        t, mine, its = np.intersect1d(measured.t, again.t, return_indices=True)
        before = (measured.value - fitted)[mine] / size
        after = (again.value - other)[its] / size
        interval = 1.0
        if t.size > 1:
            # Samples may come in bursts: the grid of a correlation is not to be as fine.
            interval = max(float(np.median(np.diff(t))), float(t[-1] - t[0]) / (_FINEST * t.size))
        return cls(t, phases_at(t, phases), after - before, after + before, interval, size)

    def summed(self, inside: NDArray[np.bool_], sensor: SensorNoise) -> _Sums:
        """Return the sums over some of them."""
        step = self.step[inside]
        # Of (a + n)^2 - (b + n)^2 the noise n makes 2 (a - b) n.
        noise = _variance(2.0 * step, self.t[inside], self.interval, sensor) / self.size**2
        return _Sums(step.size, float(step @ self.both[inside]), noise)


def error_changes(
    before: Sequence[TrialFit | None],
    after: Sequence[TrialFit | None],
    campaign: Sequence[Segmented],
    noise: Noise,
    sensors: Mapping[Channel, SensorNoise],
) -> ErrorChanges:
    """
    Return by how much chi squared changes from one model to the other.

    Parameters
    ----------
    before, after : sequence of (TrialFit or None)
        The trials beside either model, which has not seen them.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The same trials as measured, with their phases.
    noise : Noise
        Of one sample, to which chi squared refers.
    sensors : mapping of Channel to SensorNoise
        The noise with its correlation in time.

    Returns
    -------
    ErrorChanges
        Over the samples that both models are held against; without a channel that has none, or
        whose noise is unknown.

    """
    level = {'force': noise.force.value, 'height': noise.height.value}
    total: dict[Channel, list[_Sums]] = {}
    by_phase: dict[tuple[Channel, Phase], list[_Sums]] = {}
    by_trial: dict[tuple[str, Channel], _Sums] = {}
    for label, old, new, (_, phases) in zip(
        labels(campaign), before, after, pairs_of(campaign), strict=True
    ):
        if old is None or new is None:
            continue
        for channel in CHANNELS:
            size, sensor = level[channel], sensors.get(channel)
            if not size or sensor is None:
                continue
            compared = _Compared.of(old, new, channel, phases, size)
            if not compared.t.size:
                continue
            whole = compared.summed(np.ones(compared.t.size, np.bool_), sensor)
            total.setdefault(channel, []).append(whole)
            by_trial[label, channel] = whole
            for index, name in enumerate(PHASES):
                inside = compared.phase == index
                if inside.any():
                    part = compared.summed(inside, sensor)
                    by_phase.setdefault((channel, name), []).append(part)
    return ErrorChanges(
        {key: _over_trials(sums) for key, sums in total.items()},
        {key: _over_trials(sums) for key, sums in by_phase.items()},
        {key: _of_one(sums) for key, sums in by_trial.items()},
    )


def _variance(weight: FloatArray, t: FloatArray, interval: float, noise: SensorNoise) -> float:
    """Return the variance of a weighted sum of samples with the noise of a sensor."""
    if not weight.size:
        return 0.0
    white = noise.white**2 * float(weight @ weight)
    place = np.round((t - t[0]) / interval).astype(np.intp)
    even = np.bincount(place, weight)
    # The correlation of the weights with themselves, at all lags at once.
    spectrum = np.abs(np.fft.rfft(even, 2 * even.size)) ** 2
    alike = np.fft.irfft(spectrum, 2 * even.size)[: even.size]
    alike[1:] *= 2.0
    lag = interval * np.arange(even.size)
    slow = noise.slow**2 * float(alike @ np.exp(-lag / noise.correlation_time))
    wander = noise.wander**2 * float(alike @ np.exp(-lag / noise.wander_time))
    return max(white + slow + wander, 0.0)


def _of_one(sums: _Sums) -> ErrorChange:
    """Return the change in one trial, with the error that the noise makes."""
    return ErrorChange(
        sums.samples, sums.change / sums.samples, math.sqrt(sums.variance) / sums.samples
    )


def _over_trials(sums: Sequence[_Sums]) -> ErrorChange:
    """Return the change over trials, with the error over these where there are several."""
    if len(sums) == 1:
        return _of_one(sums[0])
    count = np.array([each.samples for each in sums])
    change = np.array([each.change for each in sums])
    mean = float(change.sum() / count.sum())
    # The jackknife of a ratio of two sums: long trials draw it to themselves.
    off = (change - mean * count) / (count.sum() - count)
    std = math.sqrt(float(off @ off) * (len(sums) - 1) / len(sums))
    return ErrorChange(int(count.sum()), mean, std)
