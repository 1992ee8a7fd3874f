"""Riccati laws as C: within the stated bound of Python everywhere, faults held, tampering seen, own models refused."""

import ctypes
import re
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pytest
from exported import STRICT, gcc
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

import synth
from synth.delivery import agreement, csdre
from synth.delivery.formats import export
from synth.errors import ExportError, ModelError

AMAZONIA = np.array([[310, 1.11, 1.01], [1.11, 360, -0.35], [1.01, -0.35, 530.7]]) - 0.01911 * np.eye(3)  # kg m^2
BEARING = {"Q": np.diag([1.0, 1, 1, 100, 100, 100]), "R": 0.001 * np.eye(3)}  # the air bearing's, with its inertia
DISK, TARGET = np.diag([1.17, 1.17, 1.13]), np.deg2rad([50, 20, -30])
LAWS = {
    "amazonia mrp": lambda: synth.Sdre.create(synth.MrpModel.create(AMAZONIA), 0.5),
    "amazonia quaternion": lambda: synth.Sdre.create(synth.QuaternionModel.create(AMAZONIA), 0.5),
    "air bearing": lambda: synth.SdreSampled.create(synth.EulerModel.create(DISK, TARGET), 0.1, **BEARING),
    "robust": lambda: synth.SdreHinfStatic.create(synth.QuaternionModel.create(AMAZONIA), 0.5),
}
UNSHRUNK = (Phase.explicit, Phase.generate)  # an example takes seconds


class Law:
    """The exported C, stepped through ctypes."""

    def __init__(self, controller: Any, folder: Path, name: str = "law", *flags: str, **options: Any):
        self.header, self.source = export(controller, "c", folder, name=name, force=True, **options)
        self.name, self.controller = name, controller
        self.compile(*flags)

    def compile(self, *flags: str) -> None:
        library = self.source.with_suffix(".so")
        gcc(*STRICT, *flags, f"-D{self.name.upper()}_SELF_TEST", "-fPIC", "-shared", "-o", library, self.source, "-lm")
        self.library = ctypes.CDLL(str(library))

    @property
    def bound(self) -> float:
        """What the header states."""
        found = re.search(r"#define \w+_AGREEMENT +(\S+)", self.header.read_text())
        assert found is not None
        return float(found[1])

    def self_test(self) -> int:
        return getattr(self.library, f"{self.name}_self_test")()

    def replay(self, samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Commands (samples, 3), faults and failures so far, after a reset."""
        solutions = [("X", float, 36), ("before", float, 36)] * isinstance(self.controller, synth.Sdre)
        state = np.zeros(1, [("gain", float, 18), *solutions, ("u", float, 3), ("failures", np.uint64)])
        u, rows = np.zeros(3), []
        at = [a.ctypes.data_as(ctypes.c_void_p) for a in (state, u)]
        getattr(self.library, f"{self.name}_reset")(at[0])
        step = getattr(self.library, f"{self.name}_step")
        for y in np.ascontiguousarray(samples, float):
            fault = step(at[0], y.ctypes.data_as(ctypes.c_void_p), at[1])
            rows.append((u.copy(), fault, int(state["failures"][0])))
        return tuple(map(np.array, zip(*rows, strict=True)))  # pyright: ignore[reportReturnType]


def anywhere(model: Any, count: int, rng: np.random.Generator, rate: float, momentum: float) -> np.ndarray:
    """Measurements at attitudes all round."""
    if isinstance(model, synth.EulerModel):
        attitude = rng.uniform([-np.pi, -1.5, -np.pi], [np.pi, 1.5, np.pi], (count, 3))
    else:
        attitude = rng.normal(size=(count, 4))
        attitude /= np.linalg.norm(attitude, axis=1)[:, None]
    return np.hstack([attitude, rate * rng.uniform(-1, 1, (count, 3)), momentum * rng.uniform(-1, 1, (count, 3))])


def compare(law: Law, y: np.ndarray) -> float:
    """Python and C over samples: the same failures; the largest difference relative to the stated bound."""
    flight = agreement.flown(law.controller, y)
    u, faults, failures = law.replay(y)
    assert not faults.any()
    assert failures.tolist() == flight.failures.tolist()
    return float((np.linalg.norm(u - flight.u, axis=1) / (law.bound * flight.scale)).max())


@pytest.fixture(scope="module", params=LAWS)
def law(request, tmp_path_factory) -> Law:
    return Law(LAWS[request.param](), tmp_path_factory.mktemp("law"))


def test_thousand_samples_anywhere_are_within_the_stated_bound(law):
    """Attitudes all round, at the rates and momenta that the header names; the self test agrees."""
    assert law.self_test() == 0
    told = re.sub(r"[\s*]+", " ", law.header.read_text())
    found = re.search(r"rates to (\S+) rad/s and momenta to (\S+) N m s", told)
    assert found is not None
    y = anywhere(law.controller.model, 1000, np.random.default_rng(3), float(found[1]), float(found[2]))
    assert compare(law, y) < 1
    assert law.bound < 1e-8


def test_the_python_that_is_compared_is_the_law_itself(law):
    """`flown` steps the controller as a simulator does; other orders are the same law."""
    y = anywhere(law.controller.model, 5, np.random.default_rng(0), 0.01, 0.1)
    with jax.enable_x64(True):
        state, commands = law.controller.init(), []
        for now in y:
            state, u = law.controller.step(state, jax.numpy.asarray(now), 0 * now)
            commands.append(np.asarray(u))
    P, S = np.eye(6)[[3, 0, 5, 1, 2, 4]] * [1, -1, 1, 1, -1, 1], -np.eye(3)[[2, 0, 1]]
    for order in ((), (P, S)):
        flight = agreement.flown(law.controller, y, *order)
        assert (np.linalg.norm(flight.u - commands, axis=1) <= law.bound * flight.scale).all()


def test_the_header_says_what_one_has_to_know(law):
    told = re.sub(r"[\s*]+", " ", law.header.read_text())
    for part in (
        synth.synthesis.convention.REGULATED, "sample k is read at k times", "[N m]", "[rad/s]", "limits none",
        "the last gain that had a solution is flown and state->failures counts", "measured, not proved",
        "2 x 1e-11, the relative error at which either accepts", "no -ffast-math", type(law.controller).__name__,
    ):  # fmt: skip
        assert part in told
    assert max(map(len, law.header.read_text().split("\n"))) <= 140


def test_what_is_not_finite_holds_the_last_command(law):
    """NaN, infinity, overflow: a fault, u again, gains and solutions stay; then it goes on as if nothing had been."""
    rng = np.random.default_rng(1)
    clean = anywhere(law.controller.model, 6, rng, 0.01, 0.1)
    expected, _, _ = law.replay(clean)
    spoiled = np.insert(clean, [0, 3, 3, 5], clean[0], axis=0)
    spoiled[[0, 4, 5, 8], [0, 4, 8, 5]] = [np.nan, np.inf, -np.inf, 1e308]
    u, faults, failures = law.replay(spoiled)
    assert faults[[0, 4, 5]].tolist() == [1, 1, 1]
    assert failures[-1] == 4
    np.testing.assert_array_equal(u[[0, 4, 5]], [np.zeros(3), u[3], u[3]])
    kept = np.delete(u, [0, 4, 5, 8], axis=0)
    scale = agreement.flown(law.controller, clean).scale
    assert (np.linalg.norm(kept - expected, axis=1) <= law.bound * scale).all()


def test_the_self_test_notices_every_tampered_constant(law, tmp_path):
    """The last digit of the last entry of each table, and of a recorded command beyond the bound."""
    text = law.source.read_text()
    tables = re.findall(r"static const double (\w+)(?:\[\d+\])? = ", text)
    assert {"inertia", "inverse", "weight_Q", "rest_gain"} <= set(tables)
    numbers = {"trace_u": "1e9", "umin": "-9e9", "umax": "9e9"}
    changed = tmp_path / law.source.name
    shutil.copy(law.header, tmp_path)
    for table in set(tables) - {"b", "trace_y", "strange"}:
        start = text.index(f"static const double {table}")
        last = list(re.finditer(r"-?(?:INFINITY|\d[\d.e+-]*)", text[start : text.index(";", start)]))[-1]
        was = float(last[0].replace("INFINITY", "inf"))
        value = numbers.get(table, repr(float(np.nextafter(was, 9.0))))
        changed.write_text(text[: start + last.start()] + value + text[start + last.end() :])
        gcc("-std=c99", "-O0", "-DLAW_SELF_TEST", "-fPIC", "-shared", "-o", tmp_path / f"{table}.so", changed, "-lm")
        assert ctypes.CDLL(str(tmp_path / f"{table}.so")).law_self_test() > 0, table


def test_nothing_is_shadowed_allocated_or_deep(law, tmp_path):
    """Warnings that flight code asks for, no call of the library beyond a few, the stack that the header names."""
    strict = ("-Wshadow", "-Wstrict-prototypes", "-Wmissing-prototypes", "-Wcast-qual", "-Wvla", "-fstack-usage")
    gcc(*STRICT, *strict, "-O0", "-DLAW_SELF_TEST", "-c", law.source, "-o", tmp_path / "law.o")
    deep = sum(int(line.split("\t")[1]) for line in (tmp_path / "law.su").read_text().splitlines())
    told = re.search(r"at most (\d+) kB of stack", re.sub(r"[\s*]+", " ", law.header.read_text()))
    assert told is not None
    assert deep < 1024 * int(told[1])
    if shutil.which("nm"):
        found = subprocess.run(["nm", "-u", tmp_path / "law.o"], capture_output=True, text=True, check=True).stdout
        assert set(re.findall(r"U (\w+)", found)) <= {"sqrt", "sin", "cos", "memcpy", "memcmp", "__stack_chk_fail"}


def test_sanitizers_find_nothing(law, tmp_path):
    """The self test again, with every access and overflow looked at."""
    main = tmp_path / "main.c"
    main.write_text(f'#include "{law.header}"\nint main(void) {{ return law_self_test(); }}\n')
    flags = ("-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", "-DLAW_SELF_TEST")
    gcc(*STRICT, *flags, "-o", tmp_path / "main", main, law.source, "-lm")
    assert subprocess.run([tmp_path / "main"], capture_output=True).returncode == 0


def test_limits_are_kept_and_fast_math_is_refused(tmp_path):
    controller = LAWS["amazonia mrp"]()
    limited = Law(controller, tmp_path, "limited", umin=-0.075, umax=[0.05, 0.075, np.inf])
    assert limited.self_test() == 0
    y = anywhere(controller.model, 50, np.random.default_rng(2), 0.05, 5)
    free = agreement.flown(controller, y)
    u, _, _ = limited.replay(y)
    off = np.linalg.norm(u - free.u.clip(-0.075, [0.05, 0.075, np.inf]), axis=1)
    assert (off <= limited.bound * free.scale).all()
    assert (u[:, 0] == 0.05).any()
    assert "umax [0.05, 0.075, inf] N m" in re.sub(r"[\s*]+", " ", limited.header.read_text())
    with pytest.raises(AssertionError, match="compile without -ffast-math"):
        gcc("-std=c99", "-ffast-math", "-c", limited.source, "-o", tmp_path / "fast.o")
    with pytest.raises(ModelError, match="umin"):
        export(controller, "c", tmp_path, name="other", umin=1, umax=-1)
    assert not (tmp_path / "other.c").exists()


def units(draw: Any) -> Any:
    """A law of any kind, inertia, weights and period, in units of any size."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    size, time = 10.0 ** draw(st.integers(-5, 5)), 10.0 ** draw(st.integers(-3, 3))
    moments = rng.uniform(1, 1.9, 3) * size
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    J = turn * moments @ turn.T
    J = (J + J.T) / 2
    Q = np.diag(10 ** rng.uniform(-1, 1, 6)) * np.repeat([1.0, time**2], 3)
    R = np.diag(10 ** rng.uniform(-1, 1, 3)) * time**4 / size**2
    model = draw(st.sampled_from([synth.MrpModel, synth.QuaternionModel, synth.EulerModel])).create(J)
    kind = draw(st.sampled_from([synth.Sdre, synth.SdreSampled, synth.SdreHinfStatic]))
    return kind.create(model, float(rng.uniform(0.02, 0.5) * time), Q=Q, R=R), size / time, 1 / time


def any_law(data: Any, folder: Path) -> None:
    controller, momentum, rate = units(data.draw)
    name = f"law{len(list(folder.iterdir()))}"
    law = Law(controller, folder, name, "-O1")
    assert law.self_test() == 0
    rng = np.random.default_rng(0)
    assert compare(law, anywhere(controller.model, 100, rng, 0.3 * rate, 0.3 * momentum)) < 1


@settings(max_examples=4, deadline=None, phases=UNSHRUNK, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_any_inertia_in_any_unit(data, tmp_path_factory):
    any_law(data, tmp_path_factory.mktemp("any"))


@pytest.mark.slow
@settings(max_examples=40, deadline=None, phases=UNSHRUNK, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_many_inertias_in_any_unit(data, tmp_path_factory):
    any_law(data, tmp_path_factory.mktemp("any"))


@dataclass(frozen=True, kw_only=True)
class Own(synth.MrpModel):
    """A factorisation that somebody wrote on top of one that leaves."""


def test_what_cannot_leave_is_named_with_the_remedy(tmp_path):
    controller = LAWS["amazonia mrp"]()
    own = replace(controller, model=Own(inertia=AMAZONIA, inverse=np.linalg.inv(AMAZONIA)))
    with pytest.raises(ExportError, match=r"model is a Own, a factorisation of your own.*Use MrpModel, Quaternion"):
        export(own, "c", tmp_path)
    for option in ({"dtype": "float"}, {"antiwindup": np.eye(3)}, {"inputs": 1.0}, {"allow_unstable": True}):
        with pytest.raises(ExportError, match=f"{next(iter(option))}: belongs to linear controllers"):
            export(controller, "c", tmp_path, **option)
    assert not list(tmp_path.iterdir())
    header, source = export(controller, "c", tmp_path, self_test=False)
    assert "self_test" not in header.read_text()
    assert "trace" not in source.read_text()


def test_laws_without_solutions_to_compare_do_not_leave(monkeypatch, tmp_path):
    """Where most samples have no solution, or commands are made of rounding."""
    controller = LAWS["amazonia mrp"]()
    monkeypatch.setattr(agreement, "FEWEST", agreement.SAMPLES + 1)
    with pytest.raises(ExportError, match=r"has a solution at 96 of 96 samples.* and none at 1e\+100 times that"):
        export(controller, "c", tmp_path)
    monkeypatch.setattr(agreement, "FEWEST", 16)
    monkeypatch.setattr(agreement, "WORST", 1e-12)
    with pytest.raises(ExportError, match="they are made of rounding"):
        export(controller, "c", tmp_path)
    assert not list(tmp_path.iterdir())


def test_every_part_is_of_a_law_or_a_model():
    """No file in the folder that nothing uses."""
    used = {part for kind in csdre.LAWS.values() for part in kind.parts}
    used |= {part for model in csdre.MODELS.values() for part in model.kind.parts} | {"matrices", "body", "step"}
    assert used == {file.stem for file in Path(csdre.__file__).with_name("sdre").iterdir()}


def studies() -> dict[str, Any]:
    """Loop and scenario of a flight of each study, with the law of the study."""
    import airbearing_flights
    import amazonia1_flights

    from plants import airbearing, amazonia1

    laws = amazonia1_flights.controllers(0.5)
    found = {}
    for name in (amazonia1_flights.SDRE, amazonia1_flights.MRP, amazonia1_flights.STATIC):
        start = jax.tree.map(lambda part: part[1], amazonia1.monte_carlo(2, 0))
        shared = amazonia1_flights.Shared(laws[name], 900.0)
        loop, scenario = amazonia1_flights.case(start, shared)
        found[f"amazonia {name}"] = laws[name], loop, replace(scenario, keep_every=1)
    for noise in (0.0, 1.0):
        shared = airbearing_flights.configurations(120.0)[airbearing_flights.SDRE]
        loop, scenario = airbearing_flights.case(airbearing.case(noise=noise), shared)
        found[f"air bearing, noise {noise}"] = loop.controller, loop, scenario
    return found


@pytest.mark.slow
def test_flights_of_the_studies_are_replayed_within_the_bound(tmp_path):
    """Amazonia-1 and the air bearing: what the compiled loop commanded, against C on what the controller saw."""
    from plants import simulate

    flights = studies()
    for k, (name, (controller, loop, scenario)) in enumerate(flights.items()):
        run = simulate(loop, scenario)
        law = Law(controller, tmp_path, f"study{k}")
        assert len(run.estimates) >= 1000, name
        u, faults, failures = law.replay(run.estimates)
        scale = agreement.flown(controller, run.estimates).scale
        assert not faults.any()
        assert failures[-1] == run.memory.failures
        assert (np.linalg.norm(u - run.commands, axis=1) <= law.bound * scale).all(), name
