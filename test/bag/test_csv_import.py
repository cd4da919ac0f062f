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


"""A measured CSV file becomes the trial that it holds, or one sentence on why it cannot."""

import os
from pathlib import Path

from hapticvision_ros.bag.contract import DISPLACEMENT_HEIGHT, TOOL_HEIGHT, WRENCH
from hapticvision_ros.bag.csv_import import (
    Column,
    FORCE_SD,
    import_csv,
    NOMINAL_START_NS,
    read_csv,
)
from hapticvision_ros.bag.reader import read_trial
from hapticvision_ros.core.errors import InputError, UsageError
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
import numpy as np
import pytest
from rosbags.highlevel import AnyReader

MUSCLE = """\
time_s,displacement_mm,force_N,force_sd_N
2,-0.00028,-0.0002143571,0.00014179699
2.0526316,0.01162795,0.00013403951,0.00016961644
2.1052632,0.02350592,0.00028140603,0.00013195958
"""
"""The first rows of a muscle fibre's ramp (beards-lab/TitinViscoelasticity, MIT)."""


def _file(folder: Path, content: str | bytes, name: str = 'trial.csv') -> Path:
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def _messages(bag: Path) -> dict[str, list[tuple[int, object]]]:
    """Return each topic's publish times and messages, read by somebody else's reader."""
    found: dict[str, list[tuple[int, object]]] = {}
    with AnyReader([bag]) as reader:
        for connection, stamp, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            found.setdefault(connection.topic, []).append((stamp, message))
    return found


def _provenance(bag: Path) -> dict[str, str]:
    (file,) = bag.glob('*.mcap')
    with file.open('rb') as stream:
        records = {record.name: record.metadata for record in make_reader(stream).iter_metadata()}
    return records['provenance']


def test_every_row_of_a_measurement_becomes_messages_in_si_units(tmp_path: Path) -> None:
    trial = import_csv(_file(tmp_path, MUSCLE, 'ramp_1s.csv'), tmp_path, original_height=1e-3)
    messages = _messages(trial.bag)
    assert trial.bag == tmp_path / 'ramp_1s'
    assert trial.row_count == 3
    assert trial.warnings == ()
    stamps = [NOMINAL_START_NS + ns for ns in (2_000_000_000, 2_052_631_600, 2_105_263_200)]
    assert all([s for s, _ in rows] == stamps for rows in messages.values())
    wrenches = [message for _, message in messages[WRENCH.name]]
    assert [m.wrench.force.z for m in wrenches] == [0.0002143571, -0.00013403951, -0.00028140603]
    assert wrenches[1].header.stamp.nanosec == 52_631_600
    displacement = np.array([-0.00028, 0.01162795, 0.02350592]) * 1e-3
    recorded = [message.data for _, message in messages[DISPLACEMENT_HEIGHT.name]]
    height = [message.data for _, message in messages[TOOL_HEIGHT.name]]
    # One rounding of the unit's factor, one of the subtraction.
    np.testing.assert_allclose(recorded, displacement, rtol=1e-15)
    np.testing.assert_allclose(height, 1e-3 - displacement, rtol=1e-15)
    assert [message.data for _, message in messages[FORCE_SD.name]] == [
        0.00014179699,
        0.00016961644,
        0.00013195958,
    ]


def test_the_bag_says_where_it_comes_from(tmp_path: Path) -> None:
    trial = import_csv(_file(tmp_path, MUSCLE), tmp_path)
    provenance = _provenance(trial.bag)
    assert provenance['source_file'] == 'trial.csv'
    # sha256sum of the text above.
    assert provenance['source_sha256'] == (
        'ca2279e2f574ca101a6339a9aa33ded50a8f27d6608bfa4e59d7396f3cdfd089'
    )
    assert provenance['displacement_source'] == 'tool'
    assert provenance['columns'].startswith(
        'time = time_s [s]; displacement = displacement_mm [mm]'
    )
    assert provenance['original_height_m'].endswith('(nominal: the source does not say)')
    assert provenance['time_zero'].startswith('nominal')


def test_a_tool_displacement_of_its_own_is_the_tools(tmp_path: Path) -> None:
    text = 'time_ms,force_kgf,displacement_um,tool_displacement_m\n0,1,5,0.001\n500,2,6,0.002\n'
    trial = import_csv(_file(tmp_path, text), tmp_path, original_height=0.04)
    messages = _messages(trial.bag)
    assert [m.data for _, m in messages[TOOL_HEIGHT.name]] == [0.04 - 0.001, 0.04 - 0.002]
    recorded = [m.data for _, m in messages[DISPLACEMENT_HEIGHT.name]]
    np.testing.assert_allclose(recorded, [5e-6, 6e-6], rtol=1e-15)
    assert messages[WRENCH.name][1][1].wrench.force.z == -2 * 9.80665
    assert messages[WRENCH.name][1][0] - messages[WRENCH.name][0][0] == 500_000_000
    assert _provenance(trial.bag)['displacement_source'] == 'topic'


@pytest.mark.parametrize(
    ('header', 'force', 'displacement', 'second'),
    [
        ('time_s,force_kN,displacement_cm', 2e3, 0.03, 1.0),
        ('time_min,force_lbf,displacement_mm', 2 * 4.4482216152605, 0.003, 60.0),
    ],
)
def test_testing_machines_write_kilonewtons_pounds_centimetres_and_minutes(
    tmp_path: Path, header: str, force: float, displacement: float, second: float
) -> None:
    read = read_csv(_file(tmp_path, f'{header}\n0,1,1\n1,2,3\n'))
    signals = read.signals
    assert signals['force'].t[1] - signals['force'].t[0] == second
    assert signals['force'].value[1] == pytest.approx(force, rel=1e-12)
    assert signals['displacement'].value[1] == pytest.approx(displacement, rel=1e-12)


GERMAN = (
    'Prüfung;12\r\n\r\nZeit;"Kraft [N]";Weg\r\ns;N;mm\r\n'
    '0,0;1,5;0,1\r\n0,5;1,75;0,2\r\n1;2e0;,3\r\n'
)
GERMAN_CHOICES = (
    Column('time', 'Zeit', 's'),
    Column('force', 'Kraft [N]', 'N'),
    Column('displacement', 'Weg', 'mm'),
)


@pytest.mark.parametrize('encoding', ['utf-8', 'utf-8-sig', 'utf-16', 'latin-1'])
@pytest.mark.parametrize('delimiter', [';', '\t', '|'])
def test_other_instruments_dialects_give_the_same_numbers(
    tmp_path: Path, encoding: str, delimiter: str
) -> None:
    path = _file(tmp_path, GERMAN.replace(';', delimiter).encode(encoding))
    read = read_csv(path, GERMAN_CHOICES)
    assert read.signals['force'].value.tolist() == [1.5, 1.75, 2.0]
    assert read.signals['displacement'].value.tolist() == [0.1 * 1e-3, 0.2 * 1e-3, 0.3 * 1e-3]
    assert read.signals['force'].t.tolist() == [0.0, 0.5, 1.0]
    assert read.warnings == (f'{path}, line 4: no usable number; 1 row is left out.',)


@pytest.mark.parametrize(
    'text',
    [
        '# a comment\ntime_s,force_N,displacement_mm\n0,1,2\n1,3,4\n',
        'time_s , force_N , displacement_mm\n 0 , 1 , 2 \n\n1,3,4\n',
        'time_s,force_N,displacement_mm,\n0,1,2,\n1,3,4,\n',
        '"time_s","force_N","displacement_mm"\n"0","1","2"\n"1","3","4"\n',
        '"time_s","force_N","displacement_mm"\n"0,0","1,0","2,0"\n"1,0","3,0","4,0"\n',
        'displacement_mm,note,Force_N,TIME_s\n2,dry,1,0\n4,,3,1',
        'Specimen 3\nmade on 2024-05-01\n\ntime_s,force_N,displacement_mm\n0,1,2\n1,3,4\n',
        'time_s,force_N,displacement_\u00b5m\n0,1,2000\n1,3,4000\n',
    ],
)
def test_a_file_is_read_whatever_surrounds_its_numbers(tmp_path: Path, text: str) -> None:
    read = read_csv(_file(tmp_path, text))
    assert read.signals['force'].t.tolist() == [0.0, 1.0]
    assert read.signals['force'].value.tolist() == [1.0, 3.0]
    np.testing.assert_allclose(read.signals['displacement'].value, [2e-3, 4e-3], rtol=1e-15)
    assert read.warnings == ()


HEAD = 'time_s,force_N,displacement_mm\n'


@pytest.mark.parametrize(
    ('rows', 'force_t', 'displacement_t', 'warnings'),
    [
        (
            '0,1,1\n1,n/a,2\n2,nan,3\n3,4,4\n',
            [0, 3],
            [0, 1, 2, 3],
            ["line 3, 4: 'n/a' under 'force_N' is not a usable number; 2 samples are left out."],
        ),
        (
            '0,1,1\n1,,2\n2,inf,3\n3,4,4\n',
            [0, 3],
            [0, 1, 2, 3],
            ["line 3, 4: a cell under 'force_N' is not a usable number; 2 samples are left out."],
        ),
        (
            '0,1,1\n1,2,2\n1,9,9\n2,3,3\n',
            [0, 1, 2],
            [0, 1, 2],
            ['line 4: time does not increase; 1 row is left out.'],
        ),
        (
            '0,1,1\n1e6,2,2\n1,3,3\n2,4,4\n',
            [0, 1, 2],
            [0, 1, 2],
            ['line 3: time does not increase; 1 row is left out.'],
        ),
        (
            '0,1,1\n9e99,2,2\n2,4,4\n',
            [0, 2],
            [0, 2],
            ["line 3: a cell under 'time_s' is not a usable number; 1 row is left out."],
        ),
        (
            '0,1,1\n1,2,2\n2,3,3\n3,4',
            [0, 1, 2],
            [0, 1, 2],
            ['line 5: the file is cut off within this row, left out.'],
        ),
        (
            ''.join(f'{i},1,{1 + i / 100:.2f}\n' for i in range(40)) + '40,1,1.4',
            list(range(40)),
            list(range(40)),
            ['line 42: the file is cut off within this row, left out.'],
        ),
        (
            ''.join(f'{i},1,{1 + i / 100:.2f}\n' for i in range(40)) + '40,1,1.40',
            list(range(41)),
            list(range(41)),
            [],
        ),
        (
            ''.join(f'{i},1,{1 + i / 8}\n' for i in range(40)) + '40,1,6',
            list(range(41)),
            list(range(41)),
            [],
        ),
        (
            ''.join(f'{i},1,1\n' for i in range(20)) + '20,1,1,7\n',
            list(range(20)),
            list(range(20)),
            ['line 22: more cells than the header has; 1 row is left out.'],
        ),
    ],
    ids=[
        *('text', 'empty', 'twice', 'glitch', 'far', 'cut', 'cut within a number', 'no end'),
        *('no end, digits as they come', 'wide'),
    ],
)
def test_a_fault_costs_no_more_than_itself_and_is_told_with_its_line(
    tmp_path: Path,
    rows: str,
    force_t: list[float],
    displacement_t: list[float],
    warnings: list[str],
) -> None:
    path = _file(tmp_path, HEAD + rows)
    read = read_csv(path)
    assert read.signals['force'].t.tolist() == force_t
    assert read.signals['displacement'].t.tolist() == displacement_t
    assert list(read.warnings) == [f'{path}, {warning}' for warning in warnings]


@pytest.mark.parametrize(
    ('header', 'rows', 'last'),
    [
        (HEAD[:-1] + ',\n', '{i},1,{h:.2f}\n', '40,1,1.40'),
        (HEAD[:-1] + ',comment\n', '{i},1,{h:.2f}\n', '40,1,1.40'),
        (HEAD, '{i},1,{h:.2f} \n', '40,1,1.40'),
        (HEAD, '{i},1,{h:.2f}\n', '40,1,1.4\n# end'),
        (HEAD, '{i},1,{h:.2f}\r', '40,1,1.4\r'),
        (HEAD[:-1] + ',comment\n-1,1,1,start\n', '{i},1,{h:.2f}\n', '40,1,1.4'),
        (HEAD, '{i},1,1.25\n', '40,1,1.3'),
        ('time_s;force_N;displacement_mm\n', '{i};1;{c}\n', '40;1;1,40'),
    ],
    ids=['delimiter', 'comment', 'blank', 'end', 'return', 'ragged', 'constant', 'comma'],
)
def test_a_last_row_without_an_end_may_be_whole(
    tmp_path: Path, header: str, rows: str, last: str
) -> None:
    lines = (
        rows.format(i=i, h=1 + i / 100, c=f'{1 + i / 100:.2f}'.replace('.', ','))
        for i in range(40)
    )
    read = read_csv(_file(tmp_path, header + ''.join(lines) + last))
    assert read.signals['displacement'].t[-1] == 40.0
    assert read.warnings == ()


@pytest.mark.parametrize(
    ('rows', 'last'),
    [('{i},1,{c},\n', '40,1,1.4'), ('{i};1;"{d}"\n', '40;1;"1,4'), ('{i},1,{c}\r', '40,1')],
    ids=['delimiter', 'quotes', 'carriage return'],
)
def test_a_row_that_is_cut_is_found_in_any_dialect(tmp_path: Path, rows: str, last: str) -> None:
    header = HEAD if ';' not in rows else HEAD.replace(',', ';')
    made = ''
    for i in range(40):
        value = f'{1 + i / 100:.2f}'
        made += rows.format(i=i, c=value, d=value.replace('.', ','))
    read = read_csv(_file(tmp_path, header + made + last))
    assert read.signals['displacement'].t[-1] == 39.0
    assert 'cut off within this row' in read.warnings[0]
    assert read.row_count == 41


def test_a_footer_is_no_row_that_is_cut(tmp_path: Path) -> None:
    read = read_csv(_file(tmp_path, HEAD + '0,1,1\n1,1,2\nEnd of test'))
    assert read.signals['displacement'].t.tolist() == [0.0, 1.0]
    assert not any('cut off' in warning for warning in read.warnings)


@pytest.mark.parametrize(
    ('content', 'sentence'),
    [
        ('', 'is empty'),
        (' \n\n', 'is empty'),
        (HEAD, 'a header and no rows'),
        (HEAD + '0,1,1\n', 'holds 1 usable sample of the force'),
        ('0,1,2\n1,2,3\n', 'has no header line'),
        ('time_s,displacement_mm\n0,1\n1,1\n', 'no column holds the force'),
        ('time_s,force,displacement_mm\n0,1,1\n', "'force' has no unit; rename it to force_N"),
        ('time_s,force_dyn,displacement_mm\n0,1,1\n', "unit of the column 'force_dyn' is not"),
        ('time_s,force_N,force_mN,displacement_mm\n0,1,1,1\n', 'force_N or force_mN could be'),
        ('time_s,force_N,force_N,displacement_mm\n0,1,1,1\n', "two columns are called 'force_N'"),
        (HEAD + '1,1,1\n1,2,2\n1,3,3\n', 'the time is the same in all rows'),
        (
            HEAD.replace(',', ';') + '0,0;1.5;1,0\n0,5;2.5;2,0\n',
            "'1.5' under 'force_N' is not a usable number, nor",
        ),
        (HEAD + '0,1,x\n1,2,y\n', "'x' under 'displacement_mm' is not a usable number, nor"),
        (HEAD + '0,0,1,5,2,5\n0,5,1,5,2,5\n', 'where the decimal mark is a comma'),
        (HEAD + '0,1,1\n1,1,1\n2,1,1\n' * 2, 'time falls from 2 s to 0 s'),
        (b'\x89MCAP0\r\n', 'is an MCAP bag already'),
        (b'PK\x03\x04rest', 'is an Excel workbook'),
        (b'time_s\x00\x01\x02', 'is a binary file'),
        (b'\xff\xfet\x00i', 'is cut off or no UTF-16 text'),
    ],
)
def test_what_cannot_be_used_is_refused_in_one_sentence(
    tmp_path: Path, content: str | bytes, sentence: str
) -> None:
    path = _file(tmp_path, content)
    with pytest.raises(InputError) as caught:
        read_csv(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert sentence in message
    assert '\n' not in message
    assert message.endswith('.')


def test_a_mark_of_thousands_costs_its_cell_only(tmp_path: Path) -> None:
    rows = '0,0;0,1;1,0\n0,5;0,2;2,0\n1,0;1.000,5;3,0\n1,5;1.000;4,0\n2,0;0,4;5,0\n'
    path = _file(tmp_path, HEAD.replace(',', ';') + rows)
    read = read_csv(path)
    assert read.signals['force'].value.tolist() == [0.1, 0.2, 0.4]
    assert read.signals['displacement'].t.tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]
    told = "line 4, 5: '1.000,5' under 'force_N' is not a usable number; 2 samples are left out."
    assert list(read.warnings) == [f'{path}, {told}']


def test_marks_of_thousands_are_no_decimal_commas(tmp_path: Path) -> None:
    """Which they would be, by their number."""
    rows = '0;1,500;1\n1;2,500;2\n2;3,500;3.5\n3;900;4\n4;950;5\n'
    path = _file(tmp_path, HEAD.replace(',', ';') + rows)
    read = read_csv(path)
    assert read.signals['force'].value.tolist() == [900.0, 950.0]
    assert "'1,500' under 'force_N' is not a usable number; 3 samples" in read.warnings[0]


def test_a_name_that_is_no_text_is_imported(tmp_path: Path) -> None:
    path = Path(os.fsdecode(os.fsencode(tmp_path) + b'/n\xe9.csv'))
    path.write_text(HEAD + '0,1,1\n1,n/a,2\n2,3,3\n')
    made = import_csv(path, tmp_path / 'bags')
    trial = read_trial(made.bag)
    assert trial.force.value.tolist() == [1.0, 3.0]


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'nowhere\.csv cannot be read \(No such file'):
        read_csv(tmp_path / 'nowhere.csv')


@pytest.mark.parametrize(
    ('text', 'sentence'),
    [
        ('force', 'write QUANTITY=HEADER:UNIT'),
        ('force=Kraft', 'write QUANTITY=HEADER:UNIT'),
        ('weight=Kraft:N', "no quantity 'weight'; use time, force,"),
        ('force=Kraft:dyn', "'dyn' is no unit of force; use N, mN, kN, gf, kgf or lbf"),
    ],
)
def test_a_choice_that_means_nothing_is_refused(text: str, sentence: str) -> None:
    with pytest.raises(UsageError) as caught:
        Column.parse(text)
    assert sentence in str(caught.value)


def test_a_chosen_column_may_hold_the_marks_of_the_choice_itself() -> None:
    assert Column.parse('force=F = m:a:mN') == Column('force', 'F = m:a', 'mN')
    assert Column.parse('force=F = m:a: - mN') == Column('force', 'F = m:a', '-mN')


def test_a_chosen_column_that_is_not_there_is_named(tmp_path: Path) -> None:
    path = _file(tmp_path, HEAD + '0,1,1\n1,1,1\n')
    with pytest.raises(InputError, match="no column 'Kraft'; its columns are 'time_s', 'force_N'"):
        read_csv(path, [Column('force', 'Kraft', 'N')])


def test_a_choice_goes_before_a_name(tmp_path: Path) -> None:
    text = 'time_s,force_N,filtered,displacement_mm\n0,1,10,1\n1,2,20,1\n'
    read = read_csv(_file(tmp_path, text), [Column('force', 'filtered', 'mN')])
    np.testing.assert_allclose(read.signals['force'].value, [10e-3, 20e-3], rtol=1e-15)


def test_an_existing_bag_gives_way_only_when_told_and_only_to_a_good_one(tmp_path: Path) -> None:
    path = _file(tmp_path, HEAD + '0,1,1\n1,1,1\n')
    bag = import_csv(path, tmp_path / 'out').bag
    first = _provenance(bag)
    with pytest.raises(InputError, match='exists already'):
        import_csv(path, tmp_path / 'out')
    _file(tmp_path, HEAD + '0,1,1\n')
    with pytest.raises(InputError, match='usable sample'):
        import_csv(path, tmp_path / 'out', replace=True)
    assert _provenance(bag) == first
    _file(tmp_path, HEAD + '0,1,1\n1,1,1\n2,1,1\n')
    import_csv(path, tmp_path / 'out', replace=True)
    assert _provenance(bag)['rows'] == '3'
    assert [entry.name for entry in (tmp_path / 'out').iterdir()] == ['trial']


def test_a_folder_that_is_no_bag_is_never_replaced(tmp_path: Path) -> None:
    path = _file(tmp_path, HEAD + '0,1,1\n1,1,1\n')
    precious = tmp_path / 'trial' / 'thesis.tex'
    precious.parent.mkdir()
    precious.write_text('...')
    with pytest.raises(InputError, match='is not a bag'):
        import_csv(path, tmp_path, replace=True)
    assert precious.exists()


def test_a_tool_below_the_support_plane_is_refused(tmp_path: Path) -> None:
    path = _file(tmp_path, HEAD + '0,1,0\n1,1,60\n')
    with pytest.raises(InputError, match='60 mm deep into an object that is 50 mm high'):
        import_csv(path, tmp_path)
    assert import_csv(path, tmp_path, original_height=0.08).bag.exists()


def test_times_that_count_from_the_epoch_are_the_stamps(tmp_path: Path) -> None:
    path = _file(tmp_path, HEAD + '1700000000.25,1,1\n1700000000.75,1,1\n')
    messages = _messages(import_csv(path, tmp_path).bag)
    assert [s for s, _ in messages[WRENCH.name]] == [
        1_700_000_000_250_000_000,
        1_700_000_000_750_000_000,
    ]
    with pytest.raises(InputError, match='do not fit a ROS stamp'):
        import_csv(path, tmp_path / 'later', start_ns=NOMINAL_START_NS)


@settings(max_examples=60, deadline=None)
@given(
    values=st.lists(
        st.tuples(
            st.floats(-1e6, 1e6, allow_subnormal=False),
            st.floats(-1e6, 1e6, allow_subnormal=False),
        ),
        min_size=2,
        max_size=20,
    ),
    delimiter=st.sampled_from(',;\t|'),
    comma=st.booleans(),
)
def test_numbers_survive_their_way_through_text(
    tmp_path_factory: pytest.TempPathFactory,
    values: list[tuple[float, float]],
    delimiter: str,
    comma: bool,
) -> None:
    lines = [delimiter.join(('time_s', 'force_N', 'displacement_m'))]
    for i, row in enumerate(values):
        cells = [repr(number) for number in (0.5 * i, *row)]
        if comma and delimiter != ',':
            cells = [cell.replace('.', ',') for cell in cells]
        lines.append(delimiter.join(cells))
    path = _file(tmp_path_factory.mktemp('text'), '\n'.join(lines))
    read = read_csv(path)
    assert read.signals['force'].value.tolist() == [force for force, _ in values]
    assert read.signals['displacement'].value.tolist() == [moved for _, moved in values]
    assert read.warnings == ()


@given(st.binary(max_size=200))
@settings(max_examples=150, deadline=None)
def test_any_bytes_give_numbers_or_one_sentence(
    tmp_path_factory: pytest.TempPathFactory, content: bytes
) -> None:
    path = _file(tmp_path_factory.mktemp('bytes'), HEAD.encode() + content)
    try:
        read = read_csv(path)
    except InputError as error:
        assert '\n' not in str(error)
    else:
        assert len(read.signals['force']) >= 2
