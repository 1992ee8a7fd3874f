"""What the thesis of the geostationary study claims, and how each claim is judged by the flights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import geo_controllers as design
import numpy as np

from plants import Statement, Verdict
from synth import AssumptionError, mixsyn

if TYPE_CHECKING:
    from geo import Study

REACH, HOLD, PERTURBED = "in the box at 100 min", "in it until 1000 min", "likewise, perturbed"  # the bounds
EIGENVALUES = (0.9156 + 0.0462j, 0.9161 + 0.0454j, 0.9159 + 0.0458j)  # section 4.4, with their conjugates
REGULATOR_TOTAL, HINF_TOTAL = 1.8748, 0.0143  # sections 6.2.1 and 6.2.2, the sum of |u| over the samples
TOTAL = 0.1 * 1000 / 60  # m/s for one km/min^2 held over one sample of 0.1 min: the unit of those sums
TOLERANCE = 0.02  # relative, on totals read as "reproduced"


def statements(found: Study) -> list[Statement]:
    """The claims of chapters 4 to 6."""
    rate = found.rate

    def eigenvalues() -> Verdict:
        ours = design.thesis_regulator(rate, 100)[1]
        off = max(np.abs(ours - e).min() for e in EIGENVALUES)
        verdict = "holds" if off < 1e-4 else "does not hold"
        return verdict, f"largest difference {off:.1e}; with B = [e2 e4 e6] that was not multiplied by T = 0.1 min"

    def solvable() -> Verdict:
        weights = design.thesis_weights()
        try:
            mixsyn(design.relative_motion(rate, design.MINUTE), *weights)
        except AssumptionError as error:
            d = found.designs[design.MIXED]
            return "does not hold", (
                f"{error.assumption} fails; with the axis shifted by {d.info.shift:g} rad/min the norm is "
                f"{d.info.shifted_norm:.4g}, of the true loop {d.gamma:.4g}"
            )
        return "holds", "designed without a shift"

    def total() -> Verdict:
        sums = found.chapter6[design.THESIS_LQR].delta_v(found.settle) / TOTAL
        verdict = "holds" if abs(sums - REGULATOR_TOTAL) < TOLERANCE * REGULATOR_TOTAL else "does not hold"
        return verdict, (
            f"{sums:.4f} ({sums / REGULATOR_TOTAL - 1:+.1%}); the unit is km/min^2 summed over samples of 0.1 min, "
            f"not N: {sums * TOTAL:.2f} m/s"
        )

    def impossible() -> Verdict:
        claimed = HINF_TOTAL * TOTAL
        bound, reach = found.bounds[HOLD].lower, found.bounds[REACH].lower
        flown = found.chapter6[design.MIXED].delta_v(found.settle)
        verdict = "does not hold" if claimed < reach else "holds"
        return verdict, (
            f"{claimed:.4f} m/s; no control whatever does it below {bound:.4f} m/s, or below {reach:.4f} m/s if it may "
            f"leave the box again; with the thesis's weights {flown:.2f} m/s"
        )

    def reaches(*names: str) -> Verdict:
        off = {name: found.chapter6[name].farthest(found.settle) for name in names}
        good = [x <= found.box for x in off.values()]
        verdict = "holds" if all(good) else "depends on the controller" if any(good) else "does not hold"
        return verdict, "; ".join(f"{name}: {100 * x:.2g} cm" for name, x in off.items())

    def much_less() -> Verdict:
        pairs = ((design.MIXED, design.THESIS_LQR), (design.MIXED_TUNED, design.LQR), (design.FOUR_BLOCK, design.LQG))
        spent = {name: found.chapter6[name].delta_v() for pair in pairs for name in pair}
        less = [spent[a] < 0.5 * spent[b] for a, b in pairs]
        verdict = "holds" if all(less) else "depends on the controllers compared" if any(less) else "does not hold"
        return verdict, "; ".join(f"{a} {spent[a]:.2f} m/s against {b} {spent[b]:.2f} m/s" for a, b in pairs)

    def thrust() -> Verdict:
        largest = {name: found.chapter6[name].largest_force for name in (design.THESIS_LQR, design.MIXED)}
        verdict = "holds" if max(largest.values()) <= 100 else "does not hold"
        return verdict, "; ".join(f"{name} {force:.3g} N" for name, force in largest.items())

    def saturated() -> Verdict:
        ends = {name: flight.last for name, flight in found.saturated.items()}
        good = [x < 100 for x in ends.values()]
        verdict = "holds" if all(good) else "depends on the controller" if any(good) else "does not hold"
        return verdict, "distance at the end: " + "; ".join(f"{name} {x:.3g} m" for name, x in ends.items())

    def noise() -> Verdict:
        spent = {name: found.per_day(name) for name in (design.MIXED, design.MIXED_TUNED, design.LQR, design.LQG)}
        verdict = "does not hold" if spent[design.MIXED_TUNED] > spent[design.LQR] else "holds"
        return verdict, "; ".join(f"{name} {x:.3g} m/s per day" for name, x in spent.items())

    def cancels() -> Verdict:
        off = found.perturbed[design.MIXED].farthest(found.settle)
        return "holds" if off <= 1.0 else "does not hold", f"at most {100 * off:.2g} cm from 100 minutes on"

    return [
        Statement("The eigenvalues of the regulator", "section 4.4", eigenvalues),
        Statement("The mixed-sensitivity problem can be solved as posed", "sections 5.4, 6.2.2", solvable),
        Statement("The regulator's total is 1.8748", "section 6.2.1", total),
        Statement("The total of H-infinity is 0.0143", "section 6.2.2", impossible),
        Statement("Both are within 10 cm after 100 minutes", "figures 6.1, 6.3",
                  lambda: reaches(design.THESIS_LQR, design.MIXED)),
        Statement("The forces stay below 100 N without a limit", "figures 6.2, 6.4", thrust),
        Statement("H-infinity uses much less than the regulator", "section 6.3", much_less),
        Statement("Saturated at 1 N from 1 km both are stable", "figures 6.5 to 6.8", saturated),
        Statement("Under noise H-infinity is more reliable, with low fuel", "section 6.3", noise),
        Statement("H-infinity cancels Sun, Moon and Earth", "section 5.7", cancels),
    ]  # fmt: skip
