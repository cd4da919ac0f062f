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
The phases of a trial are found from its signals alone, offline and online.

The trials come from integrators of their own (below), not from the models of the package: the
truth of each event is known from the integration.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cache
import math
import pickle
from typing import Any

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal
from hapticvision_ros.core.segmentation import (
    OnlineSegmenter,
    PhaseEvent,
    segment,
    SegmentationOptions,
)
from hapticvision_ros.core.segmentation.contact import _before_rise
import numpy as np
import pytest
from scipy.signal import lfilter


@dataclass(frozen=True)
class Body:
    """
    An object under the tool; forces [N], penetration [m].

    The force of a penetration s is ``stiffness * s**power`` of an equilibrium spring beside a
    Maxwell branch (`maxwell` [N/m^power], `relaxation_time` [s]), or that of Kelvin-Voigt
    (`stiffness`, `c1`) in series with a dashpot `c2` that flows above `yield_force`.
    """

    stiffness: float = 1e3
    power: float = 1.0
    maxwell: float = 0.0
    relaxation_time: float = 10.0
    c1: float = 0.0
    c2: float = 0.0
    yield_force: float = 0.0
    adhesion: float = 0.0

    def integrate(self, t: FloatArray, s: FloatArray) -> tuple[FloatArray, float | None]:
        """Return the force under the tool's travel `s` beyond the surface, and t_loss."""
        force = np.zeros_like(t)
        slow = 0.0  # travel that the dashpot has taken up
        z = 0.0  # stretch of Kelvin-Voigt
        touching, t_loss = False, None
        for i in range(1, t.size):
            dt = t[i] - t[i - 1]
            surface = z + slow if self.c2 else 0.0
            if not touching and s[i] > surface and t_loss is None:
                touching = True
            if self.c2:
                if touching:
                    v = (s[i] - max(s[i - 1], surface)) / dt
                    # Implicit: F = K1 z' + C1 (z' - z)/dt with z' = z + (v - (F - Fy)/C2) dt.
                    a = self.stiffness * dt + self.c1
                    f = self.stiffness * z + a * v
                    flow = 0.0
                    if abs(f) > self.yield_force:
                        excess = f - math.copysign(self.yield_force, f)
                        flow = excess / (a + self.c2)
                        f = f - a * flow
                    z += (v - flow) * dt
                    slow += flow * dt
                    force[i] = f
                else:
                    z -= z * dt / (self.c1 / self.stiffness + dt)
            elif touching:
                pen = max(s[i], 0.0) ** self.power
                slow += (pen - slow) * dt / (self.relaxation_time + dt)
                force[i] = self.stiffness * pen + self.maxwell * (pen - slow)
                if s[i] < 0.0:
                    force[i] = self.stiffness * s[i] - self.maxwell * slow
            if touching and force[i] < -self.adhesion:
                touching, t_loss = False, float(t[i])
                force[i] = 0.0
        return force, t_loss


@dataclass(frozen=True)
class Case:
    """A trial: what the tool does, what it meets and how it is measured (SI units)."""

    body: Body = field(default_factory=Body)
    speed: float = 1.3e-3
    return_speed: float | None = None
    depth: float = 10e-3
    wait: float = 1.0
    air: float = 3e-3
    slowing: float = 0.0
    hold: float = 60.0
    recover: float = 30.0
    force_rate: float = 200.0
    height_rate: float = 100.0
    snr: float = 500.0
    ar: float = 0.0
    offset: float = 0.0
    drift: float = 0.0
    height_noise: float = 0.0
    quantum: float = 0.0
    stick_slip: float = 0.0
    glitches: int = 0
    start: float = 0.0
    stop: float = math.inf
    seed: int = 0


@dataclass(frozen=True)
class Measured:
    """
    The signals of a case, and the truth.

    `blur` [m] is the travel from contact over which the force hides in the noise (below one
    standard deviation); `loss_blur` [s] the time before the loss of contact over which it stays
    below three. They are what no segmentation from a few samples can look through.
    """

    force: Signal
    height: Signal
    t_contact: float
    t_hold: float
    t_release: float
    t_loss: float | None
    sigma: float
    peak: float
    blur: float
    loss_blur: float


def simulate(case: Case) -> Measured:
    """Integrate a case and measure it."""
    v, back = case.speed, case.return_speed or case.speed
    t0 = case.wait
    t_contact = t0 + case.air / v
    t_hold = t0 + (case.air + case.depth) / v + 0.5 * case.slowing
    t_release = t_hold + case.hold
    t_up = t_release + (case.depth + max(case.air, 0.3 * case.depth)) / back
    t_end = t_up + case.recover
    edges = [0.0, t0, t_contact, t_hold, t_release, t_up, t_end]
    counts = [10, 300, 2000, 2000, 2000, 2000]
    grid = np.unique(
        np.concatenate(
            [np.linspace(a, b, n) for a, b, n in zip(edges, edges[1:], counts, strict=False)]
        )
    )

    def travel(t: FloatArray) -> FloatArray:
        left = np.maximum(t_hold - t, 0.0)
        d = max(case.slowing, 1e-12)
        ramp = case.air + case.depth - v * np.where(left < d, left**2 / (2 * d), left - d / 2)
        ramp = np.maximum(np.where(t < t0, 0.0, ramp), 0.0)
        out = np.where(t > t_release, case.air + case.depth - back * (t - t_release), ramp)
        out = np.where(t > t_up, case.air + case.depth - back * (t_up - t_release), out)
        if case.stick_slip:
            moving = (t > t0) & (t < t_hold)
            phase = (out / case.stick_slip) % 1.0
            out = np.where(moving, out + case.stick_slip * (np.minimum(0.0, phase - 0.5)), out)
        return np.asarray(out - case.air)

    clean, t_loss = case.body.integrate(grid, travel(grid))
    peak = float(np.max(clean))
    sigma = peak / case.snr
    rng = np.random.default_rng(case.seed)
    t = np.arange(case.start, min(t_end, case.stop), 1.0 / case.force_rate)
    white = rng.standard_normal(t.size)
    noise = white.copy()
    if case.ar:
        for i in range(1, t.size):
            noise[i] = case.ar * noise[i - 1] + math.sqrt(1 - case.ar**2) * white[i]
    f = np.interp(t, grid, clean) + sigma * noise + case.offset + case.drift * t
    if case.glitches:
        f[rng.choice(t.size, case.glitches, replace=False)] += 2.0 * peak
    th = np.arange(case.start, min(t_end, case.stop), 1.0 / case.height_rate)
    h = 0.2 - travel(th) + case.height_noise * rng.standard_normal(th.size)
    if case.quantum:
        h = np.round(h / case.quantum) * case.quantum
    # Travel after contact at which the force is one standard deviation of its noise.
    touch = grid > t_contact
    over = grid[touch][np.abs(clean[touch]) >= sigma]
    blur = v * (float(over[0]) - t_contact) if over.size else math.inf
    loss_blur = 0.0
    if t_loss is not None:
        last = grid[(grid < t_loss) & (np.abs(clean) >= 3.0 * sigma)]
        loss_blur = t_loss - float(last[-1])
    force, height = Signal(t, f), Signal(th, h)
    return Measured(
        force, height, t_contact, t_hold, t_release, t_loss, sigma, peak, blur, loss_blur
    )


def run_online(
    measured: Measured, options: SegmentationOptions | None = None
) -> tuple[list[PhaseEvent], OnlineSegmenter]:
    """Feed the samples in order of time; return the events and the segmenter."""
    segmenter = OnlineSegmenter() if options is None else OnlineSegmenter(options)
    force, height = measured.force, measured.height
    t = np.concatenate((height.t, force.t))
    value = np.concatenate((height.value, force.value))
    events: list[PhaseEvent] = []
    for i in np.argsort(t, kind='stable').tolist():
        add = segmenter.add_height if i < len(height) else segmenter.add_force
        events += add(float(t[i]), float(value[i]))
    return events, segmenter


SPRING = Body(1e3)
STANDARD_SOLID = Body(500.0, maxwell=800.0)
HERTZ = Body(2e4, power=1.5, maxwell=2e4, relaxation_time=5.0)
THREE_ELEMENT = Body(stiffness=4.9e3, c1=8e4, c2=1.2e5, yield_force=4.9)
STICKY = replace(STANDARD_SOLID, adhesion=0.4)
SOFT = Body(1.0, maxwell=2.0, relaxation_time=3.0)

CASES = {
    'a slow push after a short approach': Case(
        Body(20.0, c1=100.0, c2=788.0),
        speed=0.88e-3,
        depth=9.9e-3,
        wait=0.34,
        air=0.1e-3,
        hold=8.0,
        recover=10.0,
        force_rate=420.0,
        height_rate=50.0,
        snr=60.0,
        offset=-0.05,
    ),
    'spring': Case(SPRING),
    'standard solid': Case(STANDARD_SOLID),
    'hertz': Case(HERTZ),
    'three-element with yield force': Case(THREE_ELEMENT),
    'fast withdrawal': Case(THREE_ELEMENT, return_speed=20e-3),
    'adhesion': Case(STICKY),
    'noise': Case(STANDARD_SOLID, snr=60.0),
    'noise, hertz': Case(HERTZ, snr=60.0),
    'noise, three-element': Case(THREE_ELEMENT, snr=60.0),
    'correlated noise': Case(STANDARD_SOLID, snr=100.0, ar=0.8),
    'offset and drift': Case(STANDARD_SOLID, offset=-3.0, drift=0.01),
    'offset and drift, hertz': Case(HERTZ, offset=30.0, drift=-0.02),
    'glitches': Case(STANDARD_SOLID, glitches=10),
    'slow': Case(STANDARD_SOLID, speed=1e-4, depth=2e-3, air=1e-3),
    'fast': Case(STANDARD_SOLID, speed=50e-3, force_rate=1000.0, height_rate=500.0),
    'fast, hertz, slow encoder': Case(
        HERTZ, speed=50e-3, depth=5e-3, force_rate=1000.0, height_rate=100.0
    ),
    'shallow': Case(STANDARD_SOLID, depth=2e-4, air=1e-3, speed=1e-3),
    'deep': Case(STANDARD_SOLID, depth=30e-3),
    'slows down': Case(STANDARD_SOLID, slowing=1.0),
    'encoder steps': Case(STANDARD_SOLID, quantum=5e-5),
    'height noise': Case(STANDARD_SOLID, height_noise=5e-5),
    'stick-slip': Case(STANDARD_SOLID, stick_slip=2e-4),
    'few samples': Case(STANDARD_SOLID, force_rate=2.0, height_rate=2.0),
    'coarse height': Case(STANDARD_SOLID, force_rate=500.0, height_rate=5.0),
    'one sample in 2.5 s': Case(
        STANDARD_SOLID,
        speed=1e-4,
        force_rate=0.4,
        height_rate=0.4,
        hold=300.0,
        recover=200.0,
        wait=20.0,
    ),
    'no approach': Case(STANDARD_SOLID, air=0.0),
    'no rest before the approach': Case(STANDARD_SOLID, wait=0.0),
    'from the first sample': Case(STANDARD_SOLID, air=0.0, wait=0.0),
    'millinewtons': Case(SOFT, depth=3e-3, snr=100.0),
    '500 N': Case(Body(2e4, maxwell=3e4), snr=1000.0),
    'jump, fast samples': Case(
        THREE_ELEMENT,
        speed=7.7e-3,
        depth=15e-3,
        air=15e-3,
        force_rate=1000.0,
        height_rate=500.0,
        snr=5000.0,
        ar=0.95,
    ),
    'jump, long record': Case(
        THREE_ELEMENT,
        speed=20e-3,
        depth=15e-3,
        air=15e-3,
        hold=220.0,
        force_rate=500.0,
        height_rate=250.0,
    ),
    'long approach': Case(STANDARD_SOLID, air=100e-3, speed=1e-3, depth=1e-3),
}
NAMES = pytest.mark.parametrize('name', CASES)


@cache
def measured(name: str) -> Measured:
    """Return the trial of a case, simulated once."""
    return simulate(CASES[name])


def contact_bound(case: Case, trial: Measured) -> float:
    """
    Return the bound on the error of T_c [s]: a sample, or twice what the noise hides.

    Correlated noise hides more: 1 / (1 - ar) samples of it count for about one.
    """
    hidden = 2.0 * trial.blur / case.speed / math.sqrt(1.0 - case.ar)
    return max(1.0 / case.force_rate, hidden)


def motion_bound(case: Case) -> float:
    """Return the bound on the errors of T_s and T_e [s]: a fifth of a sample, or the jitter's."""
    jitter = case.height_noise + case.quantum + 0.5 * case.stick_slip
    return max(0.2 / case.height_rate, jitter / case.speed)


@NAMES
def test_contact_is_found_within_a_sample_or_what_the_noise_hides(name: str) -> None:
    case, trial = CASES[name], measured(name)
    found = segment(trial.force, trial.height)
    assert found.t_contact is not None
    assert abs(found.t_contact - trial.t_contact) <= contact_bound(case, trial)


@NAMES
def test_the_force_zero_is_the_reading_just_before_contact(name: str) -> None:
    case, trial = CASES[name], measured(name)
    found = segment(trial.force, trial.height)
    assert found.t_contact is not None
    error = found.force_zero - case.offset - case.drift * found.t_contact
    # The mean of some tens of samples or more, of a few where there are few.
    few = 1.0 if case.force_rate <= 2.0 else 0.4
    assert abs(error) <= few * trial.sigma / math.sqrt(1.0 - case.ar)


def test_the_jump_of_a_dashpot_at_contact_stays_out_of_the_force_zero() -> None:
    trial = measured('jump, fast samples')
    found = segment(trial.force, trial.height)
    # A mean over the whole approach, of which the correlation leaves one sample in forty.
    before = np.count_nonzero(trial.force.t < trial.t_contact)
    assert abs(found.force_zero) <= 4.0 * trial.sigma * math.sqrt(39.0 / before)


@pytest.mark.parametrize('wait', [1.0008, 1.0013, 1.0037])
@pytest.mark.parametrize('since', [0.0, 0.01, 1.7, 1e3])
def test_a_jump_is_half_way_between_two_samples_whenever_the_record_begins(wait, since) -> None:
    """The same samples are counted from another moment: live, and in the bag of the trial."""
    trial = simulate(Case(THREE_ELEMENT, speed=10e-3, wait=wait, hold=2.0, recover=2.0))
    force, height = (
        Signal(signal.t + since, signal.value) for signal in (trial.force, trial.height)
    )
    found = segment(force, height)
    after = int(np.searchsorted(trial.force.t, trial.t_contact))
    middle = 0.5 * (trial.force.t[after - 1] + trial.force.t[after])
    assert found.t_contact == pytest.approx(middle + since, abs=1e-9)


@NAMES
def test_hold_and_release_are_found_finer_than_a_sample_of_the_height(name: str) -> None:
    case, trial = CASES[name], measured(name)
    found = segment(trial.force, trial.height)
    assert found.t_hold is not None
    assert found.t_release is not None
    assert abs(found.t_hold - trial.t_hold) <= motion_bound(case)
    assert abs(found.t_release - trial.t_release) <= motion_bound(case)


@NAMES
def test_loss_of_contact_is_found_within_two_samples_or_what_the_noise_hides(name: str) -> None:
    case, trial = CASES[name], measured(name)
    found = segment(trial.force, trial.height)
    assert found.t_loss is not None
    assert trial.t_loss is not None
    hidden = trial.loss_blur / math.sqrt(1.0 - case.ar)
    assert abs(found.t_loss - trial.t_loss) <= max(2.0 / case.force_rate, hidden)


@NAMES
def test_depth_speed_and_original_height_are_those_of_the_tool(name: str) -> None:
    case, trial = CASES[name], measured(name)
    found = segment(trial.force, trial.height)
    slack = case.speed * contact_bound(case, trial) + case.height_noise + case.quantum
    slack += case.stick_slip + 1e-6
    assert found.depth == pytest.approx(case.depth, abs=slack)
    assert found.contact_height == pytest.approx(0.2, abs=slack)
    push = trial.t_hold - trial.t_contact
    spread = slack / push + case.depth / push**2 * (
        contact_bound(case, trial) + motion_bound(case)
    )
    assert found.push_speed == pytest.approx(case.depth / push, abs=spread)


@NAMES
def test_online_finds_the_phases_that_the_whole_record_shows(name: str) -> None:
    case, trial = CASES[name], measured(name)
    whole = segment(trial.force, trial.height)
    events, segmenter = run_online(trial)
    assert [event.kind for event in events] == ['contact', 'hold', 'release', 'loss']
    assert segmenter.phase == 'recover'
    assert all(event.t <= event.detected_at for event in events)
    contact, hold, release, loss = (event.t for event in events)
    assert whole.t_contact is not None
    assert whole.t_hold is not None
    assert whole.t_release is not None
    assert whole.t_loss is not None
    # It decides on the first samples above six standard deviations of the noise.
    bound = max(5.0 / case.force_rate, 4.0 * contact_bound(case, trial))
    assert abs(contact - whole.t_contact) <= bound
    bound = max(1.0 / case.height_rate, 2.0 * motion_bound(case))
    assert abs(hold - whole.t_hold) <= bound
    assert abs(release - whole.t_release) <= bound
    assert abs(loss - whole.t_loss) <= max(3.0 / case.force_rate, 4.0 * trial.loss_blur)


@NAMES
def test_online_detects_before_the_phase_is_far_gone(name: str) -> None:
    case, trial = CASES[name], measured(name)
    events, _ = run_online(trial)
    delay = {event.kind: event.detected_at - event.t for event in events}
    push, slow = trial.t_hold - trial.t_contact, 8.0 / min(case.force_rate, case.height_rate)
    assert delay['contact'] <= 0.3 * push + slow
    assert delay['hold'] <= 0.15 * push + slow + 10.0 * motion_bound(case)
    assert delay['release'] <= 0.1 * push + slow + 10.0 * motion_bound(case)


@pytest.mark.parametrize('push_speed', [0.004, 0.008])
@pytest.mark.parametrize('seed', range(8))
def test_heights_that_come_late_hide_neither_the_stop_nor_the_start_of_the_tool(
    live: Callable[..., Any], push_speed: float, seed: int
) -> None:
    trial = live(push_speed=push_speed, seed=seed)
    force, height = trial.make()
    found = segment(force, height)
    assert found.t_hold is not None and found.t_release is not None
    # The tool slows down over 8 and 16 ms and starts over 40 ms; heights are 2 ms apart, after a
    # stall up to some 40, and none is early. What follows the tool at rest is the hold.
    assert -0.004 <= found.t_hold - trial.t_hold <= 0.03
    assert -0.004 <= found.t_release - trial.t_release <= 0.004


def test_gaps_in_the_heights_are_no_rest_of_the_tool() -> None:
    trial = measured('fast')
    t = trial.height.t
    gap = (np.abs(t - trial.t_hold + 0.08) < 0.04) & (np.abs(t - trial.t_hold + 0.08) > 0.0015)
    found = segment(trial.force, Signal(t[~gap], trial.height.value[~gap]))
    assert found.t_hold == pytest.approx(trial.t_hold, abs=0.002)
    assert found.t_release == pytest.approx(trial.t_release, abs=0.002)
    assert found.warnings == ()


def test_the_force_of_a_trial_without_contact_is_no_contact() -> None:
    trial = simulate(Case(STANDARD_SOLID, stop=3.0, snr=50.0, offset=2.0))
    found = segment(trial.force, trial.height)
    assert found.t_contact is found.t_hold is found.t_release is found.t_loss is None
    assert found.depth is found.push_speed is found.contact_height is None
    assert found.force_zero == pytest.approx(2.0, abs=trial.sigma)
    assert any('no contact' in warning for warning in found.warnings)
    events, segmenter = run_online(trial)
    assert events == []
    assert segmenter.phase == 'approach'


def test_a_record_that_starts_in_the_push_is_in_contact_from_its_start() -> None:
    trial = simulate(Case(STANDARD_SOLID, start=4.5))
    found = segment(trial.force, trial.height)
    assert found.t_contact == 4.5
    assert any('start of the record' in warning for warning in found.warnings)
    assert not found.push_is_cut
    # The force after the loss of contact still tells the load cell's zero.
    assert found.force_zero == pytest.approx(0.0, abs=0.4 * trial.sigma)


def test_a_record_that_starts_in_the_hold_has_no_push() -> None:
    trial = simulate(Case(STANDARD_SOLID, start=20.0, stop=60.0))
    found = segment(trial.force, trial.height)
    assert found.t_contact == found.t_hold == 20.0
    assert found.t_release is found.depth is found.push_speed is None
    assert any('the push is not in it' in warning for warning in found.warnings)
    assert found.push_is_cut
    assert any('taken as 0 N' in warning for warning in found.warnings)


def test_a_missing_release_is_said_and_not_guessed() -> None:
    trial = simulate(Case(STANDARD_SOLID, stop=60.0))
    found = segment(trial.force, trial.height)
    assert found.t_hold == pytest.approx(trial.t_hold, abs=0.002)
    assert found.t_release is found.t_loss is None
    assert found.t_end == trial.height.t[-1]
    assert any('release is missing' in warning for warning in found.warnings)


def test_a_push_that_never_ends_has_no_depth() -> None:
    trial = simulate(Case(STANDARD_SOLID, stop=8.0))
    found = segment(trial.force, trial.height)
    assert found.t_contact == pytest.approx(trial.t_contact, abs=0.005)
    assert found.t_hold is found.t_release is found.depth is None
    assert found.push_speed == pytest.approx(1.3e-3, rel=0.01)
    assert any('hold is missing' in warning for warning in found.warnings)


def test_a_push_that_turns_at_once_has_a_release_and_no_hold() -> None:
    case = Case(STANDARD_SOLID, hold=0.0)
    trial = simulate(case)
    found = segment(trial.force, trial.height)
    assert found.t_hold is None
    assert found.t_release == pytest.approx(trial.t_release, abs=1.5 / case.height_rate)
    assert found.depth == pytest.approx(case.depth, rel=0.01)
    assert [event.kind for event in run_online(trial)[0]] == ['contact', 'release', 'loss']


def staircase() -> Measured:
    """Return three pushes of 2 mm at 1 mm/s with rests of 30 s, in contact from the start."""
    t = np.arange(0.0, 100.0, 0.02)
    knots = [0.0, 2.0, 32.0, 34.0, 64.0, 66.0, 100.0]
    x = np.interp(t, knots, [0.0, 2e-3, 2e-3, 4e-3, 4e-3, 6e-3, 6e-3])
    force, _ = STANDARD_SOLID.integrate(t, x)
    sigma = 1e-3
    noisy = force + sigma * np.random.default_rng(5).standard_normal(t.size)
    height = Signal(t, 0.05 - x)
    return Measured(Signal(t, noisy), height, 0.0, 2.0, 32.0, None, sigma, 4.0, 1e-6, 0.0)


def test_of_a_staircase_the_first_step_is_taken_and_all_of_it_is_known() -> None:
    found = segment(staircase().force, staircase().height)
    assert found.t_contact == 0.0
    assert found.t_hold == pytest.approx(2.0, abs=0.004)
    assert found.t_release is found.t_loss is None
    assert found.t_end == pytest.approx(32.0, abs=0.004)
    assert found.depth == pytest.approx(2e-3, rel=1e-3)
    assert any('first of 3 holds' in warning for warning in found.warnings)
    assert found.whole is not None
    assert found.whole.t_contact == found.t_contact
    assert found.whole.t_hold == pytest.approx(66.0, abs=0.004)
    assert found.whole.t_end == pytest.approx(100.0, abs=0.02)
    assert found.whole.t_release is found.whole.t_loss is found.whole.whole is None
    assert found.whole.depth == pytest.approx(6e-3, rel=1e-3)
    assert (found.whole.push_speed, found.whole.t_first) == (found.push_speed, found.t_hold)
    assert 'first step' in found.unreleased
    assert 'first step' not in found.whole.unreleased
    assert not any('steps' in warning for warning in found.whole.warnings)


@pytest.mark.parametrize('held', [True, False])
def test_of_pushes_that_go_deeper_one_after_another_the_deepest_is_the_push(held: bool) -> None:
    """Holds, also where the tool has gone back; the deepest push may have none."""
    t = np.arange(0.0, 60.0, 0.02)
    hold = 10.0 if held else 0.0
    lasts = np.cumsum([2.0, 4.0, 10.0, 2.0, 10.0, 4.0, hold, 8.0])
    x = np.interp(t, [0.0, *lasts], 1e-3 * np.array([-2, -2, 2, 2, 0.5, 0.5, 4, 4, -5]))
    force, _ = STANDARD_SOLID.integrate(t, np.maximum(x, 0.0))
    noisy = force + 1e-3 * np.random.default_rng(5).standard_normal(t.size)
    found = segment(Signal(t, noisy), Signal(t, 0.05 - x))
    assert found.t_hold == pytest.approx(6.0, abs=0.01)
    assert found.t_end == pytest.approx(16.0, abs=0.02)
    assert any('those of the first hold, up' in warning for warning in found.warnings)
    assert found.whole is not None
    assert found.whole.t_hold == (pytest.approx(32.0, abs=0.01) if held else None)
    assert found.whole.t_release == pytest.approx(32.0 + hold, abs=0.02)
    assert found.whole.depth == pytest.approx(4e-3, rel=0.01)


@pytest.mark.parametrize(
    ('lasts', 'levels', 'ends', 'stop'),
    [
        ([2, 2, 8, 2, 8, 2, 8, 2, 8, 6], [-2, 2, 2, 4, 4, 6, 6, 8, 8, -4], 12.0, 34.0),
        ([2, 4, 10, 1, 10, 8], [-2, 4, 4, 5, 5, -4], 16.0, 17.0),
        ([2, 4, 10, 6, 5, 9, 10, 6], [-2, 4, 4, -2, -2, 5, 5, -5], 16.0, 36.0),
    ],
    ids=['even', 'a little deeper', 'out and deeper'],
)
def test_the_last_way_to_the_deepest_rest_tells_when_it_begins(
    lasts: list[float], levels: list[float], ends: float, stop: float
) -> None:
    """It has been most of the way down before."""
    t = np.arange(0.0, sum(lasts) + 6.0, 0.02)
    x = 1e-3 * np.interp(t, np.cumsum([0.0, *lasts]), [-2.0, *map(float, levels)])
    force, _ = STANDARD_SOLID.integrate(t, np.maximum(x, 0.0))
    noisy = force + 1e-3 * np.random.default_rng(5).standard_normal(t.size)
    found = segment(Signal(t, noisy), Signal(t, 0.05 - x))
    assert found.t_end == pytest.approx(ends, abs=0.05)
    assert found.whole is not None
    assert found.whole.t_hold == pytest.approx(stop, abs=0.05)
    assert found.whole.t_release == pytest.approx(sum(lasts[:-1]), abs=0.05)


def test_the_turned_force_of_an_object_that_relaxes_is_told() -> None:
    """For most of the time that the tool is deep nothing is left of it."""
    t = np.arange(0.0, 40.0, 0.02)
    x = np.interp(t, [0.0, 2.0, 3.0, 35.0, 36.0], [-5e-3, -5e-3, 5e-3, 5e-3, -5e-3])
    relaxing = np.where((t > 2.5) & (t < 35.0), np.where(t < 3.0, t - 2.5, 0.0), 0.0)
    relaxing += np.where((t >= 3.0) & (t < 35.0), 0.5 * np.exp(-(t - 3.0)), 0.0)
    noise = 1e-3 * np.random.default_rng(3).standard_normal(t.size)
    glitch = np.where(np.abs(t - 1.0) < 0.03, -20.0, 0.0)
    right = segment(Signal(t, 10.0 * relaxing + noise + glitch), Signal(t, 0.05 - x))
    assert right.t_contact == pytest.approx(2.5, abs=0.05)
    turned = segment(Signal(t, noise - 10.0 * relaxing), Signal(t, 0.05 - x))
    assert turned.t_contact is None
    assert turned.warnings[0].endswith('turn its sign')


@pytest.mark.parametrize('what', ['start', 'dropout', 'snap', 'drift'])
def test_a_force_that_falls_but_not_with_the_push_is_not_turned(what: str) -> None:
    t = np.arange(0.0, 60.0, 0.01)
    x = np.interp(t, [0.0, 2.0, 10.0, 19.0, 20.0], [-5e-3, -5e-3, 3e-3, 3e-3, -5e-3])
    force = 0.3 * np.maximum(x, 0.0) / 3e-3 + 5e-3 * np.random.default_rng(3).standard_normal(
        t.size
    )
    if what == 'start':
        force -= np.where((t > 2.0) & (t < 2.12), 1.2, 0.0)
    elif what == 'dropout':
        force -= np.where((t > 4.0) & (t < 4.2), 5.0, 0.0)
    elif what == 'snap':
        force -= np.where((t > 6.9) & (t < 7.3), 1.2, 0.0)
    else:
        force = -0.03 * t + 5e-3 * np.random.default_rng(3).standard_normal(t.size)
    found = segment(Signal(t, force), Signal(t, 0.05 - x))
    assert not any(warning.endswith('turn its sign') for warning in found.warnings)


@pytest.mark.parametrize('which', ['force', 'height'])
def test_a_sign_that_is_turned_is_told_and_is_no_contact(which: str) -> None:
    trial = simulate(Case(STANDARD_SOLID))
    force, height = trial.force, trial.height
    if which == 'force':
        force = Signal(force.t, -force.value)
    else:
        height = Signal(height.t, 0.1 - height.value)
    found = segment(force, height)
    assert found.t_contact is found.t_hold is None
    (warning,) = found.warnings
    assert f'the {which} ' in warning and warning.endswith('turn its sign')


def test_online_tells_each_step_of_a_staircase() -> None:
    events, segmenter = run_online(staircase())
    kinds = [event.kind for event in events]
    assert kinds == ['contact', 'hold', 'step', 'hold', 'step', 'hold']
    assert [event.t for event in events] == pytest.approx([0, 2, 32, 34, 64, 66], abs=0.02)
    assert segmenter.phase == 'hold'


def held_withdrawal(plateau: float) -> Measured:
    """Return a trial whose tool follows the recovering surface at a force of `plateau` [N]."""
    case = Case(STANDARD_SOLID, hold=10.0)
    trial = simulate(case)
    t, h = trial.force.t, trial.height.t
    sigma = trial.sigma
    at_release = float(np.interp(trial.t_release, t, trial.force.value))
    decay = np.exp(-np.maximum(t - trial.t_release, 0.0) / 1.5)
    held = plateau + (at_release - plateau) * decay
    noise = sigma * np.random.default_rng(3).standard_normal(t.size)
    force = np.where(t < trial.t_release, trial.force.value, held + noise)
    up = 1.0 - np.exp(-np.maximum(h - trial.t_release, 0.0) / 1.5)
    height = np.where(h < trial.t_release, trial.height.value, 0.19 + 0.006 * up)
    return replace(trial, force=Signal(t, force), height=Signal(h, height))


def test_a_force_kept_on_withdrawal_ends_the_release_where_it_has_settled() -> None:
    trial = held_withdrawal(0.4)
    found = segment(trial.force, trial.height)
    assert found.t_release == pytest.approx(trial.t_release, abs=0.02)
    assert found.t_loss is not None
    left = np.interp(found.t_loss, trial.force.t, trial.force.value) - 0.4
    # Settled: within the band of 1.5 % of the peak or six standard deviations.
    assert abs(left) <= max(0.015 * trial.peak, 6.0 * trial.sigma)
    assert any('not lost for good' in warning for warning in found.warnings)


def test_a_large_force_kept_on_withdrawal_is_no_loss_of_contact() -> None:
    trial = held_withdrawal(0.3 * measured('standard solid').peak)
    found = segment(trial.force, trial.height)
    assert found.t_release is not None
    assert found.t_loss is None
    assert any('loss of contact is missing' in warning for warning in found.warnings)


def test_a_surface_seen_below_the_tool_is_a_loss_of_contact_whatever_the_force() -> None:
    trial = held_withdrawal(0.4)
    t = np.arange(0.0, trial.height.t[-1], 0.1)
    travel = 0.2 - trial.height.at(t)
    noise = 2e-4 * np.random.default_rng(4).standard_normal(t.size)
    follows = Signal(t, np.maximum(travel, 0.0) + noise)
    stays = np.where(t > trial.t_release, np.maximum(travel, 8e-3), np.maximum(travel, 0.0))
    apart = Signal(t, stays + noise)
    kept = segment(trial.force, trial.height, follows)
    free = segment(trial.force, trial.height, apart)
    assert any('not lost for good' in warning for warning in kept.warnings)
    assert not any('not lost for good' in warning for warning in free.warnings)
    assert free.t_loss is not None


@dataclass(frozen=True)
class Slow:
    """A push at 1 mm/s into what grows stiff by and by, seen by load cell and range sensor."""

    power: float = 2.5
    force_noise: float = 0.006
    hum: float = 0.0
    late: float = 0.0
    bias: float = 0.0
    mass: float = 0.0
    knocked: float = 2.0
    step: float = 0.0
    early: float = 0.0
    jump: float = 0.0
    seed: int = 0

    touch: float = 12.0
    speed: float = 0.001
    depth: float = 0.006

    def way(self, t: FloatArray) -> FloatArray:
        """Return the tool's travel beyond the surface [m]; it starts at 2 s, in 0.1 s."""
        begun = np.maximum(t - 2.0, 0.0)
        ramp = np.where(begun < 0.1, 5.0 * begun**2, begun - 0.05)
        stop = 2.05 + (self.touch - 2.05) + self.depth / self.speed
        return self.speed * (np.minimum(ramp, stop - 2.05) - (self.touch - 2.05))

    def signals(self) -> tuple[Signal, Signal, Signal]:
        """Return force [N], of 100 N at most, tool height and displacement height [m]."""
        random = np.random.default_rng(self.seed)
        t = np.arange(0.0, 30.0, 0.004)
        force = 100.0 * (np.maximum(self.way(t), 0.0) / self.depth) ** self.power
        force += 100.0 * self.force_noise * random.standard_normal(t.size)
        force += 100.0 * self.hum * np.sin(2.0 * np.pi * 8.1 * t)
        force += 100.0 * self.step * (self.way(t) > 0.0)
        # The sample in which the tool touches is a mean.
        touching = (self.way(t) <= 0.0) & (self.way(t + 0.004) > 0.0)
        force += 100.0 * self.step * self.early * touching
        force += self.mass * 0.01 * ((t > self.knocked) & (t < self.knocked + 0.1))
        force += 100.0 * self.jump * (t > self.touch - 1.3)
        tt = np.arange(0.0, 30.0, 0.008)
        th = np.arange(0.0, 30.0, 0.0167)
        seen = np.maximum(self.way(th - self.late), 0.0)
        seen += self.bias * (seen > 0.0) + 25e-6 * random.standard_normal(th.size)
        return Signal(t, force), Signal(tt, 0.05 - self.way(tt)), Signal(th, seen)

    def off(self, *, seen: bool) -> float:
        """Return by how much the touch is found too low [m]."""
        force, tool, height = self.signals()
        return 0.05 - segment(force, tool, height if seen else None).contact_height


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('hum', [0.05, 0.08])
def test_a_touch_that_a_hum_hides_is_where_the_surface_starts_to_move(hum, seed) -> None:
    slow = Slow(hum=hum, seed=seed)
    assert abs(slow.off(seen=True)) < 3e-5
    assert abs(slow.off(seen=False)) > 2e-4


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('seen', [True, False])
def test_a_touch_that_is_felt_as_little_for_long_is_where_the_force_steps(seen, seed) -> None:
    """The force steps by four times its noise, and rises on only much later."""
    slow = Slow(power=8.0, step=0.025, touch=4.0, seed=seed)
    assert abs(slow.off(seen=seen)) < 3e-5


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('memory', [0.0, 0.9])
@pytest.mark.parametrize('lead', [0.02, 0.1, 0.6])
@pytest.mark.parametrize('rounded', [0.0, 0.05])
def test_the_touch_of_a_guarded_approach_is_not_the_start_of_the_push(
    rounded: float, lead: float, memory: float, seed: int
) -> None:
    """The tool slows down before the object, touches it, and pushes once it has felt that."""
    random = np.random.default_rng(seed)
    t = np.arange(0.0, 8.0, 0.002)
    knots = [0.0, 0.5, 1.5, 2.0, 2.0 + lead, 3.0 + lead, 9.0]
    way = [-10e-3, -10e-3, -0.1e-3, 0.0, 0.2e-3 * lead, 4e-3 + 0.2e-3 * lead, 4e-3 + 0.2e-3 * lead]
    x = np.interp(t, knots, way)
    speed = np.gradient(x, t)
    force = np.where(t > 2.0, 2000.0 * x + 3000.0 * speed, 0.0)
    white = random.standard_normal(t.size)
    noise = lfilter([math.sqrt(1.0 - memory**2)], [1.0, -memory], white)
    force += 0.03 * noise
    if rounded:
        force = np.round(force / rounded) * rounded
    found = segment(Signal(t, force), Signal(t, 0.05 - x))
    assert found.t_contact == pytest.approx(2.0, abs=0.01)
    assert found.push_speed == pytest.approx(4e-3, rel=0.02)
    assert found.depth == pytest.approx(x[-1], abs=5e-6)


FLOWING = Body(stiffness=28e3, c1=17e3, c2=8e5)
"""Its force jumps at the touch, and forgets the push within half a minute."""


def felt(t: FloatArray, x: FloatArray, noise: float, rounded: float, seed: int) -> Segmentation:
    """Return the phases of a way [m] beyond the surface of that object, felt with noise [N]."""
    force, _ = FLOWING.integrate(t, x)
    force += noise * np.random.default_rng(seed).standard_normal(t.size)
    if rounded:
        force = np.round(force / rounded) * rounded
    return segment(Signal(t, force), Signal(t, 0.05 - x))


NOISES = pytest.mark.parametrize(
    ('noise', 'rounded', 'seed'),
    [*((0.07, rounded, seed) for rounded in (0.0, 0.04) for seed in range(4)), (0.01, 0.1, 0)],
)


@NOISES
def test_the_touch_of_a_slow_first_step_is_where_the_force_jumps(noise, rounded, seed) -> None:
    """A fifth of the force of the fast step is reached late in the slow one."""
    t = np.arange(0.0, 30.0, 0.002)
    knots = [0.0, 0.3, 3.7, 17.7, 17.85, 30.0]
    x = np.interp(t, knots, [-2e-4, -2e-4, 1.5e-3, 1.5e-3, 3e-3, 3e-3])
    found = felt(t, x, noise, rounded, seed)
    assert found.t_contact == pytest.approx(0.7, abs=0.003)
    assert found.whole is not None
    assert found.whole.t_contact == found.t_contact
    assert not any('from the start' in warning for warning in found.warnings)


@pytest.mark.parametrize('seed', range(6))
@pytest.mark.parametrize('off', [0.0005, 0.0015, 0.0018])
@pytest.mark.parametrize(('noise', 'settling'), [(4e-7, 0.0), (1e-9, 9e-6)])
def test_steps_whose_force_is_forgotten_in_each_hold_begin_with_the_first(
    noise, settling, off, seed
) -> None:
    """Such a step is not the start of a tool with a mass: it rests, or settles, until the next."""
    t = np.arange(0.0, 22.0, 0.0005)
    starts = np.array([1.3035, 6.4 + off, 11.5 + off, 16.6 + off])
    # The last is the deepest, and its force the largest.
    way = np.repeat([0.0, 1.5e-3, 3e-3, 4.5e-3, 6.2e-3], 2)
    x = np.interp(t, [0.0, *np.stack((starts, starts + 0.1), axis=1).ravel(), 22.0], way)
    for start in starts:
        since = np.maximum(t - start - 0.1, 0.0)
        x += settling * -np.expm1(-since / 0.5)
    force, _ = Body(stiffness=5e3, c1=100.0, c2=2.5e3).integrate(t, x)
    random = np.random.default_rng(seed)
    force = force[::10] + 0.03 * random.standard_normal(t[::10].size)
    height = 0.05 - x[4::10] + noise * random.standard_normal(t[4::10].size)
    # Between two samples of the encoders the tool seems to start before it does.
    found = segment(Signal(t[::10], force), Signal(t[4::10], height))
    assert found.t_contact == pytest.approx(starts[0], abs=0.005)
    assert found.whole is not None
    assert found.whole.depth == pytest.approx(x[-1], abs=2e-5)


@NOISES
@pytest.mark.parametrize('gap', [0.0, 1e-5, 2e-5])
def test_a_tool_that_starts_softly_near_the_object_does_not_rest_on_it(
    gap, noise, rounded, seed
) -> None:
    """It takes a while at least jerk for less than a hundredth of its way."""
    t = np.arange(0.0, 20.0, 0.005)
    part = np.clip((t - 1.0) / 10.0, 0.0, 1.0)
    x = 3e-3 * part**3 * (10.0 - 15.0 * part + 6.0 * part**2) - gap
    found = felt(t, x, noise, rounded, seed)
    touch = t[np.argmax(x > 0.0)] if gap else 1.0
    # What rests on it shows no touch but that the tool has started, which it does softly.
    assert found.t_contact == pytest.approx(touch, abs=0.01 if gap else 0.3)
    assert any('from the start' in warning for warning in found.warnings) == (not gap)


def starts_softly(
    rest: float, cell: float, rounded: float, noise: float, seed: int
) -> Segmentation:
    """Return the phases of a push at least jerk by a tool that has rested on the object [s]."""
    t = np.arange(0.0, rest + 12.0, 0.001)
    part = np.clip((t - rest) / 4.3, 0.0, 1.0)
    x = 2.9e-3 * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    force, _ = Body(stiffness=46.6e3, c1=43e3, c2=64.5e3).integrate(t, x)
    random = np.random.default_rng(seed)
    force += cell * random.standard_normal(t.size)
    height = 0.05 - x[::2] + noise * random.standard_normal(t[::2].size)
    return segment(Signal(t, force), Signal(t[::2], rounded * np.round(height / rounded)))


@pytest.mark.parametrize('rest', [0.6, 1.5, 4.0, 20.0, 60.0])
@pytest.mark.parametrize(('rounded', 'noise', 'off'), [(1.1e-6, 0.0, 6e-7), (1e-9, 1e-5, 3e-6)])
@pytest.mark.parametrize('seed', range(3))
def test_what_a_tool_rests_on_is_where_it_rests_however_softly_it_starts(
    seed, rounded, noise, off, rest
) -> None:
    """Its load cell feels it start before its encoders show it, and both tell so."""
    found = starts_softly(rest, 0.047, rounded, noise, seed)
    assert any('from the start' in warning for warning in found.warnings)
    assert found.contact_height == pytest.approx(0.05, abs=off)
    assert found.force_zero == pytest.approx(0.0, abs=4.0 * found.force_zero_std)
    assert found.t_contact == pytest.approx(rest, abs=0.1)
    assert found.depth is not None
    assert found.t_hold is not None
    taken = found.t_hold - found.t_contact
    assert found.push_speed == pytest.approx(found.depth / taken, rel=1e-9)
    assert found.push_speed == pytest.approx(2.9e-3 / 4.3, rel=0.1)


@pytest.mark.parametrize('rest', [1.5, 4.0])
@pytest.mark.parametrize('seed', range(6))
def test_a_soft_start_is_felt_by_many_samples_of_a_noisy_load_cell(seed, rest) -> None:
    """Eight of them show it no earlier than the encoders do, by 0.19 s too late."""
    found = starts_softly(rest, 0.3, 1.1e-6, 0.0, seed)
    assert found.t_contact == pytest.approx(rest, abs=0.15)


def test_a_glitch_is_no_start() -> None:
    for seed in range(20):
        force = np.random.default_rng(seed).standard_normal(2000)
        force[-5] += 200.0
        assert _before_rise(force) == force.size


@pytest.mark.parametrize('part', [0.005, 0.01, 0.02])
def test_a_load_cell_that_shows_no_noise_is_as_sure_as_its_steps(part) -> None:
    """A Hertzian contact leaves the air slowly, and the cell shows parts of its peak."""
    t = np.arange(0.0, 20.0, 0.004)
    x = np.interp(t, [0.0, 2.0, 12.0], [-2e-3, -2e-3, 8e-3])
    step = part * 100.0
    force = step * np.round(100.0 / step * (np.maximum(x, 0.0) / 8e-3) ** 1.5)
    found = segment(Signal(t, force), Signal(t, 0.05 - x))
    assert found.t_contact == pytest.approx(4.0, abs=0.004)


@pytest.mark.parametrize(
    'range_sensor', [{'late': 0.3}, {'late': -0.3}, {'bias': 3e-4}, {'bias': -3e-4}]
)
def test_a_range_sensor_that_is_off_moves_no_touch_that_the_force_shows(range_sensor) -> None:
    """The force has risen before what is late, and has not where it is early."""
    sharp = Slow(power=1.0, **range_sensor)
    assert sharp.off(seen=True) == sharp.off(seen=False)
    assert abs(sharp.off(seen=True)) < 5e-5


@pytest.mark.parametrize('noise', [0.0005, 0.002])
@pytest.mark.parametrize('power', [1.5, 2.0])
@pytest.mark.parametrize('range_sensor', [{'late': 0.5}, {'bias': -5e-4}])
def test_a_force_that_grows_is_no_jump_of_the_zero(range_sensor, power, noise) -> None:
    """Beside a range sensor that sees the touch late: further on there is by much more force."""
    for seed in range(3):
        grows = Slow(power=power, force_noise=noise, seed=seed, **range_sensor)
        assert grows.off(seen=True) == grows.off(seen=False)


def test_a_force_that_grows_within_its_noise_is_rarely_a_jump_of_the_zero() -> None:
    """Which is to be clear; the few that are moved are taken for not to have risen at all."""
    moved = 0
    for seed in range(12):
        grows = Slow(power=1.5, force_noise=0.01, bias=-3e-4, seed=seed)
        moved += grows.off(seen=True) != grows.off(seen=False)
    assert moved <= 4


@pytest.mark.parametrize('blind', [2.2e-4, 3e-4])
@pytest.mark.parametrize('power', [1.0, 2.0])
def test_a_force_that_is_held_after_the_touch_is_no_jump_of_the_zero(power, blind) -> None:
    """A preload, of which the range sensor sees nothing."""
    t = np.arange(0.0, 16.0, 0.004)
    way = np.interp(t, [0.0, 1.0, 4.2, 6.2, 12.0, 16.0], [-3.0, -3.0, 0.2, 0.2, 6.0, 6.0])
    way *= 1e-3
    force = 100.0 * (np.maximum(way, 0.0) / 6e-3) ** power
    noise = np.random.default_rng(5).standard_normal(t.size)
    seen = np.maximum(way - blind, 0.0)[::4] + 2e-5 * noise[::4]
    tool = Signal(t, 0.05 - way)
    found = segment(Signal(t, force + 0.01 * noise), tool, Signal(t[::4], seen))
    assert found.contact_height == pytest.approx(0.05, abs=6e-5)
    assert found.force_zero == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize('seed', range(4))
@pytest.mark.parametrize('power', [1.0, 1.5])
def test_a_jump_of_the_zero_in_the_air_is_no_touch(power: float, seed: int) -> None:
    """The force of the load cell stays there until the object begins to move."""
    jumped = Slow(power=power, jump=0.008, force_noise=0.0015, seed=seed)
    assert abs(jumped.off(seen=True)) < 5e-5
    assert jumped.off(seen=False) < -1e-3
    force, tool, height = jumped.signals()
    assert segment(force, tool, height).force_zero == pytest.approx(0.8, abs=0.05)


@pytest.mark.parametrize('bias', [1e-4, 3e-4, 1e-3])
def test_a_force_that_jumps_at_the_touch_has_not_set_in_before(bias) -> None:
    """The sample of the jump is no force in the air, whatever the range sensor says."""
    jumps = Slow(power=1.0, step=0.8, early=0.4, bias=bias, force_noise=0.002)
    assert abs(jumps.off(seen=True)) < 5e-6


@pytest.mark.parametrize('seen', [True, False])
def test_the_tools_own_mass_is_no_touch(seen) -> None:
    """The load cell feels the tool speed up in the air: here by a third of the largest force."""
    heavy = Slow(power=1.0, mass=3500.0)
    assert abs(heavy.off(seen=seen)) < 5e-5


@pytest.mark.parametrize('seen', [True, False])
@pytest.mark.parametrize('touch', [2.3, 2.4, 2.7])
def test_a_knock_long_before_a_short_way_in_the_air_is_no_touch(touch, seen) -> None:
    """The tool waits for half of the time from the knock to the touch, or longer."""
    knocked = Slow(power=1.0, mass=3500.0, knocked=1.2, touch=touch)
    assert abs(knocked.off(seen=seen)) < 1e-4


@pytest.mark.parametrize('seed', range(4))
def test_the_tools_own_mass_is_no_touch_either_where_it_waits_on_its_way(seed) -> None:
    """It goes faster while the load cell feels its start than from then to the touch."""
    t = np.arange(0.0, 16.0, 0.004)
    begun = np.clip(t - 1.0, 0.0, 1.05)
    x = np.where(begun < 0.1, 0.05 * begun**2, 0.01 * begun - 5e-4) - 10.1e-3
    x += np.clip(t - 7.0, 0.0, 6.1) * 1e-3
    random = np.random.default_rng(seed)
    force = 100.0 * np.maximum(x, 0.0) / 6e-3 + 35.0 * ((t > 1.0) & (t < 1.1))
    force += 0.6 * random.standard_normal(t.size)
    found = segment(Signal(t, force), Signal(t, 0.05 - x + 1e-6 * random.standard_normal(t.size)))
    assert found.contact_height == pytest.approx(0.05, abs=1e-4)


@pytest.mark.parametrize(
    ('count', 'knocks', 'push'),
    [(200_000, [(0, 14, 2.0), (32, 46, 1.6)], 2.0), (400_000, [(0, 40, 20.0)], 0.5)],
)
def test_a_start_that_rings_at_a_high_rate_ends_the_search(count, knocks, push) -> None:
    """More than 68,000 samples are looked at in blocks; a knock may be the largest force."""
    random = np.random.default_rng(0)
    t = np.arange(count) / 20e3
    start, touch, stop = (share * t[-1] for share in (0.2, 0.5, 0.7))
    travel = 0.02 * (np.clip(t, start, stop) - start) + 1e-7 * random.standard_normal(count)
    force = push * np.clip((t - touch) / (stop - touch), 0.0, 1.0)
    force += 2e-3 * random.standard_normal(count)
    block = count // 4000
    begin = int(20e3 * start) // block * block + block + 1
    for first, last, height in knocks:
        inside = slice(begin + first, begin + last)
        force[inside] += height
    assert segment(Signal(t, force), Signal(t, 0.1 - travel)).t_contact is not None


def test_phases_do_not_depend_on_the_units_of_force_nor_on_its_zero() -> None:
    trial = measured('standard solid')
    found = segment(trial.force, trial.height)
    scaled = Signal(trial.force.t, 1e-3 * trial.force.value + 7.0)
    again = segment(scaled, trial.height)
    for a, b in (
        (found.t_contact, again.t_contact),
        (found.t_hold, again.t_hold),
        (found.t_release, again.t_release),
        (found.t_loss, again.t_loss),
    ):
        # The offset costs digits of the force: 7 N over 1e-5 N of noise.
        assert a == pytest.approx(b, abs=1e-3)


def test_phases_move_with_the_start_of_the_clock() -> None:
    trial = measured('hertz')
    found = segment(trial.force, trial.height)
    later = segment(
        Signal(trial.force.t + 1000.0, trial.force.value),
        Signal(trial.height.t + 1000.0, trial.height.value),
    )
    assert found.t_contact is not None and found.t_loss is not None
    assert later.t_contact == pytest.approx(found.t_contact + 1000.0, abs=1e-3)
    assert later.t_loss == pytest.approx(found.t_loss + 1000.0, abs=1e-3)


def test_too_few_samples_are_refused_in_a_sentence() -> None:
    few = Signal(np.arange(3.0), np.zeros(3))
    with pytest.raises(InputError, match='too few'):
        segment(few, few)


def test_a_height_in_millimetres_is_refused_in_a_sentence() -> None:
    taken = staircase()
    height = Signal(taken.height.t, 1e3 * taken.height.value)
    with pytest.raises(InputError, match='look like millimetres'):
        segment(taken.force, height)


def test_signals_of_different_times_are_refused_in_a_sentence() -> None:
    early = Signal(np.arange(20.0), np.zeros(20))
    late = Signal(np.arange(20.0) + 100.0, np.zeros(20))
    with pytest.raises(InputError, match='do not overlap'):
        segment(early, late)


def test_constant_signals_are_no_contact() -> None:
    t = np.arange(100.0)
    still = Signal(t, np.full(100, 0.1))
    found = segment(still, still)
    assert found.t_contact is None
    assert found.warnings


@pytest.mark.parametrize(
    'bad',
    [{'contact_sigmas': 0.0}, {'rest_slowdown': 1.0}, {'rest_band': 0.6}, {'loss_fraction': 0.0}],
)
def test_options_out_of_range_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(ValueError, match=r'.'):
        SegmentationOptions(**bad)


def test_a_higher_threshold_detects_the_contact_later() -> None:
    trial = measured('noise')
    eager, _ = run_online(trial)
    careful, _ = run_online(trial, SegmentationOptions(contact_sigmas=20.0))
    assert careful[0].detected_at > eager[0].detected_at


def test_online_ignores_samples_that_are_not_new() -> None:
    trial = measured('three-element with yield force')
    twice = Measured(**{name: getattr(trial, name) for name in Measured.__dataclass_fields__})
    once, _ = run_online(twice)
    segmenter = OnlineSegmenter()
    events: list[PhaseEvent] = []
    k = 0
    for t, value in zip(trial.force.t.tolist(), trial.force.value.tolist(), strict=True):
        while k < len(trial.height) and trial.height.t[k] <= t:
            sample = float(trial.height.t[k]), float(trial.height.value[k])
            events += segmenter.add_height(*sample)
            events += segmenter.add_height(*sample)
            k += 1
        events += segmenter.add_force(t, value)
        events += segmenter.add_force(t - 1e-3, value + 1.0)
    assert events == once


def test_online_memory_does_not_grow_with_the_record() -> None:
    segmenter = OnlineSegmenter()
    sizes = []
    rng = np.random.default_rng(0)
    for i, noise in enumerate(rng.standard_normal(150_000).tolist()):
        segmenter.add_force(1e-3 * i, 0.01 * noise)
        if i in (20_000, 149_999):
            sizes.append(len(pickle.dumps(segmenter)))
    # The history gains a level of 128 entries at most with each doubling of the record.
    assert sizes[1] < 1.5 * sizes[0]


def drawn(number: int) -> Case:
    """Draw a trial from the ranges that the segmentation is for; the same for a number."""
    rng = np.random.default_rng(number)

    def between(low: float, high: float) -> float:
        return float(rng.uniform(low, high))

    speed = 10.0 ** between(-4.0, math.log10(50e-3))
    depth = 10.0 ** between(math.log10(2e-4), math.log10(30e-3))
    force = 10.0 ** between(-2.0, math.log10(500.0))
    push = depth / speed
    relaxation_time = 10.0 ** between(math.log10(0.5), 2.0)
    power = float(rng.choice([1.0, 1.5]))
    share = between(0.2, 0.9)
    stiffness = force / depth**power
    body = Body(
        (1.0 - share) * stiffness,
        power,
        share * stiffness,
        relaxation_time,
        # A pull within the band of the noise, six standard deviations, cannot be told from none.
        adhesion=float(rng.choice([0.0, 0.2])) * force,
    )
    # At least 20 samples of either signal in the push, as a person would set the rate.
    rate = min(1000.0, max(between(1.0, 4.0) * 20.0 / push, 0.4))
    hold = max(0.6 * push, between(0.5, 3.0) * relaxation_time, 20.0 / rate)
    return Case(
        body,
        speed=speed,
        depth=depth,
        return_speed=speed * between(0.5, 5.0),
        wait=between(20.0, 60.0) / rate,
        air=between(0.3, 3.0) * depth,
        hold=hold,
        recover=max(hold, push, 40.0 / rate),
        force_rate=rate,
        height_rate=rate * between(0.5, 1.0),
        snr=between(100.0, 3000.0),
        offset=between(-1.0, 1.0) * force,
        seed=int(rng.integers(0, 10**6)),
    )


@pytest.mark.parametrize('number', range(50))
def test_any_trial_in_range_is_segmented_within_the_bounds(number: int) -> None:
    case = drawn(number)
    trial = simulate(case)
    found: Segmentation = segment(trial.force, trial.height)
    assert found.t_contact is not None
    assert abs(found.t_contact - trial.t_contact) <= 1.5 * contact_bound(case, trial)
    assert found.t_hold is not None and found.t_release is not None
    assert abs(found.t_hold - trial.t_hold) <= 0.3 / case.height_rate
    # The samples sit at any phase of a withdrawal up to five times as fast as the push.
    assert abs(found.t_release - trial.t_release) <= 0.5 / case.height_rate
    assert found.t_loss is not None and trial.t_loss is not None
    hidden = 3.0 * trial.loss_blur
    assert abs(found.t_loss - trial.t_loss) <= max(3.0 / case.force_rate, hidden)
    events, _ = run_online(trial)
    assert [event.kind for event in events] == ['contact', 'hold', 'release', 'loss']
