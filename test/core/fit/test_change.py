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

"""By how much the error changes on unseen trials, and how well that is known."""

from collections.abc import Callable
from dataclasses import replace
from types import MappingProxyType
from typing import Any

from hapticvision_ros.core.fit.campaign import TrialFit
from hapticvision_ros.core.fit.change import error_changes
from hapticvision_ros.core.fit.noise import Noise
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import Estimate, Segmentation, Signal, Trial
import numpy as np
import pytest
from scipy.signal import lfilter

STEP = 0.004
T = np.arange(0.0, 12.0, STEP)
PHASES = Segmentation(1.0, 2.0, 8.0, 8.5, 12.0, 0.04, 0.0, 0.003, 0.003)
LEVEL = Noise(Estimate(0.02), Estimate.unknown('no height'))
NOTHING = Signal(np.empty(0), np.empty(0))


def _trial(name: str) -> tuple[Trial, Segmentation]:
    signal = Signal(T, np.zeros(T.size))
    return Trial(
        name=name, start_ns=0, force=signal, tool_height=signal, displacement_height=None
    ), PHASES


def _beside(measured: Any, fitted: Any, kept: Any = slice(None)) -> TrialFit:
    """Return a trial beside a model."""
    return TrialFit(
        name='any',
        force=Signal(T[kept], measured[kept]),
        force_fitted=np.broadcast_to(fitted, T.shape)[kept],
        height=NOTHING,
        height_fitted=np.empty(0),
        values=MappingProxyType({}),
        set_aside=np.empty(0),
    )


def _noise(seed: int, white: float, slow: float, memory: float) -> Any:
    random = np.random.default_rng(seed)
    keep = np.exp(-STEP / memory)
    fresh = random.standard_normal(T.size + 4000)
    wave = lfilter([np.sqrt(1.0 - keep**2)], [1.0, -keep], fresh)[4000:]
    return white * random.standard_normal(T.size) + slow * wave


@pytest.mark.parametrize('white, slow, memory', [(0.02, 0.0, 1.0), (0.005, 0.02, 0.3)])
def test_of_one_trial_the_error_is_what_the_noise_makes(
    white: float, slow: float, memory: float
) -> None:
    """Of 400 records with the same difference of two models the changes scatter so."""
    sensors = {'force': SensorNoise(white, slow, memory)}
    before = 0.01 * np.exp(-T / 3.0)
    after = 0.002 * np.sin(T)
    found = []
    for seed in range(400):
        measured = _noise(seed, white, slow, memory)
        one = error_changes(
            [_beside(measured, before)], [_beside(measured, after)], [_trial('a')], LEVEL, sensors
        )
        found.append((one.by_trial['a', 'force'], one.by_phase['force', 'hold']))
    for index in range(2):
        chi2 = np.array([each[index].chi2 for each in found])
        std = np.array([each[index].std for each in found])
        assert np.ptp(std) < 1e-12 * std[0]
        assert np.std(chi2) == pytest.approx(std[0], rel=0.12)
    samples = found[0][1].samples
    assert samples == np.count_nonzero((T >= 2.0) & (T < 8.0))
    true = np.mean(after**2 - before**2) / LEVEL.force.value**2  # type: ignore[operator]
    assert np.mean([each[0].chi2 for each in found]) == pytest.approx(
        true, abs=0.2 * found[0][0].std
    )


def test_samples_in_bursts_take_no_finer_a_grid(monkeypatch: pytest.MonkeyPatch) -> None:
    """Ten within 9 us, every 40 ms: a grid of them would have 13 million places."""
    sizes = []
    count = np.bincount
    monkeypatch.setattr(np, 'bincount', lambda *of: sizes.append(count(*of).size) or count(*of))
    t = (np.arange(0.0, 12.0, 0.04)[:, np.newaxis] + 1e-6 * np.arange(10)).ravel()
    sensors = {'force': SensorNoise(0.005, 0.02, 0.3)}
    left, right = (
        replace(
            _beside(np.zeros(T.size), 0.0), force=Signal(t, np.zeros(t.size)), force_fitted=fit
        )
        for fit in (np.full(t.size, 0.01), np.zeros(t.size))
    )
    found = error_changes([left], [right], [_trial('a')], LEVEL, sensors).total['force']
    assert found.samples == t.size and found.std > 0.0
    assert max(sizes) <= 4 * t.size + 1


def test_over_several_trials_it_is_that_over_these() -> None:
    """Two models that differ by a level of each trial: as often too far as a normal deviate."""
    sensors = {'force': SensorNoise(0.02, 0.0, 1.0)}
    random = np.random.default_rng(1)
    pulls = []
    for seed in range(300):
        before, after, names = [], [], []
        for k in range(16):
            measured = _noise(16 * seed + k, 0.02, 0.0, 1.0)
            kept = slice(0, T.size // (1 + k % 2))
            before.append(_beside(measured, 0.02 * np.sqrt(random.uniform()), kept))
            after.append(_beside(measured, 0.0, kept))
            names.append(_trial(f'trial {k}'))
        one = error_changes(before, after, names, LEVEL, sensors).total['force']
        # On the mean half of 0.02^2 less, over the squares of the noise.
        pulls.append((one.chi2 + 0.5) / one.std)
    assert abs(np.mean(pulls)) < 0.3
    assert 0.85 < np.std(pulls) < 1.3


def test_samples_are_those_of_both_and_what_has_none_is_left_out() -> None:
    sensors = {'force': SensorNoise(0.02, 0.0, 1.0)}
    measured = _noise(0, 0.02, 0.0, 1.0)
    old, new = _beside(measured, 0.0, slice(0, 1000)), _beside(measured, 0.01, slice(500, None))
    compare: Callable[..., Any] = error_changes
    found = compare([old, None, old], [new, new, None], list(map(_trial, 'abc')), LEVEL, sensors)
    assert set(found.by_trial) == {('a', 'force')}
    assert found.total['force'].samples == 500
    both = measured[500:1000]
    change = np.mean((both - 0.01) ** 2 - both**2) / 0.02**2
    assert found.total['force'].chi2 == pytest.approx(change)
    others = [_beside(measured, level, slice(0, 1000)) for level in (0.01, 0.03)]
    two = compare([old, old], others, [*map(_trial, 'ab')], LEVEL, sensors)
    each = [two.by_trial[name, 'force'].chi2 for name in 'ab']
    assert two.total['force'].chi2 == pytest.approx(np.mean(each))
    assert two.total['force'].std == pytest.approx(0.5 * abs(each[1] - each[0]))
    # With one trial the error over trials is that of this one.
    assert found.total['force'] == found.by_trial['a', 'force']
    apart = _beside(measured, 0.0, slice(0, 500)), _beside(measured, 0.0, slice(500, None))
    assert not compare([apart[0]], [apart[1]], [_trial('a')], LEVEL, sensors).total
    assert not compare([old], [new], [_trial('a')], LEVEL, {}).total
