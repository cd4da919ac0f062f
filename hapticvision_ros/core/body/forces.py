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
Forces on the nodes over a step, and how they change with the positions at its end.

A link carries its mean force over the step along the mean of its directions at both ends,
``(r0 + r1) / (l0 + l1)``: the work that it does is then exactly force times stretch. A cell's
volume is a spring beside a dashpot, whose mean pressure acts along the gradient of the volume half
way.

All arrays of nodes run over the places of the grid, x fastest, with a margin at both ends that is
as wide as the farthest neighbour: a neighbour's index needs no check.

References
----------
O. Gonzalez, J. Nonlinear Sci. 6, 1996, 449-467, doi:10.1007/BF02440162 (discrete gradients).

"""

from hapticvision_ros.core.kernels import kernel
import numpy as np

(
    K,
    C1,
    E,
    FLOW,
    GIVE,
    YIELD,
    UNIT_LEFT,
    UNIT_SOFT,
    SERIES,
    SERIES_END,
    STIFFENING,
    DAMAGE,
    REFERENCE,
    POWER,
    RATE,
    STEP,
    AGAINST,
    PLAIN,
    CELL,
    PASSED,
    TAKEN,
    NUMBERS,
) = range(22)
"""
What a link's law is over one step: k, c1, weight e of the step's stretch, h / c2, what units and
series spring give per force, threshold, share 1 - exp(-h / T) of the unit's way, its compliance,
the series compliance, the weight of its end force, b, damage, the stretch it refers to, 1 / n, the
rate and the length of the step, the viscosity that z falls back against, whether it is plain;
what e is for the volume of a cell, which does not flow; and what a link passes on of the force of
its chain, and gives it of its stretch.
"""

LEAST_INDEX = 0.6
"""
Exponent of the flow unit from which on Newton's method finds the nodes' positions from anywhere:
of a force that goes with the rate to the power n a step from too high a rate x ends at
(1 - 1 / n) x, which is farther off for n < 1/2. The slope is taken as if n were this there.
"""
_ITERATIONS = 40
_TOLERANCE = 1e-6


@kernel(error_model='numpy')
def fitted_weight(x):  # type: ignore[no-untyped-def]
    """Return b = 1 / (1 - exp(-x)) - 1 / x: how much the end of a step weighs in its mean."""
    if x < 1e-3:
        return 0.5 + x / 12.0
    if x > 500.0:
        return 1.0 - 1.0 / x
    return -1.0 / np.expm1(-x) - 1.0 / x


@kernel(error_model='numpy')
def _retarded(u, z, z_max, q):  # type: ignore[no-untyped-def]
    """Return the mean force of a unit whose k depends on its stretch, and its slope."""
    middle = z + 0.5 * u
    size = abs(middle)
    side = 1.0 if middle > 0.0 else -1.0
    stiffer = 1.0 + q[STIFFENING] * middle * middle
    if size > z_max:
        left = max(1.0 - q[DAMAGE] * size / q[REFERENCE], 0.02)
        d_left = -q[DAMAGE] / q[REFERENCE] * side if left > 0.02 else 0.0
    else:
        left = max(1.0 - q[DAMAGE] * z_max / q[REFERENCE], 0.02)
        d_left = 0.0
    k = q[K] * stiffer * left
    dk = q[K] * (2.0 * q[STIFFENING] * middle * left + stiffer * d_left)
    b = 1.0
    if q[AGAINST] > 0.0:
        b = fitted_weight(q[STEP] * k / q[AGAINST])
    e = k * b + q[C1] / q[STEP]
    return k * z + e * u, e + 0.5 * dk * (z + b * u)


@kernel(error_model='numpy')
def _flow(force, q):  # type: ignore[no-untyped-def]
    """Return how far the flow unit goes in the step, and the slope of that."""
    excess = abs(force) - q[YIELD]
    if excess <= 0.0:
        return 0.0, 0.0
    if q[POWER] == 1.0:
        way = q[FLOW] * excess
        slope = q[FLOW]
    else:
        unit = q[STEP] * q[RATE]
        # Where a power below one is steeper than can be told, it goes on straight.
        share = excess * q[FLOW] / unit
        low = 1e-9
        if share < low:
            slope = q[FLOW] * low ** (q[POWER] - 1.0)
            way = slope * excess
        else:
            way = unit * share ** q[POWER]
            slope = q[POWER] * way / excess
    return (way if force > 0.0 else -way), slope


@kernel(error_model='numpy')
def _general(stretch, z, z_max, q):  # type: ignore[no-untyped-def]
    """Return the mean force for what k and flow unit share, its slope, and what k takes of it."""
    low = min(stretch, -2.0 * z, 0.0)
    high = max(stretch, -2.0 * z, 0.0)
    size = max(high - low, 1e-30)
    u = min(max(stretch / (1.0 + q[E] * (q[GIVE] + q[FLOW])), low), high)
    force, slope = _retarded(u, z, z_max, q)
    ahead = 1.0
    for _ in range(_ITERATIONS):
        way, more = _flow(force, q)
        miss = u + q[GIVE] * force + way - stretch
        ahead = 1.0 + (q[GIVE] + more) * slope
        if miss > 0.0:
            high = u
        else:
            low = u
        change = -miss / ahead
        if abs(miss) <= _TOLERANCE * size:
            # What this leaves is of second order in it.
            force += slope * change
            u += change
            break
        if not low <= u + change <= high:
            change = 0.5 * (low + high) - u
        u += change
        force, slope = _retarded(u, z, z_max, q)
    if q[POWER] * LEAST_INDEX > 1.0:
        more = _flow(force, q)[1] / (q[POWER] * LEAST_INDEX)
        ahead = 1.0 + (q[GIVE] + more) * slope
    return force, slope / ahead, u


@kernel(error_model='numpy', inline='always')
def _plain(stretch, z, q):  # type: ignore[no-untyped-def]
    """Return mean force and slope where both are piecewise linear in the stretch."""
    pull = q[K] * z + q[E] * stretch
    force = pull / (1.0 + q[E] * q[GIVE])
    excess = abs(force) - q[YIELD]
    if excess <= 0.0:
        return force, q[E] / (1.0 + q[E] * q[GIVE])
    inverse = 1.0 / (1.0 + q[E] * (q[GIVE] + q[FLOW]))
    threshold = q[YIELD] if force > 0.0 else -q[YIELD]
    return (pull + q[E] * q[FLOW] * threshold) * inverse, q[E] * inverse


@kernel(error_model='numpy')
def link_forces(  # type: ignore[no-untyped-def]
    x0,
    x1,
    origin,
    first,
    last,
    offsets,
    weight,
    rest,
    pitch,
    shares,
    q,
    z,
    z_max,
    unit,
    ends,
    net,
    matrix,
    fill,
):
    """
    Add the forces of the links on the nodes to `net`, and to `matrix` minus their derivatives.

    Parameters
    ----------
    x0, x1 : ndarray, shape (3, p)
        Positions at the start and at the end of the step [m].
    origin : ndarray, shape (3, p), or (3, 0)
        Positions at rest where only small displacements count; else empty.
    first, last : int
        Where the margins end and begin.
    offsets : ndarray of int, shape (13,)
        To the neighbours.
    weight, rest : ndarray, shape (13, p)
        Of each link, and its length at rest [m].
    pitch : float
        [m]
    shares : ndarray, shape (13, p), or (13, 0)
        What the chain of a link is stretched by is its stretch over this, and its force times
        this that of the link [-]; empty where both are the same.
    q : ndarray, shape (NUMBERS,)
        The law over this step.
    z, z_max, unit, ends : ndarray, shape (13, p) each, or (13, 0) where not needed
        State of the links, brought to an edge.
    net : ndarray, shape (3, p)
        [N]
    matrix : ndarray of float32, shape (14, 9, p)
        Blocks of a node with itself and with its 13 neighbours [N/m].
    fill : bool
        Whether the matrix is wanted.

    """
    plain = q[PLAIN] != 0.0
    small = origin.shape[1] > 0
    has_unit = unit.shape[1] > 0
    has_series = ends.shape[1] > 0
    has_most = z_max.shape[1] > 0
    has_shares = shares.shape[1] > 0
    for k in range(offsets.size):
        off = offsets[k]
        for i in range(first, last):
            w = weight[k, i]
            if w == 0.0:
                continue
            j = i + off
            ax = x0[0, j] - x0[0, i]
            ay = x0[1, j] - x0[1, i]
            az = x0[2, j] - x0[2, i]
            bx = x1[0, j] - x1[0, i]
            by = x1[1, j] - x1[1, i]
            bz = x1[2, j] - x1[2, i]
            la = np.sqrt(ax * ax + ay * ay + az * az)
            lb = np.sqrt(bx * bx + by * by + bz * bz)
            per = 1.0 / (la + lb)
            dx = (ax + bx) * per
            dy = (ay + by) * per
            dz = (az + bz) * per
            long = rest[k, i] / pitch
            stretch = q[TAKEN] * (lb - la) / long
            if small:
                per = 0.0
                dx = (origin[0, j] - origin[0, i]) / rest[k, i]
                dy = (origin[1, j] - origin[1, i]) / rest[k, i]
                dz = (origin[2, j] - origin[2, i]) / rest[k, i]
                stretch = q[TAKEN] * ((bx - ax) * dx + (by - ay) * dy + (bz - az) * dz) / long
            share = 1.0
            if has_shares:
                share = shares[k, i]
                stretch /= share
            if has_unit:
                stretch += q[UNIT_LEFT] * unit[k, i]
            if has_series:
                stretch += q[SERIES] * q[SERIES_END] * ends[k, i]
            if plain:
                force, slope = _plain(stretch, z[k, i], q)
            else:
                most = z_max[k, i] if has_most else 0.0
                force, slope, _ = _general(stretch, z[k, i], most, q)
            force *= w * long * share * q[PASSED]
            net[0, i] += force * dx
            net[1, i] += force * dy
            net[2, i] += force * dz
            net[0, j] -= force * dx
            net[1, j] -= force * dy
            net[2, j] -= force * dz
            if fill:
                across = force * per
                along = w * slope * q[PASSED] * q[TAKEN] - across
                xx = np.float32(along * dx * dx + across)
                xy = np.float32(along * dx * dy)
                xz = np.float32(along * dx * dz)
                yy = np.float32(along * dy * dy + across)
                yz = np.float32(along * dy * dz)
                zz = np.float32(along * dz * dz + across)
                m = matrix[k + 1]
                m[0, i] -= xx
                m[1, i] -= xy
                m[2, i] -= xz
                m[3, i] -= xy
                m[4, i] -= yy
                m[5, i] -= yz
                m[6, i] -= xz
                m[7, i] -= yz
                m[8, i] -= zz
                d = matrix[0]
                for p in (i, j):
                    d[0, p] += xx
                    d[1, p] += xy
                    d[2, p] += xz
                    d[3, p] += xy
                    d[4, p] += yy
                    d[5, p] += yz
                    d[6, p] += xz
                    d[7, p] += yz
                    d[8, p] += zz


@kernel(error_model='numpy')
def advance_links(  # type: ignore[no-untyped-def]
    x0, x1, origin, first, last, offsets, weight, rest, pitch, shares, q, z, z_max, unit, ends
):
    """Take the state of the links to the end of the step; return what their springs hold [J]."""
    plain = q[PLAIN] != 0.0
    small = origin.shape[1] > 0
    has_unit = unit.shape[1] > 0
    has_series = ends.shape[1] > 0
    has_most = z_max.shape[1] > 0
    has_shares = shares.shape[1] > 0
    total = 0.0
    for k in range(offsets.size):
        off = offsets[k]
        for i in range(first, last):
            w = weight[k, i]
            if w == 0.0:
                continue
            j = i + off
            la = 0.0
            lb = 0.0
            for a in range(3):
                la += (x0[a, j] - x0[a, i]) ** 2
                lb += (x1[a, j] - x1[a, i]) ** 2
            long = rest[k, i] / pitch
            stretch = q[TAKEN] * (np.sqrt(lb) - np.sqrt(la)) / long
            if small:
                stretch = 0.0
                for a in range(3):
                    along = q[TAKEN] * (origin[a, j] - origin[a, i]) / (rest[k, i] * long)
                    stretch += along * (x1[a, j] - x1[a, i] - x0[a, j] + x0[a, i])
            share = 1.0
            if has_shares:
                share = shares[k, i]
                stretch /= share
            if has_unit:
                stretch += q[UNIT_LEFT] * unit[k, i]
            if has_series:
                stretch += q[SERIES] * q[SERIES_END] * ends[k, i]
            if plain:
                force, _ = _plain(stretch, z[k, i], q)
                z[k, i] += (force - q[K] * z[k, i]) / q[E]
            else:
                most = z_max[k, i] if has_most else 0.0
                force, _, u = _general(stretch, z[k, i], most, q)
                z[k, i] += u
            square = z[k, i] * z[k, i]
            held = 0.5 * q[K] * square * (1.0 + 0.5 * q[STIFFENING] * square)
            if has_most:
                z_max[k, i] = max(z_max[k, i], abs(z[k, i]))
                held *= max(1.0 - q[DAMAGE] * z_max[k, i] / q[REFERENCE], 0.02)
            if has_unit:
                unit[k, i] += q[UNIT_LEFT] * (q[UNIT_SOFT] * force - unit[k, i])
                held += 0.5 * unit[k, i] * unit[k, i] / q[UNIT_SOFT]
            if has_series:
                ends[k, i] += q[SERIES_END] * (force - ends[k, i])
                held += 0.5 * q[SERIES] * ends[k, i] * ends[k, i]
            total += held * w * long * long * share * share
    return total * q[PASSED] / q[TAKEN]


@kernel(error_model='numpy', inline='always')
def _gradient(x, corner, slope, f):  # type: ignore[no-untyped-def]
    """Set f to the deformation gradient in the middle of a cell, and return its determinant."""
    for a in range(3):
        fa = 0.0
        fb = 0.0
        fc = 0.0
        for p in range(8):
            v = x[a, corner[p]]
            fa += v * slope[0, p]
            fb += v * slope[1, p]
            fc += v * slope[2, p]
        f[a, 0] = fa
        f[a, 1] = fb
        f[a, 2] = fc
    return (
        f[0, 0] * (f[1, 1] * f[2, 2] - f[1, 2] * f[2, 1])
        - f[0, 1] * (f[1, 0] * f[2, 2] - f[1, 2] * f[2, 0])
        + f[0, 2] * (f[1, 0] * f[2, 1] - f[1, 1] * f[2, 0])
    )


@kernel(error_model='numpy')
def cell_forces(  # type: ignore[no-untyped-def]
    x0, x1, origin, cells, slopes, volumes, ratio, q, z, ends, pairs, net, matrix, fill
):
    """
    Add the forces of the cells' pressures, and minus their derivatives.

    Parameters
    ----------
    x0, x1, origin, net, matrix, fill
        As in `link_forces`.
    cells : ndarray of int, shape (c, 8)
        Places of the corners.
    slopes : ndarray, shape (s, 3, 8)
        Gradients of the shape functions in the middle of each cell [1/m]; s is c, or 1 where all
        cells are alike.
    volumes : ndarray, shape (s,)
        At rest [m^3].
    ratio : float
        Pressure of a cell over the force of a link that is stretched by the relative change of its
        volume, in metres [1/m^2].
    q : ndarray, shape (NUMBERS,)
        The law over this step.
    z, ends : ndarray, shape (c,) each, or (0,) where not needed
        State of the volumes, as of the links.
    pairs : ndarray of int, shape (28, 3)
        Two corners, and the direction from the first to the second.

    """
    f = np.empty((3, 3))
    g = np.empty((3, 8))
    corner = np.empty(8, dtype=np.int64)
    middle = np.empty((3, 8))
    local = np.arange(8)
    small = origin.shape[1] > 0
    has_series = ends.size > 0
    give = 1.0 / (1.0 + q[CELL] * q[SERIES] * q[SERIES_END])
    for c in range(cells.shape[0]):
        s = c if volumes.size > 1 else 0
        slope = slopes[s]
        for p in range(8):
            i = cells[c, p]
            corner[p] = i
            for a in range(3):
                middle[a, p] = 0.5 * (x0[a, i] + x1[a, i])
        start = _gradient(x0, corner, slope, f)
        end = _gradient(x1, corner, slope, f)
        if small:
            # Of a small change, the determinant is one more than the trace.
            start, end = 1.0, 1.0
            for p in range(8):
                i = corner[p]
                for a in range(3):
                    start += slope[a, p] * (x0[a, i] - origin[a, i])
                    end += slope[a, p] * (x1[a, i] - origin[a, i])
                    middle[a, p] = origin[a, i]
        stretch = q[TAKEN] * (end - start)
        if has_series:
            stretch += q[SERIES] * q[SERIES_END] * ends[c]
        mean = volumes[s] * ratio * (q[K] * z[c] + q[CELL] * stretch) * give * q[PASSED]
        _gradient(middle, local, slope, f)
        for a in range(3):
            b = (a + 1) % 3
            d = (a + 2) % 3
            c0 = f[b, 1] * f[d, 2] - f[b, 2] * f[d, 1]
            c1 = f[b, 2] * f[d, 0] - f[b, 0] * f[d, 2]
            c2 = f[b, 0] * f[d, 1] - f[b, 1] * f[d, 0]
            for p in range(8):
                g[a, p] = c0 * slope[0, p] + c1 * slope[1, p] + c2 * slope[2, p]
                net[a, corner[p]] -= mean * g[a, p]
        if not fill:
            continue
        stiff = ratio * q[CELL] * give * volumes[s] * q[PASSED] * q[TAKEN]
        for p in range(8):
            i = corner[p]
            for a in range(3):
                for b in range(3):
                    matrix[0, 3 * a + b, i] += np.float32(stiff * g[a, p] * g[b, p])
        half = 0.0 if small else 0.5 * mean
        for pair in range(28):
            p = pairs[pair, 0]
            r = pairs[pair, 1]
            k = pairs[pair, 2] + 1
            i = corner[p]
            n0 = slope[1, p] * slope[2, r] - slope[2, p] * slope[1, r]
            n1 = slope[2, p] * slope[0, r] - slope[0, p] * slope[2, r]
            n2 = slope[0, p] * slope[1, r] - slope[1, p] * slope[0, r]
            v0 = half * (f[0, 0] * n0 + f[0, 1] * n1 + f[0, 2] * n2)
            v1 = half * (f[1, 0] * n0 + f[1, 1] * n1 + f[1, 2] * n2)
            v2 = half * (f[2, 0] * n0 + f[2, 1] * n1 + f[2, 2] * n2)
            m = matrix[k]
            s0 = stiff * g[0, p]
            s1 = stiff * g[1, p]
            s2 = stiff * g[2, p]
            m[0, i] += np.float32(s0 * g[0, r])
            m[1, i] += np.float32(s0 * g[1, r] + v2)
            m[2, i] += np.float32(s0 * g[2, r] - v1)
            m[3, i] += np.float32(s1 * g[0, r] - v2)
            m[4, i] += np.float32(s1 * g[1, r])
            m[5, i] += np.float32(s1 * g[2, r] + v0)
            m[6, i] += np.float32(s2 * g[0, r] + v1)
            m[7, i] += np.float32(s2 * g[1, r] - v0)
            m[8, i] += np.float32(s2 * g[2, r])


@kernel(error_model='numpy')
def advance_cells(  # type: ignore[no-untyped-def]
    x0, x1, origin, cells, slopes, volumes, ratio, q, z, ends
):
    """Take the state of the volumes to the end of the step; return what is held there [J]."""
    f = np.empty((3, 3))
    corner = np.empty(8, dtype=np.int64)
    held = 0.0
    has_series = ends.size > 0
    give = 1.0 / (1.0 + q[CELL] * q[SERIES] * q[SERIES_END])
    for c in range(cells.shape[0]):
        s = c if volumes.size > 1 else 0
        for p in range(8):
            corner[p] = cells[c, p]
        stretch = _gradient(x1, corner, slopes[s], f) - _gradient(x0, corner, slopes[s], f)
        if origin.shape[1] > 0:
            stretch = 0.0
            for p in range(8):
                for a in range(3):
                    stretch += slopes[s, a, p] * (x1[a, corner[p]] - x0[a, corner[p]])
        stretch *= q[TAKEN]
        if has_series:
            stretch += q[SERIES] * q[SERIES_END] * ends[c]
        force = (q[K] * z[c] + q[CELL] * stretch) * give
        z[c] += (force - q[K] * z[c]) / q[CELL]
        part = 0.5 * q[K] * z[c] * z[c]
        if has_series:
            ends[c] += q[SERIES_END] * (force - ends[c])
            part += 0.5 * q[SERIES] * ends[c] * ends[c]
        held += part * ratio * volumes[s]
    return held * q[PASSED] / q[TAKEN]
