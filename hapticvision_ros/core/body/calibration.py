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
from hapticvision_ros.core.body.links import (
    EFFECTS,
    Gauge,
    Geometry,
    link_law,
    LinkLaw,
    scaled,
    Shares,
)
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion, Touch
from hapticvision_ros.core.body.simulation import Accuracy, BodyRun, Pressed, simulate
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np

_OF_A_SPHERE: Final = 'contact_growth'
"""An effect of the object that no link carries: under a sphere geometry makes it."""
_ALIKE: Final = 5e-3
"""Relative change of numbers that is none."""
_DASHPOTS: Final = LinkLaw(1e-3, 1e3, 1e15)
_STEPS_OF_A_PUSH: Final = 16
_STEPS_OF_A_TOUCH: Final = 64
"""The same where nodes come to the tool one by one."""
_LOOKS: Final = (0.0, 0.125, 0.375, 0.625, 0.875, 1.0)
"""Shares of the depth between which it is told how fast links are stretched."""
WELL: Final = 0.01
"""Share of force or depth up to which a body follows its model well."""
_NOT_LINEAR: Final = frozenset({'yield_force', 'shear_thinning', 'strain_stiffening', 'damage'})
_IN_SERIES: Final = 'series_spring'
"""Beside it shares that change their sign, with large displacements, ask for more steps."""
_DOWN: Final = 0.99
"""Share of the depth at which a push is over."""
_SLIGHT: Final = 0.02
"""Force over the largest from which on its ratio to the model's tells something."""
_CLOSE: Final = 3e-3
"""Largest difference of force and height with which a calibration is content."""
_SLOW: Final = 0.7
"""Cost over that of the round before, from which on numbers alone do no more."""
_STILL: Final = 0.95
"""The same, from which on nothing does more."""
_MORE: Final = 4.0
_LESS: Final = 2.0
"""By how much more, or less, a step is damped after one that failed, or did not."""
_MOST: Final = 20.0
"""Damping with which no further step is tried."""
_TURN: Final = 0.05
"""By how much force and stretch are turned against each other for the derivative."""
_GRID: Final = 256
_FARTHEST_FACTOR: Final = 4.0
"""Largest change of a force's factor in a round."""
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
        The best run, with this law.
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

    @property
    def off(self) -> float:
        """Return the larger of the two misfits [-]."""
        return max(self.force_misfit, self.height_misfit)

    @property
    def alike(self) -> bool:
        """Return whether the links are alike everywhere, as of one material."""
        return self.law.geometry is None or self.law.geometry.shares is None


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
    growth: float = 0.0,
    alike: bool = True,
) -> Geometry | None:
    """
    Return what makes good what a push does to the force of a body by the change of its shape.

    A body of dashpots is pressed at constant speed. Its force tells how fast its links are
    stretched, on and on, as geometry changes and nodes come to the tool. Friction that can be
    overcome counts as none.

    Parameters
    ----------
    lattice, tool, surroundings
        As in `simulation.simulate`.
    depth : float
        How deep [m].
    growth : float
        Exponent of the depth with which the force has to grow, as the m of `contact_growth`.
    alike : bool
        Whether links are alike everywhere, see `links.link_law`.

    Returns
    -------
    Geometry or None
        None for a body of dashpots that does not bear the push.

    """
    around = surroundings or Surroundings()
    around = replace(
        around,
        tool=_without_friction(around.tool),
        support=_without_friction(around.support),
        density=0.0,
    )
    body = Pressed(lattice, _DASHPOTS, tool, around)
    level = body.is_level
    push = ToolMotion(np.array([0.0, 1.0]), np.array([body.top, body.top - depth]))
    even = 1.0 / (_STEPS_OF_A_PUSH if level else _STEPS_OF_A_TOUCH)
    accuracy = Accuracy(position=depth, force=1.0, first_step=even, longest_step=even)
    looks = () if alike else _LOOKS
    try:
        run = simulate(lattice, _DASHPOTS, tool, push, around, accuracy=accuracy, at=looks)
    except InputError:
        return None
    if not (run.force > 0.0).all():
        return None
    at = body.top - 0.5 * (run.tool[1:] + run.tool[:-1])
    share = at / depth
    ratio = run.force / share**growth
    last = max(1.5 * ratio[-1] - 0.5 * ratio[-2], 0.5 * ratio[-1])
    at, share, ratio = np.append(at, depth), np.append(share, 1.0), np.append(ratio, last)
    # A slight push is known where all is touched at once, and else what is touched in the end.
    made_good = (ratio[0] if level else last) / ratio
    lag = share**2 if level else np.log(share)
    if alike:
        half = np.sqrt(made_good)
        return Geometry(at, half, half, lag)
    way = depth * np.array(looks)
    rates = [
        body.stretches(start, end, part)
        for start, end, part in zip(run.frames[:-1], run.frames[1:], np.diff(way), strict=True)
    ]
    shares = Shares.at_depths(0.5 * (way[1:] + way[:-1]), np.stack(rates))
    return Geometry(at, made_good, np.ones_like(at), lag, shares)


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
    alike: bool | None = None,
) -> Calibration:
    """
    Return links for which the body gives force and height of the identified model.

    With large displacements, on a top that is not level, and under a sphere where the model has
    `contact_growth`, first what geometry alone does to the force is measured (`geometry`, one
    short run) and taken out of the links. Each round then simulates the trial, tells from what
    came out how the numbers of the links would bring it nearer to the model (a step by
    Levenberg's method, with the derivatives of the model), and changes them so. Where that does
    no more, rounds also take out what the push has left, by a factor of the links' force at each
    depth, and turn it (`links.Geometry.lag`) as the hold and the recovery ask for. A step from the
    best round so far that does worse is damped: the best is the one whose force and height are
    nearest to the model's in the mean square; push, hold and recovery weigh alike. It ends where
    the largest difference is 0.3 %, or a round does no more.

    Links that are alike everywhere, as of one material, come to a threshold or a power one after
    the other, and the body is not the chain that was identified. Links that are counted in what
    the push stretches them by (`links.Shares`) come to it at once. These are tried first where the
    model has such a law and the tool touches all at once, but not beside a series spring with
    large displacements, which would ask for many more steps, else those that are alike; the other
    ones where the first do not follow the model within 1 %, but not under a ball whose model has
    no contact that grows. A body with weight has links that are alike: in the others a threshold
    would be as small as what the push does to a link, and what hardly feels the push would flow
    under its weight.

    Parameters
    ----------
    lattice : Lattice
        The body at rest.
    model : Model
        The identified model; its effects of cell and sensor are left out of account. Under a
        sphere it may have `contact_growth`.
    parameters : mapping of str to float
        Its parameters by name, SI.
    tool, motion, surroundings, at, accuracy
        As in `simulation.simulate`.
    reference_depth : float, optional
        d_ref of the model [m]; the deepest point of the motion by default.
    rounds : int
        Runs at most, with either kind of links.
    alike : bool, optional
        Only links that are alike everywhere, or only those that are not; by default the first
        kind that follows the model within 1 %, else the better.

    Raises
    ------
    InputError
        If the model has an effect of the object that no link can carry, or a number that no link
        can have, or `simulate` does.

    """
    around = surroundings or Surroundings()
    body = Pressed(lattice, LinkLaw(1.0, 1.0, 1.0), tool, around)
    # No links follow a model whose contact does not grow under a ball.
    hopeless = tool.sphere and _OF_A_SPHERE not in model.effects
    if alike is not None:
        kinds = [alike]
    elif around.density > 0.0 or hopeless:
        kinds = [True]
    else:
        effects = set(model.effects)
        even = body.is_level and bool(effects & _NOT_LINEAR)
        even = even and (around.small or _IN_SERIES not in effects)
        kinds = [not even, even]
    found: list[Calibration] = []
    failed: list[InputError] = []
    for kind in kinds:
        try:
            found.append(
                _calibrated(
                    body,
                    model,
                    parameters,
                    motion,
                    reference_depth=reference_depth,
                    at=at,
                    rounds=rounds,
                    accuracy=accuracy,
                    alike=kind,
                )
            )
        except InputError as error:
            failed.append(error)
        if found and found[-1].off <= WELL:
            break
    if not found:
        raise failed[0]
    best = min(found, key=lambda one: one.off)
    return replace(best, rounds=sum(one.rounds for one in found))


def _calibrated(
    body: Pressed,
    model: Model,
    parameters: Mapping[str, float],
    motion: ToolMotion,
    *,
    reference_depth: float | None,
    at: Sequence[float],
    rounds: int,
    accuracy: Accuracy | None,
    alike: bool,
) -> Calibration:
    """Return the best links of one kind for a body at rest, see `calibrate`."""
    lattice, tool, around = body.lattice, body.tool, body.surroundings
    alone, wanted = carried(model, parameters, tool)
    target = np.array(list(wanted.values()))
    top = body.top
    deepest = top - float(motion.height.min())
    if not deepest > 0.0:
        raise InputError(
            f'the tool does not touch the body: it stays {-1e3 * deepest:.3g} mm over it'
        )
    depth = reference_depth or deepest
    measure = gauge(lattice, tool, around, depth=deepest)
    law = link_law(wanted, measure, reference_depth=depth, alike=alike)
    grows = {p.symbol for e in alone.declared if e.name == _OF_A_SPHERE for p in e.parameters}
    growth = [wanted[name] for name in grows]
    known = None
    if growth or not (tool.sphere or (around.small and body.is_level)):
        known = geometry(lattice, tool, deepest, around, growth=sum(growth), alike=alike)
    if not alike and (known is None or known.shares is None):
        slight = Shares.at_depths(np.zeros(1), measure.shares[None])
        known = replace(known or Geometry.none(), shares=slight)
    law = replace(law, geometry=known)
    given = {name for name, value in wanted.items() if value > 0.0 and name not in grows}
    used = np.array([name in given for name in alone.names])
    names = [name for name in alone.names if name in given]
    # Under a sphere a model without the growth of its contact is not to be made right by force.
    learnable = not tool.sphere or bool(grows)
    damping, learns = 1.0, False
    best: _Round | None = None
    done = 0
    while done < rounds:
        if best is not None:
            law = best.changed(names, damping, learns=learns)
        done += 1
        try:
            run = simulate(lattice, law, tool, motion, around, at=at, accuracy=accuracy)
        except InputError:
            if best is None:
                raise
            damping *= _MORE
            if damping > _MOST:
                break
            continue
        if run.force.max() <= 0.0:
            raise InputError(
                'the tool does not reach the body, which sinks under its own weight: choose a '
                'smaller density'
            )
        trial = _Driven(run.t, top - run.tool, run.t, depth)
        # A recorded tool is not quite still in the hold.
        pushed = int(np.argmax(top - run.tool >= _DOWN * (top - run.tool.min())))
        misses = _Misses(alone, trial, run, motion.corners, sum(growth))
        found = _Round(law, run, misses, target, used, pushed)
        better = best is None or found.cost < best.cost
        before = math.inf if best is None else best.cost
        # A damped step that does little tells nothing.
        tells = damping <= _LESS
        if better:
            best = found
            damping = max(damping / _LESS, 1.0)
        else:
            damping *= _MORE
        assert best is not None
        close = max(best.off) < _CLOSE
        no_more = better and tells and best.cost > _STILL * before
        if damping > _MOST or (learns and (close or no_more)):
            break
        if not learns:
            change = np.abs(best.change(damping, learns=False)).max(initial=0.0)
            settled = float(change) < _ALIKE
            slow = best.cost > _SLOW * before
            if (close and (settled or slow)) or (settled and not learnable):
                break
            if learnable and not close and (settled or slow or 2 * done >= rounds):
                damping, learns = 1.0, True
    if best is None:
        raise InputError('a calibration has at least one round: ask for one or more')
    recovered = dict(zip(alone.names, (float(v) for v in best.misses.fit(target)), strict=True))
    return Calibration(best.law, best.run, recovered, *best.off, done)


def carried(
    model: Model, parameters: Mapping[str, float], tool: Tool
) -> tuple[Model, dict[str, float]]:
    """
    Return the model of the object alone, and its numbers.

    Raises
    ------
    InputError
        If the model has an effect of the object, or a number, that no link can have.

    """
    effects = (*EFFECTS, _OF_A_SPHERE) if tool.sphere else EFFECTS
    strange = [e.name for e in model.declared if e.kind == 'object' and e.name not in effects]
    if strange:
        tip = f'; {_OF_A_SPHERE} is that of a spherical tool' if _OF_A_SPHERE in strange else ''
        raise InputError(
            f'no link can carry {", ".join(strange)}: simulate the shape with a model of '
            f'{", ".join(EFFECTS)} only{tip}'
        )
    alone = Model(tuple(name for name in model.effects if name in effects))
    wanted = {name: parameters[name] for name in alone.names}
    bad = next((name for name, value in wanted.items() if not 0.0 <= value < math.inf), None)
    if bad is not None or min(wanted['K1'], wanted['C2']) <= 0.0:
        bad = bad or ('K1' if wanted['K1'] <= 0.0 else 'C2')
        raise InputError(
            f'{bad} of the model is {wanted[bad]:g}, which no body can have: fit it again'
        )
    return alone, wanted


@dataclass(frozen=True, slots=True, eq=False)
class _Driven:
    """A run as a trial: see `DrivenTrial`."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    reference_depth: float
    campaign_time: float = 0.0
    depth_before: float = 0.0
    zero_time: float = 0.0


class _Misses:
    """What separates a run from the model, each phase with the same weight."""

    def __init__(
        self,
        model: Model,
        trial: _Driven,
        run: BodyRun,
        corners: Sequence[float],
        growth: float,
    ) -> None:
        self.model, self.trial, self.run, self._growth = model, trial, run, growth
        # Steps are short where much happens: those of a phase weigh alike.
        phase = np.searchsorted(np.array(corners) - 1e-9, run.t[:-1], side='right')
        weight = 1.0 / np.sqrt(np.bincount(phase)[phase])
        self._by_force = weight / max(float(run.force.max()), 1e-300)
        free = np.append(0.0, weight * (run.touching == 0))
        self._by_height = free / max(float(run.height.max()), 1e-300)

    def values(self, theta: FloatArray, level: FloatArray | float = 1.0) -> FloatArray:
        """Return the misses for parameters of the model; the run's force is brought to a level."""
        told = self.model.predict(self.trial, theta, directions=False)
        return np.concatenate(
            [
                self._by_force * (told.force - self.run.force / level),
                self._by_height * (told.height - self.run.height),
            ]
        )

    def slopes(self, theta: FloatArray) -> FloatArray:
        """Return their derivatives in theta, one column each."""
        told = self.model.predict(self.trial, theta)
        rows = slice(0, theta.size)
        return np.concatenate(
            [(self._by_force * told.d_force[rows]).T, (self._by_height * told.d_height[rows]).T]
        )

    def turned(self, theta: FloatArray, geometry: Geometry) -> FloatArray:
        """Return how the misses go as force and stretch are turned against each other."""
        way = self.trial.displacement
        deepest = float(way.max())
        grid = np.linspace(0.0, deepest, _GRID)
        turn = np.exp(_TURN * np.interp(grid, geometry.depth, geometry.lag))
        slope = 0.5 * (1.0 / turn[1:] + 1.0 / turn[:-1])
        taken = np.append(0.0, np.cumsum(slope * np.diff(grid)))
        there = np.where(way > 0.0, np.interp(way, grid, taken), way)
        told = self.model.predict(self.trial, theta, directions=False)
        other = self.model.predict(
            replace(self.trial, displacement=there), theta, directions=False
        )
        middle = 0.5 * (way[1:] + way[:-1])
        # The contact grows with the depth of the tool, whatever the chain is given of it.
        turn[1:] *= (grid[1:] / taken[1:]) ** self._growth
        force = other.force * np.interp(middle, grid, turn) - told.force
        height = np.interp(other.height, taken, grid)
        free = np.flatnonzero(self.run.touching > 0)[-1] + 1
        back = (other.height[free] - other.height[free:]) * grid[-1] / taken[-1]
        height[free:] = height[free] - back
        height -= told.height
        return np.concatenate([self._by_force * force, self._by_height * height]) / _TURN

    def fit(self, start: FloatArray) -> FloatArray:
        """Return the parameters with which the model comes closest to the run."""
        from scipy.optimize import least_squares

        lower, upper = self.model.bounds
        theta = np.clip(self.model.theta(start), lower, upper)
        found = least_squares(
            self.values,
            theta,
            self.slopes,
            bounds=(lower, upper),
            x_scale='jac',
            xtol=1e-10,
            ftol=1e-12,
        )
        return self.model.values(found.x)


class _Round:
    """
    A round of the calibration: how far a run is off the model, and what would bring it nearer.

    Attributes
    ----------
    off : tuple of float
        Largest difference of force and of height, over the largest force and the depth.
    cost : float
        Norm of what separates run and model.

    """

    def __init__(
        self,
        law: LinkLaw,
        run: BodyRun,
        misses: _Misses,
        target: FloatArray,
        used: BoolArray,
        pushed: int,
    ) -> None:
        self.law, self.run, self.misses = law, run, misses
        model = misses.model
        self._theta = model.theta(target)
        self._scale = np.where(model.log, 1.0, target)
        self._used = used
        told = model.predict(misses.trial, self._theta, directions=False)
        force = float(np.abs(run.force - told.force).max() / np.abs(told.force).max())
        height = float(np.abs(run.height - told.height).max() / np.abs(told.height).max())
        self.off = force, height
        self.cost = float(np.linalg.norm(misses.values(self._theta)))
        self._ratio = np.ones_like(run.force)
        known = (told.force > _SLIGHT * told.force.max()) & (run.force > 0.0)
        known[pushed:] = False
        if known.any():
            share = run.force[known] / told.force[known]
            ends = run.t[1:]
            # What is left at the end of the push is left in the hold as well.
            ratio = np.interp(ends[:pushed], ends[known], share / share[-1])
            self._ratio[:pushed] = np.clip(ratio, 1.0 / _FARTHEST_FACTOR, _FARTHEST_FACTOR)
        self._pushed = pushed

    def change(self, damping: float, *, learns: bool) -> FloatArray:
        """
        Return a change of the logarithms of the links' numbers: a step of Levenberg's method.

        The chain in one dimension tells how force and height follow them. Damped as they are
        missed: numbers that make up for each other are not moved far for what no number makes
        good. Where what the push has left is taken out, it is left out here, and the last element
        is how much to turn the geometry.

        """
        missed = self.misses.values(self._theta, self._ratio if learns else 1.0)
        slopes = (self.misses.slopes(self._theta) * self._scale)[:, self._used]
        if learns and self.law.geometry is not None:
            turned = self.misses.turned(self._theta, self.law.geometry)
            slopes = np.column_stack([slopes, turned])
        damped = damping * float(np.linalg.norm(missed)) * np.eye(slopes.shape[1])
        rows = np.concatenate([slopes, damped])
        wanted = np.concatenate([missed, np.zeros(len(damped))])
        found = np.linalg.lstsq(rows, wanted, rcond=1e-9)[0]
        return np.asarray(np.clip(found, -_FARTHEST, _FARTHEST))

    def changed(self, names: Sequence[str], damping: float, *, learns: bool) -> LinkLaw:
        """Return the law with that change, and with what the push has left taken out."""
        change = self.change(damping, learns=learns)
        count = len(names)
        factors = (float(factor) for factor in np.exp(change[:count]))
        law = scaled(self.law, dict(zip(names, factors, strict=True)))
        if not learns or self._pushed == 0:
            return law
        way = self.misses.trial.displacement
        depth = np.maximum.accumulate(0.5 * (way[1:] + way[:-1]))
        depth, first = np.unique(depth[: self._pushed], return_index=True)
        known = law.geometry or Geometry.none()
        turned = float(change[count:].sum())
        refined = known.refined(depth, self._ratio[first] ** (-1.0 / damping), turned)
        return replace(law, geometry=refined)
