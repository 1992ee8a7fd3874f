"""`mussv`: the structured singular value of a matrix, of matrices over frequency, or of a system, from both sides.

    mu(M) = 1 / (the least |Delta| of the structure for which I - M Delta is singular), 0 where there is none

From above by (D, G) scalings (`scalings`), over all frequencies without a grid (`mucover`); from below by a Delta that
was found (`perturbations`) and put in. What is between the two is open: for more than three complex blocks, or with
real ones, mu may lie below the bound of the scalings, and the search may miss the smallest Delta.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.analysis import perturbations
from synth.analysis.blocks import Structure, as_structure
from synth.analysis.mucover import cover, response
from synth.analysis.norms import is_stable
from synth.analysis.perturbations import Perturbation, least, polished
from synth.analysis.scalings import Scalings, best_scalings
from synth.checks import as_number, check_unmasked, numerical, shown
from synth.errors import ModelError, VerificationError
from synth.systems.sampled import inverse_cayley
from synth.systems.statespace import StateSpace, as_system
from synth.threads import one_thread

TOLERANCE = 1e-4  # relative, of the bound over all frequencies
PEAKS = 4  # frequencies from which real parameters are looked for
OPEN = 0.01  # relative distance of the bounds that is told


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class Mu:
    """Bounds of a structured singular value; of k matrices arrays of them, (k,) and so on.

    `upper` is the bound of the scalings, evaluated from them; of a system it was verified between frequencies too.
    `lower` is 1 / |perturbation|, or 0 where none was found.
    """

    upper: Any  # float, or (k,)
    lower: Any  # float, or (k,)
    perturbation: np.ndarray  # (m, p) or (k, m, p) complex Delta with I - M Delta singular; zero where none was found
    residual: Any  # smallest singular value of I - M Delta over 1 + |M Delta|, put in; inf where there is no Delta
    frequency: float | None  # rad/s, of the perturbation; None where M is no system
    peak: float | None  # rad/s, where `upper` is largest; None where M is no system
    scalings: tuple[Scalings, ...]  # of every matrix; of a system those at `peak`
    blocks: tuple[tuple[int, int], ...]  # as they were given

    @property
    def gap(self) -> Any:
        """Relative distance of the bounds, 1 - lower / upper: 0 where they meet."""
        upper = np.asarray(self.upper, float)
        with np.errstate(invalid="ignore"):
            gap = np.where(upper > 0, 1 - np.asarray(self.lower) / upper, 0.0)
        return float(gap) if gap.ndim == 0 else gap

    @property
    def note(self) -> str:
        """What the bounds leave open; empty where they meet."""
        if np.max(self.gap, initial=0.0) <= OPEN:
            return ""
        return (
            f"mu is only known to be between the bounds, which are {np.max(self.gap):.0%} apart: neither a smaller "
            "Delta nor better scalings were found"
        )

    def __repr__(self) -> str:
        if np.ndim(self.upper):
            worst = int(np.argmax(self.upper))
            text = f"Mu of {len(self.upper)} matrices: largest at number {worst}, "
            text += f"{self.lower[worst]:.6g} to {self.upper[worst]:.6g}"
        else:
            text = f"Mu: {self.lower:.6g} to {self.upper:.6g}"
            if self.frequency is not None:
                text += f", Delta at {self.frequency:.6g} rad/s, verified between frequencies"
        return text + (f"\nnote: {self.note}" if self.note else "")


@one_thread
@numerical
def mussv(M: Any, blocks: Any, *, tol: float = TOLERANCE) -> Mu:
    """Bounds of the structured singular value.

    Parameters
    ----------
    M : (p, m) complex matrix; (k, p, m) for k of them, over frequency for example; or a stable system in any form that
        `system` takes, of which the largest value over all frequencies is found, not on a grid
    blocks : structure of Delta, which takes the p outputs of M to its m inputs, as pairs: (r, c) a full complex block
        of r rows and c columns, (r, 0) a complex number repeated r times, (-r, 0) a real one repeated r times. The rows
        of all blocks are the m inputs
    tol : relative, how near the bound over all frequencies is to the largest one at a single frequency; with real
        blocks alone, whose bound jumps from frequency to frequency, it may stay farther (`gap` has it)

    Returns
    -------
    Mu : `upper`, `lower`, `perturbation` with its `residual`, `frequency`, `scalings`; `note` says what is left open

    Raises
    ------
    ModelError : no matrix and no system; blocks that mean nothing or do not fit, the message names the pair.
    VerificationError : the system is not stable.
    NumericalError : no level could be shown between frequencies.

    Notes
    -----
    Real mu is not continuous: with real blocks alone a smallest Delta exists at some frequencies only, and next to them
    mu may be far less, so that a grid misses them. The bound of the scalings is an upper one at all frequencies anyway.
    Constant real parameters of a loop have a better answer, proved: `worst_gain` and `stability_margin`.

    References: Packard and Doyle (1993), Automatica 29, 71; Young, Newlin and Doyle (1991), CDC; docs/mu.md.
    """
    tol = as_number("tol", tol, "a relative distance, 1e-4 for example", above=0)
    matrices = _as_matrices(M)
    if matrices is None:
        G = as_system("M", M)
        structure = as_structure("blocks", blocks, G.ny, G.nu)
        return of_system(G, structure, tol)
    structure = as_structure("blocks", blocks, *matrices.shape[-2:])
    each = [_at(X, structure) for X in matrices.reshape(-1, *matrices.shape[-2:])]
    *bounds, scalings = zip(*each, strict=True)
    upper, lower, Delta, off = (x[0] if matrices.ndim == 2 else np.array(x) for x in bounds)
    return Mu(
        upper=upper, lower=lower, perturbation=Delta, residual=off, frequency=None, peak=None, scalings=scalings,
        blocks=_pairs(structure),
    )  # fmt: skip


def of_system(G: StateSpace, blocks: Structure, tol: float = TOLERANCE) -> Mu:
    """Bounds over all frequencies of a stable system."""
    if not is_stable(G):
        raise VerificationError("M is not stable: no Delta is needed for instability; close it by a controller first")
    H = inverse_cayley(G, 1.0) if G.discrete else G
    found = cover(H, blocks, tol)
    at = response(H)
    best = None
    ends = [] if blocks.is_complex else [w for w in (0.0, np.inf) if w != found.frequency]
    for w in (found.frequency, *ends):
        scalings = found.scalings if w == found.frequency else best_scalings(at(w), blocks)
        if best is None or scalings.bound * best.size > 1:
            f = perturbations.smallest(at(w), blocks, scalings)
            best = least(best, f and f._replace(at=w))
    if not blocks.is_complex and not (best and best.size * found.upper <= 1 + OPEN / 10):
        for w in (found.frequency, *found.tops[:PEAKS]):
            if 0 < w < np.inf:
                best = least(best, *_along(H, blocks, w))
    return _of_cover(G, blocks, found.upper, found.frequency, found.scalings, best)


def _along(H: StateSpace, blocks: Structure, w: float) -> list[Perturbation | None]:
    """Perturbations near a frequency and beside it."""
    I = np.eye(H.n)

    def family(t: float) -> tuple[np.ndarray, np.ndarray]:
        s = 1j * w * np.exp(np.clip(t, -5, 5))
        X = np.linalg.solve(s * I - H.A, H.B)
        return H.C @ X + H.D, -s * H.C @ np.linalg.solve(s * I - H.A, X)

    M = family(0.0)[0]
    scalings = best_scalings(M, blocks)
    if scalings.bound == 0:
        return []
    N = perturbations.scaled(M, scalings.left, scalings.right)[0]
    found = [polished(family, blocks, scalings, start, moving=True) for start in perturbations.starts(N, blocks)]
    return [f and f._replace(at=w * float(np.exp(np.clip(f.at, -5, 5)))) for f in found]


def _of_cover(
    G: StateSpace, blocks: Structure, upper: float, peak: float, scalings: Scalings, best: Perturbation | None
) -> Mu:
    """The result, with frequencies of the system that was given, and the perturbation put into its response."""

    def frequency(w: float) -> float:
        return float(2 * np.arctan(w) / G.dt) if G.discrete else float(w)

    peak = frequency(peak)
    where, Delta = (frequency(best.at), best.Delta) if best else (peak, np.zeros(blocks.shape, complex))
    off = np.inf
    if best:
        z = np.exp(1j * where * G.dt) if G.discrete else 1j * where
        M = G.matrices.at(z) if np.isfinite(where) and G.n else G.D
        off = perturbations.residual(M, Delta)
    return Mu(
        upper=upper, lower=1 / best.size if best else 0.0, perturbation=Delta, residual=off, frequency=where, peak=peak,
        scalings=(scalings,), blocks=_pairs(blocks),
    )  # fmt: skip


def _at(M: np.ndarray, blocks: Structure) -> tuple[float, float, np.ndarray, float, Scalings]:
    """Upper and lower bound at a matrix, Delta and its residual, and the scalings."""
    scalings = best_scalings(M, blocks)
    found = perturbations.smallest(M, blocks, scalings)
    if found is None:
        return scalings.bound, 0.0, np.zeros(blocks.shape, complex), np.inf, scalings
    return scalings.bound, 1 / found.size, found.Delta, found.residual, scalings


def _pairs(blocks: Structure) -> tuple[tuple[int, int], ...]:
    """The blocks in MATLAB's notation."""
    sign = {"real": -1, "complex": 1}
    return tuple((sign[block.kind] * block.size[0], 0) if block.repeated else block.size for block in blocks.blocks)


def _as_matrices(M: Any) -> np.ndarray | None:
    """(p, m) or (k, p, m) complex numbers; None for what is to be taken for a system."""
    if not isinstance(M, np.ndarray | np.generic | list | int | float | complex) or isinstance(M, bool | np.bool_):
        return None
    check_unmasked("M", M)
    wanted = "pass a complex matrix (p, m), k of them (k, p, m), or a system"
    try:
        raw = np.asarray(M)
    except Exception:  # ragged lists and foreign objects
        raise ModelError(f"M is {shown(M)}; {wanted}") from None
    if raw.dtype.kind not in "iufc" or raw.ndim > 3 or not raw.size:
        raise ModelError(f"M is {shown(M)}; {wanted}")
    found = np.atleast_2d(raw).astype(complex)
    if not np.isfinite(found).all():
        where = tuple(int(i) for i in np.argwhere(~np.isfinite(found))[0])
        raise ModelError(f"M[{', '.join(map(str, where))}] is {found[where]}; every entry must be finite")
    return found
