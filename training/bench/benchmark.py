"""What a benchmark is: one description, which the command line, the report and the tests read.

One of over 250 lines is a room (``training/bench/<room>/``): ``rows.py`` (frozen dataclasses and the tables made of
them), ``run.py`` (what measures them, and the ``BENCHMARK``) and, where there is one, ``chart.py`` (draws from rows).
"""

import argparse
import json
import subprocess
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any
from zlib import crc32

from cloth_envs.files import check_folder, read_json, write_text
from cloth_envs.machine import header
from cloth_envs.naming import unknown_name
from cloth_envs.parsing import Parser
from cloth_envs.progress import announce
from cloth_envs.registry import SCENES
from training.cache import cache_folder
from training.rows import Store, read_names, read_rows

# name on the command line -> the module whose BENCHMARK it is, imported on use.
BENCHMARKS: dict[str, str] = {
    "speed-accuracy": "training.bench.speed_accuracy.run",
    "stability": "training.bench.stability.run",
    "transfer": "training.bench.transfer.run",
    "agents": "training.bench.agents.run",
    "tasks": "training.bench.tasks",
    "choices": "training.bench.choices",
    "outside": "training.bench.outside",
    "mesh": "training.bench.mesh",
    "folds": "training.bench.folds",
    "synchronised": "training.bench.synchronised.run",
    "endurance": "training.bench.endurance",
    "wrinkles": "training.bench.wrinkles",
    "long-runs": "training.bench.long_runs.run",
    "convergence": "training.bench.convergence",
    "peers": "training.bench.peers.run",
    "tables": "training.bench.papers.run",
    "throughput": "training.bench.throughput.run",
    "gpu": "training.bench.gpu.run",
    "super-resolution": "training.bench.superres.run",
}
# Scenes of the stored rows; others are measured where ``--scenes`` names them.
MEASURED = ("Curtain", "Flag", "Collision", "Pressure", "Hanging", "BallDrop")
CODE = ("cloth_envs", "surrogates", "training", "CMakeLists.txt")  # what rows follow from


@dataclass(frozen=True)
class RowFile:
    """A CSV of rows: the class of its rows, and the fields that tell one row from another."""

    kind: type
    key: tuple[str, ...] = ()


@dataclass(frozen=True)
class Part:
    """What is shown of some rows: ``show`` takes the rows of every stem of ``files`` and makes text of them."""

    title: str
    files: tuple[str, ...]
    show: Callable[..., str]
    options: str = ""  # what the benchmark needs on the command line to write them


class Session:
    """One call of a benchmark: its options, its rows on disk (in memory without ``--out``), what it says of itself."""

    def __init__(self, benchmark: "Benchmark", given: argparse.Namespace) -> None:
        self.benchmark, self.given = benchmark, given
        self.quick: bool = given.quick
        self.out: Path | None = given.out
        self.images: Path | None = given.images or given.out
        usual = list(benchmark.scenes)
        self.scenes = usual if given.scenes is None else read_names(given.scenes, benchmark.known, "scene")
        self.about: dict[str, Any] = {**header(), "revision": revision(), "quick": given.quick}
        if self.out and not given.chart_only:
            check_folder(self.out)
        self._stores: dict[str, Store[Any]] = {}

    def cache(self, kind: str) -> Path:
        """The folder of what takes long to make, ``--cache`` or among the user's caches."""
        return cache_folder(kind, self.given.cache)

    def store(self, stem: str) -> Store[Any]:
        """The rows of ``<stem>.csv``; those that it holds are kept unless ``--fresh``."""
        if stem not in self._stores:
            file = self.benchmark.files[stem]
            path = self.out / f"{stem}.csv" if self.out else None
            self._stores[stem] = Store(path, file.kind, file.key, fresh=self.given.fresh)
        return self._stores[stem]

    def plan(self) -> str:
        """What is going to be measured, and where it goes."""
        there = {} if self.out is None or self.given.fresh else saved(self.benchmark, self.out)
        kept = f"{sum(map(len, there.values()))} rows that it holds are kept"
        goes_on = f"rows go into {self.out}, where {kept}; stopped by Ctrl-C, the same command goes on"
        lost = "rows are printed in the end and lost where it is stopped: --out FOLDER keeps them"
        quick = "a trial run of 2 minutes" if self.quick else "minutes to hours (--quick: a trial run)"
        return (
            f"{self.benchmark.name}, {quick}: {self.benchmark.about}\n"
            f"Scenes {', '.join(self.scenes)}; {goes_on if self.out else lost}. "
            f"What takes long to make is kept in {self.cache('')}."
        )

    def begin(self, header: Path | None) -> None:
        """Write the header; with ``--fresh`` nothing of before is left beside it."""
        for stem in self.benchmark.files if self.out and self.given.fresh else ():
            (self.out / f"{stem}.csv").unlink(missing_ok=True)  # type: ignore[operator]
        self.write(header)

    def write(self, header: Path | None) -> None:
        """What the session says of itself, as JSON."""
        if header:
            write_text(header, json.dumps(self.about, indent=2) + "\n")

    def rows(self) -> dict[str, list[Any]]:
        """Rows by stem: what this call's stores hold, or else what is on disk."""
        found = {stem: store.rows for stem, store in self._stores.items()}
        return found if self.out is None else {**saved(self.benchmark, self.out), **found}


@dataclass(frozen=True)
class Benchmark:
    """A benchmark, registered once.

    Attributes:
        name: on the command line; its JSON header is ``<name with _>.json``.
        about: one sentence, "Error against ...".
        files: stem of a CSV -> what its rows are.
        parts: tables for people, in the order in which they are shown.
        measure: fills the session's stores.
        times: fills those of times, before ``measure``; ``minicloth bench all`` lets nothing else run then.
        pieces: options that measure a part of the rows each, by which that command divides the work (none: by scenes).
        scenes: those that are measured unless ``--scenes`` names others.
        known: what ``--scenes`` may name.
        charts: stem of a picture -> what it shows; drawn by ``draw(rows by stem, folder, setup)``.
        options: adds options of its own to the parser.
    """

    name: str
    about: str
    files: Mapping[str, RowFile]
    parts: Sequence[Part]
    measure: Callable[[Session], None]
    times: Callable[[Session], None] | None = None
    pieces: Sequence[tuple[str, ...]] = ()
    scenes: Sequence[str] = MEASURED
    known: Sequence[str] = tuple(SCENES)
    charts: Mapping[str, str] | None = None
    draw: Callable[[Mapping[str, list[Any]], Path, str], None] | None = None
    options: Callable[[argparse.ArgumentParser], object] | None = None

    @property
    def header(self) -> str:
        """Stem of the JSON file that says on what and how the rows were measured."""
        return self.name.replace("-", "_")

    def parser(self) -> Parser:
        """The options that all benchmarks have, and its own."""
        top = Parser(prog=f"minicloth bench {self.name}", description=self.about)
        top.add_argument("--scenes", help="default: " + ",".join(self.scenes))
        top.add_argument("--quick", action="store_true", help="a trial run in 2 minutes; says that it is quick")
        top.add_argument("--out", type=Path, help="folder for rows (CSV), their header (JSON) and charts")
        top.add_argument("--images", type=Path, help="another folder for the charts")
        top.add_argument("--chart-only", action="store_true", help="draw what --out holds, measure nothing")
        top.add_argument("--cache", type=Path, help="folder of what takes long to make (default: the user's caches)")
        top.add_argument("--fresh", action="store_true", help="measure again what --out holds")
        if self.times:
            top.add_argument("--times-only", action="store_true", help="only the times, which other programs disturb")
        top.add_argument("--backend", action="append", default=[], metavar="NAME[=JSON]", help="one more; may repeat")
        if self.options:
            self.options(top)
        return top

    def main(self, argv: Sequence[str]) -> int:
        """Measure what is missing, print the tables, write rows, header and charts.

        Raises:
            ValueError: an unknown name; ``--chart-only`` without ``--out``; rows of ``--quick``, of another revision
                or of none would mix with others.
        """
        session = Session(self, self.parser().parse_args(argv))
        header = session.out / f"{self.header}.json" if session.out else None
        remedy = "restore it, or start anew with --fresh and another --out"
        old = read_json(header, "quick", remedy=remedy) if header and header.is_file() else None
        if session.out and not session.given.fresh:
            check_header(self, session.out)
        if session.given.chart_only:
            if old is None:
                raise ValueError("--chart-only needs --out, the folder that holds the rows and their header")
            session.about = old
        else:
            if old and old["quick"] != session.quick and not session.given.fresh:
                kind = "without" if session.quick else "of"
                raise ValueError(f"{session.out} holds rows {kind} --quick: choose another --out, or --fresh")
            if old and not session.given.fresh:
                check_revision(old.get("revision"), session.about["revision"], session.out)
            announce(session.plan())
            print(setup(session.about))
            session.begin(header)
            if self.times:
                self.times(session)
            if not (self.times and session.given.times_only):
                self.measure(session)
            session.write(header)
        rows = session.rows()
        for part in self.parts:
            if all(rows.get(stem) for stem in part.files):
                print(f"\n{part.title}\n{part.show(*(rows[stem] for stem in part.files))}")
        if self.draw and session.images:
            session.images.mkdir(parents=True, exist_ok=True)
            self.draw(rows, session.images, setup(session.about))
        if session.out:
            print(f"rows in {session.out}")
        return 0


def find(name: str) -> Benchmark:
    """The benchmark of a name.

    Raises:
        ValueError: there is none; the nearest match is named.
        ImportError: a package that it needs is missing.
    """
    if name not in BENCHMARKS:
        raise unknown_name("benchmark", name, BENCHMARKS)
    return import_module(BENCHMARKS[name]).BENCHMARK


def saved(benchmark: Benchmark, folder: Path) -> dict[str, list[Any]]:
    """The rows that ``folder`` holds, by stem."""
    there = {stem: folder / f"{stem}.csv" for stem in benchmark.files}
    return {stem: read_rows(path, benchmark.files[stem].kind) for stem, path in there.items() if path.is_file()}


def setup(about: Mapping[str, Any]) -> str:
    """Where and how rows were measured, for the top of a table and the foot of a chart."""
    threads = about.get("threads", 1)
    parts = [
        about["processor"],
        about.get("instruction_set"),
        f"{threads} thread{'s' * (threads > 1)}",
        about.get("engines"),
    ]
    return ", ".join(filter(None, [*parts, "QUICK: a trial run, not for citing" if about["quick"] else ""]))


def check_header(benchmark: Benchmark, folder: Path) -> None:
    """That a header tells what the rows are that ``folder`` holds, if any.

    Raises:
        ValueError: there is none.
    """
    header = f"{benchmark.header}.json"
    rows = [f"{stem}.csv" for stem in benchmark.files if (folder / f"{stem}.csv").is_file()]
    if rows and not (folder / header).is_file():
        raise ValueError(
            f"{folder} holds {', '.join(rows)} without {header}, which tells their revision: restore it, choose "
            "another --out, or --fresh to measure them again"
        )


def check_revision(old: str | None, now: str, folder: Path | None) -> None:
    """That rows which ``folder`` holds and new ones are of one revision.

    Raises:
        ValueError: they are not.
    """
    if (old or "") != now:
        raise ValueError(
            f"{folder} holds rows of revision {old or 'unknown'}, and this is {now or 'unknown'}: choose another "
            "--out, or --fresh to measure them again"
        )


def revision() -> str:
    """The last commit of the code, with ``-dirty`` and a digest of what differs from it; empty outside a checkout."""
    root = Path(__file__).parents[2]

    def git(*command: str) -> str:
        found = subprocess.run(["git", *command, "--", *CODE], cwd=root, capture_output=True, text=True, check=False)
        return found.stdout.strip()

    changed = git("diff", "HEAD")
    return git("log", "-1", "--format=%h", "--abbrev=12") + (f"-dirty-{crc32(changed.encode()):08x}" if changed else "")
