"""CubeSat nadir pointing: design the controllers of Pecorilla and Stesina (2024), fly them, measure their claims.

Doi 10.1002/rnc.7119. The H-infinity controller is designed and verified, flown with MPC and PD in the same nonlinear
simulator, compared with the mission requirements, and written to files together with an HTML report.
"""

from __future__ import annotations

import dataclasses
import functools
import io
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np
from cubesat3u_budget import compared, composition, modelled, predicted, worst_inertia
from cubesat3u_claims import (
    BOUNDS,
    DIRECT,
    HINF,
    INDICES,
    MPC,
    PD,
    SVD_HINF,
    SVD_MPC,
    findings,
    passes,
    statements,
    worst,
)  # fmt: skip
from cubesat3u_figures import drawings, indices_figure
from cubesat3u_worst import question
from tqdm import tqdm

import synth
from plants import (
    Budget,
    Campaign,
    Indices,
    Loop,
    Run,
    Scenario,
    Table,
    attitude,
    campaign,
    cubesat3u,
    draw,
    indices,
    report,
    simulate_many,
    study,
)
from plants.files import write_atomically
from plants.missions.cubesat3u import DEG, REQUIREMENTS
from plants.outcome.worst import ask
from plants.outcome.worst import tables as worst_tables
from synth.delivery.qp import save_mpc


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
class Study(study.Study):
    """What has been measured so far."""

    design: synth.Design
    controllers: Mapping[str, Any]
    window: float  # s, start of the window of the indices
    nominal: dict[str, Indices] = field(default_factory=dict)
    campaigns: dict[str, Campaign] = field(default_factory=dict)
    turned: dict[str, Campaign] = field(default_factory=dict)  # on random orbit planes
    quiet: dict[str, Indices] = field(default_factory=dict)  # with vector sensors of half the noise
    eclipse: dict[str, Run] = field(default_factory=dict)  # one orbit with its eclipse
    budget: Budget | None = None  # of EKF + Hinf, predicted
    worst_ape: str = ""  # over the inertia, in a sentence


def model() -> synth.StateSpace:
    """The linear model about nadir, torque to quaternion and rate."""
    return synth.StateSpace(*cubesat3u.linear_model(), cubesat3u.CONTROL_PERIOD)


def hinfinity(W: cubesat3u.Weights = cubesat3u.WEIGHTS) -> synth.Design:
    """The verified H-infinity design, by default with the weights of table 4."""
    torque, state = ("Tx", "Ty", "Tz"), ("q1", "q2", "q3", "wx", "wy", "wz")
    units = dict.fromkeys(torque, "N m") | dict.fromkeys(state[:3], "1") | dict.fromkeys(state[3:], "rad/s")
    return synth.hinfsyn(
        synth.GeneralizedPlant.tracking(
            model(), Wproc=W.proc, Wdist=W.dist, Werr=W.err, Wact=W.act, Wr=W.ref, u=torque, y=state, units=units
        )
    )


def design_controllers() -> tuple[synth.Design, dict[str, Any]]:
    """The verified H-infinity design of table 4, and all controllers by name."""
    design, nominal = hinfinity(), model()
    limits = np.concatenate([np.full(3, np.inf), np.full(3, cubesat3u.MPC_RATE_LIMIT)])

    def predictive(form: str) -> synth.Mpc:
        return synth.mpc(
            nominal,
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

    hinf = synth.LinearController.of(design.controller)
    pd = synth.proportional_derivative(cubesat3u.INERTIA, 0.17, 0.8, cubesat3u.CONTROL_PERIOD)
    return design, {
        "Hinf": hinf,
        "MPC velocity": predictive("velocity"),
        "MPC position": predictive("position"),
        "PD": pd.padded(len(hinf.A)),  # one compiled flight for both
    }


def starts(runs: int, seed: int) -> Start:
    """Table 3 and `runs` draws of table 5."""

    def one(seed: int, index: int) -> Start:
        if index == 0:
            return Start(cubesat3u.INERTIA, cubesat3u.ANGLES, cubesat3u.RATES)
        drawn = cubesat3u.disperse(seed, index)
        return Start(drawn.inertia, drawn.angles, drawn.rates)

    return draw(one, runs + 1, seed)


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


def fly(found: Study, runs: int, seed: int, duration: float) -> None:
    """Table 3 and the Monte Carlo of table 5 with every configuration, then random orbit planes and an eclipse."""
    surroundings = cubesat3u.environment(duration)
    drawn = starts(runs, seed)
    periods = round(duration / cubesat3u.CONTROL_PERIOD)
    measure = functools.partial(indices, start=found.window, delta_t=REQUIREMENTS.pse_interval)
    navigators = {"EKF": cubesat3u.ekf(), "SVD": cubesat3u.svd(), "EKF direct": cubesat3u.ekf(direct=True)}
    order, turned = (HINF, SVD_HINF, PD, *MPC, *SVD_MPC), (HINF, SVD_HINF)
    orbits = 5.64 * duration  # s, the period of the orbit for full runs: 38 minutes of eclipse
    with tqdm(total=len(order) + len(turned) + 4, desc="configurations", delay=2.0) as bar:
        for name in order:
            navigator, controller = name.split(" + ")
            shared = Shared(surroundings, found.controllers[controller], navigators[navigator], periods)
            keep = range(runs + 1) if name == HINF else [0]
            options = {"measure": measure, "seed": seed, "progress": False, **study.stored(found.flying, name)}
            flown = campaign(case, drawn, shared, read=applied, keep=keep, **options)
            found.campaigns[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
            found.nominal[name] = indices(flown.kept[0], start=found.window)
            bar.update()
        planes = np.array([cubesat3u.disperse(seed, index).raan for index in range(runs + 1)])
        batch = cubesat3u.environment(duration, raan=planes, argument_of_latitude=cubesat3u.noon(planes, duration))
        for name in turned:
            navigator, controller = name.split(" + ")
            shared = Shared(None, found.controllers[controller], navigators[navigator], periods)
            options = {
                "measure": measure,
                "seed": seed,
                "progress": False,
                **study.stored(found.flying, f"{name} turned"),
            }
            flown = campaign(on_plane, (drawn, batch), shared, **options)
            found.turned[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
            bar.update()
        start = Start(cubesat3u.INERTIA, cubesat3u.ANGLES, cubesat3u.RATES)
        for name in (SVD_HINF, *MPC):
            navigator, controller = name.split(" + ")
            shared = Shared(surroundings, found.controllers[controller], navigators[navigator], periods)
            found.quiet[name] = measure(simulate_many([quiet(*case(start, shared))], progress=False)[0])
        bar.update(2)
        night = cubesat3u.environment(orbits)
        for name in (HINF, DIRECT):
            navigator, controller = name.split(" + ")
            shared = Shared(night, found.controllers[controller], navigators[navigator], round(orbits / 0.5))
            found.eclipse[name] = simulate_many([case(start, shared)], progress=False)[0]
            bar.update()


def tell(found: Study, runs: int, seed: int, duration: float) -> None:
    """The pointing budget of EKF + Hinf, nominal and worst, without a flight with noise."""
    surroundings, drawn = cubesat3u.environment(duration), starts(runs, seed)
    shared = Shared(
        surroundings, found.controllers["Hinf"], cubesat3u.ekf(), round(duration / cubesat3u.CONTROL_PERIOD)
    )
    flown = [case(Start(*(part[index] for part in drawn)), shared) for index in range(1, runs + 1)]

    def model(inertia: np.ndarray) -> dict[str, Any]:
        return modelled(case(Start(inertia, np.zeros(3), np.zeros(3)), shared), flown, found.window)

    nominal = model(cubesat3u.INERTIA)
    found.budget, found.worst_ape = predicted(nominal), worst_inertia(model, nominal)


def requirements(found: Study) -> Table:
    """Table 3's run against table 1."""
    rows = [["requirement (table 1)", *(f"{BOUNDS[name]:.2f}" for name in INDICES), "", ""]]
    marks = [[""] * 7]
    for name, i in found.nominal.items():
        met = passes(i)
        settles = f"{float(i.settling_time):.0f}" if np.isfinite(i.settling_time) else "never"
        levels = [f"{worst(i, key):.4f}" for key in INDICES.values()]
        rows.append([name, *levels, settles, f"{1e3 * i.effort.sum():.1f}"])
        marks.append(["", *("pass" if met[index] else "fail" for index in INDICES), "", ""])
    headers = ("worst axis, 95 %, deg", *INDICES, "settles to 1 deg, s", "effort, mN m s")
    note = f"window from {found.window:g} s, PSE over {REQUIREMENTS.pse_interval:g} s"
    return Table("Requirements", headers, rows, marks, note)


def monte_carlo(found: Study) -> Table:
    """How many runs of the Monte Carlo meet each requirement."""
    rows = []
    for kind, group in (("", found.campaigns), (", random sunlit orbit planes", found.turned)):
        for name, flown in group.items():
            drawn = flown.index > 0 if not kind else flown.index >= 0
            met = {index: m[drawn] for index, m in passes(flown.results).items()} if flown.results is not None else {}
            rows.append([name + kind, *(f"{m.sum()}/{m.size}" for m in met.values())])
    return Table("Runs that meet each requirement", ("Monte Carlo", *INDICES), rows)


def margins(found: Study) -> list[report.Requirement]:
    """The paper's choice in table 3's run against table 1, worst axis."""
    if HINF not in found.nominal:
        return []
    levels = {name: float(worst(found.nominal[HINF], key)) for name, key in INDICES.items()}
    return [report.Requirement(f"{name}, {HINF}", level, BOUNDS[name], "deg") for name, level in levels.items()]


def save(found: Study, out: Path) -> list[report.Card]:
    """The controllers' files in `out`, and their cards."""
    cards = [study.card("H-infinity", found.design, out, "hinf")]
    for form in ("velocity", "position"):
        controller, files = found.controllers[f"MPC {form}"], [f"mpc_{form}.{ending}" for ending in study.FILES]
        for file in files:
            save_mpc(controller, out / file)
        facts = [("form", form), ("sampling time", f"{controller.dt:g} s"), ("horizon", cubesat3u.MPC_HORIZON),
                 ("free moves", cubesat3u.MPC_MOVES), ("solver", "DAQP")]  # fmt: skip
        cards.append(report.Card(f"MPC, {form} form", facts, [(file, "the quadratic program") for file in files]))
    if HINF in found.nominal:
        indices_figure(found).savefig(picture := io.BytesIO(), format="png", dpi=120, facecolor="white")
        write_atomically(out / "indices.png", picture.getvalue())
    return cards


def sun_and_field(found: Study) -> list[str]:
    """What the level of the attitude knowledge depends on."""
    if not found.nominal:
        return []
    angle = cubesat3u.environment(found.nominal[HINF].end).sun_field_angle() / DEG
    return [
        f"The angle between Sun and field, {angle.min():.0f} to {angle.max():.0f} deg during the run, sets the level "
        "of the attitude knowledge."
    ]


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast, what = "200 s flights, 3 dispersed runs, no search for the worst", "dispersed runs of table 5"
    parser = study.parser(__doc__, out="out/cubesat3u", fast=fast, runs=30, what=what)
    options = study.parse(parser, arguments)
    runs, duration, window = (min(options.runs, 3), 200.0, 100.0) if options.fast else (options.runs, 1000.0, 300.0)
    design, controllers = design_controllers()
    print(f"{design}\n", flush=True)
    found = Study(design, controllers, window)

    def measure() -> None:
        fly(found, runs, options.seed, duration)
        if not options.fast:
            asked = question(controllers["Hinf"], starts(runs, options.seed))
            ask(asked, found.worst, seed=options.seed, flights=64, rounds=4)
        if not options.fast and runs > 1:
            tell(found, runs, options.seed, duration)

    study.carry_out(found, measure, options)
    told = [] if found.budget is None else [compared(found, found.budget, found.worst_ape)]
    made_of = [] if found.budget is None else [composition(found.budget)]
    return study.conclude(
        found,
        options.out,
        title="CubeSat nadir pointing",
        subtitle="H-infinity, MPC and PD in one nonlinear simulator; after Pecorilla and Stesina (2024), "
        "doi 10.1002/rnc.7119",
        tables=[requirements(found), monte_carlo(found), *told, *worst_tables(found.worst)],
        statements=statements(found),
        findings=[*findings(found), *sun_and_field(found)],
        requirements=margins(found),
        cards=save(found, options.out),
        sections=[*made_of, *(drawings(found) if HINF in found.nominal else [])],
        settings=f"{runs} dispersed runs, seed {options.seed}, {duration:g} s flights, window from {window:g} s",
        packages=("cvxpy", "clarabel", "daqp"),
        notes=[f"plant {design.plant.system.digest()[:16]}, {design.info.date}"],
    )


if __name__ == "__main__":
    raise SystemExit(main())
