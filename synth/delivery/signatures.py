"""Signatures: who holds the public key knows that a file is, to the last bit, what the private key's holder signed.

The checksums inside designs and controllers tell damage; whoever changes a file can renew them. A signature is a file
of its own, ``FILE.sig``, so that C sources, FMUs and manifests are signed as designs are: an Ed25519 signature (RFC
8032) of the sha256 of all bytes. The file's name is not signed. Keys are PEM files, as `keygen` and OpenSSL write them.
"""

from __future__ import annotations

import base64
import hashlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from synth.checks import as_flag, as_path, shown
from synth.errors import ExportError, ModelError, VerificationError
from synth.files import is_device, read_bytes, read_json, write_atomically

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey

FORMAT = "convex-synth signature"
SUFFIX = ".sig"
LARGEST = 2**30  # bytes of a signed file
SMALL = 2**16  # bytes of a key


def keygen(path: str | os.PathLike[str]) -> tuple[Path, Path]:
    """Make a pair of keys: ``PATH.key``, private, which only its owner may read, and ``PATH.pub``.

    Parameters
    ----------
    path : without an ending

    Raises
    ------
    ExportError : one of the files exists, or cannot be written; cryptography is not installed.
    """
    primitives = _library()
    path = as_path("path", path)
    if not path.name or is_device(path.name):
        raise ModelError(f"path is {shown(str(path))}; pass a name for the pair of keys, without an ending")
    key = primitives.Ed25519PrivateKey.generate()
    private, public = (path.parent / f"{path.name}{ending}" for ending in (".key", ".pub"))
    if there := [file for file in (private, public) if file.exists()]:
        raise ExportError(f"path: {there[0]} exists; a key is not replaced, choose another name")
    form = primitives.serialization
    pem = key.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption())
    shared = key.public_key().public_bytes(form.Encoding.PEM, form.PublicFormat.SubjectPublicKeyInfo)
    try:
        write_atomically(private, pem, mode=0o600)
        write_atomically(public, shared)
    except OSError as error:
        raise ExportError(f"path: {path} cannot be written ({error.strerror}); choose another folder") from None
    return private, public


def sign(
    path: str | os.PathLike[str], key: str | os.PathLike[str], *, passphrase: str | None = None, force: bool = False
) -> Path:
    """Sign any file; returns the path of the signature, ``PATH.sig``.

    Parameters
    ----------
    path : of a design, controller, certificate, exported C file or unit, or of whatever is handed on
    key : path of the private key
    passphrase : of a key that has one
    force : replace a signature that exists

    Raises
    ------
    ModelError : a file is missing, no file or larger than 1 GiB; the key is no private key of Ed25519.
    ExportError : the signature exists or cannot be written; cryptography is not installed.

    Reference: RFC 8032.
    """
    as_flag("force", force)
    path = as_path("path", path)
    digest, secret = _digest(path), _private(as_path("key", key), passphrase)
    target = path.parent / f"{path.name}{SUFFIX}"
    if target.exists() and not force:
        raise ExportError(f"{target} exists; pass force=True to replace it")
    data = {"format": FORMAT, "format_version": 1, "sha256": digest, "key": fingerprint(secret.public_key())}
    data |= {"signature": base64.b64encode(secret.sign(_message(digest))).decode()}
    try:
        return write_atomically(target, f"{json.dumps(data, indent=1)}\n".encode())
    except OSError as error:
        raise ExportError(f"{target} cannot be written ({error.strerror}); sign a copy elsewhere") from None


def verify_signature(path: str | os.PathLike[str], key: str | os.PathLike[str]) -> str:
    """Check the signature ``PATH.sig`` of a file; returns the fingerprint of the key, the sha256 of its 32 bytes.

    Parameters
    ----------
    path : of the file
    key : path of the public key, from somebody who is trusted: a key that comes with the file proves nothing

    Raises
    ------
    ModelError : a file is missing or no file, the key is no public key of Ed25519, or the signature is damaged.
    VerificationError : the file is not signed, was changed since, or was signed with another key.
    """
    from synth import mistakes, schemas

    path = as_path("path", path)
    digest, public = _digest(path), _public(as_path("key", key))
    target = path.parent / f"{path.name}{SUFFIX}"
    if not os.path.lexists(target):
        raise VerificationError(f"{path.name} is not signed: there is no {target.name} beside it")
    try:
        data = read_json(target)
        mistakes.check(schemas.Signature, data, "it is no signature")
        signature = base64.b64decode(data["signature"], validate=True)
    except ValueError as error:
        raise ModelError(f"{target.name}: {error}; take it from where the file came") from None
    own = fingerprint(public)
    if data["key"] != own:
        raise VerificationError(f"{path.name} was signed with another key, {data['key'][:16]}..., not {own[:16]}...")
    if data["sha256"] != digest:
        raise VerificationError(f"{path.name} was changed after it was signed: its sha256 differs")
    try:
        public.verify(signature, _message(digest))
    except _library().InvalidSignature:
        raise VerificationError(f"{target.name} is forged: no holder of the key signed this file") from None
    return own


def fingerprint(public: Ed25519PublicKey) -> str:
    """The sha256 of the 32 bytes of a public key."""
    return hashlib.sha256(public.public_bytes_raw()).hexdigest()


def _message(digest: str) -> bytes:
    """What is signed: no signature of something else can be taken for one of a file."""
    return f"{FORMAT} 1\nsha256 {digest}\n".encode()


def _digest(path: Path) -> str:
    try:
        return hashlib.sha256(read_bytes(path, LARGEST)).hexdigest()
    except ModelError as error:
        raise ModelError(f"path {shown(path.name)}: {error}") from None


def _private(path: Path, passphrase: str | None) -> Ed25519PrivateKey:
    library = _library()
    if passphrase is not None and not isinstance(passphrase, str):
        raise ModelError(f"passphrase is {shown(passphrase)}; pass text, or None")
    secret = None if passphrase is None else passphrase.encode()
    return _key(
        path,
        lambda content: library.serialization.load_pem_private_key(content, secret),
        library.Ed25519PrivateKey,
        "a private key of Ed25519 in PEM, as `synth keygen` writes it, and its passphrase if it has one",
    )


def _public(path: Path) -> Ed25519PublicKey:
    library = _library()
    return _key(
        path,
        library.serialization.load_pem_public_key,
        library.Ed25519PublicKey,
        "a public key of Ed25519 in PEM, as `synth keygen` writes it (.pub)",
    )


def _key(path: Path, load: Any, kind: type, wanted: str) -> Any:
    """The key in a file; nothing of its content is in an error."""
    try:
        content = read_bytes(path, SMALL)
    except ModelError as error:
        raise ModelError(f"key {shown(path.name)}: {error}") from None
    try:
        key = load(content)
    except Exception:  # whatever the library raises for what is no such key
        key = None
    if not isinstance(key, kind):
        raise ModelError(f"key {shown(path.name)} is not {wanted}")
    return key


def _library() -> Any:
    """The parts of cryptography that are needed, which is an extra."""
    try:
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives import serialization
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey, Ed25519PublicKey
    except ImportError:
        raise ExportError("signatures need the package cryptography: pip install 'convex-synth[sign]'") from None
    from types import SimpleNamespace

    return SimpleNamespace(
        InvalidSignature=InvalidSignature, serialization=serialization,
        Ed25519PrivateKey=Ed25519PrivateKey, Ed25519PublicKey=Ed25519PublicKey,
    )  # fmt: skip
