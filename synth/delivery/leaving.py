"""Which controller leaves in which format, and what to do where one cannot: the one table for `export`.

Classes stand here by their names, so that none is imported for it; those of `plants` too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from synth.errors import ExportError

ALL = ("json", "mat", "c", "fmu2", "fmu3")
STEPS = ("init", "step")


class Row(NamedTuple):
    """What leaves of a class, and the answer for the other formats."""

    formats: tuple[str, ...]
    why: str
    remedy: str


SDRE = Row(
    ("c",),
    "its gain is that of a Riccati equation in every sample, which these files, of matrices A, B, C, D, cannot hold",
    "pass format 'c', whose header and self test say what Python does",
)
MATRICES = "it is no linear controller with matrices A, B, C, D"
TABLE = {
    "synth.regulators.controller.LinearController": Row(ALL, "", ""),
    "synth.regulators.antiwindup.AntiWindup": Row(ALL, "", ""),
    "synth.regulators.sequential.SequentialController": Row(
        (),
        "it is the twin of an exported controller, without what it was made of",
        "pass the design or controller that it was made of, with the same dtype, umin, umax and antiwindup",
    ),
    "synth.regulators.fixed.FixedController": Row(
        (),
        "it is the twin of an exported controller, without what it was made of",
        "pass the design or controller that it was made of, format 'c', the same dtype ('q15' or 'q31') and inputs",
    ),
    "synth.regulators.quaternion.QuaternionPid": Row(
        (),
        f"{MATRICES}: it takes the sign of q0, and its integral stands still outside a zone",
        "write its step by hand, u = -(Kp s qv + Ki z + Kd w), from the fields Kp, Ki, Kd, zone and dt; or export "
        "quaternion_lqr without short_way, which is linear",
    ),
    "synth.regulators.sdre.Sdre": SDRE,
    "synth.regulators.sdre.SdreSampled": SDRE,
    "synth.regulators.sdre.SdreHinfStatic": SDRE,
    "synth.regulators.sdre.SdreHinf": Row(
        (),
        "its observer is a state in which the difference from Python adds up, for which there is no bound yet",
        "export SdreHinfStatic, the same law without its observer, as C; or the linear controller of ncfsyn",
    ),
    "synth.regulators.sdre.SdreHinfPaperLiteral": Row(
        (),
        "it reproduces published results and is no robust controller; it is for comparisons only",
        "export SdreHinfStatic, or Sdre, as C",
    ),
    "synth.predictive.horizon.Mpc": Row(ALL, "", ""),
    "synth.predictive.fuel.FuelMpc": Row(
        (),
        f"{MATRICES}: it solves a linear program by HiGHS, anew from the sample number and its known forecast, and "
        "there is no C of that",
        "step it in Python and store its commands as a time table, or pose the task as mpc(...), which leaves",
    ),
    "plants.missions.geo.Coast": Row((), f"{MATRICES}", "export the gain 0, StateSpace.gain(zeros, dt)"),
    "plants.guidance.laws.AttitudeControl": Row(
        (),
        f"{MATRICES}: it hands a controller the attitude error and adds the dumping of momentum",
        "export its field controller; the dipole of its dumping is one line, see CrossProductDumping",
    ),
    "plants.guidance.laws.Detumbling": Row(
        (),
        f"{MATRICES}: it divides by the square of the field",
        "write its step by hand: dipole = -gain dB/dt / |B|^2 within its limit",
    ),
    "plants.guidance.sequences.SequenceController": Row(
        (),
        f"{MATRICES}: it changes its law with the mode that the navigator tells",
        "export the controller of each mode by itself, and write the changes of mode by hand",
    ),
}
OWN = Row(
    (),
    "it is a controller of your own, whose step is Python; nothing but its numbers could be written",
    "write its step in C by hand and replay a Run's y and u with it; or export what is linear near the target: a "
    "LinearController, state_feedback, a StateSpace (A, B, C, D, dt)",
)
PYTHON = (
    "this is a program; `synth export` reads designs and linear controllers (.json, .mat). A controller that lives in "
    "Python, such as Sdre, leaves from there: synth.export(controller, 'c', folder)"
)
OVERRIDDEN = Row((), "its class has a step of its own on top of one that leaves", OWN.remedy)


def row_of(controller: Any) -> Row | None:
    """The row of a controller's class; None for what is no controller with a step, such as designs and systems."""
    kind = type(controller)
    for base in kind.__mro__:
        row = TABLE.get(f"{base.__module__}.{base.__qualname__}")
        if row is not None:
            return row if all(getattr(kind, name) is getattr(base, name) for name in STEPS) else OVERRIDDEN
    stepped = all(callable(getattr(controller, name, None)) for name in STEPS)
    return OWN if stepped and not all(hasattr(controller, name) for name in "ABCD") else None  # else a linear system


def check_leaves(controller: Any, format: str) -> None:
    """Raise for a controller that cannot leave in this format.

    Raises
    ------
    ExportError : it cannot; says why and what to do instead.
    """
    row = row_of(controller)
    if row is not None and format not in row.formats:
        raise ExportError(f"{type(controller).__name__} does not leave as {format}: {row.why}; {row.remedy}")


def is_sdre(controller: Any) -> bool:
    """Whether it leaves through `synth.delivery.csdre`."""
    return row_of(controller) is SDRE
