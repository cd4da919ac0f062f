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
How strong an effect of the simulated campaigns is: from one number, and to a wanted misfit.

The strength of an effect is one number without a unit, zero where the effect is absent and about
one where it is as large as what it disturbs; `undeclared` makes an effect of it. `strength_for`
finds the strength at which the base model misses noise-free data by r times the noise; by which
fit that is measured is up to the caller. `LinearMisfit` is a measure of this world's own.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
import math
from typing import Final

from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import Campaign, peak_force, run
from hapticvision_ros.sim.specimen import Body, EFFECTS, Undeclared
import numpy as np

_STEP: Final = 1e-3
"""Relative change of a coefficient for its sensitivity."""
_WEAKEST: Final = 1e-7
_STRONGEST: Final = 30.0
_TRIES: Final = 25


@dataclass(frozen=True, slots=True)
class Scale:
    """
    What is large in a campaign.

    Parameters
    ----------
    force : float
        Highest force of the three elements alone [N].
    depth : float
        Deepest push [m].
    push_time : float
        Duration of the fastest push [s].
    top_speed : float
        Highest push speed [m/s].
    hold, trial, campaign : float
        Usual hold, usual trial, and from first to last trial [s].
    interval : float
        Between two samples of the load cell [s].
    clearance : float
        From where the tool starts to the surface [m].
    body : Body
        The three elements.

    """

    force: float
    depth: float
    push_time: float
    top_speed: float
    hold: float
    trial: float
    campaign: float
    interval: float
    clearance: float
    body: Body


@lru_cache(maxsize=256)
def scale(campaign: Campaign) -> Scale:
    """Return what is large in a campaign without any effect."""
    durations = [campaign.motion(index)[1] for index in range(len(campaign.pushes))]
    starts = campaign.starts
    return Scale(
        force=peak_force(campaign),
        depth=campaign.deepest,
        push_time=min(push.depth / push.speed for push in campaign.pushes),
        top_speed=max(push.speed for push in campaign.pushes),
        hold=float(np.median([push.hold for push in campaign.pushes])),
        trial=float(np.median(durations)),
        campaign=starts[-1] - starts[0] + durations[-1],
        interval=1.0 / campaign.sensors.force_rate,
        clearance=campaign.clearance,
        body=campaign.body,
    )


type _Maker = Callable[[float, float, Scale], tuple[float, ...]]


def _sign(u: float) -> float:
    return -1.0 if u < 0.5 else 1.0


def _second_unit(s: float, u: float, k: Scale) -> tuple[float, ...]:
    stiffness = k.body.K1 / s
    return stiffness, stiffness * k.body.retardation_time * 10.0 ** (1.2 * u - 1.5)


def _hum(s: float, u: float, k: Scale) -> tuple[float, ...]:
    lowest = 0.5
    return s * k.force, lowest * (0.4 / (k.interval * lowest)) ** u


_MAKERS: Final[Mapping[str, _Maker]] = {
    'yield_force': lambda s, u, k: (s * k.force,),
    'series_spring': lambda s, u, k: (k.force / (s * k.depth),),
    'parallel_spring': lambda s, u, k: (s * k.force / k.depth,),
    'second_retardation': _second_unit,
    'springpot': lambda s, u, k: (1.0 - min(s, 0.9),),
    'strain_stiffening': lambda s, u, k: (s / k.depth**2,),
    'shear_thinning': lambda s, u, k: (1.0 - min(s, 0.9),),
    'contact_growth': lambda s, u, k: (s,),
    'damage': lambda s, u, k: (min(s, 0.95),),
    'ageing': lambda s, u, k: (_sign(u) * s * 3600.0 / k.campaign,),
    'adhesion': lambda s, u, k: (s * k.force,),
    'inertia': lambda s, u, k: (s * k.force * k.interval / k.top_speed,),
    'machine_compliance': lambda s, u, k: (k.force / (s * k.depth),),
    # An object that reaches the tool before it moves would be another trial.
    'contact_offset': lambda s, u, k: (_sign(u) * min(s * k.depth, 0.9 * k.clearance),),
    'friction': lambda s, u, k: (s * k.force,),
    'force_drift': lambda s, u, k: (_sign(u) * s * k.force / k.trial,),
    'force_lag': lambda s, u, k: (s * k.push_time,),
    'clock_offset': lambda s, u, k: (_sign(u) * s * k.push_time,),
    'height_bias': lambda s, u, k: (_sign(u) * s * k.depth,),
    'periodic_disturbance': _hum,
    'stiction': lambda s, u, k: (s * k.force, 0.02 * k.depth),
    'contact_friction': lambda s, u, k: (s * k.force,),
    'tool_mass': lambda s, u, k: (s * k.force * k.interval / k.top_speed,),
    'gathered_mass': lambda s, u, k: (s * k.force * k.interval / k.top_speed,),
    'early_shadow': lambda s, u, k: (_sign(u) * s * k.depth, (0.1 + 0.5 * u) * k.depth),
    'touch_shadow': lambda s, u, k: (_sign(u) * s * k.depth,),
    'loose_top': lambda s, u, k: (min(s * k.depth, 0.9 * k.clearance),),
    'ageing_by_trial': lambda s, u, k: (_sign(u) * s * 3600.0 / k.campaign,),
    'necking': lambda s, u, k: (s * k.force, 0.01 * 10.0**u * k.depth),
    'stringing': lambda s, u, k: (s * k.force, 0.01 * 10.0**u * k.depth),
    'lasting_damage': lambda s, u, k: (min(s, 0.95),),
    'early_damage': lambda s, u, k: (min(s, 0.95), (0.1 + 0.3 * u) * k.depth),
    'early_lasting_damage': lambda s, u, k: (min(s, 0.95), (0.1 + 0.3 * u) * k.depth),
    'poroelasticity': lambda s, u, k: (
        s * k.force / k.depth,
        k.body.relaxation_time * 10.0 ** (1.5 * u - 1.25),
    ),
    'fracture': lambda s, u, k: (min(s, 0.9), (0.4 + 0.4 * u) * k.depth),
    'thixotropy': lambda s, u, k: (min(s, 0.95), 0.2 * k.depth, (0.3 + u) * k.hold),
    'support_slip': lambda s, u, k: (s * k.depth, (0.3 + 0.4 * u) * k.force, 0.3 * k.push_time),
    'unloading_stiffness': lambda s, u, k: (
        min(s, 0.9),
        0.1 * k.depth / k.body.relaxation_time,
    ),
    'shoulder_contact': lambda s, u, k: (s * k.force / k.depth, (0.4 + 0.3 * u) * k.depth),
    'backlash': lambda s, u, k: (min(s, 0.9) * k.depth,),
    'cell_creep': lambda s, u, k: (s, (0.3 + u) * k.hold),
    'cell_hysteresis': lambda s, u, k: (min(s, 1.0), 0.3 * k.force),
    'gain_step': lambda s, u, k: (_sign(u) * s,),
    'force_saturation': lambda s, u, k: (k.force / (1.0 + s),),
    'force_quantisation': lambda s, u, k: (s * k.force,),
    'knock': lambda s, u, k: (s * k.force, 2.0 * 10.0**u, 0.5),
    'height_gain': lambda s, u, k: (_sign(u) * s,),
}


def undeclared(
    name: str, strength: float, campaign: Campaign, *, shape: float = 0.5
) -> Undeclared:
    """
    Return an effect of a strength.

    Parameters
    ----------
    name : str
        One of `hapticvision_ros.sim.specimen.EFFECTS`.
    strength : float
        Zero where the effect is absent, about one where it is as large as what it disturbs.
    campaign : Campaign
        What it is to act in.
    shape : float, default 0.5
        From 0 to 1, chooses what the strength does not: sign, frequency, ratio of times.

    Returns
    -------
    Undeclared
        The effect.

    Raises
    ------
    UsageError
        If there is no such effect.

    """
    if name not in _MAKERS:
        raise UsageError(
            f'there is no effect {name!r} in this world: choose among {", ".join(EFFECTS)}'
        )
    if strength <= 0.0:
        return Undeclared(name, tuple(quantity.absent for quantity in EFFECTS[name]))
    return Undeclared(name, _MAKERS[name](strength, shape, scale(campaign)))


def strength_for(
    r: float,
    name: str,
    campaign: Campaign,
    misfit: Callable[[tuple[Trial, ...]], float],
    *,
    shape: float = 0.5,
    seed: int = 0,
    beside: Sequence[Undeclared] = (),
    tolerance: float = 0.02,
    start: float = 0.03,
) -> float:
    """
    Return the strength at which an effect makes the base model miss by r times the noise.

    Parameters
    ----------
    r : float
        Wanted RMS misfit of noise-free data over the noise.
    name, shape : str, float
        As in `undeclared`.
    campaign : Campaign
        What it acts in.
    misfit : callable
        Takes the noise-free trials of the campaign, returns their misfit over the noise; such as
        a `LinearMisfit`, or a base fit with the campaign's noise.
    seed : int
        Seed of the noise-free run.
    beside : sequence of Undeclared
        What else acts.
    tolerance : float
        Relative, of r.
    start : float
        Where to begin to look.

    Returns
    -------
    float
        The strength.

    Raises
    ------
    InputError
        If no strength of the effect misses by r in this campaign.

    """
    low, high = math.log(_WEAKEST), math.log(_STRONGEST)
    at = math.log(start)
    last: tuple[float, float] | None = None
    power = 1.0
    for _ in range(_TRIES):
        effect = undeclared(name, math.exp(at), campaign, shape=shape)
        reached = misfit(run(campaign, (*beside, effect), seed=seed, ideal=True).trials)
        if abs(reached / r - 1.0) <= tolerance:
            return math.exp(at)
        if reached < r:
            low = max(low, at)
        else:
            high = min(high, at)
        if high - low < 1e-3:
            break
        size = math.log(max(reached, 1e-9 * r) / r)
        if last is not None and at != last[0]:
            power = min(max((size - last[1]) / (at - last[0]), 0.3), 3.0)
        last = (at, size)
        # The misfit goes with a power of the strength, which the last two tell.
        at = min(max(at - size / power, at - 5.0), at + 5.0)
        if not low < at < high:
            at = 0.5 * (low + high)
    raise InputError(
        f'no strength of {name} makes the base model miss by {r:g} times the noise in this '
        'campaign: choose another effect or campaign'
    )


class LinearMisfit:
    """
    The misfit of the three-element model, to first order about the campaign without effects.

    What an effect changes in noise-free data is freed from what K1, C1, C2, the touch and the
    zeros of each trial can imitate.

    Parameters
    ----------
    campaign : Campaign
        What is pushed; its sensors tell the noise.
    seed : int
        Seed of the runs that it is to measure.

    """

    def __init__(self, campaign: Campaign, *, seed: int = 0) -> None:
        sensors = campaign.sensors
        self._noise = (sensors.force_noise.std, sensors.height_noise)
        self._trials = run(campaign, seed=seed, ideal=True).trials
        body = campaign.body
        moved = [
            replace(campaign, body=replace(body, K1=body.K1 * (1.0 + _STEP))),
            replace(campaign, body=replace(body, C1=body.C1 * (1.0 + _STEP))),
            replace(campaign, body=replace(body, C2=body.C2 * (1.0 + _STEP))),
            replace(campaign, surface_offset=1e-3 * campaign.deepest),
        ]
        self._moved = [run(each, seed=seed, ideal=True).trials for each in moved]

    def __call__(self, trials: tuple[Trial, ...]) -> float:
        """Return the misfit of the noise-free run with the same seed, over the noise."""
        shared, misses = [], []
        for index, (trial, before) in enumerate(zip(trials, self._trials, strict=True)):
            rows, zeros = [], []
            for channel, noise in enumerate(self._noise):
                now, base = _channel(trial, channel), _channel(before, channel)
                _, at, of = np.intersect1d(
                    np.round(now.t * 1e9), np.round(base.t * 1e9), return_indices=True
                )
                changes = [(now.value[at] - base.value[of]) / noise]
                for each in self._moved:
                    other = _channel(each[index], channel)
                    changes.append((np.interp(base.t, other.t, other.value) - base.value)[of])
                rows.append(np.array(changes))
                zeros.append(at.size)
            # Own to the trial: where it touches, and the zeros of both sensors.
            change = np.concatenate(rows, axis=1)
            for row in change[1:]:
                row /= np.concatenate(
                    [np.full(n, s) for n, s in zip(zeros, self._noise, strict=True)]
                )
            own = np.stack((change[4], np.repeat([1.0, 0.0], zeros), np.repeat([0.0, 1.0], zeros)))
            basis, _ = np.linalg.qr(own.T)
            rest = change[:4] - change[:4] @ basis @ basis.T
            misses.append(rest[0])
            shared.append(rest[1:])
        miss, columns = np.concatenate(misses), np.concatenate(shared, axis=1).T
        columns /= np.linalg.norm(columns, axis=0)
        best, *_ = np.linalg.lstsq(columns, miss, rcond=None)
        return float(np.sqrt(np.mean((miss - columns @ best) ** 2)))


def _channel(trial: Trial, channel: int) -> Signal:
    """Return force (0) or displacement height (1)."""
    signal = trial.displacement_height if channel else trial.force
    if signal is None:
        raise UsageError('the displacement height is missing: measure a run of this world')
    return signal
