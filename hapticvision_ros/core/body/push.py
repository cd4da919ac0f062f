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

"""What presses the body: the tool, its motion, and how tool and support touch."""

from dataclasses import dataclass, field
import math

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
import numpy as np


@dataclass(frozen=True, slots=True)
class Tool:
    """
    A tool that moves along z, with its tip below.

    Parameters
    ----------
    radius : float
        Of the flat face, or of the sphere [m].
    x, y : float
        Its axis, in the frame of the body [m].
    sphere : bool
        Whether the tip is a sphere; else it is a flat disc.

    """

    radius: float
    x: float
    y: float
    sphere: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class ToolMotion:
    """
    Where the tool's tip is.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times [s], increasing.
    height : ndarray, shape (n,)
        Height of the tip over the support plane [m], linear in between.
    corners : tuple of float
        Times at which the speed changes suddenly, such as the starts of the phases [s]; steps end
        there and begin anew with the shortest.

    Raises
    ------
    InputError
        If the times do not increase or there are fewer than two.

    """

    t: FloatArray
    height: FloatArray
    corners: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.t.ndim != 1 or self.t.shape != self.height.shape or self.t.size < 2:
            raise InputError('a motion of the tool has at least two times, with a height for each')
        if not (np.diff(self.t) > 0.0).all() or not np.isfinite(self.height).all():
            raise InputError('the times of a motion increase and its heights are finite numbers')

    @classmethod
    def trial(
        cls,
        top: float,
        *,
        depth: float,
        push_speed: float,
        hold: float,
        recovery: float,
        release_speed: float | None = None,
        clearance: float = 0.01,
    ) -> 'ToolMotion':
        """
        Return push, hold, release and recovery, from the first touch at time zero.

        Parameters
        ----------
        top : float
            Height of the body where the tool touches it [m].
        depth : float
            [m]
        push_speed, release_speed : float
            [m/s]; the release is as fast as the push by default.
        hold, recovery : float
            Durations [s]; that of the recovery counts from the start of the release.
        clearance : float
            How far above the top the tool rises [m].

        """
        out = release_speed or push_speed
        pressed = depth / push_speed
        released = pressed + hold
        clear = released + (depth + clearance) / out
        t = np.array([0.0, pressed, released, clear, max(released + recovery, clear + recovery)])
        if released + recovery > clear:
            t[-1] = released + recovery
        height = top - np.array([0.0, depth, depth, -clearance, -clearance])
        return cls(t, height, (pressed, released))

    def at(self, t: FloatArray) -> FloatArray:
        """Return the heights at times [m]."""
        return np.interp(t, self.t, self.height)


@dataclass(frozen=True, slots=True)
class Touch:
    """
    How a surface touches the body.

    Parameters
    ----------
    friction : float
        Coulomb's coefficient [-]; infinite for a surface that holds what it touches, 0 for none.
    lets_go : bool
        Whether the body may leave it; the tool's may always.

    """

    friction: float = math.inf
    lets_go: bool = True


@dataclass(frozen=True, slots=True)
class Surroundings:
    """
    What the force on the tool alone does not tell.

    Parameters
    ----------
    tool, support : Touch
        How they touch the body. The support is the plane z = 0.
    volume_ratio : float
        Stiffness of a cell against a change of its volume, over Young's modulus of its links,
        1.875 k/a [-]: of a spring, over that of k, and of a dashpot beside it, over that of c1 and
        c2 in series. 14 keeps the volume of a common push within 0.6 %, 0 is the bare lattice with
        a Poisson's ratio of 1/4.
    density : float
        [kg/m^3]; zero for a body without weight.
    gravity : float
        [m/s^2]
    small : bool
        Whether links keep their directions and cells their shapes, as if the push were small: the
        body is then as linear in the depth as the model is. Contact goes by the true positions.

    """

    tool: Touch = field(default_factory=Touch)
    support: Touch = field(default_factory=lambda: Touch(lets_go=False))
    volume_ratio: float = 14.0
    density: float = 0.0
    gravity: float = 9.80665
    small: bool = False
