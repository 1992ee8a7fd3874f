"""`c2d` by every method with delays of any length, and `d2c`: against motions and published figures, there and back."""

from __future__ import annotations

import families
import flint
import numpy as np
import pytest
import scipy.linalg as sla
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

import synth
from synth import ModelError, NumericalError, StateSpace, c2d, d2c
from synth.systems.connect import input_delay
from synth.systems.exponential import expm

METHODS = ("zoh", "foh", "impulse", "tustin", "midpoint", "matched")
FINE = 16  # parts of a period, of which delays are made
EACH = settings(max_examples=25, deadline=None)


def plant(seed: int, kind: str = "dense", direct: bool = True) -> StateSpace:
    """Several inputs and outputs; rates about one, but for integrators and modes that die within a sample."""
    rng = np.random.default_rng(seed)
    n, m, p = (int(k) for k in rng.integers(1, (6, 4, 4)))
    A = rng.standard_normal((n, n))
    if kind == "integrators":
        A = np.triu(A, 1)
    if kind == "stiff":
        T = np.linalg.qr(rng.standard_normal((n, n)))[0]
        A = T @ np.diag(-(10.0 ** rng.uniform(-2, 3, n))) @ T.T
    D = rng.standard_normal((p, m)) * direct
    return StateSpace(A, rng.standard_normal((n, m)), rng.standard_normal((p, n)), D)


def answer(H: StateSpace, u: np.ndarray) -> np.ndarray:
    """Outputs (N, p) of a discrete system to inputs (N, m), from rest."""
    x, y = np.zeros(H.n), []
    for v in u:
        y.append(H.C @ x + H.D @ v)
        x = H.A @ x + H.B @ v
    return np.array(y)


def motion(G: StateSpace, dt: float, method: str, u: np.ndarray, late: np.ndarray, waits: np.ndarray) -> np.ndarray:
    """What the plant does, on a grid of 1/16 of a period, by the linear simulation of SciPy."""
    t = np.arange(FINE * len(u)) * dt / FINE
    k = np.arange(len(t))[:, None] - late
    before, part = np.floor_divide(k, FINE), np.mod(k, FINE) / FINE
    padded, j = np.vstack([np.zeros((1, G.nu)), u, u[-1:], u[-1:]]), np.arange(G.nu)
    at, after = padded[np.maximum(before + 1, 0), j], padded[np.maximum(before + 2, 0), j]
    v = (1 - part) * at + part * after if method == "foh" else at
    y = signal.lsim(G.matrices, v, t, interp=method == "foh")[1].reshape(len(t), G.ny)
    shown = np.arange(len(u))[:, None] * FINE - waits
    return np.where(shown >= 0, y[np.maximum(shown, 0), np.arange(G.ny)], 0.0)


@EACH
@given(st.integers(0, 10_000), st.sampled_from(["zoh", "foh"]), st.sampled_from(["dense", "integrators", "stiff"]))
def test_held_inputs_and_lines_with_delays_are_exact(seed, method, kind):
    """Delays of every input and output, whole and broken, up to three periods."""
    G, rng, dt = plant(seed, kind), np.random.default_rng(seed + 1), 0.4
    late, waits = rng.integers(0, 3 * FINE + 1, G.nu), rng.integers(0, 3 * FINE + 1, G.ny)
    u = rng.standard_normal((20, G.nu))
    u[0] = 0.0  # from rest
    found = c2d(G, dt, method, delay=late * dt / FINE, output_delay=waits * dt / FINE)
    expected = motion(G, dt, method, u, late, waits)
    np.testing.assert_allclose(answer(found, u), expected, rtol=0, atol=1e-9 * np.abs(expected).max(initial=1.0))
    assert found.n <= G.n + np.ceil(late / FINE).sum() + np.ceil(waits / FINE).sum() + G.ny
    assert (found.u, found.y) == (G.u, G.y)


@EACH
@given(st.integers(0, 10_000), st.floats(0, 3), st.floats(0, 3), st.sampled_from(["dense", "integrators", "stiff"]))
def test_impulses_are_answered_by_samples_of_the_impulse_response(seed, late, wait, kind):
    """y_k = dt sum of g(k dt - j dt - delays) u_j, and g(0) = C B, as MATLAB scales it."""
    G, dt = plant(seed, kind, direct=False), 0.4
    found = c2d(G, dt, "impulse", delay=late * dt, output_delay=wait * dt)
    times = (np.arange(12) - late - wait) * dt
    g = np.array([G.C @ sla.expm(G.A * max(t, 0.0)) @ G.B * (t > -1e-9 * dt) for t in times])
    np.testing.assert_allclose(
        found.impulse_response(11.5 * dt).values, g, rtol=0, atol=1e-9 * np.abs(g).max(initial=1.0)
    )


def test_published_figures():
    """Of MATLAB's documentation of c2d and d2c, and of ControlSystems.jl's test_discrete.jl."""
    h = synth.system([10], [1, 3, 10])
    z = np.exp(1j * np.array([0.1, 1.0, 2.0]))
    found = c2d(h, 0.1, delay=0.25).frequency_response(np.angle(z) / 0.1)[:, 0, 0]
    expected = np.polyval([0.01187, 0.06408, 0.009721], z) / np.polyval([1, -1.655, 0.7408], z) / z**3
    np.testing.assert_allclose(found, expected, rtol=2e-2)  # four digits of poles near z
    shown = c2d(h, 0.1, delay=0.25)
    num, den = shown.tf().num[0][0], shown.tf().den[0][0]
    np.testing.assert_allclose(num[-3:], [0.01187, 0.06408, 0.009721], rtol=5e-4)
    np.testing.assert_allclose(den[:3], [1, -1.655, 0.7408], rtol=5e-4)
    back = d2c(([1, -1], [1, 1, 0.3], 0.1))
    np.testing.assert_allclose(back.tf().num[0][0], [121.7, 0], rtol=5e-4, atol=1e-9)
    np.testing.assert_allclose(back.tf().den[0][0], [1, 12.04, 776.7], rtol=5e-4)
    turned = d2c({"zeros": [-0.5], "poles": [-2, 5], "gain": 1, "dt": 0.1}, "tustin")
    np.testing.assert_allclose(np.sort(turned.zeros()), [-60, 20], rtol=1e-9)
    np.testing.assert_allclose(np.sort(turned.poles()), [40 / 3, 60], rtol=1e-9)
    assert turned.D[0, 0] == pytest.approx(1 / 12)
    line = c2d(StateSpace([[-5.0]], [[2.0]], [[3.0]], [[0.0]]), 0.01, "foh")
    for M, value in zip(line.matrices, (0.951229424500714, 0.01902855227625244, 3, 0.029506188017136226), strict=True):
        assert M[0, 0] == pytest.approx(value, rel=1e-12)


def test_figures_of_octaves_control_package():
    """10/(s^2 + 3 s + 10) at 0.1 s; its impulse-invariant system is not multiplied by dt."""
    h = synth.system([10], [1, 3, 10])
    for found, expected in (
        (c2d(h, 0.1, "impulse"), [0.08496, 0]),
        (c2d(h, 0.1, "matched"), [0.04284, 0.04284]),
        (c2d(h, 0.1, "foh"), [0.01541, 0.057, 0.01326]),
        (c2d(h, 0.1, "tustin", prewarp=3), [0.02157, 0.04314, 0.02157]),
    ):
        num = found.tf().num[0][0]
        np.testing.assert_allclose(num[-len(expected) :], expected, rtol=5e-4, atol=1e-12)


@EACH
@given(st.integers(0, 10_000), st.floats(0.01, 7.8))
def test_prewarping_keeps_the_response_there(seed, w):
    G = plant(seed)
    found, expected = c2d(G, 0.4, "tustin", prewarp=w).frequency_response(w), G.frequency_response(w)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7 * max(np.abs(expected).max(), 1.0))


@EACH
@given(st.integers(0, 10_000), st.integers(0, 3), st.integers(0, 3))
def test_matching_takes_poles_and_zeros_and_the_gain_at_rest(seed, integrators, excess):
    """Any number of integrators and of zeros at infinity: one of these stays, and s^k G is kept at s = 0."""
    rng, dt = np.random.default_rng(seed), 0.3
    poles, zeros = -rng.uniform(0.1, 3, excess + 2), -rng.uniform(0.1, 3, 2)
    G = synth.system({"zeros": zeros, "poles": np.append(poles, np.zeros(integrators)), "gain": 2.0, "dt": 0})
    G = G.transform(np.linalg.qr(rng.standard_normal((G.n, G.n)))[0])
    extra = max(excess + integrators - 1, 0)  # zeros at -1
    k = 2.0 * np.prod(-zeros) / np.prod(-poles) * np.prod(1 - np.exp(poles * dt)) / np.prod(1 - np.exp(zeros * dt))
    z = np.exp(1j * dt * np.geomspace(0.01, 10, 9))
    above = np.prod(z[:, None] - np.exp(zeros * dt), axis=1) * ((z + 1) / 2) ** extra
    below = np.prod(z[:, None] - np.exp(poles * dt), axis=1) * ((z - 1) / dt) ** integrators
    found = c2d(G, dt, "matched")
    np.testing.assert_allclose(found.frequency_response(np.angle(z) / dt)[:, 0, 0], k * above / below, rtol=1e-6)
    back = d2c(found, "matched")
    omega = np.geomspace(0.1, 10, 9)
    np.testing.assert_allclose(back.frequency_response(omega), G.frequency_response(omega), rtol=1e-4)


@EACH
@given(st.integers(0, 10_000), st.floats(0, 17), st.floats(0, 6), st.booleans())
def test_exponentials_of_triangular_matrices_with_a_diagonal_that_is_nearly_constant(seed, near, size, lower):
    """Where SciPy returns zeros for entries beside the diagonal; against arithmetic of 300 bits."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 6))
    A = np.triu(rng.standard_normal((n, n)) * 10**size, 1)
    A[np.diag_indices(n)] = -0.6 * (1 + 10.0**-near * rng.standard_normal(n))
    A = A.T if lower else A
    with flint.ctx.workprec(300):
        E = flint.arb_mat(A.tolist()).exp()
        exact = np.array([[float(E[i, j]) for j in range(n)] for i in range(n)])
    np.testing.assert_allclose(expm(A), exact, rtol=0, atol=1e-7 * np.abs(exact).max())


ROUND = ("double_integrator_axes", "integrator_chain", "flexible_axis", "spread_lags", "jordan_block", "dense_system")


@pytest.mark.parametrize("method", ["zoh", "foh", "tustin", "prewarp", "midpoint"])
@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 10_000), st.sampled_from(ROUND), st.sampled_from(["turned", "scaled", "scaled, then turned"]),
    st.sampled_from([1.0, 1e-3, 1e3]),
)  # fmt: skip
def test_there_and_back(method, seed, family, kind, unit):
    """In any coordinates that hold the sampled plant, and units of time; the fastest pole turns by 0.6 a sample."""
    rng = np.random.default_rng(seed)
    G = getattr(families, family)(rng)
    dt, angles = 0.6 / max(np.abs(G.poles()).max(), 0.1), np.geomspace(0.3, 3, 7)
    name = "tustin" if method == "prewarp" else method

    def options(period: float) -> dict[str, float]:
        return {"prewarp": 1.0 / period} if method == "prewarp" else {}

    def sampled(H: StateSpace) -> np.ndarray:
        period = dt / (1.0 if H is G else unit)
        return families.response(c2d(H, period, name, **options(period)), angles / period)

    expected = sampled(G)
    H = families.holding(kind, G, rng, lambda H: families.apart(expected, sampled(H)), unit)(G)
    dt = dt / unit
    once = c2d(H, dt, name, **options(dt))
    again = c2d(d2c(once, name, **options(dt)), dt, name, **options(dt))
    assert families.apart(again.frequency_response(angles / dt), expected) < 1e-6


@EACH
@given(st.integers(0, 10_000), st.sampled_from(["zoh", "foh", "midpoint", "tustin"]))
def test_the_matrices_come_back(seed, method):
    """Below half a turn a sample the continuous system itself is found again."""
    G = plant(seed)
    dt = 1.0 / max(np.abs(G.poles()).max(), 1.0)
    for M, N in zip(d2c(c2d(G, dt, method), method).matrices, G.matrices, strict=True):
        np.testing.assert_allclose(M, N, rtol=0, atol=1e-7 * max(np.abs(N).max(), 1.0))


def test_gains_without_states():
    for method in ("zoh", "foh", "tustin", "midpoint"):
        G = c2d(StateSpace.gain([[2.0, 1.0]], 0.0), 0.1, method, delay=[0.1, 0.3])
        np.testing.assert_allclose(answer(G, np.eye(2)[[0, 0, 1, 1, 1]] * 1.0).ravel(), [0, 2, 2, 0, 0])
        np.testing.assert_array_equal(d2c(c2d(StateSpace.gain([[2.0]], 0.0), 0.1, method), method).D, [[2.0]])
    assert c2d(2.0, 0.1, "matched").D[0, 0] == 2
    assert d2c(c2d(2.0, 0.1, "matched"), "matched").D[0, 0] == 2


@EACH
@given(st.integers(0, 10_000), st.integers(0, 40))
def test_whole_samples_are_lines_of_every_method(seed, samples):
    """0.3 s is three samples of 0.1 s, whatever doubles say; and `input_delay` of the sampled system."""
    G = plant(seed, direct=False)[0, 0]
    for method in METHODS:
        try:
            once = c2d(G, 0.1, method)
        except NumericalError:
            continue
        found, expected = c2d(G, 0.1, method, delay=samples * 0.1), input_delay(once, samples * 0.1)
        assert found.n == once.n + samples
        np.testing.assert_allclose(found.C, expected.C, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(found.A, expected.A, rtol=1e-9, atol=1e-12)


def test_distances_of_loops_with_delays():
    """The nu-gap of sampled systems with delays is the largest chordal distance of what they do, on a fine grid."""
    G = synth.system([1.0], [1.0, 0.5, 0.0])
    for a, b in ((0.0, 0.05), (0.13, 0.2)):
        one, other = (c2d(G, 0.1, delay=d) for d in (a, b))
        w = np.geomspace(1e-3, np.pi / 0.1, 5000)
        p, q = (H.frequency_response(w)[:, 0, 0] for H in (one, other))
        chord = np.abs(p - q) / np.sqrt((1 + np.abs(p) ** 2) * (1 + np.abs(q) ** 2))
        assert synth.gapmetric(one, other).nugap == pytest.approx(chord.max(), rel=1e-5)
    # a broken delay of the plant takes from the delay margin what it says
    L = c2d(0.3 * G, 0.1)
    late = synth.margin(L).delay
    assert synth.margin(c2d(0.3 * G, 0.1, delay=0.2)).delay == pytest.approx(late - 0.2, rel=1e-6)


def test_what_is_refused():
    G = synth.system([1.0, 1.0], [1.0, 2.0])
    with pytest.raises(ModelError, match=r"impulse response has an impulse.*method='zoh'"):
        c2d(G, 0.1, "impulse")
    with pytest.raises(ModelError, match="prewarp is 40 rad/s; pass a frequency in rad/s between 0 and pi/dt = 31"):
        c2d(G, 0.1, "tustin", prewarp=40)
    with pytest.raises(ModelError, match="it belongs to method='tustin'"):
        c2d(G, 0.1, "zoh", prewarp=1)
    with pytest.raises(
        ModelError, match=r"delay is \[0\.5\] samples of dt = 0\.1 s, and method 'tustin' has whole ones only"
    ):
        c2d(G, 0.1, "tustin", delay=0.05)
    with pytest.raises(ModelError, match="output_delay is -1"):
        c2d(G, 0.1, output_delay=-1)
    with pytest.raises(ModelError, match="at most 5000 can be states"):
        c2d(G, 0.1, delay=1e4)
    with pytest.raises(ModelError, match="G is 1 x 2: it has no zeros entry by entry"):
        c2d(StateSpace([[-1.0]], [[1.0, 1.0]], [[1.0]], [[0.0, 0.0]]), 0.1, "matched")
    with pytest.raises(ModelError, match=r"sample G\.at"):
        c2d(synth.UncertainSystem([[synth.ureal("J", 1.0, percentage=20)]], -1.0, 1.0, 1.0), 0.1, delay=0.1)
    with pytest.raises(NumericalError, match="goes beyond all numbers"):
        c2d(synth.system([1.0], [1.0, -1e5]), 0.1, "matched")
    for method in ("zoh", "foh", "matched"):
        with pytest.raises(ModelError, match=r"the pole z = -0\.5.*changes sign.*method='tustin'"):
            d2c(([1.0, 0.3], [1.0, 0.5], 0.1), method)
        with pytest.raises(ModelError, match="at 0 it is a delay"):
            d2c(([1.0, 0.3], [1.0, 0.0], 0.1), method)
    Q = np.linalg.qr(np.random.default_rng(0).standard_normal((3, 3)))[0]
    dead = StateSpace(Q @ np.diag([-100.0, -1, -2]) @ Q.T, Q[:, :1], Q[:1], [[0.0]])
    with pytest.raises(NumericalError, match="a pole that is 0 to rounding"):
        d2c(c2d(dead, 1.0))
    with pytest.raises(ModelError, match="a pole at z = -1"):
        d2c(([1.0], [1.0, 1.0], 0.1), "tustin")
    with pytest.raises(ModelError, match="already continuous"):
        d2c(G)
    with pytest.raises(ModelError, match="unspecified sampling time"):
        d2c(([1.0], [1.0, 0.5], True))
    with pytest.raises(ModelError, match="2 poles and 0 zeros"):
        d2c(([1.0], [1.0, -0.7, 0.1], 0.1), "matched")
