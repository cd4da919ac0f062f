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


"""Encoders between whose readings a driver draws straight lines."""

from collections.abc import Sequence
import math

from hapticvision_ros.core.fit.data import tool_path
from hapticvision_ros.core.fit.interpolated import readings
from hapticvision_ros.core.records import Segmentation, Signal
import numpy as np
import pytest

PHASES = Segmentation(1.0, 3.0, 13.0, 13.35, 14.5, 0.04, 0.0, 0.0035, 0.007)
TURNS = [0.0, 3.0, 13.0, 13.5, 14.6]
PLACES = [-0.0035, 0.007, 0.007, -0.003, -0.003]
NOISE = 1e-6


def _read(interval: float, noise: float = NOISE) -> tuple[np.ndarray, np.ndarray]:
    """Return what is read seldom of a tool that goes straight."""
    t = np.arange(0.0, 14.55, interval)
    seen = np.interp(t, TURNS, PLACES)
    return t, seen + noise * np.random.default_rng(3).standard_normal(t.size)


@pytest.mark.parametrize('rate', [250.0, 400.0, 997.0])
@pytest.mark.parametrize('interval', [0.016, 0.02])
def test_the_readings_come_back(rate: float, interval: float) -> None:
    t, value = _read(interval)
    told = np.arange(0.003, 14.5, 1.0 / rate)
    found_t, found = readings(told, np.interp(told, t, value))
    inner = slice(1, -1)
    places = np.rint(found_t[inner] / interval).astype(int)
    assert np.all(np.diff(places) == 1)
    # Where three readings lie nearly on a line, that in the middle is not seen as well.
    assert np.mean(np.abs(found_t[inner] - t[places]) < 1e-6) > 0.99
    # Of the last one the line after it is too short.
    places = places[:-2]
    assert np.interp(t[places], found_t, found) == pytest.approx(value[places], abs=1e-9)


@pytest.mark.parametrize('rate', [150.0, 160.0, 200.0, 250.0, 312.5, 357.0])
@pytest.mark.parametrize('start', [0.0, 0.003])
def test_readings_come_back_where_lines_have_two_samples_or_one(rate: float, start: float) -> None:
    t, value = _read(0.008)
    told = np.arange(start, 14.5, 1.0 / rate)
    found_t, found = readings(told, np.interp(told, t, value))
    inner = slice(1, -1)
    places = np.rint(found_t[inner] / 0.008).astype(int)
    assert np.all(np.diff(places) == 1)
    assert found_t[inner] == pytest.approx(t[places], abs=1e-8)
    assert found[inner] == pytest.approx(value[places], abs=1e-4 * NOISE)
    assert found_t[[0, -1]].tolist() == told[[0, -1]].tolist()


def test_readings_come_back_at_any_rate() -> None:
    random = np.random.default_rng(5)
    for _ in range(12):
        ratio, interval = random.uniform(1.22, 2.9), random.choice([0.004, 0.008, 0.016])
        t, value = _read(interval, noise=10.0 ** random.uniform(-7.0, -5.0))
        told = np.arange(random.uniform(0.0, 0.01), 14.5, interval / ratio)
        found_t, _ = readings(told, np.interp(told, t, value))
        assert np.diff(found_t[1:-1]) == pytest.approx(interval, abs=1e-6), (ratio, interval)


def test_where_the_tool_changes_its_speed_readings_are_not_looked_for_first() -> None:
    random = np.random.default_rng(6)
    for _ in range(12):
        ratio = random.uniform(1.22, 2.9)
        t, value = _read(0.01, noise=1e-7)
        told = np.arange(2.9, 14.5, 0.01 / ratio)
        found_t, _ = readings(told, np.interp(told, t, value))
        assert np.diff(found_t[1:-1]) == pytest.approx(0.01, abs=1e-6), ratio


def test_readings_that_are_asked_for_again_are_not_those_that_were_changed() -> None:
    """A record's are kept: its path is made several times."""
    t, value = _read(0.008)
    told = np.arange(0.003, 14.5, 0.005)
    samples = np.interp(told, t, value)
    found_t, found = readings(told, samples)
    once = found_t.copy(), found.copy()
    found_t += 1.0
    found += 1.0
    again = readings(told, samples)
    assert np.array_equal(again[0], once[0])
    assert np.array_equal(again[1], once[1])


def test_twice_as_many_readings_as_there_are_are_not_taken() -> None:
    """At 1 kHz, readings of 400 Hz are on the lines between those of 800 Hz as well."""
    t, value = _read(0.0025)
    told = np.arange(0.001, 14.5, 0.001)
    found_t, _ = readings(told, np.interp(told, t, value))
    assert np.diff(found_t[1:-1]) == pytest.approx(0.0025, abs=1e-8)


@pytest.mark.parametrize('ratio', [1.2, 1.3, 1.6, 2.5])
@pytest.mark.parametrize('phase', [0.0, 0.1, 0.3, 0.9])
def test_readings_that_lost_samples_told_do_not_come_back(ratio: float, phase: float) -> None:
    """Where as many samples are left as there are unknowns less one, any reading fits."""
    random = np.random.default_rng(7)
    t = np.arange(1300) * 0.01
    value = 1e-2 * np.sin(2.0 * t) + 1e-5 * random.standard_normal(t.size)
    told = (np.arange(1000) / ratio + phase) * 0.01
    at_random = random.choice(1000, 30, replace=False)
    for lost in [3], [997], [501, 504], [500, 502], [*range(400, 450)], at_random:
        left = np.delete(told, lost)
        samples = np.interp(left, t, value)
        found_t, found = readings(left, samples)
        assert found_t.size < left.size
        assert np.all(np.diff(found_t) > 1e-4)
        assert found == pytest.approx(np.interp(found_t, t, value), abs=1e-9)
        inner = (left > left[0] + 0.0151) & (left < left[-1] - 0.0151)
        assert np.interp(left[inner], found_t, found) == pytest.approx(samples[inner], abs=1e-9)


@pytest.mark.parametrize(
    ('ratio', 'left'),
    [(1.5, [0, *range(2, 240, 2)]), (2.0, range(0, 200, 3)), (2.5, range(0, 200, 4))],
)
@pytest.mark.parametrize('end', [1, -1])
def test_samples_stay_where_those_that_are_lost_told_more(
    ratio: float, left: Sequence[int], end: int
) -> None:
    """With most of them lost at an end, none of the readings there is known."""
    t = np.arange(1300) * 0.01
    value = 1e-2 * np.sin(2.0 * t) + 1e-5 * np.random.default_rng(7).standard_normal(t.size)
    kept = np.concatenate((left, np.arange(240, 1000)))
    told = (np.sort(999 - kept if end < 0 else kept) / ratio + 0.3) * 0.01
    samples = np.interp(told, t, value)
    found_t, found = readings(told, samples)
    assert found_t.size < told.size
    inner = (told > told[0] + 0.0151) & (told < told[-1] - 0.0151)
    assert np.interp(told[inner], found_t, found) == pytest.approx(samples[inner], abs=1e-9)


def test_a_vibration_is_not_taken_for_lines() -> None:
    """Of six samples a period: at 1.2 a reading five readings miss little of it."""
    t = np.arange(0.0, 14.5, 1.0 / 300.0)
    noise = 1e-8 * np.random.default_rng(1).standard_normal(t.size)
    found_t, _ = readings(
        t, np.interp(t, TURNS, PLACES) + 1e-5 * np.sin(100.0 * math.pi * t) + noise
    )
    assert found_t is t


def test_no_more_readings_come_back_than_there_are_samples() -> None:
    """Of 1.2 samples a reading nearly every sixth is lost: any readings fit the others."""
    t = np.arange(1300) * 0.01
    value = 1e-2 * np.sin(2.0 * t) + 1e-5 * np.random.default_rng(7).standard_normal(t.size)
    told = np.delete(
        (np.arange(1000) / 1.2 + 0.3) * 0.01, [*range(2, 480, 6), *range(488, 1000, 6)]
    )
    found_t, _ = readings(told, np.interp(told, t, value))
    assert found_t is told


def test_a_sample_that_is_off_shows_that_readings_do_not_tell_all() -> None:
    t, value = _read(0.008)
    told = np.arange(0.003, 14.5, 0.005)
    samples = np.interp(told, t, value)
    samples[1500] += NOISE
    found_t, _ = readings(told, samples)
    assert found_t is told


def test_a_stamp_of_another_day_is_no_long_record() -> None:
    """Room for all readings until then there is none."""
    t, value = _read(0.008)
    told = np.arange(0.003, 14.5, 0.005)
    samples = np.interp(told, t, value)
    told[-1] = 1.7e12
    found_t, _ = readings(told, samples)
    assert found_t is told


@pytest.mark.parametrize('interval', [0.002, 0.005, 0.01])
def test_smooth_ways_are_not_taken_for_lines(interval: float) -> None:
    """Six samples miss little of five readings, whatever smooth way they follow."""
    t = np.arange(0.0, 10.0, interval)
    part = np.clip(t / 3.0, 0.0, 1.0)
    for value in (
        1e-2 * np.sin(2.0 * t),
        1e-2 * t + 2e-5 * np.sin(50.0 * t),
        1e-2 * np.exp(-t),
        1e-3 * t**2,
        1e-3 * (np.sin(3.0 * t) + np.sin(7.1 * t)),
        1e-2 * part**3 * (10.0 - 15.0 * part + 6.0 * part**2),
    ):
        found_t, _ = readings(t, value)
        assert found_t is t


def test_no_reading_is_next_to_the_first_or_the_last_sample() -> None:
    """Stamps that begin with a reading, of which every 32nd falls on one."""
    t, value = _read(0.016)
    told = np.arange(0.0, 14.5, 0.0025)
    found_t, _ = readings(told, np.interp(told, t, value))
    assert found_t.size < told.size
    assert np.diff(found_t).min() > 0.007


def test_readings_that_lie_on_a_line_are_not_left_out() -> None:
    """At rest encoders that round read the same."""
    t, value = _read(0.016, noise=2e-5)
    value = np.round(value / 1e-5) * 1e-5
    value[300:320] = value[300]
    told = np.arange(0.003, 14.5, 0.0025)
    found_t, found = readings(told, np.interp(told, t, value))
    assert np.diff(found_t[1:-1]) == pytest.approx(0.016, abs=1e-6)
    assert np.interp(t[1:-5], found_t, found) == pytest.approx(value[1:-5], abs=1e-9)


@pytest.mark.parametrize(
    'what',
    [
        'noise',
        'exact',
        'curved',
        'filtered',
        'rounded after',
        'uneven',
        'to and fro',
        'quickly to and fro',
        'few',
        'out of order',
        'rests',
        'swings for a while',
        'one is far away',
        'stamped years later',
        'noisy for a while',
        'very seldom',
    ],
)
def test_other_samples_stay_as_they_are(what: str) -> None:
    told = np.arange(0.003, 14.5, 0.0025)
    value = np.interp(told, TURNS, PLACES)
    if what == 'noise':
        value += NOISE * np.random.default_rng(1).standard_normal(told.size)
    elif what == 'curved':
        value += 1e-4 * np.sin(told)
    elif what == 'filtered':
        random = np.random.default_rng(1).standard_normal(told.size)
        value += NOISE * np.convolve(random, np.exp(-np.arange(20.0) / 3.0), 'same')
    elif what == 'rounded after':
        # To a tenth of the noise.
        value = np.round(np.interp(told, *_read(0.004)) / (0.1 * NOISE)) * (0.1 * NOISE)
    elif what == 'uneven':
        at = np.cumsum(np.random.default_rng(1).uniform(0.015, 0.03, 800))
        value = np.interp(told, at, NOISE * np.random.default_rng(2).standard_normal(at.size))
    elif what == 'to and fro':
        value += 1e-4 * np.abs((told / 0.1) % 2.0 - 1.0)
    elif what == 'quickly to and fro':
        value += 1e-4 * np.abs((told / 0.02) % 2.0 - 1.0)
    elif what in ('swings for a while', 'one is far away', 'stamped years later'):
        t, read = _read(0.016)
        value = np.interp(told, t, read)
        if what == 'swings for a while':
            value += 1e-4 * np.where((told > 6.0) & (told < 6.05), np.sin(told) ** 2, 0.0)
        elif what == 'one is far away':
            value[2000] += 1e-4
        else:
            told[-1] = 1.7e9
    elif what == 'noisy for a while':
        value = np.interp(told, *_read(0.016))
        random = np.random.default_rng(1)
        value += np.where((told > 6.0) & (told < 9.0), 1e-7, 0.0) * random.standard_normal(
            told.size
        )
    elif what == 'very seldom':
        value = np.interp(told, *_read(0.1))
    elif what == 'few':
        told = told[:150]
        value = np.interp(told, *_read(0.0125))
    elif what == 'out of order':
        t, read = _read(0.016)
        value = np.interp(told, t, read)
        told[50] = told[51]
    elif what == 'rests':
        value = np.full(told.size, 0.003)
    found_t, found = readings(told, value)
    assert found_t is told
    assert found is value


def test_a_tool_whose_driver_interpolates_goes_straight() -> None:
    """Readings of 62.5 Hz, told at 400 Hz: followed as told its speed is off by 88 um/s."""
    t, value = _read(0.016)
    told = np.arange(0.003, 14.5, 0.0025)
    path = tool_path(Signal(told, np.interp(told, t, value)), PHASES)
    assert path.noise == pytest.approx(NOISE, rel=0.15)
    assert path.t.size < 12
    pushed = np.arange(1.0, 2.9, 0.0025)
    speed = np.diff(path.at(pushed)) / 0.0025
    assert speed == pytest.approx(0.0035, abs=1e-6)
    assert math.isclose(path.interval, 0.016, rel_tol=1e-3)
