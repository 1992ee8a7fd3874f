"""The CubeSat study from its command line: requirements, the paper's claims, files, and an interruption."""

import html
import json
import re
import threading

import cubesat3u as study
import numpy as np
import pytest
from browser import check, needs_chromium
from studyrun import run

from plants.missions import cubesat3u
from plants.simulation import campaign
from synth import Design
from synth.errors import ModelError
from synth.files import sealed_by_parts

pytestmark = pytest.mark.slow


def growth(controller, delay):
    """Growth per sample of small motions about nadir with `delay` extra samples: the loop is stable below 1."""
    A, B, _, _ = cubesat3u.linear_model()
    x, state, waiting, sizes = np.full(6, 1e-9), controller.init(), [np.zeros(3)] * delay, []
    while len(sizes) < 600 and 1e-14 < np.linalg.norm(x) < 1e-4:  # far from every limit, above rounding
        state, u = controller.step(state, x, np.zeros(6))
        waiting.append(u)
        x = A @ x + B @ waiting.pop(0)
        sizes.append(np.linalg.norm(x))
    late = np.log(sizes[len(sizes) // 2 :])
    return float(np.exp(np.polyfit(np.arange(len(late)), late, 1)[0]))


@pytest.fixture(scope="module")
def flown(tmp_path_factory):
    """Five dispersed runs of full length: the study, its claims by their text, and the folder."""
    return run(study, ["--runs", "5"], tmp_path_factory.mktemp("cubesat3u"))


def test_ekf_with_hinf_meets_table_1_in_every_run(flown):
    met = study.passes(flown[0].campaigns[study.HINF].results)
    assert {name: bool(m.all()) for name, m in met.items()} == dict.fromkeys(study.INDICES, True)


def test_qualitative_findings(flown):
    s, verdicts = flown.study, {text: claim.verdict for text, claim in flown.claims.items()}
    assert not study.passes(s.nominal[study.SVD_HINF])["AKE"]
    assert not study.passes(s.campaigns[study.SVD_HINF].results)["AKE"].any()
    pse = {name: study.worst(i, "pse") for name, i in s.nominal.items()}
    settling = {name: float(i.settling_time) for name, i in s.nominal.items()}
    control = {name: study.worst(i, "control_error") for name, i in s.nominal.items()}
    paper = (study.MPC[0], study.SVD_HINF, study.HINF)
    assert min(paper, key=pse.__getitem__) == study.HINF
    assert min(paper, key=settling.__getitem__) == study.MPC[0]
    assert min(paper, key=control.__getitem__) == study.MPC[0]
    for text in (
        "MPC reaches the desired attitude faster",
        "MPC has the smallest control error",
        "MPC costs more control",
    ):
        assert verdicts[text] == "holds"
    settled = {name: s.campaigns[name].results.settling_time < s.window for name in study.SVD_MPC}
    assert settled[study.SVD_MPC[1]].all()
    assert settled[study.SVD_MPC[0]].mean() < 0.5  # of six runs, which is too few to decide
    assert pse[study.MPC[1]] < 0.6 * pse[study.SVD_HINF]  # so not every form has the worst PSE
    assert verdicts["EKF + MPC has the worst PSE"] != "holds"  # six runs do not decide on the other form, 31 do
    assert "not measured" not in verdicts.values()


def test_what_the_paper_does_not_say(flown):
    s, _, _ = flown
    hinf, pd = s.nominal[study.HINF], s.nominal[study.PD]
    assert study.worst(pd, "pse") < study.worst(hinf, "pse")
    later = s.campaigns[study.PD].results.settling_time - s.campaigns[study.HINF].results.settling_time
    assert np.abs(np.median(later)) < 5  # s: of the same bandwidth
    table = {row[0]: row for row in study.filters(s).rows}
    before, after = (float(next(row[1] for name, row in table.items() if name.startswith(kind) and "table 3" in name))
                     for kind in ("paper's", "EKF, ours"))  # fmt: skip
    assert before == pytest.approx(13.9, abs=1.5)  # of the issue, for 9 expected
    assert 9 <= after < 11
    growths = {name: growth(c, 1) for name, c in s.controllers.items()}
    assert growths["MPC velocity"] == pytest.approx(1.627, abs=0.05)  # literature: rho 1.12 to 1.63
    assert growths["MPC position"] == pytest.approx(1.123, abs=0.02)
    assert growths["Hinf"] < 1
    assert growth(s.controllers["Hinf"], 5) < 1 < growth(s.controllers["Hinf"], 6)  # a delay margin of 5.5 samples


def test_dispersions_were_applied(flown):
    s, _, _ = flown
    for flight in s.campaigns.values():
        assert flight.complete
        np.testing.assert_allclose(flight.applied.inertia, flight.dispersed.inertia, rtol=1e-12)
        assert any("inertia" in name for name in flight.varied)


def test_files_and_report(flown):
    s, _, out = flown
    design = Design.load(out / "hinf.json")
    assert design.controller.digest() == s.design.controller.digest()
    assert design.plant.units["Tx"] == "N m"
    assert {p.name for p in out.iterdir() if not p.name.startswith("box_")} == {
        "hinf.json", "hinf.mat", "mpc_velocity.json", "mpc_velocity.mat", "mpc_position.json", "mpc_position.mat",
        "report.html", "indices.png", "runs", "claims.json", "figures", "hinf.c", "hinf.h",
    }  # fmt: skip
    proofs = {f"box_{law}_margin.json" for law in ("hinf", "pd", "mpc_velocity", "mpc_position")}
    assert {p.name for p in out.glob("box_*")} == proofs | {"box_hinf_10.json", "box_hinf_30.json"}
    assert json.loads((out / "mpc_position.json").read_text())["form"] == "position"
    page = (out / "report.html").read_text()
    assert page.count("<figure>") == 14
    for number in range(7, 17):
        assert re.search(rf"figure {number}\b", page)
    assert not re.search(r'(src|href)="(https?:)?//', page)
    assert "EKF + PD" in page
    assert 'id="pointing-budget"' in page
    assert re.search(r"\d \| \d+(\.\d+)? \(\d", page)  # predicted beside measured
    assert "complete" in page
    for fact in s.design.facts.values():
        assert f"<dd>{html.escape(fact)}</dd>" in page
    assert {r.name.split(",")[0] for r in study.margins(s)} == set(study.INDICES)
    assert all(r.met for r in study.margins(s))


@needs_chromium
def test_report_in_a_browser(flown):
    check(flown[2] / "report.html", figures=14)


@pytest.mark.parametrize("when", [1, 2])
def test_interruption_keeps_what_was_flown(tmp_path, monkeypatch, capsys, when):
    real, calls = campaign.campaign, []

    def interrupted(*arguments, **options):
        """Ctrl-C comes to the main thread; beside it those fly that are stepped from Python."""
        if threading.current_thread() is threading.main_thread():
            calls.append(1)
            if len(calls) == when:
                raise KeyboardInterrupt
        return real(*arguments, **options)

    monkeypatch.setattr(study, "campaign", interrupted)
    assert study.main(["--fast", "--runs", "1", "--out", str(tmp_path)]) == 130
    assert "INTERRUPTED" in (tmp_path / "report.html").read_text()
    printed = capsys.readouterr().out
    assert "EKF + Hinf" in printed
    assert "NOT MEASURED: interrupted before" in printed


def test_bad_options_are_refused(capsys):
    for arguments, message in ((["--runs", "0"], "at least one run"), (["--seed", "-1"], "at least 0")):
        with pytest.raises(SystemExit):
            study.main(arguments)
        assert message in capsys.readouterr().err


def test_requirements_are_those_of_table_1():
    assert study.BOUNDS == pytest.approx({"APE": 0.65, "control error": 0.31, "AKE": 0.31, "PSE": 0.12})
    assert cubesat3u.REQUIREMENTS.pse_interval == 1.0


def test_a_changed_controller_file_is_refused(flown, tmp_path):
    data = json.loads((flown[2] / "hinf.json").read_text())
    data["plant"]["A"][0][0] += 1e-9
    (tmp_path / "hinf.json").write_text(json.dumps(data))
    with pytest.raises(ModelError, match=r"plant\.A was changed"):
        Design.load(tmp_path / "hinf.json")
    (tmp_path / "hinf.json").write_text(json.dumps(sealed_by_parts(data)))
    with pytest.raises(ModelError, match="plant_sha256"):
        Design.load(tmp_path / "hinf.json")
