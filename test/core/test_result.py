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

from hapticvision_ros.core.pipeline import analyse, analyse_campaign, TrialAnalysis
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.core.result import PAPER_KEYS, result_document
import numpy as np
import pytest

RESULT_PAGE = Path(__file__).parents[2] / 'doc' / 'result.md'
TRIAL_KEYS = {'bag', 'push_speed_m_s', 'depth_m', 't_contact_s', 't_hold_s', 't_release_s'}
TRIAL_KEYS |= {'paper', 'paper_std', 'warnings'}
ERROR_KEYS = {'force_rmse_N', 'height_rmse_m', 'force_chi2', 'height_chi2'}


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


def _numbers(node: Any) -> list[float]:
    """Return all numbers of a document."""
    if isinstance(node, dict):
        node = list(node.values())
    if isinstance(node, list):
        return [number for item in node for number in _numbers(item)]
    return [node] if isinstance(node, int | float) and not isinstance(node, bool) else []


def test_the_document_has_the_keys_of_the_schema_and_finite_numbers(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses), ['a', 'b'])
    assert document['schema'] == 'hapticvision/result/1'
    assert [trial['bag'] for trial in document['trials']] == ['a', 'b']
    for trial in document['trials']:
        assert set(trial) == TRIAL_KEYS
        assert set(trial['paper']) == {key for key, _ in PAPER_KEYS} == set(trial['paper_std'])
    assert set(document['noise']) == {'force_N', 'height_m'}
    assert set(document['before']) == {'model', 'parameters', 'error'}
    assert set(document['before']['parameters']) == {'K1', 'C1', 'C2'}
    for parameter in document['before']['parameters'].values():
        assert set(parameter) == {'value', 'std', 'unit', 'identifiable'}
    assert set(document['before']['error']) == {'train', 'held_out'}
    assert set(document['before']['error']['train']) == ERROR_KEYS
    numbers = _numbers(json.loads(json.dumps(document, allow_nan=False)))
    assert len(numbers) > 40
    assert all(math.isfinite(number) for number in numbers)


def test_the_trial_through_its_own_phases_gives_what_it_was_made_of(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses), ['a', 'b'])
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


def test_this_version_claims_no_diagnosis_and_says_so(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses), ['a', 'b'])
    assert document['diagnosis'] is None
    assert document['after'] is None
    assert any('does not diagnose' in warning for warning in document['warnings'])


def test_one_trial_has_no_held_out_error_and_a_warning_says_why(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses[:1]), ['a'])
    assert document['before']['error']['held_out'] is None
    assert any('held out' in warning for warning in document['warnings'])


def test_a_trial_held_out_is_listed_marked_and_compared_with(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    document = result_document(analyse_campaign(analyses[:1], analyses[1:]), ['a'], ['b'])
    assert [trial['bag'] for trial in document['trials']] == ['a', 'b']
    assert document['trials'][1]['warnings'][0].startswith('held out')
    error = document['before']['error']
    assert set(error['held_out']) == ERROR_KEYS
    # The fit has seen only the first: it misses the second by more.
    assert error['held_out']['force_rmse_N'] > error['train']['force_rmse_N']


def test_what_cannot_be_told_is_null_with_its_reason() -> None:
    document = result_document(
        analyse_campaign([analyse(replace(_trial(release=False), displacement_height=None))]),
        ['a'],
    )
    (trial,) = document['trials']
    assert trial['t_release_s'] is None
    for key in ('gamma_s', 'H0_m', 'Hinf_m', 'K1_N_m', 'C1_Ns_m', 'C2_Ns_m'):
        assert trial['paper'][key] is None
        assert any(key in warning and 'no release' in warning for warning in trial['warnings'])
    assert trial['paper']['tau_s'] == pytest.approx(2.0, rel=0.02)
    assert document['noise']['height_m'] is None


def _keys(node: Any, path: str = '') -> dict[str, list[Any]]:
    """Return the values at each key of a document, named as doc/result.md names them."""
    found: dict[str, list[Any]] = {}
    for key, value in node.items():
        kind = '*' if path in ('before.parameters.', 'before.error.') else key
        if path == 'before.error.':
            found[path + key] = [value]
        if isinstance(value, dict) and key != 'paper_std':
            below = [_keys(value, f'{path}{kind}.')]
        elif key == 'trials':
            below = [_keys(trial, 'trials[].') for trial in value]
        else:
            below = [] if path == 'before.error.' else [{path + kind: [value]}]
        for some in below:
            for name, values in some.items():
                found.setdefault(name, []).extend(values)
    return found


def test_the_page_on_the_result_has_every_key_and_says_when_it_is_null(
    analyses: tuple[TrialAnalysis, TrialAnalysis],
) -> None:
    rows = [
        [cell.strip() for cell in line.strip('|').split('|')]
        for line in RESULT_PAGE.read_text().splitlines()
        if line.startswith('| `')
    ]
    null_when = {key.strip('`'): when for key, _, _, when in rows}
    assert len(null_when) == len(rows)
    full = result_document(analyse_campaign(analyses[:1], analyses[1:]), ['a'], ['b'])
    assert set(_keys(full)) == set(null_when)
    untouched = replace(_trial(), displacement_height=None)
    t = untouched.force.t
    untouched = replace(untouched, force=Signal(t, np.zeros(t.size)))
    empty = result_document(analyse_campaign([analyse(untouched)]), ['a'])
    nulls = set()
    for document in (full, empty):
        for key, values in _keys(document).items():
            if None in values:
                nulls.add(key)
    assert not [key for key in nulls if null_when[key].startswith('never')]
    always = {key for key, when in null_when.items() if when.startswith('always')}
    assert always == {'diagnosis', 'after'} == {k for k, v in _keys(full).items() if v == [None]}
    # A trial without any contact lacks all that can be lacking, but for the errors' own entries,
    # which it does not have, and the errors of estimates, which are null one by one.
    sometimes = {key for key, when in null_when.items() if not when.startswith('never')}
    assert sometimes - nulls == {
        'trials[].paper_std',
        'before.error.*.height_rmse_m',
        'before.error.*.force_chi2',
        'before.error.*.height_chi2',
    }
