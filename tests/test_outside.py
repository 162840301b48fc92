"""``minicloth bench outside``: what it tells of cloths that were not fitted, and of backends that are asked for."""

import json
from pathlib import Path

import pytest

from training.bench import outside
from training.rows import read_rows


def test_other_backends_are_held_against_the_same_truth(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(outside, "QUICK", ("9 x 13",))
    argv = ["--quick", "--scenes", "Flag", "--out", str(tmp_path)]

    def rows(*more: str) -> list[outside.OutsideRow]:
        assert outside.BENCHMARK.main([*argv, *more]) == 0
        return read_rows(tmp_path / "outside.csv", outside.OutsideRow)

    assert {json.dumps(json.loads(r.others)) for r in rows()} == {"{}"}
    found = rows("--backend", "reference", "--backend", 'miniature={"factor": 2}')
    assert [(r.factor, r.frames) for r in found] == [(2, 5), (2, 10), (4, 5), (4, 10)]
    for row in found:
        others = json.loads(row.others)
        assert others["reference"] < 1e-3 * row.default
        if row.factor == 2:  # the default, asked for by name
            assert others["miniature x2"] == row.default
    assert "default / closure / reference / miniature x2 over similar" in capsys.readouterr().out
    monkeypatch.setattr(outside, "windows", lambda *_: pytest.fail("measured again"))
    assert rows("--backend", "reference") == rows() == found
