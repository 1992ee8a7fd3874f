"""What all studies share: the command line, the flights and their interruption, the tables, the claims, the page.

A study is numbers with their sources, scenarios, and what it makes of them; its `main` reads

    options = study.parse(study.parser(__doc__, ...), arguments)
    study.carry_out(found, lambda: fly(found, ...), options)
    return study.conclude(found, options.out, title=..., tables=..., statements=..., sections=...)

Ctrl-C and SIGTERM end the flights, not the study: what has been measured by then is printed and written, and says so;
--resume flies the rest, also after SIGKILL.
"""

from __future__ import annotations

import argparse
import io
import platform
import re
import sys
import threading
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
from matplotlib.figure import Figure

from plants.errors import EngineError, StoreError
from plants.files import usable, write_atomically
from plants.outcome import report
from plants.outcome.claims import Statement, counted, judged, stored_claims
from plants.outcome.claims import either as either
from plants.outcome.inline import csv
from plants.simulation import campaign
from plants.simulation.conduct import terminable
from plants.simulation.progress import Bar
from plants.simulation.store import move_aside

FILES = {"json": "with its plant, every bit", "mat": "for MATLAB and Octave"}  # that a design writes
DATA = "figures"  # folder beside the page for the data of its figures
PACKAGES = ("convex-synth", "jax", "numpy", "scipy")  # named at the foot of every page
INTERRUPTED = 130  # exit code, as of a program ended by Ctrl-C


class Table(NamedTuple):
    """A table for the terminal and for the page."""

    title: str
    headers: Sequence[str]
    rows: Sequence[Sequence[Any]]
    marks: Sequence[Sequence[str]] = ()  # "pass", "fail" or "" for each cell, see `report.table`
    note: str = ""  # a sentence below
    drawn: Sequence[tuple[Figure, str]] = ()  # figures with their captions, on the page only
    files: Sequence[tuple[str, str]] = ()  # beside the page, and what they are; on the page only

    def text(self) -> str:
        """For the terminal."""
        body = report.text_table(self.headers, self.rows)
        return f"{body}\n({self.note})" if self.note else body

    def section(self) -> report.Section:
        """For the page."""
        body = report.table(self.headers, self.rows, marks=self.marks)
        if self.note:
            body += report.paragraph(self.note)
        body += report.links(self.files) if self.files else ""
        figures = drawings(self.title, self.drawn)
        return report.Section(self.title, body + figures.body, figures.files)


class Saved(Protocol):
    """A design that describes itself and writes files, such as `synth.Design`."""

    @property
    def facts(self) -> Mapping[str, str]:
        """What a card shows of it."""
        ...

    def save(self, path: Path) -> Any:
        """Write to a path that ends with .json or .mat."""
        ...


@dataclass(kw_only=True)
class Study:
    """What has been measured so far; a study adds its own fields."""

    complete: bool = False  # False while it flies, and for good if it was interrupted
    seconds: float = 0.0  # s, wall time of the flights
    flying: Mapping[str, Any] = field(default_factory=dict)  # how its campaigns fly: further options of `campaigns`
    worst: list[Any] = field(default_factory=list)  # each a `worst.Answer`
    boxes: list[Any] = field(default_factory=list)  # each a `boxes.Answer`


def parser(
    doc: str | None, *, out: str, fast: str, runs: int, what: str = "dispersed runs", stored: bool = True
) -> argparse.ArgumentParser:
    """The options that all studies have; a study may add its own.

    Parameters
    ----------
    doc : docstring of the study, whose first line describes it
    out : folder for the report
    fast : what --fast leaves, in words
    runs : default of --runs
    what : what --runs counts
    stored : whether its flights are campaigns, which outlive an interruption
    """
    p = argparse.ArgumentParser(description=(doc or "").strip().splitlines()[0])
    p.add_argument("--fast", action="store_true", help=f"{fast}: a quick look")
    p.add_argument("--runs", type=int, default=runs, help=f"{what} (default {runs})")
    p.add_argument("--seed", type=int, default=0, help="of everything that is drawn (default 0)")
    p.add_argument("--out", type=Path, default=Path(out), help=f"folder for report and data (default {out})")
    if stored:
        p.add_argument(
            "--resume",
            action="store_true",
            help="fly only what an earlier start with the same options has not flown yet, by the runs in --out",
        )
        p.add_argument("--workers", type=int, help="batches flown at the same time (default: one for each processor)")
        p.add_argument("--scheduler", metavar="ADDRESS",
                       help='of a Dask cluster that flies instead, such as "tcp://127.0.0.1:8786"')  # fmt: skip
    return p


def parse(parser: argparse.ArgumentParser, arguments: Sequence[str] | None, *, natural: Collection[str] = ()) -> Any:
    """The options, checked: at least one run, a whole seed; likewise the options named in `natural`.

    The folder --out is made and tried by writing, before anything is flown for it. Unusable options end the program
    with exit code 2 and a line that names the option.
    """
    options = parser.parse_args(arguments)
    if options.runs < 1:
        parser.error(f"--runs {options.runs}: at least one run is needed")
    for name in ("seed", *natural):
        if (getattr(options, name) or 0) < 0:
            parser.error(f"--{name} {getattr(options, name)}: give a whole number of at least 0")
    try:
        usable(options.out)
    except OSError as error:
        parser.error(f"--out {options.out}: {error.strerror}; give a folder that can be written")
    for stream in (sys.stdout, sys.stderr):  # a screen without the sign shows its number, and the page is written
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")
    return options


def carry_out(study: Study, fly: Callable[[], None], options: Any = None) -> None:
    """Call `fly`, which fills the study; note the time it took and whether it came to its end.

    With the `options` of `parse`, its campaigns are stored in the folder ``runs`` of --out; without --resume what an
    earlier start left there is moved to ``runs.previous``. A store or a cluster that is not usable ends the program
    with exit code 2. SIGTERM ends the flights as Ctrl-C does.
    """
    started = time.perf_counter()
    try:
        with terminable():
            if options is not None:
                study.flying = _flying(options)
            fly()
        study.complete = True
    except KeyboardInterrupt:
        print("interrupted: the report holds what was flown")
    except (StoreError, EngineError) as error:
        print(f"error: {error}", file=sys.stderr)
        raise SystemExit(2) from error
    study.seconds = time.perf_counter() - started


def _flying(options: Any) -> dict[str, Any]:
    """Options of `campaigns` that the command line has given."""
    folder = options.out / "runs"
    if not options.resume and (previous := move_aside(folder)):
        print(f"the runs of an earlier start are in {previous} now; --resume would have continued them")
    given = {"workers": options.workers, "scheduler": options.scheduler}
    return {"store": folder, **{name: value for name, value in given.items() if value is not None}}


def stored(flying: Mapping[str, Any], name: str) -> dict[str, Any]:
    """Options of one campaign of a study: those in `flying`, with a store of its own, which is continued."""
    options = dict(flying)
    if options.get("store") is not None:
        plain = "".join(letter if letter.isalnum() else "-" for letter in name.lower())
        options |= {"store": options["store"] / plain, "resume": True}
    return options


def beside(own: Callable[[], None], other: Callable[[threading.Event], None]) -> None:
    """Call both at once, `other` in a thread: flights stepped from Python keep one processor busy, compilers another.

    Where `own` ends in an exception, or is interrupted, the event is set: then `other` is to end soon.
    """
    ended = threading.Event()
    with ThreadPoolExecutor(1) as pool:
        future = pool.submit(other, ended)
        try:
            own()
            future.result()
        except BaseException:
            ended.set()
            raise


def campaigns(
    case: campaign.Case,
    dispersed: Any,
    shared: Mapping[str, Any],
    into: dict[str, campaign.Campaign],
    *,
    keep: Mapping[str, Sequence[int]] | None = None,
    **options: Any,
) -> None:
    """One campaign for each name in `shared`, under one progress bar; what has finished is in `into`.

    Parameters
    ----------
    case, dispersed : as in `campaign.campaign`
    shared : name -> what the runs of this campaign have in common
    into : name -> Campaign, filled here
    keep : name -> indices of the runs whose trajectories are kept
    options : further ones of `campaign.campaign`, the same for all; in `store` each has a folder of its own

    Raises
    ------
    KeyboardInterrupt
        Ctrl-C; the finished batches are in `into`.
    """
    runs = campaign.count(dispersed)
    with Bar(len(shared) * runs) as bar:
        for done, (name, common) in enumerate(shared.items()):

            def advanced(finished: int, before: int = done * runs) -> None:
                bar.reach(before + finished)

            kept = (keep or {}).get(name, ())
            flown = campaign.campaign(
                case, dispersed, common, keep=kept, progress=False, on_batch=advanced, **stored(options, name)
            )  # fmt: skip
            if len(flown.index):
                into[name] = flown
            if flown.errors:
                bar.tell(f"{name}: {str(flown).splitlines()[-1]}")
            if not flown.complete:
                raise KeyboardInterrupt


def drawings(title: str, drawn: Sequence[tuple[Figure, str]]) -> report.Section:
    """A section of figures with their captions, and the data of their lines."""
    plain, parts, files = re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") or "figure", [], {}
    for k, (fig, caption) in enumerate(drawn):
        name, data = f"{DATA}/{plain}-{k + 1}.csv", csv(fig)
        if data:
            files[name] = data
        parts.append(report.figure(fig, caption, salt=f"{title}{k}", data=name if data else ""))
    return report.Section(title, f'<div class="figures">{"".join(parts)}</div>' if parts else "", files)


def card(name: str, design: Saved, out: Path, stem: str) -> report.Card:
    """The files of a design, `stem`.json and `stem`.mat in `out`, and its card."""
    out.mkdir(parents=True, exist_ok=True)
    files = [(f"{stem}.{ending}", text) for ending, text in FILES.items()]
    for file, _ in files:
        design.save(out / file)
    return report.Card(name, [*design.facts.items()], files)


def conclude(
    study: Study,
    out: Path,
    *,
    title: str,
    subtitle: str,
    tables: Sequence[Table],
    statements: Sequence[Statement],
    settings: str,
    requirements: Sequence[report.Requirement] = (),
    cards: Sequence[report.Card] = (),
    sections: Sequence[report.Section] = (),
    findings: Sequence[str] = (),
    packages: Collection[str] = (),
    notes: Sequence[str] = (),
    paper: str = "",
    counterparts: Sequence[report.Claim] = (),
    summary: str = "",
    abbreviations: Mapping[str, str] | None = None,
    first: tuple[Figure, str] | None = None,
) -> int:
    """Print tables and claims, write ``report.html`` and ``claims.json`` into `out`, return the exit code.

    Parameters
    ----------
    study : carried out
    out : folder, made if it is not there
    title, subtitle : of the page; the subtitle names the paper
    tables : in order; they come first
    statements : the paper's claims
    settings : what was flown, in words
    requirements : of the design that the study is about; the page begins with their margins
    cards : of the controllers
    sections : further ones of the page, at its end
    findings : what the paper does not say, in sentences
    packages : versions to name beside `PACKAGES`
    notes : further lines at the foot
    paper : whose claims these are, such as "003 Pecorilla and Stesina (2024)": the heading of its claims page; empty if
        they are the study's own
    counterparts : of the paper's figures and tables that state nothing, see `drawn` and `left_out`
    summary : a sentence that says which controller to take, and why
    abbreviations : short form -> what it stands for, of those that the page uses
    first : the figure that says most, with its caption: before all tables
    """
    claims = judged(statements)
    for table in tables:
        print(table.text(), end="\n\n")
    for r in requirements:
        print(r)
    for claim in claims:
        print(f"{claim.text}\n  {claim.verdict.upper()}: {claim.measured}")
    lines = counted([*claims, *counterparts])
    told = ", ".join(f"{kind} {number}" for kind, number in lines.most_common())
    count = f"{paper or title}: {lines.total()} lines of tables, figures and claims: {told}"
    for text in (*findings, count, summary):
        print(f"\n{text}" if text else "")
    own = [drawings("At a glance", [first])] if first else []
    if requirements:
        own.append(report.Section("Margins", report.requirements_table(requirements)))
    own += [table.section() for table in tables]
    own.append(report.Section("The paper's claims, measured" if paper else "Claims", report.claims_table(claims)))
    if findings:
        heading = "What the paper does not say" if paper else "Findings"
        own.append(report.Section(heading, "".join(map(report.paragraph, findings))))
    if cards:
        own.append(report.Section("Controllers", report.cards(cards)))
    foot = [*provenance(settings, study, packages), count, *notes]
    marks = highlights(requirements, claims, "claims of the paper" if paper else "claims")
    if abbreviations:
        sections = [*sections, report.Section("Abbreviations", report.definitions(abbreviations))]
    page = report.page(title, subtitle, [*own, *sections], foot, highlights=marks, summary=summary)
    path = written(out / "report.html", page, [*own, *sections])
    written(out / "claims.json", stored_claims(paper or title, [*claims, *counterparts], settings, study.complete))
    print(f"\nflown in {study.seconds:.0f} s; report: {path}")
    return 0 if study.complete else INTERRUPTED


def highlights(
    requirements: Sequence[report.Requirement], claims: Sequence[report.Claim], whose: str = "claims of the paper"
) -> list[tuple[str, str]]:
    """What a reader in a hurry sees: (figure, what it counts)."""
    found = []
    if requirements:
        tightest = min(requirements, key=lambda r: -np.inf if np.isnan(r.margin) else r.margin)
        found.append((f"{sum(r.met for r in requirements)} of {len(requirements)}", "requirements met"))
        found.append((report.percent(tightest.margin), f"least margin: {tightest.name}"))
    if claims:
        verdicts = [claim.verdict for claim in claims if claim.verdict != "not measured"]
        holds, fails, open_ = (verdicts.count(verdict) for verdict in ("holds", "does not hold", "not decided"))
        for number, what in (
            (holds, "hold"),
            (len(verdicts) - holds - fails - open_, "depend on something"),
            (fails, "do not hold"),
            (open_, "are not decided"),
        ):
            if number or what != "are not decided":
                found.append((f"{number} of {len(verdicts)}", f"{whose} {what}"))
    return found


def provenance(settings: str, study: Study, packages: Collection[str] = ()) -> list[str]:
    """What a page was made with."""
    versions = ", ".join(f"{name} {metadata.version(name)}" for name in dict.fromkeys((*PACKAGES, *packages)))
    state = "complete" if study.complete else "INTERRUPTED: what was flown until then"
    return [f"{settings}; {state}; {study.seconds:.0f} s", f"Python {platform.python_version()}, {versions}"]


def written(path: Path, page: str, sections: Sequence[report.Section] = ()) -> Path:
    """A page in its file, with the files of its sections beside it; folders are made if they are not there."""
    texts = {path: page} | {path.parent / name: text for section in sections for name, text in section.files.items()}
    for file, text in texts.items():
        file.parent.mkdir(parents=True, exist_ok=True)
        write_atomically(file, text.encode())
    return path
