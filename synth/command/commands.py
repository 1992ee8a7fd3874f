"""What the commands of `synth` do: read files, measure, print, and turn errors into one line and an exit code."""

from __future__ import annotations

import argparse
import sys
import traceback
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from synth.command.look import facts, info
from synth.command.terminal import BAD_INPUT, DONE, MISSED, NO_CONTROLLER, NUMERICAL, load, print_json, say
from synth.delivery.modelfiles import Model
from synth.errors import (
    AssumptionError,
    ExportError,
    InfeasibleError,
    ModelError,
    NumericalError,
    SynthError,
    VerificationError,
)
from synth.regulators.antiwindup import AntiWindup
from synth.synthesis.design import Design
from synth.systems.generalized import GeneralizedPlant

CODES = {
    VerificationError: MISSED,
    AssumptionError: NO_CONTROLLER,
    InfeasibleError: NO_CONTROLLER,
    NumericalError: NUMERICAL,
    ExportError: BAD_INPUT,
    ModelError: BAD_INPUT,
}

OPTIONS = {"force=True": "--force", "allow_unstable=True": "--allow-unstable"}  # what messages call them in Python


def run(options: argparse.Namespace) -> int:
    """Run the command that was asked for; returns its exit code."""
    commands = {
        "info": info, "verify": verify, "certify": certify, "export": export, "compare": compare, "design": design,
        "sign": sign, "keygen": keygen, "init": init, "fly": fly,
    }  # fmt: skip
    try:
        return commands[options.command](options)
    except BrokenPipeError:
        raise
    except MemoryError:
        say(f"synth {options.command}: there is not enough memory for this", sys.stderr)
        return NUMERICAL
    except (SynthError, OSError) as error:
        if options.debug:
            say(traceback.format_exc().rstrip(), sys.stderr)
        where = f"{error.filename}: {error.strerror}" if isinstance(error, OSError) else str(error)
        for argument, option in OPTIONS.items():
            where = where.replace(argument, option)
        say(f"synth {options.command}: {where}", sys.stderr)
        return next((code for kind, code in CODES.items() if isinstance(error, kind)), BAD_INPUT)


def table(rows: list[list[str]]) -> str:
    """Rows in aligned columns, the first one a heading."""
    widths = [max(len(row[j]) for row in rows) for j in range(len(rows[0]))]
    rows = [rows[0], ["-" * width for width in widths], *rows[1:]]
    return "\n".join("  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)).rstrip() for row in rows)


def number(value: float | None) -> str:
    """Five digits, or a dash for what was not measured."""
    if value is True:  # a sampling time
        return "unspecified"
    return "-" if value is None or np.isnan(value) else f"{value:.5g}"


def verify(options: argparse.Namespace) -> int:
    """`synth verify`."""
    from synth.command import certificates

    if options.key is not None:
        from synth.command.signing import verify_files

        others = [name for name in certificates.GATE if getattr(options, name) not in (None, False)]
        listed = [f"--{name.replace('_', '-')}" for name in (*others, *(["design"] if options.design else []))]
        return told(options, *verify_files(options, listed))
    if any(map(certificates.is_certificate, options.files)):
        return told(options, *certificates.verify(options, load))
    if options.design is not None:
        raise ModelError("--design is about certificates; none is given")
    from synth.delivery.acceptance import Acceptance, Requirements, accept

    given = {f.name: getattr(options, f.name) for f in fields(Requirements)}
    required = Requirements(**{name: value for name, value in given.items() if value is not None})
    plant = None if options.plant is None else plant_of(load(options.plant), options.plant, options.negative)
    if plant is None and options.negative:
        raise ModelError("--negative is about a plain --plant; give one")
    found: dict[str, Acceptance] = {}
    for file in options.files:
        item = load(file)
        if isinstance(item, GeneralizedPlant):
            raise ModelError(f"{file}: this is a plant; pass a design, or a controller with --plant")
        if isinstance(item, Model) and plant is None:
            raise ModelError(f"{file}: the controller comes without a plant; pass --plant")
        umin, umax = limits_of(options)
        try:
            found[file] = accept(
                source_of(item), plant, level=options.level, dt=options.dt, umin=umin, umax=umax,
                antiwindup=gain_of(item, options), overload=options.overload, requirements=required,
                form=getattr(options, "as") or "controller", precision=options.precision or "float32",
                inputs=one_or_all(options.inputs),
            )  # fmt: skip
        except SynthError as error:
            error.args = (f"{file}: {error}",)
            raise
    if options.json:
        print_json([{"file": file, **acceptance_data(a)} for file, a in found.items()])
    else:
        say("\n\n".join(f"{file}\n{acceptance_text(a)}" for file, a in found.items()))
    return DONE if all(a.passed for a in found.values()) else MISSED


def certify(options: argparse.Namespace) -> int:
    """`synth certify`."""
    from synth.command import certificates

    return told(options, *certificates.certify(options, load))


def sign(options: argparse.Namespace) -> int:
    """`synth sign`."""
    from synth.command.signing import sign_files

    return told(options, *sign_files(options))


def keygen(options: argparse.Namespace) -> int:
    """`synth keygen`."""
    from synth.command.signing import make_keys

    return told(options, *make_keys(options))


def init(options: argparse.Namespace) -> int:
    """`synth init`."""
    from synth.command.flying import init

    return told(options, *init(options))


def fly(options: argparse.Namespace) -> int:
    """`synth fly`."""
    from synth.command.flying import fly

    data, text = fly(options)
    told(options, data, text)
    return DONE if data["met"] else MISSED


def told(options: argparse.Namespace, data: Any, text: str) -> int:
    """Print what was done, as data or in words."""
    print_json(data) if options.json else say(text)
    return DONE


def plant_of(item: Any, file: str, negative: bool) -> GeneralizedPlant:
    """A generalised plant, or the four-block problem of a plain one."""
    from synth.analysis.coprime import gang_of_four

    if isinstance(item, Design):
        item = item.plant
    if isinstance(item, GeneralizedPlant):
        if negative:
            raise ModelError(f"{file}: --negative is about a plain plant; a generalised one says itself what y is")
        return item
    return gang_of_four(-item.system if negative else item.system)


def limits_of(options: argparse.Namespace) -> tuple[Any, Any]:
    """The limits as a number for all commands, or one for each."""
    return one_or_all(options.umin), one_or_all(options.umax)


def one_or_all(values: list[float] | None) -> Any:
    """A number for all signals, one for each, or nothing."""
    return values[0] if values is not None and len(values) == 1 else values


def source_of(item: Any) -> Any:
    """What is measured or exported of a file: a design, or a controller, with its limits if it has some."""
    return (item.limited or item.system) if isinstance(item, Model) else item


def predictive(file: str) -> Any:
    """The predictive controller in a file, None if there is none in it."""
    from synth.command.certificates import begins
    from synth.delivery.qp import FORMAT, load_mpc, restored

    try:
        return restored(load_mpc(file)) if begins(file) == FORMAT else None
    except ModelError as error:
        error.args = (f"{file}: {error}",)
        raise


def gain_of(item: Any, options: argparse.Namespace) -> Any:
    """The anti-windup gain of a loop-shaping design, if it is asked for."""
    if not options.antiwindup:
        return None
    umin, umax = limits_of(options)
    if not isinstance(item, Design) or (umin is None and umax is None):
        raise ModelError("--antiwindup needs a loop-shaping design, and --umin and --umax")
    return AntiWindup.of(item, -np.inf if umin is None else umin, np.inf if umax is None else umax).L


def acceptance_data(found: Any) -> dict[str, Any]:
    """An `Acceptance` as plain data."""
    from dataclasses import asdict, replace

    conditions = [{**asdict(replace(c, certificate=None)), "verdict": c.verdict} for c in found.conditions]
    for condition, c in zip(conditions, found.conditions, strict=True):
        condition["certificate"] = c.certificate and c.certificate.sha256
    return {
        "passed": found.passed, "verdict": found.verdict, "level": found.level, "dt": found.dt,
        "conditions": conditions, "margins": None if found.margins is None else margins_data(found.margins),
    }  # fmt: skip


def margins_data(kept: Any) -> dict[str, Any]:
    """The `Margins` of a loop as plain data."""
    from dataclasses import asdict

    def disk(one: Any) -> dict[str, float]:
        return {"alpha": one.alpha, "frequency": one.frequency, "skew": one.skew}

    return {
        "input": [asdict(one) for one in kept.input],
        "output": [asdict(one) for one in kept.output],
        "disk_input": disk(kept.disk_input),
        "disk_output": disk(kept.disk_output),
        "ncf": kept.ncf,
        "dt": kept.dt,
    }


def acceptance_text(found: Any) -> str:
    """An `Acceptance` as a table."""
    rows = [["condition", "stable", "norm", "ratio", "verdict", "measured"]]
    for c in found.conditions:
        stable = "-" if c.stable is None else "yes" if c.stable else "NO"
        rows.append([c.name, stable, number(c.norm), number(c.ratio), c.verdict, c.note])
    ending = "accepted" if found.passed else "NOT accepted"
    level = "norm not judged: no level known" if found.level is None else f"ratios to the level {found.level:.7g}"
    return f"{table(rows)}\n{ending}; {level}, at {found.period}"


def export(options: argparse.Namespace) -> int:
    """`synth export`."""
    from synth.command.certificates import read
    from synth.delivery.acceptance import accept
    from synth.delivery.files import made
    from synth.delivery.formats import export as write
    from synth.delivery.leaving import PYTHON
    from synth.delivery.rounding import PRECISIONS

    file = options.files[0]
    if Path(file).suffix == ".py":
        raise ModelError(f"{file}: {PYTHON}")
    item = predictive(file) or load(file)
    if isinstance(item, GeneralizedPlant):
        raise ModelError(f"{file}: this is a plant; pass a design or a controller")
    certificate: Any = None if options.certificate is None else read(options.certificate)
    made(Path(options.output))
    umin, umax = limits_of(options)
    found = None
    if options.accept:
        if not isinstance(item, Design):
            raise ModelError(f"{file}: --accept needs a design, whose plant it knows; see `synth verify` for others")
        bounds = {"umin": umin, "umax": umax, "inputs": one_or_all(options.inputs)}
        bounds = {} if item.shaping else bounds  # y and u are no signals of a shaped plant
        found = accept(
            item, dt=None if item.plant.dt else options.dt, precision=options.precision or "float32", **bounds
        )
    if options.float and options.precision not in (None, "float32"):
        raise ModelError(f"--float and --precision {options.precision} exclude each other; pass one of them")
    precision = "float32" if options.float else options.precision or "double"
    written = write(
        source_of(item), options.format, options.output, name=options.name,
        force=options.force, allow_unstable=options.allow_unstable, umin=umin, umax=umax,
        antiwindup=gain_of(item, options), dtype=PRECISIONS.get(precision, precision),
        inputs=one_or_all(options.inputs), acceptance=found, certificate=certificate,
    )  # fmt: skip
    if options.json:
        gate = {} if found is None else {"acceptance": acceptance_data(found)}
        print_json({"files": [str(path) for path in written], **gate})
    else:
        say("\n".join(map(str, written)))
        if found is not None:
            say(acceptance_text(found))
    return DONE if found is None or found.passed else MISSED


def compare(options: argparse.Namespace) -> int:
    """`synth compare`."""
    from synth.delivery import comparison

    designs = {}
    for file in options.files:
        designs[file] = load(file)
        if not isinstance(designs[file], Design):
            raise ModelError(f"{file}: this is no design; pass what `synth design` or Design.save wrote")
    found = comparison.compare(designs)
    if options.plot:
        comparison.plot(designs, options.plot)
    if options.json:
        print_json([{"file": file, **row} for file, row in found.items()])
        return DONE
    rows = [["", *(Path(file).name for file in found)]]
    for key, (text, _) in comparison.MEASURES.items():
        rows.append([text, *(number(row[key]) for row in found.values())])
    say(table(rows))
    return DONE


def design(options: argparse.Namespace) -> int:
    """`synth design`."""
    from synth.command.specification import read_study
    from synth.delivery.files import check_target

    file = Path(options.files[0])
    target = Path(options.output) if options.output else file.with_suffix(".json")
    check_target(target, "a design", (".json", ".mat"), force=options.force)
    study = read_study(file)
    found = study.design()
    accepted = study.accept(found)
    missed = study.missed(found, accepted)
    found.save(target)
    if options.json:
        gate = acceptance_data(accepted) if accepted else None
        print_json({"file": str(target), "missed": missed, **facts(found), "acceptance": gate})
    else:
        say(found)
        if accepted:
            say(acceptance_text(accepted))
        say(f"saved as {target}")
    for text in missed:
        say(f"synth design: missed: {text}", sys.stderr)
    return MISSED if missed else DONE
