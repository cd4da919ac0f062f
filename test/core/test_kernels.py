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

"""Kernels work wherever the package is installed."""

from hapticvision_ros.core.kernels import kernel
from numba.core import caching
import pytest


def _double(x: float) -> float:
    return 2.0 * x


def test_a_kernel_works_where_no_cache_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CompileResultCacheImpl, '_locator_classes', [])
    assert kernel()(_double)(1.5) == 3.0


def test_a_kernel_keeps_what_is_compiled_and_frees_the_interpreter() -> None:
    compiled = kernel(error_model='numpy')(_double)
    assert compiled.targetoptions['nogil']
    assert compiled._cache.cache_path
