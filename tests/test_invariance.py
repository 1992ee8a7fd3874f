"""Results depend on neither coordinates nor units: of states, of time, of signals.

Every property draws a plant of a family (`families.py`), computes something, and computes it again in random
coordinates: turned by an orthogonal matrix, scaled by 10^[-6, 6], or both as far as doubles still hold the plant. A
companion form of poles at 1e5 rad/s that is turned holds no digit: such a draw is scaled only. A double integrator that
is turned gets poles at 1e-8, which is no loss, because no loop shows them.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from families import (
    AS_IT_IS,
    CLASSES,
    KINDS,
    PLANTS,
    Move,
    apart,
    four_block,
    frequencies,
    holding,
    integrator_chain,
    loop_response,
    modal_form,
    response,
    sampled,
)
from hypothesis import HealthCheck, assume, given, settings
from hypothesis import strategies as st

from synth import (
    AssumptionError,
    GeneralizedPlant,
    Margins,
    StateSpace,
    SynthError,
    augw,
    c2d,
    diskmargin,
    dlqr,
    gapmetric,
    h2norm,
    hinfnorm,
    hinfsyn,
    lqg,
    lqr,
    lqrd,
    margin,
    margins,
    mixsyn,
    ncfmargin,
    ncfsyn,
    series,
    system,
    verify,
)
from synth.analysis.coprime import gang_of_four
from synth.analysis.stabilitymargins import Margin

LEVEL, NUMBER, GAP = 1e-3, 1e-6, 1e-6  # relative, of levels and numbers; absolute, of gaps
TINY = 1e-3  # gains are compared relative to themselves, or to this
GENERALISED: dict[str, Callable[[np.random.Generator], GeneralizedPlant]] = {
    **{make.__name__: make for make in CLASSES},
    "integrators": lambda rng: four_block(integrator_chain(rng), rng),
    "modal": lambda rng: four_block(modal_form(rng), rng),
    "sampled": lambda rng: four_block(sampled(rng), rng),
}


class Draw(NamedTuple):
    """What hypothesis draws: a family, a seed for its plant, and the coordinates."""

    family: str
    seed: int
    kind: str
    decades: float  # of the unit of time

    @property
    def unit(self) -> float:
        return 10**self.decades


def hold(check: Callable[[Draw], None], count: int, families=PLANTS) -> None:
    """Run a check on `count` draws."""
    draws = st.builds(
        Draw, st.sampled_from(sorted(families)), st.integers(0, 2**32 - 1), st.sampled_from(KINDS), st.floats(-3, 3)
    )
    quiet = {"deadline": None, "derandomize": True, "database": None, "suppress_health_check": list(HealthCheck)}
    settings(max_examples=count, **quiet)(given(draws)(check))()


def effort(few: int, many: int):
    """A few examples, and many of them in the slow tests."""
    return pytest.mark.parametrize(
        "count", [pytest.param(few, id="few"), pytest.param(many, id="many", marks=pytest.mark.slow)]
    )


class Loop:
    """A plant of a family, its loop-shaping controller, and both of them in coordinates of their own."""

    def __init__(self, draw: Draw):
        self.rng, self.unit = np.random.default_rng(draw.seed), draw.unit
        self.G = PLANTS[draw.family](self.rng)
        try:
            self.design = ncfsyn(self.G)
        except SynthError:  # a random plant that cannot be stabilised well
            assume(False)
        self.K, self.CL = self.design.controller, replace(self.design.closed_loop, u=(), y=(), units={})
        self.omega = frequencies(self.CL, self.G)
        self.F = loop_response(gang_of_four(self.G), self.K, self.omega)
        self.kind, self.in_time = draw.kind, Move(np.eye(self.K.n), draw.unit)
        self.plant = holding(draw.kind, self.G, self.rng, self.lost, draw.unit)
        self.moved = self.plant(self.G)
        self.controller = holding(draw.kind, self.K, self.rng, lambda K: self.lost(self.moved, K), draw.unit)(self.K)

    def lost(self, G: StateSpace, K: StateSpace | None = None) -> float:
        """What the loop of a moved plant loses."""
        closed = loop_response(gang_of_four(G), K or self.in_time(self.K), self.omega, self.unit)
        return apart(self.F, closed)

    def whole(self, G: StateSpace) -> StateSpace:
        """A stable system in coordinates of its own."""
        F = response(G, self.omega)
        return holding(self.kind, G, self.rng, lambda H: apart(F, response(H, self.omega, self.unit)), self.unit)(G)


def assert_same_margin(one: Margin, other: Margin, unit: float) -> None:
    """Gains up count by their inverse; a gain far below one is known as well as the loop is at one."""
    absolute = NUMBER * TINY
    assert 1 / other.gain_up == pytest.approx(1 / one.gain_up, rel=NUMBER, abs=absolute)
    assert other.gain_down == pytest.approx(one.gain_down, rel=NUMBER, abs=absolute)
    assert other.phase == pytest.approx(one.phase, rel=NUMBER)
    assert other.delay * unit == pytest.approx(one.delay, rel=NUMBER)
    assert other.phase_frequency / unit == pytest.approx(one.phase_frequency, rel=NUMBER, nan_ok=True)


def assert_same_margins(one: Margins, other: Margins, unit: float) -> None:
    for a, b in zip((*one.input, *one.output), (*other.input, *other.output), strict=True):
        assert_same_margin(a, b, unit)
    assert other.disk_input.alpha == pytest.approx(one.disk_input.alpha, rel=NUMBER)
    assert other.disk_output.alpha == pytest.approx(one.disk_output.alpha, rel=NUMBER)
    assert other.ncf == pytest.approx(one.ncf, rel=NUMBER)


@effort(20, 80)
def test_margins(count):
    def check(draw):
        loop = Loop(draw)
        assert_same_margins(margins(loop.G, loop.K, 1), margins(loop.moved, loop.controller, 1), loop.unit)

    hold(check, count)


@effort(20, 80)
def test_margin_of_one_loop_whatever_the_units_of_its_signals(count):
    def check(draw):
        loop = Loop(draw)
        assume((loop.G.ny, loop.G.nu) == (1, 1))
        a, b = 10 ** loop.rng.uniform(-3, 3, 2)
        G, K = loop.moved, loop.controller
        G = StateSpace(G.A, G.B * a, b * G.C, a * b * G.D, G.dt)
        L = series(G, StateSpace(K.A, K.B / b, K.C / a, K.D / (a * b), K.dt))
        exact = series(loop.G, loop.K)
        assert_same_margin(margin(exact, 1), margin(L, 1), loop.unit)
        assert diskmargin(L, 1).alpha == pytest.approx(diskmargin(exact, 1).alpha, rel=NUMBER)

    hold(check, count)


@effort(20, 80)
def test_ncfmargin_and_ncfsyn(count):
    def check(draw):
        loop = Loop(draw)
        measured = verify(gang_of_four(loop.moved).close(loop.controller))
        rounding = measured.rounding / measured.norm  # which the margin, a guarantee, leaves room for
        assert ncfmargin(loop.moved, loop.controller, 1) == pytest.approx(
            ncfmargin(loop.G, loop.K, 1), rel=NUMBER + rounding
        )
        design = ncfsyn(loop.moved)
        assert design.gamma == pytest.approx(loop.design.gamma, rel=LEVEL)
        assert design.info.optimum == pytest.approx(loop.design.info.optimum, rel=LEVEL)

    hold(check, count)


@effort(15, 80)
def test_gapmetric(count):
    hold(gaps_agree, count)


def gaps_agree(draw: Draw) -> None:
    """The gap to a plant with a tenth more gain and poles that are moved by a hundredth of the smallest one."""
    loop = Loop(draw)
    G = loop.G
    A = G.A if G.discrete else G.A - 1e-2 * np.linalg.norm(G.A, -2) * np.eye(G.n)
    other = StateSpace(A, 1.1 * G.B, G.C, 1.1 * G.D, G.dt)
    one, two = gapmetric(G, other), gapmetric(loop.moved, loop.plant(other))
    assert two.gap == pytest.approx(one.gap, abs=GAP)
    assert two.nugap == pytest.approx(one.nugap, abs=GAP)


@pytest.mark.parametrize(
    "draw",
    [
        Draw("companion", 17221, "turned", 0.0),  # five lags, 1e-5 off while only powers of two balanced them
        Draw("companion", 97121, "scaled, then turned", 0.0),  # four, 4e-3 off
        Draw("companion", 3524838638, "turned, then scaled", -1.9143686554212198),  # 1e-4 off
    ],
)
def test_gap_of_turned_companion_forms(draw):
    gaps_agree(draw)


def test_ncfsyn_of_a_turned_jordan_block():
    """Three unstable poles in one: signals of 400 hide behind each other, and its Riccati equations have no digit."""
    loop = Loop(Draw("jordan", 4009902300, "scaled, then turned", 0.0))
    assert ncfsyn(loop.moved).info.optimum == pytest.approx(loop.design.info.optimum, rel=1e-6)


def test_norm_of_a_loop_of_condition_2e5():
    """2.8501584 is its largest singular value at 240 bits; powers of two do not balance it, |A| stays 1e5."""
    loop = Loop(Draw("double integrators", 538189, "scaled, then turned", 0.0))
    closed = gang_of_four(loop.moved).close(loop.controller)
    assert verify(closed).norm >= 2.8501584 * (1 - 1e-7)
    assert hinfnorm(closed)[0] == pytest.approx(2.8501584, rel=NUMBER)


@effort(20, 80)
def test_norms(count):
    def check(draw):
        loop = Loop(draw)
        G = loop.CL
        H = loop.whole(G)
        assert hinfnorm(H)[0] == pytest.approx(hinfnorm(G)[0], rel=NUMBER)
        assert verify(H).norm == pytest.approx(verify(G).norm, rel=NUMBER)
        assert verify(H).spectral_radius < (1 if G.discrete else 0)
        proper, moved = (StateSpace(S.A, S.B, S.C, 0 * S.D, S.dt) for S in (G, H))
        of_time = 1.0 if G.discrete else np.sqrt(loop.unit)
        assert h2norm(moved) / of_time == pytest.approx(h2norm(proper), rel=NUMBER)

    hold(check, count)


@pytest.mark.parametrize("method", ["zoh", "foh", "tustin", "midpoint"])
@effort(15, 80)
def test_c2d(count, method):
    """The response of the sampled plant, closed by a controller that was sampled exactly."""

    def check(draw):
        loop = Loop(draw)
        assume(not loop.G.discrete)
        dt = float(0.1 / np.abs(loop.CL.poles()).max())
        angles = np.geomspace(1e-3, 3, 20)
        P = c2d(loop.G, dt, method)
        try:
            K = ncfsyn(P).controller
        except SynthError:
            assume(False)
        F = loop_response(gang_of_four(P), K, angles / dt)
        Q = c2d(loop.moved, dt / loop.unit, method)
        assert Q.dt * loop.unit == pytest.approx(dt)
        assert apart(F, loop_response(gang_of_four(Q), replace(K, dt=Q.dt), angles / dt, loop.unit)) < NUMBER

    hold(check, count)


@effort(20, 80)
def test_regulators(count):
    """Costs go by T'S T over the unit of time, gains by K T; they are compared in states for which the cost is one."""

    def check(draw):
        loop = Loop(draw)
        G, H, T = loop.G, loop.moved, loop.plant.T
        regulator, of_time = (dlqr, 1.0) if G.discrete else (lqr, loop.unit)
        try:
            K, S, _ = regulator(G.A, G.B, G.C.T @ G.C, np.eye(G.nu))
        except AssumptionError:  # the outputs do not see a mode on the boundary
            assume(False)
        root = np.sqrt(of_time)
        C, B = H.C / (1.0 if G.discrete else root), H.B * (1.0 if G.discrete else root)
        Km, Sm, _ = regulator(H.A, B, C.T @ C, np.eye(G.nu))
        expected, gain = T.T @ S @ T / of_time, K @ T
        D = 1 / np.sqrt(np.diag(expected))
        assert np.abs(D[:, None] * (Sm - expected) * D).max() < NUMBER * len(D)
        assert np.linalg.norm((Km - gain) * D) < NUMBER * np.linalg.norm(gain * D)

    hold(check, count)


def hinfsyn_keeps_its_levels(draw: Draw, method: str) -> None:
    """In other coordinates and units of time, u and y, and in common units of w and of z, with which levels go."""
    rng = np.random.default_rng(draw.seed)
    P = GENERALISED[draw.family](rng)
    kind = "scaled" if AS_IT_IS in P.units.values() else draw.kind
    _, nw, nu, nz, ny = P.sizes
    design = hinfsyn(P, method=method)
    G = StateSpace(*P.system.matrices, P.dt)
    omega = frequencies(design.closed_loop, G)
    F, K = loop_response(P, design.controller, omega), Move(np.eye(design.controller.n), draw.unit)(design.controller)

    def lost(H: StateSpace) -> float:
        return apart(F, loop_response(GeneralizedPlant.partition(H, ny, nu), K, omega, draw.unit))

    H = holding(kind, G, rng, lost, draw.unit)(G)
    u, y, (w, z) = 10 ** rng.uniform(-3, 3, nu), 10 ** rng.uniform(-3, 3, ny), 10 ** rng.uniform(-3, 3, 2)
    into, out = np.concatenate([np.full(nw, w), u]), np.concatenate([np.full(nz, z), y])[:, None]
    moved = GeneralizedPlant.partition(StateSpace(H.A, H.B * into, out * H.C, out * H.D * into, H.dt), ny, nu)
    found = hinfsyn(moved, method=method)
    assert found.gamma / (w * z) == pytest.approx(design.gamma, rel=LEVEL)
    assert found.info.optimum is not None
    assert found.info.optimum / (w * z) == pytest.approx(design.info.optimum, rel=LEVEL)


@effort(25, 150)
def test_hinfsyn(count):
    hold(lambda draw: hinfsyn_keeps_its_levels(draw, "auto"), count, GENERALISED)


@effort(10, 80)
def test_hinfsyn_by_riccati_equations(count):
    hold(lambda draw: hinfsyn_keeps_its_levels(draw, "riccati"), count, GENERALISED)


@pytest.mark.slow
def test_hinfsyn_by_lmi():
    hold(lambda draw: hinfsyn_keeps_its_levels(draw, "lmi"), 10, GENERALISED)


@effort(10, 60)
def test_mixsyn(count):
    """A plant with a quasi-integrating weight of the error, the plant turned by itself."""

    def check(draw):
        rng = np.random.default_rng(draw.seed)
        a, b, pole = 10 ** rng.uniform(-2, 0.5), 10 ** rng.uniform(-3, -1), 10 ** rng.uniform(-8, -1)
        G = StateSpace([[-a, 0], [1, -b]], [[10 ** rng.uniform(-0.5, 1.5)], [0.0]], [[0.0, 1]], [[0.0]])
        W1, W2 = system([1 / rng.uniform(1.2, 2), 10 ** rng.uniform(-0.5, 1)], [1, pole]), 10 ** rng.uniform(-1, 0.5)
        design = mixsyn(G, W1, W2)
        omega, K = frequencies(design.closed_loop), Move(np.eye(3), draw.unit)(design.controller)
        F, V1 = loop_response(design.plant, design.controller, omega), Move(np.eye(1), draw.unit)(W1)
        moved = holding(draw.kind, G, rng, lambda H: apart(F, loop_response(augw(H, V1, W2), K, omega, draw.unit)),
                        draw.unit)(G)  # fmt: skip
        found = mixsyn(moved, V1, W2)
        assert found.gamma == pytest.approx(design.gamma, rel=LEVEL)
        assert found.info.optimum == pytest.approx(design.info.optimum, rel=LEVEL)

    hold(check, count)


@effort(10, 60)
def test_lqg_and_lqrd(count):
    """The loop of an LQG controller has the same H2 norm; a sampled regulator the same cost."""

    def check(draw):
        loop = Loop(draw)
        G, H, T, unit = loop.G, loop.moved, loop.plant.T, 1.0 if loop.G.discrete else loop.unit
        try:
            costs = [_lqg_cost(S) for S in (G, H)]
        except AssumptionError:
            assume(False)
        assert costs[1] / np.sqrt(unit) == pytest.approx(costs[0], rel=NUMBER)
        if G.discrete:
            return
        dt, root = float(0.1 / np.abs(loop.CL.poles()).max()), np.sqrt(unit)
        S = lqrd(G.A, G.B, G.C.T @ G.C, np.eye(G.nu), dt)[1]
        C = H.C / root
        Sm, expected = lqrd(H.A, H.B * root, C.T @ C, np.eye(G.nu), dt / unit)[1], T.T @ S @ T / unit
        D = 1 / np.sqrt(np.diag(expected))
        assert np.abs(D[:, None] * (Sm - expected) * D).max() < NUMBER * len(D)

    hold(check, count)


def _lqg_cost(G: StateSpace) -> float:
    """H2 norm from (noise of u and y) to (y, u) in the loop of the LQG controller for them."""
    C, B = (np.hstack([G.C, G.D]), np.vstack([G.B, G.D]))
    weight = C.T @ C + np.diag([0.0] * G.n + [1.0] * G.nu)
    noise = B @ B.T + np.diag([0.0] * G.n + [1.0] * G.ny)
    P = gang_of_four(replace(G, D=0 * G.D))
    return h2norm(P.close(lqg(replace(G, D=0 * G.D), (weight + weight.T) / 2, (noise + noise.T) / 2)))
