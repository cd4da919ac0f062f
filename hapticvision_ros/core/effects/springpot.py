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

"""
Fractional element in place of the dashpot C2.

Its creep under a constant force, t^alpha / (c Gamma(1 + alpha)), is realised as a sum of
exponentials, that is of Kelvin-Voigt units in series: the trapezoidal rule in x = ln s on

    ``t^alpha / Gamma(1 + alpha)
    = sin(pi alpha) / pi * integral of (1 - exp(-t e^x)) e^(-alpha x) dx``,

which converges exponentially in the step. The two ends of the sum are geometric series: the slow
one is a dashpot, the fast one a spring. With 16 units the creep is that of the springpot within
0.1 % from 1 ms to 1000 s.

References
----------
G. Beylkin and L. Monzon, Appl. Comput. Harmon. Anal. 28, 2010, 131-149,
doi:10.1016/j.acha.2009.08.011 (powers by sums of exponentials).

"""

from collections.abc import Sequence
from typing import Final

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot
import numpy as np

REFERENCE_TIME: Final = 10.0
"""Time [s] at which the element has the viscosity C2: F = C2 t_ref^(alpha - 1) D^alpha y."""

_STEP: Final = 1.25
_NODES: Final = _STEP * np.arange(-8, 8)
"""ln of the inverse retardation times of the units [ln(1/s)]."""
_TIMES: Final = np.exp(-_NODES)
_SMALLEST: Final = 1e-12
"""Distance from alpha = 1, where the units would be infinitely stiff."""


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    alpha = values[0]
    left = 1.0 - alpha
    if left.real < _SMALLEST:
        left = _SMALLEST + 1j * left.imag
    share = np.sin(np.pi * left) / np.pi * _STEP
    viscosity = draft.slots[Slot.C2] * REFERENCE_TIME**-left
    below, above = _NODES[0] - _STEP, _NODES[-1] + _STEP
    flow = share * np.exp(left * below) / -np.expm1(-left * _STEP)
    jump = share * np.exp(-alpha * above) / -np.expm1(-alpha * _STEP)
    stiffness = viscosity / share * np.exp(alpha * _NODES)
    draft.units += zip(stiffness.tolist(), (stiffness * _TIMES).tolist(), strict=True)
    draft.slots[Slot.C2] = viscosity / flow
    draft.add(Slot.SERIES_COMPLIANCE, jump / viscosity)


EFFECT = Effect(
    name='springpot',
    title='Springpot',
    kind='object',
    sketch="""
    ---- (K1 || C1) ---- <C2, alpha> ----      F = C2 t_ref^(alpha - 1) d^alpha y / dt^alpha
    """,
    parameters=(
        EffectParameter(
            'alpha',
            '-',
            'order of the derivative: 1 a dashpot, towards 0 a spring; C2 holds at 10 s',
            0.05,
            1.0,
            lambda scale: 0.8,
            neutral=1.0,
        ),
    ),
    validity='Steps of 1 ms and more, trials of up to 1000 s.',
    signature=(
        'The decay in the hold is a power law: fast at first and ever slower, with no time '
        'constant of its own.'
    ),
    source='R. C. Koeller, J. Appl. Mech. 51, 1984, 299-307, doi:10.1115/1.3167616.',
    shape=_shape,
    excludes=('yield_force', 'shear_thinning'),
)
