"""Anti-windup: the linear controller while nothing saturates, and less overshoot when something does."""

import jax
import numpy as np
import pytest
from scipy.signal import tf2ss

from synth.errors import ModelError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.controller import LinearController
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace


def tf(num, den) -> StateSpace:
    return StateSpace(*tf2ss(num, den))


SECOND = tf([200], np.polymul([10, 1], np.polymul([0.05, 1], [0.05, 1])))


def sampled(G: StateSpace, W1: StateSpace, dt: float) -> tuple[StateSpace, Design]:
    """The plant and the design for the loop on e = r - y, whose plant is -G."""
    G = c2d(G, dt)
    return G, ncfsyn(StateSpace(G.A, G.B, -G.C, -G.D, dt), c2d(W1, dt, "tustin"))


def step_response(G: StateSpace, controller, samples: int, limit: float = np.inf) -> tuple[np.ndarray, np.ndarray]:
    """y and u after a unit step of the reference, with an actuator that saturates."""
    x, s, ys, us = np.zeros(G.n), controller.init(), [], []
    for _ in range(samples):
        y = G.C @ x
        s, u = controller.step(s, y, np.ones(G.ny))
        u = u.clip(-limit, limit)
        x = G.A @ x + G.B @ u
        ys.append(y)
        us.append(u)
    return np.array(ys), np.array(us)


CASES = {  # plant, PI weight, sampling time s, actuator limit
    "Skogestad 9.3": (SECOND, tf([1, 2], [1, 0]), 0.01, 0.02),
    "double integrator": (tf([1], [1, 0, 0]), tf([2, 0.4], [1, 0]), 0.05, 0.1),
    "unstable": (tf([1], [1, -0.3]), tf([3, 3], [1, 0]), 0.02, 0.5),
}


@pytest.mark.parametrize("name", CASES)
def test_overshoot_with_a_saturating_actuator(name):
    """Less than half of the clipped linear controller's, and no steady-state error."""
    G, W1, dt, limit = CASES[name]
    G, design = sampled(G, W1, dt)
    samples = round(40 / dt)
    naive, _ = step_response(G, LinearController.of(design.controller), samples, limit)
    ours, u = step_response(G, AntiWindup.of(design, -limit, limit), samples)
    assert (np.abs(u) == limit).any()
    assert np.abs(u).max() <= limit
    assert naive.max() - 1 > 0.4
    assert ours.max() - 1 < 0.5 * (naive.max() - 1)
    assert ours[-1, 0] == pytest.approx(1, abs=1e-3)


def test_without_limits_it_is_the_linear_controller():
    rng = np.random.default_rng(0)
    G = StateSpace(
        rng.normal(size=(3, 3)) * 0.6, rng.normal(size=(3, 2)), rng.normal(size=(2, 3)), rng.normal(size=(2, 2)), 0.1
    )
    pi = c2d(StateSpace(np.zeros((2, 2)), np.eye(2), np.eye(2), 2 * np.eye(2)), 0.1, "tustin")
    design = ncfsyn(G, pi, np.diag([1.0, 2.0]))
    ours, linear = AntiWindup.of(design, -np.inf, np.inf), LinearController.of(design.controller)
    s1, s2 = ours.init(), linear.init()
    for y in rng.normal(size=(50, 2)):
        s1, u1 = ours.step(s1, y, np.zeros(2))
        s2, u2 = linear.step(s2, y, np.zeros(2))
        np.testing.assert_array_equal(u1, u2)


def test_weight_and_observer_follow_the_actuator():
    """The state of W1 is the one that belongs to the actual u; the observer forgets its error although u clips."""
    _, design = sampled(SECOND, tf([1, 2], [1, 0]), 0.01)
    assert design.shaping is not None
    W1, Gs, limit = design.shaping.W1, design.plant, 0.02
    controller = AntiWindup.of(design, -limit, limit)
    n = design.shaping.Ks.n
    state, x1 = controller.init(), np.zeros(W1.n)
    xs = 0.1 * np.ones(n)  # of the shaped plant, unknown to the observer
    clipped, errors = 0, []
    for _ in range(2000):
        errors.append(np.linalg.norm(state[:n] - xs))
        following, u = controller.step(state, -(Gs.C2 @ xs), np.zeros(1))
        clipped += int(abs(u[0]) == limit)
        us = np.linalg.solve(W1.D, u - W1.C @ x1)  # the shaped input that makes the actual u
        np.testing.assert_allclose(state[n:], x1, atol=1e-9)
        xs, x1, state = Gs.A @ xs + Gs.B2 @ us, W1.A @ x1 + W1.B @ us, following
    assert clipped > 10
    assert errors[-1] < 1e-6 * errors[0]


def test_it_runs_inside_jax():
    _, design = sampled(tf([1], [1, 0, 0]), tf([2, 0.4], [1, 0]), 0.05)
    controller = AntiWindup.of(design, -0.1, 0.1)
    errors = np.random.default_rng(1).normal(size=(200, 1))
    with jax.enable_x64(True):

        def step(state, y):
            return controller.step(state, y, np.zeros(1))

        _, compiled = jax.jit(lambda s, ys: jax.lax.scan(step, s, ys))(controller.init(), errors)
    state, plain = controller.init(), []
    for y in errors:
        state, u = controller.step(state, y, np.zeros(1))
        plain.append(u)
    np.testing.assert_allclose(compiled, plain, atol=1e-12)


def test_bad_input_is_named():
    G, design = sampled(tf([1], [1, 0, 0]), tf([2, 0.4], [1, 0]), 0.05)
    with pytest.raises(ModelError, match=r"umin = \[1.0\] is not below"):
        AntiWindup.of(design, 1.0, -1.0)
    with pytest.raises(ModelError, match="umax is nan"):
        AntiWindup.of(design, -1.0, np.nan)
    with pytest.raises(ModelError, match="umin is"):
        AntiWindup.of(design, [-1.0, -1.0], 1.0)
    with pytest.raises(ModelError, match="design is continuous"):
        AntiWindup.of(ncfsyn(tf([1], [1, 0])), -1.0, 1.0)
    with pytest.raises(ModelError, match="not invertible"):
        AntiWindup.of(ncfsyn(G, c2d(tf([1], [1, 1]), 0.05)), -1.0, 1.0)
    plain = hinfsyn(GeneralizedPlant.tracking(G, Wproc=1, Wdist=1, Werr=1, Wact=1, Wr=1))
    with pytest.raises(ModelError, match="no shaping"):
        AntiWindup.of(plain, -1.0, 1.0)
