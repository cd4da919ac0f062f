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

"""``result.json`` against its schema, and the pipeline that fills it."""

from dataclasses import replace
import json
import math
from pathlib import Path
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis.records import (
    Bootstrap,
    Candidate,
    Diagnosis,
    NextTrial,
    Unexplained,
)
from hapticvision_ros.core.pipeline import (
    analyse,
    analyse_campaign,
    CampaignAnalysis,
    TrialAnalysis,
)
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.result import PAPER_KEYS, result_document
import numpy as np
import pytest

RESULT_PAGE = Path(__file__).parents[2] / 'doc' / 'result.md'
TRIAL_KEYS = {'bag', 'push_speed_m_s', 'depth_m', 't_contact_s', 't_hold_s', 't_release_s'}
TRIAL_KEYS |= {'paper', 'paper_std', 'warnings'}
ERROR_KEYS = {'force_rmse_N', 'height_rmse_m', 'force_chi2', 'height_chi2'}
DETAIL_KEYS = ERROR_KEYS | {'force_percent_of_range', 'height_percent_of_range'}
PARAMETER_KEYS = {'value', 'std', 'unit', 'identifiable'}
DIAGNOSIS_KEYS = {'status', 'effects', 'sets', 'not_testable', 'look_alikes', 'ranking', 'laws'}
DIAGNOSIS_KEYS |= {'unexplained', 'next_trial', 'bootstrap', 'tool_height_late_s'}
BASE, YIELD = Model(), Model(('yield_force',))


def _trial(speed: float = 0.005, seed: int = 0, *, release: bool = True) -> Trial:
    """Return a pushed, held and released object whose signals are the paper's two curves."""
    rng = np.random.default_rng(seed)
    t_hold, hold, top, depth = 1.0 + 0.008 / speed, 12.0, 0.040, 0.008
    t_release = t_hold + hold
    t_end = t_release + 8.0 if release else t_release
    t = np.arange(0.0, t_end, 0.005)
    force = np.where(
        t < t_hold,
        13.0 * np.clip(t - 1.0, 0.0, None) / (t_hold - 1.0),
        8.0 * np.exp(-(t - t_hold) / 2.0) + 5.0,
    )
    force[t >= t_release] = 0.0
    tool = np.interp(
        t,
        [0.0, 1.0, t_hold, t_release, t_release + 1.0],
        [top + speed, top, top - depth, top - depth, top + 0.02],
    )
    seen = (t < 1.0) | (t > t_release)
    height = np.where(t < 1.0, 0.0, 0.001 * np.exp(-(t - t_release) / 0.9) + 0.007)[seen]
    return Trial(
        name=f'trial_{seed}',
        start_ns=0,
        force=Signal(t, force + 0.2 + 0.01 * rng.standard_normal(t.size)),
        tool_height=Signal(t, tool + 1e-6 * rng.standard_normal(t.size)),
        displacement_height=Signal(t[seen], height + 2e-5 * rng.standard_normal(height.size)),
    )


@pytest.fixture(scope='module')
def analyses() -> tuple[TrialAnalysis, TrialAnalysis]:
    """Return two analysed trials."""
    return analyse(_trial(0.005, 1)), analyse(_trial(0.010, 2))


@pytest.fixture(scope='module')
def both(analyses: tuple[TrialAnalysis, TrialAnalysis]) -> CampaignAnalysis:
    """Return two trials with the base model and one more."""
    return analyse_campaign(analyses, model=YIELD)


@pytest.fixture(scope='module')
def held(analyses: tuple[TrialAnalysis, TrialAnalysis]) -> CampaignAnalysis:
    """Return one trial with the base model and one more, and one held out."""
    return analyse_campaign(analyses[:1], analyses[1:], model=YIELD)


def _diagnosed(campaign: CampaignAnalysis) -> CampaignAnalysis:
    """Return an analysis with a diagnosis that fills all its keys."""
    assert campaign.before.fit is not None
    assert campaign.after is not None and campaign.after.fit is not None
    found = Diagnosis(
        status='partly_explained',
        effects=('yield_force',),
        sets=(('yield_force', 'shear_thinning'),),
        not_testable=('ageing',),
        look_alikes=(('yield_force', 'shear_thinning', 0.98),),
        ranking=(
            Candidate('yield_force', 900.0, 890.0, 0.1, 3.0),
            Candidate('damage', 1.0, -8.0, None, None),
        ),
        unexplained=Unexplained(0.2, ('the hold of the force',)),
        next_trial=NextTrial(
            0.001, 0.005, 30.0, ('yield_force', 'shear_thinning'), 12.0, 'slow pushes differ most'
        ),
        before=campaign.before.fit,
        after=campaign.after.fit,
        warnings=('a warning of the diagnosis',),
        bootstrap=Bootstrap(50, 1, 0.02),
    )
    return replace(campaign, diagnosis=found)


def _numbers(node: Any) -> list[float]:
    """Return all numbers of a document."""
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        return [number for item in node for number in _numbers(item)]
    return [node] if isinstance(node, int | float) and not isinstance(node, bool) else []


def _check_model(model: Any, names: set[str]) -> None:
    """Compare the entry of a model with the contract."""
    assert set(model) == {'model', 'parameters', 'correlation', 'error', 'residual'}
    assert np.shape(model['correlation']) == 2 * (len(model['parameters']),)
    for row, parameter in enumerate(model['parameters'].values()):
        told = model['correlation'][row][row]
        assert told is None if parameter['value'] is None else told == pytest.approx(1.0)
    assert set(model['parameters']) == names
    for parameter in model['parameters'].values():
        assert set(parameter) == PARAMETER_KEYS
        assert parameter['identifiable'] == (parameter['value'] is not None)
    error = model['error']
    assert set(error) == {'train', 'held_out', 'percent_of_range', 'by_phase', 'by_trial'}
    for side in ('train', 'held_out'):
        assert set(error[side]) == ERROR_KEYS
        assert error['by_phase'][side].keys() >= {'push', 'hold', 'recover'}
        for phase in error['by_phase'][side].values():
            assert set(phase) == DETAIL_KEYS
        for trial in error['by_trial'][side]:
            assert set(trial) == {'bag', *DETAIL_KEYS}
    residual = model['residual']
    assert [one['channel'] for one in residual['noise']] == ['force', 'height']
    bags = [trial['bag'] for trial in error['by_trial']['train']]
    groups = [(one['channel'], one['bag'], one['phase']) for one in residual['parts']]
    assert len(set(groups)) == len(groups)
    for channel in ('force', 'height'):
        assert {(channel, None, None), (channel, None, 'recover')} <= set(groups)
        assert [bag for c, bag, _ in groups if c == channel and bag] == bags
    assert {one['bag'] for one in residual['smooth']} == set(bags)
    for one in residual['smooth']:
        unit = 'N' if one['channel'] == 'force' else 'm'
        assert len(one['time_s']) == len(one[f'value_{unit}']) == len(one[f'std_{unit}']) > 2


@pytest.mark.parametrize('named', [False, True], ids=['by condition', 'by name'])
def test_the_document_has_the_keys_of_the_schema_and_finite_numbers(
    both: CampaignAnalysis, held: CampaignAnalysis, named: bool
) -> None:
    campaign = _diagnosed(held if named else both)
    document = result_document(campaign, *([['a'], ['b']] if named else [['a', 'b']]))
    assert set(document) == {
        *('schema', 'trials', 'noise', 'before', 'diagnosis', 'after', 'warnings'),
        *('held_out_by', 'held_out_change'),
    }
    assert document['schema'] == 'hapticvision/result/1'
    assert [trial['bag'] for trial in document['trials']] == ['a', 'b']
    for trial in document['trials']:
        assert set(trial) == TRIAL_KEYS
        assert set(trial['paper']) == {key for key, _ in PAPER_KEYS} == set(trial['paper_std'])
    assert set(document['noise']) == {'force_N', 'height_m'}
    _check_model(document['before'], {'K1', 'C1', 'C2'})
    _check_model(document['after'], {'K1', 'C1', 'C2', 'F_y'})
    bags = [trial['bag'] for trial in document['before']['error']['by_trial']['held_out']]
    assert bags == (['b'] if named else ['a', 'b'])
    assert document['held_out_by'] == ('name' if named else 'condition')
    assert set(document['held_out_change']) == {'ratio', 'change', 'std', 'parts'}
    parts = document['held_out_change']['parts']
    for channel in ('force', 'height'):
        mine = {(one['bag'], one['phase']): one for one in parts if one['channel'] == channel}
        assert {(None, None), (None, 'recover'), *((bag, None) for bag in bags)} <= set(mine)
        chi2 = [
            document[model]['error']['held_out'][f'{channel}_chi2']
            for model in ('before', 'after')
        ]
        assert mine[None, None]['chi2'] == pytest.approx(chi2[1] - chi2[0], rel=0.02)
        assert all(one['std'] > 0.0 for one in mine.values())
    # A single trial does not tell it.
    assert (document['held_out_change']['std'] is None) == named
    found = document['diagnosis']
    assert set(found) == DIAGNOSIS_KEYS
    assert all(
        {'effect', 'score', 'delta_bic', 'held_out_ratio'} <= set(c) for c in found['ranking']
    )
    assert set(found['unexplained']) == {'share_of_chi2', 'where'}
    assert {'push_speed_m_s', 'depth_m', 'hold_s', 'separates'} <= set(found['next_trial'])
    numbers = _numbers(json.loads(json.dumps(document, allow_nan=False)))
    assert len(numbers) > 150
    assert all(math.isfinite(number) for number in numbers)


def test_chi_squared_is_the_error_over_the_noise_that_is_told(both: CampaignAnalysis) -> None:
    document = result_document(both, ['a', 'b'])
    for model in ('before', 'after'):
        for side in ('train', 'held_out'):
            error = document[model]['error'][side]
            for rmse, chi2, noise in (
                ('force_rmse_N', 'force_chi2', 'force_N'),
                ('height_rmse_m', 'height_chi2', 'height_m'),
            ):
                ratio = error[rmse] / document['noise'][noise]
                assert error[chi2] == pytest.approx(ratio**2)


def test_the_noise_is_that_of_the_sensors_though_both_models_are_wrong(
    both: CampaignAnalysis,
) -> None:
    # The signals were written down, so no model fits. 1 s before contact at 5 ms: 5 % each.
    assert both.noise.force.value == pytest.approx(0.01, rel=0.15)
    assert both.noise.height.value == pytest.approx(2e-5, rel=0.15)
    assert both.before.train is not None
    chi2 = both.before.train.total['force'].chi2
    assert chi2 is not None and chi2 > 100.0


def test_the_trial_through_its_own_phases_gives_what_it_was_made_of(
    both: CampaignAnalysis,
) -> None:
    document = result_document(both, ['a', 'b'])
    for trial, speed in zip(document['trials'], (0.005, 0.010), strict=True):
        paper = trial['paper']
        assert trial['push_speed_m_s'] == pytest.approx(speed, rel=0.01)
        # A sample of 5 ms more or less in T_s or T_e moves F0 by 0.3 % and H0 by 0.6 %; noise
        # adds less.
        assert paper['tau_s'] == pytest.approx(2.0, rel=0.01)
        assert paper['gamma_s'] == pytest.approx(0.9, rel=0.02)
        assert paper['K1_N_m'] == pytest.approx(5000.0, rel=0.02)
        assert paper['C1_Ns_m'] == pytest.approx(4500.0, rel=0.03)
        assert paper['C2_Ns_m'] == pytest.approx(5500.0, rel=0.03)


def test_a_fixed_model_has_no_diagnosis_and_a_warning_says_so(both: CampaignAnalysis) -> None:
    document = result_document(both, ['a', 'b'])
    assert document['diagnosis'] is None
    assert document['after']['model'] == 'three-element+yield_force'
    assert any('the model was fixed' in warning for warning in document['warnings'])


def test_the_base_model_alone_has_nothing_after_it(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses, model=BASE), ['a', 'b'])
    assert document['after'] is None and document['held_out_change'] is None
    assert document['before']['error']['held_out'] is not None


def test_one_trial_has_no_held_out_error_and_a_warning_says_why(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses[:1], model=YIELD), ['a'])
    for model in ('before', 'after'):
        assert document[model]['error']['held_out'] is None
    assert document['held_out_by'] is None and document['held_out_change'] is None
    assert any('held out' in warning for warning in document['warnings'])


def test_a_trial_held_out_is_listed_marked_and_compared_with(held: CampaignAnalysis) -> None:
    document = result_document(held, ['a'], ['b'])
    assert [trial['bag'] for trial in document['trials']] == ['a', 'b']
    assert document['trials'][1]['warnings'][0].startswith('held out')
    error = document['before']['error']
    assert set(error['held_out']) == ERROR_KEYS
    # The fit has seen only the first: it misses the second by more.
    assert error['held_out']['force_rmse_N'] > error['train']['force_rmse_N']


def test_two_trials_of_one_name_are_both_told() -> None:
    twins = [replace(_trial(0.005 + 0.003 * i, i), name='take_1') for i in range(2)]
    document = result_document(
        analyse_campaign([analyse(trial) for trial in twins], model=BASE), ['x/take_1', 'y/take_1']
    )
    for side in ('train', 'held_out'):
        errors = document['before']['error']['by_trial'][side]
        assert [trial['bag'] for trial in errors] == ['x/take_1', 'y/take_1']
        assert errors[0]['force_rmse_N'] != errors[1]['force_rmse_N']


def test_what_cannot_be_told_is_null_with_its_reason() -> None:
    bare = replace(_trial(release=False), displacement_height=None)
    document = result_document(analyse_campaign([analyse(bare)], model=BASE), ['a'])
    (trial,) = document['trials']
    assert trial['t_release_s'] is None
    for key in ('gamma_s', 'H0_m', 'Hinf_m', 'K1_N_m', 'C1_Ns_m', 'C2_Ns_m'):
        assert trial['paper'][key] is None
        assert any(key in warning and 'no release' in warning for warning in trial['warnings'])
    assert trial['paper']['tau_s'] == pytest.approx(2.0, rel=0.02)
    assert document['noise']['height_m'] is None
    assert any('noise of the height' in warning for warning in document['warnings'])
    error = document['before']['error']
    assert error['train']['height_rmse_m'] is None and error['train']['height_chi2'] is None
    for name, parameter in document['before']['parameters'].items():
        if not parameter['identifiable']:
            assert any(f'{name} is unknown' in warning for warning in document['warnings'])


def test_a_campaign_without_any_contact_has_a_result_that_says_so() -> None:
    trial = _trial()
    calm = replace(trial, force=Signal(trial.force.t, np.zeros(len(trial.force))))
    document = result_document(analyse_campaign([analyse(calm)]), ['a'])
    assert all(p['value'] is None for p in document['before']['parameters'].values())
    assert document['before']['error']['train'] is None
    assert document['diagnosis'] is None and document['after'] is None
    assert any('no contact' in warning for warning in document['warnings'])


_NAMED_BY_THE_DATA = {
    ('before', 'parameters'),
    ('after', 'parameters'),
    ('error', 'by_phase', 'train'),
    ('error', 'by_phase', 'held_out'),
}


def _keys(node: Any, path: tuple[str, ...] = ()) -> dict[str, list[Any]]:
    """Return the values at each key of a document, named as doc/result.md names them."""
    found: dict[str, list[Any]] = {}
    for key, value in node.items():
        free = path[-2:] in _NAMED_BY_THE_DATA or path[-3:] in _NAMED_BY_THE_DATA
        kind = '*' if free else key
        if path[-1:] == ('error',) or path[-2:-1] == ('error',):
            kind = '*' if key in ('train', 'held_out') else key
        below: list[dict[str, list[Any]]] = []
        if isinstance(value, dict):
            below = [_keys(value, (*path, key))]
        elif isinstance(value, list) and value and all(isinstance(one, dict) for one in value):
            below = [_keys(one, (*path, f'{key}[]')) for one in value]
            kind += '[]'
        prefix = f'{kind}.'
        if not below or key == 'paper_std':
            below, prefix = [{kind: [value]}], ''
        for some in below:
            for name, values in some.items():
                found.setdefault(prefix + name, []).extend(values)
    return found


def test_the_page_on_the_result_has_every_key_and_says_when_it_is_null(
    both: CampaignAnalysis, held: CampaignAnalysis
) -> None:
    rows = [
        [cell.strip() for cell in line.strip('|').split('|')]
        for line in RESULT_PAGE.read_text().splitlines()
        if line.startswith('| `')
    ]
    null_when = {key.strip('`'): when for key, _, _, when in rows}
    assert len(null_when) == len(rows)
    full = result_document(_diagnosed(held), ['a'], ['b'])
    # What stands for the base model stands for the one after it.
    keys = {key.replace('after.', 'before.', 1) for key in _keys(full)}
    assert keys <= set(null_when)
    others = set(null_when) - keys
    inner = ('.', '[')
    assert all(
        key == 'after' or any(k.startswith(tuple(key + i for i in inner)) for k in keys)
        for key in others
    )
    untouched = replace(_trial(), displacement_height=None)
    t = untouched.force.t
    untouched = replace(untouched, force=Signal(t, np.zeros(t.size)))
    empty = result_document(analyse_campaign([analyse(untouched)]), ['a'])
    nulls = {
        key.replace('after.', 'before.', 1)
        for document in (full, empty, result_document(both, ['a', 'b']))
        for key, values in _keys(document).items()
        if None in values
    }
    assert not [key for key in nulls if null_when[key].startswith('never')]
    assert {'diagnosis', 'after', 'held_out_by', 'before.error.*'} <= nulls
