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

from collections.abc import Mapping
from dataclasses import dataclass

from hapticvision_ros.core.body.lattice import Lattice
from hapticvision_ros.core.body.links import Gauge, LinkLaw
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.body.simulation import Accuracy, BodyRun
from hapticvision_ros.core.composition import Model


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


def gauge(lattice: Lattice, tool: Tool, surroundings: Surroundings | None = None) -> Gauge:
    """Return how the body passes a small push on to its links, by one static solve."""
    raise NotImplementedError


def calibrate(
    lattice: Lattice,
    model: Model,
    parameters: Mapping[str, float],
    tool: Tool,
    motion: ToolMotion,
    surroundings: Surroundings | None = None,
    *,
    reference_depth: float | None = None,
    rounds: int = 4,
    accuracy: Accuracy | None = None,
) -> Calibration:
    """
    Return links for which the body gives force and height of the identified model.

    Each round simulates the trial, fits the model to what came out, and multiplies the numbers of
    the links by identified over fitted.

    Parameters
    ----------
    lattice : Lattice
        The body at rest.
    model : Model
        The identified model; its effects of cell and sensor are left out of account.
    parameters : mapping of str to float
        Its parameters by name, SI.
    tool, motion, surroundings, accuracy
        As in `simulation.simulate`.
    reference_depth : float, optional
        d_ref of the model [m]; the deepest point of the motion by default.
    rounds : int
        Runs at most.

    """
    raise NotImplementedError
