"""`rounding`: how far a controller as it leaves, in double or single precision, can be from exact arithmetic.

The theorem, and what is proved in balls, is in `synth.proof.rounding`; here its matrices come from a controller, and
the result says in words what was assumed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from synth.checks import as_array, as_choice, shown
from synth.equations.are import dare
from synth.errors import ModelError, NumericalError
from synth.proof.matrices import exact
from synth.proof.peakgain import is_proved_stable
from synth.proof.rounding import FLOATING, Bound, Fixed, Floating, Law, bounded, reached
from synth.regulators.fixed import FORMATS, FixedController
from synth.regulators.sequential import SequentialController, controller_of
from synth.synthesis.design import Design
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace, as_system, common_timebase
from synth.threads import one_thread

PRECISIONS = {"double": "double", "float32": "float"}  # what is asked for -> C's name of the type
HELD = "inputs beyond are held there"
SMALL = 1e-12  # part of the excitation given to states that no input moves, when an observer is looked for
ROOM = 1e-3  # of the signals' peaks, that is left to what rounding adds
TRIES = 5  # at making this room larger
NONE = 1e-250  # peaks below it are what their proof adds to zero
SLOW = 0.999  # largest pole, from which a bound of the states that leaves u aside is not worth its time
UNASKED = 20  # states, up to which a bound is proved though none was asked for
DIGITS = 3  # of a bound in words, rounded up


@dataclass(frozen=True, eq=False)
class Rounding(Bound):
    """A proved bound on what rounding does over any time, and what was assumed for it."""

    precision: str  # "double", "float32", "q15" or "q31"
    inputs: np.ndarray  # (p,) bound of |y| that was assumed
    assumptions: tuple[str, ...]

    def __str__(self) -> str:
        bound, where = listed(self.command), "" if self.output is None else " in the loop"
        return (
            f"{self.precision} against exact arithmetic{where}: |u - exact u| <= {bound}; {'; '.join(self.assumptions)}"
        )


@one_thread
def rounding(
    controller: Any,
    *,
    inputs: Any,
    precision: str = "float32",
    plant: Any = None,
    commands: Any = None,
    umin: Any = None,
    umax: Any = None,
    antiwindup: Any = None,
) -> Rounding:
    """Prove a bound on the difference of the exported controller from the designed one in exact arithmetic.

    It holds from reset, for any number of samples, for the sums of the exported C in their order, its rounded
    coefficients and the conversion of the inputs, as long as every assumption of the result is met.

    Parameters
    ----------
    controller : discrete Design, StateSpace, `LinearController` or `AntiWindup`, as `export` takes it
    inputs : number or (p,) bound of |y_j| in every sample, unit of y
    precision : "float32", "double", or words of fixed point: "q15" (16 bits) or "q31" (32 bits)
    plant : from u to y, u = K y (positive feedback), a state-space system or GeneralizedPlant: then both controllers
        are compared in the loop that each closes with it, under the same references and disturbances; None for the
        controller alone, which then must be stable, under the same inputs
    commands : number or (m,) bound of |u_i|; None for the larger limit. Only a controller that is not stable needs it;
        in a loop the bound of one with slow states becomes smaller by it
    umin, umax, antiwindup : as `export` takes them

    Returns
    -------
    Rounding : `command` (m,), the bound in units of u, with its parts `coefficients` and `arithmetic`; `state` (n,);
        `output` (p,) in a loop; sizes `states` (n,) and `commands` (m,) that the exported one does not exceed

    Raises
    ------
    ModelError : bounds are missing or not positive, or the plant does not fit.
    ExportError : the controller is continuous, or its numbers do not fit into the precision.
    NumericalError : the controller or the loop is not proved stable, or the errors are as large as the signals.

    Reference: see `synth.proof.rounding`.
    """
    as_choice("precision", precision, (*PRECISIONS, *FORMATS))
    K = controller_of(controller)
    G = None if plant is None else _plant(plant, K)
    if precision in FORMATS:
        if not (commands is None and antiwindup is None):
            raise ModelError("commands or antiwindup is given; fixed point is of stable controllers: leave it away")
        Y = bounds("inputs", inputs, K.nu)
        return of_fixed(FixedController.of(controller, precision, Y, umin=umin, umax=umax), Y, K, G)
    limits = {"umin": umin, "umax": umax, "antiwindup": antiwindup}
    exported = SequentialController.of(controller, dtype=PRECISIONS[precision], allow_unstable=True, **limits)
    return _proved(exported, K, bounds("inputs", inputs, K.nu), commands, G)


def of_fixed(
    controller: FixedController, inputs: np.ndarray, K: StateSpace | None = None, plant: Law | None = None
) -> Rounding:
    """The bound that came with the scaling of a controller in fixed point; with its K and a plant that in the loop."""
    found = controller.bound
    if K is not None and plant is not None:
        steps = np.ldexp(1.0, -np.concatenate([controller.states, controller.commands]))
        arithmetic = Fixed(steps, np.ldexp(1.0, -controller.read))
        found = bounded(Law(*controller.system.matrices), Law(*K.matrices), arithmetic, inputs, plant=plant)
    v = found.commands + found.command
    limits = np.ldexp(np.minimum(-controller.umin, controller.umax).astype(float), -controller.commands)
    within = "from reset until a command reaches its limit" if (v >= limits).any() else "from reset, over any time"
    assumed = (f"|y| <= {listed(inputs)}, {HELD}", within)
    return Rounding(**vars(found), precision=controller.format, inputs=inputs, assumptions=assumed)


def told(source: Any, exported: SequentialController, inputs: Any) -> str:
    """The bound of what is exported, in words, or why there is none.

    It is that of the controller alone if it is stable, else of the loop with the plant of its design.

    Parameters
    ----------
    inputs : as in `rounding`; None for 1, for controllers of up to `UNASKED` states, whose proof takes seconds

    Raises
    ------
    ModelError : the inputs are no positive numbers.
    """
    K = controller_of(source)
    Y = bounds("inputs", 1.0 if inputs is None else inputs, K.nu)
    if inputs is None and K.n > UNASKED:
        return f"not bounded unasked: the controller has more than {UNASKED} states; pass inputs, bounds of |y|"
    own = isinstance(source, Design) and source.shaping is None and not is_proved_stable(exact(exported.system.A))
    try:
        return str(_proved(exported, K, Y, None, _plant(source, K) if own else None))
    except (ModelError, NumericalError) as error:
        return f"not bounded: {error}"


def in_loop(
    P: GeneralizedPlant, K: StateSpace, precision: str, inputs: Any = None, commands: Any = None
) -> tuple[Rounding, np.ndarray]:
    """The bound in the loop that K closes with a generalised plant, and the peaks (m,) of the commands beside it.

    Parameters
    ----------
    inputs : (p,) bound of |y|, and the peaks are those of such inputs; None for all |w| <= 1 from rest: y and u are
        then bounded by their peaks in the exact loop and by what rounding, so bounded, adds, by induction
    commands : (m,) bound of |u| beside `inputs`, for a controller that is not stable

    Raises
    ------
    ModelError, ExportError, NumericalError : as `rounding`.
    """
    if inputs is not None:
        commands = None if precision in FORMATS else commands
        found = rounding(K, inputs=inputs, precision=precision, plant=P, commands=commands)
        return found, found.commands
    Y, U = loop_peaks(P, K)
    room_y, room_u = Y * ROOM, U * ROOM
    for _ in range(TRIES):
        commands = None if precision in FORMATS else U + room_u
        found = rounding(K, inputs=Y + room_y, precision=precision, plant=P, commands=commands)
        assert found.output is not None
        if (found.output <= room_y).all() and (found.command <= room_u).all():
            return found, U
        room_y, room_u = np.maximum(room_y, 2 * found.output), np.maximum(room_u, 2 * found.command)
    raise NumericalError("rounding errors grow with the signals that they make: no bound")


def loop_peaks(P: GeneralizedPlant, K: StateSpace) -> tuple[np.ndarray, np.ndarray]:
    """Proved bounds of |y| (p,) and |u| (m,) in the loop while |w| <= 1; of a signal that w does not move, any bound.

    Raises
    ------
    NumericalError : the loop is not proved stable.
    """
    found = reached(Law(*K.matrices), _plant(P, K), P.B1, P.D21)
    Y, U = (
        np.where(moved, size, size.max(initial=0.0, where=moved) or 1.0) for size in found for moved in [size > NONE]
    )
    return Y, U


def _proved(exported: SequentialController, K: StateSpace, Y: np.ndarray, commands: Any, plant: Law | None) -> Rounding:
    """The bound, and what it was proved for."""
    new, old = Law(*exported.system.matrices), Law(*K.matrices)
    precision = next(key for key, name in PRECISIONS.items() if name == exported.dtype)
    assumed, numbers = [f"|y| <= {listed(Y)}"], FLOATING[precision]
    stable = is_proved_stable(exact(new.A)) and is_proved_stable(exact(old.A))
    if not stable and plant is None:
        raise ModelError(
            "the controller is not proved stable by itself: errors of its states grow unless a loop holds them; "
            "pass plant, from u to y"
        )
    found = seen = U = None
    if not stable or (K.n and commands is not None and plant is not None):
        U = _commands(commands, exported)
        seen = found = _observed(new, old, numbers, Y, U, plant, needed=not stable)
    slow = bool(np.abs(np.linalg.eigvals(new.A)).max(initial=0.0) > SLOW)
    if stable and (seen is None or not slow):
        plain = bounded(new, old, numbers, Y, plant=plant)
        better = seen is None or U is None or (plain.command / U).sum() < (seen.command / U).sum()
        found, U = (plain, None) if better else (seen, U)
    assert found is not None
    assumed += [] if U is None else [f"|u| <= {listed(U)}"]
    limits = np.minimum(-exported.umin.astype(float), exported.umax.astype(float))
    beyond = (found.commands + found.command >= limits).any()
    within = "; no command reaches its limit" if exported.limited else ""
    assumed.append("from reset until a command reaches its limit" if beyond else f"from reset, over any time{within}")
    return Rounding(**vars(found), precision=precision, inputs=Y, assumptions=tuple(assumed))


def _observed(
    new: Law, old: Law, numbers: Floating, Y: np.ndarray, U: np.ndarray, plant: Law | None, *, needed: bool
) -> Bound | None:
    """The bound whose sizes come from an observer of the states, which u shows; None where none was found or needed."""
    try:
        return bounded(new, old, numbers, Y, commands=U, observer=_observer(old, Y, U), plant=plant)
    except (ModelError, NumericalError):
        if needed:
            raise
        return None


def bounds(name: str, value: Any, size: int) -> np.ndarray:
    """Positive numbers (size,)."""
    given = as_array(name, value, f"pass a positive number, or {size} of them")
    if given.shape not in ((), (size,)) or not (given > 0).all():
        raise ModelError(f"{name} is {shown(value)}; pass a positive number, or {size} of them, one for each signal")
    return np.broadcast_to(given, (size,)).copy()


def _commands(commands: Any, made: SequentialController) -> np.ndarray:
    """The bound of |u|: given, or the limits."""
    if commands is not None:
        return bounds("commands", commands, len(made.D))
    limits = np.maximum(np.abs(made.umin), np.abs(made.umax)).astype(float)
    if not np.isfinite(limits).all():
        raise ModelError(
            "the controller is not stable by itself, so that bounds of y alone do not bound its states; pass commands, "
            "a bound of |u|, or umin and umax"
        )
    return limits


def _observer(law: Law, Y: np.ndarray, U: np.ndarray) -> np.ndarray:
    """The gain of a Kalman filter that sees u, when y is noise of the size Y and u has noise of the size U."""
    Q = (law.B * Y) @ (law.B * Y).T
    Q += np.eye(len(Q)) * max(float(np.trace(Q)), 1.0) * SMALL
    U = np.where(U > 0, U, max(float(U.max()), SMALL))
    X, ok = dare(law.A.T, law.C.T, Q, np.diag(U**2))
    if not ok:
        raise ModelError("the controller has a state that is not stable and that u does not show; remove it")
    seen = X @ law.C.T
    return law.A @ np.linalg.solve(law.C @ seen + np.diag(U**2), seen.T).T


def _plant(plant: Any, K: StateSpace) -> Law:
    """From u to y."""
    if isinstance(plant, Design):
        plant = plant.plant
    if isinstance(plant, GeneralizedPlant):
        plant = StateSpace(plant.A, plant.B2, plant.C2, plant.D22, plant.dt)
    G = as_system("plant", plant, K.dt)
    common_timebase(G, K)
    if (G.nu, G.ny) != (K.ny, K.nu):
        raise ModelError(f"plant has {G.nu} inputs and {G.ny} outputs; the controller needs {K.ny} and {K.nu}")
    return Law(*G.matrices)


def listed(values: np.ndarray) -> str:
    """Bounds in words, rounded up: one number where all are the same."""
    texts = [_up(float(value)) for value in values]
    return texts[0] if len(set(texts)) == 1 else f"({', '.join(texts)})"


def _up(value: float) -> str:
    """The number with a few digits, not below it."""
    text = f"{value:.{DIGITS}g}"
    if float(text) >= value:
        return text
    step = 10.0 ** (np.floor(np.log10(value)) - DIGITS + 1)
    return f"{float(text) + step:.{DIGITS}g}"
