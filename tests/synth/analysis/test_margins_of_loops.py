"""Margins of loops as spacecraft have them: exact, whatever coordinates and units, and true on what was given."""

import numpy as np
import pytest
from loops import exact_margin, in_units, one, orthogonal, several

from synth import StateSpace, allmargin, c2d, diskmargin, feedback, margin, margins, system
from synth.analysis.norms import is_stable

COORDINATES = 1e-6  # relative
UNITS = 1e-9


def groups(size: int, fast: int):
    """Two hundred seeds in groups; those from `fast` on are slow."""
    return [
        pytest.param(range(k, k + size), id=f"{k} to {k + size - 1}", marks=[pytest.mark.slow] if k >= fast else [])
        for k in range(0, 200, size)
    ]


SEEDS, COUPLED = groups(20, 40), groups(10, 20)


def in_turned_coordinates(L: StateSpace, rng) -> StateSpace:
    return L.transform(orthogonal(rng, L.n))


def in_other_units(L: StateSpace, rng) -> tuple[StateSpace, float]:
    """Powers of ten, so that no entry is rounded by more than itself."""
    states, signals, time = (10.0 ** rng.integers(-6, 7, k) for k in (L.n, L.nu, 1))
    return in_units(L, states, signals, float(time[0])), float(time[0])


def response(L: StateSpace, omega: float) -> np.ndarray:
    """From the given matrices, by nothing of the package."""
    if not np.isfinite(omega):
        return L.D
    s = np.exp(1j * omega * L.dt) if L.discrete else 1j * omega
    return L.C @ np.linalg.solve(s * np.eye(L.n) - L.A, L.B) + L.D


@pytest.mark.parametrize("seeds", SEEDS)
def test_against_the_roots_of_polynomials(seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        loop = one(rng)
        exact, given = exact_margin(loop), system(loop.num, loop.den)
        for L in (given, in_turned_coordinates(given, rng)):
            found = margin(L)
            if exact is None:
                assert (found.gain_up, found.gain_down, found.phase, found.delay) == (1, 1, 0, 0)
                continue
            for name in ("gain_up", "gain_down", "phase", "delay"):
                assert getattr(found, name) == pytest.approx(getattr(exact, name), rel=1e-8), (seed, loop.kind, name)


@pytest.mark.parametrize("seeds", SEEDS)
def test_every_crossing_holds_on_the_given_matrices(seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        loop = one(rng)
        L = in_turned_coordinates(system(loop.num, loop.den), rng)
        found, every = margin(L), allmargin(L)
        assert every.stable == (found.phase > 0)
        for factor, omega in zip(every.gain, every.gain_frequency, strict=True):
            assert abs(factor * response(L, omega) + 1) < 1e-6, (seed, loop.kind, factor)
        for phi, omega in zip(every.phase, every.phase_frequency, strict=True):
            assert abs(abs(response(L, omega)) - 1) < 1e-6, (seed, loop.kind)
            assert abs(np.exp(-1j * phi) * response(L, omega) + 1) < 1e-6, (seed, loop.kind, phi)
        for delay, omega in zip(every.delay, every.delay_frequency, strict=True):
            assert abs(np.exp(-1j * omega * delay) * response(L, omega) + 1) < 1e-6, (seed, loop.kind, delay)
        if every.stable and np.isfinite(found.phase_frequency):
            assert min(abs(every.phase)) == pytest.approx(found.phase, rel=1e-12)
            assert min(every.delay, default=np.inf) == pytest.approx(found.delay, rel=1e-12)


@pytest.mark.parametrize("seeds", SEEDS)
def test_units_of_states_and_time_change_nothing(seeds):
    for seed in seeds:
        rng = np.random.default_rng(seed)
        loop = one(rng)
        L = system(loop.num, loop.den)
        moved, time = in_other_units(L, rng)
        found, other = margin(L), margin(moved)
        assert other.gain_up == pytest.approx(found.gain_up, rel=UNITS), (seed, loop.kind)
        assert other.gain_down == pytest.approx(found.gain_down, rel=UNITS), (seed, loop.kind)
        assert other.phase == pytest.approx(found.phase, rel=UNITS), (seed, loop.kind)
        assert other.delay * time == pytest.approx(found.delay, rel=UNITS), (seed, loop.kind)
        assert diskmargin(moved).alpha == pytest.approx(diskmargin(L).alpha, rel=UNITS), (seed, loop.kind)


@pytest.mark.parametrize("seeds", COUPLED)
def test_disk_margins_of_coupled_loops(seeds):
    """Unchanged by coordinates and units; the worst factors bring the given loop to the boundary, in the same disk."""
    for seed in seeds:
        rng = np.random.default_rng([seed, 1])
        L = several(rng)
        found = diskmargin(L)
        turned = diskmargin(in_turned_coordinates(L, rng))
        moved, _ = in_other_units(L, rng)
        assert turned.alpha == pytest.approx(found.alpha, rel=COORDINATES), seed
        assert diskmargin(moved).alpha == pytest.approx(found.alpha, rel=UNITS), seed
        delta = 2 * (found.factors - 1) / (found.factors + 1)
        assert abs(delta).max() == pytest.approx(found.alpha, rel=1e-6), seed
        assert abs(boundary(L, found.factors)) == pytest.approx(found.frequency, rel=1e-4, abs=1e-6), seed
        for _ in range(20):  # and nothing smaller does
            inside = 0.999 * found.alpha * np.exp(2j * np.pi * rng.random(L.nu))
            assert distance(L, (1 + inside / 2) / (1 - inside / 2)) < 0, seed


def poles(L: StateSpace, factors: np.ndarray) -> np.ndarray:
    """Of the closed loop with complex factors in its channels."""
    F = np.diag(factors)
    return np.linalg.eigvals(L.A - L.B @ F @ np.linalg.solve(np.eye(L.nu) + L.D @ F, L.C))


def distance(L: StateSpace, factors: np.ndarray) -> float:
    """Of the poles beyond the imaginary axis; negative for a stable loop."""
    return float(poles(L, factors).real.max())


def boundary(L: StateSpace, factors: np.ndarray) -> float:
    """The height of the pole that is on the imaginary axis."""
    found = poles(L, factors)
    on = found[np.argmax(found.real)]
    assert abs(on.real) < 1e-6 * max(abs(found)), found
    return float(on.imag)


@pytest.mark.parametrize("seed", range(20))
def test_margins_of_a_plant_and_a_controller_at_every_end(seed):
    """Signals in other units and turned states; the margin of both ends at once is none of the largest."""
    rng = np.random.default_rng([seed, 2])
    L = several(rng)
    K = StateSpace.gain(rng.normal(size=(L.nu, L.nu)) + 3 * np.eye(L.nu), 0.0)
    P = StateSpace(L.A, L.B, np.linalg.solve(K.D, L.C), np.linalg.solve(K.D, L.D))
    found = margins(P, K)
    u, y = (10.0 ** rng.integers(-6, 7, k) for k in (P.nu, P.ny))
    other = margins(
        in_turned_coordinates(StateSpace(P.A, P.B * u, y[:, None] * P.C, y[:, None] * P.D * u), rng),
        StateSpace.gain(K.D / u[:, None] / y, 0.0),
    )
    for name in ("gain_db", "phase_deg", "delay", "disk"):
        assert getattr(other, name) == pytest.approx(getattr(found, name), rel=COORDINATES), name
    assert other.disk_both.alpha == pytest.approx(found.disk_both.alpha, rel=COORDINATES)
    for one_at_a_time, all_of_them in (
        (found.disk_inputs, found.disk_input),
        (found.disk_outputs, found.disk_output),
    ):
        assert min(each.alpha for each in one_at_a_time) >= all_of_them.alpha * (1 - 1e-6)
    assert found.disk_both.alpha <= found.disk * (1 + 1e-6)


@pytest.mark.parametrize("seed", range(20))
def test_disk_margins_survive_a_bilinear_map(seed):
    """Tustin's map moves frequencies only."""
    rng = np.random.default_rng([seed, 3])
    L = several(rng)
    rate = float(np.abs(np.linalg.eigvals(feedback(L, np.eye(L.nu)).A)).max())
    assert diskmargin(c2d(L, 0.3 / rate, "tustin")).alpha == pytest.approx(diskmargin(L).alpha, rel=COORDINATES)


@pytest.mark.parametrize("skew", [-1.0, -0.5, 0.5, 1.0, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_gains_and_phases_of_a_skewed_disk_are_borne(seed, skew):
    rng = np.random.default_rng([seed, 4])
    L = several(rng)
    found = diskmargin(L, skew=skew)
    low, high = found.gain
    turn = np.exp(1j * 0.9999 * found.phase)
    for factor in (low + 1e-4 * (1 - low), min(high, 1e6) * 0.9999, turn, turn.conjugate()):
        if low < abs(factor) < high or abs(factor) == pytest.approx(1):
            assert is_stable_with(L, factor), (skew, factor)
    assert abs(boundary(L, found.factors)) == pytest.approx(found.frequency, rel=1e-4, abs=1e-6)


def is_stable_with(L: StateSpace, factor: complex) -> bool:
    return distance(L, np.full(L.nu, factor)) < 0


def test_independent_axes_have_the_margin_of_the_worst():
    """Channels that do not see one another, or in one direction only: no coupling, no loss."""
    a, b = system([25], [1, 10, 10, 10]), system([1.4, 1], [1, 0, 0])
    worst = min(diskmargin(a).alpha, diskmargin(b).alpha)
    A = np.block([[a.A, np.zeros((3, 2))], [np.zeros((2, 3)), b.A]])
    B, C = np.zeros((5, 2)), np.zeros((2, 5))
    B[:3, 0], B[3:, 1], C[0, :3], C[1, 3:] = a.B[:, 0], b.B[:, 0], a.C[0], b.C[0]
    alone = StateSpace(A, B, C, np.zeros((2, 2)))
    assert diskmargin(alone).alpha == pytest.approx(worst, rel=1e-7)
    C[1, :3] = 1e3 * a.C[0]  # the second measures the first as well
    assert diskmargin(StateSpace(A, B, C, np.zeros((2, 2)))).alpha == pytest.approx(worst, rel=1e-7)
    assert is_stable(feedback(alone, np.eye(2)))


@pytest.mark.parametrize("seed", range(6))
def test_both_ends_of_a_loop_that_a_controller_decouples(seed):
    """L = k/s I at either end, through an ill-conditioned plant: equal singular values need scalings that follow."""
    rng = np.random.default_rng([seed, 5])
    m = 2 + seed % 2
    G = rng.normal(size=(m, m))
    inverse, O = np.linalg.inv(G), np.zeros((m, m))
    P, K = StateSpace(-np.eye(m) / 75, np.eye(m) / 75, G, O), StateSpace(O, np.eye(m), 0.7 * inverse, 52.5 * inverse)
    found = margins(P, K)
    assert found.disk == pytest.approx(2, rel=1e-7)
    both = found.disk_both
    assert 0 < both.alpha < 2 * (np.sqrt(2) - 1) + 1e-7  # that of a well-conditioned plant
    assert abs(boundary(found.loops.both, both.factors)) == pytest.approx(both.frequency, rel=1e-4)


@pytest.mark.parametrize("modes", [0, 3, 12])
def test_flexible_satellite_under_proportional_derivative_control(modes):
    """Angles and rates are measured, so that at rest half of the output's channels see the others one way only."""
    rng = np.random.default_rng(modes)
    n, J = 6 + 2 * modes, np.diag([10.0, 12.0, 8.0])
    A, B, C = np.zeros((n, n)), np.zeros((n, 3)), np.eye(6, n)
    A[:3, 3:6], B[3:6] = np.eye(3), np.linalg.inv(J)
    for i, w in zip(range(6, n, 2), np.geomspace(1, 100, modes), strict=True):
        A[i, i + 1], A[i + 1, i], A[i + 1, i + 1] = 1.0, -(w**2), -0.01 * w
        B[i + 1] = C[:3, i] = C[3:, i + 1] = 0.1 * rng.normal(size=3)
    P, K = StateSpace(A, B, C, np.zeros((6, 3))), StateSpace.gain(np.hstack([0.5 * J, 1.5 * J]), 0.0)
    found = margins(P, K)
    y = 10.0 ** rng.integers(-3, 4, 6)
    moved = margins(
        in_turned_coordinates(StateSpace(A, B, y[:, None] * C, np.zeros((6, 3))), rng), StateSpace.gain(K.D / y, 0.0)
    )
    for disk in ("disk_input", "disk_output", "disk_both"):
        one_of_them = getattr(found, disk)
        assert getattr(moved, disk).alpha == pytest.approx(one_of_them.alpha, rel=COORDINATES), disk
        assert 0 < one_of_them.alpha < 2
    assert abs(boundary(found.loops.input, found.disk_input.factors)) == pytest.approx(found.disk_input.frequency)
    assert found.disk_both.alpha <= found.disk < min(each.alpha for each in found.disk_inputs) * (1 + 1e-6)
