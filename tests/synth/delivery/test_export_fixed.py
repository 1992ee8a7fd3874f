"""Fixed point: the compiled C is its Python twin bit for bit, cannot overflow, and is as near as it says."""

import ctypes
import re

import numpy as np
import pytest
from exported import STRICT, gcc
from literature import cubesat_pecorilla2024
from replayed import NEAR, random_controller, trying

import synth
from synth.errors import ExportError, ModelError
from synth.regulators.fixed import FORMATS, FixedController


def load(source):
    library = source.with_suffix(".so")
    sanitised = ("-fsanitize=undefined", "-fno-sanitize-recover", "-static-libubsan")
    gcc(*STRICT, *sanitised, f"-D{source.stem.upper()}_SELF_TEST", "-fPIC", "-shared", "-o", library, source)
    return ctypes.CDLL(str(library))


def replay(library, name, controller, whole):
    """Commands (samples, m) and faults (samples,) of the compiled C."""
    n, p, m = len(controller.states), len(controller.read), len(controller.commands)
    state, y, u = (ctypes.c_int32 * (n + m))(*[7] * (n + m)), (ctypes.c_int32 * p)(), (ctypes.c_int32 * m)()
    getattr(library, f"{name}_reset")(state)
    commands, faults = [], []
    for sample in whole:
        y[:] = sample.tolist()
        faults.append(getattr(library, f"{name}_step")(state, y, u))
        commands.append(list(u))
    return np.array(commands), np.array(faults)


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("seed", [None, 3, 11])
def test_compiled_c_is_the_twin_bit_for_bit(format, seed, tmp_path):
    """Also with inputs far beyond their bounds, with undefined behaviour trapped by the compiler."""
    source = synth.hinfsyn(cubesat_pecorilla2024()) if seed is None else random_controller(seed)
    K = source.controller if isinstance(source, synth.Design) else source
    Y = np.array([0.5] * 3 + [0.05] * 3) if seed is None else np.full(K.nu, 3.0)
    size = synth.rounding(source, inputs=Y, precision=format).commands * 0.7
    twin = FixedController.of(source, format, Y, umin=-size, umax=size)
    _, file = synth.export(source, "c", tmp_path, name=format, dtype=format, inputs=Y, umin=-size, umax=size)
    library = load(file)
    assert getattr(library, f"{format}_self_test")() == 0
    rng = np.random.default_rng(0)
    whole = twin.words(trying(K, Y, rng, 300)[:3000])
    whole[::7] = np.array([-(2**31) + 1, 2**31 - 1])[rng.integers(0, 2, whole[::7].shape)]
    x, expected, held = twin.init().x, [], []
    for sample in whole:
        (x, u), fault = twin.advance(x, sample)
        expected.append(u)
        held.append(fault)
    commands, faults = replay(library, format, twin, whole)
    assert (commands == np.array(expected)).all()
    assert (faults == held).all()
    assert faults[::7].all()
    assert not np.delete(faults, slice(None, None, 7)).any()


@pytest.mark.parametrize("format", FORMATS)
@pytest.mark.parametrize("seed", [0, 1, 2, 5])
def test_bound_in_fixed_point(format, seed):
    K = random_controller(seed)
    Y = 10 ** np.random.default_rng(seed).uniform(-3, 3, K.nu)
    twin, found = FixedController.of(K, format, Y), synth.rounding(K, inputs=Y, precision=format)
    length = 5000
    inputs = trying(K, Y, np.random.default_rng(0), length)
    inputs = inputs[: len(inputs) // length * length].reshape(-1, length, K.nu)  # side by side, each from rest
    n, steps = K.n, 2 ** twin.shifts[:, None]
    X, x = np.zeros((n, len(inputs)), np.int64), np.zeros((n, len(inputs)))
    off, largest = np.zeros(K.ny), 0
    for y in inputs.transpose(1, 2, 0):
        whole = np.floor(y * 2.0 ** twin.read[:, None] + 0.5).astype(np.int64)
        sums = (twin.rows @ np.vstack([X, whole]) + steps // 2) // steps
        X, u = sums[:n], sums[n:] / 2.0 ** twin.commands[:, None]
        off = np.maximum(off, np.abs(u - (K.C @ x + K.D @ y)).max(axis=1))
        x, largest = K.A @ x + K.B @ y, max(largest, np.abs(X).max(initial=0))
    assert (off <= found.command).all()
    assert (found.command <= NEAR * off).all()
    assert 0.25 * 2 ** FORMATS[format] <= largest < 2 ** FORMATS[format]


def test_headers_say_scales_bound_and_where_it_holds(tmp_path):
    K = random_controller(3)
    header, _ = synth.export(K, "c", tmp_path, dtype="q15", inputs=2.0)
    text = " ".join(header.read_text().replace("*", " ").split())
    assert str(synth.rounding(K, inputs=2.0, precision="q15")) in text
    twin = FixedController.of(K, "q15", np.full(K.nu, 2.0))
    assert f"times 2^{twin.read[0]}, in [{-twin.most[0]}, {twin.most[0]}]" in text
    limited, _ = synth.export(K, "c", tmp_path, name="limited", dtype="q15", inputs=2.0, umin=-0.25, umax=0.5)
    facts = [re.search(r"limits +(.*)", file.read_text())[1] for file in (header, limited)]
    assert "min(max(v" not in facts[0]
    assert "min(max(v" in facts[1]


def test_what_fixed_point_does_not_do_is_refused(tmp_path):
    integrator = synth.StateSpace([[1.0]], [[0.1]], [[1.0]], [[2.0]], 0.1)
    with pytest.raises(ExportError, match="not proved stable"):
        synth.export(integrator, "c", tmp_path, dtype="q31", inputs=1.0)
    K = random_controller(3)
    for wrong in ({}, {"inputs": 1.0, "antiwindup": np.zeros((K.n, K.ny)), "umin": -1, "umax": 1}):
        with pytest.raises(ExportError, match="needs inputs"):
            synth.export(K, "c", tmp_path, dtype="q15", **wrong)
    with pytest.raises(ExportError, match="needs inputs"):
        synth.export(K, "fmu2", tmp_path, dtype="q15", inputs=1.0)
    with pytest.raises(ModelError, match="inputs is"):
        synth.export(K, "c", tmp_path, dtype="q15", inputs=-1.0)


@pytest.mark.parametrize("dtype", ["double", "float", "q15", "q31"])
def test_self_test_refuses_every_changed_constant(dtype, tmp_path):
    """One constant after another, each in its last place, also those that no command shows within the trace."""
    K = synth.StateSpace([[0.5, 0.0], [1e-3, 0.25]], [[1.0], [1e-9]], [[1.0, 1e-9]], [[0.5]], 0.1)
    header, source = synth.export(K, "c", tmp_path, name="small", dtype=dtype, inputs=1.0, umin=-5, umax=5)
    text = source.read_text()
    end = min(at for at in (text.find("void small_reset"), text.find("/* total")) if at > 0)
    numbers = [m for m in re.finditer(r"(?<=[ {])-?\d[\d.e+-]*(?=F?[,\n }])", text[:end]) if float(m[0])]
    assert len(numbers) > 6
    for k, number in enumerate(numbers):
        folder = tmp_path / str(k)
        folder.mkdir()
        (folder / header.name).write_text(header.read_text())
        value = number[0]
        if dtype in FORMATS:
            other = str(int(value) - 1)
        else:
            real = np.float32 if dtype == "float" else np.float64
            other = str(np.nextafter(real(value), real(np.inf)))
        changed = folder / source.name
        changed.write_text(text[: number.start()] + other + text[number.end() :])
        library = folder / "small.so"
        gcc(*STRICT, "-DSMALL_SELF_TEST", "-fPIC", "-shared", "-o", library, changed)
        assert ctypes.CDLL(str(library)).small_self_test() > 0, (value, other)
