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

"""Triangles before the range sensor: the depth at which each pixel meets them."""

import math

from hapticvision_ros.core.kernels import kernel


@kernel(error_model='numpy')
def cast(seen, place, triangles, focal, depth):  # type: ignore[no-untyped-def]
    """
    Lower the depths of pixels to those of triangles before them.

    Parameters
    ----------
    seen : ndarray, shape (n, 3)
        Nodes along the sensor's axes [m].
    place : ndarray, shape (n, 2)
        Column and row where each is seen, 0 in the middle of the first pixel.
    triangles : ndarray of int, shape (m, 3)
        Their nodes.
    focal : float
        [pixels]
    depth : ndarray of float32, shape (height, width)
        Along the optical axis [m]; NaN where there is nothing.

    """
    height, width = depth.shape
    for m in range(triangles.shape[0]):
        a, b, c = triangles[m, 0], triangles[m, 1], triangles[m, 2]
        ax, ay, bx, by, cx, cy = (
            place[a, 0],
            place[a, 1],
            place[b, 0],
            place[b, 1],
            place[c, 0],
            place[c, 1],
        )
        twice = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
        if twice == 0.0:
            continue
        e0, e1, e2 = (
            seen[b, 0] - seen[a, 0],
            seen[b, 1] - seen[a, 1],
            seen[b, 2] - seen[a, 2],
        )
        f0, f1, f2 = (
            seen[c, 0] - seen[a, 0],
            seen[c, 1] - seen[a, 1],
            seen[c, 2] - seen[a, 2],
        )
        n0 = e1 * f2 - e2 * f1
        n1 = e2 * f0 - e0 * f2
        n2 = e0 * f1 - e1 * f0
        level = n0 * seen[a, 0] + n1 * seen[a, 1] + n2 * seen[a, 2]
        first = max(0, math.ceil(min(ax, bx, cx)))
        last = min(width - 1, math.floor(max(ax, bx, cx)))
        for row in range(
            max(0, math.ceil(min(ay, by, cy))), min(height - 1, math.floor(max(ay, by, cy))) + 1
        ):
            for column in range(first, last + 1):
                # Weights of the corners, of one sign inside.
                wa = ((bx - column) * (cy - row) - (by - row) * (cx - column)) / twice
                wb = ((cx - column) * (ay - row) - (cy - row) * (ax - column)) / twice
                if wa < -1e-9 or wb < -1e-9 or wa + wb > 1.0 + 1e-9:
                    continue
                across = n0 * (column - 0.5 * (width - 1)) / focal
                across += n1 * (row - 0.5 * (height - 1)) / focal + n2
                here = level / across
                if not depth[row, column] <= here:
                    depth[row, column] = here
