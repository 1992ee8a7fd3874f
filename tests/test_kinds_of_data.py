"""Data that is not what doubles hold is named in every door: nothing is converted in silence."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from test_doors import RIGHT as FUNCTIONS
from test_doors_of_classes import RIGHT as CLASSES

import synth
from plants.checks import real
from plants.errors import ScenarioError
from synth.errors import ModelError

# kind -> array of doubles -> the same as that kind, and what the message must say of it
KINDS: dict[str, tuple[Any, str]] = {
    "complex": (lambda M: M + 1e-3j, "complex"),
    "single precision": (lambda M: M.astype(np.float32), "float32, of 7 digits"),
    "half precision": (lambda M: M.astype(np.float16), "float16, of 4 digits"),
    "long doubles": (lambda M: M.astype(np.longdouble), "longdouble|float96|float128"),
    "masked": (lambda M: np.ma.masked_array(M, mask=np.ones_like(M, bool)), "masked entries"),
    "objects": (lambda M: M.astype(object), "holds objects"),
    "dates": (lambda M: (1000 * M).astype("datetime64[D]"), "a date"),
    "spans of time": (lambda M: (1000 * M).astype("timedelta64[s]"), "a time span"),
    "text": (lambda M: M.astype(str), "text"),
    "single precision of JAX": (lambda M: jnp.asarray(M, jnp.float32), "float32, of 7 digits"),
    "lists of single precision": (lambda M: [*np.atleast_1d(M).astype(np.float32)], "float32"),
    "lists of masked rows": (lambda M: [np.ma.masked_array(row, mask=True) for row in np.atleast_1d(M)], "masked"),
    "lists with the masked constant": (lambda M: [np.ma.masked, *np.ravel(M)[1:]], "masked entries"),
    "lists of fractions": (lambda M: [Fraction(1, 3) for _ in np.ravel(M)], "holds objects, such as Fraction"),
    "lists of decimals": (lambda M: [Decimal("0.1") for _ in np.ravel(M)], "holds objects, such as Decimal"),
}
ARRAYS = {  # doors that take an array by these parameters
    "care": "ABQR", "dare": "ABQR", "dlqr": "ABQR", "lqr": "ABQR", "lqrd": "ABQR", "lqg": ("QXU", "QWV"),
    "lqgd": ("QXU", "QWV"), "kalmd": ("Qn", "Rn"),
    "mpc": ("Q", "R", "umin", "umax"), "fuel_mpc": ("box", "umax"), "minimum_fuel": ("free", "box"),
    "free_motion": ("x0",), "augw": ("W1", "W2", "W3"), "state_feedback": "K", "quaternion_lqr": ("inertia",),
    "quaternion_pd": ("inertia",), "proportional_derivative": ("inertia",), "diskmargin_at": ("omega",),
    "accept": ("umin", "umax"), "SequentialController.of": ("umin", "umax"),
    "StateSpace": "ABCD", "GeneralizedPlant": ("A", "B1", "D11", "D22"), "StateSpace.transform": "T",
    "GeneralizedPlant.tracking": ("Wproc", "Wdist", "Werr", "Wact", "Wr"),
    "GeneralizedPlant.four_block": ("Wdist", "Wnoise", "Wout", "Wact"), "AntiWindup.of": ("umin", "umax"),
    "StateSpace.frequency_response": ("omega",),
}  # fmt: skip
DOORS = {**{name: (getattr(synth, name), right) for name, right in FUNCTIONS.items()}, **CLASSES}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("door", ARRAYS)
def test_every_door_names_the_kind(door, kind, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, right = DOORS[door]
    convert, said = KINDS[kind]
    for parameter in ARRAYS[door]:
        value = 1.0 if right[parameter] is None else right[parameter]
        wrong = convert(np.asarray(value, float))
        with pytest.raises(ModelError) as caught:
            call(**{**right, parameter: wrong})
        assert re.search(said, str(caught.value)), (parameter, str(caught.value))
        assert ";" in str(caught.value)  # and the remedy


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("place", range(4))
def test_systems_of_every_form_name_the_kind(kind, place):
    convert, said = KINDS[kind]
    parts = [np.array([[0.5]]), np.array([[1.0]]), np.array([[1.0]]), np.array([[0.25]])]
    wrong = [*parts[:place], convert(parts[place]), *parts[place + 1 :]]
    forms = [tuple(wrong), dict(zip("ABCD", wrong, strict=True))]
    if place < 2:
        polynomial = convert(np.array([1.0, 0.5]))
        forms += [(polynomial, [1.0, 2.0], 0.1) if place else ([1.0], polynomial, 0.1)]
    for form in forms:
        with pytest.raises(ModelError, match=said):
            synth.system(form)


@pytest.mark.parametrize("kind", ["single precision", "masked", "objects", "single precision of JAX"])
def test_roots_and_numbers_name_the_kind(kind):
    convert, said = KINDS[kind]
    for key in ("zeros", "poles"):
        roots = {"zeros": [-0.5], "poles": [-1.0], "gain": 1.0, "dt": 0.1, key: convert(np.array([-1.0]))}
        with pytest.raises(ModelError, match=said):
            synth.system(roots)
    with pytest.raises(ModelError, match=r"dt (is float32|has masked|holds objects)"):
        synth.system([1.0], [1.0, 1.0], dt=np.asarray(convert(np.array(0.1))) if kind != "masked" else np.ma.masked)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if kind != "text"])
def test_measurements_of_predictive_controllers_name_the_kind(kind):
    convert, said = KINDS[kind]
    G = synth.c2d(synth.system([[0, 1], [0, 0]], [0, 1], np.eye(2), 0), 0.5)
    fuel = synth.fuel_mpc(synth.c2d(synth.system([1.0], [1.0, 0.4, 1.0]), 0.5), box=1.0, umax=1.0, horizon=3)
    for controller in (synth.mpc(G, Q=1.0, R=1.0, Np=4, Nc=2, umin=-1.0, umax=1.0), fuel):
        with pytest.raises(ModelError, match=said):
            controller.step(controller.init(), convert(np.array([0.1, 0.2])), np.zeros(2))


def test_what_doubles_hold_is_taken():
    """Whole numbers, flags of a matrix, big whole numbers of a file, complex numbers without imaginary part."""
    for A in ([[1]], np.array([[1]]), np.uint8([[1]]), [[np.int64(1)]], np.array([[1 + 0j]]), [[np.float64(1)]],
              np.ma.masked_array([[1.0]], mask=[[False]]), [[10**18]], [[10**20]]):  # fmt: skip
        G = synth.StateSpace(A, [[1]], [[1]], [[0]], 0.1)
        assert G.A[0, 0] in (1.0, 1e18, 1e20)


@pytest.mark.parametrize("kind", ["complex", "masked", "objects", "dates", "text"])
def test_plants_name_the_kind_too(kind):
    convert, _ = KINDS[kind]
    with pytest.raises(ScenarioError, match="mass"):
        real("mass", convert(np.array([1.0, 2.0])), (2,))
