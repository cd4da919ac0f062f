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

"""The object under the simulated tool as a body that deforms, where a chain only has a dent."""

from math import inf, isfinite

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.sim.config import Block, SoftBodyModel
from hapticvision_ros.sim.objects import Material
from hapticvision_ros.sim.soft_body import Integers, SoftBody, SoftMaterial
import numpy as np

_MODULUS = 1.875
"""Young's modulus of the lattice times pitch over the stiffness of a link."""
_SLIGHT = 1e-3
"""Depth of the push by which the links are told, over the pitch."""
_WHOLE = 1e-6
"""By what share of a cell a side may not be made of whole cells."""
_DAMPING = 20.0
"""Of the body that is pressed for that, per step and spring: at rest after some hundred steps."""


class SoftObject:
    """
    The state of a deforming block under the tool, stepped like `objects.DeformableObject`.

    The links are made so that a slight push meets the springs, dashpots and threshold of the
    material. As the push gets deeper the block goes its own way: it has a shape.

    Parameters
    ----------
    material : Material
        What the object is made of, as a slight push feels it; without springs in series or beside
        it.
    block : Block
        Its size; its dent makes itself.
    tool_radius : float
        [m]
    model : SoftBodyModel
        Cells, time step, support and volume.
    step : float
        Time step of the world [s].

    Raises
    ------
    InputError
        If the block or the material cannot be made of such cells.

    Attributes
    ----------
    displacement : float
        How far the surface under the tool has gone down, on average [m].
    force : float
        Contact force on the tool over the last step of the body [N].

    """

    def __init__(
        self,
        material: Material,
        block: Block,
        tool_radius: float,
        model: SoftBodyModel,
        step: float,
    ) -> None:
        _check(material, block, tool_radius, model)
        self._block, self._radius, self._model = block, tool_radius, model
        self._every = max(1, round(model.step / step))
        self._step = self._every * step
        bulk = model.volume_ratio * _MODULUS / model.pitch
        trial = self._body(SoftMaterial(1.0, _DAMPING, inf, 0.0, bulk), 1.0)
        depth = _SLIGHT * model.pitch
        force, stretched = trial.pressed_by(depth)
        spring = material.elastic_stiffness * depth / force
        self._links = SoftMaterial(
            spring,
            material.retardation_viscosity * depth / force,
            material.flow_viscosity * depth / force,
            material.yield_force * depth / stretched,
            spring * bulk,
            bulk * _in_series(material) * depth / force,
        )
        self.triangles: Integers = trial.triangles
        self.reset()

    def reset(self) -> None:
        """Become a fresh, undeformed object."""
        self._soft = self._body(self._links, self._step)
        self._pressed = False
        self._waited = 0
        self._height = inf
        self.force = 0.0
        self.displacement = 0.0

    def advance(self, tool_depth: float) -> float:
        """
        Advance by one time step of the world; the body takes one step for several of these.

        Parameters
        ----------
        tool_depth : float
            How far the tool tip is below the original surface at the end of the step [m];
            negative above it.

        Returns
        -------
        float
            Contact force [N].

        """
        self._waited += 1
        if self._waited < self._every:
            return self.force
        self._waited = 0
        height = self._block.height - tool_depth
        # What has never been touched stays as it is.
        self._pressed = self._pressed or tool_depth > 0.0
        if self._pressed:
            start = self._height if isfinite(self._height) else height
            self.force = self._soft.advance(self._step, start, height)
            self.displacement = self._soft.sunk
        self._height = height
        return self.force

    @property
    def points(self) -> FloatArray:
        """Return the positions of the nodes in the frame `support_plane`, shape (n, 3) [m]."""
        cos, sin = np.cos(self._block.yaw), np.sin(self._block.yaw)
        turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        return np.asarray(self._soft.points @ turn.T)

    @property
    def rest(self) -> FloatArray:
        """Return the positions of the nodes of the block at rest, before it is turned [m]."""
        return self._soft.rest

    def _body(self, links: SoftMaterial, step: float) -> SoftBody:
        block, model = self._block, self._model
        return SoftBody(
            (block.length, block.width, block.height),
            model.pitch,
            links,
            self._radius,
            step,
            friction=model.friction,
            sphere=model.sphere,
        )


def soft_surface(block: Block, model: SoftBodyModel) -> tuple[int, Integers]:
    """Return how many nodes a soft block has, and the triangles of its surface."""
    size = block.length, block.width, block.height
    body = SoftBody(size, model.pitch, SoftMaterial(1.0, 1.0, 1.0), model.pitch, 1.0)
    return len(body.rest), body.triangles


def _in_series(material: Material) -> float:
    """Return the viscosity that a fast push meets, both dashpots in series [N.s/m]."""
    return 1.0 / (1.0 / material.retardation_viscosity + 1.0 / material.flow_viscosity)


def _check(material: Material, block: Block, tool_radius: float, model: SoftBodyModel) -> None:
    """Refuse what the body cannot be."""
    if isfinite(material.series_stiffness) or material.parallel_stiffness > 0.0:
        raise InputError(
            'a soft body has no spring in series or beside it: leave series_stiffness and '
            'parallel_stiffness out of the object, or soft_body out of the cell'
        )
    if not material.retardation_viscosity > 0.0:
        raise InputError(
            'a soft body needs a dashpot beside its spring: give the object a '
            'retardation_viscosity, or leave soft_body out of the cell'
        )
    for name in ('length', 'width', 'height'):
        cells = getattr(block, name) / model.pitch
        if abs(cells - round(cells)) > _WHOLE or round(cells) < 1:
            raise InputError(
                f'a soft body is made of whole cells: {name} is {getattr(block, name):g} m, '
                f'which cells of {model.pitch:g} m do not divide'
            )
    if tool_radius < model.pitch:
        raise InputError(
            f'the tool is smaller than a cell of the soft body: choose a pitch below '
            f'{tool_radius:g} m'
        )
