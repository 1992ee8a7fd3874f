"""The frame of the studies: options, interruptions, verdicts, and what is printed and written."""

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest
from browser import CHROMIUM, FLAGS, SCREENS, check, needs_chromium

from plants.outcome import figures, report, study
from plants.outcome.claims import Reading, Rule, drawn, left_out
from plants.outcome.study import Statement, Study, Table


def conclude(found: Study, out: Any, statements: list[Statement], **more: Any) -> int:
    table = Table("Levels", ("name", "level"), [["a", "0.1"], ["b", "0.3"]], [["", "pass"], ["", "fail"]], "both axes")
    words = {"title": "A study", "subtitle": "after nobody", "settings": "2 runs"}
    return study.conclude(found, out, tables=[table], statements=statements, **words, **more)


def ended(work: Callable[[], Any]) -> Any:
    with pytest.raises(SystemExit) as caught:
        work()
    return caught.value.code


def test_a_study_prints_and_writes_the_same(tmp_path, capsys):
    found = Study()
    study.carry_out(found, lambda: None)
    claims = [Statement("It <flies>", "section 1", lambda: ("holds", "all of it"))]
    assert conclude(found, tmp_path / "new", claims, findings=["Nobody says so."], notes=["plant 0123"]) == 0
    page, printed = (tmp_path / "new" / "report.html").read_text(), capsys.readouterr().out
    for text in ("both axes", "0.3", "all of it", "Nobody says so."):
        assert text in page
        assert text in printed
    assert "It &lt;flies&gt;" in page
    assert "HOLDS: all of it" in printed
    assert "2 runs; complete" in page
    assert "plant 0123" in page
    assert "numpy " + np.__version__ in page


def test_an_interrupted_study_says_so(tmp_path, capsys):
    found = Study()

    def interrupted() -> None:
        raise KeyboardInterrupt

    study.carry_out(found, interrupted)
    assert not found.complete
    missing: dict[str, int] = {}
    claims = [Statement("It lands", "section 2", lambda: ("holds", str(missing["landing"])))]
    assert conclude(found, tmp_path, claims) == study.INTERRUPTED
    assert "INTERRUPTED" in (tmp_path / "report.html").read_text()
    assert "NOT MEASURED: interrupted before landing" in capsys.readouterr().out


def test_errors_are_not_taken_for_interruptions():
    def broken() -> None:
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        study.carry_out(Study(), broken)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--runs", "0"], "--runs 0: at least one run is needed"),
        (["--seed", "-1"], "--seed -1: give a whole number of at least 0"),
        (["--replay", "-3"], "--replay -3: give a whole number of at least 0"),
        (["--runs", "many"], "invalid int value: 'many'"),
    ],
)
def test_options_that_make_no_sense(arguments, message, capsys):
    parser = study.parser("A study of nothing.\n\nMore.", out="out/nothing", fast="less", runs=3)
    parser.add_argument("--replay", type=int)
    assert ended(lambda: study.parse(parser, arguments, natural=["replay"])) == 2
    assert message in capsys.readouterr().err


def test_a_folder_that_cannot_be_written_is_told_before_anything_is_flown(tmp_path, capsys, monkeypatch):
    parser = study.parser("A study of nothing.", out="out/nothing", fast="less", runs=3)
    (tmp_path / "file").touch()
    for folder in (tmp_path / "file", tmp_path / "file" / "x"):
        assert ended(lambda folder=folder: study.parse(parser, ["--out", str(folder)])) == 2
        assert f"error: --out {folder}: " in capsys.readouterr().err
    assert study.parse(parser, ["--out", str(tmp_path / "new" / "one")]).out.is_dir()

    def refused(*_):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "write_bytes", refused)
    assert ended(lambda: study.parse(parser, ["--out", str(tmp_path)])) == 2
    assert "Permission denied; give a folder that can be written" in capsys.readouterr().err


def test_help_names_defaults(capsys):
    parser = study.parser("A study of nothing.\n\nMore.", out="out/nothing", fast="less", runs=3, what="flights")
    assert ended(lambda: study.parse(parser, ["--help"])) == 0
    printed = capsys.readouterr().out
    for text in ("A study of nothing.", "flights (default 3)", "less: a quick look", "out/nothing"):
        assert text in printed
    assert "More." not in printed


def test_verdicts_of_two_cases():
    assert study.either(True, True, "luck") == "holds"
    assert study.either(True, False, "luck") == study.either(False, True, "luck") == "depends on luck"
    assert study.either(False, False, "luck") == "does not hold"


def test_two_chains_of_flights_go_on_beside_each_other_and_end_together():
    met = threading.Barrier(2, timeout=30)
    study.beside(met.wait, lambda ended: met.wait())  # neither could end alone

    def interrupted():
        raise KeyboardInterrupt

    told = []
    with pytest.raises(KeyboardInterrupt):
        study.beside(interrupted, lambda ended: told.append(ended.wait(30)))
    assert told == [True]
    with pytest.raises(ZeroDivisionError):
        study.beside(lambda: None, lambda ended: 1 / 0)


def test_highlights_count_what_was_measured():
    requirements = [report.Requirement("APE", 0.1, 0.4, "deg"), report.Requirement("PSE", 0.3, 0.2, "deg")]
    verdicts = ("holds", "holds", "depends on the axis", "does not hold", "not measured")
    found = study.highlights(requirements, [report.Claim("", "", verdict, "") for verdict in verdicts])
    assert [number for number, _ in found] == ["1 of 2", "-50 %", "2 of 4", "1 of 4", "1 of 4"]
    assert found[1][1] == "least margin: PSE"
    assert study.highlights([], []) == []


def test_requirements_and_cards_are_printed_and_written(tmp_path, capsys):
    cards = [report.Card("The law", [("gamma", "0.99")], [("k.json", "the file")])]
    requirements = [report.Requirement("APE", 0.1, 0.4, "deg"), report.Requirement("PSE", 0.3, 0.2, "deg")]
    assert conclude(Study(complete=True), tmp_path, [], requirements=requirements, cards=cards) == 0
    page, printed = (tmp_path / "report.html").read_text(), capsys.readouterr().out
    assert "PSE 0.3 deg (at most 0.2 deg): margin -50 %, NOT MET" in printed
    assert "+75 %" in page
    assert "<dd>0.99</dd>" in page
    assert 'href="k.json" download' in page


def test_a_design_is_saved_and_has_a_card(tmp_path):
    class Design:
        facts: ClassVar = {"gamma": "0.99"}

        def save(self, path):
            path.write_text(path.suffix)

    made = study.card("The law", Design(), tmp_path / "new", "law")
    assert made.facts == [("gamma", "0.99")]
    assert [(tmp_path / "new" / name).read_text() for name, _ in made.files] == [".json", ".mat"]


def complete(out) -> None:
    """A study with everything that a page may have."""
    found, time = Study(), np.linspace(0, 10, 50)
    study.carry_out(found, lambda: None)
    first = figures.histories({"one": (time, np.sin(time)[:, None]), "two": (time, np.cos(time)[:, None])}, ["error"])
    conclude(
        found,
        out,
        [Statement("It flies", "section 1", lambda: [Reading("", 0.5)], Rule("error", "<", 1, "deg"))],
        requirements=[report.Requirement("APE", 0.13, 0.65, "deg")],
        findings=["Nobody says so."],
        paper="009 Nobody (2026)",
        counterparts=[
            drawn("figure 1", "error", "At a glance"),
            left_out("figure 2", "a photograph", "nothing to fly"),
        ],
        summary="Take one: it is the best.",
        abbreviations={"APE": "absolute performance error"},
        first=(first, "The errors."),
    )


def test_a_page_says_first_what_a_reader_needs(tmp_path, capsys):
    complete(tmp_path)
    page, told = (tmp_path / "report.html").read_text(), capsys.readouterr().out
    order = ["Take one", "requirements met", "The errors.", "Margins</h2>", "Levels</h2>", "It flies", "Nobody says",
             "absolute performance error", "Provenance</h2>"]  # fmt: skip
    places = [page.index(text) for text in order]
    assert places == sorted(places)
    assert "Take one: it is the best." in told
    assert "1 of 1" in page  # claims that hold: what is drawn or left out is none
    assert (tmp_path / "figures" / "at-a-glance-1.csv").read_text().startswith('"time, s","error: one"')
    stored = json.loads((tmp_path / "claims.json").read_text())
    assert [c["verdict"] for c in stored["claims"]] == ["holds", "drawn", "left out"]
    assert stored["paper"] == "009 Nobody (2026)"


@pytest.mark.slow
@needs_chromium
def test_the_first_figure_is_on_the_first_screen_and_can_be_enlarged(tmp_path):
    from playwright.sync_api import sync_playwright

    complete(tmp_path)
    check(tmp_path / "report.html", figures=1)
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        for width, height in SCREENS.values():
            page = browser.new_page(viewport={"width": width, "height": height})
            page.goto((tmp_path / "report.html").as_uri())
            picture = page.locator("figure svg").first
            before = picture.bounding_box()
            assert before is not None
            assert before["y"] < height
            assert before["x"] + before["width"] <= width  # nothing of it is off the screen
            page.get_by_label("enlarge").first.check()
            after = picture.bounding_box()
            assert after is not None
            assert after["width"] > 1.9 * min(before["width"], width)
            assert page.evaluate("document.documentElement.scrollWidth <= innerWidth")
            page.close()
        browser.close()
