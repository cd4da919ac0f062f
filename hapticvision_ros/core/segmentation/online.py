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

"""The phases of a running trial, sample by sample."""

from collections import deque

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.core.segmentation.contact import fit_start, locate_touch
from hapticvision_ros.core.segmentation.events import (
    EventKind,
    PhaseEvent,
    PhaseName,
    SegmentationOptions,
)
from hapticvision_ros.core.segmentation.fits import fit_onset, fit_stop
import numpy as np

_PER_LEVEL = 64
_LEVELS = 16
_WARM_UP = 8
_FAR = 8
_BASELINE_SAMPLES = 20000.0
_RISE = 6.0
_LAG = 512
_FEW = 64
_FIRST_FITTED = 6
# For a normal distribution, of third differences of variance 20.
_MEAN_BEND_TO_STD = 0.28025
# White noise over its running median of three, in standard deviations.
_MEDIAN_OF_3 = 1.49
_NOISE_SAMPLES = 4096.0
_DEFAULTS = SegmentationOptions()


class _History:
    """
    The past of a signal in bounded memory: single samples of late, ever longer means before.

    Each level keeps the newest `_PER_LEVEL` to twice as many entries, each the mean of two of the
    level below; so an event that is seen late is still resolved to a fixed fraction of the delay.
    """

    def __init__(self) -> None:
        self._levels: list[list[tuple[float, float]]] = [[] for _ in range(_LEVELS)]

    def push(self, t: float, value: float) -> None:
        """Append a sample."""
        newest = self._levels[0]
        newest.append((t, value))
        if len(newest) >= 2 * _PER_LEVEL:
            self._spill()

    def _spill(self) -> None:
        """Halve the resolution of the older half of each level that is full."""
        for level, entries in enumerate(self._levels):
            if len(entries) < 2 * _PER_LEVEL:
                return
            old = entries[:_PER_LEVEL]
            del entries[:_PER_LEVEL]
            if level + 1 < _LEVELS:
                self._levels[level + 1] += [
                    (0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1]))
                    for a, b in zip(old[::2], old[1::2], strict=True)
                ]

    def arrays(self) -> tuple[FloatArray, FloatArray]:
        """Return times and values, oldest first."""
        rows = np.array([entry for level in reversed(self._levels) for entry in level])
        return rows[:, 0].copy(), rows[:, 1].copy()


class _Stream:
    """One signal: spikes removed by a median of three, a running scale of its noise."""

    def __init__(self) -> None:
        self.history = _History()
        self.count = 0
        self.t = 0.0
        self.value = 0.0
        self.step = 0.0
        self._raw: tuple[tuple[float, float], tuple[float, float]] | None = None
        self._last: tuple[float, float] | None = None
        self._near: deque[float] = deque(maxlen=4)
        self._far: deque[float] = deque(maxlen=3 * _FAR + 1)
        self._bend = 0.0
        self._far_bend = 0.0

    @property
    def noise(self) -> float:
        """
        Return the standard deviation of a sample, from the mean size of its third differences.

        Those of neighbours, and of samples further apart, for noise that is correlated; but not
        many times larger, for that is the signal.
        """
        return _MEAN_BEND_TO_STD * max(self._bend, min(self._far_bend, 6.0 * self._bend))

    def add(self, t: float, value: float) -> bool:
        """Take a sample; return whether one (the sample before it) has become final."""
        if self._last is None:
            self._last = (t, value)
            return False
        if t <= self._last[0]:
            return False
        self._learn_noise(value)
        if self._raw is None:
            self._raw = ((self._last), (t, value))
            self._accept(*self._last)
            self._last = (t, value)
            return True
        before = self._raw[0][1]
        now_t, now = self._last
        low, high = (before, now) if before < now else (now, before)
        middle = low if value < low else high if value > high else value
        self._raw = ((now_t, now), (t, value))
        self._last = (t, value)
        self._accept(now_t, middle)
        return True

    def _learn_noise(self, value: float) -> None:
        """Follow the size of the third differences of neighbouring raw samples."""
        near, n = self._near, self.count
        near.append(value)
        if n < 3:
            return
        bend = abs(value - near[0] + 3.0 * (near[1] - near[2]))
        # A spike is no noise: one difference counts for no more than four usual ones.
        if n > 16 and bend > 4.0 * self._bend > 0.0:
            bend = 4.0 * self._bend
        self._bend += (bend - self._bend) * max(1.0 / (n - 2), 1.0 / _NOISE_SAMPLES)

    def _accept(self, t: float, value: float) -> None:
        if self.count:
            self.step += (t - self.t - self.step) * max(1.0 / self.count, 0.01)
        self.count += 1
        self.t, self.value = t, value
        far = self._far
        far.append(value)
        if self.count > _FEW:
            bend = _MEDIAN_OF_3 * abs(value - far[0] + 3.0 * (far[_FAR] - far[2 * _FAR]))
            # Those of neighbours count as the first half of the past.
            rate = max(1.0 / (self.count - _FEW // 2), 1.0 / _NOISE_SAMPLES)
            self._far_bend += (bend - self._far_bend) * rate
        else:
            self._far_bend = self._bend
        self.history.push(t, value)


class OnlineSegmenter:
    """
    Find the phases of a trial while it runs, from samples as they come.

    Parameters
    ----------
    options : SegmentationOptions
        What counts as an event.

    Notes
    -----
    Over the tests' table of conditions it agrees with `segment`: T_s and T_e within a sample of
    the height or twice the jitter over the speed; T_c within five samples of the force or eight
    times the travel over which the force hides in its noise; t_loss within three samples or four
    times the time over which it does. It sees T_c, T_s and T_e within 30, 15 and 10 % of the
    duration of the push and eight samples more.

    Not seen online: a contact in a record that starts in the hold, and that what the load cell
    feels is only the tool's own mass as it starts, or a knock on its way. A withdrawal that keeps
    a force counts as a loss once the force stands still, which `segment` may place later.

    Memory is bounded, and a sample costs a constant number of operations; the sample that shows
    an event costs a fit of about a millisecond more, of some ten where stamps are uncertain.
    Force and height may come at different rates and interleave in any order; a sample that is not
    newer than the last of its kind is ignored.

    """

    def __init__(self, options: SegmentationOptions = _DEFAULTS) -> None:
        self._options = options
        self._force = _Stream()
        self._height = _Stream()
        self._phase: PhaseName = 'approach'
        self._baseline = 0.0
        self._drift = 0.0
        self._mean = 0.0
        self._followed = 0
        self._latest: deque[tuple[float, float]] = deque(maxlen=_LAG + 1)
        self._lowest = 0.0
        self._t_baseline = 0.0
        self._first = 0.0
        self._fast = 0.0
        self._over = 0
        self._x_first = 0.0
        self._moving_from_start = False
        self._peak = 0.0
        self._force_noise = 0.0
        self._t_contact = 0.0
        self._x_contact = 0.0
        self._top = 0.0
        self._t_top = 0.0
        self._anchor = (0.0, 0.0)
        self._band = 0.0
        self._pushed = (0.0, 0.0)
        self._level = 0.0
        self._held = 0
        self._t_hold = 0.0
        self._away = 0
        self._t_release = 0.0
        self._still = (0.0, 0.0)

    @property
    def phase(self) -> PhaseName:
        """Return the phase that the trial is in, as far as the samples show."""
        return self._phase

    @property
    def force_zero(self) -> float:
        """Return the load cell's reading without contact [N], as known so far."""
        return self._baseline

    def add_force(self, t: float, value: float) -> tuple[PhaseEvent, ...]:
        """
        Take a sample of the contact force.

        Parameters
        ----------
        t : float
            Time of the sample [s].
        value : float
            Force [N], positive in compression.

        Returns
        -------
        tuple of PhaseEvent
            What this sample shows, mostly nothing.

        """
        if not self._force.add(t, value):
            return ()
        force = self._force
        if self._phase == 'approach':
            return self._watch_contact(t)
        if force.value - self._baseline > self._peak:
            self._peak = force.value - self._baseline
        if self._phase == 'release':
            return self._watch_loss(t)
        return ()

    def add_height(self, t: float, value: float) -> tuple[PhaseEvent, ...]:
        """
        Take a sample of the tool's height.

        Parameters
        ----------
        t : float
            Time of the sample [s].
        value : float
            Height of the tool tip [m].

        Returns
        -------
        tuple of PhaseEvent
            What this sample shows, mostly nothing.

        """
        if not self._height.add(t, -value):
            return ()
        height = self._height
        if height.count == 1:
            self._x_first = height.value
        elif height.count == _WARM_UP:
            away = abs(height.value - self._x_first)
            self._moving_from_start = away > 5.0 * height.noise + 1e-12
        if self._phase == 'push':
            return self._watch_hold(t)
        if self._phase == 'hold':
            return self._watch_release(t)
        return ()

    def _event(self, kind: EventKind, t: float, now: float) -> tuple[PhaseEvent, ...]:
        phases: dict[EventKind, PhaseName] = {
            'contact': 'push',
            'hold': 'hold',
            'release': 'release',
            'loss': 'recover',
            'step': 'push',
        }
        self._phase = phases[kind]
        return (PhaseEvent(kind, t, now),)

    def _watch_contact(self, now: float) -> tuple[PhaseEvent, ...]:
        force, options = self._force, self._options
        if force.count == 1:
            self._baseline = self._fast = self._first = self._mean = force.value
            self._lowest = force.value
            self._t_baseline = force.t
            self._followed = 1
            return ()
        # The baseline is a straight line through all of the past but the latest quarter, so that
        # an onset has time to stand out; in Holt's recursive form, with the gains of least
        # squares, and the far past forgotten slowly.
        self._latest.append((force.t, force.value))
        expected = self._mean
        if self._followed > _FEW:
            expected = self._baseline + self._drift * (force.t - self._t_baseline)
        self._fast += (force.value - self._fast) * 0.5
        excess = self._fast - expected
        self._lowest = min(self._lowest, self._fast)
        limit = options.contact_sigmas * force.noise + 1e-9 * abs(self._baseline)
        if force.count < _FEW:
            limit *= 3.0
        # Nothing is touched by a tool that rests: what the force does until then is its noise.
        height = self._height
        resting = height.count > _WARM_UP and not self._moving_from_start
        resting &= abs(height.value - self._x_first) <= 5.0 * height.noise + 1e-12
        if (excess < 0.5 * limit or force.count < _WARM_UP or resting) and (
            len(self._latest) > min(force.count // 4, _LAG)
        ):
            self._follow(*self._latest.popleft())
        over = excess > limit and self._fast - self._lowest > limit
        # A force that rises from the first sample is itself the line.
        rises = self._moving_from_start and self._fast - self._first > _RISE * limit
        self._over = self._over + 1 if (over or rises) and not resting else 0
        if self._over < 3 or self._height.count < 3:
            return ()
        t, f = force.history.arrays()
        tx, x = self._height.history.arrays()
        line = np.full_like(t, self._first if rises else self._mean)
        if self._followed > _FEW and not rises:
            line = self._baseline + self._drift * (t - self._t_baseline)
        quiet = np.flatnonzero(f - line <= 0.5 * limit)
        low = int(quiet[-1]) if quiet.size else 0
        touch = locate_touch(t, f, tx, x, self._height.noise, low, f.size - 1)
        t_contact = touch.t
        self._baseline = touch.zero if touch.zero is not None else 0.0
        self._t_contact = t_contact
        self._x_contact = touch.travel(tx, x)
        self._peak = float(f[-1]) - self._baseline
        # From here on the force itself bends.
        self._force_noise = self._force.noise
        self._start_push(float(tx[-1]), float(x[-1]), t_contact, self._x_contact)
        return self._event('contact', t_contact, now)

    def _follow(self, t: float, value: float) -> None:
        """Take a sample into the baseline."""
        self._followed += 1
        n = min(float(self._followed), _BASELINE_SAMPLES)
        self._mean += (value - self._mean) / n
        expected = self._baseline + self._drift * (t - self._t_baseline)
        error = value - expected
        self._baseline = expected + error * (4.0 * n - 2.0) / (n * (n + 1.0))
        self._drift += error * 6.0 / (n * (n + 1.0)) / max(self._force.step, 1e-12)
        self._t_baseline = t

    def _start_push(self, t: float, x: float, t_from: float, x_from: float) -> None:
        self._top, self._t_top = x, t
        self._anchor = (t, x)
        self._band = 0.0
        self._pushed = (max(x - x_from, 0.0), max(t - t_from, 0.0))

    def _watch_hold(self, now: float) -> tuple[PhaseEvent, ...]:
        height, options = self._height, self._options
        t, x = height.t, height.value
        travel = x - self._x_contact
        t_anchor, x_anchor = self._anchor
        if self._band == 0.0:
            self._band = max(5.0 * height.noise, options.rest_band * travel, 1e-12)
        if x > self._top:
            self._top, self._t_top = x, t
        if abs(x - x_anchor) > self._band:
            if x > x_anchor:
                # Older travel counts for less, so that the pace is that of the push just now.
                dx, dt = self._pushed
                keep = 0.95
                self._pushed = (keep * dx + x - x_anchor, keep * dt + t - t_anchor)
            self._anchor = (t, x)
            self._band = max(5.0 * height.noise, options.rest_band * travel, 1e-12)
            if self._top - x > max(20.0 * height.noise, 0.3 * (self._top - self._x_contact)):
                self._t_release, self._level = self._t_top, self._top
                self._still = (now, self._force.value)
                return self._event('release', self._t_top, now)
            return ()
        dx, dt = self._pushed
        if dx <= 3.0 * self._band:
            return ()
        resting = t - t_anchor
        if resting <= max(
            options.rest_slowdown * self._band * dt / dx,
            4.0 * height.step,
            0.05 * (t_anchor - self._t_contact),
        ):
            return ()
        tx, xs = height.history.arrays()
        tail = xs[tx >= t_anchor]
        third = tail.size // 3
        self._level = float(np.median(tail[third:]))
        self._held = 1
        begin = int(np.searchsorted(tx, self._t_contact))
        low = begin + int(
            np.argmax(xs[begin:] >= self._x_contact + 0.7 * (self._level - self._x_contact))
        )
        first = int(np.searchsorted(tx, t_anchor))
        low = max(0, min(low, first - 5))
        t_hold = fit_stop(tx[low:], xs[low:], float(tx[low]), float(tx[-1]))
        self._t_hold = max(t_hold, self._t_contact)
        self._away = 0
        return self._event('hold', self._t_hold, now)

    def _watch_release(self, now: float) -> tuple[PhaseEvent, ...]:
        height, options = self._height, self._options
        depth = self._level - self._x_contact
        band = max(5.0 * height.noise, options.rest_band * depth)
        off = height.value - self._level
        if abs(off) <= band:
            self._away = 0
            return ()
        self._away += 1
        if self._away < 3:
            return ()
        tx, xs = height.history.arrays()
        begin = min(int(np.searchsorted(tx, self._t_hold)), tx.size - 4)
        t_start = fit_start(tx, xs, begin, tx.size - 3)
        if off > 0.0:
            self._start_push(height.t, height.value, t_start, self._level)
            return self._event('step', t_start, now)
        self._t_release = max(t_start, self._t_hold)
        self._still = (now, self._force.value)
        return self._event('release', self._t_release, now)

    def _watch_loss(self, now: float) -> tuple[PhaseEvent, ...]:
        force, options = self._force, self._options
        band = max(options.contact_sigmas * self._force_noise, options.loss_fraction * self._peak)
        t_still, f_still = self._still
        if abs(force.value - f_still) > band:
            self._still = (force.t, force.value)
            return ()
        left = f_still - self._baseline
        share = 0.1 if abs(left) <= band else 0.5
        if abs(left) > 0.15 * self._peak:
            return ()
        since = t_still - self._t_release
        if force.t - t_still < max(share * since, 5.0 * force.step):
            return ()
        if share == 0.5:
            return self._event('loss', t_still, now)
        t, f = force.history.arrays()
        begin = int(np.searchsorted(t, self._t_release))
        big = np.flatnonzero(
            np.abs(f[begin:] - self._baseline) > max(4.0 * band, 0.2 * self._peak)
        )
        first = begin + (int(big[-1]) if big.size else -_FIRST_FITTED)
        first = max(0, min(first, int(np.searchsorted(t, t_still)) - _FIRST_FITTED))
        back_t, back_f = -t[first:][::-1], f[first:][::-1]
        onset = fit_onset(back_t, back_f, back_t, float(back_t[0]), float(back_t[-1]))
        return self._event('loss', max(-onset.t, self._t_release), now)
