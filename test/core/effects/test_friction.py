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


"""Friction that a tool at rest keeps, on paths as encoders tell them."""

from collections.abc import Callable
from dataclasses import replace

from hapticvision_ros.core.composition import Model
import numpy as np
import pytest

K1, C1, C2, F_C = 2000.0, 1600.0, 4000.0, 0.3


@pytest.mark.parametrize(('back', 'kept'), [(0.0, 1.0), (2e-7, 1.0), (4e-5, -1.0)])
@pytest.mark.parametrize('law', ['held', 'held_in_contact'])
def test_what_a_tool_at_rest_keeps_does_not_turn_with_a_path_that_swings(
    driven: Callable, law: str, back: float, kept: float
) -> None:
    """A path that goes back within 10 ms after its stop: by nothing, by a hair, and really."""
    trial = driven(2e-3)
    knots = [0.0, 2.0, 4.0, 4.01, 20.0, 21.0, 30.0]
    way = np.array([-5e-3, 0.0, 5e-3, 5e-3 - back, 5e-3 - back, -5e-3, -5e-3])
    trial = replace(trial, displacement=np.interp(trial.t, knots, way))
    middle = 0.5 * (trial.t[1:] + trial.t[:-1])
    model = Model((f'friction:{law}',))
    with_it, without = (
        model.predict(trial, model.theta([K1, C1, C2, F]), directions=False).force
        for F in (F_C, 0.0)
    )
    felt = with_it - without
    assert felt[(middle > 2.1) & (middle < 3.9)] == pytest.approx(F_C)
    assert felt[(middle > 4.1) & (middle < 19.9)] == pytest.approx(kept * F_C)
    # The object, which has relaxed, lets go at once.
    gone = 0.0 if law == 'held_in_contact' else -F_C
    assert felt[(middle > 20.1) & (middle < 20.2)] == pytest.approx(gone)
