"""The laws and rules of the SDRE studies without their flights: fair opponents, matrices of the papers, thresholds."""

from typing import Any, cast

import airbearing as bearing
import airbearing_claims
import airbearing_flights
import amazonia1 as study
import amazonia1_claims
import amazonia1_flights
import amazonia1_pointwise as pointwise
import amazonia1_region as region
import amazonia1_region_claims
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plants import draw
from plants.dynamics.eulerbody import kinematics
from plants.missions import airbearing, amazonia1
from plants.outcome.claims import judged
from synth import lqrd, quaternion_pd
from synth.regulators.regulator import sampled_cost

ANGLE = st.floats(-3.1, 3.1)
TARGETS = st.tuples(ANGLE, st.floats(-1.5, 1.5), ANGLE)


@settings(deadline=None, max_examples=30)
@given(TARGETS)
def test_inverse_kinematics(angles):
    a = np.array(angles)
    np.testing.assert_allclose(np.asarray(bearing.inverse(a)) @ np.asarray(kinematics(a)), np.eye(3), atol=1e-4)


@settings(deadline=None, max_examples=10)
@given(TARGETS)
def test_the_constant_gain_on_exact_kinematics_has_one_loop_at_every_target(target):
    """Turned into rates of the body, all targets are the same to it."""
    K = lqrd(*bearing.linear(), airbearing.Q, airbearing.R, airbearing.PERIOD)[0]
    law = airbearing_flights.ExactKinematics(gain=K, target=np.array(target), dt=airbearing.PERIOD)
    at, step = np.r_[target, np.zeros(6)], 1e-6
    with jax.enable_x64(True):
        commands = [np.asarray(law.step(law.init(), jnp.asarray(at + d), None)[1]) for d in step * np.eye(9)[:6]]
    gain = -np.column_stack(commands) / step

    def radius(angles, K):
        A, B = bearing.linear(angles)
        F, G, *_ = sampled_cost(A, B, airbearing.Q, airbearing.R, airbearing.PERIOD)
        return np.abs(np.linalg.eigvals(F - G @ K)).max()

    assert radius(np.array(target), gain) == pytest.approx(radius(np.zeros(3), K), abs=1e-6)


def test_another_inertia_reaches_the_plant():
    one = draw(airbearing.disperse, 20, 3)
    spread = one.moments / np.diag(airbearing.INERTIA)
    assert abs(spread - 1).max() <= airbearing.INERTIA_SPREAD
    assert spread.min() < 0.8 < 1.2 < spread.max()
    first = airbearing.Case(*(part[0] for part in one))
    loop, _ = bearing.case(first, bearing.configurations(1.0)[bearing.EXACT])
    plant, navigator = cast(Any, loop.plant), cast(Any, loop.navigator)
    np.testing.assert_array_equal(np.diag(plant.inertia), first.moments)
    np.testing.assert_array_equal(navigator.body.inertia, airbearing.INERTIA)


@given(st.floats(1e-3, 1.0), st.floats(0.1, 2.0))
def test_bandwidth_is_that_of_the_law(wn, zeta):
    """Overdamped as well: the geometric mean of two real poles is the natural frequency."""
    found = amazonia1_flights.bandwidth(quaternion_pd(amazonia1_flights.NET_INERTIA, wn, zeta, 0.1))
    assert found == pytest.approx((wn, zeta), rel=1e-4)


def test_pd_and_pid_have_the_bandwidth_of_the_lqr():
    built = amazonia1_flights.controllers(0.5)
    wanted = amazonia1_flights.bandwidth(built[study.SHORT])
    for name in (study.PD, study.PID):
        assert amazonia1_flights.bandwidth(built[name]) == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_pairs_of_the_paper_are_the_dynamics(seed):
    """A x is equation 14 with the gyroscopic torque, in each of the three forms."""
    rng = np.random.default_rng(seed)
    q, w = rng.standard_normal(4), 0.01 * rng.standard_normal(3)
    q /= np.linalg.norm(q)
    rate = 0.5 * np.r_[q[0] * w - np.cross(w, q[1:]), -q[1:] @ w]  # the scalar part comes last in the paper
    J = amazonia1_flights.NET_INERTIA
    expected = np.r_[rate, np.linalg.solve(J, -np.cross(w, J @ w))]
    for pair in (pointwise.printed_pair, pointwise.rate_pair, pointwise.attitude_pair):
        A, _ = pair(q, w)
        np.testing.assert_allclose(A @ np.r_[q[1:], q[0], w], expected, atol=1e-15)


def empty():
    """Every study before its flights."""
    drawn = amazonia1.region(3)
    area = region.Study(drawn, amazonia1.momentum_load(amazonia1.starts(drawn)), 1.0)
    return [
        (amazonia1_claims, study.Study(1.0)), (amazonia1_region_claims, area),
        (airbearing_claims, airbearing_flights.Study()),
    ]  # fmt: skip


@pytest.mark.parametrize("k", range(3))
def test_a_quantity_has_one_threshold(k):
    claims, found = empty()[k]
    bounds = {}
    for statement in claims.statements(found):
        assert statement.rule is not None, statement.text
        bounds.setdefault((statement.rule.quantity, statement.rule.unit), set()).add(statement.rule.bound)
    assert all(len(values) == 1 for values in bounds.values()), bounds


@pytest.mark.parametrize("k", range(3))
def test_what_was_not_flown_is_not_measured(k):
    claims, found = empty()[k]
    verdicts = {claim.text: claim.verdict for claim in judged(claims.statements(found))}
    assert "not measured" in verdicts.values()
    assert claims.summary(found) == ""
    assert all(claim.source and (claim.measured or claim.why) for claim in claims.counterparts())
    assert len(set(verdicts)) == len(claims.statements(found))
