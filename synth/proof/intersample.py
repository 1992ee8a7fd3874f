"""What a discrete controller does to a continuous plant between the samples too, proved in balls.

At a level g, let H be the plant's Hamiltonian, constants of a period (u and the w that are held) states. The state X of
a period and its costate p, the gradient of |z|^2/g - g |w|^2, go by

    X(t) = F X(0) + W p(t),    p(0) = Q X(0) + F' p(t),    W, Q >= 0,                                              (1)

as long as no free w has a gain of g or more within t. Over a step with |H| t <= 1/4 none has: the block of exp(H s)
that must be invertible for all s <= t differs from I by less than e^(1/4) - 1, and what the exponential, in balls,
says is (1). Two steps are a step of (1), by Redheffer's product, and no w within both has a gain of g exactly when

    the largest eigenvalue of W1 Q2 is below one,

which a norm of W1 Q2 proves, or I - L'Q2 L > 0 with L L' = W1 + e I. So every doubling up to the whole period decides.
The loop is then stable with a norm below g if the discrete plant with A = F, B1 B1' = W, C1'C1 = Q has, closed by K, a
norm below one; and so if the one with W + e I and Q + e I has, whose factors balls enclose. For that one the bounded
real lemma decides, as in `balls`, with a witness from doubles. The coordinates of the states are a witness too: any
invertible ones will do. Nothing else is chosen, and nothing is sampled in time.

References: Bamieh and Pearson (1992), IEEE TAC 37, 418; Redheffer (1960), J. Math. Phys. 39, 269.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import NamedTuple

import numpy as np
from flint import arb, arb_mat, ctx

from synth.analysis.sampleddata import TOLERANCE, bounds, late
from synth.equations.lifting import Lifting
from synth.errors import VerificationError
from synth.proof import balls
from synth.proof.balls import Balls, UpperWitness
from synth.proof.matrices import block, cholesky, columns, exact, identity, row_sum, rows
from synth.proof.upper import FAILURES, continuous_poles, contractions, rates
from synth.systems.generalized import GeneralizedPlant
from synth.systems.realization import principal_axes
from synth.systems.sampled import pole_rate
from synth.systems.statespace import StateSpace

SHORT = 0.25  # row sum of the Hamiltonian over the first step
DOUBLINGS = 400  # 2^400 steps at most
MARGINS = (1e-7, 1e-6, 1e-5, 1e-4, 1e-3, 1e-2)  # of a bound above the norm in doubles


@dataclass(frozen=True, eq=False, kw_only=True)
class Intersample:
    """A bound of the norm between the samples, and the witness that proves it."""

    upper: float  # the controller stabilises the plant, and the norm at all times is below this
    delay: float  # s from the sample to the new value of the hold, from 0 to the period,
    samples: int  # and so many samples later
    held: tuple[int, ...]  # those w that are constant over a period
    bits: int  # precision of the ball arithmetic
    states: np.ndarray  # (n, n) S, x = S x_new
    constants: np.ndarray  # (k + m) units of the held w and of u
    witness: UpperWitness  # of the discrete loop of a period, whose level is one
    plant: GeneralizedPlant  # continuous

    @property
    def statement(self) -> str:
        """What was proved, in words."""
        held = f", w number {', '.join(str(j + 1) for j in self.held)} constant over a period" if self.held else ""
        whole = f"{self.samples} samples and " if self.samples else ""
        late = f", u {whole}{self.delay!r} s after the sample" if self.delay or self.samples else ""
        return (
            f"the controller stabilises the continuous plant with an H-infinity norm below {self.upper!r} between the "
            f"samples too ({self.bits}-bit{late}{held})"
        )

    def is_proved(self, K: StateSpace) -> bool:
        """True when the bound is proved for a discrete controller, u = K y."""
        if not balls.is_rate(self.witness.rate, K.dt):
            return False
        with ctx.workprec(self.bits):
            try:
                G = loop(self, K)
                return balls.contracts(balls.mapped(G, K.dt, self.witness.rate), self.witness, 1.0)
            except (ArithmeticError, ValueError):
                return False


class Period(NamedTuple):
    """F, W and Q of (1)."""

    F: arb_mat
    W: arb_mat
    Q: arb_mat


def loop(claim: Intersample, K: StateSpace) -> Balls:
    """The discrete loop of a period: has it a norm below one, the sampled one has a norm below `claim.upper`.

    Raises
    ------
    ValueError, ArithmeticError : a w within a period may have a gain of `claim.upper`; or there is no such loop: P must
        be continuous, K discrete, and every w that reaches a sampler held.
    """
    P, held, lag = claim.plant, list(claim.held), claim.delay > 0
    n, k, m = len(P.A), len(held), len(P.u)
    free = [j for j in range(len(P.w)) if j not in held]
    ours = P.dt == 0 and K.dt is not True and 0 <= claim.delay <= K.dt and K.dt > 0
    if not ours or held != sorted(set(range(len(P.w))) - set(free)) or P.D21[:, free].any():
        raise ValueError("no sampled loop")
    g, S, unit = arb(claim.upper), exact(claim.states), exact(np.diag(claim.constants))
    if not g > 0 or S.nrows() != n or unit.nrows() != k + m:
        raise ValueError("no level or no coordinates")
    Si = S.inv()
    free_part = Si * exact(P.B1[:, free]), exact(P.D11[:, free])
    constant = Si * exact(np.hstack([P.B1[:, held], P.B2])) * unit, exact(np.hstack([P.D11[:, held], P.D12])) * unit
    whole = None
    for after, time in [(False, arb(claim.delay))] * lag + [(True, arb(K.dt) - claim.delay)] * (claim.delay < K.dt):
        acts = exact(_acting(k, m, lag, after))
        A, C = block([[Si * exact(P.A) * S, constant[0] * acts]]), block([[exact(P.C1) * S, constant[1] * acts]])
        part = period(A, free_part[0], C, free_part[1], g, time)
        whole = part if whole is None else joined(whole, part)
    assert whole is not None
    return balls.closed(_plant(claim, whole, S, unit, K.dt), late(K, claim.samples))


def _acting(k: int, m: int, late: bool, after: bool) -> np.ndarray:
    """Which constants of a period, (k + m, all of them), act: of a late hold the u before and then the new."""
    acts = np.eye(k + m, k + m * (2 if late else 1))
    return np.hstack([acts[:, :k], acts[:, k + m :], acts[:, k : k + m]]) if late and after else acts


def period(A: arb_mat, B: arb_mat, C: arb_mat, D: arb_mat, g: arb, time: arb) -> Period:
    """X' = A (x, c) + B w, z = C (x, c) + D w over a time, c constant.

    Raises
    ------
    ValueError, ArithmeticError : a w within it may have a gain of g.
    """
    n, N = A.nrows(), A.ncols()
    R = identity(D.ncols()) - D.transpose() * D * (1 / g**2)
    cholesky(R)
    DC, Bt = D.transpose() * C * (1 / g**2), B.transpose()
    O = arb_mat(N - n, N)
    A = block([[A + B * R.solve(DC)], [O]])
    BB = block([[B * R.solve(Bt) * (1 / g), arb_mat(n, N - n)], [O]])
    CC = C.transpose() * (C + D * R.solve(DC)) * (1 / g)
    H = block([[-A.transpose(), -CC], [BB, A]]) * time
    doublings = max(0, int(np.ceil(np.log2(float(row_sum(H)) / SHORT))) + 1) if row_sum(H) > 0 else 0
    if doublings > DOUBLINGS:
        raise ValueError("the plant is too fast for the period")
    H = H * (arb(2) ** -doublings)
    if not row_sum(H) <= SHORT:
        raise ValueError("the first step is too long")
    X, first, second = H.exp(), range(N), range(N, 2 * N)
    back, forth = rows(X, first), rows(X, second)
    F = columns(back, first).inv().transpose()
    W = columns(forth, first) * F.transpose()
    Q = -F.transpose() * columns(back, second)
    found = Period(columns(forth, second) - W * columns(back, second), W, Q)
    for _ in range(doublings):
        found = joined(found, found)
    return found


def joined(first: Period, second: Period) -> Period:
    """One after the other.

    Raises
    ------
    ValueError, ArithmeticError : a w within both may have a gain of g.
    """
    I, WQ = identity(first.F.nrows()), first.W * second.Q
    if not row_sum(WQ) < 1:
        L = factor(first.W)
        cholesky(I - L.transpose() * second.Q * L)
    middle = (I - WQ).inv()
    moved = second.F * middle
    return Period(
        moved * first.F,
        second.W + moved * first.W * second.F.transpose(),
        first.Q + first.F.transpose() * second.Q * middle * first.F,
    )


def factor(W: arb_mat) -> arb_mat:
    """L with L L' = W + e I, a little more than a positive semidefinite W.

    Raises
    ------
    ValueError, ArithmeticError : W is not known well enough.
    """
    added = row_sum(W) * arb(2) ** -(ctx.prec // 2)
    return cholesky(W + identity(W.nrows()) * added) if added > 0 else W


def _plant(claim: Intersample, whole: Period, S: arb_mat, unit: arb_mat, h: float) -> dict[str, arb_mat]:
    """The discrete plant of a period, its nine matrices by name; its state is x, and the u before of a late hold."""
    P, held, lag = claim.plant, list(claim.held), claim.delay > 0
    n, k, m, N = len(P.A), len(held), len(P.u), whole.F.nrows()
    s = m if lag else 0
    state, now = [*range(n), *range(n + k, n + k + s)], range(N - m, N)
    one, energy = unit.inv(), 1 / (arb(claim.upper) * h).sqrt()
    per_held = rows(columns(one, range(k)), range(k)) * energy
    per_u = rows(columns(one, range(k, k + m)), range(k, k + m))
    F, C = rows(whole.F, range(n)), factor(whole.Q).transpose()
    L = factor(rows(columns(whole.W, range(n)), range(n)))
    D11, D21 = columns(C, range(n, n + k)) * per_held, exact(P.D21[:, held]) * energy
    B1 = block([[L, columns(F, range(n, n + k)) * per_held], [arb_mat(s, n + k)]])
    C2 = exact(P.C2) * S
    return {
        "A": block([[columns(F, state)], [arb_mat(s, n + s)]]),
        "B1": B1,
        "B2": block([[columns(F, now) * per_u], [rows(per_u, range(s))]]),
        "C1": columns(C, state),
        "D11": block([[arb_mat(N, n), D11]]),
        "D12": columns(C, now) * per_u,
        "C2": block([[C2, exact(P.D22) * per_u.inv()]]) if lag else C2,
        "D21": block([[arb_mat(len(P.y), n), D21]]),
        "D22": exact(0 * P.D22 if lag else P.D22),
    }


def prove(
    lifting: Lifting, K: StateSpace, levels: Sequence[float], bits: Sequence[int], samples: int = 0
) -> Intersample:
    """A bound of the norm between the samples of a discrete controller, the tightest that is proved.

    Without `levels` some are tried a little above the norm in doubles. u may come whole `samples` later.

    Raises
    ------
    VerificationError : none of the levels was proved.
    """
    if not levels:
        norm = bounds(lifting, late(K, samples), TOLERANCE).upper
        levels = [norm * (1 + m) for m in MARGINS] if norm < np.inf else []
    for level, precision in product(levels, bits):
        found = find(lifting, K, level, precision, samples)
        if found:
            return found
    told = f"below {levels[-1]:.9g}" if levels else "finite"
    raise VerificationError(f"it was not proved that the norm between the samples is {told}")


def find(lifting: Lifting, K: StateSpace, level: float, bits: int, samples: int = 0) -> Intersample | None:
    """A proof that the norm between the samples is below `level`, or None where none was found."""
    slow, none = lifting.at(lifting.wide), np.zeros((0, 0))
    if slow is None or not 0 < level < np.inf:
        return None
    with np.errstate(all="ignore"), ctx.workprec(bits):
        claim = Intersample(
            upper=level,
            delay=lifting.delay,
            samples=samples,
            held=lifting.held,
            bits=bits,
            states=principal_axes(lifting.given.system.matrices)[1],
            constants=lifting.units(level),
            witness=UpperWitness(none, none, none, none, 0.0),
            plant=lifting.given,
        )
        try:
            G = loop(claim, K)
        except FAILURES:
            return None
        for rate in rates(K.dt, pole_rate(continuous_poles(slow[0].close(late(K, samples))))):
            try:
                H = balls.mapped(G, K.dt, rate)
            except FAILURES:
                continue
            for witness in contractions(H, 1.0, rate):
                if balls.contracts(H, witness, 1.0):
                    return replace(claim, witness=witness)
    return None
