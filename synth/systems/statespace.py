"""Linear time-invariant systems x+ = A x + B u, y = C x + D u, as plain frozen data, and their algebra.

The timebase `dt` is 0 for continuous time and the sampling time in seconds for discrete time, or True where nobody said
it: one sample is then the unit of time, until a system with a sampling time joins. `as_system` (public name
`synth.system`) makes one of whatever users have; every function of the package calls it.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from synth.checks import (
    as_array,
    as_indices,
    as_matrix,
    as_names,
    as_sign,
    as_texts,
    as_timebase,
    as_units,
    as_whole,
    given_names,
    restore,
    shown,
)
from synth.errors import ModelError
from synth.systems import zeros as transmission
from synth.systems.convert import fitted, parts
from synth.systems.realization import Matrices, fraction, gain_at_rest, is_singular, loop_solve
from synth.systems.responses import Response, impulse, step
from synth.systems.timebase import common_timebase, retimed

if TYPE_CHECKING:
    import control


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A state-space system; checked when made, immutable, picklable.

    Numbers and vectors will do where they fit: B may be a list (a column), C a list (a row), D = 0.

    `G + H`, `G * H` (H first), `G / H`, `G ** 2`, `~G` (G(-s)' or G(1/z)'), `-G` and `G["output", 0]` make systems;
    numbers, matrices and systems of python-control and scipy may stand on either side.

    Raises
    ------
    ModelError : shapes do not fit, an entry is not finite, `dt` is no timebase, or names do not fit.
    """

    A: np.ndarray  # (n, n)
    B: np.ndarray  # (n, m)
    C: np.ndarray  # (p, n)
    D: np.ndarray  # (p, m)
    dt: float = 0.0  # s, 0 for continuous time, True for an unspecified sampling time
    u: tuple[str, ...] = ()  # (m) names of the inputs; u0, u1, ... when left out
    y: tuple[str, ...] = ()  # (p) names of the outputs; y0, y1, ... when left out
    units: Mapping[str, str] = field(default_factory=dict)  # name -> unit
    continuous: StateSpace | None = field(default=None, repr=False)  # what `c2d` sampled with a hold, for builders
    __setstate__ = restore
    __array_ufunc__ = None  # NumPy's operators leave systems to the operators below

    def __post_init__(self):
        for name, M in zip("ABCD", fitted(self.A, self.B, self.C, self.D), strict=True):
            M.flags.writeable = False
            object.__setattr__(self, name, M)
        object.__setattr__(self, "dt", as_timebase(self.dt))
        object.__setattr__(self, "u", as_names("u", self.u, self.nu))
        object.__setattr__(self, "y", as_names("y", self.y, self.ny))
        if unknown := set(as_units(self.units)) - {*self.u, *self.y}:
            raise ModelError(f"units are given for {sorted(map(str, unknown))}, which are no signals of the system")
        object.__setattr__(self, "units", dict(self.units))

    @classmethod
    def of(cls, system: Any) -> StateSpace:
        """From any description of a linear system; see `synth.system`, which also takes names and a timebase."""
        return as_system("the system", system)

    @classmethod
    def gain(cls, D: Any, dt: float) -> StateSpace:
        """The gain y = D u, (p, m), as a system without states."""
        return cls(np.zeros((0, 0)), np.zeros((0, 0)), np.zeros((0, 0)), as_matrix("D", D), dt)

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

    @property
    def matrices(self) -> Matrices:
        """A, B, C, D."""
        return Matrices(self.A, self.B, self.C, self.D)

    def poles(self) -> np.ndarray:
        """Eigenvalues of A, (n,) complex."""
        return np.linalg.eigvals(self.A)

    def zeros(self) -> np.ndarray:
        """Transmission zeros, complex: where the transfer matrix loses rank (Emami-Naeini and Van Dooren 1982)."""
        return transmission.transmission_zeros(self.A, self.B, self.C, self.D)

    @property
    def named_inputs(self) -> tuple[str, ...]:
        """The names of the inputs if somebody gave them, else their numbers: what derived signals are called by."""
        return given_names("u", self.u)

    @property
    def named_outputs(self) -> tuple[str, ...]:
        """The names of the outputs if somebody gave them, else their numbers."""
        return given_names("y", self.y)

    def dcgain(self) -> np.ndarray:
        """The gain at rest, (p, m): each entry at s = 0 or z = 1, inf where a pole stands there."""
        return np.array(
            [
                [gain_at_rest(self[i, j].matrices, discrete=self.discrete) for j in range(self.nu)]
                for i in range(self.ny)
            ]
        )

    def frequency_response(self, omega: Any) -> np.ndarray:
        """Transfer matrix at `omega` rad/s: (p, m) complex for a number, (N, p, m) for N of them."""
        grid = as_array("omega", omega, "pass frequencies in rad/s")
        points = np.exp(1j * grid * self.dt) if self.discrete else 1j * grid
        responses = [self.C @ np.linalg.solve(s * np.eye(self.n) - self.A, self.B) + self.D for s in points.ravel()]
        return np.reshape(responses, (*grid.shape, self.ny, self.nu))

    def step_response(self, time: Any = None) -> Response:
        """Answers to unit steps, one input after the other; `time` is a grid or its end in s, chosen by default."""
        return step(self.A, self.B, self.C, self.D, self.dt, time, self.u, self.y)

    def impulse_response(self, time: Any = None) -> Response:
        """Answers to impulses of area one; `time` as in `step_response`. Continuous ones leave a direct term out."""
        return impulse(self.A, self.B, self.C, self.D, self.dt, time, self.u, self.y)

    def transform(self, T: np.ndarray) -> StateSpace:
        """The same system in the coordinates x = T x_new."""
        T = as_matrix("T", T, (self.n, self.n))
        try:
            A, B = np.linalg.solve(T, self.A @ T), np.linalg.solve(T, self.B)
        except np.linalg.LinAlgError:
            raise ModelError("T is singular; pass coordinates x = T x_new that can be undone") from None
        return replace(self, A=A, B=B, C=self.C @ T)

    def digest(self) -> str:
        """SHA-256 over the exact bits of the matrices and the timebase."""
        h = hashlib.sha256()
        for M in (self.A, self.B, self.C, self.D, np.array(self.dt)):
            h.update(repr(M.shape).encode())
            h.update(np.ascontiguousarray(M, dtype="<f8").tobytes())
        h.update(b"unspecified" * (self.dt is True))
        return h.hexdigest()

    def to_control(self) -> control.StateSpace:
        """The same system as a `control.StateSpace`, with its names."""
        import control

        return control.StateSpace(self.A, self.B, self.C, self.D, self.dt, inputs=list(self.u), outputs=list(self.y))

    def tf(self) -> control.TransferFunction:
        """The transfer matrix as a `control.TransferFunction`, entry by entry without what cancels."""
        import control

        entries = [[fraction(self[i, j].matrices) for j in range(self.nu)] for i in range(self.ny)]
        num, den = ([[entry[k] for entry in row] for row in entries] for k in (0, 1))
        return control.TransferFunction(num, den, self.dt, inputs=list(self.u), outputs=list(self.y))

    def inverse(self) -> StateSpace:
        """The system from y to u.

        Raises
        ------
        ModelError : D is not square and invertible, so that the inverse would be improper.
        """
        if self.ny != self.nu or is_singular(self.D):
            raise ModelError(
                f"the inverse of a {self.ny} x {self.nu} system with D = {shown(self.D.tolist())} is improper; a "
                "system has an inverse when D is square and invertible"
            )
        Di = np.linalg.inv(self.D)
        A, B = self.A - self.B @ Di @ self.C, self.B @ Di
        return StateSpace(A, B, -Di @ self.C, Di, self.dt)

    def feedback(self, K: Any = 1, sign: int = -1) -> StateSpace:
        """The loop y = G (u + sign K y), negative by default; also what `control.feedback` calls."""
        sign = as_sign(sign)
        K = _matched("K", K, self, square=True)
        K = -K if sign == -1 else K
        check_loop("G", self, "K", K)
        # v = u + K y = (I - Dk D)^-1 (u + Ck xk + Dk C x)
        V = loop_solve(K.D @ self.D, np.hstack([K.D @ self.C, K.C, np.eye(self.nu)]))
        if V is None:
            raise ModelError("the loop is not well posed: I - Dk D is singular; perturb one of the direct terms")
        Y = np.hstack([self.C, np.zeros((self.ny, K.n)), np.zeros((self.ny, self.nu))]) + self.D @ V
        n = self.n + K.n
        top = np.hstack([self.A, np.zeros((self.n, K.n + self.nu))]) + self.B @ V
        bottom = np.hstack([np.zeros((K.n, self.n)), K.A, np.zeros((K.n, self.nu))]) + K.B @ Y
        AB = np.vstack([top, bottom])
        return StateSpace(AB[:, :n], AB[:, n:], Y[:, :n], Y[:, n:], K.dt, self.u, self.y, self.units)

    def __getitem__(self, key: Any) -> StateSpace:
        """The system of some outputs and inputs, G[outputs, inputs]; by number, name, slice or list of them."""
        if not (isinstance(key, tuple) and len(key) == 2):
            raise ModelError(f"the index is {shown(key)}; pass outputs and inputs, as in G['angle', 0] or G[:, 1]")
        i, j = as_indices("output", key[0], self.y), as_indices("input", key[1], self.u)
        u, y = tuple(self.u[k] for k in j), tuple(self.y[k] for k in i)
        units = {name: unit for name, unit in self.units.items() if name in (*u, *y)}
        return StateSpace(self.A, self.B[:, j], self.C[i], self.D[np.ix_(i, j)], self.dt, u, y, units)

    def __neg__(self) -> StateSpace:
        return replace(self, C=-self.C, D=-self.D)

    def __add__(self, other: Any) -> StateSpace:
        G, H = self, _operand(other, self, wide=True)
        if (G.ny, G.nu) != (H.ny, H.nu):
            raise ModelError(f"a {G.ny} x {G.nu} and a {H.ny} x {H.nu} system cannot be added; sizes must agree")
        A = np.block([[G.A, np.zeros((G.n, H.n))], [np.zeros((H.n, G.n)), H.A]])
        return replace(G, A=A, B=np.vstack([G.B, H.B]), C=np.hstack([G.C, H.C]), D=G.D + H.D, dt=H.dt)

    def __radd__(self, other: Any) -> StateSpace:
        return self + other

    def __sub__(self, other: Any) -> StateSpace:
        return self + -_operand(other, self, wide=True)

    def __rsub__(self, other: Any) -> StateSpace:
        return -self + other

    def __mul__(self, other: Any) -> StateSpace:
        H = _operand(other, self)
        G, H = repeated(self, H.ny), repeated(H, self.nu)
        if G.nu != H.ny:
            raise ModelError(f"the first system has {H.ny} outputs, the second {G.nu} inputs; they must agree")
        A = np.block([[H.A, np.zeros((H.n, G.n))], [G.B @ H.C, G.A]])
        B, C = np.vstack([H.B, G.B @ H.D]), np.hstack([G.D @ H.C, G.C])
        units = {n: H.units[n] for n in H.u if n in H.units} | {n: G.units[n] for n in G.y if n in G.units}
        return StateSpace(A, B, C, G.D @ H.D, H.dt, H.u, G.y, units)

    def __rmul__(self, other: Any) -> StateSpace:
        return _operand(other, self) * self

    def __truediv__(self, other: Any) -> StateSpace:
        return self * _operand(other, self).inverse()

    def __rtruediv__(self, other: Any) -> StateSpace:
        return _operand(other, self) * self.inverse()

    def __pow__(self, power: int) -> StateSpace:
        power = as_whole("the power", power, "a whole number", least=-(10**6))
        if self.ny != self.nu:
            raise ModelError(f"a {self.ny} x {self.nu} system has no powers; it must be square")
        base = self.inverse() if power < 0 else self
        product = StateSpace.gain(np.eye(self.nu), self.dt)
        for _ in range(abs(power)):
            product = product * base
        return product

    def __invert__(self) -> StateSpace:
        """G(-s)' in continuous, G(1/z)' in discrete time, the conjugate transpose on the stability boundary."""
        if not self.discrete:
            return StateSpace(-self.A.T, -self.C.T, self.B.T, self.D.T, 0.0)
        if self.n and is_singular(self.A):
            raise ModelError("~G has poles at infinity where G has poles at z = 0 (pure delays); it is improper")
        Ait = np.linalg.inv(self.A).T
        return StateSpace(Ait, Ait @ self.C.T, -self.B.T @ Ait, self.D.T - self.B.T @ Ait @ self.C.T, self.dt)


def as_system(name: str, value: Any, dt: float | None = None) -> StateSpace:
    """Any description of a linear system as a StateSpace; `name` is how messages call it.

    `dt` is the timebase of its company, for gains that have none of their own; continuous when there is no company.
    """
    if isinstance(value, StateSpace):
        return value
    found = parts(name, value)
    timebase = found.dt if found.dt is not None else (dt or 0.0)
    try:
        return StateSpace(*found[:4], timebase, found.u, found.y, found.units or {})
    except ModelError as error:
        raise ModelError(f"{name}: {error}") from None


def as_systems(**systems: Any) -> list[StateSpace]:
    """Several systems that work together, by name: gains take the timebase of the others, which must agree."""
    own = (G.dt if isinstance(G, StateSpace) else parts(name, G).dt for name, G in systems.items())
    base = next((dt for dt in own if dt is not None), None)
    found = [as_system(name, G, base) for name, G in systems.items()]
    for name, G in zip(list(systems)[1:], found[1:], strict=True):
        found[0] = retimed(found[0], common_timebase(found[0], G, (next(iter(systems)), name)))
    return [retimed(G, found[0].dt) for G in found]


def system(*description: Any, dt: Any = None, u: Any = (), y: Any = (), units: Any = None) -> StateSpace:
    """A linear system from whatever describes it; every function of this package takes the same forms.

    Parameters
    ----------
    description : one of

        - a StateSpace, a GeneralizedPlant, any object with A, B, C, D and dt
        - a system of python-control (state space, transfer function, zpk; nonlinear ones where they rest), of
          scipy.signal or harold
        - A, B, C, D[, dt] or num, den[, dt], as arguments or as a tuple; polynomials have the highest power first,
          transfer matrices are lists of rows of polynomials
        - a mapping with these keys, or with zeros, poles, gain
        - a number, vector or matrix: a gain

    dt : s, 0 for continuous time, True for an unspecified sampling time; needed by discrete transfer functions that do
        not say it, and for gains; says the sampling time of a system that has an unspecified one
    u, y : names of inputs and outputs; those of the description when left out
    units : name -> unit

    Returns
    -------
    StateSpace; of a transfer matrix a minimal realisation, whose response agrees with the polynomials to 1e-8

    Raises
    ------
    ModelError : it is no linear system, is improper, or has no timebase; frequency response data is no system.

    Examples
    --------
    >>> from synth import system
    >>> G = system([1], [1, 0.4, 1])  # 1 / (s^2 + 0.4 s + 1)
    >>> G.n, float(G.dcgain()[0, 0])
    (2, 1.0)
    """
    if not description:
        raise ModelError("no system was given; pass one, for example system([1], [1, 1])")
    value = description[0] if len(description) == 1 else tuple(description)
    if dt is not None and isinstance(value, tuple) and len(value) in (2, 4):
        value = (*value, dt)
    if dt is not None and isinstance(value, Mapping):
        value = {"dt": dt, **value}
    G = as_system("the system", value, None if dt is None else as_timebase(dt))
    named = {key: as_texts(key, () if names is None else names) for key, names in (("u", u), ("y", y))}
    changes: dict[str, Any] = {key: names for key, names in named.items() if names}
    if changes or units is not None:
        changes["units"] = {} if units is None else units
    if dt is not None:
        timebase = as_timebase(dt)
        G = retimed(G, timebase) if timebase else G
        if timebase != G.dt or (timebase is True) != (G.dt is True):
            raise ModelError(f"the system has the timebase {G.dt} s and dt = {dt} was given; convert it with c2d")
    return replace(G, **changes) if changes else G


def check_loop(name: str, G: StateSpace, controller: str, K: StateSpace) -> None:
    """Raise ModelError unless K takes the outputs of G and makes its inputs."""
    if (K.ny, K.nu) != (G.nu, G.ny):
        raise ModelError(
            f"the controller {controller} is {K.ny} x {K.nu}; {name}, which is {G.ny} x {G.nu} (outputs x inputs), "
            f"needs {G.nu} x {G.ny}"
        )


def _matched(name: str, value: Any, G: StateSpace, *, square: bool = False) -> StateSpace:
    """Another system beside G; a number is that multiple of the identity where `square` says so."""
    if np.isscalar(value) and not isinstance(value, str | bytes | bool):
        size = G.nu if square and G.ny == G.nu else 1
        value = as_array(name, value) * np.eye(size)
    K = as_system(name, value, G.dt)
    return retimed(K, common_timebase(G, K))


def _operand(other: Any, G: StateSpace, *, wide: bool = False) -> StateSpace:
    """The other operand of an operator; in a sum a number stands for a matrix of it (`wide`)."""
    if wide and np.isscalar(other) and not isinstance(other, str | bytes | bool):
        other = as_array("the other operand", other) * np.ones((G.ny, G.nu))
    return _matched("the other operand", other, G)


def repeated(G: StateSpace, size: int) -> StateSpace:
    """A system of one signal for every one of several channels."""
    if size == 1 or (G.ny, G.nu) != (1, 1):
        return G
    I = np.eye(size)
    return StateSpace(np.kron(I, G.A), np.kron(I, G.B), np.kron(I, G.C), np.kron(I, G.D), G.dt)
