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
One trial's shape: the object simulated with what was identified, beside what the sensor saw.

The body stands where the cloud before the push shows it, the tool moves as it was recorded, and
the surfaces are those of the times at which the free object was seen. Nothing is fitted to the
shape.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import math
from typing import Final

from hapticvision_ros.core.body.calibration import calibrate, Calibration, carried, WELL
from hapticvision_ros.core.body.lattice import box, from_heights, Lattice
from hapticvision_ros.core.body.links import LinkLaw
from hapticvision_ros.core.body.push import Surroundings, Tool, ToolMotion
from hapticvision_ros.core.body.simulation import Pressed
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.fit.release import pressed_in
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Trial
from hapticvision_ros.core.surface.cloud import CloudSettings, Observation, observe
from hapticvision_ros.core.surface.compare import compare, Comparison, seen_triangles
from hapticvision_ros.core.surface.deformation import Deformation, levels, measure
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
import numpy as np

type Progress = Callable[[str], None]

_KNOTS: Final = (12, 4, 12, 24)
"""Times at which the tool's motion is taken in push, hold, release and recovery."""
_USUAL_PITCH: Final = 0.005
"""[m]"""
_SPAN: Final = 0.2
"""How far a cell may be from the usual one for a block to be made of whole ones [-]."""
_COARSE: Final = 0.02
"""A block that is off by more than this share in its cells is worth a warning."""
_OTHER_SIZE: Final = 0.1
"""So is one that is seen to be off by more than this share, and by `_CELLS_OFF` of the map."""
_CELLS_OFF: Final = 2.0
_OTHER_RADIUS: Final = 0.05
"""So is a tool that is seen to be of another radius by more than this share, and by `_SURE`."""
_SURE: Final = 4.0
"""Standard errors."""
_OF_FACE: Final = 0.25
"""A dent is as deep as the deepest cells of this share of the tool's face."""
_CLEAR: Final = 8.0
"""A dent is one from so many standard errors of a cell on."""
_ASIDE: Final = 0.6
"""A dent this far from the axis, in radii, and by `_CELLS_OFF` of the map, is beside it."""
_TOP_SHARE: Final = 95.0
"""Percentile of the seen heights that is the height of a block."""
_PLACINGS: Final = 5
_UPRIGHT: Final = 0.5
"""A triangle whose normal rises by less than this is of a side."""
_LEAST_OF_SIDES: Final = 30
_WELL_SEEN: Final = 0.8
"""Less than this share of the top view is worth a warning."""
_MOST_NODES: Final = 250_000
_FEW_NODES: Final = 9
_TOP_VIEW_NOTE: Final = (
    "the tool's axis was taken where the mass centre of the object's top view is, since no circle "
    "of the tool's radius is seen above the object in the hold: a view from one side shifts it by "
    'some millimetres, so check --tool-radius or give --contact'
)


@dataclass(frozen=True, slots=True)
class ShapeSettings:
    """
    What is simulated, and how.

    Parameters
    ----------
    cloud : CloudSettings
        How the object is taken out of the clouds; the tool's radius is that of the simulation.
    pitch : float, optional
        Side of a cell of the lattice [m]; by default about half the tool's radius, at most 5 mm,
        and so that a block is made of whole cells.
    size : tuple of float, optional
        Length, width and height of a box [m]; without it the body is what the cloud shows.
    contact : tuple of float, optional
        x and y of the tool's axis in the frame of the clouds [m].
    sphere : bool
        Whether the tool ends in a sphere.
    surroundings : Surroundings, optional
        Friction, volume stiffness, weight.
    rounds : int
        Runs of the calibration of either kind of links at most.
    alike : bool, optional
        Whether links are alike everywhere, see `calibration.calibrate`.
    pictures : int
        Times beside those of the comparison at which the surface is kept, for an animation.

    """

    cloud: CloudSettings
    pitch: float | None = None
    size: tuple[float, float, float] | None = None
    contact: tuple[float, float] | None = None
    sphere: bool = False
    surroundings: Surroundings | None = None
    rounds: int = 12
    alike: bool | None = None
    pictures: int = 40


@dataclass(frozen=True, slots=True, eq=False)
class ShapeStudy:
    """
    What a trial's shape tells.

    Parameters
    ----------
    phases : Segmentation
        Phases of the trial.
    model : Model
        The identified model.
    settings : ShapeSettings
        What was asked for.
    observed : Observation
        The object in the clouds, in its own frame.
    calibration : Calibration
        The links, and the run with them.
    rest : Mesh
        The simulated surface before the push.
    surfaces : tuple of Mesh
        The same at the times of ``observed.after``.
    at_rest : Comparison
        The cloud before the push beside `rest`: what is wrong before anything was pressed.
    comparisons : tuple of Comparison
        The clouds after the release beside `surfaces`.
    deformation : Deformation
        What stays, what comes back, bulge and volume.
    shots : tuple of (float, Mesh)
        Times and surfaces for an animation.
    warnings : tuple of str
        What to know of it, one sentence each.

    """

    phases: Segmentation
    model: Model
    settings: ShapeSettings
    observed: Observation
    calibration: Calibration
    rest: Mesh
    surfaces: tuple[Mesh, ...]
    at_rest: Comparison
    comparisons: tuple[Comparison, ...]
    deformation: Deformation
    shots: tuple[tuple[float, Mesh], ...]
    warnings: tuple[str, ...]


def study_shape(
    trial: Trial,
    phases: Segmentation,
    model: Model,
    parameters: Mapping[str, float],
    settings: ShapeSettings,
    *,
    reference_depth: float | None = None,
    observed: Observation | None = None,
    progress: Progress | None = None,
) -> ShapeStudy:
    """
    Simulate the object of a trial and hold it against the trial's clouds.

    Parameters
    ----------
    trial : Trial
        A trial with clouds and a release.
    phases : Segmentation
        Its phases.
    model : Model
        The identified model.
    parameters : mapping of str to float
        Its parameters in SI units, by name.
    settings : ShapeSettings
        Tool, cells, contact.
    reference_depth : float, optional
        Depth of the deepest push of the campaign that was fitted [m].
    observed : Observation, optional
        The object in the trial's clouds, where another study has taken it out with the same
        `settings.cloud`.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    ShapeStudy
        Surfaces, distances, numbers.

    Raises
    ------
    InputError
        If the trial has no clouds, no release, no object in them, or the body cannot be
        simulated.

    """
    tell = progress or (lambda what: None)
    clouds = trial.clouds
    if clouds is None or not len(clouds):
        raise InputError('the bag has no clouds: record /range_sensor/points, or choose a bag')
    tool = Tool(settings.cloud.tool_radius, 0.0, 0.0, settings.sphere)
    # Before the clouds, which take longer.
    carried(model, parameters, tool)
    trial, phases = _at_the_tip(trial, phases, model, parameters)
    if observed is None:
        tell('taking the object out of the clouds')
        observed = observe(
            clouds, trial.tool_height, phases, settings.cloud, contact=settings.contact
        )
    lattice = _lattice(observed, settings)
    if len(lattice.points) > _MOST_NODES:
        raise InputError(
            f'the body has {len(lattice.points)} nodes, more than {_MOST_NODES}: check the size '
            'of the object, or choose larger cells'
        )
    nodes, triangles = lattice.surface
    rest = Mesh(lattice.points[nodes], triangles)
    surroundings = settings.surroundings or Surroundings()
    # The surface is not just as high as the arm felt it: what counts is the way beyond the touch.
    body = Pressed(lattice, LinkLaw(1.0, 1.0, 1.0), tool, surroundings)
    top, under = body.top, len(body.face(0.0))
    motion = _motion(trial, phases, top)
    at, shots = _times(observed, phases, settings.pictures)
    tell(f'simulating the body with {len(lattice.points)} nodes')
    found = calibrate(
        lattice,
        model,
        parameters,
        tool,
        motion,
        surroundings,
        reference_depth=reference_depth,
        at=at.tolist(),
        rounds=settings.rounds,
        alike=settings.alike,
    )
    tell('comparing surfaces and clouds')
    run = found.run
    frame_of = [int(np.argmin(np.abs(run.frame_t - t))) for t in at]
    meshes = [Mesh(*run.surface(frame)) for frame in frame_of]
    after = [int(np.argmin(np.abs(at - seen.t))) for seen in observed.after]
    surfaces = tuple(meshes[k] for k in after)
    visible = seen_triangles(observed.before, rest)
    released = float(np.interp(phases.t_release or phases.t_end, run.t, run.tool))
    warnings = [_TOP_VIEW_NOTE] if observed.contact_source == 'top view' else []
    warnings += _other_tool(observed, settings)
    warnings += _dent_aside(observed, rest, surfaces[-1], settings.cloud.tool_radius)
    if settings.cloud.average == 1:
        warnings.append(
            'a single frame at each time: its noise is taken from the support plane, in all '
            'directions alike; --average 5 measures it'
        )
    if observed.body.seen_share < _WELL_SEEN and settings.size is None:
        warnings.append(
            f'only {observed.body.seen_share:.0%} of the top of the object are seen: the rest was '
            'filled from beside; give its --size if it is a block'
        )
    if settings.size is not None:
        cells = np.array(lattice.full.shape) * lattice.pitch
        if np.any(np.abs(cells / np.array(settings.size) - 1.0) > _COARSE):
            made = ' x '.join(f'{1e3 * one:.3g}' for one in cells)
            warnings.append(
                f'the block is {made} mm in cells of {1e3 * lattice.pitch:.3g} mm: choose --cell '
                'so that it divides the size'
            )
        warnings += _other_size(observed, settings.size)
    if not settings.sphere and under < _FEW_NODES:
        warnings.append(
            f"the tool's face has only {under} node{'s' * (under > 1)} in cells of "
            f'{1e3 * lattice.pitch:.3g} mm: '
            'choose a smaller --cell'
        )
    if surroundings.density > 0.0 and 'yield_force' not in model.effects:
        warnings.append(
            'a body with weight whose model has no yield_force sinks for as long as it stands: '
            'leave out its density, or choose a model with yield_force'
        )
    if found.off > WELL:
        cure = ''
        if settings.sphere and 'contact_growth' not in model.effects:
            cure = '; fit a model with contact_growth, as the contact of a sphere grows'
        warnings.append(
            f'the simulated body differs from the model by up to {found.force_misfit:.2g} of the '
            f'largest force and {found.height_misfit:.2g} of the depth: the distances hold that '
            f'as well{cure}'
        )
    return ShapeStudy(
        phases=phases,
        model=model,
        settings=settings,
        observed=observed,
        calibration=found,
        rest=rest,
        surfaces=surfaces,
        at_rest=compare(observed.before, rest, visible),
        comparisons=tuple(
            compare(seen, surface, visible)
            for seen, surface in zip(observed.after, surfaces, strict=True)
        ),
        deformation=measure(
            observed,
            rest,
            surfaces,
            depth=_depth(trial, phases),
            simulated_depth=top - released,
        ),
        shots=tuple(
            (float(t), mesh) for t, mesh in zip(at, meshes, strict=True) if shots.count(t)
        ),
        warnings=tuple(warnings),
    )


def _other_tool(observed: Observation, settings: ShapeSettings) -> list[str]:
    """Return a warning where a tool of another radius is seen."""
    seen, told = observed.tool_radius, settings.cloud.tool_radius
    if seen.value is None or seen.std is None:
        return []
    # A ball that is not in by its radius is smaller where it is seen.
    larger_only = settings.sphere
    off = seen.value - told
    if abs(off) <= max(_OTHER_RADIUS * told, _SURE * seen.std) or (larger_only and off < 0.0):
        return []
    axis = ': the axis is off by about as much' if observed.contact_source == 'tool' else ''
    return [
        f'above the object a tool of {1e3 * seen.value:.3g} mm radius is seen in the hold, not of '
        f'the {1e3 * told:.3g} mm that were given{axis}; check --tool-radius'
    ]


def _dent_aside(observed: Observation, rest: Mesh, last: Mesh, radius: float) -> list[str]:
    """Return a warning where the dent is not under the tool's axis."""
    maps = levels(observed, rest, last)
    lower = np.where(maps.seen, -maps.measured, -np.inf)
    face = math.pi * (radius / maps.cell) ** 2
    count = max(round(_OF_FACE * face), 1)
    if np.count_nonzero(maps.seen) <= count:
        return []
    # As deep as a part of what the tool covers: no single return decides.
    deep = float(np.sort(lower[maps.seen])[-count])
    if deep < _CLEAR * math.sqrt(float(np.median(maps.variance[maps.seen]))):
        return []
    x, y = maps.middles
    there = lower > 0.5 * deep
    aside = math.hypot(float(np.median(x[there])), float(np.median(y[there])))
    if aside <= max(_ASIDE * radius, _CELLS_OFF * maps.cell):
        return []
    return [
        f'the dent is {1e3 * aside:.3g} mm beside the axis of the tool: check --tool-radius and '
        '--contact'
    ]


def _other_size(observed: Observation, size: tuple[float, float, float]) -> list[str]:
    """Return a warning where a block is clearly not as large as it was given."""
    body = observed.body
    if not np.any(body.inside & body.seen):
        return []
    # A few returns from beside an edge make no row of the block.
    rows = [body.inside.sum(axis=axis) for axis in (0, 1)]
    along, across = (np.count_nonzero(2 * one > one.max()) * body.cell for one in rows)
    seen = np.array(
        [
            along,
            across,
            float(np.percentile(body.heights[body.inside & body.seen], _TOP_SHARE)),
        ]
    )
    told = np.array(size)
    off = np.abs(seen - told)
    # A height is measured, an extent is counted in cells.
    slack = np.maximum(_OTHER_SIZE * told, [_CELLS_OFF * body.cell, _CELLS_OFF * body.cell, 0.0])
    if not np.any(off > slack):
        return []
    sizes = (' x '.join(f'{1e3 * one:.3g}' for one in of) for of in (told, seen))
    return [
        'the block is {} mm as given, but {} mm of it are seen: check --size; a far side '
        'may be hidden'.format(*sizes)
    ]


def _at_the_tip(
    trial: Trial, phases: Segmentation, model: Model, parameters: Mapping[str, float]
) -> tuple[Trial, Segmentation]:
    """Return where the tip was, and the object, by what was identified of the cell."""
    felt = phases.contact_height
    if felt is not None and 'contact_offset' in model.effects:
        phases = replace(phases, contact_height=felt + parameters['delta_0'])
    if 'machine_compliance' in model.effects:
        told = trial.tool_height
        force = trial.force.at(told.t) - phases.force_zero
        touching = told.t >= (phases.t_contact or 0.0)
        tip = told.value + np.where(touching, force, 0.0) / parameters['K_m']
        trial = replace(trial, tool_height=replace(told, value=tip))
    return trial, phases


def _depth(trial: Trial, phases: Segmentation) -> Estimate:
    """Return how deep the object was pressed in when the tool left [m]."""
    depth, error = pressed_in(trial, phases, phases.t_release or phases.t_end)
    if not math.isfinite(depth):
        return Estimate.unknown('no height of the tool was recorded right before the release')
    return Estimate(depth, error)


def _lattice(observed: Observation, settings: ShapeSettings) -> Lattice:
    """Return the body at rest in the object's frame."""
    body = observed.body
    pitch = cell_side(settings)
    if settings.size is None:
        lattice = from_heights(body.low, body.cell, body.heights, pitch)
    else:
        lattice = box(settings.size, pitch)
        row, column = np.nonzero(body.inside)
        middle = [0.5 * (one.min() + one.max() + 1) * body.cell for one in (column, row)]
        lattice = replace(lattice, low=lattice.low + np.array([*np.add(body.low, middle), 0.0]))
    # Whole cells, and a far side that is hidden: the sides that are seen tell where it stands.
    for _ in range(_PLACINGS):
        lattice = replace(lattice, low=lattice.low + _misplaced(observed, lattice))
    return lattice


def cell_side(settings: ShapeSettings) -> float:
    """Return the side of a cell [m]."""
    if settings.pitch is not None:
        return settings.pitch
    usual = min(0.5 * settings.cloud.tool_radius, _USUAL_PITCH)
    if settings.size is None:
        return usual
    tried = usual * np.linspace(1.0 - _SPAN, 1.0 + _SPAN, 401)
    tried = tried[np.argsort(np.abs(tried - usual), kind='stable')]
    cells = np.array(settings.size)[:, None] / tried
    return float(tried[np.argmin(np.round(np.abs(cells - np.rint(cells)).max(axis=0), 6))])


def _misplaced(observed: Observation, lattice: Lattice) -> FloatArray:
    """Return how far a body is to be moved for its sides to be where they were seen [m]."""
    nodes, triangles = lattice.surface
    surface = Mesh(lattice.points[nodes], triangles)
    found = nearest(observed.before.points, surface)
    normals = surface.normals[found.triangle]
    side = np.abs(normals[:, 2]) < _UPRIGHT
    if np.count_nonzero(side) < _LEAST_OF_SIDES:
        return np.zeros(3)
    # Where no side is seen that faces a direction, nothing moves the body along it.
    step = np.linalg.lstsq(normals[side, :2], found.distance[side], rcond=1e-3)[0]
    return np.append(step, 0.0)


def _motion(trial: Trial, phases: Segmentation, top: float) -> ToolMotion:
    """Return the recorded motion of the tool from the contact on, over a surface at `top`."""
    touched, released, felt = phases.t_contact, phases.t_release, phases.contact_height
    assert touched is not None
    assert released is not None
    assert felt is not None
    held = phases.t_hold if phases.t_hold is not None else touched
    record = trial.tool_height
    risen = record.between(released, phases.t_end)
    up = np.flatnonzero(risen.value > felt)
    clear = float(risen.t[up[0]]) if up.size else phases.t_end
    clear = min(clear + 0.2 * (clear - released), phases.t_end)
    ends = [touched, held, released, clear, phases.t_end]
    pieces = [
        np.linspace(start, stop, count, endpoint=False)
        for start, stop, count in zip(ends[:-1], ends[1:], _KNOTS, strict=True)
        if stop > start
    ]
    t = np.unique(np.concatenate([*pieces, [phases.t_end]]))
    height = record.at(t) + (top - felt)
    height[0] = top
    return ToolMotion(t, height, tuple(one for one in (held, released) if t[0] < one < t[-1]))


def _times(
    observed: Observation, phases: Segmentation, pictures: int
) -> tuple[FloatArray, Sequence[float]]:
    """Return the times of all frames that are kept, and those of the animation."""
    assert phases.t_contact is not None
    assert phases.t_release is not None
    held = phases.t_hold if phases.t_hold is not None else phases.t_contact
    loss = phases.t_loss if phases.t_loss is not None else phases.t_release
    quarter = max(pictures // 4, 1)
    shots = np.concatenate(
        [
            np.linspace(phases.t_contact, held, quarter, endpoint=False),
            np.linspace(held, phases.t_release, quarter, endpoint=False),
            np.linspace(phases.t_release, loss, quarter, endpoint=False),
            # The recovery is fast first.
            loss + (phases.t_end - loss) * np.linspace(0.0, 1.0, quarter) ** 2,
        ]
    )
    shots = np.unique(shots)
    return np.unique(np.append(shots, [seen.t for seen in observed.after])), shots.tolist()
