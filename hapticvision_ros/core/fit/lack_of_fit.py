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
What a model leaves of the residual: its size, whether it is white or smooth, what it goes with.

The residual of each trial is made white by the noise of the sensors (its level and its correlation
in time), as the model that misses least shows it beside what is smooth. Of a model that lacks
nothing it is then white and of size 1. What is left is held against smooth curves over each phase
of each trial, which belong to no model, and against where the tool is and how fast it goes.

References
----------
G. M. Ljung and G. E. P. Box, Biometrika 65, 1978, 297-303, doi:10.1093/biomet/65.2.297 (whether a
residual is white); G. E. P. Box and G. M. Jenkins, Time Series Analysis, 1970, ch. 11
(cross-correlation with an input that is whitened alike); E. B. Wilson and M. M. Hilferty, PNAS 17,
1931, 684-688, doi:10.1073/pnas.17.12.684 (chi squared by a normal deviate).

"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.diagnosis.records import (
    Channel,
    Goes,
    Leftover,
    Leftovers,
    Phase,
    SmoothCurve,
)
from hapticvision_ros.core.fit.campaign import (
    Fit,
    force_blocks,
    height_blocks,
    pairs_of,
    Segmented,
)
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.held_out import labels, PHASES, phases_at
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.fit.noise_model import (
    Blocks,
    estimate,
    louder,
    Record,
    SensorNoise,
    Whitener,
    whitener,
)
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray

_CORNERS: Final = np.array([0.0, 0.02, 0.06, 0.15, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0])
"""Where a curve over a phase has its corners, in parts of it: closer where most happens."""
_FEW_CORNERS: Final = np.array([0.0, 0.5, 1.0])
_PER_CORNER: Final = 3
"""Means of samples for each corner, without which there is no such curve."""
_LAGS: Final = 10
"""Lags of the correlation of a residual with itself that are looked at together."""
_FEWEST: Final = 32
"""Means of samples from which on a residual may be told from white noise."""
_UNLIKELY: Final = 1e-3
"""Chance of what smooth curves take out of noise, below which they have a part of it."""
_LOUDER: Final = 1.1
"""Noise in contact over that which chi squared refers to, from which on it is no noise alone."""
_ALIKE: Final = 1.5
"""Noise before the touch over the latter, or the other way round, at most, to be that noise."""
_FEW: Final = 8
_CLEAR: Final = 2.0
"""Means of samples before the touch that tell anything, and samples next to it that do not."""
_FEW_TRIALS: Final = 5
"""Trials from which on their order may go with something."""
_LONGEST: Final = 1.0
"""Lag of the residual behind the tool, or before it, that is looked for at most [s]."""
_TIMES: Final = 4
"""From one lag of those to the next."""
_TOLD: Final = 1e-6
"""Singular value over the largest, below which a corner is not told."""
_MOVES: Final = 1e-9
"""Squares of an input over those that its size would make, below which it does not change."""


class _Record(NamedTuple):
    """
    One channel of one trial: its residual in blocks, when and in which phase these are.

    The interval between two samples [s] is the longest of all trials.
    """

    label: str
    channel: Channel
    blocks: Blocks
    t: FloatArray
    phase: NDArray[np.intp]
    residual: FloatArray
    trial: FitTrial
    segmentation: Segmentation
    interval: float

    @property
    def begins(self) -> dict[Phase, float | None]:
        """Return when the phases from the touch on begin [s]."""
        phases = self.segmentation
        times = phases.t_contact, phases.t_hold, phases.t_release, phases.t_loss
        return dict(zip(PHASES[1:], times, strict=True))


class _Curve(NamedTuple):
    """A smooth curve over the blocks that are `inside` a phase, and the squares it takes out."""

    phase: Phase
    inside: NDArray[np.bool_]
    t: FloatArray
    value: FloatArray
    std: FloatArray
    squares: float
    corners: int


@dataclass(frozen=True, slots=True)
class _Sums:
    """What is summed up over one phase of one channel of a trial, for any group of these."""

    record: _Record
    phase: Phase
    count: int
    total: float
    squares: float
    lagged: FloatArray
    inputs: FloatArray
    curve: _Curve | None
    raw: float
    left: float


def sensor_noise(
    fit: Fit, campaign: Sequence[Segmented], noise: Noise
) -> dict[Channel, SensorNoise]:
    """
    Return the noise of the sensors, by channel, without what is smooth in the residual.

    Parameters
    ----------
    fit : Fit
        The fit that misses least.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        What it was fitted to.
    noise : Noise
        Of a sample, which chi squared refers to: what is louder is no noise alone.

    Returns
    -------
    dict
        Level and correlation in time; without a channel that has no noise or no samples.

    """
    found: dict[Channel, SensorNoise] = {}
    memory = fit.noise.memory
    known: dict[Channel, tuple[SensorNoise, float, float | None]] = {
        'force': (fit.noise.force, memory.force, noise.force.value),
        'height': (fit.noise.height, memory.height, noise.height.value),
    }
    every = _records(fit, campaign)
    for channel, (start, longest, most) in known.items():
        records = [each for each in every if each.channel == channel]
        if not records or not most or start.std <= 0.0:
            continue
        interval = records[0].interval
        curves = [_curves(each, whitener(each.blocks, start)) for each in records]
        corners = sum(curve.corners for of in curves for curve in of)
        taken = sum(curve.squares for of in curves for curve in of)
        quiet = start
        if corners and _chance(taken, corners) < _UNLIKELY:
            bare = [_without(each, of) for each, of in zip(records, curves, strict=True)]
            blocks = sum(int(np.count_nonzero(each.blocks.count)) for each in records)
            # What the corners have taken out of the noise itself.
            lost = math.sqrt(blocks / max(blocks - corners, 1))
            quiet = louder(estimate(bare, start, interval, longest=longest), lost)
        loud = math.hypot(quiet.white, quiet.slow) / most
        if loud > _LOUDER:
            # What is neither smooth nor noise would pass for slow noise.
            air = [one for one in map(_before_contact, records) if one is not None]
            told = sum(one.residual.size for one in air) >= _FEWEST
            still = estimate(air, quiet, interval, longest=longest) if told else quiet
            # A sensor may read one and the same before the touch.
            quieter = most / _ALIKE < math.hypot(still.white, still.slow) < _ALIKE * most
            quiet = still if quieter else louder(quiet, 1.0 / loud)
        found[channel] = quiet
    return found


def _without(record: _Record, curves: Sequence[_Curve]) -> Record:
    """Return what a residual is beside its smooth curves."""
    left = record.residual.copy()
    for curve in curves:
        left[curve.inside] -= np.interp(record.t[curve.inside], curve.t, curve.value)
    nothing = np.empty((0, left.size))
    return Record(record.blocks, left, nothing, nothing)


def _before_contact(record: _Record) -> Record | None:
    """Return what a sensor has measured before the touch, about its zero; None if hardly any."""
    trial, blocks = record.trial, record.blocks
    count = int(np.searchsorted(record.t, trial.t_contact - _CLEAR * record.interval))
    if count < _FEW:
        return None
    value = (trial.force if record.channel == 'force' else trial.height)[:count]
    early = Blocks(blocks.duration[:count], blocks.count[:count], np.zeros(count))
    return Record(early, value, np.empty((0, count)), np.ones((1, count)))


def lack_of_fit(
    fit: Fit, campaign: Sequence[Segmented], noise: dict[Channel, SensorNoise]
) -> Leftovers:
    """
    Return what a model leaves of the trials that it was fitted to, by channel, phase and trial.

    Parameters
    ----------
    fit : Fit
        The model.
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        What it was fitted to.
    noise : dict
        Of the sensors, from `sensor_noise`: the same for all models that are compared.

    Returns
    -------
    Leftovers
        Without a channel that has no noise or no samples.

    """
    sums: list[_Sums] = []
    curves: list[SmoothCurve] = []
    for record in _records(fit, campaign):
        if record.channel not in noise:
            continue
        found = _summed(record, noise[record.channel])
        sums += found
        for each in found:
            if each.curve is not None:
                since = each.curve.t - (record.begins[each.phase] or 0.0)
                value, std = each.curve.value, each.curve.std
                curves.append(
                    SmoothCurve(record.label, record.channel, each.phase, since, value, std)
                )
    return Leftovers(
        noise,
        _grouped(sums, lambda each: each.record.channel),
        _grouped(sums, lambda each: (each.record.channel, each.phase)),
        _grouped(sums, lambda each: (each.record.label, each.record.channel)),
        tuple(curves),
    )


def _grouped[K](sums: Sequence[_Sums], key: Callable[[_Sums], K]) -> dict[K, Leftover]:
    """Return what is left of each group of phases."""
    groups: dict[K, list[_Sums]] = {}
    for each in sums:
        groups.setdefault(key(each), []).append(each)
    return {name: _leftover(parts) for name, parts in groups.items()}


def _records(fit: Fit, campaign: Sequence[Segmented]) -> list[_Record]:
    """Return both channels of all trials of a fit."""
    used = [
        (label, phases)
        for label, one, (_, phases) in zip(
            labels(campaign), fit.trials, pairs_of(campaign), strict=True
        )
        if one is not None
    ]
    trials = fit.problem.trials
    unsure = fit.problem.unsure(fit.state, fit.noise.blur)
    intervals: dict[Channel, float] = {
        'force': max(trial.interval for trial in trials),
        'height': max(trial.height_interval for trial in trials),
    }
    records = []
    for index, ((label, phases), trial) in enumerate(zip(used, trials, strict=True)):
        force, height = fit.problem.residual(fit.state, index)
        parts: list[tuple[Channel, FloatArray, FloatArray, Blocks]] = [
            ('force', force, trial.middle, force_blocks(trial, unsure[index]))
        ]
        if height.size:
            parts.append(('height', height, trial.height_t, height_blocks(trial)))
        for channel, residual, t, blocks in parts:
            phase, interval = phases_at(t, phases), intervals[channel]
            records.append(
                _Record(label, channel, blocks, t, phase, residual, trial, phases, interval)
            )
    return records


def _curves(record: _Record, white: Whitener) -> list[_Curve]:
    """Return the smooth curves over the phases from the touch on that have enough blocks."""
    residual = white(record.residual[np.newaxis])[0]
    found = []
    for index, phase in enumerate(PHASES[1:], start=1):
        inside = (record.phase == index) & (record.blocks.count > 0.0)
        curve = next(
            (
                curve
                for parts in (_CORNERS, _FEW_CORNERS)
                if (curve := _curve(record, phase, inside, parts, white, residual)) is not None
            ),
            None,
        )
        if curve is not None:
            found.append(curve)
    return found


def _curve(
    record: _Record,
    phase: Phase,
    inside: NDArray[np.bool_],
    parts: FloatArray,
    white: Whitener,
    residual: FloatArray,
) -> _Curve | None:
    """Return the smooth curve with corners at parts of a phase; None where these are not told."""
    if np.count_nonzero(inside) < _PER_CORNER * parts.size:
        return None
    t = record.t[inside]
    corners = t[0] + parts * (t[-1] - t[0])
    hats = np.zeros((parts.size, record.t.size))
    for k in range(parts.size):
        hats[k, inside] = np.interp(t, corners, np.eye(parts.size)[k])
    left, singular, right = np.linalg.svd(white(hats), full_matrices=False)
    # A corner without a sample near it is told by no other.
    if singular[-1] <= _TOLD * singular[0]:
        return None
    along = right @ residual
    value = left @ (along / singular)
    std = np.sqrt(np.sum((left / singular) ** 2, axis=1))
    return _Curve(phase, inside, corners, value, std, float(along @ along), parts.size)


def _summed(record: _Record, noise: SensorNoise) -> list[_Sums]:
    """Return the sums over each phase of a record."""
    white = whitener(record.blocks, noise)
    inputs = _inputs(record)
    whitened = white(np.vstack((record.residual[np.newaxis], inputs.reshape(-1, record.t.size))))
    residual, tool = whitened[0], whitened[1:].reshape(inputs.shape)
    curves = {curve.phase: curve for curve in _curves(record, white)}
    found = []
    for index, phase in enumerate(PHASES):
        inside = (record.phase == index) & (record.blocks.count > 0.0)
        if not inside.any():
            continue
        mine, its, weight = residual[inside], tool[:, :, inside], record.blocks.count[inside]
        raw = left = record.residual[inside]
        curve = curves.get(phase)
        if curve is not None:
            left = raw - np.interp(record.t[inside], curve.t, curve.value)
        lags = min(_LAGS, mine.size - 1)
        lagged = np.zeros(_LAGS)
        lagged[:lags] = [float(mine[k:] @ mine[:-k]) for k in range(1, lags + 1)]
        found.append(
            _Sums(
                record,
                phase,
                mine.size,
                float(mine.sum()),
                float(mine @ mine),
                lagged,
                np.stack((its.sum(axis=2), np.sum(its**2, axis=2), its @ mine)),
                curve,
                float(weight @ raw**2),
                float(weight @ left**2),
            )
        )
    return found


def _lags(interval: float) -> FloatArray:
    """Return the lags at which a residual is held against the tool [s]."""
    later, lag = [0.0], interval
    while 0.0 < lag <= _LONGEST:
        later.append(lag)
        lag *= _TIMES
    return np.array([*(-lag for lag in later[:0:-1]), *later])


def _inputs(record: _Record) -> FloatArray:
    """Return depth and speed of a tool that touches, at all lags; shape (2, lags, n) [m, m/s]."""
    trial, loss = record.trial, record.segmentation.t_loss
    touches = (trial.middle >= trial.t_contact) & (loss is None or trial.middle < loss)
    speed = np.where(touches, np.diff(trial.displacement) / trial.duration, 0.0)
    depth = np.where(touches, 0.5 * (trial.displacement[1:] + trial.displacement[:-1]), 0.0)
    at = record.t - _lags(record.interval)[:, np.newaxis]
    return np.stack([np.interp(at, trial.middle, each) for each in (depth, speed)])


def _leftover(parts: Sequence[_Sums]) -> Leftover:
    """Return what is left of a group of phases of one channel."""
    count = sum(each.count for each in parts)
    squares = sum(each.squares for each in parts)
    neighbours = white = smooth = share = depth = speed = order = None
    if count >= _FEWEST and squares > 0.0:
        alike = np.sum([each.lagged for each in parts], axis=0) / squares
        neighbours = float(alike[0])
        free = count - np.arange(1, _LAGS + 1)
        # Ljung and Box, of blocks of several records: pairs across two of them are left out.
        white = _chance(count * (count + 2.0) * float(np.sum(alike**2 / free)), _LAGS)
        depth, speed = _goes_with(parts, alike)
        order = _goes_with_order(parts)
    curves = [each.curve for each in parts if each.curve is not None]
    if curves:
        taken = sum(curve.squares for curve in curves)
        smooth = _chance(taken, sum(curve.corners for curve in curves))
        raw = sum(each.raw for each in parts)
        # Weighted otherwise, by chance they take out less than nothing.
        share = max(1.0 - sum(each.left for each in parts) / raw, 0.0) if raw > 0.0 else None
    return Leftover(
        count, math.sqrt(squares / count), neighbours, white, smooth, share, depth, speed, order
    )


def _goes_with(parts: Sequence[_Sums], alike: FloatArray) -> tuple[Goes | None, Goes | None]:
    """
    Return how a residual goes with depth and speed of the tool, each about its mean over a phase.

    What differs from trial to trial is no evidence: there are few of them. `alike` is how one mean
    goes with those after it.
    """
    shape = parts[0].inputs.shape[1:]
    size, inputs, products = np.zeros((3, *shape))
    own, count = 0.0, 0
    for each in parts:
        if each.phase == PHASES[0] or each.count < 2:
            continue
        sums, squares, with_it = each.inputs
        count += each.count
        own += each.squares - each.total**2 / each.count
        size += squares
        inputs += squares - sums**2 / each.count
        products += with_it - sums * each.total / each.count
    found: list[Goes | None] = []
    lags = _lags(parts[0].record.interval)
    moves = (inputs > _MOVES * size) & (own > 0.0)
    scale = np.sqrt(np.where(moves, inputs * own, 1.0))
    # As many as are independent, beside an input that goes slowly.
    free = count / _bunched(alike)
    for correlation in np.where(moves, products / scale, 0.0):
        most = int(np.argmax(np.abs(correlation)))
        value = float(correlation[most])
        chance = min(lags.size * math.erfc(abs(value) * math.sqrt(0.5 * free)), 1.0)
        known = value != 0.0 and math.isfinite(value)
        found.append(Goes(value, float(lags[most]), chance) if known else None)
    return found[0], found[1]


def _bunched(alike: FloatArray) -> float:
    """Return how many means count as one, by how alike those are that follow one another."""
    first, last = (max(float(one), 0.0) for one in alike[[0, -1]])
    total = 1.0 + 2.0 * float(np.sum(np.maximum(alike, 0.0)))
    if 0.0 < last < first < 1.0:
        # Beyond the lags that were looked at, as it has fallen so far.
        fall = (last / first) ** (1.0 / (alike.size - 1))
        total += 2.0 * last * fall / (1.0 - fall)
    return total


def _goes_with_order(parts: Sequence[_Sums]) -> Goes | None:
    """Return how the means over the trials go with their order; None of few trials."""
    means: dict[float, list[float]] = {}
    for phase in PHASES[1:]:
        mine = [each for each in parts if each.phase == phase]
        count = sum(each.count for each in mine)
        for each in mine:
            off = each.total - each.count * sum(one.total for one in mine) / count
            of = means.setdefault(each.record.trial.campaign_time, [0.0, 0.0])
            of[0] += off
            of[1] += each.count
    mean = np.array([total / count for _, (total, count) in sorted(means.items())])
    if mean.size < _FEW_TRIALS:
        return None
    rank = np.arange(mean.size) - 0.5 * (mean.size - 1)
    scale = math.sqrt(float(np.sum((mean - mean.mean()) ** 2) * np.sum(rank**2)))
    value = float(rank @ mean) / scale if scale > 0.0 else 0.0
    # Fisher's transformation; each trial counts once, however well its mean is known.
    deviate = math.atanh(min(abs(value), 1.0 - 1e-12)) * math.sqrt(mean.size - 3.0)
    return Goes(value, 0.0, math.erfc(deviate / math.sqrt(2.0)))


def _chance(squares: float, count: int) -> float:
    """Return the chance of a chi squared as large, by Wilson and Hilferty."""
    spread = 2.0 / (9.0 * count)
    deviate = ((max(squares, 0.0) / count) ** (1.0 / 3.0) - 1.0 + spread) / math.sqrt(spread)
    return 0.5 * math.erfc(deviate / math.sqrt(2.0))
