"""CubeSat nadir pointing: design the controllers of Pecorilla and Stesina (2024), fly them, measure their claims.

Doi 10.1002/rnc.7119. The H-infinity controller is designed and verified, flown with MPC and PD in the same nonlinear
simulator, compared with the mission requirements, and written to files together with an HTML report.
"""

from __future__ import annotations

import functools
import io
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from threading import Event
from typing import Any

import jax
import numpy as np
from cubesat3u_box import MODEL, QUANTITY, WHOSE, WITHIN, questions
from cubesat3u_budget import compared, composition, modelled, momentum, predicted, worst_inertia
from cubesat3u_claims import (
    BOUNDS,
    DIRECT,
    HINF,
    INDICES,
    MPC,
    PAPER_EKF,
    PAPER_HINF,
    PAPER_MPC,
    PD,
    SVD_HINF,
    SVD_MPC,
    passes,
    share,
    statements,
    worst,
)  # fmt: skip
from cubesat3u_controllers import design_controllers, hinfinity, model
from cubesat3u_figures import drawings, indices_figure
from cubesat3u_findings import ABBREVIATIONS, counterparts, filters, findings, summary
from cubesat3u_flights import (
    VARYING,
    Shared,
    Start,
    applied,
    case,
    measure,
    of_wide_inertia,
    on_plane,
    quiet,
    starts,
)
from cubesat3u_modes import fly_far, into_night, perturb
from cubesat3u_robustness import table as robustness
from cubesat3u_worst import question
from tqdm import tqdm

import synth
from plants import (
    Budget,
    Campaign,
    Indices,
    Run,
    Table,
    campaign,
    cubesat3u,
    ekf_record,
    indices,
    report,
    study,
)
from plants.files import write_atomically
from plants.missions.cubesat3u import REQUIREMENTS
from plants.outcome import boxes, intersample
from plants.outcome.worst import ask
from plants.outcome.worst import tables as worst_tables
from synth.delivery.qp import save_mpc

__all__ = ["SVD_MPC", "hinfinity", "main", "model"]  # also for the notebook and the tests

ORDER = (HINF, PAPER_HINF, SVD_HINF, PD, *MPC, *PAPER_MPC, *SVD_MPC)
TURNED = (HINF, PAPER_HINF, SVD_HINF)
QUIET = (SVD_HINF, *PAPER_MPC)  # with sensors of half the noise
WIDE = (HINF, PD, *MPC)  # with moments of inertia that are far off
FILTERS, NIGHT = (HINF, PAPER_HINF, DIRECT), (HINF, DIRECT)
KEPT = (" night", " moved")  # campaigns of which all trajectories are
LONG = 500.0  # s, that a flight to another attitude takes
FEW = 17  # runs at most where no more are needed: if all of so many meet a requirement, a share of 80 % is decided
BRIEF = {"": (*MPC, PAPER_MPC[1], SVD_MPC[1]), " quiet": PAPER_MPC[1:], " wide": MPC}  # `FEW` times: an MPC is dear


@dataclass
class Study(study.Study):
    """What has been measured so far."""

    design: synth.Design
    controllers: Mapping[str, Any]
    window: float  # s, start of the window of the indices
    nominal: dict[str, Indices] = field(default_factory=dict)
    campaigns: dict[str, Campaign] = field(default_factory=dict)
    turned: dict[str, Campaign] = field(default_factory=dict)  # on random orbit planes
    quiet: dict[str, Campaign] = field(default_factory=dict)  # with vector sensors of half the noise
    wide: dict[str, Campaign] = field(default_factory=dict)  # with moments of inertia that are far off
    tracked: dict[str, np.ndarray] = field(default_factory=dict)  # which runs hold another attitude than nadir
    far: dict[str, Run] = field(default_factory=dict)  # the first of them
    again: dict[str, Campaign] = field(default_factory=dict)  # table 3 over and over, with other noise
    night: dict[str, Campaign] = field(default_factory=dict)  # into the eclipse
    moved: tuple[float, float] | None = None  # m, deg, by what perturbs the orbit beyond the oblateness
    budget: Budget | None = None  # of the paper's EKF + Hinf, predicted
    worst_ape: str = ""  # over the inertia, in a sentence


def navigators() -> dict[str, Any]:
    """By the first word of a configuration."""
    ours = {"EKF": cubesat3u.consistent_ekf(), "EKF direct": cubesat3u.direct_ekf()}
    return ours | {PAPER_EKF: cubesat3u.ekf(), "SVD": cubesat3u.svd()}


def fly(found: Study, runs: int, seed: int, duration: float, then: Callable[[], None]) -> None:
    """Table 3 and the Monte Carlo of table 5 with every configuration, what else their verdicts hang on, and `then`.

    Beside all that can be compiled fly those with an MPC, which is stepped from Python.
    """
    surroundings, drawn, known = cubesat3u.environment(duration), starts(runs, seed), navigators()
    periods = round(duration / cubesat3u.CONTROL_PERIOD)
    groups = (ORDER, TURNED, QUIET, WIDE, FILTERS, NIGHT)

    def shared(name: str, environment: Any = surroundings, periods: int = periods) -> Shared:
        navigator, controller = name.split(" + ")
        return Shared(environment, found.controllers[controller], known[navigator], periods)

    def options(name: str) -> dict[str, Any]:
        own = {"seed": seed, "progress": False, "varying": VARYING}
        if "MPC" in name:  # stepped: all at once, with the paper's filters by one program however few are flown
            own["batch"] = FEW if name.startswith(MPC) else runs + 1
        return own | study.stored(found.flying, name)

    def fly_all(into: dict[str, Campaign], names: Any, how: Any, of: Any, label: str = "", **more: Any) -> None:
        for name in names:
            those = jax.tree.map(lambda part: part[:FEW], of) if name in BRIEF.get(label, ()) else of
            everything = (not label and name == PAPER_HINF) or label in KEPT
            flown = campaign(
                how, those, shared(name, **more), measure=functools.partial(measure, start=found.window),
                record=None if name.startswith("SVD") else ekf_record, read=applied if how is case else None,
                keep=range(runs + 1) if everything else () if label else [0], **options(name + label),
            )  # fmt: skip
            into[name] = flown
            if not flown.complete:
                raise KeyboardInterrupt
            if not label:
                found.nominal[name] = indices(flown.kept[0], start=found.window)
            bar.update()

    def some(stepped: bool) -> list[tuple[Any, ...]]:
        """The campaigns that may be stepped: what they fill, names, cases, starts, label."""
        wide = of_wide_inertia(drawn)
        all_ = ((found.campaigns, ORDER, case, drawn, ""), (found.quiet, QUIET, quiet, drawn, " quiet"),
                (found.wide, WIDE, case, wide, " wide"))  # fmt: skip
        return [(into, [n for n in names if ("MPC" in n) is stepped], *rest) for into, names, *rest in all_]

    def stepped(ended: Event) -> None:
        for into, names, *rest in some(True):
            for name in names:
                if ended.is_set():
                    return
                fly_all(into, [name], *rest)

    def compiled() -> None:
        for each in some(False):
            fly_all(*each)
        planes = np.array([cubesat3u.disperse(seed, index).raan for index in range(runs + 1)])
        batch = cubesat3u.environment(duration, raan=planes, argument_of_latitude=cubesat3u.noon(planes, duration))
        fly_all(found.turned, TURNED, on_plane, (drawn, batch), " turned", environment=None)
        fly_all(found.again, FILTERS, case, Start(*(np.repeat(part[:1], runs + 1, axis=0) for part in drawn)), " again")
        fly_all(found.night, NIGHT, case, drawn, " night", environment=into_night(duration))
        moved: dict[str, Campaign] = {}
        other = cubesat3u.environment(duration, moved_by=cubesat3u.perturbations())
        fly_all(moved, (PAPER_HINF,), case, drawn, " moved", environment=other)
        perturb(found, found.campaigns[PAPER_HINF].kept, moved[PAPER_HINF].kept, (surroundings, other))
        if duration >= LONG:
            fly_far(found, drawn, shared(HINF), options)
        bar.update()
        then()

    with tqdm(total=sum(map(len, groups)) + 2, desc="configurations", delay=2.0) as bar:
        try:
            study.beside(compiled, stepped)
        finally:  # in the order of the tables
            for part in (found.campaigns, found.nominal, found.quiet, found.wide):
                items = {name: part.pop(name) for name in ORDER if name in part}
                part.update(items)


def tell(found: Study, runs: int, seed: int, duration: float) -> None:
    """The pointing budget of the paper's EKF + Hinf, nominal and worst, without a flight with noise."""
    surroundings, drawn = cubesat3u.environment(duration), starts(runs, seed)
    shared = Shared(
        surroundings, found.controllers["Hinf"], cubesat3u.ekf(), round(duration / cubesat3u.CONTROL_PERIOD)
    )
    flown = [case(Start(*(part[index] for part in drawn)), shared) for index in range(1, runs + 1)]
    momenta = np.array([momentum(*pair) for pair in flown])

    def model(inertia: np.ndarray) -> dict[str, Any]:
        return modelled(case(Start(inertia, np.zeros(3), np.zeros(3)), shared), momenta, found.window)

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
            rows.append([name + kind, *(counted(m) for m in met.values())])
    note = "In brackets the 95 % interval of the probability (Clopper and Pearson)."
    return Table("Runs that meet each requirement", ("Monte Carlo", *INDICES), rows, note=note)


def counted(met: np.ndarray) -> str:
    """How many, and the interval of their share."""
    reading = share(met)
    return f"{met.sum()}/{met.size} ({100 * reading.low:.0f} to {100 * reading.high:.0f} %)"


def margins(found: Study) -> list[report.Requirement]:
    """The paper's choice in table 3's run against table 1, worst axis."""
    if HINF not in found.nominal:
        return []
    levels = {name: float(worst(found.nominal[HINF], key)) for name, key in INDICES.items()}
    return [report.Requirement(f"{name}, {HINF}", level, BOUNDS[name], "deg") for name, level in levels.items()]


def exported(found: Study, out: Path) -> report.Card:
    """The card of the H-infinity controller, with its C code."""
    card = study.card("H-infinity", found.design, out, "hinf")
    files = synth.export(found.design, "c", out, name="hinf", force=True)
    return card._replace(files=[*card.files, *((path.name, "C code, with its self-test") for path in files)])


def at_a_glance(found: Study) -> tuple[Any, str] | None:
    """Every run's indices against the requirements."""
    if HINF not in found.nominal:
        return None
    return indices_figure(found), "Indices of every run, worst axis, and the requirements (figure 16, all loops)."


def save(found: Study, out: Path) -> list[report.Card]:
    """The controllers' files in `out`, and their cards."""
    cards = [exported(found, out)]
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


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast, what = "200 s flights, 3 dispersed runs, no search for the worst, no proofs", "dispersed runs of table 5"
    parser = study.parser(__doc__, out="out/cubesat3u", fast=fast, runs=30, what=what)
    options = study.parse(parser, arguments)
    runs, duration, window = (min(options.runs, 3), 200.0, 100.0) if options.fast else (options.runs, 1000.0, 300.0)
    design, controllers = design_controllers()
    print(f"{design}\n", flush=True)
    found = Study(design, controllers, window)

    def then() -> None:
        if not options.fast:
            asked = question(controllers["Hinf"], starts(runs, options.seed))
            ask(asked, found.worst, seed=options.seed, flights=64, rounds=4)
            boxes.ask(questions(controllers, {"Hinf": WITHIN}), found.boxes, synth)
        if not options.fast and runs > 1:
            tell(found, runs, options.seed, duration)

    study.carry_out(found, lambda: fly(found, runs, options.seed, duration, then), options)
    told = [] if found.budget is None else [compared(found, found.budget, found.worst_ape)]
    made_of = [] if found.budget is None else [composition(found.budget)]
    return study.conclude(
        found,
        options.out,
        title="CubeSat nadir pointing",
        subtitle="H-infinity, MPC and PD in one nonlinear simulator; after Pecorilla and Stesina (2024), "
        "doi 10.1002/rnc.7119",
        tables=[requirements(found), monte_carlo(found), filters(found), robustness(found), *told,
                *boxes.tables(found.boxes, options.out, quantity=QUANTITY, model=MODEL),
                *intersample.tables([a.question for a in found.boxes], synth, quantity=QUANTITY),
                *worst_tables(found.worst)],
        statements=statements(found),
        findings=[*findings(found), *boxes.findings(found.boxes, WHOSE)],
        requirements=margins(found),
        cards=save(found, options.out),
        sections=[*made_of, *(drawings(found) if PAPER_HINF in found.nominal else [])],
        settings=f"{runs} dispersed runs, seed {options.seed}, {duration:g} s flights, window from {window:g} s",
        packages=("cvxpy", "clarabel", "daqp"),
        paper="003 Pecorilla and Stesina (2024)",
        counterparts=counterparts(),
        summary=summary(found),
        abbreviations=ABBREVIATIONS,
        first=at_a_glance(found),
        notes=[f"plant {design.plant.system.digest()[:16]}, {design.info.date}"],
    )  # fmt: skip


if __name__ == "__main__":
    raise SystemExit(main())
