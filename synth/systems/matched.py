"""Zero-pole matching, z = e^(s dt), of systems with one input and one output, there and back.

Of the zeros at infinity one stays there, so that the sampled system is a sample late, and the others go to -1. The gain
is that at s = 0, divided by powers of s where poles or zeros are there, which needs no decision about what is zero:

    k_d = k product of c(z_i) / product of c(p_i) / 2^(zeros at -1),   c(a) = a / (e^(a dt) - 1),  1/dt at a = 0

Reference: Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, section 6.3.2.
"""

from __future__ import annotations

import numpy as np

from synth.errors import ModelError, NumericalError
from synth.systems.realization import balanced, of_roots
from synth.systems.statespace import StateSpace
from synth.systems.zeros import transmission_zeros

POINTS = 9  # at which the gain is read
AT_NYQUIST = 1e-12  # relative error of a zero at -1, alone
NEAREST = 0.05  # to -1: how far several there may be apart by rounding


def matched(G: StateSpace, dt: float) -> StateSpace:
    """The sampled system.

    Raises
    ------
    ModelError : G has several inputs or outputs.
    NumericalError : a pole or a zero is so fast that e^(s dt) overflows.
    """
    zeros, poles, gain = _roots(G)
    infinite = max(len(poles) - len(zeros) - 1, 0)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        moved = [np.exp(roots * dt) for roots in (zeros, poles)]
        scale = _product(_differences(zeros, dt)) / _product(_differences(poles, dt))
    if not (all(np.isfinite(roots).all() for roots in moved) and np.isfinite(scale)):
        fastest = max((*zeros, *poles), key=np.real)
        raise NumericalError(
            f"method is 'matched' and the pole or zero at {fastest:.4g} rad/s goes beyond all numbers in dt = {dt:g} "
            "s; pass a shorter dt, or another method"
        )
    found = of_roots("G", np.append(moved[0], -np.ones(infinite)), moved[1], gain * scale / 2.0**infinite)
    return StateSpace(found.A, found.B, found.C, found.D, dt, G.u, G.y, G.units)


def unmatched(G: StateSpace) -> StateSpace:
    """The continuous system.

    Raises
    ------
    ModelError : G has several inputs or outputs, poles or zeros that are no e^(s dt) (at 0 or below), or several zeros
        at infinity, which are delays.
    """
    zeros, poles, gain = _roots(G)
    if len(poles) - len(zeros) > 1:
        raise ModelError(
            f"G has {len(poles)} poles and {len(zeros)} zeros, and method 'matched' knows one zero at infinity: the "
            "others are delays, which no continuous system of finite order has; take them out, or pass method='tustin'"
        )
    zeros = zeros[np.argsort(np.abs(zeros + 1))]
    infinite = _at_nyquist(zeros)
    zeros = zeros[infinite:]
    for name, roots in (("pole", poles), ("zero", zeros)):
        check_logarithm("matched", name, roots)
    zeros, poles = np.log(zeros) / G.dt, np.log(poles) / G.dt
    scale = _product(_differences(poles, G.dt)) / _product(_differences(zeros, G.dt)) * 2.0**infinite
    found = of_roots("G", zeros, poles, gain * scale)
    return StateSpace(found.A, found.B, found.C, found.D, 0.0, G.u, G.y, G.units)


def check_logarithm(method: str, name: str, roots: np.ndarray) -> None:
    """Raise ModelError unless the roots have real systems as their logarithms."""
    wrong = roots[(np.abs(np.imag(roots)) <= 1e-9 * np.abs(roots)) & (np.real(roots) <= 0)]
    if wrong.size:
        at = float(np.real(wrong[np.argmin(np.abs(wrong))]))
        raise ModelError(
            f"G has the {name} z = {at:.6g}, and method {method!r} is a logarithm, which no number from 0 down has as "
            f"a real one: {'at 0 it is a delay' if abs(at) < 1e-9 else 'it changes sign from sample to sample'}; pass "
            "method='tustin', or take that part out"
        )


def _roots(G: StateSpace) -> tuple[np.ndarray, np.ndarray, float]:
    """Zeros, poles and the factor k of k (s - z1).../(s - p1)..., which is read where the roots are not."""
    if (G.ny, G.nu) != (1, 1):
        raise ModelError(
            f"method is 'matched' and G is {G.ny} x {G.nu}: it has no zeros entry by entry; pass one entry, G[0, 0], "
            "or another method"
        )
    M = balanced(G.matrices)
    zeros, poles = transmission_zeros(*M), np.linalg.eigvals(M.A).astype(complex)
    moduli = np.abs([*zeros, *poles])
    moduli = moduli[moduli > 1e-9 * moduli.max(initial=0.0)]
    low, high = (moduli.min(), moduli.max()) if moduli.size else (1.0, 1.0)
    read = []
    for s in np.geomspace(low, high * 2, POINTS) * np.exp(0.3j * np.pi):
        logarithm = np.log(s - poles).sum() - np.log(s - zeros).sum()
        read.append(complex(M.at(s)[0, 0]) * np.exp(logarithm))
    return zeros, poles, float(np.median(np.real(read)))


def _differences(roots: np.ndarray, dt: float) -> np.ndarray:
    """c(a) = a / (e^(a dt) - 1)."""
    grown = np.expm1(roots * dt)
    return np.where(grown == 0, 1 / dt, roots / np.where(grown == 0, 1.0, grown))


def _product(factors: np.ndarray) -> float:
    """Of complex numbers that come with their conjugates."""
    return float(np.prod(factors).real)


def _at_nyquist(zeros: np.ndarray) -> int:
    """How many zeros, the nearest first, are at -1 but for rounding, which spreads k of them by its k-th root."""
    return max(
        (
            k
            for k in range(1, len(zeros) + 1)
            if np.abs(zeros[:k] + 1).max() < min(10 * AT_NYQUIST ** (1 / k), NEAREST)
            and abs(zeros[:k].mean() + 1) < 1e3 * AT_NYQUIST
        ),
        default=0,
    )
