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

from hapticvision_ros.core.diagnosis.records import (
    Bootstrap,
    Candidate,
    Channel,
    Diagnosis,
    ErrorChange,
    ErrorChanges,
    Leftover,
    Leftovers,
    Misfit,
    Misfits,
    NextTrial,
    Phase,
)
from hapticvision_ros.core.fit.held_out import labels, PHASES
from hapticvision_ros.core.pipeline import CampaignAnalysis, FittedModel, TrialAnalysis
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

CHANNELS: Final[tuple[tuple[Channel, str], ...]] = (('force', 'N'), ('height', 'm'))
"""What is measured, and the unit of its residual."""


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
    names = {
        'train': dict(zip(labels(campaign.trials), bags, strict=True)),
        'held_out': dict(zip(labels(campaign.trials), bags, strict=True))
        if campaign.held_out_by == 'condition'
        else dict(zip(labels(campaign.held_out), held_out_bags, strict=True)),
    }
    change, changes = campaign.change, campaign.changes
    return {
        'schema': SCHEMA,
        'trials': trials,
        'noise': {
            'force_N': _number(campaign.noise.force.value),
            'height_m': _number(campaign.noise.height.value),
        },
        'before': _model(campaign.before, names),
        'diagnosis': None if campaign.diagnosis is None else _diagnosis(campaign.diagnosis),
        'after': None if campaign.after is None else _model(campaign.after, names),
        'held_out_by': campaign.held_out_by,
        'held_out_change': None
        if change is None
        else {
            'ratio': _number(change.ratio),
            'change': _number(change.change),
            # Of a single trial nothing tells it.
            'std': _number(change.std) if change.std else None,
            'parts': [] if changes is None else _changes(changes, names['held_out']),
        },
        'warnings': list(campaign.warnings),
    }


def _changes(changes: ErrorChanges, bags: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return by how much the error changes by channel, phase and trial."""
    found: list[tuple[Channel, str | None, Phase | None, ErrorChange]] = [
        (channel, None, None, one) for channel, one in changes.total.items()
    ]
    found += [(channel, None, phase, one) for (channel, phase), one in changes.by_phase.items()]
    found += [(channel, bags[of], None, one) for (of, channel), one in changes.by_trial.items()]
    return [
        {
            'channel': channel,
            'bag': bag,
            'phase': phase,
            'chi2': _number(one.chi2),
            'std': _number(one.std),
        }
        for channel, bag, phase, one in found
    ]


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


def _model(fitted: FittedModel, names: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """Return the entry of a fitted model; `names` has the bag of each trial's label."""
    sides = {'train': fitted.train, 'held_out': fitted.held_out}
    return {
        'model': fitted.model.name,
        'parameters': {
            name: {
                'value': _number(estimate.value),
                'std': _number(estimate.std),
                'unit': fitted.units[name],
                'identifiable': estimate.known,
            }
            for name, estimate in fitted.parameters.items()
        },
        'correlation': None
        if fitted.fit is None
        else [[_number(one) for one in row] for row in fitted.fit.correlation.tolist()],
        'error': {
            **{side: None if of is None else _error(of.total) for side, of in sides.items()},
            'percent_of_range': {
                side: None
                if of is None
                else {channel: _percent(of.total.get(channel)) for channel, _ in CHANNELS}
                for side, of in sides.items()
            },
            'by_phase': {
                side: None if of is None else _by_phase(of) for side, of in sides.items()
            },
            'by_trial': {
                side: None if of is None else _by_trial(of, names[side])
                for side, of in sides.items()
            },
        },
        'residual': None if fitted.left is None else _residual(fitted.left, names['train']),
    }


def _residual(left: Leftovers, bags: Mapping[str, str]) -> dict[str, Any]:
    """Return the entry of what a model leaves; `bags` has the bag of each trial's label."""
    units = dict(CHANNELS)
    parts = [_leftover(of, channel, None, None) for channel, of in left.total.items()]
    parts += [
        _leftover(of, channel, None, phase) for (channel, phase), of in left.by_phase.items()
    ]
    parts += [
        _leftover(of, channel, bags[label], None) for (label, channel), of in left.by_trial.items()
    ]
    return {
        'noise': [
            {
                'channel': channel,
                f'white_{units[channel]}': _number(of.white),
                f'slow_{units[channel]}': _number(of.slow),
                'correlation_time_s': _number(of.correlation_time),
                f'wander_{units[channel]}': _number(of.wander),
            }
            for channel, of in left.noise.items()
        ],
        'parts': parts,
        'smooth': [
            {
                'channel': curve.channel,
                'bag': bags[curve.trial],
                'phase': curve.phase,
                'time_s': [_number(t) for t in curve.t],
                f'value_{units[curve.channel]}': [_number(one) for one in curve.value],
                f'std_{units[curve.channel]}': [_number(one) for one in curve.std],
            }
            for curve in left.curves
        ],
    }


def _leftover(
    of: Leftover, channel: Channel, bag: str | None, phase: Phase | None
) -> dict[str, Any]:
    """Return the entry of what is left of one channel in one trial or phase, or in all."""
    return {
        'channel': channel,
        'bag': bag,
        'phase': phase,
        'size': _number(of.size),
        'neighbours': _number(of.neighbours),
        'white_p': _number(of.white),
        'smooth_p': _number(of.smooth),
        'smooth_share': _number(of.share),
        'depth_correlation': None if of.depth is None else _number(of.depth.correlation),
        'depth_lag_s': None if of.depth is None else _number(of.depth.lag),
        'depth_p': None if of.depth is None else _number(of.depth.chance),
        'speed_correlation': None if of.speed is None else _number(of.speed.correlation),
        'speed_lag_s': None if of.speed is None else _number(of.speed.lag),
        'speed_p': None if of.speed is None else _number(of.speed.chance),
        'order_correlation': None if of.order is None else _number(of.order.correlation),
        'order_p': None if of.order is None else _number(of.order.chance),
    }


def _error(of: Mapping[Channel, Misfit]) -> dict[str, float | None]:
    """Return the entry of the errors on some samples; null without any in that channel."""
    values = {
        f'{channel}_rmse_{unit}': _number(of[channel].rmse) if channel in of else None
        for channel, unit in CHANNELS
    }
    values |= {
        f'{channel}_chi2': _number(of[channel].chi2) if channel in of else None
        for channel, _ in CHANNELS
    }
    return values


def _percent(misfit: Misfit | None) -> float | None:
    """Return an error in percent of the range of what was measured."""
    return None if misfit is None else _number(misfit.percent_of_range)


def _detail(of: Mapping[Channel, Misfit]) -> dict[str, float | None]:
    """Return the entry of the errors on a part of the samples, with their percentages."""
    percent = {f'{channel}_percent_of_range': _percent(of.get(channel)) for channel, _ in CHANNELS}
    return _error(of) | percent


def _by_phase(of: Misfits) -> dict[str, dict[str, float | None]]:
    """Return the errors in each phase that has samples."""
    found = {
        phase: {c: of.by_phase[c, phase] for c, _ in CHANNELS if (c, phase) in of.by_phase}
        for phase in PHASES
    }
    return {phase: _detail(misfit) for phase, misfit in found.items() if misfit}


def _by_trial(of: Misfits, bags: Mapping[str, str]) -> list[dict[str, Any]]:
    """Return the errors in each trial that could be compared."""
    found = {
        label: {c: of.by_trial[label, c] for c, _ in CHANNELS if (label, c) in of.by_trial}
        for label in bags
    }
    return [{'bag': bags[label], **_detail(misfit)} for label, misfit in found.items() if misfit]


def _diagnosis(found: Diagnosis) -> dict[str, Any]:
    """Return the entry of the diagnosis."""
    rest = found.unexplained
    return {
        'status': found.status,
        'effects': list(found.effects),
        'sets': [list(each) for each in found.sets],
        'not_testable': list(found.not_testable),
        'laws': list(found.laws),
        'tool_height_late_s': _number(found.late),
        'look_alikes': [[one, other, _number(cos)] for one, other, cos in found.look_alikes],
        'ranking': [_candidate(candidate) for candidate in found.ranking],
        'unexplained': None
        if rest is None
        else {'share_of_chi2': _number(rest.share_of_chi2), 'where': list(rest.where)},
        'next_trial': None if found.advice is None else _next_trial(found.advice),
        'bootstrap': None if found.bootstrap is None else _bootstrap(found.bootstrap),
    }


def _candidate(candidate: Candidate) -> dict[str, Any]:
    """Return the entry of one effect of the ranking."""
    return {
        'effect': candidate.effect,
        'score': _number(candidate.score),
        'delta_bic': _number(candidate.delta_bic),
        'held_out_ratio': _number(candidate.held_out_ratio),
        'strength': None if candidate.strength is None else _number(candidate.strength),
    }


def _next_trial(trial: NextTrial) -> dict[str, Any]:
    """Return the entry of the trial to push next."""
    return {
        'push_speed_m_s': _number(trial.push_speed),
        'depth_m': _number(trial.depth),
        'hold_s': _number(trial.hold_time),
        'repeats': trial.repeats,
        'separates': list(trial.separates),
        'gain': _number(trial.gain),
        'reason': trial.reason,
    }


def _bootstrap(found: Bootstrap) -> dict[str, Any]:
    """Return the entry of what chance does."""
    return {
        'campaigns': found.campaigns,
        'false_alarms': found.false_alarms,
        'p_value': _number(found.p_value),
    }


def _number(value: float | None) -> float | None:
    """Return a plain number; None for one that is missing or not finite."""
    return float(value) if value is not None and math.isfinite(value) else None
