"""A mission in modes, in one flight of three orbits: tumbling, nadir, a target on the ground and nadir again."""

import argparse
from datetime import datetime
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy import radians

import plants
import synth
from plants import ARCSEC, DEG_PER_SQRT_H, AttitudeControl, Wheel, mode

EPOCH = datetime(2026, 3, 20)
ORBITS, PERIOD = 3, 5677.0  # (), s
SLEW = {"max_rate": radians(0.5), "max_acceleration": radians(0.005)}  # rad/s, rad/s^2
WANTED = {"pointing": radians(0.1), "bandwidth": 0.1}  # rad, rad/s
MUNICH = {"latitude": radians(48.1), "longitude": radians(11.6), "epoch": EPOCH}

craft = plants.spacecraft(
    name="A 6U CubeSat with magnetorquers",
    inertia=[0.12, 0.11, 0.05],  # kg m^2
    wheels=[Wheel.create(axis, max_torque=3e-3, max_momentum=15e-3, max_speed_rpm=6000) for axis in np.eye(3)],
    magnetorquers=plants.Magnetorquers.create(max_dipole=0.4),  # A m^2
    sensors=[
        plants.StarTracker.create(cross_noise=20 * ARCSEC, boresight=[0.0, 0.8, -0.6], fastest=radians(1)),
        plants.IntegratingGyro.create(random_walk=0.1 * DEG_PER_SQRT_H, turn_on_bias=radians(0.01)),
        plants.ThreeAxisMagnetometer.create(noise=1e-8),  # T
        plants.Tachometers.create(),
    ],
    orbit=plants.circular(500e3, radians(97.4), raan=1.0),
    epoch=EPOCH,
    disturbances=[plants.ResidualDipole.create([0.02, 0.01, 0.02])],  # A m^2
    dt=1.0,
)


def modes(design: synth.Design) -> list[plants.Mode]:
    """The modes: what each points at, and what it waits for."""
    dumping = plants.CrossProductDumping.create(1e-3, limit=0.2)
    law = AttitudeControl(controller=design, dumping=dumping)
    target = plants.Pointing.create(
        [0, 0, 1], plants.ToTarget.create(**MUNICH), second_axis=[1, 0, 0], second_to=plants.Forward()
    )
    detumbling = plants.Detumbling.create(4e-4, limit=0.4)
    return [
        mode("detumbling", detumbling, until=plants.Slow.create(radians(0.3), hold=60.0)),
        mode("nadir", law, until=plants.After.create(4000.0), **SLEW),
        mode("target", law, guidance=target, until=plants.After.create(600.0), **SLEW),
        mode("nadir again", law, **SLEW),
    ]


def fly(design: synth.Design, duration: float = ORBITS * PERIOD) -> tuple[plants.Run, tuple[str, ...], float]:
    """The flight, the names of its modes, and the seconds that it took after compilation."""
    made = plants.sequence(
        modes(design),
        dt=craft.dt,
        navigators=[craft.navigator],
        wheel_axes=craft.plant.body.wheel_axes,
        wheel_inertia=craft.plant.body.wheel_inertia,
        field=craft.reads(plants.ThreeAxisMagnetometer, "vector"),
        wheels=craft.reads(plants.Tachometers, "wheels"),
    )
    loop = plants.Loop(
        plant=craft.plant, controller=made.controller, sensors=craft.sensors, navigator=made.navigator,
        actuator=craft.actuator,
    )  # fmt: skip
    scenario = craft.scenario(duration, rate=radians([3.0, -2.0, 2.5]))
    run = plants.simulate(loop, scenario, record=plants.commanded_record)
    begun = perf_counter()
    run = plants.simulate(loop, scenario, record=plants.commanded_record)
    return run, made.names, perf_counter() - begun


def design() -> synth.Design:
    """The H-infinity controller of all pointing modes."""
    G = synth.c2d(craft.linear(), craft.dt)
    return synth.hinfsyn(synth.GeneralizedPlant.four_block(G, **craft.weights(**WANTED)))


def main() -> None:
    """Fly, tell when the modes changed, and draw."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("mission"), help="folder for the picture (default mission)")
    options = parser.parse_args()
    run, names, seconds = fly(design())
    for k in np.flatnonzero(np.diff(run.extra.mode, prepend=-1)):
        print(f"{run.time[k]:7.0f} s  {names[int(run.extra.mode[k])]}")
    print(f"{run.duration:.0f} s flown in {seconds:.1f} s after compilation")
    options.out.mkdir(parents=True, exist_ok=True)
    axes = run.plot(requirement=WANTED["pointing"], modes=names)
    axes[0].figure.savefig(options.out / "mission.png", dpi=110)
    run.to_parquet(options.out / "mission.parquet", force=True)
    print(f"picture and table: {options.out}")


if __name__ == "__main__":
    main()
