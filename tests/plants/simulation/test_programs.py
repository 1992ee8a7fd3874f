"""Compiled programs: kept on disk, safely, and nobody else's business."""

import os
import subprocess
import sys
from collections import Counter
from dataclasses import dataclass, replace

import jax
import numpy as np
import pytest
from flown import Opaque, Pendulum, Swing, cubesat, pd, scenario

from plants.simulation import programs, simulate
from plants.simulation.simulate import Loop

COUNTED = Counter()
jax.monitoring.register_event_listener(lambda event, **_: COUNTED.update([event.split("/")[-1]]))


def fly(**changes):
    """A flight from an empty process, as far as JAX is concerned."""
    jax.clear_caches()
    COUNTED.clear()
    return simulate.simulate(Loop(plant=Pendulum(), controller=pd(5.0, 2.0)), scenario(**changes))


def configuration():
    return {name: value for name, value in jax.config.values.items() if "cache" in name or "x64" in name}


def entries(path):
    return sorted(path.glob("**/*-cache"))


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A cache of the test's own."""
    path = tmp_path / "programs"
    monkeypatch.setenv(programs.SWITCH, str(path))
    monkeypatch.setattr(programs, "_broken", [])
    return path


@pytest.fixture
def nowhere(tmp_path, monkeypatch):
    """No switch, and a home that the test can look into."""
    monkeypatch.delenv(programs.SWITCH)
    monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(programs, "_broken", [])
    return tmp_path


def test_a_program_is_fetched_and_flies_the_same(folder):
    first = fly()
    assert COUNTED["cache_misses"] == len(entries(folder)) > 0
    assert folder.stat().st_mode & 0o777 == 0o700
    again = fly()
    assert COUNTED["cache_hits"] > 0 == COUNTED["cache_misses"]
    np.testing.assert_array_equal(again.outputs, first.outputs)


def test_stepped_programs_are_kept_too(folder):
    loop = Loop(plant=Pendulum(), controller=Opaque(5.0))
    simulate.simulate(loop, scenario(steps=3))
    assert any("advance" in entry.name for entry in entries(folder))


def test_by_default_in_the_users_cache_folder(nowhere, monkeypatch):
    fly()
    assert len(entries(nowhere)) > 0
    monkeypatch.setenv("XDG_CACHE_HOME", str(nowhere / "elsewhere"))
    fly()
    assert len(entries(nowhere / "elsewhere" / "convex-synth")) > 0


def test_the_switch_turns_it_off(nowhere, monkeypatch):
    for word in ("off", "OFF"):
        monkeypatch.setenv(programs.SWITCH, word)
        assert fly().ok
    assert not list(nowhere.iterdir())


def test_no_home_no_folder_and_no_error(nowhere, monkeypatch):
    for home in ("/proc/nobody", "/dev/null"):
        monkeypatch.setenv("HOME", home)
        assert programs.folder() is None
        assert fly().ok
    assert COUNTED["cache_misses"] == 0


def test_a_folder_that_cannot_be_used_is_left_alone(folder, monkeypatch):
    folder.parent.joinpath("file").write_text("")
    monkeypatch.setenv(programs.SWITCH, str(folder.parent / "file"))
    assert programs.folder() is None
    assert fly().ok
    monkeypatch.setenv(programs.SWITCH, str(folder))
    folder.mkdir(mode=0o500)
    folder.chmod(0o500)
    if os.getuid():  # nothing is read-only for root
        assert programs.folder() is None
    folder.chmod(0o777)  # somebody else could put a program there
    assert programs.folder() is None
    assert fly().ok
    assert not entries(folder)


def test_a_full_disk_costs_the_cache_only(folder, monkeypatch):
    def full(self, value):
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as m:
        m.setattr("pathlib.Path.write_bytes", full)
        assert fly().ok
    assert fly().ok
    assert not entries(folder)  # given up in this process


@pytest.mark.parametrize("damage", [lambda b: b[: len(b) // 2], lambda b: b"", lambda b: bytes(len(b))])
def test_a_damaged_program_is_compiled_anew_and_the_next_process_is_sound(folder, monkeypatch, damage):
    first = fly()
    for entry in entries(folder):
        entry.write_bytes(damage(entry.read_bytes()))
    again = fly()
    np.testing.assert_array_equal(again.outputs, first.outputs)
    assert not entries(folder)
    monkeypatch.setattr(programs, "_broken", [])
    fly()
    fly()
    assert COUNTED["cache_hits"] > 0


def test_the_callers_configuration_is_untouched(folder):
    before = configuration()
    fly()
    assert configuration() == before
    with pytest.raises(ZeroDivisionError):
        simulate.simulate(Loop(plant=Broken(), controller=pd(5.0, 2.0)), scenario(bound=7.0))
    assert configuration() == before
    count = len(entries(folder))
    jax.clear_caches()
    jax.jit(lambda x: x @ x)(np.ones((3, 3)))  # not ours
    assert len(entries(folder)) == count


def test_a_caller_with_a_cache_keeps_it(folder, tmp_path):
    theirs = tmp_path / "theirs"
    jax.config.update("jax_compilation_cache_dir", str(theirs))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    try:
        before = configuration()
        fly()
        assert configuration() == before
    finally:
        jax.config.update("jax_compilation_cache_dir", None)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 1.0)
        programs.compilation_cache.reset_cache()
    assert len(entries(theirs)) > 0
    assert not folder.exists() or not entries(folder)


@dataclass(frozen=True)
class Broken(Pendulum):
    """A mistake that shows when the plant is traced with its actuator."""

    def derivative(self, x, u, env):
        return Swing(x.rate, 1 // 0)


def test_a_mistake_in_a_block_is_not_blamed_on_the_cache(folder):
    fly()
    kept = entries(folder)
    with pytest.raises(ZeroDivisionError):
        simulate.simulate(Loop(plant=Broken(), controller=pd(5.0, 2.0)), scenario())
    assert entries(folder) == kept
    assert not programs._broken


def test_the_oldest_programs_go_first(folder, monkeypatch):
    fly()
    (first,) = entries(folder)
    os.utime(first, (1, 1))
    monkeypatch.setattr(programs, "SIZE", 3 * first.stat().st_size // 2)
    fly(periods=50)
    assert len(entries(folder)) == 1
    assert first not in entries(folder)


def test_an_xla_without_the_option_compiles_all_the_same(monkeypatch):
    unknown = {"xla_cpu_of_another_year": False}
    monkeypatch.setattr(programs, "OPTIONS", unknown)
    programs.options.cache_clear()
    try:
        with pytest.raises(jax.errors.JaxRuntimeError, match="xla_cpu_of_another_year"):
            jax.jit(lambda: 0, compiler_options=unknown)()
        assert programs.options() is None
        program = programs.Program(lambda x: 2 * x)
        assert program(np.float32(3.0)) == 6
    finally:
        programs.options.cache_clear()


def test_this_xla_knows_the_option():
    assert programs.options() == programs.OPTIONS


@pytest.mark.parametrize("controller", [pd(5.0, 2.0), Opaque(5.0)])
def test_a_caller_is_told_when_it_compiles(controller):
    told = []
    cases = [(Loop(plant=Pendulum(), controller=controller), scenario(periods=33))]
    for expected in (True, False):
        told.clear()
        simulate.simulate_many(cases, on_compile=lambda: told.append(1), progress=False)
        assert bool(told) == expected


def test_controllers_of_one_padded_order_share_a_program():
    def padded(kp, order):
        controller = pd(kp, 1.0)
        A, B, C = np.zeros((order, order)), np.zeros((order, 2)), np.zeros((1, order))
        return replace(controller, A=A, B=B, C=C)

    scn, before = scenario(periods=11), simulate._fly._cache_size()
    wide = [simulate.simulate(Loop(plant=Pendulum(), controller=padded(kp, 5)), scn) for kp in (3.0, 4.0)]
    assert simulate._fly._cache_size() == before + 1
    own = [simulate.simulate(Loop(plant=Pendulum(), controller=pd(kp, 1.0)), scn) for kp in (3.0, 4.0)]
    for a, b in zip(wide, own, strict=True):
        np.testing.assert_allclose(a.outputs, b.outputs, rtol=0, atol=1e-13)


def test_a_gpu_flies_the_same(surroundings):
    try:
        gpu = jax.devices("cuda")[0]
    except RuntimeError:
        pytest.skip("JAX sees no CUDA device")
    loop, scn = cubesat(surroundings, periods=20)
    cases = [(loop, replace(scn, run=run)) for run in range(2)]
    flown = {}
    for device in (gpu, jax.devices("cpu")[0]):
        for compiled in (True, False):
            with jax.default_device(device):
                flown[device, compiled] = simulate.simulate_many(cases, compiled=compiled, progress=False)
    reference = flown.pop((jax.devices("cpu")[0], True))
    for runs in flown.values():
        for run, expected in zip(runs, reference, strict=True):
            np.testing.assert_allclose(run.outputs, expected.outputs, rtol=0, atol=1e-9)


SCRIPT = """
import sys; sys.path.insert(0, {tests!r})
import test_programs
run = test_programs.fly()
print(test_programs.COUNTED["cache_hits"], test_programs.COUNTED["cache_misses"], run.outputs.tobytes().hex()[-64:])
"""


@pytest.mark.slow
def test_processes_share_the_cache(folder):
    here = os.path.dirname(__file__)
    code = f"import sys; sys.path[:0] = {[here, os.path.join(here, '..', '..')]!r}" + SCRIPT.format(tests=here)
    start = [sys.executable, "-W", "error", "-c", code]
    environment = os.environ | {programs.SWITCH: str(folder)}

    def together(count):
        started = [subprocess.Popen(start, env=environment, stdout=-1, stderr=-1, text=True) for _ in range(count)]
        ended = [process.communicate() for process in started]
        assert [process.returncode for process in started] == [0] * count, ended
        return [out.split() for out, _ in ended]

    first = together(3)  # at the same time, into an empty folder
    (again,) = together(1)
    assert int(again[0]) > 0 == int(again[1])
    assert {run[2] for run in [*first, again]} == {again[2]}
