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

"""The top view of what stands on the support plane: a grid, and the objects in it."""

from dataclasses import dataclass

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, PointArray
from hapticvision_ros.core.scene.settings import PlanningSettings
import numpy as np
from numpy.typing import NDArray

_MOST_CELLS = 25_000_000


@dataclass(frozen=True, slots=True, eq=False)
class TopView:
    """
    The objects in the top view, largest first.

    Parameters
    ----------
    object_of_point : ndarray of int, shape (n,)
        Which object each point belongs to; -1 for none.
    areas : tuple of float
        Each object's area [m^2].
    centres : tuple of tuple of float
        Each object's mass centre in the top view [m].

    """

    object_of_point: NDArray[np.intp]
    areas: tuple[float, ...]
    centres: tuple[tuple[float, float], ...]


def find_objects(points: PointArray | FloatArray, settings: PlanningSettings) -> TopView:
    """
    Find the objects on the support plane.

    Parameters
    ----------
    points : ndarray, shape (n, 3)
        Points above the support plane, in its frame [m].
    settings : PlanningSettings
        Cells, closing and least area.

    Returns
    -------
    TopView
        At least one object.

    Raises
    ------
    InputError
        If there is none, or the points spread too far.

    """
    import cv2

    nothing = (
        f'Nothing larger than {settings.least_area * 1e4:.3g} cm^2 stands out of the support '
        'plane: put an object under the tool.'
    )
    if not len(points):
        raise InputError(nothing)
    # Half a cell more, so that the rounding is alike at both ends and the centre unbiased.
    low = points[:, :2].min(axis=0) - settings.cell_size * (settings.closing_cells + 0.5)
    cells = ((points[:, :2] - low) / settings.cell_size).astype(np.intp)
    columns, rows = cells.max(axis=0) + 1 + settings.closing_cells
    if columns * rows > _MOST_CELLS:
        raise InputError(
            'The points above the support plane spread over '
            f'{columns * settings.cell_size:.3g} m x {rows * settings.cell_size:.3g} m: '
            'limit the range sensor to the cell.'
        )
    grid = np.zeros((rows, columns), dtype=np.uint8)
    grid[cells[:, 1], cells[:, 0]] = 1
    kernel = np.ones((settings.closing_cells, settings.closing_cells), dtype=np.uint8)
    closed = cv2.morphologyEx(grid, cv2.MORPH_CLOSE, kernel)
    _, labels, statistics, centroids = cv2.connectedComponentsWithStats(closed)
    areas = statistics[1:, cv2.CC_STAT_AREA] * settings.cell_size**2
    large = np.flatnonzero(areas >= settings.least_area)
    large = large[np.argsort(-areas[large], kind='stable')]
    if not large.size:
        raise InputError(nothing)
    number = np.full(len(areas) + 1, -1, dtype=np.intp)
    number[large + 1] = np.arange(large.size)
    centres = low + (centroids[large + 1] + 0.5) * settings.cell_size
    return TopView(
        number[labels[cells[:, 1], cells[:, 0]]],
        tuple(float(area) for area in areas[large]),
        tuple((float(x), float(y)) for x, y in centres),
    )


def refuse_several(view: TopView) -> None:
    """Raise an InputError if there is more than one object."""
    if len(view.areas) > 1:
        raise InputError(
            f'There are {len(view.areas)} objects on the support plane, of '
            f'{", ".join(f"{area * 1e4:.3g}" for area in view.areas)} cm^2: leave one.'
        )
