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
from hapticvision_ros.report.misses import verdicts
from hapticvision_ros.report.quantities import display_unit, UnitSystem


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    fit = campaign.before
    shown = {
        name: cell(estimate, display_unit(fit.units[name], units))
        for name, estimate in fit.parameters.items()
    }
    known = [f'{name} = {one.text}' for name, one in shown.items() if one.known]
    unknown = [f'{name} ({one.note})' for name, one in shown.items() if not one.known]
    by_paper = sum(analysis.paper.K1.known for analysis in campaign.trials)
    return {
        'trial_count': len(campaign.trials),
        'held_out_count': len(campaign.held_out),
        'identified_count': by_paper,
        'known': known,
        'unknown': unknown,
        'verdicts': verdicts(campaign, units),
    }
