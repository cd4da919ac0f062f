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


import re

from hapticvision_ros.report.figure import Mark, Panel, Phase, Series, svg
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
    return svg(panel, 'a')


def texts(picture: str) -> list[str]:
    """Return what a person can read in a picture."""
    root = etree.fromstring(re.sub('xlink:', '', picture))
    return [''.join(node.itertext()).strip() for node in root.iter('text')]


def test_a_picture_takes_its_colours_from_the_page(picture: str) -> None:
    assert '#0102' not in picture
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
    assert re.search(r'<use [^>]*var\(--base-fit\)', picture)


def is_number(text: str) -> bool:
    """Return whether a tick's label is a number."""
    return re.fullmatch(r'\u2212?\d+(\.\d+)?', text) is not None


def test_identifiers_of_two_pictures_do_not_collide(panel: Panel, picture: str) -> None:
    other = set(re.findall(r' id="([^"]*)"', svg(panel, 'b')))
    assert other and not other & set(re.findall(r' id="([^"]*)"', picture))


def test_small_numbers_on_an_axis_keep_their_digits(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 500)
    small = Panel('Height', 'm', (Series('measured', 'm', t, 8e-4 * t / 10.0),), (), None, (), ())
    ticks = [text for text in texts(svg(small, 'a')) if is_number(text)]
    assert '0.0002' in ticks and '0.0008' in ticks


def test_few_samples_are_drawn_as_points(panel: Panel) -> None:
    t = np.linspace(0.0, 10.0, 80)
    few = Panel('Force', 'N', (Series('measured', 'm', t, np.sin(t)),), (), None, (), ())
    assert len(re.findall(r'<use [^>]*var\(--measured\)', svg(few, 'a'))) >= 80
