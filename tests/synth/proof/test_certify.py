"""Certificates: enclosures of known optima, and that nothing false can be proved or slipped in."""

import json
from dataclasses import replace

import numpy as np
import pytest
from literature import GAMMA_PECORILLA2024, compleib, cubesat_pecorilla2024, mass_spring_chain, random_plant

from synth.analysis.norms import hinfnorm
from synth.errors import ModelError, VerificationError
from synth.proof.balls import Coupling, Impulse, Step, proves_lower
from synth.proof.certify import Certificate, certify
from synth.synthesis.design import Design
from synth.synthesis.hinfinity import hinfsyn
from synth.synthesis.loopshaping import ncfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

PROVED_PECORILLA2024 = (4.1579245945e-6, 4.157929852e-6)  # both bounds proved with semidefinite programmes


@pytest.fixture(scope="module")
def design() -> Design:
    return hinfsyn(cubesat_pecorilla2024(), method="riccati")


@pytest.fixture(scope="module")
def certificate(design) -> Certificate:
    return design.certify()


@pytest.mark.parametrize("factor", [1e-3, 1.0, 1e3])
def test_cubesat_is_enclosed_with_every_scaling(factor):
    design = hinfsyn(cubesat_pecorilla2024(factor), method="riccati")
    c = design.certify()
    assert c.lower < GAMMA_PECORILLA2024 * factor**2 < c.upper
    assert c.gap < 1.2e-5
    assert c.lower < PROVED_PECORILLA2024[1] * factor**2  # two proofs cannot exclude each other
    assert c.upper > PROVED_PECORILLA2024[0] * factor**2
    c.check(design.plant, design.controller)


@pytest.mark.parametrize("method", ["lmi", "standard", "extended"])
def test_designs_by_linear_matrix_inequalities_are_certified_too(method):
    c = hinfsyn(cubesat_pecorilla2024(), method=method).certify()
    assert c.lower < GAMMA_PECORILLA2024 < c.upper
    assert c.gap < 1e-3


@pytest.mark.parametrize("n", [4, 8, 20])
def test_chains(n):
    design = hinfsyn(mass_spring_chain(n), method="riccati")
    c = certify(design)
    assert c.lower < design.gamma <= design.verified_norm < c.upper
    assert c.gap < 1.2e-5
    c.check(design.plant, design.controller)


def random_design(seed: int) -> Design:
    rng = np.random.default_rng(seed)
    n, nu, ny = rng.integers(2, 8), rng.integers(1, 4), rng.integers(1, 4)
    nz, nw = nu + rng.integers(0, 3), ny + rng.integers(0, 3)  # square D12 and D21 among them
    deficient = ("none", "none", "D12", "D21", "both")[seed % 5]
    P = random_plant(seed, n, nw, nu, nz, ny, direct=bool(rng.integers(2)), deficient=deficient)
    return hinfsyn(P, method="riccati")


@pytest.mark.parametrize("seed", range(10))
def test_random_plants_are_enclosed_and_contradictions_are_refused(seed):
    """Square and rank-deficient D12 and D21 among them; what one bound proves the other one cannot deny."""
    design = random_design(seed)
    c = certify(design)
    c.check(design.plant, design.controller)
    assert 0 < c.lower < c.upper
    assert c.gap < 2e-4
    assert hinfnorm(design.closed_loop)[0] < c.upper
    with pytest.raises(VerificationError, match="no controller reaches"):
        certify(design, lower=c.upper)
    with pytest.raises(VerificationError, match="norm is below"):
        certify(design, upper=c.lower)


def test_bounds_that_were_asked_for_and_are_false_by_a_millionth(design):
    peak = hinfnorm(design.closed_loop)[0]
    assert certify(design, upper=peak * (1 + 1e-6), lower=4.15792e-6).upper == peak * (1 + 1e-6)
    with pytest.raises(VerificationError, match="norm is below"):
        certify(design, upper=peak * (1 - 1e-6))
    assert certify(design, lower=GAMMA_PECORILLA2024 * (1 - 1e-6)).lower == GAMMA_PECORILLA2024 * (1 - 1e-6)
    with pytest.raises(VerificationError, match="no controller reaches"):
        certify(design, lower=GAMMA_PECORILLA2024 * (1 + 1e-6))


def with_direct_term(D11: list[list[float]]) -> GeneralizedPlant:
    """An unstable first-order plant that is easily controlled, so that part of D11 decides."""
    D12, D21 = np.zeros((len(D11), 1)), np.zeros((1, len(D11[0])))
    D12[-1], D21[0, -1] = 0.1, 0.1
    B1, C1 = 1e-2 * np.ones((1, len(D11[0]))), 1e-2 * np.ones((len(D11), 1))
    one = np.ones((1, 1))
    return GeneralizedPlant(1.1 * one, B1, one, C1, np.array(D11), D12, one, D21, 0.3 * one, 1.0)


@pytest.mark.parametrize(
    ("D11", "dual"),
    [([[3.0, 4.0], [0.0, 0.0]], False), ([[3.0, 0.0], [4.0, 0.0]], True)],
    ids=["control", "estimation"],
)
def test_one_side_alone_decides(D11, dual):
    """What the direct term passes from all w to the first z (or back) is out of reach: 5 by Pythagoras."""
    design = hinfsyn(with_direct_term(D11), method="riccati")
    c = certify(design)
    c.check(design.plant, design.controller)
    assert isinstance(c.lower_witness.end, Impulse)
    assert c.lower_witness.end.dual == dual
    assert 5 * (1 - 1e-3) < c.lower < c.upper < 5.2


def test_continuous_plant_through_cayley():
    P, reference = compleib()["ac5"]
    design = hinfsyn(P, method="riccati")
    c = certify(design)
    c.check(P, design.controller)
    assert c.lower < reference * (1 + 1e-5)
    assert c.gap < 1e-4
    assert c.upper_witness.rate > 0


def test_zero_on_the_stability_boundary_gets_no_lower_bound_and_says_so():
    P, _ = compleib()["ac2"]
    design = hinfsyn(P, method="riccati")
    c = certify(design)
    assert c.lower == 0
    assert c.gap == np.inf
    assert "no lower bound proved (no strict inequality" in c.statement
    c.check(P, design.controller)
    with pytest.raises(VerificationError, match="without a witness"):
        replace(c, lower=0.05).check(P, design.controller)
    with pytest.raises(VerificationError, match="stability boundary"):
        certify(design, lower=0.1)


def test_loop_shaping_designs_certify_the_shaped_plant():
    G = StateSpace([[1.0, 0.1], [0.0, 1.0]], [[0.005], [0.1]], [[1.0, 0.0]], [[0.0]], 0.1)
    design = ncfsyn(G)
    c = certify(design)
    c.check(design.plant, design.shaping.Ks)
    assert c.lower <= c.upper
    assert c.upper < 1.01 * design.verified_norm


def destabilised(K: StateSpace) -> StateSpace:
    return StateSpace(K.A, K.B, -K.C, K.D, K.dt)


def test_another_plant_or_controller_is_refused(design, certificate):
    P, K = design.plant, design.controller
    bent = StateSpace(K.A, K.B, K.C * (1 + 2e-16), K.D, K.dt)  # one bit
    with pytest.raises(VerificationError, match="another controller"):
        certificate.check(P, bent)
    with pytest.raises(VerificationError, match="another plant"):
        certificate.check(replace(P, D11=P.D11 * (1 + 2e-16)), K)


def test_hashes_that_were_changed_as_well_do_not_help(design, certificate):
    P, K = design.plant, design.controller
    wrong = destabilised(K)
    forged = replace(certificate, controller_sha256=wrong.digest())
    with pytest.raises(VerificationError, match="does not prove that the norm"):
        forged.check(P, wrong)
    louder = replace(P, B1=P.B1 * (1 + 1e-4))
    with pytest.raises(VerificationError, match="does not prove that the norm"):
        replace(certificate, plant_sha256=louder.system.digest()).check(louder, K)
    quieter = replace(P, B1=P.B1 * (1 - 1e-4), D11=P.D11 * (1 - 1e-4), D21=P.D21 * (1 - 1e-4))
    assert proves_lower(P, certificate.lower_witness, certificate.lower, 128)
    assert not proves_lower(quieter, certificate.lower_witness, certificate.lower, 128)


def bend_step(c: Certificate, **changes) -> Certificate:
    w = c.lower_witness
    return replace(c, lower_witness=replace(w, control=(*w.control[:-1], replace(w.control[-1], **changes))))


def bend_end(c: Certificate, **changes) -> Certificate:
    return replace(c, lower_witness=replace(c.lower_witness, end=replace(c.lower_witness.end, **changes)))


def bend_upper(c: Certificate, **changes) -> Certificate:
    return replace(c, upper_witness=replace(c.upper_witness, **changes))


@pytest.mark.parametrize(
    "bend",
    [
        lambda c: replace(c, lower=GAMMA_PECORILLA2024 * (1 + 1e-6)),
        lambda c: replace(c, lower=np.nan),
        lambda c: replace(c, upper=c.lower),
        lambda c: replace(c, upper=-c.upper),
        lambda c: bend_step(c, X=c.lower_witness.control[-1].X * 1.01),
        lambda c: bend_step(c, X=np.full_like(c.lower_witness.control[-1].X, np.nan)),
        lambda c: bend_step(c, F=0 * c.lower_witness.control[-1].F),
        lambda c: bend_step(c, after=np.zeros((0, 0))),
        lambda c: bend_end(c, v=c.lower_witness.end.v[::-1].copy()),
        lambda c: bend_end(c, shift=-c.lower_witness.end.shift),
        lambda c: bend_end(c, factor=np.zeros((6, 6))),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, estimation=c.lower_witness.control)),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, control=c.lower_witness.control[1:])),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, T=np.zeros((6, 6)))),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, z=-c.lower_witness.z)),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, rate=1.0)),
        lambda c: replace(c, lower_witness=replace(c.lower_witness, rate=-1.0)),
        lambda c: bend_upper(c, rate=1.0),
        lambda c: bend_upper(c, T=np.eye(12)),
        lambda c: bend_upper(c, T=np.eye(11)),
        lambda c: bend_upper(c, U=2 * c.upper_witness.U),
        lambda c: bend_upper(c, factor=0 * c.upper_witness.factor),
    ],
)
def test_a_claim_or_witness_that_was_changed_proves_nothing(design, certificate, bend):
    with pytest.raises(VerificationError, match="does not prove"):
        bend(certificate).check(design.plant, design.controller)


def test_a_disturbance_from_rest_is_no_way_around_the_coupling(design, certificate):
    """The CubeSat's optimum is one of coupling: on one side alone no impulse gains, whatever factor is claimed."""
    side = certificate.lower_witness.control
    for w in (np.eye(15)[0], np.eye(15)[7], np.zeros(15)):
        for factor in (np.eye(4), 1e3 * np.eye(4)):
            forged = replace(certificate.lower_witness, control=side, end=Impulse(w, False, factor))
            with pytest.raises(VerificationError, match="does not prove"):
                replace(certificate, lower_witness=forged).check(design.plant, design.controller)


def test_file_keeps_every_bit_of_the_witnesses(design, certificate, tmp_path):
    again = Certificate.load(certificate.save(tmp_path / "c.json"))
    assert (again.lower, again.upper, again.statement) == (certificate.lower, certificate.upper, certificate.statement)
    assert isinstance(again.lower_witness.end, Coupling)
    for a, b in zip(again.lower_witness.estimation, certificate.lower_witness.estimation, strict=True):
        assert all(np.array_equal(getattr(a, name), getattr(b, name)) for name in Step.__dataclass_fields__)
    again.check(design.plant, design.controller)
    with pytest.raises(ModelError, match=r"\.txt"):
        certificate.save(tmp_path / "c.txt")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.update(format="other"), "no certificate"),
        (lambda d: d.pop("upper"), "incomplete or damaged"),
        (lambda d: d.update(bits=2), "bits is 2"),
        (lambda d: d["upper_witness"].update(T=[[1.0], [2.0, 3.0]]), "incomplete or damaged"),
        (lambda d: d["lower_witness"].update(end={}), "incomplete or damaged"),
        (lambda d: d["lower_witness"]["end"].update(v=[[1.0]]), r"end\.v\[0\] is \[1\.0\]; a number belongs there"),
    ],
)
def test_a_damaged_file_is_named(certificate, tmp_path, change, message):
    path = certificate.save(tmp_path / "c.json")
    data = json.loads(path.read_text())
    change(data)
    path.write_text(json.dumps(data))
    with pytest.raises(ModelError, match=message):
        Certificate.load(path)
    path.write_text("{")
    with pytest.raises(ModelError, match="it is no JSON"):
        Certificate.load(path)


def test_statement_uses_the_words_exactly(certificate):
    assert "Proved in 128-bit ball arithmetic" in certificate.statement
    assert "no controller of any order" in certificate.statement
    assert repr(certificate.lower) in certificate.statement
    assert "optimal" not in certificate.statement
