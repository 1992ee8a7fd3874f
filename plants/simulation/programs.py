"""Compiled programs of a long session: JAX keeps all of them, which is too many.

A flight with a Kalman filter takes 45 MB and 850 of the 65530 memory maps that Linux grants a process. The program
that finds none left does not raise: LLVM ends the process, and a notebook's variables with it.
"""

from typing import Any

KEPT = 32  # programs; at worst 27 000 maps


def make_room(*functions: Any) -> None:
    """Forget the programs of all jitted `functions` once they have `KEPT` together; those still used compile again.

    All at once, because JAX does not say which was used last, and so rarely that it costs nothing beside compiling.
    """
    if sum(function._cache_size() for function in functions) >= KEPT:
        for function in functions:
            function.clear_cache()
