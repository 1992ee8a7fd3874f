"""One random change of what a file holds, or of its bytes."""

import json

import numpy as np

NUMBERS = (0.0, -1.0, 1e-300, 1e300, 0.5, 2, -0.0, 53, 4096, True, None, "1", [], {}, [[1.0]])
WRONG = (
    "true",
    "null",
    '"x"',
    "{}",
    "[]",
    "[[]]",
    "[[[1]]]",
    "-1",
    "1e300",
    "1e-320",
    "[[1],[2,3]]",
    '"\\u001b[2J"',
    "7.5",
)


# what a value may become in a damaged file: kinds, sizes and bounds that a reader did not expect
ATOMS = (
    None, True, False, 0, -1, 3, 2**63, 10**19, -(10**300), 0.5, -0.0, 5e-324, 1e-320, 1e200, -1e308, "", "inf", "nan",
    "-1+2j", "1e5", "CON", "../x", "\x1b[2J", "\x00", "<script>", "\u202e", "$\\frac$", "µ" * 40, [], {}, [[]],
    [[], []], [None], [[None]], [True], [["a"]], ["a", "a"], [[1], [1, 2]], [[[1.0]]], [1.0, 2.0],
    [[1e200, 1e-200]], {"a": 1}, {"diag": [1]}, [0.0] * 300, [[0.0] * 40] * 40, [[1e308] * 3] * 3, {"v": [1.0]},
    {"shift": 1.0},
)  # fmt: skip
UNUSUAL = (
    "A",
    "B1",
    "dt",
    "num",
    "zeros",
    "format",
    "format_version",
    "units",
    "L",
    "umin",
    "delay",
    "__proto__",
    "\x1b",
)
FACTORS = (1 + 1e-12, 1.001, 2, -1, 1e10, 1e200, 1e-200, 0.0)


def places(data, path=()):
    """Paths to all that a file holds."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    for key, value in items:
        yield (*path, key)
        yield from places(value, (*path, key))


def tampered(data, rng):
    """The data with one change, of a number, a text, a structure or a name; None where it came out the same."""
    data = json.loads(json.dumps(data))
    found = list(places(data))
    # half of the changes near the top, where the claims are
    path = found[int(rng.integers(len(found)))] if rng.random() < 0.5 else (list(data)[int(rng.integers(len(data)))],)
    holder = data
    for key in path[:-1]:
        holder = holder[key]
    key, kind = path[-1], rng.integers(5)
    old = holder[key]
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, dict):
        holder[str(key) + "x"] = holder.pop(key)
    elif kind == 2 and isinstance(old, list) and old:
        holder[key] = old[::-1] if rng.random() < 0.5 else old[:-1]
    elif isinstance(old, float | int) and not isinstance(old, bool):
        holder[key] = [float(np.nextafter(old, 10)), old * 0.999, old * 1.001, -old][int(rng.integers(4))]
    elif isinstance(old, str):
        holder[key] = [old + " ", old[::-1], old.replace("below", "above"), ""][int(rng.integers(4))]
    else:
        holder[key] = NUMBERS[int(rng.integers(len(NUMBERS)))]
    return data


def rearranged(data, rng):
    """The data with one to three changes of any kind, which need not leave it in a form that anybody wrote."""
    data = json.loads(json.dumps(data))
    for _ in range(int(rng.choice([1, 1, 2, 3]))):
        found = list(places(data))
        if not found:
            return data
        path = found[int(rng.integers(len(found)))]
        if rng.random() < 0.5:  # near the top, where fewer are
            path = path[: int(rng.integers(1, len(path) + 1))]
        holder = data
        for key in path[:-1]:
            holder = holder[key]
        key, kind, atom = path[-1], rng.random(), ATOMS[int(rng.integers(len(ATOMS)))]
        old, atom = holder[key], json.loads(json.dumps(atom))
        if kind < 0.45:
            holder[key] = atom
        elif kind < 0.6:
            del holder[key]
        elif kind < 0.7 and isinstance(holder, dict):
            holder[UNUSUAL[int(rng.integers(len(UNUSUAL)))]] = atom
        elif kind < 0.8 and isinstance(holder, list):
            holder.insert(int(key), json.loads(json.dumps(old)))
        elif isinstance(old, int | float) and not isinstance(old, bool):
            holder[key] = old * FACTORS[int(rng.integers(len(FACTORS)))] if abs(old) < 1e100 else 1.0
        else:
            holder[key] = [old, old]
    return data


def mutated(text: bytes, rng: np.random.Generator) -> bytes:
    """One change of the bytes: a flip, a cut, a piece doubled or a number become something else."""
    at, kind = int(rng.integers(len(text))), rng.integers(5)
    if kind == 0:
        return text[:at] + bytes([rng.integers(256)]) + text[at + 1 :]
    if kind == 1:
        return text[:at] + text[at + int(rng.integers(1, 40)) :]
    if kind == 2:
        return text[: at + 20] + text[at:]
    value = WRONG[int(rng.integers(len(WRONG)))].encode()
    ends = [i for i in (text.find(c, at + 1) for c in (b",", b"]", b"}", b"\n")) if i > 0]
    start = max(text.rfind(c, 0, at) for c in (b",", b"[", b":", b"=")) + 1
    return text[:start] + b" " + value + text[min(ends, default=len(text)) :]
