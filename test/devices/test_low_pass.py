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

"""The low-pass: what it passes, and when."""

from hapticvision_ros.core.devices import WrenchSample
from hapticvision_ros.devices.low_pass import LowPass
import numpy as np
import pytest

RATE = 1000.0


def _filtered(low_pass, force):
    """Return the stamps [s] and forces that come out, and when each was known [s]."""
    out = []
    for number, value in enumerate(force):
        stamp_ns = number * 1_000_000
        sample = low_pass.take(WrenchSample(stamp_ns, (0.0, 0.0, value), (0.0, value, 0.0)))
        if sample is not None:
            assert sample.torque[1] == pytest.approx(sample.force[2])
            out.append((sample.stamp_ns * 1e-9, sample.force[2], stamp_ns * 1e-9))
    return np.array(out).T


def _gain(frequency, delay):
    t = np.arange(4000) / RATE
    stamps, force, _ = _filtered(LowPass(delay, RATE), np.sin(2 * np.pi * frequency * t))
    settled = stamps > 0.5
    phase = 2 * np.pi * frequency * stamps[settled]
    basis = np.stack([np.sin(phase), np.cos(phase)], axis=1)
    return np.linalg.lstsq(basis, force[settled])[0]


@pytest.mark.parametrize('delay', [0.005, 0.02])
def test_it_passes_what_it_says_without_a_shift_in_time(delay):
    in_phase, in_quadrature = _gain(0.36 / (delay + 1.0 / RATE), delay)
    assert 20 * np.log10(in_phase) == pytest.approx(-3.0, abs=0.1)
    assert in_quadrature == pytest.approx(0.0, abs=1e-9)
    assert _gain(0.01 / delay, delay)[0] == pytest.approx(1.0, abs=2e-3)
    assert abs(_gain(1.5 / delay, delay)[0]) < 0.05


def test_a_result_is_known_after_the_stated_delay():
    low_pass = LowPass(0.02, RATE)
    stamps, force, known = _filtered(low_pass, np.linspace(0.0, 1.0, 300))
    assert low_pass.delay == pytest.approx(0.02)
    late = known - stamps
    assert late.max() == pytest.approx(0.02)
    assert np.all(np.diff(stamps) > 0.0)
    # A straight line stays where it is, also at the beginning, where fewer are averaged.
    assert force == pytest.approx(stamps * RATE / 299.0, abs=1e-12)
    assert stamps[0] == 0.0


def test_nothing_is_averaged_across_a_break():
    low_pass = LowPass(0.005, RATE)
    _filtered(low_pass, np.full(50, 100.0))
    low_pass.restart()
    _, force, _ = _filtered(low_pass, np.zeros(50))
    assert force == pytest.approx(0.0, abs=1e-12)


def test_without_a_delay_nothing_is_changed():
    sample = WrenchSample(1, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0))
    assert LowPass(0.0, RATE).take(sample) is sample
