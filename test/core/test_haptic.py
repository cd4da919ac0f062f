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

"""The step function against the forward model on the same path, and what a renderer may ask."""

from dataclasses import dataclass

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.haptic import HapticStepper
import numpy as np
import pytest

DEPTH = 0.01
CAMPAIGN_TIME = 600.0
VALUES = {
    'K1': 5000.0,
    'C1': 20000.0,
    'C2': 60000.0,
    'F_y': 3.0,
    'K_0': 2e4,
    'K_p': 300.0,
    'K_2': 15000.0,
    'C_3': 9000.0,
    'alpha': 0.6,
    'beta': 3e4,
    'n': 0.6,
    'm': 0.5,
    'D': 0.4,
    's': 4.0,
    'rate': 0.2,
    'F_ad': 1.0,
    'delta_c': 1e-3,
    'kappa': 0.7,
    'delta_e': 5e-4,
    'M': 0.2,
    'a': 60.0,
}
KNOT_T = [0.0, 0.2, 1.2, 2.5, 3.0, 3.3, 4.0, 4.5, 5.0, 6.0]
KNOT_D = [-0.001, -0.001, 0.009, 0.0092, 0.002, 0.002, 0.008, -0.005, -0.004, 0.006]
"""A push, a hold, a withdrawal and a second push on the dent, the air, and a third."""
OF_THE_OBJECT = [effect.name for effect in EFFECTS if effect.kind == 'object']
OF_THE_OBJECT += ['damage:lasting', 'damage:saturating', 'damage:lasting_saturating']
OF_THE_OBJECT += ['adhesion:cohesive_zone', 'adhesion:fading_zone']
TOGETHER = [
    ('yield_force', 'series_spring', 'strain_stiffening'),
    ('shear_thinning', 'damage', 'contact_growth', 'parallel_spring'),
    ('springpot', 'inertia', 'parallel_spring'),
    (
        'yield_force',
        'series_spring',
        'second_retardation',
        'inertia',
        'adhesion',
        'exponential_stiffening',
    ),
]


@dataclass(frozen=True)
class Path:
    """A tool's path, as the forward model asks for one."""

    t: np.ndarray
    displacement: np.ndarray
    height_t: np.ndarray
    campaign_time: float = CAMPAIGN_TIME
    reference_depth: float = DEPTH
    depth_before: float = 0.0
    zero_time: float = 0.0


def _path() -> Path:
    t = np.arange(6001) * 1e-3
    return Path(t, np.interp(t, KNOT_T, KNOT_D), t[:1].copy())


def _values(model: Model) -> dict[str, float]:
    return {name: VALUES[name.rpartition('.')[2]] for name in model.names}


@pytest.mark.parametrize(
    'effects', [(), *((name,) for name in OF_THE_OBJECT), *TOGETHER], ids='+'.join
)
def test_a_step_gives_the_force_of_the_forward_model(effects: tuple[str, ...]) -> None:
    path, model = _path(), Model(effects)
    values = _values(model)
    theta = model.theta([values[name] for name in model.names])
    whole = model.predict(path, theta, directions=False)
    body = HapticStepper(model, values, reference_depth=DEPTH, campaign_time=CAMPAIGN_TIME)
    body.reset(float(path.displacement[0]))
    force = np.empty(path.t.size - 1)
    surface = np.empty(path.t.size - 1)
    for i, (d, h) in enumerate(
        zip(path.displacement[1:].tolist(), np.diff(path.t).tolist(), strict=True)
    ):
        force[i] = body.step(d, h)
        surface[i] = body.surface
    # Both iterate to 1e-12; the forward model takes steps within 1e-9 of each other for equal.
    np.testing.assert_allclose(force, whole.force, rtol=0.0, atol=1e-9 * whole.force.max())
    np.testing.assert_allclose(surface, whole.surface[1:], rtol=0.0, atol=1e-9 * DEPTH)
    # The path comes off the surface and back to it, or nothing of that was tested.
    assert np.count_nonzero(np.diff((force > 0.0).astype(int)) == 1) >= 2


def test_effects_of_arm_and_sensors_are_left_out() -> None:
    model = Model(('yield_force', 'machine_compliance', 'force_lag'))
    values = {'K1': 5e3, 'C1': 2e4, 'C2': 6e4, 'F_y': 3.0, 'K_m': 1e4, 'T_f': 0.1}
    whole = HapticStepper(model, values)
    bare = HapticStepper(Model(('yield_force',)), values)
    assert whole.left_out == ('machine_compliance', 'force_lag')
    path = np.linspace(0.0, 0.005, 50).tolist()
    assert [whole.step(d) for d in path] == [bare.step(d) for d in path]


def test_reset_brings_back_the_untouched_body() -> None:
    body = HapticStepper(Model(('damage',)), _values(Model(('damage',))), reference_depth=DEPTH)
    path = [*np.linspace(-0.001, 0.008, 100).tolist(), *np.linspace(0.008, -0.001, 100).tolist()]
    body.reset(-0.001)
    first = [body.step(d) for d in path]
    again = [body.step(d) for d in path]
    assert body.surface > 0.001
    body.reset(-0.001)
    assert (body.surface, body.touching) == (0.0, False)
    assert [body.step(d) for d in path] == first != again


@pytest.mark.parametrize('effects', [(), ('springpot',)])
def test_contact_pushes_and_does_not_pull(effects: tuple[str, ...]) -> None:
    model = Model(effects)
    body = HapticStepper(model, _values(model))
    forces = [body.step(d) for d in (*np.linspace(0.0, 0.005, 200), *np.linspace(0.005, 0.0, 20))]
    assert min(forces) >= 0.0
    assert max(forces) > 0.0
    assert not body.touching
    assert body.surface > 0.0


def test_a_step_is_not_taken_without_its_numbers() -> None:
    with pytest.raises(UsageError, match='C2 is not known'):
        HapticStepper(Model(), {'K1': 1.0, 'C1': 1.0})
    model = Model(('damage',))
    with pytest.raises(UsageError, match='reference_depth'):
        HapticStepper(model, _values(model))
    body = HapticStepper(Model(), _values(Model()))
    for displacement, dt in ((float('nan'), 1e-3), (0.001, 0.0), (0.001, float('inf'))):
        with pytest.raises(UsageError, match='no step'):
            body.step(displacement, dt)
    assert body.step(0.001) > 0.0
