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
The closed loop: from a campaign to what the three-element model lacks, and the model with it.

The base model is fitted; what trials differ among themselves is measured from repeats; effects are
selected by refits; what is left is held against smooth curves; and the model with what was
accepted is fitted again.
"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement
import math
from typing import Final

from hapticvision_ros.core import parallel
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.design import push_again, PushLimits, suggest
from hapticvision_ros.core.diagnosis.excess import (
    Bursts,
    bursts,
    Ended,
    ended,
    Excess,
    louder,
    Stretch,
)
from hapticvision_ros.core.diagnosis.likeness import change, left_out, pairs, Tangent, visible
from hapticvision_ros.core.diagnosis.records import (
    Candidate,
    Diagnosis,
    NextTrial,
    Status,
    Unexplained,
)
from hapticvision_ros.core.diagnosis.refit import Columns, Refit, Workbench
from hapticvision_ros.core.diagnosis.scatter import (
    apart,
    Block,
    conditions,
    measure,
    pushed_apart,
    Scatter,
)
from hapticvision_ros.core.diagnosis.selection import (
    BLUNT,
    drawn_out,
    eliminate,
    GATE,
    LEAD,
    price,
    Round,
    select,
    strength,
    worth,
)
from hapticvision_ros.core.diagnosis.structure import describe, Found, look
from hapticvision_ros.core.effects import BY_NAME, EVERY_LAW
from hapticvision_ros.core.effects.declaration import LAW, without_law
from hapticvision_ros.core.fit.bend import Corner, Servo, told
from hapticvision_ros.core.fit.campaign import (
    carried,
    Fit,
    fit_prepared,
    line_spectrum,
    pairs_of,
    places_of,
    Problem,
    Segmented,
)
from hapticvision_ros.core.fit.data import along, arm_of, FitTrial, prepare
from hapticvision_ros.core.fit.simplex import minimum
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal, Trial
from hapticvision_ros.core.segmentation import segment
import numpy as np

LOAD_CELL_GAIN: Final = 'load_cell_gain'
"""Scales every stiffness and viscosity alike, so that no trial can show it."""
LINE: Final = 'periodic_disturbance'
_LINE: Final = 1e-4
"""Chance below which a line in the residual's spectrum is looked at with every sample."""
_SCATTERS: Final = (0.003, 0.006, 0.012, 0.025, 0.05)
"""Scatter of the trials that is tried where no push was repeated, or few were."""
_AGEING: Final = 'ageing'
"""What changes an object steadily over a campaign, as scatter would by chance."""
_FEW_REPEATS: Final = 4
"""Differences between repeats below which they may be alike by chance."""
_WORSE: Final = 2
"""So many larger ones that are all less likely than a smaller one end the search."""
_TOO_MUCH: Final = 0.05
"""Scatter without repeats from which on the trials differ by more than specimens of a kind do."""
_OTHER_OBJECTS: Final = 0.2
"""Scatter of repeats from which on they are of more than one object, or change by an effect."""
_FORM: Final = 0.15
"""A rest below this share of the strongest effect may be its form, which is never exact."""
_STANDS_FOR: Final = 0.95
"""Part of the gain of stamps that are late from which on another effect may be what they show."""
_OPEN: Final = 0.7
"""Part of a leader's gain from which on another may lead without some of the trials."""
_ARM_STEPS: Final = np.array([0.2, 0.2, 0.4, 0.2])
"""
Relative changes of how an arm changes its speed that are tried first: duration, lag, jerk, and
swing where it has one.
"""
_TOLD: Final = 8.0
"""Twice what the encoders may tell against the first of them, minus twice a log likelihood."""
_ARM_TURNS: Final = 60
_ARM_LOOKS: Final = 4
_ON_THE_WAY: Final = 0.2
"""Turns after which a search must have come so much of its way to go on."""
_LITTLE: Final = 0.1
"""Part of these that shows what they would take out."""
_PROMISING: Final = 0.1
"""Part of what effects take out that these must promise to take out to look further."""
_SHARPER: Final = 20.0
"""
What the forces must take out beside what was found, by another way of the arm, to look again.

Each of up to four numbers takes out one by chance.
"""
_MOST_RIVALS: Final = 3
"""Rivals of a single effect beside which that is looked for as well."""
_NEAR: Final = 0.7
"""Part of the leader's gain from which on another is not told from it while a rest is left."""
_LEAST_SHARE: Final = 0.03
"""A rest takes at least this part out of the residual of its phase."""
_LEAST_REST: Final = 0.05
"""A rest below this share of the noise is of no consequence."""


def diagnose(
    campaign: Sequence[Segmented],
    *,
    progress: Callable[[str], None] | None = None,
    workers: int = 1,
    limits: PushLimits | None = None,
    dated: bool = False,
    servo: Servo | None = None,
) -> Diagnosis:
    """
    Find what the three-element model lacks.

    Parameters
    ----------
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials; none that the error is to be tested on.
    progress : callable, optional
        Told what is being looked at.
    workers : int
        Processors.
    limits : PushLimits, optional
        What the cell can do, for the push to make next.
    dated : bool
        Whether the stamps of the tool's height are known to be right. Otherwise they are looked
        at, and moved in all trials where they are late.
    servo : Servo, optional
        How the arm changes its speed; what encoders and forces tell of it by default.

    Returns
    -------
    Diagnosis
        The answer, for the trials as they were moved: see `Diagnosis.late`.

    Raises
    ------
    UsageError
        If there is no trial to fit.

    """

    def tell(what: str) -> None:
        if progress is not None:
            progress(what)

    trials = pairs_of(campaign)
    tell('fitting the three-element model')
    arm, corners = arm_of(trials, workers=workers) if servo is None else (servo, ())
    prepared, known = prepare(trials, servo=arm)
    before = fit_prepared(prepared, Model(), warnings=known)
    line = line_spectrum(before.problem, before.state).chance < _LINE
    if line:
        prepared, known = prepare(trials, windows=True, servo=arm)
        before = fit_prepared(prepared, Model(), near=before, warnings=known)
    phases = [p for made, (_, p) in zip(prepared, trials, strict=True) if made is not None]
    search = _Search(before, phases, workers, tell, limits, line=line, dated=dated)
    outcome = search.run()
    if outcome.late:
        tell(f"moving the stamps of the tool's height by {1e3 * outcome.late:.3g} ms")
        again = diagnose(
            earlier(trials, outcome.late),
            progress=progress,
            workers=workers,
            limits=limits,
            dated=True,
            servo=servo,
        )
        # What the stamps stand for as well is no more to be seen once they are moved.
        named = {name for each in again.sets for name in each}
        stood_for = tuple(name for name in outcome.stood_for if name not in named)
        said = (
            f"the stamps of the tool's height are {1e3 * outcome.late:.4g} ms late against "
            'those of the force in all trials: they were moved back by that'
        )
        if stood_for:
            said += f' ({" or ".join(stood_for)} would show much the same in these trials)'
        return replace(
            again,
            late=outcome.late,
            not_testable=tuple(dict.fromkeys((*stood_for, *again.not_testable))),
            warnings=(said, *again.warnings),
        )
    if arm is not None and servo is None and (outcome.effects or outcome.rest):
        otherwise = _otherwise(trials, prepared, before, outcome, workers, arm, corners)
        if otherwise is not None:
            tell('trying another way of the arm to change its speed')
            other, better = otherwise
            again = diagnose(
                trials,
                progress=progress,
                workers=workers,
                limits=limits,
                dated=dated,
                servo=other,
            )
            fewer = better or len(again.effects) < len(outcome.effects)
            if fewer or (outcome.rest and again.unexplained is None):
                return again
        if outcome.effects:
            sharper = _sharpened(trials, prepared, before, outcome, workers, arm, corners)
            if sharper is not None:
                tell('looking again, with how the forces tell that the arm changes its speed')
                again = diagnose(
                    trials,
                    progress=progress,
                    workers=workers,
                    limits=limits,
                    dated=dated,
                    servo=sharper,
                )
                if _is_as_good(again, outcome):
                    return again
    if outcome.scatter is not None:
        # Errors without what differs from trial to trial would be those of one trial.
        before = fit_prepared(
            prepared, Model(), near=before, scatter=outcome.scatter, warnings=known
        )
    after = before
    if outcome.effects:
        tell('fitting the model with ' + ', '.join(outcome.effects))
        after = fit_prepared(
            prepared,
            outcome.chosen.model,
            near=outcome.chosen.as_fit(before),
            scatter=outcome.scatter,
            warnings=known,
        )
    return Diagnosis(
        status=outcome.status,
        effects=outcome.effects,
        sets=outcome.sets,
        not_testable=outcome.not_testable,
        laws=outcome.laws,
        look_alikes=outcome.look_alikes,
        ranking=outcome.ranking,
        unexplained=outcome.unexplained,
        next_trial=outcome.next_trial,
        before=before,
        after=after,
        warnings=outcome.warnings,
        contenders=_contenders(outcome.rounds, outcome.chosen.model.effects),
        repeat=outcome.repeat,
    )


def _contenders(rounds: Sequence[Round], chosen: Sequence[str]) -> tuple[tuple[str, ...], ...]:
    """
    Return the effects that might be chosen from some of the trials, round by round.

    What was accepted after another, and `chosen` in the end, may be the first without some.
    """
    names = list[tuple[str, ...]]()
    for each in rounds:
        least = 0.5 * GATE
        if each.alike:
            leader = next(one for one in each.candidates if one.effect == each.alike[0])
            least = _OPEN * leader.gain
        near = [
            one.effect
            for one in each.candidates
            # Stamps that are late have been moved for all trials.
            if one.refit is not None and one.gain > least and not BY_NAME[one.effect].misdates
        ]
        accepted = () if names else chosen
        # The first of all comes first again.
        names.append(tuple(dict.fromkeys((*accepted, *each.alike, *near))))
    return tuple(names)


def _otherwise(
    trials: Sequence[tuple[Trial, Segmentation]],
    prepared: Sequence[FitTrial | None],
    before: Fit,
    outcome: '_Outcome',
    workers: int,
    known: Servo,
    corners: Sequence[Corner],
) -> tuple[Servo, bool] | None:
    """
    Return how the arm may change its speed so that fewer effects, or none, explain the forces.

    Encoders that round leave a lag or a mass at each stop open. What they tell by the `corners`,
    beside the arm that is `known`, and what the forces tell beside each smaller model, is taken
    together; also whether that is the better account, and not only as good.
    """
    # Where the tool is away it does not matter to a rest how it goes.
    rest = [each for each in outcome.rest if not each.away]
    if not rest and not outcome.effects:
        return None
    arms = [known]
    if not known.stops:
        # Encoders that round may take the stops for what the withdrawals are.
        arms.append(replace(known, stops=True, others=known))
    memory, scatter = before.noise.memory, outcome.scatter
    bench = Workbench(before.problem.trials, scatter, memory)
    reached = worth(bench, outcome.chosen)
    if rest and not outcome.effects:
        reached -= max(0.0, *(each.gain for each in rest))
    smaller = list[Refit]()
    for each in outcome.rounds:
        if not each.alike and (outcome.effects or not rest):
            break
        if outcome.effects and len(each.without.model.effects) >= len(outcome.effects):
            break
        smaller.append(each.without)

    def better(tried: tuple[Servo, Refit]) -> tuple[Servo, bool] | None:
        arm, without = tried
        least = worth(bench, without)
        promise = 0.0 if without.blur.later >= BLUNT else _PROMISING * (least - reached)
        way = _best_way(bench, without, arm, (trials, prepared, corners), promise, least - reached)
        if way is None:
            return None
        found, left = way
        return (found, left < reached - LEAD) if left < reached + LEAD else None

    jobs = [(arm, without) for arm in arms for without in smaller]
    found = parallel.each(better, jobs, workers)
    return next((each for each in found if each is not None), None)


def _sharpened(
    trials: Sequence[tuple[Trial, Segmentation]],
    prepared: Sequence[FitTrial | None],
    before: Fit,
    outcome: '_Outcome',
    workers: int,
    known: Servo,
    corners: Sequence[Corner],
) -> Servo | None:
    """
    Return how the arm changes its speed as the forces tell it beside the effects that were found.

    Dashpots make a force of a speed that is off by less than encoders tell, and of two effects
    that are much alike that one leads which makes up for it. None where the forces tell no more.
    """
    bench = Workbench(before.problem.trials, outcome.scatter, before.noise.memory)
    models = [outcome.chosen, *_rivals(outcome)]
    measured = trials, prepared, corners

    def way(model: Refit) -> tuple[Servo, float] | None:
        return _best_way(bench, model, known, measured, _SHARPER, _SHARPER)

    found = [each for each in parallel.each(way, models, workers) if each is not None]
    if not found:
        return None
    servo, left = min(found, key=lambda each: each[1])
    return servo if left < worth(bench, outcome.chosen) - _SHARPER else None


def _rivals(outcome: '_Outcome') -> list[Refit]:
    """Return the best refits of other effects where a single one was chosen."""
    if len(outcome.effects) != 1 or not outcome.rounds:
        return []
    tried = sorted(outcome.rounds[0].candidates, key=lambda each: -each.gain)
    known = {without_law(outcome.effects[0])}
    least = _OPEN * max(
        (each.gain for each in tried if without_law(each.effect) in known), default=math.inf
    )
    rivals = list[Refit]()
    for each in tried:
        name = without_law(each.effect)
        if each.refit is not None and each.gain > least and name not in known:
            known.add(name)
            rivals.append(each.refit)
    return rivals[:_MOST_RIVALS]


def _is_as_good(again: Diagnosis, outcome: '_Outcome') -> bool:
    """Return whether a diagnosis with another arm needs no more effects and leaves no more."""
    if len(again.effects) > len(outcome.effects):
        return False
    left, before = again.unexplained, outcome.unexplained
    if left is None:
        return True
    return (
        before is not None and bool(again.effects) and left.share_of_chi2 <= before.share_of_chi2
    )


def _best_way(
    bench: Workbench,
    model: Refit,
    arm: Servo,
    measured: tuple[
        Sequence[tuple[Trial, Segmentation]], Sequence[FitTrial | None], Sequence[Corner]
    ],
    promise: float,
    hoped: float,
) -> tuple[Servo, float] | None:
    """
    Return how an arm goes beside a model as encoders and forces tell it, and what that leaves.

    None where a little of each change does not promise to take out as much as it should; the
    search ends where it does not come near to taking out what is hoped for.
    """
    trials, prepared, corners = measured
    scatter, memory = bench.scatter, bench.memory
    start = told(corners, arm)
    steps = _open_ways(corners, arm)
    paid = sum(price(bench, name) for name in model.model.effects)
    nearest, least_cost = model, math.inf

    def cost(x: FloatArray) -> float:
        nonlocal nearest, least_cost
        other = arm.changed(*(x @ steps).tolist())
        there = Workbench(along(trials, prepared, other), scatter, memory)
        # The best so far is nearer than what the arm as it was left.
        found = there.taken_over(nearest)
        total = found.deviance + paid + told(corners, other) - start
        if total < least_cost:
            nearest, least_cost = found, total
        return total

    # What a little of each change would take out shows whether to look further, where jumps
    # are not taken to come at any moment.
    little = [
        _moved(bench, model, along(trials, prepared, arm.changed(*step)))
        for step in (_LITTLE * steps).tolist()
    ]
    columns = [
        Columns(np.vstack([c.force for c in of]), np.vstack([c.height for c in of]))
        for of in zip(*little, strict=True)
    ]
    if bench.smooth(model, columns, again=False).gain < promise:
        return None
    least = worth(bench, model)

    def hopeful(turn: int, best: float) -> bool:
        return turn < _ARM_LOOKS or least - best > _ON_THE_WAY * hoped

    nowhere, sizes = np.zeros(len(steps)), np.ones(len(steps))
    left, x = minimum(cost, nowhere, sizes, turns=_ARM_TURNS, hopeful=hopeful)
    return arm.changed(*(x @ steps).tolist()), left


def _open_ways(corners: Sequence[Corner], arm: Servo) -> FloatArray:
    """
    Return by what an arm may do otherwise, as far as the encoders leave it open.

    Shape (k, k), a way in each row: what `Servo.changed` takes. All together may be open by much
    where each by itself is not.
    """
    steps = _ARM_STEPS if arm.swing > 0.0 else _ARM_STEPS[:-1]
    count = steps.size
    inward = np.array([*arm.inward(*(2.0 * _LITTLE * steps[:3]).tolist()), 0.0])[:count]

    def at(*ways: FloatArray) -> float:
        # Beside a limit nothing is looked at beyond it.
        away = 2.0 * inward + np.sum(ways, axis=0)
        return told(corners, arm.changed(*(_LITTLE * steps * away).tolist()))

    ways = np.eye(count)
    bent = np.empty((count, count))
    for i, j in combinations_with_replacement(range(count), 2):
        ahead = at(ways[i], ways[j]) + at(-ways[i], -ways[j])
        bent[i, j] = bent[j, i] = ahead - at(ways[i], -ways[j]) - at(-ways[i], ways[j])
    curved, axes = np.linalg.eigh(bent / (2.0 * _LITTLE) ** 2)
    open_ = (axes / np.sqrt(1.0 + np.maximum(curved, 0.0) / _TOLD)).T
    # Each goes away from the limits, or to what is slower.
    heads = open_ @ inward
    heads[heads == 0.0] = open_[heads == 0.0, 0]
    return np.asarray(steps * open_ * np.where(heads < 0.0, -1.0, 1.0)[:, np.newaxis])


def _moved(bench: Workbench, found: Refit, trials: Sequence[FitTrial]) -> list[Columns]:
    """Return what another way of the tool changes in the prediction of a model."""
    other = Problem(found.model, trials, found.problem.scatter)
    return change(bench, found, other, carried(found.problem, found.state, other))


def earlier(
    trials: Sequence[tuple[Trial, Segmentation]], late: float
) -> list[tuple[Trial, Segmentation]]:
    """
    Return trials whose tool heights have earlier stamps, with their phases.

    Parameters
    ----------
    trials : sequence of (Trial, Segmentation)
        As they were measured.
    late : float
        By how much the stamps are late [s].

    Returns
    -------
    list of (Trial, Segmentation)
        With phases that are looked for anew.

    """
    moved = []
    for trial, _ in trials:
        tool = trial.tool_height
        there = replace(trial, tool_height=Signal(tool.t - late, tool.value))
        height = trial.displacement_height
        if height is not None and trial.displacement_source == 'tool':
            there = replace(there, displacement_height=Signal(height.t - late, height.value))
        phases = segment(there.force, there.tool_height, there.displacement_height)
        moved.append((there, phases.entire))
    return moved


@dataclass(frozen=True, slots=True)
class _Outcome:
    """What the search has come to."""

    status: Status
    effects: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    not_testable: tuple[str, ...]
    laws: tuple[str, ...]
    look_alikes: tuple[tuple[str, str, float], ...]
    ranking: tuple[Candidate, ...]
    unexplained: Unexplained | None
    next_trial: NextTrial | None
    repeat: NextTrial | None
    warnings: tuple[str, ...]
    chosen: Refit
    scatter: FloatArray | None
    late: float = 0.0
    stood_for: tuple[str, ...] = ()
    rounds: tuple[Round, ...] = ()
    rest: tuple[Found, ...] = ()


type _Chosen = tuple[Refit, tuple[Round, ...], tuple[str, ...]]
"""The model, how it came about, and its effects in the order of their adding."""


class _Search:
    """The steps of a diagnosis, with what they share."""

    def __init__(
        self,
        before: Fit,
        phases: Sequence[Segmentation],
        workers: int,
        tell: Callable[[str], None],
        limits: PushLimits | None,
        *,
        line: bool,
        dated: bool,
    ) -> None:
        self.before = before
        self.dated = dated
        self.limits = limits
        self.line = line
        self.phases = phases
        self.workers = workers
        self.tell = tell
        self.groups = conditions(phases)
        self.warnings: list[str] = []

    def run(self) -> _Outcome:
        """Return what the trials tell."""
        plain = Workbench(self.before.problem.trials, None, self.before.noise.memory)
        base = plain.base(self.before)
        names, hidden = self._testable(plain, base)
        scatter = self._repeats(plain, base, names)
        bench, scattered = plain, None
        if scatter is not None and scatter.cautious.any():
            scattered = scatter.cautious
            bench = plain.scattering(scattered)
            base = bench.base(self.before)
        usual = [name for name in names if not BY_NAME[name].extra]
        chosen, rounds, order = self._select(bench, base, usual)
        unrepeated: float | None = None
        if scatter is None or scatter.degrees < _FEW_REPEATS:
            unrepeated = self._unrepeated(bench, base, chosen)
        if unrepeated is not None:
            # What takes other laws for scatter must not hide them.
            chosen, rounds, order = self._further(bench, chosen, rounds, order, names)
            unrepeated = self._unrepeated(bench, base, chosen)
        if unrepeated is not None:
            bench, chosen, rounds, order = self._scattered(plain, unrepeated, usual)
        at_once = None
        if scatter is None or scatter.degrees < _FEW_REPEATS:
            at_once = self._at_once(plain, bench, chosen)
        if at_once is not None:
            names, usual = ([n for n in of if without_law(n) != _AGEING] for of in (names, usual))
            unrepeated = at_once
            bench, chosen, rounds, order = self._scattered(plain, at_once, usual)
        if unrepeated is not None:
            scattered = np.full(3, unrepeated)
            self.warnings.append(_differ(unrepeated, scatter))
        self.tell('looking at what is left')
        rest = self._rest(bench, rounds[0].without, chosen, rounds)
        # What only another law shows, such as friction that a tool in the air does not feel, may
        # leave nothing for the usual ones.
        further = self._further(bench, chosen, rounds, order, names)
        if further[0] is not chosen:
            chosen, rounds, order = further
            rest = self._rest(bench, rounds[0].without, chosen, rounds)
        base = rounds[0].without
        ranking = self._ranking(bench, base, rounds[0])
        sets = [each for each in rounds if each.alike and each.alike[0] in order]
        sets.sort(key=lambda each: order.index(each.alike[0]))
        status: Status = 'explained' if order else 'none'
        named = [each.alike for each in sets]
        if rest:
            taken = base.deviance - chosen.deviance
            if not order or max(each.gain for each in rest) > taken:
                status, order, chosen, named = 'unexplained', (), base, []
            else:
                # A model that is known to be wrong does not tell its effects from others well.
                status = 'partly_explained'
                named = [_widened(each) for each in sets]
        named = _parted(named, order)
        unexplained = self._unexplained(bench, base, chosen, rest)
        self._drawn_out(bench, rounds[-1])
        if not rest:
            loud = louder(chosen, self.phases)
            if loud:
                # What is left has no smooth form, and has passed for noise.
                status = 'partly_explained' if order else 'unexplained'
                unexplained = self._loud(bench, base, chosen, loud)
            struck = bursts(chosen, self.phases)
            if struck is not None:
                # Or stands out so much that it has passed for glitches.
                status = 'partly_explained' if order else 'unexplained'
                unexplained = self._beside(bench, base, chosen, struck, unexplained)
        cut = ended(chosen)
        if cut is not None and math.sqrt(cut.share) > _LEAST_REST:
            status = 'partly_explained' if order else 'unexplained'
            unexplained = self._beside(bench, base, chosen, cut, unexplained)
        changed = None
        if scatter is not None and scatter.block is not None:
            changed = self._changed(bench, base, chosen, scatter.block, unexplained)
        elif unrepeated is not None or any(without_law(name) == _AGEING for name in order):
            # What changes at once passes for a steady change where nothing tells when it did.
            changed = self._changed(bench, base, chosen, None, unexplained)
        if changed is not None:
            status = 'partly_explained' if order else 'unexplained'
            unexplained = changed
        if unrepeated is not None and (order or unrepeated >= _TOO_MUCH):
            # An effect of no library may hide in what stands in for scatter.
            status = 'partly_explained' if order else 'unexplained'
            if unexplained is None:
                unexplained = self._differing(bench, plain, base, chosen, unrepeated)
        if scatter is not None and scatter.std.max() >= _OTHER_OBJECTS:
            # So much is no scatter of one object, whatever repeats say of it.
            status = 'partly_explained' if order else 'unexplained'
            if unexplained is None:
                size = float(scatter.std.max())
                unexplained = self._differing(bench, plain, base, chosen, size)
        alike = pairs(bench, base, rounds[0].candidates, order)
        not_testable = (*(n for n in hidden if n not in _named(order)), LOAD_CELL_GAIN)
        late, stood_for = _late(rounds, order)
        return _Outcome(
            status=status,
            effects=_named(order),
            sets=tuple(map(_named, named)),
            not_testable=not_testable,
            laws=tuple(name for name in order if LAW in name),
            look_alikes=_named_pairs(alike),
            # By another law than the usual one these can be shown, but do not lead.
            ranking=tuple(each for each in ranking if each.effect not in not_testable),
            unexplained=unexplained,
            next_trial=self._next(bench, chosen, rounds, order),
            repeat=self._again(bench, chosen, rounds, order, unrepeated, scatter),
            warnings=tuple(self.warnings),
            chosen=chosen,
            scatter=scattered,
            late=late,
            stood_for=stood_for,
            rounds=rounds,
            rest=rest,
        )

    def _testable(self, bench: Workbench, base: Refit) -> tuple[list[str], list[str]]:
        """Return the effects that the trials can show, and those that they cannot."""
        seen, hidden = list[str](), list[str]()
        tangent = Tangent(bench, base)
        for effect in EVERY_LAW:
            if effect.name == LINE and not self.line:
                # Without a line in the spectrum a sine would only follow slow noise.
                continue
            usual = BY_NAME[without_law(effect.name)]
            # What each trial finds for itself by the usual law may show by another.
            if usual.name in hidden and not (usual.nuisance and not effect.nuisance):
                continue
            if effect.misdates and self.dated:
                continue
            shown = not effect.nuisance and visible(bench, base, tangent, effect.name)
            if shown or not (LAW in effect.name or effect.misdates):
                (seen if shown else hidden).append(effect.name)
        return seen, hidden

    def _repeats(self, bench: Workbench, base: Refit, names: Sequence[str]) -> Scatter | None:
        """Return the scatter that repeats show, and say so."""
        scatter = measure(base, self.groups)
        if scatter is None:
            return None
        # Two trials make a steady change of any difference.
        few = scatter.degrees < _FEW_REPEATS <= len(bench.trials)
        if few and scatter.cautious.any() and _AGEING in names:
            scatter = self._steady(bench, base, scatter)
        if scatter.std.any():
            said = 'a nuisance that is allowed for'
            if scatter.std.max() >= _OTHER_OBJECTS:
                said = 'more than one object does'
            elif scatter.block is None:
                said += ' and no effect'
            sizes = ', '.join(
                f'{100.0 * size:.2g} % in {name}'
                for size, name in zip(scatter.std, base.model.names, strict=True)
            )
            self.warnings.append(
                f'repeats of the same push scatter by {sizes} ({scatter.degrees} differences '
                f'between repeats): {said}'
            )
        return scatter

    def _steady(self, bench: Workbench, base: Refit, scatter: Scatter) -> Scatter:
        """Return the scatter that is left if the object ages, where all trials tell this."""
        # So few repeats do not tell a change over the campaign from scatter.
        aged = bench.refit(Model((_AGEING,)), base)
        left = None if aged is None else measure(aged, self.groups)
        if aged is None or left is None or left.cautious.max() >= scatter.cautious.max():
            return scatter
        if left.cautious.any():
            aged = bench.scattering(left.cautious).base(aged.as_fit(self.before))
        scattered = bench.scattering(scatter.cautious).base(self.before)
        better = aged.deviance + price(bench, _AGEING) + LEAD < scattered.deviance
        return left if better else scatter

    def _select(
        self,
        bench: Workbench,
        base: Refit,
        names: Sequence[str],
        known: Sequence[Round] = (),
    ) -> _Chosen:
        chosen, rounds = select(
            bench,
            base,
            names,
            workers=self.workers,
            progress=self.tell,
            known=known,
        )
        chosen, order = eliminate(bench, chosen, rounds, workers=self.workers)
        return chosen, rounds, order

    def _further(
        self,
        bench: Workbench,
        chosen: Refit,
        rounds: tuple[Round, ...],
        order: tuple[str, ...],
        names: Sequence[str],
    ) -> _Chosen:
        """Return the choice among all effects and laws, if it is clearly better."""
        first = rounds[0]
        if all(any(name == each.effect for each in first.candidates) for name in names):
            return chosen, rounds, order
        again = self._select(bench, first.without, names, rounds)
        lead = LEAD
        if order and all(BY_NAME[name].misdates for name in order):
            # Where stamps that are late leave nothing to be named, another law is no other form of
            # an effect, but an effect.
            lead += GATE
        if worth(bench, again[0]) < worth(bench, chosen) - lead:
            return again
        return chosen, rounds, order

    def _unrepeated(self, bench: Workbench, base: Refit, chosen: Refit) -> float | None:
        """
        Return the scatter that trials with no or few repeats ask for, if they do.

        Scatter is a rival of every effect: it stands where it explains the trials clearly better
        beside the effects, or as well as they do in their place.
        """
        if len(bench.trials) < 2:
            return None
        size = self._scattering(bench, chosen, chosen.deviance - LEAD)
        if size is None and chosen.model.effects:
            own = math.log(bench.samples)
            size = self._scattering(bench, base, worth(bench, chosen) - own + LEAD)
        return size

    def _scattered(
        self, plain: Workbench, size: float, names: Sequence[str]
    ) -> tuple[Workbench, Refit, tuple[Round, ...], tuple[str, ...]]:
        """Return the bench of trials that scatter by so much, and the choice on it."""
        bench = plain.scattering(np.full(3, size))
        return bench, *self._select(bench, bench.base(self.before), names)

    def _at_once(self, plain: Workbench, bench: Workbench, chosen: Refit) -> float | None:
        """
        Return the scatter that stands in for a change between two trials, no ageing, if any.

        It is no less than that of a few repeats, which the trials of the `bench` have.
        """
        names = chosen.model.effects
        others = tuple(name for name in names if without_law(name) != _AGEING)
        if len(others) == len(names):
            return None
        without = plain.refit(Model(others), chosen)
        if without is None or apart(without) is None:
            return None
        held = bench.refit(without.model, without)
        size = None if held is None else self._scattering(bench, held, held.deviance)
        if size is None and bench.scatter is not None:
            size = float(bench.scatter.max())
        return size

    def _scattering(self, bench: Workbench, near: Refit, below: float) -> float | None:
        """Return the scatter with which a model has its least deviance, if that is low enough."""
        best, size = below, None
        least, worse = near.deviance, 0
        known = 0.0 if bench.scatter is None else float(bench.scatter.max())
        sizes = [each for each in _SCATTERS if each > known]

        def scattering(each: float) -> Refit | None:
            return bench.scattering(np.full(3, each)).refit(near.model, near)

        refits = parallel.each(scattering, sizes, self.workers, bench.trials)
        for each, refit in zip(sizes, refits, strict=True):
            if refit is None:
                continue
            if refit.deviance < best:
                best, size = refit.deviance, each
            worse = 0 if refit.deviance < least else worse + 1
            least = min(least, refit.deviance)
            if worse == _WORSE:
                break
        return size

    def _rest(
        self, bench: Workbench, base: Refit, chosen: Refit, rounds: Sequence[Round]
    ) -> tuple[Found, ...]:
        """Return the curves that are left beyond chance and beyond the form of an effect."""
        strongest = strength(bench, chosen, base) if chosen.model.effects else 0.0
        least = max(_LEAST_REST, _FORM * strongest)
        return tuple(
            found
            for found in look(bench, chosen, self.phases)
            if found.beyond_chance and found.strength > least and found.share > _LEAST_SHARE
        )

    def _drawn_out(self, bench: Workbench, last: Round) -> None:
        """Say what the encoders are too slow to show, if it seems to be there."""
        # Where it has accepted one, its candidates stand beside a model without that.
        tried = () if last.alike else drawn_out(bench, last.candidates)
        if not tried:
            return
        names = ' or '.join(each.effect for each in tried)
        interval = 1e3 * bench.trials[0].path.interval
        self.warnings.append(
            f'the force is drawn out where it jumps, as {names} would do it: with a tool height '
            f'every {interval:.3g} ms this cannot be told from how the arm starts and stops'
        )

    def _next(
        self,
        bench: Workbench,
        chosen: Refit,
        rounds: Sequence[Round],
        order: Sequence[str],
    ) -> NextTrial | None:
        """Return the push that splits the first set of several, or else sharpens a parameter."""
        accepted = _named(order)
        for each in rounds:
            if not each.alike or each.alike[0] not in order:
                continue
            # What was accepted beside it is no rival of it, nor is another law of its own.
            other = next((n for n in each.alike if without_law(n) not in accepted), None)
            if other is None:
                continue
            refits = {one.effect: one.refit for one in each.candidates}
            first, second = refits[each.alike[0]], refits[other]
            if first is not None and second is not None:
                found = suggest(
                    bench, first, second, self.phases, self.limits, workers=self.workers
                )
                if found is None:
                    return None
                reason = found.reason
                for name in found.separates:
                    reason = reason.replace(name, without_law(name))
                return replace(found, separates=_named(found.separates), reason=reason)
        return suggest(bench, chosen, None, self.phases, self.limits, workers=self.workers)

    def _again(
        self,
        bench: Workbench,
        chosen: Refit,
        rounds: Sequence[Round],
        order: Sequence[str],
        size: float | None,
        scatter: Scatter | None,
    ) -> NextTrial | None:
        """Return the push to repeat where only repeats tell scatter of a size from an effect."""
        candidates = (*order, *(each.effect for each in rounds[0].candidates))
        if size is None or not candidates:
            return None
        missing = _FEW_REPEATS - (0 if scatter is None else scatter.degrees)
        rival = without_law(candidates[0])
        return push_again(bench, chosen, self.phases, size, rival, missing, self.limits)

    def _ranking(self, bench: Workbench, base: Refit, first: Round) -> tuple[Candidate, ...]:
        """Return all candidates beside the base model."""
        refits = {each.effect: each.refit for each in first.candidates if each.refit is not None}

        def ratio(refit: Refit) -> float | None:
            return left_out(bench, base, refit, self.groups)

        ratios = parallel.each(ratio, list(refits.values()), self.workers)
        plain = dict(zip(refits, ratios, strict=True))
        # Of the laws of an effect the one that gains most stands for it.
        best = {without_law(each.effect): each for each in reversed(first.candidates)}
        return tuple(
            Candidate(
                effect=without_law(each.effect),
                score=each.score,
                delta_bic=each.gain,
                held_out_ratio=plain.get(each.effect),
                strength=None if each.refit is None else each.strength,
            )
            for each in first.candidates
            if each is best[without_law(each.effect)]
        )

    def _unexplained(
        self, bench: Workbench, base: Refit, chosen: Refit, rest: Sequence[Found]
    ) -> Unexplained | None:
        """Return what is known of the rest."""
        if not rest:
            return None
        left = max(found.strength for found in rest)
        taken = strength(bench, chosen, base) if chosen.model.effects else 0.0
        return Unexplained(
            share_of_chi2=left**2 / (left**2 + taken**2),
            where=tuple(describe(found) for found in rest),
        )

    def _loud(
        self, bench: Workbench, base: Refit, chosen: Refit, loud: Sequence[Excess]
    ) -> Unexplained:
        """Return what is left where it is only seen to be louder than the noise."""
        left = max(each.ratio for each in loud) ** 2 - 1.0
        taken = strength(bench, chosen, base) if chosen.model.effects else 0.0
        return Unexplained(
            share_of_chi2=left / (left + taken**2) if left > 0.0 else 0.0,
            where=tuple(map(str, loud)),
        )

    def _beside(
        self,
        bench: Workbench,
        base: Refit,
        chosen: Refit,
        left: Bursts | Stretch | Ended,
        other: Unexplained | None,
    ) -> Unexplained:
        """Return what is left in samples that no model is fitted to."""
        taken = strength(bench, chosen, base) if chosen.model.effects else 0.0
        known = 0.0 if other is None else other.share_of_chi2
        where = () if other is None else other.where
        share = left.share / (left.share + taken**2) if left.share > 0.0 else 0.0
        return Unexplained(share_of_chi2=max(share, known), where=(str(left), *where))

    def _changed(
        self,
        bench: Workbench,
        base: Refit,
        chosen: Refit,
        repeated: Block | None,
        other: Unexplained | None,
    ) -> Unexplained | None:
        """
        Return what is left where some trials differ from all others; None if it is little.

        If repeats do not show these, all trials are looked at as if they were of one push, without
        a steady change.
        """
        kept = [name for name in chosen.model.effects if without_law(name) != _AGEING]
        alike = Workbench(bench.trials, None, bench.memory).refit(Model(tuple(kept)), chosen)
        if alike is None:
            return None
        block = apart(alike) if repeated is None else repeated
        if block is None:
            return None
        left = strength(bench, chosen, alike)
        taken = strength(bench, chosen, base) if chosen.model.effects else 0.0
        if left < max(_LEAST_REST, _FORM * taken):
            return None
        share = left**2 / (left**2 + taken**2)
        if other is not None:
            share = max(share, other.share_of_chi2)
        others, rest = 'repeats of the same push before or after them', 'all others'
        if repeated is None:
            others, rest = 'all others', 'those on either side among themselves'
        where = (
            f'{bench.trials[block.first].name} to {bench.trials[block.last].name} differ from '
            f'{others} by {100.0 * block.change:+.2g} % in K1, C1 and C2, {rest} only by '
            f'{100.0 * block.rest:.2g} %: what changed between trials is no scatter'
        )
        times = [trial.campaign_time for trial in bench.trials]
        with_it = pushed_apart(self.phases, times, block) if repeated is None else ()
        if with_it:
            where += f', or goes with the {" and the ".join(with_it)}'
        return Unexplained(share, (where, *(() if other is None else other.where)))

    def _differing(
        self, bench: Workbench, plain: Workbench, base: Refit, chosen: Refit, size: float
    ) -> Unexplained | None:
        """Return what only parameters that differ from trial to trial take out."""
        alike = plain.refit(chosen.model, chosen)
        if alike is None:
            return None
        left = strength(bench, chosen, alike)
        taken = strength(bench, alike, base) if chosen.model.effects else 0.0
        return Unexplained(
            share_of_chi2=left**2 / (left**2 + taken**2),
            where=(
                f'the trials differ among themselves as if K1, C1 and C2 scattered by about '
                f'{100.0 * size:.2g} % from trial to trial: scatter, or an effect',
            ),
        )


def _differ(size: float, scatter: Scatter | None) -> str:
    """Return what scatter without enough repeats is warned of with."""
    what = 'without repeats' if scatter is None else 'with so few repeats'
    return (
        f'the trials differ among themselves as if K1, C1 and C2 scattered by about '
        f'{100.0 * size:.2g} % from trial to trial: {what} of the same push this '
        f'cannot be told from an effect'
    )


def _late(rounds: Sequence[Round], order: Sequence[str]) -> tuple[float, tuple[str, ...]]:
    """
    Return how late the stamps of the tool's height are, as they came to be said to be [s].

    And the effects that explain nearly as much, which the stamps may stand for.
    """
    for each in rounds:
        if not each.alike or each.alike[0] not in order or not BY_NAME[each.alike[0]].misdates:
            continue
        # What is accepted beside it may take some of it, or of what it stands for.
        leader = next(one for one in each.candidates if one.effect == each.alike[0])
        if leader.refit is not None:
            model = leader.refit.model
            (place,) = places_of(model, [leader.effect])
            near = [
                one.effect
                for one in each.candidates
                if one.refit is not None and one.gain > _STANDS_FOR * leader.gain
            ]
            others = _named([n for n in (*each.alike, *near) if n not in order])
            return float(model.values(leader.refit.theta)[place]), others
    return 0.0, ()


def _named(effects: Sequence[str]) -> tuple[str, ...]:
    """Return the names of effects without their laws, each once."""
    return tuple(dict.fromkeys(map(without_law, effects)))


def _named_pairs(
    alike: Sequence[tuple[str, str, float]],
) -> tuple[tuple[str, str, float], ...]:
    """Return pairs of effects by their names, the most alike of each two."""
    most = dict[tuple[str, str], float]()
    for one, other, cosine in alike:
        pair = without_law(one), without_law(other)
        if pair[0] != pair[1]:
            most.setdefault(pair, cosine)
    return tuple((*pair, cosine) for pair, cosine in most.items())


def _parted(sets: Sequence[tuple[str, ...]], order: Sequence[str]) -> list[tuple[str, ...]]:
    """Return the sets without what was accepted beside them: it is no rival of their leaders."""
    return [(*each[:1], *(name for name in each[1:] if name not in order)) for each in sets]


def _widened(found: Round) -> tuple[str, ...]:
    """Return the effects that a round cannot tell apart if no model is right."""
    # The first candidate may have been refused.
    leader = next(each for each in found.candidates if each.effect == found.alike[0])
    near = [
        each.effect
        for each in found.candidates
        if each.refit is not None and each.gain > _NEAR * leader.gain
    ]
    return tuple(dict.fromkeys((*found.alike, *near)))


def choose_again(found: Diagnosis, left_out: Collection[str]) -> Refit | None:
    """
    Choose the effects and fit the parameters without some trials.

    The choice is among what came near to being chosen from all trials (`Diagnosis.contenders`);
    these, the scatter and the memory of the noise, all trials have told.

    Parameters
    ----------
    found : Diagnosis
        Of all trials.
    left_out : collection of str
        Names of the trials to do without.

    Returns
    -------
    Refit or None
        The model that the others ask for; None where none is left.

    """
    whole = found.before.problem.trials
    trials = [trial for trial in whole if trial.name not in left_out]
    if not trials:
        return None
    scatter = found.after.problem.scatter
    known = scatter if scatter.size else None
    bench = Workbench(trials, known, found.before.noise.memory)
    # All trials have shown how closely to search.
    first, *later = found.contenders or ((),)
    chosen, rounds = select(
        bench, bench.base(found.before), first, later=later, rivals=first[:1], closely=False
    )
    return eliminate(bench, chosen, rounds)[0]
