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
One set of parameters for all trials of a campaign, from their whole force and height at once.

Least squares of the measured minus the predicted force and displacement height, made white by the
sensors' noise, whose level and memory are estimated from the residual in a loop with the fit. The
parameters of the model are shared; each trial adds its own: how much deeper the tool is than the
detected contact says (known to within the precision of the detection), the parameters that an
effect declares for a trial, and the zeros of both sensors.

References
----------
A. C. Harvey, Forecasting, Structural Time Series Models and the Kalman Filter, 1989 (whitening);
H. D. Patterson and R. Thompson, Biometrika 58, 1971, 545-554, doi:10.1093/biomet/58.3.545 (noise).

"""

from collections.abc import Callable, Mapping, Sequence
import contextlib
from dataclasses import dataclass, replace
from functools import cached_property
import math
from types import MappingProxyType
from typing import Final, NamedTuple, Protocol

from hapticvision_ros.core.composition import BASE_PARAMETERS, Model
from hapticvision_ros.core.effects import BY_NAME
from hapticvision_ros.core.effects.declaration import Prediction, Scale
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.fit.data import FitTrial, prepare, QUIETEST
from hapticvision_ros.core.fit.least_squares import (
    Evaluated,
    left_over,
    minimise,
    NotFiniteError,
    Solution,
    triangle,
)
from hapticvision_ros.core.fit.noise_model import (
    Blocks,
    deviance,
    estimate,
    Record,
    SensorNoise,
    wandering,
    Whitener,
    whitener,
)
from hapticvision_ros.core.fit.start import identify
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.models.motion import acceleration
from hapticvision_ros.core.models.three_element import ThreeElement
from hapticvision_ros.core.outliers import NORMAL_FROM_MAD, runs
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np
from numpy.typing import NDArray

_ROUNDS: Final = 4
"""Most rounds of noise and parameters."""
_TOLERANCE: Final = 1e-7
"""Relative change of the cost that is none: a small part of one in the sum of squares."""
_SETTLED: Final = 0.03
"""Relative change of the noise at which a further round is not worth it."""
_UNTOLD: Final = 0.7
"""Standard error of a logarithm from which on a parameter is not told: a factor of two."""
_UNTOLD_LINEAR: Final = 100.0
"""The same of a parameter that is none, over its value or, where that is more, a usual one."""
_QUICK: Final = 20.0
_BRIEF: Final = 0.01
"""Relaxation, in samples and over the contact, below which the force of a push may show none."""
_OTHER: Final = 0.3
"""Relative change of the noise from which on it may be of another kind."""
_OUTLYING: Final = 6.0
"""Residual, in standard deviations of a sample, from which on a sample is looked at."""
_LOOKS: Final = 7
_STEPS: Final = 25
"""Evaluations from each of several starts, then from the best."""
_SAME: Final = 1.0
"""Squares by which two ends of a search are the same."""
_ONSET_REACH: Final = 4.0
_ONSET_ZOOMS: Final = 4
"""The onset is looked for in this many errors of the detection, and so often more finely."""
_ONSET_PART: Final = 0.125
"""Part of a sample's way to which it is looked for again."""
_MISPLACED: Final = 4.0
"""Squares at the touch, over those of the noise, from which on the onset is looked for again."""
_TOUCHING: Final = 3
"""Steps before and after the touch that tell whether it is misplaced."""
_BETTER: Final = 9.0
"""What another onset takes out of the squares near the touch, over those of a sample's noise."""
_FIRST_RECORDS: Final = 2
"""Records that the first look at the noise takes, about: it only has to come near."""
_BLURS: Final = (0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0)
"""How well moments of jumps may be known, in samples."""
_TOUCH: Final = math.sqrt(1.0 / 12.0)
"""
How well the moment of a touch is known at best, in samples.

Whether a reading of the load cell is of a moment or a mean is not known, and each trial has a
touch of its own to suit the one reading that it falls on.
"""
_LATE: Final = 3.0
"""How late the heights of the tool may be, in their intervals."""
_DENSE: Final = 0.05
"""Quantile of the intervals that is theirs where samples are dense."""
_FAR: Final = 2.5
_TREND: Final = 4.0
"""How far a jump may be moved, and half the window that the trend is seen in, over its error."""
_FARTHEST_ONSET: Final = 5.0
"""The onset is at most so many errors of the detection from the detected contact."""
_REST_STEP: Final = 0.1
"""Change of where a tool is held, over its standard deviation, that shows what it does."""
_MEMORY: Final = 0.01
_MEMORY_SAMPLES: Final = 20
"""Longest memory of a sensor's noise, over the record or in samples, where no more is seen."""
_BASELINE: Final = 64
"""Steps without contact, in all trials together, from which on they tell the noise's memory."""
_FEW: Final = 8
_EDGE: Final = 4.0
_CLEARANCE: Final = 0.1
"""Steps, samples before the touch, and way above the surface over the depth, without contact."""
_SLOWER: Final = 2.0
_REACH: Final = 3.0
"""How far the logarithm of a parameter goes in one step of a search."""
_SEEN: Final = 12.0
"""Gain in likelihood from which on slower noise is seen without contact."""
_WANDERS: Final = 4.0
"""The same for a zero that wanders: a little too much of it costs little."""
_DRIFTS: Final = 16.0
"""
Gain in likelihood from which on a zero goes alike in all trials and does not wander.

By chance four curves gain so much in one campaign of three hundred.
"""
_ACCELERATION: Final = 4
_FELT: Final = 100.0
"""Which of the curves is the tool's acceleration, and the gain from which on its mass is felt."""
_SLIDES: Final = 1e-5
"""Speed above which a tool slides, and friction shows [m/s]."""
_NEW: Final = 1e-3
"""Part of the squares of a curve that others do not have, for it to be one more."""
_ZERO: Final = 0.03
"""How far the zero of a load cell may be from the one before contact, over the largest force."""
_SMALLEST_GLITCH: Final = 1e-3
"""No residual below this share of the largest force is one."""
_LOUD: Final = 1.5
"""Residual over the noise before contact from which on a reader is told."""
_MISSED: Final = 2.0
"""Misfit over the noise from which on the body that most trials tell, each alone, is tried."""
_NAMED: Final = 3
"""Samples set aside whose times are told."""
_NEIGHBOURS: Final = 64
"""Places of a spectrum whose median is what noise makes there."""
_LEVELS: Final = 3
"""Looks for a pull, each at half of what the one before has told."""
_LAST_HELD: Final = 6
"""Heights before a pull ends that tell where the surface is then."""
_AS_QUICK: Final = 1.01
"""Sampling interval over the shortest of a campaign up to which spectra are added up."""
_TURNS: Final = 5
"""Periods in a trial below which a line is none: anything smooth has such."""
_FEWEST_HEIGHTS: Final = 8
"""Displacement heights of a campaign below which they tell no noise: a fit leaves them none."""
_USUAL: Final = 0.005
"""Noise of the displacement height over the depth where it is not told."""
_FAST: Final = frozenset({'periodic_disturbance'})
"""Effects that live within the steps that a trial is averaged over."""


class Analysed(Protocol):
    """A trial with its phases, as `hapticvision_ros.core.pipeline.analyse` returns it."""

    @property
    def trial(self) -> Trial:
        """Return what was measured."""
        ...

    @property
    def segmentation(self) -> Segmentation:
        """Return its phases."""
        ...


type Segmented = Analysed | tuple[Trial, Segmentation]


def pairs_of(campaign: Sequence[Segmented]) -> list[tuple[Trial, Segmentation]]:
    """Return each trial with the phases of its whole record."""
    pairs = [t if isinstance(t, tuple) else (t.trial, t.segmentation) for t in campaign]
    return [(trial, phases.entire) for trial, phases in pairs]


class Blur(NamedTuple):
    """
    How well the moments are known at which the force jumps or falls fast, in samples.

    At the touch the tool goes on as it did, and the moment is a parameter of the fit. How it stops
    and starts again is known by its encoders alone.
    """

    touch: float
    later: float

    def at_least(self, other: 'Blur') -> 'Blur':
        """Return what is known no better than either."""
        return Blur(max(self.touch, other.touch), max(self.later, other.later))


_SAMPLE: Final = Blur(1.0, 1.0)
_HALF: Final = Blur(0.5, 0.5)
SHARPEST: Final = Blur(_BLURS[0], _BLURS[0])
"""The best that moments may be known."""


@dataclass(frozen=True, slots=True)
class CampaignNoise:
    """
    The noise of a campaign.

    Parameters
    ----------
    force, height : SensorNoise
        What the residual of the fit tells of one sample of force [N] and height [m].
    blur : Blur
        How well the moments are known at which the force jumps or falls fast.
    force_before_contact, height_before_contact : float or None
        Standard deviation of a sample before contact, where the model cannot be wrong.
    memory : Memory
        How long it may remember.

    """

    force: SensorNoise
    height: SensorNoise
    blur: Blur
    force_before_contact: float | None
    height_before_contact: float | None
    memory: 'Memory'


@dataclass(frozen=True, slots=True)
class TrialFit:
    """
    One trial beside what the model says of it, sample by sample.

    Parameters
    ----------
    name : str
        The trial's name.
    force, height : Signal
        Measured force [N] and displacement height [m], without the zeros that the fit has found;
        samples set aside, and those within a sample of a jump of the force, are left out.
    force_fitted, height_fitted : ndarray
        The model's at the same times.
    values : mapping of str to Estimate
        The trial's own parameters.
    set_aside : ndarray
        Times of force samples that were not used [s].

    """

    name: str
    force: Signal
    force_fitted: FloatArray
    height: Signal
    height_fitted: FloatArray
    values: Mapping[str, Estimate]
    set_aside: FloatArray

    @property
    def force_rmse(self) -> float:
        """Return the root mean square of measured minus fitted force [N]."""
        return _rms(self.force.value - self.force_fitted)

    @property
    def height_rmse(self) -> float | None:
        """Return the same of the height [m]; None without any."""
        return _rms(self.height.value - self.height_fitted) if len(self.height) else None


@dataclass(frozen=True, slots=True)
class Fit:
    """
    A model fitted to a campaign.

    Parameters
    ----------
    model : Model
        What was fitted.
    parameters : mapping of str to Estimate
        The p shared parameters, in SI units; unknown with a reason where the trials cannot tell.
    theta : ndarray, shape (p,)
        The same as the search sees them, known or not.
    covariance : ndarray, shape (p, p)
        Of `theta`; infinite where nothing is told.
    trials : tuple of (TrialFit or None)
        One for each trial; None where it could not be used.
    noise : CampaignNoise
        Of the sensors.
    cost : float
        Sum of squares of the whitened residual.
    deviance : float
        Minus twice the log likelihood, constants apart: compares models on the same noise.
    samples : int
        Force and height samples in the fit.
    warnings : tuple of str
        What a reader of the numbers must know.
    problem : Problem
        What was minimised, for intervals and tests of further effects.
    state : ndarray
        All parameters where the search ended, as `problem` orders them.

    """

    model: Model
    parameters: Mapping[str, Estimate]
    theta: FloatArray
    covariance: FloatArray
    trials: tuple[TrialFit | None, ...]
    noise: CampaignNoise
    cost: float
    deviance: float
    samples: int
    warnings: tuple[str, ...]
    problem: 'Problem'
    state: FloatArray

    @property
    def correlation(self) -> FloatArray:
        """Return the correlation of the entries of `theta`; not a number where nothing is told."""
        std = np.sqrt(np.diag(self.covariance))
        known = np.isfinite(std) & (std > 0.0)
        result = np.full(self.covariance.shape, math.nan)
        both = np.outer(known, known)
        scale = np.where(known, std, 1.0)
        np.divide(self.covariance, np.outer(scale, scale), out=result, where=both)
        return result

    @property
    def force_rmse(self) -> float:
        """Return the root mean square force residual over all samples [N]."""
        return _rms(np.concatenate([t.force.value - t.force_fitted for t in self.trials if t]))

    @property
    def height_rmse(self) -> float | None:
        """Return the root mean square height residual over all samples [m]; None without any."""
        heights = [t.height.value - t.height_fitted for t in self.trials if t and len(t.height)]
        return _rms(np.concatenate(heights)) if heights else None

    @property
    def force_chi2(self) -> float | None:
        """Return the mean squared force residual over the squared noise before contact."""
        noise = self.noise.force_before_contact
        return (self.force_rmse / noise) ** 2 if noise else None

    @property
    def height_chi2(self) -> float | None:
        """Return the mean squared height residual over the squared noise before contact."""
        noise, rmse = self.noise.height_before_contact, self.height_rmse
        return (rmse / noise) ** 2 if noise and rmse is not None else None


@dataclass(frozen=True, slots=True)
class _Weights:
    """What makes a trial's residuals white."""

    force: Whitener
    height: Whitener | None


class _Known(NamedTuple):
    """
    What is known of a trial's own parameters beforehand: that they are near zero.

    Parameters
    ----------
    places : ndarray of int, shape (k,)
        Which they are in the state.
    weights : ndarray, shape (k,)
        One over how far from zero they are.
    rows : ndarray, shape (k, p + own)
        The same as rows of the trial's Jacobian.

    """

    places: NDArray[np.intp]
    weights: FloatArray
    rows: FloatArray

    @classmethod
    def of(cls, known: Sequence[int], weights: Sequence[float], place: slice, p: int) -> '_Known':
        """Return it for the places among the own parameters of a trial."""
        own = np.array(known, dtype=np.intp)
        rows = np.zeros((own.size, p + place.stop - place.start))
        rows[np.arange(own.size), p + own] = weights
        return cls(place.start + own, np.array(weights), rows)


class Problem:
    """
    The least-squares problem of a campaign: whitened residuals and Jacobian.

    The state holds the p shared parameters (theta), then for each trial its q own parameters, the
    logarithms by which its K1, C1 and C2 differ from the shared ones where trials scatter, by how
    much deeper the tool is held than it is taken to be where its encoders leave that open, its
    force zero and its height zero, as far as its record can tell them.

    Parameters
    ----------
    model : Model
        What to fit.
    trials : sequence of FitTrial
        The trials.
    scatter : ndarray, shape (3,), optional
        Standard deviations of the logarithms of K1, C1 and C2 from trial to trial; none by
        default.

    """

    def __init__(
        self, model: Model, trials: Sequence[FitTrial], scatter: FloatArray | None = None
    ) -> None:
        self.model = model
        self.trials = tuple(trials)
        self.scatter = np.empty(0) if scatter is None else np.asarray(scatter, dtype=np.float64)
        self.p = len(model.parameters)
        self.q = len(model.trial_parameters)
        self.places: list[slice] = []
        self.names = list(model.names)
        stop = self.p
        for trial in self.trials:
            names = self.own_names(trial)
            self.places.append(slice(stop, stop + len(names)))
            self.names += [f'{name} of {trial.name}' for name in names]
            stop += len(names)
        self.size = stop
        self._weights: tuple[_Weights, ...] = ()
        self._noise: tuple[SensorNoise, SensorNoise]
        self._said: list[tuple[bytes, Prediction] | None] = [None] * len(self.trials)
        self.log_determinant = 0.0
        lower, upper = np.full(stop, -np.inf), np.full(stop, np.inf)
        lower[: self.p], upper[: self.p] = model.bounds
        for place in self.places:
            own = slice(place.start, place.start + self.q)
            lower[own] = [parameter.lower for parameter in model.trial_parameters]
            upper[own] = [parameter.upper for parameter in model.trial_parameters]
        for trial, place in zip(self.trials, self.places, strict=True):
            # Further away it would stand in for what the model lacks.
            lower[place.start] = -_FARTHEST_ONSET * trial.onset_std
            upper[place.start] = _FARTHEST_ONSET * trial.onset_std
        self.bounds = (lower, upper)
        self.reach = np.full(stop, np.inf)
        self.reach[: self.p] = np.where(model.log, _REACH, np.inf)

    def search(
        self,
        state: FloatArray,
        *,
        tolerance: float,
        max_evaluations: int = 200,
        known: Evaluated | None = None,
    ) -> Solution:
        """
        Search for the least squares from a state.

        Parameters
        ----------
        state : ndarray
            Where to start.
        tolerance : float
            The search ends where the linear model promises a smaller relative drop.
        max_evaluations : int
            Or after this many evaluations.
        known : Evaluated, optional
            What `evaluate` has returned for the start beside the same noise.

        Returns
        -------
        Solution
            The best state found.

        Raises
        ------
        NotFiniteError
            If the model is not finite at the start.

        """
        return minimise(
            self.evaluate,
            state,
            self.bounds,
            known=known,
            reach=self.reach,
            tolerance=tolerance,
            max_evaluations=max_evaluations,
        )

    def search_on(self, found: Solution) -> Solution:
        """
        Search beside white noise as well, and on from there, where the object is touched again.

        An object that comes after a tool which has left it makes a force that jumps when it gets
        there, and when that is hangs on the parameters. A jump that is misplaced misses some
        samples by much, and beside white noise a search goes to where it misses fewer. Beside
        noise with a memory it is differences of neighbouring samples that count: such a jump
        spoils a few of them, as many near its place as far from it.

        Parameters
        ----------
        found : Solution
            Where the search has ended.

        Returns
        -------
        Solution
            The deeper end; `found` itself where the tool touches the object once, or nothing
            deeper is promised.

        """
        if not self._touches_again(found.theta):
            return found
        kept = self._noise, self._weights, self.log_determinant
        try:
            # What is not known of the moments of jumps would hide that they are misplaced.
            force, height = self._noise
            self.set_noise(_white(force), _white(height))
            led = self.search(found.theta, tolerance=1e-4, max_evaluations=_STEPS).theta
        finally:
            self._noise, self._weights, self.log_determinant = kept
        known = self.evaluate(led)
        if left_over(*known) >= found.cost - _SAME:
            return found
        other = self.search(led, tolerance=_TOLERANCE, known=known)
        return min(found, other, key=lambda end: end.cost)

    def _touches_again(self, state: FloatArray) -> bool:
        """Return whether the tool loses the object in a trial and touches it again."""
        for index in range(len(self.trials)):
            touched = self.predict(state, index, directions=False).touched
            assert touched is not None
            if np.count_nonzero(np.diff(touched.astype(np.int8), prepend=0) > 0) > 1:
                return True
        return False

    def set_noise(
        self, force: SensorNoise, height: SensorNoise, jumps: Sequence[FloatArray] | None = None
    ) -> None:
        """
        Set what the residuals are weighted by.

        Parameters
        ----------
        force, height : SensorNoise
            Noise of one sample.
        jumps : sequence of ndarray, optional
            For each trial, the variance that each step's force has for that the moments of
            jumps and the speed of the push are not known exactly [N^2].

        """
        weights = []
        self._noise = force, height
        self.log_determinant = 0.0
        for i, trial in enumerate(self.trials):
            blocks = force_blocks(trial, None if jumps is None else jumps[i])
            force_filter = whitener(blocks, force)
            self.log_determinant += force_filter.log_determinant
            height_filter = None
            if trial.height_t.size:
                height_filter = whitener(height_blocks(trial), height)
                self.log_determinant += height_filter.log_determinant
            weights.append(_Weights(force_filter, height_filter))
        self._weights = tuple(weights)

    def own_names(self, trial: FitTrial) -> list[str]:
        """Return what a trial's own parameters are called, in their order."""
        return [
            *self.model.trial_names,
            *[f'scatter of {name}' for name in self.model.names[: self.scatter.size]],
            *(['rest'] if trial.rest_std > 0.0 else []),
            *(['force_zero'] if trial.has_force_zero else []),
            *(['height_zero'] if trial.has_height_zero else []),
        ]

    def own(self, state: FloatArray, index: int) -> tuple[FloatArray, float, float]:
        """Return a trial's own parameters and the zeros of its force and height."""
        values = state[self.places[index]]
        trial = self.trials[index]
        place = self._rest + (trial.rest_std > 0.0)
        force_zero = float(values[place]) if trial.has_force_zero else 0.0
        height_zero = float(values[-1]) if trial.has_height_zero else 0.0
        return values[: self.q], force_zero, height_zero

    def scattered(self, index: int) -> slice:
        """Return the place in the state of what a trial's own K1, C1 and C2 differ by."""
        first = self.places[index].start + self.q
        return slice(first, first + self.scatter.size)

    @property
    def _rest(self) -> int:
        """Return the place among a trial's own parameters of where the tool is held."""
        return self.q + self.scatter.size

    def predict(
        self, state: FloatArray, index: int, trial: FitTrial | None = None, *, directions: bool
    ) -> Prediction:
        """Return what the model says of a trial, or of another form of it."""
        if trial is not None or directions:
            return self._predict(state, index, trial, directions)
        # Noise, jumps and residual ask for the same one after the other.
        asked = state[: self.p].tobytes() + state[self.places[index]].tobytes()
        known = self._said[index]
        if known is None or known[0] != asked:
            known = self._said[index] = asked, self._predict(state, index, None, False)
        return known[1]

    def _predict(
        self, state: FloatArray, index: int, trial: FitTrial | None, directions: bool
    ) -> Prediction:
        theta = state[: self.p]
        if self.scatter.size:
            theta = theta.copy()
            theta[: self.scatter.size] += state[self.scattered(index)]
        if trial is None:
            trial = self.trials[index]
        if trial.rest_std > 0.0:
            trial = trial.held(float(state[self.places[index].start + self._rest]))
        own = self.own(state, index)[0]
        return self.model.predict(trial, theta, own, directions=directions, turns=trial.turns)

    def records(self, state: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
        """
        Return residuals and derivatives before whitening.

        Returns
        -------
        force, height : ndarray, shapes (p + own + 1, n), (p + own + 1, m)
            Derivatives of the prediction in the shared parameters, then in the trial's own; last,
            predicted minus measured.

        """
        trial = self.trials[index]
        prediction = self.predict(state, index, directions=True)
        _, force_zero, height_zero = self.own(state, index)
        given = self.p + self.q
        rows = self.p + self.places[index].stop - self.places[index].start + 1
        force = np.zeros((rows, trial.force.size))
        height = np.zeros((rows, trial.height_t.size))
        force[:given] = prediction.d_force
        height[:given] = prediction.d_height
        for k in range(self.scatter.size):
            force[given + k] = prediction.d_force[k]
            height[given + k] = prediction.d_height[k]
        given += self.scatter.size
        if trial.rest_std > 0.0:
            # Almost linear: a small step does.
            step = _REST_STEP * trial.rest_std
            moved = state.copy()
            moved[self.places[index].start + self._rest] += step
            other = self.predict(moved, index, directions=False)
            force[given] = (other.force - prediction.force) / step
            height[given] = (other.height - prediction.height) / step
            given += 1
        if trial.has_force_zero:
            force[given] = 1.0
        if trial.has_height_zero:
            height[rows - 2] = 1.0
        force[-1] = prediction.force + force_zero - trial.force
        height[-1] = prediction.height + height_zero - trial.height
        return force, height

    def residual(
        self, state: FloatArray, index: int, measured: FitTrial | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """
        Return measured minus predicted force and height of a trial, block by block.

        The trial is its own, unless other measurements in the same blocks are given.
        """
        trial = self.trials[index] if measured is None else measured
        prediction = self.predict(state, index, directions=False)
        _, force_zero, height_zero = self.own(state, index)
        return (
            trial.force - prediction.force - force_zero,
            trial.height - prediction.height - height_zero,
        )

    def evaluate(self, state: FloatArray) -> Evaluated:
        """
        Return the whitened residual and Jacobian, shapes (k,) and (k, size).

        Each trial is reduced to its triangular factor, with the same squares and products.
        """
        p, first = self.p, 0
        whole, blocks = np.empty(self._reduced_size), np.zeros((self._reduced_size, self.size))
        for index, place in enumerate(self.places):
            residual, jacobian = self.reduced(state, index)
            if not np.isfinite(residual).all():
                return np.array([math.inf]), np.zeros((1, self.size))
            here = slice(first, first + residual.size)
            whole[here] = residual
            blocks[here, :p] = jacobian[:, :p]
            blocks[here, place] = jacobian[:, p:]
            first = here.stop
        return whole, blocks

    @cached_property
    def _reduced_size(self) -> int:
        """Return how many residuals `evaluate` has."""
        return sum(
            self.p + place.stop - place.start + 1 + known.places.size
            for place, known in zip(self.places, self._known, strict=True)
        )

    def evaluate_trial(self, state: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
        """
        Return one trial's whitened residual and its derivatives in the trial's own parameters.

        Returns
        -------
        residual, jacobian : ndarray, shapes (k,), (k, own)
            Reduced to the triangular factor, with what is known of the parameters beforehand.

        """
        residual, jacobian = self.reduced(state, index)
        if not np.isfinite(residual).all():
            return np.array([math.inf]), np.zeros((1, jacobian.shape[1] - self.p))
        return residual, np.split(jacobian, [self.p], axis=1)[1]

    def reduced(self, state: FloatArray, index: int) -> tuple[FloatArray, FloatArray]:
        """
        Return one trial's whitened residual, and derivatives in the shared and own parameters.

        Returns
        -------
        residual, jacobian : ndarray, shapes (k,), (k, p + own)
            Reduced to the triangular factor, with what is known of the parameters beforehand.

        """
        weights, known = self._weights[index], self._known[index]
        force, height = self.records(state, index)
        rows = weights.force(force)
        if weights.height is not None:
            rows = np.hstack((rows, weights.height(height)))
        factor = triangle(rows)
        if not np.isfinite(factor).all():
            return np.array([math.inf]), np.zeros((1, rows.shape[0] - 1))
        residual = np.concatenate((factor[:, -1], state[known.places] * known.weights))
        return residual, np.concatenate((factor[:, :-1], known.rows))

    @cached_property
    def _known(self) -> tuple[_Known, ...]:
        """Return which own parameters of each trial are known beforehand to be near zero."""
        return tuple(
            _Known.of(*self._known_of(trial), place, self.p)
            for trial, place in zip(self.trials, self.places, strict=True)
        )

    def _known_of(self, trial: FitTrial) -> tuple[list[int], list[float]]:
        """Return the same of a trial, as places among its own, and how well."""
        # The onset is near the detected contact, and trials are alike.
        known = [0, *range(self.q, self.q + self.scatter.size)]
        weights = [1.0 / trial.onset_std, *(1.0 / self.scatter)]
        if trial.rest_std > 0.0:
            known.append(self._rest)
            weights.append(1.0 / trial.rest_std)
        if trial.has_force_zero:
            known.append(self._rest + (trial.rest_std > 0.0))
            weights.append(1.0 / (_ZERO * trial.peak_force))
        return known, weights

    def scatter_price(self, state: FloatArray, jacobian: FloatArray | None = None) -> float:
        """
        Return what the freedom of the trials to scatter costs in minus twice the log likelihood.

        It is ``log det(I + S A^T A S)``, with the standard deviations S of the scatter and the
        whitened derivatives A of each trial beyond those of its other own parameters (Laplace's
        approximation of the integral over the scatter); zero without scatter. The `jacobian` is
        that of `evaluate` at the same state, if it is known.
        """
        total, k = 0.0, self.scatter.size
        if not k:
            return total
        if jacobian is None:
            _, jacobian = self.evaluate(state)
        first = 0
        for known, place in zip(self._known, self.places, strict=True):
            # The factor of its parameters and residual, then what is known beforehand.
            last = first + self.p + place.stop - place.start + 1
            own = jacobian[first:last, place]
            first = last + known.places.size
            columns = np.arange(own.shape[1])
            chosen = (columns >= self.q) & (columns < self.q + k)
            basis, singular, _ = np.linalg.svd(own[:, ~chosen], full_matrices=False)
            basis = basis[:, singular > 1e-12 * singular[0]]
            rest = own[:, chosen] - basis @ (basis.T @ own[:, chosen])
            scaled = rest * self.scatter
            total += float(np.linalg.slogdet(np.eye(k) + scaled.T @ scaled)[1])
        return total

    def priors(self, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return what is known beforehand, as rows of a Jacobian (k, size), residuals (k,)."""
        places = np.concatenate([known.places for known in self._known])
        weights = np.concatenate([known.weights for known in self._known])
        rows = np.zeros((places.size, self.size))
        rows[np.arange(places.size), places] = weights
        return rows, state[places] * weights

    def noise_records(
        self, state: FloatArray, jumps: Sequence[FloatArray]
    ) -> tuple[list[Record], list[Record]]:
        """Return what tells the noise of force and height."""
        forces, heights, p = [], [], self.p
        for index, trial in enumerate(self.trials):
            force, height = self.records(state, index)
            blocks = force_blocks(trial, jumps[index])
            forces.append(Record(blocks, force[-1], force[:p], force[p:-1]))
            if trial.height_t.size:
                heights.append(Record(height_blocks(trial), height[-1], height[:p], height[p:-1]))
        return forces, heights

    def jumps(self, state: FloatArray, blur: Blur = _SAMPLE) -> tuple[FloatArray, ...]:
        """Return the variance of each step's force for what its moment is not known by [N^2]."""
        return tuple(
            _jumps(self.predict(state, i, directions=False).force, trial, blur)
            for i, trial in enumerate(self.trials)
        )

    def unsure(self, state: FloatArray, blur: Blur = _SAMPLE) -> tuple[FloatArray, ...]:
        """Return the same with what the speed of the push is not known by [N^2]."""
        return tuple(
            _unsure(self.predict(state, i, directions=False).force, trial, blur)
            for i, trial in enumerate(self.trials)
        )

    def sharpest(self, state: FloatArray, noise: SensorNoise, blur: Blur) -> Blur:
        """
        Return how well the moments of jumps are known.

        Parameters
        ----------
        state : ndarray
            All parameters.
        noise : SensorNoise
            The noise of the force.
        blur : Blur
            Where to begin to look.

        Returns
        -------
        Blur
            What makes the residual force most likely, among some.

        """
        parts = []
        for index, trial in enumerate(self.trials):
            force = self.predict(state, index, directions=False).force
            zero = self.own(state, index)[1]
            parts.append((trial, force, trial.force - force - zero))
        known: dict[int, tuple[float, float]] = {}

        def misfit(place: int) -> tuple[float, float]:
            """Return the misfit near the touches, and after them, for one place in `_BLURS`."""
            if place not in known:
                touch = later = 0.0
                for trial, force, residual in parts:
                    jumps = _unsure(force, trial, Blur(_BLURS[place], _BLURS[place]))
                    filter_ = whitener(force_blocks(trial, jumps), noise)
                    white = filter_(residual[np.newaxis])[0]
                    half = trial.half_way
                    weight = filter_.weight[:half]
                    first = float(white[:half] @ white[:half])
                    first -= 2.0 * float(np.log(weight[weight > 0.0]).sum())
                    touch += first
                    later += float(white @ white) + filter_.log_determinant - first
                known[place] = touch, later
            return known[place]

        last = _bluntest(self.trials)
        return Blur(
            max(_sharpest(lambda place: misfit(place)[0], blur.touch, last), _TOUCH),
            _sharpest(lambda place: misfit(place)[1], blur.later, last),
        )


def _sharpest(misfit: Callable[[int], float], start: float, last: int) -> float:
    """Return the blur of the least misfit: of the places in `_BLURS` up to `last`, or between."""
    place = min(int(np.argmin(np.abs(np.log(np.array(_BLURS) / start)))), last)
    while True:
        near = range(max(place - 1, 0), min(place + 1, last) + 1)
        best = min(near, key=misfit)
        if best == place:
            break
        place = best
    if len(near) < 3:
        return _BLURS[place]
    # Between the places: what is taken for less sure than it is rewards a smoother model. With a
    # blur of 2^x the misfit is that of a variance of 4^x, a x + b 4^-x.
    below, here, above = (misfit(each) for each in near)
    b = (below - 2.0 * here + above) / 2.25
    a = above - here + 0.75 * b
    if a <= 0.0 or b <= 0.0:
        return _BLURS[place]
    aside = -0.5 * math.log2(a / (b * math.log(4.0)))
    return _BLURS[place] * math.exp2(min(max(aside, -0.5), 0.5))


def places_of(model: Model, effects: Sequence[str]) -> list[int]:
    """Return where the parameters of some effects stand in theta."""
    places: list[int] = []
    place = len(BASE_PARAMETERS)
    for name in model.effects:
        count = len(BY_NAME[name].parameters)
        if name in effects:
            places += range(place, place + count)
        place += count
    return places


def strengths(model: Model) -> NDArray[np.bool_]:
    """
    Return which parameters are stronger or weaker with their effect.

    What is absent by another parameter has a size of its own, but for what goes with a stiffness
    in series.

    Parameters
    ----------
    model : Model
        A model.

    Returns
    -------
    ndarray of bool, shape (p,)
        None of the base parameters.

    """
    found = [False] * len(BASE_PARAMETERS)
    for name in model.effects:
        own = BY_NAME[name].parameters
        found += [math.isinf(own[0].neutral) or not math.isnan(each.neutral) for each in own]
    return np.array(found)


def carried(old: Problem, state: FloatArray, new: Problem) -> FloatArray:
    """
    Return the state of one problem in another, with neutral values for what it lacks.

    Trials are known by their names; one that is new starts with nothing of its own.
    """
    result = np.zeros(new.size)
    values = np.array([0.0 if math.isnan(p.neutral) else p.neutral for p in new.model.parameters])
    base = len(BASE_PARAMETERS)
    old_values = old.model.values(state[: old.p])
    values[:base] = old_values[:base]
    for name in new.model.effects:
        if name in old.model.effects:
            values[places_of(new.model, [name])] = old_values[places_of(old.model, [name])]
    result[: new.p] = np.clip(new.model.theta(values), *new.model.bounds)
    known = {trial.name: index for index, trial in enumerate(old.trials)}
    # Two trials may have one name.
    same = [trial.name for trial in old.trials] == [trial.name for trial in new.trials]
    for number, (trial, place) in enumerate(zip(new.trials, new.places, strict=True)):
        index = number if same else known.get(trial.name)
        if index is None:
            continue
        own = dict(zip(old.own_names(old.trials[index]), state[old.places[index]], strict=True))
        result[place] = [own.get(name, 0.0) for name in new.own_names(trial)]
    return result


def in_order(problem: Problem, ended: Solution, base: Mapping[str, float]) -> Solution:
    """
    Return the same body with its twins exchanged where that is nearer to the base model's.

    Two Kelvin-Voigt units in series are one body by either name, and a search may end at either.

    Parameters
    ----------
    problem : Problem
        Model and trials.
    ended : Solution
        Where a search of the problem has ended.
    base : mapping of str to float
        What the base model shows [SI units].

    Returns
    -------
    Solution
        `ended` itself, or the best beside what an exchange makes of it.

    """
    model = problem.model
    twins = {p.symbol: p.twin for p in model.parameters if p.twin}
    values = model.values(ended.theta[: problem.p])
    ours, theirs = (
        [model.names.index(name) for name in names] for names in (twins.values(), twins)
    )
    aim = np.log([base[name] for name in twins.values()])
    if not twins or _away(values[theirs], aim) >= _away(values[ours], aim):
        return ended
    values[ours + theirs] = values[theirs + ours]
    exchanged = ended.theta.copy()
    exchanged[: problem.p] = np.clip(model.theta(values), *model.bounds)
    # Another effect may act on one of the two alone.
    try:
        found = problem.search(exchanged, tolerance=1e-4, max_evaluations=_LOOKS)
    except NotFiniteError:
        return ended
    return found if found.cost < ended.cost + _SAME else ended


def _away(values: FloatArray, aim: FloatArray) -> float:
    return float(np.abs(np.log(values) - aim).sum())


def force_blocks(trial: FitTrial, extra: FloatArray | None = None) -> Blocks:
    """Return how the force of a trial is averaged."""
    return Blocks(
        trial.duration,
        trial.force_count,
        np.zeros(trial.force.size) if extra is None else extra,
    )


def height_blocks(trial: FitTrial) -> Blocks:
    """Return how the height of a trial is averaged."""
    gaps = np.diff(trial.height_t, prepend=trial.height_t[0] - trial.height_interval)
    extra = np.zeros(trial.height_t.size)
    if trial.height_jitter > 0.0:
        # Whether a sample or only its stamp came off the clock is not known: where the tool moves
        # the surface fast, few samples whose stamps are off would be a clock that is. What it
        # withdraws from goes its own way, and slowly.
        half = 0.5 * trial.height_interval
        before, after = (
            np.maximum(np.interp(trial.height_t + side, trial.t, trial.displacement), 0.0)
            for side in (-half, half)
        )
        speed = (after - before) / trial.height_interval
        if trial.t_release is not None:
            speed[trial.height_t > trial.t_release] = 0.0
        extra = (speed * trial.height_jitter) ** 2 / trial.height_count
    return Blocks(gaps, trial.height_count, extra)


def _jumps(force: FloatArray, trial: FitTrial, blur: Blur = _SAMPLE) -> FloatArray:
    """Return the variance of each step's force for that its moment is known to `blur`."""
    variance = _alike(force, trial, blur.touch)
    if blur.later != blur.touch:
        late = slice(trial.half_way, None)
        variance[late] = _alike(force, trial, blur.later)[late]
    return variance


def _alike(force: FloatArray, trial: FitTrial, blur: float) -> FloatArray:
    """Return it where all moments are known to as many samples."""
    variance = np.empty(force.size)
    _jump_variance(force, trial.middle, trial.spacing, trial.force_count, min(blur, 1.0), variance)
    if blur > 1.0:
        slope = np.diff(force) / np.diff(trial.middle)
        moved = _moved(force, trial.middle, slope, blur, _spacing(trial))
        variance = np.maximum(variance, moved)
    return variance


def _unsure(force: FloatArray, trial: FitTrial, blur: Blur) -> FloatArray:
    """Return the same with what the speed of the tool is not known by."""
    variance = _jumps(force, trial, blur)
    if trial.unsteady is not None:
        variance += trial.unsteady
    push, error = trial.pushed
    if error > 0.0:
        # The error is one for the whole push: each step stands for as much as all tell together.
        variance[push] += (push.stop - push.start) * (error * force[push]) ** 2
    return variance


@kernel()
def _jump_variance(force, middle, spacing, count, blur, variance):  # type: ignore[no-untyped-def]
    """Set the variance for moments known to `blur` samples, from the bends of the force."""
    last = force.size - 1
    before = 0.0
    here = 0.0
    slope = 0.0
    if last > 0:
        slope = (force[1] - force[0]) / (middle[1] - middle[0])
    for i in range(last + 1):
        after = 0.0
        if i + 1 < last:
            steeper = (force[i + 2] - force[i + 1]) / (middle[i + 2] - middle[i + 1])
            after = 0.5 * spacing[i + 1] * abs(steeper - slope)
            slope = steeper
        # A mean over several samples holds the jump in one of them.
        missed = blur * max(before, here, after) / max(count[i], 1.0)
        variance[i] = missed * missed
        before = here
        here = after


def calm(full: FitTrial, force: FloatArray, noise: SensorNoise) -> NDArray[np.bool_]:
    """Return which samples of a trial at the full rate can be held against a prediction."""
    good = full.samples.good & (_jumps(force, full) <= noise.std**2)
    # What goes on for most of a sparse record is no jump.
    sparse = 2 * np.count_nonzero(good) < np.count_nonzero(full.samples.good)
    return full.samples.good if sparse else good


def _spacing(trial: FitTrial) -> float:
    """Return the interval between two samples of the force where they are dense [s]."""
    return float(np.quantile(trial.spacing, _DENSE))


def _bluntest(trials: Sequence[FitTrial]) -> int:
    """Return the place of the worst that moments may be known, in `_BLURS`."""
    # Heights come late by some of their own intervals; one clock for both has no late ones.
    late = max(_LATE * trial.path.interval / _spacing(trial) for trial in trials)
    return int(np.searchsorted(_BLURS, max(late, 1.0), side='right')) - 1


@kernel()
def _running_median(value, reach):  # type: ignore[no-untyped-def]
    """Return the median of each value and as many before and after it; the ends go on."""
    # An own kernel, sorting by itself: scipy.ndimage takes a fifth of a short fit to import, and
    # what numba makes of a sort loads scipy.linalg.
    last = value.size - 1
    window = np.empty(2 * reach + 1)
    for i in range(window.size):
        come = value[min(max(i - reach, 0), last)]
        at = i
        while at > 0 and window[at - 1] > come:
            window[at] = window[at - 1]
            at -= 1
        window[at] = come
    median = np.empty(value.size)
    for i in range(value.size):
        median[i] = window[reach]
        gone = value[max(i - reach, 0)]
        come = value[min(i + reach + 1, last)]
        at = 0
        beyond = 2 * reach
        while at < beyond:
            middle = (at + beyond) // 2
            if window[middle] < gone:
                at = middle + 1
            else:
                beyond = middle
        while at < 2 * reach and window[at + 1] < come:
            window[at] = window[at + 1]
            at += 1
        while at > 0 and window[at - 1] > come:
            window[at] = window[at - 1]
            at -= 1
        window[at] = come
    return median


def _moved(
    force: FloatArray, t: FloatArray, slope: FloatArray, blur: float, spacing: float
) -> FloatArray:
    """Return the mean square of what a force changes by, beyond its trend, when it is moved."""
    # A tool that goes on as it did is known from many of its heights.
    window = 2 * int(_TREND * blur) + 9
    trend = _running_median(slope, window // 2)
    trend = np.append(trend, trend[-1])
    offsets = np.linspace(-_FAR, _FAR, 2 * int(_FAR * blur) + 5)
    weights = np.exp(-0.5 * offsets**2)
    total = np.zeros(force.size)
    _move(force, t, trend, offsets * blur * spacing, weights / weights.sum(), total)
    return total


@kernel()
def _move(force, t, trend, offsets, weights, total):  # type: ignore[no-untyped-def]
    """Add to `total` the weighted squares of what each offset changes the force by."""
    last = t.size - 1
    for k in range(offsets.size):
        offset = offsets[k]
        after = 1
        for i in range(last + 1):
            at = t[i] + offset
            # Far from the ends of the record nothing is extrapolated.
            if at < t[0] or at > t[last]:
                continue
            while after < last and t[after] < at:
                after += 1
            slope = (force[after] - force[after - 1]) / (t[after] - t[after - 1])
            change = force[after] + slope * (at - t[after]) - force[i] - offset * trend[i]
            total[i] += weights[k] * change * change


def fit(
    campaign: Sequence[Segmented],
    model: Model | None = None,
    *,
    start: Mapping[str, float] | None = None,
) -> Fit:
    """
    Fit a model to all trials of a campaign at once.

    Parameters
    ----------
    campaign : sequence of TrialAnalysis or (Trial, Segmentation)
        The trials.
    model : Model, optional
        What to fit; the three-element model by default.
    start : mapping of str to float, optional
        Where to start for some parameters, in SI units; all others start from what the force
        alone tells by linear least squares.

    Returns
    -------
    Fit
        The parameters with their errors.

    Raises
    ------
    UsageError
        If there is no trial to fit, or `start` names what the model does not have.

    """
    model = Model() if model is None else model
    prepared, warnings = prepare(pairs_of(campaign), windows=bool(_FAST & set(model.effects)))
    return fit_prepared(prepared, model, start=start, warnings=warnings)


def fit_prepared(
    prepared: Sequence[FitTrial | None],
    model: Model,
    *,
    start: Mapping[str, float] | None = None,
    near: Fit | None = None,
    scatter: FloatArray | None = None,
    warnings: Sequence[str] = (),
) -> Fit:
    """
    Fit a model to trials that are in the form of the fit already, as `fit` does.

    Parameters
    ----------
    prepared : sequence of (FitTrial or None)
        From `hapticvision_ros.core.fit.data.prepare`.
    model : Model
        What to fit.
    start : mapping of str to float, optional
        Where to start.
    near : Fit, optional
        A fit to other trials of the same object, or of another model, to start from instead of
        looking for a start.
    scatter : ndarray, shape (3,), optional
        Standard deviations of the logarithms of K1, C1 and C2 from trial to trial.
    warnings : sequence of str
        What is known already of the trials.

    Returns
    -------
    Fit
        The parameters with their errors.

    Raises
    ------
    UsageError
        If there is no trial to fit, or `start` names what the model does not have.

    """
    usable = [trial for trial in prepared if trial is not None]
    if not usable:
        why = f': {warnings[0]}' if warnings else ''
        raise UsageError(f'there is no trial to fit{why}')
    for name in start or {}:
        if name not in model.names:
            raise UsageError(
                f'the model has no parameter {name!r}: choose among {", ".join(model.names)}'
            )
    try:
        ends = _ends(usable, model, start, near, scatter)
    except NotFiniteError:
        names = ', '.join(trial.name for trial in usable)
        raise UsageError(
            f'the {model.name} model has no finite value at any start for {names}: leave out what '
            'the report shows to be no push'
        ) from None
    # Which of several valleys is right shows once each has its own noise.
    best = min(ends, key=lambda end: end.solution.cost + end.problem.log_determinant)
    told = list(warnings)
    if are_few(usable) and any(trial.height_t.size for trial in usable):
        told.append(
            'the displacement heights are too few to tell their noise: it is taken as '
            f'{1e6 * best.height_noise.std:.2g} um'
        )
    return _result(prepared, best, told)


class _End(NamedTuple):
    """Where a search with its own noise has ended."""

    problem: Problem
    solution: Solution
    force_noise: SensorNoise
    height_noise: SensorNoise
    blur: Blur
    memory: 'Memory'


def _ends(
    usable: Sequence[FitTrial],
    model: Model,
    start: Mapping[str, float] | None,
    near: Fit | None,
    scatter: FloatArray | None,
) -> 'list[_End]':
    """Return where the searches end, each with the noise that its residual shows."""
    if near is None:
        force_noise, height_noise = _first_noise(usable)
        problem, states, body = _search(usable, model, start, force_noise, height_noise)
    else:
        force_noise, height_noise = near.noise.force, near.noise.height
        problem, body = Problem(model, usable), None
        states = [carried(near.problem, near.state, problem)]
    blur = _SAMPLE if near is None else near.noise.blur
    limit = _known_memory(usable, near) or longest_memory(usable)
    force_noise = replace(force_noise, wander=limit.wander, wander_time=limit.wander_time)
    ends = list[_End]()
    for state in states:
        # Each has a problem of its own, whose weights are those of its noise.
        own = Problem(model, usable, scatter)
        begin = carried(problem, state, own)
        ends.append(_weighted(own, begin, force_noise, height_noise, blur, limit, body=body))
    return ends


def _known_memory(trials: Sequence[FitTrial], near: Fit | None) -> 'Memory | None':
    """Return the memory of the noise from a fit of trials of the same names."""
    if near is None or [t.name for t in near.problem.trials] != [t.name for t in trials]:
        return None
    return near.noise.memory


def _weighted(
    problem: Problem,
    state: FloatArray,
    force_noise: SensorNoise,
    height_noise: SensorNoise,
    blur: Blur,
    limit: 'Memory',
    *,
    body: Mapping[str, float] | None,
) -> _End:
    """
    Return the best parameters with the noise that their residual shows.

    A search that is fresh has a body that the base model shows.
    """
    trials = problem.trials
    for turn in range(_ROUNDS):
        moved = replace_onsets(problem, state, force_noise, _HALF) if turn else False
        if moved:
            # What was taken for not known was misplaced, and would be moved away again.
            blur = problem.sharpest(state, force_noise, blur).at_least(_SAMPLE)
        jumps = problem.unsure(state, blur)
        forces, heights = problem.noise_records(state, jumps)
        before, first = force_noise, turn == 0 and body is not None
        if first:
            # The second turn looks at all of them.
            step = max(1, len(forces) // _FIRST_RECORDS)
            forces, heights = forces[::step], heights[::step]
        force_noise = follow(
            forces, force_noise, trials[0].interval, first, limit.force, limit.least_force
        )
        if heights and are_few(trials):
            height_noise = _of_few(heights, trials)
        elif heights:
            interval = trials[0].height_interval
            height_noise = follow(
                heights, height_noise, interval, first, limit.height, limit.least_height
            )
        # Error bars are those of moments known to a sample, however sharp these look.
        blur = problem.sharpest(state, force_noise, blur).at_least(_SAMPLE)
        problem.set_noise(force_noise, height_noise, problem.unsure(state, blur))
        solution = problem.search(state, tolerance=_TOLERANCE)
        solution = problem.search_on(solution)
        state = solution.theta
        if body is not None and turn == 0:
            # The next turn goes on from there.
            state = in_order(problem, solution, body).theta
        cleaned = _without_outliers(problem, state, force_noise) if turn == 1 else None
        if cleaned is not None:
            scatter = problem.scatter if problem.scatter.size else None
            problem = Problem(problem.model, cleaned, scatter)
            continue
        if abs(math.log(force_noise.std / before.std)) < _SETTLED and turn > 0 and not moved:
            break
    return _End(problem, solution, force_noise, height_noise, blur, limit)


def _first_noise(trials: Sequence[FitTrial]) -> tuple[SensorNoise, SensorNoise]:
    """Return a guess of each sensor's noise: as much slow as white, over some samples."""
    force, height = [], []
    for trial in trials:
        good = trial.samples.good
        air = np.searchsorted(trial.samples.edges, trial.t_contact) - 2
        force.append(_guess(trial.samples.force[:air][good[:air]], trial.samples.force[good]))
        if trial.height.size > 8:
            early = int(np.searchsorted(trial.height_t, trial.t_contact))
            height.append(_guess(trial.height[:early], trial.height))
    least_force, least_height = quietest(trials)
    return (
        _even(max(float(np.median(force)), least_force), trials[0].interval),
        _even(
            max(float(np.median(height)) if height else 0.0, least_height),
            trials[0].height_interval,
        ),
    )


def quietest(trials: Sequence[FitTrial]) -> tuple[float, float]:
    """Return the least noise of a sample of force [N] and of height [m]."""
    peak = max(float(np.abs(trial.force).max()) for trial in trials)
    return QUIETEST * peak, QUIETEST * trials[0].reference_depth


def are_few(trials: Sequence[FitTrial]) -> bool:
    """Return whether the displacement heights are too few to tell their noise."""
    return sum(float(trial.height_count.sum()) for trial in trials) < _FEWEST_HEIGHTS


def _of_few(records: Sequence[Record], trials: Sequence[FitTrial]) -> SensorNoise:
    """Return the noise of heights that are too few to tell it: no less than is usual."""
    count = sum(record.residual.size for record in records)
    squares = sum(float(record.blocks.count @ record.residual**2) for record in records)
    zeros = sum(trial.has_height_zero for trial in trials)
    std = math.sqrt(squares / max(count - zeros - 1, 1))
    usual = _USUAL * trials[0].reference_depth
    return SensorNoise(max(std, usual), 0.0, 20.0 * trials[0].height_interval)


def follow(
    records: Sequence[Record],
    start: SensorNoise,
    interval: float,
    everywhere: bool,
    longest: float,
    least: float = 0.0,
) -> SensorNoise:
    """Return the noise, looked for near a start and, if it is not as large there, everywhere."""
    if not everywhere:
        near = _at_least(
            least, estimate(records, start, interval, everywhere=False, longest=longest)
        )
        if abs(math.log(near.std / start.std)) < _OTHER:
            return near
        start = near
    return _at_least(least, estimate(records, start, interval, longest=longest))


def _at_least(std: float, noise: SensorNoise) -> SensorNoise:
    """Return noise that is no quieter than a sensor can be."""
    # A simulation may have none at all, or a model explain it to the last digit.
    if noise.std >= std:
        return noise
    return replace(noise, white=math.sqrt(std**2 - noise.slow**2 - noise.wander**2))


class Memory(NamedTuple):
    """
    What is known of the noise's memory before any model is fitted.

    Parameters
    ----------
    force, height : float
        Longest memory that the noise of each may have [s].
    wander, wander_time : float
        Standard deviation [N] and correlation time [s] of the force's zero; none where 0 N.
    least_force, least_height : float
        The least noise of a sample [N, m].

    """

    force: float
    height: float
    wander: float = 0.0
    wander_time: float = math.inf
    least_force: float = 0.0
    least_height: float = 0.0


def longest_memory(trials: Sequence[FitTrial]) -> Memory:
    """
    Return the longest memory that the noise of force and height may have.

    What a model lacks goes on for as long as a trial does and would pass for noise with such a
    memory. Noise is taken to forget within a hundredth of the trial, unless the force without
    contact, which no model is needed for, shows that it is slower, or that its zero wanders.
    """
    record = max(float(trial.t[-1] - trial.t[0]) for trial in trials)
    interval, height_interval = trials[0].interval, trials[0].height_interval
    least_force, least_height = quietest(trials)
    memory = Memory(
        max(_MEMORY * record, _MEMORY_SAMPLES * interval),
        max(_MEMORY * record, _MEMORY_SAMPLES * height_interval),
        least_force=least_force,
        least_height=least_height,
    )
    parts = [part for part in map(without_contact, trials) if part is not None]
    if sum(rest.size for _, rest, _ in parts) < _BASELINE:
        return memory
    spread = math.sqrt(
        float(np.sum([np.sum(rest**2 * blocks.count) for blocks, rest, _ in parts]))
        / float(np.sum([blocks.count.sum() for blocks, _, _ in parts]))
    )
    # Where a simulation without noise has a drift, that is all there is.
    if spread <= least_force:
        return memory
    # A zero that goes alike in all trials, with the time, the way or the speed of the tool, is an
    # effect and does not wander. Few trials whose zeros wander may seem to go alike: it must be
    # the better account of both.
    guess = _even(spread, interval)
    rows = _new_rows(parts)
    going = _air(parts, [row for row in rows if row != _ACCELERATION])
    if _ACCELERATION in rows:
        # Few samples tell of a mass of the tool: it must be felt.
        felt = _air(parts, rows)
        if _likelihood(going, guess) - _likelihood(felt, guess) > _FELT:
            going = felt
    found = _zero(going, memory, guess, interval)
    if found is None:
        return memory
    still = _air(parts, ())
    likelihood = _likelihood(going, found.noise)
    other = _zero(still, memory, guess, interval)
    # Where noise alone would do as well, each curve gains one by chance.
    least = _DRIFTS
    if deviance(still, found.noise) - likelihood < _DRIFTS:
        least = float(going[0].shared.shape[0])
    if other is not None and other.deviance - likelihood < least:
        return other.memory
    return found.memory


class _Zero(NamedTuple):
    """The noise of a force without contact, its deviance, and what it makes of the memory."""

    noise: SensorNoise
    deviance: float
    memory: Memory


def _zero(
    air: Sequence[Record], memory: Memory, start: SensorNoise, interval: float
) -> _Zero | None:
    """Return how the force without contact goes about its zero; None where it does not."""
    free = estimate(air, start, interval)
    if free.std <= memory.least_force:
        return None
    brief = free
    if free.correlation_time > memory.force:
        brief = estimate(air, start, interval, longest=memory.force)
    level, slow = deviance(air, brief), deviance(air, free)
    wanders = wandering(air, brief, interval, memory.force, at_least=0.5 * _WANDERS)
    if wanders is not None:
        wandered = deviance(air, wanders)
        if level - wandered > max(level - slow, 0.0) + _WANDERS:
            known = memory._replace(wander=wanders.wander, wander_time=wanders.wander_time)
            return _Zero(wanders, wandered, known)
    if level - slow > _SEEN:
        known = memory._replace(force=max(memory.force, _SLOWER * free.correlation_time))
        return _Zero(free, slow, known)
    return _Zero(brief, level, memory)


def _new_rows(parts: Sequence[tuple[Blocks, FloatArray, FloatArray]]) -> list[int]:
    """Return which rows of what is known without contact tell anything beside those before."""
    stacked = [
        along - (along @ blocks.count / blocks.count.sum())[:, np.newaxis]
        for blocks, _, along in parts
    ]
    weights = np.sqrt(np.concatenate([blocks.count for blocks, _, _ in parts]))
    rows = np.concatenate(stacked, axis=1) * weights
    chosen, basis = list[int](), np.zeros((0, rows.shape[1]))
    for index, row in enumerate(rows):
        left = row - basis.T @ (basis @ row)
        size = float(left @ left)
        if size > _NEW * float(row @ row) > 0.0:
            chosen.append(index)
            basis = np.vstack((basis, left / math.sqrt(size)))
    return chosen


def _air(
    parts: Sequence[tuple[Blocks, FloatArray, FloatArray]], rows: Sequence[int]
) -> list[Record]:
    """Return the force without contact about a zero of each trial, and what it may go with."""
    return [
        Record(blocks, rest, along[list(rows)], np.ones((1, rest.size)))
        for blocks, rest, along in parts
    ]


def _likelihood(air: Sequence[Record], noise: SensorNoise) -> float:
    """Return minus twice the log likelihood of records beside what they go with."""
    return deviance(air, noise) - _told(air, noise)


def _told(air: Sequence[Record], noise: SensorNoise) -> float:
    """Return what records tell of the parameters that they share: the log determinant."""
    count = air[0].shared.shape[0]
    told = np.zeros((count, count))
    for record in air:
        white = whitener(record.blocks, noise)(np.concatenate((record.shared, record.own)))
        shared, own = white[:-1], white[-1]
        told += shared @ shared.T - np.outer(shared @ own, shared @ own) / float(own @ own)
    return float(np.linalg.slogdet(told)[1])


def without_contact(trial: FitTrial) -> tuple[Blocks, FloatArray, FloatArray] | None:
    """
    Return the force before the touch and after the tool has left, less its mean.

    Both are of one record, between which a block without samples stands for the push: how far the
    zero has gone meanwhile tells most of how it wanders.

    Parameters
    ----------
    trial : FitTrial
        A trial as the fit sees it.

    Returns
    -------
    tuple of Blocks, ndarray and ndarray, or None
        The record, of n blocks; the force [N], shape (n,); what it may go with, shape (5, n): the
        time since the zero [s], whether the tool slides and which way, its displacement [m], speed
        [m/s] and acceleration [m/s^2]. None where hardly anything is seen without contact.

    """
    blocks = force_blocks(trial)
    middle = 0.5 * (trial.t[1:] + trial.t[:-1])
    clear = trial.displacement[1:] < -_CLEARANCE * trial.reference_depth
    pieces = [middle < trial.t_contact - _EDGE * trial.interval]
    if trial.t_release is not None:
        pieces.append((middle > trial.t_release) & clear)
    chosen = np.zeros(middle.size, dtype=np.bool_)
    for piece in pieces:
        inside = piece & (blocks.count > 0.0)
        if np.count_nonzero(inside) >= _FEW:
            chosen |= inside
    at = np.flatnonzero(chosen)
    if at.size == 0:
        return None
    mean = float(trial.force[at] @ blocks.count[at]) / float(blocks.count[at].sum())
    gaps = np.flatnonzero(np.diff(at) > 1)
    length = trial.t[at[gaps + 1]] - trial.t[at[gaps] + 1]
    part = Blocks(
        np.insert(blocks.duration[at], gaps + 1, length),
        np.insert(blocks.count[at], gaps + 1, 0.0),
        np.zeros(at.size + gaps.size),
    )
    rest = np.insert(trial.force[at] - mean, gaps + 1, 0.0)
    speed = np.diff(trial.displacement) / np.diff(trial.t)
    along = np.stack(
        (
            middle - trial.zero_time,
            np.tanh(speed / _SLIDES),
            0.5 * (trial.displacement[1:] + trial.displacement[:-1]),
            speed,
            acceleration(trial.t, trial.displacement),
        )
    )
    return part, rest, np.insert(along[:, at], gaps + 1, 0.0, axis=1)


def _even(std: float, interval: float) -> SensorNoise:
    """Return noise that is as much slow as white."""
    return SensorNoise(math.sqrt(0.5) * std, math.sqrt(0.5) * std, 20.0 * interval)


def _white(noise: SensorNoise) -> SensorNoise:
    """Return noise of the same size that forgets at once."""
    return replace(noise, white=noise.std, slow=0.0, wander=0.0)


def _guess(air: FloatArray, whole: FloatArray) -> float:
    """Return the scatter without contact, or what neighbouring samples show."""
    if air.size >= 32:
        return float(np.std(air))
    curvature = np.abs(np.diff(whole[:200_000], 2))
    return NORMAL_FROM_MAD * float(np.median(curvature)) / math.sqrt(6.0)


def _of_body(body: ThreeElement) -> tuple[float, float, float]:
    return body.K1, body.C1, body.C2


def _search(
    trials: Sequence[FitTrial],
    model: Model,
    start: Mapping[str, float] | None,
    force_noise: SensorNoise,
    height_noise: SensorNoise,
) -> tuple[Problem, list[FloatArray], dict[str, float]]:
    """Return the problem with white noise, states from several starts, and the base's body."""
    # Beside noise with a memory a search may end on its way: see `Problem.search_on`.
    force_noise, height_noise = _white(force_noise), _white(height_noise)
    base = Model()
    body = _of_body(identify(trials, force_noise.std))
    values = dict(zip(('K1', 'C1', 'C2'), body, strict=True))
    problem = Problem(base, trials)
    given = {} if start is None else dict(start)
    starts = [values]
    slow = slow_body(trials, values)
    if slow is not None:
        starts.append(slow)
    if any(name in values for name in given):
        starts.append({name: given.get(name, value) for name, value in values.items()})
    ends = [_ended(problem, each, force_noise, height_noise) for each in starts]
    samples = sum(float(t.force_count.sum() + t.height_count.sum()) for t in trials)
    if len(trials) > 1 and min(end.squares for end in ends) > _MISSED**2 * samples:
        # Where contacts are told wrongly all trials together mislead; most by themselves may not.
        each = np.array([_of_body(identify([trial], force_noise.std)) for trial in trials])
        usual = dict(zip(values, np.exp(np.median(np.log(each), axis=0)), strict=True))
        ends.append(_ended(problem, usual, force_noise, height_noise))
    # A start that was asked for may lead into a wrong valley; others stand beside it.
    ends.sort(key=lambda end: end.deviance)
    state = ends[0].state
    problem.set_noise(force_noise, height_noise, problem.unsure(state))
    K1, C1, C2 = base.values(state[:3]).tolist()
    shown = {'K1': K1, 'C1': C1, 'C2': C2}
    if not model.effects:
        return problem, [end.state for end in ends], shown
    scale = scale_of(problem, state, K1, C1, C2)
    whole = Problem(model, trials)
    whole.set_noise(force_noise, height_noise, problem.unsure(state))
    guess, strong = model.values(model.first_guess(scale)), strengths(model)
    tried: list[Solution] = []
    for factor in (1.0, 0.1, 0.01, 10.0):
        values_ = np.where(strong, factor * guess, guess)
        for name, value in given.items():
            values_[model.names.index(name)] = value
        begin = np.zeros(whole.size)
        begin[: whole.p] = np.clip(model.theta(values_), *model.bounds)
        for old, new in zip(problem.places, whole.places, strict=True):
            # The onsets of the smaller model make up for what it lacks: they start anew.
            # The zeros stand last.
            zeros = np.arange(old.stop - old.start - 1)
            begin[new.stop - 1 - zeros] = state[old.stop - 1 - zeros]
        if tried and not guess[3:].any():
            break
        turn_phases(whole, begin)
        with contextlib.suppress(ValueError):
            tried.append(whole.search(begin, tolerance=1e-3, max_evaluations=_LOOKS))
    if not tried:
        raise UsageError(f'the model {model.name} cannot be evaluated near any start')
    best = min(tried, key=lambda found: found.cost)
    best = whole.search(best.theta, tolerance=1e-4, max_evaluations=_STEPS)
    # What the model lacked has moved the onsets.
    again = best.theta.copy()
    find_onsets(whole, again)
    moved = whole.search(again, tolerance=1e-4, max_evaluations=_STEPS)
    state = min((best, moved), key=lambda found: found.cost).theta
    return whole, [state], shown


class _Valley(NamedTuple):
    """Where a first search has ended: its squares, with those of the noise, and the state."""

    squares: float
    deviance: float
    state: FloatArray


def _ended(
    problem: Problem,
    values: Mapping[str, float],
    force_noise: SensorNoise,
    height_noise: SensorNoise,
) -> _Valley:
    """Return where a search of the base model with white noise ends."""
    state = np.zeros(problem.size)
    state[:3] = problem.model.theta(list(values.values()))
    for _ in range(2):
        find_onsets(problem, state)
        # Where the force jumps depends on the onsets.
        problem.set_noise(force_noise, height_noise, problem.unsure(state))
        state = problem.search(state, tolerance=1e-4).theta
    problem.set_noise(force_noise, height_noise, problem.unsure(state))
    residual, _ = problem.evaluate(state)
    squares = float(residual @ residual)
    return _Valley(squares, squares + problem.log_determinant, state)


def slow_body(trials: Sequence[FitTrial], body: Mapping[str, float]) -> dict[str, float] | None:
    """
    Return the slow body that an object may be whose force shows a dashpot alone.

    The two dashpots may be that one together, which the height tells. A relaxation so brief may
    also be how the force jumps where the path is not well known, or a spring in series.

    Parameters
    ----------
    trials : sequence of FitTrial
        The trials.
    body : mapping of str to float
        K1 [N/m], C1 and C2 [N.s/m] as they were found.

    Returns
    -------
    dict of str to float or None
        K1, C1 and C2 of the slow body; None where the relaxation is none of a dashpot alone.

    """
    relaxation = (body['C1'] + body['C2']) / body['K1']
    contact = max(float(trial.t[-1] - trial.t_contact) for trial in trials)
    if relaxation >= max(_QUICK * trials[0].interval, _BRIEF * contact):
        return None
    both = 2.0 * body['C2']
    return {'K1': both / contact, 'C1': both, 'C2': both}


def find_onsets(problem: Problem, state: FloatArray) -> None:
    """
    Set the onsets to where the first force of each trial is followed best.

    The force of a dashpot jumps at the touch: a search that goes by slopes does not see which way
    the jump has to move, as no sample changes before it passes one.
    """
    for index in range(len(problem.trials)):
        _find_onset(problem, state, index)


def replace_onsets(problem: Problem, state: FloatArray, noise: SensorNoise, blur: Blur) -> bool:
    """
    Look for the onsets again that leave more than the noise near the touch.

    Parameters
    ----------
    problem : Problem
        Model and trials.
    state : ndarray
        All parameters; changed where another onset is better.
    noise : SensorNoise
        The noise of the force.
    blur : Blur
        How well the moments of jumps are known: where one is misplaced by less, it is left.

    Returns
    -------
    bool
        Whether any onset was moved.

    """
    moved = False
    for index, trial in enumerate(problem.trials):
        chosen = trial.near_touch
        if not chosen.stop:
            continue
        head = trial.touch_head
        place = problem.places[index].start
        old = float(state[place])
        first = int(np.argmax(head.displacement > -old))
        beside = slice(max(first - _TOUCHING, 0), min(first + _TOUCHING, chosen.stop))
        force = problem.predict(state, index, head, directions=False).force
        variance = _jumps(force, head, blur)[beside] + noise.std**2
        # The samples of the jump itself tell.
        left = _squares(problem, state, index, head, beside)
        if left < _MISPLACED * float(head.force_count[beside] @ variance):
            continue
        squares = _squares(problem, state, index, head, chosen)
        _find_onset(problem, state, index, finely=True)
        better = squares - _BETTER * float(variance.max())
        if _squares(problem, state, index, head, chosen) < better:
            moved = True
        else:
            state[place] = old
    return moved


def _squares(
    problem: Problem, state: FloatArray, index: int, head: FitTrial, chosen: slice
) -> float:
    """Return the squares of the residual force in some steps of a trial's head."""
    predicted = problem.predict(state, index, head, directions=False).force[chosen]
    residual = predicted + problem.own(state, index)[1] - head.force[chosen]
    return float(head.force_count[chosen] @ residual**2)


def _find_onset(problem: Problem, state: FloatArray, index: int, *, finely: bool = False) -> None:
    """Set the onset of one trial to where its first force is followed best."""
    trial, place = problem.trials[index], problem.places[index].start
    reach, chosen = _ONSET_REACH * trial.onset_std, trial.near_touch
    if not chosen.stop:
        return
    head = trial.touch_head
    zooms = _ONSET_ZOOMS
    if finely:
        push = trial.pushed[0]
        way, spent = (float(x[push.stop] - x[push.start]) for x in (trial.displacement, trial.t))
        if way > 0.0:
            finest = _ONSET_PART * way * trial.interval / spent
            zooms = min(max(zooms, math.ceil(math.log(0.25 * reach / finest, 3.0)) + 1), 20)
    state[place] = 0.0
    for _ in range(zooms):
        tried = state[place] + np.linspace(-reach, reach, 9)
        costs = []
        for value in tried:
            state[place] = value
            costs.append(_squares(problem, state, index, head, chosen))
        state[place] = tried[int(np.argmin(costs))]
        reach /= 3.0


def turn_phases(problem: Problem, state: FloatArray) -> None:
    """Start the trials' own parameters that have no neutral value where they fit best."""
    for k, parameter in enumerate(problem.model.trial_parameters):
        if not math.isnan(parameter.neutral):
            continue
        for index, trial in enumerate(problem.trials):
            place = problem.places[index].start + k
            costs = []
            tried = np.linspace(-math.pi, math.pi, 8, endpoint=False)
            for value in tried:
                state[place] = value
                prediction = problem.predict(state, index, directions=False)
                missed = (prediction.force - trial.force) ** 2
                costs.append(float(trial.force_count @ missed))
            state[place] = tried[int(np.argmin(costs))]


def scale_of(problem: Problem, state: FloatArray, K1: float, C1: float, C2: float) -> Scale:
    """Return what the campaign looks like."""
    trials = problem.trials
    speeds, contacts = [], []
    for trial in trials:
        end = trial.t[-1] if trial.t_release is None else trial.t_release
        contacts.append(float(end - trial.t_contact))
        deepest = float(trial.t[int(np.argmax(trial.displacement))])
        reach = float(trial.displacement.max())
        early = float(np.interp(0.9 * reach, *_rising(trial, deepest)))
        speeds.append(0.9 * reach / max(early - trial.t_contact, trial.interval))
    line = line_spectrum(problem, state)
    opening, held_back = _opening(problem, state)
    return Scale(
        K1=float(K1),
        C1=float(C1),
        C2=float(C2),
        force=max(float(np.abs(trial.force).max()) for trial in trials),
        depth=trials[0].reference_depth,
        push_speed=float(np.median(speeds)),
        contact_time=float(np.median(contacts)),
        sampling_interval=trials[0].interval,
        campaign_time=max(trial.campaign_time for trial in trials),
        disturbance_amplitude=line.amplitude,
        disturbance_frequency=line.frequency,
        pull=_pull(problem, state),
        opening=opening,
        held_back=held_back,
    )


def _pull(problem: Problem, state: FloatArray) -> float:
    """Return the largest force that holds the tool back in the usual withdrawal [N]."""
    pulls = []
    for index, trial in enumerate(problem.trials):
        if trial.t_release is None:
            continue
        seen = (trial.t[1:] > trial.t_release) & (trial.force_count > 0.0)
        if seen.any():
            _, zero, _ = problem.own(state, index)
            pulls.append(zero - float(trial.force[seen].min()))
    return max(float(np.median(pulls)), 0.0) if pulls else 0.0


def _opening(problem: Problem, state: FloatArray) -> tuple[float, float]:
    """Return how far tool and surface are apart where a pull ends [m], and its mean [N]."""
    openings, pulls = [], []
    for index, trial in enumerate(problem.trials):
        if trial.t_release is None:
            continue
        own, zero, height_zero = problem.own(state, index)
        first = int(np.searchsorted(trial.t, trial.t_release))
        pull, last = _drawn(zero - trial.force[first:], trial.force_count[first:])
        if last == 0:
            continue
        end = float(trial.t[first + last])
        near = slice(*np.searchsorted(trial.height_t, (trial.t_release, end)))
        # The surface comes up as it goes on, and falls back when it is let go.
        t, height = (each[near][-_LAST_HELD:] for each in (trial.height_t, trial.height))
        if t.size < 2 or t[-1] <= t[0]:
            continue
        surface = float(np.polyfit(t - end, height, 1)[1])
        tool = float(np.interp(end, trial.t, trial.displacement)) + float(own[0])
        openings.append(surface - height_zero - tool)
        pulls.append(pull)
    if not openings:
        return 0.0, 0.0
    return max(float(np.median(openings)), 0.0), float(np.median(pulls))


def _drawn(pull: FloatArray, count: FloatArray) -> tuple[float, int]:
    """
    Return the mean of a pull that goes on for a while, and how many steps are up to its end.

    A single reading of noise is not taken for it: of all runs of steps it is the one that is above
    a level by most in all, and the level half of what the run before has told.
    """
    level, mean, last = 0.25 * float(pull.max(initial=0.0)), 0.0, 0
    for _ in range(_LEVELS):
        above = np.concatenate(([0.0], np.cumsum(count * (pull - level))))
        rise = above - np.minimum.accumulate(above)
        last = int(np.argmax(rise))
        start = int(np.flatnonzero(above[: last + 1] == above[: last + 1].min())[-1])
        seen = float(count[start:last].sum())
        if seen <= 0.0:
            return 0.0, 0
        mean = float(count[start:last] @ pull[start:last]) / seen
        level = 0.5 * mean
    return mean, last


def _rising(trial: FitTrial, deepest: float) -> tuple[FloatArray, FloatArray]:
    """Return displacement, increasing, and time of the push."""
    inside = (trial.t >= trial.t_contact) & (trial.t <= deepest)
    return np.maximum.accumulate(trial.displacement[inside]), trial.t[inside]


@dataclass(frozen=True, slots=True)
class Line:
    """
    The strongest line in the spectrum of a residual force.

    Parameters
    ----------
    amplitude, frequency : float
        Of the sine [N, Hz].
    chance : float
        Probability that noise which is smooth in frequency shows such a line anywhere.

    """

    amplitude: float
    frequency: float
    chance: float


def line_spectrum(problem: Problem, state: FloatArray) -> Line:
    """Return the strongest line in the residual force of the trials of the highest rate."""
    from scipy.special import gammaincc, gammaincinv

    total = np.empty(0)
    # Slower trials show a line that is too quick for them elsewhere, with phases that are lost.
    interval = min(trial.interval for trial in problem.trials)
    quick = [k for k, t in enumerate(problem.trials) if t.interval < _AS_QUICK * interval]
    shortest = min(float(problem.trials[k].t[-1] - problem.trials[k].t[0]) for k in quick)
    length = _quick_length(int(shortest / interval))
    ago = interval * np.arange(length - 1, -1, -1.0)
    for index in quick:
        full = problem.trials[index].full_rate
        residual = full.force - problem.predict(state, index, full, directions=False).force
        # Samples that are missing would shift the phase of all that follow.
        seen = full.force_count > 0.0
        middle = full.middle[seen]
        piece = np.interp(middle[-1] - ago, middle, residual[seen])
        piece -= piece.mean()
        power = np.abs(np.fft.rfft(piece * np.hanning(length))) ** 2
        total = power if total.size == 0 else total + power
    total[:_TURNS] = 0.0
    peak = int(np.argmax(total / _background(total)))
    places = np.arange(max(peak - 1, 0), min(peak + 2, total.size))
    around = total[places]
    weight = max(float(around.sum()), 1e-300)
    frequency = float(around @ places / weight) / (length * interval)
    count = len(quick)
    amplitude = 4.0 * math.sqrt(float(total[peak]) / count) / length
    # The power of each trial has an exponential distribution, whose median tells its mean.
    mean = float(_background(total)[peak]) / gammaincinv(count, 0.5)
    chance = total.size * float(gammaincc(count, float(total[peak]) / max(mean, 1e-300)))
    return Line(amplitude, max(frequency, 1e-2), min(chance, 1.0))


def _quick_length(longest: int) -> int:
    """Return the largest length up to a given one that has no factor above five."""
    best = 1
    fives = 1
    while fives <= longest:
        threes = fives
        while threes <= longest:
            best = max(best, threes << ((longest // threes).bit_length() - 1))
            threes *= 3
        fives *= 5
    return best


def _background(power: FloatArray) -> FloatArray:
    """Return the median of a spectrum around each of its places."""
    size = max(min(_NEIGHBOURS, power.size // 4), 1)
    blocks = power[: power.size // size * size].reshape(-1, size)
    centres = (np.arange(blocks.shape[0]) + 0.5) * size
    middle = np.interp(np.arange(power.size), centres, np.median(blocks, axis=1))
    # What is smooth in time falls off with the frequency: the slower, the nearer are its likes.
    for place in range(_TURNS, min(2 * _NEIGHBOURS, power.size)):
        near = slice(max(place // 2, _TURNS), 2 * place + 1)
        middle[place] = np.median(power[near])
    return np.maximum(middle, 1e-300)


def _without_outliers(
    problem: Problem, state: FloatArray, noise: SensorNoise
) -> tuple[FitTrial, ...] | None:
    """Return the trials without the samples that stand out of the residual; None if none do."""
    cleaned, any_bad = [], False
    for index, trial in enumerate(problem.trials):
        full = trial.full_rate
        predicted = problem.predict(state, index, full, directions=False).force
        residual = trial.samples.force - predicted
        least = _SMALLEST_GLITCH * max(float(predicted.max()), -float(predicted.min()))
        bad = np.abs(residual) > max(_OUTLYING * noise.std, least)
        bad &= trial.samples.good & ~trial.eventful
        if bad.any():
            # What a jump known to the sample leaves is no glitch.
            limit = _OUTLYING * np.sqrt(noise.std**2 + 4.0 * _jumps(predicted, full))
            bad = np.abs(residual) > np.maximum(limit, least)
            bad = _sudden(residual, bad & trial.samples.good) & ~trial.eventful
        if bad.any():
            any_bad = True
            trial = trial.without(bad)
        cleaned.append(trial)
    return tuple(cleaned) if any_bad else None


def _sudden(residual: FloatArray, bad: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return the runs that start and end at once: what a model lacks comes and goes smoothly."""
    kept = np.zeros(bad.size, dtype=np.bool_)
    size = np.abs(residual)
    for first, last in runs(bad):
        edge = 0.5 * float(size[first:last].min())
        before = first == 0 or size[first - 1] < edge
        after = last == bad.size or size[last] < edge
        kept[first:last] = before and after
    return kept


def _result(prepared: Sequence[FitTrial | None], end: _End, known: Sequence[str]) -> Fit:
    """Return the fit with its errors and warnings."""
    problem, solution, force_noise, height_noise, blur, _ = end
    model, p, state = problem.model, problem.p, solution.theta
    covariance = solution.covariance()
    warnings = list(known)
    parameters = _estimates(problem, solution, covariance[:p, :p])
    warnings += [f'{name} is unknown: {e.reason}' for name, e in parameters.items() if not e.known]
    fitted: list[TrialFit | None] = []
    indices = iter(range(len(problem.trials)))
    before: list[float] = []
    height_before: list[float] = []
    samples = 0
    for item in prepared:
        if item is None:
            fitted.append(None)
            continue
        index = next(indices)
        trial = problem.trials[index]
        made = _trial_fit(problem, state, covariance, index, force_noise)
        fitted.append(made)
        samples += len(made.force) + len(made.height)
        early = made.force.between(-math.inf, trial.t_contact).value[:-2]
        if early.size >= 32:
            before.append(float(np.std(early)))
        early = made.height.between(-math.inf, trial.t_contact).value
        if early.size >= 16:
            height_before.append(float(np.std(early)))
        for what, times in (
            ('force sample', made.set_aside.tolist()),
            ('displacement height', list(trial.heights_aside)),
        ):
            if times:
                warnings.append(f'{trial.name}: {_aside(what, times)}')
        if not trial.has_force_zero:
            warnings.append(
                f'{trial.name}: the record has no force without contact, so the zero of the load '
                f'cell is taken for right'
            )
    noise = CampaignNoise(
        force_noise,
        height_noise,
        blur,
        float(np.median(before)) if before else None,
        float(np.median(height_before)) if height_before else None,
        end.memory,
    )
    result = Fit(
        model=model,
        parameters=MappingProxyType(parameters),
        theta=state[:p].copy(),
        covariance=covariance[:p, :p],
        trials=tuple(fitted),
        noise=noise,
        cost=solution.cost,
        deviance=solution.cost + problem.log_determinant,
        samples=samples,
        warnings=tuple(warnings),
        problem=problem,
        state=state,
    )
    loud = []
    for what, quiet, rmse in (
        ('force', noise.force_before_contact, result.force_rmse),
        ('height', noise.height_before_contact, result.height_rmse),
    ):
        if quiet and rmse is not None and rmse > _LOUD * quiet > 1e-9 * rmse:
            loud.append(
                f'the model misses the {what} by {rmse / quiet:.3g} times the noise before '
                f'contact: the errors of the parameters take this for slow noise'
            )
    if not solution.converged:
        loud.append('the search for the best parameters did not settle')
    return replace(result, warnings=(*result.warnings, *loud))


def _aside(what: str, times: Sequence[float]) -> str:
    """Return that samples were set aside, and when the first of them were."""
    first = ', '.join(f'{t:.4g}' for t in times[:_NAMED])
    more = ', ...' if len(times) > _NAMED else ''
    stand = f'{what} stands out and was' if len(times) == 1 else f'{what}s stand out and were'
    return f'{len(times)} {stand} set aside (at {first}{more} s)'


def _estimates(
    problem: Problem, solution: Solution, covariance: FloatArray
) -> dict[str, Estimate]:
    """Return the shared parameters, unknown with a reason where the trials cannot tell them."""
    model = problem.model
    values = model.values(solution.theta[: len(model.names)])
    std = np.sqrt(np.diag(covariance))
    usual = np.abs(values)
    linear = ~np.array(model.log)
    if np.any(linear & (std > _UNTOLD_LINEAR * usual)):
        # What is about zero may be told well all the same.
        scale = scale_of(problem, solution.theta, *values[:3].tolist())
        guess = np.abs(model.values(model.first_guess(scale)))
        usual = np.where(guess > 0.0, np.maximum(usual, guess), np.inf)
    known = np.isfinite(std) & (std > 0.0)
    estimates = {}
    for i, name in enumerate(model.names):
        log = model.log[i]
        value = float(values[i])
        if solution.at_bound[i]:
            parameter = model.parameters[i]
            if not log and value == parameter.neutral:
                estimates[name] = Estimate(
                    value, None, f'the best fit has no {name} at all: it lies on the bound'
                )
                continue
            unit = '' if parameter.unit == '-' else f' {parameter.unit}'
            at = f'{name} = {value:.3g}{unit}'
            low = solution.theta[i] == model.bounds[0][i]
            estimates[name] = Estimate.unknown(
                f'these trials only bound it from {"above" if low else "below"}: the best fit '
                f'goes to the end of its range, {at}'
            )
            continue
        if not math.isfinite(std[i]):
            estimates[name] = Estimate.unknown('nothing in these trials depends on it')
            continue
        if log and std[i] > _UNTOLD:
            others = [
                (abs(covariance[i, j]) / (std[i] * std[j]), model.names[j])
                for j in range(len(model.names))
                if j != i and known[j]
            ]
            closest = max(others, default=(0.0, ''))
            tie = (
                f', and any change of it can be made up for by {closest[1]}'
                if closest[0] > 0.9
                else ''
            )
            estimates[name] = Estimate.unknown(
                f'these trials tell it only to within a factor of '
                f'{math.exp(min(std[i], 20.0)):.2g}{tie}'
            )
            continue
        if not log and std[i] > _UNTOLD_LINEAR * usual[i]:
            unit = '' if model.parameters[i].unit == '-' else f' {model.parameters[i].unit}'
            estimates[name] = Estimate.unknown(
                f'these trials tell it only to within {std[i]:.2g}{unit}'
            )
            continue
        estimates[name] = Estimate(value, float(std[i]) * (value if log else 1.0))
    return estimates


def _trial_fit(
    problem: Problem,
    state: FloatArray,
    covariance: FloatArray,
    index: int,
    noise: SensorNoise,
) -> TrialFit:
    """Return a trial beside the model at the full rate."""
    trial = problem.trials[index]
    full = trial.full_rate
    prediction = problem.predict(state, index, full, directions=False)
    _, force_zero, height_zero = problem.own(state, index)
    good = calm(full, prediction.force, noise)
    place = problem.places[index]
    std = np.sqrt(np.diag(covariance)[place])
    names = problem.own_names(trial)
    values = {
        name: Estimate(float(value), float(error))
        if math.isfinite(error)
        else Estimate.unknown('nothing in this trial depends on it')
        for name, value, error in zip(names, state[place], std, strict=True)
    }
    return TrialFit(
        name=trial.name,
        force=Signal(full.middle[good], trial.samples.force[good] - force_zero),
        force_fitted=prediction.force[good],
        height=Signal(full.height_t, full.height - height_zero),
        height_fitted=prediction.height,
        values=MappingProxyType(values),
        set_aside=trial.set_aside,
    )


def _rms(value: FloatArray) -> float:
    """Return the root mean square."""
    return math.sqrt(float(value @ value) / value.size)
