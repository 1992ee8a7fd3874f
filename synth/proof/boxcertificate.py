"""Certificates of loops over a box of parameters: what was proved, exact data, and the boxes to prove it again with.

    gain       the loop is stable with an H-infinity norm below `level` at every point of the box, and reaches `reached`
    stability  the loop is stable at every point of the box made `level` times as large about the nominal parameters,
               and is not at a point of the box made `reached` times as large

The check needs the polynomials (`robust`) and follows the script of halvings (`boxes`): it searches nothing. The file
is taken only as it was written, byte for byte of its data.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from flint import acb, acb_mat, arb, ctx

from synth.checks import as_path
from synth.errors import ModelError, VerificationError
from synth.files import SEAL, read_json, sealed, write_atomically
from synth.proof import robust
from synth.proof.boxes import follows
from synth.proof.pencils import Pencil, rational
from synth.systems.parameters import Expression, Hold, Parameter, Remainder, as_expression
from synth.systems.polynomialholds import as_hold, errors
from synth.systems.uncertain import UncertainSystem

FORMAT = "convex-synth box certificate"
FORMAT_VERSION = 1
GAIN, STABILITY = "gain", "stability"
MATRICES = ("E", "A", "B", "C", "D")
PARTS = ("name", "nominal", "low", "high")  # of a parameter


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class BoxCertificate:
    """What was proved about a loop on a box of parameters, with all that is needed to prove it again."""

    quantity: str  # "gain" or "stability"
    level: float  # proved: the norm is below this, or the box may be made so many times as large
    reached: float  # proved from the other side at `point`; 0 or inf when nothing was
    point: dict[str, float]  # parameters that reach it
    w: float  # rad/s, where the gain is reached; of a discrete loop tan(omega dt / 2)
    system: UncertainSystem  # from w to z
    bits: int  # precision of the ball arithmetic
    edges: tuple[float, ...]  # of the pieces of frequency, rad/s or tan(omega dt / 2)
    script: tuple[str, ...]  # of halvings
    degrees: tuple[int, ...] = ()  # of interpolants in the parameters, of loops with hold equivalents

    def __repr__(self) -> str:
        return f"BoxCertificate({self.statement})"

    @property
    def statement(self) -> str:
        """What was proved, in words."""
        box = ", ".join(f"{p.name} in [{p.low!r}, {p.high!r}]" for p in self.system.parameters.values())
        at = ", ".join(f"{name} = {value!r}" for name, value in self.point.items())
        if self.quantity == GAIN:
            claim = f"the loop is stable with an H-infinity norm below {self.level!r} for all {box}"
            other = f"; at {at} its gain is above {self.reached!r}" if self.reached else ""
        else:
            claim = f"the loop is stable on the box {box} made {self.level!r} times as large about its nominal values"
            other = f"; at {at}, in the box made {self.reached!r} times as large, it is not" if at else ""
        return f"Proved in {self.bits}-bit ball arithmetic, all data taken as exact doubles: {claim}{other}"

    @property
    def sha256(self) -> str:
        """Of all that its file holds, as the file itself says it."""
        return to_dict(self)[SEAL]

    def check(self, system: UncertainSystem | None = None) -> None:
        """Prove it again, from the data and the script alone.

        Parameters
        ----------
        system : the closed loop that the certificate must be of; its own when left out

        Raises
        ------
        VerificationError : the certificate is of another loop, or a proof does not hold.
        """
        if system is not None and system_to_dict(system) != system_to_dict(self.system):
            raise VerificationError("the certificate is of another loop: its matrices or parameters differ")
        what = "the norm" if self.quantity == GAIN else "stability"
        try:
            if not self._proves_holds():
                raise VerificationError("what is claimed of a hold equivalent does not hold")
            if not (self._proves_level() and self._proves_point()):
                raise VerificationError(f"the script does not prove what is claimed of {what}")
        except (ZeroDivisionError, ValueError, OverflowError, ModelError) as error:
            raise VerificationError(f"what is claimed of {what} cannot be checked: {error}") from None

    def _proves_holds(self) -> bool:
        """Whether every Phi, polynomials with remainders, holds the one of its plant on the whole box."""
        found: dict[Hold, dict[tuple[int, int], Expression]] = {}
        G, remainders = self.system, self.system.remainders
        for entry in (x for M in (G.E, G.A, G.B, G.C, G.D) for x in M.flat):
            own = [p for name, p in entry.parameters.items() if name in remainders]
            if not own:
                continue
            (p, *others), polynomial = own, entry.without(remainders)
            same = found.setdefault(p.hold, {}).setdefault(p.at, polynomial).terms == polynomial.terms
            if (
                others
                or not same
                or {m: c for m, c in entry.terms.items() if m not in polynomial.terms} != {((p.name, 1),): 1}
            ):
                return False
        for hold, Phi in found.items():
            n = len(hold.A)
            if hold != as_hold(hold.E, hold.A, hold.dt, hold.tol) or hold.dt != G.dt or len(Phi) != n * n:
                return False
            bounds = errors(hold, Phi)
            claimed = {p.at: min(-p.low, p.high) for p in remainders.values() if p.hold == hold}
            if not all(bounds[at] <= size for at, size in claimed.items()):
                return False
        return True

    def _proves_level(self) -> bool:
        box = tuple(self.system.parameters.values())
        gain = self.quantity == GAIN
        pencil = Pencil.of(self.system, box, Fraction(1) if gain else Fraction(self.level))
        size = (robust.size_of_gain if gain else robust.size_of_stability)(pencil)
        edges = np.array(self.edges)
        sound = self.level > 0 and len(edges) > pencil.order + 1 and edges[0] > 0 and (np.diff(edges) > 0).all()
        if not sound or not robust.fits(pencil, size, bordered=gain) or not pencil.is_stable_at(pencil.nominal):
            return False
        if (len(self.degrees) != len(box)) if pencil.off else self.degrees:
            return False
        if not gain:
            pair = robust.stability_pieces(pencil, self.edges, self.bits, self.degrees)
            return follows(pair, robust.excludes_zero, self.script)
        pieces = robust.gain_pieces(pencil, self.edges, self.bits, self.degrees)
        start = robust.at_level(pieces, self.level)
        at_rest = pencil.is_below_at_rest(pencil.nominal, rational(self.level))
        return at_rest and follows(start, robust.is_positive, self.script)

    def _proves_point(self) -> bool:
        box = tuple(self.system.parameters.values())
        if not self.point:
            return self.reached == (0.0 if self.quantity == GAIN else np.inf)
        if set(self.point) != {p.name for p in box}:
            return False
        pencil, values = Pencil.of(self.system, box), [rational(self.point[p.name]) for p in box]
        if self.quantity == STABILITY:
            inside = scale_of(box, self.point) <= Fraction(self.reached)
            return inside and not pencil.is_stable_at(values)
        inside = all(a <= x <= b for a, b, x in zip(pencil.low, pencil.high, values, strict=True))
        return inside and self.w >= 0 and proves_reached(pencil, self.point, self.w, self.reached, self.bits)

    def save(self, path: str | os.PathLike[str]) -> Path:
        """Write to `path`, a ``.json`` file.

        Raises
        ------
        ModelError : the file name ends otherwise.
        """
        path = as_path("path", path)
        if path.suffix != ".json":
            raise ModelError(f"path ends with {path.suffix!r}; a certificate is saved as .json")
        return write_atomically(path, _text(to_dict(self)).encode())

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> BoxCertificate:
        """Read what `save` wrote. Nothing is proved by reading: call `check`.

        Raises
        ------
        ModelError : the file is no certificate or is incomplete.
        """
        path = as_path("path", path)
        try:
            return from_dict(read_json(path))
        except ModelError as error:
            raise ModelError(f"path {path.name!r}: {error}; pass what BoxCertificate.save wrote") from None


def scale_of(box: Sequence[Parameter], point: Mapping[str, float]) -> Fraction:
    """How many times as large the box must be made to hold a point, at least; 0 where no size holds it."""
    scale = Fraction(0)
    for p in box:
        moved, room = Fraction(point[p.name]) - Fraction(p.nominal), Fraction(p.high) - Fraction(p.nominal)
        if moved < 0:
            moved, room = -moved, Fraction(p.nominal) - Fraction(p.low)
        if moved and not room:
            return Fraction(10) ** 400
        scale = max(scale, moved / room if moved else Fraction(0))
    return scale


def gain_at(pencil: Pencil, point: Mapping[str, float], w: float, bits: int) -> arb:
    """A lower bound on the largest singular value at a point, as a ball: along a direction found in doubles."""
    with ctx.workprec(bits):
        p, N = pencil.response([rational(point[name]) for name in pencil.names], rational(w))
        _, nw, nz = pencil.sizes
        G = np.array([complex(x / p) for x in N.entries()]).reshape(nz, nw)
        v = np.linalg.svd(G)[2][0].conj()
        direction = acb_mat(nw, 1, [acb(float(x.real), float(x.imag)) for x in v])
        moved = sum((_square(x) for x in (N * direction).entries()), arb(0))
        return (moved / (_square(p) * sum((_square(x) for x in direction.entries()), arb(0)))).sqrt()


def proves_reached(pencil: Pencil, point: Mapping[str, float], w: float, level: float, bits: int) -> bool:
    """True when it is proved that the gain at this point is above `level`."""
    return bool(gain_at(pencil, point, w, bits) > arb(level))


def _square(x: acb) -> arb:
    return x.real * x.real + x.imag * x.imag


def to_dict(certificate: BoxCertificate) -> dict[str, Any]:
    """The certificate as plain data, complete and exact, with a sha256 of all of it."""
    c = certificate
    data = {
        "format": FORMAT,
        "format_version": FORMAT_VERSION,
        "statement": c.statement,
        "quantity": c.quantity,
        "level": c.level,
        "reached": c.reached if np.isfinite(c.reached) else None,
        "point": c.point,
        "w": c.w,
        "bits": c.bits,
        "system": system_to_dict(c.system),
        "edges": list(c.edges),
        "script": list(c.script),
        **({"degrees": list(c.degrees)} if c.degrees else {}),
    }
    return sealed(json.loads(_text(data)))


def _text(data: Any) -> str:
    return json.dumps(data, allow_nan=False)


def from_dict(data: Any) -> BoxCertificate:
    """The certificate in a file.

    Raises
    ------
    ModelError : the data is no certificate, is incomplete, or is not what `to_dict` made.
    """
    from synth import mistakes, schemas

    if not isinstance(data, dict) or data.get("format") != FORMAT or data.get("format_version") != FORMAT_VERSION:
        raise ModelError(f"the data is no box certificate of format {FORMAT_VERSION}")
    mistakes.check(schemas.BoxCertificate, data, "the certificate is incomplete or damaged")
    reached = data["reached"]
    certificate = BoxCertificate(
        quantity=data["quantity"],
        level=float(data["level"]),
        reached=np.inf if reached is None else float(reached),
        point={name: float(x) for name, x in data["point"].items()},
        w=float(data["w"]),
        system=_system_from_dict(data["system"]),
        bits=data["bits"],
        edges=tuple(float(x) for x in data["edges"]),
        script=tuple(data["script"]),
        degrees=tuple(data.get("degrees", ())),
    )
    if _text(to_dict(certificate)) != _text(data):
        raise ModelError("the certificate is not as BoxCertificate.save wrote it: something in it was changed")
    return certificate


def system_to_dict(G: UncertainSystem) -> dict[str, Any]:
    """An uncertain system as plain data: entries are numbers, or lists of coefficients with powers of parameters."""
    data = {"parameters": _box_to_list(G.parameters.values()), **_matrices(G, MATRICES)}
    data |= {"dt": G.dt, "u": list(G.u), "y": list(G.y)}
    if G.remainders:
        holds = sorted({p.hold for p in G.remainders.values()}, key=lambda hold: hold.name)
        data["holds"] = [
            {
                "name": hold.name,
                **_matrices(hold, ("E", "A")),
                "dt": hold.dt,
                "tol": hold.tol,
                "parameters": _box_to_list(hold.box),
                "remainders": [
                    {"name": p.name, "at": list(p.at), "size": p.high} for p in G.remainders.values() if p.hold == hold
                ],
            }
            for hold in holds
        ]
    return data


def _box_to_list(box: Iterable[Parameter]) -> list[dict[str, Any]]:
    return [{part: getattr(p, part) for part in PARTS} for p in box]


def _matrices(of: Any, names: Sequence[str]) -> dict[str, Any]:
    return {name: [[_entry(x) for x in row] for row in getattr(of, name)] for name in names}


def _entry(x: Expression) -> Any:
    if not x.parameters:
        return _number(x.terms.get((), Fraction(0)))
    return [[_number(c), dict(monomial)] for monomial, c in sorted(x.terms.items())]


def _number(c: Fraction) -> float | str:
    """A rational, as a text where it is no double."""
    try:
        return float(c) if Fraction(float(c)) == c else str(c)
    except OverflowError:
        return str(c)


def _system_from_dict(data: Mapping[str, Any]) -> UncertainSystem:
    box = _box_from_list(data["parameters"])
    try:
        for part in data.get("holds", ()):
            own = _box_from_list(part["parameters"])
            E, A = (_matrix(part[name], own) for name in ("E", "A"))
            hold = Hold(part["name"], E, A, float(part["dt"]), float(part["tol"]), tuple(own.values()))
            for r in part["remainders"]:
                size, (i, j) = float(r["size"]), r["at"]
                box[r["name"]] = Remainder(r["name"], 0.0, -size, size, hold, (i, j))
        E, A, B, C, D = (_matrix(data[name], box) for name in MATRICES)
        return UncertainSystem(E, A, B, C, D, data["dt"], tuple(data["u"]), tuple(data["y"]))
    except (ValueError, TypeError, KeyError, AttributeError, ArithmeticError) as error:
        raise ModelError(f"the certificate is incomplete or damaged: {error}") from None


def _box_from_list(data: Any) -> dict[str, Parameter]:
    box = {p["name"]: Parameter(p["name"], *(float(p[part]) for part in PARTS[1:])) for p in data}
    if not all(p.low <= p.nominal <= p.high and p.low < p.high for p in box.values()):
        raise ModelError("the certificate is incomplete or damaged: a range without its nominal value")
    return box


def _matrix(data: Any, box: Mapping[str, Parameter]) -> np.ndarray:
    return np.array([[_expression(x, box) for x in row] for row in data], object)


def _expression(x: Any, box: Mapping[str, Parameter]) -> Expression:
    if not isinstance(x, list):
        return as_expression("an entry", _fraction(x))
    total = as_expression("an entry", 0)
    for c, powers in x:
        term = as_expression("an entry", _fraction(c))
        for name, k in powers.items():
            term = term * Expression({((name, 1),): Fraction(1)}, {name: box[name]}) ** k
        total = total + term
    return total


def _fraction(x: Any) -> Fraction | float:
    """A number of a file: a double, or a text p/q."""
    if isinstance(x, str):
        if not re.fullmatch(r"-?[0-9]{1,4000}(/[0-9]{1,4000})?", x):
            raise ValueError(f"{x[:40]!r} is no number")
        return Fraction(x)
    return x
