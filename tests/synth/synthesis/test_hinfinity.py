"""H-infinity synthesis: literature values, random plants, peers, and what happens with bad input."""

import control
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from literature import GAMMA_PECORILLA2024, compleib, cubesat_pecorilla2024, random_plant

from synth.analysis.norms import hinfnorm, is_stable
from synth.analysis.precondition import precondition
from synth.errors import AssumptionError, InfeasibleError, ModelError, NumericalError
from synth.synthesis import hinfinity
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.connect import lft
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

GAMMA_TOLERANCE = {"lmi": 1e-6, "riccati": 1e-6, "standard": 2e-5, "extended": 2e-5}  # relative


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("method", GAMMA_TOLERANCE)
def test_cubesat_optimum_by_every_method_and_scaling(method, factor):
    design = hinfsyn(cubesat_pecorilla2024(factor), method=method)
    assert design.info.method == method
    assert design.info.optimum == pytest.approx(GAMMA_PECORILLA2024 * factor**2, rel=GAMMA_TOLERANCE[method])
    assert design.gamma == design.verified_norm
    assert design.gamma == pytest.approx(GAMMA_PECORILLA2024 * factor**2, rel=1e-3)
    assert np.abs(design.closed_loop.poles()).max() < 1


def test_design_unpacks_into_control_objects_with_names():
    P = cubesat_pecorilla2024()
    K, CL, gamma, info = hinfsyn(P)
    assert isinstance(K, control.StateSpace)
    assert K.dt == CL.dt == 0.5
    assert K.input_labels[0] == "error y0"
    assert CL.output_labels[-1] == "weighted effort u2"
    assert info.method == "riccati"
    assert 0 < gamma < 1
    # python-control's own feedback interconnection has the same norm
    loop = P.system.to_control().lft(K)
    assert hinfnorm(loop)[0] == pytest.approx(hinfnorm(CL)[0], rel=1e-6)


dimensions = {
    "seed": st.integers(0, 10**6), "n": st.integers(2, 8), "nu": st.integers(1, 3), "ny": st.integers(1, 3),
    "extra_z": st.integers(0, 2), "extra_w": st.integers(0, 2), "direct": st.booleans(),
    "deficient": st.sampled_from(["none", "none", "D12", "D21", "both"]),
}  # fmt: skip


def slicot_norm(P: GeneralizedPlant, level: float) -> float:
    """Norm of the loop that sb10dd's controller for `level` closes; infinite when there is none or it is unstable."""
    slycot = pytest.importorskip("slycot", reason="slycot (SLICOT) is the oracle of this test")
    n, nw, nu, nz, ny = P.sizes
    G = P.system
    try:
        _, Ak, Bk, Ck, Dk, *_ = slycot.sb10dd(n, nw + nu, nz + ny, nu, ny, level, G.A, G.B, G.C, G.D)
        return hinfnorm(lft(G, StateSpace(Ak, Bk, Ck, Dk, P.dt), ny, nu))[0]
    except (slycot.exceptions.SlycotArithmeticError, ModelError):
        return np.inf


@pytest.mark.slow
@settings(max_examples=200, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
@given(**dimensions)
def test_random_plants_get_verified_controllers(seed, n, nu, ny, extra_z, extra_w, direct, deficient):
    """Square, tall and rank-deficient D12 and D21 among them; sb10dd agrees wherever its own answer verifies."""
    P = random_plant(seed, n, ny + extra_w, nu, nu + extra_z, ny, direct=direct, deficient=deficient)
    design = hinfsyn(P)
    assert is_stable(design.closed_loop)
    measured = hinfnorm(P.close(design.controller))[0]
    assert measured <= design.gamma * (1 + 1e-9)
    zero = 1e-3 * precondition(P).scale  # where control can be perfect the optimum is 0: compare with the LQG loop
    for factor in (0.5, 0.8, 0.95, 0.98, 1.01):
        level = factor * design.gamma
        theirs = slicot_norm(P, level)
        if theirs <= level:
            assert design.verified_norm <= 1.01 * max(theirs, zero)


@pytest.mark.slow
@pytest.mark.parametrize("name", compleib())
def test_compleib_reference_optima(name):
    P, reference = compleib()[name]
    design = hinfsyn(P)
    assert design.closed_loop.poles().real.max() < 0
    assert hinfnorm(P.close(design.controller))[0] <= 1.01 * reference
    assert design.verified_norm <= 1.01 * reference


def test_continuous_plant_keeps_its_timebase_and_norm():
    P, reference = compleib()["ac2"]
    design = hinfsyn(P, method="lmi")
    assert design.controller.dt == design.closed_loop.dt == 0.0
    assert design.gamma == pytest.approx(reference, rel=1e-2)
    sweep = [np.linalg.norm(design.closed_loop.frequency_response(w), 2) for w in np.geomspace(1e-4, 1e4, 2000)]
    assert max(sweep) <= design.verified_norm * (1 + 1e-9)


@pytest.mark.parametrize("method", ["lmi", "extended", "standard", "riccati"])
def test_suboptimal_level_is_kept_and_an_unreachable_one_says_what_is_possible(method):
    P = cubesat_pecorilla2024()
    design = hinfsyn(P, method=method, gamma=6e-6)
    assert design.info.level == 6e-6
    assert design.gamma <= 6e-6
    with pytest.raises(InfeasibleError, match="cannot be reached") as caught:
        hinfsyn(P, method=method, gamma=3e-6)
    assert caught.value.best == pytest.approx(GAMMA_PECORILLA2024, rel=1e-3)
    assert caught.value.lower == pytest.approx(GAMMA_PECORILLA2024, rel=1e-4)


def test_all_methods_agree_on_a_plant_with_direct_terms():
    P = random_plant(11, 4, 3, 2, 3, 2, direct=True, deficient="none")
    gammas = [hinfsyn(P, method=m).info.optimum for m in ("lmi", "standard", "extended", "riccati")]
    np.testing.assert_allclose(gammas, gammas[0], rtol=1e-4)


def uncontrollable() -> GeneralizedPlant:
    A, b = np.diag([1.2, 0.5]), np.array([[0.0], [1.0]])
    one = np.ones((1, 1))
    return GeneralizedPlant(A, np.ones((2, 1)), b, np.ones((1, 2)), 0 * one, one, np.ones((1, 2)), one, 0 * one, 1.0)


def test_missing_actuator_or_sensor_names_the_mode():
    P = uncontrollable()
    with pytest.raises(AssumptionError, match=r"1\.2") as caught:
        hinfsyn(P)
    assert "stabilisable" in caught.value.assumption
    assert caught.value.modes == pytest.approx((1.2,))
    dual = GeneralizedPlant(P.A.T, P.C1.T, P.C2.T, P.B1.T, P.D11, P.D21.T, P.B2.T, P.D12.T, P.D22, 1.0)
    with pytest.raises(AssumptionError, match=r"1\.2") as caught:
        hinfsyn(dual)
    assert "detectable" in caught.value.assumption


def test_bad_input_is_named():
    P = cubesat_pecorilla2024()
    system = (P.system.A, P.system.B, P.system.C, P.system.D, 0.5)
    with pytest.raises(ModelError, match="both are needed"):
        hinfsyn(system)
    with pytest.raises(ModelError, match="contradict"):
        hinfsyn(P, 3, 3)
    with pytest.raises(ModelError, match="method is 'fast'"):
        hinfsyn(P, method="fast")
    with pytest.raises(ModelError, match="gamma is -1"):
        hinfsyn(P, gamma=-1)
    with pytest.raises(ModelError, match="timebase is unspecified"):
        hinfsyn(control.ss(*system[:4], None), 6, 3)
    with pytest.raises(ModelError, match=r"A\[0, 0\] is nan"):
        hinfsyn((np.full((6, 6), np.nan), *system[1:]), 6, 3)


def test_auto_falls_back_when_a_route_fails_and_says_so(monkeypatch):
    """A first route whose controllers destabilise must not get through; the second one answers."""

    class Liar:
        solver, tolerance, backoff = "liar", 1.0, (0.0,)

        def __init__(self, plant):
            self.sizes = plant.sizes

        def minimise(self):
            return 1e-3, "optimal"

        def controllers(self, level):
            _, _, nu, _, ny = self.sizes
            yield StateSpace(np.zeros((0, 0)), np.zeros((0, ny)), np.zeros((nu, 0)), 1e3 * np.ones((nu, ny)), 0.5)

    genuine = hinfinity.make_route
    monkeypatch.setattr(
        hinfinity, "make_route", lambda name, plant: Liar(plant) if name == "riccati" else genuine(name, plant)
    )
    design = hinfsyn(cubesat_pecorilla2024())
    assert design.info.method == "lmi"
    assert any("unstable" in reason for reason in design.info.failures.values())
    with pytest.raises(NumericalError, match="no method found a controller that verifies"):
        hinfsyn(cubesat_pecorilla2024(), method="riccati")


def test_repr_says_what_was_verified():
    text = repr(hinfsyn(cubesat_pecorilla2024()))
    assert "verified norm" in text
    assert "method 'riccati'" in text
    assert "optimum 4.157926e-06 by the solver" in text
    assert "margins: gain" in text
