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


"""Exponential stiffening against closed forms."""

from collections.abc import Callable

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects.declaration import Scale
from hapticvision_ros.core.models.three_element import respond, ThreeElement
import numpy as np

RATE = 130.0
"""a [1/m]: the force at 10 mm is 3.7 times that of the chain."""
KNOT_T = np.array([0.0, 1.003, 9.0, 20.0, 30.0])
KNOT_D = 1e-3 * np.array([0.0, 0.0, 10.0, 10.0, 10.0])


def _force(driven: Callable, model: Model, values: list[float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the middles of the steps in push and hold, and the force there."""
    trial = driven(2e-3)
    force = model.predict(trial, model.theta(values), directions=False).force
    middle = 0.5 * (trial.t[1:] + trial.t[:-1])
    held = (middle > 1.01) & (middle < 20.0)
    return middle[held], force[held]


def test_the_force_is_that_of_the_exact_chain_times_the_exponential_of_the_depth(
    driven: Callable, scale: Scale
) -> None:
    model = Model(('exponential_stiffening',))
    t, force = _force(driven, model, [scale.K1, scale.C1, scale.C2, RATE])
    chain = respond(ThreeElement(scale.K1, scale.C1, scale.C2), t, KNOT_T, KNOT_D)
    exact = np.exp(RATE * np.interp(t, KNOT_T, KNOT_D)) * chain.force
    # The depth at the middle of a step of 2 ms for all of it: (a v h)^2 / 24 = 5e-9; and at the
    # corner, which no step straddles evenly, half of one step's growth, a v h / 8 = 4e-5.
    assert np.abs(force - exact).max() < 1e-4 * exact.max()
    inner = np.abs(t - 9.0) > 0.01
    assert np.abs(force - exact)[inner].max() < 1e-7 * exact.max()


def test_a_spring_that_stiffens_has_a_secant_whose_slope_grows_with_the_secant(
    driven: Callable, scale: Scale
) -> None:
    # d(F / H) / dH = a F / H for an elastic body, here K_p beside a chain of next to nothing.
    model = Model(('parallel_spring', 'exponential_stiffening'))
    t, force = _force(driven, model, [1e-3, 1e-6, 1e-6, 400.0, RATE])
    depth = np.interp(t, KNOT_T, KNOT_D)
    deep = (depth > 1e-3) & (t < 8.99)
    slope = np.diff(np.log(force[deep] / depth[deep])) / np.diff(depth[deep])
    # The chain's rest carries 1e-8 of the force; the logarithm's difference over 2.5 um makes
    # 1e-4 of it in the slope.
    assert np.abs(slope / RATE - 1.0).max() < 1e-3


def test_the_share_of_the_force_that_relaxes_is_the_same_at_any_depth(
    driven: Callable, scale: Scale
) -> None:
    base, model = Model(), Model(('exponential_stiffening',))
    values = [scale.K1, scale.C1, scale.C2]
    t, plain = _force(driven, base, values)
    _, stiff = _force(driven, model, [*values, RATE])
    hold = t > 9.01
    assert np.allclose(stiff[hold] / stiff[hold][0], plain[hold] / plain[hold][0], rtol=1e-12)


def test_an_object_that_the_tool_has_left_carries_no_force(driven: Callable, scale: Scale) -> None:
    model = Model(('exponential_stiffening',))
    trial = driven()
    theta = model.theta([scale.K1, scale.C1, scale.C2, RATE])
    force = model.predict(trial, theta, directions=False).force
    away = (trial.t[:-1] > 24.5) & (trial.t[1:] < 35.0)
    assert np.all(force[away] == 0.0)
    assert np.all(force[trial.t[1:] < 1.0] == 0.0)
