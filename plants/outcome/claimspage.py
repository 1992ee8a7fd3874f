"""One page for the claims of all papers, made from the ``claims.json`` that every study leaves beside its report.

    python -m plants.outcome.claimspage out/cubesat3u out/amazonia1 out/geo --out out/claims

Each row of a paper's tables, each figure and each claim has a line: where it stands, the printed figure, the measured
one with its interval, the verdict, the rule that decided it, and why; or the reason for which it has none.
"""

from __future__ import annotations

import argparse
import html
import json
import os
from collections import Counter
from collections.abc import Sequence
from itertools import groupby
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

from plants.errors import StoreError
from plants.files import usable
from plants.outcome import report
from plants.outcome.claims import KINDS, LEFT_OUT, counted
from plants.outcome.study import written

HEADERS = ("paper", "lines", *KINDS)
LARGEST = 10_000_000  # bytes of a file of claims
NAME = "claims.json"


class Claims(NamedTuple):
    """What a study found of a paper's claims."""

    paper: str
    settings: str
    complete: bool
    claims: list[report.Claim]
    folder: Path


def read_claims(path: Path) -> Claims:
    """The claims of a study's folder, or of its file.

    Raises
    ------
    StoreError
        There is no such file, it is too large, or it is not what a study has written; with the remedy.
    """
    file = path / NAME if path.is_dir() else path
    try:
        if file.stat().st_size > LARGEST:
            raise StoreError(f"{file}: {file.stat().st_size} bytes; a study writes less than {LARGEST}")
        data = json.loads(file.read_text(encoding="utf-8"))
        texts = [{name: _text(row[name]) for name in report.Claim._fields} for row in data["claims"]]
        head = (_text(data["paper"]), _text(data["settings"]), bool(data["complete"]))
    except FileNotFoundError:
        raise StoreError(f"{file}: there is no such file; run the study with --out {path}") from None
    except OSError as error:
        raise StoreError(f"{file}: {error.strerror}; give the folder of a study") from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise StoreError(f"{file}: not the claims of a study ({error}); run the study again") from error
    return Claims(*head, [report.Claim(**row) for row in texts], file.parent)


def _text(value: object) -> str:
    """Of a field that is a text."""
    if not isinstance(value, str):
        raise ValueError(f"{str(value)[:40]!r} is no text")
    return value


def claims_page(found: Sequence[Claims], folder: Path) -> tuple[str, str]:
    """The page, and its table of counts for the terminal; `folder` is where it will be, for its links."""
    ordered = sorted(found, key=lambda c: c.paper)
    papers = {paper: list(group) for paper, group in groupby(ordered, key=lambda c: c.paper)}
    counts = {paper: sum((counted(c.claims) for c in group), Counter()) for paper, group in papers.items()}
    total = sum(counts.values(), Counter())
    rows = [
        (paper, str(n.total()), *(str(n[kind]) for kind in KINDS)) for paper, n in [*counts.items(), ("all", total)]
    ]
    sections = [report.Section("All papers", report.table(HEADERS, rows))]
    for paper, group in papers.items():
        parts = (f"{_about(claims, folder)}{report.claims_table(claims.claims)}" for claims in group)
        sections.append(report.Section(paper, "".join(parts)))
    judged = sum(total[kind] for kind in KINDS[:4])
    page = report.page(
        "What five papers claim, measured",
        "Every table row, figure and claim, the printed figure, the measured one and the verdict",
        sections,
        ["A rule, printed below each figure, decides every verdict; intervals are of 95 %."],
        highlights=[
            (f"{total['holds']} of {judged}", "claims hold"),
            (f"{total[KINDS[1]]} of {judged}", "depend on something"),
            (f"{total['does not hold']} of {judged}", "do not hold"),
            (f"{total[LEFT_OUT]}", "lines without a counterpart, with the reason"),
        ],
    )
    return page, report.text_table(HEADERS, rows)


def _about(claims: Claims, folder: Path) -> str:
    """Where a study's own report is, and what it flew."""
    there = quote(Path(os.path.relpath(claims.folder / "report.html", folder)).as_posix())
    state = "" if claims.complete else " It was interrupted: what was flown until then."
    text = html.escape(f"{claims.settings}.{state}")
    return f'<p><a href="{there}">The study</a>: {text}</p>'


def main(arguments: list[str] | None = None) -> int:
    """The command line."""
    p = argparse.ArgumentParser(prog="python -m plants.outcome.claimspage", description=(__doc__ or "").splitlines()[0])
    p.add_argument("studies", nargs="+", type=Path, help="folders of studies (their --out)")
    p.add_argument("--out", type=Path, default=Path("out/claims"), help="folder of the page (default out/claims)")
    options = p.parse_args(arguments)
    try:
        usable(options.out)
        found = [read_claims(path) for path in options.studies]
    except OSError as error:
        p.error(f"--out {options.out}: {error.strerror}; give a folder that can be written")
    except StoreError as error:
        p.error(str(error))
    page, counts = claims_page(found, options.out)
    print(counts)
    print(f"\nclaims: {written(options.out / 'index.html', page)}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
