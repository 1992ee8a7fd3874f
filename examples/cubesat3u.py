"""CubeSat nadir pointing: design the controllers of Pecorilla and Stesina (2024), fly them, measure their claims.

Doi 10.1002/rnc.7119. The H-infinity controller is designed and verified, flown with MPC and PD in the same nonlinear
simulator, compared with the mission requirements, and written to files together with an HTML report.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import platform
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from cubesat3u_claims import (
    BOUNDS,
    DIRECT,
    HINF,
    INDICES,
    MPC,
    PD,
    SVD_HINF,
    SVD_MPC,
    claims,
    findings,
    passes,
    worst,
)  # fmt: skip
from cubesat3u_figures import drawings, indices_figure
from tqdm import tqdm

import synth
from plants import attitude, campaign, cubesat3u, indices, report, simulate
from plants.cubesat3u import DEG, REQUIREMENTS
from plants.indices import Indices
from plants.loop import Loop, Run, Scenario
from synth.export.qp import save_mpc


class Start(NamedTuple):
    """What differs between the runs of the campaign; run 0 is table 3, the others are drawn from table 5."""

    inertia: np.ndarray  # (3,) kg m^2
    angles: np.ndarray  # (3,) rad
    rates: np.ndarray  # (3,) rad/s


class Shared(NamedTuple):
    """What the runs of one configuration have in common."""

    environment: Any
    controller: Any
    navigator: Any
    periods: int


@dataclass
class Study:
    """What has been measured so far; complete unless interrupted."""

    design: synth.Design
    controllers: Mapping[str, Any]
    window: float  # s, start of the window of the indices
    nominal: dict[str, Indices] = field(default_factory=dict)
    campaigns: dict[str, campaign.Campaign] = field(default_factory=dict)
    turned: dict[str, campaign.Campaign] = field(default_factory=dict)  # on random orbit planes
    quiet: dict[str, Indices] = field(default_factory=dict)  # with vector sensors of half the noise
    eclipse: dict[str, Run] = field(default_factory=dict)  # one orbit with its eclipse
    complete: bool = False
    seconds: float = 0.0


def design_controllers() -> tuple[synth.Design, dict[str, Any]]:
    """The verified H-infinity design of table 4, and all controllers by name."""
    model = synth.StateSpace(*cubesat3u.linear_model(), cubesat3u.CONTROL_PERIOD)
    W = cubesat3u.WEIGHTS
    torque, state = ("Tx", "Ty", "Tz"), ("q1", "q2", "q3", "wx", "wy", "wz")
    units = dict.fromkeys(torque, "N m") | dict.fromkeys(state[:3], "1") | dict.fromkeys(state[3:], "rad/s")
    plant = synth.GeneralizedPlant.tracking(
        model, Wproc=W.proc, Wdist=W.dist, Werr=W.err, Wact=W.act, Wr=W.ref, u=torque, y=state, units=units
    )
    design = synth.hinfsyn(plant)
    limits = np.concatenate([np.full(3, np.inf), np.full(3, cubesat3u.MPC_RATE_LIMIT)])

    def predictive(form: str) -> synth.Mpc:
        return synth.mpc(
            model,
            Q=cubesat3u.MPC_STATE_WEIGHT * np.eye(6),
            R=cubesat3u.MPC_INPUT_WEIGHT * np.eye(3),
            Np=cubesat3u.MPC_HORIZON,
            Nc=cubesat3u.MPC_MOVES,
            umin=-cubesat3u.WHEEL_TORQUE,
            umax=cubesat3u.WHEEL_TORQUE,
            form=form,
            ymin=-limits,
            ymax=limits,
            hmax=cubesat3u.WHEEL_INERTIA * cubesat3u.WHEEL_SPEED,
        )

    return design, {
        "Hinf": synth.LinearController.of(design.controller),
        "MPC velocity": predictive("velocity"),
        "MPC position": predictive("position"),
        "PD": synth.proportional_derivative(cubesat3u.INERTIA, 0.17, 0.8, cubesat3u.CONTROL_PERIOD),
    }


def starts(runs: int, seed: int) -> Start:
    """Table 3 and `runs` draws of table 5."""

    def one(seed: int, index: int) -> Start:
        if index == 0:
            return Start(cubesat3u.INERTIA, cubesat3u.ANGLES, cubesat3u.RATES)
        drawn = cubesat3u.disperse(seed, index)
        return Start(drawn.inertia, drawn.angles, drawn.rates)

    return campaign.draw(one, runs + 1, seed)


def case(start: Start, shared: Shared) -> tuple[Loop, Scenario]:
    """One run as the simulator takes it."""
    loop = Loop(
        plant=cubesat3u.body(start.inertia),
        controller=shared.controller,
        sensors=cubesat3u.suite(),
        navigator=shared.navigator,
        actuator=cubesat3u.wheels(),
    )
    return loop, Scenario(
        initial=cubesat3u.initial_state(shared.environment, start.angles, start.rates),
        dt=cubesat3u.CONTROL_PERIOD,
        periods=shared.periods,
        samples=cubesat3u.SAMPLES,
        environment=shared.environment,
    )


def applied(loop: Loop, scenario: Scenario) -> Start:
    """The dispersion read back from the blocks that fly."""
    with jax.enable_x64(True):
        y = np.asarray(loop.plant.output(scenario.initial, scenario.environment.at(0.0)))
        q = np.concatenate([[np.sqrt(1 - y[:3] @ y[:3])], y[:3]])
        return Start(np.diag(loop.plant.inertia), np.asarray(attitude.to_euler(q)), y[3:])


def quiet(loop: Loop, scenario: Scenario) -> tuple[Loop, Scenario]:
    """The same run with Sun sensor and magnetometer of half the noise: table 2 of the paper is not in the text."""
    sun, field_ = loop.sensors.sun, loop.sensors.magnetometer
    sun, field_ = (dataclasses.replace(sensor, noise=sensor.noise / 2) for sensor in (sun, field_))
    return dataclasses.replace(loop, sensors=dataclasses.replace(loop.sensors, sun=sun, magnetometer=field_)), scenario


def on_plane(drawn: tuple[Start, Any], shared: Shared) -> tuple[Loop, Scenario]:
    """`case` in an environment of its own."""
    start, surroundings = drawn
    return case(start, shared._replace(environment=surroundings))


def fly(study: Study, runs: int, seed: int, duration: float) -> None:
    """Table 3 and the Monte Carlo of table 5 with every configuration, then random orbit planes and an eclipse."""
    surroundings = cubesat3u.environment(duration)
    drawn = starts(runs, seed)
    periods = round(duration / cubesat3u.CONTROL_PERIOD)
    measure = functools.partial(indices.indices, start=study.window, delta_t=REQUIREMENTS.pse_interval)
    navigators = {"EKF": cubesat3u.ekf(), "SVD": cubesat3u.svd(), "EKF direct": cubesat3u.ekf(direct=True)}
    order, turned = (HINF, SVD_HINF, PD, *MPC, *SVD_MPC), (HINF, SVD_HINF)
    orbits = 5.64 * duration  # s, the period of the orbit for full runs: 38 minutes of eclipse
    with tqdm(total=len(order) + len(turned) + 4, desc="configurations", delay=2.0) as bar:
        for name in order:
            navigator, controller = name.split(" + ")
            shared = Shared(surroundings, study.controllers[controller], navigators[navigator], periods)
            keep = range(runs + 1) if name == HINF else [0]
            flown = campaign.campaign(
                case, drawn, shared, measure=measure, read=applied, seed=seed, keep=keep, progress=False
            )
            study.campaigns[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
            study.nominal[name] = indices.indices(flown.kept[0], start=study.window)
            bar.update()
        planes = np.array([cubesat3u.disperse(seed, index).raan for index in range(runs + 1)])
        batch = cubesat3u.environment(duration, raan=planes, argument_of_latitude=cubesat3u.noon(planes, duration))
        for name in turned:
            navigator, controller = name.split(" + ")
            shared = Shared(None, study.controllers[controller], navigators[navigator], periods)
            flown = campaign.campaign(on_plane, (drawn, batch), shared, measure=measure, seed=seed, progress=False)
            study.turned[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
            bar.update()
        start = Start(cubesat3u.INERTIA, cubesat3u.ANGLES, cubesat3u.RATES)
        for name in (SVD_HINF, *MPC):
            navigator, controller = name.split(" + ")
            shared = Shared(surroundings, study.controllers[controller], navigators[navigator], periods)
            study.quiet[name] = measure(simulate.simulate_many([quiet(*case(start, shared))], progress=False)[0])
        bar.update(2)
        night = cubesat3u.environment(orbits)
        for name in (HINF, DIRECT):
            navigator, controller = name.split(" + ")
            shared = Shared(night, study.controllers[controller], navigators[navigator], round(orbits / 0.5))
            study.eclipse[name] = simulate.simulate_many([case(start, shared)], progress=False)[0]
            bar.update()
    study.complete = True


def requirement_rows(study: Study) -> tuple[list[list[str]], list[list[str]]]:
    """The table of requirements of table 3's run: texts and marks."""
    rows = [["requirement (table 1)", *(f"{BOUNDS[name]:.2f}" for name in INDICES), "", ""]]
    marks = [[""] * 7]
    for name, i in study.nominal.items():
        met = passes(i)
        settles = f"{float(i.settling_time):.0f}" if np.isfinite(i.settling_time) else "never"
        figures_ = [f"{worst(i, key):.4f}" for key in INDICES.values()]
        rows.append([name, *figures_, settles, f"{1e3 * i.effort.sum():.1f}"])
        marks.append(["", *("pass" if met[index] else "fail" for index in INDICES), "", ""])
    return rows, marks


def campaign_rows(study: Study) -> list[list[str]]:
    """How many runs of the Monte Carlo meet each requirement."""
    rows = []
    for kind, group in (("", study.campaigns), (", random sunlit orbit planes", study.turned)):
        for name, flown in group.items():
            drawn = flown.index > 0 if not kind else flown.index >= 0
            met = {index: m[drawn] for index, m in passes(flown.results).items()} if flown.results is not None else {}
            rows.append([name + kind, *(f"{m.sum()}/{m.size}" for m in met.values())])
    return rows


HEADERS = ("worst axis, 95 %, deg", *INDICES, "settles to 1 deg, s", "effort, mN m s")


def write(study: Study, judged: list[report.Claim], out: Path, settings: str) -> Path:
    """Report and controller files into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    files = []
    for ending in ("json", "mat"):
        study.design.save(out / f"hinf.{ending}")
        files.append((f"hinf.{ending}", "the verified H-infinity controller with its plant"))
        for form in ("velocity", "position"):
            save_mpc(study.controllers[f"MPC {form}"], out / f"mpc_{form}.{ending}")
            files.append((f"mpc_{form}.{ending}", f"the quadratic program of the MPC, {form} form"))
    rows, marks = requirement_rows(study)
    angle = cubesat3u.environment(study.nominal[HINF].end).sun_field_angle() / DEG if study.nominal else np.zeros(1)
    card = report.paragraph(repr(study.design)) + report.paragraph(
        f"Angle between Sun and field during the run: {angle.min():.0f} to {angle.max():.0f} deg. It sets the level "
        "of the attitude knowledge."
    )
    sections = [
        report.Section("Requirements", report.table(HEADERS, rows, marks=marks)),
        report.Section("The paper's claims, measured", report.claims_table(judged)),
        report.Section("What the paper does not say", "".join(map(report.paragraph, findings(study)))),
        report.Section(
            "Runs that meet each requirement", report.table(("Monte Carlo", *INDICES), campaign_rows(study))
        ),
        report.Section("Controller", card + report.links(files)),
    ]
    if HINF in study.nominal:
        sections += drawings(study)
        indices_figure(study).savefig(out / "indices.png", dpi=120, facecolor="white")
    versions = ", ".join(
        f"{n} {metadata.version(n)}" for n in ("convex-synth", "cvxpy", "clarabel", "daqp", "jax", "numpy")
    )
    state = "complete" if study.complete else "INTERRUPTED: what was flown until then"
    path = out / "report.html"
    page = report.page(
        "CubeSat nadir pointing",
        "H-infinity, MPC and PD in one nonlinear simulator; after Pecorilla and Stesina (2024), doi 10.1002/rnc.7119",
        sections,
        [f"{settings}; {state}; {study.seconds:.0f} s", f"Python {platform.python_version()}, {versions}",
         f"plant {study.design.plant.system.digest()[:16]}, {study.design.info.date}"],
    )  # fmt: skip
    path.write_text(page, encoding="utf-8")
    return path


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fast", action="store_true", help="200 s flights and 3 dispersed runs: a quick look")
    parser.add_argument("--runs", type=int, default=30, help="dispersed runs of table 5 (default 30)")
    parser.add_argument("--seed", type=int, default=0, help="of dispersions and noise (default 0)")
    parser.add_argument("--out", type=Path, default=Path("out/cubesat3u"), help="folder for report and controllers")
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs {options.runs}: at least one run is needed")
    if options.seed < 0:
        parser.error(f"--seed {options.seed}: give a whole number of at least 0")
    runs, duration, window = (min(options.runs, 3), 200.0, 100.0) if options.fast else (options.runs, 1000.0, 300.0)
    started = time.perf_counter()
    design, controllers = design_controllers()
    print(f"{design}\n", flush=True)
    study = Study(design, controllers, window)
    try:
        fly(study, runs, options.seed, duration)
    except KeyboardInterrupt:
        print("interrupted: the report holds what was flown")
    study.seconds = time.perf_counter() - started
    print(report.text_table(HEADERS, requirement_rows(study)[0]))
    print(f"(window {window:g} to {duration:g} s, PSE over {REQUIREMENTS.pse_interval:g} s)\n")
    print(report.text_table(("runs that meet it", *INDICES), campaign_rows(study)), end="\n\n")
    judged = claims(study)
    for claim in judged:
        print(f"{claim.text}\n  {claim.verdict}: {claim.measured}")
    print("\n".join(["", *findings(study)]))
    settings = f"{runs} dispersed runs, seed {options.seed}, {duration:g} s flights, window from {window:g} s"
    path = write(study, judged, options.out, settings)
    print(f"\nsynthesis {design.info.seconds:.2f} s, in all {time.perf_counter() - started:.0f} s; report: {path}")
    return 0 if study.complete else 130


if __name__ == "__main__":
    raise SystemExit(main())
