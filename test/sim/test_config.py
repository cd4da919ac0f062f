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


"""A wrong description of the cell is refused in one sentence that says where."""

from math import inf
from pathlib import Path

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.core.units import KGF_PER_MM
from hapticvision_ros.sim.config import default_config_path, load_config, WorldConfig
import pytest
import yaml


def changed(tmp_path: Path, *keys: str, value: object) -> Path:
    """Write the shipped description with one entry changed, or removed for None."""
    content = yaml.safe_load(default_config_path().read_text())
    section = content
    for key in keys[:-1]:
        section = section[key]
    if value is None:
        del section[keys[-1]]
    else:
        section[keys[-1]] = value
    path = tmp_path / 'cell.yaml'
    path.write_text(yaml.safe_dump(content))
    return path


@pytest.mark.parametrize(
    ('keys', 'value', 'sentence'),
    [
        (('time_step',), None, "entry 'time_step' is missing"),
        (('block', 'length'), None, r"block: entry 'length' is missing"),
        (('block', 'colour'), 1.0, r"block: unknown entry 'colour'"),
        (('arm', 'watchdog'), 'soon', 'watchdog must be a number'),
        (('arm', 'watchdog'), True, 'watchdog must be a number'),
        (('load_cell', 'rate'), 0, 'rate is 0, but must lie in 1 to 1000'),
        (('load_cell', 'zero'), float('nan'), 'zero must be a number'),
        (('range_sensor',), 3, 'range_sensor: expected names with values'),
        (('objects', 'clay'), {}, 'objects: clay.*elastic_stiffness'),
        (('objects', 'clay'), {'elastic_stiffness': -1.0}, 'clay: elastic_stiffness must be'),
    ],
)
def test_a_wrong_entry_is_refused_by_name(
    tmp_path: Path, keys: tuple[str, ...], value: object, sentence: str
) -> None:
    with pytest.raises(InputError, match=sentence):
        load_config(changed(tmp_path, *keys, value=value))


def test_a_file_that_cannot_be_used_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match='cannot be read'):
        load_config(tmp_path / 'nowhere.yaml')
    broken = tmp_path / 'broken.yaml'
    broken.write_text('objects: [1, 2')
    with pytest.raises(InputError, match='is not valid YAML'):
        load_config(broken)


def test_an_unknown_object_is_refused_with_what_there_is(config: WorldConfig) -> None:
    with pytest.raises(InputError, match='choose one of dough, soft_dough, spring1'):
        config.material('cheese')


def test_the_springs_are_those_of_the_papers_table_1(config: WorldConfig) -> None:
    for name, kgf_per_mm in (('spring1', 0.37), ('spring2', 0.76), ('spring3', 1.13)):
        spring = config.material(name)
        assert spring.elastic_stiffness == pytest.approx(kgf_per_mm * KGF_PER_MM, rel=1e-12)
        assert spring.retardation_viscosity == 0.0
        assert spring.flow_viscosity == inf


def test_the_dough_has_the_papers_time_constants(config: WorldConfig) -> None:
    dough = config.material('dough')
    # Table 2, first row: 38.3 s and 16.8 s.
    assert dough.relaxation_time == pytest.approx(38.0, abs=0.5)
    assert dough.retardation_time == pytest.approx(17.0, abs=0.5)
