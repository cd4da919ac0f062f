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

"""What the models leave of the residual, in plain words."""

from typing import Final

from hapticvision_ros.core.diagnosis.records import Goes, Leftover
from hapticvision_ros.core.pipeline import CampaignAnalysis, CHANNEL_NAMES
from hapticvision_ros.report.misses import ROUGH, short_name
from hapticvision_ros.report.quantities import format_number, format_quantity, UnitSystem

_CHANCE: Final = 1e-3
"""Chance below which a residual is not taken for white, smooth parts or correlations for none."""
_LOUD: Final = 1.1
"""Size from which on it is not for noise that is known a little worse."""


def is_coloured(left: Leftover) -> bool:
    """Return whether what is left is more alike from one mean to the next than white noise."""
    return left.white is not None and left.white < _CHANCE


def is_smooth(left: Leftover) -> bool:
    """Return whether smooth curves take more out of it than out of white noise."""
    return left.smooth is not None and left.smooth < _CHANCE


def goes(with_it: Goes | None) -> bool:
    """Return whether it goes with something by more than chance."""
    return with_it is not None and with_it.chance < _CHANCE


def residual_sentences(campaign: CampaignAnalysis, units: UnitSystem) -> list[str]:
    """
    Return what the last model leaves of each channel, one sentence each.

    Parameters
    ----------
    campaign : CampaignAnalysis
        The trials and the fits.
    units : mapping of str to Unit
        Units of display.

    Returns
    -------
    list of str
        Nothing of a channel without noise or samples.

    """
    model = campaign.before if campaign.after is None else campaign.after
    if model.left is None:
        return []
    return [
        _sentence(left, CHANNEL_NAMES[channel], short_name(model), units)
        for channel, left in model.left.total.items()
    ]


def _sentence(left: Leftover, what: str, model: str, units: UnitSystem) -> str:
    size = _number(left.size)
    known = []
    if is_coloured(left) and left.neighbours is not None:
        known.append(f'is not white (one mean goes with the next by {_number(left.neighbours)})')
    if is_smooth(left) and left.share is not None:
        share = _number(100.0 * left.share)
        known.append(f'is smooth over the phases by {share}\u00a0%')
    for name, with_it in (('depth', left.depth), ('speed', left.speed)):
        if with_it is not None and goes(with_it):
            known.append(f'goes with the {name} of the tool by {_with(with_it, units)}')
    if left.order is not None and goes(left.order):
        known.append(f'goes with the order of the trials by {_number(left.order.correlation)}')
    text = f'What the {model} model leaves of the {what}, whitened, is {size} times its noise'
    if left.white is None:
        return f'{text}; there are too few means of samples to tell more.'
    if not known and left.size > _LOUD:
        return f'{text}; nothing but its size tells it from white noise.'
    if not known:
        return f'{text}; nothing in it tells it from white noise.'
    return f'{text}; it {", ".join(known)}.'


def _with(with_it: Goes, units: UnitSystem) -> str:
    """Return a correlation, and by how much the residual comes later, if it does."""
    text = _number(with_it.correlation)
    if with_it.lag == 0.0:
        return text
    size = format_quantity(abs(with_it.lag), units['time'], digits=ROUGH)
    return f'{text} ({size} {"later" if with_it.lag > 0.0 else "earlier"})'


def _number(value: float) -> str:
    return format_number(value, digits=ROUGH)
