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
Where tool and support hold the nodes: a set of constraints that an iteration corrects.

A node that touches may not move along the normal, and not at all where the surface holds it. It is
let go where the surface would have to pull, and taken where it has gone through. Coulomb's
friction acts against the way along the surface in the step, in full beyond a ten-thousandth of the
pitch; an iteration takes it as a dashpot that gives as much for the way and the pressure of the
iteration before.
"""

from dataclasses import dataclass
import math

from hapticvision_ros.core.body.lattice import BoolArray, IndexArray
from hapticvision_ros.core.body.push import Surroundings, Tool
from hapticvision_ros.core.records import FloatArray
import numpy as np

_MOST_CHANGES = 3
"""How often a node may change between two states in a step."""
_STUCK = 1e-4
"""Way along the surface at which friction is in full, over the pitch."""
_NEAR = 1e-6
"""Distance at which a node touches, over the pitch."""


@dataclass(frozen=True, slots=True, eq=False)
class Holds:
    """
    What holds which nodes, in an iteration.

    Parameters
    ----------
    nodes : ndarray of int, shape (m,)
        Those that are held.
    normals : ndarray, shape (m, 3)
        Out of the body.
    free : ndarray, shape (m, 3, 3)
        The projection onto where each may move.
    correction : ndarray, shape (m, 3)
        How far each is from where it has to be [m].
    rub : ndarray, shape (m,)
        Friction over the way along the surface [N/m].
    friction : ndarray, shape (m, 3)
        On the body [N].

    """

    nodes: IndexArray
    normals: FloatArray
    free: FloatArray
    correction: FloatArray
    rub: FloatArray
    friction: FloatArray


class Contact:
    """
    The nodes that tool and support touch.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Nodes at rest [m].
    surface : ndarray of int, shape (s,)
        Those on the surface.
    pitch : float
        [m]
    tool : Tool
        Its shape.
    surroundings : Surroundings
        How it and the support touch.

    Attributes
    ----------
    by_tool, by_support : ndarray of bool, shape (n,)
        What touches.
    unsettled : float
        By how much the last correction changed the pressure that friction goes by, relative.

    """

    def __init__(
        self,
        points: FloatArray,
        surface: IndexArray,
        pitch: float,
        tool: Tool,
        surroundings: Surroundings,
    ) -> None:
        self._tool = tool
        self._touches = surroundings.tool, surroundings.support
        self._pitch = pitch
        near = points[surface, 2] <= _NEAR * pitch
        self._lowest = surface[near]
        self._upper = surface[~near]
        self._surface = surface
        self._foot = np.zeros(len(points), dtype=bool)
        self._foot[self._lowest] = True
        count = len(points)
        self.by_tool: BoolArray = np.zeros(count, dtype=bool)
        self.by_support: BoolArray = np.zeros(count, dtype=bool)
        self.by_support[self._lowest] = True
        self._held: BoolArray = self.by_support & math.isinf(surroundings.support.friction)
        self._changes = np.zeros(count, dtype=np.intp)
        self._press = np.zeros(count)
        self._side = self._upper
        self._untouched = True
        self.unsettled = 0.0

    def start(self, x: FloatArray, height: float, *, down: bool) -> None:
        """Begin a step; a tool that comes down takes what it touches already."""
        self._changes[:] = 0
        self.unsettled = 0.0
        axis = np.hypot(x[self._upper, 0] - self._tool.x, x[self._upper, 1] - self._tool.y)
        side = self._upper[axis <= self._tool.radius * (1.0 + _NEAR)]
        gap, _ = self._gap(x[side], height)
        # What comes in under the edge from beside, above the face, is at the wall of the tool; but
        # a motion may begin a little within the body.
        below = (gap >= -_NEAR * self._pitch) | self._untouched
        self._side = side[below]
        if down:
            self.by_tool[self._side[gap[below] <= _NEAR * self._pitch]] = True
        self._untouched = False
        if math.isinf(self._touches[0].friction):
            self._held |= self.by_tool
        if math.isinf(self._touches[1].friction):
            self._held |= self.by_support
        self._held &= self.by_tool | self.by_support

    @property
    def slides(self) -> bool:
        """Return whether there is friction that can be overcome."""
        return any(0.0 < touch.friction < math.inf for touch in self._touches)

    @property
    def state(self) -> tuple[BoolArray, BoolArray, BoolArray, FloatArray]:
        """Return a copy of the sets, to go back to."""
        return self.by_tool.copy(), self.by_support.copy(), self._held.copy(), self._press.copy()

    @state.setter
    def state(self, value: tuple[BoolArray, BoolArray, BoolArray, FloatArray]) -> None:
        self.by_tool, self.by_support = value[0].copy(), value[1].copy()
        self._held, self._press = value[2].copy(), value[3].copy()

    def _gap(self, x: FloatArray, height: float) -> tuple[FloatArray, FloatArray]:
        """Return the distances from the tool's surface, and its normals out of the body."""
        if not self._tool.sphere:
            return height - x[:, 2], np.tile([0.0, 0.0, 1.0], (len(x), 1))
        away = np.array([self._tool.x, self._tool.y, height + self._tool.radius]) - x
        distance = np.linalg.norm(away, axis=1)
        return distance - self._tool.radius, away / distance[:, None]

    def holds(self, x0: FloatArray, x: FloatArray, before: float, height: float) -> Holds:
        """
        Return what is held at a position.

        Parameters
        ----------
        x0, x : ndarray, shape (n, 3)
            Positions at the start of the step, and as far as known at its end [m].
        before, height : float
            Height of the tool then and now [m].

        """
        one = np.flatnonzero(self.by_tool)
        two = np.flatnonzero(self.by_support & ~self.by_tool)
        gap, normal = self._gap(x[one], height)
        normals = np.concatenate([normal, np.tile([0.0, 0.0, -1.0], (two.size, 1))])
        nodes = np.concatenate([one, two])
        gaps = np.concatenate([gap, x[two, 2]])
        free = np.eye(3) - normals[:, :, None] * normals[:, None, :]
        correction = gaps[:, None] * normals
        held = self._held[nodes]
        if held.any():
            free[held] = 0.0
            goal = x0[nodes].copy()
            goal[:, 2] = np.where(self.by_tool[nodes], goal[:, 2] + height - before, 0.0)
            if not self._tool.sphere:
                goal[np.arange(one.size), 2] = height
            correction[held] = (goal - x[nodes])[held]
        rub = np.zeros(nodes.size)
        moved = np.zeros((nodes.size, 3))
        if self.slides:
            tool, support = self._touches
            friction = np.where(self.by_tool[nodes], tool.friction, support.friction)
            rough = np.isfinite(friction) & (friction > 0.0)
            moved = np.einsum('mij,mj->mi', free, x[nodes] - x0[nodes])
            way = np.maximum(np.linalg.norm(moved, axis=1), _STUCK * self._pitch)
            rub[rough] = (friction[rough] * self._press[nodes][rough]) / way[rough]
        return Holds(nodes, normals, free, correction, rub, -rub[:, None] * moved)

    def change(
        self,
        holds: Holds,
        net: FloatArray,
        x0: FloatArray,
        x: FloatArray,
        height: float,
        slack: float,
    ) -> bool:
        """
        Correct the sets by what the iteration found; return whether that changed the system.

        Parameters
        ----------
        holds : Holds
            What was held.
        net : ndarray, shape (n, 3)
            Forces on the nodes, without those of tool and support [N].
        x0, x : ndarray, shape (n, 3)
            Positions [m].
        height : float
            Of the tool [m].
        slack : float
            A pull that counts as none [N].

        """
        nodes = holds.nodes
        press = np.einsum('ij,ij->i', net[nodes], holds.normals)
        support = self._touches[1]
        may = self._changes[nodes] < _MOST_CHANGES
        on_tool = self.by_tool[nodes]
        # What comes down beside the foot is not glued to the support.
        loose = support.lets_go | ~self._foot[nodes]
        leaves = (press < -slack) & may & (on_tool | loose)
        gone = nodes[leaves]
        self.by_tool[gone] = False
        self.by_support[gone] = False
        self._held[gone] = False
        changed = bool(leaves.any())
        self.unsettled = 0.0
        gap, _ = self._gap(x[self._side], height)
        through = self._side[(gap < -_NEAR * self._pitch) & ~self.by_tool[self._side]]
        self.by_tool[through] = True
        deep = x[self._surface, 2] < -_NEAR * self._pitch
        low = self._surface[deep]
        low = low[~(self.by_support[low] | self.by_tool[low])]
        self.by_support[low] = True
        for new in (through, low):
            self._changes[new] += 1
            changed = changed or new.size > 0
        bearable = np.maximum(press, 0.0) * ~leaves
        most = float(bearable.max(initial=0.0))
        turn = float(np.abs(bearable - self._press[nodes]).max(initial=0.0))
        self.unsettled = turn / max(most, slack, 1e-300) if self.slides else 0.0
        self._press[:] = 0.0
        self._press[nodes] = bearable
        return changed
