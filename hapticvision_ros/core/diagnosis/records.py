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


"""What a diagnosis says, and how far a model misses trials: the results that others read."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple

from hapticvision_ros.core.fit.campaign import Fit
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import FloatArray

SCATTER: Final = 'scatter'
"""What trials differ by among themselves, beside the names of effects."""

type Status = Literal['none', 'explained', 'partly_explained', 'unexplained']
type Channel = Literal['force', 'height']
type Phase = Literal['approach', 'push', 'hold', 'release', 'recover']


@dataclass(frozen=True, slots=True)
class Misfit:
    """
    How far a model misses some samples of one channel.

    Parameters
    ----------
    samples : int
        How many samples.
    rmse : float
        Root mean square of measured minus predicted [N or m].
    chi2 : float or None
        Mean squared residual over the squared noise of a sample; None where the noise is unknown.
    percent_of_range : float or None
        `rmse` in percent of the range of the measured values; None where that is zero.

    """

    samples: int
    rmse: float
    chi2: float | None
    percent_of_range: float | None


@dataclass(frozen=True, slots=True)
class Misfits:
    """
    How far a model misses a set of trials.

    Parameters
    ----------
    total : mapping of Channel to Misfit
        Over all samples; without a channel that was not recorded.
    by_phase : mapping of (Channel, Phase) to Misfit
        Over all trials.
    by_trial : mapping of (str, Channel) to Misfit
        Over all phases; the first key is the trial's name.

    """

    total: Mapping[Channel, Misfit]
    by_phase: Mapping[tuple[Channel, Phase], Misfit]
    by_trial: Mapping[tuple[str, Channel], Misfit]


class Goes(NamedTuple):
    """
    How a residual goes with something.

    Parameters
    ----------
    correlation : float
        Largest correlation at any lag, both whitened by the noise of the sensor [-].
    lag : float
        By how much the residual comes later there [s].
    chance : float
        Chance that noise which is as much alike from one mean to the next goes with it as much.

    """

    correlation: float
    lag: float
    chance: float


@dataclass(frozen=True, slots=True)
class Leftover:
    """
    What a model leaves of one channel, in means of samples that are whitened by the noise.

    Parameters
    ----------
    blocks : int
        How many means.
    size : float
        Their root mean square: 1 of noise alone [-].
    neighbours : float or None
        Correlation of each with the next; as are all others, None where few tell it [-].
    white : float or None
        Chance that white noise is as much correlated with itself, over ten lags (Ljung, Box).
    smooth : float or None
        Chance that white noise has smooth curves over the phases that take as much out.
    share : float or None
        Part of the squares, before whitening, that these curves take out [-].
    depth, speed : Goes or None
        How it goes with depth and speed of a tool that touches, each about its mean over a phase.
    order : Goes or None
        How its means over the trials, from the touch on, go with their order; None of few trials.

    """

    blocks: int
    size: float
    neighbours: float | None
    white: float | None
    smooth: float | None
    share: float | None
    depth: Goes | None
    speed: Goes | None
    order: Goes | None


@dataclass(frozen=True, slots=True)
class SmoothCurve:
    """
    What is smooth in the residual of one channel over one phase of one trial.

    Parameters
    ----------
    trial : str
        The trial.
    channel : Channel
        Where it is.
    phase : Phase
        When.
    t : ndarray, shape (n,)
        Corners of the curve, straight between: time since the phase began [s].
    value, std : ndarray, shape (n,)
        Measured minus predicted there, and its standard error [N or m].

    """

    trial: str
    channel: Channel
    phase: Phase
    t: FloatArray
    value: FloatArray
    std: FloatArray


@dataclass(frozen=True, slots=True)
class Leftovers:
    """
    What a model leaves of the trials that it was fitted to.

    Parameters
    ----------
    noise : mapping of Channel to SensorNoise
        What the residual was whitened by.
    total : mapping of Channel to Leftover
        Over all.
    by_phase : mapping of (Channel, Phase) to Leftover
        Over all trials.
    by_trial : mapping of (str, Channel) to Leftover
        Over all phases; the first key is the trial's name.
    curves : tuple of SmoothCurve
        Trial by trial, in the order of the phases.

    """

    noise: Mapping[Channel, SensorNoise]
    total: Mapping[Channel, Leftover]
    by_phase: Mapping[tuple[Channel, Phase], Leftover]
    by_trial: Mapping[tuple[str, Channel], Leftover]
    curves: tuple[SmoothCurve, ...]


@dataclass(frozen=True, slots=True)
class HeldOutChange:
    """
    By how much an added effect changes the error on unseen trials.

    Parameters
    ----------
    ratio : float
        Whitened squares of the unseen samples with the effect over those without.
    change, std : float
        Mean change of the whitened squares of a trial, and its standard error over the trials
        (0.0 where there is only one).

    """

    ratio: float
    change: float
    std: float


class ErrorChange(NamedTuple):
    """
    By how much an added effect changes the error on some unseen samples.

    Parameters
    ----------
    samples : int
        How many samples.
    chi2 : float
        Mean of the squares over those of the noise, with the effect less without.
    std : float
        Its standard error: over the trials, or of one trial what the sensor's noise makes.

    """

    samples: int
    chi2: float
    std: float


@dataclass(frozen=True, slots=True)
class ErrorChanges:
    """
    By how much an added effect changes the errors on unseen trials.

    Parameters
    ----------
    total : mapping of Channel to ErrorChange
        Over all samples.
    by_phase : mapping of (Channel, Phase) to ErrorChange
        Over all trials.
    by_trial : mapping of (str, Channel) to ErrorChange
        Over all phases; the first key is the trial's name.

    """

    total: Mapping[Channel, ErrorChange]
    by_phase: Mapping[tuple[Channel, Phase], ErrorChange]
    by_trial: Mapping[tuple[str, Channel], ErrorChange]


@dataclass(frozen=True, slots=True)
class Candidate:
    """
    One effect, held against the model that was chosen without it.

    Parameters
    ----------
    effect : str
        Its name.
    score : float
        By how much it lowers minus twice the log likelihood.
    delta_bic : float
        `score` less the price of its parameters: what it gains by Schwarz's criterion.
    held_out_ratio : float or None
        Squares on trials left out in turn, with the effect over without; None where unknown.
    strength : float or None
        Root mean square of what it changes in the prediction, over the noise of a sample; None
        where no refit was needed, and score and gain are what a linear model promises.

    """

    effect: str
    score: float
    delta_bic: float
    held_out_ratio: float | None
    strength: float | None


@dataclass(frozen=True, slots=True)
class Unexplained:
    """
    What is left when nothing in the library explains it.

    Parameters
    ----------
    share_of_chi2 : float
        Part of the squares beyond the noise, before any effect, that is left.
    where : tuple of str
        One sentence for each thing known of it: channel and phase, size, what it goes with.

    """

    share_of_chi2: float
    where: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class NextTrial:
    """
    The trial that would tell most.

    Parameters
    ----------
    push_speed, depth, hold_time : float
        The push [m/s, m, s].
    separates : tuple of str
        The two candidates that it is to tell apart, or one parameter that it is to sharpen.
        `SCATTER` stands for trials that differ among themselves.
    gain : float
        Expected separation [standard deviations], or factor on the standard error, of one push.
    reason : str
        Why, as a sentence.
    repeats : int
        How many times to make it.

    """

    push_speed: float
    depth: float
    hold_time: float
    separates: tuple[str, ...]
    gain: float
    reason: str
    repeats: int = 1


@dataclass(frozen=True, slots=True)
class Bootstrap:
    """
    What chance alone does in campaigns that the base model makes.

    Parameters
    ----------
    campaigns : int
        How many were simulated.
    false_alarms : int
        In how many of them an effect would have been accepted.
    p_value : float
        Share of them, the measured one counted in, that gain as much as the measured one.

    """

    campaigns: int
    false_alarms: int
    p_value: float


@dataclass(frozen=True, slots=True)
class Diagnosis:
    """
    What the base model lacks.

    Parameters
    ----------
    status : Status
        The answer.
    effects : tuple of str
        Accepted effects in the order of their adding: the leader of each set.
    sets : tuple of (tuple of str)
        For each, the effects that these trials cannot tell from it, itself first.
    not_testable : tuple of str
        What these trials cannot show.
    look_alikes : tuple of (str, str, float)
        Pairs of effects with the cosine of what they change.
    ranking : tuple of Candidate
        All testable effects by `delta_bic`, as each stands alone beside the base model.
    unexplained : Unexplained or None
        What is left.
    next_trial : NextTrial or None
        What to push next.
    repeat : NextTrial or None
        What to push again before, where nothing else tells scatter from an effect.
    before, after : Fit
        The base model and the one with the accepted effects; the same without any.
    warnings : tuple of str
        What a reader must know.
    bootstrap : Bootstrap or None
        How often chance does as much; None where it was not asked for.
    laws : tuple of str
        Those of the accepted effects that follow another law than the usual one, as
        ``effect:law``.
    late : float
        By how much the stamps of the tool's height were late, and have been moved before all
        this [s].
    contenders : tuple of (tuple of str)
        The effects, each by the law that was looked for, that came near to being chosen or were:
        at first, beside the first of them, and so on.

    """

    status: Status
    effects: tuple[str, ...]
    sets: tuple[tuple[str, ...], ...]
    not_testable: tuple[str, ...]
    look_alikes: tuple[tuple[str, str, float], ...]
    ranking: tuple[Candidate, ...]
    unexplained: Unexplained | None
    next_trial: NextTrial | None
    before: Fit
    after: Fit
    warnings: tuple[str, ...]
    bootstrap: Bootstrap | None = None
    laws: tuple[str, ...] = ()
    late: float = 0.0
    contenders: tuple[tuple[str, ...], ...] = ()
    repeat: NextTrial | None = None

    @property
    def advice(self) -> NextTrial | None:
        """Return what to do first."""
        return self.next_trial if self.repeat is None else self.repeat
