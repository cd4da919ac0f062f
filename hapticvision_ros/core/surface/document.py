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

"""``shape.json``: what a trial's shape tells, in SI units, which the names carry."""

from collections.abc import Iterator, Mapping
import math
from typing import Any, Final

from hapticvision_ros.core.body.push import Surroundings, Touch
from hapticvision_ros.core.records import Estimate
from hapticvision_ros.core.surface.compare import Comparison
from hapticvision_ros.core.surface.deformation import Pair
from hapticvision_ros.core.surface.study import ShapeStudy

SCHEMA: Final = 'hapticvision/shape/2'

PAIRS: Final = (
    ('residual', 'm', 'residual deformation'),
    ('bouncing', 'm', 'bouncing deformation'),
    ('at_once', 'm', 'part of the bouncing that came back before the dent was seen'),
    ('bulge', 'm', 'bulge of the sides'),
    ('volume_change', 'm3', 'change of the volume that is seen'),
)
"""Name of a pair, its unit and what it is."""


def shape_document(
    study: ShapeStudy,
    *,
    result: str,
    which: str,
    bag: str,
    fitted_anew: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """
    Return what is written to ``shape.json``.

    Parameters
    ----------
    study : ShapeStudy
        What was found.
    result, which, bag : str
        The files, as they were named, and which model of the result was used.
    fitted_anew : mapping of str to float, optional
        The model's parameters in SI units, by name, where they are not those of the result.

    Returns
    -------
    dict
        Finite numbers, strings, lists, dicts and None; each None has its reason in `warnings`.

    """
    settings, run = study.settings, study.calibration.run
    surroundings = settings.surroundings or Surroundings()
    rotation, shift = study.observed.rotation, study.observed.shift
    # Where x = y = 0 of the object's frame is in the frame of the clouds before the push.
    axis = -shift @ rotation
    return {
        'schema': SCHEMA,
        'result': result,
        'which': which,
        'model': study.model.name,
        'fitted_anew': None if fitted_anew is None else dict(fitted_anew),
        'bag': bag,
        'simulation': {
            'cell_m': run.lattice.pitch,
            'nodes': len(run.lattice.points),
            'box_m': None if settings.size is None else list(settings.size),
            'tool_radius_m': settings.cloud.tool_radius,
            'tool_is_sphere': settings.sphere,
            'volume_ratio': surroundings.volume_ratio,
            'tool_friction': _friction(surroundings.tool),
            'support_friction': _friction(surroundings.support),
            'density_kg_m3': surroundings.density,
            'small_displacements': surroundings.small,
            'links': 'alike' if study.calibration.alike else 'even',
            'geometry_taken_out': study.calibration.law.geometry is not None,
            'calibration_rounds': study.calibration.rounds,
            'force_misfit': study.calibration.force_misfit,
            'height_misfit': study.calibration.height_misfit,
            'volume_m3': float(run.volume[0]),
            'volume_change_m3': float(run.volume[-1] - run.volume[0]),
        },
        'contact': {
            'x_m': float(axis[0]),
            'y_m': float(axis[1]),
            'source': study.observed.contact_source,
        },
        'before': _comparison(study.at_rest),
        'after': [
            {
                't_s': height.t,
                'dent_m': _pair(Pair(height.measured, height.simulated)),
                **_comparison(comparison),
            }
            for height, comparison in zip(
                study.deformation.heights, study.comparisons, strict=True
            )
        ],
        **{f'{name}_{unit}': _pair(getattr(study.deformation, name)) for name, unit, _ in PAIRS},
        'seen_area_m2': study.deformation.seen_area,
        'warnings': list(_warnings(study)),
    }


def _friction(touch: Touch) -> float | str:
    return 'sticks' if math.isinf(touch.friction) else touch.friction


def _pair(pair: Pair) -> dict[str, float | None]:
    return {
        'measured': pair.measured.value,
        'measured_std': pair.measured.std,
        'simulated': pair.simulated.value,
    }


def _comparison(one: Comparison) -> dict[str, Any]:
    return {
        'returns': int(one.distance.size),
        'rms_m': one.rms,
        'noise_m': one.noise,
        'noise_share': one.noise_share,
        'rms_beyond_noise_m': one.beyond_noise,
        'mean_m': one.shift,
        'percentile_95_m': one.percentile_95,
        'percentile_95_of_noise_m': one.noise_percentile_95,
        'largest_m': one.largest,
        'largest_of_noise_m': one.noise_largest,
        'hausdorff_m': one.hausdorff,
        'surface_to_cloud_percentile_95_m': one.surface_percentile_95,
        'spacing_m': one.spacing,
    }


def _warnings(study: ShapeStudy) -> Iterator[str]:
    """Yield what to know, and the reason of each null."""
    yield from study.warnings
    for height in study.deformation.heights:
        for side, one in (('measured', height.measured), ('simulated', height.simulated)):
            if one.value is None:
                yield f'the {side} dent at {height.t:.3g} s is unknown: {one.reason}'
    for name, _, what in PAIRS:
        pair: Pair = getattr(study.deformation, name)
        sides: tuple[tuple[str, Estimate], ...] = (
            ('measured', pair.measured),
            ('simulated', pair.simulated),
        )
        for side, one in sides:
            if one.value is None:
                yield f'the {side} {what} is unknown: {one.reason}'
    if any(one.hausdorff is None for one in (study.at_rest, *study.comparisons)):
        yield (
            'the Hausdorff distance is unknown: no place of the simulated surface has a return '
            'beside it before the push'
        )
