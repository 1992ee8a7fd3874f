"""Forms of systems and messages that users of other toolboxes reported (`kind` "form" and "message" of the reports)."""

from __future__ import annotations

import control
import numpy as np
import pytest

from synth import ModelError, StateSpace, augw, hinfsyn, mixsyn, ncfmargin, ncfsyn, system


def test_transfer_functions_as_plant_and_weights():
    """python-control #973, #367, #465: transfer functions go where systems go, and mean the same."""
    G, W1 = control.tf([1, 1], [1, 0.5, 4]), control.tf([2, -2.2, 1], [3, 0.2, 0.01])
    design = mixsyn(G, W1)
    assert design.gamma == pytest.approx(2 / 3, rel=1e-3)
    other = mixsyn(control.ss(G), control.ss(W1))
    assert design.gamma == pytest.approx(other.gamma, rel=1e-3)
    P = augw(G, W1)
    assert hinfsyn(P.system.to_control(), 1, 1).gamma == pytest.approx(design.gamma, rel=1e-3)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_static_systems_of_control_without_a_timebase(dt):
    """RobustAndOptimalControl.jl's test of ncfmargin: the gain has dt None, and takes the timebase of its company."""
    one = control.ss([], [], [], [[1.0]])
    assert one.dt is None
    P = control.tf([4], [1, -0.001]) if not dt else control.tf([4 * dt], [1, -np.exp(0.001 * dt)], dt)
    if not dt:
        assert ncfmargin(P, one) == pytest.approx(0.7069299, rel=1e-6)
    assert ncfmargin(P, one) == pytest.approx(ncfmargin(P, 1.0), rel=1e-12)
    assert augw(P, one, one).dt == dt
    assert ncfsyn(P, W1=one, W2=one).plant.dt == dt
    assert (system(P) * one).dt == dt
    assert system(one, dt=dt).dt == dt


@pytest.mark.parametrize(("nmeas", "ncon"), [(1, 1), (1, None), (2, 1), (1, 2)])
def test_a_plant_too_small_for_its_channels(nmeas, ncon):
    """python-control #99: the message says what is missing, and no range that is empty ("from 1 to 0")."""
    with pytest.raises(ModelError) as caught:
        hinfsyn(StateSpace([[-1.0]], [[1.0]], [[1.0]], [[0.0]]), nmeas, ncon)
    assert "to 0" not in str(caught.value)
    if ncon == nmeas == 1:
        assert "P is 1 x 1; a generalised plant has at least one w and one u" in str(caught.value)
        assert "mixsyn, ncfsyn" in str(caught.value)
