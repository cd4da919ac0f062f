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


"""The object under the simulated tool: one-dimensional, viscoelastic, in unilateral contact."""

from dataclasses import dataclass
from math import inf


@dataclass(frozen=True, slots=True)
class Material:
    """
    What an object is made of, as seen by a flat tool.

    ::

                        +--[ K_0 ]--( K1 || C1 )--( C2 || slider F_y )--+
        tool surface ---+                                               +--- support
                        +--------------------[ K_p ]--------------------+

    Parameters
    ----------
    elastic_stiffness : float
        K1 [N/m].
    retardation_viscosity : float
        C1 [N.s/m], beside K1; zero for an ideal spring.
    flow_viscosity : float
        C2 [N.s/m]; infinite for an object that does not flow.
    yield_force : float
        F_y [N]: threshold of the Saint-Venant slider beside C2 (a Bingham element).
    series_stiffness : float
        K_0 [N/m]: instantaneous spring in series; infinite for none.
    parallel_stiffness : float
        K_p [N/m]: equilibrium spring beside the whole chain; zero for none.

    Raises
    ------
    ValueError
        If a constant is out of its range.

    References
    ----------
    Paper, eqs. (1)-(3), for K1, C1 and C2; M. Reiner, Deformation, Strain and Flow, 1960, for
    the Bingham element.

    """

    elastic_stiffness: float
    retardation_viscosity: float = 0.0
    flow_viscosity: float = inf
    yield_force: float = 0.0
    series_stiffness: float = inf
    parallel_stiffness: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 < self.elastic_stiffness < inf:
            raise ValueError('elastic_stiffness must be above zero and finite')
        if not self.flow_viscosity > 0.0:
            raise ValueError('flow_viscosity must be above zero')
        if not self.series_stiffness > 0.0:
            raise ValueError('series_stiffness must be above zero')
        for name in ('retardation_viscosity', 'yield_force', 'parallel_stiffness'):
            if not 0.0 <= getattr(self, name) < inf:
                raise ValueError(f'{name} must be zero or more and finite')

    @property
    def relaxation_time(self) -> float:
        """Return the time constant of the force at held displacement, ``(C1 + C2) / K1`` [s]."""
        return (self.retardation_viscosity + self.flow_viscosity) / self.elastic_stiffness

    @property
    def retardation_time(self) -> float:
        """Return the time constant of the free recovery, ``C1 / K1`` [s]."""
        return self.retardation_viscosity / self.elastic_stiffness


class DeformableObject:
    """
    The state of an object under the tool, stepped by the implicit Euler method.

    Each step solves the piecewise linear network for the force in closed form, so that it is
    stable for any stiffness and the unilateral contact is decided within the step: the object
    carries the tool, or it recovers freely below it.

    Parameters
    ----------
    material : Material
        What the object is made of.
    step : float
        Time step [s].

    Attributes
    ----------
    displacement : float
        The paper's displacement height H of the surface under the tool [m].
    force : float
        Contact force on the tool at the end of the last step [N], zero or more.
    retarded_displacement : float
        Stretch of K1 and C1 [m].
    flow_displacement : float
        Permanent deformation, the stretch of C2 [m].

    """

    __slots__ = (
        '_flow_compliance',
        '_instant_compliance',
        '_memory',
        '_parallel_stiffness',
        '_retarded_compliance',
        '_yield_force',
        'displacement',
        'flow_displacement',
        'force',
        'retarded_displacement',
    )

    def __init__(self, material: Material, step: float) -> None:
        if not step > 0.0:
            raise ValueError('the time step must be above zero')
        viscous = material.retardation_viscosity / step
        self._retarded_compliance = 1.0 / (material.elastic_stiffness + viscous)
        self._memory = viscous * self._retarded_compliance
        self._instant_compliance = self._retarded_compliance + 1.0 / material.series_stiffness
        self._flow_compliance = step / material.flow_viscosity
        self._yield_force = material.yield_force
        self._parallel_stiffness = material.parallel_stiffness
        self.reset()

    def reset(self) -> None:
        """Become a fresh, undeformed object."""
        self.displacement = 0.0
        self.force = 0.0
        self.retarded_displacement = 0.0
        self.flow_displacement = 0.0

    def advance(self, tool_depth: float) -> float:
        """
        Advance by one time step.

        Parameters
        ----------
        tool_depth : float
            How far the tool tip is below the original surface at the end of the step [m];
            negative above it.

        Returns
        -------
        float
            Contact force at the end of the step [N].

        """
        # The chain answers a force F with x = rest + instant F + flow max(|F| - F_y, 0) sign(F).
        rest = self.flow_displacement + self.retarded_displacement * self._memory
        instant = self._instant_compliance
        flow = self._flow_compliance
        threshold = self._yield_force
        parallel = self._parallel_stiffness

        force = -parallel * rest / (1.0 + parallel * instant)
        if force < -threshold:
            force = -parallel * (rest + flow * threshold) / (1.0 + parallel * (instant + flow))
            surface = rest + instant * force + flow * (force + threshold)
        else:
            surface = rest + instant * force
        if tool_depth > surface:
            surface = tool_depth
            force = (surface - rest) / instant
            if force > threshold:
                force = (surface - rest + flow * threshold) / (instant + flow)
            elif force < -threshold:
                force = (surface - rest - flow * threshold) / (instant + flow)
            self.force = force + parallel * surface
        else:
            self.force = 0.0

        self.retarded_displacement = (
            self.retarded_displacement * self._memory + self._retarded_compliance * force
        )
        if force > threshold:
            self.flow_displacement += flow * (force - threshold)
        elif force < -threshold:
            self.flow_displacement += flow * (force + threshold)
        self.displacement = surface
        return self.force
