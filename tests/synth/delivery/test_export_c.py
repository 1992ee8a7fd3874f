"""The C that leaves the toolbox: clean, bit for bit the Python that verified it, and refused when it should be."""

import re
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from exported import STRICT, Compiled, closed_loop_inputs, gcc, plain_loop
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from literature import cubesat_model, cubesat_pecorilla2024
from scipy.signal import tf2ss

from synth.delivery.acceptance import Requirements, accept
from synth.delivery.formats import export
from synth.errors import ExportError, ModelError, VerificationError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.controller import LinearController
from synth.regulators.sequential import SequentialController
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

LIMIT = 3e-4  # N m
STABLE = StateSpace([[0.5, 0.1], [0, 0.3]], [[1], [1]], [[1, 2]], [[0.5]], 0.1)
INTEGRATOR = StateSpace([[1]], [[0.1]], [[1]], [[2]], 0.1)


@pytest.fixture(scope="module")
def design() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


def loop_shaping() -> AntiWindup:
    """A PI-weighted loop-shaping design with an observer that is told what the actuator did."""
    G = c2d(StateSpace(*tf2ss([1], [1, -0.3])), 0.02)
    W1 = c2d(StateSpace(*tf2ss([3, 3], [1, 0])), 0.02, "tustin")
    return AntiWindup.of(ncfsyn(StateSpace(G.A, G.B, -G.C, -G.D, 0.02), W1), -0.5, 0.5)


@pytest.mark.parametrize("dtype", ["double", "float"])
def test_cubesat_closed_loop_is_replayed_bit_for_bit(design, tmp_path, dtype):
    """2000 samples, saturated in part; the compiled C, the exported reference and a plain loop agree to the bit."""
    gain = np.linalg.lstsq(design.controller.C, np.eye(3), rcond=None)[0] * 0.1
    options = {"umin": -LIMIT, "umax": LIMIT, "antiwindup": gain, "dtype": dtype}
    controller = SequentialController.of(design, **options)
    _, source = export(design, "c", tmp_path, name="attitude", **options)
    compiled = Compiled(source, controller)

    inputs = closed_loop_inputs(controller, 2000)
    expected = plain_loop(controller, inputs)
    state, ours = controller.init(), []
    for e in inputs:
        state, u = controller.update(state, e)
        ours.append(u)
    saturated = (np.abs(expected) == controller.umax[0]).any(axis=1).mean()
    assert 0.01 < saturated < 0.9
    assert np.array(ours).tobytes() == expected.tobytes()
    assert compiled.replay(inputs).tobytes() == expected.tobytes()
    assert compiled.self_test() == 0


def test_self_test_notices_one_changed_bit(design, tmp_path):
    header, source = export(design, "c", tmp_path, name="attitude")
    text, controller = source.read_text(), SequentialController.of(design)
    number = repr(float(controller.D[0, 0]))  # which reaches a command unrounded
    other = repr(float(np.nextafter(float(number), np.inf)))
    changed = tmp_path / "changed" / source.name
    changed.parent.mkdir()
    (changed.parent / header.name).write_text(header.read_text())
    changed.write_text(text.replace(number, other, 1))
    assert Compiled(source, controller).self_test() == 0
    assert Compiled(changed, controller).self_test() > 0


def test_c99_keeps_the_bits_where_the_machine_could_fuse(design, tmp_path):
    """-std=c99 forbids contraction: with all instructions of this machine the trace is the same."""
    _, source = export(design, "c", tmp_path, name="attitude")
    assert Compiled(source, SequentialController.of(design), "-O3", "-march=native").self_test() == 0


def test_files_say_whether_the_controller_was_accepted(design, tmp_path):
    def comment(name: str, **options) -> str:
        return " ".join(export(design, "c", tmp_path, name=name, **options)[0].read_text().split())

    assert "this controller was never put through accept" in comment("never")
    found = accept(design)
    assert "accepted at a sampling time of 0.5 s" in comment("passed", acceptance=found)
    strict = accept(design, requirements=Requirements(gain_margin_db=40))
    assert "NOT accepted (gain margin) at a sampling time of 0.5 s" in comment("failed", acceptance=strict)
    with pytest.raises(ExportError, match="of another controller"):
        export(STABLE, "c", tmp_path, acceptance=found)
    with pytest.raises(ExportError, match="pass what accept returned"):
        export(design, "c", tmp_path, acceptance=True)


def test_decimal_constants_are_the_bits(design, tmp_path):
    """The shortest decimal in the C source reads back as the same number as its hexadecimal spelling."""
    K = design.controller
    for dtype, real in (("double", np.float64), ("float", np.float32)):
        text = export(design, "c", tmp_path, name=f"a_{dtype}", dtype=dtype)[1].read_text()
        block = text.split(f"static const {dtype} A[")[1].split("};")[0].split("=")[1]
        found = np.array([real(v) for v in re.findall(r"-?\d[\d.e+-]*", block)])
        assert found.tobytes() == K.A.astype(real).tobytes()
        values = K.A.astype(real).ravel()
        lines = [f"{v!s}{'F' if real is np.float32 else ''} == {float(v).hex()}" for v in values]
        program = tmp_path / f"hex_{dtype}.c"
        program.write_text(f"int main(void) {{ return ({' && '.join(lines)}) ? 0 : 1; }}\n")
        gcc("-std=c99", "-o", tmp_path / f"hex_{dtype}", program)
        assert subprocess.run([str(tmp_path / f"hex_{dtype}")]).returncode == 0


def test_antiwindup_of_a_loop_shaping_design(tmp_path):
    """An unstable plant with an integrating weight; limits and gain come with the AntiWindup."""
    controller = loop_shaping()
    sequential = SequentialController.of(controller)
    _, source = export(controller, "c", tmp_path, name="pi")
    inputs = np.random.default_rng(0).normal(size=(500, 1))
    expected = plain_loop(sequential, inputs)
    assert Compiled(source, sequential).replay(inputs).tobytes() == expected.tobytes()
    state, ours = controller.init(), []
    for e in inputs:
        state, u = controller.step(state, np.zeros(1), e)
        ours.append(u)
    np.testing.assert_allclose(ours, expected, atol=1e-12)
    assert (np.abs(expected) == 0.5).any()


@st.composite
def controllers(draw):
    """Stable controllers of any shape, with and without direct term, limits and anti-windup, in both types."""
    n, p, m = draw(st.integers(0, 6)), draw(st.integers(1, 3)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    A, C = rng.normal(size=(n, n)), rng.normal(size=(m, n))
    A *= 0.95 / max(np.abs(np.linalg.eigvals(A)).max(initial=0), 0.95)
    B = rng.normal(size=(n, p)) * 10.0 ** rng.integers(-6, 6, size=(1, p))
    K = StateSpace(A, B, C, rng.normal(size=(m, p)) * draw(st.booleans()), 0.1)
    options = {"dtype": draw(st.sampled_from(["double", "float"]))}
    if draw(st.booleans()):
        options["umax"] = rng.uniform(0.1, 2, size=m) * np.where(rng.random(m) < 0.2, np.inf, 1)
        options["umin"] = -rng.uniform(0.1, 2)
        gain = 0.1 * rng.normal(size=(n, m))
        while n and np.abs(np.linalg.eigvals(A - gain @ C)).max() >= 0.99:
            gain = gain / 2
        options["antiwindup"] = gain if draw(st.booleans()) else None
    return K, options, rng.normal(size=(100, p))


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(case=controllers())
def test_random_controllers_compile_clean_and_agree(case, tmp_path_factory):
    K, options, inputs = case
    controller = SequentialController.of(K, **options)
    _, source = export(K, "c", tmp_path_factory.mktemp("c"), name="random", **options)
    compiled = Compiled(source, controller)
    assert compiled.self_test() == 0
    assert compiled.replay(inputs).tobytes() == plain_loop(controller, inputs).tobytes()


@pytest.mark.parametrize("self_test", [True, False])
def test_header_and_source_are_clean_without_the_macro(design, tmp_path, self_test):
    header, source = export(design, "c", tmp_path, name="attitude", self_test=self_test)
    gcc(*STRICT, "-c", source, "-o", tmp_path / "attitude.o")
    assert ("SELF_TEST" in header.read_text()) == ("SELF_TEST" in source.read_text()) == self_test


def test_provenance_names_and_units_but_no_place(tmp_path):
    weights = {"Wact": 1e-2 * np.eye(3), "Wproc": 2.5e-4 * np.eye(3), "Wdist": 5e-2 * np.eye(6)}
    weights |= {"Werr": 1e-5 * np.eye(6), "Wr": 2e-2 * np.eye(6)}
    axes, signals = ("tx", "ty", "tz"), ("qx", "qy", "qz", "wx", "wy", "wz")
    units = dict.fromkeys(axes, "N m") | dict.fromkeys(signals[3:], "rad/s")
    plant = cubesat_pecorilla2024().tracking(cubesat_model(), **weights, u=axes, y=signals, units=units)
    design = hinfsyn(plant)
    header = export(design, "c", tmp_path, dtype="float", umin=-LIMIT, umax=LIMIT)[0].read_text()
    flat = re.sub(r"\s*\n \*\s*", " ", header)
    assert plant.system.digest() in flat
    assert design.controller.digest() in flat
    assert repr(design.gamma) in flat
    assert repr(design.verified_norm) in flat
    assert "rounded      to float; H-infinity norm" in header
    assert "u[2]  tz [N m]  in [-0.0003, 0.0003]" in header
    assert "y[3]  error wx [rad/s]" in header
    assert str(tmp_path) not in header
    bare = export(STABLE, "c", tmp_path, name="bare")[0].read_text()
    assert "without a plant" in bare


@pytest.mark.parametrize(
    ("K", "options", "message"),
    [
        (StateSpace([[-1]], [[1]], [[1]], [[0]]), {}, "continuous.*c2d"),
        (StateSpace([[1.2]], [[1]], [[1]], [[0]], 0.1), {}, "is unstable.*allow_unstable=True"),
        (INTEGRATOR, {}, "integrates.*umin, umax and antiwindup"),
        (INTEGRATOR, {"umin": -1, "umax": 1}, "A - L C has spectral radius 1"),
        (INTEGRATOR, {"umin": -1, "umax": 1, "allow_unstable": True}, "A - L C has spectral radius 1"),
        (STABLE, {"umin": -1, "umax": 1, "antiwindup": [[5], [0]]}, "A - L C has spectral radius"),
        (StateSpace([[0.5]], [[1e300]], [[1]], [[0]], 0.1), {"dtype": "float"}, r"B has the entry 1e\+300.*float"),
        (STABLE, {"dtype": "half"}, "dtype is 'half'"),
        (STABLE, {"name": "my controller"}, "name is 'my controller'.*letters, digits"),
        (STABLE, {"name": "../evil"}, "no folder"),
        (STABLE, {"name": "/evil"}, "no folder"),
        (STABLE, {"name": "_x"}, "a letter first"),
        (STABLE, {"name": "x\n"}, "a letter first"),
        (STABLE, {"name": "été"}, "a letter first"),
        (STABLE, {"name": "double"}, "reserved word"),
        (STABLE, {"name": "Math"}, "reserved word or standard header"),
        (STABLE, {"name": "a" * 60}, "60 characters"),
    ],
)
def test_what_is_no_exportable_controller_is_refused(tmp_path, K, options, message):
    with pytest.raises(ExportError, match=message):
        export(K, "c", tmp_path / "out", **options)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"umin": np.nan}, "umin is nan"),
        ({"umin": 1, "umax": 1}, r"umin = \[1.0\] is not below"),
        ({"umin": [1, 2]}, "umin is"),
        ({"umax": "much"}, "umax is 'much'"),
        ({"umax": 1, "antiwindup": [[np.inf], [0]]}, r"antiwindup\[0, 0\] is inf"),
        ({"umax": 1, "antiwindup": [[1]]}, "antiwindup is 1 x 1"),
        ({"antiwindup": [[1], [0]]}, "antiwindup is given without limits"),
    ],
)
def test_limits_and_gain_are_checked(tmp_path, options, message):
    with pytest.raises(ModelError, match=message):
        export(STABLE, "c", tmp_path, **options)
    with pytest.raises(ModelError, match=r"A\[0, 0\] is nan"):
        export(([[np.nan]], [[1]], [[1]], [[0]], 0.1), "c", tmp_path)
    with pytest.raises(ModelError, match="an AntiWindup has its own"):
        export(loop_shaping(), "c", tmp_path, umax=1)
    assert not list(tmp_path.iterdir())


def test_permissions(tmp_path):
    unstable = StateSpace([[1.2]], [[1]], [[1]], [[0]], 0.1)
    assert len(export(unstable, "c", tmp_path, name="a", allow_unstable=True)) == 2
    assert len(export(INTEGRATOR, "c", tmp_path, name="b", umin=-1, umax=1, antiwindup=[[0.5]])) == 2
    explosive = StateSpace([[1e30]], [[1]], [[1]], [[0]], 0.1)
    with pytest.raises(ExportError, match="overflow within the self test"):
        export(explosive, "c", tmp_path, name="c", allow_unstable=True)
    assert len(export(explosive, "c", tmp_path, name="c", allow_unstable=True, self_test=False)) == 2


def test_existing_files_are_kept_without_force(tmp_path):
    header, source = export(STABLE, "c", tmp_path)
    before = header.read_bytes()
    source.unlink()
    with pytest.raises(ExportError, match=r"controller\.h exists; pass force=True"):
        export(STABLE, "c", tmp_path, dtype="float")
    assert [p.name for p in tmp_path.iterdir()] == ["controller.h"]
    assert header.read_bytes() == before
    export(STABLE, "c", tmp_path, dtype="float", force=True)
    assert "float" in header.read_text()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["controller.c", "controller.h"]
    with pytest.raises(ExportError, match="is no folder"):
        export(STABLE, "c", header)


def test_both_files_or_none(tmp_path, monkeypatch):
    """The disk fails at the second file: the first one is what it was."""
    from synth.delivery import files

    export(STABLE, "c", tmp_path)
    before = {p.name: p.read_bytes() for p in tmp_path.iterdir()}
    write, calls = files.write_atomically, []

    def failing(path, content):
        calls.append(path)
        if len(calls) == 2:
            raise OSError("no space left")
        return write(path, content)

    monkeypatch.setattr(files, "write_atomically", failing)
    with pytest.raises(OSError, match="no space"):
        export(STABLE, "c", tmp_path, dtype="float", force=True)
    assert {p.name: p.read_bytes() for p in tmp_path.iterdir()} == before


def test_texts_cannot_leave_their_comment(design, tmp_path):
    hostile = replace(design, info=replace(design.info, status="*/ int evil; /*"))
    with pytest.raises(ExportError, match=r"method is .* use printable characters"):
        export(hostile, "c", tmp_path)
    names = replace(design.plant, u=("a", "b", "c\nd"))
    with pytest.raises(ExportError, match="signal"):
        export(replace(design, plant=names), "c", tmp_path)
    assert not list(tmp_path.iterdir())


def test_rounding_that_loses_the_loop_is_noticed(design, tmp_path):
    """In single precision the loop is closed again with the rounded matrices; one that is unstable does not leave."""
    K = design.controller
    spoiled = replace(design, controller=StateSpace(K.A, K.B, K.C, -K.D, K.dt))
    with pytest.raises(VerificationError, match="unstable"):
        export(spoiled, "c", tmp_path, dtype="float")
    assert not list(tmp_path.iterdir())


def test_unknown_formats_and_options_of_other_formats(tmp_path):
    with pytest.raises(ExportError, match="format is 'pdf'"):
        export(STABLE, "pdf", tmp_path)
    with pytest.raises(ExportError, match="dtype: a json file holds the numbers as they are"):
        export(STABLE, "json", tmp_path, umax=1, dtype="float")


def test_step_is_update_on_the_error(design):
    """A simulator flies the exported controller as it flies the linear one."""
    ours, linear = SequentialController.of(design), LinearController.of(design.controller)
    y, r = np.arange(6.0), np.ones(6)
    s1, u1 = ours.step(ours.init(), y, r)
    s2, u2 = linear.step(linear.init(), y, r)
    np.testing.assert_allclose(u1, u2, rtol=1e-12)
    np.testing.assert_allclose(s1.x, s2, rtol=1e-12)
    with pytest.raises(ModelError, match="pass 6 numbers"):
        ours.update(ours.init(), np.zeros(5))
