"""What the paper does not say: the filters' consistency, fair opponents, what the verdicts hang on; which to take."""

from __future__ import annotations

from typing import Any

import numpy as np
from cubesat3u_claims import (
    BOUNDS,
    DIRECT,
    HINF,
    INDICES,
    MOST,
    MPC,
    PAPER_HINF,
    PD,
    SVD_HINF,
    passes,
    statements,
    worst,
)  # fmt: skip
from cubesat3u_controllers import flops
from cubesat3u_modes import told
from cubesat3u_robustness import margins_of

from plants import (
    Claim,
    Consistency,
    Reading,
    Run,
    Statement,
    Table,
    cubesat3u,
    drawn,
    left_out,
    nees,
    nis,
    paired,
    pointing_errors,
)
from plants.missions.cubesat3u import DEG
from plants.outcome.claims import judged

FILTERS = {PAPER_HINF: "paper's: window of 5, R fixed", HINF: "EKF, ours: no window, R of Wahba's solution",
           DIRECT: "EKF direct, ours: the vectors themselves"}  # fmt: skip
WHERE = {"again": "table 3", "campaigns": "table 5", "turned": "table 5, random sunlit planes"}
STATES = 9


def consistent(found: Any, name: str, of: str = "campaigns") -> dict[str, Consistency]:
    """NEES of all states and of the attitude, and NIS, of the sound runs of a configuration."""
    flown = getattr(found, of)[name]
    kept = [getattr(flown.results, part)[flown.ok] for part in ("white", "nis", "rows")]
    white, squares, rows = kept
    unit = [np.broadcast_to(np.eye(n), (*white.shape[:2], n, n)) for n in (STATES, 3)]
    return {"state": nees(white, unit[0]), "attitude": nees(white[..., :3], unit[1]), "innovations": nis(squares, rows)}


def filters(found: Any) -> Table:
    """Whether the errors of the filters are as large as they believe."""
    rows = []
    for of, where in WHERE.items():
        for name in (name for name in FILTERS if name in getattr(found, of)):
            c = consistent(found, name, of)
            ake = worst(getattr(found, of)[name].results, "ake")
            state, attitude, innovations = c["state"], c["attitude"], c["innovations"]
            rows.append([
                f"{FILTERS[name]}; {where}", f"{STATES * state.mean:.1f}", f"{3 * attitude.mean:.2f}",
                f"{innovations.mean:.3f}", f"{100 * state.inside:.0f} %", state.verdict, f"{np.median(ake):.4f}",
            ])  # fmt: skip
    headers = ("filter, with Hinf", "NEES, 9 expected", "attitude, 3 expected", "NIS, 1 expected", "inside its band",
               "verdict", "AKE, median, deg")  # fmt: skip
    note = (
        f"Normalised errors squared over all runs, every 10 s from {found.window:g} s on. Inside its band: the part of "
        "the times at which the average NEES of the runs is where that of a right filter is with 95 %. Table 3 is "
        "flown over and over with other noise, its inertia as the filters believe; in table 5 it is up to 10 % off."
    )
    return Table("Consistency of the filters", headers, rows, note=note)


def cases(statement: Statement) -> set[str]:
    """What the readings of a claim are told apart by; nothing where its runs are missing."""
    try:
        return {reading.what for reading in statement.judge()}
    except (KeyError, IndexError):
        return set()


def changed(found: Any) -> str:
    """Which verdicts are others with our filter, of the claims that are read on the same cases with both."""
    both = zip(statements(found), statements(found, "EKF"), strict=True)
    pairs = [judged(pair) for pair in both if cases(pair[0]) and cases(pair[0]) == cases(pair[1])]
    other = [f"{a.text}: {b.verdict} instead of {a.verdict}" for a, b in pairs if a.verdict != b.verdict]
    same = (
        f"{len(pairs) - len(other)} of {len(pairs)} verdicts are the same with our filter in the place of the paper's"
    )
    return same + (f"; {'; '.join(other)}." if other else ".")


def findings(found: Any) -> list[str]:
    """In sentences with figures; of what has been flown."""
    sentences = []
    if {HINF, PAPER_HINF} <= found.again.keys():
        before, after = (consistent(found, name, "again")["state"].mean * STATES for name in (PAPER_HINF, HINF))
        gain = paired(*(worst(found.campaigns[n].results, "ake") for n in (HINF, PAPER_HINF)), ratio=True)
        sentences.append(
            f"The paper's filter is too sure of itself: its NEES is {before:.1f} where 9 is expected. Without the "
            "moving average, which makes consecutive solutions depend on each other, and with the covariance of "
            f"Wahba's solution in the place of a fixed one it is {after:.1f}, and the AKE {said(gain.reading())} of "
            "what it was: the smoothing filter of figure 3 does harm."
        )
        sentences.append(changed(found))
    if {HINF, PD} <= found.campaigns.keys():
        sentences.append(fair(found))
    if {HINF, DIRECT} <= found.night.keys():
        peaks = {name: np.array([late_peak(run) for run in found.night[name].kept.values()]) for name in (HINF, DIRECT)}
        sentences.append(
            f"Into the eclipse the pointing error of {HINF}, whose filter is fed by the vector solution, reaches "
            f"{np.median(peaks[HINF]):.2f} deg in the median of the runs; with the vectors themselves ({DIRECT}) "
            f"{np.median(peaks[DIRECT]):.2f} deg, run by run "
            f"{said(paired(peaks[DIRECT], peaks[HINF], ratio=True).reading())} of it."
        )
    sentences += told(found)
    if HINF in found.nominal:
        angle = cubesat3u.environment(found.nominal[HINF].end).sun_field_angle() / DEG
        sentences.append(
            f"The angle between Sun and field, {angle.min():.0f} to {angle.max():.0f} deg during the run, sets the "
            "level of the attitude knowledge."
        )
    sentences.append(
        "Two equations of the paper are not as they should be: (3) lacks the reaction of the wheels on the body, (7) "
        "has q0 w x q for q0 w + q x w; the simulator has them right."
    )
    return sentences


def late_peak(run: Run) -> float:
    """Largest pointing error after a third of the flight, deg."""
    return float(pointing_errors(run).angle[run.time > run.duration / 3].max() / DEG)


def fair(found: Any) -> str:
    """Hinf against a PD with the same bandwidth and the same filter."""
    hinf, pd = (found.campaigns[name].results for name in (HINF, PD))
    parts = [
        f"{name} {said(paired(worst(pd, key), worst(hinf, key), ratio=True).reading())}"
        for name, key in INDICES.items()
    ]
    t = paired(pd.settling_time, hinf.settling_time)
    own, other = (margins_of(found.controllers[name]) for name in ("PD", "Hinf"))
    bears = ", ".join(f"{name} {own[name]:.3g} against {other[name]:.3g}" for name in own)
    return (
        f"A plain PD with the same bandwidth and the same filter ({PD}) has, relative to {HINF}, {', '.join(parts)}; "
        f"it settles {said(t.reading())} s later; margins: {bears}; a step costs {flops(found.controllers['PD'])} "
        f"multiplications and additions against {flops(found.controllers['Hinf'])}."
    )


def said(reading: Reading) -> str:
    """Value and interval."""
    return f"{reading.value:.3g} ({reading.low:.3g} to {reading.high:.3g})"


def summary(found: Any) -> str:
    """Which to take: of those that meet table 1 in most runs the one that holds stillest, and what speaks for it."""
    flown = {name: found.campaigns[name].results for name in (HINF, PD, *MPC, SVD_HINF) if name in found.campaigns}
    runs = min((len(i.settling_time) for i in flown.values()), default=0)  # that all of them have
    share = {name: np.all([*passes(i).values()], axis=0)[:runs].mean() for name, i in flown.items()}
    good = [name for name, met in share.items() if met >= MOST]
    if not good:
        return ""
    still = {name: float(np.median(worst(flown[name], "pse")[:runs])) for name in good}
    best = min(still, key=still.__getitem__)
    text = (
        f"Take {best}: of the {len(good)} configurations of {len(share)} that meet table 1 in at least {MOST:.0%} of "
        f"the same {runs} runs it holds stillest, {still[best]:.4f} deg in a second where {BOUNDS['PSE']:.2f} are "
        "allowed"
    )
    others = [f"{name} {value:.4f}" for name, value in still.items() if name != best]
    return f"{text} ({', '.join(others)})." if others else f"{text}."


def counterparts() -> list[Claim]:
    """Every table, figure and statement of the paper that is judged by no rule."""
    scheme, terms = "it defines, and states nothing", "Requirements"
    return [
        drawn("table 1", "Requirements on APE, control error, AKE, PSE", f"{terms}, Runs that meet each requirement"),
        left_out("table 2", "Hardware", "absent from the text that we have; sensors, wheels, dipole, box are ours, of "
                 "parts typical for the class, as are the length of the smoothing filter and the limits of the MPC"),
        drawn("table 3", "Set-up of the simulation", f"{terms}: run 0 of every configuration; epoch and node are ours"),
        drawn("table 4", "Weights of the H-infinity controller", "Controllers: H-infinity"),
        drawn("table 5", "Dispersions of the Monte Carlo", "Runs that meet each requirement; the mass moves nothing"),
        drawn("figure 1", "Three configurations", "paper EKF + MPC, SVD + Hinf, paper EKF + Hinf"),
        left_out("figure 2", "Frames of reference", scheme),
        drawn("figure 3", "Attitude determination: smoothing, SVD, EKF", "Consistency of the filters"),
        left_out("figure 4", "Framework of optimal control", scheme),
        drawn("figure 5", "Framework of tracking", "Controllers: H-infinity; a desired attitude is flown"),
        drawn("figure 6", "Simulator: state machine, forces on the orbit, Moon and Sun", "Figure 6: modes; findings"),
        *(drawn(f"figure {k}", text, "Table 3: one run") for k, text in (
            (7, "Quaternions"), (8, "Angular velocities"), (9, "Wheels"), (10, "AKE"), (11, "APE"),
            (12, "Control error"), (13, "PSE"))),
        *(drawn(f"figure {k}", text, "Table 5: Monte Carlo") for k, text in (
            (14, "Quaternions of the Monte Carlo"), (15, "Angular velocities"), (16, "Indices"))),
        drawn("equations 1 to 7", "Dynamics and kinematics", "the simulator; (3) and (7) corrected, see the findings"),
        drawn("equation 8", "States of the filter", "Consistency of the filters"),
        drawn("equations 9 to 15", "Linear model in discrete time", "Controllers: the plant of the H-infinity design"),
        left_out("equations 16 to 21", "Matrix inequalities of the synthesis, two of them equivalent", "algebra: the "
                 "corrected inequalities and their agreement are in the tests of synth; here the optimum is verified"),
        drawn("equations 22 to 27", "Generalised plant", "Controllers: H-infinity"),
        left_out("section 4", "H-infinity is easier to implement", "no quantity; the C code of the controller is on "
                 "its card, the MPC needs a solver"),
    ]  # fmt: skip


ABBREVIATIONS = {
    "APE": "absolute performance error, true attitude against the desired",
    "AKE": "absolute knowledge error, true attitude against the estimated",
    "control error": "estimated attitude against the desired",
    "PSE": "performance stability error, change of the APE within a second, the paper's own",
    "EKF": "extended Kalman filter; \"paper EKF\" as in figure 3, \"direct\" corrected by the vectors themselves",
    "Hinf": "H-infinity output feedback",
    "MPC": "model predictive control; its velocity form penalises increments of the command, the position form itself",
    "NEES, NIS": "normalised estimation error and innovation squared: as large as expected if the filter is right",
    "PD": "proportional-derivative control, with the crossover frequencies of Hinf",
    "SVD": "attitude of two vectors alone (Wahba's problem), with the raw gyro",
}  # fmt: skip
