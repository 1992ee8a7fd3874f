"""What `gamma` means, what is called impossible, and what a design says against itself."""

import json

import numpy as np
import pytest
from literature import GAMMA_PECORILLA2024, compleib, cubesat_pecorilla2024, mass_spring_chain, random_plant
from provable import drawn

from synth.analysis.norms import hinfnorm
from synth.analysis.stabilitymargins import margins
from synth.errors import InfeasibleError, ModelError
from synth.synthesis.design import Design, to_dict
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.synthesis.mixedsensitivity import augw, mixsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.sampled import c2d
from synth.systems.statespace import StateSpace

DOUBLE = StateSpace([[0, 1.0], [0, 0]], [[0], [1.0]], [[1.0, 0]], [[0]])


def some_plants() -> dict[str, GeneralizedPlant]:
    found = {f"random {seed}": random_plant(seed, 5, 3, 2, 3, 2, direct=True, deficient=d)
             for seed, d in ((1, "none"), (2, "D12"), (3, "both"))}  # fmt: skip
    found |= {name: compleib()[name][0] for name in ("ac2", "he1", "dis1")}
    servo = StateSpace([[-0.12, 0], [1, -1e-5]], [[11.2], [0]], [[0, 1.0]], [[0]])
    found["servo"] = augw(servo, StateSpace([[-2e-4]], [[1]], [[20]], [[0.6]]), 1.0)
    return found | {"chain": mass_spring_chain(8), "cubesat": cubesat_pecorilla2024()}


@pytest.mark.parametrize("name", some_plants())
def test_gamma_is_the_norm_and_a_level_just_above_it_is_delivered(name):
    P = some_plants()[name]
    design = hinfsyn(P)
    assert design.gamma == design.verified_norm == design[2]
    assert hinfnorm(P.close(design.controller))[0] == pytest.approx(design.gamma, rel=1e-5)
    assert design.info.optimum <= design.gamma <= design.info.optimum * (1 + 1.1e-3)
    again = hinfsyn(P, gamma=1.0001 * design.gamma)
    assert again.gamma <= again.info.level * (1 + 1e-12) or again.gamma <= 1.0001 * design.gamma


@pytest.mark.parametrize("tol", [1e-2, 1e-4, 1e-6])
@pytest.mark.parametrize("method", ["riccati", "lmi"])
def test_tolerance_is_kept_or_the_status_says_that_it_is_not(tol, method):
    design = hinfsyn(cubesat_pecorilla2024(), method=method, tol=tol)
    if design.gamma > GAMMA_PECORILLA2024 * (1 + 1.01 * tol):
        assert "claims an optimum of" in design.info.status
        assert design.info.warnings
    else:
        assert not design.info.warnings
    if method == "riccati":
        assert design.gamma <= GAMMA_PECORILLA2024 * (1 + 1.01 * tol)
    with pytest.raises(ModelError, match="tol is 0"):
        hinfsyn(cubesat_pecorilla2024(), tol=0)


def test_what_is_not_proved_is_not_called_impossible():
    """A millionth above the optimum: possible, but no method builds such a controller."""
    P, level = cubesat_pecorilla2024(), GAMMA_PECORILLA2024 * (1 + 2e-7)
    assert hinfsyn(P, gamma=GAMMA_PECORILLA2024 * (1 + 2e-5)).gamma <= GAMMA_PECORILLA2024 * (1 + 2e-5)
    with pytest.raises(InfeasibleError, match="was not reached: the best verified level is") as caught:
        hinfsyn(P, gamma=level)
    assert "proved impossible is only what is below 4.1579" in str(caught.value)
    assert caught.value.lower < GAMMA_PECORILLA2024 < level < caught.value.best
    with pytest.raises(InfeasibleError, match=r"cannot be reached: no controller goes below 4\.1579.*which is proved"):
        hinfsyn(P, gamma=0.999 * GAMMA_PECORILLA2024)


@pytest.mark.parametrize("method", ["lmi", "standard", "extended"])
def test_a_named_method_that_stops_short_says_so(method):
    """Textbook mixed sensitivity (S-P 2.17), where the LMIs are ill-conditioned: within 1 %, or said."""
    G = StateSpace([[-0.1, 0, 0], [20, -20, 0], [0, 20, -20]], [[20.0], [0], [0]], [[0, 0, 1.0]], [[0]])
    W1 = StateSpace([[-1e-3]], [[1]], [[10 - 1e-3 / 1.5]], [[1 / 1.5]])
    best = mixsyn(G, W1, 1.0)
    assert best.info.method == "riccati"
    design = mixsyn(G, W1, 1.0, method=method)
    if design.gamma > 1.01 * best.gamma:
        assert design.info.warnings
        assert "'riccati' claims" in design.info.status
        assert "warning" in repr(design)


def test_zero_optimum_is_not_attained():
    """u and y act on z and w at once: any level is reached by ever larger gains."""
    one = np.eye(1)
    P = GeneralizedPlant(0.5 * one, one, one, one, 0 * one, one, one, one, 0 * one, 1.0)
    design = hinfsyn(P)
    assert "not attained" in design.info.status
    assert hinfnorm(P.close(design.controller))[0] <= design.gamma
    assert hinfsyn(P, gamma=1e-3).gamma <= 1e-3


@pytest.mark.parametrize(
    ("torque", "text"),
    [
        (0.01, "'reference y0' acts directly on 'weighted error y0', out of reach of the controls"),
        (3.0, "samples: the loop is unstable with one sample of delay"),
    ],
)
def test_useless_designs_say_what_they_are(torque, text):
    """A level that is the reference's feedthrough, and a loop that one sample of delay makes unstable.

    Both cancel the zero at -1 that the samples of the double integrator have, and ring between them.
    """
    P = GeneralizedPlant.tracking(c2d(DOUBLE, 0.5), Wproc=torque, Wdist=1e-3, Werr=10.0, Wact=1e-3, Wr=1.0)
    design = hinfsyn(P)
    kept = margins(P0(P), design.controller, sign=1)
    assert (design.margins.gain_db, design.margins.delay) == (kept.gain_db, kept.delay)
    (ripple,) = (w for w in design.warnings if w.startswith("between the samples the norm is"))
    (warning,) = (w for w in design.warnings if w != ripple)
    assert text in warning
    for told in (warning, ripple):
        assert told in repr(design)
        assert told in design.facts["warnings"]


def P0(P: GeneralizedPlant) -> StateSpace:
    """From u to y."""
    return StateSpace(P.A, P.B2, P.C2, P.D22, P.dt)


def test_a_good_design_warns_of_nothing():
    design = ncfsyn(c2d(DOUBLE, 0.1), 1.0)
    assert design.warnings == ()
    assert "warning" not in repr(design)
    assert "disk" in repr(design)


def test_a_pole_that_only_rounding_placed_is_told():
    """An integrator that z does not see, beside one that it does."""
    P = GeneralizedPlant(
        np.zeros((2, 2)), np.hstack([np.eye(2), np.zeros((2, 2))]), np.eye(2), [[1.0, 0], [0, 0], [0, 0]],
        np.zeros((3, 4)), [[0, 0], [1.0, 0], [0, 1.0]], np.eye(2), np.hstack([np.zeros((2, 2)), np.eye(2)]),
        np.zeros((2, 2)),
    )  # fmt: skip
    design = hinfsyn(P, method="riccati")
    assert design.info.slowest == pytest.approx(-design.closed_loop.poles().real.max(), rel=1e-6)
    assert design.info.slowest > 1e-3 or any("rounding placed it" in text for text in design.info.warnings)
    healthy = hinfsyn(cubesat_pecorilla2024())
    assert healthy.info.slowest > 1e-3
    assert healthy.info.warnings == ()


def unsealed(design):
    return {key: value for key, value in to_dict(design).items() if key not in ("sha256", "parts_sha256")}


def test_files_of_version_1_are_read(tmp_path):
    design = hinfsyn(cubesat_pecorilla2024(), method="lmi")
    data = unsealed(design)
    info = {key: value for key, value in data["info"].items() if key not in ("optimum", "slowest", "warnings")}
    data |= {"format_version": 1, "gamma": design.info.optimum, "info": info | {"gamma_min": None}}
    (tmp_path / "old.json").write_text(json.dumps(data))
    again = Design.load(tmp_path / "old.json")
    assert (again.gamma, again.info.optimum) == (design.gamma, design.info.optimum)
    shaped = ncfsyn(DOUBLE)
    data = unsealed(shaped)
    info = {key: value for key, value in data["info"].items() if key not in ("optimum", "slowest", "warnings")}
    data |= {"format_version": 1, "gamma": shaped.info.level, "info": info | {"gamma_min": shaped.info.optimum}}
    (tmp_path / "old.json").write_text(json.dumps(data))
    again = Design.load(tmp_path / "old.json")
    assert (again.gamma, again.info.optimum, again.info.level) == (shaped.gamma, shaped.info.optimum, shaped.info.level)


def test_a_false_optimum_is_refuted_by_proof():
    """The Riccati equations claim .447 here; nothing goes below 28.1754, which the design reaches."""
    design = hinfsyn(drawn(24))
    assert design.certify().lower <= design.info.optimum * (1 + 1e-3)
    assert design.info.optimum == pytest.approx(design.gamma, rel=1e-3)
    assert not any("claims an optimum" in warning for warning in design.warnings)
