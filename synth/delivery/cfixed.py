"""A controller in fixed point as C99: whole numbers, one header, one source, and a self test that compares bits.

The arithmetic is that of `synth.regulators.fixed`, whose scaling rules overflow out, so that the C needs no saturating
arithmetic and no floating-point unit. Shifts to the right are written for positive numbers only, which C defines.
"""

from __future__ import annotations

import textwrap
from collections.abc import Sequence

import numpy as np

from synth.delivery.c import SAMPLES, WIDTH, comment, compared, function, hashing, loop, told
from synth.delivery.origin import Origin, Signal
from synth.regulators.fixed import FixedController

NEVER = (
    "No sum can overflow, whatever the inputs are: those beyond the bounds given here are held at them, and the step "
    "returns 1 then, 0 otherwise. Numbers become whole ones by rounding to nearest, halves up."
)
ROUNDED = """\
/* total / 2^shift, rounded to nearest, halves up; |total| < 2^62. */
static int32_t rounded(int64_t total, int shift)
{
    int64_t step = (int64_t)1 << shift;
    total += step / 2;
    return (int32_t)(total >= 0 ? total >> shift : -((step - 1 - total) >> shift));
}
"""


def fixed_c_files(
    controller: FixedController, origin: Origin, name: str, *, self_test: bool = True
) -> dict[str, bytes]:
    """The header ``name.h`` and the source ``name.c``."""
    texts = {
        f"{name}.h": _header(controller, origin, name, self_test),
        f"{name}.c": _source(controller, name, self_test),
    }
    return {file: text.encode() for file, text in texts.items()}


def _header(controller: FixedController, origin: Origin, name: str, self_test: bool) -> str:
    """The interface: sizes, scales, the state and its functions, and where all this comes from."""
    N, (n, p, m) = name.upper(), _sizes(controller)
    lines = [f"{name}: linear controller in fixed point, {controller.format}, sample time {controller.dt!r} s", ""]
    lines += ["    v = C x + D y,   u = min(max(v, umin), umax)" + (",   x+ = A x + B y" if n else ""), ""]
    lines += [*_signals("y", origin.inputs, controller.read, -controller.most, controller.most), ""]
    lines += [*_signals("u", origin.outputs, controller.commands, controller.umin, controller.umax), ""]
    lines += [*told(origin), "", f"Use, once every {controller.dt!r} s:", ""]
    lines += [f"    static {name}_state state;", f"    {name}_reset(&state);      once, before the first sample"]
    lines += [f"    fault = {name}_step(&state, y, u);", "", *textwrap.wrap(NEVER, WIDTH)]
    sizes = [f"#define {N}_STATES  {n}"] * (n > 0) + [f"#define {N}_INPUTS  {p}", f"#define {N}_OUTPUTS {m}"]
    scales = ["/* A signal is its whole number times 2^-f, with these f. */"]
    scales += [
        f"#define {N}_INPUT_BITS  {_braced(controller.read)}",
        f"#define {N}_OUTPUT_BITS {_braced(controller.commands)}",
    ]
    states = f"    int32_t x[{N}_STATES];\n" * (n > 0)
    parts = [
        comment(lines), f"#ifndef {N}_H\n#define {N}_H\n\n#include <stdint.h>\n", "\n".join([*sizes, *scales, ""]),
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        f"typedef struct {{\n{states}    int32_t u[{N}_OUTPUTS]; /* the last command */\n}} {name}_state;\n",
        f"/* Sets the states to zero, and the last command to zero as far as the limits allow. */\n"
        f"void {name}_reset({name}_state *state);\n",
        "/* One sample: reads the inputs y, writes the outputs u. Returns 1 where an input is beyond its bound. */\n"
        f"int {name}_step({name}_state *state, const int32_t y[{N}_INPUTS], int32_t u[{N}_OUTPUTS]);\n",
    ]  # fmt: skip
    if self_test:
        parts.append(
            f"#ifdef {N}_SELF_TEST\n"
            "/* Replays a stored trace: 0 if every bit agrees, else the number of the first sample that differs, and\n"
            " * the number after the last one where a constant does. */\n"
            f"int {name}_self_test(void);\n#endif\n"
        )
    return "\n".join([*parts, "#ifdef __cplusplus\n}\n#endif\n", "#endif\n"])


def _signals(symbol: str, found: Sequence[Signal], bits: np.ndarray, low: np.ndarray, high: np.ndarray) -> list[str]:
    """One line per signal, with its scale and its bounds."""
    return [f"{symbol}[{i}]  {signal}  times 2^{bits[i]}, in [{low[i]}, {high[i]}]" for i, signal in enumerate(found)]


def _sizes(controller: FixedController) -> tuple[int, int, int]:
    return len(controller.states), len(controller.read), len(controller.commands)


def _constants(controller: FixedController) -> dict[str, np.ndarray]:
    """All tables of the C, which are 32 bits wide."""
    tables = {"rows": controller.rows, "shifts": controller.shifts, "most": controller.most}
    return {key: M.astype(np.int32) for key, M in (tables | {"umin": controller.umin, "umax": controller.umax}).items()}


def _source(controller: FixedController, name: str, self_test: bool) -> str:
    """The implementation: tables, step, and the trace of the self test."""
    N, (n, p, m) = name.upper(), _sizes(controller)
    parts = [f'#include "{name}.h"\n']
    if self_test:
        parts.append(f"#ifdef {N}_SELF_TEST\n#include <string.h>\n#endif\n")
    parts.append(
        "/* Of the next states and of the commands: rows of coefficients of x and y, and what they are shifted by. */"
    )
    parts += [_table(key, M) for key, M in _constants(controller).items()]
    held = "{0} < umin[i] ? umin[i] : {0} > umax[i] ? umax[i] : {0}"
    body = loop("i", f"{N}_STATES", ["state->x[i] = 0;"]) if n else []
    body += loop("i", f"{N}_OUTPUTS", [f"state->u[i] = {held.format('0')};"])
    parts += [ROUNDED, function(f"void {name}_reset({name}_state *state)", body)]
    body = [f"int32_t signals[{n + p}], results[{n + m}];", "int fault = 0;", ""]
    body += loop("j", f"{N}_STATES", ["signals[j] = state->x[j];"]) if n else []
    body += loop("j", f"{N}_INPUTS", [
        f"int32_t *held = signals + {n} + j;", "*held = y[j] > most[j] ? most[j] : y[j] < -most[j] ? -most[j] : y[j];",
        "fault |= *held != y[j];",
    ])  # fmt: skip
    body += loop("i", str(n + m), [
        "int64_t total = 0;", *loop("j", str(n + p), ["total += (int64_t)rows[i][j] * signals[j];"]),
        "results[i] = rounded(total, (int)shifts[i]);",
    ])  # fmt: skip
    body += loop("i", f"{N}_STATES", ["state->x[i] = results[i];"]) if n else []
    body += loop("i", f"{N}_OUTPUTS", [
        f"int32_t v = results[{n} + i];", f"u[i] = state->u[i] = {held.format('v')};",
    ])  # fmt: skip
    step = f"int {name}_step({name}_state *state, const int32_t y[{N}_INPUTS], int32_t u[{N}_OUTPUTS])"
    parts.append(function(step, [*body, "return fault;"]))
    return "\n".join([*parts, *([_self_test(controller, name)] if self_test else [])])


def _self_test(controller: FixedController, name: str) -> str:
    """The stored trace and the function that replays it."""
    N, (y, u) = name.upper(), trace(controller)
    body = [
        f"{name}_state state;", f"int32_t u[{N}_OUTPUTS];", "uint32_t hash = 2166136261u;", "",
        f"{name}_reset(&state);",
        *loop("k", str(SAMPLES), [
            f"{name}_step(&state, trace_y[k], u);",
            "if (memcmp(u, trace_u[k], sizeof u) != 0) {", "    return k + 1;", "}",
        ]),
        *compared(_constants(controller), SAMPLES + 1),
        "return 0;",
    ]  # fmt: skip
    test = function(f"int {name}_self_test(void)", body)
    tables = [_table("trace_y", y), _table("trace_u", u), hashing("int32_t", "uint32_t")]
    return "\n".join([f"#ifdef {N}_SELF_TEST", *tables, f"{test}#endif\n"])


def trace(controller: FixedController) -> tuple[np.ndarray, np.ndarray]:
    """Inputs (SAMPLES, p) within and beyond their bounds, and the commands (SAMPLES, m), whole."""
    k, j = np.arange(1, SAMPLES + 1)[:, None], np.arange(len(controller.read))
    y = np.clip(((5 * k**2 * (j + 2)) % 31 - 15) * controller.most // 14, -(2**31) + 1, 2**31 - 1)
    x, commands = controller.init().x, []
    for sample in y:
        (x, u), _ = controller.advance(x, sample)
        commands.append(u)
    return y.astype(np.int32), np.array(commands, np.int32)


def _table(key: str, M: np.ndarray) -> str:
    """A constant array."""
    size = "".join(f"[{length}]" for length in M.shape)
    if M.ndim == 1:
        return f"static const int32_t {key}{size} = {_braced(M)};\n"
    lines = ",\n".join(f"    {_braced(row)}" for row in M)
    return f"static const int32_t {key}{size} = {{\n{lines}\n}};\n"


def _braced(values: np.ndarray) -> str:
    return f"{{ {', '.join(str(int(value)) for value in values)} }}"
