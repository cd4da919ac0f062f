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
The law of a link: the chain of the identified model, in the numbers of one link.

The law is that of a link along an edge of the lattice. A diagonal of weight w and length L carries
``w L/a`` times the force that an edge, of length a, carries at the same strain, so that all links
have one law in stress and strain, the effects included, unless each is counted in a share of its
own (`Shares`).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
import math
from typing import Final

from hapticvision_ros.core.models.chain import REFERENCE_RATE
from hapticvision_ros.core.records import FloatArray
import numpy as np

EFFECTS: Final = (
    'yield_force',
    'series_spring',
    'second_retardation',
    'strain_stiffening',
    'shear_thinning',
    'damage',
)
"""Effects of the object that a link can carry."""


@dataclass(frozen=True, slots=True, eq=False)
class Shares:
    """
    How fast a push stretches each link, in which its chain is then counted.

    The chain of a link is stretched by the link's stretch over its share, and the link passes on
    the chain's force times its share. So all chains are where that of the model is, whatever its
    law, as long as links are stretched in these proportions; and forces in these proportions
    balance, as those of dashpots do. While shares stand still, springs and dashpots are the same
    with them and without.

    Parameters
    ----------
    depth : ndarray, shape (m,)
        Of the tool below its first touch [m].
    of_links : ndarray, shape (m, 13, p)
        Stretch of each link per depth, brought to the length of an edge, then; not zero [-].
    least : float
        What a share is at least: one that changes its sign does not go through zero, where a
        chain would be stretched without end [-].
    free : ndarray, shape (13, p)
        Shares where no tool touches: the mean of the way down.

    """

    depth: FloatArray
    of_links: FloatArray
    least: float
    free: FloatArray

    @classmethod
    def at_depths(cls, depth: FloatArray, of_links: FloatArray) -> 'Shares':
        """Return shares at some depths, as `simulation.Pressed.stretches` tells them."""
        least = float(np.abs(of_links).min())
        mean = of_links[0]
        if depth.size > 1:
            parts = np.diff(depth) / (depth[-1] - depth[0])
            weights = 0.5 * (np.append(parts, 0.0) + np.append(0.0, parts))
            mean = np.tensordot(weights, of_links, 1)
        return cls(depth, of_links, least, not_less(mean, least))

    def at(self, depth: float) -> FloatArray:
        """Return the shares where the tool is so deep [m], shape (13, p)."""
        after = int(np.searchsorted(self.depth, depth))
        if after in (0, self.depth.size):
            return np.asarray(self.of_links[min(after, self.depth.size - 1)])
        before = after - 1
        first, last = self.depth[before], self.depth[after]
        part = (depth - first) / (last - first)
        between = (1.0 - part) * self.of_links[before] + part * self.of_links[after]
        return not_less(between, self.least)


def not_less(values: FloatArray, least: float) -> FloatArray:
    """Return values of which none is nearer to zero than `least`."""
    return np.where(np.abs(values) < least, np.where(values < 0.0, -least, least), values)


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """
    What links make good of what a push does to the force of a body by its shape alone.

    A link takes `stretch` of its stretch for what its chain is stretched by, and passes on `force`
    of the chain's force, both by the depth of the push, whatever the chain is. Where no tool
    touches, it takes as much as on the mean of the way down, so that what springs back is as deep
    as what was pressed, and passes on so much more that a weight does what it would.

    Parameters
    ----------
    depth : ndarray, shape (n,)
        Of the tool below its first touch [m].
    force, stretch : ndarray, shape (n,)
        [-]
    lag : ndarray, shape (n,)
        How the two may be turned against each other, ``exp(x lag)`` and ``exp(-x lag)``. What a
        link does now keeps its force; what it remembers of the way there counts for more or less:
        springs hold on to how links were stretched where the tool no longer stretches them [-].
    shares : Shares or None
        None for links that are alike everywhere, as of one material.

    """

    depth: FloatArray
    force: FloatArray
    stretch: FloatArray
    lag: FloatArray
    shares: Shares | None = None

    @classmethod
    def none(cls) -> 'Geometry':
        """Return one that changes nothing."""
        return cls(np.zeros(1), np.ones(1), np.ones(1), np.zeros(1))

    def refined(self, depth: FloatArray, factor: FloatArray, turned: float) -> 'Geometry':
        """Return one that passes on more of the force, by a factor at each depth, and turned."""
        both = np.union1d(self.depth, depth)
        more = np.interp(both, depth, factor)
        force, stretch, lag = (
            np.interp(both, self.depth, one) for one in (self.force, self.stretch, self.lag)
        )
        turn = np.exp(turned * lag)
        return Geometry(both, force * more * turn, stretch / turn, lag, self.shares)

    @property
    def free(self) -> float:
        """Return `stretch` where no tool touches [-]."""
        way = np.append(0.0, self.depth)
        parts = np.append(self.stretch[0], 0.5 * (self.stretch[1:] + self.stretch[:-1]))
        return float(parts @ np.diff(way)) / way[-1] if way[-1] > 0.0 else float(self.stretch[-1])

    def at(self, depth: float) -> tuple[float, float]:
        """Return `force` and `stretch` where the tool is so deep [m]."""
        return (
            float(np.interp(depth, self.depth, self.force)),
            float(np.interp(depth, self.depth, self.stretch)),
        )


@dataclass(frozen=True, slots=True)
class LinkLaw:
    """
    What a link along an edge does.

    Parameters
    ----------
    stiffness : float
        k of the first Kelvin-Voigt unit [N/m].
    bounce_viscosity : float
        c1, beside k [N.s/m]; zero for a spring.
    flow_viscosity : float
        c2, in series [N.s/m].
    yield_force : float
        Threshold of the slider beside c2 [N].
    series_stiffness : float
        Instantaneous spring in series [N/m]; infinite for none.
    unit_stiffness, unit_viscosity : float
        A second Kelvin-Voigt unit in series [N/m, N.s/m]; infinite for none.
    stiffening : float
        b of k (1 + b z^2) [1/m^2].
    flow_index : float
        Exponent n of c2 [-]; 1 is a dashpot.
    reference_rate : float
        Rate at which a power law has the viscosity c2 [m/s].
    damage : float
        Share of k that is lost when its stretch has reached `reference_stretch` [-].
    reference_stretch : float
        [m]
    geometry : Geometry or None
        What is taken out of all links at each depth, so that the body answers as it would if
        geometry did not change; None for links that are the same at any depth.

    """

    stiffness: float
    bounce_viscosity: float
    flow_viscosity: float
    yield_force: float = 0.0
    series_stiffness: float = math.inf
    unit_stiffness: float = math.inf
    unit_viscosity: float = math.inf
    stiffening: float = 0.0
    flow_index: float = 1.0
    reference_rate: float = REFERENCE_RATE
    damage: float = 0.0
    reference_stretch: float = 1.0
    geometry: Geometry | None = None

    @property
    def plain(self) -> bool:
        """Return whether the mean force of a step is piecewise linear in the step's stretch."""
        return self.stiffening == 0.0 and self.damage == 0.0 and self.flow_index == 1.0


@dataclass(frozen=True, slots=True)
class Gauge:
    """
    What a push of one metre would do to the links of an elastic lattice: one static solve.

    Parameters
    ----------
    stiffness : float
        Force on the tool per depth, per stiffness of an edge link [-]: the G of ``k = K1 / G``.
    share : float
        Root mean square stretch of the links per depth, brought to the length of an edge and
        weighted by their energy [-].
    first_share : float
        Sum of the links' absolute stretches per depth, each brought to an edge and weighted by
        its weight and length [-]: the force of a body that flows everywhere at a threshold.
    shares : ndarray, shape (13, p)
        Stretch of each link per depth, brought to the length of an edge, not zero [-].

    """

    stiffness: float
    share: float
    first_share: float
    shares: FloatArray


def link_law(
    parameters: Mapping[str, float],
    gauge: Gauge,
    *,
    reference_depth: float,
    alike: bool = True,
) -> LinkLaw:
    """
    Return the links of a body that answers as identified, to first order.

    Exact for the linear elements of a body that keeps its contact; a first guess for the others,
    which `calibration.calibrate` makes good.

    Parameters
    ----------
    parameters : mapping of str to float
        Of the identified model, by name, SI: K1, C1, C2, and F_y, K_0, K_2, C_3, beta, n, D where
        the model has them. A name that no link can carry is left out of account.
    gauge : Gauge
        From `calibration.gauge`.
    reference_depth : float
        d_ref of the model, the deepest push of the campaign [m].
    alike : bool
        Whether links are alike everywhere, as of one material; else each is counted in what a
        push stretches it by (`Shares`), and so is this law.

    """
    scale = 1.0 / gauge.stiffness
    share = gauge.share if alike else 1.0
    return LinkLaw(
        stiffness=parameters['K1'] * scale,
        bounce_viscosity=parameters['C1'] * scale,
        flow_viscosity=parameters['C2'] * scale,
        yield_force=parameters.get('F_y', 0.0) * (1.0 / gauge.first_share if alike else scale),
        series_stiffness=parameters.get('K_0', math.inf) * scale,
        unit_stiffness=parameters.get('K_2', math.inf) * scale,
        unit_viscosity=parameters.get('C_3', math.inf) * scale,
        stiffening=parameters.get('beta', 0.0) / share**2,
        flow_index=parameters.get('n', 1.0),
        reference_rate=REFERENCE_RATE * share,
        damage=parameters.get('D', 0.0),
        reference_stretch=reference_depth * share,
    )


_NUMBERS: Final = {
    'K1': 'stiffness',
    'C1': 'bounce_viscosity',
    'C2': 'flow_viscosity',
    'F_y': 'yield_force',
    'K_0': 'series_stiffness',
    'K_2': 'unit_stiffness',
    'C_3': 'unit_viscosity',
    'beta': 'stiffening',
    'n': 'flow_index',
    'D': 'damage',
}


def scaled(law: LinkLaw, factors: Mapping[str, float]) -> LinkLaw:
    """Return a law with the numbers of named parameters multiplied."""
    return replace(
        law,
        **{
            _NUMBERS[name]: getattr(law, _NUMBERS[name]) * factor
            for name, factor in factors.items()
            if name in _NUMBERS
        },
    )
