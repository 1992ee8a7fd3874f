"""The bridge to Basilisk: the same body moved by both, and what the example says without Basilisk."""

import importlib.util
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import plants
from plants.dynamics.rigidbody import BodyState, RigidBody

BRIDGE = Path(__file__).parents[3] / "examples" / "basilisk" / "bridge.py"


@pytest.fixture(scope="module")
def bridge():
    spec = importlib.util.spec_from_file_location("bridge", BRIDGE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@dataclass(frozen=True)
class Replay:
    commands: np.ndarray
    dt: float

    def init(self):
        return 0

    def step(self, k, y, r):
        return k + 1, self.commands[k]


@pytest.mark.filterwarnings("default")
def test_basilisk_moves_the_body_as_rigidbody_does(bridge):
    pytest.importorskip("Basilisk.simulation.spacecraft", reason="needs Basilisk (pip: bsk)")
    run = bridge.fly(periods=40)
    assert run.ok
    sigma = run.states[0, :3]
    q = np.array([1 - sigma @ sigma, *(2 * sigma)]) / (1 + sigma @ sigma)
    body = RigidBody.create(bridge.INERTIA, wheel_axes=bridge.AXES, wheel_inertia=np.full(3, bridge.SPIN))
    scenario = plants.Scenario(
        initial=BodyState(q, run.states[0, 3:6], run.states[0, 6:]),
        dt=run.duration / 40,
        periods=40,
        steps=10,
        environment=plants.FreeSpace(),
    )
    own = plants.simulate(plants.Loop(plant=body, controller=Replay(run.commands, scenario.dt)), scenario)
    np.testing.assert_allclose(own.states.w, run.states[:, 3:6], rtol=0, atol=1e-11)
    np.testing.assert_allclose(own.states.wheels, run.states[:, 6:], rtol=0, atol=1e-8)
    again = bridge.fly(periods=40)
    np.testing.assert_array_equal(again.states, run.states)


def test_without_basilisk_the_example_says_so():
    code = f"import runpy, sys; sys.modules['Basilisk'] = None; runpy.run_path({str(BRIDGE)!r}, run_name='__main__')"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert "Basilisk is not installed" in ended.stderr
    assert "pip install bsk" in ended.stderr
