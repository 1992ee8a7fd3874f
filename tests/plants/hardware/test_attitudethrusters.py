"""Attitude thrusters: allocation, pulses, limit cycles against their closed forms, propellant."""

from dataclasses import dataclass

import jax
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from plants.errors import ScenarioError
from plants.hardware.attitudethrusters import AttitudeThrusters, Pwm, Pwpf, Schmitt
from plants.hardware.effectors import equip
from plants.simulation.simulate import Loop, Scenario, simulate
from plants.surroundings.environment import FreeSpace

FORCE, LEVER = 0.1, 0.5  # N, m: a couple gives 0.1 N m
REST = np.array([1.0, 0, 0, 0])


@pytest.fixture(autouse=True)
def _double():
    with jax.enable_x64(True):
        yield


def geometry():
    """Twelve thrusters in couples about the three axes."""
    positions, directions = [], []
    for axis in range(3):
        arm, push = np.eye(3)[(axis + 1) % 3], np.eye(3)[(axis + 2) % 3]
        for sense in (1, -1):
            positions += [LEVER * arm, -LEVER * arm]
            directions += [sense * push, -sense * push]
    return np.array(positions).T, np.array(directions).T


def couples(modulator, **options):
    return AttitudeThrusters.create(*geometry(), force=FORCE, modulator=modulator, **options)


def fire(thrusters, torques, h, noise=0.0):
    """Torques of a sequence of commands, (k, 3), and the last state."""
    quiet = noise * np.ones(thrusters.channels)
    state, rows = jax.lax.scan(lambda s, c: thrusters.apply(s, c, None, quiet, h), thrusters.init(), np.array(torques))
    return np.asarray(rows), jax.tree.map(np.asarray, state)


@settings(max_examples=10, deadline=None)
@given(st.integers(6, 9), st.integers(0, 2**32 - 1), st.sampled_from([1e-3, 1.0, 500.0]))
def test_on_times_are_not_negative_give_the_torque_and_are_the_fewest(n, seed, force):
    """Against a solver of linear programs."""
    rng = np.random.default_rng(seed)
    r, d = rng.normal(size=(2, 3, n))
    d /= np.linalg.norm(d, axis=0)
    with jax.enable_x64(True):
        try:
            thrusters = AttitudeThrusters.create(r, d, force=force, modulator=Pwm.create(shortest=1e-12))
        except ScenarioError as error:
            assert "do not add up" in str(error)  # noqa: PT017
            return
        command = 1e-3 * force * rng.normal(size=3)
        state, torque = thrusters.apply(thrusters.init(), command, None, np.zeros(n), 2.0)
    np.testing.assert_allclose(torque, command, rtol=0, atol=1e-9 * np.linalg.norm(command))
    on = np.asarray(state.impulse) / force
    best = linprog(np.ones(n), A_eq=thrusters.torques / force, b_eq=command / force, bounds=(0, None))
    assert (on >= 0).all()
    assert on.sum() / 2 == pytest.approx(best.fun, rel=1e-6, abs=1e-12)


def test_beyond_full_thrust_the_torque_keeps_its_direction():
    torque, _ = fire(couples(Pwm.create(shortest=0.01)), [[1.0, -0.5, 0.25]], 1.0)
    np.testing.assert_allclose(torque[0], [0.1, -0.05, 0.025], rtol=1e-12)


@settings(max_examples=8, deadline=None)
@given(st.floats(-0.1, 0.1), st.sampled_from([0.01, 0.05]), st.sampled_from([0.1, 1.0]))
def test_no_pulse_is_shorter_than_the_shortest(torque, shortest, h):
    with jax.enable_x64(True):
        given_torque, state = fire(couples(Pwm.create(shortest=shortest)), [[torque, 0, 0]], h)
    duty = abs(torque) / 0.1
    expected = torque if duty * h >= shortest else 0.0
    if abs(duty * h - shortest) > 1e-9:
        np.testing.assert_allclose(given_torque[0], [expected, 0, 0], rtol=0, atol=1e-12)
        np.testing.assert_allclose(state.impulse.sum(), 2 * FORCE * abs(expected) / 0.1 * h, rtol=1e-9, atol=1e-15)
        assert set(np.round(state.impulse[state.impulse > 0] / FORCE, 12) >= shortest * (1 - 1e-9)) <= {True}


def test_schmitt_has_a_dead_zone_hysteresis_and_a_shortest_pulse():
    asked = np.array([0.0, 0.4, 0.59, 0.6, 0.4, 0.31, 0.3, 0.4, 0.6, 0.1, 0.1, 0.1])
    torques = np.outer(0.1 * asked, [1, 0, 0])
    plain, _ = fire(couples(Schmitt.create(on=0.595, off=0.305)), torques, 0.1)
    np.testing.assert_allclose(plain[:, 0] / 0.1, [0, 0, 0, 1, 1, 1, 0, 0, 1, 0, 0, 0], atol=1e-12)
    held, _ = fire(couples(Schmitt.create(on=0.595, off=0.305, shortest=0.3)), torques, 0.1)
    np.testing.assert_allclose(held[:, 0] / 0.1, [0, 0, 0, 1, 1, 1, 0, 0, 1, 1, 1, 0], atol=1e-12)


def test_pwpf_pulses_and_pauses_are_the_closed_form():
    """Under a constant input: Wie (2008), section 7.5, from the lag between the two levels."""
    on, off, gain, lag, h, asked = 0.45, 0.15, 4.5, 0.15, 2e-5, 0.4
    modulator = Pwpf.create(on=on, off=off, gain=gain, lag=lag)
    given_torque, _ = fire(couples(modulator), np.tile([0.1 * asked, 0, 0], (20_000, 1)), h)
    firing = given_torque[:, 0] > 0
    edges = np.flatnonzero(np.diff(firing.astype(int)))
    pauses = np.diff(edges)[::2] * h if firing[edges[0]] else np.diff(edges)[1::2] * h
    pulses = np.diff(edges)[1::2] * h if firing[edges[0]] else np.diff(edges)[::2] * h
    full, rest = gain * (asked - 1), gain * asked
    np.testing.assert_allclose(pulses, lag * np.log((on - full) / (off - full)), rtol=0, atol=2.1 * h)
    np.testing.assert_allclose(pauses, lag * np.log((rest - off) / (rest - on)), rtol=0, atol=2.1 * h)


@dataclass(frozen=True, kw_only=True)
class RateAndAngle:
    """-k (angle + lead * rate) about x, in N m."""

    dt: float
    gain: float
    lead: float

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, -self.gain * (2 * y[:3] + self.lead * y[3:]) * np.array([1.0, 0, 0])


def cycle(plant, actuator, law, *, angle, seconds, h):
    start = plant.state([1, 0.5 * angle, 0, 0] / np.hypot(1, 0.5 * angle), np.zeros(3), FreeSpace())
    loop = Loop(plant=plant, actuator=actuator, controller=law)
    run = simulate(loop, Scenario(initial=start, dt=h, periods=round(seconds / h), environment=FreeSpace()))
    assert run.ok
    return 2 * run.outputs[:, 0], run.outputs[:, 3], run.time


def crossings(signal, time):
    """Times at which a signal rises through zero."""
    i = np.flatnonzero((signal[:-1] < 0) & (signal[1:] >= 0))
    return time[i] - signal[i] * (time[i + 1] - time[i]) / (signal[i + 1] - signal[i])


def test_schmitt_limit_cycle_is_the_closed_form():
    """A double integrator on angle + lead rate, switched on at a1 and off at a2: by symmetry of the parabola the rate
    of the coast is w = (a1 - a2) / (2 lead) and it begins and ends at (a1 + a2) / 2 (Sidi 1997, section 9.4), so

        amplitude = (a1 + a2) / 2 + w^2 / (2 c),    period = 2 (a1 + a2) / w + 4 w / c,    c = T / I
    """
    I, T, a1, a2, lead, h = 10.0, 0.1, 2e-3, 1.6e-3, 0.5, 2e-3
    gain = 10.0  # N m / rad: full thrust is asked for at 10 mrad
    trigger = Schmitt.create(on=a1 * gain / T, off=a2 * gain / T)
    plant, actuator = equip([I, I, I], thrusters=couples(trigger))
    angle, rate, time = cycle(plant, actuator, RateAndAngle(dt=h, gain=gain, lead=lead), angle=3e-3, seconds=200, h=h)
    w, c = (a1 - a2) / (2 * lead), T / I
    late = time > 100
    assert np.abs(angle[late]).max() == pytest.approx((a1 + a2) / 2 + w**2 / (2 * c), rel=0.02)
    angle, rate, time = angle[late], rate[late], time[late]
    coasts = np.abs(rate[:-1][np.diff(np.sign(angle)) != 0])  # samples leave an asymmetry that the cycle hardly damps
    assert coasts.mean() == pytest.approx(w, rel=0.05)  # a sample of thrust is c h = w / 20
    period = np.diff(crossings(angle, time)).mean()
    assert period == pytest.approx(2 * (a1 + a2) * (1 / coasts).mean() + 4 * w / c, rel=0.02)


def test_minimum_impulse_limit_cycle_is_the_closed_form():
    """One shortest pulse t at each side of the dead zone a turns the rate over: w = T t / (2 I), period 4 a / w (Sidi
    1997, section 9.4; Wertz 1978, section 19.2)."""
    I, T, a, t = 10.0, 0.1, 2e-3, 0.02
    trigger = Schmitt.create(on=a * 10 / T, off=0.999 * a * 10 / T, shortest=t)
    plant, actuator = equip([I, I, I], thrusters=couples(trigger))
    law = RateAndAngle(dt=t, gain=10.0, lead=0.3)
    start = plant.state(REST, np.array([0.5 * T * t / I, 0, 0]), FreeSpace())
    run = simulate(
        Loop(plant=plant, actuator=actuator, controller=law),
        Scenario(initial=start, dt=t, periods=round(600 / t), environment=FreeSpace()),
    )
    angle, rate = 2 * run.outputs[:, 0], run.outputs[:, 3]
    w = T * t / (2 * I)
    np.testing.assert_allclose(np.abs(rate), w, rtol=1e-9)
    assert np.abs(angle).max() == pytest.approx(a, rel=0.02)
    assert np.diff(crossings(angle, run.time)).mean() == pytest.approx(4 * a / w, rel=0.02)
    spent = run.actuator.thrusters  # two thrusters of a couple turn the rate by 2 w in each pulse
    pulses = np.count_nonzero(np.diff(np.sign(rate)))
    assert spent.impulse.sum() == pytest.approx(2 * FORCE * t * pulses, rel=2 / pulses)


def test_propellant_is_impulse_over_exhaust_velocity():
    thrusters = couples(Pwm.create(shortest=0.01), specific_impulse=220.0)
    _, state = fire(thrusters, np.tile([0.05, 0, 0], (100, 1)), 1.0)
    assert state.impulse.sum() == pytest.approx(100 * 0.5 * 2 * FORCE, rel=1e-9)
    assert float(thrusters.propellant(state)) == pytest.approx(state.impulse.sum() / (220 * 9.80665), rel=1e-12)
    assert float(couples(Pwm.create(shortest=0.01)).propellant(state)) == 0


def test_spread_is_of_each_pulse():
    noisy = couples(Pwm.create(shortest=0.01), spread=0.05)
    noise = np.random.default_rng(0).normal(size=(5000, 12))
    torque = np.asarray(jax.vmap(lambda n: noisy.apply(noisy.init(), np.array([0.05, 0, 0]), None, n, 1.0)[1])(noise))
    assert torque[:, 0].std() == pytest.approx(0.05 * 0.05 / np.sqrt(2), rel=0.05)  # of two thrusters
    np.testing.assert_array_equal(torque[:, 1:], 0)


ONE_SIDED = (np.array([[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]), np.array([[0, 1.0, 0], [0, 0, 1], [1, 0, 0]]).T)


@pytest.mark.parametrize(
    ("act", "message"),
    [
        (lambda: AttitudeThrusters.create(*ONE_SIDED, force=1.0, modulator=Pwm.create(shortest=0.1)), "do not add up"),
        (lambda: couples(Pwm.create(shortest=0.0)), "shortest must be positive"),
        (lambda: couples(Schmitt.create(on=0.3, off=0.3)), "off = 0.3 must be below on = 0.3"),
        (lambda: couples(Schmitt.create(on=0.3, off=-0.1)), "off must be at least 0"),
        (lambda: couples(Pwpf.create(on=0.3, off=0.1, gain=1.0, lag=0.0)), "lag must be positive"),
        (lambda: couples(Pwm.create(shortest=0.1), spread=-0.1), "spread must be at least 0"),
        (lambda: couples(Pwm.create(shortest=0.1), specific_impulse=0.0), "specific_impulse must be positive"),
        (
            lambda: AttitudeThrusters.create(
                geometry()[0], 2 * geometry()[1], force=1.0, modulator=Pwm.create(shortest=0.1)
            ),
            "directions must be unit columns",
        ),
        (
            lambda: AttitudeThrusters.create(*geometry(), force=[1.0, 2.0], modulator=Pwm.create(shortest=0.1)),
            "force must have shape",
        ),
    ],
)
def test_mistakes_are_named(act, message):
    with pytest.raises(ScenarioError, match=message):
        act()
