"""How a predictive controller leaves: as data, as C, as a co-simulation unit; and which ones cannot, and why.

export(mpc(G, ...), "c", "out", name="attitude")
"""

from __future__ import annotations

from importlib import metadata
from typing import Any

import numpy as np

from synth.delivery import qp
from synth.delivery.cmpc import about, held, mpc_files, program, sizes
from synth.delivery.origin import Origin, Signal, checked
from synth.errors import ExportError
from synth.predictive.horizon import Mpc
from synth.predictive.prestabilised import STIFF

OF_LINEAR = {  # options of `export` that are for linear controllers: name -> (value when left away, what to do instead)
    "umin": (None, "its limits are in its program: pose it with mpc(..., umin=...)"),
    "umax": (None, "its limits are in its program: pose it with mpc(..., umax=...)"),
    "antiwindup": (None, "it knows its limits, and needs no anti-windup; leave it away"),
    "inputs": (None, "the bound of rounding is proved for linear laws; here every command is checked; leave it away"),
    "acceptance": (None, "accept judges linear controllers; fly this one in a simulation instead"),
    "certificate": (None, "certificates are of linear loops; leave it away"),
    "dtype": ("double", "in other numbers than doubles its optimum is not known well enough to pass the check"),
}


def files(controller: Any, format: str, name: str, *, self_test: bool, **options: Any) -> dict[str, bytes]:
    """The files of `export` for a controller of `synth.predictive`: name -> content.

    Raises
    ------
    ExportError : it is no controller, an option is for linear controllers, or there is no C compiler for an
        FMU.
    """
    if not isinstance(controller, Mpc):
        raise ExportError(f"a {type(controller).__name__} is no controller; pass what mpc returned")
    for option, (default, instead) in OF_LINEAR.items():
        given = options[option]
        if not (given is default or (isinstance(default, str) and isinstance(given, str) and given == default)):
            raise ExportError(f"{option}: of a predictive controller there is none; {instead}")
    if format in ("json", "mat"):
        return {f"{name}.{format}": (qp.json_bytes if format == "json" else qp.mat_bytes)(controller)}
    origin = origin_of(controller)
    if format == "c":
        return mpc_files(controller, origin, name, self_test=self_test)
    from synth.delivery.fmu import Code, fmu_bytes, lagging

    p, N = controller.problem, name.upper()
    planned = f"it is {'the' if p.delay == 1 else 'one'} sampling time of delay that the controller plans for"
    origin = lagging(
        origin, controller.dt, planned if p.delay else "mpc(..., delay=1) makes a controller that plans for it"
    )
    code = Code(
        files=mpc_files(controller, origin, name, self_test=False),
        about=about(controller), held=held(name),
        dt=controller.dt, dtype="double", umin=p.umin, umax=p.umax,
        joined=f"""\
#define MODEL_INPUTS (2 * {N}_STATES) /* y, then r */
#define MODEL_STEP(state, y, u) {name}_step(state, y, (y) + {N}_STATES, u)
#define MODEL_COMMAND(state) (state).inputs[{N}_MEMORY - 1]
#define MODEL_HELD "no command passed the check, or a number is not finite: it is rough, or the last one is held"
""",
    )  # fmt: skip
    return {f"{name}.fmu": fmu_bytes(code, origin, name, version=int(format[-1]))}


def origin_of(controller: Mpc) -> Origin:
    """The facts of a predictive controller, and its signals: y, then r, and u.

    Raises
    ------
    ExportError : a name or a unit has characters that would break an exported file.
    """
    p, size = controller.problem, sizes(controller)
    unit = p.model.units
    y = tuple(Signal(s, unit.get(s, "")) for s in p.model.y)
    r = tuple(Signal(f"reference {s}", unit.get(s, "")) for s in p.model.y)
    u = tuple(Signal(s, unit.get(s, "")) for s in p.model.u)
    bytes_of = {"constants": sum(M.nbytes for M in program(controller).values()), "state": state_bytes(size)}
    facts = qp.conventions(controller) | {
        "momentum": "summed up from the commands as they act, h+ = h - dt u, from zero on",
        "plant": f"order {p.model.n}, sha256 {p.model.digest()}",
        "program": f"{size['VARIABLES']} variables, {size['ROWS']} rows beside their limits; "
        + ", ".join(f"{-(-value // 1024)} KiB of {key}" for key, value in bytes_of.items()),
        "solver": "dual active-set method of Goldfarb and Idnani, started from the rows active at the last sample; at "
        f"most {size['ITERATIONS']} exchanges of rows a sample, no allocation",
        "check": "residuals of the optimality conditions: what is called solved is within 1e-8 of the optimum, in "
        "units of each command's larger limit",
        **_stiff(controller),
        "fallback": "a command that is known to 1e-4 all the same, else the last command again, within its limits; the "
        "status says so",
        "exported by": f"convex-synth {metadata.version('convex-synth')}",
    }
    return checked(Origin(facts, (*y, *r), u))


def _stiff(controller: Mpc) -> dict[str, str]:
    """What does not leave of a program whose penalty drowns the rest: Python goes on in long arithmetic."""
    heaviest = float(np.diag(controller.qp.P).max())
    if heaviest <= STIFF:
        return {}
    return {
        "soft limits": f"their penalty is {heaviest:.0e} times the weight of a command: where one cannot be kept, "
        "doubles may not know the optimum, and then the last command is held, while Python goes on in long "
        "arithmetic; a shorter horizon or a smaller penalty avoids that"
    }


def state_bytes(size: dict[str, int]) -> int:
    """How large the state is in C, workspace included, about."""
    N, M = size["VARIABLES"], size["ROWS"]
    remembered = size["OUTPUTS"] * (size["MEMORY"] + 1) + size["STATES"] * size["VELOCITY"]
    return 8 * (2 * N * N + 4 * N + 2 * M + remembered) + 5 * N + M
