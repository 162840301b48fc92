"""``minicloth bench all``: pieces come together, a stopped or failed run goes on, revisions are not mixed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path
from time import sleep

import pytest

from training.bench import benchmark, everything
from training.bench.benchmark import BENCHMARKS, Benchmark, find
from training.bench.children import Children
from training.rows import read_rows

TOY = """
import os
from dataclasses import dataclass
from pathlib import Path
from training.bench.benchmark import Benchmark, Part, RowFile

@dataclass(frozen=True)
class Row:
    scene: str
    times: int

@dataclass(frozen=True)
class Sum:
    scenes: int

LOG = Path(__file__).with_name("log")

def note(what):
    with LOG.open("a") as file:
        file.write(what + "\\n")

def times(session):
    if ("all",) not in session.store("toy_cost"):
        note("times")
        session.store("toy_cost").add(Row("all", 1))

def measure(session):
    store = session.store("toy_rows")
    for scene in session.scenes:
        if (scene,) not in store:
            note(scene)
            if scene == os.environ.get("TOY_TEARS"):
                raise RuntimeError("torn")
            store.add(Row(scene, len(session.store("toy_cost").rows)))
    session.store("toy").replace([Sum(len(store.rows))])

BENCHMARK = Benchmark(
    name="toy", about="A toy.", scenes=("Flag", "Curtain"), measure=measure, times=times, parts=[],
    files={"toy": RowFile(Sum), "toy_rows": RowFile(Row, ("scene",)), "toy_cost": RowFile(Row, ("scene",))},
)
"""

RUN = """
import sys
from training.bench import benchmark
benchmark.revision = lambda: "now"
from toy import BENCHMARK
sys.exit(BENCHMARK.main(sys.argv[2:]))
"""


@pytest.fixture
def toy(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Benchmark:
    (tmp_path / "toy.py").write_text(TOY)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", ":".join([str(tmp_path), *sys.path]))
    monkeypatch.setitem(BENCHMARKS, "toy", "toy")
    for module in (benchmark, everything):  # whoever edits a file while this runs
        monkeypatch.setattr(module, "revision", lambda: "now")
    monkeypatch.setattr(everything, "RUN", RUN)
    monkeypatch.delitem(sys.modules, "toy", raising=False)
    return find("toy")


def test_pieces_come_together_and_go_on(
    toy: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    out, log = tmp_path / "out", tmp_path / "log"
    argv = ["--out", str(out), "--only", "toy", "--jobs", "2"]
    monkeypatch.setenv("TOY_TEARS", "Curtain")
    assert everything.main(argv) == 1
    said = capsys.readouterr().out
    assert "toy scenes Curtain" in said
    assert "RuntimeError: torn" in said
    assert "2 done" in said
    assert sorted(log.read_text().split()) == ["Curtain", "Flag", "times"]
    assert log.read_text().startswith("times")  # alone, before all others
    assert not (out / "toy.csv").exists()
    monkeypatch.delenv("TOY_TEARS")
    log.unlink()
    assert everything.main(argv) == 0
    assert log.read_text() == "Curtain\n"  # nothing else was measured again
    rows = {name: read_rows(out / f"{name}.csv", toy.files[name].kind) for name in toy.files}
    assert [(r.scene, r.times) for r in rows["toy_rows"]] == [("Flag", 1), ("Curtain", 1)]  # each knew the times
    assert (rows["toy"][0].scenes, len(rows["toy_cost"])) == (2, 1)
    assert sorted(path.name for path in out.iterdir()) == [
        "all.json",
        "toy.csv",
        "toy.json",
        "toy_cost.csv",
        "toy_rows.csv",
    ]
    record = json.loads((out / "all.json").read_text())
    assert record["revision"] == json.loads((out / "toy.json").read_text())["revision"] == "now"
    assert set(record["seconds"]) == {"toy times-only", "toy scenes Flag", "toy scenes Curtain", "toy"}
    log.unlink()
    assert everything.main(argv) == 0
    assert not log.exists()
    with pytest.raises(ValueError, match="quick"):
        everything.main([*argv, "--quick"])


def test_rows_of_another_revision_are_refused_or_measured_anew(toy: Benchmark, tmp_path: Path) -> None:
    out, log = tmp_path / "out", tmp_path / "log"
    argv = ["--out", str(out), "--scenes", "Flag"]
    assert toy.main(argv) == 0
    header = out / "toy.json"
    header.write_text(json.dumps({**json.loads(header.read_text()), "revision": "older"}))
    for refused in (lambda: toy.main(argv), lambda: everything.main(["--out", str(out), "--only", "toy"])):
        with pytest.raises(ValueError, match=r"revision older.*--fresh"):
            refused()
    assert toy.main([*argv, "--chart-only"]) == 0  # what is there is still shown
    log.unlink()
    assert everything.main(["--out", str(out), "--only", "toy", "--fresh"]) == 0
    assert sorted(log.read_text().split()) == ["Curtain", "Flag", "times"]
    assert json.loads(header.read_text())["revision"] == "now"


def test_rows_without_their_header_are_of_no_known_revision(toy: Benchmark, tmp_path: Path) -> None:
    out = tmp_path / "out"
    argv = ["--out", str(out), "--scenes", "Flag"]
    assert toy.main(argv) == 0
    (out / "toy.json").unlink()
    for refused in (lambda: toy.main(argv), lambda: everything.main(["--out", str(out), "--only", "toy"])):
        with pytest.raises(ValueError, match=r"toy_rows.csv.* without toy.json.*--fresh"):
            refused()
    assert toy.main([*argv, "--fresh"]) == 0


@pytest.mark.parametrize("where", ['note("times")', "note(scene)"])
def test_sigterm_ends_what_was_started(toy: Benchmark, tmp_path: Path, where: str) -> None:
    sleeps = 'note(f"pid {os.getpid()}"); time.sleep(60)'
    (tmp_path / "toy.py").write_text("import time\n" + TOY.replace(where, sleeps))
    code = (
        "import sys; from training.bench import benchmark, everything\n"
        f"benchmark.BENCHMARKS['toy'], everything.RUN = 'toy', {RUN!r}\n"
        f"sys.exit(everything.main(['--out', {str(tmp_path / 'out')!r}, '--only', 'toy', '--jobs', '1']))"
    )
    log = tmp_path / "log"
    with subprocess.Popen([sys.executable, "-c", code]) as running:
        while not (log.exists() and "pid" in log.read_text()):
            assert running.poll() is None
            sleep(0.02)
        running.terminate()
        assert running.wait(20) == 143
    with pytest.raises(ProcessLookupError):
        os.kill(int(log.read_text().split()[-1]), 0)


def test_code_that_changes_meanwhile_is_told(
    toy: Benchmark, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(everything, "revision", lambda: "older")
    assert everything.main(["--out", str(tmp_path / "out"), "--only", "toy", "--jobs", "1"]) == 1
    assert "the code became revision now meanwhile" in capsys.readouterr().out


def test_a_piece_is_charged_what_it_computes_and_not_what_it_waits(tmp_path: Path) -> None:
    """Sleep is not counted, a child's work is, and how a process ended is told."""
    busy = "from time import process_time\nwhile process_time() < 0.6: pass"
    child = f"import subprocess, sys; subprocess.run([sys.executable, '-c', {busy!r}]); sys.exit(3)"
    with (tmp_path / "log").open("w") as log:
        children = Children()
        slept = everything.taken(children.start([sys.executable, "-c", "import time; time.sleep(1.0)"], log))
        worked = everything.taken(children.start([sys.executable, "-c", child], log))
    assert slept[0] == 0
    assert slept[1] < 0.6 <= worked[1]
    assert worked[0] == 3


def test_every_usual_benchmark_is_divided_into_what_it_takes() -> None:
    """Each piece is a command line that its benchmark reads."""
    for name in everything.USUAL:
        found = find(name)
        pieces = everything.parts(found)
        assert len({piece.name for piece in pieces}) == len(pieces) > 1
        for piece in pieces:
            found.parser().parse_args(piece.options)


def test_mistakes_name_the_nearest(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="Did you mean 'mesh'"):
        everything.main(["--out", str(tmp_path), "--only", "mash"])
    with pytest.raises(ValueError, match="',' names no benchmark"):
        everything.main(["--out", str(tmp_path), "--only", ","])
