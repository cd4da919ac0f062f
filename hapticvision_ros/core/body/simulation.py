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

from hapticvision_ros.core.body.lattice import IndexArray, Lattice
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.records import FloatArray
import numpy as np


@dataclass(frozen=True, slots=True)
class Accuracy:
    """
    How finely time is cut.

    Parameters
    ----------
    position : float
        Error of the positions that a step may make [m].
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
        Displacement height at the contact: how far the surface under the tool has gone down, the
        mean over the nodes of its face [m].
    touching : ndarray of int, shape (n,)
        How many nodes the tool touches.
    volume : ndarray, shape (n + 1,)
        [m^3]
    work : ndarray, shape (n + 1,)
        What the tool has done so far [J].
    stored : ndarray, shape (n + 1,)
        What springs, cells and weight hold of it [J].
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
        """Return what has become heat, shape (n + 1,) [J]."""
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
    raise NotImplementedError
