"""``minicloth report``: one self-contained HTML page from the rows and charts that benchmarks wrote."""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from cloth_envs.extras import install
from cloth_envs.files import check_file
from cloth_envs.registry import SCENES
from cloth_envs.version import __version__
from training.bench.benchmark import BENCHMARKS
from training.bench.report import page
from training.bench.report.tables import learned, scenes, survived
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES as FRAMES
from training.rows import read_rows

SHORT = 64  # lines of text that are shown without a click


@dataclass(frozen=True)
class Part:
    """What is shown of some rows. ``rows``: CSV -> class of its rows, ``show``: what makes HTML of them, or text as the
    benchmark prints it; both as ``module:name``, imported on use. ``header`` is their JSON file, ``options`` are what
    the benchmark needs to write them.
    """

    title: str
    header: str
    rows: Mapping[str, str]
    show: Callable[..., str] | str
    options: str = ""


# benchmark -> (its charts and what they show, its tables). Add one by a line.
PARTS: dict[str, tuple[Mapping[str, str], Sequence[Part]]] = {
    "speed-accuracy": (
        {
            "speed_accuracy": f"All scenes: error after {FRAMES} frames against milliseconds a frame, by method",
            **{f"speed_accuracy_{s.lower()}": f"{s}: errors against milliseconds a frame, by method" for s in SCENES},
        },
        (
            Part("Methods", "speed_accuracy", {"speed_accuracy": "speed_accuracy_summary:Summary"}, scenes),
            Part(
                f"Speed-up at equal error after {FRAMES} frames", "speed_accuracy",
                {"speed_accuracy_speedup": "speed_accuracy_speedup:SpeedUp"}, learned,
            ),
        ),
    ),
    "stability": (
        {"stability": "Heat maps of the runs that passed and survived: a panel an axis, a line a method"},
        (
            Part("By axis", "stability", {"stability": "stability_rows:Cell"}, survived),
            Part(
                "By level: runs that passed / survived / all", "stability", {"stability": "stability_rows:Cell"},
                "stability_rows:table",
            ),
        ),
    ),
    "transfer": (
        {"transfer": "Reward on the reference against training time, by what the policy was trained on"},
        (Part("Rewards a frame", "transfer", {"transfer": "transfer_rows:Summary"}, "transfer_rows:table"),),
    ),
    "mesh": ({}, (Part("Errors", "mesh_error", {"mesh_error": "mesh:Row"}, "mesh:table"),)),
    "solvers": (
        {"solvers": f"Error after {FRAMES} frames against milliseconds a frame, by solver"},
        (
            Part("Accuracy per cost", "solvers", {"solvers": "summary:Summary"}, "summary:table"),
            Part("Convergence", "solvers", {"solvers_convergence": "convergence:Point"}, "convergence:table"),
            Part("Limits", "solvers", {"solvers_sweep": "sweep:Cell"}, "sweep:table"),
            Part("Chaos floor [% of the length]", "chaos_floor", {"chaos_floor": "chaos:Floor"}, "chaos:table"),
        ),
    ),
    "peers": (
        {"peers": "Error against milliseconds a frame, by engine, a panel a scene"},
        (Part("Engines", "peers", {"peers": "peers_rows:Row"}, "peers_rows:table"),),
    ),
    "tables": (
        {
            "published_frames": "Errors by frame: interpolation and networks beside the teacher (figures 9-12)",
            "published_variants": "Errors for other masses, springs and winds (figures 13-15)",
            "published_pictures": "The teacher's cloth beside those that it is compared with (figures 10-12, 15)",
        },
        (
            Part("Tables 4, 6 and 8", "tables", {"tables": "tables:Row"}, "tables:text"),
            Part("With networks", "published", {"published": "published:Row"}, "published:text", "--networks"),
            Part(
                "Zhao 2024, table 2", "cnn",
                {"cnn": "cnn:Row", "cnn_speed": "cnn:Speed", "cnn_checks": "cnn:Check"}, "cnn:text", "--cell",
            ),
        ),
    ),
    "throughput": (
        {},
        (
            Part("Terms and threads", "throughput", {"throughput": "throughput:Row"}, "throughput:table"),
            Part("Whole frames", "throughput", {"frames": "frames:Frame"}, "frames:table"),
        ),
    ),
}  # fmt: skip


def write(data: Path, images: Path, out: Path) -> str:
    """Write the page of what ``data`` (rows) and ``images`` (charts, or else those in ``data``) hold to ``out``.

    Returns what was written. What is missing is listed on the page, with the command that makes it.

    Raises:
        ValueError: ``data`` holds no rows of a benchmark, or rows with other columns than this version's.
        OSError: ``out`` can't be written.
    """
    check_file(out, suffixes=(".html",))
    sections, missing = {}, []
    for name in PARTS:
        body, lacks = section(name, data, images)
        missing += lacks
        if body:
            sections[name.capitalize()] = body
    if not sections:
        raise ValueError(
            f"{data} holds no rows of a benchmark: run `minicloth bench NAME --quick --out {data}` first (NAME: "
            f"{', '.join(PARTS)}), or choose another --data"
        )
    head = page.paragraph(f"MiniCloth {__version__}: what `minicloth bench` measured. Each has its set-up beside it.")
    if missing:
        head += page.fold(f"Missing: {len(missing)}", page.items(missing), opened=True)
    text = page.document("MiniCloth benchmarks", head, sections)
    out.write_text(text, encoding="utf-8")
    lacking = f"; {len(missing)} missing, listed in it" if missing else ""
    return f"{out}: {len(sections)} benchmarks, {len(text.encode()) / 1e6:.1f} MB{lacking}"


def section(name: str, data: Path, images: Path) -> tuple[str, list[str]]:
    """A benchmark's part of the page as HTML, empty where nothing of it is there; and what is missing."""
    body, missing, header = [], [], ""
    charts, parts = PARTS[name]
    for part in parts:
        lacks = [f"{stem}.csv" for stem in part.rows if not (data / f"{stem}.csv").is_file()]
        command = " ".join(f"minicloth bench {name} {part.options} --out {data}".split())
        if lacks:
            missing.append(f"{name}, {part.title} ({', '.join(lacks)}): {command}")
            continue
        try:
            rows = [read_rows(data / f"{stem}.csv", _named(kind)) for stem, kind in part.rows.items()]
            shown = part.show(*rows) if callable(part.show) else _text(_named(part.show)(*rows))
        except ImportError as error:
            missing.append(f"{name}, {part.title}: {error}; {install('all')}, then this command again")
            continue
        if part.header != header:
            header = part.header
            body.append(setup(data / f"{header}.json"))
        body.append(f"<h3>{escape(part.title)}</h3>\n{shown}")
    if not body:
        return "", missing
    found = {_picture(stem, (images, data)): about for stem, about in charts.items()}
    pictures = [(about, page.picture(path, about)) for path, about in found.items() if path]
    if charts and not pictures:
        missing.append(
            f"{name}, charts: minicloth bench {name} --out {data}" + f" --images {data}" * (name == "tables")
        )
    drawn = [page.fold(about, image, opened=not number) for number, (about, image) in enumerate(pictures)]
    return "\n".join([page.paragraph(purpose(name)), body[0], *drawn, *body[1:]]), missing


def purpose(name: str) -> str:
    """What a benchmark measures: the first line of its module's docstring, read without importing it."""
    spec = find_spec(BENCHMARKS[name].split(":")[0])
    assert spec is not None
    assert spec.origin is not None
    text = ast.get_docstring(ast.parse(Path(spec.origin).read_text(encoding="utf-8"))) or ""
    about = text.splitlines()[0].split(": ", 1)[1]
    return about[0].upper() + about[1:]


def setup(path: Path) -> str:
    """Machine, threads, versions, revision and options from a benchmark's JSON header."""
    if not path.is_file():
        return page.paragraph(f"Set-up unknown: {path.name} is missing", "setup")
    about = json.loads(path.read_text())
    plain = {key: value for key, value in about.items() if not isinstance(value, dict)}
    words = (f"{key} {', '.join(map(str, x)) if isinstance(x, list) else x}" for key, x in plain.items())
    text = page.paragraph(" · ".join(words), "setup")
    if about.get("quick"):
        text = page.paragraph("QUICK: a trial run on coarse grids or with few repeats, not for citing", "quick") + text
    rest = {key: value for key, value in about.items() if key not in plain}
    return text + (page.fold("More of the set-up", page.pre(json.dumps(rest, indent=1))) if rest else "")


def _text(table: str) -> str:
    lines = table.strip("\n").count("\n") + 1
    return page.fold(f"{lines} lines", page.pre(table), opened=lines <= SHORT)


def _named(path: str) -> Any:
    module, name = path.split(":")
    return getattr(import_module(f"training.bench.{module}"), name)


def _picture(stem: str, folders: Sequence[Path]) -> Path | None:
    paths = (folder / f"{stem}{kind}" for folder in folders for kind in page.PICTURES)
    return next((path for path in paths if path.is_file()), None)
