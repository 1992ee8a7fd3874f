"""Mixed-sensitivity H-infinity design: `augw` weighs a plant, `mixsyn` finds its controller.

    e = r - G u,  u = K e,       z = [W1 e; W2 u; W3 G u] = [W1 S; W2 K S; W3 T] r
    S = (I + G K)^-1,  T = G K S = I - S

The measurement is the error e, so K is used as it is with e = r - y (`LinearController`), and u = K e is the positive
convention of `lft`. Signs and order of the channels are those of MATLAB and python-control.

Poles of G on the stability boundary: r reaches the measurement through P21 = I alone, so that P21 loses rank there,
and a design can only cancel such poles. With `shift` = e the design is made for G(s - e), whose poles lie to the
right, and K(s + e) is used on G: the poles of that loop are left of -e. In discrete time A and B are multiplied by
exp(e dt), which is the same shift of every pole's logarithm.

Reference: Skogestad and Postlethwaite (2005), Multivariable Feedback Control, 2nd edition, sections 2.8 and 3.5.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from synth.analysis.norms import balance, is_stable, judge
from synth.checks import as_number, numerical
from synth.errors import AssumptionError, ModelError, VerificationError
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import TOLERANCE, hinfsyn, slowest_pole
from synth.systems.connect import feedback
from synth.systems.generalized import GeneralizedPlant, remembering
from synth.systems.statespace import StateSpace, as_system, common_timebase, repeated
from synth.systems.timebase import retimed

NEAR = 1e-3  # relative to |A|, of a pole that may be on the boundary: rounding moves a triple one by 1e-5 |A|
BOUNDARY = 1e-12  # relative to |A|, of the change of A that puts it there
ROUNDING = 1e-6  # relative to the shift, on the poles' distance to the boundary


def augw(G: Any, W1: Any = None, W2: Any = None, W3: Any = None) -> GeneralizedPlant:
    """The weighted plant of mixed sensitivity, z = [W1 S; W2 K S; W3 T] r under u = K e, e = r - G u.

    Parameters
    ----------
    G : (q x m) plant, in any form that `system` takes
    W1 : weight of the error e, (any x q); W2 : of the control u, (any x m); W3 : of the output G u, (any x q). Each a
        system in any of these forms; a number or a system with one input and one output weighs every channel, None
        stands for no such rows in z; at least one is needed

    Raises
    ------
    ModelError : shapes or timebases do not fit, no weight was given, or a weight is not stable.
    """
    G = as_system("G", G)
    q, m = G.ny, G.nu
    O = np.zeros
    wanted = (("W1", W1, q), ("W2", W2, m), ("W3", W3, q))
    weights = [_weight(name, W, size, G) for name, W, size in wanted]
    for W in weights:
        G = retimed(G, common_timebase(G, W))
    if all(W.ny == 0 for W in weights):
        raise ModelError("W1, W2 and W3 are all None; pass at least one weight, or z would be empty")
    V1, V2, V3 = weights
    n1, n2, n3 = V1.n, V2.n, V3.n
    plant = GeneralizedPlant(
        A=np.block([
            [G.A, O((G.n, n1 + n2 + n3))],
            [-V1.B @ G.C, V1.A, O((n1, n2 + n3))],
            [O((n2, G.n + n1)), V2.A, O((n2, n3))],
            [V3.B @ G.C, O((n3, n1 + n2)), V3.A],
        ]),
        B1=np.vstack([O((G.n, q)), V1.B, O((n2 + n3, q))]),
        B2=np.vstack([G.B, -V1.B @ G.D, V2.B, V3.B @ G.D]),
        C1=np.block([
            [-V1.D @ G.C, V1.C, O((V1.ny, n2 + n3))],
            [O((V2.ny, G.n + n1)), V2.C, O((V2.ny, n3))],
            [V3.D @ G.C, O((V3.ny, n1 + n2)), V3.C],
        ]),
        D11=np.vstack([V1.D, O((V2.ny + V3.ny, q))]),
        D12=np.vstack([-V1.D @ G.D, V2.D, V3.D @ G.D]),
        C2=np.hstack([-G.C, O((q, n1 + n2 + n3))]),
        D21=np.eye(q),
        D22=-G.D,
        dt=G.dt,
        w=tuple(f"reference {s}" for s in G.named_outputs),
        u=G.u,
        z=tuple(
            f"weighted {signal} {i}"
            for signal, W in zip(("error", "control", "output"), weights, strict=True)
            for i in range(W.ny)
        ),
        y=tuple(f"error {s}" for s in G.named_outputs),
        units={s: G.units[s] for s in G.u if s in G.units},
    )  # fmt: skip
    return remembering(plant, G, lambda H: augw(H, W1, W2, W3))


@numerical
def mixsyn(
    G: Any,
    W1: Any = None,
    W2: Any = None,
    W3: Any = None,
    *,
    shift: float = 0.0,
    method: str = "auto",
    gamma: float | None = None,
    tol: float = TOLERANCE,
) -> Design:
    """Controller u = K (r - y) that minimises the H-infinity norm of [W1 S; W2 K S; W3 T].

    Parameters
    ----------
    G, W1, W2, W3 : as in `augw`
    shift : e >= 0 in rad/s; needed where G has poles on the stability boundary. The controller is designed for
        G(s - e) with the weights as given, and moved back.
    method, gamma, tol : as in `hinfsyn`

    Returns
    -------
    Design : unpacks as K, CL, gamma, info; `plant` is `augw` of G itself.

        Without a shift as `hinfsyn` has it. With a shift, `info.optimum` and `info.shifted_norm` are the optimum and
        the verified norm for G(s - e). Guaranteed is then what follows for G itself: the poles of the loop of G and K
        lie left of -e (measured: to rounding), and
        [W1(s + e) S; W2(s + e) K S; W3(s + e) T] has at most the norm `info.shifted_norm`. The norm with the weights
        as given, W(s), is `gamma`: measured on the true loop, below or above the optimum.

    Raises
    ------
    ModelError : as `augw`; a shift that is negative or not finite.
    AssumptionError : G has a pole on the stability boundary, where P21 loses rank; the remedy is `shift`.
    VerificationError : the loop of G and the controller moved back is not what it should be.
    InfeasibleError, NumericalError : as `hinfsyn`.
    """
    G = as_system("G", G)
    shift = as_number("shift", shift, "a rate in rad/s of at least 0, small beside the bandwidth", least=0)
    plant = augw(G, W1, W2, W3)
    G = retimed(G, plant.dt)  # that of a weight
    moved = shifted(G, shift)
    check_boundary(moved, shift)
    design = hinfsyn(augw(moved, W1, W2, W3), method=method, gamma=gamma, tol=tol)
    if shift == 0:
        return design
    K = shifted(design.controller, -shift)
    check_shift(feedback(G, K), shift)
    closed_loop, measured = judge(plant, K)
    info = replace(
        design.info,
        spectral_radius=measured.spectral_radius,
        slowest=slowest_pole(plant, measured.poles)[0],
        frequency=measured.frequency,
        shift=float(shift),
        shifted_norm=design.verified_norm,
    )
    return Design(plant, K, closed_loop, measured.norm, info)


def shifted(G: StateSpace, e: float) -> StateSpace:
    """G(s - e): every pole moves right by e rad/s; in discrete time every modulus grows by exp(e dt)."""
    if e == 0:
        return G
    if not G.discrete:
        return StateSpace(G.A + e * np.eye(G.n), G.B, G.C, G.D)
    growth = np.exp(e * G.dt)
    return StateSpace(growth * G.A, growth * G.B, G.C, G.D, G.dt)


def check_boundary(G: StateSpace, shift: float) -> None:
    """Raise AssumptionError for poles of G, after the shift, on the stability boundary.

    A pole is there if a change of A of the size of rounding, the least singular value of s I - A, puts it there.
    """
    A, I = balance(G).A, np.eye(G.n)
    size, poles = np.linalg.norm(A, 2) if G.n else 1.0, np.linalg.eigvals(A)
    nearest = np.exp(1j * np.angle(poles)) if G.discrete else 1j * np.imag(poles)
    near = np.abs(poles - nearest) <= NEAR * (1.0 if G.discrete else size)
    on = [
        p for p, s in zip(poles[near], nearest[near], strict=True)
        if np.linalg.svd(s * I - A, compute_uv=False)[-1] <= BOUNDARY * size
    ]  # fmt: skip
    if not on:
        return
    where = ", ".join(f"{p:.4g}" for p in on)
    advice = "pass another" if shift else "pass"
    raise AssumptionError(
        "P21 of full row rank on the stability boundary",
        f"G{f' moved by shift = {shift:g}' if shift else ''} has poles on the stability boundary ({where}), where "
        "P21, from the reference to the error, loses rank: no best controller exists; "
        f"{advice} shift= in rad/s, small beside the bandwidth wanted, to design for a plant with poles right of it",
        tuple(complex(p) for p in on),
    )


def check_shift(loop: StateSpace, shift: float) -> None:
    """Raise VerificationError unless the poles of a loop lie left of -shift, to rounding."""
    poles = loop.poles()
    rates = np.log(np.maximum(np.abs(poles), 1e-300)) / loop.dt if loop.discrete else np.real(poles)
    if rates.max(initial=-np.inf) > -shift * (1 - ROUNDING):
        raise VerificationError(f"the loop has a pole at a rate of {rates.max():.9g} rad/s, right of -{shift:g}")


def _weight(name: str, W: Any, size: int, G: StateSpace) -> StateSpace:
    """A weight of `size` signals as a stable system with the timebase of G; without outputs for None."""
    if W is None:
        return StateSpace.gain(np.zeros((0, size)), G.dt)
    W = as_system(name, W, G.dt)
    try:
        common_timebase(G, W)
    except ModelError as error:
        raise ModelError(f"{name} does not fit the plant: {error}") from None
    W = repeated(W, size)
    if W.nu != size:
        raise ModelError(f"{name} has {W.nu} inputs for {size} signals; pass one with {size}, or one for every channel")
    if not is_stable(W):
        pole = max(W.poles(), key=abs if W.discrete else np.real)
        raise ModelError(
            f"{name} has a pole at {pole:.6g}, which is not stable; a weight stands outside the loop, where no "
            "controller moves its poles: put a slow stable pole in the place of an integrator"
        )
    return W
