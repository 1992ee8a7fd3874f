"""The numbers of the Amazonia-1 study: what the papers print, what physics bounds, and bad input."""

from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from plants.errors import ScenarioError
from plants.hardware.actuators import ReactionWheels
from plants.missions import amazonia1
from plants.missions.amazonia1 import DEG, Start
from plants.simulation import campaign, simulate
from plants.simulation.loop import Run
from plants.surroundings.environment import FreeSpace

HERE = np.array([1.0, 0, 0, 0])


@dataclass(frozen=True)
class ProportionalDerivative:
    """Torque towards the nearer of the two quaternions of the desired attitude."""

    attitude: float = 1.0  # N m
    rate: float = 20.0  # N m s
    dt: float = amazonia1.PERIOD

    def init(self):
        return ()

    def step(self, s, y, r):
        sign = 1 - 2 * (y[0] < 0)
        return s, -self.attitude * sign * y[1:4] - self.rate * y[4:7]


@dataclass(frozen=True)
class Push:
    """A constant torque on the body."""

    torque: np.ndarray  # (3,) N m
    dt: float = amazonia1.PERIOD

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.torque + 0 * y[:3]


def start(q=HERE, rates=(0.0, 0, 0), moments=None, torque=(0.0, 0, 0)):
    moments = np.diag(amazonia1.INERTIA) if moments is None else moments
    return Start(np.array(moments), np.array(q), np.array(rates), np.array(torque))


def test_largest_controllable_rates_are_those_the_paper_prints():
    """[2] solves I w = Is w_max for three wheels at full speed; the printed digits hold to one in the last place."""
    w = np.linalg.solve(amazonia1.INERTIA, np.full(3, amazonia1.MOMENTUM))
    np.testing.assert_allclose(w, [0.0385, 0.0332, 0.0225], rtol=0, atol=1.1e-4)
    assert np.linalg.norm(w) == pytest.approx(amazonia1.REGION_RATE_NORM, abs=1e-4)
    assert w.max() == pytest.approx(amazonia1.REGION_RATE, abs=1e-4)


def test_wheels_hold_and_give_what_table_1_says():
    wheels = amazonia1.wheels()
    np.testing.assert_allclose(amazonia1.WHEEL_INERTIA * wheels.speed_limit, 12.007, rtol=1e-4)
    x = simulate.simulate(*amazonia1.manoeuvre(start(), Push(np.array([1.0, 0, -0.05])), duration=0.05))
    np.testing.assert_array_equal(x.inputs[0], [-0.075, 0, 0.05])


def test_output_is_attitude_rate_and_absolute_wheel_momentum():
    q = Rotation.from_euler("ZYX", [30, 20, 10], degrees=True).as_quat(scalar_first=True)
    x = amazonia1.BodyState(q=q, w=np.array([0.1, 0.2, 0.3]), wheels=np.array([100.0, 0, -50]))
    with jax.enable_x64(True):
        y = np.asarray(amazonia1.satellite().output(x, FreeSpace().at(0.0)))
    np.testing.assert_allclose(y[:4], q, rtol=0, atol=1e-15)
    np.testing.assert_array_equal(y[4:7], x.w)
    np.testing.assert_allclose(y[7:], 0.01911 * (x.w + x.wheels), rtol=1e-14)


def test_a_command_is_a_torque_on_the_body():
    """From rest the body turns by Ib^-1 T, eq. 23."""
    torque = np.array([0.03, -0.02, 0.01])
    run = simulate.simulate(*amazonia1.manoeuvre(start(), Push(torque), duration=0.1))
    Ib = amazonia1.INERTIA - 0.01911 * np.eye(3)
    np.testing.assert_allclose(run.outputs[1, 4:7], np.linalg.solve(Ib, torque) * 0.05, rtol=1e-6)
    np.testing.assert_allclose(run.outputs[1, 7:], -torque * 0.05, rtol=1e-6)


def test_a_constant_disturbance_adds_its_momentum():
    torque = np.array([1e-3, 2e-3, -1e-3])
    run = simulate.simulate(*amazonia1.manoeuvre(start(torque=torque), ProportionalDerivative(), duration=60.0))
    body = amazonia1.satellite().body
    momentum = body.inertia @ run.states.w[-1] + body.wheel_inertia * run.states.wheels[-1]
    inertial = Rotation.from_quat(run.states.q[-1], scalar_first=True).apply(momentum)
    np.testing.assert_allclose(inertial, torque * run.time[-1], rtol=1e-2)  # the body has hardly turned


def test_dispersions_lie_within_their_bounds_and_fill_them():
    drawn = campaign.draw(amazonia1.disperse, 400, 0)
    for value, half in (
        (drawn.moments / np.diag(amazonia1.INERTIA) - 1, 0.2),
        (drawn.angles / DEG, 180),
        (drawn.rates, 0.01),
    ):
        assert np.abs(value).max() <= half
        assert np.abs(value).max() > 0.97 * half
        assert np.abs(value.mean(axis=0)).max() < 0.1 * half  # 3.5 standard errors
    around = amazonia1.region(400)
    largest = np.abs(np.hstack([around.angles / DEG, around.rates])).max(axis=0)
    bound = np.array([180, 90, 180, 0.0385, 0.0385, 0.0385])
    assert (largest <= bound).all()
    assert (largest > 0.97 * bound).all()
    np.testing.assert_array_equal(around.moments, np.tile(np.diag(amazonia1.INERTIA), (400, 1)))


def test_a_run_depends_on_its_seed_and_index_only():
    many, few, other = amazonia1.monte_carlo(20, 7), amazonia1.monte_carlo(4, 7), amazonia1.monte_carlo(4, 8)
    for a, b, c in zip(many[:3], few, other, strict=False):
        np.testing.assert_array_equal(a[:4], b)
        assert (b != c).all()


def test_momentum_load_against_scipy():
    some = amazonia1.starts(amazonia1.region(50))
    inertial = Rotation.from_quat(some.q, scalar_first=True).apply(some.rates @ amazonia1.INERTIA)
    expected = np.abs(inertial).max(axis=1) / (0.01911 * 6000 * 2 * np.pi / 60)
    np.testing.assert_allclose(amazonia1.momentum_load(some), expected, rtol=1e-12)
    one = Start(*(part[3] for part in some))
    assert amazonia1.momentum_load(one) == pytest.approx(expected[3])
    heavier = one._replace(moments=1.2 * one.moments)
    assert amazonia1.momentum_load(heavier) == pytest.approx(1.2 * expected[3], rel=0.01)


def test_nothing_comes_to_rest_beyond_the_momentum_bound():
    """The same rate about z below and above what the wheel can hold."""
    rate = amazonia1.MOMENTUM / amazonia1.INERTIA[2, 2]
    ends = {}
    for share in (0.8, 1.2):
        begin = start(rates=[0, 0, share * rate])
        assert amazonia1.momentum_load(begin) == pytest.approx(share, rel=1e-9)
        run = simulate.simulate(*amazonia1.manoeuvre(begin, ProportionalDerivative(), keep_every=20))
        ends[share] = amazonia1.outcome(run)
    assert ends[0.8].converged
    assert ends[0.8].settled
    assert not ends[1.2].converged
    assert not ends[1.2].settled
    assert ends[1.2].wheel_speed == pytest.approx(amazonia1.WHEEL_SPEED, rel=1e-3)
    assert ends[1.2].given < ends[1.2].asked


def test_outcome_of_a_history_made_by_hand():
    """1000 rows of 1 s: 2 deg until 299 s, then half a degree; turning at 0.5e-4 rad/s in the last 50 s only."""
    angle = np.where(np.arange(1000) < 300, 2 * DEG, 0.5 * DEG)
    rate = np.where(np.arange(1000) < 950, 2e-4, 0.5e-4)
    zero, asked, given = np.zeros((1000, 3)), np.tile([0.3, 0, 0.4], (1000, 1)), np.tile([0, 0, 0.1], (1000, 1))
    outputs = np.column_stack([np.cos(angle / 2), zero[:, 0], np.sin(angle / 2), zero[:, 0], rate, zero[:, :2], zero])
    run = Run(
        duration=1000.0, time=np.arange(1000.0), states=amazonia1.BodyState(outputs[:, :4], zero, zero - 3),
        outputs=-outputs, estimates=outputs, references=outputs, commands=asked, inputs=given,
        extra=None, ok=True, failed_at=None, culprit="", compiled=True,
    )  # fmt: skip
    o = amazonia1.outcome(run)
    np.testing.assert_allclose(o[:3], [300, 0.5 * DEG, 0.5e-4], rtol=1e-12)
    assert o.path == pytest.approx(950 * 2e-4 + 50 * 0.5e-4)
    assert (o.asked, o.given, o.wheel_speed) == pytest.approx((0.5, 0.1, 3.0))
    assert o.settled
    assert o.slow
    assert not o.converged
    failed = amazonia1.outcome(replace(run, ok=False))
    assert not failed.settled
    assert not failed.slow


def test_campaign_reads_back_what_it_asked_for():
    def case(begin, controller):
        return amazonia1.manoeuvre(begin, controller, duration=20.0, keep_every=20)

    some = amazonia1.monte_carlo(6)
    flown = campaign.campaign(
        case, some, ProportionalDerivative(), measure=amazonia1.outcome, read=amazonia1.applied, progress=False
    )
    np.testing.assert_array_equal(flown.applied.q, some.q)
    again = simulate.simulate(*campaign.replay_case(case, some, 4, ProportionalDerivative()))
    assert amazonia1.outcome(again).path == pytest.approx(flown.results.path[4], rel=1e-9)


@pytest.mark.parametrize(
    ("message", "change"),
    [
        ("moments", {"moments": [310, 360]}),
        ("moments", {"moments": [310, np.nan, 530]}),
        ("inertia .* positive definite", {"moments": [310, -360, 530]}),
        ("q must be finite", {"q": [np.nan, 0, 0, 0]}),
        ("q = .* unit quaternion", {"q": [1.0, 1, 0, 0]}),
        ("rates", {"rates": [0, np.nan, 0]}),
    ],
)
def test_bad_starts_are_named(message, change):
    with pytest.raises(ScenarioError, match=message):
        amazonia1.manoeuvre(start(**change), ProportionalDerivative())


def test_other_bad_input_is_named(monkeypatch):
    for runs in (0, -5, 1.5):
        for make in (amazonia1.monte_carlo, amazonia1.region):
            with pytest.raises(ScenarioError, match="runs ="):
                make(runs)
    for duration in (0.0, -1.0, 0.12):
        with pytest.raises(ScenarioError, match="duration"):
            amazonia1.manoeuvre(start(), ProportionalDerivative(), duration=duration)
    for period in (0.0, -0.05, np.nan):
        with pytest.raises(ScenarioError, match="period"):
            amazonia1.manoeuvre(start(), ProportionalDerivative(), period=period)
    with pytest.raises(ScenarioError, match="torque_limit"):
        ReactionWheels.create(amazonia1.WHEEL_AXES, torque_limit=-0.075)
    skew = amazonia1.INERTIA + np.array([[0, 1, 0], [0, 0, 0], [0, 0, 0]])
    monkeypatch.setattr(amazonia1, "INERTIA", skew)
    with pytest.raises(ScenarioError, match="inertia must be symmetric"):
        amazonia1.satellite()
