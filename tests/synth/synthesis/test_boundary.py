"""Zeros on the stability boundary: no controller may cancel them, and what is called verified is above their bound."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synth.analysis.norms import verify
from synth.errors import VerificationError
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace


def with_boundary_zero(seed: int, n: int, m: int, dt: float) -> tuple[GeneralizedPlant, complex]:
    """A plant whose u reaches all of z, and a zero of its P12 on the stability boundary."""
    rng = np.random.default_rng(seed)
    r = rng.standard_normal
    F = np.diag(rng.uniform(0.1, 0.8, n) if dt else -rng.uniform(0.3, 3, n))
    F[0, 0] = 1.0 if dt else 0.0
    if n > 2 and seed % 2:  # a pair instead
        w = rng.uniform(0.2, 2)
        F[:2, :2] = [[np.cos(w), np.sin(w)], [-np.sin(w), np.cos(w)]] if dt else [[0, w], [-w, 0]]
        zero = np.exp(1j * w) if dt else 1j * w
    else:
        zero = complex(F[0, 0])
    T = np.linalg.qr(r((n, n)))[0]
    F, B2, C1, D12 = T @ F @ T.T, r((n, m)), r((m, n)), r((m, m)) + 2 * np.eye(m)
    A = F + B2 @ np.linalg.solve(D12, C1)  # so that perfect control leaves F
    ny = 1 + seed % 2
    C2, D21 = r((ny, n)), np.hstack([0.1 * r((ny, 1)), np.eye(ny)])
    return GeneralizedPlant(A, r((n, ny + 1)), B2, C1, 0.3 * r((m, ny + 1)), D12, C2, D21, np.zeros((ny, m)), dt), zero


def bound(P: GeneralizedPlant, zero: complex) -> float:
    """Interpolation: with v'[A - zero I, B2; C1, D12] = 0 every stable loop has v2' z = -v'[B1; D11] w at the zero."""
    M = np.block([[P.A - zero * np.eye(len(P.A)), P.B2], [P.C1, P.D12]])
    v = np.linalg.svd(M)[0][:, -1].conj()
    return float(np.linalg.norm(v @ np.vstack([P.B1, P.D11])) / np.linalg.norm(v[len(P.A) :]))


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 10**6), st.integers(1, 5), st.integers(1, 2), st.sampled_from([0.0, 1.0]))
def test_norms_are_above_the_bound_of_a_zero_on_the_boundary(seed, n, m, dt):
    P, zero = with_boundary_zero(seed, n, m, dt)
    design = hinfsyn(P)
    assert design.gamma >= bound(P, zero) * (1 - 1e-6)
    loop = P.close(design.controller)
    s = [np.exp(1j * w) if dt else 1j * w for w in np.geomspace(1e-4, np.pi, 400)]
    peak = max(np.linalg.norm(loop.C @ np.linalg.solve(z * np.eye(loop.n) - loop.A, loop.B) + loop.D, 2) for z in s)
    assert peak <= design.gamma * (1 + 1e-9)


@pytest.mark.parametrize("dt", [0.0, 1.0])
def test_a_loop_that_is_stable_by_rounding_only_is_not_stable(dt):
    nearly = np.nextafter(1.0, 0.0) if dt else -1e-17
    A = np.array([[nearly, 1.0], [0.0, 0.5 if dt else -1.0]])
    T = np.array([[0.6, -0.8], [0.8, 0.6]])  # in other coordinates nobody knows on which side it is
    turned = StateSpace(T.T @ A @ T, T.T, T, 0, dt)
    for system in (StateSpace(A, np.eye(2), np.eye(2), 0, dt), turned) if dt else (turned,):  # -1e-17 is a double
        with pytest.raises(VerificationError, match=r"within rounding of its own entries|unstable"):
            verify(system)
