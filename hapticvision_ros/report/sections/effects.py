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

"""What the names of effects on the page stand for."""

from collections.abc import Mapping

from hapticvision_ros.core.diagnosis.records import Diagnosis
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.effects.declaration import without_law
from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.quantities import display_unit, UnitSystem


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    named = set[str]()
    if campaign.diagnosis is not None:
        named |= _named(campaign.diagnosis)
    if campaign.after is not None:
        named |= {without_law(name) for name in campaign.after.model.effects}
    return {
        'effects': [
            {
                'name': effect.name,
                'title': effect.title,
                'signature': effect.signature,
                'validity': effect.validity,
                'source': effect.source,
                'parameters': [
                    (
                        each.symbol,
                        display_unit(each.unit, units).symbol,
                        each.meaning,
                    )
                    for each in effect.parameters
                ],
            }
            for effect in EFFECTS
            if effect.name in named
        ]
    }


def _named(found: Diagnosis) -> set[str]:
    """Return the effects that a diagnosis names."""
    alike = {name for one, other, _ in found.look_alikes for name in (one, other)}
    ranked = {each.effect for each in found.ranking}
    return {*alike, *ranked, *found.not_testable, *(name for of in found.sets for name in of)}
