"""The chart and the notes of a comparison in which one entry is another, to the bit."""

from __future__ import annotations

from pathlib import Path

import imageio.v2 as imageio
import numpy as np

from cloth_envs.commands import chart, tables
from cloth_envs.commands.entries import Entry
from cloth_envs.commands.measure import Comparison, Result, compare
from cloth_envs.style import COLORS

GRID = (9, 13)


def test_on_a_sheet_the_cnn_has_the_errors_of_the_reference() -> None:
    entries = [Entry("reference", GRID), Entry("reference", GRID, {"refine": 2}), Entry("cnn", GRID)]
    result = compare("Flag", entries, np.ones((12, 2)), resolution=GRID, repeats=1)
    assert result.twins == {"cnn 9x13": "reference 9x13"}
    notes = tables.notes(result, "Flag")
    assert "cnn 9x13 has the errors of reference 9x13, to the bit" in notes
    assert "Take it for gradients and forces of your own" in notes
    result.results.pop()
    assert "cnn" not in tables.notes(result, "Flag")


def test_markers_at_the_same_place_are_both_seen(tmp_path: Path) -> None:
    errors = np.linspace(0.01, 0.02, 4)[:, None]
    entries = [Entry(backend, GRID) for backend in ("reference", "cnn")]
    results = [Result(entry, errors, errors, [], 0.0, np.zeros(1, int), None, [1e-3]) for entry in entries]
    scene = entries[0].world("Flag", None).scene
    path = tmp_path / "chart.png"
    chart.draw(Comparison(scene, entries[0], results, [1], [0, 1, 2, 3]), [path], horizon=1, setup="two alike")
    picture = imageio.imread(path)[..., :3].astype(int)
    for color in COLORS[:2]:
        wanted = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
        seen = (abs(picture - wanted).max(-1) < 8).sum()
        # A disc of 8 points at 200 dots an inch, less its white edge, has 298 dots; the ring has more.
        assert seen > 280
