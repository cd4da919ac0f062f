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
Which effects a campaign asks for: forward selection by refits, then elimination.

Every candidate is looked at by what one step of the search promises; those that promise something
are refitted, each with its own noise, and compared by Schwarz's criterion. A candidate is accepted
when it gains clearly, and changes the prediction by more than a small part of the noise.

References
----------
G. Schwarz, Ann. Stat. 6, 1978, 461-464, doi:10.1214/aos/1176344136; R. E. Kass and A. E. Raftery,
J. Am. Stat. Assoc. 90, 1995, 773-795, doi:10.1080/01621459.1995.10476572 (a difference of ten is
very strong evidence, one of six strong).

"""

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from itertools import product
import math
from typing import Final

from hapticvision_ros.core import parallel
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.refit import Look, Refit, Workbench
from hapticvision_ros.core.effects import BY_NAME, EVERY_LAW
from hapticvision_ros.core.effects.declaration import without_law
from hapticvision_ros.core.fit.campaign import Problem, SHARPEST
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

GATE: Final = 10.0
"""Gain in Schwarz's criterion from which on an effect is there."""
LEAD: Final = 10.0
"""Lead in it by which one effect is told from another."""
_COST: Final = 0.5
"""Part that counts against a rival of what its parameters cost more than those of the leader."""
_PAIR: Final = 2
_THIRD: Final = 0.5
"""Part of what tells an effect from the leader that does so once so many are not told apart."""
WEAKEST: Final = 0.07
"""Root mean square change of the prediction over the noise below which an effect is of no use."""
_PUSHED: Final = 5.0
"""Samples after the touch over which the speed of the push is taken."""
_TURNS: Final = 5.0
"""What comes again does so at least this often in each trial."""
_RESOLVED: Final = 3.5
"""Samples of the encoders within a change of speed by which it is followed, and not guessed."""
_QUICK_GATE: Final = 20.0
"""Gain of what draws jumps out over less than a sample."""
_MOVED: Final = 5.0
"""What an effect does at a stop, over what an error of its moment would do, to be told there."""
_LOCAL: Final = 0.7
"""Part of what an effect does from which on it acts where the tool changes its speed only."""
_BESIDE: Final = 2
"""Samples before and after the start of the release that belong to it."""
_AT_ONCE: Final = 0.03
"""Samples within which what draws a jump out does not show."""
_BRIEF: Final = 3.0
_BRIEF_WAY: Final = 0.02
"""Part of the gain of what is over within so many samples that does not tell it from its like:
how the tool went within a sample is not known."""
_WAY: Final = 0.005
"""Part of the gain of what draws jumps out that does not tell it from its like, however long it
lasts: the way of the tool as it changes its speed is not known more exactly."""
_KNOWN: Final = 0.15
"""Samples to which the moments of jumps are known, below which that is no matter."""
BLUNT: Final = 1.0
"""Samples to which moments are known, above which a search is made as if they were known."""
_IN_TURN: Final = (np.geomspace(0.7, 1.6, 48), np.geomspace(0.97, 1.03, 24))
"""Sizes over a known one that are looked at where a search does not find its way."""
CERTAIN: Final = 40.0
"""Gain from which on an effect is there that acts in so few samples that `WEAKEST` misses it."""
_SECONDARY: Final = 0.15
"""A further effect is at least this share of the strongest: below it, forms are not exact."""
_SECOND_GAIN: Final = 0.05
"""It gains so much of what those before it have, if it shows only where jumps may be misplaced."""
_FORM: Final = 0.01
"""Part of its gain that does not tell a further effect from its like: the form of those before it
is not exact."""
_ROUGH: Final = 3
"""Starts above which a parameter is one that a search does not find its way to."""
_MOST: Final = 3
"""Effects that are added at most."""
_RIVAL: Final = 0.7
_NEAR_RIVAL: Final = 0.9
"""Part of the leader's gain from which on another may come first, if more than one is there, or
only the leader."""
_RIVALS: Final = 3
"""How many do."""
_STRIKING: Final = 200.0
"""Gain of a candidate from which on all that change the chain are fitted beside it."""
_CLOSER: Final = 4
"""How often sizes that a search does not find its way to are looked at."""
_CONTEST: Final = 3
"""Candidates that are searched for longer: those that may come first."""
_HOPEFUL: Final = 0.25
"""Part of the largest gain below which a longer search is in vain."""
_FIRST: Final = 10
_LATER: Final = 5
"""Candidates that are refitted, at first and beside effects that were accepted."""


@dataclass(frozen=True, slots=True)
class Strongest:
    """
    What was accepted so far.

    Parameters
    ----------
    strength, in_height, calm : float
        The largest strengths in all samples, in the displacement height alone, and where no jump
        is whose moment is not known.
    gain : float
        What all of it has gained by Schwarz's criterion.
    unscattered : float
        The largest strength of trials without scatter, as in `Trialled`.

    """

    strength: float = 0.0
    in_height: float = 0.0
    calm: float = 0.0
    gain: float = 0.0
    unscattered: float = 0.0


@dataclass(frozen=True, slots=True)
class Trialled:
    """
    A candidate beside a model without it.

    Parameters
    ----------
    effect : str
        Its name.
    score : float
        What it lowers the deviance by.
    gain : float
        What it gains by Schwarz's criterion.
    strength : float
        Root mean square change of the prediction over the noise.
    refit : Refit or None
        The model with it; None where the promise was too small to look further.
    release, stop : float
        What of the score the start of the release tells, and the stops that the encoders do not
        show, if the effect is over within a sample.
    in_height, height_score : float
        The strength in the displacement height alone, whose samples are few beside the force's,
        and what of the score these tell; that is zero where the heights show nothing of it.
    sure : float
        What it lowers the squares by where the arm's motion is seen, if the moments of jumps are
        known as well without it; infinite where it lasts for longer than a sample.
    calm : float
        The strength where no jump is whose moment is not known, if the effect gains anything.
    unscattered : float
        What `calm` would be if no trial had a scatter of its own, where trials scatter and the
        effect gains much: what goes from trial to trial as an effect would, scatter takes up, at a
        price.

    """

    effect: str
    score: float
    gain: float
    strength: float
    refit: Refit | None
    release: float = 0.0
    stop: float = 0.0
    in_height: float = 0.0
    height_score: float = 0.0
    sure: float = math.inf
    calm: float = 0.0
    unscattered: float = 0.0


@dataclass(frozen=True, slots=True)
class Round:
    """
    One step of the selection.

    Parameters
    ----------
    without : Refit
        The model before it.
    candidates : tuple of Trialled
        As `try_all` returns them.
    alike : tuple of str
        The leader and those that it does not lead clearly; empty if nothing was accepted.

    """

    without: Refit
    candidates: tuple[Trialled, ...]
    alike: tuple[str, ...]


def price(bench: Workbench, effect: str) -> float:
    """Return what an effect must lower the deviance by to be worth its parameters."""
    declared = BY_NAME[effect]
    # What a trial has of its own only its own samples tell.
    own = sum(math.log(max(samples, 1)) for samples in bench.samples_of)
    shared = len(declared.parameters) * math.log(bench.samples)
    return shared + len(declared.trial_parameters) * own


def worth(bench: Workbench, refit: Refit) -> float:
    """Return what a model leaves by Schwarz's criterion, constants apart."""
    return refit.deviance + sum(price(bench, name) for name in refit.model.effects)


def changes(bench: Workbench, one: Refit, other: Refit, *, calm: bool = False) -> FloatArray:
    """
    Return by what two models differ, sample by sample, over the noise of the second.

    Where only `calm` counts, the noise is larger by what either model does not know of the
    moments of jumps: a touch that one of them misplaces is no size of what it lacks.
    """
    parts = []
    force_noise, height_noise = other.force_noise.std, other.height_noise.std
    for index, trial in enumerate(bench.trials):
        a, b = _predicted(one, index), _predicted(other, index)
        weight = np.sqrt(trial.force_count)
        if calm:
            unknown = np.maximum(one.jumps[index], other.jumps[index])
            weight /= np.sqrt(1.0 + unknown * trial.force_count / force_noise**2)
        parts.append((a[0] - b[0]) / force_noise * weight)
        if trial.height_t.size:
            height = (a[1] - b[1]) / height_noise
            parts.append(height * np.sqrt(trial.height_count))
    return np.concatenate(parts)


def strength(bench: Workbench, one: Refit, other: Refit, *, calm: bool = False) -> float:
    """Return the root mean square of `changes` over all samples."""
    total = sum(float(t.force_count.sum() + t.height_count.sum()) for t in bench.trials)
    difference = changes(bench, one, other, calm=calm)
    return math.sqrt(float(difference @ difference) / total)


def strength_in_height(bench: Workbench, one: Refit, other: Refit) -> float:
    """Return the root mean square change of the displacement height alone, over its noise."""
    total = sum(float(trial.height_count.sum()) for trial in bench.trials)
    squares = 0.0
    for index, trial in enumerate(bench.trials):
        change = _predicted(one, index)[1] - _predicted(other, index)[1]
        squares += float(trial.height_count @ change**2)
    return math.sqrt(squares / total) / other.height_noise.std if total > 0.0 else 0.0


def fleeting(bench: Workbench, refit: Refit, effect: str) -> bool:
    """
    Return whether an effect only draws jumps of the force out over less than a sample.

    How a load cell takes its samples, and how exactly the moments are known at which the tool
    starts and stops, does the same: the sample is that of the slower of the two.
    """
    return _samples(bench, refit, effect) < 1.0


def _is_quick(effect: str) -> bool:
    """Return whether an effect is one that draws jumps of the force out."""
    return BY_NAME[effect].time_constant is not None


def _samples(bench: Workbench, refit: Refit, effect: str) -> float:
    """Return over how many samples an effect draws jumps out; infinite if that is not its kind."""
    time_constant = BY_NAME[effect].time_constant
    if time_constant is None:
        return math.inf
    trial = bench.trials[0]
    return time_constant(_values(refit)) / max(trial.interval, trial.path.interval)


def _shown(trial: FitTrial) -> bool:
    """
    Return whether the encoders show how the arm stops after the push of a trial.

    How it slows down in the air, and a withdrawal, which is quicker as a rule and shows less in
    the force, tell nothing of that.
    """
    return any(
        (bend.common or bend.lasts > _RESOLVED * trial.path.interval)
        for bend in trial.path.bends
        if bend.t > trial.t_contact
        and (trial.t_release is None or bend.t + 0.5 * bend.shape.duration < trial.t_release)
    )


def _withdrawal_shown(trial: FitTrial) -> bool:
    """Return whether the encoders show how the arm gathers speed for the withdrawal of a trial."""
    return any(
        bend.start < trial.t_release < bend.stop or abs(bend.start - trial.t_release) < bend.lasts
        for bend in trial.path.bends
        if trial.t_release is not None and bend.lasts > _RESOLVED * trial.path.interval
    )


def seldom(bench: Workbench, refit: Refit, effect: str) -> bool:
    """Return whether an effect that comes again does so too seldom in a trial to be one."""
    period = BY_NAME[effect].period
    if period is None:
        return False
    shortest = min(float(trial.t[-1] - trial.t[0]) for trial in bench.trials)
    # A slow sine follows anything that is smooth.
    return period(_values(refit)) > shortest / _TURNS


def within_a_sample(bench: Workbench, refit: Refit, effect: str) -> bool:
    """
    Return whether an offset of the touch is one that no touch is told from.

    It is then less than the tool goes by within half a sample of the force, and whether such a
    sample is of a moment or a mean is not known.
    """
    if without_law(effect) != 'contact_offset':
        return False
    ways = []
    for trial in bench.trials:
        later = trial.t_contact + np.array([0.0, _PUSHED]) * trial.interval
        way = np.diff(np.interp(later, trial.t, trial.displacement))
        ways.append(float(way[0]) / _PUSHED)
    return abs(_values(refit)['delta_0']) < 0.5 * float(np.median(ways))


def _values(refit: Refit) -> dict[str, float]:
    """Return the parameters of a model by name."""
    return dict(zip(refit.model.names, refit.model.values(refit.theta).tolist(), strict=True))


def try_all(
    bench: Workbench,
    without: Refit,
    names: Sequence[str],
    *,
    most: int = _FIRST,
    closely: bool = True,
    reached: float = 0.0,
    workers: int = 1,
    progress: Callable[[str], None] | None = None,
) -> tuple[Trialled, ...]:
    """
    Hold candidates against a model without them.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    without : Refit
        The model.
    names : sequence of str
        The candidates.
    most : int
        How many are refitted at most: those that promise most.
    closely : bool
        Whether those that may come first are searched for longer.
    reached : float
        The largest gain of others beside the same model.
    workers : int
        Processors.
    progress : callable, optional
        Told what is being done.

    Returns
    -------
    tuple of Trialled
        By gain, best first; those that were not refitted, and only promise a gain, last.

    """

    def tell(what: str) -> None:
        if progress is not None:
            progress(what)

    def look(name: str) -> Look:
        return bench.look(Model((*without.model.effects, name)), without)

    def one(name: str) -> Trialled:
        model = Model((*without.model.effects, name))
        refit = bench.refit(model, without, looks[name])
        if refit is None:
            return Trialled(name, 0.0, -price(bench, name), 0.0, None)
        return _trialled(bench, without, name, refit)

    def refitted(chosen: Sequence[str]) -> list[Trialled]:
        found = []
        for each in parallel.each(one, chosen, workers, bench.trials):
            tell(f'fitted with {each.effect}')
            found.append(each)
        return found

    def promised(name: str) -> Trialled:
        promise = max(looks[name].promise, 0.0)
        return Trialled(name, promise, promise - price(bench, name), 0.0, None)

    # What every start asks for is looked at once, and not by each worker.
    bench.scale(without)
    looks = dict[str, Look]()
    for name, found in zip(names, parallel.each(look, names, workers, bench.trials), strict=True):
        tell(f'trying {name}')
        looks[name] = found
    # The laws of an effect, which promise alike, take the place of one.
    promises = dict[str, float]()
    for name, looked in looks.items():
        effect = without_law(name)
        promises[effect] = max(promises.get(effect, -math.inf), looked.promise)
    least = sorted(promises.values(), reverse=True)[:most]
    worthy = [
        name for name in names if looks[name].promise >= max(price(bench, name) / 3.0, least[-1])
    ]
    tried = refitted(worthy)
    best = max(tried, key=lambda each: (each.refit is not None, each.gain), default=None)
    drawn = best is not None and best.gain > GATE and _is_quick(best.effect)
    missed = [name for name in names if name not in worthy]
    if drawn or without.blur.later > BLUNT:
        # Jumps of moments that are not known promise nothing to some that draw them out.
        tried += refitted([name for name in missed if _is_quick(name)])
    if best is not None and best.gain > _STRIKING:
        # What makes another chain may move the body so far that one step promises nothing.
        known = {each.effect for each in tried}
        tried += refitted([n for n in missed if n not in known and BY_NAME[n].shape is not None])
    known = {each.effect for each in tried}
    tried += [promised(name) for name in names if name not in known]
    # What was refitted comes before what only promised something.
    tried.sort(key=lambda each: (each.refit is None, -each.gain))
    if closely:
        blunt = without.blur.later > BLUNT
        # As many effects, and not only laws of one.
        first = {without_law(each.effect): place for place, each in reversed([*enumerate(tried)])}
        contest = {*range(_CONTEST), *sorted(first.values())[:_CONTEST]}
        largest = max((reached, *(each.gain for each in tried if each.refit is not None)))
        hopeful = max(GATE, _HOPEFUL * largest)
        chosen = [
            place
            for place, each in enumerate(tried)
            if each.refit is not None
            # What moments that are not known hide has no gain yet to be told by.
            and ((place in contest and each.gain >= hopeful) or (blunt and _is_quick(each.effect)))
        ]

        def closer(place: int) -> Trialled:
            return _closer(bench, without, tried[place])

        found_closer = parallel.each(closer, chosen, workers, bench.trials)
        for place, better in zip(chosen, found_closer, strict=True):
            tried[place] = better
    return tuple(sorted(tried, key=lambda each: (each.refit is None, -each.gain)))


def _closer(bench: Workbench, without: Refit, found: Trialled) -> Trialled:
    """Return a candidate after a longer search."""
    assert found.refit is not None
    known = near = found.refit
    rough = any(len(p.scan) > _ROUGH for p in BY_NAME[found.effect].parameters)
    if rough:
        # Looked for anew where the noise is known better.
        near = replace(
            without,
            force_noise=known.force_noise,
            height_noise=known.height_noise,
            blur=known.blur,
            jumps=known.jumps,
        )
    best, starts = known, [near]
    for _ in range(_CLOSER):
        if rough or max(known.blur) > BLUNT:
            starts += _sharper(bench, known, found.effect)
        for start in starts:
            again = bench.refit(known.model, start)
            if again is not None and again.deviance < best.deviance:
                best = again
        if not rough or best.deviance > known.deviance - LEAD:
            break
        # Beside what has moved with it another size may be better.
        known, starts = best, []
    if best is found.refit:
        return found
    return _trialled(bench, without, found.effect, best)


def _sharper(bench: Workbench, known: Refit, effect: str) -> list[Refit]:
    """
    Return starts for a refit: one as if its moments were known, and one of another size.

    A jump that may come at any time has no say in how large it is. Where a search does not find
    its way to a size, others near it are looked at, the best by what they leave once everything
    else has moved by a step.
    """
    jumps = known.problem.unsure(known.state, SHARPEST)
    sharp = replace(known, blur=SHARPEST, jumps=jumps)
    starts = [sharp]
    if max(known.blur) > BLUNT:
        known = sharp
    rough = [p.symbol for p in BY_NAME[effect].parameters if len(p.scan) > _ROUGH]
    if rough:
        problem = Problem(known.model, known.problem.trials, known.problem.scatter)
        state = known.state
        # What two of them do together is looked at in turn, and then more finely.
        for sizes, symbol in product(_IN_TURN, rough):
            values = known.model.values(state[: problem.p])
            place = known.model.names.index(symbol)
            others = []
            for size in values[place] * sizes:
                values[place] = size
                other = state.copy()
                other[: values.size] = known.model.theta(values)
                others.append(other)
            held = [known.model.names.index(name) for name in rough]
            state = others[int(np.argmin(bench.leaves_after(problem, others, known, held)))]
        jumps = problem.unsure(state, known.blur)
        starts.append(replace(known, state=state, jumps=jumps))
    return starts


def _trialled(bench: Workbench, without: Refit, effect: str, refit: Refit) -> Trialled:
    """Return a candidate that was refitted."""
    score = max(without.deviance - refit.deviance, 0.0)
    gain = score - price(bench, effect)
    release = stop = 0.0
    sure = math.inf
    if gain > GATE:
        brief = fleeting(bench, refit, effect)
        shown, local = _stops_shown(bench, without, refit)
        if brief or local:
            before, after = (np.array(_by_place(bench, r, shown, r)) for r in (without, refit))
            release, stop = np.maximum(before - after, 0.0)[:2].tolist()
            # How the tool leaves is no less than how it is held, but for what is over at once.
            release = release if brief else 0.0
            if brief:
                # What only has other moments known better, by a trial that no model follows.
                sure = _by_place(bench, without, shown, refit)[2] - float(after[2])
    in_height = strength_in_height(bench, refit, without)
    told = 0.0
    if in_height > WEAKEST or _is_quick(effect):
        told = _told_by_heights(bench, without) - _told_by_heights(bench, refit)
    size = strength(bench, refit, without)
    calm = strength(bench, refit, without, calm=True) if gain > GATE else 0.0
    unscattered = 0.0
    if bench.scatter is not None and gain > CERTAIN:
        both = _without_scatter(refit), _without_scatter(without)
        unscattered = strength(bench, *both, calm=True)
    return Trialled(
        effect, score, gain, size, refit, release, stop, in_height, told, sure, calm, unscattered
    )


def _without_scatter(refit: Refit) -> Refit:
    """Return a model as it would be of trials that are alike."""
    state = refit.state.copy()
    for index in range(len(refit.problem.trials)):
        state[refit.problem.scattered(index)] = 0.0
    return replace(refit, state=state)


def _told_by_heights(bench: Workbench, refit: Refit) -> float:
    """Return the part of the deviance that is told by the displacement heights."""
    told = 0.0
    filters = bench.whiteners(refit.force_noise, refit.height_noise, refit.jumps)
    for index, (_, white) in enumerate(filters):
        if white is not None:
            residual = bench.residual(refit.problem, refit.state, index)[1]
            told += float(np.sum(white(residual[np.newaxis]) ** 2)) + white.log_determinant
    return told


def _stops_shown(bench: Workbench, without: Refit, refit: Refit) -> tuple[tuple[bool, ...], bool]:
    """
    Return which stops are seen well enough to tell an effect, and whether it acts at events only.

    At a stop an effect does what a stop a little earlier or later would do; how exactly the
    encoders tell when it was decides whether it is the effect.
    """
    shown = []
    near = total = 0.0
    for index, trial in enumerate(bench.trials):
        before, after = _predicted(without, index)[0], _predicted(refit, index)[0]
        change = (after - before) ** 2 * trial.force_count
        at_stops = [_about(trial, t) for t in trial.stops]
        stop = np.logical_or.reduce(at_stops)
        at_events = stop | _about(trial, trial.t_contact)
        if trial.t_release is not None:
            at_events |= _about(trial, trial.t_release)
        near += float(change[at_events].sum())
        total += float(change.sum())
        slope = np.gradient(before, trial.middle) if trial.middle.size > 1 else before * 0.0
        moved = sum(
            float(((slope * _moment_error(trial, t)) ** 2 * trial.force_count)[there].sum())
            for t, there in zip(trial.stops, at_stops, strict=True)
        )
        seen = _shown(trial) and change[stop].sum() > _MOVED**2 * moved
        shown.append(bool(seen))
    return tuple(shown), near > _LOCAL * total


def _about(trial: FitTrial, t: float) -> NDArray[np.bool_]:
    """Return the steps in which the tool changes its speed at an event."""
    reach = _RESOLVED * trial.path.interval
    first, last = t - reach, t + reach
    for bend in trial.path.bends:
        if bend.start < t < bend.stop:
            first, last = min(first, bend.start), max(last, bend.stop)
    return np.asarray((trial.middle > first) & (trial.middle < last))


def _moment_error(trial: FitTrial, t: float) -> float:
    """Return how exactly the encoders tell when the tool stopped, as a standard error [s]."""
    near = [bend.error for bend in trial.path.bends if bend.start < t < bend.stop]
    return near[0] if near else trial.path.interval


def _by_place(
    bench: Workbench, refit: Refit, shown: Sequence[bool], like: Refit
) -> tuple[float, float, float]:
    """
    Return the parts of the force's deviance by how well the arm's motion is seen.

    The first is told by the start of the releases, where the way within a sample decides when the
    tool leaves; the second by the stops that are not `shown`, one for each trial, with all of a
    short push; the last by all else. The noise and the moments of jumps are those of `like`.
    """
    release = stop = seen = 0.0
    filters = bench.whiteners(like.force_noise, like.height_noise, like.jumps)
    for index, (trial, (white, _)) in enumerate(zip(bench.trials, filters, strict=True)):
        residual, _ = bench.residual(refit.problem, refit.state, index)
        told = white.weight > 0.0
        parts = np.zeros(told.size)
        parts[told] = (white(residual[np.newaxis])[0] ** 2)[told]
        parts[told] -= 2.0 * np.log(white.weight[told])
        seen += float(parts.sum())
        if trial.t_release is not None and not _withdrawal_shown(trial):
            stops = [bend.stop for bend in trial.path.bends if bend.stop > trial.t_release]
            first = trial.t_release - _BESIDE * trial.interval
            # It may be seen as several changes of speed, or as none.
            least = trial.t_release + _RESOLVED * trial.path.interval
            last = max([least, *stops[:1]]) + _BESIDE * trial.interval
            release += float(parts[(trial.middle > first) & (trial.middle < last)].sum())
        if not shown[index]:
            unseen = np.logical_or.reduce([_about(trial, t) for t in trial.stops])
            if trial.t_stop - trial.t_contact < 2.0 * _RESOLVED * trial.path.interval:
                # The tool may slow down at the touch already.
                first = trial.t_contact - _RESOLVED * trial.path.interval
                unseen |= (trial.middle > first) & (trial.middle < trial.t_stop)
            stop += float(parts[unseen].sum())
    return release, stop, seen - release - stop


def candidates_for(model: Model, names: Sequence[str]) -> list[str]:
    """Return the effects that a model can still take."""
    excluded = {other for name in model.effects for other in BY_NAME[name].excludes}
    excluded |= {e.name for e in EVERY_LAW if set(e.excludes) & set(model.effects)}
    # An effect follows one law.
    taken = {without_law(name) for name in model.effects}
    return [name for name in names if without_law(name) not in taken and name not in excluded]


def select(
    bench: Workbench,
    base: Refit,
    names: Sequence[str],
    *,
    workers: int = 1,
    progress: Callable[[str], None] | None = None,
    known: Sequence[Round] = (),
    later: Sequence[Sequence[str]] = (),
    rivals: Sequence[str] | None = None,
    closely: bool = True,
) -> tuple[Refit, tuple[Round, ...]]:
    """
    Add effects to a model as long as one gains clearly.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    base : Refit
        The model to begin with.
    names : sequence of str
        The candidates.
    workers : int
        Processors.
    progress : callable, optional
        Told what is being done.
    known : sequence of Round
        Of a selection among fewer: what was held against the same model is not tried again.
    later : sequence of (sequence of str)
        Further candidates once one effect, two, and so on were accepted.
    rivals : sequence of str, optional
        What may come first although it does not lead; by default what comes near to it.
    closely : bool
        Whether those that may come first are searched for longer.

    Returns
    -------
    chosen : Refit
        The model with what was accepted.
    rounds : tuple of Round
        How it came to that; the last has accepted nothing unless the most effects are reached.

    """

    def forward(first: str | None, known: Sequence[Round]) -> _Path:
        return _forward(
            bench,
            base,
            names,
            first=first,
            workers=workers,
            progress=progress,
            known=known,
            later=later,
            closely=closely,
        )

    path = forward(None, known)
    order = [each.alike[0] for each in path[1] if each.alike]
    if not order:
        return path
    # What comes first by itself need not be part of what is best together.
    begin = replace(path[1][0], alike=())
    others = _rivals(bench, begin, order)
    if rivals is not None:
        others = [name for name in rivals if name != order[0]]
    paths = [path, *(forward(name, (begin,)) for name in others)]
    return _best(bench, [each for each in paths if each[1][0].alike])


def _rivals(bench: Workbench, first: Round, order: Sequence[str]) -> list[str]:
    """Return what may be part of the best model, beside what leads to those in `order`."""
    least = (_RIVAL if len(order) > 1 else _NEAR_RIVAL) * first.candidates[0].gain
    brief = _briefly(bench, first)
    best = dict[str, str]()
    for each in first.candidates:
        # What draws jumps out alike leaves the same to others.
        alike = {order[0], each.effect} <= brief
        if each.refit is not None and each.gain > least and not alike:
            best.setdefault(without_law(each.effect), each.effect)
    # The laws of an effect are one rival, and no rival of one another.
    best.pop(without_law(order[0]), None)
    return list(best.values())[:_RIVALS]


def _briefly(bench: Workbench, first: Round) -> set[str]:
    """Return the candidates that draw jumps out over a few samples only."""
    return {
        each.effect
        for each in first.candidates
        if each.refit is not None and _samples(bench, each.refit, each.effect) < _BRIEF
    }


type _Path = tuple[Refit, tuple[Round, ...]]


def _forward(
    bench: Workbench,
    base: Refit,
    names: Sequence[str],
    *,
    first: str | None,
    workers: int,
    progress: Callable[[str], None] | None,
    known: Sequence[Round],
    later: Sequence[Sequence[str]],
    closely: bool,
) -> _Path:
    """Return what `select` does, with an effect that comes first whichever leads."""
    current, rounds, strongest = base, list[Round](), Strongest()
    while len(rounds) < _MOST:
        added = [name for more in later[: len(rounds)] for name in more]
        open_ = candidates_for(current.model, list(dict.fromkeys((*names, *added))))
        before: tuple[Trialled, ...] = ()
        if len(rounds) < len(known):
            past = known[len(rounds)]
            if past.without.model == current.model and past.without.deviance <= current.deviance:
                current, before = past.without, past.candidates
        tried = try_all(
            bench,
            current,
            [name for name in open_ if all(name != each.effect for each in before)],
            most=_LATER if rounds else _FIRST,
            closely=closely,
            reached=before[0].gain if before else 0.0,
            workers=workers,
            progress=progress,
        )
        tried = tuple(sorted((*before, *tried), key=lambda e: (e.refit is None, -e.gain)))
        good = _good(bench, current, tried, strongest)
        if first is not None and not rounds:
            # Those that gain more stay its rivals.
            good.sort(key=lambda each: each.effect != first)
            if not good or good[0].effect != first:
                return current, (Round(current, tried, ()),)
        elif good and good[0].refit is not None:
            # What the search for the larger model has found may serve the smaller one as well.
            closer = bench.refit(current.model, good[0].refit)
            if closer is not None and closer.deviance < current.deviance:
                tried = _against(bench, tried, current, closer)
                current = closer
                good = _good(bench, current, tried, strongest)
        if not good or good[0].refit is None:
            rounds.append(Round(current, tried, ()))
            break
        leader = good[0]
        others = _as_quick(bench, tried, good)
        near = _near(bench, [*good, *others], {each.effect for each in others})
        alike = tuple(each.effect for each in near)
        rounds.append(Round(current, tried, alike))
        calm = strength(bench, good[0].refit, current, calm=True)
        whole = calm
        if fleeting(bench, good[0].refit, leader.effect):
            whole = strength(bench, good[0].refit, current)
        strongest = Strongest(
            max(strongest.strength, whole),
            max(strongest.in_height, leader.in_height),
            max(strongest.calm, calm),
            strongest.gain + leader.gain,
            max(strongest.unscattered, leader.unscattered),
        )
        current = good[0].refit
    return current, tuple(rounds)


def _best(bench: Workbench, paths: Sequence[_Path]) -> _Path:
    """
    Return the best of some models, the first of which is that of the leaders.

    Effects whose models are not told from the best are alike, whatever they gain by themselves,
    and those whose models are, are not. How jumps are drawn out the first round tells as well.
    """
    # Of several that have come to the same effects, one after another, the best.
    ways = dict[frozenset[str], tuple[float, _Path]]()
    for path in paths:
        effects, total = frozenset(path[0].model.effects), worth(bench, path[0])
        if effects not in ways or total < ways[effects][0]:
            ways[effects] = total, path
    totals, paths = zip(*ways.values(), strict=True)
    orders = [[each.alike[0] for each in rounds if each.alike] for _, rounds in paths]
    good = [k for k, total in enumerate(totals) if total < min(totals) + LEAD]
    fewest = min(len(orders[k]) for k in good)
    # Of those that are not told apart, the simplest.
    near = [k for k in good if len(orders[k]) == fewest]
    best = min(near, key=lambda k: totals[k])
    order, (model, rounds) = orders[best], paths[best]
    mine = set(map(without_law, order))
    rivals: list[list[str]] = [[] for _ in order]
    for k in near:
        # What both have is no rival of what only one of them has, whichever law it follows.
        theirs = set(map(without_law, orders[k]))
        places = [place for place, name in enumerate(order) if without_law(name) not in theirs]
        names = [name for name in orders[k] if without_law(name) not in mine]
        for place, name in zip(places, names, strict=True):
            rivals[place].append(name)
    others = {without_law(orders[k][0]) for k in range(len(paths)) if k not in good or k in near}
    brief = _briefly(bench, rounds[0])
    kept = {*rivals[0], order[0], *(brief if order[0] in brief else ())}
    others = others.difference(map(without_law, kept))
    alike = tuple(name for name in rounds[0].alike if without_law(name) not in others)
    told = [replace(rounds[0], alike=alike), *rounds[1:]]
    for place, names in enumerate(rivals):
        told[place] = _with_rivals(bench, told[place], names)
    return model, tuple(told)


def _with_rivals(bench: Workbench, found: Round, names: Sequence[str]) -> Round:
    """Return a round with rivals of its leader, which are refitted if they were not."""
    tried = {each.effect: each for each in found.candidates}
    alike = dict.fromkeys(found.alike)
    for name in names:
        if (name not in tried or tried[name].refit is None) and candidates_for(
            found.without.model, [name]
        ):
            refit = bench.refit(Model((*found.without.model.effects, name)), found.without)
            if refit is not None:
                tried[name] = _trialled(bench, found.without, name, refit)
        if name in tried and tried[name].refit is not None:
            alike[name] = None
    candidates = sorted(tried.values(), key=lambda each: (each.refit is None, -each.gain))
    return replace(found, candidates=tuple(candidates), alike=tuple(alike))


def _as_quick(
    bench: Workbench, tried: Sequence[Trialled], good: Sequence[Trialled]
) -> list[Trialled]:
    """Return what draws jumps out as the leader does, and has only missed a limit itself."""
    leader = good[0]
    if leader.refit is None or not fleeting(bench, leader.refit, leader.effect):
        return []
    return [
        each
        for each in tried
        if each.refit is not None and each not in good and fleeting(bench, each.refit, each.effect)
    ]


def _near(
    bench: Workbench, good: Sequence[Trialled], missed: Collection[str] = ()
) -> list[Trialled]:
    """
    Return the leader of some candidates, best first, and those that are not told from it.

    A single name is right in 99 % if it leads by so much. From the third on, half of that sets one
    aside: two that are left hold the right one as surely as a set is asked to.
    """
    leader = good[0]
    near = sorted(_within(bench, good, 1.0), key=lambda each: (each is not leader, -each.gain))
    near = [each for each in near if each is leader or not _more_of(bench, each, near)]
    closer = {each.effect for each in _within(bench, good, _THIRD)}
    # The laws of an effect are one name, and what has missed a limit itself comes last.
    taken = sorted(near, key=lambda each: each.effect in missed)
    pair = list(dict.fromkeys(without_law(each.effect) for each in taken))[:_PAIR]
    return [e for e in near if without_law(e.effect) in pair or e.effect in closer]


def _within(bench: Workbench, good: Sequence[Trialled], part: float) -> list[Trialled]:
    """Return the leader and those within a part of the lead that tells an effect from it."""
    leader = good[0]
    assert leader.refit is not None
    lead = part * LEAD
    if len(leader.refit.model.effects) > 1:
        lead = max(lead, part * _FORM * leader.gain)
    enough = leader.gain - lead
    samples = _samples(bench, leader.refit, leader.effect)
    if samples >= _BRIEF:
        alike = enough
        if math.isfinite(samples):
            alike = min(enough, (1.0 - part * _WAY) * leader.gain)
        return [
            each
            for each in good
            if (each.gain if _is_quick(leader.effect) else _at_less_cost(each, leader)) > enough
            or (_is_quick(each.effect) and each.gain > alike and _heights_alike(each, leader))
        ]
    if leader.refit.blur.later > _KNOWN:
        enough = min(enough, (1.0 - part * _BRIEF_WAY) * leader.gain)
    # Nor does it count between them how the arm moved unseen.
    seen = _seen(leader) - lead
    return [
        each
        for each in good
        if each.gain > leader.gain - lead
        or ((each.gain > enough or _seen(each) > seen) and _heights_alike(each, leader))
    ]


def _at_less_cost(each: Trialled, leader: Trialled) -> float:
    """
    Return the gain of a rival, if what it costs more than the leader counts in part.

    What a parameter costs is for a model that may do without it, and tells two effects of
    different numbers of parameters apart where the data do not. What has the leader as a limit
    never leaves more than that, and nothing but the cost tells the two apart.
    """
    if leader.effect in BY_NAME[each.effect].limits:
        return each.gain
    more = (each.score - each.gain) - (leader.score - leader.gain)
    return each.gain + (1.0 - _COST) * max(more, 0.0)


def _heights_alike(each: Trialled, leader: Trialled) -> bool:
    """Return whether the heights, which jumps do not matter to, speak no less for one effect."""
    return each.height_score > leader.height_score - LEAD


def _seen(each: Trialled) -> float:
    """Return the gain of a candidate without what is told where the arm's motion is not seen."""
    return each.gain - each.release - each.stop


def _more_of(bench: Workbench, one: Trialled, others: Sequence[Trialled]) -> bool:
    """Return whether an effect is within a sample one of the others with a parameter too many."""
    simpler = set(BY_NAME[one.effect].generalises) & {each.effect for each in others}
    return bool(simpler) and one.refit is not None and fleeting(bench, one.refit, one.effect)


def told_by_one_step(bench: Workbench, without: Refit, refit: Refit) -> float:
    """
    Return the most that an effect takes out at any one step of the force.

    No effect acts for a single step. One that is far off, as where the tool's way is not known, is
    lowered by many effects a little; without it such an effect must gain something as well.
    """
    most = 0.0
    # Beside the noise of a model that explains much, each step without it is far off.
    filters = bench.whiteners(without.force_noise, without.height_noise, without.jumps)
    for index, (white, _) in enumerate(filters):
        left = [bench.residual(each.problem, each.state, index)[0] for each in (without, refit)]
        before, after = white(np.array(left)) ** 2
        most = max(most, float(np.max(before - after, initial=0.0)))
    return most


def _good(
    bench: Workbench, without: Refit, tried: Sequence[Trialled], strongest: Strongest
) -> list[Trialled]:
    """Return the candidates that may be accepted beside what was so far, best first."""
    weakest = max(WEAKEST, _SECONDARY * strongest.strength)
    weakest_in_height = max(WEAKEST, _SECONDARY * strongest.in_height)
    # What draws jumps out is strong there only, and what lasts is held against what lasts.
    weakest_calm = max(WEAKEST, _SECONDARY * strongest.calm)
    weakest_unscattered = max(WEAKEST, _SECONDARY * strongest.unscattered)
    certain = max(CERTAIN, _SECOND_GAIN * strongest.gain)
    refused = drawn_out(bench, tried)

    def heights_tell(each: Trialled) -> bool:
        # A few heights are weak beside many forces, and so is what only they show.
        return each.in_height > weakest_in_height and each.height_score > CERTAIN

    def enough(each: Trialled, refit: Refit) -> bool:
        if not fleeting(bench, refit, each.effect):
            seen = each.strength > weakest_calm
            if strongest.strength > 0.0:
                # What is off in the form of an effect is made up for where jumps are misplaced.
                seen &= each.calm > weakest_calm or each.gain > certain
            else:
                # What acts for a short while, such as adhesion, is weak over whole trials.
                seen |= each.gain > CERTAIN
            # What differs between trials scatter may take up in all of them.
            seen |= each.unscattered > weakest_unscattered
            return (seen and _seen(each) > GATE) or heights_tell(each)
        # How a jump is drawn out does not matter to the heights.
        told = min(_seen(each), each.sure)
        drawn = _draws_out(bench, each, weakest, told) and told >= _SECOND_GAIN * strongest.gain
        if not drawn and not heights_tell(each):
            return False
        # What a simpler one tells as well is not there where that one is refused.
        simpler = [e for e in tried if e.effect in BY_NAME[each.effect].generalises]
        return all(
            e.gain < each.gain or (e.refit is not None and enough(e, e.refit)) for e in simpler
        )

    good = [
        each
        for each in tried
        if each.refit is not None
        and enough(each, each.refit)
        and not seldom(bench, each.refit, each.effect)
        and not within_a_sample(bench, each.refit, each.effect)
        and each.gain > told_by_one_step(bench, without, each.refit)
    ]
    return [each for each in good if _beside(bench, each, refused) > GATE]


def _beside(bench: Workbench, each: Trialled, refused: Sequence[Trialled]) -> float:
    """
    Return the gain of a candidate where those that are refused may act.

    Jumps are drawn out whether or not the encoders show by what: an effect that does not clearly
    gain more than that, and nothing beside it, may only have taken some of it.
    """
    gains = [each.gain]
    lead = 0.0 if _is_quick(each.effect) else LEAD
    for other in refused:
        if other.refit is None or each.gain - other.gain >= lead:
            continue
        if each.effect not in candidates_for(other.refit.model, [each.effect]):
            continue
        both = bench.refit(Model((*other.refit.model.effects, each.effect)), other.refit)
        if both is not None:
            gains.append(other.refit.deviance - both.deviance - price(bench, each.effect))
            break
    return min(gains)


def drawn_out(bench: Workbench, tried: Sequence[Trialled]) -> tuple[Trialled, ...]:
    """
    Return the effects that draw jumps out and are refused for what the encoders do not show.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    tried : sequence of Trialled
        Candidates beside a model.

    Returns
    -------
    tuple of Trialled
        Those that might be accepted if the encoders showed how the arm stops, and those that are
        over at once, and only change what a jump is said to be.

    """

    def refused(each: Trialled, refit: Refit) -> bool:
        if each.gain - each.release <= _QUICK_GATE or each.strength <= WEAKEST:
            return False
        if _samples(bench, refit, each.effect) <= _AT_ONCE:
            return True
        return fleeting(bench, refit, each.effect) and not _draws_out(
            bench, each, WEAKEST, min(_seen(each), each.sure)
        )

    return tuple(each for each in tried if each.refit is not None and refused(each, each.refit))


def _draws_out(bench: Workbench, each: Trialled, weakest: float, gain: float) -> bool:
    """Return whether a candidate is seen to draw jumps out, over less than a sample."""
    if each.refit is None or gain <= _QUICK_GATE or each.strength <= weakest:
        return False
    # What is over at once only changes what a jump is said to be.
    return _AT_ONCE < _samples(bench, each.refit, each.effect) < 1.0


def _against(
    bench: Workbench, tried: Sequence[Trialled], old: Refit, new: Refit
) -> tuple[Trialled, ...]:
    """Return the candidates beside a better fit of the model without them."""
    less = old.deviance - new.deviance
    by_heights = _told_by_heights(bench, old) - _told_by_heights(bench, new)
    return tuple(
        replace(
            each,
            score=max(each.score - less, 0.0),
            gain=each.gain - less,
            height_score=each.height_score - by_heights,
        )
        for each in tried
    )


def eliminate(
    bench: Workbench, chosen: Refit, rounds: Sequence[Round], *, workers: int = 1
) -> tuple[Refit, tuple[str, ...]]:
    """
    Take out effects that later ones have made superfluous.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    chosen : Refit
        The model with all accepted effects.
    rounds : sequence of Round
        How they were accepted.
    workers : int
        Processors.

    Returns
    -------
    chosen : Refit
        The model with those that are needed.
    order : tuple of str
        These, in the order of their adding.

    """
    order = [each.alike[0] for each in rounds if each.alike]

    def without(name: str) -> Refit | None:
        return bench.refit(Model(tuple(n for n in order if n != name)), chosen)

    while len(order) > 1:
        losses = []
        all_fewer = parallel.each(without, order, workers, bench.trials)
        for name, fewer in zip(order, all_fewer, strict=True):
            if fewer is not None:
                loss = fewer.deviance - chosen.deviance - price(bench, name)
                losses.append((loss, name, fewer))
        least = min(losses, key=lambda each: each[0], default=None)
        if least is None or least[0] > GATE:
            break
        chosen = least[2]
        order.remove(least[1])
    return chosen, tuple(order)


def _predicted(refit: Refit, index: int) -> tuple[FloatArray, FloatArray]:
    """Return the force and the height of a trial as the sensors show them by a model."""
    prediction = refit.problem.predict(refit.state, index, directions=False)
    _, force, height = refit.problem.own(refit.state, index)
    return prediction.force + force, prediction.height + height
