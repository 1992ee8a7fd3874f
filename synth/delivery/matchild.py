"""Run as a program by `matfiles`, never imported: reads a .mat file from its input, writes its matrices as .npz.

SciPy's reader trusts what a file says of itself: one damaged byte can end the interpreter, or ask for all memory.
What is no real matrix is written as a text that says what it is. The fields of a struct of one element are written as
``name.field``, its texts as they are; a struct whose name was not asked for is written too, by its fields alone.
"""

import io
import sys
from typing import Any

MEMORY = 4 * 2**30  # bytes
DEEPEST = 2  # levels of structs
KINDS = {"c": "complex", "O": "a cell, a struct or sparse", "U": "text", "V": "a record"}


def main(names: list[str]) -> int:
    """0 when all was written; 1 with the reason on the error channel."""
    try:
        import resource  # not on Windows

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY, MEMORY))
    except (ImportError, ValueError, OSError):
        pass
    try:
        import numpy as np
        import scipy.io

        raw = sys.stdin.buffer.read()
        structs = [name for name, _, kind in scipy.io.whosmat(io.BytesIO(raw)) if kind == "struct"]
        found = scipy.io.loadmat(io.BytesIO(raw), variable_names=[*names, *structs])
        told: dict[str, Any] = {}

        def tell(name: str, M: Any, depth: int) -> None:
            """One variable, and what is in it."""
            M = np.asarray(M)
            if M.dtype.names and M.size == 1 and depth < DEEPEST:
                for field in M.dtype.names:
                    tell(f"{name}.{field}", M.ravel()[0][field], depth + 1)
            if depth == 0 and name not in names:
                return
            is_text = depth and M.dtype.kind == "U" and M.size == 1
            told[name] = M if M.dtype.kind in "fiu" or is_text else np.array(KINDS.get(M.dtype.kind, str(M.dtype)))

        for name, value in found.items():
            if name in names or name in structs:
                tell(name, value, 0)
        content = io.BytesIO()
        np.savez(content, **told)
        sys.stdout.buffer.write(content.getvalue())
        return 0
    except BaseException as error:  # SciPy raises what it meets in a damaged file
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
