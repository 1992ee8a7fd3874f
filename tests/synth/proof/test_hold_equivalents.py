"""Loops of plants sampled with a hold: bounds hold of the exact one, and certificates prove all of it again."""

import hashlib
import json

import numpy as np
import pytest

import synth
from synth import UncertainSystem, VerificationError, stability_margin, ureal, worst_gain
from synth.proof.boxcertificate import BoxCertificate, from_dict, to_dict

DT = 0.5
K = synth.system([0.1], [1, -0.3], dt=DT)


def plant(percentage: float = 20.0) -> UncertainSystem:
    """A lightly damped oscillator: from torque and control to angle, twice."""
    J, w = ureal("J", 5.0, percentage=percentage), ureal("w", 2.0, percentage=percentage)
    return UncertainSystem([[1, 0], [0, J]], [[0, 1], [-5 * w * w, -0.2 * w]], [[0, 0], [1, 1]], [[1, 0], [1, 0]])


@pytest.fixture(scope="module")
def loop() -> UncertainSystem:
    return synth.c2d(plant(), DT).close(K)


@pytest.fixture(scope="module")
def proved(loop):
    return worst_gain(loop, tol=1e-4)


def exact(values: dict) -> synth.StateSpace:
    return synth.lft(synth.c2d(plant().at(values), DT), K)


def test_no_exact_hold_contradicts_the_gain(loop, proved):
    assert proved.gap < 1e-3
    assert exact(proved.parameters).poles().size
    assert synth.hinfnorm(exact(proved.parameters))[0] >= proved.lower * (1 - 1e-9)
    assert max(synth.hinfnorm(exact(v))[0] for v, _ in loop.sample(100)) <= proved.upper


@pytest.mark.slow
def test_a_coarser_polynomial_makes_the_bound_wider_and_no_less_true(proved):
    coarse = synth.c2d(plant(), DT, tol=1e-5).close(K)
    found = worst_gain(coarse, tol=1e-4)
    assert found.upper >= proved.lower
    assert found.gap >= proved.gap * 0.9


def test_no_exact_hold_contradicts_a_disk_margin():
    H = synth.c2d(plant(10.0), DT)
    L = synth.series(UncertainSystem(H.E, H.A, H.B[:, 1:], H.C[1:], H.D[1:, 1:], H.dt), K)
    kept = synth.diskmargin(L, 1)
    for _, G in plant(10.0).sample(10):
        one = synth.c2d(G, DT)
        cut = synth.series(synth.StateSpace(one.A, one.B[:, 1:], one.C[1:], 0, DT), K)
        assert synth.diskmargin(cut, 1).alpha >= kept.alpha


def test_the_margin_ends_where_the_hold_was_made_for(loop):
    found = stability_margin(loop)
    assert found.lower == 1.0
    assert "wider ranges before c2d" in found.note
    found.certificate.check(loop)


@pytest.mark.slow
def test_the_margin_of_a_box_inside_goes_beyond_it():
    inner = synth.c2d(plant(40.0), DT).with_ranges(list(plant(20.0).parameters.values())).close(K)
    assert stability_margin(inner, tol=1e-2).lower > 1.5


def test_the_certificate_proves_the_remainder_again(loop, proved, tmp_path):
    found = BoxCertificate.load(proved.certificate.save(tmp_path / "c.json"))
    found.check(loop)


def _hold(data):
    return data["system"]["holds"][0]


@pytest.mark.parametrize(
    "change",
    [
        lambda d: _hold(d)["remainders"][0].update(size=_hold(d)["remainders"][0]["size"] / 10),
        lambda d: [r.update(size=r["size"] / 1e6) for r in _hold(d)["remainders"]],
        lambda d: d["system"]["A"][0][3][0].__setitem__(0, 0.4),
        lambda d: _hold(d)["parameters"][1].update(high=2.9),
        lambda d: _hold(d).update(dt=0.25),
        lambda d: _hold(d).update(name="hold 0"),
        lambda d: _hold(d)["A"][1].__setitem__(0, -21.0),
        lambda d: d["system"].pop("holds"),
        lambda d: _hold(d)["remainders"].pop(),
        lambda d: d.pop("degrees"),
        lambda d: d.update(degrees=[1, 1]),
        lambda d: d.update(degrees=[]),
        lambda d: d.update(level=d["level"] * 0.999),
    ],
)
def test_whoever_changes_hold_or_remainder_has_to_prove_it(proved, change):
    data = json.loads(json.dumps(to_dict(proved.certificate)))
    change(data)
    rest = {key: value for key, value in data.items() if key != "sha256"}
    rest["sha256"] = hashlib.sha256(json.dumps(rest).encode()).hexdigest()
    with pytest.raises((VerificationError, synth.ModelError)):
        from_dict(rest).check()


def flexible(percentage: float, damping: float = 0.005) -> UncertainSystem:
    """A hub with one bending mode, inertia and frequency uncertain; criterion as of `examples/flexible`."""
    J, w = ureal("J", 500.0, percentage=percentage), ureal("w", 1.2, percentage=percentage)
    E = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, J, 14], [0, 0, 14, 1]]
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [0, 0, 0, 0], [0, -(w * w), 0, -2 * damping * w]]
    B = [[0, 0, 0], [0, 0, 0], [5, 0, 500], [0, 0, 0]]
    C = [[1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]]
    return UncertainSystem(E, A, B, C, [[0, 0, 0], [0, 0, 50], [0, 0.05, 0]])


@pytest.mark.slow
@pytest.mark.parametrize(("dt", "percentage"), [(0.1, 20.0), (0.1, 5.0)])
def test_a_flexible_satellite_with_a_sampled_design(dt, percentage):
    """H-infinity design for a damped model, sampled; two channels, twice the noise."""
    G, model = flexible(percentage), flexible(percentage, 0.7).nominal
    noisy = synth.StateSpace(model.A, model.B * [1, 2, 1], model.C, model.D * [1, 2, 1], 0)
    K = synth.hinfsyn(synth.c2d(noisy, dt), 1, 1).controller
    found = worst_gain(synth.c2d(G, dt, tol=1e-12).close(K), tol=1e-3)
    assert found.gap < 2e-3
    found.certificate.check()
    norms = [synth.hinfnorm(synth.lft(synth.c2d(H, dt), K))[0] for _, H in G.sample(200)]
    assert found.lower * 0.9 < max(norms) < found.upper


def test_what_cannot_be_proved_is_said_and_nothing_is_claimed():
    J, w = ureal("J", 5.0, percentage=70), ureal("w", 2.0, percentage=20)
    E, A = [[1, 0], [0, J]], [[0, 1], [-5 * w * w, -2 * w]]
    G = UncertainSystem(E, A, [[0, 0], [1, 1]], [[1, 0], [1, 0]])
    found = worst_gain(synth.c2d(G, DT, tol=1e-6).close(K), tol=1e-3, boxes=2000)
    assert (found.upper, found.certificate) == (np.inf, None)
    assert "was not proved" in found.note
