"""Two theorems about a loop on a box of parameters, as positive polynomials and what is to be checked of them.

Gain. With p and N of `pencils` and k = min(nw, nz),

    h(u, d) = |p|^2 det(g^2 I - G(j omega)^H G(j omega)),        u = omega^2,

is a real polynomial of degree n in u and at most twice that of the minors in each parameter. If the loop is stable with
a gain below g at rest for ONE d, and h > 0 on [0, inf] x box, it is stable with an H-infinity norm below g on the whole
box: on the way from that point a pole on the axis or a gain of g would make h zero, and a pole at infinity makes the
highest coefficient zero, which is h at u = inf.

Stability. p(j omega) = R(u) + j omega I(u). If the loop is stable for one d and (R, u I) is never (0, 0) for u >= 0,
nor the pair of highest coefficients at infinity, it is stable on the whole box. On a piece it is enough that one
combination a R + b u I of the pair is positive.

Frequencies are divided into pieces whose ends are points of the projective line, so that u = inf is an end like any
other. On each piece the polynomial is homogeneous in the two ends, and the coefficients are rounded to doubles with the
radius of their balls and the rounding as error; from there on `boxes` works.

References: Bernstein expansion in robust control: Zettler and Garloff (1998), IEEE TAC 43, 425; zero exclusion:
Barmish (1994), New Tools for Robustness of Linear Systems, chapter 7.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from flint import acb, acb_mat, arb, ctx, fmpq, fmpq_mat

from synth.proof import reduced
from synth.proof.boxes import HIGHEST, ROUNDING, Boxes
from synth.proof.pencils import Pencil, along, bernstein_of, on_unit, rational

MIDPOINT = 2.0**-51  # relative error of a midpoint as a double, with room
MOST_COEFFICIENTS = 300_000  # of a polynomial on a box
TINY, HUGE = 1e-200, 1e200
UNDERFLOW = 1e-300  # what powers of a level may have lost


class Pieces(NamedTuple):
    """Polynomials on every piece of frequencies; of a gain those times the powers of (g / 2^exponent)^2."""

    coefficients: np.ndarray  # (pieces, components, n + 1, 2 r1 + 1, ...)
    errors: np.ndarray  # (pieces, components)
    exponent: int = 0  # of a gain of the loop's size


def size_of_gain(pencil: Pencil) -> int:
    """How many coefficients a box of the polynomial of the gain has."""
    if pencil.off:
        return reduced.SIZE if reduced.is_within_reach(pencil, bordered=True) else 10**9
    return (pencil.order + 1) * math.prod(2 * r + 1 for r in pencil.degrees(bordered=True))


def size_of_stability(pencil: Pencil) -> int:
    """How many coefficients a box of the pair of the stability has."""
    if pencil.off:
        return reduced.SIZE
    return 2 * ((pencil.order + 1) // 2 + 1) * math.prod(r + 1 for r in pencil.degrees(bordered=False))


def fits(pencil: Pencil, size: int, *, bordered: bool) -> bool:
    """Whether a polynomial can be handled."""
    if pencil.off:
        return size <= MOST_COEFFICIENTS
    highest = max((pencil.order, *(2 * r for r in pencil.degrees(bordered=bordered))))
    return size <= MOST_COEFFICIENTS and highest <= HIGHEST


def degrees_for(pencil: Pencil, edges: Sequence[float], *, bordered: bool) -> tuple[int, ...]:
    """Degrees of interpolants in the parameters, of loops with hold equivalents; none of others, which need none."""
    return reduced.degrees_for(pencil, edges, bordered=bordered) if pencil.off else ()


def gain_pieces(pencil: Pencil, edges: Sequence[float], bits: int, degrees: Sequence[int] = ()) -> Pieces:
    """The polynomials h_0, h_1, ... with h = h_0 + g^2 h_1 + g^4 h_2 + ... on every piece between the edges (rad/s).

    `degrees` are those of `degrees_for`.

    Raises
    ------
    ZeroDivisionError : a node could be a pole; other edges help.
    """
    with ctx.workprec(bits):
        n, r = pencil.order, degrees if pencil.off else pencil.degrees(bordered=True)
        coarse, fine = _nodes(edges, n // 2 + 1), _nodes(edges, n + 1)
        sampled = reduced.sampled if pencil.off else Pencil.sampled
        real, imaginary = _parts(sampled(pencil, coarse, r, bordered=True), coarse)
        up = fmpq_mat(len(fine), len(coarse), _powers([w * w for w in fine], len(coarse)))
        up = up * fmpq_mat(len(coarse), len(coarse), _powers([w * w for w in coarse], len(coarse))).inv()
        if pencil.off:
            finer: list[Any] = [reduced.onto(k, [b for _, b in on_unit(2 * k)]) for k in r]
        else:
            finer = [bernstein_of(on_unit(2 * k), k) * bernstein_of(on_unit(k), k).inv() for k in r]
        for axis, Q in enumerate([*finer, up]):
            real, imaginary = along(real, axis + 1, Q), along(imaginary, axis + 1, Q)
        imaginary = imaginary * np.array([arb(w) for w in fine], object)
        h = (_gain_of_minors if pencil.off else _gain_values)(real, imaginary, pencil.sizes[1:])
        exponent = _unit(h)
        h = h * np.array([arb(2) ** (2 * k * exponent) for k in range(len(h))]).reshape(-1, *[1] * (h.ndim - 1))
        for axis, k in enumerate(r):
            h = along(h, axis + 1, bernstein_of(on_unit(2 * k), 2 * k).inv())
        off = _off_gain(pencil, edges, r, exponent) if pencil.off else None
        return _on_pieces(h, [w * w for w in fine], edges, n, off=off)._replace(exponent=exponent)


def at_level(pieces: Pieces, level: float) -> Boxes:
    """The polynomial h of a level, in doubles with a bound on the error."""
    g = math.ldexp(level, -pieces.exponent)
    powers = np.array([(g * g) ** k for k in range(pieces.coefficients.shape[1])])
    rounded = np.array([(2 * k + 4) * ROUNDING for k in range(len(powers))])  # of the power, the product and the sum
    shape = pieces.coefficients.shape
    size = np.abs(pieces.coefficients).reshape(*shape[:2], -1).max(axis=2)
    errors = (powers * (pieces.errors * (1 + 1e-9) + size * (rounded + len(powers) * ROUNDING))).sum(axis=1)
    h = np.tensordot(pieces.coefficients, powers, axes=(1, 0))
    return _first(h[:, None], errors[:, None] * (1 + 1e-9) + UNDERFLOW)


def stability_pieces(pencil: Pencil, edges: Sequence[float], bits: int, degrees: Sequence[int] = ()) -> Boxes:
    """The pair (R, u I), or the one that is its equal at infinity, on every piece between the edges (rad/s)."""
    with ctx.workprec(bits):
        n, r = pencil.order, degrees if pencil.off else pencil.degrees(bordered=False)
        degree = (n + 1) // 2
        nodes = _nodes(edges, degree + 1)
        R, I = _parts((reduced.sampled if pencil.off else Pencil.sampled)(pencil, nodes, r, bordered=False), nodes)
        u = [w * w for w in nodes]
        pair = np.concatenate([R, I * np.array([arb(x) for x in u], object)])
        last = np.concatenate([R, I]) if n % 2 == 0 else pair
        found = []
        off = _off_pair(pencil, edges, r) if pencil.off else None
        for values in (pair, last):
            for axis, k in enumerate(r):
                if pencil.off:
                    values = along(values, axis + 1, reduced.onto(k, [b for _, b in on_unit(k)]))
                values = along(values, axis + 1, bernstein_of(on_unit(k), k).inv())
            found.append(_on_pieces(values, u, edges, degree, apart=True, off=off))
        (V, e, _), (W, f, _) = found
        return _first(np.concatenate([V[:-1], W[-1:]]), np.concatenate([e[:-1], f[-1:]]))


def is_positive(boxes: Boxes) -> np.ndarray:
    """Of which boxes the only component is proved positive."""
    V = boxes.coefficients
    return V.reshape(len(V), -1).min(axis=1) > boxes.errors[:, 0]


def negative_corner(boxes: Boxes) -> tuple[int, int] | None:
    """A box and its corner where the only component is proved negative, the worst of them."""
    values = boxes.corners[0][:, 0] / boxes.errors
    if not len(values) or values.min() >= -1:
        return None
    box, corner = np.unravel_index(int(values.argmin()), values.shape)
    return int(box), int(corner)


def excludes_zero(boxes: Boxes) -> np.ndarray:
    """Of which boxes a combination of the two components is proved positive."""
    V, e = boxes.coefficients.reshape(len(boxes.low), 2, -1), boxes.errors
    mean = V.mean(axis=2)
    turned = (V[:, 0] + 1j * V[:, 1]) * (mean[:, 0] - 1j * mean[:, 1])[:, None]
    angles = np.angle(turned)
    direction = (angles.max(axis=1) + angles.min(axis=1)) / 2 + np.arctan2(mean[:, 1], mean[:, 0])
    a, b = np.cos(direction), np.sin(direction)
    least = (V[:, 0] * a[:, None] + V[:, 1] * b[:, None]).min(axis=1)
    size = np.abs(V).max(axis=2)
    error = (e[:, 0] + 4 * ROUNDING * size[:, 0]) * np.abs(a) + (e[:, 1] + 4 * ROUNDING * size[:, 1]) * np.abs(b)
    return least > error * (1 + 1e-9)


def _first(V: np.ndarray, errors: np.ndarray) -> Boxes:
    """One box for each piece."""
    count, axes = len(V), V.ndim - 2
    return Boxes(V, errors, np.zeros((count, axes)), np.ones((count, axes)), np.arange(count))


def _nodes(edges: Sequence[float], count: int) -> list[fmpq]:
    """`count` of the edges, as far apart as they can be."""
    return [rational(edges[round(i * (len(edges) - 1) / max(count - 1, 1))]) for i in range(count)]


def _powers(points: Sequence[fmpq], count: int) -> list[fmpq]:
    return [x**k for x in points for k in range(count)]


def _parts(values: np.ndarray, nodes: Sequence[fmpq]) -> tuple[np.ndarray, np.ndarray]:
    """Real parts, and imaginary ones over omega, both polynomials in u."""
    real = np.array([x.real for x in values.flat], object).reshape(values.shape)
    imaginary = np.array([x.imag for x in values.flat], object).reshape(values.shape)
    return real, imaginary * np.array([arb(1 / w) for w in nodes], object)


def _gain_values(real: np.ndarray, imaginary: np.ndarray, channels: tuple[int, int]) -> np.ndarray:
    """h_0, h_1, ..., h_k at the nodes, from p and N there."""
    nw, nz = channels
    small = min(nw, nz)
    found = np.empty((small + 1, *real.shape[1:]), object)
    for at in np.ndindex(real.shape[1:]):
        x, y = real[(slice(None), *at)], imaginary[(slice(None), *at)]
        p = x[0] * x[0] + y[0] * y[0]
        if small == 1:
            found[(0, *at)] = -sum((a * a + b * b for a, b in zip(x[1:], y[1:], strict=True)), arb(0))
            found[(1, *at)] = p
            continue
        N = acb_mat(nz, nw, [acb(a, b) for a, b in zip(x[1:], y[1:], strict=True)])
        H = acb_mat(nw, nz, [N[i, j].conjugate() for j in range(nw) for i in range(nz)])
        c = (H * N if nw <= nz else N * H).charpoly().coeffs()
        for k in range(small + 1):
            found[(k, *at)] = c[k].real * p ** (k + 1 - small)
    return found


def _gain_of_minors(real: np.ndarray, imaginary: np.ndarray, channels: tuple[int, int]) -> np.ndarray:
    """The same from the minors of `reduced`."""
    small, at, found = min(channels), 0, []
    for j in range(small + 1):
        count = math.comb(channels[0], j) * math.comb(channels[1], j)
        part = slice(at, at + count)
        found.append((-1) ** j * (real[part] ** 2 + imaginary[part] ** 2).sum(axis=0))
        at += count
    return np.array(found[::-1], object)


def _off_gain(pencil: Pencil, edges: Sequence[float], degrees: Sequence[int], exponent: int) -> np.ndarray:
    """What h_0, h_1, ... on the pieces are off, (pieces, components)."""
    squared = reduced.off(pencil, edges, degrees, bordered=True).squared
    _, nw, nz = pencil.sizes
    small, at, found = min(nw, nz), 0, []
    for j in range(small + 1):
        count = math.comb(nw, j) * math.comb(nz, j)
        found.append(squared[at : at + count].sum(axis=0) * 2.0 ** (2 * (small - j) * exponent))
        at += count
    return np.array(found[::-1]).T * (_largest(edges) ** pencil.order)[:, None] * reduced.ROOM


def _off_pair(pencil: Pencil, edges: Sequence[float], degrees: Sequence[int]) -> np.ndarray:
    """What R, and u I or I, on the pieces are off, (pieces, 2)."""
    error, n = reduced.off(pencil, edges, degrees, bordered=False).error[0], pencil.order
    size = error * _largest(edges) ** ((n + 1) // 2)
    other = np.append(size[:-1] * np.maximum(edges, 1.0), size[-1] * max(1.0, 1 / edges[-1]))
    return np.array([size, other]).T * reduced.ROOM


def _ends(edges: Sequence[float]) -> list[tuple[fmpq, fmpq]]:
    """Ends of the pieces of u, points (u, 1) up to a factor."""
    w = [rational(x) for x in edges]
    return [(fmpq(0), 1 / w[0]), *((x, 1 / x) for x in w), (w[-1], fmpq(0))]


def _largest(edges: Sequence[float]) -> np.ndarray:
    """The largest sum of both coordinates of a point of every piece."""
    sums = np.array([float(x + y) for x, y in _ends(edges)])
    return np.maximum(sums[1:], sums[:-1]) * reduced.ROOM


def _on_pieces(
    values: np.ndarray, u: Sequence[fmpq], edges: Sequence[float], degree: int, *, apart: bool = False,
    off: np.ndarray | None = None,
) -> Pieces:  # fmt: skip
    """Values at u, the last axis, as coefficients on all pieces, then the first axis but one; scaled to about one.

    `apart` says whether components may be scaled one by one, `off` what they are off, (pieces, components).
    """
    ends = _ends(edges)
    coefficients, errors = [], []
    for piece, (a, b) in enumerate(itertools.pairwise(ends)):
        det = a[0] * b[1] - a[1] * b[0]
        nodes = [((x * b[1] - b[0]) / det, (a[0] - x * a[1]) / det) for x in u]  # (u, 1) = alpha a + beta b
        on = along(values, values.ndim - 1, bernstein_of(nodes, degree).inv())
        if off is not None:
            on = on + np.array([arb(0, x) for x in off[piece]], object).reshape(-1, *[1] * (on.ndim - 1))
        middle, radius = _doubles(on, apart=apart)
        size = np.abs(middle).reshape(len(middle), -1).max(axis=1)
        coefficients.append(np.moveaxis(middle, -1, 1))
        errors.append(radius.reshape(len(radius), -1).max(axis=1) * (1 + 1e-9) + MIDPOINT * size)
    return Pieces(np.array(coefficients), np.array(errors))


def _doubles(values: np.ndarray, *, apart: bool) -> tuple[np.ndarray, np.ndarray]:
    """Midpoints and radii of balls, scaled by a power of two so that the largest of them is about one."""
    if apart and len(values) > 1:
        both = [_doubles(component[None], apart=False) for component in values]
        return np.concatenate([m for m, _ in both]), np.concatenate([r for _, r in both])
    flat = values.ravel().tolist()
    middle = np.array([float(x) for x in flat])
    largest = np.abs(middle).max()
    if not TINY < largest < HUGE:
        top = max((x.mid().man_exp() for x in flat if not x.contains(0)), key=_exponent, default=(1, 0))
        scale = arb(2) ** -_exponent(top)
        flat = [x * scale for x in flat]
        middle = np.array([float(x) for x in flat])
        largest = np.abs(middle).max()
    radius = np.array([float(x.rad()) for x in flat])
    if not (np.isfinite(middle).all() and np.isfinite(radius).all()):
        raise ZeroDivisionError("a node of the interpolation could be a pole")
    scale = 2.0 ** -math.frexp(largest)[1] if largest else 1.0
    return (middle * scale).reshape(values.shape), (radius * scale).reshape(values.shape)


def _unit(h: np.ndarray) -> int:
    """Exponent of two of a gain about as large as the loop's: the root of the ratio of |N|^2 and |p|^2."""
    tops = [
        max((_exponent(x.mid().man_exp()) for x in part.flat if not x.contains(0)), default=None) for part in h[-2:]
    ]
    return 0 if tops[0] is None or tops[1] is None else (tops[0] - tops[1]) // 2


def _exponent(x: tuple) -> int:
    return int(x[0]).bit_length() + int(x[1])
