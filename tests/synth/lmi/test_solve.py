"""Whatever a solver does, what comes out is a status or one of our errors, without its advice to somebody else."""

import cvxpy as cp
import pytest

from synth import GeneralizedPlant, NumericalError, hinfsyn
from synth.lmi.solve import run


class Panic(BaseException):
    """Clarabel's panics are no `Exception`."""


@pytest.mark.parametrize(
    "error", [cp.error.SolverError("Try another solver"), ValueError("Problem data contains NaN"), Panic("unwrap")]
)
def test_a_broken_solver_is_our_error(monkeypatch, error):
    def fails(self, **settings):
        raise error

    monkeypatch.setattr(cp.Problem, "solve", fails)
    with pytest.raises(NumericalError, match="broke down") as caught:
        run(cp.Problem(cp.Minimize(cp.Variable())), "Clarabel")
    assert "another solver" not in str(caught.value)
    assert str(error) in caught.value.statuses["clarabel"]
    plant = GeneralizedPlant.four_block(([1], [1, 1, 0]), Wdist=1, Wnoise=1, Wout=1, Wact=1)
    with pytest.raises(NumericalError):
        hinfsyn(plant, method="lmi")
    assert hinfsyn(plant).info.method == "riccati"  # which needs no solver


def test_interruptions_pass(monkeypatch):
    def interrupted(self, **settings):
        raise KeyboardInterrupt

    monkeypatch.setattr(cp.Problem, "solve", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run(cp.Problem(cp.Minimize(cp.Variable())), "Clarabel")
