"""Files that leave the toolbox, one format per module; `export` is the one way out.

    export(design, "c", "out", name="attitude", dtype="float", umin=-1e-3, umax=1e-3)

``json`` is the master format, read back by `Design.load`; ``mat`` is for MATLAB and Octave; ``c`` is C99 for a flight
computer; ``fmu2`` and ``fmu3`` are co-simulation units that run that same C.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

FORMATS = ("json", "mat", "c", "fmu2", "fmu3")


def export(
    design: Any,
    format: str,
    folder: str | os.PathLike[str],
    *,
    name: str = "controller",
    force: bool = False,
    allow_unstable: bool = False,
    umin: Any = None,
    umax: Any = None,
    antiwindup: Any = None,
    dtype: str = "double",
    self_test: bool = True,
) -> tuple[Path, ...]:
    """Write a controller into `folder` and return the files' paths; all of them appear or none.

    Parameters
    ----------
    design : Design, or a controller that comes without a plant (StateSpace, `control.StateSpace`, (A, B, C, D, dt),
        `LinearController`, `AntiWindup`), whose files then say that nothing was verified in a loop
    format : "json", "mat", "c", "fmu2" or "fmu3"
    folder : made if it is missing
    name : of the files and, in C, of the functions: a C identifier
    force : replace files that exist
    allow_unstable : export a controller with poles on or outside the unit circle; an integrator needs no permission
        when all its outputs have limits and anti-windup
    umin, umax : number or (m,), unit of u: limits that the C code and the FMU keep; None for no limit
    antiwindup : (n, m) gain L in x+ = A x + B y + L (u - v) with u = min(max(v, umin), umax); A - L C must be stable
    dtype : "double" or "float", of the C code
    self_test : put a stored trace and its bitwise comparison into the C source, compiled in with -DNAME_SELF_TEST

    Raises
    ------
    ExportError : the controller is continuous or unstable (both are fine in json and mat), the name is no C identifier,
        a file exists, an option does not belong to the format, there is no C compiler for an FMU.
    ModelError : the controller, the limits or the gain are not valid.
    VerificationError : rounded to float, the controller does not stabilise the design's plant.
    """
    from synth.checks import as_flag, as_path, shown
    from synth.delivery.files import check_name, write_all
    from synth.errors import ExportError

    if not isinstance(format, str) or format not in FORMATS:
        raise ExportError(f"format is {shown(format)}; pass one of {', '.join(FORMATS)}")
    check_name(name)
    folder = as_path("folder", folder)
    for flag, given in (("force", force), ("allow_unstable", allow_unstable), ("self_test", self_test)):
        as_flag(flag, given)
    options = {"umin": umin, "umax": umax, "antiwindup": antiwindup}
    if format in ("json", "mat"):
        given = [key for key, value in options.items() if value is not None]
        if not (isinstance(dtype, str) and dtype == "double"):
            given.append("dtype")
        if given:
            raise ExportError(f"{', '.join(given)}: a {format} file holds the design as it is; leave this away")
        files = _documents(design, format, name)
    else:
        files = _code(design, format, name, self_test, dtype=dtype, allow_unstable=allow_unstable, **options)
    return write_all(folder, files, force=force)


def _documents(design: Any, format: str, name: str) -> dict[str, bytes]:
    """The design, or a controller without a plant, as data."""
    from synth.delivery import matlab, plain
    from synth.synthesis.design import Design, json_bytes

    if not isinstance(design, Design):
        content = plain.json_bytes(design) if format == "json" else plain.mat_bytes(design)
    elif format == "json":
        content = json_bytes(design)
    else:
        content = matlab.mat_bytes(design)
    return {f"{name}.{format}": content}


def _code(design: Any, format: str, name: str, self_test: bool, **options: Any) -> dict[str, bytes]:
    """The C files, or the FMU made of them."""
    from synth.delivery.c import c_files
    from synth.delivery.origin import origin_of
    from synth.regulators.sequential import SequentialController

    controller = SequentialController.of(design, **options)
    origin = origin_of(design, controller)
    if format == "c":
        return c_files(controller, origin, name, self_test=self_test)
    from synth.delivery.fmu import fmu_bytes

    return {f"{name}.fmu": fmu_bytes(controller, origin, name, version=int(format[-1]))}
