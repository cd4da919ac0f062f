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


"""What holds for all trials together and limits what the numbers mean."""

from collections.abc import Mapping

from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.report.quantities import UnitSystem


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows; those of one trial stand with its pictures."""
    return {
        'warnings': list(dict.fromkeys(campaign.warnings)),
        'trials': [
            (number, analysis.trial.name, len(set(analysis.warnings)))
            for number, analysis in enumerate((*campaign.trials, *campaign.held_out), start=1)
            if analysis.warnings
        ],
    }
