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

"""The verb `export`: from a result.json to each format, and what it refuses."""

import json
from pathlib import Path
import subprocess
import sys

from hapticvision_ros import Campaign, fit, haptic, Model
from hapticvision_ros.cli.main import main
from hapticvision_ros.core.errors import InputError
import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]

SIZE = ['--area', '20cm2', '--height', '40mm']
FINITE_ELEMENTS = [*SIZE, '--poisson', '0.45']


def _parameter(value: float | None, unit: str, std: float | None = None) -> dict:
    return {'value': value, 'std': std, 'unit': unit, 'identifiable': value is not None}


@pytest.fixture
def result(tmp_path: Path) -> Path:
    """Return a result with a base model and one with what it lacked."""
    path = tmp_path / 'result.json'
    base = {
        'K1': _parameter(1500.0, 'N/m'),
        'C1': _parameter(1600.0, 'N.s/m'),
        'C2': _parameter(None, 'N.s/m'),
    }
    better = {
        'K1': _parameter(2000.0, 'N/m', 20.0),
        'C1': _parameter(1600.0, 'N.s/m', 8.0),
        'C2': _parameter(2400.0, 'N.s/m', 12.0),
        'F_y': _parameter(6.0, 'N', 0.1),
    }
    document = {
        'schema': 'hapticvision/result/1',
        'before': {'model': 'three-element', 'parameters': base},
        'after': {'model': 'three-element+yield_force', 'parameters': better},
        'warnings': ['C2 is unknown: the best fit is a body that does not flow'],
    }
    path.write_text(json.dumps(document))
    return path


def _export(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> str:
    assert main(['export', *map(str, arguments)]) == 0
    return capsys.readouterr().out


def test_the_better_model_is_exported_with_its_errors(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads(_export(capsys, result, '--format', 'json', *SIZE))
    assert document['model'] == 'three-element+yield_force'
    assert document['material']['K1'] == {
        'symbol': 'E1',
        'value': 40e3,
        'std': 400.0,
        'unit': 'Pa',
        'reason': None,
    }
    assert document['material']['F_y']['value'] == 3e3


def test_terms_have_errors_where_the_result_tells_how_those_of_the_parameters_go_together(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = (result, '--format', 'json', '--linearise', 'reference')
    without = json.loads(_export(capsys, *asked))
    assert without['relaxation']['terms'][0]['stiffness_std_N_m'] is None
    assert 'hapticvision fit' in without['reasons']['relaxation_std']
    document = json.loads(result.read_text())
    document['after']['correlation'] = [[float(i == j) for j in range(4)] for i in range(4)]
    result.write_text(json.dumps(document))
    told = json.loads(_export(capsys, *asked))
    # T = (C1 + C2) / K1 = 2 s.
    error = 2.0 * ((20.0 / 2000.0) ** 2 + (8.0**2 + 12.0**2) / 4000.0**2) ** 0.5
    assert told['relaxation']['terms'][0]['relaxation_time_std_s'] == pytest.approx(error)
    document['after']['correlation'] = [[1.0]]
    result.write_text(json.dumps(document))
    assert main(['export', *map(str, asked)]) == 2
    assert 'correlation' in capsys.readouterr().err


def test_the_size_may_come_in_si(result: Path, capsys: pytest.CaptureFixture[str]) -> None:
    same = ['--area', '2e-3', '--height', '0.04']
    texts = [_export(capsys, result, '--format', 'json', *size) for size in (SIZE, same)]
    assert texts[0] == texts[1]


def test_finite_element_formats_go_to_a_file(
    result: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    options = [*FINITE_ELEMENTS, '--linearise', 'reference', '--shortest-time', '0.01']
    for name, keyword in (('abaqus', '*VISCOELASTIC, TIME=PRONY'), ('ansys', 'TB,PRONY,1,1,2')):
        out = tmp_path / f'material.{name}'
        said = _export(capsys, result, '--format', name, *options, '--out', out)
        assert said == f'Wrote {out}.\n'
        text = out.read_text()
        assert keyword in text
        assert 'linearised at: reference' in text
        assert 'nothing faster than 0.01 s is resolved' in text


def test_an_unknown_parameter_of_the_base_model_is_null_with_its_reason(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = _export(capsys, result, '--format', 'json', '--which', 'before')
    assert json.loads(text)['parameters']['C2'] == {
        'value': None,
        'std': None,
        'unit': 'N.s/m',
        'reason': 'the best fit is a body that does not flow',
    }


def test_the_reason_is_that_of_the_parameter_and_of_the_model(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    document = json.loads(result.read_text())
    better = document['after']['parameters']
    better['F_y'] = _parameter(None, 'N')
    document['warnings'] = [
        'C2 is unknown: F_y is too small',
        'before: F_y is unknown: of the other model',
        'after: F_y is unknown: no trial shows it',
    ]
    result.write_text(json.dumps(document))
    text = _export(capsys, result, '--format', 'json')
    assert json.loads(text)['parameters']['F_y']['reason'] == 'no trial shows it'


@pytest.mark.parametrize(
    ('arguments', 'says'),
    [
        (['--format', 'csv'], 'choose the point at which to linearise it'),
        (['--format', 'csv', '--which', 'before'], 'the trials do not tell C2'),
        (['--format', 'abaqus', *SIZE, '--linearise', 'rest'], 'needs area and height'),
        (
            ['--format', 'abaqus', '--poisson', '0.4', '--linearise', 'rest'],
            'needs area and height',
        ),
        (['--format', 'json', '--area', '20cm2'], 'belong together'),
        (['--format', 'json', '--area', '20kg', '--height', '1'], "--area '20kg' is no size"),
        (['--format', 'json', '--area', '1', '--height', '0mm'], "--height '0mm' is no size"),
        (['--format', 'json', '--area', '51', '--height', '0.04'], '--area is 51 m2, which no'),
        (['--format', 'json', '--area', '51cm2', '--height', '40'], '--height is 40 m, which no'),
        (['--format', 'json', '--area', '1e400', '--height', '1'], "--area '1e400' is no size"),
        (['--format', 'json', '--area', '1', '--height', '1e-400'], "'1e-400' is no size"),
        (['--format', 'json', '--area', '1', '--height', '1e-322um'], "'1e-322um' is no size"),
        (
            ['--format', 'ansys', *FINITE_ELEMENTS, '--linearise', 'reference'],
            'name the shortest time',
        ),
        (
            ['--format', 'ansys', *FINITE_ELEMENTS, '--linearise', 'rest', '--shortest-time', '0'],
            'must be above zero',
        ),
        (['--format', 'json', '--out', '/nowhere/export.json'], 'choose another --out'),
    ],
)
def test_what_cannot_be_exported_is_told_in_one_sentence(
    result: Path, arguments: list[str], says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['export', str(result), *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ''
    assert says in shown.err
    assert shown.err.count('\n') == 1


@pytest.mark.parametrize(
    ('text', 'says'),
    [
        (None, 'cannot be read'),
        ('{', 'is no JSON'),
        ('[]', 'is no result'),
        ('{"schema": "hapticvision/shapes/1"}', 'is no result'),
        ('{"schema": "hapticvision/result/2"}', 'fit the bags with this version'),
        ('{"schema": "hapticvision/result/1", "before": null}', "no model 'before'"),
        (
            '{"schema": "hapticvision/result/1", "warnings": [],'
            ' "before": {"model": "three-element", "parameters": {"K1": {"value": 1}}}}',
            'does not hold the parameters',
        ),
    ],
)
def test_a_file_that_is_no_result_is_told_in_one_sentence(
    tmp_path: Path, text: str | None, says: str, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / 'result.json'
    if text is not None:
        path.write_text(text)
    assert main(['export', str(path), '--format', 'json']) == 2
    error = capsys.readouterr().err
    assert says in error
    assert error.count('\n') == 1


def test_arguments_are_checked_without_numerics() -> None:
    code = (
        'import sys\n'
        'from hapticvision_ros.cli.main import main\n'
        "assert main(['export', 'a', '--format', 'stone']) == 2\n"
        "sys.exit('numpy' in sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, '-c', code], stderr=subprocess.DEVNULL, timeout=60, check=False
    )
    assert done.returncode == 0


def test_a_stepper_from_a_result_is_that_of_the_fit(tmp_path: Path) -> None:
    bag = str(ROOT / 'bags' / 'synthetic_soft_block' / 'speed_5mm_s_depth_8mm')
    # Damage counts from the depth of the deepest push, which the file has to tell.
    name = 'three-element+damage'
    assert main(['fit', bag, '--model', name, '--out', str(tmp_path)]) == 0
    from_file = haptic(tmp_path / 'result.json')
    from_fit = haptic(fit(Campaign.read(bag), Model.parse(name)))
    path = np.concatenate([np.linspace(0.0, 0.006, 300), np.full(200, 0.006), np.zeros(100)])
    forces = np.array([[body.step(depth) for depth in path] for body in (from_file, from_fit)])
    assert forces.max() > 1.0
    np.testing.assert_allclose(forces[0], forces[1], atol=2e-3 * forces.max())
    assert haptic(tmp_path / 'result.json', which='before').step(0.001) > 0.0
    with pytest.raises(InputError, match='cannot be read'):
        haptic(str(tmp_path / 'no_result.json'))


@pytest.mark.parametrize('name', ['result.json', """it's "of" {two} \\ \"\"\" '''.json"""])
def test_step_function_runs_on_its_own(result: Path, tmp_path: Path, name: str) -> None:
    document = json.loads(result.read_text())
    # Damage counts from the deepest push, which the file has to tell.
    document['trials'] = [{'depth_m': 0.004}, {'depth_m': 0.008}]
    document['after']['model'] += '+damage'
    document['after']['parameters']['D'] = _parameter(0.4, '-', 0.01)
    result = tmp_path / name
    result.write_text(json.dumps(document))
    written = tmp_path / 'body.py'
    assert main(['export', str(result), '--format', 'haptic', '--out', str(written)]) == 0
    way = np.linspace(0.0, 0.008, 200)
    body = haptic(result)
    told = [body.step(float(displacement)) for displacement in way]
    lines = '\n'.join(repr(float(displacement)) for displacement in way)
    done = subprocess.run(
        [sys.executable, str(written)], input=lines, capture_output=True, text=True, check=True
    )
    np.testing.assert_array_equal([float(line) for line in done.stdout.split()], told)
    assert max(told) > 1.0
    for wrong in ('deep', 'nan'):
        done = subprocess.run(
            [sys.executable, str(written)],
            check=False,
            input=f'0.001\n{wrong}\n',
            capture_output=True,
            text=True,
        )
        assert done.returncode == 2
        assert done.stderr == f'line 2 is no finite number: {wrong}\n'


@pytest.mark.parametrize(
    ('parameter', 'value', 'depth', 'says'),
    [
        ('K1', -2000.0, 0.008, 'K1 of the model is -2000, which no body can have'),
        ('C2', 0.0, 0.008, 'C2 of the model is 0'),
        ('C1', float('nan'), 0.008, 'C1'),
        ('D', 0.4, None, 'deepest push'),
        ('D', 0.4, float('inf'), 'deepest push'),
    ],
)
def test_step_function_of_no_body_is_refused(
    parameter: str,
    value: float,
    depth: float | None,
    says: str,
    result: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    document = json.loads(result.read_text())
    document['trials'] = [{'depth_m': depth}]
    document['after']['model'] += '+damage'
    document['after']['parameters']['D'] = _parameter(0.4, '-', 0.01)
    document['after']['parameters'][parameter]['value'] = value
    result.write_text(json.dumps(document))
    assert main(['export', str(result), '--format', 'haptic']) == 2
    told = capsys.readouterr()
    assert told.out == ''
    assert says in told.err
    assert told.err.count('\n') == 1


@pytest.mark.parametrize('option', [['--poisson', '0.45'], SIZE, ['--shortest-time', '0.1']])
def test_step_function_takes_no_option_of_a_continuum(
    option: list[str], result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['export', str(result), '--format', 'haptic', *option]) == 2
    assert 'leave out' in capsys.readouterr().err


def test_step_function_needs_all_parameters(
    result: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(['export', str(result), '--format', 'haptic', '--which', 'before']) == 2
    assert 'C2' in capsys.readouterr().err
