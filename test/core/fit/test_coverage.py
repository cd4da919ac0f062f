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

"""Standard errors cover the truth from the raw signals on, not only from known phases."""

from dataclasses import replace
import math

from hapticvision_ros.core.pipeline import analyse
from hapticvision_ros.core.records import Signal, Trial
import numpy as np
import pytest
from scipy.signal import lfilter

COUNT = 32
FINE = 2000.0
EVERY = 10
FORCE_NOISE, TOOL_NOISE, HEIGHT_NOISE = 0.05, 5e-6, 2e-5


def _ar1(rng: np.random.Generator, count: int, correlation: float) -> np.ndarray:
    """Return stationary noise of unit standard deviation."""
    white = rng.standard_normal(200 + count)
    step = math.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([step], [1.0, -correlation], white)[200:])


def _recorded(exact: Trial, seed: int, correlation: float) -> Trial:
    """Return 200 samples/s of an exact trial with noise, from 0.2 to 0.4 s before contact on."""
    rng = np.random.default_rng((seed, round(10 * correlation)))
    # Contact, at 1 s, lies anywhere between two samples.
    start = rng.uniform(0.6, 0.8)

    def sampled(signal: Signal, noise: np.ndarray) -> Signal:
        t = np.arange(start, signal.t[-1], EVERY / FINE)
        # What the tool hides is not recorded.
        near = np.searchsorted(signal.t, t).clip(1, signal.t.size - 1)
        seen = signal.t[near] - signal.t[near - 1] < 2.0 / FINE
        t = t[seen]
        return Signal(t, np.interp(t, signal.t, signal.value) + noise[: t.size])

    count = len(exact.force)
    assert exact.displacement_height is not None
    return replace(
        exact,
        force=sampled(exact.force, FORCE_NOISE * _ar1(rng, count, correlation)),
        tool_height=sampled(exact.tool_height, TOOL_NOISE * rng.standard_normal(count)),
        displacement_height=sampled(
            exact.displacement_height, HEIGHT_NOISE * rng.standard_normal(count)
        ),
    )


@pytest.mark.parametrize(
    ('withdrawal', 'correlation'),
    [(0.001, 0.0), (0.001, 0.6), (0.05, 0.6)],
    ids=['keeps pace, white', 'keeps pace, AR(1)', 'left behind, AR(1)'],
)
def test_errors_hold_those_of_the_zero_and_of_the_contact_height(
    bingham: type, withdrawal: float, correlation: float
) -> None:
    # So few samples before contact that the zero has ten times the error of the hold's limit,
    # and a contact that is known to half a sample: 10 um beside the 2 um of the recovery.
    body = bingham()
    exact, _ = body.make(hold=24.0, withdrawal=withdrawal, rate=FINE)
    truth = {
        'F_inf': body.yield_force,
        'H0': body.yield_force / body.K1,
        'K1': body.K1,
    }
    scores: dict[str, list[float]] = {name: [] for name in truth}
    for seed in range(COUNT):
        analysis = analyse(_recorded(exact, seed, correlation))
        # Noise alone, white or not, is neither a drift nor a second exponential.
        assert not analysis.warnings
        for name, value in truth.items():
            estimate = getattr(analysis.paper, name)
            assert estimate.value is not None, estimate.reason
            scores[name].append((estimate.value - value) / estimate.std)
    for name, score in scores.items():
        # The root mean square of 32 scores is known to 12.5 %, and that of an error that is spread
        # evenly over a sample is not normal: three of those below 1 and four above.
        assert 0.6 < math.sqrt(float(np.mean(np.square(score)))) < 1.5, (name, score)


def test_a_zero_that_has_moved_is_told_with_its_size(bingham: type) -> None:
    exact, _ = bingham().make(hold=24.0, rate=FINE)
    trial = _recorded(exact, 1, 0.0)
    moved = 0.1
    drift = moved * np.clip((trial.force.t - 3.0) / 24.0, 0.0, 1.0)
    drifting = replace(trial, force=Signal(trial.force.t, trial.force.value + drift))
    phases = analyse(drifting).segmentation
    (warning,) = [text for text in phases.warnings if 'zero of the load cell' in text]
    told, error = (float(word) for word in warning.split(' by ')[1].split(' N')[0].split(' ± '))
    # Both levels are means: their errors are far below the 0.05 N of a sample, and are told.
    assert abs(told - moved) < 4.0 * error < 0.05
    # It is told and not corrected.
    assert phases.force_zero == analyse(trial).segmentation.force_zero


def test_a_steady_reading_of_a_coarse_load_cell_has_the_error_of_its_step(bingham: type) -> None:
    exact, _ = bingham().make(hold=24.0, rate=FINE)
    trial = _recorded(exact, 1, 0.0)
    step = 0.1
    clean = np.interp(trial.force.t, exact.force.t, exact.force.value)
    rounded = step * np.round((clean + 0.04) / step)
    coarse = analyse(replace(trial, force=Signal(trial.force.t, rounded)))
    # The true zero of 0.04 N reads 0 N throughout.
    assert coarse.segmentation.force_zero == 0.0
    assert coarse.segmentation.force_zero_std == pytest.approx(step / math.sqrt(12.0), rel=0.05)
    assert not coarse.warnings


def test_an_exact_trial_warns_of_nothing(bingham: type) -> None:
    exact, _ = bingham().make(hold=40.0, rate=200.0)
    assert not analyse(exact).warnings
