"""A predictive controller as C99: its program as constants, a small active-set solver, and all that it remembers.

    status = NAME_step(&state, y, r, u)

No allocation, no recursion, loops of fixed bounds. The solver in the folder `mpc` is ours, from the published
algorithm. What leaves is checked by the residuals of the optimality conditions, as `synth.predictive.optimality` does
it and to the same accuracy; what is known less well leaves as rough. Where it is not known at all, and where a
measurement is no number, the last command is held. The status tells which. The other routes of Python (Clarabel, long
arithmetic) do not leave.
"""

from __future__ import annotations

import textwrap
from importlib import resources

import numpy as np
import scipy.linalg as sla

from synth.delivery.c import ARITHMETIC, WIDTH, comment, compared, function, hashing, initializer, loop, table, told
from synth.delivery.origin import Origin
from synth.errors import ExportError, NumericalError
from synth.predictive.horizon import Mpc

HELD = (
    "Where a measurement, a reference or a state is not finite, or overflows, the step returns {N}_BAD_DATA; where the "
    "optimum was not found within {N}_ITERATIONS exchanges of rows, or is not known to 1e-4, {N}_UNSOLVED. In both "
    "cases u is the last command again, within its limits, and counts as commanded. After bad data the forecast starts "
    "anew with the next sample. Momentum that is not finite stays so, and every sample is bad, until it is written or "
    "the controller is reset. A command that is not known to 1e-8 of its larger limit, but to 1e-4, leaves with "
    "{N}_ROUGH. Needs IEEE arithmetic with NaN: no -ffast-math."
)
PACKAGE = resources.files("synth.delivery") / "mpc"
PARTS = ("factors.c", "activeset.c", "step.c")
SAMPLES = 24  # of the stored trace
AGREES = 1e-9  # of the trace, in units of each command's larger limit
EXCHANGES = 4  # of rows, allowed for each variable and row


def mpc_files(controller: Mpc, origin: Origin, name: str, *, self_test: bool = True) -> dict[str, bytes]:
    """The header ``name.h`` and the source ``name.c``.

    Raises
    ------
    ExportError : the self test's trace cannot be flown.
    """
    files = {f"{name}.h": header(controller, origin, name, self_test), f"{name}.c": source(controller, name, self_test)}
    return {file: text.encode() for file, text in files.items()}


def program(controller: Mpc) -> dict[str, np.ndarray]:
    """The constants of the C code; parameters that no entry depends on stay, those of another form do not.

    A program without rows gets one that always holds, 0 v <= 1.
    """
    p, qp = controller.problem, controller.qp
    N = len(qp.P)
    slope, A, b = qp.slope, qp.A, qp.offset[2 * N :]
    if p.form == "position":
        slope = np.delete(slope, np.r_[p.parameters["d"]], axis=1)
    b_slope = slope[2 * N :]
    if not len(A):
        A, b, b_slope = np.zeros((1, N)), np.ones(1), np.zeros((1, slope.shape[1]))
    root = sla.solve_triangular(np.linalg.cholesky(qp.P), np.eye(N), lower=True).T
    lengths = np.concatenate([np.linalg.norm(root, axis=1), np.linalg.norm(A @ root, axis=1)])
    found = {"P": qp.P, "A": A, "root": root, "f_offset": qp.offset[:N], "f_slope": slope[:N], "b_offset": b}
    found |= {"b_slope": b_slope, "lower": qp.lower[:N], "upper": qp.offset[N : 2 * N], "length": lengths}
    found |= {"unit": p.unit, "umin": p.umin, "umax": p.umax}
    if p.form == "velocity":
        found |= {"plant_A": p.model.A, "plant_B": p.model.B}
    return {key: np.ascontiguousarray(value, dtype=float) for key, value in found.items()}


def sizes(controller: Mpc) -> dict[str, int]:
    """The sizes that the header names."""
    p, N = controller.problem, len(controller.qp.P)
    rows = max(len(controller.qp.A), 1)
    columns = p.parameters["inputs"].stop - (p.model.n if p.form == "position" else 0)
    return {
        "STATES": p.model.n, "OUTPUTS": p.model.nu, "DELAY": p.delay, "MEMORY": max(p.delay, 1),
        "VELOCITY": int(p.form == "velocity"), "PARAMETERS": columns, "VARIABLES": N, "ROWS": rows,
        "ITERATIONS": EXCHANGES * (N + rows),
    }  # fmt: skip


def header(controller: Mpc, origin: Origin, name: str, self_test: bool) -> str:
    """The interface: sizes as macros, the state, its functions, and where all this comes from."""
    N = name.upper()
    said = {"STATES": "measured", "OUTPUTS": "commands", "DELAY": "samples from a command to its action",
            "MEMORY": "commands remembered", "VELOCITY": "1 for the velocity form, 0 for the position form",
            "PARAMETERS": "of the program", "VARIABLES": "of the program", "ROWS": "of the program",
            "ITERATIONS": "exchanges of rows at most, in one step"}  # fmt: skip
    macros = [f"#define {N}_{key} {value} /* {said[key]} */" for key, value in sizes(controller).items()]
    macros.append(f"#define {N}_SAMPLE_TIME {float(controller.dt)!r} /* s */")
    own = [(f"double inputs[{N}_MEMORY][{N}_OUTPUTS]", "last commands, the newest at the end"),
           (f"double momentum[{N}_OUTPUTS]", "of the actuators; write it before a step if it is measured")]  # fmt: skip
    if controller.problem.form == "velocity":
        own += [(f"double forecast[{N}_STATES]", "of the next measurement"), ("int known", "whether there is one")]
    own += [
        ("int size", "of the working set: rows at their limits, where the next step starts"),
        (f"int row[{N}_VARIABLES]", ""), (f"double sign[{N}_VARIABLES]", ""),
        ("int iterations", "exchanges of rows in the last step"),
        ("double error", "bound of |u - optimum|, in units of each command's larger limit, as last computed"),
        ("int allowed", "this and what follows: workspace"),
        (f"unsigned char taken[{N}_VARIABLES + {N}_ROWS]", ""),
        *((f"double {key}[{N}_VARIABLES]", "") for key in "vyf"), *((f"double {key}[{N}_ROWS]", "") for key in "bw"),
        *((f"double {key}[{N}_VARIABLES][{N}_VARIABLES]", "") for key in "JR"),
    ]  # fmt: skip
    members = "\n".join(f"    {what};{f' /* {why} */' if why else ''}" for what, why in own)
    state = f"""\
enum {{ {N}_SOLVED, {N}_BAD_DATA, {N}_UNSOLVED, {N}_ROUGH }}; /* what the step returns */

typedef struct {{
{members}
}} {name}_state;

/* At rest: no command given, no momentum stored. */
void {name}_reset({name}_state *state);

/* One sample: reads the state y and the state r to go to, writes the command u, which is always within its limits.
 * Returns {N}_SOLVED if u is optimal and passed the check. */
int {name}_step({name}_state *state, const double y[{N}_STATES], const double r[{N}_STATES],
{" " * (len(name) + 10)}double u[{N}_OUTPUTS]);
"""
    tested = f"""\
#ifdef {N}_SELF_TEST
/* Replays a stored flight of the linear plant: 0 if every command agrees to {AGREES:g} of its larger limit (and
 * what its own check leaves open), else the
 * number of the first sample that differs. The last samples are not numbers, and must be refused; the number after
 * them is that of the constants, whose hash differs. */
int {name}_self_test(void);
#endif
"""
    parts = [_title(controller, origin, name), f"#ifndef {N}_H\n#define {N}_H\n", "\n".join([*macros, ""])]
    parts += ['#ifdef __cplusplus\nextern "C" {\n#endif\n', state, *([tested] if self_test else [])]
    return "\n".join([*parts, "#ifdef __cplusplus\n}\n#endif\n", "#endif\n"])


def _title(controller: Mpc, origin: Origin, name: str) -> str:
    """The comment at the top of the header."""
    p, N = controller.problem, name.upper()
    lines = [f"{name}: {about(controller)}", ""]
    for i, signal in enumerate(origin.inputs[: p.model.n]):
        low, high = float(p.ymin[i]), float(p.ymax[i])
        lines.append(
            f"y[{i}], r[{i}]  {signal}" + (f"  soft in [{low!r}, {high!r}]" if np.isfinite([low, high]).any() else "")
        )
    lines.append("")
    for i, signal in enumerate(origin.outputs):
        stored = f"  |momentum| soft within {float(p.hmax[i])!r}" if np.isfinite(p.hmax[i]) else ""
        lines.append(f"u[{i}]  {signal}  in [{float(p.umin[i])!r}, {float(p.umax[i])!r}]{stored}")
    lines += ["", *told(origin), "", f"Use, once every {N}_SAMPLE_TIME seconds:", ""]
    lines += [f"    static {name}_state state;", f"    {name}_reset(&state);      once, before the first sample"]
    lines += [f"    status = {name}_step(&state, y, r, u);", ""]
    return comment([*lines, *textwrap.wrap(held(name), WIDTH)])


def about(controller: Mpc) -> str:
    """The controller in a line."""
    p = controller.problem
    return (
        f"model predictive controller, {p.form} form, horizons Np = {p.Np} and Nc = {p.Nc}, sample time "
        f"{float(controller.dt)!r} s"
    )


def held(name: str) -> str:
    """What happens where there is no command."""
    return HELD.format(N=name.upper())


def source(controller: Mpc, name: str, self_test: bool) -> str:
    """The implementation: the program, the solver, the step, and the trace of the self test."""
    N, constants = name.upper(), program(controller)
    includes = [f'#include "{name}.h"\n', "#include <math.h>\n#include <string.h>\n"]
    if self_test:
        includes.append(f"#ifdef {N}_SELF_TEST\n#include <stdint.h>\n#endif\n")
    tables = []
    for key, M in constants.items():
        size = "".join(f"[{k}]" for k in M.shape)
        values = f"{{\n{table(M)}\n}}" if M.ndim == 2 else initializer(M)
        tables.append(f"static const double {key}{size} = {values};\n")
    code = [(PACKAGE / part).read_text(encoding="utf-8") for part in PARTS]
    own = [part.replace("MPC_", f"{N}_").replace("mpc_", f"{name}_") for part in code]
    parts = [*includes, ARITHMETIC, *tables, *own]
    return "\n".join(parts + ([_self_test(controller, name, constants)] if self_test else []))


def _self_test(controller: Mpc, name: str, constants: dict[str, np.ndarray]) -> str:
    """The stored flight and the function that replays it."""
    N = name.upper()
    y, u = flown(controller)
    differs = f"!(fabs(u[i] - trace_u[{{}}][i]) <= ({AGREES!r} + {{}}) * unit[i])"
    body = [
        "static const double strange[3] = { NAN, INFINITY, -INFINITY };",
        f"static {name}_state state;",
        f"double y[{N}_STATES], r[{N}_STATES], u[{N}_OUTPUTS];", "uint32_t hash = 2166136261u;", "",
        f"{name}_reset(&state);", "memset(r, 0, sizeof r);",
        *loop("k", str(SAMPLES), [
            f"const int status = {name}_step(&state, trace_y[k], r, u);",
            f"if (status != {N}_SOLVED && status != {N}_ROUGH) {{", "    return k + 1;", "}",
            *loop("i", f"{N}_OUTPUTS", [f"if ({differs.format('k', 'state.error')}) {{", "    return k + 1;", "}"]),
            f"memcpy(state.inputs[{N}_MEMORY - 1], trace_u[k], sizeof u); /* its plant was driven by that */",
        ]),
        "memcpy(y, trace_y[0], sizeof y);",
        *loop("k", "3", [
            f"y[k % {N}_STATES] = strange[k];",
            f"if ({name}_step(&state, y, r, u) != {N}_BAD_DATA) {{", f"    return {SAMPLES} + k + 1;", "}",
            *loop("i", f"{N}_OUTPUTS", [
                f"if ({differs.format(SAMPLES - 1, 'state.error')}) {{", f"    return {SAMPLES} + k + 1;", "}",
            ]),
        ]),
        *compared(constants, SAMPLES + 4),
        "return 0;",
    ]  # fmt: skip
    tables = [
        f"static const double trace_{key}[{SAMPLES}][{N}_{size}] = {{\n{table(M)}\n}};\n"
        for key, M, size in (("y", y, "STATES"), ("u", u, "OUTPUTS"))
    ]
    return "\n".join(
        [
            f"#ifdef {N}_SELF_TEST",
            *tables,
            hashing("double", "uint64_t"),
            f"{function(f'int {name}_self_test(void)', body)}#endif\n",
        ]
    )


def flown(controller: Mpc) -> tuple[np.ndarray, np.ndarray]:
    """States (SAMPLES, n) and commands (SAMPLES, m) of the linear plant on its way to rest, with a disturbance.

    It starts where full commands take it, so that limits are active; nearer to rest where the way cannot be flown.

    Raises
    ------
    ExportError : it cannot be flown at all.
    """
    p = controller.problem
    A, B, m = p.model.A, p.model.B, p.model.nu
    pattern = np.where((5 * np.arange(1, SAMPLES + p.Np + 1)[:, None] ** 2 * (np.arange(m) + 2)) % 31 < 16, 1.0, -1.0)
    start = np.zeros(p.model.n)
    for _ in range(p.Np):
        start = A @ start + B @ (p.unit * np.where(np.arange(m) % 2, -1.0, 1.0))
    for size in 2.0 ** -np.arange(0, 40, 4):
        x, state, X, U, acting = size * start, controller.init(), [], [], [np.zeros(m)] * p.delay
        try:
            for k in range(SAMPLES):
                state, u = controller.step(state, x, np.zeros(p.model.n))
                X.append(x)
                U.append(u)
                acting.append(u)
                x = A @ x + B @ (acting[k] + 0.05 * size * p.unit * pattern[k])
        except NumericalError:
            continue
        if state.fallbacks == 0:
            return np.array(X), np.array(U)
    raise ExportError("no flight for the self test's trace ends without a fallback; pass self_test=False")
