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
Which push would tell most: one that two candidates answer differently, or one that sharpens.

The models predict pushes that were not made. Where two candidates cannot be told apart, the push
is chosen at which either, with its parameters as free as the trials have left them, misses by most
what the other says, each as often as it is likely to be the right one; otherwise the push that
sharpens the least known parameter. Straight slopes find where to begin to look; as a rival that
moves far imitates more than they say, it is then fitted to what the other says.

References
----------
A. C. Atkinson and V. V. Fedorov, Biometrika 62, 1975, 57-70, doi:10.1093/biomet/62.1.57 (designs
that discriminate between models); V. V. Fedorov, Theory of Optimal Experiments, 1972.

"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from types import MappingProxyType
from typing import Final

from hapticvision_ros.core import parallel
from hapticvision_ros.core.diagnosis.bootstrap import trial_noise, TrialNoise
from hapticvision_ros.core.diagnosis.records import NextTrial, SCATTER
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.fit.campaign import (
    carried,
    follow,
    force_blocks,
    height_blocks,
    Problem,
)
from hapticvision_ros.core.fit.data import FitTrial, planned
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.fit.noise_model import Blocks, deviance, Record, SensorNoise, whitener
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np

_SPEEDS: Final = 4
_DEPTHS: Final = (0.35, 0.6, 1.0)
_HOLDS: Final = (0.3, 1.0, 3.0)
"""Over the longest hold of the campaign."""
_STEPS: Final = 25
"""Evaluations of such a fit at most."""
_FLOOR: Final = 3.0
"""Root of the squares, beside those of the fit, of which the tolerance is a part."""
_TOLERANCE: Final = 5e-3
_UNLIKELY: Final = 1e-3
"""A model that is less likely to be the right one is not asked."""
_HARDLY: Final = 2.0
"""Standard deviations below which a push does not tell two effects apart."""
_CLEARLY: Final = 3.0
_MOST_REPEATS: Final = 10
"""Standard deviations at which effects are told apart, and the most pushes that are asked for."""
_AS_MEASURED: Final = 1.02
"""What speed, depth and hold of a push may be beyond a limit as they are measured."""
_BODY: Final = 3
"""K1, C1 and C2, whose logarithms come first among the parameters."""
_LITTLE: Final = 1.02
"""Gain in a parameter's standard error below which a push is not worth its while."""
_PASSES: Final = 0.01
"""Squares of a miss, over the samples, from which on a part of it passes for noise."""


@dataclass(frozen=True, slots=True)
class PushLimits:
    """
    What a cell can do.

    Parameters
    ----------
    slowest, fastest : float
        Speeds of a push [m/s].
    deepest : float
        Deepest push [m].
    longest_hold : float
        Longest hold [s].

    """

    slowest: float
    fastest: float
    deepest: float
    longest_hold: float

    @classmethod
    def like(
        cls, phases: Sequence[Segmentation], known: Mapping[str, float] = MappingProxyType({})
    ) -> 'PushLimits':
        """
        Return what is near what has been done: speeds within a factor of three.

        Parameters
        ----------
        phases : sequence of Segmentation
            Of the trials.
        known : mapping of str to float
            Those of the limits that are known, by their names.

        """
        speeds = [p.push_speed for p in phases if p.push_speed]
        depths = [reach for p in phases if (reach := p.reach)]
        holds = [p.hold_time for p in phases if p.hold_time is not None]
        longest = max(holds, default=10.0)
        near = cls(
            min(speeds, default=1e-3) / 3.0,
            max(speeds, default=1e-3) * 3.0,
            max(depths, default=1e-3),
            3.0 * longest,
        )
        made = replace(near, **known)
        if made.slowest <= made.fastest:
            return made
        # One of the two is known, and beyond what has been done.
        speed = known.get('slowest', made.fastest)
        return replace(made, slowest=speed, fastest=speed)

    def allow(self, push_speed: float, depth: float, hold_time: float) -> bool:
        """Return whether a push that was made, as it was measured, is within the limits."""
        return (
            push_speed <= self.fastest * _AS_MEASURED
            and push_speed * _AS_MEASURED >= self.slowest
            and depth <= self.deepest * _AS_MEASURED
            and hold_time <= self.longest_hold * _AS_MEASURED
        )


@dataclass(frozen=True, slots=True)
class _Plan:
    """A push that might be made, in the form of the fit."""

    push_speed: float
    depth: float
    hold_time: float
    trial: FitTrial

    @property
    def duration(self) -> float:
        """Return how long it takes [s]."""
        return float(self.trial.t[-1] - self.trial.t[0])


def suggest(
    bench: Workbench,
    first: Refit,
    second: Refit | None,
    phases: Sequence[Segmentation],
    limits: PushLimits | None = None,
    *,
    workers: int = 1,
) -> NextTrial | None:
    """
    Return the push to make next.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    first : Refit
        The model that leads.
    second : Refit or None
        The one that it is to be told from; None to sharpen a parameter of the first.
    phases : sequence of Segmentation
        Of the trials.
    limits : PushLimits, optional
        What the cell can do; near what has been done by default.
    workers : int
        Processors.

    Returns
    -------
    NextTrial or None
        The push with the most expected of it, for its duration; None where no push tells more.

    """
    limits = PushLimits.like(phases) if limits is None else limits
    plans = list(_plans(bench, phases, limits))
    if not plans:
        return None
    usual = float(np.median([t.t[-1] - t.t[0] for t in bench.trials]))
    if second is None:
        name = _least_known(first)

        def sharpening(plan: _Plan) -> float:
            return _sharpening(bench, first, plan, name)

        gains = parallel.each(sharpening, plans, workers)
        worth = [
            ((gain - 1.0) / max(plan.duration, usual), gain, plan)
            for gain, plan in zip(gains, plans, strict=True)
        ]
    else:
        worth = [
            (squares / max(plan.duration, usual), math.sqrt(squares), plan)
            for squares, plan in _apart(bench, first, second, plans, usual, workers)
        ]
    score, gain, best = max(worth, key=lambda each: each[0])
    if score <= 0.0 or (second is None and gain < _LITTLE):
        return None
    if second is None:
        separates: tuple[str, ...] = (name,)
        reason = f'{name} is what these trials tell least of'
    else:
        separates = (_odd(first, second), _odd(second, first))
        reason = (
            f'{separates[0]} and {separates[1]} answer it differently, by {gain:.2g} standard '
            f'deviations of the noise'
        )
        apart = {_odd(first, second), _odd(second, first)}
        kinds = {each.name: each.kind for one in (first, second) for each in one.model.declared}
        of_cell = sorted(name for name in apart if kinds.get(name, 'object') != 'object')
        if gain < _HARDLY and len(of_cell) == 1:
            reason += (
                f': hardly. Something rigid in the place of the object, pushed as hard, would '
                f'show {of_cell[0]} by itself'
            )
    repeats = 1
    # Squares add up from one push to the next; so many that hardly tell are not asked for.
    if second is not None and gain * math.sqrt(_MOST_REPEATS) >= _HARDLY:
        repeats = min(math.ceil((_CLEARLY / gain) ** 2), _MOST_REPEATS)
    return NextTrial(best.push_speed, best.depth, best.hold_time, separates, gain, reason, repeats)


def push_again(
    bench: Workbench,
    found: Refit,
    phases: Sequence[Segmentation],
    size: float,
    rival: str,
    repeats: int,
    limits: PushLimits | None = None,
) -> NextTrial | None:
    """
    Return the push to repeat, to tell scatter from an effect.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    found : Refit
        The model.
    phases : sequence of Segmentation
        Of the trials.
    size : float
        Standard deviation of the logarithms of K1, C1 and C2, if they scatter.
    rival : str
        The effect that may be the cause as well.
    repeats : int
        How many repeats tell.
    limits : PushLimits, optional
        What the cell can do; what has been done by default.

    Returns
    -------
    NextTrial or None
        The one that was made of which two show most of such a scatter in their difference, for how
        long it takes; None where none goes to one depth within the limits and holds there.

    """
    # Of trials that have no K1, C1 and C2 of their own.
    problem = Problem(found.model, bench.trials)
    state = carried(found.problem, found.state, problem)
    problem.set_noise(found.force_noise, found.height_noise, problem.unsure(state, found.blur))
    usual = float(np.median([t.t[-1] - t.t[0] for t in bench.trials]))
    worth = []
    for index, (trial, shown) in enumerate(zip(bench.trials, phases, strict=True)):
        if not shown.push_speed or not shown.depth or shown.hold_time is None or shown.whole:
            continue
        push = shown.push_speed, shown.depth, shown.hold_time
        if limits is not None and not limits.allow(*push):
            continue
        _, jacobian = problem.reduced(state, index)
        # Each of the three scatters by itself, in both trials, which have noise both.
        (shared,) = _beyond_own(jacobian, problem.p, jacobian[:, :_BODY])
        gain = size * math.sqrt(float(np.sum(shared**2)))
        worth.append((gain**2 / max(float(trial.t[-1] - trial.t[0]), usual), gain, push))
    if not worth:
        return None
    _, gain, push = max(worth)
    reason = (
        f'only repeats of one push tell scatter from trial to trial, of about '
        f'{100.0 * size:.2g} % in K1, C1 and C2, from an effect'
    )
    return NextTrial(*push, (SCATTER, rival), gain, reason, repeats)


def _apart(
    bench: Workbench,
    first: Refit,
    second: Refit,
    plans: Sequence[_Plan],
    usual: float,
    workers: int,
) -> list[tuple[float, _Plan]]:
    """Return some plans with how far two models part: mean square, whichever is the right one."""
    likely = _likely(bench, first, second)
    known = _information(first), _information(second)
    sides = ((likely, first, second), (1.0 - likely, second, first))
    rivals = [
        (weight, _Rival(bench, right, rival))
        for weight, right, rival in sides
        if weight > _UNLIKELY
    ]
    shape = (_SPEEDS, len(_DEPTHS), len(_HOLDS))
    found: dict[int, float] = {}

    def worth(place: int) -> float:
        if place not in found:
            found[place] = sum(weight * rival.misses(plans[place]) for weight, rival in rivals)
        return found[place] / max(plans[place].duration, usual)

    def promise(plan: _Plan) -> float:
        squares = _separation(bench, (first, second), known, plan, likely)
        return squares / max(plan.duration, usual)

    best = int(np.argmax(list(parallel.each(promise, plans, workers))))
    grid = np.arange(len(plans)).reshape(shape)
    # From there along hold, depth and speed in turn: slopes may mislead by orders of magnitude.
    for axis in (2, 1, 0):
        at = np.unravel_index(best, shape)
        line = grid[tuple(slice(None) if k == axis else at[k] for k in range(3))]
        best = max(line.tolist(), key=worth)
    return [(squares, plans[place]) for place, squares in found.items()]


def _odd(one: Refit, other: Refit) -> str:
    """Return the effect that one model has and the other has not."""
    only = [name for name in one.model.effects if name not in other.model.effects]
    return only[0] if only else one.model.name


def _plans(
    bench: Workbench, phases: Sequence[Segmentation], limits: PushLimits
) -> Iterator[_Plan]:
    """Yield pushes within the limits."""
    deepest = int(np.argmax([t.displacement.max() for t in bench.trials]))
    like, shown = bench.trials[deepest], phases[deepest]
    releases = shown.t_release is not None
    speeds = np.geomspace(limits.slowest, limits.fastest, _SPEEDS)
    longest = limits.longest_hold
    # What is next comes as long after the last as that came after others: an object may age.
    starts = np.sort([trial.campaign_time for trial in bench.trials])
    pause = np.median(np.diff(starts)) if starts.size > 1 else like.t[-1] - like.t[0]
    for speed in speeds:
        for share in _DEPTHS:
            for hold in _HOLDS:
                depth, time = share * limits.deepest, hold * longest / _HOLDS[-1]
                trial = planned(
                    like,
                    push_speed=float(speed),
                    depth=depth,
                    hold_time=time,
                    release=releases,
                    campaign_time=float(starts[-1] + pause),
                )
                yield _Plan(float(speed), depth, time, trial)


def _rows(
    bench: Workbench, refit: Refit, noise: Refit, plan: _Plan
) -> tuple[FloatArray, FloatArray]:
    """
    Return the whitened prediction of a plan, and derivatives in shared and own parameters.

    The noise, and how well moments are known, is that of another refit of the campaign.
    """
    problem, state = _beginning(bench, refit, plan.trial)
    force, height = problem.records(state, 0)
    (jumps,) = problem.unsure(state, noise.blur)
    rows = whitener(force_blocks(plan.trial, jumps), noise.force_noise)(force)
    if plan.trial.height_t.size:
        heights = whitener(height_blocks(plan.trial), noise.height_noise)(height)
        rows = np.hstack((rows, heights))
    prior, _ = problem.priors(state)
    jacobian = np.vstack((rows[:-1].T, prior))
    return np.append(rows[-1], np.zeros(prior.shape[0])), jacobian


def _beginning(bench: Workbench, refit: Refit, trial: FitTrial) -> tuple[Problem, FloatArray]:
    """Return a problem of one trial alone, with the shared parameters of a refit."""
    problem = Problem(refit.model, (trial,), bench.scatter)
    state = np.zeros(problem.size)
    state[: problem.p] = refit.theta
    return problem, state


def _beyond_own(jacobian: FloatArray, p: int, *columns: FloatArray) -> list[FloatArray]:
    """Return columns less what the trial's own parameters can make up for."""
    basis, singular, _ = np.linalg.svd(jacobian[:, p:], full_matrices=False)
    basis = basis[:, singular > 1e-10 * singular[0]]
    return [column - basis @ (basis.T @ column) for column in columns]


def _information(refit: Refit) -> FloatArray:
    """Return what the trials tell of the shared parameters, beyond each trial's own."""
    problem = refit.problem
    total = np.zeros((problem.p, problem.p))
    for index in range(len(problem.trials)):
        _, jacobian = problem.reduced(refit.state, index)
        (shared,) = _beyond_own(jacobian, problem.p, jacobian[:, : problem.p])
        total += shared.T @ shared
    return total


def _likely(bench: Workbench, first: Refit, second: Refit) -> float:
    """Return how likely the first is to be the right one of the two, by Schwarz's criterion."""
    lead = _criterion(bench, second) - _criterion(bench, first)
    return 1.0 / (1.0 + math.exp(-0.5 * min(max(lead, -100.0), 100.0)))


def _criterion(bench: Workbench, refit: Refit) -> float:
    count = refit.problem.p + len(bench.trials) * refit.problem.q
    return refit.deviance + count * math.log(bench.samples)


def _separation(
    bench: Workbench,
    models: tuple[Refit, Refit],
    informations: tuple[FloatArray, FloatArray],
    plan: _Plan,
    likely: float,
) -> float:
    """Return the mean square by which one misses what the other says, along straight slopes."""
    rows = [_rows(bench, one, models[0], plan) for one in models]
    total = 0.0
    for weight, said, moving in ((likely, 0, 1), (1.0 - likely, 1, 0)):
        guessed, jacobian = rows[moving]
        size = min(guessed.size, rows[said][0].size)
        p, known = models[moving].problem.p, informations[moving]
        difference = np.zeros(guessed.size)
        difference[:size] = guessed[:size] - rows[said][0][:size]
        if not np.isfinite(difference).all() or not np.isfinite(jacobian).all():
            return 0.0
        miss, shared = _beyond_own(jacobian, p, difference, jacobian[:, :p])
        scale = np.sqrt(np.diag(known) + np.sum(shared**2, axis=0))
        scale[scale == 0.0] = 1.0
        normal = (known + shared.T @ shared) / np.outer(scale, scale)
        gradient = shared.T @ miss / scale
        change = np.linalg.lstsq(normal, gradient, rcond=1e-12)[0]
        total += weight * max(float(miss @ miss - gradient @ change), 0.0)
    return total


class _Rival:
    """
    A model that is fitted to what another says of the campaign, with and without one more push.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    right : Refit
        The model that is taken for the right one, and its noise.
    rival : Refit
        The one that is to be told from it.

    """

    def __init__(self, bench: Workbench, right: Refit, rival: Refit) -> None:
        self._bench, self._right = bench, right
        self._blur = right.blur.at_least(rival.blur)
        self._trials = [
            _said(right.problem, right.state, index) for index in range(len(bench.trials))
        ]
        self._jumps = right.problem.unsure(right.state, self._blur)
        self._noise: dict[int, TrialNoise] = {}
        self._problem = Problem(rival.model, self._trials, bench.scatter)
        self._state = carried(rival.problem, rival.state, self._problem)
        self._lead, self._state = self._fitted(self._problem, self._state, self._jumps)

    def misses(self, plan: _Plan) -> float:
        """Return by how much a push makes the deviance grow by which the rival is worse."""
        alone, state = _beginning(self._bench, self._right, plan.trial)
        trials = [*self._trials, _said(alone, state, 0)]
        problem = Problem(self._problem.model, trials, self._bench.scatter)
        begin = carried(self._problem, self._state, problem)
        jumps = (*self._jumps, *alone.unsure(state, self._blur))
        try:
            lead, _ = self._fitted(problem, begin, jumps)
        except ValueError:
            return 0.0
        return max(lead - self._lead, 0.0)

    def _fitted(
        self, problem: Problem, begin: FloatArray, jumps: Sequence[FloatArray]
    ) -> tuple[float, FloatArray]:
        """Return by how much the rival is worse, and its parameters."""
        problem.set_noise(self._right.force_noise, self._right.height_noise, jumps)

        def evaluate(state: FloatArray) -> tuple[FloatArray, FloatArray]:
            residual, jacobian = problem.evaluate(state)
            if not np.isfinite(residual).all():
                return residual, jacobian
            # Squares that may be none at all: the tolerance is a part of this.
            return np.append(residual, _FLOOR), np.vstack((jacobian, np.zeros(problem.size)))

        end = minimise(
            evaluate,
            begin,
            problem.bounds,
            reach=problem.reach,
            tolerance=_TOLERANCE,
            max_evaluations=_STEPS,
        )
        squares = end.cost - _FLOOR**2
        if squares > _PASSES * self._bench.samples:
            _, known = problem.priors(end.theta)
            squares = self._worse(problem, end.theta, jumps) + float(known @ known)
        return squares, end.theta

    def _drawn(self, trial: FitTrial, jumps: FloatArray, index: int) -> TrialNoise:
        """Return noise of a trial; of those that were made, always the same."""
        if index in self._noise:
            return self._noise[index]
        drawn = trial_noise(trial, self._right, jumps, np.random.default_rng(index))
        if index < len(self._trials):
            self._noise[index] = drawn
        return drawn

    def _worse(self, problem: Problem, state: FloatArray, jumps: Sequence[FloatArray]) -> float:
        """
        Return by how much the residual makes noise less likely, with the noise as it may.

        What a model misses passes in part for noise: level and memory are looked for with it.
        """
        forces, heights = _Beside([], []), _Beside([], [])
        for index, trial in enumerate(problem.trials):
            noise = self._drawn(trial, jumps[index], index)
            force, height = (rows[-1] for rows in problem.records(state, index))
            forces.add(force_blocks(trial, jumps[index]), force, noise.force)
            if height.size:
                heights.add(height_blocks(trial), height, noise.height)
        trial, memory = problem.trials[0], self._bench.memory
        return forces.worse(self._right.force_noise, trial.interval, memory.force) + heights.worse(
            self._right.height_noise, trial.height_interval, memory.height
        )


@dataclass(frozen=True, slots=True)
class _Beside:
    """Noise of a sensor in all trials, with what a model misses and without."""

    missed: list[Record]
    bare: list[Record]

    def add(self, blocks: Blocks, miss: FloatArray, noise: FloatArray) -> None:
        """Add a trial."""
        # Both signs: no chance in how the two happen to agree.
        self.missed.extend(_record(blocks, miss + sign * noise) for sign in (1.0, -1.0))
        self.bare.append(_record(blocks, noise))

    def worse(self, noise: SensorNoise, interval: float, longest: float) -> float:
        """Return by how much less likely the noise is with the misses, at its best."""
        if not self.bare:
            return 0.0
        best = follow(self.missed, noise, interval, False, longest)
        return 0.5 * deviance(self.missed, best) - deviance(self.bare, noise)


def _record(blocks: Blocks, residual: FloatArray) -> Record:
    """Return a record without derivatives."""
    none = np.zeros((0, residual.size))
    return Record(blocks, residual, none, none)


def _said(problem: Problem, state: FloatArray, index: int) -> FitTrial:
    """Return a trial with what a model says in place of what was measured."""
    trial = problem.trials[index]
    prediction = problem.predict(state, index, directions=False)
    _, force_zero, height_zero = problem.own(state, index)
    return replace(
        trial, force=prediction.force + force_zero, height=prediction.height + height_zero
    )


def _least_known(refit: Refit) -> str:
    """Return the parameter with the largest relative error."""
    spread = _spread(_information(refit))
    values = refit.model.values(refit.theta)
    relative = [
        spread[i] if log else spread[i] / max(abs(values[i]), 1e-300)
        for i, log in enumerate(refit.model.log)
    ]
    return refit.model.names[int(np.argmax(relative))]


def _sharpening(bench: Workbench, refit: Refit, plan: _Plan, name: str) -> float:
    """Return by what factor a push makes the error of a parameter smaller."""
    _, jacobian = _rows(bench, refit, refit, plan)
    if not np.isfinite(jacobian).all():
        return 1.0
    p = refit.problem.p
    (shared,) = _beyond_own(jacobian, p, jacobian[:, :p])
    known = _information(refit)
    place = refit.model.names.index(name)
    return float(_spread(known)[place] / _spread(known + shared.T @ shared)[place])


def _spread(information: FloatArray) -> FloatArray:
    """Return standard errors."""
    scale = np.sqrt(np.maximum(np.diag(information), 1e-300))
    inverse = np.linalg.pinv(information / np.outer(scale, scale), rcond=1e-14, hermitian=True)
    return np.asarray(np.sqrt(np.maximum(np.diag(inverse), 1e-300)) / scale, dtype=np.float64)
