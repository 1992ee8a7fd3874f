"""Linear time-invariant systems x+ = A x + B u, y = C x + D u, as plain frozen data.

The timebase `dt` is 0 for continuous time and the sampling time in seconds for discrete time. `lft` and
`feedback` state their sign: `lft` is the positive one of H-infinity theory (u = K y), `feedback` the negative one.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

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


def is_singular(M: np.ndarray, size: float | np.floating) -> bool:
    """Singular to working precision, for a matrix that is the difference of matrices of norm `size`."""
    return bool(np.linalg.svd(M, compute_uv=False).min(initial=np.inf) <= 1e-14 * size)
