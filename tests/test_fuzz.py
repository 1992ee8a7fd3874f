"""Twenty thousand damaged files over all readers: typed errors only, and none that hangs; nothing forged is taken.

FUZZ_SEED=7 FUZZ_FILES=100000 python -m pytest -s tests/test_fuzz.py       other files, or more of them
"""

import io
import json
import os
import signal
import sys
import time
import traceback
from collections import Counter

import numpy as np
import pytest
import scipy.io
from literature import cubesat_model, cubesat_pecorilla2024
from studyfiles import MIXED, SHAPING
from tampering import mutated, rearranged, tampered

from synth import AntiWindup, Certificate, Design, export, keygen, mpc, ncfsyn, sign, verify_signature
from synth.command.look import facts
from synth.command.specification import read_study
from synth.delivery.modelfiles import read, save_system
from synth.delivery.qp import load_mpc, save_mpc
from synth.errors import SynthError
from synth.files import sealed, sealed_by_parts
from synth.synthesis.hinfinity import hinfsyn
from synth.systems.generalized import GeneralizedPlant
from synth.systems.statespace import StateSpace

SEED, FILES = int(os.environ.get("FUZZ_SEED", "0")), int(os.environ.get("FUZZ_FILES", "20000"))
PATIENCE = 30.0  # s, for one file
MAT = 40  # damaged .mat files, each of which takes a process and half a second
SYSTEM = {"format": "convex-synth system", "format_version": 1, "dt": 0.5, "delay": 1.0, "u": ["a"], "y": ["b"]}
FORMS = {
    "system": {"A": [[0.9, 0.1], [0.0, 0.8]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "D": [[0.0]]},
    "polynomials": {"num": [[1.0, 0.5]], "den": [[1.0, -0.5, 0.06]]},
    "roots": {"zeros": [0.5], "poles": ["0.1+0.2j", "0.1-0.2j"], "gain": 2.0},
}
KINDS = ("design", "shaped", "controller", "limited", "plant", *FORMS, "certificate", "mpc", "signature", "toml", "mat")


class Hang(BaseException):
    """A file took longer than `PATIENCE`."""


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A sound file of each kind: kind -> content."""
    folder = tmp_path_factory.mktemp("sound")
    G = StateSpace([[1.0, 1.0], [0.0, 1.0]], [[0.5], [1.0]], [[1.0, 0.0]], 0, 1.0)
    small = GeneralizedPlant.tracking(G * 0.5, Wproc=0.1, Wdist=0.1, Werr=1, Wact=1, Wr=1)
    design, shaped = hinfsyn(small, method="riccati"), ncfsyn(G)
    design.save(folder / "design.json")
    shaped.save(folder / "shaped.json")
    export(design.controller, "json", folder, name="controller")
    export(AntiWindup.of(shaped, -1.0, np.inf), "json", folder, name="limited")
    save_system(folder / "plant.json", cubesat_pecorilla2024())
    for name, parts in FORMS.items():
        (folder / f"{name}.json").write_text(json.dumps(SYSTEM | parts))
    design.certify().save(folder / "certificate.json")
    weights = {"Q": 1e3 * np.eye(6), "R": 1e3 * np.eye(3)}
    save_mpc(mpc(cubesat_model(), **weights, Np=4, Nc=2, umin=-1e-3, umax=1e-3, form="position"), folder / "mpc.json")
    keygen(folder / "pair")
    (folder / "signature.json").write_text("signed")
    signed = sign(folder / "signature.json", folder / "pair.key").read_bytes()
    found = {path.stem: path.read_bytes() for path in folder.glob("*.json")} | {"signature": signed}
    scipy.io.savemat(content := io.BytesIO(), FORMS["system"] | {"dt": 0.5})
    return found | {"toml": SHAPING.encode(), "mat": content.getvalue()}, folder


def use(path, folder):
    """A file is read by all that might be asked to, and what was read is shown and handed on."""
    refused = 0
    for reader in (read, Design.load):
        try:
            item = reader(path)
            facts(item)
            repr(item)
            if isinstance(item, Design):
                item._repr_html_()
            if not isinstance(item, GeneralizedPlant):
                source = item if isinstance(item, Design) else item.limited or item.system
                export(source, "c", folder / "out", force=True, allow_unstable=True)
        except SynthError as error:
            refused, last = refused + 1, error
    if refused == 2:
        raise last


def proved(path, folder):
    Certificate.load(path).check()


def signed(path, folder):
    (folder / "signature.json.sig").write_bytes(path.read_bytes())
    verify_signature(folder / "signature.json", folder / "pair.pub")


READERS = {
    "certificate": proved, "mpc": lambda path, folder: load_mpc(path), "signature": signed,
    "toml": lambda path, folder: read_study(path), "mat": lambda path, folder: read(path),
}  # fmt: skip


def damaged(kind: str, content: bytes, rng: np.random.Generator) -> bytes:
    """Changes of the bytes or of the data; seals are renewed for half of them, so that what comes after is tried."""
    if kind == "mat":
        changed = bytearray(content)
        for at in rng.integers(len(content), size=int(rng.integers(1, 4))):
            changed[at] = rng.integers(256)
        return bytes(changed[: rng.integers(len(content))] if rng.random() < 0.1 else changed)
    if kind == "toml":
        content = (SHAPING, MIXED)[int(rng.integers(2))].encode()
    elif rng.random() < 0.7:
        data = rearranged(json.loads(content), rng)
        if isinstance(data, dict) and rng.random() < 0.8:
            data = sealed_by_parts(data) if "parts_sha256" in data else sealed(data) if "sha256" in data else data
        return json.dumps(data).encode()
    for _ in range(int(rng.integers(1, 4))):
        content = mutated(content, rng) or b" "
    return content


def late(*_):
    raise Hang


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")  # of numbers such as 1e300, which the checks after them refuse
@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="there are no timers here")
def test_damaged_files_end_in_typed_errors_and_in_time(files, tmp_path, capsys):
    import resource

    (sound, folder), rng, found, bare, longest = files, np.random.default_rng(SEED), Counter(), {}, 0.0
    mat = min(MAT, FILES // 500)
    counts = dict.fromkeys(KINDS, (FILES - mat) // (len(KINDS) - 1)) | {"mat": mat}
    before, started = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.process_time()
    previous = signal.signal(signal.SIGALRM, late)
    try:
        for kind, count in counts.items():
            path = tmp_path / ("x" + {"toml": ".toml", "mat": ".mat"}.get(kind, ".json"))
            path.write_bytes(sound[kind])
            READERS.get(kind, use)(path, folder)
            for k in range(count):
                path.write_bytes(damaged(kind, sound[kind], rng))
                began = time.perf_counter()
                signal.setitimer(signal.ITIMER_REAL, PATIENCE)
                try:
                    READERS.get(kind, use)(path, folder)
                    found[kind, "read"] += 1
                except SynthError:
                    found[kind, "refused"] += 1
                except BaseException as error:
                    if isinstance(error, KeyboardInterrupt):
                        raise
                    where = traceback.extract_tb(error.__traceback__)[-1]
                    key = (kind, type(error).__name__, where.name)
                    bare.setdefault(key, (k, str(error)[:200], path.read_bytes()[:2000]))
                finally:
                    signal.setitimer(signal.ITIMER_REAL, 0)
                longest = max(longest, time.perf_counter() - began)
    finally:
        signal.signal(signal.SIGALRM, previous)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    unit = 1024 if sys.platform == "linux" else 1024**2  # KiB, elsewhere bytes
    with capsys.disabled():
        print(
            f"\n{sum(counts.values())} damaged files in {time.process_time() - started:.0f} s of CPU, the longest"
            f" {longest:.2f} s; peak memory {peak / unit:.0f} MiB, before {before / unit:.0f} MiB; {dict(found)}"
        )
    assert not bare, bare
    assert peak - before < 512 * unit


@pytest.mark.slow
def test_five_hundred_tamperings_are_all_refused(files, tmp_path, capsys):
    """One change of a number in its last bit, of a text, a structure or a name; who tampers does not renew the seal."""
    (sound, folder), rng, tried = files, np.random.default_rng(SEED), Counter()
    readers = READERS | dict.fromkeys(("design", "shaped", "controller", "limited"), lambda path, _: read(path))
    for kind in ("design", "shaped", "controller", "limited", "certificate", "mpc", "signature"):
        data = json.loads(sound[kind])
        while tried[kind] < 100:
            changed = tampered(data, rng)
            if json.dumps(changed) == json.dumps(data):
                continue
            (tmp_path / "x.json").write_text(json.dumps(changed))
            tried[kind] += 1
            with pytest.raises(SynthError):
                readers[kind](tmp_path / "x.json", folder)
    with capsys.disabled():
        print(f"\n{sum(tried.values())} tamperings, 0 accepted: {dict(tried)}")
