"""The one door: whatever users call a linear system becomes matrices, a timebase and names.

    StateSpace, GeneralizedPlant, any object with A, B, C, D (and dt)          as they are
    control.TransferFunction, scipy.signal and harold objects                   realised (`realization`)
    control's nonlinear systems                                                 linearised at rest
    (A, B, C, D[, dt]),  (num, den[, dt])                                       tuples and lists
    {"A": ..., "dt": ...}, {"num": ..., "den": ...}, {"zeros": ..., "poles": ..., "gain": ...}   as in files
    numbers, vectors, matrices                                                  gains, with their company's timebase

Objects are known by what they have, so that nothing is imported for them. A polynomial is a list of coefficients,
highest power first; a transfer matrix is a list of rows of polynomials, as in python-control; scipy's form, rows of
numerators over one denominator, is one column.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_array, as_matrix, as_number, as_roots, as_timebase, check_unmasked, shown
from synth.errors import ModelError
from synth.systems.realization import of_polynomials, of_roots

FORMS = (
    "pass a StateSpace, a system of python-control or scipy.signal, (A, B, C, D[, dt]), (num, den[, dt]), "
    "a number or a matrix"
)
MATRIX = "pass a real matrix"
KEYS = ("A", "B", "C", "D", "num", "den", "zeros", "poles", "gain", "dt")


class Parts(NamedTuple):
    """A system taken apart; the matrices are not checked yet."""

    A: Any
    B: Any
    C: Any
    D: Any
    dt: float | None  # s; None for a gain that takes the timebase of its company
    u: tuple[str, ...] = ()
    y: tuple[str, ...] = ()
    units: Mapping[str, str] | None = None


def parts(name: str, value: Any) -> Parts:
    """What a system is made of.

    Raises
    ------
    ModelError : it is no linear system, is improper, or its timebase is not known; `name` is how the message calls it.
    """
    try:
        found = _parts(name, value)
        check_unmasked("D", found.D)
    except ModelError as error:
        raise error if name in str(error) else ModelError(f"{name}: {error}") from None
    if 0 in np.shape(found.D):
        raise ModelError(f"{name} is {shown(value)}, without inputs or outputs; {FORMS}")
    return found


def _parts(name: str, value: Any) -> Parts:
    """The same, with messages that may not name the system yet."""
    if isinstance(value, Mapping):
        return _of_mapping(name, value)
    if isinstance(value, tuple | list):
        listed = isinstance(value, tuple) or _is_listed_system(value)
        return _of_sequence(name, value) if listed else _of_another(name, value)
    if all(hasattr(value, key) for key in ("A", "B", "C", "D")):
        return _of_matrices(name, value)
    if all(hasattr(value, key) for key in ("a", "b", "c", "d", "SamplingPeriod")):
        return Parts(value.a, value.b, value.c, value.d, value.SamplingPeriod or 0.0)
    if hasattr(value, "num") and hasattr(value, "den"):
        dt = value.SamplingPeriod or 0.0 if hasattr(value, "SamplingPeriod") else _timebase(value)
        u, y = _names(value)
        return _of_fraction(name, value.num, value.den, dt)._replace(u=u, y=y)
    if all(hasattr(value, key) and not callable(getattr(value, key)) for key in ("zeros", "poles", "gain")):
        return _of_roots(name, value.zeros, value.poles, value.gain, _timebase(value))
    return _of_another(name, value)


def _of_another(name: str, value: Any) -> Parts:
    """A generalised plant, a gain, or something that is refused with the reason."""
    if hasattr(value, "closed_loop") and hasattr(value, "controller"):
        raise ModelError(f"{name} is a Design; pass its .controller, its .closed_loop or its .plant")
    inner = getattr(value, "system", None)
    if inner is not None and all(hasattr(inner, key) for key in ("A", "B", "C", "D")):
        return _of_matrices(name, inner)
    if hasattr(value, "frdata") or hasattr(value, "fresp") or hasattr(value, "frd_data"):
        raise ModelError(
            f"{name} is a measured frequency response, which has no states: fit a model to it first; its margins can "
            "be read from the data with control.stability_margins"
        )
    if hasattr(value, "linearize") and hasattr(value, "nstates"):
        return _at_rest(name, value)
    if isinstance(value, str | bytes) or value is None or callable(value) or isinstance(value, bool | set):
        raise ModelError(f"{name}: {shown(value)} is no state-space system; {FORMS}")
    return Parts([], [], [], as_matrix(name, as_array(name, value, FORMS, "a linear system")), None)


def _is_listed_system(value: list) -> bool:
    """Whether a list is (A, B, C, D[, dt]) or (num, den[, dt]) and no matrix of numbers."""
    if len(value) in (4, 5):
        return np.ndim(value[0]) == 2 if _regular(value[0]) else False
    ragged = len(value) in (2, 3) and _regular(value[0]) and np.ndim(value[0]) == 1 and not _regular(value)
    return ragged


def _regular(value: Any) -> bool:
    try:
        np.ndim(value)
    except Exception:  # ragged lists and foreign objects
        return False
    return True


def _of_sequence(name: str, value: Any) -> Parts:
    """(A, B, C, D[, dt]) or (num, den[, dt])."""
    if len(value) in (4, 5):
        dt = value[4] if len(value) == 5 else 0.0
        if np.size(dt) > 1:
            raise ModelError(
                f"the fifth entry of {name} has {np.size(dt)} numbers and is no sampling time (SLICOT puts condition "
                "numbers there); pass (A, B, C, D, dt)"
            )
        A, B, C, D = value[:4]
        return Parts(A, B, C, D, as_timebase(dt))
    if len(value) in (2, 3):
        return _of_fraction(name, value[0], value[1], as_timebase(value[2]) if len(value) == 3 else None, free=0.0)
    raise ModelError(
        f"{name}: a system of {len(value)} entries was given; pass (A, B, C, D), (A, B, C, D, dt), (num, den) or "
        "(num, den, dt)"
    )


def _of_mapping(name: str, value: Mapping) -> Parts:
    """The same by key, as in files."""
    if unknown := [key for key in value if key not in KEYS]:
        raise ModelError(f"{name} has {shown(unknown[0])}, which is no part of a system; known are {', '.join(KEYS)}")
    dt = as_timebase(value["dt"]) if "dt" in value else None
    for keys in (("A", "B", "C", "D"), ("num", "den"), ("zeros", "poles", "gain")):
        if keys[0] in value or keys[1] in value:
            if missing := [key for key in keys if key not in value]:
                raise ModelError(f"{name} has no {', '.join(missing)}; it needs {', '.join(keys)}")
            if keys[0] == "A":
                return Parts(value["A"], value["B"], value["C"], value["D"], 0.0 if dt is None else dt)
            if keys[0] == "num":
                return _of_fraction(name, value["num"], value["den"], dt, free=0.0)
            return _of_roots(name, value["zeros"], value["poles"], value["gain"], dt)
    raise ModelError(f"{name} has no A, B, C, D, no num, den and no zeros, poles, gain; it needs one of them")


def _of_matrices(name: str, value: Any) -> Parts:
    """An object with A, B, C, D; python-control's gain without a timebase takes that of its company."""
    dt = _timebase(value)
    if dt is None and np.size(value.A):
        as_timebase(None)
    u, y = _names(value)
    return Parts(value.A, value.B, value.C, value.D, dt, u, y, getattr(value, "units", None))


def _names(value: Any) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names of the signals, but for those that python-control makes up, "u[0]"."""
    found = []
    for mine, theirs in (("u", "input_labels"), ("y", "output_labels")):
        names = getattr(value, mine, None)
        if not isinstance(names, tuple):
            names = tuple(getattr(value, theirs, None) or ())
        made_up = names == tuple(f"{mine}[{i}]" for i in range(len(names)))
        found.append(() if made_up or not all(isinstance(n, str) for n in names) else names)
    return found[0], found[1]


def _timebase(value: Any) -> float | None:
    """The sampling time of an object; None where it says none, as control's gains do. In scipy None is continuous."""
    dt = getattr(value, "dt", 0.0)
    if dt is None:
        return 0.0 if type(value).__module__.startswith("scipy.") else None
    return as_timebase(dt)


def _of_fraction(name: str, num: Any, den: Any, dt: float | None, *, free: float | None = None) -> Parts:
    """A transfer matrix; `free` is the timebase of one with states that names none."""
    rows = _transfer_matrix(name, num, den)
    G = of_polynomials(name, *rows, discrete=bool(dt))
    dynamic = any(len(np.trim_zeros(d, "f")) > 1 for row in rows[1] for d in row)
    if dt is None and dynamic:
        dt = as_timebase(free)
    return Parts(G.A, G.B, G.C, G.D, dt)


def _of_roots(name: str, zeros: Any, poles: Any, gain: Any, dt: float | None) -> Parts:
    """Zeros, poles and gain of one input and one output."""
    roots = []
    for key, value in (("zeros", zeros), ("poles", poles)):
        try:
            found = np.atleast_1d(as_roots(f"the {key} of {name}", value))
        except (TypeError, ValueError, OverflowError) as error:
            if isinstance(error, ModelError):
                raise
            found = np.zeros((1, 1))
        if found.ndim > 1:
            raise ModelError(
                f"the {key} of {name} are {shown(value)}; pass a list of numbers, in files complex ones as '-1+2j'"
            )
        if not np.isfinite(found).all():
            raise ModelError(f"the {key} of {name} are {shown(value)}; every one must be finite")
        roots.append(found)
    A, B, C, D = of_roots(name, roots[0], roots[1], as_number(f"the gain of {name}", gain, "one real number"))
    return Parts(A, B, C, D, 0.0 if dt is None and len(roots[1]) else dt)


def _transfer_matrix(name: str, num: Any, den: Any) -> tuple[list[list[np.ndarray]], list[list[np.ndarray]]]:
    """Rows of numerators and denominators, from polynomials nested like python-control's or scipy's."""
    n, d = _depth(name, num), _depth(name, den)
    if n == 3:
        top = [[_polynomial(name, entry) for entry in _row(name, row)] for row in num]
    elif n == 2:
        top = [[_polynomial(name, row)] for row in num]
    else:
        top = [[_polynomial(name, num)]]
    if not top or not top[0] or any(len(row) != len(top[0]) for row in top):
        raise ModelError(f"{name} has numerators in rows of different length; pass p rows of m polynomials")
    if d == 3:
        below = [[_polynomial(name, entry) for entry in _row(name, row)] for row in den]
    elif d == 2 and len(den) != 1:
        below = [[_polynomial(name, row)] for row in den]
    else:
        below = [[_polynomial(name, den[0] if d == 2 else den)] * len(top[0]) for _ in top]
    if [len(row) for row in below] != [len(row) for row in top]:
        raise ModelError(
            f"{name} has {len(top)} x {len(top[0])} numerators and {len(below)} x {len(below[0]) if below else 0} "
            "denominators; pass one for each, or one denominator for all"
        )
    return top, below


def _row(name: str, value: Any) -> Any:
    """A row of polynomials, where others are rows."""
    if not isinstance(value, list | tuple | np.ndarray) or (isinstance(value, np.ndarray) and value.ndim == 0):
        raise ModelError(f"{name} has {shown(value)} beside rows of polynomials; nest all polynomials alike")
    return value


def _depth(name: str, value: Any) -> int:
    """How deep polynomials are nested: 0 a number, 1 one polynomial, 2 a column, 3 rows of them."""
    depth, inner = 0, value
    while isinstance(inner, list | tuple | np.ndarray) and np.shape(inner if isinstance(inner, np.ndarray) else 1) != 0:
        if isinstance(inner, np.ndarray) and inner.ndim == 0:
            break
        if not len(inner):
            raise ModelError(f"{name} has an empty polynomial; pass at least one coefficient")
        depth, inner = depth + 1, inner[0]
    if depth > 3:
        raise ModelError(f"{name} has polynomials nested {depth} deep; pass rows of polynomials")
    return depth


def _polynomial(name: str, value: Any) -> np.ndarray:
    c = np.atleast_1d(as_array(f"a polynomial of {name}", value, "pass real coefficients, highest power first"))
    if c.ndim != 1 or not c.size:
        raise ModelError(f"{name} has a polynomial of shape {c.shape}; pass a list of coefficients, highest first")
    return c


def _at_rest(name: str, value: Any) -> Parts:
    """A nonlinear system of python-control, linearised where it rests with x = 0 and u = 0."""
    n, m = value.nstates, value.ninputs
    if not n or not m:
        raise ModelError(
            f"{name} is a nonlinear system without a known number of states and inputs; linearise it first"
        )
    try:
        moved = value.dynamics(0.0, np.zeros(n), np.zeros(m))
        if not np.allclose(moved, 0.0, atol=1e-9):
            raise ModelError(
                f"{name} does not rest at x = 0, u = 0 (dx = {shown(np.asarray(moved))}); find its equilibrium with "
                "control.find_operating_point and pass what linearize gives there"
            )
        return parts(name, value.linearize(np.zeros(n), np.zeros(m)))
    except ModelError:
        raise
    except Exception as error:  # whatever the user's functions raise
        raise ModelError(f"{name} cannot be linearised at x = 0, u = 0 ({error}); linearise it first") from None


def fitted(A: Any, B: Any, C: Any, D: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The matrices in two dimensions: vectors become the column or row that fits, D = 0 takes its size from B and C."""
    A, D = as_array("A", A, "pass numbers in rows and columns", "a real matrix"), as_array("D", D, MATRIX)
    if D.ndim > 2:
        raise ModelError(f"D has {D.ndim} dimensions; {MATRIX}")
    if A.size == 0:
        D = as_matrix("D", D)
        for name, M in (("B", as_array("B", B, MATRIX)), ("C", as_array("C", C, MATRIX))):
            if M.size:
                raise ModelError(f"{name} has entries but A has none; pass the states' matrix A")
        return np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D
    A = as_matrix("A", A)
    n = A.shape[0]
    A = as_matrix("A", A, (n, n))
    B, C = as_array("B", B, MATRIX), as_array("C", C, MATRIX)
    B = B.reshape(n, -1) if B.ndim < 2 and B.size and B.size % n == 0 and (n == 1 or B.size == n) else B
    C = C.reshape(-1, n) if C.ndim < 2 and C.size and C.size % n == 0 and (n == 1 or C.size == n) else C
    p, m = (C.shape[0] if C.ndim == 2 else 1), (B.shape[1] if B.ndim == 2 else 1)
    if D.ndim == 0 and D == 0:
        D = np.zeros((p, m))
    elif D.ndim < 2:
        D = as_matrix("D", D, (p if m == 1 else None, m))
    p, m = D.shape
    return A, as_matrix("B", B, (n, m)), as_matrix("C", C, (p, n)), D
