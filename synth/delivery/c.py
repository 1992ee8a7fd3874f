"""A controller as C99: one header, one source, fixed sizes, no allocation, and a self test that compares bits.

The arithmetic is that of `synth.regulators.sequential`: loops over the matrices, one rounded product after another.
With ``-std=c99`` (or ``-ffp-contract=off``) and IEEE arithmetic the same bits come out on every processor; the self
test, compiled in with ``-DNAME_SELF_TEST``, says whether they do on yours.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from synth.delivery.origin import Origin, Signal
from synth.errors import ExportError
from synth.regulators.sequential import SequentialController

SAMPLES = 32  # of the stored trace
WIDTH = 100  # of comments


def c_files(controller: SequentialController, origin: Origin, name: str, *, self_test: bool = True) -> dict[str, bytes]:
    """The header ``name.h`` and the source ``name.c``."""
    texts = {f"{name}.h": header(controller, origin, name, self_test), f"{name}.c": source(controller, name, self_test)}
    return {file: text.encode() for file, text in texts.items()}


def header(controller: SequentialController, origin: Origin, name: str, self_test: bool) -> str:
    """The interface: sizes and sample time as macros, the state, its functions, and where all this comes from."""
    N, real, n = name.upper(), controller.dtype, len(controller.A)
    state = f"{name}_state *state, " if n else ""
    parts = [_title(controller, origin, name), f"#ifndef {N}_H\n#define {N}_H\n"]
    sizes = [f"#define {N}_STATES  {n}"] if n else []
    sizes += [f"#define {N}_INPUTS  {controller.D.shape[1]}", f"#define {N}_OUTPUTS {controller.D.shape[0]}"]
    parts.append(
        "\n".join([*sizes, f"#define {N}_SAMPLE_TIME {_number(controller.A.dtype.type(controller.dt))} /* s */\n"])
    )
    parts.append('#ifdef __cplusplus\nextern "C" {\n#endif\n')
    if n:
        parts.append(f"typedef struct {{\n    {real} x[{N}_STATES];\n}} {name}_state;\n")
        parts.append(f"/* Sets the states to zero. */\nvoid {name}_reset({name}_state *state);\n")
    parts.append(
        "/* One sample: reads the inputs y, writes the outputs u. The two must not overlap. */\n"
        f"void {name}_step({state}const {real} y[{N}_INPUTS], {real} u[{N}_OUTPUTS]);\n"
    )
    if self_test:
        parts.append(
            f"#ifdef {N}_SELF_TEST\n"
            "/* Replays a stored trace: 0 if every bit agrees, else the number of the first sample that differs. */\n"
            f"int {name}_self_test(void);\n#endif\n"
        )
    return "\n".join([*parts, "#ifdef __cplusplus\n}\n#endif\n", "#endif\n"])


def source(controller: SequentialController, name: str, self_test: bool) -> str:
    """The implementation: matrices, step, and the trace of the self test."""
    N, n = name.upper(), len(controller.A)
    includes = [f'#include "{name}.h"\n']
    if controller.limited and not np.isfinite([controller.umin, controller.umax]).all():
        includes.append("#include <math.h>\n")
    if self_test:
        includes.append(f"#ifdef {N}_SELF_TEST\n#include <string.h>\n#endif\n")
    contract = "#if defined(__clang__)\n#pragma STDC FP_CONTRACT OFF\n#endif\n"
    parts = [*includes, contract, *_matrices(controller, N)]
    if n:
        parts.append(_reset(name, N))
    parts.append(_step(controller, name))
    if self_test:
        parts.append(_self_test(controller, name))
    return "\n".join(parts)


def _title(controller: SequentialController, origin: Origin, name: str) -> str:
    """The comment at the top of the header."""
    n = len(controller.A)
    equations = ["v = C x + D y" if n else "v = D y", "u = min(max(v, umin), umax)" if controller.limited else "u = v"]
    if n:
        equations.append("x+ = A x + B y" + (" + L (u - v)" if controller.conditioned else ""))
    lines = [f"{name}: linear controller, {controller.dtype} precision, sample time {controller.dt!r} s", ""]
    lines += ["    " + ",   ".join(equations), ""]
    lines += [*_signals("y", origin.inputs), "", *_signals("u", origin.outputs, controller), ""]
    for key, text in origin.facts.items():
        lines += textwrap.wrap(text, WIDTH - 14, initial_indent=f"{key:12} ", subsequent_indent=" " * 13)
    lines += ["", f"Use, once every {name.upper()}_SAMPLE_TIME seconds, with finite inputs:", ""]
    lines += (
        [f"    static {name}_state state;", f"    {name}_reset(&state);      once, before the first sample"]
        if n
        else []
    )
    lines += [f"    {name}_step({'&state, ' if n else ''}y, u);"]
    body = "\n".join(f" * {line}".rstrip() for line in lines)
    return f"/*\n{body}\n */\n"


def _signals(symbol: str, signals: Sequence[Signal], controller: SequentialController | None = None) -> list[str]:
    """One line per signal, with its limits if it has some."""
    lines = []
    for i, signal in enumerate(signals):
        line = f"{symbol}[{i}]  {signal}"
        if controller is not None and controller.limited:
            line += f"  in [{controller.umin[i]!s}, {controller.umax[i]!s}]"
        lines.append(line)
    return lines


def _matrices(controller: SequentialController, N: str) -> list[str]:
    """The constants of the step, those that it needs."""
    n, dtype = len(controller.A), controller.dtype
    x, y, u = (f"{N}_{size}" for size in ("STATES", "INPUTS", "OUTPUTS"))
    tables = []
    if n:
        tables += [("A", controller.A, x, x, "x"), ("B", controller.B, x, y, "y")]
        tables += [("C", controller.C, u, x, "x")]
    if _has_direct_term(controller):
        tables.append(("D", controller.D, u, y, "y"))
    if controller.conditioned:
        tables.append(("L", controller.L, x, u, "u"))
    parts = [
        f"{_columns(M, symbol)}\nstatic const {dtype} {key}[{rows}][{columns}] = {{\n{_rows(M)}\n}};\n"
        for key, M, rows, columns, symbol in tables
    ]
    if controller.limited:
        for key, limit in (("umin", controller.umin), ("umax", controller.umax)):
            parts.append(f"static const {dtype} {key}[{u}] = {initializer(limit)};\n")
    return parts


def _has_direct_term(controller: SequentialController) -> bool:
    return not len(controller.A) or bool(controller.D.any())


def initializer(values: np.ndarray) -> str:
    """A vector as C constants in braces."""
    return f"{{ {', '.join(_number(value) for value in values)} }}"


def _number(value: np.floating) -> str:
    """A C constant that reads back to the same bits: the shortest decimal, with F in single precision."""
    if np.isinf(value):
        return "INFINITY" if value > 0 else "-INFINITY"
    return str(value) + "F" if value.dtype == np.float32 else str(value)


def _widths(M: np.ndarray) -> list[int]:
    return [max(len(_number(value)) for value in column) for column in M.T]


def _columns(M: np.ndarray, symbol: str) -> str:
    """A comment over the columns: what each is multiplied by."""
    heads = [f"{symbol}[{j}]".rjust(max(width, 5)) for j, width in enumerate(_widths(M))]
    return f"/*    {'  '.join(heads)} */"


def _rows(M: np.ndarray) -> str:
    """The rows of a matrix, aligned below the comment."""
    widths = [max(width, 5) for width in _widths(M)]
    rows = [", ".join(_number(v).rjust(w) for v, w in zip(row, widths, strict=True)) for row in M]
    return ",\n".join(f"    {{ {row} }}" for row in rows)


def _reset(name: str, N: str) -> str:
    return f"""\
void {name}_reset({name}_state *state)
{{
    for (int i = 0; i < {N}_STATES; ++i) {{
        state->x[i] = 0;
    }}
}}
"""


def _step(controller: SequentialController, name: str) -> str:
    """One sample: outputs first, from the old states; then the states, through a copy."""
    N, n, real = name.upper(), len(controller.A), controller.dtype
    states, inputs, outputs = (f"{N}_{size}" for size in ("STATES", "INPUTS", "OUTPUTS"))
    result = "v" if controller.limited else "u[i]"
    lines = [f"{f'{real} v' if controller.limited else 'u[i]'} = 0;"]
    lines += _add(result, "C", "state->x", states) if n else []
    lines += _add(result, "D", "y", inputs) if _has_direct_term(controller) else []
    if controller.limited:
        lines.append("u[i] = v < umin[i] ? umin[i] : v > umax[i] ? umax[i] : v;")
    if controller.conditioned:
        lines.append("deficit[i] = u[i] - v;")
    body = _loop("i", outputs, lines)
    if n:
        lines = ["next[i] = 0;", *_add("next[i]", "A", "state->x", states), *_add("next[i]", "B", "y", inputs)]
        lines += _add("next[i]", "L", "deficit", outputs) if controller.conditioned else []
        body += _loop("i", states, lines) + _loop("i", states, ["state->x[i] = next[i];"])
        declared = [f"{real} next[{states}];"] + [f"{real} deficit[{outputs}];"] * controller.conditioned
        body = [*declared, "", *body]
    state = f"{name}_state *state, " if n else ""
    code = textwrap.indent("\n".join(body), "    ")
    return f"void {name}_step({state}const {real} y[{inputs}], {real} u[{outputs}])\n{{\n{code}\n}}\n"


def _loop(index: str, size: str, lines: Sequence[str]) -> list[str]:
    return [f"for (int {index} = 0; {index} < {size}; ++{index}) {{", *(f"    {line}" for line in lines), "}"]


def _add(target: str, matrix: str, vector: str, size: str) -> list[str]:
    """The loop that adds row i of the matrix times the vector to the target."""
    return _loop("j", size, [f"{target} += {matrix}[i][j] * {vector}[j];"])


def _self_test(controller: SequentialController, name: str) -> str:
    """The stored trace and the function that replays it."""
    N, n, real = name.upper(), len(controller.A), controller.dtype
    y, u = trace(controller)
    call = f"{name}_step({'&state, ' if n else ''}trace_y[k], u);"
    declared = [f"{name}_state state;"] if n else []
    body = [*declared, f"{real} u[{N}_OUTPUTS];", "", *([f"{name}_reset(&state);"] if n else [])]
    body += _loop("k", str(SAMPLES), [call, "if (memcmp(u, trace_u[k], sizeof u) != 0) {", "    return k + 1;", "}"])
    code = textwrap.indent("\n".join([*body, "return 0;"]), "    ")
    tables = [
        f"{_columns(M, key)}\nstatic const {real} trace_{key}[{SAMPLES}][{N}_{size}] = {{\n{_rows(M)}\n}};\n"
        for key, M, size in (("y", y, "INPUTS"), ("u", u, "OUTPUTS"))
    ]
    return "\n".join([f"#ifdef {N}_SELF_TEST", *tables, f"int {name}_self_test(void)\n{{\n{code}\n}}\n#endif\n"])


def trace(controller: SequentialController) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (SAMPLES, p) that move every state, and reach the limits if there are some; and the outputs (SAMPLES, m).

    Raises
    ------
    ExportError : the outputs overflow, which only an unstable controller can do.
    """
    k, j = np.arange(1, SAMPLES + 1)[:, None], np.arange(controller.D.shape[1])
    y = ((5 * k**2 * (j + 2)) % 31 - 15) / 16
    if controller.limited:
        free = replace(
            controller, umin=np.full_like(controller.umin, -np.inf), umax=np.full_like(controller.umax, np.inf)
        )
        peak = np.abs(_outputs(free, y)).max(axis=0)
        limits = np.abs(np.where(np.isfinite(controller.umax), controller.umax, controller.umin))
        reach = [limit / top for limit, top in zip(limits, peak, strict=True) if np.isfinite(limit) and top > 0]
        y = y * 2.0 ** np.ceil(np.log2(2 * max(reach, default=1) or 1))
    y = y.astype(controller.A.dtype)
    u = _outputs(controller, y)
    if not np.isfinite(u).all():
        raise ExportError("the outputs overflow within the self test's trace; pass self_test=False")
    return y, u


def _outputs(controller: SequentialController, inputs: np.ndarray) -> np.ndarray:
    state, outputs = controller.init(), []
    for y in inputs:
        state, u = controller.update(state, y)
        outputs.append(u)
    return np.array(outputs)
