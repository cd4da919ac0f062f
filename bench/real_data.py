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
Bench: how far models miss measured trials, those that they were fitted to and those held out.

Each set is one campaign. A model is fitted to all of its trials (in-sample), and to all but those
of one condition (speed and depth), which it then predicts, each condition in turn (held-out); a
predicted trial may only have its own onset, within the precision of the detected contact, and its
sensors' zeros. The model of a set is chosen anew for each held-out condition, by the same
cross-validation among the other conditions, so that neither the fit nor the choice has seen what
is predicted. Models of the first set are also asked for trials of another kind. Muscle and
adhesive are read from ``bags/``; the silicone is read from CSV files in
``DIR/silicone_indentation`` where ``--data DIR`` is given (``bags/README.md`` tells the source).

``OMP_NUM_THREADS=1 python bench/real_data.py --data DIR --out doc/real_data.md`` renews the tables
of that page.
"""

import argparse
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
import math
from pathlib import Path
import tempfile
import time

from hapticvision_ros.api import Campaign, fit, Model, Trial
from hapticvision_ros.bag.csv_import import import_csv
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.fit.campaign import TrialFit
from hapticvision_ros.core.fit.data import FitTrial, prepare
from hapticvision_ros.core.fit.held_out import conditions, predict_unseen, Trained
from hapticvision_ros.core.pipeline import analyse, analyse_campaign
from hapticvision_ros.core.records import FloatArray, Segmentation
from hapticvision_ros.core.records import Trial as Record
import numpy as np
from page import renew

BAGS = Path(__file__).parents[1] / 'bags'
BEGIN, END = '<!-- tables of bench/real_data.py -->', '<!-- end of the tables -->'

CANDIDATES = tuple(
    Model.parse('+'.join(('three-element', *effects.split())))
    for effects in (
        '',
        'parallel_spring',
        'springpot',
        'shear_thinning',
        'strain_stiffening',
        'contact_growth',
        'exponential_stiffening',
        'second_retardation series_spring',
        'springpot parallel_spring',
        'strain_stiffening springpot',
        'contact_growth springpot',
        'exponential_stiffening springpot',
        'contact_growth springpot parallel_spring',
        'exponential_stiffening springpot parallel_spring',
    )
)
"""What the choice is among: a law of depth, a spectrum of relaxation, both, and neither."""


@dataclass(frozen=True)
class Set:
    """A set of measured trials."""

    title: str
    folder: str
    pattern: str


SETS = (
    Set('silicone, push and hold', 'silicone_indentation', 'push_hold_P002_laser_[2-6]'),
    Set('silicone, push, hold and release', 'silicone_indentation', 'push_hold_release_*'),
    Set('muscle', 'muscle_ramp_hold', 'ramp_*'),
    Set('adhesive', 'adhesive_shear_relaxation', 'rate_*'),
)

OTHERS = (
    Set('silicone, push, hold and release', 'silicone_indentation', 'push_hold_release_*'),
    Set('the push with a slip', 'silicone_indentation', 'push_hold_P002_laser_1'),
)
"""Trials that are also predicted by the models fitted to the first set alone."""


@dataclass(frozen=True)
class Miss:
    """
    How far a model misses a trial.

    Parameters
    ----------
    rmse : float
        The error [N].
    shape : float
        The error with the predicted force scaled by the factor that suits the trial best [N].
    peak : float
        The trial's largest force [N].
    onset : float
        How far the touch was moved, over the error of its detection.

    """

    rmse: float
    shape: float
    peak: float
    onset: float

    @classmethod
    def of(
        cls,
        model: Model,
        theta: FloatArray,
        one: FitTrial,
        found: TrialFit,
        within: tuple[float, float] = (-math.inf, math.inf),
    ) -> 'Miss':
        """
        Return it for a trial with its own values as found, over the times `within` [s].

        All samples count but those set aside as glitches, also the corners of the force that the
        records of a fit leave out.
        """
        full = one.full_rate
        own = [found.values[name].value or 0.0 for name in model.trial_names]
        zero = found.values.get('force_zero')
        middle = 0.5 * (full.t[1:] + full.t[:-1])
        good = full.samples.good & (middle >= within[0]) & (middle < within[1])
        said = model.predict(full, theta, own, directions=False, turns=full.turns).force[good]
        measured = full.samples.force[good] - ((zero.value or 0.0) if zero else 0.0)
        factor = float(measured @ said) / max(float(said @ said), 1e-300)
        return cls(
            math.sqrt(float(np.mean((measured - said) ** 2))),
            math.sqrt(float(np.mean((measured - factor * said) ** 2))),
            float(np.abs(full.samples.force[full.samples.good]).max()),
            own[0] / one.onset_std,
        )

    @property
    def percent(self) -> float:
        """Return the error in percent of the trial's peak."""
        return 100.0 * self.rmse / self.peak

    @property
    def shape_percent(self) -> float:
        """Return the error with the force scaled by one free factor, in percent of the peak."""
        return 100.0 * self.shape / self.peak


def pair(trial: Trial) -> tuple[Record, Segmentation]:
    """Return what was measured and its phases."""
    return trial.trial, trial.segmentation


def inside(campaign: Campaign, model: Model) -> list[Miss]:
    """Return how far a model misses the trials that it is fitted to."""
    found = fit(campaign, model)
    trials = [trial for trial in found.trials if trial is not None]
    return [
        Miss.of(model, found.theta, one, trial)
        for one, trial in zip(found.problem.trials, trials, strict=True)
    ]


def read(one: Set, data: Path | None, scratch: Path) -> Campaign | None:
    """Return the trials of a set; None where they are not there."""
    bags = sorted((BAGS / one.folder).glob(one.pattern))
    if not bags and data is not None:
        files = sorted((data / one.folder).glob(f'{one.pattern}.csv'))
        bags = [import_csv(file, scratch / one.folder, replace=True).bag for file in files]
    return Campaign.read(*bags) if bags else None


class Folds:
    """Fits of the candidates to a campaign without some of its conditions, each made once."""

    def __init__(self, campaign: Campaign) -> None:
        self.campaign = campaign
        self.groups = conditions(campaign)
        self._known: dict[tuple[Model, frozenset[int]], Trained | None] = {}

    def trained(self, model: Model, left_out: Collection[int]) -> Trained | None:
        """Return a model fitted without the trials of some conditions; None where it fails."""
        key = (model, frozenset(left_out))
        if key not in self._known:
            gone = {i for group in left_out for i in self.groups[group]}
            kept = [trial for i, trial in enumerate(self.campaign) if i not in gone]
            try:
                self._known[key] = Trained.of(fit(kept, model), kept)
            except UsageError as error:
                print(f'{model.name}: {error}', flush=True)
                self._known[key] = None
        return self._known[key]

    def misses(self, model: Model, group: int, also: Collection[int] = ()) -> list[Miss]:
        """Return how far a model misses a condition, fitted without it and others."""
        trained = self.trained(model, {group, *also})
        if trained is None:
            return [Miss(math.inf, math.inf, 1.0, 0.0)] * len(self.groups[group])
        pairs = [pair(self.campaign[i]) for i in self.groups[group]]
        unseen = predict_unseen(trained, pairs)
        return [
            Miss.of(model, trained.theta, replace(one, reference_depth=trained.reference_depth), t)
            for one, t in zip(prepare(pairs)[0], unseen.trials, strict=True)
            if one is not None and t is not None
        ]

    def choose(self, group: int) -> Model:
        """Return the candidate with the least error in cross-validation without a condition."""
        others = [k for k in range(len(self.groups)) if k != group]
        return min(
            CANDIDATES,
            key=lambda model: pooled(m for k in others for m in self.misses(model, k, {group})),
        )


def pooled(misses: Iterable[Miss]) -> float:
    """Return the root mean square of errors in percent of the peak."""
    return math.sqrt(float(np.mean([miss.percent**2 for miss in misses])))


def pooled_shape(misses: Iterable[Miss]) -> float:
    """Return the same of the errors of the shape."""
    return math.sqrt(float(np.mean([miss.shape_percent**2 for miss in misses])))


def tables(one: Set, campaign: Campaign, started: float) -> Iterator[str]:
    """Yield the lines of a set."""
    folds = Folds(campaign)
    names = [trial.name for trial in campaign]
    yield from (f'### {one.title[0].upper()}{one.title[1:]}', '')
    seen = {model: inside(campaign, model) for model in CANDIDATES}
    outside: dict[Model, list[Miss]] = {}
    for model in CANDIDATES:
        found: dict[int, Miss] = {}
        for k, group in enumerate(folds.groups):
            found |= dict(zip(group, folds.misses(model, k), strict=True))
        outside[model] = [found[i] for i in range(len(campaign))]
        print(f'{time.perf_counter() - started:.0f} s: {one.title}, {model.name}', flush=True)
    chosen: list[Model] = [CANDIDATES[0]] * len(campaign)
    for k, group in enumerate(folds.groups):
        model = folds.choose(k)
        for i in group:
            chosen[i] = model
        print(f'{time.perf_counter() - started:.0f} s: without {group}: {model.name}', flush=True)
    yield (
        '| held-out trial | peak | base, in-sample | base, held out | chosen without it '
        '| in-sample | held out | shape, held out | onset moved |'
    )
    yield '| --- |' + ' --- |' * 8
    base = CANDIDATES[0]
    rows = []
    for i, (name, model) in enumerate(zip(names, chosen, strict=True)):
        row = (seen[base][i], outside[base][i], seen[model][i], outside[model][i])
        rows.append(row)
        yield (
            f'| {name} | {row[0].peak:.3g} N | {cell(row[0])} | {cell(row[1])} '
            f'| {effects(model)} | {cell(row[2])} | {cell(row[3])} '
            f'| {row[3].shape_percent:.1f} % | {row[3].onset:+.1f} |'
        )
    mean = [f'{pooled(column):.1f} %' for column in zip(*rows, strict=True)]
    yield (
        f'| **root mean square** | | {mean[0]} | {mean[1]} | | {mean[2]} | {mean[3]} '
        f'| {pooled_shape(row[3] for row in rows):.1f} % | |'
    )
    yield from ('', '| candidate | in-sample | held out | shape, held out |')
    yield '| --- | --- | --- | --- |'
    for model in CANDIDATES:
        yield (
            f'| {effects(model)} | {pooled(seen[model]):.1f} % | {pooled(outside[model]):.1f} % '
            f'| {pooled_shape(outside[model]):.1f} % |'
        )
    yield ''


def singles(campaigns: Sequence[tuple[Set, Campaign]]) -> Iterator[str]:
    """Yield the lines of the base model and each effect alone, in-sample."""
    yield from ('### Each effect alone, in-sample', '')
    yield '| effect | ' + ' | '.join(one.title for one, _ in campaigns) + ' |'
    yield '| --- |' + ' --- |' * len(campaigns)
    for name in ('', *BY_NAME):
        model = Model((name,) if name else ())
        cells = [f'{pooled(inside(campaign, model)):.1f} %' for _, campaign in campaigns]
        yield f'| {effects(model)} | ' + ' | '.join(cells) + ' |'
    yield ''


def elsewhere(campaign: Campaign, others: Sequence[tuple[Set, Campaign]]) -> Iterator[str]:
    """Yield how far the models of a campaign miss trials of another kind."""
    yield from ('### Silicone: what push and hold say of other trials', '')
    yield (
        '| candidate | '
        + ' | '.join(
            f'{one.title}: all | until the release | after it | shape' for one, _ in others
        )
        + ' |'
    )
    yield '| --- |' + ' --- |' * (4 * len(others))
    for model in CANDIDATES:
        trained = Trained.of(fit(campaign, model), list(campaign))
        cells = []
        for _, other in others:
            pairs = [pair(trial) for trial in other]
            unseen = predict_unseen(trained, pairs).trials
            columns: list[list[Miss]] = [[], [], []]
            for one, found in zip(prepare(pairs)[0], unseen, strict=True):
                if one is None or found is None:
                    continue
                same = replace(one, reference_depth=trained.reference_depth)
                release = math.inf if one.t_release is None else one.t_release
                parts = [(-math.inf, math.inf), (-math.inf, release), (release, math.inf)]
                for column, part in zip(columns, parts, strict=True):
                    if part[0] < math.inf:
                        column.append(Miss.of(model, trained.theta, same, found, part))
            cells += [f'{pooled(column):.1f} %' if column else '-' for column in columns]
            cells.append(f'{pooled_shape(columns[0]):.1f} %')
        yield f'| {effects(model)} | ' + ' | '.join(cells) + ' |'
        print(f'elsewhere: {model.name}', flush=True)
    yield ''


def closed(campaigns: Sequence[tuple[Set, Campaign]], started: float) -> Iterator[str]:
    """Yield the lines of what ``hapticvision fit`` says, whose held-out conditions nothing saw."""
    yield from ('### What the closed loop says', '')
    yield (
        '| set | answer | effects, each with those not told from it | base, in-sample | held out '
        '| with the effects, in-sample | held out | squares left |'
    )
    yield '| --- |' + ' --- |' * 7
    rests = []
    for one, campaign in campaigns:
        whole = analyse_campaign([analyse(trial.trial) for trial in campaign])
        print(f'{time.perf_counter() - started:.0f} s: {one.title}, the closed loop', flush=True)
        found = whole.diagnosis
        assert found is not None
        peak = max(float(np.abs(trial.trial.force.value).max()) for trial in campaign)
        errors = []
        for model in (whole.before, whole.after):
            for misfits in (None, None) if model is None else (model.train, model.held_out):
                rmse = None if misfits is None else misfits.total['force'].rmse
                errors.append('-' if rmse is None else f'{100.0 * rmse / peak:.1f} %')
        names = '; '.join(' or '.join(each) for each in found.sets) or '-'
        left = '-'
        if found.unexplained is not None:
            left = f'{100.0 * found.unexplained.share_of_chi2:.0f} %'
            rests.append(f'- {one.title}: {found.unexplained.where[0]}')
        yield f'| {one.title} | {found.status} | {names} | {" | ".join(errors)} | {left} |'
    yield from ('', 'What is left, the first of it:', '', *rests, '')


def cell(miss: Miss) -> str:
    """Return an error in percent of the peak and in newtons."""
    return f'{miss.percent:.1f} % ({miss.rmse:.2g} N)'


def effects(model: Model) -> str:
    """Return the effects of a model."""
    return ', '.join(model.effects) or 'none (base)'


def main() -> None:
    """Print the tables, and write them into a page if asked to."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--data', type=Path, help='folder of the sets that are not shipped')
    parser.add_argument('--set', default='', help='only sets whose title holds this')
    parser.add_argument('--out', type=Path, help='page whose tables are renewed')
    args = parser.parse_args()
    started = time.perf_counter()
    lines: list[str] = []
    with tempfile.TemporaryDirectory() as scratch:
        campaigns = []
        for one in SETS:
            campaign = read(one, args.data, Path(scratch)) if args.set in one.title else None
            if campaign is not None:
                campaigns.append((one, campaign))
            elif args.set in one.title:
                print(f'{one.title}: not there, give its folder by --data', flush=True)
        for one, campaign in campaigns:
            lines += tables(one, campaign, started)
        others = [(one, read(one, args.data, Path(scratch))) for one in OTHERS]
        found = [(one, other) for one, other in others if other is not None]
        if found and campaigns[0][0] is SETS[0]:
            lines += elsewhere(campaigns[0][1], found)
        lines += closed(campaigns, started)
        lines += singles(campaigns)
    print('\n'.join(lines))
    if args.out is not None:
        renew(args.out, BEGIN, END, '\n'.join(lines))


if __name__ == '__main__':
    main()
