"""What a step of model predictive control costs: python benchmarks/mpc.py

The CubeSat of Pecorilla and Stesina (2024, equation 12), table 3, both forms, soft limits on rate and momentum. Four
ways to the same command for the same measurements of a regulation from the attitude error of table 3, in one run:

    step      the controller's public step, checks and bookkeeping included
    raw       DAQP alone: update and solve of the same program, vectors ready, warm start by DAQP
    C         the exported C, called from Python: its solver, its check and its memory
    cvxpy     CVXPY with parameters on the condensed program, solved by Clarabel at its defaults

Each measurement is repeated; the fastest of the repetitions counts. Targets, for the study's program (soft limits on):
step / raw <= 4, C / step <= 1, cvxpy / step >= 50. Without soft limits DAQP needs half the time and the bookkeeping
weighs more.
"""

import ctypes
import sys
import tempfile
import time
from pathlib import Path

import cvxpy as cp
import daqp
import numpy as np

sys.path.insert(0, str(Path(__file__).parent.parent / "tests"))
from exportedmpc import REAL, exported
from literature import cubesat_model

from synth import Mpc, mpc
from synth.predictive.horizon import MpcState

TORQUE, MOMENTUM, RATE = 1e-3, 10.8e-3, np.radians(2)  # N m, N m s, rad/s
REST = np.zeros(6)
PERIODS = 200  # 100 s


def flight(controller: Mpc, noise: float) -> list[tuple[MpcState, np.ndarray]]:
    """Controller states and measurements of a regulation with measurement noise (rad, rad/s)."""
    rng = np.random.default_rng(0)
    model, state, x = controller.problem.model, controller.init(), np.array([-0.13, 0.22, 0.09, 0, 0.0011, 0])
    cases = []
    for _ in range(PERIODS):
        y = x + noise * rng.standard_normal(6) * [1, 1, 1, 0.1, 0.1, 0.1]
        cases.append((state, y))
        state, u = controller.step(state, y, REST)
        x = model.A @ x + model.B @ u
    return cases


def fastest(runs, repeat: int) -> list[float]:
    """CPU seconds per period of each run's fastest repetition; the runs take turns: a busy machine is fair to all."""
    seconds = np.full((repeat, len(runs)), np.inf)
    for row in seconds:
        for i, run in enumerate(runs):
            start = time.process_time()
            run()
            row[i] = time.process_time() - start
    return (seconds.min(axis=0) / PERIODS).tolist()


def stepping(controller: Mpc, cases):
    """A function that returns the commands of all periods."""
    return lambda: [controller.step(state, y, REST)[1] for state, y in cases]


def raw_daqp(controller: Mpc, cases):
    """A function that returns the commands and slacks of all periods."""
    qp = controller.qp
    both = [qp.vectors(controller.parameters(state, y, REST)) for state, y in cases]
    model = daqp.Model()
    model.setup(qp.P, both[0][0], qp.A, both[0][1], qp.lower, np.zeros(qp.lower.size, dtype=np.intc))
    model.settings = {"primal_tol": 1e-10, "eps_prox": 0.0}

    def run():
        out = []
        for f, upper in both:
            model.update(f=f, bupper=upper)
            out.append(model.solve()[0])
        return out

    return run


def in_c(controller: Mpc, cases, folder: Path):
    """A function that returns the commands of all periods."""
    compiled, size = exported(controller, folder), controller.problem.model.B.shape
    step, memory = compiled.library.attitude_step, ctypes.byref(compiled.memory)
    inputs, r = [(REAL * size[0])(*y) for _, y in cases], (REAL * size[0])()
    commands = [(REAL * size[1])() for _ in cases]

    def run():
        compiled.reset()
        for y, u in zip(inputs, commands, strict=True):
            if step(memory, y, r, u):
                raise RuntimeError("a step found no command")
        return np.array(commands) / TORQUE

    return run


def cvxpy_condensed(controller: Mpc, cases):
    """A function that returns the commands and slacks of all periods."""
    qp, N = controller.qp, controller.qp.P.shape[0]
    both = [qp.vectors(controller.parameters(state, y, REST)) for state, y in cases]
    v, f, b = cp.Variable(N), cp.Parameter(N), cp.Parameter(qp.A.shape[0])
    above, below = np.flatnonzero(np.isfinite(both[0][1][:N])), np.flatnonzero(np.isfinite(qp.lower[:N]))
    bounds = [v[above] <= both[0][1][above], v[below] >= qp.lower[below]]
    objective = cp.quad_form(v, cp.psd_wrap(qp.P)) / 2 + f @ v
    problem = cp.Problem(cp.Minimize(objective), [*bounds, qp.A @ v <= b])

    def run():
        out = []
        for fk, upper in both:
            f.value, b.value = fk, upper[N:]
            problem.solve(solver="CLARABEL")
            out.append(v.value)
        return out

    return run


def main():
    model = cubesat_model()
    limits = {"ymin": [-np.inf] * 3 + [-RATE] * 3, "ymax": [np.inf] * 3 + [RATE] * 3, "hmax": MOMENTUM}
    table_3 = {"Q": 1000 * np.eye(6), "R": 1000 * np.eye(3), "Np": 10, "Nc": 7, "umin": -TORQUE, "umax": TORQUE}
    print(f"{PERIODS} periods, microseconds per step")
    print(
        "form      soft  noise |   step    raw      C   cvxpy | step/raw  C/step  C/raw  cvxpy/step"
        " | command differs by (raw, C, cvxpy)"
    )
    folder = Path(tempfile.mkdtemp())
    for form in ("position", "velocity"):
        for soft in (limits, {}):
            for noise in (0.0, 2e-3):
                controller = mpc(model, form=form, **table_3, **soft)
                cases = flight(controller, noise)
                stepped = stepping(controller, cases)
                raw, posed = raw_daqp(controller, cases), cvxpy_condensed(controller, cases)
                ours = in_c(controller, cases, folder)
                t_step, t_raw, t_c = fastest([stepped, raw, ours], 200)
                (t_cvxpy,) = fastest([posed], 4)
                u = np.array(stepped()) / TORQUE
                off = [np.abs(np.array(run())[:, :3] - u).max() for run in (raw, ours, posed)]
                print(
                    f"{form:9} {'yes' if soft else 'no':4} {noise:6.0e}"
                    f" | {1e6 * t_step:6.1f} {1e6 * t_raw:6.1f} {1e6 * t_c:6.1f} {1e6 * t_cvxpy:7.0f}"
                    f" | {t_step / t_raw:8.2f}  {t_c / t_step:6.2f} {t_c / t_raw:6.2f}  {t_cvxpy / t_step:10.0f}"
                    f" | {off[0]:.0e} {off[1]:.0e} {off[2]:.0e}"
                )


if __name__ == "__main__":
    main()
