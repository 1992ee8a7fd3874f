"""A spacecraft, what is required of it and how it is flown, as a TOML file: the words of `spacecraft` with units.

    name = "A 6U CubeSat"
    inertia = [0.12, 0.11, 0.05]          # kg m^2
    epoch = 2026-03-20T00:00:00           # UTC
    dt = 1.0                              # s, control period

    [requirements]
    pointing_deg = 0.1
    bandwidth = 0.1                       # rad/s

    [flight]
    duration = 1500                       # s

    [orbit]
    kind = "circular"
    altitude_km = 500
    inclination_deg = 97.4

    [[wheels]]
    axis = [1, 0, 0]
    max_torque_mNm = 3
    max_momentum_mNms = 15
    max_speed_rpm = 6000

    [[sensors]]
    kind = "star tracker"
    cross_noise_arcsec = 20

Further tables: [dispersion], [navigation], [[disturbances]], [[magnetorquers]] and [dumping], [[thrusters]] with
[propulsion], [[cmgs]] with [steering], [[appendages]] that bend, [atmosphere], [[forces]]; `plants.craft.kinds` says
what each may hold. Every device is a table. A number without a unit behind its name is in SI and radians. A sensor with
`calibrate` is calibrated by the filter, from a misalignment or bias of that deviation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from plants.checks import positive
from plants.craft import kinds
from plants.craft.comparison import Comparison, Dispersion, compare_flights
from plants.craft.kinds import APPENDAGES, ATMOSPHERES, CALIBRATED, DISTURBANCES, FORCES, ORBITS, SENSORS
from plants.craft.spacecraft import Spacecraft
from plants.craft.tables import REFUSED, Kind, Tables, keys_of, read_toml
from plants.errors import ScenarioError
from plants.guidance.laws import Dumping

BODY = [key for key in keys_of(kinds.BODY) if key != "parts"]
LISTS = ("wheels", "sensors", "disturbances", "magnetorquers", "thrusters", "cmgs", "appendages", "forces")
TABLES = (
    "requirements", "flight", "orbit", "dispersion", "navigation", "dumping", "propulsion", "steering", "atmosphere",
)  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class DataSheet:
    """What a file says; build it with `read_spacecraft`."""

    craft: Spacecraft
    wanted: Mapping[str, Any]  # pointing () rad, bandwidth () rad/s, integral: arguments of `Spacecraft.weights`
    duration: float  # () s, of a flight
    after: float | None = None  # () s, from when errors count
    spread: Dispersion = Dispersion()  # noqa: RUF009 (immutable)
    dumping: Dumping | None = None
    surroundings: Mapping[str, Any] = field(default_factory=dict)  # options of `Spacecraft.environment`

    def weights(self) -> dict[str, Any]:
        """First weights of a four-block problem, by `Spacecraft.weights`, which may refuse with a ScenarioError."""
        return self.craft.weights(**self.wanted)

    def compare(self, controllers: Mapping[str, Any], *, duration: float | None = None, **options: Any) -> Comparison:
        """`compare_flights` of these controllers as the file says; with options of it, such as `runs`, `seed`, `out`.

        Raises
        ------
        ScenarioError
            What `compare_flights` refuses.
        """
        span = float(positive("duration", self.duration if duration is None else duration))
        try:
            around = self.craft.environment(span, **self.surroundings)
        except ScenarioError as error:
            if not str(error).startswith("atmosphere"):
                raise
            raise ScenarioError(
                f'{error}. In a file: [atmosphere] with kind = "none", or "layered" and highest = inf'
            ) from error
        return compare_flights(
            self.craft, controllers, duration=span, pointing=self.wanted["pointing"], spread=self.spread,
            after=self.after if span == self.duration else None, dumping=self.dumping,
            environment=around, **options,
        )  # fmt: skip


def read_spacecraft(path: Path | str) -> DataSheet:
    """The spacecraft of a TOML file, what is required of it, and its flights.

    Raises
    ------
    ScenarioError
        The file is missing, larger than 64 KiB, no TOML, or says what cannot be: all mistakes, each with its path,
        value and remedy.
    """
    file = Path(path)
    tables = Tables(read_toml(file))
    tables.check_keys([*BODY, *TABLES, *LISTS])
    data = tables.data
    body = {key: data[key] for key in BODY if key in data}
    parts, surroundings = _parts(tables), _surroundings(tables)
    wanted = tables.made(data.get("requirements", {}), "requirements", kinds.REQUIREMENTS)
    flight = tables.made(data.get("flight", {}), "flight", kinds.FLIGHT)
    spread = tables.made(data.get("dispersion", {}), "dispersion", kinds.DISPERSION)
    dumping = tables.made(data["dumping"], "dumping", kinds.DUMPING) if "dumping" in data else None
    craft = tables.made(body, "", kinds.BODY, parts=None if tables.problems else parts)
    if dumping is not None and not tables.problems:
        tables.made({}, "dumping", Kind(lambda: craft.loop(_Rest(craft.dt), dumping=dumping)))
    if tables.problems:
        raise ScenarioError(tables.told(file))
    return DataSheet(craft=craft, wanted=wanted, **flight, spread=spread, dumping=dumping, surroundings=surroundings)


@dataclass(frozen=True)
class _Rest:
    """A controller that commands nothing, with which a loop is tried."""

    dt: float

    def init(self) -> tuple[()]:
        return ()

    def step(self, s: tuple[()], y: Any, r: Any) -> tuple[tuple[()], np.ndarray]:
        del y, r
        return s, np.zeros(3)


def _parts(tables: Tables) -> dict[str, Any]:
    """Arguments of `spacecraft` that have tables of their own."""
    data, parts = tables.data, dict[str, Any]()
    if "orbit" in data:
        parts["orbit"] = tables.chosen(data["orbit"], "orbit", ORBITS)
    else:
        tables.problems.append('orbit: missing; add a table [orbit] with kind = "circular"')
    parts["wheels"] = [
        tables.made(row, f"wheels[{i}]", kinds.WHEEL) for i, row in enumerate(tables.rows("wheels", "wheel"))
    ]
    parts["disturbances"] = [
        tables.chosen(row, f"disturbances[{i}]", DISTURBANCES)
        for i, row in enumerate(tables.rows("disturbances", "disturbance"))
    ]
    if "appendages" in data:
        rows = enumerate(tables.rows("appendages", "appendage"))
        parts["appendages"] = tuple(tables.chosen(row, f"appendages[{i}]", APPENDAGES) for i, row in rows)
    parts["sensors"], calibrate = _sensors(tables)
    if "navigation" in data or calibrate:
        made = tables.made(data.get("navigation", {}), "navigation", kinds.NAVIGATION)
        parts["navigation"] = made if made is REFUSED or not calibrate else made | {"calibrate": calibrate}
    torquers = _columns(tables, "magnetorquers", "magnetorquer", kinds.MAGNETORQUER)
    if torquers:
        parts["magnetorquers"] = tables.made({}, "magnetorquers", Kind(lambda: kinds.magnetorquers(torquers)))
    _shared(tables, parts, "thrusters", "thruster", kinds.THRUSTER, "propulsion", kinds.thrusters)
    _shared(tables, parts, "cmgs", "gyroscope", kinds.GYROSCOPE, "steering", kinds.gyroscopes)
    return parts


def _columns(tables: Tables, name: str, owner: str, kind: Kind) -> dict[str, np.ndarray] | None:
    """The numbers of all devices of a list as columns, (..., n); None if there are none or one is wrong."""
    rows = [tables.made(row, f"{name}[{i}]", kind) for i, row in enumerate(tables.rows(name, owner))]
    return None if not rows or REFUSED in rows else {key: np.array([row[key] for row in rows]).T for key in rows[0]}


def _shared(
    tables: Tables, parts: dict[str, Any], name: str, owner: str, kind: Kind, below: str, finish: Callable[..., Any]
) -> None:
    """Devices of a list with a table that they share."""
    if name not in tables.data and below not in tables.data:
        return
    columns = _columns(tables, name, owner, kind)
    if below not in tables.data:
        tables.problems.append(f"{below}: missing; add a table [{below}] for the {name}")
    elif name not in tables.data:
        tables.problems.append(f"{name}: missing; add a table [[{name}]] for each {owner}, or leave out [{below}]")
    else:
        table = tables.data[below]
        several = below == "propulsion"
        common = tables.chosen(table, below, kinds.MODULATORS) if several else tables.made(table, below, kinds.STEERING)
        if columns and common is not REFUSED:
            parts[name] = tables.made({}, name, Kind(lambda: finish(columns, common)))


def _sensors(tables: Tables) -> tuple[list[Any], dict[int, float]]:
    """The instruments, and which of them the filter is to calibrate, from which deviation."""
    made, calibrate = [], dict[int, float]()
    for i, row in enumerate(tables.rows("sensors", "sensor")):
        kind, path = row.get("kind"), f"sensors[{i}]"
        units = CALIBRATED.get(kind) if isinstance(kind, str) else None
        own = {key: value for key, value in row.items() if units is not None and key.startswith("calibrate")}
        if own:
            about = {"calibrate": units or {}}
            found = tables.made(own, path, Kind(lambda calibrate: float(positive("calibrate", calibrate)), about))
            calibrate[i] = found
        made.append(tables.chosen({k: v for k, v in row.items() if k not in own}, path, SENSORS))
    return made, calibrate


def _surroundings(tables: Tables) -> dict[str, Any]:
    """Options of `Spacecraft.environment`."""
    found: dict[str, Any] = {}
    if "atmosphere" in tables.data:
        found["atmosphere"] = tables.chosen(tables.data["atmosphere"], "atmosphere", ATMOSPHERES)
    if "forces" in tables.data:
        rows = enumerate(tables.rows("forces", "force"))
        found["forces"] = tuple(tables.chosen(row, f"forces[{i}]", FORCES) for i, row in rows)
    return found
