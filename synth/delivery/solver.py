"""A model predictive controller's quadratic program as C, by CVXPYgen and QOCOGEN: generated, without allocation.

    NAME_solve(phi, u)      phi: the measured data, laid out as in the JSON file of `save_mpc`; u: the command

The program is the canonical one of `synth.delivery.qp`, so the JSON file beside the code describes it completely. What
the controller remembers from sample to sample (forecast, past commands, momentum) is a few lines on the caller's side,
see `Mpc.step`. CVXPYgen is optional and only generates; the licences of what it writes are beside the code. QOCOGEN
is an interior-point method: on the CubeSat's program about ten iterations, within 1e-5 of the limits of the command
that DAQP finds; OSQP, which CVXPYgen offers too, needs tolerances of 1e-11 for that.

References: Schaller et al. (2022), IEEE Control Systems Letters 6, 2653; Chari and Acikmese (2025), QOCO: A
Quadratic Objective Conic Optimizer with Custom Solver Generation, arXiv 2503.12658.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import tempfile
from pathlib import Path

import cvxpy as cp
import numpy as np

from synth.delivery.files import check_name, write_all
from synth.delivery.qp import FREE, document, jsonable
from synth.errors import ExportError
from synth.predictive.horizon import Mpc

TOLERANCE = 1e-8  # absolute and relative, of QOCO; with ten times smaller ones it fails on some states
SCALE = 1e4  # of the objective, whose curvature is small against the tolerance where commands hardly matter
SOLVED = 1  # QOCO's status
KEPT = ("src/cpg_[sw]*.c", "include/*.h", "solver_code/*.[ch]")  # of the generated folder c
EXAMPLE = "runtest.c"  # a main function of QOCOGEN


def export_mpc(
    controller: Mpc, folder: str | os.PathLike[str], *, name: str = "mpc", force: bool = False
) -> tuple[Path, ...]:
    """Write ``name.json``, ``name.h``, ``name.c`` and the solver's sources into `folder`; all of them or none.

    Compile ``name.c`` with the sources in ``src``, the headers in ``include`` and the mathematics library.

    Raises
    ------
    ExportError : CVXPYgen is not installed, the name is no C identifier, or a file exists and `force` is not set.
    """
    check_name(name)
    try:
        from cvxpygen import cpg  # pyright: ignore[reportMissingImports]
    except ImportError as error:
        raise ExportError(
            f"C code of a predictive controller needs CVXPYgen ({error}): pip install cvxpygen, or save the program as "
            "JSON with save_mpc and solve it with a solver of your own"
        ) from None
    files = {f"{name}.json": json.dumps(jsonable(document(controller)), indent=1, allow_nan=False).encode()}
    with tempfile.TemporaryDirectory() as place:
        with contextlib.redirect_stdout(io.StringIO()):
            cpg.generate_code(_problem(controller), code_dir=place, solver="QOCOGEN", wrapper=False)
        code = Path(place) / "c"
        for path in (path for pattern in KEPT for path in sorted(code.glob(pattern)) if path.name != EXAMPLE):
            files[f"{'src' if path.suffix == '.c' else 'include'}/{path.name}"] = path.read_bytes()
        files["LICENSE-cvxpygen.txt"] = (Path(place) / "LICENSE").read_bytes()
        files["LICENSE-qoco.txt"] = (code / "solver_code" / "LICENSE").read_bytes()
    return write_all(folder, files | _wrapper(controller, name), force=force)


def _problem(controller: Mpc) -> cp.Problem:
    """The canonical program: minimise v'P v/2 + f'v subject to lower <= [v; A v] <= upper."""
    qp, N = controller.qp, len(controller.qp.P)
    v, phi = cp.Variable(N, name="v"), cp.Parameter(qp.slope.shape[1], name="phi")
    rows = np.vstack([np.eye(N), qp.A])
    below, above = np.abs(qp.lower) < FREE, np.abs(qp.offset[N:]) < FREE
    objective = cp.quad_form(v, cp.psd_wrap(qp.P)) / 2 + qp.offset[:N] @ v
    if qp.slope[:N].any():
        objective += (qp.slope[:N] @ phi) @ v
    constraints = [
        rows[above] @ v <= qp.offset[N:][above] + qp.slope[N:][above] @ phi,
        rows[below] @ v >= qp.lower[below],
    ]
    return cp.Problem(cp.Minimize(SCALE * objective), constraints)


def _wrapper(controller: Mpc, name: str) -> dict[str, bytes]:
    """The header and the function that a sampled loop calls."""
    N, unit = name.upper(), controller.problem.unit
    where = controller.problem.parameters
    layout = "\n".join(f" *   phi[{s.start}..{s.stop - 1}]  {key}" for key, s in where.items())
    header = f"""\
/*
 * {name}: the quadratic program of a predictive controller, sample time {controller.dt!r} s
 *
{layout}
 *
 * plant model  sha256 {controller.problem.model.digest()}
 * The program, its settings and the versions that made it are in {name}.json.
 */
#ifndef {N}_H
#define {N}_H

#define {N}_PARAMETERS {where["inputs"].stop}
#define {N}_OUTPUTS {len(unit)}

/* The command u from the measured data phi; 0 if QOCO solved the program. Else 1, and u is left as it was: keep the
 * last command in it. So it is where phi or the solution is not finite; compile without -ffast-math. */
int {name}_solve(const double phi[{N}_PARAMETERS], double u[{N}_OUTPUTS]);

#endif
"""
    source = f"""\
#include "{name}.h"

#include <math.h>

#include "cpg_solve.h"
#include "cpg_workspace.h"

static const double unit[{N}_OUTPUTS] = {{ {", ".join(repr(float(value)) for value in unit)} }};

int {name}_solve(const double phi[{N}_PARAMETERS], double u[{N}_OUTPUTS])
{{
    cpg_set_solver_default_settings();
    cpg_set_solver_abstol({TOLERANCE});
    cpg_set_solver_reltol({TOLERANCE});
    for (int i = 0; i < {N}_PARAMETERS; ++i) {{
        if (!isfinite(phi[i])) {{
            return 1;
        }}
        cpg_update_phi(i, phi[i]);
    }}
    cpg_solve();
    if (CPG_Result.info->status != {SOLVED}) {{
        return 1;
    }}
    for (int i = 0; i < {N}_OUTPUTS; ++i) {{
        if (!isfinite(CPG_Result.prim->v[i])) {{
            return 1;
        }}
    }}
    for (int i = 0; i < {N}_OUTPUTS; ++i) {{
        u[i] = unit[i] * CPG_Result.prim->v[i];
    }}
    return 0;
}}
"""
    return {f"{name}.h": header.encode(), f"{name}.c": source.encode()}
