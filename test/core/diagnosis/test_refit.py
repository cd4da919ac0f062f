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


"""Models refitted to one campaign: strengths, likelihoods and smooth curves."""

from collections.abc import Callable
from dataclasses import replace
import math
from typing import Any

from hapticvision_ros.core.composition import Model
from hapticvision_ros.core.diagnosis import refit as refitting
from hapticvision_ros.core.diagnosis.refit import _is_beyond, Columns, Refit, Start, Workbench
from hapticvision_ros.core.diagnosis.selection import eliminate, price, Round, strength
from hapticvision_ros.core.diagnosis.structure import GATE, look
from hapticvision_ros.core.effects import EFFECTS
from hapticvision_ros.core.fit.campaign import Blur, fit_prepared, in_order, line_spectrum, Problem
from hapticvision_ros.core.fit.least_squares import covariance, NotFiniteError
from hapticvision_ros.core.fit.noise_model import SensorNoise
from hapticvision_ros.core.records import Signal, Trial
from hapticvision_ros.sim.campaigns import Campaign, ForceNoise, peak_force, Push, Sensors
from hapticvision_ros.sim.specimen import Body, Undeclared
from hapticvision_ros.sim.strengths import undeclared
import numpy as np
import pytest
from scipy.stats import chi2

EVALUATIONS = 0.1
"""A search ends where the squares no longer change by this much."""
ONE_IN_A_MILLION = 1e-6

type Bench = tuple[Workbench, Refit]


@pytest.fixture(scope='module')
def quiet(noise_only: Any) -> Bench:
    """Return a campaign without an effect, on a bench."""
    return noise_only.bench()


@pytest.fixture(scope='module')
def lacking(yielding: Any) -> Bench:
    """Return a campaign that yields, on a bench, with a model that does not."""
    return yielding.bench()


@pytest.fixture(scope='module')
def found(lacking: Bench) -> Refit:
    """Return the model that lacks nothing."""
    bench, base = lacking
    refit = bench.refit(Model(('yield_force',)), base)
    assert refit is not None
    return refit


def error(refit: Refit, place: int) -> float:
    """Return the standard error of a parameter as the search sees it."""
    _, jacobian = refit.problem.evaluate(refit.state)
    return math.sqrt(float(covariance(jacobian)[place, place]))


def test_a_refit_recovers_the_effect_and_the_body(found: Refit, world: Any) -> None:
    K1, C1, C2, yield_force = found.model.values(found.theta)
    assert abs(yield_force - 0.37) < 5.0 * error(found, 3)
    # By far less than the tenths by which the model without it is wrong.
    body = world.body
    assert pytest.approx([body.K1, body.C1, body.C2], rel=0.01) == [K1, C1, C2]


def test_the_deviance_falls_to_that_of_the_truth(lacking: Bench, found: Refit) -> None:
    # Four parameters and twelve of the trials: twice the log likelihood of the truth is less by
    # chi squared of so many degrees, whatever the effect.
    _, base = lacking
    state = found.state.copy()
    state[: found.problem.p] = found.model.theta([1000.0, 900.0, 1600.0, 0.37])
    residual, _ = found.problem.evaluate(state)
    fallen = float(residual @ residual) - found.cost
    assert -EVALUATIONS < fallen < chi2.isf(ONE_IN_A_MILLION, found.problem.size)
    assert base.deviance - found.deviance > 200.0


def test_a_weak_effect_lowers_the_deviance_by_the_square_of_its_strength_over_its_error(
    world: Any,
) -> None:
    drift = 0.004
    bench, base = world.measure(
        world.campaign(), Undeclared('force_drift', (drift,)), seed=4
    ).bench()
    refit = bench.refit(Model(('force_drift',)), base)
    assert refit is not None
    sigmas = refit.theta[3] / error(refit, 3)
    assert abs(refit.theta[3] - drift) < 5.0 * error(refit, 3)
    assert sigmas > 5.0
    # The model without the drift takes part of it for noise, which costs it less.
    ratio = (base.deviance - refit.deviance) / sigmas**2
    assert 0.6 < ratio < 1.05


def test_a_model_that_goes_where_nothing_is_finite_beside_its_noise_is_not_refitted(
    lacking: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The other candidates go on."""
    bench, base = lacking

    def nowhere(*_: Any, **__: Any) -> Refit:
        raise NotFiniteError('the model is not finite at the start')

    monkeypatch.setattr(Workbench, '_settled', nowhere)
    assert bench.refit(Model(('yield_force',)), base) is None


def test_effects_that_are_absent_gain_what_chance_gives(quiet: Bench) -> None:
    bench, base = quiet
    for name in ('yield_force', 'force_drift', 'clock_offset', 'friction'):
        refit = bench.refit(Model((name,)), base)
        assert refit is not None
        gain = base.deviance - refit.deviance
        assert gain < chi2.isf(1e-4, 1)
        assert gain < price(bench, name)
        assert abs(refit.theta[3]) < 5.0 * error(refit, 3)


@pytest.mark.parametrize('effect', EFFECTS, ids=lambda effect: effect.name)
def test_a_further_effect_never_fits_worse(lacking: Bench, effect: Any) -> None:
    bench, base = lacking
    refit = bench.refit(Model((effect.name,)), base)
    assert refit is not None
    # Each model has its own noise, which a search finds to a tenth.
    assert refit.deviance < base.deviance + 1.0


def test_one_step_promises_what_is_worth_a_refit(lacking: Bench, found: Refit) -> None:
    bench, base = lacking
    gain = base.deviance - found.deviance
    promised = bench.look(Model(('yield_force',)), base).promise
    # At the noise of the base model, in which part of the effect passes for noise.
    assert 10.0 * price(bench, 'yield_force') < promised < 1.5 * gain
    assert bench.look(Model(('force_drift',)), base).promise < price(bench, 'force_drift')


def test_what_later_effects_have_made_superfluous_is_taken_out(
    lacking: Bench, found: Refit
) -> None:
    bench, base = lacking
    both = bench.refit(Model(('friction', 'yield_force')), found)
    assert both is not None
    rounds = tuple(Round(base, (), (name,)) for name in ('friction', 'yield_force'))
    chosen, order = eliminate(bench, both, rounds)
    assert order == ('yield_force',)
    assert chosen.model.effects == ('yield_force',)
    assert chosen.deviance == pytest.approx(found.deviance, abs=1.0)


@pytest.mark.parametrize('scatter', [None, 0.1], ids=['alike', 'scattering'])
def test_what_a_model_without_an_effect_has_done_without_holds_up_no_search(
    scatter: float | None, world: Any
) -> None:
    """As it does without C1 and flow, where neither lowers what the effect leaves."""
    measured = world.measure(world.campaign(), Undeclared('contact_growth', (0.5,)), seed=3)
    bench, base = measured.bench(scatter)
    state = base.state.copy()
    state[1:3] = np.log([1e-6, 1e12])
    stiff = replace(base, state=state)
    # What is wrong itself, beside what it lacks, ends within some squares of a hundred.
    for effect, part in (('contact_growth', 1e-3), ('springpot', 0.05)):
        model = Model((effect,))
        usual, found = bench.refit(model, base), bench.refit(model, stiff)
        assert usual is not None
        assert found is not None
        gain = base.deviance - usual.deviance
        assert gain > 100.0
        assert found.deviance < usual.deviance + part * gain


def test_more_effects_explain_no_less_whatever_is_taken_for_a_jump(
    lacking: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Moments that are taken to be hardly known, beside a noise to go with it, hide the effect."""
    bench, base = lacking
    sharpest = Problem.sharpest

    def blunt(problem: Problem, state: Any, noise: Any, blur: Blur) -> Blur:
        found = sharpest(problem, state, noise, blur)
        return Blur(16.0, 16.0) if problem.model.effects else found

    monkeypatch.setattr(Problem, 'sharpest', blunt)
    found = bench.refit(Model(('yield_force',)), base)
    assert found is not None
    assert found.deviance < base.deviance
    assert found.blur == base.blur
    again = found.problem.evaluate(found.state)[0]
    assert float(again @ again) == pytest.approx(found.cost)


def test_a_refit_does_not_end_on_its_way_where_the_tool_comes_again(
    world: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What stiffens moves the base parameters further than a search beside slow noise finds."""
    body = Body(378.0, 1192.0, 1822.0)
    pushes = tuple(
        Push(speed, depth, 6.0, 4.0, swings=3, swing=0.65 * depth)
        for speed, depth in ((0.002, 0.0018), (0.008, 0.0045), (0.002, 0.0032))
    )
    silent = Campaign(body, pushes, Sensors(ForceNoise(0.0), 0.0))
    part = 0.0014 * peak_force(silent)
    campaign = replace(silent, sensors=Sensors(ForceNoise(part, part, 0.03), 2e-5))
    acting = undeclared('strain_stiffening', 20.0, campaign)
    bench, base = world.measure(campaign, acting, seed=4).bench()
    model = Model(('strain_stiffening',))
    found = bench.refit(model, base)
    monkeypatch.setattr(Problem, 'search_on', lambda _, found: found)
    stuck = bench.refit(model, base)
    assert found is not None
    assert stuck is not None
    assert found.deviance < stuck.deviance - 1000.0
    assert np.exp(found.theta[0]) == pytest.approx(body.K1, rel=0.01)


def test_each_parameter_costs_the_logarithm_of_the_samples(lacking: Bench) -> None:
    bench, _ = lacking
    own = [t.force_count.astype(bool).sum() + t.height_t.size for t in bench.trials]
    samples = sum(own)
    assert price(bench, 'yield_force') == pytest.approx(math.log(samples))
    assert price(bench, 'second_retardation') == pytest.approx(2.0 * math.log(samples))
    # Amplitude and frequency, and a phase in each trial, which only its own samples tell.
    phases = sum(map(math.log, own))
    assert price(bench, 'periodic_disturbance') == pytest.approx(2.0 * math.log(samples) + phases)


def test_strength_is_the_change_of_the_prediction_over_the_noise(
    lacking: Bench, found: Refit
) -> None:
    bench, base = lacking
    squares, samples = 0.0, 0.0
    for index, trial in enumerate(bench.trials):
        ours, theirs = (bench.residual(each.problem, each.state, index) for each in (found, base))
        squares += float(trial.force_count @ (ours[0] - theirs[0]) ** 2) / base.force_noise.std**2
        squares += (
            float(trial.height_count @ (ours[1] - theirs[1]) ** 2) / base.height_noise.std**2
        )
        samples += float(trial.force_count.sum() + trial.height_count.sum())
    assert strength(bench, found, base) == pytest.approx(math.sqrt(squares / samples), rel=1e-9)


def waves(bench: Workbench, frequency: float) -> list[Columns]:
    """Return a sine and a cosine in the force of each trial."""
    made = []
    for trial in bench.trials:
        angle = 2.0 * np.pi * frequency * 0.5 * (trial.t[1:] + trial.t[:-1])
        inside = (angle > 0.0) & (trial.displacement[1:] > 0.0)
        force = np.stack((np.sin(angle), np.cos(angle))) * inside
        made.append(Columns(force, np.zeros((2, trial.height_t.size))))
    return made


def test_curves_gain_from_noise_as_many_as_they_are(quiet: Bench) -> None:
    bench, base = quiet
    gains = [bench.smooth(base, waves(bench, f), again=False) for f in np.arange(1.0, 4.0, 0.1)]
    assert all(each.count == 2 for each in gains)
    total = sum(each.gain for each in gains)
    # Chi squared of sixty degrees, if the waves are independent; five of its deviations.
    assert total == pytest.approx(60.0, abs=5.0 * math.sqrt(120.0))


def test_no_curve_stands_out_of_noise(quiet: Bench, noise_only: Any) -> None:
    bench, base = quiet
    assert all(each.gain < GATE for each in look(bench, base, noise_only.phases))


def bumped(bench: Workbench, base: Refit, change: Callable[..., Any]) -> tuple[Workbench, Refit]:
    """Return a bench whose trials have been changed, with the same model on it."""
    other = Workbench([change(k, trial) for k, trial in enumerate(bench.trials)], None)
    problem = Problem(base.model, other.trials)
    problem.set_noise(base.force_noise, base.height_noise, base.jumps)
    residual, _ = problem.evaluate(base.state)
    cost = float(residual @ residual)
    return other, replace(
        base, problem=problem, cost=cost, deviance=cost + problem.log_determinant
    )


@pytest.mark.parametrize(('channel', 'phase'), [('force', 'hold'), ('height', 'recover')])
def test_a_bump_is_found_where_it_is(
    quiet: Bench, noise_only: Any, channel: str, phase: str
) -> None:
    bench, base = quiet
    size = {'force': base.force_noise.std, 'height': base.height_noise.std}[channel]
    bumps = []

    def change(index: int, trial: Any) -> Any:
        phases = noise_only.phases[index]
        start, stop = (
            (phases.t_hold, phases.t_release) if phase == 'hold' else (phases.t_loss, phases.t_end)
        )
        t = 0.5 * (trial.t[1:] + trial.t[:-1]) if channel == 'force' else trial.height_t
        along = (t - start) / (stop - start)
        bump = 2.0 * size * np.where((along > 0.0) & (along < 1.0), np.sin(np.pi * along), 0.0)
        bumps.append(bump)
        return replace(trial, **{channel: getattr(trial, channel) + bump})

    other, same = bumped(bench, base, change)
    seen = look(other, same, noise_only.phases)
    assert (seen[0].curve.channel, seen[0].curve.phase) == (channel, phase)
    assert seen[0].gain > 5.0 * GATE
    # Between the mean of a sine and its peak; the parameters may take a part of it.
    assert 0.3 * 2.0 * size < seen[0].rms < 2.0 * size
    assert 0.0 < seen[0].share <= 1.0


def test_a_curve_is_given_back_as_it_was_put_in(quiet: Bench) -> None:
    bench, base = quiet
    columns = waves(bench, 2.0)
    height = 3.0 * base.force_noise.std

    def change(index: int, trial: Any) -> Any:
        return replace(trial, force=trial.force + height * columns[index].force[0])

    other, same = bumped(bench, base, change)
    before = bench.smooth(base, columns, again=False)
    after = other.smooth(same, columns, again=False)
    assert after.gain > before.gain + 100.0
    for index, trial in enumerate(bench.trials):
        taken = after.force[index] - before.force[index]
        # Least squares are linear: what was added comes out, beside what was there.
        added = height * columns[index].force[0]
        # Directions that the data hardly tell are left out of the solution.
        assert np.abs(taken - added)[trial.force_count > 0].max() < 1e-3 * height


def dense(duration: Any, noise: SensorNoise) -> Any:
    """Return the covariance of samples, each of which fills its step."""
    t = np.cumsum(duration)
    away = np.abs(t[:, None] - t[None, :])
    return noise.slow**2 * np.exp(-away / noise.correlation_time) + noise.white**2 * np.eye(t.size)


def scattered(bench: Workbench, base: Refit) -> tuple[Problem, Any]:
    """Return two short trials at their full rate, whose K1, C1 and C2 scatter."""
    trials = [replace(trial.full_rate, height_t=np.empty(0)) for trial in bench.trials[2:]]
    cut = []
    for trial in trials:
        first = int(np.searchsorted(trial.t, trial.t_contact)) - 50
        kept, edges = slice(first, first + 200), slice(first, first + 201)
        samples = replace(
            trial.samples,
            edges=trial.t[edges],
            force=trial.force[kept],
            good=trial.samples.good[kept],
        )
        cut.append(
            replace(
                trial,
                t=trial.t[edges],
                displacement=trial.displacement[edges],
                force=trial.force[kept],
                force_count=np.ones(200),
                height=np.empty(0),
                height_count=np.empty(0),
                has_height_zero=False,
                samples=samples,
            )
        )
    problem = Problem(base.model, cut, np.array([0.02, 0.03, 0.05]))
    problem.set_noise(base.force_noise, base.height_noise)
    state = np.zeros(problem.size)
    state[:3] = base.theta
    return problem, state


def test_the_price_of_scatter_is_a_ratio_of_determinants(quiet: Bench) -> None:
    # The force of a trial is normal, with the scatter's part in its covariance or without it.
    bench, base = quiet
    problem, state = scattered(bench, base)
    expected = 0.0
    for index, trial in enumerate(problem.trials):
        force, _ = problem.records(state, index)
        body, others = force[:3].T, force[[3, -2]].T
        # What else is the trial's own, its onset and its zero, may be anything.
        flat = others / np.sqrt(np.sum(others**2, axis=0))
        without = dense(np.diff(trial.t), base.force_noise)
        without = without + 1e6 * base.force_noise.std**2 * flat @ flat.T
        within = without + body @ np.diag(problem.scatter**2) @ body.T
        expected += float(np.linalg.slogdet(within)[1] - np.linalg.slogdet(without)[1])
    # The flat part is a million times the noise.
    assert problem.scatter_price(state) == pytest.approx(expected, rel=1e-3)
    assert expected > 1.0
    _, jacobian = problem.evaluate(state)
    assert problem.scatter_price(state, jacobian) == problem.scatter_price(state)
    # What is known of the derivatives is taken.
    assert problem.scatter_price(state, 2.0 * jacobian) > expected + 1.0


def test_no_state_is_evaluated_twice_beside_one_noise(
    lacking: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, base = lacking
    asked = []
    evaluate = Problem.evaluate

    def counted(problem: Problem, state: Any) -> Any:
        # The determinant stands for the noise.
        asked.append((state.tobytes(), problem.log_determinant))
        return evaluate(problem, state)

    monkeypatch.setattr(Problem, 'evaluate', counted)
    for names in (('yield_force',), ('second_retardation',)):
        asked.clear()
        assert bench.refit(Model(names), base) is not None
        assert len(asked) > 10
        assert len(set(asked)) == len(asked)


def test_a_start_that_promises_less_than_is_reached_is_left_where_promises_are_kept() -> None:
    nothing = np.empty(0)
    first, other, body = (
        Start(np.array(state), nothing, nothing, left)
        for state, left in (
            ([1.0, 2.0, 3.0, 0.1], 900.0),
            ([1.0, 2.0, 3.0, 0.5], 910.0),
            ([1.0, 2.5, 3.0, 0.5], 910.0),
        )
    )
    # One step promised 100 of 1000.
    assert _is_beyond(other, first, 901.0, 100.0)
    assert not _is_beyond(first, first, 901.0, 100.0)
    assert not _is_beyond(body, first, 901.0, 100.0), 'what another body promises is less exact'
    assert not _is_beyond(other, first, 912.0, 100.0), 'it promises more'
    assert not _is_beyond(other, first, 894.0, 100.0), 'the first was further than one step'


def test_all_starts_of_what_is_scanned_are_followed(
    lacking: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    bench, base = lacking

    def beyond(start: Start, first: Start, reached: float, promised: float) -> bool:
        return start is not first and reached < math.inf

    monkeypatch.setattr(refitting, '_is_beyond', beyond)
    followed = []
    search = Problem.search

    def counted(problem: Problem, state: Any, **how: Any) -> Any:
        followed.append(state.tobytes())
        return search(problem, state, **how)

    monkeypatch.setattr(Problem, 'search', counted)
    for name, scanned in (('yield_force', False), ('second_retardation', True)):
        looked = bench.look(Model((name,)), base)
        assert len(looked.starts) > 1
        followed.clear()
        bench.refit(Model((name,)), base, looked)
        others = [start.state.tobytes() in followed for start in looked.starts[1:]]
        assert others == [scanned] * len(others)


def test_without_scatter_there_is_no_price(quiet: Bench) -> None:
    _, base = quiet
    assert base.problem.scatter_price(base.state) == 0.0


def test_slopes_with_scatter_are_those_of_differences(quiet: Bench) -> None:
    bench, base = quiet
    problem = Problem(base.model, bench.trials, np.array([0.02, 0.03, 0.05]))
    problem.set_noise(base.force_noise, base.height_noise, base.jumps)
    state = np.zeros(problem.size)
    state[:3] = base.theta + 0.02
    state[3:] = 1e-5 * np.arange(problem.size - 3)

    def squares(at: Any) -> float:
        residual, _ = problem.evaluate(at)
        return float(residual @ residual)

    residual, jacobian = problem.evaluate(state)
    slope = 2.0 * residual @ jacobian
    for place, name in enumerate(problem.names):
        # The force jumps at the touch: half a micrometre on, it is in another sample.
        step = 1e-8 if name.startswith('onset') else 1e-5
        away = np.zeros(problem.size)
        away[place] = step
        numeric = (squares(state + away) - squares(state - away)) / (2.0 * step)
        # Central differences of squares of thousands, to their rounding.
        assert slope[place] == pytest.approx(numeric, rel=2e-3, abs=1e-2), name


def test_scatter_moves_a_trial_as_the_shared_parameters_would(quiet: Bench) -> None:
    bench, base = quiet
    problem = Problem(base.model, bench.trials, np.full(3, 0.02))
    moved, shared = np.zeros(problem.size), np.zeros(problem.size)
    moved[:3], shared[:3] = base.theta, base.theta + 0.01
    first = problem.places[1].start + problem.q
    moved[[first, first + 1, first + 2]] = 0.01
    one = problem.predict(moved, 1, directions=False)
    other = problem.predict(shared, 1, directions=False)
    np.testing.assert_allclose(one.force, other.force, rtol=1e-12, atol=1e-12)
    same = problem.predict(moved, 0, directions=False)
    assert not np.allclose(same.force, problem.predict(shared, 0, directions=False).force)


@pytest.mark.parametrize('times', [0.1, 8.0])
def test_the_unit_that_the_base_model_shows_is_the_first(world: Any, times: float) -> None:
    """Two units in series are one body by either name: the second may be the slower one."""
    K_2 = 6.0 * world.body.K1
    second = Undeclared('second_retardation', (K_2, 6.0 * times * world.body.C1))
    measured = world.measure(world.campaign(hold=20.0, recover=12.0), second, seed=4)
    bench, base = measured.bench()
    model = Model(('second_retardation',))
    refit = bench.refit(model, base)
    assert refit is not None
    fitted = fit_prepared(base.problem.trials, model)
    for K1, C1, C2, found_K_2, C_3 in (model.values(refit.theta), model.values(fitted.theta)):
        body = (world.body.K1, world.body.C1, world.body.C2)
        assert pytest.approx(body, rel=0.03) == (K1, C1, C2)
        assert (found_K_2, C_3) == pytest.approx(second.values, rel=0.2)


def test_the_other_name_of_a_body_is_the_same_to_the_data(world: Any) -> None:
    second = Undeclared('second_retardation', (6000.0, 43200.0))
    measured = world.measure(world.campaign(hold=20.0, recover=12.0), second, seed=4)
    bench, base = measured.bench()
    refit = bench.refit(Model(('second_retardation',)), base)
    assert refit is not None
    values = refit.model.values(refit.theta)
    other = refit.state.copy()
    other[: values.size] = refit.model.theta(values[[3, 4, 2, 0, 1]])
    bodies = dict(zip(refit.model.names, values.tolist(), strict=True))
    there = refit.problem.search(other, tolerance=1.0)
    back = in_order(refit.problem, there, bodies)
    assert refit.model.values(back.theta[: values.size]) == pytest.approx(values, rel=1e-3)
    assert in_order(refit.problem, back, bodies) is back


def test_a_power_of_one_is_started_from_near_one(lacking: Bench) -> None:
    """A thinning body differs from a dashpot by how far its index is from one, not from zero."""
    bench, base = lacking
    _, starts = bench.guesses(Model(('shear_thinning',)), base)
    indices = [Model(('shear_thinning',)).values(state[:4])[3] for state in starts]
    assert np.min(np.abs(np.array(indices) - 1.0)) < 0.01
    assert bench.look(Model(('shear_thinning',)), base).promise > 0.0


def test_a_line_is_found_where_samples_are_missing(world: Any) -> None:
    """Every fiftieth: counted by samples, a hum of 8.1 Hz would be one of 7.9 to 8.1."""

    def thinned(trial: Trial) -> Trial:
        kept = np.random.default_rng(0).random(len(trial.force)) > 0.02
        return replace(trial, force=Signal(trial.force.t[kept], trial.force.value[kept]))

    force = peak_force(world.campaign())
    hum = Undeclared('periodic_disturbance', (0.004 * force, 8.1))
    measured = world.measure(world.campaign(hold=20.0), hum, seed=5, change=thinned)
    _, base = measured.bench()
    line = line_spectrum(base.problem, base.state)
    assert line.frequency == pytest.approx(8.1, abs=0.01)
    assert line.chance < 1e-6


def test_a_line_is_found_whatever_trial_comes_first(world: Any) -> None:
    """By one that is recorded ten times as slowly a hum of 31 Hz is one of 9 Hz."""

    def slow(trial: Trial) -> Trial:
        if trial.name != 'trial_01':
            return trial
        return replace(trial, force=Signal(trial.force.t[::10], trial.force.value[::10]))

    force = peak_force(world.campaign())
    hum = Undeclared('periodic_disturbance', (0.004 * force, 31.0))
    measured = world.measure(world.campaign(hold=10.0), hum, seed=5, change=slow)
    _, base = measured.bench()
    assert base.problem.trials[0].interval > 9.0 * base.problem.trials[1].interval
    line = line_spectrum(base.problem, base.state)
    assert line.frequency == pytest.approx(31.0, abs=0.05)
    assert line.chance < 1e-6


def _on(body: Body, campaign: Campaign, noise: float) -> Campaign:
    """Return a campaign on another body, with white noise of a part of its largest force."""
    campaign = replace(campaign, body=body)
    level = ForceNoise(noise * peak_force(campaign))
    return replace(campaign, sensors=replace(campaign.sensors, force_noise=level))


def test_a_lag_is_found_where_the_base_model_has_done_without_its_viscosity(world: Any) -> None:
    """C1 makes the force jump at the touch: a load cell that is late leaves none of it to see."""
    body = Body(1000.0, 75.0, 425.0)
    pushes = ((0.01, 0.01), (0.0017, 0.01), (0.01, 0.004))
    campaign = _on(body, world.campaign(pushes, rate=250.0, hold=2.0), 0.005)
    late = Undeclared('force_lag', (0.125,))
    bench, base = world.measure(campaign, late, seed=31).bench()
    C1, C2 = base.model.values(base.theta)[1:3]
    assert C1 < 1e-3 * C2
    refit = bench.refit(Model(('force_lag',)), base)
    assert refit is not None
    expected = (body.K1, body.C1, body.C2, late.values[0])
    assert pytest.approx(expected, rel=0.03) == refit.model.values(refit.theta)


def test_a_slow_body_is_found_behind_a_machine_that_gives_way(world: Any) -> None:
    """Its spring is nothing beside the noise, and the base model makes one of the machine."""
    body = Body(21.0, 718.0, 560.0)
    pushes = ((0.008, 0.0036), (0.005, 0.004), (0.019, 0.0049))
    campaign = _on(body, world.campaign(pushes, hold=30.0, recover=40.0), 0.015)
    machine = Undeclared('machine_compliance', (9500.0,))
    bench, base = world.measure(campaign, machine, seed=32).bench()
    assert base.model.values(base.theta)[0] > 100.0 * body.K1
    refit = bench.refit(Model(('machine_compliance',)), base)
    assert refit is not None
    expected = (body.K1, body.C1, body.C2, machine.values[0])
    assert pytest.approx(expected, rel=0.05) == refit.model.values(refit.theta)
    # Whether an effect shows is asked beside one body: another is a change as well.
    _, states = bench.guesses(Model(('machine_compliance',)), base)
    assert len({tuple(state[:3].tolist()) for state in states}) == 1
