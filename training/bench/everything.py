"""``minicloth bench all``: the benchmarks of the docs' rows, of one revision in one folder, several at once.

Times are taken first, by one process of one thread while nothing else runs. The rest is divided into pieces, ``--jobs``
at once, each a process of one thread with a folder of its own, in which it goes on where it was stopped. Their rows are
put together in the end; summaries, charts and headers follow from them.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

from cloth_envs.arguments import whole_number
from cloth_envs.files import check_folder, read_json, write_text
from cloth_envs.parsing import Parser
from cloth_envs.progress import announce, progress, say
from training.bench.benchmark import BENCHMARKS, Benchmark, check_header, check_revision, find, revision, saved
from training.bench.children import Children
from training.rows import Store, read_names

# All but those of tasks, kernels, cards, solvers, single sheets, pairs, other programs, other papers and of a
# million steps, and the one whose table ``backend="auto"`` reads: it is made first, and is code of the others.
APART = (
    "tasks",
    "throughput",
    "convergence",
    "folds",
    "synchronised",
    "super-resolution",
    "peers",
    "tables",
    "endurance",
    "choices",
    "gpu",
)
USUAL = [name for name in BENCHMARKS if name not in APART]
RECORD, PARTS, TIMES = "all.json", "parts", ("--times-only",)
RUN = "import sys; from training.bench.benchmark import find; sys.exit(find(sys.argv[1]).main(sys.argv[2:]))"


@dataclass(frozen=True)
class Piece:
    """A call of ``benchmark`` with ``options``: its times (alone), a part of its rows, or what follows from them."""

    benchmark: str
    options: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """What the record and the summary call it."""
        return " ".join((self.benchmark, *(word.removeprefix("--") for word in self.options)))


def parts(benchmark: Benchmark) -> list[Piece]:
    """The pieces of its rows; one may measure all of them."""
    return [Piece(benchmark.name, words) for words in benchmark.pieces or [("--scenes", s) for s in benchmark.scenes]]


def taken(process: "subprocess.Popen[bytes]") -> tuple[int, float]:
    """How a process ends, and its seconds of the processor; those of the processes that it started are among them."""
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, round(usage.ru_utime + usage.ru_stime, 1)


class Everything:
    """One call: the folder, its record of what is done ``{piece: seconds of the processor}``, and what failed
    ``{piece: why}``.
    """

    def __init__(self, given: argparse.Namespace) -> None:
        self.given, self.out = given, check_folder(given.out)
        self.chosen = [find(name) for name in read_names(given.only, list(BENCHMARKS), "benchmark")]
        self.revision, self.done, self.failed = revision(), dict[str, float](), dict[str, str]()
        self.children = Children()
        record = self.out / RECORD
        if given.fresh:
            self.clear()
        for benchmark in self.chosen:
            check_header(benchmark, self.out)
        for path in (record, *(self.out / f"{b.header}.json" for b in self.chosen)):
            if path.is_file():
                old = read_json(path, "quick", remedy="restore it, or start anew with --fresh")
                check_revision(old.get("revision"), self.revision, self.out)
                if old["quick"] != given.quick:
                    raise ValueError(f"{self.out} holds rows with or without --quick: choose another --out, or --fresh")
                self.done |= old["seconds"] if path == record else {}
        (self.out / PARTS).mkdir(exist_ok=True)

    def clear(self) -> None:
        """Remove the rows and headers of what was chosen, and the record."""
        shutil.rmtree(self.out / PARTS, ignore_errors=True)
        stems = [f"{stem}.csv" for b in self.chosen for stem in b.files]
        for name in (RECORD, *stems, *(f"{b.header}.json" for b in self.chosen)):
            (self.out / name).unlink(missing_ok=True)

    def run(self, piece: Piece, folder: Path) -> tuple[Piece, float, str]:
        """Do a piece into ``folder``, unless it is done; its seconds of the processor, and why it failed."""
        if piece.name in self.done:
            return piece, self.done[piece.name], ""
        given, log = self.given, self.out / PARTS / f"{piece.name}.txt"
        words = [*piece.options, "--out", str(folder), *(["--quick"] if given.quick else [])]
        words += ["--cache", str(given.cache)] if given.cache else []
        words += ["--images", str(given.images)] if given.images and folder == self.out else []
        with log.open("w") as file:
            command = [sys.executable, "-c", RUN, piece.benchmark, *words]
            ended, seconds = taken(self.children.start(command, file))
        why = ""
        if ended:
            said = log.read_text(errors="replace").strip().splitlines()
            why = said[-1] if said else f"it ended with {ended}"
        else:
            at = read_json(folder / f"{find(piece.benchmark).header}.json", remedy="start anew with --fresh")[
                "revision"
            ]
            why = f"the code became revision {at} meanwhile: start anew with --fresh" if at != self.revision else ""
        return piece, seconds, why

    def part(self, piece: Piece) -> tuple[Piece, float, str]:
        """A piece of rows, in a folder of its own that knows the times."""
        folder, benchmark = self.out / PARTS / piece.name, find(piece.benchmark)
        if not folder.is_dir():
            folder.mkdir(parents=True)
            for name in (f"{benchmark.header}.json", *(f"{stem}.csv" for stem in benchmark.files)):
                if (self.out / name).is_file():
                    shutil.copy(self.out / name, folder)
        return self.run(piece, folder)

    def finish(self, benchmark: Benchmark) -> None:
        """Put the rows of all its pieces together, and make of them what follows; nothing where a piece failed."""
        mine = parts(benchmark)
        if any(piece.name not in self.done for piece in mine):
            return
        header = f"{benchmark.header}.json"
        if not (self.out / header).is_file():
            shutil.copy(self.out / PARTS / mine[0].name / header, self.out)
        for stem, file in benchmark.files.items():
            store: Store[Any] = Store(self.out / f"{stem}.csv", file.kind, file.key)
            for piece in mine if file.key else ():
                store.add(*saved(benchmark, self.out / PARTS / piece.name).get(stem, ()))
        self.note(*self.run(Piece(benchmark.name), self.out))
        if benchmark.name in self.done:
            for piece in (*mine, Piece(benchmark.name), Piece(benchmark.name, TIMES)):
                shutil.rmtree(self.out / PARTS / piece.name, ignore_errors=True)
                (self.out / PARTS / f"{piece.name}.txt").unlink(missing_ok=True)

    def measure(self, pieces: Sequence[Piece]) -> None:
        """Times alone, then ``pieces``, then what follows from them."""
        for benchmark in (b for b in self.chosen if b.times):
            self.note(*self.run(Piece(benchmark.name, TIMES), self.out))
        with ThreadPoolExecutor(self.given.jobs) as pool:
            running = [pool.submit(self.part, piece) for piece in pieces]
            try:
                for one in progress(as_completed(running), "all", len(running), unit="piece"):
                    self.note(*one.result())
            finally:
                pool.shutdown(cancel_futures=True)
        for benchmark in self.chosen:
            self.finish(benchmark)

    def note(self, piece: Piece, seconds: float, why: str) -> None:
        """Keep what has come of a piece."""
        if why:
            self.failed[piece.name] = why
            say(f"{piece.name} failed: {why}")
            return
        self.done[piece.name] = seconds
        about = {"revision": self.revision, "quick": self.given.quick, "jobs": self.given.jobs, "seconds": self.done}
        write_text(self.out / RECORD, json.dumps(about, indent=2) + "\n")

    def summary(self, seconds: float) -> str:
        """What ran and its seconds of the processor, and what failed."""
        lines = [f"{name:44s}{self.done[name]:8.0f} s" for name in self.done]
        lines += [f"{name:44s}  failed: {why}" for name, why in self.failed.items()]
        logs = f"; logs in {self.out / PARTS}, the same command goes on" if self.failed else ""
        busy = f"{sum(self.done.values()) / 60:.0f} min of the processor in all"
        ended = f"{len(self.done)} done, {busy}, {len(self.failed)} failed{logs}; this call took {seconds / 60:.0f} min"
        return "\n".join([*lines, ended])


def main(argv: Sequence[str]) -> int:
    """Measure everything that is missing; 1 if something failed.

    Raises:
        ValueError: an unknown name; ``--out`` holds rows of another revision, or of ``--quick`` and others would mix.
        OSError: ``--out`` can't be written.
    """
    top = Parser(prog="minicloth bench all", description="The benchmarks of the docs' rows, of one revision.")
    top.add_argument("--out", type=Path, required=True, help="folder for rows (CSV), their headers (JSON) and charts")
    top.add_argument("--jobs", type=int, default=os.cpu_count() or 1, help="pieces at once (default: the processors)")
    top.add_argument("--only", default=",".join(USUAL), help="benchmarks (default: %(default)s)")
    top.add_argument("--images", type=Path, help="another folder for the charts")
    top.add_argument("--cache", type=Path, help="folder of what takes long to make (default: the user's caches)")
    top.add_argument("--quick", action="store_true", help="a trial run; its rows say that it is quick")
    top.add_argument("--fresh", action="store_true", help="remove what --out holds of these benchmarks first")
    begin, all_of = perf_counter(), Everything(top.parse_args(argv))
    given, chosen = all_of.given, all_of.chosen
    whole_number("jobs", given.jobs)
    pieces = [piece for benchmark in chosen for piece in parts(benchmark)]
    announce(
        f"{', '.join(b.name for b in chosen)} into {given.out}: times alone, then {len(pieces)} pieces, {given.jobs} "
        f"at once; {len(all_of.done)} are done. Stopped by Ctrl-C, the same command goes on."
    )
    with all_of.children.watched():
        all_of.measure(pieces)
    if not any((given.out / PARTS).iterdir()):
        (given.out / PARTS).rmdir()
    print(all_of.summary(perf_counter() - begin))
    return int(bool(all_of.failed))
