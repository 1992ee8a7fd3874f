"""`synth keygen`, `synth sign`, and `synth verify --key`: signatures of files."""

from __future__ import annotations

import argparse
import getpass
import sys
from typing import Any

from synth.delivery.signatures import keygen, sign, verify_signature
from synth.errors import ModelError


def make_keys(options: argparse.Namespace) -> tuple[dict[str, Any], str]:
    """A pair of keys; returns where they are, as data and in words."""
    private, public = keygen(options.files[0])
    told = f"{private}  private: signs, and stays with you\n{public}  public: hand it on, by another way than the files"
    return {"private": str(private), "public": str(public)}, told


def sign_files(options: argparse.Namespace) -> tuple[list[dict[str, Any]], str]:
    """Every file is signed; returns the signatures likewise."""
    passphrase = getpass.getpass("passphrase: ", sys.stderr) if options.passphrase else None
    found = [(f, str(sign(f, options.key, passphrase=passphrase, force=options.force))) for f in options.files]
    return [{"file": f, "signature": s} for f, s in found], "\n".join(s for _, s in found)


def verify_files(options: argparse.Namespace, given: list[str]) -> tuple[list[dict[str, Any]], str]:
    """Every file is as it was signed with the key; `given` are options that have no meaning here."""
    if given:
        raise ModelError(f"{', '.join(given)} beside --key; a signature is of any file, and is looked at alone")
    found = [(file, verify_signature(file, options.key)) for file in options.files]
    data = [{"file": file, "signed": True, "key": key} for file, key in found]
    return data, "\n".join(f"{file}: as it was signed, with the key {key}" for file, key in found)
