"""Numbers that are none: the exported controller holds its last command and says so, in C as in Python, to the bit."""

import shutil
import subprocess

import numpy as np
import pytest
from exported import Compiled, gcc, plain_loop_with_faults
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from synth.delivery.formats import export
from synth.regulators.sequential import SequentialController
from synth.systems.statespace import StateSpace

OPTIMISED = [("-O0",), ("-O3", "-march=native")]
STRANGE = [np.nan, -np.nan, np.inf, -np.inf, 1e308, -1e308, 3e38, 5e-324, 1e-40, -1e-310, -0.0, 0.0]


def dynamic(D: float = 0.5) -> StateSpace:
    return StateSpace([[0.5, 0.1], [0, 0.3]], [[1, 0.2], [1, -1]], [[1, 2], [0, 1]], D * np.eye(2), 0.1)


CASES = {
    "dynamic": (dynamic(), {}),
    "no direct term": (dynamic(0), {}),
    "limits": (dynamic(), {"umin": -1, "umax": [0.5, np.inf]}),
    "anti-windup": (dynamic(0), {"umin": -1, "umax": 1, "antiwindup": [[0.1, 0], [0.1, 0.2]]}),
    "away from zero": (dynamic(), {"umin": 0.25, "umax": 1}),
    "below zero": (dynamic(), {"umin": [-1, -2], "umax": [-0.5, -0.25]}),
    "static": (StateSpace.gain([[1, 2], [3, -4.0]], 0.1), {}),
    "static with limits": (StateSpace.gain([[1, 0], [3, -4.0]], 0.1), {"umin": -1, "umax": 1}),
}


def run(controller: SequentialController, inputs: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Outputs and faults of the Python that C is printed from."""
    state, outputs, faults = controller.init(), [], []
    for y in inputs:
        state, u = controller.update(state, y)
        outputs.append(u)
        faults.append(state.fault)
    return np.array(outputs), np.array(faults)


def sequences() -> np.ndarray:
    """Faults at the first sample, one after the other, in one channel or both, and samples to recover in between."""
    rng = np.random.default_rng(0)
    rows = [[np.nan, 0.0], [np.inf, np.nan], *rng.normal(size=(3, 2))]
    for value in STRANGE:
        rows += [[value, 0.1], *rng.normal(size=(2, 2)), [0.1, value], [value, value], *rng.normal(size=(2, 2))]
    return np.array(rows)


@pytest.mark.parametrize("dtype", ["double", "float"])
@pytest.mark.parametrize("case", CASES)
def test_every_strange_number(case, dtype, tmp_path):
    """C at both ends of optimisation, the Python behind it and a plain loop: the same bits, the same faults."""
    K, options = CASES[case]
    controller = SequentialController.of(K, dtype=dtype, **options)
    with np.errstate(over="ignore"):
        inputs = sequences().astype(controller.A.dtype)
    expected, faults = plain_loop_with_faults(controller, inputs)
    ours, told = run(controller, inputs)
    assert ours.tobytes() == expected.tobytes()
    assert told.tolist() == faults.tolist()
    assert np.isfinite(expected).all()
    assert faults[[0, 1]].all()
    assert not faults[2:5].any()
    assert 0.2 < faults.mean() < 0.8
    first = np.clip(0, controller.umin, controller.umax).astype(expected.dtype)
    np.testing.assert_array_equal(expected[:2], [first, first])
    _, source = export(K, "c", tmp_path, name="held", dtype=dtype, **options)
    for k, flags in enumerate(OPTIMISED):
        place = tmp_path / str(k) / source.name
        place.parent.mkdir()
        for file in (source, source.with_suffix(".h")):
            shutil.copy(file, place.parent)
        compiled = Compiled(place, controller, *flags)
        outputs, returned = compiled.replay_with_faults(inputs)
        assert outputs.tobytes() == expected.tobytes()
        assert returned.tolist() == faults.tolist()
        assert compiled.self_test() == 0


@pytest.mark.parametrize("case", CASES)
def test_a_fault_leaves_no_trace(case):
    """Samples before and after faults give the commands that they give without the faults in between."""
    K, options = CASES[case]
    controller = SequentialController.of(K, **options)
    clean = np.random.default_rng(1).normal(size=(20, 2))
    expected, faults = run(controller, clean)
    assert not faults.any()
    spoiled = np.insert(clean, [0, 0, 7, 7, 7, 19], np.nan, axis=0)
    found, faults = run(controller, spoiled)
    assert found[~faults].tobytes() == expected.tobytes()
    held = [found[k - 1] for k in range(4, len(found)) if faults[k]]
    np.testing.assert_array_equal(held, [found[k] for k in range(4, len(found)) if faults[k]])


def test_overflow_inside_is_a_fault():
    """Every input is finite, a sum is not; with limits the command would be, and the states would not."""
    K = StateSpace([[0.5]], [[1e200]], [[1.0]], [[0.0]], 0.1)
    for options in ({}, {"umin": -1, "umax": 1}):
        controller = SequentialController.of(K, **options)
        outputs, faults = run(controller, np.array([[1e-200], [1e200], [-1e200], [0.0]]))
        assert faults.tolist() == [False, True, True, False]
        np.testing.assert_array_equal(outputs[:, 0], [0, 0, 0, 1])


def test_a_state_that_is_no_number_is_a_fault_until_the_reset():
    """As after an upset of memory: the command is held, every sample says so."""
    controller = SequentialController.of(dynamic(0), umin=-1, umax=1, antiwindup=0.1 * np.eye(2))
    state, u = controller.update(controller.init(), np.ones(2))
    for value in (np.nan, np.inf):
        upset = state._replace(x=np.array([0.0, value]))
        for y in (np.zeros(2), np.ones(2)):
            upset, held = controller.update(upset, y)
            assert upset.fault
            np.testing.assert_array_equal(held, u)
    assert not controller.update(controller.init(), np.ones(2))[0].fault


@st.composite
def programs(draw):
    """Controllers of any shape in both types, and inputs of which any may be any number that the type has."""
    n, p, m = draw(st.integers(0, 4)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A = rng.normal(size=(n, n)) * (rng.random((n, n)) < 0.7)
    A *= 0.9 / max(np.abs(np.linalg.eigvals(A)).max(initial=0), 0.9)
    B, C, D = (rng.normal(size=s) * (rng.random(s) < 0.7) for s in ((n, p), (m, n), (m, p)))
    options = {"dtype": draw(st.sampled_from(["double", "float"]))}
    if draw(st.booleans()):
        low = rng.normal(size=m)
        options |= {"umin": low, "umax": low + rng.uniform(0.1, 2, size=m)}
    width = 64 if options["dtype"] == "double" else 32
    number = st.floats(width=width) | st.sampled_from([0.0, 1.0, -1.0])
    inputs = draw(st.lists(st.lists(number, min_size=p, max_size=p), min_size=5, max_size=30))
    return StateSpace(A, B, C, D, 0.1), options, np.array(inputs)


@settings(max_examples=200, deadline=None)
@given(programs())
def test_python_holds_as_the_plain_loop_does(case):
    K, options, inputs = case
    controller = SequentialController.of(K, **options)
    outputs, faults = run(controller, inputs)
    expected, held = plain_loop_with_faults(controller, inputs)
    assert outputs.tobytes() == expected.tobytes()
    assert faults.tolist() == held.tolist()
    assert np.isfinite(outputs).all()
    assert ((outputs >= controller.umin) & (outputs <= controller.umax)).all()


@pytest.mark.slow
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(case=programs())
def test_c_holds_as_python_does(case, tmp_path_factory):
    K, options, inputs = case
    controller = SequentialController.of(K, **options)
    _, source = export(K, "c", tmp_path_factory.mktemp("c"), name="held", **options)
    outputs, faults = Compiled(source, controller, "-O3", "-march=native").replay_with_faults(inputs)
    expected, held = run(controller, inputs)
    assert outputs.tobytes() == expected.tobytes()
    assert faults.tolist() == held.tolist()


def test_the_self_test_notices_comparisons_that_let_nan_pass(tmp_path):
    """Where the tests are taken out, by hand or by an option of a compiler, the self test fails or nothing compiles."""
    header, source = export(dynamic(), "c", tmp_path, name="held", umin=-1, umax=1)
    controller = SequentialController.of(dynamic(), umin=-1, umax=1)
    tests = ["!isfinite(y[j])", "!isfinite(v)", "!isfinite(next[i])"]
    for k, (removed, answer) in enumerate([(tests[:1], 0), (tests[1:], 0), (tests, 33)]):  # one of them is enough
        text = source.read_text()
        for test in removed:
            assert test in text
            text = text.replace(test, "0")
        changed = tmp_path / str(k) / source.name
        changed.parent.mkdir()
        shutil.copy(header, changed.parent)
        changed.write_text(text)
        assert Compiled(changed, controller).self_test() == answer
    gcc("-std=c99", "-c", source, "-o", tmp_path / "held.o")
    fast = ["gcc", "-std=c99", "-ffast-math", "-c", str(source), "-o", str(tmp_path / "held.o")]
    done = subprocess.run(fast, capture_output=True, text=True)
    assert done.returncode != 0
    assert "compile without -ffast-math" in done.stderr
