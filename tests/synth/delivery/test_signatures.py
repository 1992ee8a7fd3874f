"""Signed files are what was signed, to the last bit, with this key and no other."""

import base64
import hashlib
import json
import os
import stat
import subprocess
import sys

import numpy as np
import pytest
from tampering import tampered

from synth import keygen, sign, verify_signature
from synth.__main__ import main
from synth.delivery.formats import export
from synth.errors import ExportError, ModelError, VerificationError
from synth.systems.statespace import StateSpace

pytest.importorskip("cryptography", reason="signatures are an extra: pip install 'convex-synth[sign]'")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A signed C file and two pairs of keys."""
    monkeypatch.chdir(tmp_path)
    export(StateSpace.gain([[0.5]], 0.1), "c", tmp_path, name="law")
    keygen("mine")
    keygen("other")
    sign("law.c", "mine.key")
    return tmp_path


def test_a_signed_file_is_verified_by_its_key(folder):
    found = verify_signature("law.c", "mine.pub")
    assert found == json.loads((folder / "law.c.sig").read_text())["key"]
    assert len(found) == 64


def test_no_bit_of_the_file_may_change(folder):
    content = (folder / "law.c").read_bytes()
    rng = np.random.default_rng(0)
    changes = [b"", content + b"\n", content[:-1], content[1:]]
    for at in rng.integers(len(content), size=60):
        changes.append(content[:at] + bytes([content[at] ^ 1 << int(rng.integers(8))]) + content[at + 1 :])
    for changed in changes:
        (folder / "law.c").write_bytes(changed)
        with pytest.raises(VerificationError, match=r"law\.c was changed after it was signed"):
            verify_signature("law.c", "mine.pub")
    (folder / "law.c").write_bytes(content)
    verify_signature("law.c", "mine.pub")


@pytest.mark.parametrize("renewed", [False, True])
def test_nothing_of_the_signature_may_change(folder, renewed):
    """Also where the file was changed and the sha256 in its signature renewed, as by one who knows how."""
    path, rng = folder / "law.c.sig", np.random.default_rng(1)
    data = json.loads(path.read_text())
    if renewed:
        (folder / "law.c").write_text("other")
        data["sha256"] = hashlib.sha256(b"other").hexdigest()
        path.write_text(json.dumps(data))
        with pytest.raises(VerificationError, match=r"law\.c\.sig is forged"):
            verify_signature("law.c", "mine.pub")
    for _ in range(60):
        changed = tampered(data, rng)
        if changed == data and not renewed:
            continue
        path.write_text(json.dumps(changed))
        with pytest.raises((VerificationError, ModelError)):
            verify_signature("law.c", "mine.pub")
    raw = base64.b64decode(data["signature"])
    for k in range(64):
        bad = base64.b64encode(raw[:k] + bytes([raw[k] ^ 1]) + raw[k + 1 :]).decode()
        path.write_text(json.dumps(data | {"signature": bad}))
        with pytest.raises(VerificationError, match="is forged"):
            verify_signature("law.c", "mine.pub")


def test_what_is_wrong_is_said_with_its_exit_code(folder, capsys):
    (folder / "unsigned.h").write_text("x")
    (folder / "broken.h").write_text("x")
    (folder / "broken.h.sig").write_text("{")
    for arguments, code, message in (
        (("law.c", "--key", "mine.pub"), 0, "law.c: as it was signed, with the key"),
        (("law.c", "--key", "other.pub"), 1, "law.c was signed with another key"),
        (("unsigned.h", "--key", "mine.pub"), 1, "unsigned.h is not signed: there is no unsigned.h.sig beside it"),
        (("law.c", "unsigned.h", "--key", "mine.pub"), 1, "unsigned.h is not signed"),
        (("no.c", "--key", "mine.pub"), 2, "path 'no.c': there is no such file"),
        (("law.c", "--key", "no.pub"), 2, "key 'no.pub': there is no such file"),
        (("law.c", "--key", "mine.key"), 2, "key 'mine.key' is not a public key"),
        (("law.c", "--key", "law.c"), 2, "key 'law.c' is not a public key"),
        (("broken.h", "--key", "mine.pub"), 2, "broken.h.sig: it is no JSON"),
        (("law.c", "--key", "mine.pub", "--umin=1", "--ratio", "2"), 2, "--umin, --ratio beside --key"),
    ):
        assert main(["verify", *arguments]) == code, arguments
        told = capsys.readouterr()
        assert message in told.out + told.err
        assert (told.out == "") == (code != 0)
    assert main(["verify", "law.c", "--key", "mine.pub", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)[0]["signed"] is True


def test_signing_by_the_command(folder, capsys):
    assert main(["keygen", "third"]) == 0
    assert main(["keygen", "third"]) == 2
    assert "a key is not replaced" in capsys.readouterr().err
    assert main(["sign", "law.c", "law.h", "--key", "third.key"]) == 2
    assert "law.c.sig exists; pass --force to replace it" in capsys.readouterr().err
    assert main(["sign", "law.c", "law.h", "--key", "third.key", "--force"]) == 0
    assert capsys.readouterr().out.split() == ["law.c.sig", "law.h.sig"]
    assert main(["verify", "law.c", "law.h", "--key", "third.pub"]) == 0
    assert main(["sign", "law.c", "--key", "third.pub", "--force"]) == 2
    assert "key 'third.pub' is not a private key" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix", reason="modes of files are POSIX's")
def test_the_private_key_is_its_owners(folder):
    assert stat.S_IMODE((folder / "mine.key").stat().st_mode) == 0o600


def test_keys_of_openssl_and_keys_with_a_passphrase(folder):
    from cryptography.hazmat.primitives import serialization as form
    from cryptography.hazmat.primitives.asymmetric import ec, ed25519

    key = ed25519.Ed25519PrivateKey.generate()
    locked = key.private_bytes(
        form.Encoding.PEM, form.PrivateFormat.PKCS8, form.BestAvailableEncryption("täglich".encode())
    )
    (folder / "locked.key").write_bytes(locked)
    public = key.public_key().public_bytes(form.Encoding.PEM, form.PublicFormat.SubjectPublicKeyInfo)
    (folder / "locked.pub").write_bytes(public)
    for passphrase in (None, "wrong"):
        with pytest.raises(ModelError, match=r"key 'locked\.key' is not a private key .* passphrase if it has one"):
            sign("law.h", "locked.key", passphrase=passphrase)
    sign("law.h", "locked.key", passphrase="täglich")
    verify_signature("law.h", "locked.pub")
    other = ec.generate_private_key(ec.SECP256R1())
    (folder / "ec.key").write_bytes(
        other.private_bytes(form.Encoding.PEM, form.PrivateFormat.PKCS8, form.NoEncryption())
    )
    with pytest.raises(ModelError, match="not a private key of Ed25519"):
        sign("law.h", "ec.key", force=True)


def test_without_the_library_the_error_says_what_to_install(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "cryptography.exceptions", None)
    with pytest.raises(ExportError, match=r"pip install 'convex-synth\[sign\]'"):
        verify_signature("law.c", "mine.pub")


def test_openssl_agrees(folder):
    """The signature is plain Ed25519 of the text that the module names: anybody can check it."""
    data = json.loads((folder / "law.c.sig").read_text())
    (folder / "message").write_bytes(f"convex-synth signature 1\nsha256 {data['sha256']}\n".encode())
    (folder / "raw").write_bytes(base64.b64decode(data["signature"]))
    command = ["openssl", "pkeyutl", "-verify", "-pubin", "-inkey", "mine.pub", "-rawin", "-in", "message"]
    try:
        done = subprocess.run([*command, "-sigfile", "raw"], capture_output=True, text=True)
    except FileNotFoundError:
        pytest.skip("OpenSSL's program is not installed")
    assert done.returncode == 0, done.stderr
