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

"""Exports: the same numbers come back out of each format, in units of the material."""

import re
import xml.etree.ElementTree as ElementTree

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.effects import EVERY_LAW
from hapticvision_ros.core.errors import UsageError
from hapticvision_ros.core.export import (
    abaqus,
    ansys,
    csv,
    document,
    export,
    links,
    material_quantities,
    mujoco,
    Specimen,
)
from hapticvision_ros.core.records import Estimate
from hapticvision_ros.core.relaxation import prony_series, PronySeries, relaxation_function
import numpy as np
import pytest

DOUGH = {
    'K1': Estimate(2000.0, 20.0),
    'C1': Estimate(1600.0, 8.0),
    'C2': Estimate(2400.0, None),
}
BURGERS = DOUGH | {'K_0': Estimate(8000.0), 'K_p': Estimate(50.0)}
BURGERS_MODEL = Model(('series_spring', 'parallel_spring'))
BLOCK = Specimen(area=0.002, height=0.040)
T = np.geomspace(1e-3, 1e2, 40)


def _values(parameters: dict[str, Estimate]) -> dict[str, float]:
    return {name: estimate.value for name, estimate in parameters.items() if estimate.known}


def _series(model: Model, parameters: dict[str, Estimate], specimen: Specimen) -> PronySeries:
    relaxation = relaxation_function(model, _values(parameters))
    return prony_series(relaxation, scale=specimen.modulus)


def _relaxation_of(modulus: float, pairs: list[tuple[float, float]]) -> np.ndarray:
    """Return E(t) as the manuals define it: E0 (1 - sum g_i (1 - exp(-t / tau_i)))."""
    return modulus * (1.0 - sum(g * (1.0 - np.exp(-T / tau)) for g, tau in pairs))


def test_a_modulus_is_the_stiffness_times_height_over_area_and_so_is_its_error() -> None:
    model = Model(('yield_force', 'strain_stiffening'))
    parameters = DOUGH | {'F_y': Estimate(6.0, 0.1), 'beta': Estimate(1e4, 1e3)}
    found = material_quantities(model, parameters, BLOCK)
    assert found['K1'].symbol == 'E1'
    assert found['K1'].unit == 'Pa'
    assert found['K1'].estimate == Estimate(pytest.approx(40e3), pytest.approx(400.0))
    assert found['C1'].symbol == 'eta1'
    assert found['C1'].estimate == Estimate(pytest.approx(32e3), pytest.approx(160.0))
    assert found['C2'].estimate == Estimate(pytest.approx(48e3), None)
    assert found['F_y'].symbol == 'sigma_y'
    assert found['F_y'].estimate == Estimate(pytest.approx(3e3), pytest.approx(50.0))
    # z / h in place of z: beta z^2 = (beta h^2) (z / h)^2.
    assert found['beta'].estimate == Estimate(pytest.approx(16.0), pytest.approx(1.6))


def test_the_moduli_are_those_of_the_material_whatever_the_specimen() -> None:
    # Two blocks of one material: K and C go with A / h, and moduli do not.
    large = Specimen(area=0.008, height=0.020)
    ratio = BLOCK.modulus / large.modulus
    scaled = {name: Estimate(ratio * estimate.value) for name, estimate in DOUGH.items()}
    of_small = material_quantities(Model(), DOUGH, BLOCK)
    of_large = material_quantities(Model(), scaled, large)
    for name in DOUGH:
        assert of_large[name].estimate.value == pytest.approx(of_small[name].estimate.value)


def test_each_parameter_of_each_effect_has_a_form_or_a_reason() -> None:
    without = set()
    for effect in EVERY_LAW:
        model = Model((effect.name,))
        parameters = {name: Estimate(1.0, 0.1) for name in model.names}
        for name in model.names[3:]:
            quantity = material_quantities(model, parameters, BLOCK)[name]
            if quantity.estimate.known:
                assert quantity.symbol and quantity.unit
            else:
                assert quantity.estimate.reason
                assert quantity.symbol is None
                assert 'has no form' not in quantity.estimate.reason
                without.add((effect.named, name))
    none = {(e.named, p.symbol) for e in EVERY_LAW if e.kind != 'object' for p in e.parameters}
    none |= {('inertia', 'M'), ('damage', 'kappa')}
    none |= {('adhesion', name) for name in ('F_ad', 'delta_c', 'delta_e')}
    assert without == none


def test_an_unknown_parameter_stays_unknown_with_its_reason() -> None:
    parameters = DOUGH | {'C2': Estimate.unknown('the body does not flow')}
    quantity = material_quantities(Model(), parameters, BLOCK)['C2']
    assert quantity.estimate == Estimate.unknown('the body does not flow')
    whole = document(Model(), parameters, BLOCK)
    assert whole['relaxation'] is None
    assert 'the body does not flow' in whole['reasons']['relaxation']


@pytest.mark.parametrize(('area', 'height'), [(0.0, 1.0), (1.0, -1.0), (np.nan, 1.0)])
def test_a_specimen_has_a_size(area: float, height: float) -> None:
    with pytest.raises(UsageError, match='above zero'):
        Specimen(area, height)


def test_abaqus_lines_give_the_relaxation_of_the_chain_back() -> None:
    series = _series(BURGERS_MODEL, BURGERS, BLOCK)
    lines = abaqus(series, 0.45, ('a remark',)).splitlines()
    assert lines[0] == '** a remark'
    lines = [line for line in lines if not line.startswith('**')]
    assert lines[1] == '*ELASTIC, MODULI=INSTANTANEOUS'
    modulus, poisson = map(float, lines[2].split(','))
    assert lines[3] == '*VISCOELASTIC, TIME=PRONY'
    terms = [tuple(map(float, line.split(','))) for line in lines[4:]]
    assert poisson == 0.45
    assert all(g == k for g, k, _ in terms)
    relaxation = relaxation_function(BURGERS_MODEL, _values(BURGERS))
    expected = BLOCK.modulus * relaxation(T)
    # Ten digits are printed; what is left in the long run is 1 less their sum.
    found = _relaxation_of(modulus, [(g, tau) for g, _, tau in terms])
    assert found == pytest.approx(expected, rel=1e-6)


def test_ansys_pairs_are_those_of_abaqus_in_commands_of_six_numbers() -> None:
    model = Model(('springpot',))
    parameters = DOUGH | {'alpha': Estimate(0.5)}
    series = _series(model, parameters, BLOCK)
    pairs: dict[str, list[float]] = {}
    for line in ansys(series, 0.45).splitlines():
        command, *fields = line.split(',')
        if command == 'TB':
            part = fields[-1]
            assert fields[:4] == ['PRONY', '1', '1', str(series.ratio.size)]
            pairs[part] = []
        elif command == 'TBDATA':
            assert int(fields[0]) == len(pairs[part]) + 1
            assert len(fields) <= 7
            pairs[part] += map(float, fields[1:])
        elif line.startswith('MP,EX'):
            modulus = float(fields[-1])
    assert pairs['SHEAR'] == pairs['BULK']
    terms = list(zip(pairs['SHEAR'][::2], pairs['SHEAR'][1::2], strict=True))
    expected = BLOCK.modulus * relaxation_function(model, _values(parameters))(T)
    # The slowest of its branches are 1e-6 of the modulus at once: of their ten decimals few count.
    assert _relaxation_of(modulus, terms) == pytest.approx(expected, rel=1e-3)


def test_printed_ratios_never_add_up_to_more_than_one() -> None:
    # A code refuses a material that is pushed back by its own long-term modulus.
    for K_0 in np.geomspace(2.1e3, 9.7e6, 50):
        parameters = DOUGH | {'K_0': Estimate(float(K_0))}
        text = abaqus(_series(Model(('series_spring',)), parameters, BLOCK), 0.3)
        assert 'the body flows' in text
        terms = text.partition('TIME=PRONY\n')[2].splitlines()
        assert sum(float(line.split(',')[0]) for line in terms) <= 1.0


@pytest.mark.parametrize('poisson', [0.5, -1.0, np.nan])
def test_a_poisson_ratio_without_a_bulk_modulus_is_refused(poisson: float) -> None:
    series = _series(BURGERS_MODEL, BURGERS, BLOCK)
    for write in (abaqus, ansys):
        with pytest.raises(UsageError, match="Poisson's ratio"):
            write(series, poisson)


def test_the_table_adds_up_to_the_relaxation_function() -> None:
    model = Model(('parallel_spring',))
    parameters = DOUGH | {'K_p': Estimate(50.0)}
    rows = [
        line.split(',')
        for line in csv(relaxation_function(model, _values(parameters))).splitlines()[1:]
    ]
    # The errors of the parameters alone do not tell those of the terms.
    assert all(row[3:] == ['', '', ''] for row in rows)
    rows = [row[:3] for row in rows]
    assert rows[0] == ['50.0', '', '']
    assert rows[1][0] == rows[1][2] == ''
    assert float(rows[1][1]) == pytest.approx(960.0)
    stiffness, viscosity, time = map(float, rows[2])
    assert viscosity == pytest.approx(stiffness * time)
    assert (stiffness, time) == pytest.approx((720.0, 2.0))


TOLD = DOUGH | {'C2': Estimate(2400.0, 36.0)}
TOGETHER = np.array([[1.0, 0.3, -0.2], [0.3, 1.0, -0.8], [-0.2, -0.8, 1.0]])


def test_errors_of_the_terms_follow_from_the_closed_form_and_the_correlation() -> None:
    K1, C1, C2 = (TOLD[name].value for name in ('K1', 'C1', 'C2'))
    std = np.array([20.0, 8.0, 36.0])
    covariance = TOGETHER * np.outer(std, std)
    total = C1 + C2
    # K = K1 C2^2 / (C1 + C2)^2, T = (C1 + C2) / K1, eta = C1 C2 / (C1 + C2), differentiated.
    slopes = {
        'stiffness': (C2**2 / total**2, -2 * K1 * C2**2 / total**3, 2 * K1 * C1 * C2 / total**3),
        'time': (-total / K1**2, 1.0 / K1, 1.0 / K1),
        'impulse': (0.0, C2**2 / total**2, C1**2 / total**2),
    }
    expected = {name: np.sqrt(slope @ covariance @ slope) for name, slope in slopes.items()}
    found = document(Model(), TOLD, correlation=TOGETHER)
    assert 'relaxation_std' not in found['reasons']
    (term,) = found['relaxation']['terms']
    assert term['stiffness_std_N_m'] == pytest.approx(expected['stiffness'], rel=1e-6)
    assert term['relaxation_time_std_s'] == pytest.approx(expected['time'], rel=1e-6)
    assert found['relaxation']['impulse_std_Ns_m'] == pytest.approx(expected['impulse'], rel=1e-6)
    assert found['relaxation']['long_term_std_N_m'] == 0.0
    # C1 and C2 err against each other, so that their sum is known better than either alone.
    (alone,) = document(Model(), TOLD, correlation=np.eye(3))['relaxation']['terms']
    assert term['relaxation_time_std_s'] < 0.99 * alone['relaxation_time_std_s']


def test_errors_of_a_spectrum_are_those_of_drawn_parameters() -> None:
    parameters = TOLD | {'K_0': Estimate(8000.0, 80.0), 'K_p': Estimate(50.0, 1.0)}
    together = np.eye(5)
    together[:3, :3] = TOGETHER
    together[0, 3] = together[3, 0] = -0.5
    found = document(BURGERS_MODEL, parameters, correlation=together)['relaxation']
    values = np.array([parameters[name].value for name in BURGERS_MODEL.names])
    std = np.array([parameters[name].std for name in BURGERS_MODEL.names])
    drawn = np.random.default_rng(0).multivariate_normal(
        values, together * np.outer(std, std), size=2000
    )
    terms = []
    for one in drawn:
        given = dict(zip(BURGERS_MODEL.names, one.tolist(), strict=True))
        relaxation = relaxation_function(BURGERS_MODEL, given)
        terms.append((*relaxation.stiffness, *relaxation.relaxation_time, relaxation.long_term))
    told = [term['stiffness_std_N_m'] for term in found['terms']]
    told += [term['relaxation_time_std_s'] for term in found['terms']]
    # The spread of 2000 draws is known to 1.6 %.
    assert [*told, found['long_term_std_N_m']] == pytest.approx(np.std(terms, axis=0), rel=0.06)


def test_finite_element_files_tell_the_errors_of_what_they_hold() -> None:
    text = export(
        'abaqus',
        Model(),
        TOLD,
        specimen=BLOCK,
        poisson=0.45,
        shortest_time=0.01,
        correlation=TOGETHER,
    )
    remarks = [line for line in text.splitlines() if line.startswith('** ')]
    # The dashpot C1 C2 / (C1 + C2) = 960 N.s/m in 0.01 s is nearly all of the modulus.
    (modulus,) = [line for line in remarks if 'instantaneous modulus' in line]
    value, error = re.search(r'modulus (\S+) \+- (\S+) Pa', modulus).groups()
    covariance = TOGETHER * np.outer((20.0, 8.0, 36.0), (20.0, 8.0, 36.0))
    slope = np.array([0.0, 0.36, 0.16]) / 0.01 + (0.36, -2 * 0.18, 2 * 0.12)
    assert float(value) == pytest.approx(20.0 * (96_000.0 + 720.0))
    assert float(error) == pytest.approx(20.0 * np.sqrt(slope @ covariance @ slope), rel=0.05)
    # The time that the user has named has no error.
    (chosen,) = [line for line in remarks if line.startswith('** term 2')]
    assert chosen.endswith('time 0.01 +- 0 s')
    unknown = export('ansys', Model(), TOLD, specimen=BLOCK, poisson=0.45, shortest_time=0.01)
    assert '! standard errors: how the errors' in unknown
    assert '+-' not in unknown


def test_an_error_that_is_not_known_is_told_by_name() -> None:
    found = document(Model(), DOUGH, correlation=TOGETHER)
    assert found['relaxation']['terms'][0]['stiffness_std_N_m'] is None
    assert found['reasons']['relaxation_std'] == 'the standard error of C2 is not known'


def test_links_in_series_have_the_compliance_of_the_chain() -> None:
    model = Model(('series_spring', 'second_retardation', 'yield_force', 'inertia', 'adhesion'))
    values = _values(DOUGH) | {
        'K_0': 8000.0,
        'K_2': 5000.0,
        'C_3': 300.0,
        'F_y': 6.0,
        'M': 0.2,
        'F_ad': 0.5,
    }
    found = links(model, values)
    s = 0.7j
    compliance = sum(
        1.0 / (link['stiffness_N_m'] + s * link['damping_Ns_m']) for link in found['in_series']
    )
    expected = 1 / 8000 + 1 / (2000 + 1600 * s) + 1 / (5000 + 300 * s) + 1 / (2400 * s)
    assert compliance == pytest.approx(expected)
    assert found['in_series'][-1]['dry_friction_N'] == 6.0
    assert (found['mass_kg'], found['pull_off_force_N']) == (0.2, 0.5)
    assert found['laws'] == {}


def test_what_constant_numbers_cannot_hold_comes_with_its_law() -> None:
    model = Model(('shear_thinning',))
    values = _values(DOUGH) | {'n': 0.5}
    assert links(model, values)['laws']['shear_thinning']['parameters'] == {'n': 0.5}
    with pytest.raises(UsageError, match='cannot hold shear_thinning'):
        mujoco(model, values)


def test_a_mujoco_model_is_the_links_one_in_another() -> None:
    model = Model(('series_spring', 'parallel_spring', 'yield_force', 'inertia'))
    values = _values(BURGERS) | {'F_y': 6.0, 'M': 0.2}
    root = ElementTree.fromstring(mujoco(model, values))
    names, body = [], root.find('worldbody/body')
    while body is not None:
        joint, mass = body.find('joint'), float(body.find('inertial').get('mass'))
        names.append((body.get('name'), joint.get('name')))
        innermost, body = body, body.find('body')
    assert names == [('flow', 'flow'), ('retarded', 'retarded'), ('surface', 'instantaneous')]
    assert innermost.get('name') == 'surface'
    assert mass > 0.2
    flow = root.find('.//joint[@name="flow"]')
    assert (flow.get('stiffness'), flow.get('damping'), flow.get('frictionloss')) == (
        '0',
        '2400',
        '6',
    )
    tendon = root.find('tendon/fixed')
    assert tendon.get('stiffness') == '50'
    assert [joint.get('joint') for joint in tendon] == ['flow', 'retarded', 'instantaneous']


def test_the_document_says_why_a_nonlinear_body_has_no_relaxation_function() -> None:
    model = Model(('yield_force',))
    parameters = DOUGH | {'F_y': Estimate(6.0, 0.1)}
    refused = document(model, parameters)
    assert refused['relaxation'] is refused['material'] is None
    assert 'yield_force' in refused['reasons']['relaxation']
    assert 'not given' in refused['reasons']['material']
    assert refused['links']['in_series'][-1]['dry_friction_N'] == 6.0
    # C2 does not flow at rest: that its error is unknown is of no importance.
    at_rest = document(model, parameters, BLOCK, 'rest', np.eye(4))
    assert at_rest['relaxation']['linearised_at'] == 'rest'
    assert at_rest['relaxation']['long_term_N_m'] == pytest.approx(2000.0)
    assert at_rest['reasons'] == {}


def test_a_law_is_exported_as_what_it_is() -> None:
    own = {'M': Estimate(0.3, 0.01), 'rate': Estimate(0.2, 0.01)}
    tool = Model(('inertia:of_the_tool',))
    quantity = material_quantities(tool, DOUGH | own, BLOCK)['M']
    assert quantity.estimate.reason == 'inertia is of the cell, not of the object'
    assert document(tool, DOUGH | own)['links']['mass_kg'] == 0.0
    assert document(Model(('inertia',)), DOUGH | own)['links']['mass_kg'] == 0.3
    aged = document(Model(('ageing:within_trials',)), DOUGH | own)['links']['laws']
    assert aged['ageing:within_trials']['parameters'] == {'rate': 0.2}
