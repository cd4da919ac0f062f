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

"""Robotic texture analyser: rheological parameters from touch and sight."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hapticvision_ros.api import (
        Campaign,
        classify,
        describe,
        export,
        Fit,
        fit,
        haptic,
        HapticStepper,
        Model,
        profile_intervals,
        Specimen,
        Trial,
    )

__all__ = [
    'Campaign',
    'Fit',
    'HapticStepper',
    'Model',
    'Specimen',
    'Trial',
    'classify',
    'describe',
    'export',
    'fit',
    'haptic',
    'profile_intervals',
]


def __getattr__(name: str) -> object:
    """Import the names of the notebook when they are asked for: a node needs none of them."""
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from hapticvision_ros import api

    return getattr(api, name)
