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


from dataclasses import replace
import re

from hapticvision_ros.core.records import FloatArray
from hapticvision_ros.report.figure import (
    curves_svg,
    Mark,
    Panel,
    Phase,
    Series,
    SmoothLine,
    svg,
)
from lxml import etree
import numpy as np
import pytest

NOISE = 0.05


@pytest.fixture(scope='module')
def panel() -> Panel:
    """Return a trial of 130 s at 1 kHz with one glitch, and a fit that is 10 % short of it."""
    t = np.arange(130_000) / 1000.0
    truth = np.interp(t, [2.0, 9.7, 70.0, 70.5], [0.0, 11.0, 3.0, 0.0])
    measured = truth + np.random.default_rng(3).normal(0.0, NOISE, t.size)
    measured[50_000] = 40.0
    return Panel(
        quantity='Force',
        unit='N',
        lines=(Series('measured', 'measured', t, measured), Series('base', 'fit', t, 0.9 * truth)),
        residuals=((Series('base', 'fit', t, measured - 0.9 * truth),),),
        noise=NOISE,
        phases=(Phase(2.0, 9.7, 'push'), Phase(9.7, 70.0, 'hold'), Phase(70.5, 130.0, 'recover')),
        marks=(Mark(2.0, 'T_c'), Mark(9.7, 'T_s'), Mark(70.0, 'T_e')),
    )


@pytest.fixture(scope='module')
def picture(panel: Panel) -> str:
    """Return the drawing of `panel`."""
    return svg(panel)


def texts(picture: str) -> list[str]:
    """Return what a person can read in a picture."""
    root = etree.fromstring(picture)
    return [''.join(node.itertext()).strip() for node in root.iter('text')]


def paths(picture: str, colour: str) -> list[str]:
    """Return the paths of a picture that are drawn or filled with a colour of the page."""
    root = etree.fromstring(picture)
    return [
        str(node.get('d'))
        for node in root.iter('path')
        if f'var(--{colour})' in str(node.get('style'))
    ]


def corners(path: str) -> FloatArray:
    """Return the corners of a line of one piece [points]."""
    start, steps = path.removeprefix('M').split('l')
    moves = [start, *steps.split()]
    return np.cumsum([[float(one) for one in move.split(',')] for move in moves], axis=0)


def test_a_picture_takes_its_colours_from_the_page(picture: str) -> None:
    assert not re.search(r'#[0-9a-f]{3}|rgb\(', picture)
    for name in ('ink', 'grid', 'band', 'shade-a', 'measured', 'base-fit'):
        assert f'var(--{name})' in picture


def test_a_picture_of_130_000_samples_stays_small(picture: str) -> None:
    # Two pictures a trial, 300 kB a trial.
    assert len(picture) < 150_000


def test_axes_carry_quantity_unit_and_phases(picture: str) -> None:
    seen = texts(picture)
    assert {'Force [N]', 'Residual [N]', 'Time [s]', 'push', 'hold', 'recover'} <= set(seen)
    assert {'Tc', 'Ts', 'Te'} <= set(seen)


def test_a_glitch_does_not_flatten_the_residual(picture: str) -> None:
    # The upper axis spans 40 N; only the residual's own can have ticks between 0 and 5 N.
    ticks = [float(text.replace('\u2212', '-')) for text in texts(picture) if is_number(text)]
    assert any(0.0 < tick < 5.0 for tick in ticks)
    # A triangle at the frame points at what is off the scale.
    (triangles,) = [path for path in paths(picture, 'base-fit') if path.endswith('z')]
    assert triangles.count('M') == 1


def is_number(text: str) -> bool:
    """Return whether a tick's label is a number."""
    return re.fullmatch(r'\u2212?\d+(\.\d+)?', text) is not None


def test_a_picture_has_no_identifiers_to_collide_with_those_of_others(picture: str) -> None:
    assert 'id=' not in picture


def test_a_line_stands_where_the_ticks_say(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 400)
    ramp = Panel('Force', 'N', (Series('measured', 'm', t, 3.0 * t),), (), None, (), ())
    picture = svg(ramp)
    (path,) = [one for one in paths(picture, 'measured') if 'l' in one]
    points = corners(path)
    root = etree.fromstring(picture)
    places = {
        ''.join(node.itertext()): (float(node.get('x')), float(node.get('y')))
        for node in root.iter('text')
        if node.get('x') and is_number(''.join(node.itertext()))
    }
    # '4' stands on the axis of time alone, '20' and '30' on that of the force.
    (x0, y0), (x1, y1) = points[0], points[-1]
    assert x0 + 0.4 * (x1 - x0) == pytest.approx(places['4'][0], abs=0.02)
    per_newton = (places['30'][1] - places['20'][1]) / 10.0
    assert y1 - y0 == pytest.approx(30.0 * per_newton, abs=0.05)
    assert np.allclose(np.diff(points, axis=0)[:, 1], (y1 - y0) / (t.size - 1), atol=0.011)


@pytest.mark.parametrize(
    ('low', 'high', 'expected'),
    [
        (-0.3, 1.1, ['\u22120.25', '0.00', '0.25', '0.50', '0.75', '1.00']),
        (0.0, 12.0, ['0', '2', '4', '6', '8', '10', '12']),
        (0.0, 4.0e-9, ['0', '1e\u221209', '2e\u221209', '3e\u221209', '4e\u221209']),
        (9.999e6, 1.0001e7, ['9.999e+06', '9.9995e+06', '1e+07', '1.00005e+07', '1.0001e+07']),
    ],
)
def test_ticks_are_round_and_told_apart(low: float, high: float, expected: list[str]) -> None:
    t = np.linspace(0.0, 10.0, 400)
    # The frame leaves a margin of 6 % about the values: this one's ends are `low` and `high`.
    value = np.interp(t, [0.0, 10.0], [low, high])
    inner = (value - 0.5 * (low + high)) / 1.12 + 0.5 * (low + high)
    one = Panel('Force', 'N', (Series('measured', 'm', t, inner),), (), None, (), ())
    ticks = [text for text in texts(svg(one)) if re.match(r'\u2212?\d', text)]
    assert ticks[: len(expected)] == expected


def test_a_gap_is_not_bridged(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 400)
    value = np.where((t > 4.0) & (t < 6.0), np.nan, t)
    gap = Panel('Force', 'N', (Series('measured', 'm', t, value),), (), None, (), ())
    assert any(path.count('M') == 2 for path in paths(svg(gap), 'measured'))


def test_a_fit_that_nowhere_exists_leaves_the_rest_of_the_picture(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 400)
    none = Series('base', 'fit', t, np.full(t.size, np.nan))
    one = Panel('Force', 'N', (Series('measured', 'm', t, t), none), ((none,),), None, (), ())
    assert {'fit', 'Force [N]', 'Residual [N]'} <= set(texts(svg(one)))


def test_names_with_markup_are_told_as_they_are() -> None:
    t = np.linspace(0.0, 10.0, 400)
    one = Panel('F < 0', 'N & m', (Series('measured', '<b>', t, t),), (), None, (), ())
    assert {'F < 0 [N & m]', '<b>'} <= set(texts(svg(one)))


def test_small_numbers_on_an_axis_keep_their_digits(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 500)
    small = Panel('Height', 'm', (Series('measured', 'm', t, 8e-4 * t / 10.0),), (), None, (), ())
    ticks = [text for text in texts(svg(small)) if is_number(text)]
    assert '0.0002' in ticks and '0.0008' in ticks


def test_few_samples_are_drawn_as_points(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 80)
    few = Panel('Force', 'N', (Series('measured', 'm', t, np.sin(t)),), (), None, (), ())
    assert max(path.count('h0') for path in paths(svg(few), 'measured')) == 80


def test_a_record_of_one_sample_has_a_picture(panel: Panel) -> None:
    """A sensor may go silent after its first reading."""
    one = tuple(Series(line.role, line.label, line.t[:1], line.value[:1]) for line in panel.lines)
    assert 'NaN' not in svg(replace(panel, lines=one, residuals=()))


def _line(trial: str, phase: str, value: list[float]) -> SmoothLine:
    t = np.linspace(0.0, 2.0, len(value))
    return SmoothLine(trial, phase, t, np.array(value), np.full(len(value), 0.01))


def test_curves_stand_phase_by_phase_with_a_row_for_each_model() -> None:
    before = [
        _line('one', 'hold', [0.1, 0.3, 0.2]),
        _line('<two>', 'hold', [-0.1, -0.3, -0.2]),
        _line('one', 'push', [0.0, 0.1, 0.0]),
    ]
    after = [_line('one', 'hold', [0.001, -0.001, 0.0])]
    picture = curves_svg([('base', before), ('base+more', after)], ['push', 'hold'], 'N')
    read = texts(picture)
    assert [one for one in read if one in ('push', 'hold')] == ['push', 'hold'] * 2
    assert [read.index(one) for one in ('base', 'base+more')] == sorted(
        read.index(one) for one in ('base', 'base+more')
    )
    assert read.count('Residual [N]') == 2
    assert {'one', '<two>'} <= set(read)
    root = etree.fromstring(picture)
    lines = [node for node in root.iter('path') if 'stroke-width:1.2' in str(node.get('style'))]
    assert len(lines) == 4
    colours = [re.findall(r'hsl\([^)]*\)', str(node.get('style')))[0] for node in lines]
    # The phases of the first row, then that of the second: a trial keeps its colour.
    assert colours[0] == colours[1] == colours[3] != colours[2]
    up, down = (corners(str(node.get('d'))) for node in lines[1:3])
    # On paper, y goes downwards.
    assert np.all(up[:, 1] < down[:, 1])
    assert up[:, 1].argmin() == down[:, 1].argmax() == 1


def test_no_curve_makes_no_picture_and_many_trials_no_list_of_names() -> None:
    assert curves_svg([('base', [])], ['push'], 'N') == ''
    many = [_line(f'trial {k}', 'hold', [0.1, 0.2, 0.1]) for k in range(40)]
    assert 'trial 3' not in texts(curves_svg([('base', many)], ['hold'], 'N'))
    few = curves_svg([('base', many[:20])], ['hold'], 'N')
    assert {f'trial {k}' for k in range(20)} <= set(texts(few))
    # Rows of names do not run over the edge, nor into the frame.
    places = [
        (float(str(node.get('x'))), node.getparent())
        for node in etree.fromstring(few).iter('text')
        if str(node.text).startswith('trial')
    ]
    assert max(x for x, _ in places) < 686.0
    assert len({row.get('transform') for _, row in places}) > 1
