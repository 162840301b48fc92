"""``minicloth report``: a page that needs nothing besides it, with the right figures and what is missing."""

from __future__ import annotations

import json
import re
import sys
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, get_type_hints

import pytest

from cloth_envs.commands.cli import main
from training.bench.benchmark import BENCHMARKS, find
from training.bench.mesh import MeshRow
from training.bench.report import run as report
from training.bench.report.run import survived
from training.bench.speed_accuracy.rows import SpeedAccuracyRow
from training.bench.stability.rows import StabilityRow
from training.rows import write_rows

DOCS = Path(__file__).parents[1] / "docs"
ALONE = {"meta", "img"}  # tags of the page without an end
PIXEL = "<svg xmlns='http://www.w3.org/2000/svg' width='1' height='1'/>"


class Page(HTMLParser):
    """Tags in order, open ones as a stack, rows of tables, and text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.rows: list[list[str]] = []
        self.words = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
        if tag not in ALONE:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.words += data
        if self.open and self.open[-1] in ("td", "th"):
            self.rows[-1][-1] += data


def row(kind: type[Any], **given: Any) -> Any:
    """A row of zeros and empty texts but for what is ``given``."""
    return kind(**{name: given.get(name, of()) for name, of in get_type_hints(kind).items()})


def summaries(**given: Any) -> Any:
    return row(SpeedAccuracyRow, **{"scene": "Flag", "options": "{}", "frames": 5, **given})


def test_page_of_the_stored_rows_needs_nothing_besides_it(tmp_path: Path) -> None:
    out = tmp_path / "report.html"
    report.write(DOCS / "data", DOCS / "images", out)
    page = Page(out.read_text())
    assert page.open == []
    assert {tag for tag, _ in page.tags} & {"script", "link", "iframe", "object", "base"} == set()
    sources = [value for _, attrs in page.tags for name, value in attrs.items() if name in ("src", "srcset", "data")]
    assert len(sources) >= 10
    assert all(value and value.startswith("data:image/") for value in sources)
    assert not re.search(r"url\(|@import", out.read_text().split("</style>")[0])
    targets = [attrs["href"] for tag, attrs in page.tags if tag == "a"]
    assert set(targets) == {f"#{attrs['id']}" for _, attrs in page.tags if "id" in attrs}
    assert len(targets) == len(BENCHMARKS)  # none is left out
    assert all(attrs["alt"] for tag, attrs in page.tags if tag == "img")
    assert len(page.rows) < 600  # the rows behind them are thousands
    assert out.stat().st_size < 15e6


def test_methods_are_sorted_and_escaped(tmp_path: Path) -> None:
    rows = [
        summaries(family="explicit", ms_median=8.0, error=0.25, floor=0.1),
        summaries(family="miniature", options='{"factor": 2}', ms_median=2.0, error=1.0, floor=0.1),
        summaries(family="slow", ms_median=float("nan"), error=9.0, failure="<b>&refused"),
        summaries(family="late", ms_median=4.0, error=0.5, gate=0.2),
        summaries(family="oracle coarse", ms_median=float("nan"), error=0.01),
        summaries(family="explicit", frames=10, ms_median=8.0),
    ]
    write_rows(tmp_path / "speed_accuracy.csv", rows)
    (tmp_path / "speed_accuracy.json").write_text(json.dumps({"processor": "<x>", "quick": True, "seeds": [1, 2]}))
    (tmp_path / "speed_accuracy.svg").write_text(PIXEL)
    out = tmp_path / "a.html"
    assert main(["report", "--data", str(tmp_path), "--out", str(out)]) == 0
    page = Page(out.read_text())
    assert page.rows[1:] == [
        ["miniature x2 *", "2", "4", "1", ""],
        ["late", "4", "2", "0.5", "mean height off by 20 % of its way"],
        ["explicit *", "8", "1", "0.25", ""],
        ["slow", "-", "-", "9", "<b>&refused"],
    ]
    assert "b" not in dict(page.tags)
    assert "processor <x>" in page.words
    assert "seeds 1, 2" in page.words
    assert "QUICK" in page.words
    assert [attrs["src"][:18] for tag, attrs in page.tags if tag == "img" and attrs["src"]] == ["data:image/svg+xml"]


def test_missing_is_listed_with_its_command(tmp_path: Path) -> None:
    write_rows(tmp_path / "mesh_error.csv", [row(MeshRow, scene="Flag", options="{}", family="explicit")])
    said = report.write(tmp_path, tmp_path, tmp_path / "a.html")
    words = Page((tmp_path / "a.html").read_text()).words
    assert "Set-up unknown: mesh.json" in words
    commands = re.findall(r"minicloth bench (\S+)( --[\w-]+)? --out", words)
    assert {name for name, _ in commands} == set(BENCHMARKS) - {"mesh"}
    assert ("tables", " --cell") in commands
    assert f"{sum(len(find(name).parts) for name in BENCHMARKS) - 1} missing" in said


def test_missing_packages_leave_the_rest(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("throughput", "tables"):
        (tmp_path / f"{name}.csv").write_text((DOCS / "data" / f"{name}.csv").read_text())
    monkeypatch.setitem(sys.modules, "training.bench.papers.run", None)
    report.write(tmp_path, tmp_path, tmp_path / "a.html")
    words = Page((tmp_path / "a.html").read_text()).words
    assert 'pip install -e ".[all]"' in words
    assert "ns per vertex and substep" in words


def test_parts_of_runs_are_rounded_down() -> None:
    """A hundred means all: 199 of 200 do not."""
    cells = [row(StabilityRow, axis="mass", backend="a", level=1.0, seed=s) for s in range(197)]
    cells += [row(StabilityRow, axis="mass", backend="a", level=2.0, reason="slow motion", seed=s) for s in range(2)]
    cells += [row(StabilityRow, axis="mass", backend="a", level=2.0, reason="overstretch")]
    cells += [row(StabilityRow, axis="wind", backend="b", level=1.0)]
    assert Page(survived(cells)).rows == [["method", "mass", "wind"], ["a", "99 (98)", ""], ["b", "", "100 (100)"]]


@pytest.mark.parametrize(
    ("name", "out", "words"),
    [
        ("none", "a.html", "minicloth bench NAME --quick --out"),
        ("", "a.html", "minicloth bench NAME --quick --out"),
        ("", "a.pdf", "must end in .html"),
        ("", "none/a.html", "create the folder"),
        ("old", "a.html", "other columns"),
    ],
)
def test_mistakes_end_in_one_line(
    name: str, out: str, words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "old").mkdir()
    (tmp_path / "old" / "transfer.csv").write_text("scene,reward\nFlag,1\n")
    assert main(["report", "--data", str(tmp_path / name), "--out", str(tmp_path / out)]) == 2
    printed, err = capsys.readouterr()
    assert printed == ""
    assert words in err.splitlines()[-1]
    assert [path.name for path in tmp_path.iterdir()] == ["old"]
