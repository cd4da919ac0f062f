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
Whether anything but noise is left in the residual, and what it looks like.

The residual is held against flexible smooth curves that belong to no effect: over each phase of
the trials, of the same size in all trials or growing with their force, or different in each. Such
a curve is described and never added to the model: it would predict nothing.

"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
import math
from typing import Final, Literal

from hapticvision_ros.core.diagnosis.records import Channel, Phase
from hapticvision_ros.core.diagnosis.refit import Columns, Refit, Smooth, Workbench
from hapticvision_ros.core.fit.data import FitTrial
from hapticvision_ros.core.outliers import runs
from hapticvision_ros.core.records import FloatArray, Segmentation
import numpy as np
from numpy.typing import NDArray
from scipy.special import fdtrc

_PHASES: Final[tuple[Phase, ...]] = ('push', 'hold', 'release', 'recover')
_HATS: Final = 5
"""Corners of the curve over a phase."""
GATE: Final = 12.0
"""Gain in Schwarz's criterion from which on something is left."""
SURPRISE: Final = 10.0
"""Or minus twice the logarithm of the chance that the curves of all trials are as much alike."""
_BESIDE: Final = 3
"""Steps beside a jump of the force in which nothing is looked for."""
_UNKNOWN: Final = 2.0
"""Intervals of the encoders beside a jump of the force in which nothing is looked for either."""
_BY_THE_WAY: Final = 4.0
"""Variance of a mean over long for what the speed is off by, over that of the noise, above which
nothing is looked for: how a way is off is much the same in trials that go alike."""
_OFF: Final = math.sqrt(12.0)
"""By how much a height may be off for a tool on a curve, over the noise of its encoders."""
_FEWEST_AWAY: Final = 4
"""Recoveries that tell from slow noise what is alike in them once the tool is away."""
_LOOKED_CLOSER: Final = 3
"""Curves whose noise is estimated anew."""

_EARLY: Final = 100.0
"""What the logarithm sees begins at a hundredth of the phase."""

type Along = Literal['time', 'log time']
type Size = Literal['alike', 'force', 'own']
_ALONG: Final[tuple[Along, ...]] = ('time', 'log time')


@dataclass(frozen=True, slots=True)
class Curve:
    """
    A smooth curve over one phase in one channel.

    Parameters
    ----------
    channel : Channel
        Where it is.
    phase : Phase
        When.
    along : {'time', 'log time'}
        What it is smooth in: the time since the phase began, over its duration; or its logarithm.
    size : {'alike', 'force', 'own'}
        The same in all trials, in proportion to the largest force of each, or of its own in each.

    """

    channel: Channel
    phase: Phase
    along: Along
    size: Size


@dataclass(frozen=True, slots=True)
class Found:
    """
    What a curve takes out of the residual.

    Parameters
    ----------
    curve : Curve
        The curve.
    gain : float
        By how much it lowers the deviance beyond the price of its corners.
    surprise : float
        Minus twice the logarithm of the chance that all trials have it as much alike.
    rms : float
        Its root mean square where it is not zero, in the channel's unit.
    strength : float
        Its root mean square over all samples of the campaign, over their noise.
    share : float
        Part of the squares of the channel's residual in this phase that it takes out.

    """

    curve: Curve
    gain: float
    surprise: float
    rms: float
    strength: float
    share: float

    @property
    def beyond_chance(self) -> bool:
        """Return whether it is no chance that this was left."""
        return self.gain > GATE or self.surprise > SURPRISE

    @property
    def away(self) -> bool:
        """Return whether it is in the force while the tool does not touch the object."""
        return (self.curve.channel, self.curve.phase) == ('force', 'recover')


def look(bench: Workbench, found: Refit, phases: Sequence[Segmentation]) -> tuple[Found, ...]:
    """
    Return the curves that stand out of the residual of a model, the strongest first.

    Parameters
    ----------
    bench : Workbench
        The campaign.
    found : Refit
        The model.
    phases : sequence of Segmentation
        Of its trials.

    Returns
    -------
    tuple of Found
        Those that gain anything, also by chance; of heights those beyond what the tool may be off.

    """
    tried = dict[Curve, tuple[list[Columns], Smooth]]()
    calm, astray = _calm(found), _astray(bench)
    for curve in _curves(bench, phases):
        columns = _columns(bench, phases, curve, calm)
        smooth = bench.smooth(found, columns, again=False)
        if smooth.count:
            tried[curve] = columns, smooth
    alike = {
        curve: _alike(smooth, tried[own][1], len(tried))
        for curve, (_, smooth) in tried.items()
        if curve.size != 'own' and (own := replace(curve, size='own')) in tried
    }
    rough = []
    for curve, (columns, smooth) in tried.items():
        if curve.channel == 'height' and astray > 0.0:
            rms = _described(bench, found, phases, curve, smooth, 0.0, 0.0).rms
            if rms <= astray:
                continue
        gain = smooth.gain - smooth.count * math.log(bench.samples)
        rough.append((max(gain, alike.get(curve, gain)), curve, columns))
    rough.sort(key=lambda each: -each[0])
    results = []
    for first, curve, columns in rough[:_LOOKED_CLOSER]:
        if first < 0.0:
            break
        smooth = bench.smooth(found, columns, again=True)
        gain = smooth.gain - smooth.count * math.log(bench.samples)
        surprise = alike.get(curve, 0.0)
        if max(gain, surprise) > 0.0:
            results.append(_described(bench, found, phases, curve, smooth, gain, surprise))
    return tuple(sorted(results, key=lambda each: -max(each.gain, each.surprise)))


def _astray(bench: Workbench) -> float:
    """Return by how much a height may be off as the tool is, where that goes along a curve [m]."""
    # Of encoders that round it is a step: how they are off within one is much alike in all trials.
    return max(
        (_OFF * t.path.noise for t in bench.trials if t.path.unsteady is not None), default=0.0
    )


def _alike(common: Smooth, own: Smooth, curves: int) -> float:
    """
    Return what it says against chance that the curves of all trials have one form.

    Slow noise of unknown size takes any curve up, but goes otherwise in each trial: what curves of
    one form take out, a column, is held against what those of their own take out beyond it, by
    the ratio of an analysis of variance. Minus twice the logarithm of its chance, for so many
    curves as were tried, is on the scale of a gain.
    """
    free = own.count - common.count
    if free < 1 or not own.gain > common.gain > 0.0:
        return 0.0
    ratio = (common.gain / common.count) / ((own.gain - common.gain) / free)
    chance = float(fdtrc(common.count, free, ratio)) * curves
    return -2.0 * math.log(max(chance, 1e-300))


def _curves(bench: Workbench, phases: Sequence[Segmentation]) -> Iterator[Curve]:
    """Yield the curves to look for."""
    recovered = sum(
        phase.t_loss is not None and int(np.count_nonzero(trial.t > phase.t_loss)) > 2 * _HATS
        for trial, phase in zip(bench.trials, phases, strict=True)
    )
    channels: list[Channel] = ['force']
    if any(trial.height_t.size for trial in bench.trials):
        channels.append('height')
    sizes: list[Size] = ['alike', 'force', 'own'] if len(bench.trials) > 1 else ['alike']
    for channel in channels:
        for phase in _PHASES:
            # The tool is away: what differs from trial to trial is the load cell's own slow noise.
            away = channel == 'force' and phase == 'recover'
            for along in _ALONG:
                for size in sizes:
                    if away and (size == 'own' or recovered < _FEWEST_AWAY):
                        continue
                    yield Curve(channel, phase, along, size)


def _calm(found: Refit) -> list[NDArray[np.bool_]]:
    """Return, for each trial, in which steps how the tool goes is known well enough to look."""
    limit = found.force_noise.std**2
    calm = []
    for trial, jumps in zip(found.problem.trials, found.problem.jumps(found.state), strict=True):
        sudden = jumps > limit
        near = sudden.copy()
        for k in range(1, _BESIDE + 1):
            near[k:] |= sudden[:-k]
            near[:-k] |= sudden[k:]
        # How the tool changes its speed between two samples of its encoders is not known.
        reach = _UNKNOWN * trial.path.interval
        for first, last in runs(sudden):
            start = int(np.searchsorted(trial.t[1:], trial.t[first] - reach))
            stop = int(np.searchsorted(trial.t[:-1], trial.t[last] + reach))
            near[start:stop] = True
        for bend in trial.path.bends:
            # Nor, as a flow feels it, how a tool that withdraws gathers its speed, which an object
            # that has relaxed does not outlast.
            if trial.t_release is not None and bend.start - reach < trial.t_release < bend.stop:
                start = int(np.searchsorted(trial.t[1:], bend.start - reach))
                stop = int(np.searchsorted(trial.t[:-1], bend.stop + reach))
                near[start:stop] = True
        if trial.unsteady is not None:
            least = _BY_THE_WAY * found.force_noise.over_long(trial.interval)
            near |= trial.unsteady * trial.duration > least
        calm.append(~near)
    return calm


def _columns(
    bench: Workbench,
    phases: Sequence[Segmentation],
    curve: Curve,
    calm: Sequence[NDArray[np.bool_]],
) -> list[Columns]:
    """Return the hats of a curve in each trial."""
    count = len(bench.trials) * _HATS if curve.size == 'own' else _HATS
    result = []
    for index, (trial, segmentation) in enumerate(zip(bench.trials, phases, strict=True)):
        columns = Columns(
            np.zeros((count, trial.force.size)), np.zeros((count, trial.height_t.size))
        )
        t = 0.5 * (trial.t[1:] + trial.t[:-1]) if curve.channel == 'force' else trial.height_t
        rows = columns.force if curve.channel == 'force' else columns.height
        first = index * _HATS if curve.size == 'own' else 0
        mine = slice(first, first + _HATS)
        size = float(np.abs(trial.force).max()) if curve.size == 'force' else 1.0
        rows[mine] = size * _hats(trial, segmentation, curve, t)
        if curve.channel == 'force':
            rows[:, ~calm[index]] = 0.0
        if np.count_nonzero(rows[mine].any(axis=0)) < 2 * _HATS:
            rows[mine] = 0.0
        result.append(columns)
    return result


def _hats(trial: FitTrial, segmentation: Segmentation, curve: Curve, t: FloatArray) -> FloatArray:
    """Return the hats over a phase at some times; shape (hats, times)."""
    start, stop = _bounds(trial, segmentation, curve.phase)
    hats = np.zeros((_HATS, t.size))
    if start is None or stop is None or stop <= start:
        return hats
    inside = (t >= start) & (t < stop)
    along = (t[inside] - start) / (stop - start)
    if curve.along == 'log time':
        along = np.log1p(_EARLY * along) / math.log1p(_EARLY)
    corners = np.linspace(0.0, 1.0, _HATS)
    for k in range(_HATS):
        hats[k, inside] = np.maximum(1.0 - np.abs(along - corners[k]) * (_HATS - 1), 0.0)
    if (curve.channel, curve.phase) == ('force', 'recover') and inside.any():
        # The level beside that before the push is also that of friction, or of the tool's weight.
        hats[:, inside] -= hats[:, inside].mean(axis=1, keepdims=True)
    return hats


def _bounds(
    trial: FitTrial, segmentation: Segmentation, phase: Phase
) -> tuple[float | None, float | None]:
    """Return when a phase begins and ends [s]."""
    end = float(trial.t[-1])
    times = [
        segmentation.t_contact,
        segmentation.t_hold,
        segmentation.t_release,
        segmentation.t_loss,
    ]
    index = _PHASES.index(phase)
    start, *later = times[index:]
    following = [time for time in later if time is not None]
    return start, following[0] if following else end


def _described(
    bench: Workbench,
    found: Refit,
    phases: Sequence[Segmentation],
    curve: Curve,
    smooth: Smooth,
    gain: float,
    surprise: float,
) -> Found:
    """Return the size of a curve that was found."""
    force = curve.channel == 'force'
    weights, values, residuals = [], [], []
    for index, (trial, segmentation) in enumerate(zip(bench.trials, phases, strict=True)):
        t = 0.5 * (trial.t[1:] + trial.t[:-1]) if force else trial.height_t
        start, stop = _bounds(trial, segmentation, curve.phase)
        if start is None or stop is None:
            continue
        inside = (t >= start) & (t < stop)
        taken = smooth.force[index] if force else smooth.height[index]
        left = bench.residual(found.problem, found.state, index)[0 if force else 1]
        weights.append((trial.force_count if force else trial.height_count)[inside])
        values.append(taken[inside])
        residuals.append(left[inside])
    weight, value = np.concatenate(weights), np.concatenate(values)
    residual = np.concatenate(residuals)
    squares = float(weight @ value**2)
    noise = (found.force_noise if force else found.height_noise).std
    all_samples = sum(
        float((trial.force_count if force else trial.height_count).sum()) for trial in bench.trials
    )
    before = float(weight @ residual**2)
    after = float(weight @ (residual - value) ** 2)
    return Found(
        curve=curve,
        gain=gain,
        surprise=surprise,
        rms=math.sqrt(squares / max(float(weight.sum()), 1.0)),
        strength=math.sqrt(squares / all_samples) / noise,
        share=1.0 - after / before if before > 0.0 else 0.0,
    )


def describe(found: Found) -> str:
    """Return what is known of a curve as a sentence."""
    unit, scale = ('N', 1.0) if found.curve.channel == 'force' else ('mm', 1e3)
    what = 'force' if found.curve.channel == 'force' else 'displacement height'
    since = {'push': 'touch', 'hold': 'stop', 'release': 'start of the release'}
    begin = since.get(found.curve.phase, 'loss of contact')
    along = f'with the {found.curve.along} since the {begin}'
    size = {
        'alike': 'the same in all trials',
        'force': 'in proportion to the largest force of each trial',
        'own': 'differently in each trial',
    }[found.curve.size]
    return (
        f'{what}, {found.curve.phase}: {scale * found.rms:.3g} {unit} rms, '
        f'{100.0 * found.share:.0f} % of the residual there, goes smoothly {along}, {size}'
    )
