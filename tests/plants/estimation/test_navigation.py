"""Attitude determination: two solutions of Wahba's problem, the filter against textbook algebra and statistics."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from plants.dynamics.rigidbody import BodyState, state_from
from plants.errors import ScenarioError
from plants.estimation import navigation, updates, wahba
from plants.geometry import attitude
from plants.hardware import sensors
from plants.missions import cubesat3u
from plants.simulation.simulate import Loop, Scenario, simulate_many
from plants.surroundings.environment import FreeSpace

CLOSED_FORM = 5e-13  # the two solutions of Wahba's problem, vectors at least 3 deg apart


@dataclass(frozen=True)
class ProportionalDerivative:
    gain: np.ndarray  # (3, 6)
    dt: float = cubesat3u.CONTROL_PERIOD

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, self.gain @ (r - y)


def cubesat_pd(wn=0.17, zeta=0.8):
    I = np.diag(cubesat3u.INERTIA)
    return ProportionalDerivative(np.hstack([2 * wn**2 * I, 2 * zeta * wn * I]))


def vectors(rng, n, noise):
    A = Rotation.random(random_state=rng).as_matrix().T
    r = rng.normal(size=(n, 3))
    r /= np.linalg.norm(r, axis=1, keepdims=True)
    b = r @ A.T + noise * rng.normal(size=(n, 3))
    return A, b / np.linalg.norm(b, axis=1, keepdims=True), r


def test_svd_recovers_the_attitude_and_is_the_optimum():
    rng = np.random.default_rng(1)
    with jax.enable_x64(True):
        for n in (2, 3, 5):
            A, b, r = vectors(rng, n, 0.0)
            np.testing.assert_allclose(wahba.wahba_svd(b, r, np.ones(n)), A, atol=1e-12)
        _, b, r = vectors(rng, 4, 0.1)
        w = rng.uniform(0.5, 2, 4)
        best = np.asarray(wahba.wahba_svd(b, r, w))
        scipy = Rotation.align_vectors(b, r, weights=w)[0].as_matrix()
    np.testing.assert_allclose(best, scipy, atol=1e-12)
    assert np.linalg.det(best) == pytest.approx(1)


def test_closed_form_equals_svd():
    rng = np.random.default_rng(2)
    pair = jax.jit(wahba.wahba_pair)
    svd = jax.jit(wahba.wahba_svd)
    tested = 0
    with jax.enable_x64(True):
        while tested < 500:
            _, b, r = vectors(rng, 2, 0.05)
            if min(np.linalg.norm(np.cross(*b)), np.linalg.norm(np.cross(*r))) < 0.05:
                continue
            w = rng.uniform(0.1, 10, 2)
            A, determined = pair(3.0 * b, 0.1 * r, w)
            assert determined
            np.testing.assert_allclose(A, svd(b, r, w), rtol=0, atol=CLOSED_FORM)
            tested += 1


@pytest.mark.parametrize(
    "body", [np.array([[1.0, 0, 0], [1, 0, 0]]), np.array([[1.0, 0, 0], [-2, 0, 0]]), np.eye(2, 3) * [0, 1, 0]]
)
def test_parallel_or_missing_vectors_determine_nothing(body):
    with jax.enable_x64(True):
        A, determined = wahba.wahba_pair(body, np.eye(2, 3), np.ones(2))
        slope = jax.jacfwd(lambda b: wahba.wahba_pair(b, np.eye(2, 3), np.ones(2))[0])(jnp.asarray(body))
    assert not determined
    assert np.isfinite(A).all()
    assert np.isfinite(slope).all()


def test_scalar_updates_equal_the_textbook_batch():
    rng = np.random.default_rng(3)
    root = rng.normal(size=(9, 9))
    P, H = root @ root.T, rng.normal(size=(6, 9))
    R, z = rng.uniform(0.1, 1, 6), rng.normal(size=6)
    with jax.enable_x64(True):
        e, updated = updates.scalar_updates(*map(jnp.asarray, (P, z, H, R, np.ones(6))))
        known = np.array([1.0, 0, 1, 1, 0, 1])
        part, _ = updates.scalar_updates(*map(jnp.asarray, (P, z, H, R, known)))
        none, same = updates.scalar_updates(*map(jnp.asarray, (P, z, H, R, np.zeros(6))))
    K = P @ H.T @ np.linalg.inv(H @ P @ H.T + np.diag(R))
    np.testing.assert_allclose(e, K @ z, rtol=1e-10)
    np.testing.assert_allclose(updated, P - K @ H @ P, atol=1e-11 * np.abs(P).max())
    rows = known > 0
    K = P @ H[rows].T @ np.linalg.inv(H[rows] @ P @ H[rows].T + np.diag(R[rows]))
    np.testing.assert_allclose(part, K @ z[rows], rtol=1e-10)
    np.testing.assert_array_equal(none, 0)
    np.testing.assert_array_equal(same, P)


def orbit_like():
    """Surroundings with a turning frame O, as in orbit."""
    return (
        FreeSpace()
        .at(0.0)
        ._replace(
            q_ON=jnp.array([0.6, 0.0, 0.8, 0.0]),
            w_ON=jnp.array([0.0, -1.1e-3, 0.0]),
            sun=jnp.array([0.6, 0.0, 0.8]),
            B=jnp.array([1e-5, 3e-5, -2e-5]),
            sunlit=jnp.ones(()),
        )
    )


def test_error_dynamics_against_differences_of_the_propagation():
    """Two neighbouring bodies, propagated for a short time, part as the Jacobian says."""
    filter_ = cubesat3u.ekf()
    with jax.enable_x64(True):
        env, wheels, u, h = orbit_like(), jnp.array([100.0, -50.0, 20.0]), jnp.array([1e-4, -2e-4, 5e-5]), 1e-4
        s = filter_.init()._replace(q=attitude.from_euler(np.array([0.3, -0.4, 1.1])), w=jnp.array([0.02, -0.01, 0.03]))
        A = np.asarray(filter_.error_dynamics(s, wheels, u, env))

        def parted(e):
            error = jnp.concatenate([jnp.sqrt(1 - e[:3] @ e[:3])[None], e[:3]])
            q, w = filter_._propagate(attitude.compose(error, s.q), s.w + e[3:], wheels, u, env, h)
            q0, w0 = filter_._propagate(s.q, s.w, wheels, u, env, h)
            return jnp.concatenate([attitude.compose(q, attitude.conjugate(q0))[1:], w - w0])

        step = 1e-4
        columns = [(parted(d) - parted(-d)) / (2 * step) for d in step * jnp.eye(6)]
    transition = np.eye(6) + h * A + (h * A) @ (h * A) / 2
    np.testing.assert_allclose(np.stack(columns, axis=1), transition, rtol=0, atol=1e-10)


@pytest.mark.parametrize("made", [cubesat3u.ekf, cubesat3u.direct_ekf])
def test_innovation_jacobian_against_differences(made):
    """H is the derivative of what the sensors would give, with respect to the true body's error."""
    filter_ = made()
    suite = cubesat3u.suite()
    with jax.enable_x64(True):
        env = orbit_like()
        s = filter_.init()._replace(q=attitude.from_euler(np.array([0.3, -0.4, 1.1])), w=jnp.array([0.02, -0.01, 0.03]))

        def seen(e):
            error = jnp.concatenate([jnp.sqrt(1 - e[:3] @ e[:3])[None], e[:3]])
            q = attitude.compose(error, s.q)
            x = BodyState(attitude.compose(q, env.q_ON), s.w + e[3:6], jnp.zeros(3))
            _, y = suite.measure(s.bias + e[6:], x, env, jnp.zeros(12), 0.0)
            full = s._replace(smoothing=navigation.Smoothing(y.sun[None], y.field[None]))
            return filter_.innovation(full, y, env)

        step = 1e-5
        columns = [(seen(d)[0] - seen(-d)[0]) / (2 * step) for d in step * jnp.eye(9)]
        z, H, *_ = seen(jnp.zeros(9))
    np.testing.assert_allclose(z, 0, atol=1e-14)
    np.testing.assert_allclose(np.stack(columns, axis=1), H, atol=1e-8)


def with_covariance_of_the_solution(**changes):
    """The filter of the study, told how well Wahba's problem is solved at every sample."""
    known = {"attitude_noise": None, "torque_noise": 1e-9, "bias_walk": cubesat3u.GYRO_BIAS_WALK, "window": 1}
    return navigation.ekf(cubesat3u.body(disturbed=False), cubesat3u.suite(), **{**known, **changes})


def test_solution_of_wahbas_problem_counts_as_much_as_its_covariance_says():
    """The rows are independent, of unit variance, and hold 4 P^-1 of information on the vector part."""
    filter_ = with_covariance_of_the_solution()
    with jax.enable_x64(True):
        env = orbit_like()
        q = attitude.from_euler(np.array([0.3, -0.4, 1.1]))
        x = BodyState(attitude.compose(q, env.q_ON), jnp.zeros(3), jnp.zeros(3))
        _, y = cubesat3u.suite().measure(jnp.zeros(3), x, env, jnp.zeros(12), 0.0)
        s = filter_.init()._replace(q=q, smoothing=navigation.Smoothing(y.sun[None], y.field[None]))
        z, H, R, known = (np.asarray(a) for a in filter_.innovation(s, y, env))
        seen = [np.asarray(attitude.rotate(x.q, v)) for v in (env.sun, env.B)]
        deviations = [cubesat3u.SUN_NOISE, cubesat3u.MAGNETOMETER_NOISE / np.linalg.norm(env.B)]
        P = np.asarray(wahba.wahba_covariance(np.stack(seen), deviations))
    np.testing.assert_allclose(z[:3], 0, atol=1e-9)
    np.testing.assert_array_equal(R[:3], 1)
    np.testing.assert_allclose(H[:3, :3].T @ H[:3, :3], 4 * np.linalg.inv(P), rtol=1e-8)
    assert (known == 1).all()


def test_filter_takes_the_gyro_by_its_random_walk():
    """The variance of the rate is that of the sampling period; before time has passed there is nothing to use."""
    suite = sensors.attitude_suite(sun_noise=1e-3, magnetometer_noise=1e-7, gyro_random_walk=2e-5)
    filter_ = navigation.ekf(cubesat3u.body(), suite, attitude_noise=1e-3, torque_noise=1e-7, bias_walk=0.0)
    with jax.enable_x64(True):
        env = orbit_like()
        x = BodyState(env.q_ON, jnp.zeros(3), jnp.zeros(3))
        _, y = suite.measure(jnp.zeros(3), x, env, jnp.zeros(12), 0.0)
        for h, variance, used in ((0.0, 0.0, 0), (0.1, 4e-9, 1), (0.4, 1e-9, 1)):
            *_, R, known = filter_.innovation(filter_.init(), y, env, h)
            np.testing.assert_allclose(R[3:], variance, rtol=1e-12)
            np.testing.assert_array_equal(known[3:], used)


def errors_and_covariance(x, env, sensors, navigator):
    """Error of the nine states and their covariance."""
    q = attitude.compose(x.q, attitude.conjugate(env.q_ON))
    a = attitude.positive(attitude.compose(q, attitude.conjugate(navigator.q)))[1:]
    told = navigation.ekf_record(x, env, sensors, navigator)
    return jnp.concatenate([a, x.w - navigator.w, sensors - navigator.bias]), navigator.P, told


def normalised_errors(navigator, runs, periods=120, environment=None, body=None, drawn=True):
    """e' P^-1 e at every sample of several runs whose first error is drawn from the filter's own covariance."""
    surroundings = environment or cubesat3u.environment(0.5 * periods)
    suite, deviation = cubesat3u.suite(), np.asarray(navigator.deviation)
    cases = []
    for i in range(runs):
        e = deviation * np.random.default_rng([7, i]).normal(size=9) * drawn
        with jax.enable_x64(True):
            env = surroundings.at(0.0)
            q = attitude.normalise(jnp.concatenate([jnp.ones(1), e[:3]]))
            x = jax.tree.map(np.asarray, state_from(q, np.zeros(3), np.zeros(3), env))
        guess = replace(navigator, w=x.w - e[3:6], bias=np.asarray(suite.gyro.bias) - e[6:])
        loop = Loop(
            plant=body or cubesat3u.body(disturbed=False),
            controller=cubesat_pd(),
            sensors=suite,
            navigator=guess,
            actuator=cubesat3u.wheels(),
        )
        cases.append((loop, Scenario(initial=x, dt=0.5, periods=periods, samples=5, environment=surroundings, run=i)))
    flown = simulate_many(cases, record=errors_and_covariance)
    assert all(run.ok for run in flown)
    e, P = (np.stack([run.extra[k] for run in flown]) for k in (0, 1))
    squared = np.einsum("rti,rti->rt", e, np.linalg.solve(P, e[..., None])[..., 0])
    attitude_alone = np.einsum("rti,rti->rt", e[..., :3], np.linalg.solve(P[..., :3, :3], e[..., :3, None])[..., 0])
    white = np.stack([run.extra[2].error for run in flown])
    np.testing.assert_allclose((white**2).sum(axis=-1), squared, rtol=1e-6)
    np.testing.assert_allclose((white[..., :3] ** 2).sum(axis=-1), attitude_alone, rtol=1e-6)
    nis, rows = (np.stack([getattr(run.extra[2], name) for run in flown]) for name in ("nis", "rows"))
    return squared, e, P, nis / np.maximum(rows, 1)


SMALL = np.array([0.02] * 3 + [1e-3] * 3 + [5e-4] * 3)  # first errors in the linear range: 2.3 deg


@pytest.mark.slow
def test_direct_filter_is_consistent():
    """With the true noise in the filter, the normalised squared error is chi-square with nine degrees (NEES)."""
    runs = 40
    direct = replace(cubesat3u.direct_ekf(), deviation=SMALL, torque_noise=1e-9)
    nees, e, P, nis = normalised_errors(direct, runs)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 9 * runs) / runs
    for time in (0, 5, 50, 200, 599):  # instants far apart, so that five tests at 2e-4 are one at 1e-3
        assert low < nees[:, time].mean() < high, (time, nees[:, time].mean(), low, high)
    assert (P[:, -1].diagonal(axis1=1, axis2=2)[:, :3] < 0.05 * P[:, 0].diagonal(axis1=1, axis2=2)[:, :3]).all()
    assert_innovations(nis, 9)
    assert np.abs(e[:, -1, 6:]).max() < 4 * np.sqrt(P[:, -1].diagonal(axis1=1, axis2=2)[:, 6:].max())


@pytest.mark.slow
def test_fed_filter_is_consistent_with_the_covariance_of_the_solution():
    """Without smoothing and with Wahba's covariance the reference's scheme is as consistent as the direct filter."""
    runs = 40
    nees, *_, nis = normalised_errors(with_covariance_of_the_solution(deviation=SMALL), runs)
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 9 * runs) / runs
    for time in (0, 5, 50, 200, 599):
        assert low < nees[:, time].mean() < high, (time, nees[:, time].mean(), low, high)
    assert_innovations(nis, 6)


def assert_innovations(nis, rows):
    """Innovations are white, so that all of them together are one sum of squares."""
    count = rows * nis.size
    low, high = chi2.ppf([1e-4, 1 - 1e-4], count) / count
    assert low < nis.mean() < high, (nis.mean(), low, high)


@pytest.mark.slow
def test_all_filters_converge_from_zero_at_large_angles():
    """Table 5: the filter starts from zeros, the body 43 deg away and turning; bias is found."""
    surroundings = cubesat3u.environment(300.0)
    suite = cubesat3u.suite()
    final = {}
    for made in (cubesat3u.ekf, cubesat3u.consistent_ekf, cubesat3u.direct_ekf):
        loop = Loop(
            plant=cubesat3u.body(),
            controller=cubesat_pd(),
            sensors=suite,
            navigator=made(),
            actuator=cubesat3u.wheels(),
        )
        start = cubesat3u.initial_state(surroundings, np.radians([25, -25, 25]), np.radians([0.3, -0.3, 0.3]))
        scn = Scenario(initial=start, dt=0.5, periods=600, samples=5, environment=surroundings)
        (run,) = simulate_many([(loop, scn)], record=errors_and_covariance)
        assert run.ok
        final[made] = run.extra[0]
    for e in final.values():
        assert np.abs(e[-500:, :3]).max() < np.radians(0.3)
        assert np.abs(e[-1, 6:]).max() < np.radians(0.005)


@pytest.mark.slow
def test_eclipse_starves_the_vector_solution_and_not_the_direct_filter():
    """Without the Sun the fed-by-SVD filter coasts; the direct one keeps the magnetometer."""
    lit = cubesat3u.environment(600.0)
    night = replace(lit, splines=np.array(lit.splines))
    dark = np.asarray(night.splines)
    dark[..., 0, 12], dark[..., 1:, 12] = -1.0, 0.0  # the Sun stays 1 rad below the limb
    spread, miss = {}, {}
    for direct in (False, True):
        navigator = replace(cubesat3u.direct_ekf() if direct else cubesat3u.ekf(), deviation=SMALL)
        _, e, P, _ = normalised_errors(navigator, 2, periods=1200, environment=night, body=cubesat3u.body())
        spread[direct] = np.sqrt(P[:, :, :3, :3].trace(axis1=2, axis2=3))
        miss[direct] = np.linalg.norm(e[:, :, :3], axis=-1)
    assert (spread[False][:, -1] > 2 * spread[False][:, 0]).all()
    assert (spread[True][:, -1] < spread[True][:, 0]).all()
    assert (miss[True][:, -1] < 4 * spread[True][:, -1]).all()


@pytest.mark.slow
def test_svd_navigator_smooths_and_reports_the_raw_gyro():
    surroundings = cubesat3u.environment(20.0)
    loop = Loop(
        plant=cubesat3u.body(),
        controller=cubesat_pd(),
        sensors=cubesat3u.suite(),
        navigator=cubesat3u.svd(),
        actuator=cubesat3u.wheels(),
    )
    scn = Scenario(
        initial=cubesat3u.initial_state(surroundings, np.zeros(3), np.zeros(3)),
        dt=0.5,
        periods=40,
        samples=5,
        environment=surroundings,
    )
    spread = {}
    for window in (1, 5):
        (run,) = simulate_many([(replace(loop, navigator=replace(loop.navigator, window=window)), scn)])
        spread[window] = (run.estimates - run.outputs)[20:].std(axis=0)
    ratio = spread[1][:3] / spread[5][:3]
    np.testing.assert_allclose(ratio, np.sqrt(5), rtol=0.35)
    np.testing.assert_allclose(spread[5][3:], cubesat3u.GYRO_NOISE, rtol=0.2)


def test_bad_numbers_are_named():
    suite, body = cubesat3u.suite(), cubesat3u.body(disturbed=False)
    sound = {"attitude_noise": 1e-3, "torque_noise": 1e-7, "bias_walk": 1e-7}
    for name, value in (
        ("attitude_noise", -1.0),
        ("torque_noise", np.nan),
        ("q", [1.0, 1.0, 0.0, 0.0]),
        ("deviation", np.ones(6)),
        ("window", 0),
    ):
        with pytest.raises(ScenarioError, match=name):
            navigation.ekf(body, suite, **{**sound, name: value})
    with pytest.raises(ScenarioError, match="window"):
        navigation.svd_navigator(suite, window=2.5)
