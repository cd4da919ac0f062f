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
The effects that a model can be composed of: one effect, one file.

An effect is added by its file and by its line in `EFFECTS`. The order of the tuple is that in
which the effects act: object, cell, then from the load cell's mechanics to its output.
"""

from typing import Final

from hapticvision_ros.core.effects import (
    adhesion,
    ageing,
    arm_clock_offset,
    clock_offset,
    contact_growth,
    contact_offset,
    damage,
    exponential_stiffening,
    force_drift,
    force_lag,
    friction,
    height_bias,
    inertia,
    machine_compliance,
    parallel_spring,
    periodic_disturbance,
    second_retardation,
    series_spring,
    shear_thinning,
    springpot,
    strain_stiffening,
    yield_force,
)
from hapticvision_ros.core.effects.declaration import Effect

EFFECTS: Final[tuple[Effect, ...]] = (
    yield_force.EFFECT,
    series_spring.EFFECT,
    parallel_spring.EFFECT,
    second_retardation.EFFECT,
    springpot.EFFECT,
    strain_stiffening.EFFECT,
    shear_thinning.EFFECT,
    contact_growth.EFFECT,
    exponential_stiffening.EFFECT,
    damage.EFFECT,
    ageing.EFFECT,
    adhesion.EFFECT,
    inertia.EFFECT,
    machine_compliance.EFFECT,
    contact_offset.EFFECT,
    friction.EFFECT,
    arm_clock_offset.EFFECT,
    force_drift.EFFECT,
    force_lag.EFFECT,
    clock_offset.EFFECT,
    height_bias.EFFECT,
    periodic_disturbance.EFFECT,
)
"""All effects: those of the contract in its order, and what measured data ask for beside them."""

EVERY_LAW: Final = tuple(each for effect in EFFECTS for each in (effect, *effect.laws))
"""The effects, each followed by the other laws that it may follow."""

BY_NAME: Final = {effect.name: effect for effect in EVERY_LAW}
"""All of these by their names in a model."""
