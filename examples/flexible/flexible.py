"""Flexible satellite: a proved optimum that 1 % of its parameters destabilises, and controllers proved over 20 %.

A hub with panels, lightly damped. Roll is controlled by the H-infinity optimum of the nominal parameters, by one of a
model with more damping, by D-K iteration, by a second-order controller tuned over the box of parameters, and by PD.
The gain of each is bounded from both sides over the box, and all are flown over it with the whole satellite.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from flexible_claims import findings, least_quiet, statements, summary
from flexible_designs import (
    COUPLINGS,
    FREQUENCIES,
    NOMINAL,
    ROLL,
    SPREAD,
    SPREAD_OF_DAMPING,
    TUNED,
    designs,
    law,
    uncertain,
)
from flexible_flights import DEG, DURATION, PERIOD, QUIET, STEADY, Study, case, configurations, drawn, outcome
from matplotlib.figure import Figure

from plants import Table, draw, figures, report, study
from plants.outcome.inline import STYLE
from synth import Design, StateSpace, hinfnorm, stability_margin, worst_gain

TOLERANCE = 1e-3  # relative, between what is reached and what is proved
WIDE = 30.0  # percent, the widest box
PARAMETERS = {"J": ROLL, "w1": FREQUENCIES[0], "w2": FREQUENCIES[1]}
UNITS = {"J": "inertia", "w1": "first frequency", "w2": "second frequency"}
ABBREVIATIONS = {
    "box": "all parameters independently within so many percent of nominal",
    "gain": "H-infinity norm from torque and noise to angle and effort, all scaled",
    "PD": "proportional and derivative feedback with roll-off",
    "rms": "root of the mean square",
}


def analyse(found: Study, fast: bool) -> None:
    """Designs, margins and gains over boxes, everything proved from both sides."""
    found.designs |= designs(rounds=1 if fast else 4)
    boxes, tol = (() if fast else (1 / 3, 2 / 3, 1.0)), 10 * TOLERANCE if fast else TOLERANCE
    found.optimum = found.designs[NOMINAL].certify()
    for name, K in found.designs.items():
        loop = uncertain().close(K)
        found.margins[name] = stability_margin(loop, tol=tol)
        limit = SPREAD * found.margins[name].lower
        sizes = {round(min(WIDE, 0.9 * limit) * part, 6) for part in boxes} | ({SPREAD} if limit > SPREAD else set())
        found.gains[name] = {p: worst_gain(uncertain(p), K, tol=tol) for p in sorted(sizes)}
        if limit > SPREAD and (name == TUNED or not fast):
            found.whole[name] = worst_gain(uncertain(SPREAD, SPREAD_OF_DAMPING), K, tol=10 * TOLERANCE)
        for parameter in PARAMETERS:
            found.along.setdefault(parameter, {})[name] = along(K, parameter, 5 if fast else 41)


def along(K: Any, parameter: str, points: int) -> np.ndarray:
    """(points, 2): percent from nominal, and the gain with the other parameters nominal; inf where unstable."""
    loop, percent = uncertain(WIDE).close(K), np.linspace(-WIDE, WIDE, points)
    gains = [hinfnorm(loop.at(PARAMETERS | {parameter: PARAMETERS[parameter] * (1 + p / 100)}))[0] for p in percent]
    return np.stack([percent, gains], axis=1)


def fly(found: Study, duration: float, runs: int, seed: int) -> None:
    """Analysis, then every controller over the box, the same flights for all."""
    analyse(found, duration < DURATION)
    study.campaigns(
        case, draw(drawn, runs, seed), configurations(found.designs, duration), found.campaigns,
        measure=outcome, seed=seed, keep={name: range(runs) for name in found.designs}, workers=1, **found.flying,
    )  # fmt: skip


def robustness(found: Study) -> Table:
    """The box, from both sides."""
    rows = []
    for name, gains in found.gains.items():
        m, gain, whole = found.margins[name], gains.get(SPREAD), found.whole.get(name)
        rows.append((
            name, law(found.designs[name]).n, f"{hinfnorm(uncertain().close(found.designs[name]).nominal)[0]:.4f}",
            "unstable" if gain is None else f"{gain.lower:.4f}", "" if gain is None else f"{gain.upper:.4f}",
            "" if whole is None else f"{whole.upper:.4f}", f"{SPREAD * m.lower:.4g}", f"{SPREAD * m.upper:.4g}",
        ))  # fmt: skip
    return Table(
        "Over the box",
        ("controller", "order", "nominal gain", f"reached in {SPREAD:g} %", "proved", "with damping", "stable to, %",
         "unstable at, %"),
        rows,
        note=f"Inertia and both frequencies within {SPREAD:g} %; with damping: it is within {SPREAD_OF_DAMPING:g} % as "
        f"well. With {100 * (1 - np.square(COUPLINGS).sum() / ROLL):.1f} % less inertia the hub has none. "
        "What is proved is in the certificates beside this page, for `synth verify`.",
    )  # fmt: skip


def counterexample(found: Study) -> Table:
    """The parameters that refute the nominal optimum."""
    m = found.margins[NOMINAL]
    rows = [(name, f"{PARAMETERS[name]:g}", f"{v:.8g}", f"{100 * (v / PARAMETERS[name] - 1):+.4f}")
            for name, v in m.parameters.items()]  # fmt: skip
    poles = uncertain().close(found.designs[NOMINAL])
    beyond = {name: PARAMETERS[name] + 1.1 * (v - PARAMETERS[name]) for name, v in m.parameters.items()}
    worst = max(poles.at(beyond).poles(), key=lambda p: p.real)
    return Table(
        "The counterexample", ("parameter", "nominal", "here", "off by, %"), rows,
        note=f"At the nominal parameters the optimum's gain is below {found.optimum.upper:.6g}, and no controller has "
        f"less than {found.optimum.lower:.6g}: both are proved. Here its loop has the pole {m.eigenvalue:.4g} rad/s, "
        f"a tenth farther {worst:.4g} rad/s.",
    )  # fmt: skip


def flights(found: Study) -> Table:
    """Every controller over the box."""
    rows = []
    for name in found.campaigns:
        o, quiet, stable = found.outcome(name), found.quiet(name), found.stable(name)
        rows.append((
            name, f"{quiet.sum()}/{len(quiet)}", f"{stable.sum()}/{len(stable)}", f"{np.median(o.error):.5f}",
            f"{np.max(o.error):.5f}", f"{np.max(o.bending):.5f}", f"{np.max(o.torque):.4f}",
        ))  # fmt: skip
    return Table(
        "Flights over the box",
        ("controller", "quiet", "stable by its poles", "roll, deg: median", "worst", "bending, worst", "torque, N m"),
        rows,
        note=f"Rms from {STEADY:g} s on, of roll about its mean; quiet: below {QUIET:g} deg. The same inertias, "
        "frequencies, dampings, starts and noise for every controller. Bending: the first mode, sqrt(kg) m. The "
        f"proofs are of continuous loops; here the controllers are sampled every {PERIOD:g} s, behind a filter.",
    )  # fmt: skip


def curves(panels: Mapping[str, Mapping[str, np.ndarray]], label: str, marker: str = "") -> Figure:
    """Gains (k, 2) against percent, one axes for each panel."""
    with mpl.rc_context(STYLE):
        fig = Figure(figsize=(figures.WIDTH, 0.9 + 1.7 * len(panels)), layout="constrained")
        axes = fig.subplots(len(panels), 1, squeeze=False, sharex=True)[:, 0]
        for ax, (title, series) in zip(axes, panels.items(), strict=True):
            for (name, points), dashes in zip(series.items(), cycle(figures.DASHES)):
                values = np.where(np.isfinite(points[:, 1]), points[:, 1], np.nan)
                ax.plot(points[:, 0], values, ls=dashes, marker=marker, ms=3, label=name)
            ax.set(yscale="log", ylabel=title or "gain", ylim=(0.5, 30))
            ax.yaxis.set_major_formatter("{x:g}")
        axes[-1].set_xlabel(label)
        fig.legend(*axes[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
        return fig


def glance(found: Study) -> tuple[Figure, str] | None:
    """Proved gain against the size of the box."""
    if not found.gains:
        return None
    start = {n: hinfnorm(uncertain().close(K).nominal)[0] for n, K in found.designs.items()}
    series = {
        name: np.array([(0.0, start[name]), *((p, g.upper) for p, g in gains.items() if np.isfinite(g.upper))])
        for name, gains in found.gains.items()
    }
    return curves({"": series}, "box: inertia and frequencies within, %", "o"), (
        "Gain that no point of the box exceeds, proved, against the size of the box. The optimum's line ends at "
        f"{SPREAD * found.margins[NOMINAL].upper:.2g} %, where it is unstable."
    )


def pictures(found: Study) -> list[report.Section]:
    """Gain along each parameter, and one flight with all controllers."""
    panels = {f"{UNITS[p]}: gain": series for p, series in found.along.items()}
    shown = [
        (curves(panels, "percent from nominal, the others nominal"), "Gain against one parameter; no line: unstable.")
    ]
    if found.campaigns and (NOMINAL in found.campaigns):
        k = least_quiet(found)
        runs = {name: c.kept[k] for name, c in found.campaigns.items() if k in c.kept}
        one = {p: getattr(found.campaigns[NOMINAL].dispersed, p)[k] for p in ("inertia", "frequencies")}
        series = {
            name: (
                r.time[::5],
                np.stack([2 * r.outputs[::5, 0] / DEG, r.states.modes[::5, 0], r.inputs[::5, 0]], axis=1),
            )
            for name, r in runs.items()
        }
        text = f"The flight in which the optimum swings most: inertia {one['inertia']:.4g} kg m2, "
        text += "frequencies " + " and ".join(f"{w:.4g}" for w in one["frequencies"]) + " rad/s."
        shown.append((figures.histories(series, ("roll, deg", "first mode, sqrt(kg) m", "torque, N m")), text))
    return [study.drawings("Figures", shown)]


def spelled(K: StateSpace) -> str:
    """A controller of one input and output, as a fraction."""
    a = np.poly(K.A)
    b = np.poly(K.A - K.B @ K.C) + (K.D[0, 0] - 1) * a
    parts = [" ".join(f"{c:+.5g} {f's^{len(p) - 1 - k}' if k < len(p) - 1 else ''}".strip()
                      for k, c in enumerate(p) if c) for p in (b, a)]  # fmt: skip
    return f"({parts[0]}) / ({parts[1]})"


def cards(found: Study, out: Path) -> list[report.Card]:
    """The controllers, with their files and certificates."""
    made = []
    for name, gains in found.gains.items():
        K = found.designs[name]
        stem = "-".join(word.strip(",").lower() for word in name.split())
        files, facts = [], [("order", law(K).n), ("stable to, %", f"{SPREAD * found.margins[name].lower:.4g}")]
        if isinstance(K, Design):
            card = study.card(name, K, out, stem)
            files, facts = [*card.files], [*card.facts, *facts[1:]]
        else:
            facts.append(("law, u / J", spelled(K)))
        proofs = {
            "margin": found.margins[name],
            "gain": gains.get(SPREAD),
            "damping": found.whole.get(name),
        }
        if name == NOMINAL:
            found.optimum.save(out / f"{stem}-norm.json")
            files.append((f"{stem}-norm.json", "certificate of the nominal gain, which no controller undercuts"))
        for kind, answer in proofs.items():
            if answer is not None and answer.certificate is not None:
                answer.certificate.save(out / f"{stem}-{kind}.json")
                files.append((f"{stem}-{kind}.json", f"certificate of the {kind.replace('-', ' ')}"))
        made.append(report.Card(name, facts, files))
    return made


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    fast = f"{STEADY + 10:g} s flights, 2 runs, one box"
    options = study.parse(study.parser(__doc__, out="out/flexible", fast=fast, runs=31), arguments)
    runs, duration = (min(options.runs, 2), STEADY + 10) if options.fast else (options.runs, DURATION)
    found = Study()
    study.carry_out(found, lambda: fly(found, duration, runs, options.seed), options)
    return study.conclude(
        found,
        options.out,
        title="A flexible satellite: true for the one that flies",
        subtitle="Gains and margins proved over a box of inertia and frequencies, flights over the same box",
        tables=[robustness(found), counterexample(found), flights(found)] if found.complete else [robustness(found)],
        statements=statements(found),
        findings=findings(found),
        summary=summary(found),
        abbreviations=ABBREVIATIONS,
        first=glance(found),
        sections=pictures(found) if found.along else [],
        cards=cards(found, options.out),
        settings=f"{runs} flights of {duration:g} s for each controller, seed {options.seed}",
    )


if __name__ == "__main__":
    raise SystemExit(main())
