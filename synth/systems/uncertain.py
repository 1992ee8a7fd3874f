"""Uncertain linear systems E x+ = A x + B u, y = C x + D u: entries are polynomials in parameters of known ranges.

The descriptor form is what keeps them polynomial: an inertia is linear in the mass matrix E, where 1/J in A would be
rational. Nothing is rounded: entries keep exact rational coefficients until a certain system is asked for (`at`).

Rows and columns of E without any entry belong to algebraic states, 0 = A x + B u. Where the direct terms of both sides
of a loop meet, I - Dk D22 has no polynomial inverse either: the control becomes an algebraic state there.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any

import numpy as np

from synth.checks import as_flag, as_names, as_number, as_sign, as_timebase, as_whole, shown, timebase_told
from synth.errors import ModelError
from synth.systems.expressions import eye, fitted, product, square, zeros
from synth.systems.parameters import Expression, Hold, Parameter, Remainder, as_expression, joined
from synth.systems.realization import Matrices, is_singular
from synth.systems.statespace import StateSpace, as_system
from synth.systems.timebase import common_timebase

MOST_PARAMETERS = 20
MOST_POINTS = 100_000  # of a grid
Values = dict[str, float]


@dataclass(frozen=True, eq=False)
class UncertainSystem:
    """A system whose matrices depend on `ureal` parameters; checked when made, immutable.

    Matrices are numbers, expressions, lists of rows or arrays that mix both; vectors become the column or row that
    fits, D = 0 takes its size from B and C, and E is the identity when left out.

    Raises
    ------
    ModelError : shapes do not fit, an entry is not finite, one name stands for two parameters, `dt` is no timebase, or
        E is singular at the nominal parameters in more than its empty rows and columns.

    Examples
    --------
    >>> from synth import UncertainSystem, ureal
    >>> J = ureal("J", 2.0, percentage=25)
    >>> G = UncertainSystem(E=[[1, 0], [0, J]], A=[[0, 1], [-1, -0.1]], B=[0, 1], C=[1, 0])
    >>> [round(float(abs(pole)), 4) for pole in G.at({"J": 2.5}).poles()]
    [0.6325, 0.6325]
    """

    E: Any = None  # (n, n)
    A: Any = None  # (n, n)
    B: Any = None  # (n, m)
    C: Any = None  # (p, n)
    D: Any = 0  # (p, m)
    dt: float = 0.0  # s, 0 for continuous time, True for an unspecified sampling time
    u: tuple[str, ...] = ()  # (m) names of the inputs
    y: tuple[str, ...] = ()  # (p) names of the outputs
    __array_ufunc__ = None

    def __post_init__(self):
        for name in "ABC":
            if getattr(self, name) is None:
                raise ModelError(f"{name} is None; pass the matrices of E x+ = A x + B u, y = C x + D u")
        A, B, C, D = fitted(self.A, self.B, self.C, self.D)
        E = eye(len(A)) if self.E is None else square("E", self.E, len(A))
        for name, M in zip("EABCD", (E, A, B, C, D), strict=True):
            M.flags.writeable = False
            object.__setattr__(self, name, M)
        object.__setattr__(self, "dt", as_timebase(self.dt))
        object.__setattr__(self, "u", as_names("u", self.u, self.nu))
        object.__setattr__(self, "y", as_names("y", self.y, self.ny))
        if len(self.parameters) > MOST_PARAMETERS:
            raise ModelError(f"there are {len(self.parameters)} parameters; at most {MOST_PARAMETERS} can be handled")
        for hold in self._holds:
            hold.check("the range", {name: p.range for name, p in self.parameters.items()})
        self._reduced({})

    @property
    def parameters(self) -> dict[str, Parameter]:
        """The parameters that occur, by name, in alphabetical order."""
        return {name: p for name, p in self._symbols.items() if not isinstance(p, Remainder)}

    @property
    def remainders(self) -> dict[str, Remainder]:
        """What entries of a hold equivalent are off their polynomials: proved ranges, part of every proof."""
        return {name: p for name, p in self._symbols.items() if isinstance(p, Remainder)}

    @property
    def _holds(self) -> set[Hold]:
        return {p.hold for p in self.remainders.values()}

    @cached_property
    def _symbols(self) -> dict[str, Parameter]:
        found = joined(*(entry.parameters for M in (self.E, self.A, self.B, self.C, self.D) for entry in M.flat))
        return dict(sorted(found.items()))

    @property
    def n(self) -> int:
        """Number of states, algebraic ones included."""
        return len(self.A)

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
    def nominal(self) -> StateSpace:
        """The system at the nominal parameters."""
        return self.at({})

    def at(self, values: Mapping[str, float], *, within: bool = True) -> StateSpace:
        """The certain system at these values; parameters that are not named have their nominal ones.

        Parameters
        ----------
        values : name -> value
        within : whether values outside the ranges are refused

        Raises
        ------
        ModelError : no such parameter, a value outside its range, or E is singular there.

        Of a hold equivalent (`c2d`) it is the polynomial, without what `remainders` bound, and only inside its box.
        """
        within = as_flag("within", within)
        if not isinstance(values, Mapping):
            raise ModelError(f"values is {shown(values)}; pass names with values, such as {{'J': 500.0}}")
        parameters, found = self.parameters, {}
        for name, value in values.items():
            if name not in parameters:
                raise ModelError(
                    f"values has {shown(name)}, which is no parameter; there are {', '.join(parameters) or 'none'}"
                )
            p, found[name] = parameters[name], as_number(f"values[{name!r}]", value, "a finite number")
            if within and not p.low <= found[name] <= p.high:
                raise ModelError(
                    f"values[{name!r}] is {found[name]:.17g}, outside [{p.low:.17g}, {p.high:.17g}]; pass one inside, "
                    "or within=False"
                )
        for hold in self._holds:
            hold.check("the value", {name: (x, x) for name, x in found.items()})
        return StateSpace(*self._reduced(found), self.dt, self.u, self.y)

    def sample(self, n: int, seed: int = 0) -> list[tuple[Values, StateSpace]]:
        """`n` systems at parameters drawn uniformly from their ranges, each with its values."""
        n = as_whole("n", n, f"a number of systems from 1 to {MOST_POINTS}", least=1, most=MOST_POINTS)
        rng = np.random.default_rng(as_whole("seed", seed, "a whole number that is not negative", least=0, most=2**63))
        box = self.parameters.values()
        drawn = [{p.name: float(rng.uniform(p.low, p.high)) for p in box} for _ in range(n)]
        return [(values, self.at(values)) for values in drawn]

    def gridded(self, points: int = 3) -> list[tuple[Values, StateSpace]]:
        """The systems on a grid over the box with `points` values of each parameter, both ends among them."""
        points = as_whole("points", points, "2 or more values of each parameter", least=2, most=1000)
        box = self.parameters.values()
        if points ** len(box) > MOST_POINTS:
            raise ModelError(
                f"points is {points}, {points ** len(box)} systems for {len(box)} parameters; at most {MOST_POINTS}"
            )
        axes = [[float(x) for x in np.linspace(p.low, p.high, points)] for p in box]
        grid = [dict(zip(self.parameters, values, strict=True)) for values in itertools.product(*axes)]
        return [(values, self.at(values)) for values in grid]

    def series(self, H: Any) -> UncertainSystem:
        """H after this system: y = H G u; H in any form that `system` takes, or uncertain.

        Raises
        ------
        ModelError : sizes or timebases do not fit.
        """
        return series(self, H)

    def feedback(self, K: Any = 1, sign: int = -1) -> UncertainSystem:
        """The loop y = G (u + sign K y), negative by default.

        Raises
        ------
        ModelError : sizes or timebases do not fit, or the loop is not well posed at the nominal parameters.
        """
        return feedback(self, K, sign)

    def lft(self, K: Any, nmeas: int | None = None, ncon: int | None = None) -> UncertainSystem:
        """The system closed by u = K y (positive feedback), u and y its last inputs and outputs.

        Raises
        ------
        ModelError : sizes or timebases do not fit, or the loop is not well posed at the nominal parameters.
        """
        return lft(self, K, nmeas, ncon)

    def close(self, K: Any) -> UncertainSystem:
        """Closed loop from w to z under u = K y, with as many u and y as K has; also takes a `Design`."""
        return self.lft(getattr(K, "closing", K))

    def with_ranges(self, box: Sequence[Parameter]) -> UncertainSystem:
        """The system whose parameters of these names have these ranges and nominal values.

        Raises
        ------
        ModelError : the box is no list of parameters.
        """
        if not isinstance(box, list | tuple) or not all(isinstance(p, Parameter) for p in box):
            raise ModelError(f"box is {shown(box)}; pass a list of parameters, as parameters.values() has them")
        found = {p.name: p for p in box}

        def ranged(M: np.ndarray) -> np.ndarray:
            moved = M.copy()
            for at, x in np.ndenumerate(M):
                moved[at] = Expression(x.terms, x.parameters | {n: p for n, p in found.items() if n in x.parameters})
            return moved

        E, A, B, C, D = map(ranged, (self.E, self.A, self.B, self.C, self.D))
        return UncertainSystem(E, A, B, C, D, self.dt, self.u, self.y)

    def __repr__(self) -> str:
        ranges = ", ".join(f"{p.name} in [{p.low:g}, {p.high:g}]" for p in self.parameters.values())
        return (
            f"UncertainSystem({self.n} states, {self.nu} inputs, {self.ny} outputs, {timebase_told(self.dt)}; "
            f"{ranges or 'no uncertain parameters'})"
        )

    def _reduced(self, values: Mapping[str, float]) -> Matrices:
        """A, B, C, D in doubles, with E undone and algebraic states solved for; nominal where nothing is said."""
        exact = {name: Fraction(values.get(name, p.nominal)) for name, p in self._symbols.items()}
        E, A, B, C, D = (_rounded(M, exact) for M in (self.E, self.A, self.B, self.C, self.D))
        where = f"at {values}" if values else "at the nominal parameters"
        static = algebraic(self.E)
        if static.any():
            x, r = ~static, np.ix_(static, static)
            if is_singular(A[r]):
                raise ModelError(f"the loop is not well posed {where}: its direct terms make it singular")
            W = np.linalg.solve(A[r], np.hstack([A[np.ix_(static, x)], B[static]]))
            k = int(x.sum())
            top, out = A[np.ix_(x, static)] @ W, C[:, static] @ W
            A, B = A[np.ix_(x, x)] - top[:, :k], B[x] - top[:, k:]
            C, D, E = C[:, x] - out[:, :k], D - out[:, k:], E[np.ix_(x, x)]
        if not np.array_equal(E, np.eye(len(E))):
            if is_singular(E):
                raise ModelError(f"E is singular {where}; masses and inertias in it must be invertible")
            AB = np.linalg.solve(E, np.hstack([A, B]))
            A, B = AB[:, : len(E)], AB[:, len(E) :]
        return Matrices(A, B, C, D)


def series(G: Any, H: Any) -> UncertainSystem:
    """H after G; see `synth.series`."""
    G, H = _together(G, H, "H")
    if G.ny != H.nu:
        raise ModelError(f"the first system, G, has {G.ny} outputs, the second, H, {H.nu} inputs; they must agree")
    E = _diagonal(G.E, H.E)
    A = np.block([[G.A, zeros(G.n, H.n)], [product(H.B, G.C), H.A]])
    B, C = np.vstack([G.B, product(H.B, G.D)]), np.hstack([product(H.D, G.C), H.C])
    return UncertainSystem(E, A, B, C, product(H.D, G.D), same_timebase(G, H), G.u, H.y)


def feedback(G: Any, K: Any = 1, sign: int = -1) -> UncertainSystem:
    """The loop y = G (u + sign K y); see `synth.feedback`."""
    sign = as_sign(sign)
    if np.isscalar(K) and not isinstance(K, str | bytes | bool):
        size = as_uncertain("G", G).nu
        K = np.eye(size) * as_expression("K", K).nominal
    G, K = _together(G, K, "K")
    if (K.ny, K.nu) != (G.nu, G.ny):
        raise ModelError(f"the controller K is {K.ny} x {K.nu}; G, which is {G.ny} x {G.nu}, needs {G.nu} x {G.ny}")
    both = UncertainSystem(
        G.E, G.A, np.hstack([G.B, G.B]), np.vstack([G.C, G.C]), np.block([[G.D, G.D], [G.D, G.D]]), G.dt
    )
    K = K if sign == 1 else UncertainSystem(K.E, K.A, K.B, -K.C, -K.D, K.dt)
    loop = lft(both, K)
    return UncertainSystem(loop.E, loop.A, loop.B, loop.C, loop.D, loop.dt, G.u, G.y)


def lft(P: Any, K: Any, nmeas: int | None = None, ncon: int | None = None) -> UncertainSystem:
    """P closed by u = K y; see `synth.lft`."""
    P, K = _together(P, K, "K")
    nmeas = as_whole("nmeas", K.nu if nmeas is None else nmeas, "the number of measurements", least=1)
    ncon = as_whole("ncon", K.ny if ncon is None else ncon, "the number of controls", least=1)
    if (K.ny, K.nu) != (ncon, nmeas):
        raise ModelError(f"the controller K is {K.ny} x {K.nu} where {ncon} x {nmeas} is needed (ncon x nmeas)")
    if nmeas >= P.ny or ncon >= P.nu:
        raise ModelError(
            f"P has {P.ny} outputs and {P.nu} inputs; {nmeas} measurements and {ncon} controls leave no z or no w"
        )
    mw, pz, n, k = P.nu - ncon, P.ny - nmeas, P.n, K.n
    B1, B2, C1, C2 = P.B[:, :mw], P.B[:, mw:], P.C[:pz], P.C[pz:]
    D11, D12, D21, D22 = P.D[:pz, :mw], P.D[:pz, mw:], P.D[pz:, :mw], P.D[pz:, mw:]
    # u = Dk C2 x + Ck xk + Dk D21 w + Dk D22 u
    U = np.hstack([product(K.D, C2), K.C, product(K.D, D21)])
    again = product(K.D, D22)
    m = 0 if all(entry.is_zero for entry in again.flat) else ncon  # algebraic states
    if m:
        U = np.hstack([zeros(ncon, n + k), eye(ncon), zeros(ncon, mw)])
        own = np.hstack([product(K.D, C2), K.C, again - eye(ncon), product(K.D, D21)])
    else:
        own = zeros(0, n + k + mw)
    Y = np.hstack([C2, zeros(nmeas, k + m), D21]) + product(D22, U)
    top = np.hstack([P.A, zeros(n, k + m), B1]) + product(B2, U)
    middle = np.hstack([zeros(k, n), K.A, zeros(k, m + mw)]) + product(K.B, Y)
    out = np.hstack([C1, zeros(pz, k + m), D11]) + product(D12, U)
    AB, size = np.vstack([top, middle, own]), n + k + m
    E = _diagonal(_diagonal(P.E, K.E), zeros(m, m))
    return UncertainSystem(
        E, AB[:, :size], AB[:, size:], out[:, :size], out[:, size:], same_timebase(P, K), P.u[:mw], P.y[:pz]
    )


def _diagonal(M: np.ndarray, N: np.ndarray) -> np.ndarray:
    return np.block([[M, zeros(len(M), len(N))], [zeros(len(N), len(M)), N]])


def _together(G: Any, K: Any, name: str) -> tuple[UncertainSystem, UncertainSystem]:
    """Two systems of one timebase; what has none of its own takes that of the other."""
    if isinstance(G, UncertainSystem):
        return G, as_uncertain(name, K, G.dt)
    K = as_uncertain(name, K)
    return as_uncertain("G", G, K.dt), K


def algebraic(E: np.ndarray) -> np.ndarray:
    """Which states have neither an entry in the rows nor in the columns of E, (n,) bool."""
    used = np.array([[not entry.is_zero for entry in row] for row in E], bool).reshape(E.shape)
    return np.logical_not(used.any(axis=0) | used.any(axis=1))


def as_uncertain(name: str, value: Any, dt: float | None = None) -> UncertainSystem:
    """An uncertain system, or any description of a certain one, which has no parameters then."""
    if isinstance(value, UncertainSystem):
        return value
    G = as_system(name, value, dt)
    return UncertainSystem(None, G.A, G.B, G.C, G.D, G.dt, G.u, G.y)


def same_timebase(G: UncertainSystem, K: UncertainSystem) -> float:
    """The timebase of two systems that work together."""
    return common_timebase(G, K)


def _rounded(M: np.ndarray, values: Mapping[str, Fraction]) -> np.ndarray:
    """The matrix at exact values, each entry correctly rounded."""
    try:
        return np.array([float(entry.exactly(values)) for entry in M.flat]).reshape(M.shape)
    except OverflowError:
        raise ModelError("an entry is beyond doubles at these parameters; choose other units") from None
