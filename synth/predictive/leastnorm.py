"""Least norm under inequalities in long arithmetic, for programs that doubles do not carry.

    minimise  z'z/2   subject to   G z <= b

The dual active-set method: from the optimum for some rows, the most violated row is driven to its limit while the
multipliers stay positive; a row whose multiplier vanishes on the way is let go. Every step increases the optimum, so
it ends. The inverse of G_W G_W' of the working set W is kept and bordered.

References: Goldfarb and Idnani (1983), Mathematical Programming 27, 1; Johansson (2017), IEEE Trans. Computers 66,
1281 (Arb).
"""

from __future__ import annotations

from flint import arb, arb_mat

from synth.errors import NumericalError

DEPENDENT = 2.0**-160  # a row with a smaller part of its square beyond the working set lies in its span
MET = 2.0**-60  # how far a row may exceed its limit, relative to the size of both or 1


def least_norm(G: arb_mat, b: arb_mat) -> tuple[arb_mat, list[int], list[arb]]:
    """(z, working set, its multipliers) at the optimum, at the precision in force.

    Parameters
    ----------
    G : (M, N), b : (M, 1) of which the midpoints count

    Raises
    ------
    NumericalError : the rows contradict each other, or the precision does not suffice to solve them.
    """
    rows, limit = [arb_mat([row]) for row in G.tolist()], [e.mid() for e in b.entries()]
    squares = [(g * g.transpose())[0, 0].mid() for g in rows]
    sizes = [1 + abs(float(e)) for e in limit]
    z, W, y, J = arb_mat(G.ncols(), 1), list[int](), list[arb](), arb_mat(0, 0)
    for _ in range(20 * len(rows) + 20):
        excess = [float((e - u).mid()) / size for e, u, size in zip((G * z).entries(), limit, sizes, strict=True)]
        for i in W:
            if not abs(excess[i]) <= MET:
                raise NumericalError("a limit in the working set is not met: the rows depend on each other")
            excess[i] = 0.0
        p = max(range(len(excess)), key=excess.__getitem__, default=-1)
        if p < 0 or excess[p] <= MET:
            return z, W, y
        z, W, y, J = _entered(p, rows, limit, squares, z, W, y, J)
    raise NumericalError("the active-set method did not come to an end")


def _entered(p: int, rows, limit, squares, z, W, y, J):
    """The optimum with row `p` at its limit and in the working set."""
    multiplier = arb(0)
    while True:
        k = arb_mat(len(W), 1, [(rows[i] * rows[p].transpose())[0, 0] for i in W])
        share, step = (J * k).mid(), rows[p]
        for s, i in zip(share.entries(), W, strict=True):
            step = step - rows[i] * s
        gain = (squares[p] - (k.transpose() * share).trace()).mid() if W else squares[p]
        full = None if gain <= DEPENDENT * squares[p] else (((rows[p] * z)[0, 0] - limit[p]) / gain).mid()
        blocking = [((m / s).mid(), i) for i, (m, s) in enumerate(zip(y, share.entries(), strict=True)) if s > 0]
        short, leaving = min(blocking, default=(None, -1))
        length = full if short is None or (full is not None and full <= short) else short
        if length is None:
            raise NumericalError("the rows contradict each other")
        z = (z - step.transpose() * length).mid()
        y = [(m - length * s).mid() for m, s in zip(y, share.entries(), strict=True)]
        multiplier = (multiplier + length).mid()
        if length is full:
            return z, [*W, p], [*y, multiplier], _bordered(J, share, gain)
        J = _without(J, leaving)
        W, y = W[:leaving] + W[leaving + 1 :], y[:leaving] + y[leaving + 1 :]


def _bordered(J: arb_mat, share: arb_mat, gain: arb) -> arb_mat:
    """The inverse with one more row and column."""
    r = share.entries()
    inner = (J + share * share.transpose() * (1 / gain)).tolist() if r else []
    last = [-e / gain for e in r]
    return arb_mat([[*row, e] for row, e in zip(inner, last, strict=True)] + [[*last, 1 / gain]]).mid()


def _without(J: arb_mat, i: int) -> arb_mat:
    """The inverse without row and column `i`."""
    table = J.tolist()
    column = [row[i] for row in table]
    keep = [k for k in range(len(table)) if k != i]
    if not keep:
        return arb_mat(0, 0)
    return arb_mat([[table[j][k] - column[j] * column[k] / column[i] for k in keep] for j in keep]).mid()
