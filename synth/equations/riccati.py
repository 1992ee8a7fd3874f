"""Riccati equations inside compiled loops, under `jit`, `vmap` and `scan`; outside them see `synth.equations.are`.

    continuous   A'X + X A - X G X + Q = 0                  G = B R^-1 B'
    discrete     X = Q + A'X (I + G X)^-1 A

Doubling finds the neighbourhood of the stabilising solution from nothing; Newton's method (Kleinman 1968, Hewer 1971)
finishes to rounding, and starts at once where a guess is at hand, such as the solution of the last sample. Both stop
when a test says so. A step d from X leaves the residual -d G d, which tells the error of the new X. Its Lyapunov
equation is solved by squaring the closed loop, and the squares vanish for a stable loop only: a solution that was
accepted stabilises.

Inside, lanes come last: a batch of (n, n) matrices is (n, n, b), so that every operation runs along the batch; `vmap`
finds its way here by a batching rule of its own. What can be is eliminated without pivots: I + G H becomes positive
definite by a Cholesky factor of H. Failure is a value, `ok`. Needs JAX and float64.

References: Chu, Fan and Lin (2005), Linear Algebra and its Applications 396, 55 (structure-preserving doubling);
Kleinman (1968), IEEE TAC 13, 114; Smith (1968), SIAM J. Applied Math. 16, 198 (X A + B X = C).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.custom_batching import custom_vmap

from synth.equations.are import Solution
from synth.errors import ModelError

DOUBLINGS = 40  # 2^40 samples: slower convergence than that is a mode on the stability boundary
NEAR = 1e-3  # size of the doubled closed loop where Newton takes over; the solution is then right to its square
LANES = 48  # of a batch that go together: their matrices stay near the processor
NEWTON_STEPS = 8
WARM_STEPS = 3  # from a guess; one that needs more is no guess
VANISHED = 1e-4  # size of the squared closed loop that counts as zero in a Newton step, right to its square
ACCURACY = 1e-11  # relative error of a solution, as estimated from the last step
RIDGE = 1e-13  # relative, keeps Cholesky factors of semidefinite matrices real; Newton corrects it
TINY = 1e-300  # keeps 0 / 0 from being one
OVERFLOW = 1e100  # size of a square beyond which a lane has diverged
OFF_POLE = 1.17  # keeps the rate of the Cayley map from the mirror images of closed-loop poles, which A may have

barrier = jax.lax.optimization_barrier  # one kernel per matrix: XLA would compute the operands again for every entry


class Pair(NamedTuple):
    """Stabilising solutions of an equation and of its dual, A Z + Z A' - Z Q Z + G = 0."""

    X: Any  # (..., n, n)
    Z: Any  # (..., n, n)
    ok: Any  # (...) bool, both


def closed_loop_rate(A: np.ndarray, G: np.ndarray, Q: np.ndarray) -> np.ndarray:
    """Geometric mean of the closed-loop poles' moduli, (...) rad/s, by the determinant of the Hamiltonian; NumPy."""
    H = np.block([[A, -G], [-Q, -np.swapaxes(A, -1, -2)]])
    logarithm = np.linalg.slogdet(H)[1] / H.shape[-1]
    return np.exp(np.where(np.isfinite(logarithm), logarithm, 0.0))


def stabilising(A: Any, G: Any, Q: Any, shift: Any) -> Solution:
    """Solution of the continuous equation; traceable, one equation (`vmap` for many).

    Parameters
    ----------
    A, G, Q : (n, n), G and Q symmetric, positive semidefinite
    shift : () rad/s, a typical modulus of the closed-loop poles (`closed_loop_rate`); twice as much costs a doubling
    """
    return Solution(*_cold(*_floats(A, G, Q, shift)))


def continued(A: Any, G: Any, Q: Any, shift: Any, guess: Any) -> Solution:
    """`stabilising` from a guess (n, n): Newton where that converges at once, doubling where it does not."""
    return Solution(*_warm(*_floats(A, G, Q, shift, guess)))


def stabilising_pair(A: Any, G: Any, Q: Any, shift: Any) -> Pair:
    """Solutions of the continuous equation and of its dual, for the price of little more than one."""
    return Pair(*_both(*_floats(A, G, Q, shift)))


def discrete_stabilising(A: Any, G: Any, Q: Any) -> Solution:
    """Solution of the discrete equation; traceable, one equation (`vmap` for many)."""
    return Solution(*_discrete(*_floats(A, G, Q)))


def _lanes_last(solve: Callable) -> Callable:
    """A function of (..., b) arrays as one of arrays without lanes, with its batching rule."""

    @custom_vmap
    def single(*operands):
        return tuple(out[..., 0] for out in solve(*(a[..., None] for a in operands)))

    @single.def_vmap
    def rule(size, batched, *operands):
        blocks = -(-size // LANES)
        lanes = -(-size // blocks)

        def split(a):
            a = jnp.pad(a, [(0, blocks * lanes - size)] + [(0, 0)] * (a.ndim - 1), mode="edge")
            return jnp.moveaxis(a.reshape(blocks, lanes, *a.shape[1:]), 1, -1)

        def block(own):
            own = iter(own)
            mine = (next(own) if b else a[..., None] for a, b in zip(operands, batched, strict=True))
            return solve(*(jnp.broadcast_to(a, (*a.shape[:-1], lanes)) for a in mine))

        out = jax.lax.map(block, [split(a) for a, b in zip(operands, batched, strict=True) if b])
        out = tuple(jnp.moveaxis(a, -1, 1).reshape(blocks * lanes, *a.shape[1:-1])[:size] for a in out)
        return out, tuple(True for _ in out)

    return jax.jit(single)  # so that a call outside compiled code is compiled once


@_lanes_last
def _cold(A, G, Q, shift):
    X, _ = _doubled(*_cayley(A, G, Q, shift))
    return _kleinman(A, G, Q, shift, X, NEWTON_STEPS)


@_lanes_last
def _warm(A, G, Q, shift, guess):
    def going(loop):
        turn, _, ok = loop
        return (turn < 2) & ~jnp.all(ok)

    def body(loop):  # from the guess, then from the doubling; a loop, so that Newton is compiled once
        turn, X, ok = loop
        start = jax.lax.cond(turn == 0, lambda: X, lambda: jnp.where(ok, X, _doubled(*_cayley(A, G, Q, shift))[0]))
        return turn + 1, *_kleinman(A, G, Q, shift, start, jnp.where(turn == 0, WARM_STEPS, NEWTON_STEPS), ok)

    _, X, ok = jax.lax.while_loop(going, body, (0, guess, jnp.zeros(guess.shape[-1], bool)))
    return X, ok


@_lanes_last
def _both(A, G, Q, shift):
    X, Z = _doubled(*_cayley(A, G, Q, shift))
    X, first = _kleinman(A, G, Q, shift, X, NEWTON_STEPS)
    Z, second = _kleinman(_transpose(A), Q, G, shift, Z, NEWTON_STEPS)
    return X, Z, first & second


@_lanes_last
def _discrete(A, G, Q):
    def step(X):
        closed, R = _discrete_residual(A, G, Q, X)
        d, stable = _stein(closed, R)
        return d, _size(_discrete_residual(A, G, Q, X + d)[1]) / (_size(R) + TINY), stable

    return _newton(step, _doubled(A, G, Q)[0], NEWTON_STEPS)


def _kleinman(A, G, Q, shift, X, steps, ok=None):
    """Newton's method on the continuous equation from X: (X, ok)."""

    def step(X):
        closed = barrier(A - _mul(G, X))
        R = barrier(_symmetric(_mul(_transpose(A), X) + _mul(X, closed)) + Q)
        V = _inverse(closed - shift * _eye(A))
        d, stable = _stein(_eye(A) + 2 * shift * V, 2 * shift * _mul(_transpose(V), barrier(_mul(R, V))))
        left = _mul(d, barrier(_mul(G, d)))
        return d, _size(left) / (_size(R) + TINY), stable

    return _newton(step, X, steps, ok)


def _newton(step, X, limit, ok=None):
    """X after as many steps as it needs: step(X) -> (d, residual left over residual before, closed loop stable)."""

    def going(loop):
        k, _, ok, alive = loop
        return (k < limit) & jnp.any(~ok & alive)

    def body(loop):
        k, X, ok, _ = loop
        d, left, stable = step(X)
        X = jnp.where(ok, X, X + d)
        error = left * _size(d) / (_size(X) + TINY)
        return k + 1, X, ok | (stable & (error <= ACCURACY)), jnp.isfinite(_size(X))

    alive = jnp.ones(X.shape[-1], bool)
    _, X, ok, _ = jax.lax.while_loop(going, body, (0, X, ~alive if ok is None else ok, alive))
    return X, ok


def _doubled(A, G, H):
    """Solutions near the limits of H and G under doubling, from the discrete equation and its dual."""

    def body(A, G, H):
        Y = _half_kernel(G, H)
        YA, AG = barrier((_mul(Y, A), _mul(A, G)))
        AGY = barrier(_mul(AG, _transpose(Y)))
        return (
            _mul(A, A) - _mul(AGY, YA),
            G + _mul(AG, _transpose(A)) - _mul(AGY, _transpose(AGY)),
            H + _mul(_transpose(YA), YA),
        )

    (_, G, H), _ = _squared(body, (A, G, H), NEAR)
    return H, G


def _stein(C, R):
    """The solution of S = R + C'S C by squaring C, and whether C is stable."""

    def body(C, S):
        return _mul(C, C), S + _mul(_transpose(C), barrier(_mul(S, C)))

    (_, S), stable = _squared(body, (C, R), VANISHED)
    return _symmetric(S), stable


def _squared(body, matrices, small):
    """`body` repeated until the first matrix, which it squares, is small in every lane; which lanes got there.

    A lane that got there has zero for its first matrix from then on, so that further turns leave it as it is.
    """

    def going(loop):
        k, lanes, _, _ = loop
        return (k < DOUBLINGS) & jnp.any(lanes)

    def turn(loop):
        k, _, done, matrices = loop
        first, *others = barrier(body(*matrices))
        size = _size(first)
        done |= size < small
        return k + 1, ~done & (size < OVERFLOW), done, (jnp.where(done, 0.0, first), *others)

    lanes = jnp.ones(matrices[0].shape[-1], bool)
    _, _, done, matrices = jax.lax.while_loop(going, turn, (0, lanes, ~lanes, barrier(matrices)))
    return matrices, done


def _cayley(A, G, Q, shift):
    """The discrete equation with the same X and Z (Chu, Fan and Lin 2005, section 2)."""
    shift = OFF_POLE * shift
    V = _inverse(A - shift * _eye(A))
    F = barrier(_mul(_cholesky(Q), V))
    Y = _half_kernel(G, _mul(_transpose(F), F))
    VG, VGY = barrier((_mul(V, G), _mul(V, barrier(_mul(G, _transpose(Y))))))
    return (
        _eye(A) + 2 * shift * (V - _mul(VGY, Y)),
        2 * shift * (_mul(VG, _transpose(V)) - _mul(VGY, _transpose(VGY))),
        2 * shift * _mul(_transpose(Y), Y),
    )


def _discrete_residual(A, G, Q, X):
    """Closed loop (I + G X)^-1 A and residual of the discrete equation."""
    Y = _half_kernel(G, X)
    YA = barrier(_mul(Y, A))
    return A - _mul(barrier(_mul(G, _transpose(Y))), YA), _symmetric(Q - X + _mul(_transpose(YA), YA))


def _half_kernel(G, H):
    """Y with Y'Y = H (I + G H)^-1: with H = C C' this is C (I + C'G C)^-1 C'."""
    C = _cholesky(H)
    M = _eye(H) + _mul(barrier(_mul(C, G)), _transpose(C))
    return _eliminated(jnp.concatenate([M, C], 1), jnp.ones((len(H), 1)))[:, len(H) :]


def _cholesky(S):
    """Upper triangular C with C'C = S, for S positive semidefinite."""
    ridge = RIDGE * jnp.stack([S[k, k] for k in range(len(S))])
    return _eliminated(S + ridge * _eye(S), ridge)


def _eliminated(W, least):
    """[L', L^-1 F] from W = [S, F] with S = L L' positive definite, its pivots not below `least` (n, b)."""
    n, rows = len(W), []
    for k in range(n):
        row = barrier(W[0] / jnp.sqrt(jnp.maximum(W[0, 0], least[k]) + TINY))
        rows.append(jnp.pad(row, ((k, 0), (0, 0))))
        W = barrier(W[1:, 1:] - row[1 : n - k, None] * row[1:])
    return barrier(jnp.stack(rows))


def _inverse(M):
    """Inverse by Gauss-Jordan elimination with row pivots."""
    n = len(M)
    index = jnp.arange(n)[:, None]
    W = jnp.concatenate([M, jnp.broadcast_to(_eye(M), M.shape)], 1)
    for k in range(n):
        largest = jnp.argmax(jnp.where(index < k, -1.0, jnp.abs(W[:, 0])), axis=0)
        chosen = index == largest
        row = jnp.sum(jnp.where(chosen[:, None], W, 0.0), axis=0)
        row = row / row[0]
        W = jnp.where(chosen[:, None], W[k], W)
        W = barrier(jnp.where((index == k)[:, None], row, W - W[:, :1] * row)[:, 1:])
    return W


def _mul(A, B):
    """A B for every lane."""
    return sum((A[:, k, None] * B[None, k] for k in range(1, A.shape[1])), A[:, 0, None] * B[None, 0])


def _transpose(A):
    return A.transpose(1, 0, 2)


def _symmetric(A):
    return (A + _transpose(A)) / 2


def _size(A):
    """Frobenius norm of every lane."""
    return jnp.sqrt(jnp.sum(A**2, axis=(0, 1)))


def _eye(A):
    """The identity, to be added to (n, n, b)."""
    return jnp.eye(len(A))[:, :, None]


def _floats(*operands):
    """The operands as float64 arrays, or a ModelError where JAX has no such thing."""
    arrays = tuple(jnp.asarray(a, float) for a in operands)
    if any(a.dtype != jnp.float64 for a in arrays):
        raise ModelError("JAX computes in float32, too little for Riccati equations; use jax.enable_x64(True)")
    return arrays
