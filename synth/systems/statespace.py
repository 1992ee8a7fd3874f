"""Linear time-invariant systems x+ = A x + B u, y = C x + D u, as plain frozen data.

The timebase `dt` is 0 for continuous time and the sampling time in seconds for discrete time. `lft` and
`feedback` state their sign: `lft` is the positive one of H-infinity theory (u = K y), `feedback` the negative one.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.linalg as sla

from synth.errors import ModelError

if TYPE_CHECKING:
    import control


def as_matrix(name: str, value: Any, shape: tuple[int | None, int | None] = (None, None)) -> np.ndarray:
    """A finite float64 matrix, or a ModelError that names it; `None` in `shape` accepts any size."""
    try:
        M = np.array(value, dtype=float, ndmin=2)
    except (TypeError, ValueError) as error:
        raise ModelError(f"{name} is not a real matrix ({error}); pass numbers in rows and columns") from None
    if M.ndim != 2:
        raise ModelError(f"{name} has {M.ndim} dimensions; pass a matrix")
    if any(want is not None and have != want for have, want in zip(M.shape, shape, strict=True)):
        want = " x ".join("any" if s is None else str(s) for s in shape)
        raise ModelError(
            f"{name} is {M.shape[0]} x {M.shape[1]} where {want} is needed; check the partition of the plant"
        )
    if not np.isfinite(M).all():
        i, j = np.argwhere(~np.isfinite(M))[0]
        raise ModelError(f"{name}[{i}, {j}] is {M[i, j]}; every entry must be finite")
    return M


def as_timebase(dt: Any) -> float:
    """Sampling time in seconds, 0 for continuous time, or a ModelError."""
    if isinstance(dt, bool) or dt is None:
        raise ModelError(
            f"dt is {dt}: the timebase is unspecified; pass 0 (continuous) or the sampling time in seconds"
        )
    try:
        value = float(dt)
    except (TypeError, ValueError):
        raise ModelError(f"dt is {dt!r}; pass 0 (continuous) or the sampling time in seconds") from None
    if not np.isfinite(value) or value < 0:
        raise ModelError(f"dt is {value}; pass 0 (continuous) or a positive sampling time in seconds")
    return value


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A state-space system; checked when made, immutable, picklable.

    Raises
    ------
    ModelError : shapes do not fit, an entry is not finite, or `dt` is no timebase.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    C: np.ndarray  # (p, n)
    D: np.ndarray  # (p, m)
    dt: float = 0.0  # s, 0 for continuous time

    def __post_init__(self):
        D = as_matrix("D", self.D)
        p, m = D.shape
        n = np.shape(self.A)[0] if np.size(self.A) else 0
        empty = n == 0
        A = np.zeros((0, 0)) if empty else as_matrix("A", self.A, (n, n))
        B = np.zeros((0, m)) if empty else as_matrix("B", self.B, (n, m))
        C = np.zeros((p, 0)) if empty else as_matrix("C", self.C, (p, n))
        for name, M in zip("ABCD", (A, B, C, D), strict=True):
            M.flags.writeable = False
            object.__setattr__(self, name, M)
        object.__setattr__(self, "dt", as_timebase(self.dt))

    @classmethod
    def gain(cls, D: Any, dt: float) -> StateSpace:
        """The gain y = D u, (p, m), as a system without states."""
        return cls(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), D, dt)

    def __neg__(self) -> StateSpace:
        """The system with the signs of its outputs changed."""
        return StateSpace(self.A, self.B, -self.C, -self.D, self.dt)

    @property
    def n(self) -> int:
        """Number of states."""
        return self.A.shape[0]

    @property
    def nu(self) -> int:
        """Number of inputs."""
        return self.D.shape[1]

    @property
    def ny(self) -> int:
        """Number of outputs."""
        return self.D.shape[0]

    @property
    def discrete(self) -> bool:
        """True when `dt` > 0."""
        return self.dt > 0

    def poles(self) -> np.ndarray:
        """Eigenvalues of A, (n,) complex."""
        return np.linalg.eigvals(self.A)

    def frequency_response(self, omega: float) -> np.ndarray:
        """Transfer matrix at `omega` rad/s, (p, m) complex."""
        s = np.exp(1j * omega * self.dt) if self.discrete else 1j * omega
        return self.C @ np.linalg.solve(s * np.eye(self.n) - self.A, self.B) + self.D

    def transform(self, T: np.ndarray) -> StateSpace:
        """The same system in the coordinates x = T x_new."""
        return StateSpace(np.linalg.solve(T, self.A @ T), np.linalg.solve(T, self.B), self.C @ T, self.D, self.dt)

    def digest(self) -> str:
        """SHA-256 over the exact bits of the matrices and the timebase."""
        h = hashlib.sha256()
        for M in (self.A, self.B, self.C, self.D, np.array(self.dt)):
            h.update(repr(M.shape).encode())
            h.update(np.ascontiguousarray(M, dtype="<f8").tobytes())
        return h.hexdigest()

    def to_control(self) -> control.StateSpace:
        """The same system as a `control.StateSpace`."""
        import control

        return control.StateSpace(self.A, self.B, self.C, self.D, self.dt)

    @classmethod
    def of(cls, system: Any) -> StateSpace:
        """From a StateSpace, a `control.StateSpace` or a tuple (A, B, C, D[, dt])."""
        if isinstance(system, StateSpace):
            return system
        if isinstance(system, tuple | list):
            if len(system) not in (4, 5):
                raise ModelError(f"a system of {len(system)} entries was given; pass (A, B, C, D) or (A, B, C, D, dt)")
            return cls(*system)
        if all(hasattr(system, name) for name in "ABCD"):
            dt = getattr(system, "dt", None)
            return cls(
                np.asarray(system.A),
                np.asarray(system.B),
                np.asarray(system.C),
                np.asarray(system.D),
                as_timebase(dt),
            )
        raise ModelError(
            f"{type(system).__name__} is no state-space system; pass StateSpace, control.StateSpace or (A, B, C, D, dt)"
        )


def _is_singular(M: np.ndarray, size: float | np.floating) -> bool:
    """Singular to working precision, for a matrix that is the difference of matrices of norm `size`."""
    return bool(np.linalg.svd(M, compute_uv=False).min(initial=np.inf) <= 1e-14 * size)


def common_timebase(G: StateSpace, K: StateSpace) -> float:
    """The timebase two systems share, or a ModelError."""
    if not np.isclose(G.dt, K.dt, rtol=1e-12, atol=0):
        raise ModelError(f"the systems have timebases {G.dt} and {K.dt} s; convert one with c2d first")
    return G.dt


def series(G: StateSpace, H: StateSpace) -> StateSpace:
    """H after G: y = H G u."""
    dt = common_timebase(G, H)
    if G.ny != H.nu:
        raise ModelError(f"the first system has {G.ny} outputs, the second {H.nu} inputs; they must agree")
    A = np.block([[G.A, np.zeros((G.n, H.n))], [H.B @ G.C, H.A]])
    return StateSpace(A, np.vstack([G.B, H.B @ G.D]), np.hstack([H.D @ G.C, H.C]), H.D @ G.D, dt)


def delayed(G: StateSpace) -> StateSpace:
    """A discrete system whose outputs come one sample later."""
    p = G.ny
    return series(G, StateSpace(np.zeros((p, p)), np.eye(p), np.eye(p), np.zeros((p, p)), G.dt))


def feedback(G: StateSpace, K: StateSpace) -> StateSpace:
    """Negative feedback y = G (u - K y)."""
    dt = common_timebase(G, K)
    m, p = G.nu, G.ny
    P = StateSpace(G.A, np.hstack([G.B, G.B]), np.vstack([G.C, G.C]), np.vstack([np.hstack([G.D, G.D])] * 2), dt)
    if (K.nu, K.ny) != (p, m):
        raise ModelError(f"the controller is {K.ny} x {K.nu} where {m} x {p} is needed")
    return lft(P, -K, p, m)


def lft(P: StateSpace, K: StateSpace, nmeas: int, ncon: int) -> StateSpace:
    """Lower linear fractional transformation: P closed by u = K y (positive feedback).

    u and y are the last `ncon` inputs and `nmeas` outputs of P.

    Raises
    ------
    ModelError : dimensions or timebases disagree, or the loop is not well posed (I - D22 Dk is singular).
    """
    dt = common_timebase(P, K)
    if (K.ny, K.nu) != (ncon, nmeas):
        raise ModelError(f"the controller is {K.ny} x {K.nu} where {ncon} x {nmeas} is needed (ncon x nmeas)")
    if not (0 < nmeas < P.ny + 1 and 0 < ncon < P.nu + 1):
        raise ModelError(f"nmeas = {nmeas}, ncon = {ncon} do not fit a plant with {P.ny} outputs and {P.nu} inputs")
    mw, pz = P.nu - ncon, P.ny - nmeas
    B1, B2 = P.B[:, :mw], P.B[:, mw:]
    C1, C2 = P.C[:pz], P.C[pz:]
    D11, D12, D21, D22 = P.D[:pz, :mw], P.D[:pz, mw:], P.D[pz:, :mw], P.D[pz:, mw:]
    E = np.eye(ncon) - K.D @ D22
    if _is_singular(E, 1 + np.linalg.norm(K.D @ D22, 2)):
        raise ModelError("the loop is not well posed: I - Dk D22 is singular; perturb D22 or the controller's D")
    # u = E^-1 (Ck xk + Dk C2 x + Dk D21 w), y = C2 x + D21 w + D22 u
    U = np.linalg.solve(E, np.hstack([K.D @ C2, K.C, K.D @ D21]))
    Y = np.hstack([C2, np.zeros((nmeas, K.n)), D21]) + D22 @ U
    x, w = slice(0, P.n + K.n), slice(P.n + K.n, None)
    top = np.hstack([P.A, np.zeros((P.n, K.n)), B1]) + B2 @ U
    bottom = np.hstack([np.zeros((K.n, P.n)), K.A, np.zeros((K.n, mw))]) + K.B @ Y
    out = np.hstack([C1, np.zeros((pz, K.n)), D11]) + D12 @ U
    AB = np.vstack([top, bottom])
    return StateSpace(AB[:, x], AB[:, w], out[:, x], out[:, w], dt)


def c2d(G: StateSpace, dt: float, method: str = "zoh") -> StateSpace:
    """Continuous to discrete: `"zoh"` exact hold equivalent, `"tustin"` bilinear.

    Parameters
    ----------
    dt : sampling time in seconds, positive.
    """
    if G.discrete:
        raise ModelError(f"the system is already discrete (dt = {G.dt} s); c2d takes a continuous one")
    if as_timebase(dt) == 0:
        raise ModelError("dt is 0; pass the sampling time in seconds")
    if method not in ("zoh", "tustin"):
        raise ModelError(f"method is {method!r}; pass 'zoh' or 'tustin'")
    if G.n == 0:
        return StateSpace(G.A, G.B, G.C, G.D, dt)
    if method == "zoh":
        M = sla.expm(dt * np.block([[G.A, G.B], [np.zeros((G.nu, G.n + G.nu))]]))
        return StateSpace(M[: G.n, : G.n], M[: G.n, G.n :], G.C, G.D, dt)
    return cayley(G, 2 / dt, dt)


def cayley(G: StateSpace, rate: float, dt: float = 1.0) -> StateSpace:
    """Norm-preserving map of a continuous system to a discrete one, s = rate (z - 1)/(z + 1).

    Stability, H-infinity norm and stabilisability carry over exactly; `inverse_cayley` is the way back.

    Raises
    ------
    ModelError : `rate` (rad/s) is an eigenvalue of A.
    """
    E = rate * np.eye(G.n) - G.A
    if _is_singular(E, rate + np.linalg.norm(G.A, 2)):
        raise ModelError(f"{rate} rad/s is an eigenvalue of A: choose another rate for the Cayley map")
    A = np.linalg.solve(E, rate * np.eye(G.n) + G.A)
    B = np.sqrt(2 * rate) * np.linalg.solve(E, G.B)
    C = np.sqrt(2 * rate) * np.linalg.solve(E.T, G.C.T).T
    D = G.D + G.C @ np.linalg.solve(E, G.B)
    return StateSpace(A, B, C, D, dt)


def cayley_rate(G: StateSpace) -> float:
    """A rate in rad/s for the Cayley map: the geometric mean of the pole moduli, away from every pole."""
    moduli = np.abs(G.poles())
    moduli = moduli[moduli > 1e-8 * max(moduli.max(initial=0.0), 1e-300)]
    rate = float(np.exp(np.log(moduli).mean())) if moduli.size else 1.0
    while G.n and np.abs(G.poles() - rate).min() < 1e-2 * rate:
        rate *= 1.1
    return rate


def inverse_cayley(G: StateSpace, rate: float) -> StateSpace:
    """The way back from `cayley`: z = (rate + s)/(rate - s).

    Raises
    ------
    ModelError : -1 is an eigenvalue of A, that is, the continuous system would be improper.
    """
    E = G.A + np.eye(G.n)
    if _is_singular(E, 1 + np.linalg.norm(G.A, 2)):
        raise ModelError("-1 is an eigenvalue of A: the continuous system would not be proper")
    A = rate * np.linalg.solve(E, G.A - np.eye(G.n))
    B = np.sqrt(2 * rate) * np.linalg.solve(E, G.B)
    C = np.sqrt(2 * rate) * np.linalg.solve(E.T, G.C.T).T
    D = G.D - G.C @ np.linalg.solve(E, G.B)
    return StateSpace(A, B, C, D, 0.0)
