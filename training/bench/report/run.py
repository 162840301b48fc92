"""``minicloth report``: one self-contained HTML page from the rows and charts that benchmarks wrote."""

from __future__ import annotations

import json
from collections.abc import Sequence
from html import escape
from pathlib import Path

from cloth_envs.extras import install
from cloth_envs.files import check_file
from cloth_envs.version import __version__
from training.bench.benchmark import BENCHMARKS, find, saved
from training.bench.report import page
from training.bench.report.tables import shown


def write(data: Path, images: Path, out: Path) -> str:
    """Write the page of what ``data`` (rows) and ``images`` (charts, or else those in ``data``) hold to ``out``.

    Returns what was written. What is missing is listed on the page, with the command that makes it.

    Raises:
        ValueError: ``data`` holds no rows of a benchmark, or rows with other columns than this version's.
        OSError: ``out`` can't be written.
    """
    check_file(out, suffixes=(".html",))
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
        head += page.fold(f"Missing: {len(missing)}", page.items(missing), opened=True)
    text = page.document("MiniCloth benchmarks", head, sections)
    out.write_text(text, encoding="utf-8")
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
            html = shown(part, [rows[stem] for stem in part.files])
            body.append(f"<h3>{escape(part.title)}</h3>\n{html}")
    if not body:
        return "", missing
    found = {_picture(stem, (images, data)): about for stem, about in (benchmark.charts or {}).items()}
    pictures = [(about, page.picture(path, about)) for path, about in found.items() if path]
    if benchmark.charts and not pictures:
        missing.append(f"{name}, charts: {command} --out {data}")
    drawn = [page.fold(about, image, opened=not number) for number, (about, image) in enumerate(pictures)]
    head = [page.paragraph(benchmark.about), setup(data / f"{benchmark.header}.json")]
    return "\n".join([*head, *drawn, *body]), missing


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


def _picture(stem: str, folders: Sequence[Path]) -> Path | None:
    paths = (folder / f"{stem}{kind}" for folder in folders for kind in page.PICTURES)
    return next((path for path in paths if path.is_file()), None)
