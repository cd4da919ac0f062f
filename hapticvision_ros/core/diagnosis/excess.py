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
A residual that is louder or slower in contact than without.

What has no smooth form, or another one in each trial, passes for noise in a fit that takes its
noise from its own residual. Without contact no model can be wrong: the sensors' noise is seen
there.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Final, Literal, NamedTuple

from hapticvision_ros.core.diagnosis.refit import Refit
from hapticvision_ros.core.fit.campaign import calm, height_blocks, quietest, without_contact
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.noise import in_motion, of_neighbours, rounding
from hapticvision_ros.core.fit.noise_model import (
    Blocks,
    deviance,
    estimate,
    Record,
    SensorNoise,
)
from hapticvision_ros.core.outliers import runs
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray

_FEWEST: Final = 64
"""Samples without contact, in all trials together, that tell the noise."""
_OWN: Final = 16
"""Those of one trial from which on it may be noisier than the others."""
_FEW: Final = 32
"""Samples in contact, of a trial or of all together, that tell how loud it is."""
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
_APPROACH: Final = 0.1
"""Part of what is seen before the touch in which a slow sensor may see the push already."""
_OTHER: Final = 14.0
"""
Fall of the deviance without contact beside the noise of the fit, which has then another form.

By chance it falls so far once in a thousand: chi squared of two degrees of freedom.
"""
_SLOW: Final = 0.5
"""Slow noise of the fit over all noise without contact that is more than an arm's ripple."""
_SLOWER: Final = 2.0
"""What is left of either in a mean over long, one over the other, where the fit's is slower."""
_LOUDER: Final = 1.1
"""
Residual in contact, away from changes of speed, over the noise, that slow noise makes at least.

At these the tool's own way may be off for a moment, which a fit takes for slow noise as well.
"""
_OUTLYING: Final = 6.0
"""Residual over the noise from which on a sample that was set aside is still astray."""
_LONGEST_GLITCH: Final = 0.05
"""Time that a glitch of a load cell lasts at most [s]."""
_LARGEST: Final = 1e100
"""Residual that is counted at most, whose square is a number [N]."""
_FEWEST_BURSTS: Final = 6
_CHANCE: Final = 1e-6
"""Bursts in one phase, and the probability of so many there, if they came at any time."""
_COARSE: Final = 0.3
"""Rounding over the noise without contact, above which the latter may be hidden by it."""


@dataclass(frozen=True, slots=True)
class Excess:
    """
    A residual that is louder or slower in contact than without.

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
    memory : float
        How long what is left goes on, where noise without contact does not [s]; otherwise zero.

    """

    channel: Literal['force', 'displacement height']
    ratio: float
    trial: str
    trial_ratio: float
    memory: float = 0.0

    def __str__(self) -> str:
        """Return what was found as a sentence."""
        return (
            f'{self.channel}, in contact: the residual is {self.ratio:.2g} times the noise '
            f'without contact, {self.trial_ratio:.2g} times in {self.trial}, '
            + (
                f'and goes on for about {self.memory:.2g} s, which the noise without contact does '
                f'not'
                if self.memory
                else 'in no smooth form'
            )
        )


@dataclass(frozen=True, slots=True)
class Bursts:
    """
    Bursts of the force that come in one phase, as glitches of a load cell do not.

    Parameters
    ----------
    phase : {'push', 'hold'}
        Where.
    count, total : int
        How many come there, and at all.
    rms : float
        Root mean square of the samples that stand out there [N].
    share : float
        Their squares over those of the noise of all samples.

    """

    phase: Literal['push', 'hold']
    count: int
    total: int
    rms: float
    share: float

    def __str__(self) -> str:
        """Return what was found as a sentence."""
        return (
            f'force, {self.phase}: {self.count} of {self.total} bursts of a few samples, '
            f'{self.rms:.3g} N rms, come there, which glitches of a load cell would not'
        )


@dataclass(frozen=True, slots=True)
class Stretch:
    """
    Where the force stands off the model at once, for longer than a glitch, and comes back so.

    Parameters
    ----------
    phase : {'push', 'hold'}
        Where.
    trials : tuple of str
        In which trials.
    longest : float
        How long it lasts at most [s].
    rms : float
        Root mean square of what the samples there are off by [N].
    share : float
        Their squares over those of the noise of all samples.

    """

    phase: Literal['push', 'hold']
    trials: tuple[str, ...]
    longest: float
    rms: float
    share: float

    def __str__(self) -> str:
        """Return what was found as a sentence."""
        more = '' if len(self.trials) == 1 else f' and {len(self.trials) - 1} more'
        return (
            f'force, {self.phase}: from one sample to the next it stands off by {self.rms:.3g} N '
            f'rms, for up to {self.longest:.2g} s, in {self.trials[0]}{more}, which is no glitch '
            'of a load cell; the samples were set aside'
        )


@dataclass(frozen=True, slots=True)
class Ended:
    """
    Readings at which the range of the load cell has ended.

    Parameters
    ----------
    count, total : int
        How many, of how many.
    rms : float
        Root mean square of what the model says there beyond the reading [N].
    share : float
        Their squares beyond the noise, over those of the noise of all samples.

    """

    count: int
    total: int
    rms: float
    share: float

    def __str__(self) -> str:
        """Return what was found as a sentence."""
        return (
            f'force: {self.count} of {self.total} samples read the greatest force of their trial, '
            f'again and again, {self.rms:.3g} N rms beside the model, as at the end of the load '
            "cell's range"
        )


def ended(found: Refit) -> Ended | None:
    """
    Return what the end of a load cell's range hides.

    Parameters
    ----------
    found : Refit
        The model.

    Returns
    -------
    Ended or None
        None where no reading is at the end.

    """
    count, total, squares = 0, 0, 0.0
    for index, trial in enumerate(found.problem.trials):
        samples = trial.samples
        total += samples.force.size
        if samples.ended is None:
            continue
        full = trial.full_rate
        predicted = found.problem.predict(found.state, index, full, directions=False).force
        _, force_zero, _ = found.problem.own(found.state, index)
        left = (samples.force - force_zero - predicted)[samples.ended]
        count += left.size
        squares += float(left @ left)
    if not count:
        return None
    variance = found.force_noise.std**2
    share = max(squares - count * variance, 0.0) / (total * variance)
    return Ended(count, total, math.sqrt(squares / count), share)


def bursts(found: Refit, phases: Sequence[Segmentation]) -> Bursts | Stretch | None:
    """
    Return what samples which were set aside make of one phase: bursts, or a whole stretch.

    Parameters
    ----------
    found : Refit
        The model.
    phases : sequence of Segmentation
        Of its trials.

    Returns
    -------
    Bursts, Stretch or None
        None where such samples are few, or come at any time.

    """
    from scipy.special import bdtrc

    parts: dict[Literal['push', 'hold'], list[tuple[int, int, float]]] = {'push': [], 'hold': []}
    stretches: dict[Literal['push', 'hold'], list[_Run]] = {'push': [], 'hold': []}
    total = count = 0
    problem, noise = found.problem, found.force_noise.std
    for index, (trial, phase) in enumerate(zip(problem.trials, phases, strict=True)):
        full = trial.full_rate
        predicted = problem.predict(found.state, index, full, directions=False).force
        residual = full.force - predicted - problem.own(found.state, index)[1]
        taken = np.ones(full.middle.size, dtype=np.bool_)
        if full.samples.missing is not None:
            taken = ~full.samples.missing
        # What the way of the tool leaves open there stands off as far.
        unknown = np.interp(full.middle, trial.middle, found.jumps[index])
        beyond = np.abs(residual) > _OUTLYING * np.sqrt(noise**2 + unknown)
        astray = taken & ~full.samples.good & beyond
        starts = np.array([first for first, _ in runs(astray)], dtype=np.intp)
        total += starts.size
        count += int(np.count_nonzero(taken))
        stop = trial.t_stop if phase.t_hold is None else phase.t_hold
        end = float(trial.t[-1]) if trial.t_release is None else trial.t_release
        bounds: dict[Literal['push', 'hold'], tuple[float, float]] = {
            'push': (trial.t_contact, stop),
            'hold': (stop, end),
        }
        for name, (first, last) in bounds.items():
            inside = taken & (full.middle > first) & (full.middle < last)
            # A reading may be the largest number that there is.
            loud = np.minimum(np.abs(residual[astray & inside]), _LARGEST)
            squares = float(np.sum(loud**2))
            parts[name].append(
                (int(np.count_nonzero(inside[starts])), int(np.count_nonzero(inside)), squares)
            )
            stretches[name] += _long_runs(full, residual, astray & inside, float(predicted.max()))
    for name, found_runs in stretches.items():
        if found_runs:
            squares, samples = sum(r.squares for r in found_runs), sum(r.size for r in found_runs)
            return Stretch(
                name,
                tuple(dict.fromkeys(r.trial for r in found_runs)),
                max(r.lasts for r in found_runs),
                math.sqrt(squares / samples),
                squares / (count * noise**2),
            )
    best: Bursts | None = None
    for name, each in parts.items():
        there, samples = sum(one[0] for one in each), sum(one[1] for one in each)
        if there < _FEWEST_BURSTS or bdtrc(there - 1, total, samples / count) > _CHANCE:
            continue
        squares = sum(one[2] for one in each)
        made = Bursts(name, there, total, math.sqrt(squares / there), squares / (count * noise**2))
        if best is None or made.count > best.count:
            best = made
    return best


def louder(found: Refit, phases: Sequence[Segmentation]) -> tuple[Excess, ...]:
    """
    Return the channels whose residual is louder in contact than without, or slower.

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
    in_air = [each for each in map(_heights, problem.trials) if each is not None]
    height_interval = next((t.height_interval for t in problem.trials if t.height_t.size), 1.0)
    single = _single(in_air, found.height_noise, height_interval)
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
            averaged = None
            if single.std > 0.0:
                left = single.std_of_mean(full.height_count, full.height_interval)
                # What stamps that are off make of a surface that moves is no noise of the sensor.
                residual /= np.sqrt(1.0 + height_blocks(full).extra / left**2)
                if np.any(full.height_count > 1.0):
                    averaged = _Averaged(single.std, left)
            # What the range sensor sees of the recovery is no silence.
            parts = _parted(full.height_t, residual, trial, phase, averaged, after=False)
            heights.append((trial.name, *parts))
    first = problem.trials[0]
    least_force, least_height = quietest(problem.trials)
    alike = _alike(found.force_noise, first.interval)
    height_alike = _alike(found.height_noise, height_interval)
    coarse = max(rounding(t.samples.force[t.samples.good]) for t in problem.trials)
    height_coarse = max(rounding(t.full_rate.height) for t in problem.trials)
    force_memory = height_memory = 0.0
    free = [each for each in map(without_contact, problem.trials) if each is not None]
    air = [_quiet(blocks, rest) for blocks, rest, _ in free]
    if coarse < _COARSE * found.force_noise.std:
        force_memory = _slower(air, found.force_noise, first.interval, least_force)
    if height_coarse < _COARSE * found.height_noise.std:
        height_memory = _slower(in_air, found.height_noise, height_interval, least_height)
    held = (
        _held('force', forces, alike, least_force, coarse, memory=force_memory),
        _held(
            'displacement height',
            heights,
            height_alike,
            least_height,
            height_coarse,
            memory=height_memory,
        ),
    )
    return tuple(each for each in held if each is not None)


class _Run(NamedTuple):
    """A run of samples that stand off: where, how many, their squares [N^2], how long [s]."""

    trial: str
    size: int
    squares: float
    lasts: float


def _long_runs(
    full: FitTrial, residual: FloatArray, astray: NDArray[np.bool_], largest: float
) -> list[_Run]:
    """Return the runs that last for longer than a glitch, of a load cell that goes on reading."""
    made = []
    for first, last in runs(astray):
        lasts = float(full.middle[last - 1] - full.middle[first])
        off, read = residual[first:last], full.force[first:last]
        # A cell that hangs, or tells more than any force of the push, has failed.
        if last - first < _FEWEST_BURSTS or lasts < _LONGEST_GLITCH or np.ptp(read) == 0.0:
            continue
        if float(np.median(np.abs(off))) < largest:
            made.append(_Run(full.name, off.size, float(off @ off), lasts))
    return made


def _before(trial: FitTrial, first: float) -> float:
    """Return until when nothing is seen of the push, of a record that begins at `first`."""
    return trial.t_contact - _APPROACH * max(trial.t_contact - first, 0.0)


def _heights(trial: FitTrial) -> Record | None:
    """Return the heights before the touch."""
    full = trial.full_rate
    count = 0
    if full.height_t.size:
        count = int(np.searchsorted(full.height_t, _before(trial, float(full.height_t[0]))))
    if count < 2:
        return None
    blocks = height_blocks(full)
    early = Blocks(blocks.duration[:count], blocks.count[:count], np.zeros(count))
    return _quiet(early, full.height[:count])


def _quiet(blocks: Blocks, value: FloatArray) -> Record:
    """Return what is seen without contact about a zero of its own."""
    return Record(blocks, value, np.zeros((0, value.size)), np.ones((1, value.size)))


def _single(air: Sequence[Record], noise: SensorNoise, interval: float) -> SensorNoise:
    """Return the noise of one height, of a range sensor that is seen in means of several."""
    averaged = any(bool(np.any(each.blocks.count > 1.0)) for each in air)
    if not averaged or not _told(air) or noise.std == 0.0 or noise.correlation_time <= 0.0:
        return noise
    return estimate(air, noise, interval)


def _told(air: Sequence[Record]) -> bool:
    """Return whether what is seen without contact tells the noise."""
    return sum(int(np.count_nonzero(each.blocks.count)) for each in air) >= _FEWEST


def _slower(air: Sequence[Record], noise: SensorNoise, interval: float, least: float) -> float:
    """
    Return the memory of the noise of a fit, if the sensor's own is not as slow.

    A fit takes for slow noise whatever it lacks that goes on for as long as noise may.
    """
    if not _told(air) or noise.correlation_time <= interval:
        return 0.0
    own = estimate(air, noise, interval)
    if noise.slow < _SLOW * own.std or own.std <= least:
        return 0.0
    if noise.over_long(interval) < _SLOWER**2 * own.over_long(interval):
        return 0.0
    other = deviance(air, noise) - deviance(air, own) > _OTHER
    return noise.correlation_time if other else 0.0


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


def _about_its_mean(part: FloatArray) -> FloatArray:
    """Return what is seen less its mean: exactly nothing of what is always the same."""
    return part - part.mean() if np.ptp(part) > 0.0 else np.zeros(part.size)


class _Averaged(NamedTuple):
    """How noisy each sample of a record was, and what is left of that in each of its means."""

    single: float
    left: FloatArray


def _parted(
    t: FloatArray,
    residual: FloatArray,
    trial: FitTrial,
    phase: Segmentation,
    averaged: _Averaged | None = None,
    *,
    after: bool,
) -> tuple[list[FloatArray], FloatArray]:
    """
    Return the residual without contact, less its means, before and after, and in contact.

    Of a record that is averaged, as if each sample were there.
    """
    loss = phase.t_end if phase.t_loss is None else phase.t_loss
    first = float(t[0]) if t.size else trial.t_contact
    silent = [t < _before(trial, first)]
    if after:
        silent.append(t > loss + _SETTLING * (loss - trial.t_contact))
    silent = [each for each in silent if each.any()]
    quiet = [_about_its_mean(residual[each]) for each in silent]
    pressed = (t > trial.t_contact) & (t < loss)
    loud = residual[pressed]
    if averaged is not None:
        single, left = averaged
        quiet = [part * (single / left[each]) for part, each in zip(quiet, silent, strict=True)]
        # What acts in contact is in all that was averaged alike.
        lost = np.sqrt(np.maximum(single**2 - left[pressed] ** 2, 0.0))
        loud = np.copysign(np.hypot(loud, lost), loud)
    return quiet, loud


def _held(
    channel: Literal['force', 'displacement height'],
    parts: Sequence[tuple[str, list[FloatArray], FloatArray]],
    alike: float,
    least: float,
    coarse: float = 0.0,
    *,
    memory: float,
) -> Excess | None:
    """Return by how much a channel is louder in contact, if it is or goes on for longer."""
    # Of each trial, as a sensor may be noisier in one, in the air as well.
    levels = [_level(quiet, loud, coarse) for _, quiet, loud in parts]
    size = sum(count for _, count in levels)
    told = math.sqrt(sum(count * level**2 for level, count in levels) / max(size, 1))
    whole = np.concatenate([np.empty(0), *(each[2] for each in parts)])
    if size < _FEWEST or whole.size < _FEW:
        return None
    noise = max(told, least)
    # A standard deviation is known to one over the root of twice the samples.
    unsure = _SIGMAS * math.sqrt(0.5 * alike / size)
    ratios = []
    # One sample that is astray is no trial that is louder.
    known = [each for each in parts if each[2].size >= _FEW]
    squares = 0.0
    for (name, _, loud), (level, count) in zip(parts, levels, strict=True):
        if not loud.size:
            continue
        own = noise
        if count >= _OWN:
            own = max(noise, level * (1.0 - _SIGMAS * math.sqrt(0.5 * alike / count)))
        squares += float(loud @ loud) / own**2
        if loud.size >= _FEW or not known:
            error = _SIGMAS * math.sqrt(0.5 * alike / loud.size)
            ratios.append((math.sqrt(float(np.mean(loud**2))) / own, name, error))
    worst, name, error = max(ratios)
    ratio = math.sqrt(squares / whole.size)
    unsure_whole = math.hypot(unsure, _SIGMAS * math.sqrt(0.5 * alike / whole.size))
    quieter = ratio < _LOUD + (unsure if known else unsure_whole)
    quieter &= not known or worst < _LOUD_TRIAL + math.hypot(unsure, error)
    if ratio < _LOUDER:
        memory = 0.0
    if quieter and memory == 0.0:
        return None
    return Excess(channel, ratio, name, worst, memory)


def _level(parts: Sequence[FloatArray], loud: FloatArray, coarse: float) -> tuple[float, int]:
    """Return the noise of a sensor that what is seen of it at rest tells, and from how many."""
    size = sum(part.size for part in parts)
    squares = 0.0
    for part in parts:
        # A coarse sensor may read the same at rest, and rounds in motion.
        told = in_motion(part, coarse) if coarse > 0.0 else 0.0
        if np.ptp(part) == 0.0:
            # A height that is taken from the tool once it touches shows its noise in contact.
            told = max(told, of_neighbours(loud))
        squares += max(float(part @ part), part.size * told**2)
    return math.sqrt(squares / max(size, 1)), size
