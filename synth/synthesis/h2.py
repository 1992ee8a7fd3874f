"""H2 synthesis by Riccati equations: balance, solve, close the loop, measure; `equations/h2_riccati.py` has the theory.

The H2 norm is the root of the mean power of z for white noise of intensity one (continuous) or covariance one
(discrete) in w. What the Riccati solutions say is the least norm is compared with that of the closed loop, which comes
from its Gramian: neither knows of the other.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.analysis.norms import h2norm, judge
from synth.analysis.precondition import balanced, check_assumptions
from synth.checks import as_flag, as_whole, numerical, printable, timebase_told
from synth.equations.h2_riccati import CANCELLED, h2_controller
from synth.errors import ModelError, VerificationError
from synth.files import provenance
from synth.synthesis.design import Design, Info
from synth.synthesis.hinfinity import as_plant, slowest_pole
from synth.synthesis.remarks import words
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace
from synth.threads import one_thread

AGREE = 1e-6  # relative distance of the measured norm from the claimed one from which on it is told
WRONG = 1e-2  # the same from which on nothing is returned
NOTHING = 1e-6  # of the terms that z is the sum of: a norm below it is what rounding leaves of them


@dataclass(frozen=True, eq=False)
class H2Design:
    """An H2-optimal controller, verified. Unpacks as ``K, CL, gamma, info``, as MATLAB's and python-control's."""

    design: Design  # as every tool takes it, saves and exports it; its `gamma` is the verified H-infinity norm
    gamma: float  # H2 norm of the closed loop, measured by its Gramian
    optimum: float  # the least H2 norm, as the Riccati solutions claim: a bound from below, which is no proof
    X: np.ndarray  # (n, n) solution of the control's Riccati equation, in the plant's states
    Y: np.ndarray  # (n, n) that of the filter, the covariance of the error of its estimate
    residual: float  # the larger of their relative residuals

    plant = property(lambda self: self.design.plant)
    controller = property(lambda self: self.design.controller)
    closed_loop = property(lambda self: self.design.closed_loop)
    info = property(lambda self: self.design.info)
    margins = property(lambda self: self.design.margins)
    warnings = property(lambda self: self.design.warnings)
    K = property(lambda self: self.design.K)
    CL = property(lambda self: self.design.CL)

    def __iter__(self) -> Iterator[Any]:
        """K, CL, gamma, info."""
        return iter((self.K, self.CL, self.gamma, self.info))

    def __len__(self) -> int:
        return 4

    def __getitem__(self, i: int) -> Any:
        """K, CL, gamma, info by their number."""
        return tuple(self)[i]

    def __repr__(self) -> str:
        K, margins = self.controller, self.margins
        return printable(
            f"H2Design(order {K.n} controller, {K.nu} measurements, {K.ny} controls, {timebase_told(K.dt)}\n"
            f"         H2 norm {self.gamma:.7g}, measured (least {self.optimum:.7g} by the Riccati solutions)\n"
            f"         H-infinity norm {self.design.gamma:.7g}, verified"
            + (f"\n         margins: {words(margins)}" if margins else "")
            + "".join(f"\n         warning: {text}" for text in self.warnings)
            + ")"
        )


@one_thread
@numerical
def h2syn(
    P: Any,
    nmeas: int | None = None,
    ncon: int | None = None,
    *,
    strictly_proper: bool = False,
    ncont: int | None = None,
) -> H2Design:
    """Controller K that minimises the H2 norm of P closed by u = K y (positive feedback).

    Parameters
    ----------
    P : GeneralizedPlant, or a system in any form that `system` takes, whose last inputs are u and last outputs y;
        discrete or continuous; z and w may have any number of signals, D22 any value. In discrete time D11 may too and
        D12, D21 may lose rank or be zero; in continuous time D12 has full column and D21 full row rank, and D11 is
        zero or cancelled by the direct term of the controller
    nmeas, ncon : number of outputs y and inputs u; needed unless P is a GeneralizedPlant; `ncont` is MATLAB's name
    strictly_proper : whether u may not depend on the present measurement, which in discrete time costs some and leaves
        the processor a period; a continuous controller is strictly proper by itself where D11 is zero

    Returns
    -------
    H2Design : unpacks as K, CL, gamma, info. `gamma` is the H2 norm measured on the closed loop, `optimum` the least
        one as the Riccati solutions claim it, `design` what `export`, `accept` and files take.

    Raises
    ------
    ModelError : data that is no model: NaN, wrong shapes, an unspecified timebase.
    AssumptionError : (A, B2) is not stabilisable or (A, C2) not detectable; D12 or D21 loses rank or D11 cannot be
        cancelled in continuous time; a control acts on no z or a measurement has no noise; a zero from u to z or from
        w to y is on the stability boundary. In all but the first there is no best controller, or more than one.
    NumericalError : a Riccati equation was not solved, or the controller and D22 form a loop without a solution.
    VerificationError : the closed loop is not stable, or its measured norm is not the one that was claimed.

    References
    ----------
    Doyle, Glover, Khargonekar and Francis (1989), IEEE TAC 34, 831; Chen and Francis (1995), Optimal Sampled-Data
    Control Systems, chapter 6. MATLAB h2syn (the convention).

    Examples
    --------
    >>> from synth import GeneralizedPlant, h2syn
    >>> integrator = GeneralizedPlant(0, [1, 0], 1, [[1], [0]], [[0, 0], [0, 0]], [[0], [1]], 1, [0, 1], 0)
    >>> round(h2syn(integrator).gamma**2, 6)  # X = Y = 1: 1 + 1
    2.0
    """
    started = time.perf_counter()
    for name, count in (("nmeas", nmeas), ("ncon", ncon), ("ncont", ncont)):
        if count is not None:
            as_whole(name, count, "the number of signals, at least 1", least=1)
    if None not in (ncon, ncont) and ncon != ncont:
        raise ModelError(f"ncon = {ncon} and ncont = {ncont} are two names of one number; pass one of them")
    plant = as_plant(P, nmeas, ncont if ncon is None else ncon)
    strictly_proper = as_flag("strictly_proper", strictly_proper)
    check_assumptions(plant)
    scaled = balanced(plant)
    found = h2_controller(scaled.plant, strictly_proper=strictly_proper)
    T, Ti = scaled.T, np.linalg.inv(scaled.T)
    K = scaled.restore(found.controller)
    K = StateSpace(T @ K.A @ Ti, T @ K.B, K.C @ Ti, K.D, K.dt)  # its states estimate those of the plant
    closed_loop, measured = judge(plant, K)
    closed_loop = without_rounding(plant, closed_loop)
    gamma, optimum = h2norm(closed_loop), scaled.scale * float(np.sqrt(max(found.squared, 0.0)))
    told = tuple(_contradiction(gamma, optimum, NOTHING * _terms(plant, closed_loop)))
    slowest, why = slowest_pole(plant, measured.poles)
    versions, date = provenance()
    info = Info(
        method="h2",
        status="; ".join(("optimum in closed form, of the H2 norm", *told)),
        level=measured.norm,
        optimum=None,
        spectral_radius=measured.spectral_radius,
        slowest=slowest,
        frequency=measured.frequency,
        seconds=time.perf_counter() - started,
        solver="Riccati equations",
        tolerance=AGREE,
        warnings=(*told, *why),
        failures={},
        versions=versions,
        date=date,
    )
    z, w = 1 / (scaled.scale * scaled.w), scaled.w
    X, Y = Ti.T @ found.X @ Ti / z**2, T @ found.Y @ T.T / w**2
    return H2Design(Design(plant, K, closed_loop, measured.norm, info), gamma, optimum, X, Y, found.residual)


def _contradiction(gamma: float, optimum: float, nothing: float) -> Iterator[str]:
    """What to tell where the measured norm is not the claimed one.

    Raises
    ------
    VerificationError : it is another by far.
    """
    apart = abs(gamma - optimum)
    if apart <= AGREE * optimum or max(gamma, optimum) <= nothing:
        return
    text = f"the Riccati solutions claim a least H2 norm of {optimum:.7g}, the loop was measured to have {gamma:.7g}"
    if not apart <= WRONG * optimum + nothing:
        raise VerificationError(
            f"{text}: the problem is too ill-conditioned; weigh more of z, or let w drive more, or choose other units"
        )
    yield text


def _terms(plant: GeneralizedPlant, closed_loop: StateSpace) -> float:
    """H2 norm of the terms of z = C x + D w, before they cancel."""
    size = np.diag(np.linalg.norm(closed_loop.C, axis=0))
    apart = StateSpace(closed_loop.A, closed_loop.B, size, np.zeros((closed_loop.n, closed_loop.nu)), closed_loop.dt)
    states = h2norm(apart) if closed_loop.n else 0.0
    return float(np.hypot(states, np.linalg.norm(plant.D11)))


def without_rounding(plant: GeneralizedPlant, closed_loop: StateSpace) -> StateSpace:
    """A continuous loop without the direct term that rounding leaves where that of K cancels D11.

    What is left away is at most a part `CANCELLED` of D11, and would make the H2 norm infinite.
    """
    left = np.linalg.norm(closed_loop.D, 2)
    if closed_loop.dt or not left or left > CANCELLED * np.linalg.norm(plant.D11, 2):
        return closed_loop
    return StateSpace(closed_loop.A, closed_loop.B, closed_loop.C, np.zeros_like(closed_loop.D), 0.0)
