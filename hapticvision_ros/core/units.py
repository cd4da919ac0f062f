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

"""Units of the outside world, converted at its border: SI inside (REP-103)."""

from types import MappingProxyType
from typing import Final

STANDARD_GRAVITY: Final = 9.80665
"""Standard acceleration of free fall [m/s^2] (CGPM 1901): 1 kgf = 9.80665 N."""

POUND: Final = 0.45359237
"""Avoirdupois pound [kg] (international yard and pound agreement, 1959)."""

TIME_UNITS: Final = MappingProxyType({'s': 1.0, 'ms': 1e-3, 'min': 60.0})
FORCE_UNITS: Final = MappingProxyType(
    {
        'N': 1.0,
        'mN': 1e-3,
        'kN': 1e3,
        'gf': 1e-3 * STANDARD_GRAVITY,
        'kgf': STANDARD_GRAVITY,
        'lbf': POUND * STANDARD_GRAVITY,
    }
)
LENGTH_UNITS: Final = MappingProxyType({'m': 1.0, 'cm': 1e-2, 'mm': 1e-3, 'um': 1e-6})
AREA_UNITS: Final = MappingProxyType({'m2': 1.0, 'cm2': 1e-4, 'mm2': 1e-6})

MM: Final = LENGTH_UNITS['mm']
KGF_PER_MM: Final = FORCE_UNITS['kgf'] / MM
"""1 kgf/mm [N/m]; also 1 kgf.s/mm [N.s/m]: the units of the paper's Tables 1 and 3."""
LARGEST: Final = 10.0
"""Length and area of what is pressed [m, m^2]: more has been meant in another unit."""
