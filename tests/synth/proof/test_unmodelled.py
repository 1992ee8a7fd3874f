"""Unmodelled dynamics beside uncertain parameters: the channel they see, and gains that hold with all of them."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import synth
from synth import ModelError, UncertainSystem, ultidyn, ureal, worst_gain


def spinning_satellite() -> UncertainSystem:
    """MathWorks, page `wcdiskmargin`: dynamics at the plant's input, then channel one cut for a disk margin.

    From (d, e) to (u, S - 1/2): y = P (u + d), u = K (e - y).
    """
    p = ureal("p", 10.0, percentage=10)
    I, e = np.eye(2), np.array([[1.0], [0.0]])
    A, C1 = np.array([[-0.2, p], [-p, -0.2]], object), np.array([[1, p], [-p, 1]], object)
    B = np.hstack([I, np.zeros((2, 1)), I])
    C = np.vstack([np.zeros((2, 2)), -C1[:1], -C1])
    D = np.block([[np.zeros((2, 3)), I], [np.array([[0, 0, 0.5, 0, 0]])], [np.zeros((2, 2)), e, np.zeros((2, 2))]])
    return UncertainSystem(None, A, B, C, D).lft(np.array([[1.0, -2.0], [0.0, 1.0]]))


def part(M: UncertainSystem, rows: slice, columns: slice) -> UncertainSystem:
    return UncertainSystem(M.E, M.A, M.B[:, columns], M.C[rows], M.D[rows, columns], M.dt)


def closed(H: synth.StateSpace, delta: synth.StateSpace) -> synth.StateSpace:
    """H with dynamics from its first outputs to its first inputs."""
    p, m = delta.ny, delta.nu
    rows, columns = [*range(m, H.ny), *range(m)], [*range(p, H.nu), *range(p)]
    turned = synth.StateSpace(H.A, H.B[:, columns], H.C[rows], H.D[np.ix_(rows, columns)], H.dt)
    return synth.lft(turned, delta)


def test_dynamics_in_the_loop_of_mathworks():
    """`wcdiskmargin` has a margin of 0.6147 .. 0.6160 with both: 1 / gain. A constant scaling proves less of it."""
    M = spinning_satellite()
    found = worst_gain(M, dynamics=ultidyn("DEL", (2, 2), bound=0.1))
    assert 1 / 0.6160 < found.upper < 1 / 0.39
    found.certificate.check()
    assert found.lower == pytest.approx(worst_gain(part(M, slice(2, 3), slice(2, 3))).lower)
    assert "constant scaling" in found.note
    small = worst_gain(M, dynamics=ultidyn("DEL", (2, 2), bound=1e-6))
    assert small.upper == pytest.approx(found.lower, rel=1e-2)


@settings(max_examples=5, deadline=None)
@given(st.integers(0, 1000))
def test_no_dynamics_contradict_the_gain(seed):
    M, bound = spinning_satellite(), 0.1
    upper = UPPER.setdefault(bound, worst_gain(M, dynamics=ultidyn("DEL", (2, 2), bound=bound), tol=1e-3).upper)
    for k, (_, H) in enumerate(M.sample(4, seed)):
        rng = np.random.default_rng([seed, k])
        U, _, V = np.linalg.svd(rng.normal(size=(2, 2)))
        loop = closed(H, synth.StateSpace.gain(bound * U @ V, 0.0))
        assert loop.poles().real.max() < 0
        assert synth.hinfnorm(loop)[0] < upper


UPPER: dict[float, float] = {}


def test_the_channel_alone_decides_stability_and_a_counterexample_reaches_it():
    M = spinning_satellite()
    channel = part(M, slice(0, 2), slice(0, 2))
    found = worst_gain(channel, dynamics=ultidyn("DEL", (2, 2), bound=0.1))
    assert found.upper < 1
    H = channel.at(found.parameters)
    assert found.frequency == pytest.approx(0, abs=1e-3)
    U, s, V = np.linalg.svd(H.matrices.at(0.0).real)
    destabilising = V[:1].T @ U[:, :1].T / s[0]
    assert np.linalg.norm(destabilising, 2) == pytest.approx(0.1 / found.lower, rel=1e-6)
    pole = np.linalg.eigvals(H.A + H.B @ np.linalg.solve(np.eye(2) - destabilising @ H.D, destabilising @ H.C))
    assert np.abs(pole).min() < 1e-6
    unstable = worst_gain(M, dynamics=ultidyn("DEL", (2, 2), bound=0.12))
    assert (unstable.lower, unstable.certificate) == (np.inf, None)
    assert "not stable for all 'DEL'" in unstable.note


def test_a_weight_says_where_dynamics_are():
    """Nothing at low frequencies, where the loop needs its gain."""
    k = ureal("k", 1.0, percentage=20)
    G = UncertainSystem(A=[[0, 1], [0, -2]], B=[[0, 0], [k, k]], C=[[0, 0], [-1, 0]], D=[[0, 1], [0, 0]])
    M = G.lft(synth.system([4.0], [1.0]))  # from d to u, u = -4 y
    free, weighted = (worst_gain(M, dynamics=ultidyn("flex", weight=W)) for W in (None, synth.system([1, 0], [1, 20])))
    assert free.lower > 1 > weighted.upper
    assert worst_gain(M, dynamics=ultidyn("flex", bound=0.5)).upper == pytest.approx(free.upper / 2, rel=1e-4)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda M: worst_gain(M, dynamics=[ultidyn("a"), ultidyn("b")]), "mussv"),
        (lambda M: worst_gain(M, dynamics=ultidyn("a", (5, 1))), "3 inputs"),
        (lambda M: worst_gain(M, dynamics=0.1), "ultidyn"),
        (lambda M: ultidyn("a", bound=0.0), "bound"),
        (lambda M: ultidyn("a", weight=synth.system([1], [1, -1])), "not stable"),
        (lambda M: ultidyn("a", weight=np.eye(2)), "2 x 2"),
        (lambda M: ultidyn("", (1, 1)), "name"),
    ],
)
def test_what_is_wrong_is_named(call, message):
    with pytest.raises(ModelError, match=message):
        call(spinning_satellite())
