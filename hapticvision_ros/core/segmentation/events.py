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

"""What the segmenters take and what the online one says."""

from dataclasses import dataclass
from typing import Literal

type PhaseName = Literal['approach', 'push', 'hold', 'release', 'recover']
type EventKind = Literal['contact', 'hold', 'release', 'loss', 'step']


@dataclass(frozen=True, slots=True)
class SegmentationOptions:
    """
    What counts as an event, relative to the noise and the size of the trial.

    Parameters
    ----------
    contact_sigmas : float
        Force above its baseline [noise standard deviations] that is a contact.
    rest_band : float
        Band [fraction of the travel since contact] within which a tool that stays is at rest.
    rest_slowdown : float
        A tool is at rest once it takes this many times longer to cross the band than it did
        while pushing.
    loss_fraction : float
        Force [fraction of its peak] below which, noise aside, a withdrawn tool is free.

    Raises
    ------
    ValueError
        If a number is out of its range.

    """

    contact_sigmas: float = 6.0
    rest_band: float = 0.01
    rest_slowdown: float = 5.0
    loss_fraction: float = 0.015

    def __post_init__(self) -> None:
        if self.contact_sigmas <= 0.0 or self.rest_slowdown <= 1.0:
            raise ValueError('contact_sigmas is above 0 and rest_slowdown above 1')
        if not (0.0 < self.rest_band < 0.5 and 0.0 < self.loss_fraction < 0.5):
            raise ValueError('rest_band and loss_fraction are fractions between 0 and 0.5')


@dataclass(frozen=True, slots=True)
class PhaseEvent:
    """
    A change of phase that the online segmenter has seen.

    Parameters
    ----------
    kind : {'contact', 'hold', 'release', 'loss', 'step'}
        What happened; 'step': the tool pushes on after a hold, the phase is 'push' again.
    t : float
        When it happened [s].
    detected_at : float
        Time of the sample that showed it [s].

    """

    kind: EventKind
    t: float
    detected_at: float
