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
How much the trials of a campaign differ among themselves, from repeats of the same push.

Repeats of a push are missed by a model in the same way, whatever it lacks; what differs between
them is scatter of the object or of the cell. Each trial is fitted with its own K1, C1 and C2, and
the differences between repeats, beyond what the sensors' noise makes of them, tell the scatter.
A steady change over the campaign (drying) is no scatter: it is taken out where it shows.

References
----------
S. R. Searle, G. Casella and C. E. McCulloch, Variance Components, 1992, ch. 3 (between and within
groups).

"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.fit.campaign import carried, Problem
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.least_squares import covariance, minimise
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri, fdtrc

_WIDE: Final = 0.5
"""Scatter of the logarithms that is allowed when it is measured."""
_SAME: Final = {'push_speed': 0.06, 'reach': 0.06, 'hold_time': 0.2}
"""
Relative difference of speed, depth and hold within which two pushes are the same; of one without a
hold, that of how deep it comes.
"""
_POOLED: Final = 3.0
"""Degrees of freedom that the likeliest common scatter counts for in each element."""
_TREND: Final = 0.01
"""Probability below which a change over the campaign is no chance."""
_SIZES: Final = (0.0, *np.geomspace(2e-4, 0.3, 180).tolist())
"""Scatter that is tried."""
_CAUTION: Final = 0.25
"""The scatter is taken as large as it is with this probability of being larger still."""
_SHORTEST_BLOCK: Final = 2
"""Trials that differ from all others, and of these, beside a repeat on the other side."""
_LEAST_DEGREES: Final = 3
"""Differences between repeats that show such trials."""
_BLOCK_SHARE: Final = 0.9
"""Part of what repeats differ by that is due to them."""
_BLOCK_CHANCE: Final = 1e-3
"""Probability of that where trials scatter."""
_DRAWS: Final = 10_000
_AT_ONCE: Final = 500
_CLEARER: Final = 0.5
"""
Variance that such trials leave, over that which a steady change leaves, to stand for it: between
repeats, times that of all trials where there are repeats.
"""
_SEED: Final = 20_250_102
LEAST: Final = 5e-4
"""Scatter below this is none."""


@dataclass(frozen=True, slots=True)
class Scatter:
    """
    What repeats tell of the scatter from trial to trial.

    Parameters
    ----------
    std : ndarray, shape (3,)
        Standard deviations of the logarithms of K1, C1 and C2; zeros where none shows.
    cautious : ndarray, shape (3,)
        The same, enlarged for how few repeats there are.
    degrees : int
        Differences between repeats of the same push.
    block : Block or None
        Trials that differ from all others, where that is no scatter.

    """

    std: FloatArray
    cautious: FloatArray
    degrees: int
    block: 'Block | None' = None


@dataclass(frozen=True, slots=True)
class Block:
    """
    Trials one after another that differ from their repeats, while all others agree.

    Parameters
    ----------
    first, last : int
        Indices of the first and of the last of them in time.
    change : float
        By how much K1, C1 and C2, taken together, are larger in them, relatively.
    rest : float
        Standard deviation of what is left between repeats, relatively.

    """

    first: int
    last: int
    change: float
    rest: float


def conditions(phases: Sequence[Segmentation]) -> list[list[int]]:
    """
    Return the trials of each push: same speed, depth and hold, and steps if there are any.

    Parameters
    ----------
    phases : sequence of Segmentation
        Of the trials.

    Returns
    -------
    list of list of int
        Indices of the trials, grouped; in the order of their first.

    """
    groups: list[list[int]] = []
    for index, one in enumerate(phases):
        for group in groups:
            if _alike(phases[group[0]], one):
                group.append(index)
                break
        else:
            groups.append([index])
    return groups


def _alike(one: Segmentation, other: Segmentation) -> bool:
    for name, within in _SAME.items():
        a, b = getattr(one, name), getattr(other, name)
        if (a is None) != (b is None):
            return False
        if a is not None and abs(a - b) > within * max(abs(a), abs(b)):
            return False
    steps, others = one.in_steps, other.in_steps
    return len(steps) == len(others) and all(
        abs(a - b) <= _SAME['hold_time'] * max(a, b) for a, b in zip(steps, others, strict=True)
    )


def measure(found: Refit, groups: Sequence[Sequence[int]]) -> Scatter | None:
    """
    Return the scatter that repeats show.

    Parameters
    ----------
    found : Refit
        A model without scatter, fitted to the campaign.
    groups : sequence of sequence of int
        From `conditions`, for the trials of the refit.

    Returns
    -------
    Scatter or None
        None without repeats.

    """
    repeated = [list(group) for group in groups if len(group) > 1]
    if not repeated:
        return None
    shifts, noises = _shifts(_withdrawn_alike(found, repeated))
    times = np.array([trial.campaign_time for trial in found.problem.trials])
    factors, variances = _factors(shifts, noises)
    slope = _trend(factors, times, repeated)
    block = _block(factors, variances, times, repeated)
    if slope != 0.0 and block is not None:
        # What changes at once changes with time as well.
        if _at_once(block, factors, times, repeated):
            slope = 0.0
        else:
            block = None
    late = np.zeros(times.size) if slope == 0.0 else times - times.mean()
    shifts = shifts - slope * late[:, np.newaxis]
    degrees = sum(len(group) - 1 for group in repeated)
    likeliest, largest = _common(shifts, noises, late, repeated)
    common = likeliest**2
    squares, noise = np.zeros(3), np.zeros(3)
    for group in repeated:
        away = shifts[group] - shifts[group].mean(axis=0)
        # Noise alone makes this much of it.
        share = 1.0 - 1.0 / len(group)
        own = share * np.sum(noises[group].diagonal(axis1=1, axis2=2), axis=0)
        squares += np.sum(away**2, axis=0) - own
        noise += own / degrees
    squares = np.maximum(squares, 0.0)
    # What a trial does not tell of an element by itself it does not tell of its scatter.
    told = common / np.maximum(common + noise, 1e-300)
    variance = (_POOLED * common + told * squares) / (_POOLED + told * degrees)
    enlarged = (_POOLED + degrees) / float(chdtri(_POOLED + degrees, 1.0 - _CAUTION))
    std = np.sqrt(variance)
    cautious = np.maximum(std * math.sqrt(enlarged), largest)
    if cautious.max() < LEAST:
        return Scatter(np.zeros(3), np.zeros(3), degrees)
    std = np.where(std < LEAST, 0.0, std)
    return Scatter(std, np.maximum(cautious, LEAST), degrees, block)


def apart(found: Refit) -> Block | None:
    """
    Return the trials that differ from all others, where no push was repeated.

    Parameters
    ----------
    found : Refit
        A model without scatter, fitted to the campaign.

    Returns
    -------
    Block or None
        None where trials scatter, or change steadily, or agree.

    """
    times = np.array([trial.campaign_time for trial in found.problem.trials])
    everyone = [list(range(times.size))]
    factors, variances = _factors(*_shifts(found))
    # Without times there is no order in which the trials are one after another.
    block = _block(factors, variances, times, everyone) if np.ptp(times) > 0.0 else None
    if block is None or block.rest**2 >= _CLEARER * _left_by_trend(factors, times, everyone):
        return None
    return block


def pushed_apart(
    phases: Sequence[Segmentation], times: Sequence[float], block: Block
) -> tuple[str, ...]:
    """
    Return in what the pushes of a block differ from all others.

    Parameters
    ----------
    phases : sequence of Segmentation
        Of the trials.
    times : sequence of float
        Of the trials, in the campaign [s].
    block : Block
        Some of the trials.

    Returns
    -------
    tuple of str
        Such as the speed, where each of them is slower than any other trial; mostly nothing.

    """
    told = []
    for name, within in _SAME.items():
        sides: tuple[list[float], list[float]] = [], []
        for phase, time in zip(phases, times, strict=True):
            size = getattr(phase, name)
            if size is not None:
                sides[times[block.first] <= time <= times[block.last]].append(abs(size))
        if not all(sides):
            continue
        less, more = sorted(sides, key=min)
        if min(more) - max(less) > within * max(more):
            told.append('depth' if name == 'reach' else name.replace('_', ' '))
    return tuple(told)


def _common(
    shifts: FloatArray, noises: FloatArray, late: FloatArray, groups: Sequence[Sequence[int]]
) -> tuple[float, float]:
    """
    Return the scatter that is most likely if it is the same in all three elements, and a limit.

    One trial may tell the size of the force, and not how the elements share in it: each has the
    whole covariance of its noise. The likelihood is restricted: the means of the groups are free,
    and so is a change with time, where `late` is not zero. The scatter is above the limit with
    the probability `_CAUTION`, if any order of its size is as likely beforehand.
    """
    trials = np.concatenate([np.asarray(group) for group in groups])
    slopes = int(late.any())
    design = np.zeros((trials.size, 3, 3 * len(groups) + slopes))
    row = 0
    for number, group in enumerate(groups):
        mine = slice(3 * number, 3 * (number + 1))
        for index in group:
            design[row, :, mine] = np.eye(3)
            if slopes:
                design[row, :, -1] = late[index]
            row += 1

    def deviance(size: float) -> float:
        weights = np.linalg.inv(noises[trials] + size**2 * np.eye(3))
        weighted = weights @ design
        normal = np.einsum('ijp,ijq->pq', design, weighted)
        seen = np.einsum('ijp,ij->p', weighted, shifts[trials])
        squares = float(np.einsum('ij,ijk,ik', shifts[trials], weights, shifts[trials]))
        squares -= float(seen @ np.linalg.solve(normal, seen))
        return squares + float(np.linalg.slogdet(normal)[1] - np.linalg.slogdet(weights)[1].sum())

    deviances = np.array([deviance(size) for size in _SIZES])
    likeliest = float(_SIZES[int(np.argmin(deviances))])
    # Of repeats that tell it well the limit is that of chi squared.
    chances = np.cumsum(np.exp(-0.5 * (deviances - deviances.min()))[1:])
    limit = int(np.searchsorted(chances, (1.0 - _CAUTION) * chances[-1]))
    return likeliest, float(_SIZES[1:][limit])


def _withdrawal(trial: FitTrial) -> float:
    """Return how fast a tool withdraws over half its depth [m/s]; zero if it stays."""
    if trial.t_release is None:
        return 0.0
    after = trial.t[trial.t >= trial.t_release]
    depth = trial.path.at(after)
    if after.size < 2 or depth[-1] > 0.5 * depth[0]:
        return 0.0
    half = int(np.argmax(depth <= 0.5 * depth[0]))
    return float((depth[0] - depth[half]) / (after[half] - after[0]))


def _withdrawn_alike(found: Refit, groups: Sequence[Sequence[int]]) -> Refit:
    """
    Return the model for what repeats have in common.

    A push whose tool withdraws otherwise is no repeat from there on: what a model lacks there, as
    an object that sticks to the tool, makes another difference of each.
    """
    trials = found.problem.trials
    speeds = [[_withdrawal(trials[index]) for index in group] for group in groups]
    if all(max(each) - min(each) <= _SAME['push_speed'] * max(each) for each in speeds):
        return found
    heads = [
        trial
        if trial.t_release is None
        else trial.head(int(np.searchsorted(trial.t, trial.t_release)) - 1)
        for trial in trials
    ]
    return Workbench(heads, None).taken_over(found)


def _shifts(found: Refit) -> tuple[FloatArray, FloatArray]:
    """Return each trial's own logarithms of K1, C1, C2 beside the shared, and their covariance."""
    old = found.problem
    problem = Problem(old.model, old.trials, np.full(3, _WIDE))
    problem.set_noise(found.force_noise, found.height_noise, found.jumps)
    state = carried(old, found.state, problem)
    shifts, noises = np.zeros((len(old.trials), 3)), np.zeros((len(old.trials), 3, 3))
    for index, place in enumerate(problem.places):

        def one(
            own: FloatArray, index: int = index, place: slice = place
        ) -> tuple[FloatArray, FloatArray]:
            whole = state.copy()
            whole[place] = own
            return problem.evaluate_trial(whole, index)

        bounds = (problem.bounds[0][place], problem.bounds[1][place])
        solution = minimise(one, state[place], bounds, tolerance=1e-6, max_evaluations=20)
        chosen = slice(problem.q, problem.q + 3)
        # The misfit of the trial stands in for its noise.
        shifts[index] = solution.theta[chosen]
        noises[index] = covariance(solution.jacobian)[chosen, chosen]
    return shifts, noises


def _factors(shifts: FloatArray, noises: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return what each trial tells of one factor of all three, as a logarithm; its variance."""
    weights = np.linalg.inv(noises).sum(axis=1)
    total = weights.sum(axis=1)
    return np.sum(weights * shifts, axis=1) / total, 1.0 / total


def _apart(values: FloatArray, groups: Sequence[Sequence[int]]) -> FloatArray:
    """Return what the trials of each group differ by from their mean, group by group."""
    return np.concatenate([values[group] - values[group].mean() for group in groups])


def _block(
    factors: FloatArray,
    variances: FloatArray,
    times: FloatArray,
    groups: Sequence[Sequence[int]],
) -> Block | None:
    """
    Return the trials that differ from all others by more than chance makes of scatter.

    What changed between two trials, as a temperature or how the object lies, changes all that
    follow until it changes back. Where chance alone puts the trials it seldom leaves so little
    between the others, which is simulated with the scatter that they show beside their noise.
    """
    order = np.argsort(times, kind='stable')
    place = np.argsort(order)
    groups = [[int(place[index]) for index in group] for group in groups]
    members = np.sort(np.concatenate([np.asarray(group) for group in groups]))
    bounds, columns = _contrasts(members, groups)
    degrees = members.size - len(groups)
    if not bounds or degrees < _LEAST_DEGREES:
        return None
    sizes = np.linalg.norm(columns, axis=1)
    unit = columns / sizes[:, np.newaxis]
    values = factors[order]
    for group in groups:
        values[group] -= values[group].mean()
    along = unit @ values[members]
    total = float(values[members] @ values[members])
    if not total > 0.0:
        return None
    # Pushes that are repeated once do not show where between them a change was.
    alike = np.flatnonzero(along**2 >= (1.0 - 1e-9) * np.max(along**2))
    best = int(min(alike, key=lambda k: bounds[k][1] - bounds[k][0]))
    share = float(along[best] ** 2) / total
    if share < _BLOCK_SHARE:
        return None
    noise = variances[order]
    own = sum((1.0 - 1.0 / len(group)) * float(noise[group].sum()) for group in groups)
    # What they show of it may be their noise alone.
    for scatter in (max(total - own, 0.0) / degrees, 0.0):
        std = np.sqrt(scatter + noise)
        if _chance(unit, std, members, groups, share) > _BLOCK_CHANCE:
            return None
    first, last = bounds[best]
    change = float(along[best] / sizes[best])
    if 2 * np.count_nonzero((members >= first) & (members <= last)) > members.size:
        # Of what changed once, the fewer trials are the others.
        if first == members[0]:
            first, last, change = int(members[members > last][0]), int(members[-1]), -change
        elif last == members[-1]:
            first, last, change = int(members[0]), int(members[members < first][-1]), -change
    rest = math.sqrt(max(total * (1.0 - share), 0.0) / (degrees - 1))
    return Block(int(order[first]), int(order[last]), math.expm1(change), rest)


def _chance(
    unit: FloatArray,
    std: FloatArray,
    members: NDArray[np.intp],
    groups: Sequence[Sequence[int]],
    share: float,
) -> float:
    """Return how often trials of some scatter each have a block of at least such a share."""
    random = np.random.default_rng(_SEED)
    larger = 0
    for _ in range(_DRAWS // _AT_ONCE):
        drawn = std * random.standard_normal((_AT_ONCE, std.size))
        for group in groups:
            drawn[:, group] -= drawn[:, group].mean(axis=1, keepdims=True)
        drawn = drawn[:, members]
        shares = ((drawn @ unit.T) ** 2).max(axis=1) / np.sum(drawn**2, axis=1)
        larger += int(np.count_nonzero(shares >= share))
    return larger / _DRAWS


def _contrasts(
    members: NDArray[np.intp], groups: Sequence[Sequence[int]]
) -> tuple[list[tuple[int, int]], FloatArray]:
    """Return the blocks that repeats can show, and what one of size one does to the members."""
    bounds, columns = list[tuple[int, int]](), list[FloatArray]()
    for i, first in enumerate(members):
        later = i + _SHORTEST_BLOCK - 1
        for last in members[later:]:
            column = np.zeros(int(members[-1]) + 1)
            for group in groups:
                among = [index for index in group if first <= index <= last]
                column[among] = 1.0
                column[group] -= len(among) / len(group)
            column = column[members]
            inside = (members >= first) & (members <= last)
            # A block and the rest after it are the same blocks seen from the other side.
            told = (inside & (column != 0.0), ~inside & (column != 0.0))
            if min(map(np.count_nonzero, told)) >= _SHORTEST_BLOCK:
                bounds.append((int(first), int(last)))
                columns.append(column)
    return bounds, np.array(columns)


def _left_by_trend(
    factors: FloatArray, times: FloatArray, groups: Sequence[Sequence[int]]
) -> float:
    """Return the variance that a steady change over the campaign leaves in the groups."""
    common, late = _apart(factors, groups), _apart(times, groups)
    rest = common - late * float(late @ common) / float(late @ late)
    return float(rest @ rest) / (rest.size - len(groups) - 1)


def _at_once(
    block: Block, factors: FloatArray, times: FloatArray, groups: Sequence[Sequence[int]]
) -> bool:
    """
    Return whether some trials differ rather than that all change steadily.

    Between two rounds of the same pushes repeats hardly tell the one from the other; the pushes
    within each round do, as far as the model tells them.
    """
    place = np.argsort(np.argsort(times, kind='stable'))
    members = [place[index] for group in groups for index in group]
    # What was pushed once, before all repeats or after them, is as the repeats beside it.
    first = 0 if place[block.first] == min(members) else place[block.first]
    last = times.size - 1 if place[block.last] == max(members) else place[block.last]
    inside = (place >= first) & (place <= last)
    rest = _apart(factors, [np.flatnonzero(inside).tolist(), np.flatnonzero(~inside).tolist()])
    by_block = float(rest @ rest) / (rest.size - 2)
    everyone = [list(range(times.size))]
    steadily = [_left_by_trend(factors, times, alike) for alike in (groups, everyone)]
    return block.rest**2 * by_block < _CLEARER * steadily[0] * steadily[1]


def _trend(factors: FloatArray, times: FloatArray, groups: Sequence[Sequence[int]]) -> float:
    """Return by how much the factors change with time over the campaign, where it is no chance."""
    common, late = _apart(factors, groups), _apart(times, groups)
    spread = float(late @ late)
    free = common.size - len(groups) - 1
    if spread == 0.0 or free < 1:
        return 0.0
    slope = float(common @ late) / spread
    rest = common - slope * late
    explained = slope**2 * spread
    ratio = explained / max(float(rest @ rest) / free, 1e-300)
    return slope if float(fdtrc(1, free, ratio)) <= _TREND else 0.0
