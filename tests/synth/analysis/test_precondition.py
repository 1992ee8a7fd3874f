"""Conditioning: the way back is exact, weights change the scale only, and missing assumptions are named."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from literature import compleib, cubesat_pecorilla2024, mass_spring_chain, random_plant

from synth.analysis.norms import hinfnorm
from synth.analysis.precondition import check_assumptions, precondition
from synth.equations.hinf_riccati import RiccatiRoute
from synth.errors import AssumptionError, ModelError, NumericalError
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

seeds = st.integers(0, 10**6)
deficiencies = st.sampled_from(["none", "D12", "D21", "both"])


def some_plant(seed: int, n: int = 5, deficient: str = "none") -> GeneralizedPlant:
    return random_plant(seed, n, 3, 2, 3, 2, direct=True, deficient=deficient)


def rescaled(P: GeneralizedPlant, seed: int, decades: float) -> tuple[GeneralizedPlant, float]:
    """Other units for states, u, y, w and z, and the factor this puts on every closed-loop gain."""
    n, _, nu, _, ny = P.sizes
    rng = np.random.default_rng(seed)
    x, u, y = (10.0 ** rng.uniform(-decades, decades, k) for k in (n, nu, ny))
    w, z = 10.0 ** rng.uniform(-decades, decades, 2)
    Q = replace(
        P, A=P.A / x[:, None] * x, B1=P.B1 / x[:, None] * w, B2=P.B2 / x[:, None] * u,
        C1=z * P.C1 * x, D11=z * w * P.D11, D12=z * P.D12 * u,
        C2=y[:, None] * P.C2 * x, D21=y[:, None] * P.D21 * w, D22=y[:, None] * P.D22 * u,
    )  # fmt: skip
    return Q, w * z


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=seeds, n=st.integers(1, 8), deficient=deficiencies)
def test_restored_controller_gives_the_scaled_loop_times_the_scale(seed, n, deficient):
    P = some_plant(seed, n, deficient)
    c = precondition(P)
    K = StateSpace(*(0.1 * np.random.default_rng(seed).normal(size=s) for s in ((3, 3), (3, 2), (2, 3), (2, 2))), P.dt)
    scaled, original = c.plant.close(K), P.close(c.restore(K))
    assert not np.any(c.plant.D22)
    for omega in (0.0, 0.3, 2.0, np.pi):
        want = c.scale * scaled.frequency_response(omega)
        have = original.frequency_response(omega)
        assert np.linalg.norm(have - want) <= 1e-7 * np.linalg.norm(want)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=seeds, decades=st.sampled_from([3.0, 10.0]), deficient=deficiencies)
def test_extreme_units_are_conditioned_away(seed, decades, deficient):
    P = some_plant(seed, deficient=deficient)
    Q, factor = rescaled(P, seed, decades)
    S, T = precondition(P), precondition(Q)
    for c in (S, T):
        size = np.linalg.norm(c.plant.system.D) + np.linalg.norm(c.plant.A)
        assert 1e-2 < size < 1e5
    if deficient == "none":
        levels = [RiccatiRoute.of(c.plant).minimise()[0] * c.scale for c in (S, T)]
        assert levels[1] / factor == pytest.approx(levels[0], rel=5e-7)


@pytest.mark.parametrize("factor", [1e-3, 1e3, 1e10])
def test_weights_change_the_scale_and_nothing_else(factor):
    one, other = precondition(cubesat_pecorilla2024()), precondition(cubesat_pecorilla2024(factor))
    assert other.scale == pytest.approx(one.scale * factor**2, rel=1e-11)
    for name in ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21"):
        a, b = getattr(one.plant, name), getattr(other.plant, name)
        assert np.linalg.norm(a - b) <= 1e-10 * np.linalg.norm(a)


def test_optimal_level_of_the_scaled_plant_is_about_one():
    for P in (cubesat_pecorilla2024(), mass_spring_chain(20), some_plant(1)):
        c = precondition(P)
        assert 0.05 < RiccatiRoute.of(c.plant).minimise()[0] < 20
        assert np.linalg.cond(c.Su) < 1e6


def test_perfect_and_useless_channels_do_not_stop_it():
    P = some_plant(3)
    n, nw, nu, nz, ny = P.sizes
    for change in (
        {"D12": np.zeros((nz, nu))},
        {"D21": np.zeros((ny, nw))},
        {"D12": np.zeros((nz, nu)), "D21": np.zeros((ny, nw)), "D11": np.zeros((nz, nw))},
        {"B1": np.zeros((n, nw)), "D11": np.zeros((nz, nw)), "D21": np.zeros((ny, nw))},
        {"C1": np.zeros((nz, n)), "D11": np.zeros((nz, nw)), "D12": np.zeros((nz, nu))},
        {"B2": P.B2 * [1, 0], "D12": P.D12 * [1, 0], "D22": P.D22 * [1, 0]},
        {"B2": P.B2[:, [0, 0]], "D12": P.D12[:, [0, 0]]},
    ):
        c = precondition(replace(P, **change))
        assert np.isfinite(c.scale)
        assert c.scale > 0
        assert all(np.isfinite(M).all() for M in (c.plant.A, c.plant.B1, c.plant.B2, c.Su, c.Sy))


def test_algebraic_loop_through_the_plant_is_refused():
    P = some_plant(4, deficient="none")
    P = replace(P, D22=np.eye(2))
    c = precondition(P)
    D = -np.linalg.inv(c.Su) @ np.linalg.inv(c.Sy)
    with pytest.raises(NumericalError, match="algebraic loop"):
        c.restore(StateSpace(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((2, 0)), D, P.dt))


def test_continuous_plants_are_sent_to_the_cayley_map():
    with pytest.raises(ModelError, match="cayley"):
        precondition(compleib()["toy"][0])


def with_extra_mode(P: GeneralizedPlant, mode: float, seed: int, *, actuated: bool, sensed: bool) -> GeneralizedPlant:
    """One more mode, in random coordinates over eight decades, that u does not move or y does not see."""
    n, nw, nu, nz, ny = P.sizes
    rng = np.random.default_rng(seed)
    r = lambda *s: rng.normal(size=s)  # noqa: E731
    T = r(n + 1, n + 1) * 10.0 ** rng.uniform(-4, 4, n + 1)[:, None]
    Ti = np.linalg.inv(T)
    column, row = (np.zeros((n, 1)), r(1, n)) if actuated else (r(n, 1), np.zeros((1, n)))
    A = np.block([[P.A, column if not sensed or not actuated else r(n, 1)], [row, np.array([[mode]])]])
    B2 = np.vstack([P.B2, r(1, nu) if actuated else np.zeros((1, nu))])
    C2 = np.hstack([P.C2, r(ny, 1) if sensed else np.zeros((ny, 1))])
    if sensed and not actuated:
        A[-1, :-1] = 0
    return replace(
        P, A=T @ A @ Ti, B1=T @ np.vstack([P.B1, r(1, nw)]), B2=T @ B2,
        C1=np.hstack([P.C1, r(nz, 1)]) @ Ti, C2=C2 @ Ti,
    )  # fmt: skip


@settings(max_examples=60, deadline=None, derandomize=True)
@given(seed=seeds, n=st.integers(1, 8), mode=st.sampled_from([1.0, -1.0, 1.2, -3.0, 0.99, 0.3]), actuated=st.booleans())
def test_mode_out_of_reach_is_named_exactly_when_it_is_not_stable(seed, n, mode, actuated):
    P = with_extra_mode(some_plant(seed, n), mode, seed, actuated=actuated, sensed=not actuated)
    if abs(mode) < 1:
        check_assumptions(P)
        precondition(P)
        return
    with pytest.raises(AssumptionError) as caught:
        precondition(P)
    assert caught.value.assumption == ("(C2, A) detectable" if actuated else "(A, B2) stabilisable")
    assert any(abs(m - mode) < 1e-6 for m in caught.value.modes)


def test_continuous_plant_with_a_mode_out_of_reach_names_it():
    toy = compleib()["toy"][0]
    P = with_extra_mode(toy, 0.6065, 1, actuated=False, sensed=True)
    with pytest.raises(AssumptionError, match=r"no actuator moves the mode at eigenvalue 0\.6065") as caught:
        check_assumptions(P)
    assert caught.value.modes[0] == pytest.approx(0.6065, rel=1e-8)
    check_assumptions(with_extra_mode(toy, -0.6065, 1, actuated=False, sensed=True))


def test_no_false_alarms():
    for P, _ in compleib().values():
        check_assumptions(P)
    for n in (8, 50):
        check_assumptions(mass_spring_chain(n))
    for factor in (1e-10, 1.0, 1e10):
        check_assumptions(cubesat_pecorilla2024(factor))
    for seed in range(40):
        check_assumptions(rescaled(some_plant(seed, 8), seed, 10.0)[0])


def test_weakly_actuated_mode_is_no_false_alarm_and_still_controlled():
    P = some_plant(7, 4)
    A = np.block([[P.A, np.zeros((4, 1))], [np.zeros((1, 4)), np.array([[1.2]])]])
    weak = replace(
        P, A=A, B1=np.vstack([P.B1, np.ones((1, 3))]), B2=np.vstack([P.B2, [[1e-6, 0.0]]]),
        C1=np.hstack([P.C1, np.ones((3, 1))]), C2=np.hstack([P.C2, np.ones((2, 1))]),
    )  # fmt: skip
    c = precondition(weak)
    route = RiccatiRoute.of(c.plant)
    level, _ = route.minimise()
    design = hinfsyn(weak)
    assert hinfnorm(design.closed_loop)[0] <= 1.002 * level * c.scale
    assert design.gamma <= 1.05 * level * c.scale  # with what rounding may hide in a loop with gains of a million
    assert any("gain margin" in text for text in design.warnings)  # a loop that no satellite should fly
