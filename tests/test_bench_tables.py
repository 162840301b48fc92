"""The seed's tables: a row from a short run, and errors that are those of their definition."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest

from training.bench.papers.run import BENCHMARK
from training.bench.papers.runs import by_frame


def test_errors_are_means_over_the_vertices_of_every_frame() -> None:
    a = np.zeros((2, 3, 4, 5))
    b = a.copy()
    b[1, :, 0, 0] = [3.0, 0.0, 4.0]
    assert by_frame(a, b) == pytest.approx([0.0, 5.0 / 20])


def test_a_finer_miniature_and_its_oracle_are_nearer_to_the_teacher(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert BENCHMARK.main(["--quick", "--out", str(tmp_path)]) == 0
    assert "QUICK" in capsys.readouterr().out
    with open(tmp_path / "tables.csv", newline="") as file:
        rows = list(csv.DictReader(line for line in file if line[0] != "#"))
    similar = [row for row in rows if row["table"] == "4" and row["scaling"] == "similar"]
    assert [row["factor"] for row in similar] == ["2", "3", "4"]
    for kind in ("oracle_error", "real_error"):
        errors = [float(row[kind]) for row in similar]
        assert errors == sorted(errors)
    assert all(float(row["oracle_error"]) < float(row["real_error"]) for row in rows)
    assert {row["scene"] for row in rows if row["table"] == "8"} == {"Curtain", "Flag", "Collision"}
