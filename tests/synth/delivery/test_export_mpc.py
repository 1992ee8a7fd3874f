"""Predictive controllers in C: the command of the controller in Python, at every sample, or a status that says why not.

The CubeSat's are those of the study (Pecorilla and Stesina 2024, table 3); the others are random.
"""

import re
import shutil
import subprocess

import numpy as np
import pytest
from exactmpc import random_program
from exportedmpc import CompiledMpc, exported, flight, rescaled
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from table3 import FORMS, MODEL, REST, SOFT, TABLE_3, TORQUE

import synth
from synth.delivery.cmpc import flown, program, sizes
from synth.errors import ExportError, NumericalError
from synth.predictive.horizon import mpc
from synth.predictive.prestabilised import LongArithmetic
from synth.systems.statespace import StateSpace

AGREES = 1e-9  # of the larger limit of each command
SOLVED, BAD_DATA, UNSOLVED, ROUGH = range(4)
TIGHT = {"hmax": 4e-4}  # N m s, active at every slew
CUBESATS = {
    "position": {"form": "position", **SOFT}, "velocity": {"form": "velocity", **SOFT},
    "position, late": {"form": "position", "delay": 2, **SOFT}, "velocity, late": {"form": "velocity", "delay": 1},
    "position, momentum": {"form": "position", **TIGHT}, "velocity, momentum": {"form": "velocity", **TIGHT},
    "position, hard limits alone": {"form": "position"},
}  # fmt: skip


@pytest.mark.parametrize("case", CUBESATS)
def test_the_cubesat_in_closed_loop(case, tmp_path):
    """2000 samples of slews with noise and a disturbance, each of the two with a plant of its own."""
    controller = mpc(MODEL, **TABLE_3, **CUBESATS[case])
    compiled = exported(controller, tmp_path)
    assert compiled.self_test() == 0
    rng = np.random.default_rng(0)
    noise = 1e-3 * rng.standard_normal((2000, 6)) * [1, 1, 1, 0.1, 0.1, 0.1]
    targets = np.repeat(np.hstack([rng.uniform(-0.3, 0.3, (20, 3)), np.zeros((20, 3))]), 100, axis=0)
    flights, limited = [], 0
    for step in (flight(controller), compiled.step):
        delay, x, U = controller.problem.delay, np.array([-0.13, 0.22, 0.09, 0, 0.0011, 0]), []
        for k in range(2000):
            U.append(step(x + noise[k], targets[k]))
            acting = U[k - delay] if k >= delay else np.zeros(3)
            x = MODEL.A @ x + MODEL.B @ (acting + 1e-5)
            limited += step == compiled.step and not compiled.slack
        flights.append(np.array(U))
    assert np.abs(flights[0] - flights[1]).max() <= AGREES * TORQUE
    assert compiled.statuses == {SOLVED}
    assert 0 < compiled.most <= sizes(controller)["ITERATIONS"]
    assert limited >= 40
    assert np.abs(flights[1]).max() <= TORQUE


def test_the_study_s_own_controllers(tmp_path):
    """As the study poses them, about nadir on its orbit."""
    from cubesat3u_controllers import predictive

    for form in FORMS:
        controller = predictive(form)
        compiled = exported(controller, tmp_path)
        assert compiled.self_test() == 0
        A, B, unit = controller.problem.model.A, controller.problem.model.B, controller.problem.unit
        own, rng, x, off = flight(controller), np.random.default_rng(1), 0.2 * np.ones(6), 0.0
        for k in range(2000):
            r = np.zeros(6) if k % 200 < 100 else np.array([0.2, -0.1, 0.3, 0, 0, 0])
            y = x + 1e-4 * rng.standard_normal(6)
            u = own(y, r)
            off = max(off, np.abs((u - compiled.step(y, r)) / unit).max())
            x = A @ x + B @ u
        assert off <= AGREES
        assert compiled.statuses == {SOLVED}


def both(controller, compiled, x, r, state):
    """One sample by both from the same memory: what Python returns, and how far C is off, in units of the limits."""
    compiled.remember(state)
    after, u = controller.step(state, x, r)
    found = compiled.step(x, r)
    return after, u, np.abs((u - found) / controller.problem.unit).max()


@st.composite
def programs(draw):
    return draw(st.integers(0, 10**6)), draw(st.sampled_from([-6, -3, 0, 3, 6])), draw(st.sampled_from([-6, 0, 6]))


def replayed(case, folder):
    """A random plant in random units under its predictive controller: the commands agree at every sample."""
    seed, states, commands = case
    model, options, x, r = rescaled(seed, 10.0**states, 10.0**commands)
    controller = mpc(model, **options)
    compiled = exported(controller, folder)
    p, rng, state = controller.problem, np.random.default_rng(seed), controller.init()
    acting = [np.zeros(model.nu)] * p.delay
    for k in range(40):
        try:
            state, u, off = both(controller, compiled, x, r if k > 20 else 0 * r, state)
        except NumericalError:
            return
        assert compiled.status in (SOLVED, ROUGH) or state.fallbacks
        assert compiled.status == UNSOLVED or off <= (
            AGREES if compiled.status == SOLVED else 2 * compiled.memory.error
        )
        assert compiled.iterations <= sizes(controller)["ITERATIONS"]
        assert (compiled.last >= p.umin).all()
        assert (compiled.last <= p.umax).all()
        acting.append(u)
        x = model.A @ x + model.B @ (acting[k] + 0.1 * p.unit * rng.uniform(-1, 1, model.nu))
    assert compiled.self_test() == 0


@settings(max_examples=8, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture], derandomize=True)
@given(case=programs())
@example(case=(97, -6, 6))  # two limits that are almost the same row: known to 1e-7, and told as rough
def test_random_plants_in_any_units(case, tmp_path):
    replayed(case, tmp_path)


@pytest.mark.slow
@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(case=programs())
def test_many_random_plants_in_any_units(case, tmp_path):
    replayed(case, tmp_path)


SEEDS = [1077, 1182, 1005, 1029, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2000, 2040))]


@pytest.mark.parametrize("seed", SEEDS)
def test_what_is_called_solved_is_the_optimum_also_where_doubles_end(seed, tmp_path):
    """Modes to 1.5 a sample over horizons to 100 with soft limits that cannot be kept: right, or refused and held."""
    model, options, x, r, past, d = random_program(np.random.default_rng(seed))
    controller = mpc(model, **options)
    prediction = x - d if controller.problem.form == "velocity" else None
    state = controller.init()._replace(prediction=prediction, inputs=past)
    compiled = exported(controller, tmp_path, self_test=False)
    compiled.remember(state)
    u, unit, phi = compiled.step(x, r), controller.problem.unit, controller.parameters(state, x, r)
    if compiled.status in (SOLVED, ROUGH):
        m = unit.size
        best = LongArithmetic(controller.problem, commands=True)(phi, controller.qp.likely(phi))[:m]
        np.testing.assert_allclose(u / unit, best, rtol=0, atol=max(1e-8, compiled.memory.error))
    else:
        assert compiled.status == UNSOLVED
        np.testing.assert_allclose(u, state.inputs[-1], rtol=1e-15)


@pytest.mark.parametrize("form", FORMS)
def test_what_is_no_number_is_refused_and_the_last_command_is_held(form, tmp_path):
    controller = mpc(MODEL, form=form, **TABLE_3, **SOFT)
    compiled, x = exported(controller, tmp_path), np.array([-0.13, 0.22, 0.09, 0, 0.0011, 0])
    before = compiled.step(x, REST)
    for value in (np.nan, np.inf, -np.inf, 1e200):
        for k in range(6):
            for y, r in ((np.where(np.arange(6) == k, value, x), REST), (x, np.where(np.arange(6) == k, value, 0))):
                np.testing.assert_array_equal(compiled.step(y, r), before)
                assert compiled.status == BAD_DATA
    np.testing.assert_allclose(
        compiled.memory.momentum, -0.5 * 49 * before, rtol=1e-12
    )  # it was commanded all the time
    state = controller.init()._replace(inputs=before[None], momentum=np.array(compiled.memory.momentum))
    assert np.abs(compiled.step(x, REST) - controller.step(state, x, REST)[1]).max() <= AGREES * TORQUE
    assert compiled.status == SOLVED
    compiled.memory.momentum[0] = np.nan
    for _ in range(2):
        compiled.step(x, REST)
        assert compiled.status == BAD_DATA
    compiled.memory.momentum[0] = 0.0
    compiled.step(x, REST)
    assert compiled.status == SOLVED


def test_measured_momentum_is_written_into_the_state(tmp_path):
    controller = mpc(MODEL, form="velocity", **TABLE_3, **TIGHT)
    compiled, x, h = exported(controller, tmp_path), np.array([0.02, 0, 0, 0, 0, 0]), np.array([4e-4, 0, -3e-4])
    compiled.memory.momentum[:] = h.tolist()
    expected = controller.step(controller.init(), np.concatenate([x, h]), REST)[1]
    assert np.abs(compiled.step(x, REST) - expected).max() <= AGREES * TORQUE
    assert np.abs(expected - controller.step(controller.init(), x, REST)[1]).max() > 0.1 * TORQUE


@pytest.mark.parametrize("size", [1e3, 1e6, 1e12])
def test_far_beyond_all_limits_there_is_a_saturated_command_or_a_status(size, tmp_path):
    controller = mpc(MODEL, form="position", **TABLE_3, **SOFT)
    compiled, rng = exported(controller, tmp_path), np.random.default_rng(2)
    for _ in range(20):
        x = size * rng.uniform(-1, 1, 6)
        compiled.reset()
        u = compiled.step(x, REST)
        assert np.abs(u).max() <= TORQUE
        if compiled.status == SOLVED:
            expected = controller.step(controller.init(), x, REST)[1]
            np.testing.assert_allclose(u, expected, rtol=0, atol=1e-8 * TORQUE)


def test_a_step_ends_at_the_bound_of_its_iterations_and_says_so(tmp_path):
    """With a bound of eight exchanges some samples of a slew have no command, and none is wrong."""
    controller = mpc(MODEL, form="position", **TABLE_3, **SOFT)
    folder = tmp_path / "short"
    synth.export(controller, "c", folder, name="attitude")
    header = (folder / "attitude.h").read_text()
    shorter, count = re.subn(r"(#define ATTITUDE_ITERATIONS) \d+", r"\1 8", header)
    assert count == 1
    (folder / "attitude.h").write_text(shorter)
    compiled, x, state = CompiledMpc(folder / "attitude.c", controller), np.full(6, 0.1), controller.init()
    for _ in range(60):
        _, u, off = both(controller, compiled, x, REST, state)
        assert compiled.iterations <= 8
        held = np.clip(state.inputs[-1], -TORQUE, TORQUE)
        assert (compiled.last == held).all() if compiled.status == UNSOLVED else off <= AGREES
        state = controller.step(state, x, REST)[0]
        x = MODEL.A @ x + MODEL.B @ u
    assert compiled.statuses == {SOLVED, UNSOLVED}


def test_every_constant_is_guarded_by_the_self_test(tmp_path):
    """The last digit but one of one number in each table is changed."""
    controller = mpc(MODEL, form="velocity", **TABLE_3, **SOFT)
    synth.export(controller, "c", tmp_path, name="attitude")
    source, rng = (tmp_path / "attitude.c").read_text(), np.random.default_rng(3)
    for key in program(controller):
        start = source.index(f"static const double {key}[")
        text = source[start : source.index(";\n", start)]
        numbers = [n for n in re.finditer(r"\d+\.\d+(?=[e,\s}])", text) if float(n[0]) != 0]
        number = numbers[rng.integers(len(numbers))]
        digit = str((int(number[0][-1]) + 5) % 10)
        changed = text[: number.end() - 1] + digit + text[number.end() :]
        folder = tmp_path / key
        folder.mkdir()
        (folder / "attitude.h").write_text((tmp_path / "attitude.h").read_text())
        (folder / "attitude.c").write_text(source.replace(text, changed))
        assert CompiledMpc(folder / "attitude.c", controller, "-O0").self_test() != 0, key


MAIN = """
#include <math.h>
#include <stdio.h>
#include <string.h>
#include "attitude.h"
int main(void)
{
    static attitude_state state;
    double y[ATTITUDE_STATES] = { 0.3, -0.2, 0.1 }, r[ATTITUDE_STATES] = { 0 }, u[ATTITUDE_OUTPUTS];
    attitude_reset(&state);
    for (int k = 0; k < 1000; ++k) {
        for (int i = 0; i < ATTITUDE_STATES; ++i) {
            const double last = k % 97 == 1 ? 0 : y[i];
            y[i] = k % 97 == 0 ? NAN : k % 89 == 0 ? 1e100 : 0.9 * last + 0.01 * ((k * (i + 3)) % 7 - 3);
        }
        attitude_step(&state, y, r, u);
        if (k % 89 == 0) {
            y[0] = y[1] = y[2] = y[3] = y[4] = y[5] = 0;
        }
    }
    memset(&state, 1, sizeof state); /* as it comes without a reset */
    y[0] = 0;
    attitude_step(&state, y, r, u);
    printf("%d\\n", attitude_self_test());
    return 0;
}
"""


@pytest.mark.parametrize("compiler", ["gcc", "clang"])
@pytest.mark.parametrize("form", FORMS)
def test_it_compiles_without_a_warning_and_runs_without_undefined_behaviour(compiler, form, tmp_path):
    if shutil.which(compiler) is None:
        pytest.skip(f"{compiler} compiles the C of this test and is not installed")
    synth.export(mpc(MODEL, form=form, delay=2, **TABLE_3, **SOFT), "c", tmp_path, name="attitude")
    (tmp_path / "main.c").write_text(MAIN)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-Wconversion", "-Wvla"]
    checked = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-g"]
    sources = [str(tmp_path / "main.c"), str(tmp_path / "attitude.c")]
    command = [compiler, *strict, *checked, "-DATTITUDE_SELF_TEST", *sources, "-lm", "-o", str(tmp_path / "main")]
    built = subprocess.run(command, capture_output=True, text=True)
    assert built.returncode == 0, built.stderr
    done = subprocess.run([str(tmp_path / "main")], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "0\n", "")
    assert not re.search(r"\b(malloc|calloc|realloc|free|alloca)\b", (tmp_path / "attitude.c").read_text())


@pytest.mark.parametrize("Nc", [1, 2, 3])
def test_the_smallest_programs(Nc, tmp_path):
    """No rows at all; limits of one sign, whose least command is not zero; one state, one command."""
    G = StateSpace([[0.9]], [[0.5]], [[1.0]], [[0.0]], 0.1)
    controller = mpc(G, Q=1, R=0.1, Np=4, Nc=Nc, umin=0.25, umax=2.0, form="position")
    compiled, own, x = exported(controller, tmp_path), flight(controller), np.array([3.0])
    np.testing.assert_array_equal(compiled.step(x * np.nan, x), [0.25])  # nothing commanded yet, and zero is no command
    compiled.reset()
    for k in range(50):
        r = np.array([2.0 * (-1) ** (k // 10)])
        u = own(x, r)
        np.testing.assert_allclose(compiled.step(x, r), u, rtol=0, atol=2 * AGREES)
        x = G.A @ x + G.B @ u
    assert compiled.statuses == {SOLVED, BAD_DATA}


def test_the_stored_flight_reaches_the_limits():
    for form in FORMS:
        y, u = flown(mpc(MODEL, form=form, **TABLE_3, **SOFT))
        assert (np.abs(np.abs(u) - TORQUE) < 1e-9 * TORQUE).sum() >= 5
        assert np.isfinite(y).all()


def test_what_cannot_leave_says_why_and_what_to_do(tmp_path):
    G = synth.c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], np.eye(2), np.zeros((2, 1))), 0.5)
    controller = mpc(G, Q=1, R=1, Np=5, Nc=3, umin=-1, umax=1)
    fuel = synth.fuel_mpc(G, box=1.0, umax=1.0, horizon=3)
    with pytest.raises(
        ExportError, match=r"FuelMpc does not leave as c: .* it solves a linear program .* pose the task as mpc"
    ):
        synth.export(fuel, "c", tmp_path)
    for option, message in (
        ({"umin": -1.0}, "umin: .* pose it with mpc"), ({"dtype": "float"}, "dtype: .* in other numbers than doubles"),
        ({"dtype": 3}, "dtype: "), ({"antiwindup": np.zeros((2, 1))}, "antiwindup: "), ({"inputs": 1.0}, "inputs: "),
        ({"acceptance": "x"}, "acceptance: .* fly this one"),
    ):  # fmt: skip
        with pytest.raises(ExportError, match=message):
            synth.export(controller, "c", tmp_path, **option)
    with pytest.raises(ExportError, match="no controller; pass what mpc returned"):
        synth.export(controller.problem, "c", tmp_path)
    assert not list(tmp_path.iterdir())
