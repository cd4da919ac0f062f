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

"""The verb `shape`: from a result and a bag with clouds to a folder, and what it refuses."""

from dataclasses import replace
import json
from pathlib import Path
import re
import shutil

import cv2
from hapticvision_ros.cli.main import main
from hapticvision_ros.cli.tips import ByTip, Identified
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.surface.loop import Loop
from hapticvision_ros.core.surface.study import ShapeSettings
import pytest

ROOT = Path(__file__).resolve().parents[2]
CLOUDS = ROOT / 'bags' / 'synthetic_clouds' / 'speed_5mm_s_depth_5mm'
WITHOUT_CLOUDS = ROOT / 'bags' / 'synthetic_stiff_block' / 'speed_5mm_s_depth_5mm'
WITHOUT_RELEASE = ROOT / 'bags' / 'muscle_ramp_hold' / 'ramp_10s'
TOOL = ['--tool-radius', '8mm']


def _result(path: Path, **changed: float | None) -> Path:
    values = {'K1': 2000.0, 'C1': 1600.0, 'C2': 2400.0} | changed
    units = {'K1': 'N/m', 'C1': 'N.s/m', 'C2': 'N.s/m'}
    parameters = {
        name: {'value': value, 'std': None, 'unit': units[name], 'identifiable': True}
        for name, value in values.items()
    }
    document = {
        'schema': 'hapticvision/result/1',
        'trials': [{'depth_m': 0.005}, {'depth_m': None}],
        'before': {'model': 'three-element', 'parameters': parameters},
        'after': None,
        'warnings': ['C2 is unknown: the best fit is a body that does not flow'],
    }
    path.write_text(json.dumps(document))
    return path


@pytest.fixture(scope='module')
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return what the verb wrote for the shipped bag with clouds, in coarse cells."""
    place = tmp_path_factory.mktemp('shape')
    out = place / 'out'
    out.mkdir()
    for name in ('surface_9.ply', 'surface_9.vtk', 'cloud_9.ply', 'cloud_mine.ply'):
        (out / name).write_text('of an earlier run, or of somebody else')
    arguments = ['shape', str(_result(place / 'result.json')), str(CLOUDS), *TOOL]
    arguments += ['--small', '--rounds', '1', '--links', 'alike', '--cell', '5mm']
    assert main([*arguments, '--out', str(out)]) == 0
    return out


def _no_nulls_without_reason(document: dict) -> bool:
    missing = json.dumps(document).count('null')
    return missing == 0 or bool(document['warnings'])


def test_the_numbers_of_a_shape_are_written(folder: Path) -> None:
    document = json.loads((folder / 'shape.json').read_text())
    assert document['schema'] == 'hapticvision/shape/2'
    assert document['model'] == 'three-element'
    assert document['which'] == 'before'
    assert document['simulation']['small_displacements'] is True
    assert document['simulation']['links'] == 'alike'
    # The true axis is the origin of the bag's frame; the tool is seen, and tells it.
    assert document['contact']['source'] == 'tool'
    assert abs(document['contact']['x_m']) < 5e-4
    assert abs(document['contact']['y_m']) < 5e-4
    assert document['before']['rms_m'] < 1e-3
    residual, bouncing = document['residual_m'], document['bouncing_m']
    # The depth is 5 mm; what is left after 3 s is what the simulated cell had.
    assert residual['measured'] == pytest.approx(0.0020, abs=2e-4)
    assert residual['measured'] + bouncing['measured'] == pytest.approx(0.00502, abs=5e-5)
    assert residual['simulated'] + bouncing['simulated'] == pytest.approx(0.00502, abs=5e-5)
    assert 0.0 < residual['simulated'] < 0.005
    times = [look['t_s'] for look in document['after']]
    assert times == sorted(times)
    for look in (document['before'], *document['after']):
        assert 0.0 < look['noise_m'] < look['rms_m'] < look['largest_m'] <= look['hausdorff_m']
        assert look['noise_share'] == pytest.approx((look['noise_m'] / look['rms_m']) ** 2)
    assert _no_nulls_without_reason(document)


def test_a_model_that_no_link_carries_is_refused_before_the_clouds_are_read(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def observed(*_: object, **__: object) -> None:
        raise AssertionError('the clouds are read')

    monkeypatch.setattr('hapticvision_ros.core.surface.study.observe', observed)
    result = _result(tmp_path / 'result.json', K1=-2000.0)
    arguments = ['shape', str(result), str(CLOUDS), *TOOL, '--out', str(tmp_path / 'out')]
    assert main(arguments) == 2
    assert 'K1' in capsys.readouterr().err
    document = json.loads(_result(result).read_text())
    document['before']['model'] = 'three-element+springpot'
    document['before']['parameters']['alpha'] = document['before']['parameters']['K1']
    result.write_text(json.dumps(document))
    assert main(arguments) == 2
    assert 'springpot' in capsys.readouterr().err


def test_friction_and_weight_are_declared(folder: Path, tmp_path: Path) -> None:
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), *TOOL]
    arguments += ['--small', '--rounds', '1', '--cell', '5mm', '--out', str(tmp_path / 'out')]
    arguments += ['--tool-friction', '0', '--support-friction', '0.2', '--density', '1000']
    assert main(arguments) == 0
    usual = json.loads((folder / 'shape.json').read_text())
    told = json.loads((tmp_path / 'out' / 'shape.json').read_text())
    names = ('tool_friction', 'support_friction', 'density_kg_m3')
    assert [told['simulation'][name] for name in names] == [0.0, 0.2, 1000.0]
    assert [usual['simulation'][name] for name in names] == ['sticks', 'sticks', 0.0]
    assert any('sinks for as long as it stands' in one for one in told['warnings'])
    # A foot that slides lets the sides go out, and the weight helps.
    assert told['bulge_m']['simulated'] > usual['bulge_m']['simulated'] + 2e-5


def test_a_table_of_several_bags_has_the_numbers_of_each(folder: Path, tmp_path: Path) -> None:
    copy = tmp_path / 'copy'
    shutil.copytree(CLOUDS, copy)
    out = tmp_path / 'out'
    bags = [str(CLOUDS), str(copy)]
    arguments = ['shape', str(_result(tmp_path / 'result.json')), *bags, *TOOL, '--small']
    arguments += ['--rounds', '1', '--links', 'alike', '--cell', '5mm', '--out', str(out)]
    assert main(arguments) == 0
    rows = json.loads((out / 'shapes.json').read_text())['trials']
    assert [row['bag'] for row in rows] == bags
    one = json.loads((folder / 'shape.json').read_text())
    for row in rows:
        assert row['links'] == 'alike'
        for name in ('bouncing_m', 'residual_m', 'bulge_m', 'volume_change_m3'):
            assert row[name] == one[name]
        for name in ('rms_m', 'percentile_95_m', 'hausdorff_m'):
            assert row[name] == one['after'][-1][name]


def test_a_body_that_is_not_its_model_is_warned_of_with_what_helps(
    folder: Path, tmp_path: Path
) -> None:
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), *TOOL]
    arguments += ['--sphere', '--rounds', '1', '--cell', '6mm', '--out', str(tmp_path / 'out')]
    assert main(arguments) == 0
    told = json.loads((tmp_path / 'out' / 'shape.json').read_text())
    of_force = [one for one in told['warnings'] if 'differs from the model' in one]
    assert [one.endswith('as the contact of a sphere grows') for one in of_force] == [True]
    assert told['simulation']['force_misfit'] > 0.01
    usual = json.loads((folder / 'shape.json').read_text())
    assert not any('sphere' in one for one in usual['warnings'])


def test_few_nodes_under_the_tool_are_warned_of(tmp_path: Path) -> None:
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), *TOOL]
    arguments += ['--small', '--rounds', '1', '--cell', '7mm', '--out', str(tmp_path / 'out')]
    assert main(arguments) == 0
    told = json.loads((tmp_path / 'out' / 'shape.json').read_text())
    assert any(
        re.search(r"tool's face has only \d nodes in cells of .*smaller --cell", one)
        for one in told['warnings']
    )


def test_pictures_meshes_and_clouds_stand_beside(folder: Path) -> None:
    looks = len(json.loads((folder / 'shape.json').read_text())['after'])
    names = {path.name for path in folder.iterdir()}
    assert names == {
        'shape.json',
        'shape.html',
        'comparison.png',
        'animation.gif',
        'surface_before.ply',
        'cloud_mine.ply',
        *(f'surface_{k}.ply' for k in range(1, looks + 1)),
        *(f'surface_{k}.vtk' for k in range(1, looks + 1)),
        *(f'cloud_{k}.ply' for k in range(1, looks + 1)),
    }
    assert cv2.imread(str(folder / 'comparison.png')).shape[1] == 1200
    assert (folder / 'animation.gif').read_bytes().startswith(b'GIF89a')
    page = (folder / 'shape.html').read_text()
    assert page.count('data:image/') == 2
    assert 'residual deformation' in page
    assert 'http' not in page.partition('<body>')[2]


@pytest.mark.parametrize(
    ('bag', 'options', 'complaint'),
    [
        (WITHOUT_CLOUDS, TOOL, 'has no clouds'),
        (WITHOUT_RELEASE, TOOL, 'has no clouds'),
        (CLOUDS, ['--tool-radius', '8km'], 'is no size'),
        (CLOUDS, ['--tool-radius', '8'], 'write millimetres as'),
        (CLOUDS, [*TOOL, '--volume-ratio', '1e9'], '--volume-ratio'),
        (CLOUDS, [*TOOL, '--size', '48x36mm'], 'is no size of a block'),
        (CLOUDS, [*TOOL, '--rounds', '0'], 'one run or more'),
        (CLOUDS, [*TOOL, '--average', '0'], 'from 1 to'),
        (CLOUDS, [*TOOL, '--volume-ratio', 'nan'], 'zero or above'),
        (CLOUDS, [*TOOL, '--support-friction', '-0.1'], 'zero or above'),
        (CLOUDS, [*TOOL, '--tool-friction', 'inf'], 'zero or above'),
        (CLOUDS, [*TOOL, '--density', '-1'], 'zero or above, and finite'),
        (CLOUDS, [*TOOL, '--size', '48x36x20mm', '--cell', '25mm'], 'falls between the nodes'),
        (CLOUDS, [*TOOL, '--size', '480x360x200mm'], 'nodes, more than 250000'),
        (CLOUDS, [*TOOL, '--which', 'after'], "has no model 'after'"),
        (CLOUDS, [*TOOL, '--cell', '0.01mm'], 'nodes'),
        (CLOUDS, [*TOOL, '--contact', '0.5', '0.5'], 'does not meet the body'),
        (CLOUDS, [*TOOL, '--contact', 'nan', '0'], 'two finite numbers'),
        (CLOUDS / 'nothing', TOOL, 'nothing'),
        (CLOUDS, [], 'tool-radius'),
        (CLOUDS, [*TOOL, '--close-loop'], 'give 2 or more'),
    ],
)
def test_what_cannot_be_done_is_said_in_one_sentence(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    bag: Path,
    options: list[str],
    complaint: str,
) -> None:
    result = str(_result(tmp_path / 'result.json'))
    assert main(['shape', result, str(bag), *options, '--out', str(tmp_path / 'out')]) == 2
    last = capsys.readouterr().err.strip().splitlines()[-1]
    assert last.startswith('hapticvision: ')
    assert complaint in last
    assert not (tmp_path / 'out').exists()


def test_several_bags_have_a_folder_each_and_a_table(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    folders = []

    def done(_: object, __: Path, which: str, bag: Path, out: Path, ___: object) -> dict:
        folders.append(out)
        pair = {'measured': 0.00215, 'measured_std': 1e-5, 'simulated': 0.00294}
        unseen = {'measured': None, 'measured_std': None, 'simulated': 0.00706}
        return {
            'bag': str(bag),
            'push_speed_m_s': 0.0013,
            'depth_m': 0.010,
            'bouncing_m': pair,
            'residual_m': unseen,
        }

    monkeypatch.setattr('hapticvision_ros.cli.shape._study', lambda *_: None)
    monkeypatch.setattr('hapticvision_ros.cli.shape._done', done)
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), 'other.mcap', *TOOL]
    assert main([*arguments, '--out', str(tmp_path / 'out')]) == 0
    assert folders == [tmp_path / 'out' / CLOUDS.name, tmp_path / 'out' / 'other']
    table = json.loads((tmp_path / 'out' / 'shapes.json').read_text())
    assert [row['depth_m'] for row in table['trials']] == [0.010, 0.010]
    printed = capsys.readouterr().out
    assert printed.count('2.150') == printed.count('2.940') == printed.count('7.060') == 2
    assert main([*arguments[:4], 'a/other', *TOOL, '--out', str(tmp_path / 'out')]) == 2
    assert "two bags are called 'other'" in capsys.readouterr().err


def test_what_the_loop_accepts_is_what_is_simulated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    used = []

    def closed(trials: int, settings: ShapeSettings, _: object) -> tuple[Loop, ShapeSettings]:
        found = Loop(
            misfits={'as declared': (2e-4, 2e-4), 'spherical tool': (2e-5, 3e-5)},
            chosen='spherical tool',
            before=2e-4,
            after=2.5e-5,
            lowered=4e-8,
            lowered_std=1e-9,
            by_cells=1e-9,
            accepted=True,
            alike=(),
            verdict='spherical tool: asked for',
        )
        assert trials == 2
        # What it asks for is accepted, and then nothing more.
        found = replace(found, accepted=not settings.sphere)
        return found, replace(settings, sphere=True)

    def studied(_: Path, __: object, identified: Identified, settings: ShapeSettings) -> None:
        used.append((identified.model.name, settings.sphere))

    row = dict.fromkeys(('push_speed_m_s', 'depth_m'))
    row |= {key: {'measured': None, 'simulated': None} for key in ('bouncing_m', 'residual_m')}
    monkeypatch.setattr('hapticvision_ros.core.surface.loop.close_loop', closed)
    chain = {'K1': 1.0, 'C1': 2.0, 'C2': 3.0}
    doubt = 'm is not known well'
    growing = Identified(Model(('contact_growth',)), {**chain, 'm': 0.5}, None, warnings=(doubt,))
    monkeypatch.setattr(ByTip, '_other', lambda *_: replace(growing, anew=True))
    monkeypatch.setattr('hapticvision_ros.cli.shape._study', studied)
    monkeypatch.setattr('hapticvision_ros.cli.shape._differ', lambda _: None)
    monkeypatch.setattr('hapticvision_ros.cli.shape._done', lambda *_: row)
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), 'other.mcap', *TOOL]
    assert main([*arguments, '--close-loop', '--out', str(tmp_path / 'out')]) == 0
    assert used == [('three-element+contact_growth', True)] * 2
    told = json.loads((tmp_path / 'out' / 'shapes.json').read_text())['loop']
    assert [turn['accepted'] for turn in told] == [True, False]
    assert told[0]['misfit_m']['spherical tool'] == [2e-5, 3e-5]
    # No stub of the loop has asked for the other tip in the first turn.
    assert told[0]['fitted_anew'] is None
    assert told[1]['fitted_anew'] == {
        'model': 'three-element+contact_growth',
        'parameters': {**chain, 'm': 0.5},
        'warnings': [doubt],
    }
    printed = capsys.readouterr().out
    assert 'Accepted: spherical tool: asked for.' in printed
    assert '0.200 as declared, 0.025 with what the others choose' in printed
    assert '0.200 as accepted so far' in printed
    assert 'Not accepted' in printed
    assert 'fitted anew, with three-element+contact_growth: K1 1 N/m' in printed
    assert printed.count('m 0.5.') == 1
    assert printed.count(f'{doubt}.') == 1


def test_a_parameter_that_is_not_known_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = str(_result(tmp_path / 'result.json', C2=None))
    assert main(['shape', result, str(CLOUDS), *TOOL, '--out', str(tmp_path / 'out')]) == 2
    assert 'C2 (the best fit is a body that does not flow)' in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_refused_first(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / 'file'
    shutil.copy(_result(tmp_path / 'result.json'), file)
    assert main(['shape', str(file), str(CLOUDS), *TOOL, '--out', str(file / 'out')]) == 2
    assert 'is a file: name a directory' in capsys.readouterr().err


def test_what_was_fitted_anew_is_told_with_its_warnings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    chain = {'K1': 2000.0, 'C1': 1600.0, 'C2': 2400.0}
    doubt = 'C2 is known to a third only'
    anew = Identified(Model(), chain, 0.005, anew=True, warnings=(doubt,))
    monkeypatch.setattr('hapticvision_ros.cli.shape._identified', lambda *_: anew)
    out = tmp_path / 'out'
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), *TOOL]
    arguments += ['--small', '--rounds', '1', '--cell', '5mm', '--out', str(out)]
    assert main(arguments) == 0
    document = json.loads((out / 'shape.json').read_text())
    assert document['fitted_anew'] == chain
    assert doubt in document['warnings']
    assert doubt in (out / 'shape.html').read_text()


@pytest.mark.parametrize(
    ('asked', 'warned'),
    [
        (('9mm',), r'a tool of 8(\.\d+)? mm radius is seen in the hold, not of the 9 mm'),
        (('8mm', '--contact', '0', '-0.008'), r'the dent is \d+\.\d+ mm beside the axis of the'),
        (('8mm', '--average', '1'), 'a single frame at each time'),
    ],
)
def test_what_the_clouds_do_not_bear_out_is_warned_of(
    asked: tuple[str, ...], warned: str, folder: Path, tmp_path: Path
) -> None:
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), *TOOL]
    arguments[arguments.index('8mm')] = asked[0]
    arguments += ['--small', '--rounds', '1', '--cell', '5mm', *asked[1:]]
    assert main([*arguments, '--out', str(tmp_path / 'out')]) == 0
    told = json.loads((tmp_path / 'out' / 'shape.json').read_text())['warnings']
    assert sum(bool(re.search(warned, one)) for one in told) == 1
    usual = json.loads((folder / 'shape.json').read_text())['warnings']
    assert not any(re.search(warned, one) for one in usual)


def test_a_trial_is_not_held_out_of_its_own_copy(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    copy = tmp_path / 'copy'
    shutil.copytree(CLOUDS, copy)
    arguments = ['shape', str(_result(tmp_path / 'result.json')), str(CLOUDS), str(copy), *TOOL]
    assert main([*arguments, '--close-loop', '--out', str(tmp_path / 'out')]) == 2
    assert 'is the same trial as' in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()
