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

"""The numbers of the links from those of the identified model."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Final

from hapticvision_ros.core.body.lattice import BoolArray, Lattice
from hapticvision_ros.core.body.links import EFFECTS, Gauge, Geometry, link_law, LinkLaw, scaled
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion, Touch
from hapticvision_ros.core.body.simulation import Accuracy, BodyRun, Pressed, simulate
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np

_OF_A_SPHERE: Final = 'contact_growth'
"""An effect of the object that no link carries: under a sphere it makes itself."""
_ALIKE: Final = 5e-4
"""Relative difference between identified and fitted that makes none."""
_SPRINGS: Final = LinkLaw(1e3, 0.0, 1e15)
_DASHPOTS: Final = LinkLaw(1e-3, 1e3, 1e15)
_STEPS_OF_A_PUSH: Final = 16
_DOWN: Final = 0.99
"""Share of the depth at which a push is over."""
_FARTHEST: Final = 0.5
"""Largest change of a logarithm in a round."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """
    Links that give the identified force.

    Parameters
    ----------
    law : LinkLaw
        Of the links.
    run : BodyRun
        The last run, with this law.
    recovered : dict of str to float
        What the identified model gives when it is fitted to force and height of that run.
    force_misfit, height_misfit : float
        Largest difference between that run and the identified model, over the largest force and
        over the deepest push [-].
    rounds : int
        How many runs it took.

    """

    law: LinkLaw
    run: BodyRun
    recovered: dict[str, float]
    force_misfit: float
    height_misfit: float
    rounds: int


def gauge(
    lattice: Lattice,
    tool: Tool,
    surroundings: Surroundings | None = None,
    *,
    depth: float = 0.0,
) -> Gauge:
    """
    Return how the body passes a small push on to its links, by one static solve.

    Parameters
    ----------
    lattice, tool, surroundings
        As in `simulation.simulate`.
    depth : float
        How deep a sphere is pushed, which says how much of it touches [m].

    """
    return Pressed(lattice, LinkLaw(1.0, 1.0, 1.0), tool, surroundings or Surroundings()).static(
        depth
    )


def geometry(
    lattice: Lattice,
    tool: Tool,
    depth: float,
    surroundings: Surroundings | None = None,
    *,
    lasting: float = 1.0,
) -> Geometry | None:
    """
    Return what a push does to the force of a body by the change of its shape alone.

    A body of springs and one of dashpots are pressed at constant speed, with the links' directions
    as they are and as they were at rest. Friction that can be overcome counts as none.

    Parameters
    ----------
    lattice, tool, surroundings
        As in `simulation.simulate`.
    depth : float
        How deep [m].
    lasting : float
        How long the push takes for which it is wanted [s].

    Returns
    -------
    Geometry or None
        None for a body of which one of these does not bear the push, and under a sphere: its
        nodes come to the tool one by one, at other depths in each of these runs.

    """
    if tool.sphere:
        return None
    around = surroundings or Surroundings()
    around = replace(
        around,
        tool=_without_friction(around.tool),
        support=_without_friction(around.support),
        density=0.0,
    )
    top = Pressed(lattice, _SPRINGS, tool, around).meets()
    push = ToolMotion(np.array([0.0, 1.0]), np.array([top, top - depth]))
    even = 1.0 / _STEPS_OF_A_PUSH
    accuracy = Accuracy(position=depth, force=1.0, first_step=even, longest_step=even)
    middle = depth * even * (np.arange(_STEPS_OF_A_PUSH) + 0.5)
    ratios = []
    for law in (_SPRINGS, _DASHPOTS):
        forces = []
        for small in (False, True):
            try:
                run = simulate(
                    lattice, law, tool, push, replace(around, small=small), accuracy=accuracy
                )
            except InputError:
                return None
            # Where the surface is not level, the tool has gone farther than what it touches.
            forces.append(np.interp(middle, 0.5 * (run.height[1:] + run.height[:-1]), run.force))
        true, linear = forces
        if not (true > 0.0).all() or not (linear > 0.0).all():
            return None
        ratios.append(true / linear)
    at = np.array([0.0, *middle, depth])
    springs, dashpots = (
        np.array([1.0, *one, max(1.5 * one[-1] - 0.5 * one[-2], 0.5 * one[-1])]) for one in ratios
    )
    return Geometry(at, springs, dashpots, lasting)


def _without_friction(touch: Touch) -> Touch:
    return touch if math.isinf(touch.friction) else replace(touch, friction=0.0)


def calibrate(
    lattice: Lattice,
    model: Model,
    parameters: Mapping[str, float],
    tool: Tool,
    motion: ToolMotion,
    surroundings: Surroundings | None = None,
    *,
    reference_depth: float | None = None,
    at: Sequence[float] = (),
    rounds: int = 4,
    accuracy: Accuracy | None = None,
) -> Calibration:
    """
    Return links for which the body gives force and height of the identified model.

    With large displacements, first what geometry alone does to the force is measured (`geometry`,
    four short runs) and taken out of the links. Each round then simulates the trial, tells from
    what came out how far the model's parameters have moved (one step of the fit, by Levenberg's
    method), and takes the numbers of the links back by that; how these follow each other is learnt
    on the way (Broyden). A round that does worse than the best
    so far is taken back by half: the best is the one whose force and height are nearest to the
    model's in the mean square, or where a fit would change nothing any more. Push, hold and
    recovery weigh alike.

    Parameters
    ----------
    lattice : Lattice
        The body at rest.
    model : Model
        The identified model; its effects of cell and sensor are left out of account. Under a
        sphere it may have `contact_growth`, which the contact of the body then has to give.
    parameters : mapping of str to float
        Its parameters by name, SI.
    tool, motion, surroundings, at, accuracy
        As in `simulation.simulate`.
    reference_depth : float, optional
        d_ref of the model [m]; the deepest point of the motion by default.
    rounds : int
        Runs at most.

    Raises
    ------
    InputError
        If the model has an effect of the object that no link can carry, or a number that no link
        can have, or `simulate` does.

    """
    effects = (*EFFECTS, _OF_A_SPHERE) if tool.sphere else EFFECTS
    strange = [e.name for e in model.declared if e.kind == 'object' and e.name not in effects]
    if strange:
        tip = f'; {_OF_A_SPHERE} is that of a spherical tool' if _OF_A_SPHERE in strange else ''
        raise InputError(
            f'no link can carry {", ".join(strange)}: simulate the shape with a model of '
            f'{", ".join(EFFECTS)} only{tip}'
        )
    carried = Model(tuple(name for name in model.effects if name in effects))
    wanted = {name: parameters[name] for name in carried.names}
    bad = next((name for name, value in wanted.items() if not 0.0 <= value < math.inf), None)
    if bad is not None or min(wanted['K1'], wanted['C2']) <= 0.0:
        bad = bad or ('K1' if wanted['K1'] <= 0.0 else 'C2')
        raise InputError(
            f'{bad} of the model is {wanted[bad]:g}, which no body can have: fit it again'
        )
    target = np.array(list(wanted.values()))
    top = Pressed(lattice, LinkLaw(1.0, 1.0, 1.0), tool, surroundings or Surroundings()).meets()
    deepest = top - float(motion.height.min())
    depth = reference_depth or deepest
    measure = gauge(lattice, tool, surroundings, depth=deepest)
    law = link_law(wanted, measure, reference_depth=depth)
    if not (surroundings or Surroundings()).small:
        # A recorded tool is not quite still in the hold.
        low = top - motion.height >= _DOWN * deepest
        lasting = float(motion.t[np.argmax(low)] - motion.t[0])
        known = geometry(lattice, tool, deepest, surroundings, lasting=lasting)
        law = replace(law, geometry=known)
    grows = {p.symbol for e in carried.declared if e.name == _OF_A_SPHERE for p in e.parameters}
    given = {name for name, value in wanted.items() if value > 0.0 and name not in grows}
    used = np.array([name in given for name in carried.names])
    names = [name for name in carried.names if name in given]
    follows = np.eye(len(names))
    change = np.zeros(len(names))
    best: _Round | None = None
    done = 0
    while done < rounds:
        done += 1
        try:
            run = simulate(lattice, law, tool, motion, surroundings, at=at, accuracy=accuracy)
        except InputError:
            if best is None:
                raise
            change *= 0.5
            law = _changed(best.law, names, change)
            continue
        trial = _Driven(run.t, top - run.tool, run.t, depth)
        misses = _Misses(carried, trial, run, motion.corners)
        off, cost = _off(carried, target, used, misses)
        if best is not None:
            # Broyden's update of how the fit follows the links; alike is where it starts.
            missed = off - best.off - follows @ change
            follows += np.outer(missed, change) / max(float(change @ change), 1e-300)
        share = 1.0
        settled = float(np.abs(off).max(initial=0.0)) < _ALIKE
        if best is None or settled or cost < best.cost:
            best = _Round(law, run, trial, off, cost)
        else:
            share = 0.5
        if settled:
            break
        wish = -np.linalg.lstsq(follows, best.off, rcond=1e-3)[0]
        change = share * np.clip(wish, -_FARTHEST, _FARTHEST)
        law = _changed(best.law, names, change)
    if best is None:
        raise InputError('a calibration has at least one round: ask for one or more')
    law, run, trial = best.law, best.run, best.trial
    told = carried.predict(trial, carried.theta(target), directions=False)
    force = float(np.abs(run.force - told.force).max() / np.abs(told.force).max())
    height = float(np.abs(run.height - told.height).max() / np.abs(told.height).max())
    fitted = _fit(carried, target, trial, run, motion.corners)
    recovered = {name: float(v) for name, v in zip(carried.names, fitted, strict=True)}
    return Calibration(law, run, recovered, force, height, done)


@dataclass(frozen=True, slots=True, eq=False)
class _Round:
    """A round of the calibration: how far the fit to its run is off, and how much is missed."""

    law: LinkLaw
    run: BodyRun
    trial: '_Driven'
    off: FloatArray
    cost: float


def _changed(law: LinkLaw, names: Sequence[str], change: FloatArray) -> LinkLaw:
    """Return a law with the logarithms of its numbers changed."""
    factors = (float(factor) for factor in np.exp(change))
    return scaled(law, dict(zip(names, factors, strict=True)))


@dataclass(frozen=True, slots=True, eq=False)
class _Driven:
    """A run as a trial: see `DrivenTrial`."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    reference_depth: float
    campaign_time: float = 0.0
    zero_time: float = 0.0


class _Misses:
    """What separates a run from the model, each phase with the same weight."""

    def __init__(
        self, model: Model, trial: _Driven, run: BodyRun, corners: Sequence[float]
    ) -> None:
        self._model, self._trial, self._run = model, trial, run
        long = np.diff(run.t)
        phase = np.searchsorted(np.array(corners) - 1e-9, run.t[:-1], side='right')
        weight = np.sqrt(long / np.bincount(phase, long)[phase])
        self._by_force = weight / max(float(run.force.max()), 1e-300)
        free = np.append(0.0, weight * (run.touching == 0))
        self._by_height = free / max(float(run.height.max()), 1e-300)

    def values(self, theta: FloatArray) -> FloatArray:
        """Return the misses for parameters of the model."""
        told = self._model.predict(self._trial, theta, directions=False)
        return np.concatenate(
            [
                self._by_force * (told.force - self._run.force),
                self._by_height * (told.height - self._run.height),
            ]
        )

    def slopes(self, theta: FloatArray) -> FloatArray:
        """Return their derivatives in theta, one column each."""
        told = self._model.predict(self._trial, theta)
        rows = slice(0, theta.size)
        return np.concatenate(
            [(self._by_force * told.d_force[rows]).T, (self._by_height * told.d_height[rows]).T]
        )


def _off(
    model: Model, target: FloatArray, used: BoolArray, misses: _Misses
) -> tuple[FloatArray, float]:
    """
    Return by how much a step of a fit to a run changes the logarithms of the used parameters.

    Beside it stands the norm of what separates run and model. Where the body cannot follow the
    model, the largest change tells little of it: parameters that make up for each other move far
    for nothing.

    """
    theta = model.theta(target)
    missed = misses.values(theta)
    slopes = misses.slopes(theta) * np.where(model.log, 1.0, target)
    cost = float(np.linalg.norm(missed))
    # As in Levenberg's method, with a damping that goes as the misses go: numbers that make up for
    # each other are not moved far for what no number can make good.
    damping = cost * np.eye(int(np.count_nonzero(used)))
    rows = np.concatenate([slopes[:, used], damping])
    wanted = np.concatenate([-missed, np.zeros(len(damping))])
    return np.linalg.lstsq(rows, wanted, rcond=1e-9)[0], cost


def _fit(
    model: Model, start: FloatArray, trial: _Driven, run: BodyRun, corners: Sequence[float]
) -> FloatArray:
    """Return the parameters with which the model comes closest to a run."""
    from scipy.optimize import least_squares

    misses = _Misses(model, trial, run, corners)
    lower, upper = model.bounds
    theta = np.clip(model.theta(start), lower, upper)
    found = least_squares(
        misses.values,
        theta,
        misses.slopes,
        bounds=(lower, upper),
        x_scale='jac',
        xtol=1e-10,
        ftol=1e-12,
    )
    return model.values(found.x)
