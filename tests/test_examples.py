"""The examples run."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import imageio.v2 as imageio

ROOT = Path(__file__).parents[1]


def test_quickstart_runs(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, str(ROOT / "examples" / "quickstart.py"), str(tmp_path)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "51 frames recorded" in done.stdout
    assert imageio.imread(tmp_path / "flag.png").shape == (480, 640, 3)
    assert len((ROOT / "examples" / "quickstart.py").read_text().splitlines()) <= 40


def test_gallery_runs(tmp_path: Path) -> None:
    command = [sys.executable, str(ROOT / "examples" / "gallery.py"), "--starts", "--out", str(tmp_path / "all.png")]
    subprocess.run(command, capture_output=True, check=True)
    sheet = imageio.imread(tmp_path / "all.png")
    assert sheet.shape == (600, 1200, 3)
    for tile in (sheet[:300, i : i + 400] for i in (0, 400, 800)):
        assert tile.std() > 10  # something is drawn in each
