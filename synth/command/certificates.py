"""`synth certify`, and what `synth verify` does with the certificates that it writes: it proves them again."""

from __future__ import annotations

import argparse
import io
import re
import zipfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from synth.delivery.conditions import Requirements
from synth.delivery.files import check_target
from synth.delivery.matfiles import read_mat
from synth.delivery.modelfiles import JSON, WRITTEN
from synth.errors import ModelError, SynthError, VerificationError
from synth.files import read_bytes
from synth.proof import boxcertificate
from synth.proof.boxcertificate import BoxCertificate
from synth.proof.certify import BITS, FORMAT, Certificate
from synth.proof.certify import certify as prove
from synth.synthesis.design import Design

GATE = (
    "plant",
    "negative",
    "dt",
    "as",
    "umin",
    "umax",
    "antiwindup",
    "precision",
    "inputs",
    *(f.name for f in fields(Requirements)),
)
Load = Callable[[str], Any]  # reads a file that is no certificate
SUFFIX = ".certificate.json"
EXPORTED, DESCRIPTION = (".h", ".fmu"), "modelDescription.xml"
NAMED = re.compile(r"certificate\W+(?:value=\W+)?sha256 ([0-9a-f]{64})")


def certify(options: argparse.Namespace, load: Load) -> tuple[dict[str, Any], str]:
    """The certificate of the design in a file is found and saved; returns what it claims, as data and in words."""
    file = options.files[0]
    target = Path(options.output) if options.output else Path(file).with_suffix(SUFFIX)
    check_target(target, "a certificate", (".json",), force=options.force)
    bits = BITS if options.bits is None else options.bits
    levels = {name: getattr(options, name) for name in ("lower", "upper", "intersample")}
    found = prove(of_design(file, load), **levels, delay=options.delay, bits=bits)
    found.save(target)
    note = f"\n  no lower bound was proved: {found.note}" if found.note else ""
    data = {"file": str(target), **facts(found), "note": found.note}
    return data, f"{text(found)}{note}\nproved; saved as {target}"


def verify(options: argparse.Namespace, load: Load) -> tuple[list[dict[str, Any]], str]:
    """Certificates are proved again, of the plant and controller that they hold or of a design; returns likewise."""
    if given := [name for name in GATE if getattr(options, name) not in (None, False)]:
        listed = ", ".join(f"--{name.replace('_', '-')}" for name in given)
        raise ModelError(f"{listed} means nothing for a certificate; verify controllers on their own")
    if others := [file for file in options.files if not is_certificate(file)]:
        raise ModelError(f"{others[0]}: this is no certificate; verify controllers on their own")
    of = options.design
    design = None if of is None or Path(of).suffix in EXPORTED else of_design(of, load)
    named = set() if of is None else named_in(of)
    if of is not None and design is None and not named:
        raise ModelError(f"{of}: this file names no certificate; pass one that `synth export --certificate` wrote")
    found = {file: read(file) for file in options.files}
    for file, certificate in found.items():
        try:
            if isinstance(certificate, BoxCertificate) and design is not None:
                raise ModelError("--design means nothing for a certificate of a box, which holds its own closed loop")
            if isinstance(certificate, BoxCertificate) or design is None:
                certificate.check()
            else:
                certificate.check(design.plant, design.closing)
            if named and certificate.sha256 not in named:
                raise VerificationError(f"the certificate is another than the one that {of} names: the sha256 differs")
        except SynthError as error:
            error.args = (f"{file}: {error}",)
            raise
    ending = "proved again" + (f", of {of}" if design else "") + (f", and named in {of}" if named else "")
    data = [{"file": file, "proved": True, "design": of, "named": bool(named), **facts(c)} for file, c in found.items()]
    return data, "\n\n".join(f"{file}\n{text(c)}\n{ending}" for file, c in found.items())


def named_in(file: str) -> set[str]:
    """The sha256 of the certificates that a design or an exported file names."""
    path = Path(file)
    if path.suffix == ".mat":
        texts = [str(text) for name, text in read_mat(path, WRITTEN).items() if name.endswith(f".{JSON}")]
    elif path.suffix == ".fmu":
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as unit:
            texts = [unit.read(DESCRIPTION).decode(errors="replace")]
    else:
        texts = [read_bytes(path).decode(errors="replace")]
    return set(NAMED.findall(re.sub(r"[\s*]+", " ", " ".join(texts))))


def begins(file: str) -> str:
    """The format that a file names at its beginning, empty if it names none there."""
    if not Path(file).is_file():
        return ""
    with open(file, "rb") as opened:
        found = re.search(rb'"format": ?"([^"]*)"', opened.read(64))
    return found[1].decode(errors="replace") if found else ""


def is_certificate(file: str) -> bool:
    """True when a file begins as `Certificate.save` or `BoxCertificate.save` writes it."""
    return begins(file) in (FORMAT, boxcertificate.FORMAT)


def of_design(file: str, load: Load) -> Design:
    """The design in a file."""
    design = load(file)
    if not isinstance(design, Design):
        raise ModelError(f"{file}: this is no design; pass what `synth design` or Design.save wrote")
    return design


def read(file: str) -> Certificate | BoxCertificate:
    """The certificate in a file, with the file's name in front of what is wrong."""
    try:
        return (BoxCertificate if begins(file) == boxcertificate.FORMAT else Certificate).load(file)
    except SynthError as error:
        error.args = (f"{file}: {error}",)
        raise


def claims(file: str) -> dict[str, Any]:
    """What a certificate claims, without a proof."""
    return {"kind": "certificate", **facts(read(file)), "proved": "not here; synth verify proves it again"}


def facts(certificate: Certificate | BoxCertificate) -> dict[str, Any]:
    """What a certificate claims; its note is no claim."""
    if isinstance(certificate, BoxCertificate):
        c, gain = certificate, certificate.quantity == boxcertificate.GAIN
        return {
            "quantity": c.quantity,
            "upper": c.level if gain else c.reached if c.point else None,
            "lower": c.reached if gain else c.level,
            "parameters": c.point,
            "box": {p.name: list(p.range) for p in c.system.parameters.values()},
            "bits": c.bits,
        }
    return {
        "upper": certificate.upper,
        "lower": certificate.lower or None,
        "gap": certificate.gap,
        **({"intersample": certificate.intersample.upper} if certificate.intersample else {}),
        "bits": certificate.bits,
        "plant_sha256": certificate.plant_sha256,
        "controller_sha256": certificate.controller_sha256,
    }


def text(certificate: Certificate | BoxCertificate) -> str:
    """The claims in words."""
    if isinstance(certificate, BoxCertificate):
        return f"  {certificate.statement}"
    lower = f"no controller of any order reaches a norm below {certificate.lower!r}"
    return "\n".join(
        (
            f"  the controller stabilises the plant with an H-infinity norm below {certificate.upper!r}",
            f"  {lower if certificate.lower_witness else 'nothing is claimed about other controllers'}",
            *([f"  {certificate.intersample.statement}"] if certificate.intersample else []),
            f"  in {certificate.bits}-bit ball arithmetic, all data taken as exact doubles",
            f"  plant       {certificate.plant_sha256}",
            f"  controller  {certificate.controller_sha256}",
        )
    )
