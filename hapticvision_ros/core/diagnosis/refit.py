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
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.composition import BASE_PARAMETERS, Model
from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.fit.campaign import (
    carried,
    find_onsets,
    Fit,
    force_blocks,
    height_blocks,
    places_of,
    Problem,
    scale_of,
    turn_phases,
)
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.least_squares import minimise
from hapticvision_ros.core.fit.noise_model import Blocks, estimate, Record, SensorNoise
from hapticvision_ros.core.records import FloatArray
import numpy as np

_FACTORS: Final = (1.0, 0.1, 0.01, 10.0)
"""Strengths, over the first guess, that a search starts from."""
_LOOKS: Final = 6
_STEPS: Final = 30
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

    """

    model: Model
    problem: Problem
    state: FloatArray
    cost: float
    deviance: float
    force_noise: SensorNoise
    height_noise: SensorNoise

    @property
    def theta(self) -> FloatArray:
        """Return the shared parameters as the search sees them."""
        return self.state[: self.problem.p]


class Workbench:
    """
    One campaign, to which models are refitted.

    Parameters
    ----------
    trials : sequence of FitTrial
        The trials.
    scatter : ndarray, shape (3,) or None
        How K1, C1 and C2 vary from trial to trial.
    jumps : sequence of ndarray
        Variance of each step's force for that a jump is known to a sample [N^2].

    """

    def __init__(
        self,
        trials: Sequence[FitTrial],
        scatter: FloatArray | None,
        jumps: Sequence[FloatArray],
    ) -> None:
        self.trials = tuple(trials)
        self.scatter = scatter
        self.jumps = tuple(jumps)
        self.samples = sum(
            int(np.count_nonzero(t.force_count)) + t.height_t.size for t in self.trials
        )

    def base(self, fit: Fit) -> Refit:
        """Return a fitted model as it stands on this bench."""
        problem = Problem(fit.model, self.trials, self.scatter)
        state = carried(fit.problem, fit.state, problem)
        problem.set_noise(fit.noise.force, fit.noise.height, self.jumps)
        return self._settled(problem, state, fit.noise.force, fit.noise.height)

    def refit(self, model: Model, near: Refit) -> Refit | None:
        """
        Fit a model, starting from a part of it or from one with more effects.

        Parameters
        ----------
        model : Model
            What to fit.
        near : Refit
            Where to start.

        Returns
        -------
        Refit or None
            The best that was found; None where the model cannot be evaluated.

        """
        problem, promised = self._look(model, near)
        if not promised:
            return None
        ends = []
        for _, state in promised[:2]:
            with contextlib.suppress(ValueError):
                ends.append(
                    minimise(
                        problem.evaluate,
                        state,
                        problem.bounds,
                        tolerance=1e-4,
                        max_evaluations=_LOOKS,
                    )
                )
        best = min(ends, key=lambda end: end.cost)
        return self._settled(problem, best.theta, near.force_noise, near.height_noise)

    def promise(self, model: Model, near: Refit) -> float:
        """
        Return by how much one step of the search promises to lower the squares of a refit.

        Parameters
        ----------
        model : Model
            A model with more effects.
        near : Refit
            The refit without them.

        Returns
        -------
        float
            The best promise from any of the starts, at the noise of `near`; minus infinity where
            the model cannot be evaluated.

        """
        _, promised = self._look(model, near)
        return near.cost - promised[0][0] if promised else -math.inf

    def _look(self, model: Model, near: Refit) -> tuple[Problem, list[tuple[float, FloatArray]]]:
        """Return the problem of a model, and starts with the squares they promise, best first."""
        problem = Problem(model, self.trials, self.scatter)
        problem.set_noise(near.force_noise, near.height_noise, self.jumps)
        begin = carried(near.problem, near.state, problem)
        states = [begin]
        added = [name for name in model.effects if name not in near.model.effects]
        if added:
            states = self._starts(problem, begin, near, added)
        promised = []
        for state in states:
            residual, jacobian = problem.evaluate(state)
            if np.isfinite(residual).all():
                promised.append((_promise(residual, jacobian), state))
        promised.sort(key=lambda each: each[0])
        return problem, promised

    def with_onsets(self, found: Refit) -> Refit:
        """Return a refit whose onsets were looked for anew, if that is better."""
        state = found.state.copy()
        find_onsets(found.problem, state)
        again = self._settled(found.problem, state, found.force_noise, found.height_noise)
        return min((found, again), key=lambda each: each.deviance)

    def _starts(
        self, problem: Problem, begin: FloatArray, near: Refit, added: Sequence[str]
    ) -> list[FloatArray]:
        """Return states with several strengths of the added effects."""
        model = problem.model
        K1, C1, C2 = near.model.values(near.theta)[: len(BASE_PARAMETERS)]
        scale = self.scale(near, K1, C1, C2)
        guess = model.values(model.first_guess(scale))
        new = places_of(model, added)
        signless = any(guess[k] != 0.0 for k in new)
        states = []
        for factor in _FACTORS if signless else _FACTORS[:1]:
            values = model.values(begin[: problem.p])
            values[new] = factor * guess[new]
            state = begin.copy()
            state[: problem.p] = np.clip(model.theta(values), *model.bounds)
            fresh = state.copy()
            # The onsets of the smaller model make up for what it lacks.
            for place in problem.places:
                fresh[place.start] = 0.0
            states += [state, fresh]
        for state in states:
            turn_phases(problem, state)
        return states

    def scale(self, near: Refit, K1: float, C1: float, C2: float) -> Scale:
        """Return what the campaign looks like beside a refit."""
        return scale_of(near.problem, near.state, K1, C1, C2)

    def _settled(
        self, problem: Problem, state: FloatArray, force: SensorNoise, height: SensorNoise
    ) -> Refit:
        """Return the best parameters and the noise that goes with them."""
        for turn in range(2):
            state = minimise(
                problem.evaluate,
                state,
                problem.bounds,
                tolerance=_TOLERANCE if turn else 1e-4,
                max_evaluations=_STEPS,
            ).theta
            force, height = self.noise(problem, state, force, height)
            problem.set_noise(force, height, self.jumps)
        solution = minimise(
            problem.evaluate, state, problem.bounds, tolerance=_TOLERANCE, max_evaluations=_STEPS
        )
        return Refit(
            model=problem.model,
            problem=problem,
            state=solution.theta,
            cost=solution.cost,
            deviance=solution.cost + problem.log_determinant,
            force_noise=force,
            height_noise=height,
        )

    def noise(
        self, problem: Problem, state: FloatArray, force: SensorNoise, height: SensorNoise
    ) -> tuple[SensorNoise, SensorNoise]:
        """Return the noise that makes the residual most likely, near a first guess."""
        forces, heights = [], []
        for index, trial in enumerate(self.trials):
            prediction = problem.predict(state, index, directions=False)
            _, force_zero, height_zero = problem.own(state, index)
            residual = prediction.force + force_zero - trial.force
            forces.append(_bare(force_blocks(trial, self.jumps[index]), residual))
            if trial.height_t.size:
                residual = prediction.height + height_zero - trial.height
                heights.append(_bare(height_blocks(trial), residual))
        force = estimate(forces, force, self.trials[0].interval, everywhere=False)
        if heights:
            interval = self.trials[0].height_interval
            height = estimate(heights, height, interval, everywhere=False)
        return force, height


def _bare(blocks: Blocks, residual: FloatArray) -> Record:
    """Return a record without derivatives: its likelihood is the plain one."""
    none = np.zeros((0, residual.size))
    return Record(blocks, residual, none, none)


def _promise(residual: FloatArray, jacobian: FloatArray) -> float:
    """Return the least squares that the linear model promises."""
    left, singular, _ = np.linalg.svd(jacobian, full_matrices=False)
    explained = left[:, singular > 1e-10 * singular[0]].T @ residual
    return float(residual @ residual - explained @ explained)
