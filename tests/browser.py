"""A real browser that looks at a report: phone and desktop, light and dark."""

import shutil
from pathlib import Path
from typing import NamedTuple

import pytest

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: apt install chromium")
FLAGS = (
    "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync",
)  # fmt: skip
SCREENS = {"phone": (390, 844), "desktop": (1280, 900)}

MEASURE = """() => {
  const luminance = c => { const [r, g, b] = c.map(v => v / 255).map(v => v <= .04045 ? v / 12.92
    : ((v + .055) / 1.055) ** 2.4); return .2126 * r + .7152 * g + .0722 * b };
  const numbers = c => (c.match(/[\\d.]+/g) || []).map(Number);
  const behind = e => { for (; e; e = e.parentElement) { const c = numbers(getComputedStyle(e).backgroundColor);
    if (c.length == 3 || c[3] > .99) return c.slice(0, 3) } return [255, 255, 255] };
  const faint = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let n; n = walker.nextNode();) {
    const e = n.parentElement; if (!n.data.trim() || e.closest('style, defs')) continue;
    const style = getComputedStyle(e), ink = numbers(e.closest('svg') ? style.fill : style.color);
    const [a, b] = [luminance(ink), luminance(behind(e))].sort((x, y) => y - x);
    if ((a + .05) / (b + .05) < 4.5) faint.push(n.data.trim());
  }
  const root = document.documentElement;
  const size = e => { const r = e.getBoundingClientRect(); return [r.width, r.height] };
  return {
    overflow: root.scrollWidth - root.clientWidth, faint, background: getComputedStyle(document.body).backgroundColor,
    figures: [...document.querySelectorAll('figure svg')].map(size),
    unnamed: document.querySelectorAll('figure svg:not([aria-label]), th:not([scope])').length,
    ids: [...document.querySelectorAll('[id]')].map(e => e.id),
    broken: [...document.querySelectorAll('a[href^="#"]')].map(e => e.hash.slice(1))
      .filter(id => !document.getElementById(id)),
    files: [...document.querySelectorAll('a[download]')].map(e => e.getAttribute('href')),
  } }"""


class Look(NamedTuple):
    """What one look at a page found."""

    messages: list[str]  # of console and page errors
    requests: list[str]  # for anything but the page itself
    overflow: int  # px that the page is wider than the screen
    faint: list[str]  # texts with a contrast below 4.5 (WCAG 2.2, AA)
    background: str
    figures: list[list[float]]  # (width, height) px
    unnamed: int  # figures without alternative, table headers without scope
    ids: list[str]
    broken: list[str]  # links within the page that lead nowhere
    files: list[str]  # offered for download


def look(path: Path) -> dict[tuple[str, str], Look]:
    """The page on every screen in every colour scheme."""
    from playwright.sync_api import sync_playwright

    found = {}
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=list(FLAGS))
        for screen, (width, height) in SCREENS.items():
            for scheme in ("light", "dark"):
                page = browser.new_page(viewport={"width": width, "height": height}, color_scheme=scheme)
                messages, requests = [], []
                page.on("console", lambda message, to=messages: to.append(message.text))
                page.on("pageerror", lambda error, to=messages: to.append(str(error)))
                page.on("request", lambda request, to=requests: to.append(request.url))
                page.goto(path.as_uri())
                measured = page.evaluate(MEASURE)
                foreign = [url for url in requests if url != path.as_uri() and not url.startswith("data:")]
                found[screen, scheme] = Look(messages, foreign, **measured)
                page.close()
        browser.close()
    return found


def check(path: Path, figures: int) -> None:
    """Assert that the page is sound on every screen in every colour scheme."""
    found = look(path)
    for view, seen in found.items():
        assert seen.messages == [], view
        assert seen.requests == [], view
        assert seen.overflow <= 0, view
        assert seen.faint == [], view
        assert len(seen.figures) == figures, view
        assert all(width > 300 and height > 50 for width, height in seen.figures), view
        assert seen.unnamed == 0, view
        assert seen.broken == [], view
        assert len(set(seen.ids)) == len(seen.ids), view
        assert all((path.parent / name).is_file() for name in seen.files), view
    assert len({seen.background for seen in found.values()}) == 2  # light and dark
