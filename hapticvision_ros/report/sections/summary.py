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


"""What was found, in plain sentences."""

from collections.abc import Mapping

from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.cells import cell
from hapticvision_ros.report.findings import findings
from hapticvision_ros.report.misses import held_out_sentences, verdicts
from hapticvision_ros.report.quantities import display_unit, UnitSystem


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    model = campaign.before if campaign.after is None else campaign.after
    cells = {
        name: cell(estimate, display_unit(model.units[name], units))
        for name, estimate in model.parameters.items()
    }
    diagnosis = campaign.diagnosis
    return {
        'trial_count': len(campaign.trials),
        'held_out_count': len(campaign.held_out),
        'identified_count': sum(one.paper.K1.known for one in campaign.trials),
        'model': model.model.name,
        'known': [f'{name} = {one.text}' for name, one in cells.items() if one.known],
        'unknown': [f'{name} ({one.note})' for name, one in cells.items() if not one.known],
        'answer': None if diagnosis is None else findings(diagnosis, units)[0],
        'verdicts': [*verdicts(campaign, units), *held_out_sentences(campaign, units)],
    }
