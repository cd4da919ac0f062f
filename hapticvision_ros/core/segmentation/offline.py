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

"""The phases of a recorded trial, from the whole of its signals."""

from dataclasses import dataclass, replace
import math

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.outliers import NORMAL_FROM_MAD, possible, runs
from hapticvision_ros.core.records import FloatArray, Segmentation, Signal
from hapticvision_ros.core.segmentation.contact import (
    fit_start,
    locate_touch,
    quiet_level,
    slope,
)
from hapticvision_ros.core.segmentation.events import SegmentationOptions
from hapticvision_ros.core.segmentation.fits import (
    despike,
    fit_onset,
    fit_stop,
    noise_std,
)
from hapticvision_ros.core.segmentation.fits import (
    level as median_level,
)
import numpy as np
from numpy.typing import NDArray

_FEWEST = 8
_IRRELEVANT = 1e-3
"""A zero that moves by less than this share of the peak spoils nothing."""
_MOVED = 5.0
"""Standard errors by which two levels without contact differ for certain."""
_CALM = 16
"""Samples without force in a row that are no chance."""
_STARTS = 0.5
"""Speed of the tool over that after it, below which it speeds up."""
_FURTHER = 0.2
"""Way of a tool from its start to the touch, over that in which it starts, at least."""
_AT_THE_TOUCH = 2
"""Samples before a touch that may be of it already."""
_UNMOVED = 3.0
"""Standard errors within which two levels are the same."""
_TOUCHED = 3.0
"""Rise of the force in contact over a jump of the zero before it, at least."""
_CLEAR_JUMP = 12.0
"""Standard errors of such a jump, at least: a force that rises evenly would be seen to."""
_EVEN = 0.7
"""Least speed over the greatest of a tool that goes on as before."""
_OF_MEDIAN = 1.2533
"""Standard error of a median over that of a mean, in normal noise."""
_STRAIGHT = 2.0
"""Spread of the object's way beside the tool's, over their noise, in which both go together."""
_CLEARLY = 3.0
_DEEP = 0.8
"""How much larger is a matter of sign, and the share of the way from which on a tool is deep."""
_DEEPEST = 0.99
"""The share of the way from which on a push is over."""
_BLOCKS = 50
_AGAIN = 4
"""Rounds in which the touch that the heights show, and what is before it, are found."""
_LATE_SAMPLES = 30.0
_LATE_SHARE = 0.05
"""Samples of the height, and share of the hold, by which T_e may be found late."""
_FALLEN = 3
"""Samples of the force below its decay that are no noise."""
_NO_PUSH = (
    'the force is largest at the start of the record: it starts in contact, and the push is not '
    'in it'
)
_HIGHEST = 10.0
"""A tool is no higher [m]: one that is more than a centimetre high, in millimetres, is."""
_DEFAULTS = SegmentationOptions()


@dataclass(frozen=True, slots=True)
class _Record:
    """
    The despiked signals: force at `tf` [s, N], travel at `tx` [s, m], and their noise.

    `force_step` is the error of a reading of the force by the load cell's step [N].
    """

    tf: FloatArray
    f: FloatArray
    tx: FloatArray
    x: FloatArray
    force_noise: float
    travel_noise: float
    force_step: float


@dataclass(frozen=True, slots=True)
class _Contact:
    """
    First touch: time [s], force zero [N] or None where there is none, force peak [N].

    With the travel at the touch [m], the standard errors of the zero [N] and of that [m], and when
    the push begins [s], where a slow approach was waiting for the touch.
    """

    t: float | None
    zero: float | None
    amplitude: float
    warnings: tuple[str, ...]
    zero_std: float = 0.0
    travel_std: float = 0.0
    t_push: float = -math.inf
    travel: float = 0.0


@dataclass(frozen=True, slots=True)
class _Rest:
    """Samples `first` to `stop` during which the tool stays at travel `level` [m]."""

    first: int
    stop: int
    level: float


@dataclass(frozen=True, slots=True)
class _Motion:
    """T_s, T_e, the end of the usable record, the travel reached, and what to know of them."""

    t_hold: float | None
    t_release: float | None
    t_stop: float
    level: float
    notes: tuple[str, ...] = ()
    onward: '_Motion | None' = None


def segment(
    force: Signal,
    tool_height: Signal,
    displacement_height: Signal | None = None,
    *,
    options: SegmentationOptions = _DEFAULTS,
) -> Segmentation:
    """
    Find the phases of a trial from its signals alone.

    T_c is the onset of the force over the tool's travel; T_s is the moment at which the tool has
    come to rest (the end of its slowing down, where it slows down) and T_e the moment at which it
    starts back, both from the tool's motion (heights may come late: T_e is no later than the
    sudden fall of the force); t_loss is where the force on withdrawal has gone to its level
    without contact for good, after the pull of an adhesive object. Where a small force (up to
    15 % of its peak) is kept on withdrawal, t_loss is where it has settled to that; where
    the tool pushes in steps, the phases are those of the first step and `t_end` is its end; those
    of the `whole` record have the last hold, at its depth, and all before it is the push. Where
    the tool never comes to rest, `push_speed` is the mean up to the end of the push. A slow
    approach that waits for the touch is no part of the push that it is the mean of.

    Parameters
    ----------
    force : Signal
        Contact force [N] with the load cell's offset, positive in compression.
    tool_height : Signal
        Height of the tool tip [m], falling as the tool pushes; its rate may differ.
    displacement_height : Signal or None
        The paper's H [m]; where the force cannot tell, it shows when the surface stays behind.
    options : SegmentationOptions
        What counts as an event.

    Returns
    -------
    Segmentation
        The phases; what is missing is None, with a warning that says why.

    Raises
    ------
    InputError
        If the signals are too short, do not overlap in time, or the height is in millimetres.

    """
    record = _prepare(force, tool_height)
    t_end = float(min(force.t[-1], tool_height.t[-1]))
    turned = _turned(record, options)
    if turned is None:
        contact = _find_contact(record, options)
    else:
        contact = _Contact(None, None, 0.0, (turned,))
    if contact.t is None:
        middle = float(np.median(record.f))
        return Segmentation(
            None, None, None, None, t_end, None, middle, None, None, contact.warnings
        )
    motion = _find_motion(record, contact.t, contact.travel, options)
    if displacement_height is not None and not contact.warnings and motion.t_hold is not None:
        seen = _seen_by_height(record, contact, motion.t_hold, displacement_height)
        if seen is not contact and seen.t is not None:
            contact = seen
            motion = _find_motion(record, seen.t, seen.travel, options)
    first = _phases(record, tool_height, contact, motion, t_end, displacement_height, options)
    if motion.onward is None:
        return first
    whole = _phases(
        record, tool_height, contact, motion.onward, t_end, displacement_height, options
    )
    return replace(first, whole=replace(whole, push_speed=first.push_speed, t_first=first.t_hold))


def _phases(
    record: _Record,
    tool_height: Signal,
    contact: _Contact,
    motion: _Motion,
    t_end: float,
    displacement_height: Signal | None,
    options: SegmentationOptions,
) -> Segmentation:
    """Return the phases of a trial whose touch is known, and how the tool goes on from there."""
    assert contact.t is not None
    t_contact = contact.t
    x_contact = contact.travel
    warnings = [*contact.warnings, *motion.notes]
    t_hold, t_release = motion.t_hold, motion.t_release
    if t_hold is not None and t_release is not None:
        t_release = _seen_by_force(record, t_hold, t_release)
    t_end = min(t_end, motion.t_stop)
    t_loss, free, notes = _find_loss(
        record, contact, t_release, t_end, x_contact, displacement_height, options
    )
    warnings += notes
    zero, zero_std = contact.zero, contact.zero_std
    if zero is None and free is not None:
        zero, zero_std = free
    elif zero is not None and free is not None:
        warnings += _moved_zero(zero, zero_std, *free, contact.amplitude)
    if zero is None:
        warnings.append(
            'the record has no force without contact: the zero of the load cell is taken as 0 N'
        )
    depth = push_speed = None
    t_deepest = t_hold if t_hold is not None else t_release
    if t_deepest is not None and t_deepest > t_contact:
        depth = motion.level - x_contact
        t_push = contact.t_push if contact.t_push < t_deepest else t_contact
        t_push = max(t_push, t_contact)
        x_push = x_contact
        if t_push > t_contact:
            x_push = float(np.interp(t_push, record.tx, record.x))
        push_speed = (motion.level - x_push) / (t_deepest - t_push)
    elif t_deepest is None and t_end > t_contact:
        push_speed = (motion.level - x_contact) / (t_end - t_contact)
    return Segmentation(
        t_contact=t_contact,
        t_hold=t_hold,
        t_release=t_release,
        t_loss=t_loss,
        t_end=t_end,
        contact_height=float(tool_height.value[0]) - x_contact,
        force_zero=zero if zero is not None else 0.0,
        push_speed=push_speed,
        depth=depth,
        warnings=tuple(warnings),
        force_zero_std=zero_std,
        contact_height_std=contact.travel_std,
        push_is_cut=_NO_PUSH in warnings,
    )


def _moved_zero(
    zero: float, zero_std: float, free: float, free_std: float, amplitude: float
) -> list[str]:
    """Return the sentence on a zero of the load cell that is another after the trial."""
    moved, error = free - zero, math.hypot(zero_std, free_std)
    if abs(moved) <= max(_MOVED * error, _IRRELEVANT * amplitude):
        return []
    return [
        f'the zero of the load cell moved by {moved:+.2g} ± {error:.1g} N from before contact to '
        'after its loss, which is not corrected: forces late in the trial are off by up to that'
    ]


def _prepare(force: Signal, tool_height: Signal) -> _Record:
    for name, signal in (('force', force), ('tool height', tool_height)):
        if len(signal) < _FEWEST:
            raise InputError(
                f'the {name} has too few samples ({len(signal)}) to find the phases of a trial: '
                f'record at least {_FEWEST}'
            )
    highest = float(np.median(np.abs(tool_height.value)))
    if highest > _HIGHEST:
        raise InputError(
            f'the tool is {highest:.3g} m high: heights are in metres, and these look like '
            'millimetres; convert them'
        )
    start = max(force.t[0], tool_height.t[0])
    stop = min(force.t[-1], tool_height.t[-1])
    if stop <= start:
        raise InputError(
            'the force and the tool height do not overlap in time: check the clocks that '
            'stamped them'
        )
    f = despike(possible(force))
    x = tool_height.value[0] - despike(possible(tool_height))
    inside = slice(*np.searchsorted(force.t, (start, stop + 1e-12)))
    f_noise, x_noise = noise_std(force.value), noise_std(tool_height.value)
    x_noise = max(x_noise, _coarseness(x))
    return _Record(
        force.t[inside], f[inside], tool_height.t, x, f_noise, x_noise, _coarseness(force.value)
    )


def _turned(record: _Record, options: SegmentationOptions) -> str | None:
    """Return what is said of a force or a height that has the wrong sign; None if neither has."""
    span = float(np.ptp(record.x))
    least = _CLEARLY * (
        options.contact_sigmas * record.force_noise + 1e-12 * float(np.max(np.abs(record.f)))
    )
    if span <= _CLEARLY**2 * record.travel_noise:
        return None
    depth = (np.interp(record.tf, record.tx, record.x) - float(record.x.min())) / span
    deep, shallow = record.f[depth > _DEEP], record.f[depth < 1.0 - _DEEP]
    if min(deep.size, shallow.size) < _FEWEST:
        return None
    usual = median_level(record.f[: max(record.f.size // 100, _FEWEST)])
    pressed, free = median_level(deep) - usual, median_level(shallow) - usual
    # An adhesive object pulls as the tool goes away, not where it is deepest.
    turned = -pressed > max(least, _CLEARLY * abs(free)) and float(deep.max()) - usual < -pressed
    # One that relaxes has let go of the tool where it stays.
    push = record.f[: int(np.argmax(depth > _DEEPEST))]
    begun = push[depth[: push.size] < 1.0 - _DEEP]
    fallen = 0.0
    if begun.size >= _FEWEST:
        zero = median_level(begun)
        fallen = zero - median_level(push[-_FEWEST:])
        # What goes on to fall, or stays, is a zero that wanders.
        relaxes = zero - median_level(deep) < 0.5 * fallen
        risen = float(record.f.max()) - zero
        turned = turned or (relaxes and fallen > max(least, _CLEARLY * risen))
    if turned:
        return (
            f'the force falls by {max(-pressed, fallen):.3g} N as the tool goes down: it is to be '
            'positive in compression, so turn its sign'
        )
    if free > max(least, _CLEARLY * abs(pressed)):
        return (
            f'the force rises by {free:.3g} N where the tool height is greatest: the height is to '
            'fall as the tool pushes, so turn its sign'
        )
    return None


def _coarseness(value: FloatArray) -> float:
    """Return the error of a reading by the sensor's step, which a rest hides; 0 if it is fine."""
    steps = np.abs(np.diff(value))
    moving = steps[steps > 0.0]
    if not moving.size or moving.size >= 0.7 * steps.size:
        return 0.0
    return 0.3 * float(np.min(moving))


def _find_contact(record: _Record, options: SegmentationOptions) -> _Contact:
    tf, f = record.tf, record.f
    block = max(1, f.size // 4000)
    starts = np.arange(0, f.size, block)
    coarse = np.add.reduceat(f, starts) / np.diff(np.append(starts, f.size))
    sigma = record.force_noise
    peak = int(np.argmax(coarse))
    before = coarse[: peak + 1]
    p10 = float(np.quantile(before, 0.1))
    base = float(np.mean(before[before <= p10 + 2.6 * sigma]))
    # A slow push after a short approach leaves less than a tenth of all to the air.
    base = min(base, float(np.median(before[: max(before.size // 100, _FEWEST)])))
    amplitude = float(coarse[peak]) - base
    least = options.contact_sigmas * sigma + 1e-12 * float(np.max(np.abs(f)))
    if amplitude <= least:
        late = coarse.size - max(1, coarse.size // 10)
        fall = float(coarse[peak] - np.median(coarse[late:]))
        if fall > least:
            travel = float(np.interp(tf[0], record.tx, record.x))
            return _Contact(float(tf[0]), None, fall, (_NO_PUSH,), travel=travel)
        return _Contact(None, None, 0.0, ('the force never rises out of its noise: no contact',))
    threshold = max(0.2 * amplitude, least)
    calm = f <= base + max(least, 0.01 * amplitude)
    begin, end = 0, min((peak + 1) * block, f.size)
    while True:
        # The block before may have risen already in its last samples.
        skipped = begin // block
        risen = int(np.argmax(before[skipped:] > base + threshold))
        first = max((skipped + max(risen - 1, 0)) * block, begin)
        high = first + int(np.argmax(f[first:] > base + threshold))
        again = _calm_again(record, calm, high, end)
        if again is None or again >= end:
            break
        begin = again
    quiet = np.flatnonzero(calm[: high + 1])
    low = int(quiet[-1]) if quiet.size else 0
    touch = locate_touch(tf, f, record.tx, record.x, record.travel_noise, low, high)
    notes = {
        'approach': (),
        'rest': (
            'the force rises as soon as the tool moves: it rests on the object from the start, '
            f'and its reading there, {touch.zero or 0.0:.4g} N, is taken as the force zero',
        ),
        'start': ('the force rises from the first sample: contact is at the start of the record',),
    }
    zero_std = 0.0 if touch.zero is None else math.hypot(touch.zero_std, record.force_step)
    return _Contact(
        touch.t,
        touch.zero,
        amplitude,
        notes[touch.found],
        zero_std,
        touch.travel_std,
        touch.t_push,
        touch.travel(record.tx, record.x),
    )


def _calm_again(record: _Record, calm: NDArray[np.bool_], high: int, peak: int) -> int | None:
    """
    Return when a force is gone again that was the tool's start, or a knock before; None for none.

    The mass of the tool hangs on the load cell, which feels it speed up. An object that is touched
    is still there further on; one that tears, or is touched twice, does so without a start, and
    one that forgets the force of a step does so while the tool is held.
    """
    gone = next((last for last in runs(calm[high:peak]) if last[1] - last[0] >= _CALM), None)
    if gone is None:
        return None
    risen = np.flatnonzero(calm[:high])
    low = int(risen[-1]) if risen.size else 0
    begin, end = high + gone[0], high + gone[1]
    length = float(record.tf[begin] - record.tf[low])
    gone_by, back_by = float(record.tf[begin]), float(record.tf[end - 1])
    moments = record.tf[low] - length, record.tf[low], gone_by, back_by
    first, rises, falls, last = np.interp(moments, record.tx, record.x).tolist()
    before = (rises - first) / length
    after = (last - falls) / max(back_by - gone_by, 1e-300)
    starts = last - falls > 5.0 * record.travel_noise and before < _STARTS * after
    # A tool that is held until the force is forgotten only settles, and begins to go on.
    return end if starts and last - falls > _FURTHER * (falls - rises) else None


def _seen_by_height(record: _Record, contact: _Contact, t_hold: float, height: Signal) -> _Contact:
    """
    Return the touch that the displacement height shows where the force agrees with that one.

    A force that sets in slowly, or beside a hum, may be seen to rise millimetres from the touch.
    The object goes with the tool from the touch on, so that the tool's travel less the object's is
    the travel at the touch; as a late clock of the range sensor or a bias of it would move that as
    well, the force decides: between the two it has to have risen where that is to be contact, and
    has not to have risen where it is to be air, but for a jump of its zero.
    """
    assert contact.t is not None
    value = despike(possible(height))
    pressed = (height.t > contact.t + (t_hold - contact.t) / 3.0) & (height.t < t_hold)
    t_touch = contact.t
    for _ in range(_AGAIN):
        # A force that rises late has part of the push in what it leaves to the air.
        air = value[height.t < t_touch]
        if min(air.size, int(np.count_nonzero(pressed))) < _FEWEST:
            return contact
        level = float(np.median(air))
        touches = np.interp(height.t[pressed], record.tx, record.x) - (value[pressed] - level)
        x_touch = float(np.median(touches))
        after = int(np.argmax(np.maximum.accumulate(record.x) > x_touch))
        beside = slice(max(after - 1, 0), after + 1)
        t_touch = float(np.interp(x_touch, record.x[beside], record.tx[beside]))
    noise = NORMAL_FROM_MAD * float(np.median(np.abs(air - level)))
    spread = NORMAL_FROM_MAD * float(np.median(np.abs(touches - x_touch)))
    error = math.hypot(spread / math.sqrt(touches.size), noise / math.sqrt(air.size))
    error = math.hypot(_OF_MEDIAN * error, record.travel_noise)
    away = abs(x_touch - contact.travel)
    if spread > _STRAIGHT * math.hypot(noise, record.travel_noise) or away <= _MOVED * math.hypot(
        error, contact.travel_std
    ):
        return contact
    between = min(t_touch, contact.t), max(t_touch, contact.t)
    first, last = (int(place) for place in np.searchsorted(record.tf, between))
    if t_touch < contact.t:
        last -= _AT_THE_TOUCH
    # The end of what is asked about has the most force of it; blocks of that length before it have
    # the same slow noise and hum.
    size = min(last - first, first // _FEWEST)
    if size < _FEWEST:
        return contact
    blocks = min(first // size, _BLOCKS)
    start, end = first - blocks * size, last - size
    means = record.f[start:first].reshape(blocks, size).mean(axis=1)
    risen = float(record.f[end:last].mean() - means.mean())
    error_risen = float(means.std(ddof=1)) * math.sqrt(1.0 + 1.0 / blocks)
    jumped = False
    if t_touch < contact.t:
        agrees = risen > _MOVED * error_risen
    else:
        agrees = abs(risen) < _UNMOVED * error_risen
        if not agrees:
            beside = slice(end, last + size)
            way = np.interp(record.tf[beside], record.tx, record.x)
            agrees = jumped = _only_jumps(record.f[beside], way, size, risen, error_risen)
    if not agrees:
        return contact
    quiet = slice(end if jumped else 0, int(np.searchsorted(record.tf, t_touch)))
    zero, zero_std = quiet_level(record.f[quiet])
    return replace(
        contact,
        t=t_touch,
        zero=zero,
        zero_std=math.hypot(zero_std, record.force_step),
        travel_std=error,
        travel=float(np.interp(t_touch, record.tx, record.x)),
    )


def _only_jumps(force: FloatArray, way: FloatArray, size: int, risen: float, error: float) -> bool:
    """
    Return whether a force that has risen is that of a load cell whose zero has jumped.

    It stays where it is for `size` samples, in which the tool goes on at one speed, and rises by
    much more after them, where the object begins to move.
    """
    before, after = force[:size], force[size:]
    if after.size < size or abs(risen) < _CLEAR_JUMP * error:
        return False
    ways = way[size // 2] - way[0], way[size] - way[size // 2], way[-1] - way[size]
    speeds = np.array(ways) / np.array([size // 2, size - size // 2, size - 1])
    # Held after a first touch, a force stays as well.
    if speeds.min() < _EVEN * speeds.max():
        return False
    earlier, later = np.array_split(before, 2)
    goes_on = abs(float(later.mean() - earlier.mean()))
    # Halves have a root of two more of the error each, and both have theirs.
    if goes_on > _UNMOVED * 2.0 * error:
        return False
    return float(after.mean() - later.mean()) > _TOUCHED * abs(risen)


def _find_rests(
    t: FloatArray, x: FloatArray, band: float, options: SegmentationOptions
) -> list[_Rest]:
    """Return where the tool stays within `band` far longer than it takes to cross it."""
    anchors = [0]
    while True:
        i, size = anchors[-1], 64
        found = -1
        while found < 0 and i + 1 < x.size:
            chunk = np.abs(x[i:][:size] - x[anchors[-1]]) > band
            hit = int(np.argmax(chunk))
            if chunk[hit]:
                found = i + hit
            i, size = i + size, 2 * size
        if found < 0:
            break
        anchors.append(found)
    edges = np.array([*anchors, x.size - 1])
    duration = np.diff(t[edges])
    rising = np.diff(x[edges]) > 0.5 * band
    if not np.any(rising):
        return []
    pace = float(np.median(duration[rising]))
    # A gap in the record is no rest.
    at_rest = (duration > options.rest_slowdown * pace) & (np.diff(edges) > 3)
    rests: list[_Rest] = []
    for k in np.flatnonzero(at_rest):
        first, stop = int(edges[k]), int(edges[k + 1])
        if k + 2 == edges.size:
            stop += 1
        if rests and rests[-1].stop >= first:
            first = rests[-1].first
            rests.pop()
        rests.append(_Rest(first, stop, median_level(x[first:stop])))
    return rests


def _find_motion(
    record: _Record, t_contact: float, x_contact: float, options: SegmentationOptions
) -> _Motion:
    """Return how the tool goes on from the touch."""
    begin = max(0, int(np.searchsorted(record.tx, t_contact)) - 1)
    tx, x = record.tx[begin:], record.x[begin:]
    deepest = int(np.argmax(x))
    reach = float(x[deepest]) - x_contact
    if reach <= 5.0 * record.travel_noise or x.size < 4:
        note = 'the tool does not push on after contact: the whole record is taken as the hold'
        return _Motion(t_contact, None, float(tx[-1]), x_contact, (note,))
    band = max(5.0 * record.travel_noise, options.rest_band * reach)
    # Once most of the depth is withdrawn no hold comes any more.
    back = np.flatnonzero(x[deepest:] < x_contact + 0.3 * reach)
    last = deepest + int(back[0]) + 1 if back.size else x.size
    rests = _find_rests(tx[:last], x[:last], band, options)
    rests = [r for r in rests if r.level - x_contact > 0.05 * reach]

    def was_deeper(rest: _Rest) -> bool:
        before = rest.first + 1
        return float(np.max(x[:before])) - rest.level > max(2.0 * band, 0.03 * reach)

    def goes_deeper(rest: _Rest) -> bool:
        after = rest.stop - 1
        return float(np.max(x[after:])) - rest.level > max(2.0 * band, 0.05 * reach)

    hold: _Rest | None = None
    steps = 0
    for rest in rests:
        pushed = float(tx[rest.first]) - t_contact
        lasted = float(tx[rest.stop - 1] - tx[rest.first])
        if was_deeper(rest):
            break
        goes_on = goes_deeper(rest)
        if goes_on and lasted < 0.2 * pushed:
            continue
        steps += 1
        if hold is None:
            hold = rest
        if not goes_on:
            break
    if hold is None:
        return _without_hold(tx, x, deepest, band)
    motion = _held(tx, x, hold, t_contact)
    if motion.t_release is None or not goes_deeper(hold):
        return motion
    # How it goes on from the first step is told by the way to the next rest.
    later = next((rest.stop for rest in rests if rest.first >= hold.stop), x.size)
    t_leave = _held(tx[:later], x[:later], hold, t_contact).t_release or motion.t_release
    deep = next((rest for rest in rests if not (was_deeper(rest) or goes_deeper(rest))), None)
    if deep is None:
        onward = _without_hold(tx, x, deepest, band)
    else:
        since = max((rest.stop - 1 for rest in rests if rest.stop <= deep.first), default=0)
        onward = _held(tx, x, deep, t_contact, since)
    which = f'first of {steps} holds' if steps > 1 else 'first hold'
    note = (
        f'the tool pushes in steps: the phases are those of the {which}, up to the '
        f'next step, at {t_leave:.4g} s; fits of the whole waveform use all of the record'
    )
    return replace(motion, t_release=None, t_stop=t_leave, notes=(note,), onward=onward)


def _held(tx: FloatArray, x: FloatArray, hold: _Rest, t_contact: float, since: int = 0) -> _Motion:
    """Return how a tool goes on that comes to rest, and has rested before up to a sample."""
    left, t_stop = hold.stop, float(tx[-1])
    t_hold = _fit_hold(tx, x, hold, t_contact, since)
    if left < x.size and abs(float(x[left]) - hold.level) > 0.0:
        t_leave = fit_start(tx, x, _after(tx, t_hold), left)
        return _Motion(t_hold, t_leave, t_stop, hold.level)
    note = 'the tool does not withdraw within the record: the release is missing'
    return _Motion(t_hold, None, t_stop, hold.level, (note,))


def _seen_by_force(record: _Record, t_hold: float, t_release: float) -> float:
    """
    Return T_e, earlier where the force had left its slow decay before: heights may come late.

    A tool that rests does not make the force fall all at once.
    """
    back = min(
        _LATE_SAMPLES * float(np.median(np.diff(record.tx))), _LATE_SHARE * (t_release - t_hold)
    )
    first, middle, last = np.searchsorted(
        record.tf, (t_release - 3.0 * back, t_release - back, t_release)
    )
    if middle - first < _FEWEST or last - middle < _FALLEN:
        return t_release
    t, f = record.tf[first:last] - t_release, record.f[first:last]
    calm = int(middle - first)
    decay = np.polynomial.Polynomial.fit(t[:calm], f[:calm], 1)
    noise = max(record.force_noise, float(np.std(f[:calm] - decay(t[:calm]))), record.force_step)
    held = calm + np.flatnonzero(f[calm:] > decay(t[calm:]) - 6.0 * noise)
    seen = int(held[-1]) if held.size else calm - 1
    return t_release + float(t[seen]) if f.size - 1 - seen >= _FALLEN else t_release


def _after(t: FloatArray, moment: float) -> int:
    return min(int(np.searchsorted(t, moment)), t.size - 2)


def _without_hold(tx: FloatArray, x: FloatArray, deepest: int, band: float) -> _Motion:
    level, t_stop = float(x[deepest]), float(tx[-1])
    if level - float(np.min(x[deepest:])) > 5.0 * band:
        note = 'the tool withdraws without a rest: the hold is missing'
        return _Motion(None, float(tx[deepest]), t_stop, level, (note,))
    note = 'the tool still pushes at the end of the record: the hold is missing'
    return _Motion(None, None, t_stop, level, (note,))


def _fit_hold(tx: FloatArray, x: FloatArray, hold: _Rest, t_contact: float, since: int) -> float:
    """Return when the tool has come to rest, from the push before `hold` and its first part."""
    if since:
        # The last way to it, also where the tool was as deep before.
        stop = hold.first + 1
        way = x[since:stop]
        start = float(way.min())
        low = since + int(np.flatnonzero(way <= start + 0.7 * (hold.level - start))[-1])
    else:
        low = int(np.argmax(x >= x[0] + 0.7 * (hold.level - x[0])))
    low = max(since, min(low, hold.first - 5))
    span = max(hold.first - low, 5)
    last = min(hold.stop, hold.first + 2 * span)
    t = tx[low:last]
    latest = min(float(tx[hold.stop - 1]), float(tx[min(hold.first + span, tx.size - 1)]))
    return max(t_contact, fit_stop(t, x[low:last], float(t[0]), latest))


def _stays_behind(
    displacement_height: Signal | None, t_contact: float | None, t_end: float, travel: float
) -> bool:
    """Whether the surface is seen to lie below the tool at the end of the record."""
    if displacement_height is None or t_contact is None:
        return False
    before = displacement_height.between(-np.inf, t_contact).value
    late = displacement_height.between(t_end - 0.1 * (t_end - t_contact), np.inf).value
    if before.size < 5 or late.size < 5:
        return False
    noise = max(float(np.std(before)), float(np.std(late)))
    gap = float(np.median(late)) - float(np.median(before)) - travel
    return gap > 5.0 * noise + 0.05 * float(np.max(displacement_height.value))


def _find_loss(
    record: _Record,
    contact: _Contact,
    t_release: float | None,
    t_end: float,
    x_contact: float,
    displacement_height: Signal | None,
    options: SegmentationOptions,
) -> tuple[float | None, tuple[float, float] | None, list[str]]:
    """Return t_loss, the force level without contact after it and its error, and warnings."""
    if t_release is None:
        return None, None, []
    first, last = np.searchsorted(record.tf, (t_release, t_end + 1e-9))
    t, f = record.tf[first:last], record.f[first:last]
    missing = 'the force does not settle on withdrawal: the loss of contact is missing'
    if f.size < 5:
        return None, None, [missing]
    late = f.size - max(5, f.size // 10)
    tail = f[late:]
    level, level_std = quiet_level(tail)
    level_std = max(level_std, record.force_noise / math.sqrt(tail.size))
    level_std = math.hypot(level_std, record.force_step)
    band = max(
        options.contact_sigmas * record.force_noise, options.loss_fraction * contact.amplitude
    )
    zero = contact.zero if contact.zero is not None else 0.0
    x_end = float(np.interp(t_end, record.tx, record.x))
    slack = 5.0 * record.travel_noise + options.rest_band * float(np.max(record.x) - x_contact)
    free = (
        x_end < x_contact - slack
        or abs(level - zero) <= band
        or _stays_behind(displacement_height, contact.t, t_end, x_end - x_contact)
    )
    settled = abs(float(np.mean(tail[: tail.size // 2])) - level) <= band
    if not settled or (not free and abs(level - zero) > 0.15 * contact.amplitude):
        return None, None, [missing]
    if free and f.size >= 60:
        third = f.size - f.size // 3
        # A drifting zero is a straight line here, and no force.
        drift, error = slope(t[third:], f[third:])
        if abs(drift) > 4.0 * error and abs(drift) * float(t[-1] - t[0]) < 0.1 * contact.amplitude:
            f = f - drift * (t - float(t[f.size - tail.size // 2]))
    outside = np.flatnonzero(np.abs(f - level) > band)
    coarse = int(outside[-1]) + 1 if outside.size else 0
    if coarse == 0:
        return t_release, (level, level_std), []
    coarse = min(coarse, f.size - 1)
    if not free:
        return (
            float(t[coarse]),
            None,
            [
                f'a force of {level - zero:.3g} N keeps the tool on the object as it recovers: '
                'contact is not lost for good, and t_loss is when the force has settled to that'
            ],
        )
    big = np.flatnonzero(np.abs(f[:coarse] - level) > max(4.0 * band, 0.2 * contact.amplitude))
    begin = int(big[-1]) if big.size else 0
    begin = max(0, min(begin, coarse - 6))
    stop = min(f.size, coarse + 3 * max(coarse - begin, 10))
    back_t, back_f = -t[begin:stop][::-1], f[begin:stop][::-1]
    latest = -float(t[begin])
    # What the band hides of a force that goes out smoothly; a pull that lets go hides nothing.
    fading = np.flatnonzero(np.abs(f[:coarse] - level) > 3.0 * band)
    hidden = 2 * (coarse - int(fading[-1])) if fading.size else 2
    earliest = -float(t[min(coarse + max(hidden, 2), stop - 1)])
    onset = fit_onset(back_t, back_f, back_t, earliest, latest)
    return max(t_release, -onset.t), (level, level_std), []
