"""`synth info`: what is in a file, in words or as data; nothing in it is taken for more than it says of itself."""

from __future__ import annotations

import argparse
from typing import Any

from synth.command.terminal import DONE, load, print_json, say
from synth.delivery.modelfiles import Model
from synth.errors import ModelError
from synth.synthesis.convention import sampling
from synth.synthesis.design import Design
from synth.systems.generalized import GeneralizedPlant


def info(options: argparse.Namespace) -> int:
    """`synth info`."""
    from synth.command.certificates import begins, claims, is_certificate
    from synth.delivery.qp import FORMAT as MPC

    readers = {MPC: program}
    found = [
        {"file": f, **(claims(f) if is_certificate(f) else readers.get(begins(f), lambda f: facts(load(f)))(f))}
        for f in options.files
    ]
    if options.json:
        print_json(found)
        return DONE
    for i, item in enumerate(found):
        say(("\n" if i else "") + item.pop("file"))
        for key, value in item.items():
            if isinstance(value, dict):
                value = ", ".join(f"{k} {v}" for k, v in value.items())
            elif isinstance(value, list):
                value = ", ".join(map(str, value)) or "none"
            told = format(value, ".9g") if isinstance(value, float) else str(value).replace("\n", "\\n")
            say(f"  {key.replace('_', ' '):18} {told}")
    return DONE


def program(file: str) -> dict[str, Any]:
    """What is to be said about the file of a predictive controller."""
    from synth.delivery.qp import load_mpc

    try:
        found = load_mpc(file)
    except ModelError as error:
        error.args = (f"{file}: {error}",)
        raise
    settings, (n, m) = found["settings"], found["model"]["B"].shape
    return {
        "kind": "predictive controller", "form": found["form"], **timebase(found["dt"]), "states": n, "commands": m,
        **{key: found[key] for key in ("convention", "sampling", "limits") if key in found},
        "horizon": settings["Np"], "free_moves": settings["Nc"], "delay": settings["delay"],
        "umin": settings["umin"].tolist(), "umax": settings["umax"].tolist(), "variables": len(found["qp"]["P"]),
        "rows": len(found["qp"]["A"]), "date": found["date"], "versions": found["versions"],
        "model_sha256": found["model_sha256"],
    }  # fmt: skip


def facts(item: Design | GeneralizedPlant | Model) -> dict[str, Any]:
    """What is to be said about a file."""
    if isinstance(item, Model):
        G = item.system
        names = {"measurements": "u", "controls": "y"} if item.convention else {"u": "u", "y": "y"}
        signals: dict[str, Any] = {name: labels(getattr(item, key), item.units) for name, key in names.items()}
        if item.limited:
            signals |= {"umin": item.limited.umin.tolist(), "umax": item.limited.umax.tolist()}
        told = ({"convention": item.convention} if item.convention else {}) | (
            {"warnings": list(item.warnings)} if item.warnings else {}
        )
        kind = "controller" if item.convention else "system"
        return {"kind": kind, "order": G.n, **timebase(G.dt), **signals, "sha256": G.digest(), **told}
    if isinstance(item, GeneralizedPlant):
        signals = {key: labels(getattr(item, key), item.units) for key in "wuzy"}
        sha256 = item.system.digest()
        return {"kind": "generalised plant", "order": item.sizes[0], **timebase(item.dt), **signals, "sha256": sha256}
    P, K, about = item.plant, item.controller, item.info
    data: dict[str, Any] = {"kind": "loop-shaping design" if item.shaping else "design", "order": K.n}
    data |= timebase(K.dt)
    if item.shaping:  # y and u of the plant are those of the shaped plant
        data |= {"measurements": [f"y{i}" for i in range(K.nu)], "controls": [f"u{i}" for i in range(K.ny)]}
    else:
        data |= {"measurements": labels(P.y, P.units), "controls": labels(P.u, P.units)}
    data |= {
        "convention": item.convention,
        "sampling": sampling(P.dt),
        "plant_order": P.sizes[0],
        "exogenous": labels(P.w, P.units),
        "regulated": labels(P.z, P.units),
        "gamma": item.gamma,
        "verified_norm": item.verified_norm,
        **({"intersample_norm": item.intersample.upper} if item.intersample else {}),
        "optimum": about.optimum,
        "peak_frequency": about.frequency,
        "spectral_radius" if P.dt else "largest_real_part": about.spectral_radius,
        "method": about.method,
        "solver": about.solver,
        "status": about.status,
        "warnings": list(item.warnings),
        "date": about.date,
        "versions": dict(about.versions),
        "controller_sha256": K.digest(),
        "plant_sha256": P.system.digest(),
    }
    return data


def labels(names: tuple[str, ...], units: Any) -> list[str]:
    """Names with their units."""
    return [f"{name} [{units[name]}]" if name in units else name for name in names]


def timebase(dt: float) -> dict[str, Any]:
    """The sampling time, and in words."""
    every = "at an unspecified sampling time" if dt is True else f"every {dt:g} s"
    return {"dt": dt, "time": f"discrete, {every}" if dt else "continuous"}
