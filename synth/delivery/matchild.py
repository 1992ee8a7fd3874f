"""Run as a program by `matfiles`, never imported: reads a .mat file from its input, writes its matrices as .npz.

SciPy's reader trusts what a file says of itself: one damaged byte can end the interpreter, or ask for all memory.
What is no real matrix is written as a text that says what it is.
"""

import io
import sys
from typing import Any

MEMORY = 4 * 2**30  # bytes
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

        found = scipy.io.loadmat(io.BytesIO(sys.stdin.buffer.read()), variable_names=names)
        kept = {name: np.asarray(value) for name, value in found.items() if name in names}
        told: dict[str, Any] = {
            name: M if M.dtype.kind in "fiu" else np.array(KINDS.get(M.dtype.kind, str(M.dtype)))
            for name, M in kept.items()
        }
        content = io.BytesIO()
        np.savez(content, **told)
        sys.stdout.buffer.write(content.getvalue())
        return 0
    except BaseException as error:  # SciPy raises what it meets in a damaged file
        print(f"{type(error).__name__}: {error}", file=sys.stderr)
        return 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
