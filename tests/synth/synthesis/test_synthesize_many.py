"""Random plants with one to three specifications: none is missed when measured, no refusal is without a reason."""

import numpy as np
import pytest

from synth import (
    H2,
    Disc,
    GeneralisedH2,
    GeneralizedPlant,
    Hinf,
    InfeasibleError,
    Peak,
    StrictlyProper,
    h2syn,
    hinfnorm,
    hinfsyn,
    synthesize,
)

OUTPUT = {"z": 0}  # channel of peaks


def drawn(rng: np.random.Generator) -> GeneralizedPlant:
    """A plant of up to six states in units over six decades, continuous or discrete."""
    N, dt = rng.standard_normal, 0.5 if rng.random() < 0.6 else 0.0
    n, nu, ny = int(rng.integers(1, 7)), int(rng.integers(1, 3)), int(rng.integers(1, 3))
    nw, nz = ny + int(rng.integers(1, 3)), nu + int(rng.integers(1, 3))
    A = N((n, n))
    if dt:
        A *= rng.uniform(0.5, 1.2) / np.abs(np.linalg.eigvals(A)).max()
    w, z, u, y = 10.0 ** rng.uniform(-3, 3, 4)
    D11, D22 = 0.3 * N((nz, nw)) * bool(dt), 0.1 * N((ny, nu)) * (rng.random() < 0.5)
    return GeneralizedPlant(
        A, w * N((n, nw)), u * N((n, nu)), z * N((nz, n)), w * z * D11, z * u * N((nz, nu)), y * N((ny, n)),
        w * y * N((ny, nw)), u * y * D22, dt=dt,
    )  # fmt: skip


def asked(P: GeneralizedPlant, rng: np.random.Generator) -> list:
    """Specifications that the H2-optimal loop does not meet as a rule."""
    best, robust = h2syn(P), hinfsyn(P)
    kinds = ["hinf", "energy", "disc", "proper", *(["peak"] if P.dt else [])]
    found = []
    for kind in rng.choice(kinds, size=int(rng.integers(1, 4)), replace=False):
        if kind == "hinf":
            part = rng.uniform(0.1, 0.9)
            found.append(Hinf() <= robust.gamma ** (1 - part) * best.design.gamma**part)
        elif kind == "disc":
            size = np.abs(best.closed_loop.poles()).max()
            found.append(
                Disc(0, size * rng.uniform(0.85, 1)) if P.dt else Disc(-1.3 * size, 1.3 * size * rng.uniform(0.9, 1))
            )
        elif kind == "proper":
            found.append(StrictlyProper())
        else:
            norm = (GeneralisedH2 if kind == "energy" else Peak)(**OUTPUT)
            found.append(norm <= norm.measured(P, best.closed_loop) * rng.uniform(0.7, 1.0))
    return found


def impulse_peak(G) -> float:
    """Sum of |h| of the first output, term by term."""
    h, x = [np.abs(G.D[0]).sum()], G.B
    for _ in range(4000):
        h.append(np.abs(G.C[0] @ x).sum())
        x = G.A @ x
    return float(np.sum(h))


def held(specification, P: GeneralizedPlant, design) -> None:
    """Measured by what `synthesize` does not use, where there is something."""
    G = design.closed_loop
    if isinstance(specification, StrictlyProper):
        assert not design.controller.D.any()
    elif isinstance(specification, Disc):
        assert np.abs(G.poles() - specification.centre).max() <= specification.radius * (1 + 1e-6)
    else:
        most = specification.level * (1 + 1e-6)
        assert specification.norm.measured(P, G) <= most
        if isinstance(specification.norm, Hinf):
            assert hinfnorm(G)[0] <= most
        elif isinstance(specification.norm, Peak):
            assert impulse_peak(G) <= most


@pytest.mark.slow
@pytest.mark.parametrize("block", range(6))
def test_no_specification_is_missed(block):
    met, reasons = 0, []
    for seed in range(10 * block, 10 * (block + 1)):
        rng = np.random.default_rng(1000 + seed)
        P = drawn(rng)
        specifications = asked(P, rng)
        try:
            design = synthesize(P, minimize=H2(), subject_to=specifications)
        except InfeasibleError as error:
            reasons.append(str(error))
            continue
        met += 1
        assert design.gamma >= h2syn(P).gamma * (1 - 1e-6)
        for specification in specifications:
            held(specification, P, design)
    assert met  # the block says something
    assert all(any(word in text for word in ("alone", "relaxed by a factor", "missed")) for text in reasons)
