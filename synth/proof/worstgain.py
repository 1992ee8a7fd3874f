"""`worst_gain`: the largest gain over a box of parameters, also with unmodelled dynamics in the loop."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import optimize

from synth.analysis import worstcase as search
from synth.checks import shown
from synth.errors import ModelError
from synth.proof.worstcase import BOXES, TRIES, WIDER, Asked, WorstCase, asked, worst_of_box
from synth.systems.statespace import StateSpace
from synth.systems.uncertain import UncertainSystem, series
from synth.systems.unmodelled import Dynamics
from synth.threads import one_thread

ROUNDED = 1e-14  # relative, of what is computed from a bound

HALVINGS = 60  # of a level


@one_thread
def worst_gain(
    loop: Any, controller: Any = None, *, dynamics: Any = None, tol: float = 1e-5, boxes: int = BOXES
) -> WorstCase:
    """The largest H-infinity norm of an uncertain loop over its box of parameters, from both sides.

    Parameters
    ----------
    loop : UncertainSystem from w to z, closed; or an open one, with the controller
    controller : K of u = K y (positive feedback), u and y the last inputs and outputs of the plant; a `Design` or any
        description of a system
    dynamics : an `ultidyn` block between the first outputs of the loop and its first inputs. `upper` then holds for all
        such dynamics, by the main loop theorem with a constant scaling, which is conservative; `lower` is reached
        without them. Where the loop has no other signals the gain is that of the channel which they see: they are
        harmless if and only if it is below one
    tol : relative distance of the bounds that is aimed at
    boxes : how many boxes a proof may need

    Returns
    -------
    WorstCase : `lower` is reached at `parameters`, where `norm` was measured again; the loop is proved stable with a
        norm below `upper` on the whole box. Both are inf where an unstable point was found, with its `eigenvalue`.

    Raises
    ------
    ModelError : there are no parameters, or arguments that are none.

    Reference: theorem and assumptions are in `synth.proof.robust` and in docs/robust_box.md.
    """
    ask = asked(loop, controller, tol, boxes)
    return worst_of_box(ask) if dynamics is None else _with_dynamics(ask, dynamics)


wcgain = worst_gain  # MATLAB's name


def _with_dynamics(ask: Asked, dynamics: Any) -> WorstCase:
    """Levels g at which the gain of diag(I, 1/g) [M11, c M12; M21/c, M22] is below one over the box, c constant.

    The loop is then stable for all dynamics, with a gain below g (main loop theorem; Zhou, Doyle and Glover (1996),
    Robust and Optimal Control, theorem 11.8).
    """
    p, m, G = _channel(ask, dynamics)
    if (p, m) == (G.nu, G.ny):
        return worst_of_box(ask._replace(G=G))
    channel = worst_of_box(ask._replace(G=UncertainSystem(G.E, G.A, G.B[:, :p], G.C[:m], G.D[:m, :p], G.dt)))
    if channel.eigenvalue is not None:
        return channel
    if channel.lower >= 1:
        note = f"the loop is not stable for all {dynamics.name!r}: the channel that they see has the gain given"
        return replace(channel, lower=np.inf, upper=np.inf, note=note, certificate=None)
    without = worst_of_box(ask._replace(G=UncertainSystem(G.E, G.A, G.B[:, p:], G.C[m:], G.D[m:, p:], G.dt)))
    seen = [(r.parameters, r.frequency) for r in (channel, without)]
    level, proof = 0.0, None
    for k in range(TRIES):
        c, g = _scaling(ask, G, (p, m), seen)
        level = max(g * (1 + ask.tol * WIDER), level * (1 + ask.tol * WIDER**2) if k else 0.0)
        left, right = np.r_[np.ones(m), np.full(G.ny - m, 1 / (c * level))], np.r_[np.ones(p), np.full(G.nu - p, c)]
        scaled = UncertainSystem(G.E, G.A, G.B * right, left[:, None] * G.C, left[:, None] * G.D * right, G.dt)
        found = worst_of_box(ask._replace(G=scaled))
        if found.upper < 1:
            proof = found
            break
        if (found.lower < 1 and found.note) or level == np.inf:
            break
        seen.append((found.parameters, found.frequency))
    note = "for all dynamics a bound from above, by one constant scaling; what is reached is so without them"
    return replace(
        without, upper=level if proof else np.inf, note=note if proof else "no bound was proved with the dynamics",
        boxes=proof.boxes if proof else 0, certificate=proof.certificate if proof else None,
    )  # fmt: skip


def _channel(ask: Asked, dynamics: Any) -> tuple[int, int, UncertainSystem]:
    """Sizes of the block, and the loop with the weight and the bound on what it sees."""
    if isinstance(dynamics, list | tuple):
        raise ModelError(f"dynamics is a list of {len(dynamics)}; one block is proved here, `mussv` bounds several")
    if not isinstance(dynamics, Dynamics):
        raise ModelError(f"dynamics is {shown(dynamics)}; pass what ultidyn makes")
    (p, m), G = dynamics.shape, ask.G
    if G.nu < p or G.ny < m:
        raise ModelError(f"dynamics is {p} x {m}; the loop has {G.nu} inputs and {G.ny} outputs, and needs {p} and {m}")
    C, D, gain = G.C.copy(), G.D.copy(), np.ones(G.ny)
    gain[:m] = dynamics.bound
    G = UncertainSystem(G.E, G.A, G.B, gain[:, None] * C, gain[:, None] * D, G.dt)
    if dynamics.weight is not None:
        W, n, k = dynamics.weight, dynamics.weight.n, G.ny - m
        I, rest = np.eye(m), np.zeros((n * m, k))
        G = series(G, StateSpace(
            np.kron(I, W.A), np.hstack([np.kron(I, W.B), rest]), np.vstack([np.kron(I, W.C), rest.T]),
            np.block([[np.kron(I, W.D), np.zeros((m, k))], [np.zeros((k, m)), np.eye(k)]]), W.dt,
        ))  # fmt: skip
    return p, m, G


def _scaling(
    ask: Asked, G: UncertainSystem, block: tuple[int, int], seen: list[tuple[dict[str, float], float]]
) -> tuple[float, float]:
    """The scaling c and the least level g with it at the points and frequencies that were worst, in doubles."""
    N, (p, m) = search.Numbers(G, ask.box), block
    M = []
    for point, frequency in seen:
        H = G.at(point)
        w = np.append(search.pole_frequencies(N, H.poles()), abs(frequency) if not G.discrete else 1.0)
        M.append(np.array([H.matrices.at(z) for z in N.z(w)]))
    M = np.concatenate(M)

    def least(c: float) -> float:
        S = M.copy()
        S[:, :m, p:] *= c
        S[:, m:, :p] /= c
        low, high = 0.0, np.linalg.norm(S, 2, axis=(1, 2)).max() * 1e6
        for _ in range(HALVINGS):
            g = np.sqrt(max(low, high * 1e-12) * high)
            T = S.copy()
            T[:, m:] /= g
            low, high = (low, g) if np.linalg.norm(T, 2, axis=(1, 2)).max() < 1 else (g, high)
        return float(high)

    across = np.linalg.norm(M[:, :m, p:], axis=(1, 2)).max(), np.linalg.norm(M[:, m:, :p], axis=(1, 2)).max()
    middle = np.sqrt(across[1] / across[0]) if min(across) > 0 else 1.0
    found = optimize.minimize_scalar(lambda x: np.log(least(middle * np.exp(x))), bounds=(-7, 7), method="bounded")
    c = float(middle * np.exp(found.x))
    return c, least(c)


def inverted(found: WorstCase, quantity: str) -> WorstCase:
    """The margin that is the inverse of a worst gain."""
    lower, upper = ((1 / x if x else np.inf) if np.isfinite(x) else 0.0 for x in (found.upper, found.lower))
    return replace(found, quantity=quantity, lower=lower * (1 - ROUNDED), upper=upper)
