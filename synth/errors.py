"""The errors of this package, all below one root.

SynthError
 ├─ ModelError         the data is not a model: NaN, wrong shape, wrong timebase
 │   └─ SpecificationError   a study file has mistakes: carries all of them, with their paths
 ├─ AssumptionError    the model is sound but no controller can exist: names the assumption
 ├─ InfeasibleError    the asked-for level was not reached: carries the best level, and what is proved impossible
 ├─ NumericalError     every route failed: carries the statuses of the solvers
 ├─ VerificationError  a controller was found and the independent judge rejected it
 └─ ExportError        a sound controller cannot leave in this form, under this name, to this place
"""

MOST = 100  # mistakes in a message


class SynthError(Exception):
    """Root of all errors raised by `synth`."""


class ModelError(SynthError, ValueError):
    """The data given is not a valid model; the message names the field, the value and the remedy."""


class SpecificationError(ModelError):
    """A study file has mistakes; the message has all of them, one a line, of very many the first hundred.

    Attributes
    ----------
    problems : tuple of str, each with the path of the key, for example ``"plant.A[2][3]: expected a number"``
    """

    def __init__(self, name: str, problems: list[str]):
        listed = problems[0] if len(problems) == 1 else "".join(f"\n  {text}" for text in problems[:MOST])
        listed += f"\n  and {len(problems) - MOST} more" if len(problems) > MOST else ""
        count = "" if len(problems) == 1 else f"{len(problems)} mistakes:"
        super().__init__(f"{name}: {count}{listed}")
        self.problems = tuple(problems)


class AssumptionError(SynthError):
    """No controller can exist for this model.

    Attributes
    ----------
    assumption : str, for example ``"(A, B2) stabilisable"``
    modes : tuple of complex, the eigenvalues at which it fails
    """

    def __init__(self, assumption: str, message: str, modes: tuple[complex, ...] = ()):
        super().__init__(message)
        self.assumption = assumption
        self.modes = modes


class InfeasibleError(SynthError):
    """The requested performance level was not reached, or is proved to be impossible; the message says which.

    Attributes
    ----------
    best : float, the lowest level that was reached
    lower : float, the level below which no controller goes, as far as that was proved; 0 when nothing was
    """

    def __init__(self, message: str, best: float, lower: float = 0.0):
        super().__init__(message)
        self.best = best
        self.lower = lower


class NumericalError(SynthError):
    """Every route to a solution failed.

    Attributes
    ----------
    statuses : dict of str to str, what each route reported
    """

    def __init__(self, message: str, statuses: dict[str, str] | None = None):
        super().__init__(message)
        self.statuses = dict(statuses or {})


class VerificationError(SynthError):
    """A controller was computed but failed its independent verification."""


class ExportError(SynthError):
    """A controller cannot be exported like this; the message names the reason and the remedy."""
