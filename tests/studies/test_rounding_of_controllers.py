"""What rounding does to the linear controllers of all studies is below its bound, and the bound is not far above.

The bounds of the inputs are those of what the sensors of each study can say; the C is replayed a million steps.
"""

import sys
from pathlib import Path

import airbearing_flights
import amazonia1_flights
import cubesat3u_controllers
import flexible_designs
import flexible_flights
import geo_controllers
import numpy as np
import pytest
from replayed import NEAR, TYPES, measured

import synth

sys.path.append(str(Path(__file__).parents[2] / "examples/own_6u"))
RATE = 7.292e-5  # rad/s, of the geostationary orbit
ATTITUDE = [1.0] * 3 + [0.05] * 3  # of a quaternion's vector part, and rad/s
ORBIT = [1000.0] * 3 + [0.1] * 3  # m and m/s


def controllers():
    """Name -> what makes a controller, and the bounds of its inputs."""
    import mission

    def cubesat(name):
        return cubesat3u_controllers.linear_law(cubesat3u_controllers.design_controllers()[1][name])

    def amazonia():
        return synth.quaternion_lqr(amazonia1_flights.NET_INERTIA, amazonia1_flights.PERIOD)

    def airbearing():
        gain = airbearing_flights.configurations(10.0)[airbearing_flights.LQR].gain[:, :6]
        return static(gain, airbearing_flights.PERIOD)

    def geo(of, name):
        return of(RATE, 6.0)[0][name]

    def static(gain, dt):
        return synth.StateSpace.gain(-np.asarray(gain), dt)

    flexible = {
        "flexible, full order": flexible_designs.full_order, "flexible, damped": flexible_designs.damped,
        "flexible, PD": flexible_designs.pd,
    }  # fmt: skip
    found = {
        "CubeSat, H-infinity": (lambda: cubesat("Hinf"), ATTITUDE),
        "CubeSat, PD": (lambda: cubesat("PD"), ATTITUDE),
        "Amazonia-1, LQR": (amazonia, [1.0] * 10),  # of the quaternion four times, and the rate
        "air bearing, LQR": (airbearing, ATTITUDE),
        "own 6U": (lambda: mission.design().controller, ATTITUDE),
    }
    g = geo_controllers
    of = {
        g.linear: (g.THESIS_LQR, g.LQR, g.LQG, g.MIXED, g.MIXED_TUNED, g.FOUR_BLOCK),
        g.nearby: (g.LQR4, g.MIXED5, g.MIXED5_CHEAP),
    }
    for make, names in of.items():
        found |= {f"geostationary, {name}": (lambda m=make, n=name: geo(m, n), ORBIT) for name in names}
    for name, make in flexible.items():
        found[name] = (lambda m=make: flexible_flights.three_axes(m()), ATTITUDE)
    return found


def least(K):
    """A controller without the states that only fill it up."""
    A, B, C, D = (np.asarray(M, float) for M in (K.A, K.B, K.C, K.D))
    used = [i for i in range(len(A)) if A[i].any() or A[:, i].any() or B[i].any() or C[:, i].any()]
    return synth.StateSpace(A[np.ix_(used, used)], B[used], C[:, used], D, K.dt)


@pytest.mark.slow
@pytest.mark.parametrize("name", controllers())
def test_bounds_over_a_million_steps(name, tmp_path):
    make, Y = controllers()[name]
    K = least(make())
    Y = np.array(Y)[: K.nu]
    for precision in TYPES:
        found = synth.rounding(K, inputs=Y, precision=precision)
        off = measured(K, Y, precision, tmp_path / precision, 1_000_000)
        assert (off <= found.command).all()
        moved = found.command > 0
        assert (found.command[moved] <= NEAR * off[moved]).all()
