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
The linear system of a step: conjugate gradients, preconditioned by multigrid on the grid itself.

A matrix joins each node to its 26 neighbours by blocks of three by three, of which the half that
follows a node in the grid's order is kept: ``matrix[0]`` is the node with itself, and
``matrix[1 + d]`` with the neighbour in direction d. All is in single precision, which suffices for
the change of an iteration whose forces are exact. A direction in which a node may not move is
projected out of the matrix; what a vector holds there is without meaning.

References
----------
U. Trottenberg, C. W. Oosterlee and A. Schueller, Multigrid, 2001, ch. 2 and 7; M. Adams, M.
Brezina, J. Hu and R. Tuminaro, J. Comput. Phys. 188, 2003, 593-610,
doi:10.1016/S0021-9991(03)00194-3 (polynomial smoothers).

"""

from dataclasses import dataclass, field
import itertools
from typing import Final

from hapticvision_ros.core.body.lattice import DIRECTIONS
from hapticvision_ros.core.kernels import kernel
import numpy as np
from numpy.typing import NDArray

type SingleArray = NDArray[np.float32]

_COARSEST = 300
"""Unknowns at which a level is solved directly."""
_LOWER = np.float32(0.15)
_UPPER = np.float32(1.1)
"""The smoother's range of eigenvalues, over the largest."""
_SLACK = 1e-5
"""What makes the block of a node invertible that cannot move, over its trace."""
_CHUNK = 1024
_ROUNDED = 0.1
"""What may be left over where rounding stops the iteration, as it does for a body that slides."""


@kernel(error_model='numpy', fastmath=True)
def _multiply(matrix, x, base, sign, y, first, last, offsets):  # type: ignore[no-untyped-def]
    """Set y to base plus sign times matrix times x, all of shape (3, p)."""
    for a in range(3):
        y[a, :] = base[a, :]
    for start in range(first, last, _CHUNK):
        stop = min(start + _CHUNK, last)
        size = stop - start
        x0 = x[0, start:stop]
        x1 = x[1, start:stop]
        x2 = x[2, start:stop]
        for a in range(3):
            out = y[a, start:stop]
            m0 = matrix[0, 3 * a, start:stop]
            m1 = matrix[0, 3 * a + 1, start:stop]
            m2 = matrix[0, 3 * a + 2, start:stop]
            for p in range(size):
                out[p] += sign * (m0[p] * x0[p] + m1[p] * x1[p] + m2[p] * x2[p])
        for k in range(offsets.size):
            off = offsets[k]
            near, end = start + off, stop + off
            far0 = x[0, near:end]
            far1 = x[1, near:end]
            far2 = x[2, near:end]
            for a in range(3):
                out = y[a, start:stop]
                m0 = matrix[k + 1, 3 * a, start:stop]
                m1 = matrix[k + 1, 3 * a + 1, start:stop]
                m2 = matrix[k + 1, 3 * a + 2, start:stop]
                for p in range(size):
                    out[p] += sign * (m0[p] * far0[p] + m1[p] * far1[p] + m2[p] * far2[p])
            for a in range(3):
                out = y[a, near:end]
                m0 = matrix[k + 1, a, start:stop]
                m1 = matrix[k + 1, a + 3, start:stop]
                m2 = matrix[k + 1, a + 6, start:stop]
                for p in range(size):
                    out[p] += sign * (m0[p] * x0[p] + m1[p] * x1[p] + m2[p] * x2[p])


@kernel(error_model='numpy', fastmath=True)
def _blocks(inverse, r, x, keep, first, last, scale):  # type: ignore[no-untyped-def]
    """Set x to keep times itself plus scale times the blocks' inverses times r."""
    for start in range(first, last, _CHUNK):
        stop = min(start + _CHUNK, last)
        r0 = r[0, start:stop]
        r1 = r[1, start:stop]
        r2 = r[2, start:stop]
        for a in range(3):
            out = x[a, start:stop]
            m0 = inverse[3 * a, start:stop]
            m1 = inverse[3 * a + 1, start:stop]
            m2 = inverse[3 * a + 2, start:stop]
            for p in range(stop - start):
                out[p] = keep * out[p] + scale * (m0[p] * r0[p] + m1[p] * r1[p] + m2[p] * r2[p])


@kernel(error_model='numpy')
def _invert(matrix, inverse, first, last):  # type: ignore[no-untyped-def]
    """Set out the inverses of the nodes' own blocks."""
    for i in range(first, last):
        trace = matrix[0, 0, i] + matrix[0, 4, i] + matrix[0, 8, i]
        if not trace > 0.0:
            for k in range(9):
                inverse[k, i] = np.float32(0.0)
            continue
        slack = _SLACK * trace
        a = matrix[0, 0, i] + slack
        b = 0.5 * (matrix[0, 1, i] + matrix[0, 3, i])
        c = 0.5 * (matrix[0, 2, i] + matrix[0, 6, i])
        d = matrix[0, 4, i] + slack
        e = 0.5 * (matrix[0, 5, i] + matrix[0, 7, i])
        f = matrix[0, 8, i] + slack
        ca = d * f - e * e
        cb = c * e - b * f
        cc = b * e - c * d
        per = 1.0 / (a * ca + b * cb + c * cc)
        inverse[0, i] = np.float32(per * ca)
        inverse[1, i] = np.float32(per * cb)
        inverse[2, i] = np.float32(per * cc)
        inverse[3, i] = np.float32(per * cb)
        inverse[4, i] = np.float32(per * (a * f - c * c))
        inverse[5, i] = np.float32(per * (b * c - a * e))
        inverse[6, i] = np.float32(per * cc)
        inverse[7, i] = np.float32(per * (b * c - a * e))
        inverse[8, i] = np.float32(per * (a * d - b * b))


def _shares(axis: int) -> tuple[NDArray[np.intp], SingleArray]:
    """
    Return where the blocks of a matrix go when a grid is halved along one axis (Galerkin).

    Returns
    -------
    ndarray of int, shape (m, 8)
        Direction; parity of the node's place along the axis; half of that place to which it goes,
        beside the half of the even place; direction there; whether the block goes there, whether
        its transpose does; how far aside of the node along the other two axes.
    ndarray of float32, shape (m,)
        Weights of linear interpolation.

    """
    names = {tuple(d): k for k, d in enumerate([(0, 0, 0), *DIRECTIONS.tolist()])}
    others = [one for one in range(3) if one != axis]
    rows, weights = [], []
    for d, k in names.items():
        for parity in (0, 1):
            ends = [
                [(at // 2, 1.0)] if at % 2 == 0 else [(at // 2, 0.5), (at // 2 + 1, 0.5)]
                for at in (parity, parity + d[axis])
            ]
            for (one, by_one), (two, by_two) in itertools.product(*ends):
                there = list(d)
                there[axis] = two - one
                to = names.get(tuple(there))
                if to == 0:
                    # Both ends at one node: the mirror image of a block of two falls there too.
                    row = (k, parity, one, 0, 1, min(k, 1), 0, 0)
                elif to is not None:
                    row = (k, parity, one, to, 1, 0, 0, 0)
                elif k > 0:
                    mirrored = names[tuple(-one for one in there)]
                    row = (k, parity, two, mirrored, 0, 1, d[others[0]], d[others[1]])
                else:
                    continue
                rows.append(row)
                weights.append(by_one * by_two)
    return np.array(rows, dtype=np.intp), np.array(weights, dtype=np.float32)


@kernel(error_model='numpy', fastmath=True)
def _halve(  # type: ignore[no-untyped-def]
    fine, coarse, rows, weights, counts, inner, first, coarse_first, aside
):
    """Set out the matrix of a grid that is halved along one axis, with `inner` nodes below it."""
    outer, n, m = counts
    coarse[:] = np.float32(0.0)
    for row in range(rows.shape[0]):
        k, parity, at, to, straight, turned, by_one, by_two = rows[row]
        w = weights[row]
        shift = by_one * aside[0] + by_two * aside[1]
        places = (n - parity + 1) // 2
        for a in range(3):
            for b in range(3):
                source = fine[k, 3 * a + b]
                for o in range(outer):
                    for t in range(places):
                        start = first + (o * n + 2 * t + parity) * inner
                        goal = coarse_first + (o * m + t + at) * inner + shift
                        if straight:
                            out = coarse[to, 3 * a + b]
                            for p in range(inner):
                                out[goal + p] += w * source[start + p]
                        if turned:
                            out = coarse[to, 3 * b + a]
                            for p in range(inner):
                                out[goal + p] += w * source[start + p]


@kernel(error_model='numpy', fastmath=True)
def _restrict(  # type: ignore[no-untyped-def]
    fine, coarse, shape, coarse_shape, first, coarse_first
):
    """Set the coarse vector to the transpose of the interpolation of the fine one."""
    nx, ny, nz = shape
    cx, cy, cz = coarse_shape
    half = np.float32(0.5)
    one = np.float32(1.0)
    for a in range(3):
        coarse[a, :] = np.float32(0.0)
        for kz in range(cz):
            for dz in range(-1, 2):
                z = 2 * kz + dz
                if not 0 <= z < nz:
                    continue
                wz = half if dz else one
                for ky in range(cy):
                    row = coarse_first + cx * (ky + cy * kz)
                    for dy in range(-1, 2):
                        y = 2 * ky + dy
                        if not 0 <= y < ny:
                            continue
                        w = wz * half if dy else wz
                        start = first + nx * (y + ny * z)
                        for kx in range(cx):
                            x = 2 * kx
                            total = np.float32(0.0)
                            if x < nx:
                                total += fine[a, start + x]
                            if x + 1 < nx:
                                total += half * fine[a, start + x + 1]
                            if x > 0:
                                total += half * fine[a, start + x - 1]
                            coarse[a, row + kx] += w * total


@kernel(error_model='numpy', fastmath=True)
def _prolong(  # type: ignore[no-untyped-def]
    coarse, fine, shape, coarse_shape, first, coarse_first
):
    """Add the trilinear field of the coarse vector to the fine one."""
    nx, ny, nz = shape
    cx, cy, _ = coarse_shape
    half = np.float32(0.5)
    line = np.empty(cx, dtype=np.float32)
    for a in range(3):
        for z in range(nz):
            for y in range(ny):
                line[:] = np.float32(0.0)
                w = np.float32(1.0)
                if y % 2:
                    w *= half
                if z % 2:
                    w *= half
                for kz in range(z // 2, (z + 1) // 2 + 1):
                    for ky in range(y // 2, (y + 1) // 2 + 1):
                        row = coarse_first + cx * (ky + cy * kz)
                        for kx in range(cx):
                            line[kx] += w * coarse[a, row + kx]
                start = first + nx * (y + ny * z)
                for x in range(nx):
                    value = line[x // 2]
                    if x % 2:
                        value = half * (value + line[x // 2 + 1])
                    fine[a, start + x] += value


@kernel(error_model='numpy', fastmath=True)
def _dot(x, y, first, last):  # type: ignore[no-untyped-def]
    total = 0.0
    for a in range(3):
        u = x[a, first:last]
        v = y[a, first:last]
        for p in range(last - first):
            total += np.float64(u[p]) * np.float64(v[p])
    return total


@kernel(error_model='numpy', fastmath=True)
def _combine(x, scale, y, keep, first, last):  # type: ignore[no-untyped-def]
    """Set x to keep times x plus scale times y."""
    for a in range(3):
        u = x[a, first:last]
        v = y[a, first:last]
        for p in range(last - first):
            u[p] = keep * u[p] + scale * v[p]


@kernel(error_model='numpy')
def project(matrix, node, fixed, first, offsets):  # type: ignore[no-untyped-def]
    """
    Take directions out of the matrix.

    Parameters
    ----------
    matrix : ndarray of float32, shape (14, 9, p)
        Becomes P matrix P.
    node : ndarray of int, shape (m,)
        Places of the nodes.
    fixed : ndarray of float32, shape (m, 3, 3)
        The projection P of each, onto where it may move.

    """
    old = np.empty((3, 3), dtype=np.float32)
    for m in range(node.size):
        i = node[m]
        keep = fixed[m]
        for k in range(14):
            for a in range(3):
                for b in range(3):
                    old[a, b] = matrix[k, 3 * a + b, i]
            for a in range(3):
                for b in range(3):
                    total = np.float32(0.0)
                    for c in range(3):
                        total += keep[a, c] * old[c, b]
                    matrix[k, 3 * a + b, i] = total
        for k in range(14):
            p = i if k == 0 else i - offsets[k - 1]
            for a in range(3):
                for b in range(3):
                    old[a, b] = matrix[k, 3 * a + b, p]
            for a in range(3):
                for b in range(3):
                    total = np.float32(0.0)
                    for c in range(3):
                        total += old[a, c] * keep[c, b]
                    matrix[k, 3 * a + b, p] = total


_SHARES: Final = tuple(_shares(axis) for axis in range(3))


@dataclass(eq=False)
class Level:
    """
    A grid, its matrix and what its cycles need.

    Parameters
    ----------
    shape : tuple of int, length 3
        Nodes along x, y and z.

    """

    shape: tuple[int, int, int]
    margin: int = field(init=False)
    size: int = field(init=False)
    offsets: NDArray[np.intp] = field(init=False)
    matrix: SingleArray = field(init=False)
    inverse: SingleArray = field(init=False)
    b: SingleArray = field(init=False)
    x: SingleArray = field(init=False)
    r: SingleArray = field(init=False)
    d: SingleArray = field(init=False)
    w: SingleArray = field(init=False)
    zero: SingleArray = field(init=False)
    between: list[SingleArray] = field(default_factory=list)
    largest: float = field(default=2.0)

    def __post_init__(self) -> None:
        nx, ny, nz = self.shape
        self.margin = nx * ny + nx + 1
        self.size = nx * ny * nz
        self.offsets = (DIRECTIONS * (1, nx, nx * ny)).sum(axis=1)
        length = self.size + 2 * self.margin
        self.matrix = np.zeros((14, 9, length), dtype=np.float32)
        self.inverse = np.zeros((9, length), dtype=np.float32)
        self.b, self.x, self.r, self.d, self.w, self.zero = (
            np.zeros((3, length), dtype=np.float32) for _ in range(6)
        )
        # A start for the largest eigenvalue that holds something of every mode.
        rng = np.random.default_rng(1)
        self.w[:, self.span] = rng.standard_normal((3, self.size)).astype(np.float32)

    @property
    def span(self) -> slice:
        """Return the places between the margins."""
        return slice(self.margin, self.margin + self.size)

    @property
    def ends(self) -> tuple[int, int]:
        """Return where the margins end and begin."""
        return self.margin, self.margin + self.size

    def halve(self, fine: 'Level') -> None:
        """Set the matrix to that of a finer grid between trilinear fields, axis by axis."""
        shape = fine.shape
        matrix, first = fine.matrix, fine.margin
        # The longest rows first: those of whole planes.
        for step, axis in enumerate((2, 1, 0)):
            sides = list(shape)
            sides[axis] = self.shape[axis]
            nx, ny, nz = sides
            margin = nx * ny + nx + 1
            if axis == 0:
                halved = self.matrix
            elif len(self.between) > step:
                halved = self.between[step]
            else:
                halved = np.zeros((14, 9, nx * ny * nz + 2 * margin), dtype=np.float32)
                self.between.append(halved)
            strides = np.array([1, nx, nx * ny])
            inner = int(strides[axis])
            outer = nx * ny * nz // (inner * sides[axis])
            rows, weights = _SHARES[axis]
            aside = np.delete(strides, axis)
            counts = (outer, shape[axis], sides[axis])
            _halve(matrix, halved, rows, weights, counts, inner, first, margin, aside)
            shape, matrix, first = (nx, ny, nz), halved, margin

    def multiply(self, x: SingleArray, y: SingleArray) -> None:
        """Set y to the matrix times x."""
        _multiply(self.matrix, x, self.zero, np.float32(1.0), y, *self.ends, self.offsets)

    def residual(self) -> None:
        """Set r to b minus the matrix times x."""
        _multiply(self.matrix, self.x, self.b, np.float32(-1.0), self.r, *self.ends, self.offsets)

    def prepare(self, iterations: int) -> None:
        """Invert the blocks and find the largest eigenvalue of inverse times matrix."""
        first, last = self.ends
        _invert(self.matrix, self.inverse, first, last)
        v, r = self.w, self.r
        largest = 0.0
        for _ in range(iterations):
            self.multiply(v, r)
            _blocks(self.inverse, r, v, np.float32(0.0), first, last, np.float32(1.0))
            largest = float(np.abs(v[:, self.span]).max())
            if not 0.0 < largest < np.inf:
                v[:, self.span] = 1.0
                return
            v *= np.float32(1.0 / largest)
        self.largest = largest

    def smooth(self, degree: int, *, blank: bool) -> None:
        """Improve x by a Chebyshev polynomial; `blank` where x is zero so far."""
        first, last = self.ends
        low, high = _LOWER * self.largest, _UPPER * self.largest
        middle, half = 0.5 * (high + low), 0.5 * (high - low)
        sigma = middle / half
        rho = 1.0 / sigma
        one, nil = np.float32(1.0), np.float32(0.0)
        if blank:
            _blocks(self.inverse, self.b, self.d, nil, first, last, np.float32(1.0 / middle))
            self.x[:] = self.d
        else:
            self.residual()
            _blocks(self.inverse, self.r, self.d, nil, first, last, np.float32(1.0 / middle))
            _combine(self.x, one, self.d, one, first, last)
        for _ in range(degree - 1):
            after = 1.0 / (2.0 * sigma - rho)
            self.residual()
            _blocks(
                self.inverse,
                self.r,
                self.d,
                np.float32(after * rho),
                first,
                last,
                np.float32(2.0 * after / half),
            )
            _combine(self.x, one, self.d, one, first, last)
            rho = after


class Multigrid:
    """
    Solves with the matrix of its finest level.

    Parameters
    ----------
    shape : tuple of int, length 3
        Nodes of the grid along x, y and z.
    degree : int
        Of the smoother's polynomial.

    """

    def __init__(self, shape: tuple[int, int, int], degree: int = 2) -> None:
        self.levels = [Level(shape)]
        self._degree = degree
        while 3 * self.levels[-1].size > _COARSEST:
            nx, ny, nz = self.levels[-1].shape
            self.levels.append(Level((nx // 2 + 1, ny // 2 + 1, nz // 2 + 1)))
        self._direct: SingleArray = np.zeros((0, 0), dtype=np.float32)
        self._fresh = True

    @property
    def matrix(self) -> SingleArray:
        """Return the matrix to be filled, shape (14, 9, p)."""
        return self.levels[0].matrix

    def prepare(self) -> None:
        """Build the coarse levels for the matrix as it is."""
        iterations = 12 if self._fresh else 3
        self._fresh = False
        for fine, coarse in zip(self.levels, self.levels[1:], strict=False):
            fine.prepare(iterations)
            coarse.halve(fine)
        last = self.levels[-1]
        dense = np.zeros((3 * last.size, 3 * last.size))
        index = np.arange(last.size)
        for k in range(14):
            off = 0 if k == 0 else int(last.offsets[k - 1])
            near = index[(index + off >= 0) & (index + off < last.size)]
            for a in range(3):
                for b in range(3):
                    value = last.matrix[k, 3 * a + b, last.margin + near]
                    dense[3 * near + a, 3 * (near + off) + b] += value
                    if k > 0:
                        dense[3 * (near + off) + b, 3 * near + a] += value
        diagonal = np.diag(dense).copy()
        dense[np.diag_indices_from(dense)] += _SLACK * max(float(diagonal.mean()), 1e-300)
        self._direct = np.linalg.inv(dense).astype(np.float32)

    def _cycle(self, depth: int) -> None:
        level = self.levels[depth]
        if depth == len(self.levels) - 1:
            solved = self._direct @ level.b[:, level.span].T.ravel()
            level.x[:, level.span] = solved.reshape(-1, 3).T
            return
        below = self.levels[depth + 1]
        level.smooth(self._degree, blank=True)
        level.residual()
        _restrict(level.r, below.b, level.shape, below.shape, level.margin, below.margin)
        self._cycle(depth + 1)
        _prolong(below.x, level.x, level.shape, below.shape, level.margin, below.margin)
        level.smooth(self._degree, blank=False)

    def solve(
        self, b: SingleArray, tolerance: float, most: int = 200
    ) -> tuple[SingleArray, bool, int]:
        """
        Return x of matrix x = b.

        Parameters
        ----------
        b : ndarray of float32, shape (3, p)
            Right-hand side.
        tolerance : float
            What may be left of it, relative.
        most : int
            Iterations.

        Returns
        -------
        x : ndarray of float32, shape (3, p)
        sound : bool
            Whether x is as good as asked for, or as single precision allows; not so where the
            matrix turned out not to be positive definite.
        iterations : int
            How many were taken.

        """
        level = self.levels[0]
        first, last = level.ends
        one = np.float32(1.0)
        x = np.zeros_like(b)
        r = b.copy()
        p, ap = np.zeros_like(b), np.zeros_like(b)
        whole = float(np.sqrt(_dot(b, b, first, last)))
        old = 0.0
        for done in range(most):
            left = float(np.sqrt(_dot(r, r, first, last)))
            if left <= tolerance * whole:
                return x, True, done
            level.b[:] = r
            self._cycle(0)
            new = _dot(r, level.x, first, last)
            if not new > 0.0:
                return x, left <= _ROUNDED * whole, done
            _combine(p, one, level.x, np.float32(new / old if done else 0.0), first, last)
            old = new
            level.multiply(p, ap)
            curvature = _dot(p, ap, first, last)
            if not curvature > 0.0:
                return x, left <= _ROUNDED * whole, done
            length = np.float32(new / curvature)
            _combine(x, length, p, one, first, last)
            _combine(r, -length, ap, one, first, last)
        return x, left <= _ROUNDED * whole, most
