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

"""What the base model lacks."""

from collections.abc import Mapping

from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.findings import findings
from hapticvision_ros.report.quantities import format_number, UnitSystem


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    found = campaign.diagnosis
    if found is None:
        return {'found': False}
    return {
        'found': True,
        'sentences': findings(found, units),
        'sets': [
            (effect, ', '.join(name for name in alike if name != effect) or 'none')
            for effect, alike in zip(found.effects, found.sets, strict=True)
        ],
        'look_alikes': [
            (one, other, format_number(cosine, digits=3))
            for one, other, cosine in found.look_alikes
        ],
        'ranking': [
            (
                one.effect,
                format_number(one.score, digits=3),
                format_number(one.delta_bic, digits=3),
                'unknown'
                if one.held_out_ratio is None
                else format_number(one.held_out_ratio, digits=3),
                'not refitted' if one.strength is None else format_number(one.strength, digits=2),
                one.effect in found.effects,
            )
            for one in found.ranking
        ],
        'not_testable': list(found.not_testable),
        'warnings': list(dict.fromkeys(found.warnings)),
    }
