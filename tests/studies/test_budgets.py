"""Pointing budgets in closed form against campaigns: the CubeSat and the air bearing, each with its Kalman filter."""

from dataclasses import replace

import airbearing as bearing
import cubesat3u as cubesat
import cubesat3u_budget as told
import jax.numpy as jnp
import numpy as np
import pytest

from plants import airbearing, budget, campaign, cubesat3u, linear_loop, pooled_level, simulate_many, stability, windows
from synth import lqrd, state_feedback

pytestmark = pytest.mark.slow
PERIOD, KINDS = airbearing.PERIOD, ("ape", "mpe", "rpe", "pse")


def outside(level, interval):
    """How many of the predicted levels (p,) miss the interval of the measured."""
    _, low, high = interval
    return int(((level < low) | (level > high)).sum())


def of_all_kinds(errors, span, lag):
    """Samples of the four errors, of every run."""
    means, rest = zip(*(windows(run, span) for run in errors), strict=True)
    return dict(zip(KINDS, (errors, means, rest, [stability(run, lag) for run in errors]), strict=True))


def test_cubesat_with_its_extended_kalman_filter():
    """Time-varying geometry, a filter that is not stationary, dispersed starts and inertia."""
    runs, seed, start = 40, 5, 300.0
    design, controllers = cubesat.design_controllers()
    found = cubesat.Study(design, controllers, start)
    shared = cubesat.Shared(cubesat3u.environment(1000.0), controllers["Hinf"], cubesat3u.ekf(), 2000)
    found.campaigns[cubesat.PAPER_HINF] = campaign(
        cubesat.case, cubesat.starts(runs, seed), shared, measure=lambda run: 0, seed=seed, keep=range(runs + 1),
        progress=False,
    )  # fmt: skip
    cubesat.tell(found, runs, seed, 1000.0)
    levels = found.budget.levels()
    counts = [
        sum(
            outside(getattr(levels, kind)[3 * told.NAMES[name] :][:3], interval)
            for (name, kind), interval in told.measured(found, confidence).items()
        )
        for confidence in (0.95, 1 - 0.05 / 36)
    ]
    assert counts[0] <= 5  # of 36, where 2 are expected of independent ones
    assert counts[1] == 0  # all at once, with 95 % (Bonferroni)
    assert "no proof" in found.worst_ape
    table = told.compared(found, found.budget, found.worst)
    assert len(table.rows) == 12
    assert f"{counts[0]} of 36" in table.note


def errors(output, estimate, reference):
    return jnp.concatenate([output[:3] - reference[:3], output[:3] - estimate[:3]])


def coordinates(flight, memory, env):
    moving = [flight.x.angles, flight.x.w, flight.navigator.x, flight.estimate[:6], jnp.ravel(memory)]
    return jnp.concatenate(moving), flight.x.wheels


def torque(scn, v, k):
    """At both ends of a period, linear in between."""
    table = jnp.asarray(scn.environment.torque)
    pushed = replace(scn.environment, torque=table.at[k].add(v[:3]).at[k + 1].add(v[3:]))
    return replace(scn, environment=pushed)


def test_air_bearing_with_its_kalman_filter():
    """Stationary filter and gain; the torque of a period's beginning is a state of the model."""
    A, B = bearing.linear()
    gain = np.hstack([lqrd(A, B, airbearing.Q, airbearing.R, PERIOD)[0], np.zeros((3, 3))])
    controller, start, duration, runs = state_feedback(gain, PERIOD), 100.0, 300.0, 40
    target = airbearing.TARGET

    def case(noise, seed):
        one = airbearing.case(target, noise=noise, seed=seed)
        loop, scenario = airbearing.manoeuvre(one, controller, airbearing.filtered(rates=True), duration=duration)
        return loop, replace(scenario, seed=1, run=seed)

    loop, scenario = case(0.0, 0)
    loop = replace(loop, sensors=airbearing.SENSORS)
    model = linear_loop(
        loop, scenario, [round(duration / PERIOD) - 1], errors=errors, coordinates=coordinates, push=torque, pushes=6
    )
    F, G, C, D = (M[0] for M in model[:4])
    old, new = slice(3, 6), slice(6, None)  # after the wheels' speeds, which are held
    found = budget(
        np.vstack([np.hstack([F, G[:, old]]), np.zeros((3, len(F) + 3))]),
        np.vstack([G[:, new], np.eye(3, 9)]),
        np.hstack([C, D[:, old]]),
        D[:, new],
        PERIOD,
        noise=np.repeat([airbearing.TORQUE_NOISE, 1.0], [3, 6]),
        window=10.0,
        delta_t=1.0,
    )
    flown = simulate_many([case(1.0, seed) for seed in range(runs)])
    counts = np.zeros(2, int)
    for at, which in ((slice(0, 3), "references"), (slice(3, 6), "estimates")):
        late = [(run.outputs - getattr(run, which))[run.time >= start - 1e-9, :3] for run in flown]
        predicted = {kind: getattr(found.levels(), kind)[at] for kind in KINDS}
        samples = of_all_kinds(late, round(10.0 / PERIOD), round(1.0 / PERIOD))
        counts += [
            sum(outside(level, pooled_level(samples[kind], confidence=c)) for kind, level in predicted.items())
            for c in (0.95, 1 - 0.05 / 24)
        ]
    assert counts[0] <= 4  # of 24
    assert counts[1] == 0
