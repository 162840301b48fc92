"""``minicloth report``: one self-contained HTML page from the rows and charts that benchmarks wrote."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from html import escape
from pathlib import Path

from cloth_envs.extras import install
from cloth_envs.files import check_file, read_json, write_text
from cloth_envs.progress import announce
from cloth_envs.version import __version__
from training.bench.benchmark import BENCHMARKS, find, saved
from training.bench.participants import FLOOR, ORACLE, label
from training.bench.report import page
from training.bench.speed_accuracy import rows as speed_accuracy
from training.bench.speed_accuracy import speedup
from training.bench.speed_accuracy.chart import OVERVIEW_FRAMES as FRAMES
from training.bench.speed_accuracy.rows import GATE, SpeedAccuracyRow, front
from training.bench.speed_accuracy.speedup import FITTED
from training.bench.stability import rows as stability
from training.bench.stability.rows import StabilityRow, marks
from training.bench.stability.worlds import AXES


def write(data: Path, images: Path, out: Path) -> str:
    """Write the page of what ``data`` (rows) and ``images`` (charts, or else those in ``data``) hold to ``out``.

    Returns what was written. What is missing is listed on the page, with the command that makes it.

    Raises:
        ValueError: ``data`` holds no rows of a benchmark, or rows with other columns than this version's.
        OSError: a folder is not there, or ``out`` can't be written.
    """
    check_file(out, suffixes=(".html",))
    if not data.is_dir():
        raise FileNotFoundError(
            f"there is no folder {data}: run `minicloth bench NAME --quick --out {data}` first, or choose another "
            "--data"
        )
    if not images.is_dir():
        raise FileNotFoundError(f"there is no folder {images}: choose another --images, or leave it out")
    announce(f"rows of {', '.join(BENCHMARKS)} in {data} and charts in {images} become one page, {out}")
    sections, missing = {}, []
    for name in BENCHMARKS:
        body, lacks = section(name, data, images)
        missing += lacks
        if body:
            sections[name.capitalize()] = body
    if not sections:
        raise ValueError(
            f"{data} holds no rows of a benchmark: run `minicloth bench NAME --quick --out {data}` first (NAME: "
            f"{', '.join(BENCHMARKS)}), or choose another --data"
        )
    head = page.paragraph(f"MiniCloth {__version__}: what `minicloth bench` measured. Each has its set-up beside it.")
    if missing:
        lines = "".join(f"<li>{escape(line)}</li>" for line in missing)
        head += page.fold(f"Missing: {len(missing)}", f"<ul>{lines}</ul>", opened=True)
    text = page.document("MiniCloth benchmarks", head, sections)
    write_text(out, text)
    lacking = f"; {len(missing)} missing, listed in it" if missing else ""
    return f"{out}: {len(sections)} benchmarks, {len(text.encode()) / 1e6:.1f} MB{lacking}"


def section(name: str, data: Path, images: Path) -> tuple[str, list[str]]:
    """A benchmark's part of the page as HTML, empty where nothing of it is there; and what is missing."""
    command = f"minicloth bench {name}"
    try:
        benchmark = find(name)
    except ImportError as error:
        return "", [f"{name}: {error}; {install('all')}, then {command} --out {data}, or this command again"]
    rows, body, missing = saved(benchmark, data), [], []
    for part in benchmark.parts:
        lacks = [f"{stem}.csv" for stem in part.files if stem not in rows]
        if lacks:
            words = " ".join(f"{command} {part.options} --out {data}".split())
            missing.append(f"{name}, {part.title} ({', '.join(lacks)}): {words}")
        else:
            shorter, found = SHORTER.get(part.show), [rows[stem] for stem in part.files]
            html = shorter(*found) if shorter else page.text(part.show(*found))
            body.append(f"<h3>{escape(part.title)}</h3>\n{html}")
    if not body:
        return "", missing
    pictures = []
    for stem, about in (benchmark.charts or {}).items():
        paths = (folder / f"{stem}{kind}" for folder in (images, data) for kind in page.PICTURES)
        if path := next((path for path in paths if path.is_file()), None):
            pictures.append((about, page.picture(path, about)))
    if benchmark.charts and not pictures:
        missing.append(f"{name}, charts: {command} --out {data}")
    drawn = [page.fold(about, image, opened=not number) for number, (about, image) in enumerate(pictures)]
    head = [page.paragraph(benchmark.about), setup(data / f"{benchmark.header}.json")]
    return "\n".join([*head, *drawn, *body]), missing


def setup(path: Path) -> str:
    """Machine, threads, versions, revision and options from a benchmark's JSON header."""
    if not path.is_file():
        return page.paragraph(f"Set-up unknown: {path.name} is missing", "setup")
    about = read_json(path, remedy="restore it, or measure again")
    plain = {key: value for key, value in about.items() if not isinstance(value, dict)}
    words = (f"{key} {', '.join(map(str, x)) if isinstance(x, list) else x}" for key, x in plain.items())
    text = page.paragraph(" · ".join(words), "setup")
    if about.get("quick"):
        text = page.paragraph("QUICK: a trial run on coarse grids or with few repeats, not for citing", "quick") + text
    rest = {key: value for key, value in about.items() if key not in plain}
    return text + (page.fold("More of the set-up", page.pre(json.dumps(rest, indent=1))) if rest else "")


def scenes(rows: Sequence[SpeedAccuracyRow]) -> str:
    """A table a scene: who is how fast and how close after ``FRAMES`` frames, the fastest first."""
    out = []
    for scene in dict.fromkeys(r.scene for r in rows):
        mine = [r for r in rows if (r.scene, r.frames) == (scene, FRAMES) and r.family not in (ORACLE, FLOOR)]
        if not mine:
            continue
        mine.sort(key=lambda r: math.inf if math.isnan(r.ms_median) else r.ms_median)
        best = front(mine)
        full = next((r.ms_median for r in mine if (r.family, r.options) == ("explicit", "{}")), math.nan)
        cells = []
        for r in mine:
            late = f"mean height off by {100 * r.gate:.0f} % of its way" if r.gate > GATE else ""
            numbers = map(_short, (r.ms_median, full / r.ms_median, r.error))
            cells.append((label(r.family, r.options) + " *" * (r in best), *numbers, r.failure or late))
        about = (
            f"{scene} after {FRAMES} frames; error in % of the cloth's length (chaos floor {_short(mine[0].floor)}), "
            "times over explicit at full resolution; *: nothing that passes is both faster and closer"
        )
        heads = ("method", "ms a frame", "x faster", "error %", "failure")
        out.append(page.fold(f"{scene}: {len(mine)} methods", page.table(about, heads, cells)))
    return "\n".join(out)


def survived(rows: Sequence[StabilityRow]) -> str:
    """Which part of its runs a method survived, and passed, along each axis; rounded down."""
    found = marks(rows)
    axes = [axis for axis in AXES if any(key[0] == axis for key in found)]
    cells = []
    for backend in dict.fromkeys(key[1] for key in found):
        line = [backend]
        for axis in axes:
            some = [m for key, m in found.items() if key[:2] == (axis, backend)]
            runs = sum(m.runs for m in some)
            parts = (100 * sum(part) // runs for part in zip(*((m.survived, m.passed) for m in some), strict=True))
            line.append("{} ({})".format(*parts) if runs else "")
        cells.append(line)
    about = (
        "Runs [%] of all levels, scenes and seeds of an axis that survived, in brackets those that passed; a run that "
        "is only wrong survived"
    )
    return page.table(about, ["method", *axes], cells)


def _short(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "-"


# What a benchmark prints -> a shorter form of it.
SHORTER: Mapping[Callable[..., str], Callable[..., str]] = {
    speed_accuracy.table: scenes,
    speedup.table: lambda found: page.pre(  # after ``FRAMES`` frames, methods that are no baseline themselves
        speedup.table([f for f in found if f.frames == FRAMES and f.family not in FITTED])
    ),
    stability.table: lambda rows: survived(rows) + page.text(stability.table(rows)),
}
