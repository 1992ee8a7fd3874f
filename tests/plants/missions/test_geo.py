"""The geostationary study: cases, fuel that is counted exactly, and the loop as it would fly."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from plants.errors import ScenarioError
from plants.missions import geo
from plants.simulation.simulate import simulate


@dataclass(frozen=True)
class Damper:
    """u = -K x, slow."""

    dt: float
    stiffness: float = 2e-7  # 1/s^2
    damping: float = 8e-4  # 1/s

    def init(self):
        return ()

    def step(self, state, y, r):
        return state, -self.stiffness * y[:3] - self.damping * y[3:]


@pytest.fixture(scope="module")
def run():
    """1 km with 1 N, two hours short of a day."""
    return simulate(*geo.case(Damper(60.0), 10 * geo.OFFSET, 79200.0, limit=geo.WEAK_FORCE))


def test_fuel_is_the_integral_of_what_the_thrusters_gave(run):
    assert run.ok
    given = np.abs(run.inputs[:-1]).sum(axis=0) * 60.0
    np.testing.assert_allclose(geo.outcome(run).delta_v, given, rtol=1e-12)
    assert np.abs(run.inputs).max() <= geo.WEAK_FORCE / geo.MASS


def test_outcome(run):
    loose, tight = geo.outcome(run, box=200.0, since=40000.0), geo.outcome(run, box=1e-3, since=40000.0)
    assert 0 < loose.settling_time < 40000.0
    assert loose.violation == loose.outside == 0
    assert tight.settling_time == np.inf
    assert tight.outside == 1
    assert tight.violation == pytest.approx(tight.farthest - 1e-3)
    assert loose.per_day == pytest.approx(loose.delta_v.sum() / run.time[-1] * geo.DAY)
    assert geo.outcome(replace(run, ok=False)).per_day == np.inf
    with pytest.raises(ScenarioError, match="since"):
        geo.outcome(run, since=80000.0)


def test_perturbation_at_the_ideal_point():
    """Tides of up to 8e-6 m/s^2 and sunlight; nothing of the attraction that holds the satellite."""
    push = geo.perturbation(np.arange(0, 2 * geo.DAY, 1800.0))
    assert push.shape == (96, 3)
    assert 5e-6 < np.abs(push).max() < 1e-5


@pytest.mark.parametrize(
    ("make", "field"),
    [
        (lambda: geo.case(Damper(7.0), np.zeros(6), 100.0), "duration"),
        (lambda: geo.case(Damper(10.0), np.zeros(3), 100.0), "start"),
        (lambda: geo.case(Damper(10.0), np.zeros(6), 100.0, limit=0.0), "force"),
        (lambda: geo.case(Damper(10.0), np.zeros(6), 100.0, noise=-np.ones(6)), "noise"),
        (lambda: geo.operational(Damper(90.0), np.zeros(6), 900.0), "controller.dt"),
    ],
)
def test_bad_numbers(make, field):
    with pytest.raises(ScenarioError, match=field):
        make()


@pytest.mark.slow
def test_the_loop_as_it_flies():
    """Filter and pulses of 0.1 N s for half a day: whole pulses, and the satellite comes home."""
    run = simulate(*geo.operational(Damper(600.0), 10 * geo.OFFSET, 43200.0))
    assert run.ok
    pulses = run.inputs * geo.MASS * geo.SAMPLE / (geo.WEAK_FORCE * geo.PULSE)
    np.testing.assert_allclose(pulses, np.round(pulses), rtol=0, atol=1e-6)
    assert (pulses % 600 != 0).any()
    assert np.abs(run.outputs[-1, :3]).max() < 100.0
