"""A spacecraft that Basilisk moves, under a controller that flies here: `python examples/basilisk/bridge.py`.

Basilisk's rigid body with balanced reaction wheels is a plant from outside: `advance` hands it the motors' torques and
lets it run for a step. Needs Basilisk (pip: bsk); without it the program says so and ends with exit code 2.
"""

import sys

import numpy as np

import plants

INERTIA, AXES, SPIN = np.diag([0.12, 0.11, 0.05]), np.eye(3), 2.5e-5  # kg m^2, wheels included; unit; kg m^2
STEP = 0.05  # s, of Basilisk's integrator; divides the sampling period


class BasiliskBody:
    """State: modified Rodrigues parameters (3), rate in rad/s (3), wheel speeds in rad/s (3); output: the first six."""

    def begin(self, x):
        from Basilisk.architecture import messaging
        from Basilisk.simulation import reactionWheelStateEffector, spacecraft
        from Basilisk.utilities import SimulationBaseClass, macros, simIncludeRW

        self.nano = macros.sec2nano
        self.sim = SimulationBaseClass.SimBaseClass()
        self.sim.CreateNewProcess("process").addTask(self.sim.CreateNewTask("task", self.nano(STEP)))
        self.body = spacecraft.Spacecraft()
        self.body.ModelTag = "body"
        self.body.hub.mHub = 10.0  # kg; nothing pulls at it
        self.body.hub.IHubPntBc_B = INERTIA.tolist()
        self.body.hub.sigma_BNInit = x[:3, None].tolist()
        self.body.hub.omega_BN_BInit = x[3:6, None].tolist()
        factory, self.wheels = simIncludeRW.rwFactory(), reactionWheelStateEffector.ReactionWheelStateEffector()
        for axis, speed in zip(AXES.T, x[6:], strict=True):
            factory.create("custom", axis.tolist(), Js=SPIN, Omega=float(speed / macros.RPM), useMaxTorque=False)
        factory.addToSpacecraft("wheels", self.wheels, self.body)
        self.torques, self.write = messaging.ArrayMotorTorqueMsg(), messaging.ArrayMotorTorqueMsgPayload
        self.wheels.rwMotorCmdInMsg.subscribeTo(self.torques)
        self._command(np.zeros(3))
        self.sim.AddModelToTask("task", self.wheels, 2)
        self.sim.AddModelToTask("task", self.body, 1)
        self.sim.InitializeSimulation()
        return x

    def advance(self, x, u, t, h):
        self._command(u)
        self.sim.ConfigureStopTime(self.nano(t + h))
        self.sim.ExecuteSimulation()
        now, speeds = self.body.scStateOutMsg.read(), self.wheels.rwSpeedOutMsg.read()
        return np.concatenate([now.sigma_BN, now.omega_BN_B, speeds.wheelSpeeds[:3]])

    def output(self, x, env):
        return x[:6]

    def _command(self, u):
        payload = self.write()
        payload.motorTorque = u.tolist()
        self.torques.write(payload)


class Pd:
    """Motor torques of a proportional and derivative law; positive on a wheel is negative on the body."""

    dt = 0.5

    def init(self):
        return ()

    def step(self, s, y, r):
        return s, AXES.T @ (0.02 * (y[:3] - r[:3]) + 0.05 * (y[3:] - r[3:]))


def fly(periods=400):
    initial = np.array([0.1, -0.05, 0.08, 0.01, -0.02, 0.005, 0.0, 0.0, 0.0])
    scenario = plants.Scenario(initial=initial, dt=Pd.dt, periods=periods)
    return plants.simulate(plants.Loop(plant=BasiliskBody(), controller=Pd()), scenario)


if __name__ == "__main__":
    try:
        import Basilisk  # noqa: F401
    except ImportError:
        print("Basilisk is not installed, so there is nothing to fly: pip install bsk", file=sys.stderr)
        sys.exit(2)
    run = fly()
    print(f"{run.duration:g} s, ok {run.ok}: |sigma| {np.linalg.norm(run.outputs[-1, :3]):.1e} at the end")
