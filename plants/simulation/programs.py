"""Compiled programs: what the compiler is told, and where its work is kept, in this process and on disk.

A flight with a Kalman filter takes seconds to compile and a fraction of one to fly. So compiled flights are kept by
JAX's persistent cache, which knows them by their code, the versions of JAX and XLA, the compiler's options and the
instruction set of the machine:

    CONVEX_SYNTH_CACHE      the folder, or "off"; by default convex-synth in the user's cache folder
                            ($XDG_CACHE_HOME or ~/.cache, ~/Library/Caches, %LOCALAPPDATA%), private to the user

A caller who has given JAX a cache keeps it, and JAX's configuration is as it was after every call. A folder that cannot
be used, or that somebody else could have written into, is left alone: then everything is compiled anew.

In this process programs are forgotten in time: a flight with a Kalman filter takes 45 MB and 850 of the 65530 memory
maps that Linux grants a process. The program that finds none left does not raise: LLVM ends the process, and a
notebook's variables with it.
"""

import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache, cached_property
from pathlib import Path
from typing import Any

import jax
from jax.core import Tracer
from jax.experimental.compilation_cache import compilation_cache

KEPT = 32  # programs; at worst 27 000 maps
SWITCH = "CONVEX_SYNTH_CACHE"
SIZE = 256 << 20  # bytes on disk, the oldest programs go first; the CubeSat study takes 5 MB
QUICK = 0.05  # s, what compiles faster is not kept on disk

# the emitters of fused kernels that XLA took in 2025 need half as long again for the long chains of small arrays here
OPTIONS: dict[str, bool | int] = {"xla_cpu_use_fusion_emitters": False}
UNOPTIMISED = {"xla_backend_optimization_level": 0}  # what runs a few times: a third of the time to compile

_compiling = threading.RLock()  # JAX's configuration is that of the whole process
_broken: list[Path] = []  # folders that have failed in this process


class Program:
    """A traceable function, compiled once for every form of its arguments.

    Parameters
    ----------
    function : traceable
    static : names of the arguments that are part of the program, hashable
    once : whether it runs so seldom that optimising it would take longer than it saves
    """

    def __init__(self, function: Callable[..., Any], static: tuple[str, ...] = (), *, once: bool = False) -> None:
        self.__doc__ = function.__doc__
        self._function, self._static, self._once = function, static, once
        self._known: set[Any] = set()

    @cached_property
    def jitted(self) -> Any:
        """The function for a loop that has called this object before: it costs less, and keeps nothing on disk."""
        return jax.jit(self._function, static_argnames=self._static, compiler_options=options(self._once))

    def __call__(self, *args: Any, on_compile: Callable[[], None] | None = None) -> Any:
        """The function's result; `on_compile` is called before this form is compiled or fetched from the disk."""
        leaves, structure = jax.tree.flatten(args)
        if any(isinstance(leaf, Tracer) for leaf in leaves):
            return self._function(*args)  # part of another program
        key = structure, tuple((a.shape, a.dtype) if hasattr(a, "dtype") else a for a in leaves)
        if self._cache_size() < len(self._known):
            self._known.clear()  # jax.clear_caches was called
        if key in self._known:
            return self.jitted(*args)
        if on_compile is not None:
            on_compile()
        result = _kept(lambda: self.jitted(*args))
        self._known.add(key)
        return result

    def _cache_size(self) -> int:
        return self.jitted._cache_size()

    def clear_cache(self) -> None:
        """Forget all programs of this process."""
        self._known.clear()
        self.jitted.clear_cache()


def make_room(*programs: Program) -> None:
    """Forget all `programs` once they have `KEPT` forms together; those still used are compiled or fetched again.

    All at once, because JAX does not say which was used last, and so rarely that it costs nothing beside compiling.
    """
    if sum(program._cache_size() for program in programs) >= KEPT:
        for program in programs:
            program.clear_cache()


@cache
def options(once: bool = False) -> dict[str, bool | int] | None:
    """`OPTIONS`, with `UNOPTIMISED` for what runs once, or None where this XLA does not know them."""
    asked = {**OPTIONS, **UNOPTIMISED} if once else OPTIONS
    try:
        jax.jit(lambda: 0, compiler_options=asked)()
    except Exception:
        return None
    return asked


def folder() -> Path | None:
    """Where programs are kept on disk; None if that is switched off, or there is no place only we can write to."""
    asked = os.environ.get(SWITCH, "")
    if asked.lower() == "off":
        return None
    try:
        path = Path(asked).expanduser() if asked else _user_cache() / "convex-synth"
        path.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = path.stat()
        ours = not hasattr(os, "getuid") or (found.st_uid == os.getuid() and not found.st_mode & 0o022)
        usable = ours and os.access(path, os.R_OK | os.W_OK | os.X_OK)
    except (OSError, RuntimeError):  # read-only, no home
        return None
    return path if usable else None


def _user_cache() -> Path:
    """The user's cache folder; RuntimeError without a home."""
    if sys.platform == "win32" and os.environ.get("LOCALAPPDATA"):
        return Path(os.environ["LOCALAPPDATA"])
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches"
    named = os.environ.get("XDG_CACHE_HOME", "")
    return Path(named) if os.path.isabs(named) else Path.home() / ".cache"  # relative ones count as unset


def _kept(call: Callable[[], Any]) -> Any:
    """What `call` returns; what it compiles is fetched from the disk and kept there, if the caller has no cache."""
    path, theirs = folder(), jax.config.values.get("jax_compilation_cache_dir")
    if path is None or path in _broken or theirs is not None:
        return call()
    with _compiling:
        try:
            with _cache_in(path):
                result = call()
        except Exception:
            result = call()  # raises again if the cache was not at fault
            _broken.append(path)
            _shrink(path, -1)  # all of them
        else:
            _shrink(path, SIZE)
    return result


@contextmanager
def _cache_in(path: Path) -> Iterator[None]:
    """JAX's persistent cache in a folder, its errors raised; then JAX's configuration as it was."""
    settings = {
        "jax_compilation_cache_dir": str(path),
        "jax_compilation_cache_max_size": -1,  # JAX's own bound needs another package, and a killed process breaks it
        "jax_persistent_cache_min_compile_time_secs": QUICK,
        "jax_persistent_cache_min_entry_size_bytes": -1,
        "jax_persistent_cache_enable_xla_caches": "none",
        "jax_raise_persistent_cache_errors": True,
    }
    before = {name: jax.config.values[name] for name in settings}
    compilation_cache.reset_cache()
    try:
        for name, value in settings.items():
            jax.config.update(name, value)
        yield
    finally:
        for name, value in before.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()


def _shrink(path: Path, size: int) -> None:
    """Remove the oldest programs of a folder until those that are left take `size` bytes at most."""
    with suppress(OSError):  # another process does the same
        files = sorted(((file.stat(), file) for file in path.glob("*-cache")), key=lambda pair: -pair[0].st_mtime)
        total = 0
        for found, file in files:
            total += found.st_size
            if total > size:
                file.unlink(missing_ok=True)
