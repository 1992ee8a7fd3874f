"""What a solution of a Riccati equation is judged by, sharing no code with `synth`: the solution to many digits, the
residual in the equation's own units, and the error that rounding of the data alone may cause.

Units. Scaling a state by s divides its row and column of the equation by s. Everything below is divided by
unit_i unit_j, unit_i^2 = T_ii, where T is the sum of the absolute values of the terms that the residual adds up,

    T = |A'||X||E| + |E'||X||A| + |Q| + 2 |K'|(|B'||X||E| + |N'|) + |K'||R||K|            (continuous; discrete alike),

at the solution, so that no choice of units makes a residual small. States that nothing sees, T_ii = 0, have the unit
of the states that drive them. Rounding every term once, |P_ij| <= eps unit_i unit_j, leaves P between -+ n eps diag(T)
as a quadratic form, and moves X between -+ n eps Z, where Z >= 0 solves A_K'Z E + E'Z A_K + diag(T) = 0 of the closed
loop A_K (Kenney and Hewer 1990; Ghavimi and Laub 1995). So the error is |X - X*|_ij / sqrt(Z_ii Z_jj), and
max Z_ii / |X_ii| the condition of the equation.

Method: Cayley map into discrete time, structure-preserving doubling (Chu, Fan, Lin and Wang 2004) in ball arithmetic,
radii dropped, accepted by its residual. Beyond LARGE states: Newton's method, residual in balls, correction in double.
"""

from typing import NamedTuple

import numpy as np
import scipy.linalg as sla
from flint import arb, arb_mat, ctx
from riccati_examples import Example

BITS = (256, 1024)
MAX_STEPS = 120
STARTS = (0, 1, 0.3)  # multiples of I: from 0 it breaks down where R is singular
EXACT = 1e-30  # the residual of a solution that may judge others
LARGE = 110
FACTOR = 10  # a step of Newton's method in double and in the units below comes to .2
EPS = float(np.finfo(float).eps)


class Truth(NamedTuple):
    """The stabilising solution, rounded to double, and the units of residual and error."""

    X: np.ndarray  # (n, n)
    K: np.ndarray  # (m, n)
    unit: np.ndarray  # (n,) of the residual
    Z: np.ndarray  # (n,) diagonal of the majorant: n eps Z is what rounding may do to X

    @property
    def condition(self) -> float:
        """Error of X, relative, per relative rounding of the terms."""
        x = np.abs(np.diag(self.X))
        seen = x > 1e-14 * self.Z
        return float(np.max(self.Z[seen] / x[seen]))


def truth(e: Example, *, discrete: bool) -> Truth:
    """The solution of an example and its units; a ValueError when none is found."""
    for bits in BITS:
        with ctx.workprec(bits):
            A, B, Q, R, N, E = _balls(e)
            try:
                back = E.inv()
                reduced = (A * back, B, back.transpose() * Q * back, R, back.transpose() * N)
                if len(e.A) > LARGE:
                    X = _newton(e)
                else:
                    X = _symmetric(_solve(*(reduced if discrete else _cayley(*reduced, _rate(e)))))
                K = _gain(A, B, R, N, E, X, discrete)
                unit = _units(_terms(e, _floats(X), _floats(K), discrete), e, discrete)
                P = _floats(_residual(A, B, Q, R, N, E, X, K, discrete))
                if np.max(np.abs(P) / np.outer(unit, unit)) > EXACT:
                    continue
                loop = (A - B * K) * back
                if len(e.A) > LARGE:
                    scaled = unit[:, None] * _floats(loop) / unit
                    z = np.diag(sla.solve_continuous_lyapunov(scaled.T, -np.eye(len(unit)))) * unit**2
                else:
                    D = back.transpose() * _diagonal((unit**2).tolist()) * back
                    Z = _stein(loop, D) if discrete else _stein(*_cayley_lyapunov(loop, D, _rate(e)))
                    z = np.diag(_floats(Z))
            except ZeroDivisionError:
                continue
            return Truth(_floats(X), _floats(K), unit, z)
    raise ValueError("no stabilising solution was found")


def residual(e: Example, X: np.ndarray, true: Truth, *, discrete: bool) -> float:
    """Residual of the equation at X, computed without rounding, in the units of the header."""
    with ctx.workprec(BITS[0]):
        A, B, Q, R, N, E = _balls(e)
        x = _ball(X)
        P = _residual(A, B, Q, R, N, E, x, _gain(A, B, R, N, E, x, discrete), discrete)
        return float(np.max(np.abs(_floats(P)) / np.outer(true.unit, true.unit)))


def gain_residual(e: Example, X: np.ndarray, K: np.ndarray, true: Truth, *, discrete: bool) -> float:
    """|R K - F| / (r unit' + |B'||X||E| + |N'|), r = sqrt(diag R), F = B'X E + N'; discrete: R + B'X B, B'X A + N'."""
    with ctx.workprec(BITS[0]):
        A, B, _, R, N, E = _balls(e)
        x, Bt, right = _ball(X), B.transpose(), A if discrete else E
        RX = R + Bt * x * B if discrete else R
        off = np.abs(_floats(RX * _ball(K) - Bt * x * right - N.transpose()))
        size = np.abs(e.B.T) @ np.abs(true.X) @ np.abs(_floats(right)) + np.abs(_floats(N.transpose()))
        return float(np.max(off / (np.outer(np.sqrt(np.abs(np.diag(_floats(RX)))), true.unit) + size)))


def error(X: np.ndarray, true: Truth) -> float:
    """|X - X*|_ij / sqrt(Z_ii Z_jj), the largest."""
    return float(np.max(np.abs(X - true.X) / np.sqrt(np.outer(true.Z, true.Z))))


def check_solution(e: Example, X: np.ndarray, true: Truth, *, discrete: bool) -> None:
    """Residual as small as that of the rounded solution allows, error as small as rounding of the terms allows."""
    n = len(e.A)
    at_best = residual(e, true.X, true, discrete=discrete)
    _assert_small("residual", residual(e, X, true, discrete=discrete), n * EPS + at_best)
    _assert_small("error of the solution", error(X, true), n * EPS)


def check_regulator(e: Example, K, S, poles, true: Truth, *, discrete: bool) -> None:
    """`check_solution`; the gain goes with S, the loop is stable, and the poles are the loop's."""
    check_solution(e, S, true, discrete=discrete)
    np.testing.assert_array_equal(S, S.T)
    _assert_small("residual of the gain", gain_residual(e, S, K, true, discrete=discrete), len(e.A) * EPS)
    M = e.A - e.B @ K
    M = true.unit[:, None] * (M if e.E is None else np.linalg.solve(e.E, M)) / true.unit
    for p in (np.linalg.eigvals(M), poles):
        assert (np.abs(p).max() < 1) if discrete else (p.real.max() < 0), f"unstable poles: {p}"
    for pole in poles[:30]:
        off = np.linalg.svd(M - pole * np.eye(len(M)), compute_uv=False)[-1] / np.linalg.norm(M)
        assert off <= 1e-12, f"{pole} is no pole of the loop, relative distance {off:.1e}"


def check_claims(result, true: Truth) -> None:
    """`residual` is one of rounding; `condition` has the order of the one here, whatever the norm it is measured in."""
    assert 0 <= result.residual <= FACTOR * len(true.X) * EPS
    assert 1 / 30 <= result.condition / true.condition <= 30, f"{result.condition:.1e}, here {true.condition:.1e}"


def _assert_small(what: str, found: float, unit: float) -> None:
    assert found <= FACTOR * unit, (
        f"{what}: {found / unit:.1e} times what rounding explains, at most {FACTOR} are allowed"
    )


def in_other_units(e: Example, seed: int, *, discrete: bool) -> Example:
    """States, equations, commands, cost and, where it is continuous, time in units up to a thousand times others."""
    rng = np.random.default_rng(seed)
    n, m = e.B.shape
    x, u, row = 10.0 ** rng.integers(-3, 4, n), 10.0 ** rng.integers(-3, 4, m), 10.0 ** rng.integers(-3, 4, n)
    cost, time = 10.0 ** rng.integers(-3, 4), 1.0 if discrete else 10.0 ** rng.integers(-3, 4)
    row = 1 / x if e.E is None else row
    Q, R = cost * x[:, None] * e.Q * x, cost * u[:, None] * e.R * u
    return e._replace(
        A=time * row[:, None] * e.A * x, B=time * row[:, None] * e.B * u,
        E=None if e.E is None else row[:, None] * e.E * x, X=None,
        Q=(Q + Q.T) / 2, R=(R + R.T) / 2, N=None if e.N is None else cost * x[:, None] * e.N * u,
    )  # fmt: skip


def in_other_coordinates(e: Example, seed: int) -> Example:
    """States, and commands, turned by orthogonal matrices."""
    rng = np.random.default_rng(seed)
    n, m = e.B.shape
    T, V = (np.linalg.qr(rng.standard_normal((k, k)))[0] for k in (n, m))
    Q, R = T.T @ e.Q @ T, V.T @ e.R @ V
    return e._replace(
        A=T.T @ e.A @ T, B=T.T @ e.B @ V, E=None if e.E is None else T.T @ e.E @ T, X=None,
        Q=(Q + Q.T) / 2, R=(R + R.T) / 2, N=None if e.N is None else T.T @ e.N @ V,
    )  # fmt: skip


def options(e: Example) -> dict[str, np.ndarray]:
    """N and E, where an example has them."""
    return {key: value for key, value in (("N", e.N), ("E", e.E)) if value is not None}


def _units(T: np.ndarray, e: Example, discrete: bool) -> np.ndarray:
    """sqrt(T_ii), and for states that nothing sees the unit of the commands or states that drive them, (n,)."""
    A, B = (np.abs(M if e.E is None else np.linalg.solve(e.E, M)) for M in (e.A, e.B))
    rate = 1.0 if discrete else _rate(e)
    seen = T > 1e-60 * T.max()
    r = np.sqrt(np.abs(np.diag(e.R)))
    size = np.where(seen, 1 / np.sqrt(np.where(seen, T, 1)), 0)  # of a state that costs one
    commanded = (B * np.where(r > 0, 1 / np.where(r > 0, r, 1), 0)).max(1)
    for _ in range(len(T)):
        size = np.where(seen, size, np.maximum(((A - np.diag(np.diag(A))) * size).max(1), commanded) / rate)
    return 1 / np.where(size > 0, size, 1)


def _newton(e: Example):
    """Continuous equation, E = I, from SciPy's solution; residual in balls, correction in double."""
    A, B, Q, R, N, E = _balls(e)
    X = _ball(sla.solve_continuous_are(e.A, e.B, e.Q, e.R, s=e.N))
    for _ in range(8):
        K = _gain(A, B, R, N, E, X, discrete=False)
        unit = np.sqrt(_terms(e, _floats(X), _floats(K), discrete=False))
        P = _floats(_residual(A, B, Q, R, N, E, X, K, discrete=False)) / np.outer(unit, unit)
        if np.abs(P).max() < EXACT:
            break
        loop = unit[:, None] * _floats(A - B * K) / unit
        X = _symmetric(X + _ball(sla.solve_continuous_lyapunov(loop.T, -P) * np.outer(unit, unit)))
    return X


def _solve(A, B, Q, R, N):
    """Stabilising solution of the discrete equation, by doubling from the first start that does not break down."""
    for start in STARTS:
        X0 = start * _eye(A.nrows())
        At, Bt = A.transpose(), B.transpose()
        try:
            return X0 + _double(A, B, Q + At * X0 * A - X0, R + Bt * X0 * B, N + At * X0 * B)
        except ZeroDivisionError:
            continue
    raise ZeroDivisionError(f"no convergence, n = {A.nrows()}")


def _double(A, B, Q, R, N):
    I, inverse = _eye(A.nrows()), R.inv()
    G, H = _symmetric(B * inverse * B.transpose()), _symmetric(Q - N * inverse * N.transpose())
    A = (A - B * inverse * N.transpose()).mid()
    for _ in range(MAX_STEPS):
        V = (I + G * H).mid().inv().mid()
        V1, V2 = V * A, V * G
        H, G = _symmetric(H + A.transpose() * H * V1), _symmetric(G + A * V2 * A.transpose())
        A = (A * V1).mid()
        if max(abs(float(x)) for x in A.entries()) < 1e-80:
            return H
    raise ZeroDivisionError


def _cayley(A, B, Q, R, N, rate):
    """The discrete equation with the same solution X; s = rate (z - 1)/(z + 1)."""
    g = arb(rate)
    M = (g * _eye(A.nrows()) - A).inv()
    F, MB = M * (g * _eye(A.nrows()) + A), M * B
    half = Q * MB + N
    root = (2 * g).sqrt()
    return (
        F.mid(),
        (root * MB).mid(),
        (2 * g * M.transpose() * Q * M).mid(),
        (R + MB.transpose() * half + N.transpose() * MB).mid(),
        (root * M.transpose() * half).mid(),
    )


def _cayley_lyapunov(loop, D, rate):
    g, I = arb(rate), _eye(loop.nrows())
    M = (g * I - loop).inv()
    return (M * (g * I + loop)).mid(), (2 * g * M.transpose() * D * M).mid()


def _stein(F, Z):
    """Z = D + F'Z F by squaring."""
    for _ in range(MAX_STEPS):
        Z, F = _symmetric(Z + F.transpose() * Z * F), (F * F).mid()
        if max(abs(float(x)) for x in F.entries()) < 1e-40:
            return Z
    raise ZeroDivisionError("the closed loop is not stable")


def _rate(e: Example) -> float:
    """Geometric mean of the Hamiltonian's eigenvalues, rad/s: any positive number is right, this one is quick."""
    A, B = (M if e.E is None else np.linalg.solve(e.E, M) for M in (e.A, e.B))
    H = np.block([[A, -B @ np.linalg.solve(e.R, B.T)], [-e.Q, -A.T]])
    moduli = np.abs(np.linalg.eigvals(H))
    moduli = moduli[moduli > 1e-14 * moduli.max(initial=0)]
    return float(np.exp(np.mean(np.log(moduli)))) * 1.09375 if len(moduli) else 1.0


def _gain(A, B, R, N, E, X, discrete: bool):
    Bt = B.transpose()
    if discrete:
        return ((R + Bt * X * B).inv() * (Bt * X * A + N.transpose())).mid()
    return (R.inv() * (Bt * X * E + N.transpose())).mid()


def _residual(A, B, Q, R, N, E, X, K, discrete: bool):
    At, Bt, Et = A.transpose(), B.transpose(), E.transpose()
    XA = X * A
    if discrete:
        return At * XA - Et * X * E + Q - K.transpose() * (Bt * XA + N.transpose())
    AXE = At * (X * E)
    return AXE + AXE.transpose() + Q - K.transpose() * (Bt * X * E + N.transpose())


def _terms(e: Example, X: np.ndarray, K: np.ndarray, discrete: bool) -> np.ndarray:
    """Diagonal of T of the header, (n,)."""
    n, m = e.B.shape
    a, b, q, r, x, k = (np.abs(M) for M in (e.A, e.B, e.Q, e.R, X, K))
    E, N = np.eye(n) if e.E is None else np.abs(e.E), np.zeros((n, m)) if e.N is None else np.abs(e.N)
    right, r = (a, r + b.T @ x @ b) if discrete else (E, r)
    quadratic = a.T @ x @ a + E.T @ x @ E if discrete else 2 * a.T @ x @ E
    return np.diag(quadratic + q + 2 * k.T @ (b.T @ x @ right + N.T) + k.T @ r @ k)


def _balls(e: Example):
    n, m = e.B.shape
    N = np.zeros((n, m)) if e.N is None else e.N
    return tuple(_ball(M) for M in (e.A, e.B, e.Q, e.R, N, np.eye(n) if e.E is None else e.E))


def _ball(M: np.ndarray):
    return arb_mat(np.asarray(M, dtype=float).tolist())


def _floats(M) -> np.ndarray:
    return np.array([float(x) for x in M.entries()]).reshape(M.nrows(), M.ncols())


def _symmetric(M):
    return ((M + M.transpose()) * arb(0.5)).mid()


def _eye(n: int):
    return _diagonal([1] * n)


def _diagonal(d):
    return arb_mat([[d[i] if i == j else 0 for j in range(len(d))] for i in range(len(d))])
