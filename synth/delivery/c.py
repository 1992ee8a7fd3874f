"""A controller as C99: one header, one source, fixed sizes, no allocation, and a self test that compares bits.

The arithmetic is that of `synth.regulators.sequential`: loops over the matrices, one rounded product after another, and
the last command and the old states where something is not finite, which the step returns as 1.
With ``-std=c99`` (or ``-ffp-contract=off``) and IEEE arithmetic the same bits come out on every processor; the self
test, compiled in with ``-DNAME_SELF_TEST``, says whether they do on yours.
"""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from synth.delivery.origin import Origin, Signal
from synth.errors import ExportError
from synth.regulators.sequential import SequentialController

HELD = (
    "Where an input, a sum or a new state is not finite (NaN, infinity, overflow) the step returns 1: u is the last "
    "command again, and the states stay as they were. The next finite sample goes on from there. States that are not "
    "finite themselves stay so, and every sample is a fault, until the controller is reset. Needs IEEE arithmetic with "
    "NaN: no -ffast-math."
)
SAMPLES = 32  # of the stored trace
WIDTH = 100  # of comments
ARITHMETIC = """\
#if defined(__clang__)
#pragma STDC FP_CONTRACT OFF
#endif
#if defined(__FAST_MATH__) || (defined(__FINITE_MATH_ONLY__) && __FINITE_MATH_ONLY__)
#error "compile without -ffast-math: it changes the bits, and takes the tests for NaN out"
#endif
"""


def c_files(controller: SequentialController, origin: Origin, name: str, *, self_test: bool = True) -> dict[str, bytes]:
    """The header ``name.h`` and the source ``name.c``."""
    texts = {f"{name}.h": header(controller, origin, name, self_test), f"{name}.c": source(controller, name, self_test)}
    return {file: text.encode() for file, text in texts.items()}


def header(controller: SequentialController, origin: Origin, name: str, self_test: bool) -> str:
    """The interface: sizes and sample time as macros, the state, its functions, and where all this comes from."""
    N, real, n = name.upper(), controller.dtype, len(controller.A)
    parts = [_title(controller, origin, name), f"#ifndef {N}_H\n#define {N}_H\n"]
    sizes = [f"#define {N}_STATES  {n}"] if n else []
    sizes += [f"#define {N}_INPUTS  {controller.D.shape[1]}", f"#define {N}_OUTPUTS {controller.D.shape[0]}"]
    parts.append(
        "\n".join([*sizes, f"#define {N}_SAMPLE_TIME {_number(controller.A.dtype.type(controller.dt))} /* s */\n"])
    )
    parts.append('#ifdef __cplusplus\nextern "C" {\n#endif\n')
    members = [f"    {real} x[{N}_STATES];\n"] * (n > 0) + [f"    {real} u[{N}_OUTPUTS]; /* the last command */\n"]
    parts.append(f"typedef struct {{\n{''.join(members)}}} {name}_state;\n")
    parts.append(
        f"/* Sets the states to zero, and the last command to zero as far as the limits allow. */\n"
        f"void {name}_reset({name}_state *state);\n"
    )
    parts.append(
        "/* One sample: reads the inputs y, writes the outputs u. Returns 0, or 1 for a fault: an input, a sum or a\n"
        " * new state is not finite; u is then the last command again, and the states stay. */\n"
        f"int {name}_step({name}_state *state, const {real} y[{N}_INPUTS], {real} u[{N}_OUTPUTS]);\n"
    )
    if self_test:
        parts.append(
            f"#ifdef {N}_SELF_TEST\n"
            "/* Replays a stored trace: 0 if every bit agrees, else the number of the first sample that differs. The\n"
            " * last samples are not numbers, and must be faults; the number after them is that of the constants,\n"
            " * whose hash differs. */\n"
            f"int {name}_self_test(void);\n#endif\n"
        )
    return "\n".join([*parts, "#ifdef __cplusplus\n}\n#endif\n", "#endif\n"])


def source(controller: SequentialController, name: str, self_test: bool) -> str:
    """The implementation: matrices, step, and the trace of the self test."""
    N = name.upper()
    includes = [f'#include "{name}.h"\n', "#include <math.h>\n"]
    if self_test:
        includes.append(f"#ifdef {N}_SELF_TEST\n#include <stdint.h>\n#include <string.h>\n#endif\n")
    parts = [*includes, ARITHMETIC, *_matrices(controller, N), _reset(controller, name), _step(controller, name)]
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
    lines += [*signals("y", origin.inputs), "", *signals("u", origin.outputs, controller), ""]
    lines += [*told(origin), "", f"Use, once every {name.upper()}_SAMPLE_TIME seconds:", ""]
    lines += [f"    static {name}_state state;", f"    {name}_reset(&state);      once, before the first sample"]
    lines += [f"    fault = {name}_step(&state, y, u);", ""]
    return comment([*lines, *textwrap.wrap(HELD, WIDTH)])


def comment(lines: Sequence[str]) -> str:
    """Lines as a comment in C."""
    body = "\n".join(f" * {line}".rstrip() for line in lines)
    return f"/*\n{body}\n */\n"


def told(origin: Origin) -> list[str]:
    """The facts of an origin, in lines."""
    lines: list[str] = []
    for key, text in origin.facts.items():
        lines += textwrap.wrap(text, WIDTH - 14, initial_indent=f"{key:12} ", subsequent_indent=" " * 13)
    return lines


def signals(symbol: str, signals: Sequence[Signal], controller: SequentialController | None = None) -> list[str]:
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
    dtype, parts = controller.dtype, []
    for key, (M, rows, columns, symbol) in _constants(controller, N).items():
        values = f"{{\n{table(M)}\n}}" if M.ndim == 2 else initializer(M)
        heading, size = (f"{headings(M, symbol)}\n", f"[{rows}][{columns}]") if M.ndim == 2 else ("", f"[{rows}]")
        parts.append(f"{heading}static const {dtype} {key}{size} = {values};\n")
    return parts


def _constants(controller: SequentialController, N: str) -> dict[str, tuple[np.ndarray, str, str, str]]:
    """Name -> values, number of rows, number of columns, what they are multiplied by."""
    x, y, u = (f"{N}_{size}" for size in ("STATES", "INPUTS", "OUTPUTS"))
    found = {}
    if len(controller.A):
        found |= {"A": (controller.A, x, x, "x"), "B": (controller.B, x, y, "y"), "C": (controller.C, u, x, "x")}
    if _has_direct_term(controller):
        found["D"] = (controller.D, u, y, "y")
    if controller.conditioned:
        found["L"] = (controller.L, x, u, "u")
    if controller.limited:
        found |= {"umin": (controller.umin, u, "", ""), "umax": (controller.umax, u, "", "")}
    return found


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


def headings(M: np.ndarray, symbol: str) -> str:
    """A comment over the columns: what each is multiplied by."""
    heads = [f"{symbol}[{j}]".rjust(max(width, 5)) for j, width in enumerate(_widths(M))]
    return f"/*    {'  '.join(heads)} */"


def table(M: np.ndarray) -> str:
    """The rows of a matrix, aligned below the comment."""
    widths = [max(width, 5) for width in _widths(M)]
    rows = [", ".join(_number(v).rjust(w) for v, w in zip(row, widths, strict=True)) for row in M]
    return ",\n".join(f"    {{ {row} }}" for row in rows)


def _within_limits(controller: SequentialController, value: str) -> str:
    """The value within its limits; NaN would not pass these comparisons."""
    if not controller.limited:
        return value
    return f"!({value} >= umin[i]) ? umin[i] : !({value} <= umax[i]) ? umax[i] : {value}"


def _reset(controller: SequentialController, name: str) -> str:
    """The function that sets the state."""
    N = name.upper()
    body = loop("i", f"{N}_STATES", ["state->x[i] = 0;"]) if len(controller.A) else []
    body += loop("i", f"{N}_OUTPUTS", [f"state->u[i] = {_within_limits(controller, '0')};"])
    return function(f"void {name}_reset({name}_state *state)", body)


def _step(controller: SequentialController, name: str) -> str:
    """One sample: the commands from the old states, and the new states; both are kept if all is finite."""
    N, n, real = name.upper(), len(controller.A), controller.dtype
    states, inputs, outputs = (f"{N}_{size}" for size in ("STATES", "INPUTS", "OUTPUTS"))
    body = [f"{real} command[{outputs}];"]
    body += [f"{real} deficit[{outputs}];"] * controller.conditioned + [f"{real} next[{states}];"] * (n > 0)
    body += ["int fault = 0;", "", *loop("j", inputs, ["fault |= !isfinite(y[j]);"])]
    lines = [f"{real} v = 0;"]
    lines += _add("v", "C", "state->x", states) if n else []
    lines += _add("v", "D", "y", inputs) if _has_direct_term(controller) else []
    lines += [f"command[i] = {_within_limits(controller, 'v')};", "fault |= !isfinite(v);"]
    lines += ["deficit[i] = command[i] - v;"] * controller.conditioned
    body += loop("i", outputs, lines)
    kept = loop("i", outputs, ["state->u[i] = command[i];"])
    if n:
        lines = ["next[i] = 0;", *_add("next[i]", "A", "state->x", states), *_add("next[i]", "B", "y", inputs)]
        lines += _add("next[i]", "L", "deficit", outputs) if controller.conditioned else []
        body += loop("i", states, [*lines, "fault |= !isfinite(next[i]);"])
        kept = loop("i", states, ["state->x[i] = next[i];"]) + kept
    body += ["if (!fault) {", *(f"    {line}" for line in kept), "}"]
    body += [*loop("i", outputs, ["u[i] = state->u[i];"]), "return fault;"]
    return function(f"int {name}_step({name}_state *state, const {real} y[{inputs}], {real} u[{outputs}])", body)


def function(head: str, body: Sequence[str]) -> str:
    """A function in C."""
    code = textwrap.indent("\n".join(body), "    ", lambda line: bool(line.strip()))
    return f"{head}\n{{\n{code}\n}}\n"


def loop(index: str, size: str, lines: Sequence[str]) -> list[str]:
    """A loop in C."""
    return [f"for (int {index} = 0; {index} < {size}; ++{index}) {{", *(f"    {line}" for line in lines), "}"]


def _add(target: str, matrix: str, vector: str, size: str) -> list[str]:
    """The loop that adds row i of the matrix times the vector to the target."""
    return loop("j", size, [f"{target} += {matrix}[i][j] * {vector}[j];"])


def _self_test(controller: SequentialController, name: str) -> str:
    """The stored trace and the function that replays it, and then holds the last command over what is no number."""
    N, real = name.upper(), controller.dtype
    y, u = trace(controller)
    differs = "memcmp(u, trace_u[{}], sizeof u) != 0"
    body = [
        f"static const {real} strange[3] = {{ NAN, INFINITY, -INFINITY }};",
        f"{name}_state state;", f"{real} y[{N}_INPUTS], u[{N}_OUTPUTS];", "uint32_t hash;", "",
        f"{name}_reset(&state);",
        *loop("k", str(SAMPLES), [
            f"if ({name}_step(&state, trace_y[k], u) != 0 || {differs.format('k')}) {{", "    return k + 1;", "}",
        ]),
        "memcpy(y, trace_y[0], sizeof y);",
        *loop("k", "3", [
            "y[k % " + f"{N}_INPUTS] = strange[k];",
            f"if ({name}_step(&state, y, u) != 1 || {differs.format(SAMPLES - 1)}) {{",
            f"    return {SAMPLES} + k + 1;", "}",
        ]),
        *_untouched(controller, N),
        "return 0;",
    ]  # fmt: skip
    tables = [
        f"{headings(M, key)}\nstatic const {real} trace_{key}[{SAMPLES}][{N}_{size}] = {{\n{table(M)}\n}};\n"
        for key, M, size in (("y", y, "INPUTS"), ("u", u, "OUTPUTS"))
    ]
    return "\n".join(
        [
            f"#ifdef {N}_SELF_TEST",
            *tables,
            hashing(real, f"uint{8 * y.itemsize}_t"),
            f"{function(f'int {name}_self_test(void)', body)}#endif\n",
        ]
    )


def _untouched(controller: SequentialController, N: str) -> list[str]:
    """What compares the hash of all constants, also of those that this trace does not tell apart."""
    constants = {key: M for key, (M, *_) in _constants(controller, N).items()}
    return ["hash = 2166136261u;", *compared(constants, SAMPLES + 4)]


def hashing(kind: str, bits: str) -> str:
    """The function that goes on with a hash (FNV-1a) over the bytes of numbers of this kind, the lowest first."""
    body = [
        *loop("i", "count", [
            f"{bits} bits;", "memcpy(&bits, values + i, sizeof bits);",
            *loop("k", "(int)sizeof bits", ["hash = (hash ^ (uint32_t)((bits >> (8 * k)) & 255u)) * 16777619u;"]),
        ]),
        "return hash;",
    ]  # fmt: skip
    return function(f"static uint32_t hashed(uint32_t hash, const {kind} *values, int count)", body)


def compared(constants: Mapping[str, np.ndarray], number: int) -> list[str]:
    """Lines that return this number where the hash of the constants is another than now."""
    lines, found = [], 2166136261
    for key, M in constants.items():
        at = "&" + key + "[0]" * M.ndim
        lines.append(f"hash = hashed(hash, {at}, {M.size});")
        for byte in M.astype(M.dtype.newbyteorder("<")).tobytes():
            found = ((found ^ byte) * 16777619) % 2**32
    return [*lines, f"if (hash != {found}u) {{", f"    return {number};", "}"]


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
    """Outputs (samples, m), not numbers from the first fault on."""
    state, outputs = controller.init(), np.full((len(inputs), len(controller.D)), np.nan, controller.A.dtype)
    for k, y in enumerate(inputs):
        state, u = controller.update(state, y)
        if state.fault:
            break
        outputs[k] = u
    return outputs
