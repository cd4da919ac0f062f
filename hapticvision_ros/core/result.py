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

"""The content of ``result.json``, schema ``hapticvision/result/1``."""

from collections.abc import Mapping, Sequence
import math
from typing import Any, Final

from hapticvision_ros.core.fit.waveform import ModelError, ModelFit
from hapticvision_ros.core.pipeline import CampaignAnalysis, TrialAnalysis
from hapticvision_ros.core.records import Estimate

SCHEMA: Final = 'hapticvision/result/1'

PAPER_KEYS: Final = (
    ('tau_s', 'relaxation_time'),
    ('F0_N', 'F0'),
    ('Finf_N', 'F_inf'),
    ('gamma_s', 'retardation_time'),
    ('H0_m', 'H0'),
    ('Hinf_m', 'H_inf'),
    ('K1_N_m', 'K1'),
    ('C1_Ns_m', 'C1'),
    ('C2_Ns_m', 'C2'),
)
"""Key in the file and name of the estimate of the paper's method."""


def result_document(
    campaign: CampaignAnalysis, bags: Sequence[str], held_out_bags: Sequence[str] = ()
) -> dict[str, Any]:
    """
    Return an analysis as the document that ``result.json`` holds.

    Parameters
    ----------
    campaign : CampaignAnalysis
        The analysis.
    bags, held_out_bags : sequence of str
        What to call its trials and its held-out trials, in their order.

    Returns
    -------
    dict
        Numbers, strings, lists and dicts only; every number is finite, and what the data cannot
        tell is None with its reason among the warnings.

    """
    trials = [
        _trial(analysis, bag, ()) for analysis, bag in zip(campaign.trials, bags, strict=True)
    ]
    trials += [
        _trial(analysis, bag, ('held out: the model was not fitted to this trial',))
        for analysis, bag in zip(campaign.held_out, held_out_bags, strict=True)
    ]
    return {
        'schema': SCHEMA,
        'trials': trials,
        'noise': {
            'force_N': _number(campaign.noise.force.value),
            'height_m': _number(campaign.noise.height.value),
        },
        'before': _model(campaign.before),
        'diagnosis': None,
        'after': None,
        'warnings': list(campaign.warnings),
    }


def estimate_warnings(estimates: Mapping[str, Estimate]) -> list[str]:
    """Return one sentence for each reason why estimates are unknown or doubtful."""
    names: dict[tuple[str, bool], list[str]] = {}
    for name, estimate in estimates.items():
        if estimate.reason is not None:
            names.setdefault((estimate.reason, estimate.known), []).append(name)
    return [
        f'{", ".join(of)} {"with caution" if known else "unknown"}: {reason}'
        for (reason, known), of in names.items()
    ]


def _trial(analysis: TrialAnalysis, bag: str, warnings: Sequence[str]) -> dict[str, Any]:
    """Return the entry of one trial."""
    phases = analysis.segmentation
    estimates: dict[str, Estimate] = {
        key: getattr(analysis.paper, name) for key, name in PAPER_KEYS
    }
    return {
        'bag': bag,
        'push_speed_m_s': _number(phases.push_speed),
        'depth_m': _number(phases.depth),
        't_contact_s': _number(phases.t_contact),
        't_hold_s': _number(phases.t_hold),
        't_release_s': _number(phases.t_release),
        'paper': {key: _number(estimate.value) for key, estimate in estimates.items()},
        'paper_std': {key: _number(estimate.std) for key, estimate in estimates.items()},
        'warnings': [*warnings, *analysis.warnings, *estimate_warnings(estimates)],
    }


def _model(fit: ModelFit) -> dict[str, Any]:
    """Return the entry of a fitted model."""
    return {
        'model': fit.model,
        'parameters': {
            name: {
                'value': _number(estimate.value),
                'std': _number(estimate.std),
                'unit': fit.units[name],
                'identifiable': estimate.known,
            }
            for name, estimate in fit.parameters.items()
        },
        'error': {'train': _error(fit.train), 'held_out': _error(fit.held_out)},
    }


def _error(error: ModelError | None) -> dict[str, float | None] | None:
    """Return the entry of the errors on one set of trials."""
    if error is None:
        return None
    return {
        'force_rmse_N': _number(error.force_rmse),
        'height_rmse_m': _number(error.height_rmse),
        'force_chi2': _number(error.force_chi2),
        'height_chi2': _number(error.height_chi2),
    }


def _number(value: float | None) -> float | None:
    """Return a plain number; None for one that is missing or not finite."""
    return float(value) if value is not None and math.isfinite(value) else None
