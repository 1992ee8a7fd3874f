"""One system in every form that `synth` takes."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import control
import numpy as np
import scipy.signal as signal

import synth

NUM, DEN, DT = [0.5, 1.0], [1.0, 0.4, 1.0], 0.5
OMEGA = np.array([0.03, 0.4, 1.1, 2.5])


def plant(dt: float) -> synth.StateSpace:
    """(0.5 s + 1) / (s^2 + 0.4 s + 1), sampled with a hold where dt is not zero."""
    G = synth.system(NUM, DEN)
    return synth.c2d(G, dt) if dt else G


def polynomials(dt: float) -> tuple[np.ndarray, np.ndarray]:
    tf = plant(dt).tf()
    return np.asarray(tf.num[0][0]), np.asarray(tf.den[0][0])


def nonlinear(dt: float) -> control.NonlinearIOSystem:
    """Whose linearisation at rest is the plant."""
    G = plant(dt)
    return control.NonlinearIOSystem(
        lambda t, x, u, params: G.A @ x + G.B @ u + np.sum(x**2) * x,
        lambda t, x, u, params: G.C @ x + G.D @ u,
        inputs=1, outputs=1, states=2, dt=dt,
    )  # fmt: skip


FORMS: dict[str, Callable[[float], Any]] = {
    "StateSpace": plant,
    "control.StateSpace": lambda dt: plant(dt).to_control(),
    "control.TransferFunction": lambda dt: control.tf(*polynomials(dt), dt),
    "control.zpk": lambda dt: control.zpk(*signal.tf2zpk(*polynomials(dt)), dt=dt),
    "nonlinear system of control": nonlinear,
    "scipy StateSpace": lambda dt: signal.StateSpace(*plant(dt).matrices, **({"dt": dt} if dt else {})),
    "scipy TransferFunction": lambda dt: signal.TransferFunction(*polynomials(dt), **({"dt": dt} if dt else {})),
    "scipy ZerosPolesGain": lambda dt: signal.ZerosPolesGain(
        *signal.tf2zpk(*polynomials(dt)), **({"dt": dt} if dt else {})
    ),
    "harold State": lambda dt: SimpleNamespace(
        **dict(zip("abcd", plant(dt).matrices, strict=True)), SamplingPeriod=dt or None
    ),
    "harold Transfer": lambda dt: SimpleNamespace(
        num=polynomials(dt)[0][None], den=polynomials(dt)[1][None], SamplingPeriod=dt or None
    ),
    "(A, B, C, D, dt)": lambda dt: (*plant(dt).matrices, dt),
    "lists, D = 0, vectors": lambda dt: (
        plant(dt).A.tolist(), *(np.ravel(M).tolist() for M in plant(dt).matrices[1:3]), 0, dt
    ),
    "(num, den, dt)": lambda dt: (*(p.tolist() for p in polynomials(dt)), dt),
    "(num, den, dt) in control's nesting": lambda dt: ([[polynomials(dt)[0]]], [[polynomials(dt)[1]]], dt),
    "mapping of matrices": lambda dt: dict(zip("ABCD", plant(dt).matrices, strict=True)) | {"dt": dt},
    "mapping of polynomials": lambda dt: dict(zip(("num", "den"), polynomials(dt), strict=True)) | {"dt": dt},
    "mapping of roots": lambda dt: dict(zip(("zeros", "poles", "gain"), signal.tf2zpk(*polynomials(dt)), strict=True))
    | {"dt": dt},
    "LinearController": lambda dt: synth.LinearController(*plant(dt).matrices, dt=dt),
}  # fmt: skip
