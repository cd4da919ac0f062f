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
What an effect declares: its parameters, its term in the chain or in a sensor, and its source.

An effect of the object or of the cell edits the draft of the chain (`shape`), with arithmetic
that also holds for complex numbers: the model takes its derivatives by the complex step, which is
exact, so no derivative is declared. An effect of a sensor edits the prediction (`observe`)
together with its tangents, and fills those of its own parameters.

References
----------
W. Squire and G. Trapp, SIAM Rev. 40, 1998, 110-112, doi:10.1137/S003614459631241X (complex step).

"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, Literal, Protocol

from hapticvision_ros.core.models.chain import neutral, Slot
from hapticvision_ros.core.models.sampling import sample
from hapticvision_ros.core.records import FloatArray
import numpy as np
from numpy.typing import NDArray

LAW: Final = ':'
"""Between the name of an effect and that of another law of it."""


class DrivenTrial(Protocol):
    """What a prediction has to know about a trial; no measured force or height is among it."""

    @property
    def t(self) -> FloatArray:
        """Return the ends of the n steps with a mean force each; shape (n + 1,) [s]."""
        ...

    @property
    def displacement(self) -> FloatArray:
        """Return the cleaned tool displacement beyond the touch at `t`; shape (n + 1,) [m]."""
        ...

    @property
    def height_t(self) -> FloatArray:
        """Return the increasing stamps of the samples of the height; shape (m,) [s]."""
        ...

    @property
    def campaign_time(self) -> float:
        """Return when the trial starts, from the start of the campaign [s]."""
        ...

    @property
    def reference_depth(self) -> float:
        """Return the depth of the deepest push of the campaign, d_ref [m]."""
        ...

    @property
    def depth_before(self) -> float:
        """Return the depth of the deepest push of the campaign before this one [m]."""
        ...

    @property
    def zero_time(self) -> float:
        """Return the mean time of the samples that gave the force zero, on the axis of `t` [s]."""
        ...


@dataclass(frozen=True, slots=True)
class Scale:
    """
    What a campaign looks like at first sight; what the first guesses are made from.

    Parameters
    ----------
    K1, C1, C2 : float
        The three elements as the paper's method or the identity finds them [N/m, N.s/m].
    force : float
        Largest force [N].
    depth : float
        Deepest push [m].
    push_speed : float
        Usual speed of a push [m/s].
    contact_time : float
        Usual duration of the contact in a trial [s].
    sampling_interval : float
        Usual interval between two force samples [s].
    campaign_time : float
        From the start of the first trial to that of the last [s].
    disturbance_amplitude, disturbance_frequency : float
        The strongest line in the spectrum of the force's noise [N, Hz].
    pull : float
        Largest force that holds the tool back on withdrawal, noise included [N].
    opening : float
        How far tool and surface are apart where such a force ends; zero where it is not seen [m].
    held_back : float
        Mean force that holds the tool back until then [N].

    """

    K1: float
    C1: float
    C2: float
    force: float
    depth: float
    push_speed: float
    contact_time: float
    sampling_interval: float
    campaign_time: float = 0.0
    disturbance_amplitude: float = 0.0
    disturbance_frequency: float = 50.0
    pull: float = 0.0
    opening: float = 0.0
    held_back: float = 0.0


@dataclass(frozen=True, slots=True)
class EffectParameter:
    """
    One parameter of a model.

    Parameters
    ----------
    symbol : str
        Its name in results.
    unit : str
        Its SI unit; '-' for none, and '1/h' for a rate of the campaign.
    meaning : str
        What it is, in a few words.
    lower, upper : float
        Its range.
    guess : callable of Scale to float
        A start for the fit, within the range.
    neutral : float
        The value at which it has no effect; infinite for a stiffness in series, and not a number
        where the effect is absent by another parameter of it.
    log : bool
        Whether the fit works with its logarithm. So it does for what has a scale and cannot be
        zero; a strength, which is zero where the effect is absent, stays linear, so that an
        interval can reach zero.
    scan : tuple of float
        Factors on the guess that a search starts from, whatever the strength.
    twin : str
        The base parameter that it may be exchanged with, all of an effect at once, without any
        difference; empty for none.

    """

    symbol: str
    unit: str
    meaning: str
    lower: float
    upper: float
    guess: Callable[[Scale], float]
    neutral: float = 0.0
    log: bool = False
    scan: tuple[float, ...] = (1.0,)
    twin: str = ''


_NEUTRAL: Final = [complex(number) for number in neutral()]


@dataclass(slots=True)
class Draft:
    """
    A chain in the making, whose numbers may be complex.

    Parameters
    ----------
    slots : list of complex, length len(Slot)
        One number for each `Slot`.
    units : list of (complex, complex)
        K_i [N/m] and C_i [N.s/m] of the further Kelvin-Voigt units.

    """

    slots: list[complex] = field(default_factory=_NEUTRAL.copy)
    units: list[tuple[complex, complex]] = field(default_factory=list)

    @classmethod
    def of(cls, K1: complex, C1: complex, C2: complex) -> 'Draft':
        """Return the chain of three elements."""
        draft = cls()
        draft.slots[Slot.K1], draft.slots[Slot.C1], draft.slots[Slot.C2] = K1, C1, C2
        return draft

    @property
    def real_slots(self) -> FloatArray:
        """Return the slots without their imaginary parts, shape (len(Slot),)."""
        return np.array([number.real for number in self.slots])

    def add(self, slot: Slot, value: complex) -> None:
        """Add to a slot."""
        self.slots[slot] += value

    def multiply(self, slot: Slot, factor: complex) -> None:
        """Multiply a slot."""
        self.slots[slot] *= factor


@dataclass(slots=True)
class Prediction:
    """
    What the sensors report of a trial, and how that depends on the parameters.

    Parameters
    ----------
    force : ndarray, shape (n,)
        Mean force over each step [N], without the load cell's zero.
    height : ndarray, shape (m,)
        Displacement height at the stamps of its samples [m].
    d_force : ndarray, shape (p + q, n)
        Derivatives of `force`: in the p parameters of the model, then in the q of the trial.
    d_height : ndarray, shape (p + q, m)
        Derivatives of `height`.
    surface : ndarray, shape (n + 1,)
        The true displacement height at the ends of the steps [m].
    d_surface : ndarray, shape (p + q, n + 1)
        Derivatives of `surface`.
    late : float
        How late all that the tool does is in the recorded time [s].
    late_row : int or None
        Which row is the derivative in that, if one is.
    touched : ndarray of bool, shape (n,), optional
        Whether the tool touches the object in a step.

    Notes
    -----
    Derivatives have no rows where none were asked for.

    """

    force: FloatArray
    height: FloatArray
    d_force: FloatArray
    d_height: FloatArray
    surface: FloatArray
    d_surface: FloatArray
    late: float = 0.0
    late_row: int | None = None
    touched: NDArray[np.bool_] | None = None

    @property
    def in_contact(self) -> FloatArray:
        """Return 1 for each step in which the tool touches the object, else 0; shape (n,)."""
        assert self.touched is not None
        return np.where(self.touched, 1.0, 0.0)

    def look(self, t: FloatArray, at: FloatArray) -> FloatArray:
        """
        Set the height and its derivatives to those of the surface at other times.

        Parameters
        ----------
        t : ndarray, shape (n + 1,)
            Ends of the steps [s].
        at : ndarray, shape (m,)
            Increasing times [s].

        Returns
        -------
        ndarray, shape (m,)
            Speed of the surface then [m/s].

        """
        speed = np.empty(at.size)
        when = at + self.late
        sample(t, self.surface, self.d_surface, when, self.height, self.d_height, speed)
        if self.late_row is not None:
            self.d_height[self.late_row] += speed
        return speed


type Shape = Callable[[Draft, Sequence[complex], DrivenTrial], None]
"""(draft, values, trial): put the effect into the chain."""

type Observe = Callable[[DrivenTrial, Sequence[float], Prediction, Sequence[int]], None]
"""
(trial, values, prediction, rows): put the effect into the prediction and into all its derivatives,
and fill the rows of the effect's own parameters, which come in as zeros. `rows` is empty where no
derivatives were asked for. The values are those of `parameters`, then of `trial_parameters`. The
derivatives in its own are in the values; those in others may be in logarithms: it has to be linear
in them.
"""


@dataclass(frozen=True, slots=True)
class Effect:
    """
    A deviation from the three-element model that trials may carry.

    Parameters
    ----------
    name : str
        Its name in results.
    title : str
        Its name in prose.
    kind : {'object', 'cell', 'sensor'}
        Where it sits.
    sketch : str
        Its place in the chain, or its equation.
    parameters : tuple of EffectParameter
        What it adds to a model; at their neutral values the effect is absent.
    validity : str
        Where it holds.
    signature : str
        What it leaves in the residual of a fit without it.
    source : str
        Where it is described.
    shape : callable, optional
        Its term in the chain.
    observe : callable, optional
        Its term in the sensors.
    trial_parameters : tuple of EffectParameter
        What differs from trial to trial and is of no interest.
    excludes : tuple of str
        Effects with which it has no common meaning.
    time_constant : callable, optional
        For an effect that shows where the force jumps: over which time it draws a jump out, from
        the parameters of the model by name [s].
    period : callable, optional
        For an effect that comes again and again: after which time, from the same [s].
    extra : bool
        Whether it is none of the bag contract's: it is looked for where those do not suffice.
    generalises : tuple of str
        Effects that it becomes where it acts within a sample.
    limits : tuple of str
        Effects that it comes as near to as one likes, so that it leaves no more than they do.
    nuisance : bool
        Whether each trial finds it for itself in any case, so that no campaign can show it.
    laws : tuple of Effect
        Other laws that it is known to follow, made by `following`.
    misdates : bool
        Whether it is stamps of the arm that are late: the data are freed from it, and nothing is
        said to be missing in the model.

    """

    name: str
    title: str
    kind: Literal['object', 'cell', 'sensor']
    sketch: str
    parameters: tuple[EffectParameter, ...]
    validity: str
    signature: str
    source: str
    shape: Shape | None = None
    observe: Observe | None = None
    trial_parameters: tuple[EffectParameter, ...] = ()
    excludes: tuple[str, ...] = ()
    time_constant: Callable[[Mapping[str, float]], float] | None = None
    period: Callable[[Mapping[str, float]], float] | None = None
    extra: bool = False
    generalises: tuple[str, ...] = ()
    limits: tuple[str, ...] = ()
    nuisance: bool = False
    laws: tuple['Effect', ...] = ()
    misdates: bool = False

    @property
    def named(self) -> str:
        """Return the name of the effect, whatever its law."""
        return without_law(self.name)

    def following(
        self,
        law: str,
        *,
        sketch: str,
        validity: str,
        source: str,
        observe: Observe | None = None,
        shape: Shape | None = None,
        kind: Literal['object', 'cell', 'sensor'] | None = None,
        parameters: tuple[EffectParameter, ...] | None = None,
    ) -> 'Effect':
        """
        Return the effect by another law, which is looked for where the usual one does not suffice.

        Parameters
        ----------
        law : str
            Its name, put after that of the effect.
        sketch, validity, source : str
            As in `Effect`.
        observe, shape : callable, optional
            What takes the place of both of the effect.
        kind : {'object', 'cell', 'sensor'}, optional
            Where it sits by this law, if it is not where the effect sits.
        parameters : tuple of EffectParameter, optional
            What takes the place of the parameters of the effect; of the same meaning, with what
            the law adds to them.

        Returns
        -------
        Effect
            The law, an effect of its own to a model.

        """
        return replace(
            self,
            name=f'{self.name}{LAW}{law}',
            kind=kind or self.kind,
            title=f'{self.title} ({law.replace("_", " ")})',
            sketch=sketch,
            validity=validity,
            source=source,
            observe=observe,
            shape=shape,
            parameters=self.parameters if parameters is None else parameters,
            time_constant=None if shape is None else self.time_constant,
            extra=True,
            laws=(),
        )


def without_law(name: str) -> str:
    """Return the name of the effect of which a name may say the law as well."""
    return name.partition(LAW)[0]


def dashpots(values: Mapping[str, float]) -> float:
    """Return the viscosity of C1 and C2 in series, which answers a sudden motion [N.s/m]."""
    return values['C1'] * values['C2'] / (values['C1'] + values['C2'])
