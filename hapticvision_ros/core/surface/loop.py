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
What the force cannot see, from what is wrong with the shape.

Volume stiffness, friction under the object and the tip of the tool change the force as other
links would, which a calibration makes good; they change the shape otherwise. Each is simulated in
the place of what was declared, and held against the same clouds by a profile: how far the sides
have gone out, in bands of height, and the top down, in rings about the tool. A rival is accepted
where it lowers the misfit of trials that had no part in choosing it, by more than their noise and
by more than other cells of the lattice would change it.

"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
import itertools
import math
from types import MappingProxyType
from typing import Final

from hapticvision_ros.core.body.push import Surroundings
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.surface.cloud import Observation
from hapticvision_ros.core.surface.compare import seen_triangles
from hapticvision_ros.core.surface.deformation import levels, of_sides
from hapticvision_ros.core.surface.distance import nearest
from hapticvision_ros.core.surface.mesh import Mesh
from hapticvision_ros.core.surface.study import cell_side, ShapeSettings, ShapeStudy
import numpy as np

type Simulate = Callable[[int, ShapeSettings, Observation | None], ShapeStudy]
"""Return the study of a trial, by its place, with settings and with what was observed already."""

AS_DECLARED: Final = 'as declared'
OTHER_CELLS: Final = 'other cells'
_BANDS: Final = (0.05, 0.25, 0.5, 0.75, 0.95)
"""Between these shares of the height."""
_RINGS: Final = ((0.0, 0.4), (0.4, 0.8), (1.4, 1.8), (1.8, 2.4), (2.4, 3.2))
"""Between these multiples of the tool's radius, off the flank of the dent."""
_ASTRAY: Final = 0.05
"""Share of force or depth from which on a body is not that of the identified model."""
_FRICTIONS: Final = {
    'slides on the support': 0.0,
    'friction 0.3 on the support': 0.3,
    'sticks to the support': math.inf,
}
_LEAST_RETURNS: Final = 30
_LEAST_CELLS: Final = 12
_LEAST_PARTS: Final = 3
_COARSER: Final = 1.25
"""Side of the other cells over that of the usual."""
_SURE: Final = 2.0
"""Standard errors by which a misfit has to be lower."""


@dataclass(frozen=True, slots=True, eq=False)
class Profile:
    """
    How the surface has moved from before the push to the last look, part by part.

    Parameters
    ----------
    measured, std, simulated : ndarray, shape (n,)
        Outward on the sides and upward on the top, and the standard error [m]; NaN for a part
        that was not seen.

    """

    measured: FloatArray
    std: FloatArray
    simulated: FloatArray

    def misfit(self) -> float:
        """Return the mean squared difference over the parts that were seen [m^2]."""
        return float(np.nanmean((self.measured - self.simulated) ** 2))


@dataclass(frozen=True, slots=True)
class Loop:
    """
    Whether the shape asks for something else than what was declared.

    Parameters
    ----------
    misfits : mapping of str to tuple of float
        Root mean square misfit of each trial, by rival [m].
    chosen : str
        The rival with the least misfit over all trials, or `AS_DECLARED`.
    before, after : float or None
        Root mean square misfit of the trials, each left out in turn, as declared and with what
        the others choose [m]; None for a single trial.
    lowered, lowered_std : float or None
        By how much that lowers the mean square, and the standard error [m^2].
    by_cells : float
        By how much other cells change the mean square [m^2].
    accepted : bool
        Whether `chosen` is to be simulated with.
    alike : tuple of str
        What cannot be told from it.
    verdict : str
        A sentence.

    """

    misfits: Mapping[str, tuple[float, ...]]
    chosen: str
    before: float | None
    after: float | None
    lowered: float | None
    lowered_std: float | None
    by_cells: float
    accepted: bool
    alike: tuple[str, ...]
    verdict: str


def profile(observed: Observation, rest: Mesh, last: Mesh, radius: float) -> Profile:
    """
    Return how the surface has moved, measured and simulated, in the same parts.

    Parameters
    ----------
    observed : Observation
        The object's clouds.
    rest, last : Mesh
        The simulated surface before the push and at the last look.
    radius : float
        Of the tool [m].

    """
    parts = [*_sides(observed, rest, last), *_top(observed, rest, last, radius)]
    measured, std, simulated = (np.array(one) for one in zip(*parts, strict=True))
    return Profile(measured, std, simulated)


_UNSEEN: Final = (math.nan, math.nan, math.nan)


def _sides(observed: Observation, rest: Mesh, last: Mesh) -> list[tuple[float, float, float]]:
    """Return measured, error and simulated of the bands of the sides [m]."""
    top = float(rest.points[:, 2].max())
    upright = of_sides(rest, (0.0, 1.0))
    looks = []
    for seen in (observed.before, observed.after[-1]):
        found = nearest(seen.points, rest)
        noise = seen.noise(rest.normals[found.triangle])
        looks.append((seen.points[:, 2] / top, upright[found.triangle], found.distance, noise))
    where = np.flatnonzero(upright & seen_triangles(observed.before, rest))
    moved = nearest(last.centres[where], rest).distance
    level = last.centres[where, 2] / top
    parts = []
    for low, high in itertools.pairwise(_BANDS):
        means, variance = [], 0.0
        for share, of_side, distance, noise in looks:
            chosen = of_side & (share > low) & (share < high)
            count = int(np.count_nonzero(chosen))
            if count >= _LEAST_RETURNS:
                means.append(float(distance[chosen].mean()))
                variance += float(np.mean(noise[chosen] ** 2)) / count
        there = (level > low) & (level < high)
        if len(means) < len(looks) or not there.any():
            parts.append(_UNSEEN)
            continue
        told = float(np.average(moved[there], weights=rest.areas[where][there]))
        parts.append((means[1] - means[0], math.sqrt(variance), told))
    return parts


def _top(
    observed: Observation, rest: Mesh, last: Mesh, radius: float
) -> list[tuple[float, float, float]]:
    """Return measured, error and simulated of the rings of the top [m]."""
    maps = levels(observed, rest, last)
    x, y = maps.middles
    away = np.hypot(x, y) / radius
    parts = []
    for low, high in _RINGS:
        ring = maps.seen & (away >= low) & (away < high)
        count = int(np.count_nonzero(ring))
        if count < _LEAST_CELLS:
            parts.append(_UNSEEN)
            continue
        variance = float(np.sum(maps.variance[ring])) / count**2
        variance += observed.before.plane_std**2 + observed.after[-1].plane_std ** 2
        parts.append(
            (
                float(np.mean(maps.measured[ring])),
                math.sqrt(variance),
                float(np.mean(maps.simulated[ring])),
            )
        )
    return parts


def rivals(settings: ShapeSettings) -> dict[str, ShapeSettings]:
    """Return what is simulated: as declared, in other cells, and what might be instead."""
    around = settings.surroundings or Surroundings()
    found = {
        AS_DECLARED: settings,
        OTHER_CELLS: replace(settings, pitch=_other_cell(settings)),
    }
    for ratio in (0.0, 1.0, 14.0):
        if ratio != around.volume_ratio:
            found[f'volume ratio {ratio:g}'] = replace(
                settings, surroundings=replace(around, volume_ratio=ratio)
            )
    for name, friction in _FRICTIONS.items():
        if friction != around.support.friction:
            found[name] = replace(
                settings,
                surroundings=replace(around, support=replace(around.support, friction=friction)),
            )
    tip = 'flat tool' if settings.sphere else 'spherical tool'
    found[tip] = replace(settings, sphere=not settings.sphere)
    return found


def _other_cell(settings: ShapeSettings) -> float:
    """Return another side for the cells, of which a block has whole ones too [m]."""
    pitch = cell_side(settings)
    if settings.size is None:
        return _COARSER * pitch
    tried = _COARSER * pitch * np.linspace(0.9, 1.2, 301)
    cells = np.array(settings.size)[:, None] / tried
    return float(tried[np.argmin(np.abs(cells - np.rint(cells)).max(axis=0))])


def close_loop(
    trials: int, settings: ShapeSettings, simulate: Simulate
) -> tuple[Loop, ShapeSettings]:
    """
    Simulate trials as declared and otherwise, and say what their shapes ask for.

    Parameters
    ----------
    trials : int
        How many.
    settings : ShapeSettings
        As declared.
    simulate : callable
        Makes the study of a trial.

    Returns
    -------
    Loop
        What was found.
    ShapeSettings
        With what was accepted.

    Raises
    ------
    InputError
        If what was declared cannot be simulated; a rival that cannot, or whose body does not
        follow the identified model, is left out.

    """
    asked = rivals(settings)
    observed: list[Observation | None] = [None] * trials
    profiles: dict[str, list[Profile]] = {}
    failed: dict[str, str] = {}
    kinds: dict[int, bool] = {}
    for name, changed in asked.items():
        made = []
        for trial in range(trials):
            # What rivals differ in is to be what they are named for, and not the kind of links;
            # of another tip the contact is another, and what follows the model there.
            same = changed
            if changed.sphere == settings.sphere:
                same = replace(changed, alike=kinds.get(trial, changed.alike))
            try:
                study = simulate(trial, same, observed[trial])
            except InputError as error:
                if name == AS_DECLARED:
                    raise
                failed[name] = str(error).rstrip('.')
                break
            off = study.calibration.off
            if off > _ASTRAY and name != AS_DECLARED:
                failed[name] = f'its body is {100.0 * off:.0f} % off the identified model'
                break
            observed[trial] = study.observed
            kinds.setdefault(trial, study.calibration.alike)
            radius = settings.cloud.tool_radius
            made.append(profile(study.observed, study.rest, study.surfaces[-1], radius))
        else:
            profiles[name] = made
    loop = judge(profiles)
    for name, why in failed.items():
        loop = replace(loop, verdict=f'{loop.verdict}; {name} was left out ({why})')
    return loop, asked[loop.chosen] if loop.accepted else settings


def judge(profiles: Mapping[str, Sequence[Profile]]) -> Loop:
    """
    Return what the profiles of some trials, by what they were simulated with, ask for.

    Parameters
    ----------
    profiles : mapping of str to sequence of Profile
        `AS_DECLARED`, `OTHER_CELLS` if these could be simulated, and the rivals.

    Raises
    ------
    InputError
        If too little of the object is seen.

    """
    base = profiles[AS_DECLARED]
    for one in base:
        if np.count_nonzero(np.isfinite(one.measured - one.simulated)) < _LEAST_PARTS:
            raise InputError(
                'too little of top and sides is seen both before the push and after it for the '
                'loop over the shape: look from higher up, or with more pixels'
            )
    count = len(base)
    misfit = {name: np.array([one.misfit() for one in of]) for name, of in profiles.items()}
    names = [name for name in profiles if name != OTHER_CELLS]
    by_cells = float(np.mean(np.abs(misfit.get(OTHER_CELLS, np.inf) - misfit[AS_DECLARED])))
    chosen = min(names, key=lambda name: float(misfit[name].mean()))
    shown = MappingProxyType({name: tuple(np.sqrt(of).tolist()) for name, of in misfit.items()})
    alike = tuple(
        name
        for name in names
        if name != chosen
        and (of := _difference(profiles[name], profiles[chosen]))[0]
        <= max(_SURE * of[1], by_cells)
    )
    if count < 2:
        verdict = (
            f'{chosen} fits the shape best, but nothing is held out of a single trial: give more'
        )
        return Loop(shown, chosen, None, None, None, None, by_cells, False, alike, verdict)
    by_others = []
    for trial in range(count):
        rest = np.arange(count) != trial
        by_others.append(min(names, key=lambda name: float(misfit[name][rest].mean())))
    held = [profiles[name][trial] for trial, name in enumerate(by_others)]
    lowered, error = _difference(base, held)
    before = math.sqrt(float(misfit[AS_DECLARED].mean()))
    after = math.sqrt(float(np.mean([one.misfit() for one in held])))
    accepted = chosen != AS_DECLARED and lowered > max(_SURE * error, by_cells)
    if chosen == AS_DECLARED:
        verdict = 'nothing that was tried fits the shape better than what was declared'
    elif not accepted:
        verdict = (
            f'{chosen} fits the shape best, but on trials that had no part in choosing it not by '
            'more than noise and cells make: the shape cannot tell'
        )
    else:
        verdict = f'{chosen}: the shape of trials that had no part in choosing it asks for it'
    if alike and chosen != AS_DECLARED:
        verdict += f'; it cannot be told from {", ".join(alike)}'
    return Loop(shown, chosen, before, after, lowered, error, by_cells, accepted, alike, verdict)


def _difference(first: Sequence[Profile], second: Sequence[Profile]) -> tuple[float, float]:
    """Return by how much the mean square of the first is larger, and the error [m^2]."""
    larger = np.array([a.misfit() - b.misfit() for a, b in zip(first, second, strict=True)])
    variances = []
    for a, b in zip(first, second, strict=True):
        slope = 2.0 * (b.simulated - a.simulated) * a.std
        seen = np.isfinite(slope)
        count = max(int(np.count_nonzero(seen)), 1)
        variances.append(float(np.sum(slope[seen] ** 2)) / float(count) ** 2)
    by_noise = math.sqrt(sum(variances)) / larger.size
    scatter = 0.0
    if larger.size > 1:
        scatter = float(larger.std(ddof=1)) / math.sqrt(larger.size)
    return float(larger.mean()), max(by_noise, scatter)
