"""A predictive controller's exported C, compiled, loaded, and stepped beside the controller in Python."""

import ctypes
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from exactmpc import random_program
from exported import STRICT, gcc

from synth.delivery.cmpc import sizes
from synth.delivery.formats import export
from synth.predictive.horizon import Mpc, MpcState
from synth.systems.statespace import StateSpace

REAL, WHOLE = ctypes.c_double, ctypes.c_int


def memory_of(controller: Mpc) -> type[ctypes.Structure]:
    """The state in C."""
    size = sizes(controller)
    n, m, N, rows = (size[key] for key in ("STATES", "OUTPUTS", "VARIABLES", "ROWS"))
    fields = [("inputs", REAL * (size["MEMORY"] * m)), ("momentum", REAL * m)]
    fields += [("forecast", REAL * n), ("known", WHOLE)] if size["VELOCITY"] else []
    fields += [("size", WHOLE), ("row", WHOLE * N), ("sign", REAL * N), ("iterations", WHOLE), ("error", REAL)]
    fields += [("allowed", WHOLE), ("taken", ctypes.c_ubyte * (N + rows))]
    fields += [(name, REAL * N) for name in "vyf"] + [(name, REAL * rows) for name in "bw"]
    fields += [("J", REAL * (N * N)), ("R", REAL * (N * N))]
    return type("Memory", (ctypes.Structure,), {"_fields_": fields})


class CompiledMpc:
    """The exported C as a shared library, called through ctypes.

    `status` and `last` are what the last step returned, `statuses` and `most` (exchanges of rows) what any step did.
    """

    def __init__(self, source: Path, controller: Mpc, *flags: str):
        self.name, self.controller = source.stem, controller
        self.n, self.m = controller.problem.model.B.shape
        library = source.with_suffix(".so")
        gcc(*STRICT, *flags, f"-D{self.name.upper()}_SELF_TEST", "-fPIC", "-shared", "-o", library, source, "-lm")
        self.library = ctypes.CDLL(str(library))
        self.memory = memory_of(controller)()
        self.statuses: set[int] = set()
        self.most = 0
        self.reset()

    def reset(self) -> None:
        getattr(self.library, f"{self.name}_reset")(ctypes.byref(self.memory))

    def self_test(self) -> int:
        return getattr(self.library, f"{self.name}_self_test")()

    def remember(self, state: MpcState) -> None:
        """What the controller in Python remembers, but for the working set."""
        self.memory.inputs[:] = state.inputs.ravel().tolist()
        self.memory.momentum[:] = state.momentum.tolist()
        if self.controller.problem.form == "velocity":
            self.memory.known = state.prediction is not None
            if state.prediction is not None:
                self.memory.forecast[:] = state.prediction.tolist()

    def step(self, y: np.ndarray, r: np.ndarray) -> np.ndarray:
        u = (REAL * self.m)(*[np.nan] * self.m)
        step = getattr(self.library, f"{self.name}_step")
        self.status = step(ctypes.byref(self.memory), (REAL * self.n)(*y), (REAL * self.n)(*r), u)
        self.statuses.add(self.status)
        self.most = max(self.most, self.iterations)
        self.last = np.array(u)
        return self.last

    @property
    def slack(self) -> bool:
        """Whether no row is at its limit but those that say that no soft limit is exceeded."""
        N = self.controller.problem.Nc * self.m
        return all(N <= row < len(self.controller.qp.P) for row in self.memory.row[: self.memory.size])

    @property
    def iterations(self) -> int:
        return self.memory.iterations


def exported(controller: Mpc, folder: Path, **options: Any) -> CompiledMpc:
    """The controller, exported as C and compiled, in a place of its own: a library that is loaded is not replaced."""
    folder = Path(tempfile.mkdtemp(dir=folder))
    export(controller, "c", folder, name="attitude", **options)
    return CompiledMpc(folder / "attitude.c", controller)


def flight(controller: Mpc) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
    """The controller in Python, with its memory: (y, r) -> u."""
    state = controller.init()

    def step(y: np.ndarray, r: np.ndarray) -> np.ndarray:
        nonlocal state
        state, u = controller.step(state, y, r)
        assert state.fallbacks == 0
        return u

    return step


def rescaled(seed: int, states: float, commands: float) -> tuple[StateSpace, dict[str, Any], np.ndarray, np.ndarray]:
    """A random program (model, options, x, r), its states and commands in units of random size up to these factors."""
    rng = np.random.default_rng(seed)
    G, options, x, r, *_ = random_program(rng, largest=8, growth=1.15)
    T, S = states ** rng.uniform(0, 1, G.n), commands * 10 ** rng.uniform(-2, 2, G.nu)  # x becomes T x, u S u
    model = StateSpace(T[:, None] * G.A / T, T[:, None] * G.B / S, G.C, G.D, G.dt)
    for name, scale in (("Q", 1 / T), ("terminal", 1 / T), ("R", 1 / S)):
        if options.get(name) is not None:
            weight = options[name] * np.eye(scale.size) if np.ndim(options[name]) == 0 else np.asarray(options[name])
            options[name] = scale[:, None] * weight * scale
    for name, scale in (("umin", S), ("umax", S), ("hmax", S), ("ymin", T), ("ymax", T)):
        if options.get(name) is not None:
            options[name] = np.asarray(options[name]) * scale
    return model, options, T * x, T * r
