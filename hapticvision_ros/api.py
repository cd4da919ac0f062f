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
What a researcher works with in a notebook: `Trial`, `Campaign`, `Model`, `fit`, `export`.

.. code-block:: python

    from hapticvision_ros import Campaign, describe, fit, Model

    campaign = Campaign.read('bags/slow', 'bags/fast')
    result = fit(campaign, Model.parse('three-element+yield_force'))
    print(describe(result))

"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Literal, Self

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.classification import Classification
from hapticvision_ros.core.classification import classify as classify_record
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.export import export as export_model
from hapticvision_ros.core.export import Format, known_values, Specimen
from hapticvision_ros.core.fit.campaign import Fit, fit
from hapticvision_ros.core.fit.intervals import Interval, profile_intervals
from hapticvision_ros.core.haptic import HapticStepper
from hapticvision_ros.core.records import Segmentation
from hapticvision_ros.core.records import Trial as Record
from hapticvision_ros.core.relaxation import Point
from hapticvision_ros.core.segmentation import segment

__all__ = [
    'Campaign',
    'Classification',
    'Fit',
    'HapticStepper',
    'Interval',
    'Model',
    'Specimen',
    'Trial',
    'classify',
    'describe',
    'export',
    'fit',
    'haptic',
    'profile_intervals',
]


@dataclass(frozen=True, slots=True)
class Trial:
    """
    A measured trial and its phases.

    Parameters
    ----------
    trial : hapticvision_ros.core.records.Trial
        What was measured.
    segmentation : Segmentation
        When the tool touches, holds, releases and lets go.

    """

    trial: Record
    segmentation: Segmentation

    @classmethod
    def of(cls, trial: Record) -> Self:
        """Return a measured trial with its phases, found from the signals."""
        return cls(trial, segment(trial.force, trial.tool_height, trial.displacement_height))

    @classmethod
    def read(cls, bag: str | PathLike[str]) -> Self:
        """
        Read a bag.

        Parameters
        ----------
        bag : path
            A bare .mcap or a rosbag2 directory.

        Returns
        -------
        Trial
            The trial.

        Raises
        ------
        InputError
            If it cannot be read.

        """
        return cls.of(read_trial(Path(bag)))

    @property
    def name(self) -> str:
        """Return the trial's name."""
        return self.trial.name


class Campaign(tuple[Trial, ...]):
    """Trials on one object, to be fitted together."""

    __slots__ = ()

    def __new__(cls, trials: Iterable[Trial] = ()) -> Self:
        """Make a campaign of trials."""
        return super().__new__(cls, trials)

    @classmethod
    def read(cls, *bags: str | PathLike[str]) -> Self:
        """
        Read bags.

        Parameters
        ----------
        *bags : path
            Bare .mcap files or rosbag2 directories.

        Returns
        -------
        Campaign
            Their trials, in the same order.

        Raises
        ------
        InputError
            If one cannot be read.

        """
        return cls(Trial.read(bag) for bag in bags)


def describe(result: Fit, *, intervals: bool = True) -> str:
    """
    Return a fit as a table in plain text.

    Parameters
    ----------
    result : Fit
        The fit.
    intervals : bool
        Whether to add the 95 % intervals of the profile likelihood.

    Returns
    -------
    str
        A line for each parameter, then the errors and the warnings.

    """
    return '\n'.join(_lines(result, profile_intervals(result) if intervals else {}))


def classify(trial: Trial) -> Classification:
    """
    Tell whether a trial shows an elastic, viscoelastic, plastic or rheological object.

    Parameters
    ----------
    trial : Trial
        One trial with a release.

    Returns
    -------
    Classification
        See `hapticvision_ros.core.classification`.

    """
    return classify_record(trial.trial, trial.segmentation)


def export(
    result: Fit,
    form: Format,
    *,
    specimen: Specimen | None = None,
    poisson: float | None = None,
    shortest_time: float | None = None,
    point: Point | None = None,
) -> str:
    """
    Return a fit in a format of others.

    Parameters
    ----------
    result : Fit
        The fit.
    form : {'json', 'csv', 'abaqus', 'ansys', 'mujoco', 'haptic'}
        The format.
    specimen, poisson, shortest_time, point : optional
        See `hapticvision_ros.core.export.export`.

    Returns
    -------
    str
        The content of a file.

    Raises
    ------
    UsageError
        If the format cannot hold the model, or something that it needs is missing.

    """
    return export_model(
        form,
        result.model,
        result.parameters,
        specimen=specimen,
        poisson=poisson,
        shortest_time=shortest_time,
        point=point,
        correlation=result.correlation,
        reference_depth=result.problem.trials[0].reference_depth,
    )


def haptic(
    result: Fit | str | PathLike[str], *, which: Literal['before', 'after'] | None = None
) -> HapticStepper:
    """
    Return the fitted body as a step function for a haptic renderer.

    Parameters
    ----------
    result : Fit or path
        The fit, or the result.json of one.
    which : {'before', 'after'}, optional
        Of a result.json, the base model or the one with what it lacked; by default the latter
        where there is one.

    Returns
    -------
    HapticStepper
        At rest; ``step(displacement)`` gives the force 1 ms later.

    Raises
    ------
    InputError
        If the file is no result.
    UsageError
        If the trials have not told a parameter, or an effect has no step of its own.

    """
    if not isinstance(result, Fit):
        # Only a notebook that reads a file needs what reads it.
        from hapticvision_ros.cli.export import deepest, fitted_model

        path = Path(result)
        model, estimates, _ = fitted_model(path, which)
        return HapticStepper(model, known_values(model, estimates), reference_depth=deepest(path))
    return HapticStepper(
        result.model,
        known_values(result.model, result.parameters),
        reference_depth=result.problem.trials[0].reference_depth,
    )


def _lines(result: Fit, intervals: dict[str, Interval]) -> Iterator[str]:
    yield f'{result.model.name}, {sum(t is not None for t in result.trials)} trials'
    for unit, (name, estimate) in zip(result.model.units, result.parameters.items(), strict=True):
        if estimate.value is None:
            yield f'{name:>12} unknown: {estimate.reason}'
            continue
        error = '' if estimate.std is None else f' +- {estimate.std:.2g}'
        line = f'{name:>12} = {estimate.value:.6g}{error} {unit}'
        interval = intervals.get(name)
        if interval is not None:
            lower = '...' if interval.lower is None else f'{interval.lower:.6g}'
            upper = '...' if interval.upper is None else f'{interval.upper:.6g}'
            line += f'  [{lower}, {upper}]'
        yield line
    yield f'force misses by {result.force_rmse:.3g} N'
    if result.height_rmse is not None:
        yield f'displacement height misses by {result.height_rmse:.3g} m'
    yield from (f'warning: {warning}' for warning in result.warnings)
