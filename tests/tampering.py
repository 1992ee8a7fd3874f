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
