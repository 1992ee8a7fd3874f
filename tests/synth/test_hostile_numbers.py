"""Numbers at the ends of the doubles: an answer or an error of ours, and copies that are what they are copies of."""

import copy
import pickle
import warnings
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from together import designed

from synth import (
    GeneralizedPlant,
    LinearController,
    StateSpace,
    SynthError,
    c2d,
    diskmargin,
    hinfnorm,
    hinfsyn,
    margins,
    ncfsyn,
)

G = StateSpace([[-1, 2], [0, -3]], [[0], [1]], [[1, 0]], [[0]])
INTEGRATORS = StateSpace([[0, 1], [0, 0]], [[0], [1]], np.eye(2), np.zeros((2, 1)))
WEIGHTS = {
    "Wproc": [[0.1]], "Wdist": 0.01 * np.eye(2), "Werr": np.diag([1.0, 0.1]), "Wact": [[0.5]], "Wr": 0.1 * np.eye(2)
}  # fmt: skip
SCALES = (1e-320, 1e-300, 1e-200, 1e200, 1e300)


def tracking(scale=1.0, where="A"):
    """The plant of the README with one of its matrices times a number."""
    system = {name: getattr(INTEGRATORS, name) * (scale if name == where else 1.0) for name in "ABC"}
    weights = {name: np.asarray(W) * (scale if name == where else 1.0) for name, W in WEIGHTS.items()}
    return GeneralizedPlant.tracking(c2d(StateSpace(**system, D=INTEGRATORS.D), 0.1), **weights)


def answers(function):
    """Whether there is an answer; any error but one of ours goes on."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # overflow is what is asked for here
        try:
            function()
        except SynthError:
            return False
        return True


@pytest.mark.parametrize("where", ["Wact", "Wdist", "B"])
@pytest.mark.parametrize("scale", [1e-320, 1e200])
def test_a_synthesis_of_hostile_numbers_ends_in_an_answer_or_an_error_of_ours(where, scale):
    answers(lambda: hinfsyn(tracking(scale, where)))


@pytest.mark.slow
@pytest.mark.parametrize("where", [*WEIGHTS, "A", "B", "C"])
@pytest.mark.parametrize("scale", SCALES)
def test_every_synthesis_of_hostile_numbers_does(where, scale):
    answers(lambda: hinfsyn(tracking(scale, where)))


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("function", [hinfnorm, lambda H: margins(H, 1.0), diskmargin, ncfsyn, lambda H: c2d(H, 0.1)])
def test_measuring_hostile_numbers_ends_in_an_answer_or_an_error_of_ours(function, scale):
    for H in (StateSpace(G.A, scale * G.B, G.C, G.D), StateSpace(scale * G.A, scale * G.B, G.C, G.D)):
        answers(lambda H=H: function(H))


def frozen(value):
    """Whether every array of an object is read-only."""
    if isinstance(value, np.ndarray):
        return not value.flags.writeable
    return all(frozen(item) for item in vars(value).values()) if hasattr(value, "__dict__") else True


def test_copies_and_pickles_are_as_immutable_as_the_systems():
    design = hinfsyn(tracking())
    for system in (G, design.plant, design.controller, LinearController.of(design.controller)):
        for other in (copy.copy(system), copy.deepcopy(system), pickle.loads(pickle.dumps(system))):
            assert frozen(other)
            np.testing.assert_array_equal(other.A, system.A)
    for other in (copy.deepcopy(design), pickle.loads(pickle.dumps(design))):
        assert all(frozen(part) for part in (other.plant, other.controller, other.closed_loop))


def test_threads_design_what_one_thread_designs_bit_for_bit():
    weights = [1.0 + 0.1 * k for k in range(8)] * 4
    alone = {W: designed(W) for W in set(weights)}
    with ThreadPoolExecutor(8) as pool:
        assert list(pool.map(designed, weights)) == [alone[W] for W in weights]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::RuntimeWarning")  # of fork beside threads
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_processes_design_what_this_one_designs_bit_for_bit(method):
    import multiprocessing

    if method not in multiprocessing.get_all_start_methods():
        pytest.skip(f"this system has no {method}")
    weights = [1.0, 1.3, 2.0, 5.0]
    with multiprocessing.get_context(method).Pool(2) as pool:
        assert pool.map(designed, weights) == [designed(W) for W in weights]
