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
The paper's three-element model: a Kelvin-Voigt unit in series with a dashpot.

::

            +---- K1 ----+
    tool ---|            |---- C2 ---- support
            +---- C1 ----+

    |<-- bouncing, z -->|<- residual, y ->|          H = z + y

The force is the same in both parts, eqs. (1) and (2) with the direction of the push positive:
``F = K1 z + C1 dz/dt = C2 dy/dt``. While the tool prescribes H this is, exactly,

    ``F = eta dH/dt + k s``,  ``ds/dt = dH/dt - s / T``,  ``z = r s``,

    ``r = C2 / (C1 + C2)``,  ``eta = r C1``,  ``k = r^2 K1``,  ``T = (C1 + C2) / K1``:

a dashpot beside a Maxwell branch that relaxes with the relaxation time T of eq. (9). In the hold F
decays with T to zero (eq. 8, without the stray factor that eq. 7 is printed with). Contact pushes
but does not pull: it ends when F has fallen to zero. Free, z decays with the retardation time
C1 / K1 of eq. (12), y stays, and H follows eq. (10).

"""

from dataclasses import dataclass
import math

from hapticvision_ros.core.records import FloatArray
import numpy as np


@dataclass(frozen=True, slots=True)
class ThreeElement:
    """
    The three-element model under the force of a tool.

    Parameters
    ----------
    K1 : float
        Elastic coefficient [N/m], positive.
    C1, C2 : float
        Viscosities [N.s/m]: of the bouncing part, at least 0, and of the residual part, positive.

    Raises
    ------
    ValueError
        If a parameter is out of its range.

    """

    K1: float
    C1: float
    C2: float

    def __post_init__(self) -> None:
        if not (self.K1 > 0.0 and self.C1 >= 0.0 and self.C2 > 0.0):
            raise ValueError(f'no such body: K1 = {self.K1}, C1 = {self.C1}, C2 = {self.C2}')

    @classmethod
    def from_maxwell(cls, eta: float, k: float, relaxation_time: float) -> 'ThreeElement':
        """Return the body whose force is `eta` [N.s/m] beside a Maxwell branch `k` [N/m]."""
        C2 = eta + k * relaxation_time
        r = k * relaxation_time / C2
        return cls(K1=k / r**2, C1=eta / r, C2=C2)

    @property
    def relaxation_time(self) -> float:
        """Return the time constant of the force at a held displacement, eq. (9) [s]."""
        return (self.C1 + self.C2) / self.K1

    @property
    def retardation_time(self) -> float:
        """Return the time constant of the free recovery, eq. (12) [s]."""
        return self.C1 / self.K1

    @property
    def share(self) -> float:
        """Return r, the part of the tool's speed that goes into z."""
        return self.C2 / (self.C1 + self.C2)

    @property
    def eta(self) -> float:
        """Return the viscosity of the dashpot beside the Maxwell branch [N.s/m]."""
        return self.share * self.C1

    @property
    def k(self) -> float:
        """Return the stiffness of the Maxwell branch [N/m]."""
        return self.share**2 * self.K1


@dataclass(frozen=True, slots=True)
class Response:
    """
    What the model does under a tool.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Contact force [N]; zero once contact is lost.
    height : ndarray, shape (n,)
        Displacement height H [m].
    t_loss : float or None
        When contact ends [s].

    """

    force: FloatArray
    height: FloatArray
    t_loss: float | None


def maxwell_stretch(
    t: FloatArray, knot_t: FloatArray, knot_height: FloatArray, relaxation_times: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """
    Return speed and stretch s of a Maxwell branch under a piecewise linear displacement.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Increasing times [s], within the knots.
    knot_t, knot_height : ndarray, shape (m,)
        The displacement: increasing times [s], and H [m] at them, linear in between; s is zero at
        the first.
    relaxation_times : ndarray, shape (p,)
        T [s].

    Returns
    -------
    speed : ndarray, shape (n,)
        dH/dt at `t` [m/s]; at a knot that of the piece before it.
    stretch : ndarray, shape (p, n)
        s at `t` [m], exact for each T.

    """
    widths = np.diff(knot_t)
    speeds = np.diff(knot_height) / widths
    T = relaxation_times[:, np.newaxis]
    at_knots = np.zeros((relaxation_times.size, knot_t.size))
    # -T expm1(-w / T) is w for a spring (T long), without the difference of two large numbers.
    left = np.exp(-widths / T)
    gained = -T * np.expm1(-widths / T) * speeds
    for piece in range(widths.size):
        at_knots[:, piece + 1] = at_knots[:, piece] * left[:, piece] + gained[:, piece]
    piece_of = np.clip(np.searchsorted(knot_t, t, side='left') - 1, 0, widths.size - 1)
    since = t - knot_t[piece_of]
    speed = speeds[piece_of]
    stretch = at_knots[:, piece_of] * np.exp(-since / T) - T * np.expm1(-since / T) * speed
    return speed, stretch


def respond(
    body: ThreeElement, t: FloatArray, knot_t: FloatArray, knot_height: FloatArray
) -> Response:
    """
    Return force and displacement height of a body that a tool pushes and leaves.

    Parameters
    ----------
    body : ThreeElement
        The body, at rest and undeformed at the first knot.
    t : ndarray, shape (n,)
        Increasing times [s], from the first knot on.
    knot_t, knot_height : ndarray, shape (m,)
        The tool's displacement from the first touch on: increasing times [s], and depth [m] at
        them, linear in between. Contact, once lost, is not looked for again.

    Returns
    -------
    Response
        Exact for the piecewise linear tool.

    """
    T = np.array([body.relaxation_time])
    _, at_knots = maxwell_stretch(knot_t, knot_t, knot_height, T)
    t_loss = _loss(body, knot_t, knot_height, at_knots[0])
    inside = np.minimum(t, knot_t[-1] if t_loss is None else t_loss)
    speed, stretch = maxwell_stretch(inside, knot_t, knot_height, T)
    force = body.eta * speed + body.k * stretch[0]
    height = np.interp(inside, knot_t, knot_height)
    if t_loss is None:
        return Response(force, height, None)
    free = t > t_loss
    force[free] = 0.0
    bounced = body.share * maxwell_stretch(np.array([t_loss]), knot_t, knot_height, T)[1][0, 0]
    recovered = recovery(body, bounced, t[free] - t_loss)
    height[free] += recovered - bounced
    return Response(force, height, t_loss)


def recovery(body: ThreeElement, bouncing: float, t: FloatArray) -> FloatArray:
    """Return z [m] a time `t` [s] after the body was left free with z = `bouncing` [m]."""
    if body.C1 == 0.0:
        return np.where(t > 0.0, 0.0, bouncing)
    return np.asarray(bouncing * np.exp(-t / body.retardation_time), dtype=np.float64)


def _loss(
    body: ThreeElement, knot_t: FloatArray, knot_height: FloatArray, stretch: FloatArray
) -> float | None:
    """Return when the force has fallen to zero after the touch [s]."""
    widths = np.diff(knot_t)
    speeds = np.diff(knot_height) / widths
    touched = False
    for piece in range(widths.size):
        start, width = float(knot_t[piece]), float(widths[piece])
        speed, s = float(speeds[piece]), float(stretch[piece])
        first = body.eta * speed + body.k * s
        steady = body.k * speed * body.relaxation_time
        # F = first + (steady + eta speed - first) (1 - exp(-dt / T)) falls to zero in this piece?
        change = steady + body.eta * speed - first
        touched = touched or first > 0.0 or change > 0.0
        if not touched:
            continue
        if first <= 0.0 and change <= 0.0:
            return start
        if first > 0.0 and change < -first:
            after = -body.relaxation_time * math.log1p(first / change)
            if after < width:
                return start + after
    return None
