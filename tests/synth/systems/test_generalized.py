"""The generalised plant: seed equation (27) signal by signal, partitions, names, errors."""

import numpy as np
import pytest
import scipy.linalg as sla
from literature import cubesat_model, cubesat_pecorilla2024

from synth.errors import ModelError
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace


def test_tracking_is_the_block_diagram_of_figure_5():
    """Seed equation (23): z1 = We (Wr r - P0 (Wp n + u)), z2 = Wa u, y = Wr r - P0 (Wp n + u) - Wd d."""
    rng = np.random.default_rng(0)
    m, q = 2, 3
    G = StateSpace(0.5 * np.eye(4), rng.normal(size=(4, m)), rng.normal(size=(q, 4)), rng.normal(size=(q, m)), 0.5)
    W = {name: np.diag(rng.uniform(1, 2, size)) for name, size in
         {"Wproc": m, "Wact": m, "Wdist": q, "Werr": q, "Wr": q}.items()}  # fmt: skip
    P = GeneralizedPlant.tracking(G, **W)
    P0 = G.frequency_response(1.1)
    O = np.zeros
    from_r = np.vstack([W["Werr"] @ W["Wr"], O((m, q)), W["Wr"]])
    from_n = np.vstack([-W["Werr"] @ P0 @ W["Wproc"], O((m, m)), -P0 @ W["Wproc"]])
    from_d = np.vstack([O((q, q)), O((m, q)), -W["Wdist"]])
    from_u = np.vstack([-W["Werr"] @ P0, W["Wact"], -P0])
    expected = np.hstack([from_r, from_n, from_d, from_u])
    np.testing.assert_allclose(P.system.frequency_response(1.1), expected, rtol=1e-12, atol=1e-12)


def test_cubesat_plant_has_the_sizes_of_the_study():
    P = cubesat_pecorilla2024()
    assert P.sizes == (6, 15, 3, 9, 6)
    assert P.w[0] == "reference y0"
    assert P.y[5] == "error y5"


def test_partition_and_system_are_inverse():
    P = cubesat_pecorilla2024()
    Q = GeneralizedPlant.partition(P.system.to_control(), 6, 3)
    for name in ("A", "B1", "B2", "C1", "D11", "D12", "C2", "D21", "D22"):
        np.testing.assert_array_equal(getattr(P, name), getattr(Q, name))


def test_bad_plants_are_named():
    G = cubesat_model()
    W = {"Wproc": np.eye(3), "Wact": np.eye(3), "Wdist": np.eye(6), "Werr": np.eye(6), "Wr": np.eye(6)}
    with pytest.raises(ModelError, match="Wr is 2 x 2 where 6 x 6 is needed"):
        GeneralizedPlant.tracking(G, **(W | {"Wr": np.eye(2)}))
    with pytest.raises(ModelError, match="nmeas is 9"):
        GeneralizedPlant.partition(G, 9, 1)
    with pytest.raises(ModelError, match="channel w has names"):
        GeneralizedPlant.tracking(G, **W, u=("a", "a", "b"))
    with pytest.raises(ModelError, match="units are given for"):
        GeneralizedPlant(*(np.eye(1) for _ in range(9)), units={"nobody": "m"})
    with pytest.raises(ModelError, match="every channel needs at least one signal"):
        GeneralizedPlant(np.eye(1), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)),
                         np.ones((1, 1)), np.zeros((0, 1)), np.zeros((0, 1)), np.zeros((0, 1)))  # fmt: skip


def dynamic(seed: int, size: int, dt: float) -> StateSpace:
    """A stable weight with two states."""
    rng = np.random.default_rng(seed)
    A = np.diag([0.5, -0.2]) if dt else np.diag([-1.0, -30.0])
    return StateSpace(A, rng.normal(size=(2, size)), rng.normal(size=(size, 2)), np.eye(size), dt)


@pytest.mark.parametrize("dt", [0.0, 0.1])
def test_weights_with_states_weigh_as_constant_ones_do_at_every_frequency(dt):
    rng = np.random.default_rng(3)
    G = StateSpace(0.3 * rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(1, 3)), [[0.1, 0.2]], dt)
    first, second = dynamic(1, 1, dt), dynamic(2, 2, dt)
    lag = StateSpace([[0.9 if dt else -3.0]], [[1.0]], [[2.0]], [[0.5]], dt)  # of one signal, for every channel
    cases = {
        "tracking": {"Wr": first, "Wproc": 2.0, "Wdist": first, "Werr": lag, "Wact": second},
        "four_block": {"Wdist": second, "Wnoise": lag, "Wout": first, "Wact": lag},
    }
    sizes = {"tracking": (1, 2, 1, 1, 2), "four_block": (2, 1, 1, 2)}  # signals of each weight; those of z come last
    for name, weights in cases.items():
        make = getattr(GeneralizedPlant, name)
        P, unweighted = make(G, **weights), make(G, **dict.fromkeys(weights, 1.0))
        assert P.sizes[0] > G.n
        assert P.sizes[1:] == unweighted.sizes[1:]
        for w in (0.01, 0.7, 20.0):
            at = [response(W, w, k) for W, k in zip(weights.values(), sizes[name], strict=True)]
            before, after = sla.block_diag(*at[:-2], np.eye(G.nu)), sla.block_diag(*at[-2:], np.eye(G.ny))
            expected = after @ unweighted.system.frequency_response(w) @ before
            np.testing.assert_allclose(P.system.frequency_response(w), expected, rtol=1e-9, atol=1e-12)


def response(W, w: float, size: int) -> np.ndarray:
    """A weight at a frequency, for `size` signals."""
    if not isinstance(W, StateSpace):
        return W * np.eye(size)
    found = W.frequency_response(w)
    return np.kron(np.eye(size), found) if found.shape == (1, 1) else found


def test_weights_that_do_not_fit_are_named():
    G = StateSpace([[0.0]], [[1.0]], [[1.0]], [[0.0]])
    constant = {"Wdist": 1.0, "Wnoise": 1.0, "Wout": 1.0, "Wact": 1.0}
    with pytest.raises(ModelError, match="Wout is 2 x 2"):
        GeneralizedPlant.four_block(G, **{**constant, "Wout": dynamic(0, 2, 0.0)})
    with pytest.raises(ModelError, match="the plant and Wact have timebases"):
        GeneralizedPlant.four_block(G, **{**constant, "Wact": dynamic(0, 1, 0.1)})
    with pytest.raises(ModelError, match="Wact"):
        GeneralizedPlant.four_block(G, **{**constant, "Wact": "x"})
