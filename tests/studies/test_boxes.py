"""The loops whose robustness over boxes the studies prove: the laws that fly, the plants that fly, the figures."""

import airbearing_box
import airbearing_margins
import amazonia1_box
import amazonia1_flights as amazonia
import cubesat3u_box
import cubesat3u_controllers
import geo_box
import geo_controllers
import jax
import numpy as np
import pytest

import synth
from plants import airbearing, amazonia1, cubesat3u, geo
from plants.missions.airbearing import PERIOD, TARGET
from plants.outcome import boxes
from synth import UncertainSystem, c2d, hinfnorm, stability_margin, ureal, worst_gain


@pytest.fixture(scope="module")
def designed():
    return cubesat3u_controllers.design_controllers()


@pytest.mark.parametrize("mission", [cubesat3u, amazonia1, airbearing, geo])
def test_the_models_are_those_of_the_plants_and_no_expansions(mission):
    model = mission.uncertain_model(0.3)
    assert model.exact
    linear = {cubesat3u: "wheeled_model", amazonia1: "wheeled_model", airbearing: "linear_model", geo: "driven_model"}
    rng = np.random.default_rng(0)
    for p in model.nominal * rng.uniform(0.7, 1.3, size=(3, len(model.names))):
        E, A, B, *_ = model.at(dict(zip(model.names, p, strict=True)))
        true = getattr(mission, linear[mission])(p)
        np.testing.assert_allclose(np.linalg.solve(E, A), true.A, rtol=1e-8, atol=1e-14)
        np.testing.assert_allclose(np.linalg.solve(E, B), true.B, rtol=1e-9, atol=1e-14)


def test_amazonias_laws_near_the_target_are_what_steps():
    built, scale = amazonia.controllers(0.5), 1e-6
    laws = amazonia1_box.laws(built)
    rng = np.random.default_rng(0)
    steps = scale * rng.normal(size=(6, 6))
    measured = [np.concatenate([[np.sqrt(1 - s[:3] @ s[:3])], s, 0 * s[:3]]) for s in steps]
    for name in (f"{amazonia.LQR}, {amazonia.SDRE}", amazonia.PD, amazonia.PID, amazonia.DYNAMIC):
        law, controller = laws[name], built[name.split(", ")[0] if name.startswith(amazonia.LQR) else name]
        with jax.enable_x64(True):
            state = controller.init()
            x = steps[0] if name == amazonia.DYNAMIC else np.zeros(law.n)  # its estimate begins as measured
            for y, s in zip(measured, steps, strict=True):
                state, u = controller.step(state, y, np.zeros(10))
                np.testing.assert_allclose(np.asarray(u), law.C @ x + law.D @ s, rtol=1e-4, atol=1e-6 * scale)
                x = law.A @ x + law.B @ s
    for name in (amazonia.SDRE, amazonia.MRP, amazonia.LITERAL, amazonia.STATIC):  # the gain there, on its coordinates
        controller = built[name]
        with jax.enable_x64(True):
            x = np.array([np.asarray(controller.model.factorise(y, 1.0)[0]) for y in measured])
        law = laws[f"{amazonia.LQR}, {name}" if name == amazonia.SDRE else name]
        np.testing.assert_allclose(-x @ controller.gain.T, steps @ law.D.T, rtol=1e-6, atol=1e-9 * scale)


def test_the_air_bearing_loses_stability_where_its_gain_margin_says():
    """All moments down and a motor up is a gain, so the box ends where (1 + d)/(1 - d) is the gain margin."""
    asked = airbearing_box.questions()
    found = []
    boxes.ask([q._replace(gains=()) for q in asked], found, synth)
    for answer in found:
        margin = 10 ** (airbearing_margins.local(answer.question.controller, TARGET).gain / 20)
        d = (margin - 1) / (margin + 1)
        assert answer.stable <= answer.lost
        assert answer.lost == pytest.approx(d, rel=5e-3)
        assert answer.question.law.dt == PERIOD


def test_the_laws_of_the_geostationary_study_are_what_flies():
    controllers = geo_controllers.linear(geo.RATE, 6.0)[0]
    rng = np.random.default_rng(0)
    for question in geo_box.questions(controllers):
        controller, law = controllers[question.controller], question.law
        state, x = controller.init(), np.zeros(law.n)
        for y in rng.normal(size=(5, 6)):
            state, u = controller.step(state, y, np.zeros(6))
            np.testing.assert_allclose(u, law.C @ x + law.D @ y, rtol=1e-9, atol=1e-15)
            x = law.A @ x + law.B @ y


def test_the_cubesats_fastest_law_is_unstable_within_a_quarter_of_its_moments(designed):
    """MPC of the velocity form; so is the plant that flies, with an exact hold, and a PD bears four times as much."""
    controllers = {name: designed[1][name] for name in ("MPC velocity", "PD")}
    asked = cubesat3u_box.questions(controllers, {})
    found = []
    boxes.ask(asked, found, synth)
    mpc, pd = found
    assert 0.21 < mpc.stable < mpc.lost < 0.23
    assert pd.stable > 4 * mpc.lost
    for q in asked:
        p = np.array([mpc.margin.parameters[name] for name in q.model.names])
        assert np.abs(p / q.model.nominal - 1).max() < 0.23
        G = c2d(synth.StateSpace(*q.linear(p)), q.law.dt)
        radius = np.abs(synth.feedback(G, q.law, 1).poles()).max()
        assert radius > 1 - 1e-5 if q.controller == "MPC velocity" else radius < 0.99


@pytest.mark.slow
@pytest.mark.parametrize("within", cubesat3u_box.WITHIN)
def test_the_cubesats_design_over_its_inertia_box(designed, within):
    """The norm that was designed for, 15 x 9 channels, with the body that flies; samples of its plant, held exactly."""
    design, W = designed[0], cubesat3u.WEIGHTS
    P, model = design.plant, cubesat3u.uncertain_model(within)

    def weighted(G):
        B1 = np.hstack([np.zeros((6, 6)), G.B @ W.proc, np.zeros((6, 6))])
        C, D = np.vstack([P.C1, P.C2]), np.block([[P.D11, P.D12], [P.D21, P.D22]])
        return np.hstack([B1, G.B]), C, D

    E, A, B, C, D = model.over(ureal)
    G = c2d(UncertainSystem(E, A, -B, C, D), P.dt, "midpoint")
    loop = UncertainSystem(G.E, G.A, *weighted(G), P.dt).close(design)
    r = worst_gain(loop, tol=1e-4)
    assert design.gamma < r.lower < r.upper < r.lower * (1 + 1e-3)
    assert not r.note
    r.certificate.check(loop)
    rng = np.random.default_rng(0)
    for p in [np.array(list(r.parameters.values())), *model.nominal * rng.uniform(1 - within, 1 + within, (5, 3))]:
        A, B, C, D = cubesat3u.wheeled_model(p)
        H = c2d(synth.StateSpace(A, -B, C, D), P.dt)
        norm = hinfnorm(synth.lft(synth.StateSpace(H.A, *weighted(H), P.dt), design.controller))[0]
        assert norm < r.upper
    margin = stability_margin(loop, tol=1e-3)
    assert margin.lower * within > 0.9
