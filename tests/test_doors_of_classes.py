"""Constructors and methods answer wrong arguments as the functions do: with a typed error that says what to pass."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from test_doors import CONTINUOUS, HELD, SAMPLED, UNCERTAIN, WEIGHTED, refusal
from wrong import WRONG

import synth

I, G = np.eye(2), CONTINUOUS
NINE = {"A": I / 2, "B1": I, "B2": I[:, :1], "C1": I, "D11": 0 * I, "D12": I[:, :1], "C2": I[:1], "D21": I[:1]}


def shaped() -> synth.Design:
    return synth.ncfsyn(synth.c2d(synth.system([1], [1, 1]), 0.1))


# name -> what is called, and arguments that work
RIGHT: dict[str, tuple[Callable[..., Any], dict[str, Any]]] = {
    "StateSpace": (synth.StateSpace, {"A": I, "B": I, "C": I, "D": I, "dt": 0.0, "u": (), "y": (), "units": {}}),
    "StateSpace.frequency_response": (G.frequency_response, {"omega": 1.0}),
    "StateSpace.step_response": (G.step_response, {"time": None}),
    "StateSpace.impulse_response": (G.impulse_response, {"time": None}),
    "StateSpace.transform": (G.transform, {"T": I}),
    "StateSpace.feedback": (G.feedback, {"K": 1, "sign": -1}),
    "G[key]": (lambda key: G[key], {"key": (0, 0)}),
    "G * other": (lambda other: G * other, {"other": G}),
    "G + other": (lambda other: G + other, {"other": G}),
    "G / other": (lambda other: G / other, {"other": 2.0}),
    "G ** power": (lambda power: G**power, {"power": 1}),
    "GeneralizedPlant": (
        synth.GeneralizedPlant,
        NINE | {"D22": 0, "dt": 0.5, "w": (), "u": (), "z": (), "y": (), "units": {}, "continuous": None},
    ),
    "GeneralizedPlant.partition": (
        synth.GeneralizedPlant.partition, {"system": WEIGHTED.system, "nmeas": 1, "ncon": 1}
    ),
    "GeneralizedPlant.tracking": (
        synth.GeneralizedPlant.tracking,
        {"P0": G, "Wproc": 1, "Wdist": 1, "Werr": 1, "Wact": 1, "Wr": 1, "u": (), "y": (), "units": None},
    ),
    "GeneralizedPlant.four_block": (
        synth.GeneralizedPlant.four_block, {"G": G, "Wdist": 1, "Wnoise": 1, "Wout": 1, "Wact": 1}
    ),
    "GeneralizedPlant.close": (WEIGHTED.close, {"K": 1.0}),
    "UncertainSystem": (
        synth.UncertainSystem, {"E": I, "A": -I, "B": I, "C": I, "D": 0, "dt": 0.0, "u": (), "y": ()}
    ),
    "UncertainSystem.at": (UNCERTAIN.at, {"values": {"J": 1.1}, "within": True}),
    "UncertainSystem.sample": (UNCERTAIN.sample, {"n": 2, "seed": 0}),
    "UncertainSystem.gridded": (UNCERTAIN.gridded, {"points": 2}),
    "UncertainSystem.with_ranges": (UNCERTAIN.with_ranges, {"box": list(UNCERTAIN.parameters.values())}),
    "UncertainSystem.series": (UNCERTAIN.series, {"H": 1.0}),
    "UncertainSystem.feedback": (UNCERTAIN.feedback, {"K": 1.0, "sign": -1}),
    "UncertainSystem.lft": (
        synth.UncertainSystem(None, -1.0, [[1.0, 1.0]], [[1.0], [1.0]]).lft, {"K": 0.5, "nmeas": 1, "ncon": 1}
    ),
    "Expression + other": (lambda other: synth.ureal("J", 1.0, plusminus=0.5) + other, {"other": 2.0}),
    "Expression * other": (lambda other: synth.ureal("J", 1.0, plusminus=0.5) * other, {"other": 2.0}),
    "Expression / other": (lambda other: synth.ureal("J", 1.0, plusminus=0.5) / other, {"other": 2.0}),
    "Expression ** power": (lambda power: synth.ureal("J", 1.0, plusminus=0.5) ** power, {"power": 2}),
    "LinearController.of": (synth.LinearController.of, {"K": SAMPLED}),
    "LinearController.padded": (synth.LinearController.of(SAMPLED).padded, {"states": 8}),
    "AntiWindup.of": (synth.AntiWindup.of, {"design": shaped(), "umin": -1.0, "umax": 1.0}),
    "SequentialController.of": (
        synth.SequentialController.of,
        {"source": SAMPLED, "dtype": "double", "umin": None, "umax": None, "antiwindup": None},
    ),
    "Requirements": (
        synth.Requirements,
        {"ratio": 1.01, "delay_ratio": None, "intersample_ratio": 1.05, "gain_margin_db": 6.0, "disk_margin": 0.34},
    ),
    "Sdre.create": (
        synth.Sdre.create, {"model": synth.QuaternionModel.create(np.eye(3)), "dt": 0.1, "Q": None, "R": None}
    ),
    "Reduction.plot": (synth.reduce(G, 1).plot, {"ax": None}),
    "Disc": (synth.Disc, {"centre": -1.0, "radius": 0.5}),
    "H2 <= level": (lambda level: synth.H2() <= level, {"level": 2.0}),
    "Design.save": (shaped().save, {"path": "design.json"}),
    "Design.certify": (
        synth.hinfsyn(synth.c2d(synth.GeneralizedPlant.partition(HELD, 1, 1), 0.5)).certify,
        {"lower": None, "upper": None, "intersample": None, "delay": None},
    ),
}  # fmt: skip
READERS = {
    "Design.load": synth.Design.load,
    "Certificate.load": synth.Certificate.load,
    "BoxCertificate.load": synth.BoxCertificate.load,
}


@pytest.mark.parametrize("name", RIGHT)
def test_wrong_arguments_are_refused_with_what_to_pass(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call, right = RIGHT[name]
    call(**right)
    for parameter, (wrong, value) in itertools.product(right, WRONG.items()):
        text = refusal(lambda: call(**{**right, parameter: value}), f"{parameter} = {wrong}")  # noqa: B023
        assert text is None or len(text) >= 20, (parameter, wrong, text)


@pytest.mark.parametrize("name", READERS)
def test_readers_refuse_what_is_no_file(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for wrong, value in WRONG.items():
        assert refusal(lambda: READERS[name](value), wrong) is not None  # noqa: B023
