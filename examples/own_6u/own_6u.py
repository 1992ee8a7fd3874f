"""Your own satellite in sixty lines: a 6U CubeSat from data sheets to two controllers, flights, a report and C."""

import argparse
from datetime import datetime
from pathlib import Path

import numpy as np
from numpy import radians

import plants
import synth
from plants import ARCSEC, DEG_PER_SQRT_H, Wheel

POINTING, BANDWIDTH = radians(0.1), 0.1  # rad, rad/s: what the mission requires

craft = plants.spacecraft(
    name="A 6U CubeSat with star tracker and gyro",
    inertia=[0.12, 0.11, 0.05],  # kg m^2
    wheels=[Wheel.create(axis, max_torque=3e-3, max_momentum=15e-3, max_speed_rpm=6000) for axis in np.eye(3)],
    sensors=[
        plants.StarTracker.create(
            cross_noise=20 * ARCSEC,
            boresight=[0.0, 0.8, -0.6],
            period=1.0,
            sun_exclusion=radians(35),
            earth_exclusion=radians(20),
        ),
        plants.IntegratingGyro.create(random_walk=0.1 * DEG_PER_SQRT_H, turn_on_bias=radians(0.01)),
    ],
    orbit=plants.circular(500e3, radians(97.4), raan=1.0),
    epoch=datetime(2026, 3, 20),
    disturbances=[plants.ResidualDipole.create([0.05, 0.02, 0.05])],  # A m^2, beside the gravity gradient
    dt=1.0,
    samples=5,
)


def main() -> None:
    """Design, fly, report, export."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("own_6u"), help="folder for report and code (default own_6u)")
    parser.add_argument("--runs", type=int, default=30, help="dispersed flights of each controller (default 30)")
    options = parser.parse_args()
    G = synth.c2d(craft.linear(), craft.dt)
    wanted = {"pointing": POINTING, "bandwidth": BANDWIDTH}
    design = synth.hinfsyn(synth.GeneralizedPlant.four_block(G, **craft.weights(**wanted)))
    mpc = synth.mpc(G, **craft.costs(**wanted), Np=20, Nc=8)
    controllers = {"H-infinity": design, "MPC": mpc}
    flown = plants.compare_flights(
        craft, controllers, duration=1500, pointing=POINTING, runs=options.runs, out=options.out
    )
    print(design, flown, sep="\n")
    synth.export(design, "c", options.out / "code", umin=-craft.torque, umax=craft.torque, force=True)
    print(f"report: {flown.report}; C code: {options.out / 'code'}")


if __name__ == "__main__":
    main()
