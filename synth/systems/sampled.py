"""From continuous to discrete time and back: `c2d`, and the Cayley map that keeps norms.

Every function of the package that works in discrete time takes continuous systems there by this map, s =
rate (z - 1)/(z + 1). The rate decides the accuracy. A loop whose poles are faster than the rate by orders of magnitude
crowds at z = -1 and is lost; one that is slower keeps its digits over four decades. So the rate is the fastest pole of
a loop, never of a plant, whose poles may be rounding errors of an integrator or belong to a slow weight:

    `loop_rate`    of a plant from u to y: the loop that minimises |y|^2 + |u|^2
    `design_rate`  of a generalised plant: the loop that minimises the H2 norm from w to z
    `pole_rate`    of a stable system, which is a closed loop already: the geometric mean of its poles

They depend on neither coordinates nor units, of the signals or of time. The map balances the states before it solves
with them, and scales back by the same powers of two, so that it does not change coordinates either.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, overload

import numpy as np

from synth.checks import as_array, as_choice, as_number, as_period, numerical, timebase_told
from synth.errors import ModelError
from synth.systems.delays import as_late
from synth.systems.exponential import expm
from synth.systems.generalized import GeneralizedPlant
from synth.systems.holds import HOLDS, bilinear_rate, held, waiting
from synth.systems.matched import matched
from synth.systems.realization import Matrices, rescaled, state_scales
from synth.systems.statespace import StateSpace, as_system
from synth.systems.uncertain import UncertainSystem
from synth.systems.uncertainsampling import sampled_uncertain

ILL_CONDITIONED = 1e14  # of rate I - A, balanced: the rate is a pole to rounding
APART = 0.25  # relative distance of a rate from every pole
SLOW = 1e-6  # relative: moduli below it may be rounding errors of zero
MOVED = 1e-2  # relative distance from every pole of the plant from which on a pole belongs to the loop
INDEPENDENT = 1e-2  # smallest singular value of D12, its columns of length one, with which every control is weighed


@overload
def c2d(G: UncertainSystem, dt: float, method: str = "zoh", *, tol: float = 1e-9) -> UncertainSystem: ...
@overload
def c2d(
    G: GeneralizedPlant,
    dt: float,
    method: str = ...,
    *,
    prewarp: Any = ...,
    delay: Any = ...,
    output_delay: Any = ...,
    tol: float = ...,
) -> GeneralizedPlant: ...
@overload
def c2d(
    G: Any,
    dt: float,
    method: str = "zoh",
    *,
    prewarp: float | None = None,
    delay: Any = 0.0,
    output_delay: Any = 0.0,
    tol: float = 1e-9,
) -> StateSpace: ...
@numerical
def c2d(
    G: Any,
    dt: float,
    method: str = "zoh",
    *,
    prewarp: float | None = None,
    delay: Any = 0.0,
    output_delay: Any = 0.0,
    tol: float = 1e-9,
) -> Any:
    """Continuous to discrete, with delays of any length.

    Three methods are exact for an input that is known between the samples: `"zoh"` held, `"foh"` straight from sample
    to sample (D included; the state is x less the effect of the present input), `"impulse"` a train of impulses of area
    dt u_k, so that the impulse responses agree at the samples, g(0+) = C B at the first. `"tustin"` is the bilinear
    map, `"midpoint"` a hold by that rule. `"matched"` takes poles and zeros through e^(s dt), as one of one input
    and one output: of the zeros at infinity one stays there, the others go to -1, and the gain at s = 0 is kept, or
    what it is divided by powers of s where poles or zeros are there.

    Parameters
    ----------
    G : continuous system, in any form that `system` takes; a GeneralizedPlant stays one, `continuous` is then what
        "zoh" made it of, without delay or with one that all u have, and no w; or an uncertain one, whose `"tustin"`
        and `"midpoint"` are exact in the parameters; so is its hold equivalent where the exponential series ends, as of
        rigid bodies, and where parameters are in B, C and D alone. Others become polynomials with `remainders`: each
        entry is off by a proved amount at most on the whole box, which every connection keeps and every proof takes in
    dt : sampling time in seconds, positive
    method : one of these six; of uncertain systems "zoh", "tustin" or "midpoint". The last is E (x+ - x) =
        dt (A (x+ + x)/2 + B u) with u held: the hold equivalent itself of double integrators, such as the axes of a
        body at rest, off it by (A dt)^3/12 to third order of others: what is proved of it is proved of that model
    prewarp : rad/s, below pi/dt: where `"tustin"` keeps the frequency response; at rest when left out
    delay : s, () or (m,), by which the inputs act later; any with the exact methods, whole periods with the others. The
        states of whole samples come before those of G
    output_delay : s, () or (p,), by which the outputs come later, likewise; their states come last
    tol : of an uncertain hold equivalent that is no polynomial, how far the polynomial may be off, relative to dt in
        coordinates that balance the plant

    Raises
    ------
    ModelError : G is no system or is discrete already, dt is not positive, the rate of the map (2/dt) is a pole,
        algebraic states where the midpoint rule or the hold of an uncertain system has none, or a box too wide
        (sampling too slow) for polynomials within `tol`; "impulse" with D, "matched" with
        several inputs or outputs, a delay that is negative or beyond 5000 samples.

    References: Franklin, Powell and Workman (1998), Digital Control of Dynamic Systems, chapters 4 and 6.
    """
    if isinstance(G, GeneralizedPlant):
        return _generalised(G, dt, method, prewarp=prewarp, delay=delay, output_delay=output_delay, tol=tol)
    G = G if isinstance(G, UncertainSystem) else as_system("G", G)
    if G.discrete:
        raise ModelError(f"the system G is already discrete ({timebase_told(G.dt)}); c2d takes a continuous one")
    dt = as_period(dt)
    tol = as_number("tol", tol, "a relative error from 1e-12 to 0.01", least=1e-12)
    if tol > 0.01:
        raise ModelError(f"tol is {tol:g}; pass a relative error from 1e-12 to 0.01")
    if isinstance(G, UncertainSystem):
        if prewarp is not None or np.any(as_array("delay", delay)) or np.any(as_array("output_delay", output_delay)):
            raise ModelError("prewarp, delay and output_delay are of certain systems; sample G.at(values) with them")
        as_choice("method", method, ("zoh", "tustin", "midpoint"))
        return sampled_uncertain(G, dt, method, tol)
    as_choice("method", method, (*HOLDS, "tustin", "midpoint", "matched"))
    rate = bilinear_rate(method, dt, prewarp)
    late = as_late("delay", delay, G.nu, dt), as_late("output_delay", output_delay, G.ny, dt)
    if method in HOLDS and (method != "zoh" or any(line.any() for each in late for line in each)):
        return held(G, dt, method, *late)
    return waiting(matched(G, dt) if method == "matched" else _mapped(G, dt, method, rate), method, *late)


def _generalised(P: GeneralizedPlant, dt: float, method: str, **options: Any) -> GeneralizedPlant:
    """A plant with all its inputs and outputs."""
    _, nw, m, _, p = P.sizes
    found = GeneralizedPlant.partition(c2d(StateSpace(*P.system.matrices, P.dt), dt, method, **options), p, m)
    late = np.broadcast_to(options["delay"], nw + m)
    as_one = not (late[:nw].any() or np.any(options["output_delay"]) or np.ptp(late[nw:]))
    named = replace(found, w=P.w, u=P.u, z=P.z, y=P.y, units=P.units)
    return replace(named, continuous=P, delay=float(late[-1])) if method == "zoh" and as_one else named


def _mapped(G: StateSpace, dt: float, method: str, rate: float) -> StateSpace:
    """By one exponential, or by the Cayley map at `rate`."""
    if G.n == 0:
        return replace(G, dt=dt)
    if method == "zoh":
        M = expm(dt * np.block([[G.A, G.B], [np.zeros((G.nu, G.n + G.nu))]]))
        return replace(G, A=M[: G.n, : G.n], B=M[: G.n, G.n :], dt=dt, continuous=G)
    try:
        mapped = cayley(G, rate, dt)
        if method == "midpoint":  # the input and the output of the samples, not their means
            return replace(G, A=mapped.A, B=np.linalg.solve(np.eye(G.n) - dt / 2 * G.A, dt * G.B), dt=dt)
        return replace(mapped, u=G.u, y=G.y, units=G.units)
    except ModelError:
        raise ModelError(
            f"dt is {dt:g} s and {'2/dt' if rate == 2 / dt else 'the rate'} = {rate:g} rad/s is a pole of the system, "
            "which this method sends to infinity; pass another dt, or method='zoh'"
        ) from None


def cayley(G: StateSpace, rate: float, dt: float = 1.0) -> StateSpace:
    """Norm-preserving map of a continuous system to a discrete one, s = rate (z - 1)/(z + 1).

    Stability, H-infinity norm and stabilisability carry over exactly; `inverse_cayley` is the way back.

    Raises
    ------
    ModelError : `rate` (rad/s) is an eigenvalue of A.
    """
    scales = state_scales(G.matrices)
    A, B, C, D = rescaled(G.matrices, scales)
    I = np.eye(G.n)
    E = rate * I - A
    if G.n and not np.linalg.cond(E) < ILL_CONDITIONED:
        raise ModelError(f"{rate} rad/s is an eigenvalue of A: choose another rate for the Cayley map")
    mapped = Matrices(
        np.linalg.solve(E, rate * I + A),
        np.sqrt(2 * rate) * np.linalg.solve(E, B),
        np.sqrt(2 * rate) * np.linalg.solve(E.T, C.T).T,
        D + C @ np.linalg.solve(E, B),
    )
    return StateSpace(*rescaled(mapped, 1 / scales), dt)


def inverse_cayley(G: StateSpace, rate: float) -> StateSpace:
    """The way back from `cayley`: z = (rate + s)/(rate - s).

    Raises
    ------
    ModelError : -1 is an eigenvalue of A, that is, the continuous system would be improper.
    """
    scales = state_scales(G.matrices)
    A, B, C, D = rescaled(G.matrices, scales)
    I = np.eye(G.n)
    E = A + I
    if G.n and not np.linalg.cond(E) < ILL_CONDITIONED:
        raise ModelError("-1 is an eigenvalue of A: the continuous system would not be proper")
    mapped = Matrices(
        rate * np.linalg.solve(E, A - I),
        np.sqrt(2 * rate) * np.linalg.solve(E, B),
        np.sqrt(2 * rate) * np.linalg.solve(E.T, C.T).T,
        D - C @ np.linalg.solve(E, B),
    )
    return StateSpace(*rescaled(mapped, 1 / scales), 0.0)


def on_circle(rate: float, *systems: StateSpace) -> list[StateSpace]:
    """Discrete systems as they are, continuous ones by one Cayley map at exactly `rate` rad/s."""
    return [G if G.discrete else cayley(G, rate) for G in systems]


def apart(rate: float, poles: np.ndarray) -> float:
    """The rate, or the next larger one that keeps its distance from every pole."""
    while poles.size and np.abs(poles - rate).min() < APART * rate:
        rate *= 1 + 2 * APART
    return rate


def pole_rate(poles: np.ndarray) -> float:
    """A rate in rad/s for a closed loop: the geometric mean of the moduli of its poles."""
    moduli = np.abs(poles)
    moduli = moduli[moduli > SLOW * moduli.max(initial=0.0)]
    return apart(float(np.exp(np.log(moduli).mean())) if moduli.size else 1.0, poles)


def loop_rate(*systems: StateSpace) -> float:
    """A rate in rad/s for plants from u to y: the fastest pole of their LQG loops, equal weights on u and y."""
    fastest = max((loop_moduli(G).max(initial=0.0) for G in systems), default=0.0)
    return apart(float(fastest) or 1.0, np.concatenate([G.poles() for G in systems]))


def design_rate(P: GeneralizedPlant) -> float:
    """A rate in rad/s for a generalised plant: the fastest pole of the loop with the least H2 norm from w to z.

    Poles of the plant that this loop leaves where they are do not count. Where z does not weigh a control, or a
    measurement has no noise, the loop would be infinitely fast: as much is added as the signal does at the rate that
    the others, or the plant's poles, have.
    """
    _, nw, _, nz, _ = P.sizes
    A, B, C, D = rescaled(P.system.matrices, state_scales(P.system.matrices))
    control = A, B[:, nw:], C[:nz], D[:nz, nw:]
    estimation = A.T, C[nz:].T, B[:, :nw].T, D[nz:, :nw].T
    regular = [_moved(*side, 0.0) for side in (control, estimation) if _weighed(side[-1])]
    rate = max((float(m.max(initial=0.0)) for m in regular), default=0.0) or _typical(A)
    others = [_moved(*side, rate) for side in (control, estimation) if not _weighed(side[-1])]
    return apart(
        max((float(m.max(initial=0.0)) for m in (*regular, *others)), default=0.0) or rate, np.linalg.eigvals(A)
    )


def loop_moduli(G: StateSpace) -> np.ndarray:
    """Moduli of the LQG poles of a continuous system, each twice, (2n,) rad/s: eigenvalues of the Hamiltonian."""
    n, I = G.n, np.eye
    A, B, C, D = rescaled(G.matrices, state_scales(G.matrices))
    return np.abs(_hamiltonian_poles(A, B, np.vstack([C, np.zeros((G.nu, n))]), np.vstack([D, I(G.nu)])))


def _weighed(D: np.ndarray) -> bool:
    """True when every control, and every combination of controls, has a direct effect on z."""
    size = np.linalg.norm(D, axis=0)
    return bool(size.all() and np.linalg.svd(D / size, compute_uv=False)[-1] > INDEPENDENT and D.shape[0] >= D.shape[1])


def _typical(A: np.ndarray) -> float:
    """The geometric mean of the poles, without those that may be zero but for rounding; the size of A when all may."""
    size, moduli = float(np.linalg.norm(A, 2)) if A.size else 0.0, np.abs(np.linalg.eigvals(A))
    moduli = moduli[moduli > SLOW * size]
    return float(np.exp(np.log(moduli).mean())) if moduli.size else size or 1.0


def _moved(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray, rate: float) -> np.ndarray:
    """Moduli of the poles of the loop u = F x of least |C x + D u|^2 that are none of A's own.

    With a rate, each u costs what it does there, and what C and D say besides.
    """
    n = len(A)
    if rate:
        s = rate * np.exp(0.25j * np.pi)  # between the axes, where hardly a pole is
        effect = np.linalg.norm(C @ np.linalg.solve(s * np.eye(n) - A, B) + D, axis=0)
        B, D, effect = B[:, effect > 0], D[:, effect > 0], effect[effect > 0]
        C, D = np.vstack([C, np.zeros((len(effect), n))]), np.vstack([D, np.diag(effect)])
    size = np.linalg.norm(D, axis=0)
    loop, own = _hamiltonian_poles(A, B / size, C, D / size), np.linalg.eigvals(A)
    away = np.abs(loop[:, None] - np.concatenate([own, -own])).min(axis=1) > MOVED * np.abs(loop)
    return np.abs(loop[away])


def _hamiltonian_poles(A: np.ndarray, B: np.ndarray, C: np.ndarray, D: np.ndarray) -> np.ndarray:
    """Eigenvalues of the Hamiltonian of |C x + D u|^2, (2n,); D has full column rank."""
    R, S = D.T @ D, C.T @ D
    W = np.linalg.solve(R, np.hstack([B.T, S.T]))
    n = len(A)
    G, F = B @ W[:, :n], W[:, n:]
    return np.linalg.eigvals(np.block([[A - B @ F, -G], [S @ F - C.T @ C, -(A - B @ F).T]]))


def moebius(G: StateSpace, c: float) -> StateSpace:
    """Norm-preserving map of a discrete system to another, z = (z' - c)/(1 - c z') with |c| < 1; -c is the way back.

    It is the same as to continuous time and back at another rate.

    Raises
    ------
    ModelError : -1/c is an eigenvalue of A.
    """
    scales = state_scales(G.matrices)
    A, B, C, D = rescaled(G.matrices, scales)
    I = np.eye(G.n)
    E, root = I + c * A, np.sqrt(1 - c**2)
    if G.n and not np.linalg.cond(E) < ILL_CONDITIONED:
        raise ModelError(f"{-1 / c} is an eigenvalue of A: choose another c for the map of the unit disk")
    mapped = Matrices(
        np.linalg.solve(E, A + c * I),
        root * np.linalg.solve(E, B),
        root * np.linalg.solve(E.T, C.T).T,
        D - c * C @ np.linalg.solve(E, B),
    )
    return StateSpace(*rescaled(mapped, 1 / scales), G.dt)


def discretised(
    plant: GeneralizedPlant, rate: float | None = None
) -> tuple[GeneralizedPlant, Callable[[StateSpace], StateSpace]]:
    """A discrete plant with the same norms, and the way back for its controllers.

    Without a rate a continuous plant is mapped at its `design_rate`, and a discrete one stays as it is.

    Raises
    ------
    ModelError : the rate is a pole of the plant.
    """
    _, _, nu, _, ny = plant.sizes
    if plant.dt == 0:
        r = design_rate(plant) if rate is None else rate
        return GeneralizedPlant.partition(cayley(plant.system, r), ny, nu), lambda K: inverse_cayley(K, r)
    if rate is None:
        return plant, lambda K: K
    c = (rate - 2 / plant.dt) / (rate + 2 / plant.dt)
    return GeneralizedPlant.partition(moebius(plant.system, c), ny, nu), lambda K: moebius(K, -c)
