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

"""What the force says under another tip of the tool than the declared one."""

from dataclasses import replace
from pathlib import Path

from hapticvision_ros.cli.tips import ByTip, Identified
from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.fit import campaign
from hapticvision_ros.core.fit.campaign import fit
from hapticvision_ros.sim.campaigns import (
    Campaign,
    ForceNoise,
    Push,
    run,
    Sensors,
    write_bags,
)
from hapticvision_ros.sim.specimen import Body, Undeclared
import pytest

BODY = Body(1500.0, 1200.0, 2500.0)
CHAIN = {'K1': 2200.0, 'C1': 700.0, 'C2': 5000.0}


def _bags(folder: Path, *effects: Undeclared) -> list[Path]:
    pushes = tuple(Push(0.005, depth, 3.0, 2.0) for depth in (0.002, 0.004))
    campaign = Campaign(BODY, pushes, Sensors(ForceNoise(0.005), 1e-5))
    return list(write_bags(run(campaign, effects, seed=3), folder))


@pytest.fixture(scope='module')
def growing(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Return bags of an object whose contact grows as that of a sphere."""
    return _bags(tmp_path_factory.mktemp('growing'), Undeclared('contact_growth', (0.5,)))


def test_under_a_sphere_the_chain_is_that_beside_its_contact(growing: list[Path]) -> None:
    declared = Identified(Model(), CHAIN, 0.004)
    of_tip = ByTip(growing, declared, sphere=False)
    assert of_tip(False) is declared
    found = of_tip(True)
    assert found.anew
    assert found.model == Model(('contact_growth',))
    assert found.parameters['m'] == pytest.approx(0.5, abs=0.02)
    assert found.parameters['K1'] == pytest.approx(BODY.K1, rel=0.03)
    assert found.reference_depth == pytest.approx(0.004, rel=0.02)
    assert of_tip(True) is found


def test_a_flat_tool_has_no_contact_that_grows(growing: list[Path]) -> None:
    declared = Identified(Model(('contact_growth',)), {**CHAIN, 'm': 0.5}, 0.004)
    found = ByTip(growing, declared, sphere=True)(False)
    assert found.anew
    assert found.model == Model()


def test_under_a_sphere_a_contact_that_does_not_grow_leaves_the_chain(tmp_path: Path) -> None:
    declared = Identified(Model(), CHAIN, 0.004)
    found = ByTip(_bags(tmp_path), declared, sphere=False)(True)
    assert found.parameters['m'] == pytest.approx(0.0, abs=1e-3)
    assert found.parameters['K1'] == pytest.approx(BODY.K1, rel=0.03)


def test_what_the_fit_warns_of_is_kept(
    growing: list[Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    doubt = ('m is known to a third only',)

    def doubting(*given: object) -> object:
        return replace(fit(*given), warnings=doubt)  # type: ignore[arg-type]

    monkeypatch.setattr(campaign, 'fit', doubting)
    of_tip = ByTip(growing, Identified(Model(), CHAIN, 0.004), sphere=False)
    assert of_tip.anew is None
    assert of_tip(True).warnings == doubt
    assert of_tip.anew is of_tip(True)


def test_nothing_is_read_where_no_model_changes(tmp_path: Path) -> None:
    declared = Identified(Model(), CHAIN, 0.004)
    assert ByTip([tmp_path / 'none'], declared, sphere=True)(False) is declared


def test_bags_that_tell_nothing_are_asked_once(tmp_path: Path) -> None:
    of_tip = ByTip([tmp_path / 'none'], Identified(Model(), CHAIN, 0.004), sphere=False)
    for _ in range(2):
        with pytest.raises(InputError, match='none'):
            of_tip(True)
