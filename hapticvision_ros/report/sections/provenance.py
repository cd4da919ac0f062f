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


"""Where the data come from, and whose they are."""

from collections.abc import Mapping
from datetime import datetime, timedelta, UTC
from typing import Final

from hapticvision_ros.core.pipeline import CampaignAnalysis
from hapticvision_ros.core.records import Trial
from hapticvision_ros.report.quantities import format_quantity, UnitSystem

_EPOCH: Final = datetime(1970, 1, 1, tzinfo=UTC)
_SOURCES: Final = {
    'topic': 'its own topic',
    'points': 'the range sensor’s points',
    'tool': 'the tool alone',
    'none': 'not recorded',
}


def fill(campaign: CampaignAnalysis, units: UnitSystem) -> Mapping[str, object]:
    """Return what the template shows."""
    return {
        'trials': [
            _facts(analysis.trial, units) for analysis in (*campaign.trials, *campaign.held_out)
        ]
    }


def _facts(trial: Trial, units: UnitSystem) -> Mapping[str, object]:
    force = trial.force
    span = float(force.t[-1] - force.t[0]) if len(force) else 0.0
    first = _EPOCH + timedelta(microseconds=trial.start_ns // 1000)
    return {
        'name': trial.name,
        'facts': [
            ('first stamp', f'{first:%Y-%m-%d %H:%M:%S} UTC'),
            ('force', f'{len(force)} samples in {format_quantity(span, units["time"])}'),
            ('displacement height from', _SOURCES[trial.displacement_source]),
            *trial.provenance.items(),
        ],
    }
