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
What the force says under each tip of the tool.

The contact of a sphere grows with the depth, and its force with it. A body whose contact does that
by itself has to be given links that were identified beside it: a chain that was fitted without it
has made good for it as well as it could, and a body of such links does so a second time.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final, TYPE_CHECKING

from hapticvision_ros.cli.fit import Progress
from hapticvision_ros.core.errors import InputError, UsageError

if TYPE_CHECKING:
    from hapticvision_ros.core.composition import Model

GROWTH: Final = 'contact_growth'


@dataclass(frozen=True, slots=True)
class Identified:
    """
    A model with its parameters.

    Parameters
    ----------
    model : Model
        What was fitted.
    parameters : mapping of str to float
        Its parameters, SI.
    reference_depth : float or None
        Depth of the deepest push that it was fitted to [m].
    anew : bool
        Whether it was fitted here, as the tip is another than the declared one.
    warnings : tuple of str
        What to know of that fit, one sentence each.

    """

    model: 'Model'
    parameters: Mapping[str, float]
    reference_depth: float | None
    anew: bool = False
    warnings: tuple[str, ...] = ()


class ByTip:
    """
    The model for each tip: the declared one, and for the other tip one that is fitted anew.

    Parameters
    ----------
    bags : sequence of Path
        What is fitted.
    declared : Identified
        What holds for the declared tip.
    sphere : bool
        The declared tip.

    """

    def __init__(self, bags: Sequence[Path], declared: Identified, *, sphere: bool) -> None:
        self._bags = tuple(bags)
        self._declared = declared
        self._known: dict[bool, Identified | InputError] = {sphere: declared}

    def __call__(self, sphere: bool) -> Identified:
        """
        Return what holds for a tip.

        Raises
        ------
        InputError
            If the bags do not tell the parameters of its model.

        """
        found = self._known.get(sphere)
        if found is None:
            try:
                found = self._other(sphere)
            except (InputError, UsageError) as error:
                found = InputError(str(error))
            self._known[sphere] = found
        if isinstance(found, InputError):
            raise found
        return found

    @property
    def anew(self) -> Identified | None:
        """Return what was fitted for the tip that was not declared, where it was."""
        fitted = (one for one in self._known.values() if isinstance(one, Identified) and one.anew)
        return next(fitted, None)

    def _other(self, sphere: bool) -> Identified:
        from hapticvision_ros.core.composition import Model

        effects = tuple(name for name in self._declared.model.effects if name != GROWTH)
        model = Model((*effects, GROWTH) if sphere else effects)
        if model == self._declared.model:
            return self._declared
        from hapticvision_ros.api import Campaign
        from hapticvision_ros.core.export import known_values
        from hapticvision_ros.core.fit.campaign import fit

        with Progress() as tell:
            tell(f'fitting {model.name}')
            found = fit(Campaign.read(*self._bags), model)
        depth = found.problem.trials[0].reference_depth
        return Identified(
            model,
            known_values(model, found.parameters),
            depth,
            anew=True,
            warnings=tuple(found.warnings),
        )
