"""Loop shaping: literature values, SLICOT's controllers, random plants, and what happens with bad input."""

import json

import control
import numpy as np
import pytest
from literature import DATA
from scipy.signal import tf2ss

from synth.analysis.coprime import gang_of_four, ncfmargin, solutions
from synth.analysis.norms import hinfnorm, is_stable
from synth.errors import AssumptionError, InfeasibleError, ModelError, VerificationError
from synth.files import sealed_by_parts
from synth.lmi import coprime as program
from synth.synthesis.design import Design, to_dict
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn, observer_controller
from synth.systems.connect import feedback, series
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

KNOWN = 1e-6  # relative, of the optimal level
METHODS_AGREE = 1e-3  # relative, where the level is below 100


def tf(num, den) -> StateSpace:
    return StateSpace(*tf2ss(num, den))


def gain(D, dt=0.0) -> StateSpace:
    D = np.atleast_2d(np.asarray(D, dtype=float))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D, dt)


def random_system(seed: int, dt: float) -> StateSpace:
    """Up to 8 states, 3 inputs and outputs, half of them with a direct term, most of them unstable."""
    rng = np.random.default_rng(seed)
    n, m, p = (int(k) for k in rng.integers(1, [9, 4, 4]))
    A = rng.normal(size=(n, n))
    if dt:
        A *= rng.uniform(0.3, 1.5) / np.abs(np.linalg.eigvals(A)).max()
    D = rng.normal(size=(p, m)) * rng.integers(0, 2)
    return StateSpace(A, rng.normal(size=(n, m)), rng.normal(size=(p, n)), D, dt)


def companion(seed: int) -> StateSpace:
    """Badly scaled controller form, 3 to 8 poles over five decades; coefficients up to 1e20."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(3, 9))
    poles = -(10 ** rng.uniform(-2, 3, n)) * rng.choice([1, 1, 1, -0.02], n)
    num, den = np.poly(-(10 ** rng.uniform(-2, 3, n - 1))) * 10 ** rng.uniform(0, 2), np.poly(poles)
    A = np.eye(n, k=1)
    A[-1] = -den[:0:-1]
    return StateSpace(A, np.eye(n)[:, -1:], num[::-1][None], [[0.0]])


def skogestad_9_3() -> tuple[StateSpace, StateSpace]:
    """Skogestad and Postlethwaite (2005), example 9.3: G = 200 / ((10 s + 1)(0.05 s + 1)^2), W1 = (s + 2) / s."""
    return tf([200], np.polymul([10, 1], np.polymul([0.05, 1], [0.05, 1]))), tf([1, 2], [1, 0])


@pytest.mark.parametrize("method", ["lmi", "riccati"])
@pytest.mark.parametrize(
    ("G", "level"),
    [(tf([1], [1, 0]), np.sqrt(2)), (tf([1], [1, 0, 0]), np.sqrt(4 + 2 * np.sqrt(2)))],
    ids=["1/s", "1/s^2"],
)
def test_integrators_in_closed_form(G, level, method):
    design = ncfsyn(G, method=method)
    assert design.info.method == method
    assert design.info.optimum == pytest.approx(level, rel=KNOWN)
    assert design.info.level == 1.1 * design.info.optimum
    assert design.gamma == design.verified_norm <= design.info.level
    assert ncfmargin(G, design.controller, 1) == pytest.approx(1 / design.verified_norm, rel=1e-6)


def test_skogestad_example_9_3():
    G, W1 = skogestad_9_3()
    design = ncfsyn(G, W1)
    assert round(design.info.optimum, 2) == 2.34
    assert design.info.optimum == pytest.approx(2.338767, rel=KNOWN)
    assert design.controller.n == 5
    loop = feedback(G, StateSpace(*(getattr(design.controller, k) for k in "AB"), -design.controller.C, [[0.0]]))
    assert is_stable(loop)


def slicot(name: str) -> tuple[StateSpace, StateSpace, float]:
    data = json.loads((DATA / "slicot_loop_shaping.json").read_text())[name]
    plant, K = (StateSpace(*(data[key][k] for k in "ABCD"), data["dt"]) for key in ("plant", "controller"))
    return plant, K, data["factor"]


@pytest.mark.parametrize("name", ["SB10KD", "SB10ZD"])
def test_slicot_prints_the_same_discrete_controllers(name):
    """The controllers agree as transfer matrices to the four printed decimals."""
    G, K, factor = slicot(name)
    design = ncfsyn(G, gamma_factor=factor)
    for omega in np.linspace(0, np.pi, 7):
        theirs = K.frequency_response(omega)
        assert np.abs(design.controller.frequency_response(omega) - theirs).max() < 3e-3 * np.abs(theirs).max()


def test_slicot_optimal_continuous_controller_reaches_our_optimum():
    G, K, factor = slicot("SB10ID")
    design = ncfsyn(G)
    assert factor == 1
    assert design.info.optimum == pytest.approx(3.320916379195, rel=KNOWN)
    assert hinfnorm(gang_of_four(G).close(K))[0] == pytest.approx(design.info.optimum, rel=1e-4)


@pytest.mark.parametrize("dt", [0.0, 0.5])
@pytest.mark.parametrize("seed", [1, 4, 11])
def test_the_four_block_problem_solved_as_any_other_has_the_same_optimum(seed, dt):
    G = random_system(seed, dt)
    ours, theirs = ncfsyn(G), hinfsyn(gang_of_four(G), method="lmi")
    assert ours.info.optimum == pytest.approx(theirs.info.optimum, rel=1e-4)


def check_random(systems) -> None:
    """Stable, below the level, the same level by both methods."""
    for G in systems:
        design = ncfsyn(G, method="lmi")
        assert is_stable(design.closed_loop)
        assert hinfnorm(gang_of_four(G).close(design.controller))[0] <= design.info.level
        other = ncfsyn(G, method="riccati").info.optimum
        if other < 100:
            assert design.info.method == "lmi"
            assert design.info.optimum == pytest.approx(other, rel=METHODS_AGREE)


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_some_random_plants(dt):
    check_random(random_system(seed, dt) for seed in range(100, 104))


@pytest.mark.slow
@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_hundred_random_plants(dt):
    check_random(random_system(seed, dt) for seed in range(100))


@pytest.mark.slow
def test_badly_scaled_companion_forms():
    for seed in range(60):
        design = ncfsyn(companion(seed), method="lmi")
        other = ncfsyn(companion(seed), method="riccati").info.optimum
        assert design.gamma <= design.info.level
        if other < 100:
            assert design.info.method == "lmi"
            assert design.info.optimum == pytest.approx(other, rel=METHODS_AGREE)


def test_observer_form_is_the_printed_controller():
    """The observer form is K = [A + B F + H (C + D F), H; B'X, -D'], H = g^2 L'^-1 Z C' (Glover and McFarlane 1989)."""
    for seed in (2, 8, 20):
        G = random_system(seed, 0.0)
        X, Z, _ = s = solutions(G)
        g = 1.2 * np.sqrt(1 + s.coupling)
        F = -np.linalg.solve(np.eye(G.nu) + G.D.T @ G.D, G.D.T @ G.C + G.B.T @ X)
        L = (1 - g**2) * np.eye(G.n) + X @ Z
        H = g**2 * np.linalg.solve(L.T, Z @ G.C.T)
        printed = StateSpace(G.A + G.B @ F + H @ (G.C + G.D @ F), H, G.B.T @ X, -G.D.T)
        ours = observer_controller(G, s, g)
        for omega in (0.1, 1.0, 10.0):
            K = printed.frequency_response(omega)
            assert np.abs(ours.frequency_response(omega) - K).max() <= 1e-6 * np.abs(K).max()


def test_cayley_map_keeps_the_riccati_solutions_and_the_optimum():
    G = random_system(5, 0.0)
    tustin = c2d(G, 0.1, "tustin")
    for ours, theirs in zip(solutions(G)[:2], solutions(tustin)[:2], strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-6, atol=1e-8 * np.abs(theirs).max())
    assert ncfsyn(G).info.optimum == pytest.approx(ncfsyn(tustin).info.optimum, rel=KNOWN)


def test_fast_sampling_tends_to_the_continuous_optimum():
    G, W1 = skogestad_9_3()
    levels = [ncfsyn(c2d(G, dt), c2d(W1, dt, "tustin")).info.optimum for dt in (1e-2, 1e-3, 1e-5)]
    errors = np.abs(np.array(levels) / 2.338767 - 1)
    assert (np.diff(errors) < 0).all()
    assert errors[-1] < 1e-4


def test_level_at_or_below_the_optimum_is_refused_with_the_optimum():
    G, W1 = skogestad_9_3()
    best = ncfsyn(G, W1).info.optimum
    for level in (best, 0.9 * best, 0.5):
        with pytest.raises(InfeasibleError, match="not above the optimal level") as caught:
            ncfsyn(G, W1, gamma=level)
        assert caught.value.best == best
    design = ncfsyn(G, W1, gamma=3.0)
    assert design.gamma <= design.info.level == 3.0
    assert design.info.optimum < design.verified_norm <= 3.0


def test_a_level_that_touches_the_optimum_is_not_claimed():
    G = tf([1], [1, 0, 0])
    near = ncfsyn(G, gamma_factor=1 + 1e-5)
    assert near.gamma <= near.info.level
    with pytest.raises(VerificationError, match="ask for a larger gamma"):
        ncfsyn(G, gamma_factor=1 + 1e-9)


def test_weights_end_up_in_the_controller_and_in_the_file(tmp_path):
    G, W1 = skogestad_9_3()
    W2 = tf([1], [0.01, 1])
    design = ncfsyn(G, W1, W2)
    parts = design.shaping
    assert parts is not None
    for omega in (0.0123, 1.0, 77.0):
        K = design.controller.frequency_response(omega)
        product = [S.frequency_response(omega) for S in (W1, parts.Ks, W2)]
        np.testing.assert_allclose(K, product[0] @ product[1] @ product[2], rtol=1e-9)
    assert is_stable(design.plant.close(parts.Ks))
    shaped_plant = series(series(W1, G), W2)
    assert ncfmargin(shaped_plant, parts.Ks, 1) == pytest.approx(1 / design.verified_norm, rel=1e-6)

    again = Design.load(design.save(tmp_path / "design.json"))
    assert again.info == design.info
    assert again.shaping is not None
    assert again.controller.digest() == design.controller.digest()
    assert [getattr(again.shaping, k).digest() for k in ("W1", "W2", "Ks")] == [
        getattr(parts, k).digest() for k in ("W1", "W2", "Ks")
    ]
    design.save(tmp_path / "design.mat")
    K, CL, level, info = design
    assert isinstance(K, control.StateSpace)
    assert CL.ninputs == CL.noutputs == 2
    assert (level, info.optimum) == (design.gamma, design.info.optimum)


def test_a_file_with_another_weight_is_refused(tmp_path):
    data = to_dict(ncfsyn(*skogestad_9_3()))
    data["shaping"]["W1"]["D"] = [[2.0]]
    (tmp_path / "x.json").write_text(json.dumps(sealed_by_parts(data)))
    with pytest.raises(ModelError, match="W1 Ks W2"):
        Design.load(tmp_path / "x.json")


def test_weights_may_be_matrices_and_need_not_be_square():
    G = tf([1], [1, 1])
    design = ncfsyn(G, np.array([[1.0, 2.0]]), np.array([[1.0], [1.0], [1.0]]))
    assert (design.controller.ny, design.controller.nu) == (1, 1)
    assert ncfsyn(G, 2.0, 3.0).info.optimum == pytest.approx(ncfsyn(tf([6], [1, 1])).info.optimum, rel=1e-6)


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_a_plant_without_effect_leaves_nothing_to_do(dt):
    design = ncfsyn(StateSpace([[-0.5]], [[0.0]], [[1.0]], [[0.0]], dt))
    assert design.info.optimum == pytest.approx(1)
    assert hinfnorm(design.controller)[0] < 1e-9


def test_margins_of_matlabs_documentation():
    """Robust Control Toolbox, reference pages of ncfmargin and gapmetric."""
    P = tf([4], [1, -0.001])
    assert ncfmargin(P, gain(1.0)) == pytest.approx(0.7069, abs=5e-5)
    assert ncfmargin(P, gain(10.0)) == pytest.approx(0.0995, abs=5e-5)
    assert ncfmargin(tf([1, 2], [1, 5, 10]), tf([4.4], [1, 0])) == pytest.approx(0.1961, abs=5e-5)
    assert ncfmargin(P, gain(1.0), sign=1) == 0
    assert ncfmargin(P, gain(-1.0), sign=1) == ncfmargin(P, gain(1.0))


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_no_controller_beats_the_optimal_margin(dt):
    rng = np.random.default_rng(3)
    G = random_system(6, dt)
    design = ncfsyn(G)
    K = design.controller
    margins = [
        ncfmargin(G, StateSpace(K.A, K.B, K.C * f, K.D + g, dt), 1)
        for f, g in zip(rng.normal(1, 0.2, 40), rng.normal(0, 0.05, 40), strict=True)
    ]
    assert max(margins) > 0
    assert max(margins) <= (1 + 1e-6) / design.info.optimum


def test_an_unbelievable_program_gives_way_to_the_riccati_equations(monkeypatch):
    monkeypatch.setattr(program, "optimal_level", lambda G: (7.0, "optimal"))
    design = ncfsyn(tf([1], [1, 0]), method="lmi")
    assert design.info.method == "riccati"
    assert design.info.optimum == pytest.approx(np.sqrt(2))
    assert "7" in design.info.failures["lmi"]
    assert "'lmi' was not believed" in design.info.status
    assert "7" in repr(design)


def test_hidden_unstable_modes_are_named():
    unreached = StateSpace(np.diag([1.0, -2.0]), [[0.0], [1.0]], [[1.0, 1.0]], [[0.0]])
    with pytest.raises(AssumptionError, match="eigenvalue 1 ") as caught:
        ncfsyn(unreached)
    assert "stabilisable" in caught.value.assumption
    # the weight's integrator is cancelled by a zero of the plant
    with pytest.raises(AssumptionError, match="no sensor sees"):
        ncfsyn(tf([1, 0], [1, 2, 1]), tf([1], [1, 0]))


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((tf([1], [1, 1]),), {"method": "auto"}, "method is 'auto'"),
        ((tf([1], [1, 1]),), {"gamma_factor": 1.0}, "gamma_factor is 1.0"),
        ((tf([1], [1, 1]),), {"gamma": np.nan}, "gamma is nan"),
        ((tf([1], [1, 1]), np.eye(2)), {}, "W1 is 2 x 2"),
        ((tf([1], [1, 1]), None, np.eye(2)), {}, "W2 is 2 x 2"),
        ((tf([1], [1, 1]), gain(1.0, 0.1)), {}, "timebases"),
        ((tf([1], [1, 1]), [[np.inf]]), {}, r"W1\[0, 0\] is inf"),
        (((np.full((1, 1), np.nan), [[1]], [[1]], [[0]]),), {}, r"A\[0, 0\] is nan"),
    ],
)
def test_bad_input_is_named(arguments, options, message):
    with pytest.raises(ModelError, match=message):
        ncfsyn(*arguments, **options)


def test_margin_of_bad_input_is_named():
    with pytest.raises(ModelError, match="sign is 0"):
        ncfmargin(tf([1], [1, 1]), gain(1.0), sign=0)
    with pytest.raises(ModelError, match="not well posed"):
        ncfmargin(gain(1.0), gain(-1.0))
