"""Chapter 5: sensitivities against their weights, and flights with thrusters that are not those of the model."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import geo_controllers as design
import numpy as np
import scipy.linalg as sla
from geo_flights import Flight, short

from plants import Reading, Rule, Statement, Table, clopper_pearson, geo, paired, simulate_many
from plants.missions.geo import BOX, FORCE, OFFSET, SETTLE
from synth import LinearController, StateSpace, c2d, feedback, hinfnorm, series
from synth.systems.zeros import transmission_zeros

if TYPE_CHECKING:
    from geo_flights import Study

OMEGA = np.geomspace(1e-4, 3e2, 400)  # rad/min, of the figures
LONG = 18000.0  # s, of the flights with other thrusters
PAIRS = ((design.MIXED, design.THESIS_LQR), (design.MIXED_TUNED, design.LQR), (design.FOUR_BLOCK, design.LQG))
NONE = StateSpace(np.zeros((0, 0)), np.zeros((0, 3)), np.zeros((3, 0)), np.eye(3))
RATE_ERROR = 0.1  # relative, of the orbital rate: more is no small change of the plant


class Peaks(NamedTuple):
    """Norms of a loop against the thesis's weights, and its curves over `OMEGA`."""

    performance: float  # of wP S; NaN if it does not measure the position alone
    robustness: float  # of wI T at the input of the plant
    together: float  # largest sum of the two over frequency, below 1 for robust performance (5.37); NaN likewise
    S: np.ndarray  # (400,) largest singular values
    T: np.ndarray


def blocks(w: StateSpace) -> StateSpace:
    """The scalar weight on three channels."""
    return StateSpace(*(np.kron(design.I3, M) for M in (w.A, w.B, w.C, w.D)), dt=w.dt)


def largest(G: StateSpace) -> np.ndarray:
    """(400,) largest singular values over `OMEGA`."""
    return np.array([np.linalg.norm(G.frequency_response(w), 2) for w in OMEGA])


def peaks(n: float, K: StateSpace, weights: design.Weights) -> Peaks:
    """Of a controller u = K e in minutes: of the position (3 inputs) or of the state (6)."""
    G, (wP, _, wI) = design.relative_motion(n, design.MINUTE), design.thesis_weights(weights)
    plant = G if K.nu == 3 else StateSpace(G.A, G.B, design.I6, np.zeros((6, 3)))
    T = feedback(series(plant, K), NONE)
    robust, curve = hinfnorm(series(T, blocks(wI)))[0], largest(T)
    if K.nu != 3:
        return Peaks(np.nan, robust, np.nan, np.full(len(OMEGA), np.nan), curve)
    S = feedback(NONE, series(K, G))
    sums = largest(series(S, blocks(wP))) + largest(series(T, blocks(wI)))
    return Peaks(hinfnorm(series(S, blocks(wP)))[0], robust, float(sums.max()), largest(S), curve)


def measure(found: Study) -> None:
    """Every H-infinity design of chapters 5 and 6 and the regulators, against the weights of their chapter."""
    gains = {design.LQR4: 100.0, design.THESIS_LQR: 200.0}
    static = {
        name: StateSpace(
            np.zeros((0, 0)), np.zeros((0, 6)), np.zeros((3, 0)), design.thesis_regulator(found.rate, p)[0]
        )
        for name, p in gains.items()
    }
    chapters = {
        design.MIXED5: design.CHAPTER5,
        design.MIXED5_CHEAP: design.CHEAP,
        design.MIXED: design.CHAPTER6,
        design.LQR4: design.CHAPTER5,
        design.THESIS_LQR: design.CHAPTER6,
    }
    for name, weights in chapters.items():
        K = static[name] if name in static else found.designs[name].controller
        found.peaks[name] = peaks(found.rate, K, weights)


def thrusters(rng: np.random.Generator, dt: float) -> StateSpace:
    """A plant of the set G (I + wI Delta) with |Delta| = 1 at all frequencies, as what stands before G (5.24).

    Delta is U diag(a_i) V with rotations U, V and all-pass a_i = +-(1 - p z) / (z - p); wI that of section 6.2.2.
    """
    p, sign = rng.uniform(-1, 1, 3), rng.choice([-1.0, 1.0], 3)
    U, V = (np.asarray(sla.qr(rng.normal(size=(3, 3)))[0]) for _ in "UV")
    delta = StateSpace(np.diag(p), V, U @ np.diag(sign * (1 - p**2)), -U @ np.diag(sign * p) @ V, dt)
    wI = c2d(design.thesis_weights()[2], dt / design.MINUTE, "tustin")
    wI = blocks(StateSpace(wI.A, wI.B, wI.C, wI.D, dt))
    both = series(delta, wI)
    return StateSpace(both.A, both.B, both.C, both.D + design.I3, dt)


def uncertain_flights(found: Study, controllers: Mapping[str, LinearController], runs: int, seed: int) -> None:
    """From 100 m, unperturbed, each controller with the same drawn thrusters: one compiled batch."""
    flights = []
    for run in range(runs):
        for name, K in controllers.items():
            rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(run,)))
            loop = LinearController.of(series(StateSpace(K.A, K.B, K.C, K.D, K.dt), thrusters(rng, K.dt)))
            flights.append((name, geo.case(loop, OFFSET, LONG, perturbed=False, limit=FORCE)))
    for (name, (loop, _)), run in zip(flights, simulate_many([c for _, c in flights]), strict=True):
        found.uncertain.setdefault(name, []).append(Flight(run, float(loop.controller.dt)))


def uncertain_table(found: Study) -> Table:
    """Norms, and what became of the drawn plants."""
    rows = []
    for name, flights in found.uncertain.items():
        off = [f.farthest(SETTLE) for f in flights]
        fuel = [f.delta_v() for f in flights]
        robust = f"{found.peaks[name].robustness:.3f}" if name in found.peaks else "-"
        rows.append(
            (
                name,
                robust,
                f"{stable(flights)} of {len(flights)}",
                f"{within(flights)} of {len(flights)}",
                short(100 * float(np.median(off))),
                short(100 * max(off)),
                f"{np.median(fuel):.2f}",
                f"{max(fuel):.2f}",
            )
        )
    headers = (
        "controller",
        "norm of wI T",
        "come closer",
        "within 10 cm",
        "median, cm",
        "worst, cm",
        "median m/s",
        "worst m/s",
    )
    note = (
        "Thrusters that push by (I + wI Delta) times what they are told, wI of section 6.2.2 (30 % at rest, 200 % at "
        "high frequency), the norm of Delta 1 at all frequencies, drawn; the same for all. From 100 m, unperturbed, "
        "300 minutes; the largest component of the position from 100 minutes on. A norm below 1 promises stability "
        "(5.32)."
    )
    return Table("Thrusters other than the model's", headers, rows, note=note)


def stable(flights: list[Flight]) -> int:
    """How many end nearer to the ideal point than they began."""
    return sum(bool(f.run.ok) and f.last < float(np.linalg.norm(f.position[0])) for f in flights)


def within(flights: list[Flight]) -> int:
    """How many are in the box from 100 minutes on."""
    return sum(bool(f.run.ok) and f.farthest(SETTLE) <= BOX for f in flights)


def share(count: int, of: int, what: str) -> Reading:
    """With its Clopper-Pearson interval."""
    low, high = clopper_pearson(count, of)
    return Reading(what, count / of, float(low), float(high), f"{count} of {of}")


def statements(found: Study) -> list[Statement]:
    """The claims of sections 5.3 to 5.7."""

    def euler() -> tuple[StateSpace, StateSpace]:
        G, h = design.relative_motion(found.rate, design.MINUTE), 0.1
        stepped = np.linalg.inv(2 * design.I6 + h * G.A)  # Euler at 0.1 min, then back by Tustin
        A, B = 2 * stepped @ G.A, 2 * stepped @ G.B * h / h
        return G, StateSpace(A, 2 * stepped @ B, G.C, -G.C @ stepped @ G.B * h)

    def poles() -> list[Reading]:
        G = euler()[0]
        printed = np.array([0, 0, 0.0044j, 0.0044j, -0.0044j, -0.0044j])
        ours = G.poles()
        return [Reading("", float(max(np.abs(ours - p).min() for p in printed)))]

    def zeros() -> list[Reading]:
        kinds = zip(("the plant", "Euler's model through Tustin"), euler(), strict=True)
        return [Reading(name, float(len(transmission_zeros(G.A, G.B, G.C, G.D)))) for name, G in kinds]

    def rank() -> list[Reading]:
        return [Reading("", float(np.linalg.matrix_rank(euler()[0].frequency_response(1.0))))]

    def shift() -> list[Reading]:
        n = found.rate * design.MINUTE
        half = design.mixed_sensitivity(found.rate, shift=design.SHIFT / 2).info.optimum
        full = found.designs[design.MIXED].info.optimum
        return [Reading("", design.SHIFT / n, text=f"level {full:.3f} with 0.1, {half:.3f} with 0.05")]

    def below(field: str) -> Any:
        names = (design.MIXED5, design.MIXED5_CHEAP, design.MIXED)
        return lambda: [Reading(name, getattr(found.peaks[name], field)) for name in names]

    def robust() -> list[Reading]:
        return [Reading(name, p.robustness) for name, p in found.peaks.items()]

    def flown() -> list[Reading]:
        return [share(stable(f), len(f), name) for name, f in found.uncertain.items()]

    def fast() -> list[Reading]:
        names = (design.MIXED5, design.MIXED5_CHEAP)
        return [Reading(name, 100 * found.near[name].farthest(2 * SETTLE)) for name in names]

    def later() -> list[Reading]:
        names = (design.LQR4, design.MIXED5, design.MIXED5_CHEAP)
        ends = {name: found.near[name].since(2 * SETTLE).position for name in names}
        return [Reading(name, 100 * float(np.ptp(p, axis=0).max())) for name, p in ends.items()]

    box = 100 * BOX
    return [
        Statement(
            "Six poles at 0 and +-0.0044j",
            "section 5.3.3",
            poles,
            Rule("largest distance from the printed", "<=", 5e-5, "rad/min"),
        ),
        Statement(
            "Six zeros at 20",
            "section 5.3.3",
            zeros,
            Rule("finite zeros", ">=", 6),
            printed="20",
            depends="the model",
            why="2 / T: Euler's rule followed by Tustin's; a satellite has none, and no bandwidth follows",
        ),
        Statement(
            "The plant is functionally controllable: normal rank 3",
            "section 5.3.4",
            rank,
            Rule("rank", ">=", 3),
            printed="3",
        ),
        Statement(
            "The shift e = 0.1 has no significant influence on the system",
            "section 5.6",
            shift,
            Rule("shift over the orbital rate", "<=", RATE_ERROR),
            why="the slowest motion of the plant is 23 times slower; the shift is the speed asked of every mode",
        ),
        Statement(
            "S is below 1 / wP (5.6)",
            "figure 5.8",
            below("performance"),
            Rule("norm of wP S", "<=", 1),
            depends="wu",
            why="wu of chapter 5 is not printed; with that of chapter 6 it costs too much to be so fast",
        ),
        Statement(
            "T is below 1 / wI (5.9, 5.32)",
            "figure 5.9",
            below("robustness"),
            Rule("norm of wI T", "<=", 1),
            depends="wu",
        ),
        Statement(
            "Performance is robust (5.37)",
            "section 5.5.3",
            below("together"),
            Rule("largest sum of |wP S| and |wI T|", "<=", 1),
            depends="wu",
        ),
        Statement(
            "The loop is stable for all thrusters of the set (5.32)",
            "section 5.5.2",
            robust,
            Rule("norm of wI T", "<=", 1),
            depends="the controller",
            why="the regulators are, without having been told of wI",
        ),
        Statement(
            "likewise flown, each with the same drawn thrusters",
            "section 5.5.2, ours",
            flown,
            Rule("share that come closer", ">=", 0.8),
            depends="the controller",
        ),
        Statement(
            "From 1 m the errors go fast to zero, disturbances being cancelled",
            "figures 5.10, 5.11",
            fast,
            Rule("position from 200 minutes on", "<=", box, "cm"),
            depends="the weights",
        ),
        Statement(
            "After 200 minutes there is no significant difference",
            "sections 4.5, 5.7",
            later,
            Rule("change of a coordinate from 200 to 1000 minutes", "<=", box, "cm"),
            depends="the controller",
            why="the tides turn, and a loop without an integrator gives way by what its gain allows",
        ),
    ]


def more_reliable(found: Study) -> list[Reading]:
    """Norm of wI T of H-infinity over that of the regulator, of the thesis; worst position with the same thrusters."""
    readings = []
    for ours, theirs in PAIRS:
        a, b = ([f.farthest(SETTLE) for f in found.uncertain[name]] for name in (ours, theirs))
        readings.append(paired(a, b, ratio=True).reading(f"{ours} over {theirs}"))
    return readings
