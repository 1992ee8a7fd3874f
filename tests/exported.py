"""Exported controllers brought back to life for the tests: compiled, loaded, and replayed against plain loops."""

import ctypes
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from literature import cubesat_model

from synth.regulators.sequential import SequentialController

STRICT = ("-std=c99", "-O2", "-Wall", "-Wextra", "-pedantic", "-Werror", "-Wconversion")


def gcc(*arguments: object) -> None:
    """Run the C compiler, or skip the test where there is none."""
    if shutil.which("gcc") is None:
        pytest.skip("gcc compiles the exported C in this test and is not installed")
    done = subprocess.run(["gcc", *map(str, arguments)], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


class Compiled:
    """The exported C as a shared library, called through ctypes."""

    def __init__(self, source: Path, controller: SequentialController, *flags: str):
        self.name, self.n, (self.m, self.p) = source.stem, len(controller.A), controller.D.shape
        self.real = ctypes.c_float if controller.dtype == "float" else ctypes.c_double
        library = source.with_suffix(".so")
        gcc(*STRICT, *flags, f"-D{self.name.upper()}_SELF_TEST", "-fPIC", "-shared", "-o", library, source)
        self.library = ctypes.CDLL(str(library))

    def self_test(self) -> int:
        return getattr(self.library, f"{self.name}_self_test")()

    def replay(self, inputs: np.ndarray) -> np.ndarray:
        """Outputs (samples, m) after a reset, without a fault."""
        outputs, faults = self.replay_with_faults(inputs)
        assert not faults.any()
        return outputs

    def replay_with_faults(self, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Outputs (samples, m) after a reset, and what the step returned (samples,)."""
        size = self.n + self.m
        state, y, u = (self.real * size)(*[1.0] * size), (self.real * self.p)(), (self.real * self.m)()
        step = getattr(self.library, f"{self.name}_step")
        getattr(self.library, f"{self.name}_reset")(state)
        outputs, faults = np.zeros((len(inputs), self.m), self.real), np.zeros(len(inputs), int)
        for k, sample in enumerate(inputs):
            y[:] = sample.tolist()
            faults[k] = step(state, y, u)
            outputs[k] = u
        return outputs, faults


def plain_loop(c: SequentialController, inputs: np.ndarray) -> np.ndarray:
    """Outputs (samples, m) by scalar sums, written down once more and independent of the package."""
    return plain_loop_with_faults(c, inputs)[0]


def plain_loop_with_faults(c: SequentialController, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same, and where the command was held (samples,)."""
    real = c.A.dtype.type
    x, outputs, faults = [real(0)] * len(c.A), [], []
    held = [min(max(real(0), low), high) for low, high in zip(c.umin, c.umax, strict=True)]
    with np.errstate(all="ignore"):
        for y in inputs.astype(c.A.dtype):
            sums, u, deficit = [], [], []
            for i in range(len(c.D)):
                v = real(0)
                for j in range(len(x)):
                    v = v + c.C[i, j] * x[j]
                for j in range(len(y)):
                    v = v + c.D[i, j] * y[j]
                sums.append(v)
                u.append(c.umin[i] if v < c.umin[i] else c.umax[i] if v > c.umax[i] else v)
                deficit.append(u[i] - v)
            following = []
            for i in range(len(x)):
                total = real(0)
                for M, vector in ((c.A, x), (c.B, y), *([(c.L, deficit)] if c.L.any() else [])):
                    for j in range(len(vector)):
                        total = total + M[i, j] * vector[j]
                following.append(total)
            faults.append(not all(map(np.isfinite, [*y, *sums, *following])))
            if not faults[-1]:
                x, held = following, u
            outputs.append(held)
    return np.array(outputs, c.A.dtype), np.array(faults)


def closed_loop_inputs(controller: SequentialController, samples: int) -> np.ndarray:
    """Errors (samples, 6) that the CubeSat's controller sees: slews, sensor noise and a disturbance torque."""
    G, rng = cubesat_model(), np.random.default_rng(0)
    x, state, errors = np.zeros(6), controller.init(), []
    for k in range(samples):
        r = np.array([0.2, -0.1, 0.05, 0, 0, 0]) * (1 if k // 500 % 2 == 0 else -1)
        e = r - x - 1e-3 * rng.normal(size=6)
        state, u = controller.update(state, e)
        x = G.A @ x + G.B @ (u + 1e-6)
        errors.append(e)
    return np.array(errors)
