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
What kind of object a trial shows: elastic, viscoelastic, plastic or rheological.

Section 2.1 of the paper names three properties that an object shows once it is released, in its
Fig. 1: a residual deformation that stays, a bouncing deformation that comes back, and vibrations
that decrease. A rheological object has all three. The other kinds are those of Fig. 1's
neighbours, which lack one:

============  ========  ======  ==================
kind          residual  bounce  vibration decays
============  ========  ======  ==================
elastic       no        yes     no
viscoelastic  no        yes     yes
plastic       yes       no      not asked
rheological   yes       yes     yes
============  ========  ======  ==================

Each property is a size with an error. It is there where its interval of confidence lies above what
counts, absent where the interval lies below, and unknown where it reaches across. What counts is a
share of what was pressed in, and at least what the sensor resolves.

Where the paper leaves gaps
---------------------------
- It says neither from which size on a deformation remains, nor how long to wait for it to come
  back. Here 2 % counts, and the limit of eq. (10) is what remains; the part of it that no sample
  has seen counts as an error.
- A body with residual and bounce whose vibration does not decay (a spring on a slider without
  viscosity) has no name: it stays unknown.
- Most objects creep back without any vibration (they are overdamped), and a range sensor sees
  none above half its frame rate. A vibration decays in every body that loses energy, so that
  three signs are taken for the third property: a decaying vibration of the height after release, a
  free height that creeps, a force that relaxes in the hold. A body that shows none of them, looked
  at both in hold and recovery, counts as one whose vibration would not decay.
- The kind is one of the trial. Below its yield force a rheological object is viscoelastic, and one
  that is held for many relaxation times may have no bounce left, and is plastic.

"""

from dataclasses import dataclass, replace
import math
from typing import Final, Literal

from hapticvision_ros.core.fit.exponential import ExponentialFit, MIN_SAMPLES
from hapticvision_ros.core.fit.least_squares import covariance, minimise
from hapticvision_ros.core.fit.paper import fit_paper, PaperResult
from hapticvision_ros.core.fit.release import pressed_in, start_of_recovery
from hapticvision_ros.core.fit.uncertainty import least_squares_covariance
from hapticvision_ros.core.records import Estimate, FloatArray, Segmentation, Signal, Trial
import numpy as np
from numpy.typing import NDArray

type Kind = Literal['elastic', 'viscoelastic', 'plastic', 'rheological']

SHARE: Final = 0.02
"""Share of the deformation from which on a part of it counts."""
_SIGMAS: Final = 2.576
"""Half the width of an interval of 99 % confidence, in standard errors."""
_MOST_SAMPLES: Final = 1024
"""Samples after the release that are looked at for a vibration."""
_FEWEST_CYCLES: Final = 4.0
"""Less than this is not told from a creep that is no single exponential."""
_FEWEST_PER_CYCLE: Final = 2.5
_STRONGEST_DECAY: Final = 2.0
"""Logarithmic decrement from which on nothing swings."""
_CREEPS: Final = np.array([1.5, 0.5, 0.15, 0.05])
"""Time constants of the smooth part, in durations of the record."""
_DECREMENTS: Final = (0.0, 0.03, 0.1, 0.3, 1.0)
_PARTS: Final = 10
"""Of these the last tells how far the height is when the record ends."""
_CHUNKS: Final = 8
_ROUNDING: Final = 1e-24
"""Least variance of a sample [m^2]: a picometre."""
_FAR_BEYOND_CHANCE: Final = 50.0
"""Drop of the squares over the noise that no search over a few thousand frequencies makes."""


@dataclass(frozen=True, slots=True)
class Property:
    """
    One property of an object.

    Parameters
    ----------
    present : bool or None
        Whether it is there; None where the trial cannot tell.
    size : Estimate
        Residual and bounce [m]; what is lost of a vibration in a cycle, or of force or bounce
        where it creeps [-].
    threshold : float
        The size from which on it counts, in the same unit.
    reason : str
        What was seen, or why the trial cannot tell.

    """

    present: bool | None
    size: Estimate
    threshold: float
    reason: str


@dataclass(frozen=True, slots=True)
class Classification:
    """
    The kind of an object in one trial.

    Parameters
    ----------
    kind : Kind or None
        None where it is unknown.
    residual, bounce, decay : Property
        The three properties; `decay` is that vibrations decrease.
    reason : str
        Why it is this kind, or why it is unknown.

    """

    kind: Kind | None
    residual: Property
    bounce: Property
    decay: Property
    reason: str


@dataclass(frozen=True, slots=True)
class Vibration:
    """
    A decaying vibration of the free height.

    Parameters
    ----------
    frequency : float
        [Hz].
    decrement : Estimate
        Logarithmic decrement: what a cycle takes from the logarithm of the amplitude [-].
    cosine, sine : float
        Its two amplitudes at the time `origin` [m].
    origin : float
        The first sample after the loss of contact [s].

    """

    frequency: float
    decrement: Estimate
    cosine: float
    sine: float
    origin: float

    def __call__(self, t: FloatArray) -> FloatArray:
        """Return the swing at times `t` [s] from the origin on [m]."""
        turns = self.frequency * (t - self.origin)
        decay = np.exp(-(self.decrement.value or 0.0) * turns)
        angle = 2.0 * math.pi * turns
        swing = self.cosine * np.cos(angle) + self.sine * np.sin(angle)
        return np.asarray(decay * swing, dtype=np.float64)


def classify(trial: Trial, segmentation: Segmentation, share: float = SHARE) -> Classification:
    """
    Tell what kind of object a trial shows.

    Parameters
    ----------
    trial : Trial
        What was measured.
    segmentation : Segmentation
        Its phases.
    share : float
        Share of the deformation from which on a part of it counts.

    Returns
    -------
    Classification
        The kind with its three properties; unknown, with the reason, where the trial lacks a phase
        or its noise hides which side of the threshold a property is on.

    References
    ----------
    Paper, section 2.1 with Fig. 1 and eqs. (1)-(3).

    """
    pressed = math.nan, math.inf
    if segmentation.t_release is not None:
        pressed = pressed_in(trial, segmentation, segmentation.t_release)
    free, why = _free_height(trial, segmentation)
    vibration = None if free is None else find_vibration(free)
    if free is not None and vibration is not None:
        # What is left is the creep that eq. (10) describes.
        still = Signal(free.t, free.value - vibration(free.t))
        trial = replace(trial, displacement_height=_continued(trial, still))
    paper = fit_paper(trial, segmentation)
    residual, bounce = _deformations(trial, segmentation, paper, free, why, pressed, share)
    decay = _decay(paper, vibration, pressed[0], share)
    kind, reason = _kind(residual, bounce, decay)
    return Classification(kind, residual, bounce, decay, reason)


def find_vibration(height: Signal) -> Vibration | None:
    """
    Find a vibration that starts with a record and decays, or does not, beside a smooth creep.

    Parameters
    ----------
    height : Signal
        The displacement height from the loss of contact on [m].

    Returns
    -------
    Vibration or None
        The strongest, if it is far beyond what noise with memory makes; its errors hold that
        memory. None too where it is slower than four cycles in the record or faster than the
        samples can follow.

    """
    count = min(len(height), _MOST_SAMPLES)
    if count < 2 * MIN_SAMPLES:
        return None
    origin = float(height.t[0])
    t = height.t[:count] - origin
    y = height.value[:count] - height.value[:count].mean()
    span = float(t[-1])
    interval = float(np.median(np.diff(t)))
    slowest, fastest = _FEWEST_CYCLES / span, 1.0 / (_FEWEST_PER_CYCLE * interval)
    if slowest >= fastest or not y.any():
        return None
    smooth = np.exp(-np.outer(t, [0.0, *(1.0 / (_CREEPS * span))]))
    basis = np.linalg.qr(smooth).Q
    best, decrement, frequency = 0.0, 0.0, slowest
    for some in np.array_split(np.arange(slowest, fastest, 0.5 / span), _CHUNKS):
        turns = np.outer(t, some)
        wave = np.exp(2j * math.pi * turns)
        for tried in _DECREMENTS if some.size else ():
            gains = _gains(y, basis, np.exp(-tried * turns) * wave)
            if gains.max() > best:
                best, decrement, frequency = float(gains.max()), tried, float(some[gains.argmax()])
    return _polished(t, y, smooth, frequency, decrement, origin)


def _gains(y: FloatArray, basis: FloatArray, wave: NDArray[np.complex128]) -> FloatArray:
    """Return by how much the wave of each column lowers the squares."""
    wave = wave - basis @ (basis.T @ wave)
    cosine, sine = wave.real, wave.imag
    cc = np.sum(cosine**2, axis=0)
    ss = np.sum(sine**2, axis=0)
    cs = np.sum(cosine * sine, axis=0)
    c, s = y @ cosine, y @ sine
    with np.errstate(divide='ignore', invalid='ignore'):
        gain = (ss * c * c - 2.0 * cs * c * s + cc * s * s) / (cc * ss - cs * cs)
    return np.asarray(np.nan_to_num(gain), dtype=np.float64)


def _polished(
    t: FloatArray,
    y: FloatArray,
    smooth: FloatArray,
    frequency: float,
    decrement: float,
    origin: float,
) -> Vibration | None:
    """Return the vibration of least squares near a start, unless noise would do."""
    omega, rate = 2.0 * math.pi * frequency, decrement * frequency

    def waves(omega: float, rate: float) -> FloatArray:
        decay = np.exp(-rate * t)
        return np.stack((decay * np.cos(omega * t), decay * np.sin(omega * t)), axis=1)

    columns = np.hstack((smooth, waves(omega, rate)))
    start = np.linalg.lstsq(columns, y, rcond=None)[0]

    def model(theta: FloatArray) -> tuple[FloatArray, FloatArray]:
        wave = waves(theta[-2], theta[-1])
        a, b = theta[-4], theta[-3]
        swing = wave @ theta[-4:-2]
        by_omega = t * (b * wave[:, 0] - a * wave[:, 1])
        jacobian = np.column_stack((smooth, wave, by_omega, -t * swing))
        return smooth @ theta[:-4] + swing - y, jacobian

    lower = np.full(start.size + 2, -np.inf)
    upper = np.full(start.size + 2, np.inf)
    lower[-2] = 2.0 * math.pi * _FEWEST_CYCLES / t[-1]
    upper[-2] = 2.0 * omega
    lower[-1], upper[-1] = -1.0 / t[-1], 2.0 * _STRONGEST_DECAY * frequency
    solution = minimise(model, np.append(start, [omega, rate]), (lower, upper))
    theta, residual = solution.theta, solution.residual
    freedom = t.size - theta.size
    omega, rate = float(theta[-2]), float(theta[-1])
    # The noise has a memory: what counts is its power at the frequency of the vibration, and at
    # least that of white noise, since its memory need not be that of one time constant.
    memory = float(residual[1:] @ residual[:-1]) / max(float(residual @ residual), 1e-300)
    memory = min(max(memory, 0.0), 0.99)
    phase = omega * float(np.median(np.diff(t)))
    colour = (1.0 - memory**2) / (1.0 - 2.0 * memory * math.cos(phase) + memory**2)
    noise = max(float(residual @ residual) / freedom * max(colour, 1.0), _ROUNDING)
    without = y - smooth @ np.linalg.lstsq(smooth, y, rcond=None)[0]
    drop = float(without @ without) - float(residual @ residual)
    if (
        drop < _FAR_BEYOND_CHANCE * noise
        or omega <= lower[-2]
        or rate > _STRONGEST_DECAY * omega / (2.0 * math.pi)
    ):
        return None
    spread = noise * covariance(solution.jacobian)[-2:, -2:]
    # Decrement: rate over frequency, 2 pi rate / omega.
    gradient = 2.0 * math.pi * np.array([-rate / omega**2, 1.0 / omega])
    return Vibration(
        frequency=omega / (2.0 * math.pi),
        decrement=Estimate(
            2.0 * math.pi * rate / omega, math.sqrt(float(gradient @ spread @ gradient))
        ),
        cosine=float(theta[-4]),
        sine=float(theta[-3]),
        origin=origin,
    )


def _free_height(trial: Trial, phases: Segmentation) -> tuple[Signal | None, str]:
    """Return the height from the loss of contact on, or None and why there is none."""
    if phases.t_release is None:
        return None, phases.unreleased
    height = trial.displacement_height
    if height is None:
        return None, 'the displacement height was not recorded'
    start, caution = start_of_recovery(trial, phases, phases.t_release)
    if start is None:
        return None, caution
    free = height.between(start, phases.t_end)
    if len(free) < MIN_SAMPLES:
        return None, f'the recovery has only {len(free)} samples of the displacement height'
    return free, ''


def _continued(trial: Trial, free: Signal) -> Signal:
    """Return the height with another free part."""
    height = trial.displacement_height
    if height is None:
        return free
    before = height.between(-math.inf, float(free.t[0]))
    return Signal(np.append(before.t, free.t), np.append(before.value, free.value))


def _deformations(
    trial: Trial,
    phases: Segmentation,
    paper: PaperResult,
    free: Signal | None,
    why: str,
    pressed: tuple[float, float],
    share: float,
) -> tuple[Property, Property]:
    """Return residual and bounce."""
    depth, depth_std = pressed
    if free is None or not depth > 0.0:
        reason = why or 'nothing was pressed in'
        nothing = Property(None, Estimate.unknown(reason), math.nan, reason)
        return nothing, nothing
    zero, zero_std = _height_zero(trial, phases)
    steps = np.abs(np.diff(free.value))
    resolution = float(np.min(steps, where=steps > 0.0, initial=math.inf))
    threshold = max(share * depth, resolution if math.isfinite(resolution) else 0.0)
    limit, fit = paper.H_inf, paper.recovery_fit
    if limit.value is None or limit.std is None or fit is None:
        reason = limit.reason or 'the recovery has no limit'
        late = np.array_split(free.value, _PARTS)[-1]
        seen = depth + zero - float(late.mean())
        error = math.hypot(depth_std, zero_std, float(late.std()))
        present = _judged(seen, error, threshold) or None
        text = f'at least {_mm(seen, error)} came back' if present else reason
        return (
            Property(None, Estimate.unknown(reason), threshold, reason),
            Property(present, Estimate.unknown(reason), threshold, text),
        )
    unseen = abs(float(fit(np.array([fit.stop]))[0]) - fit.offset)
    stays = limit.value - zero
    stays_std = math.hypot(limit.std, zero_std, unseen)
    back, back_std = depth - stays, math.hypot(depth_std, stays_std)
    return (
        Property(
            _judged(stays, stays_std, threshold),
            Estimate(stays, stays_std),
            threshold,
            f'{_mm(stays, stays_std)} of {1e3 * depth:.3g} mm stay',
        ),
        Property(
            _judged(back, back_std, threshold),
            Estimate(back, back_std),
            threshold,
            f'{_mm(back, back_std)} of {1e3 * depth:.3g} mm come back',
        ),
    )


def _height_zero(trial: Trial, phases: Segmentation) -> tuple[float, float]:
    """Return what the height reads before contact, and the standard error of that [m]."""
    height = trial.displacement_height
    if height is None or phases.t_contact is None:
        return 0.0, 0.0
    before = height.between(-math.inf, phases.t_contact).value
    if before.size < MIN_SAMPLES:
        return 0.0, 0.0
    mean = float(before.mean())
    spread = least_squares_covariance(np.ones((before.size, 1)), (before - mean,))
    return mean, math.sqrt(float(spread[0, 0]))


def _decay(
    paper: PaperResult, vibration: Vibration | None, depth: float, share: float
) -> Property:
    """Return whether vibrations decay."""
    if vibration is not None:
        lost, error = vibration.decrement.value or 0.0, vibration.decrement.std or math.inf
        return Property(
            _judged(lost, error, share),
            vibration.decrement,
            share,
            f'the free height swings at {vibration.frequency:.3g} Hz and loses '
            f'{100.0 * lost:.2g} ± {100.0 * error:.2g} % of its amplitude in a cycle',
        )
    signs = (
        _sign(paper.recovery_fit, depth, paper.H_inf.reason, 'the free height creeps by'),
        _sign(paper.hold_fit, None, paper.F_inf.reason, 'the force relaxes in the hold by'),
    )
    judged = [
        None if size.value is None else _judged(size.value, size.std or 0.0, share)
        for size, _ in signs
    ]
    for seen, (size, text) in zip(judged, signs, strict=True):
        if seen:
            return Property(True, size, share, text)
    text = '; '.join(text for _, text in signs)
    if judged != [False, False]:
        return Property(None, Estimate.unknown(text), share, text)
    return Property(False, max((size for size, _ in signs), key=_size), share, text)


def _size(estimate: Estimate) -> float:
    return abs(estimate.value or 0.0)


def _sign(
    fit: ExponentialFit | None, whole: float | None, why: str | None, what: str
) -> tuple[Estimate, str]:
    """Return how much of the whole a decay takes, and say so; the whole is its start if None."""
    if fit is None:
        reason = why or 'nothing was recorded'
        return Estimate.unknown(reason), reason
    drop, std = fit.drop if fit.amplitude != 0.0 else (fit.slide, fit.slide_std)
    start = abs(float(fit(np.array([fit.start]))[0])) if whole is None else whole
    if not start > 0.0:
        return Estimate.unknown('nothing was pressed'), 'nothing was pressed'
    size, error = drop / start, std / start
    return Estimate(size, error), f'{what} {100.0 * size:.2g} ± {100.0 * error:.2g} %'


def _judged(value: float, std: float, threshold: float) -> bool | None:
    """Return on which side of a threshold a value is; None where its error reaches across."""
    if value - _SIGMAS * std > threshold:
        return True
    if value + _SIGMAS * std < threshold:
        return False
    return None


def _kind(residual: Property, bounce: Property, decay: Property) -> tuple[Kind | None, str]:
    """Return the kind by the table, and why."""
    if bounce.present is None:
        return None, f'whether anything comes back is open: {bounce.reason}'
    if residual.present is None:
        return None, f'whether anything stays is open: {residual.reason}'
    if not bounce.present:
        if residual.present:
            return 'plastic', f'{residual.reason}, and nothing comes back'
        return None, 'nothing stays and nothing comes back: nothing was pressed in'
    if decay.present is None:
        pair = 'rheological or none of the four' if residual.present else 'elastic or viscoelastic'
        return None, f'{pair}: whether a vibration decays is open: {decay.reason}'
    if not residual.present:
        return (
            ('viscoelastic', f'all comes back; {decay.reason}')
            if decay.present
            else ('elastic', f'all comes back, and no energy is lost: {decay.reason}')
        )
    if decay.present:
        return 'rheological', f'{residual.reason}; {bounce.reason}; {decay.reason}'
    return None, (
        'a part stays and a part comes back, but no energy is lost: none of the four kinds of the '
        f'paper ({decay.reason})'
    )


def _mm(value: float, std: float) -> str:
    return f'{1e3 * value:.3g} ± {1e3 * std:.2g} mm'
