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
A residual that is louder in contact than without.

What has no smooth form, or another one in each trial, passes for noise in a fit that takes its
noise from its own residual. Without contact no model can be wrong: the sensors' noise is seen
there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Final, Literal

from hapticvision_ros.core.diagnosis.refit import Refit
from hapticvision_ros.core.fit.campaign import calm, quietest
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.noise import rounding
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray

_FEWEST: Final = 64
"""Samples without contact, in all trials together, that tell the noise."""
_FEW: Final = 32
"""Samples of a trial in contact that tell how loud it is."""
_NEAR: Final = 4.0
"""Intervals of the encoders about a change of speed in which the force may be off."""
_SETTLING: Final = 0.05
"""Part of a contact after it in which the object may still cling to the tool."""
_UNSURE: Final = 0.3
"""What the speed of a push is not known by makes in its force, over the noise, to leave it out."""
_SIGMAS: Final = 3.0
_LOUD: Final = 1.3
_LOUD_TRIAL: Final = 1.7
"""Residual over the noise, of all trials or of one, beyond its errors, that is more than noise."""


@dataclass(frozen=True, slots=True)
class Excess:
    """
    A residual that is louder in contact than without.

    Parameters
    ----------
    channel : {'force', 'displacement height'}
        Of what.
    ratio : float
        Root mean square in contact over that without, in all trials.
    trial : str
        Where it is loudest.
    trial_ratio : float
        The ratio there.

    """

    channel: Literal['force', 'displacement height']
    ratio: float
    trial: str
    trial_ratio: float

    def __str__(self) -> str:
        """Return what was found as a sentence."""
        return (
            f'{self.channel}, in contact: the residual is {self.ratio:.2g} times the noise '
            f'without contact, {self.trial_ratio:.2g} times in {self.trial}, in no smooth form'
        )


def louder(found: Refit, phases: Sequence[Segmentation]) -> tuple[Excess, ...]:
    """
    Return the channels whose residual is louder in contact than without.

    Parameters
    ----------
    found : Refit
        The model.
    phases : sequence of Segmentation
        Of its trials.

    Returns
    -------
    tuple of Excess
        The force, the height, both or none; a channel that is not seen long enough without
        contact is left out.

    """
    forces, heights = [], []
    problem = found.problem
    for index, (trial, phase) in enumerate(zip(problem.trials, phases, strict=True)):
        full = trial.full_rate
        prediction = problem.predict(found.state, index, full, directions=False)
        _, force_zero, height_zero = problem.own(found.state, index)
        t = full.middle
        good = calm(full, prediction.force, found.force_noise) & ~_turning(full, t)
        push, error = full.pushed
        if error * float(np.abs(prediction.force[push]).max(initial=0.0)) > (
            _UNSURE * found.force_noise.std
        ):
            good[push] = False
        residual = full.force - prediction.force - force_zero
        forces.append((trial.name, *_parted(t[good], residual[good], trial, phase, after=True)))
        if full.height_t.size:
            residual = full.height - prediction.height - height_zero
            # What the range sensor sees of the recovery is no silence.
            parts = _parted(full.height_t, residual, trial, phase, after=False)
            heights.append((trial.name, *parts))
    first = problem.trials[0]
    least_force, least_height = quietest(problem.trials)
    alike = _alike(found.force_noise, first.interval)
    height_alike = _alike(found.height_noise, first.height_interval)
    # A coarse load cell may read the same without contact, and round in it.
    coarse = max(rounding(t.samples.force[t.samples.good]) for t in problem.trials)
    held = (
        _held('force', forces, alike, least_force, coarse),
        _held('displacement height', heights, height_alike, least_height),
    )
    return tuple(each for each in held if each is not None)


def _alike(noise: SensorNoise, interval: float) -> float:
    """Return how many samples tell as much of the noise's size as one that is alone."""
    if noise.std == 0.0:
        return 1.0
    alike = (noise.slow / noise.std) ** 4 * noise.correlation_time
    if noise.wander > 0.0:
        alike += (noise.wander / noise.std) ** 4 * noise.wander_time
    return 1.0 + alike / interval


def _turning(trial: FitTrial, t: FloatArray) -> NDArray[np.bool_]:
    """Return which samples are near a change of the tool's speed."""
    events = np.array(sorted([*trial.path.events, trial.t_contact]))
    reach = _NEAR * max(trial.path.interval, trial.interval)
    after = np.searchsorted(events, t)
    since = t - events[np.maximum(after - 1, 0)]
    until = events[np.minimum(after, events.size - 1)] - t
    near: NDArray[np.bool_] = np.minimum(np.abs(since), np.abs(until)) < reach
    return near


def _parted(
    t: FloatArray, residual: FloatArray, trial: FitTrial, phase: Segmentation, *, after: bool
) -> tuple[FloatArray, FloatArray]:
    """Return the residual without contact, less its means, and in contact."""
    loss = phase.t_end if phase.t_loss is None else phase.t_loss
    quiet = [residual[t < trial.t_contact]]
    if after:
        quiet.append(residual[t > loss + _SETTLING * (loss - trial.t_contact)])
    return (
        np.concatenate([np.empty(0), *(part - part.mean() for part in quiet if part.size)]),
        residual[(t > trial.t_contact) & (t < loss)],
    )


def _held(
    channel: Literal['force', 'displacement height'],
    parts: Sequence[tuple[str, FloatArray, FloatArray]],
    alike: float,
    least: float,
    coarse: float = 0.0,
) -> Excess | None:
    """Return by how much a channel is louder in contact, if it is."""
    known = [each for each in parts if each[2].size >= _FEW]
    quiet = np.concatenate([np.empty(0), *(each[1] for each in parts)])
    if quiet.size < _FEWEST or not known:
        return None
    noise = max(math.hypot(math.sqrt(float(np.mean(quiet**2))), coarse), least)
    # A standard deviation is known to one over the root of twice the samples.
    unsure = _SIGMAS * math.sqrt(0.5 * alike / quiet.size)
    ratios = []
    for name, _, loud in known:
        error = _SIGMAS * math.sqrt(0.5 * alike / loud.size)
        ratios.append((math.sqrt(float(np.mean(loud**2))) / noise, name, error))
    worst, name, error = max(ratios)
    whole = np.concatenate([each[2] for each in known])
    ratio = math.sqrt(float(np.mean(whole**2))) / noise
    if ratio < _LOUD + unsure and worst < _LOUD_TRIAL + math.hypot(unsure, error):
        return None
    return Excess(channel, ratio, name, worst)
