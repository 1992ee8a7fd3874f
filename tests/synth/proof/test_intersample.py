"""The norm between the samples, proved: levels above it are, levels below it are not, and nothing tampered with is."""

import json
from dataclasses import replace

import numpy as np
import pytest
from fastsampling import fast_sampled, random_loop
from tampering import tampered

from synth import (
    Certificate,
    GeneralizedPlant,
    ModelError,
    StateSpace,
    SynthError,
    VerificationError,
    c2d,
    hinfnorm,
    hinfsyn,
    sdhinfnorm,
    sdhinfsyn,
    system,
)
from synth.analysis.sampleddata import lifted
from synth.proof import intersample
from synth.proof.certify import certify
from synth.systems.connect import input_delay

BITS = (128, 512)


def prove(P: GeneralizedPlant, K: StateSpace, delay: float, levels, bits=BITS):
    return intersample.prove(lifted(P, K.dt, delay, None, noisy=True), K, levels, bits)


def find(P: GeneralizedPlant, K: StateSpace, delay: float, level: float, bits: int = 512):
    return intersample.find(lifted(P, K.dt, delay, None, noisy=True), K, level, bits)


H = 2.0  # s


def variant(seed: int):
    """A random loop, with direct terms, a late hold and a held w in turn; (P, K, delay, held)."""
    P, K = random_loop(seed, n=2 + seed % 3, m=1 + seed % 2, p=1 + seed // 2 % 2)
    rng = np.random.default_rng(seed)
    _, _, m, _, p = P.sizes
    if seed % 5 == 1:
        P = replace(P, D11=0.3 * rng.normal(size=(2, 2)))
    if seed % 4 > 1:
        P = replace(P, D21=np.hstack([np.zeros((p, 1)), rng.normal(size=(p, 1))]))
    if seed % 5 == 0:
        P = replace(P, D22=0.05 * rng.normal(size=(p, m)))
    return P, K, K.dt * (seed % 3) / 4, (1,) if seed % 4 > 1 else ()


def checked_on_both_sides(P: GeneralizedPlant, K: StateSpace, delay: float = 0.0, held=()) -> None:
    """A millionth above the norm is proved, and proved again; what is below it is not."""
    found = sdhinfnorm(P, K, delay=delay, held=list(held) or None)
    if not np.isfinite(found.upper):
        with pytest.raises(VerificationError, match="finite"):
            prove(P, K, delay, [])
        return
    for above in (1e-6, 1e-3):
        proved = prove(P, K, delay, [found.upper * (1 + above)])
        assert proved.is_proved(K)
        for level in (found.lower * (1 - 1e-6), 0.5 * found.lower):
            assert not replace(proved, upper=level).is_proved(K)
    for below in (1e-6, 1e-3, 0.5):
        assert find(P, K, delay, found.lower * (1 - below), 128) is None


@pytest.mark.parametrize("seed", range(16))
def test_levels_above_the_norm_are_proved_and_those_below_are_not(seed):
    checked_on_both_sides(*variant(seed))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(100, 150))
def test_levels_above_the_norm_are_proved_and_those_below_are_not_on_fifty_loops(seed):
    checked_on_both_sides(*variant(seed))


@pytest.mark.parametrize("seed", range(8))
def test_what_is_proved_is_above_brute_force(seed):
    """Every hold of w over parts of a period is a w, and shares nothing with the proof."""
    P, K, delay, held = variant(seed)
    brute = hinfnorm(fast_sampled(P, K, 16, late=round(16 * delay / K.dt), held=held))[0]
    if np.isfinite(brute):
        assert prove(P, K, delay, []).upper > brute


@pytest.mark.parametrize(("condition", "known"), [(1e4, 1e-6), (1e6, 1e-3)])
@pytest.mark.parametrize("seed", range(4))
def test_neither_coordinates_nor_units_matter(seed, condition, known):
    """In bad ones the plant's doubles, another plant then, and the norm in doubles have fewer digits; proofs do not."""
    P, K = random_loop(seed, n=4)
    rng = np.random.default_rng(seed)
    t, a, b, c = 10.0 ** rng.uniform(-3, 3, 4)
    T = np.geomspace(condition**-0.5, condition**0.5, 4)[:, None] * np.linalg.qr(rng.normal(size=(4, 4)))[0]
    Ti = np.linalg.inv(T)
    moved = replace(
        P, A=Ti @ P.A @ T / t, B1=Ti @ P.B1 / t, B2=Ti @ P.B2 * a / t, C1=c * P.C1 @ T, D12=c * a * P.D12,
        C2=b * P.C2 @ T,
    )  # fmt: skip
    Km = StateSpace(K.A, K.B / b, K.C / a, K.D / a / b, K.dt * t)
    norm = c * sdhinfnorm(P, K, delay=0.3 * K.dt).upper
    proved = prove(moved, Km, 0.3 * Km.dt, [norm * (1 + known)])
    assert proved.is_proved(Km)
    assert find(moved, Km, 0.3 * Km.dt, norm * (1 - 2 * known)) is None
    assert not replace(proved, upper=norm * (1 - 2 * known)).is_proved(Km)


@pytest.mark.parametrize("rate", [1e3, 1e6, 1e9, 1e12])
def test_an_actuator_that_is_ever_faster(rate):
    P, K = random_loop(1)
    lagged = replace(
        P, A=np.block([[P.A, P.B2], [np.zeros((1, 3)), -rate * np.eye(1)]]), B1=np.vstack([P.B1, np.zeros((1, 2))]),
        B2=[[0], [0], [0], [rate]], C1=np.hstack([P.C1, P.D12]), D12=0 * P.D12, C2=np.hstack([P.C2, [[0]]]),
    )  # fmt: skip
    checked_on_both_sides(lagged, K)


@pytest.mark.parametrize("h", [1e-6, 1e-2, 1.0, 1e2, 1e6])
def test_the_gain_within_a_period_is_that_of_continuous_time_where_control_does_nothing(h):
    """The longer the period the nearer is the norm to what a w within one period reaches."""
    rng = np.random.default_rng(3)
    A = rng.normal(size=(4, 4))
    A -= (np.linalg.eigvals(A).real.max() + 0.3) * np.eye(4)
    G = StateSpace(A, rng.normal(size=(4, 2)), rng.normal(size=(2, 4)), 0.2 * rng.normal(size=(2, 2)))
    Z = np.zeros
    P = GeneralizedPlant(A=G.A, B1=G.B, B2=Z((4, 1)), C1=G.C, D11=G.D, D12=Z((2, 1)), C2=G.C[:1], D21=Z((1, 2)), D22=0)
    K, norm = system([[0.0]], dt=h), hinfnorm(G)[0]
    assert prove(P, K, 0.4 * h, [norm * (1 + 1e-6)]).is_proved(K)
    assert find(P, K, 0.4 * h, norm * (1 - 1e-6)) is None


@pytest.mark.parametrize(("h", "low", "high"), [(0.75, 3.7908, 3.7929), (0.2, 1.0044, 1.0049)])
def test_the_example_of_matlabs_documentation(h, low, high):
    """https://www.mathworks.com/help/robust/ref/dynamicsystem.sdhinfnorm.html."""
    p = system([30], [1, 30, 0])
    G = StateSpace(p.A, np.hstack([p.B, p.B]), np.vstack([p.C, p.C]), np.zeros((2, 2)))
    P, K = GeneralizedPlant.partition(G, 1, 1), system(-c2d(system([4], [1, 4]), h))
    assert low < prove(P, K, 0.0, []).upper < high
    with pytest.raises(VerificationError, match=f"below {low}"):
        prove(P, K, 0.0, [low])


def satellite() -> GeneralizedPlant:
    """One axis of a satellite with a panel (1.2 rad/s, 0.5 % damping): z = [kp angle; u/2], noise of a sample."""
    J, coupling, w, damping = 500.0, 14.0, 1.2, 0.005
    M = np.array([[J, coupling], [coupling, 1.0]])
    stiff, damped, torque = np.diag([0, w**2]), np.diag([0, 2 * damping * w]), np.array([[1.0], [0.0]])
    Z, I = np.zeros, np.eye
    A = np.block([[Z((2, 2)), I(2)], [-np.linalg.solve(M, stiff), -np.linalg.solve(M, damped)]])
    B = np.vstack([Z((2, 1)), np.linalg.solve(M, torque)])
    return GeneralizedPlant(
        A=A, B1=np.hstack([B, Z((4, 1))]), B2=B, C1=np.vstack([J * 0.1**2 * I(4)[:1], Z((1, 4))]), D11=Z((2, 2)),
        D12=[[0], [0.5]], C2=I(4)[:1], D21=[[0, 0.01 * H**0.5]], D22=0,
    )  # fmt: skip


@pytest.fixture(scope="module")
def design():
    return hinfsyn(c2d(satellite(), H))


@pytest.fixture(scope="module")
def certificate(design) -> Certificate:
    return design.certify(delay=0.3)


def test_the_certificate_of_a_flexible_satellite(design, certificate, tmp_path):
    between = design.certify().intersample
    assert design.intersample.lower < between.upper < design.intersample.upper * (1 + 1e-6)
    assert certificate.intersample.upper > sdhinfnorm(satellite(), design.controller, delay=0.3, held=[1]).lower
    assert "between the samples too" in certificate.statement
    again = Certificate.load(certificate.save(tmp_path / "c.json"))
    assert again.statement == certificate.statement
    again.check()
    again.check(design.plant, design.controller)


def test_a_design_between_the_samples_is_proved_to_be_one():
    found = sdhinfsyn(satellite(), H)
    proved = found.certify(intersample=found.gamma * (1 + 1e-6), upper=0.77)
    assert proved.intersample.upper == found.gamma * (1 + 1e-6)
    with pytest.raises(VerificationError, match="between the samples"):
        found.certify(intersample=found.intersample.lower * (1 - 1e-6))


@pytest.mark.parametrize(
    "change",
    [
        lambda c, P: replace(c, upper=c.upper * (1 - 1e-5)),
        lambda c, P: replace(c, upper=np.nan),
        lambda c, P: replace(c, upper=-c.upper),
        lambda c, P: replace(c, delay=0.31),
        lambda c, P: replace(c, delay=2.1),
        lambda c, P: replace(c, delay=-0.1),
        lambda c, P: replace(c, held=()),
        lambda c, P: replace(c, held=(1, 1)),
        lambda c, P: replace(c, held=(-1,)),
        lambda c, P: replace(c, held=(0, 1)),
        lambda c, P: replace(c, bits=53),
        lambda c, P: replace(c, plant=replace(P, A=P.A * (1 - 1e-4))),
        lambda c, P: replace(c, plant=replace(P, C1=P.C1 * (1 + 1e-5))),
        lambda c, P: replace(c, plant=replace(P, dt=2.0)),
        lambda c, P: replace(c, states=c.states * 2),
        lambda c, P: replace(c, states=np.zeros_like(c.states)),
        lambda c, P: replace(c, states=c.states[:3]),
        lambda c, P: replace(c, constants=c.constants[:1]),
        lambda c, P: replace(c, constants=0 * c.constants),
        lambda c, P: replace(c, witness=replace(c.witness, rate=-1.0)),
        lambda c, P: replace(c, witness=replace(c.witness, T=c.witness.T[::-1].copy())),
        lambda c, P: replace(c, witness=replace(c.witness, factor=0 * c.witness.factor)),
    ],
)
def test_a_claim_or_witness_that_was_changed_proves_nothing(design, certificate, change):
    forged = replace(certificate, intersample=change(certificate.intersample, satellite()))
    with pytest.raises(VerificationError, match="between the samples"):
        forged.check()
    with pytest.raises(VerificationError, match="between the samples"):
        forged.check(design.plant, design.controller)


def test_another_controller_or_period_proves_nothing(design, certificate):
    K = design.controller
    for other in (replace(K, D=K.D + 1e-2), replace(K, C=-K.C), replace(K, dt=2.1), replace(K, dt=1.0)):
        assert not certificate.intersample.is_proved(other)


@pytest.mark.parametrize("seed", range(40))
def test_no_file_that_was_tampered_with_is_proved_again(certificate, tmp_path, seed):
    """What is read differs from what was written, or the proof does not hold."""
    data = json.loads(certificate.save(tmp_path / "c.json").read_text())
    forged = tampered(data, np.random.default_rng(seed))
    if forged in (None, data):
        return
    (tmp_path / "c.json").write_text(json.dumps(forged))
    with pytest.raises(SynthError):
        Certificate.load(tmp_path / "c.json").check()


def test_what_remembers_no_continuous_plant_is_told_so(design):
    forgetful = hinfsyn(replace(design.plant, continuous=None))
    assert forgetful.certify().intersample is None
    for asked in ({"intersample": 2.0}, {"delay": 0.1}):
        with pytest.raises(ModelError, match="remembers what c2d sampled"):
            certify(forgetful, **asked)


def test_a_hold_that_is_late_by_more_than_a_sample(design):
    """The whole samples are in front of the hold: as those in the controller."""
    K = design.controller
    slow = hinfsyn(c2d(satellite(), H, delay=[0, 0, 2.5]))
    assert slow.plant.delay == 2.5
    proved = slow.certify(upper=10).intersample
    assert (proved.samples, proved.delay) == (1, pytest.approx(0.5))
    assert "u 1 samples and 0.5 s after the sample" in proved.statement
    norm = sdhinfnorm(satellite(), input_delay(slow.controller, H), delay=0.5, held=[1])
    assert norm.lower < proved.upper < norm.upper * (1 + 1e-5)
    assert slow.intersample.upper == pytest.approx(norm.upper, rel=1e-6)
    with pytest.raises(VerificationError, match="finite"):
        certify(design, delay=7.0)
    for late in (3.0, 4.0):
        found = sdhinfnorm(satellite(), input_delay(K, H), delay=late - H, held=[1])
        if np.isfinite(found.upper):
            assert found.lower < design.certify(delay=late).intersample.upper < found.upper * (1 + 1e-5)
