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

"""The arm's clock against those of the sensors."""

from collections.abc import Sequence

from hapticvision_ros.core.effects.declaration import (
    Draft,
    DrivenTrial,
    Effect,
    EffectParameter,
    Prediction,
)
from hapticvision_ros.core.models.chain import Slot
from hapticvision_ros.core.records import FloatArray
import numpy as np


def _means(
    force: FloatArray, length: FloatArray, step: FloatArray, into: FloatArray
) -> FloatArray:
    """Return the means of forces (.., n) between times `into` steps, shape (.., n)."""
    impulse = np.zeros((*force.shape[:-1], length.size + 1))
    np.cumsum(force * length, axis=-1, out=impulse[..., 1:])
    reached = impulse[..., step] + force[..., np.minimum(step, length.size - 1)] * into
    return np.asarray(np.diff(reached, axis=-1) / length)


def _shape(draft: Draft, values: Sequence[complex], trial: DrivenTrial) -> None:
    # The touch, which each trial finds for itself, stays when it is: a search that has to move
    # all of them along does not find its way.
    below = trial.displacement > 0.0
    touch = int(np.argmax(below[1:] & ~below[:-1]))
    way = trial.displacement[touch + 1] - trial.displacement[touch]
    draft.add(Slot.OFFSET, -values[0] * float(way / (trial.t[touch + 1] - trial.t[touch])))


def _observe(
    trial: DrivenTrial, values: Sequence[float], prediction: Prediction, rows: Sequence[int]
) -> None:
    late = values[0]
    length = np.diff(trial.t)
    at = trial.t + late
    # After the last step the force goes on as in it.
    step = np.minimum(np.searchsorted(trial.t, at, side='right') - 1, length.size - 1)
    into = at - trial.t[step]
    if rows:
        slope = np.diff(prediction.force[step]) / length
        prediction.d_force[:] = _means(prediction.d_force, length, step, into)
        prediction.d_force[rows[0]] += slope
    prediction.force[:] = _means(prediction.force, length, step, into)
    prediction.late = late
    prediction.late_row = rows[0] if rows else None
    prediction.look(trial.t, trial.height_t)


EFFECT = Effect(
    name='arm_clock_offset',
    title='Arm clock offset',
    kind='sensor',
    sketch="""
    x_measured(t) = x(t - dt),  x the way of the tool
    """,
    parameters=(
        EffectParameter(
            'dt',
            's',
            "how much later the stamps of the tool's height are than those of force and height",
            0.0,
            1.0,
            # A change of speed is short: beyond it a search does not find its way.
            lambda scale: min(scale.sampling_interval, 0.3),
            scan=(1.0, 3.0),
        ),
    ),
    validity=(
        'The same offset in every trial: of an arm that tells its place by a slower way than the '
        'load cell its force. A force that is late is a force_lag to a good approximation.'
    ),
    signature='The force answers to each change of speed before it happens.',
    source=(
        'P. Furgale, J. Rehder and R. Siegwart, IEEE/RSJ IROS 2013, 1280-1286, '
        'doi:10.1109/IROS.2013.6696514 (offset of clocks as a parameter of the fit).'
    ),
    shape=_shape,
    observe=_observe,
    misdates=True,
)
