"""Uncertain real parameters, and polynomials in them with exact coefficients.

`ureal` makes a parameter; numbers, parameters and what is made of them can be added, multiplied and raised to whole
powers, also in NumPy arrays. Doubles enter as the exact rationals they are: nothing is rounded on the way to a proof.

There is no division by a parameter: 1/J is no polynomial. The equation J w' = torque keeps J in the mass matrix E of an
`UncertainSystem`, where it is linear.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np

from synth.checks import as_array, as_number, as_whole, shown
from synth.errors import ModelError

MOST_POWERS = 20  # of a parameter in an expression
PROSE = "a finite number or an expression of ureal parameters"

Monomial = tuple[tuple[str, int], ...]  # names with their powers, sorted by name; () is one


@dataclass(frozen=True)
class Parameter:
    """A real number that is known to lie in a range."""

    name: str
    nominal: float
    low: float
    high: float

    @property
    def range(self) -> tuple[float, float]:
        """Lowest and highest value."""
        return self.low, self.high


@dataclass(frozen=True)
class Hold:
    """A plant E(p) v = A(p) x on a box, of whose Phi(p) = int_0^dt exp(E^-1 A s) ds sampled ones have polynomials."""

    name: str  # made of all that follows
    E: np.ndarray = field(compare=False, repr=False)  # (n, n) expressions
    A: np.ndarray = field(compare=False, repr=False)
    dt: float  # s
    tol: float  # that was aimed at
    box: tuple[Parameter, ...]  # of the parameters of E and A

    def check(self, what: str, ranges: Mapping[str, tuple[float, float]]) -> None:
        """Raise ModelError where ranges lie outside the box, on which alone Phi is bounded."""
        for q in self.box:
            low, high = ranges.get(q.name, (q.nominal, q.nominal))
            if not q.low <= low <= high <= q.high:
                raise ModelError(
                    f"{what} of {q.name!r} is [{float(low):.17g}, {float(high):.17g}]; c2d made the hold for "
                    f"[{q.low:.17g}, {q.high:.17g}]: give the plant the wider range before c2d"
                )


@dataclass(frozen=True)
class Remainder(Parameter):
    """What an entry of Phi is off its polynomial, another number at every point of the box; its range is proved."""

    hold: Hold
    at: tuple[int, int]  # row and column


class Expression:
    """A polynomial in uncertain parameters with rational coefficients; immutable.

    `+`, `-`, `*`, `** k` with numbers, NumPy arrays and other expressions, `/` by numbers.

    Attributes
    ----------
    parameters : dict of name to Parameter, those that occur
    terms : dict of monomial to coefficient, without zeros
    """

    __slots__ = ("parameters", "terms")
    __array_ufunc__ = None  # NumPy's operators leave expressions to the operators below

    def __init__(self, terms: Mapping[Monomial, Fraction], parameters: Mapping[str, Parameter]):
        self.terms = {monomial: c for monomial, c in terms.items() if c}
        used = {name for monomial in self.terms for name, _ in monomial}
        self.parameters = {name: p for name, p in parameters.items() if name in used}

    @property
    def is_zero(self) -> bool:
        """Whether it is nothing, whatever the parameters are."""
        return not self.terms

    @property
    def nominal(self) -> float:
        """Its value at the nominal parameters, correctly rounded."""
        return float(self.exactly({name: Fraction(p.nominal) for name, p in self.parameters.items()}))

    def exactly(self, values: Mapping[str, Fraction]) -> Fraction:
        """Its value."""
        return sum((c * math.prod((values[n] ** k for n, k in m), start=Fraction(1)) for m, c in self.terms.items()),
                   start=Fraction(0))  # fmt: skip

    def without(self, names: Container[str]) -> Expression:
        """The terms that have none of these names."""
        terms = {m: c for m, c in self.terms.items() if not any(name in names for name, _ in m)}
        return Expression(terms, self.parameters)

    def moved(self, p: Parameter, origin: Fraction) -> Expression:
        """The same polynomial with p + origin in the place of p."""
        terms: dict[Monomial, Fraction] = {}
        for monomial, c in self.terms.items():
            others = tuple(part for part in monomial if part[0] != p.name)
            degree = dict(monomial).get(p.name, 0)
            for k in range(degree + 1):
                m = tuple(sorted((*others, (p.name, k)))) if k else others
                terms[m] = terms.get(m, Fraction(0)) + c * math.comb(degree, k) * origin ** (degree - k)
        return Expression(terms, self.parameters)

    def __repr__(self) -> str:
        def one(monomial: Monomial, c: Fraction) -> str:
            factors = [name if k == 1 else f"{name}^{k}" for name, k in monomial]
            return "*".join(factors if c == 1 and factors else [f"{float(c):g}", *factors])

        return " + ".join(one(*term) for term in self.terms.items()) or "0"

    def __neg__(self) -> Expression:
        return Expression({m: -c for m, c in self.terms.items()}, self.parameters)

    def __pos__(self) -> Expression:
        return self

    def __add__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(lambda x: self + x, other)
        other = as_expression("the other operand", other)
        if not self.terms or not other.terms:
            return self if not other.terms else other
        terms = dict(self.terms)
        for m, c in other.terms.items():
            terms[m] = terms.get(m, Fraction(0)) + c
        return Expression(terms, joined(self.parameters, other.parameters))

    def __radd__(self, other: Any) -> Any:
        return self + other

    def __sub__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(lambda x: self - x, other)
        return self + -as_expression("the other operand", other)

    def __rsub__(self, other: Any) -> Any:
        return -self + other

    def __mul__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(lambda x: self * x, other)
        other = as_expression("the other operand", other)
        if not self.terms or not other.terms:
            return ZERO
        terms: dict[Monomial, Fraction] = {}
        for m, c in self.terms.items():
            for n, d in other.terms.items():
                product = _times(m, n)
                terms[product] = terms.get(product, Fraction(0)) + c * d
        return Expression(terms, joined(self.parameters, other.parameters))

    def __rmul__(self, other: Any) -> Any:
        return self * other

    def __truediv__(self, other: Any) -> Any:
        if isinstance(other, np.ndarray):
            return _each(lambda x: self / x, other)
        divisor = as_expression("the divisor", other)
        if divisor.parameters:
            raise ModelError(f"the divisor is {shown(divisor)}; {NO_DIVISION}")
        if divisor.is_zero:
            raise ModelError("the divisor is 0; pass a number that is none")
        return self * Expression({(): 1 / divisor.terms[()]}, {})

    def __rtruediv__(self, other: Any) -> Any:
        if not self.parameters and self.terms:
            return ONE / self * other
        raise ModelError(f"the divisor is {shown(self)}; {NO_DIVISION}")

    def __pow__(self, power: Any) -> Expression:
        if isinstance(power, int | np.integer) and power < 0:
            raise ModelError(f"the power is {power}; {NO_DIVISION}")
        power = as_whole("the power", power, f"a whole number from 0 to {MOST_POWERS}", least=0, most=MOST_POWERS)
        product = ONE
        for _ in range(power):
            product = product * self
        return product


NO_DIVISION = (
    "1/parameter is no polynomial: put the parameter in the mass matrix E of the UncertainSystem, "
    "as in E = [[J]], A = [[-d]] for J w' = -d w"
)
ZERO, ONE = Expression({}, {}), Expression({(): Fraction(1)}, {})


def _times(m: Monomial, n: Monomial) -> Monomial:
    if not m or not n:
        return m or n
    powers = dict(m)
    for name, k in n:
        powers[name] = powers.get(name, 0) + k
        if powers[name] > MOST_POWERS:
            raise ModelError(f"{name} has the power {powers[name]}; an expression has at most {MOST_POWERS}")
    return tuple(sorted(powers.items()))


def joined(*several: Mapping[str, Parameter]) -> dict[str, Parameter]:
    """The parameters of several expressions.

    Raises
    ------
    ModelError : two different parameters have one name.
    """
    found: dict[str, Parameter] = {}
    for parameters in several:
        for name, p in parameters.items():
            if found.setdefault(name, p) != p:
                q = found[name]
                raise ModelError(
                    f"the parameter {name!r} is given twice, as {q.nominal:g} in [{q.low:g}, {q.high:g}] and as "
                    f"{p.nominal:g} in [{p.low:g}, {p.high:g}]; make it once, or give the other one another name"
                )
    return found


def as_expression(name: str, value: Any) -> Expression:
    """A number or an expression as an expression; whole numbers and fractions stay exact."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, int | Fraction) and not isinstance(value, bool):
        if abs(value) > Fraction(10) ** 300:
            raise ModelError(f"{name} is {shown(value)}, beyond doubles; pass {PROSE}")
        return Expression({(): Fraction(value)}, {})
    return Expression({(): Fraction(as_number(name, value, PROSE))}, {})


def ureal(name: str, nominal: float, *, range: Any = None, percentage: Any = None, plusminus: Any = None) -> Expression:
    """An uncertain real parameter.

    Parameters
    ----------
    name : how messages, results and files call it; one name is one parameter, however often it occurs
    nominal : its value, in SI units
    range : (low, high), the values it may have; or
    percentage : of the nominal value, up and down, or (-down, up); or
    plusminus : what may be added and taken away, or (-down, up)

    Returns
    -------
    Expression : the polynomial that is the parameter itself

    Raises
    ------
    ModelError : no name, not exactly one of range, percentage and plusminus, or a range without the nominal value.

    Examples
    --------
    >>> from synth import ureal
    >>> J = ureal("J", 500, percentage=20)
    >>> w = ureal("w", 1.2, plusminus=0.1)
    >>> 2 * 0.005 * w + J * w**2
    0.01*w + J*w^2

    Reference: the names are those of MATLAB's `ureal`.
    """
    if not isinstance(name, str) or not name or not name.isprintable() or name != name.strip():
        raise ModelError(f"name is {shown(name)}; pass the parameter's name, a text such as 'J'")
    nominal = as_number("nominal", nominal, "the parameter's usual value, a finite number")
    given = {"range": range, "percentage": percentage, "plusminus": plusminus}
    given = {key: value for key, value in given.items() if value is not None}
    if len(given) != 1:
        raise ModelError(
            f"{' and '.join(given) or 'no range'} given for {name!r}; pass one of range, percentage and plusminus"
        )
    ((key, value),) = given.items()
    if key == "range":
        low, high = _pair(key, value, "(low, high)")
    else:
        down, up = _pair(key, value, "a positive number or (-down, up)", symmetric=True)
        unit = Fraction(1) if key == "plusminus" else abs(Fraction(nominal)) / 100
        low, high = (_rounded(key, Fraction(nominal) + Fraction(d) * unit) for d in (down, up))
    if not low <= nominal <= high or low == high:
        raise ModelError(
            f"{key} of {name!r} is [{low:g}, {high:g}] with the nominal value {nominal:g}; pass a range that has a "
            "width and holds the nominal value"
        )
    parameter = Parameter(name, nominal, low, high)
    return Expression({((name, 1),): Fraction(1)}, {name: parameter})


def _pair(key: str, value: Any, wanted: str, *, symmetric: bool = False) -> tuple[float, float]:
    """Two numbers; one stands for itself and its negative where that makes sense."""
    ends = as_array(key, value, f"pass {wanted}")
    if symmetric and ends.ndim == 0 and ends > 0:
        return -float(ends), float(ends)
    if ends.shape != (2,) or not ends[0] < ends[1]:
        raise ModelError(f"{key} is {shown(value)}; pass {wanted}")
    return float(ends[0]), float(ends[1])


def _rounded(key: str, value: Fraction) -> float:
    try:
        return float(value)
    except OverflowError:
        raise ModelError(f"{key} leads beyond doubles; pass a smaller one") from None


def as_expressions(name: str, value: Any) -> np.ndarray:
    """Numbers and expressions, in lists or arrays of any depth, as an array of expressions."""
    if isinstance(value, Expression):
        found = np.empty((), object)
        found[()] = value
        return found
    if isinstance(value, list | tuple):
        if not any(isinstance(entry, Expression) for entry in _leaves(value)):
            value = as_array(name, value, "pass numbers and expressions in rows and columns", "a matrix")
    elif not (isinstance(value, np.ndarray) and value.dtype.kind == "O"):
        value = as_array(name, value, f"pass {PROSE}, or rows of them")
    try:
        raw = np.array(value, dtype=object)
    except ValueError as error:  # rows of different length
        raise ModelError(f"{name} is no matrix ({error}); pass rows of equal length") from None
    found = np.empty(raw.shape, object)
    for at in np.ndindex(raw.shape):
        found[at] = as_expression(f"{name}{list(at)}", raw[at])
    return found


def _each(operation: Callable[[Any], Any], others: np.ndarray) -> np.ndarray:
    """An operation with every entry of an array."""
    others = as_expressions("the other operand", others)
    found = np.empty(others.shape, object)
    for at in np.ndindex(others.shape):
        found[at] = operation(others[at])
    return found


def _leaves(value: Any) -> Iterator[Any]:
    if isinstance(value, list | tuple):
        for item in value:
            yield from _leaves(item)
    elif isinstance(value, np.ndarray):
        yield from value.flat
    else:
        yield value
