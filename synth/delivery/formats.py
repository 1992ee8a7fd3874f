"""Files that leave the toolbox, one format per module; `export` is the one way out.

    export(design, "c", "out", name="attitude", dtype="float", umin=-1e-3, umax=1e-3)

``json`` is the master format, read back by `Design.load`; ``mat`` is for MATLAB and Octave; ``c`` is C99 for a flight
computer; ``fmu2`` and ``fmu3`` are co-simulation units that run that same C.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from synth.delivery.acceptance import Acceptance
    from synth.proof.certify import Certificate
    from synth.regulators.antiwindup import AntiWindup

NEVER = "none: this controller was never put through accept"
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
    inputs: Any = None,
    self_test: bool = True,
    acceptance: Acceptance | None = None,
    certificate: Certificate | None = None,
) -> tuple[Path, ...]:
    """Write a controller into `folder` and return the files' paths; all of them appear or none.

    Parameters
    ----------
    design : Design, or a controller that comes without a plant (StateSpace, `control.StateSpace`, (A, B, C, D, dt),
        `LinearController`, `AntiWindup`), whose files then say that nothing was verified in a loop; an `Mpc`, which
        takes none of the options from `umin` to `certificate`; `Sdre`, `SdreSampled` and `SdreHinfStatic` of a model of
        `synth`, which leave as "c", with umin, umax and self_test alone
    format : "json", "mat", "c", "fmu2" or "fmu3"
    folder : made if it is missing
    name : of the files and, in C, of the functions: a C identifier
    force : replace files that exist
    allow_unstable : export a controller with poles on or outside the unit circle; an integrator needs no permission
        when all its outputs have limits and anti-windup
    umin, umax : number or (m,), unit of u: limits that the C code and the FMU keep, and that json and mat then hold as
        a controller with the facts about its design; None for no limit
    antiwindup : (n, m) gain L in x+ = A x + B y + L (u - v) with u = min(max(v, umin), umax); A - L C must be stable
    dtype : "double" or "float", of the C code; "q15" or "q31" for whole numbers (C alone; stable controllers, with
        `inputs`, by which they are scaled, and without anti-windup)
    inputs : number or (p,) bound of |y|, unit of y, under which the files state the bound of `rounding`; None for 1
    acceptance : what `accept` found for this controller, for the files to say; without it they say that it was never
        accepted (json holds the design as it is)
    certificate : of this design, as `certify` found it: proved again here, and named by its sha256 in every file,
        with what it proves
    self_test : put a stored trace and its bitwise comparison into the C source, compiled in with -DNAME_SELF_TEST

    Raises
    ------
    ExportError : the controller is continuous or unstable (both are fine in json and mat) or of a kind that does not
        leave so (`synth.delivery.leaving`); the name is no C identifier, a file exists, an option does not belong to
        the format or the controller, there is no C compiler for an FMU, or `acceptance` or `certificate` is of another
        controller.
    ModelError : the controller, the limits or the gain are not valid.
    VerificationError : rounded to float, the controller does not stabilise the design's plant, or a proof of the
        certificate does not hold.
    """
    from synth.checks import as_flag, as_path, shown
    from synth.delivery.files import check_name, write_all
    from synth.delivery.leaving import check_leaves, is_sdre
    from synth.errors import ExportError

    if not isinstance(format, str) or format not in FORMATS:
        raise ExportError(f"format is {shown(format)}; pass one of {', '.join(FORMATS)}")
    check_name(name)
    folder = as_path("folder", folder)
    for flag, given in (("force", force), ("allow_unstable", allow_unstable), ("self_test", self_test)):
        as_flag(flag, given)
    check_leaves(design, format)
    options: dict[str, Any]
    if any(kind.__module__.startswith("synth.predictive") for kind in type(design).__mro__):
        from synth.delivery import predictive

        options = {"umin": umin, "umax": umax, "antiwindup": antiwindup, "inputs": inputs, "acceptance": acceptance,
                   "certificate": certificate}  # fmt: skip
        files = predictive.files(design, format, name, self_test=self_test, dtype=dtype, **options)
        return write_all(folder, files, force=force)
    if is_sdre(design):
        _check_unused(dtype=dtype != "double", allow_unstable=allow_unstable, antiwindup=antiwindup is not None,
                      inputs=inputs is not None, acceptance=acceptance is not None,
                      certificate=certificate is not None)  # fmt: skip
        from synth.delivery.csdre import sdre_files

        return write_all(folder, sdre_files(design, name, umin=umin, umax=umax, self_test=self_test), force=force)
    accepted = NEVER if acceptance is None else _verdict(design, acceptance)
    proved = "" if certificate is None else _proved(design, certificate)
    options = {"umin": umin, "umax": umax, "antiwindup": antiwindup}
    if format in ("json", "mat"):
        if inputs is not None:
            raise ExportError(f"inputs: a {format} file holds the design, not its arithmetic; leave this away")
        if not (isinstance(dtype, str) and dtype == "double"):
            raise ExportError(f"dtype: a {format} file holds the numbers as they are; leave this away")
        files = _documents(design, format, name, accepted, proved, **options)
    else:
        options |= {"dtype": dtype, "allow_unstable": allow_unstable}
        files = _code(design, format, name, self_test, (accepted, proved), inputs, options)
    return write_all(folder, files, force=force)


def _check_unused(**given: bool) -> None:
    """Options of linear controllers, of which a Riccati law has none."""
    from synth.errors import ExportError

    for name, passed in given.items():
        if passed:
            raise ExportError(f"{name}: belongs to linear controllers; a Riccati law has none, leave this away")


def _verdict(design: Any, acceptance: Any) -> str:
    """What the gate found, if it is of this controller."""
    from synth.checks import shown
    from synth.delivery.acceptance import Acceptance
    from synth.errors import ExportError
    from synth.regulators.sequential import controller_of

    if not isinstance(acceptance, Acceptance):
        raise ExportError(f"acceptance is {shown(acceptance)}; pass what accept returned, or None")
    if acceptance.controller_sha256 != controller_of(design).digest():
        raise ExportError("acceptance is of another controller: the sha256 differs; pass accept of this one")
    proved = (f"; {name}: certificate sha256 {c.sha256}. {c.statement}" for name, c in acceptance.certificates.items())
    return acceptance.verdict + "".join(proved)


def _proved(design: Any, certificate: Any) -> str:
    """What a certificate of this design proves, with its sha256, if it does."""
    from synth.checks import shown
    from synth.errors import ExportError
    from synth.proof.certify import Certificate
    from synth.synthesis.design import Design

    if not isinstance(certificate, Certificate):
        raise ExportError(f"certificate is {shown(certificate)}; pass what certify returned, or None")
    if not isinstance(design, Design):
        raise ExportError("certificate is of a design, and the controller comes without one; export the design")
    parts = (("plant", design.plant.system), ("controller", design.closing))
    for name, system in parts:
        if getattr(certificate, f"{name}_sha256") != system.digest():
            raise ExportError(f"certificate is of another {name}: the sha256 differs; certify this design")
    certificate.check(design.plant, design.closing)
    return f"sha256 {certificate.sha256}. {certificate.statement}"


def _documents(design: Any, format: str, name: str, accepted: str, proved: str, **options: Any) -> dict[str, bytes]:
    """The design, or a controller without a plant or with limits, as data."""
    from synth.delivery import matlab, plain
    from synth.synthesis.design import Design, json_bytes

    limited = None if all(value is None for value in options.values()) else _limited(design, **options)
    if limited is not None or not isinstance(design, Design):
        write = plain.json_bytes if format == "json" else plain.mat_bytes
        content = write(design, limited, accepted if isinstance(design, Design) else "", proved)
    elif format == "json":
        content = json_bytes(design, proved)
    else:
        content = matlab.mat_bytes(design, accepted, proved)
    return {f"{name}.{format}": content}


def _limited(design: Any, **options: Any) -> AntiWindup:
    """The controller with the limits that it gets on its way out, checked as those of the C code."""
    from synth.regulators.antiwindup import AntiWindup
    from synth.regulators.sequential import SequentialController, controller_of

    K, made = controller_of(design), SequentialController.of(design, allow_unstable=True, **options)
    return AntiWindup(K.A, K.B, K.C, K.D, made.L, made.umin, made.umax, K.dt)


def _code(
    design: Any, format: str, name: str, self_test: bool, words: tuple[str, str], inputs: Any, options: dict[str, Any]
) -> dict[str, bytes]:
    """The C files, or the FMU made of them; `words` are those of the gate and of the certificate."""
    from synth.checks import check_period
    from synth.delivery.c import c_files
    from synth.delivery.origin import origin_of
    from synth.delivery.rounding import told
    from synth.regulators import fixed
    from synth.regulators.sequential import SequentialController

    if isinstance(options["dtype"], str) and options["dtype"] in fixed.FORMATS:
        return _fixed(design, format, name, self_test, words, inputs, options)
    controller = SequentialController.of(design, **options)
    check_period("the controller", controller.dt)
    accepted, proved = words
    origin = origin_of(design, controller, accepted, told(design, controller, inputs), proved)
    if format == "c":
        return c_files(controller, origin, name, self_test=self_test)
    from synth.delivery.fmu import Code, fmu_bytes, lagging

    origin = lagging(origin, controller.dt)
    return {f"{name}.fmu": fmu_bytes(Code.of(controller, origin, name), origin, name, version=int(format[-1]))}


def _fixed(
    design: Any, format: str, name: str, self_test: bool, words: tuple[str, str], inputs: Any, options: dict[str, Any]
) -> dict[str, bytes]:
    """The C files in whole numbers."""
    from synth.checks import check_period
    from synth.delivery.cfixed import fixed_c_files
    from synth.delivery.origin import origin_of
    from synth.delivery.rounding import bounds, of_fixed
    from synth.errors import ExportError
    from synth.regulators.fixed import FixedController
    from synth.regulators.sequential import controller_of

    if format != "c" or inputs is None or options["antiwindup"] is not None:
        raise ExportError(
            f"dtype is {options['dtype']!r}, which is for format 'c', needs inputs, the bounds by which it is scaled, "
            "and has no antiwindup"
        )
    Y = bounds("inputs", inputs, controller_of(design).nu)
    controller = FixedController.of(design, options["dtype"], Y, umin=options["umin"], umax=options["umax"])
    check_period("the controller", controller.dt)
    limited = _limited(design, umin=options["umin"], umax=options["umax"])  # in their units, for the facts
    accepted, proved = words
    origin = origin_of(design, limited, accepted, str(of_fixed(controller, Y)), proved)
    return fixed_c_files(controller, origin, name, self_test=self_test)
