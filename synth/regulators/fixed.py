"""A controller in fixed point: whole numbers alone, scaled so that nothing can overflow, and its error bounded.

Every signal s is a whole number S times a power of two of its own, s = S 2^-f, with |S| < 2^N in the words of N + 1
bits of the format qN. For each state and command, with whole coefficients of 32 bits and sums of 64,

    S = (c_1 S_1 + c_2 S_2 + ... + half) >> shift,

rounded once, halves up. The powers are chosen from proved peaks of the signals (`synth.proof.rounding`) for inputs
within given bounds, errors of rounding included, so that they fit whatever the inputs are: those beyond their bounds
are held at them, which the step reports. |c_1| + |c_2| + ... < 2^31 keeps the sums below 2^62. Limits hold the
commands after the sum. Only stable controllers can be scaled so; anti-windup is not offered.

Reference: Volkova, Hilaire and Lauter (2020), Arithmetic approaches for rigorous design of reliable fixed-point LTI
filters, IEEE Trans. Computers 69, 489, on scaling by peak gains.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_limits
from synth.errors import ExportError, ModelError, NumericalError
from synth.proof.rounding import Bound, Fixed, Law, bounded
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.sequential import State, controller_of
from synth.systems.statespace import StateSpace

FORMATS = {f"q{bits}": bits for bits in (15, 31)}  # bits without the sign
COEFFICIENTS = 2**31 - 1  # that a row's may add up to
LONGEST = 61  # shift
TRIES = 8  # at scales that leave room for errors


class Words(NamedTuple):
    """One sample's signals as whole numbers."""

    x: np.ndarray  # (n,) int64
    u: np.ndarray  # (m,) int64


@dataclass(frozen=True, eq=False)
class FixedController:
    """A stable controller in whole numbers, stepped as the exported C steps it. Make one with `FixedController.of`."""

    rows: np.ndarray  # (n + m, n + p) int64 coefficients of the next states and of the commands
    shifts: np.ndarray  # (n + m,) bits to the right
    states: np.ndarray  # (n,) f of x
    read: np.ndarray  # (p,) f of y
    commands: np.ndarray  # (m,) f of u
    most: np.ndarray  # (p,) bound of |y|, whole
    umin: np.ndarray  # (m,) whole; below every command where free
    umax: np.ndarray  # (m,) whole
    format: str  # "q15" or "q31"
    dt: float  # s
    bound: Bound  # proved

    @property
    def system(self) -> StateSpace:
        """The controller with the matrices that its whole coefficients stand for, exactly, and without limits."""
        return StateSpace(*law_of(self.rows, self.shifts, np.append(self.states, self.commands), self.read), self.dt)

    def init(self) -> State:
        """Zero states, and zero commands as far as the limits allow."""
        zero = np.zeros(len(self.commands), np.int64)
        u = np.clip(zero, self.umin, self.umax)
        return State(np.zeros(len(self.states), np.int64), np.ldexp(u.astype(float), -self.commands), False)

    def advance(self, x: np.ndarray, y: np.ndarray) -> tuple[Words, bool]:
        """(x, y) -> (next x, u) in whole numbers, and whether an input was beyond its bound: one call of the C."""
        held = np.clip(y, -self.most, self.most)
        total = self.rows @ np.append(x, held).astype(np.int64)
        half = np.where(self.shifts > 0, np.left_shift(np.int64(1), np.maximum(self.shifts - 1, 0)), 0)
        following = np.right_shift(total + half, self.shifts)
        n = len(self.states)
        return Words(following[:n], np.clip(following[n:], self.umin, self.umax)), bool((held != y).any())

    def words(self, y: Any) -> np.ndarray:
        """Inputs (..., p) as whole numbers, halves up; those that do not fit are the largest."""
        scaled = np.floor(np.ldexp(np.asarray(y, float), self.read) + 0.5)
        return np.clip(scaled, -(2.0**31), 2.0**31 - 1).astype(np.int64)

    def update(self, state: State, e: Any) -> tuple[State, np.ndarray]:
        """(state, e) -> (state, u) with controller input e (p,) and u (m,), both in their units."""
        found, fault = self.advance(state.x, self.words(e))
        u = np.ldexp(found.u.astype(float), -self.commands)
        return State(found.x, u, fault), u

    def step(self, state: State, y: Any, r: Any) -> tuple[State, np.ndarray]:
        """(state, y, r) -> (state, u): `update` with e = r - y."""
        return self.update(state, np.asarray(r, float) - np.asarray(y, float))

    @classmethod
    def of(cls, source: Any, format: str, inputs: np.ndarray, *, umin: Any = None, umax: Any = None) -> FixedController:
        """Scale a stable discrete controller for inputs (p,) that stay within bounds.

        Raises
        ------
        ModelError : limits that are none, or an AntiWindup.
        ExportError : the controller is continuous or not stable, or its numbers are too different for the words.
        """
        if isinstance(source, AntiWindup):
            raise ModelError("fixed point has no anti-windup; pass a stable controller, and umin and umax")
        K, bits = controller_of(source), FORMATS[format]
        if not K.discrete:
            raise ExportError(
                "the controller is continuous; discretise it with c2d(K, dt), and verify the sampled loop"
            )
        low = as_limits("umin", -np.inf if umin is None else umin, K.ny)
        high = as_limits("umax", np.inf if umax is None else umax, K.ny)
        read = bits - _exponent(inputs, bits)
        most = np.floor(np.ldexp(inputs, read) + 0.5).astype(np.int64)
        designed, conversion = Law(*K.matrices), np.ldexp(1.0, -read)
        sizes = np.zeros(K.n + K.ny)
        try:
            found = bounded(designed, designed, Fixed(sizes, np.zeros(K.nu)), inputs)
            for _ in range(TRIES):
                sizes = np.maximum(sizes, np.append(found.states, found.commands))
                scales = bits - _exponent(sizes, bits)
                rows, shifts = _coefficients(designed, scales, read)
                law = law_of(rows, shifts, scales, read)
                found = bounded(law, designed, Fixed(np.ldexp(1.0, -scales), conversion), inputs)
                if (np.append(found.states, found.commands) <= np.ldexp(2.0**bits - 1, -scales)).all():
                    break
            else:
                raise NumericalError("the errors are as large as the signals")
        except NumericalError as error:
            raise ExportError(f"no scaling for {format}: {error}") from None
        states, commands = scales[: K.n], scales[K.n :]
        least, largest = _limits(low, high, commands)
        if not (least < largest).all():
            raise ModelError(f"umin = {low.tolist()} is not below umax = {high.tolist()} in {format}")
        return cls(rows, shifts, states, read, commands, most, least, largest, format, K.dt, found)


def law_of(rows: np.ndarray, shifts: np.ndarray, scales: np.ndarray, read: np.ndarray) -> Law:
    """The matrices that whole coefficients stand for, exactly; scales are those of states and commands."""
    n = rows.shape[1] - len(read)
    M = np.ldexp(rows.astype(float), np.append(scales[:n], read)[None, :] - (scales + shifts)[:, None])
    return Law(M[:n, :n], M[:n, n:], M[n:, :n], M[n:, n:])


def _exponent(sizes: np.ndarray, bits: int) -> np.ndarray:
    """The least e for which sizes are at most (2^bits - 1) 2^(e - bits)."""
    e = np.frexp(np.maximum(sizes, 1e-300))[1]
    return e + (sizes > np.ldexp(2.0**bits - 1, e - bits))


def _coefficients(law: Law, scales: np.ndarray, read: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whole coefficients (n + m, n + p) and shifts, each row as fine as its sum allows."""
    n = len(law.A)
    M = np.block([[law.A, law.B], [law.C, law.D]])
    of = np.append(scales[:n], read)
    rows, shifts = np.zeros(M.shape, np.int64), np.zeros(len(M), np.int64)
    for i, row in enumerate(M):
        scaled = np.ldexp(row, scales[i] - of)  # with shift 0
        if scaled.any():
            room = (COEFFICIENTS - len(row)) / np.abs(scaled).sum()
            shifts[i] = min(int(np.frexp(room)[1]) - 1, LONGEST)
            if shifts[i] < 0:
                raise ExportError("the numbers of a row are too different for whole ones of 32 bits; scale the signals")
            rows[i] = np.floor(np.ldexp(scaled, shifts[i]) + 0.5).astype(np.int64)
    return rows, shifts


def _limits(low: np.ndarray, high: np.ndarray, scales: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whole limits within those given."""
    top = 2.0**31 - 1
    return (
        np.ceil(np.clip(np.ldexp(low, scales), -top, top)).astype(np.int64),
        np.floor(np.clip(np.ldexp(high, scales), -top, top)).astype(np.int64),
    )
