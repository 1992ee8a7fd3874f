"""Margins of a rational loop in exact arithmetic: real roots of polynomials with rational coefficients."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from fractions import Fraction
from functools import reduce

import numpy as np
from flint import acb, arb, ctx, fmpq, fmpq_poly

SKEWS = (0, 1, -1)
BITS = 400
REAL = 1e-60  # relative, of the imaginary part of a root that is real


def numbered(frequencies: Iterable, values: Iterable, name: str) -> dict[str, float]:
    """Values and frequencies by name, in the order of frequency."""
    found = sorted(zip(map(float, frequencies), map(float, values), strict=True))
    return {key: x for k, (w, value) in enumerate(found) for key, x in ((f"{name} {k}", value), (f"{name} {k} at", w))}


def exact_margins(num, den, skews: Iterable[int] = SKEWS) -> dict[str, float]:
    """Of num / den in s: every crossing, and margins if the closed loop is stable; angles in degrees."""
    before, ctx.prec = ctx.prec, BITS
    try:
        N, D = _rational(num), _rational(den)
        (a, b), (c, d) = _on_axis(N), _on_axis(D)

        def L(w: arb) -> acb:
            return _at(N, w) / _at(D, w)

        start = [arb(0)] if D.coeffs()[0] != 0 else []
        real = [w for w in (*start, *_positive(b * c - a * d)) if L(w).real < 0]
        gains = [-1 / L(w).real for w in real]
        unit = list(_positive(a * a + b * b - c * c - d * d))
        phases = [(-L(w)).arg() * 180 / arb.pi() for w in unit]
        out = numbered(real, gains, "gain") | numbered(unit, phases, "phase")
        if all(root.real < 0 for root, _ in (N + D).complex_roots()):
            real, gains, unit, phases = ([float(x) for x in xs] for xs in (real, gains, unit, phases))
            out |= _margins(real, gains, unit, phases)
            if D.degree() == N.degree() and abs(N.coeffs()[-1] / D.coeffs()[-1]) > 1:
                out["delay"] = 0.0  # L stays above one, and a short delay turns it to -1 at a high frequency
            for skew in skews:
                value, frequency = _peak(D + (skew - 1) * (N + D) / 2, N + D)
                out |= {f"alpha {skew}": 1 / value, f"at {skew}": frequency}
        return out
    finally:
        ctx.prec = before


def _margins(real: list[float], gains: list[float], unit: list[float], phases: list[float]) -> dict[str, float]:
    """The nearest crossings."""
    nearer = min(zip(gains, real, strict=True), key=lambda x: abs(np.log(x[0])), default=(1.0, np.nan))
    phase, frequency = min(((abs(f), w) for f, w in zip(phases, unit, strict=True)), default=(180.0, np.nan))
    return {
        "gain up": min((g for g in gains if g > 1), default=np.inf),
        "gain down": max((g for g in gains if g < 1), default=0.0),
        "gain at": nearer[1],
        "phase": phase,
        "phase at": frequency,
        "delay": min((np.deg2rad(f % 360) / w for f, w in zip(phases, unit, strict=True)), default=np.inf),
    }


def _rational(coefficients) -> fmpq_poly:
    """From doubles, highest power first, exactly."""
    ratios = [Fraction(float(x)) for x in np.asarray(coefficients)[::-1]]
    return fmpq_poly([fmpq(x.numerator, x.denominator) for x in ratios])


def _on_axis(q: fmpq_poly) -> tuple[fmpq_poly, fmpq_poly]:
    """Real and imaginary part of q(j w), polynomials in w."""
    x = q.coeffs()
    real, imaginary = ([c * turn[k % 4] for k, c in enumerate(x)] for turn in ((1, 0, -1, 0), (0, 1, 0, -1)))
    return fmpq_poly(real), fmpq_poly(imaginary)


def _positive(q: fmpq_poly) -> Iterator[arb]:
    """Its positive real roots."""
    for root, _ in q.complex_roots() if q.degree() > 0 else ():
        if root.real > 0 and float(abs(root.imag).upper()) < REAL * float(abs(root).upper()):
            yield root.real


def _at(q: fmpq_poly, w: arb) -> acb:
    """q(j w)."""
    return reduce(lambda out, x: out * acb(0, w) + acb(arb(x)), q.coeffs()[::-1], acb(0))


def _peak(N: fmpq_poly, D: fmpq_poly) -> tuple[float, float]:
    """Largest |N/D| on the imaginary axis and its frequency: where the slope is zero, or at an end."""
    above, below = (a * a + b * b for a, b in map(_on_axis, (N, D)))
    slope = above.derivative() * below - above * below.derivative()
    last = above.coeffs()[-1] / below.coeffs()[-1] if above.degree() == below.degree() else fmpq(0)
    values = [(float(abs(_at(N, w) / _at(D, w))), float(w)) for w in (arb(0), *_positive(slope))]
    return max(*values, (float(arb(last).sqrt()), np.inf))
