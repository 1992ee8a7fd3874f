"""Every public function takes every form of a linear system, and answers wrong arguments with a typed error.

The tables below name all public functions of `synth`: one that is missing from them fails the first test.
"""

from __future__ import annotations

import inspect
import itertools
from collections.abc import Callable
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
import scipy.signal as signal
from forms import DEN, DT, FORMS, OMEGA, plant
from wrong import WRONG

import synth
from synth.delivery.modelfiles import read, save_system
from synth.errors import ExportError, ModelError, SynthError

mpl.use("Agg")


def response(G: Any) -> np.ndarray:
    return synth.system(G).frequency_response(OMEGA)


def gamma(design: synth.Design) -> float:
    return design.verified_norm


def curve(ax: Any) -> np.ndarray:
    """What a picture shows."""
    shown = ax.lines[0].get_ydata()
    plt.close(ax.figure)
    return shown


def weighted(G: Any) -> Any:
    """A plant whose last output sees the given system."""
    return synth.augw(G, 1.0, 0.1).system.to_control()


ONES = dict.fromkeys(("Wdist", "Wnoise", "Wout", "Wact"), 1.0)
# z = G (w + u) + 0.1 u, y = G (w + u), with a G that the plant of this file stabilises
HELD = synth.system([[-1.0]], [[1.0, 1.0]], [[1.0], [-1.0]], [[0.0, 0.1], [0.0, 0.0]])


# function -> what it makes of one system at a timebase, as numbers that no coordinates change
OF_A_SYSTEM: dict[str, Callable[[Any, float], Any]] = {
    "accept": lambda G, dt: synth.accept(-0.3, synth.gang_of_four(G), dt=None if dt else 0.1).conditions[0].norm,
    "allmargin": lambda G, dt: [*synth.allmargin(G).phase, *synth.allmargin(G).gain],
    "augw": lambda G, dt: response(synth.augw(G, 1.0, 0.1).system),
    "balreal": lambda G, dt: response(synth.balreal(G).system),
    "bode": lambda G, dt: curve(synth.bode(G, omega=OMEGA)[0]),
    "c2d": lambda G, dt: response(synth.c2d(G, DT)) if not dt else 0.0,
    "d2c": lambda G, dt: response(synth.d2c(G)) if dt else 0.0,
    "diskmargin": lambda G, dt: synth.diskmargin(G).alpha,
    "diskmargin_at": lambda G, dt: synth.diskmargin_at(G, OMEGA),
    "diskmarginplot": lambda G, dt: curve(synth.diskmarginplot(G, omega=OMEGA)[0]),
    "dlqr": lambda G, dt: np.sort_complex(synth.dlqr(G, weights(G)[0], 2.0)[2]) if dt else 0.0,
    "feedback": lambda G, dt: response(synth.feedback(G, 1)) + response(synth.feedback(G, G)),
    "free_motion": lambda G, dt: synth.free_motion(G, np.zeros(2), dt=0.1, samples=3, held=np.ones((3, 1)))
    if not dt else 0.0,
    "fuel_mpc": lambda G, dt: synth.fuel_mpc(G, box=1.0, umax=1.0, horizon=3).step(
        synth.fuel_mpc(G, box=1.0, umax=1.0, horizon=3).init(), np.zeros(2), np.zeros(1)
    )[1] if dt and not synth.system(G).D.any() else 0.0,
    "gang_of_four": lambda G, dt: response(synth.gang_of_four(G).system),
    "gapmetric": lambda G, dt: np.array(synth.gapmetric(G, 2.0)),
    "gramians": lambda G, dt: np.linalg.eigvals(np.linalg.multi_dot(synth.gramians(G))),
    "h2norm": lambda G, dt: synth.h2norm(G),
    "h2syn": lambda G, dt: synth.h2syn(synth.GeneralizedPlant.four_block(G, **ONES).system.to_control(), 1, 1).gamma
    if dt or not synth.system(G).D.any() else 0.0,
    "hinfnorm": lambda G, dt: synth.hinfnorm(G)[0],
    "hinfsyn": lambda G, dt: gamma(synth.hinfsyn(synth.augw(G, 1.0, 0.1).system.to_control(), 1, 1)),
    "hsvd": lambda G, dt: synth.hsvd(G),
    "hsvplot": lambda G, dt: curve(synth.hsvplot(G)),
    "impulse": lambda G, dt: curve(synth.impulse(G, time=5.0)),
    "kalmd": lambda G, dt: response(synth.kalmd(G, 1.0, 0.1, DT).system[0, 0])
    if not dt and not synth.system(G).D.any() else 0.0,
    "lft": lambda G, dt: response(synth.lft(synth.augw(plant(dt), 1.0, 0.1).system, G)),
    "lqg": lambda G, dt: response(
        synth.lqg(G, *(np.block([[M, np.zeros((2, 1))], [np.zeros((1, 2)), 1.0]]) for M in weights(G)))
    ),
    "lqgd": lambda G, dt: response(
        synth.lqgd(G, *(np.block([[M, np.zeros((2, 1))], [np.zeros((1, 2)), 1.0]]) for M in weights(G)), DT)
    ) if not dt else 0.0,
    "lqr": lambda G, dt: np.sort_complex(synth.lqr(G, weights(G)[0], 2.0)[2]),
    "lqrd": lambda G, dt: np.sort_complex(synth.lqrd(G, weights(G)[0], 2.0, DT)[2])
    if not dt else 0.0,
    "margin": lambda G, dt: [getattr(synth.margin(G), k) for k in ("gain_up", "gain_down", "phase", "delay")],
    "margins": lambda G, dt: synth.margins(G, 0.3).disk,
    "minimum_fuel": lambda G, dt: synth.minimum_fuel(G, [[2.0], [2.0], [2.0]], 1.0, dt=0.5).upper if not dt else 0.0,
    "minreal": lambda G, dt: response(synth.minreal(G)),
    "mixsyn": lambda G, dt: gamma(synth.mixsyn(G, 1.0, 0.1)),
    "mussv": lambda G, dt: synth.mussv(G, [(1, 1)]).upper,
    "musyn": lambda G, dt: synth.musyn(
        synth.augw(G, 1.0, 0.1).system.to_control(), 1, 1, [(1, 2)], iterations=1
    ).mu.upper,
    "ncfmargin": lambda G, dt: synth.ncfmargin(G, 0.3),
    "ncfsyn": lambda G, dt: gamma(synth.ncfsyn(G)),
    "nichols": lambda G, dt: curve(synth.nichols(G, omega=OMEGA)),
    "nugap": lambda G, dt: synth.nugap([G, 2.0]).radius,
    "nyquist": lambda G, dt: curve(synth.nyquist(G, omega=OMEGA)),
    "pzmap": lambda G, dt: np.sort(np.abs(curve(synth.pzmap(G)))),
    "sdh2norm": lambda G, dt: synth.sdh2norm(HELD, G) if dt else synth.sdh2norm(weighted(G), 0.3, DT, held=0),
    "sdhinfnorm": lambda G, dt: synth.sdhinfnorm(HELD, G).upper
    if dt else synth.sdhinfnorm(weighted(G), 0.3, DT, held=0).upper,
    "sdhinfsyn": lambda G, dt: gamma(synth.sdhinfsyn(weighted(G), DT, 1, 1)) if not dt else 0.0,
    "reduce": lambda G, dt: response(synth.reduce(G, 1)) + response(synth.reduce(plant(dt), 1, output_weight=G)),
    "rounding": lambda G, dt: synth.rounding(G, inputs=1.0).commands if dt else 0.0,
    "series": lambda G, dt: response(synth.series(G, G)) + response(synth.series(G, 2.0)),
    "sigma": lambda G, dt: curve(synth.sigma(G, omega=OMEGA)),
    "step": lambda G, dt: curve(synth.step(G, time=5.0)),
    "synthesize": lambda G, dt: synth.synthesize(
        synth.augw(G, 1.0, 0.1).system.to_control(), 1, 1, minimize=synth.Hinf()
    ).gamma,
    "system": lambda G, dt: response(G),
    "ucover": lambda G, dt: np.abs(synth.ucover([2.0], G, 0, "additive").weight.D),
    "verify": lambda G, dt: synth.verify(G).norm,
}  # fmt: skip
OF_ANOTHER_SYSTEM = {"export", "mpc"}  # tested below
WITHOUT_A_SYSTEM = {
    "care", "dare", "keygen", "sign", "verify_signature", "pade", "pade_error", "proportional_derivative",
    "quaternion_lqr", "quaternion_pd", "quaternion_pid", "read", "read_study",
    "robstab", "stability_margin", "state_feedback", "ultidyn", "ureal", "wcgain", "worst_gain",
}  # fmt: skip


def weights(G: Any) -> tuple[np.ndarray, np.ndarray]:
    H = synth.system(G)
    return H.C.T @ H.C, H.B @ H.B.T


def functions() -> set[str]:
    return {name for name in synth.__all__ if inspect.isfunction(getattr(synth, name))}


def test_the_tables_name_every_public_function():
    assert functions() == {*OF_A_SYSTEM, *OF_ANOTHER_SYSTEM, *WITHOUT_A_SYSTEM}


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("dt", [0.0, DT])
def test_every_form_is_the_same_system(form, dt):
    np.testing.assert_allclose(response(FORMS[form](dt)), response(plant(dt)), rtol=1e-8)
    assert synth.system(FORMS[form](dt)).dt == dt


@pytest.mark.parametrize("dt", [0.0, DT])
@pytest.mark.parametrize("function", sorted(OF_A_SYSTEM))
def test_every_function_takes_every_form(function, dt):
    expected = OF_A_SYSTEM[function](plant(dt), dt)
    for name, form in FORMS.items():
        found = OF_A_SYSTEM[function](form(dt), dt)
        np.testing.assert_allclose(found, expected, rtol=2e-3, atol=1e-9, err_msg=name)  # 1e-3 is a design's tolerance


@pytest.mark.parametrize("form", FORMS)
def test_controllers_of_every_form_leave_as_the_same_file(form, tmp_path):
    synth.export(FORMS[form](DT), "json", tmp_path, name="found")
    synth.export(plant(DT), "json", tmp_path, name="expected")
    found, expected = (read(tmp_path / f"{name}.json").system for name in ("found", "expected"))
    np.testing.assert_allclose(response(found), response(expected), rtol=1e-8)


STATES = synth.c2d(synth.system([[0, 1], [0, 0]], [0, 1], np.eye(2), 0), DT)


@pytest.mark.parametrize(
    "model",
    [STATES.to_control(), (*STATES.matrices, DT), signal.StateSpace(*STATES.matrices, dt=DT), STATES],
    ids=["control", "tuple", "scipy", "StateSpace"],
)
def test_mpc_takes_models_of_every_form_that_has_a_state(model):
    controller = synth.mpc(model, Q=[1.0, 0.1], R=1.0, Np=5, Nc=3, umin=-1.0, umax=1.0)
    _, u = controller.step(controller.init(), np.array([1.0, 0.0]), np.zeros(2))
    reference = synth.mpc(STATES, Q=np.diag([1.0, 0.1]), R=[[1.0]], Np=5, Nc=3, umin=-1.0, umax=1.0)
    np.testing.assert_allclose(u, reference.step(reference.init(), np.array([1.0, 0.0]), np.zeros(2))[1], rtol=1e-9)


I, Z = np.eye(2), np.zeros((2, 2))
CONTINUOUS, SAMPLED = plant(0.0), plant(DT)
WEIGHTED = synth.augw(CONTINUOUS, 1.0, 0.1)
STRICT = synth.system([1.0], DEN)
UNCERTAIN = synth.UncertainSystem([[synth.ureal("J", 1.0, percentage=20)]], -1.0, 1.0, 1.0)

# function -> a call that works, by parameter
RIGHT: dict[str, dict[str, Any]] = {
    "accept": {"design": synth.system(-0.3), "plant": synth.gang_of_four(CONTINUOUS), "level": None, "dt": 0.1,
               "form": "controller", "umin": -1.0, "umax": 1.0, "antiwindup": None, "overload": 2.0,
               "requirements": None, "precision": "float32", "inputs": None},
    "augw": {"G": CONTINUOUS, "W1": 1.0, "W2": 0.1, "W3": 0.2},
    "c2d": {"G": CONTINUOUS, "dt": 0.1, "method": "tustin", "prewarp": 1.0, "delay": 0.2, "output_delay": 0.1,
            "tol": 1e-9},
    "balreal": {"G": CONTINUOUS},
    "care": {"A": Z, "B": I, "Q": I, "R": I, "N": None, "E": None},
    "d2c": {"G": SAMPLED, "method": "tustin", "prewarp": 1.0},
    "dare": {"A": Z, "B": I, "Q": I, "R": I, "N": None, "E": None},
    "allmargin": {"L": CONTINUOUS, "sign": -1, "delay": 0.1},
    "diskmargin": {"L": CONTINUOUS, "sign": -1, "skew": 0.0},
    "diskmargin_at": {"L": CONTINUOUS, "omega": [1.0, 2.0], "sign": -1, "skew": 0.0},
    "diskmarginplot": {"systems": CONTINUOUS, "ax": None, "omega": None, "skew": 0.0},
    "dlqr": {"A": 0.5 * I, "B": I, "Q": I, "R": 1.0, "N": None, "E": None},
    "export": {"design": SAMPLED, "format": "json", "folder": "out", "name": "name", "force": True,
               "allow_unstable": False, "umin": None, "umax": None, "antiwindup": None, "dtype": "double",
               "inputs": None, "self_test": True, "acceptance": None, "certificate": None},
    "feedback": {"G": CONTINUOUS, "K": 0.3, "sign": -1},
    "free_motion": {"G": CONTINUOUS, "x0": [1.0, 0.0], "dt": 0.1, "samples": 3, "held": None},
    "fuel_mpc": {"model": synth.c2d(STRICT, DT), "box": 1.0, "umax": 1.0, "horizon": 3, "settle": 0, "forecast": None,
                 "penalty": 100.0},
    "gang_of_four": {"G": CONTINUOUS},
    "gapmetric": {"G1": CONTINUOUS, "G2": CONTINUOUS, "delay": 0.0},
    "gramians": {"G": CONTINUOUS},
    "h2norm": {"system": STRICT},
    "h2syn": {"P": 1 - I, "nmeas": 1, "ncon": 1, "strictly_proper": True, "ncont": 1},
    "hinfnorm": {"system": CONTINUOUS, "tol": 1e-9},
    "hinfsyn": {"P": WEIGHTED.system, "nmeas": 1, "ncon": 1, "method": "riccati", "gamma": None, "tol": 1e-3,
                "ncont": 1},
    "hsvd": {"G": CONTINUOUS},
    "hsvplot": {"systems": CONTINUOUS, "ax": None},
    "kalmd": {"sys": STRICT, "Qn": 1.0, "Rn": 0.1, "dt": 0.1},
    "lft": {"P": WEIGHTED.system, "K": CONTINUOUS, "nmeas": 1, "ncon": 1},
    "lqg": {"G": CONTINUOUS, "QXU": np.eye(3), "QWV": np.eye(3)},
    "lqgd": {"G": CONTINUOUS, "QXU": np.eye(3), "QWV": np.eye(3), "dt": 0.1, "current": False},
    "lqr": {"A": Z, "B": I, "Q": I, "R": 1.0, "N": None, "E": None},
    "lqrd": {"A": Z, "B": I, "Q": I, "R": 1.0, "dt": 0.1, "N": None},
    "margin": {"L": CONTINUOUS, "sign": -1, "delay": 0.1},
    "margins": {"P": CONTINUOUS, "K": 0.3, "sign": -1, "delay": 0.1},
    "minimum_fuel": {"G": STRICT, "free": [[2.0]] * 3, "box": 1.0, "dt": 0.5, "settle": 1},
    "minreal": {"G": CONTINUOUS, "tol": 1e-8},
    "mixsyn": {"G": CONTINUOUS, "W1": 1.0, "W2": 0.1, "W3": None, "shift": 0.0, "method": "riccati", "gamma": None,
               "tol": 1e-3},
    "mpc": {"model": STATES, "Q": 1.0, "R": 1.0, "Np": 4, "Nc": 2, "umin": -1.0, "umax": 1.0, "form": "velocity",
            "terminal": None, "ymin": None, "ymax": None, "hmax": None, "delay": 0, "penalty": 10.0},
    "mussv": {"M": np.array([[1, 2j], [3, 4]]), "blocks": [(-1, 0), (1, 1)], "tol": 1e-3},
    "musyn": {"P": WEIGHTED.system, "nmeas": 1, "ncon": 1, "blocks": [(1, 2)], "iterations": 1, "order": 1,
              "tol": 1e-3},
    "ncfmargin": {"P": CONTINUOUS, "K": 0.3, "sign": -1},
    "ncfsyn": {"G": CONTINUOUS, "W1": 1.0, "W2": 1.0, "gamma_factor": 1.1, "gamma": None, "method": "riccati"},
    "nugap": {"models": [CONTINUOUS, 2.0], "nominal": CONTINUOUS, "delays": [0.0, 0.0]},
    **{name: {"systems": CONTINUOUS, "ax": None, "omega": None} for name in ("bode", "nichols", "nyquist", "sigma")},
    **{name: {"systems": CONTINUOUS, "ax": None, "time": None} for name in ("impulse", "step")},
    "pade": {"delay": 0.3, "n": 3},
    "pade_error": {"delay": 0.3, "n": 3, "omega": [1.0, 2.0]},
    "pzmap": {"systems": CONTINUOUS, "ax": None},
    "proportional_derivative": {"inertia": [1.0, 2.0, 3.0], "wn": 0.1, "zeta": 0.7, "dt": 0.1},
    "quaternion_lqr": {"inertia": np.eye(3), "dt": 0.1, "Q": None, "R": None, "short_way": True},
    "quaternion_pd": {"inertia": np.eye(3), "wn": 0.1, "zeta": 0.7, "dt": 0.1},
    "quaternion_pid": {"inertia": np.eye(3), "wn": 0.1, "zeta": 0.7, "dt": 0.1, "integral_time": 100.0,
                       "zone_deg": 5.0},
    "read": {"path": "plant.json"},
    "read_study": {"path": "nothing.toml"},
    "reduce": {"G": CONTINUOUS, "order": 1, "error": None, "loss": None, "method": "auto", "input_weight": None,
               "output_weight": CONTINUOUS, "plant": None},
    "rounding": {"controller": SAMPLED, "inputs": 1.0, "precision": "float32", "plant": -0.1, "commands": 1.0,
                 "umin": -1.0, "umax": 1.0, "antiwindup": None},
    "series": {"G": CONTINUOUS, "H": CONTINUOUS},
    "sdhinfsyn": {"P": HELD, "h": DT, "nmeas": 1, "ncon": 1, "delay": 0.1, "held": None, "tol": 1e-3},
    **{
        name: {"P": HELD, "K": SAMPLED, "h": None, "delay": 0.1, "held": None} | more
        for name, more in (("sdh2norm", {}), ("sdhinfnorm", {"tol": 1e-6}))
    },
    "keygen": {"path": "nothing"},
    "sign": {"path": "file", "key": "pair.key", "passphrase": None, "force": True},
    "verify_signature": {"path": "file", "key": "pair.pub"},
    "state_feedback": {"K": np.ones((1, 2)), "dt": 0.1},
    "synthesize": {"P": WEIGHTED.system, "nmeas": 1, "ncon": 1, "minimize": synth.Hinf(), "subject_to": (),
                   "method": "standard"},
    "system": {"dt": 0.0, "u": ("u",), "y": ("y",), "units": None},
    **{
        name: {"loop": UNCERTAIN, "controller": None, "tol": 1e-4, "boxes": 100} | more
        for name, more in (("wcgain", {"dynamics": None}), ("worst_gain", {"dynamics": None}),
                           ("robstab", {"growing": ("J",)}), ("stability_margin", {"growing": ("J",)}))
    },
    "ucover": {"models": [CONTINUOUS, 2.0], "nominal": CONTINUOUS, "order": 1, "kind": "additive"},
    "ultidyn": {"name": "flex", "shape": (1, 2), "bound": 0.1, "weight": CONTINUOUS},
    "ureal": {"name": "J", "nominal": 1.0, "range": (0.5, 2.0), "percentage": None, "plusminus": None},
    "verify": {"system": CONTINUOUS},
}  # fmt: skip

# whose label and style are matplotlib's
STYLED = {"bode", "diskmarginplot", "hsvplot", "impulse", "nichols", "nyquist", "pzmap", "sigma", "step"}
POSITIONAL = {"dlqr", "lqr", "lqrd", "system"}  # whose parameters are not in their signature


# parameters that a message calls by another word
IMPLIED = {
    "accept": ("design",),  # the controller
    "export": ("design",),
    "hinfnorm": ("system",),
    "read": ("path",),  # the file
    "read_study": ("path",),  # the file
}


def refusal(call: Callable[[], Any], what: str) -> str | None:
    """What is said of wrong arguments; None where the call works, or is refused for what the plant is."""
    try:
        call()
        plt.close("all")
    except (ModelError, ExportError) as error:
        return str(error)
    except SynthError:
        return None
    except Exception as error:
        raise AssertionError(f"{what} ended in a bare {type(error).__name__}: {error}") from error
    return None


def write_files() -> None:
    """Those that the right calls read."""
    with open("file", "w") as file:
        file.write("content")
    synth.keygen("pair")
    synth.sign("file", "pair.key")
    save_system("plant.json", CONTINUOUS)


SLOW = {"accept"}  # more than three seconds
FUNCTIONS = [pytest.param(f, marks=pytest.mark.slow) if f in SLOW else f for f in sorted(RIGHT)]


@pytest.mark.parametrize("function", FUNCTIONS)
def test_wrong_arguments_are_named(function, tmp_path, monkeypatch):
    """Every wrong value for every parameter in turn: it is taken, or refused by an error that names the parameter."""
    monkeypatch.chdir(tmp_path)
    write_files()
    f, right = getattr(synth, function), RIGHT[function]
    first = ([1.0], [1.0, 1.0]) if function == "system" else ()
    for parameter, (wrong, value) in itertools.product(right, WRONG.items()):
        text = refusal(lambda: f(*first, **{**right, parameter: value}), f"{parameter} = {wrong}")  # noqa: B023
        if text is not None:
            assert len(text) >= 20, (parameter, wrong, text)
            assert parameter in text or parameter in IMPLIED.get(function, ()), (parameter, wrong, text)


def test_the_right_calls_work(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_files()
    assert set(RIGHT) == {*OF_A_SYSTEM, *OF_ANOTHER_SYSTEM, *WITHOUT_A_SYSTEM}
    for function, right in RIGHT.items():
        if function == "read_study":
            continue
        first = ([1.0], [1.0, 1.0]) if function == "system" else ()
        getattr(synth, function)(*first, **right)
        plt.close("all")
        if function in STYLED:
            assert set(right) | {"label", "style"} == set(inspect.signature(getattr(synth, function)).parameters)
        elif function not in POSITIONAL:
            assert set(right) == set(inspect.signature(getattr(synth, function)).parameters), function
