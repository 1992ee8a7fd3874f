"""Pages of studies: what they say, and how a real browser shows them."""

import csv
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from browser import CHROMIUM, FLAGS, check, needs_chromium

from plants.outcome import figures, inline, report, study
from plants.outcome.report import Card, Claim, Html, Requirement, Section

LONG = "a sentence that goes on, as verdicts do, with figures 0.1234 and names that are long: " * 3
REQUIREMENTS = [
    Requirement("APE", 0.13, 0.65, "deg"),
    Requirement("PSE", 0.36, 0.12, "deg"),
    Requirement("stability margin", 0.3, 0.25, "", least=True),
    Requirement("settling time", np.inf, 60.0, "s"),
]
CLAIMS = [Claim("It points <well>", "table 1", "holds", LONG), Claim("It is fast", "", "does not hold", "2 s"),
          Claim("It is best", "", "depends on the index", LONG), Claim("It lasts", "", "not measured", "")]  # fmt: skip


def example() -> str:
    """Every element that a page may have."""
    time = np.linspace(0, 10, 50)
    drawn = figures.histories({"one": (time, np.sin(time)[:, None])}, ["angle, deg"])
    dense = figures.spread([(time, np.cos(k * time)[:, None]) for k in range(3)], ["rate"], until=10.0)
    wide = report.table(["name", *(f"column {k}" for k in range(9))], [["row", *range(9)]],
                        marks=[["", "pass", "fail", *[""] * 7]])  # fmt: skip
    card = Card("H-infinity & co", [("order", 6), ("hash", "0123456789abcdef" * 4)], [("k.json", "a file")], "Note.")
    sections = [
        Section("Requirements", report.requirements_table(REQUIREMENTS)),
        Section("Claims", report.claims_table(CLAIMS)),
        Section("Claims", wide + report.paragraph("1 < 2")),
        Section("Controllers", report.cards([card])),
        Section("Figures", report.figure(drawn, "A history.", salt="a") + report.figure(dense, "Many.", salt="b")),
    ]
    return report.page("A study", "of nothing", sections, ["seed 0"], highlights=[("2 of 4", "met")])


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    (folder / "k.json").write_text("{}")
    (folder / "report.html").write_text(example(), encoding="utf-8")
    return folder / "report.html"


def test_margins():
    assert [r.margin for r in REQUIREMENTS] == pytest.approx([80.0, -200.0, 20.0, -np.inf])
    assert [r.met for r in REQUIREMENTS] == [True, False, True, False]
    assert not Requirement("lost", np.nan, 1.0, "deg").met
    assert np.isnan(Requirement("zero", 1.0, 0.0, "deg").margin)
    assert str(REQUIREMENTS[1]) == "PSE 0.36 deg (at most 0.12 deg): margin -200 %, NOT MET"
    assert REQUIREMENTS[2].required == "at least 0.25"


def test_requirements_are_met_or_not_by_sign_and_word():
    rows = re.findall(r"<tr role=\"row\"><th role=\"rowheader\".*?</tr>", report.requirements_table(REQUIREMENTS))
    assert [("&#10003;" in row, "not met" in row) for row in rows] == [(r.met, not r.met) for r in REQUIREMENTS]
    assert "+80 %" in rows[0]
    assert "width:20%" in rows[0]


def test_verdicts_have_signs():
    page = report.claims_table(CLAIMS)
    assert re.findall(r'class="verdict (\w+)"', page) == ["pass", "fail", "part", "none"]
    assert "It points &lt;well&gt;" in page


def test_text_is_escaped_and_html_is_not():
    page = report.table(["a", "b"], [["<i>", Html("<b>x</b>")]], marks=[["", "pass"]])
    assert "&lt;i&gt;" in page
    assert "<b>x</b>" in page
    assert 'aria-label="met"' in page


def test_pages_are_reproducible_and_fetch_nothing():
    page = example()
    assert page == example()
    assert not re.search(r'(src|href)="(https?:)?//', page)
    assert report.INK not in page
    assert page.count("<figure>") == 2
    assert 'id="claims"' in page
    assert 'id="claims-2"' in page
    assert 'href="k.json" download' in page


HOSTILE = "</svg><script>alert(1)</script>"
WORSE = f"\"'><img src=x onerror=alert(1)></style></title>{HOSTILE} $\\frac$ &amp; javascript:alert(1)"


class Elements(HTMLParser):
    """Names and attributes of what a browser would make of a page."""

    def __init__(self, page: str):
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.feed(page)

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))


def page_of(name: str, short: str) -> str:
    """Every text of every element is the name, of the figures the short one."""
    time, two = np.linspace(0, 10, 50), np.ones((1, 3))
    drawn = [
        figures.histories({short: (time, np.sin(time)[:, None])}, [short], scale="log"),
        figures.against_bound({short: (time, np.sin(time)[:, None])}, [short], 1.0, ""),
        figures.levels([short], {short: two}, {short: 2.0}, ""),
        figures.scatter({short: (time, time, {short: time > 5})}, short, short),
        figures.shares(np.arange(3.0), {short: np.array([1, 2])}, np.array([3, 3]), short),
    ]
    card = Card(name, [(name, name)], [(name, name)], name)
    sections = [
        Section(name, report.requirements_table([Requirement(name, 1.0, 2.0, name)])),
        Section(name, report.claims_table([Claim(name, name, name, name)]) + report.paragraph(name)),
        Section(name, report.table([name, name], [[name, name]], label=name) + report.cards([card])),
        Section(
            name, "".join(report.figure(f, name, salt=f"{name}{k}", alternative=name) for k, f in enumerate(drawn))
        ),
    ]
    return report.page(name, name, sections, [name], highlights=[(name, name)])


def test_scripts_in_names_are_text():
    """A page of hostile names has the elements and attributes of one of harmless names, and no link leads out."""
    hostile, harmless = (Elements(page_of(*n)).found for n in ((WORSE, f"{HOSTILE} $\\frac$"), ("name", "name")))
    kinds = ({(tag, *sorted(attributes)) for tag, attributes in found} for found in (hostile, harmless))
    assert next(kinds) == next(kinds)
    for _, attributes in hostile:
        for name in ("href", "src", "xlink:href"):
            link = attributes.get(name) or "#"
            assert link.startswith(("#", "data:")) or ":" not in link, link


@pytest.mark.slow
@needs_chromium
def test_a_browser_runs_nothing_of_a_hostile_page(tmp_path):
    from playwright.sync_api import sync_playwright

    (tmp_path / "report.html").write_text(page_of(WORSE, HOSTILE), encoding="utf-8")
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page, alarms = browser.new_page(), []
        page.on("dialog", lambda dialog: (alarms.append(dialog.message), dialog.dismiss()))
        page.on("console", lambda message: alarms.append(message.text))
        page.goto((tmp_path / "report.html").as_uri())
        assert alarms == []
        assert page.locator("script, img").count() == 0
        assert page.locator("h1").inner_text() == WORSE
        browser.close()


def test_series_are_seen_on_light_and_dark_cards():
    """Contrast of graphical objects is at least 3 (WCAG 2.2, 1.4.11)."""
    from plants.outcome.page_style import DARK, LIGHT

    def luminance(colour: str) -> float:
        v = np.array([int(colour[i : i + 2], 16) for i in (1, 3, 5)]) / 255
        return float(np.where(v <= 0.04045, v / 12.92, ((v + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])

    for colour in (*report.COLOURS, report.BOUND):
        for theme in (LIGHT, DARK):
            low, high = sorted((luminance(colour), luminance(theme["card"])))
            assert (high + 0.05) / (low + 0.05) >= 3, (colour, theme["card"])


@pytest.mark.slow
@needs_chromium
def test_every_screen_and_scheme(path):
    check(path, figures=2)


@pytest.mark.slow
@needs_chromium
def test_phone_keyboard_and_paper(path):
    from playwright.sync_api import sync_playwright

    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        page = browser.new_page(viewport={"width": 390, "height": 844})
        page.goto(path.as_uri())
        cell = ".stacked td[data-label=verdict]"
        assert page.evaluate(f"getComputedStyle(document.querySelector('{cell}'), '::before').content") == '"verdict"'
        assert page.get_by_role("columnheader", name="verdict").count() == 2  # stacked rows are tables still
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.hash") == "#content"
        page.keyboard.press("Tab")
        page.keyboard.press("Enter")
        page.wait_for_function("location.hash === '#requirements'")  # the browser follows a link in its own time
        page.emulate_media(media="print", color_scheme="dark")
        assert page.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)"
        assert not page.get_by_role("navigation").is_visible()
        browser.close()


def test_numbers_stand_with_their_decimals_under_each_other():
    """Each cell of a column of numbers is padded, unseen, to the same number of places behind the point."""
    rows = [
        ["a", "1.25", "3/30", "word that is long", "7"],
        ["b", "-10.5", "12/30", "x", "never"],
        ["c", "3 %", "", "", ""],
    ]
    page = report.table(["name", "value", "count", "text", "time"], rows)
    cells = re.findall(r'<td role="cell" class="([^"]*)" data-label="(\w+)"><span>(.*?)</span></td>', page)
    kinds = {(label, kind) for kind, label, _ in cells}
    assert kinds == {("value", "number"), ("count", "number"), ("text", ""), ("time", "number")}
    shown = [re.sub("<[^>]*>", "", text) for _, label, text in cells if label == "value"]
    assert shown == ["1.25", "-10.50", "3.00 %"]
    assert 'class="pad" aria-hidden="true">0<' in page
    assert page.count('class="number">value') == 1  # the header as well


def test_marks_and_alignment_go_together():
    page = report.table(["n", "v"], [["a", "1.5"], ["b", "10"]], marks=[["", "pass"], ["", "fail"]])
    assert 'class="pass number"' in page
    assert 'class="fail number"' in page
    assert 'aria-label="not met"' in page


def test_claims_say_when_they_hold_and_why():
    claim = Claim(
        "It points", "table 1", "holds", "0.1 deg", "0.2 deg", "error below 0.2 deg", "the loop is fast & <fine>"
    )
    page = report.claims_table([claim])
    for text in ("printed: 0.2 deg", "holds if: error below 0.2 deg", "why: the loop is fast &amp; &lt;fine&gt;"):
        assert text in page
    assert "printed" not in report.claims_table(CLAIMS)


def test_the_data_of_a_figure_are_those_of_its_lines():
    time = np.linspace(0, 10, 5)
    series = {"one": (time, np.c_[time, 2 * time]), 'two, "b"': (time[:3], np.c_[-time, time][:3])}
    names, *rows = csv.reader(inline.csv(figures.histories(series, ["x, m", "y"])).splitlines())
    assert names == ["time, s", "x, m: one", "time, s", 'x, m: two, "b"', "time, s", "y: one", "time, s", 'y: two, "b"']
    table = np.array([[float(v) if v else np.nan for v in row] for row in rows])
    np.testing.assert_allclose(table[:, :2], np.c_[time, time])
    np.testing.assert_allclose(table[:3, 2:4], np.c_[time, -time][:3])
    assert np.isnan(table[3:, 2:4]).all()
    np.testing.assert_allclose(table[:, 5], 2 * time)
    bounded = inline.csv(figures.against_bound({"one": (time, time[:, None])}, ["roll"], 3.0, "deg"))
    assert bounded.splitlines()[0] == '"time, s","roll, deg: one"'  # the bound is none of the data
    assert inline.csv(figures.composition({"a": {"b": np.ones(2)}}, ["c", "d"])) == ""


def test_the_files_of_sections_are_written_beside_the_page(tmp_path):
    time = np.linspace(0, 10, 5)
    section = study.drawings("Figures 1 & 2", [(figures.histories({"one": (time, time[:, None])}, ["x"]), "One.")])
    page = report.page("t", "s", [section], [])
    study.written(tmp_path / "new" / "report.html", page, [section])
    (link,) = re.findall(r'href="([^"]*csv)" download', page)
    assert (tmp_path / "new" / link).read_text().startswith('"time, s","x: one"')


def test_a_signal_fills_its_axes_and_a_bound_beyond_is_named():
    """The axes of a study's errors were ten times as high as the errors."""
    time, error = np.arange(3.0), np.array([[0.1], [-0.2], [0.15]])
    for bound, inside in ((0.15, True), (0.3, True), (2.0, False)):
        (ax,) = figures.against_bound({"one": (time, error)}, ["roll"], bound, "deg").axes
        top = ax.get_ylim()[1]
        assert 0.2 < top < 0.5
        assert (bound < top) == inside
        assert ("required: 2 deg, beyond the axes" in ax.get_xlabel()) != inside


def test_curves_that_cover_each_other_leave_an_edge():
    time = np.arange(3.0)
    fig = figures.histories({name: (time, time[:, None]) for name in "abc"}, ["x"])
    widths = [line.get_linewidth() for line in fig.axes[0].lines]
    assert widths == sorted(widths, reverse=True)
    assert len(set(widths)) == 3
