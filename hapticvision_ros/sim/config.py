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


"""The description of a simulated cell: what stands in it, and how its devices measure."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, MISSING
from math import inf, isnan
import os
from pathlib import Path
import sys

from hapticvision_ros.core.errors import InputError
from hapticvision_ros.sim.objects import Material
import yaml

CONFIG_NAME = 'sim_world.yaml'


@dataclass(frozen=True, slots=True)
class Block:
    """
    The object's shape: a block that lies on the support plane, centred under the tool.

    Parameters
    ----------
    length, width, height : float
        Size along x, y and z [m] before the rotation.
    yaw : float
        Rotation about z [rad].
    rim_width : float
        Distance outside the tool's edge over which the dent runs out [m].

    """

    length: float
    width: float
    height: float
    yaw: float
    rim_width: float


@dataclass(frozen=True, slots=True)
class ToolArm:
    """
    The arm: a flat, round tool that moves along z.

    Parameters
    ----------
    tool_radius : float
        Radius of the tool [m].
    start_height, lowest_height, highest_height : float
        Tool tip above the support plane [m]: at the start, and its end stops.
    acceleration : float
        Largest acceleration [m/s^2].
    watchdog : float
        The arm stops when no command has come for this time [s].
    encoder_resolution, encoder_noise : float
        Quantum and standard deviation of the height that the arm reads [m].
    state_rate : float
        Rate of the arm's readings [Hz].

    """

    tool_radius: float
    start_height: float
    lowest_height: float
    highest_height: float
    acceleration: float
    watchdog: float
    encoder_resolution: float
    encoder_noise: float
    state_rate: float


@dataclass(frozen=True, slots=True)
class LoadCellModel:
    """
    How the load cell measures.

    Parameters
    ----------
    rate : float
        Samples per second [Hz].
    white_noise : float
        Standard deviation of the noise that is new in each sample [N].
    slow_noise, slow_noise_time : float
        Standard deviation [N] and correlation time [s] of the first-order autoregressive noise.
    zero : float
        Reading without load [N].
    drift : float
        Drift of the zero [N/s].

    """

    rate: float
    white_noise: float
    slow_noise: float
    slow_noise_time: float
    zero: float
    drift: float


@dataclass(frozen=True, slots=True)
class RangeSensorModel:
    """
    Where the range sensor stands and what it sees.

    Parameters
    ----------
    rate : float
        Frames per second [Hz].
    elevation : float
        Angle of the view above the horizon [rad].
    distance : float
        Distance from the object's top, under the tool [m].
    field_of_view : float
        Full horizontal angle [rad].
    dropout : float
        Share of the pixels without a return.
    table_size : float
        Side of the square of support plane that returns light [m].

    """

    rate: float
    elevation: float
    distance: float
    field_of_view: float
    dropout: float
    table_size: float


@dataclass(frozen=True, slots=True)
class SoftBodyModel:
    """
    How the object deforms, where it is a body of mass points and not a chain with a dent.

    Parameters
    ----------
    pitch : float
        Side of a cell, which divides the block's sides [m].
    step : float
        Time step [s]; the finer, the less inertia.
    volume_ratio : float
        Stiffness against a change of volume over Young's modulus [-]; zero for a material with a
        Poisson's ratio of 1/4.
    friction : float
        Coulomb's coefficient under the block [-]; infinite for one that is glued to the support.
    sphere : bool
        Whether the tool ends in a sphere of its radius; else it is flat.

    """

    pitch: float
    step: float
    volume_ratio: float
    friction: float = inf
    sphere: bool = False


@dataclass(frozen=True, slots=True)
class WorldConfig:
    """
    A simulated cell: its parts and the objects that can be placed in it, by name.

    Without `soft_body` an object is a chain of springs and dashpots, and what is seen of it a
    block with a dent.
    """

    time_step: float
    block: Block
    arm: ToolArm
    load_cell: LoadCellModel
    range_sensor: RangeSensorModel
    objects: Mapping[str, Material]
    soft_body: SoftBodyModel | None = None

    def material(self, name: str) -> Material:
        """
        Return the material of the object called `name`.

        Raises
        ------
        InputError
            If there is none.

        """
        try:
            return self.objects[name]
        except KeyError:
            known = ', '.join(sorted(self.objects))
            raise InputError(
                f'there is no simulated object {name!r}: choose one of {known}'
            ) from None


_RANGES: Mapping[str, tuple[float, float]] = {
    'time_step': (1e-5, 2e-3),
    'length': (0.03, 1.0),
    'width': (0.03, 1.0),
    'height': (0.005, 0.5),
    'yaw': (-3.2, 3.2),
    'rim_width': (1e-4, 0.1),
    'tool_radius': (1e-3, 0.1),
    'start_height': (0.0, 1.0),
    'lowest_height': (0.0, 1.0),
    'highest_height': (0.0, 1.0),
    'acceleration': (0.01, 100.0),
    'watchdog': (0.005, 10.0),
    'encoder_resolution': (0.0, 1e-3),
    'encoder_noise': (0.0, 1e-3),
    'state_rate': (1.0, 1000.0),
    'rate': (1.0, 1000.0),
    'white_noise': (0.0, 100.0),
    'slow_noise': (0.0, 100.0),
    'slow_noise_time': (1e-4, 100.0),
    'zero': (-1000.0, 1000.0),
    'drift': (-10.0, 10.0),
    'elevation': (0.1, 1.57),
    'distance': (0.1, 5.0),
    'field_of_view': (0.05, 2.0),
    'dropout': (0.0, 0.9),
    'table_size': (0.1, 10.0),
    'pitch': (1e-3, 0.05),
    'step': (1e-5, 2e-3),
    'volume_ratio': (0.0, 50.0),
    'friction': (0.0, inf),
}


def _number(value: object, name: str, where: str) -> float:
    """Return `value` as a number, inside the range of `name` where it has one."""
    if isinstance(value, bool) or not isinstance(value, int | float) or isnan(value):
        raise InputError(f'{where}: {name} must be a number, not {value!r}')
    low, high = _RANGES.get(name, (float('-inf'), float('inf')))
    if not low <= value <= high:
        raise InputError(f'{where}: {name} is {value:g}, but must lie in {low:g} to {high:g}')
    return float(value)


def _flag(value: object, name: str, where: str) -> bool:
    """Return `value` as true or false."""
    if not isinstance(value, bool):
        raise InputError(f'{where}: {name} must be true or false, not {value!r}')
    return value


def _section(value: object, where: str) -> Mapping[str, object]:
    """Return `value` as a mapping with text keys."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InputError(f'{where}: expected names with values below it')
    return value


def _build[T](cls: type[T], value: object, where: str, *, optional: bool = False) -> T:
    """Return a `cls` whose fields are the numbers in `value`."""
    section = _section(value, where)
    names = [field.name for field in fields(cls)]  # type: ignore[arg-type]
    unknown = sorted(set(section) - set(names))
    if unknown:
        raise InputError(f'{where}: unknown entry {unknown[0]!r}; known are {", ".join(names)}')
    needed = [f.name for f in fields(cls) if f.default is MISSING]  # type: ignore[arg-type]
    missing = [name for name in needed if name not in section]
    if missing and not optional:
        raise InputError(f'{where}: entry {missing[0]!r} is missing')
    flags = {field.name for field in fields(cls) if field.type is bool}  # type: ignore[arg-type]
    numbers = {
        name: _flag(value, name, where) if name in flags else _number(value, name, where)
        for name, value in section.items()
    }
    try:
        return cls(**numbers)
    except (TypeError, ValueError) as error:
        raise InputError(f'{where}: {error}') from error


def default_config_path() -> Path:
    """
    Return the description of the cell that comes with the package.

    Raises
    ------
    InputError
        If it is not installed.

    """
    package = Path(__file__).resolve().parents[1]
    share = Path('share') / package.name / 'config'
    prefixes = [Path(p) for p in os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep) if p]
    folders = [package.parent / 'config']
    folders += [prefix / share for prefix in (*prefixes, Path(sys.prefix))]
    for folder in folders:
        if (folder / CONFIG_NAME).is_file():
            return folder / CONFIG_NAME
    raise InputError(f'{CONFIG_NAME} is not installed: give its path with --config')


def load_config(path: Path | None = None) -> WorldConfig:
    """
    Read the description of a simulated cell.

    Parameters
    ----------
    path : Path or None
        A YAML file; None for the one that comes with the package.

    Returns
    -------
    WorldConfig
        The cell, checked.

    Raises
    ------
    InputError
        If the file cannot be read or an entry is missing, unknown or out of range.

    """
    path = default_config_path() if path is None else path
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f'{path}: cannot be read ({error})') from error
    except yaml.YAMLError as error:
        raise InputError(f'{path}: is not valid YAML ({error})'.replace('\n', ' ')) from error
    where = str(path)
    section = _section(content, where)
    for name in (field.name for field in fields(WorldConfig)):
        if name not in section and name != 'soft_body':
            raise InputError(f'{where}: entry {name!r} is missing')
    objects = {
        name: _build(Material, value, f'{where}: objects: {name}', optional=True)
        for name, value in _section(section['objects'], f'{where}: objects').items()
    }
    return WorldConfig(
        time_step=_number(section['time_step'], 'time_step', where),
        block=_build(Block, section['block'], f'{where}: block'),
        arm=_build(ToolArm, section['arm'], f'{where}: arm'),
        load_cell=_build(LoadCellModel, section['load_cell'], f'{where}: load_cell'),
        range_sensor=_build(RangeSensorModel, section['range_sensor'], f'{where}: range_sensor'),
        objects=objects,
        soft_body=None
        if section.get('soft_body') is None
        else _build(SoftBodyModel, section['soft_body'], f'{where}: soft_body'),
    )
