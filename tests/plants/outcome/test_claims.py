"""Verdicts by rules that are data, and paired comparisons."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

from plants.errors import ScenarioError, StoreError
from plants.outcome import claimspage
from plants.outcome.claims import Reading, Rule, Statement, drawn, judged, left_out, stored_claims
from plants.outcome.paired import paired
from plants.outcome.report import Claim

BELOW = Rule("pointing error", "<", 0.2, "deg")
NUMBERS = st.floats(-1e3, 1e3, width=32)


@pytest.mark.parametrize(
    ("readings", "verdict"),
    [
        ([Reading("a", 0.1), Reading("b", 0.19)], "holds"),
        ([Reading("a", 0.2), Reading("b", 0.3)], "does not hold"),
        ([Reading("a", 0.1), Reading("b", 0.3)], "depends on the filter"),
        ([Reading("a", 0.1, 0.05, 0.15)], "holds"),
        ([Reading("a", 0.1, 0.05, 0.25)], "not decided"),
        ([Reading("a", 0.3, 0.2, 0.4)], "does not hold"),
        ([Reading("a", 0.1), Reading("b", 0.1, 0.0, 0.3)], "not decided"),
        ([Reading("a", 0.1), Reading("b", 0.1, 0.0, 0.3), Reading("c", 1)], "depends on the filter"),
        ([Reading("a", np.nan)], "does not hold"),
        ([Reading("a", np.inf)], "does not hold"),
        ([], "not measured"),
    ],
)
def test_a_verdict_is_the_side_of_the_bound_on_which_all_readings_are(readings, verdict):
    (claim,) = judged([Statement("It points", "table 1", lambda: readings, BELOW, "0.2", "the filter", "because")])
    assert claim.verdict == verdict
    assert (claim.printed, claim.rule, claim.why) == ("0.2", "pointing error below 0.2 deg", "because")


@given(NUMBERS, st.floats(0, 10, width=32), st.sampled_from(["<", "<=", ">", ">="]), NUMBERS)
def test_an_interval_decides_only_with_both_ends(value, half, relation, bound):
    """What the rule says of the ends alone it says of the interval, and nothing if they differ."""
    rule, ends = Rule("x", relation, bound), (value - half, value + half)
    alone = [rule.met(Reading("", end)) for end in ends]
    assert rule.met(Reading("", value, *ends)) is (alone[0] if alone[0] == alone[1] else None)


def test_what_was_measured_is_said_with_its_interval_and_unit():
    claim = judged([Statement("t", "s", lambda: [Reading("MPC", 0.123456, 0.1, 0.15, "12 of 30")], BELOW)])[0]
    assert claim.measured == "MPC 0.1235 (0.1 to 0.15) deg [12 of 30]"


@pytest.mark.parametrize(("relation", "bound", "named"), [("=", 1, "relation"), ("<", np.nan, "bound")])
def test_a_rule_that_is_none_is_refused(relation, bound, named):
    with pytest.raises(ScenarioError, match=f"{named} of the rule for speed"):
        Rule("speed", relation, bound)


def test_claims_are_stored_with_figures_that_state_nothing():
    rows = [drawn("figure 7", "attitude", "Figures"), left_out("table 2", "hardware", "not in the text")]
    stored = json.loads(stored_claims("003", rows, "2 runs", True))
    assert [(c["source"], c["verdict"], c["why"]) for c in stored["claims"]] == [
        ("figure 7", "drawn", ""), ("table 2", "left out", "not in the text"),
    ]  # fmt: skip


@given(st.lists(st.tuples(NUMBERS, NUMBERS), min_size=1, max_size=40))
def test_paired_agrees_with_scipy(pairs):
    """The interval of the median with SciPy's quantile test, the sign test with the binomial one."""
    a, b = np.array(pairs).T
    found = paired(a, b)
    low, high = stats.quantile_test(a - b, q=0, p=0.5).confidence_interval()
    expected = (-np.inf if np.isnan(low) else low, np.inf if np.isnan(high) else high)
    np.testing.assert_allclose((found.low, found.high), expected)
    moved = found.smaller + found.larger
    assert found.sign == pytest.approx(stats.binomtest(found.smaller, moved).pvalue if moved else 1.0)
    assert found.low <= found.median <= found.high
    other = paired(b, a)
    np.testing.assert_allclose((-other.median, -other.high, -other.low), (found.median, found.low, found.high))
    assert other.effect == pytest.approx(-found.effect)


def test_ranks_decide_as_wilcoxon():
    rng = np.random.default_rng(0)
    a = rng.normal(size=(20, 60))
    for x in a:
        assert paired(x, np.zeros(60)).wilcoxon == pytest.approx(stats.wilcoxon(x, method="asymptotic").pvalue)
        assert paired(x[:20], np.zeros(20)).wilcoxon == pytest.approx(stats.wilcoxon(x[:20]).pvalue)


def test_the_interval_of_the_median_covers_it():
    """Skewed differences, 19 in 20 times or more; the signed-rank interval would need symmetry."""
    draws = np.random.default_rng(1).exponential(size=(2000, 17)) - np.log(2)
    hits = sum(p.low <= 0 <= p.high for p in (paired(d, np.zeros(17)) for d in draws))
    assert hits >= 1900


def test_a_run_that_never_got_there_is_larger_than_any_number():
    inf = np.inf
    found = paired([1, 2, 3, 4, 5, 6, 7, inf], [9, 9, 9, 9, 9, inf, inf, inf])
    assert (found.smaller, found.larger, found.median, found.high) == (7, 0, -6.5, 0.0)
    assert paired(np.exp([1, 2, 3.0]), np.exp([0, 1, 2.0]), ratio=True).median == pytest.approx(np.e)


@pytest.mark.parametrize(
    ("first", "second", "ratio", "named"),
    [
        ([1, 2], [1], False, "2 runs of the first, 1 of the second"),
        ([], [], False, r"first: shape \(0,\)"),
        ([1, np.nan], [1, 2], False, "first: run 1 is NaN"),
        ([1, 2], [0, 2], True, "second: 0 is not positive"),
    ],
)
def test_unusable_pairs_are_refused(first, second, ratio, named):
    with pytest.raises(ScenarioError, match=named):
        paired(first, second, ratio=ratio)


def stored(folder, paper, *verdicts):
    """A study's folder."""
    folder.mkdir()
    claims = [Claim(f"claim {k} of {paper}", "section 1", v, "0.1 <m>") for k, v in enumerate(verdicts)]
    (folder / "claims.json").write_text(stored_claims(paper, claims, "2 runs", True), encoding="utf-8")
    return folder


def test_the_page_of_all_papers_counts_every_line(tmp_path, capsys):
    """Two studies of one paper are one section; the links lead to the reports."""
    folders = [stored(tmp_path / "b", "002", "holds", "depends on x"), stored(tmp_path / "a", "001", "does not hold"),
               stored(tmp_path / "c", "002", "left out", "drawn", "not decided")]  # fmt: skip
    assert claimspage.main([*map(str, folders), "--out", str(tmp_path / "claims")]) == 0
    lines = [line.split() for line in capsys.readouterr().out.splitlines()[1:4]]
    assert lines == [
        ["001", "1", "0", "0", "1", "0", "0", "0", "0"],
        ["002", "5", "1", "1", "0", "1", "0", "1", "1"],
        ["all", "6", "1", "1", "1", "1", "0", "1", "1"],
    ]
    page = (tmp_path / "claims" / "index.html").read_text(encoding="utf-8")
    assert page.count("<section") == 3
    for link in ("../a/report.html", "../b/report.html", "../c/report.html"):
        assert f'href="{link}"' in page
    assert "0.1 &lt;m&gt;" in page


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", "null", '{"paper": 1, "settings": "", "complete": true, "claims": []}',
             '{"paper": "", "settings": "", "complete": true, "claims": [{"text": "x"}]}', "[" * 10_000, "\x00"],
)  # fmt: skip
def test_a_damaged_file_of_claims_is_refused(tmp_path, text, capsys):
    (tmp_path / "claims.json").write_text(text, encoding="utf-8")
    with pytest.raises(StoreError, match=r"not the claims of a study .*run the study again"):
        claimspage.read_claims(tmp_path)
    with pytest.raises(SystemExit):
        claimspage.main([str(tmp_path), "--out", str(tmp_path / "claims")])
    assert "run the study again" in capsys.readouterr().err
    with pytest.raises(StoreError, match="there is no such file; run the study with --out"):
        claimspage.read_claims(tmp_path / "nowhere")
