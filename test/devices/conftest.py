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

"""What the tests of the devices share."""

from collections.abc import Callable
import time
from typing import Any

from hapticvision_ros.core.devices import WrenchSample
import pytest

PATIENCE = 20.0
"""Longest wait for something that takes well under a second [s]."""


@pytest.fixture
def read_until() -> Callable[..., list[WrenchSample]]:
    """Return a function that reads a load cell until a condition on what it has read holds."""

    def read(
        cell: Any, condition: Callable[[list[WrenchSample]], Any], timeout: float = 5.0
    ) -> list[WrenchSample]:
        samples: list[WrenchSample] = []
        deadline = time.monotonic() + PATIENCE
        while not condition(samples):
            assert time.monotonic() < deadline, f'not after {len(samples)} readings'
            samples.extend(cell.read(timeout))
        return samples

    return read
