"""The controllers of the study: H-infinity and MPC of Pecorilla and Stesina (2024), a PD of the same bandwidth."""

from __future__ import annotations

from typing import Any

import numpy as np

import synth
from plants import cubesat3u

PERIOD = cubesat3u.CONTROL_PERIOD
FORMS = ("velocity", "position")  # of the MPC: which of the two the paper has is not said
DAMPING = 0.8  # () of the PD, ours


def model() -> synth.StateSpace:
    """The linear model about nadir, torque to quaternion and rate."""
    return synth.StateSpace(*cubesat3u.linear_model(), PERIOD)


def hinfinity(W: cubesat3u.Weights = cubesat3u.WEIGHTS) -> synth.Design:
    """The verified H-infinity design, by default with the weights of table 4."""
    torque, state = ("Tx", "Ty", "Tz"), ("q1", "q2", "q3", "wx", "wy", "wz")
    units = dict.fromkeys(torque, "N m") | dict.fromkeys(state[:3], "1") | dict.fromkeys(state[3:], "rad/s")
    return synth.hinfsyn(
        synth.GeneralizedPlant.tracking(
            model(), Wproc=W.proc, Wdist=W.dist, Werr=W.err, Wact=W.act, Wr=W.ref, u=torque, y=state, units=units
        )
    )


def predictive(form: str) -> synth.Mpc:
    """The MPC of table 3; its limits are ours."""
    limits = np.concatenate([np.full(3, np.inf), np.full(3, cubesat3u.MPC_RATE_LIMIT)])
    return synth.mpc(
        model(),
        Q=cubesat3u.MPC_STATE_WEIGHT * np.eye(6),
        R=cubesat3u.MPC_INPUT_WEIGHT * np.eye(3),
        Np=cubesat3u.MPC_HORIZON,
        Nc=cubesat3u.MPC_MOVES,
        umin=-cubesat3u.WHEEL_TORQUE,
        umax=cubesat3u.WHEEL_TORQUE,
        form=form,
        ymin=-limits,
        ymax=limits,
        hmax=cubesat3u.WHEEL_INERTIA * cubesat3u.WHEEL_SPEED,
    )


def same_bandwidth(margins: synth.Margins, damping: float = DAMPING) -> synth.LinearController:
    """A PD whose loop gain crosses one where that of another loop does, axis by axis.

    The loop of I (2 wn^2 q + 2 zeta wn w) about a free body crosses one at c with
    c^2 = wn^2 (2 zeta^2 + (4 zeta^4 + 1)^1/2), delays left out.
    """
    crossing = np.array([m.phase_frequency for m in margins.input])
    square = 2 * damping**2
    wn = crossing / np.sqrt(square + np.sqrt(square**2 + 1))
    gain = cubesat3u.INERTIA[:, None] * np.hstack([2 * np.diag(wn**2), 2 * damping * np.diag(wn)])
    return synth.state_feedback(gain, PERIOD)


def design_controllers() -> tuple[synth.Design, dict[str, Any]]:
    """The verified H-infinity design of table 4, and all controllers by name."""
    design = hinfinity()
    hinf = synth.LinearController.of(design.controller)
    assert design.margins is not None
    pd = same_bandwidth(design.margins)
    return design, {
        "Hinf": hinf,
        "PD": pd.padded(len(hinf.A)),  # one compiled flight for both
        **{f"MPC {form}": predictive(form) for form in FORMS},
    }


def linear_law(controller: Any) -> synth.StateSpace:
    """The law from y to u, r = 0: of an MPC the one that holds while no limit is active.

    With x measured, its states are what it predicted for x (velocity form only) and the last command.
    """
    if isinstance(controller, synth.LinearController):
        return synth.StateSpace(controller.A, -controller.B, controller.C, -controller.D, PERIOD)
    p, n = controller.problem, len(controller.problem.unit) * controller.problem.Nc
    gain = -p.unit[:, None] * np.linalg.solve(controller.qp.P[:n, :n], controller.qp.slope[:n])[: len(p.unit)]
    here, off, last = (gain[:, p.parameters[name]] for name in ("x", "d", "inputs"))
    if p.form == "position":
        return synth.StateSpace(last, here, last, here, PERIOD)
    A, B = p.model.A, p.model.B
    C, D = np.hstack([-off, last]), here + off
    return synth.StateSpace(np.vstack([B @ C, C]), np.vstack([A + B @ D, D]), C, D, PERIOD)


def flops(controller: Any) -> int:
    """Multiplications and additions of a step: of a linear law in C all of them, of an MPC those that no solver saves.

    These are its slope at the measured data, one product with the inverse of its Hessian, and one look at all of its
    rows: what it costs when no limit is active. Every active limit comes on top.
    """
    if isinstance(controller, synth.LinearController):
        states = np.count_nonzero(controller.B.any(axis=1) | controller.A.any(axis=1))  # without those of `padded`
        outputs, inputs = controller.D.shape
        return 2 * (states + outputs) * (states + inputs)
    qp = controller.qp
    return 2 * (np.count_nonzero(qp.slope) + qp.P.size + np.count_nonzero(qp.A))
