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

"""
Parameters of the nodes: declared from one frozen table, with defaults from ``config/``.

A node has no number of its own: its table says what may be set, its file what is set.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
import math
from pathlib import Path
from typing import Any, Final, Literal

from hapticvision_ros.bag.contract import Topic
from hapticvision_ros.core.errors import InputError, UsageError
from hapticvision_ros.nodes.qos import interface_class, relative_name, subscription_profile
from hapticvision_ros.share import share_folder
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.event_handler import SubscriptionEventCallbacks
import yaml

type Kind = Literal['bool', 'integer', 'double', 'string', 'double_array']
type Check = Callable[[Mapping[str, Any]], str | None]

_EXAMPLES: Final = {
    'bool': 'true',
    'integer': '10',
    'double': '10.0',
    'string': "'text'",
    'double_array': '[1.0, 2.0]',
}
_PUSHING: Final = ('approach', 'push', 'hold', 'release', 'recover')
_AT_REST: Final = ('done', 'aborted')
_FOREIGN_PREFIXES: Final = ('use_sim_time', 'qos_overrides.', 'start_type_description_service')


@dataclass(frozen=True, slots=True)
class ParameterSpec:
    """
    One parameter of a node.

    Parameters
    ----------
    name : str
        Its name, without a prefix.
    kind : {'bool', 'integer', 'double', 'string', 'double_array'}
        Its type; a value of another type is refused, never converted.
    unit : str
        SI unit; ``-`` where it has none.
    description : str
        One sentence for the people who set it.
    minimum, maximum : float or None
        The closed range of a number, or of each number of an array.
    choices : tuple of str
        The allowed texts; empty where any text is allowed.
    read_only : bool
        Whether it is fixed once the node has started.

    """

    name: str
    kind: Kind
    unit: str
    description: str
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple[str, ...] = ()
    read_only: bool = False

    def refusal(self, value: Any) -> str | None:
        """Return why `value` cannot be taken, as one sentence, or None if it can."""
        if not self._has_type(value):
            return (
                f"Parameter '{self.name}' is {value!r}, not of type {self.kind}: write "
                f'it for example as {_EXAMPLES[self.kind]}.'
            )
        if self.choices and value not in self.choices:
            return f"Parameter '{self.name}' is {value!r}; choose from {', '.join(self.choices)}."
        low = -math.inf if self.minimum is None else self.minimum
        high = math.inf if self.maximum is None else self.maximum
        unit = '' if self.unit == '-' else f' {self.unit}'
        for number in self._numbers(value):
            if not (math.isfinite(number) and low <= number <= high):
                return (
                    f"Parameter '{self.name}' is {value!r}; it must lie between {low:g} and "
                    f'{high:g}{unit}.'
                )
        return None

    def descriptor(self) -> Any:
        """Return the descriptor that tools such as rqt show."""
        unit = '' if self.unit == '-' else f' [{self.unit}]'
        descriptor = ParameterDescriptor(
            name=self.name,
            description=self.description + unit,
            additional_constraints=' | '.join(self.choices),
            read_only=self.read_only,
        )
        if self.minimum is not None and self.maximum is not None:
            if self.kind == 'integer':
                descriptor.integer_range = [
                    IntegerRange(from_value=int(self.minimum), to_value=int(self.maximum))
                ]
            elif self.kind == 'double':
                descriptor.floating_point_range = [
                    FloatingPointRange(
                        from_value=float(self.minimum), to_value=float(self.maximum)
                    )
                ]
        return descriptor

    def _has_type(self, value: Any) -> bool:
        match self.kind:
            case 'bool':
                return isinstance(value, bool)
            case 'integer':
                return isinstance(value, int) and not isinstance(value, bool)
            case 'double':
                return isinstance(value, float)
            case 'string':
                return isinstance(value, str)
            case 'double_array':
                return (
                    isinstance(value, Sequence)
                    and not isinstance(value, str)
                    and len(value) > 0
                    and all(isinstance(item, float) for item in value)
                )

    def _numbers(self, value: Any) -> Iterable[float]:
        match self.kind:
            case 'integer' | 'double':
                return (value,)
            case 'double_array':
                return tuple(value)
            case _:
                return ()


def config_file(node_name: str) -> Path:
    """Return the file with the defaults of a node's parameters."""
    return share_folder() / 'config' / f'{node_name}.yaml'


def default_values(node_name: str, table: Sequence[ParameterSpec]) -> dict[str, Any]:
    """
    Read the defaults of a node's parameters from its file in ``config/``.

    Parameters
    ----------
    node_name : str
        The node's own name, also the file's.
    table : sequence of ParameterSpec
        What the node declares.

    Returns
    -------
    dict of str to value
        One checked value for each row of the table.

    Raises
    ------
    InputError
        If the file is missing, is no ROS parameter file, or does not fit the table.

    """
    path = config_file(node_name)
    try:
        content = yaml.safe_load(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise InputError(
            f'Cannot read the parameters of {node_name} from {path}: {error.strerror}.'
        ) from error
    except yaml.YAMLError as error:
        first_line = str(error).splitlines()[0]
        raise InputError(f'{path} is not valid YAML ({first_line}).') from error
    try:
        values = content['/**']['ros__parameters']
    except (KeyError, TypeError) as error:
        raise InputError(
            f'{path} is no ROS parameter file: it needs /** and below it ros__parameters.'
        ) from error
    if not isinstance(values, dict):
        raise InputError(f'{path} sets no parameters below ros__parameters.')
    _refuse_unknown(values, table, str(path))
    for spec in table:
        if spec.name not in values:
            raise InputError(f"{path} has no value for the parameter '{spec.name}'.")
        refusal = spec.refusal(values[spec.name])
        if refusal:
            raise InputError(f'{path}: {refusal}')
    return values


def _refuse_unknown(names: Iterable[str], table: Sequence[ParameterSpec], where: str) -> None:
    known = {spec.name for spec in table}
    for name in names:
        if name not in known and not name.startswith(_FOREIGN_PREFIXES):
            raise UsageError(
                f"{where}: unknown parameter '{name}'; there are {', '.join(sorted(known))}."
            )


class Parameters:
    """
    The declared parameters of a node, read with their types.

    Parameters
    ----------
    node : rclpy.node.Node
        A node that was made with ``automatically_declare_parameters_from_overrides``, so that
        what the user has set is known before it is checked against the table.
    name : str
        The node's own name, also of its file in ``config/``.
    table : sequence of ParameterSpec
        What it declares.

    Raises
    ------
    InputError, UsageError
        If the file or what the user set (``--params-file``, ``-p``) does not fit the table.

    """

    def __init__(self, node: Any, name: str, table: Sequence[ParameterSpec]) -> None:
        self._node = node
        self._specs = {spec.name: spec for spec in table}
        self._checks: list[Check] = []
        defaults = default_values(name, table)
        given = {key: item.value for key, item in node.get_parameters_by_prefix('').items()}
        _refuse_unknown(given, table, name)
        for spec in table:
            value = defaults[spec.name]
            if spec.name in given:
                value = given[spec.name]
                refusal = spec.refusal(value)
                if refusal:
                    raise UsageError(f'{name}: {refusal}')
                node.undeclare_parameter(spec.name)
            node.declare_parameter(spec.name, value, spec.descriptor())
        node.add_on_set_parameters_callback(self._on_set)

    def add_check(self, check: Check) -> None:
        """Let `check` see each change (name to new value) and return a refusal or None."""
        self._checks.append(check)

    def flag(self, name: str) -> bool:
        """Return a bool."""
        return bool(self._node.get_parameter(name).value)

    def integer(self, name: str) -> int:
        """Return an integer."""
        return int(self._node.get_parameter(name).value)

    def real(self, name: str) -> float:
        """Return a double."""
        return float(self._node.get_parameter(name).value)

    def text(self, name: str) -> str:
        """Return a string."""
        return str(self._node.get_parameter(name).value)

    def reals(self, name: str) -> tuple[float, ...]:
        """Return an array of doubles."""
        return tuple(float(item) for item in self._node.get_parameter(name).value)

    def _on_set(self, changes: Sequence[Any]) -> Any:
        for change in changes:
            spec = self._specs.get(change.name)
            refusal = spec.refusal(_plain(change.value)) if spec else None
            if refusal:
                return SetParametersResult(successful=False, reason=refusal)
        values = {change.name: _plain(change.value) for change in changes}
        for check in self._checks:
            refusal = check(values)
            if refusal:
                return SetParametersResult(successful=False, reason=refusal)
        return SetParametersResult(successful=True)


class RunningPush:
    """
    Whether a push is running, as the arm push controller tells it.

    Parameters
    ----------
    node : rclpy.node.Node
        Who asks; its executor hears the phase.
    topic : Topic
        Where the phase is told, latched.

    """

    def __init__(self, node: Any, topic: Topic) -> None:
        self._phase: str | None = None
        node.create_subscription(
            interface_class(topic.msgtype),
            relative_name(topic.name),
            self._on_phase,
            subscription_profile(topic.qos),
            event_callbacks=SubscriptionEventCallbacks(matched=self._on_matched),
        )

    @property
    def phase(self) -> str | None:
        """Return the phase of the running push, or None while there is none."""
        return self._phase

    def refusal(self, changes: Mapping[str, Any]) -> str | None:
        """Return why parameters cannot be changed now, or None if they can."""
        if self._phase is None:
            return None
        return (
            f"A push is running (in the phase '{self._phase}'): stop it or wait for its end "
            f'before changing {", ".join(sorted(changes))}.'
        )

    def _on_phase(self, message: Any) -> None:
        if message.data in _PUSHING:
            self._phase = message.data
        elif message.data in _AT_REST:
            self._phase = None

    def _on_matched(self, status: Any) -> None:
        # A controller that has died in a push would keep the parameters locked for ever.
        if not status.current_count:
            self._phase = None


def refuse_changes_while_pushing(node: Any, topic: Topic) -> None:
    """
    Let a node refuse all changes of its parameters from the approach to the end of each push.

    Parameters
    ----------
    node : CellNode
        The node, whose ``parameters`` are declared.
    topic : Topic
        Where the phase of the push is told: ``PHASE`` of the contract.

    """
    node.parameters.add_check(RunningPush(node, topic).refusal)


def _plain(value: Any) -> Any:
    """Return arrays of the parameter service as lists of Python numbers."""
    return list(value) if hasattr(value, 'typecode') else value
