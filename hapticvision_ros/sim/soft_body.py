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
A deforming body for the simulated cell: mass points, explicit in time, with more mass than real.

It shares nothing with the body that is fitted (`core.body`): another lattice code, Newton's law
with mass instead of a balance of forces. Its masses are
made so large that the step is stable; inertia then shows for about the time that a step times the
stiffening from a link to the body takes, and is small beside the push.
"""

from dataclasses import dataclass
import math
from typing import Final

from hapticvision_ros.core.kernels import kernel
import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.float64]
type Integers = NDArray[np.int64]

_SHARES: Final = {1: 1.0 / 4.0, 2: 1.0 / 4.0, 3: 3.0 / 16.0}
"""What a cell gives an edge, a diagonal of a face, a diagonal of the body."""
_MARGIN: Final = 1.5
_CALM: Final = 2.2
"""
Of the masses over those that the step just bears, and so that nothing swings from step to step,
which would let links flow that are kept from it by a threshold.
"""
_FREE: Final = 3
_UPRIGHT: Final = 2
_GLUED: Final = 0
"""Along how many of its axes a node may move."""
_SETTLED: Final = 1e-4
"""Relative change of a force in a round that makes none."""
_ROUND, _ROUNDS = 200, 60
"""Steps of a round in which a body comes to rest, and how many at most."""


@dataclass(frozen=True, slots=True)
class SoftMaterial:
    """
    A link along an edge.

    Parameters
    ----------
    spring : float
        Of the part that bounces back [N/m].
    retardation : float
        Its dashpot [N.s/m].
    flow : float
        Dashpot of the part that stays [N.s/m].
    threshold : float
        Force below which that does not flow [N].
    bulk : float
        Pressure over the relative change of a cell's volume [Pa].
    bulk_viscosity : float
        Pressure over the rate of that change [Pa.s].

    """

    spring: float
    retardation: float
    flow: float
    threshold: float = 0.0
    bulk: float = 0.0
    bulk_viscosity: float = 0.0


class SoftBody:
    """
    A block on the support, under a round tool that slides on nothing.

    Parameters
    ----------
    size : tuple of float, length 3
        [m]
    pitch : float
        [m]
    material : SoftMaterial
        Its links.
    radius : float
        Of the tool [m]; its axis is over the middle.
    step : float
        Time step [s]; the masses follow from it.
    friction : float
        Coulomb's coefficient under the block [-]; infinite for one that is glued to the support,
        which never lets go of it.
    sphere : bool
        Whether the tool ends in a sphere; else it is flat.

    """

    def __init__(
        self,
        size: tuple[float, float, float],
        pitch: float,
        material: SoftMaterial,
        radius: float,
        step: float,
        *,
        friction: float = math.inf,
        sphere: bool = False,
    ) -> None:
        self._pitch, self._step = pitch, step
        nx, ny, nz = (round(side / pitch) + 1 for side in size)
        grid = np.stack(np.meshgrid(range(nx), range(ny), range(nz), indexing='ij'), axis=-1)
        self.rest: Floats = pitch * grid.reshape(-1, 3).astype(np.float64)
        self.rest[:, :2] -= 0.5 * pitch * np.array([nx - 1, ny - 1])
        self.points = self.rest.copy()
        self._velocity = np.zeros_like(self.rest)
        name = np.arange(nx * ny * nz).reshape(nx, ny, nz)
        corners = [
            name[i:, j:, k:][: nx - 1, : ny - 1, : nz - 1].ravel()
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
        ]
        self._cells: Integers = np.stack(corners, axis=1)
        self._links, self._share = _links(self._cells)
        span = self.rest[self._links[:, 1]] - self.rest[self._links[:, 0]]
        self._length = np.linalg.norm(span, axis=1)
        self._scale = self._share * self._length / pitch
        self._per = pitch / self._length
        self._flowed = np.zeros(len(self._links))
        below = self.rest[:, 2] == 0.0
        self._held: Integers = np.where(below, _GLUED if math.isinf(friction) else _UPRIGHT, _FREE)
        self._round = radius if sphere else 0.0
        top = self.rest[:, 2].max()
        inside = np.hypot(self.rest[:, 0], self.rest[:, 1]) <= radius * (1.0 + 1e-9)
        self.face: Integers = np.flatnonzero(inside & (self.rest[:, 2] == top))
        if not self.face.size:
            raise ValueError('the tool is smaller than a cell: choose smaller cells')
        self._sticks = np.zeros(self.face.size, dtype=bool)
        dashpot = 1.0 / (1.0 / material.retardation + 1.0 / material.flow)
        # The stiffest motion of the nodes, each against all its neighbours: the links are 9 and
        # the cells 12 times as stiff as one. Masses that the step bears follow from its damping
        # and from its frequency.
        viscous = 9.0 * dashpot + 12.0 * material.bulk_viscosity * pitch
        elastic = 9.0 * material.spring + 12.0 * material.bulk * pitch
        margin = _CALM if material.threshold > 0.0 else _MARGIN
        mass = margin * (0.5 * viscous * step + 0.25 * elastic * step**2)
        self._numbers = np.array(
            [
                material.spring,
                material.retardation,
                material.flow,
                material.threshold,
                material.bulk,
                material.bulk_viscosity,
                mass,
                pitch,
                0.0 if math.isinf(friction) else friction,
            ]
        )
        self.force = 0.0

    def advance(self, seconds: float, start: float, end: float) -> float:
        """
        Let the tool go from one height to another.

        Parameters
        ----------
        seconds : float
            How long it takes; a multiple of the step, else the step is made to fit [s].
        start, end : float
            Heights of its face [m].

        Returns
        -------
        float
            Mean force of the body on the tool [N], without the inertia of the nodes that touch it.

        """
        steps = max(1, math.ceil(seconds / self._step - 1e-9))
        self.force = float(
            _advance(
                self.points,
                self._velocity,
                self._links,
                self._scale,
                self._length,
                self._per,
                self._flowed,
                self._cells,
                self._held,
                self.face,
                self._round,
                self._sticks,
                self._numbers,
                steps,
                seconds / steps,
                start,
                end,
            )
        )
        return self.force

    def pressed_by(self, depth: float) -> tuple[float, float]:
        """
        Press the body and wait until it rests.

        Parameters
        ----------
        depth : float
            Of the tool below the top [m].

        Returns
        -------
        float
            Force on the tool [N].
        float
            Sum of the stretches of the springs, each as that of an edge, by weight and length [m].

        """
        height = float(self.rest[:, 2].max())
        start, before = height, 0.0
        for _ in range(_ROUNDS):
            self.advance(_ROUND * self._step, start, height - depth)
            start = height - depth
            if abs(self.force - before) <= _SETTLED * abs(self.force):
                break
            before = self.force
        span = self.points[self._links[:, 1]] - self.points[self._links[:, 0]]
        long = self._length / self._pitch
        stretch = (np.linalg.norm(span, axis=1) - self._length) / long
        return self.force, float(np.sum(self._share * long**2 * np.abs(stretch)))

    @property
    def triangles(self) -> Integers:
        """Return the surface, shape (m, 3): nodes of each triangle."""
        place = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
        sides = []
        for axis in range(3):
            for end in (0, 1):
                a, b, c, d = self._cells[:, place[:, axis] == end].T
                sides.append(np.stack([a, b, d, c], axis=1))
        faces = np.concatenate(sides)
        # A face between two cells comes twice.
        _, first, count = np.unique(
            np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
        )
        a, b, c, d = faces[first[count == 1]].T
        return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])

    @property
    def sunk(self) -> float:
        """Return how far the face under the tool has gone down, the mean of its nodes [m]."""
        return float((self.rest - self.points)[self.face, 2].mean())


def _links(cells: Integers) -> tuple[Integers, Floats]:
    """Return the pairs of nodes that are joined, and the weights of the links."""
    place = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    pairs, shares = [], []
    for p in range(8):
        for r in range(p + 1, 8):
            apart = int(np.abs(place[p] - place[r]).sum())
            pairs.append(np.sort(cells[:, [p, r]], axis=1))
            shares.append(np.full(len(cells), _SHARES[apart]))
    unique, which = np.unique(np.concatenate(pairs), axis=0, return_inverse=True)
    return unique.astype(np.int64), np.bincount(which.ravel(), np.concatenate(shares))


@kernel(error_model='numpy', fastmath=True)
def _advance(  # type: ignore[no-untyped-def]
    x,
    v,
    links,
    scale,
    length,
    per,
    flowed,
    cells,
    held,
    face,
    sphere,
    sticks,
    numbers,
    steps,
    dt,
    start,
    end,
):
    spring, retardation, flow, threshold, bulk, thick, mass, pitch, friction = numbers
    yielding = 1.0 / (retardation + flow)
    n = x.shape[0]
    force = np.zeros((n, 3))
    gradient = np.zeros((3, 3))
    slopes = np.zeros((8, 3))
    total = 0.0
    for step in range(steps):
        force[:] = 0.0
        for m in range(links.shape[0]):
            i, j = links[m, 0], links[m, 1]
            dx = x[j, 0] - x[i, 0]
            dy = x[j, 1] - x[i, 1]
            dz = x[j, 2] - x[i, 2]
            now = math.sqrt(dx * dx + dy * dy + dz * dz)
            rate = dx * (v[j, 0] - v[i, 0]) + dy * (v[j, 1] - v[i, 1]) + dz * (v[j, 2] - v[i, 2])
            over = 1.0 / now
            # As strain, so that a diagonal flows at the strain of an edge.
            pull = spring * ((now - length[m]) * per[m] - flowed[m])
            pull += retardation * rate * over * per[m]
            if abs(pull) > threshold:
                side = 1.0 if pull > 0.0 else -1.0
                creep = (pull - side * threshold) * yielding
                flowed[m] += creep * dt
                pull -= retardation * creep
            pull *= scale[m] * over
            force[i, 0] += pull * dx
            force[i, 1] += pull * dy
            force[i, 2] += pull * dz
            force[j, 0] -= pull * dx
            force[j, 1] -= pull * dy
            force[j, 2] -= pull * dz
        if bulk > 0.0 or thick > 0.0:
            quarter = 0.25 / pitch
            for c in range(cells.shape[0]):
                for a in range(3):
                    for b in range(3):
                        gradient[a, b] = 0.0
                for p in range(8):
                    node = cells[c, p]
                    for b in range(3):
                        sign = quarter if p >> (2 - b) & 1 else -quarter
                        for a in range(3):
                            gradient[a, b] += sign * x[node, a]
                f = gradient
                c00 = f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1]
                c01 = f[1, 2] * f[2, 0] - f[1, 0] * f[2, 2]
                c02 = f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0]
                volume = f[0, 0] * c00 + f[0, 1] * c01 + f[0, 2] * c02
                rate = 0.0
                for p in range(8):
                    node = cells[c, p]
                    sx = quarter if p & 4 else -quarter
                    sy = quarter if p & 2 else -quarter
                    sz = quarter if p & 1 else -quarter
                    for a in range(3):
                        b = (a + 1) % 3
                        d = (a + 2) % 3
                        slopes[p, a] = (
                            sx * (f[b, 1] * f[d, 2] - f[b, 2] * f[d, 1])
                            + sy * (f[b, 2] * f[d, 0] - f[b, 0] * f[d, 2])
                            + sz * (f[b, 0] * f[d, 1] - f[b, 1] * f[d, 0])
                        )
                        rate += slopes[p, a] * v[node, a]
                press = (bulk * (volume - 1.0) + thick * rate) * pitch**3
                for p in range(8):
                    for a in range(3):
                        force[cells[c, p], a] -= press * slopes[p, a]
        height = start + (end - start) * (step + 1) / steps
        for i in range(n):
            if held[i] == 0:
                continue
            for a in range(held[i]):
                v[i, a] += force[i, a] * dt / mass
            if held[i] == _UPRIGHT and friction > 0.0:
                # What presses it down takes at most all of its speed along the support.
                lost = friction * max(-force[i, 2], 0.0) * dt / mass
                speed = math.hypot(v[i, 0], v[i, 1])
                left = 1.0 - lost / speed if speed > lost else 0.0
                v[i, 0] *= left
                v[i, 1] *= left
            for a in range(held[i]):
                x[i, a] += v[i, a] * dt
        for k in range(face.size):
            i = face[k]
            here = height
            if sphere > 0.0:
                away = x[i, 0] * x[i, 0] + x[i, 1] * x[i, 1]
                here += sphere - math.sqrt(max(sphere * sphere - away, 0.0))
            if x[i, 2] <= here:
                sticks[k] = False
                continue
            # The tool takes what would be above it along, and feels what springs and dashpots do.
            before = x[i, 2] - v[i, 2] * dt
            needed = (here - before) / dt
            # Not what the added mass of the nodes at its face asks for: that would be a blow.
            total += force[i, 2]
            v[i, 2] = needed
            x[i, 2] = here
            if sticks[k]:
                for a in range(2):
                    x[i, a] -= v[i, a] * dt
                    v[i, a] = 0.0
            sticks[k] = True
    return total / steps
