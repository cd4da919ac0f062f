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
How often chance alone has an effect accepted in these very trials: a parametric bootstrap.

The base model, as it was fitted, makes campaigns anew: the same pushes, its prediction, and noise
of the kind and size that was estimated. Each goes through what the measured one went through up to
the first effect that is accepted. Theory's price of a parameter is that of many samples and of
effects that are near nothing; this takes the campaign, the candidates and the search as they are.

References
----------
A. C. Davison and D. V. Hinkley, Bootstrap Methods and their Application, 1997, ch. 4.4 (tests);
D. T. Gillespie, Phys. Rev. E 54, 1996, 2084-2091, doi:10.1103/PhysRevE.54.2084 (exact steps of an
Ornstein-Uhlenbeck process).

"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from hapticvision_ros.core import parallel
from hapticvision_ros.core.diagnosis.records import Bootstrap, Diagnosis
from hapticvision_ros.core.diagnosis.refit import Refit, Workbench
from hapticvision_ros.core.diagnosis.scatter import conditions, measure
from hapticvision_ros.core.diagnosis.selection import GATE, Round, select
from hapticvision_ros.core.effects import EVERY_LAW
from hapticvision_ros.core.effects.declaration import without_law
from hapticvision_ros.core.fit.campaign import Fit, height_blocks
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np

_SEED: Final = 20_250_101


def bootstrap(
    found: Diagnosis,
    phases: Sequence[Segmentation],
    campaigns: int,
    *,
    progress: Callable[[str], None] | None = None,
    workers: int = 1,
) -> Bootstrap:
    """
    Return how often campaigns without an effect have one accepted.

    Parameters
    ----------
    found : Diagnosis
        Of the measured campaign.
    phases : sequence of Segmentation
        Of the trials that the diagnosis has used.
    campaigns : int
        How many are simulated.
    progress : callable, optional
        Told of each.
    workers : int
        Processors.

    Returns
    -------
    Bootstrap
        The false alarms, and how many gain as much as what was found in the measured campaign.

    """
    groups = conditions(phases)
    tried = {candidate.effect for candidate in found.ranking}
    # Each by all of its laws; stamps that are late are moved and are no effect.
    names = [e.name for e in EVERY_LAW if without_law(e.name) in tried and not e.misdates]
    # Without repeats, scatter was assumed for the trials; it then is so for the simulated ones.
    assumed = found.after.problem.scatter if max(map(len, groups)) == 1 else np.empty(0)
    base, drawn = _base(found.before, found.before.problem.trials, groups, assumed)
    measured = _gain_found(found)

    def first(number: int) -> tuple[bool, float]:
        """Return whether an effect is accepted in a simulated campaign, and what it gains."""
        made = simulated(base, drawn, np.random.default_rng((_SEED, number)))
        start, _ = _base(found.before, made, groups, assumed)
        bench = Workbench(made, start.problem.scatter if start.problem.scatter.size else None)
        # What leads is accepted or not; what would go better with others does not matter.
        _, rounds = select(bench, start, names, rivals=())
        return bool(rounds[0].alike), _gain(rounds[0])

    alarms = as_large = 0
    numbers = range(1, campaigns + 1)
    for number, (alarm, gain) in enumerate(parallel.each(first, numbers, workers), start=1):
        if progress is not None:
            progress(f'bootstrap {number} of {campaigns}')
        alarms += alarm
        as_large += gain >= measured
    return Bootstrap(campaigns, alarms, (1 + as_large) / (campaigns + 1))


def _base(
    fit: Fit,
    trials: Sequence[FitTrial],
    groups: Sequence[Sequence[int]],
    assumed: FloatArray,
) -> tuple[Refit, FloatArray]:
    """Return the base model on some trials, and the scatter that these show or are said to."""
    plain = Workbench(trials, None)
    if assumed.size:
        return plain.scattering(assumed).base(fit), assumed
    base = plain.base(fit)
    scatter = measure(base, groups)
    if scatter is None or not scatter.cautious.any():
        return base, np.empty(0)
    return plain.scattering(scatter.cautious).base(fit), scatter.std


def _gain_found(found: Diagnosis) -> float:
    """Return what the leading effect of the measured campaign has gained."""
    gains = {candidate.effect: candidate.delta_bic for candidate in found.ranking}
    if found.effects:
        return max(gains[name] for name in found.effects)
    best = max(gains.values(), default=0.0)
    # What gained more and was not accepted was too weak to be.
    return best if found.status == 'unexplained' else min(best, GATE)


def _gain(first: Round) -> float:
    """Return what the leading effect of a simulated campaign has gained."""
    gains = {each.effect: each.gain for each in first.candidates}
    if first.alike:
        return gains[first.alike[0]]
    return min(max(gains.values(), default=0.0), GATE)


def simulated(base: Refit, scatter: FloatArray, random: np.random.Generator) -> list[FitTrial]:
    """
    Return a campaign as a model and its noise make it.

    Parameters
    ----------
    base : Refit
        The model.
    scatter : ndarray, shape (3,) or (0,)
        Standard deviations of the logarithms of K1, C1 and C2 from trial to trial.
    random : numpy.random.Generator
        Where chance comes from.

    Returns
    -------
    list of FitTrial
        The trials of the refit, with force and height replaced.

    """
    problem, state = base.problem, base.state.copy()
    theta = state[: scatter.size].copy()
    made = []
    for index, trial in enumerate(problem.trials):
        # The problem's own scatter is what the fit has found; here each trial draws its own.
        state[: scatter.size] = theta + scatter * random.standard_normal(scatter.size)
        state[problem.scattered(index)] = 0.0
        _, force_zero, height_zero = problem.own(state, index)
        full = trial.full_rate
        noise = trial_noise(trial, base, base.jumps[index], random)
        said = problem.predict(state, index, directions=False)
        force = np.where(trial.force_count > 0.0, said.force + force_zero + noise.force, 0.0)
        samples = problem.predict(state, index, full, directions=False).force + force_zero
        height = said.height + height_zero + noise.height
        made.append(
            replace(
                trial,
                force=force,
                height=height,
                samples=replace(trial.samples, force=samples + noise.samples),
            )
        )
    return made


@dataclass(frozen=True, slots=True)
class TrialNoise:
    """
    Noise of a trial.

    Parameters
    ----------
    samples, force : ndarray, shapes (samples,), (n,)
        Of each sample of the force, and of its mean in each step [N].
    height : ndarray, shape (m,)
        Of each mean of heights [m].

    """

    samples: FloatArray
    force: FloatArray
    height: FloatArray


def trial_noise(
    trial: FitTrial, like: Refit, jumps: FloatArray, random: np.random.Generator
) -> TrialNoise:
    """
    Return noise of a trial.

    Parameters
    ----------
    trial : FitTrial
        The trial.
    like : Refit
        Whose noise it is.
    jumps : ndarray, shape (n,)
        Variance of each step's force for that moments are not known well [N^2].
    random : numpy.random.Generator
        Where chance comes from.

    Returns
    -------
    TrialNoise
        The noise.

    """
    edges, good = trial.samples.edges, trial.samples.good.astype(np.float64)
    samples = sensor_noise(0.5 * (edges[1:] + edges[:-1]), like.force_noise, random)
    first_of = np.searchsorted(edges, trial.t)[:-1]
    force = np.add.reduceat(samples * good, first_of) / np.maximum(trial.force_count, 1.0)
    # The moments of jumps are known no better than when they were measured.
    force += np.sqrt(jumps) * random.standard_normal(force.size)
    return TrialNoise(samples, force, _height_noise(trial, like.height_noise, random))


def sensor_noise(t: FloatArray, noise: SensorNoise, random: np.random.Generator) -> FloatArray:
    """
    Return noise of a sensor.

    Parameters
    ----------
    t : ndarray, shape (n,)
        Times of the samples, in order [s].
    noise : SensorNoise
        Its level and memory.
    random : numpy.random.Generator
        Where chance comes from.

    Returns
    -------
    ndarray, shape (n,)
        In the unit of `noise`.

    """
    value = noise.white * random.standard_normal(t.size)
    for size, time in (
        (noise.slow, noise.correlation_time),
        (noise.wander, noise.wander_time),
    ):
        if size > 0.0:
            kept = np.exp(-np.maximum(np.diff(t, prepend=-np.inf), 0.0) / time)
            slow = np.empty(t.size)
            _remember(kept, np.sqrt(1.0 - kept**2) * random.standard_normal(t.size), slow)
            value += size * slow
    return value


@kernel()
def _remember(kept, new, out):  # type: ignore[no-untyped-def]
    """Fill an autoregression of unit variance."""
    last = 0.0
    for i in range(kept.size):
        last = kept[i] * last + new[i]
        out[i] = last


def _height_noise(trial: FitTrial, noise: SensorNoise, random: np.random.Generator) -> FloatArray:
    """Return the noise of each mean of heights [m]."""
    if not trial.height_t.size:
        return np.empty(0)
    count = np.maximum(np.rint(trial.height_count), 1.0).astype(np.intp)
    first_of = np.cumsum(count) - count
    # When the samples of a mean were taken is known by their interval.
    place = np.arange(int(count.sum())) - np.repeat(first_of + 0.5 * (count - 1), count)
    t = np.repeat(trial.height_t, count) + place * trial.height_interval
    single = sensor_noise(np.maximum.accumulate(t), noise, random)
    mean = np.asarray(np.add.reduceat(single, first_of) / count, dtype=np.float64)
    # What stamps that are off make of a surface that moves.
    extra = height_blocks(trial).extra
    return mean + np.sqrt(extra) * random.standard_normal(mean.size) if extra.any() else mean
