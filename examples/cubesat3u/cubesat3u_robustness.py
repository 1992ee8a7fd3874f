"""How much the loops bear: gain, phase, disk and delay margins, and moments of inertia that are far off."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from cubesat3u_controllers import FORMS, PERIOD, flops, linear_law, model

import synth
from plants import Reading, Table, clopper_pearson, cubesat3u

MARGINS = {
    "gain, dB": lambda m: min(one.gain_db for one in m.input),
    "phase, deg": lambda m: min(one.phase_deg for one in m.input),
    "disk, all axes at once": lambda m: m.disk_input.alpha,
    "delay, periods": lambda m: min(one.delay for one in m.input) / PERIOD,
}


KEYS = ("ape", "control_error", "ake", "pse")


_known: dict[int, tuple[Any, dict[str, float]]] = {}  # of controllers by identity: claims ask again and again


def margins_of(controller: Any) -> dict[str, float]:
    """Each of `MARGINS` at the plant's input: what every motor bears, the worst axis."""
    if id(controller) not in _known:
        found = synth.margins(model(), linear_law(controller), sign=1)
        _known[id(controller)] = controller, {name: float(of(found)) for name, of in MARGINS.items()}
    return _known[id(controller)][1]


def margin_ratios(controllers: Mapping[str, Any]) -> dict[tuple[str, str], Reading]:
    """Margins of Hinf over those of each MPC."""
    own, ratios = margins_of(controllers["Hinf"]), {}
    for form in FORMS:
        others = margins_of(controllers[f"MPC {form}"])
        for name, value in own.items():
            ratios[(name, f"{form} form")] = Reading("", value / others[name], text=f"{value:.3g}, {others[name]:.3g}")
    return ratios


def survivors(found: Any, name: str) -> np.ndarray:
    """Which runs with inertia that is far off meet all of table 1."""
    i, bounds = found.wide[name].results, cubesat3u.REQUIREMENTS
    return np.all([getattr(i, key).max(axis=-1) <= getattr(bounds, key) for key in KEYS], axis=0)


def only_one_points(found: Any, first: str, second: str) -> Reading:
    """Of the runs that only one of two configurations survives, the share of the first's, with its exact interval."""
    a, b = survivors(found, first), survivors(found, second)
    a, b = a[: len(b)], b[: len(a)]
    ours, differ = int((a & ~b).sum()), int((a ^ b).sum())
    text = f"{a.sum()} and {b.sum()} of {a.size}"
    if not differ:
        return Reading("", 0.5, 0.0, 1.0, text)
    low, high = clopper_pearson(ours, differ)
    return Reading("", ours / differ, float(low), float(high), text)


def work(controllers: Mapping[str, Any], form: str) -> Reading:
    """Multiplications and additions of a step of an MPC over those of Hinf."""
    ours, other = flops(controllers["Hinf"]), flops(controllers[f"MPC {form}"])
    return Reading("", other / ours, text=f"at least {other} to {ours}")


def table(found: Any) -> Table:
    """Margins, inertia and work of all controllers."""
    rows = []
    for name, controller in found.controllers.items():
        flown = found.wide.get(f"EKF + {name}")
        kept = "" if flown is None else f"{survivors(found, f'EKF + {name}').sum()}/{len(flown.index)}"
        least = "" if isinstance(controller, synth.LinearController) else "at least "
        values = margins_of(controller).values()
        rows.append([name, *(f"{value:.3g}" for value in values), kept, f"{least}{flops(controller)}"])
    note = (
        "Margins at the plant's input, of the worst axis; an MPC has the law that holds while no limit is active. Runs "
        "with every moment of inertia within 50 % of nominal, filter and controller as before. Work: multiplications "
        "and additions of a step, of an MPC without those for active limits."
    )
    return Table(
        "Robustness and work",
        ("controller", *MARGINS, "table 1 met, inertia 50 % off", "work of a step"),
        rows,
        note=note,
    )
