"""Several specifications at once: met when measured, the least level known, units, channels, discs, refusals."""

import numpy as np
import pytest

from synth import (
    H2,
    AssumptionError,
    Design,
    Disc,
    GeneralisedH2,
    GeneralizedPlant,
    Hinf,
    InfeasibleError,
    ModelError,
    StrictlyProper,
    h2norm,
    h2syn,
    hinfnorm,
    hinfsyn,
    synthesize,
)
from synth.synthesis.combined import Search, mapped
from synth.synthesis.tasks import Task


def random_plant(rng, dt: float = 0.5, n: int = 2) -> GeneralizedPlant:
    N, nu, ny, nw, nz = rng.standard_normal, 1, 1, 3, 3
    return GeneralizedPlant(
        N((n, n)), N((n, nw)), N((n, nu)), N((nz, n)), 0.3 * N((nz, nw)), N((nz, nu)), N((ny, n)), N((ny, nw)),
        0.1 * N((ny, nu)), dt=dt,
    )  # fmt: skip


def between(a: float, b: float, part: float = 0.5) -> float:
    return a ** (1 - part) * b**part


@pytest.mark.parametrize("method", ["standard", "extended"])
@pytest.mark.parametrize("proper", [False, True])
def test_one_specification_is_that_of_the_riccati_equations(method, proper):
    rng = np.random.default_rng(5)
    for _ in range(3):
        P = random_plant(rng)
        task = Task.of(P, H2(), [StrictlyProper()] if proper else [], method)
        search = Search(task, *mapped(task))
        level, _ = search.least()
        assert level * search.scaled.scale == pytest.approx(h2syn(P, strictly_proper=proper).optimum, rel=1e-4)
        K = search.centred(level, 1.0, 1e-3, "")
        assert K.values[0] <= 1.001 * level * search.scaled.scale
        assert not (proper and K.controller.D.any())


def test_h2_under_an_h_infinity_bound():
    """The bound holds, the level is between those without and with it alone, extended is not worse than standard."""
    rng = np.random.default_rng(6)
    drawn = 0
    while drawn < 2:
        P = random_plant(rng)
        best, robust = h2syn(P), hinfsyn(P)
        if best.design.gamma < 1.1 * robust.gamma:
            continue
        drawn += 1
        bound = between(robust.gamma, best.design.gamma)
        found = [synthesize(P, minimize=H2(), subject_to=[Hinf() <= bound], method=m) for m in ("standard", "extended")]
        for design in found:
            assert hinfnorm(design.closed_loop)[0] <= bound * (1 + 1e-6)
            assert best.gamma * (1 - 1e-9) <= design.gamma == h2norm(design.closed_loop)
            objective, hinf = design.specifications
            assert objective.measured <= objective.claimed * 1.01
            assert (objective.level, hinf.level) == (None, bound)
            assert hinf.claimed >= bound
            assert hinf.alone == pytest.approx(robust.gamma, rel=2e-3)
        tasks = (Task.of(P, H2(), [Hinf() <= bound], m) for m in ("standard", "extended"))
        standard, extended = (Search(task, *mapped(task)).least()[0] * mapped(task)[0].scale for task in tasks)
        assert extended <= standard * (1 + 1e-3)
        assert extended <= 2 * best.gamma


def test_bounds_that_cost_nothing_cost_nothing():
    P = random_plant(np.random.default_rng(7))
    best = h2syn(P)
    design = synthesize(P, minimize=H2(), subject_to=[Hinf() <= 1.01 * best.design.gamma, Disc(0, 1)])
    assert design.gamma == pytest.approx(best.gamma, rel=1e-9)
    assert design.info.method == "alone"
    assert [told.claimed for told in design.specifications] == [None] * 3


@pytest.mark.parametrize("method", ["standard", "extended"])
def test_a_disc_holds_the_poles(method):
    rng = np.random.default_rng(8)
    for _ in range(3):
        P = random_plant(rng)
        farthest = np.abs(h2syn(P).closed_loop.poles()).max()
        design = synthesize(P, minimize=H2(), subject_to=[Disc(0, 0.7 * farthest)], method=method)
        assert np.abs(design.closed_loop.poles()).max() <= 0.7 * farthest
        assert h2syn(P).gamma < design.gamma < 10 * h2syn(P).gamma
        assert design.specifications[1].measured <= 0.7 * farthest


def test_a_disc_in_continuous_time():
    rng = np.random.default_rng(9)
    G = random_plant(rng, 0.0)
    best = hinfsyn(G)
    size = 3 * np.abs(best.closed_loop.poles().real).max()
    design = synthesize(G, minimize=Hinf(), subject_to=[Disc(-size, 0.9 * size)])
    assert (np.abs(design.closed_loop.poles() + size) <= 0.9 * size).all()
    assert best.info.optimum * (1 - 1e-6) <= design.gamma == pytest.approx(design.design.gamma, rel=1e-9)


def test_the_cayley_map_takes_discs_to_discs():
    disc, rate = Disc(-3.0, 2.5), 2.0
    moved = disc.moved(rate)
    edge = disc.centre + disc.radius * np.exp(1j * np.linspace(0, 6, 20))
    np.testing.assert_allclose(np.abs((rate + edge) / (rate - edge) - moved.centre), moved.radius, rtol=1e-12)
    with pytest.raises(ModelError, match="left half plane"):
        Disc(0.0, 3.0).moved(rate)


def test_channels_by_name_and_number():
    P = random_plant(np.random.default_rng(10))
    named = GeneralizedPlant(*(getattr(P, k) for k in ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22")),
                             dt=P.dt, w=("gust", "bias", "noise"), z=("angle", "rate", "effort"))  # fmt: skip
    channel = {"w": ["gust", 2], "z": "angle"}
    G = Hinf(**channel).channel(named)
    np.testing.assert_array_equal(G.D11, P.D11[[0], :][:, [0, 2]])
    assert (G.w, G.z) == (("gust", "noise"), ("angle",))
    free = synthesize(named, minimize=H2(z=["angle", "effort"]))
    peak = GeneralisedH2(**channel).measured(named, free.closed_loop)
    least = hinfsyn(named).gamma
    design = synthesize(
        named, minimize=H2(z=["angle", "effort"]), subject_to=[Hinf() <= 2 * least, GeneralisedH2(**channel) <= peak]
    )
    told = design.specifications
    assert [t.name for t in told] == [
        "H2(z=['angle', 'effort'])", "Hinf()", "GeneralisedH2(w=['gust', 'noise'], z=['angle'])",
    ]  # fmt: skip
    assert told[1].measured <= 2 * least * (1 + 1e-6)
    assert told[2].measured <= peak * (1 + 1e-6)
    for wrong in ("wind", 3, -1, [], [0, "gust"], True, 1.0):
        with pytest.raises(ModelError, match=r"^w "):
            synthesize(named, minimize=H2(w=wrong))


def test_generalised_h2_is_the_peak_for_energy_one():
    """The worst input is the impulse response backwards."""
    P = random_plant(np.random.default_rng(11))
    G = h2syn(P).closed_loop
    h = np.array([G.D, *(G.C @ np.linalg.matrix_power(G.A, k) @ G.B for k in range(400))])
    value = GeneralisedH2().measured(P, G)
    _, V = np.linalg.eigh(np.einsum("kij,klj->il", h, h))
    w = np.einsum("kij,i->kj", h, V[:, -1])
    w /= np.linalg.norm(w)
    assert np.linalg.norm(np.einsum("kij,kj->i", h, w)) == pytest.approx(value, rel=1e-9)


def test_units_change_nothing():
    rng = np.random.default_rng(12)
    P = random_plant(rng)
    n, _, nu, _, ny = P.sizes
    x, u, y = (10.0 ** rng.uniform(-3, 3, k) for k in (n, nu, ny))
    w, z = 1e3, 1e-7
    moved = GeneralizedPlant(
        P.A * x / x[:, None], P.B1 * w / x[:, None], P.B2 * u / x[:, None], z * P.C1 * x, z * w * P.D11,
        z * P.D12 * u, P.C2 * x * y[:, None], w * P.D21 * y[:, None], P.D22 * u * y[:, None], dt=P.dt,
    )  # fmt: skip
    bound = between(hinfsyn(P).gamma, h2syn(P).design.gamma)
    one, other = (synthesize(G, minimize=H2(), subject_to=[Hinf() <= bound * k]) for G, k in ((P, 1.0), (moved, w * z)))
    assert other.gamma == pytest.approx(w * z * one.gamma, rel=1e-4)


def test_what_cannot_be_met_is_refused_with_a_reason():
    P = random_plant(np.random.default_rng(13))
    with pytest.raises(InfeasibleError, match=r"H2\(\) <= .* is the least .* alone"):
        synthesize(P, minimize=Hinf(), subject_to=[H2() <= 0.9 * h2syn(P).gamma])
    with pytest.raises(InfeasibleError, match=r"poles within 1e-09 of 0\.5"):
        synthesize(P, minimize=Hinf(), subject_to=[Disc(0.5, 1e-9)])
    stuck = GeneralizedPlant(
        [[2, 0], [0, 0.5]], [[1, 0], [0, 0]], [[1], [0]], [[1, 1], [0, 0]], np.zeros((2, 2)), [[0], [1]], [[1, 0]],
        [[0, 1]], 0, dt=1.0,
    )  # fmt: skip
    with pytest.raises(InfeasibleError, match="no control moves"):
        synthesize(stuck, minimize=H2(), subject_to=[Disc(0, 0.3)])
    with pytest.raises(AssumptionError, match="eigenvalue 2 of A"):
        synthesize(GeneralizedPlant(2, 1, 0, 1, 0, 1, 1, 1, 0, dt=1.0), minimize=H2())


def test_wrong_arguments():
    P, C = random_plant(np.random.default_rng(14)), random_plant(np.random.default_rng(14), 0.0)
    for call, text in (
        (lambda: synthesize(P, minimize="H2"), "minimize"),
        (lambda: synthesize(P, minimize=H2() <= 1), "minimize"),
        (lambda: synthesize(P, minimize=H2(), subject_to=H2() <= 1), "subject_to"),
        (lambda: synthesize(P, minimize=H2(), subject_to=[Hinf()]), "subject_to"),
        (lambda: synthesize(P, minimize=H2(), subject_to=[Disc(0, 1), Disc(0, 2)]), "2 discs"),
        (lambda: synthesize(P, minimize=H2(), method="lmi"), "method"),
        (lambda: synthesize(C, minimize=H2(), method="extended"), "discrete time"),
        (lambda: synthesize(C, minimize=H2()), "direct term D11"),
        (lambda: synthesize(C, minimize=Hinf(), subject_to=[StrictlyProper()], method="standard"), "discrete time"),
        (lambda: Hinf() <= -1, "level"),
        (lambda: Disc(0, 0), "radius"),
        (lambda: Disc("0", 1), "centre"),
    ):
        with pytest.raises(ModelError, match=text):
            call()


def test_what_it_returns(tmp_path):
    P = random_plant(np.random.default_rng(15))
    design = synthesize(P, minimize=Hinf(), subject_to=[StrictlyProper()])
    K, CL, gamma, info = design
    assert (K.nstates, CL.ninputs, gamma, info) == (2, 3, design.gamma, design.info)
    assert not design.controller.D.any()
    assert hinfsyn(P).gamma < 1.001 * gamma
    assert f"{gamma:.7g}" in repr(design)
    again = Design.load(design.design.save(tmp_path / "design.json"))
    assert again.gamma == pytest.approx(gamma, rel=1e-9)
