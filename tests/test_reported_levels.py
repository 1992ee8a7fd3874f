"""Levels of plants that were reported or measured elsewhere, in coordinates that used to lose them."""

from __future__ import annotations

import json

import numpy as np
import pytest
from literature import DATA

from synth import Design, GeneralizedPlant, StateSpace, augw, c2d, hinfsyn, margin, system

CASES = {case["name"]: case for case in json.loads((DATA / "cases_reports.json").read_text())}


def assert_norm_on_a_grid(P: GeneralizedPlant, design: Design) -> None:
    """The loop, closed by hand, is stable and has the norm that the design claims, on a dense grid."""
    K, (n, *_) = design.controller, P.sizes
    E = np.linalg.inv(np.eye(K.ny) - K.D @ P.D22)
    Cu = np.hstack([E @ K.D @ P.C2, E @ K.C])
    Du = E @ K.D @ P.D21
    Y = np.hstack([P.C2, np.zeros((len(P.C2), K.n))]) + P.D22 @ Cu
    A = np.block([[P.A, np.zeros((n, K.n))], [np.zeros((K.n, n)), K.A]]) + np.vstack([P.B2 @ Cu, K.B @ Y])
    B = np.vstack([P.B1 + P.B2 @ Du, K.B @ (P.D21 + P.D22 @ Du)])
    C, D = np.hstack([P.C1, np.zeros((len(P.C1), K.n))]) + P.D12 @ Cu, P.D11 + P.D12 @ Du
    poles = np.linalg.eigvals(A)
    assert poles.real.max() < 0
    omega = np.concatenate([[0.0], np.geomspace(1e-9, 1e6, 3000), np.abs(poles.imag), np.abs(poles)])
    peak = max(np.linalg.norm(C @ np.linalg.solve(1j * w * np.eye(len(A)) - A, B) + D, 2) for w in omega)
    assert peak <= design.gamma * (1 + 1e-5)
    assert peak >= 0.99 * design.gamma


@pytest.mark.parametrize("name", CASES)
def test_reported_cases(name):
    case = CASES[name]
    expected = case["expected"]
    design = hinfsyn((*(case[M] for M in "ABCD"), case["dt"]), case["nmeas"], case["ncon"])
    reached, claim = expected["reachable_norm"], expected["slicot_claim"]
    assert design.gamma <= min(np.inf if reached is None else reached, claim * 1.001) * (1 + 1e-3)
    assert_norm_on_a_grid(design.plant, design)


def unit_four_block(G: StateSpace) -> GeneralizedPlant:
    return GeneralizedPlant.four_block(G, Wdist=1, Wnoise=1, Wout=1, Wact=1)


def flexible_axis() -> GeneralizedPlant:
    """1/s^2 + .2/(s^2 + .01 s + 1)."""
    A = np.zeros((4, 4))
    A[0, 1] = A[2, 3] = 1.0
    A[3, 2:] = -1.0, -0.01
    return unit_four_block(StateSpace(A, [[0.0], [1], [0], [1]], [[1.0, 0, 0.2, 0]], [[0.0]]))


@pytest.mark.parametrize("mirror", [None, (4.0, 3.0, 2.0, 1.0), (1.0, 1.0, 1.0, 1.0)])
def test_flexible_axis_exact_and_mirrored(mirror):
    P = flexible_axis()
    if mirror is not None:
        v = np.array(mirror)
        P = GeneralizedPlant.partition(P.system.transform(np.eye(4) - 2 * np.outer(v, v) / (v @ v)), 1, 1)
    design = hinfsyn(P)
    assert design.gamma == pytest.approx(2.571203, rel=1e-3)
    assert design.info.optimum == pytest.approx(2.571203, rel=1e-5)
    assert_norm_on_a_grid(P, design)
    asked = hinfsyn(P, gamma=3)
    assert asked.gamma <= 3
    assert_norm_on_a_grid(P, asked)


@pytest.mark.parametrize(("order", "level"), [(4, 79.206), (3, 18.84)])
def test_jordan_block_right_of_the_axis(order, level):
    J = StateSpace(0.5 * np.eye(order) + np.eye(order, k=1), np.eye(order)[:, -1:], np.eye(1, order), [[0.0]])
    assert hinfsyn(unit_four_block(J)).gamma == pytest.approx(level, rel=1e-3)


def test_mixed_sensitivity_of_a_slow_double_lag():
    case = CASES["mixsyn 1/(s+1e-3)^2 wb=1 eps=1e-3 W2=.1"]
    design = hinfsyn(tuple(case[M] for M in "ABCD"), 1, 1)
    assert design.gamma == pytest.approx(0.7881, rel=1e-3)


@pytest.mark.parametrize("dt", [0.0, 0.001, 0.01, 0.1, 0.2, 1.0, 10.0])
@pytest.mark.parametrize(("a", "level"), [(0.2, 4.355), (0.02, 4.454), (2e-3, 4.464), (2e-4, 4.466), (2e-7, 4.466)])
def test_dc_servo_with_a_quasi_integrating_weight(a, level, dt):
    """11.2/((s + .12)(s + 1e-5)), W1 = (s/1.5 + 20)/(s + a), W2 = 1; sampled as a whole by a map that keeps norms."""
    G = StateSpace([[-0.12, 0.0], [1.0, -1e-5]], [[11.2], [0.0]], [[0.0, 1.0]], [[0.0]])
    P = augw(G, StateSpace([[-a]], [[1.0]], [[20 - a / 1.5]], [[1 / 1.5]]), 1)
    if dt:
        P = GeneralizedPlant.partition(c2d(P.system, dt, "tustin"), 1, 1)
    design = hinfsyn(P)
    assert 0.995 * level <= design.gamma <= 1.001 * level


def orthogonal(seed: int, n: int) -> np.ndarray:
    return np.linalg.qr(np.random.default_rng(seed).standard_normal((n, n)))[0]


@pytest.mark.parametrize("seed", range(20))
def test_margins_of_turned_loops(seed):
    """PID (20 s^2 + 14 s + 4)/(s^3 (s + 10)) and PD (1.4 s + 1)/s^2."""
    A = np.diag([1.0, 1, 1], 1)
    A[3, 3] = -10
    pid = StateSpace(A, [[0.0], [0], [0], [1]], [[4.0, 14, 20, 0]], [[0.0]])
    found = margin(pid.transform(orthogonal(seed, 4)))
    assert found.phase_deg == pytest.approx(58.3995, rel=1e-5)
    assert found.gain_down == pytest.approx(0.15361, rel=1e-4)
    assert found.delay == pytest.approx(0.5131, rel=1e-4)
    assert margin(system([20, 14, 4], [1, 10, 0, 0, 0])).phase_deg == pytest.approx(found.phase_deg, rel=1e-6)
    pd = StateSpace([[0.0, 1], [0, 0]], [[0.0], [1]], [[1.0, 1.4]], [[0.0]])
    found = margin(pd.transform(orthogonal(seed, 2)))
    assert found.phase_deg == pytest.approx(65.156, rel=1e-5)
    assert found.gain_down == 0
