"""What the geostationary study is made of: sets of plants, anti-windup, predictive control, the lines of the thesis."""

import re

import geo_controllers as design
import geo_filter as filters
import geo_limited as limited
import geo_sensitivity as sensitivity
import numpy as np
import pytest
import scipy.linalg as sla
from geo_claims import HINF_TOTAL, REGULATOR_TOTAL, TOLERANCE, continuous, statements
from geo_counterparts import counterparts
from geo_flights import NEAR, Flight, Study
from hypothesis import given, settings
from hypothesis import strategies as st

from plants import Run
from plants.missions import geo
from synth import LinearController, StateSpace, c2d

PERIOD = 6.0
FIGURES = {1: 1, 2: 12, 3: 6, 4: 4, 5: 11, 6: 8}  # chapter -> figures, from the thesis's own list


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10**6), frequency=st.floats(1e-3, 3.1))
def test_drawn_thrusters_fill_the_set_to_its_edge(seed, frequency):
    """All singular values of (plant - I) / wI are 1 at every frequency."""
    plant = sensitivity.thrusters(np.random.default_rng(seed), PERIOD)
    weight = c2d(design.thesis_weights()[2], PERIOD / 60, "tustin")
    off = plant.frequency_response(frequency / PERIOD) - np.eye(3)
    wI = abs(weight.frequency_response(frequency / (PERIOD / 60))[0, 0])
    np.testing.assert_allclose(np.linalg.svd(off, compute_uv=False), wI, rtol=1e-9)
    assert np.abs(plant.poles()).max() < 1


@pytest.mark.parametrize(
    ("shift", "weights", "performance", "robustness"),
    [(0.1, design.CHAPTER6, 1.647, 0.3777), (0.1, design.CHAPTER5, 7.441, 0.3529), (0.1, design.CHEAP, 0.9555, 0.7885)],
)
def test_sensitivities_against_their_weights(shift, weights, performance, robustness):
    """Norms by a grid of frequencies agree with those of the study, and the level is above each."""
    d = design.mixed_sensitivity(geo.RATE, shift=shift, weights=weights)
    p = sensitivity.peaks(geo.RATE, d.controller, weights)
    assert (p.performance, p.robustness) == pytest.approx((performance, robustness), rel=1e-3)
    wP, _, wI = design.thesis_weights(weights)
    for curve, weight, norm in ((p.S, wP, p.performance), (p.T, wI, p.robustness)):
        products = [s * abs(weight.frequency_response(w)[0, 0]) for s, w in zip(curve, sensitivity.OMEGA, strict=True)]
        assert 0.99 * norm <= max(products) <= 1.0001 * norm
    assert max(p.performance, p.robustness) <= d.gamma
    assert max(p.performance, p.robustness) <= p.together <= p.performance + p.robustness


def test_regulators_are_robust_to_the_thesis_uncertainty_as_well():
    K, _ = design.thesis_regulator(geo.RATE, 200)
    static = StateSpace(np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((3, 0)), K)
    found = sensitivity.peaks(geo.RATE, static, design.CHAPTER6)
    assert found.robustness == pytest.approx(0.660, abs=1e-3)
    assert np.isnan(found.performance)


def test_the_regulator_of_continuous_time():
    """1.8709 (-0.2 %) and 13.6 cm where the held input gives 1.9065 (+1.7 %) and 15.9 cm."""
    found = continuous(geo.RATE)
    assert found.total == pytest.approx(1.8709, abs=5e-5)
    assert abs(found.total / REGULATOR_TOTAL - 1) < TOLERANCE
    assert found.off == pytest.approx(0.1361, abs=5e-4)
    assert HINF_TOTAL < 0.01 * found.total


@pytest.mark.slow
def test_three_measurements_show_five_states():
    assert filters.rank(filters.PAPER) == 5
    assert filters.seen(3).deviations[0] == np.inf
    assert filters.rank(filters.OURS) == 6


def stepped(controller, errors, limit=np.inf):
    """Commands (N, 3) for positions, and what is left of them under a limit."""
    state, commands = controller.init(), []
    for e in errors:
        state, u = controller.step(state, -e, np.zeros(len(e)))
        commands.append(np.clip(u, -limit, limit))
    return np.array(commands)


def test_anti_windup_changes_nothing_without_a_limit():
    """Both kinds, while the limit is not met."""
    plain, told, _ = limited.loop_shaping(geo.RATE, PERIOD)
    mixed = design.padded(design.sampled(design.mixed_sensitivity(geo.RATE).controller, 60.0, PERIOD), 12, 6)
    errors = 1e-4 * np.random.default_rng(0).normal(size=(200, 6))
    for without, guarded in ((plain, told), (mixed, limited.observing(mixed))):
        calm = stepped(without, errors)
        assert np.abs(calm).max() < limited.LIMIT
        np.testing.assert_allclose(stepped(guarded, errors), calm, rtol=0, atol=1e-12 * np.abs(calm).max() + 1e-18)


def held(controller, samples):
    """The state after so many samples 1 km away, whatever is done about it."""
    state = controller.init()
    for _ in range(samples):
        state, _ = controller.step(state, np.r_[np.full(3, -1e3), np.zeros(3)], np.zeros(6))
    return state


def test_anti_windup_forgets_while_the_limit_holds():
    """A - L C is stable and the state comes to rest, where the integrators of the loop shaping alone grow on."""
    plain, told, _ = limited.loop_shaping(geo.RATE, PERIOD)
    mixed = design.padded(design.sampled(design.mixed_sensitivity(geo.RATE).controller, 60.0, PERIOD), 12, 6)
    for guarded in (told, limited.observing(mixed)):
        assert np.abs(np.linalg.eigvals(guarded.A - guarded.L @ guarded.C)).max() < 1
        early, late = held(guarded, 5000), held(guarded, 10000)
        np.testing.assert_allclose(late, early, rtol=0, atol=1e-3 * np.abs(late).max())
    integrators = slice(-3, None)
    assert (np.abs(held(plain, 10000)[integrators]) > 1.9 * np.abs(held(plain, 5000)[integrators])).all()


def test_predictive_control_without_a_limit_is_the_regulator_of_its_cost():
    n, dt, km = geo.RATE, 60.0, 1e-3
    controller = limited.quadratic(n, 1e3, dt)
    G = design.relative_motion(n)
    model = c2d(StateSpace(G.A, G.B, np.eye(6), np.zeros((6, 3))), dt)
    Q, R = np.diag([km**2] * 3 + [(60 * km) ** 2] * 3), 200 * (3600 * km) ** 2 * np.eye(3)
    P = sla.solve_discrete_are(model.A, model.B, Q, R)
    K = np.linalg.solve(R + model.B.T @ P @ model.B, model.B.T @ P @ model.A)
    x = np.r_[30.0, -20.0, 10.0, 1e-3, 2e-3, -1e-3]
    u = controller.step(controller.init(), x, np.zeros(6))[1]
    np.testing.assert_allclose(u, -K @ x, rtol=1e-6, atol=1e-9)
    assert isinstance(design.padded(design.thesis_feedback(n, 200, PERIOD), 12, 6), LinearController)


def flight(position):
    """A flight of these positions (N, 3)."""
    zero = np.zeros((len(position), 3))
    time = PERIOD * np.arange(len(position))
    return Flight(Run(duration=time[-1], time=time, states=None, outputs=np.hstack([position, zero]), estimates=zero,
                      references=zero, commands=zero, inputs=zero, extra=None, ok=True, failed_at=None, culprit="",
                      compiled=True), PERIOD)  # fmt: skip


@given(scale=st.floats(0.01, 1e6), past=st.floats(0, 3))
def test_overshoot_is_a_share_of_the_start(scale, past):
    """In any units, on either side, of the worst axis."""
    x = scale * np.array([[1.0, -1.0, 1.0], [0.2, 0.5 * past, -past], [0.0, 0.0, 0.0]])
    assert flight(x).overshoot == pytest.approx(100 * past, abs=1e-9)


def test_every_figure_of_the_thesis_has_its_line():
    """Once each; the rest are equations and remarks."""
    lines = [claim.source for claim in counterparts()]
    listed = [line.removeprefix("figure ") for line in lines if line.startswith("figure ")]
    assert len(listed) == len(set(listed))
    expected = {f"{chapter}.{k}" for chapter, figures in FIGURES.items() for k in range(1, figures + 1)}
    assert set(listed) == expected
    assert all(claim.why or claim.measured for claim in counterparts())


def test_every_claim_has_a_rule_and_one_threshold_for_one_quantity():
    claims = statements(Study(days=2))
    assert all(s.rule for s in claims)
    assert len({s.text for s in claims}) == len(claims)
    bounds = {}
    for s in claims:
        if s.rule.quantity.startswith(("position from", "change of a coordinate")):
            assert (s.rule.bound, s.rule.unit) == (100 * geo.BOX, "cm")
        if s.rule.relation in ("<=", ">"):
            assert bounds.setdefault(s.rule.quantity, s.rule.bound) == s.rule.bound
    assert not any(re.search(r"\bmedian\b", s.rule.quantity) for s in claims)
    assert NEAR[0] == 1.0
