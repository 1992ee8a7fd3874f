"""Norms of sampled loops: published figures, brute force, loops of which the norm is known, what changes nothing."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg as sla
from fastsampling import exponential_and_gram, fast_sampled, random_loop
from hypothesis import given, settings
from hypothesis import strategies as st

from synth import (
    GeneralizedPlant,
    ModelError,
    StateSpace,
    UncertainSystem,
    c2d,
    h2norm,
    hinfnorm,
    lqrd,
    sdh2norm,
    sdhinfnorm,
    system,
)

seeds = st.integers(0, 10**6)
TOL = 1e-6  # of the bounds, relative


def disturbed(F, Fw, rho: float) -> GeneralizedPlant:
    """z = [F (Fw w + u); rho u], y = -F (Fw w + u)."""
    F, Fw = system(*F), system(*Fw)
    n, k = F.n, Fw.n
    C = np.hstack([F.C, np.zeros((1, k))])
    return GeneralizedPlant(
        A=np.block([[F.A, F.B @ Fw.C], [np.zeros((k, n)), Fw.A]]), B1=np.vstack([F.B @ Fw.D, Fw.B]),
        B2=np.vstack([F.B, np.zeros((k, 1))]), C1=np.vstack([C, 0 * C]), D11=[[0], [0]], D12=[[0], [rho]],
        C2=-C, D21=0, D22=0,
    )  # fmt: skip


def roots(zeros, poles, gain: float, dt: float) -> StateSpace:
    return system({"zeros": zeros, "poles": poles, "gain": gain, "dt": dt})


def open_loop(G: StateSpace) -> GeneralizedPlant:
    """A plant whose control does nothing, so that its norms are those of G at any period."""
    Z = np.zeros
    return GeneralizedPlant(
        A=G.A, B1=G.B, B2=Z((G.n, 1)), C1=G.C, D11=G.D, D12=Z((G.ny, 1)), C2=G.C[:1], D21=Z((1, G.nu)), D22=0
    )


def stable(seed: int, n: int = 4) -> StateSpace:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n))
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-2, 0)) * np.eye(n)
    return StateSpace(A, rng.normal(size=(n, 2)), rng.normal(size=(2, n)), np.zeros((2, 2)))


@pytest.mark.parametrize(("h", "low", "high"), [(0.75, 3.7908, 3.7929), (0.2, 1.0044, 1.0049)])
def test_the_example_of_matlabs_documentation(h, low, high):
    """https://www.mathworks.com/help/robust/ref/dynamicsystem.sdhinfnorm.html: [1; 1] p [1 1] with -kd."""
    p = system([30], [1, 30, 0])
    G = StateSpace(p.A, np.hstack([p.B, p.B]), np.vstack([p.C, p.C]), np.zeros((2, 2)))
    found = sdhinfnorm(G, -c2d(system([4], [1, 4]), h))
    assert low < found.lower <= found.upper < high
    assert found.upper <= (1 + TOL) * found.lower


def test_examples_of_directsd():
    """Polyakov, Rosenwasser and Lampe, DirectSD 3.0: getting started, demo_at96, demo_hinf; controllers as printed.

    Of demo_hinf's first controller DirectSD prints an L2-induced norm of 11.4082, fast sampling and we find 11.4454.
    """
    P = disturbed(([1], [25, 1, 0]), ([2], [1, 2]), 0.0)
    assert sdh2norm(P, roots([0.5], [0.2], 1.0, 1.0)) == pytest.approx(0.8332, abs=5e-5)

    spectrum = np.roots([1, 0, 2.489, 0, 1.848])
    ship = [0.051], [25, 1, 0]
    wave = [0.0757**0.5], np.real(np.poly(spectrum[spectrum.real < 0]))
    K = roots([0.9261, *np.roots([1, -0.6558, 0.6191])], [-0.6347, *np.roots([1, 0.07026, 0.07218])], 76.1295, 1.0)
    assert sdh2norm(disturbed(ship, wave, 0.1**0.5), K) == pytest.approx(0.0190, abs=5e-5)
    course = disturbed(ship, wave, 0.0)
    assert np.degrees(sdh2norm(course, K)) == pytest.approx(0.6567, abs=5e-5)
    rudder = replace(course, C1=0 * course.C1, D12=[[1.0], [0.0]])
    assert np.degrees(sdh2norm(rudder, K)) == pytest.approx(2.7468, rel=1e-4)  # K has five digits

    P = GeneralizedPlant(
        A=[[0, 1], [0, -1 / 25]], B1=[[1], [0]], B2=[[0], [0.051 / 25]], C1=[[-1, 0], [0, 0]], D11=[[0], [0]],
        D12=[[0], [0.1]], C2=[[-1, 0]], D21=0, D22=0,
    )  # fmt: skip
    slow, fast = roots([0.9608], [0.8048], 9.2043, 1.0), roots([0.9608], [-0.07181], 72.4068, 1.0)
    assert sdh2norm(P, slow) == pytest.approx(3.2563, abs=5e-5)
    assert sdh2norm(P, fast) == pytest.approx(7.6683, abs=5e-5)
    assert sdhinfnorm(P, fast).upper == pytest.approx(7.6628, abs=5e-3)  # the controller's four digits
    assert sdhinfnorm(P, slow).upper == pytest.approx(hinfnorm(fast_sampled(P, slow, 64))[0], rel=2e-6)


@settings(max_examples=25, deadline=None)
@given(seed=seeds, h=st.floats(-4, 4), part=st.floats(0, 1), direct=st.booleans())
def test_a_loop_that_control_does_not_reach_has_the_norms_of_continuous_time(seed, h, part, direct):
    """Whatever the period: nothing of it is in the answer, and D11, even where it is all of the norm."""
    G, h = stable(seed), 10.0**h
    if direct:
        G = replace(G, D=np.random.default_rng(seed).normal(size=(2, 2)) * 10 ** (2 * part - 1))
    found, expected = sdhinfnorm(open_loop(G), 0.0, h, delay=part * h), hinfnorm(G)[0]
    assert found.lower <= expected * (1 + 1e-7)
    assert expected * (1 - 1e-7) <= found.upper <= found.lower * (1 + 3 * TOL)
    assert sdh2norm(open_loop(G), 0.0, h, delay=part * h) == pytest.approx(h2norm(G), rel=1e-7)


def variant(seed: int, N: int):
    """A random loop, with direct terms, a delay of whole parts of N, and a held w in turn."""
    P, K = random_loop(seed, n=2 + seed % 3, m=1 + seed % 2, p=1 + seed // 2 % 2)
    rng = np.random.default_rng(seed)
    _, _, m, _, p = P.sizes
    late, held = (N // 4) * (seed % 3), (1,) if seed % 4 > 1 else ()
    if seed % 5 == 1:
        P = replace(P, D11=0.3 * rng.normal(size=(2, 2)))
    if held:
        P = replace(P, D21=np.hstack([np.zeros((p, 1)), rng.normal(size=(p, 1))]))
    if seed % 5 == 0:
        P = replace(P, D22=0.05 * rng.normal(size=(p, m)))
    return P, K, {"delay": K.dt * late / N, "held": held or None}, late, held


def checked_against_fast_sampling(seed: int) -> None:
    """Every finer hold of w is a w: its norm is below, and goes to ours with the square of the step."""
    P, K, options, late, held = variant(seed, 8)
    found = sdhinfnorm(P, K, **options)
    coarse, fine = (hinfnorm(fast_sampled(P, K, 8 * k, late=late * k, held=held))[0] for k in (1, 2))
    assert np.isfinite(found.upper) == np.isfinite(fine)
    if np.isfinite(fine):
        assert max(coarse, fine) <= found.upper * (1 + 1e-7)
        limit = fine + (fine - coarse) / 3
        assert limit == pytest.approx(found.upper, rel=2e-6 + 0.2 * (1 - coarse / found.upper))


@pytest.mark.parametrize("seed", range(12))
def test_fast_sampling_comes_to_the_same_from_below(seed):
    checked_against_fast_sampling(seed)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 150))
def test_fast_sampling_comes_to_the_same_from_below_on_fifty_plants(seed):
    checked_against_fast_sampling(seed)


def mean_power(P: GeneralizedPlant, K: StateSpace, delay: float, held) -> float:
    """Of z for white noise: the covariance at the samples, carried through the period, by Gauss's rule."""
    n, nw, m, *_ = P.sizes
    h, free, held = float(K.dt), [j for j in range(nw) if j not in held], list(held)
    Z, I = np.zeros, np.eye
    k = n + K.n + m + len(held)  # x, xk, u before, w held

    def carried(time: float, B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of [x; v], v constant with x' = A x + B v, over `time`: transition, and covariance of the noise."""
        A = np.block([[P.A, B], [Z((B.shape[1], n + B.shape[1]))]])
        W = np.zeros_like(A)
        W[:n, :n] = P.B1[:, free] @ P.B1[:, free].T
        E, gram = exponential_and_gram(A.T, W, time)
        return E.T, gram

    wd = np.hstack([Z((len(held), k - len(held))), I(len(held))])
    x, xk, before = I(k)[:n], I(k)[n : n + K.n], I(k)[n + K.n : n + K.n + m]
    y = P.C2 @ x + P.D21[:, held] @ wd
    if delay:
        y = y + P.D22 @ before
        u = K.C @ xk + K.D @ y
    else:
        u = np.linalg.solve(I(m) - K.D @ P.D22, K.C @ xk + K.D @ y)
        y = y + P.D22 @ u
    B, D = np.hstack([P.B1[:, held], P.B2]), np.hstack([P.D11[:, held], P.D12])
    phases = [(delay, np.vstack([wd, before]))] * (delay > 0) + [(h - delay, np.vstack([wd, u]))]
    # one period of the state at the sample
    F, W, rows = x, Z((n, n)), []
    for time, v in phases:
        rows.append((time, np.vstack([F, v]), W))
        E, gram = carried(time, B)
        F = E[:n] @ np.vstack([F, v])
        W = E[:n, :n] @ W @ E[:n, :n].T + gram[:n, :n]
    A = np.vstack([F, K.A @ xk + K.B @ y, u, 0 * wd])
    Q = sla.block_diag(W, Z((K.n + m, K.n + m)), I(len(held)) / h)
    S = sla.solve_discrete_lyapunov(A, Q)
    power = 0.0
    nodes, weights = np.polynomial.legendre.leggauss(30)
    for time, start, noise in rows:
        for node, weight in zip(nodes, weights, strict=True):
            E, gram = carried(time * (node + 1) / 2, B)
            C = np.hstack([P.C1, D])
            z, inside = C @ E @ start, E[:n, :n] @ noise @ E[:n, :n].T + gram[:n, :n]
            power += weight * time / 2 * (np.trace(z @ S @ z.T) + np.trace(P.C1 @ inside @ P.C1.T))
    return power / h


@pytest.mark.parametrize("seed", range(8))
def test_h2_norm_is_the_root_of_the_mean_power(seed):
    P, K, options, _, held = variant(seed, 8)
    if not held:
        P = replace(P, D11=np.zeros((2, 2)))
    elif P.D11.any():
        P = replace(P, D11=np.hstack([np.zeros((2, 1)), P.D11[:, 1:]]))
    found = sdh2norm(P, K, **options)
    assert np.isfinite(found) == np.isfinite(hinfnorm(fast_sampled(P, K, 8, late=2 * (seed % 3), held=held))[0])
    if np.isfinite(found):
        assert found**2 == pytest.approx(mean_power(P, K, options["delay"], held), rel=1e-8)


@settings(max_examples=15, deadline=None)
@given(
    seed=seeds, x=st.floats(-6, 6), time=st.floats(-6, 6), u=st.floats(-6, 6), y=st.floats(-6, 6), z=st.floats(-6, 6)
)
def test_neither_coordinates_nor_units_nor_time_matter(seed, x, time, u, y, z):
    P, K = random_loop(seed % 100)
    rng = np.random.default_rng(seed)
    n, t, a, b, c = len(P.A), 10.0**time, 10.0**u, 10.0**y, 10.0**z
    Q = np.linalg.qr(rng.normal(size=(n, n)))[0]
    T = (10.0 ** rng.uniform(-abs(x) / 3, abs(x) / 3, n))[:, None] * Q  # from 1e4 on the data itself lose digits
    T, Ti = T * (scales := 2.0 ** rng.integers(-30, 31, n)), np.linalg.inv(T) / scales[:, None]
    moved = replace(
        P, A=Ti @ P.A @ T / t, B1=Ti @ P.B1 / t, B2=Ti @ P.B2 * a / t, C1=c * P.C1 @ T, D12=c * a * P.D12,
        C2=b * P.C2 @ T, D11=c * P.D11,
    )  # fmt: skip
    Km = StateSpace(K.A, K.B / b, K.C / a, K.D / a / b, K.dt * t)
    first, second = sdhinfnorm(P, K, delay=0.3 * K.dt), sdhinfnorm(moved, Km, delay=0.3 * Km.dt)
    for k in (0, 1):
        assert second[k] == pytest.approx(c * first[k], rel=3 * TOL)
    assert sdh2norm(moved, Km) == pytest.approx(c * sdh2norm(P, K) / t**0.5, rel=1e-6)


def test_what_is_hidden_from_the_samples_is_not_hidden():
    """A mode at the sampling rate: the samples of z see nothing of what w does to it, and the truth is large."""
    h = 1.0
    w = 2 * np.pi / h
    G = StateSpace([[0, 1], [-(w**2), -2e-3 * w]], [[0], [1]], [[0, 1]], 0)
    P = open_loop(G)
    sampled = GeneralizedPlant.partition(c2d(P.system, h), 1, 1)
    assert sdhinfnorm(P, 0.0, h).upper == pytest.approx(hinfnorm(G)[0], rel=2 * TOL)
    assert hinfnorm(sampled.close(0.0))[0] < 0.2 * hinfnorm(G)[0]


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e9, 1e12])
def test_an_actuator_that_is_ever_faster_changes_nothing(rate):
    P, K = random_loop(1)
    lagged = replace(
        P, A=np.block([[P.A, P.B2], [np.zeros((1, 3)), -rate * np.eye(1)]]), B1=np.vstack([P.B1, np.zeros((1, 2))]),
        B2=[[0], [0], [0], [rate]], C1=np.hstack([P.C1, P.D12]), D12=0 * P.D12, C2=np.hstack([P.C2, [[0]]]),
    )  # fmt: skip
    assert sdhinfnorm(lagged, K).upper == pytest.approx(sdhinfnorm(P, K).upper, rel=10 / rate + 2 * TOL)
    assert sdh2norm(lagged, K) == pytest.approx(sdh2norm(P, K), rel=30 / rate + 1e-9)


@pytest.mark.parametrize("bandwidth", [1e-4, 1e-2, 0.3])
def test_double_integrators(bandwidth):
    """Sampled often, the loop is the continuous one: 1/wn^2 at rest."""
    A, B, Z = [[0, 1], [0, 0]], [[0], [1]], np.zeros((2, 1))
    P = GeneralizedPlant(A=A, B1=B, B2=B, C1=[[1, 0]], D11=0, D12=0, C2=np.eye(2), D21=Z, D22=Z)
    K = system([[-(bandwidth**2), -2 * bandwidth]], dt=1.0)
    found = sdhinfnorm(P, K).upper
    assert found == pytest.approx(hinfnorm(fast_sampled(P, K, 32))[0], rel=1e-4)
    assert found == pytest.approx(bandwidth**-2, rel=0.2 * bandwidth + 2 * TOL)


def test_no_gain_of_the_samples_has_a_smaller_h2_norm_than_that_of_lqrd():
    """White noise on all states, z the cost: the norm is stationary and least at the sampled-data regulator."""
    rng = np.random.default_rng(4)
    A, B, h, Z, I = rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), 0.4, np.zeros, np.eye
    P = GeneralizedPlant(
        A=A, B1=I(3), B2=B, C1=np.vstack([I(3), Z((2, 3))]), D11=Z((5, 3)), D12=np.vstack([Z((3, 2)), 0.5 * I(2)]),
        C2=I(3), D21=Z((3, 3)), D22=Z((3, 2)),
    )  # fmt: skip
    K = -lqrd(A, B, I(3), 0.25 * I(2), h)[0]
    least = sdh2norm(P, K, h)
    for _ in range(6):
        step = 1e-3 * rng.normal(size=K.shape)
        up, down = (sdh2norm(P, K + sign * step, h) for sign in (1, -1))
        assert min(up, down) > least
        assert abs(up - down) < 1e-2 * (up + down - 2 * least)


def test_a_whole_period_of_delay_is_a_state_of_the_controller():
    P, K = random_loop(3)
    late = StateSpace(
        np.block([[K.A, np.zeros((K.n, 1))], [K.C, np.zeros((1, 1))]]), np.vstack([K.B, K.D]),
        np.hstack([np.zeros((1, K.n)), [[1.0]]]), [[0.0]], K.dt,
    )  # fmt: skip
    assert sdhinfnorm(P, K, delay=K.dt).upper == pytest.approx(sdhinfnorm(P, late).upper, rel=2 * TOL)
    assert sdh2norm(P, K, delay=K.dt) == pytest.approx(sdh2norm(P, late), rel=1e-9)


def test_noise_of_the_sensor_alone_is_held_of_itself_and_others_are_named():
    P, K = random_loop(2)
    noisy = replace(P, B1=P.B1 * [1, 0], D21=[[0, 0.5]])
    assert sdhinfnorm(noisy, K).upper == sdhinfnorm(noisy, K, held=["w1"]).upper
    both = replace(P, D21=[[0, 0.5]], w=("torque", "reference"))
    for norm in (sdhinfnorm, sdh2norm):
        with pytest.raises(
            ModelError, match=r"'reference' reaches a sampler directly.*anti-aliasing.*held=\['reference'\]"
        ):
            norm(both, K)
    assert sdhinfnorm(both, K, held=["reference"]).upper == sdhinfnorm(both, K, held=1).upper


def test_held_signals_that_are_slow_are_those_of_the_sampled_plant():
    """With z that is sampled often beside its changes, all w held: the norm of c2d's loop."""
    P, K = random_loop(5, h=1e-3)
    P = replace(P, D21=[[0.3, 0.5]])
    found = sdhinfnorm(P, K, held=[0, 1]).upper
    sampled = GeneralizedPlant.partition(c2d(P.system, K.dt), 1, 1)
    assert found == pytest.approx(hinfnorm(sampled.close(K))[0], rel=5e-3)


def test_unstable_loops_have_no_norm():
    P = open_loop(StateSpace([[0.1]], [[1.0]], [[1.0]], [[0.0]]))
    assert sdhinfnorm(P, 0.0, 1.0)[:2] == (np.inf, np.inf)
    assert sdh2norm(P, 0.0, 1.0) == np.inf
    direct = open_loop(StateSpace([[-0.1]], [[1.0]], [[1.0]], [[1.0]]))
    assert sdh2norm(direct, 0.0, 1.0) == np.inf
    assert sdhinfnorm(open_loop(StateSpace([[-1.0]], [[0.0]], [[1.0]], [[0.0]])), 0.0, 1.0) == (0, 0, 0)


@pytest.mark.parametrize("norm", [sdhinfnorm, sdh2norm])
def test_wrong_arguments_are_refused_with_what_to_pass(norm):
    P, K = random_loop(2)
    G = system([1], [1, 1])
    for call, told in (
        (lambda: norm(P, K, 2 * K.dt), "h is .* and K has"),
        (lambda: norm(P, G), "K is continuous"),
        (lambda: norm(P, G, 0.1), "K has continuous"),
        (lambda: norm(P, 1.0), "K is continuous"),
        (lambda: norm(P, system([1], [1, 0.5], True)), "dt = True"),
        (lambda: norm(P, K, delay=2 * K.dt), "delay is .* more than the period"),
        (lambda: norm(P, K, delay=-1), "delay"),
        (lambda: norm(GeneralizedPlant.partition(c2d(P.system, K.dt), 1, 1), K), "P is discrete"),
        (lambda: norm(P, np.eye(2), 0.1), "K is 2 x 2 where 1 x 1"),
        (lambda: norm(system(1.0), K), "P is 1 x 1, which leaves no z"),
        (lambda: norm(P, K, held="w7"), "no held w 'w7'"),
        (lambda: norm(UncertainSystem(None, -1.0, 1.0, 1.0), K), "P"),
    ):
        with pytest.raises(ModelError, match=told):
            call()
    assert norm(P, system([1e-3], [1, 0.5], True), K.dt) == norm(P, system([1e-3], [1, 0.5], K.dt))
