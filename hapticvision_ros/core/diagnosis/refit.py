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
Models refitted to one campaign, so that their likelihoods can be compared.

All of them see the same samples, steps and scatter of the trials; each has the noise that makes
its own residual most likely, so that a model is not preferred for what the noise can explain.
"""

from collections.abc import Sequence
import contextlib
from dataclasses import dataclass, replace
from itertools import product
import math
from typing import Final, NamedTuple

from hapticvision_ros.core.composition import BASE_PARAMETERS, Model
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.fit.campaign import (
    are_few,
    Blur,
    carried,
    Fit,
    follow,
    force_blocks,
    height_blocks,
    in_order,
    longest_memory,
    Memory,
    places_of,
    Problem,
    replace_onsets,
    scale_of,
    SHARPEST,
    slow_body,
    strengths,
    turn_phases,
)
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.least_squares import (
    Evaluated,
    left_over,
    NotFiniteError,
    triangle,
)
from hapticvision_ros.core.fit.noise_model import (
    Blocks,
    Record,
    SensorNoise,
    Whitener,
    whitener,
)
from hapticvision_ros.core.fit.start import identify
from hapticvision_ros.core.records import FloatArray
import numpy as np

_FACTORS: Final = (1.0, 0.1, 0.01, 1e-3, 10.0)
"""Strengths, over the first guess, that a search starts from."""
_CLOSE_BY: Final = 16
"""Starts of an effect that are enough of themselves."""
_BEST: Final = 2
"""Starts that are followed."""
_LOOKS: Final = 6
_STEPS: Final = 12
_ROUNDS: Final = 6
_ENOUGH: Final = 1.0
"""Gain below which another round of noise and parameters is not worth it."""
_KEPT: Final = 0.05
"""Part of what one step promises by which a search that kept to it has reached more."""
_NEGLIGIBLE: Final = 1e-3
_MODERATE: Final = 0.1
"""Part of C2 below which C1 does nothing, and the one that it is started from then as well."""
_SMALL: Final = 1e-3
"""Step from an effect's absence where it has no first guess."""
_TOLERANCE: Final = 1e-6
"""Relative change of the squares that is none: below one in any campaign of a million samples."""


@dataclass(frozen=True, slots=True)
class Refit:
    """
    A model at its best in a campaign.

    Parameters
    ----------
    model : Model
        The model.
    problem : Problem
        What was minimised, with the model's own noise.
    state : ndarray
        All parameters.
    cost : float
        Whitened squares.
    deviance : float
        Minus twice the log likelihood, constants apart.
    force_noise, height_noise : SensorNoise
        The most likely noise.
    blur : Blur
        How well the moments are known at which the force jumps.
    jumps : tuple of ndarray
        The variance that each step's force has by it [N^2].

    """

    model: Model
    problem: Problem
    state: FloatArray
    cost: float
    deviance: float
    force_noise: SensorNoise
    height_noise: SensorNoise
    blur: Blur
    jumps: tuple[FloatArray, ...]

    def as_fit(self, like: Fit) -> Fit:
        """Return a fit to start from, with everything else as in another."""
        return replace(
            like,
            model=self.model,
            noise=replace(
                like.noise,
                force=self.force_noise,
                height=self.height_noise,
                blur=self.blur,
            ),
            problem=self.problem,
            state=self.state,
        )

    @property
    def theta(self) -> FloatArray:
        """Return the shared parameters as the search sees them."""
        return self.state[: self.problem.p]


@dataclass(frozen=True, slots=True)
class Columns:
    """
    Some k curves over a trial, in the form of the fit.

    Parameters
    ----------
    force, height : ndarray, shapes (k, n), (k, m)
        Their values in each step of the force [N] and at each height [m].

    """

    force: FloatArray
    height: FloatArray


@dataclass(frozen=True, slots=True)
class Smooth:
    """
    What curves take out of the residual of a model.

    Parameters
    ----------
    gain : float
        By how much they lower the deviance.
    count : int
        How many of them the data can tell.
    force, height : tuple of ndarray
        What they and the parameters, as far as these move with them, add to the prediction of
        each trial, shapes (n,), (m,).

    """

    gain: float
    count: int
    force: tuple[FloatArray, ...]
    height: tuple[FloatArray, ...]


class Start(NamedTuple):
    """A state, what `Problem.evaluate` returned there, and the squares that one step promises."""

    state: FloatArray
    residual: FloatArray
    jacobian: FloatArray
    left: float


@dataclass(frozen=True, slots=True)
class Look:
    """
    A model with more effects, before it is refitted.

    Parameters
    ----------
    problem : Problem
        Of the model, at the noise of the refit without them.
    starts : tuple of Start
        Where to search from, the best first; empty where the model cannot be evaluated.
    promise : float
        By how much one step of the search from the best of them promises to lower the squares.

    """

    problem: Problem
    starts: tuple[Start, ...]
    promise: float


type _Linear = tuple[
    list[tuple[FloatArray, FloatArray]], list[tuple[Whitener, Whitener | None]], float
]
"""Residuals and derivatives of each trial, the filters of the noise, and the deviance of both."""


class Workbench:
    """
    One campaign, to which models are refitted.

    Parameters
    ----------
    trials : sequence of FitTrial
        The trials.
    scatter : ndarray, shape (3,) or None
        How K1, C1 and C2 vary from trial to trial.
    memory : Memory, optional
        What is known of the memory of the noise already.

    """

    def __init__(
        self,
        trials: Sequence[FitTrial],
        scatter: FloatArray | None,
        memory: Memory | None = None,
    ) -> None:
        self.trials = tuple(trials)
        self.scatter = scatter
        self.memory = longest_memory(trials) if memory is None else memory
        self._scale: tuple[Refit, Scale] | None = None
        self._known: tuple[Refit, _Linear] | None = None
        self.samples_of = tuple(
            int(np.count_nonzero(t.force_count)) + t.height_t.size for t in self.trials
        )
        self.samples = sum(self.samples_of)

    def scattering(self, scatter: FloatArray) -> 'Workbench':
        """Return the same campaign with trials that scatter."""
        return Workbench(self.trials, scatter, self.memory)

    def base(self, fit: Fit) -> Refit:
        """Return a fitted model as it stands on this bench."""
        problem = Problem(fit.model, self.trials, self.scatter)
        state = carried(fit.problem, fit.state, problem)
        noise = fit.noise
        problem.set_noise(noise.force, noise.height, problem.unsure(state, noise.blur))
        return self._settled(problem, state, noise.force, noise.height, noise.blur)

    def taken_over(self, found: Refit) -> Refit:
        """Return a model of another bench as it stands on this one, with noise of its own."""
        problem = Problem(found.model, self.trials, self.scatter)
        state = carried(found.problem, found.state, problem)
        problem.set_noise(found.force_noise, found.height_noise, problem.unsure(state, found.blur))
        return self._settled(problem, state, found.force_noise, found.height_noise, found.blur)

    def refit(self, model: Model, near: Refit, looked: Look | None = None) -> Refit | None:
        """
        Fit a model, starting from a part of it or from one with more effects.

        Parameters
        ----------
        model : Model
            What to fit.
        near : Refit
            Where to start.
        looked : Look, optional
            What `look` has found for the same two.

        Returns
        -------
        Refit or None
            The best that was found; None where the model cannot be evaluated.

        """
        look = self.look(model, near) if looked is None else looked
        problem, best = look.problem, None
        added = places_of(
            model, [name for name in model.effects if name not in near.model.effects]
        )
        scanned = any(len(model.parameters[k].scan) > 1 for k in added)
        for start in look.starts:
            # A search finds its way between the values that are scanned from close by only.
            reached = math.inf if best is None or scanned else best.cost
            if _is_beyond(start, look.starts[0], reached, look.promise):
                continue
            with contextlib.suppress(ValueError):
                end = problem.search(
                    start.state,
                    tolerance=1e-4,
                    max_evaluations=_LOOKS,
                    known=(start.residual, start.jacobian),
                )
                if best is None or end.cost < best.cost:
                    best = end
        if best is None:
            return None
        names = [parameter.symbol for parameter in BASE_PARAMETERS]
        values = near.model.values(near.theta)[: len(names)]
        begin = in_order(problem, best, dict(zip(names, values.tolist(), strict=True)))
        noise = near.force_noise, near.height_noise, near.blur
        known = begin.residual, begin.jacobian
        try:
            found = self._settled(problem, begin.theta, *noise, known=known)
            more = set(near.model.effects) < set(model.effects)
            if more and found.deviance > near.deviance + _ENOUGH:
                # More effects explain no less: a blur and a noise that are the most likely ones
                # beside each other need not be so of all.
                problem.set_noise(near.force_noise, near.height_noise, near.jumps)
                blurred = self._settled(problem, begin.theta, *noise, known=known, blurred=True)
                found = min(found, blurred, key=lambda each: each.deviance)
                # What is asked of the problem goes with the noise that was kept.
                problem.set_noise(found.force_noise, found.height_noise, found.jumps)
            return found
        except NotFiniteError:
            return None

    def look(self, model: Model, near: Refit) -> Look:
        """
        Return where to begin with a model, and what one step of the search promises.

        Parameters
        ----------
        model : Model
            A model with more effects, or fewer.
        near : Refit
            The refit without them, whose noise is taken.

        Returns
        -------
        Look
            The starts that promise most.

        """
        problem = Problem(model, self.trials, self.scatter)
        problem.set_noise(near.force_noise, near.height_noise, near.jumps)
        begin = carried(near.problem, near.state, problem)
        states = [begin]
        added = [name for name in model.effects if name not in near.model.effects]
        if added:
            states = self._likeliest(problem, self._starts(problem, begin, near, added), near)
        left = []
        for state in states:
            residual, jacobian = problem.evaluate(state)
            if np.isfinite(residual).all():
                left.append(Start(state, residual, jacobian, left_over(residual, jacobian)))
        left.sort(key=lambda each: each.left)
        promise = near.cost - left[0].left if left else -math.inf
        # What another body promises is less exact: it is further away.
        others = _best_of_others([each.state for each in left], _BEST)
        return Look(problem, (*left[:_BEST], *(left[k] for k in others)), promise)

    def residual(
        self, problem: Problem, state: FloatArray, index: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return measured minus predicted force and height of a trial, block by block."""
        # The bench may have other measurements of the trials than those of the problem.
        return problem.residual(state, index, self.trials[index])

    def smooth(self, found: Refit, columns: Sequence[Columns], *, again: bool) -> Smooth:
        """
        Let curves take what they can out of the residual of a model, which may move as well.

        Parameters
        ----------
        found : Refit
            The model; what it can make up for itself is no gain.
        columns : sequence of Columns
            The curves in each trial.
        again : bool
            Whether the noise is estimated anew without what they take out.

        Returns
        -------
        Smooth
            What they take out, and what it is worth.

        """
        problem = found.problem
        rows, whiteners, deviance = self._beside(found)
        force_noise, height_noise = found.force_noise, found.height_noise
        left: list[tuple[FloatArray, FloatArray]] = []
        for turn in range(3 if again else 1):
            if turn:
                force_noise, height_noise = self._most_likely(
                    left, force_noise, height_noise, found.jumps
                )
                whiteners = self.whiteners(force_noise, height_noise, found.jumps)
            solution, squares, determinant, count = self._linear(
                problem, found.state, rows, columns, whiteners
            )
            left = self._left(problem, rows, columns, solution)
        return Smooth(
            gain=deviance - squares - determinant,
            count=count,
            force=tuple(
                after - force[-1] for (force, _), (after, _) in zip(rows, left, strict=True)
            ),
            height=tuple(
                after - height[-1] for (_, height), (_, after) in zip(rows, left, strict=True)
            ),
        )

    def _beside(self, found: Refit) -> _Linear:
        """Return a refit as a linear model, without the price of its scatter."""
        # Many curves are held against one model.
        if self._known is None or self._known[0] is not found:
            problem = found.problem
            rows = [problem.records(found.state, index) for index in range(len(self.trials))]
            whiteners = self.whiteners(found.force_noise, found.height_noise, found.jumps)
            deviance = found.deviance - problem.scatter_price(found.state)
            self._known = found, (rows, whiteners, deviance)
        return self._known[1]

    def guesses(self, model: Model, near: Refit) -> tuple[Problem, list[FloatArray]]:
        """Return the problem of a model with more effects, and states with these in action."""
        problem = Problem(model, self.trials, self.scatter)
        begin = carried(near.problem, near.state, problem)
        added = [name for name in model.effects if name not in near.model.effects]
        states = self._starts(problem, begin, near, added)[:-1]
        # Another body is a change as well, and none of what is added.
        states = [state for state in states if _body(state) == _body(states[0])]
        # What has no first guess is seen by a small step.
        for k in places_of(model, added):
            if states[0][k] == begin[k]:
                states[0][k] += _SMALL * max(abs(states[0][k]), 1.0)
        return problem, states

    def whiteners(
        self, force: SensorNoise, height: SensorNoise, jumps: Sequence[FloatArray]
    ) -> list[tuple[Whitener, Whitener | None]]:
        """Return what makes the noise of each trial white."""
        return [
            (
                whitener(force_blocks(trial, jumps[index]), force),
                whitener(height_blocks(trial), height) if trial.height_t.size else None,
            )
            for index, trial in enumerate(self.trials)
        ]

    def _linear(
        self,
        problem: Problem,
        state: FloatArray,
        rows: Sequence[tuple[FloatArray, FloatArray]],
        columns: Sequence[Columns],
        whiteners: Sequence[tuple[Whitener, Whitener | None]],
    ) -> tuple[FloatArray, float, float, int]:
        """
        Return the best linear change, the squares it leaves, the determinant, and a count.

        The change is that of all parameters, then the sizes of the curves; the count is of those
        curves that the data can tell.
        """
        k = columns[0].force.shape[0]
        blocks, targets, determinant = [], [], 0.0
        for index, (force, height) in enumerate(rows):
            force_filter, height_filter = whiteners[index]
            whole = force_filter(np.vstack((columns[index].force, force)))
            determinant += force_filter.log_determinant
            if height_filter is not None:
                other = height_filter(np.vstack((columns[index].height, height)))
                whole = np.hstack((whole, other))
                determinant += height_filter.log_determinant
            factor = triangle(whole)
            mine, shared, own, target = np.split(factor, [k, k + problem.p, -1], axis=1)
            block = np.zeros((factor.shape[0], problem.size))
            block[:, : problem.p] = shared
            block[:, problem.places[index]] = own
            blocks.append(np.hstack((block, mine)))
            targets.append(target[:, 0])
        prior, aim = problem.priors(state)
        blocks.append(np.hstack((prior, np.zeros((prior.shape[0], k)))))
        targets.append(aim)
        matrix, target = np.vstack(blocks), np.concatenate(targets)
        scale = np.sqrt(np.sum(matrix**2, axis=0))
        told = scale > 0.0
        scaled = matrix[:, told] / scale[told]
        left, singular, right = np.linalg.svd(scaled, full_matrices=False)
        steep = singular > 1e-8 * singular[0]
        projected = left[:, steep].T @ target
        change = np.zeros(matrix.shape[1])
        change[told] = -(right[steep].T @ (projected / singular[steep])) / scale[told]
        squares = float(target @ target - projected @ projected)
        plain = np.linalg.svd(scaled[:, : int(told[: problem.size].sum())], compute_uv=False)
        count = int(steep.sum() - np.count_nonzero(plain > 1e-8 * plain[0]))
        return change, squares, determinant, count

    def _left(
        self,
        problem: Problem,
        rows: Sequence[tuple[FloatArray, FloatArray]],
        columns: Sequence[Columns],
        change: FloatArray,
    ) -> list[tuple[FloatArray, FloatArray]]:
        """Return what a linear change leaves of the residuals."""
        left = []
        curves = np.split(change, [problem.size])[1]
        for index, (force, height) in enumerate(rows):
            own = np.concatenate((change[: problem.p], change[problem.places[index]], [1.0]))
            left.append(
                (
                    own @ force + curves @ columns[index].force,
                    own @ height + curves @ columns[index].height,
                )
            )
        return left

    def _starts(
        self, problem: Problem, begin: FloatArray, near: Refit, added: Sequence[str]
    ) -> list[FloatArray]:
        """Return states with several strengths of the added effects."""
        model = problem.model
        scale = self.scale(near)
        guess = model.values(model.first_guess(scale))
        new = places_of(model, added)
        neutral = np.array([model.parameters[k].neutral for k in new])
        absent = np.where(np.isfinite(neutral), neutral, 0.0)
        signless = any(guess[k] != 0.0 for k in new)
        # A stiffness in series is the weaker the larger it is, and its viscosity with it.
        stiff = np.concatenate(
            [
                np.full(
                    len(BY_NAME[name].parameters),
                    math.isinf(BY_NAME[name].parameters[0].neutral),
                )
                for name in added
            ]
        )
        strong = strengths(model)[new]
        scans = list(product(*(model.parameters[k].scan for k in new)))
        factors = _FACTORS if signless and len(scans) < _CLOSE_BY else _FACTORS[:1]
        # What the smaller model has done without, no search finds the way back to.
        base = [model.names.index(parameter.symbol) for parameter in BASE_PARAMETERS]
        body = dict(zip(('K1', 'C1', 'C2'), model.values(begin[: problem.p])[base], strict=True))
        bodies = [body]
        if body['C1'] < _NEGLIGIBLE * body['C2']:
            bodies.append({**body, 'C1': _MODERATE * body['C2']})
        # Likewise a flow, which would give way as much as K1 while the tool touches.
        flowing = body['K1'] * scale.contact_time
        if flowing < _NEGLIGIBLE * body['C2']:
            bodies.append({**body, 'C2': flowing})
        slow = slow_body(self.trials, body)
        if slow is not None:
            bodies.append(slow)
        if len(new) > 1 and len(scans) > _CLOSE_BY:
            # What shows when the tool leaves has bent what is told from all of a trial.
            held = identify(self.trials, near.force_noise.white)
            bodies.append({'K1': held.K1, 'C1': held.C1, 'C2': held.C2})
        states = []
        for factor, scan, each in product(factors, scans, bodies):
            values = model.values(begin[: problem.p])
            values[base] = list(each.values())
            # A power of one, as of a dashpot, is what it differs from.
            strength = np.where(stiff, 1.0 / factor, np.where(strong, factor, 1.0))
            values[new] = absent + (guess[new] - absent) * strength * scan
            state = begin.copy()
            state[: problem.p] = np.clip(model.theta(values), *model.bounds)
            states.append(state)
        fresh = states[0].copy()
        # The onsets of the smaller model may make up for what it lacks.
        for place in problem.places:
            fresh[place.start] = 0.0
        states.append(fresh)
        for state in states:
            turn_phases(problem, state)
        return states

    def _likeliest(
        self, problem: Problem, states: list[FloatArray], near: Refit
    ) -> list[FloatArray]:
        """Return what leaves least of many states: that needs no derivatives."""
        if len(states) <= _CLOSE_BY:
            return states
        left = np.array(self.leaves(problem, states, near))
        # The last has onsets of its own, which leave much until they have been moved.
        left[-1] = -math.inf
        ranked = [states[k] for k in np.argsort(left, kind='stable').tolist()]
        chosen = [*range(min(_CLOSE_BY, len(ranked))), *_best_of_others(ranked, _CLOSE_BY)]
        taken = {id(ranked[k]) for k in chosen}
        return [state for state in states if id(state) in taken]

    def leaves(self, problem: Problem, states: Sequence[FloatArray], near: Refit) -> list[float]:
        """Return what each of many states leaves beside the noise of a refit: squares [-]."""
        filters = self.whiteners(near.force_noise, near.height_noise, near.jumps)

        def left(state: FloatArray) -> float:
            total = 0.0
            for index, (of_force, of_height) in enumerate(filters):
                force, height = self.residual(problem, state, index)
                white = of_force(force[np.newaxis])[0]
                total += float(white @ white)
                if of_height is not None:
                    white = of_height(height[np.newaxis])[0]
                    total += float(white @ white)
            return total if math.isfinite(total) else math.inf

        return [left(state) for state in states]

    def leaves_after(
        self,
        problem: Problem,
        states: Sequence[FloatArray],
        near: Refit,
        held: Sequence[int],
    ) -> list[float]:
        """Return the same after one step of all parameters but those that are held, by place."""
        problem.set_noise(near.force_noise, near.height_noise, near.jumps)

        def left(state: FloatArray) -> float:
            residual, jacobian = problem.evaluate(state)
            if not np.isfinite(residual).all():
                return math.inf
            return left_over(residual, np.delete(jacobian, held, axis=1))

        return [left(state) for state in states]

    def scale(self, near: Refit) -> Scale:
        """Return what the campaign looks like beside a refit."""
        known = self._scale
        if known is None or known[0] is not near:
            values = near.model.values(near.theta)[: len(BASE_PARAMETERS)].tolist()
            known = self._scale = near, scale_of(near.problem, near.state, *values)
        return known[1]

    def _settled(
        self,
        problem: Problem,
        state: FloatArray,
        force: SensorNoise,
        height: SensorNoise,
        blur: Blur,
        known: Evaluated | None = None,
        *,
        blurred: bool = False,
    ) -> Refit:
        """
        Return the best parameters and the noise that goes with them.

        What is `known` is what the problem was evaluated to at the state beside its noise. Moments
        of jumps are no better known than before where that is `blurred`.
        """
        best, at_best, begin = None, None, state
        for turn in range(_ROUNDS):
            state = state.copy()
            # A jump that is misplaced passes for one whose moment is not known.
            moved = turn > 0 and replace_onsets(problem, state, force, SHARPEST)
            if moved:
                blur = blur if blurred else problem.sharpest(state, force, blur)
                problem.set_noise(force, height, problem.unsure(state, blur))
                known = None
            try:
                end = problem.search(
                    state,
                    tolerance=_TOLERANCE if turn else 1e-4,
                    max_evaluations=_STEPS,
                    known=known,
                )
            except NotFiniteError:
                # An onset was moved to where the model is not.
                if best is None:
                    raise
                known = at_best
                break
            if not turn:
                end = problem.search_on(end)
            state = end.theta
            left = [self.residual(problem, state, index) for index in range(len(self.trials))]
            force, height = self._most_likely(left, force, height, problem.unsure(state, blur))
            blur = blur if blurred else problem.sharpest(state, force, blur)
            jumps = problem.unsure(state, blur)
            problem.set_noise(force, height, jumps)
            known = problem.evaluate(state)
            cost = float(known[0] @ known[0])
            deviance = cost + problem.log_determinant + problem.scatter_price(state, known[1])
            if best is not None and deviance > best.deviance - _ENOUGH:
                if not moved:
                    # The search was made beside the best noise, from where that was seen.
                    begin, known = state, (end.residual, end.jacobian)
                elif deviance < best.deviance:
                    begin, known = state, None
                else:
                    known = at_best
                break
            best = Refit(problem.model, problem, state, cost, deviance, force, height, blur, jumps)
            begin, at_best = state, known
        assert best is not None
        # The noise goes with the parameters that it was seen beside.
        problem.set_noise(best.force_noise, best.height_noise, best.jumps)
        solution = problem.search(
            begin,
            tolerance=_TOLERANCE,
            max_evaluations=_STEPS,
            known=known,
        )
        return replace(
            best,
            state=solution.theta,
            cost=solution.cost,
            deviance=solution.cost
            + problem.log_determinant
            + problem.scatter_price(solution.theta, solution.jacobian),
        )

    def _most_likely(
        self,
        left: Sequence[tuple[FloatArray, FloatArray]],
        force: SensorNoise,
        height: SensorNoise,
        jumps: Sequence[FloatArray],
    ) -> tuple[SensorNoise, SensorNoise]:
        """Return the noise that makes residuals of force and height most likely."""
        forces, heights = [], []
        for index, trial in enumerate(self.trials):
            forces.append(_bare(force_blocks(trial, jumps[index]), left[index][0]))
            if trial.height_t.size:
                heights.append(_bare(height_blocks(trial), left[index][1]))
        memory = self.memory
        interval = self.trials[0].interval
        force = follow(forces, force, interval, False, memory.force, memory.least_force)
        # A few have none of their own beside each model: it would vanish where one fits them.
        if heights and not are_few(self.trials):
            interval = self.trials[0].height_interval
            height = follow(heights, height, interval, False, memory.height, memory.least_height)
        return force, height


def _bare(blocks: Blocks, residual: FloatArray) -> Record:
    """Return a record without derivatives: its likelihood is the plain one."""
    none = np.zeros((0, residual.size))
    return Record(blocks, residual, none, none)


def _is_beyond(start: Start, first: Start, reached: float, promised: float) -> bool:
    """
    Return whether a start promises less than was reached from the first one of the same body.

    What a start promises tells what is reached from it only if it did so for the first.
    """
    same = start is not first and _body(start.state) == _body(first.state)
    kept = reached > first.left - max(_ENOUGH, _KEPT * promised)
    return same and kept and start.left > reached - _ENOUGH


def _best_of_others(ranked: Sequence[FloatArray], count: int) -> list[int]:
    """Return where the first of each body stands of which none is among the first `count`."""
    known = {_body(state) for state in ranked[:count]}
    others = []
    for place, state in enumerate(ranked[count:], count):
        if _body(state) not in known:
            known.add(_body(state))
            others.append(place)
    return others


def _body(state: FloatArray) -> tuple[float, ...]:
    """Return the base parameters of a state, which come first in every model."""
    return tuple(state[: len(BASE_PARAMETERS)].tolist())
