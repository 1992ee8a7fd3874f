"""Controllers reduced in their loops: no loop lost, orders chosen by what the loop loses, everything measured anew."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from families import CLASSES, double_integrator_axes, four_block, integrating, modal_form, sampled
from literature import cubesat_pecorilla2024

from synth import (
    Design,
    InfeasibleError,
    ModelError,
    StateSpace,
    SynthError,
    VerificationError,
    augw,
    c2d,
    gang_of_four,
    hinfnorm,
    hinfsyn,
    lqg,
    mixsyn,
    musyn,
    ncfsyn,
    reduce,
    sdhinfsyn,
    system,
)
from synth.analysis.norms import is_stable, judge

MAKES = (*CLASSES, lambda rng: four_block(modal_form(rng), rng), lambda rng: four_block(sampled(rng), rng))


@pytest.fixture(scope="module")
def cubesat() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


def measured(design: Design) -> float:
    """The norm of the loop of a design, from its plant and controller."""
    return hinfnorm(design.plant.close(design.closing))[0]


def test_the_cubesat_controller_needs_three_states(cubesat):
    found = reduce(cubesat, loss=1e-3)
    assert found.controller.n == 3
    assert measured(found) <= 1.001 * cubesat.gamma
    np.testing.assert_allclose(found.gamma, measured(found), rtol=1e-6)
    assert "from order 6 to 3" in found.info.status
    with_two = reduce(cubesat, 2)
    assert 1.001 * cubesat.gamma < with_two.gamma == pytest.approx(measured(with_two), rel=1e-6)


def test_it_leaves_and_comes_back_as_every_design(cubesat, tmp_path):
    found = reduce(cubesat, 3)
    again = Design.load(found.save(tmp_path / "reduced.json"))
    assert again.controller.n == 3
    assert again.info.status == found.info.status
    assert found.certify(upper=1.001 * cubesat.gamma).upper <= 1.001 * cubesat.gamma


@pytest.mark.parametrize("method", ["truncate", "matchdc", "coprime"])
def test_the_units_and_coordinates_of_the_plant_change_nothing(cubesat, method):
    P, rng = cubesat.plant, np.random.default_rng(2)
    T = np.linalg.qr(rng.standard_normal((6, 6)))[0] @ np.diag(10.0 ** rng.uniform(-2, 2, 6))
    turned = replace(
        P, A=np.linalg.solve(T, P.A @ T), B1=np.linalg.solve(T, P.B1), B2=np.linalg.solve(T, P.B2), C1=P.C1 @ T,
        C2=P.C2 @ T,
    )  # fmt: skip
    K = cubesat.controller.transform(10 * np.linalg.qr(rng.standard_normal((6, 6)))[0])
    there = replace(cubesat, plant=turned, controller=K, closed_loop=turned.close(K))
    for order in (2, 3):
        found, expected = (reduce(design, order, method=method) for design in (there, cubesat))
        np.testing.assert_allclose(found.gamma, expected.gamma, rtol=1e-5)
    if method == "coprime":  # for which units are weights
        return
    u, y = 10.0 ** rng.uniform(-3, 3, 3), 10.0 ** rng.uniform(-3, 3, 6)
    there = replace(P, B2=P.B2 * u, D12=P.D12 * u, C2=P.C2 * y[:, None], D21=P.D21 * y[:, None],
                    D22=P.D22 * np.outer(y, u))  # fmt: skip
    K = cubesat.controller
    K = StateSpace(K.A, K.B / y, K.C / u[:, None], K.D / np.outer(u, y), K.dt)
    found = reduce(replace(cubesat, plant=there, controller=K, closed_loop=there.close(K)), 3, method=method)
    np.testing.assert_allclose(found.gamma, reduce(cubesat, 3, method=method).gamma, rtol=1e-5)


def test_integrators_and_continuous_designs():
    """Mixed sensitivity with a quasi-integrating weight: the controller keeps its slow pole, and its loop the level."""
    design = mixsyn(system([200], [0.025, 1.0025, 10.1, 1]), system([0.667, 10], [1, 1e-3]), 1.0)
    found = reduce(design, loss=1e-2)
    assert found.controller.n < design.controller.n
    assert measured(found) <= 1.01 * design.gamma
    slow = [np.abs(each.controller.poles()).min() for each in (design, found)]
    np.testing.assert_allclose(slow[1], slow[0], rtol=0.5)


@pytest.mark.parametrize("dt", [0.0, 0.05])
def test_integrators_of_controllers_stay(dt):
    """A PID with filters on a flexible body: whatever z is, the loop goes on to be exact at rest."""
    G = system([1.0], np.polymul([1, 0.5], [1, 0.2, 4]))
    K = system([-0.5], [1, 0]) * system([1, 0.5], [0.1, 1]) * system([1, 0.2, 4], np.polymul([1, 4, 8], [0.02, 1]))
    G, K = (c2d(H, dt) if dt else H for H in (G, K))
    P = gang_of_four(G)
    assert is_stable(P.close(K))
    for method in ("auto", "truncate", "matchdc"):
        found = reduce(K, 3, plant=P, method=method)
        assert np.abs(found.controller.poles() - (1 if dt else 0)).min() < 1e-9
        assert np.abs(P.close(found.controller).dcgain()[:1, 0]).max() < 1e-6  # of the output, with its disturbance
    assert reduce(K, loss=0.05, plant=P).controller.n < K.n
    with pytest.raises(InfeasibleError, match="order is 0"):
        reduce(K, 0, plant=P)


def test_loop_shaping_designs_keep_their_weights():
    G = c2d(double_integrator_axes(np.random.default_rng(1)), 0.1)
    design = ncfsyn(G, W1=2.0)
    assert design.shaping is not None
    found = reduce(design, loss=0.3)
    assert found.shaping is not None
    assert found.shaping.Ks.n < design.shaping.Ks.n
    assert found.controller.n == found.shaping.controller.n
    assert measured(found) <= 1.3 * design.gamma


def test_sampled_data_designs_are_judged_between_the_samples():
    G = system([1], [1, 0.05, 1])
    P = augw(G, integrating(np.random.default_rng(0), 0.1, 1e-3), 0.3)
    plant = StateSpace(P.A, np.hstack([P.B1, P.B2]), np.vstack([P.C1, P.C2]), 0 * P.system.D)
    design = sdhinfsyn(plant, 0.2, 1, 1, tol=0.05)
    found = reduce(design, loss=0.1)
    assert found.intersample is not None
    assert found.gamma == pytest.approx(found.intersample.upper, rel=1e-6)
    assert found.gamma <= 1.1 * design.gamma


def test_what_cannot_be_is_refused_by_name(cubesat):
    for call, words in (
        (lambda: reduce(cubesat), "order"),
        (lambda: reduce(cubesat, 3, loss=0.1), "loss"),
        (lambda: reduce(cubesat, error=0.1), "error"),
        (lambda: reduce(cubesat, 3, input_weight=1.0), "input_weight"),
        (lambda: reduce(cubesat, 7), "order"),
        (lambda: reduce(cubesat, loss=-0.1), "loss"),
    ):
        with pytest.raises(ModelError, match=words):
            call()
    unstable = hinfsyn(four_block(system([1], [1, 0, -1, 0]), np.random.default_rng(0)))
    with pytest.raises(InfeasibleError, match="loss=") as caught:
        reduce(unstable, 0)
    assert caught.value.best == unstable.gamma
    assert reduce(cubesat, 6) is cubesat or reduce(cubesat, 6).gamma <= cubesat.gamma * (1 + 1e-6)


def test_states_that_do_nothing_are_all_left_out(cubesat):
    K = cubesat.controller
    idle = StateSpace(0.5 * np.eye(3), np.zeros((3, K.nu)), np.ones((K.ny, 3)), np.zeros_like(K.D), K.dt)
    design = replace(cubesat, controller=K + idle)
    for order in (3, 7, 8):
        found = reduce(design, order)
        assert found.controller.n <= min(order, 6)
        np.testing.assert_allclose(found.gamma, reduce(cubesat, min(order, 6)).gamma, rtol=1e-6)


def test_controllers_that_were_designed_elsewhere(tmp_path):
    """An LQG regulator of a flexible body, judged by the four transfer functions of its loop."""
    G = system([0.2, 0.01, 1], [0.2, 0.01, 1.2, 0, 0])
    K = lqg(G, np.diag([1.0] * 4 + [1.0]), np.diag([1.0] * 4 + [1.0]))
    P = gang_of_four(G)
    full = hinfnorm(P.close(K))[0]
    found = reduce(K, loss=0.1, plant=P)
    assert found.controller.n < 4
    assert measured(found) <= 1.1 * full * (1 + 1e-6)
    assert Design.load(found.save(tmp_path / "reduced.json")).info.method == "given"
    with pytest.raises(VerificationError, match="unstable"):
        reduce(-system(K), 2, plant=P)
    for call in (
        lambda: reduce(K, 2, plant=G), lambda: reduce(found, 2, plant=P), lambda: reduce(K, error=0.1, plant=P),
        lambda: reduce(c2d(system(K), 0.1), 2, plant=P),
    ):  # fmt: skip
        with pytest.raises(ModelError):
            call()


def test_no_loss_leaves_the_design_or_one_as_good(cubesat):
    found = reduce(cubesat, loss=0.0)
    assert found.gamma <= cubesat.gamma


def test_mu_designs_are_not_judged_by_their_norm():
    P = augw(system([1.0], [1.0, 1.0]), 1.0, 0.1)
    with pytest.raises(ModelError, match="MuDesign"):
        reduce(musyn(P.system, 1, 1, [(1, 2)], iterations=1), 1)


@pytest.mark.parametrize(
    ("makes", "count"),
    [pytest.param(MAKES[::5], 1, id="few"), pytest.param(MAKES, 10, id="100", marks=pytest.mark.slow)],
)
def test_no_reduced_loop_is_unstable(makes, count):
    """Of every family, every order and method: what is returned is stable and has the norm that it says it has."""
    tried = 0
    for make in makes:
        for seed in range(count):
            try:
                design = hinfsyn(make(np.random.default_rng([17, seed])))
            except SynthError:
                continue
            tried += 1
            lowest = reduce(design, loss=0.05)
            assert lowest.gamma <= 1.05 * design.gamma
            for method in ("auto", "truncate", "matchdc", "coprime"):
                for order in range(design.controller.n):
                    try:
                        found = reduce(design, order, method=method)
                    except InfeasibleError:
                        assert order < lowest.controller.n or method != "auto"
                        continue
                    assert found.controller.n == order
                    loop = design.plant.close(found.controller)
                    assert is_stable(loop)
                    norm, again = hinfnorm(loop)[0], judge(design.plant, found.controller)[1]
                    assert norm <= found.gamma * (1 + 1e-6)
                    np.testing.assert_allclose(found.gamma, again.norm, rtol=1e-9)
                    assert norm >= found.gamma * (1 - 1e-5) or again.rounding > 1e-5 * norm
                    if method == "auto" and order < lowest.controller.n:
                        assert found.gamma > 1.05 * design.gamma * (1 - 1e-6)
    assert tried >= 0.9 * len(makes) * count
