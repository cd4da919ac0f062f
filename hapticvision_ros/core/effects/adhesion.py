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

"""The object holds the tool back on withdrawal."""

from collections.abc import Sequence
from dataclasses import replace
import math
from typing import Final

from hapticvision_ros.core.effects.declaration import Draft, DrivenTrial, Effect, EffectParameter
from hapticvision_ros.core.models.chain import Slot
import numpy as np

_PULLS: Final = (
    *np.geomspace(0.1, 0.6, 16).tolist(),
    *np.geomspace(0.615, 1.6, 40).tolist(),
    *np.geomspace(1.78, 3.3, 6).tolist(),
)
"""
Pull-off forces that are tried, over the pull that is seen. An object that springs back faster than
the tool withdraws is let go several times, and the force that does so is known to a few percent.
"""


_PULLED: Final = (0.6, 0.85, 0.95, 1.0, 1.05, 1.2)
"""Those of a zone that goes on to pull, whose force shows for a while."""
_FADING: Final = (0.6, 0.8, 1.0, 1.25)
"""Those of a zone whose pull fades as it opens."""
_OPENINGS: Final = (0.5, 0.8, 0.93, 1.0, 1.07, 1.25, 2.0)
"""Openings of it that are tried, over the one that is seen."""
_WIDEST: Final = 1.0
"""
Opening [m] beyond which no tool goes: a search that finds a pull which does not fade is not led
astray by how little more the trials say.
"""


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.ADHESION, values[0])


def _zone(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.ADHESION, values[0])
    draft.add(Slot.OPENING, values[1])


def _fading(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    draft.add(Slot.ADHESION, values[0])
    draft.add(Slot.DECAY, values[1])


_AT_ONCE: Final = Effect(
    name='adhesion',
    title='Adhesion',
    kind='object',
    sketch="""
    contact ends where F < -F_ad, instead of where F < 0
    """,
    parameters=(
        EffectParameter(
            'F_ad',
            'N',
            'pull-off force',
            0.0,
            math.inf,
            lambda scale: max(scale.pull, 0.02 * scale.force),
            # Samples average the pull with what comes after it, noise makes it look larger, and
            # the force jumps past many values: between these a search does not find its way.
            scan=_PULLS,
        ),
    ),
    validity='A pull-off force that depends neither on the speed nor on the time in contact.',
    signature='The force is negative for a while when the tool withdraws.',
    source=(
        'K. L. Johnson, K. Kendall and A. D. Roberts, Proc. R. Soc. A 324, 1971, 301-313, '
        'doi:10.1098/rspa.1971.0141 (pull-off force).'
    ),
    shape=_shape,
)

EFFECT = replace(
    _AT_ONCE,
    laws=(
        _AT_ONCE.following(
            'cohesive_zone',
            sketch="""
    F = -F_ad from where F would fall below it until tool and surface are delta_c apart
    """,
            validity=(
                'A film, or necks of the object itself, that pull with a force that depends '
                'neither on how far they are drawn out nor on the speed.'
            ),
            source=(
                'D. S. Dugdale, J. Mech. Phys. Solids 8, 1960, 100-104, '
                'doi:10.1016/0022-5096(60)90013-2 (constant traction up to an opening); D. '
                'Maugis, J. Colloid Interface Sci. 150, 1992, 243-269, '
                'doi:10.1016/0021-9797(92)90285-T (as adhesion).'
            ),
            shape=_zone,
            parameters=(
                replace(
                    _AT_ONCE.parameters[0],
                    guess=lambda scale: scale.held_back or max(scale.pull, 0.02 * scale.force),
                    scan=_PULLED,
                ),
                EffectParameter(
                    'delta_c',
                    'm',
                    'opening between tool and surface at which the pull ends',
                    0.0,
                    _WIDEST,
                    lambda scale: scale.opening or 0.05 * scale.depth,
                    scan=_OPENINGS,
                ),
            ),
        ),
        _AT_ONCE.following(
            'fading_zone',
            sketch="""
    F = -F_ad exp(-g / delta_e) from where F would fall below it; g: how far tool and surface
    are apart
    """,
            validity=(
                'Threads, a liquid, or a rough and tacky contact that lets go bit by bit: a pull '
                'that depends on how far it is drawn out and not on the speed; what came apart by '
                'twenty times delta_e does not hold again.'
            ),
            source=(
                'X.-P. Xu and A. Needleman, J. Mech. Phys. Solids 42, 1994, 1397-1434, '
                'doi:10.1016/0022-5096(94)90003-5 (exponential law of an interface; here from its '
                'largest traction on).'
            ),
            shape=_fading,
            parameters=(
                replace(_AT_ONCE.parameters[0], scan=_FADING),
                EffectParameter(
                    'delta_e',
                    'm',
                    'opening between tool and surface over which the pull falls to 1/e',
                    0.0,
                    _WIDEST,
                    lambda scale: scale.opening or 0.05 * scale.depth,
                    scan=_OPENINGS,
                ),
            ),
        ),
    ),
)
