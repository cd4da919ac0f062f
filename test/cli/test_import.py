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


"""The verb ``import``: what a person sees, and what is left when something is wrong."""

import argparse
from pathlib import Path

from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.cli import import_csv
from hapticvision_ros.core.errors import UsageError
from mcap.reader import make_reader
import numpy as np
import pytest

GOOD = 'time_s,force_N,displacement_mm\n0,1,1\n1,2,2\n'


def _import(*arguments: str | Path) -> int:
    parser = argparse.ArgumentParser(prog='hapticvision import')
    import_csv.add_arguments(parser)
    return import_csv.run(parser.parse_args([str(argument) for argument in arguments]))


def _metadata(bag: Path) -> dict[str, str]:
    with (bag / f'{bag.name}_0.mcap').open('rb') as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    return records['provenance']


def test_each_file_becomes_a_bag_of_its_name(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in ('slow', 'fast'):
        (tmp_path / f'{name}.csv').write_text(GOOD)
    code = _import(tmp_path / 'slow.csv', tmp_path / 'fast.csv', '--out', tmp_path / 'bags')
    assert code == 0
    assert sorted(bag.name for bag in (tmp_path / 'bags').iterdir()) == ['fast', 'slow']
    shown = capsys.readouterr()
    assert shown.out.splitlines()[0] == (
        f'{tmp_path / "slow.csv"}: 2 rows -> {tmp_path / "bags" / "slow"}: '
        '2 of force, 2 of displacement'
    )
    assert shown.err == ''


def test_a_bad_file_is_told_and_the_others_are_imported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / 'bad.csv').write_text('time_s,force_N\n0,1\n')
    (tmp_path / 'good.csv').write_text(GOOD + '2,x,3\n')
    code = _import(tmp_path / 'bad.csv', tmp_path / 'good.csv', '--out', tmp_path)
    assert code == 2
    assert (tmp_path / 'good' / 'metadata.yaml').is_file()
    assert not (tmp_path / 'bad').exists()
    first, second = capsys.readouterr().err.splitlines()
    assert 'bad.csv, line 1: no column holds the displacement' in first
    assert 'warning: ' in second
    assert "good.csv, line 4: 'x' under 'force_N' is not a usable number" in second


def test_columns_height_and_start_can_be_said(tmp_path: Path) -> None:
    (tmp_path / 'zwick.csv').write_text('Zeit;Kraft [N];Weg\n0;1,5;1\n1;2,5;2\n')
    choices = ('time=Zeit:s', 'force=Kraft [N]:N', 'displacement=Weg:mm')
    arguments = [text for choice in choices for text in ('--column', choice)]
    said = ('--height', '40mm', '--start', '2026-05-01T12:00:00.25+02:00')
    assert _import(tmp_path / 'zwick.csv', '--out', tmp_path / 'b', *arguments, *said) == 0
    bag = tmp_path / 'b' / 'zwick'
    assert _metadata(bag)['original_height_m'] == '0.04'
    assert _metadata(bag)['time_zero'] == 'given'
    # 2026-05-01T10:00:00.25Z
    assert '1777629600250000000' in (bag / 'metadata.yaml').read_text()


@pytest.mark.parametrize('minus', ['-', '\u2212'])
def test_a_minus_before_the_unit_turns_the_sign(tmp_path: Path, minus: str) -> None:
    (tmp_path / 'tension.csv').write_text('time_s,F,displacement_mm\n0,0,0\n1,-1.5,1\n2,-2.5,2\n')
    turned = ('--column', f'force=F:{minus}mN')
    assert _import(tmp_path / 'tension.csv', '--out', tmp_path, *turned) == 0
    trial = read_trial(tmp_path / 'tension')
    np.testing.assert_allclose(trial.force.value, [0.0, 1.5e-3, 2.5e-3], rtol=1e-12)
    assert 'force = F [-mN]' in _metadata(tmp_path / 'tension')['columns']


@pytest.mark.parametrize(
    ('arguments', 'sentence'),
    [
        (('--height', '40 inch'), "--height '40 inch' is no height"),
        (('--height', '0'), "--height '0' is no height"),
        (('--height', '40'), '--height is 40 m, which is none: write its unit beside it'),
        (('--start', 'yesterday'), "--start 'yesterday' is no time"),
        (('--column', 'force=a:N', '--column', 'force=b:N'), 'names force 2 times'),
        (('--column', 'time=time_s:-s'), 'a time has no sign to turn'),
        (('--column', 'force=force_N:--N'), "'--N' is no unit of force"),
        (('elsewhere/trial.csv',), "2 files would become the bag 'trial'"),
    ],
)
def test_arguments_that_do_not_fit_write_nothing(
    tmp_path: Path, arguments: tuple[str, ...], sentence: str
) -> None:
    (tmp_path / 'trial.csv').write_text(GOOD)
    with pytest.raises(UsageError) as caught:
        _import(tmp_path / 'trial.csv', *arguments, '--out', tmp_path / 'bags')
    assert sentence in str(caught.value)
    assert not (tmp_path / 'bags').exists()


def test_force_replaces_a_bag(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / 'trial.csv').write_text(GOOD)
    assert _import(tmp_path / 'trial.csv', '--out', tmp_path) == 0
    assert _import(tmp_path / 'trial.csv', '--out', tmp_path) == 2
    assert 'exists already: choose another --out' in capsys.readouterr().err
    assert _import(tmp_path / 'trial.csv', '--out', tmp_path, '--force') == 0
