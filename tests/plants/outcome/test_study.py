"""The frame of the studies: options, interruptions, verdicts, and what is printed and written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from plants.outcome import report, study
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
