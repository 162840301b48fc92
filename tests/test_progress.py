"""How far a long command is: plain lines where nobody sees a bar, and the same items either way."""

from __future__ import annotations

import sys
from collections.abc import Iterator

import pytest

from cloth_envs import progress as module
from cloth_envs.progress import announce, progress


def ticking(monkeypatch: pytest.MonkeyPatch, seconds: float) -> None:
    """Every look at the clock is so much later."""
    clock = iter(range(10_000))
    monkeypatch.setattr(module, "monotonic", lambda: seconds * next(clock))


def test_lines_in_a_pipe(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 4)
    assert list(progress(range(7), "Flag", unit="frame")) == list(range(7))
    out, err = capsys.readouterr()
    assert out == ""
    assert err.splitlines() == [
        "Flag: 3 of 7 frames, 12 s, about 16 s left",
        "Flag: 6 of 7 frames, 24 s, about 4 s left",
        "Flag: 7 of 7 frames, 32 s",
    ]


def test_long_runs_tell_less_often(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    ticking(monkeypatch, 10)
    assert len(list(progress(range(2000), "steps"))) == 2000
    lines = capsys.readouterr().err.splitlines()
    assert 20 < len(lines) < 120  # in 20,000 s: 20 in the first 200, then ln(100) / ln(1.05) = 94
    assert lines[-1].startswith("steps: 2000 of 2000, 5 h 33 min")


def test_what_was_done_before_and_what_has_no_length(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    ticking(monkeypatch, 60)

    def some() -> Iterator[int]:
        yield from range(2)

    assert list(progress(some(), "a")) == [0, 1]
    assert list(progress(range(8, 10), "b", 10, unit="step", done=8)) == [8, 9]
    assert capsys.readouterr().err.splitlines() == [
        "a: 1, 1 min 0 s",
        "a: 2, 2 min 0 s",
        "a: 2, 3 min 0 s",
        "b: 9 of 10 steps, 1 min 0 s, about 1 min 0 s left",
        "b: 10 of 10 steps, 3 min 0 s",
    ]


def test_a_bar_on_a_terminal(capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    names = {"a": "first", "b": "second"}
    assert list(progress(list(names), "entries", name=lambda item: names[item])) == ["a", "b"]
    err = capsys.readouterr().err
    assert "2/2" in err
    assert "second" in err


def test_a_loop_that_is_left_early_ends_quietly(capsys: pytest.CaptureFixture[str]) -> None:
    for item in progress(range(5), "Flag"):
        if item == 2:
            break
    assert capsys.readouterr().err == ""


def test_a_plan_is_no_result(capsys: pytest.CaptureFixture[str]) -> None:
    announce("into a folder")
    assert capsys.readouterr() == ("", "into a folder\n")
