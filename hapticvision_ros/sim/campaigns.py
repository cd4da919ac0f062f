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
Campaigns of simulated trials in which an effect acts that their data do not declare.

A `Campaign` is what an experimenter would write down: pushes, sensors, and, known to nobody but
this world, the body. `run` carries it out with any `Undeclared` effects and returns trials as the
reader of bags would, and apart from them the truth; `write_bags` makes bags of the trials. Names
and provenance of the trials are neutral.

.. code-block:: python

    campaign = random_campaign(7)
    effect = undeclared('yield_force', 0.1, campaign, shape=0.5)
    trials, truth = run(campaign, [effect], seed=1)

"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
import math
from pathlib import Path
from types import MappingProxyType
from typing import Final, NamedTuple

from hapticvision_ros.bag.contract import DISPLACEMENT_HEIGHT, POINTS, TOOL_HEIGHT
from hapticvision_ros.bag.writer import Compression, write_signals
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.kernels import kernel
from hapticvision_ros.core.records import CloudFrame, FloatArray, Signal, Trial
from hapticvision_ros.sim.config import WorldConfig
from hapticvision_ros.sim.offline import CloudPlan
from hapticvision_ros.sim.scene import RangeRenderer, Scene
from hapticvision_ros.sim.specimen import (
    Body,
    History,
    integrate,
    LASTING,
    Motion,
    parameter,
    parameter_vector,
    Undeclared,
)
import numpy as np
from numpy.typing import NDArray

START_NS: Final = 1_750_000_000 * 10**9
"""Stamp of the start of a campaign [ns since the epoch]."""
PROVENANCE_TEXT: Final = 'synthetic'
_NS_PER_S: Final = 1e9
_FINEST: Final = 2000.0
"""The integrator makes at least this many steps a second [Hz]."""
_OVERSAMPLING: Final = 10
"""Steps of the integrator between two samples of the load cell, at least."""
_FULL_RIPPLE: Final = 0.3
"""Speed of the arm from which on it ripples in full, over that of the push."""
_RIPPLE_STEPS: Final = 64
"""Pieces of even acceleration in a period of the ripple."""
_SWING_STEPS: Final = 240
"""Pieces of even acceleration in a move at least jerk."""
_COARSE: Final = 4000
"""Steps of a trial where only its peak is asked for."""


@dataclass(frozen=True, slots=True)
class Push:
    """
    What the arm does in one trial.

    Parameters
    ----------
    speed : float
        Speed of the push [m/s].
    depth : float
        How far below the nominal surface the push goes [m].
    hold, recover : float
        Duration of the hold, and of the recovery after the tool is up again [s].
    release_speed : float
        Speed of the withdrawal [m/s].
    swings : int
        How often the tool goes back and down again before the hold, with the speed of the push.
    swing : float
        How far it goes back [m].
    steps : int
        In how many steps of one size it goes down; it holds after each.
    back : float
        How far it goes back after each hold but the last, to hold there as well [m].

    """

    speed: float
    depth: float
    hold: float
    recover: float
    release_speed: float = 0.02
    swings: int = 0
    swing: float = 0.0
    steps: int = 1
    back: float = 0.0


@dataclass(frozen=True, slots=True)
class ForceNoise:
    """
    Noise of the load cell.

    Parameters
    ----------
    white : float
        Standard deviation of what is new in each sample [N].
    coloured, correlation_time : float
        Standard deviation [N] and correlation time [s] of an Ornstein-Uhlenbeck process.
    slow, slow_time : float
        The same of a second, slower one.

    """

    white: float
    coloured: float = 0.0
    correlation_time: float = 0.02
    slow: float = 0.0
    slow_time: float = 30.0

    @property
    def std(self) -> float:
        """Return the standard deviation of a sample [N]."""
        return math.hypot(self.white, self.coloured, self.slow)


@dataclass(frozen=True, slots=True)
class Sensors:
    """
    How the cell measures.

    Parameters
    ----------
    force_noise : ForceNoise
        Noise of the load cell.
    height_noise : float
        Standard deviation of the displacement height [m].
    force_rate, tool_rate, height_rate : float
        Samples per second [Hz]; the clocks have random phases.
    height_noise_time : float
        Correlation time of the height's noise [s]; zero for white noise.
    encoder_noise, encoder_resolution : float
        Standard deviation and quantum of the tool height [m].
    force_zero : float
        Standard deviation of the load cell's reading without load, from trial to trial [N].
    jitter : float
        Standard deviation of a sample's moment over the interval of its stream.
    gaps : int
        Gaps in each stream, each of up to 20 samples.
    sees_in_contact : bool
        Whether the height is measured while the tool is in the dent.

    """

    force_noise: ForceNoise
    height_noise: float
    force_rate: float = 250.0
    tool_rate: float = 250.0
    height_rate: float = 20.0
    height_noise_time: float = 0.0
    encoder_noise: float = 1e-6
    encoder_resolution: float = 1e-6
    force_zero: float = 0.0
    jitter: float = 0.0
    gaps: int = 0
    sees_in_contact: bool = True


@dataclass(frozen=True, slots=True)
class Campaign:
    """
    Pushes on one body, each on a fresh place of it.

    Parameters
    ----------
    body : Body
        The three elements; on average over the places.
    pushes : tuple of Push
        One for each trial.
    sensors : Sensors
        How the cell measures.
    rest : float
        Time between two trials [s].
    scatter : float
        Relative standard deviation of K1, C1 and C2 from place to place, each by itself.
    surface_scatter : float
        Standard deviation of the height of the surface from place to place [m].
    surface_height : float
        Nominal height of the surface above the support plane [m].
    surface_offset : float
        How much higher than that it is at every place [m].
    acceleration : float
        Of the arm [m/s^2].
    quiet_time : float
        Rest before the approach [s].
    clearance : float
        How far above the surface the tool starts and ends [m].
    ripple, ripple_rate : float
        Amplitude [m] and frequency [Hz] at which the tool goes to and fro while the arm moves, as
        its gears make it; slow moves ripple less.
    curved : bool
        Whether the arm moves at least jerk from rest to rest, and has the speeds of the pushes
        half way, and not with `acceleration` up to a steady one.

    """

    body: Body
    pushes: tuple[Push, ...]
    sensors: Sensors
    rest: float = 60.0
    scatter: float = 0.0
    surface_scatter: float = 0.0
    surface_height: float = 0.040
    surface_offset: float = 0.0
    acceleration: float = 0.5
    quiet_time: float = 1.0
    clearance: float = 0.010
    ripple: float = 0.0
    ripple_rate: float = 8.0
    curved: bool = False

    @property
    def deepest(self) -> float:
        """Return the depth of the deepest push [m]."""
        return max(push.depth for push in self.pushes)

    def motion(self, trial: int) -> tuple[Motion, float, tuple[tuple[float, str], ...]]:
        """Return the tool's motion in a trial, its duration [s], and the commanded phases."""
        return _motion(self, self.pushes[trial])

    @property
    def starts(self) -> tuple[float, ...]:
        """Return when each trial starts, from the start of the first [s]."""
        lasted = [self.motion(i)[1] + self.rest for i in range(len(self.pushes))]
        return tuple(float(start) for start in np.cumsum([0.0, *lasted[:-1]]))


@dataclass(frozen=True, slots=True)
class Truth:
    """
    What nobody who looks at the trials is told.

    Parameters
    ----------
    body : Body
        The three elements, on average.
    effects : tuple of Undeclared
        What else acted.
    bodies : tuple of Body
        The three elements in each trial.
    surface_offsets : tuple of float
        How much higher than nominal the surface was in each trial [m].
    touches, losses : tuple of float
        True first touch and last loss of contact in each trial, from its first stamp [s]; NaN
        where there was none.

    """

    body: Body
    effects: tuple[Undeclared, ...]
    bodies: tuple[Body, ...]
    surface_offsets: tuple[float, ...]
    touches: tuple[float, ...]
    losses: tuple[float, ...]


class Run(NamedTuple):
    """The trials of a campaign as they were measured, and the truth behind them."""

    trials: tuple[Trial, ...]
    truth: Truth


def run(
    campaign: Campaign, effects: Sequence[Undeclared] = (), *, seed: int, ideal: bool = False
) -> Run:
    """
    Carry out a campaign.

    Parameters
    ----------
    campaign : Campaign
        What is pushed and how.
    effects : sequence of Undeclared
        What acts beside the three elements; none may be named twice.
    seed : int
        Seed of noise, scatter and clock phases.
    ideal : bool
        Without noise, scatter, jitter, gaps and steps of the encoders, but with the same zeros
        and clock phases.

    Returns
    -------
    Run
        The trials and the truth.

    Raises
    ------
    UsageError
        If an effect is named twice.

    """
    names = [effect.name for effect in effects]
    if len(set(names)) < len(names):
        raise UsageError('an effect acts once in a campaign: name each one once')
    trials, bodies, offsets, touches, losses = [], [], [], [], []
    stretched = 0.0
    for index, start in enumerate(campaign.starts):
        random = np.random.default_rng((seed, index))
        share = campaign.scatter * random.standard_normal(3)
        offset = campaign.surface_scatter * float(random.standard_normal())
        if ideal:
            share, offset = np.zeros(3), 0.0
        vector = parameter_vector(campaign.body, effects)
        offset += campaign.surface_offset + parameter(vector, 'contact_offset', 'delta_0')
        body = Body(
            campaign.body.K1 * math.exp(share[0]),
            campaign.body.C1 * math.exp(share[1]),
            campaign.body.C2 * math.exp(share[2]),
        )
        vector = parameter_vector(body, effects)
        if not any(parameter(vector, name, 'D') for name in LASTING):
            # Each trial has a fresh place.
            stretched = 0.0
        trial, touch, loss, stretched = _trial(
            campaign, index, start, vector, offset, stretched, random, ideal
        )
        trials.append(trial)
        bodies.append(body)
        offsets.append(offset)
        touches.append(touch)
        losses.append(loss)
    truth = Truth(
        campaign.body,
        tuple(effects),
        tuple(bodies),
        tuple(offsets),
        tuple(touches),
        tuple(losses),
    )
    return Run(tuple(trials), truth)


def random_campaign(
    seed: int,
    *,
    trials: int | None = None,
    scatter: float = 0.0,
    surface_scatter: float = 5e-5,
    longest: float = 40.0,
    tidy: bool = False,
) -> Campaign:
    """
    Draw a campaign: material, protocol and sensors.

    Parameters
    ----------
    seed : int
        The same seed gives the same campaign.
    trials : int, optional
        How many trials; drawn from 2 to 24 by default.
    scatter, surface_scatter : float
        From place to place, as in `Campaign`; with a scatter each push is repeated.
    longest : float
        How long a trial may about last [s].
    tidy : bool
        Without jitter and gaps.

    Returns
    -------
    Campaign
        Relaxation times from 0.5 to 100 s, peak forces from 0.1 to 500 N, noise of 0.2 to 1 % of
        the peak with a correlation of up to 30 samples.

    """
    random = np.random.default_rng((seed, 0x5EED))

    def between(low: float, high: float) -> float:
        """Return a number whose logarithm is uniform."""
        return math.exp(random.uniform(math.log(low), math.log(high)))

    relaxation_time = between(0.5, 100.0)
    share = random.uniform(0.15, 0.6)
    count = round(between(2.0, 24.0)) if trials is None else trials
    repeats = 1 if count < 4 else int(random.integers(1, 4))
    if scatter > 0.0:
        repeats = max(2, repeats)
    depth = between(0.002, 0.012)
    slowest = 0.3 * longest
    speed = between(max(2e-4, depth / min(slowest, 3.0 * relaxation_time)), 0.03)
    conditions = -(-count // repeats)
    speeds = speed * np.array([1.0, *(between(0.15, 0.8) for _ in range(int(conditions > 2)))])
    speeds = np.maximum(speeds, depth / slowest)
    depths = depth * np.linspace(1.0, 0.4, -(-conditions // speeds.size))
    hold = min(max(2.0, relaxation_time * random.uniform(0.3, 1.5)), 0.4 * longest)
    recover = min(max(2.0, share * relaxation_time * between(0.5, 3.0)), 0.25 * longest)
    grid = [(float(v), float(d)) for d in depths for v in speeds][:conditions]
    order = random.permutation([i % len(grid) for i in range(count)])
    pushes = tuple(Push(speed, down, hold, recover) for speed, down in (grid[i] for i in order))

    # Forces are in proportion to K1 as long as the times are the same.
    unit = Body(1.0, share * relaxation_time, (1.0 - share) * relaxation_time)
    trial = Campaign(unit, pushes, Sensors(ForceNoise(0.0), 0.0))
    K1 = between(0.1, 500.0) / peak_force(trial)
    body = Body(K1, unit.C1 * K1, unit.C2 * K1)
    peak = K1 * peak_force(trial)

    rate = float(random.choice([100.0, 250.0, 500.0, 1000.0]))
    noise = peak * random.uniform(0.002, 0.01)
    coloured = random.uniform(0.0, 0.95)
    slow = 0.3 if random.uniform() < 0.3 else 0.0
    force_noise = ForceNoise(
        noise * math.sqrt(1.0 - coloured),
        noise * math.sqrt(coloured),
        between(1.0, 30.0) / rate,
        slow * noise,
        between(5.0, 60.0),
    )
    height_rate = between(5.0, 30.0)
    sensors = Sensors(
        force_noise=force_noise,
        height_noise=depth * random.uniform(0.003, 0.01),
        force_rate=rate,
        tool_rate=float(random.choice([50.0, 100.0, 250.0, 500.0])),
        height_rate=height_rate,
        height_noise_time=1.0 / height_rate if random.uniform() < 0.3 else 0.0,
        force_zero=0.05 * peak,
        jitter=0.0 if tidy or random.uniform() < 0.6 else 0.05,
        gaps=0 if tidy or random.uniform() < 0.7 else 2,
    )
    return Campaign(
        body,
        pushes,
        sensors,
        rest=between(20.0, 300.0),
        scatter=scatter,
        surface_scatter=surface_scatter,
    )


def peak_force(campaign: Campaign) -> float:
    """Return the highest force of the three elements alone in a campaign [N]."""
    vector = parameter_vector(campaign.body)
    force = 0.0
    for push in set(campaign.pushes):
        motion, duration, _ = campaign.motion(campaign.pushes.index(push))
        history = integrate(np.linspace(0.0, duration, _COARSE), motion, vector)
        force = max(force, float(history.force.max()))
    return force


def write_bags(
    run: Run,
    folder: Path,
    *,
    clouds: tuple[WorldConfig, CloudPlan] | None = None,
    duplicates: int = 0,
    seed: int = 0,
    compression: Compression = 'zstd',
) -> tuple[Path, ...]:
    """
    Write the trials of a campaign as contract bags.

    Parameters
    ----------
    run : Run
        Its truth is not written.
    folder : Path
        Where the bags go; each takes its trial's name.
    clouds : (WorldConfig, CloudPlan) or None
        The cell before the range sensor and the size of its clouds, which then take the place of
        the displacement height; None for bags of numbers only. The cell's block must be as high
        as the campaign's surface.
    duplicates : int
        Messages of tool height and displacement height that come twice in each bag.
    seed : int
        Seed of the clouds' noise and of which messages come twice.
    compression : {'none', 'lz4', 'zstd'}
        Compression of the bags.

    Returns
    -------
    tuple of Path
        The bags, in the order of the trials.

    Raises
    ------
    InputError
        If a bag cannot be written.

    """
    paths = []
    late = parameter(parameter_vector(run.truth.body, run.truth.effects), 'clock_offset', 'dt')
    for index, trial in enumerate(run.trials):
        random = np.random.default_rng((seed, index))
        height = trial.displacement_height
        extra = []
        for topic, signal in ((TOOL_HEIGHT, trial.tool_height), (DISPLACEMENT_HEIGHT, height)):
            if duplicates and signal is not None and (topic == TOOL_HEIGHT or clouds is None):
                twice = np.sort(
                    random.choice(len(signal), min(duplicates, len(signal)), replace=False)
                )
                extra.append((topic, Signal(signal.t[twice], signal.value[twice])))
        path = folder / trial.name
        write_signals(
            path,
            start_ns=trial.start_ns,
            force=trial.force,
            tool_height=trial.tool_height,
            displacement=height if clouds is None else None,
            push_velocity=trial.push_velocity,
            phases=trial.phases,
            clouds=() if clouds is None else _frames(trial, *clouds, late=late, seed=seed + index),
            extra=extra,
            provenance=trial.provenance,
            compression=compression,
        )
        paths.append(path)
    return tuple(paths)


def _frames(
    trial: Trial, config: WorldConfig, plan: CloudPlan, *, late: float, seed: int
) -> Iterator[CloudFrame]:
    """
    Yield what the range sensor sees whenever the displacement height was sampled.

    By a clock that is `late` [s] the tool is seen where it was, as the surface is.
    """
    scene = Scene(config.block, config.arm.tool_radius, config.range_sensor)
    renderer = RangeRenderer(
        scene, width=plan.width, height=plan.height, depth_noise=plan.depth_noise, seed=seed
    )
    height = trial.displacement_height
    if height is not None:
        tool = trial.tool_height.at(height.t - late)
        for t, tip, dent in zip(height.t.tolist(), tool, height.value, strict=True):
            yield CloudFrame(t, renderer.render(float(tip), float(dent)), POINTS.frame_id)


class _Path:
    """Puts a motion together from legs between rests."""

    def __init__(self, depth: float, acceleration: float, *, curved: bool = False) -> None:
        self.t, self.depth = 0.0, depth
        self._most, self._curved = acceleration, curved
        self._pieces: list[tuple[float, float, float, float]] = []

    def rest(self, duration: float) -> None:
        """Stay."""
        self._add(duration, 0.0, 0.0)

    def go(self, depth: float, speed: float) -> None:
        """Go to `depth` [m] with at most `speed` [m/s], and stop there."""
        way = depth - self.depth
        if self._curved and way != 0.0:
            self._swing(way, speed)
            self.depth = depth
            return
        sign = math.copysign(1.0, way)
        a = self._most
        top = min(speed, math.sqrt(a * abs(way)))
        steady = (abs(way) - top * top / a) / top
        self._add(top / a, 0.0, sign * a)
        self._add(steady, sign * top, 0.0)
        self._add(top / a, sign * top, -sign * a)
        self.depth = depth

    def _swing(self, way: float, speed: float) -> None:
        """Go a way at least jerk."""
        # T. Flash and N. Hogan, J. Neurosci. 5, 1985, 1688-1703,
        # doi:10.1523/JNEUROSCI.05-07-01688.1985: the greatest speed is 15/8 of the mean one.
        step = 1.875 * abs(way) / speed / _SWING_STEPS
        part = np.linspace(0.0, 1.0, _SWING_STEPS + 1)
        speeds = part**2 * (1.0 - part) ** 2
        speeds *= way / (step * float(speeds.sum()))
        for now, then in pairwise(speeds.tolist()):
            self._add(step, now, (then - now) / step)

    def _add(self, duration: float, speed: float, acceleration: float) -> None:
        if duration > 0.0:
            self._pieces.append((self.t, self.depth, speed, acceleration))
            self.depth += duration * (speed + 0.5 * acceleration * duration)
            self.t += duration

    def motion(self) -> Motion:
        """Return the motion; the tool stays where it is."""
        pieces = np.array([*self._pieces, (self.t, self.depth, 0.0, 0.0)])
        return Motion(*(np.ascontiguousarray(column) for column in pieces.T))


@lru_cache(maxsize=4096)
def _motion(campaign: Campaign, push: Push) -> tuple[Motion, float, tuple[tuple[float, str], ...]]:
    a = campaign.acceleration
    # Far enough above any surface to push with a steady speed at the touch, but on a curve.
    gap = max(1e-3, 6.0 * campaign.surface_scatter, 2.0 * push.speed**2 / a)
    top = max(campaign.clearance, 2.0 * gap)
    path = _Path(-top, a, curved=campaign.curved)
    phases = [(0.0, 'approach')]
    path.rest(campaign.quiet_time)
    path.go(-gap, max(push.speed, 0.01))
    phases.append((path.t, 'push'))
    for step in range(1, push.steps):
        path.go(push.depth * step / push.steps, push.speed)
        path.rest(push.hold)
        if push.back > 0.0:
            path.go(push.depth * step / push.steps - push.back, push.speed)
            path.rest(push.hold)
    path.go(push.depth, push.speed)
    for _ in range(push.swings):
        path.go(push.depth - push.swing, push.speed)
        path.go(push.depth, push.speed)
    phases.append((path.t, 'hold'))
    path.rest(push.hold)
    phases.append((path.t, 'release'))
    path.go(-top, push.release_speed)
    phases.append((path.t, 'recover'))
    path.rest(push.recover)
    phases.append((path.t, 'done'))
    motion = path.motion()
    if campaign.ripple > 0.0:
        motion = _rippling(motion, campaign, _FULL_RIPPLE * push.speed)
    return motion, path.t, tuple(phases)


def _rippling(motion: Motion, campaign: Campaign, full: float) -> Motion:
    """Return a motion with the ripple of the arm, which is full from some speed [m/s] on."""
    step = 1.0 / (_RIPPLE_STEPS * campaign.ripple_rate)
    t = np.arange(0.0, float(motion.t[-1]) + step, step)
    depth, speed, _ = motion.at(t)
    part = np.minimum(np.abs(speed) / full, 1.0)
    depth += campaign.ripple * part * np.sin(2.0 * math.pi * campaign.ripple_rate * t)
    # Speeds that are continuous, with a piece of even acceleration between two of them.
    speeds = np.append(np.gradient(depth[:-1], step), 0.0)
    way = np.concatenate(([0.0], np.cumsum(0.5 * step * (speeds[1:] + speeds[:-1]))))
    return Motion(t, depth[0] + way, speeds, np.append(np.diff(speeds) / step, 0.0))


def _trial(
    campaign: Campaign,
    index: int,
    start: float,
    vector: FloatArray,
    offset: float,
    stretched: float,
    random: np.random.Generator,
    ideal: bool,
) -> tuple[Trial, float, float, float]:
    """
    Return a trial as measured, its true touch and loss, and how far K1 was stretched [m].

    Touch and loss are from its first stamp [s].
    """
    sensors = campaign.sensors
    motion, duration, phases = campaign.motion(index)
    interval = 1.0 / sensors.force_rate
    phase = random.uniform(size=3)
    zero = sensors.force_zero * float(random.standard_normal())
    knock_at = float(random.uniform(0.2, 0.8))
    jitter = 0.0 if ideal else sensors.jitter

    # The steps end where samples of the load cell end.
    steps = max(_OVERSAMPLING, math.ceil(_FINEST * interval))
    first = (phase[0] + 0.5) * interval
    count = int((duration - first) / interval)
    fine = first + interval * (np.arange(count * steps + 1) / steps - 0.5)
    history = integrate(
        fine,
        motion,
        vector,
        surface_offset=offset,
        reference_depth=campaign.deepest,
        campaign_time=start,
        stretched=stretched,
    )
    reading = _load_cell(campaign, index, start, vector, history, motion, knock_at)
    moments: FloatArray = first + interval * np.arange(count)
    force_t = _jittered(moments, interval, jitter, random)
    passed = np.concatenate(([0.0], np.cumsum(reading * np.diff(history.t))))
    value = (
        np.interp(force_t + 0.5 * interval, history.t, passed)
        - np.interp(force_t - 0.5 * interval, history.t, passed)
    ) / interval
    value += zero
    if not ideal:
        value += _force_noise(sensors, force_t, random)
    limit = parameter(vector, 'force_saturation', 'limit')
    value = np.clip(value, -limit, limit)
    step = parameter(vector, 'force_quantisation', 'step')
    if step > 0.0:
        value = np.round(value / step) * step

    tool_interval = 1.0 / sensors.tool_rate
    tool_t = _clock(phase[1], tool_interval, duration, jitter, random)
    tool = campaign.surface_height - motion.at(tool_t)[0]
    if not ideal:
        tool += sensors.encoder_noise * random.standard_normal(tool.size)
        if sensors.encoder_resolution > 0.0:
            tool = np.round(tool / sensors.encoder_resolution) * sensors.encoder_resolution

    height_interval = 1.0 / sensors.height_rate
    height_t = _clock(phase[2], height_interval, duration, jitter, random)
    height = _range_sensor(vector, history, motion, offset, height_t)
    if not ideal:
        height += sensors.height_noise * _coloured(
            height_t, sensors.height_noise_time, random.standard_normal(height.size)
        )
    seen = np.ones(height_t.size, np.bool_)
    if not sensors.sees_in_contact and history.t_loss > history.t_touch:
        seen = (height_t < history.t_touch) | (height_t > history.t_loss)

    gaps = 0 if ideal else sensors.gaps
    streams = [
        _with_gaps(force_t, value, gaps, random),
        _with_gaps(tool_t, tool, gaps, random),
        _with_gaps(height_t[seen], height[seen], gaps, random),
    ]
    began = START_NS + round(start * _NS_PER_S)
    stamps = [began + np.rint(t * _NS_PER_S).astype(np.int64) for t, _ in streams]
    commands = _commands(phases, motion)
    command_stamps = [began + round(t * _NS_PER_S) for t, _ in commands]
    phase_stamps = [began + round(t * _NS_PER_S) for t, _ in phases]
    start_ns = min(*(int(s[0]) for s in stamps if s.size), command_stamps[0], phase_stamps[0])
    signals = [_since(start_ns, s, v) for s, (_, v) in zip(stamps, streams, strict=True)]
    trial = Trial(
        name=f'trial_{index + 1:02d}',
        start_ns=start_ns,
        force=signals[0],
        tool_height=signals[1],
        displacement_height=signals[2],
        displacement_source='topic',
        push_velocity=_since(
            start_ns, np.array(command_stamps), np.array([v for _, v in commands])
        ),
        phases=tuple(
            ((s - start_ns) / _NS_PER_S, name)
            for s, (_, name) in zip(phase_stamps, phases, strict=True)
        ),
        provenance=MappingProxyType({'source': PROVENANCE_TEXT}),
    )
    shift = (start_ns - began) / _NS_PER_S
    return trial, history.t_touch - shift, history.t_loss - shift, history.stretched


def _since(start_ns: int, stamps: NDArray[np.int64], value: FloatArray) -> Signal:
    """Return samples with stamps [ns] as a signal."""
    t: FloatArray = (stamps - start_ns) / _NS_PER_S
    return Signal(t, value)


def _commands(phases: tuple[tuple[float, str], ...], motion: Motion) -> list[tuple[float, float]]:
    """Return the commanded speeds: each phase's highest, and when it was sent."""
    commands = []
    for (t, _), (end, _) in zip(phases, (*phases[1:], (math.inf, '')), strict=True):
        inside = (motion.t >= t) & (motion.t < end)
        speeds = motion.speed[inside]
        commands.append((t, float(speeds[np.argmax(np.abs(speeds))]) if speeds.size else 0.0))
    return commands


def _clock(
    phase: float, interval: float, duration: float, jitter: float, random: np.random.Generator
) -> FloatArray:
    """Return the moments of a stream's samples [s]."""
    moments: FloatArray = phase + np.arange(int(duration / interval - phase) + 1.0)
    return _jittered(interval * moments, interval, jitter, random)


def _jittered(
    moments: FloatArray, interval: float, jitter: float, random: np.random.Generator
) -> FloatArray:
    """Return moments that are off by `jitter` intervals, yet in order."""
    if jitter == 0.0:
        return moments
    off = np.clip(jitter * random.standard_normal(moments.size), -0.45, 0.45)
    return moments + interval * off


def _with_gaps(
    t: FloatArray, value: FloatArray, gaps: int, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Return a stream without what was lost."""
    kept = np.ones(t.size, np.bool_)
    for _ in range(gaps):
        at = int(random.integers(1, max(2, t.size - 1)))
        end = at + int(random.integers(1, 21))
        kept[at:end] = False
    return t[kept], value[kept]


@kernel()
def _coloured(t: FloatArray, correlation_time: float, white: FloatArray) -> FloatArray:
    """Return a stationary Ornstein-Uhlenbeck process of unit variance at the moments `t`."""
    out = white.copy()
    if correlation_time > 0.0:
        for i in range(1, t.size):
            memory = math.exp((t[i - 1] - t[i]) / correlation_time)
            out[i] = memory * out[i - 1] + math.sqrt(1.0 - memory * memory) * white[i]
    return out


def _force_noise(sensors: Sensors, t: FloatArray, random: np.random.Generator) -> FloatArray:
    """Return the noise of the load cell [N]."""
    noise = sensors.force_noise
    total: FloatArray = noise.white * random.standard_normal(t.size)
    for std, time in (
        (noise.coloured, noise.correlation_time),
        (noise.slow, noise.slow_time),
    ):
        if std > 0.0:
            total = total + std * _coloured(t, time, random.standard_normal(t.size))
    return total


@kernel()
def _lagged(dt: FloatArray, force: FloatArray, time: float) -> FloatArray:
    """Return the mean output over each step of a first-order lag [N]."""
    out: FloatArray = np.empty_like(force)
    level = force[0]
    for i in range(force.size):
        passed = -math.expm1(-dt[i] / time)
        out[i] = force[i] + (level - force[i]) * passed * time / dt[i]
        level += (force[i] - level) * passed
    return out


@kernel()
def _play(force: FloatArray, width: float) -> FloatArray:
    """Return what follows the force only where it has moved by `width` (play operator) [N]."""
    out = np.empty_like(force)
    level = 0.0
    for i in range(force.size):
        level = min(max(level, force[i] - width), force[i] + width)
        out[i] = level
    return out


@kernel()
def _dahl(travel: FloatArray, speed: FloatArray, reach: float) -> FloatArray:
    """Return Dahl's friction over its Coulomb force: it builds up over `reach` and stays."""
    out = np.empty_like(speed)
    level = 0.0
    for i in range(speed.size):
        direction = 1.0 if speed[i] > 0.0 else -1.0
        target = direction if speed[i] != 0.0 else level
        level = target + (level - target) * math.exp(-abs(travel[i]) / reach)
        out[i] = level
    return out


def _load_cell(
    campaign: Campaign,
    index: int,
    start: float,
    vector: FloatArray,
    history: History,
    motion: Motion,
    knock_at: float,
) -> FloatArray:
    """Return what the load cell makes of the contact force, over each step [N]."""
    dt = np.diff(history.t)
    middle: FloatArray = history.t[:-1] + 0.5 * dt
    force: FloatArray = history.force
    speed = motion.at(middle)[1]

    coulomb = parameter(vector, 'friction', 'F_c')
    if coulomb != 0.0:
        force = force + coulomb * np.sign(np.round(speed, 12))
    coulomb = parameter(vector, 'stiction', 'F_c')
    if coulomb != 0.0:
        travel = np.diff(motion.at(history.t)[0])
        force = force + coulomb * _dahl(
            travel, np.round(speed, 12), parameter(vector, 'stiction', 'travel')
        )
    coulomb = parameter(vector, 'contact_friction', 'F_c')
    touched = (middle > history.t_touch) & ~(middle > history.t_loss)
    force = force + coulomb * np.sign(np.round(speed, 12)) * touched
    mass = parameter(vector, 'tool_mass', 'M') + parameter(vector, 'gathered_mass', 'M') * touched
    force = force + mass * motion.at(middle)[2]
    amplitude = parameter(vector, 'knock', 'amplitude')
    if amplitude != 0.0 and index == len(campaign.pushes) // 2:
        push = campaign.pushes[index]
        hold = campaign.motion(index)[2][2][0]
        since = middle - hold - knock_at * push.hold
        ring = np.sin(2.0 * np.pi * parameter(vector, 'knock', 'frequency') * since)
        ring *= np.exp(-np.maximum(since, 0.0) / parameter(vector, 'knock', 'decay'))
        force = force + amplitude * np.where(since > 0.0, ring, 0.0)

    share = parameter(vector, 'cell_creep', 'share')
    if share != 0.0:
        force = force + share * _lagged(dt, force, parameter(vector, 'cell_creep', 'time'))
    share = parameter(vector, 'cell_hysteresis', 'share')
    if share != 0.0:
        width = parameter(vector, 'cell_hysteresis', 'width')
        force = force + share * (_play(force, width) - force)
    lag = parameter(vector, 'force_lag', 'T_f')
    if lag > 0.0:
        force = _lagged(dt, force, lag)
    if 2 * index >= len(campaign.pushes):
        force = force * (1.0 + parameter(vector, 'gain_step', 'share'))
    force = force + parameter(vector, 'force_drift', 'rate') * (start + middle)
    amplitude = parameter(vector, 'periodic_disturbance', 'amplitude')
    if amplitude != 0.0:
        omega = 2.0 * np.pi * parameter(vector, 'periodic_disturbance', 'frequency')
        mean = np.sinc(0.5 * omega * dt / np.pi)
        force = force + amplitude * mean * np.sin(omega * (start + middle))
    return force


def _range_sensor(
    vector: FloatArray, history: History, motion: Motion, offset: float, stamps: FloatArray
) -> FloatArray:
    """Return the displacement height that is stamped with `stamps` [m]."""
    t = stamps - parameter(vector, 'clock_offset', 'dt')
    height = np.interp(t, history.t, history.surface)
    height *= 1.0 + parameter(vector, 'height_gain', 'share')
    below = motion.at(t)[0] + offset > 0.0
    clearance = parameter(vector, 'early_shadow', 'clearance')
    near = motion.at(t)[0] + offset > -clearance
    height += parameter(vector, 'early_shadow', 'b') * near
    touched = (t > history.t_touch) & ~(t > history.t_loss)
    height += parameter(vector, 'touch_shadow', 'b') * touched
    loose = parameter(vector, 'loose_top', 'delta_0')
    deepest = np.maximum.accumulate(motion.at(history.t)[0] + offset)
    height += np.clip(np.interp(t, history.t, deepest) + loose, 0.0, loose)
    return height + parameter(vector, 'height_bias', 'b') * below
