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


"""How alike effects are in a campaign, and what each is worth on trials that it has not seen."""

from collections.abc import Sequence
from typing import Final

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.refit import Columns, Refit, Workbench
from hapticvision_ros.core.diagnosis.selection import Trialled
from hapticvision_ros.core.fit.campaign import Problem
from hapticvision_ros.core.fit.least_squares import orthonormal
from hapticvision_ros.core.records import FloatArray
import numpy as np

_HIDDEN: Final = 1e-3
"""An effect is hidden if the base model can make up for all but this part of what it does."""
_ALIKE: Final = 0.8
"""Cosine from which on two effects are said to look alike."""


def direction(bench: Workbench, base: Refit, effect: str, refit: Refit | None) -> list[Columns]:
    """
    Return what an effect changes in the prediction, in the form of the fit.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The model without it.
    effect : str
        The effect.
    refit : Refit or None
        The model with it, if it was fitted; otherwise its first guess is taken.

    Returns
    -------
    list of Columns
        One curve in each trial.

    """
    if refit is None:
        problem, states = bench.guesses(Model((*base.model.effects, effect)), base)
        return change(bench, base, problem, states[0])
    return change(bench, base, refit.problem, refit.state)


def change(bench: Workbench, base: Refit, problem: Problem, state: FloatArray) -> list[Columns]:
    """
    Return what a state changes in the prediction of the base model.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The base model.
    problem : Problem
        Another problem, of as many steps in each trial.
    state : ndarray
        Its parameters.

    Returns
    -------
    list of Columns
        One curve in each trial.

    """
    result = []
    for index in range(len(bench.trials)):
        force, height = bench.residual(problem, state, index)
        base_force, base_height = bench.residual(base.problem, base.state, index)
        result.append(
            Columns((base_force - force)[np.newaxis], (base_height - height)[np.newaxis])
        )
    return result


class Tangent:
    """
    What the parameters of a model can make up for, to first order.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The model.

    """

    def __init__(self, bench: Workbench, base: Refit) -> None:
        self._whiteners = bench.whiteners(base.force_noise, base.height_noise, base.jumps)
        problem = base.problem
        blocks = []
        for index, place in enumerate(problem.places):
            force, height = problem.records(base.state, index)
            rows = self._white(index, force[:-1], height[:-1])
            block = np.zeros((problem.size, rows.shape[1]))
            shared, own = np.split(rows, [problem.p])
            block[: problem.p] = shared
            block[place] = own
            blocks.append(block)
        prior, _ = problem.priors(base.state)
        self._priors = prior.shape[0]
        self._basis = orthonormal(np.hstack((*blocks, prior.T)))

    def white(self, curve: Sequence[Columns]) -> FloatArray:
        """Return a curve over the noise, as one vector."""
        parts = [
            self._white(index, each.force, each.height)[0] for index, each in enumerate(curve)
        ]
        return np.concatenate((*parts, np.zeros(self._priors)))

    def beyond(self, curve: Sequence[Columns]) -> FloatArray:
        """Return a curve over the noise less what the parameters can make up for."""
        white = self.white(curve)
        # Directions that are nearly alike are not quite at right angles the first time.
        for _ in range(2):
            white = white - (self._basis @ white) @ self._basis
        return np.asarray(white, dtype=np.float64)

    def _white(self, index: int, force: FloatArray, height: FloatArray) -> FloatArray:
        force_filter, height_filter = self._whiteners[index]
        rows = force_filter(np.ascontiguousarray(force))
        if height_filter is not None:
            rows = np.hstack((rows, height_filter(np.ascontiguousarray(height))))
        return rows


def visible(bench: Workbench, base: Refit, tangent: Tangent, effect: str) -> bool:
    """
    Return whether an effect would show at all.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The base model.
    tangent : Tangent
        What its parameters can make up for.
    effect : str
        The effect.

    Returns
    -------
    bool
        False if what it does is nothing at any usual strength, or nothing that the base model
        could not do as well.

    """
    problem, states = bench.guesses(Model((*base.model.effects, effect)), base)
    for state in states:
        curve = change(bench, base, problem, state)
        raw = float(np.linalg.norm(tangent.white(curve)))
        if raw > 0.0 and float(np.linalg.norm(tangent.beyond(curve))) > _HIDDEN * raw:
            return True
    return False


def pairs(
    bench: Workbench, base: Refit, tried: Sequence[Trialled], accepted: Sequence[str]
) -> tuple[tuple[str, str, float], ...]:
    """
    Return which effects look like the accepted ones in these trials.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The base model.
    tried : sequence of Trialled
        The candidates beside it.
    accepted : sequence of str
        The accepted effects.

    Returns
    -------
    tuple of (str, str, float)
        Accepted effect, other, and the cosine of what they change beyond what the base model can
        make up for; most alike first. The nearest of each is there, however unlike it is.

    """
    if not accepted:
        return ()
    names = [each.effect for each in tried]
    tangent = Tangent(bench, base)
    own = {
        each.effect: tangent.beyond(direction(bench, base, each.effect, each.refit))
        for each in tried
    }
    found = []
    for one in accepted:
        if one not in own:
            continue
        near = []
        for other in names:
            if other == one or (other in accepted and accepted.index(other) < accepted.index(one)):
                continue
            length = float(np.linalg.norm(own[one]) * np.linalg.norm(own[other]))
            cosine = abs(float(own[one] @ own[other])) / length if length > 0.0 else 0.0
            near.append((one, other, min(cosine, 1.0)))
        near.sort(key=lambda each: -each[2])
        # What fits is not thereby true: the nearest is told in any case.
        found += [each for each in near if each[2] > _ALIKE] or near[:1]
    return tuple(sorted(found, key=lambda each: -each[2]))


def left_out(
    bench: Workbench, base: Refit, refit: Refit, groups: Sequence[Sequence[int]]
) -> float | None:
    """
    Return the squares on pushes left out in turn, with an effect over without it.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base, refit : Refit
        The model without and with the effect.
    groups : sequence of sequence of int
        The trials of each push.

    Returns
    -------
    float or None
        The ratio, by linearising both models about their fits and at the same noise; None with
        a single push.

    """
    if len(groups) < 2:
        return None
    plain = Problem(base.model, bench.trials, bench.scatter)
    plain.set_noise(refit.force_noise, refit.height_noise, refit.jumps)
    without = _unseen_squares(plain, base.state, groups)
    if without <= 0.0:
        return None
    return _unseen_squares(refit.problem, refit.state, groups) / without


def _unseen_squares(problem: Problem, state: FloatArray, groups: Sequence[Sequence[int]]) -> float:
    """Return the squares of each group at the parameters that the others ask for."""
    p = problem.p
    parts = []
    for index in range(len(problem.trials)):
        residual, jacobian = problem.reduced(state, index)
        # What the trial's own parameters can do is done.
        basis, singular, _ = np.linalg.svd(jacobian[:, p:], full_matrices=False)
        basis = basis[:, singular > 1e-10 * singular[0]] if singular.size else basis
        shared = jacobian[:, :p] - basis @ (basis.T @ jacobian[:, :p])
        parts.append((residual - basis @ (basis.T @ residual), shared))
    total = 0.0
    for group in groups:
        others = [part for index, part in enumerate(parts) if index not in group]
        residual = np.concatenate([r for r, _ in others])
        shared = np.vstack([j for _, j in others])
        scale = np.sqrt(np.sum(shared**2, axis=0))
        told = scale > 0.0
        change = np.zeros(p)
        change[told] = -np.linalg.lstsq(shared[:, told] / scale[told], residual, rcond=1e-9)[0]
        change[told] /= scale[told]
        for index in group:
            left = parts[index][0] + parts[index][1] @ change
            total += float(left @ left)
    return total
