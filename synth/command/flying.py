"""`synth init`, which writes a spacecraft and a study for it, and `synth fly`, which flies controllers on it."""

from __future__ import annotations

import argparse
import shlex
import sys
from dataclasses import replace
from importlib import resources
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from synth.command import door
from synth.command.terminal import load, say
from synth.delivery.files import write_all
from synth.delivery.modelfiles import Model
from synth.errors import ModelError, SynthError
from synth.regulators.controller import LinearController
from synth.synthesis.convention import ERROR, MEASURED
from synth.synthesis.design import Design
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

RUNS, FEW = 30, 4  # flights of each controller, and of a quick look


class Fed(NamedTuple):
    """What closes the loop."""

    controller: Any  # steps u = K (r - y)
    K: StateSpace | None  # None of predictive control
    remedy: str  # if the sign is wrong


def init(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """Both templates are written; returns what was done, as data and in words."""
    folder = Path(options.folder)
    texts = {
        "spacecraft.toml": door.find().template(),
        "design.toml": (resources.files("synth.command") / "design.toml").read_text(encoding="utf-8"),
    }
    files = write_all(folder, {name: text.encode() for name, text in texts.items()}, force=options.force)
    craft, study, controller = (shlex.quote(str(folder / name)) for name in (*texts, "controller.json"))
    steps = [
        f"synth design {study} -o {controller}",
        f"synth fly {craft} {controller} --report {shlex.quote(str(folder / 'out'))}",
    ]
    text = "\n".join([f"written: {craft} and {study}; change the numbers to yours, then", *(f"  {s}" for s in steps)])
    return {"files": [str(file) for file in files], "next": steps}, text


def fly(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """The controllers are flown; returns what came out, as data and in words."""
    if options.fast and options.runs is not None:
        raise ModelError("--fast and --runs both say how many flights; give one of them")
    runs = FEW if options.fast else RUNS if options.runs is None else options.runs
    if runs < 1 or options.seed < 0:
        raise ModelError(f"--runs is {runs}, --seed {options.seed}; at least one flight, and a seed of at least 0")
    if Path(options.spacecraft).suffix in (".json", ".mat"):
        raise ModelError(
            f"{options.spacecraft}: this is no spacecraft; its TOML file comes first, as synth init writes it"
        )
    craft = door.read(Path(options.spacecraft))
    plant = craft.plant()
    controllers = {}
    for file, name in zip(options.files, _names(options.files), strict=True):
        try:
            controllers[name] = _fitting(_controller(file, options.positive), plant, name, options.spacecraft)
        except SynthError as error:
            if not str(error).startswith(file):
                error.args = (f"{file}: {error}",)
            raise
    with door.refusals(craft.door):
        found = craft.door.fly(
            craft.sheet, controllers, runs=runs, seed=options.seed, duration=options.duration,
            out=None if options.report is None else Path(options.report),
        )  # fmt: skip
    page = None if found["report"] is None else str(found["report"])
    data = {"met": found["met"], "controllers": found["controllers"], "report": page}
    return data, found["text"] + (f"\nreport: {page}" if page else "")


def _names(files: list[str]) -> list[str]:
    """What the controllers are called: the names of their files, or the whole paths where these are the same."""
    if len({Path(file) for file in files}) < len(files):
        raise ModelError(f"{', '.join(files)}: one file is given twice; give each once")
    stems = [Path(file).stem for file in files]
    return stems if len(set(stems)) == len(stems) else files


def _controller(file: str, positive: bool) -> Fed:
    """What a file gives the loop."""
    from synth.command.certificates import begins
    from synth.delivery.qp import FORMAT, load_mpc, restored

    if Path(file).suffix == ".toml":
        raise ModelError("this is no controller; `synth design` makes one of a study")
    if begins(file) == FORMAT:
        return Fed(restored(load_mpc(file)), None, "")
    item = load(file)
    if isinstance(item, GeneralizedPlant):
        raise ModelError("this is a plant; pass a design or a controller")
    if isinstance(item, Design) and (item.shaping or item.convention == ERROR):
        given = item.as_controller() if item.plant.dt else None
        return Fed(given, _negative(item), "it was designed for another plant")
    if isinstance(item, Model) and item.convention in (ERROR, MEASURED):
        if positive:
            raise ModelError(f"it says of itself: {item.convention}; leave out --positive")
        positive, remedy = item.convention == MEASURED, "it was designed for another plant"
    elif isinstance(item, Model) and item.limited:
        if positive:
            raise ModelError("its limits and anti-windup are those of u = K (r - y); leave out --positive")
        remedy = "with its limits it can be taken as u = K (r - y) only"
    else:
        remedy = "leave out --positive" if positive else "--positive takes it as u = K y"
    K = item.system if isinstance(item, Model) else item.closing
    K = StateSpace(K.A, -K.B, K.C, -K.D, K.dt) if positive else StateSpace(*K.matrices, K.dt)
    if isinstance(item, Model) and item.limited:
        return Fed(replace(item.limited, B=K.B, D=K.D), K, remedy)
    return Fed(LinearController.of(K) if K.discrete and K.dt is not True else None, K, remedy)


def _negative(design: Design) -> StateSpace:
    """K of u = K (r - y) of a design that says its sign."""
    K = design.controller
    return -K if design.shaping else K


def _fitting(fed: Fed, G: StateSpace, name: str, spacecraft: str) -> Any:
    """The controller, if its signals and its sampling time are those of the spacecraft, and its sign is right."""
    if fed.K is None:
        dt, ny, nu = fed.controller.dt, fed.controller.problem.model.n, fed.controller.problem.model.nu
    else:
        dt, ny, nu = fed.K.dt, fed.K.nu, fed.K.ny
    if (ny, nu) != (G.ny, G.nu):
        raise ModelError(
            f"it has {ny} inputs and {nu} outputs; that of {spacecraft} takes the error of {', '.join(G.y)} ({G.ny}) "
            f"and gives {', '.join(G.u)} ({G.nu}): design for its plant, as in the study of `synth init`"
        )
    if dt is True or dt == 0:
        kind = "continuous" if dt == 0 else "sampled at a time that it does not say"
        raise ModelError(f"it is {kind}, and {spacecraft} has the control period dt = {G.dt:g} s; design at that")
    if not np.isclose(dt, G.dt, rtol=1e-9, atol=0):
        raise ModelError(
            f"its sampling time is {dt:g} s, and {spacecraft} has the control period dt = {G.dt:g} s; design at that, "
            "or change dt"
        )
    if fed.K is not None:
        _check_sign(G, fed.K, fed.remedy, name)
    return fed.controller


def _check_sign(G: StateSpace, K: StateSpace, remedy: str, name: str) -> None:
    """Refuse a controller that stabilises the linear plant with the other sign only; tell of one that never does."""
    G = StateSpace(*G.matrices, K.dt)
    radius = {sign: np.abs(G.feedback(K, sign).poles()).max(initial=0) for sign in (-1, 1)}
    if radius[-1] < 1:
        return
    if radius[1] < 1:
        raise ModelError(f"the loop that it closes is unstable, and stable with the other sign; {remedy}")
    told = f"the linear loop of {name} is unstable (spectral radius {radius[-1]:.6g}); it flies all the same"
    say(f"synth fly: {told}", sys.stderr)
