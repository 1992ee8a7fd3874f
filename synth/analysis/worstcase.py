"""Where in a box of parameters a loop is worst: a search in floating-point arithmetic, which proves nothing.

Gains are climbed in frequency and parameters at once from the best of many samples, with exact gradients: of the
largest singular value of G = C (z E - A)^-1 B + D the derivative is Re(l (S' - z E') r), with the singular vectors
carried through the resolvent. The nearest unstable parameters are looked for along rays, and then moved so that the box
that just holds them is as small as it can be.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from typing import NamedTuple, cast

import numpy as np
import scipy.linalg as sla
from scipy import optimize

from synth.errors import ModelError
from synth.systems.parameters import Expression, Parameter
from synth.systems.uncertain import UncertainSystem

VERTICES = 64  # of a box that are looked at, at most
DRAWN = 64  # samples besides
STARTS = 8  # of a climb
GRID = 24  # frequencies besides those of the poles
FARTHEST = 100.0  # times the ranges: as far as instability is looked for
RAYS = np.geomspace(0.02, FARTHEST, 48)
HALVINGS = 40
LOW = 4  # powers that cancel little
NOWHERE = 1e-9  # times the ranges: nothing grows
SINGULAR = 1e10  # condition of E from which on poles may be at infinity
ROUNDED = 1e-9  # of the poles' size: a growth that may be rounding


Pair = tuple[np.ndarray, np.ndarray]
Matrices = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


class Peak(NamedTuple):
    """A large gain."""

    gain: float
    w: float  # rad/s; of a discrete system tan(omega dt / 2)
    t: np.ndarray  # (parameters,) in [-1, 1]
    values: np.ndarray  # (parameters,) there


class Numbers:
    """A loop as a function of its parameters in doubles; t in [-1, 1] is the box, 0 the nominal values.

    Margins are looked for with the ranges of the `growing` parameters larger, of all when left out.
    """

    def __init__(self, G: UncertainSystem, box: Sequence[Parameter], growing: Iterable[str] = ()):
        names = [p.name for p in box]
        grow = set(growing) or set(names)
        self.growing = np.array([name in grow for name in names])
        self.discrete, self.n = G.discrete, G.n
        self.nominal = np.array([p.nominal for p in box])
        self.low, self.high = np.array([p.low for p in box]), np.array([p.high for p in box])
        self.up, self.down = self.high - self.nominal, self.nominal - self.low
        E, S, self.origin = _centred(G, box)
        monomials = sorted({m for M in (E, S) for entry in M.flat for m in entry.terms})
        self.powers = np.array([[dict(m).get(name, 0) for name in names] for m in monomials])
        self.E, self.S = (
            np.array([[[float(entry.terms.get(m, 0)) for entry in row] for row in M] for m in monomials])
            for M in (E, S)
        )
        self.fixed = ~(self.E.any(axis=(0, 1)) | self.E.any(axis=(0, 2)))  # algebraic states

    def values(self, t: np.ndarray) -> np.ndarray:
        """Parameters at t; inside their ranges for t in [-1, 1]."""
        x = self.nominal + np.where(t > 0, self.up, self.down) * t
        return np.where(np.abs(t) <= 1, np.clip(x, self.low, self.high), x)

    def fractions(self, f: np.ndarray, scale: float) -> np.ndarray:
        """T of points at fractions f of the ranges, those that grow made larger by `scale`."""
        x = np.where(self.growing, scale, 1.0) * (f * (self.up + self.down) - self.down)
        room = np.where(x > 0, self.up, self.down)
        return np.divide(x, room, out=np.zeros_like(x), where=room > 0)

    def on_ray(self, t: np.ndarray, scale: float) -> np.ndarray:
        """The point with what grows in it multiplied."""
        return np.where(self.growing, scale * t, t)

    def size(self, t: np.ndarray) -> float:
        """How many times as large the ranges that grow must be made to hold t."""
        return float(np.abs(t[self.growing]).max())

    def in_plane(self, poles: np.ndarray) -> np.ndarray:
        """Finite poles, of a discrete loop as Cayley's map has them."""
        poles = poles[np.isfinite(poles)]
        if self.discrete:
            poles = poles[poles != -1]
            poles = (poles - 1) / (poles + 1)
        return poles

    def _weights(self, t: np.ndarray) -> np.ndarray:
        """Monomials at t (..., parameters), (..., m)."""
        return ((self.values(t) - self.origin)[..., None, :] ** self.powers).prod(axis=-1)

    def _slopes(self, t: np.ndarray) -> np.ndarray:
        """Derivatives of the monomials by t, (m, parameters)."""
        x = self.values(t) - self.origin
        factors = x**self.powers
        slopes = np.empty(self.powers.shape)
        for i in range(len(x)):
            others = np.delete(factors, i, axis=1).prod(axis=1)
            k = self.powers[:, i]
            slopes[:, i] = others * k * x[i] ** np.maximum(k - 1, 0)
        return slopes * np.where(t > 0, self.up, self.down)

    def at(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """E and [A, B; C, D] at t (..., parameters)."""
        weights = self._weights(t)
        return np.tensordot(weights, self.E, 1), np.tensordot(weights, self.S, 1)

    def poles(self, t: np.ndarray) -> np.ndarray:
        """Finite poles, and inf for one that E sends there."""
        E, S = self.at(t)
        try:
            E, A, _, _ = self._moving(E, S)
        except np.linalg.LinAlgError:
            return np.array([np.inf])
        if np.linalg.cond(E) < SINGULAR:
            return np.linalg.eigvals(np.linalg.solve(E, A))
        alpha, beta = _eigenvalues(A, E)
        infinite = np.abs(beta) <= 1e-14 * np.abs(alpha)
        return np.concatenate([alpha[~infinite] / beta[~infinite], [np.inf] * int(infinite.sum())])

    def _moving(self, E: np.ndarray, S: np.ndarray) -> Matrices:
        """E and A of the states that move, what the others are made of, and what their equations add to."""
        A = S[..., : self.n, : self.n]
        if not self.fixed.any():
            return E, A, np.zeros((0, self.n)), np.zeros((self.n, 0))
        x, a = np.flatnonzero(~self.fixed), np.flatnonzero(self.fixed)
        own, above, below = A[..., a[:, None], a], A[..., x[:, None], a], A[..., a[:, None], x]
        down, across = -np.linalg.solve(own, below), -np.linalg.solve(own.mT, above.mT).mT
        return E[..., x[:, None], x], A[..., x[:, None], x] + above @ down, down, across

    def growth(self, t: np.ndarray) -> float:
        """Largest real part of a pole, or log of its modulus: negative for a stable loop."""
        poles = self.poles(t)
        if not poles.size:
            return -np.inf
        with np.errstate(divide="ignore"):
            return float((np.log(np.abs(poles)) if self.discrete else np.real(poles)).max())

    def growths(self, points: np.ndarray) -> np.ndarray:
        """Of several points, (k, parameters), at once."""
        weights = self._weights(points)
        try:
            E, A, _, _ = self._moving(np.tensordot(weights, self.E, 1), np.tensordot(weights, self.S, 1))
            regular = A.size > 0 and bool((np.linalg.cond(E) < SINGULAR).all())
        except np.linalg.LinAlgError:
            regular = False
        if not regular:
            return np.array([self.growth(t) for t in points])
        poles = np.linalg.eigvals(np.linalg.solve(E, A))
        with np.errstate(divide="ignore"):
            return (np.log(np.abs(poles)) if self.discrete else np.real(poles)).max(axis=1)

    def growth_slope(self, t: np.ndarray) -> np.ndarray:
        """Derivative of the growth, (parameters,); NaN where it has none."""
        E, S = self.at(t)
        Er, A, down, across = self._moving(E, S)
        poles, first = cast(Pair, np.linalg.eig(np.linalg.solve(Er, A)))
        last = np.linalg.solve(Er.T, np.linalg.inv(first).T)  # columns are the left eigenvectors of the pencil
        right, left = np.zeros((self.n, len(A)), complex), np.zeros((self.n, len(A)), complex)
        right[~self.fixed], right[self.fixed] = first, down @ first
        left[~self.fixed], left[self.fixed] = last, across.T @ last
        with np.errstate(all="ignore"):
            size = np.where(np.isfinite(poles), np.log(np.abs(poles)) if self.discrete else np.real(poles), -np.inf)
            k = int(np.argmax(size))
            l, r, s = left[:, k], right[:, k], poles[k]
            changed = (l @ self.S[:, : self.n, : self.n] @ r - s * (l @ self.E @ r)) / (l @ E @ r)
            slope = changed @ self._slopes(t)
            return (slope / s if self.discrete else slope).real

    def z(self, w: float | np.ndarray) -> np.ndarray:
        """S = j w, or the point of the unit circle that Cayley's map takes there."""
        s = 1j * np.asarray(w)
        return (1 + s) / (1 - s) if self.discrete else s

    def gains(self, t: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Largest singular values at frequencies."""
        E, S = self.at(t)
        n = self.n
        M = self.z(w)[:, None, None] * E - S[:n, :n]
        G = S[n:, :n] @ np.linalg.solve(M, np.broadcast_to(S[:n, n:].astype(complex), (len(w), *S[:n, n:].shape)))
        return np.linalg.norm(G + S[n:, n:], 2, axis=(1, 2))

    def gain(self, x: np.ndarray) -> tuple[float, np.ndarray]:
        """Largest singular value and its gradient at x = (log w, t)."""
        w, t, n = np.exp(x[0]), x[1:], self.n
        E, S = self.at(t)
        z = complex(self.z(w))
        M = z * E - S[:n, :n]
        right = np.linalg.solve(M, S[:n, n:])
        U, sigma, Vh = np.linalg.svd(S[n:, :n] @ right + S[n:, n:])
        u, v = U[:, 0].conj(), Vh[0].conj()
        r = np.concatenate([right @ v, v])
        l = np.concatenate([np.linalg.solve(M.T, (u @ S[n:, :n]).T), u])
        by_monomial = (l @ self.S @ r - z * (l[:n] @ self.E @ r[:n])).real
        turned = 2j / (1 - 1j * w) ** 2 if self.discrete else 1j
        by_w = (-turned * (l[:n] @ E @ r[:n])).real
        return float(sigma[0]), np.concatenate([[by_w * w], by_monomial @ self._slopes(t)])


def _centred(G: UncertainSystem, box: Sequence[Parameter]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """E and [A, B; C, D] without remainders, in powers of parameters less their origins, and these.

    The origin is the nominal value where there are high powers, which would cancel each other around zero.
    """
    parts, origin = [G.E, np.block([[G.A, G.B], [G.C, G.D]])], np.zeros(len(box))
    known = {p.name: p for p in box}

    def each(M: np.ndarray, change: Callable[[Expression], Expression]) -> np.ndarray:
        return np.array([change(x) for x in M.flat], object).reshape(M.shape)

    if G.remainders:
        parts = [each(M, lambda x: x.without(G.remainders)) for M in parts]
    for k, p in enumerate(box):
        if any(dict(m).get(p.name, 0) > LOW for M in parts for x in M.flat for m in x.terms):
            origin[k] = p.nominal
            parts = [each(M, lambda x, p=p: x.moved(known[p.name], Fraction(p.nominal))) for M in parts]
    return parts[0], parts[1], origin


def _eigenvalues(A: np.ndarray, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of A - s E, s = alpha / beta; where LAPACK's iteration does not end, it is begun again with other rows."""
    rng = np.random.default_rng(0)
    for attempt in range(4):
        Q = np.linalg.qr(rng.normal(size=A.shape))[0] if attempt else np.eye(len(A))
        try:
            alpha, beta = np.asarray(sla.eigvals(Q @ A, Q @ E, homogeneous_eigvals=True))
            return alpha, beta
        except np.linalg.LinAlgError:
            continue
    raise ModelError("the poles of the loop cannot be computed: LAPACK's iteration does not end; choose other units")


def samples(p: int) -> Iterable[np.ndarray]:
    """The centre, vertices and points drawn from the box."""
    rng = np.random.default_rng(0)
    yield np.zeros(p)
    if 2**p <= VERTICES:
        yield from (np.array(v, float) for v in itertools.product((-1, 1), repeat=p))
    else:
        yield from rng.choice([-1.0, 1.0], size=(VERTICES, p))
    yield from rng.uniform(-1, 1, size=(DRAWN, p))


def worst_gain(
    N: Numbers, starts: Iterable[np.ndarray] = (), frequencies: Iterable[float] = (), stable_below: float = 0.0
) -> tuple[np.ndarray | None, list[Peak]]:
    """An unstable point if one was met, and large gains, the largest first; from the points given or from samples.

    `frequencies` are looked at besides those of the poles; a growth of `stable_below` times the poles is none.
    """
    peaks, climbed = [], []
    given = list(starts)
    for t in given or samples(len(N.nominal)):
        poles = N.poles(t)
        if N.growth(t) >= stable_below * _size(N, poles):
            return t, []
        w = np.unique([*pole_frequencies(N, poles), *frequencies])
        with np.errstate(all="ignore"):
            gains = np.nan_to_num(N.gains(t, w))
        tops = np.flatnonzero((gains >= np.append(gains[1:], 0)) & (gains >= np.insert(gains[:-1], 0, 0)))
        peaks += [Peak(float(gains[i]), float(w[i]), t, N.values(t)) for i in tops]
    for start in sorted(peaks, key=lambda peak: -peak.gain)[:STARTS]:
        found = _climbed(N, start)
        if N.growth(found.t) >= stable_below * _size(N, N.poles(found.t)):
            return found.t, []
        climbed.append(max(found, start, key=lambda peak: peak.gain))
    return None, sorted(climbed, key=lambda peak: -peak.gain)


def _size(N: Numbers, poles: np.ndarray) -> float:
    finite = np.abs(poles[np.isfinite(poles)])
    return 1.0 if N.discrete or not finite.size else float(np.median(finite)) or 1.0


def pole_frequencies(N: Numbers, poles: np.ndarray) -> np.ndarray:
    """Those of the poles and a few others, as w."""
    poles = N.in_plane(poles)
    moduli = np.abs(poles)[np.abs(poles) > 0]
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    resonant = np.abs(np.imag(poles))[np.abs(np.imag(poles)) > 1e-6 * np.abs(poles)]
    return np.concatenate([moduli, resonant, np.geomspace(low / 10, high * 10, GRID)])


def _climbed(N: Numbers, start: Peak) -> Peak:
    """The local maximum uphill from a point."""
    size, at = start.gain or 1.0, np.log(start.w)

    def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
        try:
            gain, slope = N.gain(x)
        except np.linalg.LinAlgError:
            return 0.0, np.zeros_like(x)
        return -gain / size, -slope / size

    bounds = [(at - 3.0, at + 3.0), *[(-1.0, 1.0)] * len(start.t)]
    with np.errstate(all="ignore"):
        found = optimize.minimize(
            cost, np.concatenate([[at], start.t]), jac=True, bounds=bounds, method="L-BFGS-B",
            options={"maxiter": 200, "ftol": 1e-15, "gtol": 1e-10},
        )  # fmt: skip
    t = np.clip(found.x[1:], -1, 1)
    return Peak(-float(found.fun) * size, float(np.exp(found.x[0])), t, N.values(t))


def nearest_instability(N: Numbers, starts: Iterable[np.ndarray] = ()) -> np.ndarray | None:
    """The point t of the least size found at which the loop is not stable; None up to `FARTHEST`."""
    rays = sorted(ray for ray in (_along_ray(N, t) for t in list(starts) or _directions(N)) if ray is not None)
    found = [_refined(N, ray) for k, ray in enumerate(rays) if k < STARTS or ray.low <= rays[0].high]
    found.sort(key=N.size)
    nearer = [ray for ray in (_along_ray(N, _moved(N, t)) for t in found[:STARTS]) if ray is not None]
    return min([*found[:1], *(_refined(N, ray) for ray in nearer)], key=N.size, default=None)


def _directions(N: Numbers) -> Iterable[np.ndarray]:
    """Samples of the box; what grows alone has two directions, or one where its range has one side."""
    if N.growing.sum() > 1 or N.growing.all():
        yield from samples(len(N.nominal))
        return
    for t in samples(len(N.nominal)):
        for sign, room in ((1.0, N.up[N.growing]), (-1.0, N.down[N.growing])):
            if room > 0:
                yield np.where(N.growing, sign, t)


class Ray(NamedTuple):
    """A direction along which stability is lost, between two multiples of it."""

    high: float
    low: float
    direction: tuple[float, ...]


def _along_ray(N: Numbers, direction: np.ndarray) -> Ray | None:
    """Where the loop is first found unstable on a ray."""
    size = N.size(direction)
    if size < NOWHERE:
        return None
    e = np.where(N.growing, direction / size, np.clip(direction, -1, 1))
    near = [1 - 1e-3, 1 - 1e-6, 1.0, 1 + 1e-6, 1 + 1e-3]
    scales = np.unique([0.0, *RAYS, *(size * x for x in near)])
    lost = np.flatnonzero(N.growths(np.array([N.on_ray(e, k) for k in scales[1:]])) >= 0)
    if not lost.size:
        return None
    return Ray(float(scales[lost[0] + 1]), float(scales[lost[0]]), tuple(map(float, e)))


def _refined(N: Numbers, ray: Ray) -> np.ndarray:
    """The point on a ray where stability is lost, to rounding."""
    high, low, e = ray.high, ray.low, np.array(ray.direction)
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if N.growth(N.on_ray(e, middle)) >= 0 else (middle, high)
    return N.on_ray(e, high)


def _moved(N: Numbers, start: np.ndarray) -> np.ndarray:
    """The point moved along the boundary of stability to where the box that holds it is smallest."""
    unit, p = _size(N, N.poles(start)), len(start)
    rows = np.hstack([np.vstack([-np.eye(p), np.eye(p)]), np.tile(N.growing.astype(float), 2)[:, None]])
    room = np.tile(1.0 - N.growing, 2)
    with np.errstate(all="ignore"):
        try:
            found = optimize.minimize(
                lambda x: x[-1], np.append(start, N.size(start)), jac=lambda x: np.eye(p + 1)[-1],
                method="SLSQP", options={"maxiter": 100, "ftol": 1e-12},
                constraints=[
                    {"type": "ineq", "fun": lambda x: rows @ x + room, "jac": lambda x: rows},
                    {
                        "type": "ineq",
                        "fun": lambda x: N.growth(x[:-1]) / unit,
                        "jac": lambda x: np.append(N.growth_slope(x[:-1]) / unit, 0.0),
                    },
                ],
            )  # fmt: skip
        except (np.linalg.LinAlgError, ValueError):
            return start
    return found.x[:-1] if np.isfinite(found.x).all() else start
