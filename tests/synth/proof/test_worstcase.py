"""Worst-case gains and stability margins over a box: published figures, both sides, and no proof against a sample."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import cubesat_pecorilla2024
from uncertain import cubesat, de_gaston_safonov, flexible_satellite, random_loop, two_masses

import synth
from synth import ModelError, UncertainSystem, VerificationError, robstab, stability_margin, ureal, wcgain, worst_gain
from synth.analysis.worstcase import Numbers
from synth.proof.boxcertificate import BoxCertificate, from_dict, to_dict


def unstable(G: UncertainSystem, result) -> bool:
    poles = G.at(result.parameters, within=False).poles()
    return (np.abs(poles).max() if G.discrete else 1 + poles.real.max()) >= 1 - 1e-6


def test_the_margin_of_de_gaston_and_safonov():
    r = robstab(de_gaston_safonov(), tol=1e-6)
    assert 3.41739 < r.lower < r.upper < 3.41740
    assert unstable(de_gaston_safonov(), r)
    assert r.eigenvalue.imag == pytest.approx(r.frequency)
    r.certificate.check()


def test_the_two_masses_of_matlab():
    G = two_masses()
    r = stability_margin(G)
    assert 2.8862 < r.lower < r.upper < 2.8864
    g = wcgain(G, tol=2e-6)
    assert 1.04750 < g.lower < g.upper < 1.04751
    assert g.norm == pytest.approx(g.lower, rel=1e-6)


@pytest.mark.parametrize(
    ("percentage", "modes", "channels", "sampled"),
    [(20, 2, 1, 1.26208898), (30, 2, 1, 1.49456780), (30, 2, 2, 7.11861047), (20, 3, 1, 1.2544049)],
)
def test_the_flexible_satellite(percentage, modes, channels, sampled):
    """Sampled worst cases by another code."""
    G = flexible_satellite(percentage, modes, channels)
    r = worst_gain(G)
    assert sampled * (1 - 1e-7) < r.lower < r.upper < sampled * (1 + 1e-4)
    assert r.gap < 1.1e-5
    assert not r.note
    assert synth.hinfnorm(G.at(r.parameters))[0] == pytest.approx(r.norm)
    r.certificate.check(G)


@pytest.mark.parametrize("percentage", [10, pytest.param(30, marks=pytest.mark.slow)])
def test_many_channels(percentage):
    """The CubeSat's design of 15 x 9 channels over its inertia box, sampled."""
    design = synth.hinfsyn(cubesat_pecorilla2024(), method="riccati")
    loop = cubesat(percentage).close(design)
    r = worst_gain(loop)
    assert design.gamma < r.lower < r.upper < r.lower * (1 + 2e-5)
    assert r.norm == pytest.approx(r.lower, rel=1e-6)
    assert max(synth.hinfnorm(H)[0] for _, H in loop.gridded(2)) < r.upper


def test_a_design_that_is_unstable_in_its_box_is_refuted_with_the_parameters():
    G = flexible_satellite(60)
    r = worst_gain(G)
    assert (r.lower, r.upper, r.certificate) == (np.inf, np.inf, None)
    assert unstable(G, r)
    assert r.eigenvalue.real >= 0
    assert "unstable" in str(r)
    assert stability_margin(G).upper < 1


@pytest.mark.parametrize("seed", range(12))
def test_no_proof_is_contradicted_by_a_sample(seed):
    G = random_loop(seed)
    check_against_samples(G, 40)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 150))
def test_no_proof_of_many_loops_is_contradicted_by_a_sample(seed):
    """Poles at twenty thousand points of the box, and gains there at frequencies around that of the worst."""
    G, count = random_loop(seed), 20_000
    check_against_samples(G, 20)
    gain, margin = worst_gain(G), stability_margin(G)
    rng, N = np.random.default_rng(seed), Numbers(G, list(G.parameters.values()))
    t = rng.uniform(-1, 1, size=(count, len(N.nominal)))
    t[: count // 2] = np.where(rng.random(t[: count // 2].shape) < 0.5, np.sign(t[: count // 2]), t[: count // 2])
    assert growths(N, t * min(margin.lower, 1e3)).max() < 1e-9
    if np.isfinite(gain.upper):
        w = (np.tan(gain.frequency * G.dt / 2) if G.discrete else gain.frequency) or 1.0
        assert gains(N, t, w * 10 ** rng.uniform(-1, 1, size=count)).max() <= gain.upper


def matrices(N: Numbers, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    weights = np.array([(N.values(x) ** N.powers).prod(axis=1) for x in t])
    return np.tensordot(weights, N.E, 1), np.tensordot(weights, N.S, 1)


def growths(N: Numbers, t: np.ndarray) -> np.ndarray:
    E, S = matrices(N, t)
    poles = np.linalg.eigvals(np.linalg.solve(E, S[:, : N.n, : N.n]))
    return (np.abs(poles) - 1 if N.discrete else poles.real).max(axis=1)


def gains(N: Numbers, t: np.ndarray, w: np.ndarray) -> np.ndarray:
    (E, S), n = matrices(N, t), N.n
    M = N.z(w)[:, None, None] * E - S[:, :n, :n]
    return np.linalg.norm(S[:, n:, :n] @ np.linalg.solve(M, S[:, :n, n:]) + S[:, n:, n:], 2, axis=(1, 2))


def check_against_samples(G: UncertainSystem, count: int) -> None:
    gain, margin = worst_gain(G), stability_margin(G)
    assert gain.lower <= gain.upper
    assert margin.lower <= margin.upper
    assert margin.certificate is not None
    margin.certificate.check()
    if np.isfinite(margin.upper):
        assert unstable(G, margin)
    if gain.certificate is None:
        assert unstable(G, gain)
        assert margin.upper <= 1 + 1e-6
        return
    gain.certificate.check()
    assert gain.norm == pytest.approx(gain.lower, rel=1e-6)
    assert gain.gap < 1e-3
    worst = max(synth.hinfnorm(H)[0] for _, H in (*G.sample(count, 1), *G.gridded(2)))
    assert worst <= gain.upper


@settings(max_examples=3, deadline=None)
@given(st.integers(0, 30), st.floats(-3, 3), st.floats(-3, 3), st.floats(-2, 2))
def test_units_do_not_matter(seed, of_signals, of_time, of_states):
    """Signals, time (continuous), states and parameters in other units."""
    G = random_loop(seed)
    k, t = 10.0**of_signals, 1.0 if G.discrete else 10.0**of_time
    T = np.diag(10.0 ** np.linspace(-of_states, of_states, G.n))
    Ti = np.linalg.inv(T)
    H = UncertainSystem(Ti @ G.E @ T, t * (Ti @ G.A @ T), t * (Ti @ G.B), k * (G.C @ T), k * G.D, G.dt)
    a, b = worst_gain(G), worst_gain(H)
    if np.isfinite(a.upper):
        assert b.upper / k == pytest.approx(a.upper, rel=1e-4)
    else:
        assert not np.isfinite(b.upper)
    assert stability_margin(H).lower == pytest.approx(stability_margin(G).lower, rel=1e-4)


@pytest.mark.parametrize("unit", [1e-60, 1e30])
def test_gains_of_any_size(unit):
    """Several channels, so that powers of the level would leave the doubles."""
    G = flexible_satellite(20, channels=2)
    r = worst_gain(UncertainSystem(G.E, G.A, G.B, G.C * unit, G.D * unit))
    assert r.upper / unit == pytest.approx(worst_gain(G).upper, rel=1e-6)
    assert r.gap < 1.1e-5


def test_algebraic_loops_and_the_gain_at_infinity():
    a, b = ureal("a", 0.5, percentage=20), ureal("b", 1.0, percentage=10)
    G = UncertainSystem(A=-1.0, B=0.1 * b, C=1.0, D=a)  # a + 0.1 b/(s + 1)
    L = G.feedback(-1.0)
    assert L.n == 2
    r = worst_gain(L)
    assert r.lower == pytest.approx((0.6 + 0.11) / (1 - 0.71), rel=1e-5)
    assert r.parameters == pytest.approx({"a": 0.6, "b": 1.1})
    assert r.gap < 2e-5
    high = worst_gain(UncertainSystem(A=-1.0, B=-0.1 * b, C=1.0, D=a))  # largest where the frequency is
    assert 0.6 * (1 - 1e-4) < high.lower < 0.6 < high.upper < 0.6 * (1 + 1e-4)
    assert stability_margin(L).upper == pytest.approx(0.4 / 0.11)


def test_tustins_map_keeps_gains_and_margins():
    G = flexible_satellite(20)
    H = synth.c2d(G, 0.1, "tustin")
    assert worst_gain(H).lower == pytest.approx(worst_gain(G).lower, rel=1e-9)
    assert worst_gain(H).gap < 1.1e-5
    assert stability_margin(H).upper == pytest.approx(stability_margin(G).upper, rel=1e-6)


def test_a_mass_that_may_vanish_ends_stability():
    J = ureal("J", 1.0, plusminus=0.5)
    r = stability_margin(UncertainSystem(J, -1.0, 1.0, 1.0))
    assert r.lower < 2.0 <= r.upper * (1 + 1e-9)
    assert r.gap < 1e-4


@pytest.mark.parametrize("half", [1e-2, 1e-3])
def test_a_narrow_island_of_instability_is_found(half):
    """Damping that is negative in a small part of the range, where no sample is."""
    p = ureal("p", 0.5, range=(0, 1))
    G = UncertainSystem(A=[[0, 1], [-1, half**2 - (p - 0.37) ** 2]], B=[0, 1], C=[1, 0])
    r = worst_gain(G)
    assert r.lower == np.inf
    assert abs(r.parameters["p"] - 0.37) <= half
    m = stability_margin(G)
    assert m.upper == pytest.approx((0.5 - 0.37 - half) / 0.5)
    assert m.gap < 2e-5


def test_loops_at_the_edge_of_what_there_is():
    q = ureal("q", 1.0, range=(1.0, 2.0))  # one-sided
    r = worst_gain(UncertainSystem(A=-q, B=1.0, C=1.0))
    assert (r.lower, r.frequency) == (pytest.approx(1.0), 0.0)
    nothing = worst_gain(UncertainSystem(A=-q, B=0.0, C=1.0))
    assert (nothing.lower, nothing.upper < 1e-100) == (0.0, True)
    nothing.certificate.check()
    undamped = worst_gain(UncertainSystem(A=[[0, 1], [-q, 0]], B=[0, 1], C=[1, 0]))
    assert (undamped.lower, undamped.eigenvalue, undamped.certificate) == (np.inf, 1j, None)
    with pytest.raises(ModelError, match="no states"):
        worst_gain(UncertainSystem(A=np.zeros((0, 0)), B=np.zeros((0, 1)), C=np.zeros((1, 0)), D=[[q]]))


def test_nothing_unstable_up_to_a_hundred_times_the_box():
    k = ureal("k", 1.0, range=(0.9, 1.1))
    r = stability_margin(UncertainSystem(A=-1.0, B=k, C=k))
    assert (r.lower, r.upper, r.parameters) == (100.0, np.inf, {})
    assert "none found" in str(r)
    r.certificate.check()


def test_not_proved_is_not_called_unstable():
    G = flexible_satellite(20)
    r = worst_gain(G, boxes=1)
    assert r.certificate is None or r.note
    many = [ureal(f"p{k}", 0.0, plusminus=0.01) for k in range(9)]
    A = -np.eye(9).astype(object) * 2
    for k, p in enumerate(many):
        A[k, (k + 1) % 9] = A[k, k] * 0 + p + p**3
    r = worst_gain(UncertainSystem(A=A, B=np.ones((9, 1)), C=np.ones((1, 9))))
    assert r.upper == np.inf
    assert r.lower > 0
    assert "would divide" in r.note
    assert "no upper bound proved" in str(r)
    assert "unstable" not in str(r)


def test_a_plant_and_a_design():
    m = ureal("m", 1.0, percentage=10)
    P = synth.augw(synth.system([1], [1, 0.2, 1]), synth.system([0.5], [1, 0.05]), 0.1)
    design = synth.hinfsyn(P.system, 1, 1)
    M = P.system.matrices
    E = np.eye(len(M.A)).astype(object)
    E[0, 0] = m * E[0, 0]
    plant = UncertainSystem(E, *M)
    r = worst_gain(plant, design)
    assert r.lower >= design.gamma * (1 - 1e-4)
    assert r.gap < 1e-3
    assert worst_gain(plant.close(design)).upper == r.upper


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda G: worst_gain(synth.system(1, [1, 1])), "loop"),
        (lambda G: worst_gain(G.close(1.0) if G.nu > 1 else G, 2.0), "controller"),
        (lambda G: worst_gain(UncertainSystem(A=-1, B=1, C=1)), "no uncertain parameters"),
        (lambda G: worst_gain(G, tol=0), "tol"),
        (lambda G: stability_margin(G, boxes=0), "boxes"),
    ],
)
def test_what_is_wrong_is_named(call, message):
    G = UncertainSystem(ureal("J", 1.0, percentage=10), -1, 1, 1)
    with pytest.raises(ModelError, match=message):
        call(G)


@pytest.mark.parametrize("quantity", [worst_gain, stability_margin])
def test_a_certificate_is_proved_again_from_its_file(quantity, tmp_path):
    G = flexible_satellite(20)
    c = quantity(G).certificate
    assert isinstance(c, BoxCertificate)
    path = c.save(tmp_path / "c.json")
    found = BoxCertificate.load(path)
    assert to_dict(found) == to_dict(c)
    found.check(G)
    with pytest.raises(VerificationError, match="another loop"):
        found.check(flexible_satellite(10))
    for change in ({"level": c.level * (1.01 if quantity is stability_margin else 0.99)}, {"script": c.script[:-1]},
                   {"reached": c.reached * (1.01 if quantity is worst_gain else 0.99)}, {"edges": c.edges[::-1]},
                   {"point": dict.fromkeys(c.point, 1.0)}):  # fmt: skip
        with pytest.raises(VerificationError):
            replace(c, **change).check()
    assert from_dict(to_dict(c)).level == c.level
    with pytest.raises(ModelError, match="json"):
        c.save(tmp_path / "c.txt")


CHECK = """
import sys
from synth.proof.boxcertificate import BoxCertificate
BoxCertificate.load(sys.argv[1]).check()
assert not [m for m in sys.modules if m.split(".")[0] in ("cvxpy", "clarabel", "jax", "control")
            or m.startswith(("synth.synthesis", "synth.lmi", "synth.analysis", "scipy.optimize"))]
"""


def test_the_check_needs_neither_solvers_nor_design_code(tmp_path):
    path = stability_margin(de_gaston_safonov()).certificate.save(tmp_path / "c.json")
    subprocess.run([sys.executable, "-c", CHECK, str(path)], check=True)
