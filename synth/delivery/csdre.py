"""A state-dependent Riccati law as C99: one header, one source, fixed sizes, no allocation, a self test.

The functions in the folder ``sdre`` are put together: the model's A(y) and B, the steps of `synth.equations.riccati`
with the same limits and tests, the law. A sum begins with its first product and takes one rounded product after
another. Where no solution is accepted the last gain is flown and counted, as in Python. How far from Python the
commands may be is in the header (`synth.delivery.agreement`); the self test holds the recorded samples against it.
"""

from __future__ import annotations

import textwrap
from importlib import metadata, resources
from typing import Any, NamedTuple

import numpy as np

from synth.checks import as_limits
from synth.delivery import c
from synth.delivery.agreement import FACTOR, ORDERS, Record, recorded
from synth.delivery.origin import Origin, Signal
from synth.equations.riccati import ACCURACY
from synth.errors import ExportError, ModelError
from synth.regulators.sdc import EulerModel, MrpModel, QuaternionModel
from synth.regulators.sdre import Sdre, SdreHinfStatic, SdreSampled
from synth.synthesis import convention

PARTS = resources.files("synth.delivery") / "sdre"


class Kind(NamedTuple):
    """What a law or a model is made of in C."""

    parts: tuple[str, ...]  # files
    constants: tuple[str, ...]  # fields
    told: str


class Model(NamedTuple):
    """A model, and its measurement."""

    kind: Kind
    inputs: tuple[Signal, ...]


WHEELS = tuple(Signal(f"{kind}{axis}", unit) for kind, unit in (("w", "rad/s"), ("h", "N m s")) for axis in "xyz")
QUATERNION = (*(Signal(f"q{i}", "") for i in range(4)), *WHEELS)
ANGLES = (*(Signal(name, "rad") for name in ("roll", "pitch", "yaw")), *WHEELS)
LAWS = {
    Sdre: Kind(
        ("doubling", "continuous", "sdre"),
        ("weight_Q", "inverse_R", "usual_rate"),
        "K = R^-1 B'X with A'X + X A - X B R^-1 B'X + Q = 0",
    ),
    SdreSampled: Kind(
        ("solve", "doubling", "sampled"),
        ("weight_Q", "weight_R", "dt"),
        "K of the model sampled at y, its command held and the same integral as cost (lqrd)",
    ),
    SdreHinfStatic: Kind(
        ("solve", "doubling", "continuous", "robust"),
        ("weight_Q", "inverse_R", "usual_rate", "gamma_factor"),
        "K of Glover and McFarlane's robust controller without its observer",
    ),
}
MODELS = {
    MrpModel: Model(
        Kind(("wheels", "mrp"), ("inertia", "inverse"), "x = [s; w], modified Rodrigues parameters of the short way"),
        QUATERNION,
    ),
    QuaternionModel: Model(
        Kind(("wheels", "quaternion"), ("inertia", "inverse", "least_q0"), "x = [qv; w], part of the quaternion"),
        QUATERNION,
    ),
    EulerModel: Model(
        Kind(("euler",), ("inertia", "inverse", "angles"), "x = [angles - target; w], 3-2-1 Euler angles"), ANGLES
    ),
}
FIELDS = {  # those of another name in C
    "weight_Q": "Q",
    "weight_R": "R",
    "inverse_R": "R_inverse",
    "usual_rate": "shift",
    "least_q0": "floor",
    "rest_gain": "gain",
    "rest_X": "X",
}
UNSOLVED = (
    "the last gain that had a solution is flown and state->failures counts the sample; before the first solution that "
    "is the gain at rest at the target. Where it is a matter of rounding whether there is one, C and Python may differ"
)
HELD = (
    "Where a measurement or the command is not finite (NaN, infinity, overflow) the step returns 1 and counts a "
    "failure: u is the last command again, gain and solutions stay. The next finite sample goes on from there. Needs "
    "IEEE arithmetic with NaN: no -ffast-math. All functions together need at most {stack} kB of stack."
)


def sdre_files(controller: Any, name: str, *, umin: Any, umax: Any, self_test: bool) -> dict[str, bytes]:
    """The header ``name.h`` and the source ``name.c``.

    Raises
    ------
    ExportError : the model is none of `synth`, or too few samples have solutions to compare.
    ModelError : limits that are none.
    """
    if type(controller.model) not in MODELS:
        raise ExportError(
            f"model is a {type(controller.model).__name__}, a factorisation of your own: its A(y) and B are Python, of "
            f"which there is no C. Use {', '.join(kind.__name__ for kind in MODELS)} of synth; or export the law with "
            "one of them and put your own `factorise` into the C by hand, where the self test will tell the difference"
        )
    low, high = (as_limits(*limit, 3) for limit in (("umin", -np.inf if umin is None else umin),
                                                    ("umax", np.inf if umax is None else umax)))  # fmt: skip
    if not (low < high).all():
        raise ModelError(f"umin = {low.tolist()} is not below umax = {high.tolist()}; leave room between them")
    found = recorded(controller)
    numbers = _constants(controller) | {"umin": low, "umax": high}
    texts = {
        f"{name}.h": _header(controller, numbers, found, name, self_test),
        f"{name}.c": _source(controller, numbers, found, name, self_test),
    }
    return {file: text.encode() for file, text in texts.items()}


def _constants(controller: Any) -> dict[str, np.ndarray]:
    """Name in C -> values, a scalar or flat."""
    law, model = LAWS[type(controller)], MODELS[type(controller.model)].kind
    names = (*model.constants, *law.constants, "rest_gain", *(["rest_X"] if _continues(controller) else []))
    fields = vars(controller.model) | vars(controller)
    return {key: np.array(fields[FIELDS.get(key, key)], float) for key in names}


def _continues(controller: Any) -> bool:
    """Whether the law remembers solutions."""
    return isinstance(controller, Sdre)


def _header(controller: Any, numbers: dict[str, np.ndarray], found: Record, name: str, self_test: bool) -> str:
    """The interface, and all there is to know."""
    N, inputs = name.upper(), MODELS[type(controller.model)].inputs
    sizes = {"STATES": "6", "INPUTS": str(len(inputs)), "OUTPUTS": "3", "SAMPLE_TIME": f"{controller.dt!r} /* s */"}
    sizes["AGREEMENT"] = f"{found.bound!r} /* of |u - u of Python| relative to |K| |x| */"
    members = ["double gain[3 * 6]; /* K, the last sound one */"]
    if _continues(controller):
        members += ["double X[6 * 6]; /* the last sound solution */", "double before[6 * 6]; /* the one before */"]
    members += ["double u[3]; /* the last command */", "unsigned long failures; /* samples without a solution */"]
    parts = [
        c.comment([*_told(controller, numbers, found, name)]),
        f"#ifndef {N}_H\n#define {N}_H\n",
        "\n".join(f"#define {N}_{key:11} {value}" for key, value in sizes.items()) + "\n",
        '#ifdef __cplusplus\nextern "C" {\n#endif\n',
        "typedef struct {\n" + "".join(f"    {member}\n" for member in members) + f"}} {name}_state;\n",
        f"/* At rest at the target, nothing failed. */\nvoid {name}_reset({name}_state *state);\n",
        "/* One sample: reads the measurement y, writes the command u. Returns 0, or 1 for a fault: something is not\n"
        " * finite; u is then the last command again. */\n"
        f"int {name}_step({name}_state *state, const double y[{N}_INPUTS], double u[{N}_OUTPUTS]);\n",
    ]
    if self_test:
        parts.append(
            f"#ifdef {N}_SELF_TEST\n"
            f"/* Replays recorded samples: 0 if every command is within {N}_AGREEMENT of Python's, else the number of\n"
            " * the first sample that is not. The last of them has no solution. Then come three that are not numbers\n"
            " * and must be faults, then the count of failures, then the hash of all constants. */\n"
            f"int {name}_self_test(void);\n#endif\n"
        )
    return "\n".join([*parts, "#ifdef __cplusplus\n}\n#endif\n", "#endif\n"])


def _told(controller: Any, numbers: dict[str, np.ndarray], found: Record, name: str) -> list[str]:
    """The lines of the header's comment."""
    law, (model, inputs) = LAWS[type(controller)], MODELS[type(controller.model)]
    outputs = tuple(Signal(f"torque on the body {axis}", "N m") for axis in "xyz")
    low, high = numbers["umin"], numbers["umax"]
    limited = np.isfinite(low).any() or np.isfinite(high).any()
    facts = {
        "convention": convention.REGULATED,
        "sampling": convention.sampling(controller.dt),
        "limits": f"u = min(max(-K x, umin), umax), umin {low.tolist()}, umax {high.tolist()} N m" if limited
        else "none: u is not limited, and the law has no states that an actuator's limit could mislead",
        "law": f"{type(controller).__name__}: u = -K x, {law.told}",
        "model": f"{type(controller.model).__name__}: {model.told}; dx = A(y) x + B u",
        "no solution": UNSOLVED,
        "agreement": _agreement(found, name.upper()),
        "plant": "none; the law was exported without a plant, nothing was verified in a loop",
        "exported by": f"convex-synth {metadata.version('convex-synth')}",
    }  # fmt: skip
    stack = 32 if isinstance(controller, SdreSampled) else 16
    return [
        f"{name}: state-dependent Riccati law, double precision, sample time {controller.dt!r} s", "",
        *c.signals("y", inputs), "", *c.signals("u", outputs), "", *c.told(Origin(facts, inputs, outputs)), "",
        f"Use, once every {name.upper()}_SAMPLE_TIME seconds:", "",
        f"    static {name}_state state;", f"    {name}_reset(&state);      once, before the first sample",
        f"    fault = {name}_step(&state, y, u);", "", *textwrap.wrap(HELD.format(stack=stack), c.WIDTH),
    ]  # fmt: skip


def _agreement(found: Record, N: str) -> str:
    """The bound in words."""
    return (
        f"|u - u of Python| <= {N}_AGREEMENT | |K| |x| |, 2-norms and moduli of the entries: {found.bound:.3g} = "
        f"2 x {ACCURACY:g}, the relative error at which either accepts a solution, + {FACTOR} x {found.rounding:.3g}, "
        f"the most by which commands of {len(found.y)} samples moved, relative to | |K| |x| |, when Python flew them "
        f"again with its states and commands in {ORDERS} other orders, which round otherwise: measured, not proved. "
        f"The last has no solution; the others are attitudes all round, rates to {found.rate:.3g} rad/s and momenta to "
        f"{found.momentum:.3g} N m s about an axis, where the bound is at most {found.largest:.3g} N m"
    )


def _source(controller: Any, numbers: dict[str, np.ndarray], found: Record, name: str, self_test: bool) -> str:
    """The implementation."""
    N, law, model = name.upper(), LAWS[type(controller)], MODELS[type(controller.model)].kind
    includes = [f'#include "{name}.h"\n', "#include <math.h>\n#include <stddef.h>\n#include <string.h>\n"]
    if self_test:
        includes.append(f"#ifdef {N}_SELF_TEST\n#include <stdint.h>\n#endif\n")
    sizes = "".join(
        f"#define {own} {N}_{key}\n" for own, key in (("N", "STATES"), ("M", "OUTPUTS"), ("INPUTS", "INPUTS"))
    )
    files = ("matrices", "body", *model.parts, *law.parts, "step")
    kept = ["state->failures = 0;", "memcpy(state->gain, rest_gain, sizeof rest_gain);"]
    kept += [f"memcpy(state->{key}, rest_X, sizeof rest_X);" for key in ("X", "before") if _continues(controller)]
    body = [*kept, *c.loop("i", "M", ["state->u[i] = limited(0, i);"])]
    parts = [
        *includes, c.ARITHMETIC, f"{sizes}\ntypedef {name}_state memory;\n",
        *(_declared(key, value) for key, value in numbers.items()),
        *((PARTS / f"{file}.c").read_text() for file in files),
        c.function(f"void {name}_reset({name}_state *state)", body),
        c.function(
            f"int {name}_step({name}_state *state, const double y[{N}_INPUTS], double u[{N}_OUTPUTS])",
            ["return stepped(state, y, u);"],
        ),
    ]  # fmt: skip
    return "\n".join([*parts, _self_test(numbers, found, name)] if self_test else parts)


def _declared(key: str, values: np.ndarray, rows: str = "") -> str:
    """A constant in C, a scalar or the rows of a matrix one after the other."""
    if not values.ndim:
        return f"static const double {key} = {c.initializer(values[None])[2:-2]};\n"
    lines = "\n".join(f"    {c.initializer(row)[2:-2]}," for row in np.atleast_2d(values))
    return f"static const double {key}[{values.size}] = {{\n{lines}\n}};\n"


def _self_test(numbers: dict[str, np.ndarray], found: Record, name: str) -> str:
    """The recorded samples, and the function that replays them."""
    N, samples = name.upper(), len(found.y)
    u = np.clip(found.u, numbers["umin"], numbers["umax"])
    body = [
        "static const double strange[3] = { NAN, INFINITY, -INFINITY };",
        f"{name}_state state;", "double y[INPUTS], u[M], off[M], near[M], held[M];", "double x[N], A[N * N], B[N * M];",
        "uint32_t hash;", "",
        f"{name}_reset(&state);",
        *c.loop("k", str(samples), [
            f"const int fault = {name}_step(&state, trace_y + k * INPUTS, u);",
            "factorise(trace_y + k * INPUTS, x, A, B);",
            *c.loop("i", "M", [
                "off[i] = u[i] - trace_u[k * M + i];", "near[i] = 0;",
                *c.loop("j", "N", ["near[i] += fabs(state.gain[i * N + j] * x[j]);"]),
            ]),
            f"if (fault || !(size_of(off, M) <= {N}_AGREEMENT * size_of(near, M))) {{", "    return k + 1;", "}",
        ]),
        "memcpy(y, trace_y, sizeof y);", "memcpy(held, u, sizeof held);",
        *c.loop("k", "3", [
            "y[k % INPUTS] = strange[k];",
            f"if ({name}_step(&state, y, u) != 1 || memcmp(u, held, sizeof u) != 0) {{",
            f"    return {samples} + k + 1;", "}",
        ]),
        f"if (state.failures != 4) {{ /* the last sample, and these */\n    return {samples + 4};\n}}",
        "hash = 2166136261u;",
        *c.compared({key: value.ravel() if value.ndim else value for key, value in numbers.items()}, samples + 5),
        "return 0;",
    ]  # fmt: skip
    return "\n".join([
        f"#ifdef {N}_SELF_TEST",
        _declared("trace_y", found.y), _declared("trace_u", u),
        c.hashing("double", "uint64_t"),
        f"{c.function(f'int {name}_self_test(void)', body)}#endif\n",
    ])  # fmt: skip
