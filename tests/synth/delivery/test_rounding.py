"""What rounding does is below its bound, measured on the compiled C, and the bound is not far above."""

import json

import numpy as np
import pytest
from literature import cubesat_pecorilla2024
from replayed import NEAR, TYPES, measured, random_controller

import synth
from synth.__main__ import main
from synth.errors import ModelError, NumericalError

INTEGRATOR = synth.StateSpace([[1.0]], [[0.1]], [[1.0]], [[2.0]], 0.1)
LAG = synth.c2d(synth.system([-1], [1, 1]), 0.1)


@pytest.mark.parametrize("precision", TYPES)
def test_bound_of_the_cubesats_controller(precision, tmp_path):
    design, Y = synth.hinfsyn(cubesat_pecorilla2024()), np.array([0.5] * 3 + [0.05] * 3)
    found = synth.rounding(design, inputs=Y, precision=precision)
    off = measured(design, Y, precision, tmp_path, 20_000)
    assert (off <= found.command).all()
    assert (found.command <= NEAR * off).all()
    looped = synth.rounding(design, inputs=Y, precision=precision, plant=design.plant)
    assert looped.output is not None
    assert (looped.output > 0).all()


@pytest.mark.slow
@pytest.mark.parametrize("precision", TYPES)
def test_bounds_of_fifty_random_controllers_over_a_million_steps(precision, tmp_path):
    ratios = []
    for seed in range(50):
        K = random_controller(seed)
        Y = 10 ** np.random.default_rng(seed).uniform(-3, 3, K.nu)
        found = synth.rounding(K, inputs=Y, precision=precision)
        off = measured(K, Y, precision, tmp_path / str(seed), 1_000_000, seed)
        assert (off <= found.command).all(), seed
        ratios.append((found.command / off).max())
    assert max(ratios) <= NEAR


def looped(K, G, bounds, precision, seed):
    """The largest |u - exact u| and |y - exact y| of scalar loops under square waves that keep y and u in bounds."""
    rng, S = np.random.default_rng(seed), 200
    low, high = (np.float32, float) if precision == "float32" else (float, np.longdouble)
    period, size = rng.integers(20, 1000, S), rng.uniform(0.1, 1, S) * 0.45 * bounds[0]
    (A, B, C, D), (Ap, Bp, Cp, _) = (tuple(M.item() for M in system.matrices) for system in (K, G))
    a, b, c, d = (low(M) for M in (A, B, C, D))
    x, p, X, P = np.zeros(S, low), *np.zeros((3, S), high)
    worst_u = worst_y = largest_u = largest_y = 0.0
    for k in range(4000):
        w = size * np.sign(np.sin(2 * np.pi * k / period))
        y, Y = high(Cp) * p + w, high(Cp) * P + w
        read = y.astype(low)
        u, U = c * x + d * read, high(C) * X + high(D) * Y
        x, X = a * x + b * read, high(A) * X + high(B) * Y
        p, P = high(Ap) * p + high(Bp) * u.astype(high), high(Ap) * P + high(Bp) * U
        worst_u, worst_y = max(worst_u, abs(u - U).max()), max(worst_y, abs(y - Y).max())
        largest_y = max(largest_y, abs(y).max(), abs(Y).max())
        largest_u = max(largest_u, abs(u).max(), abs(U).max())
    assert largest_y <= bounds[0]
    assert largest_u <= bounds[1]
    return float(worst_u), float(worst_y)


@pytest.mark.parametrize("precision", TYPES)
def test_an_integrator_is_bounded_in_its_loop(precision):
    found = synth.rounding(INTEGRATOR, inputs=2.0, commands=3.0, plant=LAG, precision=precision)
    u, y = looped(INTEGRATOR, LAG, (2.0, 3.0), precision, 1)
    assert u <= found.command.item() <= NEAR * u
    assert y <= found.output.item() <= NEAR * y


def test_an_integrator_alone_has_no_bound():
    with pytest.raises(ModelError, match="pass plant"):
        synth.rounding(INTEGRATOR, inputs=1.0)
    with pytest.raises(ModelError, match="pass commands"):
        synth.rounding(INTEGRATOR, inputs=1.0, plant=LAG)
    with pytest.raises(NumericalError, match="not proved stable"):
        synth.rounding(INTEGRATOR, inputs=1.0, commands=1.0, plant=-LAG)


def test_bounds_scale_with_powers_of_two_and_hold_the_commands():
    K = random_controller(3)
    one, eight = (synth.rounding(K, inputs=y) for y in (1.0, 8.0))
    np.testing.assert_allclose(eight.command, 8 * one.command, rtol=1e-12)
    np.testing.assert_allclose(eight.commands, 8 * one.commands, rtol=1e-12)
    np.testing.assert_allclose(one.command, one.coefficients + one.arithmetic, rtol=1e-8)


def test_coefficients_of_slow_poles_are_told_from_those_they_became():
    """u of a lag and of the one that its rounded pole makes: sum of |r^k - R^k| is the difference of 1/(1 - r)."""
    for pole in (1 - 1e-4, 1 - 1e-5, 1 - 3e-6):
        T = np.array([[1.0, 0.5, 0.25], [0.0, 1.0, 0.5], [0.0, 0.0, 1.0]])  # its entries and those of T^-1 are exact
        A = np.linalg.inv(T) @ np.diag([pole, 0.5, 0.25]) @ T
        K = synth.StateSpace(A, np.linalg.inv(T)[:, :1], T[:1], [[0.0]], 1.0)
        became = float(np.float32(A[0, 0]))
        expected = abs(1 / (1 - A[0, 0]) - 1 / (1 - became))
        found = synth.rounding(K, inputs=1.0)
        np.testing.assert_allclose(found.coefficients, expected, rtol=0.05)


def test_the_result_says_whether_a_limit_can_be_reached():
    K = synth.StateSpace([[0.5]], [[1.0]], [[1.0]], [[0.0]], 0.1)  # |u| <= 2
    assert "until a command reaches its limit" in str(synth.rounding(K, inputs=1.0, umin=-1, umax=1))
    assert "no command reaches its limit" in str(synth.rounding(K, inputs=1.0, umin=-3, umax=3))


def test_exported_files_state_the_bound(tmp_path):
    K = random_controller(3)
    header, _ = synth.export(K, "c", tmp_path, dtype="float", inputs=2.0)
    text = " ".join(header.read_text().replace("*", " ").split())
    assert str(synth.rounding(K, inputs=2.0)) in text
    header, _ = synth.export(INTEGRATOR, "c", tmp_path, name="other", umin=-1, umax=1, antiwindup=[[0.5]])
    assert "not bounded: the controller is not proved stable by itself" in " ".join(header.read_text().split())


@pytest.mark.parametrize("field", ["A", "B", "C", "D"])
def test_synth_verify_refuses_a_changed_coefficient(field, tmp_path, capsys):
    """One unit in the last place of one number of the controller in the design's file."""
    path = tmp_path / "design.json"
    synth.hinfsyn(cubesat_pecorilla2024()).save(path)
    assert main(["verify", str(path)]) == 0
    data = json.loads(path.read_text())
    row = data["controller"][field][0]
    row[0] = float(np.nextafter(row[0], np.inf))
    path.write_text(json.dumps(data))
    assert main(["verify", str(path)]) != 0
    assert "sha256" in capsys.readouterr().err


def test_large_controllers_are_exported_at_once_and_bounded_when_asked(tmp_path):
    """A bound of 300 states takes a minute: the header says that none was proved, and how to have one."""
    n = 45
    K = synth.StateSpace(0.5 * np.eye(n), np.ones((n, 1)), np.ones((1, n)), [[0.0]], 1.0)
    header = synth.export(K, "c", tmp_path)[0].read_text()
    assert "not bounded unasked" in " ".join(header.replace("*", " ").split())
    header = synth.export(K, "c", tmp_path, inputs=1.0, force=True)[0].read_text()
    assert "|u - exact u| <=" in " ".join(header.replace("*", " ").split())
