"""`synth verify` of certificates over a box: proved again from the file alone, and nothing tampered with is."""

import hashlib
import json
import subprocess
import sys

import numpy as np
import pytest
from tampering import tampered
from uncertain import de_gaston_safonov, random_loop, two_masses

from synth import stability_margin, worst_gain
from synth.__main__ import main


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("boxes")
    worst_gain(two_masses()).certificate.save(folder / "gain.json")
    stability_margin(de_gaston_safonov()).certificate.save(folder / "margin.json")
    return folder


@pytest.fixture
def synth(folder, monkeypatch, capsys):
    """Run the command in the folder: (exit code, what it printed, its errors)."""
    monkeypatch.chdir(folder)

    def run(*arguments: str):
        try:
            code = main(list(arguments))
        except SystemExit as stop:
            code = stop.code
        printed = capsys.readouterr()
        return code, printed.out, printed.err

    return run


def test_it_is_proved_again_from_its_file_alone(synth):
    code, out, _ = synth("verify", "gain.json", "margin.json")
    assert code == 0
    assert out.count("proved again") == 2
    assert "H-infinity norm below 1.0475" in out
    assert "m1 in [0.8, 1.2]" in out
    assert "stable on the box" in out
    code, out, _ = synth("verify", "gain.json", "--json")
    assert json.loads(out)[0]["proved"] is True
    assert 1.0475 < json.loads(out)[0]["lower"] < json.loads(out)[0]["upper"]


def test_info_says_that_it_proves_nothing(synth):
    assert "not here; synth verify proves it again" in synth("info", "gain.json")[1]


def test_a_design_means_nothing(synth):
    code, _, error = synth("verify", "gain.json", "--design", "gain.json")
    assert (code, error.count("\n")) == (2, 1)


def test_the_command_loads_no_solver(folder):
    code = (
        "import sys; from synth.__main__ import main; c = main(['verify', sys.argv[1]]);"
        "assert c == 0 and not {m.split('.')[0] for m in sys.modules} & {'cvxpy', 'clarabel', 'jax', 'control'};"
        "assert not {'synth.synthesis.hinfinity', 'synth.analysis.worstcase', 'synth.proof.worstcase'} & {*sys.modules}"
    )
    subprocess.run([sys.executable, "-c", code, str(folder / "margin.json")], check=True, stdout=subprocess.DEVNULL)


def is_accepted(synth, path, data) -> bool:
    path.write_text(json.dumps(data))
    code, out, error = synth("verify", str(path))
    assert code in (0, 1, 2)
    assert code == 0 or (out, error.count("\n")) == ("", 1)
    return code == 0


def resealed(data: dict) -> dict:
    rest = {key: value for key, value in data.items() if key != "sha256"}
    return {**rest, "sha256": hashlib.sha256(json.dumps(rest).encode()).hexdigest()}


@pytest.mark.parametrize("name", ["gain.json", "margin.json"])
def test_nothing_tampered_with_is_accepted(synth, folder, tmp_path, name):
    data, rng = json.loads((folder / name).read_text()), np.random.default_rng(1)
    for _ in range(25):
        changed = tampered(data, rng)
        if json.dumps(changed) != json.dumps(data):
            assert not is_accepted(synth, tmp_path / "t.json", changed), changed
    assert is_accepted(synth, tmp_path / "t.json", data)


@pytest.mark.slow
def test_nothing_tampered_with_of_fifty_loops_is_accepted(synth, tmp_path):
    tried = 0
    for seed in range(200, 250):
        G, rng = random_loop(seed), np.random.default_rng(seed)
        found = worst_gain(G) if seed % 2 else stability_margin(G)
        if found.certificate is None:
            found = stability_margin(G)
        data = json.loads(found.certificate.save(tmp_path / "c.json").read_text())
        while tried < 4 * (seed - 199):
            changed = tampered(data, rng)
            if json.dumps(changed) != json.dumps(data):
                tried += 1
                assert not is_accepted(synth, tmp_path / "t.json", changed), changed
        assert is_accepted(synth, tmp_path / "t.json", data)
    assert tried == 200


@pytest.mark.parametrize(
    "change",
    [
        lambda d: d.update(level=d["level"] * 0.9999),
        lambda d: d.update(reached=d["reached"] * 1.0001),
        lambda d: d.update(script=[]),
        lambda d: d.update(script=["." * len(d["script"][0])]),
        lambda d: d["system"]["parameters"][0].update(high=1.3),
        lambda d: d["system"]["A"][2].__setitem__(0, -3.0),
        lambda d: d.update(edges=d["edges"][:4]),
        lambda d: d.update(edges=d["edges"][:1] * 40),
        lambda d: d.update(point={"k": 1.0, "m1": 1.0, "m2": 1.0}),
        lambda d: d.update(point={"k": 1.0}),
        lambda d: d.update(point={}),
        lambda d: d.update(w=0.0),
        lambda d: d.update(quantity="stability"),
        lambda d: d.update(bits=53),
    ],
)
def test_a_seal_that_was_renewed_does_not_help(synth, folder, tmp_path, change):
    """Whoever changes a claim and knows how the sha256 is made still has to prove it."""
    data = json.loads((folder / "gain.json").read_text())
    statement = data["statement"]
    change(data)
    assert not is_accepted(synth, tmp_path / "t.json", resealed(data))
    data["statement"] = statement.replace("1.0475", "1.0474")
    assert not is_accepted(synth, tmp_path / "t.json", resealed(data))
