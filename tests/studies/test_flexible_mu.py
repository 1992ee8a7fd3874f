"""mu of the flexible satellite; D-K iteration takes its frequencies for complex numbers, which no controller bears."""

import flexible as study
import flexible_designs as designs
import numpy as np
import pytest

from synth import StateSpace, lft, mussv, musyn, stability_margin

BLOCKS = [(-1, 0), (-2, 0), (-2, 0), (2, 2)]  # inertia, two frequencies of which squares enter, performance


def fractional(percentage: float) -> StateSpace:
    """Roll as a linear fractional form in J and w1, w2 within +- so many percent; last input u / J, last output angle.

    v = W (1 + r b) eta, f = W (1 + r b) (v + 2 z eta'); J (1 + r a) theta'' + d eta'' = tau, eta'' + d' theta'' + f = 0
    """
    r, W, J, k = percentage / 100, designs.FREQUENCIES, designs.ROLL, len(designs.FREQUENCIES)
    n, blocks = 1 + k, 1 + 2 * k
    M = np.eye(n)
    M[0, 0], M[0, 1:], M[1:, 0] = J, designs.COUPLINGS, designs.COUPLINGS
    force, changed, driven = np.zeros((n, 2 * n)), np.zeros((n, blocks)), np.zeros((n, 3))
    driven[0], changed[0, 0] = [J * designs.TORQUE, 0, J], -1
    C, D = np.zeros((blocks + 3, 2 * n)), np.zeros((blocks + 3, blocks + 3))
    for i, w in enumerate(W):
        eta, rate, first, second = 1 + i, n + 1 + i, 1 + 2 * i, 2 + 2 * i
        force[eta, [eta, rate]] = -w * w, -2 * designs.DAMPING * w
        changed[eta, [first, second]] = -w, -1
        C[first, eta] = r * w
        C[second, [eta, rate]], D[second, first] = (r * w * w, r * w * 2 * designs.DAMPING), r * w
    moved = np.linalg.solve(M, np.hstack([force, changed, driven]))
    C[0], D[0] = r * J * moved[0, : 2 * n], r * J * moved[0, 2 * n :]
    C[[blocks, blocks + 2], 0] = 1
    D[blocks + 1, -1], D[blocks + 2, -2] = designs.EFFORT, designs.NOISE
    A = np.vstack([np.eye(2 * n)[n:], moved[:, : 2 * n]])
    return StateSpace(A, np.vstack([np.zeros((n, blocks + 3)), moved[:, 2 * n :]]), C, D, 0.0)


def test_the_fractional_form_is_the_plant_of_the_box():
    P, box = fractional(20), designs.uncertain(20)
    for signs in np.array([[1, 1, 1], [-1, 1, -1], [0.3, -0.7, 0.2]]):
        a, b, c = signs
        delta = np.diag([a, b, b, c, c])
        turned = StateSpace(P.A, np.roll(P.B, 3, 1), np.roll(P.C, 3, 0), np.roll(P.D, (3, 3), (0, 1)), 0.0)
        scales = zip(study.PARAMETERS.items(), signs, strict=True)
        values = {name: v * (1 + 0.2 * s) for (name, v), s in scales}
        omega = np.array([0.1, 1.0, 3.0, 20.0])
        np.testing.assert_allclose(
            lft(turned, StateSpace.gain(delta, 0.0), 5, 5).frequency_response(omega),
            box.at(values).frequency_response(omega), rtol=1e-8, atol=1e-12)  # fmt: skip


def test_mu_of_a_loop_finds_the_margin_of_the_box():
    """1 / mu of the real parameters alone is the size of box that `stability_margin` proves."""
    K = designs.pd()
    N = lft(fractional(20), K, 1, 1)
    N = StateSpace(N.A, N.B[:, :5], N.C[:5], N.D[:5, :5], 0.0)
    found, proved = mussv(N, BLOCKS[:3]), stability_margin(designs.uncertain(20), K, tol=1e-3)
    assert 1 / found.upper <= proved.upper * (1 + 1e-6)
    assert found.lower == 0 or 1 / found.lower >= proved.lower * (1 - 1e-6)


@pytest.mark.slow
def test_iteration_ends_far_from_the_box():
    """A complex change of a lightly damped mode's stiffness by 20 % is unstable damping: no K helps (docs/mu.md)."""
    design = musyn(fractional(20), 1, 1, BLOCKS)
    assert design.mu.upper > 5
    assert stability_margin(designs.uncertain(20), design.controller, tol=1e-2).upper < 0.5
