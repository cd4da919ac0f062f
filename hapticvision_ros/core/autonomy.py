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
What an experiment does after its grid: which push comes next, and when there is enough.

`look` asks the diagnosis what the trials recorded so far tell; `decide` weighs its answer against
the budget. Both know the trials as they were measured and nothing else. What only `look` needs is
imported there, since the orchestrator decides and another process looks.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from enum import Enum
import math
from types import MappingProxyType
from typing import Any, Final, Literal, TYPE_CHECKING

from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.push_control import expected_duration, PushGoal, PushLimits
from hapticvision_ros.core.units import MM

if TYPE_CHECKING:
    from hapticvision_ros.core.diagnosis.design import PushLimits as Reach
    from hapticvision_ros.core.pipeline import TrialAnalysis
    from hapticvision_ros.core.records import Trial

type Progress = Callable[[str], None]
"""Told what is being done, in a few words."""
type Purpose = Literal['separate', 'sharpen', 'repeat', 'explore', 'test']

LEAST_SEPARATION: Final = 1.0
"""A push that is expected to part two effects by less helps nobody [standard deviations]."""
LEAST_SHARPENING: Final = 1.05
"""A push that is expected to make an error smaller by less than this factor helps nobody."""
PATIENCE: Final = 3
"""Pushes in a row that may be made for the same question."""
SPREAD: Final = 3.0
"""Factor by which a chosen push may be slower, and its hold longer, than those of the grid."""
LIKE: Final = math.log(1.3)
"""Sum of the differences of the logarithms of speed and hold of two pushes that are alike."""
DIGITS: Final = 3
"""Of speed, depth and hold of a push."""
_UNROUNDED: Final = 1.0 + 10.0 ** (1 - DIGITS)
"""Over what it becomes in so many digits, at most."""


class Ending(Enum):
    """Why no further push is made."""

    DECIDED = 'decided'
    TIGHT = 'tight enough'
    BUDGET = 'budget spent'
    NOTHING_HELPS = 'no trial can help'
    SCATTER = 'scatter cannot be told'
    FAILED = 'the analysis failed'


@dataclass(frozen=True, slots=True)
class Budget:
    """
    How long an experiment may go on after its grid.

    Parameters
    ----------
    trials : int
        Pushes at most, failed ones included.
    time : float
        Time from the end of the grid until the end of the last push [s]; 0 for no limit.
    precision : float
        Relative standard error that every parameter of the model is to reach; 0 to stop as soon
        as the effect is decided.

    Raises
    ------
    UsageError
        If a number makes no sense.

    """

    trials: int
    time: float = 0.0
    precision: float = 0.0

    def __post_init__(self) -> None:
        if self.trials < 1:
            raise UsageError(f'budget_trials is {self.trials}: give 1 or more.')
        for name, value in (('budget_time', self.time), ('precision', self.precision)):
            if not (math.isfinite(value) and value >= 0.0):
                raise UsageError(f'{name} is {value:g}: give a finite number, 0 or more.')


@dataclass(frozen=True, slots=True)
class Parameter:
    """
    A parameter of the model as the trials tell it.

    Parameters
    ----------
    value, std : float or None
        Estimate and standard error in SI units; None where the trials cannot tell.
    unit : str
        SI unit.

    """

    value: float | None
    std: float | None
    unit: str

    @property
    def error(self) -> float:
        """Return the relative standard error; infinite where the trials cannot tell."""
        if self.value is None or self.std is None or self.value == 0.0:
            return math.inf
        return self.std / abs(self.value)


@dataclass(frozen=True, slots=True)
class Push:
    """
    A push that would tell something.

    Parameters
    ----------
    purpose : {'separate', 'sharpen', 'repeat', 'explore', 'test'}
        Whether it tells two effects apart, makes a parameter's error smaller, repeats one that
        was made, or differs from them: in the hope that it shows what no effect explains, or to
        test an answer.
    push_speed, depth, hold_time : float
        The push [m/s, m, s].
    about : tuple of str
        The effects, or the parameter.
    gain : float
        What is expected of it: standard deviations between two effects, or the factor on an
        error. Of a repeat nothing is expected.
    reason : str
        Why, as a sentence.
    like : int or None
        Which of the trials a repeat is of, from 0.

    """

    purpose: Purpose
    push_speed: float
    depth: float
    hold_time: float
    about: tuple[str, ...]
    gain: float
    reason: str
    like: int | None = None

    @property
    def worthwhile(self) -> bool:
        """Whether enough is expected of it."""
        if self.purpose == 'repeat':
            return True
        # Of a push that differs as much is asked as of one that sharpens: it has the gain of that.
        least = LEAST_SEPARATION if self.purpose == 'separate' else LEAST_SHARPENING
        return self.gain >= least


@dataclass(frozen=True, slots=True)
class Findings:
    """
    What the trials so far tell: the part of a diagnosis by which an experiment goes on.

    Parameters
    ----------
    status : str
        The diagnosis's answer.
    effects : tuple of str
        Accepted effects.
    sets : tuple of (tuple of str)
        For each, those that the trials cannot tell from it, itself first.
    parameters : mapping of str to Parameter
        Of the model with the accepted effects.
    rest : tuple of str
        What is known of what no effect explains.
    trials : int
        How many were looked at.
    kinds : int
        How many different pushes are among them.
    push : Push or None
        What the diagnosis would push next.
    repeat : Push or None
        Which push is worth a repeat.
    other : Push or None
        The push within the limits of the cell that is least like those that were made; None if
        all are like one of them.
    warnings : tuple of str
        What a reader must know.

    """

    status: str
    effects: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    parameters: Mapping[str, Parameter]
    rest: tuple[str, ...] = ()
    trials: int = 1
    kinds: int = 1
    push: Push | None = None
    repeat: Push | None = None
    other: Push | None = None
    warnings: tuple[str, ...] = ()

    @property
    def confounded(self) -> tuple[str, ...]:
        """Return the first set of effects that are not told apart; empty if all are."""
        return next((alike for alike in self.sets if len(alike) > 1), ())

    @property
    def has_rest(self) -> bool:
        """Whether something is left that no effect explains."""
        return self.status in ('partly_explained', 'unexplained')

    @property
    def least_known(self) -> tuple[str, float]:
        """Return the parameter with the largest relative error, and this error."""
        errors = {name: each.error for name, each in self.parameters.items()}
        return max(errors.items(), key=lambda item: item[1], default=('', 0.0))

    @property
    def sentence(self) -> str:
        """Return the answer in one sentence, without its full stop."""
        answer = self.status.replace('_', ' ')
        if self.sets:
            answer += ' by ' + ' and '.join(' or '.join(alike) for alike in self.sets)
        name, error = self.least_known
        if not name:
            return answer
        if math.isinf(error):
            return f'{answer}; the trials do not tell {name}'
        return f'{answer}; least known is {name}, to {100.0 * error:.2g} %'

    def among(self, places: Sequence[int], left_out: Sequence[str]) -> 'Findings':
        """
        Return what was found in some of the trials in terms of all of them.

        Parameters
        ----------
        places : sequence of int
            Which of all trials those looked at are, from 0.
        left_out : sequence of str
            Why the others were not, as sentences.

        Returns
        -------
        Findings
            The same, with the place of the trial that is worth a repeat, and warnings.

        """
        repeat = self.repeat
        if repeat is not None and repeat.like is not None:
            repeat = replace(repeat, like=places[repeat.like])
        return replace(self, repeat=repeat, warnings=(*left_out, *self.warnings))

    def document(self) -> dict[str, Any]:
        """Return plain lists, mappings and numbers, as `from_document` takes them."""
        return {
            **{
                name: getattr(self, name)
                for name in ('status', 'effects', 'sets', 'rest', 'trials', 'kinds', 'warnings')
            },
            'parameters': {name: asdict(each) for name, each in self.parameters.items()},
            'push': None if self.push is None else asdict(self.push),
            'repeat': None if self.repeat is None else asdict(self.repeat),
            'other': None if self.other is None else asdict(self.other),
        }

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> 'Findings':
        """Return findings that came as JSON from another process."""

        def push(of: Mapping[str, Any] | None) -> Push | None:
            return None if of is None else Push(**{**of, 'about': tuple(of['about'])})

        return cls(
            status=str(document['status']),
            effects=tuple(document['effects']),
            sets=tuple(map(tuple, document['sets'])),
            parameters=MappingProxyType(
                {name: Parameter(**each) for name, each in document['parameters'].items()}
            ),
            rest=tuple(document['rest']),
            trials=int(document['trials']),
            kinds=int(document['kinds']),
            push=push(document['push']),
            repeat=push(document['repeat']),
            other=push(document['other']),
            warnings=tuple(document['warnings']),
        )


@dataclass(frozen=True, slots=True)
class Decision:
    """
    What is done next.

    Parameters
    ----------
    push : Push or None
        What to push; None to stop.
    ending : Ending or None
        Why to stop; None to go on.
    reason : str
        Why, as a sentence without its full stop.

    """

    push: Push | None
    ending: Ending | None
    reason: str


@dataclass(frozen=True, slots=True)
class Spent:
    """
    What an experiment has used up since its grid.

    Parameters
    ----------
    pushes : tuple of Push
        What was pushed, failed trials included.
    time : float
        Time since the end of the grid [s].
    before : Findings or None
        What was found before the last push; None before the first.

    """

    pushes: tuple[Push, ...] = field(default=())
    time: float = 0.0
    before: Findings | None = None


def decide(
    found: Findings, budget: Budget, spent: Spent, lasts: Callable[[Push], float]
) -> Decision:
    """
    Choose the next push, or stop.

    What several trials leave over beside all effects may be scatter: without a repeated push that
    comes first, as no other push tells. Then effects are told apart that these trials confound.
    Where something is left nevertheless, `PATIENCE` pushes that differ from those made are to show
    what it is. No answer is trusted before it has outlived a push: pushes that are much alike may
    hide an effect, or single out a wrong one. Then parameters are sharpened until all are tight
    enough.

    Parameters
    ----------
    found : Findings
        What the trials so far tell.
    budget : Budget
        How long to go on.
    spent : Spent
        What has been used up of it.
    lasts : callable
        Tells how long a push takes, with the pause before it [s].

    Returns
    -------
    Decision
        What to do.

    """
    stop = _enough(found, budget, spent)
    if stop is not None:
        return stop
    wanted = _wanted(found, spent)
    question = _question(found, budget, spent)
    if wanted is None or not wanted.worthwhile:
        promise = '' if wanted is None else f' (the best promises {wanted.gain:.2g})'
        return Decision(
            None,
            Ending.NOTHING_HELPS,
            f'{question}, and no push within the limits of the cell tells more{promise}',
        )
    short = _short_of(budget, spent, lasts(wanted))
    if short:
        ending = Ending.SCATTER if wanted.purpose == 'repeat' else Ending.BUDGET
        return Decision(None, ending, f'{question}, and {short}')
    return Decision(wanted, None, wanted.reason)


def _wanted(found: Findings, spent: Spent) -> Push | None:
    """Return the push that helps with what is open, whatever it costs."""
    if _scatter_is_open(found):
        return found.repeat
    if found.push is not None and found.push.purpose == 'sharpen':
        purpose: Purpose = 'explore' if found.has_rest else 'test'
        doubt = _doubt(found, spent)
        if found.has_rest:
            doubt = 'something is left that no known effect explains'
        if doubt:
            about = () if found.has_rest else found.effects
            reason = f'{doubt}, and this push differs most'
            # One that sharpens may be a repeat, in which an effect hides as it did before.
            push = found.push if found.other is None else found.other
            return replace(push, purpose=purpose, about=about, gain=found.push.gain, reason=reason)
    return found.push


def _enough(found: Findings, budget: Budget, spent: Spent) -> Decision | None:
    """Return the decision to stop because nothing is open, or nothing can be closed."""
    wanted = _wanted(found, spent)
    if wanted is not None and wanted.purpose in ('separate', 'explore', 'test'):
        last = [(each.purpose, set(each.about)) for each in spent.pushes[-PATIENCE:]]
        if last == [(wanted.purpose, set(wanted.about))] * PATIENCE:
            return Decision(None, Ending.NOTHING_HELPS, _in_vain(found, wanted))
    if found.has_rest or found.confounded or _doubt(found, spent):
        return None
    name, error = found.least_known
    if budget.precision and error > budget.precision:
        return None
    known = ''
    if name and math.isfinite(error):
        known = f', and every parameter is known to {100.0 * error:.2g} % or better'
    if found.effects:
        effects = ' and '.join(found.effects)
        return Decision(None, Ending.DECIDED, f'{effects} explains the trials{known}')
    ending = Ending.TIGHT if budget.precision else Ending.DECIDED
    nothing = 'nothing is left that noise does not explain'
    return Decision(None, ending, nothing + known)


def _doubt(found: Findings, spent: Spent) -> str:
    """Return why an answer is not to be trusted yet; empty if it is, or if no push tells more."""
    if found.push is None or not found.push.worthwhile or _outlived(found, spent.before):
        return ''
    said = f'{" and ".join(found.effects)} is' if found.effects else 'that there is no effect is'
    return f'{said} an answer that no push has tested yet'


def _outlived(found: Findings, before: Findings | None) -> bool:
    """Whether the answer was the same before the last push, and that was recorded."""
    if before is None or before.trials >= found.trials or before.has_rest:
        return False
    return set(before.effects) == set(found.effects)


def _in_vain(found: Findings, wanted: Push) -> str:
    """Return that pushes have not helped."""
    if wanted.purpose == 'separate':
        return f'{PATIENCE} pushes that were to tell {" and ".join(wanted.about)} apart have not'
    if wanted.purpose == 'explore':
        return f'{_left(found)}, and {PATIENCE} pushes that differ have not shown what it is'
    return f'the answer could not be tested: {PATIENCE} pushes for it have failed'


def _left(found: Findings) -> str:
    """Return what is left over."""
    part = f'{" and ".join(found.effects)} explains a part, and ' if found.effects else ''
    where = f' ({found.rest[0]})' if found.rest else ''
    return f'{part}something is left that no known effect explains{where}'


def _scatter_is_open(found: Findings) -> bool:
    """Whether what is left may be scatter, which only a repeat can tell."""
    unrepeated = 1 < found.trials == found.kinds
    return found.has_rest and unrepeated and found.repeat is not None


def _question(found: Findings, budget: Budget, spent: Spent) -> str:
    """Return what is still open."""
    if _scatter_is_open(found):
        return 'what is left may be scatter from trial to trial, as no push was repeated'
    if found.confounded:
        return f'{" and ".join(found.confounded)} are not told apart'
    if found.has_rest:
        return _left(found)
    if _doubt(found, spent):
        return _doubt(found, spent)
    name, error = found.least_known
    if math.isinf(error):
        return f'the trials do not tell {name}'
    return f'{name} is known to {100.0 * error:.2g} % only, not to {100.0 * budget.precision:g} %'


def _short_of(budget: Budget, spent: Spent, lasts: float) -> str:
    """Return what of the budget a further push would exceed; empty if nothing."""
    if len(spent.pushes) >= budget.trials:
        return f'the budget of {budget.trials} trials after the grid is spent'
    if budget.time and spent.time + lasts > budget.time:
        return (
            f'the next push would take {lasts:.0f} s, of which the budget of {budget.time:g} s '
            f'leaves {max(0.0, budget.time - spent.time):.0f} s'
        )
    return ''


@dataclass(frozen=True, slots=True)
class Cell:
    """
    What the cell and the goal allow.

    Parameters
    ----------
    limits : push_control.PushLimits
        The arm's limits.
    usual : PushGoal
        A push of the grid: what all pushes have in common.
    slowest, fastest : float
        The grid's speeds [m/s].
    deepest : float
        The grid's largest depth [m].
    longest_hold : float
        The grid's hold [s].

    """

    limits: PushLimits
    usual: PushGoal
    slowest: float
    fastest: float
    deepest: float
    longest_hold: float

    def document(self) -> dict[str, Any]:
        """Return plain numbers, as `from_document` takes them."""
        return asdict(self)

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> 'Cell':
        """Return what came as JSON from another process."""
        numbers = ('slowest', 'fastest', 'deepest', 'longest_hold')
        return cls(
            limits=PushLimits(**document['limits']),
            usual=PushGoal(**document['usual']),
            **{name: float(document[name]) for name in numbers},
        )

    def reach(self) -> 'Reach':
        """
        Return the pushes that may be chosen.

        None is deeper or faster than the grid, so that a viscous or elastic body answers none with
        more force, and what a fast push makes of late readings is no more than in the grid.
        Slower ones and longer holds are open as far as `SPREAD` and the arm's limits go.
        """
        from hapticvision_ros.core.diagnosis.design import PushLimits as Reach

        fastest = min(self.fastest, self.limits.max_speed)
        slowest = min(self.slowest, fastest)
        deepest = min(self.deepest, self.limits.max_depth)

        def spare(speed: float, hold: float) -> float:
            """Return what the deepest push leaves of the time that a push may take [s]."""
            push = replace(self.usual, push_speed=speed, depth=deepest, hold_time=hold)
            return self.limits.max_duration - expected_duration(push, self.limits.highest_height)

        # No slower than leaves time for the grid's hold: the arm would refuse the push, which
        # would end the experiment.
        way = deepest + self.usual.approach_gap
        left = max(spare(slowest, self.longest_hold), 0.0)
        slower = max(slowest / SPREAD, _UNROUNDED * way / (way / slowest + left))
        slowest = min(slower, slowest)
        room = spare(slowest / _UNROUNDED, 0.0)
        hold = min(SPREAD * self.longest_hold, max(room, self.longest_hold))
        return Reach(slowest=slowest, fastest=fastest, deepest=deepest, longest_hold=hold)


def look(
    trials: 'Sequence[Trial]', cell: Cell, *, progress: Progress | None = None, workers: int = 1
) -> Findings:
    """
    Diagnose a campaign as far as it goes.

    Parameters
    ----------
    trials : sequence of Trial
        As they were recorded.
    cell : Cell
        What may be pushed next.
    progress : callable, optional
        Told what is being done.
    workers : int
        Processors.

    Returns
    -------
    Findings
        What they tell. A trial that cannot be segmented is left out, with a warning.

    Raises
    ------
    UsageError
        If no trial can be fitted.

    """
    from hapticvision_ros.core.diagnosis.scatter import conditions
    from hapticvision_ros.core.diagnosis.search import diagnose
    from hapticvision_ros.core.pipeline import analyse

    analysed, places, warnings = list['TrialAnalysis'](), list[int](), list[str]()
    for place, trial in enumerate(trials):
        try:
            analysed.append(analyse(trial))
            places.append(place)
        except InputError as error:
            warnings.append(f'{trial.name} is left out: {str(error).rstrip(".")}')
    if not analysed:
        raise UsageError('; '.join(warnings) or 'there is no trial to analyse.')
    reach = cell.reach()
    found = diagnose(analysed, progress=progress, workers=workers, limits=reach)
    fits = found.before.trials
    for each, fitted in zip(analysed, fits, strict=True):
        if fitted is None:
            # It tells nothing, and is no push that was made: another may be asked for.
            warnings += [w for w in found.before.warnings if w.startswith(f'{each.trial.name}: ')]
    analysed = [each for each, fitted in zip(analysed, fits, strict=True) if fitted is not None]
    places = [place for place, fitted in zip(places, fits, strict=True) if fitted is not None]
    best = found.next_trial
    push = None
    if best is not None:
        push = Push(
            purpose='separate' if len(best.separates) > 1 else 'sharpen',
            push_speed=_rounded(best.push_speed),
            depth=_rounded(best.depth),
            hold_time=_rounded(best.hold_time),
            about=best.separates,
            gain=best.gain if math.isfinite(best.gain) else 0.0,
            reason=best.reason,
        )
    model = found.after.model
    units = dict(zip(model.names, model.units, strict=True))
    return Findings(
        status=found.status,
        effects=found.effects,
        sets=found.sets,
        parameters=MappingProxyType(
            {
                name: Parameter(_finite(each.value), _finite(each.std), units[name])
                for name, each in found.after.parameters.items()
            }
        ),
        rest=() if found.unexplained is None else found.unexplained.where,
        trials=len(analysed),
        kinds=len(conditions([each.segmentation.entire for each in analysed])),
        push=push,
        repeat=_repeat(analysed),
        other=_other(analysed, reach),
        warnings=found.warnings,
    ).among(places, warnings)


def _other(trials: 'Sequence[TrialAnalysis]', reach: 'Reach') -> Push | None:
    """Return the deepest push that is least like those that were made."""
    made = [(s.push_speed, s.hold_time) for s in (each.segmentation.entire for each in trials)]
    middle = math.sqrt(reach.slowest * reach.fastest)
    best, most = None, LIKE
    for hold in (reach.longest_hold, reach.longest_hold / SPREAD):
        for speed in (reach.slowest, reach.fastest, middle):
            away = min(
                abs(math.log(speed / v)) + abs(math.log(hold / h))
                if v and h and h > 0.0
                else math.inf
                for v, h in made
            )
            if away > most:
                best, most = (speed, hold), away
    if best is None or not math.isfinite(most):
        return None
    speed, hold = best
    return Push(
        purpose='test',
        push_speed=_rounded(speed),
        depth=_rounded(reach.deepest),
        hold_time=_rounded(hold),
        about=(),
        gain=0.0,
        reason='it is least like those that were made',
    )


def _repeat(trials: 'Sequence[TrialAnalysis]') -> Push | None:
    """Return the repeat of the push with the largest force, where scatter stands out most."""
    straight = [
        (_peak(each), place, each.segmentation)
        for place, each in enumerate(trials)
        # Nothing that goes on at once repeats a push in steps.
        if each.segmentation.push_speed and each.segmentation.depth and not each.segmentation.whole
    ]
    if not straight:
        return None
    _, place, phases = max(straight, key=lambda item: item[0])
    return Push(
        purpose='repeat',
        push_speed=phases.push_speed or 0.0,
        depth=phases.depth or 0.0,
        hold_time=phases.hold_time or 0.0,
        about=(),
        gain=0.0,
        reason='only a repeat tells whether what is left is scatter from trial to trial',
        like=place,
    )


def _peak(trial: 'TrialAnalysis') -> float:
    """Return the largest force of a trial [N]."""
    return float(trial.trial.force.value.max()) - trial.segmentation.force_zero


def _finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def _rounded(value: float) -> float:
    """Return a number with a few digits, none larger than it was."""
    digit = 10.0 ** (math.floor(math.log10(value)) - DIGITS + 1)
    return float(f'{math.floor(value / digit * (1.0 + 1e-9)) * digit:.{DIGITS}g}')


def describe(push: Push) -> str:
    """Return a push in words."""
    return (
        f'{push.push_speed / MM:.3g} mm/s to {push.depth / MM:.3g} mm, hold {push.hold_time:.3g} s'
    )
