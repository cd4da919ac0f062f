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


"""The minimum of a function without derivatives."""

from hapticvision_ros.core.fit.simplex import minimum
from hapticvision_ros.core.records import FloatArray
import numpy as np
import pytest


def valley(x: FloatArray) -> float:
    """Return Rosenbrock's function, whose minimum is at (1, 1)."""
    return float(100.0 * (x[1] - x[0] ** 2) ** 2 + (1.0 - x[0]) ** 2)


def test_a_curved_valley_is_followed_to_its_end() -> None:
    least, point = minimum(
        valley, np.array([-1.2, 1.0]), np.full(2, 0.5), enough=1e-10, near=1e-6, turns=300
    )
    assert least < 1e-8
    assert pytest.approx([1.0, 1.0], abs=1e-4) == point


def test_a_search_without_hope_is_given_up() -> None:
    asked = list[tuple[int, float]]()

    def hopeful(turn: int, best: float) -> bool:
        asked.append((turn, best))
        return turn < 3

    least, point = minimum(valley, np.array([-1.2, 1.0]), np.full(2, 0.5), hopeful=hopeful)
    assert [turn for turn, _ in asked] == [0, 1, 2, 3]
    assert asked[-1][1] == least == valley(point)
