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

"""A trial's shape: pictures of cloud and surface side by side, an animation, and a page."""

from base64 import b64encode
from collections.abc import Iterator, Mapping, Sequence
import math
from typing import Final

from hapticvision_ros.core.records import Estimate, FloatArray
from hapticvision_ros.core.scene.surface import make_surface
from hapticvision_ros.core.surface.cloud import Seen
from hapticvision_ros.core.surface.compare import Comparison
from hapticvision_ros.core.surface.document import PAIRS
from hapticvision_ros.core.surface.mesh import ColourArray, Mesh, ply, vtk
from hapticvision_ros.core.surface.raster import ParallelView
from hapticvision_ros.core.surface.study import ShapeStudy
from hapticvision_ros.report.cells import Cell, cell
from hapticvision_ros.report.quantities import format_number, Unit
from hapticvision_ros.report.shape_gif import gif
from hapticvision_ros.report.shape_picture import (
    below,
    beside,
    captioned,
    colour_bar,
    coloured,
    draw,
    draw_with_tool,
    palette,
    png,
    ramp,
    Shape,
    tool_mesh,
)
import numpy as np

_WIDTH: Final = 400
_HEIGHT: Final = 300
_AZIMUTH: Final = 0.5
_ELEVATION: Final = 0.6
_ABOVE_TOOL: Final = 0.025
"""How much of the tool is shown above the object [m]."""
_LARGEST_SHARE: Final = 98.0
"""Percentile of the errors at which the colours end."""
_MM: Final = Unit('mm', 1e-3)
_UNITS: Final = {'m': _MM, 'm3': Unit('cm³', 1e-6)}
_SECONDS_A_PICTURE: Final = 0.1


def files(study: ShapeStudy) -> Iterator[tuple[str, bytes]]:
    """
    Yield the pictures, meshes and clouds of a trial's shape, by the names of their files.

    Parameters
    ----------
    study : ShapeStudy
        What was found.

    Yields
    ------
    tuple of (str, bytes)
        Name and content.

    """
    yield 'comparison.png', png(comparison_picture(study))
    yield 'animation.gif', animation(study)
    limit = _limit(study)
    rest = study.rest
    yield 'surface_before.ply', ply(rest.points, rest.triangles, comment='m, support plane z = 0')
    pairs = zip(study.observed.after, study.surfaces, study.comparisons, strict=True)
    for number, (seen, surface, compared) in enumerate(pairs, 1):
        moved = surface.points - rest.points
        error = _at_corners(surface, seen, compared)
        yield (
            f'surface_{number}.ply',
            ply(surface.points, surface.triangles, comment=f'm, {seen.t:.3f} s'),
        )
        quantities: dict[str, FloatArray] = {'displacement': moved, 'error': error}
        yield (
            f'surface_{number}.vtk',
            vtk(surface.points, surface.triangles, quantities, title=f'm, {seen.t:.3f} s'),
        )
        yield (
            f'cloud_{number}.ply',
            ply(
                seen.points,
                colours=ramp(compared.distance, -limit, limit, 'error'),
                quantities={'distance': compared.distance},
                comment=f'm, {seen.t:.3f} s; distance from the surface, outside positive',
            ),
        )


def _at_corners(surface: Mesh, seen: Seen, compared: Comparison) -> FloatArray:
    """Return the mean distance of the returns nearest to each corner; NaN without any."""
    from scipy.spatial import cKDTree

    near = cKDTree(surface.points).query(seen.points)[1]
    count = np.bincount(near, minlength=len(surface.points))
    with np.errstate(invalid='ignore'):
        mean = np.bincount(near, compared.distance, minlength=len(surface.points)) / count
    return np.asarray(mean, dtype=np.float64)


def _limit(study: ShapeStudy) -> float:
    """Return the error at which the colours end [m]."""
    sizes = np.concatenate([np.abs(one.distance) for one in study.comparisons])
    return max(float(np.percentile(sizes, _LARGEST_SHARE)), 1e-5)


def comparison_picture(study: ShapeStudy) -> ColourArray:
    """
    Return measured cloud, simulated surface and error side by side, as in the paper's Fig. 12.

    Parameters
    ----------
    study : ShapeStudy
        What was found.

    Returns
    -------
    ndarray of uint8, shape (height, width, 3)
        A row for before the push, one for the first and one for the last look after it.

    """
    last = len(study.surfaces) - 1
    chosen = [0, last] if last else [0]
    rows = [(study.observed.before, study.rest, study.at_rest)]
    rows += [(study.observed.after[k], study.surfaces[k], study.comparisons[k]) for k in chosen]
    names = ['before the push']
    released = study.phases.t_release or 0.0
    names += [f'{study.observed.after[k].t - released:.1f} s after the release' for k in chosen]
    everything = np.concatenate([study.rest.points, study.observed.before.points])
    view = ParallelView.around(
        everything, azimuth=_AZIMUTH, elevation=_ELEVATION, width=_WIDTH, height=_HEIGHT
    )
    top = float(study.rest.points[:, 2].max())
    low = min(0.5 * top, *(float(_dent_floor(one)) for one in study.surfaces))
    limit = _limit(study)
    strips = []
    for name, (seen, surface, compared) in zip(names, rows, strict=True):
        voxel = max(2.0 * seen.spacing, 1e-3)
        smooth = make_surface(seen.points, voxel=voxel)
        dot = math.ceil(1.5 * voxel * view.scale)
        cloud = draw(
            Shape(smooth.points, smooth.normals, smooth.points[:, 2]), view, low, top, dot=dot
        )
        mesh = draw(Shape.of_mesh(surface, surface.points[:, 2]), view, low, top)
        # No shade: what counts is the colour.
        normals = np.broadcast_to(view.toward, seen.points.shape)
        dot = math.ceil(1.4 * seen.spacing * view.scale)
        error = draw(Shape(seen.points, normals, compared.distance), view, -limit, limit, dot=dot)
        told = (
            f'measured - simulated: rms {1e3 * compared.rms:.2f} mm, noise '
            f'{1e3 * compared.noise:.2f} mm'
        )
        strips.append(
            beside(
                [
                    coloured(captioned(cloud, f'measured, {name}'), 'height'),
                    coloured(captioned(mesh, f'simulated, {name}'), 'height'),
                    coloured(captioned(error, told), 'error'),
                ]
            )
        )
    bar = colour_bar(2 * _WIDTH, low, top, 'mm height', factor=1e3)
    other = colour_bar(_WIDTH, -limit, limit, 'mm', factor=1e3, open_ended=True)
    strips.append(beside([coloured(bar, 'height'), coloured(other, 'error')]))
    return below(strips)


def _dent_floor(surface: Mesh) -> float:
    """Return the lowest height of what looks up [m]."""
    upper = surface.centres[surface.normals[:, 2] > 0.5]
    return float(upper[:, 2].min()) if len(upper) else 0.0


def animation(study: ShapeStudy) -> bytes:
    """Return the push, the hold, the release and the recovery as a GIF file."""
    radius = study.settings.cloud.tool_radius
    top = float(study.rest.points[:, 2].max())
    high = np.array([[0.0, 0.0, top + _ABOVE_TOOL]])
    view = ParallelView.around(
        np.concatenate([study.rest.points, high]),
        azimuth=_AZIMUTH,
        elevation=_ELEVATION,
        width=_WIDTH,
        height=_HEIGHT,
    )
    run = study.calibration.run
    deepest = max(float(run.height.max()), 1e-4)
    pictures = []
    for t, surface in study.shots:
        tip = float(np.interp(t, run.t, run.tool))
        lost = study.rest.points[:, 2] - surface.points[:, 2]
        picture = draw_with_tool(
            Shape.of_mesh(surface, lost),
            tool_mesh(
                radius, tip, max(top + _ABOVE_TOOL - tip, 1e-3), sphere=study.settings.sphere
            ),
            view,
            0.0,
            deepest,
        )
        told = f'{t - (study.phases.t_contact or 0.0):.2f} s, {_phase(study, t)}'
        bar = colour_bar(_WIDTH, 0.0, deepest, 'mm lower', factor=1e3)
        pictures.append(np.concatenate((captioned(picture, told), bar)))
    return gif(pictures, palette('depth'), _SECONDS_A_PICTURE)


def _phase(study: ShapeStudy, t: float) -> str:
    phases = study.phases
    for end, name in (
        (phases.t_hold, 'push'),
        (phases.t_release, 'hold'),
        (phases.t_loss, 'release'),
    ):
        if end is not None and t < end:
            return name
    return 'recovery'


def render_shape(
    study: ShapeStudy,
    *,
    result: str,
    bag: str,
    warnings: Sequence[str],
    made: Mapping[str, bytes],
) -> str:
    """
    Return the page of a trial's shape, with its pictures inside.

    Parameters
    ----------
    study : ShapeStudy
        What was found.
    result, bag : str
        The files, as they were named.
    warnings : sequence of str
        What to know of it.
    made : mapping of str to bytes
        The files of `files`, by name.

    Returns
    -------
    str
        An HTML page that needs nothing else.

    """
    from hapticvision_ros.report.templating import template_environment

    environment = template_environment()
    released = study.phases.t_release or 0.0
    section = environment.get_template('shape.html.j2').render(
        result=result,
        bag=bag,
        model=study.model.name,
        nodes=len(study.calibration.run.lattice.points),
        pitch=format_number(1e3 * study.calibration.run.lattice.pitch, digits=3),
        force_misfit=f'{100.0 * study.calibration.force_misfit:.2g}',
        height_misfit=f'{100.0 * study.calibration.height_misfit:.2g}',
        comparison=_embedded('image/png', made['comparison.png']),
        animation=_embedded('image/gif', made['animation.gif']),
        pairs=[
            (
                what,
                *_cells(
                    getattr(study.deformation, name).measured,
                    getattr(study.deformation, name).simulated,
                    _UNITS[unit],
                ),
            )
            for name, unit, what in PAIRS
        ],
        looks=[('before the push', None, study.at_rest, _distances(study.at_rest))]
        + [
            (
                f'{seen.t - released:.2f} s after the release',
                _cells(h.measured, h.simulated, _MM),
                one,
                _distances(one),
            )
            for seen, h, one in zip(
                study.observed.after, study.deformation.heights, study.comparisons, strict=True
            )
        ],
        warnings=warnings,
    )
    style = environment.get_template('style.css').render()
    page = environment.get_template('page.html.j2')
    return page.render(title='Shape: simulated and seen', style=style, sections=[section]) + '\n'


def _embedded(kind: str, data: bytes) -> str:
    return f'data:{kind};base64,{b64encode(data).decode()}'


def _cells(measured: Estimate, simulated: Estimate, unit: Unit) -> tuple[Cell, Cell]:
    known = Estimate(simulated.value, None, simulated.reason)
    other = cell(known, unit)
    if known.value is not None:
        other = Cell(other.text, True)
    return cell(measured, unit), other


def _distances(one: Comparison) -> list[str]:
    """Return the columns of the table of distances [mm]."""
    values = (one.rms, one.noise, one.beyond_noise, one.percentile_95, one.largest, one.hausdorff)
    return ['-' if value is None else f'{1e3 * value:.2f}' for value in values]
