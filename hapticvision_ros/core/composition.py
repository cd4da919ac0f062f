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
Models: the three-element chain with any set of effects, and what it predicts for a trial.

A model has p parameters, which all trials of a campaign share: K1, C1 and C2, then those of its
effects in the order of the registry. A trial adds q parameters of its own, which nobody asks for:
the onset, which is how much deeper the tool is than the detected contact says, then those that an
effect declares. The fit works with the vector theta, in which parameters that have a scale
(`EffectParameter.log`) stand with their logarithm.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import islice
import math
from typing import Any, cast, Final, NamedTuple

from hapticvision_ros.core.effects import BY_NAME, EVERY_LAW
from hapticvision_ros.core.effects.declaration import (
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
    Observe,
    Prediction,
    Scale,
    without_law,
)
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.models.chain import Chain, neutral, respond, Slot
from hapticvision_ros.core.models.turns import Turns
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

BASE: Final = 'three-element'
"""Name of the model without effects."""

BASE_PARAMETERS: Final = (
    EffectParameter(
        'K1', 'N/m', 'elastic coefficient', 1e-3, 1e9, lambda s: s.K1, neutral=math.nan, log=True
    ),
    EffectParameter(
        'C1',
        'N.s/m',
        'viscosity of the bouncing part',
        1e-6,
        1e12,
        lambda s: s.C1,
        neutral=math.nan,
        log=True,
    ),
    EffectParameter(
        'C2',
        'N.s/m',
        'viscosity of the residual part',
        1e-6,
        1e12,
        lambda s: s.C2,
        neutral=math.nan,
        log=True,
    ),
)

ONSET: Final = EffectParameter(
    'onset',
    'm',
    'how much deeper the tool is in this trial than the detected contact says',
    -math.inf,
    math.inf,
    lambda scale: 0.0,
)

_COMPLEX_STEP = 1e-30


@dataclass(frozen=True)
class Model:
    """
    The three-element chain with a set of effects.

    Parameters
    ----------
    effects : tuple of str
        Names of effects; kept in the order of the registry.

    Raises
    ------
    UsageError
        If there is no such effect, one is named twice, or two have no common meaning.

    """

    effects: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in self.effects:
            if name not in BY_NAME:
                raise UsageError(f'there is no effect {name!r}: choose among {", ".join(BY_NAME)}')
            named = without_law(name)
            if [without_law(each) for each in self.effects].count(named) > 1:
                raise UsageError(f'the effect {named!r} is named twice: name it once')
            for other in BY_NAME[name].excludes:
                if other in self.effects:
                    raise UsageError(
                        f'{name!r} and {other!r} both take the place of the dashpot C2: '
                        f'choose one of them'
                    )
        ordered = tuple(effect.name for effect in EVERY_LAW if effect.name in self.effects)
        object.__setattr__(self, 'effects', ordered)

    def __reduce__(self) -> 'tuple[type[Model], tuple[tuple[str, ...]]]':
        """Return how it is made anew: declarations hold functions, which are not sent."""
        return Model, (self.effects,)

    @classmethod
    def parse(cls, name: str) -> 'Model':
        """
        Return the model of a name such as `three-element+yield_force`.

        Raises
        ------
        UsageError
            If there is no such model.

        """
        base, *effects = name.split('+')
        if base != BASE:
            raise UsageError(f'there is no model {name!r}: write {BASE} or {BASE}+EFFECT+EFFECT')
        return cls(tuple(effects))

    @property
    def name(self) -> str:
        """Return its name in results."""
        return '+'.join((BASE, *self.effects))

    @cached_property
    def declared(self) -> tuple[Effect, ...]:
        """Return the declarations of its effects."""
        return tuple(BY_NAME[name] for name in self.effects)

    @cached_property
    def parameters(self) -> tuple[EffectParameter, ...]:
        """Return the declarations of its p parameters."""
        return BASE_PARAMETERS + tuple(p for effect in self.declared for p in effect.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Return the p names: symbols, told apart as `effect.symbol` where two are alike."""
        owned = [(BASE, p.symbol) for p in BASE_PARAMETERS]
        owned += [(e.named, p.symbol) for e in self.declared for p in e.parameters]
        symbols = [symbol for _, symbol in owned]
        return tuple(
            symbol if symbols.count(symbol) == 1 else f'{owner}.{symbol}'
            for owner, symbol in owned
        )

    @cached_property
    def units(self) -> tuple[str, ...]:
        """Return the p SI units."""
        return tuple(p.unit for p in self.parameters)

    @cached_property
    def log(self) -> tuple[bool, ...]:
        """Return which of the p entries of theta are logarithms."""
        return tuple(p.log for p in self.parameters)

    @cached_property
    def bounds(self) -> tuple[FloatArray, FloatArray]:
        """Return the least and the greatest theta; shapes (p,)."""
        return (
            self.theta([p.lower for p in self.parameters]),
            self.theta([p.upper for p in self.parameters]),
        )

    @cached_property
    def trial_parameters(self) -> tuple[EffectParameter, ...]:
        """Return the declarations of the q parameters of a trial: the onset, then the effects'."""
        return (ONSET, *(p for effect in self.declared for p in effect.trial_parameters))

    @cached_property
    def trial_names(self) -> tuple[str, ...]:
        """Return the q names of a trial's own parameters."""
        return tuple(p.symbol for p in self.trial_parameters)

    def first_guess(self, scale: Scale) -> FloatArray:
        """Return a start for the fit, theta of shape (p,), within the bounds."""
        start = [p.guess(scale) for p in self.parameters]
        return np.clip(self.theta(start), *self.bounds)

    def theta(self, values: Sequence[float] | FloatArray) -> FloatArray:
        """Return the vector of the fit for parameters in SI units; shape (p,)."""
        given = np.array(values, dtype=np.float64)
        logarithms = np.full(given.size, -np.inf)
        np.log(given, out=logarithms, where=self._logarithms & (given > 0.0))
        return np.where(self._logarithms, logarithms, given)

    def values(self, theta: FloatArray) -> FloatArray:
        """Return the parameters in SI units; shape (p,)."""
        values = theta.copy()
        # A search may go where nothing is finite: it turns back from there.
        with np.errstate(over='ignore'):
            np.exp(theta, out=values, where=self._logarithms)
        return values

    @cached_property
    def _logarithms(self) -> NDArray[np.bool_]:
        return np.array(self.log)

    def predict(
        self,
        trial: DrivenTrial,
        theta: FloatArray,
        trial_values: Sequence[float] | FloatArray | None = None,
        *,
        directions: bool = True,
        turns: Turns | None = None,
    ) -> Prediction:
        """
        Return what the sensors report of a trial.

        Parameters
        ----------
        trial : DrivenTrial
            What the tool did, and when the sensors look.
        theta : ndarray, shape (p,)
            The parameters, as the fit sees them.
        trial_values : sequence of float, length q, optional
            The trial's own parameters; zeros by default.
        directions : bool, default True
            Whether to give the derivatives, in theta and in the trial's own parameters.
        turns : Turns, optional
            The steps of the trial, split where the tool changes its speed within them.

        Returns
        -------
        Prediction
            Force, height and their derivatives.

        """
        if turns is not None:
            split = _Split.of(trial, turns)
            prediction = self.predict(split, theta, trial_values, directions=directions)
            _put_together(prediction, turns)
            return prediction
        p, q = len(self.parameters), len(self.trial_parameters)
        values = np.zeros(p + q)
        values[:p] = self.values(theta)
        if trial_values is not None:
            values[p:] = trial_values
        rows = self._rows_of_the_chain if directions else ()
        response = respond(trial.t, trial.displacement, *self._chains(trial, values, rows))
        d_force, d_surface = response.force_tangent, response.surface_tangent
        if directions and len(rows) < p + q:
            d_force = np.zeros((p + q, response.force.size))
            d_surface = np.zeros((p + q, response.surface.size))
            d_force[list(rows)] = response.force_tangent
            d_surface[list(rows)] = response.surface_tangent
        prediction = Prediction(
            force=response.force,
            height=np.empty(trial.height_t.size),
            d_force=d_force,
            d_height=np.empty((d_surface.shape[0], trial.height_t.size)),
            surface=response.surface,
            d_surface=d_surface,
            touched=response.force != 0.0,
        )
        prediction.look(trial.t, trial.height_t)
        # A search may go where nothing is finite: it turns back from there.
        with np.errstate(over='ignore', invalid='ignore'):
            for observe, own in self._observed:
                theirs = [float(values[i]) for i in own]
                observe(trial, theirs, prediction, own if directions else ())
            for row in self._scaled_last if directions else ():
                scale = _slope_of_exp(values[row])
                prediction.d_force[row] *= scale
                prediction.d_height[row] *= scale
                prediction.d_surface[row] *= scale
        return prediction

    @cached_property
    def _owned(self) -> tuple[tuple[int, ...], ...]:
        """Return, for each effect, where its parameters and its trial parameters stand."""
        shared = iter(range(len(BASE_PARAMETERS), len(self.parameters)))
        own = iter(range(len(self.parameters) + 1, len(self.parameters) + len(self.trial_names)))
        return tuple(
            (*islice(shared, len(e.parameters)), *islice(own, len(e.trial_parameters)))
            for e in self.declared
        )

    @cached_property
    def _observed(self) -> tuple[tuple[Observe, tuple[int, ...]], ...]:
        """Return what its effects do to the sensors, with `_owned`."""
        return tuple(
            (effect.observe, own)
            for effect, own in zip(self.declared, self._owned, strict=True)
            if effect.observe is not None
        )

    @cached_property
    def _rows_of_the_chain(self) -> tuple[int, ...]:
        """Return the parameters that the chain depends on, among all p + q."""
        rows = [*range(len(BASE_PARAMETERS))]
        for effect, own in zip(self.declared, self._owned, strict=True):
            if effect.shape is not None:
                rows += own
        return (*rows, len(self.parameters))

    @cached_property
    def _scaled_last(self) -> tuple[int, ...]:
        """
        Return the parameters with logarithms whose derivatives are not scaled in the chain.

        They are those to which a sensor adds; on the others it acts linearly, scaled or not.
        """
        added = {row for _, own in self._observed for row in own}
        return tuple(row for row, log in enumerate(self.log) if log and row in added)

    def _scales(self, values: FloatArray, rows: Sequence[int]) -> FloatArray:
        """Return what the chain's derivatives in some parameters are multiplied by."""
        p, last = len(self.parameters), self._scaled_last
        return np.array(
            [
                _slope_of_exp(values[row])
                if row < p and self.log[row] and row not in last
                else 1.0
                for row in rows
            ]
        )

    def _draft(self, trial: DrivenTrial, values: Sequence[complex]) -> Draft:
        """Return the chain for all p + q values."""
        draft = Draft.of(*values[: len(BASE_PARAMETERS)])
        draft.slots[Slot.REFERENCE_DEPTH] = trial.reference_depth
        draft.slots[Slot.OFFSET] = values[len(self.parameters)]
        for effect, own in zip(self.declared, self._owned, strict=True):
            if effect.shape is not None:
                effect.shape(draft, [values[i] for i in own], trial)
        return draft

    def _chains(
        self, trial: DrivenTrial, values: FloatArray, rows: Sequence[int]
    ) -> tuple[Chain, Chain | None]:
        """
        Return the chain, and how its numbers change with the parameters of some rows, if any.

        That is with their logarithms where they have some, but for those of `_scaled_last`.
        """
        onset = len(self.parameters)
        if all(effect.shape is None for effect in self.declared):
            slots = neutral()
            slots[[Slot.K1, Slot.C1, Slot.C2]] = values[: len(BASE_PARAMETERS)]
            slots[Slot.REFERENCE_DEPTH], slots[Slot.OFFSET] = trial.reference_depth, values[onset]
            return Chain(slots, _NO_UNITS, _NO_UNITS), self._plain(values) if rows else None
        # Trials that are alike to all effects have the same chain but for their onsets.
        asked = values[self._shaping].tobytes(), trial.reference_depth
        known: _Drafted | None = self.__dict__.get('_drafted')
        if known is None or known.asked != asked or (rows and known.directions is None):
            watched = _Watched(trial)
            known = _Drafted(asked, *self._drafted_for(cast('DrivenTrial', watched), values, rows))
            if not watched.looked_at:
                self.__dict__['_drafted'] = known
        slots = known.chain.slots.copy()
        slots[Slot.OFFSET] += values[onset]
        chain = Chain(slots, known.chain.unit_stiffness, known.chain.unit_viscosity)
        return chain, known.directions if rows else None

    @staticmethod
    def _plain(values: FloatArray) -> Chain:
        """Return what the logarithms of K1, C1 and C2, and the onset, are of a chain."""
        slots = _PLAIN.copy()
        for row in range(len(BASE_PARAMETERS)):
            slots[row] *= _slope_of_exp(values[row])
        return Chain(slots, _NO_DIRECTIONS, _NO_DIRECTIONS)

    @cached_property
    def _shaping(self) -> list[int]:
        """Return the parameters that the chain depends on, but for the onset."""
        return list(self._rows_of_the_chain[:-1])

    def _drafted_for(
        self, trial: DrivenTrial, values: FloatArray, rows: Sequence[int]
    ) -> tuple[Chain, Chain | None]:
        """Return what `_chains` does, for an onset of zero."""
        onset = len(self.parameters)
        given = [complex(value) for value in values.tolist()]
        given[onset] = 0j
        draft = self._draft(trial, given)
        # A unit that is infinitely stiff is none.
        kept = [i for i, (stiffness, _) in enumerate(draft.units) if math.isfinite(stiffness.real)]
        units = np.array([draft.units[i] for i in kept]).real.reshape(-1, 2).T.copy()
        chain = Chain(draft.real_slots, *units)
        if not rows:
            return chain, None
        d_slots = np.zeros((len(rows), len(Slot)))
        d_units = np.zeros((2, len(rows), len(kept)))
        steps = np.ones((len(rows), 1))
        for j, row in enumerate(rows):
            value = given[row]
            if row == onset:
                # The onset is added to, and nothing is made of it.
                d_slots[j, Slot.OFFSET] = 1.0
            elif math.isfinite(value.real):
                step = _COMPLEX_STEP * (abs(value) or 1.0)
                given[row] = complex(value.real, step)
                draft = self._draft(trial, given)
                d_slots[j] = [number.imag for number in draft.slots]
                for k, i in enumerate(kept):
                    d_units[:, j, k] = [number.imag for number in draft.units[i]]
                steps[j] = step
                given[row] = value
        factors = self._scales(values, rows)[:, np.newaxis] / steps
        return chain, Chain(d_slots * factors, *(d_units * factors))


class _Watched:
    """A trial that tells whether an effect has looked at more of it than all trials share."""

    __slots__ = ('_trial', 'looked_at')

    def __init__(self, trial: DrivenTrial) -> None:
        self._trial = trial
        self.looked_at = False

    @property
    def reference_depth(self) -> float:
        """Return that of the trial."""
        return self._trial.reference_depth

    def __getattr__(self, name: str) -> Any:
        self.looked_at = True
        return getattr(self._trial, name)


class _Drafted(NamedTuple):
    """A chain, its derivatives, and what it was asked for with."""

    asked: tuple[bytes, float]
    chain: Chain
    directions: Chain | None


_PLAIN: Final = np.eye(len(Slot))[[Slot.K1, Slot.C1, Slot.C2, Slot.OFFSET]]
"""What K1, C1, C2 and the onset are of a chain without effects."""
_NO_UNITS: Final = np.zeros(0)
_NO_DIRECTIONS: Final = np.zeros((len(_PLAIN), 0))


def _slope_of_exp(value: float) -> float:
    """Return the derivative of a parameter in its logarithm, of which an infinite one has none."""
    return float(value) if math.isfinite(value) else 0.0


class _Split(NamedTuple):
    """A trial in split steps: see `DrivenTrial`."""

    t: FloatArray
    displacement: FloatArray
    height_t: FloatArray
    campaign_time: float
    reference_depth: float
    depth_before: float
    zero_time: float

    @classmethod
    def of(cls, trial: DrivenTrial, turns: Turns) -> '_Split':
        """Return a trial in the split steps."""
        return cls(
            turns.t,
            turns.displacement,
            trial.height_t,
            campaign_time=trial.campaign_time,
            reference_depth=trial.reference_depth,
            depth_before=trial.depth_before,
            zero_time=trial.zero_time,
        )


def _put_together(split: Prediction, turns: Turns) -> None:
    """Make a prediction in split steps one in steps."""
    split.force, split.d_force, split.surface, split.d_surface = turns.joined(
        (split.force, split.d_force), (split.surface, split.d_surface)
    )
