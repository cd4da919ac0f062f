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
The body under a tool, quasi-static and implicit: force, height and positions over time.

Inertia is left out. The unknowns of a step are the positions at its end, for which the mean forces
of the links over the step, the pressures of the cells, contact and weight balance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.body import forces
from hapticvision_ros.core.body.contact import Contact, Holds
from hapticvision_ros.core.body.lattice import (
    BoolArray,
    CORNERS,
    DIRECTIONS,
    IndexArray,
    Lattice,
)
from hapticvision_ros.core.body.links import Gauge, LinkLaw, not_less
from hapticvision_ros.core.body.multigrid import Multigrid, project
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np

_MODULUS: Final = 1.875
"""Young's modulus of the lattice times pitch over link stiffness."""
_ITERATIONS: Final = 20
_SLOW: Final = 0.01
"""Rate over the reference rate of a power law at which cells still keep their volume."""
_TURNED: Final = 0.02
"""Change of the friction in the last iteration, over the largest."""
_POOR: Final = 0.3
"""By how much an iteration has to lower what is out of balance, for its matrix to be kept."""
_NEARLY: Final = 5.0
"""What may be out of balance where contact is judged, over what may be at the end."""
_SETTLED: Final = 0.1
"""Change of the positions in the last iteration, over the error that a step may make."""
_CLOSE: Final = 1e-3
"""The same at most, over the pitch."""
_SHARE: Final = 1.0 / 6.0
"""Error of a step over the difference between it and the line through the step before."""
_SHORTEST: Final = 1.0 / 64.0
"""Shortest step, over the first after a corner."""
_SAFE: Final = 0.85
_FRESH: Final = 3.0
"""First step over the relaxation time of a series spring, over the root of the force's error."""
_EVENT: Final = 4.0
"""Force of nodes that leave within a step, at most, over the error of the force."""
_DAMPED: Final = 1.65
"""Largest weight of the end of a step of a series spring where friction is overcome; 2 is all."""
_AT_ONCE: Final = 0.01
"""How far nodes are from the tool at the first touch that it touches at once, over the pitch."""
_LEAST_SHARE: Final = 0.2
"""A link that a push hardly stretches counts as stretched by this, over the root mean square."""
_ON: Final = 1.0 + 1e-6
"""How far from the tool's edge a node is still under it."""
_DRAG: Final = 1e-6
"""What holds a body that nothing else does, over the stiffness of a node."""


@dataclass(frozen=True, slots=True)
class Accuracy:
    """
    How finely time is cut.

    Parameters
    ----------
    position : float
        Error of the positions that a step may make [m].
    force : float
        The same of the force at the end of a step, relative to the largest so far; controlled
        where there is a series spring, as without one the force follows the positions.
    first_step : float
        Length of the first step after a corner of the tool's path [s].
    longest_step : float
        [s]
    growth : float
        By how much a step may be longer than the one before.
    balance : float
        Force that may be left over, relative to the largest so far.

    """

    position: float = 2e-5
    force: float = 5e-4
    first_step: float = 0.1
    longest_step: float = 10.0
    growth: float = 1.5
    balance: float = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class BodyRun:
    """
    What the body did in n steps.

    Parameters
    ----------
    lattice : Lattice
        The body at rest.
    t : ndarray, shape (n + 1,)
        Ends of the steps [s].
    force : ndarray, shape (n,)
        Mean force on the tool over each step, positive in compression [N].
    tool : ndarray, shape (n + 1,)
        Height of the tool's tip [m].
    height : ndarray, shape (n + 1,)
        Displacement height at the contact: how far the surface has gone down where the tool first
        touched it, the mean over these nodes [m].
    touching : ndarray of int, shape (n,)
        How many nodes the tool touches.
    volume : ndarray, shape (n + 1,)
        [m^3]
    work : ndarray, shape (n + 1,)
        What the tool has done so far [J].
    stored : ndarray, shape (n + 1,)
        What springs, cells and weight hold of it [J]; not exact where links change with the depth
        (`LinkLaw.geometry`), as their springs have no potential.
    frame_t : ndarray, shape (f,)
        Times of the frames [s].
    frames : ndarray, shape (f, nodes, 3)
        Positions then [m].
    newton, cycles : int
        Iterations of Newton's method, and of the linear solver in all.

    """

    lattice: Lattice
    t: FloatArray
    force: FloatArray
    tool: FloatArray
    height: FloatArray
    touching: IndexArray
    volume: FloatArray
    work: FloatArray
    stored: FloatArray
    frame_t: FloatArray
    frames: FloatArray
    newton: int
    cycles: int

    @property
    def dissipated(self) -> FloatArray:
        """Return what has become heat, shape (n + 1,) [J]; as exact as `stored` is."""
        return self.work - self.stored

    def surface(self, frame: int) -> tuple[FloatArray, IndexArray]:
        """Return the surface in a frame: points (s, 3) [m] and triangles (m, 3), outward."""
        nodes, triangles = self.lattice.surface
        return self.frames[frame][nodes], triangles

    def carried(self, points: FloatArray, frame: int) -> FloatArray:
        """
        Return where a frame has taken points that belong to the body at rest.

        Parameters
        ----------
        points : ndarray, shape (m, 3)
            Such as a measured cloud of the surface at rest [m].
        frame : int
            Which one.

        Returns
        -------
        ndarray, shape (m, 3)
            [m]

        """
        nodes, weights = self.lattice.weights(points)
        moved = self.frames[frame] - self.lattice.points
        return np.asarray(points + (weights[:, :, None] * moved[nodes]).sum(axis=1))


def simulate(
    lattice: Lattice,
    law: LinkLaw,
    tool: Tool,
    motion: ToolMotion,
    surroundings: Surroundings | None = None,
    *,
    at: Sequence[float] = (),
    accuracy: Accuracy | None = None,
) -> BodyRun:
    """
    Press a body and let it go.

    Parameters
    ----------
    lattice : Lattice
        The body at rest, at the start of the motion.
    law : LinkLaw
        Of its links.
    tool : Tool
        What presses.
    motion : ToolMotion
        Where it is.
    surroundings : Surroundings, optional
        Contact, volume stiffness and weight.
    at : sequence of float
        Times of the frames that are wanted [s].
    accuracy : Accuracy, optional
        How finely time is cut.

    Returns
    -------
    BodyRun
        Force, height, frames.

    Raises
    ------
    InputError
        If the tool does not meet the body, or the body does not bear what is asked of it.

    """
    surroundings = surroundings or Surroundings()
    accuracy = accuracy or Accuracy()
    body = Pressed(lattice, law, tool, surroundings)
    return _run(body, motion, tuple(sorted(at)), accuracy)


class Pressed:
    """
    A body with the state of its links, step by step.

    Attributes
    ----------
    top : float
        Height of the tool at which it first touches the body at rest [m].

    """

    def __init__(
        self, lattice: Lattice, law: LinkLaw, tool: Tool, surroundings: Surroundings
    ) -> None:
        self.lattice, self.law, self.tool, self.surroundings = lattice, law, tool, surroundings
        self.solver = Multigrid(lattice.shape)
        self.level = self.solver.levels[0]
        length = self.level.size + 2 * self.level.margin
        self.place = self.level.margin + lattice.grid
        self.weight = np.zeros((13, length))
        self.weight[:, self.level.span] = lattice.weights_of_links
        self.x0 = np.zeros((3, length))
        self.x0[:, self.place] = lattice.points.T
        self.x1 = self.x0.copy()
        self.net = np.zeros((3, length))
        self.rest = np.ones((13, length))
        inner = np.arange(*self.level.ends)
        for k, off in enumerate(self.level.offsets):
            there = inner[self.weight[k, inner] > 0.0]
            span = self.x0[:, there + off] - self.x0[:, there]
            self.rest[k, there] = np.sqrt((span**2).sum(axis=0))
        self.origin = self.x0.copy() if surroundings.small else np.zeros((3, 0))
        empty = np.zeros((13, 0))
        self.shares = empty
        self.z = np.zeros((13, length))
        self.z_max = np.zeros((13, length)) if law.damage > 0.0 else empty
        self.unit = np.zeros((13, length)) if math.isfinite(law.unit_stiffness) else empty
        self.ends = np.zeros((13, length)) if math.isfinite(law.series_stiffness) else empty
        self.cells = self.place[lattice.cells]
        self.slopes, self.volumes = _cell_shapes(lattice)
        # In the order of the matrix, which is larger than a cache.
        order = np.argsort(self.cells[:, 0])
        self.cells = self.cells[order]
        if len(self.volumes) == len(order):
            self.slopes, self.volumes = self.slopes[order], self.volumes[order]
        self.ratio = surroundings.volume_ratio * _MODULUS / lattice.pitch
        self.cell_z = np.zeros(len(self.cells))
        self.cell_ends = np.zeros(len(self.cells) if self.ends.size else 0)
        self.weight_of_node = np.zeros(len(lattice.points))
        if surroundings.density > 0.0:
            part = surroundings.density * surroundings.gravity / 8.0
            volumes = np.broadcast_to(self.volumes, len(order))
            np.add.at(self.weight_of_node, lattice.cells[order], part * volumes[:, None])
        self.contact = Contact(
            lattice.points, lattice.surface[0], lattice.pitch, tool, surroundings
        )
        self.loose = surroundings.support.lets_go or surroundings.support.friction < math.inf
        self.top = float(self._reached()[1].max())
        self.newton = 0
        self.cycles = 0
        self.largest = 0.0
        self.end_force = 0.0
        self.astray, self.sound_part = 0.0, 0.5
        self._begun = False
        self._q = np.zeros(forces.NUMBERS)
        self._lifted = 0.0

    @property
    def positions(self) -> FloatArray:
        """Return the positions at the start of the step, shape (n, 3) [m]."""
        return self.x0[:, self.place].T.copy()

    def first(self, accuracy: Accuracy) -> float:
        """Return the longest first step after a corner that shows how a series spring relaxes."""
        law = self.law
        # Without the dashpot nothing holds a series spring back.
        if not self.ends.size or law.bounce_viscosity == 0.0:
            return math.inf
        dashpots = 1.0 / (1.0 / law.bounce_viscosity + 1.0 / law.flow_viscosity)
        return _FRESH * math.sqrt(accuracy.force) * dashpots / law.series_stiffness

    def numbers(self, h: float, *, touching: bool) -> FloatArray:
        """Return the law of links and cells over a step."""
        law = self.law
        q = np.zeros(forces.NUMBERS)
        q[[forces.PASSED, forces.TAKEN]] = 1.0
        against = law.bounce_viscosity + (law.flow_viscosity if touching else 0.0)
        b = forces.fitted_weight(h * law.stiffness / against) if against > 0.0 else 1.0
        q[forces.K] = law.stiffness
        q[forces.C1] = law.bounce_viscosity
        q[forces.E] = law.stiffness * b + law.bounce_viscosity / h
        q[forces.FLOW] = h / law.flow_viscosity
        q[forces.YIELD] = law.yield_force
        dashpots = 1.0 / (1.0 / max(law.bounce_viscosity, 1e-300) + 1.0 / law.flow_viscosity)
        if self.unit.size:
            q[forces.UNIT_LEFT] = -math.expm1(-h * law.unit_stiffness / law.unit_viscosity)
            q[forces.UNIT_SOFT] = 1.0 / law.unit_stiffness
            q[forces.GIVE] += q[forces.UNIT_LEFT] * q[forces.UNIT_SOFT]
        if self.ends.size:
            q[forces.SERIES] = 1.0 / law.series_stiffness
            end = 1.0 / forces.fitted_weight(h * law.series_stiffness / dashpots)
            if self.contact.slides:
                # What friction leaves at the end of a step is not known: let it not ring.
                end = min(end, _DAMPED)
            elif not self._begun and self.surroundings.density > 0.0:
                # The weight is there at once.
                end = 1.0
            q[forces.SERIES_END] = end
            q[forces.GIVE] += q[forces.SERIES] * q[forces.SERIES_END]
        q[forces.STIFFENING] = law.stiffening
        q[forces.DAMAGE] = law.damage
        q[forces.REFERENCE] = law.reference_stretch
        q[forces.POWER] = 1.0 / law.flow_index
        q[forces.RATE] = law.reference_rate
        q[forces.STEP] = h
        q[forces.AGAINST] = against
        q[forces.PLAIN] = float(law.plain)
        # The dashpot beside the spring of a cell keeps its volume where the tool is fast and the
        # dashpots of the links carry more than their springs. Where they thin, they carry more
        # still as they slow down.
        slow = law.flow_viscosity * _SLOW ** (law.flow_index - 1.0)
        dashpots = 1.0 / (1.0 / max(law.bounce_viscosity, 1e-300) + 1.0 / slow)
        b = forces.fitted_weight(h * law.stiffness / dashpots)
        q[forces.CELL] = law.stiffness * b + dashpots / h
        return q

    def evaluate(self, q: FloatArray, *, fill: bool) -> FloatArray:
        """Set out the forces on the nodes, shape (n, 3) [N], and the matrix where wanted."""
        self.net[:] = 0.0
        matrix = self.solver.matrix
        if fill:
            matrix[:] = 0.0
        pitch = self.lattice.pitch
        forces.link_forces(
            self.x0,
            self.x1,
            self.origin,
            *self.level.ends,
            self.level.offsets,
            self.weight,
            self.rest,
            pitch,
            self.shares,
            q,
            self.z,
            self.z_max,
            self.unit,
            self.ends,
            self.net,
            matrix,
            fill,
        )
        if self.ratio > 0.0:
            forces.cell_forces(
                self.x0,
                self.x1,
                self.origin,
                self.cells,
                self.slopes,
                self.volumes,
                self.ratio,
                q,
                self.cell_z,
                self.cell_ends,
                _PAIRS,
                self.net,
                matrix,
                fill,
            )
        if self.loose:
            # Nothing holds a free body in its place but this.
            drag = _DRAG * q[forces.E] / (1.0 + q[forces.E] * q[forces.GIVE])
            self.net[:, self.place] -= drag * (self.x1 - self.x0)[:, self.place]
            if fill:
                for a in (0, 4, 8):
                    matrix[0, a, self.place] += np.float32(drag)
        net = self.net[:, self.place].T.copy()
        net[:, 2] -= self.weight_of_node
        return net

    def ends_out(self, passed: float) -> FloatArray:
        """Return what the end forces of the step before leave on the nodes, shape (n, 3) [N]."""
        q = np.zeros(forces.NUMBERS)
        q[[forces.PASSED, forces.TAKEN]] = passed, 1.0
        # Links that stretch by nothing, so soft that they keep what their series springs hold.
        q[[forces.E, forces.CELL, forces.SERIES_END, forces.POWER, forces.PLAIN]] = 1.0
        q[[forces.SERIES, forces.GIVE]] = 1e12
        q[forces.YIELD] = math.inf
        self.x1[:] = self.x0
        return self.evaluate(q, fill=False)

    def correct(
        self, net: FloatArray, holds: Holds, tolerance: float, *, fresh: bool
    ) -> tuple[float, bool]:
        """Move the nodes by one iteration; return the largest change and whether it is sound."""
        place = self.place[holds.nodes]
        change = np.zeros_like(self.level.b)
        right = np.zeros_like(self.level.b)
        right[:, self.place] = net.T
        change[:, place] = holds.correction.T
        if fresh:
            for a in (0, 4, 8):
                self.solver.matrix[0, a, place] += holds.rub.astype(np.float32)
            product = np.zeros_like(right)
            self.level.multiply(change, product)
            right -= product
            free = holds.free.astype(np.float32)
            project(self.solver.matrix, place, free, self.level.margin, self.level.offsets)
            self.solver.prepare()
        right[:, place] = np.einsum('mij,jm->im', holds.free, right[:, place])
        found, sound, cycles = self.solver.solve(right, tolerance)
        self.cycles += cycles
        self.newton += 1
        found[:, place] = np.einsum('mij,jm->im', holds.free, found[:, place])
        found += change
        moved = found[:, self.place]
        self.x1[:, self.place] += moved
        return float(np.abs(moved).max()), sound

    def step(
        self, h: float, before: float, height: float, speed: FloatArray | None, accuracy: Accuracy
    ) -> tuple[float, int] | None:
        """
        Find the positions at the end of a step.

        Returns
        -------
        force : float
            On the tool [N].
        touching : int
            Nodes that it touches; None instead of both where the iteration fails.

        """
        contact = self.contact
        start = self.x0[:, self.place].T
        was = contact.by_tool.copy()
        contact.start(start, before, down=height < before)
        touching = bool(contact.by_tool.any())
        q = self.numbers(h, touching=touching or height < before)
        if self.law.geometry is not None:
            deep = self.top - 0.5 * (before + height)
            q[[forces.PASSED, forces.TAKEN]] = self.law.geometry.at(deep)
            shares = self.law.geometry.shares
            # A tool that goes up and down in the air by its noise changes nothing.
            if not touching:
                free = self.law.geometry.free
                q[[forces.PASSED, forces.TAKEN]] = 1.0 / free, free
            if shares is not None:
                self.shares = shares.at(deep) if touching else shares.free
        self._q = q
        # Mean forces that balance would turn what the ends leave out of balance, as on a node that
        # is let go, over in each step: it would ring. So the means leave what makes the ends
        # balance, which is what the tool still bore when it was leaving.
        out_before = np.zeros_like(start)
        carried = np.zeros_like(start)
        end = 1.0
        if self.ends.size and not contact.slides:
            out_before = self.ends_out(q[forces.PASSED])
            end = float(q[forces.SERIES_END])
            carried = (end - 1.0) / end * out_before
        self.x1[:] = self.x0
        if speed is not None:
            self.x1[:, self.place] += h * speed.T
        stale, last, moved = True, math.inf, math.inf
        settled = min(_SETTLED * accuracy.position, _CLOSE * self.lattice.pitch)
        slow = contact.slides or self.law.flow_index < forces.LEAST_INDEX
        for iteration in range(_ITERATIONS * (3 if slow else 1)):
            net = self.evaluate(q, fill=stale)
            position = self.x1[:, self.place].T
            holds = contact.holds(start, position, before, height)
            out, scale = self._balance(net, carried, holds)
            if not math.isfinite(out):
                return None
            enough = accuracy.balance * scale
            # What holds a node is only told by forces that nearly balance.
            if iteration > 0 and out <= _NEARLY * enough:
                slack = 0.1 * enough / max(1, int(contact.by_tool.sum()))
                if contact.change(holds, net, start, position, height, slack):
                    if not stale:
                        net = self.evaluate(q, fill=True)
                        stale = True
                    holds = contact.holds(start, position, before, height)
                    out, _ = self._balance(net, carried, holds)
                    last = moved = math.inf
            off = float(np.abs(holds.correction).max(initial=0.0))
            if out <= enough and max(off, moved) <= settled and contact.unsettled <= _TURNED:
                on = holds.nodes[contact.by_tool[holds.nodes]]
                left = was & ~contact.by_tool
                force = float(net[on, 2].sum()) + max(float(carried[left, 2].sum()), 0.0)
                first = float(out_before[was, 2].sum())
                self.end_force = first + end * (force - first)
                self._leaving(net, out_before, holds, left, end)
                self.largest = max(self.largest, abs(force))
                return force, on.size
            if not stale and (out > _POOR * last or contact.slides):
                stale = True
                net = self.evaluate(q, fill=True)
            last = out
            tolerance = min(max(0.3 * enough / max(out, 1e-300), 1e-4), 0.03)
            pushed = net - carried
            pushed[holds.nodes] += holds.friction
            moved, sound = self.correct(pushed, holds, tolerance, fresh=stale)
            if not sound:
                return None
            stale = False
        return None

    def _leaving(
        self, net: FloatArray, before: FloatArray, holds: Holds, left: BoolArray, end: float
    ) -> None:
        """
        Tell by how much the tool pulls at the end of the step, or lost a press within it.

        When in the step a node leaves is not resolved. Beside the force stands the part of the
        step after which what pulls at its end would have been let go.

        """
        self.astray, self.sound_part = 0.0, 0.5
        if not self.ends.size or self.contact.slides:
            return
        on = self.contact.by_tool[holds.nodes]
        nodes, normals = holds.nodes[on], holds.normals[on]
        press = np.einsum('ij,ij->i', before[nodes], normals)
        last = press + end * (np.einsum('ij,ij->i', net[nodes], normals) - press)
        pulls = (last < 0.0) & (press > 0.0)
        pull = -float(last[pulls].sum())
        lost = max(float(before[left, 2].sum()), 0.0)
        self.astray = 0.5 * max(pull, lost)
        if pull > lost:
            bore = float(press[pulls].sum())
            self.sound_part = bore / (bore + pull)

    def _balance(self, net: FloatArray, carried: FloatArray, holds: Holds) -> tuple[float, float]:
        """Return what is out of balance, and the force that it is small against [N]."""
        scale = max(self.largest, float(np.abs(net[holds.nodes]).sum()))
        left = net - carried
        held = left[holds.nodes] + holds.friction
        left[holds.nodes] = np.einsum('mij,mj->mi', holds.free, held)
        return float(np.sqrt((left**2).sum())), scale

    def advance(self) -> float:
        """Take the links to the end of the step just found; return what is stored [J]."""
        held = forces.advance_links(
            self.x0,
            self.x1,
            self.origin,
            *self.level.ends,
            self.level.offsets,
            self.weight,
            self.rest,
            self.lattice.pitch,
            self.shares,
            self._q,
            self.z,
            self.z_max,
            self.unit,
            self.ends,
        )
        if self.ratio > 0.0:
            held += forces.advance_cells(
                self.x0,
                self.x1,
                self.origin,
                self.cells,
                self.slopes,
                self.volumes,
                self.ratio,
                self._q,
                self.cell_z,
                self.cell_ends,
            )
        rise = (self.x1 - self.x0)[2, self.place]
        self._lifted += float(self.weight_of_node @ rise)
        self.x0[:] = self.x1
        self._begun = True
        return float(held) + self._lifted

    def static(self, depth: float) -> Gauge:
        """Return what the elastic body at rest passes on when its face sinks: one solve."""
        nodes = self.face(depth)
        q = np.zeros(forces.NUMBERS)
        plain = [forces.K, forces.E, forces.CELL, forces.PLAIN, forces.POWER]
        q[[*plain, forces.PASSED, forces.TAKEN]] = 1.0
        q[forces.YIELD] = math.inf
        self.evaluate(q, fill=True)
        lowest = np.flatnonzero(self.contact.by_support)
        held = np.concatenate([nodes, lowest])
        free = np.zeros((held.size, 3, 3))
        touch = self.surroundings.tool, self.surroundings.support
        for part, which in ((slice(0, nodes.size), 0), (slice(nodes.size, None), 1)):
            if touch[which].friction == 0.0:
                free[part] = np.diag([1.0, 1.0, 0.0])
        correction = np.zeros((held.size, 3))
        correction[: nodes.size, 2] = -1.0
        normals = np.zeros((held.size, 3))
        holds = Holds(held, normals, free, correction, normals[:, 0], normals)
        matrix = self.solver.matrix.copy()
        self.correct(np.zeros_like(self.lattice.points), holds, 1e-5, fresh=True)
        moved = (self.x1 - self.x0).astype(np.float32)
        self.solver.matrix[:] = matrix
        product = np.zeros_like(moved)
        self.level.multiply(moved, product)
        self.x1[:] = self.x0
        force = -float(product[2, self.place[nodes]].sum(dtype=np.float64))
        inner = np.arange(*self.level.ends)
        shares = self._stretches(self.x0, moved.astype(np.float64))
        energy = fourth = first = 0.0
        for k in range(len(self.level.offsets)):
            there = inner[self.weight[k, inner] > 0.0]
            weight = self.weight[k, there] * (self.rest[k, there] / self.lattice.pitch) ** 2
            edge = np.abs(shares[k, there])
            first += float((weight * edge).sum())
            energy += float((weight * edge**2).sum())
            fourth += float((weight * edge**4).sum())
        share = math.sqrt(fourth / energy)
        return Gauge(force, share, first, self._not_zero(shares))

    def stretches(self, start: FloatArray, end: FloatArray, depth: float) -> FloatArray:
        """
        Return how fast links are stretched between two positions of the nodes.

        Parameters
        ----------
        start, end : ndarray, shape (n, 3)
            [m]
        depth : float
            By how much the tool went down in between [m].

        Returns
        -------
        ndarray, shape (13, p)
            Per depth, brought to the length of an edge, not zero [-].

        """
        at, moved = np.zeros_like(self.x0), np.zeros_like(self.x0)
        at[:, self.place] = 0.5 * (start + end).T
        moved[:, self.place] = (end - start).T
        longer = self._stretches(self.x0 if self.surroundings.small else at, moved)
        return self._not_zero(longer / depth)

    def _not_zero(self, shares: FloatArray) -> FloatArray:
        usual = float(np.sqrt(np.mean(shares[self.weight > 0.0] ** 2)))
        return not_less(shares, _LEAST_SHARE * usual)

    def _stretches(self, at: FloatArray, moved: FloatArray) -> FloatArray:
        """Return by how much links get longer, brought to an edge, shape (13, p) [m]."""
        found = np.ones_like(self.rest)
        inner = np.arange(*self.level.ends)
        for k, off in enumerate(self.level.offsets):
            there = inner[self.weight[k, inner] > 0.0]
            along = at[:, there + off] - at[:, there]
            along /= np.sqrt((along**2).sum(axis=0))
            longer = np.einsum('ij,ij->j', along, moved[:, there + off] - moved[:, there])
            found[k, there] = longer / (self.rest[k, there] / self.lattice.pitch)
        return found

    def face(self, depth: float) -> IndexArray:
        """Return the nodes under the tool's face; under a sphere, those that a push reaches."""
        points, tool = self.lattice.points, self.tool
        radius = math.sqrt(tool.radius * depth) if tool.sphere else tool.radius
        radius = max(radius, 0.75 * self.lattice.pitch)
        top = self.lattice.surface[0]
        aside = np.hypot(points[top, 0] - tool.x, points[top, 1] - tool.y)
        top, aside = top[aside <= radius * _ON], aside[aside <= radius * _ON]
        if not top.size:
            raise InputError('the tool does not meet the body: its axis is beside it')
        if aside.min() > tool.radius * _ON:
            raise InputError(
                f'the tool falls between the nodes: choose cells smaller than {tool.radius:g} m'
            )
        # Only the uppermost of a column: a step in the surface has two.
        columns = self.lattice.places[top]
        order = np.lexsort((-columns[:, 2], columns[:, 1], columns[:, 0]))
        _, first = np.unique(columns[order][:, :2], axis=0, return_index=True)
        return np.sort(top[order][first])

    @property
    def is_level(self) -> bool:
        """Return whether a flat tool touches all that is under it at once."""
        return not self.tool.sphere and self.first_touched().size == self.face(0.0).size

    def first_touched(self) -> IndexArray:
        """Return the nodes that the tool touches at once."""
        nodes, height = self._reached()
        return np.asarray(nodes[height >= height.max() - _AT_ONCE * self.lattice.pitch])

    def _reached(self) -> tuple[IndexArray, FloatArray]:
        """Return nodes before the tool, and its height where it touches each at rest [m]."""
        points, tool = self.lattice.points, self.tool
        nodes = self.face(0.0)
        if not tool.sphere:
            return nodes, points[nodes, 2]
        upper = self.lattice.surface[0]
        aside = np.hypot(points[upper, 0] - tool.x, points[upper, 1] - tool.y)
        near = aside < tool.radius
        rise = tool.radius - np.sqrt(tool.radius**2 - aside[near] ** 2)
        return upper[near], points[upper[near], 2] - rise


def _cell_shapes(lattice: Lattice) -> tuple[FloatArray, FloatArray]:
    """Return the slopes of the shape functions in the middle of the cells, and their volumes."""
    signs = np.where(CORNERS == 1, 0.125, -0.125)
    if lattice.lift is None:
        slopes = (2.0 / lattice.pitch) * signs.T[None]
        return slopes, np.array([lattice.pitch**3])
    jacobian = np.einsum('cpa,pb->cab', lattice.points[lattice.cells], signs)
    inverse = np.linalg.inv(jacobian)
    slopes = np.einsum('pb,cba->cap', signs, inverse)
    return np.ascontiguousarray(slopes), 8.0 * np.linalg.det(jacobian)


def _corner_pairs() -> IndexArray:
    """Return the 28 pairs of a cell's corners, with the direction from one to the other."""
    pairs = [
        (p, r, k)
        for k, direction in enumerate(DIRECTIONS)
        for p in range(8)
        for r in range(8)
        if (CORNERS[r] - CORNERS[p] == direction).all()
    ]
    return np.array(pairs, dtype=np.intp)


_PAIRS: Final = _corner_pairs()


class _Record:
    """What is kept of the steps."""

    def __init__(self, body: Pressed, t: float, height: float, at: Sequence[float]) -> None:
        self._body = body
        self._face = body.first_touched()
        self._rest = body.lattice.points
        self.t, self.tool = [t], [height]
        self.force: list[float] = []
        self.touching: list[int] = []
        self.height, self.work, self.stored = [0.0], [0.0], [0.0]
        self.volume = [body.lattice.volume(self._rest)]
        self._wanted = list(at)
        self.frame_t: list[float] = []
        self.frames: list[FloatArray] = []
        self._position = self._rest
        self._take(t, self._rest)

    def _take(self, t: float, position: FloatArray) -> None:
        """Keep the frames up to a time, to which the body moves at constant speed."""
        start = self.t[-1]
        while self._wanted and self._wanted[0] <= t:
            when = self._wanted.pop(0)
            share = (when - start) / (t - start) if t > start else 0.0
            share = min(max(share, 0.0), 1.0)
            self.frame_t.append(when)
            self.frames.append(self._position + share * (position - self._position))

    def add(self, t: float, tool: float, force: float, touching: int, stored: float) -> None:
        """Keep a step."""
        position = self._body.positions
        self._take(t, position)
        self.work.append(self.work[-1] + force * (self.tool[-1] - tool))
        self._position = position
        self.t.append(t)
        self.tool.append(tool)
        self.force.append(force)
        self.touching.append(touching)
        self.stored.append(stored)
        sunk = (self._rest - position)[self._face, 2]
        self.height.append(float(sunk.mean()))
        self.volume.append(self._body.lattice.volume(position))

    def run(self) -> BodyRun:
        """Return all that was kept."""
        shape = (-1, *self._rest.shape)
        return BodyRun(
            lattice=self._body.lattice,
            t=np.array(self.t),
            force=np.array(self.force),
            tool=np.array(self.tool),
            height=np.array(self.height),
            touching=np.array(self.touching, dtype=np.intp),
            volume=np.array(self.volume),
            work=np.array(self.work),
            stored=np.array(self.stored),
            frame_t=np.array(self.frame_t),
            frames=np.array(self.frames).reshape(shape),
            newton=self._body.newton,
            cycles=self._body.cycles,
        )


def _stops(body: Pressed, motion: ToolMotion) -> list[float]:
    """Return when steps have to end: the corners of the motion, the first touch and the end."""
    stops = [*motion.corners, float(motion.t[-1])]
    above = motion.height - body.top
    crossing = np.flatnonzero((above[:-1] > 0.0) & (above[1:] <= 0.0))
    if crossing.size:
        i = int(crossing[0])
        share = above[i] / (above[i] - above[i + 1])
        stops.append(float(motion.t[i] + share * (motion.t[i + 1] - motion.t[i])))
    return sorted(s for s in set(stops) if s > motion.t[0])


def _run(body: Pressed, motion: ToolMotion, at: tuple[float, ...], accuracy: Accuracy) -> BodyRun:
    t = float(motion.t[0])
    tool = float(motion.height[0])
    record = _Record(body, t, tool, at)
    shortest = _SHORTEST * accuracy.first_step
    for stop in _stops(body, motion):
        h = min(accuracy.first_step, body.first(accuracy))
        speed: FloatArray | None = None
        rate, end_force = 0.0, body.end_force
        while t < stop:
            left = stop - t
            h = min(h, accuracy.longest_step)
            if h > left * (1.0 - 1e-9) or left < 2.0 * shortest:
                h = left
            elif h > 0.5 * left:
                h = 0.5 * left
            after = stop if h == left else t + h
            goal = float(motion.at(np.array([after]))[0])
            kept = body.contact.state
            found = body.step(h, tool, goal, speed, accuracy)
            if found is None:
                body.contact.state = kept
                if speed is not None:
                    speed = None
                    continue
                h *= 0.5
                if h < shortest:
                    lighter = ', or a lighter body' if body.surroundings.density > 0.0 else ''
                    raise InputError(
                        f'the body does not bear the tool {1e3 * goal:g} mm over the support at '
                        f'{t:.4g} s: push less deep, or choose larger cells or a stiffer volume'
                        f'{lighter}'
                    )
                continue
            moved = (body.x1 - body.x0)[:, body.place].T
            factor = accuracy.growth
            most = accuracy.force * body.largest
            if body.astray > _EVENT * most and h > shortest:
                body.contact.state = kept
                h = max(h * min(max(body.sound_part, 0.1), 0.9), shortest)
                continue
            if speed is not None:
                error = _SHARE * float(np.abs(moved - h * speed).max())
                off = error / accuracy.position
                if body.ends.size:
                    error = _SHARE * abs(body.end_force - end_force - h * rate)
                    off = max(off, error / max(most, 1e-300))
                factor = min(factor, _SAFE / math.sqrt(max(off, 1e-300)))
                if off > 1.0 and h > shortest:
                    body.contact.state = kept
                    h = max(h * max(factor, 0.2), shortest)
                    continue
            stored = body.advance()
            record.add(after, goal, found[0], found[1], stored)
            speed = moved / h
            rate, end_force = (body.end_force - end_force) / h, body.end_force
            t, tool = after, goal
            h *= max(factor, 0.5)
    return record.run()
