"""The acceptance gate: it passes what holds, and finds what a processor and its actuators break."""

import numpy as np
import pytest
from literature import compleib, cubesat_pecorilla2024

from synth.analysis.coprime import gang_of_four
from synth.analysis.norms import hinfnorm
from synth.analysis.stabilitymargins import margins
from synth.delivery.acceptance import Acceptance, Requirements, accept, inner
from synth.delivery.simulation import simulate
from synth.errors import ModelError
from synth.regulators.antiwindup import AntiWindup
from synth.regulators.sequential import SequentialController
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.connect import delayed
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace


@pytest.fixture(scope="module")
def cubesat() -> Design:
    return hinfsyn(cubesat_pecorilla2024())


@pytest.fixture(scope="module")
def accepted(cubesat) -> Acceptance:
    return accept(cubesat, umin=-1e-3, umax=1e-3)


def lines(found: Acceptance) -> dict:
    return {c.name: c for c in found.conditions}


def static(D, dt) -> StateSpace:
    D = np.atleast_2d(np.asarray(D, float))
    return StateSpace(np.zeros((0, 0)), np.zeros((0, D.shape[1])), np.zeros((D.shape[0], 0)), D, dt)


def test_the_cubesat_design_is_accepted(cubesat, accepted):
    found = lines(accepted)
    assert accepted.passed
    assert found["designed"].norm == pytest.approx(cubesat.verified_norm, rel=1e-6)
    assert found["designed"].ratio == pytest.approx(1, abs=1e-2)
    assert 1 < found["one sample of delay"].ratio < 1.5
    assert found["float32 numbers"].ratio == pytest.approx(1, abs=1e-5)
    assert not found["zero-order hold"].required
    assert found["saturation"].stable
    assert accepted.margins.gain_db == margins(inner(cubesat.plant), cubesat.controller, sign=1).gain_db


def test_conditions_are_what_they_say(cubesat, accepted):
    """Delay and rounding measured beside the gate, by other means."""
    P, K = cubesat.plant, cubesat.controller
    late, (norm, _) = delayed(K), hinfnorm(P.close(delayed(K)))
    omega = 0.3
    np.testing.assert_allclose(
        late.frequency_response(omega),
        K.frequency_response(omega) * np.exp(-1j * omega * K.dt),
        rtol=1e-12,
        atol=1e-12 * np.abs(K.frequency_response(omega)).max(),  # the axes are nearly decoupled
    )
    assert lines(accepted)["one sample of delay"].norm == pytest.approx(norm, rel=1e-5)
    rounded = StateSpace(*(np.float32(getattr(K, name)).astype(float) for name in "ABCD"), K.dt)
    assert lines(accepted)["float32 numbers"].norm == pytest.approx(hinfnorm(P.close(rounded))[0], rel=1e-5)


def test_simulation_follows_the_closed_loop(cubesat):
    P, K = cubesat.plant, cubesat.controller
    x0 = np.array([0.1, -0.2, 0.3, 0.0, 0.01, 0.0])
    run = simulate(inner(P), SequentialController.of(K), x0, 30)
    loop = P.close(K)
    state = np.concatenate([x0, np.zeros(K.n)])
    for k in range(30):
        np.testing.assert_allclose(run.y[k], P.C2 @ state[: len(x0)], atol=1e-12)
        state = loop.A @ state


def test_requirements_that_are_missed_are_named(cubesat):
    found = accept(cubesat, requirements=Requirements(phase_margin_deg=60, disk_margin=0.4, delay_ratio=1.05))
    failed = {name: c.note for name, c in lines(found).items() if not c.passed}
    assert failed.keys() == {"phase margin", "one sample of delay"}
    assert "required 60" in failed["phase margin"]
    assert "at most 1.05" in failed["one sample of delay"]
    assert lines(found)["disk margin"].verdict == "pass"


def test_a_continuous_design_needs_its_sampling_time():
    """The LMIs' controller of AC2 has poles far beyond any processor: held over 10 ms its loop is unstable."""
    plant = compleib()["ac2"][0]
    design = hinfsyn(plant, method="lmi")
    with pytest.raises(ModelError, match="pass dt"):
        accept(design)
    found = lines(accept(design, dt=0.01))
    assert found["designed"].passed
    assert not found["zero-order hold"].stable
    design = ncfsyn(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[-1, 0]], [[0]]), method="riccati")
    coarse, fine, finer = (accept(design, dt=dt) for dt in (0.2, 0.1, 0.05))
    assert fine.passed
    assert fine.dt == 0.1
    errors = [abs(lines(found)["zero-order hold"].norm / design.verified_norm - 1) for found in (coarse, fine, finer)]
    assert errors[1] < 0.6 * errors[0]  # first order in dt
    assert errors[2] < 0.6 * errors[1]


def loop(a: float, k: float, dt: float = 1.0) -> tuple[StateSpace, GeneralizedPlant]:
    """u = -k y on x+ = a x + u."""
    return static(-k, dt), gang_of_four(StateSpace([[a]], [[1.0]], [[1.0]], [[0.0]], dt))


def test_one_sample_of_delay_destabilises_what_has_no_room():
    """x+ = 1.5 x + u: with delay z^2 - 1.5 z + k is stable for 0.5 < k < 1, the loop without delay up to 2.5."""
    assert lines(accept(*loop(1.5, 0.8)))["one sample of delay"].stable
    found = lines(accept(*loop(1.5, 1.2)))
    assert found["designed"].stable
    assert not found["one sample of delay"].stable
    assert "spectral radius" in found["one sample of delay"].note


def test_saturation_of_an_unstable_plant():
    """x+ = 1.5 x + u, |u| <= 1: no control brings back |x| >= 2. Demand k |x| of `overload` decides which it is."""
    K, P = loop(1.5, 1.0)
    assert lines(accept(K, P, umin=-1, umax=1, overload=1.9))["saturation"].passed
    found = lines(accept(K, P, umin=-1, umax=1, overload=2.1))["saturation"]
    assert not found.passed
    assert "not back" in found.note
    uneven = lines(accept(K, P, umin=-1, umax=3, overload=1.9))["saturation"]
    assert uneven.passed
    assert "2 starts" in uneven.note


def test_float32_breaks_a_controller_whose_poles_cluster():
    """A companion form with three poles at 0.998: the eighth digit of its coefficients moves them by 0.004."""
    c = np.poly(np.full(3, 0.998))
    K = StateSpace(np.vstack([-c[1:], np.eye(2, 3)]), np.eye(3, 1), 1e-9 * np.eye(1, 3), [[-0.8]], 1.0)
    found = lines(accept(K, loop(1.5, 0)[1]))
    assert found["designed"].stable
    assert not found["float32 numbers"].stable
    assert not found["float32 arithmetic"].passed


def test_loop_shaping_saturates_on_its_plant_with_anti_windup():
    g = c2d(StateSpace([[0, 1], [0, 0]], [[0], [1]], [[1, 0]], [[0]]), 0.1)
    G = StateSpace(g.A, g.B, -g.C, g.D, g.dt)
    W1 = StateSpace([[1.0]], [[0.02]], [[1.0]], [[1.0]], 0.1)
    design = ncfsyn(G, W1)
    assert accept(design).passed
    with pytest.raises(ModelError, match="shaped plant W2 G W1 only"):
        accept(design, umin=-1, umax=1)
    L = AntiWindup.of(design, -1, 1).L
    found = lines(accept(design, gang_of_four(G), umin=-1, umax=1, antiwindup=L))
    assert found["saturation"].passed
    assert found["designed"].verdict == "not judged"  # gamma is that of the shaped plant


def test_an_unstable_loop_is_not_accepted():
    K, P = loop(1.5, 0.1)
    found = accept(K, P, umin=-1, umax=1)
    assert not found.passed
    assert found.margins is None
    assert not lines(found)["gain margin"].passed
    for name in ("float32 arithmetic", "saturation"):
        assert not lines(found)[name].passed
        assert lines(found)[name].note == "not simulated: the loop is unstable"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"dt": 2.0}, "leave dt away"),
        ({"overload": 0.5}, "above 1"),
        ({"umin": 1, "umax": 2}, "zero must lie between"),
        ({"umin": [1, 2]}, "pass a number or 1 of them"),
    ],
)
def test_refusals(options, message):
    K, P = loop(1.5, 1.0)
    with pytest.raises(ModelError, match=message):
        accept(K, P, **options)
    with pytest.raises(ModelError, match="comes without a plant"):
        accept(K)
    with pytest.raises(ModelError, match="ratio is -1"):
        Requirements(ratio=-1)
    with pytest.raises(ModelError, match="disk_margin is -1"):
        Requirements(disk_margin=-1)
    with pytest.raises(ModelError, match="level is 0"):
        accept(K, P, level=0)


def worse(K: StateSpace, factor: float) -> StateSpace:
    return StateSpace(K.A, K.B, factor * K.C, factor * K.D, K.dt)


def test_a_bare_controller_has_no_level_to_keep(cubesat, accepted):
    """Its norm is reported, not judged; told a level it is, and the design's own level is that of the design."""
    bare = accept(cubesat.controller, cubesat.plant)
    line = lines(bare)["designed"]
    assert (line.verdict, line.ratio, bare.level) == ("not judged", None, None)
    assert line.norm == pytest.approx(lines(accepted)["designed"].norm, rel=1e-12)
    assert bare.passed
    assert [c.name for c in bare.not_judged] == ["designed", "between the samples"]
    assert "accepted at a sampling time of 0.5 s; not judged, no level known: designed" in bare.verdict
    told = accept(cubesat.controller, cubesat.plant, level=cubesat.gamma)
    assert [c.verdict for c in told.conditions] == [c.verdict for c in accept(cubesat).conditions]
    assert not lines(accept(cubesat.controller, cubesat.plant, level=cubesat.gamma / 2))["designed"].passed
    assert accept(cubesat, cubesat.plant).level == cubesat.gamma
    late = accept(cubesat.controller, cubesat.plant, requirements=Requirements(delay_ratio=1.5))
    assert [c.name for c in late.not_judged] == ["designed", "between the samples", "one sample of delay"]


@pytest.mark.parametrize("limits", [{}, {"umin": -1e-3, "umax": 1e-3}])
def test_a_controller_made_worse_is_not_accepted(cubesat, limits):
    """Commands 3.2 times as large: without a level it is the margins that tell, with one the norm as well."""
    K = worse(cubesat.controller, 3.2)
    bare = accept(K, cubesat.plant, **limits)
    assert not bare.passed
    assert "disk margin" in {c.name for c in bare.failed}
    told = accept(K, cubesat.plant, level=cubesat.gamma, **limits)
    assert {"designed", "disk margin"} <= {c.name for c in told.failed}


@pytest.mark.parametrize("dt", [1e-3, 1.0, 1e3])
def test_margins_are_asked_by_default(dt):
    """x+ = 1.2 x - k x: the disk shrinks as k nears the limits 0.2 and 2.2, whatever the unit of time."""
    P = gang_of_four(StateSpace([[1.2]], [[1.0]], [[1.0]], [[0.0]], dt))
    good, near = accept(static(-0.9, dt), P), accept(static(-2.0, dt), P)
    assert good.passed
    assert {c.name for c in near.failed} >= {"delay margin", "disk margin"}
    nothing = Requirements(delay_margin_samples=None, disk_margin=None)
    assert lines(accept(static(-2.0, dt), P, requirements=nothing))["disk margin"].verdict == "-"
    zero = Requirements(delay_margin_samples=0, disk_margin=0)
    assert lines(accept(static(-2.0, dt), P, requirements=zero))["delay margin"].verdict == "-"


def test_a_level_of_zero_is_kept_by_a_norm_of_zero_alone(cubesat):
    """w reaches z through the controller only: a design of level 0 whose controller was exchanged has no ratio of 1."""
    P = GeneralizedPlant([[0.5]], [[0]], [[1]], [[1]], [[0]], [[1]], [[1]], [[1]], [[0]], dt=1.0)
    for gain, ratio in ((0.0, 1.0), (-0.3, np.inf)):
        design = Design(P, static(gain, 1.0), P.close(gain), 0.0, cubesat.info)
        found = lines(accept(design))["designed"]
        assert (found.ratio, found.passed) == (ratio, ratio == 1)
