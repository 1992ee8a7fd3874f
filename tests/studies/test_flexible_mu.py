"""mu of the flexible satellite; D-K iteration takes its frequencies for complex numbers, which no controller bears."""

import flexible as study
import flexible_designs as designs
import numpy as np
import pytest

from synth import StateSpace, lft, mussv, musyn, stability_margin


def test_the_fractional_form_is_the_plant_of_the_box():
    P, box = designs.fractional(20), designs.uncertain(20)
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
    N = lft(designs.fractional(20), K, 1, 1)
    N = StateSpace(N.A, N.B[:, :5], N.C[:5], N.D[:5, :5], 0.0)
    found, proved = mussv(N, designs.BLOCKS[:3]), stability_margin(designs.uncertain(20), K, tol=1e-3)
    assert 1 / found.upper <= proved.upper * (1 + 1e-6)
    assert found.lower == 0 or 1 / found.lower >= proved.lower * (1 - 1e-6)


@pytest.mark.slow
def test_iteration_ends_far_from_the_box():
    """A complex change of a lightly damped mode's stiffness by 20 % is unstable damping: no K helps (docs/mu.md)."""
    design = musyn(designs.fractional(20), 1, 1, designs.BLOCKS)
    assert design.mu.upper > 5
    assert stability_margin(designs.uncertain(20), design.controller, tol=1e-2).upper < 0.5
